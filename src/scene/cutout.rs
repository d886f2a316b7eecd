//! Cut-out opacity: whether a surface is there at a point.

use glam::Vec3;

use super::{Scene, TriangleIndex};

impl Scene {
    /// Whether the surface of a triangle is there at barycentrics (1 − `b1` − `b2`, `b1`, `b2`): its opacity
    /// times its mask (the map's alpha if it has one, else its grey) is at least one half.
    pub fn is_opaque_at(&self, t: TriangleIndex, b1: f32, b2: f32) -> bool {
        let material = &self.materials[self.mesh.materials[t as usize].0 as usize];
        let Some(map) = material.opacity_map else { return material.opacity >= 0.5 };
        let texture = &self.textures[map.0 as usize];
        let uv = self.mesh.coordinates(t, b1, b2, texture.placement.second);
        let mask = texture.mask(uv, 0.0);
        material.opacity * mask >= 0.5
    }

    /// Whether an eye at `origin` sees a triangle: not the back of a material whose backs are seen through.
    pub fn faces(&self, t: TriangleIndex, origin: Vec3) -> bool {
        let material = &self.materials[self.mesh.materials[t as usize].0 as usize];
        if !material.culled {
            return true;
        }
        let [a, b, c] = self.mesh.corners(t).map(|p| p - origin);
        (b - a).cross(c - a).dot(a) <= 0.0
    }
}
