//! What a recording says of the run behind it: enough to make the same world again, and to name what differs.

use std::path::{Path, PathBuf};

use foveal::display::cpu_pass::Passes;
use foveal::illumination::Irradiance;
use foveal::illumination::bake::{BakeSettings, cache_key};
use foveal::illumination::stored::Illumination;
use foveal::scene::Scene;
use foveal::scene::edit::AsRead;
use foveal_files::bakes::{encode, save, under};
use foveal_runtime::{Header, Trace, TraceError};
use serde::{Deserialize, Serialize};

use foveal_actors::settings::Settings;
use foveal_actors::station::STATIONS_MAX;

use crate::bake_clock::Watch;
use crate::failure::Failure;
use crate::kept_light;
use crate::kept_scene::{self, Read};
use crate::light::Light;
use crate::machine::Machine;
use crate::opened::{self, Opened};

/// Most tracers of a session: with the thread of the light actors, as many as the runtime's threads.
pub const TRACERS_MAX: u32 = 63;

/// The application's part of a recording's header.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RecordedRun {
    /// Program and version that recorded.
    pub program: String,
    /// The command: walk, view, serve, simulate.
    pub command: String,
    /// The scene file as it was named.
    pub scene: PathBuf,
    /// BLAKE3 of everything the scene was read from, hexadecimal.
    pub scene_hash: String,
    /// Settings that all actors shared.
    pub settings: Settings,
    /// Whether the texture-id pass ran.
    pub texture_ids: bool,
    /// Whether there was anything to correct.
    pub corrects: bool,
    /// Most bytes of textures in memory, where that was less than all.
    pub texture_limit: Option<u64>,
    /// Where the illumination came from.
    pub illumination: Light,
    /// BLAKE3 of the stored illumination, hexadecimal.
    pub illumination_hash: String,
    /// Particles of that illumination.
    pub particles: u64,
    /// Relative error of that illumination.
    pub relative_error: f32,
    /// Names and BLAKE3 of the files that the scene was read from: so that it can be said which one is another now.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub scene_files: Vec<(String, String)>,
    /// The recording that it goes on from, if it does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parent: Option<Parent>,
}

/// Where a walk left a recording that was looked at.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Parent {
    /// The recording, as it was named.
    pub recording: PathBuf,
    /// BLAKE3 of its file, hexadecimal.
    pub hash: String,
    /// The frame that was on show.
    pub frame: u32,
}

impl Parent {
    /// A file's hash; empty where it cannot be read.
    pub fn hash_of(file: &Path) -> String {
        std::fs::read(file).map_or_else(|_| String::new(), |bytes| blake3::hash(&bytes).to_hex().to_string())
    }

    /// The file of it, where it still is what it was.
    ///
    /// # Errors
    /// Says that it is not there, or another one now.
    pub fn find(&self, child: &Path) -> Result<PathBuf, Failure> {
        let wrong = |what: &str| {
            let (child, parent) = (child.display(), self.recording.display());
            Failure::Input(format!("{child}: goes on from frame {} of {parent}, which {what}", self.frame))
        };
        // Recordings of one session mostly lie in one folder.
        let beside = || {
            let file = child.parent()?.join(self.recording.file_name()?);
            file.exists().then_some(file)
        };
        let file = find(&self.recording, child).or_else(beside);
        let file = file.ok_or_else(|| wrong("is neither here nor beside it"))?;
        if Self::hash_of(&file) == self.hash { Ok(file) } else { Err(wrong("is another recording now")) }
    }
}

impl RecordedRun {
    /// Describes a run that is about to begin.
    pub fn new(command: &str, opened: &Opened, machine: &Machine) -> Result<Self, Failure> {
        let (particles, relative_error) = extent(&*opened.world.illumination);
        Ok(Self {
            program: program(),
            command: command.to_owned(),
            scene: opened.path.clone(),
            scene_hash: hex(opened.world.scene.content_hash),
            settings: machine.settings,
            texture_ids: machine.passes.texture_ids,
            corrects: machine.corrects,
            texture_limit: opened.textures.as_ref().map(|store| store.limit),
            illumination: Light {
                refined: opened.refinement.is_some(),
                begun: opened.refinement.as_ref().map_or(0, |refinement| refinement.begun),
                ..opened.light.clone()
            },
            illumination_hash: illumination_hash(&*opened.world.illumination)?,
            particles,
            relative_error,
            scene_files: files_of(&opened.world.scene),
            parent: None,
        })
    }

