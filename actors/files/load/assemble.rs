//! Several files joined into one mesh without bad triangles.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use glam::Vec3;

use super::ahead::Ahead;
use super::error::{Place, SceneError, Warning};
use super::gltf::image_based::CubeMap;
use super::meshes::Library;
use super::obj::ObjFile;
use foveal::scene::thing::{ThingSource, Things, escaped};
use foveal::scene::{CameraPath, ExtensionUse, Light, MaterialId, Mesh, NamedCamera, TriangleIndex};

/// Coordinates beyond this are left out: the square of an area must fit into single precision.
const COORDINATE_MAX: f32 = 1e9;

/// Scenes smaller than this are refused: areas and offsets fall below single precision.
const DIAGONAL_MIN: f32 = 1e-6;

/// A triangle whose height is below this part of its longest side is taken for a line; rounding of
/// its corners alone moves them as far.
const FLAT: f32 = 1e-7;

/// A material that triangles use.
#[derive(Debug)]
pub(super) struct MaterialUse {
    /// As `usemtl` says; empty where nothing was said.
    pub name: String,
    /// The name in the scene.
    pub unique: String,
    /// Index of the OBJ file.
    pub file: usize,
    /// Line of the first `usemtl`.
    pub line: Option<u32>,
    /// Library and place in it.
    pub definition: Option<(usize, usize)>,
}

impl MaterialUse {
    /// What a sidecar calls it: faces without `usemtl` are of the material "default".
    pub fn called(&self) -> &str {
        if self.name.is_empty() { "default" } else { &self.name }
    }
}

/// Files joined so far.
#[derive(Default)]
pub(super) struct Joined {
    mesh: Mesh,
    /// Name of each triangle, an index into `names`.
    name_of: Vec<u32>,
    names: Vec<String>,
    /// What each name stands for.
    things: Vec<ThingSource>,
    pub uses: Vec<MaterialUse>,
    pub libraries: Vec<Library>,
    files: Vec<(PathBuf, PathBuf)>,
    use_of: HashMap<(String, Option<(usize, usize)>), u32>,
    taken: HashSet<String>,
    /// What glTF files hold besides.
    pub own: Own,
    /// Pictures decoded while meshes were read.
    pub ahead: Ahead,
}

/// Lights, cameras and their paths of glTF files.
#[derive(Default)]
pub(super) struct Own {
    /// Whether any file is one.
    pub any: bool,
    pub lights: Vec<Light>,
    pub cameras: Vec<NamedCamera>,
    pub paths: Vec<CameraPath>,
    pub extensions: Vec<ExtensionUse>,
    /// What is all around in the first file that says it, and where that is said.
    pub cube_map: Option<(CubeMap, Place)>,
}

/// What is known of triangles besides the mesh.
pub(super) struct Labels {
    name_of: Vec<u32>,
    names: Vec<String>,
}

impl Labels {
    /// The name of a triangle in its file; empty where the file gave none.
    pub fn name(&self, t: TriangleIndex) -> &str {
        self.name_of.get(t as usize).and_then(|&n| self.names.get(n as usize)).map_or("", String::as_str)
    }
}

impl Joined {
    /// The folder of an OBJ file, relative to that of the scene.
    pub fn base_of(&self, file: usize) -> &Path {
        self.files.get(file).map_or(Path::new(""), |f| &f.1)
    }

    /// An OBJ file, for messages.
    pub fn shown_of(&self, file: usize) -> &Path {
        self.files.get(file).map_or(Path::new(""), |f| &f.0)
    }

    /// Whether a mesh uses or a library holds a material.
    pub fn knows_material(&self, name: &str) -> bool {
        self.uses.iter().any(|u| u.called() == name)
            || self.libraries.iter().any(|l| l.materials.names().contains(&name))
    }

