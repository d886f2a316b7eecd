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
mod mtl;
mod obj;
mod obj_lines;
mod sidecar;
mod sidecar_material;
mod textures;
mod toml_table;
mod triangulate;

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::Vec3;

pub use error::{FileProblem, Place, SceneError, Warning};
pub use sidecar::FORMAT;

use ahead::{Ahead, Surroundings};
use assemble::Joined;
pub use folder::Sources;
use folder::{Folder, read_file};
use from_mtl::Doubts;
use mtl::MtlMaterial;
use sidecar::Sidecar;
use textures::TextureRequests;

use foveal::math;
use foveal::scene::texture::complete;
use foveal::scene::{
    Environment, Material, MaterialId, Model, Reflectance, Scene, SceneParts, TextureId, defaults, hierarchy,
    light_units,
};

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

/// Reads all meshes and the MTL files that they name.
fn read_meshes(
    path: &Path,
    is_mesh: bool,
    sidecar_path: &Path,
    sidecar: &Sidecar,
    folder: &mut Folder,
    options: &LoadOptions,
    warnings: &mut Vec<Warning>,
) -> Result<Joined, SceneError> {
    let given = file_name(path);
    let mut joined = Joined::default();
    let beside = if sidecar.files.is_none() && !is_mesh {
        MESHES.iter().map(|e| path.with_extension(e)).find(|p| folder.is_file(&file_name(p)))
    } else {
        None
    };
    let mut read = |name: &str, asked_by, joined: &mut Joined, warnings: &mut Vec<Warning>| {
        let source = MeshSource { name, asked_by, sidecar, options };
        read_mesh(&source, folder, joined, warnings)
    };
    let Some(files) = &sidecar.files else {
        let (name, asked_by) = if is_mesh {
            (given, None)
        } else {
            let name = file_name(&beside.unwrap_or_else(|| path.with_extension("obj")));
            (name, Some(Place::new(sidecar_path, 0)))
        };
        read(&name, asked_by, &mut joined, warnings)?;
        return Ok(joined);
    };
    if is_mesh && !files.iter().any(|f| f.name == given) {
        let message =
            format!("does not list \"{given}\" under [geometry] files; its own list is loaded instead");
        warnings.push(Warning::new(Place::new(sidecar_path, 0), message));
    }
    for file in files {
        read(&file.name, Some(file.place.clone()), &mut joined, warnings)?;
    }
    Ok(joined)
}

/// A mesh to be read, and how.
struct MeshSource<'a> {
    name: &'a str,
    asked_by: Option<Place>,
    sidecar: &'a Sidecar,
    options: &'a LoadOptions,
}

