//! Against the path tracer, in scenes of which both see all light.

use super::*;
use crate::scene::{Coat, Distribution, Roughness, Texture, TextureId, texture::MipChain};
use crate::transport::gather::{Gather, Trust};
use crate::transport::test_boxes::rough;

/// Batches by paths from the eye alone.
fn paths(scene: &Scene, view: View, samples: u64, seed: u64) -> Batches {
    let (accel, lights, frame) = (Accel::build(scene), Lights::build(scene), view.frame());
    let side = view.side as usize;
    let mut sums = BatchSums::new(side, side, BLOCK);
    for i in 0..samples {
        let rows: Vec<Vec<Vec3>> = (0..view.side)
            .into_par_iter()
            .map(|y| {
                let pixel = |x| {
                    let mut stream = Stream::of_pixel(seed, x, y, i);
                    let [dx, dy] = stream.next_2d();
                    let ray = Ray::new(frame.eye, frame.direction(x as f32 + dx, y as f32 + dy));
                    Gather::new(scene, &accel, &lights, Trust::Nobody).radiance(&ray, stream.split(0))
                };
                (0..view.side).map(pixel).collect()
            })
            .collect();
        sums.add(i, &Map2d::from_vec(side, side, rows.concat()));
    }
    sums.batches().expect("even batches")
}

/// Both find the same.
fn check(scene: &Scene, view: View, samples: [u64; 2], seeds: std::ops::Range<u64>, what: &str) {
    for seed in seeds {
        let (found, _) = estimate(scene, view, samples[0], seed);
        let known = paths(scene, view, samples[1], 100 + seed);
        let Some(z) = Agreement::new(&found, &known) else { panic!("{what}: nothing is seen") };
        assert!(z.holds(), "{what}, seed {seed}: {z:?}; {} and {}", total(&found), total(&known));
        assert!(found.relative_error() < 0.2, "{what}: {}", found.relative_error());
    }
}

/// A room with an area light and bodies of all kinds: cubes, and spheres whose smooth normals are far from those of
/// their facets.
fn room(models: &[Model]) -> Scene {
    let mut b = Builder::default();
    let wall = b.material(lambert(0.6));
    let light = b.emitter(lambert(0.3), Vec3::splat(4.0));
    b.cube(Vec3::ZERO, -1.0, wall);
    b.rectangle(Vec3::Z * 0.98, Vec3::Y * 0.6, Vec3::X * 0.6, light);
    for (i, model) in models.iter().enumerate() {
        let body = b.material(model.clone());
        let x = 1.2 * (i as f32 + 0.5) / models.len() as f32 - 0.6;
        b.sphere(Vec3::new(x, 0.0, -0.3), 0.3, 6, body);
        b.cube(Vec3::new(x, 0.5, -0.6), 0.2, body);
    }
    b.scene()
}

fn into_the_room() -> View {
    View::new(Vec3::new(0.1, -0.95, -0.1), Vec3::new(0.0, 0.2, -0.4), 1.1)
}

#[test]
fn diffuse_and_glossy_bodies() {
    let half = Reflectance::constant(Vec3::splat(0.5));
    let some = Reflectance::constant(Vec3::splat(0.3));
    let beckmann = Roughness { alpha_x: 0.3, alpha_y: 0.3, distribution: Distribution::Beckmann };
    let skewed = Roughness { alpha_x: 0.2, alpha_y: 0.5, distribution: Distribution::Beckmann };
    let kinds: [(&str, Vec<Model>); 3] = [
        ("diffuse", vec![lambert(0.8), lambert(0.2)]),
        (
            "metals",
            vec![
                Model::Metal { specular: half, roughness: rough(0.3) },
                Model::Conductor { eta: Vec3::splat(0.2), k: Vec3::splat(3.0), roughness: beckmann },
            ],
        ),
        (
            "coats",
            vec![
                Model::Plastic { albedo: half, coat: Coat::new(1.5, rough(0.3)) },
                Model::CookTorrance { diffuse: half, specular: some, roughness: beckmann },
                Model::Ward { diffuse: some, specular: half, roughness: skewed },
            ],
        ),
    ];
    for (name, models) in kinds {
        check(&room(&models), into_the_room(), [32, 128], 0..1, name);
    }
}

