//! What of a surface does not depend on the view: the part that the display draws.

use std::cell::Cell;

use glam::{Vec2, Vec3};

use super::interaction::mip_level;
use crate::geometry::Hit;
use crate::scene::recipe::{Made, Recipe};
use crate::scene::{Material, MaterialId, MetalRough, Model, Reflectance, Scene, Texture, TextureId};

/// A point on a surface, as far as its diffuse part and its emission go.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Triangle.
    pub triangle: u32,
    /// Barycentric weight of the second corner.
    pub b1: f32,
    /// Barycentric weight of the third corner.
    pub b2: f32,
    /// Material.
    pub material: MaterialId,
    /// Whether it is seen from its back.
    pub back: bool,
    /// Texture coordinates; zero where the material has no picture.
    pub uv: Vec2,
    /// Texture coordinates per scene unit: √(uv area / area).
    pub uv_density: f32,
    /// Width of the ray's cone, scene units.
    pub footprint: f32,
}

/// Twice the area of the triangle spanned by `e1` and `e2` times its normal, or, where that underflows, a vector
/// of the same direction; zero for triangles without area.
#[inline]
pub(in crate::transport) fn area_normal(e1: Vec3, e2: Vec3) -> Vec3 {
    let cross = e1.cross(e2);
    if cross.length_squared() > 0.0 {
        return cross;
    }
    let scale = e1.abs().max(e2.abs()).max_element().max(f32::MIN_POSITIVE);
    (e1 / scale).cross(e2 / scale)
}

impl SurfacePoint {
    /// Where a ray along `direction` ends, seen through a cone of width `footprint`, scene units.
    #[inline]
    pub fn at(scene: &Scene, direction: Vec3, hit: &Hit, footprint: f32) -> Self {
        let mesh = &scene.mesh;
        let vertices = mesh.triangles[hit.triangle as usize].map(|v| v as usize);
        let [a, b, c] = vertices.map(|v| mesh.positions[v]);
        let normal = area_normal(b - a, c - a);
        let material = mesh.materials[hit.triangle as usize];
        let mut point = Self {
            triangle: hit.triangle,
            b1: hit.b1,
            b2: hit.b2,
            material,
            back: normal.dot(direction) > 0.0,
            uv: Vec2::ZERO,
            uv_density: 0.0,
            footprint,
        };
        let m = point.material(scene);
        if m.picture().is_some() || m.model.recipe().is_some() {
            let uvs = vertices.map(|v| mesh.uvs[v]);
            let (uv, density) = texture_coordinates(uvs, hit.b1, hit.b2, (b - a).cross(c - a).length());
            (point.uv, point.uv_density) = (uv, density);
        }
        point
    }

