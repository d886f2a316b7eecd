//! Where the samples of an element begin: points spread over the surface that it stands for.
//!
//! Sixteen candidates lie evenly over a texel, or over the thirds of the triangles around a vertex. A candidate that is
//! buried – no ray from it gets further than a texel, or it looks at the inside of a body – is not used unless all are: a
//! wall behind a cupboard must not darken the wall beside it.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::atlas::{Atlas, Corners};
use super::raster::{clipped_area, inside};
use crate::geometry::{Accel, Hit, Ray};
use crate::rng::{Stream, hash, unit_f32};
use crate::scene::{Mesh, Scene};
use crate::transport::bsdf::cosine_hemisphere;
use crate::transport::interaction::Interaction;

/// Points at most from which an element is sampled.
pub const CANDIDATES: u32 = 16;
/// Rays that tell whether a candidate is buried, and those by which an element is found not to be worth asking.
const RAYS: u32 = 4;
/// Sets candidates apart from all other random numbers.
const POINT: u64 = 0x0907;

/// How closely one looks whether candidates are buried.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// Whether any is free; then all are used.
    Brief,
    /// At a few of them, where few samples begin.
    Few,
    /// At each.
    Close,
}

impl Look {
    /// Candidates that are looked at, and used.
    fn candidates(self) -> u32 {
        if self == Self::Few { 4 } else { CANDIDATES }
    }
}

/// A point of a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Triangle.
    pub triangle: u32,
    /// Barycentric coordinate at its second corner.
    pub b1: f32,
    /// Barycentric coordinate at its third corner.
    pub b2: f32,
}

impl Point {
    /// As seen from straight in front of one of its sides, with the smooth normal: bumps are finer than what is stored.
    pub fn seen_from(&self, scene: &Scene, back: bool) -> Interaction {
        let &Self { triangle, b1, b2 } = self;
        let [a, b, c] = scene.mesh.corners(triangle);
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let out = if back { -normal } else { normal };
        let p = a * (1.0 - b1 - b2) + b * b1 + c * b2;
        let mut at = Interaction::at(scene, &Ray::new(p + out, -out), &Hit { t: 1.0, triangle, b1, b2 });
        at.shading_normal = scene.mesh.smooth_normal(triangle, b1, b2, at.geometric_normal);
        at
    }
}

/// The triangles that each element stands for.
#[derive(Clone, Debug, Default)]
pub struct Points {
    /// Per element where its entries begin; one more at the end.
    first: Vec<u32>,
    triangles: Vec<u32>,
}

impl Points {
    /// Of the elements of `atlas`.
    pub fn new(mesh: &Mesh, atlas: &Atlas) -> Self {
        // Dense meshes are most of them: no memory for each of their triangles.
        let texels: Vec<Vec<u32>> = (0..atlas.corners.len())
            .into_par_iter()
            .map(|t| match &atlas.corners[t] {
                Corners::Vertices(_) => Vec::new(),
                Corners::Texels(uv) => texels_of(atlas, uv),
            })
            .collect();
        let touched = || {
            atlas.corners.iter().zip(&texels).map(|(corners, texels)| match corners {
                Corners::Vertices(v) if atlas.elements[v[0] as usize].area > 0.0 => &v[..],
                Corners::Vertices(_) => &[],
                Corners::Texels(_) => texels,
            })
        };
        let mut first = vec![0u32; atlas.elements.len() + 1];
        touched().flatten().for_each(|&e| first[e as usize + 1] += 1);
        for i in 1..first.len() {
            first[i] += first[i - 1];
        }
        let mut next = first.clone();
        let mut triangles = vec![0; first.last().map_or(0, |&all| all as usize)];
        debug_assert_eq!(atlas.corners.len(), mesh.triangles.len());
        for (t, elements) in touched().enumerate() {
            for &e in elements {
                triangles[next[e as usize] as usize] = t as u32;
                next[e as usize] += 1;
            }
        }
        Self { first, triangles }
    }

    fn of(&self, element: u32) -> &[u32] {
        let [a, b] = [element, element + 1].map(|i| self.first[i as usize] as usize);
        &self.triangles[a..b]
    }

