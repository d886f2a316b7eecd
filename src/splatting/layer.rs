//! The splat layer: which sample each pixel shows (Haber 2001 §4.3; REFERENCE §3.5–3.6, §11).

mod warped;

use bytemuck::{cast_slice, cast_slice_mut};
use glam::Vec3;
use rayon::prelude::*;

use super::{Guides, SampleBatch};
use crate::image::Map2d;
use crate::sampling::Lattice;

/// The area a fresh sample paints until finer ones come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
pub enum Footprint {
    /// The exact tile of 5ᵏ pixels: no overlap, so no dependence on order.
    Tile,
    /// The square of side Lₖ: the paper's look.
    Square,
    /// The exact tile, and what is shown goes over linearly into the next samples ([`super::Reconstruction`]).
    Linear,
    /// The exact tile, and what is shown is mixed from all samples of a surface ([`super::pull_push`]).
    #[default]
    Smooth,
}

impl Footprint {
    /// Whether something else than samples is shown between them.
    pub fn interpolates(self) -> bool {
        matches!(self, Self::Linear | Self::Smooth)
    }
}

/// Colour and rank per pixel. A splat replaces what has a lower or equal rank.
///
/// Ranks, from low to high: old (warped) samples, the coarser below the finer, the older below the
/// newer; fresh samples, each rank worth `FRESH_BONUS` levels more than an old one of its level;
/// and above all a fresh sample on its own pixel, so that a converged view shows only those.
///
/// The paper paints every fresh splat over every old one, so a level-1 splat wipes thousands of
/// valid warped samples off the screen for some frames. Weighing age against size keeps them.
#[derive(Clone, Debug)]
pub struct SplatLayer {
    color: Map2d<Vec3>,
    rank: Map2d<u32>,
    /// Who traced the sample shown, as told to `splat_fresh`; 0 for warped ones.
    source: Map2d<u8>,
    /// The pixel that the sample shown lies on: column in the low half, row in the high one.
    place: Map2d<u32>,
    /// What the guide of the sample shown showed on its own pixel in its own view; not a number where it has none.
    carried: Map2d<Vec3>,
    /// What the pixel's own guide shows in this view; not a number where none was followed.
    guide: Map2d<Vec3>,
    /// Whether `carried` and `guide` hold any number: most scenes have no guides, and nothing is written there then.
    is_guided: [bool; 2],
    footprint: Footprint,
    /// What a fresh sample of each level set paints beside its own pixel: offsets in columns and rows.
    tiles: Vec<Vec<(i16, i16)>>,
}

/// A fresh sample paints over old ones up to this many levels finer.
const FRESH_BONUS: u32 = 1;
/// Rank of a first approximation, below all samples; 0 is nothing at all.
pub const APPROXIMATED: u32 = 1;
/// Rank of a fresh sample on its own pixel.
const EXACT: u32 = u32::MAX;
/// Part of the rank of a warped sample on its own pixel, where all samples of a surface are mixed: others' tiles do not hide
/// it there.
pub const OWN: u32 = 1 << 31;

/// Rank of a sample of level set `k`; `age` is 0 for fresh ones. A pixel's own ray ranks above all.
pub fn rank(k: u32, age: u32) -> u32 {
    let fineness = Lattice::K_LIMIT - k.min(Lattice::K_LIMIT) + if age == 0 { FRESH_BONUS } else { 0 };
    ((fineness + 1) << 16) + (0xffff - age.min(0xffff))
}

/// Level set and whether it is fresh, of the sample that has a rank; `None` where that is none.
#[inline]
pub(super) fn level_of(rank: u32) -> Option<(u32, bool)> {
    match rank {
        0 | APPROXIMATED => None,
        EXACT => Some((0, true)),
        _ => {
            let fresh = rank & 0xffff == 0xffff;
            let fineness = ((rank & !OWN) >> 16) - 1 - if fresh { FRESH_BONUS } else { 0 };
            Some((Lattice::K_LIMIT - fineness, fresh))
        }
    }
}

