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
    let (said, lines): (Vec<&str>, Vec<&str>) =
        ended.out.lines().filter(|l| !l.is_empty()).partition(|l| l.starts_with(' '));
    assert!(said[0].trim().starts_with("FrameBegan { frame: 0, camera: {"), "{}", ended.out);
    assert_eq!(lines.len(), 4, "three deliveries and the summary: {}", ended.out);
    let first: Vec<&str> = lines[0].split_whitespace().collect();
    assert_eq!(first[1..4], ["FrameBegan", "from", "input"], "{}", ended.out);
    let until = Foveal::new("replay --until 1 --actor allocator").arg(&trace).json();
    assert_eq!(until["frames"], 2);
    let told = until["deliveries"].as_array().expect("deliveries");
    let done = told.iter().find(|d| d["message"] == "JobDone").expect("a job");
    assert!(done["says"]["JobDone"]["samples"].as_u64() > Some(0), "{done}");
    Foveal::new("replay --actor nobody").arg(&trace).fails(2, &["nobody", "cache ager"]);
    Foveal::new("replay --until 1:x").arg(&trace).fails(2, &["1:x"]);
    let profile = folder("profile").join("turns.json");
    Foveal::new("replay --export chrome").arg(&profile).arg(&trace).ok();
    let profile: Value =
        serde_json::from_slice(&fs::read(&profile).expect("a profile")).expect("a JSON document");
    assert!(profile["traceEvents"].as_array().is_some_and(|events| events.len() > 10));
}

#[test]
fn hashes_are_as_dense_as_asked() {
    let record = |hashes: &str| {
        let file = folder("recording").join("walk.fvl");
        let walk =
            format!("walk --frames 12 --fps 40 --size 48x32 --workers 2 --quick --hashes {hashes} --record");
        Foveal::new(&walk).arg(&file).arg(scene("gallery")).json();
        let stat = Foveal::new("log stat").arg(&file).json();
        (file, stat["bytes_per_delivery"].as_f64().expect("a number"))
    };
    let (each, sparse) = (record("each"), record("sparse"));
    assert!(each.1 < 1.5 && sparse.1 < 0.5, "{} and {} bytes", each.1, sparse.1);
    for (file, _) in [each, sparse] {
        assert_eq!(replayed(&file, 2)["diverged"], Value::Null);
    }
    // It replays, but nothing can be said of it.
    let (none, _) = record("none");
    Foveal::new("replay").arg(&none).ok();
    Foveal::new("replay --verify").arg(&none).fails(3, &["without hashes"]);
}

/// A walk of which many pixels still show samples of earlier views.
fn hurried(fps: u32) -> PathBuf {
    let file = folder("recording").join("walk.fvl");
    let walk = format!("walk --frames 6 --fps {fps} --size 96x64 --workers 1 --quick --record");
    Foveal::new(&walk).arg(&file).arg(scene("gallery")).ok();
    file
}

#[test]
fn a_pixel_is_explained_from_input_to_sample() {
    // With time for samples also where the machine is busy.
    let trace = hurried(20);
    let steps = |d: &Value| -> Vec<String> {
        let chain = d["chain"].as_array().expect("a chain");
        chain.iter().map(|link| link["step"].as_str().expect("a step").to_owned()).collect()
    };
    let (mut fresh, mut cached) = (0, 0);
    for pixel in ["20,58", "48,60", "80,55", "10,60"] {
        let d = Foveal::new(&format!("replay --why {pixel}")).arg(&trace).json();
        // A busy machine is further along the path by then, so what lies there is not asked.
        assert_eq!(d["frame"], 5, "{pixel}: {d}");
        match d["age"].as_u64() {
            Some(0) => {
                fresh += 1;
                assert_eq!(steps(&d)[..1], ["input"]);
                assert!(steps(&d).ends_with(&["job", "sample", "pixel"].map(String::from)), "{d}");
            }
            Some(age) => {
                cached += 1;
                let tail = ["priority", "job", "sample", "cache", "pixel"].map(String::from);
                assert!(steps(&d).ends_with(&tail) && age < 6, "{d}");
            }
            None => assert_eq!(steps(&d), ["input"]),
        }
        // Every place that is named can be gone to.
        for link in d["chain"].as_array().into_iter().flatten() {
            // What was traced before anybody had looked has no saliency to go to.
            let Some(at) = link["at"].as_str() else {
                assert_eq!(link["step"], "saliency", "{link}");
                continue;
            };
            Foveal::new("replay --until").arg(at).arg(&trace).ok();
        }
    }
    assert!(cached + fresh >= 1, "{cached} cached, {fresh} fresh");
    let told = Foveal::new("replay --why 2,2 --frame 0").arg(&trace).ok();
    assert!(told.out.contains("pixel 2,2") && told.out.contains("input"), "{}", told.out);
    Foveal::new("replay --why 96,0").arg(&trace).fails(2, &["96,0", "96 × 64"]);
    Foveal::new("replay --why 1,1 --frame 6").arg(&trace).fails(2, &["no frame 6"]);
}