    /// The material.
    #[inline]
    pub fn material<'s>(&self, scene: &'s Scene) -> &'s Material {
        &scene.materials[self.material.0 as usize]
    }

    /// The mip level at which a texture is read here. A function of the ray alone, so that displays and tracers read
    /// the same.
    #[inline]
    pub fn texture_level(&self, texture: &Texture) -> f32 {
        mip_level(self.uv_density * texture.placement.density(), self.footprint, texture.size(0))
    }

    /// The same point with the mesh's second set of coordinates in the place of the first.
    #[cold]
    fn on_second_set(&self, scene: &Scene) -> Self {
        let mesh = &scene.mesh;
        let [a, b, c] = mesh.corners(self.triangle);
        let corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)];
        let uvs = corners.map(|(b1, b2)| mesh.coordinates(self.triangle, b1, b2, true));
        let area = (b - a).cross(c - a).length();
        let (uv, uv_density) = texture_coordinates(uvs, self.b1, self.b2, area);
        Self { uv, uv_density, ..*self }
    }

    /// A texture's colour here, linear RGB and alpha.
    #[inline]
    pub fn texel(&self, scene: &Scene, map: TextureId) -> [f32; 4] {
        let texture = &scene.textures[map.0 as usize];
        if texture.placement.second {
            let other = self.on_second_set(scene);
            return texture.sample(other.uv, other.texture_level(texture));
        }
        texture.sample(self.uv, self.texture_level(texture))
    }

    /// [`Self::texel`] of two textures that lie on each other, in one look.
    #[inline]
    pub fn texels(&self, scene: &Scene, maps: [TextureId; 2]) -> [[f32; 4]; 2] {
        let [first, second] = maps.map(|map| &scene.textures[map.0 as usize]);
        if first.placement.second {
            return maps.map(|map| self.texel(scene, map));
        }
        first.sample_with(second, self.uv, self.texture_level(first))
    }

    /// A reflectance here, in [0, 1].
    #[inline]
    pub fn reflectance(&self, scene: &Scene, r: &Reflectance) -> Vec3 {
        let color = match r.map {
            None => r.color,
            Some(map) => {
                let [red, green, blue, _] = self.texel(scene, map);
                r.color * Vec3::new(red, green, blue)
            }
        };
        color.clamp(Vec3::ZERO, Vec3::ONE)
    }

    /// What a recipe makes here. Several of its numbers may lie in one map, which is read once.
    pub fn made(&self, scene: &Scene, recipe: &Recipe) -> Made {
        type Look = Option<(TextureId, [f32; 4])>;
        let last: Cell<[Look; 4]> = Cell::new([None; 4]);
        recipe.at(|map| {
            let known = last.get();
            if let Some((_, texel)) = known.iter().flatten().find(|(id, _)| *id == map) {
                return *texel;
            }
            let texel = self.texel(scene, map);
            let [first, second, third, _] = known;
            last.set([Some((map, texel)), first, second, third]);
            texel
        })
    }

    /// Albedo for light that falls on the other side and leaves on this one, per band: of leaves, paper, shades of lamps.
    /// 0 for nearly everything.
    #[inline]
    pub fn passed_albedo(&self, scene: &Scene) -> Vec3 {
        match &self.material(scene).model {
            Model::MetalRough(m) if m.recipe.is_some() => self.passed_by_recipe(scene, m),
            _ => Vec3::ZERO,
        }
    }

    #[cold]
    fn passed_by_recipe(&self, scene: &Scene, m: &MetalRough) -> Vec3 {
        match m.recipe.as_deref().filter(|r| r.passes.is_some()) {
            Some(recipe) => self.made(scene, recipe).passed,
            None => Vec3::ZERO,
        }
    }

    /// Emitted radiance on the front side; zero on the back.
    #[inline]
    pub fn emission(&self, scene: &Scene) -> Vec3 {
        let m = self.material(scene);
        if !(m.shadeless || m.is_emissive() && !self.back) {
            return Vec3::ZERO;
        }
        match m.emission.map {
            None => m.emission.color,
            Some(map) => {
                let [r, g, b, _] = self.texel(scene, map);
                m.emission.color * Vec3::new(r, g, b)
            }
        }
    }

    /// Albedo of the view-independent part, per band. The back of a one-sided surface is black.
    #[inline]
    pub fn diffuse_albedo(&self, scene: &Scene) -> Vec3 {
        let m = self.material(scene);
        if self.back && !m.two_sided {
            return Vec3::ZERO;
        }
        match &m.model {
            Model::Lambert { albedo } => self.reflectance(scene, albedo),
            Model::MetalRough(m) => match &m.recipe {
                None => self.reflectance(scene, &m.diffuse),
                Some(recipe) => self.made(scene, recipe).diffuse,
            },
            Model::CookTorrance { diffuse, .. } | Model::Ward { diffuse, .. } => {
                self.reflectance(scene, diffuse)
            }
            Model::Plastic { albedo, coat } => coat.albedo(self.reflectance(scene, albedo)),
            Model::Mirror { .. }
            | Model::Conductor { .. }
            | Model::Metal { .. }
            | Model::Dielectric { .. } => Vec3::ZERO,
        }
    }
}

/// Texture coordinates at barycentrics, and their density √(uv area / area); zero where they are not finite.
#[inline]
pub(super) fn texture_coordinates([a, b, c]: [Vec2; 3], b1: f32, b2: f32, doubled_area: f32) -> (Vec2, f32) {
    let uv = a * (1.0 - b1 - b2) + b * b1 + c * b2;
    let determinant = (b - a).perp_dot(c - a);
    let density = if doubled_area > 0.0 { (determinant.abs() / doubled_area).sqrt() } else { 0.0 };
    (if uv.is_finite() { uv } else { Vec2::ZERO }, if density.is_finite() { density } else { 0.0 })
}
