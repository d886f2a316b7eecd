//! Closed forms.

use super::*;
use crate::scene::{Light, Reflectance};
use crate::transport::bsdf::fresnel;
use crate::transport::gather::{Gather, Trust};
use crate::transport::test_boxes::{Builder, glass, lambert, mean, rough};

const BOTH: [Class; 2] = [Class::All, Class::Unfound];

/// Irradiance by particles on what `of` says, as a share: of which area the deposit counts there.
fn irradiance(scene: &Scene, class: Class, runs: u64, of: impl Fn(Vec3) -> f64) -> f64 {
    let (accel, lights) = (Accel::build(scene), Lights::build(scene));
    let sources = Sources::new(scene, &accel, &lights, class);
    let particles = Caustics::new(scene, &accel, &lights, &sources);
    let (n, mut sum) = (runs * RUN, 0.0);
    for i in 0..n {
        particles.trace(3, i, &mut |d| {
            sum += f64::from(d.on(d.at.shading_normal).x) * of(d.at.position);
        });
    }
    sum / n as f64
}

fn assert_near(found: f64, expected: f64, within: f64, what: &str) {
    assert!((found / expected - 1.0).abs() < within, "{what}: {found}, not {expected}");
}

/// The mean of a function over the unit square about the middle.
fn mean_on_ceiling(value: impl Fn(f64) -> f64) -> f64 {
    let steps = 64;
    let at = |k: usize| (k as f64 + 0.5) / steps as f64 - 0.5;
    let squares = (0..steps * steps).map(|i| at(i % steps).powi(2) + at(i / steps).powi(2));
    squares.map(value).sum::<f64>() / (steps * steps) as f64
}

fn mirror(reflectance: f32) -> Model {
    Model::Mirror { specular: Reflectance::constant(Vec3::splat(reflectance)) }
}

/// So little that what is sent back is nothing, but something.
const DARK: f32 = 1e-4;

/// A dark square of half side `half` at `height`, which faces down.
fn ceiling(b: &mut Builder, height: f32, half: f32) {
    let dark = b.material(lambert(DARK));
    b.rectangle(Vec3::Z * height, Vec3::Y * half, Vec3::X * half, dark);
}

/// A lamp at height 1 over a mirror: the ceiling at height 2 sees its image at distance 3.
#[test]
fn a_lamp_over_a_mirror() {
    let mut b = Builder::default();
    let floor = b.material(mirror(0.8));
    b.rectangle(Vec3::ZERO, Vec3::X * 4.0, Vec3::Y * 4.0, floor);
    ceiling(&mut b, 2.0, 0.5);
    let mut scene = b.scene();
    scene.lights = vec![Light::Point { position: Vec3::Z, intensity: Vec3::ONE, range: f32::INFINITY }];
    for class in BOTH {
        let expected = mean_on_ceiling(|r2| 0.8 * 3.0 / (9.0 + r2).sqrt().powi(3));
        assert_near(irradiance(&scene, class, 32, |_| 1.0), expected, 0.02, "ceiling");
    }
}

/// The lamp in the focus of a paraboloid: E(r) = ρ I / (f² (1 + r²/4f²)²), f = 1.
#[test]
fn a_lamp_in_a_paraboloid() {
    let mut b = Builder::default();
    let reflector = b.material(mirror(0.9));
    b.surface(48, reflector, |u, v| {
        let (x, y) = (2.0 * u - 1.0, 2.0 * v - 1.0);
        (Vec3::new(x, y, 0.25 * (x * x + y * y)), Vec3::new(-0.5 * x, -0.5 * y, 1.0).normalize())
    });
    ceiling(&mut b, 4.0, 1.0);
    let mut scene = b.scene();
    scene.lights = vec![Light::Point { position: Vec3::Z, intensity: Vec3::ONE, range: f32::INFINITY }];
    let expected = |r2: f64| 0.9 / (1.0 + 0.25 * r2).powi(2);
    for (inner, outer) in [(0.0, 0.3), (0.3, 0.6), (0.6, 0.9)] {
        let in_ring = |p: Vec3| {
            let r = f64::from(p.truncate().length());
            if r >= inner && r < outer {
                1.0 / (expected(r * r) * std::f64::consts::PI * (outer * outer - inner * inner))
            } else {
                0.0
            }
        };
        for class in BOTH {
            assert_near(irradiance(&scene, class, 12, in_ring), 1.0, 0.01, &format!("{inner} to {outer}"));
        }
    }
}

