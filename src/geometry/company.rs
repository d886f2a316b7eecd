//! Sixteen rays side by side: their numbers axis by axis, what bounds all of them, and how they meet a box and a triangle.
//!
//! Each ray meets both by the very operations of a single one (`super::node`, `super::block`), so that what it finds does not
//! depend on its company, to the bit.

use super::Ray;
use super::beam::Beam;
use super::block::{Block, exact};
use super::level::Vectors;
use super::node::{FAR, Node};
use super::packet::LANES;
use super::simd::Simd;

/// Largest components of directions that lie beyond these are followed one by one: their inverses would not be numbers.
const USUAL: [f32; 2] = [1e-15, 1e15];

/// A bit for each ray.
const ALL: u32 = (1 << LANES) - 1;

/// The numbers of the bits that are set.
#[inline(always)]
pub(super) fn bits(mut mask: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lane = (mask != 0).then(|| mask.trailing_zeros() as usize);
        mask &= mask.wrapping_sub(1);
        lane
    })
}

/// The rays, axis by axis. Those that nobody asks for are copies of the first one.
pub(super) struct Company<S: Simd<16>> {
    origin: [S::Lanes; 3],
    direction: [S::Lanes; 3],
    /// Never 0 or infinite: a component of nearly zero would make 0 · ∞, and boxes are padded by far more than it is moved.
    inverse: [S::Lanes; 3],
    /// A little larger, for where rays leave boxes.
    to_far: [S::Lanes; 3],
    /// Which of them point upwards along each axis.
    up: [S::Mask; 3],
    t_min: S::Lanes,
    /// The last distance that counts.
    t_max: S::Lanes,
    /// Which axis dominates each direction, as a single ray chooses it (`block::axes`): x, else y, else z.
    along: [S::Mask; 2],
    /// The one that dominates them all.
    pub(super) axis: Option<usize>,
}

impl<S: Simd<16>> Company<S> {
    #[inline(always)]
    pub(super) fn new(s: S, rays: &[Ray; LANES], asked: u32) -> Self {
        let first = asked.trailing_zeros() as usize & (LANES - 1);
        let (mut origins, mut directions) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
        let mut limits = [[0.0; LANES]; 2];
        for lane in 0..LANES {
            let ray = &rays[if asked >> lane & 1 != 0 { lane } else { first }];
            for axis in 0..3 {
                (origins[axis][lane], directions[axis][lane]) = (ray.origin[axis], ray.direction[axis]);
            }
            (limits[0][lane], limits[1][lane]) = (ray.t_min, ray.t_max.next_down());
        }
        let origin = [s.load(&origins[0]), s.load(&origins[1]), s.load(&origins[2])];
        let direction = [s.load(&directions[0]), s.load(&directions[1]), s.load(&directions[2])];
        let [dx, dy, dz] = direction;
        let (ax, ay, az) = (magnitude(s, dx), magnitude(s, dy), magnitude(s, dz));
        let least = s.mul(s.max(s.max(ax, ay), az), s.splat(1e-20));
        let x = s.and(s.below(ay, ax), s.below(az, ax));
        let y = s.without(s.below(az, ay), s.below(ay, ax));
        let axis = match (s.bits(x), s.bits(y)) {
            (ALL, _) => Some(0),
            (0, ALL) => Some(1),
            (0, 0) => Some(2),
            _ => None,
        };
        let [x_inverse, y_inverse, z_inverse] =
            [inverse(s, dx, ax, least), inverse(s, dy, ay, least), inverse(s, dz, az, least)];
        let (far, zero) = (s.splat(FAR), s.splat(0.0));
        Self {
            origin,
            direction,
            inverse: [x_inverse, y_inverse, z_inverse],
            to_far: [s.mul(x_inverse, far), s.mul(y_inverse, far), s.mul(z_inverse, far)],
            up: [s.below(zero, x_inverse), s.below(zero, y_inverse), s.below(zero, z_inverse)],
            t_min: s.max(s.load(&limits[0]), zero),
            // What is not a number lets nothing count.
            t_max: s.max(s.load(&limits[1]), s.splat(-1.0)),
            along: [x, y],
            axis,
        }
    }

    /// A bit for each ray whose numbers allow it to go along, and for each that is a ray at all.
    #[inline(always)]
    pub(super) fn fit(&self, s: S) -> (u32, u32) {
        let [x, y, z] = self.direction;
        let (x, y, z) = (magnitude(s, x), magnitude(s, y), magnitude(s, z));
        let largest = s.max(s.max(x, y), z);
        // What is not a number has no magnitude that is at most anything.
        let finite = |a: S::Lanes| s.bits(s.at_most(a, s.splat(f32::MAX)));
        let [ox, oy, oz] = self.origin;
        let (ox, oy, oz) = (magnitude(s, ox), magnitude(s, oy), magnitude(s, oz));
        let all = finite(x) & finite(y) & finite(z) & finite(ox) & finite(oy) & finite(oz);
        let usual = s.and(s.at_most(s.splat(USUAL[0]), largest), s.at_most(largest, s.splat(USUAL[1])));
        (all & s.bits(usual), all & s.bits(s.below(s.splat(0.0), largest)))
    }

