//! Where a replay parts from its recording, the program that recorded tells what was recorded.
//!
//! Two programs that differ are one here: a recording whose header says something else than what was walked with makes this
//! program another one than the one that recorded, and a script that takes the true recording instead is that one.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use crate::support::{Foveal, folder, recording, scene};

/// The same recording of a walk with another number of samples in each job.
fn altered(recording: &Path) -> PathBuf {
    recording::altered(recording, "altered.fvl", |_, run| {
        let samples = &mut run["settings"]["samples_per_job"];
        *samples = json!(samples.as_u64().expect("a number") / 2);
    })
}

/// A program that replays `recording`, whichever it is given, and does `then` with what it prints.
fn program(recording: &Path, then: &str) -> PathBuf {
    use std::os::unix::fs::PermissionsExt;
    let program = folder("program").join("before");
    let (foveal, recording) = (env!("CARGO_BIN_EXE_foveal"), recording.display());
    let script = format!("#!/bin/sh\nshift 2\n'{foveal}' replay '{recording}' \"$@\" {then}\n");
    fs::write(&program, script).expect("written");
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).expect("made a program");
    program
}

/// A recording, and where its scene has gone since.
fn recorded(hashes: &str) -> (PathBuf, PathBuf) {
    let folder = folder("recording");
    let (before, after) = (folder.join("before"), folder.join("after"));
    fs::create_dir(&before).expect("a folder");
    let of = scene("gallery");
    for entry in fs::read_dir(of.parent().expect("a folder")).expect("files").flatten() {
        fs::copy(entry.path(), before.join(entry.file_name())).expect("copied");
    }
    let recording = folder.join("walk.fvl");
    let walk =
        format!("walk --frames 6 --fps 40 --size 48x32 --workers 2 --quick --hashes {hashes} --record");
    Foveal::new(&walk).arg(&recording).arg(before.join("gallery.toml")).ok();
    fs::rename(&before, &after).expect("moved");
    (recording, after.join("gallery.toml"))
}

fn replay(recording: &Path, scene: &Path, with: &Path) -> (Value, String) {
    let replay = || Foveal::new("replay").arg(recording).arg("--scene").arg(scene).arg("--with").arg(with);
    let ended = replay().arg("--json").run();
    assert_eq!(ended.code, Some(1), "{}", ended.err);
    let told = replay().run();
    assert_eq!(told.code, Some(1), "{}", told.err);
    (ended.json()["diverged"].clone(), told.out)
}

/// Where files lie is handed on: the scene is not where it was recorded.
#[test]
fn the_program_that_recorded_tells_what_was_recorded() {
    for hashes in ["each", "sparse"] {
        // Jobs of half as many samples are what made it another program: a number, unless it parts at what only one says.
        let of_numbers = |_| {
            let (recording, scene) = recorded(hashes);
            let altered = altered(&recording);
            let (diverged, told) = replay(&altered, &scene, &program(&recording, ""));
            let others = diverged["recorded_differs"].as_array().unwrap_or_else(|| panic!("{diverged}"));
            assert!(!others.is_empty(), "{hashes}: {diverged}");
            for other in others {
                assert!(other["path"].is_string() && other["recorded"] != other["here"], "{other}");
            }
            let number = |of: &Value| of["recorded"].is_number() && of["here"].is_number();
            others.iter().any(number).then_some(told)
        };
        let told = (0..16).find_map(of_numbers).expect("numbers that differ");
        assert!(told.contains(": recorded ") && told.contains(", here "), "{told}");
    }
}

/// A message that only one of both says is named, and not taken for one that says nothing.
#[test]
fn missing_and_further_messages_are_named() {
    // Where a walk parts is a matter of time, too: it may be where an actor answers nothing.
    let answering = |_| {
        let (recording, scene) = recorded("each");
        let altered = altered(&recording);
        let ended = Foveal::new("replay --json").arg(&altered).arg("--scene").arg(&scene).run();
        let kind = ended.json()["diverged"]["answers"][0]["message"].as_str()?.to_owned();
        Some((recording, scene, altered, kind))
    };
    let (recording, scene, altered, kind) = (0..16).find_map(answering).expect("an answer");
    let other = program(&recording, &format!("| sed 's/\"message\": *\"{kind}\"/\"message\":\"Unheard\"/'"));
    let (diverged, told) = replay(&altered, &scene, &other);
    let only = |side: &str| -> Vec<&str> {
        let others = diverged["recorded_differs"].as_array().expect("differences").iter();
        others.filter(|of| of["only"] == side).filter_map(|of| of["path"].as_str()).collect()
    };
    assert!(only("recorded").iter().any(|path| path.starts_with("Unheard to ")), "{diverged}");
    assert!(only("here").iter().any(|path| path.starts_with(&kind)), "{diverged}");
    assert!(told.contains("recorded, and not here") && told.contains("here, and not recorded"), "{told}");
}

/// Whatever is wrong with the other program: that the replay parts is told all the same, and where.
#[test]
fn a_program_that_cannot_tell_costs_its_answer_only() {
    let (recording, scene) = recorded("each");
    let altered = altered(&recording);
    let as_wrong = program(&altered, "");
    let silent = program(&recording, "> /dev/null");
    let cases = [
        (Path::new("/nowhere/foveal"), "/nowhere/foveal"),
        (as_wrong.as_path(), "is not the program that recorded it"),
        (silent.as_path(), "cannot tell what was recorded"),
    ];
    for (other, why) in cases {
        let (diverged, _) = replay(&altered, &scene, other);
        assert!(diverged["actor"].is_string() && diverged["recorded_differs"].is_null(), "{diverged}");
        let unknown = diverged["recorded_unknown"].as_str().unwrap_or_else(|| panic!("{diverged}"));
        assert!(unknown.contains(why), "{unknown}");
    }
}

/// What is said in a delivery is what is delivered as said in it, and what nobody was told in the end.
#[test]
fn all_that_is_said_in_a_delivery_is_told() {
    for hashes in ["each", "sparse", "none"] {
        let (recording, scene) = recorded(hashes);
        let said_in =
            |place: &str| Foveal::new("replay --said").arg(place).arg(&recording).arg("--scene").arg(&scene);
        let told = Foveal::new("replay --actor allocator --scene").arg(&scene).arg(&recording).json();
        let told = told["deliveries"].as_array().expect("deliveries");
        let by = told.iter().rfind(|of| of["message"] == "JobDone").expect("a job was done");
        let place = by["sent_in"].as_str().expect("a place");
        let said = said_in(place).json();
        let all = said["said"].as_array().expect("messages");
        let to_allocator: Vec<&Value> =
            all.iter().filter(|of| of["to"] == "allocator").map(|of| &of["says"]).collect();
        let delivered: Vec<&Value> =
            told.iter().filter(|of| of["sent_in"] == place).map(|of| &of["says"]).collect();
        assert!(!delivered.is_empty() && to_allocator == delivered, "{said} {delivered:?}");
        assert_eq!((&said["at"], &said["diverged"]), (&json!(place), &Value::Null));
        let text = said_in(place).ok();
        assert_eq!(text.out.lines().filter(|line| line.starts_with("JobDone to allocator: ")).count(), 1);
        said_in("allocator:999999").fails(2, &["allocator:999999"]);
    }
}
