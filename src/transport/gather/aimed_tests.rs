use super::*;
use crate::illumination::{Irradiance, Uniform};
use crate::scene::{Distribution, Light, Model, Reflectance, Roughness, Scene};
use crate::transport::test_boxes::{Builder, glass, lambert, mean};

/// A map that says 100 on some triangles and 1 elsewhere.
struct Patches(Vec<u32>);

impl Irradiance for Patches {
    fn irradiance(&self, triangle: u32, _b1: f32, _b2: f32, _back: bool) -> Vec3 {
        Vec3::splat(if self.0.contains(&triangle) { 100.0 } else { 1.0 })
    }
}

/// A room of two lengths a side whose ceiling holds a small square: triangles 12 and 13.
fn room(square: f32) -> Builder {
    let mut b = Builder::default();
    let wall = b.material(lambert(0.6));
    b.cube(Vec3::ZERO, -1.0, wall);
    let patch = b.material(lambert(0.8));
    b.rectangle(Vec3::new(0.2, -0.1, 0.9), Vec3::Y * square, Vec3::X * square, patch);
    b
}

fn floor(scene: &Scene, accel: &Accel) -> Interaction {
    let ray = Ray::new(Vec3::new(-0.3, 0.2, 0.0), Vec3::new(0.1, 0.1, -1.0));
    Interaction::at(scene, &ray, &accel.intersect(scene, &ray).expect("the floor"))
}

/// Over all directions the density of aims is 1 where nothing hides what is aimed at.
#[test]
fn densities_of_aims_add_up() {
    let scene = room(0.25).scene();
    let (accel, map) = (Accel::build(&scene), Patches(vec![12, 13]));
    let bright = BrightSurfaces::new(&scene, &map);
    assert!(bright.share() > 0.1 && bright.share() <= 0.5, "{}", bright.share());
    let at = floor(&scene, &accel);
    let from = Receiver::from(&at);
    let bright_ones = std::cell::Cell::new(0);
    let (total, error) = mean(200_000, |i| {
        let local = cosine_hemisphere(Stream::new(1, i, 0).next_2d());
        let (x, y) = from.normal.any_orthonormal_pair();
        let wi = x * local.x + y * local.y + from.normal * local.z;
        let Some(hit) = accel.intersect(&scene, &at.spawn(wi)) else { return Vec3::ZERO };
        let pdf = bright.pdf(&scene, &from, wi, &hit, false);
        bright_ones.set(bright_ones.get() + u32::from(pdf > 0.0));
        Vec3::splat(pdf * PI / from.normal.dot(wi))
    });
    assert!((total - 1.0).abs() < 4.0 * error && error < 0.02, "{total} ± {error}");
    assert!((1_000..50_000).contains(&bright_ones.get()), "most of the room is dark: {bright_ones:?}");
    // Aims end where they are said to.
    for i in 0..1000 {
        let mut s = Stream::new(2, i, 0);
        let aim = bright.aim(&scene, &from, s.next_f64(), s.next_2d()).expect("a direction");
        let hit = accel.intersect(&scene, &at.spawn(aim.wi)).expect("a surface");
        assert_eq!((hit.triangle, aim.back), (aim.triangle, false));
        assert!(bright.pdf(&scene, &from, aim.wi, &hit, false) > 0.0);
    }
}

/// Wherever a map sends directions the mean stays; sent to where light comes from they save most of the noise.
#[test]
fn aims_change_the_noise_and_not_the_mean() {
    let mut b = room(0.1);
    let mirror = b.material(Model::Mirror { specular: Reflectance::constant(Vec3::splat(0.7)) });
    let ball = b.material(glass(1.5, 0.9, false));
    b.rectangle(Vec3::new(-0.9, 0.0, 0.0), Vec3::Y * 0.5, Vec3::Z * 0.5, mirror);
    b.sphere(Vec3::new(0.5, 0.5, -0.6), 0.3, 8, ball);
    let mut scene = b.scene();
    // Straight onto the square, and on nothing else.
    scene.lights = vec![Light::Spot {
        position: Vec3::new(0.2, -0.1, 0.5),
        direction: Vec3::Z,
        intensity: Vec3::splat(10.0),
        inner: 0.15,
        outer: 0.2,
        range: f32::INFINITY,
    }];
    let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
    let nothing = Uniform(Vec3::ZERO);
    let gather = Gather::new(&scene, &accel, &lights, Trust::EndValue(&nothing));
    for (target, pays) in [(Vec3::new(-0.2, 0.2, -1.0), true), (Vec3::new(0.5, 0.5, -0.6), false)] {
        let of = |gather: Gather<'_>| {
            let eye = Vec3::new(-0.5, -0.6, 0.1);
            mean(40_000, |i| gather.radiance(&Ray::new(eye, target - eye), Stream::new(5, i, 0)))
        };
        let (expected, noise) = of(gather);
        for (triangles, right) in [(vec![12, 13], true), (vec![0, 3], false), (vec![14], false)] {
            let bright = BrightSurfaces::new(&scene, &Patches(triangles.clone()));
            let (found, less) = of(gather.looking_for(&bright));
            assert!(
                (found - expected).abs() < 4.0 * (noise + less),
                "{triangles:?}: {found} ± {less}, not {expected} ± {noise}"
            );
            assert!(!(right && pays) || less < 0.7 * noise, "{less} beside {noise}");
        }
    }
}

