//! `foveal reference`: the gold standard to compare walks with.

use std::path::PathBuf;
use std::time::Instant;

use clap::{Args, ValueEnum};
use foveal::display::tone::ToneMap;
use foveal::image::Map2d;
use foveal::metrics::Batches;
use foveal::splatting::supersampling::Tiles;
use foveal::world::World;
use foveal_engine::files::{exr_bytes, png_bytes, write_atomic, write_batches};
use foveal_engine::interrupt::interrupted;
use foveal_engine::opened::{self, camera};
use foveal_engine::reference::{
    Enough, Sampled, sampled_bidirectional_by, sampled_paths_by, steps, traced_picture_by,
};
use foveal_engine::{Failure, Light};
use foveal_remote::hands::Helped;
use foveal_terminal::arguments::{Size, share};
use foveal_terminal::light::IlluminationArguments;
use foveal_terminal::print::{print_json, print_line};
use foveal_terminal::progress::{Progress, end_on_interrupt};
use glam::Vec3;
use serde_json::json;

use super::tracers::{self, HelpersArguments};

/// Arguments of `foveal reference`.
#[derive(Args, Debug)]
pub struct ReferenceArguments {
    /// OBJ or glTF file, or a .toml sidecar
    scene: PathBuf,
    /// What to render
    #[arg(long, value_enum, default_value_t = Kind::Traced)]
    kind: Kind,
    /// Samples per pixel; a minimum if --until-error or --time is given. With traced: as many as `walk --refine`
    /// takes of a pixel
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1 << 16))]
    spp: u32,
    /// With path and truth: continue until the relative standard error of 8 × 8 block means is below this, e.g. 0.5%,
    /// or --time is over
    #[arg(long, value_name = "SHARE", value_parser = share)]
    until_error: Option<f32>,
    /// Camera (default: the first)
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,
    /// Picture size
    #[arg(long, value_name = "WxH", default_value = "512x512")]
    size: Size,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Output file: .exr (linear) or .png (as displayed); with path and truth and a multiple of 16 samples,
    /// .batches.json is written next to it, from which `compare --blocks` derives the noise
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    illumination: IlluminationArguments,
    #[command(flatten)]
    helpers: HelpersArguments,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Which gold standard.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Kind {
    /// What a still view converges to: baked diffuse light, everything else traced
    Traced,
    /// Unbiased path tracing, without the bake
    Path,
    /// Bidirectional path tracing, which also finds light that path misses, with a confidence interval
    Truth,
}

/// Runs the command.
pub fn run(a: &ReferenceArguments, progress: Progress) -> Result<(), Failure> {
    end_on_interrupt();
    let world = match a.kind {
        Kind::Traced => {
            let light = Light { baked: !a.illumination.quick, ..a.illumination.light() };
            opened::open(&a.scene, &light, &progress.baking())?.world
        }
        Kind::Path | Kind::Truth => {
            let (scene, _) = opened::load_scene_as(&a.scene, &a.illumination.reading.reading())?;
            World::new(scene, std::sync::Arc::new(foveal::illumination::Uniform(Vec3::ZERO)))
        }
    };
    let view = camera(&world.scene, a.camera.as_deref())?;
    let frame = view.camera.frame(a.size.width, a.size.height);
    // Where nothing is baked, the bake's time is the picture's.
    let enough =
        Enough { samples: a.spp, error: a.until_error.map(f64::from), time: a.illumination.settings.time };
    let reading = a.illumination.reading.reading();
    let helped = a.helpers.open(&a.scene, &reading, world.scene.content_hash)?;
    let hands = tracers::hands(helped.as_ref());
    let steps = match a.kind {
        Kind::Traced if a.until_error.is_some() => {
            return Err(Failure::Usage("--until-error is for --kind path and truth".into()));
        }
        Kind::Traced if a.spp == 1 => steps(&frame, 1),
        Kind::Traced => steps(&frame, 1) + Tiles::of_size(a.size.width, a.size.height).len() as u64,
        Kind::Path | Kind::Truth => steps(&frame, a.spp),
    };
    let bar = progress.bar(steps, "reference");
    let goes_on = || {
        bar.inc(1);
        !interrupted()
    };
    let start = Instant::now();
    let (mut stated, mut picture, mut sampled);
    loop {
        (stated, (picture, sampled)) = match a.kind {
            Kind::Traced => {
                let refined = traced_picture_by(hands, &world, &frame, a.seed, a.spp, &goes_on);
                (Some(refined.stated).filter(|s| s.is_finite()), (refined.picture, None))
            }
            Kind::Path => (None, parted(sampled_paths_by(hands, &world, &frame, a.seed, &enough, &goes_on))),
            Kind::Truth => {
                (None, parted(sampled_bidirectional_by(hands, &world, &frame, a.seed, &enough, &goes_on)))
            }
        };
        if !hands.doubts() || interrupted() {
            break;
        }
        tracing::warn!("a machine sent what is not in the scene and is banned; the picture is made anew");
        bar.reset();
    }
    let seconds = start.elapsed().as_secs_f64();
    bar.finish_and_clear();
    let was_interrupted = interrupted();
    // Passes that are whole are a picture of fewer samples; a view that is half refined is none.
    let kept = sampled.as_ref().map_or(0, |s| s.samples);
    if was_interrupted && kept == 0 {
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
    let batches = sampled.as_ref().and_then(|s| s.batches.as_ref());
    let error = batches.map(Batches::relative_error);
    if let Some(batches) = batches {
        write_batches(&a.out, batches)?;
    }
    let helpers = helped.map(Helped::close);
    if a.json {
        let mut document = json!({
            "schema": "foveal.reference/1",
            "scene": world.scene.name,
            "camera": view.name,
            "kind": match a.kind { Kind::Traced => "traced", Kind::Path => "path", Kind::Truth => "truth" },
            "spp": sampled.as_ref().map_or(a.spp, |s| s.samples),
            "size": [a.size.width, a.size.height],
            "seconds": seconds,
            "file": a.out.display().to_string(),
        });
        if let Some(stated) = stated {
            document["stated"] = json!(stated);
        }
        if let Some(helpers) = &helpers {
            document["stations"] = tracers::helpers_document(helpers);
        }
        if let Some(s) = &sampled {
            document["error"] = json!(error);
            document["merged"] = json!({ "share": s.merged.share, "bias": s.merged.bias });
        }
        print_json(&document);
    } else {
        print_line(&format!("{} in {seconds:.1} s", a.out.display()));
        if let (Some(s), Some(error)) = (&sampled, error) {
            print_line(&format!(
                "{} samples per pixel; relative standard error of 8 × 8 blocks {:.2} % on average",
                s.samples,
                100.0 * error
            ));
        }
        if let Some(stated) = stated {
            print_line(&format!(
                "error below {:.1} % of the mean, in blocks of 8 × 8 pixels",
                100.0 * stated
            ));
        }
        if let Some(m) = sampled.map(|s| s.merged).filter(|m| m.share > 0.0) {
            print_line(&format!(
                "{:.2} % of the light comes from merged photons, which bias the picture by {:+.3} %",
                100.0 * m.share,
                100.0 * m.bias
            ));
        }
    }
    if was_interrupted {
        let kept = format!("interrupted; {} has {kept} samples per pixel", a.out.display());
        return Err(Failure::Interrupted(kept));
    }
    Ok(())
}

/// The picture, and what is known of it.
fn parted(mut sampled: Sampled) -> (Map2d<Vec3>, Option<Sampled>) {
    (std::mem::take(&mut sampled.picture), Some(sampled))
}
