//! The window: a walk that one can steer, look at and look into.
//!
//! In: a [`source::Loader`], input of the user. Out: frames of a session of actors, which is pumped on the
//! window's thread between looks at the input. Everything that reaches the actors goes through
//! [`source::FrameSource`] and is a recorded message there.
//!
//! With a graphics adapter the window is painted by it, without one by the processor; both show the same. Hardware also
//! draws the picture in it (`renderer::gpu::Mirror`).

pub mod app;
pub mod decisions;
pub mod interface;
pub mod legend;
pub mod look;
pub mod navigation;
pub mod painter;
pub mod panel;
pub mod presenter;
pub mod probe;
pub mod screenshot;
pub mod session;
pub mod source;
pub mod timeline;
pub mod walk;

pub use app::{Options, WindowError, run};
pub use presenter::{Backend, DrawnBy};
pub use session::{Made, Recording, Session, Stalled, parts_of};
pub use source::{Build, Controls, FrameSource, Loader, Place, Ranges, Status};
