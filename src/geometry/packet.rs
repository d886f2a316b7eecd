//! Sixteen primary rays at once.
//!
//! All rays of a packet leave one eye. Those that point into one octant go through the tree as one beam: interval bounds
//! of their directions decide for eight boxes at once whether any ray can meet them, so that a packet visits nodes at the
//! price of a single ray; only triangles are tested for each ray. The triangle test is the watertight one of Woop,
//! Benthin & Wald 2013 (REFERENCE §5.2) with one shear axis for the packet: each ray meets all triangles with the same
//! shear, which is what watertightness needs.

use arrayvec::ArrayVec;
use glam::Vec3;

use super::beam::{Beam, inverses, transposed};
use super::block::CUT_OUT;
use super::level::{Vectors, Work};
use super::node::Child;
use super::simd::Simd;
use super::stack::{STACK, Stack};
use super::wide::Wide;

/// Rays of a packet.
pub const LANES: usize = 16;

/// Hits of a packet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PacketHit {
    /// Distances; infinite where a ray misses.
    pub t: [f32; LANES],
    /// Triangles; of no meaning where a ray misses.
    pub triangle: [u32; LANES],
    /// Barycentric weight of the second corner.
    pub b1: [f32; LANES],
    /// Barycentric weight of the third corner.
    pub b2: [f32; LANES],
}

/// A bit for each ray.
const ALL: u32 = (1 << LANES) - 1;

/// Components along the packet's dominant axis below this are traced in packets of their own.
const SHALLOW: f32 = 1e-2;

/// Closest hits of sixteen rays from `origin` along unit `directions`; those that are none hit nothing. Cut-out
/// triangles are hit where `is_there` is true of their barycentric weights of the second and third corner.
pub(super) fn intersect(
    wide: &Wide,
    origin: Vec3,
    directions: &[Vec3; LANES],
    is_there: &impl Fn(u32, f32, f32) -> bool,
) -> PacketHit {
    wide.level().run(Through { wide, origin, directions, is_there })
}

/// The way of a packet through the tree, to be compiled for each set of instructions.
struct Through<'a, F> {
    wide: &'a Wide,
    origin: Vec3,
    directions: &'a [Vec3; LANES],
    is_there: &'a F,
}

impl<F: Fn(u32, f32, f32) -> bool> Work for Through<'_, F> {
    type Output = PacketHit;
    const SIXTEEN: bool = true;

    #[inline(always)]
    fn run<V: Vectors>(self, v: V) -> PacketHit {
        if self.wide.stack() <= STACK {
            self.go(v, &mut ArrayVec::<_, STACK>::new())
        } else {
            self.go(v, &mut Vec::with_capacity(self.wide.stack()))
        }
    }
}

