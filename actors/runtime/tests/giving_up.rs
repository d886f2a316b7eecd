//! Jobs that take long and give up once nobody wants them, and recordings of that.

use foveal_runtime::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use crate::common::{WAIT, assert_complete, read};

/// Goes on until nobody wants it, or does nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Work {
    Endless,
    Short,
}

impl Job for Work {
    type Brief = Self;

    fn digest(&self, digest: &mut Digest) {
        digest.u32(*self as u32);
    }

    fn brief(&self) -> Self {
        *self
    }
}

#[derive(Debug, Message)]
enum Told {
    /// From its own timer: the endless work has been going on for a while.
    Enough,
    Done(bool),
}

/// Orders endless work, withdraws it after a while, and orders something else.
struct Chief {
    pool: JobPool<Work>,
    done: Vec<bool>,
}

impl Actor for Chief {
    type Msg = Told;
    const NAME: &'static str = "chief";

    fn started(&mut self, cx: &mut Cx<'_, Told>) {
        cx.push(&self.pool, 0, 0, Work::Endless).expect("room");
        cx.after(Duration::from_millis(100), Told::Enough).expect("room");
    }

    fn handle(&mut self, told: Told, cx: &mut Cx<'_, Told>) {
        match told {
            Told::Enough => {
                cx.retire(&self.pool, 1);
                cx.push(&self.pool, 0, 1, Work::Short).expect("room");
            }
            Told::Done(done) => self.done.push(done),
        }
    }
}

#[derive(Message)]
enum Nothing {}

struct Hand {
    chief: Address<Told>,
    begun: Arc<AtomicU32>,
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
    type Job = Work;

    fn run(&mut self, work: &Work, cx: &mut Cx<'_, Nothing>) {
        let begun = &self.begun;
        let done = cx.while_wanted(|is_wanted| {
            begun.fetch_add(1, Ordering::SeqCst);
            let until = Instant::now() + WAIT;
            if *work == Work::Short {
                return Some(());
            }
            while is_wanted() {
                assert!(Instant::now() < until, "nobody says that it is enough");
                std::thread::yield_now();
            }
            None
        });
        cx.tell(&self.chief, Told::Done(done.is_some())).expect("room");
    }

    /// Nobody came to begin it in time.
    fn stale(&mut self, _: &Work, cx: &mut Cx<'_, Nothing>) {
        cx.tell(&self.chief, Told::Done(false)).expect("room");
    }
}

struct Wired {
    chief: Handle<Chief>,
    begun: Arc<AtomicU32>,
}

fn wire(wiring: &mut Wiring) -> Wired {
    let chief = wiring.declare::<Chief>(Bounds::messages(10));
    let pool = wiring.pool::<Work>(10);
    let begun = Arc::<AtomicU32>::default();
    let hand = wiring.declare::<Hand>(Bounds::messages(1));
    let state = Hand { chief: chief.address(), begun: begun.clone() };
    wiring.spawn_worker(hand, state, &pool, OnPanic::Resume);
    let state = Chief { pool, done: Vec::new() };
    Wired { chief: wiring.spawn(chief, state, OnPanic::Resume), begun }
}

#[test]
fn work_that_is_withdrawn_gives_up_and_is_not_begun_in_replay() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("giving-up.fvlog");
    let (mut runtime, wired) = Runtime::build(Config::live(2).record(&path), wire).expect("builds");
    assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
    assert!(runtime.end(WAIT).drained);
    assert_eq!(runtime.inspect(wired.chief, |chief| chief.done.clone()), Some(vec![false, true]));
    let trace = read(&std::fs::read(path).expect("a file"));
    for threads in [0, 2] {
        let (mut runtime, wired) =
            Runtime::build(Config::replay(Arc::clone(&trace), threads), wire).expect("builds");
        assert_complete(&runtime.replay());
        assert_eq!(wired.begun.load(Ordering::SeqCst), 1, "what was given up costs nothing");
    }
}
