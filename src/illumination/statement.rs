//! What is known of a map's error from points that it was not made of.
//!
//! Points are drawn by the pixels that they cover from cameras and along paths. At each, unbiased samples of irradiance,
//! with the map as the value of what is not followed, make four batches. With R their mean and v its variance from them,
//! `mean[(map − R)² − v]` is the squared error of the map without the noise of the samples, whatever the reason for it:
//! noise, kernels, resolution, light that is missing. Caustics of lights without area are found by no path
//! (`transport::gather`), so where there are any they count as an error of the map.

use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::Irradiance;
use crate::geometry::{Accel, Ray};
use crate::image::luminance;
use crate::rng::Stream;
use crate::scene::Scene;
use crate::transport::Indexed;
use crate::transport::bsdf::Bsdf;
use crate::transport::gather::{Trust, shown};
use crate::transport::interaction::Interaction;
use crate::transport::medium::Media;

/// Points that a statement is made of.
const POINTS: u32 = 1024;
/// Batches of a point's samples.
const BATCHES: u32 = 4;
/// Samples in each before the first statement; as long as their noise hides the error they double before the next.
const FIRST: u32 = 8;
/// Samples in each at most.
const MOST: u32 = 1024;
/// Samples added to each at a time.
const ADDED: u32 = 8;
/// Share of the squared error that doubt may have.
const DOUBTFUL: f64 = 0.3;
/// Points that are brighter than so many times the mean count as if they were not: beside a lamp everything is white.
const BRIGHT: f64 = 4.0;
/// Share of the mean irradiance of the scene below which a view is dark.
const DARK: f64 = 1e-2;
/// Surfaces that a look passes at most.
const PASSED_MAX: u32 = 16;
/// Standard errors at 95 % confidence, one-sided.
const Z_95: f64 = 1.65;
/// Sets these points apart from those of other seeds.
const TEST: u64 = 0x7e57;

/// Mean squared error of the luminance of irradiance, relative to its squared mean, and the standard error of that.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Statement {
    /// Without the samples' own noise; may be negative where that is all there is.
    pub squared: f64,
    /// Standard error.
    pub doubt: f64,
}

impl Statement {
    /// The error that there certainly is.
    pub fn at_least(&self) -> f32 {
        (self.squared - Z_95 * self.doubt).max(0.0).sqrt() as f32
    }

    /// The error that there is at most.
    pub fn at_most(&self) -> f32 {
        (self.squared + Z_95 * self.doubt).max(0.0).sqrt() as f32
    }
}

/// The first diffuse surface behind anything that is transparent.
fn diffuse_end(scene: &Scene, accel: &Accel, mut ray: Ray) -> Option<Interaction> {
    for _ in 0..PASSED_MAX {
        let hit = accel.intersect(scene, &ray)?;
        let at = Interaction::at(scene, &ray, &hit);
        if !at.material(scene).is_transparent() {
            return (at.point().diffuse_albedo(scene) != Vec3::ZERO).then_some(at);
        }
        (ray.t_min, ray.ignore) = (hit.t * (1.0 + 1e-5), hit.triangle);
    }
    None
}

/// A point that no map is made of.
#[derive(Clone, Debug)]
struct Held {
    at: Interaction,
    /// Irradiance straight from named lights, exactly: so displays show it.
    named: Vec3,
    /// Sums of the luminance of irradiance, by batch.
    sums: [f64; BATCHES as usize],
}

/// Points held back from a bake, with what samples say of them.
#[derive(Clone, Debug)]
pub struct HeldBack {
    seed: u64,
    points: Vec<Held>,
    /// Samples of each batch.
    taken: u32,
    wanted: u32,
}

/// What samples said, for going on later.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HeldBackState {
    sums: Vec<[f64; BATCHES as usize]>,
    taken: u32,
    wanted: u32,
}

impl HeldBack {
    /// Points of surfaces that cameras and paths see. None in scenes without cameras.
    pub fn new(indexed: Indexed<'_>, seed: u64) -> Self {
        /// The looks are square: only what they see counts.
        const SIDE: u32 = 1024;
        let cameras = indexed.scene.standpoints();
        let point = |i: u32| {
            let camera = cameras.get(i as usize % cameras.len().max(1))?;
            let [u, v] = Stream::new(seed ^ TEST, u64::from(i), 0).next_2d();
            let frame = camera.frame(SIDE, SIDE);
            let direction = frame.direction(u * SIDE as f32, v * SIDE as f32);
            let at = diffuse_end(indexed.scene, indexed.accel, Ray::new(frame.eye, direction))?;
            let named = indexed.gather(Trust::Nobody).named(&at, &Bsdf::at(indexed.scene, &at), Media::EMPTY);
            Some(Held { at, named, sums: [0.0; BATCHES as usize] })
        };
        let points = (0..POINTS).into_par_iter().filter_map(point).collect();
        Self { seed, points, taken: 0, wanted: FIRST }
    }

    /// Takes some of the samples that are wanted before the next statement, with `map` as the value of what they do not
    /// follow. Whether there are more.
    pub fn sample(
        &mut self,
        indexed: Indexed<'_>,
        map: &dyn Irradiance,
        is_wanted: &(dyn Fn() -> bool + Sync),
    ) -> bool {
        if self.taken >= self.wanted {
            return false;
        }
        let gather = indexed.gather(Trust::EndValue(map));
        let (seed, taken) = (self.seed ^ TEST, self.taken);
        self.points.par_iter_mut().enumerate().filter(|_| is_wanted()).for_each(|(i, point)| {
            for (batch, sum) in point.sums.iter_mut().enumerate() {
                for k in taken..taken + ADDED {
                    let numbers = Stream::in_sequence(seed, (i as u64) << 2 | batch as u64, k);
                    *sum += f64::from(luminance(gather.arriving(&point.at, Media::EMPTY, numbers).total()));
                }
            }
        });
        self.taken += ADDED;
        self.taken < self.wanted
    }

