//! Origins of secondary rays that cannot lie on the wrong side of their surface.

use glam::Vec3;

/// Bound of the relative error of `n` chained roundings in f32, n·u / (1 − n·u) with u = 2⁻²⁴
/// (Higham 2002; REFERENCE §5.1).
#[inline]
pub const fn gamma(n: u32) -> f32 {
    const U: f32 = 1.0 / 16_777_216.0;
    n as f32 * U / (1.0 - n as f32 * U)
}

/// The next representable number away from zero in the direction of `step`'s sign.
#[inline]
fn one_ulp(v: f32, step: f32) -> f32 {
    if step > 0.0 {
        v.next_up()
    } else if step < 0.0 {
        v.next_down()
    } else {
        v
    }
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
