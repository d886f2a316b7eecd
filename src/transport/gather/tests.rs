use super::*;
use crate::illumination::Uniform;
use crate::scene::texture::{MipChain, Texture};
use crate::scene::{Coat, Distribution, Light, Material, Model, Reflectance, Roughness, TextureId};
use crate::transport::test_boxes::{Builder, glass, lambert, mean, rough};

/// A map that says this everywhere.
fn uniform(irradiance: f32) -> Uniform {
    Uniform(Vec3::splat(irradiance))
}

/// The interaction of a ray's end.
fn hit_by(scene: &Scene, accel: &Accel, ray: &Ray) -> Interaction {
    let hit = accel.intersect(scene, ray).expect("a surface");
    Interaction::at(scene, ray, &hit)
}

/// Mean irradiance where `ray` ends, and its standard error, of `n` samples.
fn irradiance(scene: &Scene, trust: Trust<'_>, ray: &Ray, n: u64) -> (f64, f64) {
    let (accel, lights) = (Accel::build(scene), Lights::build(scene));
    let at = hit_by(scene, &accel, ray);
    let gather = Gather::new(scene, &accel, &lights, trust);
    mean(n, |i| gather.arriving(&at, Media::EMPTY, Stream::new(7, i, 0)).total())
}

fn check((value, error): (f64, f64), expected: f64, what: &str) {
    assert!(
        (value - expected).abs() < 4.0 * error + 1e-4 * expected,
        "{what}: {value} ± {error}, not {expected}"
    );
}

fn into_the_corner() -> Ray {
    Ray::new(Vec3::new(0.1, 0.2, -0.3), Vec3::new(0.3, 0.5, 1.0))
}

/// A closed box that emits everywhere: E = M / (1 − ρ) whatever the end value is, and without any noise but that of the
/// roulette of rounding where the end value is right.
#[test]
fn end_values_change_the_noise_and_not_the_mean() {
    let rho = 0.7;
    let expected = 1.0 / (1.0 - rho);
    let mut b = Builder::default();
    let wall = b.emitter(lambert(rho as f32), Vec3::splat(FRAC_1_PI));
    b.cube(Vec3::ZERO, -1.0, wall);
    let scene = b.scene();
    let of = |trust: Trust<'_>| irradiance(&scene, trust, &into_the_corner(), 20_000);
    let right = uniform(expected as f32);
    let (nothing, all, thrice) = (
        of(Trust::EndValue(&uniform(0.0))),
        of(Trust::EndValue(&right)),
        of(Trust::EndValue(&uniform(3.0 * expected as f32))),
    );
    for (found, what) in [(nothing, "0"), (all, "true"), (thrice, "3 × true"), (of(Trust::Nobody), "nobody")]
    {
        check(found, expected, what);
    }
    // A share of the light is counted by light samples beside directions, so each alone has noise; both together have
    // that of the geometry term only, which the first step shares with all end values.
    let [e0, e1, e3] = [nothing.1, all.1, thrice.1];
    assert!(e1 < 0.7 * e0 && e1 < e3, "{e0} {e1} {e3}");
    // Believed wholly, the map is right where it is.
    check(of(Trust::Map(&right)), expected, "map");
    let half = uniform(0.5 * expected as f32);
    check(of(Trust::Map(&half)), 1.0 + 0.7 * 0.5 * expected, "half of the map");
}

/// A room with a lamp, a mirror, a coated floor, a rough metal and a glass ball: a map that is wrong changes nothing.
#[test]
fn wrong_maps_leave_no_trace_among_all_kinds_of_surfaces() {
    let half = Reflectance::constant(Vec3::splat(0.5));
    let mut b = Builder::default();
    let wall = b.material(lambert(0.6));
    let lamp = b.emitter(lambert(0.0), Vec3::splat(4.0));
    let coated = b.material(Model::Plastic { albedo: half, coat: Coat::new(1.5, rough(0.1)) });
    let metal = b.material(Model::Metal { specular: half, roughness: rough(0.4) });
    let mirror = b.material(Model::Mirror { specular: half });
    let ball = b.material(glass(1.5, 0.9, false));
    b.cube(Vec3::ZERO, -2.0, wall);
    b.rectangle(Vec3::new(0.0, 0.0, 1.9), Vec3::Y, Vec3::X, lamp);
    b.rectangle(Vec3::new(0.0, 0.0, -1.9), Vec3::X * 1.9, Vec3::Y * 1.9, coated);
    b.rectangle(Vec3::new(-1.9, 0.0, 0.0), Vec3::Y * 1.5, Vec3::Z * 1.5, mirror);
    b.rectangle(Vec3::new(1.9, 0.0, 0.0), Vec3::Z * 1.5, Vec3::Y * 1.5, metal);
    b.sphere(Vec3::new(0.5, 0.5, -1.0), 0.5, 8, ball);
    let mut scene = b.scene();
    scene.lights = vec![Light::Point {
        position: Vec3::new(-0.5, 0.3, 1.0),
        intensity: Vec3::ONE,
        range: f32::INFINITY,
    }];
    let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
    let (nothing, much) = (uniform(0.0), uniform(9.0));
    for target in [Vec3::new(-0.8, -0.6, -1.9), Vec3::new(1.9, 0.2, 0.3), Vec3::new(0.4, 1.9, 0.2)] {
        let eye = Vec3::new(-0.9, -1.2, 0.2);
        let of = |trust: Trust<'_>| {
            let gather = Gather::new(&scene, &accel, &lights, trust);
            mean(30_000, |i| gather.radiance(&Ray::new(eye, target - eye), Stream::new(3, i, 0)))
        };
        let (a, e) = of(Trust::Nobody);
        for map in [&nothing, &much] {
            let (b, f) = of(Trust::EndValue(map));
            assert!((a - b).abs() < 4.0 * (e + f), "{target}: {a} ± {e}, with {map:?} {b} ± {f}");
        }
    }
}

