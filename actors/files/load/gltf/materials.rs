//! glTF's materials: what each asks for, before any picture is read. [`super::surfaces`] makes surfaces of them.

use glam::Vec3;

use super::buffers::Buffers;
use super::document::{Material, TextureInfo, Volume};
use super::pictures::{Coordinates, MapUse, Pictures};
use super::{Choices, Oddities, Problem};
use foveal::math;
use foveal::scene::metal_rough::Grain;

/// What lies below texture and colour.
#[derive(Clone, Debug, PartialEq)]
pub(in super::super) enum Kind {
    /// Metal, dielectric or between.
    MetalRough(Box<MetalRoughSource>),
    /// A body that lets light through, which its base colour tints at each crossing.
    Glass {
        ior: f32,
        transmittance: Vec3,
        roughness: f32,
        dispersion: f32,
        coating: Option<Box<CoatingSource>>,
    },
    /// Looks as its base colour says, whatever the light.
    Unlit,
}

/// A surface between metal and dielectric, and what lies over it.
#[derive(Clone, Debug, PartialEq)]
pub(in super::super) struct MetalRoughSource {
    pub metallic: f32,
    /// Or how smooth it is, where the model is the older one.
    pub roughness: f32,
    /// Whether that is so: of specular colour and glossiness, which one map has.
    pub is_gloss: bool,
    /// f₀ of the dielectric before it is bounded by 1 and scaled by `strength`.
    pub dielectric: Vec3,
    /// f₉₀.
    pub strength: f32,
    /// The share of what is no metal that lets light through instead of scattering it.
    pub through: f32,
    /// Strength and roughness of a clear coat.
    pub coat: Option<[f32; 2]>,
    /// Reflectance and roughness of fibres.
    pub sheen: Option<(Vec3, f32)>,
    pub grain: Option<Grain>,
    pub film: Option<FilmSource>,
    /// The share of what is scattered that leaves on the other side, and its colour.
    pub passes: Option<(f32, Vec3)>,
    pub maps: Maps<MapUse>,
}

/// What lies on a body of glass: a film, how much of a clear coat, and the maps of both.
#[derive(Clone, Debug, PartialEq)]
pub(in super::super) struct CoatingSource {
    pub film: Option<FilmSource>,
    pub coat: f32,
    pub maps: Maps<MapUse>,
}

/// A film: how much of it, its index, and its least and greatest thickness, nanometres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct FilmSource {
    pub strength: f32,
    pub ior: f32,
    pub thickness: [f32; 2],
}

/// Maps besides those that each kind of surface has.
#[derive(Clone, Debug, PartialEq)]
pub(in super::super) struct Maps<T> {
    /// Roughness in green, metalness in blue.
    pub rough: Option<T>,
    /// A factor of what lets light through, in red.
    pub through: Option<T>,
    /// Of f₉₀ and f₀, in alpha.
    pub specular: Option<T>,
    /// Of f₀; of the older model, with glossiness in alpha.
    pub specular_color: Option<T>,
    /// Of the coat's strength, in red.
    pub coat: Option<T>,
    /// Of its roughness, in green.
    pub coat_roughness: Option<T>,
    pub coat_normal: Option<T>,
    pub sheen_color: Option<T>,
    /// In alpha.
    pub sheen_roughness: Option<T>,
    /// Direction in red and green, strength in blue.
    pub grain: Option<T>,
    /// Of the film's strength, in red.
    pub film: Option<T>,
    /// Of its thickness, in green.
    pub film_thickness: Option<T>,
    /// In alpha.
    pub passes: Option<T>,
    pub passes_color: Option<T>,
}

impl<T> Maps<T> {
    /// Each of them anew. `f` is also told whether it is a colour; where alpha alone is read that is all the same, and most
    /// such pictures are read as colours as well.
    pub fn try_map<U, E>(&self, mut f: impl FnMut(&T, bool) -> Result<U, E>) -> Result<Maps<U>, E> {
        let mut one = |map: &Option<T>, is_color| map.as_ref().map(|m| f(m, is_color)).transpose();
        Ok(Maps {
            rough: one(&self.rough, false)?,
            through: one(&self.through, false)?,
            specular: one(&self.specular, true)?,
            specular_color: one(&self.specular_color, true)?,
            coat: one(&self.coat, false)?,
            coat_roughness: one(&self.coat_roughness, false)?,
            coat_normal: one(&self.coat_normal, false)?,
            sheen_color: one(&self.sheen_color, true)?,
            sheen_roughness: one(&self.sheen_roughness, true)?,
            grain: one(&self.grain, false)?,
            film: one(&self.film, false)?,
            film_thickness: one(&self.film_thickness, false)?,
            passes: one(&self.passes, true)?,
            passes_color: one(&self.passes_color, true)?,
        })
    }

