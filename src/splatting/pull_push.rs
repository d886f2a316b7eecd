//! What is shown between samples that lie anyhow: pull-push (Gortler et al. 1996, The Lumigraph, §3.6), on one surface at a
//! time.
//!
//! Cells of 2 × 2 pixels, 4 × 4 and so on hold the mean of the samples in them and how many there are (pull). From the
//! coarsest down each is then mixed with what lies around it one level up: what has [`ENOUGH`] samples shows their mean, what
//! has fewer, or none, so much of the coarser ones instead, bilinearly between the four nearest (push). So a single sample
//! fades into those around it, where a footprint of its own would have an edge.
//!
//! A cell is of one surface: one object at depths that a plane through it could have. Of several it is the one that most of
//! it shows, diffuse ones, which have no samples, aside; the others' are left to finer cells.

use std::ops::Range;

use glam::{Vec3, Vec4};
use rayon::prelude::*;

use crate::image::Map2d;

/// Samples that a cell needs to show nothing but their mean. One alone is a third its surroundings', so that it stands out
/// less and has less noise; with 1, 2 and 4 walks of table and chess were further from what their views converge to (one run
/// each).
pub const ENOUGH: f32 = 1.5;
/// Levels: the last one's cells have a side of 32 pixels, more than the spacing of any level set that is shown for long.
pub const LEVELS: usize = 5;
/// Rows of pixels in a band: as high as a cell of the last level, so that no cell lies in two. A thread takes a band through
/// all levels; each phase of all threads more would wait once more for one that another program has interrupted.
pub const BAND: usize = 1 << LEVELS;

/// An object and a depth.
type Key = (u32, f32);

/// How depths of one surface may differ.
#[derive(Clone, Copy, Debug)]
pub struct Alike {
    /// Share of the depth per pixel.
    pub slope: f32,
    /// Least and greatest share.
    pub shares: [f32; 2],
}

impl Alike {
    /// Whether both can lie on one surface, so many pixels apart.
    #[inline]
    pub fn holds(&self, a: Key, b: Key, pixels: f32) -> bool {
        let tolerance = a.1 * (self.slope * pixels).clamp(self.shares[0], self.shares[1]);
        // Also refuses NaN.
        a.0 == b.0 && (a.1 - b.1).abs() <= tolerance
    }
}

/// Pulled, the sum of a cell's samples and their number; pushed, what it shows, and 1 where that is known.
#[derive(Clone, Copy, Debug)]
struct Cell {
    key: Key,
    value: Vec4,
}

/// Rows of a level, one after the other.
#[derive(Clone, Debug)]
struct Rows {
    range: Range<usize>,
    width: usize,
    cells: Vec<Cell>,
}

impl Rows {
    #[inline]
    fn at(&self, x: usize, y: usize) -> Cell {
        self.cells[(y - self.range.start) * self.width + x]
    }
}

/// The samples of a view, pulled.
#[derive(Clone, Debug)]
pub struct PullPush {
    /// Columns and rows of each level, from the finest to the coarsest.
    sizes: [[usize; 2]; LEVELS],
    /// Of each band of pixels the rows of each level.
    bands: Vec<[Rows; LEVELS]>,
    alike: Alike,
}

/// What is shown between the samples in a band of [`BAND`] rows of pixels.
#[derive(Clone, Debug)]
pub struct Band<'a> {
    of: &'a PullPush,
    /// Pushed, from the coarsest on: of each level the band's rows, and one beside them above and below.
    levels: Vec<Rows>,
}

