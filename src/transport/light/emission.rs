//! Particles that leave the lights (REFERENCE §6.1).

use std::f32::consts::{PI, TAU};

use glam::Vec3;

use super::{Emitter, Lights, emitted, normal_and_area, spot_falloff, uniform_barycentrics};
use crate::geometry::{Hit, Ray};
use crate::math;
use crate::rng::Stream;
use crate::scene::{Light, Scene, TriangleIndex};
use crate::transport::interaction::Interaction;

/// A uniform point of the unit disk, concentric (Shirley & Chiu 1997).
fn disk(u: [f32; 2]) -> [f32; 2] {
    let (x, y) = (2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0);
    if x == 0.0 && y == 0.0 {
        return [0.0, 0.0];
    }
    let (r, phi) =
        if x.abs() > y.abs() { (x, PI / 4.0 * (y / x)) } else { (y, PI / 2.0 - PI / 4.0 * (x / y)) };
    [r * math::cos(phi), r * math::sin(phi)]
}

/// A direction around `axis` (unit) whose cosine is uniform in [`low`, 1].
fn cone(axis: Vec3, low: f32, u: [f32; 2]) -> Vec3 {
    let z = 1.0 - u[0] * (1.0 - low);
    let r = (1.0 - z * z).max(0.0).sqrt();
    let (s, c) = math::sin_cos(TAU * u[1]);
    let (x, y) = axis.any_orthonormal_pair();
    x * (r * c) + y * (r * s) + axis * z
}

/// How particles leave a light along a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::transport) struct Leaving {
    /// Density of point and direction, with the probability of the light: per area and solid angle, of lights without
    /// area per solid angle, of directional ones per area of the disk.
    pub density: f64,
    /// Cosine at the light; 1 where it has no area.
    pub cosine: f32,
}

impl Lights {
    /// A particle with its light: its ray and its flux per band in W, divided by the density of its choice, so that the mean
    /// flux of many is the power of all lights. `None` is a particle without flux.
    ///
    /// Lights are chosen by power; triangles emit by area and cosine; the environment and directional lights
    /// through a disk around the scene's bounds.
    pub(in crate::transport) fn begin(
        &self,
        scene: &Scene,
        stream: &mut Stream,
    ) -> Option<(Emitter, Ray, Vec3)> {
        // More bits than an f32 has: there may be millions of lights.
        let (emitter, probability) = self.choose_emitter(stream.next_f64())?;
        let (ray, flux) = self.emit(scene, emitter, probability, stream)?;
        Some((emitter, ray, flux))
    }

    /// How [`Self::begin`] finds particles that leave a light along a unit direction.
    pub(in crate::transport) fn leaving(&self, scene: &Scene, emitter: Emitter, direction: Vec3) -> Leaving {
        let share = f64::from(self.distant_share);
        let probability = match self.place(emitter) {
            None => 0.0,
            Some(i) if i < self.near_count => (1.0 - share) * self.near.probability(i),
            Some(i) => share * self.distant.probability(i - self.near_count),
        };
        let disk = f64::from(PI * self.radius * self.radius);
        let (density, cosine) = match emitter {
            Emitter::Triangle(t) => {
                let (normal, area) = normal_and_area(scene.mesh.corners(t));
                let cosine = normal.dot(direction).max(0.0);
                (f64::from(cosine / PI) / f64::from(area), cosine)
            }
            Emitter::Analytic(i) => match scene.lights[i as usize] {
                Light::Point { .. } => (1.0 / f64::from(2.0 * TAU), 1.0),
                Light::Spot { outer, .. } => (1.0 / f64::from(TAU * (1.0 - math::cos(outer))), 1.0),
                Light::Directional { .. } => (1.0 / disk, 1.0),
            },
            Emitter::Environment => match (&self.environment, &scene.environment) {
                (Some(d), Some(environment)) => (f64::from(d.pdf(environment, -direction)) / disk, 1.0),
                _ => (0.0, 1.0),
            },
        };
        Leaving { density: density * probability, cosine }
    }

    /// A light by power, where distant ones get the share that they have in light samples, and its probability.
    fn choose_emitter(&self, choice: f64) -> Option<(Emitter, f64)> {
        let share = f64::from(self.distant_share);
        if choice < share {
            let i = self.distant.sample(choice / share)?;
            Some((self.emitters[self.near_count + i], share * self.distant.probability(i)))
        } else {
            let i = self.near.sample((choice - share) / (1.0 - share))?;
            Some((self.emitters[i], (1.0 - share) * self.near.probability(i)))
        }
    }

    /// The same for the lights inside of the scene only, with whether its light has no area.
    pub fn sample_near_emission(&self, scene: &Scene, stream: &mut Stream) -> Option<(Ray, Vec3, bool)> {
        let choice = stream.next_f64();
        let i = self.near.sample(choice)?;
        let (ray, flux) = self.emit(scene, self.emitters[i], self.near.probability(i), stream)?;
        Some((ray, flux, self.is_dirac(self.emitters[i])))
    }

