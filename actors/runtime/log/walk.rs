//! A position in the five streams of one actor's log, and how it moves on.

use serde::{Deserialize, Serialize};

use super::format::{Cursor, Hashing, Header, Payload, STREAMS, Symbol, lane, reason, value};
use crate::message::Reason;

/// What was delivered to one actor, as recorded.
#[derive(Debug, Default)]
pub(crate) struct ActorLog {
    pub(crate) symbols: Vec<Symbol>,
    pub(crate) order: Vec<u8>,
    pub(crate) external: Vec<u8>,
    pub(crate) values: Vec<u8>,
    pub(crate) hashes: Vec<u8>,
    pub(crate) rejected: Vec<u8>,
    /// For each delivery, 1 where the actor said something in it.
    pub(crate) said: Vec<u8>,
    pub(crate) faint: Vec<u8>,
    pub(crate) deliveries: u64,
    /// The chained hash behind the last delivery; 0 where the recording does not say.
    pub(crate) chain: u64,
    /// Ones among `said`.
    pub(crate) spoken: u64,
}

impl ActorLog {
    /// Bytes of the streams as they lie here.
    pub(crate) fn plain(&self) -> [usize; STREAMS] {
        let Self { order, external, values, hashes, rejected, said, faint, .. } = self;
        [order, external, values, hashes, rejected, said, faint].map(Vec::len)
    }

    pub(crate) fn streams(&mut self) -> [&mut Vec<u8>; STREAMS] {
        let Self { order, external, values, hashes, rejected, said, faint, .. } = self;
        [order, external, values, hashes, rejected, said, faint]
    }

    /// There are as many hashes as so many deliveries leave. This bounds the deliveries that a file can claim.
    fn hashes_fit(&self, hashing: Hashing) -> bool {
        let (bytes, deliveries) = (self.hashes.len() as u64, self.deliveries);
        if hashing != Hashing::Said && !(self.said.is_empty() && self.faint.is_empty()) {
            return false;
        }
        match hashing {
            Hashing::Off => bytes == 0,
            Hashing::Every(period) => {
                bytes.is_multiple_of(8) && bytes / 8 == deliveries / u64::from(period.max(1))
            }
            // One for each delivery, and one more for a state that has a hash of its own.
            Hashing::Exact => bytes.is_multiple_of(2) && (deliveries..=2 * deliveries).contains(&(bytes / 2)),
            Hashing::Said => {
                let all = self.said.len() as u64 == deliveries && bytes == 2 * self.spoken;
                all && self.faint.len() as u64 == deliveries - self.spoken
            }
        }
    }
}

/// A value an actor asked for or said.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Value {
    pub(crate) index: u64,
    pub(crate) tag: u8,
    /// Time in nanoseconds, duration code, mark, or verdict.
    pub(crate) content: u64,
    /// Of a mark.
    pub(crate) kind: u32,
}

/// The next deliveries to one actor: one with what it carries, or as many as differ in nothing that is recorded.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stride<'a> {
    pub(crate) symbol: Symbol,
    pub(crate) payload: Payload<'a>,
    pub(crate) count: u64,
    /// Bytes of the payload.
    pub(crate) bytes: usize,
}

/// Positions in the streams of one actor.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(crate) struct Walk {
    order: usize,
    run: Option<(u32, u64)>,
    external: usize,
    last_job: u64,
    last_timer: u64,
    values: usize,
    last_value: u64,
    last_now: u64,
    hashes: usize,
    said: usize,
    rejected: usize,
    last_rejected: u64,
    peeked_rejected: Option<(u64, Reason)>,
}

impl Walk {
    /// Whose message is delivered next.
    pub(crate) fn peek(&mut self, log: &ActorLog) -> Option<Symbol> {
        if self.run.is_none() {
            let mut cursor = Cursor::new(&log.order, self.order);
            let run = cursor.run()?;
            self.order = cursor.at;
            self.run = Some(run);
        }
        let (number, _) = self.run?;
        log.symbols.get(number as usize).copied()
    }

