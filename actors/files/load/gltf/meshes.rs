//! Primitives to triangles.

use std::borrow::Cow;
use std::collections::HashMap;

use glam::{DMat3, DMat4, Vec2, Vec3, Vec4};

use super::accessor::Accessors;
use super::document::Primitive;
use super::number::Index;
use super::{Oddities, Problem};

/// What one primitive draws, in the space of its node.
#[derive(Clone, Debug, Default)]
pub(super) struct Part {
    pub positions: Vec<Vec3>,
    /// Unit, or zero where the file gave none.
    pub normals: Vec<Vec3>,
    /// Sets 0 and 1 as in the file, from the upper left; empty where there are none.
    pub uvs: [Vec<Vec2>; 2],
    /// Factors of the base colour, linear, in [0, 1]; empty where there are none.
    pub colors: Vec<[f32; 4]>,
    /// Unit, with the sign of the bitangent; empty where there are none.
    pub tangents: Vec<Vec4>,
    pub triangles: Vec<[u32; 3]>,
}

/// Where a node puts a part.
pub(super) struct Stands {
    pub positions: Vec<Vec3>,
    pub normals: Vec<Vec3>,
    pub tangents: Vec<Vec4>,
    /// Whether triangles are turned round.
    pub turned: bool,
}

/// Reads a primitive; `None` where it draws no triangles.
pub(super) fn read(
    primitive: &Primitive,
    accessors: &mut Accessors<'_, '_>,
    odd: &mut Oddities,
) -> Result<Option<Part>, Problem> {
    let mode = primitive.mode.map_or(4, |m| m.0);
    if mode < 4 {
        odd.count("points and lines", "not drawn");
        return Ok(None);
    }
    #[cfg(feature = "draco")]
    super::draco::decode(primitive, accessors)?;
    #[cfg(not(feature = "draco"))]
    if primitive.extensions.draco.is_some() {
        // Where the extension is not required there are plain accessors beside it.
        odd.count("KHR_draco_mesh_compression", "not read; the uncompressed mesh beside it is shown");
    }
    let Some(position) = primitive.attributes.position else {
        odd.count("a primitive without POSITION", "not drawn");
        return Ok(None);
    };
    if [Some(position), primitive.indices].into_iter().flatten().any(|i| accessors.is_placeholder(i)) {
        odd.count("a mesh whose buffer names no file", "not drawn");
        return Ok(None);
    }
    let positions: Vec<Vec3> =
        accessors.floats::<3>(position, "positions")?.into_iter().map(Vec3::from).collect();
    let count = positions.len();
    let vertices = |index: Option<Index>, odd: &mut Oddities| -> Result<Option<Index>, Problem> {
        let Some(index) = index else { return Ok(None) };
        if accessors.is_placeholder(index) {
            return Ok(None);
        }
        if accessors.count(index)? == count as u64 {
            return Ok(Some(index));
        }
        odd.count("an attribute of another length than POSITION", "done without");
        Ok(None)
    };
    let a = &primitive.attributes;
    let (normal, tangent) = (vertices(a.normal, odd)?, vertices(a.tangent, odd)?);
    let (uv0, uv1) = (vertices(a.uv0, odd)?, vertices(a.uv1, odd)?);
    let colors = match vertices(a.color, odd)? {
        None => Vec::new(),
        Some(index) => accessors.colors(index)?,
    };
    let normals = match normal {
        None => vec![Vec3::ZERO; count],
        // A normal of any length is meant as a direction; NaN and zero mean a flat face.
        Some(n) => {
            let read = accessors.floats::<3>(n, "normals")?;
            read.into_iter().map(|n| Vec3::from(n).normalize_or_zero()).collect()
        }
    };
    let tangents = match tangent {
        None => Vec::new(),
        Some(index) => {
            let read = accessors.floats::<4>(index, "tangents")?;
            let unit = |t: [f32; 4]| {
                let [x, y, z, w] = t;
                let along = Vec3::new(x, y, z).normalize_or_zero();
                along.extend(if along == Vec3::ZERO { 0.0 } else { w.signum() })
            };
            read.into_iter().map(unit).collect()
        }
    };
    let mut set = |index: Option<Index>| -> Result<Vec<Vec2>, Problem> {
        let Some(index) = index else { return Ok(Vec::new()) };
        let read = accessors.floats::<2>(index, "texture coordinates")?;
        Ok(read.into_iter().map(|uv| finite(Vec2::from(uv))).collect())
    };
    let uvs = [set(uv0)?, set(uv1)?];
    let triangles = match primitive.indices {
        None => triangles(mode, count, |i| i as u32),
        Some(index) => {
            let indices = accessors.indices(index)?;
            triangles(mode, indices.len(), |i| indices[i])
        }
    };
    let all = triangles.len();
    let triangles: Vec<[u32; 3]> =
        triangles.into_iter().filter(|t| t.iter().all(|&v| (v as usize) < count)).collect();
    if triangles.len() < all {
        odd.add("triangle with an index that is no vertex", "left out", all - triangles.len());
    }
    Ok(Some(Part { positions, normals, uvs, colors, tangents, triangles }))
}

