//! BSDFs, lights and the tracers.

pub mod radiosity;
