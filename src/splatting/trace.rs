//! Samples traced through the pixels of a drawn view: the work of a tracer.

use glam::Vec3;

use super::filter::GoesOn;
use super::{Sample, SampleBatch};
use crate::display::FrameBuffers;
use crate::display::cpu_pass::{primary_interaction, primary_ray};
use crate::geometry::{Hit, Ray};
use crate::rng::Stream;
use crate::scene::MaterialId;
use crate::scene::camera::CameraFrame;
use crate::transport::interaction::Interaction;
use crate::transport::tracer::guide;
use crate::transport::tracer::witness::{Path, Scribe};
use crate::world::World;

/// The random numbers of a pixel: of the seed and the pixel alone, so that a still view converges to the
/// same picture whoever traces it and in whatever order.
pub fn pixel_stream(seed: u64, x: u32, y: u32, sample: u64) -> Stream {
    Stream::of_pixel(seed, x, y, sample)
}

/// What the samples belong to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Owner {
    /// The view (age of the camera).
    pub view: u32,
    /// Object id.
    pub object: u32,
    /// Level set of the lattice.
    pub k: u32,
}

/// Traces one sample through the centre of each pixel, from the hits that the display pass left.
pub fn trace_samples(
    world: &World,
    frame: &CameraFrame,
    buffers: &FrameBuffers,
    owner: Owner,
    pixels: impl Iterator<Item = (i32, i32)>,
    seed: u64,
) -> SampleBatch {
    let tracer = world.tracer();
    samples_with(world, frame, buffers, owner, pixels, |(x, y), at| {
        let base = buffers.color.at(x as usize, y as usize);
        Some(tracer.view_dependent(at, base, pixel_stream(seed, x as u32, y as u32, 0)))
    })
}

/// The colours alone of what [`trace_samples`] traces: all that cannot be known without tracing.
pub fn trace_colors(
    world: &World,
    frame: &CameraFrame,
    buffers: &FrameBuffers,
    pixels: impl Iterator<Item = (i32, i32)>,
    seed: u64,
) -> Vec<Vec3> {
    let tracer = world.tracer();
    let color = |(x, y): (i32, i32)| {
        let hit = buffers.hit.at(x as usize, y as usize).hit()?;
        let ray = primary_ray(frame, x as u32, y as u32);
        let at = primary_interaction(world, frame, &ray, &hit);
        let base = buffers.color.at(x as usize, y as usize);
        Some(tracer.view_dependent(&at, base, pixel_stream(seed, x as u32, y as u32, 0)))
    };
    pixels.filter_map(color).collect()
}

/// The samples that [`trace_samples`] traces, from their colours. Of another number of colours no batch is made.
pub fn samples_of_colors(
    world: &World,
    frame: &CameraFrame,
    buffers: &FrameBuffers,
    owner: Owner,
    pixels: impl Iterator<Item = (i32, i32)>,
    colors: &[Vec3],
) -> Option<SampleBatch> {
    let mut colors = colors.iter();
    let mut missing = false;
    let batch = samples_with(world, frame, buffers, owner, pixels, |_, _| {
        let color = colors.next().copied();
        missing |= color.is_none();
        color
    });
    (!missing && colors.next().is_none()).then_some(batch)
}

/// One sample through the centre of each pixel, from the hits that the display pass left, with the colour that `color`
/// says; none where it says none.
fn samples_with(
    world: &World,
    frame: &CameraFrame,
    buffers: &FrameBuffers,
    owner: Owner,
    pixels: impl Iterator<Item = (i32, i32)>,
    mut color: impl FnMut((i32, i32), &Interaction) -> Option<Vec3>,
) -> SampleBatch {
    let mut batch =
        SampleBatch::new(owner.view, owner.object, owner.k, pixels.size_hint().1.unwrap_or(0).min(4096));
    for (x, y) in pixels {
        let Some(hit) = buffers.hit.at(x as usize, y as usize).hit() else { continue };
        let ray = primary_ray(frame, x as u32, y as u32);
        let at = primary_interaction(world, frame, &ray, &hit);
        let normal =
            if at.shading_normal.dot(ray.direction) > 0.0 { -at.shading_normal } else { at.shading_normal };
        let Some(color) = color((x, y), &at) else { continue };
        batch.push(Sample {
            pixel: [x as u16, y as u16],
            position: at.position,
            normal,
            view: -ray.direction,
            color,
            pixel_width: hit.t * ray.direction.dot(frame.forward) * frame.pixel_angle(),
        });
    }
    batch
}

