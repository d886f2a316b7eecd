//! The session of actors that a window shows.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crossbeam_queue::{ArrayQueue, SegQueue};
use foveal::allocation::residency::smallest;
use foveal::display::first_approximation::Probes;
use foveal::display::tone::{Encoder, ToneMap};
use foveal::display::twin::Passes;
use foveal::image::Map2d;
use foveal::scene::{Camera, Scene};
use foveal::world::World;
use foveal_runtime::{BuildError, Config, Control, Ending, Hashing, Limit, Record, Runtime};

use super::look;
use super::source::{Controls, FrameSource, Names, Place, Ranges, Status};
use crate::illuminator::Refinement;
use crate::insight::{Insight, InsightSlot};
use crate::message::{FrameIndex, FrameSnapshot, RendererInput, View};
use crate::renderer::gpu::Mirror;
use crate::renderer::overlay::Overlay;
use crate::renderer::{FrameCounts, FrameSink, Renderer, Splats};
use crate::settings::{Adjustment, Settings};
use crate::stages::StageTimes;
use crate::textures::TextureStore;
use crate::wiring::{Actors, Parts, wire};

/// Time that actors have to come to rest when they are no longer needed.
const SHUTDOWN: Duration = Duration::from_secs(2);
/// The same of a recorded session that another one replaces in the window, which stands still meanwhile.
const LEAVING: Duration = Duration::from_millis(200);
/// Longest time for the picture of a frame, once its deadline is over.
const SHOWING: Duration = Duration::from_secs(10);

/// Where the actors are recorded, and the application's part of the header.
pub struct Recording {
    /// The file, or whatever takes its bytes.
    pub into: Record,
    /// The application's part of the header.
    pub header: Vec<u8>,
    /// How densely hashes are recorded.
    pub hashing: Hashing,
}

/// Whether there is anything to correct, as there always is where any view can be refined; and what the display pass must fill.
pub fn parts_of(scene: &Scene) -> (bool, Passes) {
    // The overlay of mip levels shows the texture ids.
    (true, Passes { texture_ids: !scene.textures.is_empty() })
}

/// Keeps the newest frame's counts for the window; and for a display that draws by itself, what was splatted.
#[derive(Clone)]
struct Newest {
    counts: Arc<ArrayQueue<FrameCounts>>,
    splats: Arc<SegQueue<(View, Splats)>>,
    /// Whether there is such a display.
    mirrored: Arc<AtomicBool>,
}

impl FrameSink for Newest {
    fn frame_shown(&mut self, _snapshot: &Arc<FrameSnapshot>, counts: FrameCounts, _renderer: &Renderer) {
        self.counts.force_push(counts);
    }

    fn splatted(&mut self, view: View, splats: Splats) {
        if self.mirrored.load(Ordering::Relaxed) {
            self.splats.push((view, splats));
        }
    }
}

/// What a session is made of.
pub struct Made {
    /// What is walked through.
    pub world: World,
    /// What each object of it sees around. Without it the window's thread has to look.
    pub probes: Option<Arc<Probes>>,
    /// Textures, where they do not all fit into their limit.
    pub textures: Option<Arc<TextureStore>>,
    /// What the illumination is refined towards while one walks.
    pub refinement: Option<Refinement>,
    /// Settings to begin with.
    pub settings: Settings,
    /// Frames per second to aim at.
    pub fps: f32,
    /// Least quality of a frame that is shown, if frames are to wait for it.
    pub quality: Option<f32>,
    /// Names and values for a screenshot's metadata.
    pub facts: Vec<(String, String)>,
    /// Where the session is recorded, if anywhere.
    pub recording: Option<Recording>,
}

/// Who stops where it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stalled {
    /// Nobody.
    Nobody,
    /// All who trace rays.
    Tracers,
    /// Who keeps samples.
    CacheAger,
    /// Who looks at frames.
    Analyzer,
    /// Who orders jobs.
    Allocator,
    /// Who makes light better.
    Illuminator,
    /// All but the renderer.
    All,
}

