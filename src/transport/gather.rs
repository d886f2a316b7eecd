//! One integrator for light on surfaces: what arrives at a point, and what a ray sees, by samples of paths.
//!
//! In Heckbert's notation D is the diffuse part of a surface (also the base under a coat) and S every lobe. A path is
//! followed from surface to surface; where a surface has both parts, chance chooses one of them. At a D vertex y the
//! irradiance E(y) is wanted, of which a [`Trust`] says how much is believed of a map M:
//!
//! `Ê(y) = M + (B / q) · (N + A + C + I − M)`, B = 1 with probability q: roulette with something better than 0 for what
//! is cut. The mean of Ê is E whatever M is, as long as q > ρ² of the surface, else single paths grow without bound (Szirmay-Kalos
//! et al. 2005; Rhee & Glynn 2015).
//!
//! The classes of what arrives at a D point:
//!
//! | class | paths | found by |
//! | --- | --- | --- |
//! | N named | L x, from few lights without area | a shadow ray to each |
//! | A area | L x, from all other lights | a light sample and a direction, power heuristic |
//! | C caustic | L S⁺ x | chance: a direction that meets the light; a light sample at each S that is no mirror |
//! | I indirect | L … D S* x | a direction, then Ê at the next D point |
//!
//! Maps hold all four in one number, so all four are estimated here, C too. What no sampling finds is C of lights without
//! area over mirrors and clear glass: particles bring it to the eye ([`super::caustic::Class::Unfound`]), but for what is seen in
//! mirrors and through clear glass first, where the map tells of it. Going straight through a pane is no vertex, light is attenuated only.
//!
//! Irradiance is `∫ L · coat(ω) · max(0, n_s·ω) dω` over the directions above the surface, whatever the albedo is: it is
//! multiplied in where a surface is looked at.
//!
//! A vertex takes its random numbers from dimensions of its own, so that a new use of one changes no other.

use std::f32::consts::{FRAC_1_PI, PI};

use arrayvec::ArrayVec;
use glam::Vec3;

use super::bsdf::bands::Band;
use super::bsdf::{Bsdf, cosine_hemisphere};
use super::direct::{arriving, goes_straight, mis_weight};
use super::interaction::Interaction;
use super::light::bright::BrightSurfaces;
use super::light::named::NAMED_MAX;
use super::light::{LightSample, Lights, Receiver, VisibleSky};
use super::medium::Media;
use crate::geometry::{Accel, Hit, Ray};
use crate::illumination::Irradiance;
use crate::illumination::Unnamed;
use crate::rng::Stream;
use crate::scene::Scene;

mod aimed;
mod path;
pub mod together;

use path::{Dimension, Found, Path};

/// How much of a map is believed at the D points that paths meet.
#[derive(Clone, Copy)]
pub enum Trust<'a> {
    /// All: a path ends at the first. Little noise, and as wrong as the map is.
    Map(&'a dyn Irradiance),
    /// As the value of what roulette cuts: without bias, and the less noise the better the map.
    EndValue(&'a dyn Irradiance),
    /// Nothing: what is cut is 0.
    Nobody,
}

/// A sample of irradiance, W/m² per band.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Arriving {
    /// Straight from lights: classes N and A. It has edges.
    pub sharp: Vec3,
    /// All else, C and I, as far as the next D point, where the map is believed.
    pub soft: Vec3,
    /// What the map is off by there: what paths find beyond it, less the map. It is noise for the most part, and smooth, since it
    /// comes from all around.
    pub deep: Vec3,
}

impl Arriving {
    /// All of it.
    pub fn total(&self) -> Vec3 {
        self.sharp + self.soft + self.deep
    }
}

/// A sample of what a ray sees.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seen {
    /// Emission of the surface, or the environment. Radiance.
    pub emission: Vec3,
    /// Reflectance of its D part towards the ray, times π: albedo and coat.
    pub albedo: Vec3,
    /// What the map says of the irradiance there; 0 where there is none.
    pub map: Vec3,
    /// The sample of it.
    pub light: Arriving,
    /// Radiance by way of its S lobes.
    pub lobes: Vec3,
}

impl Seen {
    /// The radiance.
    pub fn radiance(&self) -> Vec3 {
        self.emission + self.albedo * (self.light.total() * FRAC_1_PI) + self.lobes
    }

