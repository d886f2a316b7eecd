//! An actor runtime without locks of its own that records and replays.
//!
//! Actors own their state and change it only by the messages they are given, in order. This runtime schedules them on
//! k threads and the main one, bounds every mailbox, catches panics, and puts every delivery through one place. So the
//! same system can be run **live**, **recorded**, **replayed** bit for bit on any number of threads (the first message
//! at which it differs is named), and **simulated** on one thread under seeded schedules and faults.
//!
//! # A complete system
//!
//! ```
//! use foveal_runtime::*;
//! use serde::{Deserialize, Serialize};
//! use std::{sync::Arc, time::Duration};
//!
//! // 1. Messages: one closed enum for each actor. All of their content is hashed, so that replay can compare it.
//! #[derive(Message)]
//! #[message(unsaved = "an address is not read back from a snapshot")]
//! enum CounterMsg {
//!     Add { amount: u64, reply_to: Address<ShowMsg> },
//! }
//!
//! #[derive(Message)]
//! enum ShowMsg {
//!     // Where only the newest counts, a message says so. Others: `lane = data` (default), `lane = control`.
//!     #[message(lane = latest(0))]
//!     Tick(Tick),
//!     Total(u64),
//! }
//!
//! // What comes from outside can be written down and becomes a message.
//! #[derive(Serialize, Deserialize)]
//! struct Tick {
//!     number: u64,
//! }
//!
//! impl From<Tick> for ShowMsg {
//!     fn from(tick: Tick) -> Self {
//!         Self::Tick(tick)
//!     }
//! }
//!
//! // 2. Actors. `cx` is the only door to the world: tell, now, measured, after, push, mark, random.
//! struct Counter {
//!     total: u64,
//! }
//!
//! impl Actor for Counter {
//!     type Msg = CounterMsg;
//!     const NAME: &'static str = "counter";
//!
//!     fn handle(&mut self, message: CounterMsg, cx: &mut Cx<'_, CounterMsg>) {
//!         match message {
//!             CounterMsg::Add { amount, reply_to } => {
//!                 self.total += amount;
//!                 // A full mailbox gives the message back as a value. The show's mailbox holds as many totals as it
//!                 // has credits for questions, so this cannot happen here.
//!                 cx.tell(&reply_to, ShowMsg::Total(self.total)).expect("one answer for each credit");
//!             }
//!         }
//!     }
//! }
//!
//! struct Show {
//!     counter: Address<CounterMsg>,
//!     credits: Credits,
//!     shown: Vec<u64>,
//! }
//!
//! impl Actor for Show {
//!     type Msg = ShowMsg;
//!     const NAME: &'static str = "show";
//!     const CLASS: Class = Class::Pinned; // runs inside `Runtime::pump`, on the main thread
//!
//!     fn handle(&mut self, message: ShowMsg, cx: &mut Cx<'_, ShowMsg>) {
//!         match message {
//!             ShowMsg::Tick(tick) => {
//!                 if self.credits.take(1) {
//!                     let reply_to = cx.address().clone();
//!                     let _ = cx.tell(&self.counter, CounterMsg::Add { amount: tick.number, reply_to });
//!                 }
//!             }
//!             ShowMsg::Total(total) => {
//!                 self.credits.give(1);
//!                 self.shown.push(total);
//!                 cx.mark(0, total); // a milestone that replay compares, such as the hash of a frame
//!             }
//!         }
//!     }
//! }
//!
//! // 3. Wiring: the same function for every mode. Declare first, so that addresses can go round in circles.
//! fn wire(wiring: &mut Wiring) -> (Handle<Show>, Port<Tick, ShowMsg>) {
//!     let show = wiring.declare::<Show>(Bounds::messages(4));
//!     let counter = wiring.declare::<Counter>(Bounds::messages(4));
//!     let ticks = wiring.port::<Tick, ShowMsg>("ticks", &show.address());
//!     let actor = Show { counter: counter.address(), credits: Credits::new(4), shown: Vec::new() };
//!     let show = wiring.spawn(show, actor, OnPanic::Resume);
//!     wiring.spawn(counter, Counter { total: 0 }, OnPanic::Resume);
//!     (show, ticks)
//! }
//!
//! // 4. A live run on one thread beside the main one, recorded.
//! # let folder = tempfile::tempdir().unwrap();
//! # let path = folder.path().join("run.fvlog");
//! let (mut runtime, (show, ticks)) = Runtime::build(Config::live(1).record(&path), wire)?;
//! for number in 1..=3 {
//!     ticks.send(Tick { number })?;
//!     // Works on pinned actors until the condition holds; parks meanwhile.
//!     let shown = |runtime: &Runtime| runtime.inspect(show, |show| show.shown.len()) == Some(number as usize);
//!     assert_eq!(runtime.pump_until(Limit::time(Duration::from_secs(10)), shown), Exit::Until);
//! }
//! let end = runtime.shutdown(Duration::from_secs(10));
//! assert!(end.drained && end.dead_letters == 0);
//!
//! // 5. Replay, on another number of threads. Ports are ignored: input comes from the recording.
//! let trace = Arc::new(Trace::open(&path)?);
//! let (mut runtime, (show, _)) = Runtime::build(Config::replay(trace, 0), wire)?;
//! let report = runtime.replay();
//! assert!(report.complete && report.divergence.is_none());
//! assert_eq!(runtime.inspect(show, |show| show.shown.clone()), Some(vec![1, 3, 6]));
//!
//! // 6. Simulation: one thread, virtual time, any schedule. Equal seeds give equal fingerprints.
//! for seed in 0..10 {
//!     let (mut runtime, (_, ticks)) = Runtime::build(Config::simulate(simulate::Simulation::new(seed)), wire)?;
//!     ticks.send(Tick { number: 5 })?;
//!     assert_eq!(runtime.pump(Limit::IDLE), Exit::Idle);
//!     assert_eq!(runtime.failure(), None);
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Jobs
//!
//! `wiring.pool::<J>(capacity)` makes a [`JobPool`]; `wiring.spawn_worker(declared, worker, &pool, on_panic)` seats a
//! [`Worker`], whose [`Worker::run`] gets the best job whenever its mailbox is empty (one job a turn; make it
//! [`Class::Heavy`]). Any actor pushes with `cx.push(&pool, bucket, epoch, job)` (bucket 0 first, 63 last) and retires
//! old ones with `cx.retire(&pool, epoch)`. A job whose worker panics goes back; the third time it is given up, and a
//! [`DeadJob`] says what it was and why to the actor named by `wiring.gives_up(&pool, &address, |dead| message)`. With
//! `wiring.leases(&pool, time)` a worker that hangs for so long loses its job to another one, and [`Cx::claim`] tells it
//! so when it comes back: ask before telling what came of a job, and each is told once.
//!
//! # Panics
//!
//! Whoever spawns an actor says what its panic does ([`OnPanic`]): it goes on, starts anew, stops, or ends the system in
//! order. The actor named by `wiring.supervisor(&address, |incident| message)` is told of each; that is recorded like
//! any message. What no actor did is survived and kept for [`Runtime::incidents`].
//!
//! # A window's event loop
//!
//! With [`Config::waker`], a pinned actor that has something to do calls the event loop's proxy while the main thread
//! is outside [`Runtime::pump`]; the loop then pumps for as long as it can spare ([`Limit::time`]).
//!
//! # What makes replay exact
//!
//! Each actor's recording holds the sender of each delivery, payloads of what came through [`Port`]s, timers, clock
//! readings, job pops, sends that were given back, and a hash chained over order, content and what was said. Replay
//! makes all other payloads anew and delivers by the recording; what an actor says reaches others once its hash is the
//! recorded one. An actor that reads a clock, iterates a randomly seeded map or looks at shared state is found at the
//! first delivery in which it says something that shows it ([`Hashing::Said`]). [`Actor::digest`] makes that the delivery where its state went wrong.
//!
//! # Taking a run apart
//!
//! A place in a recording is a cut: how many deliveries each actor has had. [`Runtime::run_to`] makes exactly those,
//! [`Runtime::step`] one more, in the same order wherever one begins; in replay an observer is told the delivery in
//! which each message was sent ([`Delivery::cause`]). Where all actors, messages and jobs say how they are saved,
//! [`Runtime::snapshot`] takes the state between two turns, and [`Config::from`] begins there: so one steps back, or
//! jumps into a long recording. [`Timeline`] draws it all for chrome://tracing and Perfetto.
//!
//! There are no locks of ours anywhere on a message's way: mailboxes are `crossbeam_queue::ArrayQueue`s, run queues
//! `crossbeam_deque`s, parking is an eventcount over `std::thread::park`. A queue's push or pop may have to wait for
//! another thread that is in the middle of one: it spins, then gives its core away.

