//! The actors of a session in this process, with rays that can be counted.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use foveal::illumination::Irradiance;
use foveal::scene::Camera;
use foveal_files::load::load;

use foveal::world::World;
use foveal_actors::allocator::Allocator;
use foveal_actors::renderer::Renderer;
use foveal_engine::{Engine, Frame, Opened, Options, Settings};
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

/// A walk without files whose frames end when somebody says so.
pub struct System {
    pub engine: Engine,
    pub camera: Camera,
}

impl System {
    pub fn start(world: &World, settings: Settings) -> Self {
        let opened = Opened::of_world(world.clone());
        let camera = world.scene.cameras[0].camera;
        Self { engine: Engine::start(opened, Options::new(settings)).expect("actors"), camera }
    }

    /// One frame, which ends when `done` of the renderer or after a minute.
    pub fn frame(&mut self, done: impl Fn(&Renderer) -> bool) -> Frame {
        self.engine.begin(&self.camera).expect("room");
        self.engine.work_until(Duration::from_secs(60), done).expect("a walk");
        self.engine.end().expect("a frame")
    }

    pub fn converge(&mut self) -> Frame {
        self.frame(Renderer::is_converged)
    }

    /// Until nobody has anything left to do: an analyzer may still rank what was shown last.
    pub fn rest(&mut self) {
        assert!(self.engine.rest(Duration::from_secs(60)).expect("a walk"));
    }

    /// Ends it and looks at the allocator as it stopped.
    pub fn stop_and<R>(mut self, look: impl FnOnce(&Allocator) -> R) -> Option<R> {
        assert!(self.engine.finish(Duration::from_secs(10)).drained);
        let correction = self.engine.actors().correction;
        correction.map(|c| self.engine.runtime().inspect(c.allocator, look).expect("the allocator"))
    }

    /// Ends it.
    pub fn stop(mut self) {
        assert!(self.engine.finish(Duration::from_secs(10)).drained);
    }
}
