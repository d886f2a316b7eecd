//! Subpaths: from the eye through a pixel, and from a light.
//!
//! A pane that is passed straight on is no vertex: it attenuates, and connections see through it too.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use crate::geometry::Ray;
use crate::rng::Stream;
use crate::scene::Light;
use crate::transport::bsdf::Bsdf;
use crate::transport::direct::goes_straight;
use crate::transport::interaction::Interaction;
use crate::transport::light::{Emitter, Receiver};
use crate::transport::medium::Media;

use super::Bidirectional;
use super::odds::{Odds, squared};
use super::photons::Photons;
use super::vertex::{End, Vertex, geometric_cosine, receiver, scattering};

/// Surfaces that every subpath meets before roulette begins.
const CERTAIN: u32 = 4;
/// No subpath is longer; roulette ends nearly all long before.
const BOUNCES_MAX: u32 = 1000;

/// A subpath on its way.
struct Walk {
    ray: Ray,
    throughput: Vec3,
    /// Squared refractive indices crossed, kept apart so that roulette does not end paths inside of glass.
    scale: f32,
    media: Media,
    odds: Odds,
    /// Since the last vertex, over panes.
    distance: f32,
    stream: Stream,
}

impl Walk {
    fn new(ray: Ray, throughput: Vec3, media: Media, odds: Odds, stream: Stream) -> Self {
        Self { ray, throughput, scale: 1.0, media, odds, distance: 0.0, stream }
    }

    /// Goes on from a surface, or through a pane.
    fn leave(&mut self, at: &Interaction, direction: Vec3, weight: Vec3) {
        self.throughput *= weight;
        self.ray = at.spawn(direction);
    }

    /// Roulette at vertex `n`; `relative` is what is left of the throughput. Also ends what is black or not a number.
    fn survives(&mut self, n: u32, relative: f32) -> bool {
        if n < CERTAIN {
            return relative > 0.0;
        }
        let survival = relative.min(0.95);
        if survival.is_nan() || self.stream.next_f32() >= survival {
            return false;
        }
        self.throughput /= survival;
        true
    }
}

/// What a subpath from the eye finds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Seen {
    /// Radiance by all ways that connect.
    pub connected: Vec3,
    /// Radiance by merged photons, within the radius and within 1/√2 of it.
    pub merged: [Vec3; 2],
}