    /// Only those of which `f` makes one.
    pub fn filtered(self, f: impl Fn(Option<T>) -> Option<T>) -> Self {
        Self {
            rough: f(self.rough),
            through: f(self.through),
            specular: f(self.specular),
            specular_color: f(self.specular_color),
            coat: f(self.coat),
            coat_roughness: f(self.coat_roughness),
            coat_normal: f(self.coat_normal),
            sheen_color: f(self.sheen_color),
            sheen_roughness: f(self.sheen_roughness),
            grain: f(self.grain),
            film: f(self.film),
            film_thickness: f(self.film_thickness),
            passes: f(self.passes),
            passes_color: f(self.passes_color),
        }
    }

    /// Those that cannot be joined with the base colour.
    pub fn are_special(&self) -> bool {
        let Self {
            rough: _, through: _, specular, specular_color, coat, coat_roughness, coat_normal, ..
        } = self;
        let Self { sheen_color, sheen_roughness, grain, film, film_thickness, passes, passes_color, .. } =
            self;
        [specular, specular_color, coat, coat_roughness, coat_normal, sheen_color, sheen_roughness]
            .into_iter()
            .chain([grain, film, film_thickness, passes, passes_color])
            .any(Option::is_some)
    }
}

impl<T> Default for Maps<T> {
    fn default() -> Self {
        Self {
            rough: None,
            through: None,
            specular: None,
            specular_color: None,
            coat: None,
            coat_roughness: None,
            coat_normal: None,
            sheen_color: None,
            sheen_roughness: None,
            grain: None,
            film: None,
            film_thickness: None,
            passes: None,
            passes_color: None,
        }
    }
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
    /// Whether an eye sees through its back.
    pub culled: bool,
    /// Emission leaves both sides of a sheet.
    pub glows_behind: bool,
    /// r from which on it counts as diffuse.
    pub gloss_floor: f32,
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

/// Reads a material whose unique name is `name`, on a mesh that is open or a body.
pub(super) fn read(
    material: &Material,
    name: String,
    is_open: bool,
    choices: &Choices,
    pictures: &mut Pictures<'_>,
    buffers: &mut Buffers<'_>,
    odd: &mut Oddities,
) -> Result<(Source, Coordinates), Problem> {
    let e = &material.extensions;
    let pbr = &material.pbr_metallic_roughness;
    let (base_factor, base_info) = match &e.glossiness {
        Some(g) => (g.diffuse_factor, &g.diffuse_texture),
        None => (pbr.base_color_factor, &pbr.base_color_texture),
    };
    let mut kind = kind(material, is_open, odd);
    let infos = match &kind {
        Kind::MetalRough(_) => maps(material),
        Kind::Glass { coating: Some(_), .. } => {
            let Maps { film, film_thickness, coat, .. } = maps(material);
            Maps { film, film_thickness, coat, ..Maps::default() }
        }
        Kind::Glass { coating: None, .. } | Kind::Unlit => Maps::default(),
    };
    let mut all: Vec<&TextureInfo> = base_info.iter().collect();
    let _: Result<Maps<()>, ()> = infos.try_map(|info, _| {
        all.push(*info);
        Ok(())
    });
    all.extend(material.normal_texture.iter().chain(&material.emissive_texture));
    let mut coordinates = Coordinates::of(all.into_iter(), odd);
    let along = material.normal_texture.as_ref().or(infos.coat_normal).or(infos.grain);
    if along.is_some() || matches!(&kind, Kind::MetalRough(m) if m.grain.is_some()) {
        coordinates = coordinates.with_tangents(along);
    }
    let mut map = |info: &TextureInfo| pictures.map_use(info, &coordinates, buffers, odd);
    let base_map = base_info.as_ref().map(&mut map).transpose()?;
    let found = infos.try_map(|info, _| map(info))?;
    match &mut kind {
        Kind::MetalRough(source) => source.maps = found,
        Kind::Glass { coating: Some(coating), .. } => coating.maps = found,
        Kind::Glass { coating: None, .. } | Kind::Unlit => {}
    }
    let normal = material.normal_texture.as_ref().map(&mut map).transpose()?;
    let emission_map = material.emissive_texture.as_ref().map(&mut map).transpose()?;
    let [r, g, b, base_alpha] = base_factor;
    let base = color([r, g, b]);
    let strength = e.emissive_strength.as_ref().map_or(1.0, |s| s.emissive_strength);
    let emission = Vec3::from(material.emissive_factor.map(|v| bounded(v * strength, RADIANCE_MAX)));
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
    let culled = choices.cull && !material.double_sided && !matches!(kind, Kind::Glass { .. });
    let is_unlit = matches!(kind, Kind::Unlit);
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
        culled,
        glows_behind: material.double_sided && emission.max_element() > 0.0 && !is_unlit,
        gloss_floor: choices.gloss_floor,
    };
    Ok((source, coordinates))
}

