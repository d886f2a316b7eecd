//! The sides of elements that light is gathered at, and which of them lie beside each other.
//!
//! Neighbours are found in space, not on the page of the lightmap, so that seams between charts do not show and vertices of
//! dense meshes have neighbours as texels do.

use std::sync::OnceLock;

use glam::Vec3;
use rayon::prelude::*;

use super::atlas::Atlas;
use super::stored::Value;

/// Cells are so many widths of a site wide.
const CELL: f32 = 2.0;
/// Cosine between the normals of neighbours, at least: 25°.
const FLAT: f32 = 0.906;
/// Distance of a neighbour from the tangent plane, widths, at most.
const BESIDE: f32 = 2.0;

/// Distance of a linked site from the place that is a width away, and from the tangent plane, widths: less, so that every link
/// leads that way.
const LINKED: (f32, f32) = (1.0, 1.0);
/// A site as near as this to such a place has none before it, widths.
const HALF: f32 = 0.71;
/// No site.
pub const NONE: u32 = u32::MAX;

/// Per element, of so many, the sites of its front and its back, or [`NONE`].
pub fn by_element(sites: &[Site], elements: usize) -> Vec<[u32; 2]> {
    let mut of = vec![[NONE; 2]; elements];
    for (i, site) in sites.iter().enumerate() {
        of[site.element as usize][usize::from(site.back)] = i as u32;
    }
    of
}

/// What is known of the front and of the back of each element, from that of its sites.
pub fn sides(site_of: &[[u32; 2]], value: &(dyn Fn(usize) -> Value + Sync)) -> [Vec<Value>; 2] {
    let of = |site: u32| if site == NONE { None } else { value(site as usize) };
    [0, 1].map(|side| site_of.par_iter().map(|sites| of(sites[side])).collect())
}

/// One side of an element.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Site {
    /// The element.
    pub element: u32,
    /// Whether its back.
    pub back: bool,
    /// Where it is, scene units.
    pub position: Vec3,
    /// Unit normal on its side; zero where it has none.
    pub normal: Vec3,
    /// Width of what it stands for, scene units.
    pub width: f32,
}

impl Site {
    /// Whether what light does here says something about another site: whether one surface goes on from one to the other.
    #[inline]
    pub fn goes_on_to(&self, other: &Self) -> bool {
        other.normal.dot(self.normal) > FLAT
            && (other.position - self.position).dot(self.normal).abs() < BESIDE * self.width
    }
}

/// What is asked of a neighbour.
#[derive(Clone, Copy, Debug)]
struct Near {
    position: Vec3,
    normal: Vec3,
    site: u32,
    level: i32,
}

/// Sites, and where to find those near a place.
#[derive(Clone, Debug, Default)]
pub struct Sites {
    all: Vec<Site>,
    /// Per bucket of the hash of a cell where its members begin; one more at the end.
    first: Vec<u32>,
    members: Vec<Near>,
    /// Which sizes of cells there are, as powers of two from [`FINEST`] on.
    sizes: Vec<bool>,
    /// Per site the one a width to its right, left, above and below, or [`NONE`]; once somebody asks, since to find all of them
    /// takes longer than a first picture should wait.
    links: Vec<OnceLock<Links>>,
}

/// A site's neighbours in four directions, opposite ones beside each other.
pub type Links = [u32; 4];

/// The smallest cells, as a power of two; all that are smaller count as these.
const FINEST: i32 = -60;
/// The largest.
const WIDEST: i32 = 60;

/// The size of cells, as a power of two, for sites of this width: from the bits of the number, without a logarithm.
fn level(width: f32) -> i32 {
    let exponent = ((CELL * width).to_bits() >> 23 & 0xff) as i32 - 127;
    exponent.clamp(FINEST, WIDEST)
}

/// 2⁻ˡ.
fn per_cell(level: i32) -> f32 {
    f32::from_bits(((127 - level) as u32) << 23)
}

/// The greatest integer below; beyond what an integer holds cells are shared, no more.
pub(super) fn floor(x: f32) -> i32 {
    let whole = x as i32;
    whole.saturating_sub(i32::from(whole as f32 > x))
}

fn cell(position: Vec3, level: i32) -> [i32; 3] {
    (position * per_cell(level)).to_array().map(floor)
}

