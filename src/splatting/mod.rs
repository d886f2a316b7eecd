//! Corrective splatting: samples of view-dependent radiance, the cache that keeps them from view to
//! view, and the layer they are drawn into (Haber 2001 §4.3, §4.5; REFERENCE §3, §11).
//!
//! The shown picture is the base layer (diffuse illumination, `display`) plus the splat layer, both
//! linear: splats replace each other and the *sum* is tone-mapped (correction H13).

pub mod cache;
pub mod filter;
pub mod layer;
pub mod light_tracing;
pub mod pull_push;
pub mod reconstruction;
pub mod sample;
pub mod settled;
pub mod supersampling;
pub mod tile_sums;
pub mod trace;
pub mod warp;

pub use cache::{AgeingRules, SampleCache};
pub use layer::{Footprint, SplatLayer};
pub use reconstruction::Reconstruction;
pub use sample::{Guides, Sample, SampleBatch};
pub use warp::{WarpedSample, warp};
