//! Sixteen primary rays at once.
//!
//! All rays of a packet leave one eye. Where they also point into one octant, the packet goes through the tree of eight
//! children as one beam: interval bounds of its directions decide for eight boxes at once whether any ray can meet them,
//! so that a packet visits nodes at the price of a single ray; only triangles are tested for each ray. Other packets take
//! the binary tree and test each box for each ray. What they find does not depend on the way. The triangle test is the watertight one of Woop, Benthin & Wald 2013 (REFERENCE §5.2) with one shear axis for the packet: each
//! ray meets all triangles with the same shear, which is what watertightness needs.
//!
//! The lanes are plain arrays, which the compiler turns into vectors: of 4 lanes where nothing is known of the
//! processor, of 8 or 16 in the copies that `pulp` chooses at run time. No copy fuses or reorders an operation, so
//! all of them find the same bits.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::eight::{Eight, Work};
use super::node::{CHILDREN, Child, Node};
use super::offset::gamma;
use super::wide::{Entry, Wide};

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
pub(super) struct PacketHit {
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

/// Surfaces that may be cut out.
pub(super) trait CutOut {
    /// Whether the triangle at an index in the order of the leaves has places that are not there.
    fn may_vanish(&self, index: u32) -> bool;
    /// Whether it is there at barycentric weights of the second and third corner.
    fn is_there(&self, index: u32, b1: f32, b2: f32) -> bool;
}

/// Closest hits of sixteen rays from `origin` along unit `directions`. `corners` are in the order of the
/// leaves; `cut` refuses hits of a cut-out surface.
pub(super) fn intersect(
    nodes: &[FlatNode],
    wide: Option<&Wide>,
    corners: &[[Vec3; 3]],
    origin: Vec3,
    directions: &[Vec3; LANES],
    cut: &impl CutOut,
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
            let single = traverse(nodes, corners, &packet, cut);
            hit.t[lane] = single.t[0];
            hit.index[lane] = single.index[0];
            hit.b1[lane] = single.b1[0];
            hit.b2[lane] = single.b2[0];
        }
        return hit;
    }
    let packet = Packet::new(origin, directions, kz, mean);
    if let (Some(wide), Some(beam)) = (wide, packet.beam()) {
        return wide.level().run(Through { wide, corners, packet: &packet, beam, cut });
    }
    pulp::Arch::new().dispatch(Traverse { nodes, corners, packet: &packet, cut })
}

/// The traversal, to be compiled for each set of instructions.
struct Traverse<'a, F> {
    nodes: &'a [FlatNode],
    corners: &'a [[Vec3; 3]],
    packet: &'a Packet,
    cut: &'a F,
}

impl<F: CutOut> pulp::WithSimd for Traverse<'_, F> {
    type Output = PacketHit;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> PacketHit {
        traverse(self.nodes, self.corners, self.packet, self.cut)
    }
}

/// Bounds of the rays of a packet that point into one octant.
#[derive(Clone, Copy)]
struct Beam {
    origin: [f32; 3],
    /// Least and largest inverse of the directions.
    inverse: [[f32; 2]; 3],
}

/// The way of a beam through the tree of eight children.
struct Through<'a, F> {
    wide: &'a Wide,
    corners: &'a [[Vec3; 3]],
    packet: &'a Packet,
    beam: Beam,
    cut: &'a F,
}

/// Entries of a beam's stack; trees that may need more take the binary way.
pub(super) const BEAM_STACK: usize = 128;

