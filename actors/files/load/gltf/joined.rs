//! Surfaces between metal and dielectric from their maps: of base colour, of metalness and roughness, and of what lets
//! light through, become those that are shown where they lie on each other; else all maps are read point by point
//! ([`foveal::scene::recipe`]).

use std::collections::HashMap;

use glam::Vec3;
use rayon::prelude::*;

use super::joined_maps::{Joined, Key, Rule, join};
use super::materials::{FilmSource, Maps, MetalRoughSource};
use super::surfaces::{Pending, Veil};
use super::texels::mean_of;
use foveal::image::luminance;
use foveal::scene::metal_rough::{Clearcoat, Layer, MetalRough, Over};
use foveal::scene::recipe::{Channel, FilmMaps, Recipe, Scalar};
use foveal::scene::{Reflectance, Sheen, Texture, TextureId};

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
    let coat = source.coat.map(|[strength, roughness]| Clearcoat { strength, roughness });
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
        maps_agree: false,
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
    let mixed = base_map.is_some() && metallic > 0.0 && metallic < 1.0;
    let in_alpha = around.coverage_in_alpha;
    if rough.is_some() || through_map.is_some() || in_alpha || mixed {
        let factors = [rule.base.x, rule.base.y, rule.base.z, metallic, roughness, through];
        let mut bits = [rule.layer.f90.to_bits(); 10];
        let factors = factors.into_iter().chain(rule.f0.to_array());
        bits.iter_mut().zip(factors).for_each(|(b, f)| *b = f.to_bits());
        let key = (maps.map(|m| m.map(|t| t.0)), in_alpha, bits);
        let j = known.entry(key).or_insert_with(|| join(rule, maps, in_alpha, textures)).clone();
        let mean = luminance(rgb(mean_of(j.specular, textures)));
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
            maps_agree: diffuse.map.is_some(),
            is_diffuse: around.is_plain && j.metal[1] <= METAL_FLOOR && j.range[0] >= gloss_floor,
            through,
            ..constant(diffuse, Reflectance { color: Vec3::ONE, map: Some(j.specular) }, mean)
        }
    } else if metallic >= 1.0 {
        let mean = base_map.map_or(Vec3::ONE, |map| rgb(mean_of(map, textures))) * rule.base;
        constant(Reflectance::constant(Vec3::ZERO), base(rule.base), luminance(mean))
    } else {
        let [diffuse, f0, passed] = rule.at(rule.base, metallic, roughness, through);
        let made = constant(base(diffuse), Reflectance::constant(f0), luminance(f0));
        let is_diffuse = around.is_plain && metallic <= METAL_FLOOR && roughness >= gloss_floor;
        MetalRough { is_diffuse, through: base(passed), ..made }
    }
}

/// A factor times a channel of a map, if there is one.
pub(super) fn scalar(factor: f32, map: Option<TextureId>, channel: Channel) -> Scalar {
    Scalar { factor, map: map.map(|map| (map, channel)) }
}

/// A film and its maps.
pub(super) fn film_maps(film: FilmSource, maps: &Maps<TextureId>) -> FilmMaps {
    FilmMaps {
        strength: scalar(film.strength, maps.film, Channel::Red),
        ior: film.ior,
        thickness: film.thickness,
        map: maps.film_thickness,
    }
}

/// A surface whose maps are read point by point. What is known of it as a whole comes from their means.
fn by_recipe(
    rule: &Rule,
    source: &MetalRoughSource,
    around: &Around,
    p: &Pending,
    textures: &mut [Texture],
) -> MetalRough {
    let maps = &p.maps;
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
        film: source.film.map(|film| film_maps(film, maps)),
        passes: source.passes.map(|(q, color)| {
            (scalar(q, maps.passes, Channel::Alpha), Reflectance { color, map: maps.passes_color })
        }),
    };
    let [least, most] = range(&recipe.roughness, textures);
    let roughness_range = if source.is_gloss { [1.0 - most, 1.0 - least] } else { [least, most] };
    let [_, metal] = range(&recipe.metallic, textures);
    recipe.is_diffuse = around.is_plain && metal <= METAL_FLOOR && roughness_range[0] >= p.source.gloss_floor;
    for map in recipe.maps() {
        mean_of(map, textures);
    }
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
