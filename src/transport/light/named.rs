//! Lights in two kinds: a few without area, each of which is asked (*named*), and all others, of which a sample chooses.
//! What is named has no noise but that of what hides it, and no other way of sampling finds it.

use glam::Vec3;

use super::sky::VisibleSky;
use super::{DISTANT_SHARE, Emitter, LightSample, Lights, Receiver, sample_analytic, sample_triangle};
use crate::geometry::Hit;
use crate::scene::Scene;

/// More lights without area than these cost more rays than they save noise; then all are chosen among by chance.
pub(in crate::transport) const NAMED_MAX: usize = 4;

/// The light that the light with this number sends to `point`.
#[inline]
pub(in crate::transport) fn named_sample(scene: &Scene, number: u32, point: Vec3) -> Option<LightSample> {
    let sample = sample_analytic(&scene.lights[number as usize], point)?;
    (sample.radiance.is_finite() && sample.radiance.max_element() > 0.0).then_some(sample)
}

impl Lights {
    fn has_named(&self) -> bool {
        let environments = usize::from(self.environment.is_some());
        self.emitters.len() - self.triangle_count - environments <= NAMED_MAX
    }

    /// Whether there are lights that have names.
    pub fn has_any_named(&self) -> bool {
        let environments = usize::from(self.environment.is_some());
        self.has_named() && self.emitters.len() > self.triangle_count + environments
    }

    /// The light that each named light sends to `point`.
    pub fn named<'a>(&'a self, scene: &'a Scene, point: Vec3) -> impl Iterator<Item = LightSample> + 'a {
        self.named_by_number(scene, point).map(|(_, sample)| sample)
    }

    /// The same with the light's number in [`crate::scene::SceneParts::lights`].
    pub fn named_by_number<'a>(
        &'a self,
        scene: &'a Scene,
        point: Vec3,
    ) -> impl Iterator<Item = (u32, LightSample)> + 'a {
        self.names().filter_map(move |i| Some((i, named_sample(scene, i, point)?)))
    }

    /// The numbers of the lights that have names in [`crate::scene::SceneParts::lights`].
    pub(in crate::transport) fn names(&self) -> impl Iterator<Item = u32> + '_ {
        let some = if self.has_named() { &self.emitters[self.triangle_count..] } else { &[] };
        some.iter().filter_map(|emitter| match emitter {
            Emitter::Analytic(i) => Some(*i),
            Emitter::Triangle(_) | Emitter::Environment => None,
        })
    }

    /// Share of the sky among samples of what is not named, where that is not all.
    fn sky_share(&self) -> f64 {
        let near = if self.triangle_count > 0 { self.near.sum_of_first(self.triangle_count) } else { 0.0 };
        match (near > 0.0, self.environment.is_some()) {
            (_, false) => 0.0,
            (false, true) => 1.0,
            (true, true) => {
                let sky = self.distant.total() * self.distant.probability(self.distant_count() - 1);
                f64::from(((sky / (sky + near)) as f32).clamp(DISTANT_SHARE.0, DISTANT_SHARE.1))
            }
        }
    }

    /// A direction in which light that is not named arrives, as [`Self::sample_towards`]. Where lamps without area hang
    /// among those with one, some samples choose what is named and count as zero. `visible`: what is known of how much of the
    /// sky is seen.
    pub fn sample_unnamed(
        &self,
        scene: &Scene,
        at: &Receiver,
        (u_choice, u): (f64, [f32; 2]),
        visible: Option<&VisibleSky>,
    ) -> Option<LightSample> {
        if !self.has_named() {
            return self.sample_towards(scene, at, (u_choice, u), visible);
        }
        let share = self.sky_share();
        let (sample, probability) = if u_choice < share {
            (self.sample_environment(scene, at, u, visible)?, share)
        } else {
            let (i, of_tree) = self.tree.choose(at, (u_choice - share) / (1.0 - share))?;
            let Emitter::Triangle(t) = self.emitters[i] else { return None };
            (sample_triangle(scene, t, at.point, u)?, (1.0 - share) * of_tree)
        };
        let sample = LightSample { pdf: (f64::from(sample.pdf) * probability) as f32, ..sample };
        let usable = sample.pdf > 0.0
            && sample.pdf.is_finite()
            && sample.radiance.is_finite()
            && sample.radiance.max_element() > 0.0;
        usable.then_some(sample)
    }

    /// Density per solid angle with which [`Self::sample_unnamed`] draws the unit direction `wi`, where a ray along it
    /// ends at `hit`, or in the environment. 0 where that is no light.
    pub fn pdf_unnamed(
        &self,
        scene: &Scene,
        at: &Receiver,
        (wi, hit): (Vec3, Option<&Hit>),
        visible: Option<&VisibleSky>,
    ) -> f32 {
        if !self.has_named() {
            return self.pdf_towards(scene, at, (wi, hit), visible);
        }
        let Some(emitter) = self.met(scene, hit) else { return 0.0 };
        let (density, probability) = match (emitter, hit) {
            (Emitter::Triangle(t), Some(hit)) => {
                let Some(place) = self.place(emitter) else { return 0.0 };
                let [a, b, c] = scene.mesh.corners(hit.triangle);
                let end = a * (1.0 - hit.b1 - hit.b2) + b * hit.b1 + c * hit.b2;
                let density = self.triangle_density(scene, at, t, wi, end.distance(at.point));
                (density, (1.0 - self.sky_share()) * self.tree.probability(place, at))
            }
            _ => (f64::from(self.environment_pdf(scene, at, wi, visible)), self.sky_share()),
        };
        let pdf = (density * probability) as f32;
        if pdf.is_finite() { pdf } else { 0.0 }
    }
}
