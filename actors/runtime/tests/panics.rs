//! Panics wherever code that is not the runtime's own is run: each is caught, told, and survived.

use foveal_runtime::*;
use serde::{Deserialize, Serialize};
use std::cell::Cell;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use crate::common::{WAIT, assert_complete, read};

/// Where it panics.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Where {
    Nowhere,
    Digest,
    Kind,
    Handle,
    State,
    Size,
    Wording,
    Lane,
}

/// Not a plain panic: that would fill the test's output.
fn panics(text: &'static str) -> ! {
    std::panic::resume_unwind(Box::new(text));
}

thread_local! {
    /// Who sends may ask for a size, who receives may not.
    static SENDING: Cell<bool> = const { Cell::new(false) };
}

#[derive(Serialize, Deserialize)]
struct Word(Where);

impl Message for Word {
    fn digest(&self, digest: &mut Digest) {
        if self.0 == Where::Digest {
            panics("digest");
        }
        digest.u32(self.0 as u32);
    }

    fn kind(&self) -> &'static str {
        if self.0 == Where::Kind { panics("kind") } else { "Word" }
    }

    fn lane(&self) -> Lane {
        if self.0 == Where::Lane { panics("lane") } else { Lane::Data }
    }

    fn size_bytes(&self) -> usize {
        if self.0 == Where::Size && !SENDING.get() { panics("size") } else { 0 }
    }
}

/// What no actor was told of.
fn beside(runtime: &Runtime) -> Vec<Incident> {
    let told = |incident: &Incident| matches!(incident, Incident::Beside { .. });
    runtime.incidents().into_iter().filter(told).collect()
}

/// Panics as it is told, and counts what it survives.
#[derive(Default)]
struct Listener {
    heard: u64,
    state_is_bad: bool,
}

impl Actor for Listener {
    type Msg = Word;
    const NAME: &'static str = "listener";

    fn handle(&mut self, word: Word, _: &mut Cx<'_, Word>) {
        self.heard += 1;
        self.state_is_bad = word.0 == Where::State;
        if word.0 == Where::Handle {
            panics("handle");
        }
    }

    fn digest(&self) -> Option<u64> {
        if self.state_is_bad { panics("state") } else { Some(self.heard) }
    }
}

/// What the supervisor hears.
#[derive(Clone, Debug)]
struct Told(Incident);

impl Message for Told {
    fn digest(&self, digest: &mut Digest) {
        digest.bytes(format!("{:?}", self.0).as_bytes());
    }

    fn kind(&self) -> &'static str {
        "Told"
    }

    fn lane(&self) -> Lane {
        Lane::Control
    }
}

#[derive(Default)]
struct Supervisor(Vec<Incident>);

impl Actor for Supervisor {
    type Msg = Told;
    const NAME: &'static str = "supervisor";
    const CLASS: Class = Class::Pinned;

    fn handle(&mut self, told: Told, _: &mut Cx<'_, Told>) {
        self.0.push(told.0);
    }
}

type Wired = (Handle<Listener>, Port<Word, Word>, Handle<Supervisor>);

fn wire(wiring: &mut Wiring, on_panic: OnPanic<Listener>) -> Wired {
    let listener = wiring.declare::<Listener>(Bounds::messages(100));
    let port = wiring.port::<Word, Word>("words", &listener.address());
    let supervisor = wiring.declare::<Supervisor>(Bounds::messages(100));
    wiring.supervisor(&supervisor.address(), |incident| match incident {
        Incident::Panicked { ref message, .. } if message == "wording" => panics("wording"),
        incident => Told(incident),
    });
    let listener = wiring.spawn(listener, Listener::default(), on_panic);
    (listener, port, wiring.spawn(supervisor, Supervisor::default(), OnPanic::Stop))
}