fn place_of(x: u16, y: u16) -> u32 {
    u32::from(x) | (u32::from(y) << 16)
}

/// What a pixel keeps of the sample that it shows, see the maps of [`SplatLayer`].
struct Shown {
    color: Vec3,
    source: u8,
    place: u32,
    guide: Vec3,
}

/// The maps of a layer while splats are painted.
struct Paint<'a> {
    ranks: &'a mut [u32],
    colors: &'a mut [Vec3],
    sources: &'a mut [u8],
    places: &'a mut [u32],
    /// Where the layer has guides.
    carried: Option<&'a mut [Vec3]>,
}

impl<'a> Paint<'a> {
    fn on(
        ranks: &'a mut Map2d<u32>,
        colors: &'a mut Map2d<Vec3>,
        sources: &'a mut Map2d<u8>,
        places: &'a mut Map2d<u32>,
        carried: Option<&'a mut Map2d<Vec3>>,
    ) -> Self {
        Self {
            ranks: ranks.data_mut(),
            colors: colors.data_mut(),
            sources: sources.data_mut(),
            places: places.data_mut(),
            carried: carried.map(Map2d::data_mut),
        }
    }

    #[inline]
    fn put(&mut self, i: usize, rank: u32, shown: &Shown) {
        self.ranks[i] = rank;
        self.colors[i] = shown.color;
        self.sources[i] = shown.source;
        self.places[i] = shown.place;
        if let Some(carried) = &mut self.carried {
            carried[i] = shown.guide;
        }
    }
}

impl SplatLayer {
    /// An empty layer for pictures of `width × height` and level sets up to `k_max`.
    pub fn new(width: usize, height: usize, k_max: u32, footprint: Footprint) -> Self {
        let tile = |k| match footprint {
            Footprint::Tile | Footprint::Linear | Footprint::Smooth => Lattice::tile(k),
            Footprint::Square => {
                let r = (Lattice::square_side(k) / 2) as i16;
                (-r..=r).flat_map(|y| (-r..=r).map(move |x| (x, y))).collect()
            }
        };
        let around = |k| tile(k).into_iter().filter(|&offset| offset != (0, 0)).collect();
        let tiles = (0..=k_max).map(around).collect();
        Self {
            color: Map2d::new(width, height, Vec3::ZERO),
            rank: Map2d::new(width, height, 0),
            source: Map2d::new(width, height, 0),
            place: Map2d::new(width, height, 0),
            carried: Map2d::new(width, height, Vec3::NAN),
            guide: Map2d::new(width, height, Vec3::NAN),
            is_guided: [false; 2],
            footprint,
            tiles,
        }
    }

    /// Everything that splats left: colours, ranks, sources and places.
    pub fn maps(&self) -> (&Map2d<Vec3>, &Map2d<u32>, &Map2d<u8>, &Map2d<u32>) {
        (&self.color, &self.rank, &self.source, &self.place)
    }

    /// Whether any sample shown carries a guide's look, and any pixel has a guide of its own.
    pub fn is_guided(&self) -> [bool; 2] {
        self.is_guided
    }

    /// All of that as it lies in memory, map by map; guides where there are any.
    pub fn columns(&self) -> Vec<&[u8]> {
        let Self { color, rank, source, place, carried, guide, is_guided, .. } = self;
        let guides = [carried, guide].into_iter().zip(is_guided).filter(|(_, is_there)| **is_there);
        let maps =
            [cast_slice(color.data()), cast_slice(rank.data()), source.data(), cast_slice(place.data())];
        maps.into_iter().chain(guides.map(|(map, _)| cast_slice(map.data()))).collect()
    }

