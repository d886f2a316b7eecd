//! Ready jobs: 64 priority buckets under a bitmap, popped by whichever worker is free.
//!
//! The pool decides nothing: whoever pushes chooses bucket (0 is popped first), epoch and size. Each pop is a delivery
//! of the worker that made it, so a recording knows who did what, and replay hands each job to the same worker.

use crossbeam_queue::SegQueue;
use std::any::Any;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

use crate::actor::{Actor, Cx};
use crate::env::Env;
use crate::eventcount::EventCount;
use crate::journal::Journal;
use crate::mailbox::{Link, signal};
use crate::message::{Digest, Message, Reason, Rejected};
use crate::scheduler::ThreadCx;
use crate::snapshot::{Loader, Saver};

/// Priority buckets of a pool.
pub const BUCKETS: u8 = 64;
/// A job that panicked so often is given up.
pub const KILLS_MAX: u32 = 3;

/// A piece of work that any worker of a pool can do.
pub trait Job: Send + 'static {
    /// Adds the content to a hash, as [`Message::digest`].
    fn digest(&self, digest: &mut Digest);

    /// What the job is and how to do it again, for the report if it is given up.
    fn describe(&self) -> String;

    /// The variant's name, for reports.
    fn kind(&self) -> &'static str {
        "job"
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

    /// Does one job. If this panics, the job goes back and another worker does it.
    fn run(&mut self, job: &Self::Job, cx: &mut Cx<'_, Self::Msg>);

    /// Takes a job whose epoch has passed and which will not be done.
    fn stale(&mut self, _job: Self::Job, _cx: &mut Cx<'_, Self::Msg>) {}
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
    /// Times a job went back because its worker panicked.
    pub requeued: u64,
    /// Jobs that wait.
    pub waiting: u64,
    /// Workers that take jobs.
    pub workers: u64,
    /// Simulation: jobs that were popped while a better one waited.
    pub disorder: u64,
}

/// Which buckets have jobs.
#[derive(Debug)]
pub(crate) struct Bitmap {
    bits: crate::sync::AtomicU64,
}

impl Bitmap {
    pub(crate) fn new() -> Self {
        Self { bits: crate::sync::AtomicU64::new(0) }
    }

    /// A job is in place in this bucket.
    pub(crate) fn raise(&self, bucket: u32) {
        self.bits.fetch_or(1 << bucket, crate::sync::Ordering::SeqCst);
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.bits.load(crate::sync::Ordering::SeqCst) == 0
    }

    /// Takes from the first bucket at or after `base` (cyclically) that has something. A bucket found empty loses its
    /// bit and is looked at once more: a job that came in between had its bit cleared with the old one.
    pub(crate) fn take<T>(
        &self,
        base: u32,
        pop: impl Fn(u32) -> Option<T>,
        is_empty: impl Fn(u32) -> bool,
    ) -> Option<T> {
        loop {
            let bits = self.bits.load(crate::sync::Ordering::SeqCst);
            if bits == 0 {
                return None;
            }
            let bucket = (bits.rotate_right(base).trailing_zeros() + base) % 64;
            if let Some(taken) = pop(bucket) {
                return Some(taken);
            }
            self.bits.fetch_and(!(1 << bucket), crate::sync::Ordering::SeqCst);
            if !is_empty(bucket) {
                self.raise(bucket);
            }
        }
    }
}

struct Entry<J> {
    id: u64,
    attempt: u32,
    epoch: u64,
    bucket: u32,
    /// Deliveries to its maker before it was pushed, the one at hand included.
    pushed_in: u64,
    job: J,
}

/// One worker's place at a pool.
struct Place<J> {
    link: Arc<Link>,
    /// Jobs meant for this worker: those that killed another one and, in replay, all that the script gives it.
    inbound: SegQueue<Entry<J>>,
    /// Takes no jobs: paused or stopped.
    away: AtomicBool,
}

struct Shared<J> {
    env: Arc<Env>,
    buckets: Box<[SegQueue<Entry<J>>]>,
    bitmap: Bitmap,
    base: AtomicU32,
    capacity: usize,
    waiting: AtomicUsize,
    epoch: AtomicU64,
    arriving: SegQueue<Arc<Place<J>>>,
    places: OnceLock<Box<[Arc<Place<J>>]>>,
    idle: EventCount,
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
        if self.env.replaying() {
            self.route(entry, thread);
            return;
        }
        let bucket = entry.bucket;
        self.buckets[bucket as usize].push(entry);
        self.bitmap.raise(bucket);
        self.wake(thread);
    }

    fn wake(&self, thread: &ThreadCx) {
        if let Some(place) = self.idle.notify_one()
            && let Some(place) = self.places().get(place)
        {
            place.link.raise(signal::JOBS, thread);
        }
    }

    /// Replay: a job goes straight to the worker that popped it when the recording was made.
    fn route(&self, entry: Entry<J>, thread: &ThreadCx) {
        let Some(worker) = self.env.popped_by(entry.id, entry.attempt) else { return };
        if let Some(place) = self.places().iter().find(|place| place.link.id == worker) {
            place.inbound.push(entry);
            place.link.raise(signal::JOBS, thread);
        }
    }

    /// Gives a job that killed a worker to the next one, or back to all if there is no other.
    fn hand_on(&self, entry: Entry<J>, from: usize, thread: &ThreadCx) {
        let places = self.places();
        let others = (1..places.len()).map(|step| &places[(from + step) % places.len()]);
        match others.into_iter().find(|place| !place.away.load(Ordering::SeqCst)) {
            Some(place) if !self.env.replaying() => {
                place.inbound.push(entry);
                place.link.raise(signal::JOBS, thread);
                if place.away.load(Ordering::SeqCst) {
                    self.give_back(place, thread);
                }
            }
            _ => self.put(entry, thread),
        }
    }

    /// What was meant for a worker that went away is for all.
    fn give_back(&self, place: &Place<J>, thread: &ThreadCx) {
        while let Some(entry) = place.inbound.pop() {
            self.put(entry, thread);
        }
    }

    fn take(&self) -> Option<Entry<J>> {
        let base = self.base.load(Ordering::Relaxed);
        let entry = self.bitmap.take(
            base,
            |bucket| self.buckets[bucket as usize].pop(),
            |bucket| self.buckets[bucket as usize].is_empty(),
        )?;
        if self.env.simulated() {
            // Alone, the best is the best: on several threads a better one may come while this one is popped.
            let rank = (entry.bucket + 64 - base) % 64;
            let better = (0..rank).any(|step| !self.buckets[((base + step) % 64) as usize].is_empty());
            self.disorder.fetch_add(u64::from(better), Ordering::Relaxed);
        }
        Some(entry)
    }
}

