//! Light that falls on a surface of a known normal: samples for irradiance rather than for a reflected radiance.
//!
//! Lights without area need no choice where they are few: each is asked, and its light has no noise. The surrounding
//! is sampled by the cosine as well as by its radiance, so that the half of it below the surface costs nothing and an
//! even sky has no noise but that of what hides it (balance heuristic; Veach 1997, §9.2).

use std::f32::consts::PI;

use glam::Vec3;

use super::{DISTANT_SHARE, Emitter, LightSample, Lights, sample_analytic, sample_triangle};
use crate::image::luminance;
use crate::scene::Scene;
use crate::transport::bsdf::cosine_hemisphere;

/// More lights without area than these are chosen among by chance.
const CERTAIN_MAX: usize = 32;

impl Lights {
    /// Whether lights without area are asked one by one, [`Self::certain`], and not sampled.
    fn has_certain(&self) -> bool {
        let surroundings = usize::from(self.environment.is_some());
        self.emitters.len() - self.triangle_count - surroundings <= CERTAIN_MAX
    }

    /// Samples of all lights without area, where these are so few that [`Self::sample_irradiance`] leaves them out.
    pub fn certain<'a>(&'a self, scene: &'a Scene, point: Vec3) -> impl Iterator<Item = LightSample> + 'a {
        let analytic = if self.has_certain() { &self.emitters[self.triangle_count..] } else { &[] };
        analytic
            .iter()
            .filter_map(move |emitter| match emitter {
                Emitter::Analytic(i) => sample_analytic(&scene.lights[*i as usize], point),
                Emitter::Triangle(_) | Emitter::Surrounding => None,
            })
            .filter(|s| s.radiance.is_finite() && s.radiance.max_element() > 0.0)
    }

    /// Whether [`Self::certain`] names lights inside of the scene.
    pub fn has_near_points(&self) -> bool {
        self.has_certain() && self.near_count > self.triangle_count
    }

    /// A direction in which light arrives at `point` on a surface of this normal; all lights but those that
    /// [`Self::certain`] names. `None` where the light chosen cannot be seen from there.
    pub fn sample_irradiance(
        &self,
        scene: &Scene,
        point: Vec3,
        normal: Vec3,
        u_choice: f32,
        u: [f32; 2],
    ) -> Option<LightSample> {
        if !self.has_certain() {
            return self.sample_direct(scene, point, u_choice, u);
        }
        let near = if self.triangle_count > 0 { self.near.sum_of_first(self.triangle_count) } else { 0.0 };
        let share = match (near > 0.0, self.environment.is_some()) {
            (_, false) => 0.0,
            (false, true) => 1.0,
            (true, true) => {
                let far = self.distant.total() * self.distant.probability(self.distant_count() - 1);
                ((far / (far + near)) as f32).clamp(DISTANT_SHARE.0, DISTANT_SHARE.1)
            }
        };
        let u_choice = u_choice.clamp(0.0, 1.0);
        let sample = if u_choice < share {
            self.sample_surrounding(scene, normal, u).map(|s| LightSample { pdf: s.pdf * share, ..s })
        } else {
            let choice = (u_choice - share) / (1.0 - share);
            let (members, of_group, rest) = self.groups.choose(point, normal, choice)?;
            let [before, after] = [members.start, members.end].map(|n| self.near.sum_of_first(n));
            let x = (before + f64::from(rest) * (after - before)) / self.near.total();
            let i = self.near.sample(x)?.clamp(members.start, members.end - 1);
            let Emitter::Triangle(t) = self.emitters[i] else { return None };
            let within = self.near.probability(i) * self.near.total() / (after - before);
            let probability = f64::from((1.0 - share) * of_group) * within;
            sample_triangle(scene, t, point, u)
                .map(|s| LightSample { pdf: (f64::from(s.pdf) * probability) as f32, ..s })
        }?;
        let usable = sample.pdf > 0.0
            && sample.pdf.is_finite()
            && sample.radiance.is_finite()
            && sample.radiance.max_element() > 0.0;
        usable.then_some(sample)
    }

    /// Whether there are directional lights or a surrounding.
    pub fn has_distant(&self) -> bool {
        self.distant.total() > 0.0
    }

    /// Power of the lights inside of the scene, luminance, W.
    pub fn near_power(&self) -> f64 {
        self.near.total()
    }

