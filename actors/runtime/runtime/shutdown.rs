//! Ending a system: input closes, what was accepted is handled, actors stop in order, the recording gets its end.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::actor::node::AnyNode;
use crate::journal::env::Env;
use crate::log::writer::{RecordingStatus, Writer};
use crate::message::incident::Incident;
use crate::runtime::{Exit, Limit, Runtime};
use crate::scheduler::Threads;
use crate::scheduler::clock::{Deadline, nanoseconds};
use crate::scheduler::link::{Control, Link};
use crate::scheduler::profile::ActorCounters;

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
    /// What the system ended for, if it ended by itself.
    pub ended: Option<Incident>,
    /// Final counters of each actor.
    pub counters: Vec<ActorCounters>,
}

/// A system that was left: its threads finish what they had in hand, and its recording is ended, on a thread that waits
/// for them. Dropping this waits for that thread.
#[derive(Debug, Default)]
pub struct Ending {
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Ending {
    /// Whether nothing is left to be waited for.
    pub fn is_over(&self) -> bool {
        self.thread.as_ref().is_none_or(|thread| thread.is_finished())
    }
}

impl Drop for Ending {
    fn drop(&mut self) {
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Threads and the recording have at least so long to end.
const SHUTDOWN_LEAST: Duration = Duration::from_secs(1);

/// What of a system waits for its threads. Ends when it is dropped, on whichever thread that is.
pub(crate) struct Rest {
    pub(crate) env: Arc<Env>,
    pub(crate) nodes: Arc<[Arc<dyn AnyNode>]>,
    pub(crate) threads: Option<Threads>,
    pub(crate) writer: Option<Writer>,
    /// The recording has all that was accepted.
    pub(crate) whole: bool,
}

impl Drop for Rest {
    fn drop(&mut self) {
        self.env.scheduler.stop();
        if let Some(threads) = self.threads.take() {
            threads.join();
        }
        let Some(writer) = self.writer.take() else { return };
        for node in self.nodes.iter() {
            node.end_log();
            // The writer is still at work: what it had no room for goes in soon.
            while node.link().unflushed.load(Ordering::Relaxed) && self.env.recording() && !writer.is_over() {
                std::thread::park_timeout(Duration::from_millis(1));
                node.end_log();
            }
        }
        let totals =
            self.whole.then(|| self.nodes.iter().map(|node| node.position().unwrap_or_default()).collect());
        writer.finish(totals);
    }
}

impl Runtime {
    /// As [`Self::shutdown`], but does not wait for turns that go on after `time`: whoever shows something else next must
    /// not stand still until a long one is over.
    pub fn leave(mut self, time: Duration) -> Ending {
        let drained = self.drain(time);
        let rest = self.rest(drained || self.env.replaying());
        let (env, nodes) = (Arc::clone(&self.env), Arc::clone(&self.nodes));
        let end = move || {
            drop(rest);
            clear(&env, &nodes);
        };
        self.left = true;
        // Where no thread can be started, what was to be done there is dropped here, and so ends.
        Ending { thread: std::thread::Builder::new().name("ending".into()).spawn(end).ok() }
    }

    /// Takes no more input, lets everything that was accepted be handled, then stops the actors, the last made first.
    /// What is not done within `time` is counted in the result.
    ///
    /// Turns that still go on then, and the recording, are waited for as long again, and at least for a second: a turn
    /// that hangs or a disk that does not answer keeps its thread, not the caller.
    pub fn shutdown(mut self, time: Duration) -> Shutdown {
        self.end(time)
    }

    /// As [`Self::shutdown`], and keeps the actors as they stopped: every one can be inspected then.
    pub fn end(&mut self, time: Duration) -> Shutdown {
        let drained = self.drain(time);
        let over = self.stop_within(drained || self.env.replaying(), time.max(SHUTDOWN_LEAST));
        if !over {
            self.env.stop_recording("the system was left before the recording was whole".to_owned());
        }
        let drained = drained && over;
        let counters = self.counters();
        let jobs_left = self
            .pools
            .iter()
            .map(|pool| pool.stats())
            .map(|stats| stats.pushed.saturating_sub(stats.completed + stats.stale + stats.dead));
        // Whoever did not stop never handles what waits for it.
        let waiting: u64 = self.nodes.iter().map(|node| node.waiting()).sum();
        let dead_letters = waiting + counters.iter().map(|actor| actor.dead_letters).sum::<u64>();
        let jobs_left = jobs_left.sum();
        let ended = self.ended().cloned();
        Shutdown { drained, dead_letters, jobs_left, recording: self.recording(), ended, counters }
    }

    /// Takes no more input and lets what was accepted be handled, at most for `time`. Whether all of it was, and every
    /// actor stopped.
    fn drain(&mut self, time: Duration) -> bool {
        self.env.close();
        let end = self.env.scheduler.clock.now().saturating_add(nanoseconds(time));
        let mut drained = true;
        if !self.env.replaying() && !self.env.scheduler.halted() {
            let quiet = |runtime: &Self| {
                // What waits for a paused actor is handled now or never.
                let rests = |link: &Link| link.signals.is_parked() && !link.closed.load(Ordering::SeqCst);
                for node in runtime.nodes.iter().filter(|node| rests(node.link())) {
                    node.link().control(Control::Resume, &runtime.thread);
                }
                runtime.env.scheduler.idle() && runtime.nodes.iter().all(|node| node.waiting() == 0)
            };
            drained = self.within(end, quiet);
            let nodes = Arc::clone(&self.nodes);
            for node in nodes.iter().rev().filter(|node| !node.link().closed.load(Ordering::SeqCst)) {
                node.link().control(Control::Stop, &self.thread);
                drained &= self.within(end, |_| node.link().closed.load(Ordering::SeqCst));
            }
        }
        drained
    }

    /// Pumps until `condition` or a deadline; idleness of the other threads wakes the main one to look again.
    fn within(&mut self, end: u64, condition: impl Fn(&Self) -> bool) -> bool {
        loop {
            let now = self.env.scheduler.clock.now();
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

    /// Ends threads and recording on another thread, which goes on where that takes longer than `time`. Whether all
    /// ended.
    fn stop_within(&mut self, whole: bool, time: Duration) -> bool {
        let rest = self.rest(whole);
        let (main, left) = (std::thread::current(), Arc::new(AtomicBool::new(false)));
        let end = {
            let left = Arc::clone(&left);
            move || {
                let (env, nodes) = (Arc::clone(&rest.env), Arc::clone(&rest.nodes));
                drop(rest);
                // Whoever comes second throws away what waits: it may hold addresses, and with them itself.
                if left.swap(true, Ordering::AcqRel) {
                    clear(&env, &nodes);
                }
                main.unpark();
            }
        };
        // Where no thread can be started, what was to be done there was dropped, and so has ended.
        let Ok(thread) = std::thread::Builder::new().name("ending".into()).spawn(end) else { return true };
        let deadline = Deadline::after(time);
        while !thread.is_finished() {
            let Some(wait) = deadline.left() else {
                self.left = !left.swap(true, Ordering::AcqRel);
                return !self.left;
            };
            std::thread::park_timeout(wait.min(Duration::from_millis(1)));
        }
        true
    }

    pub(crate) fn stop(&mut self, whole: bool) {
        drop(self.rest(whole));
    }

    fn rest(&mut self, whole: bool) -> Rest {
        let (env, nodes) = (Arc::clone(&self.env), Arc::clone(&self.nodes));
        env.scheduler.stop();
        Rest { env, nodes, threads: self.threads.take(), writer: self.writer.take(), whole }
    }
}

/// What is left in mailboxes and timers may hold addresses, and with them itself. When nothing runs any more.
pub(crate) fn clear(env: &Env, nodes: &[Arc<dyn AnyNode>]) {
    nodes.iter().for_each(|node| node.clear());
    env.scheduler.timers.clear();
}
