//! Light traced to the eye: what refinement by paths does not find, by particles
//! ([`Class::Unfound`](crate::transport::caustic::Class)).
//!
//! Each arrival of a particle is joined with the pinhole: `Φ · f · |cos θ_x| · V / (d² · A_p · cos³ θ_c)`, f with the
//! shading normal as the eye sees it (Veach 1997, eq 5.19). Particles come in runs, which are dealt out to batches as the
//! samples of pixels are. Sums are whole numbers of a small quantum, so that the order of runs does not matter.
//!
//! What is seen in mirrors and through clear glass is not found: there nothing can be joined with an eye.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;
use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::Xxh3;

use super::filter::GoesOn;
use super::supersampling::displayed_difference;
use super::tile_sums::BATCHES;
use crate::display::tone::ToneMap;
use crate::image::luminance;
use crate::scene::camera::CameraFrame;
use crate::transport::bsdf::Bsdf;
use crate::transport::caustic::{Deposit, RUN};
use crate::transport::direct::visibility;
use crate::transport::geometric_cosine;
use crate::world::World;

/// Parts of a display's white that sums are counted in.
const QUANTA: f32 = (1 << 24) as f32;
/// Particles between two looks at whether to go on.
const BETWEEN: u64 = 256;
/// Pixels along an edge of the blocks whose noise counts.
const BLOCK: usize = 8;
/// The D part and lobes of what is seen.
const PARTS: usize = 2;
const LOBES: usize = 0;
const DIFFUSE: usize = 1;

/// Runs of particles for so many samples of each pixel: about as many particles as samples, and as many runs in each batch.
pub fn runs_for(samples: u32, pixels: usize) -> u32 {
    let runs = (u64::from(samples) * pixels as u64).div_ceil(RUN);
    runs.next_multiple_of(BATCHES as u64).min(u64::from(u32::MAX / 2)) as u32
}

/// What a run of particles adds to a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable, Serialize, Deserialize)]
#[repr(C)]
pub struct Splat {
    pixel: u32,
    /// By the D part and by lobes: radiance, of which a display shows 1 as white.
    parts: [Vec3; PARTS],
}

/// What a run of particles shows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Splats {
    /// Which run.
    pub run: u32,
    splats: Vec<Splat>,
}

impl Splats {
    /// Hash of everything in it.
    pub fn digest(&self) -> u64 {
        let mut h = Xxh3::new();
        h.update(&self.run.to_le_bytes());
        h.update(bytemuck::cast_slice(&self.splats));
        h.digest()
    }

    /// Whether all of it is finite.
    pub fn is_sound(&self) -> bool {
        self.splats.iter().all(|s| s.parts.iter().all(|part| part.is_finite()))
    }

    /// All that it adds to the picture, by the D part and by lobes.
    pub fn sum(&self) -> Vec3 {
        self.splats.iter().flat_map(|s| s.parts).sum()
    }

    /// Whether it can be one of a picture of so many pixels: what came from elsewhere must.
    pub fn fits(&self, pixels: usize) -> bool {
        let fits = |s: &Splat| (s.pixel as usize) < pixels && s.parts.iter().all(|part| part.is_finite());
        self.splats.iter().all(fits)
    }

    /// Bytes of it.
    pub fn size_bytes(&self) -> usize {
        size_of_val(&self.splats[..]) + size_of::<Self>()
    }
}

/// Traces a run of particles to the eye of a view; `None` where that was not to go on.
pub fn trace_run(
    world: &World,
    frame: &CameraFrame,
    run: u32,
    seed: u64,
    goes_on: GoesOn<'_>,
) -> Option<Splats> {
    let caustics = world.caustics();
    let mut splats = Vec::new();
    for i in 0..RUN {
        if i % BETWEEN == 0 && !goes_on() {
            return None;
        }
        caustics.trace(seed, u64::from(run) * RUN + i, &mut |arrived| {
            splats.extend(shown(world, frame, arrived));
        });
    }
    Some(Splats { run, splats })
}

/// Factor that makes a display's white 1.
fn exposure(world: &World) -> f32 {
    let exposure = world.scene.display.exposure;
    if exposure > 0.0 && exposure.is_finite() { exposure } else { 1.0 }
}

/// A particle joined with the eye.
fn shown(world: &World, frame: &CameraFrame, arrived: &Deposit<'_>) -> Option<Splat> {
    let (scene, at) = (&*world.scene, arrived.at);
    let (x, y, _) = frame.project(at.position)?;
    let [width, height] = frame.size;
    if !(x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32) {
        return None;
    }
    let between = frame.eye - at.position;
    let distance = between.length();
    let (wo, wi) = (between / distance, at.wo);
    if !(wo.dot(at.facing_geometric()) > 0.0) {
        return None;
    }
    // What the eye sees: a shading normal may be tilted towards it.
    let seen = at.seen_from(scene, wo).map(|at| (at, Bsdf::at(scene, &at)));
    let (at, bsdf) = seen.as_ref().map_or((at, arrived.bsdf), |(at, bsdf)| (at, bsdf));
    let cosine = wi.dot(at.facing_shading()).max(0.0) / geometric_cosine(at, wi);
    let near = geometric_cosine(at, wo) / (distance * distance);
    let through = arrived.flux * (cosine * near * frame.density(-wo) / RUN as f32);
    let diffuse = bsdf.diffuse_f(wo, wi);
    let parts = [bsdf.evaluate(wo, wi), diffuse].map(|f| f * through * exposure(world));
    let sum = parts[0] + parts[1];
    if !sum.is_finite() || sum.max_element() <= 0.0 {
        return None;
    }
    let passed = visibility(scene, &world.accel, &at.spawn_to(frame.eye))
        * arrived.media.transmittance(scene, distance);
    let pixel = y as u32 * width + x as u32;
    (passed.max_element() > 0.0).then(|| Splat { pixel, parts: parts.map(|part| part * passed) })
}

