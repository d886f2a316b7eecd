//! The display pass on the processor: primary rays through the same BVH, sixteen at a time, and so the
//! shadow rays from where they end to lights without area.

mod sparse;

use glam::Vec3;
use rayon::prelude::*;

use super::{FrameBuffers, PrimaryHit, TextureLevel};
use crate::geometry::packet::LANES;
use crate::geometry::{Hit, Ray};
use crate::scene::Scene;
use crate::scene::camera::CameraFrame;
use crate::transport::gather::together::LastShadows;
use crate::transport::interaction::Interaction;
use crate::transport::surface::SurfacePoint;
use crate::world::World;

/// Pixels along an edge of one packet: 4 × 4, so that rays stay close.
const PACKET: usize = 4;
/// Pixels along an edge of a block, of which each pixel has its bits whatever else is drawn; and rows that one parallel
/// task draws.
const BLOCK: usize = 8;

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

/// The same, where `cell` is 2 with a quarter of the rays at least, and as many more as the picture asks for: sixteen in each
/// block of 8 × 8 pixels, and one for each pixel between those that do not agree. What lies between rays that do is
/// interpolated (`sparse`). Where `cell` is 4, pixels between those that do not agree show what the nearest of them shows.
///
/// # Panics
/// If the sizes differ, or `cell` is none of [`CELLS`]: a bug of the caller.
pub fn draw_in_cells(
    world: &World,
    frame: &CameraFrame,
    passes: Passes,
    cell: u32,
    buffers: &mut FrameBuffers,
) -> Rays {
    assert!(CELLS.contains(&cell), "pictures are drawn whole, sparsely or coarsely");
    buffers.cell = cell;
    let [width, height] = frame.size.map(|s| s as usize);
    assert_eq!([buffers.width(), buffers.height()], [width, height], "buffers of the frame's size");
    let band = BLOCK * width;
    let FrameBuffers { cell: _, color, depth, object, texture, hit } = buffers;
    let textures: Vec<&mut [TextureLevel]> = if passes.texture_ids {
        texture.data_mut().chunks_mut(band).collect()
    } else {
        (0..height.div_ceil(BLOCK)).map(|_| <&mut [TextureLevel]>::default()).collect()
    };
    color
        .data_mut()
        .par_chunks_mut(band)
        .zip(depth.data_mut().par_chunks_mut(band))
        .zip(object.data_mut().par_chunks_mut(band))
        .zip(hit.data_mut().par_chunks_mut(band))
        .zip(textures)
        .enumerate()
        .map(|(b, ((((color, depth), object), hit), texture))| {
            let rows = color.len() / width;
            let mut last = LastShadows::default();
            let mut show = |x: usize, row: usize, surface: &Surface| {
                let i = row * width + x;
                hit[i] = surface.hit;
                color[i] = surface.color;
                depth[i] = surface.depth;
                object[i] = surface.object;
                if let Some(texture) = texture.get_mut(i) {
                    *texture = surface.texture;
                }
            };
            let band = Band { world, frame, top: b * BLOCK, rows, texture_ids: passes.texture_ids };
            let blocks = (0..width).step_by(BLOCK);
            blocks.map(|left| band.block(cell, left, &mut last, &mut show)).fold(Rays::default(), Rays::and)
        })
        .reduce(Rays::default, Rays::and)
}

/// How densely a picture may be drawn ([`FrameBuffers::cell`]).
pub const CELLS: [u32; 3] = [1, 2, 4];

/// Rays that a picture took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rays {
    /// Rays traced.
    pub traced: usize,
    /// Pixels of a coarse picture that would have a ray of their own in a sparse one.
    pub saved: usize,
}

impl Rays {
    fn and(self, other: Self) -> Self {
        Self { traced: self.traced + other.traced, saved: self.saved + other.saved }
    }
}

/// Some rows of a picture, which are drawn block by block. Pixels are told by column, and row in the band.
struct Band<'a> {
    world: &'a World,
    frame: &'a CameraFrame,
    /// Its first row.
    top: usize,
    /// Its rows, at most [`BLOCK`].
    rows: usize,
    texture_ids: bool,
}

