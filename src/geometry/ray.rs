//! Rays and hits.

use glam::Vec3;

/// A half-open stretch of a line: points `origin + t · direction` with `t_min < t < t_max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Origin.
    pub origin: Vec3,
    /// Direction; need not be of unit length, `t` counts in it.
    pub direction: Vec3,
    /// Hits at or before this are ignored.
    pub t_min: f32,
    /// Hits at or beyond this are ignored.
    pub t_max: f32,
    /// A triangle that is never hit, as a plane cannot be hit again by a ray that leaves it;
    /// [`Ray::NOTHING`] otherwise.
    pub ignore: u32,
}

impl Ray {
    /// No triangle to ignore.
    pub const NOTHING: u32 = u32::MAX;

    /// A ray without end.
    #[inline]
    pub const fn new(origin: Vec3, direction: Vec3) -> Self {
        Self { origin, direction, t_min: 0.0, t_max: f32::INFINITY, ignore: Self::NOTHING }
    }

    /// The point at `t`.
    #[inline]
    pub fn at(&self, t: f32) -> Vec3 {
        self.origin + self.direction * t
    }
}

/// Where a ray meets a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance in units of the ray's direction.
    pub t: f32,
    /// Index of the triangle in the mesh.
    pub triangle: u32,
    /// Barycentric weight of the second corner.
    pub b1: f32,
    /// Barycentric weight of the third corner.
    pub b2: f32,
}
