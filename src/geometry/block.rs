//! The watertight ray–triangle test of Woop, Benthin and Wald 2013, eight triangles at a time.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::simd::Simd;

/// A ray's own coordinate frame: its direction is the third axis, by a shear instead of a rotation.
///
/// Rounding is monotone, so fl(ab) − fl(cd) never has the *wrong* sign, it can only be 0; there the
/// products are formed in f64, where they are exact. A fused multiply–add would break this, so none
/// is used (REFERENCE §5.2).
#[derive(Clone, Copy, Debug)]
pub(super) struct Shear<E: Simd<8>> {
    /// Axes of the scene, the direction's largest last.
    axes: [usize; 3],
    /// The origin in their order.
    origin: [E::Lanes; 3],
    x: E::Lanes,
    y: E::Lanes,
    z: f32,
}

impl<E: Simd<8>> Shear<E> {
    #[inline(always)]
    pub fn new(e: E, origin: Vec3, direction: Vec3) -> Self {
        let [kx, ky, kz] = axes(direction);
        let (d, o) = (direction.to_array(), origin.to_array());
        Self {
            axes: [kx, ky, kz],
            origin: [e.splat(o[kx]), e.splat(o[ky]), e.splat(o[kz])],
            x: e.splat(d[kx] / d[kz]),
            y: e.splat(d[ky] / d[kz]),
            z: 1.0 / d[kz],
        }
    }

    /// Corners of eight triangles in this frame.
    #[inline(always)]
    fn sheared(&self, e: E, corner: &[[f32; LEAF]; 3]) -> (E::Lanes, E::Lanes, E::Lanes) {
        let [kx, ky, kz] = self.axes;
        let z = e.sub(e.load(&corner[kz]), self.origin[2]);
        let x = e.sub(e.sub(e.load(&corner[kx]), self.origin[0]), e.mul(self.x, z));
        let y = e.sub(e.sub(e.load(&corner[ky]), self.origin[1]), e.mul(self.y, z));
        (x, y, z)
    }
}

/// The axes in a ray's own order: that of its direction's largest component last, so that windings are kept.
#[inline(always)]
pub(super) fn axes(direction: Vec3) -> [usize; 3] {
    let a = direction.abs();
    let kz = if a.x > a.y {
        if a.x > a.z { 0 } else { 2 }
    } else if a.y > a.z {
        1
    } else {
        2
    };
    let (kx, ky) = ((kz + 1) % 3, (kz + 2) % 3);
    if direction[kz] < 0.0 { [ky, kx, kz] } else { [kx, ky, kz] }
}

/// Most triangles of a block.
pub(super) const LEAF: usize = 8;

/// Up to eight triangles in five lines of the cache, corner by corner and axis by axis. Unused lanes are NaN, which no ray
/// hits.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C, align(64))]
pub(super) struct Block {
    /// `corner[c][axis]` of the triangles.
    pub corner: [[[f32; LEAF]; 3]; 3],
    /// Each in the mesh, with [`CUT_OUT`] where it may not be there; `u32::MAX` after the last.
    pub index: [u32; LEAF],
}

/// How far boxes are padded, for each unit of their largest coordinate: slab tests round, and without it rays leak at
/// shared edges.
pub(super) const PADDING: f32 = 1.0 / 1_048_576.0;

/// Flag of triangles that may be cut out.
pub(super) const CUT_OUT: u32 = 1 << 31;

impl Block {
    /// No triangle at all.
    pub const EMPTY: Self = Self { corner: [[[f32::NAN; LEAF]; 3]; 3], index: [u32::MAX; LEAF] };

    /// Adds a triangle, once.
    ///
    /// # Panics
    /// If there are eight others.
    pub fn push(&mut self, (corners, index): ([Vec3; 3], u32)) {
        if self.index.contains(&index) {
            return;
        }
        let lane = self.index.iter().position(|&i| i == u32::MAX).expect("at most eight");
        self.set(lane, corners);
        self.index[lane] = index;
    }

    /// The block of these triangles, with [`CUT_OUT`] where they may not be there; `u32::MAX` holds none.
    pub fn of(index: [u32; LEAF], corners: impl Fn(u32) -> [Vec3; 3]) -> Self {
        let mut block = Self { index, ..Self::EMPTY };
        for (lane, &index) in index.iter().enumerate().filter(|(_, index)| **index != u32::MAX) {
            block.set(lane, corners(index & !CUT_OUT));
        }
        block
    }

    fn set(&mut self, lane: usize, corners: [Vec3; 3]) {
        for (c, p) in corners.iter().enumerate() {
            for axis in 0..3 {
                self.corner[c][axis][lane] = p[axis];
            }
        }
    }

    /// A bit for each lane that holds a triangle.
    #[inline(always)]
    pub fn used(&self) -> u32 {
        let lanes = self.index.iter().enumerate();
        lanes.fold(0, |used, (lane, &index)| used | u32::from(index != u32::MAX) << lane)
    }

