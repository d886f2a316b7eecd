//! Where the first estimate of light gathers: places that speak for the sites around them.
//!
//! What the start view shows has places of its own or, in dense meshes, of narrow cells; all else shares what is left of them, in
//! cells that are as wide as that takes.

use glam::{IVec3, Vec3};
use rayon::prelude::*;
use rustc_hash::{FxHashMap, FxHashSet};

use super::sites::{NONE, Site, Sites};

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

/// Sites that speak for others; all speak for themselves where they are few.
pub(super) struct Places {
    pub sites: Sites,
    /// Per place whether the start view shows it.
    pub ahead: Vec<bool>,
    /// Per site of the scene, who of them speaks for it, where not each does for itself.
    speakers: Option<Vec<Speakers>>,
}

/// Who speaks for a site.
struct Speakers {
    /// The one of its cell.
    own: u32,
    /// Those half a width to its four sides, or [`NONE`]: where cells meet their values are mixed. Who is alone in a cell needs
    /// none.
    around: [u32; 4],
}

impl Places {
    /// A place for each of few sites; else at most [`PLACES`], one of each cell of space and direction, cells as small as that
    /// allows. `ahead`: per site whether the start view shows it; others have wider cells.
    pub fn among(all: &[Site], ahead: &[bool]) -> Self {
        if all.len() <= FEW {
            return Self { sites: Sites::of(all.to_vec()), ahead: ahead.to_vec(), speakers: None };
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
        let wide = |i: usize| match count[of[i] as usize] {
            1 => all[i],
            _ => Site { width: all[i].width.max(width_of_cell(size, ahead[i])), ..all[i] },
        };
        let sites = Sites::of(chosen.iter().map(|i| wide(*i as usize)).collect());
        let speakers = |i: usize| {
            let own = of[i];
            if count[own as usize] == 1 {
                return Speakers { own, around: [NONE; 4] };
            }
            let (x, y) = all[i].normal.any_orthonormal_pair();
            let wide = wide(i);
            let beside = |way: Vec3| sites.beside(&wide, wide.position + way * (0.5 * wide.width));
            Speakers { own, around: [x, y, -x, -y].map(|way| beside(way).unwrap_or(NONE)) }
        };
        let speakers = (0..all.len()).into_par_iter().map(speakers).collect();
        let ahead = chosen.iter().map(|i| ahead[*i as usize]).collect();
        Self { sites, ahead, speakers: Some(speakers) }
    }

    /// What light at these places is light of all sites, so many; `None` where nothing is known.
    pub fn of_all(&self, count: usize, light: &(dyn Fn(usize) -> Option<Vec3> + Sync)) -> Vec<Option<Vec3>> {
        let Some(speakers) = &self.speakers else {
            return (0..count).into_par_iter().map(light).collect();
        };
        let spoken = |Speakers { own, around }: &Speakers| {
            let around =
                around.iter().filter(|place| **place != NONE).filter_map(|place| light(*place as usize));
            let (sum, n) = around.fold((Vec3::ZERO, 0), |(sum, n), found| (sum + found, n + 1));
            // Where a surface curves too much for neighbours the own cell's is still there.
            if n > 0 { Some(sum / n as f32) } else { light(*own as usize) }
        };
        speakers.par_iter().map(spoken).collect()
    }
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
        all.iter().zip(ahead).map(of).sum::<f32>()
    };
    let (mut low, mut high) = (1e-3 * widest, 1e3 * widest);
    for _ in 0..16 {
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

type Key = (IVec3, usize);

impl Cells {
    /// `None` where they are more than [`PLACES`].
    fn of(all: &[Site], ahead: &[bool], size: f32) -> Option<Self> {
        let key = |site: &Site, width: f32| -> Key {
            let axis = site.normal.abs().max_position();
            let towards = 2 * axis + usize::from(site.normal[axis] < 0.0);
            ((site.position / width).floor().as_ivec3(), towards)
        };
        let wide = width_of_cell(size, false);
        let shown: FxHashSet<Key> =
            all.iter().zip(ahead).filter(|(_, ahead)| **ahead).map(|(site, _)| key(site, wide)).collect();
        // What the start view shows and what it does not are in cells apart.
        let ahead: Vec<bool> = all.par_iter().map(|site| shown.contains(&key(site, wide))).collect();
        let own = ahead.iter().filter(|ahead| **ahead).count() <= OWN;
        let keys: Vec<Key> =
            all.par_iter().zip(&ahead).map(|(site, ahead)| key(site, width_of_cell(size, *ahead))).collect();
        let mut cells: FxHashMap<(Key, bool), u32> = FxHashMap::default();
        let (mut chosen, mut count, mut of) = (Vec::new(), Vec::new(), Vec::with_capacity(all.len()));
        for (i, (key, &ahead)) in keys.into_iter().zip(&ahead).enumerate() {
            let mut begin = || {
                chosen.push(i as u32);
                count.push(0);
                chosen.len() as u32 - 1
            };
            let cell = if ahead && own { begin() } else { *cells.entry((key, ahead)).or_insert_with(begin) };
            count[cell as usize] += 1;
            of.push(cell);
            if chosen.len() > PLACES {
                return None;
            }
        }
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
        let light = places.of_all(all.len(), &|i| Some(Vec3::splat(i as f32)));
        assert!(light.iter().enumerate().all(|(i, light)| *light == Some(Vec3::splat(i as f32))));
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
        for (i, light) in places.of_all(all.len(), &slope).into_iter().enumerate() {
            let off = light.expect("known").x - all[i].position.x;
            assert!(off.abs() < if is_shown(i) { 1e-6 } else { 8.0 }, "{i}: {off}");
        }
        assert!(places.of_all(all.len(), &|_| None).iter().all(Option::is_none));
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
