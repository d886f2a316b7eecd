//! The renderer.
#[cfg(feature = "window")]
pub mod gpu;
pub mod overlay;
