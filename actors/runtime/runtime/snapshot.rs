//! Snapshots of a replay: all actors' states with what is on its way between them, so that a replay can begin there.
//!
//! Any moment at which no turn runs is a consistent cut: what was sent and not yet delivered waits with its receiver and
//! is part of the snapshot. Restoring is checked like everything else: the chained hashes go on where they stood, so a
//! state that was not saved whole is named as a divergence at its first delivery.

use std::any::Any;
use std::sync::Arc;

use crate::message::saved::{Loader, Saver};
use crate::runtime::Runtime;

/// A replay at some moment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Snapshot {
    /// Deliveries made to each actor by then.
    positions: Vec<u64>,
    content: Vec<u8>,
}

/// Bytes that are compressed by themselves, so that several threads can.
const BLOCK: usize = 1 << 20;

/// Does something to each of many, on several threads where there are some.
fn beside<T: Send>(all: &mut [T], work: impl Fn(&mut T) + Sync) {
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(all.len()).max(1);
    let mut parts = all.chunks_mut(all.len().div_ceil(threads).max(1));
    let own = parts.next();
    std::thread::scope(|scope| {
        let work = &work;
        for part in parts {
            scope.spawn(move || part.iter_mut().for_each(work));
        }
        own.into_iter().flatten().for_each(work);
    });
}

impl Snapshot {
    /// Deliveries made to each actor by then, by identity; zeros for ports.
    pub fn positions(&self) -> &[u64] {
        &self.positions
    }

    /// Bytes of the states.
    pub fn size_bytes(&self) -> usize {
        self.content.len()
    }

    /// As it can be kept in a file: compressed, with a checksum.
    pub fn to_bytes(&self) -> Vec<u8> {
        // A snapshot may be larger than a segment of a recording.
        let mut bytes = (self.positions.len() as u32).to_le_bytes().to_vec();
        self.positions.iter().for_each(|position| bytes.extend_from_slice(&position.to_le_bytes()));
        bytes.extend_from_slice(&(self.content.len() as u64).to_le_bytes());
        let mut blocks: Vec<(&[u8], Vec<u8>)> =
            self.content.chunks(BLOCK).map(|plain| (plain, Vec::new())).collect();
        beside(&mut blocks, |(plain, block)| *block = lz4_flex::block::compress(plain));
        for (_, block) in blocks {
            bytes.extend_from_slice(&(block.len() as u32).to_le_bytes());
            bytes.extend_from_slice(&block);
        }
        bytes.extend_from_slice(&crc32fast::hash(&bytes).to_le_bytes());
        bytes
    }

    /// Reads what [`Snapshot::to_bytes`] made; `None` if it is damaged.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (content, checksum) = bytes.split_last_chunk::<4>()?;
        if crc32fast::hash(content) != u32::from_le_bytes(*checksum) {
            return None;
        }
        let (count, content) = content.split_first_chunk::<4>()?;
        let (positions, content) = content.split_at_checked(u32::from_le_bytes(*count) as usize * 8)?;
        let (size, mut left) = content.split_first_chunk::<8>()?;
        // A block is at most 255 times shorter than what it holds.
        let size = usize::try_from(u64::from_le_bytes(*size)).ok().filter(|size| size / 255 <= left.len())?;
        let mut content = vec![0; size];
        let mut blocks = Vec::with_capacity(size.div_ceil(BLOCK));
        for plain in content.chunks_mut(BLOCK) {
            let (length, rest) = left.split_first_chunk::<4>()?;
            let (block, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
            blocks.push((block, plain, false));
            left = rest;
        }
        beside(&mut blocks, |(block, plain, is_whole)| {
            *is_whole =
                lz4_flex::block::decompress_into(block, plain).is_ok_and(|length| length == plain.len());
        });
        let is_whole = left.is_empty() && blocks.iter().all(|(_, _, is_whole)| *is_whole);
        let positions =
            positions.as_chunks().0.iter().map(|position| u64::from_le_bytes(*position)).collect();
        is_whole.then_some(Self { positions, content })
    }

    /// Whether a replay that begins here has everything still before it that `cut` has behind it at most.
    pub fn is_before(&self, cut: &[u64]) -> bool {
        self.positions.iter().zip(cut).all(|(position, end)| position <= end)
    }

    fn loader(&self, context: Option<Arc<dyn Any + Send + Sync>>) -> Loader<'_> {
        Loader::new(&self.content, context)
    }
}

impl Runtime {
    /// Takes a snapshot of a replay, between two calls of [`Runtime::pump`]. None if an actor, or something on its way,
    /// cannot be saved as it is now: try again a little later.
    pub fn snapshot(&self) -> Option<Snapshot> {
        if !self.env.replaying() || self.diverged() {
            return None;
        }
        self.held(Self::saved)
    }

    fn saved(&self) -> Option<Snapshot> {
        let mut saver = Saver::new(self.context.clone());
        let (kind, value) = self.env.last_mark().unwrap_or((u32::MAX, 0));
        saver.put(&(kind, value));
        for pool in &self.pools {
            pool.save(&mut saver);
        }
        for node in self.nodes.iter() {
            if !saver.refused() {
                node.save(&mut saver);
            }
        }
        let positions = self.positions().into_iter().map(|(deliveries, _)| deliveries).collect();
        saver.finish().map(|content| Snapshot { positions, content })
    }

    /// Puts a system that was just built where the snapshot was taken.
    pub(crate) fn restore(&self, snapshot: &Snapshot) -> Option<()> {
        let mut loader = snapshot.loader(self.context.clone());
        let (kind, value): (u32, u64) = loader.take()?;
        if kind != u32::MAX {
            self.env.set_last_mark(kind, value);
        }
        for pool in &self.pools {
            pool.restore(&mut loader)?;
        }
        for node in self.nodes.iter() {
            node.restore(&mut loader)?;
        }
        let found = self.positions().into_iter().map(|(deliveries, _)| deliveries);
        (loader.is_empty() && found.eq(snapshot.positions.iter().copied())).then_some(())
    }
}
