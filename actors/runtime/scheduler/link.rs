//! An actor as the scheduler knows it: who it is, how it is scheduled and woken, and what it is ordered.

use crossbeam_utils::CachePadded;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64};

use crate::message::ActorId;
use crate::scheduler::activation::Activation;
use crate::scheduler::profile::Counters;
use crate::scheduler::signals::{Signals, signal};
use crate::scheduler::{Scheduler, ThreadCx};

/// How an actor is scheduled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Class {
    /// Short turns, on any thread.
    Light,
    /// Turns of milliseconds (jobs): on any thread, but at most `k − 1` at once on `k > 1` threads.
    Heavy,
    /// On the thread that built the system, inside [`crate::Runtime::pump`].
    Pinned,
}

/// Orders to an actor that need no room in its mailbox.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Control {
    /// Stop after the turn at hand; what still waits becomes dead letters. For a stop without loss, drain first.
    Stop,
    /// Deliver nothing until told to resume; the mailbox keeps filling.
    Pause,
    /// Go on where the pause began.
    Resume,
}

/// What the scheduler needs to know of an actor, whatever its messages are.
pub(crate) struct Link {
    pub(crate) id: ActorId,
    pub(crate) name: String,
    pub(crate) class: Class,
    pub(crate) activation: CachePadded<Activation>,
    pub(crate) signals: Signals,
    /// Stopped: accepts nothing more.
    pub(crate) closed: AtomicBool,
    /// Has log bytes that are not yet with the writer.
    pub(crate) unflushed: AtomicBool,
    /// A turn of it takes one of the places for heavy ones.
    pub(crate) in_slot: AtomicBool,
    /// Replay: nothing is delivered beyond so many deliveries.
    pub(crate) limit: AtomicU64,
    pub(crate) counters: Arc<Counters>,
    pub(crate) scheduler: Arc<Scheduler>,
}

impl Link {
    pub(crate) fn new(
        id: ActorId,
        name: String,
        class: Class,
        ring_turns: usize,
        scheduler: &Arc<Scheduler>,
    ) -> Self {
        Self {
            id,
            name,
            class,
            activation: CachePadded::new(Activation::new()),
            signals: Signals::new(),
            closed: AtomicBool::new(false),
            unflushed: AtomicBool::new(false),
            in_slot: AtomicBool::new(false),
            limit: AtomicU64::new(u64::MAX),
            counters: Arc::new(Counters::new(ring_turns)),
            scheduler: Arc::clone(scheduler),
        }
    }

    /// One more unit of work is in place.
    #[inline]
    pub(crate) fn wake(&self, thread: &ThreadCx) {
        if self.activation.add() {
            self.scheduler.activate(self.class, self.id.0, thread);
        }
    }

    /// Sets a signal; a signal that is already up says it all.
    pub(crate) fn raise(&self, bit: u32, thread: &ThreadCx) {
        if self.signals.raise(bit) {
            self.wake(thread);
            if bit & signal::WHILE_PAUSED != 0 && self.signals.unpark() {
                self.scheduler.activate(self.class, self.id.0, thread);
            }
        }
    }

    pub(crate) fn control(&self, control: Control, thread: &ThreadCx) {
        let bit = match control {
            Control::Stop => signal::STOP,
            Control::Pause => signal::PAUSE,
            Control::Resume => signal::RESUME,
        };
        self.raise(bit, thread);
    }
}
