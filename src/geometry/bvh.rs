//! The geometry index: a BVH built by obvhs, traversed here. The only file that names obvhs.

use glam::{Vec3, Vec3A};
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::ploc::PlocBuilder;
use obvhs::{Boundable, BvhBuildParams};

use super::block::{CUT_OUT, PADDING};
use super::collapse::BinaryNode;
use super::packet::{self, LANES};
use super::shadow::{self, LastShadow, Meets, Shadows};
use super::split::{Part, split};
use super::wide::{LeafHit, Wide};
use super::{Hit, Ray};
use crate::scene::{Material, Scene};

/// Beyond this, surface areas overflow f32; boxes are cut there (and rays that far out miss).
const LARGEST: f32 = 1e18;

/// Index over all triangles of a scene.
#[derive(Clone, Debug, Default)]
pub struct Accel {
    pub(super) wide: Wide,
    /// Number of triangles in it.
    pub(super) count: usize,
    /// Whether a triangle may lie in several leaves.
    pub(super) is_split: bool,
}

impl Accel {
    /// Builds the index. Triangles with a corner that is not finite are left out; a scene without triangles is
    /// fine.
    pub fn build(scene: &Scene) -> Self {
        let mesh = &scene.mesh;
        let mut parts: Vec<Part> = Vec::with_capacity(mesh.triangles.len());
        for t in 0..mesh.triangles.len() as u32 {
            let [a, b, c] = mesh.corners(t);
            if !(a.is_finite() && b.is_finite() && c.is_finite()) {
                continue;
            }
            let cut = |v: Vec3| v.clamp(Vec3::splat(-LARGEST), Vec3::splat(LARGEST));
            parts.push(Part { min: cut(a.min(b).min(c)), max: cut(a.max(b).max(c)), triangle: t });
        }
        if parts.is_empty() {
            return Self::default();
        }
        let count = parts.len();
        let is_split = split(&mut parts, |t| mesh.corners(t));
        let may_vanish = |m: &Material| m.opacity < 1.0 || m.opacity_map.is_some() || m.culled;
        let vanishing: Vec<bool> = scene.materials.iter().map(may_vanish).collect();
        let binary = depth_first(&build_binary(&parts), &parts);
        drop(parts);
        let triangle = |t: u32| {
            let flag = if vanishing[mesh.materials[t as usize].0 as usize] { CUT_OUT } else { 0 };
            (mesh.corners(t), t | flag)
        };
        Self { wide: Wide::new(binary, triangle), count, is_split }
    }

    /// Number of triangles.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there is nothing to hit.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// From now on with other instructions.
    #[cfg(test)]
    pub(super) fn set_level(&mut self, level: super::level::Level) {
        self.wide.set_level(level);
    }

    /// Bytes held.
    pub fn size_bytes(&self) -> usize {
        self.wide.size_bytes()
    }
}

impl Boundable for Part {
    fn aabb(&self) -> Aabb {
        let pad = self.min.abs().max(self.max.abs()).max_element() * PADDING + 1e-30;
        Aabb { min: Vec3A::from(self.min - pad), max: Vec3A::from(self.max + pad) }
    }
}

/// A tree with one part in each leaf.
fn build_binary(parts: &[Part]) -> Bvh2 {
    let params =
        if parts.len() > 1_500_000 { BvhBuildParams::fast_build() } else { BvhBuildParams::medium_build() };
    let mut bvh = PlocBuilder::with_capacity(parts.len()).build(
        params.ploc_search_distance,
        parts,
        (0..parts.len() as u32).collect::<Vec<_>>(),
        params.sort_precision,
        params.search_depth_threshold,
    );
    ReinsertionOptimizer::default().run(&mut bvh, 2.0 * params.reinsertion_batch_ratio, None);
    bvh
}