    /// As it stands in a header.
    pub fn to_bytes(&self) -> Result<Vec<u8>, Failure> {
        serde_json::to_vec(self)
            .map_err(|e| Failure::Check(format!("the recording's header cannot be written: {e}")))
    }

    /// From a header; every number in it is checked.
    pub fn of(trace: &Trace, path: &Path) -> Result<Self, Failure> {
        Self::in_header(trace.header(), path)
    }

    /// As [`RecordedRun::of`], of a recording of which only the header is read.
    pub fn in_header(header: &Header, path: &Path) -> Result<Self, Failure> {
        let wrong = |what: String| Failure::Input(format!("{}: {what}", path.display()));
        let run: Self = serde_json::from_slice(&header.application)
            .map_err(|e| wrong(format!("this is no recording of foveal: {e}")))?;
        match unsound(&run.settings) {
            None => Ok(run),
            Some(what) => Err(wrong(format!("the recording's header is damaged: {what}"))),
        }
    }

    /// Which parts of the machine ran.
    pub fn machine(&self) -> Machine {
        let passes = Passes { texture_ids: self.texture_ids };
        Machine { settings: self.settings, passes, corrects: self.corrects }
    }

    /// Whether it began in this light.
    pub fn began_in(&self, illumination: &dyn Irradiance) -> bool {
        illumination_hash(illumination).is_ok_and(|hash| hash == self.illumination_hash)
    }

    /// The world of the run. What is given in `elsewhere` takes the place of the recorded files.
    pub fn open(&self, trace: &Path, elsewhere: &Elsewhere, watch: &dyn Watch) -> Result<Opened, Failure> {
        let wrong = |what: String| Failure::Input(format!("{}: {what}", trace.display()));
        let scene_file = match &elsewhere.scene {
            Some(file) => file.clone(),
            None => find(&self.scene, trace).ok_or_else(|| {
                wrong(format!(
                    "its scene {} is neither here nor beside the recording; name it with --scene",
                    self.scene.display()
                ))
            })?,
        };
        let kept_in = Light { cache: elsewhere.cache.clone(), ..self.illumination.clone() };
        let read = kept_scene::read(&scene_file, &kept_in)?;
        let scene = &read.scene;
        let here = hex(AsRead::of(scene).hash(&self.illumination.edits));
        if here != self.scene_hash {
            return Err(wrong(format!(
                "recorded in another scene: {} had the content {} then, {} has {here}{}",
                self.scene.display(),
                self.scene_hash,
                scene_file.display(),
                changed(&self.scene_files, &files_of(scene)),
            )));
        }
        let mut illumination = self.illumination.clone();
        illumination.cache.clone_from(&elsewhere.cache);
        illumination.baked = !illumination.refined && !illumination.quick;
        // Where the recorded file is gone, the same bake may be kept, or is made again: its hash tells.
        illumination.bake = match (&elsewhere.bake, &self.illumination.bake) {
            (Some(given), _) => Some(given.clone()),
            (None, recorded) => recorded.as_ref().and_then(|file| find(file, trace)),
        };
        let grows = illumination.refined || illumination.quick;
        let folder = opened::cache_folder(elsewhere.cache.as_deref()).filter(|_| grows);
        illumination.first = folder.map(|folder| folder.join(&self.illumination_hash).with_extension(FIRST));
        if illumination.begun > 0 {
            self.take_beside(trace, &read, &illumination)?;
        }
        let mut opened = opened::with_light(&scene_file, read, &illumination, watch)?;
        let stored = &*opened.world.illumination;
        // What is kept under the recorded hash was taken if it is that.
        let kept = illumination.first.as_ref().filter(|_| grows).and_then(|file| kept_hash(file));
        let here = match kept {
            Some(kept) if kept == self.illumination_hash => kept,
            _ => illumination_hash(stored)?,
        };
        if here != self.illumination_hash {
            let (particles, relative_error) = extent(stored);
            return Err(wrong(format!(
                "recorded under another illumination: {} particles, error {:.4}, content {} then; \
                 {particles} particles, error {relative_error:.4}, content {here} here; name the recorded bake \
                 with --bake",
                self.particles, self.relative_error, self.illumination_hash
            )));
        }
        // Known to be the light of the recording: the next replay need not make it.
        if let (Some(file), Some(stored)) =
            (illumination.first.filter(|file| !file.exists()), stored_of(&opened))
        {
            let key = cache_key(&opened.world.scene, &illumination.settings.settings(&opened.world.scene));
            let _ = file.parent().map(std::fs::create_dir_all);
            let _ = save(&file, &key, stored);
        }
        opened.limit_textures(self.texture_limit)?;
        Ok(opened)
    }

