//! Which tile of a converged view is sampled next: the one with the largest error.
//!
//! In rounds: every tile that is not done gets as many samples as the round wants before any gets more, in blocks, several
//! of which may be under way at once. What is shown changes between rounds only, so that it does not depend on the order
//! within, and whether a tile is done is decided there.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};
use std::sync::Arc;

use crate::display::tone::ToneMap;
use crate::splatting::light_tracing::{LightSums, Splats, runs_for};
use crate::splatting::supersampling::{Block, SAMPLES_MAX, Supersampling, Tiles, block_after};
use crate::splatting::tile_sums::TileSums;

/// Samples of each pixel in the first round; every later one doubles what there is.
const FIRST_ROUND: u32 = 8;
/// Samples before an error is believed: so few that a quiet wall costs little, so many that an edge is not missed by
/// all pixels of a tile.
const SAMPLES_MIN: u32 = 16;

/// How far a view is refined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefinementProgress {
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
    /// Samples of each pixel of a tile that were ordered.
    begun: Vec<u32>,
    /// Blocks that came before those in front of them, by tile and samples before.
    early: Early,
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
    /// Blocks and runs that were ordered and have not come back.
    ordered: u32,
    /// Whether any tile or run has come back since the picture was made.
    is_news: bool,
    /// Runs of particles that were ordered since the view converged, and that the round wants.
    runs: [u32; 2],
}

/// What each tile has.
pub type AllSums = Vec<Option<Arc<TileSums>>>;

/// Blocks, by tile and samples before.
pub type Early = BTreeMap<(u32, u32), Arc<TileSums>>;

/// A refinement in the middle of its rounds, for a snapshot.
#[derive(Clone, Debug, Default)]
pub struct UnderWay {
    /// What each tile has.
    pub sums: AllSums,
    /// Samples of each pixel of a tile that were ordered.
    pub begun: Vec<u32>,
    /// Blocks that came before those in front of them.
    pub early: Early,
    /// The open tiles.
    pub open: Vec<(u32, u32)>,
    /// How far the round is.
    pub round: Round,
    /// Tiles that stay as they are.
    pub lost: Vec<u32>,
    /// What is said of the picture.
    pub stated: Option<f32>,
    /// What was traced to the eye.
    pub traced: Option<Arc<LightSums>>,
}

