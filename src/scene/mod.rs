//! The scene: geometry, materials, lights, cameras. Immutable once built.
//!
//! Lengths in scene units, angles in radians, colours linear RGB (Rec. 709), radiance in
//! W·sr⁻¹·m⁻² per band. Files become a [`Scene`] in a package of their own, `foveal-files`.

mod box_filter;
pub mod bulk;
pub mod camera;
pub mod coat;
pub mod coating;
mod cutout;
pub mod defaults;
pub mod edit;
pub mod environment;
pub mod film;
pub mod fresnel;
pub mod hierarchy;
pub mod kept;
pub mod light_units;
pub mod lobe_albedo;
pub mod material;
pub mod metal_rough;
pub mod microfacet;
pub mod path;
pub mod placement;
pub mod plan;
pub mod recipe;
pub mod sheen;
pub mod split_sum;
#[cfg(test)]
pub mod test_scenes;
mod texels;
pub mod texture;
pub mod thing;

use std::ops::{Deref, DerefMut};
use std::sync::Arc;

use glam::{Vec2, Vec3, Vec4};

pub use camera::{Camera, CameraPath, NamedCamera};
pub use coat::Coat;
pub use environment::Environment;
pub use lobe_albedo::LobeAlbedo;
pub use material::{Distribution, Material, MaterialId, Model, Reflectance, Roughness, TextureId};
pub use metal_rough::MetalRough;
pub use placement::{Placement, Wrap};
pub use sheen::Sheen;
pub use split_sum::SplitSum;
pub use texture::Texture;
pub use thing::{Thing, ThingId, Things};

/// Index of a triangle in [`Mesh::triangles`].
pub type TriangleIndex = u32;

/// The joined triangles of all files. All vectors of vertices have the same length.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Positions, scene units, all finite.
    pub positions: Vec<Vec3>,
    /// Shading normals, unit length, or zero where the file gave none (then the face is flat).
    pub normals: Vec<Vec3>,
    /// Texture coordinates, origin at the lower left as in OBJ; zero where the file gave none.
    pub uvs: Vec<Vec2>,
    /// Other coordinates, for pictures that lie differently ([`Placement::second`]); empty where there are none.
    pub uvs1: Vec<Vec2>,
    /// Unit tangents, along which normal maps and grain lie, and the sign with which normal × tangent is the bitangent;
    /// empty, or zero at a vertex, where that is to follow from the coordinates.
    pub tangents: Vec<Vec4>,
    /// Vertex indices, counter-clockwise seen from the front.
    pub triangles: Vec<[u32; 3]>,
    /// Material of each triangle.
    pub materials: Vec<MaterialId>,
    /// Object id of each triangle: 0 for every diffuse one, ≥ 1 for each non-diffuse group
    /// (REFERENCE §10); an index into [`SceneParts::objects`].
    pub objects: Vec<u32>,
}

impl Mesh {
    /// The three corners of triangle `t`.
    #[inline]
    pub fn corners(&self, t: TriangleIndex) -> [Vec3; 3] {
        self.triangles[t as usize].map(|v| self.positions[v as usize])
    }

    /// Texture coordinates at barycentrics, of the second set or the first.
    #[inline]
    pub fn coordinates(&self, t: TriangleIndex, b1: f32, b2: f32, second: bool) -> Vec2 {
        let set = if second && !self.uvs1.is_empty() { &self.uvs1 } else { &self.uvs };
        let [i, j, k] = self.triangles[t as usize].map(|v| set[v as usize]);
        i * (1.0 - b1 - b2) + j * b1 + k * b2
    }

    /// The tangent at barycentrics, not of unit length, and the sign of its bitangent; `None` where the mesh has none.
    pub fn tangent(&self, t: TriangleIndex, b1: f32, b2: f32) -> Option<Vec4> {
        if self.tangents.is_empty() {
            return None;
        }
        let [i, j, k] = self.triangles[t as usize].map(|v| self.tangents[v as usize]);
        // All corners of a triangle have one sign.
        let sum = i * (1.0 - b1 - b2) + j * b1 + k * b2;
        (i.w * j.w * k.w != 0.0 && sum.is_finite()).then(|| sum.truncate().extend(i.w))
    }

