//! The bytes of a recording.
//!
//! A file is the magic, a version, and segments `[raw length u32 | stored length u32 | crc32 u32 | block]`, all
//! little-endian; the checksum covers both lengths and the block. A block is lz4's, or of chunks, and with the highest
//! bit of its raw length set, coded by what came before it in the file ([`super::coder`]). A segment's first byte says
//! what it is: the header, chunks, or the end. A chunk holds the next deliveries of one actor in streams whose positions
//! are implied by the order of deliveries, so that none of them interrupts the runs of the first:
//!
//! | stream | content |
//! | --- | --- |
//! | order | runs of deliveries from one (sender, lane), numbered by first appearance |
//! | external | payloads of what comes from outside: port payloads, timers, controls, job pops, skipped older values |
//! | values | what the actor asked for or said while handling: time, durations, marks, verdicts on panics |
//! | hashes | the chained hash: 16 bits for each delivery, or for each that made the actor say something, or 64 bits for each K deliveries |
//! | rejected | which of the actor's own sends came back, and why |
//! | said | whether the actor said something in each delivery |
//! | faint | 4 bits of the chained hash for each delivery in which it did not |
//!
//! Order costs at most a byte a delivery as long as an actor has fewer than 248 senders: one for a sender, the same
//! again for the second delivery of a run, and a mark with a length for all further ones.

use std::fmt;
use std::marker::PhantomData;

use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

use super::fingerprint::Fingerprint;
use crate::message::ActorId;
use crate::scheduler::link::Class;

/// First bytes of every recording.
pub const MAGIC: [u8; 6] = *b"FVLOG\0";
/// Version of this format.
pub const VERSION: u16 = 4;
/// The oldest version that is still read. It had no coded blocks, and hashes of what was delivered, not of what was said.
pub const VERSION_OLDEST: u16 = 3;
/// Marks the raw length of a segment that is coded.
pub(crate) const CODED: u32 = 1 << 31;
/// Streams of a chunk.
pub(crate) const STREAMS: usize = 7;
/// Bits of the chained hash for a delivery in which nothing was said.
pub(crate) const FAINT_BITS: u32 = 4;

/// Numbers of the streams that are not read alike.
pub(crate) mod stream {
    pub(crate) const ORDER: usize = 0;
    pub(crate) const EXTERNAL: usize = 1;
    pub(crate) const VALUES: usize = 2;
    pub(crate) const HASHES: usize = 3;
    pub(crate) const REJECTED: usize = 4;
    pub(crate) const SAID: usize = 5;
    pub(crate) const FAINT: usize = 6;
}
/// Largest segment before compression, in bytes.
pub const SEGMENT_BYTES_MAX: usize = 32 << 20;
/// Bytes of a segment's lengths and checksum.
pub const SEGMENT_HEAD: usize = 12;

/// Deliveries a chunk may hold: actors hand over what they have long before.
pub(crate) const CHUNK_DELIVERIES_MAX: u64 = 1 << 32;
/// Actors and ports a recording may name.
pub(crate) const NODES_MAX: usize = 1 << 16;

pub(crate) const KIND_HEADER: u8 = 0;
pub(crate) const KIND_CHUNKS: u8 = 1;
pub(crate) const KIND_END: u8 = 2;

/// What a delivery carries into the recording beside its sender.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Payload<'a> {
    None,
    /// From a port, encoded.
    External(&'a [u8]),
    /// Newest-only: how many older ones of this sender were replaced.
    Skipped(u32),
    Timer {
        timer: u32,
        time: u64,
    },
    Order(u32),
    Job {
        id: u64,
        attempt: u32,
    },
}

/// How densely the chained hashes are recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Hashing {
    /// None: only a stall or a difference in what is asked or marked shows a divergence.
    Off,
    /// 64 bits for each so many deliveries of an actor: 8/K bytes a message, a divergence is known to within K.
    Every(u32),
    /// 16 bits for each delivery: 2 bytes a message, a divergence is named at its exact message.
    Exact,
    /// 16 bits for each delivery in which the actor said something, of all that it said in it; 4 for each other. About a
    /// byte a message. What an actor makes wrong is named at the delivery in which it did, but once in 65,536 times; what
    /// reaches one wrong that says nothing to it, at that delivery in 15 of 16 times, and within n in 1 − 16⁻ⁿ.
    Said,
}

