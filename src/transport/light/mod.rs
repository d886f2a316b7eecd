//! Lights: emissive triangles, lights without area, the environment.
//!
//! In: a scene. Out: directions towards light with their densities ([`Lights::sample_towards`]), the densities of
//! directions found otherwise ([`Lights::pdf_towards`]), and particles that leave the lights
//! (`begin`). Radiance in W·sr⁻¹·m⁻² per band, power in W.
//!
//! Lights inside of the scene are chosen by what they may bring to the surface (`tree`). Bake, refinement and truth look
//! for the sky where it is seen (`sky`); the tracer of corrections does not, since to know that takes most of a second.
//! Bake and refinement look for surfaces that reflect much light, too ([`bright`]).

pub mod bright;
mod distant;
mod distribution;
mod emission;
pub(super) mod named;
mod sky;
mod spherical_triangle;
mod towards;
mod tree;

use std::f32::consts::{PI, TAU};
use std::sync::{Arc, OnceLock};

use glam::Vec3;

use crate::geometry::Accel;
use crate::image::luminance;
use crate::math;
use crate::scene::{Light, Scene, TriangleIndex};
use distribution::{Choice, EnvironmentDistribution};
use spherical_triangle::{SAMPLED, SphericalTriangle, barycentrics};
use tree::{Bounds, LightTree};

pub use sky::VisibleSky;
pub use towards::Receiver;

/// Least and largest share of next-event samples that go to the environment and directional lights where there
/// are others too: seen from a room, their power is mostly outside of it.
const DISTANT_SHARE: (f32, f32) = (0.25, 0.75);

/// A direction towards a light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightSample {
    /// Unit direction to the light.
    pub wi: Vec3,
    /// Distance to it, scene units; infinite for the environment and directional lights.
    pub distance: f32,
    /// Radiance from there; for `delta` lights the irradiance at perpendicular incidence.
    pub radiance: Vec3,
    /// Density per solid angle, including the probability of the light; for `delta` lights that probability.
    pub pdf: f32,
    /// Whether no other way of sampling can find the light.
    pub delta: bool,
}

impl LightSample {
    /// Whether it comes from the environment or a directional light.
    pub fn is_distant(&self) -> bool {
        self.distance.is_infinite()
    }
}

/// One light of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::transport) enum Emitter {
    /// A triangle that emits from its front.
    Triangle(TriangleIndex),
    /// `Scene::lights[index]`.
    Analytic(u32),
    /// `Scene::environment`.
    Environment,
}

/// All lights of a scene, ready to be sampled.
#[derive(Clone, Debug)]
pub struct Lights {
    /// Triangles in ascending order, point and spot lights, then the distant ones.
    emitters: Vec<Emitter>,
    triangle_count: usize,
    near_count: usize,
    near: Choice,
    distant: Choice,
    /// Share of the distant lights in next-event samples and in particles.
    distant_share: f32,
    environment: Option<EnvironmentDistribution>,
    centre: Vec3,
    radius: f32,
    /// Those inside of the scene, in their order.
    tree: LightTree,
    /// Places and ranges of lamps whose light ends somewhere.
    ending: Vec<(Vec3, f32)>,
    /// Found when it is first asked for.
    sky: Arc<OnceLock<Option<VisibleSky>>>,
}

/// Front normal and area of a triangle.
fn normal_and_area([a, b, c]: [Vec3; 3]) -> (Vec3, f32) {
    // In f64: squares of small edges underflow in f32.
    let cross = (b - a).as_dvec3().cross((c - a).as_dvec3());
    let length = cross.length();
    if length > 0.0 { ((cross / length).as_vec3(), (0.5 * length) as f32) } else { (Vec3::ZERO, 0.0) }
}

/// Smooth edge of a spot light: 1 at the inner angle, 0 at the outer, cubic in the cosine between (as pbrt-v4).
fn spot_falloff(cosine: f32, inner: f32, outer: f32) -> f32 {
    let (high, low) = (math::cos(inner), math::cos(outer));
    if cosine >= high {
        1.0
    } else if cosine <= low {
        0.0
    } else {
        let x = (cosine - low) / (high - low);
        x * x * (3.0 - 2.0 * x)
    }
}

