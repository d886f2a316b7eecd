//! Systems as a user builds them: live, recorded, replayed, simulated.

mod ring;

use foveal_runtime::*;
use std::time::Duration;

const WAIT: Duration = Duration::from_secs(60);

#[test]
fn ping_pong_runs_on_any_number_of_threads() {
    for threads in [0, 1, 2, 3, 8] {
        let (mut runtime, balls) =
            Runtime::build(Config::live(threads), |wiring| ring::wire(wiring, 2, 1, 10_000)).expect("builds");
        assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle, "{threads} threads");
        assert_eq!(runtime.deliveries(), 2 + 10_001, "two meet, then the token is passed on");
        drop(balls);
    }
}

#[test]
fn a_recording_replays_on_any_number_of_threads() {
    for threads in [0, 1, 2, 3] {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("run.fvlog");
        let config = Config { seed: 7, ..Config::live(threads).record(&path) };
        let (mut runtime, _) =
            Runtime::build(config, |wiring| ring::wire(wiring, 8, 64, 2_000)).expect("builds");
        assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
        let expected = runtime.positions();
        let shutdown = runtime.shutdown(WAIT);
        assert!(shutdown.drained, "{shutdown:?}");
        let trace = std::sync::Arc::new(Trace::open(&path).expect("reads"));
        assert!(trace.complete(), "{:?}", trace.damage());
        for replay_threads in [0, 1, 2, 3] {
            let config = Config::replay(trace.clone(), replay_threads);
            let (mut runtime, _) =
                Runtime::build(config, |wiring| ring::wire(wiring, 8, 64, 2_000)).expect("builds");
            let report = runtime.replay();
            assert!(report.divergence.is_none(), "{}", report.divergence.expect("some"));
            assert!(report.complete, "{report:?}");
            let found = runtime.positions();
            // The recording also holds the orders to stop.
            assert!(found.iter().zip(&expected).all(|(found, expected)| found.0 >= expected.0));
        }
    }
}
