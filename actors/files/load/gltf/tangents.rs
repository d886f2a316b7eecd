//! Tangents for normal maps of meshes that come without (MikkTSpace, as glTF 2.0 §3.7.2.1 asks for): normal maps are baked for
//! these.

use std::collections::HashMap;

use bevy_mikktspace::{Geometry, Ops, TangentSpace, generate_tangents};
use glam::{Mat2, Vec2, Vec3, Vec4};

use super::meshes::Part;
use foveal::math;

/// What tangents follow from: a set of coordinates, and how the map moves it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Along {
    pub set: usize,
    /// From the upper left.
    pub linear: Mat2,
}

/// The part with tangents; vertices at which several meet are there several times. `None` where it has no such coordinates.
pub(super) fn with_tangents(part: &Part, along: Along) -> Option<Part> {
    let set = part.uvs.get(along.set).filter(|set| !set.is_empty())?;
    let moved = |uv: &Vec2| {
        let uv = along.linear * *uv;
        if uv.is_finite() { Vec2::new(uv.x, 1.0 - uv.y) } else { Vec2::ZERO }
    };
    let mut faces = Faces { part, uvs: set.iter().map(moved).collect(), found: Vec::new() };
    faces.found = vec![[Vec4::ZERO; 3]; part.triangles.len()];
    // There is no kind of error yet.
    generate_tangents(&mut faces).ok()?;
    let found = faces.found;
    let mut places: HashMap<(u32, [u32; 4]), u32> = HashMap::new();
    let (mut kept, mut tangents) = (Vec::new(), Vec::new());
    let mut triangles = Vec::with_capacity(part.triangles.len());
    for (corners, found) in part.triangles.iter().zip(found) {
        triangles.push(std::array::from_fn(|c| {
            let (vertex, tangent) = (corners[c], found[c]);
            *places.entry((vertex, tangent.to_array().map(f32::to_bits))).or_insert_with(|| {
                kept.push(vertex);
                tangents.push(tangent);
                kept.len() as u32 - 1
            })
        }));
    }
    Some(Part { triangles, tangents, ..part.vertices(&kept) })
}

/// Corners of triangles as the algorithm asks for them.
struct Faces<'a> {
    part: &'a Part,
    uvs: Vec<Vec2>,
    found: Vec<[Vec4; 3]>,
}

/// Numbers with the same bits everywhere.
struct Exact;

impl Ops for Exact {
    fn sqrt(x: f32) -> f32 {
        x.sqrt()
    }

    fn acos(x: f32) -> f32 {
        math::acos(x)
    }
}

fn finite(v: Vec3) -> Vec3 {
    if v.is_finite() { v } else { Vec3::ZERO }
}

impl Geometry<Exact> for Faces<'_> {
    fn num_faces(&self) -> usize {
        self.part.triangles.len()
    }

    fn num_vertices_of_face(&self, _: usize) -> usize {
        3
    }

    fn position(&self, face: usize, corner: usize) -> [f32; 3] {
        finite(self.part.positions[self.part.triangles[face][corner] as usize]).to_array()
    }

    fn normal(&self, face: usize, corner: usize) -> [f32; 3] {
        let own = finite(self.part.normals[self.part.triangles[face][corner] as usize]);
        if own != Vec3::ZERO {
            return own.to_array();
        }
        let [a, b, c] = self.part.triangles[face].map(|v| finite(self.part.positions[v as usize]));
        (b - a).cross(c - a).normalize_or(Vec3::Z).to_array()
    }

    fn tex_coord(&self, face: usize, corner: usize) -> [f32; 2] {
        self.uvs[self.part.triangles[face][corner] as usize].to_array()
    }

    fn set_tangent(&mut self, found: Option<TangentSpace>, face: usize, corner: usize) {
        let tangent = found.map_or(Vec4::ZERO, |t| Vec4::from(t.tangent_encoded()));
        self.found[face][corner] = if tangent.is_finite() { tangent } else { Vec4::ZERO };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALONG: Along = Along { set: 0, linear: Mat2::IDENTITY };

    /// A quad in the plane z = 0 whose u goes along `u` and whose v, from below, goes along `v`.
    fn quad(u: Vec2, v: Vec2) -> Part {
        let corners = [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y];
        Part {
            positions: corners.map(|c| c.extend(0.0)).to_vec(),
            normals: vec![Vec3::Z; 4],
            uvs: [corners.map(|c| Vec2::new(c.dot(u), 1.0 - c.dot(v))).to_vec(), Vec::new()],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Part::default()
        }
    }

    #[test]
    fn tangents_go_along_u_and_their_sign_says_where_v_goes() {
        for (u, v) in [(Vec2::X, Vec2::Y), (Vec2::X, -Vec2::Y), (-Vec2::Y, Vec2::X), (Vec2::Y, Vec2::X)] {
            let made = with_tangents(&quad(u, v), ALONG).unwrap();
            assert_eq!((made.positions.len(), made.triangles.len()), (4, 2));
            for t in made.tangents {
                assert!((t.truncate() - u.extend(0.0)).length() < 1e-6, "{t}");
                let bitangent = Vec3::Z.cross(t.truncate()) * t.w;
                assert!((bitangent - v.extend(0.0)).length() < 1e-6, "{u} {v} {bitangent}");
            }
        }
        assert!(with_tangents(&quad(Vec2::X, Vec2::Y), Along { set: 1, ..ALONG }).is_none());
    }

    #[test]
    fn mirrored_halves_part_at_their_seam() {
        let mut part = quad(Vec2::X, Vec2::Y);
        // The second triangle's picture is turned over; corners 0 and 2 are common.
        part.uvs[0] = vec![Vec2::ZERO, Vec2::new(1.0, 0.0), Vec2::ONE, Vec2::new(1.0, 0.0)];
        let made = with_tangents(&part, ALONG).unwrap();
        assert_eq!(made.positions.len(), 6);
        let signs: Vec<f32> = made.triangles.iter().map(|t| made.tangents[t[0] as usize].w).collect();
        assert_eq!(signs[0], -signs[1]);
    }

    #[test]
    fn any_numbers_give_some_tangents() {
        for bad in [f32::NAN, f32::INFINITY, -1e38, 0.0] {
            let mut part = quad(Vec2::X, Vec2::Y);
            part.positions[1].x = bad;
            part.uvs[0][2].x = bad;
            part.normals[0] = Vec3::ZERO;
            let made = with_tangents(&part, ALONG).unwrap();
            assert!(made.tangents.iter().all(|t| t.is_finite()));
        }
    }
}
