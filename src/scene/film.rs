//! A film thinner than light is long, and the colours of what it reflects (Belcour & Barla 2017, in the form of glTF's
//! `KHR_materials_iridescence`).
//!
//! Light that the film's upper face reflects meets light that went to its lower face and back. The sum over orders of
//! reflection is R₁₂ + Rₛ without interference, and each order m adds 2 Cₘ cos(m φ), which three bands see through the
//! Fourier transforms of their sensitivities, here of the CIE's, fitted by Gaussians.

use std::f32::consts::{PI, TAU};

use glam::Vec3;

use crate::math;

/// A film in air on a surface.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Film {
    /// How much of it is there, in [0, 1].
    pub strength: f32,
    /// Its refractive index.
    pub ior: f32,
    /// Its thickness, nanometres.
    pub thickness: f32,
}

/// Orders of reflection whose interference is seen; of later ones bands see nothing.
const ORDERS: i32 = 2;

impl Film {
    /// Reflectance of film and base together towards `cosine`, per band, where the film is all there; `f0` is that of the
    /// base in air straight on.
    pub fn reflectance(&self, cosine: f32, f0: Vec3) -> Vec3 {
        // As it vanishes it becomes air.
        let ior = 1.0 + (self.ior - 1.0) * smoothstep(self.thickness / 0.03);
        let cosine = cosine.clamp(0.0, 1.0);
        if ior <= 1.0 {
            return f0.map(|f| schlick(f, cosine));
        }
        let inside = 1.0 - (1.0 - cosine * cosine) / (ior * ior);
        if inside <= 0.0 {
            return Vec3::ONE;
        }
        let inside = inside.sqrt();
        let upper = schlick(normal_reflectance(ior, 1.0), cosine);
        let passed = 1.0 - upper;
        let difference = 2.0 * ior * self.thickness * inside;
        let bases = f0.clamp(Vec3::ZERO, Vec3::splat(0.9999)).map(|f| {
            let root = f.sqrt();
            (1.0 + root) / (1.0 - root)
        });
        let lower = bases.map(|base| schlick(normal_reflectance(base, ior), inside));
        // Half a wave is lost where light meets what is denser; so much more or less than at the upper face.
        let turned = if ior < 1.0 { 0.0 } else { PI };
        let phase = bases.map(|base| turned + if base < ior { PI } else { 0.0 });
        let both = (lower * upper).clamp(Vec3::ZERO, Vec3::splat(0.9999));
        let returned = lower * (passed * passed) / (Vec3::ONE - both);
        let mut sum = returned + upper;
        let mut amplitude = returned - passed;
        for m in 1..=ORDERS {
            amplitude *= both.map(f32::sqrt);
            sum += amplitude * sensitivity(m as f32 * difference, phase * m as f32) * 2.0;
        }
        // Some sums are colours that the bands cannot show.
        sum.clamp(Vec3::ZERO, Vec3::ONE)
    }

    /// The reflectance straight on with which Schlick's Fresnel, rising to `f90`, is that of film and base towards
    /// `cosine`, as much of it as is film.
    pub fn normal_reflectance(&self, cosine: f32, f0: Vec3, f90: Vec3) -> Vec3 {
        let m = 1.0 - cosine.clamp(0.0, 1.0);
        let grazing = (m * m * (m * m) * m).min(0.9999);
        let seen = self.reflectance(cosine, f0);
        let plain = ((seen - f90 * grazing) / (1.0 - grazing)).clamp(Vec3::ZERO, Vec3::ONE);
        f0 + (plain - f0) * self.strength
    }
}

fn smoothstep(x: f32) -> f32 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

fn schlick(f0: f32, cosine: f32) -> f32 {
    let m = 1.0 - cosine;
    f0 + (1.0 - f0) * (m * m * (m * m) * m)
}

/// Between indices `to` and `from`, straight on.
fn normal_reflectance(to: f32, from: f32) -> f32 {
    let r = (to - from) / (to + from);
    r * r
}

