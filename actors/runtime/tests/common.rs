//! Support for the tests.

use foveal_runtime::*;
use std::sync::Arc;
use std::time::Duration;

use crate::ring;
use crate::workshop::{self, Options, Order};

/// Far more than any test needs.
pub const WAIT: Duration = Duration::from_secs(60);

/// Records a ring of 8 players and 64 tokens; returns the file's bytes.
pub fn record_ring(threads: usize, seed: u64, hops: u32, hashing: Hashing) -> Vec<u8> {
    record_ring_in_turns(threads, seed, hops, hashing, Budget::default())
}

/// The same, with turns of so much.
pub fn record_ring_in_turns(
    threads: usize,
    seed: u64,
    hops: u32,
    hashing: Hashing,
    budget: Budget,
) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("ring.fvlog");
    let config = Config { seed, hashing, budget, ..Config::live(threads).record(&path) };
    let (mut runtime, _) = Runtime::build(config, |wiring| ring::wire(wiring, 8, 64, hops)).expect("builds");
    assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
    let shutdown = runtime.shutdown(WAIT);
    assert!(shutdown.drained && shutdown.dead_letters == 0, "{shutdown:?}");
    std::fs::read(path).expect("a file")
}

/// Records `orders` orders of 16 tasks each.
pub fn record_workshop(threads: usize, orders: u64, options: Options) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("workshop.fvlog");
    let config = Config::live(threads).record(&path);
    let (mut runtime, shop) =
        Runtime::build(config, |wiring| workshop::wire(wiring, options)).expect("builds");
    for _ in 0..orders {
        shop.orders.send(Order { tasks: 16 }).expect("room");
        runtime.pump(Limit::time(Duration::from_micros(200)));
    }
    assert_eq!(runtime.pump(Limit::idle_within(WAIT)), Exit::Idle);
    let stats = shop.pool.stats();
    assert_eq!((stats.pushed, stats.completed + stats.dead), (orders * 16, orders * 16), "{stats:?}");
    let shutdown = runtime.shutdown(WAIT);
    assert!(shutdown.drained && shutdown.jobs_left == 0, "{shutdown:?}");
    std::fs::read(path).expect("a file")
}

pub fn read(bytes: &[u8]) -> Arc<Trace> {
    Arc::new(Trace::from_bytes(bytes).expect("a recording"))
}

pub fn replay_ring(trace: &Arc<Trace>, threads: usize, hops: u32) -> ReplayReport {
    let config = Config::replay(Arc::clone(trace), threads);
    let (mut runtime, _) = Runtime::build(config, |wiring| ring::wire(wiring, 8, 64, hops)).expect("builds");
    runtime.replay()
}

pub fn replay_workshop(trace: &Arc<Trace>, threads: usize, options: Options) -> ReplayReport {
    let config = Config::replay(Arc::clone(trace), threads);
    let (mut runtime, _) = Runtime::build(config, |wiring| workshop::wire(wiring, options)).expect("builds");
    runtime.replay()
}

/// Fails with the whole report unless all was replayed alike.
#[track_caller]
pub fn assert_complete(report: &ReplayReport) {
    if let Some(divergence) = &report.divergence {
        panic!("{divergence}");
    }
    assert!(report.complete && report.deliveries == report.recorded, "{report:?}");
}
