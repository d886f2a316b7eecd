//! A scene with its light, as another machine gets it: files by name in a list (the manifest), contents by hash.
//!
//! The list is a blob like all others, so one hash says everything. Who gets it keeps blobs under their hashes, and lays the
//! files out in a folder of their own, from which the loader reads nothing else: it stays in a scene's folder.

use std::fs::{self, File};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Component, Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use foveal::illumination::bake::cache_key;
use foveal::world::World;
use foveal_actors::station::wire::{Hash, PIECE_BYTES_MAX};
use foveal_engine::Light;
use foveal_engine::failure::Failure;
use foveal_engine::light::Reading;
use foveal_engine::opened::{self, Opened};
use foveal_engine::recording::illumination_hash;
use foveal_files::bakes::encode;
use serde::{Deserialize, Serialize};

/// Most bytes of a manifest.
pub const MANIFEST_BYTES_MAX: u64 = 4 << 20;
/// Most files of a scene.
pub const FILES_MAX: usize = 65_536;
/// Most bytes of one file.
pub const BLOB_BYTES_MAX: u64 = 2 << 30;

/// One file of a scene.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Entry {
    /// Relative to the scene's folder, with `/`.
    pub name: String,
    /// BLAKE3 of its content.
    pub hash: Hash,
    /// Bytes of it.
    pub bytes: u64,
}

/// All that makes a scene and its light.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Manifest {
    /// The file that names the others.
    pub scene: String,
    /// All of them, that one too.
    pub files: Vec<Entry>,
    /// How they are read and what is changed of them, JSON.
    pub light: String,
    /// The illumination, a blob, and its BLAKE3 as recordings have it; none where work has light of its own.
    pub illumination: Option<(Entry, String)>,
    /// BLAKE3 of the scene as it is read, edits and all.
    pub content_hash: Hash,
}

impl Manifest {
    /// From bytes; none where it is not sound, or names what is outside of its folder.
    pub fn of_bytes(bytes: &[u8]) -> Option<Self> {
        if bytes.len() as u64 > MANIFEST_BYTES_MAX {
            return None;
        }
        let manifest: Self = postcard::from_bytes(bytes).ok()?;
        let Self { scene, files, illumination, .. } = &manifest;
        let is_sound = |entry: &Entry| is_inside(&entry.name) && entry.bytes <= BLOB_BYTES_MAX;
        let sound = files.len() <= FILES_MAX
            && files.iter().all(is_sound)
            && illumination.iter().all(|(entry, _)| entry.bytes <= BLOB_BYTES_MAX)
            && files.iter().any(|entry| entry.name == *scene);
        sound.then_some(manifest)
    }

    /// Every blob that it names, with its size.
    pub fn blobs(&self) -> impl Iterator<Item = (Hash, u64)> {
        let illumination = self.illumination.iter().map(|(entry, _)| entry);
        self.files.iter().chain(illumination).map(|entry| (entry.hash, entry.bytes))
    }
}

/// Whether a name is of a file below a folder, on every system.
fn is_inside(name: &str) -> bool {
    let plain = |part: &str| {
        !part.is_empty() && part.len() <= 255 && part != "." && part != ".." && !part.ends_with(['.', ' '])
    };
    let is_known = |c: char| !c.is_control() && !['\\', ':', '*', '?', '"', '<', '>', '|'].contains(&c);
    name.len() <= 1024
        && name.chars().all(is_known)
        && name.split('/').all(plain)
        && Path::new(name).components().all(|part| matches!(part, Component::Normal(_)))
}

/// Where the content of a blob is.
enum Content {
    Bytes(Vec<u8>),
    File(PathBuf),
}

/// A package that is given out.
pub struct Package {
    blobs: Vec<(Hash, u64, Content)>,
    manifest: Hash,
}

impl Package {
    /// Of a scene that is open.
    ///
    /// # Errors
    /// If its files cannot be read any more, or its light cannot be sent.
    pub fn of(opened: &Opened) -> Result<Self, Failure> {
        let cannot = |what: String| Failure::Input(format!("{}: {what}", opened.path.display()));
        if opened.refinement.is_some() || opened.textures.is_some() {
            return Err(cannot(
                "other machines can trace only under light that is baked, with all textures".into(),
            ));
        }
        let (light, scene) = (&opened.light, &opened.world.scene);
        let stored =
            opened.world.illumination.stored().ok_or_else(|| cannot("it has no light to send".into()))?;
        let bytes = encode(&cache_key(scene, &light.settings.settings(scene)), stored)
            .map_err(|e| cannot(format!("its light cannot be sent: {e}")))?;
        let hash = *blake3::hash(&bytes).as_bytes();
        let entry = Entry { name: "illumination".into(), hash, bytes: bytes.len() as u64 };
        let illumination = Some((entry, illumination_hash(&*opened.world.illumination)?));
        let mut package = Self::new(&opened.path, light, scene.content_hash, illumination)?;
        package.blobs.push((hash, bytes.len() as u64, Content::Bytes(bytes)));
        Ok(package)
    }

