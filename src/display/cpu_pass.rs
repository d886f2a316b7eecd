//! The display pass on the processor: primary rays through the same BVH, sixteen at a time, and so the
//! shadow rays from where they end to lights without area.

use glam::Vec3;
use rayon::prelude::*;

use super::{FrameBuffers, PrimaryHit, TextureLevel};
use crate::geometry::packet::LANES;
use crate::geometry::{Hit, Ray};
use crate::scene::camera::CameraFrame;
use crate::scene::{Environment, Scene};
use crate::transport::gather::LastShadows;
use crate::transport::interaction::Interaction;
use crate::transport::surface::SurfacePoint;
use crate::world::World;

/// Pixels of one packet: 4 × 4, so that rays stay close.
const PACKET: [usize; 2] = [4, 4];
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

/// Where a primary ray ends, seen through the cone of a pixel: what display and samples shade alike.
#[inline]
pub fn primary_interaction(world: &World, frame: &CameraFrame, ray: &Ray, hit: &Hit) -> Interaction {
    Interaction::at(&world.scene, ray, hit).with_footprint(hit.t * frame.pixel_angle())
}

/// The texture that makes a surface's picture, with the mip level wanted of it.
fn wanted_texture(scene: &Scene, at: &SurfacePoint) -> TextureLevel {
    let material = at.material(scene);
    let Some(map) = material.picture() else { return TextureLevel::NONE };
    TextureLevel::new(map, at.texture_level(&scene.textures[map.0 as usize]))
}

/// Draws a view into `buffers`, whose size must be the frame's.
///
/// # Panics
/// If the sizes differ: a bug of the caller.
pub fn draw(world: &World, frame: &CameraFrame, passes: Passes, buffers: &mut FrameBuffers) {
    draw_in_cells(world, frame, passes, 1, buffers);
}

/// The same with one ray for each square of `cell` by `cell` pixels, 1 or 2, which goes through its first pixel.
///
/// # Panics
/// If the sizes differ, or squares are of another size: a bug of the caller.
pub fn draw_in_cells(
    world: &World,
    frame: &CameraFrame,
    passes: Passes,
    cell: u32,
    buffers: &mut FrameBuffers,
) {
    assert!(cell == 1 || cell == 2, "bands hold whole packets of cells");
    buffers.cell = cell;
    let cell = cell as usize;
    let [width, height] = frame.size.map(|s| s as usize);
    assert_eq!([buffers.width(), buffers.height()], [width, height], "buffers of the frame's size");
    let band = BAND * width;
    let FrameBuffers { cell: _, color, depth, object, texture, hit } = buffers;
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
            let mut last = LastShadows::default();
            let mut show = |x: usize, row: usize, surface: &Surface| {
                for row in row..(row + cell).min(rows) {
                    for i in row * width + x..row * width + (x + cell).min(width) {
                        hit[i] = surface.hit;
                        color[i] = surface.color;
                        depth[i] = surface.depth;
                        object[i] = surface.object;
                        if let Some(texture) = texture.get_mut(i) {
                            *texture = surface.texture;
                        }
                    }
                }
            };
            for row in (0..rows).step_by(PACKET[1] * cell) {
                for x in (0..width).step_by(PACKET[0] * cell) {
                    let wanted = |lane: usize| (x + lane % PACKET[0] * cell, row + lane / PACKET[0] * cell);
                    // Lanes beyond the picture's edge repeat the last pixel.
                    let pixel = |lane: usize| {
                        let (px, py) = wanted(lane);
                        (px.min(width - 1), py.min(rows - 1))
                    };
                    let directions: [Vec3; LANES] = std::array::from_fn(|lane| {
                        let (px, py) = pixel(lane);
                        frame.direction(px as f32 + 0.5, (b * BAND + py) as f32 + 0.5)
                    });
                    let hits = world.accel.intersect_packet(&world.scene, frame.eye, &directions);
                    let is_wanted = |lane: usize| pixel(lane) == wanted(lane);
                    let hits = std::array::from_fn(|l| hits[l].filter(|_| is_wanted(l)));
                    let surfaces = shade(world, frame, &directions, &hits, passes.texture_ids, &mut last);
                    for lane in (0..LANES).filter(|&lane| is_wanted(lane)) {
                        let (px, py) = wanted(lane);
                        show(px, py, &surfaces[lane]);
                    }
                }
            }
        });
}

/// What the display shows at one pixel.
struct Surface {
    hit: PrimaryHit,
    color: Vec3,
    depth: f32,
    object: u32,
    texture: TextureLevel,
}