impl PullPush {
    /// Of a view's objects and depths; `sample` is what a pixel's own sample shows, if it has one.
    pub fn new(
        objects: &Map2d<u32>,
        depths: &Map2d<f32>,
        alike: Alike,
        sample: impl Fn(usize) -> Option<Vec3> + Sync,
    ) -> Self {
        let (width, height) = (objects.width(), objects.height());
        let (ids, depth) = (objects.data(), depths.data());
        let mut sizes = [[width, height].map(|side| side.div_ceil(2)); LEVELS];
        for n in 1..LEVELS {
            sizes[n] = sizes[n - 1].map(|side| side.div_ceil(2));
        }
        let pixel = |x: usize, y: usize| {
            let i = y * width + x;
            let value = sample(i).map_or(Vec4::ZERO, |color| color.extend(1.0));
            Cell { key: (ids[i], depth[i]), value }
        };
        let pulled = |band: usize| {
            let mut levels = [const { Rows { range: 0..0, width: 0, cells: Vec::new() } }; LEVELS];
            let rows = |n: usize| rows_of(band, n, 0, sizes[n][1]);
            levels[0] = halved([width, height], rows(0), 1, &alike, pixel);
            for n in 1..LEVELS {
                let finer = &levels[n - 1];
                // What has enough counts no more, however much that is: else a crowd would outweigh its surroundings.
                let counted = |x: usize, y: usize| {
                    let Cell { key, value } = finer.at(x, y);
                    Cell { key, value: value * (ENOUGH / value.w.max(ENOUGH)) }
                };
                levels[n] = halved(sizes[n - 1], rows(n), 1 << n, &alike, counted);
            }
            levels
        };
        Self { sizes, bands: (0..height.div_ceil(BAND)).into_par_iter().map(pulled).collect(), alike }
    }

    /// What is shown in the rows of pixels from this many times [`BAND`] on.
    ///
    /// # Panics
    /// If the picture has no such rows: a bug of the caller.
    pub fn band(&self, band: usize) -> Band<'_> {
        let mut pushed = Band { of: self, levels: Vec::with_capacity(LEVELS) };
        for n in (0..LEVELS).rev() {
            // Cells between those of a coarser level lie between its band's and one beside them, too.
            let range = rows_of(band, n, 1, self.sizes[n][1]);
            let width = self.sizes[n][0];
            let mut cells = Vec::with_capacity(range.len() * width);
            for y in range.clone() {
                let of = &self.bands[y / (BAND >> (n + 1))][n];
                cells.extend((0..width).map(|x| {
                    let Cell { key, value } = of.at(x, y);
                    // What is diffuse has no samples.
                    let shown = match key.0 {
                        0 => None,
                        _ => mixed(value, pushed.around(n + 1, [x, y], key)),
                    };
                    Cell { key, value: shown.map_or(Vec4::ZERO, |shown| shown.extend(1.0)) }
                }));
            }
            pushed.levels.push(Rows { range, width, cells });
        }
        pushed
    }
}

impl Band<'_> {
    /// What level `n` shows at the middle of a cell of the next finer level, or of a pixel, on its surface; none beyond the
    /// coarsest.
    #[inline(always)] // a call for each pixel otherwise
    fn around(&self, n: usize, [x, y]: [usize; 2], key: Key) -> Option<Vec3> {
        let level = self.levels.get((LEVELS - 1).checked_sub(n)?)?;
        // The cell's parent and those on the side that it lies to.
        let next = |v: usize, count: usize| {
            let parent = v / 2;
            let other = if v.is_multiple_of(2) { parent.checked_sub(1) } else { Some(parent + 1) };
            (parent, other.filter(|v| *v < count))
        };
        let [width, height] = self.of.sizes[n];
        let ((px, qx), (py, qy)) = (next(x, width), next(y, height));
        let pixels = (2usize << n) as f32;
        let mut sum = Vec4::ZERO;
        for (cy, wy) in [(Some(py), 0.75), (qy, 0.25)] {
            for (cx, wx) in [(Some(px), 0.75), (qx, 0.25)] {
                let (Some(cx), Some(cy)) = (cx, cy) else { continue };
                let cell = level.at(cx, cy);
                if self.of.alike.holds(key, cell.key, pixels) {
                    sum += cell.value * (wx * wy);
                }
            }
        }
        (sum.w > 0.0).then(|| sum.truncate() / sum.w)
    }

    /// What a pixel of a surface shows whose own sample, if it has one, is this; `None` where no cell around is of its surface
    /// and has samples near.
    ///
    /// # Panics
    /// If the pixel lies in another band: a bug of the caller.
    #[inline]
    pub fn pixel(&self, [x, y]: [usize; 2], key: (u32, f32), own: Option<Vec3>) -> Option<Vec3> {
        let coarse = self.around(0, [x, y], key)?;
        mixed(own.map_or(Vec4::ZERO, |own| own.extend(1.0)), Some(coarse))
    }
}

/// Rows of level `n` in a band, with so many beside them.
fn rows_of(band: usize, n: usize, beside: usize, rows: usize) -> Range<usize> {
    let height = BAND >> (n + 1);
    (band * height).saturating_sub(beside)..((band + 1) * height + beside).min(rows)
}