/// One actor or port as the wiring made it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NodeInfo {
    /// Name, with a number where several have the same type.
    pub name: String,
    /// How it is scheduled; none for a port.
    pub class: Option<Class>,
}

/// What a recording says about itself.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// The application's own header (scene hash, options, …), opaque to the runtime.
    pub application: Vec<u8>,
    /// Where it was recorded. The program's name stands first, so that every version of this format can tell it.
    pub fingerprint: Fingerprint,
    /// Seed of [`crate::Cx::random`].
    pub seed: u64,
    /// How the hashes were recorded.
    pub hashing: Hashing,
    /// Actors and ports, by identity.
    #[serde(deserialize_with = "for_each_node")]
    pub nodes: Vec<NodeInfo>,
}

impl Header {
    pub(crate) fn is_port(&self, id: ActorId) -> bool {
        self.nodes.get(id.0 as usize).is_some_and(|node| node.class.is_none())
    }
}

/// Reads one value for each actor and port, as many as there may be.
fn for_each_node<'de, D: Deserializer<'de>, T: Deserialize<'de>>(
    deserializer: D,
) -> Result<Vec<T>, D::Error> {
    struct Bounded<T>(PhantomData<T>);
    impl<'de, T: Deserialize<'de>> Visitor<'de> for Bounded<T> {
        type Value = Vec<T>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(f, "at most {NODES_MAX} values")
        }

        fn visit_seq<S: SeqAccess<'de>>(self, mut values: S) -> Result<Vec<T>, S::Error> {
            let mut found = Vec::new();
            while let Some(value) = values.next_element()? {
                if found.len() == NODES_MAX {
                    return Err(S::Error::invalid_length(NODES_MAX + 1, &self));
                }
                found.push(value);
            }
            Ok(found)
        }
    }
    deserializer.deserialize_seq(Bounded(PhantomData))
}

/// Closes a recording that ended in order.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct End {
    /// Deliveries and final chained hash of each actor.
    #[serde(deserialize_with = "for_each_node")]
    pub(crate) totals: Vec<(u64, u64)>,
}

/// Which of a receiver's inputs a delivery came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Symbol {
    pub(crate) from: ActorId,
    pub(crate) lane: u8,
}

/// Codes of the lanes in the order stream; newest-only keys follow from `LATEST`.
pub(crate) mod lane {
    pub(crate) const DATA: u8 = 0;
    pub(crate) const CONTROL: u8 = 1;
    pub(crate) const TIMER: u8 = 2;
    pub(crate) const ORDER: u8 = 3;
    pub(crate) const JOB: u8 = 4;
    pub(crate) const STALE: u8 = 5;
    /// A job that killed workers before: how many is its payload.
    pub(crate) const JOB_AGAIN: u8 = 6;
    pub(crate) const STALE_AGAIN: u8 = 7;
    pub(crate) const LATEST: u8 = 8;
    /// One past the last code.
    pub(crate) const END: u8 = LATEST + crate::message::LATEST_KEYS;

    /// The lane's name in reports.
    pub(crate) fn name(lane: u8) -> &'static str {
        match lane {
            DATA => "data",
            CONTROL => "control",
            TIMER => "timer",
            ORDER => "order to stop, pause or resume",
            JOB | JOB_AGAIN => "job",
            STALE | STALE_AGAIN => "stale job",
            _ => "newest only",
        }
    }
}

/// Tags of the values stream.
pub(crate) mod value {
    pub(crate) const NOW: u8 = 0;
    pub(crate) const MEASURED: u8 = 1;
    pub(crate) const MARK: u8 = 2;
    pub(crate) const VERDICT: u8 = 3;
    pub(crate) const FAULT: u8 = 4;
    pub(crate) const COUNT: u8 = 5;
    pub(crate) const LOST: u8 = 6;
    pub(crate) const GIVEN_UP: u8 = 7;
    /// Bits of a tag; the deliveries since the last value stand above them.
    pub(crate) const TAG_BITS: u32 = 3;

