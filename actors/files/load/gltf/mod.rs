//! glTF 2.0, as text with files beside it or as one binary file.
//!
//! The document is read into structures of our own over `serde_json`: the crates for it panic on hostile files, follow
//! `../` and pipes, and hand on circles. Nothing is allocated by a number that has not been held against the bytes there
//! are, and only what the shown scene draws is read at all. What is odd but harmless becomes one line per kind.

mod accessor;
mod animation;
mod buffers;
mod container;
mod document;
#[cfg(feature = "draco")]
mod draco;
mod extensions;
pub(super) mod image_based;
mod joined;
mod joined_maps;
mod lights;
mod materials;
mod meshes;
mod meshopt;
mod nodes;
mod number;
mod paths;
mod pictures;
mod pointers;
mod reader;
mod skins;
pub(super) mod surfaces;
mod tangents;
#[cfg(test)]
mod tests;
mod texels;
#[cfg(test)]
mod verdict_tests;
mod whole;

use std::collections::BTreeMap;
use std::path::Path;

use super::LoadOptions;
use super::error::{Place, SceneError, Warning};
use super::folder::Folder;
use super::obj::ObjFile;
use buffers::Buffers;
use document::Document;
use foveal::scene::{CameraPath, ExtensionUse, Light, NamedCamera};
use number::{Index, List};
use reader::Reader;

pub(super) use materials::Source;

/// r from which on a dielectric counts as diffuse: in the mirrored direction of a small lamp straight above, its layer
/// adds 3 % to a grey base.
const GLOSS_FLOOR: f32 = 0.9;

/// What is wrong with a document: where, as a JSON pointer, what, and what to do.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Problem {
    pub pointer: String,
    pub message: String,
}

impl Problem {
    fn new(pointer: impl Into<String>, message: impl Into<String>) -> Self {
        Self { pointer: pointer.into(), message: message.into() }
    }
}

/// An element of one of the document's arrays.
fn get<'d, T, const MAX: usize>(list: &'d List<T, MAX>, index: Index, name: &str) -> Result<&'d T, Problem> {
    list.get(index.at()).ok_or_else(|| {
        let message = format!("{} is asked for, but there are {}; export again", index.0, list.len());
        Problem::new(format!("/{name}"), message)
    })
}

