//! Wake-ups and ends that come in time whatever somebody else does.

use foveal_runtime::*;
use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use crate::common::WAIT;
use crate::live::Number;

/// Turns that go on until they are let go.
struct Hung(Arc<AtomicBool>);

impl Actor for Hung {
    type Msg = Number;
    const NAME: &'static str = "hung";
    const CLASS: Class = Class::Heavy;

    fn handle(&mut self, _: Number, _: &mut Cx<'_, Number>) {
        while !self.0.load(Ordering::SeqCst) {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

/// Counts what it is told, on the main thread; its first message comes from a timer.
#[derive(Default)]
struct Count(u64);

impl Actor for Count {
    type Msg = Number;
    const NAME: &'static str = "count";
    const CLASS: Class = Class::Pinned;

    fn started(&mut self, cx: &mut Cx<'_, Number>) {
        cx.after(Duration::from_millis(20), Number(0)).expect("the first timer");
    }

    fn handle(&mut self, _: Number, _: &mut Cx<'_, Number>) {
        self.0 += 1;
    }
}

type Wired = (Port<Number, Number>, Port<Number, Number>, Handle<Count>);

fn wire(wiring: &mut Wiring, go: &Arc<AtomicBool>) -> Wired {
    let hung = wiring.declare::<Hung>(Bounds::messages(10));
    let count = wiring.declare::<Count>(Bounds::messages(10));
    let hang = wiring.port("hang", &hung.address());
    let counted = wiring.port("counted", &count.address());
    wiring.spawn(hung, Hung(Arc::clone(go)), OnPanic::Stop);
    (hang, counted, wiring.spawn(count, Count::default(), OnPanic::Stop))
}

#[test]
fn a_timer_is_not_late_by_a_heavy_turn() {
    let go = Arc::new(AtomicBool::new(false));
    let (mut runtime, (hang, _, count)) =
        Runtime::build(Config::live(1), |wiring| wire(wiring, &go)).expect("builds");
    hang.send(Number(1)).expect("room");
    let fired = |runtime: &Runtime| runtime.inspect(count, |count| count.0) == Some(1);
    assert_eq!(runtime.pump_until(Limit::time(Duration::from_secs(10)), fired), Exit::Until);
    go.store(true, Ordering::SeqCst);
    assert!(runtime.shutdown(WAIT).drained);
}

#[test]
fn a_shutdown_is_over_in_time_while_a_turn_hangs() {
    for recorded in [false, true] {
        let go = Arc::new(AtomicBool::new(false));
        let record = recorded.then(|| Record::Sink(Box::new(std::io::sink())));
        let config = Config { record, ..Config::live(2) };
        let (mut runtime, (hang, _, count)) =
            Runtime::build(config, |wiring| wire(wiring, &go)).expect("builds");
        for _ in 0..4 {
            hang.send(Number(1)).expect("room");
        }
        runtime.pump(Limit::time(Duration::from_millis(50)));
        let began = Instant::now();
        let shutdown = runtime.end(Duration::from_millis(100));
        assert!(began.elapsed() < Duration::from_secs(20), "{:?}", began.elapsed());
        assert!(!shutdown.drained);
        assert_eq!(shutdown.dead_letters, 3, "one is being handled, three wait for ever");
        if recorded {
            assert!(matches!(shutdown.recording, RecordingStatus::Stopped { .. }), "{shutdown:?}");
        }
        assert!(runtime.inspect(count, |count| count.0).is_some(), "whoever stopped can be looked at");
        drop(runtime);
        go.store(true, Ordering::SeqCst);
    }
}

/// A disk that takes a header and then answers no more.
struct DeadDisk {
    header: usize,
    go: Arc<AtomicBool>,
}

impl Write for DeadDisk {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        while self.header == 0 && !self.go.load(Ordering::SeqCst) {
            std::thread::sleep(Duration::from_millis(1));
        }
        self.header = 0;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_shutdown_is_over_in_time_while_the_disk_hangs() {
    let go = Arc::new(AtomicBool::new(false));
    let sink: Box<dyn Write + Send> = Box::new(DeadDisk { header: 1, go: Arc::clone(&go) });
    let config = Config { record: Some(Record::Sink(sink)), ..Config::live(1) };
    let (mut runtime, (_, counted, count)) =
        Runtime::build(config, |wiring| wire(wiring, &go)).expect("builds");
    counted.send(Number(1)).expect("room");
    assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
    let began = Instant::now();
    let shutdown = runtime.end(Duration::from_millis(100));
    assert!(began.elapsed() < Duration::from_secs(20), "{:?}", began.elapsed());
    assert!(matches!(shutdown.recording, RecordingStatus::Stopped { .. }), "{shutdown:?}");
    assert_eq!(runtime.inspect(count, |count| count.0), Some(2));
    go.store(true, Ordering::SeqCst);
}

/// A disk that panics when it is written to for the second time.
struct BurningDisk(bool);

impl Write for BurningDisk {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        if std::mem::replace(&mut self.0, true) {
            std::panic::resume_unwind(Box::new("fire"));
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_recorder_that_panics_is_told() {
    let go = Arc::new(AtomicBool::new(true));
    let config = Config { record: Some(Record::Sink(Box::new(BurningDisk(false)))), ..Config::live(1) };
    let (mut runtime, (_, counted, _)) = Runtime::build(config, |wiring| wire(wiring, &go)).expect("builds");
    counted.send(Number(1)).expect("room");
    assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
    let shutdown = runtime.shutdown(WAIT);
    assert!(shutdown.drained && shutdown.dead_letters == 0, "{shutdown:?}");
    assert!(matches!(shutdown.recording, RecordingStatus::Stopped { .. }), "{shutdown:?}");
}

#[test]
fn positions_come_while_work_waits_for_the_main_thread() {
    let go = Arc::new(AtomicBool::new(true));
    let (mut runtime, (_, counted, count)) =
        Runtime::build(Config::live(2), |wiring| wire(wiring, &go)).expect("builds");
    assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
    counted.send(Number(1)).expect("room");
    let began = Instant::now();
    let positions = runtime.positions();
    assert_eq!(positions[count.id().0 as usize].0, 1, "the timer's message, not the one that waits");
    assert!(began.elapsed() < Duration::from_secs(5));
}

/// What the recorder has written so far.
#[derive(Clone, Default)]
struct Written(Arc<crossbeam_queue::SegQueue<Vec<u8>>>);

impl Write for Written {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.push(bytes.to_vec());
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_parked_actor_hands_its_log_over() {
    let (go, told) = (Arc::new(AtomicBool::new(true)), AtomicU64::new(0));
    let written = Written::default();
    let record = Some(Record::Sink(Box::new(written.clone())));
    let (mut runtime, (_, counted, count)) =
        Runtime::build(Config { record, ..Config::live(1) }, |wiring| wire(wiring, &go)).expect("builds");
    assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
    runtime.control(count, Control::Pause);
    counted.send(Number(1)).expect("room, and nobody takes it");
    // The timer's message and the order to pause.
    let (mut bytes, began) = (Vec::new(), Instant::now());
    while told.load(Ordering::SeqCst) < 2 {
        assert!(began.elapsed() < Duration::from_secs(10), "the recorder never gets it");
        runtime.pump(Limit::time(Duration::from_millis(20)));
        bytes.extend(std::iter::from_fn(|| written.0.pop()).flatten());
        let deliveries = Trace::from_bytes(&bytes).map_or(0, |trace| trace.deliveries(count.id()));
        told.store(deliveries, Ordering::SeqCst);
    }
    runtime.control(count, Control::Resume);
    assert!(runtime.shutdown(WAIT).drained);
}

#[test]
fn what_waits_for_a_paused_actor_is_handled_at_the_end() {
    let go = Arc::new(AtomicBool::new(true));
    let (mut runtime, (_, counted, count)) =
        Runtime::build(Config::live(1), |wiring| wire(wiring, &go)).expect("builds");
    assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
    runtime.control(count, Control::Pause);
    assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
    counted.send(Number(1)).expect("room, and nobody takes it");
    let began = Instant::now();
    let end = runtime.shutdown(WAIT);
    assert!(end.drained && end.dead_letters == 0 && began.elapsed() < WAIT, "{end:?}");
}
