//! `foveal walk`: a walkthrough without a window, along a camera path at a frame-time budget.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::{Args, ValueEnum};
use crossbeam_queue::SegQueue;
use serde_json::json;

use foveal::allocation::policy::{Policy, RayPolicy};
use foveal::display::twin::Passes;
use foveal::scene::plan::{Part, ScenePlan};
use foveal::scene::texture::{forget_most_held, held_bytes};
use foveal::scene::{Budget, Camera, CameraPath};
use foveal::splatting::Footprint;
use foveal::splatting::supersampling::Supersampling;
use foveal_runtime::{BuildError, Config, Control, Limit, RecordingStatus, Runtime};

use super::arguments::{Size, bytes, positive, unit};
use super::failure::Failure;
use super::mode::ModeArguments;
use super::output::{make_folder, memory_bytes, print_json, write_atomic};
use super::pictures::PictureWriter;
use super::recording::{Hashes, RecordedRun, TRACERS_MAX};
use super::report::FramePoint;
use super::session::{self, IlluminationArguments, Session, camera, interrupted};
use super::walk_report::{Walked, document, summary, textures_json};
use super::{Progress, figures, replay};
use crate::allocator::Allocator;
use crate::insight::{InsightSlot, LONGEST_FRAME};
use crate::message::{FrameIndex, FrameSnapshot, RendererInput, View};
use crate::renderer::{FrameCounts, FrameSink, Renderer};
use crate::settings::Settings;
use crate::stages::{Stage, StageTimes};
use crate::textures::TextureStore;
use crate::wiring::{Actors, Parts, wire};

/// Turns that a profile keeps of each actor: the last minutes of a walk.
const PROFILED_TURNS: usize = 1 << 17;

/// Arguments of `foveal walk`.
#[derive(Args, Debug)]
pub struct WalkArguments {
    /// An OBJ file or a sidecar
    scene: PathBuf,
    /// Camera path (default: the scene's first, unless a camera is named)
    #[arg(long, value_name = "NAME", conflicts_with = "camera")]
    path: Option<String>,
    /// Stand still at this camera
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,
    /// Number of frames (default: the path's length)
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    frames: Option<u32>,
    /// Frames per second to keep (default: the scene's, else 10)
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
    /// What decides which samples come first
    #[arg(long, value_enum, default_value_t = PolicyName::Utility)]
    policy: PolicyName,
    /// Seed of every random number
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// After the last frame stay until the picture has converged (without --path: at the start camera)
    #[arg(long)]
    until_converged: bool,
    /// Refine the converged picture until the standard error of its displayed values, 0 to 1, is below this
    #[arg(long, value_name = "NOISE", num_args = 0..=1, default_missing_value = "0.01", value_parser = unit, requires = "until_converged")]
    refine: Option<f32>,
    /// Most samples of a pixel in that
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=1 << 16), requires = "refine")]
    refine_samples: u32,
    /// Folder for pictures and reports
    #[arg(long, value_name = "DIR")]
    pub(super) out: Option<PathBuf>,
    /// Record the walk, so that `foveal replay` can run it again
    #[arg(long, value_name = "FILE")]
    pub(super) record: Option<PathBuf>,
    /// How densely hashes are recorded
    #[arg(long, value_name = "WHICH", value_enum, default_value_t = Hashes::Each, requires = "record")]
    hashes: Hashes,
    /// Write when each actor ran on which thread, for chrome://tracing; as .pftrace in Perfetto's own format
    #[arg(long, value_name = "FILE")]
    profile: Option<PathBuf>,
    /// Weight of saliency against the task, 0 to 1
    #[arg(long, value_name = "W", default_value = "0.5", value_parser = unit)]
    saliency: f32,
    /// Priority of each next level relative to the last, 0 to 1 (the paper: 0.8 to 0.9)
    #[arg(long, value_name = "F", default_value = "0.25", value_parser = unit)]
    reduction: f32,
    /// Correct the most attended object until it has converged, then the next
    #[arg(long)]
    winner_takes_all: bool,
    /// Samples of one job (the paper's n_job)
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    n_job: u32,
    /// Coarsest level set of the √5 lattice: K + 1 levels
    #[arg(long, value_name = "K", default_value_t = 6, value_parser = clap::value_parser!(u32).range(0..=7))]
    levels: u32,
    /// What a fresh sample paints
    #[arg(long, value_enum, default_value_t = FootprintName::Tile)]
    footprint: FootprintName,
    /// Ageing: largest change of ⟨normal, view⟩ (the paper's δ)
    #[arg(long, default_value = "0.1", value_parser = unit)]
    delta: f32,
    /// Ageing: largest age of a sample in views
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u32).range(0..=65_535))]
    max_age: u32,
    /// Ageing: samples that a level needs to vote
    #[arg(long, value_name = "N", default_value_t = 10)]
    n_min: usize,
    /// Most bytes of textures in memory, e.g. 64MiB (default: the scene's, else no limit)
    #[arg(long, value_name = "SIZE", value_parser = bytes)]
    texture_budget: Option<u64>,
    /// Most bytes of environment maps; 0 shows nothing but the coarsest
    #[arg(long, value_name = "SIZE", value_parser = bytes, default_value = "64MiB")]
    environment_budget: u64,
    #[command(flatten)]
    illumination: IlluminationArguments,
    /// One JSON document
    #[arg(long)]
    json: bool,
}

