//! Which tile of a converged view is sampled next: the one with the largest error.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::sync::Arc;

use crate::display::tone::ToneMap;
use crate::splatting::supersampling::{SAMPLES_MAX, Supersampling, TileSums, Tiles};

/// Samples of each pixel in one order: a few milliseconds of a tile.
const SAMPLES_PER_ORDER: u32 = 4;
/// Samples before an error is believed: so few that a quiet wall costs little, so many that an edge is not missed by
/// all pixels of a tile.
const SAMPLES_MIN: u32 = 4;

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
}

/// Samples that a pixel may still get after `samples` later ones.
fn room(rules: &Supersampling, samples: u32) -> u32 {
    rules.max_samples.min(SAMPLES_MAX).saturating_sub(samples + 1)
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
}

impl Supersampler {
    /// For pictures of a size; nothing is open until a view has converged.
    pub fn new(rules: Supersampling, width: u32, height: u32) -> Self {
        Self {
            rules,
            tiles: Tiles::of_size(width, height),
            sums: Vec::new(),
            errors: Vec::new(),
            open: BinaryHeap::new(),
        }
    }

    /// Another view: what was there holds no more.
    pub fn forget(&mut self) {
        self.sums.clear();
        self.errors.clear();
        self.open.clear();
    }

    /// Other rules; tiles that were done go on where they are not any more.
    pub fn set_rules(&mut self, rules: Supersampling, tone: &ToneMap) {
        let before = std::mem::replace(&mut self.rules, rules);
        for (at, sums) in self.sums.iter().enumerate() {
            // What is open stays so, and what is ordered comes back.
            let was_done = is_done(&before, sums.as_deref(), tone);
            if was_done && !is_done(&rules, sums.as_deref(), tone) {
                let error = sums.as_ref().map_or(f32::INFINITY, |sums| sums.error(tone)[0]);
                self.open.push((error.to_bits(), Reverse(at as u32)));
            }
        }
        let sums = &self.sums;
        self.open.retain(|&(_, Reverse(tile))| {
            !is_done(&rules, sums.get(tile as usize).and_then(|s| s.as_deref()), tone)
        });
    }

    /// Whether a view is being refined or is refined.
    pub fn has_begun(&self) -> bool {
        !self.sums.is_empty()
    }

    /// Whether no tile is to be ordered. Those that were ordered may still be on their way.
    pub fn is_exhausted(&self) -> bool {
        self.open.is_empty()
    }

    /// The view has converged: all tiles are open.
    pub fn begin(&mut self) {
        self.forget();
        self.sums.resize(self.tiles.len(), None);
        if room(&self.rules, 0) > 0 {
            self.open
                .extend((0..self.tiles.len() as u32).map(|tile| (f32::INFINITY.to_bits(), Reverse(tile))));
        }
    }

    /// The order that helps most.
    pub fn next_order(&mut self) -> Option<TileOrder> {
        let (_, Reverse(tile)) = self.open.pop()?;
        let on = self.sums.get(tile as usize).cloned().flatten();
        let count = SAMPLES_PER_ORDER.min(room(&self.rules, on.as_ref().map_or(0, |on| on.samples)));
        Some(TileOrder { tile, on, count })
    }

    /// A tile has come back.
    pub fn record(&mut self, sums: Arc<TileSums>, tone: &ToneMap) {
        if let Some(slot) = self.sums.get_mut(sums.tile as usize) {
            *slot = Some(sums.clone());
            let error = sums.error(tone)[0];
            self.errors.resize(self.tiles.len(), f32::INFINITY);
            self.errors[sums.tile as usize] = error;
            if !is_done(&self.rules, Some(&sums), tone) {
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
        })
    }

    /// What the tiles have, for a snapshot.
    pub fn tiles(&self) -> &[Option<Arc<TileSums>>] {
        &self.sums
    }

    /// The open tiles, for a snapshot.
    pub fn open(&self) -> Vec<(u32, u32)> {
        let mut open: Vec<_> = self.open.iter().map(|&(error, Reverse(tile))| (error, tile)).collect();
        open.sort_unstable();
        open
    }

    /// Takes a snapshot up again; `None` if it is one of another picture.
    pub fn restore(&mut self, sums: Vec<Option<Arc<TileSums>>>, open: Vec<(u32, u32)>) -> Option<()> {
        let whole = sums.is_empty() || sums.len() == self.tiles.len();
        let fits = |(at, sums): (usize, &Arc<TileSums>)| sums.tile as usize == at && sums.fits(&self.tiles);
        let all_fit = sums.iter().enumerate().all(|(at, sums)| sums.as_ref().is_none_or(|s| fits((at, s))));
        if !whole || !all_fit || open.iter().any(|&(_, tile)| tile as usize >= sums.len()) {
            return None;
        }
        self.sums = sums;
        self.open = open.into_iter().map(|(error, tile)| (error, Reverse(tile))).collect();
        Some(())
    }
}
