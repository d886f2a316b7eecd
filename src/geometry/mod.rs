//! Rays, watertight triangles and the BVH.
//!
//! In: the scene's mesh. Out: closest hits and occlusion, watertight at any scale.

pub mod bvh;
mod offset;
pub mod packet;
pub mod ray;
pub mod triangle;

pub use bvh::Accel;
pub use offset::{gamma, offset_origin};
pub use ray::{Hit, Ray};