/// Sums over runs of particles.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LightSums {
    /// Radiance that a display shows as white.
    white: f32,
    /// By batch.
    runs: [u32; BATCHES],
    /// By pixel, part and batch, in quanta.
    pixels: Vec<[[[i64; 3]; BATCHES]; PARTS]>,
}

impl LightSums {
    /// Of a picture of so many pixels, without any.
    pub fn new(world: &World, pixels: usize) -> Self {
        let white = 1.0 / exposure(world);
        Self { white, runs: [0; BATCHES], pixels: vec![Default::default(); pixels] }
    }

    /// Adds a run.
    pub fn add(&mut self, splats: &Splats) {
        let batch = splats.run as usize % BATCHES;
        self.runs[batch] += 1;
        for Splat { pixel, parts } in &splats.splats {
            let Some(sums) = self.pixels.get_mut(*pixel as usize) else { continue };
            for (sums, value) in sums.iter_mut().zip(parts) {
                let quanta = (*value * QUANTA).round().to_array().map(|v| v as i64);
                for (sum, quanta) in sums[batch].iter_mut().zip(quanta) {
                    *sum = sum.saturating_add(quanta);
                }
            }
        }
    }

    /// Runs in it.
    pub fn runs(&self) -> u32 {
        self.runs.iter().sum()
    }

    /// Whether it belongs to a picture of so many pixels: what was read from a file must.
    pub fn fits(&self, pixels: usize) -> bool {
        self.pixels.len() == pixels && self.white.is_finite()
    }

    fn mean(&self, pixel: usize, part: usize, batches: &[usize]) -> Vec3 {
        let runs = batches.iter().map(|b| self.runs[*b]).sum::<u32>();
        let sum: glam::DVec3 = batches
            .iter()
            .map(|b| glam::DVec3::from(self.pixels[pixel][part][*b].map(|quanta| quanta as f64)))
            .sum();
        (sum * (f64::from(self.white / QUANTA) / f64::from(runs.max(1)))).as_vec3()
    }

    /// Variance of the luminance of the mean over some batches of one half, as far as its two batches differ.
    fn variance(&self, pixel: usize, part: usize, batches: &[usize]) -> f32 {
        let Some(first) = batches.first().map(|b| b - b % 2) else { return 0.0 };
        let [a, b] = [first, first + 1].map(|batch| luminance(self.mean(pixel, part, &[batch])));
        (a - b).powi(2) / (2 * batches.len()) as f32
    }

    /// Mean by D parts over some batches. Radiance.
    pub fn diffuse(&self, pixel: usize, batches: &[usize]) -> Vec3 {
        self.mean(pixel, DIFFUSE, batches)
    }

    /// Variance of its luminance, for batches of one half.
    pub fn diffuse_variance(&self, pixel: usize, batches: &[usize]) -> f32 {
        self.variance(pixel, DIFFUSE, batches)
    }

    /// Mean by lobes over some batches. Radiance.
    pub fn lobes(&self, pixel: usize, batches: &[usize]) -> Vec3 {
        self.mean(pixel, LOBES, batches)
    }

    /// Variance of its luminance, for batches of one half.
    pub fn lobes_variance(&self, pixel: usize, batches: &[usize]) -> f32 {
        self.variance(pixel, LOBES, batches)
    }

    /// Whether any lobe has shown anything there.
    pub fn has_lobes(&self, pixel: usize) -> bool {
        self.pixels[pixel][LOBES] != [[0; 3]; BATCHES]
    }

