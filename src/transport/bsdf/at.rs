//! The reflectance where a surface is met: each map is read once, and two that lie on each other in one look.

use glam::Vec3;

use super::layers::{self, Read};
use super::{Bsdf, Coat, CoatAt, Facet, Lobe};
use crate::scene::microfacet::Microfacet;
use crate::scene::recipe::Made;
#[cfg(doc)]
use crate::scene::recipe::Recipe;
use crate::scene::{Distribution, Material, MetalRough, Model, Reflectance, Roughness, Scene};
use crate::transport::interaction::Interaction;
#[cfg(doc)]
use crate::transport::surface::SurfacePoint;

impl Bsdf {
    /// The reflectance at an interaction, seen from its `wo`.
    pub fn at(scene: &Scene, at: &Interaction) -> Self {
        let material = at.material(scene);
        if is_black(material, at) {
            return Self::bare(at, Vec3::ZERO);
        }
        let Model::MetalRough(m) = &material.model else {
            return Self::of_others(scene, material, at, at.point().diffuse_albedo(scene));
        };
        if let Some(recipe) = &m.recipe {
            let made = at.point().made(scene, recipe);
            return Self::of_recipe(scene, m, at, made.diffuse, &made);
        }
        let read = Read::of(m, scene, &at.point(), true, !m.is_diffuse);
        let color = read
            .diffuse
            .map_or(m.diffuse.color, |[red, green, blue, _]| m.diffuse.color * Vec3::new(red, green, blue));
        Self::of_metal_rough(scene, m, at, color.clamp(Vec3::ZERO, Vec3::ONE), &read)
    }

    /// The same where the [diffuse albedo](SurfacePoint::diffuse_albedo) of the point is known, so that its textures are
    /// not read again.
    pub fn over(scene: &Scene, at: &Interaction, diffuse: Vec3) -> Self {
        let material = at.material(scene);
        if is_black(material, at) {
            return Self::bare(at, diffuse);
        }
        match &material.model {
            Model::MetalRough(m) => match &m.recipe {
                Some(recipe) => Self::of_recipe(scene, m, at, diffuse, &at.point().made(scene, recipe)),
                None => {
                    let read = Read::of(m, scene, &at.point(), m.has_alpha(), !m.is_diffuse);
                    Self::of_metal_rough(scene, m, at, diffuse, &read)
                }
            },
            _ => Self::of_others(scene, material, at, diffuse),
        }
    }

    /// What lies over a diffuse part of known albedo, as in [`Self::over`]; `None` where [`Self::coat_factor`] is 1 on all
    /// surfaces of the material.
    #[inline]
    pub fn coat_over(scene: &Scene, at: &Interaction, diffuse: Vec3) -> Option<CoatAt> {
        Self::may_have_coat(at.material(scene)).then(|| {
            let Self { normal, coat, .. } = Self::over(scene, at, diffuse);
            CoatAt { normal, coat }
        })
    }

    /// A diffuse part and nothing else.
    #[inline]
    fn bare(at: &Interaction, diffuse: Vec3) -> Self {
        Self::with_one(at, diffuse, Lobe::None, Coat::None)
    }

    #[inline]
    fn with_one(at: &Interaction, diffuse: Vec3, lobe: Lobe, coat: Coat) -> Self {
        let side = if at.back { -1.0 } else { 1.0 };
        Self {
            normal: at.facing_shading(),
            tangent: at.tangent,
            bitangent: at.bitangent * side,
            geometric: at.facing_geometric(),
            diffuse,
            passed: Vec3::ZERO,
            coat,
            lobe,
            apart: Vec3::ZERO,
            is_apart: false,
            more: [Lobe::None; layers::MORE],
            layers: 0,
        }
    }

