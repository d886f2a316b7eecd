//! What actors say to each other: messages, their digests, and the values that come back when a mailbox is full.

pub(crate) mod content;
pub(crate) mod incident;
pub(crate) mod saved;

use postcard::ser_flavors::Flavor;
use serde::Serialize;
use std::fmt;

use content::Content;
use saved::{Loader, Saver};

/// Identity of an actor or a port: the order in which the wiring made it, never an address in memory.
///
/// Actors and ports share one numbering, since both are senders.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize,
)]
pub struct ActorId(pub u32);

impl fmt::Display for ActorId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "#{}", self.0)
    }
}

/// Number of newest-only slots of every mailbox: the keys of [`Lane::Latest`] are `0..LATEST_KEYS`.
pub const LATEST_KEYS: u8 = 8;

/// Which way into the mailbox a message takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lane {
    /// In order with everything else of this sender.
    Data,
    /// Its own small queue, served before all data, so that it overtakes a full mailbox.
    Control,
    /// Only the newest of this key counts (`0..LATEST_KEYS`): an older one that was not yet delivered is replaced.
    Latest(u8),
}

/// A closed set of things one actor can be told.
///
/// Derive it: then everything is said for every field, and a field added later cannot be forgotten.
///
/// ```
/// use foveal_runtime::Message;
/// use serde::{Deserialize, Serialize};
/// use std::sync::Arc;
///
/// #[derive(Message)]
/// enum ShowMsg {
///     /// Numbers, texts, options, lists, what has serde's traits: all of it is in the digest, and in snapshots.
///     Moved { by: [f32; 3], label: Option<String> },
///     /// Only the newest counts. Others: `lane = control`, `lane = data`, which is meant where nothing is said.
///     #[message(lane = latest(0))]
///     Tick(u64),
///     /// Its heap counts against the mailbox's bound in bytes. Bulk data is hashed once, by its maker.
///     #[message(size = pixels.len())]
///     Drawn {
///         #[message(skip = "`hash` tells it")]
///         pixels: Arc<Vec<u8>>,
///         hash: u64,
///     },
///     /// Where the name in reports is another.
///     #[message(kind = if *_0 { "On" } else { "Off" })]
///     Switched(bool),
/// }
/// # assert_eq!(ShowMsg::Switched(true).kind(), "On");
/// # let drawn = ShowMsg::Drawn { pixels: Arc::new(vec![0; 9]), hash: 4 };
/// # assert_eq!((drawn.size_bytes(), drawn.kind()), (9, "Drawn"));
/// # assert_eq!(ShowMsg::Tick(3).lane(), foveal_runtime::Lane::Latest(0));
/// ```
///
/// A field's `with = module` names functions `digest(&field, &mut Digest)`, `content(&field) -> Content`,
/// `save(&field, &mut Saver)` and `restore(&mut Loader) -> Option<Field>` for types without serde's traits; with `skip`
/// the first is not asked for. A variant or a whole message with `unsaved = "why"` lets no snapshot be taken while it waits, and its fields need not
/// be read back. Leaving something out takes a reason:
///
/// ```compile_fail
/// #[derive(foveal_runtime::Message)]
/// struct Told {
///     #[message(skip)]
///     value: u64,
/// }
/// ```
///
/// What cannot be hashed is no message:
///
/// ```compile_fail
/// #[derive(foveal_runtime::Message)]
/// #[message(unsaved = "a test")]
/// struct Told {
///     value: std::cell::Cell<std::time::Instant>,
/// }
/// ```
pub trait Message: Send + 'static {
    /// Adds the content to a hash. Two messages with equal digests are taken to be equal by replay, so everything
    /// that can change the receiver belongs in it. Bulk data is hashed once by its maker and carries its hash.
    fn digest(&self, digest: &mut Digest);

    /// The variant's name, for reports.
    fn kind(&self) -> &'static str;

    /// What it says, for whoever looks at a replay.
    fn content(&self) -> Content {
        Content::Name(self.kind().into())
    }

    /// Bytes held beyond the value itself (heap, shared buffers), counted against the mailbox's bound in bytes.
    fn size_bytes(&self) -> usize {
        0
    }

    /// How this message travels.
    fn lane(&self) -> Lane {
        Lane::Data
    }

    /// Writes the message for a snapshot that is taken while it waits. Where nobody says how, there is none then.
    fn save(&self, saver: &mut Saver) {
        saver.refuse();
    }

    /// Reads a message that was saved.
    fn restore(_loader: &mut Loader<'_>) -> Option<Self>
    where
        Self: Sized,
    {
        None
    }
}

/// A running 64-bit hash of message content. Each step is a bijection of the word that goes in, so that messages
/// which differ in one word never collide.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Digest(u64);

impl Digest {
    /// An empty digest.
    pub const fn new() -> Self {
        Self(0x243f_6a88_85a3_08d3)
    }

    /// Adds one word.
    #[inline]
    pub fn u64(&mut self, word: u64) {
        let product = (self.0.rotate_left(5) ^ word).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = product ^ (product >> 32);
    }

    /// Adds a 32-bit word.
    #[inline]
    pub fn u32(&mut self, word: u32) {
        self.u64(u64::from(word));
    }

