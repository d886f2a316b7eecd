//! What goes wrong while a walk goes on: panics and stalls of tracers, disks that are full, files that are cut, a killed
//! program.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use foveal::illumination::Irradiance;
use foveal::world::World;
use foveal_actors::renderer::Renderer;
use foveal_actors::settings::Settings;
use foveal_engine::reference::traced_picture;
use foveal_files::load::load;
use glam::Vec3;

use crate::support::{CHEAP_BAKE, Foveal, assert_same_bits, folder, scene};
use crate::system::System;

/// Illumination over which a tracer stumbles now and then.
struct Stumbling {
    asked: AtomicU64,
    /// At every so many questions.
    every: u64,
    /// Hangs instead of panicking.
    hangs: bool,
}

impl Irradiance for Stumbling {
    fn irradiance(&self, triangle: u32, b1: f32, _: f32, _: bool) -> Vec3 {
        // The display asks from other threads.
        if std::thread::current().name().is_some_and(|name| name.starts_with("actors-"))
            && self.asked.fetch_add(1, Ordering::Relaxed) % self.every == self.every - 1
        {
            assert!(self.hangs, "a fault that was ordered");
            std::thread::sleep(Duration::from_millis(30));
        }
        Vec3::new(1.0, 0.5 + b1, (triangle % 3) as f32)
    }
}

/// Walks a few frames and stays until all is traced; returns how many incidents the allocator heard of.
fn stumble(every: u64, hangs: bool) -> usize {
    let scene = Arc::new(load(&scene("box")).unwrap_or_else(|e| panic!("{e}")).scene);
    let illumination = Arc::new(Stumbling { asked: AtomicU64::new(0), every, hangs });
    let world = World::new(scene, illumination);
    // Small jobs, so that few samples are traced again.
    let settings = Settings { samples_per_job: 64, ..Settings::new(64, 48, 3) };
    let mut system = System::start(&world, settings);
    for _ in 0..3 {
        system.camera.eye.x += 0.01;
        system.frame(|_| true);
    }
    system.converge();
    let shown = system.engine.look(Renderer::picture).flatten().expect("a picture");
    let frame = system.camera.frame(64, 48);
    assert_same_bits(&shown, &traced_picture(&world, &frame, 0, 1, &|| true).picture, "after faults");
    let (lost, incidents) = system.stop_and(|a| (a.lost_jobs(), a.incidents().len())).expect("an allocator");
    assert_eq!(lost, 0);
    incidents
}

/// A job that kills its tracer is done by the next; the picture is the reference all the same.
#[test]
fn tracers_that_panic_lose_nothing() {
    assert!(stumble(1500, false) > 0, "nobody heard of a panic");
}

#[test]
fn tracers_that_hang_lose_nothing() {
    assert_eq!(stumble(700, true), 0);
}

/// Runs the program where no file grows beyond so many blocks of 512 bytes: what it meets is a full disk's error.
#[cfg(unix)]
fn on_a_small_disk(blocks: u32, words: &str, rest: &[&Path]) -> (Option<i32>, String) {
    let program = env!("CARGO_BIN_EXE_foveal");
    let mut line = format!("trap '' XFSZ; ulimit -f {blocks}; exec '{program}' {words}");
    for path in rest {
        line += &format!(" '{}'", path.display());
    }
    let output = std::process::Command::new("sh")
        .args(["-c", &line])
        .env("FOVEAL_CACHE", folder("small-disk"))
        .env("NO_COLOR", "1")
        .output()
        .expect("a shell");
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

/// Files of a folder and below.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        if entry.path().is_dir() {
            found.extend(files(&entry.path()));
        } else {
            found.push(entry.path());
        }
    }
    found.sort_unstable();
    found
}