    /// Lower x, y, z and upper x, y, z of boxes around the triangles, padded as those of the tree are
    /// ([`bvh`](super::bvh)).
    #[inline(always)]
    pub fn bounds<E: Simd<8>>(&self, e: E) -> [E::Lanes; 6] {
        let zero = e.splat(0.0);
        let corner = |c: usize, axis: usize| e.load(&self.corner[c][axis]);
        let low = |axis: usize| e.min(e.min(corner(0, axis), corner(1, axis)), corner(2, axis));
        let high = |axis: usize| e.max(e.max(corner(0, axis), corner(1, axis)), corner(2, axis));
        let (lx, ly, lz, hx, hy, hz) = (low(0), low(1), low(2), high(0), high(1), high(2));
        let far = |low: E::Lanes, high: E::Lanes| e.max(e.sub(zero, low), high);
        let farthest = e.max(e.max(far(lx, hx), far(ly, hy)), far(lz, hz));
        let pad = e.add(e.mul(farthest, e.splat(PADDING)), e.splat(1e-30));
        [e.sub(lx, pad), e.sub(ly, pad), e.sub(lz, pad), e.add(hx, pad), e.add(hy, pad), e.add(hz, pad)]
    }

    /// Distances and barycentric weights of the second and third corner, and a bit for each lane that
    /// is hit with `t_min < t <= t_max`.
    /// `None` where it is none of them.
    #[inline(always)]
    pub fn intersect<E: Simd<8>>(&self, e: E, s: &Shear<E>, t_min: f32, t_max: f32) -> Option<BlockHits> {
        let (ax, ay, az) = s.sheared(e, &self.corner[0]);
        let (bx, by, bz) = s.sheared(e, &self.corner[1]);
        let (cx, cy, cz) = s.sheared(e, &self.corner[2]);
        let u = e.sub(e.mul(cx, by), e.mul(cy, bx));
        let v = e.sub(e.mul(ax, cy), e.mul(ay, cx));
        let w = e.sub(e.mul(bx, ay), e.mul(by, ax));
        let zero = e.splat(0.0);
        let outside = e.and(e.below(e.min(e.min(u, v), w), zero), e.below(zero, e.max(e.max(u, v), w)));
        let on_edge = e.bits(e.or(e.or(e.equal(u, zero), e.equal(v, zero)), e.equal(w, zero)));
        let det = e.add(e.add(u, v), w);
        // Unused lanes are not a number.
        let candidates = e.without(e.equal(det, det), outside);
        if e.bits(candidates) | on_edge == 0 {
            return None;
        }
        let r = e.div(e.splat(1.0), det);
        let along = e.add(e.add(e.mul(u, az), e.mul(v, bz)), e.mul(w, cz));
        let t = e.mul(e.mul(along, e.splat(s.z)), r);
        let inside = e.and(e.below(e.splat(t_min), t), e.at_most(t, e.splat(t_max)));
        let mut lanes = BlockHits {
            mask: e.bits(e.and(candidates, inside)) & !on_edge,
            t: e.store(t),
            b1: e.store(e.mul(v, r)),
            b2: e.store(e.mul(w, r)),
        };
        if on_edge != 0 {
            let a = [e.store(ax), e.store(ay), e.store(az)];
            let b = [e.store(bx), e.store(by), e.store(bz)];
            let c = [e.store(cx), e.store(cy), e.store(cz)];
            lanes.add_exact(on_edge, &a, &b, &c, s.z, t_min, t_max);
        }
        (lanes.mask != 0).then_some(lanes)
    }
}

/// The result for eight triangles; lanes outside of `mask` hold nothing of use.
pub(super) struct BlockHits {
    pub mask: u32,
    pub t: [f32; LEAF],
    pub b1: [f32; LEAF],
    pub b2: [f32; LEAF],
}

/// A sheared corner of eight triangles, axis by axis.
type Corners = [[f32; LEAF]; 3];

impl BlockHits {
    #[cold]
    #[expect(clippy::too_many_arguments, reason = "all of them what the test in f32 had at hand")]
    fn add_exact(
        &mut self,
        on_edge: u32,
        a: &Corners,
        b: &Corners,
        c: &Corners,
        sz: f32,
        t_min: f32,
        t_max: f32,
    ) {
        for lane in (0..LEAF).filter(|lane| on_edge >> lane & 1 != 0) {
            let at = |p: &Corners| [p[0][lane], p[1][lane], p[2][lane]].map(f64::from);
            if let Some((t, b1, b2)) = exact(at(a), at(b), at(c), f64::from(sz))
                && t > t_min
                && t <= t_max
            {
                self.mask |= 1 << lane;
                (self.t[lane], self.b1[lane], self.b2[lane]) = (t, b1, b2);
            }
        }
    }
}

