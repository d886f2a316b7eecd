//! Measurements on tiny input, so that they never rot; what they say of time is nobody's business here.

use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::report::fits_any_size;
use crate::support::browser::Browser;
use crate::support::{Foveal, folder};

fn row<'a>(document: &'a Value, what: &str) -> &'a Value {
    let rows = document["rows"].as_array().expect("rows");
    rows.iter().find(|r| r["what"].as_str().is_some_and(|w| w.contains(what))).unwrap_or_else(|| {
        panic!("no {what} in {document}");
    })
}

/// A thousand frames on a virtual clock: nothing grows, nothing is lost.
#[test]
fn a_thousand_frames_leave_nothing_behind() {
    let d = Foveal::new("bench soak --frames 1000").json();
    assert_eq!(d["schema"], "foveal.bench.soak/1");
    assert_eq!((&row(&d, "lost jobs")["value"], &row(&d, "nobody got")["value"]), (&0.0.into(), &0.0.into()));
    // Of 20 MiB: an allocator's pages come and go.
    let growth = row(&d, "growth over the second half")["value"].as_f64().expect("a number");
    assert!(growth < 5.0, "{d}");
    let messages = d["rows"].as_array().and_then(|rows| rows.last()).expect("rows");
    assert!(messages["what"] == "messages" && messages["value"].as_f64() > Some(10_000.0), "{d}");
}

/// A short recording: made, looked at and asked, with all that is told of it.
#[test]
fn a_recording_is_looked_at_and_asked() {
    let d = Foveal::new("bench seeks --frames 8 --size 48x32 --looks 2 --runs 1").json();
    assert_eq!(d["schema"], "foveal.bench.seeks/1");
    for what in ["the log", "order and hashes", "the first", "later", "stands open", "in_flight"] {
        assert!(row(&d, what)["value"].is_number(), "{what}: {d}");
    }
}

/// What glTF costs stands beside what cannot be done without.
#[test]
fn gltf_beside_its_pictures_and_plastic() {
    let d = Foveal::new("bench gltf --runs 1").json();
    assert_eq!(d["schema"], "foveal.bench.gltf/1");
    assert_eq!(row(&d, "load atelier, 4 pictures")["peer"], "decoding alone");
    for what in ["without maps", "with maps"] {
        assert_eq!((&row(&d, what)["peer"], row(&d, what)["ratio"].is_number()), (&"plastic".into(), true));
    }
}

