//! Building a system, running it from the main thread, and ending it.

use crossbeam_queue::ArrayQueue;
use std::any::Any;
use std::collections::VecDeque;
use std::fmt;
use std::io::Write;
use std::marker::PhantomData;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use crate::activation::Activation;
use crate::actor::{Actor, Class, Control, Delivery, post};
use crate::clock::{Clock, Time, nanoseconds};
use crate::journal::Journal;
use crate::log::format::{Hashing, Header, NodeInfo};
use crate::log::reader::Trace;
use crate::log::writer::{LogQueue, RecordingStatus, Writer};
use crate::mailbox::{Address, Bounds, Link, Mailbox, signal};
use crate::message::{ActorId, Digest, Message};
use crate::node::{Node, Runnable};
use crate::pool::{AnyPool, Job, JobPool, PoolStats, Seat, Worker};
use crate::port::{External, Port};
use crate::profile::{ActorCounters, Counters, RING_TURNS, TurnTime, chrome_trace};
use crate::replay::{Divergence, ReplayReport, Script, Until};
use crate::scheduler::{Scheduler, ThreadCx, Threads};
use crate::simulate::{Driver, Failure, FaultKind, Faults, Simulation};
use crate::supervise::{Incident, OnPanic};
use crate::timer::Timers;

/// How a turn is bounded: the actor goes to the back of the queue after either.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Budget {
    /// Messages.
    pub messages: u64,
    /// Nanoseconds.
    pub nanoseconds: u64,
}

impl Default for Budget {
    fn default() -> Self {
        Self { messages: 128, nanoseconds: 200_000 }
    }
}

/// Sees every delivery, on the thread that makes it.
pub type Observer = Arc<dyn Fn(&Delivery<'_>) + Send + Sync>;

/// Where a recording goes.
pub enum Record {
    /// Into a file, which is replaced.
    File(PathBuf),
    /// Anywhere else.
    Sink(Box<dyn Write + Send>),
}

/// What drives the system.
pub enum Mode {
    /// Threads, clock and input are real.
    Live,
    /// Everything comes from a recording.
    Replay {
        /// The recording.
        trace: Arc<Trace>,
        /// Where to stop before its end.
        until: Option<Until>,
    },
    /// One thread and a virtual clock.
    Simulate(Simulation),
}

/// How to build a system.
pub struct Config {
    /// Threads beside the main one (at most 64; a simulation uses none). With 0 the main thread does everything.
    pub threads: usize,
    /// What drives the system.
    pub mode: Mode,
    /// Where to record, if at all.
    pub record: Option<Record>,
    /// How densely hashes are recorded. Replay takes it from the recording; without a recording nothing is hashed,
    /// except in a simulation.
    pub hashing: Hashing,
    /// The application's part of a recording's header.
    pub application: Vec<u8>,
    /// Seed of [`crate::Cx::random`]. Replay takes it from the recording.
    pub seed: u64,
    /// Bounds of a turn.
    pub budget: Budget,
    /// Turns kept in each actor's ring.
    pub ring_turns: usize,
    /// Sees every delivery.
    pub observer: Option<Observer>,
    /// Called when the main thread is not in [`Runtime::pump`] and a pinned actor has something to do: wake the event
    /// loop here.
    pub waker: Option<Box<dyn Fn() + Send + Sync>>,
}

impl Config {
    /// A live system with so many threads beside the main one, not recorded.
    pub fn live(threads: usize) -> Self {
        Self {
            threads,
            mode: Mode::Live,
            record: None,
            hashing: Hashing::Exact,
            application: Vec::new(),
            seed: 0,
            budget: Budget::default(),
            ring_turns: RING_TURNS,
            observer: None,
            waker: None,
        }
    }

    /// A replay on so many threads beside the main one.
    pub fn replay(trace: Arc<Trace>, threads: usize) -> Self {
        Self { mode: Mode::Replay { trace, until: None }, ..Self::live(threads) }
    }

    /// A simulation.
    pub fn simulate(simulation: Simulation) -> Self {
        let seed = simulation.seed;
        Self { mode: Mode::Simulate(simulation), seed, ..Self::live(0) }
    }

    /// The same, recorded into a file.
    pub fn record(self, path: impl Into<PathBuf>) -> Self {
        Self { record: Some(Record::File(path.into())), ..self }
    }
}

/// Why a system cannot be built.
#[derive(Debug)]
pub enum BuildError {
    /// The recording cannot be written.
    Record(std::io::Error),
    /// Threads cannot be started.
    Threads(std::io::Error),
    /// The recording is of a system with other actors.
    OtherSystem {
        /// The first actor or port that differs.
        actor: ActorId,
        /// Its name in the recording.
        recorded: String,
        /// Its name here.
        found: String,
    },
}

impl fmt::Display for BuildError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Record(error) => write!(f, "cannot write the recording: {error}"),
            Self::Threads(error) => write!(f, "cannot start threads: {error}"),
            Self::OtherSystem { actor, recorded, found } => {
                write!(f, "the recording is of another system: {actor} is {recorded} there and {found} here")
            }
        }
    }
}