/// Numbers of a JSON array.
fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().expect("numbers").iter().map(|n| n.as_f64().expect("a number")).collect()
}

#[test]
fn the_sample_behind_a_pixel_is_traced_again_with_the_same_bits() {
    // Converged: each of its pixels has a sample of its own, however busy the machine was.
    let trace = folder("recording").join("converged.fvl");
    let walk = "walk --frames 1 --until-converged --fps 200 --size 96x64 --workers 1 --quick --record";
    Foveal::new(walk).arg(&trace).arg(scene("gallery")).ok();
    let (mut traced, mut rays) = (0, 0);
    for pixel in ["20,58", "48,60", "80,55", "10,60", "30,50", "60,50"] {
        let picture = folder("path").join("path.png");
        let d = Foveal::new(&format!("replay --path --why {pixel} --out")).arg(&picture).arg(&trace).json();
        let drawn = image::open(&picture).expect("a picture");
        assert!(drawn.width() >= 640, "{} columns", drawn.width());
        let path = &d["path"];
        if path.is_null() {
            continue;
        }
        traced += 1;
        assert_eq!(path["same"], true, "{pixel}: {d}");
        let steps = path["steps"].as_array().expect("steps");
        let (sum, sample) = (numbers(&steps[0]["adds"]), numbers(&path["sample"]));
        for (sum, sample) in sum.iter().zip(&sample) {
            assert!((sum - sample).abs() <= 1e-3 * (1.0 + sample.abs()), "{pixel}: {sum} of {sample}");
        }
        let is = |kind: &str| steps.iter().filter(|step| step["is"] == kind).count();
        rays += is("ray");
        assert!(is("surface") >= 1, "{path}");
        // Each ray was drawn with numbers in [0, 1), or is a lobe of one direction.
        for step in steps.iter().filter(|step| step["is"] == "ray" && step["lobe"] == "glossy") {
            assert!(numbers(&step["random_numbers"]).iter().all(|n| (0.0..1.0).contains(n)), "{step}");
        }
        let told = Foveal::new(&format!("replay --path --why {pixel}")).arg(&trace).ok();
        assert!(told.out.contains("traced again: the same bits"), "{}", told.out);
    }
    assert!(traced >= 2 && rays >= 2, "{traced} samples, {rays} rays");
    Foveal::new("replay --path").arg(&trace).fails(2, &["--why"]);
}

/// A first estimate of the light states no error, and none is told of it.
#[test]
fn what_nothing_is_known_of_is_not_told_as_exact() {
    let file = folder("recording").join("walk.fvl");
    Foveal::new("walk --frames 3 --fps 40 --size 48x32 --workers 1 --record")
        .arg(&file)
        .arg(scene("gallery"))
        .ok();
    let d = Foveal::new("replay --why 5,5 --frame 0").arg(&file).json();
    assert!(d["surface"]["thing"]["path"].is_string(), "{d}");
    let light = &d["surface"]["light"];
    let is_first = light["map"]["rounds"] == 0;
    assert_eq!(light["stated_error"].is_null(), is_first, "{light}");
    assert_eq!(light["map"]["stated_error"].is_null(), is_first, "{light}");
    let told = Foveal::new("replay --why 5,5 --frame 0").arg(&file).ok();
    assert_eq!(told.out.contains("its error not known"), is_first, "{}", told.out);
}