/// Files of triangles and rays are traced, and broken ones refused.
#[test]
fn rays_of_files() {
    let folder = folder("rays");
    let mut soup = b"SOUP".to_vec();
    let words = |values: &[u32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let floats = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    soup.extend(words(&[1, 4, 2]));
    soup.extend(floats(&[0.0; 19]));
    soup.extend(floats(&[-1.0, -1.0, 2.0, 1.0, -1.0, 2.0, 1.0, 1.0, 2.0, -1.0, 1.0, 2.0]));
    soup.extend(words(&[0, 1, 2, 0, 2, 3]));
    fs::write(folder.join("a.soup"), &soup).expect("a file");
    let mut rays = Vec::new();
    for i in 0..64 {
        rays.extend(floats(&[0.0, 0.0, 0.0, 0.0, i as f32 / 64.0 - 0.5, 0.3, 1.0, f32::INFINITY]));
    }
    for kind in ["primary", "bounce", "shadow"] {
        fs::write(folder.join(format!("a.{kind}.rays")), &rays).expect("a file");
    }
    fs::write(folder.join("beside.csv"), "other,label,a,bounce,1,64,0.1,0.1,1.0,2.0,64,1,1,1\n")
        .expect("a file");
    let bench = |soup: &str| {
        Foveal::new("bench rays --runs 1 --threads 1 --soup")
            .arg(folder.join(soup))
            .arg("--rays")
            .arg(folder.join("a"))
            .arg("--beside")
            .arg(folder.join("beside.csv"))
    };
    let d = bench("a.soup").json();
    for what in ["a, primary, 1 thread", "a, bounce, 1 thread", "a, shadow, 1 thread"] {
        assert!(row(&d, what)["peer"].as_str().is_some_and(|p| p.starts_with("obvhs")), "{d}");
    }
    let beside = d["rows"].as_array().expect("rows").iter().filter(|r| r["peer"] == "other, label").count();
    assert_eq!(beside, 1, "{d}");
    for (name, bytes) in [("cut", &soup[..soup.len() - 2]), ("none", &b"SOUR"[..])] {
        fs::write(folder.join(name), bytes).expect("a file");
        bench(name).fails(3, &[name]);
    }
}

/// Curves and pictures at equal time, of orders and of plain alternatives, against both kinds of reference.
#[test]
fn errors_beside_plain_alternatives() {
    let out = folder("error");
    let line = "bench error --plain --quick --scenes box --size 24x18 --frames 3 --runs 2 --reference-spp 8 \
                --walk-spp 4 --path-spp 4 --out";
    let d = Foveal::new(line).arg(&out).json();
    let references = |what: &str| row(&d, what)["reference"].as_str().map(str::to_owned);
    let [traced, path] =
        ["traced, 1 sample per pixel", "path, 8 samples per pixel"].map(|r| Some(r.to_owned()));
    for way in ["utility", "√5 order", "scan order"] {
        assert_eq!(references(&format!("box, against traced: {way}, time to")), traced);
        assert_eq!(references(&format!("box, against path: {way}, time to")), path);
        assert_eq!(references(&format!("box, walking, against traced: {way}")), traced);
    }
    assert_eq!(references("box, against path: path tracing, full frame, time to FLIP ≤ 0.05"), path);
    let value =
        |what: &str| row(&d, what)["value"].as_f64().unwrap_or_else(|| panic!("no value of {what}: {d}"));
    // Orders end where the converged view is.
    let floor = value("box, against path: converged view (floor)");
    assert!(floor > 0.0 && row(&d, "utility, time to FLIP ≤ 0")["value"].is_number());
    assert!(value("box, against path: refined view, 8 samples per pixel") > 0.0);
    // Walks: of non-diffuse pixels, of all, and in JOD; the floor is better than paths that fit into a frame.
    let of = |way: &str, unit: &str| -> Vec<f64> {
        let begins = format!("box, walking, against path: {way}");
        let rows = d["rows"].as_array().expect("rows").iter();
        let rows =
            rows.filter(|r| r["what"].as_str().is_some_and(|w| w.starts_with(&begins)) && r["unit"] == unit);
        rows.map(|r| r["value"].as_f64().expect("a value")).collect()
    };
    let (paths, converged) = ("path tracing, full frame", "converged view (floor)");
    for (unit, count) in [("mean FLIP", 2), ("JOD", 1)] {
        assert_eq!([of(paths, unit).len(), of(converged, unit).len()], [count; 2], "{d}");
    }
    assert!(of(converged, "mean FLIP")[1] < of(paths, "mean FLIP")[1], "{d}");
    assert!(value("paths per pixel that a frame has time for") > 0.0);
    let csv = fs::read_to_string(out.join("error-plain.csv")).expect("a table");
    assert!(csv.lines().count() > 100 && !csv.contains("NaN"), "{csv}");
    for (motion, reference, spp) in
        [("still", "traced", 1), ("still", "path", 8), ("walking", "traced", 1), ("walking", "path", 4)]
    {
        let ends = format!(",{reference},{spp}");
        assert!(
            csv.lines().any(|l| l.starts_with(&format!("box,{motion},")) && l.ends_with(&ends)),
            "{ends}"
        );
    }
    let page = fs::read_to_string(out.join("report.html")).expect("a page");
    // Each plot twice, once of them for a phone.
    assert!(page.matches("<svg").count() == 8 && page.matches("<img").count() >= 30);
    for file in ["still", "still-path", "walking", "walking-path"] {
        assert!(out.join(format!("error-box-{file}.svg")).exists());
    }
}

/// Whoever doubts our figures measures in a scene of theirs.
#[test]
fn errors_of_every_order_in_a_scene_of_ones_own() {
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes");
    let measure = |scene: &Path| {
        Foveal::new("bench error --size 24x18 --frames 2 --runs 3 --policies utility,uniform").arg(scene)
    };
    let out = folder("own");
    let d = measure(&scenes.join("duck/duck.toml")).arg("--out").arg(&out).json();
    for what in ["duck, still: utility", "duck, walking: uniform", "all scenes, still and walking: utility"] {
        let found = row(&d, what);
        assert!(found["runs"] == 3 && found["band"].as_array().is_some_and(|b| b.len() == 2), "{found}");
    }
    assert_eq!(d["rows"].as_array().expect("rows").iter().filter(|r| r["unit"] == "JOD").count(), 2);
    let csv = fs::read_to_string(out.join("error-curves.csv")).expect("a table");
    assert_eq!(csv.lines().count(), 1 + 2 * 3 * (17 + 2));
    let page = fs::read_to_string(out.join("report.html")).expect("a page");
    // Two pictures and what they should be, still and walking; and in both parts one of them under a line.
    assert!(page.contains("duck, walking") && page.matches("<img").count() == 6 + 4);
    assert!(page.contains("side by side") && page.contains("difference (FLIP)"));
    if let Some(browser) = Browser::open() {
        fits_any_size(&mut browser.page(), &out.join("report.html"), 1);
    }
    let d = measure(&scenes.join("diffuse/diffuse.toml")).json();
    assert!(d["notes"].to_string().contains("nothing that its first camera sees is corrected"), "{d}");
    measure(Path::new("nowhere.obj")).fails(3, &["nowhere.obj"]);
    measure(Path::new("nowhere")).fails(2, &["nowhere", "box"]);
}

#[cfg(feature = "serve")]
#[test]
fn the_browser_s_door_is_measured() {
    let d = Foveal::new("bench serve --runs 1 --size 64x48 --walk 1s").json();
    assert_eq!(d["schema"], "foveal.bench.serve/1");
    let rows = d["rows"].as_array().expect("rows");
    assert!(rows.len() >= 8 && rows.iter().all(|row| row["value"].is_number()), "{d}");
}
