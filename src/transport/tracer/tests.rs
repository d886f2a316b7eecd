use super::*;
use crate::illumination::Uniform;
use crate::scene::metal_rough::MetalRough;
use crate::scene::test_scenes::white_metal_rough;
use crate::scene::{Coat, Light, Model, Reflectance};
use crate::transport::gather::{Gather, Trust};
use crate::transport::test_boxes::{Builder, glass, lambert, mean, rough};

struct Prepared {
    scene: Scene,
    accel: Accel,
    lights: Lights,
    illumination: Uniform,
}

impl Prepared {
    fn new(scene: Scene, irradiance: f32) -> Self {
        let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
        Self { scene, accel, lights, illumination: Uniform(Vec3::splat(irradiance)) }
    }

    fn tracer(&self, settings: Settings) -> Tracer<'_> {
        Tracer::new(&self.scene, &self.accel, &self.lights, &self.illumination, settings)
    }

    fn trace(&self, ray: Ray, n: u64, settings: Settings) -> (f64, f64) {
        let tracer = self.tracer(settings);
        let result = mean(n, |i| tracer.radiance(&ray, Stream::new(8, i, 0)));
        assert_eq!(tracer.broken_count(), 0);
        result
    }
}

/// Rays that decide nothing by chance.
const EXACT: Settings = Settings {
    glossy_samples: 4,
    light_samples: 2,
    max_depth: 64,
    min_contribution: 0.0,
    caustic_bound: f32::INFINITY,
};

fn white() -> Reflectance {
    Reflectance::constant(Vec3::ONE)
}

#[test]
fn a_mirror_shows_the_stored_illumination() {
    let mut b = Builder::default();
    let mirror = b.material(Model::Mirror { specular: Reflectance::constant(Vec3::splat(0.5)) });
    let wall = b.material(lambert(0.8));
    b.rectangle(Vec3::ZERO, Vec3::X * 9.0, Vec3::Y * 9.0, mirror);
    b.rectangle(Vec3::Z * 5.0, Vec3::Y * 9.0, Vec3::X * 9.0, wall);
    let p = Prepared::new(b.scene(), std::f32::consts::PI);
    let (value, error) = p.trace(Ray::new(Vec3::Z, Vec3::new(0.1, 0.2, -1.0)), 8, EXACT);
    assert!((value - 0.4).abs() < 1e-6 && error < 1e-6, "{value} ± {error}");
}

/// base + view_dependent is the whole radiance, bit for bit where nothing is left to chance.
#[test]
fn the_two_parts_add_up() {
    for model in [
        lambert(0.7),
        Model::Mirror { specular: white() },
        glass(1.5, 0.9, false),
        glass(1.5, 0.9, true),
        Model::Plastic { albedo: Reflectance::constant(Vec3::splat(0.6)), coat: Coat::new(1.5, rough(0.0)) },
    ] {
        let mut b = Builder::default();
        let material = b.material(model.clone());
        b.sphere(Vec3::ZERO, 1.0, 16, material);
        let p = Prepared::new(b.under_sky(Vec3::new(0.5, 1.0, 2.0)), 2.0);
        let tracer = p.tracer(Settings { min_contribution: 1e-3, ..EXACT });
        let ray = Ray::new(Vec3::new(0.2, 0.3, -3.0), Vec3::Z);
        let hit = p.accel.intersect(&p.scene, &ray).expect("the sphere");
        let at = Interaction::at(&p.scene, &ray, &hit);
        let stream = Stream::new(1, 2, 3);
        let base = tracer.base(&at.point(), || at);
        let sum = base + tracer.view_dependent(&at, base, stream);
        let whole = tracer.radiance(&ray, stream);
        assert!((sum - whole).abs().max_element() <= 1e-5 * whole.max_element(), "{model:?}: {sum} {whole}");
        assert_eq!(tracer.view_dependent(&at, base, stream), tracer.view_dependent(&at, base, stream));
    }
}

