//! A walk at work: actors around a scene, given cameras, asked for frames.
//!
//! Everything that reaches the actors from here is one recorded input of the renderer, so that what can be done here can be
//! replayed. The walk belongs to the thread that began it, which runs the renderer between [`Engine::begin`] and
//! [`Engine::end`].

mod begins;
mod frame;
mod frames;
mod shown;
mod stalled;

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crossbeam_queue::{ArrayQueue, SegQueue};
use foveal::allocation::residency::smallest;
use foveal::display::tone::Encoder;
use foveal::scene::plan::ScenePlan;
use foveal::scene::{Budget, Camera};
use foveal_actors::allocator::Allocator;
use foveal_actors::foresight::Foresight;
use foveal_actors::insight::{Insight, InsightSlot};
use foveal_actors::message::{FrameSnapshot, RendererInput, View};
use foveal_actors::renderer::overlay::Overlay;
use foveal_actors::renderer::{FrameCounts, FrameSink, Renderer, Splats};
use foveal_actors::settings::{Adjustment, Settings};
use foveal_actors::stages::StageTimes;
use foveal_actors::station::{Heard, Station, StationMessage, StationStatus};
use foveal_actors::textures::TextureStore;
use foveal_actors::wiring::{Actors, Parts, wire};
use foveal_runtime::{BuildError, Control, Exit, Limit, Mode, Port, RecordingStatus, Runtime, Shutdown};

use crate::bake_clock::Watch;
use crate::failure::Failure;
use crate::machine::Machine;
use crate::opened::{self, Opened};
use crate::options::{Clock, Options};
use crate::recording::program;
use crate::source::{Controls, Names, Ranges};

/// Time that actors have to come to rest when they are no longer needed.
const SHUTDOWN: Duration = Duration::from_secs(2);
/// The same where a recording is to have its end: on a machine that is busy with other things it takes longer.
const SHUTDOWN_RECORDED: Duration = Duration::from_secs(20);
/// The same of a recorded walk that another one replaces on this thread, which stands still meanwhile.
const LEAVING: Duration = Duration::from_millis(200);
/// Of so many processors one is left to drawing and composing while the camera moves: on sixteen where each traced, frames
/// came up to half their time too late, since whoever draws waited on each of them.
const CORES_PER_DRAWING: usize = 4;

use begins::Begins;
pub use frame::{Event, Frame, Standing};
pub use stalled::Stalled;

/// Keeps the newest frame for whoever asked for it; and for a display that draws by itself, what was splatted.
#[derive(Clone)]
struct Newest {
    frame: Arc<ArrayQueue<(Arc<FrameSnapshot>, FrameCounts)>>,
    splats: Arc<SegQueue<(View, Splats)>>,
    /// The view of these splats: those of former ones go.
    view: View,
    /// Whether there is such a display.
    mirrored: Arc<AtomicBool>,
}

impl FrameSink for Newest {
    fn frame_shown(&mut self, snapshot: &Arc<FrameSnapshot>, counts: FrameCounts, _renderer: &Renderer) {
        self.frame.force_push((Arc::clone(snapshot), counts));
    }

    fn splatted(&mut self, view: View, splats: Splats) {
        if !self.mirrored.load(Ordering::Relaxed) {
            return;
        }
        if view != self.view {
            self.view = view;
            // Nobody may be drawing, as with a window that is hidden.
            while self.splats.pop().is_some() {}
        }
        self.splats.push((view, splats));
    }
}

/// What the last frame left behind, to tell what is new.
#[derive(Default)]
struct Before {
    standing: Option<(View, Standing)>,
    light: Option<usize>,
    lit: bool,
    stopped: bool,
    camera: Option<Camera>,
}

/// Actors at work, and what they are made of.
pub struct Engine {
    opened: Opened,
    plan: ScenePlan,
    settings: Settings,
    ranges: Ranges,
    controls: Controls,
    /// `None` only while it is dropped.
    runtime: Option<Runtime>,
    /// Whether the actors were brought to rest.
    finished: bool,
    recorded: bool,
    actors: Actors,
    newest: Newest,
    stages: StageTimes,
    /// What was splatted in a view so far, for a display that may have to begin anew.
    splats: (View, Vec<Splats>),
    shown: Option<Frame>,
    before: Before,
    frame: u32,
    /// How long a frame takes from the end of its work until it is shown.
    showing: Foresight,
    /// Processors that are left to drawing while the camera moves; while a frame is put together at least one is.
    drawing_cores: usize,
    /// Whether the frame is seen by a camera that moves, and shown at its deadline.
    hurries: bool,
    encoder: Encoder,
    slot: InsightSlot,
    insight: Option<Insight>,
    names: Names,
    facts: Vec<(String, String)>,
    /// How another size begins.
    again: Again,
    begins: Begins,
}

