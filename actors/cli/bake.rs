//! `foveal bake`: the view-independent illumination, made once and kept.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use serde_json::json;

use foveal::geometry::Accel;
use foveal::illumination::bake::cache_key;
use foveal::illumination::cache::{load_illumination, save};
use foveal::transport::light::Lights;
use foveal::transport::particle::SceneTransport;

use super::Progress;
use super::failure::Failure;
use super::output::{peak_memory_bytes, print_json, print_line};
use super::session::{self, BakeSettingsArguments, bake_with_progress, cache_file, load_scene};

/// Arguments of `foveal bake`.
#[derive(Args, Debug)]
pub struct BakeArguments {
    /// An OBJ file or a sidecar
    scene: PathBuf,
    #[command(flatten)]
    settings: BakeSettingsArguments,
    /// Where to keep it (default: the cache, where `walk` finds it)
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Folder of kept bakes (default: FOVEAL_CACHE, else the user's cache folder)
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
    /// Bake even if a kept one meets the settings
    #[arg(long)]
    again: bool,
    /// One JSON document
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(a: &BakeArguments, progress: Progress) -> Result<(), Failure> {
    session::end_on_interrupt();
    let (scene, warnings) = load_scene(&a.scene)?;
    let settings = a.settings.settings(&scene);
    let key = cache_key(&scene, &settings);
    let kept = cache_file(a.cache.as_deref(), &scene, &settings);
    let Some(file) = a.out.clone().or_else(|| kept.clone()) else {
        return Err(Failure::Usage("no place to keep the bake: give --out or set FOVEAL_CACHE".into()));
    };
    let start = Instant::now();
    let found = match &kept {
        Some(kept) if !a.again && kept.exists() => {
            load_illumination(kept, &key, scene.mesh.triangles.len()).ok()
        }
        _ => None,
    };
    let cached = found.is_some();
    let (map, complete) = match found {
        Some(map) => (map, true),
        None => {
            let accel = Accel::build(&scene);
            let lights = Lights::build(&scene);
            let transport = SceneTransport::new(&scene, &accel, &lights);
            let baked = bake_with_progress(&scene, &transport, &settings, a.settings.time, progress);
            (baked.illumination, baked.complete)
        }
    };
    if let Some(folder) = file.parent().filter(|p| *p != Path::new("")) {
        super::output::make_folder(folder)?;
    }
    save(&file, &key, &map).map_err(|e| Failure::file(&file, e))?;
    let seconds = start.elapsed().as_secs_f64();
    let s = &map.summary;
    if a.json {
        print_json(&json!({
            "schema": "foveal.bake/1",
            "scene": scene.name,
            "method": "particles",
            "seconds": seconds,
            "error": s.relative_error,
            "error_direct": s.direct_error,
            "error_particles": s.particle_error,
            "error_bias": s.bias_error,
            "complete": complete,
            "texels": map.element_count(),
            "particles": s.particles,
            "stored": s.stored,
            "has_indirect": s.has_indirect,
            "mean_irradiance": s.mean,
            "cached": cached,
            "file": file.display().to_string(),
            "peak_memory_bytes": peak_memory_bytes(),
            "warnings": warnings.iter().chain(&s.notes).collect::<Vec<_>>(),
        }));
    } else {
        print_line(&format!("{}: {}", scene.title, file.display()));
        print_line(&format!(
            "{} texels, {} particles, error {:.2} % in {seconds:.1} s{}",
            map.element_count(),
            s.particles,
            100.0 * s.relative_error,
            if cached { " (kept from before)" } else { "" },
        ));
        if !s.has_indirect {
            print_line("no indirect light: no surface reflects any");
        }
    }
    if session::interrupted() {
        return Err(Failure::Interrupted(format!(
            "interrupted; what was done is kept in {}",
            file.display()
        )));
    }
    Ok(())
}