/// What rays show that go from the eye along `directions` and end at `hits`.
fn shade(
    world: &World,
    frame: &CameraFrame,
    directions: &[Vec3; LANES],
    hits: &[Option<Hit>; LANES],
    texture_ids: bool,
    last: &mut LastShadows,
) -> [Surface; LANES] {
    let footprint = |hit: &Hit| hit.t * frame.pixel_angle();
    let points = std::array::from_fn(|lane| {
        hits[lane].map(|hit| SurfacePoint::at(&world.scene, directions[lane], &hit, footprint(&hit)))
    });
    let at = |lane: usize| {
        let hit = hits[lane].expect("only points are asked for");
        Interaction::at(&world.scene, &Ray::new(frame.eye, directions[lane]), &hit)
            .with_footprint(footprint(&hit))
    };
    let colors = world.tracer().base_together(&points, at, last);
    std::array::from_fn(|lane| match (&hits[lane], &points[lane]) {
        (&Some(hit), Some(point)) => Surface {
            hit: Some(hit).into(),
            color: colors[lane],
            depth: hit.t * directions[lane].dot(frame.forward),
            object: world.scene.mesh.objects[hit.triangle as usize],
            texture: if texture_ids { wanted_texture(&world.scene, point) } else { TextureLevel::NONE },
        },
        _ => {
            let around = |e: &Environment| e.radiance(directions[lane]);
            let color = world.scene.environment.as_ref().map_or(Vec3::ZERO, around);
            let (hit, texture) = (None.into(), TextureLevel::NONE);
            Surface { hit, color, depth: f32::INFINITY, object: 0, texture }
        }
    })
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::illumination::{Irradiance, Uniform, Unnamed};
    use crate::math;
    use crate::scene::test_scenes::{add_box, grey, scene};
    use crate::scene::texture::MipChain;
    use crate::scene::{
        Camera, Distribution, Light, Mesh, Model, Reflectance, Roughness, Texture, TextureId,
    };

    /// A checker of single texels on all walls of a room; `Vec3::ONE` of light everywhere.
    fn checkered() -> World {
        let mut mesh = Mesh::default();
        add_box(&mut mesh, Vec3::splat(-1.0), Vec3::ONE, 0, true);
        for (uv, p) in mesh.uvs.iter_mut().zip(&mesh.positions) {
            *uv = glam::Vec2::new(p.x + p.z, p.y);
        }
        let texels = (0..256 * 256u32).map(|i| [[0, 255][((i + i / 256) % 2) as usize]; 4]).collect();
        let mut material = grey();
        material.model = Model::Lambert { albedo: Reflectance { color: Vec3::ONE, map: Some(TextureId(0)) } };
        let mut scene = scene(mesh, vec![material]);
        scene.textures.push(Texture::new("checker", MipChain::from_rgba8(256, 256, texels, true)));
        World::new(Arc::new(scene), Arc::new(Uniform(Vec3::splat(std::f32::consts::PI))))
    }

    /// Shadow rays that go together find what single ones find, to the bit: on whole surfaces and edges, through panes and
    /// holes, from lamps and suns.
    #[test]
    fn light_is_that_of_single_rays() {
        let mut mesh = Mesh::default();
        add_box(&mut mesh, Vec3::splat(-1.0), Vec3::ONE, 0, true);
        for i in 0..40 {
            let mut s = crate::rng::Stream::new(4, i, 0);
            let at = Vec3::new(s.next_f32(), s.next_f32(), s.next_f32()) * 1.6 - 0.8;
            add_box(
                &mut mesh,
                at,
                at + 0.15 * Vec3::new(s.next_f32(), s.next_f32(), 0.1),
                i as u32 % 3,
                false,
            );
        }
        let pane = Model::Dielectric {
            ior: 1.5,
            transmittance: Vec3::splat(0.9),
            thin: true,
            roughness: Roughness { alpha_x: 0.0, alpha_y: 0.0, distribution: Distribution::Ggx },
        };
        let mut hole = grey();
        hole.opacity = 0.0;
        let mut made = scene(mesh, vec![grey(), crate::scene::test_scenes::material("pane", pane), hole]);
        let lamp = |position: Vec3| Light::Point { position, intensity: Vec3::ONE, range: f32::INFINITY };
        let sun =
            Light::Directional { direction: Vec3::new(0.1, -1.0, 0.3).normalize(), irradiance: Vec3::ONE };
        made.lights = vec![lamp(Vec3::new(0.2, 0.9, 0.1)), sun, lamp(Vec3::new(-0.6, 0.0, 0.8))];
        let world = World::new(Arc::new(made), Arc::new(AskEverywhere));
        let camera = Camera { eye: Vec3::new(0.1, 0.2, 0.95), target: Vec3::ZERO, up: Vec3::Y, fov_y: 1.4 };
        let frame = camera.frame(101, 75);
        let mut buffers = FrameBuffers::new(101, 75);
        draw(&world, &frame, Passes { texture_ids: false }, &mut buffers);
        let (mut dark, mut lit) = (0, 0);
        for (x, y) in (0..75).flat_map(|y| (0..101).map(move |x| (x, y))) {
            let hit = buffers.hit.at(x, y).hit().expect("a closed room");
            let ray = primary_ray(&frame, x as u32, y as u32);
            let at = primary_interaction(&world, &frame, &ray, &hit);
            let single = world.tracer().base(&at.point(), || at);
            assert_eq!(
                buffers.color.at(x, y).to_array().map(f32::to_bits),
                single.to_array().map(f32::to_bits)
            );
            *(if single == Vec3::ZERO { &mut dark } else { &mut lit }) += 1;
        }
        assert!(dark > 20 && lit > 1000, "{dark} {lit}");
    }

    /// No light but that of lights to be asked.
    struct AskEverywhere;

    impl Irradiance for AskEverywhere {
        fn irradiance(&self, _: u32, _: f32, _: f32, _: bool) -> Vec3 {
            Vec3::ZERO
        }

        fn unnamed(&self, _: u32, _: f32, _: f32, _: bool) -> Unnamed {
            Unnamed { rest: Vec3::ZERO, is_lit: true }
        }
    }

    /// Cells show their first pixel, to the picture's edges, and nothing else is there.
    #[test]
    fn cells_are_drawn_like_their_first_pixel() {
        let world = checkered();
        let camera = Camera { eye: Vec3::new(0.1, 0.2, 0.9), target: Vec3::ZERO, up: Vec3::Y, fov_y: 1.2 };
        for [width, height] in [[40, 30], [41, 33], [1, 1], [7, 50]] {
            let frame = camera.frame(width as u32, height as u32);
            let [mut fine, mut coarse] = [(); 2].map(|()| FrameBuffers::new(width, height));
            draw(&world, &frame, Passes { texture_ids: true }, &mut fine);
            draw_in_cells(&world, &frame, Passes { texture_ids: true }, 2, &mut coarse);
            assert_eq!([fine.cell, coarse.cell], [1, 2]);
            for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
                let (fx, fy) = (x / 2 * 2, y / 2 * 2);
                // Rays of other packets meet other last bits.
                let apart = (coarse.color.at(x, y) - fine.color.at(fx, fy)).abs().max_element();
                assert!(apart < 1e-3, "{width} {height}: {x} {y}");
                assert!((coarse.depth.at(x, y) - fine.depth.at(fx, fy)).abs() < 1e-4);
                assert_eq!(coarse.object.at(x, y), fine.object.at(fx, fy));
                assert_eq!(coarse.texture.at(x, y).texture(), fine.texture.at(fx, fy).texture());
                assert_eq!(coarse.hit.at(x, y).triangle, fine.hit.at(fx, fy).triangle);
            }
        }
    }

    #[test]
    fn what_is_smaller_than_a_pixel_is_averaged_and_its_level_known() {
        let world = checkered();
        let camera = Camera { eye: Vec3::new(0.0, 0.0, 0.9), target: Vec3::ZERO, up: Vec3::Y, fov_y: 1.2 };
        let frame = camera.frame(40, 30);
        let mut buffers = FrameBuffers::new(40, 30);
        draw(&world, &frame, Passes { texture_ids: true }, &mut buffers);
        let (color, wanted) = (buffers.color.at(20, 15), buffers.texture.at(20, 15));
        assert!((color - Vec3::splat(0.5)).abs().max_element() < 0.01, "{color}");
        let ray = primary_ray(&frame, 20, 15);
        let at = primary_interaction(&world, &frame, &ray, &buffers.hit.at(20, 15).hit().unwrap());
        let level = math::log2(at.footprint * at.uv_density * 256.0);
        assert!(level > 3.0 && (wanted.level() - level).abs() < 0.13, "{wanted:?} {level}");
        assert_eq!(wanted.texture(), Some(TextureId(0)));
        draw(&world, &frame, Passes { texture_ids: false }, &mut buffers);
        assert_eq!(buffers.color.at(20, 15), color);
    }
}