/// The tracer agrees with the path tracer where the stored illumination is that of the sky.
#[test]
fn agrees_with_the_path_tracer_in_a_furnace() {
    for model in [
        Model::Mirror { specular: white() },
        glass(1.5, 1.0, false),
        glass(1.5, 1.0, true),
        Model::Dielectric { ior: 1.5, transmittance: Vec3::ONE, thin: false, roughness: rough(0.2) },
        Model::Metal { specular: white(), roughness: rough(0.3) },
        Model::Plastic { albedo: white(), coat: Coat::new(1.5, rough(0.1)) },
        Model::Ward {
            diffuse: Reflectance::constant(Vec3::splat(0.3)),
            specular: Reflectance::constant(Vec3::splat(0.6)),
            roughness: rough(0.2),
        },
    ] {
        let mut b = Builder::default();
        let material = b.material(model.clone());
        b.sphere(Vec3::ZERO, 1.0, 24, material);
        let p = Prepared::new(b.under_sky(Vec3::ONE), std::f32::consts::PI);
        let ray = Ray::new(Vec3::new(0.4, 0.3, -3.0), Vec3::Z);
        let (a, ea) = p.trace(ray, 2000, Settings::default());
        let paths = Gather::new(&p.scene, &p.accel, &p.lights, Trust::Nobody);
        let (b, eb) = mean(8000, |i| paths.radiance(&ray, Stream::new(4, i, 0)));
        assert!((a - b).abs() < 4.0 * (ea + eb) + 0.01, "{model:?}: {a} ± {ea}, path {b} ± {eb}");
    }
}

/// Light samples, distributed rays and both together give the same picture of a light in a glossy floor.
#[test]
fn ways_to_find_a_light_agree() {
    let metal = |alpha| Model::Metal { specular: white(), roughness: rough(alpha) };
    let mixed = |metal, r| Model::MetalRough(Box::new(white_metal_rough(metal, r)));
    for model in [metal(0.05), metal(0.3), mixed(1.0, 0.3), mixed(0.5, 0.55)] {
        let mut b = Builder::default();
        let floor = b.material(model.clone());
        let light = b.emitter(lambert(0.0), Vec3::splat(3.0));
        b.rectangle(Vec3::ZERO, Vec3::X * 9.0, Vec3::Y * 9.0, floor);
        b.rectangle(Vec3::new(0.0, 2.0, 1.5), Vec3::Y * 0.5, Vec3::X * 0.5, light);
        let p = Prepared::new(b.scene(), 0.0);
        let ray = Ray::new(Vec3::new(0.0, -2.0, 1.5), Vec3::new(0.0, 2.0, -1.5));
        let settings = |light_samples| Settings { light_samples, ..Settings::default() };
        let without = p.trace(ray, 20_000, settings(0));
        let both = p.trace(ray, 20_000, settings(2));
        let more = p.trace(ray, 5000, Settings { glossy_samples: 1, ..settings(8) });
        for (name, other) in [("both", both), ("more light samples", more)] {
            let close = (without.0 - other.0).abs() < 4.0 * (without.1 + other.1);
            assert!(close && other.0 > 0.01, "{model:?}, {name}: {other:?} against {without:?}");
            assert!(other.1.is_finite());
        }
        assert!(both.1 < without.1, "light samples lower the error: {both:?} {without:?}");
    }
}

/// Roulette does not change the mean.
#[test]
fn roulette_keeps_the_mean() {
    let mut b = Builder::default();
    let glass = b.material(glass(1.5, 0.8, false));
    let wall = b.material(lambert(0.5));
    b.sphere(Vec3::ZERO, 1.0, 24, glass);
    b.cube(Vec3::ZERO, -4.0, wall);
    let p = Prepared::new(b.scene(), 1.0);
    let ray = Ray::new(Vec3::new(0.5, 0.3, -3.0), Vec3::Z);
    let (exact, _) = p.trace(ray, 1, Settings { min_contribution: 1e-5, ..EXACT });
    let (value, error) = p.trace(ray, 20_000, Settings { min_contribution: 0.2, ..EXACT });
    assert!((value - exact).abs() < 4.0 * error + 1e-4, "{value} ± {error}, not {exact}");
}

#[test]
fn glass_absorbs_by_the_way_through_it() {
    for (ior, expected) in [(1.0, 0.25), (1.5, 0.96 * 0.96 * 0.25 / (1.0 - (0.04f64 * 0.25).powi(2)))] {
        let mut b = Builder::default();
        let slab = b.material(glass(ior, 0.5, false));
        let wall = b.material(lambert(1.0));
        b.rectangle(Vec3::Z, Vec3::X * 50.0, Vec3::Y * 50.0, slab);
        b.rectangle(-Vec3::Z, Vec3::Y * 50.0, Vec3::X * 50.0, slab);
        b.rectangle(-Vec3::Z * 3.0, Vec3::X * 50.0, Vec3::Y * 50.0, wall);
        let p = Prepared::new(b.scene(), std::f32::consts::PI);
        let ray = Ray::new(Vec3::Z * 3.0, Vec3::NEG_Z);
        let (value, _) = p.trace(ray, 1, Settings { min_contribution: 1e-6, ..EXACT });
        assert!((value - expected).abs() < 1e-3 * expected, "ior {ior}: {value}, not {expected}");
    }
}

