//! The window: a walk that one can steer, look at and look into.
//!
//! In: a [`foveal_engine::source::Loader`], input of the user. Out: frames of a [`foveal_engine::Engine`], which is pumped on
//! the window's thread between looks at the input. Everything that reaches the actors goes through
//! [`foveal_engine::source::FrameSource`] and is a recorded message there.
//!
//! With a graphics adapter the window is painted by it, without one by the processor; both show the same. Hardware also
//! draws the picture in it ([`gpu::Mirror`]).

#![expect(clippy::disallowed_methods, reason = "outside of the actors, which it drives")]

#[cfg(test)]
mod access_tests;
mod app;
mod decisions;
pub mod gpu;
pub mod interface;
mod lanes;
pub mod legend;
#[cfg(test)]
mod mirror_tests;
mod painter;
pub mod panel;
mod presenter;
pub mod probe;
mod standing;
mod tables;
pub mod timeline;

pub use app::{Options, WindowError, run};
pub use presenter::{Backend, DrawnBy};
