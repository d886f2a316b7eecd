//! The gold standards that walks are held against.

use std::ops::Range;
use std::sync::Arc;
use std::time::{Duration, Instant};

use foveal::display::FrameBuffers;
use foveal::display::cpu_pass::{self, Passes};
use foveal::image::{Map2d, luminance};
use foveal::metrics::{BATCHES, BatchSums, Batches};
use foveal::scene::camera::CameraFrame;
use foveal::splatting::supersampling::{Refined, Tiles, refined};
use foveal::transport::bidirectional::{Bidirectional, Part, Pass, Photons};
use foveal::world::World;
use glam::{DVec3, Vec3};

use crate::batch::{Alone, Found, Ground, Hands, Picture, Piece, strips};

/// Who is asked whether it goes on, once for each piece of work ([`steps`]).
pub type GoesOn<'a> = &'a (dyn Fn() -> bool + Sync);

/// Pieces of a picture of `kind`, about.
pub fn steps(frame: &CameraFrame, passes: u32) -> u64 {
    strips(frame).count() as u64 * u64::from(passes)
}

/// Every non-diffuse pixel traced, as a still view converges to; with more than one sample, what a converged view is
/// refined to: all pixels, through other points of each.
pub fn traced_picture(
    world: &World,
    frame: &CameraFrame,
    seed: u64,
    samples: u32,
    goes_on: GoesOn<'_>,
) -> Refined {
    traced_picture_by(&Alone, world, frame, seed, samples, goes_on)
}

/// The same, by whoever is at hand.
pub fn traced_picture_by(
    hands: &dyn Hands,
    world: &World,
    frame: &CameraFrame,
    seed: u64,
    samples: u32,
    goes_on: GoesOn<'_>,
) -> Refined {
    let [width, height] = frame.size.map(|s| s as usize);
    let mut base = FrameBuffers::new(width, height);
    cpu_pass::draw(world, frame, Passes { texture_ids: false }, &mut base);
    let photons = |_: &Bidirectional<'_>, _| Arc::default();
    let ground = Ground::Picture(Picture { world, frame, seed, base: Some(&base), photons: &photons });
    let mut picture = base.color.clone();
    let found = hands.each(&ground, strips(frame).map(Piece::Converged).collect(), goes_on);
    for (strip, found) in strips(frame).zip(found) {
        if let Some(Found::Colors(colors)) = found {
            picture.data_mut()[strip.start as usize..strip.end as usize].copy_from_slice(&colors);
        }
    }
    if samples <= 1 {
        return Refined { picture, stated: f32::INFINITY };
    }
    let count = Tiles::of_size(frame.size[0], frame.size[1]).len() as u32;
    let tiles = hands.each(&ground, (0..count).map(|tile| Piece::Tile { tile, samples }).collect(), goes_on);
    let sums = |found| match found {
        Some(Found::Tile(sums)) => Some(Arc::new(sums)),
        _ => None,
    };
    let tiles: Vec<_> = tiles.into_iter().map(sums).collect();
    let splats = |found| match found {
        Some(Found::Run(splats)) => Some(splats),
        _ => None,
    };
    refined(world, frame, &base, samples, &picture, &tiles, |runs| {
        hands.each(&ground, runs.map(Piece::Run).collect(), goes_on).into_iter().map(splats).collect()
    })
}

/// When samples are enough.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Enough {
    /// Samples per pixel at least.
    pub samples: u32,
    /// Mean relative standard error of 8 × 8 blocks.
    pub error: Option<f64>,
    /// Time, whatever the error is.
    pub time: Option<Duration>,
}

impl Enough {
    /// So many samples per pixel.
    pub fn samples(samples: u32) -> Self {
        Self { samples, error: None, time: None }
    }
}

/// A picture by independent samples of all of its pixels.
#[derive(Clone, Debug)]
pub struct Sampled {
    /// The mean.
    pub picture: Map2d<Vec3>,
    /// Samples per pixel.
    pub samples: u32,
    /// Its batches, where all have as many samples.
    pub batches: Option<Batches>,
    /// What merged photons add to it.
    pub merged: Merged,
}

/// The layer of merged photons in a picture, as shares of the picture's light.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Merged {
    /// How much they are.
    pub share: f64,
    /// By how much that is expected to be too bright (or, below 0, too dark) as photons are merged over disks.
    pub bias: f64,
}

/// Pixels along an edge of the blocks whose error is told.
pub const BLOCK: usize = 8;

/// Bytes of passes that are held at once, and of a pixel in each, about.
const HELD_BYTES: usize = 256 << 20;
const PASS_BYTES: usize = 128;

