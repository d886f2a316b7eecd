//! What is known of a map's error from points that it was not made of.
//!
//! Points are drawn by the pixels that they cover from cameras and along paths. At each, unbiased samples of irradiance,
//! with the map as the value of what is not followed, make four batches. With R their mean and v its variance from them,
//! `mean[(map − R)² − v]` is the squared error of the map without the noise of the samples, whatever the reason for it:
//! noise, kernels, resolution, light that is missing. Caustics of lights without area are found by no path
//! (`transport::gather`), so where there are any they count as an error of the map.

use glam::Vec3;
use rayon::prelude::*;

use super::Irradiance;
use crate::geometry::{Accel, Ray};
use crate::image::luminance;
use crate::rng::Stream;
use crate::scene::{Camera, Scene};
use crate::transport::gather::{Gather, Trust};
use crate::transport::interaction::Interaction;
use crate::transport::light::Lights;
use crate::transport::medium::Media;

/// Points that a statement is made of.
const POINTS: u32 = 1024;
/// Batches of a point's samples.
const BATCHES: u32 = 4;
/// Samples in each.
const SAMPLES: u32 = 32;
/// Poses along each path.
const POSES: usize = 16;
/// Surfaces that a look passes at most.
const PASSED_MAX: u32 = 16;
/// Standard errors for certain: one side, 5 %.
const CERTAIN: f64 = 1.65;
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
        (self.squared - CERTAIN * self.doubt).max(0.0).sqrt() as f32
    }

    /// The error that there is at most.
    pub fn at_most(&self) -> f32 {
        (self.squared + CERTAIN * self.doubt).max(0.0).sqrt() as f32
    }
}

/// Where a walk may stand.
fn cameras(scene: &Scene) -> Vec<Camera> {
    let fov_y = scene.cameras.first().map_or(1.0, |c| c.camera.fov_y);
    let along = scene.paths.iter().flat_map(|path| {
        let pose = |i| path.at((i as f32 + 0.5) / POSES as f32 * path.duration(), scene.up, fov_y);
        (0..POSES).map(pose).collect::<Vec<Camera>>()
    });
    scene.cameras.iter().map(|c| c.camera).chain(along).collect()
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

/// The error of a map where it is seen; `None` in scenes without cameras, without light, or where nothing diffuse is seen.
pub fn statement(
    (scene, accel, lights): (&Scene, &Accel, &Lights),
    map: &dyn Irradiance,
    seed: u64,
) -> Option<Statement> {
    /// The looks are square: only what they see counts.
    const SIDE: u32 = 1024;
    let cameras = cameras(scene);
    let gather = Gather::new(scene, accel, lights, Trust::EndValue(map));
    let point = |i: u32| {
        let camera = cameras.get(i as usize % cameras.len().max(1))?;
        let mut stream = Stream::new(seed ^ TEST, u64::from(i), 0);
        let [u, v] = stream.next_2d();
        let frame = camera.frame(SIDE, SIDE);
        let direction = frame.direction(u * SIDE as f32, v * SIDE as f32);
        let at = diffuse_end(scene, accel, Ray::new(frame.eye, direction))?;
        let means = [0, 1, 2, 3].map(|batch| {
            let sample = |k| {
                let numbers = Stream::in_sequence(seed ^ TEST, u64::from(i) << 2 | batch, k);
                f64::from(luminance(gather.arriving(&at, Media::EMPTY, numbers).total()))
            };
            (0..SAMPLES).map(sample).sum::<f64>() / f64::from(SAMPLES)
        });
        let n = f64::from(BATCHES);
        let mean = means.iter().sum::<f64>() / n;
        let noise = means.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / (n * (n - 1.0));
        let shown = f64::from(luminance(map.irradiance(at.triangle, at.b1, at.b2, at.back)));
        Some((mean, (shown - mean).powi(2) - noise))
    };
    let found: Vec<(f64, f64)> = (0..POINTS).into_par_iter().filter_map(point).collect();
    let n = found.len() as f64;
    let mean = found.iter().map(|f| f.0).sum::<f64>() / n;
    let squared = found.iter().map(|f| f.1).sum::<f64>() / n;
    let spread = found.iter().map(|f| (f.1 - squared).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    let relative = |v: f64| v / (mean * mean);
    let statement = Statement { squared: relative(squared), doubt: relative((spread / n).sqrt()) };
    (n > 1.0 && statement.squared.is_finite() && statement.doubt.is_finite()).then_some(statement)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illumination::Uniform;
    use crate::scene::test_scenes::{add_box, grey, scene, with_camera};
    use crate::scene::{Material, Mesh, Reflectance};

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
        let truth = std::f32::consts::PI * 0.3 / (1.0 - albedo.color.x);
        let of = |share: f32| {
            let map = Uniform(Vec3::splat(share * truth));
            statement((&scene, &accel, &lights), &map, 1).expect("points")
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
        assert_eq!(statement((&scene, &accel, &lights), &Uniform(Vec3::ONE), 1), None);
    }
}
