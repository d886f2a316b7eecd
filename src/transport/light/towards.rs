//! Light samples for a surface: which light by what it may bring there, then a direction to it.
//!
//! Sky and suns stand beside the tree of all other lights with a fixed share, since nothing tells how much of their
//! light gets into a room. The sky is sampled by the cosine as well as by its radiance, so that the half of it below the
//! surface costs little.

use std::f32::consts::PI;

use glam::Vec3;

use super::sky::VisibleSky;
use super::{Emitter, LightSample, Lights, TriangleView, sample_analytic, sample_triangle};
use crate::geometry::Hit;
use crate::scene::{Scene, TriangleIndex};
use crate::transport::interaction::Interaction;

/// What light falls on: a point and the unit normal on the side that it falls on, the one whose cosine weighs it. No
/// light from behind is looked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Receiver {
    /// Position.
    pub point: Vec3,
    /// Unit normal.
    pub normal: Vec3,
}

impl From<&Interaction> for Receiver {
    fn from(at: &Interaction) -> Self {
        Self { point: at.position, normal: at.facing_shading() }
    }
}

impl Lights {
    /// A direction in which light arrives. `u_choice` chooses the light, `u` the direction; all uniform in [0, 1).
    ///
    /// `None` where the light that was chosen sends nothing there: that counts as a sample of zero. What stands in
    /// between is the caller's to test. `visible`: what is known of how much of the sky is seen.
    pub fn sample_towards(
        &self,
        scene: &Scene,
        at: &Receiver,
        (u_choice, u): (f64, [f32; 2]),
        visible: Option<&VisibleSky>,
    ) -> Option<LightSample> {
        Some(self.draw_towards(scene, at, (u_choice, u), visible)?.1)
    }

    /// Density per solid angle with which [`Self::sample_towards`] draws the unit direction `wi` for `at`, where a ray
    /// along it ends at `hit`, or in the environment. 0 where that is no light.
    pub fn pdf_towards(
        &self,
        scene: &Scene,
        at: &Receiver,
        (wi, hit): (Vec3, Option<&Hit>),
        visible: Option<&VisibleSky>,
    ) -> f32 {
        let Some(emitter) = self.met(scene, hit) else { return 0.0 };
        let distance = hit.map_or(f32::INFINITY, |hit| {
            let [a, b, c] = scene.mesh.corners(hit.triangle);
            (a * (1.0 - hit.b1 - hit.b2) + b * hit.b1 + c * hit.b2).distance(at.point)
        });
        self.density_towards(scene, at, emitter, (wi, distance), visible)
    }

    /// [`Self::sample_towards`], with the light.
    pub(in crate::transport) fn draw_towards(
        &self,
        scene: &Scene,
        at: &Receiver,
        (u_choice, u): (f64, [f32; 2]),
        visible: Option<&VisibleSky>,
    ) -> Option<(Emitter, LightSample)> {
        let share = f64::from(self.distant_share);
        let u_choice = u_choice.clamp(0.0, 1.0);
        let (emitter, probability) = if u_choice < share {
            let i = self.distant.sample(u_choice / share)?;
            (self.emitters[self.near_count + i], share * self.distant.probability(i))
        } else {
            let (i, of_tree) = self.tree.choose(at, (u_choice - share) / (1.0 - share))?;
            (self.emitters[i], (1.0 - share) * of_tree)
        };
        let sample = match emitter {
            Emitter::Triangle(t) => sample_triangle(scene, t, at.point, u),
            Emitter::Analytic(i) => sample_analytic(&scene.lights[i as usize], at.point),
            Emitter::Environment => self.sample_environment(scene, at, u, visible),
        }?;
        let sample = LightSample { pdf: (f64::from(sample.pdf) * probability) as f32, ..sample };
        let usable = sample.pdf > 0.0
            && sample.pdf.is_finite()
            && sample.radiance.is_finite()
            && sample.radiance.max_element() > 0.0;
        usable.then_some((emitter, sample))
    }

