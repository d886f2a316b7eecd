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
//! E is what the layer reflects towards a direction ([`LobeAlbedo::layer`]), Ē its mean, so that no light is lost between
//! base and layer. The products (1 − m) b (1 − Ē) and f₀ are made for each texel when a scene is loaded: the base layer
//! shows the one by itself, a lobe needs the other with r, and neither needs a third map.

pub use super::film::Film;
use serde::Deserialize;

use super::lobe_albedo::LobeAlbedo;
use super::recipe::Recipe;
use super::{Reflectance, Sheen};

/// Steps of r at which Ē is kept.
const STEPS: usize = 32;

/// A surface between metal and dielectric.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct MetalRough {
    /// Albedo of the view-independent part, (1 − m) b (1 − Ē); with Ē on top where it is all.
    pub diffuse: Reflectance,
    /// f₀, reflectance at normal incidence.
    pub specular: Reflectance,
    /// Whether the alpha of the map of `specular` is r; else `roughness` is.
    pub roughness_in_alpha: bool,
    /// m; `None` where it differs and no map has it.
    pub metallic: Option<f32>,
    /// Whether the alpha of the map of `diffuse` is m.
    pub metallic_in_alpha: bool,
    /// r, or its mean where a map has it.
    pub roughness: f32,
    /// Least and greatest r of all texels.
    pub roughness_range: [f32; 2],
    /// Whether the maps of `diffuse` and `specular` lie on each other and have the same size, so that one look reads both.
    pub maps_agree: bool,
    /// The layer over the base.
    pub layer: Layer,
    /// Mean of f₀ over the map, luminance.
    pub specular_mean: f32,
    /// What passes below the layer to the other side, t (1 − m) b; black for most things.
    pub through: Reflectance,
    /// Share of the surface that is there; the rest is seen through in a straight line.
    pub coverage: f32,
    /// Whether the alpha of the map of `diffuse` is a factor of `coverage`.
    pub coverage_in_alpha: bool,
    /// What lies over all of it.
    pub over: Option<Over>,
    /// Grain of the layer.
    pub grain: Option<Grain>,
    /// What is read point by point instead of all that, where maps cannot be joined.
    pub recipe: Option<Box<Recipe>>,
    /// Whether it counts as diffuse: so rough, and so little metal, that its layer hardly depends on the view.
    pub is_diffuse: bool,
}

/// A clear coat of index 1.5.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Clearcoat {
    /// How much of it is there, in [0, 1].
    pub strength: f32,
    /// r.
    pub roughness: f32,
}

impl Clearcoat {
    /// Reflectance at normal incidence.
    pub const F0: f32 = 0.04;

    /// What it reflects towards `cosine`. (The text dims what is below by the Fresnel term of the surface's normal, which is
    /// the same for a smooth coat; a rough one reflects less at grazing angles, and what it does not reflect is not lost.)
    pub fn reflectance(&self, cosine: f32) -> f32 {
        let alpha = MetalRough::alpha(self.roughness);
        self.strength * LobeAlbedo::table().layer(Self::F0, 1.0, cosine, alpha)
    }

    /// The cosine-weighted mean of [`Self::reflectance`].
    pub fn mean(&self) -> f32 {
        let alpha = MetalRough::alpha(self.roughness);
        self.strength * LobeAlbedo::table().layer_mean(Self::F0, 1.0, alpha)
    }
}

/// Grooves in one direction.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Grain {
    /// How much longer highlights are along them, in [0, 1].
    pub strength: f32,
    /// Their direction: the angle from the tangent, counter-clockwise, radians.
    pub rotation: f32,
}

impl Grain {
    /// α along and across the grooves.
    pub fn alphas(&self, r: f32) -> [f32; 2] {
        let alpha = r * r;
        [alpha + (1.0 - alpha) * self.strength * self.strength, alpha]
    }
}

/// What lies over a layer and its base, and dims both.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Over {
    /// A clear coat over everything.
    pub coat: Option<Clearcoat>,
    /// Fibres below the coat.
    pub sheen: Option<Sheen>,
    mean: f32,
}

impl Over {
    /// Clearcoat and fibres; `None` where there are neither.
    pub fn new(coat: Option<Clearcoat>, sheen: Option<Sheen>) -> Option<Self> {
        let coat = coat.filter(|c| c.strength > 0.0);
        let sheen = sheen.filter(|s| s.color.max_element() > 0.0);
        let below = sheen.map_or(1.0, |s| 1.0 - s.color.max_element() * Sheen::mean(s.alpha()));
        let mean = coat.map_or(1.0, |c| 1.0 - c.mean()) * below;
        (coat.is_some() || sheen.is_some()).then_some(Self { coat, sheen, mean })
    }