impl Band<'_> {
    /// Draws the block that begins at column `left`, tells pixel and surface of each, and says how many rays it took.
    #[inline]
    fn block(
        &self,
        cell: u32,
        left: usize,
        last: &mut LastShadows,
        tell: &mut impl FnMut(usize, usize, &Surface),
    ) -> Rays {
        if cell > 1 {
            return sparse::block(self, left, cell > 2, last, tell);
        }
        let mut rays = 0;
        let right = (left + BLOCK).min(self.width());
        for row in (0..self.rows).step_by(PACKET) {
            for x in (left..right).step_by(PACKET) {
                rays += self.packet(|lane| self.inside([x + lane % PACKET, row + lane / PACKET]), last, tell);
            }
        }
        Rays { traced: rays, saved: 0 }
    }

    fn width(&self) -> usize {
        self.frame.size[0] as usize
    }

    /// The pixel, and that it is shown; for one beyond the picture's edge the last one, and that it is not.
    fn inside(&self, [x, row]: [usize; 2]) -> ([usize; 2], bool) {
        let pixel = [x.min(self.width() - 1), row.min(self.rows - 1)];
        (pixel, pixel == [x, row])
    }

    /// What one packet of pixels shows: tells pixel and surface of each that is shown. In which packet a ray goes decides
    /// its last bits.
    #[inline(always)] // a call for each pixel otherwise: a tenth of the pass
    fn packet(
        &self,
        pixel: impl Fn(usize) -> ([usize; 2], bool),
        last: &mut LastShadows,
        tell: &mut impl FnMut(usize, usize, &Surface),
    ) -> usize {
        let Self { world, frame, top, rows: _, texture_ids } = *self;
        let directions: [Vec3; LANES] = std::array::from_fn(|lane| {
            let ([x, row], _) = pixel(lane);
            self.direction(x, top + row)
        });
        let hits = world.accel.intersect_packet(&world.scene, frame.eye, &directions);
        // Where nobody asks for shadows, nothing is gained by company.
        let together = world.lights.has_any_named().then(|| {
            let hits = std::array::from_fn(|lane| hits[lane].filter(|_| pixel(lane).1));
            shade(world, frame, &directions, &hits, texture_ids, last)
        });
        let mut rays = 0;
        for lane in 0..LANES {
            let ([x, row], is_shown) = pixel(lane);
            if !is_shown {
                continue;
            }
            rays += 1;
            let alone;
            let surface = if let Some(surfaces) = &together {
                &surfaces[lane]
            } else {
                alone = shade_alone(world, frame, directions[lane], hits[lane], texture_ids);
                &alone
            };
            tell(x, row, surface);
        }
        rays
    }

    /// Where the primary ray of a pixel of the picture goes.
    fn direction(&self, x: usize, y: usize) -> Vec3 {
        self.frame.direction(x as f32 + 0.5, y as f32 + 0.5)
    }
}

/// A view that is drawn where somebody looks, in blocks that hold whole packets: each pixel has the bits that
/// [`draw_in_cells`] gives it. Textures are not told.
pub struct PartlyDrawn {
    frame: CameraFrame,
    buffers: FrameBuffers,
    /// By block, in rows.
    drawn: Vec<bool>,
}

impl PartlyDrawn {
    /// Nothing of a view that is drawn like [`draw_in_cells`] with this `cell`.
    ///
    /// # Panics
    /// If it is none of [`CELLS`]: a bug of the caller.
    pub fn new(frame: CameraFrame, cell: u32) -> Self {
        assert!(CELLS.contains(&cell), "pictures are drawn whole, sparsely or coarsely");
        let [width, height] = frame.size.map(|s| s as usize);
        let mut buffers = FrameBuffers::new(width, height);
        buffers.cell = cell;
        Self { frame, buffers, drawn: vec![false; width.div_ceil(BLOCK) * height.div_ceil(BLOCK)] }
    }

    /// Its camera.
    pub fn frame(&self) -> &CameraFrame {
        &self.frame
    }

    /// What is drawn so far; elsewhere there is nothing.
    pub fn buffers(&self) -> &FrameBuffers {
        &self.buffers
    }

