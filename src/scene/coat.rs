//! A dielectric coat over a diffuse base.
//!
//! A coat reflects E(μ) of the light from a direction: its lobe over all directions, or Fresnel's F(μ) where it is smooth. The
//! rest, T = 1 − E, goes in. Below it the base of albedo b and the coat's inner side, which sends back f = 1 − (1 − F̄) / n²
//! of diffuse light, pass it to and fro:
//!
//! ```text
//! diffuse = b (1 − f) / (1 − b f) / π · T(μₒ) T(μᵢ) / T̄
//! ```
//!
//! so that lobe and base of a white surface together give back all light, from every direction and whatever the roughness.
//! What a rough lobe loses between its facets goes in, too.

use glam::Vec3;

use super::microfacet::Microfacet;
use super::{Roughness, fresnel};

/// Places at which T is kept.
const NODES: usize = 16;
/// Samples of E at each.
const SAMPLES: u32 = 512;
/// Steps of the means.
const STEPS: usize = 512;

/// The coat of a plastic.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Coat {
    /// Its refractive index, in [1, 3]. With 1 there is none.
    pub ior: f32,
    /// Roughness of its surface.
    pub roughness: Roughness,
    /// T at cosines (i / 15)², where it is rough.
    crossing: [f32; NODES],
    /// T̄, the mean of T over the hemisphere, weighted by the cosine.
    mean: f32,
    /// f, what its inner side sends back.
    inner: f32,
}

impl Coat {
    /// The coat of this index; indices are bounded to [1, 3].
    pub fn new(ior: f32, roughness: Roughness) -> Self {
        let ior = if ior.is_finite() { ior.clamp(1.0, 3.0) } else { 1.0 };
        let mut coat = Self { ior, roughness, crossing: [1.0; NODES], mean: 1.0, inner: 0.0 };
        if coat.is_none() {
            return coat;
        }
        if let Some(microfacet) = Microfacet::of(&roughness) {
            coat.crossing = std::array::from_fn(|i| {
                let root = i as f32 / (NODES - 1) as f32;
                let fresnel = |oh| [fresnel::dielectric(oh, ior)];
                let [reflected] = microfacet.albedo((root * root).max(1e-3), SAMPLES, fresnel);
                (1.0 - reflected).clamp(0.0, 1.0)
            });
        }
        let outer = mean(|cosine| fresnel::dielectric(cosine, ior));
        coat.inner = 1.0 - (1.0 - outer) / (ior * ior);
        coat.mean = mean(|cosine| coat.crosses(cosine)).max(1e-3);
        coat
    }

    /// Whether there is none.
    pub fn is_none(&self) -> bool {
        self.ior == 1.0
    }

    /// T towards a direction.
    #[inline]
    pub fn crosses(&self, cosine: f32) -> f32 {
        if self.roughness.is_smooth() {
            return 1.0 - fresnel::dielectric(cosine, self.ior);
        }
        let x = cosine.clamp(0.0, 1.0).sqrt() * (NODES - 1) as f32;
        let low = (x as usize).min(NODES - 2);
        self.crossing[low] + (self.crossing[low + 1] - self.crossing[low]) * (x - low as f32)
    }

    /// T / T̄: how much more or less of the base shows towards a direction than on average.
    #[inline]
    pub fn factor(&self, cosine: f32) -> f32 {
        self.crosses(cosine) / self.mean
    }

    /// Ē: what it reflects of diffuse light.
    pub fn reflects(&self) -> f32 {
        1.0 - self.mean
    }

    /// The albedo of a base of albedo b below it, the mean over all directions, is `b · in_and_out / (1 − b · back)`.
    #[inline]
    pub fn in_and_out(&self) -> f32 {
        self.mean * (1.0 - self.inner)
    }

    /// See [`Self::in_and_out`].
    #[inline]
    pub fn back(&self) -> f32 {
        self.inner
    }

    /// Albedo of this base below it, the mean over all directions.
    #[inline]
    pub fn albedo(&self, base: Vec3) -> Vec3 {
        base * self.in_and_out() / (Vec3::ONE - base * self.back())
    }
}

