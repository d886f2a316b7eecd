//! Surfaces of glTF's materials: once before pictures are read, to ask for them, and once after, when maps of base
//! colour, metalness and roughness become those that are shown ([`crate::scene::metal_rough`]).

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::super::error::{Place, Warning};
use super::super::textures::TextureRequests;
use super::materials::{Alpha, Kind, MapUse, MetalRoughSource, Picture, Source};
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
    through: Option<TextureId>,
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
    let [rough, through] = match &source.kind {
        Kind::MetalRough(m) => [ask(&m.map, false), ask(&m.through_map, false)],
        Kind::Glass { .. } | Kind::Unlit => [None, None],
    };
    let normal_map = ask(&source.normal, false);
    let emission_map = ask(&source.emission_map, true);
    let mut material = Material::new(
        source.name.clone(),
        Model::Lambert { albedo: Reflectance { color: source.base, map: base } },
    );
    material.normal_map = normal_map;
    material.emission = Reflectance { color: source.emission, map: emission_map };
    let pending =
        Pending { material: id, source: source.clone(), base, rough, through, place: place.clone() };
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
    let mut leaning: HashMap<(TextureId, u32), TextureId> = HashMap::new();
    for mut p in pending {
        let resolve = |id: Option<TextureId>| id.and_then(|id| ids.get(id.0 as usize).copied().flatten());
        p.base = resolve(p.base);
        p.rough = resolve(p.rough);
        p.through = resolve(p.through);
        let Some(material) = materials.get_mut(p.material.0 as usize) else { continue };
        if let Some(map) = material.normal_map.filter(|_| p.source.normal_scale != 1.0) {
            let key = (map, p.source.normal_scale.to_bits());
            let scaled = leaning.entry(key).or_insert_with(|| lean(map, p.source.normal_scale, textures));
            material.normal_map = Some(*scaled);
        }
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
                        layer: Layer::new(0.0, 0.0),
                        specular_mean: 0.0,
                        through: Reflectance::constant(Vec3::ZERO),
                        coverage: s.base_alpha,
                        coverage_in_alpha: veil.in_alpha,
                        over: None,
                        grain: None,
                        is_diffuse: false,
                    }))
                }
            }
        }
        &Kind::Glass { ior, transmittance, roughness } => {
            let alpha = MetalRough::alpha(roughness);
            material.tint = base;
            Model::Dielectric {
                ior,
                transmittance,
                thin: false,
                roughness: Roughness { alpha_x: alpha, alpha_y: alpha, distribution: Distribution::Ggx },
            }
        }
        Kind::MetalRough(m) => {
            let rule = Rule {
                base: s.base,
                metallic: m.metallic,
                roughness: m.roughness,
                through: m.through,
                f0: m.f0,
                layer: Layer::new(m.f0.max_element(), m.f90),
            };
            Model::MetalRough(Box::new(metal_rough(rule, m, veil, p, textures, joined, said)))
        }
    };
}

/// What is half there.
struct Veil {
    /// Whether the base map's alpha says how much of it.
    in_alpha: bool,
    /// How much on average.
    mean: f32,
}

fn rgb([r, g, b, _]: [f32; 4]) -> Vec3 {
    Vec3::new(r, g, b)
}

