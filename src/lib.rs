//! The pure core of foveal: algorithms as functions of their arguments.
//!
//! Modules in the order data flows: [`scene`] (materials, object hierarchy, cameras, plan) →
//! [`geometry`] (rays, watertight triangles, BVH) → [`transport`] (BSDFs, lights, the recursive
//! tracer, the reference path tracer, particles) → [`illumination`] (atlas, density estimation) →
//! [`display`] (frame buffers, the CPU pass) → [`perception`] → [`sampling`] (√5 lattice) →
//! [`splatting`] (footprints, sample cache, ageing, warp) → [`allocation`] → [`metrics`].
//!
//! [`math`] stands before them all: sines and powers with the same bits on every machine. [`radiosity`] stands aside: light on
//! a mesh that is cut back to any number of elements.
//!
//! Nothing in here knows an actor, a channel, a clock, a file or a GPU, and nothing prints.

pub mod allocation;
pub mod display;
pub mod geometry;
pub mod illumination;
pub mod image;
pub mod math;
pub mod metrics;
pub mod perception;
pub mod radiosity;
pub mod rng;
pub mod sampling;
pub mod scene;
pub mod splatting;
pub mod transport;
pub mod world;
