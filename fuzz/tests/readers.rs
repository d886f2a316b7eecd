//! Our own files with random edits, given to their readers.

#![allow(clippy::disallowed_methods, reason = "tests run outside of actors")]

#[path = "../../actors/runtime/tests/ring/mod.rs"]
#[allow(dead_code, reason = "a test of the runtime asks more of it")]
mod ring;
mod sealed;

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use bolero::{TypeGenerator, check};
use foveal::geometry::{Accel, Ray};
use foveal::illumination::bake::{BakeSettings, bake, cache_key};
use foveal::transport::Indexed;
use foveal::transport::light::{Lights, Receiver};
use foveal_files::bakes::{encode, load_illumination};
use foveal_files::load::{LoadOptions, load, load_with};
use foveal_runtime::{ActorId, Config, Exit, Hashing, Limit, Record, Runtime, Trace};
use glam::Vec3;

/// A change of a file. Places are parts of 2¹⁶ of its length.
#[derive(Clone, Debug, TypeGenerator)]
enum Edit {
    Flip { at: u16, bit: u8 },
    Set { at: u16, byte: u8 },
    Insert { at: u16, bytes: Vec<u8> },
    Word { at: u16, word: u8 },
    Number { at: u16, word: u8 },
    Remove { at: u16, count: u8 },
    Copy { from: u16, to: u16, count: u8 },
    Cut { at: u16 },
    Length { at: u16, value: u32 },
}

/// What the formats are made of, and what numbers should not be.
#[rustfmt::skip]
const WORDS: [&str; 40] = [
    "nan", "inf", "-inf", "1e39", "-1e-46", "0", "-0", "-1", "1", "4294967296", "99999999999999999999", "1e", ".",
    "\n", "\\\n", " ", "\t", "#", "f 1 2 3\n", "f 1/1/1 2//2 3/3\n", "f -1 -1 -1\n", "v 0 0 0\n", "vn nan 0 0\n",
    "vt 1\n", "usemtl \n", "mtllib ..\n", "o \n", "g \n", "newmtl \n", "map_Kd /dev/zero\n", "Kd 1e38 -1 nan\n", "Ns \n",
    "[[camera]]\n", "[geometry]\n", "= ", "\"", "[", "]", "\0", "\u{feff}",
];

