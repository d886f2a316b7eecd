//! `foveal bench WHAT`: medians of repeated runs, each beside its aim and its peer, the machine named.

#![expect(clippy::disallowed_methods, reason = "outside of the actors, which it drives")]

mod error;
mod error_curves;
mod error_light;
mod error_page;
mod error_paths;
mod error_plain;
mod error_plain_rows;
mod error_references;
mod error_walks;
mod first_light;
mod gltf;
mod illumination;
pub mod made;
mod mathematics;
mod messages;
#[cfg(feature = "window")]
mod motion;
mod rays;
mod remote;
mod remote_batch;
mod remote_soak;
mod report;
mod scaling;
mod seeks;
#[cfg(feature = "serve")]
mod serve;
mod simplify;
mod skips;
mod soak;
mod stages;
mod starts;
mod study;
mod texture_walks;
mod textures;
#[cfg(feature = "window")]
mod viewer;

use std::time::Instant;

use clap::Subcommand;

use foveal_engine::failure::Failure;
use foveal_terminal::progress::Progress;

/// What to measure.
#[derive(Debug, Subcommand)]
pub enum BenchCommand {
    /// Each stage of a frame, the first paper's figures beside it
    Stages(stages::StagesArguments),
    /// How fast the error of corrected pixels falls under each policy
    Error(error::ErrorArguments),
    /// From a loaded scene, and from the start of a process, to the first lit picture
    FirstLight(first_light::FirstLightArguments),
    /// What a glTF file's loading takes beside the decoding of its pictures, and its surfaces beside plastic ones
    Gltf(gltf::GltfArguments),
    /// Rays per second: primary, diffuse bounce, shadow; obvhs' own traversal beside it
    Rays(rays::RaysArguments),
    /// All that the book quotes, one after the other, and a page of what came of it
    Report(report::ReportArguments),
    /// How each stage grows with what it works on, and with tracers; memory beside it
    Scaling(scaling::ScalingArguments),
    /// How soon a moment of a recording is there, and what the recording takes
    Seeks(seeks::SeeksArguments),
    /// A radiosity mesh cut back by what is measured and by what is seen, views of it held against the whole mesh
    Simplify(simplify::SimplifyArguments),
    /// The browser's door: time from input to picture, bytes, and whether the walk notices its viewers
    #[cfg(feature = "serve")]
    Serve(serve::ServeArguments),
    /// What is saved by what a scene does not need
    Skips(skips::SkipsArguments),
    /// A walk of many frames on a virtual clock: memory, lost jobs, frame times
    Soak(soak::SoakArguments),
    /// What a limit on texture memory costs, beside what others do about it
    Textures(textures::TexturesArguments),
    /// The window: how soon it shows something, how evenly frames come, what a still view costs; a frame on the adapter
    #[cfg(feature = "window")]
    Viewer(viewer::ViewerArguments),
    /// What a message costs, with and without recording; peers beside it where they are built in
    Messages(messages::MessagesArguments),
}

/// Runs the command.
pub fn run(command: &BenchCommand, progress: Progress) -> Result<(), Failure> {
    match command {
        BenchCommand::Stages(a) => stages::run(a, progress),
        BenchCommand::Error(a) => error::run(a, progress),
        BenchCommand::FirstLight(a) => first_light::run(a, progress),
        BenchCommand::Gltf(a) => gltf::run(a, progress),
        BenchCommand::Rays(a) => rays::run(a, progress),
        BenchCommand::Report(a) => report::run(a, progress),
        BenchCommand::Scaling(a) => scaling::run(a, progress),
        BenchCommand::Seeks(a) => seeks::run(a, progress),
        BenchCommand::Simplify(a) => simplify::run(a, progress),
        #[cfg(feature = "serve")]
        BenchCommand::Serve(a) => serve::run(a, progress),
        BenchCommand::Skips(a) => skips::run(a, progress),
        BenchCommand::Soak(a) => soak::run(a, progress),
        BenchCommand::Textures(a) => textures::run(a, progress),
        #[cfg(feature = "window")]
        BenchCommand::Viewer(a) => viewer::run(a, progress),
        BenchCommand::Messages(a) => messages::run(a, progress),
    }
}

/// Milliseconds that `work` takes, and what it made.
pub fn timed<R>(work: impl FnOnce() -> R) -> (f64, R) {
    let start = Instant::now();
    let made = work();
    (start.elapsed().as_secs_f64() * 1e3, made)
}
