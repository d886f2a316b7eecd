//! Caustics: light that reaches a surface over mirrors, glass and gloss, by particles (Heckbert 1990: L S⁺ D).
//!
//! S is every lobe but wide ones ([`Bsdf::is_wide`]); going straight through a pane is no vertex. Particles begin at
//! lamps by what they emit (`aim`), and where distant light falls on S ([`super::lit`]). One that meets nothing but diffuse
//! surfaces counts for nothing: its light is found in other ways. Over S it goes on, attenuated by the media on its way,
//! weighed as particles are where shading normals differ from geometric ones (Veach 1997, eq 5.19), with roulette by weight.
//!
//! The first numbers of [`RUN`] particles share sequences: where two sums are to be independent, whole runs belong to either.

mod aim;

use glam::Vec3;

use super::bidirectional::{End, geometric_cosine, scattering};
use super::bsdf::Bsdf;
use super::bsdf::bands::Band;
use super::direct::{goes_straight, visibility};
use super::interaction::Interaction;
use super::light::{Lights, Receiver, VisibleSky};
use super::lit::{LitSurfaces, Start};
use super::medium::Media;
use crate::geometry::{Accel, Hit, Ray};
use crate::image::luminance;
use crate::rng::{Stream, hash};
use crate::scene::{Light, Material, Model, Scene};
use aim::Aim;

/// Particles that share sequences.
pub const RUN: u64 = 1 << 14;
/// Pieces of S surfaces on which distant light is looked for.
const PIECES: usize = 1 << 14;
/// Largest share of particles that survive a surface.
const SURVIVAL_MAX: f32 = 0.99;
/// A particle never meets more surfaces than this; roulette ends it long before.
const SURFACES_MAX: u32 = 1000;

/// Which light is wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Class {
    /// L S⁺ D of all lights, D being a surface with a diffuse part. Particles end where none of the S lobes sends them on.
    All,
    /// What no path from an eye finds ([`super::gather`]): from lights without area, over a lobe of single directions
    /// first. After that particles go on over all lobes, diffuse ones too, to whatever scatters in more than single
    /// directions.
    Unfound,
}

impl Class {
    /// Whether light may begin its way at such a surface.
    fn begins_at(self, material: &Material) -> bool {
        let roughness = || material.model.roughness_range().map(|[least, ..]| least);
        match (&material.model, self) {
            _ if material.is_diffuse() => false,
            (Model::Mirror { .. } | Model::Dielectric { .. }, _) => true,
            (_, Self::All) => roughness().is_some_and(|r| r.alpha_x.max(r.alpha_y) <= Bsdf::WIDE),
            (_, Self::Unfound) => roughness().is_some_and(|r| r.is_smooth()),
        }
    }
}

/// Where particles begin.
#[derive(Clone, Debug)]
pub struct Sources {
    class: Class,
    lit: LitSurfaces,
    /// Of lamps without area, where only these are wanted.
    aim: Aim,
    possible: bool,
}

impl Sources {
    /// Looks for them.
    pub fn new(scene: &Scene, accel: &Accel, lights: &Lights, class: Class) -> Self {
        let begins: Vec<bool> = scene.materials.iter().map(|m| class.begins_at(m)).collect();
        let of = |t: u32| begins[scene.mesh.materials[t as usize].0 as usize];
        let count = scene.mesh.triangles.len() as u32;
        let (near, distant) = match class {
            Class::All => (lights.near_power(), lights.has_distant()),
            Class::Unfound => (lights.near_dirac_power(), lights.has_distant_dirac()),
        };
        let none = || LitSurfaces::new([].into_iter(), 0, 0, near, &|_| 1.0, &|_, _| 0.0);
        if !(0..count).any(of) {
            return Self { class, lit: none(), aim: Aim::default(), possible: false };
        }
        let areas = (0..count).map(|t| {
            let [a, b, c] = scene.mesh.corners(t);
            if of(t) { 0.5 * (b - a).cross(c - a).length() } else { 0.0 }
        });
        let pieces = if distant { PIECES } else { 0 };
        let sky = if distant { seen_sky(scene, accel, lights, class) } else { None };
        let lit = LitSurfaces::new(areas, pieces, 1, near, &|_| 1.0, &|start, stream| {
            distant_light(scene, accel, (lights, sky), class, start, stream)
                .map_or(0.0, |light| luminance(light.irradiance))
        });
        let meets = |lamp: usize, u: [f32; 2]| {
            let Some((ray, _)) = lights.emit_near_dirac(scene, lamp, u) else { return 0.0 };
            match accel.intersect(scene, &ray) {
                Some(hit) if of(hit.triangle) => 1.0,
                _ => 0.0,
            }
        };
        let lamps = if class == Class::Unfound { lights.near_dirac_count() } else { 0 };
        let possible = lit.begins() > 0.0;
        Self { class, lit, aim: Aim::new(lamps, &meets), possible }
    }

