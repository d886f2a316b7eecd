//! The first illumination of a scene, within a second: coarse elements, few samples, wide smoothing.
//!
//! The first round follows paths to their end, so that all bounces of light are there; the next ones read what it found, as
//! those of the bake do. Of a dense mesh one vertex speaks for those around it. Nothing in it is guessed: it is a short bake.

use std::collections::HashMap;

use glam::{IVec3, Vec3};
use rayon::prelude::*;

use super::atlas::Atlas;
use super::bake::{atlas_of, sides_of};
use super::filter::{Noisy, Parts, Smoothing};
use super::gathered::Gathered;
use super::points::Points;
use super::seen::seen;
use super::sites::{Site, Sites};
use super::stored::{Illumination, Summary, Value};
use crate::transport::Indexed;
use crate::transport::gather::{Gather, Trust};

/// Texels of the first map.
const TEXELS: u32 = 16 * 1024;
/// Sites at which light is gathered, at most.
const PLACES: usize = 32 * 1024;
/// Samples of a site in each round.
const SAMPLES: u32 = 4;
/// Rounds that read what the ones before them found.
const ROUNDS: u32 = 2;
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
    let all = Sites::new(&atlas, &sides);
    let places = Places::among(&all);
    let sites = places.sites.as_ref().unwrap_or(&all);
    let mut gathered = vec![Gathered::default(); sites.all().len()];
    let mut dark = vec![false; gathered.len().div_ceil(BLOCK)];
    let mut map = Illumination::default();
    let mut paths = 0;
    for round in 0..=ROUNDS {
        let trust = if round == 0 { Trust::Nobody } else { Trust::Map(&map) };
        let gather = Gather::new(scene, accel, lights, trust).without_named();
        let taken: u64 = gathered
            .par_iter_mut()
            .enumerate()
            .map(|(i, sums)| {
                let site = &sites.all()[i];
                if dark[i / BLOCK]
                    || !is_wanted()
                    || !sums.find_points((scene, accel), &atlas, &points, (site, true))
                {
                    return 0;
                }
                sums.begin_round();
                sums.gather(scene, (&atlas, &points), &gather, site, (seed, SAMPLES));
                u64::from(SAMPLES)
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
        let shown = if round < ROUNDS { parts } else { smoothed(sites, parts, known) };
        let light = |i: usize| open[i].then(|| shown[i].iter().map(Noisy::mean).sum::<Vec3>());
        let straight = |i: usize| gathered[i].named().filter(|_| open[i]);
        let [unnamed, named] = [places.of_all(&all, &light), places.of_all(&all, &straight)];
        let has_indirect = shown.iter().any(|p| p[1].mean() != Vec3::ZERO);
        map = stored(&atlas, &all, [&unnamed, &named], lights.has_any_named());
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
    sites: Option<Sites>,
    /// Per site of the scene, which of them speaks for it.
    spokesman: Vec<u32>,
    /// Width of what each speaks for.
    size: f32,
}

impl Places {
    /// At most [`PLACES`]: one of each cell of space and direction, cells as small as that allows.
    fn among(all: &Sites) -> Self {
        if all.all().len() <= PLACES {
            return Self { sites: None, spokesman: Vec::new(), size: 0.0 };
        }
        let widest = all.all().iter().map(|s| s.width).fold(0.0f32, f32::max);
        let mut size = widest.max(f32::MIN_POSITIVE);
        // Cells of at least the widest site may be too many, or too few by far: then dense meshes have smaller ones.
        while cells(all, size).0.len() < PLACES / 4 && size > 1e-3 * widest {
            size *= 0.5;
        }
        let (mut chosen, mut spokesman) = cells(all, size);
        while chosen.len() > PLACES {
            size *= 1.25;
            (chosen, spokesman) = cells(all, size);
        }
        let wide = |i: &u32| {
            let site = all.all()[*i as usize];
            Site { width: site.width.max(size), ..site }
        };
        Self { sites: Some(Sites::of(chosen.iter().map(wide).collect())), spokesman, size }
    }

    /// What light at these places is light of all sites; `None` where nothing is known.
    fn of_all(&self, all: &Sites, own: &(dyn Fn(usize) -> Option<Vec3> + Sync)) -> Vec<Option<Vec3>> {
        let spoken = |i: usize, site: &Site| {
            let sites = self.sites.as_ref()?;
            let (x, y) = site.normal.any_orthonormal_pair();
            // Where cells meet their values are mixed.
            let around = [x, y, -x, -y].map(|way| {
                let wide = Site { width: site.width.max(self.size), ..*site };
                let place = site.position + way * (0.5 * wide.width);
                sites.beside(&wide, place).and_then(|j| own(j as usize))
            });
            let found = around.iter().flatten();
            let n = found.clone().count();
            // Where a surface curves too much for neighbours the own cell's is still there.
            if n > 0 { Some(found.sum::<Vec3>() / n as f32) } else { own(self.spokesman[i] as usize) }
        };
        let value = |(i, site): (usize, &Site)| if self.sites.is_some() { spoken(i, site) } else { own(i) };
        all.all().par_iter().enumerate().map(value).collect()
    }
}

/// The map of light at all sites: what is not named, and what is.
fn stored(atlas: &Atlas, all: &Sites, light: [&[Option<Vec3>]; 2], has_named: bool) -> Illumination {
    let none: Vec<Value> = vec![None; atlas.elements.len()];
    let [unnamed, named] = light.map(|light| {
        let mut sides = [none.clone(), none.clone()];
        for (site, value) in all.all().iter().zip(light) {
            sides[usize::from(site.back)][site.element as usize] = value.map(|v| v.extend(0.0));
        }
        sides
    });
    let (mut power, mut area) = (Vec3::ZERO, 0.0);
    for (i, site) in all.all().iter().enumerate() {
        let e = &atlas.elements[site.element as usize];
        power += light.iter().filter_map(|light| light[i]).sum::<Vec3>() * e.opaque;
        area += 0.5 * e.opaque;
    }
    let mean = if area > 0.0 { (power / area).to_array() } else { [0.0; 3] };
    let [front, back] = unnamed;
    let map =
        Illumination::new(atlas, front, back, Summary { mean, relative_error: 1.0, ..Summary::default() });
    if has_named { map.with_named(atlas, named) } else { map }
}

/// The first site of each cell of this size and of each of six directions, and which of these is the one of each site.
fn cells(all: &Sites, size: f32) -> (Vec<u32>, Vec<u32>) {
    let mut cells: HashMap<(IVec3, usize), u32> = HashMap::new();
    let (mut chosen, mut of) = (Vec::new(), Vec::with_capacity(all.all().len()));
    for (i, site) in all.all().iter().enumerate() {
        let axis = site.normal.abs().max_position();
        let towards = 2 * axis + usize::from(site.normal[axis] < 0.0);
        let cell = cells.entry(((site.position / size).floor().as_ivec3(), towards)).or_insert_with(|| {
            chosen.push(i as u32);
            chosen.len() as u32 - 1
        });
        of.push(*cell);
    }
    (chosen, of)
}
