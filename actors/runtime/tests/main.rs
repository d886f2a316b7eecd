//! Systems as a user builds them: live, recorded, replayed, simulated.

#![allow(clippy::disallowed_methods, reason = "tests run outside of actors, and plant clocks inside")]

mod asking;
mod common;
mod damage;
mod derived;
mod ends;
mod giving_up;
mod hostile;
mod keeping;
mod leases;
mod live;
mod panics;
mod planted;
mod recording;
mod ring;
mod simulation;
mod snapshots;
mod spawning;
mod stopping;
mod workshop;