    /// Noise of blocks of 8 × 8 pixels, of those that show anything, as displayed values in [0, 1], root mean square;
    /// infinite as long as a batch has no run.
    pub fn error(&self, width: usize, tone: &ToneMap) -> f32 {
        if self.runs.contains(&0) {
            return f32::INFINITY;
        }
        let columns = width.div_ceil(BLOCK).max(1);
        let rows = (self.pixels.len() / width.max(1)).div_ceil(BLOCK);
        let mut blocks = vec![([0.0f32; BATCHES], 0u32); columns * rows];
        for (i, _) in self.pixels.iter().enumerate() {
            let (sums, count) = &mut blocks[i / width / BLOCK * columns + i % width / BLOCK];
            for (batch, sum) in sums.iter_mut().enumerate() {
                *sum += luminance(self.mean(i, LOBES, &[batch]) + self.mean(i, DIFFUSE, &[batch]));
            }
            *count += 1;
        }
        let (mut squared, mut shown) = (0.0, 0u32);
        for (sums, count) in blocks {
            let batches = sums.map(|sum| sum / count.max(1) as f32);
            let mean = batches.iter().sum::<f32>() / BATCHES as f32;
            if mean > 0.0 {
                let variance = batches.iter().map(|b| (b - mean).powi(2)).sum::<f32>()
                    / (BATCHES * (BATCHES - 1)) as f32;
                squared += displayed_difference(tone, mean, variance.sqrt()).powi(2);
                shown += 1;
            }
        }
        (squared / shown.max(1) as f32).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::display::FrameBuffers;
    use crate::display::cpu_pass::{self, Passes};
    use crate::illumination::Uniform;
    use crate::scene::{Camera, Light, Model, Reflectance};
    use crate::splatting::supersampling::tests::supersampled;
    use crate::transport::test_boxes::{Builder, lambert};
    use std::sync::Arc;

    /// A lamp over a mirror, whose light a screen above gets once more from the lamp's image.
    fn world(albedo: f32) -> World {
        let mut b = Builder::default();
        let mirror = b.material(Model::Mirror { specular: Reflectance::constant(Vec3::splat(0.8)) });
        let screen = b.material(lambert(albedo));
        b.rectangle(Vec3::ZERO, Vec3::X * 4.0, Vec3::Y * 4.0, mirror);
        b.rectangle(Vec3::Z * 2.0, Vec3::Y, Vec3::X, screen);
        let mut scene = b.scene();
        scene.lights = vec![Light::Point { position: Vec3::Z, intensity: Vec3::ONE, range: f32::INFINITY }];
        World::new(Arc::new(scene), Arc::new(Uniform(Vec3::ZERO)))
    }

    /// The screen, seen from beside the lamp.
    fn frame() -> CameraFrame {
        let eye = Vec3::new(0.0, 0.5, 0.5);
        Camera { eye, target: Vec3::Z * 2.0, up: Vec3::Y, fov_y: 0.8 }.frame(24, 16)
    }

    fn sums(runs: impl Iterator<Item = u32>) -> LightSums {
        let (world, frame) = (world(ALBEDO), frame());
        let mut sums = LightSums::new(&world, 24 * 16);
        runs.for_each(|run| sums.add(&trace_run(&world, &frame, run, 1, &|| true).expect("it goes on")));
        sums
    }

    /// So little that what the screen sends back to itself over the mirror is nothing.
    const ALBEDO: f32 = 0.01;

    /// Mean radiance of the screen under the lamp with this share, and its image at distance 3.
    fn expected(straight: f32) -> f64 {
        let frame = frame();
        let of = |(x, y)| {
            let direction = frame.direction(x as f32 + 0.5, y as f32 + 0.5);
            let p = frame.eye + direction * ((2.0 - frame.eye.z) / direction.z);
            let r2 = p.truncate().length_squared();
            let by = |distance: f32| distance / (distance * distance + r2).sqrt().powi(3);
            let lit = p.x.abs() < 1.0 && p.y.abs() < 1.0;
            let e = if lit { straight * by(1.0) + 0.8 * by(3.0) } else { 0.0 };
            f64::from(ALBEDO * e / std::f32::consts::PI)
        };
        (0..16).flat_map(|y| (0..24).map(move |x| (x, y))).map(of).sum::<f64>() / 384.0
    }

    #[test]
    fn a_lamps_image_lights_the_screen_as_a_lamp_there_would() {
        let sums = sums(0..64);
        let found = (0..384).map(|i| f64::from(sums.diffuse(i, &[0, 1, 2, 3]).x)).sum::<f64>() / 384.0;
        assert!((found / expected(0.0) - 1.0).abs() < 0.01, "{found} {}", expected(0.0));
        assert!(sums.error(24, &ToneMap::default()) < 0.02);
    }

    /// Whatever a map says, and though paths do not find the image of the lamp.
    #[test]
    fn a_refined_picture_shows_it() {
        for map in [0.0, 3.0] {
            let world = world(ALBEDO).with_illumination(Arc::new(Uniform(Vec3::splat(map))));
            let (frame, mut buffers) = (frame(), FrameBuffers::new(24, 16));
            cpu_pass::draw(&world, &frame, Passes { texture_ids: false }, &mut buffers);
            let first = buffers.color.clone();
            let picture = supersampled(&world, &frame, &buffers, 1, 256, &first).picture;
            let found = picture.data().iter().map(|c| f64::from(c.x)).sum::<f64>() / 384.0;
            assert!((found / expected(1.0) - 1.0).abs() < 0.02, "{map}: {found} {}", expected(1.0));
        }
    }

    #[test]
    fn the_order_of_runs_does_not_matter() {
        assert_eq!(sums(0..8), sums((0..8).rev()));
        assert_eq!(runs_for(1, 128 * 128), 4);
        assert_eq!(runs_for(16, 128 * 128), 16);
        assert!(sums(0..3).error(24, &ToneMap::default()).is_infinite());
    }
}