impl<F: Fn(u32, f32, f32) -> bool> Through<'_, F> {
    #[inline(always)]
    fn go<V: Vectors>(&self, v: V, stack: &mut impl Stack) -> PacketHit {
        let mut hits = ClosestHits::new(v);
        if self.wide.is_empty() || !self.origin.is_finite() {
            return hits.store(v);
        }
        // Finite only if all of them are.
        let sum: Vec3 = self.directions.iter().sum();
        let axis = dominant_axis(sum);
        if sum.is_finite() && self.directions.iter().all(|d| d[axis].abs() > SHALLOW) {
            self.all(v, self.directions, axis, &mut hits, stack);
            return hits.store(v);
        }
        self.one_by_one(v, stack)
    }

    /// A wide packet (a tiny picture, a huge field of view): each ray as a packet of its own. What is not a number would
    /// meet every box, those of children that there are not as well.
    #[cold]
    #[inline(never)]
    fn one_by_one<V: Vectors>(&self, v: V, stack: &mut impl Stack) -> PacketHit {
        let mut found = ClosestHits::new(v).store(v);
        let is_direction = |d: &Vec3| d.is_finite() && *d != Vec3::ZERO;
        for (lane, &d) in self.directions.iter().enumerate().filter(|(_, d)| is_direction(d)) {
            let mut hits = ClosestHits::new(v);
            self.all(v, &[d; LANES], dominant_axis(d), &mut hits, stack);
            let one = hits.store(v);
            (found.t[lane], found.triangle[lane]) = (one.t[0], one.triangle[0]);
            (found.b1[lane], found.b2[lane]) = (one.b1[0], one.b2[0]);
        }
        found
    }

    /// Beam after beam.
    #[inline(always)]
    fn all<V: Vectors>(
        &self,
        v: V,
        directions: &[Vec3; LANES],
        axis: usize,
        hits: &mut ClosestHits<V>,
        stack: &mut impl Stack,
    ) {
        let packet = Packet::new(v, directions, axis);
        let up = packet.up(v);
        if up.iter().all(|&bits| bits == 0 || bits == ALL) {
            let beam = Beam::from_point(v, self.origin, &packet.inverse);
            self.travel(v, &packet, &beam, Simd::<16>::splat(v, f32::INFINITY), hits, stack);
            return;
        }
        let mut left = ALL;
        while left != 0 {
            let lane = left.trailing_zeros();
            let alike = |bits: u32| if bits >> lane & 1 != 0 { bits } else { !bits };
            let members = up.iter().fold(left, |members, &bits| members & alike(bits));
            left &= !members;
            let is_member = |l: usize| members >> l & 1 != 0;
            let theirs = std::array::from_fn(|l| directions[if is_member(l) { l } else { lane as usize }]);
            let beam = Beam::from_point(v, self.origin, &inverses(v, transposed(v, &theirs)));
            // No ray but its own keeps a beam going.
            let reach = std::array::from_fn(|l| if is_member(l) { f32::INFINITY } else { 0.0 });
            self.travel(v, &packet, &beam, Simd::<16>::load(v, &reach), hits, stack);
        }
    }

    #[inline(always)]
    fn travel<V: Vectors>(
        &self,
        v: V,
        packet: &Packet<V>,
        beam: &Beam<V>,
        reach: <V as Simd<16>>::Lanes,
        hits: &mut ClosestHits<V>,
        stack: &mut impl Stack,
    ) {
        let (nodes, blocks) = self.wide.parts();
        let [kx, ky, kz] = packet.axes;
        let origin = [beam.from[kx][0], beam.from[ky][0], beam.from[kz][0]];
        let mut farthest = hits.farthest(v, reach);
        let mut current = Child::node(0);
        loop {
            if current.is_leaf() {
                let block = &blocks[current.index()];
                let from_eye = |c: usize, k: usize| {
                    let corners = Simd::<8>::load(v, &block.corner[c][packet.axes[k]]);
                    Simd::<8>::store(v, Simd::<8>::sub(v, corners, origin[k]))
                };
                // Written out, since what goes through `map` stays in no register.
                let a = [from_eye(0, 0), from_eye(0, 1), from_eye(0, 2)];
                let b = [from_eye(1, 0), from_eye(1, 1), from_eye(1, 2)];
                let c = [from_eye(2, 0), from_eye(2, 1), from_eye(2, 2)];
                let mut closer = false;
                for (lane, &index) in block.index.iter().enumerate() {
                    if index == u32::MAX {
                        break;
                    }
                    let corners = [
                        [a[0][lane], a[1][lane], a[2][lane]],
                        [b[0][lane], b[1][lane], b[2][lane]],
                        [c[0][lane], c[1][lane], c[2][lane]],
                    ];
                    closer |= packet.meet(v, corners, index, hits, self.is_there);
                }
                if closer {
                    farthest = hits.farthest(v, reach);
                }
            } else {
                let node = &nodes[current.index()];
                let (enter, mask) = beam.meet(v, |side| Simd::<8>::load(v, &node.bounds[side]), farthest);
                if mask != 0 {
                    current = stack.visit::<true>(node, &enter, mask, |_| ());
                    continue;
                }
            }
            loop {
                let Some(next) = stack.pop() else { return };
                if next.t() <= farthest {
                    current = next.child();
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

/// Rays prepared for triangles.
struct Packet<S: Simd<16>> {
    inverse: [S::Lanes; 3],
    axes: [usize; 3],
    shear_x: S::Lanes,
    shear_y: S::Lanes,
    scale_z: S::Lanes,
}

impl<S: Simd<16>> Packet<S> {
    #[inline(always)]
    fn new(s: S, directions: &[Vec3; LANES], kz: usize) -> Self {
        let d = transposed(s, directions);
        let (kx, ky) = ((kz + 1) % 3, (kz + 2) % 3);
        Self {
            inverse: inverses(s, d),
            axes: [kx, ky, kz],
            shear_x: s.div(d[kx], d[kz]),
            shear_y: s.div(d[ky], d[kz]),
            scale_z: s.div(s.splat(1.0), d[kz]),
        }
    }

    /// A corner seen along the rays.
    #[inline(always)]
    fn sheared(&self, s: S, corner: [f32; 3], z: S::Lanes) -> (S::Lanes, S::Lanes) {
        let x = s.sub(s.splat(corner[0]), s.mul(self.shear_x, z));
        (x, s.sub(s.splat(corner[1]), s.mul(self.shear_y, z)))
    }

    /// For each axis a bit for each ray that goes up it.
    #[inline(always)]
    fn up(&self, s: S) -> [u32; 3] {
        let [x, y, z] = self.inverse;
        let zero = s.splat(0.0);
        [s.bits(s.below(zero, x)), s.bits(s.below(zero, y)), s.bits(s.below(zero, z))]
    }

    /// Tests a triangle, given from the eye in the packet's order of axes; says whether any ray has found it closer.
    #[inline(always)]
    fn meet(
        &self,
        s: S,
        corners: [[f32; 3]; 3],
        index: u32,
        hits: &mut ClosestHits<S>,
        is_there: &impl Fn(u32, f32, f32) -> bool,
    ) -> bool {
        let zero = s.splat(0.0);
        let [a, b, c] = corners;
        let (az, bz, cz) = (s.splat(a[2]), s.splat(b[2]), s.splat(c[2]));
        let (ax, ay) = self.sheared(s, a, az);
        let (bx, by) = self.sheared(s, b, bz);
        let (cx, cy) = self.sheared(s, c, cz);
        let mut u = s.sub(s.mul(cx, by), s.mul(cy, bx));
        let mut v = s.sub(s.mul(ax, cy), s.mul(ay, cx));
        let mut w = s.sub(s.mul(bx, ay), s.mul(by, ax));
        let mut out = outside(s, u, v, w);
        if s.bits(out) == ALL {
            return false;
        }
        let on_edge = s.bits(s.or(s.or(s.equal(u, zero), s.equal(v, zero)), s.equal(w, zero)));
        if on_edge != 0 {
            let x = [s.store(ax), s.store(bx), s.store(cx)];
            let y = [s.store(ay), s.store(by), s.store(cy)];
            let exact = exact_edges(x, y, [s.store(u), s.store(v), s.store(w)], on_edge);
            (u, v, w) = (s.load(&exact[0]), s.load(&exact[1]), s.load(&exact[2]));
            out = outside(s, u, v, w);
        }
        let determinant = s.add(s.add(u, v), w);
        let along = s.add(s.add(s.mul(u, az), s.mul(v, bz)), s.mul(w, cz));
        let t = s.div(s.mul(self.scale_z, along), determinant);
        let out = s.or(out, s.equal(determinant, zero));
        let in_front = s.without(s.below(zero, t), out);
        let mut closer = s.and(in_front, s.below(t, hits.t));
        let triangle = index & !CUT_OUT;
        let ties = s.bits(s.and(in_front, s.equal(t, hits.t)));
        if ties != 0 {
            // Of hits at one distance the lowest triangle counts, in whatever order they come.
            let bound = s.load(&lower_ties(s.store(hits.t), s.store(hits.triangle), triangle, ties));
            closer = s.and(in_front, s.below(t, bound));
        }
        if s.bits(closer) == 0 {
            return false;
        }
        if index & CUT_OUT != 0 {
            let (b1, b2) = (s.store(s.div(v, determinant)), s.store(s.div(w, determinant)));
            let bits = s.bits(closer);
            let bound = std::array::from_fn(|l| {
                if bits >> l & 1 != 0 && is_there(triangle, b1[l], b2[l]) { f32::INFINITY } else { 0.0 }
            });
            closer = s.and(closer, s.below(t, s.load(&bound)));
        }
        hits.t = s.select(closer, t, hits.t);
        hits.triangle = s.select(closer, s.splat(f32::from_bits(triangle)), hits.triangle);
        hits.v = s.select(closer, v, hits.v);
        hits.w = s.select(closer, w, hits.w);
        hits.determinant = s.select(closer, determinant, hits.determinant);
        true
    }
}

/// Rays with edge functions of both signs.
#[inline(always)]
fn outside<S: Simd<16>>(s: S, u: S::Lanes, v: S::Lanes, w: S::Lanes) -> S::Mask {
    let zero = s.splat(0.0);
    let negative = s.below(s.min(s.min(u, v), w), zero);
    s.and(negative, s.below(zero, s.max(s.max(u, v), w)))
}

/// Edge functions where one of them seems to be zero: only exact products tell the side.
#[cold]
#[inline(never)]
fn exact_edges(
    x: [[f32; LANES]; 3],
    y: [[f32; LANES]; 3],
    mut edges: [[f32; LANES]; 3],
    lanes: u32,
) -> [[f32; LANES]; 3] {
    for l in (0..LANES).filter(|l| lanes >> l & 1 != 0) {
        let product = |a: f32, b: f32| f64::from(a) * f64::from(b);
        for (edge, [p, q]) in edges.iter_mut().zip([[2, 1], [0, 2], [1, 0]]) {
            edge[l] = (product(x[p][l], y[q][l]) - product(y[p][l], x[q][l])) as f32;
        }
    }
    edges
}

/// Distances below which a hit of `triangle` counts: just above what was found where it is a tie with a higher triangle.
#[cold]
#[inline(never)]
fn lower_ties(mut t: [f32; LANES], found: [f32; LANES], triangle: u32, ties: u32) -> [f32; LANES] {
    for l in 0..LANES {
        if ties >> l & 1 != 0 && triangle < found[l].to_bits() {
            t[l] = t[l].next_up();
        }
    }
    t
}

/// What the rays have found so far.
struct ClosestHits<S: Simd<16>> {
    t: S::Lanes,
    /// Triangles, as bits.
    triangle: S::Lanes,
    /// Edge functions of the second and third corner, and the sum of all three, by which they are weights.
    v: S::Lanes,
    w: S::Lanes,
    determinant: S::Lanes,
}

impl<S: Simd<16>> ClosestHits<S> {
    #[inline(always)]
    fn new(s: S) -> Self {
        let zero = s.splat(0.0);
        Self { t: s.splat(f32::INFINITY), triangle: zero, v: zero, w: zero, determinant: s.splat(1.0) }
    }

    /// Up to where something may still be closer, for rays that have `reach`.
    #[inline(always)]
    fn farthest(&self, s: S, reach: S::Lanes) -> f32 {
        s.most(s.min(self.t, reach))
    }

    #[inline(always)]
    fn store(&self, s: S) -> PacketHit {
        PacketHit {
            t: s.store(self.t),
            triangle: bytemuck::cast(s.store(self.triangle)),
            b1: s.store(s.div(self.v, self.determinant)),
            b2: s.store(s.div(self.w, self.determinant)),
        }
    }
}

#[cfg(test)]
#[path = "packet_tests.rs"]
mod tests;
