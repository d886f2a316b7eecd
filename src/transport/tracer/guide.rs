//! Guides: what glass shows along the one way that most light takes.
//!
//! A sample of glass follows all ways of the light, tens of rays; a guide follows one, a few rays: at each surface the
//! lobe with the greater weight, until something diffuse, which ends it with what the display shows of it. Most of what
//! changes fast across a pane or a ball is in there, refracted as it must be, and what a sample knows beyond it changes
//! slowly: so samples are carried to other pixels as their difference from their guides.
//!
//! A refined picture's filter leaves out what guides show, of mirrors and smooth coats as well ([`is_sharp`]).
//!
//! Source: `two-level` estimates with a control variate, here across the pixels instead of across the samples.

use glam::Vec3;

use super::{Branch, Tracer};
use crate::image::luminance;
use crate::scene::{MaterialId, Model, Scene};
use crate::transport::bsdf::Bsdf;
use crate::transport::interaction::Interaction;

/// Surfaces that a guide may meet in a row.
const GUIDE_DEPTH: u32 = 16;

/// Whether objects of a material are looked at through guides: smooth glass, whose samples branch. Of a mirror the guide
/// would be the sample.
pub fn is_guided(scene: &Scene, material: MaterialId) -> bool {
    match &scene.materials[material.0 as usize].model {
        Model::Dielectric { roughness, .. } => roughness.is_smooth(),
        _ => false,
    }
}

/// Whether all that a material shows beside its diffuse part comes from single directions, so that guides know what most of
/// it is: mirrors, glass, and coats that are smooth everywhere.
pub fn is_sharp(scene: &Scene, material: MaterialId) -> bool {
    let model = &scene.materials[material.0 as usize].model;
    match model.roughness_range() {
        Some([.., most]) => most.is_smooth(),
        None => !matches!(model, Model::Lambert { .. }),
    }
}

impl Tracer<'_> {
    /// Radiance towards `at.wo` along the guide of a point of a surface without rough lobes, by no chance. Finite, not negative.
    pub fn guide(&self, at: &Interaction) -> Vec3 {
        let mut branch = Branch {
            width: at.footprint,
            spread: at.footprint / at.t.max(f32::MIN_POSITIVE),
            ..Branch::START
        };
        let (mut at, mut weight) = (*at, Vec3::ONE);
        let mut bsdf = Bsdf::at(self.scene, &at);
        for _ in 0..GUIDE_DEPTH {
            let [a, b] = bsdf.delta_lobes(at.wo);
            let share =
                |lobe: &Option<_>| lobe.as_ref().map_or(-1.0, |l: &super::BsdfSample| luminance(l.weight));
            let Some(lobe) = (if share(&b) > share(&a) { b } else { a }) else { return Vec3::ZERO };
            if lobe.transmitted {
                branch.media = branch.media.crossed(self.scene, &at);
            }
            weight *= lobe.weight * lobe.radiance_scale;
            let ray = at.spawn(lobe.wi);
            let Some(hit) = self.accel.intersect(self.scene, &ray) else {
                return self.finite(weight * self.lights.escaped(self.scene, ray.direction));
            };
            branch.width += branch.spread * hit.t;
            at = Interaction::at(self.scene, &ray, &hit).with_footprint(branch.width);
            bsdf = Bsdf::at(self.scene, &at);
            weight *= branch.media.transmittance_to(self.scene, &at, hit.t);
            let ends =
                bsdf.diffuse_albedo() != Vec3::ZERO || bsdf.delta_lobes(at.wo).iter().all(Option::is_none);
            if ends {
                let diffuse = bsdf.diffuse_albedo() * self.diffuse_light(&at, &bsdf, branch.media, None);
                let radiance = at.point().emission(self.scene) + diffuse * bsdf.coat_factor(at.wo);
                return self.finite(weight * radiance);
            }
        }
        Vec3::ZERO
    }
}
