//! Origins of secondary rays that cannot lie on the wrong side of their surface.

use glam::Vec3;

/// Bound of the relative error of `n` chained roundings in f32, n·u / (1 − n·u) with u = 2⁻²⁴
/// (Higham 2002; REFERENCE §5.1).
#[inline]
pub const fn gamma(n: u32) -> f32 {
    const U: f32 = 1.0 / 16_777_216.0;
    n as f32 * U / (1.0 - n as f32 * U)
}

/// The next representable number on the side of `step`'s sign; without branches, which half of all rays would guess wrong.
/// What is not finite becomes something else that is not.
#[inline]
fn one_ulp(v: f32, step: f32) -> f32 {
    const SIGN: u32 = 1 << 31;
    let (bits, sign) = (v.to_bits(), step.to_bits() & SIGN);
    // Away from zero where the signs agree, else towards it, but for zero itself.
    let further = if (bits ^ sign) & SIGN == 0 { 1 } else { u32::MAX };
    let moved = if v == 0.0 { sign | 1 } else { bits.wrapping_add(further) };
    f32::from_bits(if step == 0.0 { bits } else { moved })
}

/// A point near `p` that is certainly on the side of `w`.
///
/// `err`: bound of |error of `p`| per axis; `n`: unit geometric normal of either sign; `w`: direction
/// of the new ray. The point moves along the normal by ⟨|n|, err⟩, and then by one ulp per axis away
/// from the surface. Source: PBRT §6.8.6; REFERENCE §5.4 (a).
#[inline]
pub fn offset_origin(p: Vec3, err: Vec3, n: Vec3, w: Vec3) -> Vec3 {
    let d = n.abs().dot(err);
    let offset = if w.dot(n) < 0.0 { n * -d } else { n * d };
    let q = p + offset;
    Vec3::new(one_ulp(q.x, offset.x), one_ulp(q.y, offset.y), one_ulp(q.z, offset.z))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gamma_has_the_tabulated_values() {
        for (n, expected) in [(3, 1.788_14e-7), (5, 2.980_233e-7), (7, 4.172_327e-7)] {
            assert!((gamma(n) / expected - 1.0).abs() < 1e-6, "γ({n}) = {}", gamma(n));
        }
    }

    #[test]
    fn one_ulp_is_the_next_number() {
        let tiny = f32::from_bits(1);
        for v in [0.0, -0.0, tiny, -tiny, 1.0, -1.0, 0.999_999_94, 2.0, -1e-38, 3e38, f32::MAX, f32::MIN] {
            assert_eq!(one_ulp(v, 0.0).to_bits(), v.to_bits());
            assert_eq!(one_ulp(v, -0.0).to_bits(), v.to_bits());
            for step in [1e-30, 1.0, f32::INFINITY] {
                assert_eq!(one_ulp(v, step), v.next_up(), "{v}");
                assert_eq!(one_ulp(v, -step), v.next_down(), "{v}");
            }
        }
        for v in [f32::INFINITY, f32::NEG_INFINITY, f32::NAN] {
            assert!(!one_ulp(v, v).is_finite());
        }
    }

    #[test]
    fn the_origin_moves_to_the_side_of_the_new_ray() {
        let p = Vec3::new(1000.0, -3.0, 1e-5);
        let n = Vec3::new(0.6, 0.0, 0.8);
        let err = p.abs() * gamma(7);
        for w in [n, -n, Vec3::new(0.6, 5.0, 0.9)] {
            let q = offset_origin(p, err, n, w);
            let moved = (q - p).as_dvec3().dot(n.as_dvec3());
            let wanted = f64::from(n.abs().dot(err));
            assert!(moved * f64::from(w.dot(n).signum()) >= wanted * 0.99, "{moved} {wanted}");
        }
    }
}
