//! How a command ends: exit codes that other programs rely on, and one message for people.

use std::fmt;

/// Why a command did not end well.
#[derive(Debug)]
pub enum Failure {
    /// A check failed: replay diverged, an error above its bound. Exit 1.
    Check(String),
    /// The command line makes no sense. Exit 2.
    Usage(String),
    /// A file cannot be used; the message names it, the line and what to do. Exit 3.
    Input(String),
    /// A limit cannot be met. Exit 4.
    Limit(String),
    /// The machine lacks something, for example a display. Exit 5.
    Environment(String),
    /// Ctrl-C; what was done is kept. Exit 130.
    Interrupted(String),
}

impl Failure {
    /// The process's exit code.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Check(_) => 1,
            Self::Usage(_) => 2,
            Self::Input(_) => 3,
            Self::Limit(_) => 4,
            Self::Environment(_) => 5,
            Self::Interrupted(_) => 130,
        }
    }

    /// An actor panicked without which a walk cannot go on.
    pub fn ended(why: &impl fmt::Display) -> Self {
        Self::Check(format!("{why}; the walk ends in order"))
    }

    /// A file that could not be read or written.
    pub fn file(path: &std::path::Path, error: impl fmt::Display) -> Self {
        Self::Input(format!("{}: {error}", path.display()))
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Check(m)
            | Self::Usage(m)
            | Self::Input(m)
            | Self::Limit(m)
            | Self::Environment(m)
            | Self::Interrupted(m) => f.write_str(m),
        }
    }
}

impl std::error::Error for Failure {}
