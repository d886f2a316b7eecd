//! Recordings: the world they were made in, systems that replay them from any moment, and what can be asked of them.

mod beside;
#[cfg(test)]
mod grown_tests;
mod index;
mod player;
mod source;
mod stepper;
pub mod when;
pub mod why;
mod why_light;

pub use beside::Beside;
pub use player::Player;
pub use source::{How, Indexing, Seen, Source, Telling, name, observe};
pub use stepper::Stepper;
