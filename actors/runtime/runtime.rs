//! Building a system, running it from the main thread, and ending it.

pub(crate) mod config;
pub(crate) mod driver;
pub(crate) mod look;
pub(crate) mod shutdown;
pub(crate) mod snapshot;
pub(crate) mod timeline;
pub(crate) mod wiring;

use std::any::Any;
use std::io::Write;
use std::marker::PhantomData;
use std::sync::Arc;
use std::time::Duration;

use crate::actor::node::AnyNode;
use crate::journal::env::Env;
use crate::log::fingerprint::Fingerprint;
use crate::log::format::{Header, NODES_MAX, NodeInfo};
use crate::log::writer::Writer;
use crate::message::ActorId;
use crate::pool::AnyPool;
use crate::runtime::config::{BuildError, Config, Record};
use crate::runtime::driver::Driver;
use crate::runtime::shutdown::clear;
use crate::runtime::wiring::{PortNode, Wiring};
use crate::scheduler::clock::nanoseconds;
use crate::scheduler::link::{Class, Link};
use crate::scheduler::signals::signal;
use crate::scheduler::{ThreadCx, Threads};

/// How long [`Runtime::pump`] works.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limit {
    /// At most so long (of virtual time in a simulation).
    pub time: Option<Duration>,
    /// Until nothing is left to do and no timer runs.
    pub idle: bool,
}

impl Limit {
    /// Until nothing is left to do.
    pub const IDLE: Self = Self { time: None, idle: true };

    /// For so long, whether or not there is something to do.
    pub const fn time(time: Duration) -> Self {
        Self { time: Some(time), idle: false }
    }

    /// Until nothing is left to do, but at most so long.
    pub const fn idle_within(time: Duration) -> Self {
        Self { time: Some(time), idle: true }
    }
}

/// Why [`Runtime::pump`] returned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// Its time is over.
    Time,
    /// Nothing is left to do.
    Idle,
    /// The caller's condition holds.
    Until,
    /// Replay diverged or reached where it was to stop, or an invariant of the simulation broke.
    Halted,
    /// An actor panicked without which the system cannot go on ([`crate::OnPanic::End`]): [`Runtime::ended`] says
    /// which. [`Runtime::shutdown`] still ends everything in order, and the recording is whole.
    Ended,
}

/// A running system. It belongs to the thread that built it, which runs the pinned actors.
pub struct Runtime {
    pub(crate) env: Arc<Env>,
    pub(crate) nodes: Arc<[Arc<dyn AnyNode>]>,
    pub(crate) pools: Vec<Box<dyn AnyPool>>,
    pub(crate) threads: Option<Threads>,
    pub(crate) writer: Option<Writer>,
    pub(crate) driver: Option<Box<dyn Driver>>,
    /// What snapshots refer to.
    pub(crate) context: Option<Arc<dyn Any + Send + Sync>>,
    pub(crate) thread: ThreadCx,
    pub(crate) heavy_ns: u64,
    pub(crate) heavy_passed: u32,
    /// Another thread ends it.
    pub(crate) left: bool,
    /// A thread's property, so the system stays on it.
    stays: PhantomData<*const ()>,
}

/// A heavy turn waits at most for so many pumps that have no time for it.
const HEAVY_PASSED_MAX: u32 = 8;

impl Runtime {
    /// Wires a system and starts it.
    pub fn build<T>(config: Config, wire: impl FnOnce(&mut Wiring) -> T) -> Result<(Self, T), BuildError> {
        let (env, mut parts) = config.begin();
        let mut wiring = Wiring::new(&env, parts.ring_turns);
        let wired = wire(&mut wiring);
        let Wiring { infos, links, nodes, pools, context, .. } = wiring;
        if let Some(trace) = &env.trace {
            same_system(&trace.header().nodes, &infos)?;
        }
        env.set_nodes(infos.clone());
        let nodes: Arc<[Arc<dyn AnyNode>]> = nodes
            .into_iter()
            .zip(&infos)
            .map(|(node, info)| {
                assert!(
                    node.is_some() || info.class.is_none(),
                    "{} is declared and never spawned",
                    info.name
                );
                node.unwrap_or_else(|| Arc::new(PortNode::new(&env)))
            })
            .collect();
        pools.iter().for_each(|pool| pool.seal());
        let links: Vec<Arc<Link>> = links.into_iter().flatten().collect();
        let writer = match (parts.record, &env.log) {
            (Some(record), Some(log)) => {
                if infos.len() > NODES_MAX {
                    let reason = format!("it can name {NODES_MAX} actors and ports, not {}", infos.len());
                    return Err(BuildError::Record(std::io::Error::other(reason)));
                }
                let (application, seed, hashing) = (parts.application, env.seed, env.hashing);
                let fingerprint = Fingerprint::here(&parts.program);
                let asks = parts.driver.is_none();
                let header = Header { application, fingerprint, seed, hashing, nodes: infos.clone() };
                let sink: Box<dyn Write + Send> = match record {
                    Record::File(path) => Box::new(std::fs::File::create(path).map_err(BuildError::Record)?),
                    Record::Sink(sink) => sink,
                };
                Some(Writer::start(sink, &header, log, links.clone(), asks).map_err(BuildError::Record)?)
            }
            _ => None,
        };
        let classes: Vec<Option<Class>> = infos.iter().map(|info| info.class).collect();
        let thread = ThreadCx::outside();
        links.iter().for_each(|link| link.raise(signal::START, &thread));
        let restored = parts.from;
        if let Some(driver) = &mut parts.driver {
            driver.meet(&classes);
        }
        let mut runtime = Self {
            env,
            nodes,
            pools,
            threads: None,
            writer,
            driver: parts.driver,
            context,
            thread,
            heavy_ns: 0,
            heavy_passed: 0,
            left: false,
            stays: PhantomData,
        };
        if let Some(snapshot) = restored {
            runtime.restore(&snapshot).ok_or(BuildError::OtherSnapshot)?;
            // Before any thread begins.
            runtime.env.stop_behind(snapshot.positions());
        }
        let threads = Threads::start(&runtime.env.scheduler, &runtime.nodes, parts.locals, parts.gives_way);
        runtime.threads = Some(threads.map_err(BuildError::Threads)?);
        Ok((runtime, wired))
    }

