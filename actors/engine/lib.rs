//! A walk through a lit scene as a library. The command line, the window, recordings, simulations and measurements of
//! foveal are clients of it, so what is measured is what runs.
//!
//! ```no_run
//! use std::time::Duration;
//! use foveal_engine::{Engine, Options, Settings};
//!
//! // 320 × 240 pixels, two tracers; light is baked while one walks.
//! let options = Options::new(Settings::new(320, 240, 2));
//! let mut walk = Engine::open("scenes/box/box.toml".as_ref(), options, &())?;
//! let camera = walk.opened().world.scene.cameras[0].camera;
//! for _ in 0..10 {
//!     let frame = walk.frame(&camera, Duration::from_millis(100))?;
//!     println!("{} samples, {:?}", frame.counts.traced, frame.standing);
//! }
//! # Ok::<(), foveal_engine::Failure>(())
//! ```
//!
//! | module | what |
//! | --- | --- |
//! | [`opened`], [`light`], [`bake_clock`] | files → a scene with its illumination |
//! | [`options`], [`machine`] | how a walk is started, and which actors that takes |
//! | [`engine`], [`edit`] | frames at deadlines, controls, what happened meanwhile; changes of the scene |
//! | [`source`], [`walk`], [`navigation`] | a walk by hand: input becomes cameras, cameras become frames |
//! | [`thread`], [`controls`] | the same on a thread of its own, for a door that serves many; what can be set, as a table |
//! | [`look`], [`screenshot`], [`pick`] | overlays, pictures, other displays; what is at a pixel |
//! | [`recording`], [`replay`] | what a recording says of its run; the same run again, from any moment |
//! | [`change`] | what a walk begins anew for |
//! | [`reference`](mod@reference) | the gold standards |
//! | [`failure`], [`interrupt`], [`files`], [`process`] | how things end, Ctrl-C, files, what the process takes |
//!
//! All that changes a running walk is an input of the renderer and so part of its recording. Edits of the scene
//! ([`Engine::edit`]: lamps dimmed, lights moved) begin another walk in the same engine, under light that is made anew; those
//! that are there when a walk begins are part of its recording. Whatever moves geometry is not among them yet.

#![expect(clippy::disallowed_methods, reason = "outside of the actors, which it drives")]

#[cfg(doctest)]
#[doc = include_str!("README.md")]
struct Readme;

pub mod bake_clock;
pub mod batch;
pub mod change;
pub mod controls;
pub mod edit;
pub mod engine;
pub mod failure;
pub mod files;
pub mod interrupt;
mod kept_light;
mod kept_scene;
pub mod light;
pub mod look;
pub mod machine;
pub mod navigation;
pub mod opened;
pub mod options;
pub mod pick;
pub mod process;
pub mod recipe;
pub mod recording;
pub mod reference;
pub mod replay;
pub mod screenshot;
pub mod source;
#[cfg(test)]
mod test_scene;
pub mod thread;
pub mod walk;

// Their types stand in signatures here.
pub use {foveal, foveal_actors, foveal_runtime, glam};

pub use edit::{EditError, Lamp, SceneEdit};
pub use engine::{Engine, Event, Frame, Stalled, Standing};
pub use failure::Failure;
pub use foveal_actors::settings::Settings;
pub use light::Light;
pub use opened::Opened;
pub use options::{Clock, Options, Recording};
pub use recipe::Recipe;
