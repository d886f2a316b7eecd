//! A room with a non-diffuse ball, a textured wall and a perforated screen, made here.

use foveal::image::Map2d;
use foveal::scene::material::Roughness;
use foveal::scene::texture::MipChain;
use foveal::scene::{
    Camera, Coat, Display, Environment, Material, MaterialId, Mesh, Model, NamedCamera, Object, Reflectance,
    Scene, SceneParts, Texture, TextureId,
};
use glam::{Vec2, Vec3};

const WALL: u32 = 0;
const CHECKER: u32 = 1;
const BALL: u32 = 2;
const LAMP: u32 = 3;
const SCREEN: u32 = 4;
const PLASTIC: u32 = 5;

fn material(name: &str, model: Model) -> Material {
    Material::new(name, model)
}

fn lambert(color: Vec3, map: Option<TextureId>) -> Model {
    Model::Lambert { albedo: Reflectance { color, map } }
}

/// A grid of `n × n` cells over a parallelogram.
fn grid(mesh: &mut Mesh, [corner, u, v]: [Vec3; 3], n: usize, material: u32, object: u32) {
    let first = mesh.positions.len() as u32;
    let side = n as u32 + 1;
    for y in 0..=n {
        for x in 0..=n {
            let p = Vec2::new(x as f32, y as f32) / n as f32;
            mesh.positions.push(corner + u * p.x + v * p.y);
            mesh.normals.push(u.cross(v).normalize());
            mesh.uvs.push(p * 3.0);
        }
    }
    for y in 0..n as u32 {
        for x in 0..n as u32 {
            let a = first + y * side + x;
            add(mesh, [a, a + 1, a + side + 1], material, object);
            add(mesh, [a, a + side + 1, a + side], material, object);
        }
    }
}

fn add(mesh: &mut Mesh, triangle: [u32; 3], material: u32, object: u32) {
    mesh.triangles.push(triangle);
    mesh.materials.push(MaterialId(material));
    mesh.objects.push(object);
}

fn ball(mesh: &mut Mesh, center: Vec3, radius: f32, n: u32, [material, object]: [u32; 2]) {
    let first = mesh.positions.len() as u32;
    for i in 0..=n {
        for j in 0..=2 * n {
            let (theta, phi) =
                (std::f32::consts::PI * i as f32 / n as f32, std::f32::consts::PI * j as f32 / n as f32);
            let d = Vec3::new(theta.sin() * phi.cos(), theta.cos(), theta.sin() * phi.sin());
            mesh.positions.push(center + d * radius);
            mesh.normals.push(d);
            mesh.uvs.push(Vec2::ZERO);
        }
    }
    for i in 0..n {
        for j in 0..2 * n {
            let a = first + i * (2 * n + 1) + j;
            let b = a + 2 * n + 1;
            add(mesh, [a, a + 1, b + 1], material, object);
            add(mesh, [a, b + 1, b], material, object);
        }
    }
}

