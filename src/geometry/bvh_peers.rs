//! The traversals that obvhs has of its own, for benchmarks to be held against: not watertight, no part of any picture.

use std::time::Duration;

use glam::{Vec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::builder::build_cwbvh_from_tris;
use obvhs::ray::RayHit;
use obvhs::rt_triangle::RtTriangle;
use obvhs::triangle::Triangle;

use super::Ray;

/// Which of its trees.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PeerTree {
    /// Two children per node.
    Binary,
    /// Eight, compressed.
    CompressedWide,
}

impl PeerTree {
    /// Its name in tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Binary => "obvhs, two children",
            Self::CompressedWide => "obvhs, eight children",
        }
    }
}

#[derive(Clone)]
enum Tree {
    Binary(Bvh2),
    CompressedWide(CwBvh),
}

/// A tree with the triangles as obvhs prepares them.
#[derive(Clone)]
pub struct Peer {
    tree: Tree,
    triangles: Vec<RtTriangle>,
}

impl Peer {
    /// Builds with obvhs' `very_slow` preset, its best.
    pub fn build(corners: &[[Vec3; 3]], tree: PeerTree) -> Self {
        let point = |p: Vec3| Vec3A::from(p);
        let source: Vec<Triangle> =
            corners.iter().map(|c| Triangle { v0: point(c[0]), v1: point(c[1]), v2: point(c[2]) }).collect();
        let params = BvhBuildParams::very_slow_build();
        let tree = match tree {
            PeerTree::Binary => Tree::Binary(build_bvh2_from_tris(&source, params, &mut Duration::default())),
            PeerTree::CompressedWide => {
                Tree::CompressedWide(build_cwbvh_from_tris(&source, params, &mut Duration::default()))
            }
        };
        let order = match &tree {
            Tree::Binary(bvh) => &bvh.primitive_indices,
            Tree::CompressedWide(bvh) => &bvh.primitive_indices,
        };
        let triangles = order.iter().map(|&i| RtTriangle::from(&source[i as usize])).collect();
        Self { tree, triangles }
    }

    /// Distance of the closest hit; infinite where there is none.
    #[inline]
    pub fn intersect(&self, ray: &Ray) -> f32 {
        let ray = prepared(ray);
        let mut hit = RayHit::none();
        match &self.tree {
            Tree::Binary(bvh) => bvh.ray_traverse(ray, &mut hit, |r, i| self.triangles[i].intersect(r)),
            Tree::CompressedWide(bvh) => {
                bvh.ray_traverse(ray, &mut hit, |r, i| self.triangles[i].intersect(r))
            }
        };
        hit.t
    }

    /// Whether anything stands between the ray's bounds.
    #[inline]
    pub fn occluded(&self, ray: &Ray) -> bool {
        let ray = prepared(ray);
        !match &self.tree {
            Tree::Binary(bvh) => bvh.ray_traverse_miss(ray, |r, i| self.triangles[i].intersect(r)),
            Tree::CompressedWide(bvh) => bvh.ray_traverse_miss(ray, |r, i| self.triangles[i].intersect(r)),
        }
    }
}

#[inline]
fn prepared(ray: &Ray) -> obvhs::ray::Ray {
    obvhs::ray::Ray::new(Vec3A::from(ray.origin), Vec3A::from(ray.direction), ray.t_min, ray.t_max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Accel;
    use crate::rng::Stream;
    use crate::scene::test_scenes::of_triangles;

    /// What a benchmark compares finds the same: nearly, since it is not watertight.
    #[test]
    fn peers_hit_what_we_hit() {
        let mut s = Stream::new(1, 2, 3);
        let mut v = || Vec3::new(s.next_f32(), s.next_f32(), s.next_f32()) * 2.0 - 1.0;
        let corners: Vec<[Vec3; 3]> = (0..500)
            .map(|_| {
                let p = v();
                [p, p + v() * 0.3, p + v() * 0.3]
            })
            .collect();
        let rays: Vec<Ray> = (0..2000).map(|_| Ray::new(v() * 3.0, v().normalize())).collect();
        let scene = of_triangles(&corners);
        let accel = Accel::build(&scene);
        for tree in [PeerTree::Binary, PeerTree::CompressedWide] {
            let peer = Peer::build(&corners, tree);
            let close = |ray: &&Ray| {
                let (t, ours) = (peer.intersect(ray), accel.intersect(&scene, ray));
                peer.occluded(ray) == ours.is_some()
                    && ours.map_or(t == f32::INFINITY, |h| (h.t - t).abs() <= 1e-4 * t)
            };
            assert!(rays.iter().filter(close).count() >= 1995, "{tree:?}");
        }
    }
}
