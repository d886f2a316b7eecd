//! Simulation: the same actors on one thread under a virtual clock, scheduled and faulted by a seed.

use std::any::Any;
use std::collections::VecDeque;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use crate::message::ActorId;
use crate::pool::PoolStats;
use crate::runtime::config::{Config, Mode, Steering};
use crate::runtime::{Exit, Limit, Runtime, driver};
use crate::scheduler::clock::Clock;
use crate::scheduler::link::Class;
use crate::scheduler::work::{HEAVY_NS, Random};

pub use crate::journal::faults::{Fault, FaultKind, Faults};
pub use crate::scheduler::work::Work;

/// Who runs next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Strategy {
    /// Any runnable actor, each as likely.
    Random,
    /// Random priorities, and so many moments at which the actor at hand falls behind all others: finds rare orders
    /// with a known probability (Burckhardt et al. 2010, probabilistic concurrency testing).
    Pct {
        /// Change points.
        depth: u32,
        /// Steps among which they are drawn.
        horizon: u64,
    },
    /// Each in turn.
    RoundRobin,
    /// One actor, drawn by the seed, runs only when nothing else can, or every 1000th step.
    StarveOne,
    /// The seed's digits are the choices, the first step's first: seeds from 0 on are all schedules, those that deviate
    /// early before the others. See [`exhaust`].
    Exhaustive,
}

/// Checks the whole system between two steps.
pub type Invariant = Box<dyn FnMut(&Runtime) -> Result<(), String>>;

/// How to simulate.
pub struct Simulation {
    /// Decides everything that is open.
    pub seed: u64,
    /// Who runs next.
    pub strategy: Strategy,
    /// What goes wrong.
    pub faults: Faults,
    /// What turns take.
    pub work: Work,
    /// Steps (turns of one message) after which a system that still works has not come to rest.
    pub steps_max: u64,
    /// The application's own invariant, checked after each step.
    pub invariant: Option<Invariant>,
}

impl Simulation {
    /// Random scheduling, no faults, turns of constant length, a million steps.
    pub fn new(seed: u64) -> Self {
        Self {
            seed,
            strategy: Strategy::Random,
            faults: Faults::NONE,
            work: Work::Constant,
            steps_max: 1_000_000,
            invariant: None,
        }
    }
}

/// A broken invariant, with what it takes to see it again.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// The seed of the run.
    pub seed: u64,
    /// The step after which it showed.
    pub step: u64,
    /// What is wrong.
    pub reason: String,
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "seed {:#x}, step {}: {}", self.seed, self.step, self.reason)
    }
}

/// Leaves out faults as long as the run still fails: first halves, then ever smaller parts, at last single ones
/// (Zeller & Hildebrandt 2002, delta debugging).
pub fn shrink(faults: &[Fault], mut fails: impl FnMut(&[Fault]) -> bool) -> Vec<Fault> {
    let mut kept = faults.to_vec();
    let mut part = kept.len().div_ceil(2);
    while part > 0 && !kept.is_empty() {
        let mut start = 0;
        while start < kept.len() {
            let end = (start + part).min(kept.len());
            let fewer = [&kept[..start], &kept[end..]].concat();
            if fails(&fewer) {
                kept = fewer;
            } else {
                start = end;
            }
        }
        part = if part == 1 { 0 } else { part.div_ceil(2) };
    }
    kept
}

/// What an exhaustive seed was worth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Schedule {
    /// Product of the numbers of choices on the way: seeds from here on branch no further on it.
    pub ways: u64,
    /// Not 0: the system came to rest before all digits were used, so a smaller seed is the same schedule.
    pub left: u64,
}

/// How far [`exhaust`] came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Exhausted {
    /// Different schedules that were run.
    pub schedules: u64,
    /// These were all.
    pub complete: bool,
}

/// Runs a small system under every schedule, or under the first `runs`: `run` simulates a seed with
/// [`Strategy::Exhaustive`] and returns its [`Runtime::schedule`].
pub fn exhaust(runs: u64, mut run: impl FnMut(u64) -> Schedule) -> Exhausted {
    let (mut seed, mut end, mut schedules) = (0, 1, 0);
    // A schedule whose last deviation is at step k has a seed below the choices up to k of the one that does not
    // deviate there, which is smaller: so the end is known in time.
    while seed < end && seed < runs {
        let Schedule { ways, left } = run(seed);
        schedules += u64::from(left == 0);
        end = end.max(ways);
        seed += 1;
    }
    Exhausted { schedules, complete: seed >= end }
}