#[test]
fn what_a_frame_waited_for_is_a_chain_from_its_beginning_to_its_showing() {
    let trace = hurried(200);
    for frame in 0..6 {
        let d = Foveal::new(&format!("replay --why-late {frame}")).arg(&trace).json();
        let path = d["path"].as_array().expect("a path");
        let (first, last) = (&path[0], path.last().expect("a last one"));
        assert_eq!(
            (&first["message"], &last["message"]),
            (&"FrameBegan".into(), &"DeadlineReached".into()),
            "{d}"
        );
        assert!((d["had_ms"].as_f64().expect("a time") - 5.0).abs() < 0.01, "{d}");
        let sum: f64 = path.iter().map(|link| link["ms"].as_f64().expect("a time")).sum();
        assert!((sum - d["path_ms"].as_f64().expect("a time")).abs() < 1e-6, "{d}");
        // Each waits for the one before: at its actor, or the one that sent it.
        for pair in path.windows(2) {
            let (before, after) = (pair[0]["at"].as_str().expect("a place"), &pair[1]);
            let actor = |at: &str| at.rsplit_once(':').expect("a place").0.to_owned();
            let at = after["at"].as_str().expect("a place");
            assert!(after["sent_in"] == before || actor(at) == actor(before), "{before}, then {after}");
        }
        assert!(!d["threads"].as_array().expect("threads").is_empty());
        let told = Foveal::new(&format!("replay --why-late {frame}")).arg(&trace).ok();
        assert!(told.out.starts_with(&format!("frame {frame}: ")), "{}", told.out);
    }
    Foveal::new("replay --why-late 6").arg(&trace).fails(2, &["no frame 6"]);
}

#[test]
fn steps_go_forward_and_back_alike() {
    let trace = recorded("--policy attention");
    let session = |commands: &str| {
        let ended = Foveal::new("replay --step --until 2").arg(&trace).input(commands).ok();
        let is_place = |l: &&str| !l.starts_with(' ');
        ended.out.lines().skip(1).filter(is_place).map(str::to_owned).collect::<Vec<_>>()
    };
    // How far the others are when frame 2 is shown differs from run to run; within a session all is fixed.
    let round = session("s 5\nb 5\ns 5\np\n");
    assert_eq!(round[..5], round[10..15]);
    let undone: Vec<String> = round[5..10].iter().rev().map(|l| l.replace("back over ", "")).collect();
    assert_eq!(undone, round[..5]);
    assert!(round[15].contains("frame 2 shown"), "{round:?}");
    // Over the place it was jumped to, to the start, and what is mistyped.
    let long = session("b 500\ns\nw 1,1\nx\ng nobody:3\nq\n");
    assert!(long.iter().any(|l| l.contains("the start of the recording")), "{long:?}");
    assert!(long.iter().any(|l| l.starts_with("renderer:0 ")), "{long:?}");
    assert!(long.iter().any(|l| l.contains("nobody")), "{long:?}");
    let back = Foveal::new("replay --back 3").arg(&trace).ok();
    assert_eq!(back.out.lines().filter(|l| l.starts_with("back over")).count(), 3, "{}", back.out);
}

