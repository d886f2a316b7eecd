//! Textures under a limit: it holds at every moment, what is approached comes while other things shrink, and all of it
//! replays.

use serde_json::Value;

use crate::support::{Foveal, folder, scene};

/// A walk through the gallery, past its paintings and up to some.
fn walk(more: &str) -> Value {
    let words = format!("walk --frames 36 --fps 8 --size 288x216 --workers 2 --quick {more}");
    Foveal::new(&words).arg(scene("gallery")).json()
}

fn list<'d>(d: &'d Value, key: &str) -> &'d Vec<Value> {
    d[key].as_array().unwrap_or_else(|| panic!("{key} in {d}"))
}

#[test]
fn the_limit_holds_while_levels_come_and_go() {
    let limit = 450_000;
    let d = walk(&format!("--texture-budget {limit}"));
    let textures = &d["textures"];
    for count in ["peak_used_bytes", "peak_held_bytes"] {
        let bytes = textures[count].as_u64().expect("a count");
        assert!(bytes > limit / 2 && bytes <= limit, "{count}: {bytes} of {limit}");
    }
    // Figure 13: while the viewer goes up to a picture, its finer levels arrive and others lose theirs.
    let finest = |point: &Value| -> Vec<u64> {
        list(point, "finest").iter().map(|level| level.as_u64().expect("a level")).collect()
    };
    let over_time: Vec<Vec<u64>> = list(textures, "over_time").iter().map(finest).collect();
    let settled = &over_time[over_time.len() / 4..];
    let pairs = || (0..settled.len()).flat_map(|a| (a + 1..settled.len()).map(move |b| (a, b)));
    let exchanged = pairs().any(|(a, b)| {
        let moved = |better: bool| {
            settled[a].iter().zip(&settled[b]).any(|(x, y)| if better { y < x } else { y > x })
        };
        moved(true) && moved(false)
    });
    assert!(exchanged, "nothing came while another went: {settled:?}");
    for line in list(textures, "bill") {
        assert!(line["given_bytes"].as_u64() <= Some(limit), "{line}");
        // Masks and normals are there in full whatever is shown.
        assert!(line["pinned"] == false || line["given_level"] == 0, "{line}");
    }
    assert!(textures["drops"].as_u64() > Some(0) && textures["levels_loaded"].as_u64() > Some(20));
}

#[test]
fn without_pressure_nothing_is_managed() {
    let words = "walk --frames 2 --fps 20 --size 64x48 --quick --texture-budget 64MiB";
    let d = Foveal::new(words).arg(scene("gallery")).json();
    assert!(d["textures"].is_null(), "{}", d["textures"]);
}

#[test]
fn too_small_a_limit_says_which_would_do() {
    let small = Foveal::new("walk --frames 1 --quick --texture-budget 1kB").arg(scene("gallery"));
    let ended = small.run();
    assert_eq!(ended.code, Some(4), "{}", ended.err);
    let smallest =
        ended.err.split("works is ").nth(1).and_then(|rest| rest.split(' ').next()).expect("a number");
    let smallest: u64 = smallest.parse().expect("bytes");
    let with = |bytes: u64| {
        let words = format!("walk --frames 1 --quick --size 64x48 --texture-budget {bytes}");
        Foveal::new(&words).arg(scene("gallery")).run().code
    };
    assert_eq!((with(smallest), with(smallest - 1)), (Some(0), Some(4)));
}

#[test]
fn a_walk_with_few_textures_replays() {
    let trace = folder("textures").join("walk.fvl");
    let words =
        "walk --frames 12 --fps 10 --size 96x72 --workers 2 --quick --texture-budget 300kB --json --record";
    let ended = Foveal::new(words).arg(&trace).arg(scene("gallery")).ok();
    let d: Value = serde_json::from_str(&ended.out).expect("a document");
    assert!(d["textures"]["levels_loaded"].as_u64() > Some(5), "{}", d["textures"]);
    for workers in [1, 3] {
        let d = Foveal::new(&format!("replay --verify --workers {workers}")).arg(&trace).json();
        assert!(d["diverged"].is_null(), "{workers} workers: {}", d["diverged"]);
    }
}

#[test]
fn a_still_view_under_pressure_converges() {
    let words = "walk --camera painting --frames 1 --until-converged --size 96x72 --fps 30 --quick --texture-budget 400kB";
    let d = Foveal::new(words).arg(scene("gallery")).json();
    assert_eq!(d["converged"], true);
    assert!(d["textures"]["peak_held_bytes"].as_u64() <= Some(400_000));
}