#[test]
fn a_panic_costs_its_message_and_nothing_else_wherever_it_comes_from() {
    use Where::*;
    for threads in [0, 2] {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("panics.fvlog");
        let wired = |wiring: &mut Wiring| wire(wiring, OnPanic::Resume);
        let (mut runtime, (listener, port, supervisor)) =
            Runtime::build(Config::live(threads).record(&path), wired).expect("builds");
        for word in [Digest, Kind, Handle, State] {
            port.send(Word(word)).expect("room");
            port.send(Word(Nowhere)).expect("room");
        }
        assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
        let incidents = runtime.inspect(supervisor, |supervisor| supervisor.0.clone()).expect("pinned");
        let told: Vec<_> = incidents
            .iter()
            .map(|incident| match incident {
                Incident::Panicked { kind, message, .. } => (kind.as_str(), message.as_str()),
                other => panic!("{other}"),
            })
            .collect();
        let expected = [("Word", "digest"), ("unreadable", "kind"), ("Word", "handle"), ("Word", "state")];
        assert_eq!(told, expected);
        let shutdown = runtime.end(WAIT);
        assert!(shutdown.drained && shutdown.ended.is_none(), "{shutdown:?}");
        assert_eq!(shutdown.counters[0].panics, 4);
        // Two never reached it, and one it panicked over.
        assert_eq!(shutdown.dead_letters, 3);
        assert_eq!(runtime.inspect(listener, |listener| listener.heard), Some(6));
        let trace = read(&std::fs::read(&path).expect("a file"));
        for threads in [0, 2] {
            let config = Config::replay(Arc::clone(&trace), threads);
            assert_complete(&Runtime::build(config, wired).expect("builds").0.replay());
        }
    }
}

/// Which way a message goes is asked where it is sent, so that a panic in there is the sender's.
#[test]
fn a_message_that_cannot_say_its_way_costs_its_sender_a_turn() {
    struct Relay(Address<Word>);
    impl Actor for Relay {
        type Msg = Word;
        const NAME: &'static str = "relay";
        fn handle(&mut self, word: Word, cx: &mut Cx<'_, Word>) {
            let way = if word.0 == Where::State { Where::Lane } else { Where::Nowhere };
            cx.tell(&self.0, Word(way)).unwrap_or_else(|_| panics("refused"));
        }
    }
    for threads in [0, 2] {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("ways.fvlog");
        let wired = |wiring: &mut Wiring| {
            let (_, _, supervisor) = wire(wiring, OnPanic::Stop);
            let hears = wiring.declare::<Listener>(Bounds::messages(100));
            let relay = wiring.declare::<Relay>(Bounds::messages(100));
            let port = wiring.port::<Word, Word>("more words", &relay.address());
            wiring.spawn(relay, Relay(hears.address()), OnPanic::Resume);
            (wiring.spawn(hears, Listener::default(), OnPanic::Stop), port, supervisor)
        };
        let config = Config::live(threads).record(&path);
        let (mut runtime, (listener, port, supervisor)) = Runtime::build(config, wired).expect("builds");
        for word in [Where::Nowhere, Where::State, Where::Nowhere] {
            port.send(Word(word)).expect("room");
        }
        assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
        let told = runtime.inspect(supervisor, |supervisor| supervisor.0.clone()).expect("pinned");
        let is_relay = |told: &Incident| matches!(told, Incident::Panicked { name, message, .. } if name == "relay" && message == "lane");
        assert!(told.len() == 1 && is_relay(&told[0]), "{told:?}");
        let shutdown = runtime.end(WAIT);
        assert!(shutdown.drained && shutdown.ended.is_none(), "{shutdown:?}");
        assert_eq!(runtime.inspect(listener, |listener| listener.heard), Some(2));
        let trace = read(&std::fs::read(&path).expect("a file"));
        for threads in [0, 2] {
            let config = Config::replay(Arc::clone(&trace), threads);
            assert_complete(&Runtime::build(config, wired).expect("builds").0.replay());
        }
    }
}