    /// Adds the bits of a number: −0 and 0 differ, as do different NaNs.
    #[inline]
    pub fn f32(&mut self, number: f32) {
        self.u32(number.to_bits());
    }

    /// Adds the bits of a number: −0 and 0 differ, as do different NaNs.
    #[inline]
    pub fn f64(&mut self, number: f64) {
        self.u64(number.to_bits());
    }

    /// Adds a string of bytes and its length.
    pub fn bytes(&mut self, bytes: &[u8]) {
        self.u64(bytes.len() as u64);
        self.u64(xxhash_rust::xxh3::xxh3_64(bytes));
    }

    /// Adds everything that the value's serialization writes: numbers by their bits, lengths and variants included.
    ///
    /// A value must be of a kind that can be serialized: a sequence, for one, knows its length. Others add nothing.
    #[inline]
    pub fn value(&mut self, value: &(impl Serialize + ?Sized)) {
        let words = Words { digest: *self, word: 0, bytes: 0 };
        let added = postcard::serialize_with_flavor(value, words);
        debug_assert!(added.is_ok(), "content of a message that cannot be serialized: {added:?}");
        *self = added.unwrap_or(*self);
    }

    /// The hash of all that was added.
    #[inline]
    pub const fn finish(self) -> u64 {
        self.0
    }

    #[inline]
    pub(crate) const fn from_chain(chain: u64) -> Self {
        Self(chain)
    }
}

/// Takes serialized bytes, eight at a time, into a digest.
struct Words {
    digest: Digest,
    /// The bytes that do not fill a word yet, the first one lowest.
    word: u64,
    /// All bytes so far.
    bytes: u64,
}

impl Flavor for Words {
    type Output = Digest;

    #[inline]
    fn try_push(&mut self, byte: u8) -> postcard::Result<()> {
        self.word |= u64::from(byte) << (self.bytes % 8 * 8);
        self.bytes += 1;
        if self.bytes.is_multiple_of(8) {
            self.digest.u64(std::mem::take(&mut self.word));
        }
        Ok(())
    }

    #[inline]
    fn try_extend(&mut self, bytes: &[u8]) -> postcard::Result<()> {
        // What is long is hashed by what is made for it.
        if bytes.len() > 64 {
            self.digest.bytes(bytes);
            return Ok(());
        }
        bytes.iter().try_for_each(|byte| self.try_push(*byte))
    }

    #[inline]
    fn finalize(mut self) -> postcard::Result<Digest> {
        self.digest.u64(self.word);
        self.digest.u64(self.bytes);
        Ok(self.digest)
    }
}

/// Why a message came back.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Reason {
    /// The mailbox holds as many messages as it may.
    Full,
    /// The mailbox holds as many bytes as it may.
    FullBytes,
    /// The receiver has stopped.
    Stopped,
}

/// A message that was not accepted, handed back to its sender.
pub struct Rejected<M> {
    /// The message itself.
    pub message: M,
    /// Why it came back.
    pub reason: Reason,
}

impl<M> fmt::Debug for Rejected<M> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Rejected({:?})", self.reason)
    }
}

impl<M> fmt::Display for Rejected<M> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.reason {
            Reason::Full => "the mailbox is full",
            Reason::FullBytes => "the mailbox holds as many bytes as it may",
            Reason::Stopped => "the receiver has stopped",
        })
    }
}

impl<M> std::error::Error for Rejected<M> {}

/// What a sender may still post: a counter it takes from before it tells and gives back to when the receiver
/// answers. A receiver whose mailbox holds the sum of all its senders' credits is never full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Credits {
    available: u32,
    total: u32,
}

impl Credits {
    /// `total` messages may be on their way at once.
    pub const fn new(total: u32) -> Self {
        Self { available: total, total }
    }

    /// Takes `count` credits, or none at all.
    #[must_use]
    pub fn take(&mut self, count: u32) -> bool {
        let enough = count <= self.available;
        if enough {
            self.available -= count;
        }
        enough
    }

    /// Gives `count` credits back.
    ///
    /// # Panics
    /// If more come back than were taken: the protocol between the two actors is broken.
    pub fn give(&mut self, count: u32) {
        self.available += count;
        assert!(self.available <= self.total, "more credits returned than were taken");
    }

    /// Credits that can be taken now.
    pub const fn available(&self) -> u32 {
        self.available
    }

    /// Credits that are out.
    pub const fn taken(&self) -> u32 {
        self.total - self.available
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_bit_always_changes_a_digest() {
        let digest = |words: &[u64]| {
            let mut digest = Digest::new();
            words.iter().for_each(|word| digest.u64(*word));
            digest.finish()
        };
        let words = [3, 0, u64::MAX, 17];
        for word in 0..words.len() {
            for bit in 0..64 {
                let mut flipped = words;
                flipped[word] ^= 1 << bit;
                assert_ne!(digest(&words), digest(&flipped), "word {word} bit {bit}");
            }
        }
        assert_ne!(digest(&[1, 2]), digest(&[2, 1]));
    }

    #[test]
    fn credits_are_all_or_nothing() {
        let mut credits = Credits::new(3);
        assert!(credits.take(2));
        assert!(!credits.take(2));
        assert_eq!((credits.available(), credits.taken()), (1, 2));
        credits.give(2);
        assert_eq!(credits.available(), 3);
    }
}
