//! Image error metrics.
//!
//! In: two pictures of linear radiance and how they are shown. Out: numbers, error maps, curves over time.
//! Perceptual measures and PSNR look at what is displayed, relative measures at linear values.

pub mod batches;
pub mod blocks;
pub mod curve;
pub mod flip;
pub mod heat;
pub mod pixels;
pub mod video;

use std::fmt;

use glam::Vec3;
use rayon::prelude::*;

use crate::display::tone::ToneMap;
use crate::image::Map2d;
use crate::perception::color_difference::{delta_e76, lab};

pub use batches::{Agreement, BATCHES, BatchSums, Batches};
pub use blocks::{BlockErrors, block_errors};
pub use curve::ErrorCurve;
pub use pixels::LinearErrors;

/// The value that a share of the finite `values` lies below, between neighbours in proportion (Hyndman & Fan 1996,
/// type 7): 0.5 gives the median. NaN where there are none.
pub fn quantile(values: impl IntoIterator<Item = f64>, share: f64) -> f64 {
    let mut sorted: Vec<f64> = values.into_iter().filter(|v| v.is_finite()).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    let place = share.clamp(0.0, 1.0) * last as f64;
    let (below, above) = (sorted[place as usize], sorted[(place as usize + 1).min(last)]);
    below + (above - below) * place.fract()
}

/// How a picture differs from a reference (`foveal compare`).
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// Mean LDR-FLIP of what is displayed, in [0, 1].
    pub flip: f64,
    /// Per-pixel LDR-FLIP; [`heat::heat_map`] colours it.
    pub flip_map: Map2d<f32>,
    /// Peak signal-to-noise ratio of display-referred values, dB; none where they are equal.
    pub psnr: Option<f64>,
    /// Mean squared error of display-referred values.
    pub mse: f64,
    /// Mean ΔE*76 of what is displayed.
    pub delta_e: f64,
    /// Measures of linear values.
    pub linear: LinearErrors,
    /// Whether every value is the same to the last bit.
    pub identical: bool,
}

/// Two pictures that cannot be compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SizesDiffer {
    /// Width and height of the picture under test.
    pub test: [usize; 2],
    /// Width and height of the reference.
    pub reference: [usize; 2],
}

impl fmt::Display for SizesDiffer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ([w, h], [rw, rh]) = (self.test, self.reference);
        write!(f, "a picture of {w} × {h} pixels cannot be compared with one of {rw} × {rh}")
    }
}

impl std::error::Error for SizesDiffer {}

/// Compares two pictures of linear radiance as `tone` shows them.
pub fn compare(
    test: &Map2d<Vec3>,
    reference: &Map2d<Vec3>,
    tone: &ToneMap,
) -> Result<Comparison, SizesDiffer> {
    let sizes = [[test.width(), test.height()], [reference.width(), reference.height()]];
    if sizes[0] != sizes[1] {
        return Err(SizesDiffer { test: sizes[0], reference: sizes[1] });
    }
    let shown = |image: &Map2d<Vec3>| {
        let pixels: Vec<Vec3> = image.data().par_iter().map(|&rgb| tone.to_display(rgb)).collect();
        Map2d::from_vec(image.width(), image.height(), pixels)
    };
    let bits = |v: &Vec3| v.to_array().map(f32::to_bits);
    let flip_map = flip::flip(reference, test, tone);
    let mse = pixels::mse(&shown(test), &shown(reference));
    let differences: Vec<f32> = test
        .data()
        .par_iter()
        .zip(reference.data())
        .map(|(&a, &b)| delta_e76(lab(tone.to_linear(a)), lab(tone.to_linear(b))))
        .collect();
    let count = differences.len().max(1) as f64;
    Ok(Comparison {
        flip: flip::mean(&flip_map),
        flip_map,
        psnr: pixels::psnr(mse),
        mse,
        delta_e: differences.iter().map(|&v| f64::from(v)).sum::<f64>() / count,
        linear: pixels::linear_errors(test, reference),
        identical: test.data().iter().map(bits).eq(reference.data().iter().map(bits)),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_lie_between_the_values() {
        let of = |values: &[f64], share| quantile(values.iter().copied(), share);
        assert!(of(&[], 0.5).is_nan() && of(&[f64::NAN], 0.5).is_nan());
        assert_eq!([of(&[3.0], 0.0), of(&[3.0], 0.99), of(&[4.0, 1.0], 0.5)], [3.0, 3.0, 2.5]);
        let hundred: Vec<f64> = (0..=100).rev().map(f64::from).chain([f64::INFINITY]).collect();
        assert_eq!([0.0, 0.5, 0.95, 0.999, 1.0].map(|q| of(&hundred, q)), [0.0, 50.0, 95.0, 99.9, 100.0]);
    }

    #[test]
    fn a_picture_is_identical_to_itself() {
        let image = Map2d::from_fn(20, 10, |x, y| Vec3::new(x as f32 / 10.0, y as f32 / 10.0, f32::NAN));
        let same = compare(&image, &image, &ToneMap::default()).unwrap();
        assert!(same.identical);
        assert_eq!((same.flip, same.psnr, same.mse, same.delta_e), (0.0, None, 0.0, 0.0));
        assert_eq!(same.linear.not_finite, 200);
    }

    #[test]
    fn a_bright_difference_above_white_is_seen_by_linear_measures_alone() {
        let (a, b) = (Map2d::new(8, 8, Vec3::splat(3.0)), Map2d::new(8, 8, Vec3::splat(2.0)));
        let c = compare(&a, &b, &ToneMap::default()).unwrap();
        assert!(!c.identical);
        assert_eq!((c.flip, c.psnr, c.delta_e), (0.0, None, 0.0));
        assert!((c.linear.relmse - 1.0 / 4.01).abs() < 1e-6);
        let darker = ToneMap { exposure: 0.25, ..ToneMap::default() };
        let c = compare(&a, &b, &darker).unwrap();
        assert!(c.flip > 0.1 && c.delta_e > 5.0 && c.psnr.is_some_and(|psnr| psnr < 25.0));
    }

    #[test]
    fn sizes_must_agree() {
        let error = compare(&Map2d::new(2, 3, Vec3::ONE), &Map2d::new(3, 2, Vec3::ONE), &ToneMap::default());
        let message = error.unwrap_err().to_string();
        assert!(message.contains("2 × 3") && message.contains("3 × 2"));
    }
}
