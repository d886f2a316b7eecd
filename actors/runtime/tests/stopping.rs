//! Turns that take long and end early once their actor is to stop, and recordings of that.

use foveal_runtime::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use crate::common::{WAIT, assert_complete, read};

#[derive(Debug, Message)]
enum Turn {
    /// Done at once.
    Short,
    /// Goes on until nobody wants it.
    Endless,
}

/// Does one short piece of work, then one that never ends by itself.
struct Worker {
    begun: Arc<AtomicU32>,
    done: u32,
}

impl Actor for Worker {
    type Msg = Turn;
    const NAME: &'static str = "worker";
    const CLASS: Class = Class::Heavy;

    fn started(&mut self, cx: &mut Cx<'_, Turn>) {
        let own = cx.address().clone();
        cx.tell(&own, Turn::Short).expect("room");
    }

    fn handle(&mut self, turn: Turn, cx: &mut Cx<'_, Turn>) {
        let begun = &self.begun;
        let done = cx.while_running(|goes_on| {
            begun.fetch_add(1, Ordering::SeqCst);
            let until = Instant::now() + WAIT;
            if matches!(turn, Turn::Short) {
                return Some(());
            }
            while goes_on() {
                assert!(Instant::now() < until, "nobody says that it is enough");
                std::thread::yield_now();
            }
            None
        });
        if done.is_some() {
            self.done += 1;
            let own = cx.address().clone();
            cx.tell(&own, Turn::Endless).expect("room");
        }
    }
}

fn wire(wiring: &mut Wiring) -> (Handle<Worker>, Arc<AtomicU32>) {
    let worker = wiring.declare::<Worker>(Bounds::messages(4));
    let begun = Arc::<AtomicU32>::default();
    (wiring.spawn(worker, Worker { begun: begun.clone(), done: 0 }, OnPanic::Resume), begun)
}

/// How long the system takes to end while the worker is in the middle of its endless turn.
fn ends_after(runtime: &mut Runtime, begun: &AtomicU32, end: impl FnOnce(&mut Runtime)) -> Duration {
    let until = Instant::now() + WAIT;
    while begun.load(Ordering::SeqCst) < 2 {
        assert!(Instant::now() < until);
        runtime.pump(Limit::time(Duration::from_millis(1)));
    }
    let start = Instant::now();
    end(runtime);
    start.elapsed()
}

#[test]
fn an_actor_that_is_to_stop_leaves_a_long_turn_soon_and_does_not_begin_it_in_replay() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("stopping.fvlog");
    let (mut runtime, (worker, begun)) = Runtime::build(Config::live(2).record(&path), wire).expect("builds");
    let taken = ends_after(&mut runtime, &begun, |runtime| {
        runtime.control(worker, Control::Stop);
        assert!(runtime.end(WAIT).drained);
    });
    // Far less than anybody would wait, and far more than a busy machine needs.
    assert!(taken < Duration::from_secs(5), "{taken:?}");
    assert_eq!(runtime.inspect(worker, |worker| worker.done), Some(1));
    let trace = read(&std::fs::read(path).expect("a file"));
    let given_up = trace.events(worker.id()).filter(|e| matches!(e, Event::GivenUp { .. })).count();
    assert_eq!(given_up, 1);
    for threads in [0, 2] {
        let (mut runtime, (_, begun)) =
            Runtime::build(Config::replay(Arc::clone(&trace), threads), wire).expect("builds");
        assert_complete(&runtime.replay());
        assert_eq!(begun.load(Ordering::SeqCst), 1, "what was given up costs nothing");
    }
}

/// Nobody waits for the end of a turn whose actor could not even be told to stop in time.
#[test]
fn a_system_that_is_left_ends_long_turns_too() {
    let (mut runtime, (_, begun)) = Runtime::build(Config::live(2), wire).expect("builds");
    let taken = ends_after(&mut runtime, &begun, |runtime| {
        runtime.end(Duration::from_millis(50));
    });
    assert!(taken < Duration::from_secs(5), "{taken:?}");
}
