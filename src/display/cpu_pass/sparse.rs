//! Blocks of which not each pixel has a ray: what lies between rays that agree is interpolated, and what lies between
//! others has its own. Edges of objects are where they are in the whole picture, to the pixel, but for what is thinner
//! than the rays are apart (two or three pixels); so are edges of diffuse surfaces, which share an id, where they show.

use glam::{Vec3, Vec4};

use super::{BLOCK, Band, PACKET, Rays, Surface, beyond};
use crate::display::PrimaryHit;
use crate::display::tone::ToneMap;
use crate::image::luminance;
use crate::transport::gather::together::LastShadows;

/// Columns and rows of a block where rays go first: its edges among them, so that a block needs nothing of its
/// neighbours.
const FIRST: [usize; PACKET] = [0, 2, 5, 7];
/// Columns or rows that lie between the same two of [`FIRST`], which are told by number: each, and how far it is from one to
/// the other.
type Span = ([usize; 2], &'static [(usize, f32)]);
const SPANS: [Span; 7] = [
    ([0, 0], &[(0, 0.0)]),
    ([0, 1], &[(1, 1.0 / 2.0)]),
    ([1, 1], &[(2, 0.0)]),
    ([1, 2], &[(3, 1.0 / 3.0), (4, 2.0 / 3.0)]),
    ([2, 2], &[(5, 0.0)]),
    ([2, 3], &[(6, 1.0 / 2.0)]),
    ([3, 3], &[(7, 0.0)]),
];
/// Colours agree that differ by less than this share of the light there is.
const TOLERANCE: f32 = 1.0 / 4.0;
/// Share of display white that is added to it, for in the dark a difference is seen less (the TVI function flattens).
const DARK: f32 = 1.0 / 64.0;

/// Draws a block as [`Band::block`] does; where it is to be coarse, with no rays but the first.
pub(super) fn block(
    band: &Band<'_>,
    left: usize,
    is_coarse: bool,
    last: &mut LastShadows,
    tell: &mut impl FnMut(usize, usize, &Surface),
) -> Rays {
    let (columns, rows) = (BLOCK.min(band.width() - left), band.rows);
    let mut first = [None; PACKET * PACKET];
    let number = |x: usize| FIRST.iter().position(|&f| f == x).expect("a packet's pixel");
    let mut keep = |x: usize, row: usize, surface: &Surface| {
        first[number(row) * PACKET + number(x - left)] = Some(*surface);
        tell(x, row, surface);
    };
    let grid = |lane: usize| band.inside([left + FIRST[lane % PACKET], FIRST[lane / PACKET]]);
    let mut rays = band.packet(grid, last, &mut keep);
    let near = Near::of(band);
    let is_even = near.is_even(&first);
    // A bit for each pixel that has a ray of its own.
    let (mut open, mut saved) = (0u64, 0);
    for (lines, down) in SPANS {
        for (sides, aside) in SPANS {
            if lines[0] == lines[1] && sides[0] == sides[1] {
                continue;
            }
            let pixels = down.iter().flat_map(|down| aside.iter().map(move |aside| (*aside, *down)));
            let shown = pixels.filter(|((column, _), (row, _))| *column < columns && *row < rows);
            let corner = |i: usize| first[lines[i / 2] * PACKET + sides[i % 2]].as_ref();
            let corners = || Some([corner(0)?, corner(1)?, corner(2)?, corner(3)?]);
            let agreed = corners().and_then(|corners| Some((corners, near.agreed(&corners, is_even)?)));
            let Some((corners, agreed)) = agreed else {
                if is_coarse {
                    for ((column, aside), (row, down)) in shown {
                        // Of the nearest those beyond the picture's edge are not there, the first always is.
                        let nearest = corner(usize::from(aside > 0.5) + 2 * usize::from(down > 0.5));
                        if let Some(surface) = nearest.or_else(|| corner(0)) {
                            tell(left + column, row, surface);
                            saved += 1;
                        }
                    }
                    continue;
                }
                open |= shown.fold(0, |open, ((column, _), (row, _))| open | 1 << (row * BLOCK + column));
                continue;
            };
            for ((column, aside), (row, down)) in shown {
                let direction = || band.direction(left + column, band.top + row);
                match near.between(band, &direction, (&corners, agreed), [aside, down]) {
                    Some(surface) => tell(left + column, row, &surface),
                    None => open |= 1 << (row * BLOCK + column),
                }
            }
        }
    }
    let mut pixels = [[0; 2]; PACKET * PACKET];
    while open != 0 {
        let mut count = 0;
        while open != 0 && count < pixels.len() {
            let pixel = open.trailing_zeros() as usize;
            open &= open - 1;
            pixels[count] = [left + pixel % BLOCK, pixel / BLOCK];
            count += 1;
        }
        // Lanes without a pixel go with the last one.
        let pixel = |lane: usize| (pixels[lane.min(count - 1)], lane < count);
        rays += band.packet(pixel, last, tell);
    }
    Rays { traced: rays, saved }
}

/// What four rays agree on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Agreed {
    /// They meet nothing.
    Beyond,
    /// They meet one triangle.
    Triangle,
    /// They meet one object.
    Object,
}

