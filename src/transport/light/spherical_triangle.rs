//! Triangles as seen from a point: solid angle and uniform directions (Arvo 1995; REFERENCE §4.4).

use glam::{DVec3, Vec3};

use crate::math;

/// Solid angles in which directions are drawn from the spherical triangle. Smaller ones are as good as flat and
/// would cancel; larger ones have edges that pass the point too closely (pbrt-v4 `shapes.h`).
pub const SAMPLED: std::ops::Range<f64> = 3e-4..6.22;

/// A triangle projected on the unit sphere around a point.
#[derive(Clone, Copy, Debug)]
pub struct SphericalTriangle {
    a: DVec3,
    b: DVec3,
    c: DVec3,
    /// Solid angle, steradians.
    pub solid_angle: f64,
}

impl SphericalTriangle {
    /// `corners` as seen from `point`; `None` where a corner is at the point.
    pub fn new(corners: [Vec3; 3], point: Vec3) -> Option<Self> {
        let [a, b, c] = corners.map(|p| (p.as_dvec3() - point.as_dvec3()).try_normalize());
        let (a, b, c) = (a?, b?, c?);
        // Van Oosterom & Strackee 1983, stable for tiny triangles.
        let solid_angle = 2.0 * math::atan2(a.dot(b.cross(c)).abs(), 1.0 + a.dot(b) + b.dot(c) + c.dot(a));
        Some(Self { a, b, c, solid_angle })
    }

    /// A direction with density 1 / `solid_angle` for `u`, `v` uniform in [0, 1)², in f64, as the equations cancel.
    /// `None` for triangles without solid angle.
    pub fn sample(&self, u: f64, v: f64) -> Option<DVec3> {
        let (a, b, c) = (self.a, self.b, self.c);
        // Normals of the great circles; the inner angles lie between them.
        let (ab, bc, ca) =
            (a.cross(b).try_normalize()?, b.cross(c).try_normalize()?, c.cross(a).try_normalize()?);
        let angle = |p: DVec3, q: DVec3| math::acos(p.dot(q).clamp(-1.0, 1.0));
        let (alpha, beta, gamma) = (angle(ab, -ca), angle(bc, -ab), angle(ca, -bc));
        let area = alpha + beta + gamma - std::f64::consts::PI;
        let (sin_alpha, cos_alpha) = math::sin_cos(alpha);
        let (s, t) = math::sin_cos(u * area - alpha);
        let p = t - cos_alpha;
        let q = s + sin_alpha * a.dot(b);
        let cos_beta = (((q * t - p * s) * cos_alpha - q) / ((q * s + p * t) * sin_alpha)).clamp(-1.0, 1.0);
        if cos_beta.is_nan() {
            return None;
        }
        let ortho = |x: DVec3, y: DVec3| (x - y * x.dot(y)).normalize_or_zero();
        let c2 = a * cos_beta + ortho(c, a) * (1.0 - cos_beta * cos_beta).max(0.0).sqrt();
        let z = 1.0 - v * (1.0 - c2.dot(b));
        let w = b * z + ortho(c2, b) * (1.0 - z * z).max(0.0).sqrt();
        w.try_normalize()
    }
}

/// Barycentric weights of the second and third corner where `direction` from `point` meets the triangle's plane,
/// moved to the triangle where rounding put them outside. `None` if it is parallel to it.
pub fn barycentrics(corners: [Vec3; 3], point: Vec3, direction: DVec3) -> Option<(f32, f32)> {
    let [a, b, c] = corners.map(|p| p.as_dvec3());
    let (e1, e2) = (b - a, c - a);
    let p = direction.cross(e2);
    let determinant = e1.dot(p);
    let s = point.as_dvec3() - a;
    let b1 = (s.dot(p) / determinant).clamp(0.0, 1.0);
    let b2 = (direction.dot(s.cross(e1)) / determinant).clamp(0.0, 1.0);
    if !(b1.is_finite() && b2.is_finite()) {
        return None;
    }
    let scale = (b1 + b2).max(1.0);
    Some(((b1 / scale) as f32, (b2 / scale) as f32))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Stream;

    #[test]
    fn the_octant_is_sampled_uniformly() {
        let octant = SphericalTriangle::new([Vec3::X, Vec3::Y, Vec3::Z], Vec3::ZERO).unwrap();
        assert!((octant.solid_angle - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        let n = 40_000;
        let (mut mean, mut square) = (DVec3::ZERO, DVec3::ZERO);
        for i in 0..n {
            let [u, v] = Stream::new(1, i, 0).next_2d();
            let w = octant.sample(f64::from(u), f64::from(v)).unwrap();
            assert!(w.min_element() > -1e-9 && (w.length() - 1.0).abs() < 1e-12);
            mean += w / n as f64;
            square += w * w / n as f64;
        }
        // Four standard errors: var x = 1/3 − 1/4, var x² = 1/5 − 1/9.
        let n = n as f64;
        assert!((mean - 0.5).abs().max_element() < 4.0 * (1.0 / 12.0 / n).sqrt(), "{mean}");
        assert!((square - 1.0 / 3.0).abs().max_element() < 4.0 * (4.0 / 45.0 / n).sqrt(), "{square}");
    }

    #[test]
    fn solid_angle_of_the_published_triangle() {
        let corners = [Vec3::new(4.0, 1.0, 1.0), Vec3::new(-10.0, 3.0, 3.0), Vec3::new(-2.0, -8.0, 10.0)];
        let t = SphericalTriangle::new(corners, Vec3::new(0.5, -0.4, 0.7)).unwrap();
        assert!((t.solid_angle - 2.932470).abs() < 1e-6, "{}", t.solid_angle);
    }

    #[test]
    fn sampled_directions_meet_the_triangle() {
        let corners = [Vec3::new(1.0, 2.0, 3.0), Vec3::new(-1.0, 2.5, 2.0), Vec3::new(0.5, -1.0, 4.0)];
        let point = Vec3::new(0.1, 0.2, -0.3);
        let t = SphericalTriangle::new(corners, point).unwrap();
        for i in 0..1000 {
            let [u, v] = Stream::new(2, i, 0).next_2d();
            let w = t.sample(f64::from(u), f64::from(v)).unwrap();
            let (b1, b2) = barycentrics(corners, point, w).unwrap();
            let p = corners[0] * (1.0 - b1 - b2) + corners[1] * b1 + corners[2] * b2;
            assert!(((p - point).normalize().as_dvec3() - w).length() < 1e-5);
        }
    }

    #[test]
    fn degenerate_triangles_give_nothing() {
        assert!(SphericalTriangle::new([Vec3::X, Vec3::Y, Vec3::ZERO], Vec3::ZERO).is_none());
        let flat = SphericalTriangle::new([Vec3::X, Vec3::X * 2.0, Vec3::Y], Vec3::ZERO).unwrap();
        assert!(flat.solid_angle.abs() < 1e-12);
        assert!(flat.sample(0.3, 0.4).is_none());
    }
}
