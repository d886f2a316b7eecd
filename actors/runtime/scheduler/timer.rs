//! Timers: a heap that whichever thread finds it due takes, serves and puts back.
//!
//! A timer that fires becomes a delivery of its own actor; the message it carries stays with the actor until then.

use crossbeam_queue::SegQueue;
use crossbeam_utils::atomic::AtomicCell;
use std::cmp::{Ordering as Order, Reverse};
use std::collections::BinaryHeap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::scheduler::{Scheduler, ThreadCx};

/// Timers one actor may have running (cancelled ones count until their time).
pub const TIMERS_PER_ACTOR: usize = 64;

/// The mailbox side of a timer.
pub(crate) trait Alarm: Send + Sync {
    fn fire(&self, timer: u32, thread: &ThreadCx);

    /// Whether an actor waits for it: a system is not at rest while such a timer runs.
    fn is_of_an_actor(&self) -> bool {
        true
    }
}

struct Entry {
    deadline: u64,
    order: u64,
    timer: u32,
    target: Arc<dyn Alarm>,
}

impl PartialEq for Entry {
    fn eq(&self, other: &Self) -> bool {
        self.order == other.order
    }
}

impl Eq for Entry {}

impl PartialOrd for Entry {
    fn partial_cmp(&self, other: &Self) -> Option<Order> {
        Some(self.cmp(other))
    }
}

impl Ord for Entry {
    fn cmp(&self, other: &Self) -> Order {
        (self.deadline, self.order).cmp(&(other.deadline, other.order))
    }
}

type Heap = BinaryHeap<Reverse<Entry>>;

/// All running timers of a system.
pub(crate) struct Timers {
    /// Timers not yet in the heap; bounded by [`TIMERS_PER_ACTOR`] for each actor.
    arriving: SegQueue<Entry>,
    heap: AtomicCell<Option<Box<Heap>>>,
    /// No timer is due before this, in nanoseconds.
    next: AtomicU64,
    order: AtomicU64,
}

impl Timers {
    pub(crate) fn new() -> Self {
        Self {
            arriving: SegQueue::new(),
            heap: AtomicCell::new(Some(Box::default())),
            next: AtomicU64::new(u64::MAX),
            order: AtomicU64::new(0),
        }
    }

    /// Starts a timer. Returns whether it is due before all others, so that a sleeping thread must look again.
    pub(crate) fn start(&self, deadline: u64, timer: u32, target: Arc<dyn Alarm>) -> bool {
        let order = self.order.fetch_add(1, Ordering::Relaxed);
        self.arriving.push(Entry { deadline, order, timer, target });
        self.next.fetch_min(deadline, Ordering::SeqCst) > deadline
    }

    /// When the next timer is due; `u64::MAX` without any.
    #[inline]
    pub(crate) fn next(&self) -> u64 {
        self.next.load(Ordering::SeqCst)
    }

    /// Fires what is due at `now`, unless another thread is at it.
    pub(crate) fn serve(&self, now: u64, scheduler: &Scheduler, thread: &ThreadCx) {
        if now < self.next() {
            return;
        }
        let Some(mut heap) = self.heap.take() else { return };
        // Forget the old minimum before looking: a timer that starts from here on lowers it again by itself.
        self.next.store(u64::MAX, Ordering::SeqCst);
        while let Some(entry) = self.arriving.pop() {
            heap.push(Reverse(entry));
        }
        while heap.peek().is_some_and(|Reverse(entry)| entry.deadline <= now) {
            if let Some(Reverse(entry)) = heap.pop() {
                entry.target.fire(entry.timer, thread);
                if entry.target.is_of_an_actor() {
                    scheduler.timer_fired();
                }
            }
        }
        let next = heap.peek().map_or(u64::MAX, |Reverse(entry)| entry.deadline);
        self.heap.store(Some(heap));
        self.next.fetch_min(next, Ordering::SeqCst);
    }

    /// Forgets all timers.
    pub(crate) fn clear(&self) {
        while self.arriving.pop().is_some() {}
        self.heap.store(None);
    }
}
