//! A still view becomes the traced reference, bit for bit: for every bundled scene, any number of tracers,
//! every policy, any size of job; and after a walk too, when most samples were carried along.

use std::fs;
use std::path::Path;

use foveal_files::load::load;

use crate::support::{CHEAP_BAKE, Foveal, assert_same_bits, folder, picture, scene};

const TRACERS: [u32; 4] = [1, 2, 3, 7];
const POLICIES: [&str; 5] = ["attention", "coverage", "uniform", "random", "utility"];

/// The other things that must not matter, one set per walk.
const VARIATIONS: [&str; 4] =
    ["--n-job 256", "--n-job 1 --saliency 1", "--n-job 37 --levels 3", "--n-job 5000 --footprint square"];

/// The traced reference of a view, linear.
fn reference(sidecar: &Path, more: &str) -> foveal::image::Map2d<glam::Vec3> {
    let out = folder("reference").join("traced.exr");
    let d = Foveal::new(&format!("reference --kind traced {CHEAP_BAKE} {more} --out"))
        .arg(&out)
        .arg(sidecar)
        .json();
    assert_eq!((d["schema"].as_str(), d["kind"].as_str()), (Some("foveal.reference/1"), Some("traced")));
    picture(&out)
}

/// Four walks for each scene; over all scenes every number of tracers meets every policy.
fn check(name: &str, shift: usize) {
    let expected = reference(&scene(name), "--size 64x48 --seed 5");
    assert!(expected.data().iter().all(|c| c.is_finite() && c.min_element() >= 0.0), "{name}");
    assert!(expected.data().iter().any(|c| c.max_element() > 0.05), "{name}: the reference is black");
    for (i, tracers) in TRACERS.into_iter().enumerate() {
        let policy = POLICIES[(i + shift) % 5];
        let more = VARIATIONS[(i + 2 * shift) % 4];
        let out = folder(name);
        // At 40 frames per second a busy machine needs several frames, an idle one a single one.
        let d = Foveal::new(&format!(
            "walk --frames 1 --until-converged --size 64x48 --seed 5 --fps 40 --workers {tracers} \
             --policy {policy} {more} {CHEAP_BAKE} --out"
        ))
        .arg(&out)
        .arg(scene(name))
        .json();
        let what = format!("{name}, {tracers} tracers, {policy}, {more}");
        assert_eq!(d["converged"], true, "{what}");
        assert_eq!(d["lost_jobs"], 0, "{what}");
        assert_eq!((d["workers"].as_u64(), d["policy"].as_str()), (Some(tracers.into()), Some(policy)));
        assert_same_bits(&picture(&out.join("last.exr")), &expected, &what);
    }
}

#[test]
fn box_is_the_reference() {
    check("box", 0);
}

#[test]
fn duck_is_the_reference() {
    check("duck", 1);
}

#[test]
fn table_is_the_reference() {
    check("table", 2);
}

#[test]
fn gallery_is_the_reference() {
    check("gallery", 3);
}

#[test]
fn chess_is_the_reference() {
    check("chess", 4);
}

#[test]
fn furnace_is_the_reference() {
    check("furnace", 1);
}

#[test]
fn diffuse_is_the_reference() {
    check("diffuse", 2);
}

/// What a view is refined to is the reference with as many samples; a scene without anything to correct is refined too.
#[test]
fn a_refined_view_is_the_reference_of_many_samples() {
    for (name, workers) in [("box", 1), ("chess", 3), ("diffuse", 2)] {
        let expected = reference(&scene(name), "--size 50x40 --seed 5 --spp 7");
        let out = folder("refined");
        let d = Foveal::new(&format!(
            "walk --frames 1 --until-converged --refine 0 --refine-samples 7 --size 50x40 --seed 5 --fps 40 \
             --workers {workers} {CHEAP_BAKE} --out"
        ))
        .arg(&out)
        .arg(scene(name))
        .json();
        assert_eq!(
            (&d["converged"], &d["samples"]["refined"]),
            (&true.into(), &(50 * 40 * 7).into()),
            "{name}"
        );
        assert_same_bits(&picture(&out.join("last.exr")), &expected, name);
        // A bound on the noise lets quiet tiles end early.
        let d = Foveal::new(&format!(
            "walk --frames 1 --until-converged --refine 0.05 --refine-samples 60 --size 50x40 {CHEAP_BAKE}"
        ))
        .arg(scene(name))
        .json();
        let refined = d["samples"]["refined"].as_u64().expect("a count");
        assert!((16 * 2000..60 * 2000).contains(&refined), "{name}: {refined}");
    }
}