    /// The part that the map tells: emission, and the D part under the map's light. Radiance.
    pub fn shown(&self) -> Vec3 {
        self.emission + self.albedo * (self.map * FRAC_1_PI)
    }
}

/// S surfaces in a row that every path meets before roulette begins.
const ROULETTE_AFTER: u32 = 4;
/// Most that a path goes on with, also between surfaces that lose nothing.
const SURVIVAL_MAX: f32 = 0.95;
/// No path is longer; roulette ends nearly all long before.
const VERTICES_MAX: u32 = 1000;

/// Estimates light in a scene. Costs nothing to make.
#[derive(Clone, Copy)]
pub struct Gather<'a> {
    scene: &'a Scene,
    accel: &'a Accel,
    lights: &'a Lights,
    trust: Trust<'a>,
    /// Where most of what is reflected comes from.
    bright: Option<&'a BrightSurfaces>,
    /// What of the sky is seen from where.
    sky: Option<&'a VisibleSky>,
    /// Whether light that reaches a D point over S alone is somebody else's.
    drops_caustics: bool,
    /// Whether the light of named lights that a sample begins with is somebody else's.
    drops_named: bool,
}

impl<'a> Gather<'a> {
    /// For a scene, with as much trust.
    pub fn new(scene: &'a Scene, accel: &'a Accel, lights: &'a Lights, trust: Trust<'a>) -> Self {
        Self {
            scene,
            accel,
            lights,
            trust,
            bright: None,
            sky: None,
            drops_caustics: false,
            drops_named: false,
        }
    }

    /// Looks for such surfaces, too: less noise, and the same mean.
    pub fn looking_for(self, bright: &'a BrightSurfaces) -> Self {
        Self { bright: Some(bright).filter(|bright| bright.share() > 0.0), ..self }
    }

    /// Looks for the sky where it is seen: less noise in rooms, and the same mean.
    pub fn looking_out(self) -> Self {
        Self { sky: self.lights.visible_sky(self.scene, self.accel), ..self }
    }

    /// Leaves out class C over lobes that are not wide: particles bring it ([`super::caustic`]).
    pub fn without_caustics(self) -> Self {
        Self { drops_caustics: true, ..self }
    }

    /// Leaves out class N: it has no noise, and [`Self::named`] says what it is.
    pub fn without_named(self) -> Self {
        Self { drops_named: true, ..self }
    }

    /// Class N: the irradiance straight from named lights, exactly, a shadow ray each. Finite.
    pub fn named(&self, at: &Interaction, bsdf: &Bsdf, media: Media) -> Vec3 {
        self.named_if(at, bsdf, media, |_| true).unwrap_or(Vec3::ZERO)
    }

    /// The same, or none where `is_asked` does not want it, who is told the irradiance that there is if nothing is in the way;
    /// where that is none nobody is asked.
    pub fn named_if(
        &self,
        at: &Interaction,
        bsdf: &Bsdf,
        media: Media,
        is_asked: impl FnOnce(Vec3) -> bool,
    ) -> Option<Vec3> {
        let mut open = Vec3::ZERO;
        let mut lights: ArrayVec<(f32, LightSample), NAMED_MAX> = ArrayVec::new();
        for light in self.lights.named(self.scene, at.position) {
            let (value, _) = below_coat(at, bsdf, light.wi);
            if value > 0.0 {
                open += value * light.radiance;
                lights.push((value, light));
            }
        }
        (lights.is_empty() || is_asked(open)).then(|| {
            let arriving = |light| arriving(self.scene, self.accel, at, &media, light);
            finite(lights.iter().filter_map(|(value, light)| Some(*value * arriving(light)?)).sum())
        })
    }

    /// One sample of the irradiance on the side of a surface that `at` shows, which lies inside of `media`. Finite.
    pub fn arriving(&self, at: &Interaction, media: Media, stream: Stream) -> Arriving {
        self.arriving_at(at, &Bsdf::at(self.scene, at), media, stream, 0)
    }

