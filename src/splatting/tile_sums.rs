//! Sums over the samples of a tile's pixels, in independent batches, whose fireflies are cut.
//!
//! Of each pixel and batch the largest sample is kept apart, and when a mean is read it counts as κ s √n at most, n samples
//! of a half having the root mean square s in that tile. So a firefly moves a mean by at most κ standard errors,
//! whenever it came, and for every mean that is finite the cut vanishes in the limit, as that of truncated means (Bubeck,
//! Cesa-Bianchi & Lugosi 2013). A cut at the time that a sample comes, when s is hardly known, takes most of what a window
//! adds to a floor that reflects it: pictures were 2 to 30 % too dark after 64 samples. What is cut off is light that is
//! missing, and known.
//!
//! s is that of all samples but the largest, which may be the ones to cut, joined by these as far as most pixels have such:
//! none counts more than fifteen in sixteen do.

use std::f32::consts::FRAC_1_PI;

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
/// Batches of a half.
const PER_HALF: usize = BATCHES / HALVES;
/// Standard errors that one sample may move a mean by.
const KAPPA: f64 = 4.0;
/// One in so many of the largest samples of all pixels may be a firefly.
const PIXELS_PER_FIREFLY: usize = 16;

/// Which half a batch belongs to.
fn half_of(batch: usize) -> usize {
    batch / PER_HALF
}

/// Samples of a half among the first `n`.
fn samples_of_half(half: usize, n: u32) -> u32 {
    (half * PER_HALF..(half + 1) * PER_HALF).map(|batch| samples_of_batch(batch, n)).sum()
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

/// Lobes, and the residual of the D part: as far as the next D point, and beyond it.
pub const PARTS: usize = 3;
pub(super) const LOBES: usize = 0;
const RESIDUAL: usize = 1;
const DEEP: usize = 2;

impl From<Seen> for PixelSample {
    fn from(seen: Seen) -> Self {
        let (shown, deep) = (seen.shown(), seen.albedo * (seen.light.deep * FRAC_1_PI));
        let residual = seen.radiance() - shown - seen.lobes - deep;
        Self { shown, albedo: seen.albedo, parts: [seen.lobes, residual, deep] }
    }
}

/// How far the paths of a residual go.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Reach {
    /// To the next D point, where the map is believed.
    Near,
    /// Beyond it: what the map is off by there.
    Deep,
}

impl Reach {
    fn part(self) -> usize {
        match self {
            Self::Near => RESIDUAL,
            Self::Deep => DEEP,
        }
    }
}

/// The largest band of a value, whatever its sign.
fn size(value: Vec3) -> f32 {
    value.abs().max_element()
}

/// Sums over the samples of one pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable, Serialize, Deserialize)]
#[repr(C)]
struct PixelSums {
    /// By part and batch, all but the largest sample. Radiance.
    rest: [[Vec3; BATCHES]; PARTS],
    /// The largest sample.
    largest: [[Vec3; BATCHES]; PARTS],
    /// Squares of the luminance of all others, by part and half.
    squares: [[f32; HALVES]; PARTS],
    /// Squares of their largest bands.
    sizes: [[f32; HALVES]; PARTS],
    /// Emission and D part under the map's light, and the squares of its luminance.
    shown: Vec3,
    shown_squares: f32,
    albedo: Vec3,
}

impl PixelSums {
    /// Takes a sample of a part.
    #[inline]
    fn take(&mut self, part: usize, batch: usize, mut value: Vec3) {
        let largest = &mut self.largest[part][batch];
        if size(value) > size(*largest) {
            std::mem::swap(largest, &mut value);
        }
        self.rest[part][batch] += value;
        self.squares[part][half_of(batch)] += luminance(value).powi(2);
        self.sizes[part][half_of(batch)] += size(value).powi(2);
    }
}

/// Where the largest samples are cut, by part and half.
type Bounds = [[f32; HALVES]; PARTS];

/// What the samples of one pixel say.
#[derive(Clone, Copy, Debug)]
pub struct PixelMeans<'a> {
    sums: &'a PixelSums,
    bounds: Bounds,
    /// Samples of it.
    pub samples: u32,
}

