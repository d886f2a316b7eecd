//! Hierarchical radiosity (Hanrahan, Salzman & Aupperle 1991; REFERENCE §7): quadtrees over triangles
//! with links between nodes of unlike levels, refined where much radiosity crosses (BF refinement),
//! with solutions in between (multigridding), for any number of spectral bands.
//!
//! Deviation: polygons are triangles, subdivided at edge midpoints, so any mesh will do. Initial
//! links are between all pairs of roots, so scenes beyond some thousand triangles are refused.

pub mod form_factor;
pub mod mesh;
pub mod of_scene;
pub mod simplify;

use glam::Vec3;
use rayon::prelude::*;

pub use form_factor::{Facet, Visible};
use form_factor::{form_factor, subdivide};
use simplify::{Forest, QuadNode};

use crate::rng::Stream;

/// Roots at most: initial links are quadratic in their number.
pub const ROOTS_MAX: usize = 4000;

/// One side of a polygon, a root of a quadtree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch<const BANDS: usize> {
    /// Corners, counter-clockwise seen from the side that radiates.
    pub corners: [Vec3; 3],
    /// Diffuse reflectance in [0, 1).
    pub reflectance: [f32; BANDS],
    /// Emitted radiosity, W/m².
    pub emission: [f32; BANDS],
}

/// Energy from `source`: it arrives with `form_factor · visibility` times the source's radiosity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Link {
    /// The node that radiates.
    pub source: u32,
    /// F, unoccluded.
    pub form_factor: f32,
    /// Visible share of it.
    pub visibility: f32,
}

/// A node of a quadtree.
#[derive(Clone, Debug, PartialEq)]
pub struct Node<const BANDS: usize> {
    /// Its triangle.
    pub corners: [Vec3; 3],
    /// Area, square scene units.
    pub area: f32,
    /// Index of its root patch.
    pub root: u32,
    /// The node above.
    pub parent: Option<u32>,
    /// First of four children, as in [`form_factor::subdivide`].
    pub children: Option<u32>,
    /// Radiosity, W/m²; of an inner node the mean of its leaves.
    pub radiosity: [f32; BANDS],
    /// Irradiance through the links of this node and all above, mean over the leaves below.
    pub irradiance: [f32; BANDS],
    /// What it gathers from.
    pub links: Vec<Link>,
}

/// When links are good enough.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refinement {
    /// Largest power through one link, as a share of all emitted power.
    pub power: f32,
    /// Smallest area of a node, as a share of the area of all patches.
    pub area: f32,
    /// Links at most; refinement stops there.
    pub links_max: usize,
}

impl Default for Refinement {
    fn default() -> Self {
        Self { power: 2e-5, area: 1e-5, links_max: 8_000_000 }
    }
}

/// The quadtrees and their solution.
#[derive(Clone, Debug)]
pub struct Radiosity<const BANDS: usize> {
    patches: Vec<Patch<BANDS>>,
    normals: Vec<Vec3>,
    /// Roots first, in the order of the patches; then children after their parents.
    pub nodes: Vec<Node<BANDS>>,
    total_area: f32,
    power: f32,
}

fn strongest<const BANDS: usize>(v: &[f32; BANDS]) -> f32 {
    v.iter().copied().fold(0.0, f32::max)
}

impl<const BANDS: usize> Radiosity<BANDS> {
    /// Roots with links between all that face each other.
    ///
    /// # Errors
    /// If there are more than [`ROOTS_MAX`] patches: says so for the user.
    pub fn new(patches: Vec<Patch<BANDS>>, visible: Visible<'_>) -> Result<Self, String> {
        if patches.len() > ROOTS_MAX {
            return Err(format!(
                "{} polygon sides are too many for radiosity without clusters (at most {ROOTS_MAX}); use particles",
                patches.len()
            ));
        }
        let nodes: Vec<Node<BANDS>> = patches
            .iter()
            .enumerate()
            .map(|(i, patch)| Node::new(patch.corners, i as u32, None, patch.emission, [0.0; BANDS]))
            .collect();
        let normals = patches
            .iter()
            .map(|p| (p.corners[1] - p.corners[0]).cross(p.corners[2] - p.corners[0]).normalize_or_zero())
            .collect();
        let mut solution = Self {
            total_area: nodes.iter().map(|n| n.area).sum(),
            power: nodes.iter().map(|n| n.area * strongest(&n.radiosity)).sum(),
            patches,
            normals,
            nodes,
        };
        let n = solution.nodes.len() as u32;
        let links: Vec<Vec<Link>> = (0..n)
            .into_par_iter()
            .map(|p| (0..n).filter(|&q| q != p).filter_map(|q| solution.link(p, q, None, visible)).collect())
            .collect();
        for (node, links) in solution.nodes.iter_mut().zip(links) {
            node.links = links;
        }
        Ok(solution)
    }

