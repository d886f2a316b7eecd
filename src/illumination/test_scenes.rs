//! Small scenes with closed forms, for tests.

use glam::Vec3;

use super::sites::Site;
use crate::scene::{
    Camera, Display, Light, Material, MaterialId, Mesh, Model, NamedCamera, Object, Reflectance, Scene,
    SceneParts,
};

/// A parallelogram of two triangles with normal `u × v`.
pub fn quad(origin: Vec3, u: Vec3, v: Vec3) -> Mesh {
    grid_at(1, 1, |x, y| origin + u * x + v * y)
}

/// A grid of `nx × ny` quads over (x, y) ∈ [0, 1]².
pub fn grid(nx: u32, ny: u32, f: impl Fn(f32, f32) -> Vec3) -> Mesh {
    grid_at(nx, ny, f)
}

fn grid_at(nx: u32, ny: u32, f: impl Fn(f32, f32) -> Vec3) -> Mesh {
    let mut mesh = Mesh::default();
    for y in 0..=ny {
        for x in 0..=nx {
            mesh.positions.push(f(x as f32 / nx as f32, y as f32 / ny as f32));
        }
    }
    for y in 0..ny {
        for x in 0..nx {
            let v = y * (nx + 1) + x;
            mesh.triangles.push([v, v + 1, v + nx + 2]);
            mesh.triangles.push([v, v + nx + 2, v + nx + 1]);
        }
    }
    finish(&mut mesh, 0);
    mesh
}

fn finish(mesh: &mut Mesh, material: u32) {
    mesh.normals.resize(mesh.positions.len(), Vec3::ZERO);
    mesh.uvs.resize(mesh.positions.len(), glam::Vec2::ZERO);
    mesh.materials.resize(mesh.triangles.len(), MaterialId(material));
    mesh.objects.resize(mesh.triangles.len(), 0);
}

/// An axis-parallel cube whose faces look outward or inward. Its eight corners are shared.
pub fn cube(corner: Vec3, side: f32, outward: bool) -> Mesh {
    let mut mesh = Mesh::default();
    for i in 0..8u32 {
        let bit = |k: u32| ((i >> k) & 1) as f32;
        mesh.positions.push(corner + side * Vec3::new(bit(0), bit(1), bit(2)));
    }
    // −x, +x, −y, +y, −z, +z, counter-clockwise from outside
    let faces = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    for mut f in faces {
        if !outward {
            f.swap(1, 3);
        }
        mesh.triangles.push([f[0], f[1], f[2]]);
        mesh.triangles.push([f[0], f[2], f[3]]);
    }
    finish(&mut mesh, 0);
    mesh
}

/// Adds the triangles of `part` with `material`.
pub fn join(mesh: &mut Mesh, part: &Mesh, material: u32) {
    let first = mesh.positions.len() as u32;
    mesh.positions.extend(&part.positions);
    mesh.triangles.extend(part.triangles.iter().map(|t| t.map(|v| v + first)));
    finish(mesh, material);
}

/// A two-sided Lambertian material that emits `radiance` from its front.
pub fn lambert(albedo: f32, radiance: f32) -> Material {
    Material {
        emission: Reflectance::constant(Vec3::splat(radiance)),
        ..Material::new(
            format!("albedo {albedo}, radiance {radiance}"),
            Model::Lambert { albedo: Reflectance::constant(Vec3::splat(albedo)) },
        )
    }
}

/// A scene of a mesh and its materials.
pub fn scene(mesh: Mesh, materials: Vec<Material>, lights: Vec<Light>) -> Scene {
    let low = mesh.positions.iter().copied().fold(Vec3::splat(f32::INFINITY), Vec3::min);
    let high = mesh.positions.iter().copied().fold(Vec3::splat(f32::NEG_INFINITY), Vec3::max);
    let area = (0..mesh.triangles.len() as u32).map(|t| super::atlas::triangle_area(mesh.corners(t))).sum();
    SceneParts {
        name: "test".into(),
        title: "test".into(),
        things: Default::default(),
        objects: vec![Object {
            name: "all".into(),
            material: MaterialId(0),
            triangles: (0..mesh.triangles.len() as u32).collect(),
            bounds: [low, high],
            area,
            parent: None,
        }],
        mesh,
        materials,
        lights,
        environment: None,
        cameras: vec![NamedCamera {
            name: "main".into(),
            camera: Camera { eye: Vec3::Z * 4.0, target: Vec3::ZERO, up: Vec3::Y, fov_y: 0.7 },
        }],
        paths: Vec::new(),
        bounds: [low, high],
        metres_per_unit: 1.0,
        up: Vec3::Y,
        display: Display::default(),
        budget: Default::default(),
        extensions: Vec::new(),
        content_hash: [0; 32],
        files: Vec::new(),
    }
    .with_textures(Vec::new())
}

/// The sites of a floor, so many along both sides, each a unit wide.
pub fn floor(side: usize) -> Vec<Site> {
    let site = |i: usize| Site {
        element: i as u32,
        back: false,
        position: Vec3::new((i % side) as f32, 0.0, (i / side) as f32),
        normal: Vec3::Y,
        width: 1.0,
    };
    (0..side * side).map(site).collect()
}
