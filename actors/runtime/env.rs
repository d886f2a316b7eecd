//! What all parts of one system share.

use crossbeam_deque::Worker;
use crossbeam_queue::ArrayQueue;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};

use crate::actor::Delivery;
use crate::actor::supervise::{Incident, guarded};
use crate::journal::Journal;
use crate::log::fingerprint::Fingerprint;
use crate::log::format::{Hashing, NodeInfo};
use crate::log::reader::Trace;
use crate::log::writer::LogQueue;
use crate::message::ActorId;
use crate::replay::snapshot::Snapshot;
use crate::replay::{Divergence, Until};
use crate::runtime::config::{Budget, Config, Mode, Observer, Record};
use crate::scheduler::clock::Clock;
use crate::scheduler::timer::Timers;
use crate::scheduler::{Scheduler, ThreadCx};
use crate::simulate::{FaultKind, Faults, Simulation};

/// Tells the supervisor; false if it has no room.
type Supervisor = Box<dyn Fn(&mut Journal, &ThreadCx, Incident) -> bool + Send + Sync>;

#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Driven {
    Live,
    Replay,
    Simulated,
}

/// What all parts of one system share.
pub(crate) struct Env {
    pub(crate) clock: Clock,
    pub(crate) scheduler: Scheduler,
    pub(crate) timers: Timers,
    pub(crate) seed: u64,
    pub(crate) hashing: Hashing,
    pub(crate) budget: Budget,
    pub(crate) observer: Option<Observer>,
    pub(crate) log: Option<Arc<LogQueue>>,
    driven: Driven,
    pub(crate) trace: Option<Arc<Trace>>,
    /// Replay: what is different here from where the recording was made.
    pub(crate) foreign: Option<String>,
    pops: Vec<(u64, u32, ActorId)>,
    until_tag: AtomicU32,
    until_who: AtomicU32,
    until_count: AtomicU64,
    faults: Faults,
    pub(crate) supervisor: OnceLock<Supervisor>,
    nodes: OnceLock<Vec<NodeInfo>>,
    /// What ends the system.
    ended: OnceLock<Incident>,
    observer_broke: AtomicBool,
    closed: AtomicBool,
    halted: AtomicBool,
    divergences: ArrayQueue<(Divergence, bool)>,
    mark_kind: AtomicU32,
    mark_value: AtomicU64,
    marks_made: AtomicU64,
}

/// The parts of a configuration that are used up while a system is built.
pub(crate) struct Parts {
    pub(crate) locals: Vec<Worker<u32>>,
    pub(crate) gives_way: bool,
    pub(crate) record: Option<Record>,
    pub(crate) program: String,
    pub(crate) application: Vec<u8>,
    pub(crate) ring_turns: usize,
    pub(crate) simulation: Option<Simulation>,
    pub(crate) from: Option<Arc<Snapshot>>,
}

impl Env {
    pub(crate) fn new(config: Config) -> (Self, Parts) {
        let Config {
            threads,
            gives_way,
            mode,
            record,
            hashing,
            program,
            application,
            seed,
            budget,
            ring_turns,
            observer,
            from,
            waker,
        } = config;
        let log = record.as_ref().map(|_| Arc::new(LogQueue::new()));
        let (driven, trace, until, simulation) = match mode {
            Mode::Live => (Driven::Live, None, None, None),
            Mode::Replay { trace, until } => (Driven::Replay, Some(trace), until, None),
            Mode::Simulate(simulation) => (Driven::Simulated, None, None, Some(simulation)),
        };
        let simulated = driven == Driven::Simulated;
        let hashing = match (&trace, driven) {
            (Some(trace), _) => trace.header().hashing,
            (None, Driven::Live) if log.is_none() => Hashing::Off,
            _ => hashing,
        };
        let (scheduler, locals) = Scheduler::new(if simulated { 0 } else { threads }, waker);
        let budget = if simulated { Budget { messages: 1, nanoseconds: u64::MAX } } else { budget };
        let env = Self {
            clock: simulation.as_ref().map_or_else(Clock::real, |s| Clock::starting_at_zero(s.work, s.seed)),
            scheduler,
            timers: Timers::new(),
            seed: trace.as_ref().map_or(seed, |trace| trace.header().seed),
            hashing,
            budget,
            observer,
            log,
            driven,
            foreign: trace
                .as_ref()
                .and_then(|trace| trace.header().fingerprint.difference(&Fingerprint::here(&program))),
            pops: trace.as_ref().map(|trace| trace.pops()).unwrap_or_default(),
            trace,
            until_tag: AtomicU32::new(0),
            until_who: AtomicU32::new(0),
            until_count: AtomicU64::new(0),
            faults: simulation.as_ref().map_or(Faults::NONE, |simulation| simulation.faults.clone()),
            supervisor: OnceLock::new(),
            nodes: OnceLock::new(),
            ended: OnceLock::new(),
            observer_broke: AtomicBool::new(false),
            closed: AtomicBool::new(false),
            halted: AtomicBool::new(false),
            divergences: ArrayQueue::new(2 * (threads + 1)),
            mark_kind: AtomicU32::new(u32::MAX),
            mark_value: AtomicU64::new(0),
            marks_made: AtomicU64::new(0),
        };
        env.set_until(until);
        (env, Parts { locals, gives_way, record, program, application, ring_turns, simulation, from })
    }

