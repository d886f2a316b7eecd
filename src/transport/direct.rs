//! Light that reaches a point straight from the lights, and how two ways to find it share the work.

use glam::Vec3;

use super::bsdf::{Bsdf, BsdfSample, fresnel};
use super::interaction::Interaction;
use super::light::{LightSample, Lights, Receiver};
use super::medium::Media;
use crate::geometry::packet::LANES;
use crate::geometry::shadow::{LastShadow, Shadows};
use crate::geometry::{Accel, Hit, Ray};
use crate::scene::{Model, Scene};

/// Power heuristic with β = 2 for `n` samples of density `p` beside `m` of density `q` (Veach 1997).
#[inline]
pub(super) fn mis_weight(n: u32, p: f32, m: u32, q: f32) -> f32 {
    let (a, b) = (f64::from(n) * f64::from(p), f64::from(m) * f64::from(q));
    if a <= 0.0 {
        return 0.0;
    }
    // The quotient first: squares overflow.
    let r = b / a;
    (1.0 / (1.0 + r * r)) as f32
}

/// Relative difference of distances that are one: a few roundings.
const SAME: f32 = 2e-6;

/// Whether light may pass straight on through a triangle.
#[inline]
fn may_pass(scene: &Scene, triangle: u32) -> bool {
    match &scene.material_of(triangle).model {
        Model::Dielectric { thin, .. } => *thin,
        Model::MetalRough(m) => m.is_seen_through(),
        _ => false,
    }
}

/// The share of light that passes along those of sixteen rays that `lanes` has a bit for, to the bit as [`visibility`] finds
/// it of each; from neighbouring points to one light they go together. `last`: see [`Accel::shadows`].
pub(super) fn visibilities(
    scene: &Scene,
    accel: &Accel,
    rays: &[Ray; LANES],
    lanes: u32,
    last: &mut LastShadow,
) -> [Vec3; LANES] {
    let Shadows { blocked, unclear } =
        accel.shadows(scene, rays, lanes, last, |hit| !may_pass(scene, hit.triangle));
    std::array::from_fn(|l| {
        if blocked >> l & 1 != 0 {
            Vec3::ZERO
        } else if unclear >> l & 1 != 0 {
            visibility(scene, accel, &rays[l])
        } else {
            Vec3::ONE
        }
    })
}

/// The share of light that passes along `ray`: thin panes and veils let it through attenuated, in a straight line; all
/// else blocks it, refracting glass too, whose light arrives by other ways.
pub(crate) fn visibility(scene: &Scene, accel: &Accel, ray: &Ray) -> Vec3 {
    let mut passed = Vec3::ONE;
    // A ray through the common edge of two triangles meets both, but one pane.
    let mut crossed = [(f32::NAN, false); 8];
    let mut count = 0;
    let blocked = accel.any_hit(scene, ray, |hit: Hit| {
        let material = &scene.materials[scene.mesh.materials[hit.triangle as usize].0 as usize];
        let pane = match &material.model {
            Model::Dielectric { ior, transmittance, thin: true, .. } => {
                Some((ior.clamp(1.0, 10.0), *transmittance))
            }
            Model::MetalRough(m) if m.is_seen_through() => None,
            _ => return true,
        };
        let at = Interaction::at(scene, ray, &hit);
        if at.back && !material.two_sided {
            return true;
        }
        if crossed.iter().any(|&(t, back)| back == at.back && (t - hit.t).abs() <= SAME * t) {
            return false;
        }
        crossed[count % crossed.len()] = (hit.t, at.back);
        count += 1;
        let cosine = at.wo.dot(at.facing_shading()).abs();
        passed *= match pane {
            Some((ior, transmittance)) => fresnel::pane(cosine, ior, transmittance).1,
            None => Bsdf::at(scene, &at).straight(),
        };
        passed.max_element() <= 0.0
    });
    if blocked { Vec3::ZERO } else { passed }
}

/// The shadow ray of a light sample.
#[inline]
pub(super) fn towards(at: &Interaction, sample: &LightSample) -> Ray {
    if sample.distance.is_finite() {
        at.spawn_to(at.position + sample.wi * sample.distance)
    } else {
        at.spawn(sample.wi)
    }
}

/// A light sample for `at`, which lies inside of `media`, with the share of it that arrives; `None` where that is
/// nothing.
#[inline]
pub(super) fn arriving(
    scene: &Scene,
    accel: &Accel,
    at: &Interaction,
    media: &Media,
    sample: &LightSample,
) -> Option<Vec3> {
    let mut passed = visibility(scene, accel, &towards(at, sample));
    if sample.distance.is_finite() && !media.is_empty() {
        passed *= media.transmittance(scene, sample.distance);
    }
    (passed.max_element() > 0.0).then(|| sample.radiance * passed)
}

/// How a ray was found whose end may be a light: by sampling a BSDF at `from` with density `pdf`, `n` such samples
/// standing beside `m` light samples.
#[derive(Clone, Copy, Debug)]
pub(super) struct Found {
    pub from: Receiver,
    pub pdf: f32,
    pub n: u32,
    pub m: u32,
}

impl Found {
    /// Weight of the light seen along unit `wi`, at `hit` or in the environment, beside light samples, none of which goes
    /// behind the surface.
    pub fn weight(&self, scene: &Scene, lights: &Lights, (wi, hit): (Vec3, Option<&Hit>)) -> f32 {
        if self.m == 0 || self.from.normal.dot(wi) <= 0.0 {
            return 1.0;
        }
        mis_weight(self.n, self.pdf, self.m, lights.pdf_towards(scene, &self.from, (wi, hit), None))
    }
}

/// Whether a sample passes a surface as if it were not there, unbent, so that light sampling sees through it.
#[inline]
pub(super) fn goes_straight(scene: &Scene, at: &Interaction, sample: &BsdfSample) -> bool {
    sample.transmitted
        && match &at.material(scene).model {
            Model::Dielectric { thin, .. } => *thin,
            _ => sample.wi == -at.wo,
        }
}
