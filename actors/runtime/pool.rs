//! Ready jobs: 64 priority buckets under a bitmap, popped by whichever worker is free.
//!
//! The pool decides nothing: whoever pushes chooses bucket (0 is popped first), epoch and size. Each pop is a delivery
//! of the worker that made it, so a recording knows who did what, and replay hands each job to the same worker.

pub(crate) mod bitmap;
mod heap;
mod keep;
mod lease;
mod seat;

use crossbeam_queue::SegQueue;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use crate::actor::seat::Seat;
use crate::actor::{Actor, Cx};
use crate::journal::Journal;
use crate::journal::divergence::{Held, Said};
use crate::journal::env::Env;
use crate::message::content::Content;
use crate::message::incident::{Incident, guarded};
use crate::message::saved::{Loader, Saver};
use crate::message::{ActorId, Digest, Message, Reason, Rejected};
use crate::scheduler::ThreadCx;
use crate::scheduler::clock::nanoseconds;
use crate::scheduler::eventcount::EventCount;
use crate::scheduler::link::Link;
use crate::scheduler::signals::signal;

pub use crate::actor::seat::KILLS_MAX;

use heap::{Carried, Entry, Heap};
use keep::Keeping;
pub use keep::Kept;
use lease::Hold;
use seat::SeatOf;

/// Priority buckets of a pool.
pub const BUCKETS: u8 = 64;

/// A job that is given up, as whoever [`crate::Wiring::gives_up`] names is told of it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeadJob<B> {
    /// Its identity.
    pub job: u64,
    /// The worker that had it last.
    pub worker: ActorId,
    /// What it was.
    pub brief: B,
    /// Why it is given up.
    pub why: Death,
}

/// Why a job is given up.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Death {
    /// [`KILLS_MAX`] workers had it, and this is what the last one panicked with.
    Panicked(String),
    /// [`KILLS_MAX`] workers had it, and the last one's lease was over before it had done with it.
    Expired,
}

/// Tells of a dead job; false if there is no room.
type Undertaker<B> = Box<dyn Fn(&mut Journal, &ThreadCx, DeadJob<B>) -> bool + Send + Sync>;

/// A piece of work that any worker of a pool can do.
pub trait Job: Send + Sync + 'static {
    /// What is told of a job that is given up: enough to know what is missing now.
    type Brief: fmt::Debug + Send + 'static;

    /// Adds the content to a hash, as [`Message::digest`].
    fn digest(&self, digest: &mut Digest);

    /// What the job is, for whoever is told if it is given up.
    fn brief(&self) -> Self::Brief;

    /// The variant's name, for reports.
    fn kind(&self) -> &'static str {
        "job"
    }

    /// Whether workers that [keep](Worker::KEEPS) jobs may take it; the others may take any.
    fn travels(&self) -> bool {
        false
    }

    /// What it says, as [`Message::content`].
    fn content(&self) -> Content {
        Content::Name(self.kind().into())
    }

    /// Writes the job for a snapshot, as [`Message::save`].
    fn save(&self, saver: &mut Saver) {
        saver.refuse();
    }

    /// Reads a job that was saved.
    fn restore(_loader: &mut Loader<'_>) -> Option<Self>
    where
        Self: Sized,
    {
        None
    }
}

/// An actor that takes jobs from a pool whenever its mailbox is empty.
pub trait Worker: Actor {
    /// What it does.
    type Job: Job;

    /// Whether it [keeps](Cx::keep) jobs, and ends them in later turns: whoever hands them to others that are not of this
    /// system, say. It is given only what [travels](Job::travels) and nobody handed back, and a pool with such a worker needs
    /// another one that does not keep.
    const KEEPS: bool = false;

    /// Whether it takes a job now. Asked before each, of workers that keep; not in replay.
    fn room(&self) -> bool {
        true
    }