/// The tree's nodes in depth-first order; leaves hold their triangles.
fn depth_first(bvh: &Bvh2, parts: &[Part]) -> Vec<BinaryNode> {
    let mut nodes: Vec<BinaryNode> = Vec::with_capacity(bvh.nodes.len());
    // Those still to come, second children with the index of their parents.
    let mut open: Vec<(u32, Option<usize>)> = vec![(0, None)];
    while let Some((at, parent)) = open.pop() {
        let node = &bvh.nodes[at as usize];
        let (here, first) = (nodes.len(), node.first_index);
        if let Some(parent) = parent {
            nodes[parent].next = (here - parent) as u32;
        }
        let is_leaf = node.is_leaf();
        let next = if is_leaf {
            parts[bvh.primitive_indices[first as usize] as usize].triangle
        } else {
            open.extend([(first + 1, Some(here)), (first, None)]);
            0
        };
        let (min, max) = (Vec3::from(node.aabb().min), Vec3::from(node.aabb().max));
        nodes.push(BinaryNode { min, max, next, is_leaf });
    }
    nodes
}

impl Accel {
    /// The closest hit between the ray's bounds; of hits at one distance that of the lowest triangle. Cut-out
    /// surfaces are hit where they are there.
    pub fn intersect(&self, scene: &Scene, ray: &Ray) -> Option<Hit> {
        let mut closest: Option<Hit> = None;
        self.wide.traverse::<true>(ray, |found| {
            let Some(hit) = self.accepted(scene, ray, &found) else { return Some(f32::INFINITY) };
            if closest.is_none_or(|c| hit.t < c.t || hit.triangle < c.triangle) {
                closest = Some(hit);
            }
            Some(hit.t)
        });
        closest
    }

    /// The nearest hit of anything but one object.
    pub fn intersect_except(&self, scene: &Scene, ray: &Ray, object: u32) -> Option<Hit> {
        let mut closest: Option<Hit> = None;
        self.wide.traverse::<true>(ray, |found| {
            let hit = self.accepted(scene, ray, &found);
            let Some(hit) = hit.filter(|hit| scene.mesh.objects[hit.triangle as usize] != object) else {
                return Some(f32::INFINITY);
            };
            if closest.is_none_or(|c| hit.t < c.t || hit.triangle < c.triangle) {
                closest = Some(hit);
            }
            Some(hit.t)
        });
        closest
    }

    /// Whether anything stands between the ray's bounds. Stops at the first hit. Glass stands in the way too;
    /// whoever wants light to pass asks [`Accel::any_hit`].
    pub fn occluded(&self, scene: &Scene, ray: &Ray) -> bool {
        self.any_hit(scene, ray, |_| true)
    }

    /// Whether `blocks` is true of any hit between the ray's bounds. Visits hits in no order, each once, and
    /// stops at the first that blocks.
    pub fn any_hit(&self, scene: &Scene, ray: &Ray, mut blocks: impl FnMut(Hit) -> bool) -> bool {
        let mut blocked = false;
        let mut seen: Vec<u32> = Vec::new();
        self.wide.traverse::<false>(ray, |found| {
            let hit = self.accepted(scene, ray, &found).filter(|hit| !seen.contains(&hit.triangle));
            let Some(hit) = hit else { return Some(f32::INFINITY) };
            blocked = blocks(hit);
            if self.is_split && !blocked {
                seen.push(hit.triangle);
            }
            (!blocked).then_some(f32::INFINITY)
        });
        blocked
    }

    /// Which of sixteen rays, those that `lanes` has a bit for, something blocks: a hit that `blocks` is true of. Each finds
    /// what [`Self::any_hit`] finds; rays from neighbouring points to one light do so together. `last` remembers what
    /// threw the last shadow, for the next packet to the same light.
    pub fn shadows(
        &self,
        scene: &Scene,
        rays: &[Ray; LANES],
        lanes: u32,
        last: &mut LastShadow,
        blocks: impl Fn(&Hit) -> bool,
    ) -> Shadows {
        shadow::cast(&self.wide, rays, lanes, last, &|lane, found| match self.accepted(
            scene,
            &rays[lane],
            &found,
        ) {
            None => Meets::Nothing,
            Some(hit) if blocks(&hit) => Meets::Blocker,
            Some(_) => Meets::Other,
        })
    }

    /// The hit in the scene's terms, unless the ray ignores the triangle or it is cut out there.
    #[inline(always)]
    fn accepted(&self, scene: &Scene, ray: &Ray, found: &LeafHit) -> Option<Hit> {
        let LeafHit { t, triangle: flagged, b1, b2 } = *found;
        let triangle = flagged & !CUT_OUT;
        let is_there =
            triangle != ray.ignore && (flagged & CUT_OUT == 0 || scene.is_opaque_at(triangle, b1, b2));
        is_there.then_some(Hit { t, triangle, b1, b2 })
    }

