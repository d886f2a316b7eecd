//! Recording, replay and simulation, and the walks in `traces/`.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::support::{Foveal, folder, root, scene};

/// Records a short walk of the box.
fn recorded(words: &str) -> PathBuf {
    let file = folder("recording").join("walk.fvl");
    let walk = format!("walk --frames 4 --fps 40 --size 48x32 --workers 3 --quick {words} --record");
    let d = Foveal::new(&walk).arg(&file).arg(scene("box")).json();
    assert_eq!(d["warnings"], serde_json::json!([]));
    file
}

fn replayed(trace: &Path, workers: u32) -> Value {
    Foveal::new(&format!("replay --verify --workers {workers}")).arg(trace).json()
}

#[test]
fn a_walk_replays_on_any_number_of_threads() {
    let trace = recorded("--until-converged");
    let first = replayed(&trace, 1);
    assert_eq!((&first["diverged"], &first["complete"]), (&Value::Null, &Value::Bool(true)));
    assert!(first["frames"].as_u64() >= Some(4) && first["messages"].as_u64() > Some(20), "{first}");
    assert_eq!(first["messages"], first["recorded"]);
    for workers in [2, 3] {
        let mut other = replayed(&trace, workers);
        other["workers"] = first["workers"].clone();
        assert_eq!(other, first);
    }
}

#[test]
fn a_replayed_frame_is_the_picture_that_was_shown() {
    let (file, out) = (folder("recording").join("walk.fvl"), folder("pictures"));
    let walk = "walk --frames 3 --fps 40 --size 48x32 --workers 2 --quick --json";
    Foveal::new(walk).arg("--record").arg(&file).arg("--out").arg(&out).arg(scene("box")).ok();
    for frame in 0..3 {
        let again = out.join(format!("again-{frame}.png"));
        Foveal::new(&format!("replay --show {frame}")).arg("--out").arg(&again).arg(&file).ok();
        let shown = image::open(out.join(format!("frame-{frame:04}.png"))).expect("a picture");
        assert_eq!(image::open(&again).expect("a picture"), shown, "frame {frame}");
    }
    let missing = Foveal::new("replay --show 77 --out x.png").arg(&file);
    missing.fails(2, &["77"]);
}

#[test]
fn replay_stops_where_it_is_told_and_lists_an_actor() {
    let trace = recorded("");
    let ended = Foveal::new("replay --until renderer:2 --actor renderer").arg(&trace).ok();
    let lines: Vec<&str> = ended.out.lines().filter(|l| !l.is_empty()).collect();
    assert_eq!(lines.len(), 4, "three deliveries and the summary: {}", ended.out);
    let first: Vec<&str> = lines[0].split_whitespace().collect();
    assert_eq!(first[1..4], ["FrameBegan", "from", "input"], "{}", ended.out);
    let until = Foveal::new("replay --until 1").arg(&trace).json();
    assert_eq!(until["frames"], 2);
    Foveal::new("replay --actor nobody").arg(&trace).fails(2, &["nobody", "cache ager"]);
    Foveal::new("replay --until 1:x").arg(&trace).fails(2, &["1:x"]);
    let profile = folder("profile").join("turns.json");
    Foveal::new("replay --export chrome").arg(&profile).arg(&trace).ok();
    let profile: Value =
        serde_json::from_slice(&fs::read(&profile).expect("a profile")).expect("a JSON document");
    assert!(profile["traceEvents"].as_array().is_some_and(|events| events.len() > 10));
}

#[test]
fn recordings_that_do_not_fit_are_refused_by_name() {
    let trace = recorded("");
    let bytes = fs::read(&trace).expect("a recording");
    let altered = |change: &dyn Fn(&mut Vec<u8>)| {
        let file = folder("altered").join("altered.fvl");
        let mut bytes = bytes.clone();
        change(&mut bytes);
        fs::write(&file, bytes).expect("written");
        file
    };
    let other = Foveal::new("replay --scene").arg(scene("duck")).arg(&trace);
    other.fails(3, &["walk.fvl", "another scene", "duck.toml"]);
    let version = altered(&|b| b[6] += 1);
    Foveal::new("replay").arg(&version).fails(3, &["altered.fvl", "version"]);
    let foreign = altered(&|b| b[0] = b'X');
    Foveal::new("replay").arg(&foreign).fails(3, &["altered.fvl", "no recording"]);
    let middle = bytes.len() * 3 / 4;
    let flipped = altered(&|b| b[middle] ^= 4);
    Foveal::new("log check").arg(&flipped).fails(3, &["altered.fvl", "byte"]);
    let short = altered(&|b| b.truncate(middle));
    Foveal::new("log check").arg(&short).fails(3, &["altered.fvl"]);
    // What a kill leaves replays as far as it goes.
    let prefix = replayed(&short, 2);
    assert_eq!((&prefix["diverged"], &prefix["complete"]), (&Value::Null, &Value::Bool(false)));
    Foveal::new("log cut").arg(&flipped).ok();
    let kept = replayed(&flipped, 2);
    assert_eq!((&kept["diverged"], &kept["complete"]), (&Value::Null, &Value::Bool(false)));
    Foveal::new("log check").arg(&trace).ok();
    let stat = Foveal::new("log stat").arg(&trace).json();
    assert_eq!((&stat["frames"], &stat["tracers"]), (&4.into(), &3.into()));
}

