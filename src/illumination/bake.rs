//! The bake: particles and direct light in passes, each with an estimate of its error.
//!
//! Light that comes straight from a light source is gathered at the elements by sampling the lights
//! (next-event estimation), all other light from particles; or all of it from particles. Never both.
//! No clock in here: the caller's `keep_going` decides when the time is over. The result depends on
//! the number of particles and rounds only, not on threads or on where a bake was interrupted.

use glam::{Vec3, Vec4};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::atlas::{Atlas, ConformalCharts};
use super::bins::{BinState, Bins};
use super::clusters::ClusterTree;
use super::density::{Bandwidth, Estimate, estimate};
use super::direct::DirectBin;
use super::stored::{Illumination, Summary, Value};
use crate::image::luminance;
use crate::rng::{Stream, hash};
use crate::scene::Scene;
use crate::transport::particle::LightTransport;

/// Particles between two questions whether to go on.
const BATCH: u64 = 1 << 15;
/// Particles of the first pass; every later pass doubles the sum.
const FIRST_PASS: u64 = 1 << 17;
/// Elements that decide on the bandwidth.
const PILOTS: usize = 3000;
/// Elements that share the decision whether direct light can reach them.
const BLOCK: usize = 64;
/// Rays that decide whether an element lies inside a body.
const BURIED_RAYS: u64 = 8;

/// Where light that comes straight from light sources is taken from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum DirectLight {
    /// Lights are sampled at every element; particles count from their first reflection on.
    #[default]
    NextEvent,
    /// Particles count from their emission on.
    Particles,
}

/// What to bake, and when it is good enough.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BakeSettings {
    /// Texels of the lightmap, about; 0 stores everything per vertex.
    pub texels: u32,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Source of direct light.
    pub direct: DirectLight,
    /// Stop after this many particles.
    pub particles: Option<u64>,
    /// Stop at this relative error ([`Summary::relative_error`]), for example 0.02.
    pub error: Option<f32>,
}

impl Default for BakeSettings {
    fn default() -> Self {
        Self {
            texels: 256 * 1024,
            seed: 1,
            direct: DirectLight::NextEvent,
            particles: Some(1 << 22),
            error: Some(0.02),
        }
    }
}

/// Key of a cache file: everything that decides the values, except how far the bake went, which the
/// file's summary says.
pub fn cache_key(scene: &Scene, settings: &BakeSettings) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(b"foveal illumination");
    hasher.update(&super::cache::VERSION.to_le_bytes());
    hasher.update(&scene.content_hash);
    hasher.update(&settings.texels.to_le_bytes());
    hasher.update(&settings.seed.to_le_bytes());
    hasher.update(&[settings.direct as u8]);
    *hasher.finalize().as_bytes()
}

/// What a bake is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Emitting particles.
    Particles,
    /// Gathering direct light.
    Direct,
    /// Estimating irradiance.
    Density,
}

/// How far a bake is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// What it does now.
    pub stage: Stage,
    /// Particles emitted.
    pub particles: u64,
    /// Rounds of direct light.
    pub direct_rounds: u32,
    /// Relative error of the last estimate; `None` before the first.
    pub relative_error: Option<f32>,
}

/// Everything a bake has gathered, for saving and going on later.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BakeState {
    emitted: u64,
    bounces: u64,
    direct_rounds: u32,
    direct_rounds_wanted: u32,
    bins: Vec<BinState>,
    direct: Vec<[DirectBin; 2]>,
}

/// A bake in progress.
pub struct Baker<'a> {
    transport: &'a dyn LightTransport,
    settings: BakeSettings,
    diagonal: f32,
    atlas: Atlas,
    bins: Bins,
    direct: Vec<[DirectBin; 2]>,
    emitted: u64,
    bounces: u64,
    direct_rounds: u32,
    /// Rounds due before the next particles.
    direct_rounds_wanted: u32,
}

