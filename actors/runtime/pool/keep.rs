//! Jobs that a worker keeps, and ends in later turns: what it knows of the end comes from elsewhere, as messages.
//!
//! They lie at its place in the pool until it says what became of them. Whether it was first with a job that it shared is
//! recorded; all else follows from its messages.

use crossbeam_utils::atomic::AtomicCell;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::{Carried, Entry, Job, JobPool, Place, Shared};
use crate::actor::Cx;
use crate::message::Message;
use crate::scheduler::ThreadCx;

/// Names a job that a worker keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Kept(u64);

impl Kept {
    /// As a number, for whoever is told of it: no two jobs of a system have the same.
    pub fn number(self) -> u64 {
        self.0
    }
}

/// Jobs by their identity.
type Jobs<J> = BTreeMap<u64, Entry<J>>;

/// The jobs that one worker keeps. Only that worker's turns come here.
pub(super) struct Keeping<J> {
    jobs: AtomicCell<Option<Box<Jobs<J>>>>,
    /// Whether the job at hand is to be kept.
    pub(super) asked: AtomicBool,
}

impl<J> Default for Keeping<J> {
    fn default() -> Self {
        Self { jobs: AtomicCell::new(None), asked: AtomicBool::new(false) }
    }
}

impl<J> Keeping<J> {
    pub(super) fn look<R>(&self, look: impl FnOnce(&mut Jobs<J>) -> R) -> R {
        let mut jobs = self.jobs.take().unwrap_or_default();
        let seen = look(&mut jobs);
        self.jobs.store(Some(jobs));
        seen
    }

    pub(super) fn put(&self, entry: Entry<J>) {
        let (entry, _) = entry.split();
        self.look(|jobs| jobs.insert(entry.id, entry));
    }
}

impl<J: Job> Shared<J> {
    /// Whether who ends a job now is the first of those who have it. Live only.
    pub(super) fn is_first(&self, rival: Option<&AtomicBool>) -> bool {
        let first = rival.is_none_or(|done| !done.swap(true, Ordering::SeqCst));
        if !first {
            self.twice.fetch_sub(1, Ordering::Relaxed);
        }
        first
    }

    fn place_of(&self, actor: crate::message::ActorId) -> Option<&Arc<Place<J>>> {
        self.places().iter().find(|place| place.link.id == actor)
    }

    /// Gives a job that was kept back to all who do not keep jobs; where another one has it too, to nobody.
    fn give_up_kept(&self, entry: Entry<J>, thread: &ThreadCx) {
        self.kept.fetch_sub(1, Ordering::Relaxed);
        if self.env.replaying() {
            return;
        }
        if entry.rival.is_some() {
            self.twice.fetch_sub(1, Ordering::Relaxed);
            return;
        }
        self.requeued.fetch_add(1, Ordering::Relaxed);
        self.waiting.fetch_add(1, Ordering::Relaxed);
        self.put(Entry { attempt: entry.attempt + 1, ..entry }, thread);
    }

    pub(super) fn hand_back_all(&self, keeping: &Keeping<J>, thread: &ThreadCx) {
        for (_, entry) in keeping.look(std::mem::take) {
            self.give_up_kept(entry, thread);
        }
    }
}

/// For workers that [keep](crate::Worker::KEEPS) jobs.
impl<M: Message> Cx<'_, M> {
    /// Keeps the job at hand: it is not over with this turn, and ends with [`Cx::finish`] or [`Cx::hand_back`].
    ///
    /// # Panics
    /// Without a job at hand.
    pub fn keep(&mut self) -> Kept {
        Kept(self.lease.expect("a job is at hand").keep().0)
    }

    /// A job that this worker keeps.
    pub fn kept<J: Job>(&self, pool: &JobPool<J>, job: Kept) -> Option<Arc<J>> {
        let keeping = pool.shared.place_of(self.journal.id)?.keeping.as_ref()?;
        keeping.look(|jobs| match jobs.get(&job.0).map(|entry| &entry.job) {
            Some(Carried::Shared(job)) => Some(Arc::clone(job)),
            _ => None,
        })
    }

    /// Whether the epoch of a job that this worker keeps has passed, by now. Recorded.
    pub fn is_stale<J: Job>(&mut self, pool: &JobPool<J>, job: Kept) -> bool {
        let keeping = pool.shared.place_of(self.journal.id).and_then(|place| place.keeping.as_ref());
        let epoch =
            keeping.and_then(|keeping| keeping.look(|jobs| jobs.get(&job.0).map(|entry| entry.epoch)));
        let stale = epoch.is_some_and(|epoch| epoch < pool.shared.epoch.load(Ordering::Relaxed));
        self.observe(u64::from(stale)) != 0
    }

    /// The job has come to its end. False if this worker does not keep it, or another one, with whom it was shared, was
    /// first: then nobody is told of it.
    pub fn finish<J: Job>(&mut self, pool: &JobPool<J>, job: Kept) -> bool {
        let shared = &pool.shared;
        let taken = shared.place_of(self.journal.id).and_then(|place| place.keeping.as_ref());
        let Some(entry) = taken.and_then(|keeping| keeping.look(|jobs| jobs.remove(&job.0))) else {
            return false;
        };
        shared.kept.fetch_sub(1, Ordering::Relaxed);
        let first = self.journal.keeps_lease(|| shared.is_first(entry.rival.as_deref()));
        if first {
            shared.completed.fetch_add(1, Ordering::Relaxed);
        }
        first
    }

    /// Another worker, one that keeps no jobs, is to do this one.
    pub fn hand_back<J: Job>(&mut self, pool: &JobPool<J>, job: Kept) {
        let shared = &pool.shared;
        let taken = shared.place_of(self.journal.id).and_then(|place| place.keeping.as_ref());
        if let Some(entry) = taken.and_then(|keeping| keeping.look(|jobs| jobs.remove(&job.0))) {
            shared.give_up_kept(entry, self.thread);
        }
    }

    /// Another worker, one that keeps no jobs, may do this one as well; whoever is first with it [finishes](Cx::finish) it.
    /// Does nothing the second time.
    pub fn share<J: Job>(&mut self, pool: &JobPool<J>, job: Kept) {
        let shared = &pool.shared;
        if self.journal.replaying() {
            return;
        }
        let Some(keeping) = shared.place_of(self.journal.id).and_then(|place| place.keeping.as_ref()) else {
            return;
        };
        let copy = keeping.look(|jobs| {
            let mut entry = jobs.remove(&job.0)?;
            if entry.rival.is_some() {
                jobs.insert(job.0, entry);
                return None;
            }
            entry.rival = Some(Arc::default());
            let (own, other) = entry.split();
            jobs.insert(job.0, own);
            Some(Entry { attempt: other.attempt + 1, ..other })
        });
        if let Some(copy) = copy {
            shared.twice.fetch_add(1, Ordering::Relaxed);
            shared.waiting.fetch_add(1, Ordering::Relaxed);
            shared.put(copy, self.thread);
        }
    }
}
