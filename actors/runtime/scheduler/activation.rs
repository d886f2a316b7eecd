//! When an actor is to be run: a counter of units of work that nobody has consumed yet.
//!
//! A sender first puts its message in place, then adds one unit; the sender that moves the counter from 0 to 1 puts
//! the actor on a run queue. Whoever runs the actor subtracts what it consumed only after all of the actor's state is
//! written back, so an actor runs on one thread at a time and the next one sees everything. The runner may consume a
//! message whose sender has not yet added its unit; it then owes that unit and settles it in its next turn.

use crate::sync::{AtomicUsize, Ordering};

/// The counter, shared by senders and runner.
#[derive(Debug)]
pub(crate) struct Activation {
    pending: AtomicUsize,
    /// Units consumed before they were added, or by a turn that goes on; only the runner touches it.
    owed: AtomicUsize,
}

impl Activation {
    pub(crate) fn new() -> Self {
        Self { pending: AtomicUsize::new(0), owed: AtomicUsize::new(0) }
    }

    /// Adds a unit for work that is already in place. True: the caller must put the actor on a run queue.
    #[inline]
    #[must_use]
    pub(crate) fn add(&self) -> bool {
        self.pending.fetch_add(1, Ordering::AcqRel) == 0
    }

    /// Begins a turn: what earlier turns consumed and did not settle.
    #[inline]
    pub(crate) fn owed(&self) -> usize {
        self.owed.load(Ordering::Relaxed)
    }

    /// Ends a turn that leaves work it knows of: the actor stays active, nothing is settled.
    #[inline]
    pub(crate) fn keep(&self, consumed: usize) {
        self.owed.store(consumed, Ordering::Relaxed);
    }

    /// Ends a turn that consumed `consumed` units, owed ones included; all state must be written back before. Returns
    /// whether the actor stays active (the runner must queue it again).
    #[inline]
    pub(crate) fn finish(&self, consumed: usize) -> bool {
        let settled = consumed.min(self.pending.load(Ordering::Acquire));
        self.owed.store(consumed - settled, Ordering::Relaxed);
        self.pending.fetch_sub(settled, Ordering::AcqRel) > settled
    }

    /// Units in place now: an upper bound of what waits.
    #[inline]
    pub(crate) fn pending(&self) -> usize {
        self.pending.load(Ordering::Relaxed)
    }
}
