//! `foveal simulate`: the same actors on one thread under a virtual clock, in the order and with the faults that a
//! seed decides.

use std::cell::OnceCell;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::{Duration, Instant};

use clap::{Args, ValueEnum};
use foveal::display::twin::Passes;
use foveal::image::Map2d;
use foveal::scene::Camera;
use foveal::scene::plan::{Part, ScenePlan};
use foveal::world::World;
use foveal_runtime::simulate::{Fault, FaultKind, Faults, Simulation, Strategy, shrink};
use foveal_runtime::{ActorId, Config, Exit, JobPool, Limit, NodeInfo, Record, Runtime};
use glam::Vec3;
use serde_json::{Value, json};

use super::Progress;
use super::arguments::Size;
use super::failure::Failure;
use super::output::{make_folder, print_json, print_line};
use super::recording::{RecordedRun, TRACERS_MAX};
use super::reference::traced_picture;
use super::replay::Unseen;
use super::session::{self, BakeSettingsArguments, IlluminationArguments, Session, camera, interrupted};
use crate::allocator::Allocator;
use crate::cache_ager::CacheAger;
use crate::message::{FrameIndex, RendererInput, TraceJob};
use crate::renderer::Renderer;
use crate::settings::Settings;
use crate::stages::StageTimes;
use crate::tracer::Tracer;
use crate::wiring::{Actors, Correction, Parts, wire};

/// Samples of a job: few, so that small pictures make many messages.
const SAMPLES_PER_JOB: u32 = 32;
/// Virtual time of a frame: some jobs of a view are done in it, others are not.
const FRAME: Duration = Duration::from_millis(5);
/// Deliveries, sends or turns of an actor within which its faults come.
const HORIZON: u64 = 60;
/// Faults of a kind that an actor gets at most.
const FAULTS_EACH: u64 = 2;
/// Schedules, by seed.
const STRATEGIES: [Strategy; 4] =
    [Strategy::Random, Strategy::Pct { depth: 3, horizon: 500 }, Strategy::RoundRobin, Strategy::StarveOne];

/// Arguments of `foveal simulate`.
#[derive(Args, Debug)]
pub struct SimulateArguments {
    /// An OBJ file or a sidecar; its light is the quick one, without a bake
    scene: PathBuf,
    /// Which seeds, the last one left out
    #[arg(long, value_name = "A..B", value_parser = seeds)]
    seeds: Seeds,
    /// What goes wrong, where and when the seed says; panics hit tracers only
    #[arg(long, value_enum, value_delimiter = ',')]
    faults: Vec<FaultName>,
    /// Exactly this goes wrong instead, as a failure prints it; may be repeated
    #[arg(long, value_name = "ACTOR:KIND:AT", conflicts_with = "faults")]
    fault: Vec<String>,
    /// Picture size
    #[arg(long, value_name = "WxH", default_value = "64x64")]
    size: Size,
    /// Frames of the walk, before the stay that must converge
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    frames: u32,
    /// Number of tracers
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=i64::from(TRACERS_MAX)))]
    workers: u32,
    /// Run each seed twice; the runs must be equal message by message
    #[arg(long)]
    twice: bool,
    /// Folder for a recording of each failure, for `foveal replay`
    #[arg(long, value_name = "DIR")]
    traces: Option<PathBuf>,
    /// One JSON document
    #[arg(long)]
    json: bool,
}

/// A range of seeds, the last one left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Seeds {
    start: u64,
    end: u64,
}

fn seeds(text: &str) -> Result<Seeds, String> {
    let wrong = || format!("`{text}` is no range of seeds; write it as 0..100");
    let (start, end) = text.split_once("..").ok_or_else(wrong)?;
    let (start, end) = (start.parse().map_err(|_| wrong())?, end.parse().map_err(|_| wrong())?);
    if start < end { Ok(Seeds { start, end }) } else { Err(wrong()) }
}

/// What can go wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum FaultName {
    /// A job kills its tracer
    Panic,
    /// A turn comes a millisecond late
    Delay,
    /// An actor hangs for 100 ms
    Stall,
    /// Ten turns take 100 times as long
    Slow,
    /// A message or a job comes back to its sender
    Full,
}