/// Sets what of a material is there, and says whether it is a veil.
fn coverage(
    material: &mut Material,
    p: &Pending,
    textures: &[Texture],
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
            let mean = map.map_or(1.0, |map| textures[map.0 as usize].mean()[3]) * s.base_alpha;
            if map.is_none() && mean > 1.0 - CLEAR {
                return None;
            }
            if map.is_some_and(|map| veiled(&textures[map.0 as usize], s.base_alpha) < VEILED_MIN) {
                said.push("blends with what is behind it; cut out where its alpha is one half".to_owned());
                (material.opacity, material.opacity_map) = (s.base_alpha, map);
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

/// A map of normals that lean `scale` times as far.
fn lean(map: TextureId, scale: f32, textures: &mut Vec<Texture>) -> TextureId {
    let of = &textures[map.0 as usize];
    let [w, h] = of.size(0);
    let texel = |i: usize| {
        let [x, y, z, _] = of.texel(0, i % w, i / w).map(|v| 2.0 * v - 1.0);
        let n = Vec3::new(x * scale, y * scale, z).try_normalize().unwrap_or(Vec3::Z);
        let [x, y, z] = n.to_array().map(|v| ((0.5 * v + 0.5) * 65_535.0 + 0.5) as u16);
        [x, y, z, u16::MAX]
    };
    let texels = (0..w * h).into_par_iter().map(texel).collect();
    let mips = Arc::new(MipChain::from_rgba16(w, h, texels));
    let texture = Texture { name: format!("{} (leaning)", of.name), mips, ..of.clone() };
    textures.push(texture);
    TextureId(textures.len() as u32 - 1)
}

/// A map whose colours are multiplied by its alpha.
fn premultiplied(map: TextureId, textures: &mut Vec<Texture>) -> TextureId {
    let of = &textures[map.0 as usize];
    let [w, h] = of.size(0);
    let texel = |i: usize| {
        let [r, g, b, a] = of.texel(0, i % w, i / w);
        encoded(Vec3::new(r, g, b) * a, a)
    };
    let texels = (0..w * h).into_par_iter().map(texel).collect();
    let mips = Arc::new(MipChain::from_rgba8(w, h, texels, true));
    let texture = Texture { name: format!("{} (veil)", of.name), mips, is_color: true, ..of.clone() };
    textures.push(texture);
    TextureId(textures.len() as u32 - 1)
}

/// Linear colours and an alpha as they are stored.
fn encoded(c: Vec3, alpha: f32) -> [u8; 4] {
    let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
    let [r, g, b] = c.clamp(Vec3::ZERO, Vec3::ONE).to_array().map(|v| byte(srgb_from_linear(v)));
    [r, g, b, byte(alpha)]
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

/// How texels become those of a surface.
struct Rule {
    base: Vec3,
    metallic: f32,
    roughness: f32,
    through: f32,
    f0: Vec3,
    layer: Layer,
}

impl Rule {
    /// (1 − m) (1 − t) b (1 − Ē), f₀, and t (1 − m) b.
    fn at(&self, base: Vec3, m: f32, r: f32, t: f32) -> [Vec3; 3] {
        let below = base * (1.0 - m);
        [below * ((1.0 - t) * (1.0 - self.layer.mean(r))), self.f0 * (1.0 - m) + base * m, below * t]
    }
}

/// What makes two joined maps the same.
type Key = ([Option<u32>; 3], bool, [u32; 10]);

/// Maps that were made of others, and what is known of them.
#[derive(Clone)]
struct Joined {
    diffuse: TextureId,
    specular: TextureId,
    through: Option<TextureId>,
    metal: [f32; 2],
    range: [f32; 2],
    mean: f32,
}

fn metal_rough(
    rule: Rule,
    source: &MetalRoughSource,
    veil: Option<Veil>,
    p: &Pending,
    textures: &mut Vec<Texture>,
    joined: &mut HashMap<Key, Joined>,
    said: &mut Vec<String>,
) -> MetalRough {
    let same = |a: &Texture, b: &Texture| a.scale_offset == b.scale_offset && a.clamp == b.clamp;
    let (mut metallic, mut roughness, mut rough) = (rule.metallic, rule.roughness, p.rough);
    let (mut through, mut through_map) = (rule.through, p.through.filter(|_| rule.through > 0.0));
    let apart = |a: Option<TextureId>, b: Option<TextureId>| {
        a.zip(b).is_some_and(|(a, b)| !same(&textures[a.0 as usize], &textures[b.0 as usize]))
    };
    if let Some(map) = rough.filter(|_| apart(rough, p.base)) {
        let [_, green, blue, _] = textures[map.0 as usize].mean();
        (metallic, roughness, rough) = (metallic * blue, roughness * green, None);
        said.push(
            "has maps of colour and roughness that lie differently; the means of roughness and metalness"
                .into(),
        );
    }
    if let Some(map) = through_map.filter(|_| apart(through_map, p.base) || apart(through_map, rough)) {
        (through, through_map) = (through * textures[map.0 as usize].mean()[0], None);
        said.push("has a map of transmission that lies differently from others; its mean".into());
    }
    let rule = Rule { metallic, roughness, through, ..rule };
    let (kept, alpha) = (source.over.map_or(1.0, |o| o.kept_mean()), p.source.base_alpha);
    let coverage_in_alpha = veil.as_ref().is_some_and(|v| v.in_alpha);
    let coverage = if veil.is_some() { alpha } else { 1.0 };
    let is_plain = veil.is_none() && through <= 0.0 && source.over.is_none() && source.grain.is_none();
    let constant = |diffuse, specular, specular_mean| MetalRough {
        diffuse,
        specular,
        roughness_in_alpha: false,
        metallic: Some(metallic),
        metallic_in_alpha: false,
        roughness,
        roughness_range: [roughness; 2],
        specular_mean,
        through: Reflectance::constant(Vec3::ZERO),
        coverage,
        coverage_in_alpha,
        over: source.over,
        grain: source.grain,
        is_diffuse: false,
        layer: rule.layer.clone(),
    };
    let base = |color| Reflectance { color, map: p.base };
    let base_mean = p.base.map_or(Vec3::ONE, |map| rgb(textures[map.0 as usize].mean())) * rule.base;
    let mixed = p.base.is_some() && metallic > 0.0 && metallic < 1.0;
    let mut made = if rough.is_some() || through_map.is_some() || coverage_in_alpha || mixed {
        let factors = [
            rule.base.x,
            rule.base.y,
            rule.base.z,
            metallic,
            roughness,
            through,
            rule.f0.x,
            rule.f0.y,
            rule.f0.z,
        ];
        let mut bits = [rule.layer.f90.to_bits(); 10];
        bits.iter_mut().zip(factors).for_each(|(b, f)| *b = f.to_bits());
        let maps = [p.base, rough, through_map];
        let key = (maps.map(|m| m.map(|t| t.0)), coverage_in_alpha, bits);
        let j = joined.entry(key).or_insert_with(|| join(&rule, maps, coverage_in_alpha, textures)).clone();
        let mean = luminance(rgb(textures[j.specular.0 as usize].mean()));
        let diffuse = if j.metal[0] >= 1.0 && !coverage_in_alpha {
            Reflectance::constant(Vec3::ZERO)
        } else {
            Reflectance { color: Vec3::ONE, map: Some(j.diffuse) }
        };
        let through = j.through.map_or(Reflectance::constant(Vec3::ZERO), |map| Reflectance {
            color: Vec3::ONE,
            map: Some(map),
        });
        let [least, most] = j.metal;
        MetalRough {
            roughness_in_alpha: true,
            metallic: (least == most).then_some(least),
            metallic_in_alpha: least < most && diffuse.map.is_some() && !coverage_in_alpha,
            roughness: j.mean,
            roughness_range: j.range,
            is_diffuse: is_plain && j.metal[1] <= METAL_FLOOR && j.range[0] >= GLOSS_FLOOR,
            through,
            ..constant(diffuse, Reflectance { color: Vec3::ONE, map: Some(j.specular) }, mean)
        }
    } else if metallic >= 1.0 {
        constant(Reflectance::constant(Vec3::ZERO), base(rule.base), luminance(base_mean))
    } else {
        let [diffuse, f0, passed] = rule.at(rule.base, metallic, roughness, through);
        let made = constant(base(diffuse), Reflectance::constant(f0), luminance(f0));
        let is_diffuse = is_plain && metallic <= METAL_FLOOR && roughness >= GLOSS_FLOOR;
        MetalRough { is_diffuse, through: base(passed), ..made }
    };
    if made.is_diffuse {
        // The base gets what its layer reflects on average; a map has no place for it, so there it grows in proportion.
        let mean = rule.layer.mean(made.roughness);
        made.diffuse.color = match made.diffuse.map {
            None => made.diffuse.color + Vec3::splat(mean),
            Some(_) => made.diffuse.color / (1.0 - mean),
        };
    }
    // The base layer shows what is left of it below coat and fibres, where it is there.
    made.diffuse.color *= kept * coverage;
    made
}

/// Makes the maps of a surface from those of base colour, of roughness (green) and metalness (blue), and of transmission
/// (red). Where the base colour's alpha says what is there, the diffuse map is multiplied by it and has it.
fn join(
    rule: &Rule,
    maps: [Option<TextureId>; 3],
    coverage_in_alpha: bool,
    textures: &mut Vec<Texture>,
) -> Joined {
    let of = |id: Option<TextureId>| id.map(|id| &textures[id.0 as usize]);
    let size = |t: Option<&Texture>| t.map_or([1, 1], |t| t.size(0));
    let [w, h] = maps.map(|m| size(of(m))).into_iter().fold([1, 1], |[w, h], [a, b]| [w.max(a), h.max(b)]);
    // Coordinates are those of all maps, so texels are read where they lie, without scale and offset.
    let flat = |t: Option<&Texture>| t.map(|t| Texture { scale_offset: [1.0, 1.0, 0.0, 0.0], ..t.clone() });
    let [flat_base, flat_rough, flat_through] = maps.map(|m| flat(of(m)));
    let look = |t: &Option<Texture>, x: usize, y: usize| match t {
        None => [1.0; 4],
        Some(t) if t.size(0) == [w, h] => t.texel(0, x, y),
        Some(t) => {
            let uv = Vec2::new((x as f32 + 0.5) / w as f32, 1.0 - (y as f32 + 0.5) / h as f32);
            t.sample(uv, 0.0)
        }
    };
    let texels: Vec<([[u8; 4]; 3], u8)> = (0..w * h)
        .into_par_iter()
        .map(|i| {
            let (x, y) = (i % w, i / w);
            let [red, green, blue, alpha] = look(&flat_base, x, y);
            let color = Vec3::new(red, green, blue) * rule.base;
            let there = if coverage_in_alpha { alpha } else { 1.0 };
            let [_, green, blue, _] = look(&flat_rough, x, y);
            let (m, r) = ((rule.metallic * blue).clamp(0.0, 1.0), (rule.roughness * green).clamp(0.0, 1.0));
            let t = (rule.through * look(&flat_through, x, y)[0]).clamp(0.0, 1.0);
            let [diffuse, f0, passed] = rule.at(color, m, r, t);
            // What is there, or else how much of it is metal.
            let alpha = if coverage_in_alpha { there } else { m };
            let texels = [encoded(diffuse * there, alpha), encoded(f0, r), encoded(passed, 1.0)];
            (texels, (m * 255.0 + 0.5) as u8)
        })
        .collect();
    let bounds = |v: &mut dyn Iterator<Item = u8>| {
        let (low, high) = v.fold((255, 0), |(low, high), v| (v.min(low), v.max(high)));
        [f32::from(low) / 255.0, f32::from(high) / 255.0]
    };
    let metal = bounds(&mut texels.iter().map(|t| t.1));
    let range = bounds(&mut texels.iter().map(|t| t.0[1][3]));
    let like = maps.iter().find_map(|m| of(*m));
    let (name, clamp, scale_offset) = like
        .map_or((String::new(), false, [1.0, 1.0, 0.0, 0.0]), |t| (t.name.clone(), t.clamp, t.scale_offset));
    let mut add = |what: &str, which: usize, has_alpha| {
        let texels = texels.iter().map(|t| t.0[which]).collect();
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
    let diffuse = add("diffuse", 0, coverage_in_alpha);
    let specular = add("specular", 1, true);
    let through = (rule.through > 0.0).then(|| add("through", 2, false));
    let mean = textures[specular.0 as usize].mean()[3];
    Joined { diffuse, specular, through, metal, range, mean }
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
            f(&mut m.through.map);
        }
        Model::Conductor { .. } | Model::Dielectric { .. } => {}
    }
    f(&mut material.emission.map);
    f(&mut material.tint.map);
    f(&mut material.opacity_map);
    f(&mut material.bump_map);
    f(&mut material.normal_map);
}