/// A bounded pool of jobs. Clones share it.
pub struct JobPool<J> {
    shared: Arc<Shared<J>>,
}

impl<J> Clone for JobPool<J> {
    fn clone(&self) -> Self {
        Self { shared: Arc::clone(&self.shared) }
    }
}

impl<J: Job> JobPool<J> {
    pub(crate) fn new(env: &Arc<Env>, capacity: usize) -> Self {
        let shared = Shared {
            env: Arc::clone(env),
            buckets: (0..BUCKETS).map(|_| SegQueue::new()).collect(),
            bitmap: Bitmap::new(),
            base: AtomicU32::new(0),
            capacity,
            waiting: AtomicUsize::new(0),
            epoch: AtomicU64::new(0),
            arriving: SegQueue::new(),
            places: OnceLock::new(),
            idle: EventCount::new(),
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
            workers: shared.workers.load(Ordering::Relaxed) as u64,
            disorder: shared.disorder.load(Ordering::Relaxed),
        }
    }

    pub(crate) fn sit<A: Worker<Job = J>>(&self, link: &Arc<Link>) -> Box<dyn Seat<A>> {
        let place = Arc::new(Place {
            link: Arc::clone(link),
            inbound: SegQueue::new(),
            away: AtomicBool::new(false),
        });
        let number = self.shared.workers.fetch_add(1, Ordering::SeqCst);
        assert!(number < 64, "a pool has at most 64 workers");
        self.shared.arriving.push(Arc::clone(&place));
        Box::new(SeatOf {
            number,
            place,
            pool: self.clone(),
            left: AtomicBool::new(false),
            current: None,
            early: BTreeMap::new(),
        })
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
            self.journal.replays_rejection(number)
        } else {
            let full = self.journal.rejects_by_fault(number)
                || shared.waiting.fetch_add(1, Ordering::Relaxed) >= shared.capacity && {
                    shared.waiting.fetch_sub(1, Ordering::Relaxed);
                    true
                };
            if full {
                self.journal.record_rejection(number);
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
        shared.put(Entry { id, attempt: 0, epoch, bucket, pushed_in, job }, self.thread);
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
        if shared.buckets[base as usize].is_empty() {
            shared.base.store((base + 1) % 64, Ordering::Relaxed);
        }
    }
}

/// What a seat popped.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Popped {
    pub(crate) id: u64,
    pub(crate) attempt: u32,
    pub(crate) pushed_in: u64,
    pub(crate) stale: bool,
}