    /// Of a scene without light, for work that has light of its own.
    ///
    /// # Errors
    /// If its files cannot be read any more.
    pub fn without_light(path: &Path, reading: &Reading, content_hash: Hash) -> Result<Self, Failure> {
        let light = Light { reading: reading.clone(), ..Light::default() };
        Self::new(path, &light, content_hash, None)
    }

    fn new(
        path: &Path,
        light: &Light,
        content_hash: Hash,
        illumination: Option<(Entry, String)>,
    ) -> Result<Self, Failure> {
        let cannot = |what: String| Failure::Input(format!("{}: {what}", path.display()));
        let folder = path.parent().unwrap_or(Path::new(""));
        let (mut files, mut blobs): (Vec<Entry>, Vec<(Hash, u64, Content)>) = (Vec::new(), Vec::new());
        for (name, hash) in opened::files(path, &light.reading)? {
            if files.iter().any(|entry| entry.name == name) {
                continue;
            }
            let path = folder.join(&name);
            let bytes = fs::metadata(&path).map_err(|e| cannot(format!("{name}: {e}")))?.len();
            if !is_inside(&name) {
                return Err(cannot(format!("{name}: a name that other systems cannot have")));
            }
            blobs.push((hash, bytes, Content::File(path)));
            files.push(Entry { name, hash, bytes });
        }
        let light = Light {
            bake: None,
            cache: None,
            first: None,
            quick: false,
            baked: true,
            begun: 0,
            ..light.clone()
        };
        let manifest = Manifest {
            scene: path.file_name().unwrap_or_default().to_string_lossy().into_owned(),
            files,
            light: serde_json::to_string(&light).map_err(|e| cannot(e.to_string()))?,
            illumination,
            content_hash,
        };
        let bytes = postcard::to_stdvec(&manifest).map_err(|e| cannot(e.to_string()))?;
        if Manifest::of_bytes(&bytes).is_none() {
            return Err(cannot("it has more files than can be sent".into()));
        }
        let hash = *blake3::hash(&bytes).as_bytes();
        blobs.push((hash, bytes.len() as u64, Content::Bytes(bytes)));
        Ok(Self { blobs, manifest: hash })
    }

    /// The manifest's hash and size.
    pub fn manifest(&self) -> (Hash, u64) {
        let bytes = self.blobs.iter().find(|(hash, ..)| *hash == self.manifest).map_or(0, |blob| blob.1);
        (self.manifest, bytes)
    }

    /// Bytes of all that is in it.
    pub fn bytes(&self) -> u64 {
        self.blobs.iter().map(|(_, bytes, _)| bytes).sum()
    }

    /// A piece of a blob of it, from `at` on.
    pub fn piece(&self, hash: &Hash, at: u64) -> Option<Vec<u8>> {
        let (_, bytes, content) = self.blobs.iter().find(|(known, ..)| known == hash)?;
        let count = bytes.checked_sub(at)?.min(PIECE_BYTES_MAX as u64) as usize;
        match content {
            Content::Bytes(all) => Some(all[at as usize..at as usize + count].to_vec()),
            Content::File(path) => {
                let mut file = File::open(path).ok()?;
                file.seek(SeekFrom::Start(at)).ok()?;
                let mut piece = vec![0; count];
                file.read_exact(&mut piece).ok()?;
                Some(piece)
            }
        }
    }
}

/// A name that nobody else writes to.
fn beside(path: &Path) -> PathBuf {
    static MADE: AtomicU64 = AtomicU64::new(0);
    let number = MADE.fetch_add(1, Ordering::Relaxed);
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!("{name}.{}-{number}-new", std::process::id()))
}

/// Where a guest keeps blobs.
pub struct Stock {
    folder: PathBuf,
}

/// A blob on its way.
pub struct Arriving {
    hash: Hash,
    bytes: u64,
    got: u64,
    hasher: blake3::Hasher,
    file: File,
    path: PathBuf,
    kept: PathBuf,
}

