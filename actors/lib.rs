//! The actors of foveal, their messages and wiring.
//!
//! | actor | owns | decides |
//! | --- | --- | --- |
//! | [`renderer`] | camera, frame buffers, splat layer | what is on screen |
//! | [`analyzer`] | the attention model's pyramids | which objects matter to the eye |
//! | [`allocator`] | progress of every object, policy | what is traced next |
//! | [`tracer`] (several) | nothing that lasts | nothing: a job in, a batch of samples out |
//! | [`cache_ager`] | the sample cache | which samples still hold for this view |
//! | [`station`] (where other machines may trace) | the jobs that a machine is at | when it has waited for it long enough |
//!
//! Who tells whom what stands in [`message`]; mailboxes and their bounds in [`wiring`].

pub mod allocator;
pub mod analyzer;
pub mod cache_ager;
pub mod foresight;
pub mod illuminator;
pub mod insight;
pub mod light_book;
pub mod message;
mod outbox;
pub mod renderer;
pub mod settings;
#[expect(clippy::disallowed_methods, reason = "durations that no actor can read")]
pub mod stages;
pub mod station;
pub mod textures;
pub mod tracer;
pub mod wiring;