    /// One sample of what an eye at the ray's origin sees along it, seen through a cone that widens by `spread`
    /// per unit of length. Finite.
    pub fn seen(&self, ray: &Ray, spread: f32, stream: Stream) -> Seen {
        let Some(direction) = ray.direction.try_normalize() else { return Seen::default() };
        let scale = ray.direction.length();
        let ray = Ray { direction, t_min: ray.t_min * scale, t_max: ray.t_max * scale, ..*ray };
        let Some(hit) = self.accel.intersect_seen(self.scene, &ray) else {
            return Seen { emission: finite(self.lights.escaped(self.scene, direction)), ..Seen::default() };
        };
        let at = Interaction::at(self.scene, &ray, &hit).with_footprint(spread * hit.t);
        let bsdf = Bsdf::at(self.scene, &at);
        let absorbed = Media::EMPTY.transmittance_to(self.scene, &at, hit.t);
        let albedo = finite(bsdf.diffuse_albedo() * bsdf.coat_factor(at.wo) * absorbed);
        let mut seen =
            Seen { emission: finite(at.point().emission(self.scene) * absorbed), albedo, ..Seen::default() };
        if albedo != Vec3::ZERO {
            let named = self.named(&at, &bsdf, Media::EMPTY);
            seen.map = self.shown_at(&at, named);
            seen.light = self.without_named().arriving_at(&at, &bsdf, Media::EMPTY, stream, 0);
            seen.light.sharp += named;
        }
        if bsdf.passed_albedo() != Vec3::ZERO {
            self.add_passed(&mut seen, &at, &bsdf, absorbed, { stream }.split(2));
        }
        if bsdf.has_view_dependent() {
            // Numbers of its own: both parts are followed here.
            let stream = { stream }.split(1);
            let path = Path { width: at.footprint, spread, ..Path::at(&at, absorbed) };
            let mut sum = Vec3::ZERO;
            if let Some(path) = self.pass_lobe(&at, &bsdf, path, stream, &mut sum) {
                sum += self.follow(path, stream).total();
            }
            seen.lobes = finite(sum);
        }
        seen
    }

    /// Adds the light that falls on the other side and leaves on the one that is seen: as part of the light on one surface of
    /// both albedos together.
    #[cold]
    fn add_passed(&self, seen: &mut Seen, at: &Interaction, bsdf: &Bsdf, absorbed: Vec3, stream: Stream) {
        let passed = finite(bsdf.passed_albedo() * bsdf.coat_factor(at.wo) * absorbed);
        let behind = at.turned(self.scene);
        let other = Bsdf::at(self.scene, &behind);
        let named = self.named(&behind, &other, Media::EMPTY);
        let map = self.shown_at(&behind, named);
        let mut light = self.without_named().arriving_at(&behind, &other, Media::EMPTY, stream, 0);
        light.sharp += named;
        let all = seen.albedo + passed;
        let share =
            Vec3::from_array(std::array::from_fn(|c| if all[c] > 0.0 { passed[c] / all[c] } else { 0.0 }));
        let mixed = |a: Vec3, b: Vec3| a + (b - a) * share;
        seen.map = mixed(seen.map, map);
        seen.light.sharp = mixed(seen.light.sharp, light.sharp);
        seen.light.soft = mixed(seen.light.soft, light.soft);
        seen.light.deep = mixed(seen.light.deep, light.deep);
        seen.albedo = all;
    }

    /// One sample of the radiance that arrives at the ray's origin against its direction. Finite.
    pub fn radiance(&self, ray: &Ray, stream: Stream) -> Vec3 {
        self.seen(ray, 0.0, stream).radiance()
    }

    /// The irradiance that is believed at a point, and how much of it named lights bring, where that is known. Their shadows
    /// are sharp here as on the display: a texel that lies half in one would light what looks at its other half.
    fn believed_at(&self, at: &Interaction, bsdf: &Bsdf, media: Media) -> (Vec3, Option<Vec3>) {
        match self.trust {
            Trust::Map(map) | Trust::EndValue(map) => {
                let Unnamed { rest, named } = map.unnamed(at.triangle, at.b1, at.b2, at.back);
                let named = named.map(|_| self.named(at, bsdf, media));
                (rest + named.unwrap_or(Vec3::ZERO), named)
            }
            Trust::Nobody => (Vec3::ZERO, None),
        }
    }

    /// What neither a path finds nor a particle brings to the eye, as far as the map knows it.
    fn unfound_at(&self, at: &Interaction, path: &Path) -> Vec3 {
        match self.trust {
            Trust::Map(map) | Trust::EndValue(map) if path.is_hidden => {
                map.unfound(at.triangle, at.b1, at.b2, at.back)
            }
            _ => Vec3::ZERO,
        }
    }

