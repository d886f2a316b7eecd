//! Vertices of subpaths, and how light is scattered there between two directions.
//!
//! What is scattered is defined as paths from the eye see it: a shading normal may be tilted towards who looks
//! ([`Interaction::seen_from`]), so f is that of the view from the eye's side, whoever asks. Densities are those of the
//! subpath that would sample the direction, each with its own view.

use glam::Vec3;

use crate::scene::Scene;
use crate::transport::bsdf::Bsdf;
use crate::transport::interaction::Interaction;
use crate::transport::light::Receiver;
use crate::transport::medium::Media;

use super::odds::Odds;

/// Which end a subpath began at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    Eye,
    Light,
}

/// A vertex of a subpath that scatters in many directions.
#[derive(Clone, Copy, Debug)]
pub struct Vertex {
    /// Seen from where the subpath came.
    pub at: Interaction,
    pub bsdf: Bsdf,
    /// From the eye: the share of the radiance there that the pixel shows. From the light: flux.
    pub throughput: Vec3,
    /// Where both the subpath and what is connected to it run.
    pub media: Media,
    pub odds: Odds,
}

/// Scattering between two directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scattering {
    /// From the eye: f times the cosine of the light at the shading normal. From the light the same over the cosine at
    /// the geometric normal, by which flux counts (Veach 1997, eq 5.19).
    pub f: Vec3,
    /// Density per solid angle of the direction to the light, sampled from the eye.
    pub to_light: f32,
    /// Density per solid angle of the direction to the eye, sampled from the light.
    pub to_eye: f32,
}

/// The cosine between a direction and the geometric normal.
#[inline]
pub fn geometric_cosine(at: &Interaction, direction: Vec3) -> f32 {
    at.geometric_normal.dot(direction).abs()
}

/// What lights are chosen for. By the geometric normal, since that is the same whoever looks.
pub fn receiver(at: &Interaction) -> Receiver {
    Receiver { point: at.position, normal: at.facing_geometric() }
}

/// Scattering at a point between where its subpath came from and the direction `other`; `None` where there is none.
pub fn scattering(scene: &Scene, at: &Interaction, bsdf: &Bsdf, end: End, other: Vec3) -> Option<Scattering> {
    if !(other.dot(at.facing_geometric()) > 0.0) {
        return None;
    }
    let seen = at.seen_from(scene, other).map(|at| (at, Bsdf::at(scene, &at)));
    let there = seen.as_ref().map_or((at, bsdf), |(at, bsdf)| (at, bsdf));
    let ((eye_at, eye), light, (to_eye, to_light)) = match end {
        End::Eye => ((at, bsdf), there.1, (at.wo, other)),
        End::Light => (there, bsdf, (other, at.wo)),
    };
    let mut f = eye.evaluate_all(to_eye, to_light) * to_light.dot(eye_at.facing_shading()).max(0.0);
    if end == End::Light {
        f /= geometric_cosine(at, to_light);
    }
    (f.is_finite() && f.max_element() > 0.0).then(|| Scattering {
        f,
        to_light: eye.pdf_all(to_eye, to_light),
        to_eye: light.pdf_all(to_light, to_eye),
    })
}

impl Vertex {
    /// [`scattering`] here.
    pub fn towards(&self, scene: &Scene, end: End, other: Vec3) -> Option<Scattering> {
        scattering(scene, &self.at, &self.bsdf, end, other)
    }
}
