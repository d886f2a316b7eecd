//! The walk that is simulated, and what must hold during it and after.

use std::cell::OnceCell;
use std::io::Write;
use std::path::Path;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use crossbeam_queue::SegQueue;
use foveal::display::twin::Passes;
use foveal::image::Map2d;
use foveal::scene::Camera;
use foveal::scene::plan::{Part, ScenePlan};
use foveal::world::World;
use foveal_runtime::simulate::{Fault, FaultKind, Faults, Simulation, shrink};
use foveal_runtime::{
    ActorId, BuildError, Config, Exit, JobPool, Limit, NodeInfo, Record, Runtime, Trace, TraceError,
};
use glam::Vec3;

use super::{Broken, FRAME, SAMPLES_PER_JOB, SimulateArguments, StrategyName};
use crate::allocator::Allocator;
use crate::cache_ager::CacheAger;
use crate::cli::failure::Failure;
use crate::cli::recording::RecordedRun;
use crate::cli::reference::traced_picture;
use crate::cli::replay::Unseen;
use crate::cli::session::{IlluminationArguments, Session, camera};
use crate::message::{FrameIndex, RendererInput, TraceJob};
use crate::renderer::Renderer;
use crate::settings::Settings;
use crate::stages::StageTimes;
use crate::tracer::Tracer;
use crate::wiring::{Actors, Correction, Parts, wire};

/// A walk of a few frames and a stay, and what it must come to.
pub(super) struct Scenario {
    strategy: StrategyName,
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

impl Scenario {
    pub(super) fn new(
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
        Ok(Self { strategy: a.strategy, world, settings, passes, corrects, cameras, reference, header })
    }

    fn parts(&self) -> Parts {
        Parts {
            settings: self.settings,
            world: self.world.clone(),
            passes: self.passes,
            corrects: self.corrects,
            probes: None,
            refinement: None,
            textures: None,
            insight: None,
            stages: StageTimes::default(),
            sink: Box::new(Unseen),
        }
    }

    /// All actors by identity, and which of them are tracers.
    pub(super) fn actors(&self) -> Result<(Vec<NodeInfo>, Vec<ActorId>), Failure> {
        let (runtime, actors) =
            Runtime::build(Config::simulate(Simulation::new(0)), |w| wire(w, self.parts()))
                .map_err(|e| Failure::Environment(format!("the actors cannot be started: {e}")))?;
        Ok((runtime.actors().to_vec(), actors.tracers.iter().map(|t| t.id()).collect()))
    }

    /// Runs a seed, once or twice.
    pub(super) fn check(&self, seed: u64, faults: &[Fault], twice: bool) -> Result<(), String> {
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
    pub(super) fn pin_down(
        &self,
        seed: u64,
        faults: &[Fault],
        invariant: String,
        a: &SimulateArguments,
    ) -> Broken {
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
            strategy: self.strategy.of(seed),
            faults: Faults::Listed(faults.to_vec()),
            invariant: Some(Box::new(move |runtime| match watch.get() {
                Some(watched) => watched.check(runtime, &settings),
                None => Ok(()),
            })),
            ..Simulation::new(seed)
        };
        let mut config = Config::simulate(simulation);
        let at = |kind| faults.iter().find(|f| f.kind == kind).map(|f| f.at as usize);
        let disk = Disk::new(at(FaultKind::DiskFull), at(FaultKind::TornLog));
        config.record = match (record, &disk) {
            (Some(file), _) => Some(Record::File(file.to_owned())),
            (None, Some(disk)) => Some(Record::Sink(Box::new(disk.clone()))),
            (None, None) => None,
        };
        config.application.clone_from(&self.header);
        let (mut runtime, actors) = match Runtime::build(config, |w| wire(w, self.parts())) {
            // Without room for a header there is no recording, and the walk goes on.
            Err(BuildError::Record(_)) if disk.is_some() => return Ok(0),
            built => built.map_err(|e| e.to_string())?,
        };
        if let (Some(correction), Some(pool)) = (actors.correction, &actors.pool) {
            let _ = watched.set(Watched { correction, pool: pool.clone() });
        }
        let ran = self.walk(&mut runtime, &actors).and_then(|()| self.at_rest(&runtime, &actors));
        let fingerprint = runtime.fingerprint();
        if record.is_some() || disk.is_some() {
            runtime.shutdown(Duration::from_secs(10));
        }
        ran?;
        match disk.filter(|_| record.is_none()) {
            Some(disk) => self.replay_what_is_left(&disk.content()).map(|()| fingerprint),
            None => Ok(fingerprint),
        }
    }

    /// Whatever a disk kept of a recording replays as far as it goes.
    fn replay_what_is_left(&self, bytes: &[u8]) -> Result<(), String> {
        let trace = match Trace::from_bytes(bytes) {
            Ok(trace) => Arc::new(trace),
            // It ends in its first words.
            Err(TraceError::NotARecording | TraceError::Version { .. } | TraceError::Header { .. }) => {
                return Ok(());
            }
            Err(e) => return Err(e.to_string()),
        };
        let (mut runtime, _) =
            Runtime::build(Config::replay(trace, 0), |w| wire(w, self.parts())).map_err(|e| e.to_string())?;
        match runtime.replay().divergence {
            None => Ok(()),
            Some(divergence) => Err(format!("what is left of the recording diverges: {divergence}")),
        }
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

/// A disk in memory with so much room, and a file on it of which only the beginning is found again.
#[derive(Clone)]
struct Disk {
    written: Arc<SegQueue<Vec<u8>>>,
    room: usize,
    torn_at: usize,
}

impl Disk {
    fn new(room: Option<usize>, torn_at: Option<usize>) -> Option<Self> {
        (room.is_some() || torn_at.is_some()).then(|| Self {
            written: Arc::default(),
            room: room.unwrap_or(usize::MAX),
            torn_at: torn_at.unwrap_or(usize::MAX),
        })
    }

    fn content(&self) -> Vec<u8> {
        let mut bytes: Vec<u8> = std::iter::from_fn(|| self.written.pop()).flatten().collect();
        bytes.truncate(self.torn_at);
        bytes
    }
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        if self.room == 0 {
            return Err(std::io::ErrorKind::StorageFull.into());
        }
        let length = bytes.len().min(self.room);
        self.room -= length;
        self.written.push(bytes[..length].to_vec());
        Ok(length)
    }

    fn flush(&mut self) -> std::io::Result<()> {
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
        let maps = runtime.inspect(self.correction.allocator, |a| a.environments().bytes());
        if let Some(bytes) = maps.filter(|bytes| *bytes > settings.environment_bytes) {
            return Err(format!("{bytes} bytes of environment maps, {} allowed", settings.environment_bytes));
        }
        match runtime.inspect(self.correction.cache_ager, CacheAger::len) {
            Some(kept) if kept > settings.cache_capacity => {
                Err(format!("{kept} samples kept, {} allowed", settings.cache_capacity))
            }
            _ => Ok(()),
        }
    }
}