/// What a walk of another size is started with.
struct Again {
    fps: Option<f32>,
    quality: Option<f32>,
    texture_bytes: Option<u64>,
    whole: bool,
    gives_way: bool,
}

impl Engine {
    /// Opens a scene and starts the actors.
    ///
    /// # Errors
    /// If the scene or its illumination cannot be read, a limit cannot be met, or threads cannot be started.
    pub fn open(path: &Path, options: Options, watch: &dyn Watch) -> Result<Self, Failure> {
        let mut opened = opened::open(path, &options.light, watch)?;
        opened.limit_textures(options.texture_bytes.or(opened.world.scene.budget.texture_bytes))?;
        Self::start(opened, options)
    }

    /// Starts the actors around a scene that is open.
    ///
    /// # Errors
    /// If threads cannot be started.
    pub fn start(mut opened: Opened, options: Options) -> Result<Self, Failure> {
        let Options { settings, fps, quality, texture_bytes, whole, gives_way, clock, recording, .. } =
            options;
        if let Some(refinement) = &mut opened.refinement {
            refinement.book = match &recording {
                Some(recording) if options.keeps_light => recording.book(refinement)?,
                _ => None,
            };
        }
        let scene = &opened.world.scene;
        let budget = Budget { texture_bytes: texture_bytes.or(scene.budget.texture_bytes), ..scene.budget };
        let plan = ScenePlan::new(scene, &budget);
        let machine = Machine::new(&opened, &settings, &plan, whole);
        let store = opened.textures.as_ref();
        let set = Adjustment {
            fps: fps.or(budget.fps).unwrap_or(10.0),
            quality,
            texture_bytes: store.map(|store| store.limit),
            ..Adjustment::of(&settings, &scene.display)
        };
        let controls = Controls { set, overlay: Overlay::None };
        let ranges = Ranges { workers: settings.tracers, textures: store.map(|store| range(store)) };
        let newest = Newest {
            frame: Arc::new(ArrayQueue::new(1)),
            splats: Arc::new(SegQueue::new()),
            view: View(0),
            mirrored: Arc::new(AtomicBool::new(false)),
        };
        let (slot, stages) = (InsightSlot::default(), StageTimes::default());
        let all = || {
            let sink = Box::new(newest.clone());
            let parts =
                machine.parts(&opened, options.probes.clone(), Some(slot.clone()), stages.clone(), sink);
            Parts { outlets: options.outlets.as_ref().map_or_else(Vec::new, |make| make()), ..parts }
        };
        let live = || Clock::Real.config(&settings, machine.threads(&opened), gives_way, options.ring_turns);
        let mut config = clock.config(&settings, machine.threads(&opened), gives_way, options.ring_turns);
        let mut recorded = recording.is_some();
        if let Some(recording) = recording {
            config.application = recording.header(&opened, &machine, options.parent.as_ref())?;
            (config.hashing, config.record) = (recording.hashing, Some(recording.into));
            config.program = program();
        }
        let mut unrecorded = None;
        // What is simulated cannot go on in real time.
        let is_live = matches!(config.mode, Mode::Live);
        let built = match Runtime::build(config, |w| wire(w, all())) {
            Err(BuildError::Record(e)) if is_live => {
                recorded = false;
                let warning = format!("the walk is not recorded: {e}; choose another --record");
                tracing::warn!("{warning}");
                unrecorded = Some(warning);
                let mut parts = all();
                if let Some(refinement) = &mut parts.refinement {
                    refinement.book = None;
                }
                Runtime::build(live(), |w| wire(w, parts))
            }
            built => built,
        };
        let (runtime, actors) =
            built.map_err(|e| Failure::Environment(format!("the actors cannot be started: {e}")))?;
        let names = Names {
            objects: scene.objects.iter().map(|o| o.name.clone()).collect(),
            textures: scene.textures.iter().map(|t| t.name.clone()).collect(),
        };
        opened.warnings.extend(unrecorded);
        Ok(Self {
            plan,
            settings,
            ranges,
            controls,
            runtime: Some(runtime),
            finished: false,
            recorded,
            actors,
            newest,
            stages,
            splats: (View(0), Vec::new()),
            shown: None,
            before: Before::default(),
            frame: 0,
            showing: Foresight::default(),
            hurries: false,
            drawing_cores: std::thread::available_parallelism()
                .map_or(0, |cores| cores.get() / CORES_PER_DRAWING),
            encoder: Encoder::default(),
            slot,
            insight: None,
            names,
            facts: options.facts,
            again: Again { fps, quality, texture_bytes, whole, gives_way },
            begins: Begins::default(),
            opened,
        })
    }