/// As texture coordinates are kept: what is not finite is zero.
pub(super) fn finite(uv: Vec2) -> Vec2 {
    if uv.is_finite() { uv } else { Vec2::ZERO }
}

/// The triangles of a list (4), strip (5) or fan (6) of `count` corners, all wound the same way.
fn triangles(mode: u32, count: usize, corner: impl Fn(usize) -> u32) -> Vec<[u32; 3]> {
    let of = |a: usize, b: usize, c: usize| [corner(a), corner(b), corner(c)];
    match mode {
        5 => (2..count).map(|i| if i % 2 == 0 { of(i - 2, i - 1, i) } else { of(i - 1, i - 2, i) }).collect(),
        6 => (2..count).map(|i| of(0, i - 1, i)).collect(),
        _ => (0..count / 3).map(|i| of(3 * i, 3 * i + 1, 3 * i + 2)).collect(),
    }
}

/// Colours that one primitive is split into.
const SHADES_MAX: usize = 256;

/// A linear colour of eight bits each, opacity last.
pub(super) type Shade = [u8; 4];

/// What changes nothing.
const WHITE: Shade = [255; 4];

impl Part {
    /// The part by the mean colours of its triangles' corners, as fine as [`SHADES_MAX`] allows, in the order of first use.
    pub fn shades(&self) -> Vec<(Shade, Cow<'_, Self>)> {
        if self.colors.is_empty() {
            return vec![(WHITE, Cow::Borrowed(self))];
        }
        let mean = |t: &[u32; 3]| -> Shade {
            std::array::from_fn(|c| {
                let sum: f32 = t.iter().map(|&v| self.colors[v as usize][c]).sum();
                (sum / 3.0 * 255.0 + 0.5).clamp(0.0, 255.0) as u8
            })
        };
        let means: Vec<Shade> = self.triangles.iter().map(mean).collect();
        // Fewer and fewer steps until there are few enough.
        for steps in [255u32, 63, 31, 15, 7, 3] {
            let coarse = |v: u8| ((u32::from(v) * steps + 127) / 255 * 255 / steps) as u8;
            let mut place: HashMap<Shade, usize> = HashMap::new();
            let mut shades: Vec<(Shade, Vec<[u32; 3]>)> = Vec::new();
            for (t, color) in self.triangles.iter().zip(&means) {
                let color = color.map(coarse);
                let at = *place.entry(color).or_insert_with(|| {
                    shades.push((color, Vec::new()));
                    shades.len() - 1
                });
                shades[at].1.push(*t);
                if shades.len() > SHADES_MAX {
                    break;
                }
            }
            // Three steps of four channels are 256 colours.
            if shades.len() <= SHADES_MAX {
                if let [(color, _)] = shades.as_slice() {
                    return vec![(*color, Cow::Borrowed(self))];
                }
                return shades.into_iter().map(|(c, t)| (c, Cow::Owned(self.only(&t)))).collect();
            }
        }
        vec![(WHITE, Cow::Borrowed(self))]
    }