    pub(crate) fn name(tag: u8) -> &'static str {
        match tag {
            NOW => "a clock reading",
            MEASURED => "a measured duration",
            MARK => "a mark",
            VERDICT => "a panic",
            FAULT => "an injected fault",
            COUNT => "a count",
            LOST => "a lost lease",
            GIVEN_UP => "work that was given up",
            _ => "an unknown value",
        }
    }
}

/// Why a send came back, in the low bits of what the stream of rejections says.
pub(crate) mod reason {
    use crate::message::Reason;

    /// Bits of a reason; the sends since the last rejection stand above them.
    pub(crate) const BITS: u32 = 2;

    pub(crate) fn code(reason: Reason) -> u64 {
        match reason {
            Reason::Full => 0,
            Reason::FullBytes => 1,
            Reason::Stopped => 2,
        }
    }

    pub(crate) fn of(code: u64) -> Option<Reason> {
        [Reason::Full, Reason::FullBytes, Reason::Stopped]
            .into_iter()
            .find(|reason| self::code(*reason) == code)
    }
}

/// Appends a number, seven bits a byte.
pub(crate) fn put(bytes: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        bytes.push(number as u8 | 0x80);
        number >>= 7;
    }
    bytes.push(number as u8);
}

/// Codes of the order stream: 0 says that the run before it goes on, then come the numbers of symbols in one byte,
/// in two, and in as many as they need.
const RUN: u8 = 0;
const TWO_BYTES: u8 = 248;
const LONG: u8 = 255;
const SHORT_MAX: u32 = TWO_BYTES as u32 - 1;

/// Appends a run of deliveries of one symbol.
pub(crate) fn put_run(bytes: &mut Vec<u8>, symbol: u32, length: u64) {
    put_symbol(bytes, symbol);
    match length {
        0 | 1 => {}
        2 => put_symbol(bytes, symbol),
        _ => {
            bytes.push(RUN);
            put(bytes, length - 3);
        }
    }
}

fn put_symbol(bytes: &mut Vec<u8>, symbol: u32) {
    let behind = symbol.saturating_sub(SHORT_MAX);
    if symbol < SHORT_MAX {
        bytes.push(symbol as u8 + 1);
    } else if behind < u32::from(LONG - TWO_BYTES) << 8 {
        bytes.push(TWO_BYTES + (behind >> 8) as u8);
        bytes.push(behind as u8);
    } else {
        bytes.push(LONG);
        put(bytes, u64::from(symbol));
    }
}

/// Appends a signed difference.
pub(crate) fn put_signed(bytes: &mut Vec<u8>, number: i64) {
    put(bytes, ((number << 1) ^ (number >> 63)) as u64);
}

/// Appends a length and the bytes.
pub(crate) fn put_bytes(bytes: &mut Vec<u8>, content: &[u8]) {
    put(bytes, content.len() as u64);
    bytes.extend_from_slice(content);
}

/// A position in recorded bytes. Every read checks its bounds.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Cursor<'a> {
    pub(crate) bytes: &'a [u8],
    pub(crate) at: usize,
}

impl<'a> Cursor<'a> {
    pub(crate) fn new(bytes: &'a [u8], at: usize) -> Self {
        Self { bytes, at }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.at >= self.bytes.len()
    }

    pub(crate) fn byte(&mut self) -> Option<u8> {
        let byte = *self.bytes.get(self.at)?;
        self.at += 1;
        Some(byte)
    }

