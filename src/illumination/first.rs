//! The first illumination of a scene, within a second: coarse elements, few samples, wide smoothing.
//!
//! What named lights make bright is known before all else, so paths look for it from their first sample on: a patch of sun, a
//! lampshade. Directions by the cosine find that once in a hundred, and a single one then shows as a glow that is not there.
//!
//! The first round follows paths to their end, so that all bounces of light are there; the next ones read what it found, as
//! those of the bake do. Of a dense mesh one vertex speaks for those around it. Nothing in it is guessed: it is a short bake.

use glam::{IVec3, Vec3};
use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::atlas::Atlas;
use super::bake::{atlas_of, sides_of};
use super::filter::{Noisy, Parts, Smoothing};
use super::gathered::Gathered;
use super::points::{Look, Points};
use super::seen::seen;
use super::sites::{NONE, Site, Sites};
use super::stored::{Illumination, Summary, Value};
use crate::transport::Indexed;
use crate::transport::gather::{Gather, Trust};
use crate::transport::light::bright::BrightSurfaces;

/// Texels of the first map.
const TEXELS: u32 = 16 * 1024;
/// Sites at which light is gathered, at most.
const PLACES: usize = 32 * 1024;
/// Samples of a site in each round. Those of the first one, whose paths are followed to their end, take three times as long
/// as those of the next ones, which read what the ones before them found.
const SAMPLES: [u32; 3] = [2, 6, 4];
/// Sites that share the decision whether light can reach them.
const BLOCK: usize = 64;

/// The first picture of a scene's light.
pub fn first_picture(indexed: Indexed<'_>, seed: u64) -> Illumination {
    first_picture_while(indexed, seed, &|| true).unwrap_or_else(|| unreachable!("it is always wanted"))
}

/// The same, as long as it is wanted; `None` where that ended before.
pub fn first_picture_while(
    indexed: Indexed<'_>,
    seed: u64,
    is_wanted: &(dyn Fn() -> bool + Sync),
) -> Option<Illumination> {
    let Indexed { scene, accel, lights } = indexed;
    let seen = seen(scene, accel, u64::from(TEXELS));
    let atlas = atlas_of(scene, TEXELS, &|t: u32| seen[t as usize], is_wanted)?;
    let points = Points::new(&scene.mesh, &atlas);
    let sides = sides_of(&atlas);
    let all = Sites::listed(&atlas, &sides);
    let places = Places::among(&all);
    let sites = &places.sites;
    let mut gathered = vec![Gathered::default(); sites.all().len()];
    let mut dark = vec![false; gathered.len().div_ceil(BLOCK)];
    if !is_wanted() {
        return None;
    }
    let bright = BrightSurfaces::lit_by_named(scene, accel, lights);
    let mut map = Illumination::default();
    let mut paths = 0;
    for (round, samples) in SAMPLES.into_iter().enumerate() {
        let trust = if round == 0 { Trust::Nobody } else { Trust::Map(&map) };
        let gather = Gather::new(scene, accel, lights, trust).without_named().looking_for(&bright);
        let taken: u64 = gathered
            .par_iter_mut()
            .enumerate()
            .map(|(i, sums)| {
                let site = &sites.all()[i];
                if dark[i / BLOCK]
                    || !is_wanted()
                    || !sums.find_points((scene, accel), &atlas, &points, (site, Look::Few))
                {
                    return 0;
                }
                sums.begin_round();
                sums.gather(scene, (&atlas, &points), &gather, site, (seed, samples));
                u64::from(samples)
            })
            .sum();
        if !is_wanted() {
            return None;
        }
        paths += taken;
        dark = gathered.chunks(BLOCK).map(|block| !block.iter().any(Gathered::is_lit)).collect();
        let parts: Vec<Parts> = gathered.iter().map(|g| g.parts(0.0)).collect();
        let open: Vec<bool> = gathered.iter().map(Gathered::is_open).collect();
        let known = open.iter().enumerate().map(|(i, open)| *open && !dark[i / BLOCK]).collect();
        let shown = if round + 1 < SAMPLES.len() { parts } else { smoothed(sites, parts, known) };
        let light = |i: usize| open[i].then(|| shown[i].iter().map(Noisy::mean).sum::<Vec3>());
        let straight = |i: usize| gathered[i].named().filter(|_| open[i]);
        let unnamed = places.of_all(all.len(), &light);
        let named = lights.has_any_named().then(|| places.of_all(all.len(), &straight));
        let has_indirect = shown.iter().any(|p| p[1].mean() != Vec3::ZERO);
        map = stored(&atlas, &all, (&unnamed, named.as_deref()));
        map.summary.particles = paths;
        map.summary.has_indirect = has_indirect;
    }
    map.summary.notes = atlas.notes.clone();
    map.summary.notes.push("a first estimate from few paths".into());
    Some(map)
}

