//! The recursive ray tracer behind the corrections: what the display cannot show of a surface.
//!
//! Radiance of a surface = [`Tracer::base`] (emission and the diffuse part under the stored irradiance: what
//! the display shows) + [`Tracer::view_dependent`] (everything else: mirrors, glass, glossy lobes, and what a
//! coat takes from or adds to the diffuse part in this direction, which may be negative). The sum is exact:
//! [`Tracer::radiance`] adds the same two terms at every surface that a ray ends on.
//!
//! Mirrors and clear glass branch; glossy lobes send distributed rays and light samples, joined by multiple
//! importance sampling. Below `Settings::min_contribution` of the pixel, Russian roulette decides, also about shadow rays,
//! and chance chooses between reflection and refraction, as it does behind a glossy lobe; the expectation does not change.
//! Random numbers come from the given stream
//! alone. Absent on purpose: diffuse bounces (the stored illumination has them) and light through refracting glass from
//! lights without area.

use std::f32::consts::FRAC_1_PI;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::Vec3;

use super::bsdf::bands::Band;
use super::bsdf::{Bsdf, BsdfSample};
use super::direct::{Found, arriving, goes_straight, mis_weight};
use super::gather::together::{LastShadows, Together};
use super::gather::{Gather, Trust};
use super::interaction::Interaction;
use super::light::Lights;
use super::medium::Media;
use super::surface::SurfacePoint;
use crate::geometry::packet::LANES;
use crate::geometry::{Accel, Hit, Ray};
use crate::illumination::Irradiance;
use crate::illumination::Unnamed;
use crate::rng::{Stream, unit_f32};
use crate::scene::Scene;

pub mod guide;
pub mod witness;

use witness::{Event, Nobody, Witness};

/// How much is traced for one sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Distributed rays of a glossy lobe on the surface that is looked at; 1 on what it reflects. A coat returns little
    /// of the light, but over a dark base it is most of what is seen.
    pub glossy_samples: u32,
    /// Light samples of a glossy lobe there, fewer where it returns less than half of the light; 1 on what it reflects.
    /// 0: none anywhere.
    pub light_samples: u32,
    /// Surfaces that one ray may meet in a row.
    pub max_depth: u32,
    /// Share of the sample's value below which a ray goes on with a probability only, carrying this share. Where a ray
    /// carries no more than that, either reflection or refraction is followed, else both: a bright light that is seen
    /// over many surfaces shows as noise of this strength, not of its own. And the share of display white below which
    /// light is worth a shadow ray with a probability only.
    pub min_contribution: f32,
    /// Most that one chain glossy → mirror or glass → light may add, in units of display white. No light sampling
    /// finds such chains, so that they come as fireflies; the bound makes them a little too dark instead.
    pub caustic_bound: f32,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            glossy_samples: 4,
            light_samples: 2,
            max_depth: 64,
            min_contribution: 1.0 / 100.0,
            caustic_bound: 0.1,
        }
    }
}

/// Traces rays against a scene and its stored illumination.
pub struct Tracer<'a, W = Nobody> {
    scene: &'a Scene,
    accel: &'a Accel,
    lights: &'a Lights,
    illumination: &'a dyn Irradiance,
    settings: Settings,
    /// Results that were not finite and became 0.
    broken: AtomicU64,
    /// Who is told of it.
    witness: W,
}

/// The state of one ray of the tree.
#[derive(Clone, Copy, Debug)]
struct Branch {
    /// Share of the sample's value that it can still add.
    contribution: f32,
    depth: u32,
    /// Where it travels.
    media: Media,
    /// The band that what crosses the surface it is at carries alone.
    entering: Option<Band>,
    /// How it was found, if lights are sampled there too.
    found: Option<Found>,
    /// Whether a glossy lobe lies on its way.
    blurred: bool,
    /// Width of its cone where it starts, scene units.
    width: f32,
    /// What a unit of length adds to that (ray cones, Akenine-Möller et al. 2019). Surfaces count as flat.
    spread: f32,
}

impl Branch {
    /// The beginning of a tree, without width: textures are read at their finest.
    const START: Self = Self {
        contribution: 1.0,
        depth: 0,
        media: Media::EMPTY,
        entering: None,
        found: None,
        blurred: false,
        width: 0.0,
        spread: 0.0,
    };
}