    /// Adds a file and the libraries that it names.
    pub fn add(&mut self, file: ObjFile, shown: PathBuf, base: PathBuf, libraries: Vec<Library>) {
        let index = self.files.len();
        // A later definition of a name replaces an earlier one.
        let mut defined: HashMap<&str, (usize, usize)> = HashMap::new();
        let first_library = self.libraries.len();
        for (i, library) in libraries.iter().enumerate() {
            // Files that name the same library share it.
            let same = self.libraries.iter().position(|l| l.relative == library.relative);
            for (j, name) in library.materials.names().into_iter().enumerate() {
                defined.insert(name, (same.unwrap_or(first_library + i), j));
            }
        }
        let mut ids: Vec<Option<u32>> = vec![None; file.materials.len() + 1];
        let base_vertex = self.mesh.positions.len() as u32;
        let base_name = self.names.len() as u32;
        let ends = file.runs.iter().skip(1).map(|r| r.first).chain([file.triangles.len()]);
        for (run, end) in file.runs.iter().zip(ends) {
            let slot = run.material.map_or(file.materials.len(), |m| m as usize);
            let id = match ids[slot] {
                Some(id) => id,
                None => {
                    let (name, line) = match file.materials.get(slot) {
                        Some((name, line)) => (name.as_str(), Some(*line)),
                        None => ("", None),
                    };
                    let definition = find_definition(&defined, name);
                    let id = self.use_material(name, line, index, definition);
                    ids[slot] = Some(id);
                    id
                }
            };
            let count = end - run.first;
            self.mesh.materials.extend(std::iter::repeat_n(MaterialId(id), count));
            self.name_of.extend(std::iter::repeat_n(base_name + run.name, count));
        }
        self.libraries.extend(libraries);
        self.things.extend(file.names.iter().enumerate().map(|(i, name)| {
            // What has no name goes by that of its file.
            let stem = || shown.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
            let name = if name.is_empty() { stem() } else { name.clone() };
            let (path, parent) = match file.paths.get(i) {
                Some((path, parent)) => (path.clone(), parent.map(|p| p + base_name)),
                None => (escaped(&name), None),
            };
            ThingSource { name, path, parent }
        }));
        self.names.extend(file.names);
        self.files.push((shown, base));
        if base_vertex == 0 {
            self.mesh.positions = file.positions;
            self.mesh.normals = file.normals;
            self.mesh.uvs = file.uvs;
            self.mesh.uvs1 = file.uvs1;
            self.mesh.tangents = file.tangents;
            self.mesh.triangles = file.triangles;
        } else {
            let (before, after) =
                (self.mesh.positions.len(), self.mesh.positions.len() + file.positions.len());
            append(&mut self.mesh.uvs1, file.uvs1, before, after);
            append(&mut self.mesh.tangents, file.tangents, before, after);
            self.mesh.positions.extend(file.positions);
            self.mesh.normals.extend(file.normals);
            self.mesh.uvs.extend(file.uvs);
            self.mesh.triangles.extend(file.triangles.iter().map(|t| t.map(|v| v + base_vertex)));
        }
    }

    fn use_material(
        &mut self,
        name: &str,
        line: Option<u32>,
        file: usize,
        definition: Option<(usize, usize)>,
    ) -> u32 {
        let key = (name.to_owned(), definition);
        if let Some(&id) = self.use_of.get(&key) {
            return id;
        }
        let id = self.uses.len() as u32;
        self.use_of.insert(key, id);
        let plain = if name.is_empty() { "default" } else { name };
        let mut unique = plain.to_owned();
        let mut n = 2;
        while !self.taken.insert(unique.clone()) {
            unique = format!("{plain} ({n})");
            n += 1;
        }
        self.uses.push(MaterialUse { name: name.to_owned(), unique, file, line, definition });
        id
    }

