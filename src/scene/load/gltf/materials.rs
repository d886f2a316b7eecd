//! glTF's materials: what each asks for, before any picture is read. [`super::surfaces`] makes surfaces of them.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;

use glam::{Mat2, Vec2, Vec3};

use super::buffers::{Buffers, Reference, shortened};
use super::document::{Document, Material, TextureInfo, TextureTransform, Volume};
use super::number::Index;
use super::{Oddities, Problem, get};
use crate::math;
use crate::scene::Sheen;
use crate::scene::metal_rough::{Coat, Grain, Over};

/// A picture: where it is, or its bytes; what is wrong with it otherwise.
#[derive(Clone, Debug, PartialEq)]
pub(in super::super) enum Picture {
    /// A file of the scene's folder.
    File(PathBuf),
    /// From a buffer or a data URI.
    Bytes(Arc<Vec<u8>>),
    /// Completes "texture … ".
    Broken(String),
}

/// A picture on a surface.
#[derive(Clone, Debug, PartialEq)]
pub(in super::super) struct MapUse {
    /// For messages, and what makes it the same as another.
    pub name: String,
    pub picture: Picture,
    pub clamp: bool,
    /// In OBJ's coordinates, from the lower left.
    pub scale_offset: [f32; 4],
}

/// How coordinates of a file become those of the mesh: of which set, and moved how.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Coordinates {
    pub set: usize,
    /// Linear part and offset, from the upper left; `None` where they stay.
    pub moved: Option<(Mat2, Vec2)>,
}

/// What lies below texture and colour.
#[derive(Clone, Debug, PartialEq)]
pub(in super::super) enum Kind {
    /// Metal, dielectric or between.
    MetalRough(Box<MetalRoughSource>),
    /// A body that lets light through, which its base colour tints at each crossing.
    Glass { ior: f32, transmittance: Vec3, roughness: f32 },
    /// Looks as its base colour says, whatever the light.
    Unlit,
}

/// A surface between metal and dielectric, and what lies over it.
#[derive(Clone, Debug, PartialEq)]
pub(in super::super) struct MetalRoughSource {
    pub metallic: f32,
    pub roughness: f32,
    /// Roughness in green, metalness in blue.
    pub map: Option<MapUse>,
    pub f0: Vec3,
    pub f90: f32,
    /// The share of what is no metal that lets light through instead of scattering it.
    pub through: f32,
    /// A factor of that, in red.
    pub through_map: Option<MapUse>,
    pub over: Option<Over>,
    pub grain: Option<Grain>,
}

/// How alpha is meant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) enum Alpha {
    Opaque,
    /// There where it is at least this.
    Mask(f32),
    Blend,
}

/// A material of a document.
#[derive(Clone, Debug, PartialEq)]
pub(in super::super) struct Source {
    /// Unique in its file.
    pub name: String,
    pub kind: Kind,
    pub base: Vec3,
    pub base_alpha: f32,
    pub base_map: Option<MapUse>,
    pub alpha: Alpha,
    pub normal: Option<MapUse>,
    /// Factor of how far normals lean.
    pub normal_scale: f32,
    pub emission: Vec3,
    pub emission_map: Option<MapUse>,
}

/// Emission beyond this is taken for a slip.
const RADIANCE_MAX: f32 = 1e9;

/// Between 0 and `most`; what overflowed into NaN is 0.
fn bounded(v: f32, most: f32) -> f32 {
    if v.is_nan() { 0.0 } else { v.clamp(0.0, most) }
}

fn unit(v: f32) -> f32 {
    bounded(v, 1.0)
}

fn color(c: [f32; 3]) -> Vec3 {
    Vec3::from(c.map(unit))
}

