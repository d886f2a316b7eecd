//! `foveal walk`: a walkthrough without a window, along a camera path at a frame-time budget.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::{Args, ValueEnum};
use foveal::allocation::policy::{Policy, RayPolicy};
use foveal::scene::texture::forget_most_held;
use foveal::scene::{Camera, CameraPath};
use foveal::splatting::Footprint;
use foveal::splatting::supersampling::Supersampling;
use foveal_actors::renderer::Renderer;
use foveal_actors::station::STATIONS_MAX;
use foveal_engine::files::{exr_bytes, make_folder, write_atomic};
use foveal_engine::interrupt::interrupted;
use foveal_engine::opened::{self, camera};
use foveal_engine::process::memory_bytes;
use foveal_engine::recording::TRACERS_MAX;
use foveal_engine::{Engine, Failure, Options, Recording, Settings};
use foveal_runtime::Record;
use foveal_terminal::arguments::{Size, bytes, positive, unit};
use foveal_terminal::hashes::Hashes;
use foveal_terminal::light::IlluminationArguments;
use foveal_terminal::mode::ModeArguments;
use foveal_terminal::print::print_json;
use foveal_terminal::progress::Progress;
use foveal_terminal::report;

use super::pictures::PictureWriter;
use super::tracers::{self, TracersArguments};
use super::walk_report::{Walked, document, summary, textures_json};
use super::{figures, replay};

/// Turns that a profile keeps of each actor: the last minutes of a walk.
const PROFILED_TURNS: usize = 1 << 17;

/// Arguments of `foveal walk`.
#[derive(Args, Debug)]
pub struct WalkArguments {
    /// OBJ or glTF file, or a .toml sidecar
    scene: PathBuf,
    /// Camera path (default: the scene's first, unless --camera is given)
    #[arg(long, value_name = "NAME", conflicts_with = "camera")]
    path: Option<String>,
    /// Stand still at this camera
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,
    /// Number of frames (default: the path's length)
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    frames: Option<u32>,
    /// Target frame rate (default: the scene's, else 10)
    #[arg(long, value_parser = positive)]
    fps: Option<f32>,
    #[command(flatten)]
    pub(super) mode: ModeArguments,
    /// Picture size
    #[arg(long, value_name = "WxH", default_value = "512x512")]
    size: Size,
    /// Number of tracers (default: one per core)
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=i64::from(TRACERS_MAX)))]
    workers: Option<u32>,
    /// Policy that orders the samples
    #[arg(long, value_enum, default_value_t = PolicyName::Utility)]
    policy: PolicyName,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// After the last frame, stay until the picture has converged (without --path: at the start camera)
    #[arg(long)]
    until_converged: bool,
    /// Refine the converged picture until the standard error of displayed values (0 to 1) is below this
    #[arg(long, value_name = "NOISE", num_args = 0..=1, default_missing_value = "0.01", value_parser = unit, requires = "until_converged")]
    refine: Option<f32>,
    /// Limit on the samples per pixel for --refine
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=1 << 16), requires = "refine")]
    refine_samples: u32,
    /// Folder for pictures and reports
    #[arg(long, value_name = "DIR")]
    pub(super) out: Option<PathBuf>,
    /// Record the walk for `foveal replay`
    #[arg(long, value_name = "FILE")]
    pub(super) record: Option<PathBuf>,
    /// How many hashes of the messages to record
    #[arg(long, value_name = "WHICH", value_enum, default_value_t = Hashes::Each, requires = "record")]
    hashes: Hashes,
    /// Do not store growing lightmaps next to the recording (FILE.light); a replay then bakes them again
    #[arg(long, requires = "record")]
    no_light: bool,
    /// Write which actor ran on which thread when, for chrome://tracing (FILE.pftrace: in Perfetto's own format)
    #[arg(long, value_name = "FILE")]
    profile: Option<PathBuf>,
    /// Weight of saliency relative to the task, 0 to 1
    #[arg(long, value_name = "W", default_value = "0.5", value_parser = unit)]
    saliency: f32,
    /// Priority of each level relative to the previous one, 0 to 1 (Haber 2001: 0.8 to 0.9)
    #[arg(long, value_name = "F", default_value = "0.25", value_parser = unit)]
    reduction: f32,
    /// Correct the most attended object until it has converged, then the next
    #[arg(long)]
    winner_takes_all: bool,
    /// Samples per job (n_job in Haber 2001)
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    n_job: u32,
    /// Coarsest level set of the √5 lattice, for K + 1 levels
    #[arg(long, value_name = "K", default_value_t = 6, value_parser = clap::value_parser!(u32).range(0..=7))]
    levels: u32,
    /// Area that a fresh sample paints
    #[arg(long, value_enum, default_value_t = FootprintName::Smooth)]
    footprint: FootprintName,
    /// Ageing: largest change of ⟨normal, view⟩ (δ in Haber 2001)
    #[arg(long, default_value = "0.1", value_parser = unit)]
    delta: f32,
    /// Ageing: maximum age of a sample, in views
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u32).range(0..=65_535))]
    max_age: u32,
    /// Ageing: number of samples that a level needs to vote
    #[arg(long, value_name = "N", default_value_t = 10)]
    n_min: usize,
    /// Limit on texture memory, e.g. 64MiB (default: the scene's, else none)
    #[arg(long, value_name = "SIZE", value_parser = bytes)]
    texture_budget: Option<u64>,
    /// Limit on environment map memory; 0 shows only the coarsest maps
    #[arg(long, value_name = "SIZE", value_parser = bytes, default_value = "64MiB")]
    environment_budget: u64,
    #[command(flatten)]
    illumination: IlluminationArguments,
    #[command(flatten)]
    tracers: TracersArguments,
    /// Wait for this many machines before starting
    #[arg(long, value_name = "N", default_value_t = 0, requires = "tracers", value_parser = clap::value_parser!(u32).range(0..=i64::from(STATIONS_MAX)))]
    tracers_wait: u32,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Names of policies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum PolicyName {
    /// Saliency and task, reduced per level (Haber 2001)
    Attention,
    /// Largest objects first
    Coverage,
    /// Level by level
    Uniform,
    /// In random order
    Random,
    /// Expected reduction of visible error per time, learnt while tracing
    Utility,
}

