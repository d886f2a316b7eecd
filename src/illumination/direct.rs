//! Direct light at an element: running sums of samples.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::image::luminance;
use crate::rng::hash;
use crate::transport::particle::Arriving;

/// Samples per round of a bake, stratified among themselves.
pub const SAMPLES_PER_ROUND: u32 = 8;

/// Independent sequences that rounds belong to in turn: each goes on where it ended, so that many rounds are stratified
/// as a whole, and their spread tells the error.
const SEQUENCES: usize = 4;

/// Three numbers in [0, 1) for sample `s` of an Owen-scrambled Sobol sequence, scrambled anew for every element.
fn stratified(s: u32, scramble: u32) -> [f32; 3] {
    let [a, b, c, _] = sobol_burley::sample_4d(s, 0, scramble);
    [a, b, c]
}

/// Samples of a first look.
const PROBES: u32 = 2;

/// Whether any of a few samples finds light.
pub fn probe<E: Into<Arriving>>(key: u64, mut sample: impl FnMut([f32; 3]) -> E) -> bool {
    let scramble = hash(key, 0, 0xd1ec8) as u32;
    (0..PROBES).any(|s| sample(stratified(s, scramble)).into().irradiance.max_element() > 0.0)
}

/// Sums of the samples of one side of an element.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DirectBin {
    /// Irradiance from lights that no chance is needed for.
    certain: [f32; 3],
    sum: [f32; 3],
    /// The part of it that the sky and suns bring.
    from_afar: [f32; 3],
    /// Of the luminance of the means of the rounds of each sequence.
    sequences: [f32; SEQUENCES],
    /// Of the luminance of samples.
    squared_samples: f32,
    rounds: u32,
    samples: u32,
}

impl DirectBin {
    /// Adds a round of `samples`; `sample` gives the irradiance for three random numbers. `key` identifies the
    /// side of the element and the seed.
    pub fn gather<E: Into<Arriving>>(
        &mut self,
        key: u64,
        samples: u32,
        mut sample: impl FnMut([f32; 3]) -> E,
    ) {
        let sequence = self.rounds as usize % SEQUENCES;
        let scramble = hash(key, sequence as u64, 0xd1ec7) as u32;
        let first = self.rounds / SEQUENCES as u32 * samples;
        let (mut sum, mut from_afar) = (Vec3::ZERO, Vec3::ZERO);
        for s in first..first + samples {
            let value = sample(stratified(s, scramble)).into();
            sum += value.irradiance;
            if value.from_afar {
                from_afar += value.irradiance;
            }
            self.squared_samples += luminance(value.irradiance).powi(2);
        }
        let mean = sum / samples.max(1) as f32;
        self.samples += samples;
        self.sum = (Vec3::from_array(self.sum) + mean).to_array();
        self.from_afar = (Vec3::from_array(self.from_afar) + from_afar / samples.max(1) as f32).to_array();
        self.sequences[sequence] += luminance(mean);
        self.rounds += 1;
    }

    /// Irradiance from lights that no chance is needed for.
    pub fn certain(&self) -> Vec3 {
        Vec3::from_array(self.certain)
    }

    /// Sets the irradiance from lights that no chance is needed for.
    pub fn set_certain(&mut self, irradiance: Vec3) {
        self.certain = irradiance.to_array();
    }

    /// Mean of what samples found of the sky and of suns.
    pub fn sampled_from_afar(&self) -> Vec3 {
        Vec3::from_array(self.from_afar) / self.rounds.max(1) as f32
    }

    /// Whether any sample found light.
    pub fn has_found_light(&self) -> bool {
        self.squared_samples > 0.0
    }

    /// Whether there is any light.
    pub fn is_lit(&self) -> bool {
        self.has_found_light() || self.certain != [0.0; 3]
    }

    /// Mean irradiance and the variance of its luminance.
    pub fn mean(&self) -> (Vec3, f32) {
        let (sampled, variance) = self.sampled();
        (sampled + self.certain(), variance)
    }

    /// The same without the lights that no chance is needed for.
    pub fn sampled(&self) -> (Vec3, f32) {
        if self.rounds == 0 {
            return (Vec3::ZERO, 0.0);
        }
        let n = self.rounds as f32;
        let mean = Vec3::from_array(self.sum) / n;
        let squared = luminance(mean).powi(2);
        // Few rounds cannot tell their spread: the spread of samples is an upper bound, as if they were not
        // stratified.
        let variance = if self.rounds < SEQUENCES as u32 {
            let samples = self.samples as f32;
            (self.squared_samples / samples - squared) / (samples - 1.0).max(0.5)
        } else {
            let of = |(i, sum): (usize, &f32)| sum / (self.rounds as usize - i).div_ceil(SEQUENCES) as f32;
            let deviation = self.sequences.iter().enumerate().map(|s| (of(s) - luminance(mean)).powi(2));
            deviation.sum::<f32>() / (SEQUENCES * (SEQUENCES - 1)) as f32
        };
        (mean, variance.max(0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_and_variance_of_uniform_samples() {
        assert_eq!(DirectBin::default().mean(), (Vec3::ZERO, 0.0));
        let independent = |s: u64| Vec3::splat(crate::rng::Stream::new(1, s, 0).next_f32());
        let (mut s, mut claimed) = (0, 0.0);
        for _ in 0..200 {
            let mut bin = DirectBin::default();
            for _ in 0..50 {
                bin.gather(7, 8, |_| {
                    s += 1;
                    independent(s)
                });
            }
            let (mean, variance) = bin.mean();
            assert!((mean.x - 0.5).abs() < 0.08 && bin.is_lit());
            claimed += variance / 200.0;
        }
        assert!((claimed * 400.0 * 12.0 - 1.0).abs() < 0.2, "{claimed}");
    }

    #[test]
    fn many_rounds_are_stratified_as_a_whole() {
        let hidden = |[_, u, v]: [f32; 3]| Vec3::splat(if u + 0.6 * v < 0.8 { 1.0 } else { 0.0 });
        let (mut error, mut claimed) = (0.0f32, 0.0f32);
        for key in 0..200 {
            let mut bin = DirectBin::default();
            for _ in 0..32 {
                bin.gather(key, 8, hidden);
            }
            let (mean, variance) = bin.mean();
            error += (mean.x - 0.5).powi(2) / 200.0;
            claimed += variance / 200.0;
        }
        // 32 independent rounds would have an eighth of the error of four, less than 0.4 of the random one.
        let independent = 0.4 * 0.25 / 256.0;
        assert!(error < 0.5 * independent, "{error} {independent}");
        assert!((0.7..1.4).contains(&(claimed / error)), "{claimed} {error}");
    }

    #[test]
    fn stratified_rounds_are_better_than_random_ones_and_know_it() {
        // A penumbra: half of the light hidden by a slanted edge.
        let hidden = |[_, u, v]: [f32; 3]| Vec3::splat(if u + 0.6 * v < 0.8 { 1.0 } else { 0.0 });
        let (mut error, mut claimed) = (0.0f32, 0.0f32);
        let trials = 400;
        for key in 0..trials {
            let mut bin = DirectBin::default();
            for _ in 0..4 {
                bin.gather(key, 8, hidden);
            }
            let (mean, variance) = bin.mean();
            error += (mean.x - 0.5).powi(2) / trials as f32;
            claimed += variance / trials as f32;
        }
        let random = 0.25 / 32.0;
        assert!(error < 0.4 * random, "{error} {random}");
        assert!((0.75..1.35).contains(&(claimed / error)), "{claimed} {error}");
    }
}
