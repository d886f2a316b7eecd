//! BSDFs, lights and the tracers.
//!
//! In: a scene, its geometry index and (for the tracer) stored illumination. Out: radiance along rays, in
//! W·sr⁻¹·m⁻² per band; [`tracer`] for corrections, [`gather`] for references and refinement, [`bidirectional`] for the
//! truth, [`particle`] and [`radiosity`] for the stored illumination.

pub mod bidirectional;
pub mod bsdf;
pub mod caustic;
pub(crate) mod direct;
pub mod gather;
pub mod interaction;
pub mod light;
pub mod lit;
pub mod medium;
pub mod particle;
pub mod radiosity;
pub mod surface;
#[cfg(test)]
pub(crate) mod test_boxes;
pub mod tracer;

pub(crate) use bidirectional::geometric_cosine;
