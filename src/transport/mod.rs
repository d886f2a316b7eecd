//! BSDFs, lights and the tracers.

pub mod bsdf;
pub mod interaction;
pub mod light;
pub mod particle;
pub mod radiosity;
