//! What a converged still view is refined to: more samples for each pixel, anywhere inside it.
//!
//! A converged view shows one sample for each non-diffuse pixel, through its centre, over diffuse light as the map has it.
//! From then on whole tiles are sampled again and again, each time through another point of each pixel and along other
//! paths, on diffuse surfaces as on all others: edges are smoothed, noise falls, and what is wrong with the map goes. In the
//! limit nothing of it is left (`transport::gather`).
//!
//! By blocks of samples of a tile, each a function of view, tile and its place in the sequence alone, whose sums are joined
//! in that order: bits depend neither on who traces which, on another machine it may be, nor on who is done first. What
//! is shown of them is made of all tiles at once (`splatting::settled`).

use std::ops::Range;
use std::sync::Arc;

use glam::Vec3;

use crate::display::FrameBuffers;
use crate::display::tone::ToneMap;
use crate::geometry::Ray;
use crate::image::{Map2d, srgb_from_linear};
use crate::rng::{Stream, hash};
use crate::sampling::Rect;
use crate::scene::camera::CameraFrame;
use crate::splatting::filter::GoesOn;
use crate::splatting::light_tracing::{LightSums, Splats, runs_for};
use crate::splatting::settled::settled;
use crate::splatting::tile_sums::{BATCHES, PixelSample, TileSums};
use crate::transport::gather::Gather;
use crate::world::World;

/// Side of a tile, pixels.
pub const TILE: u32 = 16;
/// Most samples of a pixel: as many points as the sequence inside a pixel has.
pub const SAMPLES_MAX: u32 = 1 << 16;

/// Samples of each pixel in a block.
pub const BLOCK: u32 = 16;

/// Samples of each pixel in the block that begins after so many. The first two are halves, so that something is seen soon.
pub fn block_after(samples: u32) -> u32 {
    let size = if samples < BLOCK { BLOCK / 2 } else { BLOCK };
    size - samples % size
}

