use std::f32::consts::PI;

use super::*;
use crate::math;
use crate::scene::{Camera, MaterialId, NamedCamera};
use crate::transport::Indexed;
use crate::transport::gather::Trust;
use crate::transport::light::Lights;
use crate::transport::medium::Media;
use crate::transport::test_boxes::{Builder, glass, lambert, mean};

/// A room of two lengths a side, seen from its middle, with a square window of `half` in the wall at x = 1.
fn room(half: f32, environment: Environment) -> Scene {
    let mut b = Builder::default();
    let wall = b.material(lambert(0.5));
    for (middle, a, c) in [
        (Vec3::NEG_X, Vec3::Y, Vec3::Z),
        (Vec3::Y, Vec3::Z, Vec3::X),
        (Vec3::NEG_Y, Vec3::X, Vec3::Z),
        (Vec3::Z, Vec3::X, Vec3::Y),
        (Vec3::NEG_Z, Vec3::Y, Vec3::X),
    ] {
        b.rectangle(middle, a, c, wall);
    }
    // Around the window.
    let (edge, rest) = (0.5 * (1.0 + half), 0.5 * (1.0 - half));
    for side in [-1.0, 1.0] {
        b.rectangle(Vec3::new(1.0, 0.0, side * edge), Vec3::Y, Vec3::Z * rest, wall);
        b.rectangle(Vec3::new(1.0, side * edge, 0.0), Vec3::Y * rest, Vec3::Z * half, wall);
    }
    let mut scene = b.scene();
    let camera = Camera { eye: Vec3::ZERO, target: Vec3::new(0.3, 0.0, -1.0), up: Vec3::Y, fov_y: 1.5 };
    scene.cameras = vec![NamedCamera { name: "main".into(), camera }];
    scene.environment = Some(environment);
    scene
}

fn spotted() -> Environment {
    let map = Map2d::from_fn(64, 32, |x, y| match (x, y) {
        (15..=17, 14) => Vec3::splat(90.0),
        (_, 0..16) => Vec3::splat(0.5),
        _ => Vec3::splat(0.1),
    });
    Environment { map: Some(map), ..Environment::constant(Vec3::ONE) }
}

fn floor(scene: &Scene, accel: &Accel) -> Interaction {
    let ray = Ray::new(Vec3::ZERO, Vec3::new(0.2, 0.1, -1.0));
    Interaction::at(scene, &ray, &accel.intersect(scene, &ray).expect("the floor"))
}

/// Its density adds up to 1 over all directions and is the one that its samples are drawn with, wherever one stands.
#[test]
fn densities_of_the_visible_sky_add_up() {
    for environment in [Environment::constant(Vec3::ONE), spotted()] {
        let scene = room(0.3, environment);
        let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
        let visible = lights.visible_sky(&scene, &accel).expect("a window");
        let sky = (scene.environment.as_ref().unwrap(), lights.environment.as_ref().unwrap());
        for at in [
            Receiver { point: Vec3::new(0.2, 0.1, -1.0), normal: Vec3::Z },
            Receiver { point: Vec3::new(-1.0, 0.3, 0.4), normal: Vec3::X },
            Receiver { point: Vec3::splat(1e6), normal: Vec3::NEG_Y },
        ] {
            let sphere = |i| {
                let [u, v] = Stream::new(3, i, 0).next_2d();
                let (z, phi) = (1.0 - 2.0 * v, 2.0 * PI * u);
                let r = (1.0 - z * z).max(0.0).sqrt();
                Vec3::splat(
                    4.0 * PI * visible.pdf(sky, &at, Vec3::new(r * math::cos(phi), r * math::sin(phi), z)),
                )
            };
            let (total, error) = mean(200_000, sphere);
            assert!((total - 1.0).abs() < 4.0 * error && error < 0.05, "{total} ± {error}");
            for i in 0..1000 {
                let Some((wi, pdf)) = visible.sample(sky, &at, Stream::new(4, i, 0).next_2d()) else {
                    panic!("none")
                };
                assert!((wi.length() - 1.0).abs() < 1e-5 && pdf > 0.0);
                let again = visible.pdf(sky, &at, wi);
                assert!((again - pdf).abs() <= 1e-3 * pdf, "{again} {pdf}");
            }
        }
    }
}

/// Known of the sky or not, the same light comes in, with a fraction of the noise; it is that of the window's form factor.
#[test]
fn samples_of_the_visible_sky_change_the_noise_and_not_the_mean() {
    for (environment, even) in [(Environment::constant(Vec3::ONE), true), (spotted(), false)] {
        let scene = room(0.2, environment);
        let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
        let indexed = Indexed { scene: &scene, accel: &accel, lights: &lights };
        let at = floor(&scene, &accel);
        let plain = indexed.gather(Trust::Nobody);
        let of = |gather: crate::transport::gather::Gather<'_>, seed| {
            mean(20_000, |i| gather.arriving(&at, Media::EMPTY, Stream::new(seed, i, 0)).sharp)
        };
        let ((a, error_a), (b, error_b)) = (of(plain, 1), of(plain.looking_out(), 2));
        assert!((a - b).abs() < 4.0 * math::hypot(error_a, error_b), "{a} ± {error_a}, {b} ± {error_b}");
        assert!(error_b < 0.5 * error_a, "{error_a} {error_b}");
        if even {
            // The window by strips that are small from here.
            let n = 400;
            let cell = |k: usize| 0.2 * (2.0 * (k as f64 + 0.5) / f64::from(n) - 1.0);
            let p = at.position.as_dvec3();
            let form: f64 = (0..n as usize * n as usize)
                .map(|k| {
                    let to = glam::DVec3::new(1.0, cell(k % n as usize), cell(k / n as usize)) - p;
                    to.x * to.z / to.length_squared().powi(2) * (0.4 / f64::from(n)).powi(2)
                })
                .sum();
            assert!((b - form).abs() < 4.0 * error_b, "{b} ± {error_b}, {form}");
        }
    }
}

/// Nobody looks where most is seen, where there is no sky, or nobody to see it.
#[test]
fn what_is_seen_of_the_sky_is_asked_only_where_it_helps() {
    let known = |scene: &Scene| {
        let (accel, lights) = (Accel::build(scene), Lights::build(scene));
        lights.visible_sky(scene, &accel).is_some()
    };
    let mut scene = room(0.2, spotted());
    assert!(known(&scene));
    scene.cameras.clear();
    assert!(!known(&scene), "no camera");
    let mut scene = room(0.2, spotted());
    scene.environment = None;
    assert!(!known(&scene), "no sky");
    let mut b = Builder::default();
    let ground = b.material(lambert(0.5));
    b.rectangle(Vec3::ZERO, Vec3::X, Vec3::Y, ground);
    let mut field = b.under_sky(Vec3::ONE);
    field.cameras = room(0.2, spotted()).cameras.clone();
    field.cameras[0].camera.eye = Vec3::Z;
    assert!(!known(&field), "a field");
    // Through a pane it is seen as through an opening; not through a wall.
    for (is_pane, seen) in [(true, true), (false, false)] {
        let mut b = Builder::default();
        let wall = b.material(lambert(0.5));
        let other = b.material(if is_pane { glass(1.5, 1.0, true) } else { lambert(0.5) });
        b.cube(Vec3::ZERO, -1.0, wall);
        let mut closed = b.under_sky(Vec3::ONE);
        // The first face of the cube.
        closed.mesh.materials[..2].fill(MaterialId(other));
        closed.cameras = room(0.2, spotted()).cameras.clone();
        assert_eq!(known(&closed), seen, "{is_pane}");
    }
}