    /// The light that a ray found, at `hit` or in the environment; `None` where no sample is drawn there.
    pub(in crate::transport) fn met(&self, scene: &Scene, hit: Option<&Hit>) -> Option<Emitter> {
        let Some(hit) = hit else { return self.environment.is_some().then_some(Emitter::Environment) };
        let material = scene.mesh.materials[hit.triangle as usize].0 as usize;
        let emitter = Emitter::Triangle(hit.triangle);
        (scene.materials[material].is_emissive() && self.place(emitter).is_some()).then_some(emitter)
    }

    /// Whether a light has no area, so that no ray meets it.
    pub(in crate::transport) fn is_dirac(&self, emitter: Emitter) -> bool {
        matches!(emitter, Emitter::Analytic(_))
    }

    /// Whether there are lights without area.
    pub(in crate::transport) fn has_dirac(&self) -> bool {
        self.emitters.iter().any(|e| self.is_dirac(*e))
    }

    /// Whether a light is the environment or directional.
    pub(in crate::transport) fn is_distant(&self, emitter: Emitter) -> bool {
        self.place(emitter).is_some_and(|i| i >= self.near_count)
    }

    /// Place of a light among all.
    pub(super) fn place(&self, emitter: Emitter) -> Option<usize> {
        let triangle = |e: &Emitter| match e {
            Emitter::Triangle(t) => *t,
            Emitter::Analytic(_) | Emitter::Environment => u32::MAX,
        };
        match emitter {
            Emitter::Triangle(t) => {
                self.emitters[..self.triangle_count].binary_search_by_key(&t, triangle).ok()
            }
            Emitter::Analytic(_) | Emitter::Environment => {
                let at = self.emitters[self.triangle_count..].iter().position(|e| *e == emitter)?;
                Some(self.triangle_count + at)
            }
        }
    }

    /// Density per solid angle with which a sample for `at` is drawn that goes to a point of a light at `distance` along
    /// `wi`; for lights without area the probability of choosing them.
    pub(in crate::transport) fn density_towards(
        &self,
        scene: &Scene,
        at: &Receiver,
        emitter: Emitter,
        (wi, distance): (Vec3, f32),
        visible: Option<&VisibleSky>,
    ) -> f32 {
        let Some(place) = self.place(emitter) else { return 0.0 };
        let share = f64::from(self.distant_share);
        let probability = match place.checked_sub(self.near_count) {
            Some(i) => share * self.distant.probability(i),
            None => (1.0 - share) * self.tree.probability(place, at),
        };
        let density = match emitter {
            Emitter::Analytic(_) => 1.0,
            Emitter::Environment => f64::from(self.environment_pdf(scene, at, wi, visible)),
            Emitter::Triangle(t) => self.triangle_density(scene, at, t, wi, distance),
        };
        let pdf = (density * probability) as f32;
        if pdf.is_finite() { pdf } else { 0.0 }
    }

    /// Density per solid angle of a point of a triangle at `distance` along `wi`, before the choice of the light.
    pub(super) fn triangle_density(
        &self,
        scene: &Scene,
        at: &Receiver,
        triangle: TriangleIndex,
        wi: Vec3,
        distance: f32,
    ) -> f64 {
        match TriangleView::new(scene.mesh.corners(triangle), at.point) {
            None => 0.0,
            Some(TriangleView::Spherical(s)) => 1.0 / s.solid_angle,
            Some(TriangleView::Area { normal, area }) => {
                f64::from(distance).powi(2) / f64::from(area * normal.dot(wi).abs())
            }
        }
    }

    /// Density per solid angle of [`Self::sample_environment`], before the choice of the light.
    pub(super) fn environment_pdf(
        &self,
        scene: &Scene,
        at: &Receiver,
        wi: Vec3,
        visible: Option<&VisibleSky>,
    ) -> f32 {
        let (Some(environment), Some(d)) = (&scene.environment, &self.environment) else { return 0.0 };
        if let Some(visible) = visible {
            return visible.pdf((environment, d), at, wi);
        }
        let cosine = at.normal.dot(wi).max(0.0) / PI;
        if environment.map.is_none() { cosine } else { 0.5 * cosine + 0.5 * d.pdf(environment, wi) }
    }
}
