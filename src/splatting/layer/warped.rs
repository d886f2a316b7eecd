//! Samples of former views as they reach the layer: of many a view most of what is splatted (Haber 2001 §4.3; REFERENCE §11).

use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use super::{Footprint, OWN, Paint, Shown, SplatLayer, place_of, rank};
use crate::image::Map2d;
use crate::splatting::WarpedSample;

/// Rows that warped samples are painted on at a time.
const BAND: usize = 16;
/// Fewer warped samples than these are painted by one.
const BANDED_FROM: usize = 256;
/// Warped samples that one thread sorts into bands at a time.
const PART: usize = 4096;

/// Pixels that samples may still be painted on where those of each object come with falling rank, a bit each: finer samples
/// have painted most of what a coarse one covers, and 64 such pixels are passed over at once.
struct OpenPixels {
    width: usize,
    /// Words of a row.
    across: usize,
    words: Vec<u64>,
}

impl OpenPixels {
    /// None.
    fn new(width: usize, height: usize) -> Self {
        let across = width.div_ceil(64);
        Self { width, across, words: vec![0; across * height] }
    }

    /// Those that `is_open` says, by their indices.
    fn open(&mut self, is_open: impl Fn(usize) -> bool) {
        for (y, row) in self.words.chunks_mut(self.across.max(1)).enumerate() {
            for (n, word) in row.iter_mut().enumerate() {
                let start = y * self.width + n * 64;
                let count = (self.width - n * 64).min(64);
                *word = (0..count).fold(0, |word, bit| word | u64::from(is_open(start + bit)) << bit);
            }
        }
    }

    /// Calls `visit` with the index of each open pixel among these columns of a row; those of which it says so stay open.
    #[inline]
    fn visit(&mut self, y: usize, columns: std::ops::Range<usize>, mut visit: impl FnMut(usize) -> bool) {
        if columns.is_empty() {
            return;
        }
        let row = &mut self.words[y * self.across..(y + 1) * self.across];
        let (first, last) = (columns.start / 64, (columns.end - 1) / 64);
        for (n, word) in row.iter_mut().enumerate().take(last + 1).skip(first) {
            let mut bits = *word;
            if n == first {
                bits &= u64::MAX << (columns.start % 64);
            }
            if n == last {
                bits &= u64::MAX >> (63 - (columns.end - 1) % 64);
            }
            while bits != 0 {
                let bit = bits.trailing_zeros() as usize;
                bits &= bits - 1;
                if !visit(y * self.width + n * 64 + bit) {
                    *word &= !(1 << bit);
                }
            }
        }
    }
}

impl SplatLayer {
    /// Splats warped samples onto pixels of their object at their depth, from the last, the finest, to the first, so
    /// that what would be painted over is not painted. Returns how many of them painted at least one pixel. Bands of rows
    /// are painted by whoever is free; what a pixel shows does not depend on them.
    ///
    /// A sample is rejected where no pixel of the 3 × 3 around it has its object at its depth
    /// (within 1 % or two pixel slopes, REFERENCE §11): it is hidden now.
    pub fn splat_warped(
        &mut self,
        samples: &[WarpedSample],
        objects: &Map2d<u32>,
        depths: &Map2d<f32>,
    ) -> usize {
        let (width, height) = (self.color.width(), self.color.height());
        if samples.is_empty() || width == 0 || height == 0 {
            return 0;
        }
        self.is_guided[0] |= samples.iter().any(|s| !s.guide.is_nan());
        let rows = if samples.len() < BANDED_FROM { height } else { BAND };
        let reach = reach(samples, (objects, depths), rows);
        let pixels = rows * width;
        let Self { color, rank, source, place, carried, is_guided: [is_guided, _], .. } = self;
        let mut carried = is_guided.then(|| carried.data_mut().chunks_mut(pixels));
        let maps = rank.data_mut().chunks_mut(pixels).zip(color.data_mut().chunks_mut(pixels));
        let maps = maps.zip(source.data_mut().chunks_mut(pixels)).zip(place.data_mut().chunks_mut(pixels));
        let bands: Vec<_> = maps
            .map(|(((ranks, colors), sources), places)| {
                let carried = carried.as_mut().and_then(Iterator::next);
                Paint { ranks, colors, sources, places, carried }
            })
            .zip(objects.data().chunks(pixels))
            .enumerate()
            .collect();
        let keeps_own = self.footprint == Footprint::Smooth;
        // Diffuse surfaces, most of many a picture, have no samples.
        let has_diffuse = samples.iter().any(|s| s.object == 0);
        let ids = objects.data().iter().max().map_or(0, |&id| id as usize + 1);
        let painted: Vec<AtomicBool> = samples.iter().map(|_| AtomicBool::new(false)).collect();
        bands.into_par_iter().for_each(|(number, (paint, objects))| {
            let band = Band { top: number * rows, width, objects, has_diffuse, ids, keeps_own };
            let reach = reach.iter().flat_map(|bands| &bands[number]).map(|&i| i as usize);
            band.splat_warped(paint, samples, reach, |i| painted[i].store(true, Ordering::Relaxed));
        });
        painted.into_iter().map(AtomicBool::into_inner).filter(|painted| *painted).count()
    }
}

