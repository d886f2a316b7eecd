//! Frame buffers and the CPU pass beside every GPU pass.
//!
//! In: scene, camera frame, illumination. Out: linear colour of the base layer (emission + diffuse
//! reflection), depth along the view axis, object id, texture id with mip level, and the primary hit.

pub mod buffers;
pub mod cpu_pass;
pub mod environment_map;
pub mod first_approximation;
pub mod tone;

pub use buffers::{FrameBuffers, PrimaryHit, TextureLevel};
