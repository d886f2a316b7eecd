//! glTF scenes of other people: they show what paths show, and what an OBJ file of the same things shows.
//!
//! Their files lie in `../shared` beside the checkout. Without these nothing is tested, and that is said.

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

use crate::support::{Foveal, folder, root};

/// Unpacks an archive of scenes.
fn unpacked(archive: &str) -> Option<PathBuf> {
    let packed = root().join("../shared/scenes").join(format!("{archive}.tar.xz"));
    let to = folder(archive);
    let done = packed.is_file() && {
        let tar = Command::new("tar").arg("-xJf").arg(&packed).arg("-C").arg(&to).status();
        tar.is_ok_and(|status| status.success())
    };
    if !done {
        eprintln!("skipped: there is no {} that tar can unpack", packed.display());
    }
    done.then(|| to.join(archive))
}

/// Numbers of a view of the document's only buffer.
fn floats(document: &Value, bytes: &[u8], accessor: usize, width: usize) -> Vec<Vec<f32>> {
    let accessor = &document["accessors"][accessor];
    assert_eq!(accessor["componentType"], 5126);
    let number = |v: &Value| v.as_u64().unwrap_or(0) as usize;
    let view = &document["bufferViews"][number(&accessor["bufferView"])];
    let first = number(&accessor["byteOffset"]) + number(&view["byteOffset"]);
    let read = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"));
    let element = |i: usize| (0..width).map(|c| read(first + 4 * (width * i + c))).collect();
    (0..number(&accessor["count"])).map(element).collect()
}

/// Khronos's duck as its glTF file, and the same as an OBJ file that is written here: one picture, by paths and as walks show
/// it. (With another camera in one of both, its own texels would be finer there.)
#[test]
fn a_duck_is_the_same_as_obj_and_as_gltf() {
    let Some(found) = unpacked("gltf-Duck") else { return };
    let found = found.join("glTF");
    let mut document: Value =
        serde_json::from_slice(&fs::read(found.join("Duck.gltf")).expect("a document")).expect("JSON");
    let bytes = fs::read(found.join("Duck0.bin")).expect("a buffer");
    for node in document["nodes"].as_array_mut().expect("nodes") {
        node.as_object_mut().expect("a node").remove("camera");
    }
    // What the document is known to be: a hundredth of what its only mesh says.
    assert_eq!(document["meshes"].as_array().map(Vec::len), Some(1));
    let scale = document["nodes"][0]["matrix"][0].as_f64().expect("a scale") as f32;
    let mut obj = "mtllib duck.mtl\nusemtl duck\n".to_owned();
    for p in floats(&document, &bytes, 2, 3) {
        writeln!(obj, "v {} {} {}", scale * p[0], scale * p[1], scale * p[2]).expect("text");
    }
    for n in floats(&document, &bytes, 1, 3) {
        writeln!(obj, "vn {} {} {}", n[0], n[1], n[2]).expect("text");
    }
    for uv in floats(&document, &bytes, 3, 2) {
        writeln!(obj, "vt {} {}", uv[0], 1.0 - uv[1]).expect("text");
    }
    let view = &document["bufferViews"][0];
    let first = view["byteOffset"].as_u64().expect("an offset") as usize;
    let indices = &bytes[first..first + view["byteLength"].as_u64().expect("a length") as usize];
    let indices: Vec<u16> = indices.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]]) + 1).collect();
    for [a, b, c] in indices.as_chunks::<3>().0 {
        writeln!(obj, "f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}").expect("text");
    }
    let camera =
        "[[camera]]\nname = \"main\"\neye = [4.0, 4.6, 4.3]\ntarget = [0.1, 0.9, 0.0]\nfov_y = 30.0\n";
    let made = |name: &str, mesh: &str, text: &[u8]| {
        let folder = folder(name);
        fs::copy(found.join("DuckCM.png"), folder.join("DuckCM.png")).expect("a picture");
        fs::copy(found.join("Duck0.bin"), folder.join("Duck0.bin")).expect("a buffer");
        fs::write(folder.join("duck.mtl"), "newmtl duck\nKd 1 1 1\nmap_Kd DuckCM.png\n").expect("a library");
        fs::write(folder.join(mesh), text).expect("a mesh");
        let sidecar = folder.join("duck.toml");
        let head = format!("format = 1\n[geometry]\nfiles = [\"{mesh}\"]\n{camera}");
        fs::write(&sidecar, head).expect("a sidecar");
        sidecar
    };
    let gltf = made("duck-gltf", "duck.gltf", document.to_string().as_bytes());
    let obj = made("duck-obj", "duck.obj", obj.as_bytes());
    for kind in ["path", "traced --baked --particles 100000 --error 5%"] {
        let line = format!("reference --kind {kind} --spp 8 --size 128x96 --out");
        let pictures = [&gltf, &obj].map(|scene| {
            let file = scene.with_extension("exr");
            Foveal::new(&line).arg(&file).arg(scene).ok();
            file
        });
        let d = Foveal::new("compare").arg(&pictures[0]).arg(&pictures[1]).json();
        assert!(d["flip"].as_f64() <= Some(0.002), "{kind}: {d}");
    }
}

