//! Work that heavy actors stand aside for.

use foveal_runtime::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use crate::common::WAIT;
use crate::live::Number;

/// Turns of each heavy actor.
const TURNS: u64 = 3000;
const DIGGERS: usize = 3;

/// Goes on telling itself, and counts.
struct Digger {
    turns: u64,
    begun: Arc<AtomicU64>,
}

impl Actor for Digger {
    type Msg = Number;
    const NAME: &'static str = "digger";
    const CLASS: Class = Class::Heavy;

    fn handle(&mut self, _: Number, cx: &mut Cx<'_, Number>) {
        self.turns += 1;
        self.begun.fetch_add(1, Ordering::SeqCst);
        if self.turns < TURNS {
            let me = cx.address().clone();
            assert!(cx.tell(&me, Number(0)).is_ok());
        }
    }
}

/// Looks how many turns begin while it is not to be disturbed.
struct Painter {
    begun: Arc<AtomicU64>,
    most: u64,
}

impl Actor for Painter {
    type Msg = Number;
    const NAME: &'static str = "painter";
    const CLASS: Class = Class::Pinned;

    fn handle(&mut self, _: Number, cx: &mut Cx<'_, Number>) {
        let begun = Arc::clone(&self.begun);
        let meanwhile = cx.undisturbed(|_| {
            let before = begun.load(Ordering::SeqCst);
            std::thread::sleep(Duration::from_millis(2));
            begun.load(Ordering::SeqCst) - before
        });
        self.most = self.most.max(meanwhile);
    }
}

#[test]
fn heavy_actors_stand_aside_and_all_of_them_go_on() {
    for threads in [0, 1, 2, 4] {
        let begun = Arc::new(AtomicU64::new(0));
        // One message a turn.
        let config = Config { budget: Budget { messages: 1, nanoseconds: u64::MAX }, ..Config::live(threads) };
        let (mut runtime, (painter, paints, digs)) = Runtime::build(config, |wiring| {
            let painter = wiring.declare::<Painter>(Bounds::messages(100));
            let paints = wiring.port::<Number, Number>("paints", &painter.address());
            let digs: Vec<_> = (0..DIGGERS)
                .map(|_| {
                    let digger = wiring.declare::<Digger>(Bounds::messages(10));
                    let port = wiring.port::<Number, Number>("digs", &digger.address());
                    wiring.spawn(digger, Digger { turns: 0, begun: Arc::clone(&begun) }, OnPanic::Stop);
                    port
                })
                .collect();
            let looks = Painter { begun: Arc::clone(&begun), most: 0 };
            (wiring.spawn(painter, looks, OnPanic::Stop), paints, digs)
        })
        .expect("builds");
        for dig in &digs {
            dig.send(Number(0)).expect("room");
        }
        for _ in 0..20 {
            paints.send(Number(0)).expect("room");
        }
        assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle, "{threads} threads");
        assert_eq!(begun.load(Ordering::SeqCst), TURNS * DIGGERS as u64, "{threads} threads");
        // What had been taken from the queue before is under way.
        let most = runtime.inspect(painter, |painter| painter.most).expect("pinned");
        assert!(most <= threads as u64, "{most} turns began beside it on {threads} threads");
    }
}

#[test]
fn a_panic_lets_the_others_go_on() {
    struct Bad;
    impl Actor for Bad {
        type Msg = Number;
        const NAME: &'static str = "bad";
        const CLASS: Class = Class::Pinned;
        fn handle(&mut self, _: Number, cx: &mut Cx<'_, Number>) {
            cx.undisturbed(|_| std::panic::resume_unwind(Box::new("bad")));
        }
    }
    let begun = Arc::new(AtomicU64::new(0));
    let (mut runtime, (bad, dig)) = Runtime::build(Config::live(2), |wiring| {
        let bad = wiring.declare::<Bad>(Bounds::messages(10));
        let bads = wiring.port::<Number, Number>("bads", &bad.address());
        wiring.spawn(bad, Bad, OnPanic::Resume);
        let digger = wiring.declare::<Digger>(Bounds::messages(10));
        let port = wiring.port::<Number, Number>("digs", &digger.address());
        wiring.spawn(digger, Digger { turns: 0, begun: Arc::clone(&begun) }, OnPanic::Stop);
        (bads, port)
    })
    .expect("builds");
    bad.send(Number(0)).expect("room");
    assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
    dig.send(Number(0)).expect("room");
    assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
    assert_eq!(begun.load(Ordering::SeqCst), TURNS);
}
