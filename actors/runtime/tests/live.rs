//! Live systems: scheduling, bounds, pausing, panics, shutdown.

use foveal_runtime::*;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crate::common::WAIT;
use crate::ring;
use crate::workshop::{self, Options, Order};

#[derive(Serialize, Deserialize)]
pub struct Number(pub u64);

impl Message for Number {
    fn digest(&self, digest: &mut Digest) {
        digest.u64(self.0);
    }

    fn kind(&self) -> &'static str {
        "Number"
    }

    fn lane(&self) -> Lane {
        if self.0 == u64::MAX { Lane::Control } else { Lane::Data }
    }

    fn size_bytes(&self) -> usize {
        if self.0 >= 1 << 40 { (self.0 & 0xffff) as usize } else { 0 }
    }
}

/// Adds numbers, and checks that those of one sender come in order.
#[derive(Default)]
struct Sum {
    count: u64,
    sum: u64,
    control_after: Option<u64>,
}

impl Actor for Sum {
    type Msg = Number;
    const NAME: &'static str = "sum";

    fn handle(&mut self, number: Number, _: &mut Cx<'_, Number>) {
        if number.0 == u64::MAX {
            self.control_after = Some(self.count);
        } else {
            self.count += 1;
            self.sum += number.0;
        }
    }
}

#[derive(Default)]
struct PinnedSum(Sum);

impl Actor for PinnedSum {
    type Msg = Number;
    const NAME: &'static str = "pinned";
    const CLASS: Class = Class::Pinned;

    fn handle(&mut self, number: Number, cx: &mut Cx<'_, Number>) {
        self.0.handle(number, cx);
    }
}

#[test]
fn ping_pong_runs_on_any_number_of_threads() {
    for threads in [0, 1, 2, 3, 8] {
        let (mut runtime, _) =
            Runtime::build(Config::live(threads), |wiring| ring::wire(wiring, 2, 1, 10_000)).expect("builds");
        assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle, "{threads} threads");
        assert_eq!(runtime.deliveries(), 2 + 10_001, "two meet, then the token is passed on");
    }
}

#[test]
fn a_full_mailbox_gives_the_message_back() {
    let (mut runtime, (sum, port)) = Runtime::build(Config::live(0), |wiring| {
        let sum = wiring.declare::<Sum>(Bounds::messages(100).bytes(1000));
        let port = wiring.port::<Number, Number>("numbers", &sum.address());
        (wiring.spawn(sum, Sum::default(), OnPanic::Resume), port)
    })
    .expect("builds");
    for number in 0..100 {
        port.send(Number(number)).expect("there is room");
    }
    let back = port.send(Number(4711)).expect_err("full");
    assert_eq!((back.message.0, back.reason), (4711, Reason::Full));
    // The control lane has its own room, and is served first.
    port.send(Number(u64::MAX)).expect("room in the control lane");
    assert_eq!(runtime.pump(Limit::IDLE), Exit::Idle);
    assert_eq!(
        runtime.inspect(sum, |sum| (sum.count, sum.sum, sum.control_after)),
        Some((100, 4950, Some(0)))
    );
    // Bytes count too: 600 + 600 exceed 1000, but one alone may be as large as it likes.
    port.send(Number(1 << 40 | 600)).expect("alone");
    assert_eq!(port.send(Number(1 << 40 | 600)).expect_err("too many bytes").reason, Reason::FullBytes);
    runtime.pump(Limit::IDLE);
    port.send(Number(1 << 40 | 5000)).expect("alone");
    runtime.pump(Limit::IDLE);
    assert_eq!(runtime.counters()[0].rejected, 2);
    assert_eq!(runtime.counters()[0].delivered, 103);
}

/// Sends numbers to somebody, as fast as the mailbox takes them.
struct Flood {
    to: Address<Number>,
    next: u64,
    end: u64,
}

impl Actor for Flood {
    type Msg = Number;
    const NAME: &'static str = "flood";