/// Virtual time of one light turn, in nanoseconds.
const LIGHT_NS: u64 = 1_000;
const DELAY_NS: u64 = 1_000_000;
const STALL_NS: u64 = 100_000_000;
const SLOW_TURNS: u64 = 10;
const SLOW_FACTOR: u64 = 100;
/// Turns that a control message may wait for.
const CONTROL_TURNS_MAX: u32 = 1;

struct Simulated {
    class: Class,
    turns: u64,
    slow_turns: u64,
    priority: u64,
    /// Delays, stalls and slow phases to come, by turn.
    faults: VecDeque<Fault>,
}

/// The scheduler's seat in a simulation.
struct Simulator {
    simulation: Simulation,
    random: Random,
    actors: Vec<Simulated>,
    runnable: Vec<u32>,
    /// Runnable, but not before this time.
    asleep: Vec<(u64, u32)>,
    change_points: Vec<u64>,
    victim: u32,
    next: u32,
    step: u64,
    /// What is left of an exhaustive seed, and the product of the numbers of choices so far.
    digits: u64,
    ways: u64,
    /// Turns that each actor made while a control message waited.
    unheard: Vec<u32>,
    failure: Option<Failure>,
}

impl Simulator {
    fn new(simulation: Simulation) -> Self {
        Self {
            random: Random::new(&[simulation.seed, 0x5eed]),
            digits: simulation.seed,
            simulation,
            actors: Vec::new(),
            runnable: Vec::new(),
            asleep: Vec::new(),
            change_points: Vec::new(),
            victim: 0,
            next: 0,
            step: 0,
            ways: 1,
            unheard: Vec::new(),
            failure: None,
        }
    }

    fn of(runtime: &Runtime) -> Option<&Self> {
        let driver: &dyn Any = &**runtime.driver.as_ref()?;
        driver.downcast_ref()
    }

    /// Takes over what became runnable.
    fn arrive(&mut self, actor: u32) {
        self.runnable.push(actor);
    }

    /// The earliest time at which a sleeper can run.
    fn next_wake(&self) -> Option<u64> {
        self.asleep.iter().map(|(time, _)| *time).min()
    }

    /// Chooses the actor of the next step at time `now`; none if nothing is runnable.
    fn choose(&mut self, now: u64) -> Option<u32> {
        let mut index = 0;
        while index < self.asleep.len() {
            if self.asleep[index].0 <= now {
                self.runnable.push(self.asleep.remove(index).1);
            } else {
                index += 1;
            }
        }
        while !self.runnable.is_empty() {
            let chosen = self.pick();
            let actor = self.runnable.swap_remove(chosen);
            let state = &mut self.actors[actor as usize];
            let Some(fault) = state.faults.front().filter(|fault| fault.at <= state.turns).copied() else {
                return Some(actor);
            };
            state.faults.pop_front();
            match fault.kind {
                FaultKind::Slow => {
                    state.slow_turns = SLOW_TURNS;
                    return Some(actor);
                }
                FaultKind::Stall => self.asleep.push((now + STALL_NS, actor)),
                _ => self.asleep.push((now + DELAY_NS, actor)),
            }
        }
        None
    }

