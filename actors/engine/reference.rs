//! The gold standards that walks are held against.

use foveal::display::FrameBuffers;
use foveal::display::twin::{self, Passes};
use foveal::geometry::Ray;
use foveal::image::Map2d;
use foveal::scene::camera::CameraFrame;
use foveal::splatting::supersampling::supersampled;
use foveal::splatting::trace::pixel_stream;
use foveal::world::World;
use glam::Vec3;
use rayon::prelude::*;

/// Every non-diffuse pixel traced, as a still view converges to; with more than one sample, what a converged view is
/// refined to: all pixels, through other points of each.
pub fn traced_picture(
    world: &World,
    frame: &CameraFrame,
    seed: u64,
    samples: u32,
    goes_on: &(dyn Fn() -> bool + Sync),
) -> Map2d<Vec3> {
    let [width, height] = frame.size.map(|s| s as usize);
    let mut buffers = FrameBuffers::new(width, height);
    twin::draw(world, frame, Passes { texture_ids: false }, &mut buffers);
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
            let ray = twin::primary_ray(frame, px, py);
            let at = twin::primary_interaction(world, frame, &ray, &hit);
            *out += tracer.view_dependent(&at, pixel_stream(seed, px, py, 0));
        }
    });
    if samples > 1 { supersampled(world, frame, &buffers, seed, samples, &picture, goes_on) } else { picture }
}

/// Path-traced picture, box-filtered over each pixel.
pub fn path_picture(
    world: &World,
    frame: &CameraFrame,
    seed: u64,
    samples: u32,
    goes_on: &(dyn Fn() -> bool + Sync),
) -> Map2d<Vec3> {
    let [width, height] = frame.size.map(|s| s as usize);
    let mut picture = Map2d::new(width, height, Vec3::ZERO);
    picture.data_mut().par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        if !goes_on() {
            return;
        }
        for (x, out) in row.iter_mut().enumerate() {
            let mut sum = Vec3::ZERO;
            for sample in 0..samples {
                let mut stream = pixel_stream(seed, x as u32, y as u32, u64::from(sample));
                let [dx, dy] = stream.next_2d();
                let ray = Ray::new(frame.eye, frame.direction(x as f32 + dx, y as f32 + dy));
                sum += world.path_radiance(&ray, stream.split(0));
            }
            *out = sum / samples as f32;
        }
    });
    picture
}