    /// Interpolated vertex normal at a point of a triangle, on the side of `geometric`, its unit normal; that where there
    /// is none.
    pub fn smooth_normal(&self, t: TriangleIndex, b1: f32, b2: f32, geometric: Vec3) -> Vec3 {
        let [a, b, c] = self.triangles[t as usize].map(|v| self.normals[v as usize]);
        let normal = (a * (1.0 - b1 - b2) + b * b1 + c * b2).try_normalize().unwrap_or(geometric);
        if normal.dot(geometric) < 0.0 { -normal } else { normal }
    }

    /// Lower and upper corner of all triangles; a point at the origin where there is none.
    pub fn bounds(&self) -> [Vec3; 2] {
        let mut low = Vec3::INFINITY;
        let mut high = Vec3::NEG_INFINITY;
        for &v in self.triangles.iter().flatten() {
            let p = self.positions[v as usize];
            low = low.min(p);
            high = high.max(p);
        }
        if self.triangles.is_empty() { [Vec3::ZERO; 2] } else { [low, high] }
    }
}

/// A group of triangles of one material in one neighbourhood (Haber 2001 §4.1).
#[derive(Clone, Debug)]
pub struct Object {
    /// The OBJ group or object it came from, or the material's name.
    pub name: String,
    /// Its material; for object 0 that of the first diffuse triangle.
    pub material: MaterialId,
    /// Its triangles, ascending. Object 0 holds every diffuse triangle.
    pub triangles: Vec<TriangleIndex>,
    /// Bounds.
    pub bounds: [Vec3; 2],
    /// Surface area, square scene units.
    pub area: f32,
    /// The object it stands on, if one was found.
    pub parent: Option<u32>,
}

/// A light without area. Area lights are the triangles whose material emits.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub enum Light {
    /// Equal intensity in all directions.
    Point {
        /// Position, scene units.
        position: Vec3,
        /// Radiant intensity per band, W/sr.
        intensity: Vec3,
        /// Distance at which its light ends ([`Light::window`]), scene units; infinite for what nature has.
        range: f32,
    },
    /// A cone with a smooth edge between two half angles.
    Spot {
        /// Position, scene units.
        position: Vec3,
        /// Axis of the cone, unit.
        direction: Vec3,
        /// Radiant intensity inside `inner`, per band, W/sr.
        intensity: Vec3,
        /// Half angle of full intensity, radians.
        inner: f32,
        /// Half angle beyond which nothing is emitted, radians; ≥ `inner`.
        outer: f32,
        /// Distance at which its light ends, scene units.
        range: f32,
    },
    /// Parallel light.
    Directional {
        /// Direction of travel, unit.
        direction: Vec3,
        /// Irradiance at perpendicular incidence per band, W/m².
        irradiance: Vec3,
    },
}

impl Light {
    /// What it is, for people.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Point { .. } => "point light",
            Self::Spot { .. } => "spot light",
            Self::Directional { .. } => "sun",
        }
    }

    /// The factor by which glTF's `range` lets light end: 1 − (d / range)⁴, never below 0.
    pub fn window(range: f32, distance: f32) -> f32 {
        if range.is_infinite() {
            return 1.0;
        }
        let r = distance / range;
        (1.0 - r * r * (r * r)).clamp(0.0, 1.0)
    }

    /// Where a lamp is, and its range; `None` for distant light.
    pub fn lamp(&self) -> Option<(Vec3, f32)> {
        match *self {
            Self::Point { position, range, .. } | Self::Spot { position, range, .. } => {
                Some((position, range))
            }
            Self::Directional { .. } => None,
        }
    }
}

/// How the picture is shown (sidecar `[display]`).
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Display {
    /// Factor on radiance before the tone curve.
    pub exposure: f32,
    /// Whether `exposure` is still to be found from what the start view shows (`world::metered`).
    pub metered: bool,
    /// Luminance of display white, cd/m², for the perceptual metrics.
    pub white_cd_m2: f32,
    /// Its size and how far away it is; seen from the centre of projection where that is not said.
    pub screen: Option<Screen>,
    /// Whether differences between texels are those of CIELAB, so that hue counts, instead of those of luminance.
    pub lab: bool,
}