impl<'a> Baker<'a> {
    /// Divides the surfaces into elements. Nothing is traced yet.
    pub fn new(scene: &Scene, transport: &'a dyn LightTransport, settings: &BakeSettings) -> Self {
        let is_diffuse = |t: u32| transport.is_diffuse(t);
        let atlas = Atlas::build(&scene.mesh, settings.texels, &is_diffuse, &ConformalCharts);
        let elements = atlas.elements.len();
        Self {
            transport,
            settings: settings.clone(),
            diagonal: scene.diagonal(),
            bins: Bins::new(elements, transport.power()),
            direct: vec![[DirectBin::default(); 2]; elements],
            atlas,
            emitted: 0,
            bounces: 0,
            direct_rounds: 0,
            direct_rounds_wanted: 1,
        }
    }

    /// The elements.
    pub fn atlas(&self) -> &Atlas {
        &self.atlas
    }

    /// Particles emitted.
    pub fn emitted(&self) -> u64 {
        self.emitted
    }

    /// Rounds of direct light done.
    pub fn direct_rounds(&self) -> u32 {
        self.direct_rounds
    }

    /// What has been gathered.
    pub fn state(&self) -> BakeState {
        BakeState {
            emitted: self.emitted,
            bounces: self.bounces,
            direct_rounds: self.direct_rounds,
            direct_rounds_wanted: self.direct_rounds_wanted,
            bins: self.bins.state(),
            direct: self.direct.clone(),
        }
    }

    /// Goes on from a saved state. `false`, and nothing changed, if it is of other elements.
    pub fn restore(&mut self, state: &BakeState) -> bool {
        if state.direct.len() != self.direct.len() || !self.bins.restore(&state.bins) {
            return false;
        }
        self.direct.clone_from(&state.direct);
        (self.emitted, self.bounces) = (state.emitted, state.bounces);
        self.direct_rounds = state.direct_rounds;
        self.direct_rounds_wanted = state.direct_rounds_wanted;
        true
    }

    /// Emits the next `count` particles.
    pub fn emit(&mut self, count: u64) {
        let skip = u32::from(self.settings.direct == DirectLight::NextEvent);
        let first = self.emitted;
        let bounces: u64 = (0..count.min(u64::from(u32::MAX)) as u32)
            .into_par_iter()
            .with_min_len(128)
            .map(|index| {
                let mut deposit = |d: crate::transport::particle::Deposit| {
                    if d.bounce >= skip {
                        let element = self.atlas.element_at(d.triangle, d.b1, d.b2);
                        self.bins.add(element, d.back, d.flux);
                    }
                };
                u64::from(self.transport.trace(self.settings.seed, first + u64::from(index), &mut deposit))
            })
            .sum();
        self.emitted += count;
        self.bounces += bounces;
    }

    /// One more round of direct light at all elements that may receive some. Does nothing where particles
    /// bring it.
    pub fn gather_direct(&mut self) {
        if !self.gathers_direct() {
            return;
        }
        let first = self.direct_rounds == 0;
        // After four rounds the spread is known, and only blocks that are worse than the average go on. Not
        // single elements: those that missed the light by chance would stop and stay dark.
        let enough = if self.direct_rounds < 4 { -1.0 } else { 0.5 * self.mean_direct_variance() };
        let (atlas, transport, seed) = (&self.atlas, self.transport, self.settings.seed);
        self.direct.par_chunks_mut(BLOCK).enumerate().for_each(|(block, bins)| {
            // After a round without any light on 64 neighbours, none is expected.
            let variance = |side: usize| bins.iter().map(|b| b[side].mean().1).sum::<f32>() / BLOCK as f32;
            let goes_on = [0, 1]
                .map(|side| first || (bins.iter().any(|b| b[side].is_lit()) && variance(side) > enough));
            for (i, bin) in bins.iter_mut().enumerate() {
                let index = block * BLOCK + i;
                let e = &atlas.elements[index];
                if e.area <= 0.0 {
                    continue;
                }
                for side in [0, 1] {
                    if goes_on[side] {
                        let key = hash(seed, index as u64, side as u64);
                        bin[side].gather(key, |u| transport.direct(e.triangle, e.b1, e.b2, side == 1, u));
                    }
                }
            }
        });
        self.direct_rounds += 1;
    }

    /// Mean over all lit surface of the variance of direct light.
    fn mean_direct_variance(&self) -> f32 {
        let (mut sum, mut weight) = (0.0f64, 0.0f64);
        for (element, sides) in self.atlas.elements.iter().zip(&self.direct) {
            for side in sides.iter().filter(|s| s.is_lit()) {
                sum += f64::from(element.area) * f64::from(side.mean().1);
                weight += f64::from(element.area);
            }
        }
        if weight > 0.0 { (sum / weight) as f32 } else { 0.0 }
    }

