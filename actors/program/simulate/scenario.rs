//! The walk that is simulated, and what must hold during it and after.

use std::cell::OnceCell;
use std::io::Write;
use std::path::Path;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use crossbeam_queue::SegQueue;
use foveal::allocation::policy::Policy;
use foveal::display::first_approximation::Probes;
use foveal::illumination::bake::{BakeSettings, Baker};
use foveal::image::Map2d;
use foveal::rng::hash;
use foveal::scene::Camera;
use foveal::scene::camera::CameraFrame;
use foveal::scene::plan::ScenePlan;
use foveal::splatting::AgeingRules;
use foveal::world::World;
use foveal_actors::allocator::Allocator;
use foveal_actors::allocator::textures::Textures;
use foveal_actors::cache_ager::CacheAger;
use foveal_actors::illuminator::Refinement;
use foveal_actors::message::TraceJob;
use foveal_actors::renderer::{Renderer, Unseen};
use foveal_actors::settings::{Adjustment, Settings};
use foveal_actors::stages::StageTimes;
use foveal_actors::tracer::Tracer;
use foveal_actors::wiring::{Correction, wire};
use foveal_engine::machine::Machine;
use foveal_engine::opened::camera;
use foveal_engine::recording::program;
use foveal_engine::reference::traced_picture;
use foveal_engine::source::{Controls, FrameSource, Ranges};
use foveal_engine::{Clock, Engine, Failure, Opened, Options, Recording, Standing};
use foveal_runtime::simulate::{Fault, FaultKind, Faults, Simulation, Work, shrink};
use foveal_runtime::{
    ActorId, Config, Content, Hashing, Incident, JobPool, NodeInfo, Record, Runtime, Trace, TraceError,
};
use glam::Vec3;

use super::{Broken, FRAME, SAMPLES_PER_JOB, SimulateArguments, StrategyName};

/// A bake that takes next to no time.
const SMALL_BAKE: BakeSettings =
    BakeSettings { texels: 256, seed: 1, particles: Some(1 << 10), everything: false, error: None };
/// Frames within which light that grows must be final.
const LIGHT_FRAMES_MAX: u32 = 2000;
/// Frames within which textures must come to what there is room for.
const STAY_FRAMES_MAX: u32 = 100;
/// Virtual time within which nothing is left to do.
const REST_MAX: Duration = Duration::from_secs(3600);

/// The world in the light that a refinement comes to.
fn fully_lit(refinement: &Refinement) -> World {
    let Refinement { world, settings, .. } = refinement;
    let mut baker = Baker::new(world.indexed(), settings);
    baker.begin_with(&*world.illumination);
    let baked = baker.run(world.indexed(), &|_| true, &mut |_| {});
    world.with_illumination(Arc::new(baked.illumination))
}

/// A walk of a few frames and a stay, and what it must come to.
pub(super) struct Scenario {
    strategy: StrategyName,
    /// A walk that a panic ends has failed.
    must_rest: bool,
    opened: Opened,
    probes: Arc<Probes>,
    settings: Settings,
    cameras: Vec<Camera>,
    last: CameraFrame,
    /// What the last view must converge to, if its textures come to what they are now.
    reference: Map2d<Vec3>,
}

impl Scenario {
    pub(super) fn new(a: &SimulateArguments, mut opened: Opened) -> Result<Self, Failure> {
        opened.limit_textures(a.texture_budget)?;
        let world = opened.world.clone();
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
        opened.refinement = a.grow.then(|| Refinement {
            world: world.clone(),
            settings: SMALL_BAKE,
            begun: 0,
            keep: None,
            early: None,
            book: None,
        });
        let lit = opened.refinement.as_ref().map_or_else(|| world.clone(), fully_lit);
        let reference = traced_picture(&lit, &last, settings.seed, 1, &|| true).picture;
        let probes = Arc::new(Probes::of_world(&world));
        let (strategy, must_rest) = (a.strategy, a.must_rest);
        Ok(Self { strategy, must_rest, opened, probes, settings, cameras, last, reference })
    }

    /// What the scene is called.
    pub(super) fn scene_name(&self) -> &str {
        &self.opened.world.scene.name
    }

