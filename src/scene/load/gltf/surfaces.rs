//! Surfaces of glTF's materials: once before pictures are read, to ask for them, and once after, when maps of base
//! colour, metalness and roughness become those that are shown ([`crate::scene::metal_rough`]).

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::super::error::{Place, Warning};
use super::super::textures::TextureRequests;
use super::materials::{Alpha, Kind, MapUse, Picture, Source};
use crate::image::{luminance, srgb_from_linear};
use crate::scene::metal_rough::{Layer, MetalRough};
use crate::scene::texture::MipChain;
use crate::scene::{Distribution, Material, MaterialId, Model, Reflectance, Roughness, Texture, TextureId};

/// r from which a dielectric counts as diffuse: in the mirrored direction of a small lamp straight above, its layer
/// adds 3 % to a grey base.
const GLOSS_FLOOR: f32 = 0.9;

/// Metalness below which it does.
const METAL_FLOOR: f32 = 0.02;

/// Alpha below which a texel is taken for nothing, and above whose complement for all.
const CLEAR: f32 = 0.02;

/// A material whose maps are still to be joined.
#[derive(Debug)]
pub(in super::super) struct Pending {
    pub material: MaterialId,
    source: Source,
    base: Option<TextureId>,
    rough: Option<TextureId>,
    place: Place,
}

/// Asks for a material's pictures. The ids in both results are those of `requests`.
pub(in super::super) fn ask(
    source: &Source,
    id: MaterialId,
    place: &Place,
    requests: &mut TextureRequests,
) -> (Material, Pending) {
    let mut ask = |map: &Option<MapUse>, is_color: bool| {
        map.as_ref().map(|m| {
            let (found, bytes) = match &m.picture {
                Picture::File(path) => (Ok(path.clone()), None),
                // Content is what makes pictures in a file the same.
                Picture::Bytes(bytes) => {
                    let key = format!("{}#{}", place.path.display(), blake3::hash(bytes).to_hex());
                    (Ok(PathBuf::from(key)), Some(bytes.clone()))
                }
                Picture::Broken(why) => (Err(why.clone()), None),
            };
            requests.ask_for(&m.name, found, bytes, is_color, m.clamp, m.scale_offset, place.clone())
        })
    };
    let base = ask(&source.base_map, true);
    let rough = match &source.kind {
        Kind::MetalRough { map, .. } => ask(map, false),
        Kind::Glass { .. } | Kind::Unlit => None,
    };
    let normal_map = ask(&source.normal, false);
    let emission_map = ask(&source.emission_map, true);
    let mut material = Material::new(
        source.name.clone(),
        Model::Lambert { albedo: Reflectance { color: source.base, map: base } },
    );
    material.normal_map = normal_map;
    material.emission = Reflectance { color: source.emission, map: emission_map };
    let pending = Pending { material: id, source: source.clone(), base, rough, place: place.clone() };
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
    let mut joined: HashMap<Key, Joined> = HashMap::new();
    for mut p in pending {
        let resolve = |id: Option<TextureId>| id.and_then(|id| ids.get(id.0 as usize).copied().flatten());
        p.base = resolve(p.base);
        p.rough = resolve(p.rough);
        let Some(material) = materials.get_mut(p.material.0 as usize) else { continue };
        let mut said = Vec::new();
        finish_one(material, &p, textures, &mut joined, &mut said);
        for message in said {
            warnings.push(Warning::new(p.place.clone(), format!("material \"{}\" {message}", material.name)));
        }
    }
    drop_unused(materials, textures);
}

fn finish_one(
    material: &mut Material,
    p: &Pending,
    textures: &mut Vec<Texture>,
    joined: &mut HashMap<Key, Joined>,
    said: &mut Vec<String>,
) {
    let s = &p.source;
    let base = Reflectance { color: s.base, map: p.base };
    let seen_through = coverage(material, p, textures, said);
    material.model = match &s.kind {
        Kind::Unlit => {
            material.emission = base;
            material.shadeless = true;
            Model::Lambert { albedo: Reflectance::constant(Vec3::ZERO) }
        }
        &Kind::Glass { ior, transmittance, thin, roughness } => {
            let tint = p.base.map_or(Vec3::ONE, |map| rgb(textures[map.0 as usize].mean()));
            let alpha = MetalRough::alpha(roughness);
            Model::Dielectric {
                ior,
                transmittance: if thin { transmittance * tint } else { transmittance },
                thin,
                roughness: Roughness { alpha_x: alpha, alpha_y: alpha, distribution: Distribution::Ggx },
            }
        }
        Kind::MetalRough { .. } if let Some(transmittance) = seen_through => Model::Dielectric {
            ior: 1.5,
            transmittance,
            thin: true,
            roughness: Roughness { alpha_x: 0.0, alpha_y: 0.0, distribution: Distribution::Ggx },
        },
        &Kind::MetalRough { metallic, roughness, f0, f90, .. } => {
            let rule =
                Rule { base: s.base, metallic, roughness, f0, layer: Layer::new(f0.max_element(), f90) };
            Model::MetalRough(Box::new(metal_rough(rule, p, textures, joined, said)))
        }
    };
}

