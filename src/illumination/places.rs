//! Where the first estimate of light gathers: places that speak for the sites around them.
//!
//! What the start view shows has places of its own or, in dense meshes, of narrow cells; all else shares what is left of them, in
//! cells that are as wide as that takes.

use glam::Vec3;
use rayon::prelude::*;
use rustc_hash::{FxHashMap, FxHashSet};

use super::sites::{NONE, Site, Sites, floor};
use crate::rng::hash;

/// As many sites as this have a place each.
const FEW: usize = 32 * 1024;
/// Places that more than these share, at most.
const PLACES: usize = 16 * 1024;
/// As many times as wide is what a place stands for that the start view does not show.
const COARSER: f32 = 2.0;
/// As many sites as this that the start view shows speak for themselves each.
const OWN: usize = 8 * 1024;
/// A share of [`PLACES`] that is enough, and how often smaller cells are tried for it.
const FULL: f32 = 0.75;
const TRIES: u32 = 4;
/// By so much cells become wider at first where there are too many.
const WIDER: f32 = 1.2;
/// Sites whose sizes are summed at once.
const SUMMED: usize = 4096;
/// As far as this a place speaks for others, widths: to the far corner of its cell and beyond.
const REACH: f32 = 1.5;
/// A place itself, those to its four sides, and those between.
const AROUND: usize = 9;

/// Sites that speak for others; all speak for themselves where they are few.
pub(super) struct Places {
    pub sites: Sites,
    /// Per place whether the start view shows it.
    pub ahead: Vec<bool>,
    /// How others are spoken for, where not each is by itself.
    shared: Option<Shared>,
}

/// Who speaks for whom.
struct Shared {
    /// Per site of the scene, the place of its cell.
    of: Vec<u32>,
    /// Per place those around it, itself first, or [`NONE`]: none where it has its cell for itself.
    around: Vec<[u32; AROUND]>,
}

impl Places {
    /// A place for each of few sites; else at most [`PLACES`], one of each cell of space and direction, cells as small as that
    /// allows. `ahead`: per site whether the start view shows it; others have wider cells.
    pub fn among(all: &[Site], ahead: &[bool]) -> Self {
        if all.len() <= FEW {
            return Self { sites: Sites::of(all.to_vec()), ahead: ahead.to_vec(), shared: None };
        }
        let mut size = first_size(all, ahead);
        let mut wider = WIDER;
        let mut cells = loop {
            match Cells::of(all, ahead, size) {
                Some(cells) => break cells,
                // More and more so: sites without size say nothing of how far apart they are.
                None => (size, wider) = (size * wider, wider * WIDER),
            }
        };
        // Surfaces that pass through few cells, or through many, have others than their area tells.
        for _ in 0..TRIES {
            let share = cells.chosen.len() as f32 / PLACES as f32;
            if share > FULL {
                break;
            }
            let smaller = size * (share / FULL).sqrt().max(0.5);
            let Some(more) = Cells::of(all, ahead, smaller) else { break };
            (cells, size) = (more, smaller);
        }
        let Cells { chosen, count, of, ahead } = cells;
        let place = |(&i, &count): (&u32, &u32)| {
            let site = all[i as usize];
            match count {
                1 => site,
                _ => Site { width: site.width.max(width_of_cell(size, ahead[i as usize])), ..site },
            }
        };
        let sites = Sites::of(chosen.iter().zip(&count).map(place).collect());
        let around = |(i, &count): (u32, &u32)| if count == 1 { [NONE; AROUND] } else { around(&sites, i) };
        let around = (0..count.len() as u32).into_par_iter().zip(&count).map(around).collect();
        let ahead = chosen.iter().map(|i| ahead[*i as usize]).collect();
        Self { sites, ahead, shared: Some(Shared { of, around }) }
    }

