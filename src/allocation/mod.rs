//! Decision theory: what is done next, and what is kept, under limits.
//!
//! [`decision`] is Dumont's framework (2003 §3): constraint, action, approximation, cost, quality; [`knapsack`] its
//! optimiser. Textures: [`spatial_error`] (a pre-process) , [`texture_demand`] (per view) and [`residency`] (step by step), [`texture_baselines`] to compare with. Environment maps:
//! [`environment`]. Rays: [`rays`] estimates what they bring, [`policy`] ranks (object, level) pairs, [`jobs`] cuts them
//! into sample jobs, [`ray_order`] joins the three, [`supersampling`] goes on where all of them are done. Pure functions
//! and plain data: the allocator actor feeds them.

pub mod decision;
pub mod environment;
pub mod jobs;
pub mod knapsack;
pub mod mesh_elements;
pub mod policy;
pub mod ray_order;
pub mod rays;
pub mod residency;
pub mod search;
pub mod spatial_error;
pub mod supersampling;
pub mod texture_baselines;
pub mod texture_demand;