    /// Elements inside a body, such as the floor under a box: nothing ever arrives there, and from all
    /// directions the inside of something is seen.
    fn buried(&self) -> Vec<bool> {
        (0..self.atlas.elements.len())
            .into_par_iter()
            .map(|i| {
                let element = &self.atlas.elements[i];
                let e = i as u32;
                element.area > 0.0
                    && (self.bins.arrived(e, false).count == 0.0 && !self.direct[i][0].is_lit())
                    && (0..BURIED_RAYS).all(|ray| {
                        let mut stream = Stream::new(0xb0d1, i as u64, ray);
                        let (t, b1, b2) = (element.triangle, element.b1, element.b2);
                        self.transport.sees_inside(t, b1, b2, false, &mut stream)
                    })
            })
            .collect()
    }

    /// The irradiance from all that was gathered so far.
    pub fn illumination(&self) -> Illumination {
        let buried = self.buried();
        let mut tree = ClusterTree::build_where(&self.atlas.elements, &|e| !buried[e as usize]);
        tree.update(&self.bins);
        let stored = self.bins.total_count();
        let bandwidth = self.bandwidth(&tree, stored, &buried);
        let area: f32 = self.atlas.elements.iter().map(|e| e.area).sum();
        let guess = bandwidth.radius_for(area, stored);

        let lit_back: Vec<bool> = (0..self.atlas.elements.len().div_ceil(BLOCK))
            .into_par_iter()
            .map(|block| {
                let elements = block * BLOCK..((block + 1) * BLOCK).min(self.atlas.elements.len());
                let count = |back: bool| -> f32 {
                    elements.clone().map(|e| self.bins.arrived(e as u32, back).count).sum()
                };
                // Rounding lets one particle in a million slip out through an edge where walls meet.
                elements.clone().any(|e| self.direct[e][1].is_lit()) || count(true) > 1e-3 * count(false)
            })
            .collect();
        let values: Vec<[Option<Parts>; 2]> = (0..self.atlas.elements.len())
            .into_par_iter()
            .map(|i| {
                let element = &self.atlas.elements[i];
                if element.area <= 0.0 {
                    return [None; 2];
                }
                [false, true].map(|back| {
                    if (!back && buried[i]) || (back && !lit_back[i / BLOCK]) {
                        return None;
                    }
                    let particles = if stored == 0 {
                        Estimate::default()
                    } else {
                        bandwidth.estimate(&tree, element, back, guess, self.emitted)
                    };
                    let (direct, direct_variance) = self.direct[i][usize::from(back)].mean();
                    Some(Parts { direct, direct_variance, particles })
                })
            })
            .collect();
        let summary = self.summary(&values, &bandwidth, stored);
        let side = |s: usize| values.iter().map(|v| v[s].map(|p| p.value())).collect::<Vec<Value>>();
        Illumination::new(&self.atlas, side(0), side(1), summary)
    }

    /// The bandwidth of least error: at some elements the estimate is compared with one from twice as many
    /// particles. Bias grows with the count k, variance falls with 1/k, so their sum is least where the
    /// squared bias is half of the variance (REFERENCE §6.2).
    fn bandwidth(&self, tree: &ClusterTree, stored: u64, buried: &[bool]) -> ChosenBandwidth {
        let base = Bandwidth::new(stored, self.diagonal);
        let elements = &self.atlas.elements;
        let surface: Vec<usize> =
            (0..elements.len()).filter(|&i| elements[i].area > 0.0 && !buried[i]).collect();
        if surface.is_empty() || stored == 0 {
            return ChosenBandwidth { bandwidth: base, bias_squared: 0.0 };
        }
        let area: f32 = elements.iter().map(|e| e.area).sum();
        let step = surface.len().div_ceil(PILOTS);
        let wide = Bandwidth { count: 2.0 * base.count, ..base };
        let pilots: Vec<(f64, f64)> = surface
            .par_iter()
            .step_by(step)
            .map(|&i| {
                let at = |b: &Bandwidth| {
                    let radius = b.radius(tree, &elements[i], false, b.radius_for(area, stored));
                    let e = estimate(tree, &elements[i], false, radius, self.emitted);
                    (f64::from(luminance(e.irradiance)), f64::from(e.variance), radius)
                };
                let ((narrow, v1, r1), (wide, v2, r2)) = (at(&base), at(&wide));
                let area = f64::from(elements[i].area);
                // Where the radius is at a limit nothing can be learned.
                if r2 < 1.2 * r1 {
                    return (0.0, area * v1);
                }
                (area * ((wide - narrow).powi(2) - (v1 - v2).abs()), area * v1)
            })
            .collect();
        let bias: f64 = pilots.iter().map(|p| p.0).sum();
        let variance: f64 = pilots.iter().map(|p| p.1).sum();
        // Smooth scenes show none; then the radius is limited by their size.
        let bias = bias.max(0.004 * variance);
        let factor = if variance > 0.0 { (0.5 * variance / bias).cbrt().clamp(0.2, 8.0) } else { 1.0 };
        let weight: f64 = surface.iter().step_by(step).map(|&i| f64::from(elements[i].area)).sum();
        ChosenBandwidth {
            bandwidth: Bandwidth { count: base.count * factor as f32, ..base },
            bias_squared: bias / weight * factor * factor,
        }
    }

