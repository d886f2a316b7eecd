//! Files made to break readers: a picture, or exit code 3 and a message that names the file.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use crate::support::{Foveal, folder, root};

/// Scene files in a folder and below, in the order of their names.
fn scene_files(folder: &Path, found: &mut Vec<PathBuf>) {
    let mut entries: Vec<PathBuf> =
        fs::read_dir(folder).expect("a folder").flatten().map(|e| e.path()).collect();
    entries.sort_unstable();
    for entry in entries {
        if entry.is_dir() {
            scene_files(&entry, found);
        } else if entry.extension().is_some_and(|e| e == "obj" || e == "toml") {
            found.push(entry);
        }
    }
}

fn check(folder: &str, least: usize) {
    let folder = root().join("../shared/scenes/plain").join(folder);
    if !folder.exists() {
        eprintln!("skipped: there is no {} beside the checkout", folder.display());
        return;
    }
    let mut files = Vec::new();
    scene_files(&folder, &mut files);
    assert!(files.len() >= least, "{} holds {} scene files", folder.display(), files.len());
    for file in files {
        let walk = "walk --frames 1 --size 48x32 --fps 50 --particles 2000 --error 50% --texels 1024 --json";
        let ended = Foveal::new(walk).arg(&file).run();
        let stem = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let what = format!("{}: exit {:?}\n{}", file.display(), ended.code, ended.err);
        assert!(!ended.err.contains("panicked"), "{what}");
        // What texture-escapes asks for.
        assert!(!(ended.out + &ended.err).contains("root:x:"), "{what}");
        assert!(ended.code == Some(0) || ended.code == Some(3) && ended.err.contains(&stem), "{what}");
    }
}

#[test]
fn collected_files() {
    check("hostile", 20);
}

#[test]
fn hand_made_files() {
    check("hostile-made", 20);
}

/// What the program makes of 202 odd and broken glTF files of other people's tests: each ends within a second, as
/// `verdicts.txt` says, without a panic, what is refused in one line that names the file. (What
/// each verdict is and why, and what is drawn, is tested where files are read: `foveal_files::load::gltf::verdict_tests`.)
#[test]
fn odd_gltf_files_end_as_their_verdicts_say() {
    let archive = root().join("../shared/scenes/hostile-A.tar.xz");
    if !archive.is_file() {
        eprintln!("skipped: there is no {}", archive.display());
        return;
    }
    let folder = folder("verdicts");
    let unpacked = Command::new("tar").arg("-xJf").arg(&archive).arg("-C").arg(&folder).status();
    if !unpacked.is_ok_and(|status| status.success()) {
        eprintln!("skipped: tar cannot unpack {}", archive.display());
        return;
    }
    let verdicts = fs::read_to_string(root().join("actors/files/load/gltf/verdicts.txt")).expect("verdicts");
    let mut wrong = Vec::new();
    for line in verdicts.lines() {
        let (verdict, name) = line.split_once(' ').expect("an end and a name");
        let file = folder.join("hostile-A").join(name);
        let explain = |took: &mut Duration| {
            let start = Instant::now();
            let ended = Foveal::new("explain").arg(&file).run();
            *took = start.elapsed();
            ended
        };
        let mut took = Duration::ZERO;
        let ended = explain(&mut took);
        if took > Duration::from_secs(1) {
            // Something else may have been in the way.
            explain(&mut took);
        }
        let lines: Vec<&str> = ended.err.lines().collect();
        let as_written = match verdict {
            // What was odd before the end is told, too; the end itself is one line.
            "refused" => {
                let errors = lines.iter().filter(|line| line.starts_with("foveal: ")).count();
                ended.code == Some(3) && errors == 1 && lines.last().is_some_and(|l| l.contains(name))
            }
            _ => ended.code == Some(0) && ended.out.contains("triangles"),
        };
        let is_clear = lines.iter().all(|line| line.len() < 400) && !ended.err.contains("panicked");
        if !as_written || !is_clear || took > Duration::from_secs(1) {
            wrong.push(format!("{verdict} {name}: {:?} after {took:?}\n{}", ended.code, ended.err));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert_eq!(verdicts.lines().count(), 202);
}

/// A document that draws nothing is none that is wrong: every command shows its sky, and says why there is nothing else.
#[test]
fn a_document_without_triangles_shows_the_sky() {
    let folder = folder("empty-gltf");
    let file = folder.join("empty.gltf");
    fs::write(&file, "{\"asset\": {\"version\": \"2.0\"}, \"nodes\": [{}]}").expect("a file");
    for words in
        ["explain", "walk --frames 2 --size 48x32", "bake", "reference --size 48x32 --spp 2 --out empty.png"]
    {
        let words = words.replace("empty.png", &folder.join("empty.png").display().to_string());
        let ended = Foveal::new(&words).arg(&file).ok();
        assert!(ended.err.contains("no triangle"), "{words}: {}", ended.err);
    }
    let broken = folder.join("broken.gltf");
    let text = r#"{"asset": {"version": "2.0"}, "bufferViews": [{"buffer": 0, "byteLength": 8}], "buffers": [{"byteLength": 8}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "SCALAR"}]}"#;
    fs::write(&broken, text).expect("a file");
    Foveal::new("explain").arg(&broken).fails(3, &["broken.gltf", "/accessors/0", "leave the view"]);
}