/// What a cell of these samples shows amid what is coarser.
#[inline]
fn mixed(samples: Vec4, coarse: Option<Vec3>) -> Option<Vec3> {
    if samples.w <= 0.0 {
        return coarse;
    }
    let mean = samples.truncate() / samples.w;
    Some(coarse.map_or(mean, |coarse| coarse.lerp(mean, (samples.w / ENOUGH).min(1.0))))
}

/// Rows of cells of 2 × 2 of what is there, whose sides are this many pixels.
fn halved(
    [width, height]: [usize; 2],
    range: Range<usize>,
    side: usize,
    alike: &Alike,
    of: impl Fn(usize, usize) -> Cell,
) -> Rows {
    let across = width.div_ceil(2);
    let mut cells = Vec::with_capacity(range.len() * across);
    for y in range.clone() {
        cells.extend((0..across).map(|x| {
            let mut children = [Cell { key: (0, f32::NAN), value: Vec4::ZERO }; 4];
            for (k, child) in children.iter_mut().enumerate() {
                let (cx, cy) = (2 * x + k % 2, 2 * y + k / 2);
                if cx < width && cy < height {
                    *child = of(cx, cy);
                }
            }
            joined(&children, alike, side as f32)
        }));
    }
    Rows { range, width: across, cells }
}

