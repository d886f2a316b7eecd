//! The program `foveal`.

use std::process::ExitCode;

fn main() -> ExitCode {
    foveal_actors::cli::run()
}
