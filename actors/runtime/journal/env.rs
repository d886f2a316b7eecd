//! What the journals of one system share: how it is driven and recorded, where replay stops, and what ends it.

use crossbeam_queue::ArrayQueue;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};

use crate::journal::Journal;
use crate::journal::divergence::{Divergence, Said, Until};
use crate::journal::faults::{FaultKind, Faults};
use crate::journal::observe::{Delivery, Observer};
use crate::log::fingerprint::Fingerprint;
use crate::log::format::{Hashing, NodeInfo};
use crate::log::reader::Trace;
use crate::log::writer::LogQueue;
use crate::message::ActorId;
use crate::message::incident::{Incident, guarded};
use crate::scheduler::{Scheduler, ThreadCx};

/// Tells the supervisor; false if it has no room.
type Supervisor = Box<dyn Fn(&mut Journal, &ThreadCx, Incident) -> bool + Send + Sync>;

#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Driven {
    Live,
    Replay,
    Simulated,
}

/// What the journals of one system share.
pub(crate) struct Env {
    pub(crate) scheduler: Arc<Scheduler>,
    pub(crate) seed: u64,
    pub(crate) hashing: Hashing,
    pub(crate) observer: Option<Observer>,
    pub(crate) listen_to: Option<(ActorId, u64)>,
    heard: OnceLock<Vec<Said>>,
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
    divergences: ArrayQueue<(Divergence, bool)>,
    mark_kind: AtomicU32,
    mark_value: AtomicU64,
    marks_made: AtomicU64,
}

/// How a system's journals are to be kept.
pub(crate) struct Terms {
    pub(crate) driven: Driven,
    pub(crate) seed: u64,
    pub(crate) hashing: Hashing,
    pub(crate) observer: Option<Observer>,
    pub(crate) listen_to: Option<(ActorId, u64)>,
    pub(crate) records: bool,
    pub(crate) trace: Option<Arc<Trace>>,
    pub(crate) until: Option<Until>,
    pub(crate) faults: Faults,
    /// What recorded here would say of program and machine.
    pub(crate) here: Fingerprint,
}

impl Env {
    pub(crate) fn new(terms: Terms, scheduler: Scheduler) -> Self {
        let Terms { driven, seed, hashing, observer, listen_to, records, trace, until, faults, here } = terms;
        let hashing = match &trace {
            Some(trace) => trace.header().hashing,
            None if driven == Driven::Live && !records => Hashing::Off,
            None => hashing,
        };
        let env = Self {
            divergences: ArrayQueue::new(2 * (scheduler.threads() + 1)),
            scheduler: Arc::new(scheduler),
            seed: trace.as_ref().map_or(seed, |trace| trace.header().seed),
            hashing,
            observer,
            listen_to,
            heard: OnceLock::new(),
            log: records.then(|| Arc::new(LogQueue::new())),
            driven,
            foreign: trace.as_ref().and_then(|trace| trace.header().fingerprint.difference(&here)),
            pops: trace.as_ref().map(|trace| trace.pops()).unwrap_or_default(),
            trace,
            until_tag: AtomicU32::new(0),
            until_who: AtomicU32::new(0),
            until_count: AtomicU64::new(0),
            faults,
            supervisor: OnceLock::new(),
            nodes: OnceLock::new(),
            ended: OnceLock::new(),
            observer_broke: AtomicBool::new(false),
            closed: AtomicBool::new(false),
            mark_kind: AtomicU32::new(u32::MAX),
            mark_value: AtomicU64::new(0),
            marks_made: AtomicU64::new(0),
        };
        env.set_until(until);
        env
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

    /// Replay went wrong: in what reached an actor, or `of_state`, in what it made of it.
    pub(crate) fn diverged(&self, divergence: Divergence, of_state: bool) {
        let _ = self.divergences.push((divergence, of_state));
        self.scheduler.halt();
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
            self.scheduler.halt();
        }
    }

    pub(crate) fn stop_at_delivery(&self, actor: ActorId, index: u64) {
        if self.until_tag.load(Ordering::Relaxed) == 2
            && self.until_who.load(Ordering::Relaxed) == actor.0
            && self.until_count.load(Ordering::Relaxed) == index
        {
            self.scheduler.halt();
        }
    }

    /// Stands at once where so many deliveries are behind what it was to stop at.
    pub(crate) fn stop_behind(&self, positions: &[u64]) {
        let made = positions.get(self.until_who.load(Ordering::Relaxed) as usize);
        let is_behind = made.is_some_and(|made| *made > self.until_count.load(Ordering::Relaxed));
        if self.until_tag.load(Ordering::Relaxed) == 2 && is_behind {
            self.scheduler.halt();
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
                self.scheduler.note(Incident::Beside { what: "the supervisor's hook".to_owned(), message });
                self.end(incident);
            }
        }
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

    /// Keeps what was said in the delivery of which it was asked.
    pub(crate) fn hear(&self, said: Vec<Said>) {
        let _ = self.heard.set(said);
    }

    pub(crate) fn heard(&self) -> Option<&[Said]> {
        self.heard.get().map(Vec::as_slice)
    }

    /// Shows a delivery to the observer.
    pub(crate) fn observe(&self, delivery: &Delivery<'_>) {
        let Some(observer) = &self.observer else { return };
        if self.observer_broke.load(Ordering::Relaxed) {
            return;
        }
        if let Err(message) = guarded(|| observer(delivery)) {
            self.observer_broke.store(true, Ordering::Relaxed);
            self.scheduler.note(Incident::Beside { what: "the observer".to_owned(), message });
        }
    }
}
