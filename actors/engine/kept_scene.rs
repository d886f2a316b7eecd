//! Scenes kept beside the bakes, so that a second start reads what the first one made ([`foveal_files::kept`]).

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use std::time::SystemTime;

use foveal::geometry::Accel;
use foveal::scene::Scene;
use foveal_files::kept::{self, Kept, KeptError};
use foveal_files::load::{self, LoadOptions, Sources};

use crate::failure::Failure;
use crate::light::Light;
use crate::opened::cache_folder;

/// Smaller scenes are read as fast from their files: triangles, and bytes of textures.
const WORTH: (usize, usize) = (20_000, 4 << 20);
/// Bytes of all kept scenes; what was used least lately goes.
const BYTES_MAX: u64 = 4 << 30;

/// A scene that was read.
pub(crate) struct Read {
    pub scene: Arc<Scene>,
    /// Its index, where it was kept.
    pub accel: Option<Arc<Accel>>,
    pub warnings: Vec<String>,
    /// Where it is to be kept.
    keep: Option<Keep>,
}

/// What it takes to keep a scene.
struct Keep {
    file: PathBuf,
    made_by: [u8; 32],
    sources: Sources,
    warnings: Vec<String>,
}

impl Read {
    /// A scene that is not to be kept.
    pub fn of(scene: Arc<Scene>, warnings: Vec<String>) -> Self {
        Self { scene, accel: None, warnings, keep: None }
    }

    /// Keeps the scene with its index, on a thread beside that nobody waits for: a process that ends before leaves nothing.
    pub fn keep(&mut self, scene: &Arc<Scene>, accel: &Arc<Accel>) {
        let Some(keep) = self.keep.take() else { return };
        let (scene, accel) = (scene.clone(), accel.clone());
        let write = move || {
            foveal_runtime::give_way();
            if let Err(e) = keep.write(&scene, &accel) {
                tracing::debug!("{}: {e}", keep.file.display());
            }
        };
        // Without a thread it is read again next time.
        let _ = std::thread::Builder::new().name("keep scene".into()).spawn(write);
    }
}

impl Keep {
    fn write(&self, scene: &Scene, accel: &Accel) -> Result<(), KeptError> {
        let encoded = kept::encode(&self.made_by, &self.sources, scene, accel, &self.warnings)?;
        let folder = self.file.parent().unwrap_or(Path::new("."));
        fs::create_dir_all(folder)?;
        make_room(folder, EXTENSION, BYTES_MAX, encoded.bytes())?;
        encoded.save(&self.file)
    }
}

/// Removes files with this extension until `bytes` fit below `most`, those that were used least lately first.
pub(crate) fn make_room(folder: &Path, extension: &str, most: u64, bytes: u64) -> std::io::Result<()> {
    let mut kept: Vec<(SystemTime, u64, PathBuf)> = fs::read_dir(folder)?
        .filter_map(Result::ok)
        .filter(|entry| entry.path().extension().is_some_and(|e| e == extension))
        .filter_map(|entry| {
            let meta = entry.metadata().ok()?;
            Some((meta.modified().ok()?, meta.len(), entry.path()))
        })
        .collect();
    kept.sort();
    let mut all: u64 = bytes + kept.iter().map(|(_, bytes, _)| bytes).sum::<u64>();
    for (_, bytes, file) in kept {
        if all <= most {
            break;
        }
        fs::remove_file(file)?;
        all -= bytes;
    }
    Ok(())
}

const EXTENSION: &str = "fvscene";

/// Reads a scene, kept or from its files; warnings go to the log and into the list.
pub(crate) fn read(path: &Path, light: &Light) -> Result<Read, Failure> {
    let options = light.reading.options();
    let keep = made_by().zip(file(path, light.cache.as_deref(), &options));
    if let Some((made_by, file)) = &keep {
        match kept::load(made_by, file, path, options.file_bytes_max) {
            Ok(Kept { scene, accel, warnings }) => {
                said(&warnings);
                let opened = fs::File::options().append(true).open(file);
                let used = opened.and_then(|file| file.set_modified(SystemTime::now()));
                if let Err(e) = used {
                    tracing::debug!("{}: {e}", file.display());
                }
                return Ok(Read {
                    scene: Arc::new(scene),
                    accel: Some(Arc::new(accel)),
                    warnings,
                    keep: None,
                });
            }
            // It is read from its files, and kept anew.
            Err(e) => tracing::debug!("{}: {e}", file.display()),
        }
    }
    let loaded = load::load_with(path, &options).map_err(|e| Failure::Input(e.to_string()))?;
    let warnings: Vec<String> = loaded.warnings.iter().map(ToString::to_string).collect();
    said(&warnings);
    let scene = Arc::new(loaded.scene);
    let texels: usize = scene.textures.iter().map(|t| t.mips.bytes()).sum();
    let is_worth_it = scene.mesh.triangles.len() >= WORTH.0 || texels >= WORTH.1;
    let keep = keep.filter(|_| is_worth_it).zip(loaded.sources);
    let keep = keep.map(|((made_by, file), sources)| {
        let warnings = warnings.clone();
        Keep { file, made_by, sources, warnings }
    });
    Ok(Read { scene, accel: None, warnings, keep })
}

fn said(warnings: &[String]) {
    for warning in warnings {
        tracing::warn!("{warning}");
    }
}

