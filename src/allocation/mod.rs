//! Decision theory: what is done next, and what is kept, under limits.
//!
//! [`policy`] ranks (object, level) pairs, [`jobs`] cuts them into sample jobs. Pure functions and
//! plain data: the allocator actor feeds them.

pub mod jobs;
pub mod policy;
