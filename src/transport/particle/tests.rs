//! Closed forms, and transport written from the definitions.

use super::*;
use crate::illumination::test_scenes::{cube, join, lambert, quad, scene};
use crate::math;
use crate::scene::texture::{MipChain, Texture};
use crate::scene::{Light, Reflectance, TextureId};

fn of_model(model: Model) -> Material {
    Material { model, ..lambert(0.0, 0.0) }
}

/// Irradiance by particles on the whole triangle `t`, and the number of deposits on it.
fn mean_on(transport: &dyn LightTransport, t: u32, area: f32, from_bounce: u32) -> Vec3 {
    let n = 200_000;
    let mut sum = glam::DVec3::ZERO;
    for i in 0..n {
        transport.trace(3, i, &mut |d| {
            if d.triangle == t && d.bounce >= from_bounce {
                sum += d.flux.as_dvec3();
            }
        });
    }
    (sum / (n as f64 * f64::from(area))).as_vec3()
}

#[test]
fn a_mirror_sends_a_caustic_that_direct_light_does_not_have() {
    // A point light at height 1 over a mirror floor; a ceiling at height 2 that faces down.
    let mut mesh = quad(Vec3::new(-20.0, 0.0, 20.0), Vec3::X * 40.0, Vec3::NEG_Z * 40.0);
    join(&mut mesh, &quad(Vec3::new(-0.1, 2.0, -0.1), Vec3::X * 0.2, Vec3::Z * 0.2), 1);
    let mirror = of_model(Model::Mirror { specular: Reflectance::constant(Vec3::splat(0.8)) });
    let light = Light::Point { position: Vec3::Y, intensity: Vec3::ONE };
    let hall = scene(mesh, vec![mirror, lambert(0.5, 0.0)], vec![light]);
    let (accel, lights) = (Accel::build(&hall), Lights::build(&hall));
    let transport = SceneTransport::new(&hall, &accel, &lights);
    // Straight: 1/1². By the mirror from the light's image: 0.8/3².
    let direct = transport.certain(2, 0.33, 0.33, false).x;
    assert!((direct - 1.0).abs() < 0.02, "{direct}");
    let narrow = 2_000_000;
    let mut caustic = 0.0f64;
    for i in 0..narrow {
        transport.trace(1, i, &mut |d| {
            if d.triangle >= 2 && d.bounce == 1 {
                caustic += f64::from(d.flux.x);
            }
        });
    }
    let caustic = caustic / narrow as f64 / 0.04;
    assert!((caustic / (0.8 / 9.0) - 1.0).abs() < 0.12, "{caustic}");
    assert!(!transport.is_diffuse(0) && transport.is_diffuse(2));
}

#[test]
fn light_through_a_pane_arrives_as_from_the_light_itself() {
    let mut mesh = quad(Vec3::new(-0.5, 0.0, 0.5), Vec3::X, Vec3::NEG_Z);
    join(&mut mesh, &quad(Vec3::new(-3.0, 0.5, 3.0), Vec3::X * 6.0, Vec3::NEG_Z * 6.0), 1);
    let pane = of_model(Model::Dielectric {
        ior: 1.5,
        transmittance: Vec3::ONE,
        thin: true,
        roughness: crate::scene::Roughness { alpha_x: 0.0, alpha_y: 0.0, distribution: Default::default() },
    });
    let sun = Light::Directional { direction: Vec3::NEG_Y, irradiance: Vec3::ONE };
    let window = scene(mesh, vec![lambert(0.5, 0.0), pane], vec![sun]);
    let (accel, lights) = (Accel::build(&window), Lights::build(&window));
    let transport = SceneTransport::new(&window, &accel, &lights);
    // 2R/(1 + R) with R = .04 is reflected.
    let through = 1.0 - 0.08 / 1.04;
    assert!((transport.certain(0, 0.3, 0.3, false).x / through - 1.0).abs() < 1e-4);
    let straight = [0, 1].map(|t| mean_on(&transport, t, 0.5, 0).x - mean_on(&transport, t, 0.5, 1).x);
    assert!((0.5 * (straight[0] + straight[1]) / through - 1.0).abs() < 0.05, "{straight:?} {through}");
    // Neither lamp nor sun lights the floor twice: what particles bring is the floor's own light, sent back.
    let lit = transport.lit(1000, 1, &|_| 1.0);
    let (n, mut again) = (100_000, 0.0);
    for i in 0..n {
        let choice = (i as f64 + 0.5) / n as f64;
        transport.trace_reflected(&lit, choice, 3, i, &mut |d| again += f64::from(d.flux.x) / n as f64);
    }
    assert!(again < 0.01, "{again}");
}