/// Mean over the hemisphere, weighted by the cosine.
fn mean(value: impl Fn(f32) -> f32) -> f32 {
    // Even in the cosine's root: values change fastest where it grazes.
    let at = |i: usize| {
        let root = (i as f32 + 0.5) / STEPS as f32;
        4.0 * root * root * root * value(root * root)
    };
    (0..STEPS).map(at).sum::<f32>() / STEPS as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math;
    use crate::scene::Distribution;

    fn rough(alpha: f32, distribution: Distribution) -> Roughness {
        Roughness { alpha_x: alpha, alpha_y: alpha, distribution }
    }

    /// Walsh's closed form of the mean of Fresnel's reflectance from outside.
    fn walsh(n: f64) -> f64 {
        let n2 = n * n;
        0.5 + (n - 1.0) * (3.0 * n + 1.0) / (6.0 * (n + 1.0).powi(2))
            + n2 * (n2 - 1.0).powi(2) / (n2 + 1.0).powi(3) * math::ln((n - 1.0) / (n + 1.0))
            - 2.0 * n * n2 * (n2 + 2.0 * n - 1.0) / ((n2 + 1.0) * (n2 * n2 - 1.0))
            + 8.0 * n2 * n2 * (n2 * n2 + 1.0) / ((n2 + 1.0) * (n2 * n2 - 1.0).powi(2)) * math::ln(n)
    }

    #[test]
    fn smooth_means_are_walshs() {
        for n in [1.1f32, 1.3, 1.5, 2.0, 3.0] {
            let coat = Coat::new(n, rough(0.0, Distribution::Ggx));
            let outer = walsh(f64::from(n)) as f32;
            assert!((coat.mean - (1.0 - outer)).abs() < 2e-4, "{n}: {} {outer}", coat.mean);
            assert!((coat.inner - (1.0 - (1.0 - outer) / (n * n))).abs() < 2e-4);
        }
    }

    #[test]
    fn a_coat_of_index_one_is_none() {
        for n in [1.0, 0.5, f32::NAN, f32::NEG_INFINITY] {
            let coat = Coat::new(n, rough(0.3, Distribution::Ggx));
            assert!(coat.is_none() && coat.albedo(Vec3::ONE) == Vec3::ONE && coat.factor(0.1) == 1.0);
        }
        let thick = Coat::new(1e9, rough(0.3, Distribution::Ggx));
        assert!(thick.ior == 3.0 && thick.albedo(Vec3::ONE).is_finite());
    }

    /// By a grid of directions, which shares no density with [`Microfacet::albedo`].
    #[test]
    fn what_a_rough_coat_reflects() {
        for (distribution, alpha) in
            [(Distribution::Ggx, 0.1), (Distribution::Ggx, 0.4), (Distribution::Beckmann, 0.3)]
        {
            let coat = Coat::new(1.5, rough(alpha, distribution));
            let microfacet = Microfacet::of(&coat.roughness).unwrap();
            for cosine in [0.05f32, 0.1, 0.3, 0.6, 1.0] {
                let o = Vec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
                // ∫ f cos dω on a grid of directions, finest around the mirrored one.
                let (steps, mut sum) = (600, 0.0f64);
                for j in 0..steps {
                    let z = (j as f32 + 0.5) / steps as f32;
                    for k in 0..steps {
                        let phi = std::f32::consts::TAU * (k as f32 + 0.5) / steps as f32;
                        let r = (1.0 - z * z).sqrt();
                        let l = Vec3::new(r * math::cos(phi), r * math::sin(phi), z);
                        let found = microfacet.reflection(o, l);
                        sum += f64::from(found.value * fresnel::dielectric(found.oh, 1.5) * z);
                    }
                }
                let e = (sum * std::f64::consts::TAU / f64::from(steps * steps)) as f32;
                let t = coat.crosses(cosine);
                assert!((1.0 - e - t).abs() < 0.012, "{distribution:?} {alpha} {cosine}: {e} {t}");
            }
        }
    }

    #[test]
    fn a_hardly_rough_coat_is_nearly_a_smooth_one() {
        let smooth = Coat::new(1.5, rough(0.0, Distribution::Ggx));
        let nearly = Coat::new(1.5, rough(0.01, Distribution::Ggx));
        assert!((smooth.mean - nearly.mean).abs() < 0.005, "{} {}", smooth.mean, nearly.mean);
        for cosine in [0.2, 0.5, 0.9] {
            assert!((smooth.factor(cosine) - nearly.factor(cosine)).abs() < 0.01);
        }
    }
}