fn read_mesh(
    source: &MeshSource<'_>,
    folder: &mut Folder,
    joined: &mut Joined,
    warnings: &mut Vec<Warning>,
) -> Result<(), SceneError> {
    let shown = folder.show(source.name);
    let refuse =
        |problem| SceneError::File { path: shown.clone(), problem, asked_by: source.asked_by.clone() };
    let found = folder.find(Path::new(""), source.name).map_err(refuse)?;
    let bytes = folder.read(&found).map_err(refuse)?;
    let relative = PathBuf::from(folder.relative(&found));
    let base = relative.parent().map_or_else(PathBuf::new, Path::to_path_buf);
    let is_gltf =
        found.extension().is_some_and(|e| e.eq_ignore_ascii_case("glb") || e.eq_ignore_ascii_case("gltf"));
    if is_gltf {
        let choices = &source.sidecar.gltf;
        let file = gltf::parse(&bytes, &shown, &base, folder, choices, source.options, warnings)?;
        drop(bytes);
        joined.own.any = true;
        joined.own.lights.extend(file.lights);
        joined.own.cameras.extend(file.cameras);
        joined.own.paths.extend(file.paths);
        joined.own.extensions.extend(file.extensions);
        let cube_map = file.cube_map.map(|cube_map| (cube_map, Place::new(&shown, 0)));
        joined.own.cube_map = joined.own.cube_map.take().or(cube_map);
        let library =
            Library { relative, shown: shown.clone(), materials: Definitions::Gltf(file.materials) };
        joined.add(file.mesh, shown, base, vec![library]);
        return Ok(());
    }
    let pictures = ahead::of_obj(&bytes, &base, source.sidecar, folder);
    let (file, pictures) =
        rayon::join(|| obj::parse(&bytes, &shown, warnings), || Ahead::decode(pictures, source.options));
    let file = file?;
    joined.ahead.extend(pictures);
    drop(bytes);
    let mut libraries = Vec::new();
    for (text, line) in &file.libraries {
        let is_there = |base: &Path, name: &str| folder.find(base, name) != Err(FileProblem::Missing);
        for library in library_names(&base, text, is_there) {
            let place = Place::new(&shown, *line);
            let read = folder.find(&base, &library).and_then(|f| Ok((folder.read(&f)?, f)));
            match read {
                Ok((bytes, f)) => {
                    let relative = PathBuf::from(folder.relative(&f));
                    let shown = folder.show(&relative.to_string_lossy());
                    let materials = Definitions::Mtl(mtl::parse(&bytes, &shown, warnings));
                    libraries.push(Library { relative, shown, materials });
                }
                Err(problem) => {
                    let message = format!("material library \"{library}\" {problem}; its materials are grey");
                    warnings.push(Warning::new(place, message));
                }
            }
        }
    }
    joined.add(file, shown, base, libraries);
    Ok(())
}

/// A file with materials.
struct Library {
    /// Relative to the scene's folder.
    relative: PathBuf,
    shown: PathBuf,
    materials: Definitions,
}

/// Materials as a file defines them.
enum Definitions {
    /// Of an MTL file.
    Mtl(Vec<MtlMaterial>),
    /// Of a glTF file, unique by name.
    Gltf(Vec<gltf::Source>),
}

impl Definitions {
    /// Their names, in order.
    fn names(&self) -> Vec<&str> {
        match self {
            Self::Mtl(list) => list.iter().map(|m| m.name.as_str()).collect(),
            Self::Gltf(list) => list.iter().map(|m| m.name.as_str()).collect(),
        }
    }

    /// The line that defines a material; 0 where none does.
    fn line_of(&self, name: &str) -> u32 {
        match self {
            Self::Mtl(list) => list.iter().find(|m| m.name == name).map_or(0, |m| m.line),
            Self::Gltf(_) => 0,
        }
    }
}

/// The materials that triangles use.
struct Materials {
    materials: Vec<Material>,
    /// Those from MTL, whose glass filters by passage.
    filters: Vec<MaterialId>,
    /// Those from glTF, whose maps are still to be joined.
    pending: Vec<gltf::surfaces::Pending>,
}

/// `mtllib` names one file with blanks, or several.
fn library_names(base: &Path, text: &str, is_there: impl Fn(&Path, &str) -> bool) -> Vec<String> {
    let whole = text.trim_matches('"');
    if is_there(base, whole) {
        return vec![whole.to_owned()];
    }
    let mut words = escaped_words(text);
    words.dedup();
    let any = words.iter().any(|w| is_there(base, w));
    if any { words } else { vec![whole.to_owned()] }
}

/// Words between blanks; a blank after a backslash belongs to its word.
fn escaped_words(text: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut letters = text.chars().peekable();
    while let Some(c) = letters.next() {
        if c == '\\' && letters.peek() == Some(&' ') {
            letters.next();
            words.last_mut().into_iter().for_each(|w| w.push(' '));
        } else if c.is_whitespace() {
            words.push(String::new());
        } else {
            words.last_mut().into_iter().for_each(|w| w.push(c));
        }
    }
    words.retain(|w| !w.is_empty());
    words
}

