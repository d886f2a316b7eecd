//! Pictures that know their noise: `reference --kind truth` and `path`, held against each other by `compare --blocks`.

use std::path::Path;

use serde_json::Value;

use crate::support::{Foveal, folder, scene};

fn compared(a: &Path, b: &Path) -> Value {
    Foveal::new("compare --blocks 8").arg(a).arg(b).json()["blocks"].clone()
}

#[test]
fn truth_and_paths_differ_by_noise_alone() {
    let out = folder("truth");
    let made = |kind: &str, more: &str, name: &str| {
        let file = out.join(name);
        let line = format!("reference --kind {kind} --size 64x64 {more} --out");
        (Foveal::new(&line).arg(&file).arg(scene("diffuse")).json(), file)
    };
    let (truth, a) = made("truth", "--until-error 3%", "truth.exr");
    let (paths, b) = made("path", "--spp 64 --seed 3", "path.exr");
    assert_eq!((truth["kind"].as_str(), paths["spp"].as_u64()), (Some("truth"), Some(64)));
    let spp = truth["spp"].as_u64().expect("samples");
    assert!(spp.is_multiple_of(16) && truth["error"].as_f64() <= Some(0.03), "{truth}");
    let blocks = compared(&a, &b);
    assert_eq!(blocks["agreement"]["holds"], true, "{blocks}");
    let told = [&blocks["noise"]["reference"], &paths["error"]].map(|v| v.as_f64().expect("an error"));
    assert!((told[0] / told[1] - 1.0).abs() < 1e-9, "{told:?}");
    // The same samples again are the same picture, and know the same of themselves.
    let (again, c) = made("truth", &format!("--spp {spp}"), "again.exr");
    assert_eq!(again["error"], truth["error"]);
    assert_eq!(std::fs::read(&a).expect("a file"), std::fs::read(&c).expect("a file"));
    // Without batches nothing is said of noise.
    let (few, d) = made("path", "--spp 8", "few.exr");
    assert!(few["error"].is_null() && compared(&d, &b)["agreement"].is_null(), "{few}");
    let line = "reference --kind traced --until-error 1% --out";
    assert_eq!(Foveal::new(line).arg(out.join("no.exr")).arg(scene("diffuse")).run().code, Some(2));
}
