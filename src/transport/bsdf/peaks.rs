//! Where the view-dependent lobes point, and how much they reflect altogether: what looking a lobe up in a filtered
//! environment map needs.
//!
//! A rough lobe's weight is its directional albedo by the split sum of Karis 2013: F₀ A + B, tabulated in
//! [`SplitSum`]. Absent on purpose: anisotropy, and the change of a lobe's shape at grazing angles.

use glam::Vec3;

use super::{Bsdf, BsdfSample, Facet, Lobe, fresnel};
use crate::image::luminance;
use crate::math;
use crate::scene::Model;

/// Sides of the table.
const COSINES: usize = 24;
const ROUGHNESSES: usize = 16;

/// A and B of the split sum for GGX with height-correlated Smith shadowing, by ⟨n, v⟩ and roughness √α.
#[derive(Clone, Debug)]
pub struct SplitSum(Vec<[f32; 2]>);

impl Default for SplitSum {
    fn default() -> Self {
        let entry = |i: usize| {
            let cosine = ((i % COSINES) as f32 + 0.5) / COSINES as f32;
            let roughness = ((i / COSINES) as f32 + 0.5) / ROUGHNESSES as f32;
            integrate(cosine, roughness * roughness)
        };
        Self((0..COSINES * ROUGHNESSES).map(entry).collect())
    }
}

/// ∫ f cos dω split into the parts that F₀ scales and that it does not.
fn integrate(cosine: f32, alpha: f32) -> [f32; 2] {
    const SAMPLES: u32 = 256;
    let a2 = alpha * alpha;
    let v = Vec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
    let (mut scale, mut bias) = (0.0, 0.0);
    for i in 0..SAMPLES {
        let u = (i as f32 + 0.5) / SAMPLES as f32;
        let phi = std::f32::consts::TAU * (i.reverse_bits() as f32 / 4_294_967_296.0);
        let z = ((1.0 - u) / (1.0 + (a2 - 1.0) * u)).sqrt();
        let r = (1.0 - z * z).max(0.0).sqrt();
        let h = Vec3::new(r * math::cos(phi), r * math::sin(phi), z);
        let vh = v.dot(h).max(0.0);
        let l = h * (2.0 * v.dot(h)) - v;
        if l.z <= 0.0 || vh <= 0.0 {
            continue;
        }
        let lambda = |c: f32| (a2 + (1.0 - a2) * c * c).sqrt();
        let shadowing = 2.0 * l.z * cosine / (l.z * lambda(cosine) + cosine * lambda(l.z));
        let visible = shadowing * vh / (z * cosine);
        let fresnel = (1.0 - vh).powi(5);
        scale += (1.0 - fresnel) * visible;
        bias += fresnel * visible;
    }
    [scale / SAMPLES as f32, bias / SAMPLES as f32]
}

impl SplitSum {
    /// (A, B) at a cosine in [0, 1] and α in [0, 1].
    pub fn at(&self, cosine: f32, alpha: f32) -> [f32; 2] {
        let position = |v: f32, n: usize| {
            let p = (v.clamp(0.0, 1.0) * n as f32 - 0.5).clamp(0.0, (n - 1) as f32);
            let low = (p as usize).min(n - 2);
            (low, p - low as f32)
        };
        let (x, fx) = position(cosine, COSINES);
        let (y, fy) = position(alpha.max(0.0).sqrt(), ROUGHNESSES);
        let entry = |x: usize, y: usize| self.0[y * COSINES + x];
        std::array::from_fn(|i| {
            let row = |y: usize| entry(x, y)[i] + (entry(x + 1, y)[i] - entry(x, y)[i]) * fx;
            row(y) + (row(y + 1) - row(y)) * fy
        })
    }
}

impl Model {
    /// α of the view-dependent lobe, the larger of the two; 0 for smooth and diffuse surfaces.
    pub fn lobe_alpha(&self) -> f32 {
        match self.roughness() {
            Some(r) if !r.is_smooth() => r.alpha_x.max(r.alpha_y).clamp(0.0, 1.0),
            _ => 0.0,
        }
    }
}

