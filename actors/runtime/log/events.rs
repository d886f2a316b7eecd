//! What happened, read off a recording without running anything.

use super::format::{Hashing, Header, Payload, lane, unquantise, value};
use super::reader::Trace;
use super::walk::{ActorLog, Stride, Value, Walk};
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
    /// The actor took up a count that was a fact of the moment.
    Counted {
        /// Deliveries by then.
        index: u64,
        /// The count.
        count: u64,
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
    /// The worker hung at a job for so long that another one got it.
    LeaseLost {
        /// Deliveries by then.
        index: u64,
    },
    /// The actor was ordered to stop, and left what it was at.
    GivenUp {
        /// Deliveries by then.
        index: u64,
    },
}

/// What comes next of an actor: a value, or deliveries from an index on.
enum Step<'a> {
    Value(Value),
    Deliveries(u64, Stride<'a>),
}

/// An actor's log from the front. A run of deliveries that carry nothing is one step, however long it is.
struct Steps<'a> {
    log: &'a ActorLog,
    header: &'a Header,
    walk: Walk,
    index: u64,
}

impl<'a> Iterator for Steps<'a> {
    type Item = Step<'a>;

    fn next(&mut self) -> Option<Step<'a>> {
        let most = match self.walk.peek_value(self.log) {
            Some((at, _)) if at <= self.index => return self.walk.value(self.log).map(Step::Value),
            Some((at, _)) => at - self.index,
            None => u64::MAX,
        };
        let stride = self.walk.stride(self.log, self.header, most)?;
        let index = self.index;
        self.index += stride.count;
        Some(Step::Deliveries(index, stride))
    }
}

impl Trace {
    fn steps(&self, actor: ActorId) -> Option<Steps<'_>> {
        let log = self.logs.get(actor.0 as usize)?;
        Some(Steps { log, header: self.header(), walk: Walk::default(), index: 0 })
    }

    /// Everything that happened to one actor, in its order.
    pub fn events(&self, actor: ActorId) -> impl Iterator<Item = Event> + '_ {
        self.steps(actor).into_iter().flatten().flat_map(|step| {
            let (value, run) = match step {
                Step::Value(value) => (Some(event_of(value)), None),
                Step::Deliveries(first, stride) => (None, Some((first, stride))),
            };
            let delivered = run.into_iter().flat_map(|(first, stride)| {
                (first..first + stride.count).map(move |index| delivered(index, &stride))
            });
            value.into_iter().chain(delivered)
        })
    }

    /// A delivery to one actor, by its number.
    pub fn delivery(&self, actor: ActorId, index: u64) -> Option<Event> {
        self.steps(actor)?.find_map(|step| match step {
            Step::Deliveries(first, stride) if index - first < stride.count => {
                Some(delivered(index, &stride))
            }
            _ => None,
        })
    }

    /// Deliveries to one actor from another.
    pub fn deliveries_from(&self, actor: ActorId, from: ActorId) -> u64 {
        let steps = self.steps(actor).into_iter().flatten();
        steps
            .map(|step| match step {
                Step::Deliveries(_, stride) if stride.symbol.from == from => stride.count,
                _ => 0,
            })
            .sum()
    }

    /// The marks of one actor: how many deliveries it had before, kind and value.
    pub fn marks(&self, actor: ActorId) -> impl Iterator<Item = (u64, u32, u64)> + '_ {
        let log = self.logs.get(actor.0 as usize);
        let mut walk = Walk::default();
        let values = std::iter::from_fn(move || walk.value(log?));
        values.filter(|value| value.tag == value::MARK).map(|mark| (mark.index, mark.kind, mark.content))
    }

    /// The first delivery at which two recordings of the same wiring part: the actor and the index, for each actor
    /// that parts, or `None` in an actor whose recordings agree as far as both go.
    pub fn first_difference(&self, other: &Self, actor: ActorId) -> Option<u64> {
        let (left, right) = (self.logs.get(actor.0 as usize)?, other.logs.get(actor.0 as usize)?);
        let hash = match (self.header().hashing, other.header().hashing) {
            (Hashing::Exact, Hashing::Exact) => first_hash_difference(left, right),
            (Hashing::Said, Hashing::Said) => first_said_difference(left, right),
            _ => None,
        };
        let (mut left, mut right) = (self.steps(actor)?, other.steps(actor)?);
        let (mut a, mut b) = (left.next(), right.next());
        let mut index = 0;
        while let (Some(one), Some(two)) = (&mut a, &mut b) {
            if let Step::Deliveries(first, _) = one {
                index = *first;
            }
            let same = match (&mut *one, &mut *two) {
                (Step::Deliveries(first, run), Step::Deliveries(_, other)) => {
                    let same = delivered(*first, run) == delivered(*first, other);
                    let end = *first + run.count.min(other.count);
                    if same && hash.is_some_and(|hash| hash < end) {
                        break;
                    }
                    same
                }
                // Times differ between any two runs; what follows from them shows in the hashes.
                (Step::Value(Value { tag, .. }), Step::Value(Value { tag: other, .. }))
                    if tag == other && matches!(*tag, value::NOW | value::MEASURED) =>
                {
                    true
                }
                (Step::Value(value), Step::Value(other)) => event_of(*value) == event_of(*other),
                _ => false,
            };
            if !same {
                return Some(index);
            }
            let count = one.count().min(two.count());
            if !one.shorten(count) {
                a = left.next();
            }
            if !two.shorten(count) {
                b = right.next();
            }
        }
        hash
    }

    /// Who popped each job, in order of (job, attempt).
    pub(crate) fn pops(&self) -> Vec<(u64, u32, ActorId)> {
        let mut pops = Vec::new();
        for (number, log) in self.logs.iter().enumerate() {
            let mut walk = Walk::default();
            while let Some(stride) = walk.stride(log, self.header(), u64::MAX) {
                if let Payload::Job { id, attempt } = stride.payload {
                    pops.push((id, attempt, ActorId(number as u32)));
                }
            }
        }
        pops.sort_unstable();
        pops
    }
}