    fn summary(&self, values: &[[Option<Parts>; 2]], chosen: &ChosenBandwidth, stored: u64) -> Summary {
        let (mut weight, mut energy, mut surface) = (0.0f64, 0.0f64, 0.0f64);
        let (mut direct, mut particles) = (0.0f64, 0.0f64);
        let mut mean = [0.0f64; 3];
        for (element, sides) in self.atlas.elements.iter().zip(values) {
            let area = f64::from(element.area);
            surface += area;
            for parts in sides.iter().flatten() {
                let total = parts.direct + parts.particles.irradiance;
                weight += area;
                energy += area * f64::from(luminance(total)).powi(2);
                direct += area * f64::from(parts.direct_variance);
                particles += area * f64::from(parts.particles.variance);
                for (sum, band) in mean.iter_mut().zip(total.to_array()) {
                    *sum += area * f64::from(band);
                }
            }
        }
        let relative = |squared: f64| if energy > 0.0 { (squared / energy).sqrt() as f32 } else { 0.0 };
        let bias = chosen.bias_squared * weight;
        Summary {
            particles: self.emitted,
            stored,
            bounces: self.bounces,
            direct_rounds: self.direct_rounds,
            relative_error: relative(direct + particles + bias),
            direct_error: relative(direct),
            particle_error: relative(particles),
            bias_error: relative(bias),
            mean: mean.map(|m| (m / surface.max(1e-300)) as f32),
            has_indirect: stored > 0,
            notes: self.atlas.notes.clone(),
        }
    }
}

/// What the irradiance at one side of an element is made of.
#[derive(Clone, Copy, Debug)]
struct Parts {
    direct: Vec3,
    direct_variance: f32,
    particles: Estimate,
}

impl Parts {
    fn value(&self) -> Vec4 {
        let error = (self.direct_variance + self.particles.variance).sqrt();
        (self.direct + self.particles.irradiance).extend(error)
    }
}

struct ChosenBandwidth {
    bandwidth: Bandwidth,
    /// Mean squared bias of the luminance.
    bias_squared: f64,
}

impl std::ops::Deref for ChosenBandwidth {
    type Target = Bandwidth;

    fn deref(&self) -> &Bandwidth {
        &self.bandwidth
    }
}

/// What [`Baker::run`] came to.
#[derive(Clone, Debug)]
pub struct Baked {
    /// The irradiance.
    pub illumination: Illumination,
    /// Whether the error or the number of particles asked for was reached; else `keep_going` ended it.
    pub complete: bool,
}

