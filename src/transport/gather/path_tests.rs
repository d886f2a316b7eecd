//! With no trust in any map: an unbiased path tracer.

use super::*;
use crate::math;
use crate::scene::{Coat, Distribution, Light, Model, Reflectance, Roughness};
use crate::transport::test_boxes::{Builder, glass, lambert, mean, rough};

fn nobody<'a>(scene: &'a Scene, accel: &'a Accel, lights: &'a Lights) -> Gather<'a> {
    Gather::new(scene, accel, lights, Trust::Nobody)
}

/// Mean radiance along `ray` and its standard error.
fn render(scene: &Scene, ray: Ray, n: u64) -> (f64, f64) {
    let (accel, lights) = (Accel::build(scene), Lights::build(scene));
    mean(n, |i| nobody(scene, &accel, &lights).radiance(&ray, Stream::new(5, i, 0)))
}

fn check((value, error): (f64, f64), expected: f64, what: &str) {
    assert!(
        (value - expected).abs() < 4.0 * error + 1e-3 * expected,
        "{what}: {value} ± {error}, not {expected}"
    );
}

/// A closed box that emits everywhere: irradiance M / (1 − ρ) (REFERENCE §6.6).
#[test]
fn closed_furnace() {
    for rho in [0.0f32, 0.5, 0.8] {
        let mut b = Builder::default();
        let wall = b.emitter(lambert(rho), Vec3::splat(FRAC_1_PI));
        b.cube(Vec3::ZERO, -1.0, wall);
        let scene = b.scene();
        let ray = Ray::new(Vec3::new(0.1, 0.2, -0.3), Vec3::new(0.3, 0.5, 1.0));
        check(render(&scene, ray, 20_000), f64::from(FRAC_1_PI / (1.0 - rho)), &format!("ρ {rho}"));
    }
}

/// A floor that sees only a unit square light at height 1 (REFERENCE §6.6).
#[test]
fn irradiance_under_a_square_light() {
    for (x, factor) in [(0.0, 0.239456), (0.25, 0.222966), (0.5, 0.180369), (1.0, 0.084354), (2.0, 0.013924)]
    {
        let mut b = Builder::default();
        let floor = b.material(lambert(0.5));
        let light = b.emitter(lambert(0.0), Vec3::ONE);
        b.rectangle(Vec3::ZERO, Vec3::X * 4.0, Vec3::Y * 4.0, floor);
        b.rectangle(Vec3::Z, Vec3::Y * 0.5, Vec3::X * 0.5, light);
        let scene = b.scene();
        let ray = Ray::new(Vec3::new(x, -0.9, 0.5), Vec3::new(0.0, 0.9, -0.5));
        // L = ρ / π · E with E = π F.
        check(render(&scene, ray, 20_000), 0.5 * factor, &format!("x {x}"));
    }
}

#[test]
fn a_lamp_is_dark_where_its_range_ends() {
    assert_eq!([0.0, 1.0, 2.0, 3.0].map(|d| Light::window(2.0, d)), [1.0, 15.0 / 16.0, 0.0, 0.0]);
    assert_eq!(Light::window(f32::INFINITY, 1e30), 1.0);
}

#[test]
fn point_spot_and_directional_lights() {
    let lights = [
        (Light::Point { position: Vec3::Z * 2.0, intensity: Vec3::ONE, range: f32::INFINITY }, 0.25),
        (
            Light::Spot {
                position: Vec3::Z * 2.0,
                direction: Vec3::NEG_Z,
                intensity: Vec3::ONE,
                inner: 0.2,
                outer: 0.4,
                range: f32::INFINITY,
            },
            0.25,
        ),
        (Light::Directional { direction: Vec3::new(0.0, 0.6, -0.8), irradiance: Vec3::ONE }, 0.8),
        // Half way to where it ends 1/16 is gone.
        (Light::Point { position: Vec3::Z * 2.0, intensity: Vec3::ONE, range: 4.0 }, 0.25 * 15.0 / 16.0),
    ];
    for (light, irradiance) in lights {
        let mut b = Builder::default();
        let floor = b.material(lambert(0.5));
        b.rectangle(Vec3::ZERO, Vec3::X, Vec3::Y, floor);
        let mut scene = b.scene();
        scene.lights = vec![light.clone()];
        let ray = Ray::new(Vec3::new(0.0, -0.5, 0.5), Vec3::new(0.0, 0.5, -0.5));
        check(render(&scene, ray, 200), 0.5 * irradiance / f64::from(PI), &format!("{light:?}"));
    }
}

