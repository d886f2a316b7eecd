//! A scene made ready to be walked: geometry index, lights and illumination beside it.

use std::sync::Arc;

use glam::Vec3;

use crate::geometry::{Accel, Ray};
use crate::illumination::Irradiance;
use crate::rng::Stream;
use crate::scene::camera::CameraFrame;
use crate::scene::{Scene, Texture};
use crate::transport::bidirectional::Bidirectional;
use crate::transport::gather::{Gather, Trust};
use crate::transport::light::Lights;
use crate::transport::tracer::{Settings, Tracer};

/// Everything rays need, shared by all who trace and never changed. A refined illumination makes a
/// new `World` around the same scene.
#[derive(Clone)]
pub struct World {
    /// The scene.
    pub scene: Arc<Scene>,
    /// Its geometry index.
    pub accel: Arc<Accel>,
    /// Its lights.
    pub lights: Arc<Lights>,
    /// Diffuse illumination.
    pub illumination: Arc<dyn Irradiance>,
}

impl World {
    /// Builds geometry index and lights.
    pub fn new(scene: Arc<Scene>, illumination: Arc<dyn Irradiance>) -> Self {
        let accel = Arc::new(Accel::build(&scene));
        let lights = Arc::new(Lights::build(&scene));
        Self { scene, accel, lights, illumination }
    }

    /// The tracer of corrections in this world.
    pub fn tracer(&self) -> Tracer<'_> {
        Tracer::new(&self.scene, &self.accel, &self.lights, &*self.illumination, Settings::default())
    }

    /// Unbiased radiance along a ray, without the illumination.
    pub fn path_radiance(&self, ray: &Ray, stream: Stream) -> Vec3 {
        self.gather(Trust::Nobody).radiance(ray, stream)
    }

    /// The integrator of this world's light, with as much trust in a map.
    pub fn gather<'a>(&'a self, trust: Trust<'a>) -> Gather<'a> {
        Gather::new(&self.scene, &self.accel, &self.lights, trust)
    }

    /// Bidirectional paths of a view, without the illumination.
    pub fn bidirectional<'a>(&'a self, frame: &'a CameraFrame) -> Bidirectional<'a> {
        Bidirectional::new(&self.scene, &self.accel, &self.lights, frame)
    }

    /// The same world with other levels of its textures in memory.
    pub fn with_resident(&self, textures: Vec<Texture>) -> Self {
        Self { scene: Arc::new(self.scene.with_resident(textures)), ..self.clone() }
    }

    /// The same scene under another illumination.
    pub fn with_illumination(&self, illumination: Arc<dyn Irradiance>) -> Self {
        Self { illumination, ..self.clone() }
    }
}

impl std::fmt::Debug for World {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("World").field("scene", &self.scene.name).finish_non_exhaustive()
    }
}