impl std::error::Error for BuildError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Record(error) | Self::Threads(error) => Some(error),
            Self::OtherSystem { .. } => None,
        }
    }
}

type Supervisor = Box<dyn Fn(&mut Journal, &ThreadCx, Incident) + Send + Sync>;

#[derive(Clone, Copy, PartialEq, Eq)]
enum Driven {
    Live,
    Replay,
    Simulated,
}

/// What all parts of one system share.
pub(crate) struct Env {
    pub(crate) clock: Clock,
    pub(crate) scheduler: Scheduler,
    pub(crate) timers: Timers,
    pub(crate) seed: u64,
    pub(crate) hashing: Hashing,
    pub(crate) budget: Budget,
    pub(crate) observer: Option<Observer>,
    pub(crate) log: Option<Arc<LogQueue>>,
    driven: Driven,
    trace: Option<Arc<Trace>>,
    pops: Vec<(u64, u32, ActorId)>,
    until: Option<Until>,
    faults: Faults,
    supervisor: OnceLock<Supervisor>,
    nodes: OnceLock<Vec<NodeInfo>>,
    closed: AtomicBool,
    halted: AtomicBool,
    divergence: ArrayQueue<Divergence>,
    mark_kind: AtomicU32,
    mark_value: AtomicU64,
    marks_until: AtomicU64,
}

impl Env {
    pub(crate) fn name(&self, id: ActorId) -> String {
        self.nodes
            .get()
            .and_then(|nodes| nodes.get(id.0 as usize))
            .map_or_else(|| id.to_string(), |node| node.name.clone())
    }

    pub(crate) fn replaying(&self) -> bool {
        self.driven == Driven::Replay
    }

    pub(crate) fn effects(&self) -> bool {
        self.driven == Driven::Live
    }

    pub(crate) fn recording(&self) -> bool {
        self.log.as_ref().is_some_and(|log| !log.is_stopped())
    }

    pub(crate) fn stop_recording(&self, reason: String) {
        if let Some(log) = &self.log {
            log.stop(reason);
        }
    }

    pub(crate) fn closed(&self) -> bool {
        self.closed.load(Ordering::Acquire)
    }

    pub(crate) fn halted(&self) -> bool {
        self.halted.load(Ordering::Relaxed)
    }

    fn halt(&self) {
        self.halted.store(true, Ordering::SeqCst);
        self.scheduler.notify_all();
    }

    pub(crate) fn diverged(&self, divergence: Divergence) {
        let _ = self.divergence.push(divergence);
        self.halt();
    }

    pub(crate) fn last_mark(&self) -> Option<(u32, u64)> {
        let kind = self.mark_kind.load(Ordering::Relaxed);
        (kind != u32::MAX).then(|| (kind, self.mark_value.load(Ordering::Relaxed)))
    }

    pub(crate) fn marked(&self, kind: u32, value: u64) {
        self.mark_kind.store(kind, Ordering::Relaxed);
        self.mark_value.store(value, Ordering::Relaxed);
        if let Some(Until::Mark { kind: wanted, count }) = self.until
            && wanted == kind
            && self.marks_until.fetch_add(1, Ordering::Relaxed) + 1 == count
        {
            self.halt();
        }
    }

