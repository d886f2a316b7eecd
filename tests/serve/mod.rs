//! `foveal serve` as a user has it: a browser, a visit that is recorded, and those who should not get in.
//!
//! What needs a browser is skipped, with the reason on the standard error, where there is no Chromium.

mod changed;
mod encrypted;
mod page;
mod recording;
mod served;
mod strangers;

use std::fs;

use serde_json::json;

use self::served::Served;
use crate::support::{CHEAP_BAKE, Foveal, folder, scene};

/// The picture of a walk that stood still until it had converged.
fn converged(more: &str) -> image::RgbImage {
    let out = folder("converged");
    Foveal::new(&format!("walk --frames 1 --until-converged --size 96x64 --baked {CHEAP_BAKE} {more} --out"))
        .arg(&out)
        .arg(scene("box"))
        .ok();
    image::open(out.join("frame-0000.png")).expect("a picture").to_rgb8()
}

#[test]
fn a_still_picture_is_what_a_walk_converges_to_byte_for_byte() {
    let served = Served::start("--refine 0");
    let mut viewer = served.hello(&served.token);
    let welcome = viewer.hears("welcome");
    assert_eq!((&welcome["role"], &welcome["size"]), (&json!("drives"), &json!([96, 64])));
    let frame = viewer.sees(|flags| flags == 3);
    let picture = image::load_from_memory(&frame[32..]).expect("a picture").to_rgb8();
    assert!(picture == converged(""), "not what a walk converges to");
    // The same, to keep.
    let file = viewer.keeps();
    assert!(image::load_from_memory(&file).expect("a picture").to_rgb8() == picture);
    let text = String::from_utf8_lossy(&file);
    assert!(text.contains("foveal camera") && text.contains("foveal controls"));
    assert_eq!(served.interrupt().code, Some(130));
}

#[test]
fn a_visit_is_recorded_and_replays() {
    let file = folder("visit").join("visit.fvl");
    let served = Served::start(&format!("--record {}", file.display()));
    let mut viewer = served.hello(&served.token);
    viewer.hears("welcome");
    viewer.sees(|_| true);
    let mut input = Vec::new();
    for (time, kind, a) in [(100.0_f64, 1_u8, 0.0_f32), (180.0, 3, 40.0), (250.0, 2, 0.0)] {
        input.extend(time.to_le_bytes());
        input.push(kind);
        input.extend(a.to_le_bytes());
        input.extend(5.0_f32.to_le_bytes());
    }
    viewer.socket.send(tungstenite::Message::binary(input)).expect("sent");
    viewer.sees(|_| true);
    for (key, value) in [("exposure", json!(-2.0)), ("overlay", json!("sample level")), ("fps", json!(30))] {
        viewer.say(&json!({"type": "set", "key": key, "value": value}));
        loop {
            let values = viewer.hears("values");
            if values["values"][key] == value || values["values"][key].as_f64() == value.as_f64() {
                break;
            }
        }
    }
    viewer.sees(|flags| flags == 3);
    let ended = served.interrupt();
    assert_eq!(ended.code, Some(130), "{}", ended.err);
    let replayed = Foveal::new("replay --verify").arg(&file).json();
    assert_eq!((&replayed["diverged"], &replayed["complete"]), (&json!(null), &json!(true)));
    assert!(replayed["frames"].as_u64() > Some(3), "{replayed}");
    // Who came and with what right stays outside.
    let bytes = fs::read(&file).expect("a recording");
    assert!(!bytes.windows(22).any(|part| part == served_token(&ended).as_bytes()));
}

/// The token that a server printed.
fn served_token(ended: &crate::support::Ended) -> String {
    let document: serde_json::Value = serde_json::from_str(&ended.out).expect("a document");
    document["address"].as_str().and_then(|a| a.split_once("#t=")).expect("a token").1.to_owned()
}

#[test]
fn each_has_a_walk_of_their_own_where_that_is_wanted() {
    let file = folder("each").join("own.fvl");
    let served = Served::start(&format!("--share each --walks 2 --workers 2 --record {}", file.display()));
    let mut viewers = [0, 1].map(|_| served.hello(&served.token));
    for viewer in &mut viewers {
        assert_eq!(viewer.hears("welcome")["role"], "drives");
        viewer.sees(|flags| flags == 3);
    }
    let [first, second] = &mut viewers;
    first.say(&json!({"type": "set", "key": "exposure", "value": -3.0}));
    first.sees(|flags| flags == 3);
    second.say(&json!({"type": "do", "name": "bookmark", "number": 0, "set": false}));
    let mut third = served.hello(&served.token);
    assert_eq!(third.hears("bye")["why"], "full");
    assert_eq!(served.interrupt().code, Some(130));
    for file in [file.clone(), file.with_file_name("own-2.fvl")] {
        let replayed = Foveal::new("replay --verify").arg(&file).json();
        assert_eq!((&replayed["diverged"], &replayed["complete"]), (&json!(null), &json!(true)));
    }
}

#[test]
fn what_makes_no_sense_is_refused() {
    let scene = scene("box");
    Foveal::new("serve --listen 0.0.0.0:0").arg(&scene).fails(2, &["--behind-proxy", "ssh -L"]);
    Foveal::new("serve --size 5000x10").arg(&scene).fails(2, &["4096"]);
    Foveal::new("serve --listen 127.0.0.1:0").arg("none.toml").fails(3, &["none.toml"]);
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let listen = format!("serve --listen {}", taken.local_addr().expect("an address"));
    Foveal::new(&listen).arg(&scene).fails(5, &["cannot listen"]);
    let short = folder("token").join("token");
    fs::write(&short, "short\n").expect("a file");
    Foveal::new("serve --listen 127.0.0.1:0 --token-file").arg(&short).arg(&scene).fails(3, &["no token"]);
}

#[test]
fn a_kept_token_opens_the_next_server_too() {
    let file = folder("token").join("token");
    let words = format!("--token-file {}", file.display());
    let first = Served::start(&words);
    let token = first.token.clone();
    assert_eq!(fs::read_to_string(&file).expect("a token").trim(), token);
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        assert_eq!(fs::metadata(&file).expect("a file").permissions().mode() & 0o077, 0);
    }
    drop(first);
    let second = Served::start(&words);
    assert_eq!(second.token, token);
    second.hello(&token).hears("welcome");
}
