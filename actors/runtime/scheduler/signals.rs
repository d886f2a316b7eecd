//! What an actor is told beside messages: a word of bits that can never overflow, and whether it is parked.
//!
//! A signal is one unit of work, as a message is ([`crate::scheduler::activation`]); raised again before it was taken, it says
//! nothing new. Pausing and resuming share one unit, since the newer of the two takes the older one's place.
//!
//! A paused actor is parked: work waits, it counts as active, and nobody runs it until something comes that gets
//! through to it. Whoever raises that and whoever parks the actor each write first and look at the other's word then,
//! with a sequentially consistent fence between, so that one of the two sees that the actor must go on.

use crate::sync::{AtomicBool, AtomicU32, Ordering, fence};

/// One bit for each kind of signal.
pub(crate) mod signal {
    pub(crate) const START: u32 = 1;
    pub(crate) const STOP: u32 = 1 << 1;
    pub(crate) const PAUSE: u32 = 1 << 2;
    pub(crate) const RESUME: u32 = 1 << 3;
    pub(crate) const TIMER: u32 = 1 << 4;
    pub(crate) const URGENT: u32 = 1 << 5;
    pub(crate) const JOBS: u32 = 1 << 6;
    pub(crate) const FLUSH: u32 = 1 << 7;
    /// First of the newest-only slots.
    pub(crate) const LATEST: u32 = 1 << 8;
    /// Orders.
    pub(crate) const CONTROL: u32 = STOP | PAUSE | RESUME;
    /// Orders of which only the newest stands.
    pub(crate) const PACE: u32 = PAUSE | RESUME;
    /// What gets through to a paused actor.
    pub(crate) const WHILE_PAUSED: u32 = CONTROL | FLUSH | START;
}

#[derive(Debug)]
pub(crate) struct Signals {
    bits: AtomicU32,
    parked: AtomicBool,
}

impl Signals {
    pub(crate) fn new() -> Self {
        Self { bits: AtomicU32::new(0), parked: AtomicBool::new(false) }
    }

    /// Sets a signal. True: it was not up, so the caller adds a unit of work, and asks [`Signals::unpark`] if it gets
    /// through to a paused actor.
    #[must_use]
    pub(crate) fn raise(&self, bit: u32) -> bool {
        if bit & signal::PACE == 0 {
            return self.bits.fetch_or(bit, Ordering::AcqRel) & bit == 0;
        }
        let newest = |bits: u32| Some(bits & !signal::PACE | bit);
        let before = self.bits.fetch_update(Ordering::AcqRel, Ordering::Acquire, newest);
        // What stood there and was not yet seen hands its unit of work on.
        before.unwrap_or_else(|bits| bits) & signal::PACE == 0
    }

    /// Whether one of these is up.
    #[inline]
    pub(crate) fn any(&self, mask: u32) -> bool {
        self.bits.load(Ordering::Acquire) & mask != 0
    }

    /// Takes those of `mask` that are up.
    pub(crate) fn take(&self, mask: u32) -> u32 {
        self.bits.fetch_and(!mask, Ordering::AcqRel) & mask
    }

    /// The actor is paused and its turn over. True: something that gets through came just now, and the actor must be
    /// queued again.
    #[must_use]
    pub(crate) fn park(&self) -> bool {
        self.parked.swap(true, Ordering::AcqRel);
        fence(Ordering::SeqCst);
        self.any(signal::WHILE_PAUSED) && self.parked.swap(false, Ordering::AcqRel)
    }

    /// What gets through is up. True: the actor was parked, and the caller must put it on a run queue.
    #[must_use]
    pub(crate) fn unpark(&self) -> bool {
        fence(Ordering::SeqCst);
        self.parked.swap(false, Ordering::AcqRel)
    }

    pub(crate) fn is_parked(&self) -> bool {
        self.parked.load(Ordering::Relaxed)
    }
}