    /// Whether it is no body: more than a hundredth of its edges has a triangle on one side only.
    pub fn is_open(&self) -> bool {
        /// Edges with a triangle on one side, to all of them.
        const OPEN: f32 = 0.01;
        /// Parts of the body's size within which vertices are at one place.
        const PLACES: f32 = 65_536.0;
        let (low, high) = self
            .positions
            .iter()
            .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| (low.min(*p), high.max(*p)));
        let step = PLACES / (high - low).max_element().max(f32::MIN_POSITIVE);
        // Vertices at one place are one, whatever else they have.
        let place = |v: u32| ((self.positions[v as usize] - low) * step).round().to_array().map(|c| c as i64);
        let mut sides: HashMap<[[i64; 3]; 2], u32> = HashMap::new();
        for &[a, b, c] in &self.triangles {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                let mut edge = [place(from), place(to)];
                edge.sort_unstable();
                *sides.entry(edge).or_default() += 1;
            }
        }
        let open = sides.values().filter(|n| **n == 1).count();
        open as f32 > OPEN * sides.len() as f32
    }

    /// These triangles, and the vertices that they use.
    fn only(&self, triangles: &[[u32; 3]]) -> Self {
        let mut place: HashMap<u32, u32> = HashMap::new();
        let mut kept: Vec<u32> = Vec::new();
        let mut renamed = |v: u32| {
            *place.entry(v).or_insert_with(|| {
                kept.push(v);
                kept.len() as u32 - 1
            })
        };
        let triangles = triangles.iter().map(|t| t.map(&mut renamed)).collect();
        Self { triangles, colors: Vec::new(), ..self.vertices(&kept) }
    }

    /// These vertices, without triangles.
    pub fn vertices(&self, kept: &[u32]) -> Self {
        fn some<T: Copy>(all: &[T], kept: &[u32]) -> Vec<T> {
            kept.iter().filter_map(|&v| all.get(v as usize).copied()).collect()
        }
        Self {
            positions: some(&self.positions, kept),
            normals: some(&self.normals, kept),
            uvs: [some(&self.uvs[0], kept), some(&self.uvs[1], kept)],
            colors: some(&self.colors, kept),
            tangents: some(&self.tangents, kept),
            triangles: Vec::new(),
        }
    }

    /// Its vertices where a node puts them; `None` where the node leaves nothing of their area.
    pub fn placed(&self, world: &DMat4) -> Option<Stands> {
        // So that what stays where it is keeps its bits.
        if *world == DMat4::IDENTITY {
            let (positions, normals) = (self.positions.clone(), self.normals.clone());
            return Some(Stands { positions, normals, tangents: self.tangents.clone(), turned: false });
        }
        let linear = DMat3::from_mat4(*world);
        let determinant = linear.determinant();
        if !(determinant != 0.0 && determinant.is_finite()) {
            return None;
        }
        // Cofactors: the inverse transpose times the determinant, whose sign keeps normals on their side.
        let cofactors = DMat3::from_cols(
            linear.y_axis.cross(linear.z_axis),
            linear.z_axis.cross(linear.x_axis),
            linear.x_axis.cross(linear.y_axis),
        ) * determinant.signum();
        let positions =
            self.positions.iter().map(|p| world.transform_point3(p.as_dvec3()).as_vec3()).collect();
        let turn = |n: &Vec3| (cofactors * n.as_dvec3()).normalize_or_zero().as_vec3();
        let normals = self.normals.iter().map(turn).collect();
        // A mirror turns normal × tangent round.
        let along = |t: &Vec4| {
            let moved = (linear * t.truncate().as_dvec3()).normalize_or_zero().as_vec3();
            moved.extend(t.w * determinant.signum() as f32)
        };
        let tangents = self.tangents.iter().map(along).collect();
        Some(Stands { positions, normals, tangents, turned: determinant < 0.0 })
    }

    /// The other side of its triangles where a node puts them, as sheets of their own a hair behind: a surface emits from its
    /// front only.
    pub fn back(&self, world: &DMat4) -> Option<Self> {
        /// Of the sheet's size.
        const GAP: f32 = 2e-5;
        /// Of the largest coordinate, of which numbers keep some 6e-8.
        const STEPS: f32 = 5e-7;
        let Stands { positions, normals, tangents, turned } = self.placed(world)?;
        let (low, high) = positions
            .iter()
            .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| (low.min(*p), high.max(*p)));
        let gap = (GAP * (high - low).max_element()).max(STEPS * low.abs().max(high.abs()).max_element());
        let mut back = Self::default();
        for &[a, b, c] in &self.triangles {
            let corners = (if turned { [a, b, c] } else { [a, c, b] }).map(|v| v as usize);
            let [p, q, r] = corners.map(|v| positions[v]);
            let ahead = (q - p).cross(r - p).normalize_or_zero() * gap;
            let first = back.positions.len() as u32;
            for v in corners {
                back.positions.push(positions[v] + ahead);
                back.normals.push(-normals[v]);
                back.tangents.extend(tangents.get(v).map(|t| t.truncate().extend(-t.w)));
                for (set, of) in back.uvs.iter_mut().zip(&self.uvs) {
                    set.extend(of.get(v));
                }
            }
            back.triangles.push([first, first + 1, first + 2]);
        }
        Some(back)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn strips_and_fans_are_wound_like_lists() {
        let list = |mode, n| triangles(mode, n, |i| i as u32);
        assert_eq!(list(4, 7), [[0, 1, 2], [3, 4, 5]]);
        assert_eq!(list(5, 5), [[0, 1, 2], [2, 1, 3], [2, 3, 4]]);
        assert_eq!(list(6, 5), [[0, 1, 2], [0, 2, 3], [0, 3, 4]]);
        assert!(list(5, 2).is_empty() && list(6, 0).is_empty());
    }

    #[test]
    fn a_body_has_no_edges_with_one_side() {
        let corners = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z];
        let closed = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        let body = |triangles| Part { positions: corners.to_vec(), triangles, ..Part::default() };
        assert!(!body(closed.clone()).is_open() && body(closed[..3].to_vec()).is_open());
        // As exporters write it, with corners of their own for each face.
        let apart = Part {
            positions: closed.iter().flatten().map(|&v| corners[v as usize]).collect(),
            triangles: (0..4).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
            ..Part::default()
        };
        assert!(!apart.is_open());
    }

    #[test]
    fn normals_stay_perpendicular_and_mirrors_turn_triangles() {
        let part = Part {
            positions: vec![Vec3::ZERO, Vec3::new(1.0, -1.0, 0.0), Vec3::Z],
            normals: vec![Vec3::new(1.0, 1.0, 0.0).normalize(); 3],
            tangents: vec![Vec3::Z.extend(1.0); 3],
            ..Part::default()
        };
        for (scale, mirrored) in [(DVec3::new(4.0, 1.0, 1.0), false), (DVec3::new(-4.0, 1.0, 1.0), true)] {
            let Stands { positions: p, normals: n, turned, tangents } =
                part.placed(&DMat4::from_scale(scale)).unwrap();
            assert_eq!(tangents[0], Vec3::Z.extend(if mirrored { -1.0 } else { 1.0 }));
            assert!(n[0].dot(p[1]).abs() < 1e-6 && n[0].is_normalized());
            // The normal's image has to stay on the side that its own space says.
            assert!(n[0].dot(Vec3::new(scale.x as f32, 1.0, 0.0)) > 0.0);
            assert_eq!(turned, mirrored);
        }
        assert!(part.placed(&DMat4::from_scale(DVec3::new(0.0, 1.0, 1.0))).is_none());
        assert!(part.placed(&DMat4::from_scale(DVec3::splat(f64::NAN))).is_none());
    }
}