fn models() -> Vec<(Model, bool)> {
    let white = Reflectance::constant(Vec3::ONE);
    let half = Reflectance::constant(Vec3::splat(0.5));
    let beckmann = Roughness { alpha_x: 0.3, alpha_y: 0.3, distribution: Distribution::Beckmann };
    let skewed = Roughness { alpha_x: 0.15, alpha_y: 0.4, distribution: Distribution::Beckmann };
    // With whether they lose nothing.
    vec![
        (lambert(1.0), true),
        (Model::Mirror { specular: white }, true),
        (glass(1.5, 1.0, false), true),
        (glass(1.0, 1.0, false), true),
        (glass(3.0, 1.0, false), true),
        (glass(1.5, 1.0, true), true),
        (Model::Dielectric { ior: 1.5, transmittance: Vec3::ONE, thin: false, roughness: rough(0.3) }, false),
        (Model::Metal { specular: white, roughness: rough(0.0) }, true),
        (Model::Metal { specular: white, roughness: rough(0.3) }, false),
        (Model::Metal { specular: white, roughness: rough(1.0) }, false),
        (Model::Conductor { eta: Vec3::splat(0.14), k: Vec3::splat(4.0), roughness: beckmann }, false),
        (Model::Plastic { albedo: white, coat: Coat::new(1.5, rough(0.0)) }, true),
        (Model::Plastic { albedo: half, coat: Coat::new(1.5, rough(0.2)) }, false),
        (Model::CookTorrance { diffuse: half, specular: half, roughness: beckmann }, false),
        (Model::Ward { diffuse: half, specular: half, roughness: skewed }, false),
    ]
}

/// A convex body under a uniform sky of radiance 1 can send back no more than 1, and exactly 1 where its
/// material loses nothing.
#[test]
fn nothing_reflects_more_than_arrives() {
    for (model, lossless) in models() {
        for target in [Vec3::ZERO, Vec3::new(0.0, 0.6, 0.0), Vec3::new(0.3, 0.86, 0.0)] {
            let mut b = Builder::default();
            let material = b.material(model.clone());
            b.sphere(Vec3::ZERO, 1.0, 24, material);
            let scene = b.under_sky(Vec3::ONE);
            let ray = Ray::new(Vec3::new(0.1, 0.05, -4.0), target - Vec3::new(0.1, 0.05, -4.0));
            let (value, error) = render(&scene, ray, 4000);
            let what = format!("{model:?} towards {target}: {value} ± {error}");
            assert!(value < 1.0 + 4.0 * error + 0.02, "{what}");
            assert!(value > 0.2, "{what}");
            if lossless {
                assert!(value > 1.0 - 4.0 * error - 0.02, "{what}");
            }
        }
    }
}

/// Nobody gains or loses by how light is found: a glossy floor under a square light, with light samples and,
/// where the light is a sky that fills all directions, by BSDF samples mostly.
#[test]
fn a_pane_lets_direct_light_through_attenuated() {
    let picture = |pane: Option<f32>| {
        let mut b = Builder::default();
        let floor = b.material(lambert(0.5));
        let light = b.emitter(lambert(0.0), Vec3::splat(10.0));
        b.rectangle(Vec3::ZERO, Vec3::X * 4.0, Vec3::Y * 4.0, floor);
        // Small and high: all light arrives nearly straight.
        b.rectangle(Vec3::Z * 20.0, Vec3::Y * 0.5, Vec3::X * 0.5, light);
        if let Some(tau) = pane {
            let pane = b.material(glass(1.5, tau, true));
            b.rectangle(Vec3::Z * 10.0, Vec3::X * 4.0, Vec3::Y * 4.0, pane);
        }
        let scene = b.scene();
        render(&scene, Ray::new(Vec3::new(0.0, -0.9, 0.5), Vec3::new(0.0, 0.9, -0.5)), 20_000)
    };
    let (open, _) = picture(None);
    for tau in [1.0f64, 0.5] {
        let expected = open * 0.96 * 0.96 * tau / (1.0 - 0.0016 * tau * tau);
        check(picture(Some(tau as f32)), expected, &format!("τ {tau}"));
    }
}