#[test]
fn a_full_disk_costs_the_recording_only() {
    let walk = "walk --frames 2 --fps 40 --size 32x32 --workers 1 --quick --record";
    for nowhere in ["/dev/full", "/nowhere/walk.fvl"] {
        let d = Foveal::new(walk).arg(nowhere).arg(scene("box")).json();
        assert_eq!(d["frames"], 2);
        let warnings = d["warnings"].to_string();
        assert!(warnings.contains("record"), "{nowhere}: {warnings}");
    }
}

#[test]
fn another_illumination_is_refused() {
    let trace = folder("recording").join("walk.fvl");
    let bake = "--particles 20000 --error 20% --texels 8192";
    let one = folder("bakes").join("walk.bake");
    let walk = format!("walk --frames 1 --size 32x32 --workers 1 {bake} --bake");
    Foveal::new(&format!("bake {bake} --out")).arg(&one).arg(scene("box")).ok();
    Foveal::new(&walk).arg(&one).arg("--record").arg(&trace).arg(scene("box")).ok();
    assert_eq!(replayed(&trace, 2)["diverged"], Value::Null);
    let more = "--particles 300000 --error 1% --texels 8192";
    let other = folder("bakes").join("other.bake");
    Foveal::new(&format!("bake {more} --out")).arg(&other).arg(scene("box")).ok();
    let refused = Foveal::new("replay --bake").arg(&other).arg(&trace);
    refused.fails(3, &["another illumination", "20000 particles"]);
}

#[test]
fn simulated_walks_lose_nothing_whatever_goes_wrong() {
    for room in ["box", "diffuse", "gallery"] {
        let words = "simulate --seeds 0..24 --size 48x48 --faults panic,delay,stall,slow,full --twice";
        let d = Foveal::new(words).arg(scene(room)).json();
        assert_eq!((&d["seeds"], &d["failures"]), (&24.into(), &serde_json::json!([])), "{room}");
    }
}

#[test]
fn a_simulation_that_fails_says_how_and_leaves_a_recording() {
    let out = folder("failures");
    // A panicking allocator forgets that a job was done: nobody can make up for that.
    let words = "simulate --seeds 3..4 --fault allocator:panic:3 --fault tracer:stall:1 --json --traces";
    let ended = Foveal::new(words).arg(&out).arg(scene("box")).run();
    assert_eq!(ended.code, Some(1), "{}", ended.err);
    let failure = &ended.json()["failures"][0];
    assert_eq!(failure["faults"], serde_json::json!(["allocator:panic:3"]), "{failure}");
    assert!(failure["command"].as_str().is_some_and(|c| c.contains("--fault 'allocator:panic:3'")));
    assert_eq!(replayed(&out.join("seed-3.fvl"), 2)["diverged"], Value::Null);
}

#[test]
fn kept_walks_replay_with_one_two_and_three_threads() {
    let mut traces: Vec<PathBuf> = fs::read_dir(root().join("traces"))
        .expect("the folder of traces")
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.extension().is_some_and(|e| e == "fvl"))
        .collect();
    traces.sort();
    assert!(traces.len() >= 4, "{traces:?}");
    for trace in &traces {
        assert!(fs::metadata(trace).expect("a file").len() < 200 * 1024, "{}", trace.display());
        for workers in 1..=3 {
            let d = replayed(trace, workers);
            let diverged = &d["diverged"];
            assert!(
                diverged.is_null() && d["complete"] == true,
                "{} on {workers} threads: {diverged}; traces/README.md says when to record anew",
                trace.display()
            );
        }
    }
}
