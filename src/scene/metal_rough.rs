//! glTF's metal-roughness (glTF 2.0 Appendix B) as it is shown: a diffuse base under a reflecting layer, which becomes
//! the whole where the surface is metal.
//!
//! With base colour b, metalness m, roughness r (α = r²) and a dielectric's f_d the text's mix of two surfaces is one
//! lobe, since both share D and G and Schlick's Fresnel is linear:
//!
//! ```text
//! specular = D V (f₀ + (f₉₀ − f₀) (1 − ⟨v, h⟩)⁵),   f₀ = (1 − m) f_d + m b
//! diffuse  = (1 − m) b / π · (1 − E(μₒ)) (1 − E(μᵢ)) / (1 − Ē)
//! ```
//!
//! E is what the layer reflects towards a direction ([`SplitSum::layer`]), Ē its mean, so that no light is lost between
//! base and layer. The products (1 − m) b (1 − Ē) and f₀ are made for each texel when a scene is loaded: the base layer
//! shows the one by itself, a lobe needs the other with r, and neither needs a third map.

use super::{Reflectance, SplitSum};

/// Steps of r at which Ē is kept.
const STEPS: usize = 32;

/// A surface between metal and dielectric.
#[derive(Clone, Debug, PartialEq)]
pub struct MetalRough {
    /// Albedo of the view-independent part, (1 − m) b (1 − Ē); with Ē on top where it is all.
    pub diffuse: Reflectance,
    /// f₀, reflectance at normal incidence.
    pub specular: Reflectance,
    /// Whether the alpha of the map of `specular` is r; else `roughness` is.
    pub roughness_in_alpha: bool,
    /// r, or its mean where a map has it.
    pub roughness: f32,
    /// Least and greatest r of all texels.
    pub roughness_range: [f32; 2],
    /// The layer over the base.
    pub layer: Layer,
    /// Mean of f₀ over the map, luminance.
    pub specular_mean: f32,
    /// Whether it counts as diffuse: so rough, and so little metal, that its layer hardly depends on the view.
    pub is_diffuse: bool,
}

impl MetalRough {
    /// α of the roughness r. Beyond the last row of the split sum lobes hardly grow wider, but what they lose would.
    pub fn alpha(r: f32) -> f32 {
        let r = r.min(SplitSum::ROUGHEST);
        r * r
    }
}

/// The reflecting layer of a dielectric.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// Reflectance at normal incidence, the largest of the bands.
    pub f0: f32,
    /// Reflectance at grazing incidence.
    pub f90: f32,
    /// Ē at `STEPS` + 1 values of r from 0 to 1.
    means: Vec<f32>,
}

impl Layer {
    /// The layer of these reflectances.
    pub fn new(f0: f32, f90: f32) -> Self {
        let mean = |i| {
            let r = i as f32 / STEPS as f32;
            SplitSum::table().layer_mean(f0, f90, MetalRough::alpha(r)).min(0.98)
        };
        Self { f0, f90, means: (0..=STEPS).map(mean).collect() }
    }

    /// Ē of the layer at roughness `r`.
    pub fn mean(&self, r: f32) -> f32 {
        let x = r.clamp(0.0, 1.0) * STEPS as f32;
        let low = (x as usize).min(STEPS - 1);
        self.means[low] + (self.means[low + 1] - self.means[low]) * (x - low as f32)
    }

    /// (1 − E(μ)) / (1 − Ē): how much more or less of the base shows towards `cosine` than on average.
    pub fn factor(&self, cosine: f32, r: f32) -> f32 {
        let e = SplitSum::table().layer(self.f0, self.f90, cosine, MetalRough::alpha(r));
        (1.0 - e) / (1.0 - self.mean(r))
    }
}
