//! `foveal reference`: the gold standard to compare walks with.

use std::path::PathBuf;
use std::time::Instant;

use clap::{Args, ValueEnum};
use glam::Vec3;
use rayon::prelude::*;
use serde_json::json;

use foveal::display::FrameBuffers;
use foveal::display::tone::ToneMap;
use foveal::display::twin::{self, Passes};
use foveal::geometry::Ray;
use foveal::image::Map2d;
use foveal::scene::camera::CameraFrame;
use foveal::splatting::supersampling::{Tiles, supersampled};
use foveal::splatting::trace::pixel_stream;
use foveal::world::World;

use super::Progress;
use super::arguments::Size;
use super::failure::Failure;
use super::output::{exr_bytes, png_bytes, print_json, print_line, write_atomic};
use super::session::{self, IlluminationArguments, camera, interrupted};

/// Arguments of `foveal reference`.
#[derive(Args, Debug)]
pub struct ReferenceArguments {
    /// An OBJ file or a sidecar
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

/// Every non-diffuse pixel traced, as a still view converges to; with more than one sample, what a converged view is
/// refined to: all pixels, through other points of each.
pub fn traced_picture(
    world: &World,
    frame: &CameraFrame,
    seed: u64,
    samples: u32,
    goes_on: &(dyn Fn() -> bool + Sync),
) -> Map2d<Vec3> {
    let [width, height] = frame.size.map(|s| s as usize);
    let mut buffers = FrameBuffers::new(width, height);
    twin::draw(world, frame, Passes { texture_ids: false }, &mut buffers);
    let tracer = world.tracer();
    let mut picture = buffers.color.clone();
    picture.data_mut().par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        if !goes_on() {
            return;
        }
        for (x, out) in row.iter_mut().enumerate() {
            let (Some(hit), true) = (buffers.hit.at(x, y).hit(), buffers.object.at(x, y) != 0) else {
                continue;
            };
            let (px, py) = (x as u32, y as u32);
            let ray = twin::primary_ray(frame, px, py);
            let at = twin::primary_interaction(world, frame, &ray, &hit);
            *out += tracer.view_dependent(&at, pixel_stream(seed, px, py, 0));
        }
    });
    if samples > 1 { supersampled(world, frame, seed, samples, picture, goes_on) } else { picture }
}

/// Path-traced picture, box-filtered over each pixel.
pub fn path_picture(
    world: &World,
    frame: &CameraFrame,
    seed: u64,
    samples: u32,
    goes_on: &(dyn Fn() -> bool + Sync),
) -> Map2d<Vec3> {
    let [width, height] = frame.size.map(|s| s as usize);
    let mut picture = Map2d::new(width, height, Vec3::ZERO);
    picture.data_mut().par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        if !goes_on() {
            return;
        }
        for (x, out) in row.iter_mut().enumerate() {
            let mut sum = Vec3::ZERO;
            for sample in 0..samples {
                let mut stream = pixel_stream(seed, x as u32, y as u32, u64::from(sample));
                let [dx, dy] = stream.next_2d();
                let ray = Ray::new(frame.eye, frame.direction(x as f32 + dx, y as f32 + dy));
                sum += world.path_radiance(&ray, stream);
            }
            *out = sum / samples as f32;
        }
    });
    picture
}

/// Runs the command.
pub fn run(a: &ReferenceArguments, progress: Progress) -> Result<(), Failure> {
    session::end_on_interrupt();
    let world = match a.kind {
        Kind::Traced => {
            let illumination =
                IlluminationArguments { baked: !a.illumination.quick, ..a.illumination.clone() };
            session::open(&a.scene, &illumination, progress)?.world
        }
        Kind::Path => {
            let (scene, _) = session::load_scene(&a.scene)?;
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
