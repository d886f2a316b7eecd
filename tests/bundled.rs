//! What lies in `scenes/` is what the generator writes.

use std::collections::BTreeSet;
use std::fs;

use crate::support::root;

/// Text byte by byte; pictures pixel by pixel, since another version of an encoder may pack them otherwise.
#[test]
fn scenes_are_the_generators_output() {
    let again = "run `cargo run --release --example scenes -- scenes`";
    let mut made = BTreeSet::new();
    for (_, make) in foveal_scenes::BUNDLED {
        let scene = make().expect("textures");
        let folder = root().join("scenes").join(&scene.name);
        for (name, bytes) in &scene.files {
            if name.ends_with(".obj") {
                let text = String::from_utf8_lossy(bytes);
                let corners =
                    text.lines().filter(|l| l.starts_with("f ")).map(|l| l.split_whitespace().count() - 1);
                assert_eq!(corners.map(|n| n - 2).sum::<usize>(), scene.triangle_count, "{name}");
            }
            let path = folder.join(name);
            let kept = fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}; {again}", path.display()));
            let is_text = [".obj", ".mtl", ".toml", ".gltf", ".bin"].iter().any(|e| name.ends_with(e));
            let same = if is_text {
                kept == *bytes
            } else {
                let pixels = |b: &[u8]| image::load_from_memory(b).expect("a picture");
                kept == *bytes || pixels(&kept) == pixels(bytes)
            };
            assert!(same, "{} is not what the generator writes; {again}", path.display());
            made.insert(path);
        }
    }
    for folder in fs::read_dir(root().join("scenes")).expect("scenes").flatten().map(|f| f.path()) {
        if folder.is_dir() && !folder.ends_with("generate") {
            for file in fs::read_dir(folder).expect("a folder").flatten() {
                assert!(made.contains(&file.path()), "{} is no part of a scene", file.path().display());
            }
        }
    }
}