impl<F: CutOut> Work for Through<'_, F> {
    type Output = PacketHit;

    #[inline(always)]
    fn run<E: Eight>(self, e: E) -> PacketHit {
        let mut hit = MISS;
        let mut nearest = Lanes(hit.t);
        let mut farthest = f32::INFINITY;
        let Beam { origin, inverse } = self.beam;
        let start = [e.splat(origin[0]), e.splat(origin[1]), e.splat(origin[2])];
        let least = [e.splat(inverse[0][0]), e.splat(inverse[1][0]), e.splat(inverse[2][0])];
        let most = [e.splat(inverse[0][1]), e.splat(inverse[1][1]), e.splat(inverse[2][1])];
        let is_up = [inverse[0][0] > 0.0, inverse[1][0] > 0.0, inverse[2][0] > 0.0];
        let (nodes, blocks) = self.wide.parts();
        // Each ray's own bounds lie within these, since rounding is monotone.
        let meet = |node: &Node, farthest: f32| {
            let (mut enter, mut leave) = (e.splat(0.0), e.splat(f32::MAX));
            for axis in 0..3 {
                let (near, far) = if is_up[axis] { (axis, axis + 3) } else { (axis + 3, axis) };
                let near = e.sub(e.load(&node.bounds[near]), start[axis]);
                let far = e.sub(e.load(&node.bounds[far]), start[axis]);
                enter = e.max(e.min(e.mul(near, least[axis]), e.mul(near, most[axis])), enter);
                leave = e.min(e.max(e.mul(far, least[axis]), e.mul(far, most[axis])), leave);
            }
            let leave = e.min(e.mul(leave, e.splat(1.0 + 2.0 * gamma(3))), e.splat(farthest));
            (e.store(enter), e.at_most(enter, leave))
        };
        let mut stack = [Entry::default(); BEAM_STACK];
        let mut top = 0;
        let mut current = Child::node(0);
        loop {
            if current.is_leaf() {
                let first = current.index();
                for block in &blocks[first..first + current.block_count()] {
                    for &index in block.index.iter().take_while(|&&i| i != u32::MAX) {
                        let triangle = &self.corners[index as usize];
                        triangle_test(index, triangle, self.packet, &mut nearest, &mut hit, self.cut);
                    }
                }
                farthest = nearest.0.iter().copied().fold(0.0, f32::max);
            } else {
                let node = &nodes[current.index()];
                let (enter, mut mask) = meet(node, farthest);
                if mask != 0 {
                    let slot = mask.trailing_zeros() as usize & (CHILDREN - 1);
                    mask &= mask - 1;
                    let mut closest = Entry::new(enter[slot], node.child[slot]);
                    let base = top;
                    while mask != 0 {
                        let slot = mask.trailing_zeros() as usize & (CHILDREN - 1);
                        mask &= mask - 1;
                        let mut entry = Entry::new(enter[slot], node.child[slot]);
                        if entry < closest {
                            std::mem::swap(&mut entry, &mut closest);
                        }
                        let mut i = top;
                        while i > base && stack[i - 1] < entry {
                            stack[i] = stack[i - 1];
                            i -= 1;
                        }
                        stack[i] = entry;
                        top += 1;
                    }
                    current = closest.child();
                    continue;
                }
            }
            loop {
                if top == 0 {
                    return hit;
                }
                top -= 1;
                if stack[top].t() <= farthest {
                    current = stack[top].child();
                    break;
                }
            }
        }
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

impl Packet {
    /// Bounds of its rays, if all point into one octant.
    #[inline(always)]
    fn beam(&self) -> Option<Beam> {
        let mut inverse = [[0.0; 2]; 3];
        for (bounds, lanes) in inverse.iter_mut().zip(&self.inverse) {
            let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
            for &v in &lanes.0 {
                low = least(v, low);
                high = most(v, high);
            }
            // Also where one is not a number.
            if !(low > 0.0 || high < 0.0) {
                return None;
            }
            *bounds = [low, high];
        }
        Some(Beam { origin: self.origin, inverse })
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
fn traverse(nodes: &[FlatNode], corners: &[[Vec3; 3]], packet: &Packet, cut: &impl CutOut) -> PacketHit {
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
                triangle_test(index, &corners[index as usize], packet, &mut nearest, &mut hit, cut);
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
    cut: &impl CutOut,
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
    let mut found = Found { t: Lanes([0.0; LANES]), b1: [0.0; LANES], b2: [0.0; LANES], closer: [0; LANES] };
    for i in 0..LANES {
        let (low, high) = (least(least(u.0[i], v.0[i]), w.0[i]), most(most(u.0[i], v.0[i]), w.0[i]));
        let determinant = u.0[i] + v.0[i] + w.0[i];
        let scaled = packet.scale_z.0[i] * (u.0[i] * a[2] + v.0[i] * b[2] + w.0[i] * c[2]);
        let t = scaled / determinant;
        // Of hits at one distance the lowest index counts, in whatever order they come.
        let is_first = (t < nearest.0[i]) | ((t == nearest.0[i]) & (index < hit.index[i]));
        let closer = !((low < 0.0) & (high > 0.0)) & (determinant != 0.0) & (t > 0.0) & is_first;
        found.t.0[i] = t;
        found.b1[i] = v.0[i] / determinant;
        found.b2[i] = w.0[i] / determinant;
        found.closer[i] = u32::from(closer);
    }
    if cut.may_vanish(index) {
        for i in 0..LANES {
            found.closer[i] &=
                u32::from(found.closer[i] != 0 && cut.is_there(index, found.b1[i], found.b2[i]));
        }
    }
    for i in 0..LANES {
        let closer = found.closer[i] != 0;
        let pick = |new: f32, old: f32| if closer { new } else { old };
        nearest.0[i] = pick(found.t.0[i], nearest.0[i]);
        hit.t[i] = pick(found.t.0[i], hit.t[i]);
        hit.b1[i] = pick(found.b1[i], hit.b1[i]);
        hit.b2[i] = pick(found.b2[i], hit.b2[i]);
        hit.index[i] = if closer { index } else { hit.index[i] };
    }
}

/// What the rays find of one triangle.
struct Found {
    t: Lanes,
    b1: [f32; LANES],
    b2: [f32; LANES],
    /// 1 where it is the closest so far.
    closer: [u32; LANES],
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Stream;

    /// Every triangle is there.
    struct Whole;

    impl CutOut for Whole {
        fn may_vanish(&self, _: u32) -> bool {
            false
        }

        fn is_there(&self, _: u32, _: f32, _: f32) -> bool {
            true
        }
    }

    /// Every fifth is not.
    struct Fifths;

    impl CutOut for Fifths {
        fn may_vanish(&self, _: u32) -> bool {
            true
        }

        fn is_there(&self, index: u32, _: f32, _: f32) -> bool {
            !index.is_multiple_of(5)
        }
    }

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
                let hit = intersect(&nodes, None, &corners, eye, &directions, &Whole);
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
            let packet = intersect(&deep, None, &corners, eye, &directions, &Fifths);
            for (l, &direction) in directions.iter().enumerate() {
                let single = intersect(&flat, None, &corners, eye, &[direction; LANES], &Fifths);
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
        let hit = intersect(&nodes, None, &corners, Vec3::ZERO, &[Vec3::Z; LANES], &Whole);
        assert_eq!(hit, MISS);
        assert_eq!(intersect(&[], None, &[], Vec3::ZERO, &[Vec3::Z; LANES], &Whole), MISS);
    }
}