    /// Draws what is around a pixel, if it is not yet there, and tells the pixel's object.
    ///
    /// # Panics
    /// If the pixel is not in the picture: a bug of the caller.
    pub fn object_at(&mut self, world: &World, x: usize, y: usize) -> u32 {
        let [width, height] = self.frame.size.map(|s| s as usize);
        let block = y / BLOCK * width.div_ceil(BLOCK) + x / BLOCK;
        if !std::mem::replace(&mut self.drawn[block], true) {
            let top = y / BLOCK * BLOCK;
            let FrameBuffers { cell, color, depth, object, texture: _, hit } = &mut self.buffers;
            let mut show = |x: usize, row: usize, surface: &Surface| {
                *hit.at_mut(x, top + row) = surface.hit;
                *color.at_mut(x, top + row) = surface.color;
                *depth.at_mut(x, top + row) = surface.depth;
                *object.at_mut(x, top + row) = surface.object;
            };
            let rows = BLOCK.min(height - top);
            let band = Band { world, frame: &self.frame, top, rows, texture_ids: false };
            band.block(*cell, x / BLOCK * BLOCK, &mut LastShadows::default(), &mut show);
        }
        self.buffers.object.at(x, y)
    }
}

/// What the display shows at one pixel.
#[derive(Clone, Copy)]
struct Surface {
    hit: PrimaryHit,
    color: Vec3,
    depth: f32,
    object: u32,
    texture: TextureLevel,
}

/// What a ray shows that goes from the eye along `direction` and ends at `hit`.
#[inline]
fn shade_alone(
    world: &World,
    frame: &CameraFrame,
    direction: Vec3,
    hit: Option<Hit>,
    texture_ids: bool,
) -> Surface {
    let Some(at) = hit else { return beyond(world, direction) };
    let footprint = at.t * frame.pixel_angle();
    let point = SurfacePoint::at(&world.scene, direction, &at, footprint);
    Surface {
        hit: hit.into(),
        color: world.tracer().base(&point, || {
            Interaction::at(&world.scene, &Ray::new(frame.eye, direction), &at).with_footprint(footprint)
        }),
        depth: at.t * direction.dot(frame.forward),
        object: world.scene.mesh.objects[at.triangle as usize],
        texture: if texture_ids { wanted_texture(&world.scene, &point) } else { TextureLevel::NONE },
    }
}

/// What a ray shows that meets nothing.
fn beyond(world: &World, direction: Vec3) -> Surface {
    let color = world.scene.environment.as_ref().map_or(Vec3::ZERO, |e| e.radiance(direction));
    Surface { hit: None.into(), color, depth: f32::INFINITY, object: 0, texture: TextureLevel::NONE }
}

/// What rays show that go from the eye along `directions` and end at `hits`: as each alone, their shadow rays together.
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
    let seen = |lane: usize| {
        let hit = hits[lane].expect("only points are asked for");
        (Ray::new(frame.eye, directions[lane]), hit)
    };
    let colors = world.tracer().base_together(&points, seen, last);
    std::array::from_fn(|lane| match (&hits[lane], &points[lane]) {
        (&Some(hit), Some(point)) => Surface {
            hit: Some(hit).into(),
            color: colors[lane],
            depth: hit.t * directions[lane].dot(frame.forward),
            object: world.scene.mesh.objects[hit.triangle as usize],
            texture: if texture_ids { wanted_texture(&world.scene, point) } else { TextureLevel::NONE },
        },
        _ => beyond(world, directions[lane]),
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
            Unnamed { rest: Vec3::ZERO, named: Some(Vec3::ZERO) }
        }
    }

    /// Whatever is drawn first, each pixel has the bits of the whole.
    #[test]
    fn parts_are_drawn_like_the_whole() {
        let world = checkered();
        let camera = Camera { eye: Vec3::new(0.1, 0.2, 0.9), target: Vec3::ZERO, up: Vec3::Y, fov_y: 1.2 };
        for ([width, height], cell) in
            [([41, 33], 1), ([40, 30], 2), ([1, 1], 1), ([7, 50], 2), ([33, 9], 2), ([41, 33], 4)]
        {
            let frame = camera.frame(width as u32, height as u32);
            let mut whole = FrameBuffers::new(width, height);
            draw_in_cells(&world, &frame, Passes { texture_ids: false }, cell, &mut whole);
            let mut parts = PartlyDrawn::new(frame, cell);
            for i in 0..width * height {
                // In an order that jumps.
                let i = (i * 7919) % (width * height);
                let (x, y) = (i % width, i / width);
                assert_eq!(parts.object_at(&world, x, y), whole.object.at(x, y));
                assert_eq!(parts.buffers().hit.at(x, y), whole.hit.at(x, y));
                assert_eq!(parts.buffers().color.at(x, y), whole.color.at(x, y));
            }
            assert_eq!(parts.buffers().depth.data(), whole.depth.data());
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
