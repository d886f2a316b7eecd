//! How densely a recording holds hashes, as a command line says it.

use foveal_runtime::Hashing;

/// How densely a recording holds hashes of what was delivered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Hashes {
    /// One per message (a byte); a divergence is located exactly
    #[default]
    Each,
    /// One per 256 messages; a divergence is located to within 256 messages
    Sparse,
    /// None; only a stall or a different frame is reported as a divergence
    None,
}

impl From<Hashes> for Hashing {
    fn from(hashes: Hashes) -> Self {
        match hashes {
            Hashes::Each => Self::Said,
            Hashes::Sparse => Self::Every(256),
            Hashes::None => Self::Off,
        }
    }
}
