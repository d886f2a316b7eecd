//! What a scene does not need does not run.

use serde_json::Value;

use crate::support::{CHEAP_BAKE, Foveal, scene};

fn needs(document: &Value, part: &str) -> bool {
    let parts = document["plan"].as_array().expect("a plan");
    let found = parts.iter().find(|p| p["part"] == part).unwrap_or_else(|| panic!("no {part} in {document}"));
    found["needed"].as_bool().expect("yes or no")
}

fn walk(name: &str) -> Value {
    Foveal::new(&format!("walk --baked --frames 6 --fps 20 --size 64x48 --workers 2 {CHEAP_BAKE}"))
        .arg(scene(name))
        .json()
}

/// With diffuse surfaces only, the renderer is alone: it hears of each frame's begin and deadline.
#[test]
fn a_diffuse_scene_starts_one_actor() {
    let d = walk("diffuse");
    for part in ["tracers", "analyzer", "sample cache", "object-id pass"] {
        assert!(!needs(&d, part), "{part}");
    }
    assert_eq!(
        d["samples"],
        serde_json::json!({"traced": 0, "reused": 0, "expired": 0, "splatted": 0, "late": 0, "refined": 0})
    );
    assert_eq!(d["messages"]["delivered"], 2 * 6);
    assert_eq!(d["converged"], true);
}

#[test]
fn a_scene_with_mirrors_starts_all() {
    let d = walk("box");
    for part in ["tracers", "analyzer", "sample cache", "object-id pass"] {
        assert!(needs(&d, part), "{part}");
    }
    assert!(
        d["messages"]["delivered"].as_u64() > Some(4 * 6) && d["samples"]["traced"].as_u64() > Some(0),
        "{d}"
    );
}