    /// What the display shows of the irradiance at a point that named lights light so much.
    fn shown_at(&self, at: &Interaction, named: Vec3) -> Vec3 {
        match self.trust {
            Trust::Map(map) | Trust::EndValue(map) => shown(map, at, named),
            Trust::Nobody => Vec3::ZERO,
        }
    }

    fn arriving_at(&self, at: &Interaction, bsdf: &Bsdf, media: Media, stream: Stream, v: u32) -> Arriving {
        let mut path = Path { media, vertices: v, diffuse: 1, ..Path::at(at, Vec3::ONE) };
        let known = (self.drops_named && v == 0).then_some(Vec3::ZERO);
        let sharp = self.straight_light(at, bsdf, &path, stream, known);
        self.reflect(at, bsdf, &mut path, stream);
        let beyond = self.follow(path, stream);
        Arriving { sharp: finite(sharp + beyond.sharp), soft: finite(beyond.soft), deep: finite(beyond.deep) }
    }

    /// Follows a path to its end: what it finds straight from lights, and all else. One that begins at a D point tells apart
    /// what lies beyond the next one.
    fn follow(&self, mut path: Path, stream: Stream) -> Arriving {
        let mut sum = Arriving::default();
        let (begins_at_d, mut near) = (path.diffuse == 1, None);
        while path.vertices < VERTICES_MAX {
            let hit = self.accel.intersect(self.scene, &path.ray);
            if let Some(aimed) = path.aimed.take() {
                let weight = self.weight_of(&aimed, path.ray.direction, hit.as_ref());
                if weight == 0.0 {
                    break;
                }
                path.throughput *= weight;
            }
            let Some(hit) = &hit else {
                self.shine(self.lights.escaped(self.scene, path.ray.direction), &path, None, &mut sum);
                break;
            };
            path.width += path.spread * hit.t;
            let at = Interaction::at(self.scene, &path.ray, hit).with_footprint(path.width);
            let absorbed = path.media.transmittance_to(self.scene, &at, hit.t);
            path.weigh(absorbed);
            self.shine(at.point().emission(self.scene), &path, Some(hit), &mut sum);
            let bsdf = path.media.banded(Bsdf::at(self.scene, &at));
            let lobes = bsdf.lobe_share(at.wo);
            let chosen = path.numbers(stream, Dimension::Part).next_f32();
            if chosen < lobes {
                path.weigh(Vec3::splat(1.0 / lobes));
                match self.pass_lobe(&at, &bsdf, path, stream, &mut sum.soft) {
                    Some(on) => path = on,
                    None => break,
                }
            } else {
                let (mut at, mut bsdf) = (at, bsdf);
                let factor = bsdf.coat_factor(at.wo);
                let passes = bsdf.passed_share();
                // What is left of the number chooses the side.
                let diffuse = if passes > 0.0 && (chosen - lobes) / (1.0 - lobes) < passes {
                    let passed = bsdf.passed_albedo() * (factor / passes);
                    at = at.turned(self.scene);
                    bsdf = Bsdf::at(self.scene, &at);
                    passed
                } else if passes > 0.0 {
                    bsdf.diffuse_albedo() * (factor / (1.0 - passes))
                } else {
                    bsdf.diffuse_albedo() * factor
                };
                path.weigh(diffuse / (1.0 - lobes));
                path.throughput *= FRAC_1_PI;
                let lit = path.throughput.max_element() > 0.0;
                if !lit {
                    break;
                }
                let (believed, named) = self.believed_at(&at, &bsdf, path.media);
                if begins_at_d && near.is_none() {
                    near = Some(sum.soft + path.throughput * believed * path.index_scale);
                }
                if !self.goes_on(believed, &mut path, stream, &mut sum.soft) {
                    break;
                }
                let straight = self.straight_light(&at, &bsdf, &path, stream, named);
                sum.soft += path.throughput * (straight + self.unfound_at(&at, &path)) * path.index_scale;
                self.reflect(&at, &bsdf, &mut path, stream);
                path.straight = false;
            }
        }
        if let Some(near) = near {
            (sum.soft, sum.deep) = (near, sum.soft - near);
        }
        sum
    }