/// What became of a job that killed its worker.
pub(crate) enum Killed {
    Requeued,
    Dead { id: u64, description: String },
}

/// A worker's side of its pool, whatever the jobs are.
pub(crate) trait Seat<A: Actor>: Send {
    /// Pops the best job and holds it.
    fn pop(&mut self, thread: &ThreadCx) -> Option<Popped>;
    /// Replay: holds this job and tells when it was pushed; none if it was not yet.
    fn hold(&mut self, id: u64, attempt: u32) -> Option<u64>;
    fn digest(&self, digest: &mut Digest);
    fn kind(&self) -> &'static str;
    fn content(&self) -> &dyn Any;
    fn run(&mut self, actor: &mut A, cx: &mut Cx<'_, A::Msg>);
    fn stale(&mut self, actor: &mut A, cx: &mut Cx<'_, A::Msg>);
    fn completed(&mut self);
    fn killed(&mut self, thread: &ThreadCx) -> Killed;
    /// Waits for jobs; false if one is there already.
    fn rest(&self) -> bool;
    /// Takes no jobs for now; somebody else is told of one that waits.
    fn decline(&self, thread: &ThreadCx);
    /// Leaves for good unless nobody else is left.
    fn leave(&self, thread: &ThreadCx) -> bool;
    fn leave_regardless(&self, thread: &ThreadCx);
    /// Writes the jobs that wait for the script of a replay to call for them.
    fn save(&mut self, saver: &mut Saver);
    fn restore(&mut self, loader: &mut Loader<'_>) -> Option<()>;
}

struct SeatOf<J> {
    number: usize,
    place: Arc<Place<J>>,
    pool: JobPool<J>,
    left: AtomicBool,
    current: Option<Entry<J>>,
    early: BTreeMap<(u64, u32), Entry<J>>,
}

impl<J: Job, A: Worker<Job = J>> Seat<A> for SeatOf<J> {
    fn pop(&mut self, thread: &ThreadCx) -> Option<Popped> {
        let shared = &self.pool.shared;
        self.place.away.store(false, Ordering::SeqCst);
        let entry = self.place.inbound.pop().or_else(|| shared.take())?;
        shared.waiting.fetch_sub(1, Ordering::Relaxed);
        shared.idle.cancel(self.number);
        if !shared.bitmap.is_empty() {
            // The one who was woken for what is left may be this busy worker.
            shared.wake(thread);
        }
        let stale = entry.epoch < shared.epoch.load(Ordering::Relaxed);
        let popped = Popped { id: entry.id, attempt: entry.attempt, pushed_in: entry.pushed_in, stale };
        self.current = Some(entry);
        Some(popped)
    }

    fn hold(&mut self, id: u64, attempt: u32) -> Option<u64> {
        while let Some(entry) = self.place.inbound.pop() {
            self.early.insert((entry.id, entry.attempt), entry);
        }
        self.current = self.early.remove(&(id, attempt));
        self.current.as_ref().map(|entry| entry.pushed_in)
    }

    fn digest(&self, digest: &mut Digest) {
        if let Some(entry) = &self.current {
            digest.u64(entry.id);
            digest.u32(entry.attempt);
            entry.job.digest(digest);
        }
    }

    fn kind(&self) -> &'static str {
        self.current.as_ref().map_or("job", |entry| entry.job.kind())
    }

    fn content(&self) -> &dyn Any {
        match &self.current {
            Some(entry) => &entry.job,
            None => &(),
        }
    }

    fn run(&mut self, actor: &mut A, cx: &mut Cx<'_, A::Msg>) {
        if let Some(entry) = &self.current {
            actor.run(&entry.job, cx);
        }
    }

    fn stale(&mut self, actor: &mut A, cx: &mut Cx<'_, A::Msg>) {
        if let Some(entry) = self.current.take() {
            self.pool.shared.stale.fetch_add(1, Ordering::Relaxed);
            actor.stale(entry.job, cx);
        }
    }

    fn completed(&mut self) {
        if self.current.take().is_some() {
            self.pool.shared.completed.fetch_add(1, Ordering::Relaxed);
        }
    }

    fn killed(&mut self, thread: &ThreadCx) -> Killed {
        let shared = &self.pool.shared;
        let Some(entry) = self.current.take() else { return Killed::Requeued };
        let attempt = entry.attempt + 1;
        if attempt >= KILLS_MAX {
            shared.dead.fetch_add(1, Ordering::Relaxed);
            return Killed::Dead { id: entry.id, description: entry.job.describe() };
        }
        shared.requeued.fetch_add(1, Ordering::Relaxed);
        if !shared.env.replaying() {
            shared.waiting.fetch_add(1, Ordering::Relaxed);
        }
        shared.hand_on(Entry { attempt, ..entry }, self.number, thread);
        Killed::Requeued
    }

    fn rest(&self) -> bool {
        let shared = &self.pool.shared;
        shared.idle.prepare(self.number);
        let rests = shared.bitmap.is_empty() && self.place.inbound.is_empty();
        if !rests {
            shared.idle.cancel(self.number);
        }
        rests
    }

    fn decline(&self, thread: &ThreadCx) {
        let shared = &self.pool.shared;
        if shared.env.replaying() {
            return;
        }
        self.place.away.store(true, Ordering::SeqCst);
        shared.idle.cancel(self.number);
        shared.give_back(&self.place, thread);
        if !shared.bitmap.is_empty() {
            shared.wake(thread);
        }
    }

    fn leave(&self, thread: &ThreadCx) -> bool {
        let others = |workers: usize| (workers > 1).then(|| workers - 1);
        let left = self.pool.shared.workers.fetch_update(Ordering::SeqCst, Ordering::SeqCst, others).is_ok();
        if left {
            self.left.store(true, Ordering::Relaxed);
            Seat::<A>::decline(self, thread);
        }
        left
    }

    fn leave_regardless(&self, thread: &ThreadCx) {
        if self.left.swap(true, Ordering::Relaxed) {
            return;
        }
        let fewer = |workers: usize| workers.checked_sub(1);
        let _ = self.pool.shared.workers.fetch_update(Ordering::SeqCst, Ordering::SeqCst, fewer);
        Seat::<A>::decline(self, thread);
    }

    fn save(&mut self, saver: &mut Saver) {
        while let Some(entry) = self.place.inbound.pop() {
            self.early.insert((entry.id, entry.attempt), entry);
        }
        saver.put(&(self.early.len() as u64));
        for Entry { id, attempt, epoch, bucket, pushed_in, job } in self.early.values() {
            saver.put(&(*id, *attempt, *epoch, *bucket, *pushed_in));
            job.save(saver);
        }
    }

    fn restore(&mut self, loader: &mut Loader<'_>) -> Option<()> {
        let count: u64 = loader.take()?;
        for _ in 0..count {
            let (id, attempt, epoch, bucket, pushed_in) = loader.take()?;
            let job = J::restore(loader)?;
            self.early.insert((id, attempt), Entry { id, attempt, epoch, bucket, pushed_in, job });
        }
        Some(())
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

/// The journal's part in a pop, kept here so that the pool's file tells the whole story of a job.
pub(crate) fn job_symbol(journal: &Journal, stale: bool) -> crate::log::format::Symbol {
    use crate::log::format::{Symbol, lane};
    Symbol { from: journal.id, lane: if stale { lane::STALE } else { lane::JOB } }
}