    /// What light at these places is light at a site of the scene, by number; `None` where nothing is known.
    pub fn light_of(&self, i: usize, site: &Site, light: &impl Fn(usize) -> Option<Vec3>) -> Option<Vec3> {
        let Some(Shared { of, around }) = &self.shared else { return light(i) };
        let own = of[i] as usize;
        let places = self.sites.all();
        let reach = REACH * places[own].width;
        // Where cells meet their values are mixed, the nearer the more.
        let (mut sum, mut whole) = (Vec3::ZERO, 0.0);
        for &place in around[own].iter().filter(|place| **place != NONE) {
            let weight = 1.0 - places[place as usize].position.distance(site.position) / reach;
            if weight > 0.0
                && let Some(found) = light(place as usize)
            {
                (sum, whole) = (sum + weight * found, whole + weight);
            }
        }
        if whole > 0.0 { Some(sum / whole) } else { light(own) }
    }
}

/// A place, those beside it, and those between, which may lie beyond either of two.
fn around(sites: &Sites, place: u32) -> [u32; AROUND] {
    let [right, left, up, down] = sites.links_of(place);
    let hop = |from: u32, way: usize| if from == NONE { NONE } else { sites.links_of(from)[way] };
    let between = |a: u32, way_b: usize, b: u32, way_a: usize| match hop(a, way_b) {
        NONE => hop(b, way_a),
        found => found,
    };
    [
        place,
        right,
        left,
        up,
        down,
        between(right, 2, up, 0),
        between(right, 3, down, 0),
        between(left, 2, up, 1),
        between(left, 3, down, 1),
    ]
}

/// Width of the cell of a site, where those that the start view shows have cells of this size.
fn width_of_cell(size: f32, ahead: bool) -> f32 {
    if ahead { size } else { COARSER * size }
}

/// The size of cells of which there are about three quarters of [`PLACES`], by the area that sites stand for.
fn first_size(all: &[Site], ahead: &[bool]) -> f32 {
    let widest = all.iter().map(|s| s.width).fold(f32::MIN_POSITIVE, f32::max);
    let shown = ahead.iter().filter(|ahead| **ahead).count();
    let count = |size: f32| {
        let of = |(site, &ahead): (&Site, &bool)| match ahead && shown <= OWN {
            true => 1.0,
            false => (site.width / width_of_cell(size, ahead)).min(1.0).powi(2),
        };
        let some = |(all, ahead): (&[Site], &[bool])| all.iter().zip(ahead).map(of).sum::<f32>();
        let sums: Vec<f32> = all.par_chunks(SUMMED).zip(ahead.par_chunks(SUMMED)).map(some).collect();
        sums.into_iter().sum::<f32>()
    };
    let (mut low, mut high) = (1e-3 * widest, 1e3 * widest);
    for _ in 0..10 {
        let middle = (low * high).sqrt();
        *(if count(middle) > FULL * PLACES as f32 { &mut low } else { &mut high }) = middle;
    }
    high
}

/// Sites by cells and by six directions.
struct Cells {
    /// The first site of each.
    chosen: Vec<u32>,
    /// How many sites each has.
    count: Vec<u32>,
    /// Which of these is the one of each site.
    of: Vec<u32>,
    /// Per site whether the start view shows it or what is beside it in a wide cell: looks may be fewer than sites.
    ahead: Vec<bool>,
}

/// Tells the cell of a site of others, where cells are so wide.
fn key(site: &Site, width: f32, ahead: bool) -> u64 {
    let [x, y, z] = (site.position / width).to_array().map(|v| u64::from(floor(v) as u32));
    let axis = site.normal.abs().max_position();
    let towards = 2 * axis + usize::from(site.normal[axis] < 0.0);
    hash(x | y << 32, z | (towards as u64) << 32, u64::from(ahead))
}

