//! What a walk and the other commands leave: pictures, reports, JSON.

use std::fs;

use serde_json::{Value, json};

use crate::support::{CHEAP_BAKE, Foveal, folder, picture, root, scene};

/// Fails unless the document holds all `keys` (`a.b` is b inside a).
fn has(document: &Value, schema: &str, keys: &str) {
    assert_eq!(document["schema"], schema);
    for key in keys.split_whitespace() {
        let pointer = format!("/{}", key.replace('.', "/"));
        assert!(document.pointer(&pointer).is_some(), "{schema} has no {key}: {document}");
    }
}

#[test]
fn a_walk_leaves_pictures_and_reports() {
    // A folder that is not there yet, with a blank and letters beyond ASCII in its name.
    let out = folder("walk").join("größe 1").join("box");
    let d = Foveal::new(&format!("walk --frames 5 --fps 20 --size 64x48 --workers 2 {CHEAP_BAKE} --out"))
        .arg(&out)
        .arg(scene("box"))
        .json();
    has(
        &d,
        "foveal.walk/1",
        "scene size frames workers policy frame_ms.median frame_ms.p95 frame_ms.p99 stage_ms.age \
         stage_ms.display stage_ms.warp_splat stage_ms.correct stage_ms.attention stage_ms.allocate \
         samples.traced samples.reused samples.expired samples.splatted messages.delivered lost_jobs \
         converged plan peak_memory_bytes warnings",
    );
    assert_eq!((&d["scene"], &d["frames"], &d["workers"]), (&"box".into(), &5.into(), &2.into()));
    assert_eq!(d["size"], serde_json::json!([64, 48]));
    assert_eq!(d["lost_jobs"], 0);
    assert!(d["samples"]["traced"].as_u64() > Some(0), "{d}");

    let mut names: Vec<String> = fs::read_dir(&out)
        .expect("the folder")
        .flatten()
        .map(|f| f.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort_unstable();
    let frames = (0..5).map(|i| format!("frame-{i:04}.png"));
    let expected: Vec<String> =
        frames.chain(["last.exr", "report.html", "report.json"].map(str::to_owned)).collect();
    assert_eq!(names, expected);

    let first = picture(&out.join("frame-0000.png"));
    assert_eq!((first.width(), first.height()), (64, 48));
    let last = picture(&out.join("last.exr"));
    assert_eq!((last.width(), last.height()), (64, 48));
    assert!(last.data().iter().all(|c| c.is_finite()) && last.data().iter().any(|c| c.max_element() > 0.05));
    assert!(first != picture(&out.join("frame-0004.png")), "the camera does not move");

    let report = fs::read_to_string(out.join("report.json")).expect("report.json");
    assert_eq!(serde_json::from_str::<Value>(&report).expect("JSON"), d);
    let html = fs::read_to_string(out.join("report.html")).expect("report.html");
    assert!(html.contains("<svg") && html.contains("<img") && html.trim_end().ends_with("</html>"));
    assert!(html.contains("Box with a mirror ball and a glass ball"), "the report names the scene");
    for outside in ["src=\"http", "href=\"http", "src=\"/"] {
        assert!(!html.contains(outside), "the report needs something outside of it: {outside}");
    }
}

/// The same walk from a bare OBJ file, without sidecar: a camera and light are found for it.
#[test]
fn an_obj_alone_is_a_scene() {
    let out = folder("bare");
    fs::copy(root().join("scenes/box/box.obj"), out.join("bare.obj")).expect("a copy");
    fs::copy(root().join("scenes/box/box.mtl"), out.join("box.mtl")).expect("a copy");
    let d =
        Foveal::new(&format!("walk --frames 1 --size 48x36 {CHEAP_BAKE}")).arg(out.join("bare.obj")).json();
    assert_eq!(d["scene"], "bare");
    assert_eq!(d["lost_jobs"], 0);
}

#[test]
fn bakes_are_kept_and_found() {
    let (out, cache) = (folder("bake").join("box.fvbake"), folder("cache"));
    let bake = || {
        Foveal::new(&format!("bake {CHEAP_BAKE} --cache"))
            .arg(&cache)
            .arg("--out")
            .arg(&out)
            .arg(scene("box"))
    };
    let d = bake().json();
    has(&d, "foveal.bake/1", "scene method seconds error texels cached file");
    assert_eq!(d["cached"], false);
    let bytes = fs::read(&out).expect("the bake");
    // The same again has the same bytes, and so has a copy of what the cache keeps.
    let walk =
        || Foveal::new("walk --frames 1 --size 32x24 --texels 8192 --bake").arg(&out).arg(scene("box"));
    walk().ok();
    let walked = format!("walk --baked --frames 1 --size 32x24 {CHEAP_BAKE} --cache");
    Foveal::new(&walked).arg(&cache).arg(scene("box")).ok();
    assert_eq!(bake().json()["cached"], true, "what a walk has baked is found by `bake`");
    assert!(fs::read(&out).expect("the bake") == bytes, "two bakes differ");
    // A bake that was cut short is refused, not drawn with.
    fs::write(&out, &bytes[..bytes.len() / 2]).expect("a shorter file");
    walk().fails(3, &["box.fvbake"]);
}

#[test]
fn explain_and_doctor_answer() {
    for name in ["box", "diffuse"] {
        let d = Foveal::new("explain").arg(scene(name)).json();
        has(&d, "foveal.explain/1", "scene parts");
        for part in d["parts"].as_array().expect("parts") {
            let told = part["part"].is_string() && part["needed"].is_boolean() && part["why"] != "";
            assert!(told, "{name}: {part}");
        }
        let text = Foveal::new("explain").arg(scene(name)).ok().out;
        assert!(text.contains("tracers") && text.contains("skips"), "{text}");
    }
    has(&Foveal::new("doctor").json(), "foveal.doctor/1", "version cores simd adapter display");
    assert!(Foveal::new("doctor").ok().out.contains("processor"));
}

/// Every thing that a file names can be asked for by its pixel, diffuse ones too.
#[test]
fn a_pixel_picks_a_thing_by_its_name() {
    let pick = |name: &str, pixel: &str| {
        let line = format!("explain --pick {pixel} --size 64x48");
        Foveal::new(&line).arg(scene(name)).json()["picked"].clone()
    };
    let d = Foveal::new("explain").arg(scene("box")).json();
    assert!(d.get("picked").is_none());
    let things = d["things"].as_array().expect("things");
    let triangles: u64 = things.iter().filter_map(|thing| thing["triangles"].as_u64()).sum();
    assert_eq!(Some(triangles), d["triangles"].as_u64());
    let wall = pick("box", "2,2");
    let id = wall["thing"]["id"].as_u64().expect("a thing") as usize;
    assert_eq!((&things[id]["path"], &wall["object"]), (&wall["thing"]["path"], &json!(0)), "{wall}");
    assert!(wall["material"].is_string() && wall["distance"].as_f64() > Some(0.0), "{wall}");
    let text = Foveal::new("explain --pick 2,2 --size 64x48").arg(scene("box")).ok().out;
    assert!(text.contains(&format!("at 2,2: {}", wall["thing"]["path"])), "{text}");
    Foveal::new("explain --pick 64,0 --size 64x48").arg(scene("box")).fails(2, &["64,0", "64 × 48"]);
}

/// Results go to standard output, and without a terminal nothing is coloured and no bar is drawn.
#[test]
fn output_is_plain() {
    let ended = Foveal::new(&format!("walk --frames 2 --size 32x24 {CHEAP_BAKE}")).arg(scene("box")).ok();
    assert!(!ended.out.contains('\x1b') && !ended.err.contains('\x1b'));
    assert_eq!(ended.err, "");
    assert!(ended.out.starts_with("2 frames of Box"), "{}", ended.out);
}
