//! Sixteen primary rays at once through a binary BVH.
//!
//! All rays of a packet leave one eye, so a box and a triangle are moved to the eye once for all rays. The triangle
//! test is the watertight one of Woop, Benthin & Wald 2013 (REFERENCE §5.2) with one shear axis for the packet: each
//! ray meets all triangles with the same shear, which is what watertightness needs.
//!
//! The lanes are plain arrays, which the compiler turns into vectors: of 4 lanes where nothing is known of the
//! processor, of 8 or 16 in the copies that `pulp` chooses at run time. No copy fuses or reorders an operation, so
//! all of them find the same bits.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

/// Nodes on the way to a leaf that the stack has room for.
pub const STACK: usize = 128;

/// Rays of a packet.
pub const LANES: usize = 16;

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

/// A number for each ray.
#[derive(Clone, Copy)]
#[repr(align(64))]
struct Lanes([f32; LANES]);

impl Lanes {
    #[inline(always)]
    fn of(mut f: impl FnMut(usize) -> f32) -> Self {
        let mut lanes = [0.0; LANES];
        for (i, lane) in lanes.iter_mut().enumerate() {
            *lane = f(i);
        }
        Self(lanes)
    }
}

/// Closest hits of sixteen rays from `origin` along unit `directions`. `corners` are in the order of the
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
            let packet = Packet::new(origin, &[d; LANES], dominant_axis(d), d);
            let single = traverse(nodes, corners, &packet, &accept);
            hit.t[lane] = single.t[0];
            hit.index[lane] = single.index[0];
            hit.b1[lane] = single.b1[0];
            hit.b2[lane] = single.b2[0];
        }
        return hit;
    }
    let packet = Packet::new(origin, directions, kz, mean);
    pulp::Arch::new().dispatch(Traverse { nodes, corners, packet: &packet, accept: &accept })
}

/// The traversal, to be compiled for each set of instructions.
struct Traverse<'a, F> {
    nodes: &'a [FlatNode],
    corners: &'a [[Vec3; 3]],
    packet: &'a Packet,
    accept: &'a F,
}

impl<F: Fn(u32, f32, f32) -> bool> pulp::WithSimd for Traverse<'_, F> {
    type Output = PacketHit;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> PacketHit {
        traverse(self.nodes, self.corners, self.packet, self.accept)
    }
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

/// Rays prepared for boxes and triangles.
struct Packet {
    origin: [f32; 3],
    inverse: [Lanes; 3],
    mean: Vec3,
    axes: [usize; 3],
    shear_x: Lanes,
    shear_y: Lanes,
    scale_z: Lanes,
}

impl Packet {
    #[inline(always)]
    fn new(origin: Vec3, directions: &[Vec3; LANES], kz: usize, mean: Vec3) -> Self {
        // A component of zero would make 0 · ∞; the boxes are padded by far more than this moves them.
        let inverse = |axis: usize| {
            Lanes::of(|i| {
                let d = directions[i][axis];
                1.0 / if d.abs() < 1e-20 { 1e-20 } else { d }
            })
        };
        let (kx, ky) = ((kz + 1) % 3, (kz + 2) % 3);
        Self {
            origin: origin.to_array(),
            inverse: [inverse(0), inverse(1), inverse(2)],
            mean,
            axes: [kx, ky, kz],
            shear_x: Lanes::of(|i| directions[i][kx] / directions[i][kz]),
            shear_y: Lanes::of(|i| directions[i][ky] / directions[i][kz]),
            scale_z: Lanes::of(|i| 1.0 / directions[i][kz]),
        }
    }
}

