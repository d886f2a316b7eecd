//! Which tile of a converged view is sampled next: the one with the largest error.
//!
//! In rounds: every tile that is not done gets as many samples as the round wants before any gets more. What is shown
//! changes between rounds only, so that it does not depend on the order within, and whether a tile is done is decided there.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::sync::Arc;

use crate::display::tone::ToneMap;
use crate::splatting::light_tracing::{LightSums, Splats, runs_for};
use crate::splatting::supersampling::{SAMPLES_MAX, Supersampling, Tiles};
use crate::splatting::tile_sums::TileSums;

/// Samples of each pixel in one order: a few milliseconds of a tile.
const SAMPLES_PER_ORDER: u32 = 4;
/// Samples of each pixel in the first round; every later one doubles what there is.
const FIRST_ROUND: u32 = 8;
/// Samples before an error is believed: so few that a quiet wall costs little, so many that an edge is not missed by
/// all pixels of a tile.
const SAMPLES_MIN: u32 = 16;

/// More samples for a tile.
#[derive(Clone, Debug)]
pub struct TileOrder {
    /// Which tile.
    pub tile: u32,
    /// What it has; none at first.
    pub on: Option<Arc<TileSums>>,
    /// Samples to add to each pixel.
    pub count: u32,
}

/// How far a view is refined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Standing {
    /// Tiles of the picture.
    pub tiles: u32,
    /// Tiles whose standard error is below the bound.
    pub quiet: u32,
    /// Largest standard error of a tile, root mean square of displayed values in [0, 1]; `None` before any is known.
    pub error: Option<f32>,
    /// What is said of the picture shown: the error of its blocks of 8 × 8 pixels is below this share of their mean, 95 %
    /// certain; `None` before anything is known.
    pub stated: Option<f32>,
}

/// Samples that a pixel may still get after `samples`. One is what a converged view has anyway.
fn room(rules: &Supersampling, samples: u32) -> u32 {
    let most = if rules.max_samples > 1 { rules.max_samples.min(SAMPLES_MAX - 1) } else { 0 };
    most.saturating_sub(samples)
}

/// Whether a tile needs no more samples, or may not have them.
fn is_done(rules: &Supersampling, sums: Option<&TileSums>, tone: &ToneMap) -> bool {
    let Some(sums) = sums else { return room(rules, 0) == 0 };
    let [mean, largest] = sums.error(tone);
    let quiet = sums.samples >= SAMPLES_MIN && mean < rules.noise && largest < 4.0 * rules.noise;
    quiet || room(rules, sums.samples) == 0
}

/// Refines one view at a time.
#[derive(Clone, Debug)]
pub struct Supersampler {
    rules: Supersampling,
    tiles: Tiles,
    /// What each tile has.
    sums: Vec<Option<Arc<TileSums>>>,
    /// Standard error of each tile as far as is known, root mean square of displayed values; for whoever looks on.
    errors: Vec<f32>,
    /// Tiles that may be ordered, the largest error first (as bits: errors are not negative), the first tile of those.
    open: BinaryHeap<(u32, Reverse<u32>)>,
    round: Round,
    /// Tiles whose orders were given up: they stay as they are.
    lost: Vec<u32>,
    stated: Option<f32>,
    /// Light that is traced to the eye, where paths do not find all.
    traced: Option<Arc<LightSums>>,
}

/// How far a round is.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Round {
    /// Samples that each pixel of an open tile gets.
    wanted: u32,
    /// Tiles that were ordered and have not come back.
    ordered: u32,
    /// Whether any tile or run has come back since the picture was made.
    is_news: bool,
    /// Runs of particles that were ordered since the view converged, and that the round wants.
    runs: [u32; 2],
}

/// What each tile has.
pub type AllSums = Vec<Option<Arc<TileSums>>>;

impl Supersampler {
    /// For pictures of a size; nothing is open until a view has converged.
    pub fn new(rules: Supersampling, width: u32, height: u32) -> Self {
        Self {
            rules,
            tiles: Tiles::of_size(width, height),
            sums: Vec::new(),
            errors: Vec::new(),
            open: BinaryHeap::new(),
            round: Round::default(),
            lost: Vec::new(),
            stated: None,
            traced: None,
        }
    }

