//! The actors of foveal, their messages and wiring, and the program's command line.
//!
//! | actor | owns | decides |
//! | --- | --- | --- |
//! | [`renderer`] | camera, frame buffers, splat layer | what is on screen |
//! | [`analyzer`] | the attention model's pyramids | which objects matter to the eye |
//! | [`allocator`] | progress of every object, policy | what is traced next |
//! | [`tracer`] (several) | nothing that lasts | nothing: a job in, a batch of samples out |
//! | [`cache_ager`] | the sample cache | which samples still hold for this view |
//!
//! Who tells whom what stands in [`message`]; mailboxes and their bounds in [`wiring`].

pub mod allocator;
pub mod analyzer;
pub mod cache_ager;
pub mod cli;
pub mod illuminator;
pub mod insight;
pub mod message;
pub mod outbox;
pub mod processor_time;
pub mod renderer;
pub mod settings;
pub mod stages;
pub mod textures;
pub mod tracer;
#[cfg(feature = "window")]
pub mod window;
pub mod wiring;
