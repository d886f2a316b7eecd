//! `foveal bench WHAT`: medians of repeated runs, each beside its aim and its peer, the machine named.

#![expect(clippy::disallowed_methods, reason = "outside of the actors, which it drives")]

mod deadlines;
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
    /// Each stage of a frame, compared with the figures of Haber 2001
    Stages(stages::StagesArguments),
    /// How fast the error of corrected pixels falls with each policy
    Error(error::ErrorArguments),
    /// Time from a loaded scene, and from the start of a process, to the first lit picture
    FirstLight(first_light::FirstLightArguments),
    /// Loading a glTF file compared with decoding its images, and its surfaces compared with plastic ones
    Gltf(gltf::GltfArguments),
    /// Rays per second (primary, diffuse bounce, shadow), compared with obvhs' own traversal
    Rays(rays::RaysArguments),
    /// All benchmarks that the book quotes, with a page of their results
    Report(report::ReportArguments),
    /// How time and memory of each stage grow with its input, and time with the number of tracers
    Scaling(scaling::ScalingArguments),
    /// Time to seek in a recording, and the size of the recording
    Seeks(seeks::SeeksArguments),
    /// A radiosity mesh simplified by a photometric and by a perceptual criterion, compared with the full mesh
    Simplify(simplify::SimplifyArguments),
    /// Serving to browsers: time from input to picture, bytes, and whether viewers slow the walk down
    #[cfg(feature = "serve")]
    Serve(serve::ServeArguments),
    /// What is saved when a scene does not need a part of the renderer
    Skips(skips::SkipsArguments),
    /// A long walk on a virtual clock: memory, lost jobs, frame times
    Soak(soak::SoakArguments),
    /// What a limit on texture memory costs, compared with other strategies
    Textures(textures::TexturesArguments),
    /// The window: time to the first picture, regularity of frames, cost of a still view, a frame on the adapter
    #[cfg(feature = "window")]
    Viewer(viewer::ViewerArguments),
    /// The cost of a message with and without recording, compared with peers if they are built in
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