    fn start(&self, simulation: Simulation, into: Option<Record>) -> Result<Engine, Failure> {
        let recording = into.map(|into| Recording { into, hashing: Hashing::Said, command: "simulate" });
        let (clock, probes) = (Clock::Virtual(simulation), Some(self.probes.clone()));
        let options = Options { clock, probes, recording, ..Options::new(self.settings) };
        Engine::start(self.opened.clone(), options)
    }

    /// All actors by identity, and whose panic ends the walk.
    pub(super) fn actors(&self) -> Result<(Vec<NodeInfo>, Vec<ActorId>), Failure> {
        let engine = self.start(Simulation::new(0), None)?;
        let actors = engine.actors();
        let ending = [
            Some(actors.renderer.id()),
            actors.correction.map(|c| c.allocator.id()),
            actors.illuminator.map(|i| i.id()),
        ];
        Ok((engine.runtime().actors().to_vec(), ending.into_iter().flatten().collect()))
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
        let watch = Rc::clone(&watched);
        let simulation = Simulation {
            strategy: self.strategy.of(seed),
            faults: Faults::Listed(faults.to_vec()),
            work: Work::Seeded,
            invariant: Some(Box::new(move |runtime| match watch.get() {
                Some(watched) => watched.check(runtime),
                None => Ok(()),
            })),
            ..Simulation::new(seed)
        };
        let at = |kind| faults.iter().find(|f| f.kind == kind).map(|f| f.at as usize);
        // Whatever a panic ends must be whole when it is read again.
        let panics = faults.iter().any(|f| f.kind == FaultKind::Panic);
        let (room, torn_at) = (at(FaultKind::DiskFull), at(FaultKind::TornLog));
        let is_whole = room.is_none() && torn_at.is_none();
        let disk = Disk::new(room.or(panics.then_some(usize::MAX)), torn_at);
        let into = match (record, &disk) {
            (Some(file), _) => Some(Record::File(file.to_owned())),
            (None, Some(disk)) => Some(Record::Sink(Box::new(disk.clone()))),
            (None, None) => None,
        };
        let recorded = into.is_some();
        let mut engine = match self.start(simulation, into) {
            // There is no room for a header.
            Err(_) if room.is_some() => return Ok(0),
            started => started.map_err(|e| e.to_string())?,
        };
        if let (Some(correction), Some(pool)) = (engine.actors().correction, &engine.actors().pool) {
            let texture_limit = self.opened.textures.as_ref().map(|store| store.limit);
            let (pool, settings) = (pool.clone(), self.settings);
            let actors = engine.actors();
            let senders = [actors.renderer.id(), correction.cache_ager.id()];
            let senders =
                senders.into_iter().chain(actors.tracers.iter().map(|tracer| tracer.id())).collect();
            let _ = watched.set(Watched { correction, senders, pool, settings, texture_limit });
        }
        let walked = self.walk(&mut engine, seed);
        let ran = match (walked, engine.runtime().ended()) {
            (_, Some(incident)) if self.may_end(incident, faults) => Ok(()),
            (_, Some(incident)) => Err(format!("the walk ended: {incident}")),
            (Err(e), None) => Err(match engine.runtime().failure() {
                Some(broken) => broken.to_string(),
                None => e.to_string(),
            }),
            (Ok(set), None) => self.at_rest(&engine, &set),
        };
        let fingerprint = engine.runtime().fingerprint();
        if recorded {
            let ends = engine.runtime().ended().is_some();
            let end = engine.finish(Duration::from_secs(10));
            if ends && !end.drained {
                return Err("what a panic ended did not end in order".to_owned());
            }
        }
        ran?;
        match disk.filter(|_| record.is_none()) {
            Some(disk) => self.replay_what_is_left(&disk.content(), is_whole).map(|()| fingerprint),
            None => Ok(fingerprint),
        }
    }

    /// A walk ends for nothing but a panic that was to end it.
    fn may_end(&self, incident: &Incident, faults: &[Fault]) -> bool {
        let injected = |actor| faults.iter().any(|f| f.kind == FaultKind::Panic && f.actor == actor);
        matches!(incident, Incident::Panicked { actor, message, .. }
            if !self.must_rest && message == "injected" && injected(*actor))
    }

