//! Sums over the samples of a tile's pixels, in independent batches, with bright samples cut.
//!
//! Sample i of a pixel's half is cut at `κ s √i`, s the root mean square of all that the tile's pixels had in that half
//! so far. A lone bright sample then moves a mean by at most κ standard errors, and for every mean that is finite the cut
//! vanishes in the limit (truncated means: Bubeck, Cesa-Bianchi & Lugosi 2013). What is cut off is summed apart: it is
//! light that is missing.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;
use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::Xxh3;

use super::supersampling::{SAMPLES_MAX, Tiles, displayed_difference};
use crate::display::tone::ToneMap;
use crate::image::luminance;
use crate::transport::gather::Seen;

/// Parts that samples are dealt out to in turn, with random numbers of their own.
pub const BATCHES: usize = 4;
/// Two batches make a half.
pub const HALVES: usize = 2;
/// Standard errors that one sample may move a mean by.
const KAPPA: f64 = 4.0;
/// Which half a sample belongs to, counted from 0.
fn half_of(sample: u32) -> usize {
    sample as usize % BATCHES / (BATCHES / HALVES)
}

/// Samples of a half among the first `n`.
fn samples_of_half(half: usize, n: u32) -> u32 {
    let per_half = (BATCHES / HALVES) as u32;
    let rest = (n % BATCHES as u32).saturating_sub(half as u32 * per_half).min(per_half);
    n / BATCHES as u32 * per_half + rest
}

/// Samples of a batch among the first `n`.
fn samples_of_batch(batch: usize, n: u32) -> u32 {
    (n + (BATCHES - 1 - batch) as u32) / BATCHES as u32
}

/// One sample of a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PixelSample {
    /// Emission and D part under the map's light. Radiance.
    pub shown: Vec3,
    /// Reflectance of the D part times π.
    pub albedo: Vec3,
    /// By S lobes; and the D part, less what the map says. Radiance.
    pub parts: [Vec3; PARTS],
}

/// Lobes and the residual of the D part.
pub const PARTS: usize = 2;
pub(super) const LOBES: usize = 0;
pub(super) const RESIDUAL: usize = 1;

impl From<Seen> for PixelSample {
    fn from(seen: Seen) -> Self {
        let shown = seen.shown();
        Self { shown, albedo: seen.albedo, parts: [seen.lobes, seen.radiance() - shown - seen.lobes] }
    }
}

/// Sums over the samples of one pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable, Serialize, Deserialize)]
#[repr(C)]
pub struct PixelSums {
    /// By part and batch. Radiance.
    parts: [[Vec3; BATCHES]; PARTS],
    /// Squares of their luminance, by part and half.
    squares: [[f32; HALVES]; PARTS],
    /// Squares of the luminance of what is shown of the map and by lobes together.
    total_squares: f32,
    shown: Vec3,
    albedo: Vec3,
    /// What was cut off, by part and batch.
    excess: [[Vec3; BATCHES]; PARTS],
}

impl PixelSums {
    fn part(&self, part: usize) -> Vec3 {
        self.parts[part].iter().sum()
    }

    fn total(&self) -> Vec3 {
        self.shown + self.part(LOBES) + self.part(RESIDUAL)
    }

    /// Mean of a part over some batches, of `n` samples in all.
    fn mean(&self, part: usize, batches: &[usize], n: u32) -> Vec3 {
        let sum: Vec3 = batches.iter().map(|b| self.parts[part][*b]).sum();
        sum / batches.iter().map(|b| samples_of_batch(*b, n)).sum::<u32>().max(1) as f32
    }

    /// Variance of the luminance of the mean over a half.
    fn variance(&self, part: usize, half: usize, n: u32) -> f32 {
        let count = samples_of_half(half, n) as f32;
        let per_half = BATCHES / HALVES;
        let sum: Vec3 = self.parts[part][half * per_half..][..per_half].iter().sum();
        let mean = luminance(sum) / count.max(1.0);
        (self.squares[part][half] / count.max(1.0) - mean * mean).max(0.0) / (count - 1.0).max(1.0)
    }

