//! Simulation: the same actors on one thread under a virtual clock, scheduled and faulted by a seed.

use std::collections::VecDeque;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use crate::actor::Class;
use crate::message::{ActorId, Digest};
use crate::pool::PoolStats;
use crate::runtime::{Exit, Limit, Runtime};

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

/// What can go wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum FaultKind {
    /// A delivery panics before the actor sees it.
    Panic,
    /// A send or push comes back as if there was no room.
    Full,
    /// One turn comes a millisecond late.
    Delay,
    /// The actor hangs for 100 ms.
    Stall,
    /// Ten turns take 100 times as long.
    Slow,
    /// The recording's file ends at this byte. Of no actor: whoever gives the sink makes it so.
    TornLog,
    /// The disk that is recorded to has room for so many bytes. Of no actor, as above.
    DiskFull,
    /// A worker hangs at its next job from this delivery on, so that it loses its lease. Nothing where jobs have none.
    Hang,
}

/// One thing that goes wrong: at this delivery (panic, hang), send (full) or turn (delay, stall, slow) of this actor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Fault {
    /// Where.
    pub actor: ActorId,
    /// What.
    pub kind: FaultKind,
    /// When, from 0.
    pub at: u64,
}

/// Which faults a run has.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Faults {
    /// Exactly these.
    Listed(Vec<Fault>),
    /// Drawn by the seed: up to `each` of every kind for every actor, among its first `horizon` deliveries, sends or
    /// turns.
    Seeded {
        /// Kinds to draw.
        kinds: Vec<FaultKind>,
        /// At most so many of a kind for an actor.
        each: u64,
        /// None come later than this.
        horizon: u64,
    },
}

impl Faults {
    /// A run without faults.
    pub const NONE: Self = Self::Listed(Vec::new());

    /// The faults of one actor.
    pub fn of(&self, seed: u64, actor: ActorId) -> Vec<Fault> {
        match self {
            Self::Listed(faults) => faults.iter().filter(|fault| fault.actor == actor).copied().collect(),
            Self::Seeded { kinds, each, horizon } => {
                let mut faults = Vec::new();
                for kind in kinds {
                    let mut random = Random::new(&[seed, u64::from(actor.0), *kind as u64, 0xfa17]);
                    for _ in 0..random.below(each + 1) {
                        faults.push(Fault { actor, kind: *kind, at: random.below((*horizon).max(1)) });
                    }
                }
                faults
            }
        }
    }
}

/// How much virtual time work takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Work {
    /// Each turn takes a constant by its actor's class, and [`crate::Cx::measure`] finds nothing.
    #[default]
    Constant,
    /// Turns and what is measured in them take what the seed says, each another time.
    Seeded,
    /// Heavy turns and what is measured take the processor time that this thread really spends on them; light turns a
    /// constant. Such a run is never the same twice; its recording replays like any other.
    Measured,
}

impl Work {
    /// Duration number `count` under a seed, an eighth to sixteen times `nominal`.
    pub(crate) fn draw(seed: u64, count: u64, nominal: u64) -> u64 {
        let mut random = Random::new(&[seed, count, 0x71e5]);
        let least = (nominal / 8).max(1) << random.below(7);
        least + random.below(least)
    }
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

/// A stream of random numbers: hashes of a key and a counter.
pub(crate) struct Random {
    key: Digest,
    count: u64,
}

impl Random {
    pub(crate) fn new(key: &[u64]) -> Self {
        let mut digest = Digest::new();
        key.iter().for_each(|word| digest.u64(*word));
        Self { key: digest, count: 0 }
    }

    pub(crate) fn next(&mut self) -> u64 {
        self.count += 1;
        let mut hash = self.key;
        hash.u64(self.count);
        hash.u64(self.count ^ 0x5555);
        hash.finish()
    }

    /// A number below `end` (> 0).
    pub(crate) fn below(&mut self, end: u64) -> u64 {
        ((u128::from(self.next()) * u128::from(end)) >> 64) as u64
    }
}

/// Virtual time of one turn, in nanoseconds.
const LIGHT_NS: u64 = 1_000;
pub(crate) const HEAVY_NS: u64 = 500_000;
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
pub(crate) struct Driver {
    pub(crate) simulation: Simulation,
    random: Random,
    actors: Vec<Simulated>,
    runnable: Vec<u32>,
    /// Runnable, but not before this time.
    asleep: Vec<(u64, u32)>,
    change_points: Vec<u64>,
    victim: u32,
    next: u32,
    pub(crate) step: u64,
    /// What is left of an exhaustive seed, and the product of the numbers of choices so far.
    digits: u64,
    ways: u64,
    /// Turns that each actor made while a control message waited.
    unheard: Vec<u32>,
}

impl Driver {
    pub(crate) fn new(simulation: Simulation, classes: &[Option<Class>]) -> Self {
        let mut random = Random::new(&[simulation.seed, 0x5eed]);
        let mut actors = Vec::new();
        for (number, class) in classes.iter().enumerate() {
            let mut faults = simulation.faults.of(simulation.seed, ActorId(number as u32));
            faults
                .retain(|fault| matches!(fault.kind, FaultKind::Delay | FaultKind::Stall | FaultKind::Slow));
            faults.sort_by_key(|fault| fault.at);
            let class = class.unwrap_or(Class::Light);
            let priority = random.next() | 1 << 63;
            actors.push(Simulated { class, turns: 0, slow_turns: 0, priority, faults: faults.into() });
        }
        let change_points = match simulation.strategy {
            Strategy::Pct { depth, horizon } => (0..depth).map(|_| random.below(horizon.max(1))).collect(),
            _ => Vec::new(),
        };
        let victim = random.below(actors.len().max(1) as u64) as u32;
        let (runnable, asleep) = (Vec::new(), Vec::new());
        let (digits, unheard) = (simulation.seed, vec![0; actors.len()]);
        Self {
            simulation,
            random,
            actors,
            runnable,
            asleep,
            change_points,
            victim,
            next: 0,
            step: 0,
            digits,
            ways: 1,
            unheard,
        }
    }

