//! Closed forms. Blocks of a picture are held against them by their own noise.

mod against_paths;

use std::f32::consts::{FRAC_1_PI, PI};

use super::*;
use crate::metrics::{Agreement, BatchSums, Batches};
use crate::scene::test_scenes::white_metal_rough;
use crate::scene::{Camera, Environment, Light, Reflectance};
use crate::transport::test_boxes::{Builder, glass, lambert};

/// Pixels along an edge of a block.
const BLOCK: usize = 4;

/// A square picture.
#[derive(Clone, Copy)]
struct View {
    eye: Vec3,
    target: Vec3,
    fov: f32,
    side: u32,
}

impl View {
    fn new(eye: Vec3, target: Vec3, fov: f32) -> Self {
        Self { eye, target, fov, side: 32 }
    }

    fn frame(&self) -> CameraFrame {
        let across = (self.target - self.eye).any_orthonormal_vector();
        let camera = Camera { eye: self.eye, target: self.target, up: across, fov_y: self.fov };
        camera.frame(self.side, self.side)
    }
}

/// Batches by bidirectional paths; how much of it was merged, at the radius and at 1/√2 of it.
fn estimate(scene: &Scene, view: View, passes: u64, seed: u64) -> (Batches, [f64; 2]) {
    let (accel, lights, frame) = (Accel::build(scene), Lights::build(scene), view.frame());
    let paths = Bidirectional::new(scene, &accel, &lights, &frame);
    let side = view.side as usize;
    let (mut sums, mut merged) = (BatchSums::new(side, side, BLOCK), [0.0; 2]);
    for i in 0..passes {
        let mut pass = paths.pass(seed, i);
        for (pixel, found) in
            pass.connected.data_mut().iter_mut().zip(pass.merged.iter().flat_map(|m| m.data()))
        {
            *pixel += found[0];
            for (sum, found) in merged.iter_mut().zip(found) {
                *sum += f64::from(found.x) / (passes * u64::from(view.side * view.side)) as f64;
            }
        }
        sums.add(i, &pass.connected);
    }
    (sums.batches().expect("even batches"), merged)
}

/// A picture of one radiance.
fn even(view: View, radiance: f32) -> Batches {
    Batches::exact(&Map2d::new(view.side as usize, view.side as usize, Vec3::splat(radiance)), BLOCK)
}

fn assert_agree(found: &Batches, exact: &Batches, what: &str) {
    let Some(z) = Agreement::new(found, exact) else { panic!("{what}: nothing is seen") };
    assert!(z.holds(), "{what}: {z:?}; {} not {}", total(found), total(exact));
}

fn total(b: &Batches) -> f64 {
    b.statistics().map(|s| s.0).sum::<f64>() / b.means.len() as f64
}

/// Within a relative error of the mean, for what has hardly any noise.
fn assert_near(found: &Batches, expected: f64, relative: f64, what: &str) {
    let (mean, error) = (total(found), found.relative_error());
    assert!(
        (mean / expected - 1.0).abs() < relative + 4.0 * error / (found.means.len() as f64).sqrt(),
        "{what}: {mean}, not {expected}; blocks ± {error}"
    );
}

/// A closed box that emits everywhere: radiance M / π (1 − ρ) everywhere (REFERENCE §6.6).
#[test]
fn closed_furnace() {
    for (rho, seed) in [(0.5f32, 2), (0.7, 3), (0.7, 4), (0.7, 5)] {
        let mut b = Builder::default();
        let wall = b.emitter(lambert(rho), Vec3::splat(FRAC_1_PI));
        b.cube(Vec3::ZERO, -1.0, wall);
        let view = View::new(Vec3::new(0.1, 0.2, -0.3), Vec3::new(0.4, 0.7, 0.7), 1.2);
        let (found, _) = estimate(&b.scene(), view, 32, seed);
        assert_agree(&found, &even(view, FRAC_1_PI / (1.0 - rho)), &format!("ρ {rho}"));
        // A test that cannot fail would pass a percent less, too.
        if rho > 0.6 {
            let mut less = found.clone();
            less.means.as_flattened_mut().iter_mut().for_each(|m| *m *= 0.99);
            let z = Agreement::new(&less, &even(view, FRAC_1_PI / (1.0 - rho))).expect("blocks");
            assert!(!z.holds(), "{z:?}");
        }
    }
}

