//! The first maps of a walk's light, kept beside the bakes, so that the next walk of the same scene begins in them.
//!
//! A first estimate takes longer than all else before a first picture, and the rounds after it seconds more. What an illuminator
//! published last is a function of scene, settings and the rounds of its bake ([`foveal::illumination::bake`]). So a recording
//! says how many they were and what came out ([`crate::recording`]), and its replay has three ways to the same bits: this file's
//! copy under its hash, the maps beside the recording, and the bake as far as that. A walk that begins so bakes as any other, from
//! its own first estimate, and shows nothing of it before it is better: its last map is that of `foveal bake`.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use foveal::illumination::bake::{BakeSettings, Baker, Step, early_key};
use foveal::illumination::stored::Illumination;
use foveal::scene::Scene;
use foveal::transport::Indexed;
use foveal_actors::light_book::{Known, LightBook};
use foveal_files::bakes::{load_illumination, save};

use crate::kept_scene::make_room;
use crate::opened::cache_folder;

const EXTENSION: &str = "fvearly";
/// Bytes of all of them; what was used least lately goes.
const BYTES_MAX: u64 = 1 << 30;

/// Where the early light of a bake with these settings is kept: its name holds all that decides its content.
pub(crate) fn file(given: Option<&Path>, scene: &Scene, settings: &BakeSettings) -> Option<PathBuf> {
    let name = blake3::Hash::from_bytes(early_key(scene, settings)).to_hex();
    cache_folder(given).map(|folder| folder.join("light").join(format!("{}.{EXTENSION}", &name[..32])))
}

/// What is kept there, where it is whole and of this scene and these settings.
pub(crate) fn load(file: &Path, scene: &Scene, settings: &BakeSettings) -> Option<Illumination> {
    let triangles = scene.mesh.triangles.len();
    match load_illumination(file, &early_key(scene, settings), triangles) {
        Ok(map) => {
            let opened = std::fs::File::options().append(true).open(file);
            if let Err(e) = opened.and_then(|file| file.set_modified(SystemTime::now())) {
                tracing::debug!("{}: {e}", file.display());
            }
            Some(map)
        }
        Err(e) => {
            tracing::debug!("{}: {e}", file.display());
            None
        }
    }
}

/// Keeps a first estimate, on a thread beside that nobody waits for. Its illuminator writes what comes after it there.
pub(crate) fn keep(file: &Path, scene: &Scene, settings: &BakeSettings, first: Arc<Illumination>) {
    let (file, key) = (file.to_owned(), early_key(scene, settings));
    let write = move || {
        foveal_runtime::give_way();
        let folder = file.parent().unwrap_or(Path::new("."));
        let room = std::fs::create_dir_all(folder).and_then(|()| make_room(folder, EXTENSION, BYTES_MAX, 0));
        if let Err(e) = room.map_err(Into::into).and_then(|()| save(&file, &key, &*first)) {
            tracing::debug!("{}: {e}", file.display());
        }
    };
    // Without a thread it is made again next time.
    let _ = std::thread::Builder::new().name("keep light".into()).spawn(write);
}

/// The map that a recorded walk began with, of the maps beside the recording. `begun` is what says which it is.
pub(crate) fn beside_recording(
    maps: &Path,
    scene: &Scene,
    settings: &BakeSettings,
    begun: &str,
) -> Option<Arc<Illumination>> {
    let key = crate::recording::light_key(scene, settings, begun);
    // The first turn publishes what it began with.
    match LightBook::open(key, scene.mesh.triangles.len(), &[maps], None).turn(0) {
        Known::Published { map, .. } => Some(map),
        Known::Silent | Known::Unknown => None,
    }
}

/// The map of a bake after so many rounds.
pub(crate) fn baked(indexed: Indexed<'_>, settings: &BakeSettings, rounds: u32) -> Illumination {
    let mut baker = Baker::new(indexed, settings);
    loop {
        match baker.step(indexed) {
            Step::Better(map) if map.summary.rounds < rounds => {}
            Step::Better(map) | Step::Done(map) => return Illumination::clone(&map),
            Step::Going => {}
        }
    }
}
