//! `foveal explain`: what a scene needs, what is skipped, and why.

use std::path::PathBuf;

use clap::Args;
use serde_json::{Value, json};

use foveal::geometry::Accel;
use foveal::scene::plan::ScenePlan;
use foveal::scene::{ExtensionUse, Scene, ThingId};

use foveal_engine::failure::Failure;
use foveal_engine::opened::{camera, load_scene_as};
use foveal_engine::pick::{Picked, named};
use foveal_terminal::arguments::Size;
use foveal_terminal::light::ReadingArguments;
use foveal_terminal::print::{print_json, print_line};

use crate::replay::pixel;

/// Arguments of `foveal explain`.
#[derive(Args, Debug)]
pub struct ExplainArguments {
    /// OBJ or glTF file, or a .toml sidecar
    scene: PathBuf,
    /// Also say what the centre of a pixel shows: its name in the file, material and position
    #[arg(long, value_name = "X,Y", value_parser = pixel)]
    pick: Option<(u32, u32)>,
    /// Camera for --pick (default: the first)
    #[arg(long, value_name = "NAME", requires = "pick")]
    camera: Option<String>,
    /// Picture size for --pick
    #[arg(long, value_name = "WxH", default_value = "512x512", requires = "pick")]
    size: Size,
    #[command(flatten)]
    reading: ReadingArguments,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// The parts of a plan as JSON.
pub fn plan_json(plan: &ScenePlan) -> Value {
    plan.parts.iter().map(|p| json!({"part": p.part, "needed": p.needed, "why": p.why})).collect()
}

/// Things that are told by name.
const NAMED_MAX: usize = 8;

fn things(scene: &Scene) -> String {
    let names: Vec<&str> = scene.things.iter().take(NAMED_MAX).map(|thing| thing.path.as_str()).collect();
    let more = if scene.things.len() > NAMED_MAX { ", …" } else { "" };
    format!("{}: {}{more}", scene.things.len(), names.join(", "))
}

/// What a pixel shows; null for the environment.
fn picked(scene: &Scene, a: &ExplainArguments) -> Result<Option<Option<Picked>>, Failure> {
    let Some((x, y)) = a.pick else { return Ok(None) };
    let (width, height) = (a.size.width, a.size.height);
    if x >= width || y >= height {
        return Err(Failure::Usage(format!("no pixel {x},{y}; the picture has {width} × {height}")));
    }
    let view = camera(scene, a.camera.as_deref())?;
    let frame = view.camera.frame(width, height);
    Ok(Some(Picked::seen(scene, &Accel::build(scene), &frame, (x, y))))
}

fn facts(scene: &Scene) -> Vec<(&'static str, String)> {
    vec![
        ("triangles", scene.mesh.triangles.len().to_string()),
        ("materials", scene.materials.len().to_string()),
        ("textures", scene.textures.len().to_string()),
        ("things", things(scene)),
        ("objects", format!("{} non-diffuse", scene.objects.len().saturating_sub(1))),
        ("cameras", scene.cameras.iter().map(|c| c.name.as_str()).collect::<Vec<_>>().join(", ")),
        ("paths", scene.paths.iter().map(|p| p.name.as_str()).collect::<Vec<_>>().join(", ")),
    ]
}

/// Runs the command.
pub fn run(a: &ExplainArguments) -> Result<(), Failure> {
    let (scene, warnings) = load_scene_as(&a.scene, &a.reading.reading())?;
    let plan = ScenePlan::new(&scene, &scene.budget);
    let picked = picked(&scene, a)?;
    if a.json {
        let mut document = json!({
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
            "things": scene.things.iter().enumerate()
                .map(|(id, thing)| named(ThingId(id as u32), thing)).collect::<Vec<_>>(),
            "extensions": scene.extensions.iter().map(|e| json!({
                "name": e.name, "times": e.times, "became": e.became,
            })).collect::<Vec<_>>(),
            "parts": plan_json(&plan),
            "warnings": warnings,
        });
        if let Some(picked) = picked {
            document["picked"] = picked.map_or(Value::Null, |picked| picked.document());
        }
        print_json(&document);
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
    if let (Some((x, y)), Some(picked)) = (a.pick, picked) {
        let told = picked.map_or_else(|| "the environment".to_owned(), |picked| picked.told());
        print_line(&format!("  at {x},{y}: {told}"));
    }
    for part in &plan.parts {
        print_line(&format!("{} {:22} {}", if part.needed { "needs" } else { "skips" }, part.part, part.why));
    }
    Ok(())
}