/// The test in f64 for sheared corners on an edge as seen in f32: the products of f32 are exact.
pub(super) fn exact(a: [f64; 3], b: [f64; 3], c: [f64; 3], sz: f64) -> Option<(f32, f32, f32)> {
    let u = c[0] * b[1] - c[1] * b[0];
    let v = a[0] * c[1] - a[1] * c[0];
    let w = b[0] * a[1] - b[1] * a[0];
    if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
        return None;
    }
    let det = u + v + w;
    if det == 0.0 {
        return None; // degenerate, or seen from its edge
    }
    let t = (u * a[2] + v * b[2] + w * c[2]) * sz / det;
    Some((t as f32, (v / det) as f32, (w / det) as f32))
}

#[cfg(test)]
mod tests {
    use super::super::level::Portable;
    use super::*;

    fn one(corners: [Vec3; 3], origin: Vec3, direction: Vec3) -> Option<(f32, f32, f32)> {
        let mut block = Block::EMPTY;
        block.push((corners, 7));
        let l = block.intersect(Portable, &Shear::new(Portable, origin, direction), 0.0, f32::INFINITY)?;
        assert_eq!(l.mask & !1, 0, "empty lanes are never hit");
        (l.mask != 0).then(|| (l.t[0], l.b1[0], l.b2[0]))
    }

    const T: [Vec3; 3] = [Vec3::ZERO, Vec3::X, Vec3::Y];

    #[test]
    fn inside_edges_and_corners_are_hit_from_both_sides() {
        for (x, y) in [(0.25, 0.25), (0.0, 0.5), (0.5, 0.0), (0.5, 0.5), (0.0, 0.0), (1.0, 0.0), (0.0, 1.0)] {
            for side in [1.0, -1.0] {
                let (t, b1, b2) =
                    one(T, Vec3::new(x, y, 2.0 * side), Vec3::new(0.0, 0.0, -side)).expect("a hit");
                assert_eq!((t, b1, b2), (2.0, x, y));
            }
        }
        assert_eq!(one(T, Vec3::new(0.6, 0.6, 1.0), Vec3::NEG_Z), None);
        assert_eq!(one(T, Vec3::new(0.2, 0.2, 1.0), Vec3::Z), None);
    }

    #[test]
    fn degenerate_and_edge_on_triangles_are_never_hit() {
        for corners in [[Vec3::ZERO; 3], [Vec3::ZERO, Vec3::X, Vec3::X * 2.0], [Vec3::X, Vec3::X, Vec3::Y]] {
            assert_eq!(one(corners, Vec3::new(0.5, 0.0, 1.0), Vec3::NEG_Z), None, "{corners:?}");
        }
        assert_eq!(one(T, Vec3::new(-1.0, 0.25, 0.0), Vec3::X), None);
    }

    #[test]
    fn any_numbers_are_safe() {
        let values = [0.0, 1.0, -1.0, f32::NAN, f32::INFINITY, 1e30, 1e-30, -f32::MAX];
        for &a in &values {
            for &b in &values {
                for d in [Vec3::new(a, b, 1.0), Vec3::new(0.0, a, b), Vec3::ZERO] {
                    if let Some((t, ..)) =
                        one([Vec3::splat(a), Vec3::new(b, 1.0, a), Vec3::Y * b], Vec3::ONE, d)
                    {
                        assert!(t > 0.0);
                    }
                }
            }
        }
    }

    /// Rays from inside an octahedron to points on its edges never get out.
    #[test]
    fn no_ray_slips_between_triangles() {
        for offset in [0.0, 100.0, 10_000.0] {
            let shift = Vec3::new(offset, -offset, 2.0 * offset);
            let p = [Vec3::X, Vec3::Y, Vec3::NEG_X, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z].map(|v| v + shift);
            let mut faces = Vec::new();
            for i in 0..4 {
                faces.push([p[i], p[(i + 1) % 4], p[4]]);
                faces.push([p[(i + 1) % 4], p[i], p[5]]);
            }
            let mut block = Block::EMPTY;
            for (i, &f) in faces.iter().enumerate() {
                block.push((f, i as u32));
            }
            let mut rng = crate::rng::Stream::new(3, offset as u64, 0);
            for _ in 0..100_000 {
                let mut r = || rng.next_f32() * 2.0 - 1.0;
                let origin = shift + Vec3::new(r(), r(), r()) * 0.3;
                let face = &faces[((r() + 1.0) * 4.0) as usize % 8];
                let f = (r() + 1.0) * 0.5;
                let target = face[0] + (face[1] - face[0]) * f;
                let shear = Shear::new(Portable, origin, target - origin);
                let hit = block.intersect(Portable, &shear, 0.0, f32::INFINITY).is_some();
                assert!(hit, "{origin} → {target}");
            }
        }
    }
}