    /// Puts the light that the walk began with where it is looked for, if it is among the maps beside the recording and not
    /// there yet. Where it is not, it is baked again.
    fn take_beside(&self, trace: &Path, read: &Read, light: &Light) -> Result<(), Failure> {
        let Some(first) = light.first.as_ref().filter(|file| !file.exists()) else { return Ok(()) };
        let edited = AsRead::of(&read.scene)
            .edited(&read.scene, &light.edits)
            .map_err(|e| Failure::Input(format!("{}: {e}", trace.display())))?;
        let settings = light.settings.settings(&edited);
        let beside = light_beside(trace);
        let kept = kept_light::beside_recording(&beside, &edited, &settings, &self.illumination_hash);
        if let Some(map) = kept.filter(|map| self.began_in(&**map)) {
            let folder = first.parent().map_or(Ok(()), std::fs::create_dir_all);
            let saved =
                folder.map_err(Into::into).and_then(|()| save(first, &cache_key(&edited, &settings), &*map));
            if let Err(e) = saved {
                tracing::warn!("{}: {e}", first.display());
            }
        }
        Ok(())
    }
}

/// Files that replay takes instead of the recorded ones.
#[derive(Clone, Debug, Default)]
pub struct Elsewhere {
    /// The scene, where it has moved.
    pub scene: Option<PathBuf>,
    /// The bake the walk was recorded with, where it has moved.
    pub bake: Option<PathBuf>,
    /// Folder of kept bakes; `None` is FOVEAL_CACHE, else the user's cache folder.
    pub cache: Option<PathBuf>,
}

/// Reads a recording. What is missing at its end costs only that end; what is damaged is refused.
pub fn open_trace(path: &Path) -> Result<Trace, Failure> {
    checked_trace(path, Trace::open(path))
}

/// What was read of a file, where it can be replayed.
pub(crate) fn checked_trace(path: &Path, read: Result<Trace, TraceError>) -> Result<Trace, Failure> {
    let trace = read.map_err(|e| match e {
        TraceError::Io(e) => Failure::file(path, e),
        other => Failure::file(path, other),
    })?;
    let Some(cut) = trace.damage() else { return Ok(trace) };
    if !ends_early(path, cut.offset) {
        return Err(Failure::Input(format!(
            "{}: damaged at byte {}: {}; `foveal log cut` keeps what is before",
            path.display(),
            cut.offset,
            cut.reason
        )));
    }
    tracing::warn!("{}: {}; what is there is replayed", path.display(), cut.reason);
    Ok(trace)
}

/// Whether the file simply ends behind `offset`, as after a kill, rather than holding something wrong.
pub fn ends_early(path: &Path, offset: u64) -> bool {
    use std::io::{Read, Seek, SeekFrom};
    /// Lengths and checksum before each segment.
    const HEAD: u64 = 12;
    let left = || -> std::io::Result<(u64, [u8; 8])> {
        let mut file = std::fs::File::open(path)?;
        let left = file.metadata()?.len().saturating_sub(offset);
        let mut lengths = [0; 8];
        if left >= HEAD {
            file.seek(SeekFrom::Start(offset))?;
            file.read_exact(&mut lengths)?;
        }
        Ok((left, lengths))
    };
    left().is_ok_and(|(left, lengths)| {
        let stored = u32::from_le_bytes([lengths[4], lengths[5], lengths[6], lengths[7]]);
        left < HEAD || left < HEAD + u64::from(stored)
    })
}