    /// Candidate `k` of an element; `None` where it lies beside the surface or in a hole of it.
    pub fn candidate(&self, scene: &Scene, atlas: &Atlas, element: u32, k: u32) -> Option<Point> {
        let of = self.of(element);
        let key = hash(POINT, element.into(), 0);
        let own = &atlas.elements[element as usize];
        let point = if k == 0 {
            // The middle of what is covered: slivers may have no other.
            Point { triangle: own.triangle, b1: own.b1, b2: own.b2 }
        } else if (element as usize) < atlas.texel_count() {
            let corner = Vec2::new((element % atlas.width) as f32, (element / atlas.width) as f32);
            let p = corner + spread(key, k);
            of.iter().find_map(|&triangle| {
                let Corners::Texels([a, b, c]) = atlas.corners[triangle as usize] else { return None };
                let doubled = (b - a).perp_dot(c - a);
                let (b1, b2) = ((p - a).perp_dot(c - a) / doubled, (b - a).perp_dot(p - a) / doubled);
                (b1 >= 0.0 && b2 >= 0.0 && b1 + b2 <= 1.0).then_some(Point { triangle, b1, b2 })
            })?
        } else {
            // In turn, so that each has some.
            let triangle = *of.get((key as usize).wrapping_add(k as usize) % of.len().max(1))?;
            let Corners::Vertices(v) = atlas.corners[triangle as usize] else { return None };
            let corner = v.iter().position(|&e| e == element)?;
            let p = spread(key, k / of.len().max(1) as u32);
            let root = p.x.sqrt();
            let mut b = [1.0 - root, root * (1.0 - p.y), root * p.y];
            // The third of the triangle that is nearest to the corner.
            let largest = (0..3).max_by(|&i, &j| b[i].total_cmp(&b[j])).unwrap_or(corner);
            b.swap(corner, largest);
            Point { triangle, b1: b[1], b2: b[2] }
        };
        scene.is_opaque_at(point.triangle, point.b1, point.b2).then_some(point)
    }

    /// Which candidates of one side of an element samples begin at, as bits; 0 where there is nothing to see of it.
    pub fn usable(
        &self,
        (scene, accel): (&Scene, &Accel),
        atlas: &Atlas,
        element: u32,
        back: bool,
        look: Look,
    ) -> u16 {
        let width = atlas.width_of(element);
        let at = |k: u32| self.candidate(scene, atlas, element, k);
        let covered: Vec<(u32, Point)> = (0..look.candidates()).filter_map(|k| Some((k, at(k)?))).collect();
        let bits = |of: &[(u32, Buried)], but: &dyn Fn(Buried) -> bool| {
            of.iter().filter(|(_, b)| but(*b)).fold(0u16, |bits, (k, _)| bits | 1 << k)
        };
        let key = hash(POINT, element.into(), 1 + u64::from(back));
        let looks = |k: u32, point: &Point, rays: u32| {
            buried((scene, accel), point, back, width, hash(key, k.into(), 0), rays)
        };
        // Most are free, as few rays show.
        let step = (covered.len() as u32).div_ceil(RAYS).max(1) as usize;
        let all = || covered.iter().fold(0, |bits, (k, _)| bits | 1 << k);
        let free = |(k, p): &(u32, Point)| looks(*k, p, 1) == Buried::Free;
        let suffices = match look {
            Look::Brief => covered.iter().any(free),
            Look::Few | Look::Close => covered.iter().step_by(step).all(free),
        };
        if suffices {
            return all();
        }
        let found: Vec<(u32, Buried)> = covered.iter().map(|(k, p)| (*k, looks(*k, p, RAYS))).collect();
        let free = bits(&found, &|b| b == Buried::Free);
        // Where most look at the inside of something it is wound the other way round, and seen so. A few do behind a board.
        let inside = bits(&found, &|b| b == Buried::Inside);
        let most = 8 * inside.count_ones() as usize >= 7 * found.len();
        if free != 0 || !most { free } else { inside }
    }
}

/// The texels that a triangle touches.
fn texels_of(atlas: &Atlas, uv: &[Vec2; 3]) -> Vec<u32> {
    let low = uv[0].min(uv[1]).min(uv[2]).max(Vec2::ZERO);
    let high = uv[0].max(uv[1]).max(uv[2]).max(Vec2::ZERO);
    let mut found = Vec::new();
    let is_inside = inside(uv);
    for y in low.y as u32..=(high.y as u32).min(atlas.height - 1) {
        for x in low.x as u32..=(high.x as u32).min(atlas.width - 1) {
            let corner = Vec2::new(x as f32, y as f32);
            if is_inside(corner) || clipped_area(uv, corner).0 > 0.0 {
                found.push(y * atlas.width + x);
            }
        }
    }
    found
}

/// Point `k` of a square, evenly spread (R₂ of Roberts 2018) and moved by `key`.
fn spread(key: u64, k: u32) -> Vec2 {
    const R2: [f32; 2] = [0.754_877_7, 0.569_840_3];
    let [u, v] = [unit_f32(key), unit_f32(key << 24)];
    Vec2::new((u + R2[0] * k as f32).fract(), (v + R2[1] * k as f32).fract())
}

/// What rays from a candidate found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Buried {
    /// At least half get away. Behind a board one may, through a gap.
    Free,
    /// Most end within a texel.
    Near,
    /// Most end within a texel or on the backs of triangles, and none gets away.
    Inside,
}

fn buried(
    (scene, accel): (&Scene, &Accel),
    point: &Point,
    back: bool,
    width: f32,
    key: u64,
    rays: u32,
) -> Buried {
    let at = point.seen_from(scene, back);
    let normal = at.facing_geometric();
    let (x, y) = normal.any_orthonormal_pair();
    let (mut free, mut backs) = (0, 0);
    for ray in 0..rays {
        let local = cosine_hemisphere(Stream::in_sequence(POINT, key, ray).next_2d());
        let way: Vec3 = (x * local.x + y * local.y + normal * local.z).normalize_or(normal);
        match accel.intersect(scene, &at.spawn(way)) {
            Some(hit) if is_transparent(scene, hit.triangle) => free += 1,
            Some(hit) if hit.t < width => {}
            Some(hit) if !back && shows_its_back(scene, hit.triangle, way) => backs += 1,
            _ => free += 1,
        }
    }
    match (free, backs) {
        _ if 2 * free >= rays => Buried::Free,
        (0, 1..) => Buried::Inside,
        _ => Buried::Near,
    }
}

