//! Vertex elements of dense meshes: corners at one position share an element where the surface is smooth.

use glam::Vec3;
use rayon::prelude::*;

use super::atlas::Element;
use crate::scene::Mesh;

/// Corners share an element while their face normals are within 40° of the first one's, so that a
/// vertex on a crease has one value for each side of it.
const SMOOTH_COSINE: f32 = 0.766;
/// How far the point at which direct light is gathered is drawn from the corner into its triangle:
/// a vertex on the edge of another surface would be half in its shadow.
const INSET: f32 = 0.1;

/// For each triangle of `part` its three elements, and the elements. `sizes` holds the longest edge
/// and the area of every triangle of `mesh`. Each element has a third of its triangles' areas.
pub fn smooth_corners(mesh: &Mesh, part: &[u32], sizes: &[(f32, f32)]) -> (Vec<[u32; 3]>, Vec<Element>) {
    let normals: Vec<Vec3> = part
        .par_iter()
        .map(|&t| {
            let [a, b, c] = mesh.corners(t);
            (b - a).cross(c - a).normalize_or_zero()
        })
        .collect();
    // Corners at one position become neighbours, in corner order; positions by their bits. Fewer vertices than corners
    // need to be sorted for that.
    let vertex =
        |corner: u32| mesh.triangles[part[corner as usize / 3] as usize][corner as usize % 3] as usize;
    // + 0.0 so that −0 and 0 are one position
    let position = |v: usize| mesh.positions[v].to_array().map(|x| (x + 0.0).to_bits());
    let corner_count = part.len() as u32 * 3;
    let mut is_used = vec![false; mesh.positions.len()];
    (0..corner_count).for_each(|c| is_used[vertex(c)] = true);
    let mut vertices: Vec<([u32; 3], u32)> =
        (0..is_used.len()).into_par_iter().filter(|&v| is_used[v]).map(|v| (position(v), v as u32)).collect();
    vertices.par_sort_unstable();
    let mut rank = vec![0u32; mesh.positions.len()];
    let mut positions: Vec<[u32; 3]> = Vec::new();
    for &(position, v) in &vertices {
        if positions.last() != Some(&position) {
            positions.push(position);
        }
        rank[v as usize] = positions.len() as u32 - 1;
    }
    let mut next = vec![0u32; positions.len() + 1];
    (0..corner_count).for_each(|c| next[rank[vertex(c)] as usize + 1] += 1);
    for i in 1..next.len() {
        next[i] += next[i - 1];
    }
    let mut corners = vec![(0u32, 0u32); corner_count as usize];
    for c in 0..corner_count {
        let r = rank[vertex(c)];
        corners[next[r as usize] as usize] = (r, c);
        next[r as usize] += 1;
    }

    let mut assigned = vec![[0u32; 3]; part.len()];
    let mut elements: Vec<Element> = Vec::new();
    let mut first_normals: Vec<Vec3> = Vec::new();
    let mut largest: Vec<f32> = Vec::new();
    let mut group_start = 0;
    for (i, &(rank, corner)) in corners.iter().enumerate() {
        if i > 0 && rank != corners[i - 1].0 {
            group_start = elements.len();
        }
        let (t, k) = (corner as usize / 3, corner as usize % 3);
        let normal = normals[t];
        let mut group = group_start..elements.len();
        let found = match normal == Vec3::ZERO {
            // A triangle without area has no side: any element at the position will do.
            true => group.next(),
            false => group.find(|&e| first_normals[e].dot(normal) > SMOOTH_COSINE),
        };
        let e = found.unwrap_or_else(|| {
            elements.push(Element {
                position: Vec3::from_array(positions[rank as usize].map(f32::from_bits)),
                ..Element::default()
            });
            first_normals.push(normal);
            largest.push(-1.0);
            elements.len() - 1
        });
        let area = sizes[part[t] as usize].1 / 3.0;
        let element = &mut elements[e];
        element.area += area;
        element.normal += normal * area;
        if area > largest[e] {
            largest[e] = area;
            let b = [0, 1, 2].map(|corner| if corner == k { 1.0 - 2.0 * INSET } else { INSET });
            (element.triangle, element.b1, element.b2) = (part[t], b[1], b[2]);
        }
        assigned[t][k] = e as u32;
    }
    for element in &mut elements {
        element.normal = element.normal.normalize_or_zero();
        element.opaque = element.area;
    }
    (assigned, elements)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illumination::test_scenes::cube;

    #[test]
    fn a_cube_with_shared_corners_has_three_elements_per_corner() {
        let mesh = cube(Vec3::ZERO, 1.0, true);
        let part: Vec<u32> = (0..12).collect();
        let sizes = vec![(2f32.sqrt(), 0.5); 12];
        let (corners, elements) = smooth_corners(&mesh, &part, &sizes);
        assert_eq!(elements.len(), 24);
        assert!((elements.iter().map(|e| e.area).sum::<f32>() - 6.0).abs() < 1e-5);
        for (t, c) in corners.iter().enumerate() {
            let [a, b, d] = mesh.corners(t as u32);
            let n = (b - a).cross(d - a).normalize();
            assert!(c.iter().all(|&e| elements[e as usize].normal.dot(n) > 0.999));
        }
    }
}