impl Cells {
    /// `None` where they are more than [`PLACES`].
    fn of(all: &[Site], ahead: &[bool], size: f32) -> Option<Self> {
        let wide = |site: &Site| key(site, width_of_cell(size, false), false);
        let shown: FxHashSet<u64> =
            all.iter().zip(ahead).filter(|(_, ahead)| **ahead).map(|(site, _)| wide(site)).collect();
        // What the start view shows and what it does not are in cells apart.
        let keys: Vec<(u64, bool)> = all
            .par_iter()
            .map(|site| match wide(site) {
                wide if !shown.contains(&wide) => (wide, false),
                _ => (key(site, width_of_cell(size, true), true), true),
            })
            .collect();
        let own = keys.iter().filter(|(_, ahead)| *ahead).count() <= OWN;
        let mut cells: FxHashMap<u64, u32> = FxHashMap::default();
        let (mut chosen, mut count, mut of) = (Vec::new(), Vec::new(), Vec::with_capacity(all.len()));
        for (i, &(key, ahead)) in keys.iter().enumerate() {
            let mut begin = || {
                chosen.push(i as u32);
                count.push(0);
                chosen.len() as u32 - 1
            };
            let cell = if ahead && own { begin() } else { *cells.entry(key).or_insert_with(begin) };
            count[cell as usize] += 1;
            of.push(cell);
            if chosen.len() > PLACES {
                return None;
            }
        }
        let ahead = keys.into_iter().map(|(_, ahead)| ahead).collect();
        Some(Self { chosen, count, of, ahead })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illumination::test_scenes::floor;

    #[test]
    fn few_sites_speak_for_themselves() {
        let all = floor(100);
        let places = Places::among(&all, &vec![false; all.len()]);
        assert_eq!(places.sites.all(), &all);
        let light = |i: usize| Some(Vec3::splat(i as f32));
        assert!(all.iter().enumerate().all(|(i, site)| places.light_of(i, site, &light) == light(i)));
    }

    /// Of many sites those that are shown stand for themselves, whoever else is there; a slope of light stays one, as steep as
    /// before, and what is not known anywhere is not known.
    #[test]
    fn what_is_shown_has_places_of_its_own() {
        let side = 400;
        let all = floor(side);
        let is_shown = |i: usize| (100..180).contains(&(i % side)) && (100..180).contains(&(i / side));
        let shown: Vec<bool> = (0..all.len()).map(is_shown).collect();
        let places = Places::among(&all, &shown);
        let sites = places.sites.all();
        assert!((PLACES / 2..=PLACES).contains(&sites.len()), "{}", sites.len());
        assert!(places.ahead.iter().filter(|ahead| **ahead).count() >= 80 * 80);
        let slope = |place: usize| Some(Vec3::splat(sites[place].position.x));
        for (i, site) in all.iter().enumerate() {
            let off = places.light_of(i, site, &slope).expect("known").x - site.position.x;
            assert!(off.abs() < if is_shown(i) { 1e-6 } else { 8.0 }, "{i}: {off}");
            assert_eq!(places.light_of(i, site, &|_| None), None);
        }
    }

    /// More than may stand for themselves: cells are as many as there is room for, those of what is shown narrower.
    #[test]
    fn a_view_of_many_sites_has_narrow_cells() {
        let side = 400;
        let all = floor(side);
        let shown: Vec<bool> = (0..all.len()).map(|i| i % side < side / 2).collect();
        let places = Places::among(&all, &shown);
        let ahead = places.ahead.iter().filter(|ahead| **ahead).count();
        let others = places.ahead.len() - ahead;
        assert!((PLACES / 2..=PLACES).contains(&places.ahead.len()), "{}", places.ahead.len());
        assert!(ahead > 3 * others && others > 1000, "{ahead} {others}");
    }

    /// What has no size, or none that is a number, ends all the same.
    #[test]
    fn sites_of_any_size_are_survived() {
        for (width, scale) in
            [(0.0, 1.0), (1e-30, 1.0), (1e30, 1e30), (f32::INFINITY, 1.0), (f32::NAN, f32::NAN)]
        {
            let at = |site: Site| Site { width, position: site.position * scale, ..site };
            let all: Vec<Site> = floor(200).into_iter().map(at).collect();
            let places = Places::among(&all, &vec![false; all.len()]);
            assert!((1..=PLACES).contains(&places.sites.all().len()), "{width} {scale}");
        }
    }
}
