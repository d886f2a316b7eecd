//! Where the illumination that a view shows is wrong: beside irradiance by unbiased paths, pixel by pixel.

use glam::Vec3;
use rayon::prelude::*;

use super::Irradiance;
use super::reference::{ReferencePoint, at_point};
use crate::geometry::{Accel, Ray};
use crate::image::luminance;
use crate::math;
use crate::rng::hash;
use crate::scene::Scene;
use crate::scene::camera::Camera;
use crate::transport::light::Lights;

/// Relative error that the picture shows in full colour.
const FULL: f32 = 0.3;

/// Irradiance shown and true, where a view sees the front of a diffuse surface.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorMap {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Per pixel what is shown, W/m², and what `samples` paths find.
    pub pixels: Vec<Option<(Vec3, ReferencePoint)>>,
}

impl ErrorMap {
    /// The view of a camera, `width` × `height` pixels, `samples` paths each.
    pub fn new(
        (scene, accel, lights): (&Scene, &Accel, &Lights),
        shown: &dyn Irradiance,
        camera: &Camera,
        [width, height]: [u32; 2],
        samples: u32,
    ) -> Self {
        let frame = camera.frame(width, height);
        let pixel = |i: u32| {
            let direction = frame.direction((i % width) as f32 + 0.5, (i / width) as f32 + 0.5);
            let hit = accel.intersect_seen(scene, &Ray::new(camera.eye, direction))?;
            let [a, b, c] = scene.mesh.corners(hit.triangle);
            let front = (b - a).cross(c - a).dot(direction) < 0.0;
            (front && scene.material_of(hit.triangle).has_diffuse()).then(|| {
                let (t, b1, b2) = (hit.triangle, hit.b1, hit.b2);
                let known = at_point((scene, accel, lights), t, b1, b2, samples, hash(7, i.into(), 0));
                (shown.irradiance(t, b1, b2, false), known)
            })
        };
        let pixels = (0..width * height).into_par_iter().map(pixel).collect();
        Self { width, height, pixels }
    }

    /// Root of the mean squared error of the luminance of all squares of `side` pixels, relative to the root mean
    /// square; the variance of the reference is taken off.
    pub fn relative_error(&self, side: u32) -> f64 {
        let side = side.max(1);
        let (columns, rows) = (self.width.div_ceil(side), self.height.div_ceil(side));
        let (mut error, mut energy) = (0.0f64, 0.0f64);
        for square in 0..columns * rows {
            let (x0, y0) = (square % columns * side, square / columns * side);
            let (mut difference, mut known, mut variance, mut n) = (0.0f64, 0.0f64, 0.0f64, 0.0f64);
            for y in y0..(y0 + side).min(self.height) {
                for x in x0..(x0 + side).min(self.width) {
                    if let Some((shown, reference)) = &self.pixels[(y * self.width + x) as usize] {
                        difference += f64::from(luminance(*shown - reference.irradiance));
                        known += f64::from(luminance(reference.irradiance));
                        variance += f64::from(reference.variance);
                        n += 1.0;
                    }
                }
            }
            if n > 0.0 {
                error += (difference * difference - variance) / n;
                energy += known * known / n;
            }
        }
        if energy > 0.0 { (error.max(0.0) / energy).sqrt() } else { 0.0 }
    }

    /// Shown, true, and the relative error of the mean of 3 × 3 pixels side by side, red where too dark, blue where too
    /// bright: rows of sRGB triples, `3 × width` columns.
    pub fn picture(&self) -> Vec<u8> {
        let mut values: Vec<f32> = self.pixels.iter().flatten().map(|p| luminance(p.1.irradiance)).collect();
        values.sort_by(f32::total_cmp);
        let scale = 0.6 / values.get(values.len() * 3 / 4).copied().unwrap_or(1.0).max(1e-12);
        let mut bytes = Vec::with_capacity(self.pixels.len() * 9);
        for y in 0..self.height {
            for panel in 0..3 {
                for x in 0..self.width {
                    let pixel = self.pixels[(y * self.width + x) as usize];
                    let color = match (panel, pixel) {
                        (_, None) => Vec3::splat(0.01),
                        (0, Some((shown, _))) => shown * scale,
                        (1, Some((_, reference))) => reference.irradiance * scale,
                        (_, Some(_)) => self.colour(x, y),
                    };
                    bytes.extend(color.to_array().map(srgb));
                }
            }
        }
        bytes
    }

    fn colour(&self, x: u32, y: u32) -> Vec3 {
        let (mut difference, mut known) = (0.0, 0.0);
        for y in y.saturating_sub(1)..(y + 2).min(self.height) {
            for x in x.saturating_sub(1)..(x + 2).min(self.width) {
                if let Some((shown, reference)) = &self.pixels[(y * self.width + x) as usize] {
                    difference += luminance(*shown - reference.irradiance);
                    known += luminance(reference.irradiance);
                }
            }
        }
        let r = (difference / known.max(1e-12) / FULL).clamp(-1.0, 1.0);
        let rest = 0.2 * (1.0 - r.abs());
        if r < 0.0 { Vec3::new(0.2 - 0.8 * r, rest, rest) } else { Vec3::new(rest, rest, 0.2 + 0.8 * r) }
    }
}

fn srgb(linear: f32) -> u8 {
    let x = linear.clamp(0.0, 1.0);
    let y = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * math::powf(x, 1.0 / 2.4) - 0.055 };
    (255.0 * y + 0.5) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illumination::Uniform;
    use crate::illumination::test_scenes::{lambert, quad, scene};
    use crate::scene::Environment;

    #[test]
    fn an_even_sky_over_a_plain_has_a_map_without_error() {
        let mesh = quad(Vec3::new(-1.0, -1.0, 0.0), Vec3::X * 2.0, Vec3::Y * 2.0);
        let mut plain = scene(mesh, vec![lambert(0.5, 0.0)], Vec::new());
        plain.environment = Some(Environment::constant(Vec3::ONE));
        let parts = (&plain, &Accel::build(&plain), &Lights::build(&plain));
        let camera = plain.cameras[0].camera;
        let of = |e: f32| ErrorMap::new(parts, &Uniform(Vec3::splat(e)), &camera, [24, 16], 4);
        let exact = of(std::f32::consts::PI);
        assert!(exact.relative_error(2) < 0.02, "{}", exact.relative_error(2));
        assert!((of(1.1 * std::f32::consts::PI).relative_error(4) - 0.1).abs() < 0.01);
        assert!(exact.pixels.iter().flatten().count() > 50);
        assert_eq!(exact.picture().len(), 24 * 16 * 9);
    }
}