    /// A direction in which light of directional lights or of the surrounding arrives, chosen by what it would bring
    /// if nothing hid it.
    pub fn sample_distant(
        &self,
        scene: &Scene,
        point: Vec3,
        normal: Vec3,
        u_choice: f32,
        u: [f32; 2],
    ) -> Option<LightSample> {
        let brings = |l: &LightSample| {
            let e = luminance(l.radiance) * normal.dot(l.wi).max(0.0) / l.pdf;
            if e.is_finite() { e } else { 0.0 }
        };
        let candidates = || {
            self.emitters[self.near_count..].iter().filter_map(|emitter| match emitter {
                Emitter::Analytic(i) => sample_analytic(&scene.lights[*i as usize], point),
                Emitter::Surrounding => self.sample_surrounding(scene, normal, u),
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

    pub(super) fn sample_surrounding(
        &self,
        scene: &Scene,
        normal: Vec3,
        [u, v]: [f32; 2],
    ) -> Option<LightSample> {
        let (environment, distribution) = (scene.environment.as_ref()?, self.environment.as_ref()?);
        let by_cosine = |u: f32| {
            let (x, y) = normal.any_orthonormal_pair();
            let local = cosine_hemisphere([u, v]);
            x * local.x + y * local.y + normal * local.z
        };
        let (wi, pdf) = if environment.map.is_none() {
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
            Light::Point { position: Vec3::new(0.2, 0.7, 0.1), intensity: Vec3::splat(0.3) },
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
    fn both_ways_to_sample_light_find_the_same_irradiance() {
        let s = outdoors();
        let lights = Lights::build(&s);
        let (point, normal) = (Vec3::ZERO, Vec3::new(0.1, 0.9, -0.2).normalize());
        let value = |l: LightSample| f64::from(luminance(l.radiance) * l.wi.dot(normal).max(0.0) / l.pdf);
        let known: f64 = lights.certain(&s, point).map(value).sum();
        let (a, error_a) =
            mean(400_000, |r| lights.sample_direct(&s, point, r.next_f32(), r.next_2d()).map_or(0.0, value));
        let (b, error_b) = mean(100_000, |r| {
            known + lights.sample_irradiance(&s, point, normal, r.next_f32(), r.next_2d()).map_or(0.0, value)
        });
        assert!((a - b).abs() < 4.0 * math::hypot(error_a, error_b), "{a} ± {error_a}, {b} ± {error_b}");
        // From a quarter of the samples.
        assert!(0.5 * error_b < error_a, "{error_a} {error_b}");
    }

    #[test]
    fn distant_lights_are_chosen_by_what_they_bring() {
        let s = outdoors();
        let lights = Lights::build(&s);
        let normal = Vec3::new(0.1, 0.9, -0.2).normalize();
        let value = |l: LightSample| f64::from(luminance(l.radiance) * l.wi.dot(normal).max(0.0) / l.pdf);
        let is_distant = LightSample::is_from_afar;
        let (a, error_a) = mean(400_000, |r| {
            let l = lights.sample_direct(&s, Vec3::ZERO, r.next_f32(), r.next_2d()).filter(is_distant);
            l.map_or(0.0, value)
        });
        let (b, error_b) = mean(100_000, |r| {
            lights.sample_distant(&s, Vec3::ZERO, normal, r.next_f32(), r.next_2d()).map_or(0.0, value)
        });
        assert!((a - b).abs() < 4.0 * math::hypot(error_a, error_b), "{a} ± {error_a}, {b} ± {error_b}");
        // From a quarter of the samples.
        assert!(0.5 * error_b < error_a, "{error_a} {error_b}");
    }

    #[test]
    fn an_even_sky_and_lights_without_area_have_no_noise() {
        let mut s = outdoors();
        s.materials[0].emission.color = Vec3::ZERO;
        s.environment = Some(Environment::constant(Vec3::splat(0.4)));
        let lights = Lights::build(&s);
        let mut stream = Stream::new(1, 2, 3);
        for _ in 0..100 {
            let l = lights
                .sample_irradiance(&s, Vec3::ZERO, Vec3::Y, stream.next_f32(), stream.next_2d())
                .expect("a sky");
            let e = l.radiance.x * l.wi.y / l.pdf;
            assert!((e - 0.4 * PI).abs() < 1e-3 && !l.delta, "{e}");
        }
        assert_eq!(lights.certain(&s, Vec3::ZERO).count(), 2);
    }
}
