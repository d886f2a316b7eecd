//! `foveal bench gltf`: what a glTF file's loading takes beside the decoding of its pictures, and what its surfaces cost
//! beside plastic ones.

use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Args;
use foveal::geometry::{Accel, Ray};
use foveal::scene::{Coat, Distribution, Model, Reflectance, Roughness, Scene};
use foveal::transport::bsdf::Bsdf;
use foveal::transport::interaction::Interaction;
use glam::Vec3;
use rayon::prelude::*;

use super::made::Subject;
use super::timed;
use foveal_engine::failure::Failure;
use foveal_engine::opened::load_scene;
use foveal_engine::process::cpu_ns;
use foveal_terminal::progress::Progress;
use foveal_terminal::table::{Aim, CommonArguments, Row, finish, median};

/// Arguments of `foveal bench gltf`.
#[derive(Args, Debug)]
pub struct GltfArguments {
    /// Bundled scene, or a file whose images are stored next to it
    #[arg(default_value = "atelier")]
    scene: String,
    #[command(flatten)]
    common: CommonArguments,
}

/// Rays along an edge of the view whose surfaces are looked at.
const SIDE: u32 = 256;

/// Runs the benchmark.
pub fn run(a: &GltfArguments, progress: Progress) -> Result<(), Failure> {
    let bar = progress.bar(2, "glTF");
    let subject = Subject::of(&a.scene)?;
    let name = Subject::name(&a.scene);
    let mut rows = loading(subject.path(), name, a.common.runs)?;
    bar.inc(1);
    let (scene, _) = load_scene(subject.path())?;
    rows.extend(surfaces(&scene, name, a.common.runs));
    bar.finish_and_clear();
    let notes = vec!["times are of the processor, all threads together".to_owned()];
    finish("gltf", &rows, &notes, &a.common)
}

/// Milliseconds of the processor that `work` takes.
fn processor_ms<R>(work: impl FnOnce() -> R) -> (f64, R) {
    let before = cpu_ns();
    let made = work();
    ((cpu_ns() - before) * 1e-6, made)
}

/// Pictures below a folder.
fn pictures(folder: &Path, found: &mut Vec<PathBuf>) {
    let Ok(entries) = std::fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let path = entry.path();
        let is_picture = path.extension().is_some_and(|e| {
            ["png", "jpg", "jpeg", "webp"].iter().any(|known| e.eq_ignore_ascii_case(known))
        });
        if path.is_dir() {
            pictures(&path, found);
        } else if is_picture {
            found.push(path);
        }
    }
}

fn loading(scene: &Path, name: &str, runs: u32) -> Result<Vec<Row>, Failure> {
    let mut files = Vec::new();
    pictures(scene.parent().unwrap_or(Path::new(".")), &mut files);
    files.sort();
    let read = |path: &PathBuf| std::fs::read(path).map_err(|e| Failure::file(path, e));
    let files: Vec<Vec<u8>> = files.iter().map(read).collect::<Result<_, _>>()?;
    let decode = || {
        let decoded = |bytes: &Vec<u8>| image::load_from_memory(bytes).map_or(0, |p| p.into_rgba8().len());
        files.par_iter().map(decoded).sum::<usize>()
    };
    let (mut load, mut decoding) = (Vec::new(), Vec::new());
    for _ in 0..runs {
        let (ms, loaded) = processor_ms(|| load_scene(scene));
        loaded?;
        load.push(ms);
        decoding.push(processor_ms(|| black_box(decode())).0);
    }
    let row = Row::new(format!("load {name}, {} pictures", files.len()), "ms", &load);
    Ok(vec![row.against("decoding alone", median(&decoding)).aim(Aim::RatioAtMost(1.2))])
}

/// The reflectance at points of surfaces between metal and dielectric, and of the same made of plastic with the same maps.
fn surfaces(scene: &Arc<Scene>, name: &str, runs: u32) -> Vec<Row> {
    let Some(view) = scene.cameras.first() else { return Vec::new() };
    let accel = Accel::build(scene);
    let frame = view.camera.frame(SIDE, SIDE);
    let met: Vec<Interaction> = (0..SIDE * SIDE)
        .filter_map(|i| {
            let towards = frame.direction((i % SIDE) as f32 + 0.5, (i / SIDE) as f32 + 0.5);
            let ray = Ray::new(frame.eye, towards);
            accel.intersect(scene, &ray).map(|hit| Interaction::at(scene, &ray, &hit))
        })
        .collect();
    let alpha = 0.3;
    let rough = Roughness { alpha_x: alpha, alpha_y: alpha, distribution: Distribution::Ggx };
    let coat = Coat::new(1.5, rough);
    let mut plastic = Scene::clone(scene);
    for material in &mut plastic.materials {
        if let Model::MetalRough(m) = &material.model {
            let albedo = Reflectance { color: Vec3::splat(0.5), map: m.diffuse.map.or(m.specular.map) };
            material.model = Model::Plastic { albedo, coat };
        }
    }
    let time = |scene: &Scene, some: &[&Interaction]| -> Vec<f64> {
        let all = || some.iter().map(|at| Bsdf::at(scene, at).diffuse_albedo().x).sum::<f32>();
        (0..runs).map(|_| timed(|| black_box(all())).0 * 1e6 / some.len() as f64).collect()
    };
    let mut rows = Vec::new();
    for (has_maps, what) in [(false, "without maps"), (true, "with maps")] {
        let some: Vec<&Interaction> = met
            .iter()
            .filter(|at| match &scene.materials[at.material.0 as usize].model {
                Model::MetalRough(m) => {
                    !m.is_diffuse
                        && (m.diffuse.map.or(m.specular.map).is_some() || m.recipe.is_some()) == has_maps
                }
                _ => false,
            })
            .collect();
        if some.len() < 100 {
            continue;
        }
        let row =
            Row::new(format!("surface of {name} {what}, {} points", some.len()), "ns", &time(scene, &some));
        rows.push(row.against("plastic", median(&time(&plastic, &some))).aim(Aim::RatioAtMost(1.3)));
    }
    rows
}
