//! Files to a [`Scene`]: OBJ through `tobj`, MTL, glTF, the sidecar, pictures through `image`.
//!
//! Nothing in a file can break it: what is wrong is left out with a [`Warning`] that names file and
//! line, or the whole is refused with a [`SceneError`] that says what to do. No file outside the
//! scene's folder is read, and nothing is allocated by a number in a file without a bound.

mod ahead;
mod assemble;
mod error;
#[cfg(test)]
mod file_tests;
mod folder;
mod from_mtl;
mod gltf;
mod hidden_texels;
#[cfg(feature = "basisu")]
mod ktx2;
mod materials;
mod meshes;
mod mtl;
mod obj;
mod obj_lines;
mod sidecar;
mod sidecar_material;
mod surroundings;
mod textures;
mod toml_table;
mod triangulate;

use std::path::Path;

pub use error::{FileProblem, Place, SceneError, Warning};
pub use sidecar::FORMAT;

pub use folder::Sources;
use folder::{Folder, read_file};
use materials::{Materials, clamp_albedo, filters_to_absorption, materials, resolve_maps};
use meshes::read_meshes;
use sidecar::Sidecar;
use surroundings::{Surroundings, environment};
use textures::TextureRequests;

use foveal::scene::texture::complete;
use foveal::scene::{Material, Scene, SceneParts, defaults, hierarchy, light_units};

/// Bounds on what is read, and choices where files leave one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LoadOptions {
    /// Bytes of one file.
    pub file_bytes_max: u64,
    /// Columns or rows of a picture.
    pub texture_side_max: u32,
    /// Decoded bytes of one picture.
    pub picture_bytes_max: u64,
    /// Decoded bytes of all pictures together, at 4 bytes per pixel.
    pub texture_bytes_max: u64,
    /// Triangles that glTF files make, each instance counted.
    pub triangles_max: usize,
    /// Extensions of glTF to do without although a file requires them, besides those of its sidecar.
    pub ignored_extensions: Vec<String>,
    /// Variant of glTF's materials, before the one that the sidecar names.
    pub variant: Option<String>,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self {
            file_bytes_max: 2 << 30,
            texture_side_max: 16_384,
            picture_bytes_max: 512 << 20,
            texture_bytes_max: 4 << 30,
            // Some 10 GiB with its index; more than this is no scene for one machine.
            triangles_max: 1 << 26,
            ignored_extensions: Vec::new(),
            variant: None,
        }
    }
}

/// Warnings beyond this are only counted.
const WARNINGS_MAX: usize = 500;

/// A scene and what was doubtful about its files.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// The scene.
    pub scene: Scene,
    /// In the order of the files.
    pub warnings: Vec<Warning>,
    /// Every file that was read: its name relative to the scene's folder, and its BLAKE3.
    pub files: Vec<(String, [u8; 32])>,
    /// What it was read from, where that is all known.
    pub sources: Option<Sources>,
}

/// Whether a name ends as scenes do: `.obj`, `.gltf`, `.glb`, or `.toml` for a sidecar.
pub fn is_scene_name(path: &Path) -> bool {
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    extension.is_some_and(|e| e == "toml" || MESHES.contains(&e.as_str()))
}

/// Endings of files with meshes, in the order in which a sidecar without a list looks for one.
pub const MESHES: [&str; 3] = ["obj", "glb", "gltf"];

/// Loads an `.obj`, `.gltf` or `.glb` file (with the sidecar of the same name beside it, if there is one) or a sidecar.
pub fn load(path: &Path) -> Result<Loaded, SceneError> {
    load_with(path, &LoadOptions::default())
}