/// What is said of a step is what changed: the state before it and the changes make the state after it.
#[test]
fn steps_say_what_they_are_told_and_what_that_changes() {
    let trace = recorded("");
    let session = "t renderer.view\nn renderer.view > 2\nt renderer.view\nn renderer.view > 99\nt renderer.nothing\nq\n";
    let ended = Foveal::new("replay --step --until 1").arg(&trace).input(session).ok();
    let views: Vec<&str> = ended.out.lines().filter(|l| l.parse::<u32>().is_ok()).collect();
    assert_eq!(views[1], "3", "{}", ended.out);
    assert!(ended.out.contains("does not come about any more"), "{}", ended.out);
    assert!(ended.out.contains("nothing stands at nothing of renderer"), "{}", ended.out);
    let steps = Foveal::new("replay --step --json").arg(&trace).input("s 60\nq\n").ok();
    let lines = steps.out.lines().map(|l| serde_json::from_str::<Value>(l).expect("JSON"));
    let changes: Vec<Value> = lines.filter(|l| l["changes"].is_array()).collect();
    let began = changes.iter().find(|l| l["message"] == "FrameBegan").expect("a frame");
    let view = began["changes"].as_array().expect("changes").iter().find(|c| c["path"] == "view");
    assert_eq!(view, Some(&serde_json::json!({"path": "view", "from": 0, "to": 1})), "{began}");
}

#[test]
fn states_are_told_at_places_and_between_them() {
    let trace = recorded("");
    let at = |place: &str| {
        let told =
            Foveal::new("replay --state allocator --at").arg(place).arg("--json").arg(&trace).ok().json();
        told["state"].clone()
    };
    let (before, after) = (at("1"), at("3"));
    assert!(before["begun"].as_u64() < after["begun"].as_u64(), "{before} {after}");
    let between = Foveal::new("replay --state allocator --state-diff 1 3").arg(&trace).json();
    let all = between["differences"].as_array().expect("differences");
    let begun = all.iter().find(|d| d["path"] == "begun").expect("views pass");
    assert_eq!((&begun["a"], &begun["b"]), (&before["begun"], &after["begun"]));
    Foveal::new("replay --state-diff 2 2").arg(&trace).ok();
    Foveal::new("replay --state nobody").arg(&trace).fails(2, &["nobody", "cache ager"]);
}

#[test]
fn it_is_said_when_something_comes_about() {
    let trace = recorded("");
    let met = |condition: &str, which: &str| {
        let d = Foveal::new("replay --json --when")
            .arg(condition)
            .arg("--which")
            .arg(which)
            .arg(&trace)
            .ok()
            .json();
        d["met"].as_array().expect("places").clone()
    };
    let all = met("renderer.view changes", "all");
    assert!(all.len() > 2, "{all:?}");
    assert_eq!(met("renderer.view changes", "first"), all[..1]);
    assert_eq!(met("renderer.view changes", "last"), all[all.len() - 1..]);
    let next = Foveal::new("replay --json --when")
        .arg("renderer.view changes")
        .arg("--which")
        .arg("next")
        .arg("--until");
    let next = next.arg(all[0]["at"].as_str().expect("a place")).arg(&trace).ok().json();
    assert_eq!(next["met"][0], all[1]);
    Foveal::new("replay --when").arg("renderer.view > 9999").arg(&trace).fails(1, &["never comes about"]);
    Foveal::new("replay --when").arg("renderer.view").arg(&trace).fails(2, &["no condition", "--state"]);
    Foveal::new("replay --when").arg("renderer.vew > 1").arg(&trace).fails(2, &["renderer.vew"]);
}

#[test]
fn two_recordings_part_where_they_part() {
    let (one, other) = (recorded(""), recorded("--seed 5"));
    let same = Foveal::new("replay --json --diff").arg(&one).arg(&one).ok().json();
    assert_eq!((&same["same"], &same["first"]), (&Value::Bool(true), &Value::Null));
    let ended = Foveal::new("replay --json --diff").arg(&one).arg(&other).run();
    let d = ended.json();
    assert_eq!((ended.code, &d["same"]), (Some(1), &Value::Bool(false)));
    assert!(d["settings"].to_string().contains("settings"), "{d}");
    assert!(d["first"]["actor"].is_string() && d["first"]["index"].is_u64(), "{d}");
    // Each actor's parting names what differs: a field and both values.
    let named = d["actors"].as_array().expect("partings").iter().flat_map(|p| p["differences"].as_array());
    let named: Vec<&Value> = named.flatten().collect();
    assert!(!named.is_empty() && named.iter().all(|d| d["path"].is_string() && d["a"] != d["b"]), "{d}");
    let foreign = Foveal::new("replay --diff").arg(&one).arg(root().join("traces/table.fvl"));
    foreign.fails(3, &["other systems", "tracer-2"]);
}