    /// The same over some batches of one half.
    fn variance_over(&self, part: usize, batches: &[usize], n: u32) -> f32 {
        let half = batches.first().map_or(0, |b| b / (BATCHES / HALVES));
        let count = batches.iter().map(|b| samples_of_batch(*b, n)).sum::<u32>();
        self.variance(part, half, n) * samples_of_half(half, n) as f32 / count.max(1) as f32
    }

    /// Mean of the residual of the D part over some batches, of `n` samples in all. Radiance.
    pub fn residual(&self, batches: &[usize], n: u32) -> Vec3 {
        self.mean(RESIDUAL, batches, n)
    }

    /// Variance of its luminance, for batches of one half.
    pub fn residual_variance(&self, batches: &[usize], n: u32) -> f32 {
        self.variance_over(RESIDUAL, batches, n)
    }

    /// Mean by S lobes over some batches, of `n` samples in all. Radiance.
    pub fn lobes(&self, batches: &[usize], n: u32) -> Vec3 {
        self.mean(LOBES, batches, n)
    }

    /// Variance of its luminance, for batches of one half.
    pub fn lobes_variance(&self, batches: &[usize], n: u32) -> f32 {
        self.variance_over(LOBES, batches, n)
    }

    /// Whether any lobe has shown anything.
    pub fn has_lobes(&self) -> bool {
        self.squares[LOBES] != [0.0; HALVES]
    }

    /// Mean of emission and D part under the map's light, of `n` samples. Radiance.
    pub fn shown(&self, n: u32) -> Vec3 {
        self.shown / n.max(1) as f32
    }

    /// Mean reflectance of the D part times π.
    pub fn albedo(&self, n: u32) -> Vec3 {
        self.albedo / n.max(1) as f32
    }

    /// What was cut off the residual in some batches, as a mean of `n` samples in all. Radiance.
    pub fn excess(&self, batches: &[usize], n: u32) -> Vec3 {
        let sum: Vec3 = batches.iter().map(|b| self.excess[RESIDUAL][*b]).sum();
        sum / batches.iter().map(|b| samples_of_batch(*b, n)).sum::<u32>().max(1) as f32
    }

    /// All that was cut off.
    fn cut(&self) -> Vec3 {
        self.excess.as_flattened().iter().sum()
    }

    /// Whether all is a number.
    fn is_sound(&self) -> bool {
        bytemuck::cast_slice::<Self, f32>(std::slice::from_ref(self)).iter().all(|v| v.is_finite())
    }
}

/// Sums over the samples of a tile's pixels after the first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TileSums {
    /// Which tile.
    pub tile: u32,
    /// Samples of each pixel in the sums.
    pub samples: u32,
    /// Row by row.
    pub pixels: Vec<PixelSums>,
    /// Squares of the largest bands of what is in the sums, over all pixels, by part and half.
    found: [[f64; HALVES]; PARTS],
}

impl TileSums {
    /// Of a tile of so many pixels, without a sample.
    pub fn new(tile: u32, pixels: usize) -> Self {
        Self { tile, samples: 0, pixels: vec![PixelSums::default(); pixels], found: [[0.0; HALVES]; PARTS] }
    }

    /// Adds a sample of each pixel.
    ///
    /// # Panics
    /// If there are not as many as pixels.
    pub fn add(&mut self, samples: &[PixelSample]) {
        assert_eq!(samples.len(), self.pixels.len(), "a sample for each pixel");
        let (batch, half) = (self.samples as usize % BATCHES, half_of(self.samples));
        let bounds = [LOBES, RESIDUAL].map(|part| self.bound(part, half, samples));
        for (sums, sample) in self.pixels.iter_mut().zip(samples) {
            let mut all = sample.shown;
            sums.shown += sample.shown;
            sums.albedo += sample.albedo;
            for (part, bound) in bounds.into_iter().enumerate() {
                let value = sample.parts[part];
                let size = value.abs().max_element();
                let kept = if size > bound { value * (bound / size) } else { value };
                sums.parts[part][batch] += kept;
                sums.squares[part][half] += luminance(kept).powi(2);
                sums.excess[part][batch] += value - kept;
                self.found[part][half] += f64::from(size.min(bound)).powi(2);
                if part == LOBES {
                    all += kept;
                }
            }
            sums.total_squares += luminance(all).powi(2);
        }
        self.samples += 1;
    }