impl From<FaultName> for FaultKind {
    fn from(name: FaultName) -> Self {
        match name {
            FaultName::Panic => Self::Panic,
            FaultName::Delay => Self::Delay,
            FaultName::Stall => Self::Stall,
            FaultName::Slow => Self::Slow,
            FaultName::Full => Self::Full,
        }
    }
}

fn word(kind: FaultKind) -> &'static str {
    match kind {
        FaultKind::Panic => "panic",
        FaultKind::Delay => "delay",
        FaultKind::Stall => "stall",
        FaultKind::Slow => "slow",
        FaultKind::Full => "full",
    }
}

/// A walk of a few frames and a stay, and what it must come to.
struct Scenario {
    world: World,
    settings: Settings,
    passes: Passes,
    corrects: bool,
    cameras: Vec<Camera>,
    /// What the last view must converge to.
    reference: Map2d<Vec3>,
    /// The header of a recording.
    header: Vec<u8>,
}

/// A seed that broke an invariant.
struct Broken {
    seed: u64,
    invariant: String,
    faults: Vec<Fault>,
    trace: Option<PathBuf>,
}

/// Runs the command.
pub fn run(a: &SimulateArguments, progress: Progress) -> Result<(), Failure> {
    session::end_on_interrupt();
    let illumination = IlluminationArguments {
        bake: None,
        quick: true,
        cache: None,
        settings: BakeSettingsArguments::default(),
    };
    let session = session::open(&a.scene, &illumination, progress)?;
    if let Some(folder) = &a.traces {
        make_folder(folder)?;
    }
    let scenario = Scenario::new(a, &session, &illumination)?;
    let (nodes, tracers) = scenario.actors()?;
    let listed: Vec<Fault> = a.fault.iter().map(|f| parse_fault(f, &nodes)).collect::<Result<_, _>>()?;
    let kinds: Vec<FaultKind> = a.faults.iter().map(|f| (*f).into()).collect();
    let start = Instant::now();
    let bar = progress.bar(a.seeds.end - a.seeds.start, "simulate");
    let mut broken = Vec::new();
    let mut done = 0;
    for seed in a.seeds.start..a.seeds.end {
        if interrupted() {
            break;
        }
        let faults = if listed.is_empty() { draw(seed, &kinds, &nodes, &tracers) } else { listed.clone() };
        if let Err(invariant) = scenario.check(seed, &faults, a.twice) {
            broken.push(scenario.pin_down(seed, &faults, invariant, a));
        }
        done += 1;
        bar.inc(1);
    }
    bar.finish_and_clear();
    let seconds = start.elapsed().as_secs_f64();
    let failures: Vec<Value> = broken.iter().map(|b| failure(b, a, &nodes)).collect();
    if a.json {
        print_json(&json!({
            "schema": "foveal.simulate/1",
            "scene": session.world.scene.name,
            "seeds": done,
            "first": a.seeds.start,
            "faults": kinds.iter().map(|k| word(*k)).collect::<Vec<_>>(),
            "seconds": seconds,
            "failures": failures,
        }));
    } else {
        print_line(&format!("{done} seeds in {seconds:.1} s, {} failures", failures.len()));
        for failure in &failures {
            let text = |key: &str| failure[key].as_str().unwrap_or_default().to_owned();
            print_line(&format!("seed {}: {}\n    {}", failure["seed"], text("invariant"), text("command")));
        }
    }
    if interrupted() {
        return Err(Failure::Interrupted("interrupted; the seeds done so far are told".into()));
    }
    match failures.len() {
        0 => Ok(()),
        n => Err(Failure::Check(format!("{n} of {done} seeds break an invariant"))),
    }
}

/// The faults of a seed. A tracer's panic costs only time; what another actor is told when it panics is gone for good,
/// so there none is drawn.
fn draw(seed: u64, kinds: &[FaultKind], nodes: &[NodeInfo], tracers: &[ActorId]) -> Vec<Fault> {
    let seeded = Faults::Seeded { kinds: kinds.to_vec(), each: FAULTS_EACH, horizon: HORIZON };
    let mut faults: Vec<Fault> =
        (0..nodes.len() as u32).flat_map(|actor| seeded.of(seed, ActorId(actor))).collect();
    faults.retain(|f| f.kind != FaultKind::Panic || tracers.contains(&f.actor));
    faults
}

