//! Recordings that cannot be replayed, or not all of them: each with one clear line, and what can be replayed is.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use crate::support::{Ended, Foveal, folder, recording, scene};

/// A walk through a scene of its own, in a folder of its own.
fn recorded() -> (PathBuf, PathBuf) {
    let folder = folder("misfit");
    let of = scene("box");
    for entry in fs::read_dir(of.parent().expect("a folder")).expect("files").flatten() {
        fs::copy(entry.path(), folder.join(entry.file_name())).expect("copied");
    }
    let (recording, scene) = (folder.join("walk.fvl"), folder.join("box.toml"));
    let walk = "walk --frames 4 --fps 40 --size 48x32 --workers 2 --quick --record";
    Foveal::new(walk).arg(&recording).arg(&scene).ok();
    (recording, scene)
}

fn replay(recording: &Path) -> Ended {
    Foveal::new("replay --verify --workers 2 --json").arg(recording).run()
}

/// It ends with this code and one line that says why, which is returned.
fn refused(recording: &Path, code: i32) -> String {
    let ended = replay(recording);
    assert_eq!((ended.code, ended.err.trim().lines().count()), (Some(code), 1), "{}", ended.err);
    assert!(ended.err.starts_with("foveal: ") && !ended.err.contains("panicked"), "{}", ended.err);
    ended.err
}

#[test]
fn a_scene_that_is_gone_or_another_one_is_named() {
    let (recording, scene) = recorded();
    let material = scene.with_file_name("box.mtl");
    let before = fs::read_to_string(&material).expect("materials");
    fs::write(&material, before.replace("Kd 0.73", "Kd 0.7")).expect("written");
    let said = refused(&recording, 3);
    assert!(said.contains("another scene") && said.contains("box.mtl has changed"), "{said}");
    assert!(!said.contains("box.obj"), "only what has changed is named: {said}");
    fs::write(&material, before).expect("written");
    assert_eq!(replay(&recording).code, Some(0));
    fs::rename(&scene, scene.with_file_name("moved.toml")).expect("moved");
    let said = refused(&recording, 3);
    assert!(said.contains("walk.fvl") && said.contains("box.toml") && said.contains("--scene"), "{said}");
}

/// A file that ends anywhere is replayed as far as it goes; one that ends before it says what it is, is none.
#[test]
fn a_recording_that_ends_anywhere_replays_as_far_as_it_goes() {
    let (recording, _) = recorded();
    let bytes = fs::read(&recording).expect("a recording");
    let cut = recording.with_file_name("cut.fvl");
    let whole = replay(&recording).json()["messages"].as_u64();
    let mut replayed = Vec::new();
    for part in 0..16 {
        let length = bytes.len() * part / 16;
        fs::write(&cut, &bytes[..length]).expect("written");
        let ended = replay(&cut);
        assert!(!ended.err.contains("panicked"), "{length} bytes: {}", ended.err);
        assert!(ended.err.trim().lines().count() <= 1, "{length} bytes: {}", ended.err);
        match ended.code {
            Some(0) => {
                let d = ended.json();
                assert_eq!((&d["diverged"], &d["complete"]), (&Value::Null, &json!(false)), "{length} bytes");
                replayed.push(d["messages"].as_u64());
            }
            other => assert!(other == Some(3) && ended.err.contains("cut.fvl"), "{length}: {}", ended.err),
        }
    }
    assert!(replayed.is_sorted() && replayed.iter().all(|messages| *messages <= whole), "{replayed:?}");
    assert!(!replayed.is_empty());
}

#[test]
fn bits_that_were_flipped_are_found() {
    let (recording, _) = recorded();
    let bytes = fs::read(&recording).expect("a recording");
    let flipped = recording.with_file_name("flipped.fvl");
    for part in 0..24 {
        let at = (bytes.len() - 1) * part / 23;
        let mut bytes = bytes.clone();
        bytes[at] ^= 1 << (part % 8);
        fs::write(&flipped, bytes).expect("written");
        let ended = replay(&flipped);
        assert!(!ended.err.contains("panicked") && !ended.err.is_empty(), "byte {at}: {}", ended.err);
        // A length that was flipped makes it a file that ends early.
        let ends_early = ended.code == Some(0) && ended.json()["complete"] == false;
        let is_refused = ended.code == Some(3) && ended.err.trim().lines().count() == 1;
        assert!(ends_early || is_refused && ended.err.contains("flipped.fvl"), "byte {at}: {}", ended.err);
    }
}

/// Checksums are right, and what they are of makes no sense.
#[test]
fn sound_files_that_say_nonsense_are_refused() {
    let (recording, _) = recorded();
    for (place, value, says) in [
        ("/settings/width", json!(0), "picture size"),
        ("/settings/tracers", json!(4000), "number of tracers"),
        ("/settings/samples_per_job", json!(0), "samples of a job"),
        ("/settings", json!({}), "no recording of foveal"),
        ("/scene_hash", json!("ff"), "another scene"),
        ("/illumination_hash", json!("ff"), "another illumination"),
    ] {
        let file = recording::altered(&recording, "nonsense.fvl", |_, run| {
            *run.pointer_mut(place).expect("a value") = value;
        });
        let said = refused(&file, 3);
        assert!(said.contains(says) && said.contains("nonsense.fvl"), "{said}");
    }
    // Other actors than there were.
    let fewer = recording::altered(&recording, "fewer.fvl", |_, run| run["settings"]["tracers"] = json!(1));
    let said = refused(&fewer, 3);
    assert!(said.contains("another system"), "{said}");
}

/// Where nothing differs but the machine it replays; where it parts, what is different there is said.
#[test]
fn another_machine_is_named_where_a_replay_parts() {
    let (recording, _) = recorded();
    let there = |header: &mut foveal_runtime::Header| header.fingerprint.processor = "abacus".into();
    let elsewhere = recording::altered(&recording, "elsewhere.fvl", |header, _| there(header));
    let ended = replay(&elsewhere);
    assert_eq!(ended.code, Some(0), "{}", ended.err);
    assert!(ended.json()["foreign"].as_str().is_some_and(|said| said.contains("abacus")), "{}", ended.out);
    let other = recording::altered(&recording, "other.fvl", |header, run| {
        there(header);
        run["settings"]["samples_per_job"] = json!(7);
    });
    let ended = replay(&other);
    assert_eq!(ended.code, Some(1), "{}", ended.err);
    assert!(ended.err.contains("recorded elsewhere") && ended.err.contains("abacus"), "{}", ended.err);
}
