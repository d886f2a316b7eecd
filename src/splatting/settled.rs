//! What a converged view shows once samples of all its tiles are there: the map, and what samples certainly know better.
//!
//! Lobes show the filtered mean of their samples, brighter by what was cut off bright ones around. The diffuse part shows
//! the map plus the filtered difference to it, with the albedo multiplied afterwards so that textures stay sharp. What was
//! cut off bright samples is light that is missing: its mean over wide surroundings is shown as far as both halves found it.
//! Whether that difference is shown at all is decided by samples that it does not know: with Z from one half and R the raw
//! mean of the other, the mean over blocks of `(Z − map)(Z + map − 2R)` is the squared error of Z less that of the map,
//! without R's own noise. The map stays until that is below 0 for certain. The same blocks tell the error of what is shown.
//! Certain is what blocks agree on, or what the noise of R cannot be: where one block, under a caustic, say, holds nearly
//! all of the error, blocks never agree.
//!
//! The difference has two reaches ([`Reach`]), which are filtered and decided apart. As far as the next D point, where the
//! map is believed again, samples have little noise and see all edges, and what they show is off by what the map is off by
//! elsewhere, all around and dimmed by a reflection. What is beyond is nearly all of the noise and, as a mean over all
//! directions, smooth. So few samples show shadows and the map's blots, judged by their like alone; what they are off
//! by then is shown once there are enough of them.
//!
//! What paths do not find, light that was traced to the eye (`splatting::light_tracing`), belongs to the samples: it is
//! added to their means, half by half, before anything is filtered or compared.
//!
//! A function of the view and the sums alone: whoever computes it, and whatever was shown before, the bits are the same.

use std::sync::Arc;

use glam::Vec3;
use xxhash_rust::xxh3::Xxh3;

use super::filter::{GoesOn, Halves, Surfaces};
use super::light_tracing::LightSums;
use super::supersampling::Tiles;
use super::tile_sums::{BATCHES, PixelMeans, Reach, TileSums};
use crate::display::FrameBuffers;
use crate::image::{Map2d, luminance};
use crate::scene::camera::CameraFrame;
use crate::world::World;

/// Pixels along an edge of the blocks whose errors are told.
const BLOCK: usize = 8;
/// Standard errors at 95 % confidence, one-sided.
const Z_95: f64 = 1.65;
/// Of noise that is known by two batches only, and where it matters may be that of one block.
const Z_BY_NOISE: f64 = 6.0;
/// Least albedo that is divided by.
const ALBEDO_MIN: f32 = 1e-3;
/// So many paths of a pixel are worth as much as the first sample, which branches.
const FIRST_WORTH: f32 = 16.0;
/// Of how far it is from them at most in a standard deviation of its own, as it would be if it were worth that: both are as
/// noisy where they are as many.
const FIRST_OFF: f32 = 2.0;
/// Pixels on either side from which the noise of one sample is known.
const AROUND: usize = 3;
/// Samples of a pixel from which the first one, which believes the map, counts no more.
const FIRST_LEFT: u32 = 64;

/// A refined picture.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Settled {
    /// Emission and diffuse part. Radiance.
    diffuse: Map2d<Vec3>,
    /// By lobes.
    lobes: Map2d<Vec3>,
    /// Variance of the luminance of one sample of these, around each pixel.
    variance: Map2d<f32>,
    /// Samples of the pixels of each tile.
    samples: Vec<u32>,
    /// Upper limit of the error of blocks of 8 × 8 pixels, relative to their mean: noise, the map and the filter's own
    /// faults, 95 % certain; infinite while nothing is known.
    pub stated: f32,
    /// As far as what samples know better than the map: not at all, to the next D point, or all of it.
    pub corrects: Option<Reach>,
}

impl Settled {
    /// What a pixel shows, from what the base layer (`base`) and the converged view (`first`) show.
    #[inline]
    pub fn pixel(&self, x: usize, y: usize, base: Vec3, first: Vec3) -> Vec3 {
        let tiles = Tiles::of_size(self.diffuse.width() as u32, self.diffuse.height() as u32);
        let n = self.samples.get(tiles.at(x, y)).copied().unwrap_or(0);
        if n == 0 {
            return first;
        }
        let (first, lobes) = (first - base, self.lobes.at(x, y));
        let mut worth = 0.0;
        if n < FIRST_LEFT {
            // Its branches all leave one point of the pixel. Where bumps or grain differ within a pixel that point speaks for
            // itself only, which is seen by how far it is from the mean of paths from all over the pixel.
            let apart = luminance(first - lobes).powi(2);
            let off = apart * FIRST_WORTH / (FIRST_OFF * self.variance.at(x, y));
            worth = FIRST_WORTH / off.max(1.0);
        }
        let lobes = (first * worth + lobes * n as f32) / (worth + n as f32);
        (self.diffuse.at(x, y) + lobes).max(Vec3::ZERO)
    }