/// Bodies that lose nothing are not seen in a furnace, whatever light goes through them.
#[test]
fn furnace_with_mirrors_and_glass() {
    let white = Reflectance::constant(Vec3::ONE);
    for (i, model) in [
        Model::Mirror { specular: white },
        glass(1.5, 1.0, false),
        glass(1.5, 1.0, true),
        Model::Metal { specular: white, roughness: crate::transport::test_boxes::rough(0.0) },
    ]
    .into_iter()
    .enumerate()
    {
        let mut b = Builder::default();
        let wall = b.emitter(lambert(0.5), Vec3::splat(0.5));
        let body = b.material(model.clone());
        b.cube(Vec3::ZERO, -1.0, wall);
        b.cube(Vec3::new(0.3, 0.2, 0.4), 0.3, body);
        let view = View::new(Vec3::new(-0.6, -0.2, -0.7), Vec3::new(0.3, 0.2, 0.4), 1.0);
        let (found, _) = estimate(&b.scene(), view, 32, 40 + i as u64);
        assert_agree(&found, &even(view, 1.0), &format!("{model:?}"));
    }
}

/// Surfaces of glTF return what they get, too. What gives them back the light of single scattering, and the mean that the
/// light's factor is taken at, are not reciprocal, so particles and paths differ there, by less than a hundredth.
#[test]
fn a_furnace_with_metal_and_rough_dielectric() {
    for (i, (metal, r)) in
        [(0.0, 0.4), (0.5, 0.4), (1.0, 0.4), (0.0, 0.8), (1.0, 0.8)].into_iter().enumerate()
    {
        let mut b = Builder::default();
        let wall = b.emitter(lambert(0.5), Vec3::splat(0.5));
        let body = b.material(Model::MetalRough(Box::new(white_metal_rough(metal, r))));
        b.cube(Vec3::ZERO, -1.0, wall);
        b.cube(Vec3::new(0.3, 0.2, 0.4), 0.3, body);
        let view = View::new(Vec3::new(-0.6, -0.2, -0.7), Vec3::new(0.3, 0.2, 0.4), 0.5);
        let (found, _) = estimate(&b.scene(), view, 32, 60 + i as u64);
        assert_near(&found, 1.0, 0.01, &format!("m {metal}, r {r}"));
    }
}

/// A floor that sees only a unit square light at height 1 (REFERENCE §6.6).
#[test]
fn irradiance_under_a_square_light() {
    for (x, factor) in [(0.0, 0.239456), (0.5, 0.180369), (2.0, 0.013924)] {
        let mut b = Builder::default();
        let floor = b.material(lambert(0.5));
        let light = b.emitter(lambert(0.0), Vec3::ONE);
        b.rectangle(Vec3::ZERO, Vec3::X * 4.0, Vec3::Y * 4.0, floor);
        b.rectangle(Vec3::Z, Vec3::Y * 0.5, Vec3::X * 0.5, light);
        let view = View::new(Vec3::new(x, -0.9, 0.5), Vec3::X * x, 0.01);
        let (found, _) = estimate(&b.scene(), view, 32, 7);
        // L = ρ / π · E with E = π F.
        assert_near(&found, 0.5 * factor, 1e-3, &format!("x {x}"));
    }
}

/// The sun through one and two panes: 2R / (1 + R) of R = 0.04 is reflected.
#[test]
fn the_sun_through_panes() {
    let direction = Vec3::new(0.0, 0.0, -1.0);
    for panes in [0, 1, 2] {
        let mut b = Builder::default();
        let floor = b.material(lambert(0.5));
        let pane = b.material(glass(1.5, 1.0, true));
        b.rectangle(Vec3::ZERO, Vec3::X * 0.02, Vec3::Y * 0.02, floor);
        for i in 0..panes {
            b.rectangle(Vec3::Z * (1.0 + i as f32), Vec3::X, Vec3::Y, pane);
        }
        let mut scene = b.scene();
        scene.lights = vec![Light::Directional { direction, irradiance: Vec3::ONE }];
        let view = View::new(Vec3::new(0.0, -0.5, 0.5), Vec3::ZERO, 0.02);
        let (found, _) = estimate(&scene, view, 16, 3);
        // Light between two panes: 1 + r² + …, r = 2R / (1 + R).
        let r = 2.0 * 0.04 / 1.04;
        let through = [1.0, 1.0 - r, (1.0 - r) * (1.0 - r)][panes];
        assert_near(&found, 0.5 / f64::from(PI) * through, 2e-3, &format!("{panes} panes"));
        let more = [0.0, 0.0, (1.0 - r) * (1.0 - r) * (r * r / (1.0 - r * r))][panes];
        assert!(more < 0.006);
    }
}

