//! Replay: every actor is delivered what its recording says, in that order, from messages that are made anew.

pub(crate) mod snapshot;

use std::collections::VecDeque;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use crate::actor::node::ScriptState;
use crate::journal::Payload;
use crate::log::format::{Hashing, Symbol, value};
use crate::log::reader::Trace;
use crate::log::walk::{ActorLog, Walk};
use crate::mailbox::Inbound;
use crate::mailbox::signals::signal;
use crate::message::{ActorId, Reason};
use crate::runtime::{Limit, Runtime};
use crate::scheduler::clock::nanoseconds;

/// One delivery in a report.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Turn {
    /// Its number among the actor's deliveries.
    pub index: u64,
    /// The sender.
    pub from: ActorId,
    /// `data`, `control`, `timer`, `job`, …
    pub lane: &'static str,
    /// The message's variant.
    pub kind: &'static str,
}

/// Where a replay parts from its recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Divergence {
    /// The actor at which it showed.
    pub actor: ActorId,
    /// Its name.
    pub name: String,
    /// Number of the delivery.
    pub index: u64,
    /// The application's last mark before: kind and value.
    pub mark: Option<(u32, u64)>,
    /// The message's variant.
    pub kind: &'static str,
    /// Who sent it.
    pub from: Option<ActorId>,
    /// What the recording holds.
    pub expected: String,
    /// What happened instead.
    pub found: String,
    /// The actor's last deliveries, newest first (at most 20).
    pub turns: Vec<Turn>,
}

impl fmt::Display for Divergence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}, delivery {}: {}", self.name, self.actor, self.index, self.kind)?;
        if let Some(from) = self.from {
            write!(f, " from {from}")?;
        }
        write!(f, ": expected {}, found {}", self.expected, self.found)?;
        if let Some((kind, value)) = self.mark {
            write!(f, " (last mark: {kind} with {value:016x})")?;
        }
        for turn in &self.turns {
            write!(f, "\n  {:>10}  {} from {} ({})", turn.index, turn.kind, turn.from, turn.lane)?;
        }
        Ok(())
    }
}

/// Where a replay is to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Until {
    /// When so many marks of this kind have been made.
    Mark {
        /// The application's kind.
        kind: u32,
        /// How many of them, from 1.
        count: u64,
    },
    /// After this delivery of this actor.
    Delivery {
        /// The actor.
        actor: ActorId,
        /// Number of the delivery, from 0.
        index: u64,
    },
}

