//! Recordings that are kept: gone on with from every frame, found again, forgotten in order.

use std::path::Path;
use std::sync::Arc;

use foveal_runtime::{Limit, Snapshot};

use super::counters::counted;
use super::index::{Index, make_room};
use super::{How, Source};
use crate::recording::Elsewhere;

fn kept(name: &str) -> Source {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../traces").join(name);
    Source::open(&path, &Elsewhere::default(), true, &()).expect("a walk")
}

/// Whoever adds to an actor's state and forgets to save it fails here.
#[test]
fn a_walk_goes_on_from_every_frame() {
    for name in ["box.fvl", "duck.fvl", "gallery.fvl", "table.fvl"] {
        let source = kept(name);
        let (mut whole, _) = source.system(How { threads: 2, ..How::default() }).expect("a system");
        assert!(whole.replay().complete, "{name}");
        for frame in 0..source.shown_in.len() as u32 {
            let until = Some(source.frame_shown(frame).expect("a frame"));
            let how = How { threads: frame as usize % 3, until, ..How::default() };
            let (mut before, _) = source.system(how).expect("a system");
            before.pump(Limit::IDLE);
            let snapshot = before.snapshot().unwrap_or_else(|| panic!("{name}, frame {frame}: no snapshot"));
            let from = Snapshot::from_bytes(&snapshot.to_bytes()).map(Arc::new);
            assert_eq!(from.as_deref(), Some(&snapshot));
            let (mut after, _) = source.system(How { threads: 2, from, ..How::default() }).expect("a system");
            let report = after.replay();
            assert_eq!(report.divergence, None, "{name}, frame {frame}");
            assert!(report.complete && after.fingerprint() == whole.fingerprint(), "{name}, frame {frame}");
        }
    }
}

#[test]
fn kept_snapshots_are_found_again_and_damage_is_seen() {
    let source = kept("gallery.fvl");
    let folder = tempfile::tempdir().expect("a folder");
    let open = || Index::open(&source.path, Some(folder.path()));
    let mut index = open();
    let renderer = source.renderer();
    for frame in [5, 2] {
        let until = Some(source.frame_shown(frame).expect("a frame"));
        let (mut runtime, _) = source.system(How { until, ..How::default() }).expect("a system");
        runtime.pump(Limit::IDLE);
        index.keep(|| counted(&source.trace, &runtime));
    }
    let at = |index: &Index, frame: usize| {
        let snapshot = index.before(renderer, source.shown_in[frame])?;
        Some(snapshot.positions()[renderer.0 as usize] - 1)
    };
    let again = open();
    for index in [&index, &again] {
        assert_eq!(at(index, 2), None);
        assert_eq!((at(index, 3), at(index, 5)), (Some(source.shown_in[2]), Some(source.shown_in[2])));
        assert_eq!(at(index, 7), Some(source.shown_in[5]));
    }
    let file = std::fs::read_dir(folder.path()).expect("files").next().expect("one").expect("one").path();
    let mut bytes = std::fs::read(&file).expect("a file");
    let last = bytes.len() - 10;
    bytes[last] ^= 1;
    std::fs::write(&file, &bytes).expect("written");
    assert_eq!(at(&open(), 3), None, "damaged");
    bytes[12] ^= 1;
    std::fs::write(&file, &bytes).expect("written");
    assert_eq!(at(&open(), 7), None, "of another program");
}

#[test]
fn where_one_looked_before_nothing_runs() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../traces/gallery.fvl");
    let elsewhere = Elsewhere { cache: Some(folder.path().to_owned()), ..Elsewhere::default() };
    let source = Source::open(&path, &elsewhere, true, &()).expect("a walk");
    let until = Some(source.frame_shown(3).expect("a frame"));
    let (mut first, _) = source.system(How { until, ..How::default() }).expect("a system");
    first.pump(Limit::IDLE);
    source.keep(&first);
    let how = How { threads: 2, until, jump: true, ..How::default() };
    let (mut again, actors) = source.run(how, |_| ()).expect("a replay");
    let report = again.replay_report();
    assert_eq!(report.divergence, None);
    assert_eq!(again.positions(), first.positions());
    let shown = again.inspect(actors.renderer, |r| r.shown().map(|s| s.index.0)).flatten();
    assert_eq!(shown, Some(3));
    // And on from there.
    again.resume(None);
    let report = again.replay();
    assert!(report.complete, "{:?}", report.divergence);
}

#[test]
fn snapshots_have_a_bound() {
    let source = kept("gallery.fvl");
    let folder = tempfile::tempdir().expect("a folder");
    let mut index = Index::open(&source.path, Some(folder.path()));
    let renderer = source.renderer();
    for frame in 0..8 {
        let until = Some(source.frame_shown(frame).expect("a frame"));
        let (mut runtime, _) = source.system(How { until, ..How::default() }).expect("a system");
        runtime.pump(Limit::IDLE);
        index.keep(|| counted(&source.trace, &runtime));
    }
    let count = |index: &Index| {
        let found = source.shown_in.iter().filter(|at| index.right_after(renderer, **at).is_some());
        found.count()
    };
    assert_eq!(count(&index), 8);
    index.thin(4).expect("room");
    let again = Index::open(&source.path, Some(folder.path()));
    for index in [&index, &again] {
        assert!((2..=5).contains(&count(index)), "{} of 8", count(index));
    }
    // What was used least lately goes, but for what is in use.
    let [other, own] = [folder.path().join("other.fvsnaps"), again.file.clone().expect("a file")];
    std::fs::write(&other, [0; 1000]).expect("written");
    make_room(&own, 10).expect("room");
    assert!(own.exists() && !other.exists());
}
