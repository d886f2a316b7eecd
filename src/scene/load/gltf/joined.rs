//! Surfaces between metal and dielectric from their maps: of base colour, of metalness and roughness, and of what lets
//! light through, become those that are shown where they lie on each other; else all maps are read point by point
//! ([`crate::scene::recipe`]).

use std::collections::HashMap;
use std::sync::Arc;

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::materials::MetalRoughSource;
use super::surfaces::{Pending, Veil};
use super::texels::encoded;
use crate::image::luminance;
use crate::scene::metal_rough::{Coat, Layer, MetalRough, Over};
use crate::scene::recipe::{Channel, FilmMaps, Recipe, Scalar};
use crate::scene::texture::MipChain;
use crate::scene::{Placement, Reflectance, Sheen, Texture, TextureId};

/// Metalness below which what is rough counts as diffuse.
const METAL_FLOOR: f32 = 0.02;

fn rgb([r, g, b, _]: [f32; 4]) -> Vec3 {
    Vec3::new(r, g, b)
}

/// The surface of a material whose pictures have been read.
pub(super) fn surface(
    source: &MetalRoughSource,
    veil: Option<Veil>,
    p: &Pending,
    textures: &mut Vec<Texture>,
    known: &mut HashMap<Key, Joined>,
) -> MetalRough {
    let f0 = source.dielectric.clamp(Vec3::ZERO, Vec3::ONE) * source.strength;
    let mut base = p.source.base;
    if source.is_gloss {
        // The older model's own rule of energy (KHR_materials_pbrSpecularGlossiness).
        base *= 1.0 - f0.max_element();
    }
    let roughness = if source.is_gloss { 1.0 - source.roughness } else { source.roughness };
    let layer = Layer::new(f0.max_element(), source.strength);
    let coat = source.coat.map(|[strength, roughness]| Coat { strength, roughness });
    let sheen = source.sheen.map(|(color, roughness)| Sheen { color, roughness });
    let over = Over::new(coat, sheen);
    let (metallic, through) = (source.metallic, source.through);
    let rule = Rule { base, metallic, roughness, through, f0, layer };
    let maps = [p.base, p.maps.rough, p.maps.through.filter(|_| through > 0.0)];
    let coverage = if veil.is_some() { p.source.base_alpha } else { 1.0 };
    let coverage_in_alpha = veil.is_some_and(|v| v.in_alpha);
    let mut placements = maps.iter().flatten().map(|map| textures[map.0 as usize].placement);
    let first = placements.next();
    let lie_apart = first.is_some_and(|first| placements.any(|other| !other.agrees(&first)));
    let is_special = p.maps.are_special() || source.film.is_some() || source.passes.is_some();
    let is_plain = coverage >= 1.0
        && !coverage_in_alpha
        && through <= 0.0
        && over.is_none()
        && source.grain.is_none()
        && source.film.is_none();
    let around = Around { coverage, coverage_in_alpha, over, is_plain };
    if lie_apart || is_special {
        return by_recipe(&rule, source, &around, p, textures);
    }
    let mut made = flat(&rule, source, &around, maps, p.source.gloss_floor, textures, known);
    if made.is_diffuse {
        // The base gets what its layer reflects on average; a map has no place for it, so there it grows in proportion.
        let mean = rule.layer.mean(made.roughness);
        made.diffuse.color = match made.diffuse.map {
            None => made.diffuse.color + Vec3::splat(mean),
            Some(_) => made.diffuse.color / (1.0 - mean),
        };
    }
    // The base layer shows what is left of it below coat and fibres, where it is there.
    made.diffuse.color *= over.map_or(1.0, |o| o.kept_mean()) * coverage;
    made
}

/// What is beside and over a layer and its base.
struct Around {
    coverage: f32,
    coverage_in_alpha: bool,
    over: Option<Over>,
    /// Whether there is nothing.
    is_plain: bool,
}

/// A surface without maps.
fn constant(rule: &Rule, source: &MetalRoughSource, around: &Around, diffuse: Reflectance) -> MetalRough {
    MetalRough {
        diffuse,
        specular: Reflectance::constant(rule.f0),
        roughness_in_alpha: false,
        metallic: Some(rule.metallic),
        metallic_in_alpha: false,
        roughness: rule.roughness,
        roughness_range: [rule.roughness; 2],
        specular_mean: luminance(rule.f0),
        through: Reflectance::constant(Vec3::ZERO),
        coverage: around.coverage,
        coverage_in_alpha: around.coverage_in_alpha,
        over: around.over,
        grain: source.grain,
        recipe: None,
        is_diffuse: false,
        layer: rule.layer.clone(),
    }
}

