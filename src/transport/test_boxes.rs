//! Scenes of rectangles and spheres with closed forms, for tests.

use glam::Vec3;

use crate::math;
use crate::scene::test_scenes::of_triangles;
use crate::scene::{Environment, Material, MaterialId, Model, Reflectance, Roughness, Scene};

/// Triangles with their materials.
#[derive(Default)]
pub struct Builder {
    corners: Vec<[Vec3; 3]>,
    normals: Vec<Vec3>,
    materials: Vec<u32>,
    palette: Vec<Material>,
}

impl Builder {
    /// A material without emission.
    pub fn material(&mut self, model: Model) -> u32 {
        self.emitter(model, Vec3::ZERO)
    }

    pub fn emitter(&mut self, model: Model, radiance: Vec3) -> u32 {
        let mut material = of_triangles(&[]).materials.swap_remove(0);
        material.model = model;
        material.emission = Reflectance::constant(radiance);
        self.palette.push(material);
        self.palette.len() as u32 - 1
    }

    fn triangle(&mut self, corners: [Vec3; 3], normals: [Vec3; 3], material: u32) {
        self.corners.push(corners);
        self.normals.extend(normals);
        self.materials.push(material);
    }

    /// A grid of n × n patches over (u, v) ∈ [0, 1]², each point with its normal, fronts along ∂p/∂u × ∂p/∂v.
    pub fn surface(&mut self, n: usize, material: u32, point: impl Fn(f32, f32) -> (Vec3, Vec3)) {
        let at = |i: usize, j: usize| point(i as f32 / n as f32, j as f32 / n as f32);
        for i in 0..n {
            for j in 0..n {
                let p = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                for corners in [[0, 1, 2], [0, 2, 3]] {
                    self.triangle(corners.map(|c| p[c].0), corners.map(|c| p[c].1), material);
                }
            }
        }
    }

    /// The material that was made, to be changed.
    pub fn edit(&mut self, material: u32) -> &mut Material {
        &mut self.palette[material as usize]
    }

    /// The rectangle `centre ± a ± b`, its front along a × b.
    pub fn rectangle(&mut self, centre: Vec3, a: Vec3, b: Vec3, material: u32) {
        let p = [centre - a - b, centre + a - b, centre + a + b, centre - a + b];
        self.triangle([p[0], p[1], p[2]], [Vec3::ZERO; 3], material);
        self.triangle([p[0], p[2], p[3]], [Vec3::ZERO; 3], material);
    }

    /// The six faces of a cube of half side `half`, their fronts outwards, or inwards where `half` < 0.
    pub fn cube(&mut self, centre: Vec3, half: f32, material: u32) {
        for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
            for side in [1.0, -1.0] {
                let n = axis * side;
                let a = Vec3::new(n.y, n.z, n.x);
                let b = n.cross(a);
                let (a, b) = if half < 0.0 { (b, a) } else { (a, b) };
                self.rectangle(centre + n * half.abs(), a * half.abs(), b * half.abs(), material);
            }
        }
    }

    /// A sphere with smooth normals, its front outwards.
    pub fn sphere(&mut self, centre: Vec3, radius: f32, rings: usize, material: u32) {
        let point = |i: usize, j: usize| {
            let theta = std::f32::consts::PI * i as f32 / rings as f32;
            let phi = std::f32::consts::TAU * (j % (2 * rings)) as f32 / (2 * rings) as f32;
            let s = if i == 0 || i == rings { 0.0 } else { math::sin(theta) };
            Vec3::new(s * math::cos(phi), s * math::sin(phi), math::cos(theta))
        };
        for i in 0..rings {
            for j in 0..2 * rings {
                let n = [point(i, j), point(i + 1, j), point(i + 1, j + 1), point(i, j + 1)];
                for [x, y, z] in [[0, 1, 2], [0, 2, 3]] {
                    let corners = [n[x], n[y], n[z]].map(|v| centre + v * radius);
                    self.triangle(corners, [n[x], n[y], n[z]], material);
                }
            }
        }
    }

    pub fn scene(self) -> Scene {
        let mut scene = of_triangles(&self.corners);
        scene.mesh.normals = self.normals;
        scene.mesh.materials = self.materials.into_iter().map(MaterialId).collect();
        if !self.palette.is_empty() {
            scene.materials = self.palette;
        }
        scene
    }

    /// The scene under the same radiance from everywhere.
    pub fn under_sky(self, radiance: Vec3) -> Scene {
        let mut scene = self.scene();
        scene.environment = Some(Environment::constant(radiance));
        scene
    }
}

pub fn lambert(albedo: f32) -> Model {
    Model::Lambert { albedo: Reflectance::constant(Vec3::splat(albedo)) }
}

pub fn rough(alpha: f32) -> Roughness {
    Roughness { alpha_x: alpha, alpha_y: alpha, distribution: crate::scene::Distribution::Ggx }
}

pub fn glass(ior: f32, transmittance: f32, thin: bool) -> Model {
    Model::Dielectric { ior, transmittance: Vec3::splat(transmittance), thin, roughness: rough(0.0) }
}

/// Mean and standard error of the x band of `n` samples.
pub fn mean(n: u64, sample: impl Fn(u64) -> Vec3) -> (f64, f64) {
    let (mut sum, mut squares) = (0.0f64, 0.0f64);
    for i in 0..n {
        let v = f64::from(sample(i).x);
        sum += v;
        squares += v * v;
    }
    let mean = sum / n as f64;
    (mean, ((squares / n as f64 - mean * mean).max(0.0) / n as f64).sqrt())
}
