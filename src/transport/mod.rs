//! BSDFs, lights and the tracers.
