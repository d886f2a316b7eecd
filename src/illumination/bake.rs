//! The bake: particles and direct light in passes, each with an estimate of its error.
//!
//! Light that comes straight from a light source is gathered at the elements by sampling the lights
//! (next-event estimation), all other light from particles.
//! No clock in here: the caller's `keep_going` decides when the time is over. The result depends on
//! the number of particles and rounds only, not on threads or on where a bake was interrupted.

use serde::{Deserialize, Serialize};

use super::atlas::{Atlas, ConformalCharts};
use super::bins::{BinState, Bins};
use super::clusters::ClusterTree;
use super::direct::DirectBin;
use super::estimate::{Estimating, Prepared};
pub use super::quick::quick_direct;
use super::seen::seen;
use super::sources::{Importance, ImportanceState, Sources};
use super::stored::{Illumination, Summary};
use crate::math;
use crate::scene::Scene;
use crate::transport::lit::LitSurfaces;
use crate::transport::particle::LightTransport;

/// Particles between two questions whether to go on.
const BATCH: u64 = 1 << 15;
/// Particles of the first pass; every later pass doubles the sum.
const FIRST_PASS: u64 = 1 << 17;
/// Blocks of elements at which direct light is gathered between two questions whether to go on.
pub(super) const BLOCKS: usize = 256;
/// Pieces that surfaces are cut into to find where light from afar falls, at least and at most.
const LIT_PIECES: (usize, usize) = (1 << 13, 1 << 16);
/// What surfaces out of sight count as places for particles to begin at.
const UNSEEN: f64 = 0.3;
/// Rounds that are waited for at most.
const ROUNDS_MAX: u32 = 256;
/// Elements that share the decision whether direct light can reach them.
pub(super) const BLOCK: usize = 64;

/// What to bake, and when it is good enough.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BakeSettings {
    /// Texels of the lightmap, about; 0 stores everything per vertex.
    pub texels: u32,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Stop after this many particles.
    pub particles: Option<u64>,
    /// Fine elements also where no camera and no path leads.
    pub everything: bool,
    /// Stop at this relative error ([`Summary::relative_error`]), for example 0.02.
    pub error: Option<f32>,
}

impl Default for BakeSettings {
    fn default() -> Self {
        Self { texels: 256 * 1024, seed: 1, particles: Some(1 << 22), everything: false, error: Some(0.02) }
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
    hasher.update(&[u8::from(settings.everything)]);
    *hasher.finalize().as_bytes()
}

/// What a bake is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Emitting particles.
    Particles,
    /// Gathering direct light.
    Direct,
    /// Estimating the error.
    Density,
    /// Estimating irradiance everywhere; the last stage.
    Estimate,
}

/// How far a bake is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// What it does now.
    pub stage: Stage,
    /// Particles emitted.
    pub particles: u64,
    /// Surfaces they met.
    pub bounces: u64,
    /// Rounds of direct light.
    pub direct_rounds: u32,
    /// Share done of the one that has begun.
    pub direct_share: f32,
    /// Relative error of the last estimate; `None` before the first.
    pub relative_error: Option<f32>,
}

/// Everything a bake has gathered, for saving and going on later.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BakeState {
    emitted: u64,
    bounces: u64,
    direct_rounds: u32,
    direct_rounds_wanted: u32,
    direct_block: u64,
    direct_goes_on: Vec<[bool; 2]>,
    pass_end: u64,
    bins: Vec<BinState>,
    pub(super) direct: Vec<[DirectBin; 2]>,
    importance: ImportanceState,
}

/// A bake in progress.
pub struct Baker<'a> {
    pub(super) transport: Box<dyn LightTransport + Send + 'a>,
    pub(super) settings: BakeSettings,
    pub(super) diagonal: f32,
    pub(super) atlas: Atlas,
    pub(super) bins: Bins,
    pub(super) direct: Vec<[DirectBin; 2]>,
    /// Whether estimates are for a first picture only.
    pub(super) coarse: bool,
    /// What the last estimate was made from.
    pub(super) prepared: Option<Prepared>,
    /// An estimate in the making.
    pub(super) estimating: Option<Estimating>,
    /// Whether the rest of an estimate must be coarse.
    pub(super) late: Option<Box<dyn Fn() -> bool + Send + Sync + 'a>>,
    /// Elements that the first round of direct light came to, if there was no time for more: the others have the light
    /// of some of them ([`Self::cut_short`]).
    pub(super) cut: Option<usize>,
    /// A tree over all elements, if one was made and nobody took it.
    pub(super) spare_tree: Option<ClusterTree>,
    /// Where particles begin that do not begin with a diffuse reflection of light from afar.
    pub(super) lit: LitSurfaces,
    /// Where the others begin; `None` until it is known what falls there.
    pub(super) sources: Option<Sources>,
    pub(super) importance: Importance,
    /// Elements that a walk can see, whose error counts.
    pub(super) watched: Vec<bool>,
    /// Sides of elements known not to lie inside of a body or in a gap.
    pub(super) open: Vec<[bool; 2]>,
    pub(super) emitted: u64,
    pub(super) bounces: u64,
    pub(super) direct_rounds: u32,
    /// Blocks done of the round that has begun.
    pub(super) direct_block: usize,
    /// Per block and side whether it takes part in it.
    pub(super) direct_goes_on: Vec<[bool; 2]>,
    /// Rounds due before the next particles.
    direct_rounds_wanted: u32,
    /// Particles at which the error is asked for next.
    pass_end: u64,
    /// What it was the last time.
    relative_error: Option<f32>,
}

