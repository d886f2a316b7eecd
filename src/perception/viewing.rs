//! The display and its viewer: displayed luminance in cd/m², pixels per degree (REFERENCE §8.1, §8.6).

use crate::image::luminance;
use crate::math;
use glam::Vec3;

/// Luminance of the display and size of its pixels in the eye.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Viewing {
    /// Luminance of white, cd/m².
    pub white_cd_m2: f32,
    /// Luminance of black, cd/m²: what the screen leaks and reflects.
    pub black_cd_m2: f32,
    /// Pixels per degree of visual angle at the centre of the screen.
    pub pixels_per_degree: f32,
}

impl Viewing {
    /// A display whose white has `white_cd_m2` and whose black a hundredth of that, seen from the centre of projection:
    /// `width` pixels across a horizontal field of view of `fov_x` radians.
    pub fn from_centre_of_projection(white_cd_m2: f32, width: usize, fov_x: f32) -> Self {
        Self {
            white_cd_m2,
            black_cd_m2: 0.01 * white_cd_m2,
            pixels_per_degree: pixels_per_degree_of_camera(width, fov_x),
        }
    }

    /// Luminance in cd/m² of displayed linear RGB in [0, 1].
    #[inline]
    pub fn luminance(&self, linear: Vec3) -> f32 {
        self.black_cd_m2 + (self.white_cd_m2 - self.black_cd_m2) * luminance(linear)
    }
}

/// Pixels per degree at the centre of a picture of `width` pixels across `fov_x` radians, seen from the centre of
/// projection.
pub fn pixels_per_degree_of_camera(width: usize, fov_x: f32) -> f32 {
    let half = math::tan((0.5 * fov_x).clamp(1e-3, 1.57));
    width as f32 / (2.0 * half).to_degrees()
}

/// Pixels per degree of a screen of `width` pixels and `metres` width seen from `distance` metres.
pub fn pixels_per_degree_of_screen(width: usize, metres: f32, distance: f32) -> f32 {
    (distance * width as f32 / metres.max(1e-3)).to_radians()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_the_reference() {
        let camera = pixels_per_degree_of_camera(512, 45f32.to_radians());
        assert!((camera - 10.787).abs() < 1e-3, "{camera}");
        let screen = pixels_per_degree_of_screen(1920, 0.53, 0.6);
        assert!((screen - 37.9362).abs() < 1e-3, "{screen}");
    }
}