    /// Does one job. If this panics, the job goes back and another worker does it. Where the pool
    /// [leases](crate::Wiring::leases) its jobs, ask [`Cx::claim`] before telling anybody what came of it.
    fn run(&mut self, job: &Self::Job, cx: &mut Cx<'_, Self::Msg>);

    /// Takes a job whose epoch has passed and which will not be done.
    fn stale(&mut self, _job: &Self::Job, _cx: &mut Cx<'_, Self::Msg>) {}
}

/// What a pool has seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PoolStats {
    /// Jobs accepted.
    pub pushed: u64,
    /// Jobs done, each counted once.
    pub completed: u64,
    /// Jobs dropped because their epoch had passed.
    pub stale: u64,
    /// Jobs given up.
    pub dead: u64,
    /// Times a job went back because its worker panicked or lost its lease.
    pub requeued: u64,
    /// Jobs that wait, those among them that were [shared](Cx::share).
    pub waiting: u64,
    /// Jobs that workers [keep](Cx::keep).
    pub kept: u64,
    /// Jobs that two have, because they were shared.
    pub twice: u64,
    /// Workers that take jobs.
    pub workers: u64,
    /// Simulation: jobs that were popped while a better one waited.
    pub disorder: u64,
}

/// One worker's place at a pool.
struct Place<J> {
    number: usize,
    link: Arc<Link>,
    /// Jobs meant for this worker: those that killed another one and, in replay, all that the script gives it.
    inbound: SegQueue<Entry<J>>,
    /// Takes no jobs: paused, stopped, or hanging.
    away: AtomicBool,
    hold: Hold<J>,
    /// Of a worker that keeps jobs, those.
    keeping: Option<Keeping<J>>,
}

struct Shared<J: Job> {
    env: Arc<Env>,
    /// For all workers.
    common: Heap<J>,
    /// For those that do not keep jobs, where others do.
    own: Heap<J>,
    base: AtomicU32,
    capacity: usize,
    waiting: AtomicUsize,
    epoch: AtomicU64,
    undertaker: OnceLock<Undertaker<J::Brief>>,
    arriving: SegQueue<Arc<Place<J>>>,
    places: OnceLock<Box<[Arc<Place<J>>]>>,
    /// Nanoseconds that a worker has for a job; none: as long as it takes.
    lease: OnceLock<u64>,
    watched: AtomicBool,
    idle: EventCount,
    idle_keepers: EventCount,
    keepers: AtomicUsize,
    kept: AtomicU64,
    twice: AtomicU64,
    workers: AtomicUsize,
    pushed: AtomicU64,
    completed: AtomicU64,
    stale: AtomicU64,
    dead: AtomicU64,
    requeued: AtomicU64,
    disorder: AtomicU64,
}

impl<J: Job> Shared<J> {
    /// What a snapshot keeps of a pool: in replay jobs wait with their workers.
    fn numbers(&self) -> [&AtomicU64; 6] {
        [&self.epoch, &self.pushed, &self.completed, &self.stale, &self.dead, &self.requeued]
    }

    fn places(&self) -> &[Arc<Place<J>>] {
        self.places.get().map_or(&[], |places| places)
    }

    fn put(&self, entry: Entry<J>, thread: &ThreadCx) {
        let travels = self.keepers.load(Ordering::Relaxed) == 0 || entry.attempt == 0 && entry.job.travels();
        let heap = if travels { &self.common } else { &self.own };
        heap.put(entry);
        self.wake(thread);
    }

    /// Whether something waits for a worker of this kind.
    fn is_empty_for(&self, keeps: bool) -> bool {
        self.common.is_empty() && (keeps || self.own.is_empty())
    }

    /// Wakes somebody for what waits: rather one that does the job than one that keeps it.
    fn wake(&self, thread: &ThreadCx) {
        let keeper = || if self.common.is_empty() { None } else { self.idle_keepers.notify_one() };
        if let Some(place) = self.idle.notify_one().or_else(keeper)
            && let Some(place) = self.places().iter().find(|other| other.number == place)
        {
            place.link.raise(signal::JOBS, thread);
        }
    }

    fn idle_of(&self, place: &Place<J>) -> &EventCount {
        if place.keeping.is_some() { &self.idle_keepers } else { &self.idle }
    }

    /// Replay: a job goes straight to those who popped it when the recording was made, all of them at once.
    fn route(&self, mut entry: Entry<J>, thread: &ThreadCx) {
        for attempt in 0..=KILLS_MAX {
            let Some(worker) = self.env.popped_by(entry.id, attempt) else { return };
            if let Some(place) = self.places().iter().find(|place| place.link.id == worker) {
                let (now, later) = entry.split();
                entry = later;
                place.inbound.push(Entry { attempt, ..now });
                place.link.raise(signal::JOBS, thread);
            }
        }
    }

    /// Gives a job that a worker did not come to the end of to the next one, or back to all if there is no other.
    fn hand_on(&self, entry: Entry<J>, from: usize, thread: &ThreadCx) {
        let places = self.places();
        let others = (1..places.len()).map(|step| &places[(from + step) % places.len()]);
        let works = |place: &&Arc<Place<J>>| place.keeping.is_none() && !place.away.load(Ordering::SeqCst);
        match others.into_iter().find(works) {
            Some(place) => {
                place.inbound.push(entry);
                place.link.raise(signal::JOBS, thread);
                if place.away.load(Ordering::SeqCst) {
                    self.give_back(place, thread);
                }
            }
            None => self.put(entry, thread),
        }
    }

    /// What was meant for a worker that went away is for all.
    fn give_back(&self, place: &Place<J>, thread: &ThreadCx) {
        while let Some(entry) = place.inbound.pop() {
            self.put(entry, thread);
        }
    }

