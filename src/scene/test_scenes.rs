//! Small scenes for tests.

use glam::Vec3;

use super::*;

/// White diffuse triangles without light.
pub fn of_triangles(corners: &[[Vec3; 3]]) -> Scene {
    let material = Material::new("white", Model::Lambert { albedo: Reflectance::constant(Vec3::splat(0.5)) });
    let positions: Vec<Vec3> = corners.iter().flatten().copied().collect();
    let (min, max) = positions
        .iter()
        .filter(|p| p.is_finite())
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(a, b), &p| (a.min(p), b.max(p)));
    let count = corners.len();
    SceneParts {
        name: "test".into(),
        title: "test".into(),
        mesh: Mesh {
            normals: vec![Vec3::ZERO; positions.len()],
            uvs: vec![Vec2::ZERO; positions.len()],
            uvs1: Vec::new(),
            tangents: Vec::new(),
            positions,
            triangles: (0..count as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
            materials: vec![MaterialId(0); count],
            objects: vec![0; count],
        },
        materials: vec![material],
        lights: Vec::new(),
        environment: None,
        cameras: vec![NamedCamera {
            name: "main".into(),
            camera: Camera { eye: Vec3::ZERO, target: Vec3::Z, up: Vec3::Y, fov_y: 0.8 },
        }],
        paths: Vec::new(),
        objects: Vec::new(),
        things: Things::default(),
        bounds: [min, max],
        metres_per_unit: 1.0,
        up: Vec3::Y,
        display: Display::default(),
        budget: Budget::default(),
        extensions: Vec::new(),
        content_hash: [0; 32],
        files: Vec::new(),
    }
    .with_textures(Vec::new())
}

/// A material of this model.
pub fn material(name: &str, model: Model) -> Material {
    Material::new(name, model)
}

/// Grey.
pub fn grey() -> Material {
    material("grey", Model::Lambert { albedo: Reflectance::constant(Vec3::splat(0.5)) })
}

/// A mirror.
pub fn mirror() -> Material {
    material("mirror", Model::Mirror { specular: Reflectance::constant(Vec3::ONE) })
}

/// A surface of base colour 1.
pub fn white_metal_rough(metal: f32, r: f32) -> MetalRough {
    let layer = metal_rough::Layer::new(0.04, 1.0);
    MetalRough {
        diffuse: Reflectance::constant(Vec3::splat((1.0 - metal) * (1.0 - layer.mean(r)))),
        specular: Reflectance::constant(Vec3::splat(0.04 * (1.0 - metal) + metal)),
        roughness_in_alpha: false,
        metallic: Some(metal),
        metallic_in_alpha: false,
        roughness: r,
        roughness_range: [r; 2],
        maps_agree: false,
        layer,
        specular_mean: 1.0,
        through: Reflectance::constant(Vec3::ZERO),
        coverage: 1.0,
        coverage_in_alpha: false,
        over: None,
        grain: None,
        recipe: None,
        is_diffuse: false,
    }
}

/// Appends a box whose faces look outwards, or inwards.
pub fn add_box(mesh: &mut Mesh, low: Vec3, high: Vec3, material: u32, inwards: bool) {
    const FACES: [[usize; 4]; 6] =
        [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let base = mesh.positions.len() as u32;
    for corner in 0..8 {
        let pick = |bit: usize, axis: usize| if corner >> bit & 1 == 0 { low[axis] } else { high[axis] };
        mesh.positions.push(Vec3::new(pick(0, 0), pick(1, 1), pick(2, 2)));
        mesh.normals.push(Vec3::ZERO);
        mesh.uvs.push(Vec2::ZERO);
    }
    for f in FACES {
        let [a, b, c, d] = f.map(|i| base + i as u32);
        for [p, q, r] in [[a, b, c], [a, c, d]] {
            mesh.triangles.push(if inwards { [p, r, q] } else { [p, q, r] });
            mesh.materials.push(MaterialId(material));
            mesh.objects.push(0);
        }
    }
}

/// A scene of one mesh without cameras and lights.
pub fn scene(mesh: Mesh, materials: Vec<Material>) -> Scene {
    let bounds = mesh.bounds();
    let mut scene = SceneParts {
        name: "test".to_owned(),
        title: "test".to_owned(),
        mesh,
        materials,
        lights: Vec::new(),
        environment: None,
        cameras: Vec::new(),
        paths: Vec::new(),
        objects: Vec::new(),
        things: Things::default(),
        bounds,
        metres_per_unit: 1.0,
        up: Vec3::Y,
        display: Display::default(),
        budget: Budget::default(),
        extensions: Vec::new(),
        content_hash: [0; 32],
        files: Vec::new(),
    }
    .with_textures(Vec::new());
    let grouped = super::hierarchy::group(&scene.mesh, &scene.materials, scene.up, |_| "");
    scene.objects = grouped.objects;
    scene.mesh.objects = grouped.of_triangle;
    scene
}

/// The unit cube.
pub fn box_scene(inwards: bool) -> Scene {
    let mut mesh = Mesh::default();
    add_box(&mut mesh, Vec3::ZERO, Vec3::ONE, 0, inwards);
    scene(mesh, vec![grey()])
}

/// With a camera from the front.
pub fn with_camera(mut scene: Scene) -> Scene {
    let camera = Camera { eye: Vec3::new(0.5, 0.5, 0.9), target: Vec3::splat(0.5), up: Vec3::Y, fov_y: 1.0 };
    scene.cameras.push(NamedCamera { name: "main".to_owned(), camera });
    scene
}
