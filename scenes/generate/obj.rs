//! Polygons, and their way into OBJ text. Numbers are rounded to whole multiples of a power of ten
//! before anything else, so the text does not depend on the platform's mathematics library.

use std::collections::BTreeMap;
use std::fmt::Write;

use glam::{DAffine3, DVec2, DVec3};

/// A scene's files, to be written into a folder of its name.
pub struct SceneFiles {
    /// Name of the folder and stem of OBJ, MTL and TOML.
    pub name: String,
    /// Triangles in the OBJ.
    pub triangle_count: usize,
    /// File names and contents.
    pub files: Vec<(String, Vec<u8>)>,
}

/// A corner of a polygon.
#[derive(Clone, Copy)]
pub struct Corner {
    /// Position.
    pub position: DVec3,
    /// Shading normal, outward; it also decides the polygon's orientation.
    pub normal: DVec3,
    /// Texture coordinates.
    pub uv: DVec2,
}

/// Convex polygons.
#[derive(Clone, Default)]
pub struct Mesh {
    /// Corners of each polygon, in either orientation.
    pub faces: Vec<Vec<Corner>>,
}

impl Mesh {
    /// Both.
    pub fn with(mut self, other: Mesh) -> Mesh {
        self.faces.extend(other.faces);
        self
    }

    /// Moved by `m`.
    pub fn transform(mut self, m: DAffine3) -> Mesh {
        let normal_matrix = m.matrix3.inverse().transpose();
        for corner in self.faces.iter_mut().flatten() {
            corner.position = m.transform_point3(corner.position);
            corner.normal = (normal_matrix * corner.normal).normalize();
        }
        self
    }

    /// Moved by a translation.
    pub fn at(self, x: f64, y: f64, z: f64) -> Mesh {
        self.transform(DAffine3::from_translation(DVec3::new(x, y, z)))
    }

    /// Texture coordinates multiplied.
    pub fn uv_times(mut self, s: f64, t: f64) -> Mesh {
        for corner in self.faces.iter_mut().flatten() {
            corner.uv *= DVec2::new(s, t);
        }
        self
    }

    /// Turned about +y by `degrees`.
    pub fn turned(self, degrees: f64) -> Mesh {
        self.transform(DAffine3::from_rotation_y(degrees.to_radians()))
    }
}

/// Distinct rows of `v`, `vt` or `vn`, in units of the last decimal.
struct Rows {
    key: &'static str,
    decimals: u32,
    columns: usize,
    index: BTreeMap<[i64; 3], usize>,
    rows: Vec<[i64; 3]>,
}

impl Rows {
    fn new(key: &'static str, decimals: u32, columns: usize) -> Self {
        Self { key, decimals, columns, index: BTreeMap::new(), rows: Vec::new() }
    }

    /// Ties are moved off the middle, where the last bit of a sine would decide.
    fn quantize(&self, v: DVec3) -> [i64; 3] {
        let unit = 10f64.powi(self.decimals as i32);
        v.to_array().map(|x| (x * unit + 0.5 + 1e-5).floor() as i64)
    }

    /// 1-based index, as OBJ counts.
    fn insert(&mut self, row: [i64; 3]) -> usize {
        *self.index.entry(row).or_insert_with(|| {
            self.rows.push(row);
            self.rows.len()
        })
    }

    fn write(&self, out: &mut String) {
        for row in &self.rows {
            out.push_str(self.key);
            for value in &row[..self.columns] {
                out.push(' ');
                push_fixed(out, *value, self.decimals);
            }
            out.push('\n');
        }
    }
}

/// `value` / 10^`decimals`, without trailing zeros.
fn push_fixed(out: &mut String, value: i64, decimals: u32) {
    let unit = 10u64.pow(decimals);
    let (whole, fraction) = (value.unsigned_abs() / unit, value.unsigned_abs() % unit);
    if value < 0 {
        out.push('-');
    }
    out.push_str(&whole.to_string());
    if fraction != 0 {
        let digits = format!("{fraction:0width$}", width = decimals as usize);
        out.push('.');
        out.push_str(digits.trim_end_matches('0'));
    }
}

/// The text of an OBJ file under construction.
pub struct Obj {
    positions: Rows,
    uvs: Rows,
    normals: Rows,
    /// Whether faces carry texture coordinates.
    with_uvs: bool,
    faces: String,
    triangle_count: usize,
}

impl Obj {
    /// Positions are rounded to `decimals` digits of the scene's unit.
    pub fn new(decimals: u32) -> Self {
        Self {
            positions: Rows::new("v", decimals, 3),
            uvs: Rows::new("vt", 4, 2),
            normals: Rows::new("vn", 3, 3),
            with_uvs: false,
            faces: String::new(),
            triangle_count: 0,
        }
    }