    /// Takes over what became runnable.
    pub(crate) fn arrive(&mut self, actor: u32) {
        self.runnable.push(actor);
    }

    /// The earliest time at which a sleeper can run.
    pub(crate) fn next_wake(&self) -> Option<u64> {
        self.asleep.iter().map(|(time, _)| *time).min()
    }

    /// Chooses the actor of the next step at time `now`; none if nothing is runnable.
    pub(crate) fn choose(&mut self, now: u64) -> Option<u32> {
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
    pub(crate) fn turned(&mut self, actor: u32, measured: u64, spent: u64) -> u64 {
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
}

impl Runtime {
    pub(crate) fn simulate(
        &mut self,
        limit: Limit,
        end: Option<u64>,
        condition: &mut dyn FnMut(&Self) -> bool,
    ) -> Exit {
        let env = Arc::clone(&self.env);
        let Some(mut driver) = self.driver.take() else { return Exit::Idle };
        let exit = loop {
            if self.failure.is_some() {
                break Exit::Halted;
            }
            if env.ends() {
                break Exit::Ended;
            }
            if condition(self) {
                break Exit::Until;
            }
            let now = env.clock.now();
            if end.is_some_and(|end| now >= end) {
                break Exit::Time;
            }
            env.timers.serve(now, &env.scheduler, &self.thread);
            let queues = &env.scheduler;
            while let Some(actor) =
                queues.next_pinned().or_else(|| queues.next_light()).or_else(|| queues.next_heavy())
            {
                driver.arrive(actor);
            }
            let Some(actor) = driver.choose(now) else {
                let next = driver.next_wake().unwrap_or(u64::MAX).min(env.timers.next());
                if next == u64::MAX && limit.idle {
                    break Exit::Idle;
                }
                match (next.min(end.unwrap_or(u64::MAX)), next) {
                    // Nothing will ever happen, and the caller does not want to hear of idleness: time is over.
                    (u64::MAX, _) => break Exit::Idle,
                    (time, _) => env.clock.advance_to(time),
                }
                continue;
            };
            self.thread.last_end.set(0);
            let before = env.clock.spent();
            env.scheduler.run(&self.nodes, actor, &self.thread);
            let (measured, spent) = (env.clock.now() - now, env.clock.spent() - before);
            env.clock.advance_to(now + driver.turned(actor, measured, spent));
            let heard = self.hears(&mut driver, actor);
            if let Err(reason) = heard.and_then(|()| self.check(&mut driver)) {
                self.failure = Some(Failure { seed: driver.simulation.seed, step: driver.step, reason });
            }
        };
        self.driver = Some(driver);
        exit
    }

    /// The control lane is served before all else.
    fn hears(&self, driver: &mut Driver, actor: u32) -> Result<(), String> {
        let node = &self.nodes[actor as usize];
        let link = node.link();
        let deaf = link.closed.load(Ordering::Relaxed) || link.signals.is_parked();
        let turns = &mut driver.unheard[actor as usize];
        // One that came in the turn itself waits for the next.
        *turns = if node.urgent() > 0 && !deaf { *turns + 1 } else { 0 };
        if *turns > CONTROL_TURNS_MAX {
            return Err(format!(
                "{} made {turns} turns while a control message waited",
                self.env.name(link.id)
            ));
        }
        Ok(())
    }

    /// What an exhaustive seed was worth, once its run is over.
    pub fn schedule(&self) -> Schedule {
        self.driver.as_ref().map_or(Schedule { ways: 1, left: 0 }, |driver| Schedule {
            ways: driver.ways,
            left: driver.digits,
        })
    }

    fn check(&self, driver: &mut Driver) -> Result<(), String> {
        for pool in &self.pools {
            let PoolStats { pushed, completed, stale, dead, waiting, disorder, .. } = pool.stats();
            if disorder > 0 {
                return Err("a job was popped while a better one waited".to_owned());
            }
            if pushed != completed + stale + dead + waiting {
                return Err(format!(
                    "jobs are lost or counted twice: {pushed} pushed, {completed} done, {stale} stale, {dead} dead, \
                     {waiting} wait"
                ));
            }
        }
        if driver.step >= driver.simulation.steps_max {
            return Err(format!("the system is not at rest after {} steps", driver.step));
        }
        match &mut driver.simulation.invariant {
            Some(invariant) => invariant(self),
            None => Ok(()),
        }
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