/// Dirac lobes: light of areas is found through and over them by both.
#[test]
fn mirrors_glass_and_smooth_coats() {
    let kinds: [(&str, Model); 4] = [
        ("mirror", Model::Mirror { specular: Reflectance::constant(Vec3::splat(0.9)) }),
        ("glass", glass(1.5, 0.4, false)),
        (
            "rough glass",
            Model::Dielectric {
                ior: 1.5,
                transmittance: Vec3::splat(0.4),
                thin: false,
                roughness: rough(0.3),
            },
        ),
        (
            "coat",
            Model::Plastic {
                albedo: Reflectance::constant(Vec3::splat(0.5)),
                coat: Coat::new(1.5, rough(0.0)),
            },
        ),
    ];
    for (name, model) in kinds {
        check(&room(&[model]), into_the_room(), [32, 512], 0..1, name);
    }
}

/// Sky, sun, lamp and spot outdoors behind panes that do not reflect, with a cut-out, a one-sided sheet and bumps.
#[test]
fn lights_without_area_panes_masks_and_bumps() {
    let mut b = Builder::default();
    let floor = b.material(lambert(0.7));
    let pane = b.material(glass(1.0, 0.5, true));
    let cut = b.material(lambert(0.5));
    let sheet = b.material(lambert(0.5));
    b.edit(cut).opacity_map = Some(TextureId(0));
    b.edit(sheet).two_sided = false;
    b.edit(floor).normal_map = Some(TextureId(1));
    b.rectangle(Vec3::ZERO, Vec3::X, Vec3::Y, floor);
    b.rectangle(Vec3::new(0.0, 0.9, 0.5), Vec3::X, Vec3::Z * 0.5, floor);
    b.rectangle(Vec3::new(0.5, 0.0, 0.6), Vec3::X * 0.4, Vec3::Y * 0.8, pane);
    b.rectangle(Vec3::new(-0.5, 0.2, 0.4), Vec3::X * 0.3, Vec3::Y * 0.3, cut);
    b.rectangle(Vec3::new(0.0, -0.4, 0.3), Vec3::X * 0.2, Vec3::Y * 0.2, sheet);
    let mut scene = b.scene();
    scene.mesh.uvs = scene.mesh.positions.iter().map(|p| glam::Vec2::new(p.x, p.y + p.z) * 2.0).collect();
    let holes = (0..64).map(|i| [1.0, 1.0, 1.0, if (i / 4 + i / 32) % 2 == 0 { 1.0 } else { 0.0 }]);
    let bumps = (0..64).map(|i| [[0.3, 0.5, 0.8, 1.0], [0.6, 0.7, 0.7, 1.0]][(i + i / 8) % 2]);
    scene.textures = vec![
        Texture::new("holes", MipChain::from_linear(8, 8, holes.collect())),
        Texture::new("bumps", MipChain::from_linear(8, 8, bumps.collect())),
    ];
    let sky = Map2d::from_fn(16, 8, |x, y| Vec3::splat(if (x, y) == (3, 2) { 5.0 } else { 0.3 }));
    scene.environment = Some(Environment { map: Some(sky), up: Vec3::Z, ..Environment::constant(Vec3::ONE) });
    scene.lights = vec![
        Light::Directional { direction: Vec3::new(0.3, 0.4, -1.0).normalize(), irradiance: Vec3::splat(0.8) },
        Light::Point {
            position: Vec3::new(0.4, 0.0, 0.9),
            intensity: Vec3::splat(0.3),
            range: f32::INFINITY,
        },
        Light::Spot {
            position: Vec3::new(-0.4, -0.4, 0.9),
            direction: Vec3::new(0.1, 0.3, -1.0).normalize(),
            intensity: Vec3::splat(0.4),
            inner: 0.3,
            outer: 0.6,
            range: f32::INFINITY,
        },
    ];
    let view = View::new(Vec3::new(0.0, -1.8, 1.2), Vec3::new(0.0, 0.1, 0.2), 0.9);
    check(&scene, view, [32, 128], 0..3, "outdoors");
}

/// Bodies in an even furnace, of which tests of one bounce see nothing: what normals far from the facets' lose or gain,
/// both find alike.
#[test]
fn tilted_normals_over_many_bounces() {
    let mut b = Builder::default();
    let wall = b.emitter(lambert(0.8), Vec3::splat(0.2));
    let light = b.emitter(lambert(0.0), Vec3::splat(3.0));
    for axis in 0..6 {
        let n = [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z][axis];
        let (u, v) = n.any_orthonormal_pair();
        let tilted = (n + 0.6 * u - 0.3 * v).normalize();
        b.surface(1, wall, |x, y| (u * (2.0 * x - 1.0) + v * (2.0 * y - 1.0) - n, tilted));
    }
    b.rectangle(Vec3::Z * 0.9, Vec3::Y * 0.3, Vec3::X * 0.3, light);
    let view = View::new(Vec3::new(0.1, -0.9, -0.1), Vec3::new(0.0, 0.2, -0.4), 1.1);
    check(&b.scene(), view, [32, 128], 0..3, "tilted");
}
