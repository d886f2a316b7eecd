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
pub struct Truth {
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
pub fn truth(
    (scene, accel, lights): (&Scene, &Accel, &Lights),
    atlas: &Atlas,
    counts: &dyn Fn(u32) -> bool,
    count: usize,
    samples: u32,
    seed: u64,
) -> Vec<Truth> {
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
) -> Truth {
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
    Truth { triangle, b1, b2, irradiance, variance }
}

/// Root of the mean squared error of `found` against the truth, relative to the root mean square irradiance; the
/// variance that the truth itself has is taken off (it is an upper bound, as its samples are stratified).
pub fn relative_error(found: &dyn Irradiance, truth: &[Truth]) -> f64 {
    let (mut error, mut energy) = (0.0f64, 0.0f64);
    for t in truth {
        let e = found.irradiance(t.triangle, t.b1, t.b2, false);
        let difference = f64::from(luminance(e - t.irradiance));
        error += difference * difference - f64::from(t.variance);
        energy += f64::from(luminance(t.irradiance)).powi(2);
    }
    if energy > 0.0 { (error.max(0.0) / energy).sqrt() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::illumination::bake::{BakeSettings, Baker, Step};
    use crate::illumination::seen::in_sight;
    use crate::scene::load::load;
    use crate::scene::{Model, Reflectance};
    use crate::transport::Indexed;

    /// A bundled scene without what makes caustics, which are sharper than any kernel and noisy by paths: polished
    /// things lose their polish, mirrors, metal and thick glass are black, panes stay.
    fn without_caustics(name: &str) -> Scene {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("scenes/{name}/{name}.toml"));
        let mut scene = Scene::clone(&load(&path).expect("a scene").scene);
        for material in &mut scene.materials {
            let albedo = match &material.model {
                Model::Lambert { .. } | Model::Dielectric { thin: true, .. } => continue,
                Model::Plastic { albedo, .. } => *albedo,
                _ => Reflectance::constant(Vec3::ZERO),
            };
            material.model = Model::Lambert { albedo };
        }
        scene
    }

    /// Points of what is in sight, and how noisy they are, relative to what arrives.
    fn points_in_sight(
        world: (&Scene, &Accel, &Lights),
        baker: &Baker,
        count: usize,
        samples: u32,
    ) -> (Vec<Truth>, f64) {
        let counts = |e: u32| {
            let e = &baker.atlas().elements[e as usize];
            in_sight(world.0, world.1, e.position, e.normal)
        };
        let known = truth(world, baker.atlas(), &counts, count, samples, 1);
        let squares = |of: &dyn Fn(&Truth) -> f32| known.iter().map(|t| f64::from(of(t))).sum::<f64>();
        let noise = (squares(&|t| t.variance) / squares(&|t| luminance(t.irradiance).powi(2))).sqrt();
        (known, noise)
    }

    /// Sun and sky, spots and a lamp with cut-out leaves and screens before them: a short bake of each is as bright as
    /// paths say, and no further from them than it says itself.
    #[test]
    fn bundled_scenes_are_lit_as_paths_light_them() {
        for name in ["diffuse", "gallery", "duck"] {
            let scene = without_caustics(name);
            let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
            let indexed = Indexed { scene: &scene, accel: &accel, lights: &lights };
            let settings =
                BakeSettings { texels: 64 * 1024, error: None, particles: None, ..BakeSettings::default() };
            let mut baker = Baker::new(indexed, &settings);
            let (known, noise) = points_in_sight((&scene, &accel, &lights), &baker, 150, 1024);
            assert!(noise < 0.04, "{name}: {noise}");
            // One round of what the start view shows, and three of everything.
            for _ in 0..4 {
                while matches!(baker.step(indexed), Step::Going) {}
            }
            let map = baker.map().clone();
            let (error, stated) = (relative_error(&*map, &known), f64::from(map.summary.relative_error));
            assert!(error < 0.05, "{name}: {error} ± {noise}");
            assert!(stated >= 0.7 * error, "{name}: {error} ± {noise} stated as {stated}");
            let sum = |of: &dyn Fn(&Truth) -> Vec3| known.iter().map(|t| luminance(of(t))).sum::<f32>();
            let found = sum(&|t| map.irradiance(t.triangle, t.b1, t.b2, false));
            let ratio = found / sum(&|t| t.irradiance);
            assert!((ratio - 1.0).abs() < 0.02, "{name}: {ratio}");
        }
    }

    /// What is in sight of the box, shadows, corners and the lamp's own face included: within 1.5 % of paths after four
    /// rounds.
    #[test]
    fn the_box_is_lit_as_paths_light_it() {
        let scene = without_caustics("box");
        let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
        let indexed = Indexed { scene: &scene, accel: &accel, lights: &lights };
        let settings = BakeSettings { error: None, particles: None, ..BakeSettings::default() };
        let mut baker = Baker::new(indexed, &settings);
        // Errors below the noise of the truth cannot be told from none.
        let (known, noise) = points_in_sight((&scene, &accel, &lights), &baker, 200, 1024);
        assert!(noise < 0.02, "{noise}");
        // After the first round, the fourth and the sixth.
        let mut errors = Vec::new();
        for pass in 0..6 {
            while matches!(baker.step(indexed), Step::Going) {}
            if [0, 3, 5].contains(&pass) {
                let map = baker.map().clone();
                let (error, stated) = (relative_error(&*map, &known), f64::from(map.summary.relative_error));
                assert!(stated >= 0.7 * error, "{pass}: {error} ± {noise} stated as {stated}");
                errors.push(error);
            }
        }
        assert!(errors[1] < 0.015 && errors[1] < errors[0] && errors[2] < 0.015, "{errors:?}");
    }
}
