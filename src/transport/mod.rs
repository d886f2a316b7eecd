//! BSDFs, lights and the tracers.

pub mod radiosity;

pub mod interaction;