impl Baker<'_> {
    /// Goes on until the settings are met or `keep_going` says no. `on_pass` sees the estimate after each pass.
    pub fn run(
        &mut self,
        keep_going: &(dyn Fn(&Progress) -> bool + Sync),
        on_pass: &mut dyn FnMut(&Illumination),
    ) -> Baked {
        let mut relative_error = None;
        loop {
            while self.gathers_direct() && self.direct_rounds < self.direct_rounds_wanted {
                // The first round is short, and without it there is nothing to show.
                if self.direct_rounds > 0 && !keep_going(&self.progress(Stage::Direct, relative_error)) {
                    return Baked { illumination: self.illumination(), complete: false };
                }
                self.gather_direct();
            }
            let end = self.next_pass_end();
            while self.emitted < end {
                let progress = self.progress(Stage::Particles, relative_error);
                if !keep_going(&progress) {
                    return Baked { illumination: self.illumination(), complete: false };
                }
                self.emit(BATCH.min(end - self.emitted));
            }
            let map = self.illumination();
            relative_error = Some(map.summary.relative_error);
            on_pass(&map);
            let met = |limit: Option<f32>| limit.is_some_and(|limit| map.summary.relative_error <= limit);
            let emitted_all = self.settings.particles.is_some_and(|n| self.emitted >= n);
            if emitted_all || met(self.settings.error) || self.transport.power() <= 0.0 {
                return Baked { illumination: map, complete: true };
            }
            // Direct light is cheap while it is the smaller error; then its samples double as well.
            let others = map.summary.particle_error.hypot(map.summary.bias_error);
            if map.summary.direct_error > 0.6 * others {
                self.direct_rounds_wanted = 2 * self.direct_rounds;
            }
            if !keep_going(&self.progress(Stage::Density, relative_error)) {
                return Baked { illumination: map, complete: false };
            }
        }
    }

    fn gathers_direct(&self) -> bool {
        self.settings.direct == DirectLight::NextEvent
    }

    /// Passes end at the same numbers of particles wherever a bake was interrupted.
    fn next_pass_end(&self) -> u64 {
        let mut end = FIRST_PASS;
        while end <= self.emitted {
            end *= 2;
        }
        self.settings.particles.map_or(end, |n| end.min(n.max(1)))
    }

    fn progress(&self, stage: Stage, relative_error: Option<f32>) -> Progress {
        Progress { stage, particles: self.emitted, direct_rounds: self.direct_rounds, relative_error }
    }
}

/// Bakes `scene` until the settings are met or `keep_going` says no.
pub fn bake(
    scene: &Scene,
    transport: &dyn LightTransport,
    settings: &BakeSettings,
    keep_going: &(dyn Fn(&Progress) -> bool + Sync),
) -> Baked {
    Baker::new(scene, transport, settings).run(keep_going, &mut |_| {})
}

/// The first picture: direct light at coarse elements, plus the same ambient irradiance everywhere so that
/// shadows are not black. The ambient is a guess: the mean direct irradiance of lit surfaces times
/// ρ/(1 − ρ) for a mean reflectance ρ of 0.35, which is what a closed room of that reflectance has.
pub fn quick_direct(scene: &Scene, transport: &dyn LightTransport, seed: u64) -> Illumination {
    const REFLECTANCE: f32 = 0.35;
    let settings =
        BakeSettings { texels: 16 * 1024, seed, direct: DirectLight::NextEvent, ..BakeSettings::default() };
    let mut baker = Baker::new(scene, transport, &settings);
    baker.gather_direct();
    let (mut lit, mut sum) = (0.0f32, Vec3::ZERO);
    for (element, sides) in baker.atlas.elements.iter().zip(&baker.direct) {
        for side in sides.iter().filter(|s| s.is_lit()) {
            lit += element.area;
            sum += element.area * side.mean().0;
        }
    }
    let ambient = if lit > 0.0 { sum / lit * (REFLECTANCE / (1.0 - REFLECTANCE)) } else { Vec3::ZERO };
    let side = |s: usize| {
        let value = |(element, sides): (&super::atlas::Element, &[DirectBin; 2])| {
            let (direct, variance) = sides[s].mean();
            // A side that no light reaches may be inside a body; its ambient costs nothing.
            (element.area > 0.0).then(|| (direct + ambient).extend(variance.sqrt()))
        };
        baker.atlas.elements.iter().zip(&baker.direct).map(value).collect::<Vec<Value>>()
    };
    let summary = Summary {
        direct_rounds: baker.direct_rounds,
        relative_error: 1.0,
        mean: (ambient + sum / lit.max(1e-30)).to_array(),
        notes: vec!["direct light and a guessed ambient only".into()],
        ..Summary::default()
    };
    Illumination::new(&baker.atlas, side(0), side(1), summary)
}