/// No file that is there under its name is a part of itself.
fn assert_whole_pictures(folder: &Path) -> usize {
    let mut whole = 0;
    for file in files(folder).iter().filter(|f| f.extension().is_some_and(|e| e == "png")) {
        image::open(file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        whole += 1;
    }
    whole
}

#[cfg(unix)]
#[test]
fn full_disks_are_said_and_leave_no_parts() {
    let out = folder("full");
    // Too small for a picture in floating point.
    let walk = "walk --quick --frames 3 --fps 30 --size 64x48 --out";
    let (code, told) = on_a_small_disk(2, walk, &[&out, &scene("box")]);
    assert!(matches!(code, Some(1..=5)) && told.contains("cannot be written"), "{code:?} {told}");
    assert!(!told.contains("panicked"), "{told}");
    assert_whole_pictures(&out);
    assert!(!out.join("last.exr").exists());
    // A cache without room: said, and the walk goes on.
    let walk = format!("walk --baked --frames 2 --fps 30 --size 64x48 {CHEAP_BAKE}");
    let (code, told) = on_a_small_disk(8, &walk, &[&scene("box")]);
    assert!(code == Some(0) && !told.contains("panicked"), "{code:?} {told}");
    assert!(told.contains("kept"), "that the bake is not kept is said: {told}");
    // A recording without room ends early, and what is there can be read.
    let trace = folder("full").join("walk.fvl");
    let walk = "walk --quick --frames 30 --fps 100 --size 64x48";
    let (code, told) = on_a_small_disk(4, walk, &[&scene("box"), Path::new("--record"), &trace]);
    assert!(code == Some(0) && !told.contains("panicked"), "{code:?} {told}");
    assert!(told.contains("recording"), "{told}");
    let (code, told) = on_a_small_disk(1 << 20, "log stat", &[&trace]);
    assert!(matches!(code, Some(0 | 1 | 3)) && !told.contains("panicked"), "{code:?} {told}");
    // Somebody asked for this file.
    let (code, told) =
        on_a_small_disk(2, &format!("bake {CHEAP_BAKE} --out"), &[&out.join("b"), &scene("box")]);
    assert!(matches!(code, Some(1..=5)) && !told.contains("panicked"), "{code:?} {told}");
    assert!(!out.join("b").exists());
}

#[test]
fn places_where_nothing_can_be_written() {
    let file = folder("closed").join("file");
    fs::write(&file, "no folder").expect("a file");
    let nowhere = file.join("below");
    for words in ["walk --quick --frames 1 --size 32x24 --out", "reference --size 32x24 --quick --out"] {
        Foveal::new(words).arg(&nowhere).arg(scene("box")).fails(3, &["below"]);
    }
    // What would only save time next time is said and left out.
    let ended = Foveal::new(&format!("walk --baked --frames 1 --size 32x24 {CHEAP_BAKE} --cache"))
        .arg(&nowhere)
        .arg(scene("box"))
        .ok();
    assert!(ended.err.contains("below"), "{}", ended.err);
}

type Damage = fn(&mut Vec<u8>);

/// Whatever is wrong with what a cache keeps, it is baked again, to the same bytes.
#[test]
fn broken_caches_are_baked_again() {
    let cache = folder("cache");
    let bake = || {
        let line = format!("bake {CHEAP_BAKE} --cache");
        let d = Foveal::new(&line).arg(&cache).arg(scene("diffuse")).json();
        let file = d["file"].as_str().expect("a file");
        (d["cached"].as_bool().expect("a bool"), fs::read(file).expect("the bake"))
    };
    let (cached, good) = bake();
    assert!(!cached && bake() == (true, good.clone()));
    let breaks: [(&str, Damage); 5] = [
        ("cut", |b| b.truncate(b.len() * 2 / 3)),
        ("empty", Vec::clear),
        ("another thing", |b| *b = b"not a bake".repeat(1000)),
        ("a bit flipped in the middle", |b| {
            let middle = b.len() / 2;
            b[middle] ^= 4;
        }),
        ("a bit flipped at the end", |b| {
            let last = b.len() - 1;
            b[last] ^= 1;
        }),
    ];
    for (what, damage) in breaks {
        let kept = files(&cache);
        assert!(!kept.is_empty());
        for file in kept {
            let mut bytes = fs::read(&file).expect("a kept bake");
            damage(&mut bytes);
            fs::write(&file, bytes).expect("a kept bake");
        }
        let (cached, again) = bake();
        assert!(!cached && again == good, "{what}");
        assert!(bake().0, "{what}: the new bake is kept");
    }
}

/// Pictures that are none are left out, and said; of one that is cut its decoder may show what there is.
#[test]
fn broken_textures_are_left_out() {
    let broken = folder("gallery");
    let mut pictures = 0usize;
    for file in files(scene("gallery").parent().expect("a folder")) {
        let mut bytes = fs::read(&file).expect("a file");
        if file.extension().is_some_and(|e| e == "png" || e == "jpg") {
            match pictures % 3 {
                0 => bytes.truncate(bytes.len() / 2),
                1 => bytes.clear(),
                _ => bytes = b"PNG".repeat(100),
            }
            pictures += 1;
        }
        fs::write(broken.join(file.file_name().expect("a name")), bytes).expect("a copy");
    }
    assert!(pictures > 2);
    let d = Foveal::new("walk --quick --frames 1 --size 32x24").arg(broken.join("gallery.toml")).json();
    let warnings = d["warnings"].as_array().expect("warnings");
    assert!(warnings.len() >= pictures - pictures.div_ceil(3), "{pictures} pictures, {warnings:?}");
}

/// Killed at any moment, the program leaves whole files or none.
#[cfg(unix)]
#[test]
fn a_killed_program_leaves_whole_files() {
    let (cache, out) = (folder("killed-cache"), folder("killed"));
    let trace = out.join("walk.fvl");
    let mut pictures = 0usize;
    for (i, delay) in [60, 120, 200, 300].into_iter().enumerate() {
        let folder = out.join(format!("{i}"));
        let mut running = Foveal::new("walk --quick --frames 100000 --fps 200 --size 200x150 --record")
            .arg(&trace)
            .arg("--out")
            .arg(&folder)
            .arg(scene("box"))
            .start();
        while !folder.join("frame-0001.png").exists() && running.is_running() {
            std::thread::sleep(Duration::from_millis(5));
        }
        std::thread::sleep(Duration::from_millis(delay));
        assert_eq!(running.kill().code, None, "it ended by itself");
        pictures += assert_whole_pictures(&folder);
        // What is left of the recording replays.
        let cut = out.join("cut.fvl");
        let ended = Foveal::new("log cut").arg(&trace).arg("--out").arg(&cut).run();
        let file = if ended.code == Some(0) { &cut } else { &trace };
        let ended = Foveal::new("replay --verify --json").arg(file).run();
        assert!(ended.code == Some(0) && !ended.err.contains("panicked"), "{:?} {}", ended.code, ended.err);
    }
    assert!(pictures >= 8);
    // During bakes: what is kept of them is used or made again, and the result is the same.
    let bake = || Foveal::new("bake --particles 300000 --error 0.1% --texels 8192 --cache").arg(&cache);
    for delay in [30, 150, 400, 800] {
        let running = bake().arg(scene("box")).start();
        std::thread::sleep(Duration::from_millis(delay));
        running.kill();
    }
    let bytes = |cache: &Path, name: &str| {
        let file = out.join(name);
        let line = "bake --particles 300000 --error 0.1% --texels 8192 --cache";
        Foveal::new(line).arg(cache).arg("--out").arg(&file).arg(scene("box")).ok();
        fs::read(file).expect("the bake")
    };
    assert!(bytes(&cache, "a") == bytes(&folder("fresh-cache"), "b"), "a bake after kills is another");
}
