//! The illuminator's inbox.

use foveal_runtime::{Digest, Message};

/// Everything the illuminator can be told: all by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IlluminatorMessage {
    /// Do the next batch.
    Refine,
    /// From its own timer: send what was not accepted.
    SendAgain,
}

impl Message for IlluminatorMessage {
    fn digest(&self, _digest: &mut Digest) {}

    fn kind(&self) -> &'static str {
        match self {
            Self::Refine => "Refine",
            Self::SendAgain => "SendAgain",
        }
    }
}