/// This program and its version.
pub fn program() -> String {
    concat!("foveal ", env!("CARGO_PKG_VERSION")).to_owned()
}

/// Files of a scene that a message names at most.
const NAMED_MAX: usize = 3;

fn files_of(scene: &Scene) -> Vec<(String, String)> {
    scene.files.iter().map(|(name, hash)| (name.clone(), hex(*hash))).collect()
}

/// Which files are other ones now, as the end of a message; nothing where a recording does not say which it was made of.
fn changed(then: &[(String, String)], now: &[(String, String)]) -> String {
    let of = |files: &[(String, String)], name: &str| {
        files.iter().find(|(of, _)| of == name).map(|(_, hash)| hash.clone())
    };
    if then.is_empty() {
        return String::new();
    }
    let mut told: Vec<String> = then
        .iter()
        .filter_map(|(name, hash)| match of(now, name) {
            None => Some(format!("{name} is not read any more")),
            Some(here) if here != *hash => Some(format!("{name} has changed")),
            Some(_) => None,
        })
        .chain(
            now.iter().filter(|(name, _)| of(then, name).is_none()).map(|(name, _)| format!("{name} is new")),
        )
        .collect();
    if told.is_empty() {
        told.push("its files are the same, what was chosen of them or edited is not".into());
    }
    let more = told.len().saturating_sub(NAMED_MAX);
    told.truncate(NAMED_MAX);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    format!("; {}{more}", told.join(", "))
}

fn hex(hash: [u8; 32]) -> String {
    blake3::Hash::from_bytes(hash).to_hex().to_string()
}

/// A hash of all stored values.
pub fn illumination_hash(illumination: &dyn Irradiance) -> Result<String, Failure> {
    let Some(stored) = illumination.stored() else { return Ok("none".to_owned()) };
    let bytes = encode(&[0; 32], stored)
        .map_err(|e| Failure::Check(format!("the illumination cannot be identified: {e}")))?;
    Ok(blake3::hash(&bytes).to_hex().to_string())
}

/// What [`illumination_hash`] says of an illumination that is kept in a file.
fn kept_hash(file: &Path) -> Option<String> {
    let bytes = std::fs::read(file).ok()?;
    Some(blake3::hash(&under(&[0; 32], &bytes).ok()?).to_hex().to_string())
}

/// Where the maps of light that grows lie: beside the recording, under its name and `.light`.
pub fn light_beside(recording: &Path) -> PathBuf {
    let mut name = recording.as_os_str().to_owned();
    name.push(".light");
    PathBuf::from(name)
}

/// What files of first estimates are called that replays keep.
pub(crate) const FIRST: &str = "fvfirst";

fn stored_of(opened: &Opened) -> Option<&Illumination> {
    opened.world.illumination.stored()
}

/// What tells apart the light that a walk's refinement comes to, by all that decides it. `began_in` is what [`illumination_hash`]
/// says of what it begins with.
pub fn light_key(scene: &Scene, settings: &BakeSettings, began_in: &str) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&cache_key(scene, settings));
    hasher.update(&settings.particles.unwrap_or(0).to_le_bytes());
    hasher.update(&settings.error.unwrap_or(0.0).to_le_bytes());
    hasher.update(began_in.as_bytes());
    *hasher.finalize().as_bytes()
}

fn extent(illumination: &dyn Irradiance) -> (u64, f32) {
    illumination.stored().map_or((0, 0.0), |stored| (stored.summary.particles, stored.summary.relative_error))
}

/// A recorded file: where it was, or at the same place relative to the recording or a folder above it.
fn find(file: &Path, trace: &Path) -> Option<PathBuf> {
    if file.exists() {
        return Some(file.to_owned());
    }
    let trace = trace.canonicalize().ok()?;
    trace.ancestors().skip(1).map(|folder| folder.join(file)).find(|candidate| candidate.exists())
}