    fn facet(&self, i: u32) -> Facet {
        let node = &self.nodes[i as usize];
        Facet { corners: node.corners, normal: self.normals[node.root as usize], area: node.area }
    }

    /// The link over which `p` gathers from `q`, if any of it faces any of the other. `above`: the visibility over the link
    /// that this one is a part of.
    fn link(&self, p: u32, q: u32, above: Option<f32>, visible: Visible<'_>) -> Option<Link> {
        let (a, b) = (self.facet(p), self.facet(q));
        let stream = Stream::new(0x72ad, u64::from(p), u64::from(q));
        let expected = above.filter(|&v| v <= 0.0 || v >= 1.0).map(|v| v > 0.0);
        let (form_factor, visibility) = form_factor(&a, &b, expected, visible, stream);
        (form_factor > 0.0).then_some(Link { source: q, form_factor, visibility })
    }

    /// All links.
    pub fn link_count(&self) -> usize {
        self.nodes.iter().map(|n| n.links.len()).sum()
    }

    /// All leaves.
    pub fn leaf_count(&self) -> usize {
        self.nodes.iter().filter(|n| n.children.is_none()).count()
    }

    /// The polygons.
    pub fn patches(&self) -> &[Patch<BANDS>] {
        &self.patches
    }

    /// Gathers and pushes until nothing changes by more than 10⁻³ of the largest radiosity. Returns the
    /// number of iterations, at most 200.
    pub fn solve(&mut self) -> usize {
        for iteration in 1..=200 {
            let gathered: Vec<[f32; BANDS]> = self
                .nodes
                .par_iter()
                .map(|node| {
                    let mut sum = [0.0f32; BANDS];
                    for link in &node.links {
                        let weight = link.form_factor * link.visibility;
                        let source = &self.nodes[link.source as usize].radiosity;
                        for (s, b) in sum.iter_mut().zip(source) {
                            *s += weight * b;
                        }
                    }
                    sum
                })
                .collect();
            let (change, largest) = self.push_pull(gathered);
            if change <= 1e-3 * largest {
                return iteration;
            }
        }
        200
    }

    /// Pushes what was gathered down to the leaves and pulls means up (REFERENCE §7.4). Returns the
    /// largest change of a leaf's radiosity, and the largest radiosity.
    pub fn push_pull(&mut self, mut gathered: Vec<[f32; BANDS]>) -> (f32, f32) {
        let (mut change, mut largest) = (0.0f32, 0.0f32);
        // Children stand after their parents: down in ascending order, up in descending.
        for i in 0..self.nodes.len() {
            if let Some(parent) = self.nodes[i].parent {
                let from_above = gathered[parent as usize];
                for (g, a) in gathered[i].iter_mut().zip(from_above) {
                    *g += a;
                }
            }
        }
        for i in (0..self.nodes.len()).rev() {
            let (mut radiosity, mut irradiance) = ([0.0; BANDS], [0.0; BANDS]);
            if let Some(first) = self.nodes[i].children {
                let area = self.nodes[i].area;
                for child in &self.nodes[first as usize..first as usize + 4] {
                    let share = child.area / area;
                    for b in 0..BANDS {
                        radiosity[b] += share * child.radiosity[b];
                        irradiance[b] += share * child.irradiance[b];
                    }
                }
            } else {
                irradiance = gathered[i];
                let patch = &self.patches[self.nodes[i].root as usize];
                for b in 0..BANDS {
                    radiosity[b] = patch.emission[b] + patch.reflectance[b] * irradiance[b];
                    change = change.max((radiosity[b] - self.nodes[i].radiosity[b]).abs());
                    largest = largest.max(radiosity[b]);
                }
            }
            self.nodes[i].radiosity = radiosity;
            self.nodes[i].irradiance = irradiance;
        }
        (change, largest)
    }

