//! Workers that keep jobs and end them in later turns: each job is told once, whatever becomes of those who keep them.

use foveal_runtime::simulate::{Simulation, Strategy};
use foveal_runtime::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use crate::common::{WAIT, assert_complete, read};

/// Even ones travel.
struct Piece(u64);

impl Job for Piece {
    type Brief = u64;

    fn digest(&self, digest: &mut Digest) {
        digest.u64(self.0);
    }

    fn brief(&self) -> u64 {
        self.0
    }

    fn travels(&self) -> bool {
        self.0.is_multiple_of(2)
    }

    fn save(&self, saver: &mut Saver) {
        saver.put(&self.0);
    }

    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        loader.take().map(Self)
    }
}

#[derive(Message)]
enum Told {
    Order(Order),
    Done { piece: u64, by: u32 },
    Stale(u64),
}

#[derive(Serialize, Deserialize)]
struct Order {
    pieces: u64,
    retires: bool,
}

impl From<Order> for Told {
    fn from(order: Order) -> Self {
        Self::Order(order)
    }
}

struct Chief {
    pool: JobPool<Piece>,
    made: u64,
    epoch: u64,
    /// How often each piece was told, and who told of it.
    told: BTreeMap<u64, Vec<u32>>,
    stale: u64,
}

impl Actor for Chief {
    type Msg = Told;
    const NAME: &'static str = "chief";

    fn handle(&mut self, told: Told, cx: &mut Cx<'_, Told>) {
        match told {
            Told::Order(Order { pieces, retires }) => {
                if retires {
                    self.epoch += 1;
                    cx.retire(&self.pool, self.epoch);
                }
                for _ in 0..pieces {
                    let bucket = (cx.random() % 64) as u8;
                    cx.push(&self.pool, bucket, self.epoch, Piece(self.made)).expect("room");
                    self.made += 1;
                }
            }
            Told::Done { piece, by } => self.told.entry(piece).or_default().push(by),
            Told::Stale(piece) => {
                self.told.entry(piece).or_default().push(u32::MAX);
                self.stale += 1;
            }
        }
    }

    fn save(&self, saver: &mut Saver) {
        saver.put(&(self.made, self.epoch, &self.told, self.stale));
    }

    fn restore(&mut self, loader: &mut Loader<'_>) -> Option<()> {
        (self.made, self.epoch, self.told, self.stale) = loader.take()?;
        Some(())
    }
}

#[derive(Message)]
enum Nothing {}

struct Hand {
    number: u32,
    chief: Address<Told>,
}

impl Actor for Hand {
    type Msg = Nothing;
    const NAME: &'static str = "hand";
    const CLASS: Class = Class::Heavy;

    fn handle(&mut self, message: Nothing, _: &mut Cx<'_, Nothing>) {
        match message {}
    }

    fn save(&self, _: &mut Saver) {}

    fn restore(&mut self, _: &mut Loader<'_>) -> Option<()> {
        Some(())
    }
}

impl Worker for Hand {
    type Job = Piece;

    fn run(&mut self, piece: &Piece, cx: &mut Cx<'_, Nothing>) {
        let (_, _) = cx.measure(|| std::hint::black_box((0..2000_u64).sum::<u64>()));
        if cx.claim() {
            cx.tell(&self.chief, Told::Done { piece: piece.0, by: self.number }).expect("room");
        }
    }

    fn stale(&mut self, piece: &Piece, cx: &mut Cx<'_, Nothing>) {
        cx.tell(&self.chief, Told::Stale(piece.0)).expect("room");
    }
}

#[derive(Message)]
enum ShelfMsg {
    /// Its time is up.
    Due(u64),
}

/// Keeps up to four pieces, each for a while; then some are done, some handed back, some shared first.
struct Shelf {
    number: u32,
    pool: JobPool<Piece>,
    chief: Address<Told>,
    kept: BTreeMap<u64, (Kept, bool)>,
    late: u64,
}

impl Actor for Shelf {
    type Msg = ShelfMsg;
    const NAME: &'static str = "shelf";

