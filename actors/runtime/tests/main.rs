//! Systems as a user builds them: live, recorded, replayed, simulated.

mod common;
mod damage;
mod live;
mod planted;
mod recording;
mod ring;
mod simulation;
mod snapshots;
mod workshop;