/// As far as the next D point a sample says what it would with the map believed there, number by number; what lies beyond is
/// what that is off by.
#[test]
fn samples_tell_apart_what_lies_beyond_the_next_diffuse_surface() {
    let (rho, expected) = (0.7, 1.0 / 0.3);
    let mut b = Builder::default();
    let wall = b.emitter(lambert(rho), Vec3::splat(FRAC_1_PI));
    let mirror = b.material(Model::Mirror { specular: Reflectance::constant(Vec3::splat(0.5)) });
    b.cube(Vec3::ZERO, -1.0, wall);
    b.rectangle(Vec3::new(-0.9, 0.0, 0.0), Vec3::Y * 0.2, Vec3::Z * 0.2, mirror);
    let scene = b.scene();
    let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
    let at = hit_by(&scene, &accel, &into_the_corner());
    let map = uniform(0.5 * expected);
    let sample = |trust: Trust<'_>, i: u64| {
        Gather::new(&scene, &accel, &lights, trust).arriving(&at, Media::EMPTY, Stream::new(7, i, 0))
    };
    let mut missing = 0.0;
    for i in 0..4000 {
        let (near, all) = (sample(Trust::Map(&map), i), sample(Trust::EndValue(&map), i));
        assert_eq!((near.sharp, near.deep), (all.sharp, Vec3::ZERO));
        assert!((near.soft - all.soft).abs().max_element() < 1e-5, "{near:?} {all:?}");
        missing += f64::from(all.deep.x) / 4000.0;
    }
    // Half of the light of the walls times their albedo; a mirror is in the way now and then.
    assert!((missing / f64::from(0.5 * rho * expected) - 1.0).abs() < 0.1, "{missing}");
}

/// Half of a floor lies in the shadow of a board. What looks at it sees the shadow's edge where it is, however coarse the map
/// is that knows of it; a map that does not know what lamps bring is believed in all.
#[test]
fn maps_are_read_with_sharp_shadows() {
    struct Coarse;
    impl Irradiance for Coarse {
        fn irradiance(&self, _: u32, _: f32, _: f32, _: bool) -> Vec3 {
            Vec3::ONE
        }

        fn unnamed(&self, _: u32, _: f32, _: f32, _: bool) -> Unnamed {
            Unnamed { rest: Vec3::ZERO, named: Some(Vec3::ZERO) }
        }
    }
    let mut b = Builder::default();
    let [grey, black] = [0.5, 0.0].map(|albedo| b.material(lambert(albedo)));
    b.rectangle(Vec3::ZERO, Vec3::X, Vec3::Y, grey);
    b.rectangle(Vec3::new(-0.6, 0.0, 0.6), Vec3::X * 0.4, Vec3::Y, black);
    b.rectangle(Vec3::new(0.0, 0.0, 0.5), Vec3::Y * 0.01, Vec3::X * 0.01, black);
    let mut scene = b.scene();
    scene.lights = vec![Light::Directional { direction: -Vec3::Z, irradiance: Vec3::splat(2.0) }];
    let up = Ray::new(Vec3::new(0.0, 0.0, 0.1), Vec3::Z);
    let (expected, e) = irradiance(&scene, Trust::Nobody, &up, 20_000);
    let (found, f) = irradiance(&scene, Trust::Map(&Coarse), &up, 20_000);
    assert!(
        expected > 0.1 && (expected - found).abs() < 4.0 * (e + f),
        "{expected} ± {e}, not {found} ± {f}"
    );
    let (wrong, _) = irradiance(&scene, Trust::Map(&uniform(1.0)), &up, 20_000);
    assert!((expected - wrong).abs() > 8.0 * (e + f), "{wrong}");
}

