//! What of the sky is seen from where: in a room, what its windows show.
//!
//! Of samples of a sky that is drawn by its radiance alone nearly all end at the ceiling. So the sky is cut into tiles, and
//! what of each is seen is asked at points that looks from the cameras come to. A tree over these points and their normals
//! keeps for each of its leaves which share of samples goes to which tile: by what the tile would bring there, as far as
//! it is seen. Within a tile directions are drawn by its radiance (portals without their being named; Bitterli et al. 2015 map
//! a rectangle that is).
//!
//! A leaf is wrong at most points of it by a little, and where a sliver of the sky was overlooked by much; so a share of all
//! samples is drawn from all of the sky. It is a function of the scene alone and costs no bias.

use std::ops::Range;

use glam::Vec3;

use super::distribution::EnvironmentDistribution;
use super::towards::Receiver;
use crate::geometry::{Accel, Ray};
use crate::image::Map2d;
use crate::rng::Stream;
use crate::scene::{Environment, Scene};
use crate::transport::bsdf::{Bsdf, cosine_hemisphere};
use crate::transport::direct::visibility;
use crate::transport::interaction::Interaction;

/// Parts that the sky is cut into at most.
const TILES: usize = 256;
/// Looks from cameras, and surfaces that each comes to at most.
const LOOKS: u32 = 1024;
const SURFACES: u32 = 4;
/// Points of a leaf, about.
const LEAF: usize = 8;
/// Share of the samples that leaves tell.
const TOLD: f32 = 0.85;
/// How many points what a node tells counts in its children.
const PRIOR: f32 = 2.0;
/// Where more of the sky's light is seen than this, samples of all of it do as well.
const OPEN: f32 = 0.6;
/// Columns and rows of an even sky.
const EVEN: (usize, usize) = (64, 32);
/// Sets these looks apart from other uses of random numbers.
const LOOK: u64 = 0x51c7;

/// What of a sky is seen from where.
#[derive(Clone, Debug)]
pub struct VisibleSky {
    /// Of an even sky; others have their own.
    even: Option<EnvironmentDistribution>,
    tiles: Tiles,
    /// A tree of so many levels, node k above 2k + 1 and 2k + 2: the axis of position and normal, and where it is parted.
    nodes: Vec<(u8, f32)>,
    /// What normals count beside positions, scene units.
    reach: f32,
    /// Per leaf the share of samples up to and including each tile, ending at 1.
    shares: Vec<f32>,
}

/// Where somebody looked at the sky from: position, and normal times `reach`.
type Place = [f32; 6];

fn place(at: &Receiver, reach: f32) -> Place {
    let (p, n) = (at.point, at.normal * reach);
    [p.x, p.y, p.z, n.x, n.y, n.z]
}

impl VisibleSky {
    /// Looks about; `None` where there is no sky, nobody to see anything, or most of it is seen from everywhere.
    pub(super) fn new(scene: &Scene, accel: &Accel, sky: Option<&EnvironmentDistribution>) -> Option<Self> {
        let (environment, sky) = (scene.environment.as_ref()?, sky?);
        let even = environment.map.is_none().then(|| {
            let map = Some(Map2d::new(EVEN.0, EVEN.1, Vec3::ONE));
            EnvironmentDistribution::new(&Environment { map, ..environment.clone() })
        });
        let even = match even {
            Some(even) => Some(even?),
            None => None,
        };
        let tiles = Tiles::new(even.as_ref().unwrap_or(sky));
        let mut points = looked_at(scene, accel);
        if points.is_empty() {
            return None;
        }
        let reach = 0.25 * (scene.bounds[1] - scene.bounds[0]).max_element();
        let levels = (points.len() / LEAF).max(1).ilog2();
        let mut nodes = vec![(0, 0.0); (1 << levels) - 1];
        part(&mut points, 0, (levels, reach), &mut nodes);
        let distribution = even.as_ref().unwrap_or(sky);
        let (mut found, mut open, mut seen) = (0.0, 0.0, Vec::with_capacity(points.len()));
        for (i, at) in points.iter().enumerate() {
            let tiles = tiles.seen_from(scene, accel, (environment, distribution), at, i as u64);
            open += tiles.iter().map(|tile| f64::from(tile.0)).sum::<f64>();
            let seen_here: Vec<f32> = tiles.into_iter().map(|(brings, passed)| brings * passed).collect();
            found += seen_here.iter().map(|e| f64::from(*e)).sum::<f64>();
            seen.push(seen_here);
        }
        if !(found > 0.0 && found < f64::from(OPEN) * open) {
            return None;
        }
        let mut shares = Vec::with_capacity(tiles.all.len() << levels);
        tell(&seen, levels, None, &mut shares);
        Some(Self { even, tiles, nodes, reach, shares })
    }

