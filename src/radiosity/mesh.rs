//! A radiosity solution as a continuous irradiance: restricted quadtrees, vertex values, no cracks
//! (REFERENCE §7.5).

use std::collections::BTreeMap;

use glam::Vec3;

use super::Radiosity;
use crate::illumination::Irradiance;

/// Leaves share a vertex where their normals are within 25°.
const SMOOTH_COSINE: f32 = 0.906;

/// Positions of vertices as keys. Midpoints have the same bits from both sides of an edge, since addition
/// commutes.
type VertexKey = [u32; 3];

fn key(p: Vec3) -> VertexKey {
    (p + 0.0).to_array().map(f32::to_bits)
}

/// A node for lookups: children, or the vertices of a leaf.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Cell {
    Inner(u32),
    Leaf([u32; 3]),
}

/// Which root holds a triangle's front and back, or `NONE`.
const NONE: u32 = u32::MAX;

/// Irradiance at the vertices of a radiosity mesh, interpolated linearly over its leaves.
#[derive(Clone, Debug)]
pub struct RadiosityMesh {
    cells: Vec<Cell>,
    /// Per cell the leaf that it was or belonged to before neighbours were made alike.
    elements: Vec<u32>,
    vertices: Vec<Vec3>,
    /// Per triangle of the scene the roots of its front and back.
    roots: Vec<[u32; 2]>,
}

impl<const BANDS: usize> Radiosity<BANDS> {
    /// Divides leaves until neighbours differ by one level at most. New leaves take their parent's values.
    pub fn restrict(&mut self) {
        loop {
            let vertices: std::collections::BTreeSet<VertexKey> =
                self.nodes.iter().filter(|n| n.children.is_none()).flat_map(|n| n.corners.map(key)).collect();
            let has_quarter_point = |[a, b]: [Vec3; 2]| {
                let middle = (a + b) * 0.5;
                vertices.contains(&key(middle))
                    && [a, b].iter().any(|&end| vertices.contains(&key((end + middle) * 0.5)))
            };
            let uneven: Vec<u32> = (0..self.nodes.len() as u32)
                .filter(|&i| {
                    let node = &self.nodes[i as usize];
                    let [a, b, c] = node.corners;
                    node.children.is_none() && [[a, b], [b, c], [c, a]].into_iter().any(has_quarter_point)
                })
                .collect();
            if uneven.is_empty() {
                return;
            }
            for i in uneven {
                self.children_of(i);
            }
        }
    }
}

impl RadiosityMesh {
    /// A continuous irradiance from the solution for `scene_triangles` triangles. `owners` says for each patch
    /// which triangle and which side it is; a back's corners are the triangle's with the last two swapped.
    pub fn new(solution: &mut Radiosity<3>, owners: &[(u32, bool)], scene_triangles: usize) -> Self {
        let mut elements: Vec<u32> = (0..solution.nodes.len() as u32).collect();
        solution.restrict();
        let solution = &*solution;
        for node in &solution.nodes[elements.len()..] {
            elements.push(node.parent.map_or(0, |parent| elements[parent as usize]));
        }
        let mut groups: BTreeMap<VertexKey, Vec<(Vec3, u32)>> = BTreeMap::new();
        let mut sums: Vec<(Vec3, f32)> = Vec::new();
        let mut leaf_vertices = vec![[NONE; 3]; solution.nodes.len()];
        for (i, node) in solution.nodes.iter().enumerate().filter(|(_, n)| n.children.is_none()) {
            let normal = solution.normals[node.root as usize];
            for (k, corner) in node.corners.into_iter().enumerate() {
                let group = groups.entry(key(corner)).or_default();
                let v = match group.iter().find(|(n, _)| n.dot(normal) > SMOOTH_COSINE) {
                    Some(&(_, v)) => v,
                    None => {
                        let v = sums.len() as u32;
                        sums.push((Vec3::ZERO, 0.0));
                        group.push((normal, v));
                        v
                    }
                };
                leaf_vertices[i][k] = v;
                let sum = &mut sums[v as usize];
                // By angle, so that a vertex does not depend on how its surroundings are divided.
                let others = [node.corners[(k + 1) % 3] - corner, node.corners[(k + 2) % 3] - corner];
                let angle = others[0].angle_between(others[1]);
                let weight = if angle.is_finite() { angle.max(1e-6) } else { 1e-6 };
                sum.0 += weight * Vec3::from_array(node.irradiance);
                sum.1 += weight;
            }
        }
        let mut vertices: Vec<Vec3> = sums.iter().map(|(v, w)| *v / w.max(1e-30)).collect();
        settle_hanging(solution, &groups, &leaf_vertices, &mut vertices);
        let cells = solution
            .nodes
            .iter()
            .zip(leaf_vertices)
            .map(|(node, v)| node.children.map_or(Cell::Leaf(v), Cell::Inner))
            .collect();
        let mut roots = vec![[NONE; 2]; scene_triangles];
        for (i, &(t, back)) in owners.iter().enumerate() {
            if let Some(sides) = roots.get_mut(t as usize) {
                sides[usize::from(back)] = i as u32;
            }
        }
        Self { cells, elements, vertices, roots }
    }

