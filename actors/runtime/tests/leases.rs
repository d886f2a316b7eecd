//! Workers that hang: their jobs are done by others, once, and a recording of it replays.

use foveal_runtime::simulate::{FaultKind, Faults, Simulation, Strategy};
use foveal_runtime::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::{Duration, Instant};

use crate::common::{WAIT, assert_complete, read, replay_workshop};
use crate::workshop::{self, Options, Order, Task};

/// A door that workers may find shut.
#[derive(Default)]
struct Door {
    open: AtomicBool,
    /// How many are to stand before it.
    holds: AtomicU32,
}

impl Door {
    fn pass(&self) {
        let hold = |left: u32| left.checked_sub(1);
        if self.holds.fetch_update(Ordering::SeqCst, Ordering::SeqCst, hold).is_ok() {
            while !self.open.load(Ordering::SeqCst) {
                std::thread::sleep(Duration::from_millis(1));
            }
        }
    }
}

#[derive(Debug, Message)]
enum Told {
    Done(u64),
    #[message(lane = control)]
    Dead(DeadJob<u64>),
}

/// Gives out tasks, and keeps what it is told.
struct Chief {
    pool: JobPool<Task>,
    tasks: u64,
    done: Vec<u64>,
    dead: Vec<DeadJob<u64>>,
}

impl Actor for Chief {
    type Msg = Told;
    const NAME: &'static str = "chief";

    fn started(&mut self, cx: &mut Cx<'_, Told>) {
        for number in 0..self.tasks {
            cx.push(&self.pool, 0, 0, Task { number, kills: 0 }).expect("room");
        }
    }

    fn handle(&mut self, told: Told, _: &mut Cx<'_, Told>) {
        match told {
            Told::Done(number) => self.done.push(number),
            Told::Dead(dead) => self.dead.push(dead),
        }
    }
}

#[derive(Message)]
enum Nothing {}

struct Hand {
    door: Arc<Door>,
    chief: Address<Told>,
    late: Arc<AtomicU32>,
}

impl Actor for Hand {
    type Msg = Nothing;
    const NAME: &'static str = "hand";
    const CLASS: Class = Class::Heavy;

    fn handle(&mut self, message: Nothing, _: &mut Cx<'_, Nothing>) {
        match message {}
    }
}

impl Worker for Hand {
    type Job = Task;

    fn run(&mut self, task: &Task, cx: &mut Cx<'_, Nothing>) {
        if task.number == 0 && cx.effects() {
            self.door.pass();
        }
        if !cx.claim() {
            assert!(!cx.claim(), "what is lost stays lost");
            self.late.fetch_add(1, Ordering::SeqCst);
            return;
        }
        cx.tell(&self.chief, Told::Done(task.number)).expect("room");
    }
}

struct Wired {
    chief: Handle<Chief>,
    pool: JobPool<Task>,
    door: Arc<Door>,
    late: Arc<AtomicU32>,
}

fn wire(wiring: &mut Wiring, hands: u32, tasks: u64) -> Wired {
    let chief = wiring.declare::<Chief>(Bounds::messages(1000));
    let pool = wiring.pool::<Task>(1000);
    wiring.leases(&pool, Duration::from_millis(20));
    wiring.gives_up(&pool, &chief.address(), Told::Dead);
    let (door, late) = <(Arc<Door>, Arc<AtomicU32>)>::default();
    for _ in 0..hands {
        let hand = wiring.declare::<Hand>(Bounds::messages(1));
        let state = Hand { door: door.clone(), chief: chief.address(), late: late.clone() };
        wiring.spawn_worker(hand, state, &pool, OnPanic::Resume);
    }
    let state = Chief { pool: pool.clone(), tasks, done: Vec::new(), dead: Vec::new() };
    Wired { chief: wiring.spawn(chief, state, OnPanic::Resume), pool, door, late }
}

/// Pumps until so many jobs are done or given up, while somebody may hang.
fn pump(runtime: &mut Runtime, pool: &JobPool<Task>, ended: u64) {
    let until = Instant::now() + WAIT;
    while pool.stats().completed + pool.stats().dead < ended {
        assert!(Instant::now() < until, "{:?}", pool.stats());
        runtime.pump(Limit::time(Duration::from_millis(2)));
    }
}

