//! The gold standards that walks are held against.

use std::time::{Duration, Instant};

use foveal::display::FrameBuffers;
use foveal::display::cpu_pass::{self, Passes};
use foveal::geometry::Ray;
use foveal::image::{Map2d, luminance};
use foveal::metrics::{BATCHES, BatchSums, Batches};
use foveal::scene::camera::CameraFrame;
use foveal::splatting::supersampling::{Refined, supersampled};
use foveal::splatting::trace::pixel_stream;
use foveal::transport::bidirectional::Pass;
use foveal::world::World;
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Every non-diffuse pixel traced, as a still view converges to; with more than one sample, what a converged view is
/// refined to: all pixels, through other points of each.
pub fn traced_picture(
    world: &World,
    frame: &CameraFrame,
    seed: u64,
    samples: u32,
    goes_on: &(dyn Fn() -> bool + Sync),
) -> Refined {
    let [width, height] = frame.size.map(|s| s as usize);
    let mut buffers = FrameBuffers::new(width, height);
    cpu_pass::draw(world, frame, Passes { texture_ids: false }, &mut buffers);
    let tracer = world.tracer();
    let mut picture = buffers.color.clone();
    picture.data_mut().par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        if !goes_on() {
            return;
        }
        for (x, out) in row.iter_mut().enumerate() {
            let (Some(hit), true) = (buffers.hit.at(x, y).hit(), buffers.object.at(x, y) != 0) else {
                continue;
            };
            let (px, py) = (x as u32, y as u32);
            let ray = cpu_pass::primary_ray(frame, px, py);
            let at = cpu_pass::primary_interaction(world, frame, &ray, &hit);
            *out += tracer.view_dependent(&at, *out, pixel_stream(seed, px, py, 0));
        }
    });
    if samples > 1 {
        supersampled(world, frame, &buffers, seed, samples, &picture, goes_on)
    } else {
        Refined { picture, stated: f32::INFINITY }
    }
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

/// Adds up samples until there are enough; with an error or a time to meet, in rounds of one for each batch.
fn sampled(
    frame: &CameraFrame,
    enough: &Enough,
    goes_on: &(dyn Fn() -> bool + Sync),
    mut pass: impl FnMut(u64) -> Pass,
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
    while !met(samples, &batches) && goes_on() {
        let Pass { mut connected, merged: layer } = pass(u64::from(samples));
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
    goes_on: &(dyn Fn() -> bool + Sync),
) -> Map2d<Vec3> {
    sampled_paths(world, frame, seed, &Enough::samples(samples), goes_on).picture
}

/// The same with its error, of as many samples as are enough.
pub fn sampled_paths(
    world: &World,
    frame: &CameraFrame,
    seed: u64,
    enough: &Enough,
    goes_on: &(dyn Fn() -> bool + Sync),
) -> Sampled {
    let [width, height] = frame.size.map(|s| s as usize);
    sampled(frame, enough, goes_on, |sample| {
        let mut connected = Map2d::new(width, height, Vec3::ZERO);
        connected.data_mut().par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            for (x, out) in row.iter_mut().enumerate() {
                let mut stream = pixel_stream(seed, x as u32, y as u32, sample);
                let [dx, dy] = stream.next_2d();
                let ray = Ray::new(frame.eye, frame.direction(x as f32 + dx, y as f32 + dy));
                *out = world.path_radiance(&ray, stream.split(0));
            }
        });
        Pass { connected, merged: None }
    })
}

/// The same by bidirectional paths ([`foveal::transport::bidirectional`]).
pub fn sampled_truth(
    world: &World,
    frame: &CameraFrame,
    seed: u64,
    enough: &Enough,
    goes_on: &(dyn Fn() -> bool + Sync),
) -> Sampled {
    let paths = world.bidirectional(frame);
    sampled(frame, enough, goes_on, |sample| paths.pass(seed, sample))
}
