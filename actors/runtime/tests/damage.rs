//! Damaged recordings: read up to the damage, replayed as far as they agree, never a panic.

use foveal_runtime::*;
use proptest::prelude::*;
use std::sync::{Arc, LazyLock};

use crate::common::*;
use crate::workshop::{self, Options};

static RING: LazyLock<Vec<u8>> = LazyLock::new(|| record_ring(2, 7, 300, Hashing::Exact));

/// A recording of at least 200 ms, so of several segments.
static SHOP: LazyLock<Vec<u8>> = LazyLock::new(|| record_workshop(2, 1000, Options::new(2)));

#[test]
fn a_cut_recording_replays_to_its_consistent_end() {
    let whole = read(&SHOP).stat();
    assert!(whole.segments >= 3, "{whole:?}");
    let mut replayed = Vec::new();
    for cut in 0..50 {
        let bytes = &SHOP[..SHOP.len() * cut / 50];
        let Ok(trace) = Trace::from_bytes(bytes) else { continue };
        let trace = Arc::new(trace);
        assert!(trace.damage().is_some() && !trace.complete());
        for threads in [0, 2] {
            let report = replay_workshop(&trace, threads, Options::new(2));
            assert!(report.divergence.is_none(), "cut {cut}: {}", report.divergence.expect("some"));
            assert!(!report.complete);
            replayed.push(report.deliveries);
        }
        // What `cut` keeps is the same recording.
        let kept = read(&bytes[..trace.whole_bytes() as usize]);
        assert_eq!(kept.stat(), trace.stat());
    }
    assert!(replayed.iter().any(|deliveries| *deliveries > 0));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn flipped_bits_are_seen(at in 0_usize..1 << 20, bit in 0..8) {
        let mut bytes = RING.clone();
        let at = at % bytes.len();
        bytes[at] ^= 1_u8 << bit;
        match Trace::from_bytes(&bytes) {
            Ok(trace) => prop_assert!(trace.damage().is_some(), "byte {} of {}", at, bytes.len()),
            Err(error) => prop_assert!(!error.to_string().is_empty()),
        }
    }

    #[test]
    fn any_bytes_behind_the_magic_are_no_panic(tail: Vec<u8>) {
        let mut bytes = RING[..8].to_vec();
        bytes.extend_from_slice(&tail);
        let damaged = matches!(Trace::from_bytes(&bytes), Err(TraceError::Header { .. }));
        prop_assert!(damaged);
    }
}

#[test]
fn foreign_files_are_told_apart() {
    let open = |bytes: &[u8]| Trace::from_bytes(bytes);
    assert!(matches!(open(b""), Err(TraceError::NotARecording)));
    assert!(matches!(open(b"PNG and so on"), Err(TraceError::NotARecording)));
    let mut other = RING.clone();
    other[6] = 99;
    assert!(matches!(open(&other), Err(TraceError::Version { found: 99, .. })));
    assert!(matches!(Trace::open(std::path::Path::new("/nonexistent")), Err(TraceError::Io(_))));
}

#[test]
fn lengths_are_not_believed() {
    // A segment behind the header that claims to unpack to 4 GiB, and one that claims to be 4 GiB long.
    let header = 8 + 12 + u32::from_le_bytes(RING[12..16].try_into().expect("four bytes")) as usize;
    for (raw, stored) in [(u32::MAX, 100_u32), (100, u32::MAX), (1 << 24, 10)] {
        let mut bytes = RING[..header].to_vec();
        bytes.extend_from_slice(&raw.to_le_bytes());
        bytes.extend_from_slice(&stored.to_le_bytes());
        bytes.extend_from_slice(&[0; 100]);
        let trace = read(&bytes);
        let damage = trace.damage().expect("damage");
        assert_eq!(damage.offset, header as u64);
        assert!(damage.reason.contains("claims"), "{damage:?}");
    }
}

#[test]
fn a_killed_process_leaves_a_recording_that_replays() {
    // The child runs this very test with a path to record to, and is killed at some instant.
    if let Some(path) = std::env::var_os("FOVEAL_TEST_RECORD") {
        let config = Config::live(2).record(std::path::PathBuf::from(path));
        let (mut runtime, shop) =
            Runtime::build(config, |wiring| workshop::wire(wiring, Options::new(2))).expect("builds");
        loop {
            let _ = shop.orders.send(workshop::Order { tasks: 4 });
            runtime.pump(Limit::time(std::time::Duration::from_micros(500)));
        }
    }
    let folder = tempfile::tempdir().expect("a folder");
    let program = std::env::current_exe().expect("a program");
    let mut deliveries = 0;
    for round in 0..50_u64 {
        let path = folder.path().join(format!("{round}.fvlog"));
        let mut child = std::process::Command::new(&program)
            .args(["damage::a_killed_process_leaves_a_recording_that_replays", "--exact", "--nocapture"])
            .env("FOVEAL_TEST_RECORD", &path)
            .stdout(std::process::Stdio::null())
            .stderr(std::process::Stdio::null())
            .spawn()
            .expect("starts");
        std::thread::sleep(std::time::Duration::from_micros(30_000 + round * 61_803 % 150_000));
        child.kill().expect("is killed");
        child.wait().expect("ends");
        let Ok(trace) = Trace::open(&path) else { continue };
        let report = replay_workshop(&Arc::new(trace), (round % 3) as usize, Options::new(2));
        assert!(report.divergence.is_none(), "round {round}: {}", report.divergence.expect("some"));
        deliveries += report.deliveries;
    }
    assert!(deliveries > 1000, "{deliveries} deliveries in 50 recordings");
}