/// A surface whose maps lie on each other, if there are several.
fn flat(
    rule: &Rule,
    source: &MetalRoughSource,
    around: &Around,
    maps: [Option<TextureId>; 3],
    gloss_floor: f32,
    textures: &mut Vec<Texture>,
    known: &mut HashMap<Key, Joined>,
) -> MetalRough {
    let &Rule { metallic, roughness, through, .. } = rule;
    let [base_map, rough, through_map] = maps;
    let constant = |diffuse, specular, specular_mean| MetalRough {
        specular,
        specular_mean,
        ..constant(rule, source, around, diffuse)
    };
    let base = |color| Reflectance { color, map: base_map };
    let base_mean = base_map.map_or(Vec3::ONE, |map| rgb(textures[map.0 as usize].mean())) * rule.base;
    let mixed = base_map.is_some() && metallic > 0.0 && metallic < 1.0;
    let in_alpha = around.coverage_in_alpha;
    if rough.is_some() || through_map.is_some() || in_alpha || mixed {
        let factors = [rule.base.x, rule.base.y, rule.base.z, metallic, roughness, through];
        let mut bits = [rule.layer.f90.to_bits(); 10];
        let factors = factors.into_iter().chain(rule.f0.to_array());
        bits.iter_mut().zip(factors).for_each(|(b, f)| *b = f.to_bits());
        let key = (maps.map(|m| m.map(|t| t.0)), in_alpha, bits);
        let j = known.entry(key).or_insert_with(|| join(rule, maps, in_alpha, textures)).clone();
        let mean = luminance(rgb(textures[j.specular.0 as usize].mean()));
        let diffuse = if j.metal[0] >= 1.0 && !in_alpha {
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
            metallic_in_alpha: least < most && diffuse.map.is_some() && !in_alpha,
            roughness: j.mean,
            roughness_range: j.range,
            is_diffuse: around.is_plain && j.metal[1] <= METAL_FLOOR && j.range[0] >= gloss_floor,
            through,
            ..constant(diffuse, Reflectance { color: Vec3::ONE, map: Some(j.specular) }, mean)
        }
    } else if metallic >= 1.0 {
        constant(Reflectance::constant(Vec3::ZERO), base(rule.base), luminance(base_mean))
    } else {
        let [diffuse, f0, passed] = rule.at(rule.base, metallic, roughness, through);
        let made = constant(base(diffuse), Reflectance::constant(f0), luminance(f0));
        let is_diffuse = around.is_plain && metallic <= METAL_FLOOR && roughness >= gloss_floor;
        MetalRough { is_diffuse, through: base(passed), ..made }
    }
}

