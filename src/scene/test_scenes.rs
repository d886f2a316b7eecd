//! Small scenes for tests.

use glam::Vec3;

use super::*;

/// White diffuse triangles without light.
pub fn of_triangles(corners: &[[Vec3; 3]]) -> Scene {
    let material = Material {
        name: "white".into(),
        model: Model::Lambert { albedo: Reflectance::constant(Vec3::splat(0.5)) },
        emission: Reflectance::constant(Vec3::ZERO),
        opacity: 1.0,
        opacity_map: None,
        bump_map: None,
        bump_scale: 1.0,
        normal_map: None,
        two_sided: true,
    };
    let positions: Vec<Vec3> = corners.iter().flatten().copied().collect();
    let (min, max) = positions
        .iter()
        .filter(|p| p.is_finite())
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(a, b), &p| (a.min(p), b.max(p)));
    let count = corners.len();
    Scene {
        name: "test".into(),
        title: "test".into(),
        mesh: Mesh {
            normals: vec![Vec3::ZERO; positions.len()],
            uvs: vec![Vec2::ZERO; positions.len()],
            positions,
            triangles: (0..count as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
            materials: vec![MaterialId(0); count],
            objects: vec![0; count],
        },
        materials: vec![material],
        textures: Vec::new(),
        lights: Vec::new(),
        environment: None,
        cameras: vec![NamedCamera {
            name: "main".into(),
            camera: Camera { eye: Vec3::ZERO, target: Vec3::Z, up: Vec3::Y, fov_y: 0.8 },
        }],
        paths: Vec::new(),
        objects: Vec::new(),
        bounds: [min, max],
        metres_per_unit: 1.0,
        up: Vec3::Y,
        display: Display::default(),
        budget: Budget::default(),
        content_hash: [0; 32],
    }
}