/// A screen and the distance of its viewer.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Screen {
    /// Pixels across.
    pub pixels: f32,
    /// Width, metres.
    pub width: f32,
    /// Distance of the eye, metres.
    pub distance: f32,
}

impl Default for Display {
    fn default() -> Self {
        Self { exposure: 1.0, metered: false, white_cd_m2: 100.0, screen: None, lab: false }
    }
}

/// An extension of a glTF file.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct ExtensionUse {
    /// As the file calls it.
    pub name: String,
    /// How many objects of the file have it.
    pub times: usize,
    /// What became of it.
    pub became: String,
}

/// Limits of the sidecar (`[budget]`).
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Budget {
    /// Bytes of resident textures.
    pub texture_bytes: Option<u64>,
    /// Frames per second.
    pub fps: Option<f32>,
}

/// Everything the core needs to know of a scene. All but its textures is shared between copies, so that a scene with
/// other mip levels resident costs little more than a list.
#[derive(Clone, Debug)]
pub struct Scene {
    parts: Arc<SceneParts>,
    /// Textures with the levels of their mip chains that are in memory.
    pub textures: Vec<Texture>,
}

impl Deref for Scene {
    type Target = SceneParts;

    fn deref(&self) -> &SceneParts {
        &self.parts
    }
}

/// Copies what is shared.
impl DerefMut for Scene {
    fn deref_mut(&mut self) -> &mut SceneParts {
        Arc::make_mut(&mut self.parts)
    }
}

/// What a scene is besides its textures.
#[derive(Clone, Debug)]
pub struct SceneParts {
    /// Name for reports: the file's stem.
    pub name: String,
    /// Title of the sidecar, or the name.
    pub title: String,
    /// Geometry.
    pub mesh: Mesh,
    /// Materials; never empty.
    pub materials: Vec<Material>,
    /// Lights without area.
    pub lights: Vec<Light>,
    /// Light from outside the scene.
    pub environment: Option<Environment>,
    /// Cameras; never empty, the first is the start view.
    pub cameras: Vec<NamedCamera>,
    /// Camera paths; may be empty.
    pub paths: Vec<CameraPath>,
    /// Groups; index 0 is everything diffuse.
    pub objects: Vec<Object>,
    /// What files name, diffuse or not.
    pub things: Things,
    /// Bounds of all triangles.
    pub bounds: [Vec3; 2],
    /// Metres per scene unit.
    pub metres_per_unit: f32,
    /// Up axis, unit.
    pub up: Vec3,
    /// How it is shown.
    pub display: Display,
    /// Its limits.
    pub budget: Budget,
    /// Extensions of its glTF files, and what became of them.
    pub extensions: Vec<ExtensionUse>,
    /// BLAKE3 of everything that was read: geometry, materials, textures, sidecar.
    pub content_hash: [u8; 32],
    /// Names and BLAKE3 of the files that were read, in order; names are relative to the scene's folder.
    pub files: Vec<(String, [u8; 32])>,
}

impl SceneParts {
    /// The scene with these textures.
    pub fn with_textures(self, textures: Vec<Texture>) -> Scene {
        Scene { parts: Arc::new(self), textures }
    }
}

impl Scene {
    /// The material of a triangle.
    pub fn material_of(&self, triangle: u32) -> &Material {
        &self.materials[self.mesh.materials[triangle as usize].0 as usize]
    }

    /// The same scene with other levels of its textures in memory.
    pub fn with_resident(&self, textures: Vec<Texture>) -> Self {
        Self { parts: self.parts.clone(), textures }
    }

    /// Length of the diagonal of the bounds; 1 for an empty scene.
    pub fn diagonal(&self) -> f32 {
        let d = (self.bounds[1] - self.bounds[0]).length();
        if d.is_finite() && d > 0.0 { d } else { 1.0 }
    }
}
