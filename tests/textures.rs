//! Textures under a limit: it holds at every moment, what is approached comes while other things shrink, and all of it
//! replays.

use std::fmt::Write as _;
use std::path::PathBuf;

use image::{DynamicImage, ImageBuffer, Luma, Rgb, Rgba};
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

/// Figure 13: the viewer goes up to a picture on the wall; its full level arrives and others shrink.
#[test]
fn what_the_viewer_goes_up_to_comes_in_full() {
    let copy = folder("approach");
    for file in std::fs::read_dir(scene("gallery").parent().expect("a folder")).expect("a scene").flatten() {
        std::fs::copy(file.path(), copy.join(file.file_name())).expect("a copy");
    }
    let sidecar = copy.join("gallery.toml");
    let mut text = std::fs::read_to_string(&sidecar).expect("a sidecar");
    text += "\n[[path]]\nname = \"approach\"\nkeys = [\n\
        { t = 0.0, eye = [0.3, 1.6, 1.6], target = [-1.6, 1.5, -2.5] },\n\
        { t = 1.5, eye = [0.3, 1.6, 1.6], target = [-1.6, 1.5, -2.5] },\n\
        { t = 3.0, eye = [-1.6, 1.5, -1.75], target = [-1.6, 1.5, -2.5] },\n\
        { t = 9.0, eye = [-1.6, 1.5, -1.75], target = [-1.6, 1.5, -2.5] },\n]\n";
    std::fs::write(&sidecar, text).expect("a sidecar");
    let words =
        "walk --path approach --frames 48 --fps 8 --size 288x216 --workers 2 --quick --texture-budget 450000";
    let d = Foveal::new(words).arg(&sidecar).json();
    let textures = &d["textures"];
    let bill = list(textures, "bill");
    let most =
        (0..bill.len()).max_by_key(|&t| bill[t]["pixels"].as_f64().unwrap_or(0.0) as u64).expect("textures");
    assert_eq!(
        (&bill[most]["texture"], &bill[most]["given_level"]),
        (&"dusk.jpg".into(), &0.into()),
        "{textures}"
    );
    // A moment before, when it was coarser and another was finer than in the end.
    let exchanged = list(textures, "over_time").iter().any(|point| {
        let level = |t: usize| point["finest"][t].as_u64();
        let is_finer = |t: usize| t != most && level(t) < bill[t]["given_level"].as_u64();
        level(most) > Some(0) && (0..bill.len()).any(is_finer)
    });
    assert!(exchanged, "others shrink: {textures}");
    assert!(textures["peak_held_bytes"].as_u64() <= Some(450_000));
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

/// A wall of squares, each with a picture that readers and mip chains have trouble with.
fn odd_pictures() -> PathBuf {
    let folder = folder("odd");
    let grain = |x: u32, y: u32| (37 * x + 101 * y) % 251;
    let save = |name: &str, picture: DynamicImage| picture.save(folder.join(name)).expect("a picture");
    save("one.png", ImageBuffer::from_pixel(1, 1, Rgb([200u8, 60, 60])).into());
    save("wide.png", ImageBuffer::from_fn(16384, 1, |x, y| Luma([grain(x, y) as u8])).into());
    save("primes.png", ImageBuffer::from_fn(97, 211, |x, y| Rgb([grain(x, y) as u8, 120, 80])).into());
    save(
        "deep.png",
        ImageBuffer::from_fn(256, 128, |x, y| Rgb([257 * grain(x, y) as u16, 9999, 60000])).into(),
    );
    let holes = |x, y| Rgba([90, grain(x, y) as u8, 160, if (x / 8 + y / 8) % 2 == 0 { 255 } else { 0 }]);
    save("alpha.png", ImageBuffer::from_fn(256, 256, holes).into());
    save("plain.png", ImageBuffer::from_fn(256, 256, |x, y| Rgb([grain(x, y) as u8; 3])).into());
    let whole = std::fs::read(folder.join("plain.png")).expect("a picture");
    std::fs::write(folder.join("corrupt.png"), &whole[..whole.len() / 3]).expect("a file");
    let pictures = ["one", "wide", "primes", "deep", "alpha", "plain", "corrupt", "missing"];
    let mut mtl = String::from("newmtl Light\nKd 0 0 0\nKe 6 6 6\n");
    let mut obj = String::from("mtllib odd.mtl\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n");
    let mut quad = |name: &str, corners: [[f32; 3]; 4]| {
        for [x, y, z] in corners {
            let _ = writeln!(obj, "v {x} {y} {z}");
        }
        let _ = writeln!(obj, "o {name}\nusemtl {name}\nf -4/1 -3/2 -2/3 -1/4");
    };
    for (i, name) in pictures.into_iter().enumerate() {
        let _ = writeln!(mtl, "newmtl {name}\nKd 1 1 1\nmap_Kd {name}.png");
        let (x, y) = ((i % 4) as f32 - 2.0, (i / 4) as f32);
        quad(name, [[x, y, 0.0], [x + 0.95, y, 0.0], [x + 0.95, y + 0.95, 0.0], [x, y + 0.95, 0.0]]);
    }
    quad("Light", [[-3.0, 4.0, 1.0], [3.0, 4.0, 1.0], [3.0, 4.0, 5.0], [-3.0, 4.0, 5.0]]);
    std::fs::write(folder.join("odd.obj"), obj).expect("a file");
    std::fs::write(folder.join("odd.mtl"), mtl).expect("a file");
    let sidecar = "format = 1\ntitle = \"Odd\"\n[geometry]\nfiles = [\"odd.obj\"]\nup = \"+y\"\n[[camera]]\nname = \"main\"\n\
        eye = [0.0, 1.0, 3.4]\ntarget = [0.0, 1.0, 0.0]\nup = [0.0, 1.0, 0.0]\nfov_y = 45.0\n";
    let file = folder.join("odd.toml");
    std::fs::write(&file, sidecar).expect("a file");
    file
}

#[test]
fn odd_pictures_obey_the_limit_and_bad_ones_are_named() {
    let scene = odd_pictures();
    // The smallest limit is said by the refusal of one that is too small.
    let refused = Foveal::new("walk --frames 1 --quick --texture-budget 1").arg(&scene).run();
    assert_eq!(refused.code, Some(4), "{}", refused.err);
    let walk = |bytes: u64| {
        let out = folder("odd-walk");
        let words = format!(
            "walk --frames 1 --until-converged --fps 20 --size 160x120 --quick --texture-budget {bytes} --out"
        );
        let d = Foveal::new(&words).arg(&out).arg(&scene).json();
        let picture = image::open(out.join("frame-0000.png")).expect("a frame").to_rgb8();
        (d, picture)
    };
    let limit = 300_000;
    let (d, limited) = walk(limit);
    for count in ["peak_used_bytes", "peak_held_bytes"] {
        assert!(d["textures"][count].as_u64() <= Some(limit), "{count}: {}", d["textures"][count]);
    }
    assert!(d["textures"]["levels_loaded"].as_u64() > Some(10), "{}", d["textures"]);
    for name in ["corrupt.png", "missing.png"] {
        let told = list(&d, "warnings").iter().filter(|w| w.as_str().is_some_and(|w| w.contains(name)));
        assert_eq!(told.count(), 1, "{name} in {}", d["warnings"]);
    }
    // Nothing is black, and what is missing is a checker that nobody overlooks.
    let (all, full) = walk(1 << 30);
    assert!(all["textures"].is_null());
    let of_square = |picture: &image::RgbImage, column: u32, row: u32| {
        let at = |x: u32, y: u32| picture.get_pixel(28 + 27 * column + x, 91 - 27 * row - y).0;
        (0..16).flat_map(|y| (0..16).map(move |x| (x, y))).map(|(x, y)| at(x, y)).collect::<Vec<_>>()
    };
    for (row, column) in (0..2).flat_map(|row| (0..4).map(move |column| (row, column))) {
        // Where the picture with holes is, one looks through.
        if (row, column) != (1, 0) {
            let lit = of_square(&limited, column, row).iter().filter(|p| p.iter().any(|c| *c > 10)).count();
            assert!(lit > 100, "square {column}, {row}: {lit} pixels");
        }
    }
    for column in [2, 3] {
        let mut colours = of_square(&full, column, 1);
        colours.sort_unstable();
        let (first, last) = (colours[0], colours[colours.len() - 1]);
        assert!(first.iter().zip(&last).any(|(a, b)| a.abs_diff(*b) > 40), "{first:?} {last:?}");
    }
}

/// Figure 17's other mode: frames wait until they are good enough.
#[test]
fn quality_is_kept_where_that_is_asked_for() {
    let walk = |mode: &str| {
        let words = format!("walk --frames 5 --fps 200 --size 128x96 --workers 2 --quick {mode}");
        Foveal::new(&words).arg(scene("duck")).json()
    };
    let qualities = |d: &Value| -> Vec<f64> {
        let all = list(&d["over_time"], "quality").iter();
        all.map(|q| q.as_f64().unwrap_or(f64::NEG_INFINITY)).collect()
    };
    let kept = walk("--mode fixed-quality --quality -0.05");
    assert_eq!(kept["mode"], "fixed-quality");
    assert!(qualities(&kept).iter().all(|q| *q >= -0.05), "{:?}", qualities(&kept));
    assert_eq!(qualities(&walk("--mode fixed-rate")).len(), 5);
    let usage = Foveal::new("walk --quick --mode fixed-quality --quality 1").arg(scene("duck")).run();
    assert_eq!(usage.code, Some(2), "{}", usage.err);
}

/// The bill names every texture and environment map.
#[test]
fn the_bill_has_maps_too() {
    let words = "walk --camera main --frames 1 --until-converged --fps 20 --size 160x120 --quick --environment-budget 200kB";
    let d = Foveal::new(words).arg(scene("chess")).json();
    let maps = &d["environment_maps"];
    assert!(maps["used_bytes"].as_u64() <= maps["limit_bytes"].as_u64(), "{maps}");
    let lines = list(maps, "bill");
    assert!(!lines.is_empty() && maps["one_more_mib_buys"].as_f64() > Some(0.0), "{maps}");
    let given: u64 = lines.iter().filter_map(|l| l["given_bytes"].as_u64()).sum();
    assert!(given <= 200_000 && lines.iter().any(|l| l["visible_loss"].as_f64() > Some(0.0)), "{maps}");
}