impl<'a> Baker<'a> {
    /// Divides the surfaces into elements. Nothing is traced yet.
    pub fn new(scene: &Scene, transport: impl LightTransport + Send + 'a, settings: &BakeSettings) -> Self {
        let seen = if settings.everything {
            vec![true; scene.mesh.triangles.len()]
        } else {
            // A look per texel: what is missed is about as small as one.
            seen(scene, &transport, u64::from(settings.texels).clamp(1 << 14, 1 << 18))
        };
        let is_diffuse = |t: u32| transport.is_diffuse(t);
        let is_seen = |t: u32| seen[t as usize];
        let mut atlas = Atlas::build(&scene.mesh, settings.texels, &is_diffuse, &is_seen, &ConformalCharts);
        atlas.cut_out(scene);
        let elements = atlas.elements.len();
        // What nobody sees may light what somebody does, but less.
        let weight = |t: u32| if is_seen(t) { 1.0 } else { UNSEEN };
        let pieces = (settings.texels as usize / 4).clamp(LIT_PIECES.0, LIT_PIECES.1);
        let importance =
            Importance::new(&atlas.elements, &|e: u32| weight(atlas.elements[e as usize].triangle));
        let lit = transport.lit(pieces, settings.seed, &weight);
        let watched = atlas.elements.iter().map(|e| e.area > 0.0 && is_seen(e.triangle)).collect();
        Self {
            settings: settings.clone(),
            diagonal: scene.diagonal(),
            bins: Bins::new(elements, transport.power()),
            lit,
            sources: None,
            importance,
            direct: vec![[DirectBin::default(); 2]; elements],
            open: vec![[false; 2]; elements],
            watched,
            coarse: false,
            prepared: None,
            estimating: None,
            late: None,
            cut: None,
            spare_tree: None,
            transport: Box::new(transport),
            pass_end: pass_end_after(0, settings),
            relative_error: None,
            atlas,
            emitted: 0,
            bounces: 0,
            direct_rounds: 0,
            direct_block: 0,
            direct_goes_on: Vec::new(),
            direct_rounds_wanted: 1,
        }
    }

    /// `late` is asked while the irradiance is estimated: once it says yes, the rest is made coarsely, and so in little
    /// time.
    pub fn hurried_by(mut self, late: impl Fn() -> bool + Send + Sync + 'a) -> Self {
        self.late = Some(Box::new(late));
        self
    }

    pub(super) fn is_late(&self) -> bool {
        self.late.as_ref().is_some_and(|late| late())
    }

    /// The elements.
    pub fn atlas(&self) -> &Atlas {
        &self.atlas
    }

    /// Particles emitted.
    pub fn emitted(&self) -> u64 {
        self.emitted
    }

    /// Surfaces that particles met.
    pub fn bounces(&self) -> u64 {
        self.bounces
    }

    /// Rounds of direct light done.
    pub fn direct_rounds(&self) -> u32 {
        self.direct_rounds
    }

    /// What has been gathered.
    pub fn state(&self) -> BakeState {
        if let Some(done) = self.cut {
            // What only stands in for samples is not gone on with.
            return BakeState {
                direct_rounds_wanted: 1,
                direct_block: (done / BLOCK) as u64,
                pass_end: pass_end_after(0, &self.settings),
                direct: self.direct[..done].to_vec(),
                ..BakeState::default()
            };
        }
        BakeState {
            emitted: self.emitted,
            bounces: self.bounces,
            direct_rounds: self.direct_rounds,
            direct_rounds_wanted: self.direct_rounds_wanted,
            direct_block: self.direct_block as u64,
            direct_goes_on: self.direct_goes_on.clone(),
            pass_end: self.pass_end,
            bins: self.bins.state(),
            direct: self.direct.clone(),
            importance: self.importance.state(),
        }
    }