/// What surfaces must have in common for that between them to be interpolated.
struct Near {
    /// Light that is added to what is compared.
    dark: f32,
}

impl Near {
    fn of(band: &Band<'_>) -> Self {
        Self { dark: DARK * ToneMap::from(&band.world.scene.display).white() }
    }

    /// Whether what all rays of a block show is so alike that any four of them agree.
    fn is_even(&self, first: &[Option<Surface>; PACKET * PACKET]) -> bool {
        let Some(one) = &first[0] else { return false };
        let (mut least, mut most, mut is_one) = (one.color, one.color, true);
        for surface in first {
            let Some(surface) = surface else { return false };
            is_one &= surface.object == one.object && !surface.hit.is_miss() && surface.color.is_finite();
            (least, most) = (least.min(surface.color), most.max(surface.color));
        }
        // The brightest of any four are no darker than the darkest of all.
        is_one && self.are_alike(least, most, least)
    }

    /// Whether colours from `least` to `most` differ little beside one of them.
    #[inline]
    fn are_alike(&self, least: Vec3, most: Vec3, beside: Vec3) -> bool {
        (most - least).max_element() <= TOLERANCE * (luminance(beside) + self.dark)
    }

    /// What the corners of a rectangle agree on, if they do; `is_even`: what is known of all of the block.
    #[inline]
    fn agreed(&self, corners: &[&Surface; 4], is_even: bool) -> Option<Agreed> {
        let [one, others @ ..] = corners;
        if !is_even {
            if corners.iter().any(|c| c.hit.is_miss()) {
                // What is beyond a scene is known everywhere.
                return corners.iter().all(|c| c.hit.is_miss()).then_some(Agreed::Beyond);
            }
            if others.iter().any(|c| c.object != one.object) {
                return None;
            }
            let [a, b, c, d] = corners.map(|c| c.color);
            let (least, most) = (a.min(b).min(c).min(d), a.max(b).max(c).max(d));
            // What is not a number, or without bound, agrees with nothing: it would be spread over what lies around it.
            let are_finite = a.is_finite() && b.is_finite() && c.is_finite() && d.is_finite();
            if !are_finite || !self.are_alike(least, most, most) {
                return None;
            }
        }
        let is_one_triangle = others.iter().all(|c| c.hit.triangle == one.hit.triangle);
        Some(if is_one_triangle { Agreed::Triangle } else { Agreed::Object })
    }