    /// A bit for each ray that meets the box of a child, where it counts.
    #[inline(always)]
    pub(super) fn meet(&self, s: S, node: &Node, slot: usize) -> u32 {
        let (mut enter, mut leave) = (self.t_min, self.t_max);
        for axis in 0..3 {
            let (low, high) = (s.splat(node.bounds[axis][slot]), s.splat(node.bounds[axis + 3][slot]));
            let from = self.origin[axis];
            let near = s.sub(s.select(self.up[axis], low, high), from);
            let far = s.sub(s.select(self.up[axis], high, low), from);
            enter = s.max(s.mul(near, self.inverse[axis]), enter);
            leave = s.min(s.mul(far, self.to_far[axis]), leave);
        }
        s.bits(s.at_most(enter, leave))
    }
}

#[inline(always)]
fn inverse<S: Simd<16>>(s: S, d: S::Lanes, magnitude: S::Lanes, least: S::Lanes) -> S::Lanes {
    s.div(s.splat(1.0), s.select(s.below(magnitude, least), least, d))
}

#[inline(always)]
fn magnitude<S: Simd<16>>(s: S, a: S::Lanes) -> S::Lanes {
    s.max(a, s.sub(s.splat(0.0), a))
}

/// What bounds all of the rays, for eight boxes at once.
pub(super) struct Bundle<E: Simd<8>> {
    beam: Beam<E>,
    /// The box around all of them, where they do not point into one octant.
    around: Option<[E::Lanes; 6]>,
    farthest: f32,
}

impl<V: Vectors> Bundle<V> {
    #[inline(always)]
    pub(super) fn new(v: V, company: &Company<V>) -> Self {
        let farthest = Simd::<16>::most(v, company.t_max);
        let beam = Beam::from_points(v, &company.origin, &company.inverse);
        let mut around = None;
        if !beam.is_bounded {
            let mut sides = [Simd::<8>::splat(v, 0.0); 6];
            for axis in 0..3 {
                let (from, way) = (company.origin[axis], company.direction[axis]);
                let to = Simd::<16>::add(v, from, Simd::<16>::mul(v, way, company.t_max));
                let (low, high) = (Simd::<16>::min(v, to, from), Simd::<16>::max(v, to, from));
                let (low, high) = (Simd::<16>::least(v, low), Simd::<16>::most(v, high));
                let rounding = 4.0 * f32::EPSILON * low.abs().max(high.abs());
                sides[axis] = Simd::<8>::splat(v, low - rounding);
                sides[axis + 3] = Simd::<8>::splat(v, high + rounding);
            }
            around = Some(sides);
        }
        Self { beam, around, farthest }
    }

    /// A bit for each box that any ray may meet. `side` gives their lower x, y, z and then their upper ones.
    #[inline(always)]
    pub(super) fn meet(&self, v: V, side: impl Fn(usize) -> <V as Simd<8>>::Lanes) -> u32 {
        let (_, mut met) = self.beam.meet(v, &side, self.farthest);
        if let Some(around) = &self.around {
            for axis in 0..3 {
                let begins = Simd::<8>::at_most(v, side(axis), around[axis + 3]);
                let ends = Simd::<8>::at_most(v, around[axis], side(axis + 3));
                met &= Simd::<8>::bits(v, Simd::<8>::and(v, begins, ends));
            }
        }
        met
    }
}

/// Rays prepared for triangles as `block::Shear` prepares one.
pub(super) struct Shears<S: Simd<16>> {
    axes: [usize; 3],
    along: [S::Mask; 2],
    /// In the order of the axes of each.
    origin: [S::Lanes; 3],
    x: S::Lanes,
    y: S::Lanes,
    z: S::Lanes,
    t_min: S::Lanes,
    t_max: S::Lanes,
}

/// Where rays meet one triangle; of use where the mask has a bit.
pub(super) struct TriangleHits {
    pub(super) mask: u32,
    pub(super) t: [f32; LANES],
    pub(super) b1: [f32; LANES],
    pub(super) b2: [f32; LANES],
}

impl<S: Simd<16>> Shears<S> {
    /// `MIXED`: whether the rays differ in their dominant axis. Which of the two other axes comes first does not matter to a
    /// bit: all of what follows changes its sign, twice.
    #[inline(always)]
    pub(super) fn new<const MIXED: bool>(s: S, company: &Company<S>) -> Self {
        let kz = company.axis.unwrap_or(2);
        let mut shears = Self {
            axes: [(kz + 1) % 3, (kz + 2) % 3, kz],
            along: company.along,
            origin: [company.t_min; 3],
            x: company.t_min,
            y: company.t_min,
            z: company.t_min,
            t_min: company.t_min,
            t_max: company.t_max,
        };
        shears.origin = shears.in_order::<MIXED>(s, company.origin);
        let [x, y, z] = shears.in_order::<MIXED>(s, company.direction);
        (shears.x, shears.y, shears.z) = (s.div(x, z), s.div(y, z), s.div(s.splat(1.0), z));
        shears
    }