    fn started(&mut self, cx: &mut Cx<'_, Number>) {
        self.handle(Number(0), cx);
    }

    fn handle(&mut self, _: Number, cx: &mut Cx<'_, Number>) {
        while self.next < self.end {
            if cx.tell(&self.to, Number(self.next)).is_err() {
                // Full: try again after whatever else waits.
                let me = cx.address().clone();
                cx.tell(&me, Number(0)).expect("one reminder at a time");
                return;
            }
            self.next += 1;
        }
    }
}

#[test]
fn fan_in_of_bursts_loses_nothing() {
    const EACH: u64 = 100_000;
    for threads in [0, 1, 2, 4] {
        let (mut runtime, (light, pinned)) = Runtime::build(Config::live(threads), |wiring| {
            let light = wiring.declare::<Sum>(Bounds::messages(1024));
            let pinned = wiring.declare::<PinnedSum>(Bounds::messages(512));
            for number in 0..4 {
                let to = if number % 2 == 0 { light.address() } else { pinned.address() };
                let flood = wiring.declare::<Flood>(Bounds::messages(1));
                wiring.spawn(flood, Flood { to, next: 0, end: EACH }, OnPanic::Resume);
            }
            (
                wiring.spawn(light, Sum::default(), OnPanic::Resume),
                wiring.spawn(pinned, PinnedSum::default(), OnPanic::Resume),
            )
        })
        .expect("builds");
        assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
        let expected = (2 * EACH, EACH * (EACH - 1));
        assert_eq!(runtime.inspect(pinned, |sum| (sum.0.count, sum.0.sum)), Some(expected));
        let counters = runtime.counters();
        assert_eq!(counters[light.id().0 as usize].delivered, 2 * EACH);
        assert!(counters[light.id().0 as usize].turns < 2 * EACH, "turns take many messages");
        let shutdown = runtime.shutdown(WAIT);
        assert!(shutdown.drained && shutdown.dead_letters == 0, "{threads}: {shutdown:?}");
    }
}

#[test]
fn control_overtakes_a_flood() {
    const QUEUED: u64 = 100_000;
    let (mut runtime, (sum, port)) = Runtime::build(Config::live(0), |wiring| {
        let sum = wiring.declare::<Sum>(Bounds::messages(QUEUED as usize));
        let port = wiring.port::<Number, Number>("numbers", &sum.address());
        (wiring.spawn(sum, Sum::default(), OnPanic::Resume), port)
    })
    .expect("builds");
    for number in 0..QUEUED {
        port.send(Number(number)).expect("room");
    }
    // In the middle of the flood, control is served with the next message, not after those that wait.
    assert_eq!(runtime.pump_until(Limit::IDLE, |runtime| runtime.deliveries() >= 1000), Exit::Until);
    let before = runtime.inspect(sum, |sum| sum.count);
    port.send(Number(u64::MAX)).expect("room");
    runtime.pump(Limit::IDLE);
    assert_eq!(runtime.inspect(sum, |sum| sum.control_after), Some(before));
}

#[test]
fn a_paused_actor_keeps_its_mailbox_in_order() {
    for threads in [0, 2] {
        let (mut runtime, (sum, port)) = Runtime::build(Config::live(threads), |wiring| {
            let sum = wiring.declare::<PinnedSum>(Bounds::messages(100));
            let port = wiring.port::<Number, Number>("numbers", &sum.address());
            (wiring.spawn(sum, PinnedSum::default(), OnPanic::Resume), port)
        })
        .expect("builds");
        let count = |runtime: &Runtime| runtime.inspect(sum, |sum| sum.0.count);
        for round in 0..50 {
            runtime.control(sum, Control::Pause);
            runtime.pump(Limit::idle_within(WAIT));
            port.send(Number(1)).expect("room");
            port.send(Number(2)).expect("room");
            assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
            assert_eq!(count(&runtime), Some(2 * round), "paused");
            runtime.control(sum, Control::Resume);
            assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
            assert_eq!(count(&runtime), Some(2 * round + 2));
        }
        runtime.control(sum, Control::Pause);
        runtime.control(sum, Control::Stop);
        port.send(Number(1)).expect("accepted before the stop is seen");
        runtime.pump(Limit::idle_within(WAIT));
        assert_eq!(port.send(Number(3)).expect_err("stopped").reason, Reason::Stopped);
        assert_eq!(runtime.counters()[0].dead_letters, 1);
    }
}

