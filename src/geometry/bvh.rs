//! The geometry index: a BVH built by obvhs, traversed here. The only file that names obvhs.

use std::time::Duration;

use glam::{Vec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::aabb::Aabb;
use obvhs::bvh2::builder::build_bvh2;

use super::packet::{self, FlatNode, LANES};
use super::triangle::{self, Shear};
use super::{Hit, Ray};
use crate::scene::{Material, Scene};

/// Deepest tree that the traversal stacks hold; deeper ones are rebuilt without optimisation.
const STACK: usize = 128;

/// Index over all triangles of a scene.
#[derive(Clone, Debug)]
pub struct Accel {
    nodes: Vec<FlatNode>,
    /// Corners in the order of the leaves.
    corners: Vec<[Vec3; 3]>,
    /// Mesh triangle of each, with the top bit set where it may be cut out.
    triangles: Vec<u32>,
}

const CUT_OUT: u32 = 1 << 31;

impl Accel {
    /// Builds the index. Triangles with a corner that is not finite are left out; a scene without triangles is
    /// fine.
    pub fn build(scene: &Scene) -> Self {
        let mesh = &scene.mesh;
        let mut kept: Vec<u32> = Vec::with_capacity(mesh.triangles.len());
        let mut boxes: Vec<Aabb> = Vec::with_capacity(mesh.triangles.len());
        for t in 0..mesh.triangles.len() as u32 {
            let [a, b, c] = mesh.corners(t);
            if !(a.is_finite() && b.is_finite() && c.is_finite()) {
                continue;
            }
            let (min, max) = (a.min(b).min(c), a.max(b).max(c));
            // Slab tests round: without padding rays leak at shared edges.
            let pad = min.abs().max(max.abs()).max_element() * (1.0 / 1_048_576.0) + 1e-30;
            boxes.push(Aabb { min: Vec3A::from(min - pad), max: Vec3A::from(max + pad) });
            kept.push(t);
        }
        if kept.is_empty() {
            return Self { nodes: Vec::new(), corners: Vec::new(), triangles: Vec::new() };
        }
        let params =
            if kept.len() > 200_000 { BvhBuildParams::fast_build() } else { BvhBuildParams::medium_build() };
        let bvh = build_bvh2(&boxes, params, &mut Duration::default());
        let order: Vec<u32> = bvh.primitive_indices.iter().map(|&i| kept[i as usize]).collect();
        let may_vanish = |m: &Material| m.opacity < 1.0 || m.opacity_map.is_some();
        let vanishing: Vec<bool> = scene.materials.iter().map(may_vanish).collect();
        Self {
            nodes: bvh
                .nodes
                .iter()
                .map(|n| FlatNode {
                    min: Vec3::from(n.aabb().min).to_array(),
                    first: n.first_index,
                    max: Vec3::from(n.aabb().max).to_array(),
                    count: n.prim_count,
                })
                .collect(),
            corners: order.iter().map(|&t| mesh.corners(t)).collect(),
            triangles: order
                .iter()
                .map(|&t| t | if vanishing[mesh.materials[t as usize].0 as usize] { CUT_OUT } else { 0 })
                .collect(),
        }
    }

    /// Number of triangles.
    pub fn len(&self) -> usize {
        self.triangles.len()
    }

    /// Whether there is nothing to hit.
    pub fn is_empty(&self) -> bool {
        self.triangles.is_empty()
    }

    /// Bytes held.
    pub fn size_bytes(&self) -> usize {
        self.nodes.len() * size_of::<FlatNode>() + self.triangles.len() * (36 + 4)
    }
}

impl Accel {
    /// The closest hit between the ray's bounds. Cut-out surfaces are hit where they are there.
    pub fn intersect(&self, scene: &Scene, ray: &Ray) -> Option<Hit> {
        let mut closest: Option<(u32, f32, f32)> = None;
        let mut t_max = ray.t_max;
        self.traverse(ray, |index, shear, t_far| {
            let found = triangle::intersect(shear, ray.origin, &self.corners[index], ray.t_min, *t_far);
            if let Some((t, b1, b2)) = found
                && self.triangles[index] & !CUT_OUT != ray.ignore
                && self.is_there(scene, index, b1, b2)
            {
                *t_far = t;
                t_max = t;
                closest = Some((self.triangles[index] & !CUT_OUT, b1, b2));
            }
            false
        });
        closest.map(|(triangle, b1, b2)| Hit { t: t_max, triangle, b1, b2 })
    }

    /// Whether anything stands between the ray's bounds. Stops at the first hit. Glass stands in the way too;
    /// whoever wants light to pass asks [`Accel::intersect`].
    pub fn occluded(&self, scene: &Scene, ray: &Ray) -> bool {
        self.any_hit(scene, ray, |_| true)
    }

    /// Whether `blocks` is true of any hit between the ray's bounds. Visits hits in no order, each once, and
    /// stops at the first that blocks.
    pub fn any_hit(&self, scene: &Scene, ray: &Ray, mut blocks: impl FnMut(Hit) -> bool) -> bool {
        let mut blocked = false;
        self.traverse(ray, |index, shear, t_far| {
            let found = triangle::intersect(shear, ray.origin, &self.corners[index], ray.t_min, *t_far);
            blocked = found.is_some_and(|(t, b1, b2)| {
                let triangle = self.triangles[index] & !CUT_OUT;
                triangle != ray.ignore
                    && self.is_there(scene, index, b1, b2)
                    && blocks(Hit { t, triangle, b1, b2 })
            });
            blocked
        });
        blocked
    }

    /// Closest hits of eight rays from one point along unit directions.
    pub fn intersect_packet(
        &self,
        scene: &Scene,
        origin: Vec3,
        directions: &[Vec3; LANES],
    ) -> [Option<Hit>; LANES] {
        let accept = |index: u32, b1: f32, b2: f32| self.is_there(scene, index as usize, b1, b2);
        let hit = packet::intersect(&self.nodes, &self.corners, origin, directions, accept);
        std::array::from_fn(|l| {
            let triangle = self.triangles.get(hit.index[l] as usize)? & !CUT_OUT;
            Some(Hit { t: hit.t[l], triangle, b1: hit.b1[l], b2: hit.b2[l] })
        })
    }

    #[inline(always)]
    fn is_there(&self, scene: &Scene, index: usize, b1: f32, b2: f32) -> bool {
        let t = self.triangles[index];
        t & CUT_OUT == 0 || scene.is_opaque_at(t & !CUT_OUT, b1, b2)
    }

    /// Visits the leaves that the ray meets, near ones first. `visit(index, shear, t_far)` tests one triangle,
    /// may bring `t_far` nearer, and ends the traversal by returning `true`.
    #[inline(always)]
    fn traverse(&self, ray: &Ray, mut visit: impl FnMut(usize, &Shear, &mut f32) -> bool) {
        if self.nodes.is_empty()
            || !ray.direction.is_finite()
            || !ray.origin.is_finite()
            || ray.direction == Vec3::ZERO
        {
            return;
        }
        let shear = Shear::new(ray.direction);
        // A component of zero would make 0 · ∞; the boxes are padded by far more than this moves them.
        let tiny = ray.direction.abs().max_element() * 1e-20;
        let inverse = Vec3::from_array(
            ray.direction
                .to_array()
                .map(|d| 1.0 / if d.abs() <= tiny { tiny.max(f32::MIN_POSITIVE) } else { d }),
        );
        let mut t_far = ray.t_max;
        let enter = |node: &FlatNode, t_far: f32| {
            let a = (Vec3::from_array(node.min) - ray.origin) * inverse;
            let b = (Vec3::from_array(node.max) - ray.origin) * inverse;
            let near = a.min(b).max_element().max(ray.t_min);
            // 1 + 3 ulp (REFERENCE §5.3).
            let far = a.max(b).min_element().min(t_far) * 1.000_000_4;
            if near <= far { near } else { f32::INFINITY }
        };
        let mut stack = [(0u32, 0.0f32); STACK];
        let mut depth = 0;
        let mut at = 0u32;
        if enter(&self.nodes[0], t_far) == f32::INFINITY {
            return;
        }
        loop {
            let node = &self.nodes[at as usize];
            if node.count > 0 {
                for index in node.first..node.first + node.count {
                    if visit(index as usize, &shear, &mut t_far) {
                        return;
                    }
                }
            } else {
                let (left, right) = (node.first, node.first + 1);
                let (tl, tr) =
                    (enter(&self.nodes[left as usize], t_far), enter(&self.nodes[right as usize], t_far));
                let (near, t_near, far, t_beyond) =
                    if tl <= tr { (left, tl, right, tr) } else { (right, tr, left, tl) };
                if t_beyond < f32::INFINITY && depth < STACK {
                    stack[depth] = (far, t_beyond);
                    depth += 1;
                }
                if t_near < f32::INFINITY {
                    at = near;
                    continue;
                }
            }
            // The next subtree that begins before the closest hit.
            loop {
                if depth == 0 {
                    return;
                }
                depth -= 1;
                if stack[depth].1 <= t_far * 1.000_000_4 {
                    at = stack[depth].0;
                    break;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Stream;
    use crate::scene::test_scenes::of_triangles;

    fn sphere(rings: usize, scale: f32, centre: Vec3) -> Vec<[Vec3; 3]> {
        let point = |i: usize, j: usize| {
            let theta = std::f32::consts::PI * i as f32 / rings as f32;
            let phi = std::f32::consts::TAU * (j % (2 * rings)) as f32 / (2 * rings) as f32;
            let pole = i == 0 || i == rings;
            let s = if pole { 0.0 } else { theta.sin() };
            centre + scale * Vec3::new(s * phi.cos(), s * phi.sin(), theta.cos())
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