impl Lights {
    /// Collects the lights of a scene. What has no power, no area or numbers that are not finite is left out.
    pub fn build(scene: &Scene) -> Self {
        let half = (scene.bounds[1] - scene.bounds[0]) * 0.5;
        let bounded = half.is_finite() && half.min_element() >= 0.0;
        // A little larger, so that particles start outside of what they hit.
        let radius = if bounded { half.length() * 1.001 } else { 0.0 };
        let centre = if bounded { scene.bounds[0] + half } else { Vec3::ZERO };
        let environment = scene.environment.as_ref().and_then(EnvironmentDistribution::new);
        let mut lights = Self {
            emitters: Vec::new(),
            triangle_count: 0,
            near_count: 0,
            near: Choice::default(),
            distant: Choice::default(),
            distant_share: 0.0,
            environment,
            centre,
            radius,
            tree: LightTree::default(),
            sky: Arc::default(),
            ending: scene.lights.iter().filter_map(Light::lamp).filter(|l| l.1.is_finite()).collect(),
        };
        let mut weights: Vec<f64> = Vec::new();
        let mut add = |lights: &mut Self, emitter: Emitter, flux: Vec3| {
            let weight = f64::from(luminance(flux));
            if flux.is_finite() && weight > 0.0 {
                lights.emitters.push(emitter);
                weights.push(weight);
            }
        };
        let radiant: Vec<Option<Vec3>> = scene
            .materials
            .iter()
            .map(|m| {
                let mean = m.emission.map.map_or(Vec3::ONE, |map| {
                    let [r, g, b, _] = scene.textures[map.0 as usize].mean();
                    Vec3::new(r, g, b)
                });
                let there = m.opacity_map.is_some() || m.opacity >= 0.5;
                (m.is_emissive() && there).then(|| m.emission.color * mean)
            })
            .collect();
        for t in 0..scene.mesh.triangles.len() as TriangleIndex {
            if let Some(radiance) = radiant[scene.mesh.materials[t as usize].0 as usize] {
                let (_, area) = normal_and_area(scene.mesh.corners(t));
                add(&mut lights, Emitter::Triangle(t), radiance * (PI * area));
            }
        }
        lights.triangle_count = lights.emitters.len();
        let near = |light: &Light| !matches!(light, Light::Directional { .. });
        for distant in [false, true] {
            for (i, light) in scene.lights.iter().enumerate().filter(|(_, l)| near(l) != distant) {
                let flux = analytic_power(light, radius);
                add(&mut lights, Emitter::Analytic(i as u32), flux);
            }
            if !distant {
                lights.near_count = lights.emitters.len();
            }
        }
        if let Some(d) = &lights.environment {
            // An empty scene still has an environment.
            let flux = d.integral * (PI * radius * radius).max(f32::MIN_POSITIVE);
            add(&mut lights, Emitter::Environment, flux);
        }
        if lights.emitters.last() != Some(&Emitter::Environment) {
            lights.environment = None;
        }
        let (a, b) = weights.split_at(lights.near_count);
        lights.near = Choice::new(a.iter().copied());
        lights.tree =
            LightTree::new(lights.emitters.iter().zip(a).map(|(&e, &w)| lights.bounds(scene, e, w)));
        lights.distant = Choice::new(b.iter().copied());
        let total = lights.near.total() + lights.distant.total();
        if total > 0.0 {
            let share = lights.distant.total() / total;
            lights.distant_share = if a.is_empty() || b.is_empty() {
                share as f32
            } else {
                (share as f32).clamp(DISTANT_SHARE.0, DISTANT_SHARE.1)
            };
        }
        lights
    }

    /// Bounds of what a light inside of the scene sends out, from its `power`, luminance, W.
    fn bounds(&self, scene: &Scene, emitter: Emitter, power: f64) -> Option<Bounds> {
        match emitter {
            Emitter::Triangle(t) => {
                let corners = scene.mesh.corners(t);
                // Straight ahead.
                Some(Bounds::of_triangle(corners, normal_and_area(corners).0, power / f64::from(PI)))
            }
            Emitter::Analytic(i) => match scene.lights[i as usize] {
                Light::Point { position, intensity, .. } => {
                    Some(Bounds::of_point(position, f64::from(luminance(intensity))))
                }
                Light::Spot { position, direction, intensity, inner, outer, .. } => {
                    let strength = f64::from(luminance(intensity));
                    Some(Bounds::of_spot(position, direction.normalize(), inner, outer, strength))
                }
                Light::Directional { .. } => None,
            },
            Emitter::Environment => None,
        }
    }

    /// The lamp at a point, with its range, if its light ends somewhere.
    pub(in crate::transport) fn ending_lamp(&self, origin: Vec3) -> Option<(Vec3, f32)> {
        self.ending.iter().find(|(position, _)| *position == origin).copied()
    }

    /// What of the sky is seen from where, if that is worth knowing: looked at once.
    pub fn visible_sky(&self, scene: &Scene, accel: &Accel) -> Option<&VisibleSky> {
        self.sky.get_or_init(|| VisibleSky::new(scene, accel, self.environment.as_ref())).as_ref()
    }

    /// Whether nothing emits.
    pub fn is_empty(&self) -> bool {
        self.emitters.is_empty()
    }

    /// Radiance that a ray along `direction` meets where it leaves the scene. Finite.
    pub fn escaped(&self, scene: &Scene, direction: Vec3) -> Vec3 {
        match (&self.environment, &scene.environment) {
            (Some(_), Some(environment)) => environment.radiance(direction),
            _ => Vec3::ZERO,
        }
    }
}

