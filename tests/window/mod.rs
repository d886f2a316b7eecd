//! A real window on a virtual display: keys, drags and sliders, what is on the screen, and its end.
//!
//! Skipped, with the reason on the standard error, where Xvfb, xdotool or a graphics adapter is missing.

mod driver;
mod drop;
mod hands;

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use serde_json::Value;

use self::driver::{CORNER, Display, PATIENCE, SIZE, Shot, View};
use crate::support::{CHEAP_BAKE, Foveal, folder, root, scene};

/// Where the handle of the slider for frames per second is on the screen: the second one, after that for exposure.
fn fps_slider(screen: &[Vec<[u8; 3]>]) -> [usize; 2] {
    // Rails are grey and 100 points long, with a handle that has a bright rim.
    let left = CORNER[0] + SIZE[0] + 26;
    // (A line between two groups is as grey, and longer.)
    let grey =
        |y: usize, from: usize, to: usize| screen[y][from..to].iter().filter(|p| **p == [60; 3]).count();
    let rail = |y: &usize| grey(*y, left, left + 114) > 90 && grey(*y, left + 114, left + 125) == 0;
    let exposure = (0..SIZE[1]).find(rail).expect("a slider");
    // A rail is eight points high.
    let y = (exposure + 12..SIZE[1]).find(rail).expect("another slider") + 4;
    let x = (left..left + 114).find(|&x| screen[y][x].iter().all(|c| *c > 150)).expect("its handle");
    [x + 3, y]
}

#[test]
fn keys_drags_and_sliders_reach_the_walk_and_closing_ends_it() {
    let Some(display) = Display::open() else { return };
    if !display.has_adapter() {
        return;
    }
    let (files, recorded) = (folder("scene"), folder("recorded").join("window.fvl"));
    for file in fs::read_dir(root().join("scenes/box")).expect("the box").flatten() {
        fs::copy(file.path(), files.join(file.file_name())).expect("copied");
    }
    let sidecar = files.join("box.toml");
    let words = format!("--backend gpu --record {}", recorded.display());
    let mut view = View::open(&display, &words, &sidecar, &[]);
    let first = view.converged();
    view.shows(&first, "the start view");

    // What has converged is what a run without a window makes.
    assert!(headless_still().pixels == first.pixels, "not the corrected picture");

    view.act("keydown d sleep 0.3 keyup d");
    let walked = view.converged();
    assert_ne!(walked.camera("eye"), first.camera("eye"));
    view.shows(&walked, "a step to the right");

    view.act("mousedown 3 sleep 0.2 mousemove --window {} 130 100 sleep 0.2 mousemove --window {} 160 110 sleep 0.2 mouseup 3");
    let turned = view.converged();
    assert_eq!(turned.camera("eye"), walked.camera("eye"));
    assert_ne!(turned.camera("target"), walked.camera("target"));

    view.act("key 1 sleep 0.2");
    let back = view.converged();
    assert_eq!((back.camera("eye"), back.camera("target")), (first.camera("eye"), first.camera("target")));
    assert_eq!(back.pixels, first.pixels, "the same place looks the same, bit for bit");

    let screen = display.screen();
    let [x, y] = fps_slider(&screen);
    let drag: String =
        (1..=4).map(|i| format!("mousemove --window {{}} {} {y} sleep 0.15 ", x + 6 * i)).collect();
    view.act(&format!(
        "mousemove --window {{}} {x} {y} sleep 0.2 mousedown 1 sleep 0.2 {drag} mouseup 1 sleep 0.2"
    ));
    let set = view.converged();
    let fps = |shot: &Shot| shot.setting("fps").as_f64().expect("a number");
    assert!(fps(&set) > fps(&first) + 1.0, "{} after {}", fps(&set), fps(&first));
    assert_eq!(set.pixels, first.pixels);

    // The box beneath it: frames wait until they are good enough.
    view.act(&format!(
        "mousemove --window {{}} {} {} sleep 0.2 click 1 sleep 0.2",
        CORNER[0] + SIZE[0] + 44,
        y + 23
    ));
    view.until("frames wait", |s| s.setting("quality").as_f64() == Some(-0.25));

    // A scene that cannot be read keeps the old one and says why.
    assert!(!view.complains());
    let text = fs::read_to_string(&sidecar).expect("the sidecar");
    fs::write(&sidecar, format!("{text}\nnonsense = = 1\n")).expect("written");
    view.act("mousemove --window {} 100 100 key F5 sleep 0.3");
    let start = Instant::now();
    while !view.complains() {
        assert!(start.elapsed() < PATIENCE, "no error in the window");
        std::thread::sleep(Duration::from_millis(50));
    }
    let kept = view.converged();
    assert_eq!(kept.fact("foveal scene"), first.fact("foveal scene"));
    fs::write(&sidecar, text).expect("written");

    // One pixel, and more than the screen has.
    view.act("windowsize {} 1 1 sleep 0.3 windowsize {} 7680 4320 sleep 0.5");
    view.act(&format!("windowsize {{}} {} {} sleep 0.3 windowfocus {{}}", SIZE[0] + 330, SIZE[1]));
    let sized = view.converged();
    view.shows(&sized, "after other sizes");
    view.quit();

    let replayed = Foveal::new("replay --verify").arg(&recorded).json();
    assert_eq!((&replayed["diverged"], &replayed["complete"]), (&Value::Null, &Value::Bool(true)));
    assert!(replayed["frames"].as_u64() > Some(4), "{replayed}");
}

