//! Where the view-dependent lobes point, and how much they reflect altogether: what looking a lobe up in a filtered
//! environment map needs.
//!
//! A rough lobe's weight is its directional albedo by the split sum of Karis 2013: F₀ A + B, tabulated in
//! [`SplitSum`]. Absent on purpose: anisotropy, and the change of a lobe's shape at grazing angles.

use glam::Vec3;

use super::{Bsdf, BsdfSample, Facet, Lobe, fresnel};
use crate::image::luminance;
use crate::scene::Model;
pub use crate::scene::split_sum::SplitSum;

/// Directions that a surface may have: of each of its lobes one, and two of glass.
pub const PEAKS: usize = 4;

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
            Self::MetalRough(m) => m.specular_mean.clamp(0.0, 1.0),
            Self::Plastic { coat, .. } => coat.reflects(),
        }
    }
}

impl Bsdf {
    /// The directions of the view-dependent lobes, rough ones as if they were smooth, each with what the whole lobe
    /// reflects.
    pub fn peaks(&self, wo: Vec3, split_sum: &SplitSum) -> [Option<BsdfSample>; PEAKS] {
        let mut peaks = [None; PEAKS];
        let parts = self.parts().flat_map(|part| part.own_peaks(wo, split_sum));
        if self.is_layered() {
            // Of each lobe there is one.
            parts.flatten().zip(&mut peaks).for_each(|(peak, place)| *place = Some(peak));
        } else {
            parts.zip(&mut peaks).for_each(|(peak, place)| *place = peak);
        }
        peaks
    }

    fn own_peaks(&self, wo: Vec3, split_sum: &SplitSum) -> [Option<BsdfSample>; 2] {
        let cosine = wo.dot(self.normal).max(0.0);
        let rough = |f0: Vec3, alpha: f32, most: Vec3| {
            let [a, b] = split_sum.at(cosine, alpha);
            (f0 * a + Vec3::splat(b)).min(most)
        };
        let smooth = |reflectance: Vec3| Self { lobe: Lobe::Mirror { reflectance }, ..*self }.delta_lobes(wo);
        match self.lobe {
            Lobe::Glossy { facet, microfacet } => {
                let alpha = microfacet.ax.max(microfacet.ay);
                if let Facet::Between { f0, f90 } = facet {
                    let [a, b] = split_sum.at(cosine, alpha);
                    return smooth((f0 * a + f90 * b).min(Vec3::ONE));
                }
                let most = match facet {
                    Facet::Schlick { most, .. } => most,
                    _ => Vec3::ONE,
                };
                smooth(rough(facet.reflectance(1.0), alpha, most))
            }
            Lobe::Ward { specular, .. } => smooth(specular),
            Lobe::Blurred { weight, .. } => Self { lobe: Lobe::Straight { weight }, ..*self }.delta_lobes(wo),
            // Too wide to have one.
            Lobe::Fibres { .. } => [None, None],
            Lobe::Glass { eta, microfacet: Some(microfacet), tint, spread } => {
                let alpha = microfacet.ax.max(microfacet.ay);
                let reflected = rough(self.glass_reflectance(1.0, eta), alpha, Vec3::ONE);
                let [reflection, through] =
                    Self { lobe: Lobe::Glass { eta, microfacet: None, tint, spread }, ..*self }
                        .delta_lobes(wo);
                let weighted =
                    |sample: Option<BsdfSample>, weight| sample.map(|s| BsdfSample { weight, ..s });
                let passed = tint * (Vec3::ONE - reflected);
                [weighted(reflection, reflected), weighted(through, passed)]
            }
            Lobe::None
            | Lobe::Mirror { .. }
            | Lobe::Smooth { .. }
            | Lobe::Pane { .. }
            | Lobe::Straight { .. }
            | Lobe::Glass { microfacet: None, .. } => self.delta_lobes(wo),
        }
    }
}