/// Reads material `index`, whose unique name is `name`.
pub(super) fn read(
    material: &Material,
    name: String,
    pictures: &mut Pictures<'_>,
    buffers: &mut Buffers<'_>,
    odd: &mut Oddities,
) -> Result<(Source, Coordinates), Problem> {
    let e = &material.extensions;
    let pbr = &material.pbr_metallic_roughness;
    let (base_factor, base_info, rough_info) = match &e.glossiness {
        Some(g) => (g.diffuse_factor, &g.diffuse_texture, &None),
        None => (pbr.base_color_factor, &pbr.base_color_texture, &pbr.metallic_roughness_texture),
    };
    let rough_info = if e.unlit.is_some() { &None } else { rough_info };
    let through_info = e.transmission.as_ref().and_then(|t| t.transmission_texture.clone());
    let through_info = if e.unlit.is_some() { None } else { through_info };
    let infos = [base_info, rough_info, &material.normal_texture, &material.emissive_texture, &through_info];
    let coordinates = coordinates(infos.into_iter().flatten(), odd);
    let mut map = |info: &Option<TextureInfo>| -> Result<Option<MapUse>, Problem> {
        info.as_ref().map(|i| pictures.map_use(i, &coordinates, buffers, odd)).transpose()
    };
    let base_map = map(base_info)?;
    let rough_map = map(rough_info)?;
    let through_map = map(&through_info)?;
    let normal = map(&material.normal_texture)?;
    let emission_map = map(&material.emissive_texture)?;
    let [r, g, b, base_alpha] = base_factor;
    let base = color([r, g, b]);
    let strength = e.emissive_strength.as_ref().map_or(1.0, |s| s.emissive_strength);
    let emission = Vec3::from(material.emissive_factor.map(|v| bounded(v * strength, RADIANCE_MAX)));
    let kind = kind(material, rough_map, through_map, odd);
    if material.double_sided && emission.max_element() > 0.0 {
        odd.count("a double-sided light", "shines from its front only");
    }
    if material.occlusion_texture.is_some() {
        odd.count("occlusion map", "not used; what lies in shadow is computed");
    }
    let alpha = match material.alpha_mode.as_deref() {
        Some("MASK") => Alpha::Mask(material.alpha_cutoff.unwrap_or(0.5)),
        Some("BLEND") => Alpha::Blend,
        Some("OPAQUE") | None => Alpha::Opaque,
        Some(_) => {
            odd.count("an unknown alphaMode", "taken for OPAQUE");
            Alpha::Opaque
        }
    };
    let base_alpha = unit(base_alpha);
    let scale = material.normal_texture.as_ref().map_or(1.0, |n| n.scale);
    let normal_scale = if scale.is_finite() { scale.clamp(-1e3, 1e3) } else { 1.0 };
    let source = Source {
        name,
        kind,
        base,
        base_alpha,
        base_map,
        alpha,
        normal,
        normal_scale,
        emission,
        emission_map,
    };
    Ok((source, coordinates))
}

fn kind(material: &Material, map: Option<MapUse>, through_map: Option<MapUse>, odd: &mut Oddities) -> Kind {
    let e = &material.extensions;
    if e.unlit.is_some() {
        return Kind::Unlit;
    }
    let pbr = &material.pbr_metallic_roughness;
    let (over, grain) = (over(material, odd), grain(material, odd));
    if let Some(g) = &e.glossiness {
        if g.specular_glossiness_texture.is_some() {
            odd.count("map of specular and glossiness", "not used; their factors count");
        }
        let f0 = color(g.specular_factor);
        return Kind::MetalRough(Box::new(MetalRoughSource {
            metallic: 0.0,
            roughness: 1.0 - unit(g.glossiness_factor),
            map: None,
            f0,
            f90: if f0.max_element() > 0.0 { 1.0 } else { 0.0 },
            through: 0.0,
            through_map: None,
            over,
            grain,
        }));
    }
    // 0 means that all is reflected at every angle.
    let ior = e.ior.as_ref().map_or(1.5, |i| if i.ior.is_finite() { i.ior } else { 1.5 });
    let plain = if ior == 0.0 { 1.0 } else { ((ior - 1.0) / (ior + 1.0)).powi(2) };
    let (strength, tint) = e.specular.as_ref().map_or((1.0, Vec3::ONE), |s| {
        if s.specular_texture.is_some() || s.specular_color_texture.is_some() {
            odd.count("maps of KHR_materials_specular", "not used; their factors count");
        }
        (unit(s.specular_factor), Vec3::from(s.specular_color_factor.map(|v| bounded(v, 1e3))))
    });
    let f0 = (tint * plain).min(Vec3::ONE) * strength;
    let (metallic, roughness) = (unit(pbr.metallic_factor), unit(pbr.roughness_factor));
    let through = e.transmission.as_ref().map_or(0.0, |t| unit(t.transmission_factor));
    // A body has one surface: what scatters below it has no place beside what passes.
    if let Some(volume) = e.volume.as_ref().filter(|v| v.thickness_factor > 0.0 && through > 0.0) {
        if through * (1.0 - metallic) >= 0.5 {
            if through < 1.0 || through_map.is_some() || metallic > 0.0 || map.is_some() {
                odd.count("a volume that is not all glass", "shown as clear glass of its factors");
            }
            let ior = if ior == 0.0 { 10.0 } else { ior.clamp(1.0, 10.0) };
            return Kind::Glass { ior, transmittance: transmittance(volume), roughness };
        }
        odd.count("a volume that lets less than half of the light through", "shown without its inside");
    }
    Kind::MetalRough(Box::new(MetalRoughSource {
        metallic,
        roughness,
        map,
        f0,
        f90: strength,
        through,
        through_map,
        over,
        grain,
    }))
}