#[test]
fn broken_rays_and_empty_scenes_are_black() {
    let scene = Builder::default().scene();
    for direction in [Vec3::ZERO, Vec3::NAN, Vec3::INFINITY, Vec3::Z] {
        assert_eq!(render(&scene, Ray::new(Vec3::ZERO, direction), 4).0, 0.0);
    }
}

/// A wall in a glass block in which there is a bubble of denser glass: every stretch is absorbed by the glass that
/// it runs through, also the last one, after the bubble was left.
#[test]
fn nested_glasses_absorb_in_turn() {
    let mut b = Builder::default();
    let outer = b.material(glass(1.0, 0.5, false));
    let inner = b.material(glass(1.0, 0.25, false));
    let wall = b.emitter(lambert(0.0), Vec3::ONE);
    b.cube(Vec3::ZERO, 4.0, outer);
    b.cube(Vec3::ZERO, 0.5, inner);
    b.rectangle(Vec3::new(0.0, 0.0, -2.0), Vec3::X, Vec3::Y, wall);
    let value = render(&b.scene(), Ray::new(Vec3::new(0.1, 0.2, 9.0), Vec3::NEG_Z * 3.0), 2000);
    check(value, math::powf(0.5f64, 3.5) * 0.25 * math::powf(0.5f64, 1.5), "outer, inner, outer");
}

/// A white floor in a box of panes, in a furnace: light that passes panes is found by light samples, by
/// directions and after reflections inside, in total once.
#[test]
fn furnace_behind_panes() {
    let mut b = Builder::default();
    let pane = b.material(glass(1.5, 1.0, true));
    let floor = b.material(lambert(1.0));
    b.cube(Vec3::ZERO, 1.0, pane);
    b.rectangle(Vec3::new(0.0, -0.5, 0.0), Vec3::Z * 0.5, Vec3::X * 0.5, floor);
    let s = b.under_sky(Vec3::ONE);
    let target = Vec3::new(0.1, -0.5, 0.1);
    for eye in [Vec3::new(0.3, 0.4, 0.2), Vec3::new(0.3, 4.0, 0.2)] {
        check(render(&s, Ray::new(eye, target - eye), 20_000), 1.0, "white floor");
    }
}

/// The sun straight through the diagonal of a pane, where both of its triangles are hit: it is one pane.
#[test]
fn an_edge_inside_a_pane_filters_once() {
    let mut b = Builder::default();
    let pane = b.material(glass(1.5, 1.0, true));
    let floor = b.material(lambert(0.5));
    b.rectangle(Vec3::Z, Vec3::X, Vec3::Y, pane);
    b.rectangle(Vec3::ZERO, Vec3::X * 0.01, Vec3::Y * 0.01, floor);
    let mut scene = b.scene();
    scene.lights = vec![Light::Directional { direction: Vec3::NEG_Z, irradiance: Vec3::ONE }];
    let (value, _) = render(&scene, Ray::new(Vec3::new(0.0, -2.0, 0.5), Vec3::new(0.0, 2.0, -0.5)), 100);
    let expected = 0.5 * f64::from(FRAC_1_PI) * (1.0 - 2.0 * 0.04 / 1.04);
    // The pane's reflection of so small a floor adds next to nothing.
    assert!((value - expected).abs() < 2e-3 * expected, "{value}, not {expected}");
}
