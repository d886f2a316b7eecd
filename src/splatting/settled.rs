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
//! Glass and mirrors show things behind and before them, with edges that surfaces tell nothing of: a filter over the glass
//! makes milk of them. There the mean's difference from a guide is filtered, which follows one way of the light by no chance
//! (`transport::tracer::guide`), and the guide is added afterwards: a control variate, as the map is one.
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
use super::trace::mean_guides;
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
    /// What guides show in each pixel: nothing where none is followed.
    guides: Vec<Vec3>,
}

impl<'a> Pixels<'a> {
    fn new(
        width: usize,
        height: usize,
        tiles: &'a [Option<Arc<TileSums>>],
        traced: Option<&'a LightSums>,
        guides: Vec<Vec3>,
    ) -> Self {
        let grid = Tiles::of_size(width as u32, height as u32);
        let mut at = vec![None; width * height];
        // Fewer leave a batch empty.
        for tile in tiles.iter().flatten().filter(|tile| tile.samples as usize >= BATCHES) {
            for (means, (x, y)) in tile.pixels().zip(grid.pixels(tile.tile)) {
                at[y * width + x] = Some(means);
            }
        }
        Self { at, traced, guides }
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

    /// What lobes show by two sets of batches: their mean, filtered as far as guides do not know it, and, as a share of it, what was cut off samples around.
    fn lobes(&self, surfaces: &Surfaces, sets: [&[usize]; 2], goes_on: GoesOn<'_>) -> Option<Vec<Vec3>> {
        let mut halves = Halves::of_nothing(self.at.len());
        self.each(|i, means| {
            let traced = self.traced.filter(|traced| traced.has_lobes(i));
            halves.known[i] = means.has_lobes() || traced.is_some();
            for (half, set) in sets.into_iter().enumerate().filter(|_| halves.known[i]) {
                halves.values[half][i] = means.lobes(set) - self.guides[i];
                halves.variances[half][i] = means.lobes_variance(set);
                if let Some(traced) = traced {
                    halves.values[half][i] += traced.lobes(i, set);
                    halves.variances[half][i] += traced.lobes_variance(i, set);
                }
            }
        });
        let beside = halves.mean(surfaces, goes_on)?;
        let whole = |(beside, guide): (Vec3, &Vec3)| match *guide == Vec3::ZERO {
            true => beside,
            // A filtered difference may take more than there is.
            false => (beside + *guide).max(Vec3::ZERO),
        };
        let shown: Vec<Vec3> = beside.into_iter().zip(&self.guides).map(whole).collect();
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
    let grid = Tiles::of_size(width as u32, height as u32);
    let surfaces = Surfaces::of_view(world, frame, buffers, goes_on)?;
    let known = |i: usize| tiles[grid.at(i % width, i / width)].is_some();
    let guides = mean_guides(world, frame, buffers, known, goes_on)?;
    let pixels = Pixels::new(width, height, tiles, traced, guides);
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
    let pixels = Pixels::new(width, height, tiles, traced, vec![Vec3::ZERO; width * height]);
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
#[path = "settled_tests.rs"]
mod tests;