/// The surface that most of four show, and its samples. Diffuse surfaces have none.
#[inline]
fn joined(children: &[Cell; 4], alike: &Alike, side: f32) -> Cell {
    let mut best = (0, Cell { key: children[0].key, value: Vec4::ZERO });
    for &Cell { key, .. } in children.iter().filter(|child| child.key.0 != 0) {
        let mut votes = 0;
        let mut sum = Vec4::ZERO;
        for other in children {
            if alike.holds(key, other.key, side) {
                votes += 1;
                sum += other.value;
            }
        }
        if votes > best.0 {
            best = (votes, Cell { key, value: sum });
        }
        if votes == 4 {
            break;
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: usize = 90;
    const ALIKE: Alike = Alike { slope: 0.01, shares: [0.02, 0.25] };

    fn shown(
        of: impl Fn(usize, usize) -> Key,
        sample: impl Fn(usize, usize) -> Option<Vec3> + Sync,
    ) -> Map2d<Option<Vec3>> {
        let objects = Map2d::from_fn(SIZE, SIZE, |x, y| of(x, y).0);
        let depths = Map2d::from_fn(SIZE, SIZE, |x, y| of(x, y).1);
        let made = PullPush::new(&objects, &depths, ALIKE, |i| sample(i % SIZE, i / SIZE));
        let bands: Vec<Band<'_>> = (0..SIZE.div_ceil(BAND)).map(|n| made.band(n)).collect();
        Map2d::from_fn(SIZE, SIZE, |x, y| bands[y / BAND].pixel([x, y], of(x, y), sample(x, y)))
    }

    fn is_sampled(x: usize, y: usize) -> bool {
        crate::rng::hash(5, x as u64, y as u64).is_multiple_of(23)
    }

    #[test]
    fn a_constant_is_that_constant_and_a_slope_is_nearly_that_slope() {
        let all = shown(|_, _| (1, 4.0), |x, y| is_sampled(x, y).then_some(Vec3::new(0.25, 7.0, 0.0)));
        for y in 0..SIZE {
            for x in 0..SIZE {
                let found = all.at(x, y).expect("samples everywhere");
                assert!((found - Vec3::new(0.25, 7.0, 0.0)).abs().max_element() < 1e-5, "{found}");
            }
        }
        let slope = shown(|_, _| (1, 4.0), |x, y| is_sampled(x, y).then_some(Vec3::splat(x as f32)));
        let off = |x, y| slope.at(x, y).map_or(f32::NAN, |v: Vec3| v.x - x as f32);
        let inner = || (10..SIZE - 10).flat_map(|y| (10..SIZE - 10).map(move |x| (x, y)));
        let mean = inner().map(|(x, y)| off(x, y).abs()).sum::<f32>() / inner().count() as f32;
        // A sample in 23 pixels: 4.8 apart.
        assert!(mean < 1.3, "{mean}");
        assert!(inner().all(|(x, y)| off(x, y).abs() < 8.0));
    }

    /// Bands know nothing of each other: what two of them have made of the same rows must be the same.
    #[test]
    fn bands_agree_where_they_overlap() {
        let objects = Map2d::from_fn(SIZE, SIZE, |x, y| 1 + u32::from(x + y / 3 > 60));
        let depths = Map2d::from_fn(SIZE, SIZE, |_, y| 2.0 + 0.01 * y as f32);
        let color = |i: usize| Vec3::new((i % 7) as f32, (i % 11) as f32, (i % 13) as f32);
        let sample = |i: usize| is_sampled(i % SIZE, i / SIZE).then(|| color(i));
        let made = PullPush::new(&objects, &depths, ALIKE, sample);
        let bands: Vec<Band<'_>> = (0..SIZE.div_ceil(BAND)).map(|n| made.band(n)).collect();
        let mut shared = 0;
        for pair in bands.windows(2) {
            for (above, below) in pair[0].levels.iter().zip(&pair[1].levels) {
                for y in below.range.start..above.range.end {
                    for x in 0..above.width {
                        let (a, b) = (above.at(x, y), below.at(x, y));
                        assert_eq!((a.key, a.value), (b.key, b.value), "{x}, {y}");
                        shared += usize::from(a.value.w > 0.0);
                    }
                }
            }
        }
        // Two rows of each level, where there are as many.
        assert!(shared > 200, "{shared}");
    }

    #[test]
    fn no_other_surface_is_read() {
        // Two objects, one of them at two depths.
        let of =
            |x: usize, y: usize| if x + y / 3 > 60 { (2, 4.0) } else { (1, if y > 40 { 4.0 } else { 2.0 }) };
        let tint = |x, y| Vec3::new(of(x, y).0 as f32, of(x, y).1, 0.5);
        let all = shown(of, |x, y| is_sampled(x, y).then(|| tint(x, y)));
        for y in 0..SIZE {
            for x in 0..SIZE {
                let Some(found) = all.at(x, y) else { continue };
                assert!((found - tint(x, y)).abs().max_element() < 1e-5, "{found} at {x}, {y}");
            }
        }
        assert!(all.data().iter().filter(|v| v.is_none()).count() < SIZE * SIZE / 200);
    }

    #[test]
    fn a_sample_fades_and_none_shows_nothing() {
        let one = |x, y| (x == 40 && y == 40).then_some(Vec3::ONE);
        let few =
            shown(|_, _| (1, 4.0), |x, y| one(x, y).or((x % 16 == 8 && y % 16 == 8).then_some(Vec3::ZERO)));
        let at = |x: usize| few.at(x, 40).map_or(f32::NAN, |v| v.x);
        assert!(
            at(40) > 0.5 && at(41) < at(40) && at(44) < at(42) && at(50) < 0.3,
            "{:?}",
            [40, 42, 44, 50].map(at)
        );
        let step = (20..60).map(|x| (at(x + 1) - at(x)).abs()).fold(0.0f32, f32::max);
        assert!(step <= 0.51, "{step}");
        let none = shown(|_, _| (1, 4.0), |_, _| None);
        assert!(none.data().iter().all(Option::is_none));
        let far = shown(|_, _| (1, 4.0), one);
        assert_eq!(far.at(60, 40), Some(Vec3::ONE));
    }

    #[test]
    fn pixels_without_depth_and_pictures_of_one_pixel_are_no_matter() {
        let all =
            shown(|x, _| (1, if x % 3 == 0 { f32::NAN } else { f32::INFINITY }), |_, _| Some(Vec3::ONE));
        assert!(all.data().iter().all(|v| v.is_none_or(|v| v == Vec3::ONE)));
        for size in [[1, 1], [2, 1], [1, 3]] {
            let objects = Map2d::new(size[0], size[1], 1);
            let depths = Map2d::new(size[0], size[1], 2.0);
            let made = PullPush::new(&objects, &depths, ALIKE, |i| (i == 0).then_some(Vec3::X));
            let last = [size[0] - 1, size[1] - 1];
            assert_eq!(made.band(0).pixel(last, (1, 2.0), None), Some(Vec3::X));
        }
        let none = PullPush::new(&Map2d::new(0, 0, 0), &Map2d::new(0, 0, 0.0), ALIKE, |_| None);
        assert!(none.bands.is_empty());
    }
}
