//! One OBJ file: triangles, and which name, material and smoothing group each has.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use glam::{Vec2, Vec3, Vec4};

use super::error::{Place, SceneError, Warning};
use super::obj_lines::{CORNERS_MAX, ObjLines, Oddity, Segment, Tally};
use super::triangulate::Triangulator;

use foveal::math;

/// A run of triangles with the same name, material and smoothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Run {
    /// First triangle.
    pub first: usize,
    /// Index into [`ObjFile::names`].
    pub name: u32,
    /// Index into [`ObjFile::materials`].
    pub material: Option<u32>,
}

/// What one OBJ file holds.
#[derive(Debug, Default)]
pub(super) struct ObjFile {
    pub positions: Vec<Vec3>,
    /// Unit or zero.
    pub normals: Vec<Vec3>,
    /// Finite.
    pub uvs: Vec<Vec2>,
    /// [`foveal::scene::Mesh::uvs1`] and [`foveal::scene::Mesh::tangents`], which OBJ has not.
    pub uvs1: Vec<Vec2>,
    pub tangents: Vec<Vec4>,
    pub triangles: Vec<[u32; 3]>,
    pub runs: Vec<Run>,
    pub names: Vec<String>,
    /// Of each name the path of the thing and the thing it hangs from; empty where names are all that is known.
    pub paths: Vec<(String, Option<u32>)>,
    /// Names of `usemtl` and the line of their first use.
    pub materials: Vec<(String, u32)>,
    /// What follows `mtllib`, with its line.
    pub libraries: Vec<(String, u32)>,
}

/// Reads an OBJ file. `path` is for messages.
pub(super) fn parse(bytes: &[u8], path: &Path, warnings: &mut Vec<Warning>) -> Result<ObjFile, SceneError> {
    if bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]) {
        return Err(SceneError::invalid(Place::new(path, 1), "the text is UTF-16; save it as UTF-8"));
    }
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    // Nearly all files are sound, and to see that takes less time than to look for what is not.
    let text = std::str::from_utf8(bytes).map_or_else(|_| String::from_utf8_lossy(bytes), Cow::Borrowed);
    // Text of an old Macintosh ends its lines with a carriage return.
    let text = if text.contains('\n') { text } else { text.replace('\r', "\n").into() };
    let mut lines = ObjLines::new(&text);
    let options =
        tobj::LoadOptions { single_index: true, triangulate: false, ignore_points: true, ignore_lines: true };
    // Materials are resolved beside the stream, so no library is ever asked for.
    let none = |_: &Path| Err(tobj::LoadError::OpenFileFailed);
    let (models, _) = lines
        .read(|mut clean| tobj::load_obj_buf(&mut clean, &options, none))
        .map_err(|e| SceneError::invalid(Place::new(path, 0), format!("not readable as OBJ: {e}")))?;
    report(&lines.odd, path, warnings);
    let mut file = ObjFile {
        names: std::mem::take(&mut lines.names),
        materials: std::mem::take(&mut lines.materials),
        libraries: std::mem::take(&mut lines.libraries),
        ..Default::default()
    };
    let smoothing = assemble(models, &lines.segments, &mut file);
    if lines.segments.iter().any(|s| s.smoothing > 0) {
        smooth(&mut file, &smoothing);
    }
    Ok(file)
}

fn report(odd: &BTreeMap<Oddity, Tally>, path: &Path, warnings: &mut Vec<Warning>) {
    for (oddity, &Tally { count, line }) in odd {
        let (what, done) = match oddity {
            Oddity::Vertex => {
                ("vertex with a coordinate that is no finite number", "the faces that use it are left out")
            }
            Oddity::Face => ("face with an index that is no vertex of the file", "left out"),
            Oddity::Attribute => {
                ("face with a texture coordinate or normal that the file does not have", "done without")
            }
            Oddity::Short => ("face with fewer than three corners", "left out"),
            Oddity::Long => (&*format!("face with more than {CORNERS_MAX} corners"), "left out"),
            Oddity::Lines => ("points and lines", "not drawn"),
            Oddity::FreeForm => ("free-form curves and surfaces", "not drawn; export polygons"),
            Oddity::Colors => ("vertex colours", "not used"),
            Oddity::Number => ("texture coordinate or normal that is no finite number", "done without"),
        };
        let s = if count == 1 { "" } else { "s, this is the first" };
        warnings.push(Warning::new(Place::new(path, line), format!("{what} ({count} line{s}); {done}")));
    }
}

