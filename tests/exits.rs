//! Exit codes that other programs rely on, and the messages beside them.

use std::fs;

use crate::support::{CHEAP_BAKE, Foveal, folder, scene};

#[test]
fn help_and_version_succeed() {
    let help = Foveal::new("--help").ok();
    for command in ["walk", "bake", "reference", "compare", "explain", "doctor"] {
        assert!(help.out.lines().any(|l| l.trim_start().starts_with(command)), "{command}: {}", help.out);
        assert!(Foveal::new(command).arg("--help").ok().out.contains("Usage: foveal"));
    }
    assert_eq!(Foveal::new("--version").ok().out, concat!("foveal ", env!("CARGO_PKG_VERSION"), "\n"));
}

#[test]
fn wrong_command_lines_end_with_2() {
    for (words, told) in [
        ("", "Usage"),
        ("stroll", "stroll"),
        ("walk", "SCENE"),
        ("walk a.obj --no-such-flag", "--no-such-flag"),
        ("walk a.obj --size 0x48", "0x48"),
        ("walk a.obj --size 64", "64"),
        ("walk a.obj --frames 0", "--frames"),
        ("walk a.obj --workers 0", "--workers"),
        ("walk a.obj --policy best", "attention"),
        ("walk a.obj --saliency 2", "0 to 1"),
        ("walk a.obj --fps nan", "--fps"),
        ("walk a.obj --camera main --path tour", "--camera"),
        ("walk a.obj --quick --bake b", "--bake"),
        ("reference a.obj", "--out"),
        ("bake a.obj --time soon", "16ms"),
        ("compare a.png", "REFERENCE"),
    ] {
        Foveal::new(words).fails(2, &[told]);
    }
    let quick = "walk --quick --size 32x24 --frames 1";
    Foveal::new(quick).arg("--camera").arg("nowhere").arg(scene("box")).fails(2, &["nowhere", "mirror-ball"]);
    Foveal::new(quick).arg("--path").arg("nowhere").arg(scene("box")).fails(2, &["nowhere", "tour"]);
}

#[test]
fn unusable_files_end_with_3() {
    let folder = folder("unusable");
    let write = |name: &str, text: &str| {
        let path = folder.join(name);
        fs::write(&path, text).expect("a file");
        path
    };
    for command in ["walk --json", "bake", "explain", "reference --out never.exr"] {
        Foveal::new(command).arg("no-such-file.obj").fails(3, &["no-such-file.obj"]);
    }
    let unknown = write("unknown.toml", "format = 1\n\n[geometry]\nfiels = [\"a.obj\"]\n");
    Foveal::new("explain").arg(&unknown).fails(3, &["unknown.toml", "4", "fiels", "files"]);
    let missing = write("missing.toml", "format = 1\n[geometry]\nfiles = [\"not-there.obj\"]\n");
    Foveal::new("explain").arg(&missing).fails(3, &["missing.toml", "not-there.obj"]);
    let sheen = "{\"asset\": {\"version\": \"2.0\"}, \"extensionsRequired\": [\"KHR_materials_lint\"], \
        \"extensionsUsed\": [\"KHR_materials_lint\"]}";
    let sheen = write("sheen.gltf", sheen);
    Foveal::new("explain").arg(&sheen).fails(3, &["sheen.gltf", "KHR_materials_lint", "--ignore-extension"]);
    Foveal::new("explain --ignore-extension KHR_materials_lint").arg(&sheen).ok();
    let cut = write("cut.glb", "glTF\u{2}\0\0\0");
    Foveal::new("explain").arg(&cut).fails(3, &["cut.glb", "export it again"]);
    let later = write("later.toml", "format = 99\n");
    Foveal::new("explain").arg(&later).fails(3, &["later.toml", "99"]);
    let empty = write("empty.obj", "# nothing\n");
    Foveal::new("explain").arg(&empty).fails(3, &["empty.obj"]);
    let text = write("text.png", "not a picture");
    Foveal::new("compare").arg(&text).arg(&text).fails(3, &["text.png"]);
    // A file stands where the pictures should go.
    let out = text.join("inside");
    Foveal::new("walk --quick --frames 1 --size 32x24")
        .arg(scene("box"))
        .arg("--out")
        .arg(&out)
        .fails(3, &["--out"]);
}

/// Ctrl-C ends a walk soon, and what was done is kept.
#[cfg(unix)]
#[test]
fn interrupted_walks_keep_what_was_done() {
    use std::time::{Duration, Instant};

    let out = folder("interrupted");
    let walk = Foveal::new(&format!("walk --frames 100000 --fps 20 --size 32x24 {CHEAP_BAKE} --out"))
        .arg(&out)
        .arg(scene("box"))
        .start();
    let start = Instant::now();
    while !out.join("frame-0001.png").exists() {
        assert!(start.elapsed() < Duration::from_secs(120), "no second frame");
        std::thread::sleep(Duration::from_millis(10));
    }
    let sent = std::process::Command::new("kill").arg("-INT").arg(walk.id().to_string()).status();
    assert!(sent.is_ok_and(|s| s.success()));
    let ended = walk.wait();
    assert_eq!(ended.code, Some(130), "{}", ended.err);
    for file in ["frame-0000.png", "last.exr", "report.html", "report.json"] {
        assert!(out.join(file).exists(), "{file}");
    }
}

/// Ctrl-C ends a reference with the passes that are whole: a picture of fewer samples, with its batches.
#[cfg(unix)]
#[test]
fn interrupted_references_are_pictures_of_fewer_samples() {
    use std::time::Duration;

    let out = folder("interrupted-reference").join("box.exr");
    for tenths in [2, 5, 20, 80, 320, 1000] {
        let reference = Foveal::new("reference --kind path --spp 65536 --size 64x48 --json --out")
            .arg(&out)
            .arg(scene("box"))
            .start();
        std::thread::sleep(Duration::from_millis(100 * tenths));
        let sent = std::process::Command::new("kill").arg("-INT").arg(reference.id().to_string()).status();
        assert!(sent.is_ok_and(|s| s.success()));
        let ended = reference.wait();
        assert_eq!(ended.code, Some(130), "{}", ended.err);
        if ended.err.contains("no picture was written") {
            // No pass was whole by then.
            assert!(!out.exists());
            continue;
        }
        let told: serde_json::Value = serde_json::from_str(&ended.out).expect("a document");
        let samples = told["spp"].as_u64().expect("a number");
        assert!((1..65_536).contains(&samples), "{samples}");
        assert!(ended.err.contains(&format!("has {samples} samples per pixel")), "{}", ended.err);
        Foveal::new("compare").arg(&out).arg(&out).ok();
        return;
    }
    panic!("no pass was whole after 100 s");
}
