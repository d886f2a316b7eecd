//! Where a ray meets a surface: position with its error, frames, texture coordinates, side.

use glam::{Vec2, Vec3};

use super::bsdf::{Bsdf, BsdfSample};
use super::surface::{SurfacePoint, area_normal, texture_coordinates};
use crate::geometry::{Hit, Ray, gamma, offset_origin};
use crate::math;
use crate::scene::{Material, MaterialId, Scene, TextureId};

/// A point on a surface, seen along a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interaction {
    /// Position, from the barycentrics.
    pub position: Vec3,
    /// Bound of the position's rounding error per axis (REFERENCE §5.4 a).
    pub error: Vec3,
    /// Unit normal of the triangle's front (counter-clockwise) side.
    pub geometric_normal: Vec3,
    /// Unit shading normal, with bumps, in the hemisphere of `geometric_normal`.
    pub shading_normal: Vec3,
    /// Unit shading normal without bumps, in the same hemisphere.
    pub smooth_normal: Vec3,
    /// Unit tangent, perpendicular to the shading normal; along ∂p/∂u where the material has a direction or bumps, any
    /// that changes smoothly with the normal elsewhere.
    pub tangent: Vec3,
    /// shading_normal × tangent, or against it where coordinates are mirrored.
    pub bitangent: Vec3,
    /// Texture coordinates.
    pub uv: Vec2,
    /// Texture coordinates per scene unit: √(uv area / area); 0 where the triangle has none.
    pub uv_density: f32,
    /// Triangle.
    pub triangle: u32,
    /// Barycentric weight of the second corner.
    pub b1: f32,
    /// Barycentric weight of the third corner.
    pub b2: f32,
    /// Material.
    pub material: MaterialId,
    /// Object id, 0 for diffuse surfaces.
    pub object: u32,
    /// Whether the ray met the back side.
    pub back: bool,
    /// Whether the shading normal was tilted to be visible from `wo`: another direction may see another one.
    pub tilted: bool,
    /// Unit vector against the ray's direction.
    pub wo: Vec3,
    /// Distance along the ray, in its own units.
    pub t: f32,
    /// Width of the ray's cone here, scene units, which decides the mip level that textures are read at; 0 reads the
    /// finest.
    pub footprint: f32,
}

/// Which mip level a texture is read at, from the width of the ray's footprint.
#[inline]
pub fn mip_level(uv_density: f32, footprint: f32, texture_size: [usize; 2]) -> f32 {
    let texels = footprint * uv_density * texture_size[0].max(texture_size[1]) as f32;
    if texels > 1.0 { math::log2(texels).min(31.0) } else { 0.0 }
}

/// Least cosine between the shading normal and the direction that it is seen from.
const GRAZING: f32 = 0.01;

impl Interaction {
    /// The interaction of a hit of `ray`.
    pub fn at(scene: &Scene, ray: &Ray, hit: &Hit) -> Self {
        let mesh = &scene.mesh;
        let vertices = mesh.triangles[hit.triangle as usize].map(|v| v as usize);
        let [a, b, c] = vertices.map(|v| mesh.positions[v]);
        let (b1, b2) = (hit.b1, hit.b2);
        let b0 = 1.0 - b1 - b2;
        let position = a * b0 + b * b1 + c * b2;
        let error = ((a * b0).abs() + (b * b1).abs() + (c * b2).abs()) * gamma(7);
        let (e1, e2) = (b - a, c - a);
        // Hit triangles have an area, but its square may underflow.
        let area_normal = area_normal(e1, e2);
        let wo = -ray.direction.normalize();
        let geometric_normal = area_normal.try_normalize().unwrap_or(wo);
        let [na, nb, nc] = vertices.map(|v| mesh.normals[v]);
        let mut shading_normal = (na * b0 + nb * b1 + nc * b2).try_normalize().unwrap_or(geometric_normal);
        if !shading_normal.is_finite() {
            shading_normal = geometric_normal;
        }
        if shading_normal.dot(geometric_normal) < 0.0 {
            shading_normal = -shading_normal;
        }
        let uvs = vertices.map(|v| mesh.uvs[v]);
        let (uv, uv_density) = texture_coordinates(uvs, b1, b2, e1.cross(e2).length());
        let material = mesh.materials[hit.triangle as usize];
        let mut at = Self {
            position,
            error,
            geometric_normal,
            shading_normal,
            smooth_normal: shading_normal,
            tangent: Vec3::ZERO,
            bitangent: Vec3::ZERO,
            uv,
            uv_density,
            triangle: hit.triangle,
            b1,
            b2,
            material,
            object: mesh.objects[hit.triangle as usize],
            back: area_normal.dot(ray.direction) > 0.0,
            tilted: false,
            wo,
            t: hit.t,
            footprint: 0.0,
        };
        let m = at.material(scene);
        if m.has_direction() {
            let [ta, tb, tc] = uvs;
            let (d1, d2) = (tb - ta, tc - ta);
            let determinant = d1.perp_dot(d2);
            let along_u = if determinant != 0.0 { (e1 * d2.y - e2 * d1.y) / determinant } else { e1 };
            let (along_u, sign) = match mesh.tangent(hit.triangle, b1, b2) {
                None => (along_u, 1.0),
                Some(tangent) => (tangent.truncate(), tangent.w),
            };
            at.set_frame(along_u, sign);
            at.perturb(scene, along_u, sign);
            at.keep_visible(sign);
        } else {
            at.keep_visible(1.0);
            (at.tangent, at.bitangent) = at.shading_normal.any_orthonormal_pair();
        }
        at
    }