    /// Whatever a disk kept of a recording replays as far as it goes; all of it, where the disk `is_whole`.
    fn replay_what_is_left(&self, bytes: &[u8], is_whole: bool) -> Result<(), String> {
        let trace = match Trace::from_bytes(bytes) {
            Ok(trace) => Arc::new(trace),
            // It ends in its first words.
            Err(TraceError::NotARecording | TraceError::Version { .. } | TraceError::Header { .. }) => {
                return Ok(());
            }
            Err(e) => return Err(e.to_string()),
        };
        let (stages, probes) = (StageTimes::default(), Some(self.probes.clone()));
        let plan = ScenePlan::new(&self.opened.world.scene, &self.opened.world.scene.budget);
        let machine = Machine::new(&self.opened, &self.settings, &plan, false);
        let parts = machine.parts(&self.opened, probes, None, stages, Box::new(Unseen));
        let config = Config { program: program(), ..Config::replay(trace, 0) };
        let (mut runtime, _) = Runtime::build(config, |w| wire(w, parts)).map_err(|e| e.to_string())?;
        let report = runtime.replay();
        match report.divergence {
            None if is_whole && !report.complete => Err("the recording is not whole".to_owned()),
            None => Ok(()),
            Some(divergence) => Err(format!("what is left of the recording diverges: {divergence}")),
        }
    }

    /// A few frames whose views do not converge in time, between which the user changes what can be changed; then the
    /// last one again until nothing is left to do. Returns what was set at last.
    fn walk(&self, engine: &mut Engine, seed: u64) -> Result<Adjustment, Failure> {
        let begun = engine.controls();
        for (number, camera) in (0..).zip(&self.cameras) {
            if number > 0 {
                let set = self.adjustment(begun.set, engine.ranges(), seed, number);
                engine.set(&Controls { set, ..begun })?;
            }
            engine.frame(camera, FRAME)?;
        }
        // Whoever rests may hold samples, which are waited for.
        let last = engine.controls();
        let set = Adjustment { workers: self.settings.tracers, ..last.set };
        engine.set(&Controls { set, ..last })?;
        let camera = self.cameras.last().ok_or_else(|| Failure::Check("a walk without frames".into()))?;
        for number in 0.. {
            if engine.look(Renderer::is_lit) == Some(true) {
                break;
            }
            if number == LIGHT_FRAMES_MAX {
                return Err(Failure::Check("the light never becomes final".into()));
            }
            engine.frame(camera, FRAME)?;
        }
        // The first finds all at rest and shows what has come since; textures come with frames.
        for _ in 0..STAY_FRAMES_MAX {
            rest(engine)?;
            engine.frame(camera, Duration::ZERO)?;
            rest(engine)?;
            if engine.standing() == Standing::Converged && textures(engine, Textures::is_quiet) != Some(false)
            {
                break;
            }
        }
        Ok(set)
    }

    /// What the user changes before a frame: everything that changes what is done, and when, and not what it comes to.
    fn adjustment(&self, begun: Adjustment, ranges: Ranges, seed: u64, frame: u64) -> Adjustment {
        let below = |what: u64, end: u64| hash(seed, frame, what) % end;
        let between = |what: u64, [low, high]: [u64; 2]| low + below(what, high.saturating_sub(low) + 1);
        Adjustment {
            fps: 60.0,
            workers: 1 + below(0, u64::from(self.settings.tracers)) as u32,
            policy: Policy::ALL[below(1, Policy::ALL.len() as u64) as usize],
            saliency_weight: below(2, 5) as f32 * 0.25,
            samples_per_job: SAMPLES_PER_JOB >> below(3, 3),
            ageing: AgeingRules {
                max_age: self.settings.ageing.max_age >> below(4, 7),
                ..self.settings.ageing
            },
            environment_bytes: between(5, [0, self.settings.environment_bytes]),
            // The smallest limit that works, at least.
            texture_bytes: begun
                .texture_bytes
                .zip(ranges.textures)
                .map(|(limit, [least, _])| between(6, [least.min(limit), limit])),
            ..begun
        }
    }

