//! Reads files of one folder and nothing outside of it.

use std::cell::RefCell;
use std::fs::File;
use std::io::Read;
use std::path::{Component, Path, PathBuf};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::error::FileProblem;

/// The folder of a scene, and the bytes read from it.
pub(super) struct Folder {
    /// Without links.
    root: PathBuf,
    /// As the user wrote it; what messages show.
    shown: PathBuf,
    limit: u64,
    /// Names and BLAKE3 of what was read, in order.
    read: Vec<(String, [u8; 32])>,
    /// What was looked for, and where it was.
    asked: RefCell<Vec<Asked>>,
}

/// What was looked for in a folder.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Asked {
    /// A name, from a folder below, and where it was.
    Find { base: String, name: String, found: Option<String> },
    /// Whether a name is that of a file.
    IsFile { name: String, is: bool },
}

/// All that a scene was read from: what was looked for in its folder, and what the files held. A scene that is read when the
/// same questions have the same answers is the same.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sources {
    asked: Vec<Asked>,
    read: Vec<(String, [u8; 32])>,
}

impl Sources {
    /// Whether all is still there as it was for the scene at `path`; reads all files again, those beyond `limit` bytes not.
    pub fn hold(&self, path: &Path, limit: u64) -> bool {
        let Ok(folder) = Folder::of(path, limit) else { return false };
        self.asked.iter().all(|asked| match asked {
            Asked::Find { base, name, found } => {
                let now = folder.find(Path::new(base), name).ok().map(|now| folder.relative(&now));
                now == *found
            }
            Asked::IsFile { name, is } => folder.root.join(name).is_file() == *is,
        }) && self.read.par_iter().all(|(name, hash)| {
            read_file(&folder.root.join(name), limit).is_ok_and(|contents| contents.hash == *hash)
        })
    }
}

/// Bytes of a file together with their hash.
pub(super) struct Contents {
    pub bytes: Vec<u8>,
    pub hash: [u8; 32],
}

fn problem_of(error: &std::io::Error) -> FileProblem {
    match error.kind() {
        std::io::ErrorKind::NotFound | std::io::ErrorKind::NotADirectory => FileProblem::Missing,
        // A name with a NUL byte, or one that is too long.
        std::io::ErrorKind::InvalidInput | std::io::ErrorKind::InvalidFilename => FileProblem::Missing,
        kind => FileProblem::Unreadable(kind),
    }
}

/// Reads a regular file of at most `limit` bytes.
pub(super) fn read_file(path: &Path, limit: u64) -> Result<Contents, FileProblem> {
    // Asked before opening: opening a pipe would wait for a writer.
    let meta = std::fs::metadata(path).map_err(|e| problem_of(&e))?;
    if !meta.is_file() {
        return Err(FileProblem::NotAFile);
    }
    if meta.len() > limit {
        return Err(FileProblem::TooLarge { bytes: meta.len(), limit });
    }
    let mut bytes = Vec::with_capacity(meta.len() as usize + 1);
    let file = File::open(path).map_err(|e| problem_of(&e))?;
    // The file may have grown, or be one of those whose size is said to be 0.
    file.take(limit + 1).read_to_end(&mut bytes).map_err(|e| problem_of(&e))?;
    if bytes.len() as u64 > limit {
        return Err(FileProblem::TooLarge { bytes: bytes.len() as u64, limit });
    }
    let hash = *blake3::hash(&bytes).as_bytes();
    Ok(Contents { bytes, hash })
}

impl Folder {
    /// The folder that `file` lies in.
    pub fn of(file: &Path, limit: u64) -> Result<Self, FileProblem> {
        let shown = file.parent().unwrap_or(Path::new("")).to_path_buf();
        let place = if shown.as_os_str().is_empty() { Path::new(".") } else { &shown };
        let root = std::fs::canonicalize(place).map_err(|e| problem_of(&e))?;
        Ok(Self { root, shown, limit, read: Vec::new(), asked: RefCell::default() })
    }

