//! What a scene does not need does not run.

use std::sync::Arc;

use foveal::display::cpu_pass::{Passes, draw};
use foveal::display::{FrameBuffers, TextureLevel};
use foveal::geometry::{Accel, Ray};
use foveal::scene::Budget;
use foveal::scene::plan::{ScenePlan, Subsystem};
use foveal::splatting::trace::{Owner, trace_samples};
use foveal_actors::settings::Settings;
use foveal_actors::stages::Stage;
use foveal_files::load::load;
use glam::Vec3;
use serde_json::Value;

use crate::support::{CHEAP_BAKE, Foveal, folder, scene};
use crate::system::{System, counted};

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

/// What is skipped is said beforehand, part by part, and why.
#[test]
fn a_scene_s_plan_is_explained() {
    const PARTS: [&str; 8] = [
        "tracers",
        "analyzer",
        "sample cache",
        "object-id pass",
        "distributed rays",
        "transparent shadows",
        "environment maps",
        "elevation maps",
    ];
    for (name, needed) in [
        ("diffuse", [false; 8]),
        ("box", [true, true, true, true, false, true, true, false]),
        ("gallery", [true, true, true, true, true, true, true, false]),
    ] {
        let d = Foveal::new("explain").arg(scene(name)).json();
        let parts = d["parts"].as_array().expect("parts");
        assert!(parts.iter().all(|p| p["why"].as_str().is_some_and(|why| !why.is_empty())), "{d}");
        for (part, needed) in PARTS.into_iter().zip(needed) {
            let found =
                parts.iter().find(|p| p["part"] == part).unwrap_or_else(|| panic!("no {part} in {d}"));
            assert_eq!(found["needed"], needed, "{name}: {part}");
        }
    }
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
        serde_json::json!({"traced": 0, "reused": 0, "expired": 0, "splatted": 0, "late": 0, "refined": 0, "approximated": 0})
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

/// Not a ray beside those of the display, no probe, no map, no actor.
#[test]
fn a_diffuse_scene_traces_no_ray_but_the_display_s() {
    let (world, rays) = counted(&scene("diffuse"));
    let mut system = System::start(&world, Settings::new(40, 30, 2));
    let actors = system.engine.actors();
    assert!(actors.correction.is_none() && actors.pool.is_none());
    assert!(actors.tracers.is_empty() && actors.illuminator.is_none());
    let shown = system.frame(|_| true);
    let hit = shown.snapshot.drawn.buffers().hit.data().iter().filter(|h| h.hit().is_some()).count();
    assert_eq!(rays.count(), hit as u64);
    let drained: Vec<Stage> = shown.stages.iter().map(|s| s.0).collect();
    for stage in [Stage::Age, Stage::WarpSplat, Stage::Attention, Stage::Allocate] {
        assert!(!drained.contains(&stage), "{stage:?}");
    }
    system.stop();
}

/// A still view that has converged: nothing is traced, drawn, warped, looked at, allocated or composed, and the picture
/// is the very one that was shown before.
#[test]
fn a_converged_still_view_costs_nothing() {
    for name in ["box", "diffuse"] {
        let (world, rays) = counted(&scene(name));
        let mut system = System::start(&world, Settings::new(40, 30, 2));
        let first = system.converge();
        let last = system.frame(|_| true);
        system.rest();
        let (before, delivered) = (rays.count(), system.engine.runtime().deliveries());
        for number in 0..20 {
            let again = system.frame(|_| true);
            assert!(Arc::ptr_eq(&again.snapshot.rgb8, &last.snapshot.rgb8), "{name}: composed again");
            assert!(Arc::ptr_eq(&again.snapshot.drawn, &first.snapshot.drawn), "{name}: drawn again");
            // Stages of the frame before may still have been on their way to it.
            let worked = again.stages.iter().filter(|s| number > 0 && s.0 != Stage::Correct).count();
            assert_eq!(worked, 0, "{name}: {:?}", again.stages);
        }
        assert_eq!(rays.count(), before, "{name}: rays");
        assert_eq!(system.engine.runtime().deliveries() - delivered, 2 * 20, "{name}: begin and deadline");
        system.stop();
    }
}

/// A closed room of 4 units with one thing in its middle.
fn room_with(model: &str, half: f32) -> std::path::PathBuf {
    let folder = folder("thing");
    let quad = |half: f32, inwards: bool| {
        let mut text = String::new();
        for face in [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]] {
            for corner in if inwards { face.map(|c| c ^ 1) } else { face } {
                let axis = |bit: i32| if corner >> bit & 1 == 0 { -half } else { half };
                text += &format!("v {} {} {}\n", axis(0), axis(1), axis(2));
            }
            text += "f -4 -3 -2 -1\n";
        }
        text
    };
    let obj = format!(
        "mtllib room.mtl\nusemtl wall\n{}usemtl thing\no thing\n{}",
        quad(2.0, true),
        quad(half, false)
    );
    let sidecar = format!(
        "format = 1\n[geometry]\nfiles = [\"room.obj\"]\n[[camera]]\nname = \"main\"\neye = [0.3, 0.2, 1.9]\n\
         target = [0.0, 0.0, 0.0]\nup = [0.0, 1.0, 0.0]\nfov_y = 60.0\n[material.\"thing\"]\n{model}"
    );
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).expect("a file");
    write("room.obj", &obj);
    write("room.mtl", "newmtl wall\nKd 0.5 0.5 0.5\nKe 1 1 1\nnewmtl thing\nKd 0.5 0.5 0.5\n");
    write("room.toml", &sidecar);
    folder.join("room.toml")
}