    /// Whether a link carries too much. Partly visible ones must be four times as fine, since they hold
    /// the shadows' edges; hidden ones may have been missed by all rays, so strong ones are tried again.
    fn is_coarse(&self, p: u32, link: &Link, power: f32) -> bool {
        let factor = match link.visibility {
            v if v <= 0.0 => 0.25,
            v if v < 1.0 => 4.0,
            _ => 1.0,
        };
        let node = &self.nodes[p as usize];
        let brightness = strongest(&self.nodes[link.source as usize].radiosity);
        factor * link.form_factor * brightness * node.area > power
    }

    /// Replaces links through which more than the allowed power passes by links between children, until
    /// none is left or an area or the number of links is at its limit. Returns the number of replaced links.
    pub fn refine(&mut self, refinement: &Refinement, visible: Visible<'_>) -> usize {
        let power = refinement.power * self.power;
        let area_min = refinement.area * self.total_area;
        let mut replaced = 0;
        let mut count = self.link_count();
        let mut candidates: Vec<u32> = (0..self.nodes.len() as u32).collect();
        while !candidates.is_empty() && count < refinement.links_max {
            // Which links, decided for all before anything changes.
            let coarse: Vec<(u32, Vec<Link>)> = candidates
                .par_iter()
                .map(|&p| {
                    let mut links = self.nodes[p as usize].links.clone();
                    links.retain(|l| self.is_coarse(p, l, power) && self.divided(p, l, area_min).is_some());
                    (p, links)
                })
                .filter(|(_, links)| !links.is_empty())
                .collect();
            let mut pairs = Vec::new();
            for (p, links) in &coarse {
                for link in links {
                    let Some(divides_source) = self.divided(*p, link, area_min) else { continue };
                    if divides_source {
                        let first = self.children_of(link.source);
                        pairs.extend((first..first + 4).map(|q| (*p, q, link.visibility)));
                    } else {
                        let first = self.children_of(*p);
                        pairs.extend((first..first + 4).map(|child| (child, link.source, link.visibility)));
                    }
                }
                let mut gone = links.iter().peekable();
                // `links` is a subsequence of the node's links.
                self.nodes[*p as usize].links.retain(|l| gone.next_if(|g| *g == l).is_none());
                replaced += links.len();
            }
            let links: Vec<Option<Link>> =
                pairs.par_iter().map(|&(p, q, above)| self.link(p, q, Some(above), visible)).collect();
            candidates.clear();
            for ((p, ..), link) in pairs.iter().zip(links) {
                if let Some(link) = link {
                    self.nodes[*p as usize].links.push(link);
                    candidates.push(*p);
                }
            }
            candidates.sort_unstable();
            candidates.dedup();
            count = self.link_count();
        }
        replaced
    }

    /// Whether to divide the source (`true`) or the receiver of a link, or neither: the one with the
    /// larger form factor seen from the other, that is the larger one.
    fn divided(&self, p: u32, link: &Link, area_min: f32) -> Option<bool> {
        let (receiver, source) = (self.nodes[p as usize].area, self.nodes[link.source as usize].area);
        if source > receiver && source > area_min {
            Some(true)
        } else if receiver > area_min {
            Some(false)
        } else {
            (source > area_min).then_some(true)
        }
    }

    /// The quadtrees for [`crate::radiosity::simplify`], in the order of `nodes`; `luminance` weights the
    /// bands. Elevations are 1: the caller knows the textures.
    pub fn forest(&self, luminance: [f32; BANDS]) -> Forest {
        let value = |radiosity: &[f32; BANDS]| {
            radiosity.iter().zip(luminance).map(|(b, w)| f64::from(b * w)).sum::<f64>()
        };
        let node = |n: &Node<BANDS>| QuadNode {
            parent: n.parent,
            children: n.children,
            area: f64::from(n.area),
            value: value(&n.radiosity),
            elevation: 1.0,
        };
        Forest { nodes: self.nodes.iter().map(node).collect() }
    }

