//! The actors of a session in this process, with rays that can be counted.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

use foveal::illumination::Irradiance;
use foveal::scene::Camera;
use foveal::scene::load::load;

use foveal::world::World;
use foveal_actors::allocator::Allocator;
use foveal_actors::message::{FrameIndex, FrameSnapshot, RendererInput};
use foveal_actors::renderer::{FrameCounts, FrameSink, Renderer};
use foveal_actors::settings::Settings;
use foveal_actors::stages::StageTimes;
use foveal_actors::wiring::{Actors, Parts, wire};
use foveal_runtime::{Config, Limit, Runtime};
use glam::Vec3;

/// Illumination that counts how often it is asked: once for every ray that ends on a diffuse surface.
pub struct Counting(AtomicU64);

impl Counting {
    /// How often so far.
    pub fn count(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

impl Irradiance for Counting {
    fn irradiance(&self, _: u32, _: f32, _: f32, _: bool) -> Vec3 {
        self.0.fetch_add(1, Ordering::Relaxed);
        Vec3::ONE
    }
}

/// A world whose rays are counted.
pub fn counted(file: &Path) -> (World, Arc<Counting>) {
    let counting = Arc::new(Counting(AtomicU64::new(0)));
    let scene = Arc::new(load(file).unwrap_or_else(|e| panic!("{e}")).scene);
    (World::new(scene, counting.clone()), counting)
}

/// Hands on what is shown.
struct Shown(Sender<Arc<FrameSnapshot>>);

impl FrameSink for Shown {
    fn frame_shown(&mut self, snapshot: &Arc<FrameSnapshot>, _: FrameCounts, _: &Renderer) {
        let _ = self.0.send(snapshot.clone());
    }
}

/// A running system without files or clock: frames end when somebody says so.
pub struct System {
    pub runtime: Runtime,
    pub actors: Actors,
    pub stages: StageTimes,
    shown: Receiver<Arc<FrameSnapshot>>,
    frame: u32,
    pub camera: Camera,
}

impl System {
    pub fn start(world: &World, settings: Settings) -> Self {
        let (send, shown) = channel();
        let stages = StageTimes::default();
        let parts =
            Parts { stages: stages.clone(), ..Parts::new(settings, world.clone(), Box::new(Shown(send))) };
        let threads = settings.tracers as usize + 1;
        let (runtime, actors) = Runtime::build(Config::live(threads), |w| wire(w, parts)).expect("actors");
        let camera = world.scene.cameras[0].camera;
        Self { runtime, actors, stages, shown, frame: 0, camera }
    }

    /// One frame, which ends when `done` of the runtime or after a minute.
    pub fn frame(&mut self, done: impl Fn(&Runtime) -> bool) -> Arc<FrameSnapshot> {
        let frame = FrameIndex(self.frame);
        self.frame += 1;
        self.actors.input.send(RendererInput::FrameBegan { frame, camera: self.camera }).expect("room");
        self.runtime.pump_until(Limit::time(Duration::from_secs(60)), done);
        self.actors.input.send(RendererInput::DeadlineReached { frame }).expect("room");
        let mut last = None;
        self.runtime.pump_until(Limit::time(Duration::from_secs(60)), |_| {
            last = self.shown.try_recv().ok();
            last.is_some()
        });
        last.expect("a frame")
    }

    pub fn converge(&mut self) -> Arc<FrameSnapshot> {
        let renderer = self.actors.renderer;
        self.frame(|r| r.inspect(renderer, Renderer::is_converged) == Some(true))
    }

    /// Until nobody has anything left to do: an analyzer may still rank what was shown last.
    pub fn rest(&mut self) {
        let idle = Limit::idle_within(Duration::from_secs(60));
        assert_eq!(self.runtime.pump(idle), foveal_runtime::Exit::Idle);
    }

    /// Ends it and looks at the allocator as it stopped.
    pub fn stop_and<R>(mut self, look: impl FnOnce(&Allocator) -> R) -> Option<R> {
        assert!(self.runtime.end(Duration::from_secs(10)).drained);
        self.actors.correction.map(|c| self.runtime.inspect(c.allocator, look).expect("the allocator"))
    }

    /// Ends it.
    pub fn stop(self) {
        assert!(self.runtime.shutdown(Duration::from_secs(10)).drained);
    }
}