/// What a run without a window makes of the box's start view.
fn headless_still() -> Shot {
    let out = folder("headless").join("still.png");
    let [width, height] = SIZE;
    Foveal::new(&format!("view --headless --size {width}x{height} --workers 2 {CHEAP_BAKE} --out"))
        .arg(&out)
        .arg(scene("box"))
        .ok();
    Shot::read(&out).expect("a picture")
}

#[test]
fn an_adapter_draws_the_same_and_may_be_lost() {
    let Some(display) = Display::open() else { return };
    if !display.has_adapter() {
        return;
    }
    let mut view =
        View::open(&display, "--display gpu --lose-surface 2 --lose-adapter 4", &scene("box"), &[]);
    let drawn_by = |shot: &Shot| !shot.fact("foveal drawn by").is_empty();
    let first = view.converged();
    assert!(drawn_by(&first), "{:?}", first.facts);
    view.shows(&first, "drawn by the adapter");
    let still = headless_still();
    let pairs = still.pixels.iter().zip(&first.pixels);
    let off = pairs.filter(|(a, b)| a.abs_diff(**b) > 2).count();
    assert!(off * 100 < still.pixels.len(), "{off} values differ from the processor's");
    view.act("keydown d sleep 0.3 keyup d");
    let walked = view.converged();
    assert_ne!(walked.pixels, first.pixels);
    view.shows(&walked, "a step to the right");
    // The adapter is lost some time; another one shows the same.
    std::thread::sleep(Duration::from_secs(4));
    view.act("key Tab sleep 0.3");
    for _ in 1..11 {
        view.act("key Tab sleep 0.2");
    }
    let after = view.converged();
    assert_eq!(after.pixels, walked.pixels);
    view.shows(&after, "after the adapter was lost");
    let told = view.quit();
    assert!(told.contains("surface was lost") && told.contains("painted anew by"), "{told}");
}

#[test]
fn without_an_adapter_the_processor_paints_the_same() {
    let Some(display) = Display::open() else { return };
    let nowhere = [("VK_DRIVER_FILES", "/nonexistent"), ("VK_ICD_FILENAMES", "/nonexistent")];
    let words = "--backend auto --mode fixed-quality --quality -0.125";
    let mut view = View::open(&display, words, &scene("box"), &nowhere);
    let shot = view.converged();
    assert_eq!((shot.setting("quality"), shot.fact("foveal quality")), (Value::from(-0.125), "0"));
    view.shows(&shot, "painted by the processor");
    view.quit();
}