impl Stalled {
    /// Each of them.
    pub const EACH: [Self; 7] = [
        Self::Nobody,
        Self::Tracers,
        Self::CacheAger,
        Self::Analyzer,
        Self::Allocator,
        Self::Illuminator,
        Self::All,
    ];

    /// As it is written on a command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Nobody => "nobody",
            Self::Tracers => "tracers",
            Self::CacheAger => "cache-ager",
            Self::Analyzer => "analyzer",
            Self::Allocator => "allocator",
            Self::Illuminator => "illuminator",
            Self::All => "all",
        }
    }
}

/// Actors at work, and what they are made of.
pub struct Session {
    world: World,
    settings: Settings,
    ranges: Ranges,
    controls: Controls,
    /// `None` only while it is dropped.
    runtime: Option<Runtime>,
    recorded: bool,
    actors: Actors,
    newest: Newest,
    /// What was splatted in a view so far, for a display that may have to begin anew.
    splats: (View, Vec<Splats>),
    counts: FrameCounts,
    frame: u32,
    /// View of the last picture, and how far that has come.
    shown: (u32, &'static str),
    encoder: Encoder,
    slot: InsightSlot,
    insight: Option<Insight>,
    names: Names,
    facts: Vec<(String, String)>,
}

impl Session {
    /// Starts the actors.
    ///
    /// # Errors
    /// If threads cannot be started.
    pub fn start(made: Made) -> Result<Self, String> {
        let Made { world, probes, textures, refinement, settings, fps, quality, facts, recording } = made;
        let (corrects, passes) = parts_of(&world.scene);
        let store = textures.as_ref();
        let controls = Controls {
            set: Adjustment {
                fps,
                quality,
                workers: settings.tracers,
                policy: settings.policy.policy,
                saliency_weight: settings.saliency_weight,
                samples_per_job: settings.samples_per_job,
                ageing: settings.ageing,
                environment_bytes: settings.environment_bytes,
                texture_bytes: store.map(|store| store.limit),
                refine: settings.supersampling,
                tone: ToneMap::from(&world.scene.display),
            },
            overlay: Overlay::None,
        };
        let ranges = Ranges { workers: settings.tracers, textures: store.map(|store| range(store)) };
        // One more than tracers, so that the light actors keep one; and one for the illuminator.
        let threads = settings.tracers as usize + 1 + usize::from(refinement.is_some());
        let newest = Newest {
            counts: Arc::new(ArrayQueue::new(1)),
            splats: Arc::new(SegQueue::new()),
            mirrored: Arc::new(AtomicBool::new(false)),
        };
        let slot = InsightSlot::default();
        let parts = || Parts {
            settings,
            world: world.clone(),
            probes: probes.clone(),
            passes,
            corrects,
            textures: textures.clone(),
            refinement: refinement.clone(),
            insight: Some(slot.clone()),
            stages: StageTimes::default(),
            sink: Box::new(newest.clone()),
        };
        let live = || Config { gives_way: true, ..Config::live(threads) };
        let mut config = live();
        let recorded = recording.is_some();
        if let Some(recording) = recording {
            (config.application, config.hashing) = (recording.header, recording.hashing);
            config.record = Some(recording.into);
        }
        let built = match Runtime::build(config, |w| wire(w, parts())) {
            Err(BuildError::Record(e)) => {
                tracing::warn!("the walk is not recorded: {e}; choose another --record");
                Runtime::build(live(), |w| wire(w, parts()))
            }
            built => built,
        };
        let (runtime, actors) = built.map_err(|e| format!("the actors cannot be started: {e}"))?;
        let scene = &world.scene;
        let names = Names {
            objects: scene.objects.iter().map(|o| o.name.clone()).collect(),
            textures: scene.textures.iter().map(|t| t.name.clone()).collect(),
        };
        Ok(Self {
            world,
            settings,
            ranges,
            controls,
            runtime: Some(runtime),
            recorded,
            actors,
            newest,
            splats: (View(0), Vec::new()),
            counts: FrameCounts::default(),
            frame: 0,
            shown: (0, "growing"),
            encoder: Encoder::default(),
            slot,
            insight: None,
            names,
            facts,
        })
    }

