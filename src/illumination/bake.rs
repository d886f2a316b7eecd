//! The bake: irradiance gathered at the elements, round by round (LIGHT.md §2.5).
//!
//! In a round each site takes samples of what arrives at points of it, and reads the map of the round before where a path
//! meets the next diffuse surface: radiosity by gathering, with rounds as bounces. A round takes twice the samples of the
//! one before, so that what it costs to smooth and to test them stays a share. The first round reads a first picture of
//! coarse elements, in which light has bounced some times ([`super::first`]).
//!
//! What the start view shows comes first, in short rounds of its own (`Rounds`).
//!
//! No clock in here: the caller's `keep_going` decides when the time is over. The result depends on the number of paths
//! only, not on threads or on where a bake was interrupted: sites do not depend on each other within a round.

use std::sync::{Arc, OnceLock};

use glam::{Vec3, Vec4};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

pub mod orders;
pub mod particles;
mod rounds;
mod settings;
mod totals;

use orders::{Gatherers, Here};
use rounds::Rounds;
pub use settings::{BakeSettings, VERSION, cache_key, early_key};
use totals::Totals;

use super::ahead::ahead;
use super::atlas::{Atlas, ConformalCharts};
use super::filter::{Noisy, Parts, Smoothed, Smoothing};
use super::first::first_picture_while;
use super::gathered::Gathered;
use super::points::Points;
use super::seen::seen;
use super::sites::{NONE, Sites, by_element, sides};
use super::statement::{HeldBack, HeldBackState, Statement};
use super::stored::{Illumination, Summary};
use crate::scene::Scene;
use crate::transport::Indexed;
use crate::transport::caustic::Sources;
use crate::transport::light::bright::BrightSurfaces;

/// As many times more take those that the start view shows, in rounds before and in all but the first over all.
const AHEAD: u32 = 2;
/// Samples of the back of an element in the first round over all, which tell whether there is any light; and of what was seen
/// ahead of it.
const FIRST_LOOK: u32 = 2;
/// What a site out of sight takes, as a share: it may light what is in sight.
const UNSEEN: u32 = 8;
/// Samples between two questions whether to go on.
const BATCH: u64 = 1 << 16;
/// Sites smoothed between two such questions.
const SMOOTHED: usize = 1 << 14;
/// Sites that share the decision whether light can reach them.
const BLOCK: usize = 64;
/// One in so many samples is taken where the map is tested; each follows its path to the end.
const TESTED: u64 = 16;
/// Looks for what is in sight, at least and at most: one for each texel.
const LOOKS: (u64, u64) = (1 << 14, 1 << 18);

/// What a bake is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Making the first picture.
    First,
    /// Gathering light.
    Gather,
    /// Smoothing what was gathered.
    Smooth,
    /// Holding the map against points that it was not made of.
    Test,
}

/// How far a bake is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// What it does now.
    pub stage: Stage,
    /// Paths sampled.
    pub particles: u64,
    /// Rounds done.
    pub rounds: u32,
    /// Share done of the one that has begun.
    pub round_share: f32,
    /// Relative error of the last map; `None` before the first.
    pub relative_error: Option<f32>,
}

/// Everything a bake has gathered, for saving and going on later.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BakeState {
    paths: u64,
    round: u32,
    round_samples: Option<u32>,
    next: u64,
    particles: u64,
    gathered: Vec<Gathered>,
    dark: Vec<bool>,
    map: Illumination,
    held_back: HeldBackState,
}

/// What the next step of a bake does.
enum Doing {
    Begin,
    Gather,
    Smooth(Smoothing),
    Test(Illumination),
}

/// A bake in progress.
pub struct Baker {
    settings: BakeSettings,
    atlas: Atlas,
    points: Points,
    sites: Sites,
    /// Per site whether the start view shows it.
    ahead: Vec<bool>,
    /// In which order sites are come to.
    rounds: Rounds,
    /// Per site whether a walk can see it.
    seen: Vec<bool>,
    gathered: Vec<Gathered>,
    /// Per element its front's and its back's site.
    site_of: Vec<[u32; 2]>,
    /// Where particles of caustics begin.
    sources: OnceLock<Sources>,
    /// Particles traced.
    particles: u64,
    /// Per block of sites whether no light reaches it; decided by the first round.
    dark: Vec<bool>,
    /// What is read where paths meet a diffuse surface.
    map: Arc<Illumination>,
    /// Where most of its light comes from, once it was looked for.
    bright: OnceLock<BrightSurfaces>,
    /// Whether there are named lights.
    has_named: bool,
    held_back: HeldBack,
    doing: Doing,
    /// Rounds done.
    round: u32,
    /// Samples of a site in the round that has begun.
    round_samples: Option<u32>,
    /// Sites done of it.
    next: usize,
    paths: u64,
    /// What the last map was found to be off by.
    statement: Option<Statement>,
    relative_error: Option<f32>,
}

