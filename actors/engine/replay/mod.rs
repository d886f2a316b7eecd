//! Recordings: the world they were made in, systems that replay them from any moment, and what can be asked of them.

mod beside;
mod condition;
mod counters;
mod course;
pub mod diverged;
#[cfg(test)]
mod grown_tests;
mod history;
mod index;
mod indexing;
mod lanes;
pub mod late;
mod listener;
mod pair;
mod pictures;
mod plain;
mod player;
mod search;
mod source;
#[cfg(test)]
mod source_tests;
mod stepper;
pub mod when;
pub mod why;
mod why_light;
mod why_notes;
mod why_path;

pub use beside::Beside;
pub use index::Kept;
pub use indexing::Indexing;
pub use lanes::{Lanes, Timed, ring_turns};
pub use pair::{Pair, first_other_frame};
pub use player::Player;
pub use source::{Begun, Ground, How, Seen, Source, Telling, name, observe};
pub use stepper::Stepper;
pub use why_path::{Segment, drawn_over};