/// Adds up samples until there are enough; with an error or a time to meet, in rounds of one for each batch.
fn sampled(
    frame: &CameraFrame,
    enough: &Enough,
    worth: u64,
    mut passes: impl FnMut(Range<u64>) -> Option<Vec<Pass>>,
) -> Sampled {
    let [width, height] = frame.size.map(|s| s as usize);
    let start = Instant::now();
    let mut sum = vec![DVec3::ZERO; width * height];
    let mut batches = BatchSums::new(width, height, BLOCK);
    let (mut samples, mut merged) = (0, [0.0; 2]);
    let is_open = enough.error.is_some() || enough.time.is_some();
    let met = |samples: u32, batches: &BatchSums| {
        let round = samples.is_multiple_of(BATCHES as u32) && samples > 0;
        let time = enough.time.is_some_and(|t| start.elapsed() >= t);
        let error = enough.error.is_some_and(|e| batches.batches().is_some_and(|b| b.relative_error() <= e));
        samples >= enough.samples && (!is_open || round && (time || error))
    };
    // As many passes at once as keep everybody busy, none beyond where it may end.
    let held = (HELD_BYTES / (width * height * PASS_BYTES).max(1)).max(1) as u64;
    let together = worth.min(held) as u32;
    while !met(samples, &batches) {
        let end = match is_open {
            true => (samples + 1).next_multiple_of(BATCHES as u32),
            false => enough.samples,
        };
        let end = end.min(samples.saturating_add(together));
        let Some(done) = passes(u64::from(samples)..u64::from(end)) else { break };
        for Pass { mut connected, merged: layer } in done {
            if let Some(layer) = layer {
                for (pixel, found) in connected.data_mut().iter_mut().zip(layer.data()) {
                    *pixel += found[0];
                    for (sum, found) in merged.iter_mut().zip(found) {
                        *sum += f64::from(luminance(*found));
                    }
                }
            }
            for (sum, pixel) in sum.iter_mut().zip(connected.data()) {
                *sum += pixel.as_dvec3();
            }
            batches.add(u64::from(samples), &connected);
            samples += 1;
        }
    }
    let n = f64::from(samples.max(1));
    let picture = Map2d::from_vec(width, height, sum.iter().map(|s| (*s / n).as_vec3()).collect());
    let all: f64 = sum.iter().map(|s| f64::from(luminance(s.as_vec3()))).sum();
    // The bias is as the radius squared, and half of that within 1/√2.
    let of_all = |light: f64| if all > 0.0 { light / all } else { 0.0 };
    let merged = Merged { share: of_all(merged[0]), bias: of_all(2.0 * (merged[0] - merged[1])) };
    Sampled { picture, samples, batches: batches.batches(), merged }
}

/// Path-traced picture of so many samples, box-filtered over each pixel.
pub fn path_picture(
    world: &World,
    frame: &CameraFrame,
    seed: u64,
    samples: u32,
    goes_on: GoesOn<'_>,
) -> Map2d<Vec3> {
    sampled_paths(world, frame, seed, &Enough::samples(samples), goes_on).picture
}

/// The same with its error, of as many samples as are enough.
pub fn sampled_paths(
    world: &World,
    frame: &CameraFrame,
    seed: u64,
    enough: &Enough,
    goes_on: GoesOn<'_>,
) -> Sampled {
    sampled_paths_by(&Alone, world, frame, seed, enough, goes_on)
}

/// The same, by whoever is at hand.
pub fn sampled_paths_by(
    hands: &dyn Hands,
    world: &World,
    frame: &CameraFrame,
    seed: u64,
    enough: &Enough,
    goes_on: GoesOn<'_>,
) -> Sampled {
    let [width, height] = frame.size.map(|s| s as usize);
    let photons = |_: &Bidirectional<'_>, _| Arc::default();
    let ground = Ground::Picture(Picture { world, frame, seed, base: None, photons: &photons });
    sampled(frame, enough, hands.worth(), |samples| {
        let of = |sample| strips(frame).map(move |pixels| Piece::Paths { sample, pixels });
        let found = hands.each(&ground, samples.flat_map(of).collect(), goes_on);
        let colors: Vec<Vec<Vec3>> = found
            .into_iter()
            .map(|found| match found {
                Some(Found::Colors(colors)) => Some(colors),
                _ => None,
            })
            .collect::<Option<_>>()?;
        let pass = |strips: &[Vec<Vec3>]| Pass {
            connected: Map2d::from_vec(width, height, strips.concat()),
            merged: None,
        };
        Some(colors.chunks(strips(frame).count()).map(pass).collect())
    })
}

/// The same by bidirectional paths ([`foveal::transport::bidirectional`]).
pub fn sampled_bidirectional(
    world: &World,
    frame: &CameraFrame,
    seed: u64,
    enough: &Enough,
    goes_on: GoesOn<'_>,
) -> Sampled {
    sampled_bidirectional_by(&Alone, world, frame, seed, enough, goes_on)
}

/// The same, by whoever is at hand.
pub fn sampled_bidirectional_by(
    hands: &dyn Hands,
    world: &World,
    frame: &CameraFrame,
    seed: u64,
    enough: &Enough,
    goes_on: GoesOn<'_>,
) -> Sampled {
    let paths = world.bidirectional(frame);
    sampled(frame, enough, hands.worth(), |passes| {
        let first = passes.start;
        let photons: Vec<Arc<Photons>> =
            passes.clone().map(|pass| Arc::new(paths.photons(seed, pass))).collect();
        let of_pass = |_: &Bidirectional<'_>, pass: u64| Arc::clone(&photons[(pass - first) as usize]);
        let ground = Ground::Picture(Picture { world, frame, seed, base: None, photons: &of_pass });
        let of = |pass| strips(frame).map(move |pixels| Piece::Bidirectional { pass, pixels });
        let found = hands.each(&ground, passes.flat_map(of).collect(), goes_on);
        let parts: Vec<Part> = found
            .into_iter()
            .map(|found| match found {
                Some(Found::Bidirectional(part)) => Some(part),
                _ => None,
            })
            .collect::<Option<_>>()?;
        let parts = parts.chunks(strips(frame).count()).zip(&photons);
        Some(parts.map(|(parts, photons)| paths.joined(parts, photons)).collect())
    })
}
