//! The session of actors that a window shows.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use crossbeam_queue::ArrayQueue;
use foveal::allocation::policy::RayPolicy;
use foveal::display::tone::{Encoder, ToneMap};
use foveal::display::twin::Passes;
use foveal::image::Map2d;
use foveal::perception::importance::{ObjectScan, ObjectStatistics};
use foveal::perception::saliency::SaliencyModel;
use foveal::scene::Camera;
use foveal::scene::plan::{Part, ScenePlan};
use foveal::world::World;
use foveal_runtime::{BuildError, Config, Limit, Runtime};

use super::source::{ActorStatus, Controls, FrameSource, Place, Status};
use crate::message::{FrameIndex, FrameSnapshot, RendererInput};
use crate::renderer::overlay::{Overlay, Sources, paint};
use crate::renderer::{FrameCounts, FrameSink, Renderer};
use crate::settings::Settings;
use crate::stages::StageTimes;
use crate::wiring::{Actors, Parts, wire};

/// Time that actors have to come to rest when they are no longer needed.
const SHUTDOWN: Duration = Duration::from_secs(2);
/// Longest time for the picture of a frame, once its deadline is over.
const SHOWING: Duration = Duration::from_secs(10);

/// Says where a session of actors with these settings is recorded, and the application's part of the header.
pub type Recorder = Box<dyn FnMut(&Settings, Passes, bool) -> Option<(PathBuf, Vec<u8>)> + Send>;

/// Keeps the newest frame's counts for the window.
struct Newest(Arc<ArrayQueue<FrameCounts>>);

impl FrameSink for Newest {
    fn frame_shown(&mut self, _snapshot: &Arc<FrameSnapshot>, counts: FrameCounts, _renderer: &Renderer) {
        self.0.force_push(counts);
    }
}

/// Actors at work, and what they are made of.
pub struct Session {
    world: World,
    settings: Settings,
    corrects: bool,
    passes: Passes,
    controls: Controls,
    /// `None` only while it is made anew, or if that failed.
    system: Option<(Runtime, Actors)>,
    newest: Arc<ArrayQueue<FrameCounts>>,
    counts: FrameCounts,
    frame: u32,
    encoder: Encoder,
    attention: AttentionView,
    facts: Vec<(String, String)>,
    recorder: Option<Recorder>,
}

/// Relative saliency of the objects on screen, for the overlay alone: the allocator's own numbers belong to its thread.
#[derive(Default)]
struct AttentionView {
    model: SaliencyModel,
    scan: ObjectScan,
    statistics: Vec<ObjectStatistics>,
}

impl Session {
    /// Starts the actors.
    ///
    /// # Errors
    /// If threads cannot be started.
    pub fn start(
        world: World,
        settings: Settings,
        fps: f32,
        facts: Vec<(String, String)>,
        recorder: Option<Recorder>,
    ) -> Result<Self, String> {
        let plan = ScenePlan::new(&world.scene, &world.scene.budget);
        let controls = Controls {
            fps,
            saliency_weight: settings.saliency_weight,
            policy: settings.policy.policy,
            samples_per_job: settings.samples_per_job,
            ageing: settings.ageing,
            tone: ToneMap::from(&world.scene.display),
            overlay: Overlay::None,
        };
        let mut session = Self {
            corrects: plan.needs(Part::Tracers),
            // The overlay of mip levels shows it.
            passes: Passes { texture_ids: !world.scene.textures.is_empty() },
            world,
            settings,
            controls,
            system: None,
            newest: Arc::new(ArrayQueue::new(1)),
            counts: FrameCounts::default(),
            frame: 0,
            encoder: Encoder::default(),
            attention: AttentionView::default(),
            facts,
            recorder,
        };
        session.restart()?;
        Ok(session)
    }

    /// New actors with the settings as they are now. The world stays; samples are traced again.
    fn restart(&mut self) -> Result<(), String> {
        self.stop();
        let threads = if self.corrects { self.settings.tracers as usize + 1 } else { 0 };
        let recorder = self.recorder.as_mut();
        let recorded = recorder.and_then(|r| r(&self.settings, self.passes, self.corrects));
        let parts = || Parts {
            settings: self.settings,
            world: self.world.clone(),
            passes: self.passes,
            corrects: self.corrects,
            textures: None,
            refinement: None,
            stages: StageTimes::default(),
            sink: Box::new(Newest(self.newest.clone())),
        };
        let mut config = Config::live(threads);
        if let Some((file, header)) = recorded {
            config.application = header;
            config = config.record(file);
        }
        let built = match Runtime::build(config, |w| wire(w, parts())) {
            Err(BuildError::Record(e)) => {
                tracing::warn!("the walk is not recorded: {e}; choose another --record");
                Runtime::build(Config::live(threads), |w| wire(w, parts()))
            }
            built => built,
        };
        self.system = Some(built.map_err(|e| format!("the actors cannot be started: {e}"))?);
        Ok(())
    }

