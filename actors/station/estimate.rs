//! What a station thinks of its guest: how long a sample takes there, how long the way is, and so how many jobs it needs to
//! have to be busy, and when one is overdue. By measured durations alone, which are recorded.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::CREDITS_MAX;

/// Before anything is known: a guest may have to draw and to wake up.
const FIRST: Duration = Duration::from_secs(3);
/// No job is overdue sooner.
const LEAST: Duration = Duration::from_millis(60);
/// None is waited for longer.
const MOST: Duration = Duration::from_secs(10);
/// What hosts and guests add by their turns, nanoseconds.
const SLACK: f32 = 4e6;

/// Durations in nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Estimate {
    answers: u32,
    /// Of one core, for one sample.
    sample: f32,
    /// Samples of a job.
    samples: f32,
    /// From sending a job to its answer without the time it took.
    way: f32,
    /// How far that differs from its mean.
    jitter: f32,
    /// Times that jobs were overdue lately: those after it are given longer.
    late: u32,
}

impl Estimate {
    /// A job of so many samples took `micros` there, and `elapsed` nanoseconds passed here.
    pub(super) fn learn(&mut self, samples: u32, micros: u32, elapsed: u64) {
        // A guest may say anything; no longer than it took.
        let taken = (micros as f32 * 1e3).min(elapsed as f32);
        let way = elapsed as f32 - taken;
        let rate = if self.answers < 8 { 0.5 } else { 0.1 };
        let mix = |old: f32, new: f32| if self.answers == 0 { new } else { old + rate * (new - old) };
        self.sample = mix(self.sample, taken / samples.max(1) as f32);
        self.samples = mix(self.samples, samples as f32);
        self.jitter = mix(self.jitter, (way - self.way).abs());
        // Jobs queue there: what the way itself takes is nearer to the least.
        self.way = if self.answers == 0 || way < self.way { way } else { self.way + 0.02 * (way - self.way) };
        self.answers = self.answers.saturating_add(1);
        self.late = self.late.saturating_sub(u32::from(self.answers.is_multiple_of(16)));
    }

    pub(super) fn was_late(&mut self) {
        self.late = (self.late + 1).min(6);
    }

    /// There and back.
    pub(super) fn round_trip(&self) -> Duration {
        Duration::from_nanos(self.way as u64)
    }

    /// Jobs that keep all cores busy: those they are at, and what comes while answers and jobs are on their way.
    pub(super) fn window(&self, cores: u16) -> u32 {
        let job = (self.sample * self.samples).max(1e4);
        let on_the_way = ((self.way.min(2e9) + SLACK) / job).ceil();
        let jobs = f32::from(cores) * (1.0 + on_the_way) + 1.0;
        (jobs as u32).clamp((u32::from(cores) + 1).min(CREDITS_MAX), CREDITS_MAX)
    }

    /// How long a job may take, behind so many samples that are out already.
    pub(super) fn within(&self, ahead: u64, samples: u32, cores: u16) -> Duration {
        if self.answers == 0 {
            return FIRST;
        }
        let queue = (ahead as f32 / f32::from(cores) + samples as f32) * self.sample;
        let time = 3.0 * queue + self.way + 4.0 * self.jitter + SLACK;
        Duration::from_nanos(time as u64).max(LEAST).saturating_mul(1 << self.late).min(MOST)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_far_guest_has_more_jobs_out_and_more_time() {
        let of = |way: u64, micros: u32| {
            let mut estimate = Estimate::default();
            (0..50).for_each(|_| estimate.learn(256, micros, u64::from(micros) * 1000 + way));
            estimate
        };
        let (near, far) = (of(200_000, 2000), of(40_000_000, 2000));
        assert_eq!(near.window(1), 1 + 3 + 1);
        assert_eq!(far.window(1), 1 + 22 + 1);
        assert_eq!(far.window(64), CREDITS_MAX);
        assert!(near.within(0, 256, 1) >= LEAST && near.within(0, 256, 1) < Duration::from_millis(100));
        assert!(far.within(22 * 256, 256, 1) > Duration::from_millis(40 + 44));
        assert!(near.within(64 * 256, 256, 1) > near.within(0, 256, 1));
    }

    #[test]
    fn what_a_guest_says_of_its_time_is_bounded_by_ours() {
        let mut estimate = Estimate::default();
        estimate.learn(1, u32::MAX, 1_000_000);
        assert!(estimate.within(0, 1, 1) <= MOST && estimate.round_trip() <= Duration::from_millis(1));
        assert_eq!(estimate.window(1), 6);
        estimate.learn(0, 0, u64::MAX);
        assert!(estimate.window(1) <= CREDITS_MAX && estimate.within(u64::MAX, u32::MAX, 1) == MOST);
    }
}
