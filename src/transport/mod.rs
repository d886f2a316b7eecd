//! BSDFs, lights and the tracers.
//!
//! In: a scene, its geometry index and (for the tracer) stored illumination. Out: radiance along rays, in
//! W·sr⁻¹·m⁻² per band; [`tracer`] for corrections, [`gather`] and [`caustic`] for stored light, references and refinement,
//! [`bidirectional`] for the reference.

pub mod arrivals;
pub mod bidirectional;
pub mod bsdf;
pub mod caustic;
pub(crate) mod direct;
pub mod gather;
pub mod interaction;
pub mod light;
pub mod lit;
pub mod medium;
pub mod surface;
#[cfg(test)]
pub(crate) mod test_boxes;
pub mod tracer;

pub(crate) use bidirectional::geometric_cosine;

use crate::geometry::Accel;
use crate::scene::Scene;

/// A scene with all that rays need of it.
#[derive(Clone, Copy)]
pub struct Indexed<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Its geometry index.
    pub accel: &'a Accel,
    /// Its lights.
    pub lights: &'a light::Lights,
}

impl<'a> Indexed<'a> {
    /// The integrator of its light, with as much trust in a map.
    pub fn gather(self, trust: gather::Trust<'a>) -> gather::Gather<'a> {
        gather::Gather::new(self.scene, self.accel, self.lights, trust)
    }
}