    fn leaf(&self, at: &Receiver) -> &[f32] {
        let place = place(at, self.reach);
        let mut k = 0;
        while let Some((axis, middle)) = self.nodes.get(k) {
            k = 2 * k + if place[*axis as usize] < *middle { 1 } else { 2 };
        }
        let count = self.tiles.all.len();
        &self.shares[(k - self.nodes.len()) * count..][..count]
    }

    /// A direction to the sky and its density per solid angle.
    pub(super) fn sample(
        &self,
        (environment, sky): (&Environment, &EnvironmentDistribution),
        at: &Receiver,
        [u, v]: [f32; 2],
    ) -> Option<(Vec3, f32)> {
        let sky = self.even.as_ref().unwrap_or(sky);
        let leaf = self.leaf(at);
        if u >= TOLD {
            let u = ((u - TOLD) / (1.0 - TOLD)).min(1.0 - f32::EPSILON);
            let (wi, _) = sky.sample(environment, [u, v])?;
            let cell = sky.cell(environment, wi);
            return Some((wi, self.density(sky, leaf, self.tiles.of(cell), cell)));
        }
        let u = (u / TOLD).min(1.0 - f32::EPSILON);
        let tile = leaf.partition_point(|&s| s <= u).min(leaf.len() - 1);
        let before = if tile == 0 { 0.0 } else { leaf[tile - 1] };
        let u = ((u - before) / (leaf[tile] - before)).clamp(0.0, 1.0 - f32::EPSILON);
        let (wi, cell) = self.tiles.sample(environment, sky, tile, [u, v])?;
        Some((wi, self.density(sky, leaf, tile, cell)))
    }

    /// The density of [`Self::sample`].
    pub(super) fn pdf(
        &self,
        (environment, sky): (&Environment, &EnvironmentDistribution),
        at: &Receiver,
        wi: Vec3,
    ) -> f32 {
        let sky = self.even.as_ref().unwrap_or(sky);
        let cell = sky.cell(environment, wi);
        self.density(sky, self.leaf(at), self.tiles.of(cell), cell)
    }

    fn density(&self, sky: &EnvironmentDistribution, leaf: &[f32], tile: usize, cell: (usize, usize)) -> f32 {
        let share = leaf[tile] - if tile == 0 { 0.0 } else { leaf[tile - 1] };
        let told = if share > 0.0 { f64::from(share) / self.tiles.all[tile].weight } else { 0.0 };
        ((f64::from(TOLD) * told + f64::from(1.0 - TOLD)) * sky.density(cell.0, cell.1)) as f32
    }
}

/// Surfaces that cameras see, straight or over others.
fn looked_at(scene: &Scene, accel: &Accel) -> Vec<Interaction> {
    /// The looks are square: only what they see counts.
    const SIDE: u32 = 1024;
    let cameras = scene.standpoints();
    let mut points = Vec::new();
    for i in 0..LOOKS {
        let Some(camera) = cameras.get(i as usize % cameras.len().max(1)) else { break };
        let mut stream = Stream::new(LOOK, u64::from(i), 0);
        let [u, v] = stream.next_2d();
        let frame = camera.frame(SIDE, SIDE);
        let mut ray = Ray::new(frame.eye, frame.direction(u * SIDE as f32, v * SIDE as f32));
        for _ in 0..SURFACES {
            let Some(hit) = accel.intersect(scene, &ray) else { break };
            let at = Interaction::at(scene, &ray, &hit);
            let bsdf = Bsdf::at(scene, &at);
            let (u, lobe) = (stream.next_2d(), stream.next_f32());
            // Of mirrors, too: particles begin there.
            points.push(at);
            let wi = if bsdf.diffuse_albedo() != Vec3::ZERO {
                let normal = at.facing_shading();
                let (x, y) = normal.any_orthonormal_pair();
                let local = cosine_hemisphere(u);
                Some(x * local.x + y * local.y + normal * local.z)
            } else {
                bsdf.sample(at.wo, u, lobe).map(|sample| sample.wi)
            };
            let Some(wi) = wi else { break };
            ray = at.spawn(wi);
        }
    }
    points.retain(|at| at.position.is_finite() && at.facing_shading().is_finite());
    points
}

