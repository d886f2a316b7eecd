//! Rays, watertight triangles and the BVH.
//!
//! In: the scene's mesh. Out: closest hits and occlusion, watertight at any scale (nothing here knows an absolute
//! length). `obvhs` builds a binary tree in [`bvh`], whose nodes are joined eight by eight; primary rays go through it
//! sixteen at a time ([`packet`]), and so do shadow rays from neighbouring points to one light ([`shadow`]), others one by
//! one. Sources: Woop, Benthin & Wald 2013 (triangles), Ize 2013 (boxes), PBRT §6.8 (origins of secondary rays). Absent on
//! purpose: motion, instances.

mod beam;
mod block;
pub mod bvh;
pub mod bvh_peers;
mod collapse;
mod company;
pub mod kept;
mod level;
mod node;
mod offset;
pub mod packet;
pub mod ray;
pub mod shadow;
mod simd;
mod split;
mod stack;
mod wide;

pub use bvh::Accel;
pub use offset::{gamma, offset_origin};
pub use ray::{Hit, Ray};