/// What no command line could have asked for.
fn unsound(s: &Settings) -> Option<String> {
    let pixels = u64::from(s.width) * u64::from(s.height);
    let side = 1..=16384;
    let checks = [
        (side.contains(&s.width) && side.contains(&s.height) && pixels <= 1 << 26, "picture size"),
        ((1..=TRACERS_MAX).contains(&s.tracers), "number of tracers"),
        (s.stations <= STATIONS_MAX && s.tracers + s.stations <= TRACERS_MAX + 1, "number of stations"),
        (s.checked >= 1, "share of samples that are checked"),
        ((1..=1 << 20).contains(&s.samples_per_job), "samples of a job"),
        (s.k_max <= 7, "number of levels"),
        (s.cache_capacity <= 1 << 26, "size of the sample cache"),
        ((0.0..=1.0).contains(&s.saliency_weight), "weight of saliency"),
        (s.policy.reduction > 0.0 && s.policy.reduction < 1.0, "reduction of priorities"),
    ];
    checks.iter().find(|(sound, _)| !sound).map(|(_, what)| format!("no such {what}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_found_beside_the_recording_and_above() {
        let folder = tempfile::tempdir().expect("a folder");
        let (scenes, traces) = (folder.path().join("scenes"), folder.path().join("traces"));
        std::fs::create_dir_all(&scenes).expect("made");
        std::fs::create_dir_all(&traces).expect("made");
        let (scene, trace) = (scenes.join("unheard-of.obj"), traces.join("a.fvl"));
        std::fs::write(&scene, "").expect("written");
        std::fs::write(&trace, "").expect("written");
        let found = find(Path::new("scenes/unheard-of.obj"), &trace).expect("found");
        assert_eq!(found, scene.canonicalize().expect("there"));
        assert_eq!(find(Path::new("scenes/other.obj"), &trace), None);
    }

    #[test]
    fn the_file_that_is_another_one_is_named() {
        let file = |name: &str, hash: &str| (name.to_owned(), hash.to_owned());
        let then = [file("a.toml", "1"), file("a.obj", "2"), file("floor.png", "3")];
        let check = |now: &[(String, String)], says: &str| assert_eq!(changed(&then, now), says);
        check(&[file("a.toml", "1"), file("a.obj", "4"), file("floor.png", "3")], "; a.obj has changed");
        check(
            &[file("a.toml", "1"), file("a.obj", "2"), file("wall.png", "3")],
            "; floor.png is not read any more, wall.png is new",
        );
        check(&then, "; its files are the same, what was chosen of them or edited is not");
        let other: Vec<_> = ["v", "w", "x"].iter().map(|name| file(name, "5")).collect();
        assert!(changed(&then, &other).ends_with("floor.png is not read any more and 3 more"));
        assert_eq!(changed(&[], &then), "", "an older recording does not say");
    }

    #[test]
    fn settings_that_no_command_line_gives_are_refused() {
        let settings = Settings::new(64, 48, 3);
        assert_eq!(unsound(&settings), None);
        for wrong in [
            Settings { width: 0, ..settings },
            Settings { width: 16384, height: 16384, ..settings },
            Settings { tracers: 64, ..settings },
            Settings { samples_per_job: 0, ..settings },
            Settings { k_max: 8, ..settings },
            Settings { cache_capacity: usize::MAX, ..settings },
            Settings { saliency_weight: f32::NAN, ..settings },
        ] {
            assert!(unsound(&wrong).is_some(), "{wrong:?}");
        }
    }

    #[test]
    fn what_ends_early_is_told_from_what_is_damaged() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a.fvl");
        let segment = |stored: u32, bytes: usize| {
            let mut file = vec![7; 20];
            file.extend_from_slice(&4u32.to_le_bytes());
            file.extend_from_slice(&stored.to_le_bytes());
            file.extend_from_slice(&[0; 4]);
            file.resize(file.len() + bytes, 1);
            std::fs::write(&path, file).expect("written");
            ends_early(&path, 20)
        };
        assert!(!segment(10, 10), "all of it is there, so it is wrong");
        assert!(segment(10, 9));
        std::fs::write(&path, [7; 25]).expect("written");
        assert!(ends_early(&path, 20));
    }
}