    /// The payload of the next delivery, without passing it.
    pub(crate) fn payload<'a>(
        &self,
        log: &'a ActorLog,
        symbol: Symbol,
        port: bool,
    ) -> Option<(Payload<'a>, usize)> {
        let mut cursor = Cursor::new(&log.external, self.external);
        let payload = match symbol.lane {
            _ if port => Payload::External(cursor.bytes()?),
            lane::TIMER => {
                let timer = u32::try_from(cursor.number()?).ok()?;
                Payload::Timer { timer, time: self.last_timer.wrapping_add(cursor.signed()? as u64) }
            }
            lane::ORDER => Payload::Order(u32::try_from(cursor.number()?).ok()?),
            lane::JOB | lane::STALE | lane::JOB_AGAIN | lane::STALE_AGAIN => {
                let id = self.last_job.wrapping_add(cursor.signed()? as u64);
                let again = matches!(symbol.lane, lane::JOB_AGAIN | lane::STALE_AGAIN);
                Payload::Job { id, attempt: if again { u32::try_from(cursor.number()?).ok()? } else { 0 } }
            }
            lane::DATA | lane::CONTROL => Payload::None,
            lane::LATEST..lane::END => Payload::Skipped(u32::try_from(cursor.number()?).ok()?),
            _ => return None,
        };
        Some((payload, cursor.at))
    }

    /// Passes what comes next, at most `most` deliveries. The length of a run without payloads may be any number, so
    /// it passes at once.
    pub(crate) fn stride<'a>(&mut self, log: &'a ActorLog, header: &Header, most: u64) -> Option<Stride<'a>> {
        let symbol = self.peek(log)?;
        let (payload, external) = self.payload(log, symbol, header.is_port(symbol.from))?;
        let (_, run) = self.run?;
        let count = if matches!(payload, Payload::None) { run.min(most) } else { 1 };
        let bytes = external - self.external;
        self.pass(payload, external, count);
        Some(Stride { symbol, payload, count, bytes })
    }

    /// Passes the delivery whose payload [`Walk::payload`] gave, and as many more of its run as make `count`.
    pub(crate) fn pass(&mut self, payload: Payload<'_>, external: usize, count: u64) {
        if let Some((_, left)) = &mut self.run {
            *left = left.saturating_sub(count);
            if *left == 0 {
                self.run = None;
            }
        }
        self.external = external;
        match payload {
            Payload::Timer { time, .. } => self.last_timer = time,
            Payload::Job { id, .. } => self.last_job = id,
            _ => {}
        }
    }

    /// Delivery and tag of the next value.
    pub(crate) fn peek_value(&self, log: &ActorLog) -> Option<(u64, u8)> {
        let code = Cursor::new(&log.values, self.values).number()?;
        self.value_code(code)
    }

    fn value_code(&self, code: u64) -> Option<(u64, u8)> {
        let tag = code as u8 & ((1 << value::TAG_BITS) - 1);
        Some((self.last_value.checked_add(code >> value::TAG_BITS)?, tag))
    }

    /// Takes the next value.
    pub(crate) fn value(&mut self, log: &ActorLog) -> Option<Value> {
        let mut cursor = Cursor::new(&log.values, self.values);
        let code = cursor.number()?;
        let (index, tag) = self.value_code(code)?;
        let mut kind = 0;
        let content = match tag {
            value::NOW => {
                self.last_now = self.last_now.wrapping_add(cursor.signed()? as u64);
                self.last_now.checked_mul(1000)?
            }
            value::MEASURED | value::VERDICT | value::COUNT => cursor.number()?,
            value::MARK => {
                kind = u32::try_from(cursor.number()?).ok()?;
                cursor.u64()?
            }
            value::FAULT | value::LOST | value::GIVEN_UP => 0,
            _ => return None,
        };
        self.last_value = index;
        self.values = cursor.at;
        Some(Value { index, tag, content, kind })
    }

    pub(crate) fn hash16(&mut self, log: &ActorLog) -> Option<u16> {
        let mut cursor = Cursor::new(&log.hashes, self.hashes);
        let hash = cursor.u16()?;
        self.hashes = cursor.at;
        Some(hash)
    }

    /// What was recorded of what the actor made of the next delivery: whether it said something, and the hash, of 16 bits
    /// then and else of a few.
    pub(crate) fn said(&mut self, log: &ActorLog) -> Option<(bool, u16)> {
        let said = *log.said.get(self.said)? == 1;
        let hash = if said {
            self.hash16(log)?
        } else {
            // As many as were passed and said nothing.
            u16::from(*log.faint.get(self.said - self.hashes / 2)?)
        };
        self.said += 1;
        Some((said, hash))
    }

    pub(crate) fn hash64(&mut self, log: &ActorLog) -> Option<u64> {
        let mut cursor = Cursor::new(&log.hashes, self.hashes);
        let hash = cursor.u64()?;
        self.hashes = cursor.at;
        Some(hash)
    }

    /// Why send `number` came back, if it did; asked once for each send, in order.
    pub(crate) fn rejects(&mut self, log: &ActorLog, number: u64) -> Option<Reason> {
        if self.peeked_rejected.is_none() {
            let mut cursor = Cursor::new(&log.rejected, self.rejected);
            let code = cursor.number()?;
            let reason = reason::of(code & ((1 << reason::BITS) - 1))?;
            self.rejected = cursor.at;
            self.last_rejected = self.last_rejected.wrapping_add(code >> reason::BITS);
            self.peeked_rejected = Some((self.last_rejected, reason));
        }
        let (_, reason) = self.peeked_rejected.take_if(|(next, _)| *next == number)?;
        Some(reason)
    }

    /// Passes the next `count` deliveries and checks that all of them, and all values, can be decoded.
    pub(crate) fn validate(&mut self, log: &ActorLog, header: &Header, count: u64) -> Option<()> {
        let mut left = count;
        while left > 0 {
            left -= self.stride(log, header, left)?.count;
        }
        let ended =
            self.run.is_none() && self.order == log.order.len() && self.external == log.external.len();
        while self.values < log.values.len() {
            let value = self.value(log)?;
            if value.index > log.deliveries {
                return None;
            }
        }
        let mut rejected = Cursor::new(&log.rejected, self.rejected);
        while !rejected.is_empty() {
            reason::of(rejected.number()? & ((1 << reason::BITS) - 1))?;
        }
        self.rejected = rejected.at;
        (ended && log.hashes_fit(header.hashing)).then_some(())
    }
}
