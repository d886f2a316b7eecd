//! Replay: every actor is delivered what its recording says, in that order, from messages that are made anew.

use std::sync::atomic::Ordering;

use crate::actor::node::ScriptState;
use crate::journal::divergence::{Divergence, Said, Until};
use crate::log::format::lane;
use crate::message::ActorId;
use crate::runtime::{Limit, Runtime};
use crate::scheduler::signals::signal;

/// How a replay went.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReplayReport {
    /// Deliveries made.
    pub deliveries: u64,
    /// Deliveries recorded.
    pub recorded: u64,
    /// The first difference, if there is one.
    pub divergence: Option<Divergence>,
    /// All of a recording that ended in order was replayed.
    pub complete: bool,
    /// What is different here from where it was recorded, if anything is: see [`crate::Fingerprint`].
    pub foreign: Option<String>,
    /// Actors whose recording goes on, although what comes next depends on a part that was cut off.
    pub waiting: Vec<ActorId>,
}

impl Runtime {
    /// Replays to the end of the recording, or to where it was to stop.
    pub fn replay(&mut self) -> ReplayReport {
        self.set_limits(|_| u64::MAX);
        self.pump(Limit::IDLE);
        self.replay_report()
    }

    /// How the replay stands; call it when [`Runtime::pump`] returned idle or halted.
    pub fn replay_report(&mut self) -> ReplayReport {
        self.settle();
        let env = &self.env;
        let mut report = ReplayReport {
            deliveries: 0,
            recorded: 0,
            divergence: env.first_divergence(),
            complete: false,
            foreign: env.foreign.clone(),
            waiting: Vec::new(),
        };
        let states: Vec<_> = self.nodes.iter().map(|node| node.script_state()).collect();
        for (number, state) in states.iter().enumerate() {
            let Some(state) = state else { continue };
            let actor = ActorId(number as u32);
            report.deliveries += state.made;
            report.recorded += state.recorded;
            if state.waits_for.is_some() {
                report.waiting.push(actor);
            }
            if let Some((expected, found)) = state.wrong_end
                && report.divergence.is_none()
            {
                let (expected, found) = (format!("hash {expected:016x} at the end"), format!("{found:016x}"));
                report.divergence = Some(self.stop_divergence(actor, state.made, None, expected, found));
            }
        }
        let halted = env.scheduler.halted();
        let whole = env.trace.as_ref().is_some_and(|trace| trace.complete());
        if !halted && report.divergence.is_none() && !report.waiting.is_empty() {
            report.divergence = self.stall(&report.waiting, &states, whole);
        }
        report.complete = whole && report.divergence.is_none() && report.waiting.is_empty();
        report
    }

    /// All are idle and a script goes on. In a recording that was cut, that is its consistent end if the wait leads to
    /// an actor whose script is over; otherwise somebody did not send what was recorded.
    fn stall(&self, waiting: &[ActorId], states: &[Option<ScriptState>], whole: bool) -> Option<Divergence> {
        let ends_in_cut = |mut actor: ActorId| {
            for _ in 0..=states.len() {
                match states.get(actor.0 as usize).copied().flatten() {
                    Some(state) => match state.waits_for {
                        Some((None, _)) => return true,
                        Some((Some(from), _)) if from != actor => actor = from,
                        Some(_) => return false,
                        None => return true,
                    },
                    None => return true,
                }
            }
            false
        };
        let stuck = |actor: &&ActorId| whole || !ends_in_cut(**actor);
        let actor = *waiting.iter().find(stuck)?;
        let state = states.get(actor.0 as usize).copied().flatten()?;
        let (from, way) = state.waits_for?;
        let sender =
            from.map_or_else(|| "somebody".to_owned(), |from| format!("{} {from}", self.env.name(from)));
        let expected = format!("{} from {sender}", lane::name(way));
        let found = "nothing: all actors are idle".to_owned();
        Some(self.stop_divergence(actor, state.made, from, expected, found))
    }