/// The file with the edits.
fn edited(file: &[u8], edits: &[Edit]) -> Vec<u8> {
    let mut bytes = file.to_vec();
    for edit in edits.iter().take(24) {
        let place = |at: u16| ((bytes.len() as u64 * u64::from(at)) >> 16) as usize;
        match edit {
            Edit::Flip { at, bit } => {
                let at = place(*at);
                if let Some(byte) = bytes.get_mut(at) {
                    *byte ^= 1 << (bit % 8);
                }
            }
            Edit::Set { at, byte } => {
                let at = place(*at);
                if let Some(b) = bytes.get_mut(at) {
                    *b = *byte;
                }
            }
            Edit::Insert { at, bytes: new } => {
                let at = place(*at);
                bytes.splice(at..at, new.iter().copied());
            }
            Edit::Word { at, word } => {
                let at = place(*at);
                bytes.splice(at..at, WORDS[*word as usize % WORDS.len()].bytes());
            }
            Edit::Number { at, word } => {
                // The number that stands next there becomes another.
                let is_part = |b: &u8| b.is_ascii_digit() || b".-+e".contains(b);
                let at = place(*at);
                if let Some(from) = bytes[at..].iter().position(|b| b.is_ascii_digit()).map(|i| at + i) {
                    let to = bytes[from..].iter().position(|b| !is_part(b)).map_or(bytes.len(), |i| from + i);
                    bytes.splice(from..to, WORDS[*word as usize % 11].bytes());
                }
            }
            Edit::Remove { at, count } => {
                let at = place(*at);
                let end = (at + usize::from(*count)).min(bytes.len());
                bytes.drain(at..end);
            }
            Edit::Copy { from, to, count } => {
                let (from, to) = (place(*from), place(*to));
                let piece = bytes[from..(from + usize::from(*count)).min(bytes.len())].to_vec();
                bytes.splice(to..to, piece);
            }
            Edit::Cut { at } => bytes.truncate(place(*at)),
            Edit::Length { at, value } => {
                let at = place(*at);
                if let Some(word) = bytes.get_mut(at..at + 4) {
                    word.copy_from_slice(&value.to_le_bytes());
                }
            }
        }
    }
    bytes
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// A file of one of our scenes, its beginning where it is long.
fn of_scene(name: &str, file: &str, most: usize) -> Vec<u8> {
    let path = root().join("scenes").join(name).join(file);
    let mut bytes = fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    bytes.truncate(most);
    bytes
}

const OBJ: &str = "mtllib a.mtl\no box\nv -1 -1 -1\nv 1 -1 -1\nv 1 1 -1\nv -1 1 -1\nv -1 -1 1\nv 1 -1 1\nv 1 1 1\nv -1 1 1\n\
    vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\nvn 0 0 -1\nusemtl a\ns 1\nf 1/1/1 2/2/1 3/3/1 4/4/1\nf 5/1/2 8/4/2 7/3/2 6/2/2\n\
    g side\nusemtl b\nf 1 5 6 2\nf -8//1 -5//1 -1//2 -4//2\nf 2 6 7 3\nusemtl c\nf 1 2 3\n";
const MTL: &str = "newmtl a\nKa 0 0 0\nKd 0.5 0.5 0.5\nKs 0.1 0.1 0.1\nNs 100\nmap_Kd -s 2 2 1 a.png\nnewmtl b\nKd 0 0 0\nKe 4 4 4\n\
    illum 2\nnewmtl c\nKd 0 0 0\nKs 1 1 1\nillum 7\nNi 1.5\nd 0.5\nTf 1 1 1\nPr 0.2\nbump -bm 0.5 a.png\n";
const SIDECAR: &str = "format = 1\ntitle = \"t\"\n[geometry]\nfiles = [\"a.obj\"]\nmetres_per_unit = 1.0\nup = \"+y\"\n\
    [[camera]]\nname = \"m\"\neye = [0.0, 0.0, 0.9]\ntarget = [0.0, 0.0, 0.0]\nup = [0.0, 1.0, 0.0]\nfov_y = 45.0\n\
    [[path]]\nname = \"p\"\nkeys = [ { t = 0.0, eye = [0.0, 0.0, 0.9], target = [0.0, 0.0, 0.0] }, \
    { t = 1.0, eye = [0.1, 0.0, 0.9], target = [0.0, 0.0, 0.0] } ]\n[environment]\nradiance = [1.0, 1.0, 1.0]\nmap = \"a.exr\"\n\
    scale = 1.0\nrotate_up = 10.0\n[[light]]\nkind = \"spot\"\nposition = [0.0, 0.5, 0.0]\ndirection = [0.0, -1.0, 0.0]\n\
    intensity = [1.0, 1.0, 1.0]\ninner = 10.0\nouter = 20.0\n[material.\"c\"]\nmodel = \"conductor\"\neta = [0.2, 0.9, 1.1]\n\
    k = [3.9, 2.4, 2.1]\nalpha_x = 0.1\nalpha_y = 0.2\ndistribution = \"beckmann\"\n[material.\"a\"]\nmodel = \"plastic\"\n\
    map_albedo = \"a.png\"\nior = 1.5\nalpha = 0.05\nmap_opacity = \"a.png\"\nmap_bump = \"a.png\"\n[display]\nexposure = 1.2\n\
    white_cd_m2 = 100.0\n[budget]\ntextures = \"64MiB\"\nfps = 10.0\n";

/// Small pictures in every format that is read.
fn picture(format: image::ImageFormat) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    let dynamic = match format {
        image::ImageFormat::Hdr | image::ImageFormat::OpenExr => {
            image::DynamicImage::ImageRgb32F(image::ImageBuffer::from_fn(19, 11, |x, y| {
                image::Rgb([x as f32 * 0.1, y as f32, 1e3])
            }))
        }
        _ => image::DynamicImage::ImageRgb8(image::ImageBuffer::from_fn(19, 11, |x, y| {
            image::Rgb([(x * 13) as u8, (y * 21) as u8, (x * y) as u8])
        })),
    };
    dynamic.write_to(&mut bytes, format).expect("a picture");
    bytes.into_inner()
}