    /// Whether there is a file of this name.
    pub fn is_file(&self, name: &str) -> bool {
        let is = self.root.join(name).is_file();
        self.asked.borrow_mut().push(Asked::IsFile { name: name.to_owned(), is });
        is
    }

    /// All that was looked for and read; `None` where something that was found was not read, so that nobody knows whether it
    /// will be as it was.
    pub fn sources(&self) -> Option<Sources> {
        let asked = self.asked.borrow().clone();
        let is_known = |asked: &Asked| match asked {
            Asked::Find { found: Some(found), .. } => self.read.iter().any(|(name, _)| name == found),
            _ => true,
        };
        asked.iter().all(is_known).then(|| Sources { asked, read: self.read.clone() })
    }

    /// How messages name a file of this folder.
    pub fn show(&self, relative: &str) -> PathBuf {
        self.shown.join(relative)
    }

    /// Where `name` lies, looked for in `base` (relative to the folder). Accepts `\` for `/` and
    /// letters of the other case where the exact name is not there.
    pub fn find(&self, base: &Path, name: &str) -> Result<PathBuf, FileProblem> {
        let found = self.look_for(base, name);
        let relative = found.as_ref().ok().map(|found| self.relative(found));
        let (base, name) = (base.to_string_lossy().into_owned(), name.to_owned());
        self.asked.borrow_mut().push(Asked::Find { base, name, found: relative });
        found
    }

    /// As [`Self::find`], without that it counts as asked.
    pub fn peek(&self, base: &Path, name: &str) -> Option<PathBuf> {
        self.look_for(base, name).ok()
    }

    /// Bytes of a file that is read at most.
    pub fn limit(&self) -> u64 {
        self.limit
    }

    fn look_for(&self, base: &Path, name: &str) -> Result<PathBuf, FileProblem> {
        let first = self.find_exact(base, name);
        if first != Err(FileProblem::Missing) {
            return first;
        }
        let slashes = name.replace('\\', "/");
        if slashes != name {
            let second = self.find_exact(base, &slashes);
            if second != Err(FileProblem::Missing) {
                return second;
            }
        }
        self.find_any_case(base, &slashes)
    }

    fn find_exact(&self, base: &Path, name: &str) -> Result<PathBuf, FileProblem> {
        let relative = inside(base, name)?;
        let real = std::fs::canonicalize(self.root.join(relative)).map_err(|e| problem_of(&e))?;
        if real.starts_with(&self.root) { Ok(real) } else { Err(FileProblem::Escapes) }
    }

    fn find_any_case(&self, base: &Path, name: &str) -> Result<PathBuf, FileProblem> {
        let mut place = self.root.clone();
        for part in inside(base, name)?.components() {
            let exact = place.join(part);
            if exact.exists() {
                place = exact;
                continue;
            }
            let wanted = part.as_os_str().to_string_lossy().to_lowercase();
            let entries = std::fs::read_dir(&place).map_err(|e| problem_of(&e))?;
            // The first by name, so that the order of the file system does not matter.
            let found = entries
                .filter_map(Result::ok)
                .map(|e| e.file_name())
                .filter(|n| n.to_string_lossy().to_lowercase() == wanted)
                .min();
            place.push(found.ok_or(FileProblem::Missing)?);
        }
        let real = std::fs::canonicalize(place).map_err(|e| problem_of(&e))?;
        if real.starts_with(&self.root) { Ok(real) } else { Err(FileProblem::Escapes) }
    }

    /// A file that [`Self::find`] found, relative to the folder.
    pub fn relative(&self, found: &Path) -> String {
        found.strip_prefix(&self.root).unwrap_or(found).to_string_lossy().into_owned()
    }

    /// Reads a file that [`Self::find`] found, and remembers its hash.
    pub fn read(&mut self, found: &Path) -> Result<Vec<u8>, FileProblem> {
        let contents = read_file(found, self.limit)?;
        self.note(self.relative(found), contents.hash);
        Ok(contents.bytes)
    }

