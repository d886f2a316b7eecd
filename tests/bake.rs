//! Baking from the command line: going on after an interruption, limits, both methods, doubtful scenes.

use std::fs;
use std::path::PathBuf;
use std::process::Command;

use crate::support::{Foveal, Running, folder, scene};

/// A room of 4 × 3 × 4 with a square light of radiance `light` under its ceiling, walls of albedo `wall`.
fn room(wall: &str, light: &str, more: &str) -> PathBuf {
    let out = folder("room");
    let materials = format!("newmtl wall\nKd {wall}\nnewmtl lamp\nKd 0.5 0.5 0.5\nKe {light}\n");
    fs::write(out.join("room.mtl"), materials).expect("a file");
    let mut obj = String::from("mtllib room.mtl\n");
    for i in 0..8 {
        obj += &format!("v {} {} {}\n", 4 * (i & 1), 3 * (i >> 1 & 1), 4 * (i >> 2));
    }
    obj += "v 1.5 2.9 1.5\nv 2.5 2.9 1.5\nv 2.5 2.9 2.5\nv 1.5 2.9 2.5\nusemtl wall\n";
    // Inward: floor, ceiling, four walls.
    obj += "f 1 5 6 2\nf 3 4 8 7\nf 1 2 4 3\nf 5 7 8 6\nf 1 3 7 5\nf 2 6 8 4\nusemtl lamp\nf 9 10 11 12\n";
    fs::write(out.join("room.obj"), obj + more).expect("a file");
    let camera = "format = 1\n[geometry]\nfiles = [\"room.obj\"]\n[[camera]]\nname = \"main\"\neye = [2.0, 1.5, 0.5]\n\
                  target = [2.0, 1.4, 3.0]\nup = [0.0, 1.0, 0.0]\nfov_y = 50.0\n";
    fs::write(out.join("room.toml"), camera).expect("a file");
    out.join("room.toml")
}

fn grey_room() -> PathBuf {
    room("0.5 0.5 0.5", "4 4 4", "")
}

#[test]
fn a_bake_that_was_interrupted_goes_on_to_the_same_bits() {
    let out = folder("resumed");
    let bake = "bake --particles 400000 --error 0.01% --texels 4096 --json";
    let keep = |name: &str| out.join(name);
    Foveal::new(bake).arg("--out").arg(keep("whole")).arg(scene("box")).ok();
    let mut parts = 0;
    loop {
        let line = format!("{bake} --resume --time {}ms", 300 + 200 * parts);
        let d = Foveal::new(&line).arg("--out").arg(keep("parts")).arg(scene("box")).ok().json();
        // From the second part on there is something to go on with, unless the first had no time for anything.
        if !keep("parts").with_extension("fvstate").exists() {
            assert!(
                d["complete"] == false && d["error_reached"] == false,
                "the particles were all, not the error: {d}"
            );
            break;
        }
        parts += 1;
        assert!(parts < 100, "no progress: {d}");
    }
    let read = |name: &str| fs::read(keep(name)).expect("the bake");
    assert!(read("whole") == read("parts"), "after {parts} interruptions");
}