/// Among all caustics those are told that no path finds: of lamps without area, over single directions first.
#[test]
fn what_no_path_finds_is_told_apart() {
    for (floor, is_lamp, expected) in
        [(mirror(0.8), true, true), (mirror(0.8), false, false), (glossy(0.05), true, false)]
    {
        let mut b = Builder::default();
        let floor = b.material(floor);
        b.rectangle(Vec3::ZERO, Vec3::X * 4.0, Vec3::Y * 4.0, floor);
        ceiling(&mut b, 2.0, 0.5);
        if !is_lamp {
            let lamp = b.emitter(lambert(0.0), Vec3::ONE);
            b.rectangle(Vec3::Z, Vec3::Y * 0.1, Vec3::X * 0.1, lamp);
        }
        let mut scene = b.scene();
        if is_lamp {
            scene.lights =
                vec![Light::Point { position: Vec3::Z, intensity: Vec3::ONE, range: f32::INFINITY }];
        }
        let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
        let sources = Sources::new(&scene, &accel, &lights, Class::All);
        let (mut count, mut unfound) = (0, 0);
        for i in 0..RUN {
            Caustics::new(&scene, &accel, &lights, &sources).trace(3, i, &mut |d| {
                count += 1;
                unfound += usize::from(d.is_unfound);
            });
        }
        assert!(count > 50 && unfound == if expected { count } else { 0 }, "{unfound} of {count}");
    }
}

fn glossy(alpha: f32) -> Model {
    Model::Metal { specular: Reflectance::constant(Vec3::ONE), roughness: rough(alpha) }
}

/// A slab that does not bend light and lets τ per unit of length through.
#[test]
fn light_through_a_slab() {
    let mut b = Builder::default();
    let slab = b.material(glass(1.0, 0.5, false));
    b.cube(Vec3::Z * 2.0, 0.5, slab);
    ceiling(&mut b, 4.0, 0.5);
    let mut scene = b.scene();
    scene.lights = vec![Light::Point { position: Vec3::ZERO, intensity: Vec3::ONE, range: f32::INFINITY }];
    for class in BOTH {
        let expected = mean_on_ceiling(|r2| {
            let distance = (16.0 + r2).sqrt();
            4.0 / distance.powi(3) * crate::math::powf(0.5, distance / 4.0)
        });
        assert_near(irradiance(&scene, class, 64, |_| 1.0), expected, 0.02, "behind the slab");
    }
}

/// The sun on a mirror, and nothing of what a pane only lets through.
#[test]
fn the_sun_on_mirrors_and_panes() {
    let pane = f64::from(fresnel::pane(std::f32::consts::FRAC_1_SQRT_2, 1.5, Vec3::ONE).0.x);
    for (model, expected) in [(mirror(0.8), 0.8), (glass(1.5, 1.0, true), pane)] {
        let mut b = Builder::default();
        let floor = b.material(model);
        b.rectangle(Vec3::ZERO, Vec3::X, Vec3::Y, floor);
        ceiling(&mut b, -1.0, 1.0);
        let dark = b.material(lambert(DARK));
        // Upright, so that the sun passes by.
        b.rectangle(Vec3::new(1.0, 0.0, 1.0), Vec3::Y, Vec3::Z, dark);
        let mut scene = b.scene();
        let direction = Vec3::new(1.0, 0.0, -1.0).normalize();
        scene.lights = vec![Light::Directional { direction, irradiance: Vec3::ONE }];
        let cosine = std::f64::consts::FRAC_1_SQRT_2;
        for class in BOTH {
            let wall = |p: Vec3| f64::from(u8::from(p.x > 0.99)) / 4.0;
            assert_near(irradiance(&scene, class, 4, wall), expected * cosine, 0.02, "wall");
            let below = irradiance(&scene, class, 4, |p| f64::from(u8::from(p.z < -0.5)));
            assert!(below < 10.0 * f64::from(DARK), "{below}");
        }
    }
}

