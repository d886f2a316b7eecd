//! Decision theory: what is done next, and what is kept, under limits.
//!
//! [`decision`] is Dumont's framework (2003 §3): constraint, action, approximation, cost, quality;
//! [`knapsack`] its optimiser. [`policy`] ranks (object, level) pairs, [`jobs`] cuts them into sample jobs. Pure
//! functions and plain data: the allocator actor feeds them.

pub mod decision;
pub mod jobs;
pub mod knapsack;
pub mod policy;
