//! Gaussian pyramids of f32 planes (Burt & Adelson 1983, a = 0.375).
//!
//! A plane is a row-major slice of `width × height` values. Level 0 is the image; each further level
//! keeps the even samples of the level below after a separable (1, 4, 6, 4, 1)/16 filter with
//! clamp-to-edge borders, so its sides are ⌈n/2⌉ and its sample j sits at position 2·j of the level
//! below (REFERENCE §1.2). Written so that a constant plane stays constant to the last bit: only then
//! is the saliency of a uniform picture exactly zero in single precision.

use crate::image::Map2d;

/// Side of level `level` of a pyramid whose level 0 has `side` samples: ⌈side / 2^level⌉, taken step by step.
pub fn level_side(side: usize, level: u32) -> usize {
    (0..level).fold(side, |n, _| n.div_ceil(2))
}

/// (1, 4, 6, 4, 1)/16, written as the centre plus differences to it: exact where all five are equal.
#[inline(always)]
fn kernel(a: f32, b: f32, c: f32, d: f32, e: f32) -> f32 {
    let twice = c + c;
    c + (((a + e) - twice) + 4.0 * ((b + d) - twice)) * (1.0 / 16.0)
}

/// Row buffers that one REDUCE step needs; kept between frames.
#[derive(Clone, Debug, Default)]
pub(super) struct ReduceRows {
    vertical: Vec<f32>,
    even: Vec<f32>,
    odd: Vec<f32>,
}

impl ReduceRows {
    /// Filters five rows vertically and the result horizontally; `out` gets every second column.
    pub(super) fn reduce_rows(&mut self, rows: [&[f32]; 5], out: &mut [f32]) {
        let width = rows[2].len();
        self.vertical.resize(width, 0.0);
        let [a, b, c, d, e] = rows.map(|row| &row[..width]);
        for (x, v) in self.vertical[..width].iter_mut().enumerate() {
            *v = kernel(a[x], b[x], c[x], d[x], e[x]);
        }
        self.reduce_columns(width, out);
    }

    /// The horizontal half: splits columns into even and odd ones, so that the filter itself runs over
    /// contiguous memory. `even[0]` and `even[half + 1]`, `odd[0]` are the clamped border.
    fn reduce_columns(&mut self, width: usize, out: &mut [f32]) {
        let half = width.div_ceil(2);
        let out = &mut out[..half];
        self.even.resize(half + 2, 0.0);
        self.odd.resize(half + 1, 0.0);
        let source = &self.vertical[..width];
        let first = source[0];
        let last = source[width - 1];
        let (even, odd) = (&mut self.even[1..=half], &mut self.odd[1..=half]);
        let pairs = source.chunks_exact(2);
        let rest = pairs.remainder();
        for ((pair, e), o) in pairs.zip(even.iter_mut()).zip(odd.iter_mut()) {
            *e = pair[0];
            *o = pair[1];
        }
        if let [single] = rest {
            even[half - 1] = *single;
            odd[half - 1] = last;
        }
        self.even[0] = first;
        self.odd[0] = first;
        // Column 2·half lies outside; so does 2·half − 1 for an odd width, filled above.
        self.even[half + 1] = last;
        let e = &self.even[..half + 2];
        let o = &self.odd[..half + 1];
        for (i, value) in out.iter_mut().enumerate() {
            *value = kernel(e[i], o[i], e[i + 1], o[i + 1], e[i + 2]);
        }
    }

    /// REDUCE of a whole plane. `target` gets ⌈width/2⌉ · ⌈height/2⌉ values.
    pub(super) fn reduce(&mut self, source: &[f32], width: usize, height: usize, target: &mut [f32]) {
        let (w, h) = (width.div_ceil(2), height.div_ceil(2));
        for y in 0..h {
            let row = |offset: isize| {
                let y = (2 * y as isize + offset).clamp(0, height as isize - 1) as usize;
                &source[y * width..(y + 1) * width]
            };
            let rows = [row(-2), row(-1), row(0), row(1), row(2)];
            self.reduce_rows(rows, &mut target[y * w..(y + 1) * w]);
        }
    }
}

/// One REDUCE step of a map of any unit: sides ⌈n/2⌉.
///
/// Source: Burt & Adelson 1983, Eq. (1). Deviation: clamp-to-edge border.
pub fn reduce(map: &Map2d<f32>) -> Map2d<f32> {
    let (w, h) = (map.width().div_ceil(2), map.height().div_ceil(2));
    let mut out = Map2d::new(w, h, 0.0);
    if w > 0 && h > 0 {
        ReduceRows::default().reduce(map.data(), map.width(), map.height(), out.data_mut());
    }
    out
}

/// Interpolates `coarse` bilinearly to `width × height`, where coarse sample j sits at j · `factor` and
/// coordinates beyond the last sample are clamped (REFERENCE §1.3).
pub fn upsample(coarse: &Map2d<f32>, width: usize, height: usize, factor: usize) -> Map2d<f32> {
    let mut out = Map2d::new(width, height, 0.0);
    if coarse.width() == 0 || coarse.height() == 0 || width == 0 || factor == 0 {
        return out;
    }
    let mut row = vec![0.0; coarse.width()];
    for (y, out) in out.data_mut().chunks_exact_mut(width).enumerate() {
        lerp_rows(coarse.data(), coarse.width(), coarse.height(), y, factor, &mut row);
        expand_row(&row, factor, out);
    }
    out
}