impl Step<'_> {
    fn count(&self) -> u64 {
        if let Self::Deliveries(_, stride) = self { stride.count } else { 1 }
    }

    /// Passes its first `count`; false if nothing is left.
    fn shorten(&mut self, count: u64) -> bool {
        let Self::Deliveries(first, stride) = self else { return false };
        *first += count;
        stride.count -= count;
        stride.count > 0
    }
}

fn delivered(index: u64, stride: &Stride<'_>) -> Event {
    let Stride { symbol, payload, .. } = *stride;
    Event::Delivered {
        index,
        from: symbol.from,
        lane: lane::name(symbol.lane),
        job: if let Payload::Job { id, .. } = payload { Some(id) } else { None },
        external: if let Payload::External(bytes) = payload { Some(bytes.to_vec()) } else { None },
        skipped: if let Payload::Skipped(count) = payload { count } else { 0 },
    }
}

/// The first delivery whose recorded hash differs.
fn first_hash_difference(left: &ActorLog, right: &ActorLog) -> Option<u64> {
    // One hash for each delivery, or two where the actor's state is hashed as well.
    let each = (left.hashes.len() as u64 / 2).checked_div(left.deliveries)?.max(1);
    let pairs = left.hashes.chunks_exact(2).zip(right.hashes.chunks_exact(2));
    pairs.into_iter().position(|(a, b)| a != b).map(|position| position as u64 / each)
}

/// The first delivery of which something else was said.
fn first_said_difference(left: &ActorLog, right: &ActorLog) -> Option<u64> {
    let (mut a, mut b) = (Walk::default(), Walk::default());
    let pairs = std::iter::from_fn(|| Some((a.said(left)?, b.said(right)?)));
    pairs.into_iter().position(|(a, b)| a != b).map(|position| position as u64)
}

fn event_of(value: Value) -> Event {
    let Value { index, tag, content, kind } = value;
    match tag {
        value::NOW => Event::Now { index, nanoseconds: content },
        value::MEASURED => Event::Measured { index, nanoseconds: unquantise(content) },
        value::COUNT => Event::Counted { index, count: content },
        value::MARK => Event::Mark { index, kind, value: content },
        value::LOST => Event::LeaseLost { index },
        value::GIVEN_UP => Event::GivenUp { index },
        _ => Event::Panicked { index, injected: tag == value::FAULT },
    }
}