    /// What is seen along `direction`, which lies between the four corners of a rectangle that agree, `aside` from left to
    /// right and `down` from top to bottom, as shares of its sides. `None` where that is nowhere.
    #[inline]
    fn between(
        &self,
        band: &Band<'_>,
        direction: &impl Fn() -> Vec3,
        (corners, agreed): (&[&Surface; 4], Agreed),
        [aside, down]: [f32; 2],
    ) -> Option<Surface> {
        if agreed == Agreed::Beyond {
            return Some(beyond(band.world, direction()));
        }
        let weights =
            [(1.0 - aside) * (1.0 - down), aside * (1.0 - down), (1.0 - aside) * down, aside * down];
        let nearest = corners[usize::from(aside > 0.5) + 2 * usize::from(down > 0.5)];
        let color = weights.iter().zip(corners).map(|(w, c)| *w * c.color).sum();
        if agreed == Agreed::Object {
            // A sample that goes on from the nearest hit begins less than two pixels beside its own.
            return Some(Surface { color, ..*nearest });
        }
        // On a plane the reciprocal of depth is linear in the picture, and so is what is linear on it over depth.
        let of = |value: &dyn Fn(&Surface) -> f32| Vec4::from_array(corners.map(value));
        let (weights, depths) = (Vec4::from_array(weights), of(&|c| c.depth));
        let mean = |weighted: Vec4| (weighted / depths).to_array().into_iter().sum::<f32>();
        let depth = mean(weights).recip();
        let hit = PrimaryHit {
            t: depth / direction().dot(band.frame.forward),
            triangle: nearest.hit.triangle,
            b1: depth * mean(weights * of(&|c| c.hit.b1)),
            b2: depth * mean(weights * of(&|c| c.hit.b2)),
        };
        let is_there = depth > 0.0 && hit.t.is_finite() && hit.b1.is_finite() && hit.b2.is_finite();
        is_there.then_some(Surface { hit, color, depth, ..*nearest })
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::display::FrameBuffers;
    use crate::display::cpu_pass::{Passes, draw, draw_in_cells};
    use crate::illumination::Uniform;
    use crate::scene::camera::CameraFrame;
    use crate::scene::test_scenes::{add_box, grey, material, scene};
    use crate::scene::texture::MipChain;
    use crate::scene::{
        Camera, Distribution, Mesh, Model, Reflectance, Roughness, Scene, Texture, TextureId,
    };
    use crate::world::World;

    const SIZES: [[usize; 2]; 5] = [[64, 48], [41, 33], [1, 1], [7, 50], [90, 3]];

    fn lit(scene: Scene) -> World {
        World::new(Arc::new(scene), Arc::new(Uniform(Vec3::splat(std::f32::consts::PI))))
    }

    /// A room around the eye, whose walls show `texels` of 256 × 256, magnified so many times.
    fn room(magnified: f32, texel: impl Fn(u32, u32) -> u8) -> World {
        let mut mesh = Mesh::default();
        add_box(&mut mesh, Vec3::splat(-1.0), Vec3::ONE, 0, true);
        for (uv, p) in mesh.uvs.iter_mut().zip(&mesh.positions) {
            *uv = glam::Vec2::new(p.x + p.z, p.y) / magnified;
        }
        let texels = (0..256 * 256u32).map(|i| [texel(i % 256, i / 256); 4]).collect();
        let mut wall = grey();
        wall.model = Model::Lambert { albedo: Reflectance { color: Vec3::ONE, map: Some(TextureId(0)) } };
        let mut scene = scene(mesh, vec![wall]);
        scene.textures.push(Texture::new("walls", MipChain::from_rgba8(256, 256, texels, true)));
        lit(scene)
    }

    fn view([width, height]: [usize; 2]) -> CameraFrame {
        let camera = Camera { eye: Vec3::new(0.1, 0.2, 0.9), target: Vec3::ZERO, up: Vec3::Y, fov_y: 1.2 };
        camera.frame(width as u32, height as u32)
    }

    /// The picture whole and sparsely, and how many rays the second one took.
    fn drawn(world: &World, [width, height]: [usize; 2]) -> (FrameBuffers, FrameBuffers, usize) {
        let frame = view([width, height]);
        let [mut whole, mut sparse] = [(); 2].map(|()| FrameBuffers::new(width, height));
        draw(world, &frame, Passes { texture_ids: true }, &mut whole);
        let rays = draw_in_cells(world, &frame, Passes { texture_ids: true }, 2, &mut sparse);
        assert_eq!([whole.cell, sparse.cell, rays.saved as u32], [1, 2, 0]);
        (whole, sparse, rays.traced)
    }

    fn pixels([width, height]: [usize; 2]) -> impl Iterator<Item = (usize, usize)> {
        (0..height).flat_map(move |y| (0..width).map(move |x| (x, y)))
    }

    fn is_near(a: f32, b: f32) -> bool {
        (a - b).abs() <= 2e-4 * (1.0 + b.abs())
    }

    #[test]
    fn a_wall_of_one_color_takes_a_quarter_of_the_rays_and_is_where_it_is() {
        let world = room(1.0, |_, _| 128);
        let (_, _, rays) = drawn(&world, [64, 48]);
        assert!(rays * 4 < 64 * 48 + 64 * 48 / 4, "edges of triangles take none: {rays}");
        for size in SIZES {
            let (whole, sparse, _) = drawn(&world, size);
            let mut exact = 0;
            for (x, y) in pixels(size) {
                assert_eq!(sparse.object.at(x, y), whole.object.at(x, y));
                assert_eq!(sparse.texture.at(x, y).texture(), whole.texture.at(x, y).texture());
                let apart = (sparse.color.at(x, y) - whole.color.at(x, y)).abs().max_element();
                assert!(apart < 1e-5, "{size:?} {x} {y}");
                let (mine, its) = (sparse.hit.at(x, y), whole.hit.at(x, y));
                let is_there = is_near(sparse.depth.at(x, y), whole.depth.at(x, y)) && is_near(mine.t, its.t);
                let is_same = mine.triangle == its.triangle;
                exact +=
                    usize::from(is_same && is_there && is_near(mine.b1, its.b1) && is_near(mine.b2, its.b2));
            }
            assert!(exact * 10 >= 8 * size[0] * size[1], "all but edges of triangles, {size:?}: {exact}");
        }
    }

    #[test]
    fn light_that_changes_evenly_is_interpolated_evenly() {
        let world = room(4.0, |x, _| (x / 2 + 64) as u8);
        let size = [128, 96];
        let (whole, sparse, rays) = drawn(&world, size);
        assert!(rays * 2 < size[0] * size[1], "{rays}");
        let error = |(x, y)| {
            let (mine, its) = (sparse.color.at(x, y), whole.color.at(x, y));
            (mine - its).abs().max_element() / (its.max_element() + DARK)
        };
        let errors: Vec<f32> = pixels(size).map(error).collect();
        let mean = errors.iter().sum::<f32>() / errors.len() as f32;
        let most = errors.into_iter().fold(0.0, f32::max);
        assert!(most < TOLERANCE && mean < 0.004, "{most} {mean}");
    }

    #[test]
    fn what_differs_from_pixel_to_pixel_has_a_ray_for_each() {
        // Texels of some pixels, none like its neighbour.
        let world = room(60.0, |x, y| if (x + y) % 2 == 0 { 10 } else { 250 });
        for size in SIZES {
            let (whole, sparse, rays) = drawn(&world, size);
            let all = size[0] * size[1];
            // In the smallest pictures a pixel covers many texels, and all are grey.
            assert!(rays <= all && (all < 1000 || rays * 10 >= 7 * all), "{size:?}: {rays}");
            let wrong = pixels(size).filter(|&(x, y)| {
                (sparse.color.at(x, y) - whole.color.at(x, y)).abs().max_element() > TOLERANCE
            });
            let wrong = wrong.count();
            assert!(wrong * 10 <= size[0] * size[1], "{size:?} {rays}: {wrong}");
        }
    }

    /// Things before a wall of their own colour: edges are those of the whole picture, and no id is made up.
    #[test]
    fn edges_of_objects_are_those_of_the_whole_picture() {
        let mut mesh = Mesh::default();
        add_box(&mut mesh, Vec3::splat(-1.0), Vec3::ONE, 0, true);
        for i in 0..12 {
            let mut s = crate::rng::Stream::new(9, i, 0);
            let at = Vec3::new(s.next_f32(), s.next_f32(), 0.3 * s.next_f32()) * 1.4 - 0.7;
            add_box(&mut mesh, at, at + 0.25, 1 + i as u32 % 2, false);
        }
        let pane = Model::Dielectric {
            ior: 1.5,
            transmittance: Vec3::splat(0.9),
            thin: true,
            roughness: Roughness { alpha_x: 0.0, alpha_y: 0.0, distribution: Distribution::Ggx },
        };
        let world = lit(scene(mesh, vec![grey(), material("one", pane.clone()), material("two", pane)]));
        let size = [128, 96];
        let (whole, sparse, rays) = drawn(&world, size);
        let ids: std::collections::HashSet<u32> = whole.object.data().iter().copied().collect();
        assert!(ids.len() > 2, "there are edges");
        assert!(rays * 3 < 2 * size[0] * size[1], "{rays}");
        let wrong = pixels(size).filter(|&(x, y)| sparse.object.at(x, y) != whole.object.at(x, y));
        assert!(wrong.count() * 500 <= size[0] * size[1], "corners that no ray of a block meets");
    }

    /// A coarse picture takes a quarter of the rays, whatever it shows, agrees with the sparse one where that has no more, and
    /// shows nothing that is not there within two pixels.
    #[test]
    fn a_coarse_picture_takes_no_more_rays_than_the_first() {
        let worlds = [
            room(60.0, |x, y| if (x + y) % 2 == 0 { 10 } else { 250 }),
            room(4.0, |x, _| (x / 2 + 64) as u8),
        ];
        for (world, size) in worlds.iter().flat_map(|world| SIZES.map(|size| (world, size))) {
            let (whole, sparse, rays) = drawn(world, size);
            let mut coarse = FrameBuffers::new(size[0], size[1]);
            let took = draw_in_cells(world, &view(size), Passes { texture_ids: true }, 4, &mut coarse);
            let first = |side: usize| (0..side).filter(|v| FIRST.contains(&(v % BLOCK))).count();
            assert_eq!(took.traced + took.saved, rays, "{size:?}: known without drawing it sparsely");
            assert_eq!(took.traced, first(size[0]) * first(size[1]), "{size:?}");
            let mut others = 0;
            for (x, y) in pixels(size) {
                others += usize::from(coarse.color.at(x, y) != sparse.color.at(x, y));
                let is_one_of = |(i, j)| whole.object.at(i, j) == coarse.object.at(x, y);
                let around = (y.saturating_sub(2)..(y + 3).min(size[1]))
                    .flat_map(|j| (x.saturating_sub(2)..(x + 3).min(size[0])).map(move |i| (i, j)));
                assert!({ around }.any(is_one_of) && coarse.color.at(x, y).is_finite(), "{size:?} {x} {y}");
            }
            assert!(others <= took.saved, "{size:?}: {others}");
        }
    }

    /// One corner that is not finite, whichever it is, leaves its neighbours to rays of their own.
    #[test]
    fn what_is_not_finite_is_not_spread() {
        let world = room(1.0, |_, _| 128);
        let (whole, _, _) = drawn(&world, [8, 8]);
        let frame = view([8, 8]);
        let band = Band { world: &world, frame: &frame, top: 0, rows: 8, texture_ids: false };
        let corner = Surface {
            hit: whole.hit.at(4, 4),
            color: Vec3::ONE,
            depth: whole.depth.at(4, 4),
            object: 0,
            texture: crate::display::TextureLevel::NONE,
        };
        let near = Near::of(&band);
        let between = |corners: &[Surface; 4]| {
            let corners = corners.each_ref();
            let agreed = near.agreed(&corners, false)?;
            near.between(&band, &|| band.direction(4, 4), (&corners, agreed), [0.5, 0.5])
        };
        assert!(between(&[corner; 4]).is_some());
        assert!(near.is_even(&[Some(corner); 16]) && !near.is_even(&[None; 16]));
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            for i in 0..4 {
                let mut corners = [corner; 4];
                corners[i].color.y = bad;
                assert!(between(&corners).is_none(), "{bad} {i}");
                let mut all = [Some(corner); 16];
                all[5 * i] = Some(corners[i]);
                assert!(!near.is_even(&all), "{bad} {i}");
            }
        }
    }