    /// Whether a path that has come to a D point asks what arrives there. What is believed of it is added where that counts,
    /// so that the mean stays.
    fn goes_on(&self, believed: Vec3, path: &mut Path, stream: Stream, sum: &mut Vec3) -> bool {
        let scale = path.index_scale;
        let counts = |throughput: Vec3| throughput * believed * scale;
        if let Trust::Map(_) = self.trust {
            *sum += counts(path.throughput);
            return false;
        }
        // What is looked at, and the first D point that light comes from, are asked for certain.
        if path.diffuse >= 2 {
            *sum += counts(path.throughput);
            // `since` is the albedo here times the weights on the way.
            let survival = path.since.max_element().min(SURVIVAL_MAX);
            if survival.is_nan() || path.numbers(stream, Dimension::Roulette).next_f32() >= survival {
                return false;
            }
            path.throughput /= survival;
            *sum -= counts(path.throughput);
        }
        path.diffuse += 1;
        true
    }

    /// Adds the light that a path meets at `hit` or in the environment, weighed beside light samples of the vertex it
    /// comes from.
    fn shine(&self, light: Vec3, path: &Path, hit: Option<&Hit>, sum: &mut Arriving) {
        if light == Vec3::ZERO || self.drops_caustics && !path.straight && path.narrow {
            return;
        }
        let share = path.found.map_or(1.0, |Found { from, pdf }| {
            let other = self.lights.pdf_unnamed(self.scene, &from, (path.ray.direction, hit), self.sky);
            mis_weight(1, pdf, 1, other)
        });
        let sum = if path.straight { &mut sum.sharp } else { &mut sum.soft };
        *sum += path.throughput * light * (path.index_scale * share);
    }

    /// Light samples at a surface, each times what `reflects` gives for its direction: a value, and the density with
    /// which that direction is found otherwise.
    fn light_samples(
        &self,
        at: &Interaction,
        path: &Path,
        stream: Stream,
        has_named: bool,
        reflects: impl Fn(Vec3) -> (Vec3, f32),
    ) -> Vec3 {
        let mut sum = Vec3::ZERO;
        for light in self.lights.named(self.scene, at.position).filter(|_| has_named) {
            let (value, _) = reflects(light.wi);
            if value.max_element() > 0.0
                && let Some(light) = arriving(self.scene, self.accel, at, &path.media, &light)
            {
                sum += value * light;
            }
        }
        let choice = path.numbers(stream, Dimension::LightChoice).next_f64();
        let point = path.numbers(stream, Dimension::Light).next_2d();
        if let Some(light) = self.lights.sample_unnamed(self.scene, &at.into(), (choice, point), self.sky) {
            let (value, pdf) = reflects(light.wi);
            if value.max_element() > 0.0
                && let Some(radiance) = arriving(self.scene, self.accel, at, &path.media, &light)
            {
                let weight = if light.delta { 1.0 } else { mis_weight(1, light.pdf, 1, pdf) };
                sum += value * radiance * (weight / light.pdf);
            }
        }
        sum
    }

    /// Irradiance straight from lights, by samples of them; what `named` ones bring where that is known.
    fn straight_light(
        &self,
        at: &Interaction,
        bsdf: &Bsdf,
        path: &Path,
        stream: Stream,
        named: Option<Vec3>,
    ) -> Vec3 {
        let by_cosine = 1.0 - self.aims(path).map_or(0.0, BrightSurfaces::share);
        let sampled = self.light_samples(at, path, stream, named.is_none(), |wi| {
            let (value, cosine) = below_coat(at, bsdf, wi);
            (Vec3::splat(value), cosine * (by_cosine * FRAC_1_PI))
        });
        sampled + named.unwrap_or(Vec3::ZERO)
    }

    /// Sends the path on from a D point, by the cosine or to a bright surface. Directions below the surface see nothing.
    fn reflect(&self, at: &Interaction, bsdf: &Bsdf, path: &mut Path, stream: Stream) {
        let u = path.numbers(stream, Dimension::Direction).next_2d();
        let normal = at.facing_shading();
        let by_cosine = || {
            let local = cosine_hemisphere(u);
            let (x, y) = normal.any_orthonormal_pair();
            (x * local.x + y * local.y + normal * local.z).normalize_or(normal)
        };
        let (wi, share) = match self.aims(path) {
            None => {
                // Cosine / density.
                path.throughput *= PI;
                (by_cosine(), 0.0)
            }
            Some(bright) => {
                let choice = path.numbers(stream, Dimension::Aim).next_f64();
                let (wi, aimed) = self.aim(bright, at, choice, u, by_cosine);
                path.aimed = Some(aimed);
                (wi, bright.share())
            }
        };
        let above = if at.facing_geometric().dot(wi) > 0.0 { bsdf.coat_factor(wi) } else { 0.0 };
        path.since = Vec3::ONE;
        path.weigh(Vec3::splat(above));
        let pdf = normal.dot(wi).max(0.0) * ((1.0 - share) * FRAC_1_PI);
        path.found = (!self.lights.is_empty()).then_some(Found { from: at.into(), pdf });
        (path.specular, path.narrow) = (0, true);
        path.vertices += 1;
        (path.width, path.spread) = (0.0, 0.0);
        path.ray = at.spawn(wi);
    }