impl From<PolicyName> for Policy {
    fn from(name: PolicyName) -> Self {
        match name {
            PolicyName::Attention => Self::Attention,
            PolicyName::Coverage => Self::Coverage,
            PolicyName::Uniform => Self::Uniform,
            PolicyName::Random => Self::Random,
            PolicyName::Utility => Self::Utility,
        }
    }
}

/// Names of footprints.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum FootprintName {
    /// Exact lattice tiles; the picture is interpolated from all samples of a surface
    Smooth,
    /// Exact lattice tiles, with linear interpolation between samples
    Linear,
    /// Exact lattice tiles
    Tile,
    /// Squares, as in Haber 2001
    Square,
}

/// Where the camera is at a time.
enum Motion<'s> {
    Still(Camera),
    Along(&'s CameraPath, Camera),
}

impl Motion<'_> {
    fn at(&self, seconds: f32) -> Camera {
        match self {
            Self::Still(camera) => *camera,
            Self::Along(path, like) => path.at(seconds, like.up, like.fov_y),
        }
    }
}

/// Runs the command.
pub fn run(a: &WalkArguments, progress: Progress) -> Result<(), Failure> {
    foveal_terminal::progress::end_on_interrupt();
    let mut light = a.illumination.light();
    // Guests get the light once.
    light.baked |= a.tracers.is_asked_for();
    let mut opened = opened::open(&a.scene, &light, &progress.baking())?;
    opened.limit_textures(a.texture_budget.or(opened.world.scene.budget.texture_bytes))?;
    let scene = opened.world.scene.clone();
    let start_camera = camera(&scene, a.camera.as_deref())?.camera;
    let path = match &a.path {
        Some(name) => Some(scene.paths.iter().find(|p| p.name == *name).ok_or_else(|| {
            let names: Vec<&str> = scene.paths.iter().map(|p| p.name.as_str()).collect();
            Failure::Usage(format!("no path \"{name}\"; the scene has {}", names.join(", ")))
        })?),
        None if a.camera.is_some() || a.until_converged => None,
        None => scene.paths.first(),
    };
    let motion = path.map_or(Motion::Still(start_camera), |p| Motion::Along(p, start_camera));
    let fps = a.fps.or(scene.budget.fps).unwrap_or(10.0);
    let frames = a.frames.unwrap_or_else(|| match path {
        Some(p) => ((p.duration() * fps).ceil() as u32).clamp(1, 100_000),
        None => 1,
    });
    let cores = std::thread::available_parallelism().map_or(1, usize::from) as u32;
    let settings = Settings {
        policy: RayPolicy {
            policy: a.policy.into(),
            reduction: a.reduction.clamp(1e-3, 0.999),
            seed: a.seed,
        },
        saliency_weight: a.saliency,
        seed: a.seed,
        samples_per_job: a.n_job,
        k_max: a.levels,
        footprint: match a.footprint {
            FootprintName::Smooth => Footprint::Smooth,
            FootprintName::Linear => Footprint::Linear,
            FootprintName::Tile => Footprint::Tile,
            FootprintName::Square => Footprint::Square,
        },
        ageing: foveal::splatting::AgeingRules { delta: a.delta, max_age: a.max_age, n_min: a.n_min },
        environment_bytes: a.environment_budget,
        winner_takes_all: a.winner_takes_all,
        supersampling: a.refine.map(|noise| Supersampling { noise, max_samples: a.refine_samples }),
        ..Settings::new(a.size.width, a.size.height, a.workers.unwrap_or(cores.min(TRACERS_MAX)))
    };
    let settings = a.tracers.settings(settings);
    if let Some(out) = &a.out {
        make_folder(out)?;
    }
    let recording = a.record.as_ref().map(|file| Recording {
        into: Record::File(file.clone()),
        hashing: a.hashes.into(),
        command: "walk",
    });
    let mut options = Options {
        fps: Some(fps),
        quality: a.mode.least_quality(),
        texture_bytes: a.texture_budget,
        recording,
        keeps_light: !a.no_light,
        ring_turns: a.profile.as_ref().map(|_| PROFILED_TURNS),
        gives_way: true,
        ..Options::new(settings)
    };
    let door = a.tracers.open(&opened, &settings, &mut options)?;
    let mut engine = Engine::start(opened, options)?;
    a.tracers.attach(door.as_ref(), a.tracers_wait, &mut engine)?;
    let pictures = a.out.as_ref().map(|out| PictureWriter::new(out.clone()));

    let walked =
        walk(a, &mut engine, &motion, frames, fps, pictures.as_ref(), progress).inspect_err(|_| {
            // What was recorded until then is whole.
            engine.finish(Duration::from_secs(10));
        })?;
    if let Some(file) = &a.profile {
        write_atomic(file, &replay::profile(&engine.runtime().timeline(), file))?;
    }
    let converged = engine.look(Renderer::is_converged).unwrap_or(false);
    let linear = if a.out.is_some() { engine.look(Renderer::picture).flatten() } else { None };
    // Only the main thread's actors can be looked at while others run.
    let ending = Instant::now();
    let end = engine.finish(Duration::from_secs(10));
    tracing::debug!("end of the actors: {:.1} ms", ending.elapsed().as_secs_f64() * 1e3);
    drop(door);
    let mut document = document(a, &engine, fps, &walked, converged);
    if a.tracers.is_asked_for() {
        document["stations"] = tracers::document(&engine.stations());
    }
    let store = engine.opened().textures.as_ref();
    if let Some(textures) = store.and_then(|store| textures_json(store, &walked.textures, &scene)) {
        document["textures"] = textures;
    }
    if let (Some(out), Some(pictures)) = (&a.out, pictures) {
        if let Some(picture) = linear {
            write_atomic(&out.join("last.exr"), &exr_bytes(&picture)?)?;
        }
        pictures.finish()?;
        let page = figures::page(&engine, &document, &walked, fps)?;
        write_atomic(&out.join("report.html"), report::html(&page).as_bytes())?;
        write_atomic(&out.join("report.json"), format!("{document:#}\n").as_bytes())?;
    }
    if !end.drained {
        tracing::warn!("the actors did not come to rest within 10 s");
    }
    if a.json {
        print_json(&document);
    } else {
        summary(a, &document);
    }
    if interrupted() {
        return Err(Failure::Interrupted("interrupted; what was done is kept".into()));
    }
    Ok(())
}