    /// Where the next samples of a part are cut.
    fn bound(&self, part: usize, half: usize, samples: &[PixelSample]) -> f32 {
        let before = samples_of_half(half, self.samples);
        let n = f64::from(before) * self.pixels.len() as f64;
        let mean_square = self.found[part][half] / n.max(1.0);
        if mean_square > 0.0 {
            return (KAPPA * (mean_square * f64::from(before + 1)).sqrt()) as f32;
        }
        // Nothing is known yet: twice the median of what is not black.
        let mut sizes: Vec<f32> =
            samples.iter().map(|s| s.parts[part].abs().max_element()).filter(|s| *s > 0.0).collect();
        if sizes.is_empty() {
            return f32::INFINITY;
        }
        let middle = sizes.len() / 2;
        2.0 * *sizes.select_nth_unstable_by(middle, f32::total_cmp).1
    }

    /// Error of what is shown of the pixels, as displayed values in [0, 1], root mean square and largest: noise of edges and
    /// lobes in each pixel, of the diffuse part in blocks of 8 × 8, and what was cut off. Infinite before two samples.
    pub fn error(&self, tone: &ToneMap) -> [f32; 2] {
        /// Pixels that the filter joins at least, where nothing but noise is to be seen.
        const BLOCK: usize = 64;
        if self.samples < 2 {
            return [f32::INFINITY; 2];
        }
        let (n, count) = (self.samples as f32, self.pixels.len().max(1));
        let of_block =
            |p: &PixelSums| (0..HALVES).map(|h| p.variance(RESIDUAL, h, self.samples)).sum::<f32>();
        let block = self.pixels.iter().map(of_block).sum::<f32>()
            / (HALVES * HALVES * count * count.min(BLOCK)) as f32;
        let (mut sum, mut largest) = (0.0, 0.0_f32);
        for pixel in &self.pixels {
            let mean = luminance(pixel.total()) / n;
            let apart = luminance(pixel.shown + pixel.part(LOBES)) / n;
            let variance = (pixel.total_squares / n - apart * apart).max(0.0) / (n - 1.0);
            let cut = luminance(pixel.cut()) / n;
            let error = displayed_difference(tone, mean, (variance + block + cut * cut).sqrt());
            sum += error * error;
            largest = largest.max(error);
        }
        [(sum / count as f32).sqrt(), largest]
    }

    /// Share of the light of all pixels that was cut off.
    pub fn cut_share(&self) -> f32 {
        let sum = |of: fn(&PixelSums) -> Vec3| self.pixels.iter().map(|p| luminance(of(p))).sum::<f32>();
        let (excess, all) = (sum(PixelSums::cut), sum(PixelSums::total));
        if all + excess > 0.0 { excess / (all + excess) } else { 0.0 }
    }

    /// Whether its columns fit a tile of the picture: what was read from a file must.
    pub fn fits(&self, tiles: &Tiles) -> bool {
        (self.tile as usize) < tiles.len()
            && self.pixels.len() as u64 == tiles.rect(self.tile).area()
            && self.samples < SAMPLES_MAX
            && self.pixels.iter().all(PixelSums::is_sound)
            && self.found.iter().flatten().all(|f| f.is_finite())
    }

    /// Bytes of the sums.
    pub fn size_bytes(&self) -> usize {
        self.pixels.len() * size_of::<PixelSums>() + size_of::<Self>()
    }