    /// Leaves.
    pub fn leaf_count(&self) -> usize {
        self.cells.iter().filter(|c| matches!(c, Cell::Leaf(_))).count()
    }

    /// Root and barycentrics there of a point on a side of a triangle.
    fn place(&self, triangle: u32, b1: f32, b2: f32, back: bool) -> Option<(u32, [f32; 3])> {
        let root = self.roots.get(triangle as usize)?[usize::from(back)];
        let b0 = 1.0 - b1 - b2;
        (root != NONE).then_some((root, if back { [b0, b2, b1] } else { [b0, b1, b2] }))
    }

    /// The element, a leaf of the solution, that holds a point on a side of a triangle.
    pub fn element_at(&self, triangle: u32, b1: f32, b2: f32, back: bool) -> Option<u32> {
        let (root, b) = self.place(triangle, b1, b2, back)?;
        Some(self.elements[self.leaf(root, b).0 as usize])
    }

    /// Value at barycentrics of a root.
    fn at(&self, root: u32, b: [f32; 3]) -> Vec3 {
        let (_, v, b) = self.leaf(root, b);
        (0..3).map(|k| self.vertices[v[k] as usize] * b[k].max(0.0)).sum()
    }

    /// The cell of a point of a root, its vertices, and barycentrics there.
    fn leaf(&self, root: u32, mut b: [f32; 3]) -> (u32, [u32; 3], [f32; 3]) {
        let mut cell = root;
        loop {
            match self.cells[cell as usize] {
                Cell::Leaf(v) => return (cell, v, b),
                // A corner's child has its own coordinate above one half; the middle one is turned.
                Cell::Inner(first) => match b.iter().position(|&x| x >= 0.5) {
                    Some(k) => {
                        b = b.map(|x| 2.0 * x);
                        b[k] -= 1.0;
                        cell = first + k as u32;
                    }
                    None => {
                        b = b.map(|x| 1.0 - 2.0 * x);
                        cell = first + 3;
                    }
                },
            }
        }
    }
}

