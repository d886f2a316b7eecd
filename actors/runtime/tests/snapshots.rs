//! A replay can begin at any snapshot, on any number of threads, and be stepped through in both directions.

use foveal_runtime::*;
use std::sync::Arc;

use crate::common::*;
use crate::ring;
use crate::workshop::{self, Options, Workshop};

fn system(
    trace: &Arc<Trace>,
    threads: usize,
    options: Options,
    from: Option<&Snapshot>,
) -> (Runtime, Workshop) {
    let from = from.map(|snapshot| Arc::new(snapshot.clone()));
    let config = Config { from, ..Config::replay(Arc::clone(trace), threads) };
    Runtime::build(config, |wiring| workshop::wire(wiring, options)).expect("builds")
}

fn made(runtime: &Runtime) -> Vec<u64> {
    runtime.positions().into_iter().map(|(deliveries, _)| deliveries).collect()
}

#[test]
fn a_replay_begins_at_any_snapshot() {
    let options = Options { deadly: Some((5, 3)), ..Options::new(3) };
    let trace = read(&record_workshop(2, 30, options));
    let (mut runtime, _) = system(&trace, 0, options, None);
    let whole = runtime.replay();
    assert_complete(&whole);
    let (office, fingerprint) = (trace.find("office").expect("the office"), runtime.fingerprint());
    for threads in [0, 1, 2] {
        let at = |part: u64| trace.deliveries(office) * part / 8;
        let until = |part| Some(Until::Delivery { actor: office, index: at(part) });
        let mode = Mode::Replay { trace: Arc::clone(&trace), until: until(1) };
        let config = Config { mode, ..Config::live(threads) };
        let (mut runtime, _) =
            Runtime::build(config, |wiring| workshop::wire(wiring, options)).expect("builds");
        for part in 1..8 {
            let index = at(part);
            if part > 1 {
                runtime.resume(until(part));
            }
            runtime.pump(Limit::IDLE);
            let snapshot = runtime.snapshot().expect("a snapshot");
            assert_eq!(snapshot.positions(), made(&runtime));
            assert_eq!(snapshot.positions()[office.0 as usize], index + 1);
            for other_threads in [0, 2] {
                let (mut again, shop) = system(&trace, other_threads, options, Some(&snapshot));
                let report = again.replay();
                assert_complete(&report);
                assert_eq!(again.fingerprint(), fingerprint);
                assert_eq!(report.deliveries, whole.deliveries);
                let end = again.inspect(shop.office, |office| (office.done, office.state));
                assert!(end.is_none_or(|(done, _)| done + 30 * 16 / 16 >= 30 * 15), "{end:?}");
            }
        }
        // Taking snapshots changed nothing.
        runtime.resume(None);
        assert_complete(&runtime.replay());
        assert_eq!(runtime.fingerprint(), fingerprint);
    }
}

/// What is looked at while other threads work takes no state from under them, and does not let a replay run past where it is
/// to stop.
#[test]
fn a_look_between_turns_of_others_disturbs_nothing() {
    let options = Options::new(3);
    let trace = read(&record_workshop(2, 60, options));
    let office = trace.find("office").expect("the office");
    let nodes = trace.header().nodes.len() as u32;
    let end = trace.deliveries(office);
    for round in 0..40 {
        let index = end * (round % 8 + 1) / 9;
        let mode =
            Mode::Replay { trace: Arc::clone(&trace), until: Some(Until::Delivery { actor: office, index }) };
        let config = Config { mode, ..Config::live(3) };
        let (mut runtime, _) =
            Runtime::build(config, |wiring| workshop::wire(wiring, options)).expect("builds");
        while !matches!(runtime.pump_until(Limit::IDLE, |_| true), Exit::Halted | Exit::Idle) {
            for actor in (0..nodes).map(ActorId) {
                runtime.content(actor);
            }
            runtime.held(|runtime| runtime.snapshot());
        }
        assert!(runtime.incidents().is_empty() && !runtime.diverged(), "round {round}");
        assert_eq!(made(&runtime)[office.0 as usize], index + 1, "round {round}");
    }
}

