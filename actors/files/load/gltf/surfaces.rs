//! Surfaces of glTF's materials: once before pictures are read, to ask for them, and once after, when maps of base
//! colour, metalness and roughness become those that are shown ([`foveal::scene::metal_rough`]).

use std::collections::HashMap;
use std::convert::Infallible;
use std::path::PathBuf;

use glam::Vec3;

use super::super::error::{Place, Warning};
use super::super::textures::TextureRequests;
use super::joined::{self, film_maps, scalar};
use super::joined_maps::{Joined, Key};
use super::materials::{Alpha, Kind, Maps, Source};
use super::pictures::{MapUse, Picture};
use super::texels::{lean, mean_of, premultiplied};
use foveal::scene::coating::Coating;
use foveal::scene::metal_rough::{Layer, MetalRough};
use foveal::scene::recipe::Channel;
use foveal::scene::{Distribution, Material, MaterialId, Model, Reflectance, Roughness, Texture, TextureId};

/// Alpha below which a texel is taken for nothing, and above whose complement for all.
const CLEAR: f32 = 0.02;

/// A material whose maps are still to be joined.
#[derive(Debug)]
pub(in super::super) struct Pending {
    pub material: MaterialId,
    pub(super) source: Source,
    pub(super) base: Option<TextureId>,
    pub(super) maps: Maps<TextureId>,
    place: Place,
}

/// Asks for a material's pictures. The ids in both results are those of `requests`.
pub(in super::super) fn ask(
    source: &Source,
    id: MaterialId,
    place: &Place,
    requests: &mut TextureRequests,
) -> (Material, Pending) {
    let mut ask_for = |map: &MapUse, is_color: bool| {
        let (found, bytes) = match &map.picture {
            Picture::File(path) => (Ok(path.clone()), None),
            // Content is what makes pictures in a file the same.
            Picture::Bytes(bytes) => {
                let key = format!("{}#{}", place.path.display(), blake3::hash(bytes).to_hex());
                (Ok(PathBuf::from(key)), Some(bytes.clone()))
            }
            Picture::Broken(why) => (Err(why.clone()), None),
        };
        requests.ask_for(&map.name, found, bytes, is_color, map.placement, place.clone())
    };
    let base = source.base_map.as_ref().map(|m| ask_for(m, true));
    let more = match &source.kind {
        Kind::MetalRough(m) => Some(&m.maps),
        Kind::Glass { coating, .. } => coating.as_ref().map(|coating| &coating.maps),
        Kind::Unlit => None,
    };
    let mut asked = |maps: &Maps<MapUse>| {
        maps.try_map(|map, is_color| Ok::<_, Infallible>(ask_for(map, is_color))).unwrap_or_default()
    };
    let maps = more.map_or_else(Maps::default, &mut asked);
    let normal_map = source.normal.as_ref().map(|m| ask_for(m, false));
    let emission_map = source.emission_map.as_ref().map(|m| ask_for(m, true));
    let mut material = Material::new(
        source.name.clone(),
        Model::Lambert { albedo: Reflectance { color: source.base, map: base } },
    );
    material.normal_map = normal_map;
    material.emission = Reflectance { color: source.emission, map: emission_map };
    material.culled = source.culled;
    let pending = Pending { material: id, source: source.clone(), base, maps, place: place.clone() };
    (material, pending)
}

/// Makes the surfaces, once pictures are read: `ids` are the final ones of those that were asked for. Textures that
/// nothing needs any more are dropped.
pub(in super::super) fn finish(
    materials: &mut [Material],
    textures: &mut Vec<Texture>,
    pending: Vec<Pending>,
    ids: &[Option<TextureId>],
    warnings: &mut Vec<Warning>,
) {
    let mut known: HashMap<Key, Joined> = HashMap::new();
    let mut leaning: HashMap<(TextureId, u32), TextureId> = HashMap::new();
    for mut p in pending {
        p.base = resolved(p.base, ids);
        p.maps = std::mem::take(&mut p.maps).filtered(|id| resolved(id, ids));
        let Some(material) = materials.get_mut(p.material.0 as usize) else { continue };
        if let Some(map) = material.normal_map.filter(|_| p.source.normal_scale != 1.0) {
            let key = (map, p.source.normal_scale.to_bits());
            let scaled = leaning.entry(key).or_insert_with(|| lean(map, p.source.normal_scale, textures));
            material.normal_map = Some(*scaled);
        }
        let mut said = Vec::new();
        finish_one(material, &p, textures, &mut known, &mut said);
        for message in said {
            warnings.push(Warning::new(p.place.clone(), format!("material \"{}\" {message}", material.name)));
        }
    }
    drop_unused(materials, textures);
}

/// The final id of a texture that was asked for, if there is one.
fn resolved(id: Option<TextureId>, ids: &[Option<TextureId>]) -> Option<TextureId> {
    id.and_then(|id| ids.get(id.0 as usize).copied().flatten())
}