/// Parts points in halves along the axis in which they are spread widest, as many times as there are levels.
fn part(points: &mut [Interaction], node: usize, (levels, reach): (u32, f32), nodes: &mut [(u8, f32)]) {
    if levels == 0 {
        return;
    }
    let along = |at: &Interaction, axis: usize| place(&at.into(), reach)[axis];
    let spread = |axis: usize| {
        let all = points.iter().map(|at| along(at, axis));
        all.clone().fold(f32::NEG_INFINITY, f32::max) - all.fold(f32::INFINITY, f32::min)
    };
    let axis = (0..6).max_by(|a, b| spread(*a).total_cmp(&spread(*b))).unwrap_or(0);
    let middle = points.len() / 2;
    points.select_nth_unstable_by(middle, |a, b| along(a, axis).total_cmp(&along(b, axis)));
    nodes[node] = (axis as u8, along(&points[middle], axis));
    let (low, high) = points.split_at_mut(middle);
    part(low, 2 * node + 1, (levels - 1, reach), nodes);
    part(high, 2 * node + 2, (levels - 1, reach), nodes);
}

/// The shares of the leaves of a node, in their order: what its points see, and a little of what those around do.
fn tell(seen: &[Vec<f32>], levels: u32, above: Option<&[f32]>, shares: &mut Vec<f32>) {
    let mut means: Vec<f32> = above.map_or_else(|| vec![0.0; seen[0].len()], <[f32]>::to_vec);
    let prior = above.map_or(0.0, |_| PRIOR);
    for (tile, mean) in means.iter_mut().enumerate() {
        let sum: f32 = seen.iter().map(|point| point[tile]).sum();
        *mean = (sum + prior * *mean) / (seen.len() as f32 + prior);
    }
    if levels > 0 {
        let (low, high) = seen.split_at(seen.len() / 2);
        tell(low, levels - 1, Some(&means), shares);
        tell(high, levels - 1, Some(&means), shares);
        return;
    }
    // Somebody saw something, so this is not 0.
    let total: f32 = means.iter().sum();
    let mut sum = 0.0;
    let first = shares.len();
    shares.extend(means.iter().map(|mean| {
        sum += mean;
        sum / total
    }));
    // The last that has a share ends at 1.
    let last = shares[shares.len() - 1];
    shares[first..].iter_mut().filter(|share| **share >= last).for_each(|share| *share = 1.0);
}

/// A sky in rectangles of cells.
#[derive(Clone, Debug)]
struct Tiles {
    all: Vec<Tile>,
    /// How they were cut: axis (0: columns), the first cell of the second half, and for both halves the number of a cut, or
    /// of a tile with [`IS_TILE`].
    cuts: Vec<(u8, u32, [u32; 2])>,
}

const IS_TILE: u32 = 1 << 31;

#[derive(Clone, Debug)]
struct Tile {
    columns: Range<usize>,
    rows: Range<usize>,
    /// Share of the sky's light.
    weight: f64,
    /// Sums of its rows up to and including each.
    sums: Vec<f64>,
}

impl Tile {
    fn new(sky: &EnvironmentDistribution, columns: Range<usize>, rows: Range<usize>) -> Self {
        let mut weight = 0.0;
        let sums = rows.clone().map(|row| {
            weight += sky.weight(row, columns.clone());
            weight
        });
        let sums = sums.collect();
        Self { columns, rows, weight, sums }
    }

    /// What is to be gained by cutting it: its light times its width.
    fn gain(&self, sky: &EnvironmentDistribution) -> f64 {
        let is_one = self.columns.len() * self.rows.len() == 1;
        if is_one { 0.0 } else { self.weight * sky.extent(&self.columns, &self.rows).0.sqrt() }
    }
}