    /// Remembers that a file was read elsewhere.
    pub fn note(&mut self, name: String, hash: [u8; 32]) {
        self.read.push((name, hash));
    }

    /// Names and BLAKE3 of what was read, in order.
    pub fn files(&self) -> &[(String, [u8; 32])] {
        &self.read
    }

    /// BLAKE3 of everything that was read, with the names, in the order of reading.
    pub fn content_hash(&self) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new();
        for (name, hash) in &self.read {
            hasher.update(&(name.len() as u64).to_le_bytes());
            hasher.update(name.as_bytes());
            hasher.update(hash);
        }
        *hasher.finalize().as_bytes()
    }
}

/// `base/name` without `.` and `..`, if it stays inside.
fn inside(base: &Path, name: &str) -> Result<PathBuf, FileProblem> {
    let bytes = name.as_bytes();
    let drive = bytes.len() > 1 && bytes[1] == b':' && bytes[0].is_ascii_alphabetic();
    if drive || bytes.first() == Some(&b'\\') {
        return Err(FileProblem::Escapes);
    }
    let mut out = PathBuf::new();
    for part in base.components().chain(Path::new(name).components()) {
        match part {
            Component::Normal(p) => out.push(p),
            Component::CurDir => {}
            Component::ParentDir => {
                if !out.pop() {
                    return Err(FileProblem::Escapes);
                }
            }
            Component::RootDir | Component::Prefix(_) => return Err(FileProblem::Escapes),
        }
    }
    if out.as_os_str().is_empty() { Err(FileProblem::Missing) } else { Ok(out) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_outside_is_reached() {
        for name in ["../x", "a/../../x", "/etc/passwd", "C:\\x", "\\\\host\\x", "a/../../../x"] {
            assert_eq!(inside(Path::new(""), name), Err(FileProblem::Escapes), "{name}");
        }
        assert_eq!(inside(Path::new("maps"), "../x.png"), Ok(PathBuf::from("x.png")));
        assert_eq!(inside(Path::new(""), "a/./b//c"), Ok(PathBuf::from("a/b/c")));
        assert_eq!(inside(Path::new(""), ""), Err(FileProblem::Missing));
    }

    #[test]
    fn links_out_of_the_folder_are_refused_and_case_is_forgiven() {
        let place = std::env::temp_dir().join(format!("foveal-folder-{}", std::process::id()));
        let scene = place.join("scene");
        std::fs::create_dir_all(scene.join("Maps")).unwrap();
        std::fs::write(place.join("secret"), "s").unwrap();
        std::fs::write(scene.join("Maps/Wood.PNG"), "w").unwrap();
        std::fs::write(scene.join("a.obj"), "").unwrap();
        let mut folder = Folder::of(&scene.join("a.obj"), 100).unwrap();
        let found = folder.find(Path::new(""), "maps\\wood.png").unwrap();
        assert_eq!(folder.relative(&found), "Maps/Wood.PNG");
        assert_eq!(folder.read(&found).unwrap(), b"w");
        assert_eq!(folder.find(Path::new(""), "maps\\steel.png"), Err(FileProblem::Missing));
        assert_eq!(folder.find(Path::new(""), "nul\0.png"), Err(FileProblem::Missing));
        assert_eq!(folder.find(Path::new(""), "..\\secret"), Err(FileProblem::Escapes));
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(place.join("secret"), scene.join("link.png")).unwrap();
            assert_eq!(folder.find(Path::new(""), "link.png"), Err(FileProblem::Escapes));
            assert_eq!(folder.find(Path::new(""), "LINK.png"), Err(FileProblem::Escapes));
        }
        let maps = folder.find(Path::new(""), "Maps").unwrap();
        assert_eq!(folder.read(&maps), Err(FileProblem::NotAFile));
        std::fs::write(scene.join("big"), [0u8; 101]).unwrap();
        let big = folder.find(Path::new(""), "big").unwrap();
        assert_eq!(folder.read(&big), Err(FileProblem::TooLarge { bytes: 101, limit: 100 }));
        std::fs::remove_dir_all(&place).unwrap();
    }
}
