//! BSDFs, lights and the tracers.

pub mod particle;
pub mod radiosity;

pub mod bsdf;
pub mod interaction;