/// What passes one unit of a volume: all of its colour after the distance, after one unit its root.
fn transmittance(volume: &Volume) -> Vec3 {
    let distance = volume.attenuation_distance.unwrap_or(f32::INFINITY);
    let exponent = if distance > 0.0 && distance.is_finite() { 1.0 / distance } else { 0.0 };
    color(volume.attenuation_color).max(Vec3::splat(1e-6)).map(|c| math::powf(c, exponent).clamp(0.0, 1.0))
}

/// The coat and the fibres of a material.
fn over(material: &Material, odd: &mut Oddities) -> Option<Over> {
    let e = &material.extensions;
    let coat = e.clearcoat.as_ref().map(|c| {
        if [&c.clearcoat_texture, &c.clearcoat_roughness_texture, &c.clearcoat_normal_texture]
            .into_iter()
            .any(Option::is_some)
        {
            odd.count("maps of KHR_materials_clearcoat", "not used; its factors count");
        }
        Coat { strength: unit(c.clearcoat_factor), roughness: unit(c.clearcoat_roughness_factor) }
    });
    let sheen = e.sheen.as_ref().map(|s| {
        if s.sheen_color_texture.is_some() || s.sheen_roughness_texture.is_some() {
            odd.count("maps of KHR_materials_sheen", "not used; its factors count");
        }
        Sheen { color: color(s.sheen_color_factor), roughness: unit(s.sheen_roughness_factor) }
    });
    Over::new(coat, sheen)
}

fn grain(material: &Material, odd: &mut Oddities) -> Option<Grain> {
    let a = material.extensions.anisotropy.as_ref()?;
    if a.anisotropy_texture.is_some() {
        odd.count("map of KHR_materials_anisotropy", "not used; its factors count");
    }
    let strength = unit(a.anisotropy_strength);
    let rotation = if a.anisotropy_rotation.is_finite() { a.anisotropy_rotation } else { 0.0 };
    (strength > 0.0).then_some(Grain { strength, rotation })
}

/// The set and the transform that coordinates are given for good: those of all maps, where they agree. Where they do
/// not, each map keeps scale and offset of its own, on the set of the first.
fn coordinates<'i>(infos: impl Iterator<Item = &'i TextureInfo> + Clone, odd: &mut Oddities) -> Coordinates {
    let Some(first) = infos.clone().next() else { return Coordinates { set: 0, moved: None } };
    if infos.clone().any(|i| set(i) != set(first)) {
        odd.count(
            "a material with maps on two sets of coordinates",
            "shown with those of its first map on all",
        );
    }
    let number = set(first).min(1) as usize;
    if set(first) > 1 {
        odd.count("texture coordinates beyond the second set", "the second is used");
    }
    if infos.clone().all(|i| matrix(i) == matrix(first)) {
        let moved = matrix(first);
        let stays = moved == (Mat2::IDENTITY, Vec2::ZERO);
        return Coordinates { set: number, moved: (!stays).then_some(moved) };
    }
    if infos.clone().any(|i| transform(i).is_some_and(|t| t.rotation != 0.0)) {
        odd.count("a material whose maps are turned differently", "shown without turning them");
    }
    Coordinates { set: number, moved: None }
}

fn transform(info: &TextureInfo) -> Option<&TextureTransform> {
    info.extensions.transform.as_ref()
}

