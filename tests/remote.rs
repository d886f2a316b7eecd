//! Walks that other processes trace for, which are killed, stopped, and have wrong keys.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::support::*;

const WALK: &str = "walk --frames 1 --until-converged --seed 5 --workers 1 --n-job 64";

/// A walk that is walked with so many guests, recorded; and the file that they join with.
fn walk(size: &str, out: &Path, wait: u32) -> (Running, PathBuf) {
    walk_over("tcp", size, out, wait)
}

/// `size` may be followed by more words.
fn walk_over(link: &str, size: &str, out: &Path, wait: u32) -> (Running, PathBuf) {
    let key = out.join("key");
    let words = format!(
        "{WALK} --size {size} {CHEAP_BAKE} --tracers {link}/127.0.0.1:0 --tracers-max 4 --tracers-wait {wait} --json"
    );
    let walk = Foveal::new(&words)
        .arg(scene("box"))
        .arg("--out")
        .arg(out)
        .arg("--record")
        .arg(out.join("walk.fvl"))
        .arg("--tracers-key")
        .arg(&key)
        .start();
    let mut walk = walk;
    let began = Instant::now();
    while fs::read_to_string(&key).map_or(true, |text| !text.ends_with('\n')) {
        assert!(walk.is_running() && began.elapsed() < Duration::from_secs(120), "{}", walk.said());
        std::thread::sleep(Duration::from_millis(10));
    }
    (walk, key)
}

fn join(key: &Path) -> Running {
    Foveal::new("trace --cores 1 --once --json --join").arg(format!("@{}", key.display())).start()
}

fn local(size: &str) -> PathBuf {
    let out = folder("local");
    Foveal::new(&format!("{WALK} --size {size} {CHEAP_BAKE} --out")).arg(&out).arg(scene("box")).ok();
    out
}

fn assert_same(found: &Path, expected: &Path) {
    assert_same_bits(&picture(&found.join("last.exr")), &picture(&expected.join("last.exr")), "with guests");
}

fn signal(name: &str, process: &Running) {
    let sent = Command::new("kill").arg(name).arg(process.id().to_string()).status();
    assert!(sent.is_ok_and(|status| status.success()));
}

#[test]
fn two_guests_trace_for_a_walk_and_its_recording_replays_without_them() {
    let refined = "192x144 --refine 0.001 --refine-samples 8";
    let (out, expected) = (folder("remote"), local(refined));
    let (walk, key) = walk(refined, &out, 2);
    let guests = [join(&key), join(&key)];
    let ended = walk.wait();
    assert_eq!(ended.code, Some(0), "{}", ended.err);
    let document = ended.json();
    let of = |name: &str| {
        let stations = document["stations"].as_array().expect("a list");
        stations.iter().map(|station| station[name].as_u64().expect("a number")).sum::<u64>()
    };
    // How many is a matter of what else the machine does.
    assert!(of("samples") > 0 && of("banned") == 0, "{document:#}");
    assert_same(&out, &expected);
    let samples: u64 = guests
        .map(|guest| {
            let ended = guest.wait();
            assert_eq!(ended.code, Some(0), "{}", ended.err);
            ended.json()["samples"].as_u64().expect("a number")
        })
        .iter()
        .sum();
    assert!(samples >= of("samples"), "{samples} were traced, {} came", of("samples"));
    let replayed = Foveal::new("replay --verify").arg(out.join("walk.fvl")).json();
    assert!(replayed["diverged"].is_null() && replayed["complete"] == true, "{replayed:#}");
}

#[test]
fn guests_that_are_killed_or_stopped_or_come_again_change_no_bit() {
    let (out, expected) = (folder("remote-killed"), local("320x240"));
    let (walk, key) = walk_over("quic", "320x240", &out, 2);
    let (killed, stopped) = (join(&key), join(&key));
    let began = Instant::now();
    // They trace once the walk has begun to write pictures, or soon.
    while !out.join("frame-0000.png").exists() && began.elapsed() < Duration::from_secs(60) {
        std::thread::sleep(Duration::from_millis(5));
    }
    killed.kill();
    let again = join(&key);
    signal("-STOP", &stopped);
    std::thread::sleep(Duration::from_millis(300));
    signal("-CONT", &stopped);
    let ended = walk.wait();
    assert_eq!(ended.code, Some(0), "{}", ended.err);
    assert_same(&out, &expected);
    stopped.kill();
    again.kill();
    let replayed = Foveal::new("replay --verify").arg(out.join("walk.fvl")).json();
    assert!(replayed["diverged"].is_null() && replayed["complete"] == true, "{replayed:#}");
}

#[test]
fn who_has_no_key_or_a_wrong_one_is_told_so() {
    let out = folder("remote-keys");
    let (mut walk, key) = walk("48x36", &out, 1);
    let text = fs::read_to_string(&key).expect("a key");
    // Another letter of the secret.
    let other = if &text[10..11] == "A" { "B" } else { "A" };
    let wrong = format!("{}{other}{}", &text[..10], text[11..].trim());
    Foveal::new("trace --once --join").arg(&wrong).fails(5, &["another key"]);
    Foveal::new("trace --once --join fvj1-nothing").fails(3, &["no key"]);
    Foveal::new("trace --once --join @/nowhere/at/all").fails(3, &["/nowhere"]);
    Foveal::new("trace --once --join -").input("what is this\n").fails(3, &["no key"]);
    assert!(walk.is_running(), "{}", walk.said());
    Foveal::new("trace --once --memory 1kB --join").arg(text.trim()).fails(4, &["--memory"]);
    Foveal::new("trace --once --limit 5 --join").arg(text.trim()).fails(2, &["--limit"]);
    let guest = Foveal::new("trace --once --limit 5MB --memory 2GiB --join -").input(&text).start();
    assert_eq!(walk.wait().code, Some(0));
    assert_eq!(guest.wait().code, Some(0));
    Foveal::new("trace --once --join").arg(text.trim()).fails(5, &["nobody answers"]);
    let (mut walk, key) = walk_over("quic", "48x36", &out.join("quic"), 1);
    let text = fs::read_to_string(&key).expect("a key");
    let other = if &text[10..11] == "A" { "B" } else { "A" };
    let wrong = format!("{}{other}{}", &text[..10], text[11..].trim());
    Foveal::new("trace --once --join").arg(&wrong).fails(5, &["another key"]);
    assert!(walk.is_running(), "{}", walk.said());
    assert_eq!(join(&key).wait().code, Some(0));
    assert_eq!(walk.wait().code, Some(0));
}