/// Rays per sample of a thing in a room.
fn rays_per_sample(model: &str) -> f64 {
    let (world, rays) = counted(&room_with(model, 0.6));
    let frame = world.scene.cameras[0].camera.frame(40, 30);
    let mut buffers = FrameBuffers::new(40, 30);
    draw(&world, &frame, Passes { texture_ids: false }, &mut buffers);
    let pixels = (0..1200).map(|i| (i % 40, i / 40));
    let pixels: Vec<_> = pixels.filter(|&(x, y)| buffers.object.at(x as usize, y as usize) != 0).collect();
    assert!(pixels.len() > 100);
    let drawn = rays.count();
    let owner = Owner { view: 1, object: 1, k: 0 };
    let samples = trace_samples(&world, &frame, &buffers, owner, pixels.into_iter(), 0).len();
    (rays.count() - drawn) as f64 / samples as f64
}

/// A mirror sends one ray; only rough gloss sends several.
#[test]
fn mirrors_send_no_distributed_rays() {
    let mirror = rays_per_sample("model = \"mirror\"");
    let smooth = rays_per_sample("model = \"conductor\"\nspecular = [0.9, 0.9, 0.9]\nalpha = 0.0");
    let rough = rays_per_sample("model = \"conductor\"\nspecular = [0.9, 0.9, 0.9]\nalpha = 0.3");
    assert_eq!((mirror, smooth), (1.0, 1.0));
    assert!(rough > 3.0, "{rough}");
}

/// Where nothing is transparent a shadow ray ends at the first surface it meets, however many there are.
#[test]
fn shadow_rays_stop_at_the_first_hit() {
    let walls = |material: &str| {
        let folder = folder("walls");
        let mut obj = format!("mtllib walls.mtl\nusemtl {material}\n");
        for z in 0..50 {
            obj += &format!("v -9 -9 {z}\nv 9 -9 {z}\nv 0 9 {z}\nf -3 -2 -1\n");
        }
        std::fs::write(folder.join("walls.obj"), obj).expect("a file");
        std::fs::write(folder.join("walls.mtl"), "newmtl wall\nKd 0.5 0.5 0.5\n").expect("a file");
        load(&folder.join("walls.obj")).unwrap_or_else(|e| panic!("{e}")).scene
    };
    let scene = walls("wall");
    assert!(!ScenePlan::new(&scene, &scene.budget).needs(Subsystem::TransparentShadows));
    let accel = Accel::build(&scene);
    let ray = Ray { t_max: 1e3, ..Ray::new(Vec3::new(0.1, 0.2, -1.0), Vec3::Z) };
    let visits = |blocks: bool| {
        let mut count = 0;
        let blocked = accel.any_hit(&scene, &ray, |_| {
            count += 1;
            blocks
        });
        assert_eq!(blocked, blocks);
        count
    };
    assert_eq!((visits(true), visits(false)), (1, 50));
    assert!(accel.occluded(&scene, &ray));
}

/// While textures fit, their ids are not drawn, no level is left out and nobody manages them.
#[test]
fn textures_that_fit_have_no_pass() {
    let (world, _) = counted(&scene("gallery"));
    let frame = world.scene.cameras[0].camera.frame(40, 30);
    let drawn = |limit: Option<u64>| {
        let plan = ScenePlan::new(&world.scene, &Budget { texture_bytes: limit, fps: None });
        assert_eq!(plan.needs(Subsystem::ElevationMaps), plan.needs(Subsystem::TextureIdPass));
        let mut buffers = FrameBuffers::new(40, 30);
        draw(&world, &frame, Passes { texture_ids: plan.needs(Subsystem::TextureIdPass) }, &mut buffers);
        buffers.texture.data().iter().filter(|t| **t != TextureLevel::NONE).count()
    };
    assert_eq!((drawn(None), drawn(Some(1 << 30))), (0, 0));
    assert!(drawn(Some(1 << 16)) > 100);
}

/// An object that covers less than a thousandth of the picture gets no environment map of its own.
#[test]
fn small_objects_get_no_environment_map() {
    for (half, maps) in [(0.02, false), (0.6, true)] {
        let (world, _) = counted(&room_with("model = \"mirror\"", half));
        let mut system = System::start(&world, Settings::new(80, 60, 2));
        let first = system.converge();
        let shown = first.snapshot.drawn.buffers().object.data().iter().filter(|o| **o != 0).count();
        assert!(shown > 0 && (shown as f32 / 4800.0 >= 1e-3) == maps, "{shown} pixels");
        // New views, so that maps that are wanted have time to be captured.
        for _ in 0..30 {
            system.camera.eye.x += 1e-4;
            system.converge();
        }
        let captured = system.stop_and(|a| a.environments().captured()).expect("an allocator");
        assert_eq!(captured > 0, maps, "{shown} pixels");
    }
}
