//! Eight primary rays at once through a binary BVH.
//!
//! All rays of a packet leave one eye, so a box and a triangle are moved to the eye once for eight
//! rays. The triangle test is the watertight one of Woop, Benthin & Wald 2013 (REFERENCE §5.2) with
//! one shear axis for the packet: each ray meets all triangles with the same shear, which is what
//! watertightness needs.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;
use wide::f32x8;

/// Nodes on the way to a leaf that the stack has room for.
pub const STACK: usize = 128;

/// Rays of a packet.
pub const LANES: usize = 8;

/// A node in 32 bytes: inner nodes have `count` 0 and their children at `first` and `first + 1`, leaves
/// hold the triangles `first … first + count`.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct FlatNode {
    /// Lower corner of the (padded) box.
    pub min: [f32; 3],
    /// First child or first triangle.
    pub first: u32,
    /// Upper corner.
    pub max: [f32; 3],
    /// Number of triangles, 0 in inner nodes.
    pub count: u32,
}

/// Hits of a packet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PacketHit {
    /// Distances; infinite where a ray misses.
    pub t: [f32; LANES],
    /// Index in the order of the leaves; `u32::MAX` where a ray misses.
    pub index: [u32; LANES],
    /// Barycentric weight of the second corner.
    pub b1: [f32; LANES],
    /// Barycentric weight of the third corner.
    pub b2: [f32; LANES],
}

const MISS: PacketHit =
    PacketHit { t: [f32::INFINITY; LANES], index: [u32::MAX; LANES], b1: [0.0; LANES], b2: [0.0; LANES] };

/// Components along the packet's dominant axis below this are traced in packets of their own.
const SHALLOW: f32 = 1e-2;

/// Closest hits of eight rays from `origin` along unit `directions`. `corners` are in the order of the
/// leaves; `accept(index, b1, b2)` refuses hits of a cut-out surface.
pub fn intersect(
    nodes: &[FlatNode],
    corners: &[[Vec3; 3]],
    origin: Vec3,
    directions: &[Vec3; LANES],
    accept: impl Fn(u32, f32, f32) -> bool,
) -> PacketHit {
    if nodes.is_empty() || corners.is_empty() {
        return MISS;
    }
    let mean: Vec3 = directions.iter().sum();
    let kz = dominant_axis(mean);
    if !directions.iter().all(|d| d[kz].abs() > SHALLOW) {
        // A wide packet (a tiny picture, a huge field of view): one ray at a time.
        let mut hit = MISS;
        for (lane, &d) in directions.iter().enumerate() {
            let single = traverse(nodes, corners, origin, &[d; LANES], dominant_axis(d), d, &accept);
            hit.t[lane] = single.t[0];
            hit.index[lane] = single.index[0];
            hit.b1[lane] = single.b1[0];
            hit.b2[lane] = single.b2[0];
        }
        return hit;
    }
    traverse(nodes, corners, origin, directions, kz, mean, &accept)
}

fn dominant_axis(d: Vec3) -> usize {
    let a = d.abs();
    if a.x > a.y && a.x > a.z {
        0
    } else if a.y > a.z {
        1
    } else {
        2
    }
}

fn lanes(directions: &[Vec3; LANES], f: impl Fn(Vec3) -> f32) -> f32x8 {
    f32x8::from(directions.map(f))
}

/// What of a packet the triangle test needs.
struct Shear {
    axes: [usize; 3],
    x: f32x8,
    y: f32x8,
    z: f32x8,
}

