//! What a converged still view is refined to: more samples for each pixel, anywhere inside it.
//!
//! A converged view shows one sample for each non-diffuse pixel, through its centre. From then on whole tiles are
//! sampled again and again, each time through another point of each pixel and with other numbers for glossy lobes and
//! area lights: edges are smoothed, and noise falls. A pixel shows the mean of what it showed and its later samples.
//!
//! Each tile goes on from its own sums, one order at a time, so the bits of a refined picture depend neither on who
//! traces nor on the order of tiles.

use glam::Vec3;
use rayon::prelude::*;
use xxhash_rust::xxh3::Xxh3;

use crate::display::tone::ToneMap;
use crate::image::{Map2d, luminance, srgb_from_linear};
use crate::rng::hash;
use crate::sampling::Rect;
use crate::scene::camera::CameraFrame;
use crate::splatting::trace::pixel_stream;
use crate::transport::tracer::Tracer;
use crate::world::World;

/// Side of a tile, pixels.
pub const TILE: u32 = 16;
/// Most samples of a pixel: as many points as the sequence inside a pixel has.
pub const SAMPLES_MAX: u32 = 1 << 16;

/// How far a converged view is refined.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Supersampling {
    /// A tile is done when the standard error of its pixels, as displayed values in [0, 1], is below this (root mean
    /// square over the tile; no pixel above four times it).
    pub noise: f32,
    /// Most samples of a pixel, the first one included.
    pub max_samples: u32,
}

impl Default for Supersampling {
    fn default() -> Self {
        Self { noise: 0.01, max_samples: 256 }
    }
}

/// The tiles of a picture, row by row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tiles {
    width: u32,
    height: u32,
}

impl Tiles {
    /// Tiles of a picture of this size.
    pub fn of_size(width: u32, height: u32) -> Self {
        Self { width, height }
    }

    /// Number of tiles.
    pub fn len(&self) -> usize {
        (self.width.div_ceil(TILE) * self.height.div_ceil(TILE)) as usize
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The pixels of a tile; those at the right and lower rim may be smaller.
    pub fn rect(&self, tile: u32) -> Rect {
        let columns = self.width.div_ceil(TILE).max(1);
        let (x0, y0) = ((tile % columns * TILE) as i32, (tile / columns * TILE) as i32);
        Rect { x0, y0, x1: x0 + TILE as i32, y1: y0 + TILE as i32 }
            .intersection(Rect::of_size(self.width, self.height))
    }

    /// A tile's pixels, in the order of its sums.
    pub fn pixels(&self, tile: u32) -> impl Iterator<Item = (usize, usize)> + use<> {
        let Rect { x0, y0, x1, y1 } = self.rect(tile);
        (y0..y1).flat_map(move |y| (x0..x1).map(move |x| (x as usize, y as usize)))
    }
}

/// Sums over the samples of a tile's pixels after the first.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct TileSums {
    /// Which tile.
    pub tile: u32,
    /// Samples of each pixel in the sums.
    pub samples: u32,
    /// Radiance, linear RGB, row by row.
    pub sums: Vec<Vec3>,
    /// Squares of luminance.
    squares: Vec<f32>,
}

impl TileSums {
    /// What a pixel shows: the mean of its `first` value and of its later samples.
    #[inline]
    pub fn mean(&self, pixel: usize, first: Vec3) -> Vec3 {
        mean(first, self.sums[pixel], self.samples)
    }

    /// Standard error of what the pixels show, as displayed values in [0, 1]: root mean square and largest.
    /// Infinite before two samples.
    pub fn error(&self, tone: &ToneMap) -> [f32; 2] {
        if self.samples < 2 {
            return [f32::INFINITY; 2];
        }
        let n = self.samples as f32;
        let (mut sum, mut largest) = (0.0, 0.0_f32);
        for (&radiance, &squares) in self.sums.iter().zip(&self.squares) {
            let mean = luminance(radiance) / n;
            let variance = (squares / n - mean * mean).max(0.0) / (n - 1.0);
            let error = displayed_difference(tone, mean, variance.sqrt());
            sum += error * error;
            largest = largest.max(error);
        }
        [(sum / self.sums.len().max(1) as f32).sqrt(), largest]
    }

