//! A worker's side of its pool: the job it holds, what it does with it, and how it leaves.

use std::any::Any;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::lease::AtHand;
use super::{Carried, Death, Entry, Job, JobPool, KILLS_MAX, Place, Worker};
use crate::actor::Cx;
use crate::actor::seat::{Popped, Seat};
use crate::journal::Journal;
use crate::message::Digest;
use crate::message::content::Content;
use crate::message::saved::{Loader, Saver};
use crate::scheduler::ThreadCx;

pub(super) struct SeatOf<J: Job> {
    pub(super) place: Arc<Place<J>>,
    pub(super) pool: JobPool<J>,
    pub(super) left: AtomicBool,
    pub(super) current: Option<Entry<J>>,
    pub(super) early: BTreeMap<(u64, u32), Entry<J>>,
}

impl<J: Job, A: Worker<Job = J>> Seat<A> for SeatOf<J> {
    fn pop(&mut self, actor: &A, thread: &ThreadCx) -> Option<Popped> {
        let shared = &self.pool.shared;
        if A::KEEPS && !actor.room() {
            return None;
        }
        self.place.away.store(false, Ordering::SeqCst);
        let entry = self.place.inbound.pop().or_else(|| shared.take(A::KEEPS))?;
        shared.waiting.fetch_sub(1, Ordering::Relaxed);
        shared.idle_of(&self.place).cancel(self.place.number);
        if !shared.is_empty_for(false) {
            // The one who was woken for what is left may be this busy worker.
            shared.wake(thread);
        }
        let stale = entry.epoch < shared.epoch.load(Ordering::Relaxed);
        let popped = Popped { id: entry.id, attempt: entry.attempt, pushed_in: entry.pushed_in, stale };
        self.current = Some(match shared.lease.get() {
            Some(time) if !stale && !A::KEEPS && entry.attempt < KILLS_MAX => {
                let until = shared.env.scheduler.clock.now().saturating_add(*time);
                let (own, lent) = entry.split();
                self.place.hold.lend(lent, until);
                if !shared.env.simulated() {
                    shared.watch(until);
                }
                own
            }
            _ => {
                self.place.hold.own(&entry);
                entry
            }
        });
        Some(popped)
    }