/// A vertex in the middle of a coarser leaf's edge takes the mean of the edge's ends: then both sides of
/// the edge show the same. Longest edges first, so that the ends are settled.
fn settle_hanging<const BANDS: usize>(
    solution: &Radiosity<BANDS>,
    groups: &BTreeMap<VertexKey, Vec<(Vec3, u32)>>,
    leaf_vertices: &[[u32; 3]],
    vertices: &mut [Vec3],
) {
    let mut hanging: Vec<(f32, u32, [u32; 2])> = Vec::new();
    for (i, node) in solution.nodes.iter().enumerate().filter(|(_, n)| n.children.is_none()) {
        let normal = solution.normals[node.root as usize];
        for k in 0..3 {
            let (a, b) = (node.corners[k], node.corners[(k + 1) % 3]);
            let Some(group) = groups.get(&key((a + b) * 0.5)) else { continue };
            if let Some(&(_, v)) = group.iter().find(|(n, _)| n.dot(normal) > SMOOTH_COSINE) {
                let ends = [leaf_vertices[i][k], leaf_vertices[i][(k + 1) % 3]];
                hanging.push((a.distance_squared(b), v, ends));
            }
        }
    }
    hanging.sort_by(|x, y| y.0.total_cmp(&x.0).then(x.1.cmp(&y.1)).then(x.2.cmp(&y.2)));
    for (_, v, [a, b]) in hanging {
        vertices[v as usize] = (vertices[a as usize] + vertices[b as usize]) * 0.5;
    }
}

impl Irradiance for RadiosityMesh {
    fn irradiance(&self, triangle: u32, b1: f32, b2: f32, back: bool) -> Vec3 {
        self.place(triangle, b1, b2, back).map_or(Vec3::ZERO, |(root, b)| self.at(root, b))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Patch, Refinement};
    use super::*;
    use crate::illumination::test_scenes::cube;

    #[test]
    fn irradiance_is_continuous_over_every_edge_and_near_the_leaves() {
        let mesh = cube(Vec3::ZERO, 1.0, false);
        let patches: Vec<Patch<3>> = (0..12)
            .map(|t| Patch {
                corners: mesh.corners(t),
                reflectance: [0.5, 0.3, 0.1],
                emission: [if t == 6 { 1.0 } else { 0.0 }; 3],
            })
            .collect();
        let owners: Vec<(u32, bool)> = (0..12).map(|t| (t, false)).collect();
        let mut solution = Radiosity::new(patches, &|_, _| true).unwrap();
        let refinement = Refinement { power: 1e-4, area: 1e-3, links_max: 1_000_000 };
        solution.solve_progressively(&refinement, &|_, _| true, &|_, _| true);
        let before = solution.leaf_count();
        let map = RadiosityMesh::new(&mut solution, &owners, 12);
        assert!(map.leaf_count() >= before);
        // Along a fine line over the floor (triangles 4 and 5) steps stay small, also over edges of leaves of
        // unlike levels and over the diagonal.
        let floor = |x: f32, z: f32| {
            for t in [4u32, 5] {
                let [a, b, c] = mesh.corners(t);
                let n = (b - a).cross(c - a);
                let p = Vec3::new(x, 0.0, z);
                let b1 = (p - a).cross(c - a).dot(n) / n.length_squared();
                let b2 = (b - a).cross(p - a).dot(n) / n.length_squared();
                if b1 >= 0.0 && b2 >= 0.0 && b1 + b2 <= 1.0 {
                    return map.irradiance(t, b1, b2, false).x;
                }
            }
            f32::NAN
        };
        let mut last = f32::NAN;
        let mut largest = 0.0f32;
        for i in 1..4000 {
            let x = i as f32 / 4000.0;
            let value = floor(x, 0.3 + 0.37 * x);
            if value.is_finite() && last.is_finite() {
                largest = largest.max((value - last).abs());
            }
            last = value;
        }
        assert!(largest < 2e-3, "{largest}");
        assert_eq!(map.irradiance(4, 0.3, 0.3, true), Vec3::ZERO);
        assert_eq!(map.irradiance(99, 0.3, 0.3, false), Vec3::ZERO);
        let mean: f32 =
            (0..100).map(|i| floor((i % 10) as f32 / 10.0 + 0.05, (i / 10) as f32 / 10.0 + 0.047)).sum();
        let exact = (solution.nodes[4].irradiance[0] + solution.nodes[5].irradiance[0]) / 2.0;
        assert!((mean / 100.0 / exact - 1.0).abs() < 0.03, "{mean} {exact}");
    }
}
