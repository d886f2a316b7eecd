//! Error measures that look at one pixel at a time (REFERENCE §12.3).
//!
//! Relative measures are taken per channel on linear values, then averaged. Pixels with a channel that is
//! not finite in either picture are counted and left out. Sums run in f64 in index order.

use glam::Vec3;

use crate::image::Map2d;
use crate::math;

/// Measures of linear values.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LinearErrors {
    /// Mean of (x − r)² / (r² + 0.01): relMSE as in papers.
    pub relmse: f64,
    /// The same without the worst 0.1 % of the pixels: what is left without fireflies.
    pub relmse_trimmed: f64,
    /// The same, median over pixels.
    pub relmse_median: f64,
    /// Mean of (x − r)² / (r + 0.01)²: MRSE of pbrt-v4's imgtool.
    pub mrse: f64,
    /// Mean of 2 |x − r| / (|x| + |r| + 0.01), in [0, 2].
    pub smape: f64,
    /// Largest |x − r|.
    pub max_abs: f64,
    /// Pixels with a channel that is not finite, in either picture; not part of the above.
    pub not_finite: u64,
}

fn per_channel(test: Vec3, reference: Vec3, f: impl Fn(f64, f64) -> f64) -> f64 {
    let (x, r) = (test.as_dvec3(), reference.as_dvec3());
    (f(x.x, r.x) + f(x.y, r.y) + f(x.z, r.z)) / 3.0
}

fn relative_squared(x: f64, r: f64) -> f64 {
    (x - r) * (x - r) / (r * r + 0.01)
}

/// Compares linear values.
///
/// # Panics
/// If the sizes differ: a bug of the caller.
pub fn linear_errors(test: &Map2d<Vec3>, reference: &Map2d<Vec3>) -> LinearErrors {
    assert_eq!(
        (test.width(), test.height()),
        (reference.width(), reference.height()),
        "pictures of one size"
    );
    let mut errors = LinearErrors::default();
    let mut relative = Vec::with_capacity(test.data().len());
    for (&x, &r) in test.data().iter().zip(reference.data()) {
        if !(x.is_finite() && r.is_finite()) {
            errors.not_finite += 1;
            continue;
        }
        relative.push(per_channel(x, r, relative_squared));
        errors.mrse += per_channel(x, r, |x, r| ((x - r) / (r + 0.01)).powi(2));
        errors.smape += per_channel(x, r, |x, r| 2.0 * (x - r).abs() / (x.abs() + r.abs() + 0.01));
        errors.max_abs = errors.max_abs.max(f64::from((x - r).abs().max_element()));
    }
    let n = relative.len();
    if n == 0 {
        return errors;
    }
    errors.relmse = relative.iter().sum::<f64>() / n as f64;
    errors.mrse /= n as f64;
    errors.smape /= n as f64;
    relative.sort_unstable_by(f64::total_cmp);
    errors.relmse_median = super::quantile(relative.iter().copied(), 0.5);
    let kept = n - n / 1000;
    errors.relmse_trimmed = relative[..kept].iter().sum::<f64>() / kept as f64;
    errors
}

/// Mean squared error over all channels of display-referred values.
///
/// # Panics
/// If the sizes differ: a bug of the caller.
pub fn mse(test: &Map2d<Vec3>, reference: &Map2d<Vec3>) -> f64 {
    assert_eq!(test.data().len(), reference.data().len(), "pictures of one size");
    let sum: f64 =
        test.data().iter().zip(reference.data()).map(|(&x, &r)| f64::from((x - r).length_squared())).sum();
    sum / (3 * test.data().len()).max(1) as f64
}

/// Peak signal-to-noise ratio, dB, of values in [0, 1]; none where there is no error.
pub fn psnr(mse: f64) -> Option<f64> {
    (mse > 0.0).then(|| -10.0 * math::log10(mse))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(value: f64, expected: f64) {
        assert!((value - expected).abs() < 1e-5 * expected.max(1.0), "{value} instead of {expected}");
    }

    #[test]
    fn numbers_of_the_reference() {
        let xs = [0.01, 0.02, 1.1, 30.0];
        let rs = [0.0, 0.01, 1.0, 10.0];
        let mrse = [1.0, 0.25, 0.009_802_96, 3.992_012];
        let relmse = [0.01, 0.009_900_99, 0.009_900_99, 3.999_600_04];
        let smape = [1.0, 0.5, 0.094_786_73, 0.999_750_06];
        for i in 0..4 {
            let (x, r) = (Map2d::new(1, 1, Vec3::splat(xs[i])), Map2d::new(1, 1, Vec3::splat(rs[i])));
            let e = linear_errors(&x, &r);
            near(e.mrse, mrse[i]);
            near(e.relmse, relmse[i]);
            near(e.smape, smape[i]);
            near(e.max_abs, f64::from(xs[i] - rs[i]));
        }
    }

    #[test]
    fn fireflies_and_missing_numbers() {
        let reference = Map2d::new(100, 20, Vec3::ONE);
        let test = Map2d::from_fn(100, 20, |x, y| match (x, y) {
            (5, 5) | (6, 6) => Vec3::splat(1000.0),
            (7, 7) => Vec3::new(1.0, f32::NAN, 1.0),
            (8, 8) => Vec3::splat(f32::INFINITY),
            _ => Vec3::splat(1.1),
        });
        let e = linear_errors(&test, &reference);
        assert_eq!(e.not_finite, 2);
        near(e.relmse_median, 0.01 / 1.01);
        // 1998 pixels: one of the two fireflies is dropped.
        assert!(e.relmse > 900.0 && e.relmse_trimmed < 0.6 * e.relmse);
        assert_eq!(
            linear_errors(&Map2d::new(0, 0, Vec3::ONE), &Map2d::new(0, 0, Vec3::ONE)),
            LinearErrors::default()
        );
    }

    #[test]
    fn psnr_of_a_known_error() {
        let (a, b) = (Map2d::new(3, 2, Vec3::splat(0.5)), Map2d::new(3, 2, Vec3::splat(0.6)));
        near(mse(&a, &b), 0.01);
        near(psnr(mse(&a, &b)).unwrap(), 20.0);
        assert_eq!(psnr(mse(&a, &a)), None);
    }
}
