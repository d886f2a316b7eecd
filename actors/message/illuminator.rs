//! The illuminator's inbox.

use foveal_runtime::Message;

/// Everything the illuminator can be told: all by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Message)]
pub enum IlluminatorMessage {
    /// Do the next batch.
    Refine,
    /// From its own timer: send what was not accepted.
    SendAgain,
}