impl<'a> Tracer<'a> {
    /// A tracer; costs nothing to make.
    pub fn new(
        scene: &'a Scene,
        accel: &'a Accel,
        lights: &'a Lights,
        illumination: &'a dyn Irradiance,
        settings: Settings,
    ) -> Self {
        Self { scene, accel, lights, illumination, settings, broken: AtomicU64::new(0), witness: Nobody }
    }

    /// The same tracer, which tells a witness what it does.
    pub fn told_to<W: Witness>(self, witness: W) -> Tracer<'a, W> {
        let Self { scene, accel, lights, illumination, settings, broken, witness: Nobody } = self;
        Tracer { scene, accel, lights, illumination, settings, broken, witness }
    }
}

impl<W: Witness> Tracer<'_, W> {
    /// Whom it told.
    pub fn into_witness(self) -> W {
        self.witness
    }

    /// Number of results of this tracer that were not finite and became 0.
    pub fn broken_count(&self) -> u64 {
        self.broken.load(Ordering::Relaxed)
    }

    /// Emission and diffuse part: what the display shows of the surface. Radiance; finite, not negative.
    ///
    /// `at`, the same point with its directions, is only asked for where light comes from lights with names.
    #[inline]
    pub fn base(&self, point: &SurfacePoint, at: impl FnOnce() -> Interaction) -> Vec3 {
        let (diffuse, Unnamed { rest, named }) = self.diffuse_and_light(point);
        let irradiance = if named.is_some() {
            let at = at();
            rest + self.named(&at, &Bsdf::over(self.scene, &at, diffuse), Media::EMPTY)
        } else {
            rest
        };
        self.base_under(point, diffuse, irradiance)
    }

    /// [`Self::base`] of those of sixteen neighbouring points that there are: the same bits, from shadow rays that go
    /// together. `seen` tells how a point of such a number was found. `last`: what threw the last shadows.
    pub fn base_together(
        &self,
        points: &[Option<SurfacePoint>; LANES],
        seen: impl Fn(usize) -> (Ray, Hit),
        last: &mut LastShadows,
    ) -> [Vec3; LANES] {
        let mut lit = 0;
        let mut light = [(Vec3::ZERO, Vec3::ZERO); LANES];
        for (lane, point) in points.iter().enumerate() {
            let Some(point) = point else { continue };
            let (diffuse, Unnamed { rest, named }) = self.diffuse_and_light(point);
            light[lane] = (diffuse, rest);
            lit |= u32::from(named.is_some()) << lane;
        }
        let mut named = [Vec3::ZERO; LANES];
        if lit != 0 {
            let mut together = Together::new(self.scene, self.accel, self.lights);
            for (lane, point) in points.iter().enumerate().filter(|(lane, _)| lit >> lane & 1 != 0) {
                let Some(point) = point else { continue };
                let (ray, hit) = seen(lane);
                let mut at = Interaction::at(self.scene, &ray, &hit);
                at.footprint = point.footprint;
                together.ask(lane, &at, light[lane].0);
            }
            named = together.irradiance(last);
        }
        std::array::from_fn(|lane| {
            let Some(point) = &points[lane] else { return Vec3::ZERO };
            let (diffuse, rest) = light[lane];
            let irradiance = if lit >> lane & 1 != 0 { rest + named[lane] } else { rest };
            self.base_under(point, diffuse, irradiance)
        })
    }

    /// The diffuse albedo of a point, and the irradiance there but for that of lights to be asked by name; nothing of both
    /// where nothing is reflected.
    #[inline]
    fn diffuse_and_light(&self, point: &SurfacePoint) -> (Vec3, Unnamed) {
        let diffuse = point.diffuse_albedo(self.scene);
        if diffuse == Vec3::ZERO {
            return (diffuse, Unnamed { rest: Vec3::ZERO, named: None });
        }
        let &SurfacePoint { triangle, b1, b2, back, .. } = point;
        (diffuse, self.illumination.unnamed(triangle, b1, b2, back))
    }

    /// [`Self::base`] under an irradiance.
    #[inline]
    fn base_under(&self, point: &SurfacePoint, diffuse: Vec3, irradiance: Vec3) -> Vec3 {
        let shown = point.emission(self.scene) + diffuse * (irradiance * FRAC_1_PI);
        let passed = point.passed_albedo(self.scene);
        if passed == Vec3::ZERO {
            return self.finite(shown);
        }
        let behind = Interaction::turned_to(self.scene, point);
        let bsdf = Bsdf::at(self.scene, &behind);
        self.finite(shown + passed * self.light_on(&behind, &bsdf, Media::EMPTY, None))
    }

    fn named(&self, at: &Interaction, bsdf: &Bsdf, media: Media) -> Vec3 {
        Gather::new(self.scene, self.accel, self.lights, Trust::Nobody).named(at, bsdf, media)
    }

    /// Everything that [`Self::base`] leaves out, as radiance towards `at.wo`; `base` is what that gave here. Finite.
    pub fn view_dependent(&self, at: &Interaction, base: Vec3, stream: Stream) -> Vec3 {
        let bsdf = Bsdf::at(self.scene, at);
        if !bsdf.has_view_dependent() {
            return Vec3::ZERO;
        }
        let branch = Branch {
            width: at.footprint,
            spread: at.footprint / at.t.max(f32::MIN_POSITIVE),
            ..Branch::START
        };
        self.witness.open(|| Event::Sample);
        self.witness.note(|| Event::surface(at, 0), Vec3::ZERO);
        let taken = self.taken_by_coat(at, &bsdf, base);
        self.witness.note(|| Event::Coat, taken);
        let sum = self.finite(taken + self.scatter(at, &bsdf, branch, stream));
        self.witness.close();
        sum
    }

    /// What a coat adds to `base`, what [`Self::base`] shows of the surface, towards `at.wo`: less than nothing where it
    /// takes light.
    pub fn taken_by_coat(&self, at: &Interaction, bsdf: &Bsdf, base: Vec3) -> Vec3 {
        let more = bsdf.coat_factor(at.wo) - 1.0;
        if more == 0.0 { Vec3::ZERO } else { (base - at.point().emission(self.scene)) * more }
    }

    /// Radiance that arrives at the ray's origin, against its direction. Finite.
    pub fn radiance(&self, ray: &Ray, stream: Stream) -> Vec3 {
        let Some(direction) = ray.direction.try_normalize() else { return Vec3::ZERO };
        let scale = ray.direction.length();
        let ray = Ray { direction, t_min: ray.t_min * scale, t_max: ray.t_max * scale, ..*ray };
        self.witness.open(|| Event::Sample);
        let sum = self.finite(self.follow(&ray, Branch::START, stream));
        self.witness.close();
        sum
    }

    fn finite(&self, value: Vec3) -> Vec3 {
        if value.is_finite() {
            return value;
        }
        self.broken.fetch_add(1, Ordering::Relaxed);
        Vec3::ZERO
    }

    /// [`Self::light_on`] where there is something to reflect it.
    fn diffuse_light(&self, at: &Interaction, bsdf: &Bsdf, media: Media, seen: Option<(f32, f32)>) -> Vec3 {
        if bsdf.diffuse_albedo() == Vec3::ZERO {
            return Vec3::ZERO;
        }
        self.light_on(at, bsdf, media, seen)
    }

    /// Irradiance / π on the side that `at` shows: that of named lights by shadow rays, all else as stored.
    ///
    /// `seen`: the share of it that the sample's value holds, and the random number that decides whether shadow rays are
    /// worth it; else what is stored of these lights stands for them, so that the mean is as with the rays. Without it they
    /// are always traced.
    fn light_on(&self, at: &Interaction, bsdf: &Bsdf, media: Media, seen: Option<(f32, f32)>) -> Vec3 {
        let &Interaction { triangle, b1, b2, back, .. } = at;
        let irradiance = match self.illumination.unnamed(triangle, b1, b2, back) {
            Unnamed { rest, named: None } => rest,
            Unnamed { rest, named: Some(stored) } => {
                let gather = Gather::new(self.scene, self.accel, self.lights, Trust::Nobody);
                let mut survival = 1.0;
                let traced = gather.named_if(at, bsdf, media, |open| {
                    let Some((share, drawn)) = seen else { return true };
                    // Neither what the rays may add nor what they may take.
                    survival = self.survival(open.max(stored) * (share * FRAC_1_PI));
                    if survival < 1.0 {
                        self.witness.note(|| Event::Roulette { survival, drawn }, Vec3::ZERO);
                    }
                    drawn < survival
                });
                match traced {
                    None => rest + stored,
                    Some(named) if survival == 1.0 => rest + named,
                    Some(named) => rest + stored + (named - stored) / survival,
                }
            }
        };
        irradiance * FRAC_1_PI
    }

    /// Probability that light is worth a shadow ray which changes the sample's value by so much at most, so that a ray that
    /// is traced changes it by no more than [`Settings::min_contribution`] of display white instead.
    #[inline]
    fn survival(&self, most: Vec3) -> f32 {
        let survival = most.max_element() * self.scene.display.exposure / self.settings.min_contribution;
        // What is not a number is certain; so is all where nothing is displayed.
        if survival > 0.0 && survival < 1.0 { survival } else { 1.0 }
    }

    /// Surfaces along a ray whose random numbers are shared out among pixels.
    const SHARED_DEPTH: u32 = 2;
    /// The dimension of a ray's stream that decides about shadow rays.
    const SHADOWS: u32 = 0x5ade;

    /// Radiance along a ray of unit direction.
    fn follow(&self, ray: &Ray, mut branch: Branch, mut stream: Stream) -> Vec3 {
        if branch.depth > self.settings.max_depth {
            return Vec3::ZERO;
        }
        if branch.depth > Self::SHARED_DEPTH {
            stream = stream.independent();
        }
        let mut scale = 1.0;
        if branch.contribution < self.settings.min_contribution {
            let survival = branch.contribution / self.settings.min_contribution;
            let drawn = stream.next_f32();
            self.witness.note(|| Event::Roulette { survival, drawn }, Vec3::ZERO);
            // Also ends what is not a number.
            if survival.is_nan() || drawn >= survival {
                return Vec3::ZERO;
            }
            scale = 1.0 / survival;
            self.witness.scale(|| Vec3::splat(scale));
            branch.contribution = self.settings.min_contribution;
        }
        let hit = self.accel.intersect(self.scene, ray);
        let share = |light: Vec3| {
            if branch.found.is_none() && branch.blurred {
                return self.bounded(light, branch.contribution);
            }
            let Some(found) = branch.found.filter(|_| light != Vec3::ZERO) else { return light };
            light * found.weight(self.scene, self.lights, (ray.direction, hit.as_ref()))
        };
        let Some(hit) = &hit else {
            let light = share(self.lights.escaped(self.scene, ray.direction));
            self.witness.note(|| Event::Escaped { direction: ray.direction }, light);
            return light * scale;
        };
        branch.width += branch.spread * hit.t;
        let at = Interaction::at(self.scene, ray, hit).with_footprint(branch.width);
        let bsdf = branch.media.banded(Bsdf::at(self.scene, &at));
        self.witness.note(|| Event::surface(&at, branch.depth), Vec3::ZERO);
        let mut radiance = share(at.point().emission(self.scene));
        self.witness.note(|| Event::Emission, radiance);
        let drawn = || unit_f32(stream.at(Self::SHADOWS).next_u64());
        let seen = |albedo: Vec3| Some((branch.contribution * albedo.max_element(), drawn()));
        let albedo = bsdf.diffuse_albedo();
        let diffuse =
            albedo * self.diffuse_light(&at, &bsdf, branch.media, seen(albedo)) * bsdf.coat_factor(at.wo);
        self.witness.note(|| Event::Diffuse, diffuse);
        radiance += diffuse;
        if bsdf.passed_albedo() != Vec3::ZERO {
            let (behind, albedo) = (at.turned(self.scene), bsdf.passed_albedo());
            let below = Bsdf::at(self.scene, &behind);
            let light = self.light_on(&behind, &below, branch.media, seen(albedo));
            let through = albedo * light * bsdf.coat_factor(at.wo);
            self.witness.note(|| Event::Through, through);
            radiance += through;
        }
        let absorbed = branch.media.transmittance_to(self.scene, &at, hit.t);
        self.witness.scale(|| absorbed);
        if bsdf.has_view_dependent() {
            branch.contribution *= absorbed.max_element();
            radiance += self.scatter(&at, &bsdf, branch, stream);
        }
        radiance * absorbed * scale
    }

    /// Light at the end of a chain that light sampling cannot find, see [`Settings::caustic_bound`].
    fn bounded(&self, light: Vec3, contribution: f32) -> Vec3 {
        let white = 1.0 / self.scene.display.exposure.max(f32::MIN_POSITIVE);
        let added = light.max_element() * contribution;
        let bound = self.settings.caustic_bound * white;
        if added > bound { light * (bound / added) } else { light }
    }

    /// Radiance of the view-dependent lobes, without the coat's share of the diffuse part.
    fn scatter(&self, at: &Interaction, bsdf: &Bsdf, branch: Branch, mut stream: Stream) -> Vec3 {
        if bsdf.is_layered() {
            return self.scatter_layers(at, bsdf, branch, stream);
        }
        if bsdf.is_dispersive() {
            return self.scatter_bands(at, bsdf, branch, stream);
        }
        let mut sum = Vec3::ZERO;
        let lobes = bsdf.delta_lobes(at.wo);
        // One of several rays of a lobe need not branch itself.
        let follows_one = branch.blurred || branch.contribution <= self.settings.min_contribution;
        if follows_one && lobes.iter().all(Option::is_some) {
            let lobe = stream.next_f32();
            self.witness.drew(|| vec![lobe]);
            return match Bsdf::chosen_of(&lobes, lobe) {
                Some(sample) => self.follow_sample(at, &sample, branch, None, stream),
                None => Vec3::ZERO,
            };
        }
        if lobes.iter().any(Option::is_some) {
            for (i, sample) in lobes.iter().enumerate() {
                if let Some(sample) = sample {
                    sum += self.follow_sample(at, sample, branch, None, stream.split(i as u64));
                }
            }
            return sum;
        }
        self.witness.open(|| {
            let (rays, lights) = self.sample_counts(at, bsdf, branch.depth == 0);
            Event::Glossy { rays, lights }
        });
        let sum = self.glossy(at, bsdf, branch, stream);
        self.witness.close();
        sum
    }

    /// The lobes of a surface that has several, all of them or, where little is seen of them, one by chance.
    fn scatter_layers(&self, at: &Interaction, bsdf: &Bsdf, mut branch: Branch, mut stream: Stream) -> Vec3 {
        if branch.contribution <= self.settings.min_contribution {
            let chance = stream.next_f32();
            let Some((part, p, _)) = bsdf.chosen(at.wo, chance) else { return Vec3::ZERO };
            branch.contribution /= p;
            self.witness.drew(|| vec![chance]);
            self.witness.open(|| Event::Layer { number: None });
            self.witness.scale(|| Vec3::splat(1.0 / p));
            let sum = self.scatter(at, &part, branch, stream) / p;
            self.witness.close();
            return sum;
        }
        let part = |(k, part)| {
            self.witness.open(|| Event::Layer { number: Some(k as u32) });
            let sum = self.scatter(at, &part, branch, stream.split(0x1a7e_0000 + k as u64));
            self.witness.close();
            sum
        };
        bsdf.parts().enumerate().map(part).sum()
    }

    /// Glass that bends bands of light apart: each is followed, or where little is seen of them one by chance.
    fn scatter_bands(&self, at: &Interaction, bsdf: &Bsdf, branch: Branch, mut stream: Stream) -> Vec3 {
        let entering = |band| Branch { entering: Some(band), ..branch };
        if branch.contribution <= self.settings.min_contribution {
            let chance = stream.next_f32();
            let band = Band::chosen(chance);
            self.witness.drew(|| vec![chance]);
            self.witness.open(|| Event::Band { color: band.color() });
            let sum = self.scatter(at, &bsdf.where_band_crosses(band, 3.0), entering(band), stream);
            self.witness.close();
            return sum;
        }
        let mut sum = Vec3::ZERO;
        let [reflected, _] = bsdf.delta_lobes(at.wo);
        if let Some(sample) = &reflected {
            sum += self.follow_sample(at, sample, branch, None, stream.split(0));
        }
        for (k, band) in Band::ALL.into_iter().enumerate() {
            let stream = stream.split(1 + k as u64);
            self.witness.open(|| Event::Band { color: band.color() });
            if reflected.is_none() {
                // Rough glass: reflection and refraction are one sample.
                self.witness.scale(|| band.color());
                sum += self.scatter(at, &bsdf.of_band(band), entering(band), stream) * band.color();
            } else if let [_, Some(sample)] = bsdf.where_band_crosses(band, 1.0).delta_lobes(at.wo) {
                sum += self.follow_sample(at, &sample, entering(band), None, stream);
            }
            self.witness.close();
        }
        sum
    }

    /// Lobes that are not of Dirac's kind, by samples of the lobes and of the lights.
    fn glossy(&self, at: &Interaction, bsdf: &Bsdf, branch: Branch, mut stream: Stream) -> Vec3 {
        let mut sum = Vec3::ZERO;
        let (n, m) = self.sample_counts(at, bsdf, branch.depth == 0);
        for i in 0..n {
            let mut s = stream.sample_of(i, n);
            let [u, v] = s.next_2d();
            let u = if s.is_shared_out() { u } else { ((i as f32 + u) / n as f32).min(1.0 - f32::EPSILON) };
            // One lobe needs no choice.
            let u_lobe = if bsdf.is_delta() { s.next_f32() } else { 0.0 };
            let Some(sample) = bsdf.sample(at.wo, [u, v], u_lobe) else { continue };
            let found = (!sample.delta).then_some(Found { from: at.into(), pdf: sample.pdf, n, m });
            let share = 1.0 / n as f32;
            let sample = BsdfSample { weight: sample.weight * share, ..sample };
            self.witness.drew(|| vec![u, v, u_lobe]);
            sum += self.follow_sample(at, &sample, branch, found, s);
        }
        let mut lights = stream.split(u64::from(n));
        for i in 0..m {
            let mut s = lights.sample_of(i, m);
            let choice = s.next_f32();
            let choice = if s.is_shared_out() { choice } else { (i as f32 + choice) / m as f32 };
            let [u, v] = s.next_2d();
            let numbers = (f64::from(choice), [u, v]);
            let Some(light) = self.lights.sample_towards(self.scene, &at.into(), numbers, None) else {
                continue;
            };
            let (f, pdf) = bsdf.evaluate_and_pdf(at.wo, light.wi);
            let f = f * light.wi.dot(at.facing_shading()).max(0.0);
            if f.max_element() <= 0.0 {
                continue;
            }
            let weight = if light.delta { 1.0 } else { mis_weight(m, light.pdf, n, pdf) };
            let scale = weight / (light.pdf * m as f32);
            let survival = self.survival(f * light.radiance * (scale * branch.contribution));
            if survival < 1.0 {
                let drawn = unit_f32(s.next_u64());
                self.witness.note(|| Event::Roulette { survival, drawn }, Vec3::ZERO);
                if drawn >= survival {
                    continue;
                }
            }
            let arriving = arriving(self.scene, self.accel, at, &branch.media, &light);
            let event =
                || Event::Light { direction: light.wi, pdf: light.pdf, weight, blocked: arriving.is_none() };
            self.witness.drew(|| vec![choice, u, v]);
            let Some(arriving) = arriving else {
                self.witness.note(event, Vec3::ZERO);
                continue;
            };
            let found = f * arriving * (scale / survival);
            self.witness.note(event, found);
            sum += found;
        }
        sum
    }

    /// Distributed rays and light samples of a glossy lobe, on the surface that is looked at (`first`) or beyond.
    fn sample_counts(&self, at: &Interaction, bsdf: &Bsdf, first: bool) -> (u32, u32) {
        /// The share of light from which on all light samples are taken.
        const ALL: f32 = 0.5;
        let none = bsdf.is_delta() || self.lights.is_empty();
        let lights = if none { 0 } else { self.settings.light_samples };
        if !first {
            return (1, lights.min(1));
        }
        let share = bsdf.view_dependent_albedo(at.wo).max_element() / ALL;
        let some = (lights as f32 * share).ceil() as u32;
        (self.settings.glossy_samples.max(1), some.max(1).min(lights))
    }

    /// Radiance that arrives along a sampled direction, times its weight.
    fn follow_sample(
        &self,
        at: &Interaction,
        sample: &BsdfSample,
        branch: Branch,
        found: Option<Found>,
        stream: Stream,
    ) -> Vec3 {
        let contribution = branch.contribution * sample.weight.max_element();
        if contribution.is_nan() || contribution <= 0.0 {
            return Vec3::ZERO;
        }
        let blurred = branch.blurred || !sample.delta;
        let depth = branch.depth + 1;
        let mut next = Branch { contribution, depth, found, blurred, entering: None, ..branch };
        if sample.transmitted {
            next.media = branch.media.crossed(self.scene, at).with_band(branch.entering);
            // Through a pane the ray goes on as it was found, and light samples were weighed so.
            if goes_straight(self.scene, at, sample) {
                next.found = branch.found;
            }
        }
        self.witness.open(|| Event::Lobe {
            delta: sample.delta,
            transmitted: sample.transmitted,
            direction: sample.wi,
            pdf: sample.pdf,
        });
        self.witness.scale(|| sample.weight * sample.radiance_scale);
        let radiance = self.follow(&at.spawn(sample.wi), next, stream);
        self.witness.close();
        sample.weight * radiance * sample.radiance_scale
    }
}

#[cfg(test)]
mod tests;