    /// Whether its columns fit a tile of the picture: what was read from a file must.
    pub fn fits(&self, tiles: &Tiles) -> bool {
        let area = tiles.rect(self.tile).area();
        (self.tile as usize) < tiles.len()
            && self.sums.len() as u64 == area
            && self.squares.len() as u64 == area
            && self.samples < SAMPLES_MAX
    }

    /// Bytes of the sums.
    pub fn size_bytes(&self) -> usize {
        self.sums.len() * 16 + size_of::<Self>()
    }

    /// Hash of everything in it.
    pub fn digest(&self) -> u64 {
        let mut h = Xxh3::new();
        h.update(bytemuck::cast_slice(&[self.tile, self.samples]));
        h.update(bytemuck::cast_slice(&self.sums));
        h.update(bytemuck::cast_slice(&self.squares));
        h.digest()
    }
}

#[inline]
fn mean(first: Vec3, later: Vec3, samples: u32) -> Vec3 {
    (first + later) / (samples + 1) as f32
}

/// Half of what a luminance error of one `deviation` to both sides makes on the display.
fn displayed_difference(tone: &ToneMap, mean: f32, deviation: f32) -> f32 {
    let shown = |l: f32| srgb_from_linear(tone.to_linear(Vec3::splat(l)).y);
    let difference = 0.5 * (shown(mean + deviation) - shown((mean - deviation).max(0.0)));
    if difference.is_finite() { difference } else { 1.0 }
}

/// Radiance of sample number `sample` ≥ 1 of a pixel: through another point of it, with numbers of its own.
fn sample(tracer: &Tracer<'_>, frame: &CameraFrame, seed: u64, [x, y]: [u32; 2], sample: u32) -> Vec3 {
    // The points of one pixel share it out among themselves.
    let scramble = hash(seed, u64::from(y) << 32 | u64::from(x), u64::MAX) as u32;
    let [dx, dy] = [0, 1].map(|dimension| sobol_burley::sample(sample, dimension, scramble));
    let direction = frame.direction(x as f32 + dx, y as f32 + dy);
    tracer.seen(frame.eye, direction, frame.pixel_angle(), pixel_stream(seed, x, y, u64::from(sample)))
}

/// Adds `count` samples to each pixel of a tile, going `on` from what it has.
pub fn supersample(
    world: &World,
    frame: &CameraFrame,
    tile: u32,
    on: Option<&TileSums>,
    count: u32,
    seed: u64,
) -> TileSums {
    let [width, height] = frame.size;
    let tiles = Tiles::of_size(width, height);
    let area = tiles.rect(tile).area() as usize;
    let mut next = on.cloned().unwrap_or_else(|| TileSums {
        tile,
        samples: 0,
        sums: vec![Vec3::ZERO; area],
        squares: vec![0.0; area],
    });
    let tracer = world.tracer();
    let (begin, end) = (next.samples, next.samples.saturating_add(count).min(SAMPLES_MAX - 1));
    let sums = next.sums.iter_mut().zip(&mut next.squares);
    for ((sum, squares), (x, y)) in sums.zip(tiles.pixels(tile)) {
        for number in begin + 1..=end {
            let radiance = sample(&tracer, frame, seed, [x as u32, y as u32], number);
            *sum += radiance;
            *squares += luminance(radiance).powi(2);
        }
    }
    next.samples = end;
    next
}

/// Puts what tiles have into the picture of first samples.
pub fn show<'a>(tiles: impl Iterator<Item = &'a TileSums>, picture: &mut Map2d<Vec3>) {
    let grid = Tiles::of_size(picture.width() as u32, picture.height() as u32);
    for tile in tiles {
        for (i, (x, y)) in grid.pixels(tile.tile).enumerate() {
            let pixel = picture.at_mut(x, y);
            *pixel = tile.mean(i, *pixel);
        }
    }
}