// Where things are; each may use those above it (`tests/tidy.rs` keeps that):
// sync        the atomics that are model-checked
// message     what is told, hashed, saved, and what goes wrong
// scheduler   threads, run queues, timers, the clock, how an actor is woken, what turns took
// mailbox     how a message comes to an actor
// log         the format of recordings, reading and writing them
// journal     the one place through which deliveries pass, live and by the script of a replay
// actor       what an actor is and can do, how a delivery is made, what becomes of a panic
// pool        jobs, their priorities and leases
// runtime     wiring, running, looking at, saving and ending a system
// replay      going through a recording
// simulate    schedules and faults by a seed
#[cfg(doctest)]
#[doc = include_str!("README.md")]
struct Readme;

mod actor;
mod journal;
mod log;
mod mailbox;
mod message;
#[cfg(all(test, loom))]
mod model;
pub mod pool;
mod replay;
mod runtime;
mod scheduler;
pub mod simulate;
mod sync;

pub use foveal_runtime_derive::Message;

pub use actor::reserve::Reserve;
pub use actor::supervise::OnPanic;
pub use actor::{Actor, Cx, Handle, Ticket, TimerId};
pub use journal::divergence::{Divergence, Said, Turn, Until};
pub use journal::observe::{Delivery, Observer};
pub use journal::port::{External, Port};
pub use log::events::Event;
pub use log::fingerprint::Fingerprint;
pub use log::format::{Hashing, Header, NodeInfo};
pub use log::reader::{Cut, Trace, TraceError, TraceStat};
pub use log::writer::RecordingStatus;
pub use mailbox::{Address, Bounds};
pub use message::content::{Content, Difference, List};
pub use message::incident::Incident;
pub use message::saved::{Loader, Saver};
pub use message::{ActorId, Credits, Digest, LATEST_KEYS, Lane, Message, Reason, Rejected};
pub use pool::{DeadJob, Death, Job, JobPool, Kept, PoolStats, Worker};
pub use replay::ReplayReport;
pub use runtime::config::{BuildError, Config, Mode, Record, Steering};
pub use runtime::shutdown::{Ending, Shutdown};
pub use runtime::snapshot::Snapshot;
pub use runtime::timeline::{Slice, Timeline};
pub use runtime::wiring::{Declared, Wiring};
pub use runtime::{Exit, Limit, Runtime};
pub use scheduler::Budget;
pub use scheduler::clock::Time;
pub use scheduler::link::{Class, Control};
pub use scheduler::priority::{be_patient, be_prompt, give_way};
pub use scheduler::profile::{ActorCounters, TurnTime, ring_cost};
pub use scheduler::timer::TIMERS_PER_ACTOR;