    /// What must hold once nothing is left to do.
    fn at_rest(&self, engine: &Engine, set: &Adjustment) -> Result<(), String> {
        let (runtime, actors) = (engine.runtime(), engine.actors());
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
            let ageing = runtime.inspect(correction.cache_ager, |c| c.settings().ageing);
            if self.cameras.len() > 1 && ageing != Some(set.ageing) {
                return Err(format!("the cache ager goes by {ageing:?}, not by what the user changed"));
            }
            let holds = |t: &_| runtime.inspect(*t, Tracer::is_empty_handed) == Some(false);
            if actors.tracers.iter().any(holds) {
                return Err("a tracer holds samples that nobody got".into());
            }
        }
        let used = textures(engine, |t| t.residency().used());
        if let (Some(used), Some(limit)) = (used, set.texture_bytes)
            && used > limit
        {
            return Err(format!("all rest, with {used} bytes of textures, {limit} allowed"));
        }
        let (converged, shown) = engine.look(|r| (r.is_converged(), r.is_shown())).unwrap_or_default();
        if !converged || !shown {
            return Err(format!("all rest, converged: {converged}, shown: {shown}"));
        }
        let Some((picture, world)) = engine.look(|r| r.picture().zip(Some(r.world().clone()))).flatten()
        else {
            return Err("nothing was shown".into());
        };
        // With the levels of textures that there is room for.
        let resident = self
            .opened
            .textures
            .as_ref()
            .map(|_| traced_picture(&world, &self.last, self.settings.seed, 1, &|| true).picture);
        let reference = resident.as_ref().unwrap_or(&self.reference);
        let bits = |c: &Vec3| c.to_array().map(f32::to_bits);
        let pairs = picture.data().iter().zip(reference.data());
        let differing = pairs.filter(|(a, b)| bits(a) != bits(b)).count() as u64;
        // Pixels of jobs that were given up stay coarse.
        if differing > dead * u64::from(SAMPLES_PER_JOB) {
            return Err(format!(
                "{differing} pixels of the converged picture differ from the traced reference"
            ));
        }
        Ok(())
    }
}

/// Works until nothing is left to do.
fn rest(engine: &mut Engine) -> Result<(), Failure> {
    match engine.rest(REST_MAX)? {
        true => Ok(()),
        false => Err(Failure::Check(format!("the walk is not at rest after {} s", REST_MAX.as_secs()))),
    }
}

/// Looks at the textures, where they are limited.
fn textures<R>(engine: &Engine, look: impl FnOnce(&Textures) -> R) -> Option<R> {
    let allocator = engine.actors().correction?.allocator;
    engine.runtime().inspect(allocator, |a| a.textures().map(look)).flatten()
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
    /// Who keeps what is not accepted and sends it again.
    senders: Vec<ActorId>,
    pool: JobPool<TraceJob>,
    /// As the walk began: no limit is ever set higher.
    settings: Settings,
    texture_limit: Option<u64>,
}

impl Watched {
    fn check(&self, runtime: &Runtime) -> Result<(), String> {
        let Self { correction, senders, pool, settings, texture_limit } = self;
        let stats = pool.stats();
        let out = stats.pushed.saturating_sub(stats.completed + stats.stale + stats.dead);
        if let Some(in_flight) = runtime.inspect(correction.allocator, Allocator::in_flight)
            && (u64::from(in_flight) < out || in_flight > settings.jobs_in_flight() + 4)
        {
            return Err(format!("the allocator counts {in_flight} jobs in flight, {out} are out"));
        }
        // What waits to be sent comes of jobs, and of views that nobody has taken up yet.
        let most = (4 * settings.jobs_in_flight() + 64) as f64;
        for sender in senders {
            let state = runtime.content(*sender);
            let waiting = state.as_ref().and_then(|state| state.at("outbox")).and_then(Content::number);
            if waiting.is_some_and(|waiting| waiting > most) {
                return Err(format!(
                    "{sender}: {waiting:?} messages wait to be sent again, at most {most} may"
                ));
            }
        }
        let maps = runtime.inspect(correction.allocator, |a| a.environments().bytes());
        if let Some(bytes) = maps.filter(|bytes| *bytes > settings.environment_bytes) {
            return Err(format!("{bytes} bytes of environment maps, {} allowed", settings.environment_bytes));
        }
        let used = runtime.inspect(correction.allocator, |a| a.textures().map(|t| t.residency().used()));
        if let (Some(Some(used)), Some(limit)) = (used, texture_limit)
            && used > *limit
        {
            return Err(format!("{used} bytes of textures, {limit} allowed"));
        }
        match runtime.inspect(correction.cache_ager, CacheAger::len) {
            Some(kept) if kept > settings.cache_capacity => {
                Err(format!("{kept} samples kept, {} allowed", settings.cache_capacity))
            }
            _ => Ok(()),
        }
    }
}
