//! What is recorded replays, on any number of threads; what differs is named.

use foveal_runtime::*;
use std::io::Write;
use std::sync::Arc;

use crate::common::*;
use crate::ring;
use crate::workshop::{self, Options};

#[test]
fn a_ring_replays_on_any_number_of_threads() {
    for threads in [0, 1, 2, 3] {
        for hashing in [Hashing::Said, Hashing::Exact, Hashing::Every(64), Hashing::Off] {
            let trace = read(&record_ring(threads, 7, 500, hashing));
            assert!(trace.complete(), "{:?}", trace.damage());
            for replay_threads in [0, 1, 2, 3] {
                assert_complete(&replay_ring(&trace, replay_threads, 500));
            }
        }
    }
}

#[test]
fn a_workshop_with_panics_timers_and_input_replays() {
    for threads in [0, 1, 2, 3] {
        let options = Options { deadly: Some((5, 3)), ..Options::new(3) };
        let trace = read(&record_workshop(threads, 40, options));
        assert!(trace.complete(), "{:?}", trace.damage());
        let office = trace.find("office").expect("the office");
        let marks = trace.events(office).filter(|event| matches!(event, Event::Mark { .. })).count();
        assert!(marks > 0);
        for replay_threads in [0, 1, 2, 3] {
            assert_complete(&replay_workshop(&trace, replay_threads, options));
        }
    }
}

#[test]
fn full_mailboxes_replay() {
    // Two floods into a small mailbox: how often each is turned away depends on the threads.
    struct Many {
        to: Address<ring::Msg>,
        sent: u32,
        refused: u64,
    }
    impl Actor for Many {
        type Msg = ring::Msg;
        const NAME: &'static str = "many";
        fn started(&mut self, cx: &mut Cx<'_, ring::Msg>) {
            self.go(cx);
        }
        fn handle(&mut self, _: ring::Msg, cx: &mut Cx<'_, ring::Msg>) {
            self.go(cx);
        }
    }
    impl Many {
        fn go(&mut self, cx: &mut Cx<'_, ring::Msg>) {
            while self.sent < 5000 {
                let token = ring::Token { hops: self.sent, value: self.refused };
                if cx.tell(&self.to, ring::Msg::Token(token)).is_err() {
                    self.refused += 1;
                    let me = cx.address().clone();
                    let token = ring::Token { hops: 0, value: 0 };
                    cx.tell(&me, ring::Msg::Token(token)).expect("one at a time");
                    return;
                }
                self.sent += 1;
            }
        }
    }
    struct Eats(u64);
    impl Actor for Eats {
        type Msg = ring::Msg;
        const NAME: &'static str = "eats";
        fn handle(&mut self, _: ring::Msg, cx: &mut Cx<'_, ring::Msg>) {
            self.0 += 1;
            cx.mark(1, self.0);
        }
    }
    let wire = |wiring: &mut Wiring| {
        let eats = wiring.declare::<Eats>(Bounds::messages(16));
        for _ in 0..2 {
            let many = wiring.declare::<Many>(Bounds::messages(1));
            wiring.spawn(many, Many { to: eats.address(), sent: 0, refused: 0 }, OnPanic::Resume);
        }
        wiring.spawn(eats, Eats(0), OnPanic::Resume);
    };
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("full.fvlog");
    let (mut runtime, ()) = Runtime::build(Config::live(2).record(&path), wire).expect("builds");
    assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
    assert!(runtime.counters()[0].rejected > 0, "a mailbox of 16 was full at least once");
    runtime.shutdown(WAIT);
    let trace = Arc::new(Trace::open(&path).expect("reads"));
    for threads in [0, 2] {
        let (mut runtime, ()) = Runtime::build(Config::replay(trace.clone(), threads), wire).expect("builds");
        assert_complete(&runtime.replay());
    }
}

