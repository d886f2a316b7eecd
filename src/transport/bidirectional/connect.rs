//! The ways to find a path, by how many of its vertices the light's subpath has: none (a light is met), one (a light is
//! sampled), some (two vertices are connected), all but the eye (light is traced to the pinhole).

use glam::Vec3;

use crate::geometry::Hit;
use crate::transport::direct::{arriving, visibility};
use crate::transport::light::Receiver;

use super::Bidirectional;
use super::odds::{Odds, squared, weight};
use super::vertex::{End, Vertex, geometric_cosine, receiver};

impl Bidirectional<'_> {
    /// Weight of a light that a subpath from the eye has met after `vertices` others, the last of them `from` if lights
    /// were sampled there, along the unit `wi`: at a hit with its distance from there, or in the environment.
    pub(super) fn weight_of_found(
        &self,
        vertices: u32,
        odds: &Odds,
        from: Option<Receiver>,
        wi: Vec3,
        hit: Option<(&Hit, f32)>,
    ) -> f32 {
        // What is seen straight is found in no other way.
        if vertices == 0 {
            return 1.0;
        }
        let Some(emitter) = self.lights.met(self.scene, hit.map(|h| h.0)) else { return 1.0 };
        let leaving = self.lights.leaving(self.scene, emitter, -wi);
        let distance = hit.map_or(f32::INFINITY, |h| h.1);
        let asked = from.map_or(0.0, |at| {
            self.lights.density_towards(self.scene, &at, emitter, (wi, distance), self.sky)
        });
        // Per area where the light has one.
        let per =
            if distance.is_finite() { f64::from(leaving.cosine) / squared(f64::from(distance)) } else { 1.0 };
        let sampled = if asked > 0.0 { squared(f64::from(asked) * per) * odds.vcm } else { 0.0 };
        weight(sampled, squared(leaving.density) * odds.vc)
    }

    /// A light sample at a vertex from the eye.
    pub(super) fn sampled(&self, z: &Vertex, choice: f64, u: [f32; 2]) -> Vec3 {
        let (scene, lights) = (self.scene, self.lights);
        let Some((emitter, light)) = lights.draw_towards(scene, &receiver(&z.at), (choice, u), self.sky)
        else {
            return Vec3::ZERO;
        };
        let Some(s) = z.towards(scene, End::Eye, light.wi) else { return Vec3::ZERO };
        let Some(radiance) = arriving(scene, self.accel, &z.at, &z.media, &light) else { return Vec3::ZERO };
        let leaving = lights.leaving(scene, emitter, -light.wi);
        let pdf = f64::from(light.pdf);
        let met = if light.delta { 0.0 } else { squared(f64::from(s.to_light) / pdf) };
        // Density of particles there over that of the sample, both per area.
        let mut sampled = pdf * f64::from(leaving.cosine);
        if light.delta && light.distance.is_finite() {
            sampled *= squared(f64::from(light.distance));
        }
        let traced = leaving.density * f64::from(geometric_cosine(&z.at, light.wi)) / sampled;
        let weight = weight(met, squared(traced) * z.odds.behind(s.to_eye));
        finite(z.throughput * s.f * radiance * (weight / light.pdf))
    }

    /// A vertex from the eye joined with one from a light.
    pub(super) fn connected(&self, z: &Vertex, y: &Vertex) -> Vec3 {
        let scene = self.scene;
        let between = y.at.position - z.at.position;
        let distance = between.length();
        let direction = between / distance;
        let Some(at_z) = z.towards(scene, End::Eye, direction) else { return Vec3::ZERO };
        let Some(at_y) = y.towards(scene, End::Light, -direction) else { return Vec3::ZERO };
        let per_area = |at: &Vertex| geometric_cosine(&at.at, direction) / (distance * distance);
        let (near_z, near_y) = (per_area(z), per_area(y));
        let weight = weight(
            squared(f64::from(at_z.to_light * near_y)) * y.odds.behind(at_y.to_light),
            squared(f64::from(at_y.to_eye * near_z)) * z.odds.behind(at_z.to_eye),
        );
        let value = z.throughput * at_z.f * y.throughput * at_y.f * (near_y * weight);
        if !value.is_finite() || value.max_element() <= 0.0 {
            return Vec3::ZERO;
        }
        let passed = visibility(scene, self.accel, &z.at.spawn_to(y.at.position));
        value * passed * z.media.transmittance(scene, distance)
    }

    /// A vertex from a light joined with the eye: the pixel, counted row by row, and its radiance.
    pub(super) fn shown(&self, y: &Vertex) -> Option<(u32, Vec3)> {
        let (scene, frame) = (self.scene, self.frame);
        let (px, py, _) = frame.project(y.at.position)?;
        let [width, height] = frame.size;
        if !(px >= 0.0 && py >= 0.0 && px < width as f32 && py < height as f32) {
            return None;
        }
        let between = frame.eye - y.at.position;
        let distance = between.length();
        let direction = between / distance;
        let s = y.towards(scene, End::Light, direction)?;
        let film = self.frame.density(-direction);
        let near = geometric_cosine(&y.at, direction) / (distance * distance);
        let paths = self.light_paths();
        let seen = f64::from(film * near) / paths;
        let weight = weight(squared(seen) * y.odds.behind(s.to_light), 0.0);
        let value = y.throughput * s.f * (near * film * weight / paths as f32);
        if !value.is_finite() || value.max_element() <= 0.0 {
            return None;
        }
        let passed = visibility(scene, self.accel, &y.at.spawn_to(frame.eye));
        let value = value * passed * y.media.transmittance(scene, distance);
        (value.max_element() > 0.0).then_some((py as u32 * width + px as u32, value))
    }
}

fn finite(value: Vec3) -> Vec3 {
    if value.is_finite() { value } else { Vec3::ZERO }
}
