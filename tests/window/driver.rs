//! A virtual display, the program in a window on it, and a user's hands and eyes.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{BufRead, BufReader};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::support::{CHEAP_BAKE, Foveal, Running, folder};

/// However busy the machine.
pub const PATIENCE: Duration = Duration::from_secs(120);
/// Columns and rows of the picture. The panel stands to the right of it.
pub const SIZE: [usize; 2] = [320, 440];
/// Where the picture lies in the window.
pub const CORNER: [usize; 2] = [10, 0];

/// A display without a screen.
pub struct Display {
    server: Child,
    /// What DISPLAY is to be.
    pub name: String,
    folder: PathBuf,
}

impl Display {
    /// `None`, and why, where the tools are missing.
    pub fn open() -> Option<Self> {
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

    pub fn xdotool(&self, words: &str) -> String {
        let output = Command::new("xdotool")
            .args(words.split_whitespace())
            .env("DISPLAY", &self.name)
            .output()
            .expect("xdotool");
        String::from_utf8_lossy(&output.stdout).trim().to_owned()
    }

    /// What is on the screen: rows of RGB.
    pub fn screen(&self) -> Vec<Vec<[u8; 3]>> {
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

    pub fn has_adapter(&self) -> bool {
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
pub struct Shot {
    /// RGB in rows.
    pub pixels: Vec<u8>,
    /// Names and values.
    pub facts: BTreeMap<String, String>,
}

impl Shot {
    pub fn read(path: &Path) -> Option<Self> {
        let mut reader = png::Decoder::new(BufReader::new(File::open(path).ok()?)).read_info().ok()?;
        let mut pixels = vec![0; reader.output_buffer_size()?];
        reader.next_frame(&mut pixels).ok()?;
        reader.finish().ok()?;
        let text = &reader.info().utf8_text;
        let facts = text.iter().map(|t| (t.keyword.clone(), t.get_text().unwrap_or_default())).collect();
        Some(Self { pixels, facts })
    }

    pub fn fact(&self, name: &str) -> &str {
        self.facts.get(name).map_or("", String::as_str)
    }

    pub fn camera(&self, key: &str) -> String {
        let rest =
            self.fact("foveal camera").split(&format!("{key} = ")).nth(1).expect("a camera").to_owned();
        rest.split(']').next().expect("a vector").to_owned()
    }

    pub fn setting(&self, key: &str) -> Value {
        serde_json::from_str::<Value>(self.fact("foveal controls")).expect("JSON")[key].clone()
    }
}

/// The program with its window.
pub struct View<'d> {
    display: &'d Display,
    /// `None` once it has ended.
    running: Option<Running>,
    /// Its number.
    pub window: String,
    shots: PathBuf,
    count: usize,
}

impl<'d> View<'d> {
    pub fn open(display: &'d Display, words: &str, scene: &Path, environment: &[(&str, &str)]) -> Self {
        let [width, height] = SIZE;
        let line =
            format!("view --baked --size {width}x{height} --workers 2 --refine 0 {CHEAP_BAKE} {words}");
        Self::of(display, Foveal::new(&line).arg(scene), "^foveal.-.Box", environment)
    }

    /// With light that is baked while one walks.
    pub fn open_unlit(display: &'d Display, words: &str, scene: &Path) -> Self {
        let [width, height] = SIZE;
        let line = format!("view --size {width}x{height} --workers 2 --refine 0 {words}");
        Self::of(display, Foveal::new(&line).arg(scene), "^foveal.-.Box", &[])
    }

    pub fn of(display: &'d Display, line: Foveal, title: &str, environment: &[(&str, &str)]) -> Self {
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
    pub fn act(&self, words: &str) {
        self.display.xdotool(&words.replace("{}", &self.window));
    }

    /// Presses F12, again where there was no picture yet.
    pub fn shot(&mut self) -> Shot {
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

    /// Presses F12 until a screenshot is as it has to become.
    pub fn until(&mut self, what: &str, is_so: impl Fn(&Shot) -> bool) -> Shot {
        let start = Instant::now();
        loop {
            let shot = self.shot();
            if is_so(&shot) {
                return shot;
            }
            assert!(start.elapsed() < PATIENCE, "{what}: {:?}", shot.facts);
        }
    }

    /// Presses F12 until the view stands still and has converged.
    pub fn converged(&mut self) -> Shot {
        let start = Instant::now();
        let mut before = None;
        loop {
            std::thread::sleep(Duration::from_millis(300));
            let shot = self.shot();
            let rests = before.replace(shot.clone()) == Some(shot.clone());
            let stands = shot.fact("foveal at rest") != "false";
            if rests && stands && shot.fact("foveal view").ends_with("converged") {
                return shot;
            }
            assert!(start.elapsed() < PATIENCE, "never converged");
        }
    }

    /// Fails unless the window comes to show the screenshot's pixels.
    pub fn shows(&self, shot: &Shot, what: &str) {
        // The pointer would be on it.
        self.act("mousemove 1000 700 sleep 0.2");
        let start = Instant::now();
        while self.covered(shot) > 0 {
            assert!(start.elapsed() < PATIENCE, "{what}: {} pixels differ", self.covered(shot));
            std::thread::sleep(Duration::from_millis(50));
        }
        self.act("mousemove --window {} 100 100 sleep 0.1");
    }

    /// Whether anything but the screenshot's pixels is where the picture is: how many pixels of it.
    pub fn covered(&self, shot: &Shot) -> usize {
        let screen = self.display.screen();
        let of = |i: usize| screen[CORNER[1] + i / SIZE[0]][CORNER[0] + i % SIZE[0]];
        let pixels = shot.pixels.chunks_exact(3).enumerate();
        pixels.filter(|(i, p)| of(*i).iter().zip(*p).any(|(a, b)| a.abs_diff(*b) > 1)).count()
    }

    /// Whether something red is written on the panel, as errors are.
    pub fn complains(&self) -> bool {
        let screen = self.display.screen();
        let panel = screen.iter().take(120).flat_map(|row| &row[SIZE[0] + 30..SIZE[0] + 300]);
        panel.filter(|p| p[0] > 200 && p[1] < 40 && p[2] < 40).count() > 20
    }

    /// Ends the program. Returns what it told.
    pub fn quit(mut self) -> String {
        self.act("key ctrl+q");
        let running = self.running.take().expect("it runs");
        let ended = running.wait();
        assert_eq!(ended.code, Some(0), "{}", ended.err);
        assert!(!ended.err.contains("panicked") && !ended.err.contains("ERROR"), "{}", ended.err);
        ended.err
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