    /// An object of one material without textures or grooves.
    pub fn add(&mut self, object: &str, material: &str, mesh: Mesh) {
        self.with_uvs = false;
        self.object(object, material, mesh);
    }

    /// An object of one material, with texture coordinates.
    pub fn add_textured(&mut self, object: &str, material: &str, mesh: Mesh) {
        self.with_uvs = true;
        self.object(object, material, mesh);
    }

    fn object(&mut self, object: &str, material: &str, mesh: Mesh) {
        let _ = writeln!(self.faces, "o {object}\nusemtl {material}");
        for face in &mesh.faces {
            self.face(face);
        }
    }

    /// Adds a polygon, as triangles where it is not flat; none where it has no area.
    fn face(&mut self, corners: &[Corner]) {
        let mut kept: Vec<([i64; 3], &Corner)> = Vec::new();
        for corner in corners {
            let p = self.positions.quantize(corner.position);
            if kept.last().is_none_or(|(last, _)| *last != p)
                && kept.first().is_none_or(|(first, _)| *first != p)
            {
                kept.push((p, corner));
            }
        }
        if kept.len() < 3 {
            return;
        }
        let normals: DVec3 = kept.iter().map(|(_, c)| c.normal).sum();
        let sides: Vec<DVec3> = (1..kept.len()).map(|i| point(kept[i].0) - point(kept[0].0)).collect();
        let area: DVec3 = sides.windows(2).map(|s| s[0].cross(s[1])).sum();
        if area.dot(normals) < 0.0 {
            kept.reverse();
        }
        // Rounding moves corners by half a unit: flat means within that.
        let flat = sides.iter().all(|s| s.dot(area).abs() <= 1.5 * area.length());
        let corners: Vec<([i64; 3], Corner)> = kept.into_iter().map(|(p, c)| (p, *c)).collect();
        if flat {
            self.polygon(&corners);
        } else {
            for i in 1..corners.len() - 1 {
                self.polygon(&[corners[0], corners[i], corners[i + 1]]);
            }
        }
    }

    fn polygon(&mut self, corners: &[([i64; 3], Corner)]) {
        let p: Vec<DVec3> = corners.iter().map(|(p, _)| point(*p)).collect();
        let area: DVec3 = (1..p.len() - 1).map(|i| (p[i] - p[0]).cross(p[i + 1] - p[0])).sum();
        if area == DVec3::ZERO {
            return;
        }
        // A sliver cut off a polygon that is not flat may face away from its own corners' normals.
        let normals: DVec3 = corners.iter().map(|(_, c)| c.normal).sum();
        if area.dot(normals) < 0.0 {
            let turned: Vec<_> = corners.iter().rev().copied().collect();
            return self.polygon(&turned);
        }
        self.faces.push('f');
        for (p, corner) in corners {
            let v = self.positions.insert(*p);
            let vn = self.normals.insert(self.normals.quantize(corner.normal));
            let _ = if self.with_uvs {
                let vt = self.uvs.insert(self.uvs.quantize(corner.uv.extend(0.0)));
                write!(self.faces, " {v}/{vt}/{vn}")
            } else {
                write!(self.faces, " {v}//{vn}")
            };
        }
        self.faces.push('\n');
        self.triangle_count += corners.len() - 2;
    }

    /// The files of the scene: OBJ, MTL, sidecar, and the textures.
    pub fn finish(self, name: &str, mtl: &str, toml: &str, textures: Vec<(&str, Vec<u8>)>) -> SceneFiles {
        let mut text =
            format!("# foveal scene '{name}', made by scenes/generate.rs, CC0\nmtllib {name}.mtl\n");
        for rows in [&self.positions, &self.uvs, &self.normals] {
            rows.write(&mut text);
        }
        text.push_str(&self.faces);
        let mut files = vec![
            (format!("{name}.obj"), text.into_bytes()),
            (format!("{name}.mtl"), mtl.trim_start().as_bytes().to_vec()),
            (format!("{name}.toml"), toml.trim_start().as_bytes().to_vec()),
        ];
        files.extend(textures.into_iter().map(|(file, bytes)| (file.to_owned(), bytes)));
        SceneFiles { name: name.to_owned(), triangle_count: self.triangle_count, files }
    }
}

fn point(p: [i64; 3]) -> DVec3 {
    DVec3::new(p[0] as f64, p[1] as f64, p[2] as f64)
}
