//! How densely a recording holds hashes, as a command line says it.

use foveal_runtime::Hashing;

/// How densely a recording holds hashes of what was delivered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Hashes {
    /// One for each message, a byte: a divergence is named at its message
    #[default]
    Each,
    /// One for 256 messages: a divergence is named to within these
    Sparse,
    /// None: only a stall or another frame is a divergence
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