impl Stock {
    /// In this folder, which is made.
    ///
    /// # Errors
    /// If it cannot be made.
    pub fn new(folder: PathBuf) -> Result<Self, Failure> {
        let made =
            fs::create_dir_all(folder.join("blobs")).and_then(|()| fs::create_dir_all(folder.join("scenes")));
        made.map_err(|e| Failure::Environment(format!("{}: {e}", folder.display())))?;
        Ok(Self { folder })
    }

    /// Where it is.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    fn path_of(&self, hash: &Hash) -> PathBuf {
        self.folder.join("blobs").join(blake3::Hash::from(*hash).to_hex().as_str())
    }

    /// Whether a blob of so many bytes is there. Its content was checked when it came.
    pub fn has(&self, hash: &Hash, bytes: u64) -> bool {
        fs::metadata(self.path_of(hash)).is_ok_and(|facts| facts.is_file() && facts.len() == bytes)
    }

    /// The content of a blob, at most `most` bytes.
    pub fn read(&self, hash: &Hash, most: u64) -> Option<Vec<u8>> {
        let mut bytes = Vec::new();
        File::open(self.path_of(hash)).ok()?.take(most + 1).read_to_end(&mut bytes).ok()?;
        (bytes.len() as u64 <= most && blake3::hash(&bytes) == blake3::Hash::from(*hash)).then_some(bytes)
    }

    /// A blob begins to come.
    ///
    /// # Errors
    /// If there is no room for it.
    pub fn begin(&self, hash: Hash, bytes: u64) -> Result<Arriving, String> {
        let kept = self.path_of(&hash);
        let path = beside(&kept);
        let file = File::create(&path).map_err(|e| format!("{}: {e}", path.display()))?;
        Ok(Arriving { hash, bytes, got: 0, hasher: blake3::Hasher::new(), file, path, kept })
    }

    /// Lays the files of a scene out, and tells where its main file is, and its illumination if it comes with one.
    ///
    /// # Errors
    /// If a file cannot be written, or is not there.
    pub fn lay_out(&self, manifest: &Manifest, hash: &Hash) -> Result<(PathBuf, Option<PathBuf>), String> {
        let folder = self.folder.join("scenes").join(blake3::Hash::from(*hash).to_hex().as_str());
        for Entry { name, hash, bytes } in &manifest.files {
            let path = folder.join(name);
            if fs::metadata(&path).is_ok_and(|facts| facts.len() == *bytes) {
                continue;
            }
            let place = path.parent().unwrap_or(&folder);
            fs::create_dir_all(place).map_err(|e| format!("{}: {e}", place.display()))?;
            let blob = self.path_of(hash);
            // A second name costs nothing; on systems without, a copy does.
            if fs::hard_link(&blob, &path).is_ok() {
                continue;
            }
            // Another guest of this machine may have been quicker. Never into what is there: that may be the blob itself.
            if fs::metadata(&path).is_ok_and(|facts| facts.len() == *bytes) {
                continue;
            }
            let new = beside(&path);
            let copied = fs::copy(&blob, &new).and_then(|_| fs::rename(&new, &path));
            copied.map_err(|e| format!("{}: {e}", path.display()))?;
        }
        let light = manifest.illumination.as_ref().map(|(entry, _)| self.path_of(&entry.hash));
        Ok((folder.join(&manifest.scene), light))
    }
}

impl Arriving {
    /// Which blob, and from where on more of it is wanted; none once it is whole.
    pub fn wants(&self) -> Option<(Hash, u64)> {
        (self.got < self.bytes).then_some((self.hash, self.got))
    }

    /// Takes a piece.
    ///
    /// # Errors
    /// If it is not the one that was wanted, or cannot be written.
    pub fn take(&mut self, hash: &Hash, at: u64, piece: &[u8]) -> Result<(), String> {
        let fits = self.got.checked_add(piece.len() as u64).is_some_and(|end| end <= self.bytes);
        if *hash != self.hash || at != self.got || piece.is_empty() || !fits {
            return Err("a piece came that was not asked for".into());
        }
        self.hasher.update(piece);
        self.got += piece.len() as u64;
        self.file.write_all(piece).map_err(|e| format!("{}: {e}", self.path.display()))
    }