/// The path comes to rest at the start view, so that the reference can be asked for it; it has done so long before the last
/// frame, also where each is done before its deadline and the next begins at once.
#[test]
fn a_walk_that_comes_to_rest_is_the_reference() {
    for (name, workers) in [("box", 1), ("table", 3)] {
        let moved = folder("moved");
        for file in fs::read_dir(scene(name).parent().expect("a folder")).expect("the scene").flatten() {
            fs::copy(file.path(), moved.join(file.file_name())).expect("a copy");
        }
        let sidecar = moved.join(format!("{name}.toml"));
        let view = load(&sidecar).expect("the scene").scene.cameras[0].camera;
        let key = |t: f32, aside: f32| {
            let (eye, target) = (view.eye.to_array(), view.target.to_array());
            format!(
                "{{ t = {t:?}, eye = [{:?}, {:?}, {:?}], target = {target:?} }}",
                eye[0] + aside,
                eye[1],
                eye[2]
            )
        };
        let path = format!("\n[[path]]\nname = \"arrive\"\nkeys = [{}, {}]\n", key(0.0, 0.1), key(0.1, 0.0));
        let text = fs::read_to_string(&sidecar).expect("the sidecar") + &path;
        fs::write(&sidecar, text).expect("the sidecar");

        let out = folder("arrived");
        let d = Foveal::new(&format!(
            "walk --path arrive --frames 40 --fps 20 --until-converged --size 64x48 --workers {workers} \
             {CHEAP_BAKE} --out"
        ))
        .arg(&out)
        .arg(&sidecar)
        .json();
        assert_eq!(d["converged"], true, "{name}");
        assert!(
            d["samples"]["reused"].as_u64() > Some(0),
            "{name}: nothing was carried along: {}",
            d["samples"]
        );
        let expected = reference(&sidecar, "--size 64x48");
        assert_same_bits(&picture(&out.join("last.exr")), &expected, &format!("{name} after a walk"));
    }
}

/// The picture on screen is the tone-mapped reference, and `compare` says so.
#[test]
fn compare_agrees() {
    let (out, png, exr) = (folder("still"), folder("png").join("a.png"), folder("exr").join("a.exr"));
    let walk = format!("walk --frames 1 --until-converged --size 48x36 {CHEAP_BAKE} --out");
    Foveal::new(&walk).arg(&out).arg(scene("box")).ok();
    for file in [&png, &exr] {
        let traced = format!("reference --size 48x36 {CHEAP_BAKE} --out");
        Foveal::new(&traced).arg(file).arg(scene("box")).ok();
    }
    for (ours, theirs) in [(out.join("frame-0000.png"), &png), (out.join("last.exr"), &exr)] {
        let d = Foveal::new("compare --max-flip 0.001").arg(&ours).arg(theirs).json();
        assert_eq!(d["schema"], "foveal.compare/1");
        assert_eq!(
            (&d["identical"], &d["flip"], &d["max_abs"]),
            (&true.into(), &0.0.into(), &0.0.into()),
            "{d}"
        );
        assert!(d["psnr"].is_null() && d["relmse"] == 0.0, "{d}");
    }
    // Other random numbers give another picture; the comparison must see that, too.
    let other = folder("other").join("b.exr");
    let path = "reference --kind path --spp 1 --size 48x36 --out";
    Foveal::new(path).arg(&other).arg(scene("box")).ok();
    let d = Foveal::new("compare").arg(&other).arg(&exr).json();
    assert!(d["identical"] == false && d["flip"].as_f64() > Some(0.0) && d["psnr"].is_number(), "{d}");
    let ended = Foveal::new("compare --max-flip 0.1%").arg(&other).arg(&exr).run();
    assert!(ended.code == Some(1) && ended.err.contains("FLIP"), "{:?} {}", ended.code, ended.err);
}
