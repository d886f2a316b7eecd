//! Looking at a running system from the main thread.

use std::any::Any;
use std::time::Duration;

use crate::actor::{Actor, Handle};
use crate::log::format::NodeInfo;
use crate::log::writer::RecordingStatus;
use crate::message::content::Content;
use crate::message::incident::Incident;
use crate::message::{ActorId, Digest};
use crate::runtime::Runtime;
use crate::runtime::timeline::{Timeline, of_turns};
use crate::scheduler::clock::{Time, nanoseconds};
use crate::scheduler::link::{Class, Control};
use crate::scheduler::profile::{ActorCounters, TurnTime};

/// A live system need never come to rest.
const LIVE_SETTLE_MAX: Duration = Duration::from_secs(10);

impl Runtime {
    /// Looks at an actor's state: a pinned one's at any time, any one's if the main thread is alone.
    pub fn inspect<A: Actor, R>(&self, handle: Handle<A>, look: impl FnOnce(&A) -> R) -> Option<R> {
        let node = self.nodes.get(handle.id.0 as usize)?;
        let here =
            node.link().class == Class::Pinned || self.env.scheduler.threads() == 0 || self.threads.is_none();
        if !here {
            return None;
        }
        let (mut look, mut result) = (Some(look), None);
        node.look(&mut |actor: &dyn Any| {
            result = actor.downcast_ref::<A>().and_then(|actor| look.take().map(|look| look(actor)));
        });
        result
    }

    /// What an actor tells of its state; `None` of ports. No turn runs meanwhile: see [`Runtime::held`].
    pub fn content(&self, actor: ActorId) -> Option<Content> {
        let node = self.nodes.get(actor.0 as usize)?;
        self.held(|_| node.content())
    }

    /// Looks at a system in which no turn runs meanwhile: those of other threads end at their next delivery, and are gone on
    /// with after it. Call it on the main thread, between turns. What takes long stays in its turn: a live system then goes on
    /// after ten seconds.
    pub fn held<R>(&self, look: impl FnOnce(&Self) -> R) -> R {
        if self.threads.is_none() || self.threads() == 0 {
            return look(self);
        }
        let is_first = self.env.scheduler.hold();
        match self.env.replaying() {
            true => self.settle(),
            false => self.settle_within(LIVE_SETTLE_MAX),
        }
        let found = look(self);
        if is_first {
            self.env.scheduler.let_go();
        }
        found
    }

    /// Orders an actor to stop, pause or resume.
    pub fn control<A>(&self, handle: Handle<A>, control: Control) {
        if !self.env.replaying()
            && let Some(node) = self.nodes.get(handle.id.0 as usize)
        {
            node.link().control(control, &self.thread);
        }
    }

    /// From now on heavy turns leave so many of the machine's processors to others: to the main thread, and to threads that
    /// work for it, where it has something to show at a time. One heavy turn may always run. Turns that are under way are
    /// not broken off.
    pub fn leave_cores(&self, cores: usize) {
        self.env.scheduler.leave_cores(cores);
    }

    /// Time since the system was built, virtual in a simulation.
    pub fn now(&self) -> Time {
        Time(self.env.scheduler.clock.now())
    }

    /// When the next timer is due: an event loop of one's own that works alone must pump again by then.
    pub fn next_timer(&self) -> Option<Time> {
        let next = self.env.scheduler.timers.next();
        (next != u64::MAX).then_some(Time(next))
    }

    /// Threads beside the main one.
    pub fn threads(&self) -> usize {
        self.env.scheduler.threads()
    }

    /// Names and classes of all actors and ports, by identity.
    pub fn actors(&self) -> &[NodeInfo] {
        self.env.nodes()
    }

    /// Counters of each actor, by identity; those of ports stay zero.
    pub fn counters(&self) -> Vec<ActorCounters> {
        let nodes = self.nodes.iter().zip(self.actors());
        nodes
            .map(|(node, info)| ActorCounters {
                depth: node.depth() as u64,
                ..node.link().counters.read(&info.name)
            })
            .collect()
    }

    /// Deliveries to all actors.
    pub fn deliveries(&self) -> u64 {
        self.nodes.iter().map(|node| node.link().counters.deliveries()).sum()
    }

    /// The turns still in each actor's ring.
    pub fn turn_times(&self) -> Vec<(String, Vec<TurnTime>)> {
        let nodes = self.nodes.iter().zip(self.actors());
        nodes.map(|(node, info)| (info.name.clone(), node.link().counters.turn_times())).collect()
    }

    /// The same on a line of time.
    pub fn timeline(&self) -> Timeline {
        of_turns(&self.turn_times())
    }

    /// How the recording is doing.
    pub fn recording(&self) -> RecordingStatus {
        self.env.log.as_ref().map_or(RecordingStatus::Off, |log| log.status())
    }

    /// Deliveries and chained hash of each actor, when nothing runs; zeros for ports. Two runs with equal positions
    /// delivered the same messages in the same order to every actor.
    ///
    /// Waits until no turn runs on another thread: in a live system at most for ten seconds, and whoever is in a turn
    /// then has zeros. What waits for the main thread goes on waiting.
    pub fn positions(&self) -> Vec<(u64, u64)> {
        if self.env.replaying() {
            self.settle();
        } else {
            self.settle_within(LIVE_SETTLE_MAX);
        }
        self.held(|_| self.nodes.iter().map(|node| node.position().unwrap_or_default()).collect())
    }

    /// One hash of all [`Runtime::positions`].
    pub fn fingerprint(&self) -> u64 {
        let mut digest = Digest::new();
        for (deliveries, chain) in self.positions() {
            digest.u64(deliveries);
            digest.u64(chain);
        }
        digest.finish()
    }

    /// What the system ends for, if it does.
    pub fn ended(&self) -> Option<&Incident> {
        self.env.ended()
    }

    /// What went wrong since the last call, whether an actor was told of it or none can be; at most the last 64.
    pub fn incidents(&self) -> Vec<Incident> {
        self.env.scheduler.incidents()
    }

    /// Whether a replay has diverged; [`Runtime::replay_report`] says where.
    pub fn diverged(&self) -> bool {
        self.env.has_diverged()
    }

    /// Waits until no turn runs: they end soon after a halt.
    pub(crate) fn settle(&self) {
        self.settle_within(Duration::MAX);
    }

    /// The same, at most for so long.
    pub(crate) fn settle_within(&self, time: Duration) {
        // A main thread that works alone is the only one to run turns, and it is here.
        let others = self.threads.is_some() && self.threads() > 0;
        let scheduler = &self.env.scheduler;
        let end = scheduler.clock.now().saturating_add(nanoseconds(time));
        while others && scheduler.busy() && scheduler.clock.now() < end {
            std::thread::park_timeout(Duration::from_micros(100));
        }
    }
}
