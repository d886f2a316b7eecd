//! Snapshots of a recording on disk, so that a replay begins close to where one wants to be.
//!
//! They lie in the cache folder under the recording's hash. Replays leave them while they run; another build of the
//! program makes them anew. With each stand the counters that never fall. Beside them lie the maps of light that a replay had to make again. All recordings together
//! have a bound; what was used least lately goes.

use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use atomic_write_file::AtomicWriteFile;
use foveal_runtime::{ActorId, Snapshot};

use super::counters::{COUNTERS, Counts};
use super::history::TOLD;
use super::plain::{PLAIN, kept_as};
use crate::recording::{FIRST, program};

/// First bytes of the file; the program's identity follows.
const MAGIC: &[u8; 8] = b"FVSNAPS2";
/// A replay that runs for so long since the last snapshot leaves one…
const INTERVAL: Duration = Duration::from_millis(250);
/// …but spends at most this share of its time on them.
const SHARE: u32 = 5;
/// A replay that ran for so long to where it was asked to leaves one there: who looks once looks again.
const WORTH: Duration = Duration::from_millis(2);
/// Bytes of snapshots of one recording: beyond, about half of them go, those that have others close by.
const BYTES_MAX: u64 = 3 << 30;
/// Bytes of snapshots and maps of all recordings.
const ALL_BYTES_MAX: u64 = 6 << 30;
/// What files of snapshots, maps, first estimates, logs and histories are called.
const EXTENSIONS: [&str; 5] = ["fvsnaps", "fvlight", FIRST, PLAIN, TOLD];

/// Where a snapshot lies in the file, and what was delivered and counted before it.
struct Entry {
    positions: Vec<u64>,
    counts: Counts,
    offset: u64,
    length: u64,
}

/// Which snapshots of a recording are kept.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Kept {
    /// Where.
    pub file: PathBuf,
    /// How many.
    pub count: usize,
    /// Bytes of the file.
    pub bytes: u64,
}

/// The snapshots of one recording.
pub struct Index {
    /// `None` where there is no folder to keep them.
    pub(super) file: Option<PathBuf>,
    light: Option<PathBuf>,
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
    /// Where the maps lie that a replay makes again: what another program makes may have other bits.
    pub fn light(&self) -> Option<&Path> {
        self.light.as_deref()
    }

