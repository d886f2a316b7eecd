//! A recording in the browser.

use std::path::PathBuf;

use serde_json::{Value, json};

use super::served::{Served, Viewer};
use crate::support::browser::Browser;
use crate::support::{CHEAP_BAKE, Foveal, folder, scene};

/// A walk of eight frames, recorded.
fn recorded() -> PathBuf {
    let file = folder("recorded").join("walk.fvl");
    let words = format!("walk --frames 8 --fps 20 --size 96x64 --baked {CHEAP_BAKE} --record");
    Foveal::new(&words).arg(&file).arg(scene("box")).ok();
    file
}

/// The timeline, once it is as wanted.
fn timeline(viewer: &mut Viewer, wanted: impl Fn(&Value) -> bool) -> Value {
    loop {
        let timeline = viewer.hears("state")["timeline"].take();
        if wanted(&timeline) {
            return timeline;
        }
    }
}

#[test]
fn a_recording_is_gone_through_and_left_for_a_walk() {
    let file = recorded();
    let served = Served::recording(&file);
    let mut viewer = served.hello(&served.token);
    assert!(viewer.hears("welcome")["title"].as_str().is_some_and(|title| title.ends_with("recorded")));
    let first = timeline(&mut viewer, |at| at["frame"] == 0);
    assert_eq!(first["frames"], 8);
    // A frame is, each bit of it, what a replay shows.
    viewer.say(&json!({"type": "do", "name": "frame", "number": 5}));
    timeline(&mut viewer, |at| at["frame"] == 5);
    let out = folder("shown").join("five.png");
    Foveal::new("replay --show 5 --out").arg(&out).arg(&file).ok();
    let expected = image::open(&out).expect("a picture").to_rgb8();
    let decoded = |frame: &[u8]| image::load_from_memory(&frame[32..]).expect("a picture").to_rgb8();
    while viewer.last[1] != 3 || decoded(&viewer.last) != expected {
        viewer.sees(|flags| flags == 3);
    }
    viewer.say(&json!({"type": "do", "name": "why", "x": 40, "y": 40}));
    let told = timeline(&mut viewer, |at| at["story"].as_array().is_some_and(|story| !story.is_empty()));
    assert!(told["story"].to_string().contains("40,40"), "{told}");
    viewer.say(&json!({"type": "do", "name": "messages", "count": -3}));
    timeline(&mut viewer, |at| at["position"] != told["position"]);
    viewer.say(&json!({"type": "do", "name": "replay"}));
    timeline(&mut viewer, |at| at["frame"] == 7 && at["plays"] == false);
    // From there a walk goes on.
    viewer.say(&json!({"type": "do", "name": "branch"}));
    timeline(&mut viewer, Value::is_null);
    viewer.say(&json!({"type": "set", "key": "policy", "value": "random"}));
    while viewer.hears("values")["values"]["policy"] != "random" {}
    assert_eq!(served.interrupt().code, Some(130));
    Foveal::new("replay --serve=0.0.0.0:0").arg(&file).fails(2, &["ssh -L"]);
    Foveal::new("replay --serve=127.0.0.1:0 none.fvl").fails(3, &["none.fvl"]);
}

#[test]
fn a_recording_in_the_page_has_a_timeline() {
    let Some(browser) = Browser::open() else { return };
    let file = recorded();
    let served = Served::recording(&file);
    let mut page = browser.page();
    page.resize(1280, 900, "light", false);
    page.go(&served.address());
    let frame =
        |n: u32| format!("document.querySelector('#timeline output').textContent === 'frame {n} of 8'");
    page.wait(&frame(0));
    // What was decided then stays; how it is looked at does not.
    assert_eq!(
        page.eval(
            "[document.getElementById('c-exposure').disabled, document.getElementById('c-policy').disabled]"
        ),
        json!([false, true])
    );
    page.eval("document.getElementById('picture').focus()");
    page.key("ArrowRight", "ArrowRight", true);
    page.key("ArrowRight", "ArrowRight", false);
    page.wait(&frame(1));
    page.key("End", "End", true);
    page.wait(&frame(7));
    page.mouse("mousePressed", 400.0, 400.0);
    page.mouse("mouseReleased", 400.0, 400.0);
    page.wait("!document.querySelector('#timeline pre').textContent.includes('Click a pixel')");
    assert!(page.eval("document.querySelector('#timeline pre').textContent").to_string().contains("pixel"));
    let over = page.eval("document.documentElement.scrollWidth - innerWidth");
    assert!(over.as_f64() <= Some(0.0), "{over} pixels too wide");
    page.screenshot(&super::page::shots().join("recording.png"), "png");
    page.eval("document.querySelector('[data-way=branch]').click()");
    page.wait("document.getElementById('timeline').hidden");
    page.wait("document.getElementById('state').textContent.startsWith('exact')");
    assert_eq!(page.errors, Vec::<String>::new());
}
