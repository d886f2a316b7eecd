//! Half of a picture: each texel is the mean of the area that it covers, in linear light.
//!
//! In: the texels of a level, columns and rows. Out: those of the next coarser one, in the same encoding. Where sides are
//! even, four texels make one on a short way, with the same bits as shares of texels sum up to.

use rayon::prelude::*;

use super::texels::Decode;
use crate::image::SrgbSteps;

/// Fewer rows of a level are not worth another thread.
const ROWS_AT_ONCE: usize = 32;

/// Makes the `to` columns and rows of a level from the level with `from`, where `look` reads a texel, linear, and `encode`
/// stores one. Rows are made in parallel.
pub(super) fn halved<T: Copy + Default + Send + Sync>(
    from: [u32; 2],
    to: [u32; 2],
    look: impl Fn(usize) -> [f32; 4] + Sync,
    encode: impl Fn([f32; 4]) -> T + Sync,
) -> Vec<T> {
    let ([w, h], width) = (to, from[0] as usize);
    if from == to.map(|n| 2 * n) {
        return rows(to, |y, row| {
            for (x, texel) in row.iter_mut().enumerate() {
                let at = 2 * y * width + 2 * x;
                let [a, b, c, d] = [look(at), look(at + 1), look(at + width), look(at + width + 1)];
                *texel =
                    encode(std::array::from_fn(|i| 0.25 * a[i] + 0.25 * b[i] + 0.25 * c[i] + 0.25 * d[i]));
            }
        });
    }
    let columns: Vec<_> = (0..w).map(|x| covered(x, w, from[0])).collect();
    rows(to, |y, row| {
        let (y0, row_weights) = covered(y as u32, h, from[1]);
        for ((x0, column_weights), texel) in columns.iter().zip(row) {
            let mut sum = [0.0f32; 4];
            for (dy, wy) in row_weights.iter().enumerate().filter(|(_, w)| **w > 0.0) {
                let row = (y0 + dy) * width;
                for (dx, wx) in column_weights.iter().enumerate().filter(|(_, w)| **w > 0.0) {
                    let t = look(row + x0 + dx);
                    for c in 0..4 {
                        sum[c] += wy * wx * t[c];
                    }
                }
            }
            *texel = encode(sum);
        }
    })
}

/// [`halved`] of bytes.
pub(super) fn halved_bytes(
    from: [u32; 2],
    to: [u32; 2],
    texels: &[[u8; 4]],
    decode: &Decode,
) -> Vec<[u8; 4]> {
    if decode.gamma {
        let steps = SrgbSteps::shared();
        halved_by(from, to, texels, decode, |v| steps.byte(v))
    } else {
        halved_by(from, to, texels, decode, byte)
    }
}

#[inline]
fn byte(v: f32) -> u8 {
    (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

/// [`halved_bytes`] where `color` makes bytes of what is linear.
fn halved_by(
    from: [u32; 2],
    to: [u32; 2],
    texels: &[[u8; 4]],
    decode: &Decode,
    color: impl Fn(f32) -> u8 + Sync,
) -> Vec<[u8; 4]> {
    if from != to.map(|n| 2 * n) {
        let encode = |[r, g, b, a]: [f32; 4]| [color(r), color(g), color(b), byte(a)];
        return halved(from, to, |at| decode.linear(texels[at]), encode);
    }
    // A quarter of a number is exact, so tables can hold quarters.
    let quarters = decode.color.map(|v| 0.25 * v);
    let alphas: [f32; 256] = std::array::from_fn(|a| 0.25 * decode.linear([0, 0, 0, a as u8])[3]);
    let width = from[0] as usize;
    rows(to, |y, row| {
        let (above, below) = texels[2 * y * width..2 * (y + 1) * width].split_at(width);
        let pairs = above.as_chunks::<2>().0.iter().zip(below.as_chunks::<2>().0);
        for (texel, (&[a, b], &[c, d])) in row.iter_mut().zip(pairs) {
            let sum = |table: &[f32; 256], i: usize| {
                let quarter = |t: [u8; 4]| table[usize::from(t[i])];
                quarter(a) + quarter(b) + quarter(c) + quarter(d)
            };
            let [red, green, blue] = [0, 1, 2].map(|i| color(sum(&quarters, i)));
            // Most pictures have no alpha.
            let is_opaque = a[3] & b[3] & c[3] & d[3] == 255;
            *texel = [red, green, blue, if is_opaque { 255 } else { byte(sum(&alphas, 3)) }];
        }
    })
}

/// Texels of so many columns and rows, by row and its number.
fn rows<T: Copy + Default + Send>([w, h]: [u32; 2], make: impl Fn(usize, &mut [T]) + Sync) -> Vec<T> {
    let mut out = vec![T::default(); w as usize * h as usize];
    let all = out.par_chunks_mut(w as usize).enumerate().with_min_len(ROWS_AT_ONCE);
    all.for_each(|(y, row)| make(y, row));
    out
}

/// The first of `from` texels that texel `i` of `to` covers, and the shares of it and of the next two.
fn covered(i: u32, to: u32, from: u32) -> (usize, [f32; 3]) {
    // In units of 1 / to of a texel, so that whole numbers suffice.
    let (start, end) = (u64::from(i) * u64::from(from), u64::from(i + 1) * u64::from(from));
    let to = u64::from(to);
    let first = start / to;
    let share = |k: u64| {
        let (a, b) = ((first + k) * to, (first + k + 1) * to);
        b.min(end).saturating_sub(a.max(start)) as f32 / u64::from(from) as f32
    };
    (first as usize, [share(0), share(1), share(2)])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is halved on either short way has the bits of what shares of texels sum up to.
    #[test]
    fn halves_of_even_sides_are_sums_of_shares() {
        let (from, to) = ([16, 8], [8, 4]);
        let texels: Vec<[u8; 4]> = (0..16 * 8)
            .map(|i| crate::rng::hash(3, i, 0).to_le_bytes())
            .map(|b| [b[0], b[1], b[2], b[3]])
            .collect();
        for gamma in [true, false] {
            let decode = Decode::shared(gamma);
            let look = |at: usize| decode.linear(texels[at]);
            let shares = |x: u32, y: u32| {
                let ((x0, columns), (y0, rows)) = (covered(x, to[0], from[0]), covered(y, to[1], from[1]));
                let mut sum = [0.0; 4];
                for (dy, dx) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                    let t = look((y0 + dy) * 16 + x0 + dx);
                    (0..4).for_each(|c| sum[c] += rows[dy] * columns[dx] * t[c]);
                }
                sum
            };
            let sums: Vec<[f32; 4]> = (0..32).map(|i| shares(i % 8, i / 8)).collect();
            assert_eq!(halved(from, to, look, |v| v), sums);
            let color = |v: f32| if gamma { crate::image::srgb_byte_from_linear(v) } else { byte(v) };
            let stored: Vec<[u8; 4]> =
                sums.iter().map(|&[r, g, b, a]| [color(r), color(g), color(b), byte(a)]).collect();
            assert_eq!(halved_bytes(from, to, &texels, decode), stored);
        }
    }
}