/// What [`Baker::run`] came to.
#[derive(Clone, Debug)]
pub struct Baked {
    /// The irradiance.
    pub illumination: Illumination,
    /// Whether the error or the number of paths asked for was reached; else `keep_going` ended it.
    pub complete: bool,
}

/// What a step came to.
#[derive(Clone, Debug)]
pub enum Step {
    /// There is more to do.
    Going,
    /// A round ended: a better map.
    Better(Arc<Illumination>),
    /// A round ended and the settings are met.
    Done(Arc<Illumination>),
}

impl Baker {
    /// Divides the surfaces into elements. No light is gathered yet.
    pub fn new(indexed: Indexed<'_>, settings: &BakeSettings) -> Self {
        Self::new_while(indexed, settings, &|| true).unwrap_or_else(|| unreachable!("it is always wanted"))
    }

    /// The same, as long as it is wanted; `None` where that ended before.
    pub fn new_while(
        indexed: Indexed<'_>,
        settings: &BakeSettings,
        is_wanted: &(dyn Fn() -> bool + Sync),
    ) -> Option<Self> {
        let scene = indexed.scene;
        let watched = if settings.everything {
            vec![true; scene.mesh.triangles.len()]
        } else {
            seen(scene, indexed.accel, u64::from(settings.texels).clamp(LOOKS.0, LOOKS.1))
        };
        if !is_wanted() {
            return None;
        }
        let atlas = atlas_of(scene, settings.texels, &|t: u32| watched[t as usize], is_wanted)?;
        if !is_wanted() {
            return None;
        }
        let points = Points::new(&scene.mesh, &atlas);
        let sites = Sites::new(&atlas, &sides_of(&atlas));
        if !is_wanted() {
            return None;
        }
        let is_seen = |element: u32| watched[atlas.elements[element as usize].triangle as usize];
        let site_of = by_element(sites.all(), atlas.elements.len());
        let is_ahead = ahead((scene, indexed.accel), &atlas, &sites, &site_of);
        Some(Self {
            rounds: Rounds::new(&is_ahead),
            ahead: is_ahead,
            site_of,
            sources: OnceLock::new(),
            particles: 0,
            settings: settings.clone(),
            seen: sites.all().iter().map(|s| is_seen(s.element)).collect(),
            gathered: vec![Gathered::default(); sites.all().len()],
            dark: vec![false; sites.all().len().div_ceil(BLOCK)],
            map: Arc::default(),
            bright: OnceLock::new(),
            has_named: indexed.lights.has_any_named(),
            held_back: HeldBack::new(indexed, settings.seed),
            doing: Doing::Begin,
            round: 0,
            round_samples: None,
            next: 0,
            paths: 0,
            statement: None,
            relative_error: None,
            atlas,
            points,
            sites,
        })
    }

    /// Begins with this light instead of a first picture of its own; with the one that `first_picture` makes of the
    /// same seed nothing changes.
    pub fn begin_with(&mut self, first: &dyn super::Irradiance) {
        if matches!(self.doing, Doing::Begin) {
            self.map = Arc::new(Illumination::resampled(&self.atlas, first));
            self.bright = OnceLock::new();
            self.doing = Doing::Gather;
        }
    }

    /// The elements.
    pub fn atlas(&self) -> &Atlas {
        &self.atlas
    }

    /// Paths sampled.
    pub fn paths(&self) -> u64 {
        self.paths
    }

    /// The last map: that of the last round that ended.
    pub fn map(&self) -> &Arc<Illumination> {
        &self.map
    }

    /// Where most of its light comes from, once it was looked for.
    pub fn bright(&self) -> &OnceLock<BrightSurfaces> {
        &self.bright
    }

    /// What the last map was found to be off by where it is seen.
    pub fn statement(&self) -> Option<Statement> {
        self.statement
    }

