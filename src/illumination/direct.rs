//! Direct light at an element: running sums of samples.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::image::luminance;

/// Samples in the first round; every later round has as many.
pub const SAMPLES_PER_ROUND: u64 = 8;

/// Sums of the samples of one side of an element.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DirectBin {
    sum: [f32; 3],
    square: f32,
    samples: u32,
}

impl DirectBin {
    /// Adds a round of samples; `sample` gives the irradiance seen by the sample of that index.
    pub fn gather(&mut self, round: u32, mut sample: impl FnMut(u64) -> Vec3) {
        let first = u64::from(round) * SAMPLES_PER_ROUND;
        let (mut sum, mut square) = (Vec3::ZERO, 0.0);
        for s in first..first + SAMPLES_PER_ROUND {
            let value = sample(s);
            sum += value;
            square += luminance(value).powi(2);
        }
        self.sum = (Vec3::from_array(self.sum) + sum).to_array();
        self.square += square;
        self.samples += SAMPLES_PER_ROUND as u32;
    }

    /// Whether any sample found light.
    pub fn is_lit(&self) -> bool {
        self.square > 0.0
    }

    /// Mean irradiance and the variance of its luminance.
    pub fn mean(&self) -> (Vec3, f32) {
        if self.samples == 0 {
            return (Vec3::ZERO, 0.0);
        }
        let n = self.samples as f32;
        let mean = Vec3::from_array(self.sum) / n;
        let variance = (self.square / n - luminance(mean).powi(2)).max(0.0) / (n - 1.0).max(1.0);
        (mean, variance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_and_variance_of_uniform_samples() {
        let mut bin = DirectBin::default();
        assert_eq!(bin.mean(), (Vec3::ZERO, 0.0));
        for round in 0..500 {
            bin.gather(round, |s| Vec3::splat(crate::rng::Stream::new(1, s, 0).next_f32()));
        }
        let (mean, variance) = bin.mean();
        assert!((mean.x - 0.5).abs() < 0.02 && bin.is_lit());
        assert!((variance * 4000.0 * 12.0 - 1.0).abs() < 0.06, "{variance}");
    }
}
