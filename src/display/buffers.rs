//! What a display pass fills.

use glam::Vec3;

use crate::geometry::Hit;
use crate::image::Map2d;
use crate::scene::TextureId;

/// Where the primary ray through a pixel's centre ends.
#[derive(Clone, Copy, Debug, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct PrimaryHit {
    /// Distance along the ray; infinite on a miss.
    pub t: f32,
    /// Triangle, meaningless on a miss.
    pub triangle: u32,
    /// Barycentric weight of the second corner.
    pub b1: f32,
    /// Barycentric weight of the third corner.
    pub b2: f32,
}

impl PrimaryHit {
    /// No hit.
    pub const MISS: Self = Self { t: f32::INFINITY, triangle: u32::MAX, b1: 0.0, b2: 0.0 };

    /// Whether there is no hit.
    pub fn is_miss(&self) -> bool {
        self.triangle == u32::MAX
    }

    /// As the geometry index gives it.
    pub fn hit(&self) -> Option<Hit> {
        (!self.is_miss()).then_some(Hit { t: self.t, triangle: self.triangle, b1: self.b1, b2: self.b2 })
    }
}

impl From<Option<Hit>> for PrimaryHit {
    fn from(hit: Option<Hit>) -> Self {
        hit.map_or(Self::MISS, |h| Self { t: h.t, triangle: h.triangle, b1: h.b1, b2: h.b2 })
    }
}

/// A texture and the mip level a pixel wants of it, in one word (Dumont 2003 §5.2.4.1; integer
/// instead of the paper's 8-bit colour channels, correction D7).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TextureLevel(u32);

impl TextureLevel {
    /// No texture.
    pub const NONE: Self = Self(u32::MAX);
    /// Steps of a level that are told apart.
    const STEPS: f32 = 8.0;

    /// Texture and level; the level is kept to an eighth, between 0 and 31.
    pub fn new(texture: TextureId, level: f32) -> Self {
        // The cast turns NaN into 0.
        let level = (level.clamp(0.0, 31.0) * Self::STEPS) as u32;
        Self((texture.0.min(0x00ff_fffe) << 8) | level)
    }

    /// The texture.
    pub fn texture(self) -> Option<TextureId> {
        (self != Self::NONE).then_some(TextureId(self.0 >> 8))
    }

    /// The level, in eighths.
    pub fn level(self) -> f32 {
        (self.0 & 0xff) as f32 / Self::STEPS
    }
}

/// The frame buffers of one view, `width × height` each.
#[derive(Clone, Debug)]
pub struct FrameBuffers {
    /// How densely it is drawn: 1 where each pixel has its ray; 2 where a whole picture would come late, and there is a
    /// ray for each 2 × 2 pixels at least; 4 where that would, too, and there are no more than these
    /// ([`super::cpu_pass::draw_in_cells`]).
    pub cell: u32,
    /// Base layer: emission + diffuse reflection, linear radiance.
    pub color: Map2d<Vec3>,
    /// Depth along the view axis, infinite on a miss.
    pub depth: Map2d<f32>,
    /// Object id: 0 for diffuse surfaces and the background.
    pub object: Map2d<u32>,
    /// Texture and mip level wanted; empty (0 × 0) where the scene's plan skips it.
    pub texture: Map2d<TextureLevel>,
    /// Primary hits, from which samples are traced without shooting the ray again.
    pub hit: Map2d<PrimaryHit>,
}

impl FrameBuffers {
    /// Buffers of a background.
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            cell: 1,
            color: Map2d::new(width, height, Vec3::ZERO),
            depth: Map2d::new(width, height, f32::INFINITY),
            object: Map2d::new(width, height, 0),
            texture: Map2d::new(width, height, TextureLevel::NONE),
            hit: Map2d::new(width, height, PrimaryHit::MISS),
        }
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.color.width()
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.color.height()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texture_levels_round_trip_to_an_eighth() {
        for (id, level) in [(0, 0.0), (7, 3.125), (100_000, 12.5)] {
            let word = TextureLevel::new(TextureId(id), level);
            assert_eq!((word.texture(), word.level()), (Some(TextureId(id)), level));
        }
        assert_eq!(TextureLevel::NONE.texture(), None);
        assert_eq!(TextureLevel::new(TextureId(1), f32::NAN).level(), 0.0);
    }
}