fn traverse(
    nodes: &[FlatNode],
    corners: &[[Vec3; 3]],
    origin: Vec3,
    directions: &[Vec3; LANES],
    kz: usize,
    mean: Vec3,
    accept: &impl Fn(u32, f32, f32) -> bool,
) -> PacketHit {
    // A component of zero would make 0 · ∞; the boxes are padded by far more than this moves them.
    let inverse =
        |axis: usize| lanes(directions, |d| 1.0 / if d[axis].abs() < 1e-20 { 1e-20 } else { d[axis] });
    let inverse = [inverse(0), inverse(1), inverse(2)];
    let (kx, ky) = ((kz + 1) % 3, (kz + 2) % 3);
    let shear = Shear {
        axes: [kx, ky, kz],
        x: lanes(directions, |d| d[kx] / d[kz]),
        y: lanes(directions, |d| d[ky] / d[kz]),
        z: lanes(directions, |d| 1.0 / d[kz]),
    };
    let mut hit = MISS;
    let mut nearest = f32x8::from(hit.t);
    let origin_axes = origin.to_array();
    let mut stack = [0u32; STACK];
    let mut depth = 1;
    while depth > 0 {
        depth -= 1;
        let node = &nodes[stack[depth] as usize];
        let mut enter = f32x8::splat(0.0);
        let mut leave = nearest;
        for axis in 0..3 {
            let a = f32x8::splat(node.min[axis] - origin_axes[axis]) * inverse[axis];
            let b = f32x8::splat(node.max[axis] - origin_axes[axis]) * inverse[axis];
            enter = a.fast_min(b).fast_max(enter);
            leave = a.fast_max(b).fast_min(leave);
        }
        // 1 + 3 ulp (REFERENCE §5.3).
        if !enter.simd_le(leave * f32x8::splat(1.000_000_4)).any() {
            continue;
        }
        if node.count > 0 {
            for index in node.first..node.first + node.count {
                let triangle = &corners[index as usize];
                triangle_test(index, triangle, origin, &shear, &mut nearest, &mut hit, accept);
            }
            continue;
        }
        let (left, right) = (&nodes[node.first as usize], &nodes[node.first as usize + 1]);
        let between = |axis: usize| right.min[axis] + right.max[axis] - left.min[axis] - left.max[axis];
        let right_is_far = between(0) * mean.x + between(1) * mean.y + between(2) * mean.z >= 0.0;
        let (near, far) =
            if right_is_far { (node.first, node.first + 1) } else { (node.first + 1, node.first) };
        debug_assert!(depth + 2 <= stack.len(), "a tree deeper than the stack");
        if depth + 2 <= stack.len() {
            stack[depth] = far;
            stack[depth + 1] = near;
            depth += 2;
        }
    }
    hit
}