impl Tiles {
    fn new(sky: &EnvironmentDistribution) -> Self {
        let (width, height) = sky.size();
        let mut all = vec![Tile::new(sky, 0..width, 0..height)];
        let mut cuts: Vec<(u8, u32, [u32; 2])> = Vec::new();
        // Where each tile hangs: a cut and its side.
        let mut parents: Vec<Option<(usize, usize)>> = vec![None];
        let mut gains = vec![all[0].gain(sky)];
        while all.len() < TILES {
            let Some(i) = (0..all.len()).max_by(|a, b| gains[*a].total_cmp(&gains[*b])) else { break };
            if gains[i] <= 0.0 {
                break;
            }
            let Tile { columns, rows, .. } = all[i].clone();
            let along_columns = sky.extent(&columns, &rows).1;
            let cut = |r: &Range<usize>| (r.start..r.start + r.len() / 2, r.start + r.len() / 2..r.end);
            let (halves, at) = if along_columns {
                let (a, b) = cut(&columns);
                let at = b.start;
                ([Tile::new(sky, a, rows.clone()), Tile::new(sky, b, rows)], at)
            } else {
                let (a, b) = cut(&rows);
                let at = b.start;
                ([Tile::new(sky, columns.clone(), a), Tile::new(sky, columns, b)], at)
            };
            let number = cuts.len();
            if let Some((cut, side)) = parents[i] {
                cuts[cut].2[side] = number as u32;
            }
            let [a, b] = halves;
            cuts.push((
                u8::from(!along_columns),
                at as u32,
                [i as u32 | IS_TILE, all.len() as u32 | IS_TILE],
            ));
            (gains[i], parents[i]) = (a.gain(sky), Some((number, 0)));
            gains.push(b.gain(sky));
            parents.push(Some((number, 1)));
            all[i] = a;
            all.push(b);
        }
        Self { all, cuts }
    }

    /// The tile that a cell belongs to.
    fn of(&self, (column, row): (usize, usize)) -> usize {
        let mut at = if self.cuts.is_empty() { IS_TILE } else { 0 };
        while at & IS_TILE == 0 {
            let (axis, first, sides) = self.cuts[at as usize];
            let cell = if axis == 0 { column } else { row };
            at = sides[usize::from(cell >= first as usize)];
        }
        (at & !IS_TILE) as usize
    }

    /// A direction within a tile and the cell that it lies in, by radiance.
    fn sample(
        &self,
        environment: &Environment,
        sky: &EnvironmentDistribution,
        tile: usize,
        u: [f32; 2],
    ) -> Option<(Vec3, (usize, usize))> {
        let tile = &self.all[tile];
        let x = f64::from(u[1]) * tile.weight;
        let i = tile.sums.partition_point(|&s| s <= x).min(tile.sums.len() - 1);
        let before = if i == 0 { 0.0 } else { tile.sums[i - 1] };
        let v = ((x - before) / (tile.sums[i] - before)).clamp(0.0, 1.0);
        let row = tile.rows.start + i;
        let (wi, column) = sky.sample_row(environment, row, tile.columns.clone(), [f64::from(u[0]), v])?;
        Some((wi, (column, row)))
    }

    /// What each tile brings to a point where nothing stands before it, and the share that passes along one ray.
    fn seen_from(
        &self,
        scene: &Scene,
        accel: &Accel,
        (environment, sky): (&Environment, &EnvironmentDistribution),
        at: &Interaction,
        number: u64,
    ) -> Vec<(f32, f32)> {
        let normal = at.facing_shading();
        let seen = |(i, tile): (usize, &Tile)| {
            let u = Stream::new(LOOK, number, 1 + i as u64).next_2d();
            let Some((wi, _)) = self.sample(environment, sky, i, u) else { return (0.0, 0.0) };
            let brings = tile.weight as f32 * normal.dot(wi).max(0.0);
            if brings <= 0.0 || at.facing_geometric().dot(wi) <= 0.0 {
                return (0.0, 0.0);
            }
            let passed = visibility(scene, accel, &at.spawn(wi)).max_element();
            (brings, if passed.is_finite() { passed.clamp(0.0, 1.0) } else { 0.0 })
        };
        self.all.iter().enumerate().map(seen).collect()
    }
}

#[cfg(test)]
#[path = "sky_tests.rs"]
mod tests;
