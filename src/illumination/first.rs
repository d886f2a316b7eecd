//! The first illumination of a scene, within a second: coarse elements, few samples, wide smoothing.
//!
//! What named lights make bright is known before all else, so paths look for it from their first sample on: a patch of sun, a
//! lampshade. Directions by the cosine find that once in a hundred, and a single one then shows as a glow that is not there.
//!
//! The first round follows paths to their end, so that all bounces of light are there; the next ones read what it found, as
//! those of the bake do. Of a dense mesh one vertex speaks for those around it. What the start view shows has most of the places
//! and of the samples. Nothing in it is guessed: it is a short bake.

use glam::Vec3;
use rayon::prelude::*;

use super::ahead::met;
use super::atlas::Atlas;
use super::bake::{atlas_of, sides_of};
use super::filter::{Noisy, Parts, Smoothing};
use super::gathered::Gathered;
use super::places::Places;
use super::points::{Look, Points};
use super::seen::seen;
use super::sites::{Site, Sites, by_element, sides};
use super::stored::{Illumination, Summary};
use crate::transport::Indexed;
use crate::transport::gather::{Gather, Trust};
use crate::transport::light::bright::BrightSurfaces;

/// Texels of the first map.
const TEXELS: u32 = 16 * 1024;
/// Columns and rows of looks at what the start view shows.
const LOOKS: [u32; 2] = [160, 120];
/// Samples of a place in each round: of one that the start view does not show, and of one that it does. Those of the first round,
/// whose paths are followed to their end, take three times as long as those of the next ones, which read what the ones before
/// them found.
const SAMPLES: [[u32; 2]; 3] = [[2, 2], [6, 18], [4, 12]];
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
    let all = Sites::listed(&atlas, &sides_of(&atlas));
    let site_of = by_element(&all, atlas.elements.len());
    let mut ahead = vec![false; all.len()];
    met((scene, accel), &atlas, &site_of, LOOKS).into_iter().for_each(|i| ahead[i as usize] = true);
    let places = Places::among(&all, &ahead);
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
                let count = samples[usize::from(places.ahead[i])];
                sums.gather(scene, (&atlas, &points), &gather, site, (seed, count));
                u64::from(count)
            })
            .sum();
        if !is_wanted() {
            return None;
        }
        paths += taken;
        dark = gathered.chunks(BLOCK).map(|block| !block.iter().any(Gathered::is_lit)).collect();
        let open: Vec<bool> = gathered.iter().map(Gathered::is_open).collect();
        let mut shown: Vec<Parts> = gathered.iter().map(|g| g.parts(0.0)).collect();
        let is_last = round + 1 == SAMPLES.len();
        if is_last {
            smooth(sites, &mut shown, |i| open[i] && !dark[i / BLOCK]);
        }
        let light = |i: usize| open[i].then(|| shown[i].iter().map(Noisy::mean).sum::<Vec3>());
        let straight = |i: usize| gathered[i].named().filter(|_| open[i]);
        let by_site = |light: &(dyn Fn(usize) -> Option<Vec3> + Sync)| -> Vec<Option<Vec3>> {
            all.par_iter().enumerate().map(|(i, site)| places.light_of(i, site, &light)).collect()
        };
        let unnamed = by_site(&light);
        let named = lights.has_any_named().then(|| by_site(&straight));
        let has_indirect = shown.iter().any(|p| p[1].mean() != Vec3::ZERO);
        map = stored(&atlas, &site_of, &unnamed, named.as_deref());
        if is_last {
            map.summary.mean = mean(&atlas, &all, &unnamed, named.as_deref());
        }
        map.summary.particles = paths;
        map.summary.has_indirect = has_indirect;
    }
    map.summary.notes = atlas.notes.clone();
    map.summary.notes.push("a first estimate from few paths".into());
    Some(map)
}

/// Smooths what was gathered at the sites that are known.
fn smooth(sites: &Sites, parts: &mut [Parts], is_known: impl Fn(usize) -> bool) {
    let known: Vec<u32> = (0..parts.len()).filter(|i| is_known(*i)).map(|i| i as u32).collect();
    let gathered = known.iter().map(|i| parts[*i as usize]).collect();
    let mut smoothing = Smoothing::new(sites, known, gathered);
    let smoothed = loop {
        if let Some(smoothed) = smoothing.step(parts.len().max(1)) {
            break smoothed;
        }
    };
    for (i, after) in smoothed.known.into_iter().zip(smoothed.parts) {
        parts[i as usize] = after;
    }
}

/// The map of light at all sites: what is not named, and what is, where there is any.
fn stored(
    atlas: &Atlas,
    site_of: &[[u32; 2]],
    unnamed: &[Option<Vec3>],
    named: Option<&[Option<Vec3>]>,
) -> Illumination {
    let by_side = |light: &[Option<Vec3>]| sides(site_of, &|i| Some(light[i]?.extend(0.0)));
    let [front, back] = by_side(unnamed);
    let summary = Summary { relative_error: 1.0, ..Summary::default() };
    let map = Illumination::new(atlas, front, back, summary);
    match named {
        Some(named) => map.with_named(atlas, by_side(named)),
        None => map,
    }
}

/// Power that arrives on both sides per area of surface and band, W/m².
fn mean(atlas: &Atlas, all: &[Site], unnamed: &[Option<Vec3>], named: Option<&[Option<Vec3>]>) -> [f32; 3] {
    let (mut power, mut area) = (Vec3::ZERO, 0.0);
    for (i, site) in all.iter().enumerate() {
        let e = &atlas.elements[site.element as usize];
        let of_named = named.and_then(|named| named[i]);
        power += [unnamed[i], of_named].into_iter().flatten().sum::<Vec3>() * e.opaque;
        area += 0.5 * e.opaque;
    }
    if area > 0.0 { (power / area).to_array() } else { [0.0; 3] }
}