/// Where a scene is kept: its name holds which file was asked for, and how. What was in it then is in the file.
fn file(path: &Path, cache: Option<&Path>, options: &LoadOptions) -> Option<PathBuf> {
    let real = fs::canonicalize(path).ok()?;
    let mut hasher = blake3::Hasher::new();
    for text in [real.to_string_lossy(), path.to_string_lossy(), format!("{options:?}").into()] {
        hasher.update(&(text.len() as u64).to_le_bytes());
        hasher.update(text.as_bytes());
    }
    let name = format!("{}.{EXTENSION}", &hasher.finalize().to_hex()[..32]);
    cache_folder(cache).map(|folder| folder.join("scenes").join(name))
}

/// Which program this is: another build may read the same files otherwise.
fn made_by() -> Option<[u8; 32]> {
    static PROGRAM: OnceLock<Option<[u8; 32]>> = OnceLock::new();
    *PROGRAM.get_or_init(|| {
        let meta = fs::metadata(std::env::current_exe().ok()?).ok()?;
        let modified = meta.modified().ok()?.duration_since(SystemTime::UNIX_EPOCH).ok()?;
        let mut hasher = blake3::Hasher::new();
        hasher.update(env!("CARGO_PKG_VERSION").as_bytes());
        hasher.update(&meta.len().to_le_bytes());
        hasher.update(&modified.as_nanos().to_le_bytes());
        Some(*hasher.finalize().as_bytes())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A field of triangles that is worth keeping.
    fn field(folder: &Path, lift: f32) -> PathBuf {
        let mut obj = String::new();
        for i in 0..WORTH.0 {
            let (x, z) = ((i % 150) as f32, (i / 150) as f32);
            let y = lift + (i % 7) as f32 * 0.1;
            let first = 3 * i + 1;
            obj.push_str(&format!("v {x} {y} {z}\nv {} {y} {z}\nv {x} {y} {}\n", x + 1.0, z + 1.0));
            obj.push_str(&format!("f {first} {} {}\n", first + 1, first + 2));
        }
        let path = folder.join("field.obj");
        fs::write(&path, obj).expect("written");
        path
    }

    fn light(cache: &Path) -> Light {
        Light { quick: true, cache: Some(cache.to_path_buf()), ..Light::default() }
    }

    fn kept_files(cache: &Path) -> Vec<PathBuf> {
        let entries = fs::read_dir(cache.join("scenes")).into_iter().flatten();
        entries.filter_map(Result::ok).map(|e| e.path()).filter(|p| p.extension().is_some()).collect()
    }

    #[test]
    fn a_second_start_reads_what_the_first_one_made() {
        let folder = tempfile::tempdir().expect("a folder");
        let (path, light) = (field(folder.path(), 0.0), light(folder.path()));
        let mut first = read(&path, &light).expect("a scene");
        let accel = Arc::new(Accel::build(&first.scene));
        let keep = first.keep.take().expect("worth it");
        keep.write(&first.scene, &accel).expect("kept");
        let second = read(&path, &light).expect("a scene");
        assert!(second.keep.is_none());
        assert_eq!(second.scene.content_hash, first.scene.content_hash);
        assert_eq!(second.scene.mesh.positions, first.scene.mesh.positions);
        assert_eq!(second.accel.expect("kept").size_bytes(), accel.size_bytes());
        assert_eq!(second.warnings, first.warnings);

        // Damaged: made anew.
        let [file] = &kept_files(folder.path())[..] else { panic!("one file") };
        let mut bytes = fs::read(file).expect("read");
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        fs::write(file, bytes).expect("written");
        let third = read(&path, &light).expect("a scene");
        assert!(third.accel.is_none() && third.keep.is_some());

        // Another file of the same name: made anew.
        keep.write(&first.scene, &accel).expect("kept");
        field(folder.path(), 1.0);
        let fourth = read(&path, &light).expect("a scene");
        assert!(fourth.accel.is_none() && fourth.keep.is_some());
        assert_ne!(fourth.scene.content_hash, first.scene.content_hash);
    }

    #[test]
    fn a_scene_without_light_is_kept_beside_and_is_the_same() {
        let folder = tempfile::tempdir().expect("a folder");
        let (path, light) = (field(folder.path(), 0.0), light(folder.path()));
        let first = crate::opened::unlit(&path, &light).expect("a scene");
        let began = std::time::Instant::now();
        while kept_files(folder.path()).is_empty() {
            assert!(began.elapsed().as_secs() < 60, "kept on a thread beside");
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        let is_kept = || read(&path, &light).expect("a scene").accel.is_some();
        while !is_kept() {
            assert!(began.elapsed().as_secs() < 60, "whole");
        }
        let second = crate::opened::unlit(&path, &light).expect("a scene");
        assert_eq!(second.scene.content_hash, first.scene.content_hash);
        assert_eq!(second.scene.mesh.positions, first.scene.mesh.positions);
        assert_eq!(second.accel.size_bytes(), first.accel.size_bytes());
    }

    #[test]
    fn what_was_used_least_lately_goes_first() {
        let folder = tempfile::tempdir().expect("a folder");
        for (name, age) in [("a", 3), ("b", 2), ("c", 1)] {
            let file = fs::File::create(folder.path().join(name).with_extension(EXTENSION)).expect("a file");
            // Sparse: takes no room.
            file.set_len(1 << 30).expect("long");
            file.set_modified(SystemTime::now() - std::time::Duration::from_secs(age)).expect("set");
        }
        fs::write(folder.path().join("other.txt"), "stays").expect("written");
        make_room(folder.path(), EXTENSION, BYTES_MAX, 2 << 30).expect("room");
        let left = |name: &str| folder.path().join(name).exists();
        assert!(!left("a.fvscene") && left("b.fvscene") && left("c.fvscene") && left("other.txt"));
    }
}