    /// Of what lies between metal and dielectric without a [`Recipe`].
    #[inline]
    fn of_metal_rough(scene: &Scene, m: &MetalRough, at: &Interaction, diffuse: Vec3, read: &Read) -> Self {
        if m.is_diffuse {
            return Self::bare(at, diffuse);
        }
        if m.is_plain() {
            let cosine = at.wo.dot(at.facing_shading()).max(0.0);
            let (lobe, coat) = layers::only_layer(m, read, cosine, diffuse != Vec3::ZERO);
            return Self::with_one(at, diffuse, lobe, coat);
        }
        let mut bsdf = Self::bare(at, diffuse);
        bsdf.set_metal_rough(scene, m, at, read);
        bsdf
    }

    /// Of what a recipe made.
    #[inline]
    fn of_recipe(scene: &Scene, m: &MetalRough, at: &Interaction, diffuse: Vec3, made: &Made) -> Self {
        let mut bsdf = Self::bare(at, diffuse);
        match &m.recipe {
            Some(recipe) if !m.is_diffuse => bsdf.set_made(scene, recipe, made, at),
            _ => bsdf.passed = made.passed,
        }
        bsdf
    }

    /// Of all other models.
    fn of_others(scene: &Scene, m: &Material, at: &Interaction, diffuse: Vec3) -> Self {
        let point = at.point();
        let lookup = |r: &Reflectance| point.reflectance(scene, r);
        let facet_lobe = |facet: Facet, r: &Roughness, v_groove: bool| match Microfacet::of(r) {
            None => Lobe::Smooth { facet },
            Some(microfacet) => Lobe::Glossy { facet, microfacet: Microfacet { v_groove, ..microfacet } },
        };
        let mut coat_over = Coat::None;
        let lobe = match &m.model {
            Model::Lambert { .. } | Model::MetalRough(_) => Lobe::None,
            Model::Mirror { specular } => Lobe::Mirror { reflectance: lookup(specular) },
            Model::Conductor { eta, k, roughness } => {
                facet_lobe(Facet::Conductor { eta: *eta, k: *k }, roughness, false)
            }
            Model::Metal { specular, roughness } => {
                facet_lobe(Facet::Schlick { f0: lookup(specular), most: Vec3::ONE }, roughness, false)
            }
            Model::Dielectric { ior, transmittance, thin, roughness } => {
                let ior = ior.clamp(1.0, 10.0);
                if *thin {
                    Lobe::Pane { eta: ior, transmittance: *transmittance }
                } else {
                    let eta = if at.back { 1.0 / ior } else { ior };
                    let spread = (ior - 1.0) * 0.025 * m.dispersion;
                    let coated = m.coating.and_then(|c| c.at(|map| point.texel(scene, map)));
                    coat_over = coated.map_or(Coat::None, Coat::OnGlass);
                    Lobe::Glass { eta, microfacet: Microfacet::of(roughness), tint: lookup(&m.tint), spread }
                }
            }
            Model::Plastic { coat, .. } if coat.is_none() => Lobe::None,
            Model::Plastic { coat, .. } => {
                coat_over = Coat::Dielectric(*coat);
                facet_lobe(Facet::Dielectric { eta: coat.ior }, &coat.roughness, false)
            }
            Model::CookTorrance { specular, roughness, .. } => {
                let f0 = lookup(specular);
                let v_groove = roughness.distribution == Distribution::Beckmann;
                match f0.max_element() > 0.0 {
                    true => facet_lobe(Facet::Schlick { f0, most: Vec3::ONE - diffuse }, roughness, v_groove),
                    false => Lobe::None,
                }
            }
            Model::Ward { specular, roughness, .. } => {
                // Textures can ask for more than all of the light.
                let specular = lookup(specular).min(Vec3::ONE - diffuse);
                let beckmann = Roughness { distribution: Distribution::Beckmann, ..*roughness };
                match Microfacet::of(&beckmann) {
                    _ if !(specular.max_element() > 0.0) => Lobe::None,
                    None => Lobe::Mirror { reflectance: specular },
                    Some(microfacet) => Lobe::Ward { specular, microfacet },
                }
            }
        };
        Self::with_one(at, diffuse, lobe, coat_over)
    }
}

/// The back of a one-sided surface is black.
#[inline]
fn is_black(material: &Material, at: &Interaction) -> bool {
    at.back && !material.two_sided
}
