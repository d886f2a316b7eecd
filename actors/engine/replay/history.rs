//! What all actors were told and knew all along a recording, so that nothing has to be replayed to say when it was so.
//!
//! Replays that leave snapshots all along a recording leave this, too, and so does a search that had to replay all of it.
//! It lies in the cache folder beside the snapshots: records of stretches of one actor's deliveries, each with a checksum.

use std::collections::BTreeMap;
use std::fs::OpenOptions;
use std::io::{Seek, SeekFrom, Write};
use std::path::PathBuf;

use foveal_runtime::{ActorId, Content};
use serde::{Deserialize, Serialize};

use super::course::Reader;
use super::index::{head_of, make_room_beside};
use super::pictures::changes;

/// What such a file is called.
pub(super) const TOLD: &str = "fvtold";
/// First bytes of the file; the program's identity follows.
const MAGIC: &[u8; 8] = b"FVTOLD_2";
/// Bytes of one recording's history at most.
const BYTES_MAX: u64 = 256 << 20;
/// Bytes of a record's checksum.
const CHECKSUM: usize = 8;

/// Bytes that are kept compressed.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Block {
    raw: u32,
    length: u32,
    #[serde(skip)]
    bytes: Vec<u8>,
}

impl Block {
    pub(super) fn of(raw: &[u8]) -> Self {
        let bytes = lz4_flex::block::compress(raw);
        Self { raw: raw.len() as u32, length: bytes.len() as u32, bytes }
    }

    /// `None` where they are damaged.
    fn raw(&self) -> Option<Vec<u8>> {
        // A block is at most 255 times shorter than what it holds.
        let (raw, stored) = (self.raw as usize, self.bytes.len());
        if raw / 255 > stored { None } else { lz4_flex::block::decompress(&self.bytes, raw).ok() }
    }
}

/// The messages of one kind.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Heard {
    /// All of them.
    Told(Block),
    /// In which deliveries they came.
    At(Block),
}

impl Heard {
    fn block(&mut self) -> &mut Block {
        match self {
            Self::Told(block) | Self::At(block) => block,
        }
    }
}

/// What one actor was told and knew before each of some deliveries; the last one's end is one after all deliveries.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Record {
    pub(super) actor: u32,
    pub(super) begin: u64,
    pub(super) end: u64,
    /// `None` where the state was left out.
    pub(super) state: Option<Block>,
    /// By kind.
    pub(super) heard: Vec<(String, Heard)>,
    /// Of the renderer: which tiles of its picture changed.
    pub(super) pictures: Option<Block>,
}

impl Record {
    fn blocks(&mut self) -> impl Iterator<Item = &mut Block> {
        let heard = self.heard.iter_mut().map(|(_, heard)| heard.block());
        self.state.iter_mut().chain(heard).chain(self.pictures.as_mut())
    }

    fn heard(&self, kind: &str) -> Option<&Heard> {
        self.heard.iter().find(|(name, _)| name == kind).map(|(_, heard)| heard)
    }
}

/// What is kept of one recording.
pub(super) struct History {
    /// `None` where there is no folder to keep it.
    file: Option<PathBuf>,
    records: Vec<Record>,
    is_read: bool,
    end: u64,
}

impl History {
    /// Beside the file of a recording's snapshots. Nothing is read yet.
    pub(super) fn beside(snapshots: Option<&PathBuf>) -> Self {
        let file = snapshots.map(|file| file.with_extension(TOLD));
        Self { file, records: Vec::new(), is_read: false, end: 0 }
    }

    fn read(&mut self) {
        if std::mem::replace(&mut self.is_read, true) {
            return;
        }
        let Some(bytes) = self.file.as_ref().and_then(|file| std::fs::read(file).ok()) else { return };
        let head = head_of(MAGIC);
        let Some(mut rest) = bytes.strip_prefix(&head[..]) else { return };
        self.end = head.len() as u64;
        while let Some((record, behind)) = read_record(rest) {
            self.end += (rest.len() - behind.len()) as u64;
            self.records.push(record);
            rest = behind;
        }
    }