/// A scene in a folder of its own; one of its files is replaced.
fn scene_with(file: &str, bytes: &[u8], start: &str) {
    let folder = tempfile::tempdir().expect("a folder");
    let png = picture(image::ImageFormat::Png);
    let exr = picture(image::ImageFormat::OpenExr);
    let others: [(&str, &[u8]); 5] = [
        ("a.obj", OBJ.as_bytes()),
        ("a.mtl", MTL.as_bytes()),
        ("a.toml", SIDECAR.as_bytes()),
        ("a.png", &png),
        ("a.exr", &exr),
    ];
    for (name, content) in others.iter().filter(|o| o.0 != file && (o.0 != "a.toml" || start == "a.toml")) {
        fs::write(folder.path().join(name), content).expect("a file");
    }
    fs::write(folder.path().join(file), bytes).expect("a file");
    let options = LoadOptions {
        file_bytes_max: 1 << 20,
        texture_side_max: 1024,
        picture_bytes_max: 4 << 20,
        texture_bytes_max: 16 << 20,
        triangles_max: 1 << 16,
        ..LoadOptions::default()
    };
    match load_with(&folder.path().join(start), &options) {
        Ok(loaded) => {
            let scene = &loaded.scene;
            let mesh = &scene.mesh;
            let sound = |v: &Vec3| v.is_finite();
            assert!(mesh.positions.iter().all(sound) && mesh.normals.iter().all(sound));
            assert!(mesh.triangles.iter().flatten().all(|&v| (v as usize) < mesh.positions.len()));
            assert!(mesh.materials.iter().all(|m| (m.0 as usize) < scene.materials.len()));
            assert!(!scene.cameras.is_empty());
            let camera = scene.cameras[0].camera;
            let frame = camera.frame(8, 8);
            let accel = Accel::build(scene);
            let direction = frame.direction(4.0, 4.0);
            assert!(direction.is_finite(), "{camera:?}");
            if let Some(hit) = accel.intersect(scene, &Ray::new(frame.eye, direction)) {
                assert!(hit.t.is_finite() && (hit.triangle as usize) < mesh.triangles.len());
            }
            let at = Receiver { point: scene.bounds[0], normal: Vec3::Y };
            let lit = Lights::build(scene).sample_towards(scene, &at, (0.5, [0.5, 0.5]), None);
            assert!(lit.is_none_or(|light| light.radiance.is_finite() && light.pdf > 0.0));
            loaded.warnings.iter().for_each(|w| assert!(!w.to_string().is_empty()));
        }
        Err(e) => assert!(!e.to_string().is_empty()),
    }
}

/// Gives a file with random edits to `read`.
fn fuzz(corpus: &[Vec<u8>], read: impl Fn(&[u8]) + std::panic::RefUnwindSafe) {
    check!().with_type::<(u8, Vec<Edit>)>().for_each(|(which, edits)| {
        read(&edited(&corpus[*which as usize % corpus.len()], edits));
    });
}

#[test]
fn obj() {
    let corpus =
        [OBJ.as_bytes().to_vec(), of_scene("box", "box.obj", 4000), of_scene("table", "table.obj", 3000)];
    fuzz(&corpus, |bytes| scene_with("a.obj", bytes, "a.obj"));
}

#[test]
fn mtl() {
    let corpus = [MTL.as_bytes().to_vec(), of_scene("gallery", "gallery.mtl", 4000)];
    fuzz(&corpus, |bytes| scene_with("a.mtl", bytes, "a.obj"));
}