    /// Says where replay stops; only while nothing runs.
    pub(crate) fn set_until(&self, until: Option<Until>) {
        let (tag, who, count) = match until {
            None => (0, 0, 0),
            Some(Until::Mark { kind, count }) => (1, kind, count),
            Some(Until::Delivery { actor, index }) => (2, actor.0, index),
        };
        self.until_who.store(who, Ordering::SeqCst);
        self.until_count.store(count, Ordering::SeqCst);
        self.until_tag.store(tag, Ordering::SeqCst);
    }

    pub(crate) fn nodes(&self) -> &[NodeInfo] {
        self.nodes.get().map_or(&[], |nodes| nodes)
    }

    pub(crate) fn set_nodes(&self, nodes: Vec<NodeInfo>) {
        let _ = self.nodes.set(nodes);
    }

    pub(crate) fn close(&self) {
        self.closed.store(true, Ordering::SeqCst);
    }

    pub(crate) fn go_on(&self) {
        self.halted.store(false, Ordering::SeqCst);
        self.scheduler.notify_all();
    }

    pub(crate) fn name(&self, id: ActorId) -> String {
        self.nodes
            .get()
            .and_then(|nodes| nodes.get(id.0 as usize))
            .map_or_else(|| id.to_string(), |node| node.name.clone())
    }

    #[inline]
    pub(crate) fn replaying(&self) -> bool {
        self.driven == Driven::Replay
    }

    pub(crate) fn simulated(&self) -> bool {
        self.driven == Driven::Simulated
    }

    pub(crate) fn effects(&self) -> bool {
        self.driven == Driven::Live
    }

    pub(crate) fn recording(&self) -> bool {
        self.log.as_ref().is_some_and(|log| !log.is_stopped())
    }

    pub(crate) fn stop_recording(&self, reason: String) {
        if let Some(log) = &self.log {
            log.stop(reason);
        }
    }

    pub(crate) fn closed(&self) -> bool {
        self.closed.load(Ordering::Acquire)
    }

    #[inline]
    pub(crate) fn halted(&self) -> bool {
        self.halted.load(Ordering::Relaxed)
    }

    pub(crate) fn halt(&self) {
        self.halted.store(true, Ordering::SeqCst);
        self.scheduler.notify_all();
    }

    /// Replay went wrong: in what reached an actor, or `of_state`, in what it made of it.
    pub(crate) fn diverged(&self, divergence: Divergence, of_state: bool) {
        let _ = self.divergences.push((divergence, of_state));
        self.halt();
    }

    pub(crate) fn has_diverged(&self) -> bool {
        !self.divergences.is_empty()
    }

    /// The divergence at which it began; call it when no turn runs.
    ///
    /// A turn that goes wrong may send before its state's hash is compared, so that another thread can meet the wrong
    /// message first. That one stops; the sender's turn, ending, adds its own, and what was made wrong comes before
    /// what was received so.
    pub(crate) fn first_divergence(&self) -> Option<Divergence> {
        let mut all: Vec<_> = std::iter::from_fn(|| self.divergences.pop()).collect();
        all.sort_by_key(|(_, of_state)| !of_state);
        let first = all.into_iter().next()?;
        let _ = self.divergences.push(first.clone());
        Some(first.0)
    }

