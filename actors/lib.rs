//! The five actors of foveal, their messages and wiring.
pub mod renderer;
#[cfg(feature = "window")]
pub mod window;