    /// The closest hit of a ray that an eye at its origin looks along: through the backs of culled materials.
    pub fn intersect_seen(&self, scene: &Scene, ray: &Ray) -> Option<Hit> {
        let mut closest: Option<Hit> = None;
        self.wide.traverse::<true>(ray, |found| {
            let hit = self.accepted(scene, ray, &found);
            let Some(hit) = hit.filter(|hit| scene.faces(hit.triangle, ray.origin)) else {
                return Some(f32::INFINITY);
            };
            if closest.is_none_or(|c| hit.t < c.t || hit.triangle < c.triangle) {
                closest = Some(hit);
            }
            Some(hit.t)
        });
        closest
    }

    /// Closest hits of sixteen rays that an eye looks along, from one point along unit directions, through the backs of
    /// culled materials; of hits at one distance that of the lowest triangle.
    pub fn intersect_packet(
        &self,
        scene: &Scene,
        origin: Vec3,
        directions: &[Vec3; LANES],
    ) -> [Option<Hit>; LANES] {
        let is_there = |triangle: u32, b1: f32, b2: f32| {
            scene.is_opaque_at(triangle, b1, b2) && scene.faces(triangle, origin)
        };
        let hit = packet::intersect(&self.wide, origin, directions, &is_there);
        std::array::from_fn(|l| {
            let (t, triangle) = (hit.t[l], hit.triangle[l]);
            (t < f32::INFINITY).then_some(Hit { t, triangle, b1: hit.b1[l], b2: hit.b2[l] })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::level::Level;
    use super::*;
    use crate::math;
    use crate::rng::Stream;
    use crate::scene::test_scenes::of_triangles;

    fn sphere(rings: usize, scale: f32, centre: Vec3) -> Vec<[Vec3; 3]> {
        let point = |i: usize, j: usize| {
            let theta = std::f32::consts::PI * i as f32 / rings as f32;
            let phi = std::f32::consts::TAU * (j % (2 * rings)) as f32 / (2 * rings) as f32;
            let pole = i == 0 || i == rings;
            let s = if pole { 0.0 } else { math::sin(theta) };
            centre + scale * Vec3::new(s * math::cos(phi), s * math::sin(phi), math::cos(theta))
        };
        let mut corners = Vec::new();
        for i in 0..rings {
            for j in 0..2 * rings {
                let (a, b, c, d) = (point(i, j), point(i + 1, j), point(i + 1, j + 1), point(i, j + 1));
                corners.extend([[a, b, c], [a, c, d]]);
            }
        }
        corners
    }

    /// Long and thin triangles across all axes.
    fn hair(count: u64) -> Vec<[Vec3; 3]> {
        let strand = |i: u64| {
            let mut s = Stream::new(8, i, 0);
            let mut v = || Vec3::new(s.next_f32(), s.next_f32(), s.next_f32()) * 2.0 - 1.0;
            let (p, d, side) = (v(), v(), v());
            [p, p + 0.7 * d, p + 0.01 * side]
        };
        (0..count).map(strand).collect()
    }

    /// Of triangles in several leaves each is hit once, where it is hit alone.
    #[test]
    fn split_triangles_are_hit_once() {
        let corners = hair(500);
        let scene = of_triangles(&corners);
        let accel = Accel::build(&scene);
        assert!(accel.is_split);
        let alone: Vec<(Scene, Accel)> = corners
            .iter()
            .map(|&one| {
                let scene = of_triangles(&[one]);
                let accel = Accel::build(&scene);
                (scene, accel)
            })
            .collect();
        let mut several = 0;
        for i in 0..2000 {
            let mut s = Stream::new(11, i, 0);
            let mut v = || Vec3::new(s.next_f32(), s.next_f32(), s.next_f32()) * 2.0 - 1.0;
            let [a, b, c] = corners[i as usize % corners.len()];
            let origin = v() * 2.0;
            let ray = Ray::new(origin, (a + b + c) / 3.0 - origin);
            let expected: Vec<Hit> = (0u32..)
                .zip(&alone)
                .filter_map(|(triangle, (scene, accel))| {
                    accel.intersect(scene, &ray).map(|hit| Hit { triangle, ..hit })
                })
                .collect();
            let mut found = Vec::new();
            assert!(!accel.any_hit(&scene, &ray, |hit| {
                found.push(hit);
                false
            }));
            found.sort_by_key(|hit| hit.triangle);
            assert_eq!(found, expected, "ray {i}");
            assert!(!expected.is_empty());
            let closest = expected.iter().copied().min_by(|a, b| a.t.total_cmp(&b.t));
            assert_eq!(accel.intersect(&scene, &ray), closest);
            several += usize::from(expected.len() > 1);
        }
        assert!(several > 200, "{several}");
    }

    /// Every ray from inside a closed mesh at its edges and vertices hits it, at any scale and offset.
    #[test]
    fn closed_meshes_do_not_leak() {
        for (scale, shift) in [(1.0, 0.0), (2f32.powi(-20), 0.0), (2f32.powi(20), 0.0), (1.0, 1000.0)] {
            let centre = Vec3::splat(shift);
            let corners = sphere(24, scale, centre);
            let scene = of_triangles(&corners);
            let accel = Accel::build(&scene);
            for i in 0..20_000u64 {
                let mut s = Stream::new(9, i, 0);
                let triangle = &corners[(s.next_u64() % corners.len() as u64) as usize];
                let (edge, f) = (i as usize % 3, if i % 4 == 0 { 0.0 } else { s.next_f32() });
                let target = triangle[edge].lerp(triangle[(edge + 1) % 3], f);
                let origin =
                    centre + scale * 0.6 * (Vec3::new(s.next_f32(), s.next_f32(), s.next_f32()) - 0.5);
                let ray = Ray::new(origin, target - origin);
                assert!(accel.intersect(&scene, &ray).is_some(), "scale {scale}, shift {shift}, ray {i}");
                assert!(accel.occluded(&scene, &ray));
                let packet = accel.intersect_packet(&scene, origin, &[ray.direction.normalize(); LANES]);
                assert!(packet.iter().all(Option::is_some));
            }
        }
    }

    /// The tree is the same however many threads build it, and packets find what single rays find.
    #[test]
    fn trees_do_not_depend_on_threads() {
        let scene = of_triangles(&sphere(100, 1.0, Vec3::splat(0.3)));
        let build = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            pool.install(|| Accel::build(&scene))
        };
        let (one, three) = (build(1), build(3));
        // What lies in unused lanes is not a number.
        let bytes = |accel: &Accel| {
            let (nodes, blocks) = accel.wide.parts();
            [bytemuck::cast_slice(nodes), bytemuck::cast_slice::<_, u8>(blocks)].concat()
        };
        assert!(bytes(&one) == bytes(&three));
        for i in 0..2000 {
            let mut s = Stream::new(5, i, 0);
            let origin = Vec3::new(s.next_f32(), s.next_f32(), s.next_f32()) * 6.0 - 3.0;
            let target = Vec3::new(s.next_f32(), s.next_f32(), s.next_f32());
            let direction = (target - origin).normalize();
            let single = one.intersect(&scene, &Ray::new(origin, direction));
            let packet = one.intersect_packet(&scene, origin, &[direction; LANES])[i as usize % LANES];
            assert_eq!(single.is_some(), packet.is_some(), "ray {i}");
            if let (Some(a), Some(b)) = (single, packet) {
                assert!((a.t - b.t).abs() <= 1e-5 * a.t, "ray {i}: {a:?} {b:?}");
                let ignoring = Ray { ignore: a.triangle, ..Ray::new(origin, direction) };
                assert_ne!(one.intersect(&scene, &ignoring).map(|h| h.triangle), Some(a.triangle));
            }
        }
    }

    /// Whatever the processor has, hits have the same bits.
    #[test]
    fn all_ways_find_the_same_bits() {
        for corners in [sphere(30, 1.0, Vec3::splat(0.3)), hair(2000)] {
            let scene = of_triangles(&corners);
            let best = Accel::build(&scene);
            let others = Level::all().into_iter().skip(1).map(|level| {
                let mut other = best.clone();
                other.set_level(level);
                other
            });
            let others: Vec<Accel> = others.collect();
            let bits = |h: Option<Hit>| h.map(|h| (h.triangle, [h.t, h.b1, h.b2].map(f32::to_bits)));
            let mut hits = 0;
            for i in 0..3000 {
                let mut s = Stream::new(6, i, 0);
                let mut v = || Vec3::new(s.next_f32(), s.next_f32(), s.next_f32()) * 2.0 - 1.0;
                let (origin, axis) = (v() * 2.0, v());
                let ray = Ray::new(origin, axis);
                let directions: [Vec3; LANES] =
                    std::array::from_fn(|_| (axis + 0.05 * v()).try_normalize().unwrap_or(Vec3::X));
                let (one, packet) =
                    (best.intersect(&scene, &ray), best.intersect_packet(&scene, origin, &directions));
                assert_eq!(best.occluded(&scene, &ray), one.is_some());
                for other in &others {
                    assert_eq!(bits(one), bits(other.intersect(&scene, &ray)), "ray {i}");
                    assert_eq!(other.occluded(&scene, &ray), one.is_some());
                    let others = other.intersect_packet(&scene, origin, &directions);
                    assert_eq!(packet.map(bits), others.map(bits), "packet {i}");
                }
                hits += packet.iter().flatten().count();
            }
            assert!(hits > 3000, "{hits}");
        }
    }

    /// Powers of two change nothing but the scale of t.
    #[test]
    fn hits_scale_bit_for_bit_with_powers_of_two() {
        let corners = sphere(12, 1.0, Vec3::ZERO);
        let factor = 2f32.powi(-20);
        let small: Vec<_> = corners.iter().map(|t| t.map(|p| p * factor)).collect();
        let (scene, tiny) = (of_triangles(&corners), of_triangles(&small));
        let (a, b) = (Accel::build(&scene), Accel::build(&tiny));
        for i in 0..5000u64 {
            let mut s = Stream::new(2, i, 0);
            let mut v = || Vec3::new(s.next_f32(), s.next_f32(), s.next_f32()) * 4.0 - 2.0;
            let (origin, direction) = (v(), v());
            let big = a.intersect(&scene, &Ray::new(origin, direction));
            let small = b.intersect(&tiny, &Ray::new(origin * factor, direction * factor));
            assert_eq!(big.map(|h| (h.t, h.triangle)), small.map(|h| (h.t, h.triangle)));
        }
    }

    #[test]
    fn empty_and_broken_meshes_are_missed() {
        let ray = Ray::new(Vec3::ZERO, Vec3::Z);
        let nan = [Vec3::NAN, Vec3::ONE, Vec3::X];
        let infinite = [Vec3::INFINITY, Vec3::ONE, Vec3::X];
        let far = [Vec3::splat(1e30), Vec3::new(-1e30, 3e38, 0.0), Vec3::X];
        let tiny = [Vec3::splat(1e-30), Vec3::X * 1e-30, Vec3::splat(1e-45)];
        // Must not panic; whether these are hit does not matter.
        for corners in [vec![far; 9], vec![tiny; 9], vec![far, tiny, [Vec3::X, Vec3::Y, Vec3::Z]]] {
            let scene = of_triangles(&corners);
            let accel = Accel::build(&scene);
            let _ =
                (accel.intersect(&scene, &ray), accel.intersect_packet(&scene, ray.origin, &[Vec3::Z; 16]));
        }
        for corners in [vec![], vec![nan], vec![infinite], vec![[Vec3::Z; 3]; 40]] {
            let scene = of_triangles(&corners);
            let accel = Accel::build(&scene);
            assert_eq!(accel.intersect(&scene, &ray), None);
            assert!(!accel.occluded(&scene, &ray));
        }
        let scene = of_triangles(&[[
            Vec3::new(-1.0, -1.0, 2.0),
            Vec3::new(1.0, -1.0, 2.0),
            Vec3::new(0.0, 2.0, 2.0),
        ]]);
        let accel = Accel::build(&scene);
        assert_eq!(accel.intersect(&scene, &ray).map(|h| h.t), Some(2.0));
        for broken in [
            Ray::new(Vec3::NAN, Vec3::Z),
            Ray::new(Vec3::ZERO, Vec3::ZERO),
            Ray::new(Vec3::ZERO, Vec3::INFINITY),
        ] {
            assert_eq!(accel.intersect(&scene, &broken), None);
        }
        let short = Ray { t_max: 2.0, ..ray };
        assert_eq!(accel.intersect(&scene, &short), None, "t_max itself is outside");
    }
}
