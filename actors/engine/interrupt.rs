//! Ctrl-C, or whatever else asks the whole process for an end: long work looks here and keeps what was done.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::failure::Failure;

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Asks for an end. Returns whether somebody had asked before.
pub fn interrupt() -> bool {
    INTERRUPTED.swap(true, Ordering::Relaxed)
}

/// Whether an end was asked for.
pub fn interrupted() -> bool {
    INTERRUPTED.load(Ordering::Relaxed)
}

/// Nothing, until an end was asked for.
///
/// # Errors
/// From then on.
pub fn uninterrupted() -> Result<(), Failure> {
    match interrupted() {
        false => Ok(()),
        true => Err(Failure::Interrupted("interrupted; what was done is kept".into())),
    }
}