#[test]
fn a_black_texel_is_lit_as_a_white_one() {
    let mut mesh = quad(Vec3::new(-0.5, 0.0, 0.5), Vec3::X, Vec3::NEG_Z);
    mesh.uvs = mesh.positions.iter().map(|p| glam::Vec2::new(p.x, p.z)).collect();
    let texels = [[0, 0, 0, 255], [255; 4], [255; 4], [0, 0, 0, 255]];
    let checker = MipChain::from_rgba8(2, 2, texels.to_vec(), true);
    let albedo = Reflectance { color: Vec3::ONE, map: Some(TextureId(0)) };
    let sun = Light::Directional { direction: Vec3::NEG_Y, irradiance: Vec3::ONE };
    let floor = scene(mesh, vec![of_model(Model::Lambert { albedo })], vec![sun])
        .with_resident(vec![Texture::new("checker", checker)]);
    let (accel, lights) = (Accel::build(&floor), Lights::build(&floor));
    let transport = SceneTransport::new(&floor, &accel, &lights);
    for (b1, b2) in [(0.1, 0.1), (0.3, 0.1), (0.1, 0.3), (0.6, 0.1)] {
        assert_eq!(transport.certain(0, b1, b2, false), Vec3::ONE);
    }
    let particles = mean_on(&transport, 0, 0.5, 0).x;
    assert!((particles - 1.0).abs() < 0.01, "{particles}");
}

#[test]
fn glass_absorbs_on_the_way_to_what_lies_in_it() {
    let mut mesh = cube(Vec3::new(-1.0, -0.5, -1.0), 2.0, true);
    join(&mut mesh, &quad(Vec3::new(-0.5, 0.0, 0.5), Vec3::X, Vec3::NEG_Z), 1);
    let roughness = crate::scene::Roughness { alpha_x: 0.0, alpha_y: 0.0, distribution: Default::default() };
    let transmittance = Vec3::new(0.5, 0.8, 1.0);
    let glass = of_model(Model::Dielectric { ior: 1.0, transmittance, thin: false, roughness });
    let sun = Light::Directional { direction: Vec3::NEG_Y, irradiance: Vec3::ONE };
    let block = scene(mesh, vec![glass, lambert(1e-6, 0.0)], vec![sun]);
    let (accel, lights) = (Accel::build(&block), Lights::build(&block));
    let transport = SceneTransport::new(&block, &accel, &lights);
    let found = mean_on(&transport, 12, 0.5, 0);
    // A plate 1.5 below the surface of the block.
    let exact = transmittance.map(|t| math::powf(t, 1.5));
    assert!(((found / exact) - 1.0).abs().max_element() < 0.05, "{found} {exact}");
}

#[test]
fn smooth_normals_brighten_and_darken_alike_for_direct_light_and_particles() {
    let mut mesh = quad(Vec3::new(-0.5, 0.0, 0.5), Vec3::X, Vec3::NEG_Z);
    let tilted = Vec3::new(0.5, 1.0, 0.0).normalize();
    mesh.normals.fill(tilted);
    let direction = Vec3::new(-1.0, -1.0, 0.0).normalize();
    let sun = Light::Directional { direction, irradiance: Vec3::ONE };
    let floor = scene(mesh, vec![lambert(0.5, 0.0)], vec![sun]);
    let (accel, lights) = (Accel::build(&floor), Lights::build(&floor));
    let transport = SceneTransport::new(&floor, &accel, &lights);
    let exact = -direction.dot(tilted);
    let direct = transport.certain(0, 0.3, 0.3, false).x;
    assert!((direct - exact).abs() < 1e-4, "{direct} {exact}");
    let particles = mean_on(&transport, 0, 0.5, 0).x;
    assert!((particles / exact - 1.0).abs() < 0.02, "{particles} {exact}");
}

#[test]
fn glass_absorbs_along_the_way_inside() {
    let mut mesh = cube(Vec3::new(-1.0, 0.5, -1.0), 2.0, true);
    join(&mut mesh, &quad(Vec3::new(-0.5, 0.0, 0.5), Vec3::X, Vec3::NEG_Z), 1);
    let glass = of_model(Model::Dielectric {
        ior: 1.0,
        transmittance: Vec3::new(0.5, 0.8, 1.0),
        thin: false,
        roughness: crate::scene::Roughness { alpha_x: 0.0, alpha_y: 0.0, distribution: Default::default() },
    });
    let sun = Light::Directional { direction: Vec3::NEG_Y, irradiance: Vec3::ONE };
    let block = scene(mesh, vec![glass, lambert(1e-6, 0.0)], vec![sun]);
    let (accel, lights) = (Accel::build(&block), Lights::build(&block));
    let transport = SceneTransport::new(&block, &accel, &lights);
    let found = mean_on(&transport, 12, 0.5, 0);
    let exact = Vec3::new(0.25, 0.64, 1.0);
    assert!(((found / exact) - 1.0).abs().max_element() < 0.05, "{found}");
}