    /// The same point as another unit direction on its side sees it; `None` where that is no different but for `wo`.
    pub fn seen_from(&self, scene: &Scene, direction: Vec3) -> Option<Self> {
        if !self.tilted && direction.dot(self.facing_shading()) >= GRAZING {
            return None;
        }
        let hit = Hit { t: self.t, triangle: self.triangle, b1: self.b1, b2: self.b2 };
        let ray = Ray::new(self.position + direction, -direction);
        Some(Self::at(scene, &ray, &hit).with_footprint(self.footprint))
    }

    /// The other side of the same point, as a viewer there sees it who looks the opposite way.
    pub fn turned(&self, scene: &Scene) -> Self {
        let hit = Hit { t: self.t, triangle: self.triangle, b1: self.b1, b2: self.b2 };
        Self::at(scene, &Ray::new(self.position - self.wo, self.wo), &hit).with_footprint(self.footprint)
    }

    /// [`Self::turned`] of a point of which no direction is known: as it is seen straight on.
    pub fn turned_to(scene: &Scene, point: &SurfacePoint) -> Self {
        let [a, b, c] = scene.mesh.corners(point.triangle);
        let normal = area_normal(b - a, c - a).normalize_or(Vec3::Z);
        let from = if point.back { normal } else { -normal };
        let position = a * (1.0 - point.b1 - point.b2) + b * point.b1 + c * point.b2;
        let hit = Hit { t: 1.0, triangle: point.triangle, b1: point.b1, b2: point.b2 };
        Self::at(scene, &Ray::new(position + from, -from), &hit).with_footprint(point.footprint)
    }

    /// Whether a direction on either side is so close to the surface that the shading normal would be tilted for it.
    pub fn is_grazed_by(&self, direction: Vec3) -> bool {
        direction.dot(self.shading_normal).abs() < GRAZING
    }

    /// Whether light takes a sample of a Dirac lobe in both directions: not where the normal is bent for either of them.
    pub fn is_reversible(&self, bsdf: &Bsdf, sample: &BsdfSample) -> bool {
        !self.tilted && !self.is_grazed_by(sample.wi) && bsdf.is_reversible(self.wo, sample)
    }

    /// The same point seen through a cone of this width, scene units.
    #[inline]
    pub fn with_footprint(mut self, footprint: f32) -> Self {
        self.footprint = footprint;
        self
    }

    /// As far as the diffuse part and the emission go.
    #[inline]
    pub fn point(&self) -> SurfacePoint {
        SurfacePoint {
            triangle: self.triangle,
            b1: self.b1,
            b2: self.b2,
            material: self.material,
            back: self.back,
            uv: self.uv,
            uv_density: self.uv_density,
            footprint: self.footprint,
        }
    }