    fn handle(&mut self, message: ShelfMsg, cx: &mut Cx<'_, ShelfMsg>) {
        let ShelfMsg::Due(number) = message;
        let Some((job, shared)) = self.kept.remove(&number) else { return };
        let piece = cx.kept(&self.pool, job).expect("it is kept").0;
        match (cx.random() % 4, shared) {
            (0, _) => cx.hand_back(&self.pool, job),
            (1, false) => {
                cx.share(&self.pool, job);
                cx.share(&self.pool, job);
                self.kept.insert(number, (job, true));
                let delay = Duration::from_micros(cx.random() % 200);
                cx.after(delay, ShelfMsg::Due(number)).expect("few run");
            }
            _ => {
                if cx.finish(&self.pool, job) {
                    cx.tell(&self.chief, Told::Done { piece, by: 100 + self.number }).expect("room");
                } else {
                    self.late += 1;
                }
                assert!(!cx.finish(&self.pool, job), "what is over is over");
            }
        }
    }

    fn save(&self, saver: &mut Saver) {
        saver.put(&(&self.kept, self.late));
    }

    fn restore(&mut self, loader: &mut Loader<'_>) -> Option<()> {
        (self.kept, self.late) = loader.take()?;
        Some(())
    }
}

impl Worker for Shelf {
    type Job = Piece;
    const KEEPS: bool = true;

    fn room(&self) -> bool {
        self.kept.len() < 4
    }

    fn run(&mut self, piece: &Piece, cx: &mut Cx<'_, ShelfMsg>) {
        assert!(piece.travels());
        let job = cx.keep();
        self.kept.insert(job.number(), (job, false));
        let delay = Duration::from_micros(cx.random() % 300);
        cx.after(delay, ShelfMsg::Due(job.number())).expect("few run");
    }

    fn stale(&mut self, piece: &Piece, cx: &mut Cx<'_, ShelfMsg>) {
        cx.tell(&self.chief, Told::Stale(piece.0)).expect("room");
    }
}

struct Wired {
    chief: Handle<Chief>,
    orders: Port<Order, Told>,
    shelves: Vec<Handle<Shelf>>,
    pool: JobPool<Piece>,
}

fn wire(wiring: &mut Wiring, leased: bool) -> Wired {
    let chief = wiring.declare::<Chief>(Bounds::messages(4096));
    let orders = wiring.port("orders", &chief.address());
    let pool = wiring.pool::<Piece>(4096);
    if leased {
        wiring.leases(&pool, Duration::from_secs(60));
    }
    for number in 0..2 {
        let hand = wiring.declare::<Hand>(Bounds::messages(1));
        wiring.spawn_worker(hand, Hand { number, chief: chief.address() }, &pool, OnPanic::Resume);
    }
    let mut shelves = Vec::new();
    for number in 0..2 {
        let shelf = wiring.declare::<Shelf>(Bounds::messages(16));
        let state =
            Shelf { number, pool: pool.clone(), chief: chief.address(), kept: BTreeMap::new(), late: 0 };
        shelves.push(wiring.spawn_worker(shelf, state, &pool, OnPanic::Resume));
    }
    let state = Chief { pool: pool.clone(), made: 0, epoch: 0, told: BTreeMap::new(), stale: 0 };
    Wired { chief: wiring.spawn(chief, state, OnPanic::Resume), orders, shelves, pool }
}

fn order(wired: &Wired, number: u64) {
    wired.orders.send(Order { pieces: 16, retires: number % 3 == 2 }).expect("room");
}

/// Every piece was told once; returns how many by whom keeps, and how many were late.
fn check(runtime: &Runtime, wired: &Wired, pieces: u64) -> (u64, u64) {
    let (told, stale) = runtime.inspect(wired.chief, |c| (c.told.clone(), c.stale)).expect("at rest");
    assert!(told.keys().copied().eq(0..pieces), "{told:?}");
    assert!(told.values().all(|by| by.len() == 1), "{told:?}");
    let stats = wired.pool.stats();
    assert_eq!((stats.kept, stats.twice, stats.waiting), (0, 0, 0), "{stats:?}");
    assert_eq!((stats.completed, stats.stale), (pieces - stale, stale), "{stats:?}");
    let late = |shelf| runtime.inspect(shelf, |s: &Shelf| s.late).expect("at rest");
    let by_shelves = told.values().filter(|by| (100..200).contains(&by[0])).count() as u64;
    (by_shelves, wired.shelves.iter().map(|&shelf| late(shelf)).sum())
}