    /// Coordinates in the order of the axes of each ray.
    #[inline(always)]
    fn in_order<const MIXED: bool>(&self, s: S, of: [S::Lanes; 3]) -> [S::Lanes; 3] {
        if MIXED {
            let [x, y, z] = of;
            let [along_x, along_y] = self.along;
            [
                s.select(along_x, y, s.select(along_y, z, x)),
                s.select(along_x, z, s.select(along_y, x, y)),
                s.select(along_x, x, s.select(along_y, y, z)),
            ]
        } else {
            let [kx, ky, kz] = self.axes;
            [of[kx], of[ky], of[kz]]
        }
    }

    /// A corner in the frames of the rays.
    #[inline(always)]
    fn sheared<const MIXED: bool>(&self, s: S, block: &Block, c: usize, lane: usize) -> [S::Lanes; 3] {
        let [x, y, z] = if MIXED {
            let [x, y, z] = &block.corner[c];
            self.in_order::<MIXED>(s, [s.splat(x[lane]), s.splat(y[lane]), s.splat(z[lane])])
        } else {
            let [kx, ky, kz] = self.axes;
            let of = &block.corner[c];
            [s.splat(of[kx][lane]), s.splat(of[ky][lane]), s.splat(of[kz][lane])]
        };
        let z = s.sub(z, self.origin[2]);
        let x = s.sub(s.sub(x, self.origin[0]), s.mul(self.x, z));
        let y = s.sub(s.sub(y, self.origin[1]), s.mul(self.y, z));
        [x, y, z]
    }

    /// Where those of the rays that `open` has a bit for meet a triangle; `None` where none does.
    #[inline(always)]
    pub(super) fn meet<const MIXED: bool>(
        &self,
        s: S,
        block: &Block,
        lane: usize,
        open: u32,
    ) -> Option<TriangleHits> {
        let [ax, ay, az] = self.sheared::<MIXED>(s, block, 0, lane);
        let [bx, by, bz] = self.sheared::<MIXED>(s, block, 1, lane);
        let [cx, cy, cz] = self.sheared::<MIXED>(s, block, 2, lane);
        let u = s.sub(s.mul(cx, by), s.mul(cy, bx));
        let v = s.sub(s.mul(ax, cy), s.mul(ay, cx));
        let w = s.sub(s.mul(bx, ay), s.mul(by, ax));
        let zero = s.splat(0.0);
        let outside = s.and(s.below(s.min(s.min(u, v), w), zero), s.below(zero, s.max(s.max(u, v), w)));
        let on_edge = s.bits(s.or(s.or(s.equal(u, zero), s.equal(v, zero)), s.equal(w, zero))) & open;
        let determinant = s.add(s.add(u, v), w);
        let candidates = s.without(s.equal(determinant, determinant), outside);
        if s.bits(candidates) & open | on_edge == 0 {
            return None;
        }
        let r = s.div(s.splat(1.0), determinant);
        let along = s.add(s.add(s.mul(u, az), s.mul(v, bz)), s.mul(w, cz));
        let t = s.mul(s.mul(along, self.z), r);
        let inside = s.and(s.below(self.t_min, t), s.at_most(t, self.t_max));
        let mask = s.bits(s.and(candidates, inside)) & open & !on_edge;
        if mask | on_edge == 0 {
            return None;
        }
        let mut hits =
            TriangleHits { mask, t: s.store(t), b1: s.store(s.mul(v, r)), b2: s.store(s.mul(w, r)) };
        if on_edge != 0 {
            let corner = |x, y, z| [s.store(x), s.store(y), s.store(z)];
            let corners = [corner(ax, ay, az), corner(bx, by, bz), corner(cx, cy, cz)];
            let bounds = [s.store(self.t_min), s.store(self.t_max)];
            hits.add_exact(on_edge, &corners, &s.store(self.z), &bounds);
        }
        (hits.mask != 0).then_some(hits)
    }
}

impl TriangleHits {
    /// Where products of f32 do not tell the side of an edge.
    #[cold]
    #[inline(never)]
    fn add_exact(
        &mut self,
        on_edge: u32,
        corners: &[[[f32; LANES]; 3]; 3],
        z: &[f32; LANES],
        [t_min, t_max]: &[[f32; LANES]; 2],
    ) {
        for ray in bits(on_edge) {
            let [a, b, c] = corners.each_ref().map(|corner| corner.map(|lanes| f64::from(lanes[ray])));
            if let Some((t, b1, b2)) = exact(a, b, c, f64::from(z[ray]))
                && t > t_min[ray]
                && t <= t_max[ray]
            {
                self.mask |= 1 << ray;
                (self.t[ray], self.b1[ray], self.b2[ray]) = (t, b1, b2);
            }
        }
    }
}
