//! Who sleeps and whom to wake, without a lock: a bitmap of threads that are about to park.
//!
//! A thread announces itself ([`EventCount::prepare`]), looks for work once more, and only then parks. A producer puts
//! its work in place and then takes one announced thread out of the bitmap ([`EventCount::notify_one`]). Both sides put
//! a sequentially consistent fence between their two steps, so either the thread sees the work or the producer sees the
//! thread. Waking a thread that did not park after all leaves a token which makes its next park return at once: it
//! looks for work once too often, never once too little.

use crate::sync::{AtomicU64, Ordering, fence};

/// The bitmap; at most 64 threads.
#[derive(Debug)]
pub(crate) struct EventCount {
    waiting: AtomicU64,
}

impl EventCount {
    pub(crate) fn new() -> Self {
        Self { waiting: AtomicU64::new(0) }
    }

    /// Announces that `thread` is about to park. The caller looks for work after this and before it parks.
    pub(crate) fn prepare(&self, thread: usize) {
        self.waiting.fetch_or(1 << thread, Ordering::SeqCst);
        fence(Ordering::SeqCst);
    }

    /// `thread` is awake again, or found work and does not park.
    pub(crate) fn cancel(&self, thread: usize) {
        self.waiting.fetch_and(!(1 << thread), Ordering::SeqCst);
    }

    /// The work is in place; returns the thread to unpark, if any waits.
    #[inline]
    pub(crate) fn notify_one(&self) -> Option<usize> {
        fence(Ordering::SeqCst);
        let mut waiting = self.waiting.load(Ordering::Relaxed);
        while waiting != 0 {
            let thread = waiting.trailing_zeros() as usize;
            let before = self.waiting.fetch_and(!(1 << thread), Ordering::SeqCst);
            if before & (1 << thread) != 0 {
                return Some(thread);
            }
            waiting = before & !(1 << thread);
        }
        None
    }
}
