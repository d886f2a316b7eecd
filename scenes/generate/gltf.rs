//! A glTF document under construction, its bytes in one file beside it. As in OBJ files numbers are rounded before
//! anything else, so that the bytes do not depend on the platform's mathematics library.

use std::collections::BTreeMap;
use std::fmt::Write;

use glam::{DMat3, DQuat, DVec3};

use super::obj::{Corner, Mesh, SceneFiles};

/// Component types.
const SHORT: u32 = 5122;
const WORD: u32 = 5125;
const FLOAT: u32 = 5126;

/// A document and its bytes.
#[derive(Default)]
pub struct Gltf {
    bytes: Vec<u8>,
    views: Vec<String>,
    accessors: Vec<String>,
    meshes: Vec<String>,
    materials: Vec<String>,
    nodes: Vec<String>,
    /// Triangles of each mesh.
    triangles: Vec<usize>,
    shown: usize,
}

/// Rounded to 10⁻⁴, ties away from the middle.
fn rounded(v: f64) -> f64 {
    (v * 1e4 + 0.5 + 1e-5).floor() / 1e4
}

fn float(v: f64) -> f32 {
    rounded(v) as f32
}

/// A list of rounded numbers as JSON has them.
fn list(values: &[f64]) -> String {
    let words: Vec<String> = values.iter().map(|&v| (rounded(v) + 0.0).to_string()).collect();
    format!("[{}]", words.join(", "))
}

/// The turn that looks from `eye` to `target`, along −z with +y up.
pub fn looking(eye: DVec3, target: DVec3) -> DQuat {
    let back = (eye - target).normalize();
    let right = DVec3::Y.cross(back).normalize();
    DQuat::from_mat3(&DMat3::from_cols(right, back.cross(right), back))
}