fn bucket(cell: [i32; 3], level: i32, buckets: usize) -> usize {
    let [x, y, z] = cell.map(|v| u64::from(v as u32));
    let mixed = x.wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ y.wrapping_mul(0xc2b2_ae3d_27d4_eb4f)
        ^ z.wrapping_mul(0x1656_67b1_9e37_79f9)
        ^ (level as u64).wrapping_mul(0x2545_f491_4f6c_dd1d);
    ((mixed ^ mixed >> 32).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32) as usize & (buckets - 1)
}

impl Sites {
    /// These elements of `atlas`, by number and whether the back is meant.
    pub fn new(atlas: &Atlas, of: &[(u32, bool)]) -> Self {
        Self::of(Self::listed(atlas, of))
    }

    /// The sites of [`Self::new`] alone, for whom neighbours do not matter.
    pub fn listed(atlas: &Atlas, of: &[(u32, bool)]) -> Vec<Site> {
        let site = |&(element, back): &(u32, bool)| {
            let e = &atlas.elements[element as usize];
            let normal = if back { -e.normal } else { e.normal };
            Site { element, back, position: e.position, normal, width: atlas.width_of(element) }
        };
        of.par_iter().map(site).collect()
    }

    /// These.
    pub fn of(all: Vec<Site>) -> Self {
        let buckets = all.len().next_power_of_two();
        let place = |s: &Site| {
            let level = level(s.width);
            (bucket(cell(s.position, level), level, buckets) as u32, level)
        };
        let at: Vec<(u32, i32)> = all.par_iter().map(place).collect();
        let mut first = vec![0u32; buckets + 1];
        let mut sizes = vec![false; (WIDEST - FINEST + 1) as usize];
        for &(bucket, level) in &at {
            first[bucket as usize + 1] += 1;
            sizes[(level - FINEST) as usize] = true;
        }
        for i in 1..first.len() {
            first[i] += first[i - 1];
        }
        let mut next = first.clone();
        let mut order = vec![0u32; all.len()];
        for (i, &(bucket, _)) in at.iter().enumerate() {
            order[next[bucket as usize] as usize] = i as u32;
            next[bucket as usize] += 1;
        }
        let member = |&i: &u32| {
            let Site { position, normal, .. } = all[i as usize];
            Near { position, normal, site: i, level: at[i as usize].1 }
        };
        let members = order.par_iter().map(member).collect();
        let links = vec![OnceLock::new(); all.len()];
        Self { all, first, members, sizes, links }
    }

    /// Those that lie a width away from one site. The first who asks has them found.
    pub fn links_of(&self, site: u32) -> Links {
        *self.links[site as usize].get_or_init(|| self.linked(site as usize))
    }

    fn linked(&self, i: usize) -> Links {
        let site = &self.all[i];
        if site.normal == Vec3::ZERO {
            return [NONE; 4];
        }
        // The same on all of a flat surface, whatever the last bits of its normals.
        let up = if site.normal.y.abs() < 0.9 { Vec3::Y } else { Vec3::X };
        let x = up.cross(site.normal).normalize_or_zero();
        let y = site.normal.cross(x);
        [x, -x, y, -y].map(|way| self.nearest(i as u32, site.position + way * site.width))
    }

    /// The site nearest to a place a width away from another one.
    fn nearest(&self, from: u32, place: Vec3) -> u32 {
        let site = &self.all[from as usize];
        let own = level(site.width);
        let mut nearest = NONE;
        let mut least = (LINKED.0 * site.width).powi(2);
        let mut look = |here: [i32; 3], level: i32, least: &mut f32| {
            let bucket = bucket(here, level, self.first.len() - 1);
            for near in &self.members[self.first[bucket] as usize..self.first[bucket + 1] as usize] {
                let distance = near.position.distance_squared(place);
                if distance < *least
                    && near.site != from
                    && near.normal.dot(site.normal) > FLAT
                    && (near.position - site.position).dot(site.normal).abs() < LINKED.1 * site.width
                    // Other cells share the bucket by chance, and chance knows the size of the scene.
                    && near.level == level
                    && cell(near.position, level) == here
                {
                    (nearest, *least) = (near.site, distance);
                }
            }
        };
        for level in [own, own + 1, own - 1] {
            if !self.sizes.get((level - FINEST) as usize).is_some_and(|there| *there) {
                continue;
            }
            look(cell(place, level), level, &mut least);
            if level == own && least > (HALF * site.width).powi(2) {
                // It may lie across a cell's border.
                let low = cell(place - Vec3::splat(0.5 / per_cell(level)), level);
                for corner in 0..8 {
                    look(
                        [0, 1, 2].map(|axis| low[axis].saturating_add(corner >> axis & 1)),
                        level,
                        &mut least,
                    );
                }
            }
            if least < (HALF * site.width).powi(2) {
                break;
            }
        }
        nearest
    }