    pub(crate) fn number(&mut self) -> Option<u64> {
        let mut number = 0_u64;
        for shift in (0..64).step_by(7) {
            let byte = self.byte()?;
            number |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                // Ten bytes carry 70 bits: the last may hold one.
                return (shift < 63 || byte <= 1).then_some(number);
            }
        }
        None
    }

    pub(crate) fn signed(&mut self) -> Option<i64> {
        let number = self.number()?;
        Some((number >> 1) as i64 ^ -((number & 1) as i64))
    }

    pub(crate) fn slice(&mut self, length: usize) -> Option<&'a [u8]> {
        let slice = self.bytes.get(self.at..self.at.checked_add(length)?)?;
        self.at += length;
        Some(slice)
    }

    /// A symbol's number and how often it comes: what [`put_run`] wrote, or the half of a run of two.
    pub(crate) fn run(&mut self) -> Option<(u32, u64)> {
        let symbol = match self.byte()? {
            RUN => return None,
            code @ ..TWO_BYTES => u32::from(code) - 1,
            code @ ..LONG => {
                let high = u32::from(code - TWO_BYTES) << 8;
                SHORT_MAX + (high | u32::from(self.byte()?))
            }
            LONG => u32::try_from(self.number()?).ok()?,
        };
        if self.bytes.get(self.at) != Some(&RUN) {
            return Some((symbol, 1));
        }
        self.at += 1;
        Some((symbol, self.number()?.checked_add(3)?))
    }

    pub(crate) fn bytes(&mut self) -> Option<&'a [u8]> {
        let length = usize::try_from(self.number()?).ok()?;
        self.slice(length)
    }

    pub(crate) fn u16(&mut self) -> Option<u16> {
        self.slice(2)?.try_into().ok().map(u16::from_le_bytes)
    }

    pub(crate) fn u64(&mut self) -> Option<u64> {
        self.slice(8)?.try_into().ok().map(u64::from_le_bytes)
    }
}

/// A duration rounded to 8 significant bits, as it is recorded and handed to the actor alike.
pub(crate) fn quantise(nanoseconds: u64) -> (u64, u64) {
    let shift = (64 - nanoseconds.leading_zeros()).saturating_sub(8);
    let mantissa = nanoseconds >> shift;
    (mantissa << shift, mantissa << 6 | u64::from(shift))
}

/// The inverse of [`quantise`]'s code.
pub(crate) fn unquantise(code: u64) -> u64 {
    (code >> 6 & 0xff) << (code & 63).min(56)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn numbers_come_back(number: u64, signed: i64) {
            let mut bytes = Vec::new();
            put(&mut bytes, number);
            put_signed(&mut bytes, signed);
            let mut cursor = Cursor::new(&bytes, 0);
            prop_assert_eq!(cursor.number(), Some(number));
            prop_assert_eq!(cursor.signed(), Some(signed));
            prop_assert!(cursor.is_empty());
            prop_assert_eq!(cursor.byte(), None);
        }

        #[test]
        fn runs_come_back(runs: Vec<(u32, u64)>) {
            let mut bytes = Vec::new();
            let length = |raw: u64| raw % 5 + 1;
            let near = |raw: u32| if raw.is_multiple_of(3) { raw } else { raw % 3000 };
            runs.iter().for_each(|(symbol, raw)| put_run(&mut bytes, near(*symbol), length(*raw)));
            let mut cursor = Cursor::new(&bytes, 0);
            for (symbol, raw) in runs {
                let mut left = length(raw);
                while left > 0 {
                    let (found, count) = cursor.run().expect("a run");
                    prop_assert_eq!(found, near(symbol));
                    prop_assert!(count <= left);
                    left -= count;
                }
            }
            prop_assert!(cursor.is_empty());
        }

        #[test]
        fn durations_lose_less_than_a_percent(nanoseconds: u64) {
            let (rounded, code) = quantise(nanoseconds);
            prop_assert_eq!(unquantise(code), rounded);
            prop_assert!(rounded <= nanoseconds && nanoseconds - rounded <= nanoseconds / 128);
        }
    }

    #[test]
    fn order_costs_a_byte_a_delivery_at_most() {
        for symbol in [0, 1, 246] {
            for length in [1, 2, 3, 130, 131, 1 << 40] {
                let mut bytes = Vec::new();
                put_run(&mut bytes, symbol, length);
                assert!(bytes.len() as u64 <= length, "{length} of {symbol}: {bytes:?}");
            }
        }
    }

    #[test]
    fn overlong_numbers_and_lengths_are_refused() {
        assert_eq!(Cursor::new(&[0xff; 11], 0).number(), None);
        let mut bytes = Vec::new();
        put(&mut bytes, u64::MAX);
        assert_eq!(Cursor::new(&bytes, 0).bytes(), None);
        assert_eq!(Cursor::new(&[RUN, 1], 0).run(), None);
        bytes.splice(0..0, [1, RUN]);
        assert_eq!(Cursor::new(&bytes, 0).run(), None);
    }
}