#[test]
fn a_snapshot_of_something_else_is_refused() {
    let options = Options::new(2);
    let trace = read(&record_workshop(1, 5, options));
    let (mut runtime, _) = system(&trace, 0, options, None);
    runtime.step(None).expect("a step");
    let snapshot = Arc::new(runtime.snapshot().expect("a snapshot"));
    let ring = read(&record_ring(0, 7, 5, Hashing::Exact));
    let config = Config { from: Some(snapshot), ..Config::replay(ring, 0) };
    let refused = Runtime::build(config, |wiring| ring::wire(wiring, 8, 64, 5)).err();
    assert!(matches!(refused, Some(BuildError::OtherSnapshot)), "{refused:?}");
}

#[test]
fn steps_go_through_a_recording_in_one_order_wherever_they_begin() {
    let options = Options { deadly: Some((5, 2)), ..Options::new(2) };
    let trace = read(&record_workshop(2, 6, options));
    let (mut runtime, _) = system(&trace, 0, options, None);
    let (mut steps, mut cuts, mut snapshots) = (Vec::new(), vec![made(&runtime)], Vec::new());
    while let Some(actor) = runtime.step(None) {
        steps.push(actor);
        cuts.push(made(&runtime));
        if steps.len() % 50 == 0 {
            snapshots.push((steps.len(), runtime.snapshot().expect("a snapshot")));
        }
    }
    let recorded: u64 = (0..4).map(|actor| trace.deliveries(ActorId(actor))).sum();
    assert_eq!(steps.len() as u64, recorded);
    assert!(snapshots.len() > 3);
    for (at, snapshot) in &snapshots {
        let (mut again, _) = system(&trace, 0, options, Some(snapshot));
        for actor in &steps[*at..(*at + 60).min(steps.len())] {
            assert_eq!(again.step(None), Some(*actor));
        }
        // Back: to a cut that lies behind, from the snapshot before it.
        let (mut again, _) = system(&trace, 0, options, Some(snapshot));
        let end = (at + 37).min(steps.len());
        assert!(snapshot.is_before(&cuts[end]));
        assert!(again.run_to(&cuts[end]));
        assert!(!again.run_to(&cuts[at - 1]), "a replay does not go back by itself");
    }
    // An effect before its cause is no place to stand.
    let office = trace.find("office").expect("the office").0 as usize;
    let mut torn = vec![0; cuts[0].len()];
    torn[office] = trace.deliveries(ActorId(office as u32));
    let (mut again, _) = system(&trace, 0, options, None);
    assert!(!again.run_to(&torn));
}

#[test]
fn in_replay_every_delivery_knows_what_it_comes_of() {
    let options = Options::new(2);
    let trace = read(&record_workshop(2, 4, options));
    let seen = Arc::new(crossbeam_queue::SegQueue::new());
    let sink = Arc::clone(&seen);
    let observer: Observer = Arc::new(move |delivery: &Delivery<'_>| {
        sink.push((delivery.actor, delivery.index, delivery.kind, delivery.cause));
    });
    let config = Config { observer: Some(observer), ..Config::replay(Arc::clone(&trace), 2) };
    let (mut runtime, _) = Runtime::build(config, |wiring| workshop::wire(wiring, options)).expect("builds");
    assert_complete(&runtime.replay());
    let all: Vec<_> = std::iter::from_fn(|| seen.pop()).collect();
    let kind_of = |of: (ActorId, u64)| all.iter().find(|seen| (seen.0, seen.1) == of).map(|seen| seen.2);
    let causes = |kind: &'static str| all.iter().filter(move |seen| seen.2 == kind).map(|seen| seen.3);
    assert!(causes("Order").all(|cause| cause.is_none()));
    assert!(causes("job").all(|cause| cause.and_then(kind_of) == Some("Order")));
    assert!(causes("Done").all(|cause| cause.and_then(kind_of) == Some("job")));
    assert!(causes("Plan").chain(causes("Remind")).all(|cause| cause.and_then(kind_of) == Some("Order")));
    assert_eq!(causes("Done").count(), 64);
}
