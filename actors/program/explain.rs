//! `foveal explain`: what a scene needs, what is skipped, and why.

use std::path::PathBuf;

use clap::Args;
use serde_json::{Value, json};

use foveal::scene::plan::ScenePlan;
use foveal::scene::{ExtensionUse, Scene};

use foveal_engine::failure::Failure;
use foveal_engine::opened::load_scene_as;
use foveal_terminal::light::ReadingArguments;
use foveal_terminal::print::{print_json, print_line};

/// Arguments of `foveal explain`.
#[derive(Args, Debug)]
pub struct ExplainArguments {
    /// An OBJ or glTF file or a sidecar
    scene: PathBuf,
    #[command(flatten)]
    reading: ReadingArguments,
    /// One JSON document
    #[arg(long)]
    json: bool,
}

/// The parts of a plan as JSON.
pub fn plan_json(plan: &ScenePlan) -> Value {
    plan.parts.iter().map(|p| json!({"part": p.part, "needed": p.needed, "why": p.why})).collect()
}

fn facts(scene: &Scene) -> Vec<(&'static str, String)> {
    vec![
        ("triangles", scene.mesh.triangles.len().to_string()),
        ("materials", scene.materials.len().to_string()),
        ("textures", scene.textures.len().to_string()),
        ("objects", format!("{} non-diffuse", scene.objects.len().saturating_sub(1))),
        ("cameras", scene.cameras.iter().map(|c| c.name.as_str()).collect::<Vec<_>>().join(", ")),
        ("paths", scene.paths.iter().map(|p| p.name.as_str()).collect::<Vec<_>>().join(", ")),
    ]
}

/// Runs the command.
pub fn run(a: &ExplainArguments) -> Result<(), Failure> {
    let (scene, warnings) = load_scene_as(&a.scene, &a.reading.reading())?;
    let plan = ScenePlan::new(&scene, &scene.budget);
    if a.json {
        print_json(&json!({
            "schema": "foveal.explain/1",
            "scene": scene.name,
            "title": scene.title,
            "triangles": scene.mesh.triangles.len(),
            "materials": scene.materials.len(),
            "textures": scene.textures.len(),
            "objects": scene.objects.iter().enumerate().skip(1).map(|(id, o)| json!({
                "id": id, "name": o.name, "triangles": o.triangles.len(),
                "material": scene.materials[o.material.0 as usize].name,
            })).collect::<Vec<_>>(),
            "extensions": scene.extensions.iter().map(|e| json!({
                "name": e.name, "times": e.times, "became": e.became,
            })).collect::<Vec<_>>(),
            "parts": plan_json(&plan),
            "warnings": warnings,
        }));
        return Ok(());
    }
    print_line(&format!("{} ({})", scene.title, scene.name));
    for (what, value) in facts(&scene) {
        print_line(&format!("  {what:10} {value}"));
    }
    for extension in &scene.extensions {
        let ExtensionUse { name, times, became } = extension;
        print_line(&format!("  {name}, {times} times: {became}"));
    }
    for part in &plan.parts {
        print_line(&format!("{} {:22} {}", if part.needed { "needs" } else { "skips" }, part.part, part.why));
    }
    Ok(())
}