    /// The mesh without triangles that have no area or no finite corners, and what is known of them. A glTF document
    /// without triangles can be meant (`may_be_empty`), and its reader says so.
    pub fn into_mesh(
        self,
        path: &Path,
        may_be_empty: bool,
        warnings: &mut Vec<Warning>,
    ) -> Result<(Mesh, Labels, Things), SceneError> {
        let mut mesh = self.mesh;
        let mut name_of = self.name_of;
        let none =
            |message: &str| SceneError::NoGeometry { path: path.to_path_buf(), message: message.to_owned() };
        if mesh.triangles.is_empty() && may_be_empty {
            return Ok((Mesh::default(), Labels { name_of, names: self.names }, Things::default()));
        }
        if mesh.triangles.is_empty() {
            return Err(none(
                "no face to draw; export polygons (`f` lines of an OBJ file, triangles of a glTF scene)",
            ));
        }
        let (mut kept, mut far, mut flat, mut turned) = (0, 0, 0, 0);
        let mut low = Vec3::INFINITY;
        let mut high = Vec3::NEG_INFINITY;
        for t in 0..mesh.triangles.len() {
            let p = mesh.corners(t as u32);
            if !p.iter().all(|p| p.is_finite() && p.abs().max_element() <= COORDINATE_MAX) {
                far += 1;
                continue;
            }
            for p in p {
                low = low.min(p);
                high = high.max(p);
            }
            if is_flat(p) {
                flat += 1;
                continue;
            }
            mesh.triangles[kept] = if against_normals(&mesh, t) {
                turned += 1;
                let [a, b, c] = mesh.triangles[t];
                [a, c, b]
            } else {
                mesh.triangles[t]
            };
            mesh.materials[kept] = mesh.materials[t];
            name_of[kept] = name_of[t];
            kept += 1;
        }
        mesh.triangles.truncate(kept);
        mesh.materials.truncate(kept);
        name_of.truncate(kept);
        let mut say = |count: usize, what: &str| {
            if count > 0 {
                let s = if count == 1 { "" } else { "s" };
                warnings
                    .push(Warning::new(Place::new(path, 0), format!("{count} triangle{s} {what}; left out")));
            }
        };
        say(far, &format!("with a coordinate that is not finite or beyond {COORDINATE_MAX:e}"));
        say(flat, "without area");
        if kept == 0 && may_be_empty {
            return Ok((Mesh::default(), Labels { name_of, names: self.names }, Things::default()));
        }
        let diagonal = (high - low).length();
        if diagonal < DIAGONAL_MIN {
            return Err(none(&format!(
                "the whole scene is {diagonal:e} units across, too small for single precision; scale it up"
            )));
        }
        let Some(&[first, ..]) = mesh.triangles.first() else {
            return Err(none("no face has an area that single precision can hold; check the coordinates"));
        };
        if turned > 0 {
            let s = if turned == 1 { "" } else { "s" };
            let what = format!(
                "{turned} triangle{s} wound against all normals of the corners; turned to their side"
            );
            warnings.push(Warning::new(Place::new(path, 0), what));
        }
        // No triangle uses these any more, but all positions are promised to be finite.
        let place = mesh.positions[first as usize];
        for p in &mut mesh.positions {
            if !(p.is_finite() && p.abs().max_element() <= COORDINATE_MAX) {
                *p = place;
            }
        }
        let things = Things::new(&self.things, &name_of, &mesh);
        Ok((mesh, Labels { name_of, names: self.names }, things))
    }
}

/// Appends what vertices may have or not: zeros stand where they have not, unless none has.
fn append<T: Copy + Default>(all: &mut Vec<T>, more: Vec<T>, before: usize, after: usize) {
    if !(all.is_empty() && more.is_empty()) {
        all.resize(before, T::default());
        all.extend(more);
        all.resize(after, T::default());
    }
}

/// `usemtl` and `newmtl` agree on a name up to blanks.
fn find_definition(defined: &HashMap<&str, (usize, usize)>, name: &str) -> Option<(usize, usize)> {
    if let Some(&d) = defined.get(name) {
        return Some(d);
    }
    let squeezed = name.split_whitespace().collect::<Vec<_>>().join(" ");
    defined.get(squeezed.as_str()).or_else(|| defined.get(squeezed.split(" #").next()?)).copied()
}

/// Whether a triangle's winding and the normals that the file gives at all of its corners disagree on what is front.
/// The normals count then, as in other renderers: a light that shines away from its own normals lights nothing.
fn against_normals(mesh: &Mesh, t: usize) -> bool {
    let corners = mesh.triangles[t].map(|v| v as usize);
    let [a, b, c] = corners.map(|v| mesh.positions[v].as_dvec3());
    let front = (b - a).cross(c - a);
    corners.iter().all(|&v| mesh.normals[v].as_dvec3().dot(front) < 0.0)
}

fn is_flat([a, b, c]: [Vec3; 3]) -> bool {
    let (e, f) = (b - a, c - a);
    let area2 = e.cross(f).length_squared();
    let longest2 = e.length_squared().max(f.length_squared()).max((c - b).length_squared());
    // NaN cannot arise: coordinates are bounded.
    area2 <= f32::MIN_POSITIVE || area2.sqrt() <= FLAT * longest2
}
