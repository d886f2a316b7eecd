//! Fresnel reflectance (REFERENCE §4.3).

use glam::Vec3;

/// Reflectance of a dielectric for unpolarised light; `cosine` ≥ 0 on the incident side, `eta` = n_t / n_i.
pub fn dielectric(cosine: f32, eta: f32) -> f32 {
    let c = cosine.clamp(0.0, 1.0);
    let sine_t2 = (1.0 - c * c) / (eta * eta);
    if sine_t2 >= 1.0 {
        return 1.0;
    }
    let t = (1.0 - sine_t2).sqrt();
    let rp = (eta * c - t) / (eta * c + t);
    let rs = (c - eta * t) / (c + eta * t);
    0.5 * (rp * rp + rs * rs)
}

/// Reflectance of a conductor of index `n` and extinction `k`, one band.
pub fn conductor(cosine: f32, n: f32, k: f32) -> f32 {
    let c = cosine.clamp(0.0, 1.0);
    let (c2, s2) = (c * c, 1.0 - c * c);
    let (n2, k2) = (n * n, k * k);
    let t0 = n2 - k2 - s2;
    let q = (t0 * t0 + 4.0 * n2 * k2).sqrt();
    let t1 = q + c2;
    let a = (0.5 * (q + t0)).max(0.0).sqrt();
    let t2 = 2.0 * a * c;
    let rs = (t1 - t2) / (t1 + t2);
    let t3 = c2 * q + s2 * s2;
    let t4 = t2 * s2;
    let rp = rs * (t3 - t4) / (t3 + t4);
    let f = 0.5 * (rs + rp);
    if f.is_finite() { f.clamp(0.0, 1.0) } else { 1.0 }
}

/// Schlick's approximation from the reflectance at normal incidence.
pub fn schlick(cosine: f32, f0: Vec3) -> Vec3 {
    let m = (1.0 - cosine).clamp(0.0, 1.0);
    f0 + (Vec3::ONE - f0) * (m * m * (m * m) * m)
}

/// Schlick's approximation between the reflectances at normal and at grazing incidence.
pub fn schlick_between(cosine: f32, f0: Vec3, f90: Vec3) -> Vec3 {
    let m = (1.0 - cosine).clamp(0.0, 1.0);
    f0 + (f90 - f0) * (m * m * (m * m) * m)
}

/// Reflectance and transmittance of a thin pane, all reflections between its faces summed: without
/// absorption 2R / (1 + R).
pub fn pane(cosine: f32, eta: f32, transmittance: Vec3) -> (Vec3, Vec3) {
    let r = dielectric(cosine, eta);
    let a = transmittance.clamp(Vec3::ZERO, Vec3::ONE);
    let series = Vec3::ONE - a * a * (r * r);
    let series = series.max(Vec3::splat(1e-6));
    let t = a * ((1.0 - r) * (1.0 - r)) / series;
    let reflected = Vec3::splat(r) + a * a * (r * (1.0 - r) * (1.0 - r)) / series;
    (reflected.min(Vec3::ONE), t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math;

    fn degrees(d: f32) -> f32 {
        math::cos(d.to_radians())
    }

    #[test]
    fn reference_4_3() {
        for (angle, f) in [
            (0.0, 0.04),
            (30.0, 0.041523),
            (45.0, 0.050240),
            (60.0, 0.089187),
            (75.0, 0.253061),
            (85.0, 0.612800),
        ] {
            assert!((dielectric(degrees(angle), 1.5) - f).abs() < 1e-5, "{angle}");
        }
        assert!((dielectric(degrees(30.0), 1.0 / 1.5) - 0.055190).abs() < 1e-5);
        assert!((dielectric(degrees(41.0), 1.0 / 1.5) - 0.379751).abs() < 1e-4);
        assert_eq!(dielectric(degrees(42.0), 1.0 / 1.5), 1.0);
        for (angle, f) in [(45.0, 0.042069), (60.0, 0.07), (75.0, 0.254730), (85.0, 0.648492)] {
            assert!((schlick(degrees(angle), Vec3::splat(0.04)).x - f).abs() < 1e-5);
        }
        for (n, k, values) in
            [(0.143, 3.983, [0.966688, 0.965302, 0.963216]), (1.374, 1.777, [0.375, 0.3845, 0.615686])]
        {
            for (angle, f) in [0.0, 45.0, 80.0].into_iter().zip(values) {
                assert!((conductor(degrees(angle), n, k) - f).abs() < 2e-5, "{n} {angle}");
            }
            assert!((conductor(0.0, n, k) - 1.0).abs() < 1e-6);
        }
        for c in [0.1, 0.5, 1.0] {
            assert!((conductor(c, 1.5, 0.0) - dielectric(c, 1.5)).abs() < 1e-5);
        }
    }
}