    /// Whether there are caustics at all: surfaces that make them, and light.
    pub fn is_possible(&self) -> bool {
        self.possible
    }
}

/// What of the sky is seen from where, if it is wanted.
fn seen_sky<'a>(scene: &Scene, accel: &Accel, lights: &'a Lights, class: Class) -> Option<&'a VisibleSky> {
    if class == Class::All { lights.visible_sky(scene, accel) } else { None }
}

/// A place under a sample of distant light.
struct Distant {
    /// As that light sees it.
    at: Interaction,
    /// On its geometric normal.
    irradiance: Vec3,
    /// Whether it comes from a single direction.
    is_dirac: bool,
}

/// Looks there; `None` where something hides it, or the light is not wanted.
fn distant_light(
    scene: &Scene,
    accel: &Accel,
    (lights, sky): (&Lights, Option<&VisibleSky>),
    class: Class,
    start: &Start,
    stream: &mut Stream,
) -> Option<Distant> {
    let (choice, u) = (stream.next_f32(), stream.next_2d());
    let hit = Hit { t: 1.0, triangle: start.triangle, b1: start.b1, b2: start.b2 };
    let [a, b, c] = scene.mesh.corners(hit.triangle);
    let normal = (b - a).cross(c - a).normalize_or_zero();
    let out = if start.back { -normal } else { normal };
    let point = a * (1.0 - hit.b1 - hit.b2) + b * hit.b1 + c * hit.b2;
    let light = lights.sample_distant(scene, &Receiver { point, normal: out }, (choice, u), sky)?;
    if class == Class::Unfound && !light.delta || !scene.is_opaque_at(hit.triangle, hit.b1, hit.b2) {
        return None;
    }
    let at = Interaction::at(scene, &Ray::new(point + light.wi, -light.wi), &hit);
    let irradiance = light.radiance * (out.dot(light.wi).max(0.0) / light.pdf);
    let shines = |e: Vec3| e.is_finite() && e.max_element() > 0.0;
    if !shines(irradiance) {
        return None;
    }
    let irradiance = irradiance * visibility(scene, accel, &at.spawn(light.wi));
    shines(irradiance).then_some(Distant { at, irradiance, is_dirac: light.delta })
}

/// A particle that arrives.
#[derive(Clone, Copy, Debug)]
pub struct Deposit<'a> {
    /// Where, seen from where it came: triangle, barycentrics, side, direction back.
    pub at: &'a Interaction,
    /// What is there.
    pub bsdf: &'a Bsdf,
    /// The media that it came through last.
    pub media: Media,
    /// Incoming flux before reflection, as if it were the only particle, W per band: through the geometric surface, without
    /// the coat.
    pub flux: Vec3,
    /// Whether no path from a surface finds it ([`Class::Unfound`]).
    pub is_unfound: bool,
}