#[test]
fn a_resume_that_is_taken_back_leaves_nothing_behind() {
    for threads in [0, 2] {
        let (mut runtime, (sum, port)) = Runtime::build(Config::live(threads), |wiring| {
            let sum = wiring.declare::<PinnedSum>(Bounds::messages(100));
            let port = wiring.port::<Number, Number>("numbers", &sum.address());
            (wiring.spawn(sum, PinnedSum::default(), OnPanic::Resume), port)
        })
        .expect("builds");
        for round in 1..=20 {
            runtime.control(sum, Control::Pause);
            assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
            port.send(Number(1)).expect("room");
            for order in [Control::Resume, Control::Pause, Control::Resume, Control::Pause] {
                runtime.control(sum, order);
            }
            runtime.pump(Limit::time(Duration::from_millis(1)));
            assert_eq!(
                runtime.inspect(sum, |sum| sum.0.count),
                Some(round - 1),
                "the last order was to pause"
            );
            for order in [Control::Pause, Control::Resume] {
                runtime.control(sum, order);
            }
            assert_eq!(runtime.pump(Limit::idle_within(Duration::from_secs(5))), Exit::Idle, "round {round}");
            assert_eq!(runtime.inspect(sum, |sum| sum.0.count), Some(round));
        }
        assert!(runtime.shutdown(WAIT).drained);
    }
}

#[test]
fn jobs_survive_the_workers_they_kill() {
    for threads in [0, 1, 2, 4] {
        // Every 16th task kills each worker once: with one worker it comes back to it, with three it is given up.
        let options = Options { deadly: Some((5, 3)), ..Options::new(3) };
        let (mut runtime, shop) =
            Runtime::build(Config::live(threads), |wiring| workshop::wire(wiring, options)).expect("builds");
        for _ in 0..8 {
            shop.orders.send(Order { tasks: 32 }).expect("room");
        }
        assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle, "{threads} threads");
        let stats = shop.pool.stats();
        assert_eq!((stats.pushed, stats.waiting), (256, 0), "{stats:?}");
        assert_eq!(stats.completed + stats.dead, 256, "{stats:?}");
        assert!(stats.requeued + stats.dead >= 16, "{stats:?}");
        let shutdown = runtime.shutdown(WAIT);
        assert!(shutdown.drained && shutdown.jobs_left == 0, "{shutdown:?}");
    }
}

