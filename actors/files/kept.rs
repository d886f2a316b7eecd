//! A scene and its geometry index in one file, for the next start.
//!
//! The file says which files the scene was read from and what was in them: they are read again, which is faster than
//! anything made of them, and where one has changed the scene is made anew. It also says which program made it, since another
//! one may read the same files otherwise. Under its checksum every number is held against the others ([`scene::kept`],
//! [`geometry::kept`](foveal::geometry::kept)): what is cut short, altered or made up is an error, never a panic, a scene that is
//! none, or memory that nobody has.
//!
//! [`scene::kept`]: foveal::scene::kept

use std::fs;
use std::path::Path;

use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::Xxh3;

use crate::load::Sources;
use crate::write_pieces;
use foveal::geometry::Accel;
use foveal::geometry::kept::AccelHead;
use foveal::scene::Scene;
use foveal::scene::bulk::{Bulk, BulkReader, ReadAt};
use foveal::scene::kept::SceneHead;

/// First bytes of a file.
const MAGIC: [u8; 8] = *b"FVSCENE\n";
/// Raised with every change of what is stored.
const VERSION: u32 = 4;
/// Magic, version, who made it, length of the head, checksum of all of that and of the head.
const HEADER: usize = 8 + 4 + 32 + 8 + 16;
/// Bytes of a file at most.
const BYTES_MAX: u64 = 1 << 30;

/// Why a file was not used.
#[derive(Debug)]
pub enum KeptError {
    /// It could not be read or written.
    Io(std::io::Error),
    /// It is none, or one of another version or program.
    Foreign,
    /// It is cut short, altered, or says what cannot be.
    Damaged,
    /// The files that the scene was read from have changed.
    Changed,
    /// There is too much to be kept, or nobody knows all that it was read from.
    NotKept,
}

impl std::fmt::Display for KeptError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Io(error) => write!(f, "{error}"),
            Self::Foreign => f.write_str("not a scene kept by this program"),
            Self::Damaged => f.write_str("cut short or damaged"),
            Self::Changed => f.write_str("kept of other files"),
            Self::NotKept => f.write_str("not to be kept"),
        }
    }
}

impl std::error::Error for KeptError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Io(error) => Some(error),
            _ => None,
        }
    }
}

impl From<std::io::Error> for KeptError {
    fn from(error: std::io::Error) -> Self {
        Self::Io(error)
    }
}

/// A scene as it was read, ready for rays.
#[derive(Clone, Debug)]
pub struct Kept {
    /// The scene.
    pub scene: Scene,
    /// Its index.
    pub accel: Accel,
    /// What was doubtful about its files, as it was said.
    pub warnings: Vec<String>,
}

/// What of a file is short.
#[derive(Serialize, Deserialize)]
struct Head {
    sources: Sources,
    scene: SceneHead,
    accel: AccelHead,
    warnings: Vec<String>,
    /// Checksum of the lists behind it.
    lists: [u8; 16],
}

/// What a file holds: a head and lists, which lie where the scene has them.
#[derive(Debug)]
pub struct Encoded<'a> {
    head: Vec<u8>,
    lists: Bulk<'a>,
}

impl Encoded<'_> {
    /// Bytes of the file.
    pub fn bytes(&self) -> u64 {
        (self.head.len() + self.lists.len_bytes()) as u64
    }

    /// The bytes in turn.
    pub fn pieces(&self) -> impl Iterator<Item = &[u8]> {
        std::iter::once(&self.head[..]).chain(self.lists.pieces())
    }

    /// Writes them to `file`: first beside it, then in one step over what was there.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&self, file: &Path) -> Result<(), KeptError> {
        Ok(write_pieces(file, self.pieces())?)
    }
}

/// What a file will hold, which `made_by` tells the program that may read it again.
///
/// # Errors
/// [`KeptError::NotKept`] where it would be too large.
pub fn encode<'a>(
    made_by: &[u8; 32],
    sources: &Sources,
    scene: &'a Scene,
    accel: &'a Accel,
    warnings: &[String],
) -> Result<Encoded<'a>, KeptError> {
    let mut lists = Bulk::default();
    let head = Head {
        sources: sources.clone(),
        scene: scene.keep(&mut lists).ok_or(KeptError::NotKept)?,
        accel: accel.keep(&mut lists),
        warnings: warnings.to_vec(),
        lists: lists.sum(),
    };
    let head = postcard::to_stdvec(&head).map_err(|_| KeptError::NotKept)?;
    let mut bytes = Vec::with_capacity(HEADER + head.len());
    bytes.extend(MAGIC);
    bytes.extend(VERSION.to_le_bytes());
    bytes.extend(made_by);
    bytes.extend((head.len() as u64).to_le_bytes());
    bytes.extend(checksum(&bytes, &head));
    bytes.extend(head);
    let encoded = Encoded { head: bytes, lists };
    if encoded.bytes() > BYTES_MAX { Err(KeptError::NotKept) } else { Ok(encoded) }
}