    pub(crate) fn stop_at_delivery(&self, actor: ActorId, index: u64) {
        if self.until == Some(Until::Delivery { actor, index }) {
            self.halt();
        }
    }

    pub(crate) fn popped_by(&self, id: u64, attempt: u32) -> Option<ActorId> {
        let index =
            self.pops.binary_search_by_key(&(id, attempt), |(id, attempt, _)| (*id, *attempt)).ok()?;
        Some(self.pops[index].2)
    }

    /// Deliveries at which an actor is to panic, and sends which are to come back.
    pub(crate) fn faults_of(&self, actor: ActorId) -> (VecDeque<u64>, VecDeque<u64>) {
        let faults = self.faults.of(self.seed, actor);
        let of = |kind| {
            let mut at: Vec<u64> =
                faults.iter().filter(|fault| fault.kind == kind).map(|fault| fault.at).collect();
            at.sort_unstable();
            VecDeque::from(at)
        };
        (of(FaultKind::Panic), of(FaultKind::Full))
    }

    pub(crate) fn report(&self, journal: &mut Journal, thread: &ThreadCx, incident: Incident) {
        if let Incident::CircuitOpen { name, .. } = &incident {
            tracing::error!("{name} panicked too often and was stopped");
        }
        if let Some(supervisor) = self.supervisor.get() {
            supervisor(journal, thread, incident);
        }
    }
}

/// An address whose actor is still to come.
pub struct Declared<A: Actor> {
    address: Address<A::Msg>,
}

impl<A: Actor> Declared<A> {
    /// Where the actor will be reached.
    pub fn address(&self) -> Address<A::Msg> {
        self.address.clone()
    }
}

/// Names an actor of a running system, to look at its state.
pub struct Handle<A> {
    id: ActorId,
    kind: PhantomData<fn(A)>,
}

impl<A> Clone for Handle<A> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<A> Copy for Handle<A> {}

impl<A> Handle<A> {
    /// The actor's identity.
    pub fn id(self) -> ActorId {
        self.id
    }
}

/// Makes the actors of a system and their connections. The order of the calls is the actors' identity, so the same
/// wiring must run for a recording and its replay.
pub struct Wiring {
    env: Arc<Env>,
    infos: Vec<NodeInfo>,
    links: Vec<Option<Arc<Link>>>,
    nodes: Vec<Option<Box<dyn Runnable>>>,
    pools: Vec<Box<dyn AnyPool>>,
    ring_turns: usize,
}

impl Wiring {
    fn node(&mut self, name: &str, class: Option<Class>) -> ActorId {
        let same = self.infos.iter().filter(|info| info.name.split('-').next() == Some(name)).count();
        let name = if same == 0 { name.to_owned() } else { format!("{name}-{}", same + 1) };
        self.infos.push(NodeInfo { name, class });
        self.links.push(None);
        self.nodes.push(None);
        ActorId(self.infos.len() as u32 - 1)
    }

    /// Makes the mailbox of an actor, so that others can be given its address; [`Wiring::spawn`] gives it the actor.
    pub fn declare<A: Actor>(&mut self, bounds: Bounds) -> Declared<A> {
        let id = self.node(A::NAME, Some(A::CLASS));
        let link = Arc::new(Link {
            id,
            class: A::CLASS,
            activation: crossbeam_utils::CachePadded::new(Activation::new()),
            signals: AtomicU32::new(0),
            parked: AtomicBool::new(false),
            closed: AtomicBool::new(false),
            unflushed: AtomicBool::new(false),
            counters: Arc::new(Counters::new(self.ring_turns)),
            env: Arc::clone(&self.env),
        });
        self.links[id.0 as usize] = Some(Arc::clone(&link));
        Declared { address: Address { mailbox: Arc::new(Mailbox::new(link, bounds)) } }
    }

    /// Gives a declared mailbox its actor.
    pub fn spawn<A: Actor>(&mut self, declared: Declared<A>, actor: A) -> Handle<A> {
        self.spawn_supervised(declared, actor, OnPanic::Resume)
    }