    /// Where what [`SplatLayer::columns`] gave is put back, of a layer with these guides.
    pub fn columns_mut(&mut self, is_guided: [bool; 2]) -> Vec<&mut [u8]> {
        self.forget_guides();
        self.is_guided = is_guided;
        let Self { color, rank, source, place, carried, guide, .. } = self;
        let guides = [carried, guide].into_iter().zip(is_guided).filter(|(_, is_there)| *is_there);
        let (color, rank) = (cast_slice_mut(color.data_mut()), cast_slice_mut(rank.data_mut()));
        let maps = [color, rank, source.data_mut(), cast_slice_mut(place.data_mut())];
        maps.into_iter().chain(guides.map(|(map, _)| cast_slice_mut(map.data_mut()))).collect()
    }

    /// What fresh samples paint, and what lies between them.
    pub fn footprint(&self) -> Footprint {
        self.footprint
    }

    /// Forgets all splats.
    pub fn clear(&mut self) {
        self.rank.data_mut().fill(0);
        self.color.data_mut().fill(Vec3::ZERO);
        self.source.data_mut().fill(0);
        self.forget_guides();
    }

    fn forget_guides(&mut self) {
        for (guides, is_guided) in [&mut self.carried, &mut self.guide].into_iter().zip(&mut self.is_guided) {
            if std::mem::take(is_guided) {
                guides.data_mut().fill(Vec3::NAN);
            }
        }
    }

    /// Forgets all splats. Until others come, pixels show what `first` fills in: a first approximation of the
    /// view-dependent radiance.
    pub fn restart(&mut self, first: impl FnOnce(&mut Map2d<Vec3>)) {
        self.rank.data_mut().fill(0);
        self.source.data_mut().fill(0);
        self.forget_guides();
        first(&mut self.color);
    }

    /// Gives pixels on which nothing lies a first approximation of their view-dependent radiance, which stays until a
    /// splat comes: for a picture that must be shown now. Returns how many pixels that were.
    pub fn approximate(&mut self, first: impl Fn(usize, usize) -> Vec3 + Sync) -> usize {
        let width = self.color.width().max(1);
        let rows =
            self.color.data_mut().par_chunks_mut(width).zip(self.rank.data_mut().par_chunks_mut(width));
        rows.enumerate()
            .map(|(y, (colors, ranks))| {
                let bare = colors.iter_mut().zip(ranks).enumerate().filter(|(_, (_, rank))| **rank == 0);
                bare.map(|(x, (color, rank))| (*color, *rank) = (first(x, y), APPROXIMATED)).count()
            })
            .sum()
    }

    /// The first approximations of these pixels are no longer the best: they are made anew when next shown.
    pub fn disapprove(&mut self, of: impl Fn(usize, usize) -> bool + Sync) {
        let width = self.color.width().max(1);
        self.rank.data_mut().par_chunks_mut(width).enumerate().for_each(|(y, ranks)| {
            for (x, rank) in ranks.iter_mut().enumerate().filter(|(_, rank)| **rank == APPROXIMATED) {
                if of(x, y) {
                    *rank = 0;
                }
            }
        });
    }

    /// View-dependent radiance of a pixel: the first approximation where no splat lies, zero without one.
    #[inline]
    pub fn color(&self, x: usize, y: usize) -> Vec3 {
        self.color.at(x, y)
    }

    /// All colours.
    pub fn colors(&self) -> &Map2d<Vec3> {
        &self.color
    }

    /// Whether a splat lies on the pixel.
    #[inline]
    pub fn is_covered(&self, x: usize, y: usize) -> bool {
        self.rank.at(x, y) > APPROXIMATED
    }

    /// Who traced the sample that the pixel shows: the `source` of `splat_fresh`, 0 for a warped one.
    #[inline]
    pub fn source(&self, x: usize, y: usize) -> u8 {
        self.source.at(x, y)
    }

    /// Whether neither a splat nor a first approximation lies on the pixel.
    #[inline]
    pub fn is_bare(&self, x: usize, y: usize) -> bool {
        self.rank.at(x, y) == 0
    }