impl Model {
    /// ρ_s: about what share of light the view-dependent lobes reflect or pass, seen from in front.
    pub fn lobe_albedo(&self) -> f32 {
        match self {
            Self::Lambert { .. } => 0.0,
            Self::Dielectric { .. } => 1.0,
            Self::Mirror { specular }
            | Self::Metal { specular, .. }
            | Self::CookTorrance { specular, .. }
            | Self::Ward { specular, .. } => luminance(specular.color).clamp(0.0, 1.0),
            Self::Conductor { eta, k, .. } => {
                let band = |i: usize| fresnel::conductor(1.0, eta[i], k[i]);
                luminance(Vec3::new(band(0), band(1), band(2))).clamp(0.0, 1.0)
            }
            Self::Plastic { ior, .. } => fresnel::dielectric_mean(ior.clamp(1.0, 3.0)),
        }
    }
}

impl Bsdf {
    /// The directions of the view-dependent lobes, rough ones as if they were smooth, each with what the whole lobe
    /// reflects.
    pub fn peaks(&self, wo: Vec3, split_sum: &SplitSum) -> [Option<BsdfSample>; 2] {
        let cosine = wo.dot(self.normal).max(0.0);
        let rough = |f0: Vec3, alpha: f32, most: Vec3| {
            let [a, b] = split_sum.at(cosine, alpha);
            (f0 * a + Vec3::splat(b)).min(most)
        };
        let smooth = |reflectance: Vec3| Self { lobe: Lobe::Mirror { reflectance }, ..*self }.delta_lobes(wo);
        match self.lobe {
            Lobe::Glossy { facet, microfacet } => {
                let most = match facet {
                    Facet::Schlick { most, .. } => most,
                    Facet::Conductor { .. } | Facet::Dielectric { .. } => Vec3::ONE,
                };
                smooth(rough(facet.reflectance(1.0), microfacet.ax.max(microfacet.ay), most))
            }
            Lobe::Ward { specular, .. } => smooth(specular),
            Lobe::Glass { eta, microfacet: Some(microfacet) } => {
                let alpha = microfacet.ax.max(microfacet.ay);
                let f0 = fresnel::dielectric(1.0, eta);
                let reflected = rough(Vec3::splat(f0), alpha, Vec3::ONE).x;
                let [reflection, through] =
                    Self { lobe: Lobe::Glass { eta, microfacet: None }, ..*self }.delta_lobes(wo);
                let weighted = |sample: Option<BsdfSample>, weight: f32| {
                    sample.map(|s| BsdfSample { weight: Vec3::splat(weight), ..s })
                };
                [weighted(reflection, reflected), weighted(through, 1.0 - reflected)]
            }
            Lobe::None
            | Lobe::Mirror { .. }
            | Lobe::Smooth { .. }
            | Lobe::Pane { .. }
            | Lobe::Glass { microfacet: None, .. } => self.delta_lobes(wo),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_the_reference() {
        let exact = [
            (0.1, 0.1, 0.416, 0.578),
            (0.1, 0.5, 0.968, 0.031),
            (0.5, 0.5, 0.836, 0.022),
            (0.5, 1.0, 0.916, 0.0),
            (0.9, 0.5, 0.532, 0.005),
            (0.9, 1.0, 0.420, 0.0),
        ];
        for (roughness, cosine, a, b) in exact {
            let found = integrate(cosine, roughness * roughness);
            assert!(
                (found[0] - a).abs() < 0.015 && (found[1] - b).abs() < 0.015,
                "{roughness} {cosine} {found:?}"
            );
            let tabulated = SplitSum::default().at(cosine, roughness * roughness);
            assert!((tabulated[0] - a).abs() < 0.06, "{roughness} {cosine} {tabulated:?}");
        }
    }

    #[test]
    fn any_numbers_give_some() {
        let table = SplitSum::default();
        for v in [f32::NAN, f32::INFINITY, -1.0, 0.0, 1.0, 2.0] {
            for w in [f32::NAN, f32::INFINITY, -1.0, 0.0, 1.0, 2.0] {
                let [a, b] = table.at(v, w);
                // NaN in is NaN out of a clamp; everything else is an albedo.
                assert!(v.is_nan() || w.is_nan() || ((0.0..=1.001).contains(&a) && (0.0..=1.0).contains(&b)));
            }
        }
    }
}