/// A rough lobe sends light on as a diffuse surface does, so what shines by it alone is looked for, too; a narrow one keeps it
/// for who stands in the right place.
#[test]
fn what_shines_by_a_rough_lobe_is_looked_for() {
    for (alpha, looked_for) in [(0.3, true), (0.05, false)] {
        let mut b = Builder::default();
        let wall = b.material(lambert(0.6));
        b.cube(Vec3::ZERO, -1.0, wall);
        let metal = b.material(Model::CookTorrance {
            diffuse: Reflectance::constant(Vec3::splat(0.002)),
            specular: Reflectance::constant(Vec3::splat(0.7)),
            roughness: Roughness { alpha_x: alpha, alpha_y: alpha, distribution: Distribution::Ggx },
        });
        b.rectangle(Vec3::new(0.2, -0.1, 0.9), Vec3::Y * 0.1, Vec3::X * 0.1, metal);
        let mut scene = b.scene();
        scene.lights = vec![Light::Point {
            position: Vec3::new(0.2, -0.1, 0.86),
            intensity: Vec3::splat(0.1),
            range: f32::INFINITY,
        }];
        let bright = BrightSurfaces::new(&scene, &Patches(vec![12, 13]));
        assert_eq!(bright.share() > 0.0, looked_for, "{alpha}: {}", bright.share());
        let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
        let gather = Gather::new(&scene, &accel, &lights, Trust::Nobody).without_named();
        let of = |gather: Gather<'_>| {
            let at = floor(&scene, &accel);
            mean(40_000, |i| gather.arriving(&at, Media::EMPTY, Stream::new(5, i, 0)).soft)
        };
        let ((expected, noise), (found, less)) = (of(gather), of(gather.looking_for(&bright)));
        assert!(
            (found - expected).abs() < 4.0 * (noise + less),
            "{found} ± {less}, not {expected} ± {noise}"
        );
        assert!(!looked_for || less < 0.7 * noise, "{less} beside {noise}");
    }
}

/// An even map names nothing, nor does one of darkness, and then no number is drawn otherwise.
#[test]
fn where_nothing_is_bright_nothing_is_aimed_at() {
    let scene = room(0.25).scene();
    let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
    for light in [0.0, 1.0] {
        let bright = BrightSurfaces::new(&scene, &Uniform(Vec3::splat(light)));
        assert_eq!(bright.share(), 0.0);
        let gather = Gather::new(&scene, &accel, &lights, Trust::Nobody);
        assert!(gather.looking_for(&bright).bright.is_none());
    }
}

/// A closed room of albedo ½ in which the map knows of light that nothing else finds: E = U / (1 − ½), and a mirror without
/// loss shows it. Who looks straight at a wall sees nothing of it: particles bring that.
#[test]
fn light_that_no_path_finds_is_the_maps_behind_mirrors() {
    struct Unfound;
    impl Irradiance for Unfound {
        fn irradiance(&self, _triangle: u32, _b1: f32, _b2: f32, _back: bool) -> Vec3 {
            Vec3::splat(5.0)
        }
        fn unfound(&self, _triangle: u32, _b1: f32, _b2: f32, _back: bool) -> Vec3 {
            Vec3::splat(2.0)
        }
    }
    let mut b = Builder::default();
    let wall = b.material(lambert(0.5));
    let mirror = b.material(Model::Mirror { specular: Reflectance::constant(Vec3::ONE) });
    b.cube(Vec3::ZERO, -1.0, wall);
    b.rectangle(Vec3::Z * -0.9, Vec3::X * 0.5, Vec3::Y * 0.5, mirror);
    let scene = b.scene();
    let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
    let gather = Gather::new(&scene, &accel, &lights, Trust::EndValue(&Unfound));
    let of = |direction: Vec3| {
        mean(40_000, |i| gather.radiance(&Ray::new(Vec3::ZERO, direction), Stream::new(9, i, 0)))
    };
    let (found, error) = of(Vec3::new(0.2, 0.1, -1.0));
    let expected = f64::from(0.5 * FRAC_1_PI * 2.0 / (1.0 - 0.5));
    assert!(
        (found - expected).abs() < 4.0 * error && error < 0.05 * expected,
        "{found} ± {error}, not {expected}"
    );
    let (straight, error) = of(Vec3::new(0.2, 0.1, 1.0));
    assert!(straight.abs() < 4.0 * error + 1e-9, "{straight} ± {error}");
}
