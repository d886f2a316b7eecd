//! The program at the ends of its options: it ends, in bounded memory, with the reference.

use crate::support::{CHEAP_BAKE, Foveal, assert_same_bits, folder, picture, scene};

use super::Files;

/// No walk here needs more; the program alone takes about 60 MB.
const MEMORY: u64 = 500 << 20;

fn converges(file: &std::path::Path, size: &str, options: &str) {
    let (out, exr) = (folder("walked"), folder("traced").join("traced.exr"));
    let what = format!("{} {size} {options}", file.display());
    let line =
        format!("walk --frames 1 --until-converged --size {size} --workers 2 {options} {CHEAP_BAKE} --out");
    let d = Foveal::new(&line).arg(&out).arg(file).json();
    assert_eq!((&d["converged"], &d["lost_jobs"]), (&true.into(), &0.into()), "{what}");
    assert!(d["peak_memory_bytes"].as_u64() < Some(MEMORY), "{what}: {}", d["peak_memory_bytes"]);
    let line = format!("reference --kind traced --size {size} {CHEAP_BAKE} --out");
    Foveal::new(&line).arg(&exr).arg(file).ok();
    assert_same_bits(&picture(&out.join("last.exr")), &picture(&exr), &what);
}

#[test]
fn jobs_of_one_sample_and_of_a_million() {
    for options in ["--n-job 1 --fps 1000", "--n-job 1000000 --fps 40"] {
        converges(&scene("box"), "48x36", options);
    }
}

#[test]
fn one_and_a_thousand_frames_per_second() {
    for options in ["--fps 1", "--fps 1000"] {
        converges(&scene("box"), "32x24", options);
    }
}

#[test]
fn one_pixel_and_one_column() {
    for size in ["1x1", "1x4096", "3x1"] {
        converges(&scene("box"), size, "--fps 40");
    }
}

#[test]
fn the_coarsest_and_the_finest_levels() {
    for options in ["--levels 0", "--levels 7", "--environment-budget 0"] {
        converges(&scene("table"), "40x30", &format!("{options} --fps 40"));
    }
}

/// Samples that never age and samples that always do; whatever was kept, the view converges to the reference.
#[test]
fn ageing_at_its_ends() {
    for options in ["--delta 0", "--delta 1"] {
        converges(&scene("box"), "40x30", &format!("{options} --fps 40"));
    }
    for options in ["--delta 0", "--delta 1", "--max-age 0", "--n-min 0", "--saliency 0", "--reduction 0"] {
        let line = format!("walk --frames 8 --fps 40 --until-converged --size 40x30 {options} {CHEAP_BAKE}");
        let d = Foveal::new(&line).arg(scene("box")).json();
        assert_eq!((&d["converged"], &d["lost_jobs"]), (&true.into(), &0.into()), "{options}");
        assert!(d["peak_memory_bytes"].as_u64() < Some(MEMORY), "{options}: {}", d["peak_memory_bytes"]);
    }
}

/// A room with one object of each kind, seen through a pinhole and through a fish's eye.
#[test]
fn narrow_and_wide_views() {
    for fov in [1.0, 170.0] {
        let file = Files::furnished().write_with(
            "view",
            glam::Vec3::new(0.0, 0.0, 0.95),
            glam::Vec3::ZERO,
            fov,
            |p| p,
        );
        converges(&file, "40x30", "--fps 40");
    }
}
