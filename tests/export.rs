//! Replays as files for other viewers.

use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::support::{Foveal, folder, root, scene};

#[test]
fn an_export_has_arrows_from_input_to_pixel() {
    let trace = folder("recording").join("walk.fvl");
    let walk = "walk --frames 4 --fps 40 --size 48x32 --workers 3 --quick --record";
    Foveal::new(walk).arg(&trace).arg(scene("box")).ok();
    let file = folder("profile").join("replay.json");
    Foveal::new("replay --export chrome").arg(&file).arg(&trace).ok();
    let d: Value = serde_json::from_slice(&fs::read(&file).expect("a profile")).expect("a JSON document");
    let events = d["traceEvents"].as_array().expect("events");
    let count = |phase: &str| events.iter().filter(|e| e["ph"] == phase).count();
    let recorded = Foveal::new("log stat").arg(&trace).json()["deliveries"].as_u64().expect("a number");
    assert_eq!((count("X") as u64, count("s")), (recorded, count("f")));
    // Follow arrows from the first input: they come to a job, to samples, and to a frame.
    let slice_at = |e: &Value| {
        let within = |s: &&Value| {
            let (from, time) = (s["ts"].as_f64().unwrap_or(0.0), e["ts"].as_f64().unwrap_or(-1.0));
            let end = from + s["dur"].as_f64().unwrap_or(0.0);
            s["ph"] == "X" && s["tid"] == e["tid"] && from <= time && time <= end
        };
        events.iter().position(|s| within(&s)).expect("an arrow ends at a slice")
    };
    let mut arrows = std::collections::BTreeMap::new();
    for e in events.iter().filter(|e| e["ph"] == "s" || e["ph"] == "f") {
        let ends: &mut [usize; 2] = arrows.entry(e["id"].as_u64()).or_default();
        ends[usize::from(e["ph"] == "f")] = slice_at(e);
    }
    let mut reached = vec![events.iter().position(|e| e["name"] == "FrameBegan").expect("an input")];
    for step in 0.. {
        let Some(from) = reached.get(step).copied() else { break };
        let next = arrows.values().filter(|a| a[0] == from).map(|a| a[1]);
        let new: Vec<usize> = next.filter(|to| !reached.contains(to)).collect();
        reached.extend(new);
    }
    let names: Vec<&str> = reached.iter().filter_map(|slice| events[*slice]["name"].as_str()).collect();
    for name in ["FrameBegan", "ViewDrawn", "TraceJob", "SamplesTraced", "frame "] {
        assert!(names.iter().any(|n| n.starts_with(name)), "no arrow leads to {name}: {names:?}");
    }
    let file = folder("profile").join("replay.pftrace");
    Foveal::new("replay --export perfetto").arg(&file).arg(&trace).ok();
    let bytes = fs::read(&file).expect("a profile");
    assert!(bytes[0] == 0x0a && bytes.windows(9).any(|w| w == b"FrameBegan".get(..9).unwrap_or_default()));
    Foveal::new("replay --export svg x").arg(&trace).fails(2, &["svg"]);
}

/// The program that writes these files lies beside this one, where it was built.
#[test]
fn an_export_for_rerun_is_written_or_its_program_is_named() {
    let (trace, out) = (root().join("traces/box.fvl"), folder("rerun").join("box.rrd"));
    let export = || Foveal::new("replay --export rerun").arg(&out);
    export().arg("--verify").arg(&trace).fails(2, &["nothing else"]);
    let beside = Path::new(env!("CARGO_BIN_EXE_foveal")).with_file_name("foveal-rerun");
    if beside.with_extension(std::env::consts::EXE_EXTENSION).is_file() {
        export().arg(&trace).ok();
        assert_eq!(fs::read(&out).expect("a file")[..4], *b"RRF2");
        export().arg(folder("rerun").join("none.fvl")).fails(3, &["none.fvl"]);
    } else {
        export().arg(&trace).env("PATH", "").fails(5, &["foveal-rerun", "cargo install --path rerun"]);
    }
}