impl Gltf {
    fn view(&mut self, bytes: &[u8], stride: Option<usize>) -> usize {
        let at = self.bytes.len();
        self.bytes.extend(bytes);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let stride = stride.map_or(String::new(), |s| format!(", \"byteStride\": {s}"));
        let length = bytes.len();
        self.views.push(format!(r#"{{ "buffer": 0, "byteOffset": {at}, "byteLength": {length}{stride} }}"#));
        self.views.len() - 1
    }

    fn accessor(&mut self, view: usize, component: u32, count: usize, shape: &str, more: &str) -> usize {
        self.accessors.push(format!(
            r#"{{ "bufferView": {view}, "componentType": {component}, "count": {count}, "type": "{shape}"{more} }}"#
        ));
        self.accessors.len() - 1
    }

    /// An accessor of floats.
    pub fn floats<const N: usize>(&mut self, values: &[[f64; N]], more: &str) -> usize {
        let bytes: Vec<u8> = values.iter().flatten().flat_map(|&v| float(v).to_le_bytes()).collect();
        let view = self.view(&bytes, None);
        let shape = ["", "SCALAR", "VEC2", "VEC3", "VEC4"][N];
        self.accessor(view, FLOAT, values.len(), shape, more)
    }

    /// A material: the keys of its object. Returns its number.
    pub fn material(&mut self, name: &str, keys: &str) -> usize {
        let comma = if keys.is_empty() { "" } else { ", " };
        self.materials.push(format!(r#"{{ "name": "{name}"{comma}{keys} }}"#));
        self.materials.len() - 1
    }

    /// A mesh of one material. `more` are further keys of its primitive.
    pub fn mesh(&mut self, name: &str, mesh: &Mesh, material: usize, more: &str) -> usize {
        let (corners, indices) = joined(mesh);
        let p: Vec<[f64; 3]> = corners.iter().map(|c| c.position.to_array().map(rounded)).collect();
        let bound = |f: fn(f64, f64) -> f64, start: f64| -> Vec<f64> {
            (0..3).map(|i| p.iter().fold(start, |b, p| f(b, p[i]))).collect()
        };
        let (low, high) = (bound(f64::min, f64::INFINITY), bound(f64::max, f64::NEG_INFINITY));
        let bounds = format!(r#", "min": {}, "max": {}"#, list(&low), list(&high));
        let positions = self.floats(&p, &bounds);
        let normals: Vec<[f64; 3]> = corners.iter().map(|c| c.normal.to_array()).collect();
        let normals = self.floats(&normals, "");
        // From the upper left.
        let uvs: Vec<[f64; 2]> = corners.iter().map(|c| [c.uv.x, 1.0 - c.uv.y]).collect();
        let uvs = self.floats(&uvs, "");
        let attributes = format!(r#""POSITION": {positions}, "NORMAL": {normals}, "TEXCOORD_0": {uvs}"#);
        self.primitive(name, &attributes, &indices, material, more)
    }

    /// As [`Self::mesh`], positions in sixteen bits of [−1, 1] and without texture coordinates.
    pub fn quantised(&mut self, name: &str, mesh: &Mesh, material: usize) -> usize {
        let (corners, indices) = joined(mesh);
        let words = |v: DVec3| v.extend(0.0).to_array().map(|v| (rounded(v) * 32_767.0).round() as i16);
        let rows: Vec<[i16; 4]> = corners.iter().map(|c| words(c.position)).collect();
        let bound = |f: fn(i16, i16) -> i16, start: i16| -> Vec<f64> {
            (0..3).map(|i| f64::from(rows.iter().fold(start, |b, r| f(b, r[i])))).collect()
        };
        let (low, high) = (bound(i16::min, i16::MAX), bound(i16::max, i16::MIN));
        let bounds = format!(r#", "normalized": true, "min": {}, "max": {}"#, list(&low), list(&high));
        let bytes: Vec<u8> = rows.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
        let view = self.view(&bytes, Some(8));
        let positions = self.accessor(view, SHORT, rows.len(), "VEC3", &bounds);
        let normals: Vec<[f64; 3]> = corners.iter().map(|c| c.normal.to_array()).collect();
        let normals = self.floats(&normals, "");
        let attributes = format!(r#""POSITION": {positions}, "NORMAL": {normals}"#);
        self.primitive(name, &attributes, &indices, material, "")
    }

    fn primitive(
        &mut self,
        name: &str,
        attributes: &str,
        indices: &[u32],
        material: usize,
        more: &str,
    ) -> usize {
        let bytes: Vec<u8> = indices.iter().flat_map(|i| i.to_le_bytes()).collect();
        let view = self.view(&bytes, None);
        let list = self.accessor(view, WORD, indices.len(), "SCALAR", "");
        self.meshes.push(format!(
            r#"{{ "name": "{name}", "primitives": [{{ "attributes": {{ {attributes} }}, "indices": {list}, "material": {material}{more} }}] }}"#
        ));
        self.triangles.push(indices.len() / 3);
        self.meshes.len() - 1
    }

    /// A node: the keys of its object. Returns its number.
    pub fn node(&mut self, name: &str, keys: &str) -> usize {
        self.nodes.push(format!(r#"{{ "name": "{name}", {keys} }}"#));
        self.nodes.len() - 1
    }

    /// A node that shows a mesh `times` over, where `keys` put it.
    pub fn thing(&mut self, name: &str, mesh: usize, times: usize, keys: &str) -> usize {
        self.shown += times * self.triangles[mesh];
        let comma = if keys.is_empty() { "" } else { ", " };
        self.node(name, &format!(r#""mesh": {mesh}{comma}{keys}"#))
    }

    /// Keys of a node that looks from `eye` to `target`.
    pub fn pose(eye: DVec3, target: DVec3) -> String {
        let turn = looking(eye, target).to_array();
        format!(r#""translation": {}, "rotation": {}"#, list(&eye.to_array()), list(&turn))
    }

    /// The files of the scene. `rest` are the document's other keys; all nodes in `roots` are shown.
    pub fn finish(
        self,
        name: &str,
        roots: &[usize],
        rest: &str,
        pictures: Vec<(&str, Vec<u8>)>,
    ) -> SceneFiles {
        let mut text = format!(
            "{{\n\"asset\": {{ \"version\": \"2.0\", \"generator\": \"foveal scenes/generate.rs\", \
             \"copyright\": \"CC0\" }},\n\"scene\": 0,\n\"scenes\": [{{ \"nodes\": {roots:?} }}],\n"
        );
        for (key, of) in [
            ("nodes", &self.nodes),
            ("meshes", &self.meshes),
            ("materials", &self.materials),
            ("accessors", &self.accessors),
            ("bufferViews", &self.views),
        ] {
            let _ = writeln!(text, "\"{key}\": [\n  {}\n],", of.join(",\n  "));
        }
        let length = self.bytes.len();
        let _ = writeln!(text, r#""buffers": [{{ "uri": "{name}.bin", "byteLength": {length} }}],"#);
        text.push_str(rest.trim());
        text.push_str("\n}\n");
        let mut files =
            vec![(format!("{name}.gltf"), text.into_bytes()), (format!("{name}.bin"), self.bytes)];
        files.extend(pictures.into_iter().map(|(file, bytes)| (file.to_owned(), bytes)));
        SceneFiles { name: name.to_owned(), triangle_count: self.shown, files }
    }
}

/// Distinct corners of a mesh's triangles, and three indices for each triangle, wound as the normals say.
fn joined(mesh: &Mesh) -> (Vec<Corner>, Vec<u32>) {
    let mut known: BTreeMap<[i64; 8], u32> = BTreeMap::new();
    let (mut corners, mut indices) = (Vec::new(), Vec::new());
    for face in &mesh.faces {
        for i in 1..face.len().saturating_sub(1) {
            let mut triangle = [face[0], face[i], face[i + 1]];
            let [a, b, c] = triangle.map(|c| DVec3::from(c.position.to_array().map(rounded)));
            let area = (b - a).cross(c - a);
            if area.length_squared() < 1e-14 {
                continue;
            }
            if area.dot(triangle.iter().map(|c| c.normal).sum()) < 0.0 {
                triangle.swap(1, 2);
            }
            for corner in triangle {
                let [p, n] = [corner.position, corner.normal].map(|v| v.to_array().map(key));
                let row = [p[0], p[1], p[2], n[0], n[1], n[2], key(corner.uv.x), key(corner.uv.y)];
                let index = *known.entry(row).or_insert_with(|| {
                    corners.push(corner);
                    corners.len() as u32 - 1
                });
                indices.push(index);
            }
        }
    }
    (corners, indices)
}

fn key(v: f64) -> i64 {
    (rounded(v) * 1e4).round() as i64
}
