//! Rays, watertight triangles and the BVH.
//!
//! In: the scene's mesh. Out: closest hits and occlusion, watertight at any scale.

pub mod bvh;
pub mod packet;
pub mod ray;
pub mod triangle;

pub use bvh::Accel;
pub use ray::{Hit, Ray};