fn parse_fault(text: &str, nodes: &[NodeInfo]) -> Result<Fault, Failure> {
    let wrong =
        || Failure::Usage(format!("--fault {text}: an actor, a kind and a number, as tracer:panic:3"));
    let mut parts = text.rsplitn(3, ':');
    let (Some(at), Some(kind), Some(actor)) = (parts.next(), parts.next(), parts.next()) else {
        return Err(wrong());
    };
    let number = nodes.iter().position(|n| n.name == actor && n.class.is_some()).ok_or_else(|| {
        let names: Vec<&str> = nodes.iter().filter(|n| n.class.is_some()).map(|n| n.name.as_str()).collect();
        Failure::Usage(format!("--fault {text}: no actor \"{actor}\"; there are {}", names.join(", ")))
    })?;
    let kind = FaultName::from_str(kind, true).map_err(|_| wrong())?.into();
    Ok(Fault { actor: ActorId(number as u32), kind, at: at.parse().map_err(|_| wrong())? })
}

fn failure(b: &Broken, a: &SimulateArguments, nodes: &[NodeInfo]) -> Value {
    let name = |f: &Fault| nodes.get(f.actor.0 as usize).map_or("?", |n| n.name.as_str());
    let faults: Vec<String> =
        b.faults.iter().map(|f| format!("{}:{}:{}", name(f), word(f.kind), f.at)).collect();
    let given: String = faults.iter().map(|f| format!(" --fault '{f}'")).collect();
    let command = format!(
        "foveal simulate {} --seeds {}..{} --size {}x{} --frames {} --workers {}{}{given}",
        a.scene.display(),
        b.seed,
        b.seed + 1,
        a.size.width,
        a.size.height,
        a.frames,
        a.workers,
        if a.twice { " --twice" } else { "" },
    );
    json!({
        "seed": b.seed,
        "invariant": b.invariant,
        "command": command,
        "faults": faults,
        "trace": b.trace.as_ref().map(|t| t.display().to_string()),
    })
}

impl Scenario {
    fn new(
        a: &SimulateArguments,
        session: &Session,
        illumination: &IlluminationArguments,
    ) -> Result<Self, Failure> {
        let world = session.world.clone();
        let plan = ScenePlan::new(&world.scene, &world.scene.budget);
        let (passes, corrects) =
            (Passes { texture_ids: plan.needs(Part::TextureIdPass) }, plan.needs(Part::Tracers));
        let settings = Settings {
            samples_per_job: SAMPLES_PER_JOB,
            ..Settings::new(a.size.width, a.size.height, a.workers)
        };
        let still = camera(&world.scene, None)?.camera;
        let at = |frame: u32| match world.scene.paths.first() {
            Some(path) => path.at(frame as f32 * 0.1, still.up, still.fov_y),
            None => still,
        };
        let cameras: Vec<Camera> = (0..a.frames).map(at).collect();
        let last = cameras.last().copied().unwrap_or(still).frame(settings.width, settings.height);
        let reference = traced_picture(&world, &last, settings.seed, 1, &|| true);
        let header =
            RecordedRun::new("simulate", &a.scene, session, illumination, &settings, passes, corrects)?
                .to_bytes()?;
        Ok(Self { world, settings, passes, corrects, cameras, reference, header })
    }

    fn parts(&self) -> Parts {
        Parts {
            settings: self.settings,
            world: self.world.clone(),
            passes: self.passes,
            corrects: self.corrects,
            textures: None,
            stages: StageTimes::default(),
            sink: Box::new(Unseen),
        }
    }

    /// All actors by identity, and which of them are tracers.
    fn actors(&self) -> Result<(Vec<NodeInfo>, Vec<ActorId>), Failure> {
        let (runtime, actors) =
            Runtime::build(Config::simulate(Simulation::new(0)), |w| wire(w, self.parts()))
                .map_err(|e| Failure::Environment(format!("the actors cannot be started: {e}")))?;
        Ok((runtime.actors().to_vec(), actors.tracers.iter().map(|t| t.id()).collect()))
    }