/// The picture that a view is refined to after `samples` of each pixel, from its `first` samples. Before each tile it is
/// asked whether it `goes_on`; tiles after that stay as they were.
pub fn supersampled(
    world: &World,
    frame: &CameraFrame,
    seed: u64,
    samples: u32,
    mut first: Map2d<Vec3>,
    goes_on: &(dyn Fn() -> bool + Sync),
) -> Map2d<Vec3> {
    let [width, height] = frame.size;
    let tiles: Vec<TileSums> = (0..Tiles::of_size(width, height).len() as u32)
        .into_par_iter()
        .filter(|_| goes_on())
        .map(|tile| supersample(world, frame, tile, None, samples.saturating_sub(1), seed))
        .collect();
    show(tiles.iter(), &mut first);
    first
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::display::FrameBuffers;
    use crate::display::twin::{self, Passes};
    use crate::illumination::Uniform;
    use crate::scene::test_scenes::{add_box, grey, scene};
    use crate::scene::{Camera, Mesh};

    /// A grey box before black, under uniform light: radiance 0.5 where it is, 0 elsewhere.
    fn world() -> World {
        let mut mesh = Mesh::default();
        add_box(&mut mesh, Vec3::splat(-0.5), Vec3::splat(0.5), 0, false);
        let scene = scene(mesh, vec![grey()]);
        World::new(Arc::new(scene), Arc::new(Uniform(Vec3::splat(std::f32::consts::PI))))
    }

    #[test]
    fn edges_get_the_share_of_the_pixel_that_they_cover() {
        let world = world();
        let camera = Camera { eye: Vec3::new(0.1, 0.2, 4.0), target: Vec3::ZERO, up: Vec3::Y, fov_y: 0.5 };
        let frame = camera.frame(40, 24);
        let mut buffers = FrameBuffers::new(40, 24);
        twin::draw(&world, &frame, Passes { texture_ids: false }, &mut buffers);
        let seen = |n| supersampled(&world, &frame, 1, n, buffers.color.clone(), &|| true);
        assert_eq!(seen(1).data(), buffers.color.data());
        let (few, many) = (seen(65), seen(4097));
        let full = buffers.color.data().iter().fold(0.0_f32, |m, c| m.max(c.x));
        let edges = many.data().iter().filter(|c| c.x > 0.02 * full && c.x < 0.98 * full).count();
        assert!(edges > 20, "{edges} pixels lie on an edge");
        // Points that share out the pixel come closer than independent ones would: 0.5 / √65 = 0.062.
        let far = few.data().iter().zip(many.data()).fold(0.0_f32, |m, (a, b)| m.max((a.x - b.x).abs()));
        assert!(far < 0.04 * full, "{far}");
    }

    #[test]
    fn sums_do_not_depend_on_how_they_were_ordered() {
        let world = world();
        let camera = Camera { eye: Vec3::new(0.1, 0.2, 3.0), target: Vec3::ZERO, up: Vec3::Y, fov_y: 0.5 };
        let frame = camera.frame(33, 17);
        let tiles = Tiles::of_size(33, 17);
        assert_eq!(tiles.len(), 6);
        assert_eq!(tiles.rect(5), Rect { x0: 32, y0: 16, x1: 33, y1: 17 });
        for tile in 0..6 {
            let whole = supersample(&world, &frame, tile, None, 9, 3);
            let first = supersample(&world, &frame, tile, None, 4, 3);
            let second = supersample(&world, &frame, tile, Some(&first), 5, 3);
            assert_eq!(whole, second);
            assert!(whole.fits(&tiles) && !whole.fits(&Tiles::of_size(15, 90)));
        }
    }

    #[test]
    fn the_error_is_that_of_the_mean_as_displayed() {
        let tone = ToneMap::default();
        let one = |values: &[f32]| TileSums {
            tile: 0,
            samples: values.len() as u32,
            sums: vec![Vec3::splat(values.iter().sum())],
            squares: vec![values.iter().map(|v| v * v).sum()],
        };
        assert_eq!(one(&[0.3]).error(&tone), [f32::INFINITY; 2]);
        assert!(one(&[0.25; 8]).error(&tone)[0] < 1e-3);
        // Mean 0.25, standard error of the mean √(0.0025 · 2/(2 − 1)/2)…: ± 0.05 about 0.25.
        let error = one(&[0.2, 0.3]).error(&tone)[0];
        let expected = 0.5 * (srgb_from_linear(0.3) - srgb_from_linear(0.2));
        assert!((error - expected).abs() < 1e-4, "{error} {expected}");
        // What is white anyway has no error that shows, and what is no number has the largest.
        assert_eq!(one(&[5.0, 9.0]).error(&tone)[0], 0.0);
    }
}