    /// What has been gathered. A round that ended but was not smoothed or tested is smoothed and tested again.
    pub fn state(&self) -> BakeState {
        BakeState {
            paths: self.paths,
            round: self.round,
            round_samples: self.round_samples,
            next: self.next as u64,
            particles: self.particles,
            gathered: self.gathered.clone(),
            dark: self.dark.clone(),
            map: Illumination::clone(&self.map),
            held_back: self.held_back.state(),
        }
    }

    /// Goes on from a saved state. `false`, and nothing changed, if it is of other elements.
    pub fn restore(&mut self, state: &BakeState) -> bool {
        let fits = state.gathered.len() == self.gathered.len()
            && state.dark.len() == self.dark.len()
            && state.next <= state.gathered.len() as u64
            && state.round <= self.rounds.most()
            && state.map.is_sound()
            && state.map.element_count() == self.atlas.elements.len()
            && state.map.triangle_count() == self.atlas.corners.len();
        if !fits || !self.held_back.restore(&state.held_back) {
            return false;
        }
        self.gathered.clone_from(&state.gathered);
        self.dark.clone_from(&state.dark);
        (self.map, self.bright) = (Arc::new(state.map.clone()), OnceLock::new());
        (self.paths, self.round, self.next) = (state.paths, state.round, state.next as usize);
        (self.round_samples, self.particles) = (state.round_samples, state.particles);
        self.doing = Doing::Gather;
        true
    }

    /// A bounded piece of work.
    pub fn step(&mut self, indexed: Indexed<'_>) -> Step {
        self.step_by(indexed, &Here)
    }

    /// The same, where others may gather.
    pub fn step_by(&mut self, indexed: Indexed<'_>, gatherers: &dyn Gatherers) -> Step {
        match std::mem::replace(&mut self.doing, Doing::Gather) {
            Doing::Begin => {
                let first = first_picture_while(indexed, self.settings.seed, &|| gatherers.is_wanted());
                self.doing = Doing::Begin;
                if let Some(first) = first {
                    self.begin_with(&first);
                }
                Step::Going
            }
            // What a round shows has all parts of light, wherever it ends.
            Doing::Gather if self.next == 0 && self.wants_particles(indexed) => {
                self.trace(indexed, gatherers);
                Step::Going
            }
            Doing::Gather => {
                self.gather(indexed, gatherers);
                Step::Going
            }
            Doing::Smooth(mut smoothing) => {
                self.doing = match smoothing.step(SMOOTHED) {
                    None => Doing::Smooth(smoothing),
                    Some(smoothed) => Doing::Test(self.stored(&smoothed)),
                };
                Step::Going
            }
            Doing::Test(map) => {
                if self.held_back.sample(indexed, &map, &|| gatherers.is_wanted()) {
                    self.doing = Doing::Test(map);
                    return Step::Going;
                }
                self.appraised(map)
            }
        }
    }

    fn appraised(&mut self, mut map: Illumination) -> Step {
        self.statement = self.held_back.statement(&map, self.paths / TESTED);
        // Without cameras there is nobody to see an error, and what halves differ by is all that is known.
        let (direct, rest) = (map.summary.direct_error, map.summary.particle_error);
        let noise = (direct * direct + rest * rest).sqrt();
        let error = self.statement.map_or(noise, |s| s.at_most());
        map.summary.relative_error = error;
        map.summary.bias_error = (error * error - noise * noise).max(0.0).sqrt();
        self.relative_error = Some(error);
        let map = Arc::new(map);
        (self.map, self.bright) = (map.clone(), OnceLock::new());
        (self.round, self.next) = (self.round + 1, 0);
        let met = self.settings.error.is_some_and(|limit| error <= limit);
        let all = self.settings.particles.is_some_and(|most| self.paths >= most);
        let nothing = self.dark.iter().all(|d| *d);
        let is_last = self.round >= self.rounds.most();
        if met || all || nothing || is_last { Step::Done(map) } else { Step::Better(map) }
    }

    /// Rounds over all sites before the one that has begun.
    fn whole_rounds(&self) -> u32 {
        self.rounds.whole(self.round)
    }