    /// Another view: what was there holds no more.
    pub fn forget(&mut self) {
        self.sums.clear();
        self.errors.clear();
        self.open.clear();
        self.round = Round::default();
        self.lost.clear();
        self.stated = None;
        self.traced = None;
    }

    /// Other rules, from the next round on.
    pub fn set_rules(&mut self, rules: Supersampling) {
        self.rules = rules;
        if room(&rules, self.round.wanted) == 0 {
            self.open.clear();
            self.round.runs[1] = self.round.runs[0];
        }
    }

    /// Whether a view is being refined or is refined.
    pub fn has_begun(&self) -> bool {
        !self.sums.is_empty()
    }

    /// Whether nothing is to be ordered. What was ordered may still be on its way.
    pub fn is_exhausted(&self) -> bool {
        self.open.is_empty() && self.round.runs[0] >= self.round.runs[1]
    }

    /// The view has converged; `traced` is without any run, and there where light is to be traced to the eye.
    pub fn begin(&mut self, traced: Option<LightSums>) {
        self.forget();
        self.sums.resize(self.tiles.len(), None);
        self.traced = traced.map(Arc::new);
    }

    /// Runs of particles that belong to so many samples of a pixel.
    fn runs_for(&self, samples: u32) -> u32 {
        runs_for(room(&self.rules, 0).min(samples), self.tiles.pixel_count())
    }

    /// Runs of particles that the next round wants, for as many samples of the open tiles.
    fn wanted_runs(&self, tone: &ToneMap) -> u32 {
        let ordered = self.round.runs[0];
        let Some(traced) = &self.traced else { return ordered };
        let noisy = !(traced.error(self.tiles.width(), tone) < self.rules.noise);
        match (noisy, self.open.is_empty()) {
            (false, _) => ordered,
            (true, false) => self.runs_for(self.round.wanted),
            // Tiles are quiet; caustics double on their own.
            (true, true) => (2 * ordered).min(self.runs_for(SAMPLES_MAX)),
        }
        .max(ordered)
    }

    /// Where everything that a round ordered has come back, opens what the next one wants. What to make a picture of, if
    /// there is anything new.
    pub fn end_round(&mut self, tone: &ToneMap) -> Option<(Arc<AllSums>, Option<Arc<LightSums>>)> {
        if !self.has_begun() || !self.is_exhausted() || self.round.ordered > 0 {
            return None;
        }
        let is_news = std::mem::take(&mut self.round.is_news);
        for (tile, sums) in self.sums.iter().enumerate() {
            let is_lost = self.lost.contains(&(tile as u32));
            if !is_lost && !is_done(&self.rules, sums.as_deref(), tone) {
                let error = sums.as_ref().map_or(f32::INFINITY, |sums| sums.error(tone)[0]);
                self.open.push((error.to_bits(), Reverse(tile as u32)));
            }
        }
        if !self.open.is_empty() {
            let most = self.sums.iter().flatten().map(|sums| sums.samples).max().unwrap_or(0);
            self.round.wanted = (2 * most).max(FIRST_ROUND);
        }
        self.round.runs[1] = self.wanted_runs(tone);
        is_news.then(|| (Arc::new(self.sums.clone()), self.traced.clone()))
    }

    /// The next run of particles of the round.
    pub fn next_run(&mut self) -> Option<u32> {
        let [ordered, wanted] = self.round.runs;
        if ordered >= wanted {
            return None;
        }
        self.round.runs[0] += 1;
        self.round.ordered += 1;
        Some(ordered)
    }

    /// A run has come back.
    pub fn record_run(&mut self, splats: &Splats) {
        self.lose_run();
        if let Some(traced) = &mut self.traced {
            Arc::make_mut(traced).add(splats);
            self.round.is_news = true;
        }
    }

