//! A real window on a virtual display: keys, drags and sliders, what is on the screen, and its end.
//!
//! Skipped, with the reason on the standard error, where Xvfb, xdotool or a graphics adapter is missing.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{BufRead, BufReader};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::support::{CHEAP_BAKE, Foveal, Running, folder, root, scene};

/// However busy the machine.
const PATIENCE: Duration = Duration::from_secs(120);
/// Columns and rows of the picture. The panel stands to the right of it.
const SIZE: [usize; 2] = [320, 440];
/// Where the picture lies in the window.
const CORNER: [usize; 2] = [10, 0];

/// A display without a screen.
struct Display {
    server: Child,
    name: String,
    folder: PathBuf,
}

impl Display {
    /// `None`, and why, where the tools are missing.
    fn open() -> Option<Self> {
        let has = |tool: &str| {
            Command::new("sh")
                .args(["-c", &format!("command -v {tool}")])
                .output()
                .is_ok_and(|o| o.status.success())
        };
        if let Some(tool) = ["Xvfb", "xdotool"].into_iter().find(|tool| !has(tool)) {
            eprintln!("skipped: no {tool}; on Debian `apt-get install xvfb xdotool`");
            return None;
        }
        let folder = folder("display");
        fs::set_permissions(&folder, fs::Permissions::from_mode(0o700)).expect("permissions");
        let mut server = Command::new("Xvfb")
            .args([
                "-displayfd",
                "1",
                "-screen",
                "0",
                "1024x768x24",
                "-nolisten",
                "tcp",
                "-noreset",
                "-fbdir",
            ])
            .arg(&folder)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("Xvfb");
        let mut line = String::new();
        BufReader::new(server.stdout.take().expect("a pipe")).read_line(&mut line).expect("its number");
        if line.trim().is_empty() {
            let _ = server.wait();
            eprintln!("skipped: Xvfb does not start");
            return None;
        }
        Some(Self { server, name: format!(":{}", line.trim()), folder })
    }

    fn xdotool(&self, words: &str) -> String {
        let output = Command::new("xdotool")
            .args(words.split_whitespace())
            .env("DISPLAY", &self.name)
            .output()
            .expect("xdotool");
        String::from_utf8_lossy(&output.stdout).trim().to_owned()
    }

    /// What is on the screen: rows of RGB.
    fn screen(&self) -> Vec<Vec<[u8; 3]>> {
        let bytes = fs::read(self.folder.join("Xvfb_screen0")).expect("the screen");
        let word =
            |i: usize| u32::from_be_bytes(bytes[4 * i..][..4].try_into().expect("four bytes")) as usize;
        // The header of the X window dump format.
        let [header, width, height, order, bits, pitch, colors] = [0, 4, 5, 7, 11, 12, 19].map(word);
        assert_eq!((order, bits), (0, 32), "little-endian words");
        let pixels = &bytes[header + 12 * colors..];
        let row =
            |y: usize| (0..width).map(|x| &pixels[y * pitch + 4 * x..]).map(|p| [p[2], p[1], p[0]]).collect();
        (0..height).map(row).collect()
    }

    fn has_adapter(&self) -> bool {
        let found = Foveal::new("doctor").json()["adapter"].is_object();
        if !found {
            eprintln!(
                "skipped: no graphics adapter; on Debian `apt-get install mesa-vulkan-drivers libvulkan1`"
            );
        }
        found
    }
}

impl Drop for Display {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

/// A screenshot that the window wrote.
#[derive(Clone, Debug, PartialEq)]
struct Shot {
    pixels: Vec<u8>,
    facts: BTreeMap<String, String>,
}

impl Shot {
    fn read(path: &Path) -> Option<Self> {
        let mut reader = png::Decoder::new(BufReader::new(File::open(path).ok()?)).read_info().ok()?;
        let mut pixels = vec![0; reader.output_buffer_size()?];
        reader.next_frame(&mut pixels).ok()?;
        reader.finish().ok()?;
        let text = &reader.info().utf8_text;
        let facts = text.iter().map(|t| (t.keyword.clone(), t.get_text().unwrap_or_default())).collect();
        Some(Self { pixels, facts })
    }