impl Supersampler {
    /// For pictures of a size; nothing is open until a view has converged.
    pub fn new(rules: Supersampling, width: u32, height: u32) -> Self {
        Self {
            rules,
            tiles: Tiles::of_size(width, height),
            sums: Vec::new(),
            begun: Vec::new(),
            early: Early::new(),
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
        self.begun.clear();
        self.early.clear();
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
        self.begun.resize(self.tiles.len(), 0);
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

    /// A block of a tile was given up: the tile stays as it is.
    pub fn lose(&mut self, tile: u32) {
        self.round.ordered = self.round.ordered.saturating_sub(1);
        self.early.retain(|(of, _), _| *of != tile);
        self.open.retain(|(_, Reverse(open))| *open != tile);
        self.lost.push(tile);
    }

    /// What is said of the picture that is shown.
    pub fn state(&mut self, error: f32) {
        self.stated = error.is_finite().then_some(error);
    }

    /// Samples that a tile is to get in this round after so many.
    fn wanted_after(&self, samples: u32) -> u32 {
        self.round.wanted.saturating_sub(samples).min(room(&self.rules, samples))
    }

    /// The block that helps most.
    pub fn next_block(&mut self) -> Option<Block> {
        let (error, Reverse(tile)) = self.open.pop()?;
        let first = *self.begun.get(tile as usize)?;
        let count = block_after(first).min(self.wanted_after(first));
        self.begun[tile as usize] = first + count;
        self.round.ordered += 1;
        if self.wanted_after(first + count) > 0 {
            self.open.push((error, Reverse(tile)));
        }
        Some(Block { tile, first, count })
    }

    /// A block has come back. What the tile has then, if it is the one that was next.
    pub fn record(&mut self, block: Arc<TileSums>, tone: &ToneMap) -> Option<Arc<TileSums>> {
        self.round.ordered = self.round.ordered.saturating_sub(1);
        let (tile, at) = (block.tile, block.tile as usize);
        if at >= self.sums.len() || self.lost.contains(&tile) || !block.fits_as_block(&self.tiles) {
            return None;
        }
        self.early.insert((tile, block.first), block);
        let mut sums = self.sums[at].take();
        let mut has_grown = false;
        loop {
            let had = sums.as_ref().map_or(0, |sums| sums.samples);
            let Some(next) = self.early.remove(&(tile, had)) else { break };
            let sums = sums.get_or_insert_with(|| Arc::new(TileSums::new(tile, next.len())));
            Arc::make_mut(sums).join(&next);
            has_grown = true;
        }
        self.sums[at] = sums;
        let sums = self.sums[at].clone().filter(|_| has_grown)?;
        let error = sums.error(tone)[0];
        self.errors.resize(self.tiles.len(), f32::INFINITY);
        self.errors[at] = error;
        self.round.is_news = true;
        Some(sums)
    }

    /// How far the view is refined; `None` before that has begun.
    pub fn progress(&self) -> Option<RefinementProgress> {
        let known = || self.errors.iter().filter(|error| error.is_finite());
        self.has_begun().then(|| RefinementProgress {
            tiles: self.tiles.len() as u32,
            quiet: known().filter(|error| **error < self.rules.noise).count() as u32,
            error: known().copied().reduce(f32::max),
            stated: self.stated,
        })
    }

    /// For a snapshot.
    pub fn under_way(&self) -> UnderWay {
        let Self { rules: _, tiles: _, sums, begun, early, errors: _, open, round, lost, stated, traced } =
            self;
        let mut open: Vec<_> = open.iter().map(|&(error, Reverse(tile))| (error, tile)).collect();
        open.sort_unstable();
        UnderWay {
            sums: sums.clone(),
            begun: begun.clone(),
            early: early.clone(),
            open,
            round: *round,
            lost: lost.clone(),
            stated: *stated,
            traced: traced.clone(),
        }
    }

    /// Takes a snapshot up again; `None` if it is one of another picture.
    pub fn restore(&mut self, under_way: UnderWay) -> Option<()> {
        let UnderWay { sums, begun, early, open, round, lost, stated, traced } = under_way;
        let whole = sums.is_empty() || sums.len() == self.tiles.len();
        let fits = |(at, sums): (usize, &Arc<TileSums>)| sums.tile as usize == at && sums.fits(&self.tiles);
        let all_fit = sums.iter().enumerate().all(|(at, sums)| sums.as_ref().is_none_or(|s| fits((at, s))));
        let early_fit = early
            .iter()
            .all(|(key, block)| *key == (block.tile, block.first) && block.fits_as_block(&self.tiles));
        if traced.as_ref().is_some_and(|traced| !traced.fits(self.tiles.pixel_count())) {
            return None;
        }
        let indexed = |tile: u32| (tile as usize) < sums.len();
        let all_indexed = open.iter().all(|&(_, tile)| indexed(tile)) && early.keys().all(|k| indexed(k.0));
        let sound = whole && all_fit && early_fit && all_indexed && begun.len() == sums.len();
        if !sound || begun.iter().any(|begun| *begun >= SAMPLES_MAX) {
            return None;
        }
        (self.sums, self.begun, self.early) = (sums, begun, early);
        (self.round, self.lost, self.stated) = (round, lost, stated);
        self.traced = traced;
        self.errors.clear();
        self.open = open.into_iter().map(|(error, tile)| (error, Reverse(tile))).collect();
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Stream, hash};
    use crate::splatting::tile_sums::PixelSample;
    use glam::Vec3;

    const RULES: Supersampling = Supersampling { noise: 1e-4, max_samples: 70 };

    fn begun() -> Supersampler {
        let mut supersampler = Supersampler::new(RULES, 20, 10);
        supersampler.begin(None);
        supersampler
    }

    /// What a block comes to: noise, so that no tile is done before it has all samples.
    fn traced(block: Block) -> Arc<TileSums> {
        let pixels = Tiles::of_size(20, 10).rect(block.tile).area() as usize;
        let mut sums = TileSums::block(block.tile, pixels, block.first);
        for n in block.first..block.first + block.count {
            let mut stream = Stream::new(4, u64::from(block.tile), u64::from(n));
            let mut sample = || {
                let lobes = Vec3::splat(stream.next_f32());
                PixelSample { parts: [lobes, Vec3::ZERO, Vec3::ZERO], ..PixelSample::default() }
            };
            sums.add(&(0..pixels).map(|_| sample()).collect::<Vec<_>>());
        }
        Arc::new(sums)
    }

    /// Until nothing is wanted: `window` blocks are out at a time, and come back in an order by chance. What each tile has.
    fn refined(window: usize, seed: u64) -> Vec<TileSums> {
        let (tone, mut supersampler) = (ToneMap::default(), begun());
        let (mut out, mut drawn) = (Vec::new(), 0);
        loop {
            supersampler.end_round(&tone);
            while out.len() < window {
                let Some(block) = supersampler.next_block() else { break };
                out.push(block);
            }
            if out.is_empty() {
                break;
            }
            drawn += 1;
            let which = hash(seed, drawn, 0) as usize % out.len();
            supersampler.record(traced(out.swap_remove(which)), &tone);
        }
        supersampler.under_way().sums.iter().flatten().map(|sums| (**sums).clone()).collect()
    }

    #[test]
    fn whoever_is_first_the_sums_are_the_same() {
        let alone = refined(1, 0);
        assert!(alone.len() == 2 && alone.iter().all(|sums| sums.samples == 70), "{}", alone.len());
        for (window, seed) in [(3, 1), (8, 2), (8, 3), (100, 4)] {
            assert!(refined(window, seed) == alone, "{window} blocks out at a time");
        }
    }

    #[test]
    fn a_tile_that_lost_a_block_stays_as_it_is() {
        let (tone, mut supersampler) = (ToneMap::default(), begun());
        supersampler.end_round(&tone);
        let [lost, kept] = [(); 2].map(|()| supersampler.next_block().expect("two tiles"));
        assert!(lost.tile != kept.tile && [lost.first, kept.first, lost.count, kept.count] == [0, 0, 8, 8]);
        supersampler.lose(lost.tile);
        assert!(supersampler.record(traced(lost), &tone).is_none(), "it comes all the same");
        assert_eq!(supersampler.record(traced(kept), &tone).expect("more samples").samples, 8);
        while supersampler.end_round(&tone).is_some() || !supersampler.is_exhausted() {
            while let Some(block) = supersampler.next_block() {
                assert_eq!(block.tile, kept.tile);
                supersampler.record(traced(block), &tone);
            }
        }
        let sums = supersampler.under_way().sums;
        let samples = |tile: u32| sums[tile as usize].as_ref().map_or(0, |sums| sums.samples);
        assert_eq!([samples(lost.tile), samples(kept.tile)], [0, 70]);
    }

    /// What is taken up in the middle of a round, with blocks that wait for others, ends as what was not.
    #[test]
    fn a_snapshot_is_gone_on_from() {
        let (tone, mut supersampler) = (ToneMap::default(), begun());
        let all = |supersampler: &mut Supersampler| {
            supersampler.end_round(&tone);
            std::iter::from_fn(|| supersampler.next_block()).collect::<Vec<_>>()
        };
        for _ in 0..3 {
            for block in all(&mut supersampler) {
                supersampler.record(traced(block), &tone);
            }
        }
        // From 32 to 64: two blocks of each tile.
        let blocks = all(&mut supersampler);
        assert_eq!(blocks.len(), 4);
        let late = *blocks.iter().min_by_key(|block| block.first).expect("a block");
        for block in blocks.iter().filter(|block| **block != late) {
            supersampler.record(traced(*block), &tone);
        }
        let mut again = Supersampler::new(RULES, 20, 10);
        let under_way = supersampler.under_way();
        assert_eq!(under_way.early.len(), 1);
        let mut of_another = under_way.clone();
        of_another.begun[0] = u32::MAX;
        assert!(again.restore(of_another).is_none() && again.restore(under_way).is_some());
        for supersampler in [&mut supersampler, &mut again] {
            assert_eq!(supersampler.record(traced(late), &tone).expect("both blocks").samples, 64);
        }
        assert_eq!(supersampler.under_way().sums, again.under_way().sums);
    }
}