    /// Hash of everything in it.
    pub fn digest(&self) -> u64 {
        let mut h = Xxh3::new();
        h.update(bytemuck::cast_slice(&[self.tile, self.samples]));
        h.update(bytemuck::cast_slice(&self.pixels));
        h.update(bytemuck::cast_slice(self.found.as_flattened()));
        h.digest()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::srgb_from_linear;
    use crate::math;
    use crate::rng::Stream;

    fn grey(lobes: f32, residual: f32) -> PixelSample {
        PixelSample { parts: [lobes, residual].map(Vec3::splat), ..PixelSample::default() }
    }

    fn of(pixels: usize, samples: usize, value: impl Fn(usize, usize) -> PixelSample) -> TileSums {
        let mut sums = TileSums::new(0, pixels);
        for n in 0..samples {
            let all: Vec<PixelSample> = (0..pixels).map(|p| value(n, p)).collect();
            sums.add(&all);
        }
        sums
    }

    #[test]
    fn samples_are_dealt_out_to_halves_in_turn() {
        for n in 0..40 {
            let counted = (0..n).filter(|&i| half_of(i) == 0).count() as u32;
            assert_eq!([0, 1].map(|half| samples_of_half(half, n)), [counted, n - counted], "{n}");
            for batch in 0..BATCHES {
                let dealt = (0..n).filter(|&i| i as usize % BATCHES == batch).count() as u32;
                assert_eq!(samples_of_batch(batch, n), dealt, "{batch} of {n}");
            }
        }
    }

    /// One sample of 10⁶ among 1,000 of 1: it moves the mean by at most κ standard errors, and what is missing is known.
    #[test]
    fn a_lone_bright_sample_moves_a_mean_by_few_standard_errors() {
        for part in [LOBES, RESIDUAL] {
            let sums = of(1, 1000, |n, _| {
                let value = if n == 700 { 1e6 } else { 1.0 };
                if part == LOBES { grey(value, 0.0) } else { grey(0.0, value) }
            });
            let mean = sums.pixels[0].part(part).x / 1000.0;
            // Standard error of samples of 1, as their root mean square has it, of one half.
            let most = KAPPA as f32 / 500f32.sqrt();
            assert!((mean - 1.0).abs() <= most && mean > 1.0, "{mean}");
            let excess = sums.pixels[0].cut().x;
            assert!((mean * 1000.0 + excess - 1_000_999.0).abs() < 1.0, "{mean} {excess}");
            assert!(sums.cut_share() > 0.99);
        }
    }

    /// A Pareto tail of exponent 1.5, mean 3 and no variance: what is cut vanishes.
    #[test]
    fn the_cut_vanishes_for_every_mean_that_is_finite() {
        let mut stream = Stream::new(1, 2, 3);
        let mut sums = TileSums::new(0, 16);
        for _ in 0..62_500 {
            let all: Vec<PixelSample> = (0..16)
                .map(|_| grey(math::powf(1.0 - f64::from(stream.next_f32()), -1.0 / 1.5) as f32, 0.0))
                .collect();
            sums.add(&all);
        }
        let mean = sums.pixels.iter().map(|p| f64::from(p.part(LOBES).x)).sum::<f64>() / 1e6;
        assert!((mean / 3.0 - 1.0).abs() < 0.05, "{mean}");
    }

    #[test]
    fn what_is_first_found_after_black_is_let_through() {
        let sums = of(4, 100, |n, p| grey(if n >= 40 && p == 1 { 2.0 } else { 0.0 }, 0.0));
        let mean = sums.pixels[1].part(LOBES).x / 60.0;
        assert!((mean - 2.0).abs() < 0.05, "{mean}");
    }

    #[test]
    fn halves_share_nothing() {
        let bright = |n: usize| if n == 1 { 1e3 } else { 1.0 };
        let (a, b) = (of(2, 16, |n, _| grey(bright(n), 0.0)), of(2, 16, |_, _| grey(1.0, 0.0)));
        for pixel in 0..2 {
            let [p, q] = [&a, &b].map(|sums| sums.pixels[pixel].parts[LOBES]);
            assert!(p[1] != q[1] && p[2..] == q[2..], "{p:?} {q:?}");
        }
    }

    #[test]
    fn the_error_is_that_of_the_mean_as_displayed() {
        let tone = ToneMap::default();
        let one = |values: &[f32]| of(1, values.len(), |n, _| grey(values[n], 0.0));
        assert_eq!(one(&[0.3]).error(&tone), [f32::INFINITY; 2]);
        assert!(one(&[0.25; 8]).error(&tone)[0] < 1e-3);
        // Mean 0.25, ± 0.05 about it.
        let error = one(&[0.2, 0.3]).error(&tone)[0];
        let expected = 0.5 * (srgb_from_linear(0.3) - srgb_from_linear(0.2));
        assert!((error - expected).abs() < 1e-4, "{error} {expected}");
        // What is white anyway has no error that shows.
        assert_eq!(one(&[5.0, 9.0]).error(&tone)[0], 0.0);
    }
}