    /// Samples of a site in the round that has begun: the last round is as long as what is left of the paths asked for.
    fn samples_of_round(&self) -> u32 {
        let whole = self.rounds.samples(self.round);
        let Some(most) = self.settings.particles else { return whole };
        let phase = self.rounds.phase(self.round);
        // What a site takes of a whole round, as a share of it.
        let of = |i: usize| f64::from(self.samples_at(i, whole, phase)) / f64::from(whole);
        let open = |i: &usize| self.gathered[*i].is_open() && !self.dark[i / BLOCK];
        let sites: f64 = self.rounds.sites(self.round).iter().map(|i| *i as usize).filter(open).map(of).sum();
        let left = most.saturating_sub(self.paths) as f64 / sites.max(1.0);
        // An even number for each: half of them belong to either half.
        let least = if self.round < self.rounds.early() { 1 } else { 2 };
        whole.min(2 * (0.5 * left).ceil().min(f64::from(whole)) as u32).max(least)
    }

    /// The filter of what the round gathered. Where no light comes nothing is smoothed, nor does it darken what is beside it; and a
    /// first estimate tells what was gathered nothing.
    fn smoothing(&self) -> Smoothing {
        let is_known = |i: &usize| {
            let gathered = &self.gathered[*i];
            gathered.is_open() && gathered.samples() > 0 && !self.dark[i / BLOCK]
        };
        let known: Vec<u32> = (0..self.gathered.len()).filter(is_known).map(|i| i as u32).collect();
        let gathered = known.par_iter().map(|i| self.parts(*i as usize)).collect();
        Smoothing::new(&self.sites, known, gathered)
    }

    /// What was gathered at a site; the light that the round began with where nobody has come to it.
    fn parts(&self, i: usize) -> Parts {
        let site = &self.sites.all()[i];
        match self.gathered[i].samples() {
            0 => {
                let begun = self.map.unnamed_of(site.element as usize, site.back).truncate();
                [Noisy::default(), Noisy::new([begun; 2]), Noisy::default()]
            }
            _ => self.gathered[i].parts(self.per_flux(site.element)),
        }
    }

    /// Irradiance on an element per flux of one half of the particles, m⁻².
    fn per_flux(&self, element: u32) -> f32 {
        let area = self.atlas.elements[element as usize].opaque;
        if self.particles > 0 && area > 0.0 { 2.0 / (self.particles as f32 * area) } else { 0.0 }
    }

    /// The map that smoothed parts make; at other sites what was gathered stands for itself.
    fn stored(&self, smoothed: &Smoothed) -> Illumination {
        let mut number = vec![NONE; self.gathered.len()];
        smoothed.known.iter().zip(0..).for_each(|(&i, k)| number[i as usize] = k);
        let parts =
            |i: usize| smoothed.parts.get(number[i] as usize).copied().unwrap_or_else(|| self.parts(i));
        let light = |parts: &Parts| {
            let variance = parts.iter().map(|p| 0.5 * p.variance).sum::<f32>();
            parts.iter().map(Noisy::mean).sum::<Vec3>().extend(variance.sqrt())
        };
        // As smoothing: where nobody has come yet what there was stays.
        let straight = |i: usize| {
            let site = &self.sites.all()[i];
            let begun = || self.map.named_of(site.element as usize, site.back);
            self.gathered[i].named().unwrap_or_else(begun).extend(0.0)
        };
        let unfound = |i: usize| (parts(i)[2].mean() * self.gathered[i].unfound_share()).extend(0.0);
        let by_side = |value: &(dyn Fn(usize) -> Vec4 + Sync)| {
            sides(&self.site_of, &|i| self.gathered[i].is_open().then(|| value(i)))
        };
        let totals = Totals::over(self.gathered.len(), |i, totals| {
            if self.gathered[i].is_open() {
                let parts = parts(i);
                let straight = if self.has_named { straight(i) } else { Vec4::ZERO };
                let element = &self.atlas.elements[self.sites.all()[i].element as usize];
                totals.add(element, light(&parts) + straight, &parts, self.seen[i]);
            }
        });
        let [front, back] = by_side(&|i| light(&parts(i)));
        let map = Illumination::new(&self.atlas, front, back, totals.summary(self));
        let has_particles = self.particles > 0;
        let map = if has_particles { map.with_unfound(&self.atlas, by_side(&unfound)) } else { map };
        if self.has_named { map.with_named(&self.atlas, by_side(&straight)) } else { map }
    }