    /// Runs a seed, once or twice.
    fn check(&self, seed: u64, faults: &[Fault], twice: bool) -> Result<(), String> {
        // Injected panics are what was asked for, so nobody is warned of them.
        tracing::subscriber::with_default(tracing::subscriber::NoSubscriber::default(), || {
            let first = self.simulate(seed, faults, None)?;
            if twice && self.simulate(seed, faults, None)? != first {
                return Err("two runs of the same seed differ".to_owned());
            }
            Ok(())
        })
    }

    /// Finds the faults that a failure needs, and records it.
    fn pin_down(&self, seed: u64, faults: &[Fault], invariant: String, a: &SimulateArguments) -> Broken {
        let faults = shrink(faults, |fewer| self.check(seed, fewer, a.twice).is_err());
        let invariant = self.check(seed, &faults, a.twice).err().unwrap_or(invariant);
        let trace = a.traces.as_ref().map(|folder| folder.join(format!("seed-{seed}.fvl")));
        if let Some(file) = &trace {
            // It fails again; what counts is the recording.
            let _ = self.simulate(seed, &faults, Some(file));
        }
        Broken { seed, invariant, faults, trace }
    }

    /// One run; its fingerprint, or the invariant it breaks.
    fn simulate(&self, seed: u64, faults: &[Fault], record: Option<&Path>) -> Result<u64, String> {
        let watched: Rc<OnceCell<Watched>> = Rc::default();
        let (watch, settings) = (Rc::clone(&watched), self.settings);
        let simulation = Simulation {
            strategy: STRATEGIES[(seed % STRATEGIES.len() as u64) as usize],
            faults: Faults::Listed(faults.to_vec()),
            invariant: Some(Box::new(move |runtime| match watch.get() {
                Some(watched) => watched.check(runtime, &settings),
                None => Ok(()),
            })),
            ..Simulation::new(seed)
        };
        let mut config = Config::simulate(simulation);
        config.record = record.map(|file| Record::File(file.to_owned()));
        config.application.clone_from(&self.header);
        let (mut runtime, actors) =
            Runtime::build(config, |w| wire(w, self.parts())).map_err(|e| e.to_string())?;
        if let (Some(correction), Some(pool)) = (actors.correction, &actors.pool) {
            let _ = watched.set(Watched { correction, pool: pool.clone() });
        }
        let ran = self.walk(&mut runtime, &actors).and_then(|()| self.at_rest(&runtime, &actors));
        let fingerprint = runtime.fingerprint();
        if record.is_some() {
            runtime.shutdown(Duration::from_secs(10));
        }
        ran.map(|()| fingerprint)
    }

    /// A few frames whose views do not converge in time, then the last one again until nothing is left to do.
    fn walk(&self, runtime: &mut Runtime, actors: &Actors) -> Result<(), String> {
        let send = |input| actors.input.send(input).map_err(|e| format!("the renderer takes no input: {e}"));
        let broke = |runtime: &Runtime| runtime.failure().map_or_else(String::new, |f| f.to_string());
        for (frame, &camera) in (0..).map(FrameIndex).zip(&self.cameras) {
            send(RendererInput::FrameBegan { frame, camera })?;
            if runtime.pump(Limit::time(FRAME)) == Exit::Halted {
                return Err(broke(runtime));
            }
            send(RendererInput::DeadlineReached { frame })?;
        }
        // Twice: the second finds all at rest and shows what has come since.
        for stay in 0..2 {
            if runtime.pump(Limit::IDLE) != Exit::Idle {
                return Err(broke(runtime));
            }
            let frame = FrameIndex(self.cameras.len() as u32 + stay);
            send(RendererInput::DeadlineReached { frame })?;
        }
        match runtime.pump(Limit::IDLE) {
            Exit::Idle => Ok(()),
            _ => Err(broke(runtime)),
        }
    }