/// What is odd in a file, and how often.
#[derive(Debug, Default)]
pub(super) struct Oddities(BTreeMap<(String, &'static str), usize>);

impl Oddities {
    /// One more of `what`, with what is done about it.
    fn count(&mut self, what: &str, done: &'static str) {
        self.add(what, done, 1);
    }

    fn add(&mut self, what: &str, done: &'static str, times: usize) {
        *self.0.entry((what.to_owned(), done)).or_default() += times;
    }

    #[cfg(test)]
    fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    fn report(&self, place: &Place, warnings: &mut Vec<Warning>) {
        for ((what, done), times) in &self.0 {
            let times = if *times == 1 { String::new() } else { format!(" ({times} times)") };
            warnings.push(Warning::new(place.clone(), format!("{what}{times}: {done}")));
        }
    }
}

/// What the sidecar's `[gltf]` and the command line choose.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Choices {
    /// Name of the scene to show.
    pub scene: Option<String>,
    /// Name of the variant of materials.
    pub variant: Option<String>,
    /// Factor of all lights.
    pub light_scale: f32,
    /// Extensions to do without.
    pub ignored: Vec<String>,
    /// Name of the animation that moves cameras and poses the scene.
    pub play: Option<String>,
    /// The time at which the scene stands, seconds; before its animation begins where there is none.
    pub time: Option<f32>,
    /// Whether eyes see through the backs of what is not double-sided.
    pub cull: bool,
    /// Roughness from which on what is no metal counts as diffuse; beyond 1 nothing does.
    pub gloss_floor: f32,
}

impl Default for Choices {
    fn default() -> Self {
        Self {
            scene: None,
            variant: None,
            light_scale: 1.0,
            ignored: Vec::new(),
            play: None,
            time: None,
            cull: true,
            gloss_floor: GLOSS_FLOOR,
        }
    }
}

/// What one file shows.
#[derive(Debug, Default)]
pub(super) struct GltfFile {
    /// Triangles, in the form that OBJ files have, with names of nodes.
    pub mesh: ObjFile,
    /// In the order of first use; those of `mesh.materials`.
    pub materials: Vec<Source>,
    pub lights: Vec<Light>,
    pub cameras: Vec<NamedCamera>,
    /// Of cameras that an animation moves, by their names.
    pub paths: Vec<CameraPath>,
    /// What is all around.
    pub cube_map: Option<image_based::CubeMap>,
    /// Its extensions.
    pub extensions: Vec<ExtensionUse>,
}

/// Reads a file. `shown` names it in messages; `base` is its folder, relative to the scene's.
pub(super) fn parse(
    bytes: &[u8],
    shown: &Path,
    base: &Path,
    folder: &mut Folder,
    choices: &Choices,
    options: &LoadOptions,
    warnings: &mut Vec<Warning>,
) -> Result<GltfFile, SceneError> {
    let place = Place::new(shown, 0);
    let container = container::open(bytes)
        .map_err(|message| SceneError::Container { path: shown.to_path_buf(), message })?;
    for doubt in &container.doubts {
        warnings.push(Warning::new(place.clone(), doubt.clone()));
    }
    let json = &bytes[container.json.clone()];
    let refuse = |problem: Problem| SceneError::Document {
        place: place.clone(),
        pointer: problem.pointer,
        message: problem.message,
    };
    let document: Document = serde_json::from_slice(json).map_err(|e| {
        let line = if container.json.start < 12 { e.line() as u32 } else { 0 };
        let message = format!("not a readable glTF document: {}", buffers::shortened(&e.to_string()));
        SceneError::Document { place: Place::new(shown, line), pointer: String::new(), message }
    })?;
    if !document.asset.version.starts_with("2.") {
        let message = format!("is {:?}; this build reads 2.0", buffers::shortened(&document.asset.version));
        return Err(refuse(Problem::new("/asset/version", message)));
    }
    let mut odd = Oddities::default();
    let used = extensions::check(&document, json, &choices.ignored, &place, &mut odd)?;
    let mut document = document;
    if let Some(time) = choices.time {
        let changes = {
            let mut buffers = Buffers::new(&document, folder, base, bytes, container.bin.clone());
            pointed(&document, choices, time, &mut buffers).map_err(refuse)?
        };
        changes.into_iter().for_each(|(value, to)| pointers::set(&mut document, value, &to));
    }
    let mut buffers = Buffers::new(&document, folder, base, bytes, container.bin);
    let reader = Reader::new(&document, choices, options.triangles_max, &mut odd);
    let mut out = reader.read(&mut buffers).map_err(refuse)?;
    out.extensions = used;
    if out.mesh.triangles.is_empty() {
        whole::check(&document, json, &mut buffers, &mut odd).map_err(refuse)?;
        odd.count("no triangle", "nothing is drawn but the sky");
    }
    odd.report(&place, warnings);
    Ok(out)
}

/// What the chosen animation makes of values that are no transforms.
fn pointed<'d>(
    document: &'d Document,
    choices: &Choices,
    time: f32,
    buffers: &mut Buffers<'d>,
) -> Result<Vec<(pointers::Value, Vec<f32>)>, Problem> {
    // What is odd is said when everything else is read.
    let mut unheard = Oddities::default();
    let Some(animation) = animation::chosen(document, choices.play.as_deref(), &mut unheard) else {
        return Ok(Vec::new());
    };
    if animation.1.channels.iter().all(|c| c.target.extensions.pointer.is_none()) {
        return Ok(Vec::new());
    }
    Ok(animation::read(animation, document, buffers, &mut unheard)?.values(time).collect())
}