/// A shading normal tilted by θ under a uniform sky: E = π (1 + cos θ) / 2, directions below the surface missing.
#[test]
fn tilted_normals_under_the_sky() {
    for tilt in [0.0f32, 0.3, 0.6] {
        let mut b = Builder::default();
        let floor = b.material(lambert(0.5));
        let normal = Vec3::new(math::sin(tilt), 0.0, math::cos(tilt));
        b.surface(1, floor, |u, v| (Vec3::new(u - 0.5, v - 0.5, 0.0) * 4.0, normal));
        let view = View::new(Vec3::Z * 2.0, Vec3::ZERO, 0.5);
        let (found, _) = estimate(&b.under_sky(Vec3::ONE), view, 32, 5);
        assert_near(&found, f64::from(0.25 * (1.0 + math::cos(tilt))), 1e-4, &format!("{tilt}"));
    }
}

/// A picture of the plane z = `height` without noise; `mirror` is the x of a mirror that it is seen in.
fn plane(view: View, height: f32, mirror: Option<f32>, radiance: impl Fn(Vec3) -> f32) -> Batches {
    const N: usize = 4;
    let (frame, side) = (view.frame(), view.side as usize);
    let picture = Map2d::from_fn(side, side, |x, y| {
        let part = |i: usize| (i as f32 + 0.5) / N as f32;
        let seen = (0..N * N).map(|i| {
            let d = frame.direction(x as f32 + part(i % N), y as f32 + part(i / N));
            let p = frame.eye + d * ((height - frame.eye.z) / d.z);
            radiance(Vec3::new(mirror.map_or(p.x, |m| 2.0 * m - p.x), p.y, p.z))
        });
        Vec3::splat(seen.sum::<f32>() / (N * N) as f32)
    });
    Batches::exact(&picture, BLOCK)
}

/// Irradiance by a lamp of intensity 1 on a plane that is `height` above it, `r` beside the foot.
fn by_lamp(height: f32, r: f32) -> f32 {
    height / math::powf(height * height + r * r, 1.5)
}

/// Albedo of a screen that sends next to nothing back.
const SCREEN: f32 = 1e-3;

/// A lamp over a mirror floor: a ceiling gets I / d² and ρ I / (d + 2h)² from its image, traced from the light.
#[test]
fn a_lamp_over_a_mirror() {
    let mut b = Builder::default();
    let mirror = b.material(Model::Mirror { specular: Reflectance::constant(Vec3::splat(0.8)) });
    let ceiling = b.material(lambert(SCREEN));
    b.rectangle(Vec3::ZERO, Vec3::X * 9.0, Vec3::Y * 9.0, mirror);
    b.rectangle(Vec3::Z * 2.0, Vec3::Y * 2.0, Vec3::X * 2.0, ceiling);
    let mut scene = b.scene();
    scene.lights = vec![Light::Point { position: Vec3::Z, intensity: Vec3::ONE, range: f32::INFINITY }];
    let view = View { side: 16, ..View::new(Vec3::new(0.3, 0.2, 0.5), Vec3::new(0.1, 0.0, 2.0), 0.9) };
    let (found, merged) = estimate(&scene, view, 800, 4);
    let exact = plane(view, 2.0, None, |p| {
        let r = p.truncate().length();
        SCREEN * FRAC_1_PI * (by_lamp(1.0, r) + 0.8 * by_lamp(3.0, r))
    });
    assert_agree(&found, &exact, "a lamp over a mirror");
    assert_eq!(merged, [0.0; 2]);
}