    /// Works on the main thread until `limit`.
    pub fn pump(&mut self, limit: Limit) -> Exit {
        self.pump_until(limit, |_| false)
    }

    /// Works on the main thread until `limit`, or until `condition` holds; it is asked between turns of this thread.
    ///
    /// Without other threads everything is run here. Parks while there is nothing to do.
    pub fn pump_until(&mut self, limit: Limit, mut condition: impl FnMut(&Self) -> bool) -> Exit {
        let env = Arc::clone(&self.env);
        env.scheduler.enter_main();
        let end = limit.time.map(|time| env.scheduler.clock.now().saturating_add(nanoseconds(time)));
        let exit = match self.driver.take() {
            Some(mut driver) => {
                let exit = driver.drive(self, limit, end, &mut condition);
                self.driver = Some(driver);
                exit
            }
            None => self.work(limit, end, &mut condition),
        };
        self.thread.last_end.set(0);
        env.scheduler.leave_main();
        exit
    }

    fn work(&mut self, limit: Limit, end: Option<u64>, condition: &mut dyn FnMut(&Self) -> bool) -> Exit {
        let env = Arc::clone(&self.env);
        let alone = env.scheduler.threads() == 0;
        // The only other thread may be in a long turn.
        let serves = env.scheduler.threads() <= 1;
        loop {
            if env.scheduler.halted() {
                return Exit::Halted;
            }
            if env.ends() {
                return Exit::Ended;
            }
            if condition(self) {
                return Exit::Until;
            }
            let now = if end.is_some() || (serves && env.scheduler.timers.next() != u64::MAX) {
                env.scheduler.clock.now()
            } else {
                0
            };
            if serves {
                env.scheduler.timers.serve(now, &env.scheduler, &self.thread);
            }
            if end.is_some_and(|end| now >= end) {
                return Exit::Time;
            }
            let actor =
                env.scheduler.next_pinned().or_else(|| if alone { env.scheduler.next_light() } else { None });
            if let Some(actor) = actor {
                env.scheduler.run(&self.nodes, actor, &self.thread);
                continue;
            }
            // Alone, a heavy turn is begun only if the last ones say that there is time for it, or it waited long.
            if alone && env.scheduler.heavy_waits() {
                let fits = end.is_none_or(|end| now + self.heavy_ns <= end);
                if fits || self.heavy_passed >= HEAVY_PASSED_MAX {
                    if let Some(actor) = env.scheduler.next_heavy() {
                        let start = env.scheduler.clock.now();
                        env.scheduler.run(&self.nodes, actor, &self.thread);
                        self.heavy_ns = (self.heavy_ns * 3 + (env.scheduler.clock.now() - start)) / 4;
                        self.heavy_passed = 0;
                    }
                    continue;
                }
                self.heavy_passed += 1;
                return Exit::Time;
            }
            self.thread.last_end.set(0);
            let idle = || limit.idle && env.scheduler.settled();
            if idle() {
                return if env.scheduler.halted() { Exit::Halted } else { Exit::Idle };
            }
            let wake =
                end.unwrap_or(u64::MAX).min(if serves { env.scheduler.timers.next() } else { u64::MAX });
            let timeout = match wake {
                u64::MAX => Duration::MAX,
                wake => Duration::from_nanos(wake.saturating_sub(env.scheduler.clock.now())),
            };
            env.scheduler.park_main(timeout, || idle() || env.scheduler.halted() || env.ends());
        }
    }
}

/// Waits for turns that are under way, however long they take: [`Runtime::shutdown`] has a bound.
impl Drop for Runtime {
    fn drop(&mut self) {
        if self.left {
            return;
        }
        if self.threads.is_some() {
            self.stop(false);
        }
        clear(&self.env, &self.nodes);
    }
}

fn same_system(recorded: &[NodeInfo], found: &[NodeInfo]) -> Result<(), BuildError> {
    let name = |info: Option<&NodeInfo>| info.map_or_else(|| "missing".to_owned(), |info| info.name.clone());
    let length = recorded.len().max(found.len());
    match (0..length).find(|index| recorded.get(*index) != found.get(*index)) {
        None => Ok(()),
        Some(index) => Err(BuildError::OtherSystem {
            actor: ActorId(index as u32),
            recorded: name(recorded.get(index)),
            found: name(found.get(index)),
        }),
    }
}
