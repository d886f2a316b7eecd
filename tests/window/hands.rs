//! What hands do beside walking: the wheel, Shift and Ctrl, Esc, paths, a window that is hidden, a scene that loads slowly.

use std::fs;
use std::io::Write;
use std::time::Instant;

use super::driver::{Display, PATIENCE, SIZE, Shot, View};
use crate::support::{CHEAP_BAKE, Foveal, folder, root, scene};

/// Scene units per second that the walk goes at.
fn speed(shot: &Shot) -> f64 {
    shot.fact("foveal speed").parse().expect("a number")
}

#[test]
fn the_wheel_keys_and_hiding_do_what_they_are_for() {
    let Some(display) = Display::open() else { return };
    let mut view = View::open(&display, "--backend cpu", &scene("box"), &[]);
    let first = view.converged();
    view.act("click 4 sleep 0.1 click 4 sleep 0.1 click 5 sleep 0.1 click 4 sleep 0.2");
    let wheel = view.converged();
    // Three steps up and one down. (A wheel of buttons may be told of when it is pressed and released.)
    assert!(speed(&wheel) / speed(&first) > 1.43, "{} of {}", speed(&wheel), speed(&first));
    for (key, factor) in [("shift", 4.0), ("ctrl", 0.25)] {
        view.act(&format!("keydown {key} sleep 0.2"));
        view.until(key, |s| (speed(s) / speed(&wheel) - factor).abs() < 1e-3);
        view.act(&format!("keyup {key} sleep 0.2"));
        view.until(key, |s| speed(s) == speed(&wheel));
    }

    // Esc releases the mouse although its button is still down.
    view.act("mousedown 3 sleep 0.2 mousemove --window {} 130 100 sleep 0.2 key Escape sleep 0.2");
    let released = view.converged();
    assert_ne!(released.camera("target"), first.camera("target"));
    view.act("mousemove --window {} 180 140 sleep 0.2 mouseup 3 sleep 0.1 mousemove --window {} 100 100");
    assert_eq!(view.converged().camera("target"), released.camera("target"));

    // A bookmark is set, left and found again.
    view.act("key ctrl+5 sleep 0.2 key 1 sleep 0.2");
    assert_eq!(view.converged().camera("target"), first.camera("target"));
    view.act("key 5 sleep 0.2");
    assert_eq!(view.converged().camera("target"), released.camera("target"));

    // All of them, on their keys.
    let all: String = [2, 3, 4, 6, 7, 8, 9].iter().map(|n| format!("key ctrl+{n} sleep 0.05 ")).collect();
    view.act(&all);
    for n in [2, 3, 4, 6, 7, 8, 9] {
        view.act(&format!("key 1 sleep 0.2 key {n} sleep 0.2"));
        view.until("a bookmark", |s| s.camera("target") == released.camera("target"));
    }

    // In orbit the eye goes about what is in the middle of the view; otherwise it stays where it is.
    let drag = "mousedown 3 sleep 0.2 mousemove --window {} 140 110 sleep 0.2 mouseup 3 sleep 0.1 mousemove --window {} 100 100 sleep 0.1";
    view.act(&format!("key 1 sleep 0.2 key o sleep 0.2 {drag}"));
    let orbited = view.converged();
    assert_ne!(orbited.camera("eye"), first.camera("eye"));
    view.act(&format!("key o sleep 0.2 {drag}"));
    let turned = view.converged();
    assert_eq!(turned.camera("eye"), orbited.camera("eye"));
    assert_ne!(turned.camera("target"), orbited.camera("target"));

    // Help lies over the picture until its key is pressed again.
    view.act("key F1 sleep 0.3");
    let start = Instant::now();
    while view.covered(&turned) < SIZE[0] * SIZE[1] / 4 {
        assert!(start.elapsed() < PATIENCE, "no help");
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
    view.act("key F1 sleep 0.3");
    view.shows(&turned, "without help");

    // A way is recorded and played: it ends where it ended.
    view.act("key 1 sleep 0.3 key r sleep 0.2 keydown d sleep 0.5 keyup d sleep 0.3");
    let end = view.converged();
    view.act("key r sleep 0.2 key 1 sleep 0.3");
    assert_eq!(view.converged().pixels, first.pixels);
    view.act("key p sleep 0.3");
    let start = Instant::now();
    loop {
        let played = view.converged();
        if played.camera("eye") == end.camera("eye") {
            break;
        }
        assert!(start.elapsed() < PATIENCE, "{} is not {}", played.camera("eye"), end.camera("eye"));
    }

    // One pixel, and more than the screen has.
    view.act("windowsize {} 1 1 sleep 0.3 windowsize {} 7680 4320 sleep 0.5");
    view.act(&format!(
        "windowsize {{}} {} {} sleep 0.3 windowfocus {{}} key 1 sleep 0.2",
        SIZE[0] + 330,
        SIZE[1]
    ));
    let sized = view.converged();
    assert_eq!(sized.pixels, first.pixels);
    view.shows(&sized, "after other sizes");

    // Hidden, nothing is drawn; shown again, it goes on.
    view.act("windowunmap --sync {} sleep 0.5 windowmap --sync {} sleep 0.5 windowmove {} 0 0 windowfocus {} sleep 0.3");
    view.act("key 1 sleep 0.2");
    let back = view.converged();
    assert_eq!(back.pixels, first.pixels);
    view.shows(&back, "after it was hidden");
    view.quit();
}

/// Where no size was asked for, the picture has as many pixels as the window has place, at three sizes; camera and controls
/// stay.
#[test]
fn a_picture_follows_its_window() {
    let Some(display) = Display::open() else { return };
    let line = format!("view --baked --workers 2 --refine 0 --set exposure=-1 {CHEAP_BAKE}");
    let mut view = View::of(&display, Foveal::new(&line).arg(scene("box")), "^foveal.-.Box", &[]);
    let bytes = |[width, height]: [usize; 2]| 3 * width * height;
    assert_eq!(view.converged().pixels.len(), bytes([512, 512]));
    view.act("key 2 sleep 0.3");
    let placed = view.converged();
    let (eye, display_of) = (placed.camera("eye"), placed.fact("foveal display").to_owned());
    assert!(display_of.contains("exposure: 0.5"), "{display_of}");
    for [width, height] in [[560, 300], [900, 420], [700, 600]] {
        view.act(&format!("windowsize --sync {{}} {width} {height} sleep 0.5"));
        // The panel and its edge stand beside it.
        let fills = |shot: &Shot| {
            let columns = shot.pixels.len() / (3 * height);
            shot.pixels.len() == bytes([columns, height]) && (310..=340).contains(&(width - columns))
        };
        view.until("a picture of the window's size", fills);
        let sized = view.converged();
        assert!(fills(&sized) && sized.camera("eye") == eye, "{:?}", sized.facts);
        assert_eq!(sized.fact("foveal display"), display_of);
    }
    view.quit();
}

/// Where a point is two pixels wide and high the window is no larger than the display; the panel has twice its pixels, and the
/// picture, shown pixel by pixel, the rest.
#[test]
fn a_dense_display_shows_all_of_the_window() {
    let Some(display) = Display::open() else { return };
    let line = format!("view --baked --workers 2 --refine 0 {CHEAP_BAKE}");
    let dense = [("WINIT_X11_SCALE_FACTOR", "2")];
    let mut view = View::of(&display, Foveal::new(&line).arg(scene("box")), "^foveal.-.Box", &dense);
    let (width, height) = (display.screen()[0].len(), display.screen().len());
    let columns_of = |shot: &Shot| shot.pixels.len() / (3 * height);
    let fills = |shot: &Shot| {
        let columns = columns_of(shot);
        shot.pixels.len() == 3 * columns * height && (620..=680).contains(&width.saturating_sub(columns))
    };
    view.until("a picture of the window's size", fills);
    let shot = view.converged();
    let (columns, screen) = (columns_of(&shot), display.screen());
    assert!(fills(&shot), "{columns} of {width}");
    // What differs lies under the pointer, if anything does.
    let is_shown = |left: usize| {
        let of = |i: usize| screen[i / columns][left + i % columns];
        let pixels = shot.pixels.chunks_exact(3).enumerate();
        let other = pixels.filter(|(i, p)| of(*i).iter().zip(*p).any(|(a, b)| a.abs_diff(*b) > 1)).count();
        other < 1000
    };
    assert!((0..=20).any(is_shown), "the picture is not on the screen");
    view.quit();
}

#[test]
fn the_walk_goes_on_while_a_scene_loads_and_light_is_baked() {
    let Some(display) = Display::open() else { return };
    let files = folder("scene");
    for file in fs::read_dir(root().join("scenes/box")).expect("the box").flatten() {
        fs::copy(file.path(), files.join(file.file_name())).expect("copied");
    }
    // Light that is never final in the time of this test.
    let bake = folder("bakes");
    let words = format!("--backend cpu --cache {} --particles 100000000 --error 0.01%", bake.display());
    let mut view = View::open_unlit(&display, &words, &files.join("box.toml"));
    let first = view.shot();
    view.act("keydown d sleep 0.4 keyup d sleep 0.2");
    let walked = view.until("light is baked", |s| s.camera("eye") != first.camera("eye"));
    assert!(!walked.fact("foveal view").ends_with("converged"), "light is not final");

    // A file that takes long to read: a wall of small triangles.
    let mut obj = fs::OpenOptions::new().append(true).open(files.join("box.obj")).expect("the geometry");
    let grain: String = (0..30_000)
        .map(|i| {
            let [x, y] = [-0.5 + 2e-3 * f64::from(i % 500), 0.2 + 2e-3 * f64::from(i / 500)];
            format!("v {x} {y} -0.8\nv {} {y} -0.8\nv {x} {} -0.8\nf -3 -2 -1\n", x + 1e-3, y + 1e-3)
        })
        .collect();
    obj.write_all(grain.as_bytes()).expect("written");
    drop(obj);
    view.act("key F5 sleep 0.5 keydown d sleep 0.4 keyup d sleep 0.2");
    view.until("a scene is loaded", |s| s.camera("eye") != walked.camera("eye"));
    view.until("it is loaded", |s| s.fact("foveal scene") != first.fact("foveal scene"));
    view.act("key 1 sleep 0.3");
    view.until("back in the new scene", |s| s.camera("eye") == first.camera("eye"));
    view.quit();
}

#[test]
fn the_window_follows_its_user_whoever_stalls() {
    let Some(display) = Display::open() else { return };
    for who in ["tracers", "illuminator", "all"] {
        let bakes = folder("bakes");
        let words = format!("--backend cpu --cache {} --stall {who}", bakes.display());
        let mut view = View::open_unlit(&display, &words, &scene("box"));
        let first = view.shot();
        view.act("keydown d sleep 0.4 keyup d sleep 0.2");
        let walked = view.until(who, |s| s.camera("eye") != first.camera("eye"));
        assert!(!walked.fact("foveal view").ends_with("converged"), "{who}: {:?}", walked.facts);
        view.act("mousedown 3 sleep 0.2 mousemove --window {} 150 110 sleep 0.2 mouseup 3 sleep 0.2");
        view.act("mousemove --window {} 100 100 sleep 0.1");
        view.until(who, |s| s.camera("target") != walked.camera("target"));
        if who == "all" {
            // Nobody adds anything: what the window shows is what was drawn for this camera, whole once it stands.
            view.act("sleep 1");
            let turned = view.shot();
            view.shows(&turned, who);
        }
        view.quit();
    }
}