#[inline(always)]
fn triangle_test(
    index: u32,
    triangle: &[Vec3; 3],
    origin: Vec3,
    shear: &Shear,
    nearest: &mut f32x8,
    hit: &mut PacketHit,
    accept: &impl Fn(u32, f32, f32) -> bool,
) {
    let [kx, ky, kz] = shear.axes;
    let [a, b, c] = triangle.map(|p| p - origin);
    let sheared = |p: Vec3| {
        let z = f32x8::splat(p[kz]);
        (f32x8::splat(p[kx]) - shear.x * z, f32x8::splat(p[ky]) - shear.y * z)
    };
    let ((ax, ay), (bx, by), (cx, cy)) = (sheared(a), sheared(b), sheared(c));
    let mut u = cx * by - cy * bx;
    let mut v = ax * cy - ay * cx;
    let mut w = bx * ay - by * ax;
    let zero = f32x8::splat(0.0);
    let negative = u.simd_lt(zero) | v.simd_lt(zero) | w.simd_lt(zero);
    let positive = u.simd_gt(zero) | v.simd_gt(zero) | w.simd_gt(zero);
    if (negative & positive).all() {
        return;
    }
    if (u.simd_eq(zero) | v.simd_eq(zero) | w.simd_eq(zero)).any() {
        // On an edge: only exact products tell the side.
        let [mut eu, mut ev, mut ew] = [u.to_array(), v.to_array(), w.to_array()];
        let [axs, ays, bxs, bys, cxs, cys] = [ax, ay, bx, by, cx, cy].map(f32x8::to_array);
        for l in 0..LANES {
            if eu[l] == 0.0 || ev[l] == 0.0 || ew[l] == 0.0 {
                let edge = |p: f32, q: f32, r: f32, s: f32| {
                    (f64::from(p) * f64::from(q) - f64::from(r) * f64::from(s)) as f32
                };
                eu[l] = edge(cxs[l], bys[l], cys[l], bxs[l]);
                ev[l] = edge(axs[l], cys[l], ays[l], cxs[l]);
                ew[l] = edge(bxs[l], ays[l], bys[l], axs[l]);
            }
        }
        (u, v, w) = (f32x8::from(eu), f32x8::from(ev), f32x8::from(ew));
    }
    let negative = u.simd_lt(zero) | v.simd_lt(zero) | w.simd_lt(zero);
    let positive = u.simd_gt(zero) | v.simd_gt(zero) | w.simd_gt(zero);
    let determinant = u + v + w;
    let outside = (negative & positive) | determinant.simd_eq(zero);
    if outside.all() {
        return;
    }
    let scaled = shear.z * (u * f32x8::splat(a[kz]) + v * f32x8::splat(b[kz]) + w * f32x8::splat(c[kz]));
    let t = scaled / determinant;
    let mut closer = (t.simd_gt(zero) & t.simd_lt(*nearest) & !outside).to_bitmask();
    while closer != 0 {
        let lane = closer.trailing_zeros() as usize;
        closer &= closer - 1;
        let det = determinant.to_array()[lane];
        let (b1, b2) = (v.to_array()[lane] / det, w.to_array()[lane] / det);
        if accept(index, b1, b2) {
            hit.t[lane] = t.to_array()[lane];
            hit.index[lane] = index;
            hit.b1[lane] = b1;
            hit.b2[lane] = b2;
        }
    }
    *nearest = f32x8::from(hit.t);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Stream;

    /// A flat tree: one leaf, or halves split by index (bad but valid).
    fn tree(corners: &[[Vec3; 3]], leaf: usize) -> Vec<FlatNode> {
        fn bounds(corners: &[[Vec3; 3]]) -> ([f32; 3], [f32; 3]) {
            let points = || corners.iter().flatten();
            let min = points().fold(Vec3::INFINITY, |m, &p| m.min(p));
            let max = points().fold(Vec3::NEG_INFINITY, |m, &p| m.max(p));
            let pad = min.abs().max(max.abs()).max_element() / 1_048_576.0;
            ((min - pad).to_array(), (max + pad).to_array())
        }
        fn fill(nodes: &mut Vec<FlatNode>, at: usize, corners: &[[Vec3; 3]], first: usize, leaf: usize) {
            let (min, max) = bounds(corners);
            if corners.len() <= leaf {
                nodes[at] = FlatNode { min, max, first: first as u32, count: corners.len() as u32 };
                return;
            }
            let children = nodes.len();
            nodes[at] = FlatNode { min, max, first: children as u32, count: 0 };
            nodes.extend([FlatNode::zeroed(); 2]);
            let half = corners.len() / 2;
            fill(nodes, children, &corners[..half], first, leaf);
            fill(nodes, children + 1, &corners[half..], first + half, leaf);
        }
        let mut nodes = vec![FlatNode::zeroed()];
        fill(&mut nodes, 0, corners, 0, leaf);
        nodes
    }

    fn random_directions(i: u64, spread: f32) -> [Vec3; LANES] {
        let mut s = Stream::new(3, i, 0);
        let mut vector = || Vec3::new(s.next_f32() - 0.5, s.next_f32() - 0.5, s.next_f32() - 0.5);
        let axis = vector().normalize();
        std::array::from_fn(|_| (axis + spread * vector()).normalize())
    }

    /// Rays from inside a closed octahedron aimed at its edges and corners never escape (c05: plain
    /// Möller–Trumbore loses 30195 of 400 000).
    #[test]
    fn no_ray_leaves_a_closed_octahedron() {
        for offset in [0.0, 100.0, 10_000.0] {
            let at = |x: f32, y: f32, z: f32| Vec3::new(x, y, z) + offset;
            let (px, mx) = (at(1.0, 0.0, 0.0), at(-1.0, 0.0, 0.0));
            let (py, my) = (at(0.0, 1.0, 0.0), at(0.0, -1.0, 0.0));
            let (pz, mz) = (at(0.0, 0.0, 1.0), at(0.0, 0.0, -1.0));
            let corners = [
                [px, py, pz],
                [py, mx, pz],
                [mx, my, pz],
                [my, px, pz],
                [py, px, mz],
                [mx, py, mz],
                [my, mx, mz],
                [px, my, mz],
            ];
            let nodes = tree(&corners, 2);
            let vertices = [px, mx, py, my, pz, mz];
            for i in 0..4000u64 {
                let mut s = Stream::new(11, i, 0);
                let eye = at(0.0, 0.0, 0.0)
                    + Vec3::new(s.next_f32() - 0.5, s.next_f32() - 0.5, s.next_f32() - 0.5) * 0.5;
                let directions = std::array::from_fn(|l| {
                    // Opposite vertices share no edge.
                    let (a, step) = ((i as usize + l) % 6, 2 + (l % 2) * 2);
                    let pair = (vertices[a], vertices[((a / 2) * 2 + step) % 6]);
                    let f = if l == 7 { 0.0 } else { s.next_f32() };
                    (pair.0 + (pair.1 - pair.0) * f - eye).normalize()
                });
                let hit = intersect(&nodes, &corners, eye, &directions, |_, _, _| true);
                assert!(hit.index.iter().all(|&i| i != u32::MAX), "offset {offset}, packet {i}: {hit:?}");
            }
        }
    }

    /// The packet finds what eight one-ray packets over all triangles find, for any tree.
    #[test]
    fn packets_agree_with_single_rays() {
        let corners: Vec<[Vec3; 3]> = (0..300)
            .map(|i| {
                let mut s = Stream::new(1, i, 0);
                let mut p = || Vec3::new(s.next_f32(), s.next_f32(), s.next_f32()) * 2.0 - 1.0;
                let c = p();
                [c, c + p() * 0.3, c + p() * 0.3]
            })
            .collect();
        let (deep, flat) = (tree(&corners, 2), tree(&corners, 1000));
        let mut hits = 0;
        for i in 0..2000 {
            let directions = random_directions(i, if i % 3 == 0 { 3.0 } else { 0.05 });
            let eye = Vec3::new(0.1, 0.0, -0.2);
            let packet = intersect(&deep, &corners, eye, &directions, |i, _, _| i % 5 != 0);
            for (l, &direction) in directions.iter().enumerate() {
                let single = intersect(&flat, &corners, eye, &[direction; LANES], |i, _, _| i % 5 != 0);
                let close =
                    (packet.t[l] - single.t[0]).abs() <= 1e-4 * single.t[0] || packet.t[l] == single.t[0];
                assert!(close, "packet {i}, lane {l}: {} against {}", packet.t[l], single.t[0]);
                assert_ne!(packet.index[l] % 5, if packet.index[l] == u32::MAX { 9 } else { 0 });
                hits += usize::from(packet.index[l] != u32::MAX);
            }
        }
        assert!(hits > 4000);
    }

    #[test]
    fn nothing_degenerate_is_hit() {
        let p = Vec3::new(0.0, 0.0, 2.0);
        let corners = [
            [p, p, p],
            [p, p, p + Vec3::X],
            [p - Vec3::X, p, p + Vec3::X],
            [p, p + Vec3::Z, p + Vec3::Z * 2.0],
        ];
        let nodes = tree(&corners, 1);
        let hit = intersect(&nodes, &corners, Vec3::ZERO, &[Vec3::Z; LANES], |_, _, _| true);
        assert_eq!(hit, MISS);
        assert_eq!(intersect(&[], &[], Vec3::ZERO, &[Vec3::Z; LANES], |_, _, _| true), MISS);
    }
}