/// The sample of a pixel traced again, with its whole path; nothing where the pixel shows no surface.
pub fn retrace(
    world: &World,
    frame: &CameraFrame,
    buffers: &FrameBuffers,
    [x, y]: [u16; 2],
    seed: u64,
) -> Option<(Vec3, Path)> {
    let (px, py) = (u32::from(x), u32::from(y));
    let hit = buffers.hit.at(usize::from(x), usize::from(y)).hit()?;
    let at = primary_interaction(world, frame, &primary_ray(frame, px, py), &hit);
    let base = buffers.color.at(usize::from(x), usize::from(y));
    let tracer = world.tracer().told_to(Scribe::default());
    let color = tracer.view_dependent(&at, base, pixel_stream(seed, px, py, 0));
    Some((color, tracer.into_witness().path()))
}

/// What the guides of pixels show, from the hits that the display pass left: nothing where there is none.
pub fn trace_guides(
    world: &World,
    frame: &CameraFrame,
    buffers: &FrameBuffers,
    pixels: impl Iterator<Item = (i32, i32)>,
) -> Vec<Vec3> {
    let tracer = world.tracer();
    let guide = |(x, y): (i32, i32)| {
        let Some(hit) = buffers.hit.at(x as usize, y as usize).hit() else { return Vec3::ZERO };
        let ray = primary_ray(frame, x as u32, y as u32);
        tracer.guide(&primary_interaction(world, frame, &ray, &hit))
    };
    pixels.map(guide).collect()
}

/// Guides along an edge of a pixel whose mean is asked for.
const GUIDES_ALONG: u32 = 2;

/// The mean of what guides show in each pixel, row by row, where it is `known` and shows a mirror, glass or a smooth coat in
/// its middle; nothing elsewhere. `None` where that was not to go on.
pub(super) fn mean_guides(
    world: &World,
    frame: &CameraFrame,
    buffers: &FrameBuffers,
    known: impl Fn(usize) -> bool,
    goes_on: GoesOn<'_>,
) -> Option<Vec<Vec3>> {
    let (scene, tracer, width) = (&world.scene, world.tracer(), buffers.width());
    let is_sharp: Vec<bool> =
        (0..scene.materials.len() as u32).map(|m| guide::is_sharp(scene, MaterialId(m))).collect();
    let is_followed = |hit: &Hit| is_sharp[scene.mesh.materials[hit.triangle as usize].0 as usize];
    let mut guides = vec![Vec3::ZERO; width * buffers.height()];
    if !is_sharp.contains(&true) {
        return Some(guides);
    }
    let guide = |x: f32, y: f32| {
        let ray = Ray::new(frame.eye, frame.direction(x, y));
        match world.accel.intersect_seen(scene, &ray).filter(is_followed) {
            Some(hit) => tracer.guide(&primary_interaction(world, frame, &ray, &hit)),
            None => Vec3::ZERO,
        }
    };
    let places = || (0..GUIDES_ALONG).map(|i| (i as f32 + 0.5) / GUIDES_ALONG as f32);
    for (y, row) in guides.chunks_mut(width.max(1)).enumerate() {
        if !goes_on() {
            return None;
        }
        for (x, mean) in row.iter_mut().enumerate().filter(|(x, _)| known(y * width + x)) {
            if buffers.hit.at(x, y).hit().as_ref().is_some_and(is_followed) {
                let all = places().flat_map(|dy| places().map(move |dx| (x as f32 + dx, y as f32 + dy)));
                *mean = all.map(|(x, y)| guide(x, y)).sum::<Vec3>() / (GUIDES_ALONG * GUIDES_ALONG) as f32;
            }
        }
    }
    Some(guides)
}