    /// Level set shown at the pixel, and whether it is fresh; `None` without splat.
    pub fn shown_level(&self, x: usize, y: usize) -> Option<(u32, bool)> {
        level_of(self.rank.at(x, y))
    }

    /// Views since the shown sample was traced, 0 for this view; `None` without splat.
    pub fn shown_age(&self, x: usize, y: usize) -> Option<u32> {
        match self.rank.at(x, y) {
            0 | APPROXIMATED => None,
            EXACT => Some(0),
            r => Some(0xffff - (r & 0xffff)),
        }
    }

    /// Takes what guides show in this view.
    pub fn guide(&mut self, guides: &Guides) {
        let width = self.guide.width();
        for ([x, y], guide) in guides.iter() {
            self.is_guided[1] = true;
            if let Some(of) = self.guide.data_mut().get_mut(usize::from(y) * width + usize::from(x)) {
                *of = guide;
            }
        }
    }

    /// What a pixel's guide shows, where one was followed.
    pub fn guide_at(&self, x: usize, y: usize) -> Option<Vec3> {
        Some(self.guide.at(x, y)).filter(|guide| !guide.is_nan())
    }

    /// What the guides of the samples shown showed, and what the pixels' own show; not numbers where there are none.
    pub fn guides(&self) -> [&Map2d<Vec3>; 2] {
        [&self.carried, &self.guide]
    }