    /// Gives a job up, and tells of it.
    fn bury(&self, entry: &Entry<J>, why: Death, journal: &mut Journal, thread: &ThreadCx) {
        self.dead.fetch_add(1, Ordering::Relaxed);
        let (job, worker) = (entry.id, journal.id);
        let told = guarded(|| {
            let dead = DeadJob { job, worker, brief: entry.job.brief(), why };
            tracing::warn!("given up: {dead:?}");
            let tell = |journal: &mut Journal| {
                self.undertaker.get().is_none_or(|undertaker| undertaker(journal, thread, dead))
            };
            journal.without_faults(tell)
        });
        // Whoever waits for its answer would wait for ever.
        let message = match told {
            Ok(true) => return,
            Ok(false) => "the mailbox of whoever is told is full".to_owned(),
            Err(message) => message,
        };
        self.env.end(Incident::JobLost { actor: worker, job, message });
    }

    fn take(&self, keeps: bool) -> Option<Entry<J>> {
        let base = self.base.load(Ordering::Relaxed);
        let entry = if keeps || self.own.is_empty() {
            self.common.take(base)?
        } else if self.own.rank(base) <= self.common.rank(base) {
            self.own.take(base).or_else(|| self.common.take(base))?
        } else {
            self.common.take(base).or_else(|| self.own.take(base))?
        };
        if self.env.simulated() {
            // Alone, the best is the best: on several threads a better one may come while this one is popped.
            let rank = (entry.bucket + 64 - base) % 64;
            let better = self.common.has_better(base, rank) || !keeps && self.own.has_better(base, rank);
            self.disorder.fetch_add(u64::from(better), Ordering::Relaxed);
        }
        Some(entry)
    }
}

/// A bounded pool of jobs. Clones share it.
pub struct JobPool<J: Job> {
    shared: Arc<Shared<J>>,
}

impl<J: Job> Clone for JobPool<J> {
    fn clone(&self) -> Self {
        Self { shared: Arc::clone(&self.shared) }
    }
}

impl<J: Job> JobPool<J> {
    pub(crate) fn new(env: &Arc<Env>, capacity: usize) -> Self {
        let shared = Shared {
            env: Arc::clone(env),
            common: Heap::new(),
            own: Heap::new(),
            base: AtomicU32::new(0),
            capacity,
            waiting: AtomicUsize::new(0),
            epoch: AtomicU64::new(0),
            undertaker: OnceLock::new(),
            arriving: SegQueue::new(),
            places: OnceLock::new(),
            lease: OnceLock::new(),
            watched: AtomicBool::new(false),
            idle: EventCount::new(),
            idle_keepers: EventCount::new(),
            keepers: AtomicUsize::new(0),
            kept: AtomicU64::new(0),
            twice: AtomicU64::new(0),
            workers: AtomicUsize::new(0),
            pushed: AtomicU64::new(0),
            completed: AtomicU64::new(0),
            stale: AtomicU64::new(0),
            dead: AtomicU64::new(0),
            requeued: AtomicU64::new(0),
            disorder: AtomicU64::new(0),
        };
        Self { shared: Arc::new(shared) }
    }

    /// What the pool has seen. Not for decisions inside an actor: it is not recorded.
    pub fn stats(&self) -> PoolStats {
        let shared = &self.shared;
        PoolStats {
            pushed: shared.pushed.load(Ordering::Relaxed),
            completed: shared.completed.load(Ordering::Relaxed),
            stale: shared.stale.load(Ordering::Relaxed),
            dead: shared.dead.load(Ordering::Relaxed),
            requeued: shared.requeued.load(Ordering::Relaxed),
            waiting: shared.waiting.load(Ordering::Relaxed) as u64,
            kept: shared.kept.load(Ordering::Relaxed),
            twice: shared.twice.load(Ordering::Relaxed),
            workers: shared.workers.load(Ordering::Relaxed) as u64,
            disorder: shared.disorder.load(Ordering::Relaxed),
        }
    }

    pub(crate) fn sit<A: Worker<Job = J>>(&self, link: &Arc<Link>) -> Box<dyn Seat<A>> {
        let number = self.shared.workers.fetch_add(1, Ordering::SeqCst);
        let place = Arc::new(Place {
            number,
            link: Arc::clone(link),
            inbound: SegQueue::new(),
            away: AtomicBool::new(false),
            hold: Hold::new(),
            keeping: A::KEEPS.then(Keeping::default),
        });
        self.shared.keepers.fetch_add(usize::from(A::KEEPS), Ordering::SeqCst);
        assert!(number < 64, "a pool has at most 64 workers");
        self.shared.arriving.push(Arc::clone(&place));
        Box::new(SeatOf {
            place,
            pool: self.clone(),
            left: AtomicBool::new(false),
            current: None,
            early: std::collections::BTreeMap::new(),
        })
    }

