//! The recording of a run: what is in it, how it is written while the system runs, and how it is read back.

pub(crate) mod coder;
pub mod events;
pub mod fingerprint;
pub mod format;
pub mod reader;
pub(crate) mod walk;
pub(crate) mod writer;