/// Names of policies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum PolicyName {
    /// Saliency and task, reduced per level (Haber et al.)
    Attention,
    /// Largest objects first
    Coverage,
    /// Level by level
    Uniform,
    /// Any order
    Random,
    /// Expected drop of visible error per time, learnt while tracing
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
    /// Exact tiles of the lattice
    Tile,
    /// Squares, the paper's look
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

/// A frame as the renderer handed it over.
struct Shown {
    snapshot: Arc<FrameSnapshot>,
    counts: FrameCounts,
}

struct Handover(Arc<SegQueue<Shown>>);

impl FrameSink for Handover {
    fn frame_shown(&mut self, snapshot: &Arc<FrameSnapshot>, counts: FrameCounts, _renderer: &Renderer) {
        self.0.push(Shown { snapshot: snapshot.clone(), counts });
    }
}

/// Runs the command.
pub fn run(a: &WalkArguments, progress: Progress) -> Result<(), Failure> {
    session::end_on_interrupt();
    let mut session = session::open(&a.scene, &a.illumination, progress)?;
    let budget = Budget {
        texture_bytes: a.texture_budget.or(session.world.scene.budget.texture_bytes),
        ..session.world.scene.budget
    };
    let plan = ScenePlan::new(&session.world.scene, &budget);
    session.limit_textures(budget.texture_bytes, a.illumination.cache.as_deref())?;
    let scene = session.world.scene.clone();
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
            FootprintName::Tile => Footprint::Tile,
            FootprintName::Square => Footprint::Square,
        },
        ageing: foveal::splatting::AgeingRules { delta: a.delta, max_age: a.max_age, n_min: a.n_min },
        environment_bytes: a.environment_budget,
        winner_takes_all: a.winner_takes_all,
        supersampling: a.refine.map(|noise| Supersampling { noise, max_samples: a.refine_samples }),
        ..Settings::new(a.size.width, a.size.height, a.workers.unwrap_or(cores.min(TRACERS_MAX)))
    };
    if let Some(out) = &a.out {
        make_folder(out)?;
    }
    // Textures under pressure need somebody to decide and to load, edges somebody to smooth them.
    let corrects =
        plan.needs(Part::Tracers) || session.textures.is_some() || settings.supersampling.is_some();
    let stages = StageTimes::default();
    let handover = Arc::new(SegQueue::new());
    let insight = InsightSlot::default();
    let passes = Passes { texture_ids: plan.needs(Part::TextureIdPass) };
    let world = session.world.clone();
    let session_textures = session.textures.clone();
    let refinement = session.refinement.clone();
    let parts = || Parts {
        settings,
        world: world.clone(),
        passes,
        corrects,
        textures: session_textures.clone(),
        probes: None,
        refinement: refinement.clone(),
        insight: Some(insight.clone()),
        stages: stages.clone(),
        sink: Box::new(Handover(handover.clone())),
    };
    // One thread more than tracers: of k threads, k − 1 may trace at once, so the light actors keep one.
    // The illuminator has one of its own, so that no tracer waits behind its turns.
    let threads = usize::from(session.refinement.is_some())
        + if corrects { settings.tracers as usize + 1 } else { usize::from(session.refinement.is_some()) };
    let mut config = Config { seed: a.seed, ..Config::live(threads) };
    if a.profile.is_some() {
        config.ring_turns = PROFILED_TURNS;
    }
    if let Some(file) = &a.record {
        let run = RecordedRun::new("walk", &a.scene, &session, &a.illumination, &settings, passes, corrects)?;
        (config.application, config.hashing) = (run.to_bytes()?, a.hashes.into());
        config = config.record(file);
    }
    let built = match Runtime::build(config, |w| wire(w, parts())) {
        Err(BuildError::Record(e)) => {
            warn(&mut session, format!("the walk is not recorded: {e}; choose another --record"));
            Runtime::build(Config { seed: a.seed, ..Config::live(threads) }, |w| wire(w, parts()))
        }
        built => built,
    };
    let (mut runtime, actors) =
        built.map_err(|e| Failure::Environment(format!("the actors cannot be started: {e}")))?;
    let pictures = a.out.as_ref().map(|out| PictureWriter::new(out.clone()));

    let walked = walk(
        a,
        &mut runtime,
        &actors,
        &motion,
        frames,
        fps,
        &stages,
        session.textures.as_deref(),
        corrects.then_some(&insight),
        &handover,
        pictures.as_ref(),
        progress,
    )?;
    if let RecordingStatus::Stopped { reason } = runtime.recording() {
        session.warnings.push(format!("the recording ends early: {reason}"));
    }
    if let Some(file) = &a.profile {
        write_atomic(file, &replay::profile(&runtime.timeline(), file))?;
    }
    let converged = runtime.inspect(actors.renderer, Renderer::is_converged).unwrap_or(false);
    let deliveries = runtime.deliveries();
    // It would go on until the light is final.
    if let Some(illuminator) = actors.illuminator {
        runtime.control(illuminator, Control::Stop);
    }
    // Only the main thread's actors can be looked at while others run.
    let end = runtime.end(Duration::from_secs(10));
    let (lost_jobs, incidents) = actors.correction.map_or((0, Vec::new()), |c| {
        let look = |a: &Allocator| {
            (a.lost_jobs(), a.incidents().iter().map(|i| format!("{i:?}")).collect::<Vec<_>>())
        };
        runtime.inspect(c.allocator, look).unwrap_or_default()
    });
    let textures = session.textures.as_ref().and_then(|store| textures_json(store, &walked.textures, &scene));
    let mut document =
        document(a, &session, &settings, &plan, fps, &walked, converged, deliveries, lost_jobs, &incidents);
    if let Some(mut textures) = textures {
        textures["peak_used_bytes"] = json!(walked.textures.iter().map(|p| p.used).max());
        textures["peak_held_bytes"] = json!(held_bytes().1);
        document["textures"] = textures;
    }
    if let (Some(out), Some(pictures)) = (&a.out, pictures) {
        let linear = runtime.inspect(actors.renderer, Renderer::picture).flatten();
        if let Some(picture) = linear {
            write_atomic(&out.join("last.exr"), &super::output::exr_bytes(&picture)?)?;
        }
        pictures.finish()?;
        let page = figures::page(&runtime, &actors, &session.world, &settings, &document, &walked, fps)?;
        write_atomic(&out.join("report.html"), super::report::html(&page).as_bytes())?;
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

fn warn(session: &mut Session, warning: String) {
    tracing::warn!("{warning}");
    session.warnings.push(warning);
}

#[expect(clippy::too_many_arguments, reason = "the one caller has them all")]
fn walk(
    a: &WalkArguments,
    runtime: &mut Runtime,
    actors: &Actors,
    motion: &Motion<'_>,
    frames: u32,
    fps: f32,
    stages: &StageTimes,
    store: Option<&TextureStore>,
    insight: Option<&InsightSlot>,
    handover: &SegQueue<Shown>,
    pictures: Option<&PictureWriter>,
    progress: Progress,
) -> Result<Walked, Failure> {
    let mut walked = Walked {
        frame_ms: Vec::new(),
        points: Vec::new(),
        stages: Vec::new(),
        traced: 0,
        reused: 0,
        expired: 0,
        late: 0,
        refined: 0,
        approximated: 0,
        textures: Vec::new(),
        insight: None,
        memory: None,
    };
    forget_most_held();
    let bar = progress.bar(u64::from(frames), "walk");
    let budget = Duration::from_secs_f32(1.0 / fps);
    let start = Instant::now();
    let renderer = actors.renderer;
    let mut frame = 0;
    let mut pose = motion.at(0.0);
    loop {
        let staying = frame >= frames;
        if interrupted() || (staying && (!a.until_converged || is_done(runtime, actors))) {
            break;
        }
        let began = Instant::now();
        if !staying {
            pose = motion.at((began - start).as_secs_f32());
        }
        send(actors, RendererInput::FrameBegan { frame: FrameIndex(frame), camera: pose })?;
        // The camera has not moved and all is traced: nothing to wait for once the stay has begun.
        let done_early = |r: &Runtime| {
            interrupted() || (staying && r.inspect(renderer, Renderer::is_refined) == Some(true))
        };
        runtime.pump_until(Limit::time(budget.saturating_sub(began.elapsed())), done_early);
        let mut is_enough = |r: &Runtime| {
            let Some(slot) = insight else { return true };
            if let Some(newest) = slot.take() {
                walked.insight = Some(newest);
            }
            let now = walked.insight.as_ref().map_or((View(0), 0.0), |i| (i.view, i.quality));
            let view = r.inspect(renderer, |r| r.drawn().map(|d| d.view)).flatten();
            // Where it has converged nothing more can be done.
            let converged = r.inspect(renderer, Renderer::is_converged) == Some(true);
            let bound = a.mode.least_quality().unwrap_or(f32::NEG_INFINITY);
            interrupted() || converged || (Some(now.0) == view && now.1 >= bound)
        };
        match a.mode.least_quality() {
            Some(_) if !staying => {
                runtime.pump_until(Limit::time(LONGEST_FRAME.saturating_sub(began.elapsed())), is_enough);
            }
            _ => {
                is_enough(runtime);
            }
        }
        let quality = walked.insight.as_ref().map_or(0.0, |i| i.quality);
        walked.memory = walked.memory.max(memory_bytes());
        send(actors, RendererInput::DeadlineReached { frame: FrameIndex(frame) })?;
        runtime.pump_until(Limit::time(Duration::from_secs(60)), |_| !handover.is_empty());
        let Some(shown) = handover.pop() else {
            return Err(Failure::Check(format!("frame {frame} was not shown within a minute")));
        };
        let total_ms = began.elapsed().as_secs_f32() * 1e3;
        let measured: Vec<(Stage, f32)> =
            stages.drain().into_iter().map(|(s, d)| (s, d.as_secs_f32() * 1e3)).collect();
        let of = |stage| measured.iter().filter(|m| m.0 == stage).map(|m| m.1).sum::<f32>();
        // Warping and splatting come in many pieces; what counts is their sum over a frame.
        for stage in Stage::ALL {
            let sum = of(stage);
            if measured.iter().any(|m| m.0 == stage) {
                walked.stages.push((stage, sum));
            }
        }
        walked.frame_ms.push(total_ms);
        walked.points.push(FramePoint {
            total_ms,
            display_ms: of(Stage::Display),
            samples: shown.counts.traced,
            quality,
        });
        walked.traced += u64::from(shown.counts.traced);
        walked.reused += u64::from(shown.counts.reused);
        walked.expired += u64::from(shown.counts.expired);
        walked.late += u64::from(shown.counts.late);
        walked.refined += u64::from(shown.counts.refined);
        walked.approximated += u64::from(shown.counts.approximated);
        let reports = store.map(|s| std::iter::from_fn(|| s.reports.pop()).collect::<Vec<_>>());
        if let Some(report) = reports.unwrap_or_default().pop().or_else(|| walked.textures.last().cloned()) {
            walked.textures.push(report);
        }
        // Of a stay only the last picture is kept; it takes the place of the last frame's.
        if let Some(pictures) = pictures {
            pictures.write(&format!("frame-{:04}.png", frame.min(frames - 1)), shown.snapshot)?;
        }
        frame += 1;
        bar.set_position(u64::from(frame.min(frames)));
    }
    bar.finish_and_clear();
    Ok(walked)
}

fn is_done(runtime: &Runtime, actors: &Actors) -> bool {
    runtime.inspect(actors.renderer, |r| r.is_refined() && r.is_shown()).unwrap_or(false)
}

fn send(actors: &Actors, input: RendererInput) -> Result<(), Failure> {
    actors.input.send(input).map_err(|e| Failure::Check(format!("the renderer takes no input: {e}")))
}