    /// The same, and says what becomes of it when it panics.
    pub fn spawn_supervised<A: Actor>(
        &mut self,
        declared: Declared<A>,
        actor: A,
        on_panic: OnPanic<A>,
    ) -> Handle<A> {
        self.seat(declared, actor, on_panic, None)
    }

    /// Gives a declared mailbox a worker, which takes jobs from `pool` whenever its mailbox is empty.
    pub fn spawn_worker<A: Worker>(
        &mut self,
        declared: Declared<A>,
        actor: A,
        pool: &JobPool<A::Job>,
        on_panic: OnPanic<A>,
    ) -> Handle<A> {
        let seat = pool.sit::<A>(&declared.address.mailbox.link);
        self.seat(declared, actor, on_panic, Some(seat))
    }

    fn seat<A: Actor>(
        &mut self,
        declared: Declared<A>,
        actor: A,
        on_panic: OnPanic<A>,
        seat: Option<Box<dyn Seat<A>>>,
    ) -> Handle<A> {
        let id = declared.address.id();
        let script = self.env.trace.as_ref().and_then(|trace| Script::new(trace, id));
        self.nodes[id.0 as usize] =
            Some(Box::new(Node::new(&declared.address, actor, on_panic, seat, script)));
        Handle { id, kind: PhantomData }
    }

    /// Makes an ingress from outside to an actor.
    pub fn port<E: External<M>, M: Message>(&mut self, name: &str, to: &Address<M>) -> Port<E, M> {
        let id = self.node(name, None);
        Port::new(id, to)
    }

    /// Makes a pool for at most `capacity` waiting jobs.
    pub fn pool<J: Job>(&mut self, capacity: usize) -> JobPool<J> {
        let pool = JobPool::new(&self.env, capacity);
        self.pools.push(Box::new(pool.clone()));
        pool
    }

    /// Says who is told of panics, dead jobs and stopped actors, and how that actor puts it. One supervisor a system;
    /// later calls change nothing. Choose [`crate::Lane::Control`] for the message, so that it gets through.
    pub fn supervisor<M: Message>(
        &mut self,
        to: &Address<M>,
        message: impl Fn(Incident) -> M + Send + Sync + 'static,
    ) {
        let to = to.clone();
        let _ = self.env.supervisor.set(Box::new(move |journal, thread, incident| {
            if post(journal, thread, &to, message(incident)).is_err() {
                tracing::error!("the supervisor's mailbox is full: an incident is lost");
            }
        }));
    }
}

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
}

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

/// A running system. It belongs to the thread that built it, which runs the pinned actors.
pub struct Runtime {
    env: Arc<Env>,
    nodes: Arc<[Box<dyn Runnable>]>,
    pools: Vec<Box<dyn AnyPool>>,
    threads: Option<Threads>,
    writer: Option<Writer>,
    driver: Option<Box<Driver>>,
    failure: Option<Failure>,
    thread: ThreadCx,
    heavy_ns: u64,
    heavy_passed: u32,
    /// A thread's property, so the system stays on it.
    stays: PhantomData<*const ()>,
}

/// A heavy turn waits at most for so many pumps that have no time for it.
const HEAVY_PASSED_MAX: u32 = 8;

