//! What a walk begins anew for: other sizes, other lamps, its files read again.

use std::fs;

use serde_json::{Value, json};

use super::page::{STILL, opened, pixels, slide, until};
use super::served::Served;
use crate::support::browser::Browser;
use crate::support::{Foveal, folder, scene};

/// A copy of the box, to be written to.
fn own_box() -> std::path::PathBuf {
    let own = folder("own");
    let from = scene("box").parent().expect("a folder").to_owned();
    for file in fs::read_dir(from).expect("the box").flatten() {
        fs::copy(file.path(), own.join(file.file_name())).expect("a copy");
    }
    own.join("box.toml")
}

#[test]
fn a_visit_with_changes_is_recorded_walk_by_walk_and_replays() {
    let file = folder("changed").join("visit.fvl");
    let own = own_box();
    let served = Served::of(&own, &format!("--refine 0 --record {}", file.display()));
    let mut viewer = served.hello(&served.token);
    let welcome = viewer.hears("welcome");
    assert_eq!(welcome["changes"], true);
    let lamps = welcome["lamps"].as_array().expect("lamps").len();
    assert!(lamps > 0, "{welcome}");
    viewer.sees(|flags| flags == 3);
    viewer.say(&json!({"type": "do", "name": "bookmark", "number": 1, "set": false}));
    viewer.say(&json!({"type": "set", "key": "exposure", "value": -0.5}));
    let text = fs::read_to_string(&own).expect("a sidecar");
    fs::write(&own, text.replacen("title = \"", "title = \"Another ", 1)).expect("a sidecar");
    for (deed, expected) in [
        (json!({"type": "do", "name": "size", "width": 80, "height": 48}), json!([80, 48])),
        (json!({"type": "do", "name": "dim", "lamp": 0, "gain": 0.25}), json!([80, 48])),
        (json!({"type": "do", "name": "reload"}), json!([80, 48])),
    ] {
        viewer.say(&deed);
        // Whatever was set before is kept.
        let welcome = viewer.hears("welcome");
        assert_eq!((&welcome["size"], &welcome["changes"]), (&expected, &json!(true)));
        let gain = if deed["name"] == "dim" { 0.25 } else { 1.0 };
        assert_eq!(welcome["lamps"][0]["gain"], gain, "{deed}");
        assert_eq!(
            welcome["title"].as_str().is_some_and(|t| t.starts_with("Another")),
            deed["name"] == "reload"
        );
        assert_eq!(viewer.hears("values")["values"]["exposure"], -0.5);
        let still = loop {
            let still = viewer.hears("still");
            if still["exact"] == true {
                break still;
            }
        };
        let frame = viewer.sees(|flags| flags == 3);
        assert!(u64::from(viewer.number) >= still["picture"].as_u64().expect("a number"));
        assert_eq!(frame[8..12], [80, 0, 48, 0]);
    }
    let ended = served.interrupt();
    assert_eq!(ended.code, Some(130), "{}", ended.err);
    for name in ["visit-4.fvl", "visit.fvl", "visit-2.fvl", "visit-3.fvl"] {
        let replayed: Value = Foveal::new("replay --verify").arg(file.with_file_name(name)).json();
        assert_eq!((&replayed["diverged"], &replayed["complete"]), (&json!(null), &json!(true)), "{name}");
        assert!(replayed["frames"].as_u64() > Some(0), "{name}: {replayed}");
        // The others are of the files as they were.
        fs::write(&own, &text).expect("a sidecar");
    }
    assert!(!file.with_file_name("visit-5.fvl").exists());
}

#[test]
fn the_page_changes_what_the_walk_begins_anew_for() {
    let Some(browser) = Browser::open() else { return };
    let served = Served::start("--refine 0");
    let mut page = opened(&browser, &served);
    page.eval("document.getElementById('scene').open = true");
    // Exact no more at once, and then again.
    slide(&mut page, "exposure", 0.45);
    let badge = page.eval("document.getElementById('state').textContent");
    assert!(badge.as_str().is_some_and(|text| !text.starts_with("exact")), "{badge}");
    page.wait(STILL);
    let lit = pixels(&mut page);
    // A lamp, by the keyboard.
    let badge = page.eval(
        "(() => { const lamp = document.getElementById('lamp-0'); lamp.value = 0.25;
         lamp.dispatchEvent(new Event('input')); lamp.dispatchEvent(new Event('change'));
         return document.getElementById('state').textContent })()",
    );
    assert!(badge.as_str().is_some_and(|text| !text.starts_with("exact")), "{badge}");
    page.wait(STILL);
    let dimmed = pixels(&mut page);
    let sum = |p: &[u8]| p.iter().map(|b| u64::from(*b)).sum::<u64>();
    assert!(sum(&dimmed) < sum(&lit), "{} of {}", sum(&dimmed), sum(&lit));
    assert_eq!(page.eval("document.getElementById('lamp-0').getAttribute('aria-valuetext')"), "25 %");
    // Read again, lamps are as the files have them.
    page.eval("document.querySelector('#scene > button').click()");
    page.wait(&format!("document.getElementById('lamp-0').value === '1' && {STILL}"));
    until("the lamp is as it was", || pixels(&mut page) == lit);
    // As large as the page, and as that becomes.
    let fits = "(() => { const c = document.getElementById('picture'), s = document.getElementById('stage');
         return Math.abs(c.width - s.clientWidth / 2) < 2 && Math.abs(c.height - s.clientHeight / 2) < 2 })()";
    page.eval(
        "(() => { const size = document.getElementById('size'); size.value = 'half';
         size.dispatchEvent(new Event('change')) })()",
    );
    page.wait(&format!("{fits} && {STILL}"));
    page.resize(1000, 600, "dark", false);
    page.wait(&format!("{fits} && {STILL}"));
    assert_eq!(page.eval("document.getElementById('size').value"), "half");
    let shown = page.eval("document.getElementById('picture').getBoundingClientRect().width");
    let stage = page.eval("document.getElementById('stage').clientWidth");
    assert!(
        (shown.as_f64().unwrap_or(0.0) - stage.as_f64().unwrap_or(1.0)).abs() < 8.0,
        "{shown} of {stage}"
    );
    assert_eq!(page.errors, Vec::<String>::new());
}
