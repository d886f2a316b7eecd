//! The display on a graphics adapter: WGSL passes beside those in `foveal::display` and
//! `foveal::splatting::layer`.
//!
//! In: a scene with its illumination, camera frames, samples. Out: the picture, and on demand the
//! buffers of a view. Everything linear up to `compose`; the splat layer replaces, and the *sum* of
//! both layers is tone-mapped (REFERENCE H13).
//!
//! Nothing here decides anything: a session is the same with and without an adapter, since actors
//! work on the processor's buffers.

pub mod adapter;
mod base;
mod compose;
#[cfg(test)]
mod cpu_pass_tests;
pub mod display;
mod geometry;
mod layout;
mod mirror;
pub(crate) mod readback;
mod reconstruction;
mod rows;
mod splat;
#[cfg(test)]
#[path = "../../engine/test_scene.rs"]
pub(crate) mod test_scene;
mod textures;

pub use adapter::{AdapterInfo, Gpu, adapter};
pub use display::GpuDisplay;
pub use mirror::Mirror;