/// The samples in sight that reach each band of so many rows, the last of all first: band by band for each of some parts of
/// the samples, which follow each other.
fn reach(
    samples: &[WarpedSample],
    (objects, depths): (&Map2d<u32>, &Map2d<f32>),
    rows: usize,
) -> Vec<Vec<Vec<u32>>> {
    let bands = objects.height().div_ceil(rows);
    // From the end: the first part is the one that holds the finest.
    let parts = samples.par_rchunks(PART).enumerate().map(|(part, some)| {
        let mut reach = vec![Vec::new(); bands];
        let start = samples.len() - part * PART - some.len();
        for (i, s) in some.iter().enumerate().rev().filter(|(_, s)| is_in_sight(s, objects, depths)) {
            let (y, r) = (usize::from(s.y), usize::from(s.half_side));
            let last = ((y + r) / rows).min(bands - 1);
            for band in &mut reach[y.saturating_sub(r) / rows..=last] {
                band.push((start + i) as u32);
            }
        }
        reach
    });
    parts.collect()
}

/// Whether a warped sample is not hidden.
#[inline]
fn is_in_sight(s: &WarpedSample, objects: &Map2d<u32>, depths: &Map2d<f32>) -> bool {
    let (width, height) = (objects.width() as i32, objects.height() as i32);
    let (ids, depths) = (objects.data(), depths.data());
    let (cx, cy) = (i32::from(s.x), i32::from(s.y));
    let matches = |x: i32, y: i32| {
        let i = (y * width + x) as usize;
        ids[i] == s.object && (depths[i] - s.depth).abs() <= s.depth_tolerance
    };
    matches(cx, cy)
        || (cy - 1..=cy + 1)
            .any(|y| (cx - 1..=cx + 1).any(|x| x >= 0 && y >= 0 && x < width && y < height && matches(x, y)))
}

/// Some rows of a layer, on which warped samples are painted.
struct Band<'a> {
    /// The first row.
    top: usize,
    width: usize,
    /// Object of each of its pixels.
    objects: &'a [u32],
    /// Whether any sample lies on a diffuse surface.
    has_diffuse: bool,
    /// One more than the last object in sight.
    ids: usize,
    /// Whether a sample is shown on its own pixel, whatever else is painted there.
    keeps_own: bool,
}

impl Band<'_> {
    /// Paints the samples of which `reach` has the indices, in that order; tells those that painted something.
    fn splat_warped(
        &self,
        mut paint: Paint<'_>,
        samples: &[WarpedSample],
        reach: impl Iterator<Item = usize>,
        tell: impl Fn(usize),
    ) {
        let (width, ids) = (self.width, self.objects);
        let bottom = self.top + ids.len() / width;
        let is_open = |i: usize| ids[i] != 0 || self.has_diffuse;
        let mut open = OpenPixels::new(width, bottom - self.top);
        open.open(is_open);
        // The rank of the last sample of each object in sight.
        let mut last = vec![u32::MAX; self.ids];
        for i in reach {
            let s = &samples[i];
            let (cx, cy, r) = (usize::from(s.x), usize::from(s.y), usize::from(s.half_side));
            let own = rank(u32::from(s.k), u32::from(s.age).max(1));
            let shown = Shown { color: s.color, source: 0, place: place_of(s.x, s.y), guide: s.guide };
            if own > std::mem::replace(&mut last[s.object as usize], own) {
                open.open(is_open);
            }
            let mut any = false;
            // Before the others, which it is above: most samples are small and reach no pixel but their own.
            if self.keeps_own && (self.top..bottom).contains(&cy) {
                let at = (cy - self.top) * width + cx;
                if cx < width && ids[at] == s.object && paint.ranks[at] < own | OWN {
                    paint.put(at, own | OWN, &shown);
                    any = true;
                }
            }
            if r > 0 || !self.keeps_own {
                let columns = cx.saturating_sub(r)..(cx + r + 1).min(width);
                for y in cy.saturating_sub(r).max(self.top)..(cy + r + 1).min(bottom) {
                    open.visit(y - self.top, columns.clone(), |i| {
                        if ids[i] != s.object {
                            return true;
                        }
                        if paint.ranks[i] < own {
                            paint.put(i, own, &shown);
                            any = true;
                        }
                        false
                    });
                }
            }
            if any {
                tell(i);
            }
        }
    }
}