/// How a replay went.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReplayReport {
    /// Deliveries made.
    pub deliveries: u64,
    /// Deliveries recorded.
    pub recorded: u64,
    /// The first difference, if there is one.
    pub divergence: Option<Divergence>,
    /// All of a recording that ended in order was replayed.
    pub complete: bool,
    /// What is different here from where it was recorded, if anything is: see [`crate::Fingerprint`].
    pub foreign: Option<String>,
    /// Actors whose recording goes on, although what comes next depends on a part that was cut off.
    pub waiting: Vec<ActorId>,
}

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

    pub(crate) fn hash64(&mut self) -> Option<u64> {
        self.walk.hash64(&self.log)
    }

    pub(crate) fn rejects(&mut self, number: u64) -> Option<Reason> {
        self.walk.rejects(&self.log, number)
    }

    /// Deliveries recorded and the chained hash behind them.
    pub(crate) fn recorded(&self) -> (u64, u64) {
        (self.log.deliveries, self.log.chain)
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

impl Runtime {
    /// Replays to the end of the recording, or to where it was to stop.
    pub fn replay(&mut self) -> ReplayReport {
        self.set_limits(|_| u64::MAX);
        self.pump(Limit::IDLE);
        self.replay_report()
    }

    /// How the replay stands; call it when [`Runtime::pump`] returned idle or halted.
    pub fn replay_report(&mut self) -> ReplayReport {
        self.settle();
        let env = &self.env;
        let mut report = ReplayReport {
            deliveries: 0,
            recorded: 0,
            divergence: env.first_divergence(),
            complete: false,
            foreign: env.foreign.clone(),
            waiting: Vec::new(),
        };
        let states: Vec<_> = self.nodes.iter().map(|node| node.script_state()).collect();
        for (number, state) in states.iter().enumerate() {
            let Some(state) = state else { continue };
            let actor = ActorId(number as u32);
            report.deliveries += state.made;
            report.recorded += state.recorded;
            if state.waits_for.is_some() {
                report.waiting.push(actor);
            }
            if let Some((expected, found)) = state.wrong_end
                && report.divergence.is_none()
            {
                let (expected, found) = (format!("hash {expected:016x} at the end"), format!("{found:016x}"));
                report.divergence = Some(self.stop_divergence(actor, state.made, None, expected, found));
            }
        }
        let halted = env.halted();
        let whole = env.trace.as_ref().is_some_and(|trace| trace.complete());
        if !halted && report.divergence.is_none() && !report.waiting.is_empty() {
            report.divergence = self.stall(&report.waiting, &states, whole);
        }
        report.complete = whole && report.divergence.is_none() && report.waiting.is_empty();
        report
    }

    /// All are idle and a script goes on. In a recording that was cut, that is its consistent end if the wait leads to
    /// an actor whose script is over; otherwise somebody did not send what was recorded.
    fn stall(&self, waiting: &[ActorId], states: &[Option<ScriptState>], whole: bool) -> Option<Divergence> {
        let ends_in_cut = |mut actor: ActorId| {
            for _ in 0..=states.len() {
                match states.get(actor.0 as usize).copied().flatten() {
                    Some(state) => match state.waits_for {
                        Some((None, _)) => return true,
                        Some((Some(from), _)) if from != actor => actor = from,
                        Some(_) => return false,
                        None => return true,
                    },
                    None => return true,
                }
            }
            false
        };
        let stuck = |actor: &&ActorId| whole || !ends_in_cut(**actor);
        let actor = *waiting.iter().find(stuck)?;
        let state = states.get(actor.0 as usize).copied().flatten()?;
        let (from, lane) = state.waits_for?;
        let sender =
            from.map_or_else(|| "somebody".to_owned(), |from| format!("{} {from}", self.env.name(from)));
        let expected = format!("{} from {sender}", crate::log::format::lane::name(lane));
        let found = "nothing: all actors are idle".to_owned();
        Some(self.stop_divergence(actor, state.made, from, expected, found))
    }

    fn stop_divergence(
        &self,
        actor: ActorId,
        index: u64,
        from: Option<ActorId>,
        expected: String,
        found: String,
    ) -> Divergence {
        let (name, mark) = (self.env.name(actor), self.env.last_mark());
        Divergence { actor, name, index, mark, kind: "stall", from, expected, found, turns: Vec::new() }
    }

    /// Waits until no turn runs: they end soon after a halt.
    pub(crate) fn settle(&self) {
        self.settle_within(Duration::MAX);
    }

    /// The same, at most for so long.
    pub(crate) fn settle_within(&self, time: Duration) {
        // A main thread that works alone is the only one to run turns, and it is here.
        let others = self.threads.is_some() && self.threads() > 0;
        let end = self.env.clock.now().saturating_add(nanoseconds(time));
        while others && self.env.scheduler.busy(self.env.halted()) && self.env.clock.now() < end {
            std::thread::park_timeout(Duration::from_micros(100));
        }
    }

    /// Goes on after [`Until`] stopped the replay, to another place or to the end.
    pub fn resume(&mut self, until: Option<Until>) {
        self.settle();
        self.env.set_until(until);
        self.set_limits(|_| u64::MAX);
        self.env.go_on();
    }

    fn set_limits(&self, limit: impl Fn(usize) -> u64) {
        let actors = self.actors().iter().zip(self.nodes.iter()).enumerate();
        for (actor, (_, node)) in actors.filter(|(_, (info, _))| info.class.is_some()) {
            let link = node.link();
            link.limit.store(limit(actor), Ordering::SeqCst);
            // Whoever waited at its limit looks again.
            link.raise(signal::FLUSH, &self.thread);
        }
    }

    /// Makes exactly the deliveries of `cut` (how many to each actor, by identity) that are not made yet. True if they
    /// were made: a cut that ends between a message and its cause cannot be reached, nor can one behind the replay.
    ///
    /// Other threads begin as soon as the system is built: give it none, or an [`Until`], to be before the cut here.
    pub fn run_to(&mut self, cut: &[u64]) -> bool {
        self.run_within(cut, None);
        let positions = self.positions();
        positions.iter().zip(cut).all(|((deliveries, _), end)| deliveries == end)
    }

    /// The same, stopping at `until` if that comes before.
    pub fn run_within(&mut self, cut: &[u64], until: Option<Until>) {
        self.settle();
        self.env.set_until(until);
        self.set_limits(|actor| cut.get(actor).copied().unwrap_or(0));
        self.env.go_on();
        self.pump(Limit::IDLE);
    }

    /// Makes one delivery and returns its actor; none if there is none to make. Of the actors that can go on, the one
    /// goes that has the least of its recording behind it, so steps come about as they came when it was recorded, and
    /// in the same order wherever one begins. Where `within` is given, no actor goes beyond it.
    pub fn step(&mut self, within: Option<&[u64]>) -> Option<ActorId> {
        self.settle();
        let before: Vec<u64> = self.positions().into_iter().map(|(deliveries, _)| deliveries).collect();
        // First all that have not started do so.
        self.run_to(&before);
        let end = |actor: usize| {
            let recorded = self.env.trace.as_ref().map_or(0, |trace| trace.deliveries(ActorId(actor as u32)));
            recorded.min(within.and_then(|cut| cut.get(actor).copied()).unwrap_or(u64::MAX))
        };
        let recorded = |actor: usize| {
            self.env.trace.as_ref().map_or(1, |trace| trace.deliveries(ActorId(actor as u32))).max(1)
        };
        let mut order: Vec<usize> = (0..before.len()).filter(|actor| before[*actor] < end(*actor)).collect();
        order.sort_by(|a, b| {
            let behind =
                |actor: usize, other: usize| u128::from(before[actor] + 1) * u128::from(recorded(other));
            behind(*a, *b).cmp(&behind(*b, *a)).then(a.cmp(b))
        });
        for actor in order {
            let mut cut = before.clone();
            cut[actor] += 1;
            if self.run_to(&cut) || self.diverged() {
                return Some(ActorId(actor as u32));
            }
        }
        None
    }
}