/// How far a converged view is refined.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Supersampling {
    /// A tile is done when the standard error of its pixels, as displayed values in [0, 1], is below this (root mean
    /// square over the tile; no pixel above four times it).
    pub noise: f32,
    /// Most samples of a pixel, not counting the one that it converged with.
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

    /// Number of pixels.
    pub fn pixel_count(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Pixels in a row of the picture.
    pub fn width(&self) -> usize {
        self.width as usize
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The tile of a pixel.
    #[inline]
    pub fn at(&self, x: usize, y: usize) -> usize {
        let side = TILE as usize;
        y / side * (self.width as usize).div_ceil(side) + x / side
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

/// Half of what a luminance error of one `deviation` to both sides makes on the display.
pub(super) fn displayed_difference(tone: &ToneMap, mean: f32, deviation: f32) -> f32 {
    let shown = |l: f32| srgb_from_linear(tone.to_linear(Vec3::splat(l)).y);
    let difference = 0.5 * (shown(mean + deviation) - shown((mean - deviation).max(0.0)));
    if difference.is_finite() { difference } else { 1.0 }
}

/// Sample number `sample` of a pixel, counted from 0 without the first: through another point of it, with numbers of its
/// own. Each batch shares the pixel, and everything else that is chosen by chance, out among its samples.
fn sample(gather: &Gather<'_>, frame: &CameraFrame, seed: u64, [x, y]: [u32; 2], sample: u32) -> PixelSample {
    let (batch, index) = (sample % BATCHES as u32, sample / BATCHES as u32);
    let of_batch = hash(seed, u64::from(y) << 32 | u64::from(x), u64::from(batch));
    let mut stream = Stream::in_sequence(of_batch, u64::MAX, index);
    let [dx, dy] = stream.next_2d();
    let ray = Ray::new(frame.eye, frame.direction(x as f32 + dx, y as f32 + dy));
    // Textures are read ever finer, since samples average over the pixel, too: nothing of their mips is left in the limit.
    let spread = frame.pixel_angle() / ((sample + 1) as f32).sqrt();
    gather.seen(&ray, spread, stream.split(0)).into()
}

/// A block of a tile's samples, at most [`BLOCK`] of each pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Block {
    /// Which tile.
    pub tile: u32,
    /// Samples of each pixel before it.
    pub first: u32,
    /// Samples of each pixel in it.
    pub count: u32,
}

impl Block {
    /// Whether there is such a block of a picture: what came from elsewhere must be one.
    pub fn fits(&self, tiles: &Tiles) -> bool {
        (self.tile as usize) < tiles.len()
            && (1..=BLOCK).contains(&self.count)
            && self.first < SAMPLES_MAX - self.count
    }

    /// Its pixels in a picture of this size, row by row.
    pub fn pixels(&self, [width, height]: [u32; 2]) -> Vec<(usize, usize)> {
        Tiles::of_size(width, height).pixels(self.tile).collect()
    }

    /// Traces it, as long as it goes on, which is asked before each sample of all pixels.
    pub fn traced(
        &self,
        world: &World,
        frame: &CameraFrame,
        seed: u64,
        goes_on: GoesOn<'_>,
    ) -> Option<TileSums> {
        self.traced_at(&self.pixels(frame.size), world, frame, seed, goes_on)
    }

    /// The part of it that belongs to some pixels of the tile, by their number.
    pub fn traced_only(&self, only: &[usize], world: &World, frame: &CameraFrame, seed: u64) -> TileSums {
        let all = self.pixels(frame.size);
        let pixels: Vec<_> = only.iter().filter_map(|pixel| all.get(*pixel).copied()).collect();
        let traced = self.traced_at(&pixels, world, frame, seed, &|| true);
        traced.unwrap_or_else(|| TileSums::block(self.tile, 0, self.first))
    }

    fn traced_at(
        &self,
        pixels: &[(usize, usize)],
        world: &World,
        frame: &CameraFrame,
        seed: u64,
        goes_on: GoesOn<'_>,
    ) -> Option<TileSums> {
        let mut sums = TileSums::block(self.tile, pixels.len(), self.first);
        let gather = world.gather_beyond_map();
        let mut samples = Vec::with_capacity(pixels.len());
        for number in self.first..self.first + self.count {
            if !goes_on() {
                return None;
            }
            samples.clear();
            samples.extend(
                pixels.iter().map(|&(x, y)| sample(&gather, frame, seed, [x as u32, y as u32], number)),
            );
            sums.add(&samples);
        }
        Some(sums)
    }
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
    supersample_while(world, frame, tile, on, count, seed, &|| true)
}

/// The same, as long as it goes on; what is begun of a block then is lost.
pub fn supersample_while(
    world: &World,
    frame: &CameraFrame,
    tile: u32,
    on: Option<&TileSums>,
    count: u32,
    seed: u64,
    goes_on: GoesOn<'_>,
) -> TileSums {
    let [width, height] = frame.size;
    let area = Tiles::of_size(width, height).rect(tile).area() as usize;
    let mut sums = on.cloned().unwrap_or_else(|| TileSums::new(tile, area));
    let all = sums.samples.saturating_add(count).min(SAMPLES_MAX - 1);
    while sums.samples < all {
        let first = sums.samples;
        let block = Block { tile, first, count: block_after(first).min(all - first) };
        let Some(block) = block.traced(world, frame, seed, goes_on) else { break };
        sums.join(&block);
    }
    sums
}

/// A refined picture, and what is known of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Refined {
    /// Radiance.
    pub picture: Map2d<Vec3>,
    /// Its blocks of 8 × 8 pixels are off by less than this share of their mean, root mean square, 95 % certain; infinite
    /// where nothing is known.
    pub stated: f32,
}

/// The picture that a view is refined to after `samples` of each pixel, from its `first` samples: of the sums of `tiles`, those
/// that there are, and of `runs` of light traced to the eye, as many as belong to so many samples, if paths do not find all.
/// Without one of these runs it has none.
pub fn refined(
    world: &World,
    frame: &CameraFrame,
    buffers: &FrameBuffers,
    samples: u32,
    first: &Map2d<Vec3>,
    tiles: &[Option<Arc<TileSums>>],
    mut runs: impl FnMut(Range<u32>) -> Vec<Option<Splats>>,
) -> Refined {
    /// Runs that are held at once.
    const TOGETHER: u32 = 64;
    let [width, height] = frame.size.map(|s| s as usize);
    let mut traced = None;
    if samples > 0 && world.caustics().is_possible() {
        let (sums, all) =
            (traced.insert(LightSums::new(world, width * height)), runs_for(samples, width * height));
        for first in (0..all).step_by(TOGETHER as usize) {
            runs(first..all.min(first + TOGETHER)).iter().flatten().for_each(|splats| sums.add(splats));
        }
    }
    let Some(settled) = settled(world, frame, buffers, tiles, traced.as_ref(), &|| true) else {
        return Refined { picture: first.clone(), stated: f32::INFINITY };
    };
    let pixel = |x, y| settled.pixel(x, y, buffers.color.at(x, y), first.at(x, y));
    Refined { picture: Map2d::from_fn(width, height, pixel), stated: settled.stated }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::display::cpu_pass::{self, Passes};
    use crate::illumination::Uniform;
    use crate::image::luminance;
    use crate::scene::test_scenes::{add_box, grey, scene};
    use crate::scene::{Camera, Material, Mesh, Model, Reflectance};
    use crate::splatting::light_tracing::trace_run;
    use crate::transport::gather::Trust;
    use rayon::prelude::*;

    /// A refined picture, from this machine's threads.
    pub(in crate::splatting) fn supersampled(
        world: &World,
        frame: &CameraFrame,
        buffers: &FrameBuffers,
        seed: u64,
        samples: u32,
        first: &Map2d<Vec3>,
    ) -> Refined {
        let of_tile = |tile| Some(Arc::new(supersample(world, frame, tile, None, samples, seed)));
        let count = Tiles::of_size(frame.size[0], frame.size[1]).len() as u32;
        let tiles: Vec<_> = (0..count).into_par_iter().map(of_tile).collect();
        refined(world, frame, buffers, samples, first, &tiles, |runs| {
            runs.into_par_iter().map(|run| trace_run(world, frame, run, seed, &|| true)).collect()
        })
    }

    /// A box that shines before black: radiance 0.5 where it is, 0 elsewhere.
    fn world() -> World {
        let mut mesh = Mesh::default();
        add_box(&mut mesh, Vec3::splat(-0.5), Vec3::splat(0.5), 0, false);
        let black = Model::Lambert { albedo: Reflectance::constant(Vec3::ZERO) };
        let shining = Material { model: black, emission: Reflectance::constant(Vec3::splat(0.5)), ..grey() };
        World::new(Arc::new(scene(mesh, vec![shining])), Arc::new(Uniform(Vec3::ZERO)))
    }

    /// What is stated of a picture is above its true error, as paths that know no map find it: under maps that are wrong,
    /// nearly right and right, after few samples and many; and it is not far above it.
    #[test]
    fn what_is_stated_of_a_room_holds() {
        let mut mesh = Mesh::default();
        add_box(&mut mesh, Vec3::splat(-1.0), Vec3::splat(1.0), 0, true);
        add_box(&mut mesh, Vec3::new(-0.2, 0.9, -0.2), Vec3::new(0.2, 0.95, 0.2), 1, false);
        add_box(&mut mesh, Vec3::new(0.1, -1.0, -0.5), Vec3::new(0.6, -0.3, 0.0), 0, false);
        let lamp = Material { emission: Reflectance::constant(Vec3::splat(8.0)), ..grey() };
        let scene = Arc::new(scene(mesh, vec![grey(), lamp]));
        let camera = Camera {
            eye: Vec3::new(0.0, 0.0, 0.9),
            target: Vec3::new(0.0, -0.3, 0.0),
            up: Vec3::Y,
            fov_y: 1.0,
        };
        let frame = camera.frame(48, 32);
        let blocks = |picture: &Map2d<Vec3>| -> Vec<f64> {
            let mean = |i: usize, j: usize| {
                let pixels = (0..64).map(|k| picture.at(8 * i + k % 8, 8 * j + k / 8));
                pixels.map(|c| f64::from(luminance(c))).sum::<f64>() / 64.0
            };
            (0..24).map(|b| mean(b % 6, b / 6)).collect()
        };
        let world = |irradiance: f32| World::new(scene.clone(), Arc::new(Uniform(Vec3::splat(irradiance))));
        let nobody = world(0.0);
        let paths = Gather::new(&nobody.scene, &nobody.accel, &nobody.lights, Trust::Nobody);
        let reference = Map2d::from_fn(48, 32, |x, y| {
            let of = |n| sample(&paths, &frame, 77, [x as u32, y as u32], n);
            (0..1024).map(of).map(|s| s.shown + s.parts.into_iter().sum::<Vec3>()).sum::<Vec3>() / 1024.0
        });
        let reference = blocks(&reference);
        let mean = reference.iter().sum::<f64>() / 24.0;
        let (mut runs, mut above, mut near) = (0, 0, 0);
        for map in [0.0, 2.0, 3.0, 8.0] {
            let world = world(map);
            let mut buffers = FrameBuffers::new(48, 32);
            cpu_pass::draw(&world, &frame, Passes { texture_ids: false }, &mut buffers);
            for (samples, seed) in [(16, 1), (16, 2), (64, 3), (64, 4), (64, 5)] {
                let shown = supersampled(&world, &frame, &buffers, seed, samples, &buffers.color);
                let off =
                    blocks(&shown.picture).iter().zip(&reference).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
                let (off, stated) = ((off / 24.0).sqrt() / mean, f64::from(shown.stated));
                println!("map {map}, {samples} samples: {off:.4}, stated below {stated:.4}");
                (runs, above, near) =
                    (runs + 1, above + u32::from(stated >= off), near + u32::from(stated < 4.0 * off + 0.02));
            }
        }
        assert!(above + 1 >= runs && 4 * near >= 3 * runs, "{above} and {near} of {runs}");
    }

    /// A room with a lamp, under a map that is wrong by half of all light: after some samples nothing is left of it.
    #[test]
    fn diffuse_pixels_come_to_what_paths_find() {
        let mut mesh = Mesh::default();
        add_box(&mut mesh, Vec3::splat(-1.0), Vec3::splat(1.0), 0, true);
        add_box(&mut mesh, Vec3::new(-0.2, 0.9, -0.2), Vec3::new(0.2, 0.95, 0.2), 1, false);
        let lamp = Material { emission: Reflectance::constant(Vec3::splat(8.0)), ..grey() };
        let scene = Arc::new(scene(mesh, vec![grey(), lamp]));
        let camera = Camera { eye: Vec3::new(0.0, 0.0, 0.9), target: Vec3::ZERO, up: Vec3::Y, fov_y: 1.2 };
        let frame = camera.frame(32, 16);
        let mean = |irradiance: f32, samples: u32| {
            let world = World::new(scene.clone(), Arc::new(Uniform(Vec3::splat(irradiance))));
            let mut buffers = FrameBuffers::new(32, 16);
            cpu_pass::draw(&world, &frame, Passes { texture_ids: false }, &mut buffers);
            let picture = supersampled(&world, &frame, &buffers, 1, samples, &buffers.color).picture;
            picture.data().iter().map(|c| f64::from(c.x)).sum::<f64>() / 512.0
        };
        let [dark, bright] = [0.0, 9.0].map(|map| mean(map, 256));
        assert!((dark / bright - 1.0).abs() < 0.02, "{dark} {bright}");
        assert!(mean(9.0, 0) > 1.5 * bright);
    }

    #[test]
    fn edges_get_the_share_of_the_pixel_that_they_cover() {
        let world = world();
        let camera = Camera { eye: Vec3::new(0.1, 0.2, 4.0), target: Vec3::ZERO, up: Vec3::Y, fov_y: 0.5 };
        let frame = camera.frame(40, 24);
        let mut buffers = FrameBuffers::new(40, 24);
        cpu_pass::draw(&world, &frame, Passes { texture_ids: false }, &mut buffers);
        let seen = |n| supersampled(&world, &frame, &buffers, 1, n, &buffers.color).picture;
        assert_eq!(seen(0).data(), buffers.color.data());
        let (few, many) = (seen(64), seen(4096));
        let full = buffers.color.data().iter().fold(0.0_f32, |m, c| m.max(c.x));
        let edges = many.data().iter().filter(|c| c.x > 0.02 * full && c.x < 0.98 * full).count();
        assert!(edges > 20, "{edges} pixels lie on an edge");
        // Points that share out the pixel come closer than independent ones would: 0.5 / √65 = 0.062.
        let far = few.data().iter().zip(many.data()).fold(0.0_f32, |m, (a, b)| m.max((a.x - b.x).abs()));
        assert!(far < 0.04 * full, "{far}");
    }

    #[test]
    fn blocks_end_where_they_would_whatever_was_there() {
        let ends = |mut samples: u32| {
            std::iter::from_fn(|| {
                samples += block_after(samples);
                Some(samples)
            })
            .take(4)
            .collect::<Vec<_>>()
        };
        assert_eq!(ends(0), [8, 16, 32, 48]);
        assert_eq!(ends(3), [8, 16, 32, 48]);
        assert_eq!(ends(33), [48, 64, 80, 96]);
        let tiles = Tiles::of_size(33, 17);
        let fits = |tile, first, count| Block { tile, first, count }.fits(&tiles);
        assert!(fits(5, 0, 8) && fits(0, SAMPLES_MAX - 17, 16));
        assert!(!fits(6, 0, 8) && !fits(0, 0, 0) && !fits(0, 0, 17) && !fits(0, SAMPLES_MAX - 16, 16));
        assert!(!fits(0, u32::MAX, 16));
    }

    #[test]
    fn sums_do_not_depend_on_how_they_were_ordered() {
        let world = world();
        let camera = Camera { eye: Vec3::new(0.1, 0.2, 3.0), target: Vec3::ZERO, up: Vec3::Y, fov_y: 0.5 };
        let frame = camera.frame(33, 17);
        let tiles = Tiles::of_size(33, 17);
        assert_eq!(tiles.len(), 6);
        assert_eq!(tiles.rect(5), Rect { x0: 32, y0: 16, x1: 33, y1: 17 });
        let mut differ = 0;
        for tile in 0..6 {
            let whole = supersample(&world, &frame, tile, None, 41, 3);
            let first = supersample(&world, &frame, tile, None, 8, 3);
            let second = supersample(&world, &frame, tile, Some(&first), 33, 3);
            assert_eq!(whole, second);
            assert!(whole.fits(&tiles) && !whole.fits(&Tiles::of_size(15, 90)));
            let block = Block { tile, first: 16, count: BLOCK };
            let traced = block.traced(&world, &frame, 3, &|| true).expect("a block");
            assert!(block.fits(&tiles) && traced.fits_as_block(&tiles) && !traced.fits(&tiles));
            let only = [traced.len() - 1, 0];
            assert!(traced.has(&only, &block.traced_only(&only, &world, &frame, 3)));
            let all: Vec<usize> = (0..traced.len()).collect();
            differ += u32::from(!traced.has(&all, &block.traced_only(&all, &world, &frame, 4)));
            assert_eq!(block.traced(&world, &frame, 3, &|| false), None);
        }
        // All but those that show nothing.
        assert!(differ > 1, "{differ}");
    }
}