/// The guide through a slab is what crosses it straight, without what is reflected between its faces; that of a mirror
/// would be the mirror's sample, and below glass something diffuse ends it.
#[test]
fn guides_follow_the_lobe_of_most_weight() {
    let mut b = Builder::default();
    let slab = b.material(glass(1.5, 0.5, false));
    let wall = b.material(lambert(0.6));
    b.rectangle(Vec3::Z, Vec3::X * 50.0, Vec3::Y * 50.0, slab);
    b.rectangle(-Vec3::Z, Vec3::Y * 50.0, Vec3::X * 50.0, slab);
    b.rectangle(-Vec3::Z * 3.0, Vec3::X * 50.0, Vec3::Y * 50.0, wall);
    let p = Prepared::new(b.under_sky(Vec3::splat(7.0)), std::f32::consts::PI);
    let guide = |ray: &Ray| {
        let hit = p.accel.intersect(&p.scene, ray).expect("the slab");
        p.tracer(EXACT).guide(&Interaction::at(&p.scene, ray, &hit))
    };
    let through = guide(&Ray::new(Vec3::Z * 3.0, Vec3::NEG_Z));
    let expected = 0.96 * 0.96 * 0.25 * 0.6;
    assert!((through - expected).abs().max_element() < 1e-4, "{through}, not {expected}");
    // At a glancing angle most is reflected, from the sky.
    let ray = Ray::new(Vec3::new(-40.0, 0.0, 2.0), Vec3::new(40.0, 0.0, -1.0).normalize());
    let (glancing, whole) = (guide(&ray), p.trace(ray, 1, Settings { min_contribution: 1e-6, ..EXACT }).0);
    assert!(f64::from(glancing.y) > 0.8 * whole && f64::from(glancing.y) < whole, "{glancing} of {whole}");
}

/// Mirrors, panes, glass and smooth coats; nothing that is rough or diffuse, somewhere at least.
#[test]
fn sharp_is_what_is_smooth_everywhere() {
    let plastic = |alpha| Model::Plastic { albedo: white(), coat: Coat::new(1.5, rough(alpha)) };
    let varying = MetalRough { roughness_range: [0.0, 0.4], ..white_metal_rough(1.0, 0.0) };
    let of = [
        (Model::Mirror { specular: white() }, true),
        (Model::Metal { specular: white(), roughness: rough(0.0) }, true),
        (Model::MetalRough(Box::new(white_metal_rough(1.0, 0.0))), true),
        (glass(1.5, 1.0, false), true),
        (glass(1.5, 1.0, true), true),
        (plastic(0.0), true),
        (plastic(0.05), false),
        (Model::Metal { specular: white(), roughness: rough(0.3) }, false),
        (Model::MetalRough(Box::new(varying)), false),
        (lambert(0.5), false),
    ];
    let mut b = Builder::default();
    let expected: Vec<bool> = of.iter().map(|(_, expected)| *expected).collect();
    for (model, _) in of {
        b.material(model);
    }
    let scene = b.scene();
    let found: Vec<bool> =
        (0..expected.len() as u32).map(|m| guide::is_sharp(&scene, crate::scene::MaterialId(m))).collect();
    assert_eq!(found, expected);
}

/// A closed glass room ends every guide.
#[test]
fn guides_end_where_nothing_ends_them() {
    let mut b = Builder::default();
    for i in 0..20 {
        let shell = b.material(glass(1.2 + 0.01 * i as f32, 0.99, false));
        b.sphere(Vec3::ZERO, 3.0 - 0.1 * i as f32, 16, shell);
    }
    let p = Prepared::new(b.under_sky(Vec3::ONE), 1.0);
    for i in 0..200 {
        let ray = Ray::new(Vec3::new(0.014 * i as f32, 0.1, -9.0), Vec3::Z);
        let Some(hit) = p.accel.intersect(&p.scene, &ray) else { continue };
        let guide = p.tracer(EXACT).guide(&Interaction::at(&p.scene, &ray, &hit));
        assert!(guide.is_finite() && guide.min_element() >= 0.0 && guide.max_element() <= 1.0, "{guide}");
    }
}