    fn send(&mut self, input: RendererInput) {
        if let Err(e) = self.actors.input.send(input) {
            tracing::warn!("an input was not taken: {e}");
        }
    }

    /// Looks at the renderer.
    pub fn look<R>(&self, look: impl FnOnce(&Renderer) -> R) -> Option<R> {
        self.runtime.as_ref()?.inspect(self.actors.renderer, look)
    }

    fn pump(&mut self, time: Duration, until: impl FnMut(&Runtime) -> bool) {
        if let Some(runtime) = &mut self.runtime {
            runtime.pump_until(Limit::time(time), until);
        }
    }

    /// Somebody stops where it is, to see that the walk goes on.
    pub fn stall(&self, who: Stalled) {
        let (Some(runtime), actors) = (&self.runtime, &self.actors) else { return };
        let (all, others) = (who == Stalled::All, &actors.correction);
        for tracer in actors.tracers.iter().filter(|_| all || who == Stalled::Tracers) {
            runtime.control(*tracer, Control::Pause);
        }
        if let Some(others) = others.as_ref().filter(|_| all || who == Stalled::CacheAger) {
            runtime.control(others.cache_ager, Control::Pause);
        }
        if let Some(others) = others.as_ref().filter(|_| all || who == Stalled::Analyzer) {
            runtime.control(others.analyzer, Control::Pause);
        }
        if let Some(others) = others.as_ref().filter(|_| all || who == Stalled::Allocator) {
            runtime.control(others.allocator, Control::Pause);
        }
        if let Some(illuminator) = actors.illuminator.filter(|_| all || who == Stalled::Illuminator) {
            runtime.control(illuminator, Control::Pause);
        }
    }

    /// Better light is of no use to a session that ends; who makes it would go on for minutes.
    fn end_baking(&self) {
        if let (Some(runtime), Some(illuminator)) = (&self.runtime, self.actors.illuminator) {
            runtime.control(illuminator, Control::Stop);
        }
    }

    /// Takes the allocator's newest word, and drops reports that nobody collects here.
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

impl Drop for Session {
    fn drop(&mut self) {
        self.end_baking();
        if let Some(runtime) = self.runtime.take() {
            let end = runtime.shutdown(SHUTDOWN);
            tracing::debug!("actors stopped, drained: {}", end.drained);
        }
    }
}

impl FrameSource for Session {
    fn place(&self) -> Place {
        let scene = &self.world.scene;
        Place {
            title: scene.title.clone(),
            up: scene.up,
            diagonal: scene.diagonal(),
            cameras: scene.cameras.clone(),
            paths: scene.paths.clone(),
        }
    }

    fn size(&self) -> [u32; 2] {
        [self.settings.width, self.settings.height]
    }

    fn controls(&self) -> Controls {
        self.controls
    }

    fn ranges(&self) -> Ranges {
        self.ranges
    }

    fn insight(&self) -> Option<(&Insight, &Names)> {
        self.insight.as_ref().map(|insight| (insight, &self.names))
    }