/// As [`load`], with other bounds.
pub fn load_with(path: &Path, options: &LoadOptions) -> Result<Loaded, SceneError> {
    let mut warnings = Vec::new();
    let refuse =
        |path: &Path, problem| SceneError::File { path: path.to_path_buf(), problem, asked_by: None };
    if !is_scene_name(path) {
        return Err(SceneError::UnknownFormat { path: path.to_path_buf() });
    }
    let is_mesh = path.extension().is_some_and(|e| !e.eq_ignore_ascii_case("toml"));
    // The given file is trusted to be where it is; only what it asks for must stay in its folder.
    if let Err(e) = std::fs::metadata(path) {
        let problem = match e.kind() {
            std::io::ErrorKind::NotFound | std::io::ErrorKind::NotADirectory => FileProblem::Missing,
            kind => FileProblem::Unreadable(kind),
        };
        return Err(refuse(path, problem));
    }
    let mut folder = Folder::of(path, options.file_bytes_max).map_err(|p| refuse(path, p))?;
    let sidecar_path = if is_mesh { path.with_extension("toml") } else { path.to_path_buf() };
    let mut sidecar = if !is_mesh || folder.is_file(&file_name(&sidecar_path)) {
        // A sidecar is written by hand; 16 MiB hold any path.
        let limit = options.file_bytes_max.min(16 << 20);
        let contents = read_file(&sidecar_path, limit).map_err(|p| refuse(&sidecar_path, p))?;
        folder.note(file_name(&sidecar_path), contents.hash);
        sidecar::parse(&contents.bytes, &sidecar_path)?
    } else {
        Sidecar::default()
    };

    sidecar.gltf.ignored.extend(options.ignored_extensions.iter().cloned());
    sidecar.gltf.variant = options.variant.clone().or(sidecar.gltf.variant);
    let map = sidecar.environment.as_ref().and_then(|table| table.map.as_ref());
    let map = map.and_then(|map| folder.peek(Path::new(""), &map.name));
    let (joined, surroundings) = rayon::join(
        || read_meshes(path, is_mesh, &sidecar_path, &sidecar, &mut folder, options, &mut warnings),
        || map.and_then(|found| Surroundings::decode(found, options)),
    );
    let mut joined = joined?;
    let own = std::mem::take(&mut joined.own);
    let has_lights = !own.lights.is_empty();
    sidecar.lights.extend(own.lights);
    for camera in own.cameras {
        if !sidecar.cameras.iter().any(|c| c.name == camera.name) {
            sidecar.cameras.push(camera);
        }
    }
    for path in own.paths {
        if !sidecar.paths.iter().any(|p| p.name == path.name) {
            sidecar.paths.push(path);
        }
    }
    let mut requests = TextureRequests::default();
    let Materials { mut materials, filters, pending } =
        materials(&joined, &sidecar, &folder, &mut requests, &mut warnings);
    let (mut textures, ids) =
        requests.load(&mut folder, std::mem::take(&mut joined.ahead), options, &mut warnings);
    for m in &mut materials {
        resolve_maps(m, &ids);
    }
    if !pending.is_empty() {
        gltf::surfaces::finish(&mut materials, &mut textures, pending, &ids, &mut warnings);
    }
    hidden_texels::recolor(&mut materials, &mut textures);
    // Pictures that others were made of are gone by now, and their coarser levels were never made.
    complete(&mut textures, |_| true);
    let mut environment = environment(&sidecar, &mut folder, surroundings, options, &mut warnings);
    let mut has_cube_map = false;
    if let (None, Some((cube_map, place))) = (&environment, own.cube_map) {
        match gltf::image_based::environment(cube_map, sidecar.up, &mut folder, options) {
            Ok(made) => (environment, has_cube_map) = (Some(made), true),
            Err(why) => warnings.push(Warning::new(place, format!("the environment {why}; not shown"))),
        }
    }

    let name = path.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
    let (mesh, labels, things) = joined.into_mesh(path, own.any, &mut warnings)?;
    let bounds = mesh.bounds();
    let grouped = hierarchy::group(&mesh, &materials, sidecar.up, |t| labels.name(t));
    let mut scene = SceneParts {
        title: sidecar.title.unwrap_or_else(|| name.clone()),
        name,
        mesh,
        materials,
        lights: sidecar.lights,
        environment,
        cameras: sidecar.cameras,
        paths: sidecar.paths,
        objects: grouped.objects,
        things,
        bounds,
        metres_per_unit: sidecar.metres_per_unit,
        up: sidecar.up,
        display: sidecar.display,
        budget: sidecar.budget,
        extensions: own.extensions,
        content_hash: content_hash(&folder, options),
        files: folder.files().to_vec(),
    }
    .with_textures(textures);
    scene.mesh.objects = grouped.of_triangle;
    filters_to_absorption(&mut scene, &filters);
    for message in clamp_albedo(&mut scene) {
        warnings.push(Warning::new(Place::new(path, 0), message));
    }
    // Lights of glTF are photometric, and nobody chose them for an exposure of 1.
    let emits = own.any && scene.materials.iter().any(Material::is_emissive);
    // What glows in the open (labels, screens, coals) is no lighting: viewers show such files in environments of their own.
    let glows = emits && scene.lights.is_empty() && scene.environment.is_none() && defaults::is_open(&scene);
    scene.display.metered = (has_lights || emits || has_cube_map) && !glows && !sidecar.exposure_given;
    let doubt = if has_lights && emits { light_units::doubt(&scene) } else { None };
    for message in doubt.into_iter().chain(defaults::complete(&mut scene, glows)) {
        warnings.push(Warning::new(Place::new(path, 0), message));
    }
    if warnings.len() > WARNINGS_MAX {
        let more = warnings.len() - WARNINGS_MAX;
        warnings.truncate(WARNINGS_MAX);
        warnings.push(Warning::new(Place::new(path, 0), format!("{more} more warnings")));
    }
    Ok(Loaded { scene, warnings, files: folder.files().to_vec(), sources: folder.sources() })
}

/// Everything that was read, and what was chosen beside it.
fn content_hash(folder: &Folder, options: &LoadOptions) -> [u8; 32] {
    let read = folder.content_hash();
    if options.variant.is_none() && options.ignored_extensions.is_empty() {
        return read;
    }
    let mut hasher = blake3::Hasher::new();
    hasher.update(&read);
    for word in options.variant.iter().chain(&options.ignored_extensions) {
        hasher.update(&(word.len() as u64).to_le_bytes());
        hasher.update(word.as_bytes());
    }
    *hasher.finalize().as_bytes()
}

fn file_name(path: &Path) -> String {
    path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned())
}