    /// What is decided for all of a block at once is what each of its rectangles decides.
    #[test]
    fn of_an_even_block_any_four_agree() {
        let world = room(1.0, |_, _| 128);
        let (whole, _, _) = drawn(&world, [8, 8]);
        let frame = view([8, 8]);
        let near = Near::of(&Band { world: &world, frame: &frame, top: 0, rows: 8, texture_ids: false });
        let mut even = 0;
        for turn in 0..4000 {
            let mut s = crate::rng::Stream::new(5, turn, 0);
            let (light, spread) = (4.0 * s.next_f32() * s.next_f32(), 0.6 * s.next_f32());
            let surface = |color| Surface {
                hit: whole.hit.at(4, 4),
                color,
                depth: whole.depth.at(4, 4),
                object: 0,
                texture: crate::display::TextureLevel::NONE,
            };
            let mut color =
                || Vec3::from_array(std::array::from_fn(|_| light * (1.0 - spread * s.next_f32())));
            let block: [Surface; 16] = std::array::from_fn(|_| surface(color()));
            if !near.is_even(&block.map(Some)) {
                continue;
            }
            even += 1;
            for i in (0..12).filter(|i| i % PACKET != PACKET - 1) {
                let corners = [i, i + 1, i + PACKET, i + PACKET + 1].map(|corner| &block[corner]);
                assert!(near.agreed(&corners, false).is_some(), "{turn} {i}");
            }
        }
        assert!((400..3600).contains(&even), "{even}");
    }

    /// Beyond a scene, where depth is infinite, nothing is interpolated.
    #[test]
    fn what_is_beyond_a_scene_is_known_without_rays() {
        let mut mesh = Mesh::default();
        add_box(&mut mesh, Vec3::splat(-0.2), Vec3::splat(0.2), 0, false);
        let size = [64, 48];
        let (whole, sparse, rays) = drawn(&lit(scene(mesh, vec![grey()])), size);
        assert!(rays * 2 < size[0] * size[1], "{rays}");
        for (x, y) in pixels(size) {
            assert_eq!(sparse.depth.at(x, y).is_finite(), !sparse.hit.at(x, y).is_miss());
            assert_eq!(sparse.hit.at(x, y).is_miss(), whole.hit.at(x, y).is_miss(), "{x} {y}");
        }
    }
}