#[inline(always)]
fn least(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[inline(always)]
fn most(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

#[inline(always)]
fn traverse(
    nodes: &[FlatNode],
    corners: &[[Vec3; 3]],
    packet: &Packet,
    accept: &impl Fn(u32, f32, f32) -> bool,
) -> PacketHit {
    let mut hit = MISS;
    let mut nearest = Lanes(hit.t);
    let mut stack = [0u32; STACK];
    let mut depth = 1;
    while depth > 0 {
        depth -= 1;
        let node = &nodes[stack[depth] as usize];
        let min: [f32; 3] = std::array::from_fn(|axis| node.min[axis] - packet.origin[axis]);
        let max: [f32; 3] = std::array::from_fn(|axis| node.max[axis] - packet.origin[axis]);
        // Entry where positive: the ray meets the box before what it has hit. The factor is 1 + 3 ulp
        // (REFERENCE §5.3).
        let mut any = false;
        for i in 0..LANES {
            let (mut enter, mut leave) = (0.0, nearest.0[i]);
            for axis in 0..3 {
                let a = min[axis] * packet.inverse[axis].0[i];
                let b = max[axis] * packet.inverse[axis].0[i];
                enter = most(least(a, b), enter);
                leave = least(most(a, b), leave);
            }
            any |= enter <= leave * 1.000_000_4;
        }
        if !any {
            continue;
        }
        if node.count > 0 {
            for index in node.first..node.first + node.count {
                triangle_test(index, &corners[index as usize], packet, &mut nearest, &mut hit, accept);
            }
            continue;
        }
        let (left, right) = (&nodes[node.first as usize], &nodes[node.first as usize + 1]);
        let between = |axis: usize| right.min[axis] + right.max[axis] - left.min[axis] - left.max[axis];
        let mean = packet.mean;
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
    packet: &Packet,
    nearest: &mut Lanes,
    hit: &mut PacketHit,
    accept: &impl Fn(u32, f32, f32) -> bool,
) {
    let [kx, ky, kz] = packet.axes;
    let [a, b, c] = triangle.map(|p| {
        let p = p.to_array();
        [p[kx] - packet.origin[kx], p[ky] - packet.origin[ky], p[kz] - packet.origin[kz]]
    });
    let sheared =
        |p: [f32; 3], i: usize| (p[0] - packet.shear_x.0[i] * p[2], p[1] - packet.shear_y.0[i] * p[2]);
    let (mut u, mut v, mut w) = (Lanes([0.0; LANES]), Lanes([0.0; LANES]), Lanes([0.0; LANES]));
    let mut any = false;
    let mut on_edge = false;
    for i in 0..LANES {
        let ((ax, ay), (bx, by), (cx, cy)) = (sheared(a, i), sheared(b, i), sheared(c, i));
        u.0[i] = cx * by - cy * bx;
        v.0[i] = ax * cy - ay * cx;
        w.0[i] = bx * ay - by * ax;
        let (low, high) = (least(least(u.0[i], v.0[i]), w.0[i]), most(most(u.0[i], v.0[i]), w.0[i]));
        any |= !((low < 0.0) & (high > 0.0));
        on_edge |= (u.0[i] == 0.0) | (v.0[i] == 0.0) | (w.0[i] == 0.0);
    }
    if !any {
        return;
    }
    if on_edge {
        // Only exact products tell the side.
        for i in 0..LANES {
            if u.0[i] == 0.0 || v.0[i] == 0.0 || w.0[i] == 0.0 {
                let ((ax, ay), (bx, by), (cx, cy)) = (sheared(a, i), sheared(b, i), sheared(c, i));
                let edge = |p: f32, q: f32, r: f32, s: f32| {
                    (f64::from(p) * f64::from(q) - f64::from(r) * f64::from(s)) as f32
                };
                u.0[i] = edge(cx, by, cy, bx);
                v.0[i] = edge(ax, cy, ay, cx);
                w.0[i] = edge(bx, ay, by, ax);
            }
        }
    }
    let mut t = Lanes([0.0; LANES]);
    let mut closer = [false; LANES];
    for (i, closer) in closer.iter_mut().enumerate() {
        let (low, high) = (least(least(u.0[i], v.0[i]), w.0[i]), most(most(u.0[i], v.0[i]), w.0[i]));
        let determinant = u.0[i] + v.0[i] + w.0[i];
        let scaled = packet.scale_z.0[i] * (u.0[i] * a[2] + v.0[i] * b[2] + w.0[i] * c[2]);
        t.0[i] = scaled / determinant;
        *closer =
            !((low < 0.0) & (high > 0.0)) & (determinant != 0.0) & (t.0[i] > 0.0) & (t.0[i] < nearest.0[i]);
    }
    for (i, closer) in closer.into_iter().enumerate() {
        if closer {
            let determinant = u.0[i] + v.0[i] + w.0[i];
            let (b1, b2) = (v.0[i] / determinant, w.0[i] / determinant);
            if accept(index, b1, b2) {
                hit.t[i] = t.0[i];
                hit.index[i] = index;
                hit.b1[i] = b1;
                hit.b2[i] = b2;
                nearest.0[i] = t.0[i];
            }
        }
    }
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
                    let f = if l % 8 == 7 { 0.0 } else { s.next_f32() };
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
