//! glTF's sheen: a layer of fibres that stand up (Estévez & Kulla 2017, with the visibility of Neubelt & Pettineo 2013).
//!
//! ```text
//! D = (2 + 1/α) sin^{1/α} θₕ / (2π),   V = 1 / (4 (NL + NV − NL NV)),   α = r²
//! ```

use std::sync::LazyLock;

use glam::Vec3;
use rayon::prelude::*;

use crate::math;

/// Sides of the table of albedos.
const SIDE: usize = 24;

/// α below which fibres count as no smoother.
const ALPHA_MIN: f32 = 0.01;

/// The layer.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Sheen {
    /// Reflectance, per band.
    pub color: Vec3,
    /// r.
    pub roughness: f32,
}

impl Sheen {
    /// α of r.
    pub fn alpha(&self) -> f32 {
        (self.roughness * self.roughness).clamp(ALPHA_MIN, 1.0)
    }

    /// D V of a layer of this α: between directions in the frame of the surface.
    pub fn value(alpha: f32, o: Vec3, i: Vec3) -> f32 {
        let h = (o + i).normalize_or_zero();
        if o.z <= 0.0 || i.z <= 0.0 || h.z <= 0.0 {
            return 0.0;
        }
        let sine2 = (1.0 - h.z * h.z).max(0.0);
        let d = (2.0 + 1.0 / alpha) * math::powf(sine2, 0.5 / alpha) / std::f32::consts::TAU;
        d / (4.0 * (i.z + o.z - i.z * o.z))
    }

    /// Reflectance of a white layer towards `cosine`.
    pub fn albedo(cosine: f32, alpha: f32) -> f32 {
        let position = |v: f32| {
            let p = (v.clamp(0.0, 1.0) * SIDE as f32 - 0.5).clamp(0.0, (SIDE - 1) as f32);
            let low = (p as usize).min(SIDE - 2);
            (low, p - low as f32)
        };
        let ((x, fx), (y, fy)) = (position(cosine), position(alpha.max(0.0).sqrt()));
        let row = |y: usize| TABLE[y * SIDE + x] + (TABLE[y * SIDE + x + 1] - TABLE[y * SIDE + x]) * fx;
        (row(y) + (row(y + 1) - row(y)) * fy).clamp(0.0, 1.0)
    }

    /// [`Self::mean`] from a table.
    pub fn quick_mean(alpha: f32) -> f32 {
        let p = alpha.clamp(0.0, 1.0).sqrt() * SIDE as f32;
        let low = (p as usize).min(SIDE - 1);
        MEANS[low] + (MEANS[low + 1] - MEANS[low]) * (p - low as f32)
    }

    /// The cosine-weighted mean of [`Self::albedo`].
    pub fn mean(alpha: f32) -> f32 {
        const STEPS: usize = 48;
        let of = |i: usize| {
            let cosine = (i as f32 + 0.5) / STEPS as f32;
            2.0 * cosine * Self::albedo(cosine, alpha)
        };
        (0..STEPS).map(of).sum::<f32>() / STEPS as f32
    }
}

/// Means by r, from 0 to 1.
static MEANS: LazyLock<Vec<f32>> = LazyLock::new(|| {
    let of = |i: usize| Sheen::mean((i as f32 / SIDE as f32).powi(2).max(ALPHA_MIN));
    (0..=SIDE).map(of).collect()
});

/// Albedos by cosine and r.
static TABLE: LazyLock<Vec<f32>> = LazyLock::new(|| {
    const SAMPLES: u32 = 256;
    let entry = |i: usize| {
        let cosine = ((i % SIDE) as f32 + 0.5) / SIDE as f32;
        let r = ((i / SIDE) as f32 + 0.5) / SIDE as f32;
        let o = Vec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
        let alpha = (r * r).max(ALPHA_MIN);
        let sum: f32 = (0..SAMPLES)
            .map(|k| {
                let phi = std::f32::consts::TAU * (k.reverse_bits() as f32 / 4_294_967_296.0);
                let z = (k as f32 + 0.5) / SAMPLES as f32;
                let s = (1.0 - z * z).sqrt();
                Sheen::value(alpha, o, Vec3::new(s * math::cos(phi), s * math::sin(phi), z)) * z
            })
            .sum();
        // Uniform over the hemisphere.
        (sum * std::f32::consts::TAU / SAMPLES as f32).min(1.0)
    };
    (0..SIDE * SIDE).into_par_iter().map(entry).collect()
});

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fibres_shine_at_grazing_angles_and_never_more_than_all() {
        for r in [0.1, 0.3, 0.5, 0.8, 1.0f32] {
            let alpha = r * r;
            let (straight, grazing) = (Sheen::albedo(1.0, alpha), Sheen::albedo(0.05, alpha));
            assert!(straight < grazing && grazing <= 1.0, "{r}: {straight} {grazing}");
            let mean = Sheen::mean(alpha);
            assert!(mean > 0.0 && mean < 0.6, "{r}: {mean}");
            assert!((Sheen::quick_mean(alpha) - mean).abs() < 0.01, "{r}");
        }
        let (o, i) = (Vec3::new(0.6, 0.0, 0.8), Vec3::new(0.0, 0.8, 0.6));
        assert_eq!(Sheen::value(0.5, o, i), Sheen::value(0.5, i, o));
        assert_eq!(Sheen::value(0.5, o, -i), 0.0);
    }
}
