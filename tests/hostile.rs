//! Files made to break readers: a picture, or exit code 3 and a message that names the file.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::{Foveal, root};

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
