//! Bounds of up to sixteen rays, tested against eight boxes at once: tight where they point into one octant.

use glam::Vec3;

use super::level::Vectors;
use super::node::CHILDREN;
use super::offset::gamma;
use super::packet::LANES;
use super::simd::Simd;

/// Interval bounds of rays.
pub(super) struct Beam<E: Simd<8>> {
    /// Where the rays begin on each axis: what bounds their entries into boxes, and what bounds their exits.
    pub from: [[E::Lanes; 2]; 3],
    /// Least inverse of the directions.
    lower: [E::Lanes; 3],
    /// Largest.
    upper: [E::Lanes; 3],
    /// The sides of a box where the rays enter and leave.
    sides: [[usize; 2]; 3],
    /// Whether they point into one octant. An axis along which they point both ways bounds nothing.
    pub is_bounded: bool,
}

impl<V: Vectors> Beam<V> {
    /// Rays from one point.
    #[inline(always)]
    pub fn from_point(v: V, origin: Vec3, inverse: &[<V as Simd<16>>::Lanes; 3]) -> Self {
        Self::new(v, origin.to_array().map(|o| [o, o]), inverse)
    }

    /// Rays from the points `origin`, axis by axis.
    #[inline(always)]
    pub fn from_points(
        v: V,
        origin: &[<V as Simd<16>>::Lanes; 3],
        inverse: &[<V as Simd<16>>::Lanes; 3],
    ) -> Self {
        let [x, y, z] = *origin;
        let bounds = [
            [Simd::<16>::least(v, x), Simd::<16>::most(v, x)],
            [Simd::<16>::least(v, y), Simd::<16>::most(v, y)],
            [Simd::<16>::least(v, z), Simd::<16>::most(v, z)],
        ];
        Self::new(v, bounds, inverse)
    }

    /// Rays that begin within `bounds`, least and largest coordinate of each axis.
    #[inline(always)]
    fn new(v: V, bounds: [[f32; 2]; 3], inverse: &[<V as Simd<16>>::Lanes; 3]) -> Self {
        let [x, y, z] = *inverse;
        let mut lower = [Simd::<16>::least(v, x), Simd::<16>::least(v, y), Simd::<16>::least(v, z)];
        let mut upper = [Simd::<16>::most(v, x), Simd::<16>::most(v, y), Simd::<16>::most(v, z)];
        let is_bounded = [0, 1, 2].map(|k| lower[k] > 0.0 || upper[k] < 0.0);
        let e = |value: f32| Simd::<8>::splat(v, value);
        // Upwards, the farther a ray has come before it begins, the sooner it is there.
        let [fx, fy, fz] = [0, 1, 2].map(|k| {
            let [least, largest] = bounds[k];
            if !is_bounded[k] {
                (lower[k], upper[k]) = (1.0, 1.0);
                return [f32::INFINITY, f32::NEG_INFINITY];
            }
            if lower[k] > 0.0 { [largest, least] } else { [least, largest] }
        });
        Self {
            from: [[e(fx[0]), e(fx[1])], [e(fy[0]), e(fy[1])], [e(fz[0]), e(fz[1])]],
            lower: [e(lower[0]), e(lower[1]), e(lower[2])],
            upper: [e(upper[0]), e(upper[1]), e(upper[2])],
            sides: std::array::from_fn(|k| if lower[k] > 0.0 { [k, k + 3] } else { [k + 3, k] }),
            is_bounded: is_bounded == [true; 3],
        }
    }
}

impl<E: Simd<8>> Beam<E> {
    /// Entry distances of eight boxes, and a bit for each that any ray may meet before `farthest`. `side` gives their
    /// lower x, y, z and then their upper ones. Each ray's own bounds lie within these, since rounding is monotone.
    #[inline(always)]
    pub fn meet(&self, e: E, side: impl Fn(usize) -> E::Lanes, farthest: f32) -> ([f32; CHILDREN], u32) {
        let (mut enter, mut leave) = (e.splat(0.0), e.splat(f32::MAX));
        for axis in 0..3 {
            let [near, far] = self.sides[axis];
            let near = e.sub(side(near), self.from[axis][0]);
            let far = e.sub(side(far), self.from[axis][1]);
            let (lower, upper) = (self.lower[axis], self.upper[axis]);
            enter = e.max(e.min(e.mul(near, lower), e.mul(near, upper)), enter);
            leave = e.min(e.max(e.mul(far, lower), e.mul(far, upper)), leave);
        }
        let leave = e.min(e.mul(leave, e.splat(1.0 + 2.0 * gamma(3))), e.splat(farthest));
        (e.store(enter), e.bits(e.at_most(enter, leave)))
    }
}

/// Vectors axis by axis.
#[inline(always)]
pub(super) fn transposed<S: Simd<16>>(s: S, vectors: &[Vec3; LANES]) -> [S::Lanes; 3] {
    let mut lanes = [[0.0; LANES]; 3];
    for (i, d) in vectors.iter().enumerate() {
        (lanes[0][i], lanes[1][i], lanes[2][i]) = (d.x, d.y, d.z);
    }
    [s.load(&lanes[0]), s.load(&lanes[1]), s.load(&lanes[2])]
}

/// Inverses of unit directions.
#[inline(always)]
pub(super) fn inverses<S: Simd<16>>(s: S, [x, y, z]: [S::Lanes; 3]) -> [S::Lanes; 3] {
    [inverse(s, x), inverse(s, y), inverse(s, z)]
}

/// A component of zero would make 0 · ∞; boxes are padded by far more than this moves them.
#[inline(always)]
fn inverse<S: Simd<16>>(s: S, d: S::Lanes) -> S::Lanes {
    let tiny = s.and(s.below(d, s.splat(1e-20)), s.below(s.splat(-1e-20), d));
    s.div(s.splat(1.0), s.select(tiny, s.splat(1e-20), d))
}
