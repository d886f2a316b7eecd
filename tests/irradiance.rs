//! Light that a bake keeps, at points of the bundled scenes, beside unbiased paths to the same points.

use foveal::geometry::Accel;
use foveal::illumination::Irradiance;
use foveal::illumination::bake::{BakeSettings, Baker, Step};
use foveal::illumination::reference::{ReferencePoint, reference_points, relative_error};
use foveal::illumination::seen::in_sight;
use foveal::image::luminance;
use foveal::scene::{Model, Reflectance, Scene};
use foveal::transport::Indexed;
use foveal::transport::light::Lights;
use foveal_files::load::load;
use glam::Vec3;

use crate::support::scene;

/// A bundled scene without what makes caustics, which are sharper than any kernel and noisy by paths: polished
/// things lose their polish, mirrors, metal and thick glass are black, panes stay.
fn without_caustics(name: &str) -> Scene {
    let mut scene = Scene::clone(&load(&scene(name)).expect("a scene").scene);
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
) -> (Vec<ReferencePoint>, f64) {
    let counts = |e: u32| {
        let e = &baker.atlas().elements[e as usize];
        in_sight(world.0, world.1, e.position, e.normal)
    };
    let known = reference_points(world, baker.atlas(), &counts, count, samples, 1);
    let squares = |of: &dyn Fn(&ReferencePoint) -> f32| known.iter().map(|t| f64::from(of(t))).sum::<f64>();
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
        // Three rounds of what the start view shows, and three of everything.
        for _ in 0..6 {
            while matches!(baker.step(indexed), Step::Going) {}
        }
        let map = baker.map().clone();
        let (error, stated) = (relative_error(&*map, &known), f64::from(map.summary.relative_error));
        assert!(error < 0.05, "{name}: {error} ± {noise}");
        assert!(stated >= 0.7 * error, "{name}: {error} ± {noise} stated as {stated}");
        let sum = |of: &dyn Fn(&ReferencePoint) -> Vec3| known.iter().map(|t| luminance(of(t))).sum::<f32>();
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
    // Errors below the noise of the reference cannot be told from none.
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