/// Records a system in which the first task is held up for the first `holds` workers who get it.
fn record(hands: u32, holds: u32, tasks: u64) -> (Vec<u8>, Vec<u64>, Vec<DeadJob<u64>>, u32) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("leases.fvlog");
    let config = Config::live(hands as usize + 1).record(&path);
    let (mut runtime, wired) = Runtime::build(config, |wiring| {
        let wired = wire(wiring, hands, tasks);
        wired.door.holds.store(holds, Ordering::SeqCst);
        wired
    })
    .expect("builds");
    pump(&mut runtime, &wired.pool, tasks);
    let lost = |told: &Incident| matches!(told, Incident::LeaseLost { name, .. } if name.starts_with("hand"));
    assert_eq!(runtime.incidents().iter().filter(|told| lost(told)).count(), holds as usize);
    wired.door.open.store(true, Ordering::SeqCst);
    assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
    assert!(runtime.end(WAIT).drained);
    let told = runtime.inspect(wired.chief, |chief| (chief.done.clone(), chief.dead.clone()));
    let (done, dead) = told.expect("at rest");
    assert_eq!(wired.pool.stats().completed, done.len() as u64, "what is late is not counted");
    (std::fs::read(path).expect("a file"), done, dead, wired.late.load(Ordering::SeqCst))
}

#[test]
fn a_job_of_a_worker_that_hangs_is_done_by_another_and_told_once() {
    for holds in [1, 2] {
        let (bytes, mut done, dead, late) = record(3, holds, 40);
        done.sort_unstable();
        assert!(done.into_iter().eq(0..40) && dead.is_empty());
        assert_eq!(late, holds, "each that hung was told that it was late");
        let trace = read(&bytes);
        let lost = |actor| trace.events(actor).filter(|e| matches!(e, Event::LeaseLost { .. })).count();
        assert_eq!((0..4).map(|actor| lost(ActorId(actor))).sum::<usize>(), holds as usize);
        for threads in [0, 2] {
            let config = Config::replay(Arc::clone(&trace), threads);
            let (mut runtime, wired) = Runtime::build(config, |wiring| wire(wiring, 3, 40)).expect("builds");
            assert_complete(&runtime.replay());
            assert_eq!(wired.late.load(Ordering::SeqCst), holds);
        }
    }
}

#[test]
fn a_job_that_every_worker_hangs_at_is_given_up() {
    let (bytes, mut done, dead, late) = record(4, 3, 10);
    done.sort_unstable();
    assert!(done.into_iter().eq(1..10));
    assert!(matches!(&dead[..], [DeadJob { brief: 0, why: Death::Expired, .. }]), "{dead:?}");
    assert_eq!(late, 3);
    let trace = read(&bytes);
    let (mut runtime, wired) =
        Runtime::build(Config::replay(trace, 0), |wiring| wire(wiring, 4, 10)).expect("builds");
    assert_complete(&runtime.replay());
    assert_eq!(runtime.inspect(wired.chief, |chief| chief.dead.clone()), Some(dead));
}

#[test]
fn simulated_workers_hang_and_every_task_is_told_once() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, mut lost) = (folder.path().join("hanging.fvlog"), 0);
    for seed in 0..300 {
        let faults = Faults::Seeded { kinds: vec![FaultKind::Hang], each: 3, horizon: 20 };
        let simulation = Simulation { strategy: Strategy::Random, faults, ..Simulation::new(seed) };
        let mut config = Config::simulate(simulation);
        config.record = (seed % 10 == 0).then(|| Record::File(path.clone()));
        let options = Options { work: 3, ..Options::new(3) };
        let (mut runtime, shop) =
            Runtime::build(config, |wiring| workshop::wire(wiring, options)).expect("builds");
        for _ in 0..4 {
            shop.orders.send(Order { tasks: 8 }).expect("room");
        }
        assert_eq!(runtime.pump(Limit::IDLE), Exit::Idle, "{:?}", runtime.failure());
        let told = runtime.inspect(shop.office, |office| (office.made, office.done, office.given_up));
        let (made, done, given_up) = told.expect("at rest");
        assert_eq!((made, done + given_up), (32, 32), "seed {seed}");
        lost += shop.pool.stats().requeued;
        let recorded = seed % 10 == 0;
        assert!(runtime.shutdown(WAIT).drained);
        if recorded {
            let trace = Arc::new(Trace::open(&path).expect("reads"));
            for threads in [0, 2] {
                assert_complete(&replay_workshop(&trace, threads, options));
            }
        }
    }
    assert!(lost > 300, "only {lost} jobs were lost");
}
