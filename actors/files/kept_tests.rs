//! Tests of kept scenes: what comes back, and what is not believed.

use std::path::PathBuf;

use super::*;
use crate::load::{self, Loaded};

const US: [u8; 32] = [7; 32];
const LIMIT: u64 = 1 << 30;

fn bundled(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../scenes").join(name)
}

fn encoded(path: &Path) -> (Loaded, Accel, Vec<u8>) {
    let loaded = load::load(path).expect("a scene");
    let accel = Accel::build(&loaded.scene);
    let warnings: Vec<String> = loaded.warnings.iter().map(ToString::to_string).collect();
    let sources = loaded.sources.clone().expect("all is known");
    let bytes = whole(&encode(&US, &sources, &loaded.scene, &accel, &warnings).expect("few bytes"));
    (loaded, accel, bytes)
}

/// All that there is to say of a scene.
fn told(scene: &Scene) -> String {
    let textures: Vec<_> =
        scene.textures.iter().map(|t| (&t.name, t.mips.content_hash(), t.placement)).collect();
    let kinds: Vec<_> = scene.textures.iter().map(|t| (t.has_alpha, t.is_color)).collect();
    let plain = scene.with_resident(Vec::new());
    format!("{plain:?} {textures:?} {kinds:?}")
}

fn whole(encoded: &Encoded<'_>) -> Vec<u8> {
    encoded.pieces().collect::<Vec<_>>().concat()
}

#[test]
fn scenes_come_back_as_they_were() {
    for name in ["table/table.toml", "gallery/gallery.toml", "duck/duck.toml", "finishes/finishes.toml"] {
        let path = bundled(name);
        let (loaded, accel, bytes) = encoded(&path);
        let kept = decode(&US, &bytes, &path, LIMIT).expect(name);
        assert!(told(&kept.scene) == told(&loaded.scene), "{name}");
        assert_eq!(kept.warnings.len(), loaded.warnings.len());
        let again =
            encode(&US, loaded.sources.as_ref().expect("known"), &kept.scene, &kept.accel, &kept.warnings);
        assert!(whole(&again.expect("few bytes")) == bytes, "{name}");
        let [own, theirs] = [&accel, &kept.accel].map(|accel| {
            let mut bulk = Bulk::default();
            accel.keep(&mut bulk);
            (bulk.pieces().collect::<Vec<_>>().concat(), accel.size_bytes(), format!("{accel:?}"))
        });
        assert!(own == theirs, "{name}");
    }
}

/// A small scene in a folder of its own.
fn small(name: &str) -> (PathBuf, PathBuf) {
    let folder = std::env::temp_dir().join(format!("foveal-kept-{name}-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let obj = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl m\nf 1 2 3\nf 1 2 4\nf 1 3 4\n";
    std::fs::write(folder.join("a.obj"), obj).expect("written");
    std::fs::write(folder.join("a.mtl"), "newmtl m\nKd 1 0 0\nmap_Kd a.png\n").expect("written");
    (folder.join("a.obj"), folder)
}

#[test]
fn a_file_is_read_as_its_bytes_are() {
    let (path, folder) = small("file");
    let (loaded, accel, bytes) = encoded(&path);
    let file = folder.join("kept");
    let sources = loaded.sources.clone().expect("known");
    let warnings: Vec<String> = loaded.warnings.iter().map(ToString::to_string).collect();
    let kept = encode(&US, &sources, &loaded.scene, &accel, &warnings).expect("few bytes");
    kept.save(&file).expect("written");
    assert!(std::fs::read(&file).expect("read") == bytes);
    let kept = load(&US, &file, &path, LIMIT).expect("the scene");
    assert!(told(&kept.scene) == told(&loaded.scene));
    std::fs::write(&file, &bytes[..bytes.len() - 1]).expect("written");
    assert!(matches!(load(&US, &file, &path, LIMIT), Err(KeptError::Damaged)));
    std::fs::remove_file(&file).expect("removed");
    assert!(matches!(load(&US, &file, &path, LIMIT), Err(KeptError::Io(_))));
    std::fs::remove_dir_all(&folder).expect("removed");
}

/// Something that is done to a folder.
type Change = fn(&Path);

#[test]
fn changed_files_are_noticed() {
    let changes: [(&str, Change); 4] = [
        ("mesh", |folder| std::fs::write(folder.join("a.obj"), "v 0 0 0\n").expect("written")),
        ("gone", |folder| std::fs::remove_file(folder.join("a.mtl")).expect("removed")),
        // What was missing is there now.
        ("sidecar", |folder| std::fs::write(folder.join("a.toml"), "format = 1\n").expect("written")),
        ("picture", |folder| std::fs::write(folder.join("A.PNG"), "none").expect("written")),
    ];
    for (name, change) in changes {
        let (path, folder) = small(name);
        let (.., bytes) = encoded(&path);
        assert!(decode(&US, &bytes, &path, LIMIT).is_ok(), "{name}");
        change(&folder);
        let found = decode(&US, &bytes, &path, LIMIT);
        assert!(matches!(found, Err(KeptError::Changed)), "{name}: {found:?}");
        std::fs::remove_dir_all(&folder).expect("removed");
    }
}

#[test]
fn nothing_damaged_or_foreign_is_believed() {
    let (path, folder) = small("damage");
    let (_, _, bytes) = encoded(&path);
    assert!(matches!(decode(&[8; 32], &bytes, &path, LIMIT), Err(KeptError::Foreign)));
    for length in (0..bytes.len()).step_by(7) {
        assert!(decode(&US, &bytes[..length], &path, LIMIT).is_err(), "{length} bytes");
    }
    let mut refused = 0;
    for at in 0..bytes.len() {
        for value in [0, 1, 0x7f, 0xff] {
            let mut other = bytes.clone();
            other[at] = value;
            if other == bytes {
                continue;
            }
            assert!(decode(&US, &other, &path, LIMIT).is_err(), "byte {at}");
            // Somebody made it up, checksums and all: an error, or a scene that rays can meet.
            match read(&US, (&other.as_slice(), other.len() as u64), &path, LIMIT, false) {
                Err(_) => refused += 1,
                Ok(Kept { scene, accel, .. }) => {
                    for i in 0..8 {
                        let origin = glam::Vec3::new(0.3 * i as f32 - 1.0, 0.2, 0.1);
                        let ray = foveal::geometry::Ray::new(origin, glam::Vec3::new(1.0, 0.1, 0.2));
                        if let Some(hit) = accel.intersect(&scene, &ray) {
                            let _ = scene.material_of(hit.triangle);
                        }
                    }
                }
            }
        }
    }
    assert!(refused > bytes.len(), "{refused} of {} bytes", bytes.len());
    std::fs::remove_dir_all(&folder).expect("removed");
}
