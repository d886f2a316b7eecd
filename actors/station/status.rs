//! A station as people see it.

use serde::{Deserialize, Serialize};

/// How a station stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Stands {
    /// It has no guest.
    #[default]
    Vacant,
    /// The first answers of its guest are checked in full.
    Proving,
    /// Its guest traces.
    Serving,
    /// Its guest does not answer.
    Suspect,
}

impl Stands {
    /// For people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Vacant => "vacant",
            Self::Proving => "proving",
            Self::Serving => "serving",
            Self::Suspect => "suspect",
        }
    }
}

/// What became of a station's jobs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StationCounts {
    /// Samples and guides that came.
    pub samples: u64,
    /// Jobs that were done.
    pub jobs: u64,
    /// Answers that came too late, twice or for nothing.
    pub late: u64,
    /// Jobs that went to others.
    pub returned: u64,
    /// Jobs that others were given as well.
    pub shared: u64,
    /// Samples that were traced here as well, to compare.
    pub checked: u64,
    /// Guests that were banned.
    pub banned: u64,
}

/// A station as people see it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StationStatus {
    /// The guest's name; none where there is no guest.
    pub guest: Option<String>,
    /// Whether its numbers have other bits than this machine's.
    pub other_bits: bool,
    /// Its cores.
    pub cores: u16,
    /// How it stands.
    pub stands: Stands,
    /// Samples a second that came from the guest, between its coming and its last answer.
    pub rate: f32,
    /// Jobs that it has, and may have.
    pub jobs: [u32; 2],
    /// The way there and back, seconds.
    pub round_trip: f32,
    /// What became of its jobs so far.
    pub counts: StationCounts,
}

impl StationStatus {
    /// How it stands, for people.
    pub fn told(&self) -> String {
        let of_bits = if self.other_bits { ", other bits" } else { "" };
        format!("{}{of_bits}", self.stands.name())
    }
}