#[test]
fn a_walk_leaves_a_profile() {
    let folder = folder("profile");
    for (name, first) in [("walk.json", b'{'), ("walk.pftrace", 0x0a)] {
        let walk = "walk --frames 3 --fps 40 --size 48x32 --workers 2 --quick --json --profile";
        Foveal::new(walk).arg(folder.join(name)).arg(scene("box")).ok();
        let bytes = fs::read(folder.join(name)).expect("a profile");
        assert_eq!(bytes[0], first);
        let has = |word: &[u8]| bytes.windows(word.len()).any(|w| w == word);
        assert!(has(b"renderer") && has(b"tracer") && has(b"worker 1"), "{name}");
    }
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
    other.fails(3, &["walk.fvl", "another scene", "duck.toml", "is not read any more"]);
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
    let made = Foveal::new(&format!("bake {bake} --json --out")).arg(&one).arg(scene("box")).ok().json();
    Foveal::new(&walk).arg(&one).arg("--record").arg(&trace).arg(scene("box")).ok();
    assert_eq!(replayed(&trace, 2)["diverged"], Value::Null);
    let more = "--particles 300000 --error 1% --texels 8192";
    let other = folder("bakes").join("other.bake");
    Foveal::new(&format!("bake {more} --out")).arg(&other).arg(scene("box")).ok();
    let refused = Foveal::new("replay --bake").arg(&other).arg(&trace);
    refused.fails(3, &["another illumination", &format!("{} particles", made["particles"])]);
}

#[test]
fn simulated_walks_lose_nothing_whatever_goes_wrong() {
    for room in ["box", "diffuse", "gallery"] {
        let words = "simulate --seeds 0..24 --size 48x48 --faults panic,hang,delay,stall,slow,full,torn-log,disk-full --twice";
        let d = Foveal::new(words).arg(scene(room)).json();
        assert_eq!((&d["seeds"], &d["failures"]), (&24.into(), &serde_json::json!([])), "{room}");
    }
}

/// Light that grows, textures that do not fit, workers that rest, and everything that can go wrong, at once.
#[test]
fn simulated_walks_lose_nothing_under_a_limit_and_growing_light() {
    for more in ["--texture-budget 450000", "--texture-budget 450000 --grow", "--grow"] {
        let words = "simulate --seeds 0..8 --size 32x32 --faults panic,hang,delay,stall,slow,full,torn-log,disk-full --twice";
        let d = Foveal::new(&format!("{words} {more}")).arg(scene("gallery")).json();
        assert_eq!((&d["seeds"], &d["failures"]), (&8.into(), &serde_json::json!([])), "{more}");
    }
    Foveal::new("simulate --seeds 0..1 --texture-budget 1kB").arg(scene("gallery")).fails(4, &["1000 bytes"]);
}

#[test]
fn whoever_panics_the_walk_goes_on_or_ends_in_order() {
    // A quarter of the seeds may end; the light grows, so that each of the six actors has its panics.
    let words = "simulate --seeds 0..48 --size 48x48 --faults panic --grow --twice";
    let d = Foveal::new(words).arg(scene("box")).json();
    assert_eq!((&d["seeds"], &d["failures"]), (&48.into(), &serde_json::json!([])));
    let ends = ["renderer:panic:9", "allocator:panic:3", "illuminator:panic:2"];
    for fault in ends {
        let words = format!("simulate --seeds 3..4 --grow --fault {fault}");
        let d = Foveal::new(&words).arg(scene("box")).json();
        assert_eq!(d["failures"], serde_json::json!([]), "{fault} ends in order, and its recording is whole");
        let ended = Foveal::new(&format!("{words} --must-rest --json")).arg(scene("box")).run();
        assert_eq!(ended.code, Some(1), "{fault} ends the walk: {}", ended.err);
    }
    for fault in ["tracer:panic:2", "cache ager:panic:2", "analyzer:panic:1"] {
        let words = Foveal::new("simulate --seeds 3..4 --grow --must-rest --fault").arg(fault);
        assert_eq!(words.arg(scene("box")).json()["failures"], serde_json::json!([]), "{fault} is survived");
    }
}

