//! Surfaces between metal and dielectric whose maps are read point by point: where they lie apart from each other, or say
//! what few surfaces have. All others are made ready when a scene is loaded ([`super::metal_rough`]), by the same formulas.

use glam::Vec3;

use super::metal_rough::{Clearcoat, Film, Grain, MetalRough, Over};
use super::{LobeAlbedo, Reflectance, Sheen, TextureId};
use crate::math;

/// A channel of a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Channel {
    /// The first.
    Red,
    /// The second.
    Green,
    /// The third.
    Blue,
    /// The last.
    Alpha,
}

/// A factor times one channel of a map; linear.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Scalar {
    /// The factor, or the value where there is no map.
    pub factor: f32,
    /// The map.
    pub map: Option<(TextureId, Channel)>,
}

impl Scalar {
    /// A value without map.
    pub const fn constant(factor: f32) -> Self {
        Self { factor, map: None }
    }

    /// The value, in [0, 1], where `texel` reads the map.
    pub fn at(&self, texel: &impl Fn(TextureId) -> [f32; 4]) -> f32 {
        let share = self.map.map_or(1.0, |(map, channel)| texel(map)[channel as usize]);
        (self.factor * share).clamp(0.0, 1.0)
    }

    /// Calls `f` with the place of its map, if it has one; it may be changed, but not taken away.
    pub fn each_map(&mut self, f: &mut impl FnMut(&mut Option<TextureId>)) {
        if let Some((map, channel)) = self.map {
            let mut place = Some(map);
            f(&mut place);
            self.map = place.map(|map| (map, channel));
        }
    }
}

/// A film whose strength and thickness may come from maps.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct FilmMaps {
    /// How much of it is there.
    pub strength: Scalar,
    /// Refractive index.
    pub ior: f32,
    /// Thickness where the map is 0 and where it is 1, or there is none, nanometres.
    pub thickness: [f32; 2],
    /// Of thickness, in green.
    pub map: Option<TextureId>,
}

impl FilmMaps {
    /// The film where `texel` reads the maps.
    pub fn at(&self, texel: &impl Fn(TextureId) -> [f32; 4]) -> Film {
        let [low, high] = self.thickness;
        let share = self.map.map_or(1.0, |map| texel(map)[1]);
        Film { strength: self.strength.at(texel), ior: self.ior, thickness: low + (high - low) * share }
    }

    /// Calls `f` with each place of a map; it may be changed, but not taken away.
    pub fn each_map(&mut self, f: &mut impl FnMut(&mut Option<TextureId>)) {
        self.strength.each_map(f);
        f(&mut self.map);
    }
}

/// What a surface is made of.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Recipe {
    /// b.
    pub base: Reflectance,
    /// The share of the surface that is there.
    pub coverage: Scalar,
    /// m.
    pub metallic: Scalar,
    /// r.
    pub roughness: Scalar,
    /// Whether `roughness` says how smooth it is instead.
    pub is_gloss: bool,
    /// Whether all of it is shown as diffuse, with what its layer reflects on average.
    pub is_diffuse: bool,
    /// The share of what is no metal that lets light through in a line.
    pub through: Scalar,
    /// f₉₀ of the dielectric, and a factor of its f₀.
    pub specular: Scalar,
    /// f₀ of the dielectric, before it is bounded by 1.
    pub f0: Reflectance,
    /// Strength and r of a clear coat.
    pub coat: Option<[Scalar; 2]>,
    /// Normals of that coat.
    pub coat_normal: Option<TextureId>,
    /// Reflectance and r of fibres.
    pub sheen: Option<(Reflectance, Scalar)>,
    /// Grooves, and a map of their direction (red, green) and strength (blue).
    pub grain: Option<(Grain, Option<TextureId>)>,
    /// A film over the layer.
    pub film: Option<FilmMaps>,
    /// The share of the diffuse part that leaves on the other side, and its colour.
    pub passes: Option<(Scalar, Reflectance)>,
}

/// A surface at a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Made {
    /// Albedo of the view-independent part on the side that light comes from.
    pub diffuse: Vec3,
    /// The same of what leaves on the other side.
    pub passed: Vec3,
    /// f₀ of layer and metal together.
    pub f0: Vec3,
    /// m.
    pub metallic: f32,
    /// r.
    pub roughness: f32,
    /// f₀ (the largest of the bands), f₉₀ and Ē of the dielectric layer.
    pub layer: [f32; 3],
    /// What passes below the layer in a line.
    pub through: Vec3,
    /// The share that is there.
    pub coverage: f32,
    /// What lies over it.
    pub over: Option<Over>,
    /// Its grooves.
    pub grain: Option<Grain>,
    /// Its film.
    pub film: Option<Film>,
}