    /// What must hold once nothing is left to do.
    fn at_rest(&self, runtime: &Runtime, actors: &Actors) -> Result<(), String> {
        let mut dead = 0;
        if let (Some(correction), Some(pool)) = (actors.correction, &actors.pool) {
            let stats = pool.stats();
            dead = stats.dead;
            let left = runtime.inspect(correction.allocator, Allocator::in_flight).unwrap_or(u32::MAX);
            let lost = runtime.inspect(correction.allocator, Allocator::lost_jobs).unwrap_or(u32::MAX);
            if left != 0 || stats.waiting != 0 {
                return Err(format!(
                    "{left} jobs without an answer, {} in the pool, and all rest",
                    stats.waiting
                ));
            }
            if u64::from(lost) != dead {
                return Err(format!("{dead} jobs were given up, the allocator knows of {lost}"));
            }
            let holds = |t: &_| runtime.inspect(*t, Tracer::is_empty_handed) == Some(false);
            if actors.tracers.iter().any(holds) {
                return Err("a tracer holds samples that nobody got".into());
            }
        }
        let (converged, shown) =
            runtime.inspect(actors.renderer, |r| (r.is_converged(), r.is_shown())).unwrap_or_default();
        if !converged || !shown {
            return Err(format!("all rest, converged: {converged}, shown: {shown}"));
        }
        let Some(picture) = runtime.inspect(actors.renderer, Renderer::picture).flatten() else {
            return Err("nothing was shown".into());
        };
        let bits = |c: &Vec3| c.to_array().map(f32::to_bits);
        let pairs = picture.data().iter().zip(self.reference.data());
        let differing = pairs.filter(|(a, b)| bits(a) != bits(b)).count() as u64;
        // Pixels of jobs that were given up stay coarse.
        if differing > dead * u64::from(self.settings.samples_per_job) {
            return Err(format!(
                "{differing} pixels of the converged picture differ from the traced reference"
            ));
        }
        Ok(())
    }
}

/// What is looked at after each step.
struct Watched {
    correction: Correction,
    pool: JobPool<TraceJob>,
}

impl Watched {
    fn check(&self, runtime: &Runtime, settings: &Settings) -> Result<(), String> {
        let stats = self.pool.stats();
        let out = stats.pushed.saturating_sub(stats.completed + stats.stale + stats.dead);
        if let Some(in_flight) = runtime.inspect(self.correction.allocator, Allocator::in_flight)
            && (u64::from(in_flight) < out || in_flight > settings.jobs_in_flight() + 4)
        {
            return Err(format!("the allocator counts {in_flight} jobs in flight, {out} are out"));
        }
        match runtime.inspect(self.correction.cache_ager, CacheAger::len) {
            Some(kept) if kept > settings.cache_capacity => {
                Err(format!("{kept} samples kept, {} allowed", settings.cache_capacity))
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_and_faults_parse_and_nonsense_is_refused() {
        assert_eq!(seeds("3..7"), Ok(Seeds { start: 3, end: 7 }));
        for wrong in ["", "3", "7..3", "3..3", "a..b", "-1..2", "1..=2"] {
            assert!(seeds(wrong).is_err(), "{wrong}");
        }
        let node = |name: &str| NodeInfo { name: name.into(), class: Some(foveal_runtime::Class::Light) };
        let nodes = [node("cache ager"), node("tracer-2")];
        let fault = parse_fault("tracer-2:stall:12", &nodes).expect("a fault");
        assert_eq!(fault, Fault { actor: ActorId(1), kind: FaultKind::Stall, at: 12 });
        for wrong in ["tracer-2:stall", "tracer:stall:1", "tracer-2:burn:1", "tracer-2:full:x", ""] {
            assert_eq!(parse_fault(wrong, &nodes).expect_err(wrong).exit_code(), 2);
        }
    }

    #[test]
    fn only_tracers_panic() {
        let node = |name: &str| NodeInfo { name: name.into(), class: Some(foveal_runtime::Class::Light) };
        let nodes = [node("renderer"), node("tracer")];
        let all: Vec<Fault> = (0..50)
            .flat_map(|seed| draw(seed, &[FaultKind::Panic, FaultKind::Full], &nodes, &[ActorId(1)]))
            .collect();
        let of = |kind, actor| all.iter().filter(|f| f.kind == kind && f.actor == ActorId(actor)).count();
        assert_eq!(of(FaultKind::Panic, 0), 0);
        assert!(of(FaultKind::Panic, 1) > 0 && of(FaultKind::Full, 0) > 0);
    }
}
