//! Distant light on a surface of a known normal: suns and the sky.
//!
//! The sky is sampled by the cosine as well as by its radiance, so that the half of it below the surface costs nothing and an
//! even sky has no noise but that of what hides it (balance heuristic; Veach 1997, §9.2).

use std::f32::consts::PI;

use super::sky::VisibleSky;
use super::{Emitter, LightSample, Lights, Receiver, sample_analytic};
use crate::image::luminance;
use crate::scene::Scene;
use crate::transport::bsdf::cosine_hemisphere;

impl Lights {
    /// Whether there are directional lights or an environment.
    pub fn has_distant(&self) -> bool {
        self.distant.total() > 0.0
    }

    /// Power of the lights inside of the scene, luminance, W.
    pub fn near_power(&self) -> f64 {
        self.near.total()
    }

    /// A direction in which light of directional lights or of the environment arrives, chosen by what it would bring
    /// if nothing hid it. `visible`: what is known of how much of the sky is seen.
    pub fn sample_distant(
        &self,
        scene: &Scene,
        &Receiver { point, normal }: &Receiver,
        (u_choice, u): (f32, [f32; 2]),
        visible: Option<&VisibleSky>,
    ) -> Option<LightSample> {
        let brings = |l: &LightSample| {
            let e = luminance(l.radiance) * normal.dot(l.wi).max(0.0) / l.pdf;
            if e.is_finite() { e } else { 0.0 }
        };
        let candidates = || {
            self.emitters[self.near_count..].iter().filter_map(|emitter| match emitter {
                Emitter::Analytic(i) => sample_analytic(&scene.lights[*i as usize], point),
                Emitter::Environment => {
                    self.sample_environment(scene, &Receiver { point, normal }, u, visible)
                }
                Emitter::Triangle(_) => None,
            })
        };
        let total: f32 = candidates().map(|l| brings(&l)).sum();
        if !(total > 0.0 && total.is_finite()) {
            return None;
        }
        let (mut sum, mut chosen) = (0.0, None);
        for light in candidates() {
            let e = brings(&light);
            if e > 0.0 && (chosen.is_none() || sum <= u_choice * total) {
                chosen = Some(LightSample { pdf: light.pdf * e / total, ..light });
            }
            sum += e;
        }
        chosen
    }

    pub(super) fn distant_count(&self) -> usize {
        self.emitters.len() - self.near_count
    }

    pub(super) fn sample_environment(
        &self,
        scene: &Scene,
        at: &Receiver,
        [u, v]: [f32; 2],
        visible: Option<&VisibleSky>,
    ) -> Option<LightSample> {
        let (environment, distribution) = (scene.environment.as_ref()?, self.environment.as_ref()?);
        let normal = at.normal;
        let by_cosine = |u: f32| {
            let (x, y) = normal.any_orthonormal_pair();
            let local = cosine_hemisphere([u, v]);
            x * local.x + y * local.y + normal * local.z
        };
        let (wi, pdf) = if let Some(visible) = visible {
            visible.sample((environment, distribution), at, [u, v])?
        } else if environment.map.is_none() {
            let wi = by_cosine(u);
            (wi, normal.dot(wi).max(0.0) / PI)
        } else {
            let wi = match u < 0.5 {
                true => by_cosine(2.0 * u),
                false => distribution.sample(environment, [2.0 * u - 1.0, v])?.0,
            };
            let cosine = normal.dot(wi).max(0.0) / PI;
            (wi, 0.5 * cosine + 0.5 * distribution.pdf(environment, wi))
        };
        let radiance = environment.radiance(wi);
        Some(LightSample { wi, distance: f32::INFINITY, radiance, pdf, delta: false })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    use crate::illumination::test_scenes::{lambert, quad, scene};
    use crate::image::{Map2d, luminance};
    use crate::math;
    use crate::rng::Stream;
    use crate::scene::{Environment, Light};

    /// A square light above, a sky with a bright spot, a sun and a lamp; nothing hides any of them.
    fn outdoors() -> Scene {
        let mesh = quad(Vec3::new(-0.5, 1.0, -0.5), Vec3::X, Vec3::Z);
        let lights = vec![
            Light::Directional { direction: Vec3::new(0.3, -0.9, 0.1), irradiance: Vec3::splat(2.0) },
            Light::Point {
                position: Vec3::new(0.2, 0.7, 0.1),
                intensity: Vec3::splat(0.3),
                range: f32::INFINITY,
            },
        ];
        let mut s = scene(mesh, vec![lambert(0.5, 1.5)], lights);
        let bright = Map2d::from_fn(16, 8, |x, y| Vec3::splat(if (x, y) == (3, 2) { 20.0 } else { 0.3 }));
        s.environment = Some(Environment { map: Some(bright), ..Environment::constant(Vec3::ONE) });
        s
    }

    /// Irradiance without anything that hides light, and its standard error.
    fn mean(n: u64, mut sample: impl FnMut(&mut Stream) -> f64) -> (f64, f64) {
        let (mut sum, mut squares) = (0.0, 0.0);
        for i in 0..n {
            let e = sample(&mut Stream::new(5, i, 0));
            (sum, squares) = (sum + e, squares + e * e);
        }
        let m = sum / n as f64;
        (m, ((squares / n as f64 - m * m) / n as f64).sqrt())
    }

    #[test]
    fn distant_lights_are_chosen_by_what_they_bring() {
        let s = outdoors();
        let lights = Lights::build(&s);
        let normal = Vec3::new(0.1, 0.9, -0.2).normalize();
        let value = |l: LightSample| f64::from(luminance(l.radiance) * l.wi.dot(normal).max(0.0) / l.pdf);
        let is_distant = LightSample::is_distant;
        let at = Receiver { point: Vec3::ZERO, normal };
        let (a, error_a) = mean(400_000, |r| {
            let l = lights.sample_towards(&s, &at, (r.next_f64(), r.next_2d()), None).filter(is_distant);
            l.map_or(0.0, value)
        });
        let (b, error_b) = mean(100_000, |r| {
            lights.sample_distant(&s, &at, (r.next_f32(), r.next_2d()), None).map_or(0.0, value)
        });
        assert!((a - b).abs() < 4.0 * math::hypot(error_a, error_b), "{a} ± {error_a}, {b} ± {error_b}");
        // From a quarter of the samples.
        assert!(0.5 * error_b < error_a, "{error_a} {error_b}");
    }
}