/// What a glossy floor sends up is for paths to find, but for those who hold nothing else.
#[test]
fn gloss_belongs_to_one_class_only() {
    for (alpha, all) in [(0.05, true), (0.4, false)] {
        let mut b = Builder::default();
        let specular = Reflectance::constant(Vec3::ONE);
        let floor = b.material(Model::Metal { specular, roughness: rough(alpha) });
        b.rectangle(Vec3::ZERO, Vec3::X * 4.0, Vec3::Y * 4.0, floor);
        ceiling(&mut b, 2.0, 1.0);
        let mut scene = b.scene();
        scene.lights = vec![Light::Point { position: Vec3::Z, intensity: Vec3::ONE, range: f32::INFINITY }];
        assert_eq!(irradiance(&scene, Class::All, 1, |_| 1.0) > 0.0, all);
        let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
        assert!(!Sources::new(&scene, &accel, &lights, Class::Unfound).is_possible());
    }
}

/// A floor whose shading normal is tilted sees a lamp's image in a mirror above it.
#[test]
fn irradiance_is_that_of_the_shading_normal() {
    let normal = Vec3::new(0.4, 0.0, 1.0).normalize();
    let mut b = Builder::default();
    let above = b.material(mirror(1.0));
    b.rectangle(Vec3::Z, Vec3::Y * 2.0, Vec3::X * 2.0, above);
    let dark = b.material(lambert(DARK));
    b.surface(1, dark, |u, v| (Vec3::new(u - 0.5, v - 0.5, 0.0), normal));
    let mut scene = b.scene();
    scene.lights =
        vec![Light::Point { position: Vec3::new(1.5, 0.0, 0.5), intensity: Vec3::ONE, range: f32::INFINITY }];
    let image = Vec3::new(1.5, 0.0, 1.5);
    let (mut expected, steps) = (0.0, 64);
    for i in 0..steps * steps {
        let at = |k: usize| (k as f32 + 0.5) / steps as f32 - 0.5;
        let to = image - Vec3::new(at(i % steps), at(i / steps), 0.0);
        expected += f64::from(normal.dot(to.normalize()) / to.length_squared()) / (steps * steps) as f64;
    }
    assert_near(irradiance(&scene, Class::All, 32, |_| 1.0), expected, 0.02, "floor");
}

#[test]
fn without_lamps_or_mirrors_there_is_nothing_to_trace() {
    let possible = |model: Model, light: Option<Light>, class: Class| {
        let mut b = Builder::default();
        let floor = b.material(model);
        b.rectangle(Vec3::ZERO, Vec3::X, Vec3::Y, floor);
        let mut scene = b.scene();
        scene.lights = light.into_iter().collect();
        let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
        Sources::new(&scene, &accel, &lights, class).is_possible()
    };
    let lamp = Light::Point { position: Vec3::Z, intensity: Vec3::ONE, range: f32::INFINITY };
    for class in BOTH {
        assert!(possible(mirror(0.5), Some(lamp.clone()), class));
        assert!(!possible(mirror(0.5), None, class));
        assert!(!possible(lambert(0.5), Some(lamp.clone()), class));
    }
}

/// What shines under a sky sends on the same by particles and by paths.
#[test]
fn what_shines_under_a_sky_is_what_paths_leave_out() {
    for (model, name) in
        [(mirror(1.0), "mirror"), (glossy(0.03), "metal, 0.03"), (glossy(0.07), "metal, 0.07")]
    {
        let mut b = Builder::default();
        let floor = b.material(model);
        b.rectangle(Vec3::ZERO, Vec3::X * 3.0, Vec3::Y * 3.0, floor);
        ceiling(&mut b, 2.0, 1.0);
        let scene = b.under_sky(Vec3::ONE);
        let by_particles = irradiance(&scene, Class::All, 16, |p| if p.z > 1.9 { 0.25 } else { 0.0 });
        let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
        let gather = Gather::new(&scene, &accel, &lights, Trust::Nobody);
        let n = 1 << 16;
        let (by_paths, _) = mean(n, |i| {
            let mut stream = Stream::new(5, i, 0);
            let [u, v] = stream.next_2d();
            let from = Vec3::new(2.0 * u - 1.0, 2.0 * v - 1.0, 1.0);
            let ray = Ray::new(from, Vec3::Z);
            let at = Interaction::at(&scene, &ray, &accel.intersect(&scene, &ray).expect("the ceiling"));
            let all = gather.arriving(&at, Media::EMPTY, stream).total();
            let rest = gather.without_caustics().arriving(&at, Media::EMPTY, stream).total();
            all - rest
        });
        assert_near(by_particles, by_paths, 0.03, name);
    }
}
