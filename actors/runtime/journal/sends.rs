//! What an actor sends, counted: so that replay refuses what was refused, and names jobs and random numbers as they were.

use super::Journal;
use crate::log::format::{put, reason};
use crate::message::{ActorId, Digest, Reason};

impl Journal {
    #[inline]
    pub(crate) fn next_send(&mut self) -> u64 {
        self.sends += 1;
        self.sends - 1
    }

    #[inline]
    pub(crate) fn rejects_by_fault(&mut self, number: u64) -> bool {
        let rejects = self.fulls.front().is_some_and(|at| *at <= number);
        if rejects {
            self.fulls.pop_front();
        }
        rejects
    }

    /// Sends on behalf of the runtime: no fault is injected there.
    pub(crate) fn without_faults<R>(&mut self, send: impl FnOnce(&mut Self) -> R) -> R {
        let fulls = std::mem::take(&mut self.fulls);
        let result = send(self);
        self.fulls = fulls;
        result
    }

    pub(crate) fn record_rejection(&mut self, number: u64, reason: Reason) {
        if let Some(recorder) = &mut self.recorder {
            let code = (number - recorder.last_rejected) << reason::BITS | reason::code(reason);
            put(&mut recorder.rejected, code);
            recorder.last_rejected = number;
        }
    }

    pub(crate) fn replays_rejection(&mut self, number: u64) -> Option<Reason> {
        self.script.as_mut()?.rejects(number)
    }

    pub(crate) fn latest_sent(&self, to: ActorId, key: u8) -> u32 {
        count_of(&self.sent, to, key)
    }

    pub(crate) fn count_latest_sent(&mut self, to: ActorId, key: u8) {
        let count = count_of(&self.sent, to, key);
        set_count(&mut self.sent, to, key, count.wrapping_add(1));
    }

    /// How many values of this sender and slot were replaced before the one with this sequence number.
    pub(crate) fn skipped(&mut self, from: ActorId, key: u8, sequence: u32) -> u32 {
        let seen = count_of(&self.seen, from, key);
        set_count(&mut self.seen, from, key, sequence.wrapping_add(1));
        sequence.wrapping_sub(seen)
    }

    /// The identity of the next job this actor makes: its maker and a count.
    pub(crate) fn next_job(&mut self) -> u64 {
        self.jobs_made += 1;
        u64::from(self.id.0) << 40 | (self.jobs_made - 1)
    }

    pub(crate) fn random(&mut self) -> u64 {
        let mut hash = Digest::new();
        hash.u64(self.env.seed);
        hash.u64(u64::from(self.id.0));
        hash.u64(self.randoms);
        self.randoms += 1;
        hash.finish()
    }
}

fn count_of(counts: &[(ActorId, u8, u32)], id: ActorId, key: u8) -> u32 {
    counts.iter().find(|(other, slot, _)| (*other, *slot) == (id, key)).map_or(0, |(_, _, count)| *count)
}

fn set_count(counts: &mut Vec<(ActorId, u8, u32)>, id: ActorId, key: u8, value: u32) {
    match counts.iter_mut().find(|(other, slot, _)| (*other, *slot) == (id, key)) {
        Some((_, _, count)) => *count = value,
        None => counts.push((id, key, value)),
    }
}
