//! Snapshots of a replay: all actors' states with what is on its way between them, so that a replay can begin there.
//!
//! Any moment at which no turn runs is a consistent cut: what was sent and not yet delivered waits with its receiver and
//! is part of the snapshot. Restoring is checked like everything else: the chained hashes go on where they stood, so a
//! state that was not saved whole is named as a divergence at its first delivery.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::any::Any;
use std::collections::BTreeMap;
use std::sync::Arc;

use crate::actor::{Actor, OwnTimer};
use crate::log::walk::Walk;
use crate::message::{ActorId, Message};
use crate::runtime::Runtime;

/// Writes the state of an actor, a message or a job.
#[derive(Default)]
pub struct Saver {
    bytes: Vec<u8>,
    /// Shared values by their place in memory, which nothing else can take while they are held.
    numbers: BTreeMap<usize, u32>,
    held: Vec<Arc<dyn Any + Send + Sync>>,
    refused: bool,
}

impl Saver {
    /// Writes a value.
    pub fn put(&mut self, value: &(impl Serialize + ?Sized)) {
        match postcard::to_extend(value, std::mem::take(&mut self.bytes)) {
            Ok(bytes) => self.bytes = bytes,
            Err(_) => self.refused = true,
        }
    }

    /// Writes bytes with their length.
    pub fn bytes(&mut self, bytes: &[u8]) {
        crate::log::format::put_bytes(&mut self.bytes, bytes);
    }

    /// Writes a value that several own: once, and its number wherever it comes again.
    pub fn shared<T: Any + Send + Sync>(&mut self, value: &Arc<T>, save: impl FnOnce(&T, &mut Self)) {
        let place = Arc::as_ptr(value) as usize;
        if let Some(number) = self.numbers.get(&place).copied() {
            self.put(&(number + 1));
            return;
        }
        self.put(&0_u32);
        save(value, self);
        self.numbers.insert(place, self.held.len() as u32);
        let held: Arc<dyn Any + Send + Sync> = Arc::clone(value) as _;
        self.held.push(held);
    }

    /// Says that this cannot be saved, at least not as it is now: there is no snapshot at this moment.
    pub fn refuse(&mut self) {
        self.refused = true;
    }
}

/// Reads what a [`Saver`] wrote, in the same order.
pub struct Loader<'a> {
    left: &'a [u8],
    context: Option<Arc<dyn Any + Send + Sync>>,
    held: Vec<Arc<dyn Any + Send + Sync>>,
}

impl<'a> Loader<'a> {
    /// Reads a value.
    pub fn take<T: DeserializeOwned>(&mut self) -> Option<T> {
        let (value, left) = postcard::take_from_bytes(self.left).ok()?;
        self.left = left;
        Some(value)
    }

    /// What the wiring gave to [`crate::Wiring::context`].
    pub fn context<T: Any + Send + Sync>(&self) -> Option<Arc<T>> {
        self.context.clone()?.downcast().ok()
    }

    /// Reads bytes with their length.
    pub fn bytes(&mut self) -> Option<&'a [u8]> {
        let mut cursor = crate::log::format::Cursor::new(self.left, 0);
        let bytes = cursor.bytes()?;
        self.left = &self.left[cursor.at..];
        Some(bytes)
    }

    /// Reads a value that several own.
    pub fn shared<T: Any + Send + Sync>(
        &mut self,
        load: impl FnOnce(&mut Self) -> Option<T>,
    ) -> Option<Arc<T>> {
        match self.take::<u32>()?.checked_sub(1) {
            Some(number) => Arc::clone(self.held.get(number as usize)?).downcast().ok(),
            None => {
                let value = Arc::new(load(self)?);
                let held: Arc<dyn Any + Send + Sync> = Arc::clone(&value) as _;
                self.held.push(held);
                Some(value)
            }
        }
    }
}