    /// Light samples of the lobes, and the path that goes on along a direction of theirs.
    fn pass_lobe(
        &self,
        at: &Interaction,
        bsdf: &Bsdf,
        mut path: Path,
        stream: Stream,
        sum: &mut Vec3,
    ) -> Option<Path> {
        let normal = at.facing_shading();
        let band =
            bsdf.is_dispersive().then(|| Band::chosen(path.numbers(stream, Dimension::Band).next_f32()));
        let bsdf = &band.map_or(*bsdf, |band| bsdf.where_band_crosses(band, 3.0));
        path.narrow &= !bsdf.is_wide();
        if !(bsdf.is_delta() || self.drops_caustics && path.narrow) {
            let light = self.light_samples(at, &path, stream, true, |wi| {
                let (f, pdf) = bsdf.evaluate_and_pdf(at.wo, wi);
                (f * normal.dot(wi).max(0.0), pdf)
            });
            *sum += path.throughput * light * path.index_scale;
        }
        let direction = path.numbers(stream, Dimension::Direction).next_2d();
        let [choice, roulette] =
            [Dimension::Lobe, Dimension::Roulette].map(|of| path.numbers(stream, of).next_f32());
        let sample = bsdf.sample(at.wo, direction, choice)?;
        path.weigh(sample.weight);
        path.index_scale *= sample.radiance_scale;
        if sample.transmitted {
            path.media = path.media.crossed(self.scene, at).with_band(band);
        }
        // Light samples of the vertex before see through panes.
        if !goes_straight(self.scene, at, &sample) {
            let pdf = sample.pdf;
            path.found = (!sample.delta && !self.lights.is_empty()).then_some(Found { from: at.into(), pdf });
            path.is_hidden |= path.straight && path.diffuse == 0 && sample.delta;
            path.straight = false;
        }
        path.specular += 1;
        path.vertices += 1;
        if path.specular > ROULETTE_AFTER {
            let survival = path.since.max_element().min(SURVIVAL_MAX);
            // Also ends what is black or not a number.
            if survival.is_nan() || roulette >= survival {
                return None;
            }
            path.weigh(Vec3::splat(1.0 / survival));
        }
        path.ray = at.spawn(sample.wi);
        (path.throughput.max_element() > 0.0).then_some(path)
    }
}

/// The share of light from `wi` that a D part gets, cosine and coat, and the cosine alone; 0 from below the surface.
fn below_coat(at: &Interaction, bsdf: &Bsdf, wi: Vec3) -> (f32, f32) {
    let cosine = cosine_above(at, wi);
    if cosine == 0.0 { (0.0, 0.0) } else { (cosine * bsdf.coat_factor(wi), cosine) }
}

/// The cosine of `wi` at a surface; 0 from below it.
#[inline]
fn cosine_above(at: &Interaction, wi: Vec3) -> f32 {
    let cosine = at.facing_shading().dot(wi);
    if cosine <= 0.0 || at.facing_geometric().dot(wi) <= 0.0 { 0.0 } else { cosine }
}

/// The irradiance that a display shows at a point that named lights light so much: what else a map says, where it knows that
/// apart, else all that it says.
pub(crate) fn shown(map: &dyn Irradiance, at: &Interaction, named: Vec3) -> Vec3 {
    match map.unnamed(at.triangle, at.b1, at.b2, at.back) {
        Unnamed { rest, named: None } => rest,
        Unnamed { rest, named: Some(_) } => rest + named,
    }
}

fn finite(value: Vec3) -> Vec3 {
    if value.is_finite() { value } else { Vec3::ZERO }
}

#[cfg(test)]
mod aimed_tests;
#[cfg(test)]
mod path_tests;
#[cfg(test)]
mod tests;
