//! The watertight ray–triangle test of Woop, Benthin and Wald 2013, four triangles at a time.

use glam::{Vec3, Vec4};

/// A ray's own coordinate frame: its direction is the third axis, by a shear instead of a rotation.
///
/// Rounding is monotone, so fl(ab) − fl(cd) never has the *wrong* sign, it can only be 0; there the
/// products are formed in f64, where they are exact. A fused multiply–add would break this, so none
/// is used (REFERENCE §5.2).
#[derive(Clone, Copy, Debug)]
pub(super) struct Shear {
    pub kx: usize,
    pub ky: usize,
    pub kz: usize,
    pub sx: f32,
    pub sy: f32,
    pub sz: f32,
}

impl Shear {
    #[inline]
    pub fn new(direction: Vec3) -> Self {
        let a = direction.abs();
        let kz = if a.x > a.y {
            if a.x > a.z { 0 } else { 2 }
        } else if a.y > a.z {
            1
        } else {
            2
        };
        let (mut kx, mut ky) = ((kz + 1) % 3, (kz + 2) % 3);
        let d = direction.to_array();
        if d[kz] < 0.0 {
            std::mem::swap(&mut kx, &mut ky); // keeps the winding
        }
        Self { kx, ky, kz, sx: d[kx] / d[kz], sy: d[ky] / d[kz], sz: 1.0 / d[kz] }
    }
}

/// Up to four triangles, corner by corner and axis by axis. Unused lanes are NaN, which no ray hits.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub(super) struct Block {
    /// `corner[c][axis]` of the four triangles.
    pub corner: [[Vec4; 3]; 3],
    /// Index of each in the order of the leaves.
    pub index: [u32; 4],
}

impl Block {
    /// No triangle at all.
    pub const EMPTY: Self = Self { corner: [[Vec4::NAN; 3]; 3], index: [u32::MAX; 4] };

    /// Puts a triangle into a lane.
    pub fn set(&mut self, lane: usize, corners: [Vec3; 3], index: u32) {
        for (c, p) in corners.iter().enumerate() {
            for axis in 0..3 {
                self.corner[c][axis][lane] = p[axis];
            }
        }
        self.index[lane] = index;
    }

    /// Distances and barycentric weights of the second and third corner, and a bit for each lane that
    /// is hit with `t_min < t <= t_max`.
    /// `None` where it is none of them.
    #[inline(always)]
    pub fn intersect(&self, origin: [Vec4; 3], s: &Shear, t_min: f32, t_max: f32) -> Option<Lanes> {
        let (sx, sy, sz) = (Vec4::splat(s.sx), Vec4::splat(s.sy), Vec4::splat(s.sz));
        let sheared = |c: usize| {
            let z = self.corner[c][s.kz] - origin[s.kz];
            let x = (self.corner[c][s.kx] - origin[s.kx]) - sx * z;
            let y = (self.corner[c][s.ky] - origin[s.ky]) - sy * z;
            (x, y, z)
        };
        let (ax, ay, az) = sheared(0);
        let (bx, by, bz) = sheared(1);
        let (cx, cy, cz) = sheared(2);
        let u = cx * by - cy * bx;
        let v = ax * cy - ay * cx;
        let w = bx * ay - by * ax;
        let zero = Vec4::ZERO;
        let negative = u.min(v).min(w).cmplt(zero);
        let positive = u.max(v).max(w).cmpgt(zero);
        let on_edge = (u.cmpeq(zero) | v.cmpeq(zero) | w.cmpeq(zero)).bitmask();
        let det = u + v + w;
        // Unused lanes are not a number.
        let candidates = !(negative & positive) & det.cmpeq(det);
        if candidates.bitmask() | on_edge == 0 {
            return None;
        }
        let r = det.recip();
        let t = (u * az + v * bz + w * cz) * sz * r;
        let inside = candidates & t.cmpgt(Vec4::splat(t_min)) & t.cmple(Vec4::splat(t_max));
        let mut lanes = Lanes {
            mask: inside.bitmask() & !on_edge,
            t: t.to_array(),
            b1: (v * r).to_array(),
            b2: (w * r).to_array(),
        };
        if on_edge != 0 {
            let a = [ax, ay, az].map(|v| v.to_array());
            let b = [bx, by, bz].map(|v| v.to_array());
            let c = [cx, cy, cz].map(|v| v.to_array());
            for lane in 0..4 {
                if on_edge & (1 << lane) != 0 {
                    let at = |p: &[[f32; 4]; 3]| [p[0][lane], p[1][lane], p[2][lane]].map(f64::from);
                    if let Some((t, b1, b2)) = exact(at(&a), at(&b), at(&c), f64::from(s.sz))
                        && t > t_min
                        && t <= t_max
                    {
                        lanes.mask |= 1 << lane;
                        (lanes.t[lane], lanes.b1[lane], lanes.b2[lane]) = (t, b1, b2);
                    }
                }
            }
        }
        (lanes.mask != 0).then_some(lanes)
    }
}

/// The result for four triangles; lanes outside of `mask` hold nothing of use.
pub(super) struct Lanes {
    pub mask: u32,
    pub t: [f32; 4],
    pub b1: [f32; 4],
    pub b2: [f32; 4],
}

/// The test in f64 for sheared corners on an edge as seen in f32: the products of f32 are exact.
#[cold]
fn exact(a: [f64; 3], b: [f64; 3], c: [f64; 3], sz: f64) -> Option<(f32, f32, f32)> {
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
    use super::*;

    fn one(corners: [Vec3; 3], origin: Vec3, direction: Vec3) -> Option<(f32, f32, f32)> {
        let mut block = Block::EMPTY;
        block.set(2, corners, 7);
        let o = origin.to_array().map(Vec4::splat);
        let l = block.intersect(o, &Shear::new(direction), 0.0, f32::INFINITY)?;
        assert_eq!(l.mask & !4, 0, "empty lanes are never hit");
        (l.mask != 0).then(|| (l.t[2], l.b1[2], l.b2[2]))
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
            let mut blocks = [Block::EMPTY; 2];
            for (i, &f) in faces.iter().enumerate() {
                blocks[i / 4].set(i % 4, f, i as u32);
            }
            let mut rng = crate::rng::Stream::new(3, offset as u64, 0);
            for _ in 0..100_000 {
                let mut r = || rng.next_f32() * 2.0 - 1.0;
                let origin = shift + Vec3::new(r(), r(), r()) * 0.3;
                let face = &faces[((r() + 1.0) * 4.0) as usize % 8];
                let f = (r() + 1.0) * 0.5;
                let target = face[0] + (face[1] - face[0]) * f;
                let shear = Shear::new(target - origin);
                let o = origin.to_array().map(Vec4::splat);
                let hit = blocks.iter().any(|b| b.intersect(o, &shear, 0.0, f32::INFINITY).is_some());
                assert!(hit, "{origin} → {target}");
            }
        }
    }
}