    fn pick(&mut self) -> usize {
        let count = self.runnable.len() as u64;
        let first = |key: &dyn Fn(u32) -> u64, runnable: &[u32]| {
            (0..runnable.len()).min_by_key(|index| (key(runnable[*index]), runnable[*index])).unwrap_or(0)
        };
        match self.simulation.strategy {
            Strategy::Random => self.random.below(count) as usize,
            Strategy::RoundRobin => {
                let total = self.actors.len() as u32;
                let next = self.next;
                let chosen = first(&|actor| u64::from((actor + total - next) % total), &self.runnable);
                self.next = (self.runnable[chosen] + 1) % total;
                chosen
            }
            Strategy::Pct { .. } => {
                let highest = |actors: &[Simulated], runnable: &[u32]| {
                    first(&|actor| u64::MAX - actors[actor as usize].priority, runnable)
                };
                let chosen = highest(&self.actors, &self.runnable);
                if !self.change_points.contains(&self.step) {
                    return chosen;
                }
                // All initial priorities have the top bit; later changes go below earlier ones.
                self.actors[self.runnable[chosen] as usize].priority = (1 << 62) - self.step.min(1 << 61);
                highest(&self.actors, &self.runnable)
            }
            Strategy::Exhaustive => {
                let (digit, rest) = (self.digits % count, self.digits / count);
                (self.digits, self.ways) = (rest, self.ways.saturating_mul(count));
                // In the order of identities, whatever the queues' order is.
                let mut order: Vec<usize> = (0..self.runnable.len()).collect();
                order.sort_by_key(|index| self.runnable[*index]);
                order[digit as usize]
            }
            Strategy::StarveOne => {
                if self.step % 1000 == 999 {
                    return self.random.below(count) as usize;
                }
                let chosen = self.random.below(count) as usize;
                if self.runnable[chosen] != self.victim {
                    return chosen;
                }
                (chosen + 1) % self.runnable.len()
            }
        }
    }

    /// A turn of `actor` was made, in which so much was `measured`, with so much processor time `spent`; returns the
    /// virtual time it took.
    fn turned(&mut self, actor: u32, measured: u64, spent: u64) -> u64 {
        self.step += 1;
        let state = &mut self.actors[actor as usize];
        state.turns += 1;
        let heavy = state.class == Class::Heavy;
        let nominal = if heavy { HEAVY_NS } else { LIGHT_NS };
        let time = match self.simulation.work {
            Work::Seeded if measured > 0 => measured,
            // Beside those that are measured, which have small numbers.
            Work::Seeded => Work::draw(self.simulation.seed, 1 << 63 | self.step, nominal),
            Work::Measured if heavy => spent.max(measured),
            Work::Constant | Work::Measured => nominal.max(measured),
        };
        if state.slow_turns == 0 {
            return time;
        }
        state.slow_turns -= 1;
        time * SLOW_FACTOR
    }

    /// The control lane is served before all else.
    fn hears(&mut self, runtime: &Runtime, actor: u32) -> Result<(), String> {
        let node = &runtime.nodes[actor as usize];
        let link = node.link();
        let deaf = link.closed.load(Ordering::Relaxed) || link.signals.is_parked();
        let turns = &mut self.unheard[actor as usize];
        // One that came in the turn itself waits for the next.
        *turns = if node.urgent() > 0 && !deaf { *turns + 1 } else { 0 };
        if *turns > CONTROL_TURNS_MAX {
            return Err(format!("{} made {turns} turns while a control message waited", link.name));
        }
        Ok(())
    }

    fn check(&mut self, runtime: &Runtime) -> Result<(), String> {
        for pool in &runtime.pools {
            let PoolStats { pushed, completed, stale, dead, waiting, kept, twice, disorder, .. } =
                pool.stats();
            if disorder > 0 {
                return Err("a job was popped while a better one waited".to_owned());
            }
            if pushed + twice != completed + stale + dead + waiting + kept {
                return Err(format!(
                    "jobs are lost or counted twice: {pushed} pushed, {completed} done, {stale} stale, {dead} dead, \
                     {waiting} wait, {kept} kept, {twice} twice"
                ));
            }
        }
        if self.step >= self.simulation.steps_max {
            return Err(format!("the system is not at rest after {} steps", self.step));
        }
        match &mut self.simulation.invariant {
            Some(invariant) => invariant(runtime),
            None => Ok(()),
        }
    }
}

impl driver::Driver for Simulator {
    fn clock(&self) -> Clock {
        Clock::starting_at_zero(self.simulation.work, self.simulation.seed)
    }

    fn faults(&self) -> Faults {
        self.simulation.faults.clone()
    }