    fn fact(&self, name: &str) -> &str {
        self.facts.get(name).map_or("", String::as_str)
    }

    fn camera(&self, key: &str) -> String {
        let rest =
            self.fact("foveal camera").split(&format!("{key} = ")).nth(1).expect("a camera").to_owned();
        rest.split(']').next().expect("a vector").to_owned()
    }

    fn setting(&self, key: &str) -> Value {
        serde_json::from_str::<Value>(self.fact("foveal controls")).expect("JSON")[key].clone()
    }
}

/// The program with its window.
struct View<'d> {
    display: &'d Display,
    /// `None` once it has ended.
    running: Option<Running>,
    window: String,
    shots: PathBuf,
    count: usize,
}

impl<'d> View<'d> {
    fn open(display: &'d Display, words: &str, scene: &Path, environment: &[(&str, &str)]) -> Self {
        let [width, height] = SIZE;
        let line =
            format!("view --baked --size {width}x{height} --workers 2 --refine 0 {CHEAP_BAKE} {words}");
        Self::of(display, Foveal::new(&line).arg(scene), "^foveal.-.Box", environment)
    }

    fn of(display: &'d Display, line: Foveal, title: &str, environment: &[(&str, &str)]) -> Self {
        let shots = folder("shots");
        let mut line = line
            .arg("--screenshots")
            .arg(&shots)
            .env("DISPLAY", &display.name)
            .env("XDG_RUNTIME_DIR", &display.folder)
            .without("WAYLAND_DISPLAY");
        for (name, value) in environment {
            line = line.env(name, value);
        }
        let mut running = line.start();
        // The title is the scene's once it is there.
        let start = Instant::now();
        let window = loop {
            let found = display.xdotool(&format!("search --onlyvisible --name {title}"));
            if let Some(window) = found.lines().next() {
                break window.to_owned();
            }
            if !running.is_running() {
                panic!("{}", running.wait().err);
            }
            assert!(start.elapsed() < PATIENCE, "no window");
            std::thread::sleep(Duration::from_millis(50));
        };
        let view = Self { display, running: Some(running), window, shots, count: 0 };
        view.act("windowmove {} 0 0 windowfocus {} mousemove --window {} 100 100 sleep 0.2");
        view
    }

    /// Commands of xdotool; `{}` is the window.
    fn act(&self, words: &str) {
        self.display.xdotool(&words.replace("{}", &self.window));
    }

    /// Presses F12, again where there was no picture yet.
    fn shot(&mut self) -> Shot {
        let start = Instant::now();
        let file = |number: usize| self.shots.join(format!("foveal-{number}.png"));
        let first = self.count + 1;
        while start.elapsed() < PATIENCE {
            self.act("key F12");
            let pressed = Instant::now();
            while pressed.elapsed() < Duration::from_secs(2) {
                if let Some(shot) = Shot::read(&file(first)) {
                    // A press that came late may leave one more.
                    self.count =
                        (first..).take_while(|number| file(*number).exists()).last().unwrap_or(first);
                    return shot;
                }
                std::thread::sleep(Duration::from_millis(20));
            }
        }
        panic!("no screenshot {}", file(first).display());
    }

    /// Presses F12 until the view stands still and has converged.
    fn converged(&mut self) -> Shot {
        let start = Instant::now();
        let mut before = None;
        loop {
            std::thread::sleep(Duration::from_millis(300));
            let shot = self.shot();
            let rests = before.replace(shot.clone()) == Some(shot.clone());
            if rests && shot.fact("foveal view").ends_with("converged") {
                return shot;
            }
            assert!(start.elapsed() < PATIENCE, "never converged");
        }
    }