/// Cuts the faces of `tobj` into triangles. Returns the smoothing group of each run.
fn assemble(models: Vec<tobj::Model>, segments: &[Segment], file: &mut ObjFile) -> Vec<u32> {
    let mut cut = Triangulator::new();
    let mut smoothing = Vec::new();
    let mut face = 0;
    let mut segments = segments.iter().peekable();
    for model in models {
        let mesh = model.mesh;
        let base = file.positions.len() as u32;
        let vec3 = |v: &[f32]| Vec3::new(v[0], v[1], v[2]);
        file.positions.extend(mesh.positions.chunks_exact(3).map(vec3));
        // A normal of any length is meant as a direction; NaN and zero mean a flat face.
        file.normals.extend(mesh.normals.chunks_exact(3).map(|n| vec3(n).normalize_or_zero()));
        file.uvs.extend(mesh.texcoords.chunks_exact(2).map(|t| {
            let uv = Vec2::new(t[0], t[1]);
            if uv.is_finite() { uv } else { Vec2::ZERO }
        }));
        let corners: Vec<u32> = mesh.indices.iter().map(|i| i + base).collect();
        file.triangles.reserve(corners.len() / 3);
        let mut rest = &corners[..];
        let mut arities = mesh.face_arities.iter();
        while !rest.is_empty() {
            if let Some(s) = segments.next_if(|s| s.first_face == face) {
                file.runs.push(Run { first: file.triangles.len(), name: s.name, material: s.material });
                smoothing.push(s.smoothing);
            }
            let arity = arities.next().map_or(3, |&a| a as usize).clamp(1, rest.len());
            let (polygon, after) = rest.split_at(arity);
            rest = after;
            face += 1;
            cut.triangulate(polygon, |v| file.positions[v as usize], &mut file.triangles);
        }
    }
    smoothing
}