    /// Gives some nodes the mean of their values.
    pub fn join(&mut self, nodes: &[u32]) {
        let (mut radiosity, mut irradiance, mut area) = ([0.0; BANDS], [0.0; BANDS], 0.0);
        for node in nodes.iter().map(|&n| &self.nodes[n as usize]) {
            area += node.area;
            for b in 0..BANDS {
                radiosity[b] += node.area * node.radiosity[b];
                irradiance[b] += node.area * node.irradiance[b];
            }
        }
        let mean = |sum: [f32; BANDS]| sum.map(|v| v / area.max(f32::MIN_POSITIVE));
        for &n in nodes {
            let node = &mut self.nodes[n as usize];
            (node.radiosity, node.irradiance) = (mean(radiosity), mean(irradiance));
        }
    }

    /// The quadtrees cut back: nodes that `is_leaf` names become leaves, and nothing is left below them. Links
    /// are not kept.
    pub fn cut(&self, is_leaf: &[bool]) -> Self {
        let mut place = vec![None; self.nodes.len()];
        let mut nodes: Vec<Node<BANDS>> = Vec::new();
        for (i, node) in self.nodes.iter().enumerate() {
            // Parents stand before their children, and siblings together.
            let kept_parent = node.parent.map(|p| (p as usize, place[p as usize]));
            if matches!(kept_parent, Some((p, new)) if new.is_none() || is_leaf[p]) {
                continue;
            }
            let index = nodes.len() as u32;
            place[i] = Some(index);
            let parent = kept_parent.and_then(|(_, new)| new);
            if let Some(parent) = parent {
                let children = &mut nodes[parent as usize].children;
                *children = Some(children.map_or(index, |c: u32| c.min(index)));
            }
            nodes.push(Node { parent, children: None, links: Vec::new(), ..node.clone() });
        }
        Self { nodes, ..self.clone_without_nodes() }
    }

    fn clone_without_nodes(&self) -> Self {
        Self {
            patches: self.patches.clone(),
            normals: self.normals.clone(),
            nodes: Vec::new(),
            total_area: self.total_area,
            power: self.power,
        }
    }

    /// The first child of a node, which is divided if it was not.
    pub(crate) fn children_of(&mut self, i: u32) -> u32 {
        if let Some(first) = self.nodes[i as usize].children {
            return first;
        }
        let first = self.nodes.len() as u32;
        let node = &mut self.nodes[i as usize];
        node.children = Some(first);
        let (root, radiosity, irradiance) = (node.root, node.radiosity, node.irradiance);
        let corners = subdivide(node.corners);
        self.nodes.extend(corners.map(|c| Node::new(c, root, Some(i), radiosity, irradiance)));
        first
    }

    /// Solves on coarse links, then on ever finer ones (multigridding), until `refinement` is met or
    /// `keep_going` (given the leaves and links so far) says no. Returns whether it was met.
    #[cfg(test)]
    fn solve_progressively(
        &mut self,
        refinement: &Refinement,
        visible: Visible<'_>,
        keep_going: &(dyn Fn(usize, usize) -> bool + Sync),
    ) -> bool {
        self.solve();
        let mut power = refinement.power.max(1e-9) * 256.0;
        while keep_going(self.leaf_count(), self.link_count()) {
            self.refine(&Refinement { power, ..*refinement }, visible);
            self.solve();
            if power <= refinement.power {
                return true;
            }
            power = (power * 0.25).max(refinement.power);
        }
        false
    }
}