impl PixelMeans<'_> {
    /// What counts of the largest sample of a batch, and what is cut off.
    fn largest(&self, part: usize, batch: usize) -> [Vec3; 2] {
        let (value, bound) = (self.sums.largest[part][batch], self.bounds[part][half_of(batch)]);
        let share = if size(value) > bound { bound / size(value) } else { 1.0 };
        [value * share, value * (1.0 - share)]
    }

    fn count(&self, batches: &[usize]) -> f32 {
        batches.iter().map(|b| samples_of_batch(*b, self.samples)).sum::<u32>().max(1) as f32
    }

    fn mean(&self, part: usize, batches: &[usize]) -> Vec3 {
        let sum: Vec3 = batches.iter().map(|b| self.sums.rest[part][*b] + self.largest(part, *b)[0]).sum();
        sum / self.count(batches)
    }

    fn cut(&self, part: usize, batches: &[usize]) -> Vec3 {
        let sum: Vec3 = batches.iter().map(|b| self.largest(part, *b)[1]).sum();
        sum / self.count(batches)
    }

    /// Variance of the luminance of one sample, from all samples of these halves.
    fn deviation(&self, part: usize, halves: std::ops::Range<usize>) -> f32 {
        let batches = halves.start * PER_HALF..halves.end * PER_HALF;
        let count = batches.clone().map(|b| samples_of_batch(b, self.samples)).sum::<u32>().max(1) as f32;
        let (mut sum, mut squares) = (Vec3::ZERO, self.sums.squares[part][halves].iter().sum::<f32>());
        for batch in batches {
            let [largest, _] = self.largest(part, batch);
            sum += self.sums.rest[part][batch] + largest;
            squares += luminance(largest).powi(2);
        }
        let mean = luminance(sum) / count;
        (squares / count - mean * mean).max(0.0) * count / (count - 1.0).max(1.0)
    }

    /// Variance of the luminance of the mean over batches of one half.
    fn variance(&self, part: usize, batches: &[usize]) -> f32 {
        let half = batches.first().map_or(0, |b| half_of(*b));
        self.deviation(part, half..half + 1) / self.count(batches)
    }

    /// Mean of a reach of the residual of the D part over some batches. Radiance.
    pub fn residual(&self, reach: Reach, batches: &[usize]) -> Vec3 {
        self.mean(reach.part(), batches)
    }

    /// Variance of its luminance, for batches of one half.
    pub fn residual_variance(&self, reach: Reach, batches: &[usize]) -> f32 {
        self.variance(reach.part(), batches)
    }

    /// What was cut off it. Radiance.
    pub fn excess(&self, reach: Reach, batches: &[usize]) -> Vec3 {
        self.cut(reach.part(), batches)
    }

    /// Mean of all of it, with what was cut off. Radiance.
    pub fn residual_uncut(&self, batches: &[usize]) -> Vec3 {
        let of = |reach: Reach| self.residual(reach, batches) + self.excess(reach, batches);
        of(Reach::Near) + of(Reach::Deep)
    }

    /// Mean by S lobes over some batches. Radiance.
    pub fn lobes(&self, batches: &[usize]) -> Vec3 {
        self.mean(LOBES, batches)
    }

    /// What was cut off these. Radiance.
    pub fn lobes_excess(&self, batches: &[usize]) -> Vec3 {
        self.cut(LOBES, batches)
    }

    /// Variance of its luminance, for batches of one half.
    pub fn lobes_variance(&self, batches: &[usize]) -> f32 {
        self.variance(LOBES, batches)
    }

    /// Variance of the luminance of one sample of these, from all samples.
    pub fn lobes_deviation(&self) -> f32 {
        self.deviation(LOBES, 0..HALVES)
    }

    /// Whether any lobe has shown anything.
    pub fn has_lobes(&self) -> bool {
        self.sums.largest[LOBES] != [Vec3::ZERO; BATCHES]
    }

    /// Mean of emission and D part under the map's light. Radiance.
    pub fn shown(&self) -> Vec3 {
        self.sums.shown / self.samples.max(1) as f32
    }

    /// Variance of the luminance of that mean.
    pub fn shown_variance(&self) -> f32 {
        self.variances()[PARTS]
    }

    /// Mean reflectance of the D part times π.
    pub fn albedo(&self) -> Vec3 {
        self.sums.albedo / self.samples.max(1) as f32
    }

    /// The mean of all, and what was cut off.
    fn total(&self) -> [Vec3; 2] {
        const ALL: [usize; BATCHES] = [0, 1, 2, 3];
        [
            self.shown()
                + [LOBES, RESIDUAL, DEEP].map(|part| self.mean(part, &ALL)).into_iter().sum::<Vec3>(),
            [LOBES, RESIDUAL, DEEP].map(|part| self.cut(part, &ALL)).into_iter().sum(),
        ]
    }

    /// Variances of the means of all samples: of the parts, and of what is shown of the map.
    fn variances(&self) -> [f32; PARTS + 1] {
        let (n, mean) = (self.samples.max(1) as f32, luminance(self.shown()));
        let shown = (self.sums.shown_squares / n - mean * mean).max(0.0) / (n - 1.0).max(1.0);
        let [lobes, residual, deep] = [LOBES, RESIDUAL, DEEP].map(|part| self.deviation(part, 0..HALVES) / n);
        [lobes, residual, deep, shown]
    }
}