    fn meet(&mut self, classes: &[Option<Class>]) {
        for (number, class) in classes.iter().enumerate() {
            let mut faults = self.simulation.faults.of(self.simulation.seed, ActorId(number as u32));
            faults
                .retain(|fault| matches!(fault.kind, FaultKind::Delay | FaultKind::Stall | FaultKind::Slow));
            faults.sort_by_key(|fault| fault.at);
            let class = class.unwrap_or(Class::Light);
            let priority = self.random.next() | 1 << 63;
            self.actors.push(Simulated { class, turns: 0, slow_turns: 0, priority, faults: faults.into() });
        }
        if let Strategy::Pct { depth, horizon } = self.simulation.strategy {
            self.change_points = (0..depth).map(|_| self.random.below(horizon.max(1))).collect();
        }
        self.victim = self.random.below(self.actors.len().max(1) as u64) as u32;
        self.unheard = vec![0; self.actors.len()];
    }

    fn drive(
        &mut self,
        runtime: &mut Runtime,
        limit: Limit,
        end: Option<u64>,
        condition: &mut dyn FnMut(&Runtime) -> bool,
    ) -> Exit {
        let env = Arc::clone(&runtime.env);
        let queues = &*env.scheduler;
        loop {
            if self.failure.is_some() {
                return Exit::Halted;
            }
            if env.ends() {
                return Exit::Ended;
            }
            if condition(runtime) {
                return Exit::Until;
            }
            let now = queues.clock.now();
            if end.is_some_and(|end| now >= end) {
                return Exit::Time;
            }
            queues.timers.serve(now, queues, &runtime.thread);
            while let Some(actor) =
                queues.next_pinned().or_else(|| queues.next_light()).or_else(|| queues.next_heavy())
            {
                self.arrive(actor);
            }
            let Some(actor) = self.choose(now) else {
                let next = self.next_wake().unwrap_or(u64::MAX).min(queues.timers.next());
                if next == u64::MAX && limit.idle {
                    return Exit::Idle;
                }
                match (next.min(end.unwrap_or(u64::MAX)), next) {
                    // Nothing will ever happen, and the caller does not want to hear of idleness: time is over.
                    (u64::MAX, _) => return Exit::Idle,
                    (time, _) => queues.clock.advance_to(time),
                }
                continue;
            };
            runtime.thread.last_end.set(0);
            let before = queues.clock.spent();
            queues.run(&runtime.nodes, actor, &runtime.thread);
            let (measured, spent) = (queues.clock.now() - now, queues.clock.spent() - before);
            queues.clock.advance_to(now + self.turned(actor, measured, spent));
            let heard = self.hears(runtime, actor);
            if let Err(reason) = heard.and_then(|()| self.check(runtime)) {
                self.failure = Some(Failure { seed: self.simulation.seed, step: self.step, reason });
            }
        }
    }
}

impl Config {
    /// A simulation.
    pub fn simulate(simulation: Simulation) -> Self {
        let seed = simulation.seed;
        let mode = Mode::Simulate(Steering(Box::new(Simulator::new(simulation))));
        Self { mode, seed, ..Self::live(0) }
    }
}

impl Runtime {
    /// The broken invariant that ended a simulation.
    pub fn failure(&self) -> Option<&Failure> {
        Simulator::of(self)?.failure.as_ref()
    }

    /// What an exhaustive seed was worth, once its run is over.
    pub fn schedule(&self) -> Schedule {
        Simulator::of(self)
            .map_or(Schedule { ways: 1, left: 0 }, |run| Schedule { ways: run.ways, left: run.digits })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shrinking_keeps_exactly_what_matters() {
        let fault = |at| Fault { actor: ActorId(0), kind: FaultKind::Panic, at };
        let all: Vec<Fault> = (0..37).map(fault).collect();
        let needed = [fault(5), fault(30)];
        let kept = shrink(&all, |faults| needed.iter().all(|fault| faults.contains(fault)));
        assert_eq!(kept, needed);
        assert!(shrink(&all, |_| true).is_empty());
    }

    #[test]
    fn random_numbers_spread() {
        let mut random = Random::new(&[1]);
        let mut counts = [0; 10];
        (0..10_000).for_each(|_| counts[random.below(10) as usize] += 1);
        assert!(counts.iter().all(|count| (900..1100).contains(count)), "{counts:?}");
    }
}