    /// A light by power of those inside of the scene that have no area, counted from 0, and its probability.
    pub fn choose_near_dirac(&self, choice: f64) -> Option<(usize, f64)> {
        let skipped = self.near.sum_of_first(self.triangle_count) / self.near.total();
        let i = self.near.sample(skipped + (1.0 - skipped) * choice)?;
        Some((i.checked_sub(self.triangle_count)?, self.near.probability(i) / (1.0 - skipped)))
    }

    /// A particle of that light along the direction that `u` stands for, which is uniform in [0, 1)² where its light goes:
    /// its ray and its flux, W per band.
    pub fn emit_near_dirac(&self, scene: &Scene, light: usize, u: [f32; 2]) -> Option<(Ray, Vec3)> {
        let Emitter::Analytic(i) = *self.emitters.get(self.triangle_count + light)? else { return None };
        Some(self.emit_from_analytic(&scene.lights[i as usize], u))
    }

    /// Number of the lights inside of the scene that have no area.
    pub fn near_dirac_count(&self) -> usize {
        self.near_count - self.triangle_count
    }

    /// Power of the lights inside of the scene that have no area, luminance, W.
    pub fn near_dirac_power(&self) -> f64 {
        self.near.total() - self.near.sum_of_first(self.triangle_count)
    }

    /// Whether there are directional lights.
    pub fn has_distant_dirac(&self) -> bool {
        self.emitters[self.near_count..].iter().any(|e| self.is_dirac(*e))
    }

    fn emit(
        &self,
        scene: &Scene,
        emitter: Emitter,
        probability: f64,
        stream: &mut Stream,
    ) -> Option<(Ray, Vec3)> {
        let (u, v) = (stream.next_2d(), stream.next_2d());
        let (ray, flux) = match emitter {
            Emitter::Triangle(t) => emit_from_triangle(scene, t, u, v)?,
            Emitter::Analytic(i) => self.emit_from_analytic(&scene.lights[i as usize], u),
            Emitter::Environment => {
                let environment = scene.environment.as_ref()?;
                let (towards, pdf) = self.environment.as_ref()?.sample(environment, u)?;
                let flux = environment.radiance(towards) * (PI * self.radius * self.radius / pdf);
                (self.incoming(-towards, v), flux)
            }
        };
        let flux = (flux.as_dvec3() / probability).as_vec3();
        (flux.is_finite() && flux.max_element() > 0.0 && ray.origin.is_finite()).then_some((ray, flux))
    }

    /// A ray along the unit `direction` from the disk that covers the scene.
    fn incoming(&self, direction: Vec3, u: [f32; 2]) -> Ray {
        let (x, y) = direction.any_orthonormal_pair();
        let [a, b] = disk(u);
        Ray::new(self.centre + (x * a + y * b - direction) * self.radius, direction)
    }

    fn emit_from_analytic(&self, light: &Light, u: [f32; 2]) -> (Ray, Vec3) {
        match *light {
            Light::Point { position, intensity, .. } => {
                (Ray::new(position, cone(Vec3::Z, -1.0, u)), intensity * (2.0 * TAU))
            }
            Light::Spot { position, direction, intensity, inner, outer, .. } => {
                let axis = direction.normalize();
                let low = math::cos(outer);
                let towards = cone(axis, low, u);
                let falloff = spot_falloff(towards.dot(axis), inner, outer);
                (Ray::new(position, towards), intensity * (falloff * TAU * (1.0 - low)))
            }
            Light::Directional { direction, irradiance } => {
                let ray = self.incoming(direction.normalize(), u);
                (ray, irradiance * (PI * self.radius * self.radius))
            }
        }
    }
}

fn emit_from_triangle(scene: &Scene, t: TriangleIndex, u: [f32; 2], v: [f32; 2]) -> Option<(Ray, Vec3)> {
    let (b1, b2) = uniform_barycentrics(u);
    let radiance = emitted(scene, t, b1, b2);
    if radiance.max_element() <= 0.0 {
        return None;
    }
    let corners = scene.mesh.corners(t);
    let (normal, area) = normal_and_area(corners);
    // Cosine-weighted: the disk below the hemisphere (Malley's method).
    let [a, b] = disk(v);
    let (x, y) = normal.any_orthonormal_pair();
    let direction = x * a + y * b + normal * (1.0 - a * a - b * b).max(1e-8).sqrt();
    let hit = Hit { t: 1.0, triangle: t, b1, b2 };
    let at = Interaction::at(scene, &Ray::new(corners[0] + normal, -normal), &hit);
    Some((at.spawn(direction), radiance * (PI * area)))
}