/// The maps of a material besides those that every kind has.
fn maps(material: &Material) -> Maps<&TextureInfo> {
    let e = &material.extensions;
    let mut maps = Maps {
        through: e.transmission.as_ref().and_then(|t| t.transmission_texture.as_ref()),
        ..Maps::default()
    };
    match &e.glossiness {
        Some(g) => maps.specular_color = g.specular_glossiness_texture.as_ref(),
        None => {
            maps.rough = material.pbr_metallic_roughness.metallic_roughness_texture.as_ref();
            maps.specular = e.specular.as_ref().and_then(|s| s.specular_texture.as_ref());
            maps.specular_color = e.specular.as_ref().and_then(|s| s.specular_color_texture.as_ref());
        }
    }
    if let Some(c) = e.clearcoat.as_ref().filter(|c| c.clearcoat_factor > 0.0) {
        maps.coat = c.clearcoat_texture.as_ref();
        maps.coat_roughness = c.clearcoat_roughness_texture.as_ref();
        maps.coat_normal = c.clearcoat_normal_texture.as_ref();
    }
    if let Some(s) = e.sheen.as_ref().filter(|s| color(s.sheen_color_factor) != Vec3::ZERO) {
        maps.sheen_color = s.sheen_color_texture.as_ref();
        maps.sheen_roughness = s.sheen_roughness_texture.as_ref();
    }
    if let Some(a) = e.anisotropy.as_ref().filter(|a| a.anisotropy_strength > 0.0) {
        maps.grain = a.anisotropy_texture.as_ref();
    }
    if let Some(i) = e.iridescence.as_ref().filter(|i| i.iridescence_factor > 0.0) {
        maps.film = i.iridescence_texture.as_ref();
        maps.film_thickness = i.iridescence_thickness_texture.as_ref();
    }
    if let Some(d) = e.diffuse_transmission.as_ref().filter(|d| d.diffuse_transmission_factor > 0.0) {
        maps.passes = d.diffuse_transmission_texture.as_ref();
        maps.passes_color = d.diffuse_transmission_color_texture.as_ref();
    }
    maps
}