    /// The error of a map where it is seen, as far as the samples taken tell; `None` in scenes without cameras, without
    /// light, or where nothing diffuse is seen.
    /// More samples are wanted for the next statement where these leave it in doubt and `most` allows them.
    pub fn statement(&mut self, map: &dyn Irradiance, most: u64) -> Option<Statement> {
        let (batches, samples) = (f64::from(BATCHES), f64::from(self.taken.max(1)));
        let shows = |held: &Held| f64::from(luminance(shown(map, &held.at, held.named)));
        let bright = BRIGHT * self.points.iter().map(shows).sum::<f64>() / self.points.len().max(1) as f64;
        let found: Vec<(f64, f64)> = self
            .points
            .iter()
            .map(|held| {
                let means = held.sums.map(|sum| sum / samples);
                let mean = means.iter().sum::<f64>() / batches;
                let noise =
                    means.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / (batches * (batches - 1.0));
                let shown = shows(held);
                // Decided by the map alone, or the samples would choose what counts.
                let weight = if shown > bright { bright / shown } else { 1.0 };
                (weight * mean, weight * weight * ((shown - mean).powi(2) - noise))
            })
            .collect();
        let n = found.len() as f64;
        // In a view of next to nothing but darkness errors are told beside the light elsewhere.
        let elsewhere = map.stored().map_or(0.0, |s| f64::from(luminance(Vec3::from_array(s.summary.mean))));
        let mean = (found.iter().map(|f| f.0).sum::<f64>() / n).max(DARK * elsewhere);
        let squared = found.iter().map(|f| f.1).sum::<f64>() / n;
        let spread = found.iter().map(|f| (f.1 - squared).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
        let relative = |v: f64| v / (mean * mean);
        let statement = Statement { squared: relative(squared), doubt: relative((spread / n).sqrt()) };
        let allowed = u64::from(2 * self.wanted * BATCHES * POINTS) <= most;
        if allowed && statement.doubt > DOUBTFUL * statement.squared {
            self.wanted = (2 * self.wanted).min(MOST);
        }
        (n > 1.0 && statement.squared.is_finite() && statement.doubt.is_finite()).then_some(statement)
    }

    /// What samples said.
    pub fn state(&self) -> HeldBackState {
        let sums = self.points.iter().map(|p| p.sums).collect();
        HeldBackState { sums, taken: self.taken, wanted: self.wanted }
    }

    /// Goes on from a saved state. `false`, and nothing changed, if it is of other points.
    pub fn restore(&mut self, state: &HeldBackState) -> bool {
        if state.sums.len() != self.points.len() || state.wanted > MOST {
            return false;
        }
        self.points.iter_mut().zip(&state.sums).for_each(|(point, sums)| point.sums = *sums);
        (self.taken, self.wanted) = (state.taken, state.wanted);
        true
    }
}

/// The error of a map where it is seen; `None` where nothing can be said.
pub fn statement(indexed: Indexed<'_>, map: &dyn Irradiance, seed: u64) -> Option<Statement> {
    let mut held_back = HeldBack::new(indexed, seed);
    while held_back.sample(indexed, map, &|| true) {}
    held_back.statement(map, 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illumination::Uniform;
    use crate::scene::test_scenes::{add_box, grey, scene, with_camera};
    use crate::scene::{Material, Mesh, Reflectance};
    use crate::transport::light::Lights;

    /// The inside of a box that emits everywhere: E = π L / (1 − ρ), whatever is half of that is off by half.
    #[test]
    fn maps_are_stated_as_far_off_as_they_are() {
        let mut mesh = Mesh::default();
        add_box(&mut mesh, Vec3::ZERO, Vec3::ONE, 0, true);
        let wall = Material { emission: Reflectance::constant(Vec3::splat(0.3)), ..grey() };
        let scene = with_camera(scene(mesh, vec![wall]));
        let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
        let albedo = scene.materials[0].clone();
        let crate::scene::Model::Lambert { albedo } = albedo.model else { panic!("grey") };
        let exact = std::f32::consts::PI * 0.3 / (1.0 - albedo.color.x);
        let of = |share: f32| {
            let map = Uniform(Vec3::splat(share * exact));
            statement(Indexed { scene: &scene, accel: &accel, lights: &lights }, &map, 1).expect("points")
        };
        let (right, half, more) = (of(1.0), of(0.5), of(1.2));
        assert!(right.at_least() < 0.02 && right.at_most() < 0.1, "{right:?}");
        for (found, off) in [(half, 0.5), (more, 0.2)] {
            assert!(found.at_least() < off + 0.01 && found.at_most() > off - 0.01, "{found:?} {off}");
            assert!(found.at_least() > 0.8 * off, "{found:?} {off}");
        }
    }

    #[test]
    fn nothing_is_said_where_nothing_is_seen() {
        let scene = scene(Mesh::default(), vec![grey()]);
        let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
        assert_eq!(
            statement(Indexed { scene: &scene, accel: &accel, lights: &lights }, &Uniform(Vec3::ONE), 1),
            None
        );
    }
}
