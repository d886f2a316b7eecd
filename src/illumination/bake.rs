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

use glam::Vec3;
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
use super::filter::{Noisy, Parts, Smoothing};
use super::first::first_picture_while;
use super::gathered::Gathered;
use super::points::Points;
use super::seen::seen;
use super::sites::{Site, Sites};
use super::statement::{HeldBack, HeldBackState, Statement};
use super::stored::{Illumination, Summary, Value};
use crate::scene::Scene;
use crate::transport::Indexed;
use crate::transport::caustic::Sources;
use crate::transport::light::bright::BrightSurfaces;

/// As many times more take those that the start view shows, in a round before and in all of them.
const AHEAD: u32 = 2;
/// Samples of the back of an element in the first round over all, which tell whether there is any light.
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
        let mut site_of = vec![[u32::MAX; 2]; atlas.elements.len()];
        for (i, site) in sites.all().iter().enumerate() {
            site_of[site.element as usize][usize::from(site.back)] = i as u32;
        }
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
                    Some(parts) => Doing::Test(self.stored(&parts)),
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
        let of = |i: usize| match (self.ahead[i], self.seen[i]) {
            (true, _) => f64::from(AHEAD),
            (_, true) => 1.0,
            _ => 1.0 / f64::from(UNSEEN),
        };
        let open = |i: &usize| self.gathered[*i].is_open() && !self.dark[i / BLOCK];
        let sites: f64 = self.rounds.sites(self.round).iter().map(|i| *i as usize).filter(open).map(of).sum();
        let left = most.saturating_sub(self.paths) as f64 / sites.max(1.0);
        // An even number for each: half of them belong to either half.
        let least = if self.round < self.rounds.early() { 1 } else { 2 };
        whole.min(2 * (0.5 * left).ceil().min(f64::from(whole)) as u32).max(least)
    }

    /// The filter of what the round gathered.
    fn smoothing(&self) -> Smoothing {
        let own = |(i, g): (usize, &Gathered)| match g.samples() {
            0 => self.begun(i),
            _ => g.parts(self.per_flux(self.sites.all()[i].element)),
        };
        // Where no light comes nothing is smoothed, nor does it darken what is beside it; and a first estimate tells what was
        // gathered nothing.
        let known = |(i, g): (usize, &Gathered)| g.is_open() && g.samples() > 0 && !self.dark[i / BLOCK];
        let each = || self.gathered.iter().enumerate();
        let known: Vec<bool> = each().map(known).collect();
        Smoothing::new(&self.sites, self.gathered.par_iter().enumerate().map(own).collect(), &known)
    }

    /// The light that the round began with at a site that nobody has come to.
    fn begun(&self, i: usize) -> Parts {
        let site = &self.sites.all()[i];
        let e = &self.atlas.elements[site.element as usize];
        let begun = self.map.lookup_unnamed(e.triangle, e.b1, e.b2, site.back).truncate();
        [Noisy::default(), Noisy::new([begun; 2]), Noisy::default()]
    }

    /// Irradiance on an element per flux of one half of the particles, m⁻².
    fn per_flux(&self, element: u32) -> f32 {
        let area = self.atlas.elements[element as usize].opaque;
        if self.particles > 0 && area > 0.0 { 2.0 / (self.particles as f32 * area) } else { 0.0 }
    }

    /// The map that smoothed parts make.
    fn stored(&self, parts: &[Parts]) -> Illumination {
        let elements = self.atlas.elements.len();
        let mut sides: [Vec<Value>; 2] = [vec![None; elements], vec![None; elements]];
        let (mut named, mut unfound) = (sides.clone(), sides.clone());
        let mut totals = Totals::default();
        let shown = |(i, (site, parts)): (usize, (&Site, &Parts))| {
            let gathered = &self.gathered[i];
            if !gathered.is_open() {
                return None;
            }
            let light: Vec3 = parts.iter().map(Noisy::mean).sum();
            let variance = parts.iter().map(|p| 0.5 * p.variance).sum::<f32>();
            let e = &self.atlas.elements[site.element as usize];
            // As smoothing: where nobody has come yet what there was stays.
            let begun = || self.map.lookup_named(e.triangle, e.b1, e.b2, site.back);
            let straight = gathered.named().unwrap_or_else(begun).extend(0.0);
            let unfound = (parts[2].mean() * gathered.unfound_share()).extend(0.0);
            Some([light.extend(variance.sqrt()), straight, unfound])
        };
        let shown: Vec<_> = self.sites.all().par_iter().zip(parts).enumerate().map(shown).collect();
        // In the order of sites: sums depend on it.
        for (i, (site, parts)) in self.sites.all().iter().zip(parts).enumerate() {
            let Some([value, straight, beyond]) = shown[i] else { continue };
            let (side, element) = (usize::from(site.back), site.element as usize);
            (sides[side][element], named[side][element]) = (Some(value), Some(straight));
            unfound[side][element] = Some(beyond);
            totals.add(&self.atlas.elements[element], value + straight, parts, self.seen[i]);
        }
        let [front, back] = sides;
        let map = Illumination::new(&self.atlas, front, back, totals.summary(self));
        let map = map.with_unfound(&self.atlas, unfound);
        if self.has_named { map.with_named(&self.atlas, named) } else { map }
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
            if let Some(parts) = smoothing.step(usize::MAX >> 1) {
                return self.stored(&parts);
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