/// A replay at some moment.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Snapshot {
    /// Deliveries made to each actor by then.
    positions: Vec<u64>,
    content: Vec<u8>,
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
        let raw = postcard::to_stdvec(self).unwrap_or_default();
        let mut bytes = lz4_flex::block::compress_prepend_size(&raw);
        bytes.extend_from_slice(&crc32fast::hash(&bytes).to_le_bytes());
        bytes
    }

    /// Reads what [`Snapshot::to_bytes`] made; `None` if it is damaged.
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (content, checksum) = bytes.split_last_chunk::<4>()?;
        if crc32fast::hash(content) != u32::from_le_bytes(*checksum) {
            return None;
        }
        let (size, block) = content.split_first_chunk::<4>()?;
        // A block is at most 255 times shorter than what it holds.
        let size = u32::from_le_bytes(*size) as usize;
        let raw = (size / 255 <= block.len()).then(|| lz4_flex::block::decompress(block, size).ok())??;
        postcard::from_bytes(&raw).ok()
    }

    /// Whether a replay that begins here has everything still before it that `cut` has behind it at most.
    pub fn is_before(&self, cut: &[u64]) -> bool {
        self.positions.iter().zip(cut).all(|(position, end)| position <= end)
    }

    fn loader(&self, context: Option<Arc<dyn Any + Send + Sync>>) -> Loader<'_> {
        Loader { left: &self.content, context, held: Vec::new() }
    }
}

/// What of an actor's journal goes into a snapshot.
#[derive(Serialize, Deserialize)]
pub(crate) struct JournalState {
    pub(crate) index: u64,
    pub(crate) chain: u64,
    pub(crate) sends: u64,
    pub(crate) jobs_made: u64,
    pub(crate) randoms: u64,
    pub(crate) sent: Vec<(ActorId, u8, u32)>,
    pub(crate) seen: Vec<(ActorId, u8, u32)>,
    pub(crate) walk: Walk,
}

/// Saves an actor's messages that wait: each with its way and the deliveries to its sender by then.
pub(crate) fn save_messages<M: Message>(saver: &mut Saver, messages: &[(ActorId, u8, u64, &M)]) {
    saver.put(&(messages.len() as u64));
    for (from, lane, sent_in, message) in messages {
        saver.put(&(*from, *lane, *sent_in));
        message.save(saver);
    }
}

pub(crate) fn load_messages<M: Message>(loader: &mut Loader<'_>) -> Option<Vec<(ActorId, u8, u64, M)>> {
    let count: u64 = loader.take()?;
    let mut messages = Vec::new();
    for _ in 0..count {
        let (from, lane, sent_in) = loader.take()?;
        messages.push((from, lane, sent_in, M::restore(loader)?));
    }
    Some(messages)
}

/// Saves an actor's timers.
pub(crate) fn save_timers<A: Actor>(saver: &mut Saver, running: &BTreeMap<u32, OwnTimer<A::Msg>>) {
    saver.put(&(running.len() as u64));
    for (timer, OwnTimer { message, started_in }) in running {
        saver.put(&(*timer, *started_in, message.is_some()));
        if let Some(message) = message {
            message.save(saver);
        }
    }
}

pub(crate) fn load_timers<A: Actor>(loader: &mut Loader<'_>) -> Option<BTreeMap<u32, OwnTimer<A::Msg>>> {
    let count: u64 = loader.take()?;
    let mut running = BTreeMap::new();
    for _ in 0..count {
        let (timer, started_in, carries) = loader.take()?;
        let message = if carries { Some(A::Msg::restore(loader)?) } else { None };
        running.insert(timer, OwnTimer { message, started_in });
    }
    Some(running)
}

impl Runtime {
    /// Takes a snapshot of a replay, between two calls of [`Runtime::pump`]. None if an actor, or something on its way,
    /// cannot be saved as it is now: try again a little later.
    pub fn snapshot(&mut self) -> Option<Snapshot> {
        if !self.env.replaying() || self.diverged() {
            return None;
        }
        let stands = self.env.halted();
        if !stands {
            self.env.halt();
        }
        self.settle();
        let mut saver = Saver::default();
        let (kind, value) = self.env.last_mark().unwrap_or((u32::MAX, 0));
        saver.put(&(kind, value));
        for pool in &self.pools {
            pool.save(&mut saver);
        }
        for node in self.nodes.iter() {
            if !saver.refused {
                node.save(&mut saver);
            }
        }
        let positions = self.positions().into_iter().map(|(deliveries, _)| deliveries).collect();
        if !stands {
            self.env.go_on();
        }
        (!saver.refused).then_some(Snapshot { positions, content: saver.bytes })
    }

    /// Puts a system that was just built where the snapshot was taken.
    pub(crate) fn restore(
        &self,
        snapshot: &Snapshot,
        context: Option<Arc<dyn Any + Send + Sync>>,
    ) -> Option<()> {
        let mut loader = snapshot.loader(context);
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
        (loader.left.is_empty() && found.eq(snapshot.positions.iter().copied())).then_some(())
    }
}