#[test]
fn kept_jobs_end_once_and_a_recording_of_it_replays() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("keeping.fvlog");
    for leased in [false, true] {
        let config = Config::live(3).record(&path);
        let (mut runtime, wired) = Runtime::build(config, |wiring| wire(wiring, leased)).expect("builds");
        for number in 0..40 {
            order(&wired, number);
            runtime.pump(Limit::time(Duration::from_micros(300)));
        }
        assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
        let shutdown = runtime.end(WAIT);
        let (kept, _) = check(&runtime, &wired, 640);
        assert!(kept > 0);
        assert!(shutdown.drained && shutdown.jobs_left == 0, "{shutdown:?}");
        let trace = read(&std::fs::read(&path).expect("a file"));
        for threads in [0, 2] {
            let config = Config::replay(Arc::clone(&trace), threads);
            let (mut runtime, wired) = Runtime::build(config, |wiring| wire(wiring, leased)).expect("builds");
            assert_complete(&runtime.replay());
            let told = runtime.inspect(wired.chief, |chief| chief.told.len());
            assert!(told == Some(640) || threads > 0, "{told:?}");
        }
    }
}

#[test]
fn simulated_keepers_lose_nothing_and_tell_nothing_twice() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("kept.fvlog");
    let (mut kept, mut late) = (0, 0);
    for seed in 0..400 {
        let leased = seed % 2 == 0;
        let simulation = Simulation { strategy: Strategy::Random, ..Simulation::new(seed) };
        let mut config = Config::simulate(simulation);
        let recorded = seed % 20 == 0;
        config.record = recorded.then(|| Record::File(path.clone()));
        let (mut runtime, wired) = Runtime::build(config, |wiring| wire(wiring, leased)).expect("builds");
        for number in 0..6 {
            order(&wired, number);
        }
        assert_eq!(runtime.pump(Limit::IDLE), Exit::Idle, "seed {seed}: {:?}", runtime.failure());
        let (by_shelves, were_late) = check(&runtime, &wired, 96);
        (kept, late) = (kept + by_shelves, late + were_late);
        assert!(runtime.shutdown(WAIT).drained);
        if recorded {
            let trace = Arc::new(Trace::open(&path).expect("reads"));
            let config = Config::replay(trace, 0);
            let (mut runtime, _) = Runtime::build(config, |wiring| wire(wiring, leased)).expect("builds");
            assert_complete(&runtime.replay());
        }
    }
    assert!(kept > 1000 && late > 10, "{kept} kept jobs were done, {late} late");
}

#[test]
fn a_replay_goes_on_from_a_snapshot_with_kept_jobs() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("kept.fvlog");
    let mut held = 0;
    for seed in 0..12 {
        let mut config = Config::simulate(Simulation::new(seed));
        config.record = Some(Record::File(path.clone()));
        let (mut runtime, wired) = Runtime::build(config, |wiring| wire(wiring, true)).expect("builds");
        for number in 0..6 {
            order(&wired, number);
        }
        assert_eq!(runtime.pump(Limit::IDLE), Exit::Idle);
        assert!(runtime.shutdown(WAIT).drained);
        let trace = Arc::new(Trace::open(&path).expect("reads"));
        let (mut runtime, wired) =
            Runtime::build(Config::replay(Arc::clone(&trace), 0), |wiring| wire(wiring, true))
                .expect("builds");
        while runtime.step(None).is_some() {
            let keeps =
                |&shelf: &Handle<Shelf>| runtime.inspect(shelf, |shelf| !shelf.kept.is_empty()) == Some(true);
            if wired.shelves.iter().any(keeps) {
                held += 1;
                if held % 4 != 1 {
                    continue;
                }
                let snapshot = runtime.snapshot().expect("everything is saved");
                let from = Some(Arc::new(snapshot));
                let config = Config { from, ..Config::replay(Arc::clone(&trace), 0) };
                let (mut other, wired) = Runtime::build(config, |wiring| wire(wiring, true)).expect("builds");
                assert_complete(&other.replay());
                assert_eq!(other.inspect(wired.chief, |chief| chief.told.len()), Some(96));
            }
        }
    }
    assert!(held > 8, "{held} steps with kept jobs");
}
