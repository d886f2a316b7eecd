//! How 202 odd and broken files of other people's tests end. The files are not ours to ship: without their archive in
//! `../shared` beside the checkout nothing is tested here, and that is said.
//!
//! `verdicts.txt` has a line for each: `drawn` where triangles are shown, `empty` where the file loads and has none,
//! `refused` where it ends with an error. For 166 there is what Khronos's validator says of them, and the line has to be
//! what [`REFUSED`] makes of its codes.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use super::super::{SceneError, load};

/// Errors of the validator after which there is nothing that one could show. After others the rest is shown.
const REFUSED: [&str; 19] = [
    "ACCESSOR_SMALL_BYTESTRIDE",
    "ACCESSOR_TOO_LONG",
    "ARRAY_TYPE_MISMATCH",
    "BUFFER_BYTE_LENGTH_MISMATCH",
    "BUFFER_MISSING_GLB_DATA",
    "GLB_CHUNK_LENGTH_UNALIGNED",
    "GLB_DUPLICATE_CHUNK",
    "GLB_INVALID_VERSION",
    "GLB_LENGTH_MISMATCH",
    "GLB_LENGTH_TOO_SMALL",
    "GLB_UNEXPECTED_END_OF_CHUNK_DATA",
    "GLB_UNEXPECTED_END_OF_CHUNK_HEADER",
    "GLB_UNEXPECTED_FIRST_CHUNK",
    "INVALID_JSON",
    "IO_ERROR",
    "MESH_PRIMITIVES_UNEQUAL_TARGETS_COUNT",
    "MESH_PRIMITIVE_INDICES_ACCESSOR_INVALID_FORMAT",
    "TYPE_MISMATCH",
    "UNDEFINED_PROPERTY",
];

/// Files whose codes say one thing and whose sense another.
const OTHERWISE: [(&str, &str); 2] = [
    ("image/not_found.gltf", "a picture that is not there is a checker"),
    ("json/bom.gltf", "a byte order mark is skipped"),
];

fn unpacked() -> Option<PathBuf> {
    let archive = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/scenes/hostile-A.tar.xz");
    if !archive.is_file() {
        eprintln!("skipped: there is no {}", archive.display());
        return None;
    }
    let to = std::env::temp_dir().join(format!("foveal-verdicts-{}", std::process::id()));
    std::fs::create_dir_all(&to).expect("a folder");
    let tar = Command::new("tar").arg("-xJf").arg(&archive).arg("-C").arg(&to).status();
    if !tar.is_ok_and(|s| s.success()) {
        eprintln!("skipped: tar cannot unpack {}", archive.display());
        return None;
    }
    Some(to)
}

fn end(file: &Path) -> &'static str {
    match load(file) {
        Ok(loaded) if loaded.scene.mesh.triangles.is_empty() => "empty",
        Ok(_) => "drawn",
        Err(SceneError::Document { message, .. } | SceneError::Container { message, .. }) => {
            assert!(message.len() > 10, "{}: {message}", file.display());
            "refused"
        }
        Err(other) => panic!("{}: {other}", file.display()),
    }
}

#[test]
#[expect(
    clippy::disallowed_methods,
    reason = "how long a file takes is one of its verdicts, and no result depends on it"
)]
fn every_file_ends_as_its_verdict_says() {
    let Some(folder) = unpacked() else { return };
    let (mut wrong, mut codes) = (Vec::new(), BTreeSet::new());
    for line in include_str!("verdicts.txt").lines() {
        let (expected, name) = line.split_once(' ').expect("an end and a name");
        let file = folder.join("hostile-A").join(name);
        let start = Instant::now();
        let found = end(&file);
        let mut took = start.elapsed();
        if took > Duration::from_secs(1) {
            // Something else may have been in the way.
            let again = Instant::now();
            end(&file);
            took = again.elapsed();
        }
        assert!(took < Duration::from_secs(1), "{name}: {took:?}");
        if found != expected {
            wrong.push(format!("{found} {name}"));
        }
        let report = PathBuf::from(format!("{}.report.json", file.display()));
        let Ok(report) = std::fs::read(report) else { continue };
        let report: serde_json::Value = serde_json::from_slice(&report).expect("a report");
        let errors: Vec<&str> = report["issues"]["messages"]
            .as_array()
            .expect("messages")
            .iter()
            .filter(|m| m["severity"] == 0)
            .filter_map(|m| m["code"].as_str())
            .collect();
        codes.extend(errors.iter().map(|c| (*c).to_owned()));
        let refused = errors.iter().any(|c| REFUSED.contains(c));
        if OTHERWISE.iter().any(|(end, _)| name.ends_with(end)) {
            assert!(refused && found != "refused", "{name} {errors:?}");
        } else {
            assert_eq!(refused, expected == "refused", "{name} {errors:?}");
        }
    }
    let unknown: Vec<_> = REFUSED.iter().filter(|c| !codes.contains(**c)).collect();
    assert!(unknown.is_empty(), "no file has {unknown:?}");
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
    assert_eq!(include_str!("verdicts.txt").lines().count(), 202);
    std::fs::remove_dir_all(&folder).ok();
}