#[test]
fn a_simulation_that_fails_says_how_and_leaves_a_recording() {
    let out = folder("failures");
    // Nobody can stand in for an allocator: the walk ends, in order.
    let words =
        "simulate --seeds 3..4 --must-rest --fault allocator:panic:3 --fault tracer:stall:1 --json --traces";
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

/// Light that grows is not baked again where its maps are at hand, and else with one clear line; every frame is found at
/// once the second time.
#[test]
fn a_walk_whose_light_grows_is_sought_in() {
    let folder = folder("recording");
    let walk = |name: &str, more: &str| {
        let file = folder.join(name);
        let words = "walk --frames 6 --fps 10 --size 48x32 --workers 2 --texels 4096";
        Foveal::new(&format!("{words} {more} --record")).arg(&file).arg(scene("box")).ok();
        file
    };
    let cache = |name: &str| folder.join(name);
    let show = |trace: &Path, cache: &Path, frame: u32| {
        let picture = folder.join("frame.png");
        let replay = Foveal::new(&format!("replay --show {frame} --out")).arg(&picture).arg("--cache");
        let told = replay.arg(cache).arg(trace).ok();
        (fs::read(&picture).expect("a picture"), told.err)
    };
    let kept = walk("kept.fvl", "");
    let light = folder.join("kept.fvl.light");
    let whole = fs::read(&light).expect("maps");
    let first: Vec<_> = (0..6).map(|frame| show(&kept, &cache("whole"), frame)).collect();
    assert!(first.iter().all(|(_, told)| !told.contains("baked again")), "{first:?}");
    let index = Foveal::new("replay --index --cache").arg(cache("whole")).arg(&kept).json();
    assert!(index["snapshots"].is_u64() && index["frames"] == 6, "{index}");
    for frame in (0..6).rev() {
        assert_eq!(show(&kept, &cache("whole"), frame).0, first[frame as usize].0, "frame {frame}");
    }
    let damaged = |name: &str, bytes: &[u8]| {
        fs::write(&light, bytes).expect("written");
        let (picture, told) = show(&kept, &cache(name), 5);
        assert_eq!(picture, first[5].0, "{name}");
        assert_eq!(told.matches("baked again").count(), 1, "{name}: {told}");
    };
    let mut flipped = whole.clone();
    flipped[60] ^= 1;
    damaged("flipped", &flipped);
    damaged("cut", &whole[..whole.len().min(100)]);
    fs::remove_file(&light).expect("removed");
    let (picture, told) = show(&kept, &cache("missing"), 5);
    assert!(picture == first[5].0 && told.matches("baked again").count() == 1, "{told}");
    walk("without.fvl", "--no-light");
    assert!(!folder.join("without.fvl.light").exists());
    // Which lamp lights the floor.
    let told = Foveal::new("replay --why 24,28 --frame 5").arg(&kept).ok().out;
    assert!(told.contains("surface ") && told.contains("  straight ") && told.contains("  map "), "{told}");
    let d = Foveal::new("replay --why 24,28 --frame 5").arg(&kept).json();
    let light = &d["surface"]["light"];
    let band = |value: &Value| value[0].as_f64().expect("a number");
    let straight: f64 =
        light["direct"].as_array().expect("lamps").iter().map(|lamp| band(&lamp["irradiance"])).sum();
    let sum = straight + band(&light["indirect"]);
    assert!(straight > 0.0 && (sum - band(&light["irradiance"])).abs() < 1e-3 * sum, "{light}");
}
