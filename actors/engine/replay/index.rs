//! Snapshots of a recording on disk, so that a replay begins close to where one wants to be.
//!
//! They lie in the cache folder under the recording's hash. The first replays leave them while they run; another build
//! of the program makes them anew.

use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use foveal_runtime::{ActorId, Snapshot};

use crate::opened::cache_folder;
use crate::recording::program;

/// First bytes of the file; the program's identity follows.
const MAGIC: &[u8; 8] = b"FVSNAPS1";
/// A replay that runs for so long since the last snapshot leaves one…
const INTERVAL: Duration = Duration::from_millis(250);
/// …but spends at most this share of its time on them.
const SHARE: u32 = 5;
/// Bytes after which no more are kept of one recording.
const BYTES_MAX: u64 = 2 << 30;

/// Where a snapshot lies in the file, and what was delivered before it.
struct Entry {
    positions: Vec<u64>,
    offset: u64,
    length: u64,
}

/// The snapshots of one recording.
pub struct Index {
    /// `None` where there is no folder to keep them.
    file: Option<PathBuf>,
    entries: Vec<Entry>,
    end: u64,
    last: Instant,
    wait: Duration,
}

/// Which program writes the states: another one may lay them out otherwise.
fn identity() -> Vec<u8> {
    let file = std::env::current_exe().and_then(std::fs::metadata);
    let built = file.ok().map(|m| (m.len(), m.modified().ok().and_then(|t| t.elapsed_since_epoch())));
    format!("{} {built:?}", program()).into_bytes()
}

trait SinceEpoch {
    fn elapsed_since_epoch(self) -> Option<u128>;
}

impl SinceEpoch for std::time::SystemTime {
    fn elapsed_since_epoch(self) -> Option<u128> {
        self.duration_since(Self::UNIX_EPOCH).ok().map(|d| d.as_nanos())
    }
}

impl Index {
    /// The snapshots kept of a recording.
    pub fn open(trace: &Path, cache: Option<&Path>) -> Self {
        let name = std::fs::read(trace).ok().map(|bytes| blake3::hash(&bytes).to_hex()[..32].to_owned());
        let file = name.and_then(|name| Some(cache_folder(cache)?.join(format!("{name}.fvsnaps"))));
        let mut index = Self { file, entries: Vec::new(), end: 0, last: Instant::now(), wait: INTERVAL };
        let _ = index.read();
        index
    }

    fn read(&mut self) -> std::io::Result<()> {
        let Some(path) = &self.file else { return Ok(()) };
        let mut file = File::open(path)?;
        let head = head();
        let mut found = vec![0; head.len()];
        file.read_exact(&mut found)?;
        if found != head {
            return Ok(());
        }
        self.end = head.len() as u64;
        let size = file.metadata()?.len();
        loop {
            let mut lengths = [0; 16];
            if file.read_exact(&mut lengths).is_err() {
                return Ok(());
            }
            let [count, length] = [0, 8].map(|at| {
                lengths[at..at + 8].iter().rev().fold(0_u64, |number, byte| number << 8 | u64::from(*byte))
            });
            let offset = self.end + 16 + count.saturating_mul(8);
            if count > 1 << 20 || offset.saturating_add(length) > size {
                return Ok(());
            }
            let mut positions = vec![0; count as usize * 8];
            file.read_exact(&mut positions)?;
            let positions =
                positions.as_chunks::<8>().0.iter().map(|number| u64::from_le_bytes(*number)).collect();
            self.entries.push(Entry { positions, offset, length });
            self.end = file.seek(SeekFrom::Start(offset + length))?;
        }
    }

    /// The latest snapshot that has delivery `index` of `actor` still before it.
    pub fn before(&self, actor: ActorId, index: u64) -> Option<Snapshot> {
        let made = |entry: &Entry| entry.positions.get(actor.0 as usize).copied().unwrap_or(u64::MAX);
        let entry =
            self.entries.iter().filter(|entry| made(entry) <= index).max_by_key(|entry| made(entry))?;
        let mut file = File::open(self.file.as_ref()?).ok()?;
        file.seek(SeekFrom::Start(entry.offset)).ok()?;
        let mut bytes = Vec::new();
        file.take(entry.length).read_to_end(&mut bytes).ok()?;
        Snapshot::from_bytes(&bytes)
    }

    /// Whether it is time for another snapshot.
    pub fn is_due(&self) -> bool {
        self.file.is_some() && self.end < BYTES_MAX && self.last.elapsed() >= self.wait
    }

    /// Keeps what `take` gives, unless there is one close by.
    pub fn keep(&mut self, take: impl FnOnce() -> Option<Snapshot>) {
        let start = Instant::now();
        if let Some(snapshot) = take() {
            let known = self.entries.iter().any(|entry| entry.positions == snapshot.positions());
            if !known && self.append(&snapshot).is_err() {
                self.file = None;
            }
            self.wait = INTERVAL.max(start.elapsed() * SHARE);
        }
        self.last = Instant::now();
    }

    fn append(&mut self, snapshot: &Snapshot) -> std::io::Result<()> {
        let Some(path) = &self.file else { return Ok(()) };
        if self.end == 0 {
            if let Some(folder) = path.parent() {
                std::fs::create_dir_all(folder)?;
            }
            let head = head();
            std::fs::write(path, &head)?;
            self.end = head.len() as u64;
        }
        let content = snapshot.to_bytes();
        let mut bytes = Vec::with_capacity(content.len() + 64);
        bytes.extend_from_slice(&(snapshot.positions().len() as u64).to_le_bytes());
        bytes.extend_from_slice(&(content.len() as u64).to_le_bytes());
        snapshot.positions().iter().for_each(|number| bytes.extend_from_slice(&number.to_le_bytes()));
        let offset = self.end + bytes.len() as u64;
        bytes.extend_from_slice(&content);
        let mut file = OpenOptions::new().write(true).open(path)?;
        // Behind the last whole one: what another run left half written is written over.
        file.seek(SeekFrom::Start(self.end))?;
        file.write_all(&bytes)?;
        let (positions, length) = (snapshot.positions().to_vec(), content.len() as u64);
        self.entries.push(Entry { positions, offset, length });
        self.end += bytes.len() as u64;
        Ok(())
    }
}

fn head() -> Vec<u8> {
    let mut head = MAGIC.to_vec();
    head.extend_from_slice(blake3::hash(&identity()).as_bytes());
    head
}
