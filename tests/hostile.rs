//! Files made to break readers: a picture, or exit code 3 and a message that names the file.

use std::fs;
use std::path::{Path, PathBuf};

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