fn smoothed(sites: &Sites, parts: Vec<Parts>, known: Vec<bool>) -> Vec<Parts> {
    let mut smoothing = Smoothing::new(sites, parts, &known);
    let all = sites.all().len().max(1);
    loop {
        if let Some(parts) = smoothing.step(all) {
            return parts;
        }
    }
}

/// Sites that speak for others; all speak for themselves where they are few.
struct Places {
    sites: Sites,
    /// Per site of the scene, who of them speaks for it, where not each does for itself.
    speakers: Option<Vec<Speakers>>,
}

/// Who speaks for a site.
struct Speakers {
    /// The one of its cell.
    own: u32,
    /// Those half a width to its four sides, or [`NONE`]: where cells meet their values are mixed.
    around: [u32; 4],
}

impl Places {
    /// At most [`PLACES`]: one of each cell of space and direction, cells as small as that allows.
    fn among(all: &[Site]) -> Self {
        if all.len() <= PLACES {
            return Self { sites: Sites::of(all.to_vec()), speakers: None };
        }
        let widest = all.iter().map(|s| s.width).fold(0.0f32, f32::max);
        let mut size = widest.max(f32::MIN_POSITIVE);
        // Cells of at least the widest site may be too many, or too few by far: then dense meshes have smaller ones.
        let mut found = Cells::of(all, size);
        while found.as_ref().is_some_and(|cells| cells.chosen.len() < PLACES / 4) && size > 1e-3 * widest {
            size *= 0.5;
            found = Cells::of(all, size);
        }
        let Cells { chosen, of } = loop {
            match found {
                Some(cells) => break cells,
                None => size *= 1.25,
            }
            found = Cells::of(all, size);
        };
        let wide = |site: &Site| Site { width: site.width.max(size), ..*site };
        let sites = Sites::of(chosen.iter().map(|i| wide(&all[*i as usize])).collect());
        let speakers = |(site, &own): (&Site, &u32)| {
            let (x, y) = site.normal.any_orthonormal_pair();
            let wide = wide(site);
            let beside = |way: Vec3| sites.beside(&wide, site.position + way * (0.5 * wide.width));
            Speakers { own, around: [x, y, -x, -y].map(|way| beside(way).unwrap_or(NONE)) }
        };
        let speakers = all.par_iter().zip(&of).map(speakers).collect();
        Self { sites, speakers: Some(speakers) }
    }

    /// What light at these places is light of all sites, so many; `None` where nothing is known.
    fn of_all(&self, count: usize, light: &(dyn Fn(usize) -> Option<Vec3> + Sync)) -> Vec<Option<Vec3>> {
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

/// The map of light at all sites: what is not named, and what is, where there is any.
fn stored(
    atlas: &Atlas,
    all: &[Site],
    (unnamed, named): (&[Option<Vec3>], Option<&[Option<Vec3>]>),
) -> Illumination {
    let none: Vec<Value> = vec![None; atlas.elements.len()];
    let sides = |light: &[Option<Vec3>]| {
        let mut sides = [none.clone(), none.clone()];
        for (site, value) in all.iter().zip(light) {
            sides[usize::from(site.back)][site.element as usize] = value.map(|v| v.extend(0.0));
        }
        sides
    };
    let (mut power, mut area) = (Vec3::ZERO, 0.0);
    for (i, site) in all.iter().enumerate() {
        let e = &atlas.elements[site.element as usize];
        let of_named = named.and_then(|named| named[i]);
        power += [unnamed[i], of_named].into_iter().flatten().sum::<Vec3>() * e.opaque;
        area += 0.5 * e.opaque;
    }
    let mean = if area > 0.0 { (power / area).to_array() } else { [0.0; 3] };
    let [front, back] = sides(unnamed);
    let map =
        Illumination::new(atlas, front, back, Summary { mean, relative_error: 1.0, ..Summary::default() });
    match named {
        Some(named) => map.with_named(atlas, sides(named)),
        None => map,
    }
}

/// Sites by cells of one size and by six directions.
struct Cells {
    /// The first site of each.
    chosen: Vec<u32>,
    /// Which of these is the one of each site.
    of: Vec<u32>,
}

impl Cells {
    /// `None` where they are more than [`PLACES`].
    fn of(all: &[Site], size: f32) -> Option<Self> {
        let key = |site: &Site| {
            let axis = site.normal.abs().max_position();
            let towards = 2 * axis + usize::from(site.normal[axis] < 0.0);
            ((site.position / size).floor().as_ivec3(), towards)
        };
        let keys: Vec<(IVec3, usize)> = all.par_iter().map(key).collect();
        let mut cells: FxHashMap<(IVec3, usize), u32> = FxHashMap::default();
        let (mut chosen, mut of) = (Vec::new(), Vec::with_capacity(all.len()));
        for (i, key) in keys.into_iter().enumerate() {
            let cell = cells.entry(key).or_insert_with(|| {
                chosen.push(i as u32);
                chosen.len() as u32 - 1
            });
            of.push(*cell);
            if chosen.len() > PLACES {
                return None;
            }
        }
        Some(Self { chosen, of })
    }
}