/// A scene in which nothing touches anything else, with no time at all: the direct light of some of its 300,000 elements
/// lights the others, indirect light is a first estimate, and the next one goes on.
#[test]
fn a_soup_of_triangles_is_baked_in_time() {
    let folder = folder("soup");
    let mut obj = String::from("mtllib soup.mtl\nusemtl wall\n");
    for i in 0..100_000u32 {
        let (x, y, z) = (i % 100, i / 100 % 25, i / 2500);
        obj += &format!("v {x} {y} {z}\nv {x}.6 {y} {z}.{}\nv {x} {y}.7 {z}.{}\nf -3 -2 -1\n", i % 9, i % 7);
    }
    obj += "usemtl lamp\nv 20 30 10\nv 60 30 10\nv 60 30 30\nv 20 30 30\nf -4 -3 -2 -1\n";
    fs::write(folder.join("soup.obj"), obj).expect("a file");
    let materials = "newmtl wall\nKd 0.5 0.5 0.5\nnewmtl lamp\nKd 0 0 0\nKe 9 9 9\n";
    fs::write(folder.join("soup.mtl"), materials).expect("a file");
    let (file, scene) = (folder.join("soup.fvbake"), folder.join("soup.obj"));
    let bake = || {
        let line = "bake --time 1ms --texels 4096 --resume --json --out";
        let d = Foveal::new(line).arg(&file).arg(&scene).ok().json();
        assert!(d["complete"] == false && d["has_indirect"] == true, "{d}");
        assert!(d["texels"].as_u64() > Some(200_000) && d["mean_irradiance"][1].as_f64() > Some(0.0), "{d}");
        let said = d["warnings"].to_string();
        let share = said.split("gathered at ").nth(1).and_then(|s| s.split(' ').next());
        let share: u32 = share.expect("what was done").parse().expect("a number");
        (share, d["particles"].as_u64().expect("a number"), d["resumed"] == true)
    };
    // What the start view shows is come to more than once before all else is; smoothing a round may be all that one of them
    // comes to, but not each.
    let [(first, paths, anew), (second, _, resumed), (third, more, _)] = std::array::from_fn(|_| bake());
    assert!(
        first > 0 && second >= first && third >= second && more > paths,
        "{first} {third}: {paths} {more}"
    );
    assert!(resumed && !anew);
    let walk =
        || Foveal::new("walk --frames 1 --size 32x24 --texels 4096 --bake").arg(&file).arg(&scene).ok();
    walk();
    #[cfg(unix)]
    {
        let line = "bake --texels 4096 --error 0.001% --resume --jsonl --out";
        let mut running = Foveal::new(line).arg(&file).arg(&scene).start();
        while !running.said().contains("\"gather\"") {
            assert!(running.is_running(), "{}", running.said());
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        interrupt(&running);
        let ended = running.wait();
        assert_eq!(ended.code, Some(130), "{}", ended.err);
        assert!(file.with_extension("fvstate").exists());
        walk();
    }
}

#[cfg(unix)]
fn interrupt(running: &Running) {
    let id = running.id().to_string();
    assert!(Command::new("kill").args(["-INT", &id]).status().expect("kill").success());
}

#[cfg(unix)]
#[test]
fn ctrl_c_keeps_a_valid_bake_and_the_way_on() {
    let out = folder("interrupted").join("box.fvbake");
    let line = "bake --particles 1000000000 --error 0.0001% --texels 4096 --jsonl --out";
    let mut running = Foveal::new(line).arg(&out).arg(scene("box")).start();
    let told = |line: &str| serde_json::from_str::<serde_json::Value>(line).ok();
    let traced = |said: String| {
        said.lines().filter_map(told).any(|d| d["particles"].as_u64().is_some_and(|n| n > 100_000))
    };
    while !traced(running.said()) {
        assert!(running.is_running(), "{}", running.said());
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    interrupt(&running);
    let ended = running.wait();
    assert_eq!(ended.code, Some(130), "{}", ended.err);
    assert!(ended.err.contains("--resume"), "{}", ended.err);
    assert!(ended.err.lines().filter_map(told).any(|d| d["eta_seconds"].is_number()), "{}", ended.err);
    for line in ended.err.lines().filter(|l| l.starts_with('{')) {
        let told: serde_json::Value = serde_json::from_str(line).expect("a line of JSON");
        assert_eq!(told["schema"], "foveal.bake.progress/1");
        assert!(told["stage"].is_string() && told["seconds"].is_number(), "{line}");
    }
    assert!(out.with_extension("fvstate").exists());
    Foveal::new("walk --frames 1 --size 32x24 --texels 4096 --bake").arg(&out).arg(scene("box")).ok();
    // A damaged state is not trusted: the bake begins anew.
    let state = out.with_extension("fvstate");
    let bytes = fs::read(&state).expect("the state");
    fs::write(&state, &bytes[..bytes.len() - 9]).expect("a shorter file");
    let again = "bake --particles 20000 --error 50% --texels 4096 --resume --json --out";
    let ended = Foveal::new(again).arg(&out).arg(scene("box")).ok();
    assert!(ended.err.contains("begins anew") && ended.json()["resumed"] == false, "{}", ended.err);
}

/// A bake is kept under a name of all that decides it, taken again, and made anew where it cannot be trusted.
#[test]
fn a_kept_bake_is_taken_again_unless_it_is_damaged() {
    let cache = folder("kept");
    let bake = |more: &str| {
        let line = format!("bake --particles 100000 --error 50% --texels 2048 {more} --json --cache");
        let ended = Foveal::new(&line).arg(&cache).arg(scene("box")).ok();
        (ended.json(), ended.err)
    };
    let (d, said) = bake("");
    assert!(d["cached"] == false && d["complete"] == true && said.is_empty(), "{d} {said}");
    let stages = d["stage_seconds"].as_object().expect("stages");
    for name in ["elements", "first", "gather", "smooth", "test"] {
        assert!(stages[name].as_f64() > Some(0.0), "{name}: {d}");
    }
    assert!(
        stages.values().filter_map(|s| s.as_f64()).sum::<f64>() <= d["seconds"].as_f64().expect("a number")
    );
    // So coarse a map hides what it is off by from itself; where it is seen that was measured.
    let (error, measured) = (d["error"].as_f64(), [0, 1].map(|i| d["error_measured"][i].as_f64()));
    assert!(measured[0] <= error && measured[0] < measured[1] && error < Some(1.0), "{d}");
    assert_eq!(d["error_reached"], error < Some(0.5), "{d}");
    let file = PathBuf::from(d["file"].as_str().expect("a file"));
    assert_eq!(bake("").0["cached"], true);
    let whole = fs::read(&file).expect("the bake");
    let mut of_another_version = whole.clone();
    of_another_version[8] ^= 1;
    let broken = [
        (of_another_version, "version"),
        (whole[..whole.len() / 2].to_vec(), "cut short"),
        (vec![], "cut short"),
    ];
    for (bytes, why) in broken {
        fs::write(&file, bytes).expect("a file");
        let (d, said) = bake("");
        assert!(d["cached"] == false && said.contains(why) && said.contains("anew"), "{why}: {d} {said}");
        assert!(fs::read(&file).expect("the bake") == whole);
    }
    for other in ["--bake-seed 2", "--everything"] {
        let (d, _) = bake(other);
        assert!(d["cached"] == false && d["file"] != file.display().to_string(), "{other}: {d}");
    }
    // A part does not stand where a whole one is looked for, and goes where that comes.
    let (part, _) = bake("--bake-seed 3 --time 1ms");
    let place = PathBuf::from(part["file"].as_str().expect("a file"));
    assert!(part["complete"] == false && place.display().to_string().ends_with(".partial.fvbake"), "{part}");
    let (d, _) = bake("--bake-seed 3 --resume");
    assert!(d["cached"] == false && d["complete"] == true && d["resumed"] == true, "{d}");
    assert!(!place.exists() && place.display().to_string().starts_with(&cache.display().to_string()));
}

#[test]
fn radiosity_is_simplified_to_so_many_elements() {
    let room = grey_room();
    let bake = |more: &str| {
        let out = folder("radiosity").join("room.fvbake");
        let line = format!("bake --texels 2048 --error 10% --method radiosity {more} --json --out");
        let d = Foveal::new(&line).arg(&out).arg(&room).ok().json();
        assert_eq!(d["method"], "radiosity");
        assert!(d["triangles_after"].as_u64() < d["triangles_before"].as_u64(), "{d}");
        let walk = "walk --frames 1 --size 32x24 --texels 2048 --bake";
        Foveal::new(walk).arg(&out).arg(&room).ok();
        (d, fs::read(&out).expect("the bake"))
    };
    let (whole, _) = bake("");
    assert!(whole["error"].as_f64().expect("a number") <= 0.1 && whole["has_indirect"] == true);
    // Particles find the same light.
    let line = "bake --texels 2048 --error 3% --particles 300000 --out";
    let by_particles = Foveal::new(line).arg(folder("p").join("p")).arg(&room).json();
    let mean = |d: &serde_json::Value| d["mean_irradiance"][1].as_f64().expect("a number");
    assert!((mean(&whole) / mean(&by_particles) - 1.0).abs() < 0.05, "{whole} {by_particles}");
    let mut bytes = Vec::new();
    for criterion in ["photometric", "perceptual", "optimal"] {
        let (d, bake) = bake(&format!("--elements 200 --criterion {criterion}"));
        assert_eq!(d["elements"], 200, "{criterion}: {d}");
        assert!(d["elements_before"].as_u64() >= Some(200), "{d}");
        bytes.push(bake);
    }
    assert!(bytes[0] != bytes[1] && bytes[1] != bytes[2], "criteria differ in what they keep");
}

#[test]
fn a_memory_limit_makes_texels_coarser_and_says_so() {
    let bake = |limit: &str| {
        let line =
            format!("bake --particles 20000 --error 50% --texels 65536 --max-memory {limit} --json --out");
        Foveal::new(&line).arg(folder("small").join("box")).arg(scene("box"))
    };
    let d = bake("16MiB").ok().json();
    let said = d["warnings"].to_string();
    assert!(said.contains("coarser") && said.contains("16 MiB"), "{said}");
    assert!(d["texels"].as_u64().expect("a number") < 65536 * 3 / 4, "{d}");
    bake("64KiB").fails(4, &["--max-memory"]);
}

#[test]
fn doubtful_scenes_are_baked_with_a_warning() {
    let bake = |file: PathBuf| {
        let line = "bake --texels 2048 --particles 50000 --error 5% --out";
        Foveal::new(line).arg(folder("doubtful").join("bake")).arg(file).ok()
    };
    let white = bake(room("1 1 1", "4 4 4", ""));
    assert!(white.err.contains("\"wall\"") && white.err.contains("0.99"), "{}", white.err);
    // A light without area, one of negative power, an edge of three triangles, a sheet seen from both sides.
    let more = "v 1 1 1\nv 3 1 1\nf 13 14 13\nv 2 1 2\nv 2 2 2\nv 1 2 2\nusemtl wall\nf 13 14 15\nf 13 14 16\nf 14 13 17\n";
    let odd = bake(room("0.5 0.5 0.5", "4 4 4", more));
    assert!(odd.err.contains("without area"), "{}", odd.err);
    let negative = bake(room("0.5 0.5 0.5", "-4 -4 -4", ""));
    assert!(negative.err.contains("negative; left out"), "{}", negative.err);
    let black = bake(room("0 0 0", "4 4 4", ""));
    assert!(black.out.contains("no indirect light"), "{}", black.out);
}
