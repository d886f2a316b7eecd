//! The simplest light transport, for tests: constant Lambertian materials and area lights, written
//! without the BSDF and light code that the program uses.

use std::f32::consts::PI;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::Vec3;

use super::atlas::triangle_area;
use crate::geometry::{Accel, Hit, Ray};
use crate::image::luminance;
use crate::math;
use crate::rng::Stream;
use crate::scene::{Model, Scene};
use crate::transport::lit::LitSurfaces;
use crate::transport::particle::{Arriving, BOUNCES_MAX, Deposit, LightTransport, SurfacePoint};

/// Light transport by definition.
pub struct Lambertian<'a> {
    scene: &'a Scene,
    accel: Accel,
    /// Emissive triangles with their share of the power, summed up.
    lights: Vec<(u32, f32)>,
    power: f32,
    /// How often it was asked for direct light.
    pub asked: AtomicU64,
}

impl<'a> Lambertian<'a> {
    pub fn new(scene: &'a Scene) -> Self {
        let mut lights = Vec::new();
        let mut power = 0.0;
        for t in 0..scene.mesh.triangles.len() as u32 {
            let emission = material(scene, t).emission.color;
            if emission.max_element() > 0.0 {
                power += PI * luminance(emission) * triangle_area(scene.mesh.corners(t));
                lights.push((t, power));
            }
        }
        for light in &mut lights {
            light.1 /= power;
        }
        Self { scene, accel: Accel::build(scene), lights, power, asked: AtomicU64::new(0) }
    }

    /// A light, a point and the power over the probability of the light.
    fn choose(&self, [u0, u, v]: [f32; 3]) -> Option<(u32, Vec3, Vec3, f32)> {
        let i = self.lights.partition_point(|l| l.1 <= u0).min(self.lights.len().checked_sub(1)?);
        let t = self.lights[i].0;
        let probability = self.lights[i].1 - if i > 0 { self.lights[i - 1].1 } else { 0.0 };
        let s = u.sqrt();
        let [a, b, c] = self.scene.mesh.corners(t);
        let p = a * (1.0 - s) + b * (s * (1.0 - v)) + c * (s * v);
        Some((t, p, self.normal(t), probability))
    }

    fn normal(&self, t: u32) -> Vec3 {
        let [a, b, c] = self.scene.mesh.corners(t);
        (b - a).cross(c - a).normalize()
    }

    fn lift(&self, p: Vec3, n: Vec3) -> Vec3 {
        p + n * (1e-5 * self.scene.diagonal())
    }
}

fn material(scene: &Scene, t: u32) -> &crate::scene::Material {
    &scene.materials[scene.mesh.materials[t as usize].0 as usize]
}

fn albedo(scene: &Scene, t: u32) -> Vec3 {
    match &material(scene, t).model {
        Model::Lambert { albedo } => albedo.color,
        _ => Vec3::ZERO,
    }
}

fn cosine_direction(n: Vec3, [u, v]: [f32; 2]) -> Vec3 {
    let (t, b) = n.any_orthonormal_pair();
    let (r, phi) = (u.sqrt(), 2.0 * PI * v);
    t * (r * math::cos(phi)) + b * (r * math::sin(phi)) + n * (1.0 - u).sqrt()
}

impl LightTransport for Lambertian<'_> {
    fn trace(&self, seed: u64, index: u64, deposit: &mut dyn FnMut(Deposit)) -> u32 {
        let mut stream = Stream::new(seed, index, 0);
        let Some((light, p, n, probability)) = self.choose(std::array::from_fn(|_| stream.next_f32())) else {
            return 0;
        };
        let area = triangle_area(self.scene.mesh.corners(light));
        let mut flux = material(self.scene, light).emission.color * (PI * area / probability);
        let mut ray = Ray::new(self.lift(p, n), cosine_direction(n, stream.next_2d()));
        for bounce in 0..BOUNCES_MAX {
            let Some(hit) = self.accel.intersect(self.scene, &ray) else { return bounce };
            let normal = self.normal(hit.triangle);
            let back = normal.dot(ray.direction) > 0.0;
            deposit(Deposit { triangle: hit.triangle, b1: hit.b1, b2: hit.b2, back, flux, bounce });
            let reflectance = albedo(self.scene, hit.triangle);
            let survival = reflectance.max_element().min(0.95);
            if stream.next_f32() >= survival {
                return bounce + 1;
            }
            flux *= reflectance / survival;
            let n = if back { -normal } else { normal };
            ray = Ray::new(self.lift(ray.at(hit.t), n), cosine_direction(n, stream.next_2d()));
        }
        BOUNCES_MAX
    }

    fn trace_reflected(
        &self,
        _lit: &LitSurfaces,
        _choice: f64,
        seed: u64,
        index: u64,
        deposit: &mut dyn FnMut(Deposit),
    ) -> u32 {
        self.trace(seed, index, &mut |d| {
            if d.bounce > 0 {
                deposit(d);
            }
        })
    }

    fn direct(&self, triangle: u32, b1: f32, b2: f32, back: bool, u: [f32; 3]) -> Arriving {
        self.asked.fetch_add(1, Ordering::Relaxed);
        let Some((light, q, nq, probability)) = self.choose(u) else { return Vec3::ZERO.into() };
        let [a, b, c] = self.scene.mesh.corners(triangle);
        let n = if back { -self.normal(triangle) } else { self.normal(triangle) };
        let p = self.lift(a * (1.0 - b1 - b2) + b * b1 + c * b2, n);
        let d = self.lift(q, nq) - p;
        let cosines = n.dot(d).max(0.0) * (-nq.dot(d)).max(0.0);
        if cosines <= 0.0 || self.accel.occluded(self.scene, &Ray { t_max: 1.0, ..Ray::new(p, d) }) {
            return Vec3::ZERO.into();
        }
        let area = triangle_area(self.scene.mesh.corners(light));
        let emission = material(self.scene, light).emission.color;
        (emission * (cosines / d.length_squared().powi(2) * area / probability)).into()
    }

    fn sees_inside(&self, at: SurfacePoint, back: bool, near: f32, stream: &mut Stream) -> bool {
        let SurfacePoint { triangle, b1, b2 } = at;
        let [a, b, c] = self.scene.mesh.corners(triangle);
        let n = if back { -self.normal(triangle) } else { self.normal(triangle) };
        let p = self.lift(a * (1.0 - b1 - b2) + b * b1 + c * b2, n);
        let ray = Ray::new(p, cosine_direction(n, stream.next_2d()));
        self.accel
            .intersect(self.scene, &ray)
            .is_some_and(|hit| hit.t < near || !back && self.normal(hit.triangle).dot(ray.direction) > 0.0)
    }

    fn sees(&self, ray: &Ray) -> Option<Hit> {
        self.accel.intersect(self.scene, ray)
    }

    fn is_diffuse(&self, triangle: u32) -> bool {
        albedo(self.scene, triangle).max_element() > 0.0
    }

    fn power(&self) -> f32 {
        self.power
    }
}