#[test]
fn an_actor_that_cannot_start_anew_ends_the_system() {
    for threads in [0, 2] {
        let (mut runtime, (_, port, supervisor)) = Runtime::build(Config::live(threads), |wiring| {
            wire(wiring, OnPanic::restart(|| panics("no new one")))
        })
        .expect("builds");
        port.send(Word(Where::Handle)).expect("room");
        assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Ended);
        let shutdown = runtime.end(WAIT);
        assert!(shutdown.drained && shutdown.ended.is_some(), "{shutdown:?}");
        assert_eq!(runtime.inspect(supervisor, |supervisor| supervisor.0.len()), Some(1));
        let beside = beside(&runtime);
        assert!(
            matches!(&beside[..], [Incident::Beside { message, .. }] if message == "no new one"),
            "{beside:?}"
        );
    }
}

#[test]
fn an_actor_that_panics_again_and_again_ends_the_system() {
    for on_panic in [|| OnPanic::Resume, || OnPanic::restart(Listener::default)] {
        let (mut runtime, (_, port, supervisor)) =
            Runtime::build(Config::live(0), |wiring| wire(wiring, on_panic())).expect("builds");
        for _ in 0..20 {
            port.send(Word(Where::Handle)).expect("room");
        }
        assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Ended);
        assert!(runtime.end(WAIT).drained);
        assert_eq!(runtime.inspect(supervisor, |supervisor| supervisor.0.len()), Some(8));
    }
}

#[test]
fn an_observer_that_panics_is_asked_no_more() {
    let asked = Arc::new(AtomicU64::new(0));
    let counted = Arc::clone(&asked);
    let observer: Observer = Arc::new(move |_| {
        counted.fetch_add(1, Ordering::SeqCst);
        panics("observer");
    });
    let config = Config { observer: Some(observer), ..Config::live(2) };
    let (mut runtime, (_, port, supervisor)) =
        Runtime::build(config, |wiring| wire(wiring, OnPanic::Stop)).expect("builds");
    for _ in 0..10 {
        port.send(Word(Where::Nowhere)).expect("room");
    }
    assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
    assert_eq!((runtime.deliveries(), asked.load(Ordering::SeqCst)), (10, 1));
    assert_eq!(
        runtime.inspect(supervisor, |supervisor| supervisor.0.len()),
        Some(0),
        "it was not the actor's fault"
    );
    let beside = beside(&runtime);
    assert!(matches!(&beside[..], [Incident::Beside { message, .. }] if message == "observer"), "{beside:?}");
    assert!(runtime.shutdown(WAIT).drained);
}

#[test]
fn an_incident_that_cannot_be_told_ends_the_system() {
    struct Fragile;
    impl Actor for Fragile {
        type Msg = Word;
        const NAME: &'static str = "fragile";
        fn handle(&mut self, _: Word, _: &mut Cx<'_, Word>) {
            panics("wording");
        }
    }
    for threads in [0, 2] {
        let (mut runtime, port) = Runtime::build(Config::live(threads), |wiring| {
            let fragile = wiring.declare::<Fragile>(Bounds::messages(10));
            let port = wiring.port::<Word, Word>("words", &fragile.address());
            wire(wiring, OnPanic::Stop);
            wiring.spawn(fragile, Fragile, OnPanic::Resume);
            port
        })
        .expect("builds");
        port.send(Word(Where::Wording)).expect("room");
        assert_eq!(runtime.pump(Limit::time(WAIT)), Exit::Ended);
        assert!(matches!(&beside(&runtime)[..], [Incident::Beside { message, .. }] if message == "wording"));
        assert!(matches!(runtime.ended(), Some(Incident::Panicked { name, .. }) if name == "fragile"));
        assert!(runtime.shutdown(WAIT).drained);
    }
}

