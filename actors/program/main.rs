//! The program `foveal`: arguments in, results and exit codes out. All that it does, `foveal_engine` does.

#![expect(clippy::disallowed_methods, reason = "outside of the actors, which it drives")]

mod bake;
mod compare;
mod doctor;
#[cfg(any(feature = "serve", feature = "window"))]
mod doors;
mod explain;
mod figures;
#[cfg(any(feature = "serve", feature = "window"))]
mod interactive;
mod log;
mod pictures;
mod reference;
mod replay;
#[cfg(feature = "serve")]
mod serve;
mod shell;
mod simulate;
mod texture_page;
mod trace;
mod tracers;
#[cfg(feature = "window")]
mod view;
mod walk;
mod walk_report;

use std::process::ExitCode;

use clap::{Parser, Subcommand, ValueEnum};
use tracing_subscriber::Layer;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

use foveal_engine::failure::Failure;
use foveal_terminal::progress::Progress;

/// Walk through lit scenes at interactive frame rates, with rays spent where the eye looks.
#[derive(Debug, Parser)]
#[command(name = "foveal", version, max_term_width = 100, arg_required_else_help = true)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Print more messages (-v: decisions, -vv: every turn)
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    verbose: u8,
    /// Print errors only, without progress
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    quiet: bool,
    /// Whether to colour messages
    #[arg(long, global = true, value_enum, default_value_t = ColorChoice::Auto)]
    color: ColorChoice,
}

/// When messages are coloured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ColorChoice {
    /// On a terminal, unless NO_COLOR is set.
    Auto,
    /// Always.
    Always,
    /// Never.
    Never,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Walk through a scene in a window
    #[cfg(feature = "window")]
    View(Box<view::ViewArguments>),
    /// Serve a walk to browsers and print its address
    #[cfg(feature = "serve")]
    Serve(Box<serve::ServeArguments>),
    /// Walk along a camera path without a window and write pictures and a report
    Walk(walk::WalkArguments),
    /// Precompute the view-independent illumination and cache it
    Bake(bake::BakeArguments),
    /// Render a reference: what a still view converges to, or a path-traced picture
    Reference(reference::ReferenceArguments),
    /// Lend this machine's cores to a walk, reference or bake on another machine (its --tracers)
    Trace(trace::TraceArguments),
    /// Replay a recording on any number of threads, compare every message, and answer questions about it
    Replay(replay::ReplayArguments),
    /// Run walks on one thread under seeded schedules and faults
    Simulate(simulate::SimulateArguments),
    /// Check, summarise or repair a recording
    Log(log::LogArguments),
    /// Compare two pictures: FLIP, PSNR, relMSE
    Compare(compare::CompareArguments),
    /// List what a scene needs, what is skipped, and why
    Explain(explain::ExplainArguments),
    /// Run a benchmark: medians, with targets and comparisons
    #[command(subcommand)]
    Bench(foveal_bench::BenchCommand),
    /// Print completions for a shell
    Completions(shell::CompletionsArguments),
    /// Write manual pages
    Man(shell::ManArguments),
    /// Report what this machine offers
    Doctor(doctor::DoctorArguments),
}

impl Command {
    /// Whether somebody waits for its frames, or it measures what these cost.
    fn shows(&self) -> bool {
        match self {
            #[cfg(feature = "window")]
            Self::View(_) => true,
            #[cfg(feature = "serve")]
            Self::Serve(_) => true,
            Self::Walk(_) | Self::Replay(_) | Self::Bench(_) => true,
            Self::Bake(_) | Self::Reference(_) | Self::Trace(_) | Self::Simulate(_) | Self::Log(_) => false,
            Self::Compare(_) | Self::Explain(_) | Self::Completions(_) | Self::Man(_) | Self::Doctor(_) => {
                false
            }
        }
    }
}

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(e) => {
            let _ = e.print();
            return ExitCode::from(if e.use_stderr() { 2 } else { 0 });
        }
    };
    log_to_stderr(&cli);
    if cli.command.shows() {
        // Before any other thread is there, so that all have it.
        foveal_runtime::be_prompt();
    }
    let progress = Progress { shown: !cli.quiet && std::io::IsTerminal::is_terminal(&std::io::stderr()) };
    let result = match cli.command {
        #[cfg(feature = "window")]
        Command::View(a) => view::run(*a, progress),
        #[cfg(feature = "serve")]
        Command::Serve(a) => serve::run(&a, progress),
        Command::Walk(a) => walk::run(&a, progress),
        Command::Bake(a) => bake::run(&a, progress),
        Command::Reference(a) => reference::run(&a, progress),
        Command::Trace(a) => trace::run(&a, progress),
        Command::Replay(a) => replay::run(&a, progress),
        Command::Simulate(a) => simulate::run(&a, progress),
        Command::Log(a) => log::run(&a),
        Command::Compare(a) => compare::run(&a),
        Command::Explain(a) => explain::run(&a),
        Command::Bench(c) => foveal_bench::run(&c, progress),
        Command::Completions(a) => shell::completions(&a),
        Command::Man(a) => shell::man(&a),
        Command::Doctor(a) => doctor::run(&a),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            report_failure(&failure);
            ExitCode::from(failure.exit_code())
        }
    }
}

#[expect(clippy::print_stderr, reason = "the one message of a failure")]
fn report_failure(failure: &Failure) {
    eprintln!("foveal: {failure}");
}

fn log_to_stderr(cli: &Cli) {
    let default = match (cli.quiet, cli.verbose) {
        (true, _) => "error",
        (_, 0) => "warn",
        (_, 1) => {
            "foveal=info,foveal_actors=info,foveal_engine=info,foveal_remote=info,foveal_runtime=info,foveal_serve=info,foveal_window=info"
        }
        _ => {
            "foveal=debug,foveal_actors=debug,foveal_engine=debug,foveal_remote=debug,foveal_runtime=debug,foveal_serve=debug,foveal_window=debug"
        }
    };
    // As `info`, or `foveal_engine=debug,foveal_runtime=trace`.
    let asked = std::env::var("FOVEAL_LOG").ok().and_then(|asked| asked.parse::<Targets>().ok());
    let filter = asked.or_else(|| default.parse().ok()).unwrap_or_default();
    let colored = match cli.color {
        ColorChoice::Always => true,
        ColorChoice::Never => false,
        ColorChoice::Auto => {
            std::env::var_os("NO_COLOR").is_none() && std::io::IsTerminal::is_terminal(&std::io::stderr())
        }
    };
    let messages = tracing_subscriber::fmt::layer()
        .with_writer(std::io::stderr)
        .with_ansi(colored)
        .with_target(false)
        .without_time()
        .with_filter(filter);
    let listeners = tracing_subscriber::registry().with(messages);
    #[cfg(feature = "tracy")]
    let listeners =
        listeners.with(tracing_tracy::TracyLayer::default().with_filter(Targets::new().with_targets(
            ["foveal", "foveal_actors", "foveal_runtime"].map(|t| (t, tracing::Level::TRACE)),
        )));
    listeners.init();
}
