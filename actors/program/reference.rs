//! `foveal reference`: the gold standard to compare walks with.

use std::path::PathBuf;
use std::time::Instant;

use clap::{Args, ValueEnum};
use foveal::display::tone::ToneMap;
use foveal::splatting::supersampling::Tiles;
use foveal::world::World;
use foveal_engine::files::{exr_bytes, png_bytes, write_atomic};
use foveal_engine::interrupt::interrupted;
use foveal_engine::opened::{self, camera};
use foveal_engine::reference::{path_picture, traced_picture};
use foveal_engine::{Failure, Light};
use foveal_terminal::arguments::Size;
use foveal_terminal::light::IlluminationArguments;
use foveal_terminal::print::{print_json, print_line};
use foveal_terminal::progress::{Progress, end_on_interrupt};
use glam::Vec3;
use serde_json::json;

/// Arguments of `foveal reference`.
#[derive(Args, Debug)]
pub struct ReferenceArguments {
    /// An OBJ or glTF file or a sidecar
    scene: PathBuf,
    /// What to render
    #[arg(long, value_enum, default_value_t = Kind::Traced)]
    kind: Kind,
    /// Samples per pixel; traced: as many as `walk --refine` gives a pixel
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1 << 16))]
    spp: u32,
    /// Camera (default: the first)
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,
    /// Picture size
    #[arg(long, value_name = "WxH", default_value = "512x512")]
    size: Size,
    /// Seed of the random numbers
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Where to write it: .exr (linear) or .png (as shown)
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    illumination: IlluminationArguments,
    /// One JSON document
    #[arg(long)]
    json: bool,
}

/// Which gold standard.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Kind {
    /// What a still view converges to: baked diffuse light, everything else traced
    Traced,
    /// Unbiased path tracing, without the baked light
    Path,
}

/// Runs the command.
pub fn run(a: &ReferenceArguments, progress: Progress) -> Result<(), Failure> {
    end_on_interrupt();
    let world = match a.kind {
        Kind::Traced => {
            let light = Light { baked: !a.illumination.quick, ..a.illumination.light() };
            opened::open(&a.scene, &light, &progress.baking())?.world
        }
        Kind::Path => {
            let (scene, _) = opened::load_scene_as(&a.scene, &a.illumination.reading.reading())?;
            World::new(scene, std::sync::Arc::new(foveal::illumination::Uniform(Vec3::ZERO)))
        }
    };
    let view = camera(&world.scene, a.camera.as_deref())?;
    let frame = view.camera.frame(a.size.width, a.size.height);
    let refined = a.kind == Kind::Traced && a.spp > 1;
    let tiles = if refined { Tiles::of_size(a.size.width, a.size.height).len() } else { 0 };
    let bar = progress.bar(u64::from(a.size.height) + tiles as u64, "reference");
    let goes_on = || {
        bar.inc(1);
        !interrupted()
    };
    let start = Instant::now();
    let picture = match a.kind {
        Kind::Traced => traced_picture(&world, &frame, a.seed, a.spp, &goes_on),
        Kind::Path => path_picture(&world, &frame, a.seed, a.spp, &goes_on),
    };
    let seconds = start.elapsed().as_secs_f64();
    bar.finish_and_clear();
    if interrupted() {
        return Err(Failure::Interrupted("interrupted; no picture was written".into()));
    }
    let bytes = if a.out.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) {
        let tone = ToneMap::from(&world.scene.display);
        let rgb8 = picture.map(|c| tone.to_rgb8(c));
        png_bytes(a.size.width, a.size.height, rgb8.data().as_flattened())?
    } else {
        exr_bytes(&picture)?
    };
    write_atomic(&a.out, &bytes)?;
    if a.json {
        print_json(&json!({
            "schema": "foveal.reference/1",
            "scene": world.scene.name,
            "camera": view.name,
            "kind": match a.kind { Kind::Traced => "traced", Kind::Path => "path" },
            "spp": a.spp,
            "size": [a.size.width, a.size.height],
            "seconds": seconds,
            "file": a.out.display().to_string(),
        }));
    } else {
        print_line(&format!("{} in {seconds:.1} s", a.out.display()));
    }
    Ok(())
}
