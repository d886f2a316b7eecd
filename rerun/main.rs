//! `foveal-rerun WALK.fvl OUT.rrd`: what `foveal replay --export rerun` runs.

#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a program")]

use std::io::BufWriter;
use std::path::PathBuf;
use std::process::ExitCode;

use atomic_write_file::AtomicWriteFile;
use clap::Parser;
use foveal_engine::Failure;
use foveal_engine::replay::Source;
use foveal_rerun::{Written, write};
use foveal_terminal::light::ElsewhereArguments;
use foveal_terminal::progress::end_on_interrupt;

/// Writes a recorded walk of foveal as a file for the viewer of rerun
#[derive(Parser)]
#[command(name = "foveal-rerun", version)]
struct Arguments {
    /// A recording that `foveal walk --record` made
    trace: PathBuf,
    /// The file to write, as walk.rrd
    out: PathBuf,
    #[command(flatten)]
    elsewhere: ElsewhereArguments,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    end_on_interrupt();
    match run(&arguments) {
        Ok(Written { frames, views, numbers }) => {
            println!("{frames} frames, {views} views, {numbers} numbers of actors");
            ExitCode::SUCCESS
        }
        Err(failure) => {
            eprintln!("foveal-rerun: {failure}");
            ExitCode::from(failure.exit_code())
        }
    }
}

fn run(a: &Arguments) -> Result<Written, Failure> {
    let source = Source::open(&a.trace, &a.elsewhere.files(), false, &())?;
    let cannot = |e: std::io::Error| Failure::Environment(format!("{}: {e}", a.out.display()));
    // There is a whole file at the end, or what was there before.
    let mut file = AtomicWriteFile::open(&a.out).map_err(cannot)?;
    let written = write(&source, BufWriter::new(&mut file))?;
    file.commit().map_err(cannot)?;
    Ok(written)
}