/// A surface whose maps are read point by point. What is known of it as a whole comes from their means.
fn by_recipe(
    rule: &Rule,
    source: &MetalRoughSource,
    around: &Around,
    p: &Pending,
    textures: &[Texture],
) -> MetalRough {
    let maps = &p.maps;
    let scalar =
        |factor: f32, map: Option<TextureId>, channel| Scalar { factor, map: map.map(|m| (m, channel)) };
    let mut recipe = Recipe {
        base: Reflectance { color: p.source.base, map: p.base },
        coverage: scalar(around.coverage, p.base.filter(|_| around.coverage_in_alpha), Channel::Alpha),
        metallic: scalar(source.metallic, maps.rough, Channel::Blue),
        roughness: match source.is_gloss {
            false => scalar(source.roughness, maps.rough, Channel::Green),
            true => scalar(source.roughness, maps.specular_color, Channel::Alpha),
        },
        is_gloss: source.is_gloss,
        is_diffuse: false,
        through: scalar(source.through, maps.through, Channel::Red),
        specular: scalar(source.strength, maps.specular, Channel::Alpha),
        f0: Reflectance { color: source.dielectric, map: maps.specular_color },
        coat: source.coat.map(|[k, r]| {
            [scalar(k, maps.coat, Channel::Red), scalar(r, maps.coat_roughness, Channel::Green)]
        }),
        coat_normal: maps.coat_normal,
        sheen: source.sheen.map(|(color, r)| {
            (Reflectance { color, map: maps.sheen_color }, scalar(r, maps.sheen_roughness, Channel::Alpha))
        }),
        grain: source.grain.map(|grain| (grain, maps.grain)),
        film: source.film.map(|f| FilmMaps {
            strength: scalar(f.strength, maps.film, Channel::Red),
            ior: f.ior,
            thickness: f.thickness,
            map: maps.film_thickness,
        }),
        passes: source.passes.map(|(q, color)| {
            (scalar(q, maps.passes, Channel::Alpha), Reflectance { color, map: maps.passes_color })
        }),
    };
    let [least, most] = range(&recipe.roughness, textures);
    let roughness_range = if source.is_gloss { [1.0 - most, 1.0 - least] } else { [least, most] };
    let [_, metal] = range(&recipe.metallic, textures);
    recipe.is_diffuse = around.is_plain && metal <= METAL_FLOOR && roughness_range[0] >= p.source.gloss_floor;
    let mean = recipe.at(|map| textures[map.0 as usize].mean());
    let known = |v: Vec3, map: Option<TextureId>| {
        let of = map.map_or(Vec3::ONE, |map| rgb(textures[map.0 as usize].mean()));
        // As a factor of its picture, so that the mean is the one of the recipe.
        Reflectance { color: v / of.max(Vec3::splat(1e-3)), map }
    };
    MetalRough {
        specular: Reflectance::constant(mean.f0),
        specular_mean: luminance(mean.f0),
        metallic: Some(mean.metallic),
        roughness: mean.roughness,
        roughness_range,
        is_diffuse: recipe.is_diffuse,
        over: mean.over,
        through: known(mean.through, p.base.filter(|_| mean.through != Vec3::ZERO)),
        recipe: Some(Box::new(recipe)),
        ..constant(rule, source, around, known(mean.diffuse, p.base.filter(|_| mean.diffuse != Vec3::ZERO)))
    }
}

/// The least and the greatest value of a factor times a channel.
fn range(of: &Scalar, textures: &[Texture]) -> [f32; 2] {
    let Some((map, channel)) = of.map else { return [of.factor; 2] };
    let texture = &textures[map.0 as usize];
    let level = texture.mips.finest();
    let [w, h] = texture.size(level);
    let row = |y: usize| {
        let texels = (0..w).map(|x| texture.texel(level, x, y)[channel as usize]);
        texels.fold([1.0f32, 0.0], |[low, high], v| [low.min(v), high.max(v)])
    };
    let rows: Vec<[f32; 2]> = (0..h).into_par_iter().map(row).collect();
    let [low, high] = rows.into_iter().fold([1.0f32, 0.0], |[a, b], [c, d]| [a.min(c), b.max(d)]);
    [of.factor * low, of.factor * high]
}

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
pub(super) type Key = ([Option<u32>; 3], bool, [u32; 10]);

/// Maps that were made of others, and what is known of them.
#[derive(Clone)]
pub(super) struct Joined {
    diffuse: TextureId,
    specular: TextureId,
    through: Option<TextureId>,
    metal: [f32; 2],
    range: [f32; 2],
    mean: f32,
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
    let flat = |t: Option<&Texture>| {
        t.map(|t| {
            let wrap = t.placement.wrap;
            Texture { placement: Placement { wrap, ..Placement::default() }, ..t.clone() }
        })
    };
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
            // What nothing passes has no map of it.
            let passed = if rule.through > 0.0 { encoded(passed, 1.0) } else { [0; 4] };
            let texels = [encoded(diffuse * there, alpha), encoded(f0, r), passed];
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
    let (name, placement) =
        like.map_or((String::new(), Placement::default()), |t| (t.name.clone(), t.placement));
    let mut add = |what: &str, which: usize, has_alpha| {
        let texels = texels.iter().map(|t| t.0[which]).collect();
        let mips = Arc::new(MipChain::from_rgba8(w, h, texels, true));
        let texture =
            Texture { name: format!("{name} ({what})"), mips, has_alpha, is_color: true, placement };
        textures.push(texture);
        TextureId(textures.len() as u32 - 1)
    };
    let diffuse = add("diffuse", 0, coverage_in_alpha);
    let specular = add("specular", 1, true);
    let through = (rule.through > 0.0).then(|| add("through", 2, false));
    let mean = textures[specular.0 as usize].mean()[3];
    Joined { diffuse, specular, through, metal, range, mean }
}
