//! What happened, read off a recording without running anything.

use super::format::{Hashing, lane, unquantise, value};
use super::reader::Trace;
use super::walk::{ActorLog, Value, Walk};
use crate::journal::Payload;
use crate::message::ActorId;

/// Something that happened to one actor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Event {
    /// A delivery.
    Delivered {
        /// Its number, from 0.
        index: u64,
        /// The sender; the actor itself for timers, orders and jobs.
        from: ActorId,
        /// `data`, `control`, `timer`, `job`, …
        lane: &'static str,
        /// Identity of the job, where one was popped.
        job: Option<u64>,
        /// Encoded payload of what came from outside.
        external: Option<Vec<u8>>,
        /// Older newest-only values of this sender that were replaced before this one.
        skipped: u32,
    },
    /// The actor read the clock, in nanoseconds.
    Now {
        /// Deliveries before.
        index: u64,
        /// What it read, in nanoseconds.
        nanoseconds: u64,
    },
    /// The actor was given a measured duration.
    Measured {
        /// Deliveries before.
        index: u64,
        /// The duration, in nanoseconds.
        nanoseconds: u64,
    },
    /// A mark of the application.
    Mark {
        /// Deliveries before.
        index: u64,
        /// The application's kind.
        kind: u32,
        /// The application's value.
        value: u64,
    },
    /// The actor panicked.
    Panicked {
        /// Deliveries before.
        index: u64,
        /// The simulator made it.
        injected: bool,
    },
}

impl Trace {
    /// Everything that happened to one actor, in its order.
    pub fn events(&self, actor: ActorId) -> impl Iterator<Item = Event> + '_ {
        let log = self.logs.get(actor.0 as usize);
        let mut walk = Walk::default();
        let mut index = 0;
        std::iter::from_fn(move || {
            let log = log?;
            if let Some((at, _)) = walk.peek_value(log)
                && at <= index
            {
                return walk.value(log).map(event_of);
            }
            let symbol = walk.peek(log)?;
            let (payload, external) = walk.payload(log, symbol, self.is_port(symbol.from))?;
            walk.pass(payload, external);
            index += 1;
            Some(Event::Delivered {
                index: index - 1,
                from: symbol.from,
                lane: lane::name(symbol.lane),
                job: if let Payload::Job { id, .. } = payload { Some(id) } else { None },
                external: if let Payload::External(bytes) = payload { Some(bytes.to_vec()) } else { None },
                skipped: if let Payload::Skipped(count) = payload { count } else { 0 },
            })
        })
    }

    /// The first delivery at which two recordings of the same wiring part: the actor and the index, for each actor
    /// that parts, or `None` in an actor whose recordings agree as far as both go.
    pub fn first_difference(&self, other: &Self, actor: ActorId) -> Option<u64> {
        let (left, right) = (self.logs.get(actor.0 as usize)?, other.logs.get(actor.0 as usize)?);
        let exact = |trace: &Self| trace.header().hashing == Hashing::Exact;
        let hash = if exact(self) && exact(other) { first_hash_difference(left, right) } else { None };
        let mut index = 0;
        for (a, b) in self.events(actor).zip(other.events(actor)) {
            if let Event::Delivered { index: at, .. } = a {
                index = at;
            }
            if hash == Some(index) {
                break;
            }
            let differs = match (&a, &b) {
                // Times differ between any two runs; what follows from them shows in the hashes.
                (Event::Now { .. }, Event::Now { .. }) | (Event::Measured { .. }, Event::Measured { .. }) => {
                    false
                }
                _ => a != b,
            };
            if differs {
                return Some(index);
            }
        }
        hash
    }

    /// Who popped each job, in order of (job, attempt).
    pub(crate) fn pops(&self) -> Vec<(u64, u32, ActorId)> {
        let mut pops = Vec::new();
        for (number, log) in self.logs.iter().enumerate() {
            let mut walk = Walk::default();
            while let Some(symbol) = walk.peek(log) {
                let Some((payload, external)) = walk.payload(log, symbol, self.is_port(symbol.from)) else {
                    break;
                };
                walk.pass(payload, external);
                if let Payload::Job { id, attempt } = payload {
                    pops.push((id, attempt, ActorId(number as u32)));
                }
            }
        }
        pops.sort_unstable();
        pops
    }
}

/// The first delivery whose recorded hash differs.
fn first_hash_difference(left: &ActorLog, right: &ActorLog) -> Option<u64> {
    // One hash for each delivery, or two where the actor's state is hashed as well.
    let each = (left.hashes.len() as u64 / 2).checked_div(left.deliveries)?.max(1);
    let pairs = left.hashes.chunks_exact(2).zip(right.hashes.chunks_exact(2));
    pairs.into_iter().position(|(a, b)| a != b).map(|position| position as u64 / each)
}

fn event_of(value: Value) -> Event {
    let Value { index, tag, content, kind } = value;
    match tag {
        value::NOW => Event::Now { index, nanoseconds: content },
        value::MEASURED => Event::Measured { index, nanoseconds: unquantise(content) },
        value::MARK => Event::Mark { index, kind, value: content },
        _ => Event::Panicked { index, injected: tag == value::FAULT },
    }
}
