//! Irradiance at points by unbiased paths: what a bake is measured against.

use glam::Vec3;
use rayon::prelude::*;

use super::atlas::Atlas;
use crate::image::luminance;
use crate::rng::Stream;
use crate::transport::gather::{Gather, Trust};
use crate::transport::interaction::Interaction;
use crate::transport::light::Lights;
use crate::transport::medium::Media;

use super::Irradiance;
use crate::geometry::{Accel, Hit, Ray};
use crate::scene::Scene;

/// A point of the front of a surface with its irradiance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferencePoint {
    /// Triangle.
    pub triangle: u32,
    /// Barycentric coordinate at its second corner.
    pub b1: f32,
    /// Barycentric coordinate at its third corner.
    pub b2: f32,
    /// Irradiance, W/m² per band.
    pub irradiance: Vec3,
    /// Variance of its luminance.
    pub variance: f32,
}

/// Irradiance on the front of about `count` elements of `atlas` that `counts` accepts, drawn in proportion to their
/// area, from `samples` paths each.
pub fn reference_points(
    (scene, accel, lights): (&Scene, &Accel, &Lights),
    atlas: &Atlas,
    counts: &dyn Fn(u32) -> bool,
    count: usize,
    samples: u32,
    seed: u64,
) -> Vec<ReferencePoint> {
    let elements: Vec<u32> = (0..atlas.elements.len() as u32)
        .filter(|&e| atlas.elements[e as usize].area > 0.0 && counts(e))
        .collect();
    let area: f64 = elements.iter().map(|&e| f64::from(atlas.elements[e as usize].area)).sum();
    // Systematic sampling: every step of the summed area takes one.
    let (mut chosen, mut sum, step) = (Vec::new(), 0.0, area / count.max(1) as f64);
    for e in elements {
        let before = (sum / step - 0.5).floor();
        sum += f64::from(atlas.elements[e as usize].area);
        if (sum / step - 0.5).floor() > before {
            chosen.push(e);
        }
    }
    chosen
        .par_iter()
        .map(|&e| {
            let element = &atlas.elements[e as usize];
            at_point(
                (scene, accel, lights),
                element.triangle,
                element.b1,
                element.b2,
                samples,
                crate::rng::hash(seed, e.into(), 0),
            )
        })
        .collect()
}

/// Irradiance on the front of one point, from `samples` paths.
pub fn at_point(
    (scene, accel, lights): (&Scene, &Accel, &Lights),
    triangle: u32,
    b1: f32,
    b2: f32,
    samples: u32,
    key: u64,
) -> ReferencePoint {
    let [a, b, c] = scene.mesh.corners(triangle);
    let normal = (b - a).cross(c - a).normalize_or_zero();
    let p = a * (1.0 - b1 - b2) + b * b1 + c * b2;
    let at = Interaction::at(scene, &Ray::new(p + normal, -normal), &Hit { t: 1.0, triangle, b1, b2 });
    let gather = Gather::new(scene, accel, lights, Trust::Nobody);
    let (mut sum, mut squares) = (glam::DVec3::ZERO, 0.0f64);
    for s in 0..samples {
        let value = gather.arriving(&at, Media::EMPTY, Stream::in_sequence(key, 1, s)).total();
        sum += value.as_dvec3();
        squares += f64::from(luminance(value)).powi(2);
    }
    let n = f64::from(samples.max(1));
    let irradiance = (sum / n).as_vec3();
    let variance = ((squares / n - f64::from(luminance(irradiance)).powi(2)) / n).max(0.0) as f32;
    ReferencePoint { triangle, b1, b2, irradiance, variance }
}

/// Root of the mean squared error of `found` against the reference, relative to the root mean square irradiance; the
/// variance that the reference itself has is taken off (it is an upper bound, as its samples are stratified).
pub fn relative_error(found: &dyn Irradiance, reference: &[ReferencePoint]) -> f64 {
    let (mut error, mut energy) = (0.0f64, 0.0f64);
    for t in reference {
        let e = found.irradiance(t.triangle, t.b1, t.b2, false);
        let difference = f64::from(luminance(e - t.irradiance));
        error += difference * difference - f64::from(t.variance);
        energy += f64::from(luminance(t.irradiance)).powi(2);
    }
    if energy > 0.0 { (error.max(0.0) / energy).sqrt() } else { 0.0 }
}
