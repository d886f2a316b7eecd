//! Ending a system: input closes, what was accepted is handled, actors stop in order, the recording gets its end.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use crate::actor::Control;
use crate::clock::nanoseconds;
use crate::log::writer::RecordingStatus;
use crate::profile::ActorCounters;
use crate::runtime::{Exit, Limit, Runtime};

/// What a shutdown left.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shutdown {
    /// All that was accepted was also handled, and every actor stopped in time.
    pub drained: bool,
    /// Messages that were accepted and never handled.
    pub dead_letters: u64,
    /// Jobs that were accepted and not done.
    pub jobs_left: u64,
    /// How the recording ended.
    pub recording: RecordingStatus,
    /// Final counters of each actor.
    pub counters: Vec<ActorCounters>,
}

impl Runtime {
    /// Takes no more input, lets everything that was accepted be handled, then stops the actors, the last made first.
    /// What is not done within `time` is counted in the result.
    pub fn shutdown(mut self, time: Duration) -> Shutdown {
        self.end(time)
    }

    /// As [`Self::shutdown`], and keeps the actors as they stopped: every one can be inspected then.
    pub fn end(&mut self, time: Duration) -> Shutdown {
        self.env.close();
        let end = self.env.clock.now().saturating_add(nanoseconds(time));
        let mut drained = true;
        if !self.env.replaying() && !self.env.halted() {
            let quiet = |runtime: &Self| {
                runtime.env.scheduler.idle() && runtime.nodes.iter().all(|node| node.is_empty())
            };
            drained = self.within(end, quiet);
            let nodes = Arc::clone(&self.nodes);
            for node in nodes.iter().rev().filter(|node| !node.link().closed.load(Ordering::SeqCst)) {
                node.link().control(Control::Stop, &self.thread);
                drained &= self.within(end, |_| node.link().closed.load(Ordering::SeqCst));
            }
        }
        self.stop(drained || self.env.replaying());
        let counters = self.counters();
        let jobs_left = self
            .pools
            .iter()
            .map(|pool| pool.stats())
            .map(|stats| stats.pushed.saturating_sub(stats.completed + stats.stale + stats.dead));
        let dead_letters = counters.iter().map(|actor| actor.dead_letters).sum();
        let jobs_left = jobs_left.sum();
        Shutdown { drained, dead_letters, jobs_left, recording: self.recording(), counters }
    }

    /// Pumps until `condition` or a deadline; idleness of the other threads wakes the main one to look again.
    fn within(&mut self, end: u64, condition: impl Fn(&Self) -> bool) -> bool {
        loop {
            let now = self.env.clock.now();
            if condition(self) {
                return true;
            }
            if now >= end {
                return false;
            }
            let step = (end - now).min(1_000_000);
            if self.pump_until(Limit::time(Duration::from_nanos(step)), |runtime| condition(runtime))
                == Exit::Halted
            {
                return false;
            }
        }
    }

    pub(crate) fn stop(&mut self, whole: bool) {
        self.env.scheduler.stop();
        if let Some(threads) = self.threads.take() {
            threads.join();
        }
        let Some(writer) = self.writer.take() else { return };
        for node in self.nodes.iter() {
            node.end_log();
            // The writer is still at work: what it had no room for goes in soon.
            while node.link().unflushed.load(Ordering::Relaxed) && self.env.recording() {
                std::thread::park_timeout(Duration::from_millis(1));
                node.end_log();
            }
        }
        let totals =
            whole.then(|| self.nodes.iter().map(|node| node.position().unwrap_or_default()).collect());
        writer.finish(totals);
    }
}