    /// All of them.
    pub fn all(&self) -> &[Site] {
        &self.all
    }

    /// The neighbour of `site` that is nearest to a place of its tangent plane; `None` where the surface does not go on.
    #[inline]
    pub fn beside(&self, site: &Site, place: Vec3) -> Option<u32> {
        let own = level(site.width);
        // Where the mesh is finer or coarser cells are, too.
        [own, own + 1, own - 1].into_iter().find_map(|level| {
            if !self.sizes.get((level - FINEST) as usize).is_some_and(|there| *there) {
                return None;
            }
            let here = cell(place, level);
            let bucket = bucket(here, level, self.first.len() - 1);
            let range = self.first[bucket] as usize..self.first[bucket + 1] as usize;
            let mut nearest = None;
            let mut least = (CELL * site.width).powi(2);
            for near in &self.members[range] {
                let distance = near.position.distance_squared(place);
                if distance < least
                    && near.normal.dot(site.normal) > FLAT
                    && (near.position - site.position).dot(site.normal).abs() < BESIDE * site.width
                    // As for links: not what shares the bucket by chance.
                    && near.level == level
                    && cell(near.position, level) == here
                {
                    (nearest, least) = (Some(near.site), distance);
                }
            }
            nearest
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illumination::atlas::ConformalCharts;
    use crate::illumination::test_scenes::{join, quad};

    /// Two halves of a floor in two charts, and a wall.
    fn floor() -> (Atlas, Sites) {
        let mut mesh = quad(Vec3::ZERO, Vec3::X, Vec3::Y);
        join(&mut mesh, &quad(Vec3::X, Vec3::X, Vec3::Y), 0);
        join(&mut mesh, &quad(Vec3::ZERO, Vec3::Y, Vec3::Z), 0);
        let atlas = Atlas::build(&mesh, 3000, &|_| true, &|_| true, &ConformalCharts);
        let of: Vec<(u32, bool)> = (0..atlas.elements.len() as u32)
            .filter(|&e| atlas.elements[e as usize].area > 0.0)
            .flat_map(|e| [(e, false), (e, true)])
            .collect();
        let sites = Sites::new(&atlas, &of);
        (atlas, sites)
    }

    #[test]
    fn neighbours_are_found_across_charts_and_not_round_corners_or_through_sheets() {
        let (_, sites) = floor();
        let mut across = 0;
        for site in sites.all() {
            let step = 3.0 * site.width;
            let (x, y) = site.normal.any_orthonormal_pair();
            for way in [x, y, -x, -y] {
                let place = site.position + way * step;
                let Some(other) = sites.beside(site, place).map(|i| sites.all()[i as usize]) else {
                    continue;
                };
                assert!(other.normal.dot(site.normal) > 0.99 && other.back == site.back);
                assert!(other.position.distance(place) < 2.0 * site.width);
                across += u32::from((site.position.x < 1.0) != (other.position.x < 1.0));
            }
        }
        assert!(across > 50, "{across}");
    }

    #[test]
    fn every_site_finds_itself() {
        let (_, sites) = floor();
        for (i, site) in sites.all().iter().enumerate() {
            assert_eq!(sites.beside(site, site.position), Some(i as u32));
        }
    }

    #[test]
    fn sizes_without_end_are_survived() {
        for width in [0.0, 1e-38, 1e30, f32::INFINITY, f32::NAN] {
            let level = level(width);
            assert!(bucket(cell(Vec3::new(1e30, -1e-30, f32::NAN), level), level, 64) < 64);
        }
    }
}