    /// Says how long a worker has for a job.
    pub(crate) fn lease(&self, time: Duration) {
        let _ = self.shared.lease.set(nanoseconds(time).max(1));
    }

    /// Says who is told of jobs that are given up.
    pub(crate) fn bury_with(&self, undertaker: Undertaker<J::Brief>) {
        let _ = self.shared.undertaker.set(undertaker);
    }

    /// All workers have their places.
    pub(crate) fn seal(&self) {
        let mut places = Vec::new();
        while let Some(place) = self.shared.arriving.pop() {
            places.push(place);
        }
        let _ = self.shared.places.set(places.into());
    }
}

impl<M: Message> Cx<'_, M> {
    /// Puts a job into a pool: `bucket` 0 is popped first, 63 last. Returns the job's identity, or the job itself if
    /// the pool is full.
    pub fn push<J: Job>(
        &mut self,
        pool: &JobPool<J>,
        bucket: u8,
        epoch: u64,
        job: J,
    ) -> Result<u64, Rejected<J>> {
        let shared = &pool.shared;
        let number = self.journal.next_send();
        let full = if self.journal.replaying() {
            self.journal.replays_rejection(number).is_some()
        } else {
            let full = self.journal.rejects_by_fault(number)
                || shared.waiting.fetch_add(1, Ordering::Relaxed) >= shared.capacity && {
                    shared.waiting.fetch_sub(1, Ordering::Relaxed);
                    true
                };
            if full {
                self.journal.record_rejection(number, Reason::Full);
            }
            full
        };
        if full {
            return Err(Rejected { message: job, reason: Reason::Full });
        }
        shared.pushed.fetch_add(1, Ordering::Relaxed);
        let id = self.journal.next_job();
        let bucket = (u32::from(bucket.min(BUCKETS - 1)) + shared.base.load(Ordering::Relaxed)) % 64;
        let pushed_in = self.journal.index;
        let entry = Entry { id, attempt: 0, epoch, bucket, pushed_in, job: Carried::Alone(job), rival: None };
        if self.journal.holds_back() {
            self.journal.hold_back(Box::new(HeldJob { shared: Arc::clone(shared), entry }));
        } else if self.journal.replaying() {
            shared.route(entry, self.thread);
        } else {
            shared.put(entry, self.thread);
        }
        Ok(id)
    }

    /// Jobs pushed with an epoch below `epoch` are no longer worth doing: a worker that pops one takes it to
    /// [`Worker::stale`].
    pub fn retire<J: Job>(&mut self, pool: &JobPool<J>, epoch: u64) {
        pool.shared.epoch.fetch_max(epoch, Ordering::Relaxed);
    }

    /// Moves every waiting job one bucket forward, if the first bucket is empty, so that old jobs rise. Returns
    /// nothing that could tell whether it did: that depends on the workers.
    pub fn age<J: Job>(&mut self, pool: &JobPool<J>) {
        let shared = &pool.shared;
        let base = shared.base.load(Ordering::Relaxed);
        let is_empty = |heap: &Heap<J>| heap.has_none_in(base);
        if is_empty(&shared.common) && is_empty(&shared.own) {
            shared.base.store((base + 1) % 64, Ordering::Relaxed);
        }
    }
}

/// A job of a replay, before it is known that its maker does as recorded.
struct HeldJob<J: Job> {
    shared: Arc<Shared<J>>,
    entry: Entry<J>,
}

impl<J: Job> Held for HeldJob<J> {
    fn tell(&self) -> Said {
        let Carried::Alone(job) = &self.entry.job else { return Said::default() };
        let says = guarded(|| job.content()).unwrap_or_default();
        Said { to: ActorId((self.entry.id >> 40) as u32), kind: job.kind(), says }
    }

    fn go(self: Box<Self>, thread: &ThreadCx) {
        self.shared.route(self.entry, thread);
    }
}

/// Tells whether jobs wait, for the runtime's own checks.
pub(crate) trait AnyPool: Send + Sync {
    fn seal(&self);
    fn stats(&self) -> PoolStats;
    fn save(&self, saver: &mut Saver);
    fn restore(&self, loader: &mut Loader<'_>) -> Option<()>;
}

impl<J: Job> AnyPool for JobPool<J> {
    fn seal(&self) {
        Self::seal(self);
    }

    fn stats(&self) -> PoolStats {
        Self::stats(self)
    }

    fn save(&self, saver: &mut Saver) {
        saver.put(&self.shared.numbers().map(|number| number.load(Ordering::Relaxed)));
    }

    fn restore(&self, loader: &mut Loader<'_>) -> Option<()> {
        let saved: [u64; 6] = loader.take()?;
        self.shared
            .numbers()
            .iter()
            .zip(saved)
            .for_each(|(number, saved)| number.store(saved, Ordering::Relaxed));
        Some(())
    }
}