#[test]
fn what_breaks_a_turn_is_told_and_its_thread_goes_on() {
    for threads in [0, 1, 3] {
        let (mut runtime, (broken, port, other, other_port)) =
            Runtime::build(Config::live(threads), |wiring| {
                let (broken, port, _) = wire(wiring, OnPanic::Resume);
                let other = wiring.declare::<Listener>(Bounds::messages(100));
                let other_port = wiring.port::<Word, Word>("more words", &other.address());
                (broken, port, wiring.spawn(other, Listener::default(), OnPanic::Stop), other_port)
            })
            .expect("builds");
        // No delivery has begun where the mailbox counts bytes.
        port.send(Word(Where::Nowhere)).expect("room");
        SENDING.set(true);
        port.send(Word(Where::Size)).expect("room");
        SENDING.set(false);
        for _ in 0..50 {
            other_port.send(Word(Where::Nowhere)).expect("room");
        }
        assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle, "{threads} threads");
        let told = runtime.incidents();
        let is_size =
            |told: &Incident| matches!(told, Incident::TurnBroke { message, .. } if message == "size");
        assert!(told.len() == 1 && is_size(&told[0]), "{told:?}");
        assert_eq!(port.send(Word(Where::Nowhere)).expect_err("stopped").reason, Reason::Stopped);
        let shutdown = runtime.end(WAIT);
        assert!(shutdown.drained, "{shutdown:?}");
        assert_eq!(runtime.inspect(broken, |listener| listener.heard), Some(1));
        assert_eq!(runtime.inspect(other, |listener| listener.heard), Some(50));
    }
}

#[test]
fn a_waker_that_panics_leaves_the_threads_alone() {
    let waker: Box<dyn Fn() + Send + Sync> = Box::new(|| panics("waker"));
    let config = Config { waker: Some(waker), ..Config::live(1) };
    let (mut runtime, (_, port, supervisor)) =
        Runtime::build(config, |wiring| wire(wiring, OnPanic::Resume)).expect("builds");
    // The supervisor is pinned, so that its message calls the event loop.
    port.send(Word(Where::Handle)).expect("room");
    while runtime.deliveries() == 0 {
        std::thread::sleep(Duration::from_millis(1));
    }
    assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
    assert_eq!(runtime.inspect(supervisor, |supervisor| supervisor.0.len()), Some(1));
    let beside = beside(&runtime);
    assert!(beside.iter().all(|told| matches!(told, Incident::Beside { message, .. } if message == "waker")));
    assert!(!beside.is_empty() && runtime.shutdown(WAIT).drained);
}

#[test]
fn a_panic_that_ends_the_system_leaves_a_whole_recording() {
    for threads in [0, 2] {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("ended.fvlog");
        let wired = |wiring: &mut Wiring| {
            let wired = wire(wiring, OnPanic::End);
            let other = wiring.declare::<Listener>(Bounds::messages(100));
            let port = wiring.port::<Word, Word>("more words", &other.address());
            wiring.spawn(other, Listener::default(), OnPanic::Stop);
            (wired, port)
        };
        let (mut runtime, ((_, port, supervisor), other_port)) =
            Runtime::build(Config::live(threads).record(&path), wired).expect("builds");
        port.send(Word(Where::Nowhere)).expect("room");
        port.send(Word(Where::Handle)).expect("room");
        port.send(Word(Where::Nowhere)).expect("accepted before it is seen");
        assert_eq!(runtime.pump(Limit::time(WAIT)), Exit::Ended);
        assert_eq!(runtime.pump(Limit::IDLE), Exit::Ended, "and does not go on");
        // What is still accepted is handled.
        other_port.send(Word(Where::Nowhere)).expect("room");
        let shutdown = runtime.end(WAIT);
        assert!(shutdown.drained, "{shutdown:?}");
        assert_eq!(
            shutdown.ended.map(|incident| incident.to_string()),
            Some("listener panicked over Word: handle".into())
        );
        assert_eq!(runtime.inspect(supervisor, |supervisor| supervisor.0.len()), Some(1));
        let trace = read(&std::fs::read(&path).expect("a file"));
        assert!(trace.complete(), "{:?}", trace.damage());
        for threads in [0, 2] {
            let config = Config::replay(Arc::clone(&trace), threads);
            assert_complete(&Runtime::build(config, wired).expect("builds").0.replay());
        }
    }
}