/// What the bands see of a cosine of this path difference (nanometres) and phase: 1 and more for none.
fn sensitivity(difference: f32, shift: Vec3) -> Vec3 {
    // Height, place and width of the Gaussians of X, Y, Z, and of the second one of X; of the extension's text.
    const GAUSSIANS: [[f32; 3]; 4] = [
        [5.4856e-13, 1.6810e6, 4.3278e9],
        [4.4201e-13, 1.7953e6, 9.3046e9],
        [5.2481e-13, 2.2084e6, 6.6121e9],
        [9.7470e-14, 2.2399e6, 4.5282e9],
    ];
    const UNIT: f32 = 1.0685e-7;
    let phase = TAU * difference * 1e-9;
    let of = |g: usize, shift: f32| {
        let [height, place, width] = GAUSSIANS[g];
        let envelope = math::exp(-width * phase * phase);
        height * (TAU * width).sqrt() * math::cos(place * phase + shift) * envelope / UNIT
    };
    let [x, y, z] = [of(0, shift.x) + of(3, shift.x), of(1, shift.y), of(2, shift.z)];
    // CIE XYZ to linear Rec. 709.
    Vec3::new(
        3.240_454_2 * x - 1.537_138_5 * y - 0.498_531_4 * z,
        -0.969_266 * x + 1.876_010_8 * y + 0.041_556 * z,
        0.055_643_4 * x - 0.204_025_9 * y + 1.057_225_2 * z,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn film(thickness: f32) -> Film {
        Film { strength: 1.0, ior: 1.3, thickness }
    }

    #[test]
    fn no_film_is_the_base_alone() {
        for f0 in [0.04, 0.3, 0.9] {
            for cosine in [1.0, 0.7, 0.2] {
                let found = film(0.0).reflectance(cosine, Vec3::splat(f0));
                assert!((found - schlick(f0, cosine)).abs().max_element() < 1e-3, "{f0} {cosine} {found}");
            }
        }
    }

    /// Waves that are far apart do not interfere: what is left is the sum of all reflections' powers.
    #[test]
    fn a_thick_film_has_no_colour() {
        let (f0, cosine) = (0.5f32, 0.8f32);
        let found = film(20_000.0).reflectance(cosine, Vec3::splat(f0));
        let inside = (1.0 - (1.0 - cosine * cosine) / (1.3 * 1.3)).sqrt();
        let base = (1.0 + f0.sqrt()) / (1.0 - f0.sqrt());
        let a = schlick(normal_reflectance(1.3, 1.0), cosine);
        let b = schlick(normal_reflectance(base, 1.3), inside);
        // The geometric series a + (1 − a)² b (1 + a b + …).
        let powers: f32 = a + (0..60).map(|n| (1.0 - a) * (1.0 - a) * b * (a * b).powi(n)).sum::<f32>();
        assert!((found - powers).abs().max_element() < 1e-4, "{found} {powers}");
    }

    #[test]
    fn thin_films_are_coloured_and_colours_change_with_the_angle() {
        let chroma = |v: Vec3| v.max_element() - v.min_element();
        let white = Vec3::splat(0.3);
        for thickness in [250.0, 400.0, 550.0] {
            let (straight, aside) =
                (film(thickness).reflectance(1.0, white), film(thickness).reflectance(0.4, white));
            assert!(chroma(straight) > 0.01 && (straight - aside).length() > 0.02, "{straight} {aside}");
        }
        // Where it is half there, half of its effect is.
        let half = Film { strength: 0.5, ..film(400.0) };
        let [a, b] = [film(400.0), half].map(|f| f.normal_reflectance(0.9, white, Vec3::ONE));
        assert!((b - (a + white) * 0.5).abs().max_element() < 1e-6);
        for v in [f32::NAN, f32::INFINITY, 1e30] {
            let found = film(v).reflectance(0.5, white);
            assert!(v.is_nan() || found.is_finite(), "{v}");
        }
    }
}