/// The materials that triangles use, from sidecar, MTL and glTF; texture ids are those of `requests`.
fn materials(
    joined: &Joined,
    sidecar: &Sidecar,
    folder: &Folder,
    requests: &mut TextureRequests,
    warnings: &mut Vec<Warning>,
) -> Materials {
    let by_name: HashMap<&str, usize> =
        sidecar.materials.iter().enumerate().map(|(i, m)| (m.material.name.as_str(), i)).collect();
    let mut doubts = Doubts::default();
    let mut materials = Vec::with_capacity(joined.uses.len());
    let (mut filters, mut pending) = (Vec::new(), Vec::new());
    for used in &joined.uses {
        let mut material = if let Some(&i) = by_name.get(used.called()) {
            let table = &sidecar.materials[i];
            let mut ids = Vec::new();
            for m in &table.maps {
                ids.push(requests.ask(folder, &[Path::new("")], &m.statement, m.is_color, m.place.clone()));
            }
            let ids: Vec<Option<TextureId>> = ids.into_iter().map(Some).collect();
            let mut material = table.material.clone();
            resolve_maps(&mut material, &ids);
            material
        } else if let Some((library, at)) = used.definition {
            let id = MaterialId(materials.len() as u32);
            let library = &joined.libraries[library];
            match &library.materials {
                Definitions::Mtl(list) => {
                    filters.push(id);
                    let beside = library.relative.parent().unwrap_or(Path::new(""));
                    let bases = [beside, joined.base_of(used.file)];
                    let mut texture = |map: &mtl::MapStatement, is_color: bool| {
                        let place = Place::new(&library.shown, map.line);
                        requests.ask(folder, &bases, map, is_color, place)
                    };
                    from_mtl::material(&list[at], &mut texture, &mut doubts)
                }
                Definitions::Gltf(list) => {
                    let place = Place::new(&library.shown, 0);
                    let (material, rest) = gltf::surfaces::ask(&list[at], id, &place, requests);
                    pending.push(rest);
                    material
                }
            }
        } else {
            if let Some(line) = used.line {
                let message = format!("no material library has \"{}\"; grey instead", used.name);
                warnings.push(Warning::new(Place::new(joined.shown_of(used.file), line), message));
            }
            from_mtl::default_material(&used.name)
        };
        material.name = used.unique.clone();
        materials.push(material);
    }
    for table in &sidecar.materials {
        let name = &table.material.name;
        if !joined.knows_material(name) {
            let message = format!("no mesh and no material library has a material \"{name}\"; not used");
            warnings.push(Warning::new(table.place.clone(), message));
        }
    }
    for (names, what) in [
        (doubts.bright, "reflects more light than it gets; scaled down to 1"),
        (doubts.opaque, "is wholly transparent by `Tr 1`; taken for opaque (write `d 0` if it is not)"),
    ] {
        if let (Some(first), Some(library)) = (names.first(), joined.libraries.first()) {
            let more =
                if names.len() > 1 { format!(" (and {} more)", names.len() - 1) } else { String::new() };
            let line = library.materials.line_of(first);
            warnings
                .push(Warning::new(Place::new(&library.shown, line), format!("\"{first}\"{more} {what}")));
        }
    }
    if materials.is_empty() {
        materials.push(from_mtl::default_material("default"));
    }
    Materials { materials, filters, pending }
}

/// Largest diffuse reflectance: at 1 light between walls would never end.
const ALBEDO_MAX: f32 = 0.99;

/// Keeps diffuse reflectances below 1; says of which materials.
fn clamp_albedo(scene: &mut Scene) -> Vec<String> {
    let textures = scene.textures.clone();
    let mut messages = Vec::new();
    for material in &mut scene.materials {
        let (Model::Lambert { albedo: diffuse }
        | Model::Plastic { albedo: diffuse, .. }
        | Model::CookTorrance { diffuse, .. }
        | Model::Ward { diffuse, .. }) = &mut material.model
        else {
            continue;
        };
        let mean = diffuse.map.map_or(1.0, |map| {
            let [r, g, b, _] = textures[map.0 as usize].mean();
            r.max(g).max(b)
        });
        let limit = ALBEDO_MAX / mean.max(1e-6);
        if diffuse.color.max_element() > limit {
            diffuse.color = diffuse.color.min(Vec3::splat(limit));
            messages.push(format!(
                "material \"{}\" reflects all light that falls on it; {ALBEDO_MAX} of it is used",
                material.name
            ));
        }
    }
    messages
}

