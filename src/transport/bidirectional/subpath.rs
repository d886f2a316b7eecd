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
const ROULETTE_AFTER: u32 = 4;
/// No subpath is longer; roulette ends nearly all long before.
const BOUNCES_MAX: u32 = 1000;

/// A subpath on its way.
struct Subpath {
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

impl Subpath {
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
        if n < ROULETTE_AFTER {
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
    fn hit(&self, subpath: &mut Subpath) -> Option<(crate::geometry::Hit, Interaction, Bsdf)> {
        let hit = self.accel.intersect(self.scene, &subpath.ray)?;
        let at = Interaction::at(self.scene, &subpath.ray, &hit);
        subpath.distance += hit.t;
        subpath.throughput *= subpath.media.transmittance_to(self.scene, &at, hit.t);
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
        let mut subpath = Subpath::new(ray, Vec3::ONE, self.around_eye, odds, stream);
        // The last vertex, as far as lights were sampled there.
        let mut from: Option<Receiver> = None;
        let (mut vertices, mut dirac, mut length) = (0, true, 0.0);
        for _ in 0..BOUNCES_MAX {
            let Some((hit, at, bsdf)) = self.hit(&mut subpath) else {
                let light = self.lights.escaped(self.scene, subpath.ray.direction);
                if light != Vec3::ZERO {
                    let weight =
                        self.weight_of_found(vertices, &subpath.odds, from, subpath.ray.direction, None);
                    seen.connected += subpath.throughput * light * (subpath.scale * weight);
                }
                break;
            };
            let arrived = subpath.odds.arrived(subpath.distance, geometric_cosine(&at, at.wo));
            let emitted = at.point().emission(self.scene);
            if emitted != Vec3::ZERO {
                let found = Some((&hit, subpath.distance));
                let weight = self.weight_of_found(vertices, &arrived, from, -at.wo, found);
                seen.connected += subpath.throughput * emitted * (subpath.scale * weight);
            }
            let (u, u_lobe) = (subpath.stream.next_2d(), subpath.stream.next_f32());
            let sample = bsdf.sample_all(at.wo, u, u_lobe);
            if let Some(through) = sample.filter(|s| goes_straight(self.scene, &at, s)) {
                subpath.leave(&at, through.wi, through.weight);
                continue;
            }
            length += subpath.distance;
            (subpath.odds, subpath.distance) = (arrived, 0.0);
            let throughput = subpath.throughput * subpath.scale;
            let vertex = Vertex { at, bsdf, throughput, media: subpath.media, odds: subpath.odds };
            if bsdf.is_connectible() {
                let (choice, u) = (subpath.stream.next_f64(), subpath.stream.next_2d());
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
            subpath.odds = if sample.delta {
                from = None;
                subpath.odds.mirrored(cosine, at.is_reversible(&bsdf, &sample))
            } else {
                let Some(s) = scattering(self.scene, &at, &bsdf, End::Eye, sample.wi) else { break };
                subpath.odds.scattered(cosine, sample.pdf, s.to_eye)
            };
            if sample.transmitted {
                subpath.scale *= sample.radiance_scale;
                subpath.media = subpath.media.crossed(self.scene, &at);
            }
            subpath.leave(&at, sample.wi, sample.weight);
            if !subpath.survives(vertices, subpath.throughput.max_element()) {
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
        let mut subpath = Subpath::new(ray, flux, around, Odds::default(), stream);
        let (only_alone, mut alone) = (alone, self.lights.is_dirac(emitter));
        let (mut vertices, mut beside) = (0, true);
        let lamp = self.lights.ending_lamp(subpath.ray.origin);
        for _ in 0..BOUNCES_MAX {
            let Some((_, at, bsdf)) = self.hit(&mut subpath) else { return };
            let sample = bsdf.sample_all(at.wo, subpath.stream.next_2d(), subpath.stream.next_f32());
            if let Some(through) = sample.filter(|s| goes_straight(self.scene, &at, s)) {
                subpath.leave(&at, through.wi, through.weight);
                continue;
            }
            if let Some((position, range)) = lamp.filter(|_| vertices == 0) {
                subpath.throughput *= Light::window(range, position.distance(at.position));
                if subpath.throughput.max_element() <= 0.0 {
                    return;
                }
            }
            let cosine = geometric_cosine(&at, at.wo);
            subpath.odds = if vertices == 0 {
                self.odds_of_first(emitter, &at, subpath.distance)
            } else {
                subpath.odds.arrived(subpath.distance, cosine)
            };
            subpath.distance = 0.0;
            if bsdf.is_connectible() {
                let vertex = Vertex {
                    at,
                    bsdf,
                    throughput: subpath.throughput,
                    media: subpath.media,
                    odds: subpath.odds,
                };
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
                subpath.odds = subpath.odds.mirrored(out, true);
                if sample.transmitted {
                    subpath.media = subpath.media.crossed(self.scene, &at);
                }
                subpath.leave(&at, sample.wi, weight);
            } else {
                let Some(s) = scattering(self.scene, &at, &bsdf, End::Light, sample.wi) else { return };
                subpath.odds = subpath.odds.scattered(out, sample.pdf, s.to_light);
                subpath.leave(&at, sample.wi, s.f * (out / sample.pdf));
                alone &= !beside;
            }
            beside = !sample.delta;
            if only_alone && !alone
                || !subpath.throughput.is_finite()
                || !subpath.survives(vertices, (subpath.throughput / flux.max_element()).max_element())
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