    /// Changes what can be changed while walking; reaches the actors as one recorded message.
    ///
    /// # Errors
    /// If the walk has ended.
    pub fn set(&mut self, controls: &Controls) -> Result<(), Failure> {
        let before = std::mem::replace(&mut self.controls, *controls);
        if before.set == controls.set {
            return Ok(());
        }
        let workers = controls.set.workers.clamp(1, self.ranges.workers) as usize;
        for (index, tracer) in self.actors.tracers.iter().enumerate() {
            let (rested, rests) = (index >= before.set.workers as usize, index >= workers);
            if let (true, Some(runtime)) = (rested != rests, &self.runtime) {
                runtime.control(*tracer, if rests { Control::Pause } else { Control::Resume });
            }
        }
        self.controls.set.workers = workers as u32;
        self.settings.adjust(&self.controls.set);
        self.send(RendererInput::Adjusted(self.controls.set))
    }

    /// Goes on with pictures of another size: the light stays as it is, samples are traced anew, a recording ends.
    ///
    /// # Errors
    /// If threads cannot be started: the walk goes on at the size it had.
    pub fn resize(&mut self, width: u32, height: u32) -> Result<(), Failure> {
        if [width, height] == [self.settings.width, self.settings.height] {
            return Ok(());
        }
        let cache_capacity = Settings::new(width, height, 1).cache_capacity;
        self.go_on_in(self.as_lit(), Settings { width, height, cache_capacity, ..self.settings })
    }

    /// The scene under the light that it has by now.
    pub(crate) fn as_lit(&self) -> Opened {
        let mut opened = self.opened.clone();
        if let Some((illumination, lit)) = self.look(|r| (r.world().illumination.clone(), r.is_lit())) {
            opened.world = opened.world.with_illumination(illumination);
            opened.refinement = opened.refinement.filter(|_| !lit);
        }
        opened
    }

    /// Goes on with other actors, around another scene or picture.
    pub(crate) fn go_on_in(&mut self, opened: Opened, settings: Settings) -> Result<(), Failure> {
        let Again { fps, quality, texture_bytes, whole, gives_way } = self.again;
        let options = Options { fps, quality, texture_bytes, whole, gives_way, ..Options::new(settings) };
        // The next walk stands before the old one ends: where threads cannot be had, there is still one to show.
        let mut next = Self::start(opened, Options { facts: self.facts.clone(), ..options })?;
        next.before.stopped = self.recorded;
        next.newest.mirrored.store(self.newest.mirrored.load(Ordering::Relaxed), Ordering::Relaxed);
        next.set(&self.controls)?;
        next.begins = self.begins;
        *self = next;
        Ok(())
    }

    /// Whether a recording of it goes on.
    pub(crate) fn is_recorded(&self) -> bool {
        matches!(self.recording(), RecordingStatus::On { .. })
    }

    /// Brings the actors to rest within `time`: what is still to be traced is left. They can be looked at afterwards; nothing
    /// else works.
    ///
    /// # Panics
    /// While it is being dropped.
    pub fn finish(&mut self, time: Duration) -> Shutdown {
        self.end_work();
        self.finished = true;
        self.runtime.as_mut().expect("only a drop takes it").end(time)
    }

    fn send(&self, input: RendererInput) -> Result<(), Failure> {
        self.actors.input.send(input).map_err(|e| Failure::Check(format!("the renderer takes no input: {e}")))
    }

    /// Looks at the renderer.
    pub fn look<R>(&self, look: impl FnOnce(&Renderer) -> R) -> Option<R> {
        self.runtime.as_ref()?.inspect(self.actors.renderer, look)
    }