/// A floor whose smooth normal is tilted sees the part of the sky above the floor: E = π (1 + cos θ) / 2.
#[test]
fn tilted_normals_see_what_is_above_the_surface() {
    for degrees in [0.0f32, 20.0, 30.0, 45.0] {
        let theta = degrees.to_radians();
        let mut b = Builder::default();
        let floor = b.material(lambert(0.5));
        b.rectangle(Vec3::ZERO, Vec3::X, Vec3::Y, floor);
        let mut scene = b.under_sky(Vec3::ONE);
        let tilted = Vec3::new(crate::math::sin(theta), 0.0, crate::math::cos(theta));
        scene.mesh.normals.fill(tilted);
        let down = Ray::new(Vec3::new(0.2, 0.3, 1.0), Vec3::NEG_Z);
        let expected = PI * (1.0 + crate::math::cos(theta)) / 2.0;
        for trust in [Trust::Nobody, Trust::EndValue(&uniform(1.0)), Trust::Map(&uniform(1.0))] {
            check(irradiance(&scene, trust, &down, 20_000), f64::from(expected), &format!("{degrees}°"));
        }
    }
}

/// White shows E / π, and light is known on black as well.
#[test]
fn black_and_white_texels_are_lit_alike() {
    let mut b = Builder::default();
    let floor = b.material(lambert(1.0));
    b.rectangle(Vec3::ZERO, Vec3::X, Vec3::Y, floor);
    let mut scene = b.under_sky(Vec3::ONE);
    let checker = (0..64).map(|i| [((i % 8 + i / 8) % 2) as f32; 4]).collect();
    scene.textures.push(Texture::new("checker", MipChain::from_linear(8, 8, checker)));
    let map = Some(TextureId(0));
    let albedo = Reflectance { color: Vec3::ONE, map };
    scene.materials[floor as usize] =
        Material { model: Model::Lambert { albedo }, ..scene.materials[floor as usize].clone() };
    scene.mesh.uvs =
        scene.mesh.positions.iter().map(|p| glam::Vec2::new(p.x + 1.0, p.y + 1.0) * 0.5).collect();
    let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
    let gather = Gather::new(&scene, &accel, &lights, Trust::Nobody);
    let mut shown = [0, 0];
    for i in 0..64 {
        let centre =
            Vec3::new((i % 8) as f32 + 0.45, (i / 8) as f32 + 0.5, 8.0) / 4.0 - Vec3::new(1.0, 1.0, 1.0);
        let ray = Ray::new(centre, Vec3::NEG_Z);
        let (e, _) = mean(16, |s| {
            gather.arriving(&hit_by(&scene, &accel, &ray), Media::EMPTY, Stream::new(1, i, s)).total()
        });
        assert!((e - f64::from(PI)).abs() < 1e-3, "{e}");
        let (radiance, _) = mean(16, |s| gather.radiance(&ray, Stream::new(1, i, s)));
        // Beside the middles of texels: from both triangles, and not from the edge between them.
        let albedo = f64::from(hit_by(&scene, &accel, &ray).point().diffuse_albedo(&scene).x);
        assert!((radiance - albedo * e / f64::from(PI)).abs() < 1e-3, "{radiance} {albedo}");
        shown[usize::from(albedo > 0.9)] += usize::from(!(0.1..0.9).contains(&albedo));
    }
    assert_eq!(shown, [32, 32]);
}

/// The sun through panes that it meets straight on, on a tilted black floor: (1 − R) / (1 + R) for each.
#[test]
fn panes_attenuate_named_lights_exactly() {
    for (panes, expected) in [(0, 1.0f64), (1, 0.923_077), (2, 0.852_071)] {
        let mut b = Builder::default();
        let floor = b.material(lambert(0.0));
        let pane = b.material(glass(1.5, 1.0, true));
        // Tilted by 60°.
        let across = Vec3::new(0.5, 0.0, 0.866_025_4);
        b.rectangle(Vec3::ZERO, across, Vec3::Y, floor);
        for i in 0..panes {
            b.rectangle(Vec3::Z * (3.0 + i as f32), Vec3::X * 9.0, Vec3::Y * 9.0, pane);
        }
        let mut scene = b.scene();
        scene.lights = vec![Light::Directional { direction: Vec3::NEG_Z, irradiance: Vec3::ONE }];
        let at = Ray::new(Vec3::new(-0.5, 0.1, 1.0), Vec3::new(0.5, 0.0, -1.0));
        let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
        let at = hit_by(&scene, &accel, &at);
        let light = Gather::new(&scene, &accel, &lights, Trust::Nobody).arriving(
            &at,
            Media::EMPTY,
            Stream::new(1, 2, 3),
        );
        assert!((f64::from(light.sharp.x) - 0.5 * expected).abs() < 1e-4, "{panes}: {light:?}");
        assert_eq!(light.soft, Vec3::ZERO);
    }
}