/// Coarse row at fine position `y`: linear interpolation between the two coarse rows around it.
pub(super) fn lerp_rows(
    coarse: &[f32],
    width: usize,
    height: usize,
    y: usize,
    factor: usize,
    out: &mut [f32],
) {
    let y0 = (y / factor).min(height - 1);
    let y1 = (y0 + 1).min(height - 1);
    // Beyond the last sample both rows are the same, so the weight does not matter.
    let f = (y % factor) as f32 / factor as f32;
    let a = &coarse[y0 * width..(y0 + 1) * width];
    let b = &coarse[y1 * width..(y1 + 1) * width];
    for ((out, a), b) in out.iter_mut().zip(a).zip(b) {
        *out = a + (b - a) * f;
    }
}

/// Linear interpolation of a coarse row to a fine one.
fn expand_row(coarse: &[f32], factor: usize, out: &mut [f32]) {
    let step = 1.0 / factor as f32;
    for (j, cell) in out.chunks_mut(factor).enumerate() {
        let a = coarse[j.min(coarse.len() - 1)];
        let slope = (coarse[(j + 1).min(coarse.len() - 1)] - a) * step;
        for (i, value) in cell.iter_mut().enumerate() {
            *value = a + slope * i as f32;
        }
    }
}

/// `out[x] = |center[x] − interpolated coarse[x]|` for one row: the across-scale difference.
pub(super) fn difference_row(center: &[f32], coarse: &[f32], factor: usize, out: &mut [f32]) {
    let step = 1.0 / factor as f32;
    for (j, (cell, center)) in out.chunks_mut(factor).zip(center.chunks(factor)).enumerate() {
        let a = coarse[j.min(coarse.len() - 1)];
        let slope = (coarse[(j + 1).min(coarse.len() - 1)] - a) * step;
        for (i, (value, center)) in cell.iter_mut().zip(center).enumerate() {
            *value = (center - (a + slope * i as f32)).abs();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sides_are_rounded_up_level_by_level() {
        let sides = |n| (0..9).map(|l| level_side(n, l)).collect::<Vec<_>>();
        assert_eq!(sides(512), [512, 256, 128, 64, 32, 16, 8, 4, 2]);
        assert_eq!(sides(360), [360, 180, 90, 45, 23, 12, 6, 3, 2]);
        assert_eq!(sides(33), [33, 17, 9, 5, 3, 2, 1, 1, 1]);
        assert_eq!(sides(1), [1; 9]);
    }

    #[test]
    fn impulse_response_is_that_of_burt_and_adelson() {
        let impulse = Map2d::from_fn(33, 1, |x, _| if x == 16 { 1.0 } else { 0.0 });
        let once = reduce(&impulse);
        assert_eq!(&once.data()[6..11], &[0.0, 0.0625, 0.375, 0.0625, 0.0]);
        let twice = reduce(&once);
        assert_eq!(&twice.data()[2..7], &[0.0, 0.039_062_5, 0.171_875, 0.039_062_5, 0.0]);
    }

    #[test]
    fn reduce_equals_the_plain_convolution_for_every_small_size() {
        let k = [1.0, 4.0, 6.0, 4.0, 1.0];
        for (w, h) in [(1, 1), (2, 1), (1, 3), (5, 4), (8, 7), (19, 3)] {
            let map = Map2d::from_fn(w, h, |x, y| ((x * 7 + y * 13) % 11) as f32 / 10.0);
            let reduced = reduce(&map);
            assert_eq!((reduced.width(), reduced.height()), (w.div_ceil(2), h.div_ceil(2)));
            for y in 0..reduced.height() {
                for x in 0..reduced.width() {
                    let mut sum = 0.0;
                    for (j, ky) in k.iter().enumerate() {
                        for (i, kx) in k.iter().enumerate() {
                            let (sx, sy) = ((2 * x + i) as isize - 2, (2 * y + j) as isize - 2);
                            sum += kx * ky * map.clamped(sx, sy) / 256.0;
                        }
                    }
                    assert!((reduced.at(x, y) - sum).abs() < 1e-6, "{w}×{h} at {x}, {y}");
                }
            }
        }
    }

    #[test]
    fn a_constant_survives_to_the_last_bit() {
        for value in [0.1f32, 0.3, 0.7, 1.0 / 3.0] {
            let mut map = Map2d::new(37, 22, value);
            for _ in 0..8 {
                map = reduce(&map);
                assert!(map.data().iter().all(|&v| v == value));
            }
            assert!(upsample(&map, 37, 22, 256).data().iter().all(|&v| v == value));
        }
    }

    #[test]
    fn upsampling_puts_coarse_samples_at_multiples_of_the_factor() {
        let coarse = Map2d::from_fn(3, 2, |x, y| x as f32 + 10.0 * y as f32);
        let fine = upsample(&coarse, 12, 8, 4);
        assert_eq!(fine.at(4, 0), 1.0);
        assert_eq!(fine.at(8, 4), 12.0);
        assert_eq!(fine.at(6, 2), 6.5);
        assert_eq!(fine.at(11, 7), 12.0);
    }
}