#[test]
fn heavy_turns_leave_as_many_processors_as_they_are_told() {
    /// Turns at once now, and at most so far.
    #[derive(Default)]
    struct AtOnce([AtomicUsize; 2]);
    struct Busy(Arc<AtOnce>);
    impl Actor for Busy {
        type Msg = Number;
        const NAME: &'static str = "busy";
        const CLASS: Class = Class::Heavy;
        fn handle(&mut self, _: Number, _: &mut Cx<'_, Number>) {
            let AtOnce([now, most]) = &*self.0;
            most.fetch_max(now.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
            // Until another one is there, where there may be one: for long the first time.
            let until = Instant::now() + Duration::from_millis(20);
            while most.load(Ordering::SeqCst) < 2 && Instant::now() < until {
                std::thread::yield_now();
            }
            now.fetch_sub(1, Ordering::SeqCst);
        }
    }
    let at_once = Arc::new(AtOnce::default());
    let (mut runtime, inputs) = Runtime::build(Config::live(4), |wiring| {
        let busy: Vec<_> = (0..3)
            .map(|_| {
                let seat = wiring.declare::<Busy>(Bounds::messages(100));
                let input = wiring.port::<Number, Number>("input", &seat.address());
                wiring.spawn(seat, Busy(at_once.clone()), OnPanic::Resume);
                input
            })
            .collect();
        busy
    })
    .expect("builds");
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let mut most_while = |left| {
        at_once.0[1].store(0, Ordering::SeqCst);
        runtime.leave_cores(left);
        for number in 0..4 {
            inputs.iter().for_each(|input| input.send(Number(number)).expect("room"));
        }
        assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
        at_once.0[1].load(Ordering::SeqCst)
    };
    assert_eq!(most_while(usize::MAX), 1, "one may always run");
    assert_eq!(most_while(cores - 1), 1);
    if cores > 1 {
        assert!(most_while(0) > 1, "all of them");
        assert_eq!(most_while(cores - 1), 1, "and again");
    }
}

#[test]
fn a_crash_loop_ends_with_fewer_workers() {
    // All tasks kill; each is given up after three, and panics come so close that workers are taken out.
    struct Doomed;
    impl Actor for Doomed {
        type Msg = Number;
        const NAME: &'static str = "doomed";
        const CLASS: Class = Class::Heavy;
        fn handle(&mut self, _: Number, _: &mut Cx<'_, Number>) {}
    }
    impl Worker for Doomed {
        type Job = workshop::Task;
        fn run(&mut self, _: &workshop::Task, _: &mut Cx<'_, Number>) {
            std::panic::resume_unwind(Box::new("always"));
        }
    }
    struct Chief {
        pool: JobPool<workshop::Task>,
        incidents: Vec<Incident>,
        dead: Vec<DeadJob<u64>>,
    }
    #[derive(Debug)]
    enum Told {
        Incident(Incident),
        Dead(DeadJob<u64>),
    }
    impl Message for Told {
        fn digest(&self, digest: &mut Digest) {
            digest.bytes(format!("{self:?}").as_bytes());
        }
        fn kind(&self) -> &'static str {
            "Told"
        }
    }
    impl Actor for Chief {
        type Msg = Told;
        const NAME: &'static str = "chief";
        const CLASS: Class = Class::Pinned;
        fn started(&mut self, cx: &mut Cx<'_, Told>) {
            for number in 0..40 {
                cx.push(&self.pool, 3, 0, workshop::Task { number, kills: 9 }).expect("room");
            }
        }
        fn handle(&mut self, told: Told, _: &mut Cx<'_, Told>) {
            match told {
                Told::Incident(incident) => self.incidents.push(incident),
                Told::Dead(dead) => self.dead.push(dead),
            }
        }
    }
    for threads in [0, 2] {
        let (mut runtime, (chief, pool)) = Runtime::build(Config::live(threads), |wiring| {
            let chief = wiring.declare::<Chief>(Bounds::messages(1000));
            let pool = wiring.pool::<workshop::Task>(100);
            wiring.supervisor(&chief.address(), Told::Incident);
            wiring.gives_up(&pool, &chief.address(), Told::Dead);
            for _ in 0..3 {
                let doomed = wiring.declare::<Doomed>(Bounds::messages(1));
                wiring.spawn_worker(doomed, Doomed, &pool, OnPanic::Resume);
            }
            let state = Chief { pool: pool.clone(), incidents: Vec::new(), dead: Vec::new() };
            (wiring.spawn(chief, state, OnPanic::Resume), pool)
        })
        .expect("builds");
        assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
        let stats = pool.stats();
        assert_eq!((stats.dead, stats.completed, stats.workers), (40, 0, 1), "{stats:?}");
        let incidents = runtime.inspect(chief, |chief| chief.incidents.clone()).expect("pinned");
        let of = |name: &str| {
            incidents.iter().filter(|incident| format!("{incident:?}").starts_with(name)).count()
        };
        assert_eq!((of("Panicked"), of("CircuitOpen")), (120, 2));
        let dead = runtime.inspect(chief, |chief| chief.dead.clone()).expect("pinned");
        let mut briefs: Vec<u64> = dead.iter().map(|dead| dead.brief).collect();
        briefs.sort_unstable();
        assert!(briefs.into_iter().eq(0..40));
        assert!(dead.iter().all(|dead| dead.why == Death::Panicked("always".to_owned())));
    }
}

#[test]
fn timers_come_in_order_and_virtual_time_jumps() {
    struct Clocked(Vec<(u64, Time)>);
    impl Actor for Clocked {
        type Msg = Number;
        const NAME: &'static str = "clocked";
        const CLASS: Class = Class::Pinned;
        fn started(&mut self, cx: &mut Cx<'_, Number>) {
            for millis in [30, 10, 20] {
                cx.after(Duration::from_millis(millis), Number(millis)).expect("few timers");
            }
            let timer = cx.after(Duration::from_millis(5), Number(5)).expect("few timers");
            assert_eq!(cx.cancel(timer).map(|number| number.0), Some(5));
        }
        fn handle(&mut self, number: Number, cx: &mut Cx<'_, Number>) {
            let now = cx.now();
            self.0.push((number.0, now));
        }
    }
    let configs = [Config::live(0), Config::live(2), Config::simulate(simulate::Simulation::new(1))];
    for config in configs {
        let start = Instant::now();
        let simulated = matches!(config.mode, Mode::Simulate(_));
        let (mut runtime, clocked) = Runtime::build(config, |wiring| {
            let clocked = wiring.declare::<Clocked>(Bounds::messages(1));
            wiring.spawn(clocked, Clocked(Vec::new()), OnPanic::Resume)
        })
        .expect("builds");
        assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
        let fired = runtime.inspect(clocked, |clocked| clocked.0.clone()).expect("pinned");
        assert_eq!(fired.iter().map(|(number, _)| *number).collect::<Vec<_>>(), [10, 20, 30]);
        assert!(fired.iter().all(|(number, time)| time.0 >= number * 1_000_000), "{fired:?}");
        if simulated {
            assert!(runtime.now().0 < 31_000_000 && start.elapsed() < Duration::from_secs(5));
        }
    }
}

#[test]
fn the_event_loop_is_called_for_pinned_work() {
    let calls = Arc::new(AtomicU64::new(0));
    let counted = Arc::clone(&calls);
    let waker: Box<dyn Fn() + Send + Sync> = Box::new(move || {
        counted.fetch_add(1, Ordering::SeqCst);
    });
    let (mut runtime, (sum, port)) =
        Runtime::build(Config { waker: Some(waker), ..Config::live(1) }, |wiring| {
            let sum = wiring.declare::<PinnedSum>(Bounds::messages(100));
            let port = wiring.port::<Number, Number>("numbers", &sum.address());
            (wiring.spawn(sum, PinnedSum::default(), OnPanic::Resume), port)
        })
        .expect("builds");
    runtime.pump(Limit::idle_within(WAIT));
    for round in 1..=3 {
        let before = calls.load(Ordering::SeqCst);
        port.send(Number(1)).expect("room");
        assert_eq!(calls.load(Ordering::SeqCst), before + 1, "called once");
        port.send(Number(1)).expect("room");
        assert_eq!(calls.load(Ordering::SeqCst), before + 1, "and not again until it came");
        assert_eq!(runtime.pump(Limit::time(Duration::from_millis(1))), Exit::Time);
        assert_eq!(runtime.inspect(sum, |sum| sum.0.count), Some(2 * round));
    }
}

#[test]
fn shutdown_handles_all_that_was_accepted() {
    for threads in [0, 1, 2] {
        let (runtime, (_, port)) = Runtime::build(Config::live(threads), |wiring| {
            let sum = wiring.declare::<Sum>(Bounds::messages(50_000));
            let port = wiring.port::<Number, Number>("numbers", &sum.address());
            (wiring.spawn(sum, Sum::default(), OnPanic::Resume), port)
        })
        .expect("builds");
        for number in 0..50_000 {
            port.send(Number(number)).expect("room");
        }
        let shutdown = runtime.shutdown(WAIT);
        assert!(shutdown.drained && shutdown.dead_letters == 0, "{shutdown:?}");
        assert_eq!(shutdown.counters[0].delivered, 50_001, "and the order to stop");
        assert_eq!(port.send(Number(1)).expect_err("over").reason, Reason::Stopped);
    }
}

#[test]
fn a_system_is_left_while_a_turn_goes_on() {
    struct Endless(Arc<[AtomicU64; 2]>);
    impl Actor for Endless {
        type Msg = Number;
        const NAME: &'static str = "endless";
        fn handle(&mut self, _: Number, _: &mut Cx<'_, Number>) {
            let [began, may_end] = &*self.0;
            began.store(1, Ordering::SeqCst);
            while may_end.load(Ordering::SeqCst) == 0 {
                std::thread::yield_now();
            }
        }
    }
    impl Drop for Endless {
        fn drop(&mut self) {
            self.0[0].store(2, Ordering::SeqCst);
        }
    }
    for recorded in [false, true] {
        let state = Arc::new([AtomicU64::new(0), AtomicU64::new(0)]);
        let config = Config { gives_way: true, ..Config::live(2) };
        let record = recorded.then(|| Record::Sink(Box::new(std::io::sink())));
        let (mut runtime, port) = Runtime::build(Config { record, ..config }, |wiring| {
            let endless = wiring.declare::<Endless>(Bounds::messages(10));
            let port = wiring.port::<Number, Number>("numbers", &endless.address());
            wiring.spawn(endless, Endless(Arc::clone(&state)), OnPanic::Resume);
            port
        })
        .expect("builds");
        port.send(Number(1)).expect("room");
        while state[0].load(Ordering::SeqCst) == 0 {
            runtime.pump(Limit::time(Duration::from_millis(1)));
        }
        let ending = runtime.leave(Duration::ZERO);
        // Had it waited for the turn, nobody would ever let that end.
        assert!(!ending.is_over());
        assert_eq!(port.send(Number(2)).expect_err("over").reason, Reason::Stopped);
        state[1].store(1, Ordering::SeqCst);
        drop((ending, port));
        assert_eq!(state[0].load(Ordering::SeqCst), 2, "nothing is left of it");
    }
}

#[test]
fn a_panicking_actor_is_replaced_and_its_mailbox_kept() {
    struct Fragile(Vec<u64>);
    impl Actor for Fragile {
        type Msg = Number;
        const NAME: &'static str = "fragile";
        fn handle(&mut self, number: Number, _: &mut Cx<'_, Number>) {
            if number.0 == 3 {
                std::panic::resume_unwind(Box::new("three"));
            }
            self.0.push(number.0);
        }
    }
    let (mut runtime, (fragile, port)) = Runtime::build(Config::live(0), |wiring| {
        let fragile = wiring.declare::<Fragile>(Bounds::messages(10));
        let port = wiring.port::<Number, Number>("numbers", &fragile.address());
        let again = OnPanic::Restart(Box::new(|| Fragile(vec![100])));
        (wiring.spawn(fragile, Fragile(Vec::new()), again), port)
    })
    .expect("builds");
    for number in 1..=5 {
        port.send(Number(number)).expect("room");
    }
    runtime.pump(Limit::IDLE);
    assert_eq!(runtime.inspect(fragile, |fragile| fragile.0.clone()), Some(vec![100, 4, 5]));
    let counters = &runtime.counters()[0];
    assert_eq!((counters.panics, counters.dead_letters), (1, 1));
}