    /// Whether it fits a picture: what was read from a file must.
    pub fn fits(&self, width: u32, height: u32) -> bool {
        let size = [width as usize, height as usize];
        let is_sound = |map: &Map2d<Vec3>| {
            [map.width(), map.height()] == size
                && map.data().len() == size[0] * size[1]
                && map.data().iter().all(|v| v.is_finite())
        };
        let spread = &self.variance;
        is_sound(&self.diffuse)
            && is_sound(&self.lobes)
            && [spread.width(), spread.height()] == size
            && spread.data().len() == size[0] * size[1]
            && spread.data().iter().all(|v| *v >= 0.0 && v.is_finite())
            && self.samples.len() == Tiles::of_size(width, height).len()
    }

    /// Bytes of it.
    pub fn size_bytes(&self) -> usize {
        2 * size_of_val(self.diffuse.data())
            + size_of_val(self.variance.data())
            + size_of_val(&self.samples[..])
    }

    /// Hash of everything that is shown.
    pub fn digest(&self) -> u64 {
        let mut h = Xxh3::new();
        h.update(bytemuck::cast_slice(self.diffuse.data()));
        h.update(bytemuck::cast_slice(self.lobes.data()));
        h.update(bytemuck::cast_slice(self.variance.data()));
        h.update(bytemuck::cast_slice(&self.samples));
        h.update(&self.stated.to_le_bytes());
        h.digest()
    }
}

/// The sums of every pixel, as a picture.
struct Pixels<'a> {
    at: Vec<Option<PixelMeans<'a>>>,
    /// What was traced to the eye.
    traced: Option<&'a LightSums>,
}

impl<'a> Pixels<'a> {
    fn new(
        width: usize,
        height: usize,
        tiles: &'a [Option<Arc<TileSums>>],
        traced: Option<&'a LightSums>,
    ) -> Self {
        let grid = Tiles::of_size(width as u32, height as u32);
        let mut at = vec![None; width * height];
        // Fewer leave a batch empty.
        for tile in tiles.iter().flatten().filter(|tile| tile.samples as usize >= BATCHES) {
            for (means, (x, y)) in tile.pixels().zip(grid.pixels(tile.tile)) {
                at[y * width + x] = Some(means);
            }
        }
        Self { at, traced }
    }