impl Runtime {
    /// Wires a system and starts it.
    pub fn build<T>(config: Config, wire: impl FnOnce(&mut Wiring) -> T) -> Result<(Self, T), BuildError> {
        let Config { threads, mode, record, hashing, application, seed, budget, ring_turns, observer, waker } =
            config;
        let log = record.as_ref().map(|_| Arc::new(LogQueue::new()));
        let (driven, trace, until, simulation) = match mode {
            Mode::Live => (Driven::Live, None, None, None),
            Mode::Replay { trace, until } => (Driven::Replay, Some(trace), until, None),
            Mode::Simulate(simulation) => (Driven::Simulated, None, None, Some(simulation)),
        };
        let threads = if driven == Driven::Simulated { 0 } else { threads };
        let hashing = match (&trace, driven) {
            (Some(trace), _) => trace.header().hashing,
            (None, Driven::Live) if log.is_none() => Hashing::Off,
            _ => hashing,
        };
        let seed = trace.as_ref().map_or(seed, |trace| trace.header().seed);
        let (scheduler, locals) = Scheduler::new(threads, waker);
        let one_by_one = Budget { messages: 1, nanoseconds: u64::MAX };
        let env = Arc::new(Env {
            clock: if driven == Driven::Simulated { Clock::starting_at_zero() } else { Clock::real() },
            scheduler,
            timers: Timers::new(),
            seed,
            hashing,
            budget: if driven == Driven::Simulated { one_by_one } else { budget },
            observer,
            log: log.clone(),
            driven,
            pops: trace.as_ref().map(|trace| trace.pops()).unwrap_or_default(),
            trace,
            until,
            faults: simulation.as_ref().map_or(Faults::NONE, |simulation| simulation.faults.clone()),
            supervisor: OnceLock::new(),
            nodes: OnceLock::new(),
            closed: AtomicBool::new(false),
            halted: AtomicBool::new(false),
            divergence: ArrayQueue::new(1),
            mark_kind: AtomicU32::new(u32::MAX),
            mark_value: AtomicU64::new(0),
            marks_until: AtomicU64::new(0),
        });
        let mut wiring = Wiring {
            env: Arc::clone(&env),
            infos: Vec::new(),
            links: Vec::new(),
            nodes: Vec::new(),
            pools: Vec::new(),
            ring_turns,
        };
        let wired = wire(&mut wiring);
        let Wiring { infos, links, nodes, pools, .. } = wiring;
        if let Some(trace) = &env.trace {
            same_system(&trace.header().nodes, &infos)?;
        }
        let _ = env.nodes.set(infos.clone());
        let nodes: Arc<[Box<dyn Runnable>]> = nodes
            .into_iter()
            .zip(&infos)
            .map(|(node, info)| {
                assert!(
                    node.is_some() || info.class.is_none(),
                    "{} is declared and never spawned",
                    info.name
                );
                node.unwrap_or_else(|| Box::new(PortNode { link: port_link(&env) }))
            })
            .collect();
        pools.iter().for_each(|pool| pool.seal());
        let links: Vec<Arc<Link>> = links.into_iter().flatten().collect();
        let writer = match (record, log) {
            (Some(record), Some(log)) => {
                let build = format!("{} {}", env!("FOVEAL_BUILD"), env!("CARGO_PKG_VERSION"));
                let header = Header { application, build, seed, hashing, nodes: infos.clone() };
                let sink: Box<dyn Write + Send> = match record {
                    Record::File(path) => Box::new(std::fs::File::create(path).map_err(BuildError::Record)?),
                    Record::Sink(sink) => sink,
                };
                Some(Writer::start(sink, &header, &log, links.clone()).map_err(BuildError::Record)?)
            }
            _ => None,
        };
        let classes: Vec<Option<Class>> = infos.iter().map(|info| info.class).collect();
        let thread = ThreadCx::outside();
        links.iter().for_each(|link| link.raise(signal::START, &thread));
        let threads = Threads::start(&env, &nodes, locals).map_err(BuildError::Threads)?;
        let driver = simulation.map(|simulation| Box::new(Driver::new(simulation, &classes)));
        let runtime = Self {
            env,
            nodes,
            pools,
            threads: Some(threads),
            writer,
            driver,
            failure: None,
            thread,
            heavy_ns: 0,
            heavy_passed: 0,
            stays: PhantomData,
        };
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
        let end = limit.time.map(|time| env.clock.now().saturating_add(nanoseconds(time)));
        let exit = if self.driver.is_some() {
            self.simulate(limit, end, &mut condition)
        } else {
            self.work(limit, end, &mut condition)
        };
        self.thread.last_end.set(0);
        env.scheduler.leave_main();
        exit
    }