/// A document with something of everything that is read, its buffer within.
fn gltf_document() -> String {
    let numbers: [f32; 20] =
        [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0];
    let mut bytes: Vec<u8> = numbers.iter().flat_map(|v| v.to_le_bytes()).collect();
    bytes.extend([0, 1, 2, 0, 2, 3, 0, 0]);
    let data = base64::Engine::encode(&base64::engine::general_purpose::STANDARD, &bytes);
    format!("{{{BEGINNING}\"buffers\": [{{\"byteLength\": 88, \"uri\": \"data:;base64,{data}\"}}], {GLTF}}}")
}

const BEGINNING: &str = "\"asset\": {\"version\": \"2.0\"}, ";
const GLTF: &str = r#""bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 32},
    {"buffer": 0, "byteOffset": 80, "byteLength": 6}], "accessors": [{"bufferView": 0, "componentType": 5126, "count": 4,
    "type": "VEC3", "sparse": {"count": 1, "indices": {"bufferView": 2, "componentType": 5121}, "values": {"bufferView": 0}}},
    {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC2"},
    {"bufferView": 2, "componentType": 5121, "count": 6, "type": "SCALAR"}], "meshes": [{"primitives": [{"attributes":
    {"POSITION": 0, "TEXCOORD_0": 1, "TEXCOORD_1": 1}, "indices": 2, "material": 0, "mode": 4}]}], "materials": [{"alphaMode": "MASK",
    "pbrMetallicRoughness": {"baseColorTexture": {"index": 0, "extensions": {"KHR_texture_transform": {"scale": [2, 3],
    "rotation": 0.5, "offset": [0.1, 0.2]}}}, "metallicRoughnessTexture": {"index": 0}}, "normalTexture": {"index": 0},
    "emissiveFactor": [1, 2, 3], "extensions": {"KHR_materials_ior": {"ior": 1.3}, "KHR_materials_transmission":
    {"transmissionFactor": 0.2, "transmissionTexture": {"index": 0}}, "KHR_materials_clearcoat": {"clearcoatFactor": 0.5},
    "KHR_materials_sheen": {"sheenColorFactor": [1, 0.5, 0]}, "KHR_materials_anisotropy": {"anisotropyStrength": 0.5}, "KHR_materials_specular": {"specularFactor": 0.5,
    "specularColorTexture": {"index": 0, "texCoord": 1}}, "KHR_materials_iridescence": {"iridescenceFactor": 0.7,
    "iridescenceThicknessTexture": {"index": 0}}, "KHR_materials_diffuse_transmission": {"diffuseTransmissionFactor": 0.3},
    "KHR_materials_dispersion": {"dispersion": 2}}}], "textures": [{"source": 0, "sampler":
    0}], "samplers": [{"wrapS": 33071, "wrapT": 33648, "magFilter": 9728}], "images": [{"uri": "a.png"}], "cameras": [{"type": "perspective", "perspective":
    {"yfov": 0.7}}], "scenes": [{"nodes": [0]}], "scene": 0, "nodes": [{"children": [1, 2, 3], "rotation": [0, 0, 0.6, 0.8]},
    {"mesh": 0, "scale": [1, -2, 3], "weights": [1]}, {"camera": 0, "translation": [0, 0, 4]}, {"matrix":
    [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1, 2, 3, 1], "extensions": {"KHR_lights_punctual": {"light": 0}, "EXT_mesh_gpu_instancing":
    {"attributes": {"TRANSLATION": 0}}}, "mesh": 0}], "extensions": {"KHR_lights_punctual": {"lights": [{"type": "spot",
    "intensity": 5, "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.4}}]}}, "extensionsUsed": ["KHR_lights_punctual"]"#;

#[test]
fn gltf_text() {
    fuzz(&[gltf_document().into_bytes()], |bytes| scene_with("a.gltf", bytes, "a.gltf"));
}

/// A container around a document and bytes, its lengths right.
fn glb(json: &[u8], bin: &[u8]) -> Vec<u8> {
    let pad = |bytes: &[u8], with: u8| {
        let mut bytes = bytes.to_vec();
        bytes.resize(bytes.len().next_multiple_of(4), with);
        bytes
    };
    let (json, bin) = (pad(json, b' '), pad(bin, 0));
    let mut file = b"glTF".to_vec();
    for word in [2, (28 + json.len() + bin.len()) as u32, json.len() as u32] {
        file.extend(word.to_le_bytes());
    }
    file.extend(b"JSON");
    file.extend(json);
    file.extend((bin.len() as u32).to_le_bytes());
    file.extend(b"BIN\0");
    file.extend(bin);
    file
}

/// Edits of a container.
#[test]
fn gltf_binary() {
    fuzz(&[glb(gltf_document().as_bytes(), &[])], |bytes| scene_with("a.glb", bytes, "a.glb"));
}

/// Edits of a document in a container whose lengths are right.
#[test]
fn gltf_document_in_a_container() {
    fuzz(&[gltf_document().into_bytes()], |json| scene_with("a.glb", &glb(json, &[]), "a.glb"));
}

/// Edits of what accessors read: the document and all lengths are right.
#[test]
fn gltf_accessors() {
    let document = |length: usize| {
        let views: Vec<String> = ["0", "48", "80", "96"]
            .iter()
            .map(|at| format!("{{\"buffer\": 0, \"byteOffset\": {at}, \"byteLength\": 48}}"))
            .collect();
        format!(
            "{{{BEGINNING}\"buffers\": [{{\"byteLength\": {length}}}], \"bufferViews\": [{}], {ACCESSORS}}}",
            views.join(",")
        )
    };
    let corpus: Vec<Vec<u8>> = vec![(0..160u8).collect(), vec![0; 160], vec![0x3f; 160]];
    fuzz(&corpus, |bytes| {
        let mut bytes = bytes.to_vec();
        bytes.resize(160, 7);
        scene_with("a.glb", &glb(document(160).as_bytes(), &bytes), "a.glb");
    });
}

const ACCESSORS: &str = r#""accessors": [{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "sparse":
    {"count": 2, "indices": {"bufferView": 2, "componentType": 5121}, "values": {"bufferView": 1}}}, {"bufferView": 1,
    "componentType": 5122, "normalized": true, "count": 4, "type": "VEC4"}, {"bufferView": 2, "componentType": 5121, "count": 12,
    "type": "SCALAR"}, {"bufferView": 3, "componentType": 5126, "count": 2, "type": "SCALAR"}, {"bufferView": 0, "componentType":
    5126, "count": 2, "type": "VEC4"}, {"bufferView": 1, "componentType": 5121, "count": 4, "type": "VEC4"}], "meshes":
    [{"weights": [0.5], "primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1, "COLOR_0": 1, "JOINTS_0": 5, "WEIGHTS_0": 1},
    "indices": 2, "targets": [{"POSITION": 0}]}]}], "cameras": [{"type": "perspective", "perspective": {"yfov": 0.7}}],
    "nodes": [{"mesh": 0, "skin": 0}, {"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 0,
    "ROTATION": 1}}}}, {"camera": 0}], "skins": [{"joints": [0, 2]}], "animations": [{"samplers": [{"input": 3, "output": 4}],
    "channels": [{"sampler": 0, "target": {"node": 2, "path": "rotation"}}]}]"#;