    pub(crate) fn last_mark(&self) -> Option<(u32, u64)> {
        let kind = self.mark_kind.load(Ordering::Relaxed);
        (kind != u32::MAX).then(|| (kind, self.mark_value.load(Ordering::Relaxed)))
    }

    pub(crate) fn set_last_mark(&self, kind: u32, value: u64) {
        self.mark_kind.store(kind, Ordering::Relaxed);
        self.mark_value.store(value, Ordering::Relaxed);
    }

    pub(crate) fn marked(&self, kind: u32, value: u64) {
        self.set_last_mark(kind, value);
        if self.until_tag.load(Ordering::Relaxed) == 1
            && self.until_who.load(Ordering::Relaxed) == kind
            && self.marks_made.fetch_add(1, Ordering::Relaxed) + 1 == self.until_count.load(Ordering::Relaxed)
        {
            self.halt();
        }
    }

    pub(crate) fn stop_at_delivery(&self, actor: ActorId, index: u64) {
        if self.until_tag.load(Ordering::Relaxed) == 2
            && self.until_who.load(Ordering::Relaxed) == actor.0
            && self.until_count.load(Ordering::Relaxed) == index
        {
            self.halt();
        }
    }

    pub(crate) fn popped_by(&self, id: u64, attempt: u32) -> Option<ActorId> {
        let index =
            self.pops.binary_search_by_key(&(id, attempt), |(id, attempt, _)| (*id, *attempt)).ok()?;
        Some(self.pops[index].2)
    }

    /// Deliveries at which an actor is to panic, sends which are to come back, and deliveries from which on it hangs at
    /// its next job.
    pub(crate) fn faults_of(&self, actor: ActorId) -> [VecDeque<u64>; 3] {
        let faults = self.faults.of(self.seed, actor);
        let of = |kind| {
            let mut at: Vec<u64> =
                faults.iter().filter(|fault| fault.kind == kind).map(|fault| fault.at).collect();
            at.sort_unstable();
            VecDeque::from(at)
        };
        [FaultKind::Panic, FaultKind::Full, FaultKind::Hang].map(of)
    }

    /// Tells the supervisor what an actor did.
    pub(crate) fn report(&self, journal: &mut Journal, thread: &ThreadCx, incident: Incident) {
        tracing::warn!("{incident}");
        self.scheduler.keep(incident.clone());
        let Some(supervisor) = self.supervisor.get() else { return };
        let told =
            guarded(|| journal.without_faults(|journal| supervisor(journal, thread, incident.clone())));
        match told {
            Ok(true) => {}
            // Who is never told of it may wait for ever.
            Ok(false) => self.end(incident),
            Err(message) => {
                self.note(Incident::Beside { what: "the supervisor's hook".to_owned(), message });
                self.end(incident);
            }
        }
    }

    /// Keeps what no actor did, for whoever asks.
    pub(crate) fn note(&self, incident: Incident) {
        self.scheduler.note(incident);
    }

    /// Ends the system in order because of this; the first one counts.
    pub(crate) fn end(&self, incident: Incident) {
        tracing::error!("{incident}: the system ends");
        let _ = self.ended.set(incident);
        self.scheduler.notify_main();
    }

    pub(crate) fn ended(&self) -> Option<&Incident> {
        self.ended.get()
    }

    /// Whether the main thread is to leave its pump: a replay goes on to where the recording ends, and so does an end.
    pub(crate) fn ends(&self) -> bool {
        self.ended.get().is_some() && !self.replaying() && !self.closed()
    }

    /// Shows a delivery to the observer.
    pub(crate) fn observe(&self, delivery: &Delivery<'_>) {
        let Some(observer) = &self.observer else { return };
        if self.observer_broke.load(Ordering::Relaxed) {
            return;
        }
        if let Err(message) = guarded(|| observer(delivery)) {
            self.observer_broke.store(true, Ordering::Relaxed);
            self.note(Incident::Beside { what: "the observer".to_owned(), message });
        }
    }
}