/// A window's walk begins anew with each edit, and the door with it; a picture without a window is that of one machine.
#[test]
fn a_view_has_its_door_too() {
    let out = folder("remote-view");
    fs::create_dir_all(&out).expect("a folder");
    let key = out.join("key");
    let view = |name: &str| {
        let words = format!("view --headless --size 96x72 --seed 5 --workers 1 {CHEAP_BAKE}");
        Foveal::new(&words).arg(scene("box")).arg("--out").arg(out.join(name))
    };
    view("local.png").ok();
    let walk =
        view("remote.png").arg("--tracers").arg("quic/127.0.0.1:0").arg("--tracers-key").arg(&key).start();
    assert_eq!(walk.wait().code, Some(0));
    assert!(fs::read_to_string(&key).expect("a key").starts_with("fvj1-"));
    assert_same_bits(&picture(&out.join("remote.png")), &picture(&out.join("local.png")), "with a door");
    Foveal::new("serve --share each --tracers quic/127.0.0.1:0").arg(scene("box")).fails(2, &["--share one"]);
}

/// A command with two guests over `link` that it waits for, of which the first is killed once it works.
fn with_two_guests(words: &str, link: &str, out: &Path, file: &str) -> Value {
    let key = out.join(format!("{file}.key"));
    let line = format!("{words} --json --tracers {link}/127.0.0.1:0 --tracers-wait 2 --tracers-key");
    let mut work = Foveal::new(&line).arg(&key).arg("--out").arg(out.join(file)).arg(scene("box")).start();
    let began = Instant::now();
    while fs::read_to_string(&key).map_or(true, |text| !text.ends_with('\n')) {
        assert!(work.is_running() && began.elapsed() < Duration::from_secs(120), "{}", work.said());
        std::thread::sleep(Duration::from_millis(10));
    }
    let (killed, stays) = (join(&key), join(&key));
    // They come within a fraction of a second; when exactly it is killed must not matter.
    std::thread::sleep(Duration::from_millis(1500));
    killed.kill();
    let ended = work.wait();
    assert_eq!(ended.code, Some(0), "{}", ended.err);
    stays.kill();
    ended.json()
}

/// What was done elsewhere, of a document.
fn pieces(document: &Value) -> u64 {
    let stations = document["stations"].as_array().expect("a list");
    assert!(stations.len() == 2 && stations.iter().all(|s| s["banned"] == false), "{document:#}");
    stations.iter().map(|s| s["pieces"].as_u64().expect("a number")).sum()
}

#[test]
fn references_split_over_two_guests_have_the_bits_of_one_machine() {
    let out = folder("remote-reference");
    let mut elsewhere = 0;
    for (name, link, kind) in [
        ("traced.exr", "tcp", format!("traced --spp 1 {CHEAP_BAKE}")),
        ("refined.exr", "quic", format!("traced --spp 24 {CHEAP_BAKE}")),
        ("path.exr", "tcp", "path --spp 48".to_owned()),
        ("truth.exr", "quic", "truth --spp 8".to_owned()),
    ] {
        let words = format!("reference --size 320x240 --kind {kind}");
        let local = out.join(format!("local-{name}"));
        Foveal::new(&words).arg("--out").arg(&local).arg(scene("box")).ok();
        let document = with_two_guests(&words, link, &out, name);
        assert_same_bits(&picture(&out.join(name)), &picture(&local), name);
        elsewhere += pieces(&document);
    }
    // One that takes milliseconds may be done before anybody has its light.
    assert!(elsewhere > 0, "nothing was done elsewhere");
}

#[test]
fn a_bake_split_over_two_guests_has_the_bits_of_one_machine() {
    let out = folder("remote-bake");
    let words = "bake --particles 1500000 --error 0.01% --texels 4096";
    let local = out.join("local");
    Foveal::new(words).arg("--out").arg(&local).arg(scene("box")).ok();
    for link in ["tcp", "quic"] {
        let document = with_two_guests(words, link, &out, link);
        assert!(pieces(&document) > 0, "{document:#}");
        let read = |file: &Path| fs::read(file).expect("a bake");
        assert!(read(&out.join(link)) == read(&local), "another bake over {link}");
    }
    Foveal::new("bake --method radiosity --tracers tcp/127.0.0.1:0")
        .arg(scene("box"))
        .fails(2, &["--method"]);
}

#[test]
fn a_door_is_opened_only_where_it_may_be() {
    let of = |address: &str| {
        Foveal::new(&format!("walk --frames 1 --size 32x24 --quick --tracers {address}")).arg(scene("box"))
    };
    of("tcp/0.0.0.0:0").fails(5, &["not encrypted"]);
    of("quic/192.0.2.1:0").fails(5, &["quic/192.0.2.1:0"]);
    of("carrier-pigeon/roof").fails(5, &["no such link"]);
}