/// Sixty glasses one inside the other, and two mirrors face to face, come to an end.
#[test]
fn nested_glass_and_facing_mirrors_end() {
    let mut b = Builder::default();
    for i in 0..60 {
        let shell = b.material(glass(1.2 + 0.01 * i as f32, 0.99, false));
        b.sphere(Vec3::ZERO, 1.0 - 0.015 * i as f32, 12, shell);
    }
    let p = Prepared::new(b.under_sky(Vec3::ONE), 0.0);
    for i in 0..50 {
        let x = i as f32 / 50.0;
        let (value, _) = p.trace(Ray::new(Vec3::new(x, 0.1, -3.0), Vec3::Z), 4, Settings::default());
        assert!(value.is_finite() && value >= 0.0);
    }
    let mut b = Builder::default();
    let mirror = b.material(Model::Mirror { specular: white() });
    b.cube(Vec3::ZERO, -1.0, mirror);
    let p = Prepared::new(b.scene(), 0.0);
    assert_eq!(p.trace(Ray::new(Vec3::ZERO, Vec3::new(0.3, 0.4, 1.0)), 4, EXACT).0, 0.0);
}

/// No ray gets out of a closed glass-filled room into the bright sky around it.
#[test]
fn closed_rooms_do_not_leak_at_any_scale() {
    for scale in [1e-4f32, 1.0, 1e4] {
        let mut b = Builder::default();
        let wall = b.material(Model::Metal { specular: white(), roughness: rough(0.5) });
        let ball = b.material(glass(1.5, 1.0, false));
        b.cube(Vec3::splat(scale), -scale, wall);
        b.sphere(Vec3::splat(scale), 0.5 * scale, 12, ball);
        let p = Prepared::new(b.under_sky(Vec3::splat(1e6)), 0.0);
        let tracer = p.tracer(Settings { light_samples: 0, ..Settings::default() });
        for i in 0..3000 {
            let mut s = Stream::new(6, i, 0);
            let direction = Vec3::new(s.next_f32(), s.next_f32(), s.next_f32()) - 0.5;
            let light = tracer.radiance(&Ray::new(Vec3::splat(0.2 * scale), direction), s);
            assert_eq!(light, Vec3::ZERO, "scale {scale}, ray {i}");
        }
    }
}

/// Choosing between reflection and refraction, at once or further on, gives the mean of following both, with the less
/// noise the less is left to chance.
#[test]
fn choosing_a_branch_keeps_the_mean() {
    let mut b = Builder::default();
    let ball = b.material(glass(1.5, 0.8, false));
    let wall = b.material(lambert(0.5));
    let lamp = b.emitter(lambert(0.0), Vec3::splat(5.0));
    b.sphere(Vec3::ZERO, 1.0, 24, ball);
    b.cube(Vec3::ZERO, -4.0, wall);
    b.rectangle(Vec3::new(0.0, 0.0, 3.9), Vec3::Y, Vec3::X, lamp);
    let p = Prepared::new(b.scene(), 1.0);
    let ray = Ray::new(Vec3::new(0.5, 0.3, -3.0), Vec3::Z);
    let (exact, _) = p.trace(ray, 1, Settings { min_contribution: 1e-5, ..EXACT });
    let mut last = f64::INFINITY;
    for min_contribution in [1.0, 0.05, 0.005] {
        let (value, error) = p.trace(ray, 20_000, Settings { min_contribution, ..EXACT });
        assert!(
            (value - exact).abs() < 4.0 * error + 1e-4,
            "{min_contribution}: {value} ± {error}, not {exact}"
        );
        assert!(error > 0.0, "chance decides nothing below {min_contribution}");
        assert!(
            error < 0.5 * last,
            "{min_contribution}: the noise is that of what is left to chance, {error}"
        );
        last = error;
    }
}