    /// [`Self::new`] with means from tables.
    pub fn quick(coat: Option<Clearcoat>, sheen: Option<Sheen>) -> Option<Self> {
        let coat = coat.filter(|c| c.strength > 0.0);
        let sheen = sheen.filter(|s| s.color.max_element() > 0.0);
        let below = sheen.map_or(1.0, |s| 1.0 - s.color.max_element() * Sheen::quick_mean(s.alpha()));
        let table = LobeAlbedo::table();
        let reflected =
            |c: Clearcoat| c.strength * table.quick_mean(Clearcoat::F0, 1.0, MetalRough::alpha(c.roughness));
        let mean = coat.map_or(1.0, |c| 1.0 - reflected(c)) * below;
        (coat.is_some() || sheen.is_some()).then_some(Self { coat, sheen, mean })
    }

    /// The share of light towards `cosine` that the coat leaves to what is below it.
    pub fn below_coat(&self, cosine: f32) -> f32 {
        self.coat.map_or(1.0, |c| 1.0 - c.reflectance(cosine))
    }

    /// The share of light that is left towards `cosine` below both.
    pub fn kept(&self, cosine: f32) -> f32 {
        let fibres =
            self.sheen.map_or(1.0, |s| 1.0 - s.color.max_element() * Sheen::albedo(cosine, s.alpha()));
        self.below_coat(cosine) * fibres
    }

    /// Its cosine-weighted mean over directions.
    pub fn kept_mean(&self) -> f32 {
        self.mean
    }
}

impl MetalRough {
    /// α of the roughness r.
    #[inline]
    pub fn alpha(r: f32) -> f32 {
        r * r
    }

    /// Whether light passes it, straight or blurred.
    #[inline]
    pub fn is_seen_through(&self) -> bool {
        let by_recipe = self.recipe.as_ref().is_some_and(|r| r.through.factor > 0.0);
        self.coverage < 1.0 || self.coverage_in_alpha || self.through.color.max_element() > 0.0 || by_recipe
    }

    /// Whether the alpha of the map of `diffuse` says anything.
    #[inline]
    pub fn has_alpha(&self) -> bool {
        (self.metallic_in_alpha || self.coverage_in_alpha) && self.recipe.is_none() && !self.is_diffuse
    }

    /// Whether it has grooves, or a coat with normals of its own.
    pub fn has_direction(&self) -> bool {
        let by_recipe = |r: &Recipe| r.grain.is_some() || r.coat_normal.is_some();
        self.grain.is_some() || self.recipe.as_deref().is_some_and(by_recipe)
    }

    /// Whether the lobes of the layer are all there are.
    #[inline]
    pub fn is_plain(&self) -> bool {
        !self.is_seen_through() && self.over.is_none() && self.grain.is_none() && self.recipe.is_none()
    }
}

/// The reflecting layer of a dielectric.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Layer {
    /// Reflectance at normal incidence, the largest of the bands.
    pub f0: f32,
    /// Reflectance at grazing incidence.
    pub f90: f32,
    /// Ē at `STEPS` + 1 values of r from 0 to 1.
    #[serde(deserialize_with = "all_means")]
    means: Vec<f32>,
}

/// As many means as there are to be.
fn all_means<'de, D: serde::Deserializer<'de>>(from: D) -> Result<Vec<f32>, D::Error> {
    let means = Vec::<f32>::deserialize(from)?;
    if means.len() == STEPS + 1 { Ok(means) } else { Err(serde::de::Error::custom("means of a layer")) }
}

impl Layer {
    /// The layer of these reflectances.
    pub fn new(f0: f32, f90: f32) -> Self {
        let mean = |i| {
            let r = i as f32 / STEPS as f32;
            LobeAlbedo::table().layer_mean(f0, f90, MetalRough::alpha(r)).min(0.98)
        };
        Self { f0, f90, means: (0..=STEPS).map(mean).collect() }
    }

    /// Ē of the layer at roughness `r`.
    #[inline]
    pub fn mean(&self, r: f32) -> f32 {
        let x = r.clamp(0.0, 1.0) * STEPS as f32;
        let low = (x as i32 as usize).min(STEPS - 1);
        self.means[low] + (self.means[low + 1] - self.means[low]) * (x - low as f32)
    }

    /// (1 − E(μ)) / (1 − Ē): how much more or less of the base shows towards `cosine` than on average.
    pub fn factor(&self, cosine: f32, r: f32) -> f32 {
        let e = LobeAlbedo::table().layer(self.f0, self.f90, cosine, MetalRough::alpha(r));
        (1.0 - e) / (1.0 - self.mean(r))
    }
}