#[test]
fn a_refused_message_replays_with_its_reason() {
    #[derive(Message)]
    enum Told {
        Again,
        #[message(size = *_0)]
        Bytes(usize),
    }
    /// Stops at once.
    struct Gone;
    impl Actor for Gone {
        type Msg = Told;
        const NAME: &'static str = "gone";
        fn started(&mut self, cx: &mut Cx<'_, Told>) {
            cx.stop();
        }
        fn handle(&mut self, _: Told, _: &mut Cx<'_, Told>) {}
    }
    struct Silent;
    impl Actor for Silent {
        type Msg = Told;
        const NAME: &'static str = "silent";
        fn handle(&mut self, _: Told, _: &mut Cx<'_, Told>) {}
    }
    /// Does other things for each reason: the sum of all it was told.
    struct Asks {
        gone: Address<Told>,
        silent: Address<Told>,
        reasons: Vec<Reason>,
    }
    impl Actor for Asks {
        type Msg = Told;
        const NAME: &'static str = "asks";
        fn started(&mut self, cx: &mut Cx<'_, Told>) {
            let me = cx.address().clone();
            cx.tell(&me, Told::Again).expect("room");
        }
        fn handle(&mut self, _: Told, cx: &mut Cx<'_, Told>) {
            for (to, size) in [(self.silent.clone(), 100), (self.silent.clone(), 1), (self.gone.clone(), 0)] {
                if let Err(back) = cx.tell(&to, Told::Bytes(size)) {
                    self.reasons.push(back.reason);
                    cx.mark(back.reason as u32, 0);
                }
            }
            if self.reasons.last() != Some(&Reason::Stopped) {
                let me = cx.address().clone();
                cx.tell(&me, Told::Again).expect("room");
            }
        }
    }
    let wire = |wiring: &mut Wiring| {
        let silent = wiring.declare::<Silent>(Bounds::messages(1).bytes(50));
        let asks = wiring.declare::<Asks>(Bounds::messages(1));
        let gone = wiring.declare::<Gone>(Bounds::messages(1));
        let (to_silent, to_gone) = (silent.address(), gone.address());
        wiring.spawn(silent, Silent, OnPanic::End);
        wiring.spawn(gone, Gone, OnPanic::End);
        wiring.spawn(asks, Asks { gone: to_gone, silent: to_silent, reasons: Vec::new() }, OnPanic::End)
    };
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("refused.fvlog");
    let (mut runtime, asks) = Runtime::build(Config::live(0).record(&path), wire).expect("builds");
    assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
    let live = runtime.inspect(asks, |asks| asks.reasons.clone()).expect("not in a turn");
    assert!(live.contains(&Reason::FullBytes) && live.contains(&Reason::Stopped), "{live:?}");
    runtime.shutdown(WAIT);
    let trace = Arc::new(Trace::open(&path).expect("reads"));
    for threads in [0, 2] {
        let (mut runtime, asks) =
            Runtime::build(Config::replay(trace.clone(), threads), wire).expect("builds");
        assert_complete(&runtime.replay());
        if threads == 0 {
            assert_eq!(runtime.inspect(asks, |asks| asks.reasons.clone()), Some(live.clone()));
        }
    }
}

#[test]
fn one_flipped_bit_is_named_at_its_message() {
    let trace = read(&record_ring(2, 7, 200, Hashing::Exact));
    for fault in 0..200_u64 {
        let actor = ActorId((fault % 8) as u32);
        let at = 1 + fault * 7 % (trace.deliveries(actor) - 2);
        let flip = ring::Flip { actor: actor.0, at, bit: (fault % 64) as u32 };
        let config = Config::replay(Arc::clone(&trace), [0, 2][(fault % 2) as usize]);
        let (mut runtime, _) =
            Runtime::build(config, |wiring| ring::wire_flipped(wiring, 8, 64, 200, Some(flip)))
                .expect("builds");
        let report = runtime.replay();
        let divergence = report.divergence.expect("one bit matters");
        assert_eq!((divergence.actor, divergence.index), (actor, at), "fault {fault}: {divergence}");
        assert_eq!(divergence.turns[0].index, at);
    }
}

#[test]
fn a_leak_of_randomness_is_found_where_it_is() {
    let options = Options { leak_at: Some(100), ..Options::new(2) };
    let trace = read(&record_workshop(2, 20, options));
    let office = trace.find("office").expect("the office");
    // The hundredth finished task.
    let done = trace
        .events(office)
        .filter_map(|event| if let Event::Mark { index, .. } = event { Some(index - 1) } else { None })
        .nth(99)
        .expect("a hundred tasks");
    for threads in [0, 2] {
        let report = replay_workshop(&trace, threads, options);
        let divergence = report.divergence.expect("it leaks");
        assert_eq!(
            (divergence.actor, divergence.index, divergence.kind),
            (office, done, "Done"),
            "{divergence}"
        );
    }
}

#[test]
fn a_message_that_is_not_sent_is_reported_as_a_stall() {
    let trace = read(&record_ring(2, 7, 50, Hashing::Off));
    let report = replay_ring(&trace, 2, 49);
    let divergence = report.divergence.expect("every token makes one hop less");
    assert!(divergence.found.contains("idle"), "{divergence}");
    assert!(!report.complete);
}

#[test]
fn another_system_is_refused() {
    let trace = read(&record_ring(0, 7, 5, Hashing::Exact));
    let error = Runtime::build(Config::replay(trace, 0), |wiring| ring::wire(wiring, 7, 64, 5)).err();
    let Some(BuildError::OtherSystem { actor, recorded, found }) = error else { panic!("{error:?}") };
    assert_eq!((actor, recorded.as_str(), found.as_str()), (ActorId(7), "player-8", "starter"));
}

#[test]
fn replay_stops_where_it_is_told_and_goes_on() {
    let options = Options::new(2);
    let trace = read(&record_workshop(2, 10, options));
    let office = trace.find("office").expect("the office");
    let until = Some(Until::Mark { kind: 0, count: 50 });
    let config = Config { mode: Mode::Replay { trace: trace.clone(), until }, ..Config::live(0) };
    let (mut runtime, shop) =
        Runtime::build(config, |wiring| workshop::wire(wiring, options)).expect("builds");
    let report = runtime.replay();
    assert!(report.divergence.is_none() && !report.complete);
    assert_eq!(runtime.inspect(shop.office, |office| office.done), Some(50));
    let index = runtime.positions()[office.0 as usize].0 + 20;
    runtime.resume(Some(Until::Delivery { actor: office, index }));
    runtime.replay();
    assert_eq!(runtime.positions()[office.0 as usize].0, index + 1);
    runtime.resume(None);
    let before = runtime.deliveries();
    assert!(runtime.step(None).is_some() && runtime.deliveries() == before + 1);
    assert_complete(&runtime.replay());
    assert_eq!(runtime.step(None), None);
}

#[test]
fn an_observer_sees_every_delivery() {
    let trace = read(&record_workshop(1, 5, Options::new(1)));
    let seen = Arc::new(crossbeam_queue::SegQueue::new());
    let sink = Arc::clone(&seen);
    let observer: Observer = Arc::new(move |delivery: &Delivery<'_>| {
        let task = delivery.content.downcast_ref::<workshop::Task>().map(|task| task.number);
        sink.push((delivery.actor, delivery.index, delivery.kind, task));
    });
    let config = Config { observer: Some(observer), ..Config::replay(trace, 0) };
    let (mut runtime, _) =
        Runtime::build(config, |wiring| workshop::wire(wiring, Options::new(1))).expect("builds");
    let report = runtime.replay();
    assert_complete(&report);
    assert_eq!(seen.len() as u64, report.deliveries);
    let tasks: Vec<u64> = std::iter::from_fn(|| seen.pop()).filter_map(|(.., task)| task).collect();
    assert_eq!(tasks.len(), 80);
}

#[test]
fn two_recordings_part_at_a_message() {
    // The time of a turn has a bound, too, which a busy machine reaches at another message each time.
    let untimed = Budget { nanoseconds: u64::MAX, ..Budget::default() };
    let record = |hops, budget| read(&record_ring_in_turns(0, 7, hops, Hashing::Exact, budget));
    let are_same = |left: &Trace, right: &Trace| {
        (0..9).all(|actor| left.first_difference(right, ActorId(actor)).is_none())
    };
    // The thread that writes the log wakes actors that have something for it, ten times a second: one in a dozen recordings
    // has another order for that, and it may be either of a pair.
    let alike =
        || Some([record(50, untimed), record(50, untimed)]).filter(|[left, right]| are_same(left, right));
    let [left, _] = (0..12).find_map(|_| alike()).expect("one thread, one order");
    let shorter = record(50, Budget { nanoseconds: 0, ..untimed });
    assert!(!are_same(&left, &shorter), "shorter turns, another order");
    let right = record(49, untimed);
    assert_eq!(left.first_difference(&right, ActorId(0)), Some(1), "the first token has fewer hops");
}

#[test]
fn the_log_of_messages_is_small() {
    // The worst topology: 8 senders at random. Order alone, then with sparse hashes.
    let trace = read(&record_ring(2, 7, 2000, Hashing::Off));
    let stat = trace.stat();
    assert!(stat.order_bytes <= stat.deliveries, "{stat:?}");
    let stat = read(&record_ring(2, 7, 2000, Hashing::Every(64))).stat();
    assert!(stat.order_bytes + stat.hash_bytes <= stat.deliveries * 9 / 8 + 64, "{stat:?}");
    assert!(stat.file_bytes <= stat.deliveries + 2000, "{stat:?}");
    // With all hashes, of the worst kind: each message makes its receiver say something.
    let stat = read(&record_ring(2, 7, 2000, Hashing::Said)).stat();
    assert!(stat.hash_bytes <= stat.deliveries * 17 / 8, "{stat:?}");
    // Many senders at random, each message from another one.
    let stat = many_senders();
    assert!(stat.order_bytes <= stat.deliveries, "{stat:?}");
    // Each has to be told once who its 200 senders are.
    assert!(stat.file_bytes <= stat.deliveries * 21 / 20 + 3 * 200 * 200, "{stat:?}");
    // A pipeline: nothing but runs.
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("pair.fvlog");
    let config = Config { hashing: Hashing::Off, ..Config::live(0).record(&path) };
    let (mut runtime, _) = Runtime::build(config, |wiring| ring::wire(wiring, 1, 1, 50_000)).expect("builds");
    runtime.pump(Limit::IDLE);
    runtime.shutdown(WAIT);
    let stat = Trace::open(&path).expect("reads").stat();
    assert!(stat.file_bytes < stat.deliveries / 20, "{stat:?}");
}

/// 200 players, more than have a byte of their own in the order of what they get.
fn many_senders() -> TraceStat {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("many.fvlog");
    let config = Config { hashing: Hashing::Off, ..Config::live(2).record(&path) };
    let (mut runtime, _) =
        Runtime::build(config, |wiring| ring::wire(wiring, 200, 400, 300)).expect("builds");
    assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
    runtime.shutdown(WAIT);
    Trace::open(&path).expect("reads").stat()
}

/// A disk with so much room.
struct Disk {
    room: usize,
    written: Arc<crossbeam_queue::SegQueue<Vec<u8>>>,
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        if self.room == 0 {
            return Err(std::io::Error::other("no space left on device"));
        }
        let length = bytes.len().min(self.room);
        self.room -= length;
        self.written.push(bytes[..length].to_vec());
        Ok(length)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_full_disk_stops_the_recording_and_not_the_run() {
    let whole = record_ring(2, 7, 2000, Hashing::Said).len();
    for room in [1000, whole / 3, whole * 2 / 3] {
        let written = Arc::new(crossbeam_queue::SegQueue::new());
        let disk = Disk { room, written: Arc::clone(&written) };
        let config = Config { record: Some(Record::Sink(Box::new(disk))), seed: 7, ..Config::live(2) };
        let (mut runtime, _) =
            Runtime::build(config, |wiring| ring::wire(wiring, 8, 64, 2000)).expect("builds");
        assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
        let shutdown = runtime.shutdown(WAIT);
        assert!(shutdown.drained);
        let RecordingStatus::Stopped { reason } = shutdown.recording else {
            panic!("{:?}", shutdown.recording)
        };
        assert!(reason.contains("no space"), "{reason}");
        let bytes: Vec<u8> = std::iter::from_fn(|| written.pop()).flatten().collect();
        let trace = read(&bytes);
        assert!(trace.damage().is_some());
        let report = replay_ring(&trace, 2, 2000);
        assert!(report.divergence.is_none(), "{}", report.divergence.expect("some"));
    }
}