/// Edits of compressed views: the document and all lengths are right.
#[test]
fn gltf_meshopt() {
    let layouts = [
        ("ATTRIBUTES", 12, 20),
        ("ATTRIBUTES", 8, 300),
        ("TRIANGLES", 4, 24),
        ("TRIANGLES", 2, 3),
        ("INDICES", 4, 24),
    ];
    let filters = ["NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR"];
    let mut corpus: Vec<Vec<u8>> = Vec::new();
    for (header, length) in [(0xa0, 90), (0xa1, 90), (0xe1, 60), (0xd1, 40)] {
        corpus.push(std::iter::once(header).chain((1..length).map(|i: u8| i.wrapping_mul(37) % 5)).collect());
        corpus.push(std::iter::once(header).chain((1..length).map(|i: u8| i.wrapping_mul(91))).collect());
        corpus.push(std::iter::once(header).chain(vec![0; usize::from(length)]).collect());
    }
    fuzz(&corpus, |bytes| {
        for (i, (mode, stride, count)) in layouts.iter().enumerate() {
            let filter = if i < 2 { filters[bytes.len() % filters.len()] } else { "NONE" };
            let json = format!(
                "{{{BEGINNING}\"buffers\": [{{\"byteLength\": {}}}, {{\"byteLength\": 9999}}], \"bufferViews\": [{{\"buffer\": 1, \"byteLength\": {},
                \"extensions\": {{\"EXT_meshopt_compression\": {{\"buffer\": 0, \"byteLength\": {}, \"byteStride\": {stride},
                \"count\": {count}, \"mode\": \"{mode}\", \"filter\": \"{filter}\"}}}}}}], \"accessors\": [{{\"bufferView\": 0,
                \"componentType\": {}, \"count\": {}, \"type\": \"{}\"}}, {{\"componentType\": 5126, \"count\": 24, \"type\": \"VEC3\"}}],
                \"meshes\": [{{\"primitives\": [{{\"attributes\": {{\"POSITION\": {}}}, \"indices\": 0}}]}}], \"nodes\": [{{\"mesh\": 0}}]}}",
                bytes.len(),
                stride * count,
                bytes.len(),
                if i < 2 { 5126 } else if *stride == 2 { 5123 } else { 5125 },
                if *stride == 8 { count / 2 } else { *count },
                if i < 2 { "VEC3" } else { "SCALAR" },
                i32::from(i >= 2)
            );
            scene_with("a.glb", &glb(json.as_bytes(), bytes), "a.glb");
        }
    });
}