    fn stop_divergence(
        &self,
        actor: ActorId,
        index: u64,
        from: Option<ActorId>,
        expected: String,
        found: String,
    ) -> Divergence {
        let (name, mark) = (self.env.name(actor), self.env.last_mark());
        Divergence {
            actor,
            name,
            index,
            mark,
            kind: "stall",
            from,
            expected,
            found,
            said: None,
            turns: Vec::new(),
        }
    }

    /// All that was said in the delivery of [`Config::listen_to`](crate::Config::listen_to), as recorded; none before
    /// the replay has come there.
    pub fn heard(&self) -> Option<&[Said]> {
        self.env.heard()
    }

    /// Goes on after [`Until`] stopped the replay, to another place or to the end.
    pub fn resume(&mut self, until: Option<Until>) {
        self.settle();
        self.env.set_until(until);
        self.set_limits(|_| u64::MAX);
        self.env.scheduler.go_on();
    }

    fn set_limits(&self, limit: impl Fn(usize) -> u64) {
        let actors = self.actors().iter().zip(self.nodes.iter()).enumerate();
        for (actor, (_, node)) in actors.filter(|(_, (info, _))| info.class.is_some()) {
            let link = node.link();
            link.limit.store(limit(actor), Ordering::SeqCst);
            // Whoever waited at its limit looks again.
            link.raise(signal::FLUSH, &self.thread);
        }
    }

    /// Makes exactly the deliveries of `cut` (how many to each actor, by identity) that are not made yet. True if they
    /// were made: a cut that ends between a message and its cause cannot be reached, nor can one behind the replay.
    ///
    /// Other threads begin as soon as the system is built: give it none, or an [`Until`], to be before the cut here.
    pub fn run_to(&mut self, cut: &[u64]) -> bool {
        self.run_within(cut, None);
        let positions = self.positions();
        positions.iter().zip(cut).all(|((deliveries, _), end)| deliveries == end)
    }

    /// The same, stopping at `until` if that comes before.
    pub fn run_within(&mut self, cut: &[u64], until: Option<Until>) {
        self.settle();
        self.env.set_until(until);
        self.set_limits(|actor| cut.get(actor).copied().unwrap_or(0));
        self.env.scheduler.go_on();
        self.pump(Limit::IDLE);
    }

    /// Makes one delivery and returns its actor; none if there is none to make. Of the actors that can go on, the one
    /// goes that has the least of its recording behind it, so steps come about as they came when it was recorded, and
    /// in the same order wherever one begins. Where `within` is given, no actor goes beyond it.
    pub fn step(&mut self, within: Option<&[u64]>) -> Option<ActorId> {
        self.settle();
        let before: Vec<u64> = self.positions().into_iter().map(|(deliveries, _)| deliveries).collect();
        // First all that have not started do so.
        self.run_to(&before);
        let end = |actor: usize| {
            let recorded = self.env.trace.as_ref().map_or(0, |trace| trace.deliveries(ActorId(actor as u32)));
            recorded.min(within.and_then(|cut| cut.get(actor).copied()).unwrap_or(u64::MAX))
        };
        let recorded = |actor: usize| {
            self.env.trace.as_ref().map_or(1, |trace| trace.deliveries(ActorId(actor as u32))).max(1)
        };
        let mut order: Vec<usize> = (0..before.len()).filter(|actor| before[*actor] < end(*actor)).collect();
        order.sort_by(|a, b| {
            let behind =
                |actor: usize, other: usize| u128::from(before[actor] + 1) * u128::from(recorded(other));
            behind(*a, *b).cmp(&behind(*b, *a)).then(a.cmp(b))
        });
        for actor in order {
            let mut cut = before.clone();
            cut[actor] += 1;
            if self.run_to(&cut) || self.diverged() {
                return Some(ActorId(actor as u32));
            }
        }
        None
    }
}