impl Recipe {
    /// The surface where `texel` reads the maps.
    pub fn at(&self, texel: impl Fn(TextureId) -> [f32; 4]) -> Made {
        let texel = &texel;
        let color = |r: &Reflectance| {
            let [red, green, blue, _] = r.map.map_or([1.0; 4], texel);
            r.color * Vec3::new(red, green, blue)
        };
        let unit = |r: &Reflectance| color(r).clamp(Vec3::ZERO, Vec3::ONE);
        let (m, r) = (self.metallic.at(texel), self.roughness.at(texel));
        let r = if self.is_gloss { 1.0 - r } else { r };
        let (t, coverage) = (self.through.at(texel), self.coverage.at(texel));
        let strength = self.specular.at(texel);
        let dielectric = color(&self.f0).clamp(Vec3::ZERO, Vec3::ONE) * strength;
        let base = unit(&self.base);
        let alpha = MetalRough::alpha(r);
        let layer_f0 = dielectric.max_element();
        let mean = LobeAlbedo::table().quick_mean(layer_f0, strength, alpha).min(0.98);
        let coat = self.coat.map(|[k, r]| Clearcoat { strength: k.at(texel), roughness: r.at(texel) });
        let sheen = self.sheen.as_ref().map(|(c, r)| Sheen { color: unit(c), roughness: r.at(texel) });
        let over = Over::quick(coat, sheen);
        let kept = over.map_or(1.0, |o| o.kept_mean()) * coverage;
        let mut below = base * (1.0 - m);
        if self.is_gloss {
            // The older model's own rule of energy (KHR_materials_pbrSpecularGlossiness).
            below *= 1.0 - layer_f0;
        }
        let scattered = (1.0 - t) * (1.0 - mean) * kept;
        let (q, other) = self.passes.as_ref().map_or((0.0, Vec3::ZERO), |(q, c)| (q.at(texel), unit(c)));
        let more = if self.is_diffuse { Vec3::splat(mean * coverage) } else { Vec3::ZERO };
        Made {
            diffuse: below * (scattered * (1.0 - q)) + more,
            passed: other * ((1.0 - m) * scattered * q),
            f0: dielectric * (1.0 - m) + base * m,
            metallic: m,
            roughness: r,
            layer: [layer_f0, strength, mean],
            through: below * t,
            coverage,
            over,
            grain: self.grain.map(|(grain, map)| grain_at(grain, map.map(texel))),
            film: self.film.map(|film| film.at(texel)),
        }
    }

    /// The maps that it reads.
    pub fn maps(&self) -> Vec<TextureId> {
        let mut maps = Vec::new();
        self.clone().each_map(|map| maps.extend(*map));
        maps
    }

    /// Calls `f` with each place of a map; it may be changed, but not taken away.
    pub fn each_map(&mut self, mut f: impl FnMut(&mut Option<TextureId>)) {
        let mut scalars = vec![
            &mut self.coverage,
            &mut self.metallic,
            &mut self.roughness,
            &mut self.through,
            &mut self.specular,
        ];
        scalars.extend(self.coat.iter_mut().flatten());
        let mut colors = vec![&mut self.base, &mut self.f0];
        if let Some((color, roughness)) = &mut self.sheen {
            colors.push(color);
            scalars.push(roughness);
        }
        if let Some((share, color)) = &mut self.passes {
            colors.push(color);
            scalars.push(share);
        }
        if let Some(film) = &mut self.film {
            film.each_map(&mut f);
        }
        if let Some((_, map)) = &mut self.grain {
            f(map);
        }
        f(&mut self.coat_normal);
        for scalar in scalars {
            scalar.each_map(&mut f);
        }
        colors.into_iter().for_each(|c| f(&mut c.map));
    }
}

/// Grooves whose direction, in red and green, is turned from the one that is said, and whose strength is scaled by blue.
fn grain_at(grain: Grain, texel: Option<[f32; 4]>) -> Grain {
    let Some([x, y, strength, _]) = texel else { return grain };
    let turned = math::atan2(2.0 * y - 1.0, 2.0 * x - 1.0);
    Grain { strength: grain.strength * strength, rotation: grain.rotation + turned }
}