#[test]
fn a_recording_is_gone_through_in_the_window_and_left_for_a_walk() {
    let Some(display) = Display::open() else { return };
    let trace = root().join("traces/duck.fvl");
    let words = "replay --view --workers 2";
    let mut view = View::of(&display, Foveal::new(words).arg(&trace), "^foveal.-.*,.recorded", &[]);
    let at = |shot: &Shot, frame: &str| shot.fact("foveal frame") == frame;
    assert!(at(&view.shot(), "0"));
    view.act("key Right sleep 0.3 key Right sleep 0.3 key Left sleep 0.3 key Right sleep 0.5");
    let second = view.shot();
    assert!(at(&second, "2"), "{:?}", second.facts);
    let out = folder("shown").join("2.png");
    Foveal::new("replay --show 2 --out").arg(&out).arg(&trace).ok();
    assert!(
        Shot::read(&out).is_some_and(|shown| shown.pixels == second.pixels),
        "not the frame as it was shown"
    );
    // A message on, a message back, a pixel's story, and a bit of the whole.
    view.act("key period sleep 0.3 key comma sleep 0.3 click 1 sleep 0.5 key space sleep 0.5");
    let start = Instant::now();
    while at(&view.shot(), "2") {
        assert!(start.elapsed() < PATIENCE, "it does not play");
    }
    scrub(&display, &mut view, &trace);
    view.act("key b sleep 0.5");
    let walked = view.converged();
    assert!(walked.fact("foveal camera").starts_with("eye"), "{:?}", walked.facts);
    view.quit();
}

/// Goes through the recording with the mouse on its timeline: wherever the handle is, that frame is shown, while the
/// button is down as well.
fn scrub(display: &Display, view: &mut View<'_>, trace: &Path) {
    let frames = Foveal::new("log stat").arg(trace).json()["frames"].as_u64().expect("a number") as usize;
    let last = frames - 1;
    // There is room for all of the timeline. (It may play still, and is at its end soon.)
    view.act("windowsize --sync {} 900 500 sleep 0.5 key Home sleep 0.5");
    view.until("the first frame", |s| s.fact("foveal frame") == "0");
    let [left, right, y] = rail(&display.screen());
    let of = |frame: usize| {
        format!("mousemove --window {{}} {} {y} sleep 0.3 ", left + (right - left) * frame / last)
    };
    let shows = |view: &mut View<'_>, frame: usize| {
        view.until("a frame of the timeline", |s| s.fact("foveal frame") == frame.to_string())
    };
    view.act(&format!("{}mousedown 1 sleep 0.3", of(0)));
    for frame in [last, 0, last / 2] {
        view.act(&of(frame));
        shows(view, frame);
    }
    // Let go, the handle stays where it is, and the mouse moves nothing.
    view.act(&format!("mouseup 1 sleep 0.3 {}", of(last)));
    let shot = shows(view, last / 2);
    let out = folder("shown").join("middle.png");
    Foveal::new(&format!("replay --show {} --out", last / 2)).arg(&out).arg(trace).ok();
    assert!(
        Shot::read(&out).is_some_and(|shown| shown.pixels == shot.pixels),
        "not the frame as it was shown"
    );
}

/// First and last column of the places of the timeline's handle, and their row.
fn rail(screen: &[Vec<[u8; 3]>]) -> [usize; 3] {
    let grey = |y: &usize| screen[*y][..580].iter().filter(|p| **p == [60; 3]).count();
    // (The line above it goes all the way.)
    let y = (100..500).find(|y| (300..570).contains(&grey(y))).expect("a timeline") + 4;
    let is_rail = |x: &usize| screen[y][*x] == [60; 3] || screen[y][*x].iter().all(|c| *c > 150);
    let (first, last) = ((0..580).find(is_rail), (0..580).rev().find(is_rail));
    // The handle does not go beyond the rail.
    [first.expect("its begin") + 6, last.expect("its end") - 6, y]
}