    /// It is whole: keeps it under its hash.
    ///
    /// # Errors
    /// If it is not what its hash says, or cannot be kept.
    pub fn keep(self) -> Result<(), String> {
        let Self { hash, hasher, file, path, kept, .. } = self;
        let same = hasher.finalize() == blake3::Hash::from(hash);
        let done = if same { file.sync_all().and_then(|()| fs::rename(&path, &kept)) } else { Ok(()) };
        if !same || done.is_err() {
            let _ = fs::remove_file(&path);
        }
        done.map_err(|e| format!("{}: {e}", kept.display()))?;
        if same { Ok(()) } else { Err("a blob is not what its hash says".into()) }
    }
}

/// Opens what was laid out, and compares it with what the walk has. In the folder `cache` it is kept as it was read, for the
/// next time.
///
/// # Errors
/// If it cannot be opened, or is something else.
pub fn open(
    manifest: &Manifest,
    scene: &Path,
    illumination: Option<&Path>,
    cache: &Path,
) -> Result<World, Failure> {
    let wrong = |what: &str| Failure::Input(format!("the scene that came is not that of the walk: {what}"));
    let light: Light = serde_json::from_str(&manifest.light).map_err(|e| wrong(&e.to_string()))?;
    // Nothing of this machine is named from there.
    let light = Light {
        bake: illumination.map(Path::to_owned),
        quick: false,
        baked: true,
        refined: false,
        cache: Some(cache.to_owned()),
        first: None,
        ..light
    };
    let world = match illumination {
        Some(_) => opened::open(scene, &light, &())?.world,
        None => opened::unlit(scene, &light)?,
    };
    if world.scene.content_hash != manifest.content_hash {
        return Err(wrong("its files differ"));
    }
    if let Some((_, hash)) = &manifest.illumination
        && illumination_hash(&*world.illumination)? != *hash
    {
        return Err(wrong("its light differs"));
    }
    Ok(world)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stay_in_their_folder() {
        for name in ["a", "a/b.png", "Maps/Wood 1.PNG", "é.obj"] {
            assert!(is_inside(name), "{name}");
        }
        for name in
            ["", "/", "/a", "a//b", "..", "a/../b", "./a", "a/", "C:/a", "a\\b", "a\0", "a.", "a/b ", "con:"]
        {
            assert!(!is_inside(name), "{name:?}");
        }
    }

    #[test]
    fn a_blob_is_kept_only_if_it_is_what_was_asked_for() {
        let folder = tempfile::tempdir().unwrap();
        let stock = Stock::new(folder.path().join("stock")).unwrap();
        let content = b"forty-two bytes of something that is whole".to_vec();
        let (hash, bytes) = (*blake3::hash(&content).as_bytes(), content.len() as u64);
        let mut arriving = stock.begin(hash, bytes).unwrap();
        assert!(arriving.take(&hash, 1, &content).is_err() && arriving.take(&[0; 32], 0, &content).is_err());
        assert!(arriving.take(&hash, 0, &[]).is_err());
        arriving.take(&hash, 0, &content[..20]).unwrap();
        assert_eq!(arriving.wants(), Some((hash, 20)));
        assert!(arriving.take(&hash, 20, &content).is_err(), "more than there is");
        arriving.take(&hash, 20, &content[20..]).unwrap();
        assert_eq!(arriving.wants(), None);
        arriving.keep().unwrap();
        assert!(stock.has(&hash, bytes) && !stock.has(&hash, bytes + 1));
        assert_eq!(stock.read(&hash, bytes), Some(content.clone()));
        assert_eq!(stock.read(&hash, bytes - 1), None);
        let other = *blake3::hash(b"else").as_bytes();
        let mut arriving = stock.begin(other, bytes).unwrap();
        arriving.take(&other, 0, &content).unwrap();
        assert!(arriving.keep().is_err() && !stock.has(&other, bytes));
        assert_eq!(fs::read_dir(folder.path().join("stock/blobs")).unwrap().count(), 1, "nothing is left");
    }

    #[test]
    fn a_manifest_that_leads_elsewhere_is_none() {
        let entry = |name: &str| Entry { name: name.into(), hash: [1; 32], bytes: 5 };
        let of = |scene: &str, names: &[&str]| {
            let manifest = Manifest {
                scene: scene.into(),
                files: names.iter().map(|name| entry(name)).collect(),
                light: String::new(),
                illumination: Some((entry("illumination"), String::new())),
                content_hash: [0; 32],
            };
            Manifest::of_bytes(&postcard::to_stdvec(&manifest).unwrap()).is_some()
        };
        assert!(of("a.obj", &["a.obj", "m/b.png"]));
        assert!(!of("a.obj", &["b.obj"]) && !of("../a.obj", &["../a.obj"]));
        assert!(!of("a.obj", &["a.obj", "/etc/passwd"]));
    }
}
