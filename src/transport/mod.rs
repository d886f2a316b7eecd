//! BSDFs, lights and the tracers.
//!
//! In: a scene, its geometry index and (for the tracer) stored illumination. Out: radiance along rays, in
//! W·sr⁻¹·m⁻² per band; [`tracer`] for corrections, [`gather`] for references and refinement, [`bidirectional`] for the
//! truth, [`particle`] and [`radiosity`] for the stored illumination.

pub mod bidirectional;
pub mod bsdf;
mod direct;
pub mod gather;
pub mod interaction;
pub mod light;
pub mod lit;
pub mod medium;
pub mod particle;
pub mod radiosity;
pub mod surface;
#[cfg(test)]
mod test_boxes;
pub mod tracer;

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