impl Deposit<'_> {
    /// Its part of the irradiance on the shading normal `normal` (on the front) under a coat, times area.
    pub fn on(&self, normal: Vec3) -> Vec3 {
        let facing = if self.at.back { -normal } else { normal };
        let ratio = facing.dot(self.at.wo).max(0.0) / geometric_cosine(self.at, self.at.wo);
        let flux = self.flux * (ratio * self.bsdf.coat_factor(self.at.wo));
        if flux.is_finite() { flux } else { Vec3::ZERO }
    }
}

/// A particle under way.
struct Flight {
    ray: Ray,
    flux: Vec3,
    media: Media,
    /// Surfaces met, but for panes that it passed.
    vertices: u32,
    /// Whether its light has no area, and, once it has met a surface, whether a lobe of single directions came first.
    is_dirac: bool,
    is_unfound: bool,
}

/// What became of a particle at a surface from which it goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Onwards {
    /// Straight through a pane.
    Passed,
    Scattered,
}

/// Traces the particles of a scene. Costs nothing to make.
#[derive(Clone, Copy, Debug)]
pub struct Caustics<'a> {
    scene: &'a Scene,
    accel: &'a Accel,
    lights: &'a Lights,
    sky: Option<&'a VisibleSky>,
    sources: &'a Sources,
}

impl<'a> Caustics<'a> {
    /// Of a scene with what was found there.
    pub fn new(scene: &'a Scene, accel: &'a Accel, lights: &'a Lights, sources: &'a Sources) -> Self {
        let sky = if sources.possible { seen_sky(scene, accel, lights, sources.class) } else { None };
        Self { scene, accel, lights, sky, sources }
    }

    /// [`Sources::is_possible`].
    pub fn is_possible(&self) -> bool {
        self.sources.possible
    }