/// Replaces the ids of a material's pictures; a missing picture leaves the colour, and half of it
/// where it was the diffuse colour.
fn resolve_maps(material: &mut Material, ids: &[Option<TextureId>]) {
    let new = |id: &mut Option<TextureId>| -> bool {
        let Some(old) = *id else { return false };
        *id = ids.get(old.0 as usize).copied().flatten();
        id.is_none()
    };
    let color = |r: &mut Reflectance| {
        if new(&mut r.map) {
            r.color *= 0.5;
        }
    };
    let factor = |r: &mut Reflectance| {
        new(&mut r.map);
    };
    match &mut material.model {
        Model::Lambert { albedo } | Model::Plastic { albedo, .. } => color(albedo),
        Model::Mirror { specular } | Model::Metal { specular, .. } => factor(specular),
        Model::CookTorrance { diffuse, specular, .. } | Model::Ward { diffuse, specular, .. } => {
            color(diffuse);
            factor(specular);
        }
        // Made after this, of maps that are there.
        Model::MetalRough(_) | Model::Conductor { .. } | Model::Dielectric { .. } => {}
    }
    factor(&mut material.emission);
    for id in [&mut material.opacity_map, &mut material.bump_map, &mut material.normal_map] {
        new(id);
    }
}

fn environment(
    sidecar: &Sidecar,
    folder: &mut Folder,
    ahead: Option<Surroundings>,
    options: &LoadOptions,
    warnings: &mut Vec<Warning>,
) -> Option<Environment> {
    let table = sidecar.environment.as_ref()?;
    let mut environment =
        Environment { radiance: table.radiance, map: None, rotate_up: table.rotate_up, up: sidecar.up };
    let Some(file) = &table.map else { return Some(environment) };
    let found = folder.find(Path::new(""), &file.name);
    let decoded = found.map_err(|problem| problem.to_string()).and_then(|found| match ahead {
        Some(ahead) if ahead.found == found => {
            folder.note(folder.relative(&found), ahead.hash);
            ahead.made
        }
        _ => {
            let bytes = folder.read(&found).map_err(|problem| problem.to_string())?;
            textures::radiance_map(&bytes, &found, options)
        }
    });
    match decoded {
        Ok((map, bad)) => {
            if bad > 0 {
                let message =
                    format!("\"{}\": {bad} texels are negative, NaN or infinite; put right", file.name);
                warnings.push(Warning::new(file.place.clone(), message));
            }
            environment.map = Some(map);
        }
        Err(why) => {
            let message = format!("environment map \"{}\" {why}; its constant radiance instead", file.name);
            warnings.push(Warning::new(file.place.clone(), message));
        }
    }
    Some(environment)
}

/// MTL filters light once per passage; solid glass absorbs per length of path. The mean chord of a
/// convex body is 4 V / S; here that of the bounds of the material's parts.
fn filters_to_absorption(scene: &mut Scene, filters: &[MaterialId]) {
    for &id in filters {
        let mut chords = Vec::new();
        for object in scene.objects.iter().skip(1).filter(|o| o.material == id) {
            let d = object.bounds[1] - object.bounds[0];
            let surface = 2.0 * (d.x * d.y + d.y * d.z + d.z * d.x);
            if surface > 0.0 {
                chords.push(4.0 * d.x * d.y * d.z / surface);
            }
        }
        let mean = chords.iter().sum::<f32>() / chords.len().max(1) as f32;
        if let Some(Model::Dielectric { transmittance, thin: false, .. }) =
            scene.materials.get_mut(id.0 as usize).map(|m| &mut m.model)
            && mean > 0.0
        {
            let inverse = 1.0 / mean;
            *transmittance =
                transmittance.max(Vec3::splat(1e-6)).map(|t| math::powf(t, inverse).clamp(0.0, 1.0));
        }
    }
}