    /// One value of each pixel; 0 where there are no samples.
    fn of(&self, value: impl Fn(&PixelMeans<'a>) -> Vec3) -> Vec<Vec3> {
        self.at.iter().map(|p| p.as_ref().map_or(Vec3::ZERO, &value)).collect()
    }

    /// Reads all pixels that have samples.
    fn each(&self, mut read: impl FnMut(usize, &PixelMeans<'a>)) {
        for (i, pixel) in self.at.iter().enumerate() {
            if let Some(means) = pixel {
                read(i, means);
            }
        }
    }

    /// The residual of a reach, as far as both sets of batches show it. Radiance.
    fn reconstructed(
        &self,
        surfaces: &Surfaces,
        (reach, sets): (Reach, [&[usize]; 2]),
        goes_on: GoesOn<'_>,
    ) -> Option<Vec<Vec3>> {
        let count = self.at.len();
        let mut halves = Halves::of_nothing(count);
        let (mut albedo, none) = (vec![Vec3::ZERO; count], || vec![Vec3::ZERO; count]);
        let mut excess = [none(), none()];
        self.each(|i, means| {
            albedo[i] = means.albedo();
            halves.known[i] = albedo[i] != Vec3::ZERO;
            let divided_by = albedo[i].max(Vec3::splat(ALBEDO_MIN));
            for (half, set) in sets.into_iter().enumerate() {
                let (mut residual, mut variance) =
                    (means.residual(reach, set), means.residual_variance(reach, set));
                if let Some(traced) = self.traced.filter(|_| reach == Reach::Near) {
                    residual += traced.diffuse(i, set);
                    variance += traced.diffuse_variance(i, set);
                }
                halves.values[half][i] = residual / divided_by;
                halves.variances[half][i] = variance / luminance(divided_by).powi(2);
                excess[half][i] = means.excess(reach, set);
            }
        });
        let missing = surfaces.agreed_around(&excess, &albedo);
        let seen: Vec<f32> = albedo.iter().map(|albedo| luminance(*albedo)).collect();
        let residual = halves.reconstructed(surfaces, &missing, &seen, goes_on)?;
        Some(residual.into_iter().zip(albedo).map(|(residual, albedo)| residual * albedo).collect())
    }

    /// Variance of each block's luminance by edges of what the map and lamps show, pixel by pixel.
    fn noise_of_edges(&self, width: usize, height: usize) -> Vec<f64> {
        let edges = blocks(width, height, |i| self.at[i].as_ref().map_or(0.0, PixelMeans::shown_variance));
        edges.into_iter().map(|edge| edge / (BLOCK * BLOCK) as f64).collect()
    }

    /// Squared error of each block of lobes from one half of the samples, as the other half tells it.
    fn errors_of_lobes(
        &self,
        surfaces: &Surfaces,
        [from, with]: [[usize; 2]; 2],
        (width, height): (usize, usize),
        goes_on: GoesOn<'_>,
    ) -> Option<Vec<f64>> {
        let shown = self.lobes(surfaces, [&from[..1], &from[1..]], goes_on)?;
        let shown = blocks(width, height, |i| luminance(shown[i]));
        let [a, b] = [&with[..1], &with[1..]].map(|with| {
            blocks(width, height, |i| match &self.at[i] {
                Some(means) => {
                    let traced = self.traced.map_or(Vec3::ZERO, |traced| traced.lobes(i, with));
                    luminance(means.lobes(with) + means.lobes_excess(with) + traced)
                }
                None => 0.0,
            })
        });
        let (reference, noise) = mean_and_noise(&a, &b);
        Some(squared_errors(&shown, (&reference, &noise)))
    }

    /// Variance of the luminance of one sample of lobes, in the mean of the pixels around each that have any. Of a pixel
    /// alone its own few samples know too little, above all where they have not found what is rarely found.
    fn variance_around(&self, surfaces: &Surfaces) -> Vec<f32> {
        let of = |i: usize| self.at[i].as_ref().filter(|means| means.has_lobes());
        let variance = |i: usize| of(i).map_or(0.0, |means| f64::from(means.lobes_deviation()));
        let sums = surfaces.sums_around(AROUND, variance);
        let counts = surfaces.sums_around(AROUND, |i| if of(i).is_some() { 1.0 } else { 0.0 });
        sums.into_iter()
            .zip(counts)
            .map(|(sum, count)| (sum / f64::max(count, 1.0)).max(0.0) as f32)
            .collect()
    }

    /// What lobes show by two sets of batches: their filtered mean and, as a share of it, what was cut off samples around.
    fn lobes(&self, surfaces: &Surfaces, sets: [&[usize]; 2], goes_on: GoesOn<'_>) -> Option<Vec<Vec3>> {
        let mut halves = Halves::of_nothing(self.at.len());
        self.each(|i, means| {
            let traced = self.traced.filter(|traced| traced.has_lobes(i));
            halves.known[i] = means.has_lobes() || traced.is_some();
            for (half, set) in sets.into_iter().enumerate().filter(|_| halves.known[i]) {
                halves.values[half][i] = means.lobes(set);
                halves.variances[half][i] = means.lobes_variance(set);
                if let Some(traced) = traced {
                    halves.values[half][i] += traced.lobes(i, set);
                    halves.variances[half][i] += traced.lobes_variance(i, set);
                }
            }
        });
        let shown = halves.mean(surfaces, goes_on)?;
        let excess = sets.map(|set| self.of(|means| means.lobes_excess(set)));
        let shares = surfaces.agreed_around(&excess, &shown);
        Some(shown.into_iter().zip(shares).map(|(shown, share)| shown + shown * share).collect())
    }
}

/// The batches of each half.
const HALVES: [[usize; 2]; 2] = [[0, 1], [2, 3]];

/// Mean and standard error of values.
fn mean_and_error(values: &[f64]) -> (f64, f64) {
    let n = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    (mean, (variance / n).sqrt())
}

/// Mean over all batches of a block, and its variance.
fn of_batches(means: &[Vec<f64>; BATCHES], block: usize) -> (f64, f64) {
    let n = BATCHES as f64;
    let mean = means.iter().map(|m| m[block]).sum::<f64>() / n;
    (mean, means.iter().map(|m| (m[block] - mean).powi(2)).sum::<f64>() / (n * (n - 1.0)))
}

/// Luminances of the means of blocks; those that the edges cut are left out unless there are no others.
fn blocks(width: usize, height: usize, value: impl Fn(usize) -> f32) -> Vec<f64> {
    let (columns, rows) = ((width / BLOCK).max(1), (height / BLOCK).max(1));
    let mean = |x0: usize, y0: usize| {
        let (x1, y1) = ((x0 + BLOCK).min(width), (y0 + BLOCK).min(height));
        let pixels = (y0..y1).flat_map(|y| (x0..x1).map(move |x| y * width + x));
        pixels.map(|i| f64::from(value(i))).sum::<f64>() / ((x1 - x0) * (y1 - y0)).max(1) as f64
    };
    (0..rows)
        .flat_map(|j| (0..columns).map(move |i| (i * BLOCK, j * BLOCK)))
        .map(|(x, y)| mean(x, y))
        .collect()
}

/// The means of two equally good estimates, and what is known of their variance.
fn mean_and_noise(a: &[f64], b: &[f64]) -> (Vec<f64>, Vec<f64>) {
    a.iter().zip(b).map(|(a, b)| (0.5 * (a + b), 0.25 * (a - b).powi(2))).unzip()
}

/// Squared errors of what is `shown`, from an independent estimate of the truth that has such variances.
fn squared_errors(shown: &[f64], (reference, noise): (&[f64], &[f64])) -> Vec<f64> {
    shown
        .iter()
        .zip(reference)
        .zip(noise)
        .map(|((shown, reference), noise)| (shown - reference).powi(2) - noise)
        .collect()
}

/// What adding something to a picture does to its squared error, block by block.
struct Gain {
    /// The error with it less the error without.
    errors: Vec<f64>,
    /// Variances of these by the noise of what tells them.
    doubts: Vec<f64>,
}

impl Gain {
    /// Of adding `z` to what is `base` away from the map, where the truth is `r` away, which has such variances.
    fn of(z: &[f64], base: &[f64], (r, noise): (&[f64], &[f64])) -> Self {
        let all = |value: &dyn Fn(usize) -> f64| (0..z.len()).map(value).collect::<Vec<f64>>();
        Self {
            errors: all(&|i| z[i] * (z[i] + 2.0 * (base[i] - r[i]))),
            doubts: all(&|i| 4.0 * z[i] * z[i] * noise[i]),
        }
    }

    fn mean(self, other: Self) -> Self {
        Self { errors: mean(self.errors, other.errors), doubts: mean(self.doubts, other.doubts) }
    }

    /// How far its mean is from 0, and what it may be off by: as blocks go, or, where a few blocks hold nearly all of the error,
    /// as the noise is known by two batches.
    fn by_blocks(&self) -> (f64, f64) {
        let (mean, apart) = mean_and_error(&self.errors);
        let noise = self.doubts.iter().sum::<f64>().sqrt() / self.doubts.len().max(1) as f64;
        (mean, (Z_95 * apart).min(Z_BY_NOISE * noise))
    }

    /// Whether it is one, 95 % certain.
    fn is_significant(&self) -> bool {
        let (mean, doubt) = self.by_blocks();
        mean + doubt < 0.0
    }

    /// Whether it is none, 95 % certain.
    fn is_refuted(&self) -> bool {
        let (mean, doubt) = self.by_blocks();
        mean - doubt > 0.0
    }
}

/// The mean of values that belong together.
fn mean(a: Vec<f64>, b: Vec<f64>) -> Vec<f64> {
    a.into_iter().zip(b).map(|(a, b)| 0.5 * (a + b)).collect()
}

/// How pictures from one half do beside the other one.
struct Beside {
    /// What lies near beside the map, as samples of it tell, and as all samples do.
    near: [Gain; 2],
    /// All of it beside the map, and beside what lies near.
    all: [Gain; 2],
    /// Squared errors by block: of the map, with what lies near, with all of it.
    errors: [Vec<f64>; 3],
}

impl Beside {
    fn new(
        surfaces: &Surfaces,
        pixels: &Pixels<'_>,
        [from, with]: [[usize; 2]; 2],
        (width, height): (usize, usize),
        goes_on: GoesOn<'_>,
    ) -> Option<Self> {
        let guess = |reach: Reach| {
            let guess = pixels.reconstructed(surfaces, (reach, [&from[..1], &from[1..]]), goes_on)?;
            Some(blocks(width, height, |i| luminance(guess[i])))
        };
        let (near, deep) = (guess(Reach::Near)?, guess(Reach::Deep)?);
        // Uncut, or what is cut off both would seem right.
        let found = |reach: Reach, with: &[usize]| {
            let residual = pixels.of(|means| means.residual(reach, with) + means.excess(reach, with));
            let traced = |i: usize| match pixels.traced.filter(|_| reach == Reach::Near) {
                Some(traced) if pixels.at[i].is_some() => luminance(traced.diffuse(i, with)),
                _ => 0.0,
            };
            blocks(width, height, |i| luminance(residual[i]) + traced(i))
        };
        let parts = [&with[..1], &with[1..]].map(|with| [Reach::Near, Reach::Deep].map(|r| found(r, with)));
        let [a, b] = parts.each_ref().map(|[near, deep]| -> Vec<f64> {
            near.iter().zip(deep).map(|(near, deep)| near + deep).collect()
        });
        let (near_reference, near_noise) = mean_and_noise(&parts[0][0], &parts[1][0]);
        let (r, noise) = mean_and_noise(&a, &b);
        let all: Vec<f64> = near.iter().zip(&deep).map(|(near, deep)| near + deep).collect();
        let map = vec![0.0; near.len()];
        let error = |z: &[f64]| squared_errors(z, (&r, &noise));
        Some(Self {
            near: [
                Gain::of(&near, &map, (&near_reference, &near_noise)),
                Gain::of(&near, &map, (&r, &noise)),
            ],
            all: [Gain::of(&all, &map, (&r, &noise)), Gain::of(&deep, &near, (&r, &noise))],
            errors: [error(&map), error(&near), error(&all)],
        })
    }

    /// The same with roles changed, and the mean of both.
    fn mean(self, other: Self) -> Self {
        let both = |[a, b]: [Gain; 2], [c, d]: [Gain; 2]| [a.mean(c), b.mean(d)];
        let ([a, b, c], [d, e, f]) = (self.errors, other.errors);
        Self {
            near: both(self.near, other.near),
            all: both(self.all, other.all),
            errors: [mean(a, d), mean(b, e), mean(c, f)],
        }
    }

    /// As far as what samples certainly know better than the map.
    fn corrects(&self) -> Option<Reach> {
        let [by_near, by_all] = &self.near;
        let [beside_map, beside_near] = &self.all;
        if by_near.is_significant() && !by_all.is_refuted() {
            Some(if beside_near.is_significant() { Reach::Deep } else { Reach::Near })
        } else {
            beside_map.is_significant().then_some(Reach::Deep)
        }
    }

    /// Squared errors of the blocks of a picture that corrects so far.
    fn errors(&self, corrects: Option<Reach>) -> &[f64] {
        &self.errors[match corrects {
            None => 0,
            Some(Reach::Near) => 1,
            Some(Reach::Deep) => 2,
        }]
    }
}

/// The picture that the samples of `tiles` and the light `traced` to the eye make of a view; `None` where that was not to go on.
pub fn settled(
    world: &World,
    frame: &CameraFrame,
    buffers: &FrameBuffers,
    tiles: &[Option<Arc<TileSums>>],
    traced: Option<&LightSums>,
    goes_on: GoesOn<'_>,
) -> Option<Settled> {
    let (width, height) = (buffers.width(), buffers.height());
    let surfaces = Surfaces::of_view(world, frame, buffers, goes_on)?;
    let pixels = Pixels::new(width, height, tiles, traced);
    let of_roles = |roles| Beside::new(&surfaces, &pixels, roles, (width, height), goes_on);
    let beside = of_roles(HALVES)?.mean(of_roles([HALVES[1], HALVES[0]])?);
    let corrects = beside.corrects();
    let mut diffuse = pixels.of(PixelMeans::shown);
    for reach in [Reach::Near, Reach::Deep].into_iter().filter(|reach| corrects.is_some_and(|c| *reach <= c))
    {
        let residual = pixels.reconstructed(&surfaces, (reach, [&HALVES[0], &HALVES[1]]), goes_on)?;
        diffuse.iter_mut().zip(residual).for_each(|(pixel, residual)| *pixel += residual);
    }
    let variance = pixels.variance_around(&surfaces);
    let lobes = pixels.lobes(&surfaces, [&HALVES[0], &HALVES[1]], goes_on)?;
    let of_lobes = |roles| pixels.errors_of_lobes(&surfaces, roles, (width, height), goes_on);
    let of_lobes = mean(of_lobes(HALVES)?, of_lobes([HALVES[1], HALVES[0]])?);
    let bright = blocks(width, height, |i| luminance(diffuse[i] + lobes[i]));
    let light = bright.iter().sum::<f64>() / bright.len().max(1) as f64;
    let (errors, edges) = (beside.errors(corrects), pixels.noise_of_edges(width, height));
    let errors: Vec<f64> = (0..errors.len()).map(|i| errors[i] + of_lobes[i] + edges[i]).collect();
    let (squared, doubt) = mean_and_error(&errors);
    // A mean below zero is noise: it takes nothing from the doubt.
    let limit = (squared.max(0.0) + Z_95 * doubt).sqrt();
    let known = pixels.at.iter().all(Option::is_some) && light > 0.0 && limit.is_finite();
    let enough = |t: &&Arc<TileSums>| t.samples as usize >= BATCHES;
    let samples = tiles.iter().map(|t| t.as_ref().filter(enough).map_or(0, |t| t.samples)).collect();
    Some(Settled {
        diffuse: Map2d::from_vec(width, height, diffuse),
        lobes: Map2d::from_vec(width, height, lobes),
        variance: Map2d::from_vec(width, height, variance),
        samples,
        stated: if known { (limit / light) as f32 } else { f32::INFINITY },
        corrects,
    })
}

/// Quantile of Student's t with 3 degrees of freedom for 95 %, both sides: what four batches tell.
const OF_FOUR: f32 = 3.182;

/// Where the luminance of a block of 8 × 8 pixels is by its samples alone, neither cut nor filtered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// Mean of all samples.
    pub mean: f32,
    /// How far the truth is from it at most, 95 % certain, as far as four batches tell.
    pub reach: f32,
}

/// The intervals of all whole blocks, row by row. What the map shows in a pixel has no batches, so edges count as known.
pub fn intervals(
    [width, height]: [u32; 2],
    tiles: &[Option<Arc<TileSums>>],
    traced: Option<&LightSums>,
) -> Vec<Interval> {
    let (width, height) = (width as usize, height as usize);
    let pixels = Pixels::new(width, height, tiles, traced);
    let means: [Vec<f64>; BATCHES] = std::array::from_fn(|batch| {
        let of = &[batch][..];
        let value = |i: usize| {
            let Some(p) = &pixels.at[i] else { return 0.0 };
            let own = p.shown() + p.residual_uncut(of) + p.lobes(of) + p.lobes_excess(of);
            luminance(own + traced.map_or(Vec3::ZERO, |t| t.diffuse(i, of) + t.lobes(i, of)))
        };
        blocks(width, height, value)
    });
    let interval = |i: usize| {
        let (mean, variance) = of_batches(&means, i);
        Interval { mean: mean as f32, reach: OF_FOUR * variance.sqrt() as f32 }
    };
    (0..means[0].len()).map(interval).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::display::cpu_pass::{self, Passes};
    use crate::illumination::Uniform;
    use crate::rng::Stream;
    use crate::scene::test_scenes::{add_box, grey, scene};
    use crate::scene::{Camera, Mesh};
    use crate::splatting::tile_sums::PixelSample;

    const SIZE: (u32, u32) = (96, 64);

    /// The inside of a box.
    fn view() -> (World, CameraFrame, FrameBuffers) {
        let mut mesh = Mesh::default();
        add_box(&mut mesh, Vec3::splat(-1.0), Vec3::splat(1.0), 0, true);
        let world = World::new(Arc::new(scene(mesh, vec![grey()])), Arc::new(Uniform(Vec3::ONE)));
        let camera = Camera { eye: Vec3::new(0.1, 0.0, 0.9), target: Vec3::ZERO, up: Vec3::Y, fov_y: 1.0 };
        let frame = camera.frame(SIZE.0, SIZE.1);
        let mut buffers = FrameBuffers::new(SIZE.0 as usize, SIZE.1 as usize);
        cpu_pass::draw(&world, &frame, Passes { texture_ids: false }, &mut buffers);
        (world, frame, buffers)
    }

    /// A map that says 1 everywhere, off by `residual`, with samples of this deviation.
    fn of(residual: f32, deviation: f32, samples: u32, seed: u64) -> Settled {
        of_reaches([(residual, deviation), (0.0, 0.0)], samples, seed)
    }

    /// The same of what lies near and of what lies beyond.
    fn of_reaches(reaches: [(f32, f32); 2], samples: u32, seed: u64) -> Settled {
        let (world, frame, buffers) = view();
        let grid = Tiles::of_size(SIZE.0, SIZE.1);
        let tile = |tile: u32| {
            let mut sums = TileSums::new(tile, grid.rect(tile).area() as usize);
            let mut stream = Stream::new(seed, u64::from(tile), 0);
            for _ in 0..samples {
                let mut sample = |_| {
                    let [near, deep] = reaches.map(|(residual, deviation)| {
                        Vec3::splat(residual + 12f32.sqrt() * (stream.next_f32() - 0.5) * deviation)
                    });
                    let parts = [Vec3::ZERO, near, deep];
                    PixelSample { shown: Vec3::ONE, albedo: Vec3::splat(0.5), parts }
                };
                let all: Vec<PixelSample> = (0..sums.len()).map(&mut sample).collect();
                sums.add(&all);
            }
            Some(Arc::new(sums))
        };
        let tiles: Vec<_> = (0..grid.len() as u32).map(tile).collect();
        settled(&world, &frame, &buffers, &tiles, None, &|| true).expect("it goes on")
    }

    fn error(shown: &Settled, exact: f32) -> f32 {
        let values = shown.diffuse.data();
        (values.iter().map(|v| (v.x - exact).powi(2)).sum::<f32>() / values.len() as f32).sqrt()
    }

    /// Samples three times as bright or dark as the mean: what a map is off by 20 % is shown, to a fraction of it; a map
    /// that is right stays to the bit.
    #[test]
    fn the_map_gives_way_only_where_samples_certainly_know_better() {
        for seed in 0..3 {
            let off = of(0.2, 3.0, 64, seed);
            assert!(off.corrects.is_some() && error(&off, 1.2) < 0.06, "{seed}: {}", error(&off, 1.2));
            let right = of(0.0, 3.0, 16, seed);
            assert!(right.corrects.is_none() && error(&right, 1.0) == 0.0, "{seed}");
        }
    }

    /// Nearly all noise lies beyond the next D point: what lies near is shown long before that is known, and all of it then.
    #[test]
    fn what_is_near_does_not_wait_for_what_lies_beyond() {
        for seed in 0..3 {
            let few = of_reaches([(0.2, 0.5), (0.0, 8.0)], 16, seed);
            assert_eq!(few.corrects, Some(Reach::Near), "{seed}");
            assert!(error(&few, 1.2) < 0.05, "{seed}: {}", error(&few, 1.2));
            let many = of_reaches([(0.2, 0.5), (0.1, 4.0)], 256, seed);
            assert_eq!(many.corrects, Some(Reach::Deep), "{seed}");
            assert!(error(&many, 1.3) < 0.05, "{seed}: {}", error(&many, 1.3));
            let wrong = of_reaches([(0.0, 1.0), (0.0, 8.0)], 16, seed);
            assert!(wrong.corrects.is_none() && error(&wrong, 1.0) == 0.0, "{seed}");
        }
    }

    /// What is stated is above the true error, and not far above it once samples are many.
    #[test]
    fn what_is_stated_holds() {
        for (residual, deviation, samples) in
            [(0.2, 3.0, 16), (0.2, 3.0, 256), (0.02, 1.0, 64), (0.0, 1.0, 64)]
        {
            let shown = of(residual, deviation, samples, 7);
            let off = error(&shown, 1.0 + residual) / (1.0 + residual);
            assert!(shown.stated >= off, "{residual}: {off} stated below {}", shown.stated);
            let noise = deviation / (samples as f32).sqrt() / 8.0;
            assert!(shown.stated < 3.0 * off + 2.0 * noise, "{residual}: {off}, {}", shown.stated);
        }
    }

    #[test]
    fn pixels_without_samples_show_what_they_showed() {
        let (world, frame, buffers) = view();
        let none = vec![None; Tiles::of_size(SIZE.0, SIZE.1).len()];
        let none = settled(&world, &frame, &buffers, &none, None, &|| true).expect("it goes on");
        let (base, first) = (Vec3::splat(0.1), Vec3::splat(0.3));
        assert_eq!(none.pixel(3, 4, base, first), first);
        assert!(none.stated.is_infinite() && none.fits(SIZE.0, SIZE.1) && !none.fits(SIZE.1, SIZE.0));
        // One whose samples are few believes the first one, which branches, more than them, as far as it can be one of them.
        let shows = |samples: u32, variance: f32| {
            let mut few = of(0.0, 0.0, samples, 1);
            few.variance = few.variance.map(|_| variance);
            few.pixel(3, 4, base, first).x - 1.0
        };
        let (near, far) = (shows(4, 1.0), shows(4, 0.02));
        assert!((near - 0.8 * 0.2).abs() < 1e-5, "{near}");
        // Its square is 16 × 0.04 / (2 × 0.02) = 16 times what it would be: it is worth one path.
        assert!((far - 0.2 * 0.2).abs() < 1e-5, "{far}");
        assert_eq!([shows(4, 0.0), shows(64, 1.0)], [0.0, 0.0]);
    }

    /// The first sample of a pixel on rough ground speaks for one point of it: after a few paths the picture is nearer to
    /// the mean with it than without where it is as good as it is said to be, and as good as without where it is not.
    #[test]
    fn a_first_sample_that_paths_deny_counts_little() {
        let mut settled = of(0.0, 0.0, 16, 1);
        // Single samples of deviation 1 around 1, filtered to next to nothing.
        settled.lobes = settled.lobes.map(|_| Vec3::ONE);
        settled.variance = settled.variance.map(|_| 1.0);
        let mut errors = [0.0; 2];
        let mut stream = Stream::new(3, 0, 0);
        for i in 0..4096 {
            let (x, y) = (i % SIZE.0 as usize, i / SIZE.0 as usize);
            let off = 12f32.sqrt() * (stream.next_f32() - 0.5);
            for (error, deviation) in errors.iter_mut().zip([0.25, 1.0]) {
                let first = Vec3::splat(1.0 + deviation * off);
                let shown = settled.pixel(x, y, Vec3::ZERO, first) - Vec3::splat(2.0);
                *error += shown.x * shown.x / 4096.0;
            }
        }
        let [good, bad] = errors.map(f32::sqrt);
        // Half of 0.25 where it counts as much as 16 paths; a ninth of 1 where as two of them.
        assert!((0.08..0.125).contains(&good) && bad < 0.12, "{good} {bad}");
    }

    /// Sums of `samples` of all pixels of lobes that show 0.2 and, in a pixel now and then, `rare` with its probability.
    fn of_lobes(
        samples: u32,
        seed: u64,
        rare: impl Fn(usize, usize) -> (f32, f32),
    ) -> Vec<Option<Arc<TileSums>>> {
        let grid = Tiles::of_size(SIZE.0, SIZE.1);
        let mut stream = Stream::new(seed, 0, 0);
        let tile = |tile: u32| {
            let mut sums = TileSums::new(tile, grid.rect(tile).area() as usize);
            for _ in 0..samples {
                let mut sample = |(x, y): (usize, usize)| {
                    let (bright, chance) = rare(x, y);
                    let found = if stream.next_f32() < chance { bright } else { 0.0 };
                    let parts = [Vec3::splat(0.2 + found), Vec3::ZERO, Vec3::ZERO];
                    PixelSample { shown: Vec3::ZERO, albedo: Vec3::splat(0.5), parts }
                };
                let all: Vec<PixelSample> = grid.pixels(tile).map(&mut sample).collect();
                sums.add(&all);
            }
            Some(Arc::new(sums))
        };
        (0..grid.len() as u32).map(tile).collect()
    }

    /// What lobes find rarely and very bright is cut where it would be a firefly, and shown around: no light is lost.
    #[test]
    fn what_is_cut_off_lobes_is_shown_around() {
        let (world, frame, buffers) = view();
        let tiles = of_lobes(16, 5, |_, _| (100.0, 1.0 / 512.0));
        let pixels = Pixels::new(SIZE.0 as usize, SIZE.1 as usize, &tiles, None);
        let mean = |values: &[Vec3]| values.iter().map(|v| v.x).sum::<f32>() / values.len() as f32;
        let all = &[0, 1, 2, 3][..];
        let kept = mean(&pixels.of(|p| p.lobes(all)));
        let found = kept + mean(&pixels.of(|p| p.lobes_excess(all)));
        assert!(kept < 0.8 * found, "something is cut: {kept} of {found}");
        let shown = settled(&world, &frame, &buffers, &tiles, None, &|| true).expect("it goes on");
        let shown = mean(shown.lobes.data());
        assert!((shown / found - 1.0).abs() < 0.05, "{shown} of {found}, {kept} without");
    }

    /// Where it is found in one place only, around is where it is not: more than noise, and stated.
    #[test]
    fn what_lobes_show_elsewhere_is_stated() {
        /// Of each 19 in 20 are to hold.
        const RUNS: u64 = 20;
        let (world, frame, buffers) = view();
        let (bright, chance) = (60.0, 1.0 / 128.0);
        let is_there = |x: usize, y: usize| (16..48).contains(&x) && (16..48).contains(&y);
        let mut held = 0;
        for seed in 0..RUNS {
            let tiles = of_lobes(32, seed, |x, y| (bright, if is_there(x, y) { chance } else { 0.0 }));
            let shown = settled(&world, &frame, &buffers, &tiles, None, &|| true).expect("it goes on");
            let (width, height) = (SIZE.0 as usize, SIZE.1 as usize);
            let exact = blocks(width, height, |i| {
                0.2 + if is_there(i % width, i / width) { bright * chance } else { 0.0 }
            });
            let is = blocks(width, height, |i| luminance(shown.lobes.data()[i]));
            let squared = exact.iter().zip(&is).map(|(exact, is)| (exact - is).powi(2)).sum::<f64>();
            let (blocks, light) = (exact.len() as f64, is.iter().sum::<f64>());
            let off = (squared / blocks).sqrt() * blocks / light;
            held += u32::from(f64::from(shown.stated) >= off);
        }
        assert!(held >= RUNS as u32 * 9 / 10, "{held} of {RUNS} hold");
    }

    #[test]
    fn what_nobody_wants_is_not_made() {
        let (world, frame, buffers) = view();
        let tiles = vec![None; Tiles::of_size(SIZE.0, SIZE.1).len()];
        assert!(settled(&world, &frame, &buffers, &tiles, None, &|| false).is_none());
    }

    /// A map that is off in one block only, as under a caustic, gives way too.
    #[test]
    fn one_block_is_enough_where_there_is_no_doubt() {
        let gain = |noise: f64| Gain {
            errors: (0..192).map(|i| if i == 77 { -2.0 } else { -1e-5 }).collect(),
            doubts: vec![noise * noise; 192],
        };
        assert!(gain(0.01).is_significant() && !gain(0.1).is_significant() && !gain(0.1).is_refuted());
    }
}