fn set(info: &TextureInfo) -> u32 {
    transform(info).and_then(|t| t.tex_coord).unwrap_or(info.tex_coord).0
}

/// uv' = T · R · S · uv, in coordinates from the upper left. A turn by a positive angle is counter-clockwise to the eye.
fn matrix(info: &TextureInfo) -> (Mat2, Vec2) {
    let Some(t) = transform(info) else { return (Mat2::IDENTITY, Vec2::ZERO) };
    let (s, c) = if t.rotation == 0.0 { (0.0, 1.0) } else { math::sin_cos(t.rotation) };
    let [x, y] = t.scale;
    let linear = Mat2::from_cols(Vec2::new(c * x, -s * x), Vec2::new(s * y, c * y));
    let offset = Vec2::from(t.offset);
    if linear.is_finite() && offset.is_finite() { (linear, offset) } else { (Mat2::IDENTITY, Vec2::ZERO) }
}

/// The pictures of a document, each looked up once.
pub(super) struct Pictures<'a> {
    document: &'a Document,
    known: HashMap<u32, (String, Picture)>,
}

impl<'a> Pictures<'a> {
    pub fn new(document: &'a Document) -> Self {
        Self { document, known: HashMap::new() }
    }

    fn map_use(
        &mut self,
        info: &TextureInfo,
        coordinates: &Coordinates,
        buffers: &mut Buffers<'_>,
        odd: &mut Oddities,
    ) -> Result<MapUse, Problem> {
        const CLAMP: u32 = 33_071;
        const REPEAT: u32 = 10_497;
        const MIRRORED: u32 = 33_648;
        let texture = get(&self.document.textures, info.index, "textures")?;
        let mut clamp = false;
        if let Some(sampler) = texture.sampler {
            let sampler = get(&self.document.samplers, sampler, "samplers")?;
            let wraps = [sampler.wrap_s, sampler.wrap_t].map(|w| w.map_or(REPEAT, |w| w.0));
            clamp = wraps == [CLAMP; 2];
            if wraps.contains(&MIRRORED) || wraps[0] != wraps[1] {
                odd.count("a texture that is mirrored, or clamped on one axis", "repeated on both");
            }
        }
        let own = transform(info).filter(|_| coordinates.moved.is_none());
        let (scale, offset) = own.map_or(([1.0; 2], [0.0; 2]), |t| (t.scale, t.offset));
        // From the lower left: 1 − ((1 − v) s + o) = v s + (1 − s − o).
        let moved = [scale[0], scale[1], offset[0], 1.0 - scale[1] - offset[1]];
        let scale_offset = if moved.iter().all(|v| v.is_finite()) { moved } else { [1.0, 1.0, 0.0, 0.0] };
        let source = texture.extensions.webp.as_ref().and_then(|w| w.source).or(texture.source);
        let Some(source) = source else {
            let picture = Picture::Broken("has no picture that this build reads".to_owned());
            return Ok(MapUse { name: format!("texture {}", info.index.0), picture, clamp, scale_offset });
        };
        if !self.known.contains_key(&source.0) {
            let found = self.picture(source, buffers)?;
            self.known.insert(source.0, found);
        }
        let (name, picture) = self.known[&source.0].clone();
        Ok(MapUse { name, picture, clamp, scale_offset })
    }

    fn picture(&self, source: Index, buffers: &mut Buffers<'_>) -> Result<(String, Picture), Problem> {
        let image = get(&self.document.images, source, "images")?;
        let number = format!("image {}", source.0);
        Ok(match (&image.uri, image.buffer_view) {
            (Some(uri), _) => {
                let name = if uri.starts_with("data:") { number } else { shortened(uri) };
                let picture = match buffers.resolve(uri) {
                    Ok(Reference::File(found)) => Picture::File(found),
                    Ok(Reference::Data(bytes)) => Picture::Bytes(Arc::new(bytes)),
                    Err(why) => Picture::Broken(why),
                };
                (name, picture)
            }
            (None, Some(view)) => {
                let (bytes, _) = buffers.view(view)?;
                (number, Picture::Bytes(Arc::new(bytes.to_vec())))
            }
            (None, None) => (number, Picture::Broken("names neither file nor bytes".to_owned())),
        })
    }
}