    fn pump(&mut self, limit: Limit, until: impl FnMut(&Runtime) -> bool) -> Result<Exit, Failure> {
        let Some(runtime) = &mut self.runtime else { return Ok(Exit::Halted) };
        match runtime.pump_until(limit, until) {
            Exit::Halted => {
                let why = runtime.failure().map_or_else(|| "it was halted".to_owned(), ToString::to_string);
                Err(Failure::Check(format!("the walk ended at frame {}: {why}", self.frame)))
            }
            Exit::Ended => match runtime.ended() {
                Some(incident) => Err(Failure::ended(incident)),
                None => Ok(Exit::Ended),
            },
            exit => Ok(exit),
        }
    }

    /// The scene with its light, and what went wrong so far.
    pub fn opened(&self) -> &Opened {
        &self.opened
    }

    /// What the scene needs, and what is skipped.
    pub fn plan(&self) -> &ScenePlan {
        &self.plan
    }

    /// Settings as they are now.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The running system, to look into.
    ///
    /// # Panics
    /// While it is being dropped.
    pub fn runtime(&self) -> &Runtime {
        self.runtime.as_ref().expect("only a drop takes it")
    }

    /// What leads from other machines to the stations, by number: for whoever listens to them. Empty the second time.
    pub fn station_inputs(&mut self) -> Vec<Port<Heard, StationMessage>> {
        std::mem::take(&mut self.actors.station_inputs)
    }

    /// The stations as they are, once the walk is [finished](Engine::finish): before, others run them.
    pub fn stations(&self) -> Vec<StationStatus> {
        let look = |station| self.runtime.as_ref()?.inspect(station, |station: &Station| station.status());
        self.actors.stations.iter().filter_map(|&station| look(station)).collect()
    }

    /// Its actors, to look into.
    pub fn actors(&self) -> &Actors {
        &self.actors
    }

    /// Whether the walk is recorded.
    pub fn recording(&self) -> RecordingStatus {
        self.runtime.as_ref().map_or(RecordingStatus::Off, Runtime::recording)
    }

    /// Everything that went wrong without stopping anything, each said once.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = self.opened.warnings.clone();
        if let RecordingStatus::Stopped { reason } = self.recording() {
            warnings.push(format!("the recording ends early: {reason}"));
        }
        warnings
    }

    /// Jobs that were given up, and what actors failed at, once the walk is [finished](Engine::finish).
    pub fn lost(&self) -> (u32, Vec<String>) {
        let look = |a: &Allocator| {
            let incidents = a.incidents().iter().map(|i| format!("{i:?}"));
            let dead = a.dead_jobs().iter().map(|d| format!("{d:?}"));
            (a.lost_jobs(), incidents.chain(dead).collect())
        };
        let allocator = self.actors.correction.map(|c| c.allocator);
        allocator.and_then(|a| self.runtime.as_ref()?.inspect(a, look)).unwrap_or_default()
    }

    /// What the allocator thought last.
    pub fn insight(&mut self) -> Option<&Insight> {
        self.listen();
        self.insight.as_ref()
    }

    /// Lets go of what nobody will see: jobs of the view, and better light, which would take minutes more.
    fn end_work(&self) {
        // An actor that takes nothing any more has ended by itself.
        let _ = self.send(RendererInput::Left);
        if let (Some(runtime), Some(illuminator)) = (&self.runtime, self.actors.illuminator) {
            runtime.control(illuminator, Control::Stop);
        }
    }

    fn close(&mut self) {
        if self.finished {
            // Whatever did not end in time is not waited for again.
            self.runtime = None;
            return;
        }
        self.end_work();
        if let Some(runtime) = self.runtime.take() {
            let end = runtime.shutdown(if self.recorded { SHUTDOWN_RECORDED } else { SHUTDOWN });
            tracing::debug!("actors stopped, drained: {}", end.drained);
        }
    }

    /// Takes the allocator's newest word.
    fn listen(&mut self) {
        if let Some(insight) = self.slot.take() {
            self.insight = Some(insight);
        }
    }
}

/// Bytes with the coarsest levels only, and with all levels.
fn range(store: &TextureStore) -> [u64; 2] {
    let all = store.facts.iter().map(|facts| facts.bytes_from(0)).sum();
    [smallest(&store.facts), all]
}

impl Drop for Engine {
    fn drop(&mut self) {
        self.close();
    }
}

#[cfg(test)]
#[path = "engine_tests.rs"]
mod tests;
