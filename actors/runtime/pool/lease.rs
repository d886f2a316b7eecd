//! Leases of jobs: a worker that hangs loses its job to another one, and what it says of it later is not heard.
//!
//! A copy of the job that a worker is at lies where others can take it, and whoever takes it has the job: the worker
//! itself, when it [claims](crate::Cx::claim) what it found, or the pool, which looks for leases that are over and hands
//! their jobs on. That a claim came too late is recorded; in replay each attempt goes to its own worker at once.

use crossbeam_utils::atomic::AtomicCell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};

use super::{Entry, Job, Place, Shared};
use crate::actor::seat::Lease;
use crate::journal::Journal;
use crate::message::incident::Incident;
use crate::scheduler::ThreadCx;
use crate::scheduler::timer::Alarm;

/// A worker's hold on the job it is at.
pub(super) struct Hold<J> {
    lent: AtomicCell<Option<Box<Entry<J>>>>,
    /// When the lease is over, in nanoseconds; 0 where there is none.
    until: AtomicU64,
    claim: AtomicU8,
    /// Whether it is lent, and not only shared.
    is_lent: AtomicBool,
    /// As [`Entry::rival`].
    rival: AtomicCell<Option<Arc<AtomicBool>>>,
}

const UNCLAIMED: u8 = 0;
const KEPT: u8 = 1;
const LOST: u8 = 2;

impl<J> Hold<J> {
    pub(super) fn new() -> Self {
        Self {
            lent: AtomicCell::new(None),
            until: AtomicU64::new(0),
            claim: AtomicU8::new(KEPT),
            is_lent: AtomicBool::new(false),
            rival: AtomicCell::new(None),
        }
    }

    /// The worker begins a job that nobody takes from it, unless who has it too is done first.
    pub(super) fn own(&self, entry: &Entry<J>) {
        self.claim.store(if entry.rival.is_some() { UNCLAIMED } else { KEPT }, Ordering::Relaxed);
        self.is_lent.store(false, Ordering::Relaxed);
        self.rival.store(entry.rival.clone());
    }

    /// It begins one of which the recording says whether it was taken.
    pub(super) fn replay(&self) {
        self.claim.store(UNCLAIMED, Ordering::Relaxed);
    }

    /// It begins this one, which is its own until then.
    pub(super) fn lend(&self, entry: Entry<J>, until: u64) {
        self.claim.store(UNCLAIMED, Ordering::Relaxed);
        self.is_lent.store(true, Ordering::Relaxed);
        self.rival.store(entry.rival.clone());
        self.until.store(until, Ordering::SeqCst);
        self.lent.store(Some(Box::new(entry)));
    }
}

/// The job that a worker is at.
pub(super) struct AtHand<'a, J: Job> {
    pub place: &'a Place<J>,
    pub shared: &'a Shared<J>,
    pub epoch: u64,
    pub id: u64,
    pub attempt: u32,
}

impl<J: Job> Lease for AtHand<'_, J> {
    fn claim(&self, journal: &mut Journal) -> bool {
        self.place.claim(self.shared, journal)
    }

    fn keep(&self) -> (u64, u32) {
        if let Some(keeping) = &self.place.keeping {
            keeping.asked.store(true, Ordering::Relaxed);
        }
        (self.id, self.attempt)
    }

    fn is_wanted(&self) -> bool {
        self.epoch >= self.shared.epoch.load(Ordering::Relaxed)
    }
}

impl<J: Job> Place<J> {
    /// As [`Lease::claim`].
    pub(super) fn claim(&self, shared: &Shared<J>, journal: &mut Journal) -> bool {
        let Hold { lent, until, claim, is_lent, rival } = &self.hold;
        if claim.load(Ordering::Relaxed) == UNCLAIMED {
            let kept = journal.keeps_lease(|| {
                let kept = !is_lent.load(Ordering::Relaxed) || lent.take().is_some();
                until.store(0, Ordering::SeqCst);
                // Whoever took the job from this worker has the rival's word, too.
                kept && shared.is_first(rival.take().as_deref())
            });
            claim.store(if kept { KEPT } else { LOST }, Ordering::Relaxed);
        }
        claim.load(Ordering::Relaxed) == KEPT
    }
}

/// Looks for leases that are over.
struct Watch<J: Job>(Arc<Shared<J>>);

impl<J: Job> Alarm for Watch<J> {
    fn fire(&self, _timer: u32, thread: &ThreadCx) {
        let Self(shared) = self;
        let now = shared.env.scheduler.clock.now();
        // A lease that begins from here on sees to being watched, or is seen below.
        shared.watched.store(false, Ordering::SeqCst);
        let mut next = u64::MAX;
        for place in shared.places() {
            match place.hold.until.load(Ordering::SeqCst) {
                0 => {}
                until if until <= now => shared.expire(place, until, thread),
                until => next = next.min(until),
            }
        }
        if next != u64::MAX {
            shared.watch(next);
        }
    }

    fn is_of_an_actor(&self) -> bool {
        false
    }
}

impl<J: Job> Shared<J> {
    /// Looks after the leases at this time, unless that is seen to.
    pub(super) fn watch(self: &Arc<Self>, time: u64) {
        if !self.watched.swap(true, Ordering::SeqCst)
            && self.env.scheduler.timers.start(time, 0, Arc::new(Watch(Arc::clone(self))))
        {
            self.env.scheduler.notify();
        }
    }

    /// Takes the job from the worker whose lease ends at `until`, and hands it on.
    ///
    /// Should the worker have begun another one in between, it is that one which it loses: done twice, told once.
    pub(super) fn expire(&self, place: &Place<J>, until: u64, thread: &ThreadCx) {
        let Some(entry) = place.hold.lent.take() else { return };
        let _ = place.hold.until.compare_exchange(until, 0, Ordering::SeqCst, Ordering::SeqCst);
        let (env, id) = (&self.env, place.link.id);
        let name = place.link.name.clone();
        env.scheduler.note(Incident::LeaseLost { actor: id, name, job: entry.id });
        env.scheduler.free_slot_of(&place.link);
        self.requeued.fetch_add(1, Ordering::Relaxed);
        self.waiting.fetch_add(1, Ordering::Relaxed);
        // What was meant for it alone would wait as long as it hangs.
        place.away.store(true, Ordering::SeqCst);
        self.give_back(place, thread);
        self.hand_on(Entry { attempt: entry.attempt + 1, ..*entry }, place.number, thread);
    }
}