/// A lamp that shines on a mirror of reflectance ½: the ceiling receives what the lamp's image sends, by chance and once.
#[test]
fn what_mirrors_add_is_soft_and_found_once() {
    let mut b = Builder::default();
    let ceiling = b.material(lambert(0.0));
    let lamp = b.emitter(lambert(0.0), Vec3::ONE);
    let silver = b.material(Model::Mirror { specular: Reflectance::constant(Vec3::splat(0.5)) });
    b.rectangle(Vec3::Z * 2.0, Vec3::Y * 0.1, Vec3::X * 0.1, ceiling);
    b.rectangle(Vec3::new(2.0, 0.0, 1.0), Vec3::Y * 0.5, Vec3::X * 0.5, lamp);
    b.rectangle(Vec3::ZERO, Vec3::X * 20.0, Vec3::Y * 20.0, silver);
    let scene = b.scene();
    let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
    let at = hit_by(&scene, &accel, &Ray::new(Vec3::new(0.0, 0.0, 1.5), Vec3::Z));
    let gather = Gather::new(&scene, &accel, &lights, Trust::Nobody);
    let of = |part: fn(Arriving) -> Vec3| {
        mean(50_000, |i| part(gather.arriving(&at, Media::EMPTY, Stream::new(7, i, 0))))
    };
    assert_eq!(of(|a| a.sharp), (0.0, 0.0));
    // Parallel planes three apart: ∫ 9 / (x² + y² + 9)² over the image.
    let steps = |n: usize| (0..n).map(move |i| (i as f64 + 0.5) / n as f64 - 0.5);
    let image = steps(50).flat_map(|x| steps(50).map(move |y| (x + 2.0, y)));
    let received: f64 = image.map(|(x, y)| 9.0 / (x * x + y * y + 9.0).powi(2) / 2500.0).sum();
    check(of(|a| a.soft), 0.5 * received, "image");
}

/// A vertex has random numbers of its own: what one pixel shows depends on nothing else, so neither on who asks nor when.
#[test]
fn samples_are_functions_of_their_numbers() {
    use rayon::prelude::*;
    let mut b = Builder::default();
    let wall = b.emitter(lambert(0.7), Vec3::splat(0.2));
    let metal = Roughness { alpha_x: 0.2, alpha_y: 0.3, distribution: Distribution::Ggx };
    let metal = b.material(Model::Metal { specular: Reflectance::constant(Vec3::ONE), roughness: metal });
    b.cube(Vec3::ZERO, -1.0, wall);
    b.sphere(Vec3::new(0.4, 0.0, 0.3), 0.4, 8, metal);
    let scene = b.scene();
    let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
    let map = uniform(1.0);
    let gather = Gather::new(&scene, &accel, &lights, Trust::EndValue(&map));
    let of = |threads: usize| -> Vec<Vec3> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        let sample = |i: u64| gather.radiance(&into_the_corner(), Stream::new(5, i, 0));
        pool.install(|| (0..500).into_par_iter().map(sample).collect())
    };
    let alone = of(1);
    assert_eq!(alone, of(2));
    assert_eq!(alone, of(4));
    assert!(alone.iter().any(|v| *v != alone[0]));
}

/// Where walls are white light comes from everywhere, and a map that knows it saves most of the noise.
#[test]
fn a_good_map_saves_noise() {
    let mut b = Builder::default();
    let wall = b.material(lambert(0.8));
    let lamp = b.emitter(lambert(0.0), Vec3::splat(20.0));
    b.cube(Vec3::ZERO, -1.0, wall);
    b.rectangle(Vec3::Z * 0.9, Vec3::Y * 0.2, Vec3::X * 0.2, lamp);
    let scene = b.scene();
    let down = Ray::new(Vec3::ZERO, Vec3::new(0.3, 0.1, -1.0));
    let (value, error) = irradiance(&scene, Trust::Nobody, &down, 20_000);
    let about = uniform(0.8 * value as f32);
    let (same, less) = irradiance(&scene, Trust::EndValue(&about), &down, 20_000);
    assert!((value - same).abs() < 4.0 * (error + less), "{value} ± {error}, {same} ± {less}");
    assert!(less < 0.9 * error, "{less} {error}");
}

#[test]
fn broken_rays_are_black() {
    let scene = Builder::default().scene();
    let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
    let gather = Gather::new(&scene, &accel, &lights, Trust::Nobody);
    for direction in [Vec3::ZERO, Vec3::NAN, Vec3::INFINITY] {
        assert_eq!(gather.seen(&Ray::new(Vec3::ZERO, direction), 0.0, Stream::new(1, 1, 1)), Seen::default());
    }
}