fn rgb([r, g, b, _]: [f32; 4]) -> Vec3 {
    Vec3::new(r, g, b)
}

/// Sets what of a material is there. What is a veil throughout is seen through like a pane that passes the result.
fn coverage(
    material: &mut Material,
    p: &Pending,
    textures: &[Texture],
    said: &mut Vec<String>,
) -> Option<Vec3> {
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
            let mean = map.map_or(1.0, |map| textures[map.0 as usize].mean()[3]) * s.base_alpha;
            if map.is_none() && mean > 1.0 - CLEAR {
                return None;
            }
            if map.is_some_and(|map| 2.0 * veiled(&textures[map.0 as usize], s.base_alpha) < 1.0) {
                said.push("blends with what is behind it; cut out where its alpha is one half".to_owned());
                (material.opacity, material.opacity_map) = (s.base_alpha, map);
                return None;
            }
            if matches!(s.kind, Kind::Unlit) || mean < CLEAR {
                material.opacity = mean;
                return None;
            }
            said.push(format!("blends with what is behind it; shown as a pane of its mean alpha {mean:.2}"));
            let tint = p.base.map_or(Vec3::ONE, |map| rgb(textures[map.0 as usize].mean()));
            Some(Vec3::splat(1.0 - mean) + s.base * tint * mean)
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

/// How texels become those of a surface.
struct Rule {
    base: Vec3,
    metallic: f32,
    roughness: f32,
    f0: Vec3,
    layer: Layer,
}

impl Rule {
    /// (1 − m) b (1 − Ē), and f₀.
    fn at(&self, base: Vec3, m: f32, r: f32) -> [Vec3; 2] {
        [base * ((1.0 - m) * (1.0 - self.layer.mean(r))), self.f0 * (1.0 - m) + base * m]
    }
}

/// What makes two joined maps the same.
type Key = (Option<u32>, Option<u32>, [u32; 9]);

/// Maps that were made of others, and what is known of them.
#[derive(Clone)]
struct Joined {
    diffuse: TextureId,
    specular: TextureId,
    metal: [f32; 2],
    range: [f32; 2],
    mean: f32,
}

fn metal_rough(
    rule: Rule,
    p: &Pending,
    textures: &mut Vec<Texture>,
    joined: &mut HashMap<Key, Joined>,
    said: &mut Vec<String>,
) -> MetalRough {
    let same = |a: &Texture, b: &Texture| a.scale_offset == b.scale_offset && a.clamp == b.clamp;
    let (mut metallic, mut roughness, mut rough) = (rule.metallic, rule.roughness, p.rough);
    let apart =
        rough.zip(p.base).is_some_and(|(r, b)| !same(&textures[r.0 as usize], &textures[b.0 as usize]));
    if let Some(map) = rough.filter(|_| apart) {
        let [_, green, blue, _] = textures[map.0 as usize].mean();
        (metallic, roughness, rough) = (metallic * blue, roughness * green, None);
        said.push(
            "has maps of colour and roughness that lie differently; the means of roughness and metalness"
                .into(),
        );
    }
    let rule = Rule { metallic, roughness, ..rule };
    let constant = |diffuse, specular, specular_mean| MetalRough {
        diffuse,
        specular,
        roughness_in_alpha: false,
        roughness,
        roughness_range: [roughness; 2],
        specular_mean,
        is_diffuse: false,
        layer: rule.layer.clone(),
    };
    let base = |color| Reflectance { color, map: p.base };
    let base_mean = p.base.map_or(Vec3::ONE, |map| rgb(textures[map.0 as usize].mean())) * rule.base;
    let mut made = if rough.is_some() || (p.base.is_some() && metallic > 0.0 && metallic < 1.0) {
        let factors =
            [rule.base.x, rule.base.y, rule.base.z, metallic, roughness, rule.f0.x, rule.f0.y, rule.f0.z];
        let mut bits = [rule.layer.f90.to_bits(); 9];
        bits.iter_mut().zip(factors).for_each(|(b, f)| *b = f.to_bits());
        let key = (p.base.map(|t| t.0), rough.map(|t| t.0), bits);
        let j = joined.entry(key).or_insert_with(|| join(&rule, p.base, rough, textures)).clone();
        let mean = luminance(rgb(textures[j.specular.0 as usize].mean()));
        let diffuse = if j.metal[0] >= 1.0 {
            Reflectance::constant(Vec3::ZERO)
        } else {
            Reflectance { color: Vec3::ONE, map: Some(j.diffuse) }
        };
        MetalRough {
            roughness_in_alpha: true,
            roughness: j.mean,
            roughness_range: j.range,
            is_diffuse: j.metal[1] <= METAL_FLOOR && j.range[0] >= GLOSS_FLOOR,
            ..constant(diffuse, Reflectance { color: Vec3::ONE, map: Some(j.specular) }, mean)
        }
    } else if metallic >= 1.0 {
        constant(Reflectance::constant(Vec3::ZERO), base(rule.base), luminance(base_mean))
    } else {
        let [diffuse, f0] = rule.at(rule.base, metallic, roughness);
        let made = constant(base(diffuse), Reflectance::constant(f0), luminance(f0));
        MetalRough { is_diffuse: metallic <= METAL_FLOOR && roughness >= GLOSS_FLOOR, ..made }
    };
    if made.is_diffuse {
        // The base gets what its layer reflects on average; a map has no place for it, so there it grows in proportion.
        let mean = rule.layer.mean(made.roughness);
        made.diffuse.color = match made.diffuse.map {
            None => made.diffuse.color + Vec3::splat(mean),
            Some(_) => made.diffuse.color / (1.0 - mean),
        };
    }
    made
}

/// Makes the maps of a surface from those of base colour and of roughness (green) and metalness (blue).
fn join(
    rule: &Rule,
    base: Option<TextureId>,
    rough: Option<TextureId>,
    textures: &mut Vec<Texture>,
) -> Joined {
    let of = |id: Option<TextureId>| id.map(|id| &textures[id.0 as usize]);
    let (base, rough) = (of(base), of(rough));
    let size = |t: Option<&Texture>| t.map_or([1, 1], |t| t.size(0));
    let [a, b] = [size(base), size(rough)];
    let (w, h) = (a[0].max(b[0]), a[1].max(b[1]));
    // Coordinates are those of both maps, so texels are read where they lie, without scale and offset.
    let flat = |t: Option<&Texture>| t.map(|t| Texture { scale_offset: [1.0, 1.0, 0.0, 0.0], ..t.clone() });
    let (flat_base, flat_rough) = (flat(base), flat(rough));
    let look = |t: &Option<Texture>, x: usize, y: usize| match t {
        None => [1.0; 4],
        Some(t) if t.size(0) == [w, h] => t.texel(0, x, y),
        Some(t) => {
            let uv = Vec2::new((x as f32 + 0.5) / w as f32, 1.0 - (y as f32 + 0.5) / h as f32);
            t.sample(uv, 0.0)
        }
    };
    let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
    let encode = |c: Vec3, alpha: f32| {
        let [r, g, b] = c.clamp(Vec3::ZERO, Vec3::ONE).to_array().map(|v| byte(srgb_from_linear(v)));
        [r, g, b, byte(alpha)]
    };
    let texels: Vec<([u8; 4], [u8; 4], u8)> = (0..w * h)
        .into_par_iter()
        .map(|i| {
            let (x, y) = (i % w, i / w);
            let color = rgb(look(&flat_base, x, y)) * rule.base;
            let [_, green, blue, _] = look(&flat_rough, x, y);
            let (m, r) = ((rule.metallic * blue).clamp(0.0, 1.0), (rule.roughness * green).clamp(0.0, 1.0));
            let [diffuse, f0] = rule.at(color, m, r);
            (encode(diffuse, 1.0), encode(f0, r), byte(m))
        })
        .collect();
    let bounds = |v: &mut dyn Iterator<Item = u8>| {
        let (low, high) = v.fold((255, 0), |(low, high), v| (v.min(low), v.max(high)));
        [f32::from(low) / 255.0, f32::from(high) / 255.0]
    };
    let metal = bounds(&mut texels.iter().map(|t| t.2));
    let range = bounds(&mut texels.iter().map(|t| t.1[3]));
    let like = base.or(rough);
    let (name, clamp, scale_offset) = like
        .map_or((String::new(), false, [1.0, 1.0, 0.0, 0.0]), |t| (t.name.clone(), t.clamp, t.scale_offset));
    let mut add = |what: &str, texels: Vec<[u8; 4]>, has_alpha| {
        let mips = Arc::new(MipChain::from_rgba8(w, h, texels, true));
        let texture = Texture {
            name: format!("{name} ({what})"),
            mips,
            has_alpha,
            is_color: true,
            clamp,
            scale_offset,
        };
        textures.push(texture);
        TextureId(textures.len() as u32 - 1)
    };
    let diffuse = add("diffuse", texels.iter().map(|t| t.0).collect(), false);
    let specular = add("specular", texels.iter().map(|t| t.1).collect(), true);
    let mean = textures[specular.0 as usize].mean()[3];
    Joined { diffuse, specular, metal, range, mean }
}

/// Takes away the textures that no material shows, and numbers the others anew.
fn drop_unused(materials: &mut [Material], textures: &mut Vec<Texture>) {
    let mut used = vec![false; textures.len()];
    for material in materials.iter_mut() {
        each_map(material, |id| {
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
        each_map(material, |id| {
            if let Some(id) = id {
                id.0 = places[id.0 as usize];
            }
        });
    }
}

fn each_map(material: &mut Material, mut f: impl FnMut(&mut Option<TextureId>)) {
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
        }
        Model::Conductor { .. } | Model::Dielectric { .. } => {}
    }
    f(&mut material.emission.map);
    f(&mut material.opacity_map);
    f(&mut material.bump_map);
    f(&mut material.normal_map);
}