impl<const BANDS: usize> Node<BANDS> {
    fn new(
        corners: [Vec3; 3],
        root: u32,
        parent: Option<u32>,
        radiosity: [f32; BANDS],
        irradiance: [f32; BANDS],
    ) -> Self {
        let area = 0.5 * (corners[1] - corners[0]).cross(corners[2] - corners[0]).length();
        Self { corners, area, root, parent, children: None, radiosity, irradiance, links: Vec::new() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illumination::test_scenes::cube;

    fn room<const BANDS: usize>(
        reflectance: [f32; BANDS],
        emission: impl Fn(Vec3) -> [f32; BANDS],
    ) -> Vec<Patch<BANDS>> {
        let mesh = cube(Vec3::ZERO, 1.0, false);
        (0..mesh.triangles.len() as u32)
            .map(|t| {
                let corners = mesh.corners(t);
                let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
                Patch { corners, reflectance, emission: emission(normal) }
            })
            .collect()
    }

    fn all_visible(_: Vec3, _: Vec3) -> bool {
        true
    }

    #[test]
    fn push_pull_has_the_references_numbers() {
        let patch = Patch { corners: [Vec3::ZERO, Vec3::X, Vec3::Y], reflectance: [0.5], emission: [0.1] };
        let mut solution = Radiosity::new(vec![patch], &all_visible).unwrap();
        solution.children_of(0);
        solution.push_pull(vec![[1.0], [0.0], [0.4], [0.8], [0.0]]);
        let leaves: Vec<f32> = solution.nodes[1..].iter().map(|n| n.radiosity[0]).collect();
        for (found, exact) in leaves.iter().zip([0.6, 0.8, 1.0, 0.6]) {
            assert!((found - exact).abs() < 1e-6);
        }
        assert!((solution.nodes[0].radiosity[0] - 0.75).abs() < 1e-6);
    }

    fn solved<const BANDS: usize>(patches: Vec<Patch<BANDS>>) -> Radiosity<BANDS> {
        let mut solution = Radiosity::new(patches, &all_visible).unwrap();
        let refinement = Refinement { power: 3e-5, area: 1e-4, links_max: 2_000_000 };
        assert!(solution.solve_progressively(&refinement, &all_visible, &|_, _| true));
        solution
    }

    #[test]
    fn a_closed_furnace_has_its_closed_form_in_every_band() {
        let reflectance = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8];
        let solution = solved(room(reflectance, |_| [1.0; 8]));
        for root in &solution.nodes[..12] {
            for (b, rho) in root.radiosity.iter().zip(reflectance) {
                let exact = 1.0 / (1.0 - rho);
                // The form factors of touching walls are low by about 1 %, which each reflection repeats.
                assert!((b / exact - 1.0).abs() < 0.015 * rho / (1.0 - rho) + 1e-4, "{rho}: {b}");
            }
        }
    }

    #[test]
    fn a_cube_lit_by_its_ceiling_has_its_means_per_face() {
        let solution = solved(room([0.5], |n| [if n.y < -0.5 { 1.0 } else { 0.0 }]));
        // Radiosity that is constant per face has 1.090909, .181746, .181837 (REFERENCE §6.6); with 12 × 12
        // patches per face and exact form factors, extrapolated, the means are these. The sum is exact.
        for face in 0..6 {
            let mean =
                (solution.nodes[2 * face].radiosity[0] + solution.nodes[2 * face + 1].radiosity[0]) / 2.0;
            let exact = match face {
                2 => 0.1713,
                3 => 1.1040,
                _ => 0.1811,
            };
            assert!((mean / exact - 1.0).abs() < 0.02, "{face}: {mean} {exact}");
        }
        let all: f32 = solution.nodes[..12].iter().map(|n| n.radiosity[0] / 2.0).sum();
        assert!((all / 2.0 - 1.0).abs() < 0.01, "{all}");
    }

    #[test]
    fn a_solution_can_be_simplified_to_any_number_of_elements() {
        use crate::radiosity::simplify::{Criterion, simplify};
        let solution = solved(room([0.5, 0.5, 0.5], |n| [if n.y < -0.5 { 1.0 } else { 0.0 }; 3]));
        let forest = solution.forest([0.2, 0.7, 0.1]);
        assert_eq!(forest.leaf_count(), solution.leaf_count());
        let mut last = f64::INFINITY;
        for k in [20, 61, 200] {
            let cut = simplify(&forest, k, &Criterion::Optimal);
            assert_eq!(cut.elements, k);
            assert!(cut.squared_error < last);
            last = cut.squared_error;
        }
    }

    #[test]
    fn refinement_adds_links_linearly_in_leaves_and_the_same_for_any_thread_count() {
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| solved(room([0.5], |n| [if n.y < -0.5 { 1.0 } else { 0.0 }])))
        };
        let (one, three) = (run(1), run(3));
        assert_eq!(one.nodes, three.nodes);
        assert!(one.link_count() < 200 * one.leaf_count(), "{} {}", one.link_count(), one.leaf_count());
    }

    #[test]
    fn too_many_polygons_are_refused_in_words() {
        let patch = Patch { corners: [Vec3::ZERO, Vec3::X, Vec3::Y], reflectance: [0.5], emission: [0.1] };
        assert!(Radiosity::new(vec![patch; ROOTS_MAX + 1], &all_visible).unwrap_err().contains("too many"));
    }
}