/// What a material is, without its maps.
fn kind(material: &Material, is_open: bool, odd: &mut Oddities) -> Kind {
    let e = &material.extensions;
    if e.unlit.is_some() {
        return Kind::Unlit;
    }
    let pbr = &material.pbr_metallic_roughness;
    let mut source = MetalRoughSource {
        metallic: unit(pbr.metallic_factor),
        roughness: unit(pbr.roughness_factor),
        is_gloss: false,
        dielectric: Vec3::ZERO,
        strength: 1.0,
        through: e.transmission.as_ref().map_or(0.0, |t| unit(t.transmission_factor)),
        coat: e
            .clearcoat
            .as_ref()
            .map(|c| [unit(c.clearcoat_factor), unit(c.clearcoat_roughness_factor)])
            .filter(|[strength, _]| *strength > 0.0),
        sheen: e
            .sheen
            .as_ref()
            .map(|s| (color(s.sheen_color_factor), unit(s.sheen_roughness_factor)))
            .filter(|(color, _)| *color != Vec3::ZERO),
        grain: grain(material),
        film: film(material),
        passes: e
            .diffuse_transmission
            .as_ref()
            .map(|d| (unit(d.diffuse_transmission_factor), color(d.diffuse_transmission_color_factor)))
            .filter(|(share, _)| *share > 0.0),
        maps: Maps::default(),
    };
    if let Some(g) = &e.glossiness {
        let f0 = color(g.specular_factor);
        let strength = if f0.max_element() > 0.0 { 1.0 } else { 0.0 };
        let roughness = unit(g.glossiness_factor);
        return Kind::MetalRough(Box::new(MetalRoughSource {
            metallic: 0.0,
            roughness,
            is_gloss: true,
            dielectric: f0,
            strength,
            through: 0.0,
            ..source
        }));
    }
    // 0 means that all is reflected at every angle.
    let ior = e.ior.as_ref().map_or(1.5, |i| if i.ior.is_finite() { i.ior } else { 1.5 });
    let plain = if ior == 0.0 { 1.0 } else { ((ior - 1.0) / (ior + 1.0)).powi(2) };
    let (strength, tint) = e.specular.as_ref().map_or((1.0, Vec3::ONE), |s| {
        (unit(s.specular_factor), Vec3::from(s.specular_color_factor.map(|v| bounded(v, 1e3))))
    });
    (source.dielectric, source.strength) = (tint * plain, strength);
    let (metallic, through) = (source.metallic, source.through);
    // A body has one surface: what scatters below it has no place beside what passes.
    if let Some(volume) = e.volume.as_ref().filter(|v| v.thickness_factor > 0.0 && through > 0.0) {
        if is_open {
            odd.count("a volume whose mesh is open", "shown as a pane without its inside");
        } else if through * (1.0 - metallic) >= 0.5 {
            let mapped = e.transmission.as_ref().is_some_and(|t| t.transmission_texture.is_some());
            if through < 1.0 || mapped || metallic > 0.0 || pbr.metallic_roughness_texture.is_some() {
                odd.count("a volume that is not all glass", "shown as clear glass of its factors");
            }
            if source.sheen.is_some() {
                odd.count("a volume below fibres", "shown without them");
            }
            let coating = coating(material, &source, odd);
            let ior = if ior == 0.0 { 10.0 } else { ior.clamp(1.0, 10.0) };
            let dispersion = e.dispersion.as_ref().map_or(0.0, |d| bounded(d.dispersion, 20.0));
            let (transmittance, roughness) = (transmittance(volume), source.roughness);
            return Kind::Glass { ior, transmittance, roughness, dispersion, coating };
        } else {
            odd.count("a volume that lets less than half of the light through", "shown without its inside");
        }
    }
    Kind::MetalRough(Box::new(source))
}

/// What passes one unit of a volume: all of its colour after the distance, after one unit its root.
fn transmittance(volume: &Volume) -> Vec3 {
    let distance = volume.attenuation_distance.unwrap_or(f32::INFINITY);
    let exponent = if distance > 0.0 && distance.is_finite() { 1.0 / distance } else { 0.0 };
    color(volume.attenuation_color).max(Vec3::splat(1e-6)).map(|c| math::powf(c, exponent).clamp(0.0, 1.0))
}

fn grain(material: &Material) -> Option<Grain> {
    let a = material.extensions.anisotropy.as_ref()?;
    let strength = unit(a.anisotropy_strength);
    let rotation = if a.anisotropy_rotation.is_finite() { a.anisotropy_rotation } else { 0.0 };
    (strength > 0.0).then_some(Grain { strength, rotation })
}

/// What lies on a body of glass. It is as rough as the glass, and follows its bumps.
fn coating(material: &Material, source: &MetalRoughSource, odd: &mut Oddities) -> Option<Box<CoatingSource>> {
    /// Roughness of a coat that looks like another one.
    const ROUGHNESS_OFF: f32 = 0.1;
    let coat = material.extensions.clearcoat.as_ref().filter(|_| source.coat.is_some());
    if coat.is_some_and(|c| c.clearcoat_roughness_texture.is_some() || c.clearcoat_normal_texture.is_some()) {
        odd.count("roughness or normals of a coat over a volume from maps", "shown as those of the volume");
    }
    if source.coat.is_some_and(|[_, roughness]| (roughness - source.roughness).abs() > ROUGHNESS_OFF) {
        odd.count("a coat over a volume of another roughness", "shown as rough as the volume");
    }
    let (film, coat) = (source.film, source.coat.map_or(0.0, |[strength, _]| strength));
    (film.is_some() || coat > 0.0).then(|| Box::new(CoatingSource { film, coat, maps: Maps::default() }))
}

fn film(material: &Material) -> Option<FilmSource> {
    /// Nanometres: thicker than this no film has colours.
    const THICKNESS_MAX: f32 = 1e5;
    let i = material.extensions.iridescence.as_ref()?;
    let strength = unit(i.iridescence_factor);
    let [low, high] = [i.iridescence_thickness_minimum, i.iridescence_thickness_maximum];
    let ior = if i.iridescence_ior.is_finite() { i.iridescence_ior.clamp(1.0, 10.0) } else { 1.3 };
    let thickness = [low, high].map(|v| bounded(v, THICKNESS_MAX));
    (strength > 0.0).then_some(FilmSource { strength, ior, thickness })
}