/// Gives corners without a normal, in runs with a smoothing group, the mean normal of the faces of
/// that group and name which meet there, weighted by their angle (Thürmer & Wüthrich 1998).
fn smooth(file: &mut ObjFile, smoothing: &[u32]) {
    type CornerKey = ([u32; 3], u32, u32);
    let mut sums: HashMap<CornerKey, Vec3> = HashMap::new();
    let key = |p: Vec3, name: u32, group: u32| -> CornerKey {
        ((p + Vec3::ZERO).to_array().map(f32::to_bits), name, group)
    };
    let runs = file.runs.clone();
    let ends = runs.iter().skip(1).map(|r| r.first).chain([file.triangles.len()]);
    let smooth_runs: Vec<(std::ops::Range<usize>, u32, u32)> = runs
        .iter()
        .zip(ends)
        .zip(smoothing)
        .filter(|(_, s)| **s > 0)
        .map(|((r, end), &s)| (r.first..end, r.name, s))
        .collect();
    for (range, name, group) in &smooth_runs {
        for t in &file.triangles[range.clone()] {
            let p = t.map(|v| file.positions[v as usize]);
            let n = (p[1] - p[0]).cross(p[2] - p[0]).normalize_or_zero();
            for i in 0..3 {
                if file.normals[t[i] as usize] == Vec3::ZERO {
                    let (a, b) = (p[(i + 1) % 3] - p[i], p[(i + 2) % 3] - p[i]);
                    let angle = math::acos(a.normalize_or_zero().dot(b.normalize_or_zero()).clamp(-1.0, 1.0));
                    *sums.entry(key(p[i], *name, *group)).or_default() += n * angle;
                }
            }
        }
    }
    // A vertex that a face of another group uses too is doubled, or that face would be smooth.
    let bare: Vec<bool> = file.normals.iter().map(|n| *n == Vec3::ZERO).collect();
    let mut doubled: HashMap<(u32, u32, u32), u32> = HashMap::new();
    for (range, name, group) in smooth_runs {
        for t in range {
            for corner in 0..3 {
                let v = file.triangles[t][corner];
                let at = v as usize;
                if !bare.get(at).copied().unwrap_or(false) {
                    continue;
                }
                let fresh = file.positions.len() as u32;
                let new = *doubled.entry((v, name, group)).or_insert(fresh);
                if new == fresh {
                    let p = file.positions[at];
                    let n = sums.get(&key(p, name, group)).copied().unwrap_or_default();
                    file.positions.push(p);
                    file.uvs.push(file.uvs[at]);
                    file.normals.push(n.normalize_or_zero());
                }
                file.triangles[t][corner] = new;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> (ObjFile, Vec<Warning>) {
        let mut warnings = Vec::new();
        let file = parse(text.as_bytes(), Path::new("t.obj"), &mut warnings).unwrap();
        assert_eq!(file.positions.len(), file.normals.len());
        assert_eq!(file.positions.len(), file.uvs.len());
        (file, warnings)
    }

    const ROOF: &str = "v 0 0 0\nv 1 0 1\nv 2 0 0\nv 0 0 5\nv 1 0 6\nv 1 1 1\nv 1 1 6\n";

    #[test]
    fn corners_with_and_without_attributes_mix() {
        let (file, warnings) =
            read("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 1 1\nvn 0 0 9\nf 1 2 3\nf 1/1/1 2/1 3//1\nf -1 -2 -3\n");
        assert_eq!(file.triangles.len(), 3);
        assert!(warnings.is_empty());
        let [a, b, c] = file.triangles[1];
        assert_eq!(file.normals[a as usize], Vec3::Z);
        assert_eq!(file.normals[b as usize], Vec3::ZERO);
        assert_eq!(file.uvs[b as usize], Vec2::ONE);
        assert_eq!(file.uvs[c as usize], Vec2::ZERO);
        assert_eq!(file.normals[c as usize], Vec3::Z);
    }

    #[test]
    fn runs_count_triangles_not_faces() {
        let (file, _) = read("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nusemtl a\nf 1 2 3 4\no n\nf 1 2 3\n");
        let run = |first, name| Run { first, name, material: Some(0) };
        assert_eq!(file.runs, [run(0, 0), run(2, 1)]);
        assert_eq!(file.triangles.len(), 3);
    }

    #[test]
    fn smoothing_groups_smooth_inside_and_not_across() {
        let (file, _) = read(&format!("{ROOF}s 1\nf 1 2 5 4\nf 2 3 5\ns off\nf 2 5 7 6\n"));
        let normal = |t: usize, c: usize| file.normals[file.triangles[t][c] as usize];
        for t in 0..3 {
            for c in 0..3 {
                assert!((normal(t, c).length() - 1.0).abs() < 1e-5, "triangle {t}");
            }
        }
        assert_eq!(normal(3, 0), Vec3::ZERO);
        assert_eq!(normal(4, 0), Vec3::ZERO);
    }

    #[test]
    fn given_normals_outrank_smoothing() {
        let (file, _) = read("v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 1 0 0\ns 1\nf 1//1 2//1 3//1\n");
        assert_eq!(file.normals[0], Vec3::X);
        assert_eq!(file.positions.len(), 3);
    }

    #[test]
    fn warnings_name_line_and_number() {
        let (file, warnings) = read("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\nf 1 2 8\nf 1 2 3\n");
        assert_eq!(file.triangles.len(), 1);
        assert_eq!(
            warnings[0].to_string(),
            "t.obj:4: face with an index that is no vertex of the file (2 lines, this is the first); left out"
        );
    }

    #[test]
    fn old_macintosh_and_bom() {
        assert_eq!(read("\u{feff}v 0 0 0\rv 1 0 0\rv 0 1 0\rf 1 2 3\r").0.triangles.len(), 1);
        assert!(parse(&[0xff, 0xfe, 0, 0], Path::new("w.obj"), &mut Vec::new()).is_err());
    }

    proptest::proptest! {
        #[test]
        fn no_text_can_break_it(text in "(([vfglsopu]|vt|vn|usemtl|#|\\\\)[ /0-9.eE\\-\\\\a-]{0,12}[\r\n]{1,2}){0,40}") {
            let mut warnings = Vec::new();
            let file = parse(text.as_bytes(), Path::new("p.obj"), &mut warnings).unwrap();
            let n = file.positions.len() as u32;
            assert!(file.triangles.iter().flatten().all(|&v| v < n));
            assert_eq!(file.normals.len() as u32, n);
        }

        #[test]
        fn no_bytes_can_break_it(bytes in proptest::collection::vec(proptest::num::u8::ANY, 0..300)) {
            let _ = parse(&bytes, Path::new("p.obj"), &mut Vec::new());
        }
    }
}