/// Sums over the samples of a tile's pixels after the one that it converged with: of all so far, or of a block of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TileSums {
    /// Which tile.
    pub tile: u32,
    /// Samples of each pixel before those in the sums: none, but of a block.
    pub first: u32,
    /// Samples of each pixel in the sums.
    pub samples: u32,
    /// Row by row.
    pixels: Vec<PixelSums>,
}

impl TileSums {
    /// Of a tile of so many pixels, without a sample.
    pub fn new(tile: u32, pixels: usize) -> Self {
        Self::block(tile, pixels, 0)
    }

    /// A block that begins after the `first` samples, without one.
    pub fn block(tile: u32, pixels: usize, first: u32) -> Self {
        Self { tile, first, samples: 0, pixels: vec![PixelSums::default(); pixels] }
    }

    /// Pixels of the tile.
    pub fn len(&self) -> usize {
        self.pixels.len()
    }

    /// Whether it has none.
    pub fn is_empty(&self) -> bool {
        self.pixels.is_empty()
    }

    /// What is known of each pixel, row by row. Decides where samples are cut, which takes a look at all of them.
    pub fn pixels(&self) -> impl Iterator<Item = PixelMeans<'_>> + Clone {
        debug_assert_eq!(self.first, 0, "a block says nothing alone");
        let bounds = self.bounds();
        self.pixels.iter().map(move |sums| PixelMeans { sums, bounds, samples: self.samples })
    }

    /// Adds a sample of each pixel.
    ///
    /// # Panics
    /// If there are not as many as pixels.
    pub fn add(&mut self, samples: &[PixelSample]) {
        assert_eq!(samples.len(), self.pixels.len(), "a sample for each pixel");
        let batch = (self.first + self.samples) as usize % BATCHES;
        for (sums, sample) in self.pixels.iter_mut().zip(samples) {
            sums.shown += sample.shown;
            sums.shown_squares += luminance(sample.shown).powi(2);
            sums.albedo += sample.albedo;
            for (part, value) in sample.parts.into_iter().enumerate() {
                sums.take(part, batch, value);
            }
        }
        self.samples += 1;
    }

    /// Goes on with the block that follows.
    ///
    /// # Panics
    /// If it is one of another tile, or does not follow.
    pub fn join(&mut self, block: &Self) {
        let follows = block.tile == self.tile && block.first == self.first + self.samples;
        assert!(follows && block.len() == self.len(), "the block that follows");
        for (sums, block) in self.pixels.iter_mut().zip(&block.pixels) {
            sums.shown += block.shown;
            sums.shown_squares += block.shown_squares;
            sums.albedo += block.albedo;
            for part in 0..PARTS {
                for half in 0..HALVES {
                    sums.squares[part][half] += block.squares[part][half];
                    sums.sizes[part][half] += block.sizes[part][half];
                }
                for batch in 0..BATCHES {
                    sums.rest[part][batch] += block.rest[part][batch];
                    sums.take(part, batch, block.largest[part][batch]);
                }
            }
        }
        self.samples += block.samples;
    }

    /// Whether these are, bit for bit, the sums of some of its pixels, of which `only` are the numbers.
    pub fn has(&self, only: &[usize], these: &Self) -> bool {
        let own = only.iter().filter_map(|pixel| self.pixels.get(*pixel)).map(bytemuck::bytes_of);
        [self.tile, self.first, self.samples] == [these.tile, these.first, these.samples]
            && own.eq(these.pixels.iter().map(bytemuck::bytes_of))
    }

    /// Mean of all samples of each pixel, uncut. Radiance.
    pub fn uncut(&self) -> impl Iterator<Item = Vec3> {
        let samples = self.samples.max(1) as f32;
        self.pixels.iter().map(move |p| {
            let parts = p.rest.as_flattened().iter().chain(p.largest.as_flattened());
            (p.shown + parts.copied().sum::<Vec3>()) / samples
        })
    }

    /// Where the samples so far are cut.
    fn bounds(&self) -> Bounds {
        let mut sizes = Vec::with_capacity(PER_HALF * self.pixels.len());
        [LOBES, RESIDUAL, DEEP].map(|part| {
            [0, 1].map(|half| {
                let of_half = |p: &PixelSums| [0, 1].map(|i| size(p.largest[part][half * PER_HALF + i]));
                sizes.clear();
                sizes.extend(self.pixels.iter().flat_map(of_half).filter(|size| *size > 0.0));
                self.bound(part, half, &mut sizes)
            })
        })
    }

    /// Where samples of a part are cut, from the sizes of the largest ones.
    fn bound(&self, part: usize, half: usize, sizes: &mut [f32]) -> f32 {
        if sizes.is_empty() {
            return f32::INFINITY;
        }
        let usual = (sizes.len() - 1).saturating_sub((sizes.len() / PIXELS_PER_FIREFLY).max(1));
        let usual = *sizes.select_nth_unstable_by(usual, f32::total_cmp).1;
        // In the order of the pixels, whatever the selection did to it.
        let largest: f64 = (self.pixels.iter())
            .flat_map(|p| &p.largest[part][half * PER_HALF..][..PER_HALF])
            .map(|value| f64::from(size(*value).min(usual)).powi(2))
            .sum();
        let samples = f64::from(samples_of_half(half, self.samples));
        let others: f64 = self.pixels.iter().map(|p| f64::from(p.sizes[part][half])).sum();
        let mean_square = (others + largest) / (samples * self.pixels.len() as f64).max(1.0);
        (KAPPA * (mean_square * samples).sqrt()) as f32
    }

    /// Error of what is shown of the pixels, as displayed values in [0, 1], root mean square and largest: noise of edges and
    /// lobes in each pixel, of the diffuse part, near and deep, in blocks of 8 × 8, and what was cut off. Infinite before two samples.
    pub fn error(&self, tone: &ToneMap) -> [f32; 2] {
        /// Pixels that the filter joins at least, where nothing but noise is to be seen.
        const BLOCK: usize = 64;
        if self.samples < 2 {
            return [f32::INFINITY; 2];
        }
        let (pixels, count) = (self.pixels(), self.pixels.len().max(1));
        let diffuse = |p: PixelMeans<'_>| {
            let [_, near, deep, _] = p.variances();
            near + deep
        };
        let block = pixels.clone().map(diffuse).sum::<f32>() / (count * count.min(BLOCK)) as f32;
        let (mut sum, mut largest) = (0.0, 0.0_f32);
        for pixel in pixels {
            let [mean, cut] = pixel.total().map(luminance);
            let [lobes, .., shown] = pixel.variances();
            let error = displayed_difference(tone, mean, (lobes + shown + block + cut * cut).sqrt());
            sum += error * error;
            largest = largest.max(error);
        }
        [(sum / count as f32).sqrt(), largest]
    }

    /// Share of the light of all pixels that was cut off.
    #[cfg(test)]
    fn cut_share(&self) -> f32 {
        let [mut all, mut excess] = [0.0; 2];
        for pixel in self.pixels() {
            let [mean, cut] = pixel.total().map(luminance);
            all += mean;
            excess += cut;
        }
        if all + excess > 0.0 { excess / (all + excess) } else { 0.0 }
    }

    /// Whether its columns fit a tile of the picture: what was read from a file must.
    pub fn fits(&self, tiles: &Tiles) -> bool {
        self.first == 0 && self.fits_as_block(tiles)
    }

    /// The same for a block: what came from elsewhere must.
    pub fn fits_as_block(&self, tiles: &Tiles) -> bool {
        (self.tile as usize) < tiles.len()
            && self.pixels.len() as u64 == tiles.rect(self.tile).area()
            && self.first < SAMPLES_MAX
            && self.samples < SAMPLES_MAX - self.first
            && self.is_sound()
    }

    /// Whether all of it is finite.
    pub fn is_sound(&self) -> bool {
        bytemuck::cast_slice::<PixelSums, f32>(&self.pixels).iter().all(|v| v.is_finite())
    }

    /// Bytes of the sums.
    pub fn size_bytes(&self) -> usize {
        self.pixels.len() * size_of::<PixelSums>() + size_of::<Self>()
    }

    /// Hash of everything in it.
    pub fn digest(&self) -> u64 {
        let mut h = Xxh3::new();
        h.update(bytemuck::cast_slice(&[self.tile, self.first, self.samples]));
        h.update(bytemuck::cast_slice(&self.pixels));
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
        PixelSample { parts: [lobes, residual, 0.0].map(Vec3::splat), ..PixelSample::default() }
    }

    fn of(pixels: usize, samples: usize, value: impl Fn(usize, usize) -> PixelSample) -> TileSums {
        let mut sums = TileSums::new(0, pixels);
        for n in 0..samples {
            let all: Vec<PixelSample> = (0..pixels).map(|p| value(n, p)).collect();
            sums.add(&all);
        }
        sums
    }

    /// Mean of lobes of all samples.
    fn lobes(sums: &TileSums, pixel: usize) -> f32 {
        sums.pixels().nth(pixel).unwrap().mean(LOBES, &[0, 1, 2, 3]).x
    }

    #[test]
    fn samples_are_dealt_out_to_halves_in_turn() {
        for n in 0..40 {
            let counted = (0..n).filter(|&i| half_of(i as usize % BATCHES) == 0).count() as u32;
            assert_eq!([0, 1].map(|half| samples_of_half(half, n)), [counted, n - counted], "{n}");
            for batch in 0..BATCHES {
                let dealt = (0..n).filter(|&i| i as usize % BATCHES == batch).count() as u32;
                assert_eq!(samples_of_batch(batch, n), dealt, "{batch} of {n}");
            }
        }
    }

    /// One sample of 10⁶ among 1,000 of 1: it moves the mean by at most κ standard errors, and what is missing is known.
    #[test]
    fn a_firefly_moves_a_mean_by_few_standard_errors() {
        for part in [LOBES, RESIDUAL] {
            let sums = of(1, 1000, |n, _| {
                let value = if n == 700 { 1e6 } else { 1.0 };
                if part == LOBES { grey(value, 0.0) } else { grey(0.0, value) }
            });
            let pixel = sums.pixels().next().unwrap();
            let [mean, cut] = [pixel.mean(part, &[0, 1, 2, 3]).x, pixel.cut(part, &[0, 1, 2, 3]).x];
            // Standard error of samples of 1, as their root mean square has it, of one half.
            let most = KAPPA as f32 / 500f32.sqrt();
            assert!((mean - 1.0).abs() <= most && mean > 1.0, "{mean}");
            assert!(((mean + cut) * 1000.0 - 1_000_999.0).abs() < 1.0, "{mean} {cut}");
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
        let mean = (0..16).map(|p| f64::from(lobes(&sums, p))).sum::<f64>() / 16.0;
        assert!((mean / 3.0 - 1.0).abs() < 0.05, "{mean}");
    }

    /// A floor that reflects a window: one sample in ten is 200 times as bright as the others. No firefly is among
    /// them, in few samples or many, early ones or late.
    #[test]
    fn what_many_pixels_find_now_and_then_is_not_cut() {
        for samples in [4, 8, 16, 64, 256] {
            let mut stream = Stream::new(5, 6, samples);
            let picked: Vec<bool> = (0..256 * samples as usize).map(|_| stream.next_f32() < 0.1).collect();
            let value = |n: usize, p: usize| if picked[n * 256 + p] { 10.0 } else { 0.05 };
            let sums = of(256, samples as usize, |n, p| grey(value(n, p), 0.0));
            let found = picked.iter().filter(|p| **p).count() as f32 / picked.len() as f32;
            let expected = 10.0 * found + 0.05 * (1.0 - found);
            let mean = (0..256).map(|p| lobes(&sums, p)).sum::<f32>() / 256.0;
            assert!((mean / expected - 1.0).abs() < 0.02, "{samples}: {mean} {expected}");
        }
    }

    /// One pixel in a tile that is as good as black: one sample that nothing else resembles hardly counts.
    #[test]
    fn a_firefly_among_few_samples_is_cut() {
        for samples in [4, 8, 32] {
            let value = |n, p| if n == 2 && p == 17 { 1e4 } else { 0.1 };
            let sums = of(256, samples, |n, p| grey(value(n, p), 0.0));
            assert!(lobes(&sums, 17) < 0.1 + KAPPA as f32 * 0.11, "{samples}: {}", lobes(&sums, 17));
            assert!(sums.cut_share() > 0.9);
        }
    }

    #[test]
    fn halves_share_nothing() {
        let bright = |n: usize| if n == 1 { 1e3 } else { 1.0 };
        let (a, b) = (of(2, 16, |n, _| grey(bright(n), 0.0)), of(2, 16, |_, _| grey(1.0, 0.0)));
        for (p, q) in a.pixels().zip(b.pixels()) {
            assert!(p.lobes(&[0, 1]) != q.lobes(&[0, 1]) && p.lobes(&[2, 3]) == q.lobes(&[2, 3]));
        }
    }

    /// Blocks joined in their order are the sums of all, but for what rounding does to the order of a sum; whatever pixels a
    /// block is made of, each has its bits.
    #[test]
    fn blocks_join() {
        let value = |n: usize, p: usize| {
            let mut stream = Stream::new(8, n as u64, p as u64);
            grey(1.0 / (0.01 + stream.next_f32()), stream.next_f32() - 0.5)
        };
        let block = |first: usize, samples: usize, pixels: &[usize]| {
            let mut block = TileSums::block(0, pixels.len(), first as u32);
            (first..first + samples)
                .for_each(|n| block.add(&pixels.iter().map(|p| value(n, *p)).collect::<Vec<_>>()));
            block
        };
        let all = [0, 1, 2, 3, 4];
        let mut joined = TileSums::new(0, 5);
        [(0, 8), (8, 8), (16, 16), (32, 3)]
            .iter()
            .for_each(|&(first, n)| joined.join(&block(first, n, &all)));
        let whole = block(0, 35, &all);
        assert_eq!((joined.first, joined.samples), (0, 35));
        for (a, b) in joined.uncut().zip(whole.uncut()) {
            assert!((a - b).abs().max_element() <= 1e-5 * b.max_element(), "{a} {b}");
        }
        for (a, b) in joined.pixels().zip(whole.pixels()) {
            assert_eq!(a.sums.largest, b.sums.largest);
            let near = |a: f32, b: f32| (a - b).abs() <= 1e-5 * a.abs().max(b.abs());
            assert!(near(a.lobes_deviation(), b.lobes_deviation()) && near(a.bounds[0][0], b.bounds[0][0]));
        }
        let (part, of_all) = (block(16, 16, &[1, 3]), block(16, 16, &all));
        assert!(of_all.has(&[1, 3], &part) && !of_all.has(&[1, 2], &part) && !of_all.has(&[1], &part));
        assert!(!joined.has(&[1, 3], &part));
    }

    /// Samples added in two goes are those of one.
    #[test]
    fn sums_go_on() {
        let value = |n: usize, p: usize| grey((n * 7 % 5) as f32 + p as f32, (n % 3) as f32 - 1.0);
        let whole = of(5, 13, value);
        let mut parts = of(5, 6, value);
        for n in 6..13 {
            parts.add(&(0..5).map(|p| value(n, p)).collect::<Vec<_>>());
        }
        assert_eq!(whole, parts);
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

    /// The filter is the same for what lies near and beyond: noise of either counts alike, whole in a single pixel, by its
    /// square in 64 of them.
    #[test]
    fn noise_near_and_beyond_counts_alike() {
        let tone = ToneMap::default();
        let of_part = |part: usize, pixels: usize| {
            let sums = of(pixels, 2, |n, _| {
                let mut sample = grey(0.25, 0.0);
                sample.parts[part] = Vec3::splat([-0.02, 0.02][n]);
                sample
            });
            sums.error(&tone)[0]
        };
        let [near, deep] = [RESIDUAL, DEEP].map(|part| [1, 64, 1024].map(|pixels| of_part(part, pixels)));
        assert_eq!(near, deep);
        assert!(
            (near[0] / near[1] / 8.0 - 1.0).abs() < 0.05 && (near[1] / near[2] - 1.0).abs() < 1e-3,
            "{near:?}"
        );
    }
}