    /// Splats fresh samples onto the pixels of their object. Returns the sum over the samples of
    /// |new − shown before| on their own pixels, the first approximation where no splat was: the residual of
    /// REFERENCE §13.1 in radiance, and the number of such pixels.
    pub fn splat_fresh(&mut self, batch: &SampleBatch, objects: &Map2d<u32>, source: u8) -> (f32, u32) {
        let (width, height) = (self.color.width() as i32, self.color.height() as i32);
        let own = rank(batch.k, 0);
        let ids = objects.data();
        self.is_guided[0] |= !batch.guides.is_empty();
        let Self { color, rank, source: by, place, carried, is_guided: [is_guided, _], tiles, .. } = self;
        let around = &tiles[(batch.k as usize).min(tiles.len() - 1)];
        let mut paint = Paint::on(rank, color, by, place, is_guided.then_some(carried));
        let (mut residual, mut compared) = (0.0, 0);
        for (sample, (&[x, y], &color)) in batch.pixels.iter().zip(&batch.colors).enumerate() {
            let (px, py) = (i32::from(x), i32::from(y));
            let shown = Shown { color, source, place: place_of(x, y), guide: batch.guide(sample) };
            let at = (py * width + px) as usize;
            if px < width && py < height && ids[at] == batch.object {
                residual += (color - paint.colors[at]).abs().element_sum();
                compared += 1;
                paint.put(at, EXACT, &shown);
            }
            for &(dx, dy) in around {
                let (x, y) = (px + i32::from(dx), py + i32::from(dy));
                if x < 0 || y < 0 || x >= width || y >= height {
                    continue;
                }
                let i = (y * width + x) as usize;
                if ids[i] == batch.object && paint.ranks[i] <= own {
                    paint.put(i, own, &shown);
                }
            }
        }
        (residual, compared)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng;
    use crate::sampling::Rect;
    use crate::splatting::{Sample, WarpedSample};

    fn fresh(lattice: &Lattice, level: u32, rect: Rect, ids: &Map2d<u32>) -> SampleBatch {
        let mut batch = SampleBatch::new(1, 1, lattice.k_of(level), 0);
        for (x, y) in lattice.all_samples(level, rect).filter(|&(x, y)| ids.at(x as usize, y as usize) == 1) {
            batch.push(Sample {
                pixel: [x as u16, y as u16],
                position: Vec3::ZERO,
                normal: Vec3::Z,
                view: Vec3::Z,
                color: Vec3::new(x as f32, y as f32, 1.0),
                pixel_width: 1.0,
            });
        }
        batch
    }

    /// Whatever order the levels and batches come in, the converged layer is each pixel's own sample,
    /// and nothing lies outside the object.
    #[test]
    fn converged_layer_is_every_pixels_own_sample_in_any_order() {
        let (w, h) = (70, 53);
        let lattice = Lattice::new(4, [35, 26]);
        let ids =
            Map2d::from_fn(w, h, |x, y| u32::from((x as i32 - 30).pow(2) + (y as i32 - 25).pow(2) < 400));
        for footprint in [Footprint::Tile, Footprint::Square, Footprint::Smooth] {
            for seed in 0..6 {
                let mut layer = SplatLayer::new(w, h, 4, footprint);
                let mut levels: Vec<u32> = (1..=5).collect();
                levels.sort_by_key(|&l| rng::hash(seed, u64::from(l), 0));
                for l in levels {
                    layer.splat_fresh(&fresh(&lattice, l, Rect::of_size(w as u32, h as u32), &ids), &ids, 1);
                }
                for y in 0..h {
                    for x in 0..w {
                        if ids.at(x, y) == 1 {
                            assert!(layer.rank.at(x, y) == EXACT);
                            assert_eq!(layer.color(x, y), Vec3::new(x as f32, y as f32, 1.0));
                        } else {
                            assert!(!layer.is_covered(x, y));
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn each_level_alone_covers_a_full_screen_object_with_tiles() {
        let lattice = Lattice::new(3, [0, 0]);
        let (w, h) = (80, 60);
        let ids = Map2d::new(w, h, 1);
        let mut layer = SplatLayer::new(w, h, 3, Footprint::Tile);
        layer.splat_fresh(&fresh(&lattice, 1, Rect::of_size(w as u32, h as u32), &ids), &ids, 1);
        // Away from the rim: tiles of samples outside the picture are not traced.
        let r = Lattice::square_side(3) as usize / 2;
        for y in r..h - r {
            for x in r..w - r {
                assert_eq!(
                    layer.shown_level(x, y).map(|s| s.0),
                    Some(if layer.rank.at(x, y) == EXACT { 0 } else { 3 })
                );
            }
        }
    }

    #[test]
    fn only_bare_pixels_are_approximated_and_only_once() {
        let lattice = Lattice::new(2, [0, 0]);
        let ids = Map2d::new(20, 10, 1);
        let mut layer = SplatLayer::new(20, 10, 2, Footprint::Tile);
        let left = Rect { x0: 0, y0: 0, x1: 10, y1: 10 };
        layer.splat_fresh(&fresh(&lattice, 1, left, &ids), &ids, 1);
        let covered = (0..200).filter(|i| layer.is_covered(i % 20, i / 20)).count();
        assert!(covered > 60);
        let asked = std::sync::atomic::AtomicUsize::new(0);
        let first = |_: usize, _: usize| {
            asked.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            Vec3::splat(0.5)
        };
        assert_eq!(layer.approximate(first), 200 - covered);
        assert_eq!(layer.approximate(first), 0, "they stay");
        assert_eq!(asked.load(std::sync::atomic::Ordering::Relaxed), 200 - covered);
        assert!(!layer.is_covered(19, 9) && !layer.is_bare(19, 9) && layer.shown_level(19, 9).is_none());
        assert_eq!((layer.color(19, 9), layer.shown_age(19, 9)), (Vec3::splat(0.5), None));
        layer.disapprove(|x, _| x == 19);
        assert!(layer.is_bare(19, 9) && !layer.is_bare(18, 9));
        assert_eq!(layer.approximate(first), 10);
        // Any splat lies above.
        layer.splat_fresh(&fresh(&lattice, 1, Rect::of_size(20, 10), &ids), &ids, 1);
        assert!((10..18).all(|x| layer.is_covered(x, 5)));
    }

    #[test]
    fn hidden_warped_samples_paint_nothing() {
        let ids = Map2d::new(9, 9, 1);
        let depths = Map2d::new(9, 9, 1.0);
        let mut layer = SplatLayer::new(9, 9, 2, Footprint::Tile);
        let mut s = WarpedSample {
            x: 4,
            y: 4,
            depth: 2.0,
            depth_tolerance: 0.02,
            color: Vec3::ONE,
            guide: Vec3::NAN,
            object: 1,
            age: 1,
            half_side: 1,
            k: 1,
        };
        assert_eq!(layer.splat_warped(&[s], &ids, &depths), 0);
        s.depth = 1.01;
        assert_eq!(layer.splat_warped(&[s], &ids, &depths), 1);
        assert_eq!(
            (0..9).flat_map(|y| (0..9).map(move |x| (x, y))).filter(|p| layer.is_covered(p.0, p.1)).count(),
            9
        );
        assert_eq!(layer.shown_level(4, 4), Some((1, false)));
    }

    /// Each pixel shows the last of the finest, newest samples that reach it, whatever order they come in, and
    /// samples that none of it shows are not counted.
    #[test]
    fn warped_samples_show_by_rank() {
        let (w, h) = (40, 30);
        let ids = Map2d::new(w, h, 1);
        let depths = Map2d::new(w, h, 1.0);
        let random = |i: u64, n: u64| rng::hash(1, i, n);
        let samples: Vec<WarpedSample> = (0..300)
            .map(|i| WarpedSample {
                x: (random(i, 0) % w as u64) as u16,
                y: (random(i, 1) % h as u64) as u16,
                depth: 1.0,
                depth_tolerance: 0.1,
                color: Vec3::splat(i as f32),
                guide: Vec3::NAN,
                object: 1,
                age: 1 + (random(i, 2) % 3) as u16,
                half_side: (random(i, 3) % 4) as u8,
                k: (random(i, 3) % 4) as u8,
            })
            .collect();
        let mut layer = SplatLayer::new(w, h, 3, Footprint::Tile);
        let counted = layer.splat_warped(&samples, &ids, &depths);
        let mut shown = std::collections::BTreeSet::new();
        for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
            let reaches = |s: &&WarpedSample| {
                let r = usize::from(s.half_side);
                usize::from(s.x).abs_diff(x) <= r && usize::from(s.y).abs_diff(y) <= r
            };
            let best = samples.iter().filter(reaches).max_by_key(|s| rank(u32::from(s.k), u32::from(s.age)));
            assert_eq!(layer.is_covered(x, y), best.is_some());
            if let Some(best) = best {
                assert_eq!(layer.color(x, y), best.color);
                shown.insert(best.color.x as u32);
            }
        }
        assert!(shown.len() <= counted && counted < samples.len(), "{} {counted}", shown.len());
    }

    /// Each pixel shows the highest in rank of those that cover it, the last of equals, and a sample counts once. Where all
    /// are mixed, one on its own pixel is above the others.
    #[test]
    fn warped_squares_are_painted_as_if_one_after_the_other() {
        let (w, h) = (131, 53);
        let objects = Map2d::from_fn(w, h, |x, y| u32::from((x / 9 + y / 13) % 3 == 0));
        let depths = Map2d::from_fn(w, h, |x, y| 2.0 + (x + y) as f32 * 0.01);
        let random = |i: u64, what: u64, below: usize| (rng::hash(7, i, what) % below as u64) as usize;
        let samples: Vec<WarpedSample> = (0..10_000)
            .map(|i| {
                let (x, y) = (random(i, 0, w), random(i, 1, h));
                WarpedSample {
                    x: x as u16,
                    y: y as u16,
                    // Some are hidden.
                    depth: depths.at(x, y) + if random(i, 2, 5) == 0 { 1.0 } else { 0.0 },
                    depth_tolerance: 0.05,
                    color: Vec3::splat(i as f32),
                    guide: if i % 7 == 0 { Vec3::splat(-(i as f32)) } else { Vec3::NAN },
                    object: random(i, 3, 2) as u32,
                    age: 1 + random(i, 4, 3) as u16,
                    half_side: [0, 1, 3, 40][random(i, 5, 4)],
                    k: random(i, 6, 4) as u8,
                }
            })
            .collect();
        let mut in_order = samples.clone();
        in_order.sort_by_key(rank_of);
        for (samples, is_in_order) in [(samples, false), (in_order, true)] {
            let (painted, shown) = painted_and_shown(&samples, &objects, &depths, Footprint::Smooth);
            assert!(painted >= shown && painted < samples.len(), "{painted} {shown}");
            let apart = shown;
            let (painted, shown) = painted_and_shown(&samples, &objects, &depths, Footprint::Linear);
            assert!(apart > 2 * shown, "each keeps its pixel: {apart} {shown}");
            // Those painted over later by finer ones have painted, too; but the finest come first.
            assert!(painted >= shown && painted < samples.len() && shown > 10, "{painted} {shown}");
            assert!(!is_in_order || painted == shown, "{painted} {shown}");
        }
    }

    fn rank_of(s: &WarpedSample) -> u32 {
        rank(u32::from(s.k), u32::from(s.age))
    }

    /// How many samples painted, and how many are shown, having looked at each pixel.
    fn painted_and_shown(
        samples: &[WarpedSample],
        objects: &Map2d<u32>,
        depths: &Map2d<f32>,
        footprint: Footprint,
    ) -> (usize, usize) {
        let (w, h) = (objects.width(), objects.height());
        let mut layer = SplatLayer::new(w, h, 4, footprint);
        let painted = layer.splat_warped(samples, objects, depths);
        let shows = |s: &WarpedSample| {
            let around =
                |at: u16, end: usize| usize::from(at).saturating_sub(1)..(usize::from(at) + 2).min(end);
            let is_there =
                |x, y| objects.at(x, y) == s.object && (depths.at(x, y) - s.depth).abs() <= s.depth_tolerance;
            around(s.y, h).any(|y| around(s.x, w).any(|x| is_there(x, y)))
        };
        let seen: Vec<bool> = samples.iter().map(shows).collect();
        assert!(seen.iter().any(|seen| !seen));
        let mut shown = std::collections::BTreeSet::new();
        for (x, y) in (0..w * h).map(|i| (i % w, i / w)) {
            let covers = |s: &WarpedSample| {
                let r = usize::from(s.half_side);
                s.object == objects.at(x, y)
                    && x.abs_diff(usize::from(s.x)) <= r
                    && y.abs_diff(usize::from(s.y)) <= r
            };
            let all = samples.iter().enumerate().filter(|&(i, s)| seen[i] && covers(s));
            let is_own = |s: &WarpedSample| {
                footprint == Footprint::Smooth && (usize::from(s.x), usize::from(s.y)) == (x, y)
            };
            let here = |s: &WarpedSample| rank_of(s) | if is_own(s) { OWN } else { 0 };
            let best = all.max_by_key(|&(i, s)| (here(s), i));
            let (_, ranks, _, places) = layer.maps();
            let Some((i, s)) = best else {
                assert!(layer.is_bare(x, y));
                continue;
            };
            shown.insert(i);
            assert_eq!((layer.color(x, y), ranks.at(x, y)), (s.color, here(s)), "{x}, {y}");
            assert_eq!(layer.shown_level(x, y), Some((u32::from(s.k), false)));
            assert_eq!(layer.shown_age(x, y), Some(u32::from(s.age)));
            assert_eq!(places.at(x, y), place_of(s.x, s.y));
            assert_eq!(layer.guides()[0].at(x, y).is_nan(), s.guide.is_nan());
        }
        assert!(painted <= seen.iter().filter(|seen| **seen).count(), "{painted}");
        (painted, shown.len())
    }
}