    /// What was gathered so far, smoothed: where the round that has begun did not come to, the one before shows.
    fn so_far(&mut self) -> Illumination {
        let mut smoothing = match std::mem::replace(&mut self.doing, Doing::Gather) {
            Doing::Begin => return Illumination::clone(&self.map),
            Doing::Test(map) => return map,
            Doing::Smooth(smoothing) => smoothing,
            Doing::Gather if self.next == 0 => return Illumination::clone(&self.map),
            Doing::Gather => self.smoothing(),
        };
        loop {
            if let Some(smoothed) = smoothing.step(usize::MAX >> 1) {
                return self.stored(&smoothed);
            }
        }
    }

    /// Goes on until the settings are met or `keep_going` says no. `on_round` is told of each map but the last.
    pub fn run(
        &mut self,
        indexed: Indexed<'_>,
        keep_going: &(dyn Fn(&Progress) -> bool + Sync),
        on_round: &mut dyn FnMut(&Summary),
    ) -> Baked {
        self.run_by(indexed, &Here, keep_going, on_round)
    }

    /// The same, where others may gather.
    pub fn run_by(
        &mut self,
        indexed: Indexed<'_>,
        gatherers: &dyn Gatherers,
        keep_going: &(dyn Fn(&Progress) -> bool + Sync),
        on_round: &mut dyn FnMut(&Summary),
    ) -> Baked {
        let (is_new, before) = (matches!(self.doing, Doing::Begin), (self.paths, self.round));
        let mut begun = false;
        loop {
            // Without any light there is nothing to show; and who goes on again and again must get somewhere.
            if !keep_going(&self.progress()) && begun {
                let state = self.state();
                let mut illumination = self.so_far();
                if self.whole_rounds() == 0 {
                    let come_to = self.gathered.iter().filter(|g| g.samples() > 0).count();
                    illumination.summary.notes.push(format!(
                        "light was gathered at {come_to} of {} places, elsewhere a coarse estimate shows",
                        self.gathered.len()
                    ));
                }
                // What is saved is what goes on.
                self.restore(&state);
                return Baked { illumination, complete: false };
            }
            let begins = matches!(self.doing, Doing::Begin);
            match self.step_by(indexed, gatherers) {
                Step::Going => {}
                Step::Better(map) => on_round(&map.summary),
                Step::Done(map) => {
                    on_round(&map.summary);
                    return Baked { illumination: Illumination::clone(&map), complete: true };
                }
            }
            begun = !begins && (is_new || (self.paths, self.round) != before);
        }
    }

    fn progress(&self) -> Progress {
        let stage = match &self.doing {
            Doing::Begin => Stage::First,
            Doing::Gather => Stage::Gather,
            Doing::Smooth(_) => Stage::Smooth,
            Doing::Test(_) => Stage::Test,
        };
        Progress {
            stage,
            particles: self.paths,
            rounds: self.round,
            round_share: self.next as f32 / self.rounds.sites(self.round).len().max(1) as f32,
            relative_error: self.relative_error,
        }
    }
}

/// The elements of a scene, as long as they are wanted; `None` where that ended before.
pub(super) fn atlas_of(
    scene: &Scene,
    texels: u32,
    is_seen: &(dyn Fn(u32) -> bool + Sync),
    is_wanted: &dyn Fn() -> bool,
) -> Option<Atlas> {
    let is_diffuse = |t: u32| scene.material_of(t).has_diffuse();
    let charts = &ConformalCharts;
    let mut atlas = Atlas::build_while(&scene.mesh, texels, &is_diffuse, is_seen, charts, is_wanted)?;
    atlas.cut_out(scene);
    Some(atlas)
}

/// All fronts, then all backs: what shares a block lies on one side.
pub(super) fn sides_of(atlas: &Atlas) -> Vec<(u32, bool)> {
    let covered = |e: &u32| atlas.elements[*e as usize].area > 0.0;
    let side = |back: bool| (0..atlas.elements.len() as u32).filter(covered).map(move |e| (e, back));
    side(false).chain(side(true)).collect()
}

/// Bakes a scene until the settings are met or `keep_going` says no.
pub fn bake(
    indexed: Indexed<'_>,
    settings: &BakeSettings,
    keep_going: &(dyn Fn(&Progress) -> bool + Sync),
) -> Baked {
    Baker::new(indexed, settings).run(indexed, keep_going, &mut |_| {})
}
