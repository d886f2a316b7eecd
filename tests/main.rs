//! The program as a user runs it, its bundled scenes, and the rules of the source tree.
//!
//! The program runs as a process of its own, on the bundled scenes at small sizes, with illumination baked
//! cheaply into a folder that the tests of one run share.

#![allow(clippy::disallowed_methods, reason = "tests run outside of actors")]

mod approximation;
mod bake;
mod bench;
mod book;
mod bundled;
mod exits;
mod export;
mod faults;
mod gltf;
mod hostile;
mod irradiance;
mod misfits;
mod packages;
#[cfg(unix)]
mod recorder;
mod reference;
mod remote;
mod replay;
#[cfg(feature = "serve")]
mod report;
#[cfg(feature = "serve")]
mod serve;
mod shell;
mod skipped;
mod still;
mod stress;
mod support;
mod system;
mod textures;
mod tidy;
mod walk;
#[cfg(all(feature = "window", target_os = "linux"))]
mod window;