    /// Keeps more, but for what is known.
    pub(super) fn add(&mut self, records: Vec<Record>) {
        self.read();
        for record in records {
            let is_known = |known: &Record| {
                known.actor == record.actor && known.begin <= record.begin && known.end >= record.end
            };
            if self.records.iter().any(is_known) || self.end > BYTES_MAX {
                continue;
            }
            if self.write(&record).is_err() {
                self.file = None;
            }
            self.records.push(record);
        }
        if let Some(file) = &self.file {
            let _ = make_room_beside(file);
        }
    }

    fn write(&mut self, record: &Record) -> std::io::Result<()> {
        let Some(path) = &self.file else { return Ok(()) };
        if self.end == 0 {
            if let Some(folder) = path.parent() {
                std::fs::create_dir_all(folder)?;
            }
            let head = head_of(MAGIC);
            std::fs::write(path, &head)?;
            self.end = head.len() as u64;
        }
        let mut record = record.clone();
        let told = postcard::to_stdvec(&record).map_err(std::io::Error::other)?;
        let mut bytes = (told.len() as u32).to_le_bytes().to_vec();
        bytes.extend_from_slice(&told);
        record.blocks().for_each(|block| bytes.extend_from_slice(&block.bytes));
        bytes.extend_from_slice(&checksum(&bytes));
        let mut file = OpenOptions::new().write(true).open(path)?;
        // Behind the last whole one: what another run left half written is written over.
        file.seek(SeekFrom::Start(self.end))?;
        file.write_all(&bytes)?;
        self.end += bytes.len() as u64;
        Ok(())
    }

    /// The records of an actor that follow each other from its first delivery on, as far as they do.
    fn following(
        &self,
        actor: ActorId,
        is_of_use: impl Fn(&Record) -> bool,
    ) -> impl Iterator<Item = (u64, &Record)> {
        let of_actor = |record: &&Record| record.actor == actor.0 && is_of_use(record);
        let mut records: Vec<&Record> = self.records.iter().filter(of_actor).collect();
        records.sort_by_key(|record| (record.begin, record.end));
        let mut cursor = 0;
        let mut next = 0;
        std::iter::from_fn(move || {
            // Of those that begin at the cursor or before it, the one that goes farthest.
            let mut best: Option<&Record> = None;
            while let Some(record) = records.get(next).filter(|record| record.begin <= cursor) {
                if record.end > cursor && best.is_none_or(|best| record.end > best.end) {
                    best = Some(record);
                }
                next += 1;
            }
            let best = best?;
            Some((std::mem::replace(&mut cursor, best.end), best))
        })
    }

    /// So many deliveries of an actor are known from its first one on; one more where all of them are.
    pub(super) fn known_to(&mut self, actor: ActorId) -> u64 {
        self.read();
        self.following(actor, |_| true).last().map_or(0, |(_, record)| record.end)
    }

    /// What `look` finds in the state that each delivery left, where it is another than after the one before; `None` if that
    /// is not known of all `deliveries`.
    pub(super) fn left(
        &mut self,
        actor: ActorId,
        deliveries: u64,
        look: impl Fn(&Content) -> Content,
    ) -> Option<BTreeMap<u64, Content>> {
        self.read();
        let (mut found, mut end) = (BTreeMap::new(), 0);
        // What stood there before the first delivery, and the next one before which anything is seen.
        let (mut at_first, mut first) = (None, 1);
        let mut last = None;
        let mut see = |index: u64, value: Content| {
            if last.as_ref() != Some(&value) {
                last = Some(value.clone());
                found.insert(index - 1, value);
            }
        };
        for (cursor, record) in self.following(actor, |record| record.state.is_some()) {
            let raw = record.state.as_ref()?.raw()?;
            let mut reader = Reader::new(&raw);
            while let Some(entry) = reader.entry() {
                let (index, state) = entry?;
                if index < cursor {
                    continue;
                }
                match state {
                    None => first += u64::from(index == first),
                    Some(state) if index == 0 => at_first = Some(look(state)),
                    Some(state) => {
                        if let Some(value) = at_first.take().filter(|_| first < index) {
                            see(first, value);
                        }
                        see(index, look(state));
                    }
                }
            }
            end = record.end;
        }
        if end <= deliveries {
            return None;
        }
        if let Some(value) = at_first.filter(|_| first <= deliveries) {
            see(first, value);
        }
        Some(found)
    }