/// Being looked at changes no bit, and what the steps of a path add is what the sample shows.
#[test]
fn a_witness_sees_all_that_a_sample_is_made_of() {
    use super::witness::{Event, Scribe};
    let mut several = 0;
    for model in [
        Model::Mirror { specular: white() },
        glass(1.5, 0.9, false),
        Model::Dielectric { ior: 1.5, transmittance: Vec3::ONE, thin: false, roughness: rough(0.2) },
        Model::Metal { specular: white(), roughness: rough(0.3) },
        Model::Plastic { albedo: Reflectance::constant(Vec3::splat(0.6)), coat: Coat::new(1.5, rough(0.1)) },
    ] {
        let mut b = Builder::default();
        let material = b.material(model.clone());
        let light = b.emitter(lambert(0.0), Vec3::splat(3.0));
        b.sphere(Vec3::ZERO, 1.0, 16, material);
        b.rectangle(Vec3::new(0.0, 3.0, -2.0), Vec3::X * 1.5, Vec3::Z * 1.5, light);
        let p = Prepared::new(b.under_sky(Vec3::new(0.5, 1.0, 2.0)), 2.0);
        for i in 0..40 {
            let ray = Ray::new(Vec3::new(0.1 + 0.015 * i as f32, 0.3, -3.0), Vec3::Z);
            let hit = p.accel.intersect(&p.scene, &ray).expect("the sphere");
            let at = Interaction::at(&p.scene, &ray, &hit);
            let tracer = p.tracer(Settings::default());
            let stream = Stream::of_pixel(5, i, 9, 0);
            let base = tracer.base(&at.point(), || at);
            let seen = tracer.view_dependent(&at, base, stream);
            let told = tracer.told_to(Scribe::default());
            let again = told.view_dependent(&at, base, stream);
            assert_eq!(seen.to_array().map(f32::to_bits), again.to_array().map(f32::to_bits), "{model:?}");
            let path = told.into_witness().path();
            let added = path.added();
            let sum = added[0];
            assert!(
                (sum - seen).abs().max_element() <= 1e-4 * (1.0 + seen.max_element()),
                "{model:?}: {sum} of {seen}"
            );
            assert!(path.steps[1..].iter().zip(1..).all(|(s, number)| s.parent.is_some_and(|p| p < number)));
            several +=
                usize::from(path.steps.iter().filter(|s| matches!(s.event, Event::Lobe { .. })).count() > 1);
        }
    }
    assert!(several > 100, "{several}");
}

/// A map that knows a part of what named lights bring, and says so everywhere.
struct Coarse;

impl Irradiance for Coarse {
    fn irradiance(&self, _: u32, _: f32, _: f32, _: bool) -> Vec3 {
        Vec3::ONE
    }

    fn unnamed(&self, _: u32, _: f32, _: f32, _: bool) -> Unnamed {
        Unnamed { rest: Vec3::splat(0.2), named: Some(Vec3::splat(0.8)) }
    }
}

/// Where a surface is turned away from a named light no ray is needed, and what a map says of that light is not believed.
#[test]
fn what_faces_away_from_a_lamp_is_dark_without_a_ray() {
    let mut b = Builder::default();
    let mirror = b.material(Model::Mirror { specular: Reflectance::constant(Vec3::splat(0.02)) });
    let wall = b.material(lambert(0.5));
    b.rectangle(Vec3::ZERO, Vec3::X * 9.0, Vec3::Y * 9.0, mirror);
    b.rectangle(Vec3::new(0.0, 2.0, 0.0), Vec3::X * 9.0, Vec3::Z * 9.0, wall);
    let mut scene = b.scene();
    let ray = Ray::new(Vec3::new(0.0, -1.0, 1.0), Vec3::new(0.0, 1.0, -1.0));
    for (towards, expected) in [(-Vec3::Y, 0.2), (Vec3::Y, 1.0)] {
        scene.lights = vec![Light::Directional { direction: towards, irradiance: Vec3::splat(0.8) }];
        let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
        let tracer = Tracer::new(&scene, &accel, &lights, &Coarse, Settings::default());
        let expected = 0.02 * 0.5 * std::f32::consts::FRAC_1_PI * expected;
        for i in 0..100 {
            let found = tracer.radiance(&ray, Stream::new(4, i, 0)).x;
            assert!(
                (found - expected).abs() < 1e-6 * expected.max(1e-3),
                "{towards}: {found}, not {expected}"
            );
        }
    }
}