/// Power of a light without area; directional ones through a disk of `radius`.
fn analytic_power(light: &Light, radius: f32) -> Vec3 {
    match *light {
        Light::Point { position, intensity, .. } if position.is_finite() => intensity * (2.0 * TAU),
        Light::Spot { position, direction, intensity, inner, outer, .. }
            if position.is_finite() && direction.try_normalize().is_some() =>
        {
            // The cubic edge holds half of what its cone would.
            intensity * (TAU * (1.0 - 0.5 * (math::cos(inner) + math::cos(outer))))
        }
        Light::Directional { direction, irradiance } if direction.try_normalize().is_some() => {
            irradiance * (PI * radius * radius).max(f32::MIN_POSITIVE)
        }
        Light::Point { .. } | Light::Spot { .. } | Light::Directional { .. } => Vec3::ZERO,
    }
}

/// How directions to a triangle are drawn.
enum TriangleView {
    Spherical(SphericalTriangle),
    Area { normal: Vec3, area: f32 },
}

impl TriangleView {
    /// `None` where the point is not in front of the triangle.
    fn new(corners: [Vec3; 3], point: Vec3) -> Option<Self> {
        let (normal, area) = normal_and_area(corners);
        if (point - corners[0]).dot(normal) <= 0.0 || area <= 0.0 {
            return None;
        }
        Some(match SphericalTriangle::new(corners, point) {
            Some(s) if SAMPLED.contains(&s.solid_angle) => Self::Spherical(s),
            _ => Self::Area { normal, area },
        })
    }
}

/// A uniform point on a triangle: barycentric weights of the second and third corner (REFERENCE §4.4).
fn uniform_barycentrics(u: [f32; 2]) -> (f32, f32) {
    let s = u[0].sqrt();
    (s * (1.0 - u[1]), s * u[1])
}

/// Radiance of a triangle's front at a point; zero where it is cut out.
fn emitted(scene: &Scene, t: TriangleIndex, b1: f32, b2: f32) -> Vec3 {
    let material = &scene.materials[scene.mesh.materials[t as usize].0 as usize];
    if material.may_vanish() && !scene.is_opaque_at(t, b1, b2) {
        return Vec3::ZERO;
    }
    let color = material.emission.color;
    let Some(map) = material.emission.map else { return color };
    let texture = &scene.textures[map.0 as usize];
    let [r, g, b, _] = texture.sample(scene.mesh.coordinates(t, b1, b2, texture.placement.second), 0.0);
    color * Vec3::new(r, g, b)
}

fn sample_triangle(scene: &Scene, t: TriangleIndex, point: Vec3, u: [f32; 2]) -> Option<LightSample> {
    let corners = scene.mesh.corners(t);
    let view = TriangleView::new(corners, point)?;
    let (b1, b2) = match &view {
        TriangleView::Spherical(s) => {
            let wi = s.sample(f64::from(u[0]), f64::from(u[1]))?;
            barycentrics(corners, point, wi)?
        }
        TriangleView::Area { .. } => uniform_barycentrics(u),
    };
    let to = corners[0] * (1.0 - b1 - b2) + corners[1] * b1 + corners[2] * b2 - point;
    let distance = to.length();
    let wi = to / distance;
    let pdf = match view {
        TriangleView::Spherical(s) => (1.0 / s.solid_angle) as f32,
        TriangleView::Area { normal, area } => {
            let cosine = -normal.dot(wi);
            if cosine <= 0.0 {
                return None;
            }
            distance * distance / (area * cosine)
        }
    };
    Some(LightSample { wi, distance, radiance: emitted(scene, t, b1, b2), pdf, delta: false })
}

fn sample_analytic(light: &Light, point: Vec3) -> Option<LightSample> {
    let near = |position: Vec3| {
        let to = position - point;
        let distance = to.length();
        (distance > 0.0 && distance.is_finite()).then(|| (to / distance, distance))
    };
    let (wi, distance, radiance) = match *light {
        Light::Point { position, intensity, range } => {
            let (wi, distance) = near(position)?;
            (wi, distance, intensity / (distance * distance) * Light::window(range, distance))
        }
        Light::Spot { position, direction, intensity, inner, outer, range } => {
            let (wi, distance) = near(position)?;
            let falloff = spot_falloff(-wi.dot(direction.normalize()), inner, outer);
            let falloff = falloff * Light::window(range, distance);
            (wi, distance, intensity * (falloff / (distance * distance)))
        }
        Light::Directional { direction, irradiance } => (-direction.normalize(), f32::INFINITY, irradiance),
    };
    Some(LightSample { wi, distance, radiance, pdf: 1.0, delta: true })
}

#[cfg(test)]
mod tests;
