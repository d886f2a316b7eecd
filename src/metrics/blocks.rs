//! Errors of block means: over a block noise averages out, and what is wrong stays.
//!
//! At one block size noise and bias look alike; over several sizes they part, since the mean of n² pixels has a
//! deviation n times smaller, while bias stays as it is.

use glam::Vec3;

use super::quantile;
use crate::image::{Map2d, luminance};

/// Share of the median that is added to each denominator, so that black blocks do not decide the mean.
pub(super) const FLOOR: f64 = 0.05;
/// Relative error above which a block counts as off.
const OFF: f64 = 0.1;

/// Errors of the mean luminances of square blocks, relative to the reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockErrors {
    /// Pixels along an edge of a block.
    pub size: usize,
    /// Blocks; those that the picture's right and lower edges cut are left out.
    pub count: usize,
    /// Mean of |test − reference| / (reference + 5 % of the reference's median).
    pub mean: f64,
    /// Share of blocks where that is above 10 %.
    pub over_10_percent: f64,
    /// Σ test / Σ reference − 1: what no block size averages out. 0 where both are black.
    pub bias: f64,
}

/// Errors over blocks of `size` × `size` pixels; `None` where not one fits. Values that are NaN or infinite count as
/// black, as they are shown.
///
/// # Panics
/// If the pictures differ in size, or `size` is 0.
pub fn block_errors(test: &Map2d<Vec3>, reference: &Map2d<Vec3>, size: usize) -> Option<BlockErrors> {
    assert!((test.width(), test.height()) == (reference.width(), reference.height()), "pictures of one size");
    let (test, reference) = (block_means(test, size), block_means(reference, size));
    if reference.is_empty() {
        return None;
    }
    let median = quantile(reference.iter().copied(), 0.5);
    let error = |(t, r): (&f64, &f64)| {
        let (difference, scale) = ((t - r).abs(), r + FLOOR * median);
        // Beside black anything is wholly wrong, and black is right.
        if scale > 0.0 { difference / scale } else { f64::from(u8::from(difference > 0.0)) }
    };
    let errors: Vec<f64> = test.iter().zip(&reference).map(error).collect();
    let (count, total) = (errors.len() as f64, reference.iter().sum::<f64>());
    Some(BlockErrors {
        size,
        count: errors.len(),
        mean: errors.iter().sum::<f64>() / count,
        over_10_percent: errors.iter().filter(|e| **e > OFF).count() as f64 / count,
        bias: if total > 0.0 { test.iter().sum::<f64>() / total - 1.0 } else { 0.0 },
    })
}

/// Mean luminance of each whole block, row by row.
pub(super) fn block_means(picture: &Map2d<Vec3>, size: usize) -> Vec<f64> {
    let finite = |v: f32| if v.is_finite() { f64::from(v) } else { 0.0 };
    let mean = |x0: usize, y0: usize| {
        let pixels = (y0..y0 + size).flat_map(|y| (x0..x0 + size).map(move |x| (x, y)));
        pixels.map(|(x, y)| finite(luminance(picture.at(x, y)))).sum::<f64>() / (size * size) as f64
    };
    let (columns, rows) = (picture.width() / size, picture.height() / size);
    (0..rows).flat_map(|j| (0..columns).map(move |i| (i * size, j * size))).map(|(x, y)| mean(x, y)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Stream;

    /// Noise of deviation 1 falls with the block's side; a bias of 2 % stays.
    #[test]
    fn noise_and_bias_part_over_the_sizes() {
        let reference = Map2d::new(256, 256, Vec3::ONE);
        let noisy = |bias: f32| {
            let mut stream = Stream::new(1, 2, 3);
            Map2d::from_fn(256, 256, |_, _| Vec3::splat(bias + (12f32).sqrt() * (stream.next_f32() - 0.5)))
        };
        let at = |picture: &Map2d<Vec3>, size| block_errors(picture, &reference, size).expect("blocks").mean;
        let plain = noisy(1.0);
        for size in [4, 8, 16] {
            // The mean of |x| of a normal deviation σ is σ √(2/π).
            let expected = (2.0 / std::f64::consts::PI).sqrt() / size as f64 / (1.0 + FLOOR);
            assert!((at(&plain, size) / expected - 1.0).abs() < 0.15, "{size}: {}", at(&plain, size));
        }
        let biased = noisy(1.02);
        let errors = block_errors(&biased, &reference, 64).expect("blocks");
        assert!((errors.bias - 0.02).abs() < 0.01 && (errors.mean - 0.019).abs() < 0.012, "{errors:?}");
        assert_eq!((errors.count, errors.over_10_percent), (16, 0.0));
    }

    #[test]
    fn edges_are_left_out_and_what_is_no_number_is_black() {
        let reference = Map2d::new(20, 9, Vec3::ONE);
        let broken = Map2d::from_fn(20, 9, |x, _| Vec3::splat(if x < 8 { f32::NAN } else { 1.0 }));
        let errors = block_errors(&broken, &reference, 8).expect("blocks");
        assert_eq!((errors.count, errors.over_10_percent), (2, 0.5));
        assert!((errors.bias + 0.5).abs() < 1e-12);
        assert_eq!(block_errors(&broken, &reference, 10), None);
        let black = Map2d::new(8, 8, Vec3::ZERO);
        let errors = block_errors(&black, &black, 8).expect("a block");
        assert_eq!((errors.mean, errors.bias), (0.0, 0.0));
        assert_eq!(block_errors(&Map2d::new(8, 8, Vec3::ONE), &black, 8).expect("a block").mean, 1.0);
    }
}