    /// All messages of a kind that an actor was told; `None` if that is not known of all `deliveries`.
    pub(super) fn heard(
        &mut self,
        actor: ActorId,
        deliveries: u64,
        kind: &str,
    ) -> Option<Vec<(u64, Content)>> {
        self.read();
        let (mut found, mut end) = (Vec::new(), 0);
        for (cursor, record) in self.following(actor, |r| !matches!(r.heard(kind), Some(Heard::At(_)))) {
            if let Some(Heard::Told(block)) = record.heard(kind) {
                let raw = block.raw()?;
                let mut reader = Reader::new(&raw);
                while let Some(entry) = reader.entry() {
                    let (index, told) = entry?;
                    found.extend(told.filter(|_| index >= cursor).map(|told| (index, told.clone())));
                }
            }
            end = record.end;
        }
        (end >= deliveries).then_some(found)
    }

    /// In which deliveries an actor was told messages of a kind; `None` if that is not known of all `deliveries`.
    pub(super) fn heard_at(&mut self, actor: ActorId, deliveries: u64, kind: &str) -> Option<Vec<u64>> {
        self.read();
        let (mut found, mut end) = (Vec::new(), 0);
        for (cursor, record) in self.following(actor, |_| true) {
            if let Some(Heard::Told(block) | Heard::At(block)) = record.heard(kind) {
                let raw = block.raw()?;
                let mut reader = Reader::new(&raw);
                while let Some(entry) = reader.entry() {
                    let (index, _) = entry?;
                    if index >= cursor {
                        found.push(index);
                    }
                }
            }
            end = record.end;
        }
        (end >= deliveries).then_some(found)
    }

    /// In which deliveries of the renderer a tile of the shown picture may have changed; `None` if that is not known of all
    /// `deliveries`.
    pub(super) fn tile_changed(
        &mut self,
        renderer: ActorId,
        deliveries: u64,
        tile: usize,
    ) -> Option<Vec<u64>> {
        self.read();
        let (mut found, mut end) = (Vec::new(), 0);
        for (_, record) in self.following(renderer, |record| record.pictures.is_some()) {
            found.extend(changes(&record.pictures.as_ref()?.raw()?, tile)?);
            end = record.end;
        }
        found.sort_unstable();
        (end >= deliveries).then_some(found)
    }
}

fn checksum(bytes: &[u8]) -> [u8; CHECKSUM] {
    let hash = blake3::hash(bytes);
    std::array::from_fn(|at| hash.as_bytes()[at])
}

/// The first record, and what is behind it; `None` where there is none or it is damaged.
fn read_record(bytes: &[u8]) -> Option<(Record, &[u8])> {
    let (length, behind) = bytes.split_first_chunk::<4>()?;
    let (told, mut behind) = behind.split_at_checked(u32::from_le_bytes(*length) as usize)?;
    let mut record: Record = postcard::from_bytes(told).ok()?;
    let mut is_whole = true;
    for block in record.blocks() {
        match behind.split_at_checked(block.length as usize) {
            Some((stored, rest)) => {
                block.bytes = stored.to_vec();
                behind = rest;
            }
            None => is_whole = false,
        }
    }
    let content = &bytes[..bytes.len() - behind.len()];
    let (sum, behind) = behind.split_first_chunk::<CHECKSUM>()?;
    (is_whole && *sum == checksum(content)).then_some((record, behind))
}