/// Nine scenes: archive, document, and the most that blocks of 8 × 8 pixels differ from 256 paths a pixel on average, and
/// FLIP. A chart of glass wants light of the sun that paths find through panes; a level of white metal has noise of its own.
const SCENES: [(&str, &str, f64, f64); 9] = [
    ("godot-zdm2", "zdm2.glb", 0.006, 0.016),
    ("pc-vr-gallery", "vr-gallery.glb", 0.001, 0.006),
    ("pc-glass-table", "glass-table.glb", 0.0015, 0.006),
    ("gltf-SheenChair", "glTF/SheenChair.gltf", 0.0015, 0.008),
    ("gltf-Duck", "glTF/Duck.gltf", 0.001, 0.004),
    ("gltf-GlassVaseFlowers", "glTF/GlassVaseFlowers.gltf", 0.002, 0.008),
    ("gltf-StainedGlassLamp", "glTF-JPG-PNG/StainedGlassLamp.gltf", 0.0015, 0.006),
    ("gltf-FlightHelmet-bevy", "FlightHelmet.gltf", 0.0015, 0.006),
    ("gltf-TransmissionTest", "glTF/TransmissionTest.gltf", 0.018, 0.06),
];

/// Each is loaded, baked, walked until it has converged, refined, and held against paths.
#[test]
#[ignore = "minutes"]
fn scenes_of_other_people_show_what_paths_show() {
    let mut wrong = Vec::new();
    for (archive, name, blocks_max, flip_max) in SCENES {
        let Some(found) = unpacked(archive) else { continue };
        let (scene, out) = (found.join(name), folder("walked"));
        let walk = "walk --baked --frames 2 --until-converged --refine --size 320x240 --out";
        let walked = Foveal::new(walk).arg(&out).arg(&scene).json();
        assert_eq!(walked["converged"], true, "{archive}");
        let paths = out.join("paths.exr");
        let reference = "reference --kind path --spp 256 --size 320x240 --out";
        Foveal::new(reference).arg(&paths).arg(&scene).ok();
        let compare = |picture: &Path| Foveal::new("compare --blocks 8").arg(picture).arg(&paths).json();
        let d = compare(&out.join("last.exr"));
        let (blocks, flip) = (d["blocks"]["mean"].as_f64(), d["flip"].as_f64());
        println!(
            "{archive}: blocks {:.2} %, FLIP {:.4}, {}",
            100.0 * blocks.unwrap_or(f64::NAN),
            flip.unwrap_or(f64::NAN),
            out.display()
        );
        if !(blocks <= Some(blocks_max) && flip <= Some(flip_max)) || blocks.is_none() || flip.is_none() {
            wrong.push(format!("{archive}: {d}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