    fn set_controls(&mut self, controls: &Controls) {
        let before = std::mem::replace(&mut self.controls, *controls);
        if before.set == controls.set {
            return;
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
        self.send(RendererInput::Adjusted(self.controls.set));
    }

    fn begin_frame(&mut self, camera: &Camera) {
        self.send(RendererInput::FrameBegan { frame: FrameIndex(self.frame), camera: *camera });
        // Until the renderer has heard of it, "converged" is said of the view before.
        let renderer = self.actors.renderer;
        self.pump(SHOWING, |r| r.inspect(renderer, |r| r.camera() == Some(*camera)) == Some(true));
    }

    fn work(&mut self, time: Duration) {
        let renderer = self.actors.renderer;
        self.pump(time, |r| r.inspect(renderer, Renderer::is_refined) == Some(true));
    }

    fn end_frame(&mut self) {
        let _ = self.newest.counts.pop();
        self.send(RendererInput::DeadlineReached { frame: FrameIndex(self.frame) });
        self.frame = self.frame.wrapping_add(1);
        let newest = self.newest.counts.clone();
        self.pump(SHOWING, |_| !newest.is_empty());
        if let Some(counts) = self.newest.counts.pop() {
            self.counts = counts;
        }
        // What came since is not on the picture.
        let state = self.look(|r| match (r.is_shown(), r.is_converged(), r.is_refined()) {
            (true, true, true) if r.is_supersampled() => "refined",
            (true, true, _) => "converged",
            _ => "growing",
        });
        let view = self.look(|r| r.drawn().map_or(0, |d| d.view.0));
        self.shown = (view.unwrap_or(0), state.unwrap_or("growing"));
        self.listen();
    }

    fn picture(&mut self) -> Option<Map2d<[u8; 3]>> {
        self.listen();
        let (controls, insight) = (self.controls, self.insight.as_ref());
        // A mirror draws what has come since the frame was shown, too.
        let newest = self.newest.mirrored.load(Ordering::Relaxed);
        self.look(|renderer| look::picture(renderer, &self.world, &controls, insight, &self.encoder, newest))?
    }

    fn set_mirrored(&mut self, mirrored: bool) {
        self.newest.mirrored.store(mirrored, Ordering::Relaxed);
    }

    fn draw_on(&mut self, mirror: &mut Mirror) -> bool {
        self.listen();
        while let Some((view, splats)) = self.newest.splats.pop() {
            if view != self.splats.0 {
                self.splats = (view, Vec::new());
            }
            self.splats.1.push(splats);
        }
        let (controls, insight, footprint) = (self.controls, self.insight.as_ref(), self.settings.footprint);
        let splats = (self.splats.0, &*self.splats.1);
        self.look(|r| look::draw_on(r, &controls, insight, splats, footprint, mirror)).unwrap_or(false)
    }

    fn quality(&mut self) -> f32 {
        self.listen();
        let (view, converged) =
            self.look(|r| (r.drawn().map(|d| d.view), r.is_converged())).unwrap_or((None, true));
        match &self.insight {
            // Nothing more can be done.
            _ if converged => 0.0,
            Some(insight) if Some(insight.view) == view => insight.quality,
            _ => f32::NEG_INFINITY,
        }
    }

    fn is_done(&self) -> bool {
        self.look(Renderer::is_refined).unwrap_or(true)
    }

    fn is_shown(&self) -> bool {
        self.look(Renderer::is_shown).unwrap_or(true)
    }

    fn leave(mut self: Box<Self>) -> Ending {
        self.end_baking();
        // A recording is to have its end, if that comes soon; of other sessions nobody would see it.
        let time = if self.recorded { LEAVING } else { Duration::ZERO };
        self.runtime.take().map(|runtime| runtime.leave(time)).unwrap_or_default()
    }

    fn status(&self) -> Status {
        let (view, converged, lit) = self
            .look(|r| (r.drawn().map_or(0, |d| d.view.0), r.is_converged(), r.is_lit()))
            .unwrap_or((0, true, true));
        let refined = self.look(|r| r.is_refined() && r.is_supersampled()).unwrap_or(false);
        Status {
            view,
            converged,
            refined,
            lit,
            traced: self.counts.traced,
            reused: self.counts.reused,
            expired: self.counts.expired,
            supersampled: self.counts.refined,
            actors: self.runtime.as_ref().map(look::actors).unwrap_or_default(),
        }
    }

    fn facts(&self) -> Vec<(String, String)> {
        let mut facts = self.facts.clone();
        let scene = &self.world.scene;
        let hash: String = scene.content_hash.iter().map(|b| format!("{b:02x}")).collect();
        facts.push(("foveal scene".into(), format!("{} {hash}", scene.name)));
        if let Ok(settings) = serde_json::to_string(&self.settings) {
            facts.push(("foveal settings".into(), settings));
        }
        if let Ok(set) = serde_json::to_string(&self.controls.set) {
            facts.push(("foveal controls".into(), set));
        }
        let (view, state) = self.shown;
        facts.push(("foveal view".into(), format!("{view}, {state}")));
        facts.push((
            "foveal display".into(),
            format!("{:?}, {}", self.controls.set.tone, self.controls.overlay.name()),
        ));
        facts
    }
}

#[cfg(test)]
#[path = "session_tests.rs"]
mod tests;