fn walk(
    a: &WalkArguments,
    engine: &mut Engine,
    motion: &Motion<'_>,
    frames: u32,
    fps: f32,
    pictures: Option<&PictureWriter>,
    progress: Progress,
) -> Result<Walked, Failure> {
    let mut walked = Walked::default();
    forget_most_held();
    let bar = progress.bar(u64::from(frames), "walk");
    let budget = Duration::from_secs_f32(1.0 / fps);
    let start = Instant::now();
    let mut frame = 0;
    let mut pose = motion.at(0.0);
    loop {
        let staying = frame >= frames;
        let done = |r: &Renderer| r.is_refined() && r.is_shown();
        if interrupted() || (staying && (!a.until_converged || engine.look(done) == Some(true))) {
            break;
        }
        let began = Instant::now();
        if !staying {
            pose = motion.at((began - start).as_secs_f32());
        }
        let least = a.mode.least_quality().filter(|_| !staying);
        // The camera has not moved and all is traced: nothing to wait for once the stay has begun.
        let enough = |r: &Renderer| interrupted() || (staying && r.is_refined());
        let shown = engine.frame_until(&pose, budget, least, enough)?;
        walked.took(&shown, began.elapsed(), engine.insight().map_or(0.0, |i| i.quality));
        walked.memory = walked.memory.max(memory_bytes());
        // Of a stay only the last picture is kept; it takes the place of the last frame's.
        if let Some(pictures) = pictures {
            pictures.write(&format!("frame-{:04}.png", frame.min(frames - 1)), shown.snapshot)?;
        }
        frame += 1;
        bar.set_position(u64::from(frame.min(frames)));
    }
    bar.finish_and_clear();
    walked.insight = engine.insight().cloned();
    walked.delivered = engine.runtime().deliveries();
    Ok(walked)
}