    /// The snapshots kept of a recording.
    pub fn open(trace: &Path, cache: Option<&Path>) -> Self {
        let folder = kept_as(trace, cache);
        let [file, light, ..] =
            EXTENSIONS.map(|extension| folder.as_ref().map(|f| f.with_extension(extension)));
        let light = light.map(|light| {
            let program = blake3::hash(&identity()).to_hex();
            light.with_file_name(format!(
                "{}-{}",
                &program[..8],
                light.file_name().unwrap_or_default().display()
            ))
        });
        let mut index =
            Self { file, light, entries: Vec::new(), end: 0, last: Instant::now(), wait: INTERVAL };
        let _ = index.read();
        for file in [&index.file, &index.light].into_iter().flatten() {
            // Used: it goes later.
            let _ =
                File::options().append(true).open(file).and_then(|file| file.set_modified(SystemTime::now()));
        }
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
            if count > 1 << 20 {
                return Ok(());
            }
            let offset = self.end + entry_head(count as usize);
            if offset.saturating_add(length) > size {
                return Ok(());
            }
            let mut numbers = vec![0; (count as usize + COUNTERS.len()) * 8];
            file.read_exact(&mut numbers)?;
            let mut numbers = numbers.as_chunks::<8>().0.iter().map(|number| u64::from_le_bytes(*number));
            let positions = numbers.by_ref().take(count as usize).collect();
            let counts = Counts(std::array::from_fn(|_| numbers.next().unwrap_or_default()));
            self.entries.push(Entry { positions, counts, offset, length });
            self.end = file.seek(SeekFrom::Start(offset + length))?;
        }
    }

    /// The latest snapshot that has delivery `index` of `actor` still before it.
    pub fn before(&self, actor: ActorId, index: u64) -> Option<Snapshot> {
        self.read_at(|made| made.get(actor.0 as usize).copied().filter(|made| *made <= index))
    }

    /// A snapshot whose last delivery to `actor` was `index`: where a replay stopped that was to stop there.
    pub fn right_after(&self, actor: ActorId, index: u64) -> Option<Snapshot> {
        self.read_at(|made| made.get(actor.0 as usize).copied().filter(|made| *made == index + 1))
    }

    /// The snapshot that `rank` puts highest, of those that it ranks by what was delivered before them.
    fn read_at(&self, rank: impl Fn(&[u64]) -> Option<u64>) -> Option<Snapshot> {
        let ranked = self.entries.iter().filter_map(|entry| Some((rank(&entry.positions)?, entry)));
        let (_, entry) = ranked.max_by_key(|(rank, _)| *rank)?;
        let mut file = File::open(self.file.as_ref()?).ok()?;
        file.seek(SeekFrom::Start(entry.offset)).ok()?;
        let mut bytes = Vec::with_capacity(entry.length as usize);
        file.take(entry.length).read_to_end(&mut bytes).ok()?;
        // Another process may have written its own there meanwhile.
        Snapshot::from_bytes(&bytes).filter(|found| found.positions() == entry.positions)
    }

    /// What had been delivered at each, from the first on; none of which another has less and more.
    pub fn places(&self) -> Vec<Vec<u64>> {
        let mut places: Vec<Vec<u64>> = self.entries.iter().map(|entry| entry.positions.clone()).collect();
        places.sort_by_key(|place| place.iter().sum::<u64>());
        let mut ordered: Vec<Vec<u64>> = Vec::new();
        for place in places {
            let follows =
                |last: &Vec<u64>| last.len() == place.len() && last.iter().zip(&place).all(|(a, b)| a <= b);
            if ordered.last().is_none_or(follows) && ordered.last() != Some(&place) {
                ordered.push(place);
            }
        }
        ordered
    }

    /// The snapshot of a place.
    pub fn at(&self, place: &[u64]) -> Option<Snapshot> {
        self.read_at(|made| (made == place).then_some(0))
    }

    /// What had been counted by a place, where a snapshot of it is kept.
    pub fn counts(&self, place: &[u64]) -> Option<Counts> {
        self.entries.iter().find(|entry| entry.positions == place).map(|entry| entry.counts)
    }

    /// Which there are.
    pub fn kept(&self) -> Option<Kept> {
        self.file.clone().map(|file| Kept { file, count: self.entries.len(), bytes: self.end })
    }

    /// Whether there is a place to keep snapshots.
    pub fn is_kept(&self) -> bool {
        self.file.is_some()
    }

    /// Whether it is time for another snapshot.
    pub fn is_due(&self) -> bool {
        self.file.is_some() && self.last.elapsed() >= self.wait
    }

    /// Whether where a replay stops is worth a snapshot.
    pub fn is_worth(&self) -> bool {
        self.file.is_some() && self.last.elapsed() >= WORTH
    }

    /// A replay begins.
    pub fn begin(&mut self) {
        self.last = Instant::now();
    }

    /// Keeps what `take` gives, unless there is one close by.
    pub fn keep(&mut self, take: impl FnOnce() -> Option<(Snapshot, Counts)>) {
        let start = Instant::now();
        if let Some((snapshot, counts)) = take() {
            let known = self.entries.iter().any(|entry| entry.positions == snapshot.positions());
            if !known && self.append(&snapshot, counts).is_err() {
                self.file = None;
            }
            self.wait = INTERVAL.max(start.elapsed() * SHARE);
        }
        self.last = Instant::now();
    }

    fn append(&mut self, snapshot: &Snapshot, counts: Counts) -> std::io::Result<()> {
        let Some(path) = self.file.clone() else { return Ok(()) };
        if self.end == 0 {
            if let Some(folder) = path.parent() {
                std::fs::create_dir_all(folder)?;
            }
            let head = head();
            std::fs::write(&path, &head)?;
            self.end = head.len() as u64;
        }
        let content = snapshot.to_bytes();
        let mut bytes = Vec::with_capacity(content.len() + 64);
        bytes.extend_from_slice(&(snapshot.positions().len() as u64).to_le_bytes());
        bytes.extend_from_slice(&(content.len() as u64).to_le_bytes());
        let numbers = snapshot.positions().iter().chain(&counts.0);
        numbers.for_each(|number| bytes.extend_from_slice(&number.to_le_bytes()));
        let offset = self.end + bytes.len() as u64;
        bytes.extend_from_slice(&content);
        let mut file = OpenOptions::new().write(true).open(&path)?;
        // Behind the last whole one: what another run left half written is written over.
        file.seek(SeekFrom::Start(self.end))?;
        file.write_all(&bytes)?;
        let (positions, length) = (snapshot.positions().to_vec(), content.len() as u64);
        self.entries.push(Entry { positions, counts, offset, length });
        self.end += bytes.len() as u64;
        if self.end > BYTES_MAX {
            self.thin(self.entries.len() / 2)?;
        }
        make_room(&path, ALL_BYTES_MAX)
    }

    /// Keeps about so many snapshots, evenly spread.
    pub(super) fn thin(&mut self, count: usize) -> std::io::Result<()> {
        let Some(path) = &self.file else { return Ok(()) };
        let progress = |entry: &Entry| entry.positions.iter().sum::<u64>();
        self.entries.sort_by_key(progress);
        let gap = self.entries.last().map_or(0, progress) / count.max(1) as u64;
        let mut next = 0;
        let mut from = File::open(path)?;
        let mut into = AtomicWriteFile::open(path)?;
        let head = head();
        into.write_all(&head)?;
        let (mut end, mut kept) = (head.len() as u64, Vec::new());
        for mut entry in self.entries.drain(..) {
            if progress(&entry) < next {
                continue;
            }
            next = progress(&entry) + gap;
            let start = entry.offset - entry_head(entry.positions.len());
            from.seek(SeekFrom::Start(start))?;
            let length = entry.offset + entry.length - start;
            let copied = std::io::copy(&mut (&mut from).take(length), &mut into)?;
            if copied != length {
                break;
            }
            entry.offset = end + (entry.offset - start);
            end += length;
            kept.push(entry);
        }
        into.commit()?;
        (self.entries, self.end) = (kept, end);
        Ok(())
    }
}

