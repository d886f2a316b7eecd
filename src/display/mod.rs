//! Frame buffers and the CPU twin of every GPU pass.
//!
//! In: scene, camera frame, illumination. Out: linear colour of the base layer (emission + diffuse
//! reflection), depth along the view axis, object id, texture id with mip level, and the primary hit.

pub mod buffers;
pub mod environment_map;
pub mod first_approximation;
pub mod tone;
pub mod twin;

pub use buffers::{FrameBuffers, PrimaryHit, TextureLevel};