impl Bidirectional<'_> {
    fn hit(&self, walk: &mut Walk) -> Option<(crate::geometry::Hit, Interaction, Bsdf)> {
        let hit = self.accel.intersect(self.scene, &walk.ray)?;
        let at = Interaction::at(self.scene, &walk.ray, &hit);
        walk.distance += hit.t;
        walk.throughput *= walk.media.transmittance_to(self.scene, &at, hit.t);
        Some((hit, at, Bsdf::at(self.scene, &at)))
    }

    /// Follows a subpath from the eye along a unit direction; `light` is the one from a light that it is connected with,
    /// photons are merged within `radius` times the distance.
    pub(super) fn eye_path(
        &self,
        direction: Vec3,
        stream: Stream,
        light: &[Vertex],
        photons: Option<(&Photons, f32)>,
    ) -> Seen {
        let mut seen = Seen::default();
        let odds =
            Odds { vcm: squared(self.light_paths() / f64::from(self.frame.density(direction))), vc: 0.0 };
        let ray = Ray::new(self.frame.eye, direction);
        let mut walk = Walk::new(ray, Vec3::ONE, self.around_eye, odds, stream);
        // The last vertex, as far as lights were sampled there.
        let mut from: Option<Receiver> = None;
        let (mut vertices, mut dirac, mut length) = (0, true, 0.0);
        for _ in 0..BOUNCES_MAX {
            let Some((hit, at, bsdf)) = self.hit(&mut walk) else {
                let light = self.lights.escaped(self.scene, walk.ray.direction);
                if light != Vec3::ZERO {
                    let weight = self.weight_of_found(vertices, &walk.odds, from, walk.ray.direction, None);
                    seen.connected += walk.throughput * light * (walk.scale * weight);
                }
                break;
            };
            let arrived = walk.odds.arrived(walk.distance, geometric_cosine(&at, at.wo));
            let emitted = at.point().emission(self.scene);
            if emitted != Vec3::ZERO {
                let found = Some((&hit, walk.distance));
                let weight = self.weight_of_found(vertices, &arrived, from, -at.wo, found);
                seen.connected += walk.throughput * emitted * (walk.scale * weight);
            }
            let (u, u_lobe) = (walk.stream.next_2d(), walk.stream.next_f32());
            let sample = bsdf.sample_all(at.wo, u, u_lobe);
            if let Some(through) = sample.filter(|s| goes_straight(self.scene, &at, s)) {
                walk.leave(&at, through.wi, through.weight);
                continue;
            }
            length += walk.distance;
            (walk.odds, walk.distance) = (arrived, 0.0);
            let throughput = walk.throughput * walk.scale;
            let vertex = Vertex { at, bsdf, throughput, media: walk.media, odds: walk.odds };
            if bsdf.is_connectible() {
                let (choice, u) = (walk.stream.next_f64(), walk.stream.next_2d());
                seen.connected += self.sampled(&vertex, choice, u);
                for y in light {
                    seen.connected += self.connected(&vertex, y);
                }
                if let Some((photons, radius)) = photons.filter(|_| dirac && vertices > 0) {
                    let found = photons.around(&vertex, radius * length);
                    for (sum, found) in seen.merged.iter_mut().zip(found) {
                        *sum += found / self.light_paths() as f32;
                    }
                }
                from = Some(receiver(&at));
            }
            let Some(sample) = sample else { break };
            let cosine = geometric_cosine(&at, sample.wi);
            walk.odds = if sample.delta {
                from = None;
                walk.odds.mirrored(cosine, at.is_reversible(&bsdf, &sample))
            } else {
                let Some(s) = scattering(self.scene, &at, &bsdf, End::Eye, sample.wi) else { break };
                walk.odds.scattered(cosine, sample.pdf, s.to_eye)
            };
            if sample.transmitted {
                walk.scale *= sample.radiance_scale;
                walk.media = walk.media.crossed(self.scene, &at);
            }
            walk.leave(&at, sample.wi, sample.weight);
            if !walk.survives(vertices, walk.throughput.max_element()) {
                break;
            }
            (vertices, dirac) = (vertices + 1, dirac && sample.delta);
        }
        seen
    }

    /// Follows a subpath from a light and hands on its vertices that scatter in many directions, each with whether
    /// nothing before it could have been connected: from a light without area, and no two such vertices in a row. With
    /// `alone` it ends once that can no longer be.
    pub(super) fn light_path(&self, mut stream: Stream, alone: bool, mut visit: impl FnMut(&Vertex, bool)) {
        let Some((emitter, ray, flux)) = self.lights.begin(self.scene, &mut stream) else { return };
        let around = if self.absorbs && !self.lights.is_distant(emitter) {
            Media::around(self.scene, self.accel, &ray)
        } else {
            Media::EMPTY
        };
        let mut walk = Walk::new(ray, flux, around, Odds::default(), stream);
        let (only_alone, mut alone) = (alone, self.lights.is_dirac(emitter));
        let (mut vertices, mut beside) = (0, true);
        let lamp = self.lights.ending_lamp(walk.ray.origin);
        for _ in 0..BOUNCES_MAX {
            let Some((_, at, bsdf)) = self.hit(&mut walk) else { return };
            let sample = bsdf.sample_all(at.wo, walk.stream.next_2d(), walk.stream.next_f32());
            if let Some(through) = sample.filter(|s| goes_straight(self.scene, &at, s)) {
                walk.leave(&at, through.wi, through.weight);
                continue;
            }
            if let Some((position, range)) = lamp.filter(|_| vertices == 0) {
                walk.throughput *= Light::window(range, position.distance(at.position));
                if walk.throughput.max_element() <= 0.0 {
                    return;
                }
            }
            let cosine = geometric_cosine(&at, at.wo);
            walk.odds = if vertices == 0 {
                self.odds_of_first(emitter, &at, walk.distance)
            } else {
                walk.odds.arrived(walk.distance, cosine)
            };
            walk.distance = 0.0;
            if bsdf.is_connectible() {
                let vertex =
                    Vertex { at, bsdf, throughput: walk.throughput, media: walk.media, odds: walk.odds };
                visit(&vertex, alone && !beside);
            }
            let Some(sample) = sample else { return };
            let out = geometric_cosine(&at, sample.wi);
            if sample.delta {
                if !at.is_reversible(&bsdf, &sample) {
                    return;
                }
                // Particles see shading normals from the other end than paths (Veach 1997, eq 5.19).
                let shading = |w: Vec3| at.shading_normal.dot(w).abs();
                let weight = sample.weight * (shading(at.wo) / cosine * out / shading(sample.wi));
                walk.odds = walk.odds.mirrored(out, true);
                if sample.transmitted {
                    walk.media = walk.media.crossed(self.scene, &at);
                }
                walk.leave(&at, sample.wi, weight);
            } else {
                let Some(s) = scattering(self.scene, &at, &bsdf, End::Light, sample.wi) else { return };
                walk.odds = walk.odds.scattered(out, sample.pdf, s.to_light);
                walk.leave(&at, sample.wi, s.f * (out / sample.pdf));
                alone &= !beside;
            }
            beside = !sample.delta;
            if only_alone && !alone
                || !walk.throughput.is_finite()
                || !walk.survives(vertices, (walk.throughput / flux.max_element()).max_element())
            {
                return;
            }
            vertices += 1;
        }
    }

    /// Odds where a subpath from a light meets its first surface: light samples depend on who asks for them.
    fn odds_of_first(&self, emitter: Emitter, at: &Interaction, distance: f32) -> Odds {
        let leaving = self.lights.leaving(self.scene, emitter, -at.wo);
        let asked =
            self.lights.density_towards(self.scene, &receiver(at), emitter, (at.wo, distance), self.sky);
        let found = leaving.density * f64::from(geometric_cosine(at, at.wo));
        let is_dirac = self.lights.is_dirac(emitter);
        // Of an area light the density per solid angle makes up for the distance; the choice of a point does not.
        let asked = f64::from(asked)
            * match (is_dirac, self.lights.is_distant(emitter)) {
                (_, true) => 1.0,
                (true, false) => f64::from(distance * distance),
                (false, false) => f64::from(leaving.cosine),
            };
        let vc = if is_dirac { 0.0 } else { squared(f64::from(leaving.cosine) / found) };
        Odds { vcm: squared(asked / found), vc }
    }
}
