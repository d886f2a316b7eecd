//! How a system is to be built.

use crossbeam_deque::Worker;
use std::fmt;
use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;

use crate::journal::divergence::Until;
use crate::journal::env::{Driven, Env, Terms};
use crate::journal::faults::Faults;
use crate::journal::observe::Observer;
use crate::log::fingerprint::Fingerprint;
use crate::log::format::Hashing;
use crate::log::reader::Trace;
use crate::message::ActorId;
use crate::runtime::driver::Driver;
use crate::runtime::snapshot::Snapshot;
use crate::scheduler::clock::Clock;
use crate::scheduler::profile::RING_TURNS;
use crate::scheduler::{Budget, Scheduler};

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
    /// One thread and a virtual clock: see [`Config::simulate`].
    Simulate(Steering),
}

/// Says whose turn it is, in place of threads.
pub struct Steering(pub(crate) Box<dyn Driver>);

/// How to build a system.
pub struct Config {
    /// Threads beside the main one (at most 64; a simulation uses none). With 0 the main thread does everything.
    pub threads: usize,
    /// Whether these threads [give way](crate::give_way), so that the main one never waits for a processor.
    pub gives_way: bool,
    /// What drives the system.
    pub mode: Mode,
    /// Where to record, if at all.
    pub record: Option<Record>,
    /// How densely hashes are recorded. Replay takes it from the recording; without a recording nothing is hashed,
    /// except in a simulation.
    pub hashing: Hashing,
    /// Name and version of the program: a part of a recording's [`crate::Fingerprint`].
    pub program: String,
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
    /// Replay: what this actor says in this delivery is kept for [`Runtime::heard`](crate::Runtime::heard), also what
    /// is delivered to nobody.
    pub listen_to: Option<(ActorId, u64)>,
    /// Where a replay begins, if not at the start: a snapshot of a replay of the same recording.
    pub from: Option<Arc<Snapshot>>,
    /// Called when the main thread is not in [`Runtime::pump`](crate::Runtime::pump) and a pinned actor has
    /// something to do: wake the event loop here.
    pub waker: Option<Box<dyn Fn() + Send + Sync>>,
}

impl Config {
    /// A live system with so many threads beside the main one, not recorded.
    pub fn live(threads: usize) -> Self {
        Self {
            threads,
            gives_way: false,
            mode: Mode::Live,
            record: None,
            hashing: Hashing::Said,
            program: String::new(),
            application: Vec::new(),
            seed: 0,
            budget: Budget::default(),
            ring_turns: RING_TURNS,
            observer: None,
            listen_to: None,
            from: None,
            waker: None,
        }
    }

    /// A replay on so many threads beside the main one.
    pub fn replay(trace: Arc<Trace>, threads: usize) -> Self {
        Self { mode: Mode::Replay { trace, until: None }, ..Self::live(threads) }
    }

    /// The same, recorded into a file.
    pub fn record(self, path: impl Into<PathBuf>) -> Self {
        Self { record: Some(Record::File(path.into())), ..self }
    }
}

/// The parts of a configuration that are used up while a system is built.
pub(super) struct Parts {
    pub(super) locals: Vec<Worker<u32>>,
    pub(super) gives_way: bool,
    pub(super) record: Option<Record>,
    pub(super) program: String,
    pub(super) application: Vec<u8>,
    pub(super) ring_turns: usize,
    pub(super) driver: Option<Box<dyn Driver>>,
    pub(super) from: Option<Arc<Snapshot>>,
}

impl Config {
    /// What actors share, and what is left to do.
    pub(super) fn begin(self) -> (Arc<Env>, Parts) {
        let Self {
            threads,
            gives_way,
            mode,
            record,
            hashing,
            program,
            application,
            seed,
            budget,
            ring_turns,
            observer,
            listen_to,
            from,
            waker,
        } = self;
        let (driven, trace, until, driver) = match mode {
            Mode::Live => (Driven::Live, None, None, None),
            Mode::Replay { trace, until } => (Driven::Replay, Some(trace), until, None),
            Mode::Simulate(Steering(driver)) => (Driven::Simulated, None, None, Some(driver)),
        };
        let (scheduler, locals) = match &driver {
            None => {
                let clock = if trace.is_some() { Clock::of_replay() } else { Clock::real() };
                Scheduler::new(threads, clock, budget, waker)
            }
            // One message a turn: whose turn is next is the driver's to say.
            Some(driver) => {
                let budget = Budget { messages: 1, nanoseconds: u64::MAX };
                Scheduler::new(0, driver.clock(), budget, waker)
            }
        };
        let faults = driver.as_ref().map_or(Faults::NONE, |driver| driver.faults());
        let (records, here) = (record.is_some(), Fingerprint::here(&program));
        let terms = Terms { driven, seed, hashing, observer, listen_to, records, trace, until, faults, here };
        let env = Arc::new(Env::new(terms, scheduler));
        (env, Parts { locals, gives_way, record, program, application, ring_turns, driver, from })
    }
}

/// Why a system cannot be built.
#[derive(Debug)]
pub enum BuildError {
    /// The recording cannot be written.
    Record(std::io::Error),
    /// Threads cannot be started.
    Threads(std::io::Error),
    /// The snapshot is not of this recording and this program.
    OtherSnapshot,
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
            Self::OtherSnapshot => f.write_str("the snapshot is of another recording or program"),
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
            Self::OtherSystem { .. } | Self::OtherSnapshot => None,
        }
    }
}