/// A sheet of eight triangles, higher by one half in its middle, as an encoder for Draco wrote it.
#[cfg(feature = "draco")]
const SHEET: &str = concat!(
    "445241434f02020101000002090801080200ff0111ff0288400301020503ad2a07551503a07a81010101040b014001000101",
    "01040b01400100010101050f0140010001010101014001000002ff0000000000010009030000020103090200010201010101",
    "0380104928fffffffffffffffffffffffffffffff7dd0b6102fffffffffffffffffffffffffffffff77d0907538daac0f65e",
    "a700000000ff070000000000000000000000000000000000400b01010101028008c931ffffffffffffffffffffffffffffff",
    "f7390e04d2dd6d8c00000000ff03000000000000000000000000803f0a",
);

/// Edits of a mesh that Draco compressed; what its accessors declare stays right.
#[cfg(feature = "draco")]
#[test]
#[ignore = "the decoder reserves what a file asks for before it looks whether that is there, and a reservation that fails ends the process; the feature stays off until this passes"]
fn gltf_draco() {
    let sheet: Vec<u8> = (0..SHEET.len() / 2)
        .map(|i| u8::from_str_radix(&SHEET[2 * i..2 * i + 2], 16).expect("digits"))
        .collect();
    fuzz(&[sheet], |bytes| {
        let length = bytes.len();
        let json = format!(
            "{{{BEGINNING}\"extensionsUsed\": [\"KHR_draco_mesh_compression\"], \"buffers\": [{{\"byteLength\": {length}}}],
            \"bufferViews\": [{{\"buffer\": 0, \"byteLength\": {length}}}],
            \"accessors\": [{{\"componentType\": 5126, \"count\": 11, \"type\": \"VEC3\"}},
            {{\"componentType\": 5126, \"count\": 11, \"type\": \"VEC2\"}}, {{\"componentType\": 5123, \"count\": 24, \"type\": \"SCALAR\"}}],
            \"meshes\": [{{\"primitives\": [{{\"attributes\": {{\"POSITION\": 0, \"TEXCOORD_0\": 1}}, \"indices\": 2,
            \"extensions\": {{\"KHR_draco_mesh_compression\": {{\"bufferView\": 0, \"attributes\": {{\"POSITION\": 0, \"TEXCOORD_0\": 1}}}}}}}}]}}],
            \"nodes\": [{{\"mesh\": 0}}]}}"
        );
        scene_with("a.glb", &glb(json.as_bytes(), bytes), "a.glb");
    });
}

/// Pictures of Basis Universal: one block in each of four corners, its colours as they come.
#[test]
fn basisu() {
    let words = |words: &[u32]| -> Vec<u8> { words.iter().flat_map(|w| w.to_le_bytes()).collect() };
    let mut file = b"\xabKTX 20\xbb\r\n\x1a\n".to_vec();
    file.extend(words(&[0, 1, 8, 8, 0, 0, 1, 1, 0, 104, 44, 0, 0, 0, 0, 0, 0, 148, 0, 64, 0, 64, 0]));
    file.extend(words(&[
        44,
        0,
        2 | 40 << 16,
        166 | 1 << 8 | 2 << 16,
        0x0303,
        16,
        0,
        127 << 16 | 3 << 24,
        0,
        0,
        u32::MAX,
    ]));
    // Every first byte chooses a mode.
    let corpus: Vec<Vec<u8>> = (0..32u8)
        .map(|mode| {
            file.iter()
                .copied()
                .chain((0..64u8).map(|i| if i % 16 == 0 { mode } else { i.wrapping_mul(37) }))
                .collect()
        })
        .collect();
    fuzz(&corpus, |bytes| scene_with("a.png", bytes, "a.obj"));
}

#[test]
fn sidecar() {
    let corpus = [
        SIDECAR.as_bytes().to_vec(),
        of_scene("gallery", "gallery.toml", 20_000),
        of_scene("box", "box.toml", 20_000),
    ];
    fuzz(&corpus, |bytes| scene_with("a.toml", bytes, "a.toml"));
}

fn pictures(formats: &[image::ImageFormat]) {
    let corpus: Vec<Vec<u8>> = formats.iter().map(|f| picture(*f)).collect();
    fuzz(&corpus, |bytes| scene_with("a.png", bytes, "a.obj"));
}

/// Formats are told by content, so one name will do.
#[test]
fn png_and_jpeg() {
    pictures(&[image::ImageFormat::Png, image::ImageFormat::Jpeg]);
}

#[test]
fn tga_and_bmp() {
    let corpus: Vec<Vec<u8>> = [image::ImageFormat::Tga, image::ImageFormat::Bmp].map(picture).to_vec();
    fuzz(&corpus, |bytes| {
        scene_with("a.png", bytes, "a.obj");
    });
}

#[test]
fn hdr_and_exr() {
    let corpus: Vec<Vec<u8>> = [image::ImageFormat::Hdr, image::ImageFormat::OpenExr].map(picture).to_vec();
    fuzz(&corpus, |bytes| scene_with("a.exr", bytes, "a.toml"));
}

/// A kept bake with its key and the number of triangles.
fn baked() -> &'static (Vec<u8>, [u8; 32], usize) {
    static BAKED: OnceLock<(Vec<u8>, [u8; 32], usize)> = OnceLock::new();
    BAKED.get_or_init(|| {
        let scene = load(&root().join("scenes/diffuse/diffuse.toml")).expect("a scene").scene;
        let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
        let settings =
            BakeSettings { texels: 256, particles: Some(1000), error: None, ..BakeSettings::default() };
        let made = bake(Indexed { scene: &scene, accel: &accel, lights: &lights }, &settings, &|_| true);
        let key = cache_key(&scene, &settings);
        let bytes = encode(&key, &made.illumination).expect("a bake in bytes");
        (bytes, key, scene.mesh.triangles.len())
    })
}

fn read_bake(file: &Path, bytes: &[u8]) {
    let (_, key, triangles) = baked();
    fs::write(file, bytes).expect("a file");
    match load_illumination(file, key, *triangles) {
        Ok(illumination) => assert!(illumination.is_sound()),
        Err(e) => assert!(!e.to_string().is_empty()),
    }
}

#[test]
fn bakes() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("bake");
    fuzz(std::slice::from_ref(&baked().0), |bytes| read_bake(&file, bytes));
}