    /// Goes on from a saved state. `false`, and nothing changed, if it is of other elements.
    pub fn restore(&mut self, state: &BakeState) -> bool {
        let elements = self.direct.len();
        // The first round of direct light was cut short: no particles yet, and only what was done of it.
        let begun = state.emitted == 0
            && state.direct_rounds == 0
            && state.bins.is_empty()
            && state.direct.len() < elements
            && (state.direct.len() / BLOCK) as u64 == state.direct_block
            && state.direct.len().is_multiple_of(BLOCK);
        if begun {
            self.bins = Bins::new(elements, self.transport.power());
        } else if state.direct.len() != elements || !self.bins.restore(&state.bins) {
            return false;
        }
        self.direct.clone_from(&state.direct);
        self.direct.resize(elements, Default::default());
        (self.cut, self.prepared) = (None, None);
        (self.emitted, self.bounces) = (state.emitted, state.bounces);
        self.direct_rounds = state.direct_rounds;
        self.direct_rounds_wanted = state.direct_rounds_wanted;
        self.direct_block = state.direct_block as usize;
        self.direct_goes_on.clone_from(&state.direct_goes_on);
        self.pass_end = state.pass_end;
        self.importance.restore(&state.importance);
        self.sources = None;
        true
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

/// What a step came to.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// There is more to do.
    Going,
    /// A pass ended; its error is estimated.
    Appraised(Summary),
    /// A pass ended and the settings are met.
    Done(Summary),
}

impl Baker<'_> {
    /// A bounded piece of work: a round of direct light, a batch of particles, or an estimate of the error.
    pub fn step(&mut self) -> Step {
        assert!(self.cut.is_none(), "a bake that was cut short is gone on with by another one");
        match self.next_stage() {
            Stage::Direct => {
                self.gather_blocks(BLOCKS);
                Step::Going
            }
            Stage::Particles => {
                self.emit(BATCH.min(self.pass_end - self.emitted));
                Step::Going
            }
            Stage::Density | Stage::Estimate => {
                let summary = self.appraise();
                self.relative_error = Some(summary.relative_error);
                let met = |limit: Option<f32>| limit.is_some_and(|limit| summary.relative_error <= limit);
                let emitted_all = self.settings.particles.is_some_and(|n| self.emitted >= n);
                // Where direct light is by far the larger error, particles wait for it.
                let others = math::hypot(summary.particle_error, summary.bias_error);
                let waits = self.direct_rounds < ROUNDS_MAX
                    && self
                        .settings
                        .error
                        .is_some_and(|aim| summary.direct_error > (2.0 * others).max(0.7 * aim));
                let ends = emitted_all && !waits;
                if ends || met(self.settings.error) || self.transport.power() <= 0.0 {
                    return Step::Done(summary);
                }
                if !waits {
                    self.pass_end = pass_end_after(self.emitted, &self.settings);
                }
                // Direct light is cheap while it is the smaller error; then its samples double as well. Where few surfaces get
                // it, or it is dim, its noise is no large error, and yet seen.
                let noisy = summary.direct_error > 0.6 * others || self.direct_noise().is_seen();
                if waits || (noisy && self.direct_rounds < ROUNDS_MAX) {
                    self.direct_rounds_wanted = 2 * self.direct_rounds;
                }
                Step::Appraised(summary)
            }
        }
    }

    fn next_stage(&self) -> Stage {
        if self.direct_rounds < self.direct_rounds_wanted {
            Stage::Direct
        } else if self.emitted < self.pass_end {
            Stage::Particles
        } else {
            Stage::Density
        }
    }

    /// Goes on until the settings are met or `keep_going` says no. `on_pass` is told the estimated error after
    /// each pass. Where `keep_going` says no during the first round of direct light, a part of it at least is done, and
    /// the bake is good for a map and its state: to go on, another one takes that up.
    pub fn run(
        &mut self,
        keep_going: &(dyn Fn(&Progress) -> bool + Sync),
        on_pass: &mut dyn FnMut(&Summary),
    ) -> Baked {
        let mut begun = false;
        loop {
            let stage = self.next_stage();
            // Without any direct light there is nothing to show; and who goes on again and again must get somewhere.
            let first = stage == Stage::Direct && self.direct_rounds == 0;
            if !keep_going(&self.progress(stage)) && (begun || !first) {
                if first {
                    self.cut_short();
                }
                keep_going(&self.progress(Stage::Estimate));
                return Baked { illumination: self.illumination(), complete: false };
            }
            begun = true;
            match self.step() {
                Step::Going => {}
                Step::Appraised(summary) => on_pass(&summary),
                Step::Done(summary) => {
                    on_pass(&summary);
                    keep_going(&self.progress(Stage::Estimate));
                    return Baked { illumination: self.illumination(), complete: true };
                }
            }
        }
    }

    fn progress(&self, stage: Stage) -> Progress {
        Progress {
            stage,
            particles: self.emitted,
            bounces: self.bounces,
            direct_rounds: self.direct_rounds,
            direct_share: (self.direct_block * BLOCK) as f32 / self.direct.len().max(1) as f32,
            relative_error: self.relative_error,
        }
    }
}

/// The end of the pass after `emitted` particles: passes end at the same numbers wherever a bake was interrupted.
fn pass_end_after(emitted: u64, settings: &BakeSettings) -> u64 {
    let mut end = FIRST_PASS;
    while end <= emitted {
        end *= 2;
    }
    settings.particles.map_or(end, |n| end.min(n.max(1)))
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