/// Shadow rays that would add next to nothing are traced now and then, and the mean stays: of light samples, and of lamps
/// that a map knows half of.
#[test]
fn shadow_rays_are_traced_where_they_count() {
    /// Light samples, and lamps left out.
    #[derive(Default)]
    struct Count(std::cell::Cell<(u64, u64)>);
    impl Witness for &Count {
        fn note(&self, event: impl FnOnce() -> Event, _: Vec3) {
            let (lights, left) = self.0.get();
            self.0.set(match event() {
                Event::Light { .. } => (lights + 1, left),
                Event::Roulette { survival, drawn } if drawn >= survival => (lights, left + 1),
                _ => (lights, left),
            });
        }
    }
    let mut b = Builder::default();
    let (wall, board) = (b.material(lambert(0.5)), b.material(lambert(0.0)));
    let black = Reflectance::constant(Vec3::ZERO);
    let floor = b.material(Model::Plastic { albedo: black, coat: Coat::new(1.5, rough(0.1)) });
    let lamp = b.emitter(lambert(0.0), Vec3::splat(2.0));
    b.rectangle(Vec3::ZERO, Vec3::X * 9.0, Vec3::Y * 9.0, floor);
    b.rectangle(Vec3::new(0.0, 2.0, 0.0), Vec3::X * 9.0, Vec3::Z * 9.0, wall);
    // Its shadow on the wall ends where the floor shows it.
    b.rectangle(Vec3::new(-4.0, 1.0, 2.0), Vec3::X * 4.0, Vec3::Z * 8.0, board);
    b.rectangle(Vec3::new(0.3, 0.5, 1.4), Vec3::Y * 0.1, Vec3::X * 0.1, lamp);
    let mut scene = b.scene();
    scene.lights = vec![Light::Directional { direction: Vec3::Y, irradiance: Vec3::ONE }];
    let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
    let ray = Ray::new(Vec3::new(0.0, -1.0, 1.0), Vec3::new(0.0, 1.0, -1.0));
    let traced = |min_contribution: f32| {
        let count = Count::default();
        let settings = Settings { min_contribution, ..EXACT };
        let tracer = Tracer::new(&scene, &accel, &lights, &Coarse, settings).told_to(&count);
        let found = mean(40_000, |i| tracer.radiance(&ray, Stream::new(2, i, 0)));
        (found, count.0.get())
    };
    let ((exact, sure), (lights_of_all, none_left)) = traced(0.0);
    assert!(exact > 0.002 && none_left == 0, "{exact} {none_left}");
    for min_contribution in [0.01, 0.1] {
        let ((value, error), (lights, left)) = traced(min_contribution);
        assert!((value - exact).abs() < 4.0 * (error + sure), "{value} ± {error}, not {exact} ± {sure}");
        assert!(
            10 * lights < 9 * lights_of_all && left > 20_000,
            "{lights} of {lights_of_all}, {left} left out"
        );
    }
}

/// One of several rays of a glossy lobe follows reflection or refraction, not both; in a furnace each of them brings the
/// same.
#[test]
fn rays_of_a_lobe_do_not_branch() {
    #[derive(Default)]
    struct Rays(std::cell::Cell<u64>);
    impl Witness for &Rays {
        fn open(&self, event: impl FnOnce() -> Event) {
            let glass = matches!(event(), Event::Lobe { delta: true, .. });
            self.0.set(self.0.get() + u64::from(glass));
        }
    }
    let mut b = Builder::default();
    let floor = b.material(Model::Metal { specular: white(), roughness: rough(0.02) });
    let slab = b.material(glass(1.5, 1.0, true));
    b.rectangle(Vec3::ZERO, Vec3::X * 9.0, Vec3::Y * 9.0, floor);
    b.rectangle(Vec3::new(0.0, 1.0, 0.0), Vec3::X * 9.0, Vec3::Z * 9.0, slab);
    let p = Prepared::new(b.under_sky(Vec3::ONE), 0.0);
    let ray = Ray::new(Vec3::new(0.0, -1.0, 1.0), Vec3::new(0.0, 1.0, -1.0));
    let (rays, n) = (Rays::default(), 2000);
    let tracer = p.tracer(Settings { light_samples: 0, ..EXACT }).told_to(&rays);
    let (value, error) = mean(n, |i| tracer.radiance(&ray, Stream::new(3, i, 0)));
    assert!((value - 1.0).abs() < 4.0 * error + 0.01, "{value} ± {error}");
    // A few directions of the lobe lie below the floor.
    let followed = rays.0.get();
    assert!(
        followed <= 4 * n && followed > 4 * n - n / 10,
        "{followed}: through the pane or back, for each of four"
    );
}