/// The room [−1, 1]³, open at the front (+z), its walls of `n × n` cells each, under a sky.
pub fn room(n: usize) -> Scene {
    let mut mesh = Mesh::default();
    let (x, y, z) = (Vec3::X * 2.0, Vec3::Y * 2.0, Vec3::Z * 2.0);
    grid(&mut mesh, [Vec3::new(-1.0, -1.0, 1.0), x, -z], n, CHECKER, 0);
    grid(&mut mesh, [Vec3::new(-1.0, 1.0, -1.0), x, z], n, WALL, 0);
    grid(&mut mesh, [Vec3::new(-1.0, -1.0, -1.0), x, y], n, WALL, 0);
    grid(&mut mesh, [Vec3::new(-1.0, -1.0, 1.0), -z, y], n, WALL, 0);
    grid(&mut mesh, [Vec3::new(1.0, -1.0, -1.0), z, y], n, CHECKER, 0);
    grid(&mut mesh, [Vec3::new(-0.3, 0.99, -0.3), x * 0.3, z * 0.3], 1, LAMP, 0);
    grid(&mut mesh, [Vec3::new(-0.8, -0.9, 0.3), x * 0.3, y * 0.4], 1, SCREEN, 0);
    ball(&mut mesh, Vec3::new(0.2, -0.5, 0.0), 0.45, 24, [BALL, 1]);
    ball(&mut mesh, Vec3::new(-0.4, -0.7, -0.3), 0.3, 12, [PLASTIC, 2]);

    let checker: Vec<[u8; 4]> = (0..64 * 32)
        .map(
            |i| if ((i % 64) / 8 + (i / 64) / 8) % 2 == 0 { [230, 200, 40, 255] } else { [30, 60, 190, 255] },
        )
        .collect();
    let holes: Vec<[u8; 4]> =
        (0..32 * 32).map(|i| [255, 255, 255, if (i % 32) / 8 % 2 == 0 { 255 } else { 0 }]).collect();
    let mut mask = Texture::new("holes", MipChain::from_rgba8(32, 32, holes, false));
    mask.has_alpha = true;
    mask.is_color = false;

    let glossy = Model::Metal {
        specular: Reflectance::constant(Vec3::splat(0.9)),
        roughness: Roughness { alpha_x: 0.1, alpha_y: 0.1, distribution: Default::default() },
    };
    let mut lamp = material("lamp", lambert(Vec3::splat(0.5), None));
    lamp.emission = Reflectance::constant(Vec3::new(2.0, 1.5, 1.0));
    let mut screen = material("screen", lambert(Vec3::new(0.2, 0.7, 0.3), None));
    screen.opacity_map = Some(TextureId(1));
    let materials = vec![
        material("wall", lambert(Vec3::new(0.8, 0.75, 0.7), None)),
        material("checker", lambert(Vec3::splat(0.9), Some(TextureId(0)))),
        material("ball", glossy),
        lamp,
        screen,
        material(
            "plastic",
            Model::Plastic {
                albedo: Reflectance::constant(Vec3::new(0.9, 0.2, 0.1)),
                coat: Coat::new(
                    1.5,
                    Roughness { alpha_x: 0.0, alpha_y: 0.0, distribution: Default::default() },
                ),
            },
        ),
    ];
    let objects = (0..3)
        .map(|id| Object {
            name: format!("object {id}"),
            material: MaterialId([WALL, BALL, PLASTIC][id as usize]),
            triangles: (0..mesh.triangles.len() as u32).filter(|t| mesh.objects[*t as usize] == id).collect(),
            bounds: [Vec3::NEG_ONE, Vec3::ONE],
            area: 1.0,
            parent: None,
        })
        .collect();
    let sky = Map2d::from_fn(32, 16, |x, y| Vec3::new(x as f32 / 64.0, 0.3, 1.0 - y as f32 / 16.0));
    let camera =
        Camera { eye: Vec3::new(0.1, 0.2, 2.6), target: Vec3::new(0.0, -0.1, 0.0), up: Vec3::Y, fov_y: 0.9 };
    SceneParts {
        name: "room".into(),
        title: "room".into(),
        mesh,
        materials,
        lights: Vec::new(),
        environment: Some(Environment { radiance: Vec3::ONE, map: Some(sky), rotate_up: 0.4, up: Vec3::Y }),
        cameras: vec![NamedCamera { name: "start".into(), camera }],
        paths: Vec::new(),
        objects,
        things: Default::default(),
        bounds: [Vec3::NEG_ONE, Vec3::ONE],
        metres_per_unit: 1.0,
        up: Vec3::Y,
        display: Display::default(),
        budget: Default::default(),
        extensions: Vec::new(),
        content_hash: [0; 32],
        files: Vec::new(),
    }
    .with_textures(vec![Texture::new("checker", MipChain::from_rgba8(64, 32, checker, true)), mask])
}
