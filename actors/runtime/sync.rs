//! The atomics of the protocols that are model-checked: the standard ones, or loom's under `--cfg loom`.

#[cfg(loom)]
pub(crate) use loom::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, AtomicUsize, Ordering, fence};
#[cfg(not(loom))]
pub(crate) use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, AtomicUsize, Ordering, fence};

/// What a queue of another crate orders by itself: what was done before a push comes before what is done after the pop.
/// Loom does not see into such a queue, so there it is said here; elsewhere this is nothing.
#[derive(Debug)]
pub(crate) struct QueueOrder {
    #[cfg(loom)]
    passes: AtomicUsize,
}

impl QueueOrder {
    pub(crate) fn new() -> Self {
        Self {
            #[cfg(loom)]
            passes: AtomicUsize::new(0),
        }
    }

    /// Call it before each push and each pop.
    #[inline]
    pub(crate) fn pass(&self) {
        #[cfg(loom)]
        self.passes.fetch_add(1, Ordering::AcqRel);
    }
}