fn finish_one(
    material: &mut Material,
    p: &Pending,
    textures: &mut Vec<Texture>,
    known: &mut HashMap<Key, Joined>,
    said: &mut Vec<String>,
) {
    let s = &p.source;
    let base = Reflectance { color: s.base, map: p.base };
    let veil = coverage(material, p, textures, said);
    if let Some(veil) = &veil {
        material.emission.color *= veil.mean;
    }
    material.model = match &s.kind {
        Kind::Unlit => {
            material.shadeless = true;
            match veil {
                None => {
                    material.emission = base;
                    Model::Lambert { albedo: Reflectance::constant(Vec3::ZERO) }
                }
                Some(veil) => {
                    let map = p.base.filter(|_| veil.in_alpha).map(|map| premultiplied(map, textures));
                    material.emission = Reflectance { color: s.base * s.base_alpha, map: map.or(p.base) };
                    let black = Reflectance { color: Vec3::ZERO, map };
                    Model::MetalRough(Box::new(MetalRough {
                        diffuse: black,
                        specular: Reflectance::constant(Vec3::ZERO),
                        roughness_in_alpha: false,
                        metallic: Some(0.0),
                        metallic_in_alpha: false,
                        roughness: 0.0,
                        roughness_range: [0.0; 2],
                        maps_agree: false,
                        layer: Layer::new(0.0, 0.0),
                        specular_mean: 0.0,
                        through: Reflectance::constant(Vec3::ZERO),
                        coverage: s.base_alpha,
                        coverage_in_alpha: veil.in_alpha,
                        over: None,
                        grain: None,
                        recipe: None,
                        is_diffuse: false,
                    }))
                }
            }
        }
        Kind::Glass { ior, transmittance, roughness, dispersion, coating } => {
            let (ior, transmittance) = (*ior, *transmittance);
            let alpha = MetalRough::alpha(*roughness);
            material.tint = base;
            material.dispersion = *dispersion;
            material.coating = coating.as_ref().map(|source| Coating {
                film: source.film.map(|film| film_maps(film, &p.maps)),
                coat: scalar(source.coat, p.maps.coat, Channel::Red),
            });
            Model::Dielectric {
                ior,
                transmittance,
                thin: false,
                roughness: Roughness { alpha_x: alpha, alpha_y: alpha, distribution: Distribution::Ggx },
            }
        }
        Kind::MetalRough(m) => Model::MetalRough(Box::new(joined::surface(m, veil, p, textures, known))),
    };
}

/// What is half there.
pub(super) struct Veil {
    /// Whether the base map's alpha says how much of it.
    pub in_alpha: bool,
    /// How much on average.
    mean: f32,
}

/// Sets what of a material is there, and says whether it is a veil.
fn coverage(
    material: &mut Material,
    p: &Pending,
    textures: &mut [Texture],
    said: &mut Vec<String>,
) -> Option<Veil> {
    let s = &p.source;
    let map = p.base.filter(|map| textures[map.0 as usize].has_alpha);
    match s.alpha {
        Alpha::Opaque => None,
        // A cut-out is there from one half on.
        Alpha::Mask(at_least) => {
            if at_least > 0.0 {
                (material.opacity, material.opacity_map) = (0.5 * s.base_alpha / at_least, map);
            }
            None
        }
        Alpha::Blend => {
            if map.is_some_and(|map| veiled(&textures[map.0 as usize], s.base_alpha) < VEILED_MIN) {
                said.push("blends with what is behind it; cut out where its alpha is one half".to_owned());
                (material.opacity, material.opacity_map) = (s.base_alpha, map);
                return None;
            }
            let mean = map.map_or(1.0, |map| mean_of(map, textures)[3]) * s.base_alpha;
            if map.is_none() && mean > 1.0 - CLEAR {
                return None;
            }
            if mean < CLEAR && map.is_none() {
                material.opacity = mean;
                return None;
            }
            Some(Veil { in_alpha: map.is_some(), mean })
        }
    }
}

/// The share of texels that are neither there nor not.
fn veiled(texture: &Texture, factor: f32) -> f32 {
    let level = texture.mips.finest();
    let [w, h] = texture.size(level);
    let between = |x, y| {
        let a = texture.texel(level, x, y)[3] * factor;
        (CLEAR..=1.0 - CLEAR).contains(&a)
    };
    let count = (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).filter(|&(x, y)| between(x, y)).count();
    count as f32 / (w * h) as f32
}

/// Share of texels that are neither there nor not, from which on a map is no cut-out.
const VEILED_MIN: f32 = 0.01;

/// Takes away the textures that no material shows, and numbers the others anew.
fn drop_unused(materials: &mut [Material], textures: &mut Vec<Texture>) {
    let mut used = vec![false; textures.len()];
    for material in materials.iter_mut() {
        each_map(material, &mut |id| {
            if let Some(id) = id {
                used[id.0 as usize] = true;
            }
        });
    }
    let mut places = Vec::with_capacity(used.len());
    let mut next = 0;
    for &used in &used {
        places.push(next);
        next += u32::from(used);
    }
    let mut keep = used.iter();
    textures.retain(|_| keep.next().copied().unwrap_or(true));
    for material in materials {
        each_map(material, &mut |id| {
            if let Some(id) = id {
                id.0 = places[id.0 as usize];
            }
        });
    }
}

fn each_map(material: &mut Material, f: &mut dyn FnMut(&mut Option<TextureId>)) {
    match &mut material.model {
        Model::Lambert { albedo } | Model::Plastic { albedo, .. } => f(&mut albedo.map),
        Model::Mirror { specular } | Model::Metal { specular, .. } => f(&mut specular.map),
        Model::CookTorrance { diffuse, specular, .. } | Model::Ward { diffuse, specular, .. } => {
            f(&mut diffuse.map);
            f(&mut specular.map);
        }
        Model::MetalRough(m) => {
            f(&mut m.diffuse.map);
            f(&mut m.specular.map);
            f(&mut m.through.map);
            if let Some(recipe) = &mut m.recipe {
                recipe.each_map(&mut *f);
            }
        }
        Model::Conductor { .. } | Model::Dielectric { .. } => {}
    }
    if let Some(coating) = &mut material.coating {
        coating.each_map(&mut *f);
    }
    f(&mut material.emission.map);
    f(&mut material.tint.map);
    f(&mut material.opacity_map);
    f(&mut material.bump_map);
    f(&mut material.normal_map);
}