/// Bytes of an entry before its snapshot: two lengths, the positions and the counts.
fn entry_head(positions: usize) -> u64 {
    16 + (positions + COUNTERS.len()) as u64 * 8
}

/// Lets others go where a file that was just kept takes too much room.
pub(super) fn make_room_beside(kept: &Path) -> std::io::Result<()> {
    make_room(kept, ALL_BYTES_MAX)
}

/// Lets snapshots and maps of other recordings go, those that were used least lately first, until all fit into `most`
/// bytes together with those of `kept`.
pub(super) fn make_room(kept: &Path, most: u64) -> std::io::Result<()> {
    let Some(folder) = kept.parent() else { return Ok(()) };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder)?.flatten() {
        let path = entry.path();
        let is_ours = path.extension().is_some_and(|e| EXTENSIONS.iter().any(|ours| e == *ours));
        if let (true, Ok(facts)) = (is_ours, entry.metadata()) {
            files.push((facts.modified()?, facts.len(), path));
        }
    }
    let mut bytes: u64 = files.iter().map(|(_, bytes, _)| bytes).sum();
    files.sort();
    for (_, size, path) in files.into_iter().filter(|(_, _, path)| path != kept) {
        if bytes <= most {
            break;
        }
        if std::fs::remove_file(path).is_ok() {
            bytes -= size;
        }
    }
    Ok(())
}

fn head() -> Vec<u8> {
    head_of(MAGIC)
}

/// How a file begins that only the program reads which wrote it.
pub(super) fn head_of(magic: &[u8; 8]) -> Vec<u8> {
    let mut head = magic.to_vec();
    head.extend_from_slice(blake3::hash(&identity()).as_bytes());
    head
}