    fn stop(&mut self) {
        if let Some((runtime, _)) = self.system.take() {
            let end = runtime.shutdown(SHUTDOWN);
            tracing::debug!("actors stopped, drained: {}", end.drained);
        }
    }

    fn send(&mut self, input: RendererInput) {
        if let Some((_, actors)) = &self.system
            && let Err(e) = actors.input.send(input)
        {
            tracing::warn!("an input was not taken: {e}");
        }
    }

    fn look<R>(&self, look: impl FnOnce(&Renderer) -> R) -> Option<R> {
        let (runtime, actors) = self.system.as_ref()?;
        runtime.inspect(actors.renderer, look)
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        self.stop();
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

    fn set_controls(&mut self, controls: &Controls) {
        let settings = Settings {
            saliency_weight: controls.saliency_weight,
            policy: RayPolicy { policy: controls.policy, ..self.settings.policy },
            samples_per_job: controls.samples_per_job.max(1),
            ageing: controls.ageing,
            ..self.settings
        };
        self.controls = *controls;
        if settings != self.settings {
            self.settings = settings;
            if let Err(e) = self.restart() {
                tracing::error!("{e}");
            }
        }
    }

    fn begin_frame(&mut self, camera: &Camera) {
        self.send(RendererInput::FrameBegan { frame: FrameIndex(self.frame), camera: *camera });
        // Until the renderer has heard of it, "converged" is said of the view before.
        if let Some((runtime, actors)) = &mut self.system {
            let renderer = actors.renderer;
            runtime.pump_until(Limit::time(SHOWING), |r| {
                r.inspect(renderer, |r| r.camera() == Some(*camera)) == Some(true)
            });
        }
    }

    fn work(&mut self, time: Duration) {
        let Some((runtime, actors)) = &mut self.system else { return };
        let renderer = actors.renderer;
        runtime.pump_until(Limit::time(time), |r| r.inspect(renderer, Renderer::is_converged) == Some(true));
    }

    fn end_frame(&mut self) {
        let _ = self.newest.pop();
        self.send(RendererInput::DeadlineReached { frame: FrameIndex(self.frame) });
        self.frame = self.frame.wrapping_add(1);
        let newest = self.newest.clone();
        if let Some((runtime, _)) = &mut self.system {
            runtime.pump_until(Limit::time(SHOWING), |_| !newest.is_empty());
        }
        if let Some(counts) = self.newest.pop() {
            self.counts = counts;
        }
    }

    fn picture(&mut self) -> Option<Map2d<[u8; 3]>> {
        let (runtime, actors) = self.system.as_ref()?;
        let (controls, k_max) = (self.controls, self.settings.k_max);
        let (encoder, attention) = (&self.encoder, &mut self.attention);
        let as_scene = controls.tone == ToneMap::from(&self.world.scene.display);
        let objects = self.world.scene.objects.len().max(1);
        runtime.inspect(actors.renderer, |renderer| {
            let shown = renderer.shown()?;
            let rgb8 = if as_scene {
                (*shown.rgb8).clone()
            } else {
                renderer.picture()?.map(|radiance| encoder.rgb8(&controls.tone, radiance))
            };
            if controls.overlay == Overlay::None {
                return Some(rgb8);
            }
            let buffers = &renderer.drawn()?.buffers;
            let attention = match controls.overlay {
                Overlay::Saliency => attention.of(&shown.rgb8, &buffers.object, objects),
                _ => Vec::new(),
            };
            let sources = Sources { buffers, splats: renderer.layer(), k_max, attention: &attention };
            Some(paint(controls.overlay, &sources, &rgb8))
        })?
    }

    fn status(&self) -> Status {
        let (view, converged) =
            self.look(|r| (r.drawn().map_or(0, |d| d.view.0), r.is_converged())).unwrap_or((0, true));
        let actors = self.system.as_ref().map_or_else(Vec::new, |(runtime, _)| {
            runtime
                .counters()
                .into_iter()
                .map(|c| ActorStatus {
                    name: c.name,
                    delivered: c.delivered,
                    waiting_max: c.depth_max,
                    busy: Duration::from_nanos(c.busy_ns),
                })
                .collect()
        });
        Status {
            view,
            converged,
            traced: self.counts.traced,
            reused: self.counts.reused,
            expired: self.counts.expired,
            actors,
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
        let Status { view, converged, .. } = self.status();
        let state = if converged { "converged" } else { "growing" };
        facts.push(("foveal view".into(), format!("{view}, {state}")));
        facts.push((
            "foveal display".into(),
            format!("{:?}, {}", self.controls.tone, self.controls.overlay.name()),
        ));
        facts
    }
}

impl AttentionView {
    fn of(&mut self, rgb8: &Map2d<[u8; 3]>, objects: &Map2d<u32>, count: usize) -> Vec<f32> {
        let map = &self.model.compute_rgb8(rgb8.data().as_flattened(), rgb8.width(), rgb8.height()).map;
        self.scan.gather(objects, Some(map), count, &mut self.statistics);
        // Relative to the most salient of the objects that can be corrected.
        let highest = self.statistics.iter().skip(1).map(|s| s.saliency).fold(0.0, f32::max);
        let scale = if highest > 0.0 { 1.0 / highest } else { 0.0 };
        self.statistics.iter().map(|s| s.saliency * scale).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::renderer::gpu::test_scene;
    use crate::window::walk::{Next, Walk};
    use foveal::illumination::Uniform;
    use foveal::splatting::AgeingRules;
    use glam::Vec3;
    use std::time::Instant;

    fn walk() -> Walk {
        let world = World::new(Arc::new(test_scene::room(4)), Arc::new(Uniform(Vec3::ONE)));
        let session =
            Session::start(world, Settings::new(64, 48, 1), 30.0, Vec::new(), None).expect("actors");
        Walk::new(Box::new(session), 0.0)
    }

    /// Ticks in real time until nothing is left to do.
    fn settle(walk: &mut Walk, start: Instant) {
        loop {
            let now = start.elapsed().as_secs_f64();
            assert!(now < 120.0, "the walk never comes to rest");
            match walk.tick(now).1 {
                Next::Input => return,
                Next::Now => {}
                Next::At(t) => std::thread::sleep(Duration::from_secs_f64((t - now).clamp(0.0, 0.1))),
            }
        }
    }

    #[test]
    fn a_walk_comes_to_rest_converged_and_every_overlay_shows_something_else() {
        let (mut walk, start) = (walk(), Instant::now());
        settle(&mut walk, start);
        assert!(walk.status().converged);
        let plain = walk.picture().cloned().expect("a picture");
        assert!(plain.data().iter().flatten().any(|b| *b > 100));
        for _ in 1..Overlay::ALL.len() {
            walk.next_overlay();
            settle(&mut walk, start);
            assert_ne!(walk.picture(), Some(&plain), "{:?}", walk.controls().overlay);
        }
        walk.next_overlay();
        settle(&mut walk, start);
        assert_eq!(walk.picture(), Some(&plain), "overlays leave nothing behind");
    }

    #[test]
    fn exposure_changes_the_picture_but_traces_nothing() {
        let (mut walk, start) = (walk(), Instant::now());
        settle(&mut walk, start);
        let (view, plain) = (walk.status().view, walk.picture().cloned().expect("a picture"));
        let mut controls = *walk.controls();
        controls.tone.exposure = 0.25;
        walk.set_controls(controls);
        settle(&mut walk, start);
        let sum = |p: &Map2d<[u8; 3]>| p.data().iter().flatten().map(|b| u64::from(*b)).sum::<u64>();
        assert!(walk.picture().is_some_and(|p| sum(p) * 10 < sum(&plain) * 9), "darker");
        assert_eq!((walk.status().view, walk.status().traced), (view, 0));
    }

    #[test]
    fn other_ageing_rules_converge_to_the_same_picture() {
        let (mut walk, start) = (walk(), Instant::now());
        settle(&mut walk, start);
        let plain = walk.picture().cloned();
        let mut controls = *walk.controls();
        controls.ageing = AgeingRules { delta: 0.3, max_age: 7, n_min: 2 };
        walk.set_controls(controls);
        settle(&mut walk, start);
        assert!(walk.status().converged);
        assert_eq!(walk.picture().cloned(), plain);
    }
}