    /// Follows particle `index`; each arrival goes to `deposit`. The mean flux of many is that of all wanted light.
    pub fn trace(&self, seed: u64, index: u64, deposit: &mut dyn FnMut(&Deposit<'_>)) {
        const CAUSTIC: u64 = 0xca5;
        let run = hash(seed, CAUSTIC, index / RUN);
        let mut stream = Stream::in_sequence(run, u64::MAX, (index % RUN) as u32);
        if let Some(flight) = self.begin(&mut stream) {
            self.follow(flight, &mut stream, deposit);
        }
    }

    fn begin(&self, stream: &mut Stream) -> Option<Flight> {
        let Sources { class, lit, aim: _, possible: true } = self.sources else { return None };
        let (near, choice) = (lit.near_share(), stream.next_f64());
        let begun = |ray, flux, share: f64, is_dirac| Flight {
            ray,
            flux: flux / share as f32,
            media: Media::EMPTY,
            vertices: 0,
            is_dirac,
            is_unfound: false,
        };
        if choice < near {
            let (ray, flux, is_dirac) = match class {
                Class::All => self.lights.sample_near_emission(self.scene, stream)?,
                Class::Unfound => self.emit(stream).map(|(ray, flux)| (ray, flux, true))?,
            };
            return Some(begun(ray, flux, near, is_dirac));
        }
        let start = lit.start((choice - near) / (1.0 - near), stream.next_2d())?;
        let Distant { at, irradiance, is_dirac } =
            distant_light(self.scene, self.accel, (self.lights, self.sky), *class, &start, stream)?;
        let mut flight = begun(at.spawn(at.wo), irradiance, start.density * (1.0 - near), is_dirac);
        let bsdf = Bsdf::at(self.scene, &at);
        // What only passes a pane falls on the surfaces behind it, and begins there.
        (self.scatter(&at, &bsdf, &mut flight, stream)? == Onwards::Scattered).then_some(flight)
    }

    /// A particle of a lamp without area.
    fn emit(&self, stream: &mut Stream) -> Option<(Ray, Vec3)> {
        let (lamp, probability) = self.lights.choose_near_dirac(stream.next_f64())?;
        let (u, density) = self.sources.aim.sample(lamp, stream.next_2d());
        let (ray, flux) = self.lights.emit_near_dirac(self.scene, lamp, u)?;
        let flux = flux / (probability * density) as f32;
        (flux.is_finite() && flux.max_element() > 0.0).then_some((ray, flux))
    }

    fn follow(&self, mut flight: Flight, stream: &mut Stream, deposit: &mut dyn FnMut(&Deposit<'_>)) {
        // What of the light ends before it has come so far, as long as it goes straight on.
        let (lamp, mut left) = (self.lights.ending_lamp(flight.ray.origin), 1.0);
        for _ in 0..SURFACES_MAX {
            let Some(hit) = self.accel.intersect(self.scene, &flight.ray) else { return };
            let at = Interaction::at(self.scene, &flight.ray, &hit);
            let length = hit.t * flight.ray.direction.length();
            flight.flux *= flight.media.transmittance_to(self.scene, &at, length);
            if let Some((position, range)) = lamp.filter(|_| flight.vertices == 0) {
                let now = Light::window(range, position.distance(at.position));
                if now <= 0.0 {
                    return;
                }
                flight.flux *= now / left;
                left = now;
            }
            let bsdf = flight.media.banded(Bsdf::at(self.scene, &at));
            let arrives = match self.sources.class {
                // Whatever its colour there: a black texel is lit as its neighbours are.
                Class::All => at.material(self.scene).has_diffuse(),
                Class::Unfound => bsdf.is_connectible(),
            };
            if arrives && flight.vertices > 0 {
                let Flight { media, flux, is_unfound, .. } = flight;
                deposit(&Deposit { at: &at, bsdf: &bsdf, media, flux, is_unfound });
            }
            if self.scatter(&at, &bsdf, &mut flight, stream).is_none() {
                return;
            }
        }
    }

    /// Sends a particle on from a surface; `None` where it ends.
    fn scatter(
        &self,
        at: &Interaction,
        bsdf: &Bsdf,
        flight: &mut Flight,
        stream: &mut Stream,
    ) -> Option<Onwards> {
        let (u, u_lobe, roulette) = (stream.next_2d(), stream.next_f32(), stream.next_f32());
        let class = self.sources.class;
        let band = bsdf.is_dispersive().then(|| Band::chosen(stream.next_f32()));
        let bsdf = &band.map_or(*bsdf, |band| bsdf.where_band_crosses(band, 3.0));
        let over_all_lobes = class == Class::Unfound && flight.vertices > 0;
        let sample =
            if over_all_lobes { bsdf.sample_all(at.wo, u, u_lobe) } else { bsdf.sample(at.wo, u, u_lobe) }?;
        let passed = goes_straight(self.scene, at, &sample);
        let wanted = match class {
            Class::All => sample.delta || !bsdf.is_wide(),
            Class::Unfound => sample.delta || over_all_lobes,
        };
        let (arriving, leaving) = (geometric_cosine(at, at.wo), geometric_cosine(at, sample.wi));
        let shading = |w: Vec3| at.shading_normal.dot(w).abs();
        let weight = if passed {
            sample.weight
        } else if !wanted {
            return None;
        } else if over_all_lobes && !sample.delta {
            scattering(self.scene, at, bsdf, End::Light, sample.wi)?.f * (leaving / sample.pdf)
        } else {
            // Where the normal is bent by who looks, a path that comes the other way is not this one.
            if sample.delta && !at.is_reversible(bsdf, &sample) {
                return None;
            }
            sample.weight * (shading(at.wo) / arriving * leaving / shading(sample.wi))
        };
        let survival = weight.max_element().min(SURVIVAL_MAX);
        // Also ends what is not a number.
        if !(roulette < survival) {
            return None;
        }
        if sample.transmitted {
            flight.media = flight.media.crossed(self.scene, at).with_band(band);
        }
        if !passed && flight.vertices == 0 {
            flight.is_unfound = flight.is_dirac && sample.delta;
        }
        flight.vertices += u32::from(!passed);
        flight.flux *= weight / survival;
        flight.ray = at.spawn(sample.wi);
        let onwards = if passed { Onwards::Passed } else { Onwards::Scattered };
        flight.flux.is_finite().then_some(onwards)
    }
}

#[cfg(test)]
mod tests;