    /// A run was given up.
    pub fn lose_run(&mut self) {
        self.round.ordered = self.round.ordered.saturating_sub(1);
    }

    /// An order of a tile was given up.
    pub fn lose(&mut self, tile: u32) {
        self.round.ordered = self.round.ordered.saturating_sub(1);
        self.lost.push(tile);
    }

    /// What is said of the picture that is shown.
    pub fn state(&mut self, error: f32) {
        self.stated = error.is_finite().then_some(error);
    }

    /// The order that helps most.
    pub fn next_order(&mut self) -> Option<TileOrder> {
        let (_, Reverse(tile)) = self.open.pop()?;
        let on = self.sums.get(tile as usize).cloned().flatten();
        let samples = on.as_ref().map_or(0, |on| on.samples);
        let wanted = self.round.wanted.saturating_sub(samples).min(room(&self.rules, samples));
        self.round.ordered += 1;
        Some(TileOrder { tile, on, count: SAMPLES_PER_ORDER.min(wanted) })
    }

    /// A tile has come back.
    pub fn record(&mut self, sums: Arc<TileSums>, tone: &ToneMap) {
        self.round.ordered = self.round.ordered.saturating_sub(1);
        if let Some(slot) = self.sums.get_mut(sums.tile as usize) {
            *slot = Some(sums.clone());
            let error = sums.error(tone)[0];
            self.errors.resize(self.tiles.len(), f32::INFINITY);
            self.errors[sums.tile as usize] = error;
            self.round.is_news = true;
            if sums.samples < self.round.wanted && room(&self.rules, sums.samples) > 0 {
                self.open.push((error.to_bits(), Reverse(sums.tile)));
            }
        }
    }

    /// How far the view is refined; `None` before that has begun.
    pub fn standing(&self) -> Option<Standing> {
        let known = || self.errors.iter().filter(|error| error.is_finite());
        self.has_begun().then(|| Standing {
            tiles: self.tiles.len() as u32,
            quiet: known().filter(|error| **error < self.rules.noise).count() as u32,
            error: known().copied().reduce(f32::max),
            stated: self.stated,
        })
    }

    /// What the tiles have, for a snapshot.
    pub fn tiles(&self) -> &[Option<Arc<TileSums>>] {
        &self.sums
    }

    /// What was traced to the eye, for a snapshot.
    pub fn traced(&self) -> Option<&Arc<LightSums>> {
        self.traced.as_ref()
    }

    /// The open tiles, for a snapshot.
    pub fn open(&self) -> Vec<(u32, u32)> {
        let mut open: Vec<_> = self.open.iter().map(|&(error, Reverse(tile))| (error, tile)).collect();
        open.sort_unstable();
        open
    }

    /// How far the round is, and what is said of the picture, for a snapshot.
    pub fn progress(&self) -> (Round, Vec<u32>, Option<f32>) {
        (self.round, self.lost.clone(), self.stated)
    }

    /// Takes a snapshot up again; `None` if it is one of another picture.
    pub fn restore(
        &mut self,
        sums: AllSums,
        open: Vec<(u32, u32)>,
        (round, lost, stated): (Round, Vec<u32>, Option<f32>),
        traced: Option<Arc<LightSums>>,
    ) -> Option<()> {
        let whole = sums.is_empty() || sums.len() == self.tiles.len();
        let fits = |(at, sums): (usize, &Arc<TileSums>)| sums.tile as usize == at && sums.fits(&self.tiles);
        let all_fit = sums.iter().enumerate().all(|(at, sums)| sums.as_ref().is_none_or(|s| fits((at, s))));
        if traced.as_ref().is_some_and(|traced| !traced.fits(self.tiles.pixel_count())) {
            return None;
        }
        if !whole || !all_fit || open.iter().any(|&(_, tile)| tile as usize >= sums.len()) {
            return None;
        }
        (self.sums, self.round, self.lost, self.stated) = (sums, round, lost, stated);
        self.traced = traced;
        self.errors.clear();
        self.open = open.into_iter().map(|(error, tile)| (error, Reverse(tile))).collect();
        Some(())
    }
}