/// A job that panics when it is asked what it is.
struct Riddle(Where);

impl Job for Riddle {
    type Brief = Where;

    fn digest(&self, digest: &mut Digest) {
        if self.0 == Where::Digest {
            panics("digest");
        }
        digest.u32(self.0 as u32);
    }

    fn brief(&self) -> Where {
        if self.0 == Where::Wording { panics("wording") } else { self.0 }
    }

    fn kind(&self) -> &'static str {
        if self.0 == Where::Kind { panics("kind") } else { "Riddle" }
    }
}

struct Solver;

impl Actor for Solver {
    type Msg = Word;
    const NAME: &'static str = "solver";
    const CLASS: Class = Class::Heavy;

    fn handle(&mut self, _: Word, _: &mut Cx<'_, Word>) {}
}

impl Worker for Solver {
    type Job = Riddle;

    fn run(&mut self, riddle: &Riddle, _: &mut Cx<'_, Word>) {
        if riddle.0 == Where::Wording {
            panics("run");
        }
    }
}

struct Asker {
    pool: JobPool<Riddle>,
    riddles: VecDeque<Where>,
}

impl Actor for Asker {
    type Msg = Word;
    const NAME: &'static str = "asker";

    fn started(&mut self, cx: &mut Cx<'_, Word>) {
        while let Some(riddle) = self.riddles.pop_front() {
            assert!(cx.push(&self.pool, 0, 0, Riddle(riddle)).is_ok());
        }
    }

    fn handle(&mut self, _: Word, _: &mut Cx<'_, Word>) {}
}

fn wire_riddles(wiring: &mut Wiring, riddles: &[Where]) -> JobPool<Riddle> {
    let supervisor = wiring.declare::<Supervisor>(Bounds::messages(100));
    wiring.supervisor(&supervisor.address(), Told);
    let pool = wiring.pool::<Riddle>(100);
    wiring.gives_up(&pool, &supervisor.address(), |dead| {
        Told(Incident::Beside { what: format!("{:?}", dead.brief), message: format!("{:?}", dead.why) })
    });
    for _ in 0..2 {
        let solver = wiring.declare::<Solver>(Bounds::messages(1));
        wiring.spawn_worker(solver, Solver, &pool, OnPanic::Resume);
    }
    let asker = wiring.declare::<Asker>(Bounds::messages(1));
    let riddles = riddles.iter().copied().collect();
    wiring.spawn(asker, Asker { pool: pool.clone(), riddles }, OnPanic::Stop);
    wiring.spawn(supervisor, Supervisor::default(), OnPanic::Stop);
    pool
}

#[test]
fn a_job_that_cannot_be_asked_is_given_up() {
    for threads in [0, 2] {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("riddles.fvlog");
        let wired = |wiring: &mut Wiring| wire_riddles(wiring, &[Where::Digest, Where::Kind, Where::Nowhere]);
        let (mut runtime, pool) = Runtime::build(Config::live(threads).record(&path), wired).expect("builds");
        assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
        let stats = pool.stats();
        assert_eq!((stats.dead, stats.completed, stats.waiting), (2, 1, 0), "{stats:?}");
        assert!(runtime.shutdown(WAIT).drained);
        let trace = read(&std::fs::read(&path).expect("a file"));
        let config = Config::replay(trace, threads);
        assert_complete(&Runtime::build(config, wired).expect("builds").0.replay());
    }
}

#[test]
fn a_job_that_nobody_can_be_told_of_ends_the_system() {
    for threads in [0, 2] {
        let wired = |wiring: &mut Wiring| wire_riddles(wiring, &[Where::Wording]);
        let (mut runtime, _) = Runtime::build(Config::live(threads), wired).expect("builds");
        assert_eq!(runtime.pump(Limit::time(WAIT)), Exit::Ended);
        assert!(matches!(runtime.ended(), Some(Incident::JobLost { message, .. }) if message == "wording"));
        assert!(runtime.shutdown(WAIT).drained);
    }
}
