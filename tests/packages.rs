//! What goes to a registry: each package, in order, and what an embedder takes along.

use std::collections::BTreeSet;
use std::fs;
use std::process::Command;

use crate::support::root;

/// What cargo says to these arguments.
fn cargo(arguments: &str) -> String {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let run = Command::new(cargo).args(arguments.split(' ')).current_dir(root()).output();
    let run = run.expect("cargo can be run");
    assert!(run.status.success(), "cargo {arguments}: {}", String::from_utf8_lossy(&run.stderr));
    String::from_utf8(run.stdout).expect("a text")
}

/// Who takes the engine into a program of their own takes no window and no command line along.
#[test]
fn the_engine_brings_no_window_and_no_command_line() {
    let tree = "tree --offline --locked --package foveal-engine --edges normal --prefix none --format {p}";
    let found = cargo(tree);
    let names: BTreeSet<&str> = found.lines().filter_map(|line| line.split(' ').next()).collect();
    assert!(names.contains("foveal-runtime") && names.contains("glam"), "{names:?}");
    for name in ["wgpu", "winit", "egui", "softbuffer", "axum", "tokio", "clap", "indicatif", "plotters"] {
        assert!(!names.contains(name), "foveal-engine brings {name} along");
    }
}

/// What goes to a registry is whole, and small.
#[test]
fn packages_hold_what_they_need() {
    const BYTES_MAX: u64 = 1 << 18;
    let licences = ["LICENSE-MIT", "LICENSE-APACHE"];
    for (package, folder, needed) in [
        ("foveal-core", ".", &["src/README.md", "src/lib.rs"][..]),
        ("foveal-files", "actors/files", &["lib.rs", "load/gltf/document.rs"]),
        ("foveal-runtime-derive", "actors/runtime/derive", &["lib.rs"]),
        ("foveal-runtime", "actors/runtime", &["README.md", "build.rs", "examples/jobs.rs"]),
        ("foveal-actors", "actors", &["message/renderer.rs"]),
        ("foveal-engine", "actors/engine", &["README.md", "examples/walk.rs"]),
        ("foveal-scenes", "scenes", &["README.md", "generate/lib.rs"]),
        ("foveal-terminal", "actors/terminal", &["lib.rs"]),
        ("foveal-serve", "actors/serve", &["page/index.html"]),
        ("foveal-window", "actors/window", &["gpu/base.wgsl"]),
        ("foveal-remote", "actors/remote", &["lib.rs"]),
        ("foveal-bench", "actors/bench", &["lib.rs"]),
        ("foveal", "actors/program", &["main.rs", "README.md", "build.rs"]),
    ] {
        let list = format!("package --list --allow-dirty --offline --package {package}");
        let list = cargo(&list);
        let files: BTreeSet<&str> = list.lines().collect();
        for needed in needed.iter().chain(&licences) {
            assert!(files.contains(needed), "{package} goes without {needed}");
        }
        for file in files {
            // Some are made by cargo.
            let size = fs::metadata(root().join(folder).join(file)).map_or(0, |file| file.len());
            assert!(
                size <= BYTES_MAX || file.starts_with("Cargo.lock"),
                "{package}: {file} has {size} bytes"
            );
        }
    }
}

/// Each package can be made, from the core to the program: those that a package needs are found by name and version
/// among those that were made before it, as in a registry. Without compiling them once more, which `cargo package` does.
#[test]
fn every_package_can_be_made() {
    let target = tempfile::tempdir().expect("a folder");
    let folder = target.path().to_str().expect("a name");
    cargo(&format!("package --workspace --no-verify --allow-dirty --offline --target-dir {folder}"));
    let members = cargo("metadata --offline --locked --no-deps --format-version 1");
    let members: serde_json::Value = serde_json::from_str(&members).expect("JSON");
    let members = members["packages"].as_array().expect("packages");
    assert!(members.len() >= 12);
    for member in members {
        let [name, version] = ["name", "version"].map(|key| member[key].as_str().expect("a text"));
        let made = target.path().join("package").join(format!("{name}-{version}.crate"));
        assert!(fs::metadata(made).is_ok_and(|file| file.len() > 1000), "{name} was not made");
    }
}
