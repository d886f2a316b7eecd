//! What is recorded beside deliveries: times, measured durations, marks, verdicts about panics, faults, lost leases. In replay
//! each comes from the recording, and is asked for at the same delivery.

use super::Journal;
use crate::log::format::{put, put_signed, value};

impl Journal {
    /// During replay, the next recorded value, which must be of this kind and at this delivery.
    pub(crate) fn replayed_value(&mut self, tag: u8) -> Option<u64> {
        let index = self.index;
        let script = self.script.as_mut()?;
        match script.peek_value() {
            Some((at, recorded)) if at == index && recorded == tag => {
                Some(script.value().unwrap_or_default())
            }
            other => {
                let expected = match other {
                    Some((at, recorded)) if at == index => value::name(recorded).to_owned(),
                    _ if script.exhausted() && !script.complete => return Some(0),
                    _ => "none".to_owned(),
                };
                let _ = self.diverge(index.saturating_sub(1), expected, value::name(tag).to_owned());
                Some(0)
            }
        }
    }

    pub(crate) fn record_now(&mut self, now: u64) {
        if let Some(recorder) = &mut self.recorder {
            recorder.value(self.index, value::NOW);
            put_signed(&mut recorder.values, (now / 1000).wrapping_sub(recorder.last_now) as i64);
            recorder.last_now = now / 1000;
        }
    }

    pub(crate) fn record_measured(&mut self, code: u64) {
        if let Some(recorder) = &mut self.recorder {
            recorder.value(self.index, value::MEASURED);
            put(&mut recorder.values, code);
        }
    }

    pub(crate) fn record_count(&mut self, count: u64) {
        if let Some(recorder) = &mut self.recorder {
            recorder.value(self.index, value::COUNT);
            put(&mut recorder.values, count);
        }
    }

    pub(crate) fn mark(&mut self, kind: u32, mark: u64) {
        if let Some(recorder) = &mut self.recorder {
            recorder.value(self.index, value::MARK);
            put(&mut recorder.values, u64::from(kind));
            recorder.values.extend_from_slice(&mark.to_le_bytes());
        }
        if self.script.is_some()
            && let Some(expected) = self.replayed_value(value::MARK)
            && let Some(recorded_kind) = self.script.as_ref().map(|script| script.mark_kind)
            && (expected, recorded_kind) != (mark, kind)
            && !self.env.scheduler.halted()
        {
            let name = |kind: u32, mark: u64| format!("mark {kind} with {mark:016x}");
            let _ =
                self.diverge(self.index.saturating_sub(1), name(recorded_kind, expected), name(kind, mark));
        }
        self.env.marked(kind, mark);
    }

    /// What to do about a panic: decided live, taken from the recording in replay.
    pub(crate) fn verdict(&mut self, decide: impl FnOnce() -> u64) -> u64 {
        if let Some(verdict) = self.replayed_value(value::VERDICT) {
            return verdict;
        }
        let verdict = decide();
        if let Some(recorder) = &mut self.recorder {
            recorder.value(self.index, value::VERDICT);
            put(&mut recorder.values, verdict);
        }
        verdict
    }

    /// Whether a panic is injected into the delivery at hand.
    #[inline]
    pub(crate) fn panics_by_fault(&mut self) -> bool {
        let index = self.index;
        if let Some(script) = &mut self.script {
            let injected = script.peek_value() == Some((index, value::FAULT));
            if injected {
                let _ = script.value();
            }
            return injected;
        }
        if self.panics.front().is_none_or(|at| *at >= index) {
            return false;
        }
        self.panics.pop_front();
        if let Some(recorder) = &mut self.recorder {
            recorder.value(index, value::FAULT);
        }
        true
    }

    /// Simulation: whether the worker hangs at the job at hand.
    #[inline]
    pub(crate) fn hangs_by_fault(&mut self) -> bool {
        let hangs = self.hangs.front().is_some_and(|at| *at < self.index);
        if hangs {
            self.hangs.pop_front();
        }
        hangs
    }

    /// In replay, whether the work at hand was given up then.
    pub(crate) fn replays_giving_up(&mut self) -> Option<bool> {
        let index = self.index;
        let script = self.script.as_mut()?;
        let given_up = script.peek_value() == Some((index, value::GIVEN_UP));
        if given_up {
            let _ = script.value();
        }
        Some(given_up)
    }

    pub(crate) fn record_given_up(&mut self) {
        if let Some(recorder) = &mut self.recorder {
            recorder.value(self.index, value::GIVEN_UP);
        }
    }

    /// Whether the job at hand is still this worker's: `live` tells, and the recording where it was not.
    pub(crate) fn keeps_lease(&mut self, live: impl FnOnce() -> bool) -> bool {
        if let Some(script) = &mut self.script {
            let lost = script.peek_value() == Some((self.index, value::LOST));
            if lost {
                let _ = script.value();
            }
            return !lost;
        }
        let kept = live();
        if !kept && let Some(recorder) = &mut self.recorder {
            recorder.value(self.index, value::LOST);
        }
        kept
    }
}