    fn work(&mut self, limit: Limit, end: Option<u64>, condition: &mut dyn FnMut(&Self) -> bool) -> Exit {
        let env = Arc::clone(&self.env);
        let alone = env.scheduler.threads() == 0;
        loop {
            if env.halted() {
                return Exit::Halted;
            }
            if condition(self) {
                return Exit::Until;
            }
            let now =
                if end.is_some() || (alone && env.timers.next() != u64::MAX) { env.clock.now() } else { 0 };
            if alone {
                env.timers.serve(now, &self.thread);
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
                        let start = env.clock.now();
                        env.scheduler.run(&self.nodes, actor, &self.thread);
                        self.heavy_ns = (self.heavy_ns * 3 + (env.clock.now() - start)) / 4;
                        self.heavy_passed = 0;
                    }
                    continue;
                }
                self.heavy_passed += 1;
                return Exit::Time;
            }
            self.thread.last_end.set(0);
            let idle = || limit.idle && env.scheduler.idle() && env.timers.next() == u64::MAX;
            if idle() {
                return if env.halted() { Exit::Halted } else { Exit::Idle };
            }
            let wake = end.unwrap_or(u64::MAX).min(if alone { env.timers.next() } else { u64::MAX });
            let timeout = match wake {
                u64::MAX => Duration::MAX,
                wake => Duration::from_nanos(wake.saturating_sub(env.clock.now())),
            };
            env.scheduler.park_main(timeout, || idle() || env.halted());
        }
    }

    fn simulate(&mut self, limit: Limit, end: Option<u64>, condition: &mut dyn FnMut(&Self) -> bool) -> Exit {
        let env = Arc::clone(&self.env);
        let Some(mut driver) = self.driver.take() else { return Exit::Idle };
        let exit = loop {
            if self.failure.is_some() {
                break Exit::Halted;
            }
            if condition(self) {
                break Exit::Until;
            }
            let now = env.clock.now();
            if end.is_some_and(|end| now >= end) {
                break Exit::Time;
            }
            env.timers.serve(now, &self.thread);
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
            env.scheduler.run(&self.nodes, actor, &self.thread);
            env.clock.advance_to(now + driver.turned(actor));
            if let Err(reason) = self.check(&mut driver) {
                self.failure = Some(Failure { seed: driver.simulation.seed, step: driver.step, reason });
            }
        };
        self.driver = Some(driver);
        exit
    }

    fn check(&self, driver: &mut Driver) -> Result<(), String> {
        for pool in &self.pools {
            let PoolStats { pushed, completed, stale, dead, waiting, .. } = pool.stats();
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

    /// Replays to the end of the recording, or to where it was to stop.
    pub fn replay(&mut self) -> ReplayReport {
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
            divergence: env.divergence.pop(),
            complete: false,
            waiting: Vec::new(),
        };
        if let Some(divergence) = report.divergence.clone() {
            let _ = env.divergence.push(divergence);
        }
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
        let halted = env.halted();
        let whole = env.trace.as_ref().is_some_and(|trace| trace.complete());
        if !halted && report.divergence.is_none() && !report.waiting.is_empty() {
            report.divergence = self.stall(&report.waiting, &states, whole);
        }
        report.complete = whole && report.divergence.is_none() && report.waiting.is_empty();
        report
    }

    /// All are idle and a script goes on. In a recording that was cut, that is its consistent end if the wait leads to
    /// an actor whose script is over; otherwise somebody did not send what was recorded.
    fn stall(
        &self,
        waiting: &[ActorId],
        states: &[Option<crate::node::ScriptState>],
        whole: bool,
    ) -> Option<Divergence> {
        let ends_in_cut = |mut actor: ActorId| {
            for _ in 0..=states.len() {
                match states.get(actor.0 as usize).copied().flatten() {
                    Some(state) => match state.waits_for {
                        Some((from, _)) if from != actor => actor = from,
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
        let (from, lane) = state.waits_for?;
        let expected =
            format!("{} from {} {from}", crate::log::format::lane::name(lane), self.env.name(from));
        let found = "nothing: all actors are idle".to_owned();
        Some(self.stop_divergence(actor, state.made, Some(from), expected, found))
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
        Divergence { actor, name, index, mark, kind: "stall", from, expected, found, turns: Vec::new() }
    }

    /// Waits until no turn runs: they end soon after a halt.
    fn settle(&self) {
        while self.threads.is_some() && self.env.scheduler.busy(self.env.halted()) {
            std::thread::park_timeout(Duration::from_micros(100));
        }
    }

    /// Goes on after [`Until`] stopped the replay, to another place or to the end.
    pub fn resume(&mut self) {
        self.env.halted.store(false, Ordering::SeqCst);
        self.env.scheduler.notify_all();
    }

    /// The broken invariant that ended a simulation.
    pub fn failure(&self) -> Option<&Failure> {
        self.failure.as_ref()
    }

    /// The first divergence of a replay, as soon as there is one.
    pub fn diverged(&self) -> bool {
        !self.env.divergence.is_empty()
    }

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

    /// Orders an actor to stop, pause or resume.
    pub fn control<A>(&self, handle: Handle<A>, control: Control) {
        if !self.env.replaying()
            && let Some(node) = self.nodes.get(handle.id.0 as usize)
        {
            node.link().control(control, &self.thread);
        }
    }

    /// Time since the system was built, virtual in a simulation.
    pub fn now(&self) -> Time {
        Time(self.env.clock.now())
    }

    /// When the next timer is due: an event loop of one's own that works alone must pump again by then.
    pub fn next_timer(&self) -> Option<Time> {
        let next = self.env.timers.next();
        (next != u64::MAX).then_some(Time(next))
    }

    /// Threads beside the main one.
    pub fn threads(&self) -> usize {
        self.env.scheduler.threads()
    }

    /// Names and classes of all actors and ports, by identity.
    pub fn actors(&self) -> &[NodeInfo] {
        self.env.nodes.get().map_or(&[], |nodes| nodes)
    }

    /// Counters of each actor, by identity; those of ports stay zero.
    pub fn counters(&self) -> Vec<ActorCounters> {
        let nodes = self.nodes.iter().zip(self.actors());
        nodes.map(|(node, info)| node.link().counters.read(&info.name)).collect()
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

    /// The same as a Chrome trace.
    pub fn chrome_trace(&self) -> String {
        chrome_trace(&self.turn_times())
    }

    /// How the recording is doing.
    pub fn recording(&self) -> RecordingStatus {
        self.env.log.as_ref().map_or(RecordingStatus::Off, |log| log.status())
    }

    /// Deliveries and chained hash of each actor, when nothing runs; zeros for ports. Two runs with equal positions
    /// delivered the same messages in the same order to every actor.
    pub fn positions(&self) -> Vec<(u64, u64)> {
        self.settle();
        self.nodes.iter().map(|node| node.position().unwrap_or_default()).collect()
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

    /// Takes no more input, lets everything that was accepted be handled, then stops the actors, the last made first.
    /// What is not done within `time` is counted in the result.
    pub fn shutdown(mut self, time: Duration) -> Shutdown {
        self.env.closed.store(true, Ordering::SeqCst);
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

    fn stop(&mut self, whole: bool) {
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

impl Drop for Runtime {
    fn drop(&mut self) {
        if self.threads.is_some() {
            self.stop(false);
        }
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

/// Stands where a port's number is among the actors'.
struct PortNode {
    link: Arc<Link>,
}

fn port_link(env: &Arc<Env>) -> Arc<Link> {
    Arc::new(Link {
        id: ActorId(u32::MAX),
        class: Class::Light,
        activation: crossbeam_utils::CachePadded::new(Activation::new()),
        signals: AtomicU32::new(0),
        parked: AtomicBool::new(false),
        closed: AtomicBool::new(true),
        unflushed: AtomicBool::new(false),
        counters: Arc::new(Counters::new(1)),
        env: Arc::clone(env),
    })
}

impl Runnable for PortNode {
    fn turn(&self, _thread: &ThreadCx) -> bool {
        false
    }

    fn link(&self) -> &Arc<Link> {
        &self.link
    }

    fn look(&self, _show: &mut dyn FnMut(&dyn Any)) {}

    fn position(&self) -> Option<(u64, u64)> {
        None
    }

    fn script_state(&self) -> Option<crate::node::ScriptState> {
        None
    }

    fn end_log(&self) {}

    fn is_empty(&self) -> bool {
        true
    }
}