    /// The material.
    #[inline]
    pub fn material<'s>(&self, scene: &'s Scene) -> &'s Material {
        &scene.materials[self.material.0 as usize]
    }

    /// Geometric normal on the viewer's side.
    #[inline]
    pub fn facing_geometric(&self) -> Vec3 {
        if self.back { -self.geometric_normal } else { self.geometric_normal }
    }

    /// Shading normal on the viewer's side.
    #[inline]
    pub fn facing_shading(&self) -> Vec3 {
        if self.back { -self.shading_normal } else { self.shading_normal }
    }

    fn set_frame(&mut self, along_u: Vec3, sign: f32) {
        let n = self.shading_normal;
        self.tangent =
            (along_u - n * n.dot(along_u)).try_normalize().unwrap_or_else(|| n.any_orthonormal_vector());
        self.bitangent = n.cross(self.tangent) * sign;
    }

    /// The normal that a map says in a frame of tangent, bitangent and normal; not of unit length.
    fn mapped(&self, scene: &Scene, map: TextureId, frame: [Vec3; 3]) -> Vec3 {
        let texture = &scene.textures[map.0 as usize];
        let uv = if texture.placement.second {
            scene.mesh.coordinates(self.triangle, self.b1, self.b2, true)
        } else {
            self.uv
        };
        let [x, y, z, _] = texture.sample(uv, 0.0);
        let (x, y, z) = (2.0 * x - 1.0, 2.0 * y - 1.0, 2.0 * z - 1.0);
        let [tangent, bitangent, normal] = frame;
        tangent * x + bitangent * y + normal * z.max(0.05)
    }

    /// The normal of a coat, which bumps of what is below leave as it is: the smooth one, or what its own map says; on the
    /// viewer's side, tilted to be visible.
    pub(super) fn coat_normal(&self, scene: &Scene, map: Option<TextureId>) -> Vec3 {
        let n = self.smooth_normal;
        let own = map.and_then(|map| {
            // Along the tangent that is there, which bumps turned a little.
            let tangent = (self.tangent - n * n.dot(self.tangent)).try_normalize()?;
            let sign = self.shading_normal.cross(self.tangent).dot(self.bitangent).signum();
            self.mapped(scene, map, [tangent, n.cross(tangent) * sign, n]).try_normalize()
        });
        let side = if self.back { -1.0 } else { 1.0 };
        let normal = own.filter(|n| n.is_finite() && n.dot(self.geometric_normal) > 0.0).unwrap_or(n) * side;
        let cosine = normal.dot(self.wo);
        let tilted = normal + self.wo * (GRAZING - cosine).max(0.0);
        tilted.try_normalize().unwrap_or(normal)
    }

    /// Normal maps and height fields.
    fn perturb(&mut self, scene: &Scene, along_u: Vec3, sign: f32) {
        let m = &scene.materials[self.material.0 as usize];
        let mut normal = self.shading_normal;
        if let Some(map) = m.normal_map {
            let frame = [self.tangent, self.bitangent, self.shading_normal];
            normal = self.mapped(scene, map, frame);
        } else if let Some(map) = m.bump_map {
            let texture = &scene.textures[map.0 as usize];
            let [w, h] = texture.size(0);
            let step = Vec2::new(1.0 / w.max(1) as f32, 1.0 / h.max(1) as f32);
            let height = |uv: Vec2| {
                let [r, g, b, _] = texture.sample(uv, 0.0);
                (r + g + b) / 3.0
            };
            let here = height(self.uv);
            let gradient = Vec2::new(
                (height(self.uv + Vec2::X * step.x) - here) / step.x,
                (height(self.uv + Vec2::Y * step.y) - here) / step.y,
            ) * (m.bump_scale * self.uv_density);
            normal = self.shading_normal - self.tangent * gradient.x - self.bitangent * gradient.y;
        }
        if let Some(normal) = normal.try_normalize()
            && normal.is_finite()
            && normal.dot(self.geometric_normal) > 0.0
        {
            self.shading_normal = normal;
            self.set_frame(along_u, sign);
        }
    }

    /// Where interpolation or bumps turned the shading normal away from the viewer, tilts it back until
    /// the view just grazes it, so that reflections do not go black (as Keller et al. 2017 do for bumps).
    fn keep_visible(&mut self, sign: f32) {
        let side = if self.back { -1.0 } else { 1.0 };
        let cosine = side * self.shading_normal.dot(self.wo);
        if cosine < GRAZING {
            self.tilted = true;
            let tilted = self.shading_normal + self.wo * (side * (GRAZING - cosine));
            if let Some(n) = tilted.try_normalize() {
                self.shading_normal = n;
                self.set_frame(self.tangent, sign);
            }
        }
    }

    /// A ray that leaves the surface along `direction`: its origin lies outside the error bounds, on the side that
    /// it goes to, and it ignores the triangle it leaves (REFERENCE §5.4 a).
    #[inline]
    pub fn spawn(&self, direction: Vec3) -> Ray {
        let origin = offset_origin(self.position, self.error, self.geometric_normal, direction);
        Ray { ignore: self.triangle, ..Ray::new(origin, direction) }
    }

    /// A ray to `target` that ends just before it: `t` = 1 at the target.
    #[inline]
    pub fn spawn_to(&self, target: Vec3) -> Ray {
        let ray = self.spawn(target - self.position);
        Ray { direction: target - ray.origin, t_max: 1.0 - 1e-4, ..ray }
    }
}
