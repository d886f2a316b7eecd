//! What replay delivers to an actor: its recording, and the messages that are made anew and wait for their turn in it.

use std::collections::VecDeque;
use std::sync::Arc;

use crate::log::format::{Hashing, Payload, Symbol, value};
use crate::log::reader::Trace;
use crate::log::walk::{ActorLog, Walk};
use crate::mailbox::Inbound;
use crate::message::{ActorId, Reason};

/// The next delivery of a script.
pub(crate) struct Next {
    pub(crate) symbol: Symbol,
    pub(crate) payload: Payload<'static>,
    pub(crate) external: Option<Vec<u8>>,
    after: usize,
}

/// One actor's recording, read from the front.
pub(crate) struct Script {
    log: Arc<ActorLog>,
    trace: Arc<Trace>,
    walk: Walk,
    pub(crate) hashing: Hashing,
    pub(crate) complete: bool,
    /// Kind of the mark that [`Script::value`] took last.
    pub(crate) mark_kind: u32,
}

impl Script {
    pub(crate) fn new(trace: &Arc<Trace>, actor: ActorId) -> Option<Self> {
        Some(Self {
            log: Arc::clone(trace.logs.get(actor.0 as usize)?),
            trace: Arc::clone(trace),
            walk: Walk::default(),
            hashing: trace.header().hashing,
            complete: trace.complete(),
            mark_kind: 0,
        })
    }

    /// What is delivered next.
    pub(crate) fn next(&mut self) -> Option<Next> {
        let symbol = self.walk.peek(&self.log)?;
        let (payload, after) =
            self.walk.payload(&self.log, symbol, self.trace.header().is_port(symbol.from))?;
        let (payload, external) = match payload {
            Payload::External(bytes) => (Payload::None, Some(bytes.to_vec())),
            Payload::None => (Payload::None, None),
            Payload::Skipped(count) => (Payload::Skipped(count), None),
            Payload::Timer { timer, time } => (Payload::Timer { timer, time }, None),
            Payload::Order(bits) => (Payload::Order(bits), None),
            Payload::Job { id, attempt } => (Payload::Job { id, attempt }, None),
        };
        Some(Next { symbol, payload, external, after })
    }

    /// Passes what [`Script::next`] gave.
    pub(crate) fn pass(&mut self, next: &Next) {
        self.walk.pass(next.payload, next.after, 1);
    }

    pub(crate) fn walk(&self) -> &Walk {
        &self.walk
    }

    pub(crate) fn go_on_from(&mut self, walk: Walk) {
        self.walk = walk;
    }

    /// Nothing more is recorded of this actor.
    pub(crate) fn exhausted(&mut self) -> bool {
        self.walk.peek(&self.log).is_none()
    }

    pub(crate) fn peek_value(&self) -> Option<(u64, u8)> {
        self.walk.peek_value(&self.log)
    }

    pub(crate) fn value(&mut self) -> Option<u64> {
        let taken = self.walk.value(&self.log)?;
        if taken.tag == value::MARK {
            self.mark_kind = taken.kind;
        }
        Some(taken.content)
    }

    pub(crate) fn hash16(&mut self) -> Option<u16> {
        self.walk.hash16(&self.log)
    }

    /// What was recorded of what the actor made of the delivery at hand.
    pub(crate) fn said(&mut self) -> Option<(bool, u16)> {
        self.walk.said(&self.log)
    }

    pub(crate) fn hash64(&mut self) -> Option<u64> {
        self.walk.hash64(&self.log)
    }

    pub(crate) fn rejects(&mut self, number: u64) -> Option<Reason> {
        self.walk.rejects(&self.log, number)
    }

    /// Deliveries recorded and the chained hash behind them, where the recording says it.
    pub(crate) fn recorded(&self) -> (u64, Option<u64>) {
        (self.log.deliveries, Some(self.log.chain).filter(|chain| *chain != 0))
    }
}

/// Messages that were made anew and wait until the script calls for them, by sender and lane.
pub(crate) struct Stash<M> {
    waiting: Vec<(Symbol, VecDeque<(u64, M)>)>,
}

impl<M> Stash<M> {
    pub(crate) fn new() -> Self {
        Self { waiting: Vec::new() }
    }

    pub(crate) fn put(&mut self, inbound: Inbound<M>) {
        let symbol = Symbol { from: inbound.from, lane: inbound.lane };
        match self.waiting.iter_mut().find(|(other, _)| *other == symbol) {
            Some((_, queue)) => queue.push_back((inbound.sent_in, inbound.message)),
            None => self.waiting.push((symbol, VecDeque::from([(inbound.sent_in, inbound.message)]))),
        }
    }

    /// All messages that wait: sender, way, deliveries to the sender by then, message.
    pub(crate) fn messages(&self) -> impl Iterator<Item = (ActorId, u8, u64, &M)> {
        let queues = self.waiting.iter();
        queues.flat_map(|(symbol, queue)| {
            queue.iter().map(|(sent_in, message)| (symbol.from, symbol.lane, *sent_in, message))
        })
    }

    /// Takes the message after `skipped` older ones, with the deliveries to its sender by then; none if it is not there
    /// yet.
    pub(crate) fn take(&mut self, symbol: Symbol, skipped: u32) -> Option<(u64, M)> {
        let (_, queue) = self.waiting.iter_mut().find(|(other, _)| *other == symbol)?;
        if queue.len() <= skipped as usize {
            return None;
        }
        queue.drain(..skipped as usize);
        queue.pop_front()
    }
}