#[test]
fn bakes_behind_their_checksums() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("bake");
    check!().with_type::<Vec<Edit>>().for_each(|edits| {
        read_bake(&file, &sealed::sealed_bake(&baked().0, |plain| edited(plain, edits)));
    });
}

/// A ring of 8 players and 4 tokens, recorded on one thread.
fn recorded(hashing: Hashing) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("ring.fvlog");
    let config = Config { hashing, record: Some(Record::File(path.clone())), ..Config::live(0) };
    let (mut runtime, _) = Runtime::build(config, |wiring| ring::wire(wiring, 8, 4, 20)).expect("builds");
    assert_eq!(runtime.pump(Limit::IDLE), Exit::Idle);
    runtime.shutdown(std::time::Duration::from_secs(60));
    fs::read(path).expect("a recording")
}

/// Asks all that can be asked of a recording, and replays it where it is of the same system.
fn read_recording(bytes: &[u8]) {
    let begun = std::time::Instant::now();
    match Trace::from_bytes(bytes) {
        Ok(trace) => {
            let stat = trace.stat();
            let actors = || (0..trace.header().nodes.len() as u32).map(ActorId);
            assert_eq!(stat.deliveries, actors().map(|actor| trace.deliveries(actor)).sum::<u64>());
            for actor in actors() {
                assert_eq!(trace.first_difference(&trace, actor), None);
                trace.marks(actor).for_each(drop);
                trace.events(actor).take(1000).for_each(drop);
                let deliveries = trace.deliveries(actor);
                assert_eq!(trace.delivery(actor, deliveries), None);
                assert!(deliveries == 0 || trace.delivery(actor, deliveries - 1).is_some());
            }
            let wire = |wiring: &mut foveal_runtime::Wiring| ring::wire(wiring, 8, 4, 20);
            if let Ok((mut runtime, _)) = Runtime::build(Config::replay(Arc::new(trace), 0), wire) {
                let report = runtime.replay();
                assert!(!report.complete || report.deliveries == report.recorded);
            }
        }
        Err(e) => assert!(!e.to_string().is_empty()),
    }
    assert!(begun.elapsed() < std::time::Duration::from_secs(10), "{:?}", begun.elapsed());
}