fn is_transparent(scene: &Scene, triangle: u32) -> bool {
    scene.material_of(triangle).is_transparent()
}

fn shows_its_back(scene: &Scene, triangle: u32, way: Vec3) -> bool {
    let [a, b, c] = scene.mesh.corners(triangle);
    (b - a).cross(c - a).dot(way) > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illumination::atlas::ConformalCharts;
    use crate::illumination::test_scenes::{cube, grid, join, lambert, quad, scene};

    fn of(mesh: Mesh, texels: u32) -> (Scene, Accel, Atlas, Points) {
        let scene = scene(mesh, vec![lambert(0.5, 0.0)], Vec::new());
        let accel = Accel::build(&scene);
        let atlas = Atlas::build(&scene.mesh, texels, &|_| true, &|_| true, &ConformalCharts);
        let points = Points::new(&scene.mesh, &atlas);
        (scene, accel, atlas, points)
    }

    fn position(scene: &Scene, p: &Point) -> Vec3 {
        let [a, b, c] = scene.mesh.corners(p.triangle);
        a * (1.0 - p.b1 - p.b2) + b * p.b1 + c * p.b2
    }

    /// Points of a texel lie in it and spread over it; those of a vertex lie nearer to it than to others.
    #[test]
    fn points_lie_on_what_their_element_stands_for() {
        let mut mesh = quad(Vec3::ZERO, Vec3::X, Vec3::Y);
        join(&mut mesh, &grid(40, 40, |x, y| Vec3::new(2.0 + x, y, 0.0)), 0);
        let (scene, _, atlas, points) = of(mesh, 200);
        let (mut texels, mut vertices) = (0, 0);
        for e in (0..atlas.elements.len() as u32).filter(|e| atlas.elements[*e as usize].area > 0.0) {
            let width = atlas.width_of(e);
            let all: Vec<Vec3> = (0..CANDIDATES)
                .filter_map(|k| points.candidate(&scene, &atlas, e, k))
                .map(|p| position(&scene, &p))
                .collect();
            assert!(!all.is_empty(), "{e}");
            let reach = if (e as usize) < atlas.texel_count() { 0.75 } else { 2.0 };
            let center = atlas.elements[e as usize].position;
            assert!(all.iter().all(|p| p.distance(center) < reach * width), "{e}");
            if all.len() == CANDIDATES as usize {
                let mean = all.iter().sum::<Vec3>() / all.len() as f32;
                assert!(mean.distance(center) < 1.0 * width, "{e}: {mean} {center} {width}");
            }
            texels += u32::from((e as usize) < atlas.texel_count());
            vertices += u32::from((e as usize) >= atlas.texel_count());
        }
        assert!(texels > 50 && vertices > 1000, "{texels} {vertices}");
    }

    /// A box stands on a floor: what is under it is no part of the floor beside it.
    #[test]
    fn points_under_a_box_are_buried() {
        let mut mesh = quad(Vec3::new(-1.0, 0.0, 1.0), Vec3::X * 2.0, Vec3::NEG_Z * 2.0);
        join(&mut mesh, &cube(Vec3::new(-0.31, -0.01, -0.31), 0.62, true), 0);
        let (scene, accel, atlas, points) = of(mesh, 900);
        let under = |p: Vec3| p.x.abs() < 0.31 && p.z.abs() < 0.31;
        let mut mixed = 0;
        for e in 0..atlas.elements.len() as u32 {
            let element = &atlas.elements[e as usize];
            if element.area <= 0.0 || element.triangle > 1 {
                continue;
            }
            let usable = points.usable((&scene, &accel), &atlas, e, false, Look::Close);
            let at = |k: &u32| points.candidate(&scene, &atlas, e, *k).map(|p| position(&scene, &p));
            let all: Vec<(u32, Vec3)> = (0..CANDIDATES).filter_map(|k| Some((k, at(&k)?))).collect();
            let buried = all.iter().filter(|(_, p)| under(*p)).count();
            if buried == 0 {
                assert_eq!(usable.count_ones() as usize, all.len(), "{e}");
                let few = points.usable((&scene, &accel), &atlas, e, false, Look::Few);
                assert_eq!(few, usable & 0b1111, "{e}");
            } else if buried < all.len() {
                mixed += 1;
                let wrong = all.iter().filter(|(k, p)| under(*p) && usable >> k & 1 == 1).count();
                // Few looks may miss a corner.
                assert!(usable != 0 && wrong <= 1, "{e}: {wrong} of {buried}");
            }
        }
        assert!(mixed > 10, "{mixed}");
    }
}
