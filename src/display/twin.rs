//! The CPU twin of the display pass: primary rays through the same BVH, eight at a time.

use glam::Vec3;
use rayon::prelude::*;

use super::{FrameBuffers, PrimaryHit, TextureLevel};
use crate::geometry::Ray;
use crate::scene::camera::CameraFrame;
use crate::transport::interaction::Interaction;
use crate::world::World;

/// Pixels of one packet: 4 × 2, so that rays stay close.
const PACKET: [usize; 2] = [4, 2];
/// Rows that one parallel task draws.
const BAND: usize = 8;

/// What the plan of a scene lets the pass skip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Passes {
    /// Fill the texture-id pass (textures exceed their limit).
    pub texture_ids: bool,
}

/// The ray through a pixel's centre.
#[inline]
pub fn primary_ray(frame: &CameraFrame, x: u32, y: u32) -> Ray {
    Ray::new(frame.eye, frame.direction(x as f32 + 0.5, y as f32 + 0.5))
}

/// Draws a view into `buffers`, whose size must be the frame's.
///
/// # Panics
/// If the sizes differ: a bug of the caller.
pub fn draw(world: &World, frame: &CameraFrame, passes: Passes, buffers: &mut FrameBuffers) {
    let [width, height] = frame.size.map(|s| s as usize);
    assert_eq!([buffers.width(), buffers.height()], [width, height], "buffers of the frame's size");
    let band = BAND * width;
    let FrameBuffers { color, depth, object, texture, hit } = buffers;
    let textures: Vec<&mut [TextureLevel]> = if passes.texture_ids {
        texture.data_mut().chunks_mut(band).collect()
    } else {
        (0..height.div_ceil(BAND)).map(|_| <&mut [TextureLevel]>::default()).collect()
    };
    color
        .data_mut()
        .par_chunks_mut(band)
        .zip(depth.data_mut().par_chunks_mut(band))
        .zip(object.data_mut().par_chunks_mut(band))
        .zip(hit.data_mut().par_chunks_mut(band))
        .zip(textures)
        .enumerate()
        .for_each(|(b, ((((color, depth), object), hit), texture))| {
            let rows = color.len() / width;
            let mut shade = |x: usize, row: usize, primary: PrimaryHit, direction: Vec3| {
                let i = row * width + x;
                hit[i] = primary;
                let surface = shade_pixel(world, frame, direction, primary, passes.texture_ids);
                color[i] = surface.color;
                depth[i] = surface.depth;
                object[i] = surface.object;
                if let Some(texture) = texture.get_mut(i) {
                    *texture = surface.texture;
                }
            };
            for row in (0..rows).step_by(PACKET[1]) {
                for x in (0..width).step_by(PACKET[0]) {
                    // Lanes beyond the picture's edge repeat the last pixel.
                    let pixel = |lane: usize| {
                        ((x + lane % PACKET[0]).min(width - 1), (row + lane / PACKET[0]).min(rows - 1))
                    };
                    let directions: [Vec3; 8] = std::array::from_fn(|lane| {
                        let (px, py) = pixel(lane);
                        frame.direction(px as f32 + 0.5, (b * BAND + py) as f32 + 0.5)
                    });
                    let hits = world.accel.intersect_packet(&world.scene, frame.eye, &directions);
                    for (lane, (&primary, &direction)) in hits.iter().zip(&directions).enumerate() {
                        let (px, py) = pixel(lane);
                        if px == x + lane % PACKET[0] && py == row + lane / PACKET[0] {
                            shade(px, py, primary.into(), direction);
                        }
                    }
                }
            }
        });
}

/// What the display shows at one pixel.
struct Surface {
    color: Vec3,
    depth: f32,
    object: u32,
    texture: TextureLevel,
}

fn shade_pixel(
    world: &World,
    frame: &CameraFrame,
    direction: Vec3,
    primary: PrimaryHit,
    texture_ids: bool,
) -> Surface {
    let _ = texture_ids;
    let Some(hit) = primary.hit() else {
        let color = world.scene.environment.as_ref().map_or(Vec3::ZERO, |e| e.radiance(direction));
        return Surface { color, depth: f32::INFINITY, object: 0, texture: TextureLevel::NONE };
    };
    let ray = Ray::new(frame.eye, direction);
    let interaction = Interaction::at(&world.scene, &ray, &hit);
    Surface {
        color: world.tracer().base(&interaction),
        depth: primary.t * direction.dot(frame.forward),
        object: world.scene.mesh.objects[primary.triangle as usize],
        texture: TextureLevel::NONE,
    }
}