    /// Fails unless the window comes to show the screenshot's pixels.
    fn shows(&self, shot: &Shot, what: &str) {
        // The pointer would be on it.
        self.act("mousemove 1000 700 sleep 0.2");
        let differing = || {
            let screen = self.display.screen();
            let of = |i: usize| screen[CORNER[1] + i / SIZE[0]][CORNER[0] + i % SIZE[0]];
            let pixels = shot.pixels.chunks_exact(3).enumerate();
            pixels.filter(|(i, p)| of(*i).iter().zip(*p).any(|(a, b)| a.abs_diff(*b) > 1)).count()
        };
        let start = Instant::now();
        while differing() > 0 {
            assert!(start.elapsed() < PATIENCE, "{what}: {} pixels differ", differing());
            std::thread::sleep(Duration::from_millis(50));
        }
        self.act("mousemove --window {} 100 100 sleep 0.1");
    }

    /// Whether something red is written on the panel, as errors are.
    fn complains(&self) -> bool {
        let screen = self.display.screen();
        let panel = screen.iter().take(120).flat_map(|row| &row[SIZE[0] + 30..SIZE[0] + 300]);
        panel.filter(|p| p[0] > 200 && p[1] < 40 && p[2] < 40).count() > 20
    }

    fn quit(mut self) {
        self.act("key ctrl+q");
        let Some(running) = self.running.take() else { return };
        let ended = running.wait();
        assert_eq!(ended.code, Some(0), "{}", ended.err);
        assert!(!ended.err.contains("panicked") && !ended.err.contains("ERROR"), "{}", ended.err);
    }
}

impl Drop for View<'_> {
    /// Where a test has failed.
    fn drop(&mut self) {
        if let Some(running) = self.running.take() {
            running.kill();
        }
    }
}

/// Where the handle of the topmost slider is on the screen.
fn first_slider(screen: &[Vec<[u8; 3]>]) -> [usize; 2] {
    // Rails are grey and 100 points long, with a handle that has a bright rim.
    let left = CORNER[0] + SIZE[0] + 8;
    // (A line between two groups is as grey, and longer.)
    let grey =
        |y: usize, from: usize, to: usize| screen[y][from..to].iter().filter(|p| **p == [60; 3]).count();
    let rail = |y: &usize| grey(*y, left, left + 114) > 90 && grey(*y, left + 114, left + 125) == 0;
    let y = (0..SIZE[1]).find(rail).expect("a slider") + 4;
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
    let out = folder("headless").join("still.png");
    let [width, height] = SIZE;
    Foveal::new(&format!("view --headless --size {width}x{height} --workers 2 {CHEAP_BAKE} --out"))
        .arg(&out)
        .arg(scene("box"))
        .ok();
    assert!(Shot::read(&out).is_some_and(|still| still.pixels == first.pixels), "not the corrected picture");

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

    // The first slider on the panel: frames per second.
    let screen = display.screen();
    let [x, y] = first_slider(&screen);
    let drag: String =
        (1..=4).map(|i| format!("mousemove --window {{}} {} {y} sleep 0.15 ", x + 6 * i)).collect();
    view.act(&format!(
        "mousemove --window {{}} {x} {y} sleep 0.2 mousedown 1 sleep 0.2 {drag} mouseup 1 sleep 0.2"
    ));
    let set = view.converged();
    let fps = |shot: &Shot| shot.setting("fps").as_f64().expect("a number");
    assert!(fps(&set) > fps(&first) + 1.0, "{} after {}", fps(&set), fps(&first));
    assert_eq!(set.pixels, first.pixels);

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

#[test]
fn without_an_adapter_the_processor_paints_the_same() {
    let Some(display) = Display::open() else { return };
    let nowhere = [("VK_DRIVER_FILES", "/nonexistent"), ("VK_ICD_FILENAMES", "/nonexistent")];
    let mut view = View::open(&display, "--backend auto", &scene("box"), &nowhere);
    let shot = view.converged();
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
    view.act("key b sleep 0.5");
    let walked = view.converged();
    assert!(walked.fact("foveal camera").starts_with("eye"), "{:?}", walked.facts);
    view.quit();
}