/// Walks that were kept, and a small system that can be replayed here.
fn recordings_kept() -> Vec<Vec<u8>> {
    let mut corpus = Vec::new();
    for entry in fs::read_dir(root().join("traces")).expect("traces").flatten() {
        if entry.path().extension().is_some_and(|e| e == "fvl") {
            corpus.push(fs::read(entry.path()).expect("a recording"));
        }
    }
    corpus.sort_by_key(Vec::len);
    corpus.retain(|file| Trace::from_bytes(file).is_ok_and(|trace| trace.complete()));
    corpus.truncate(2);
    corpus.extend([Hashing::Said, Hashing::Exact, Hashing::Every(16), Hashing::Off].map(recorded));
    corpus
}

#[test]
fn recordings() {
    fuzz(&recordings_kept(), read_recording);
}

#[test]
fn recordings_behind_their_checksums() {
    let corpus = recordings_kept();
    for file in &corpus {
        let again = sealed::sealed_recording(file, 0, <[u8]>::to_vec);
        assert_eq!(Trace::segments(&again).expect("sealed"), Trace::segments(file).expect("kept"));
        assert_eq!(&sealed::with_block(file, 0, <[u8]>::to_vec), file);
    }
    check!().with_type::<(u8, u16, Vec<Edit>)>().for_each(|(which, part, edits)| {
        let file = &corpus[usize::from(*which) % corpus.len()];
        read_recording(&sealed::sealed_recording(file, *part, |bytes| edited(bytes, edits)));
    });
}

#[test]
fn blocks_of_recordings_behind_their_checksums() {
    let corpus = recordings_kept();
    check!().with_type::<(u8, u16, Vec<Edit>)>().for_each(|(which, block, edits)| {
        let file = &corpus[usize::from(*which) % corpus.len()];
        read_recording(&sealed::with_block(file, *block, |bytes| edited(bytes, edits)));
    });
}
