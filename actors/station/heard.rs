//! What a station is told: from outside by its guest, and by its own timers.

use std::sync::Arc;

use foveal_runtime::Message;
use serde::{Deserialize, Serialize};

use super::wire::Body;

/// What reaches a station from outside: recorded.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum Heard {
    /// A guest came. One that was there is gone.
    Joined {
        /// Names its stay.
        incarnation: u64,
        /// Its cores.
        cores: u16,
        /// Its name, for people.
        name: String,
    },
    /// Jobs are done.
    Done {
        /// Whose stay it was.
        incarnation: u64,
        /// Decides which samples are checked; the guest cannot know it.
        salt: u64,
        /// Which jobs, and what was found.
        jobs: Vec<Found>,
    },
    /// The guest left, or sent what makes no sense.
    Left {
        /// Whose stay is over.
        incarnation: u64,
        /// Whether it may not come back.
        banned: bool,
    },
    /// A guest came whose numbers have other bits.
    OtherJoined {
        /// Names its stay.
        incarnation: u64,
        /// Its cores.
        cores: u16,
        /// Its name, for people.
        name: String,
    },
    /// Jobs are done by one whose numbers have other bits, or what was found is to be kept anyway: it is recorded.
    Told {
        /// Whose stay it was.
        incarnation: u64,
        /// Decides which samples are checked; the guest cannot know it.
        salt: u64,
        /// Which jobs, and what was found.
        jobs: Vec<(Found, Option<Body>)>,
    },
}

/// An answer.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Found {
    /// The job.
    pub lease: u64,
    /// Time of one core, µs, as the guest says.
    pub micros: u32,
    /// Samples found; none where the job was not begun.
    pub count: Option<u32>,
    /// Hash of them.
    pub hash: u64,
    /// What was found itself. Not recorded: whoever replays traces it.
    #[serde(skip)]
    pub body: Option<Arc<Body>>,
}

/// What a station can be told.
#[derive(Clone, Debug, Message)]
pub enum StationMessage {
    /// From outside.
    #[message(kind = _0.kind())]
    Heard(Heard),
    /// From its own timer: a job is overdue.
    Overdue,
    /// From its own timer: send what was not accepted.
    SendAgain,
}

impl Heard {
    /// The variant's name, for reports.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Joined { .. } => "Joined",
            Self::Done { .. } => "Done",
            Self::Left { .. } => "Left",
            Self::OtherJoined { .. } => "OtherJoined",
            Self::Told { .. } => "Told",
        }
    }
}

impl From<Heard> for StationMessage {
    fn from(heard: Heard) -> Self {
        Self::Heard(heard)
    }
}