    fn hold(&mut self, id: u64, attempt: u32) -> Option<u64> {
        while let Some(entry) = self.place.inbound.pop() {
            self.early.insert((entry.id, entry.attempt), entry);
        }
        self.current = self.early.remove(&(id, attempt));
        self.place.hold.replay();
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
            Some(entry) => &*entry.job,
            None => &(),
        }
    }

    fn told(&self) -> Content {
        self.current.as_ref().map_or(Content::Untold, |entry| entry.job.content())
    }

    fn run(&mut self, actor: &mut A, cx: &mut Cx<'_, A::Msg>) {
        if let Some(entry) = &self.current {
            let (place, shared) = (&*self.place, &*self.pool.shared);
            let Entry { id, attempt, epoch, .. } = *entry;
            actor.run(&entry.job, &mut cx.at(&AtHand { place, shared, epoch, id, attempt }));
        }
    }

    fn stale(&mut self, actor: &mut A, cx: &mut Cx<'_, A::Msg>) {
        if let Some(entry) = self.current.take() {
            let shared = &self.pool.shared;
            if !cx.journal.keeps_lease(|| shared.is_first(entry.rival.as_deref())) {
                return;
            }
            shared.stale.fetch_add(1, Ordering::Relaxed);
            actor.stale(&entry.job, cx);
        }
    }

    fn completed(&mut self, journal: &mut Journal) {
        let Some(entry) = self.current.take() else { return };
        let shared = &self.pool.shared;
        match &self.place.keeping {
            Some(keeping) if keeping.asked.swap(false, Ordering::Relaxed) => {
                shared.kept.fetch_add(1, Ordering::Relaxed);
                keeping.put(entry);
            }
            _ if self.place.claim(shared, journal) => {
                shared.completed.fetch_add(1, Ordering::Relaxed);
            }
            _ => {}
        }
    }

    fn hang(&self, thread: &ThreadCx) {
        self.pool.shared.expire(&self.place, 0, thread);
    }

    fn give_up(&mut self, journal: &mut Journal, thread: &ThreadCx) {
        if let Some(entry) = self.current.take() {
            let shared = &self.pool.shared;
            if journal.keeps_lease(|| shared.is_first(entry.rival.as_deref())) {
                shared.bury(&entry, Death::Expired, journal, thread);
            }
        }
    }

    fn killed(&mut self, journal: &mut Journal, thread: &ThreadCx, message: &str) {
        let shared = &self.pool.shared;
        let Some(entry) = self.current.take() else { return };
        if let Some(keeping) = &self.place.keeping {
            keeping.asked.store(false, Ordering::Relaxed);
        }
        if !self.place.claim(shared, journal) {
            return;
        }
        let attempt = entry.attempt + 1;
        if attempt >= KILLS_MAX {
            return shared.bury(&entry, Death::Panicked(message.to_owned()), journal, thread);
        }
        shared.requeued.fetch_add(1, Ordering::Relaxed);
        if !shared.env.replaying() {
            shared.waiting.fetch_add(1, Ordering::Relaxed);
            // Who had it too is late from now on.
            shared.hand_on(Entry { attempt, rival: None, ..entry }, self.place.number, thread);
        }
    }

    fn rest(&self, actor: &A) -> bool {
        let shared = &self.pool.shared;
        if A::KEEPS && !actor.room() {
            return true;
        }
        let idle = shared.idle_of(&self.place);
        idle.prepare(self.place.number);
        let rests = shared.is_empty_for(A::KEEPS) && self.place.inbound.is_empty();
        if !rests {
            idle.cancel(self.place.number);
        }
        rests
    }

    fn decline(&self, thread: &ThreadCx) {
        let shared = &self.pool.shared;
        if shared.env.replaying() {
            return;
        }
        self.place.away.store(true, Ordering::SeqCst);
        shared.idle_of(&self.place).cancel(self.place.number);
        shared.give_back(&self.place, thread);
        if !shared.is_empty_for(false) {
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
        if let Some(keeping) = &self.place.keeping {
            self.pool.shared.hand_back_all(keeping, thread);
        }
        let fewer = |workers: usize| workers.checked_sub(1);
        let _ = self.pool.shared.workers.fetch_update(Ordering::SeqCst, Ordering::SeqCst, fewer);
        Seat::<A>::decline(self, thread);
    }

    fn save(&mut self, saver: &mut Saver) {
        while let Some(entry) = self.place.inbound.pop() {
            self.early.insert((entry.id, entry.attempt), entry);
        }
        save_entries(self.early.values(), saver);
        if let Some(keeping) = &self.place.keeping {
            keeping.look(|kept| save_entries(kept.values(), saver));
        }
    }

    fn restore(&mut self, loader: &mut Loader<'_>) -> Option<()> {
        for entry in load_entries(loader)? {
            self.early.insert((entry.id, entry.attempt), entry);
        }
        if let Some(keeping) = &self.place.keeping {
            for entry in load_entries(loader)? {
                self.pool.shared.kept.fetch_add(1, Ordering::Relaxed);
                keeping.put(entry);
            }
        }
        Some(())
    }
}

fn save_entries<'e, J: Job>(entries: impl ExactSizeIterator<Item = &'e Entry<J>>, saver: &mut Saver) {
    saver.put(&(entries.len() as u64));
    for Entry { id, attempt, epoch, bucket, pushed_in, job, rival: _ } in entries {
        saver.put(&(*id, *attempt, *epoch, *bucket, *pushed_in));
        job.save(saver);
    }
}

fn load_entries<J: Job>(loader: &mut Loader<'_>) -> Option<Vec<Entry<J>>> {
    let count: u64 = loader.take()?;
    let mut entries = Vec::new();
    for _ in 0..count {
        let (id, attempt, epoch, bucket, pushed_in) = loader.take()?;
        let job = Carried::Alone(J::restore(loader)?);
        // Who is first is recorded.
        entries.push(Entry { id, attempt, epoch, bucket, pushed_in, job, rival: None });
    }
    Some(entries)
}