/// The light of a lamp in the focus of a paraboloid, on a plane across: E(r) = ρ I / (f² (1 + r²/4f²)²), beside what
/// arrives straight. Seen straight it is traced from the light; seen in a mirror it is merged.
#[test]
fn a_paraboloid_straight_and_in_a_mirror() {
    let scene = |mirror: Option<f32>| {
        let mut b = Builder::default();
        let reflector = b.material(Model::Mirror { specular: Reflectance::constant(Vec3::splat(0.9)) });
        let screen = b.material(lambert(SCREEN));
        let silver = b.material(Model::Mirror { specular: Reflectance::constant(Vec3::ONE) });
        b.surface(48, reflector, |u, v| {
            let (x, y) = (2.0 * u - 1.0, 2.0 * v - 1.0);
            (Vec3::new(x, y, 0.25 * (x * x + y * y)), Vec3::new(-0.5 * x, -0.5 * y, 1.0).normalize())
        });
        b.rectangle(Vec3::Z * 4.0, Vec3::Y, Vec3::X, screen);
        if let Some(x) = mirror {
            // Too small to send the lamp's light to the screen.
            b.rectangle(Vec3::new(x, 0.0, 1.917), Vec3::Z * 0.25, Vec3::Y * 0.25, silver);
        }
        let mut scene = b.scene();
        scene.lights = vec![Light::Point { position: Vec3::Z, intensity: Vec3::ONE, range: f32::INFINITY }];
        scene
    };
    let caustic = |p: Vec3| 0.9 / (1.0 + 0.25 * p.truncate().length_squared()).powi(2);
    let all = |p: Vec3| SCREEN * FRAC_1_PI * (by_lamp(3.0, p.truncate().length()) + caustic(p));
    let view = View { side: 16, ..View::new(Vec3::new(0.3, 0.2, 2.0), Vec3::new(0.2, 0.1, 4.0), 0.5) };
    let (found, merged) = estimate(&scene(None), view, 800, 4);
    assert_agree(&found, &plane(view, 4.0, None, all), "straight");
    assert_eq!(merged, [0.0; 2]);
    // The mirror's image of the screen.
    let view = View { side: 16, ..View::new(Vec3::new(1.8, 0.0, 1.5), Vec3::new(4.2, 0.0, 4.0), 0.2) };
    let (found, merged) = estimate(&scene(Some(2.2)), view, 800, 4);
    assert_agree(&found, &plane(view, 4.0, Some(2.2), all), "in a mirror");
    let layer = total(&plane(view, 4.0, Some(2.2), |p| SCREEN * FRAC_1_PI * caustic(p)));
    assert!((merged[0] / layer - 1.0).abs() < 0.02, "{merged:?}, {layer}");
    assert!((2.0 * (merged[0] - merged[1]) / layer).abs() < 0.02, "{merged:?}, {layer}");
}

/// A slab that does not bend light and lets τ per unit of length through: what arrives under it is τ^d, by particles,
/// for a lamp inside of it too, and through it to an eye inside.
#[test]
fn a_slab_absorbs_whoever_goes_through_it() {
    let tau = 0.5f32;
    for (lamp, eye) in [(2.0f32, 0.25f32), (0.75, 0.25), (2.0, 0.75)] {
        let mut b = Builder::default();
        let slab = b.material(glass(1.0, tau, false));
        let floor = b.material(lambert(SCREEN));
        b.rectangle(Vec3::Z, Vec3::X * 9.0, Vec3::Y * 9.0, slab);
        b.rectangle(Vec3::Z * 0.5, Vec3::Y * 9.0, Vec3::X * 9.0, slab);
        b.rectangle(Vec3::ZERO, Vec3::X * 3.0, Vec3::Y * 3.0, floor);
        let mut scene = b.scene();
        scene.lights =
            vec![Light::Point { position: Vec3::Z * lamp, intensity: Vec3::ONE, range: f32::INFINITY }];
        let at = Vec3::new(0.0, -0.3, eye);
        let view = View { side: 16, ..View::new(at, Vec3::new(0.05, -0.25, 0.0), 1.2) };
        // Lengths inside of the slab, along slanted ways.
        let inside = |from: Vec3, p: Vec3| (from.z.min(1.0) - 0.5).max(0.0) / from.z * from.distance(p);
        let exact = plane(view, 0.0, None, |p| {
            let light = by_lamp(lamp, p.truncate().length());
            let way = inside(Vec3::Z * lamp, p) + inside(at, p);
            SCREEN * FRAC_1_PI * light * math::powf(tau, way)
        });
        let (found, merged) = estimate(&scene, view, 800, 6);
        assert_agree(&found, &exact, &format!("lamp at {lamp}, eye at {eye}"));
        assert_eq!(merged[0] > 0.0, eye > 0.5);
    }
}

#[test]
fn threads_do_not_matter_and_nothing_panics_in_the_dark() {
    let mut b = Builder::default();
    let wall = b.emitter(lambert(0.5), Vec3::splat(0.3));
    b.cube(Vec3::ZERO, -1.0, wall);
    let scene = b.scene();
    let view = View::new(Vec3::ZERO, Vec3::ONE, 1.0);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| estimate(&scene, view, 16, 1).0)
    };
    assert_eq!(on(1), on(3));
    let mut empty = Builder::default().scene();
    assert_eq!(total(&estimate(&empty, view, 16, 1).0), 0.0);
    empty.environment = Some(Environment::constant(Vec3::ONE));
    assert!((total(&estimate(&empty, view, 16, 1).0) - 1.0).abs() < 1e-6);
}