fn checksum(header: &[u8], head: &[u8]) -> [u8; 16] {
    let mut hasher = Xxh3::new();
    hasher.update(header);
    hasher.update(head);
    hasher.digest128().to_le_bytes()
}

/// What [`encode`] made of the scene at `path`, if the files that it was read from, each of at most `limit` bytes, are as
/// they were.
///
/// # Errors
/// Says why not.
pub fn decode(made_by: &[u8; 32], bytes: &[u8], path: &Path, limit: u64) -> Result<Kept, KeptError> {
    read(made_by, (&bytes, bytes.len() as u64), path, limit, true)
}

/// The same from wherever these bytes, so many of them, are. Without `sums`, as if somebody had made them up with their
/// checksums.
fn read(
    made_by: &[u8; 32],
    (source, bytes): (&dyn ReadAt, u64),
    path: &Path,
    limit: u64,
    sums: bool,
) -> Result<Kept, KeptError> {
    let mut header = [0; HEADER];
    let there = |is_there: bool| is_there.then_some(()).ok_or(KeptError::Damaged);
    there(source.read_at(0, &mut header))?;
    if header[..8] != MAGIC || header[8..12] != VERSION.to_le_bytes() || header[12..44] != *made_by {
        return Err(KeptError::Foreign);
    }
    let mut length = [0; 8];
    length.copy_from_slice(&header[44..52]);
    let length = u64::from_le_bytes(length);
    let lists =
        (HEADER as u64).checked_add(length).filter(|lists| *lists <= bytes).ok_or(KeptError::Damaged)?;
    let mut head = vec![0; length as usize];
    there(source.read_at(HEADER as u64, &mut head))?;
    there(!sums || header[52..] == checksum(&header[..52], &head))?;
    let Head { sources, scene, accel, warnings, lists: sum } =
        postcard::from_bytes(&head).map_err(|_| KeptError::Damaged)?;
    // What the lists say is held against the rest while they are read, and is nothing where their checksum is another one.
    let made = || {
        let mut bulk = BulkReader::new(source, lists..bytes);
        let scene = Scene::from_kept(scene, &mut bulk)?;
        let accel = Accel::from_kept(&scene, &accel, &mut bulk)?;
        let own = bulk.sum()?;
        (!sums || own == sum).then_some(Kept { scene, accel, warnings })
    };
    let (made, holds) = rayon::join(made, || sources.hold(path, limit));
    if holds { made.ok_or(KeptError::Damaged) } else { Err(KeptError::Changed) }
}

/// [`decode`] of what lies in a file.
///
/// # Errors
/// As [`decode`], or if the file cannot be read.
pub fn load(made_by: &[u8; 32], file: &Path, path: &Path, limit: u64) -> Result<Kept, KeptError> {
    let opened = fs::File::open(file)?;
    let length = opened.metadata()?.len();
    if length > BYTES_MAX {
        return Err(KeptError::Damaged);
    }
    read(made_by, (&Opened(opened), length), path, limit, true)
}

/// A file, which stays as it is.
struct Opened(fs::File);

#[cfg(unix)]
impl ReadAt for Opened {
    fn read_at(&self, at: u64, into: &mut [u8]) -> bool {
        std::os::unix::fs::FileExt::read_exact_at(&self.0, into, at).is_ok()
    }
}

#[cfg(windows)]
impl ReadAt for Opened {
    fn read_at(&self, mut at: u64, mut into: &mut [u8]) -> bool {
        while !into.is_empty() {
            match std::os::windows::fs::FileExt::seek_read(&self.0, into, at) {
                Ok(0) | Err(_) => return false,
                Ok(read) => {
                    at += read as u64;
                    into = &mut std::mem::take(&mut into)[read..];
                }
            }
        }
        true
    }
}

#[cfg(test)]
#[path = "kept_tests.rs"]
mod tests;
