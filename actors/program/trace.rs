//! `foveal trace`: this machine's cores for a walk elsewhere.

use std::io::Read;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::Args;
use foveal_actors::station::wire::Refusal;
use foveal_actors::station::{CREDITS_MAX, bits};
use foveal_engine::failure::Failure;
use foveal_engine::interrupt::interrupted;
use foveal_engine::opened::cache_folder;
use foveal_remote::guest::{Done, End, Host, Options, Progress as Stage, stay};
use foveal_remote::key::Invitation;
use foveal_remote::link::{self, GuestLink, Limited};
use foveal_terminal::arguments::bytes;
use foveal_terminal::print::{print_json, print_line};
use foveal_terminal::progress::Progress;
use serde_json::json;

use super::tracers;

/// Bytes a second with which somebody is still of use.
const LIMIT_LEAST: u64 = 10_000;
/// Time between two attempts to reach a walk, at first and at most.
const AGAIN: [Duration; 2] = [Duration::from_millis(250), Duration::from_secs(5)];

/// Arguments of `foveal trace`.
#[derive(Args, Debug)]
pub struct TraceArguments {
    /// What the walk printed, @FILE that contains it, or - for standard input
    ///
    /// Other users can read a command line, so prefer a file. The walk learns nothing of this machine but its
    /// answers; this machine sees the scene.
    #[arg(long, value_name = "KEY|@FILE|-")]
    join: String,
    /// Number of tracing threads (default: one per core)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..i64::from(CREDITS_MAX)))]
    cores: Option<u16>,
    /// Folder for received scenes (default: FOVEAL_CACHE, else the user's cache folder)
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
    /// Limit on the size of a scene
    #[arg(long, value_name = "SIZE", value_parser = bytes, default_value = "8GiB")]
    cache_size: u64,
    /// Limit on this process's memory; it leaves a walk that needs more
    #[arg(long, value_name = "SIZE", value_parser = bytes)]
    memory: Option<u64>,
    /// Limit on bytes per second to and from the walk, e.g. 10MB
    #[arg(long, value_name = "RATE", value_parser = bytes)]
    limit: Option<u64>,
    /// Name of this machine in the walk (default: its host name)
    #[arg(long)]
    name: Option<String>,
    /// Exit when the walk ends or does not answer, instead of waiting for the next one
    #[arg(long)]
    once: bool,
    /// Print one JSON document at the end
    #[arg(long)]
    json: bool,
}

/// Tells how far it is.
struct Teller {
    progress: Progress,
    bar: Option<Box<dyn Fn(u64)>>,
}

impl Host for Teller {
    fn leaves(&self) -> bool {
        interrupted()
    }

    fn progress(&mut self, stage: Stage) {
        match stage {
            Stage::Stocking { got, of } => {
                let begin = || {
                    let bar = self.progress.bar(of, "scene");
                    Box::new(move |got| if got < of { bar.set_position(got) } else { bar.finish_and_clear() })
                        as _
                };
                self.bar.get_or_insert_with(begin)(got);
            }
            Stage::Building => {
                self.bar = None;
                tracing::info!("the scene is here and made ready");
            }
            Stage::Ready => tracing::info!("tracing"),
        }
    }
}

fn invitation(text: &str) -> Result<Invitation, Failure> {
    if let Some(file) = text.strip_prefix('@') {
        return tracers::read(file.as_ref());
    }
    let mut given = text.to_owned();
    if text == "-" {
        given.clear();
        let read = std::io::stdin().take(4096).read_to_string(&mut given);
        read.map_err(|e| Failure::Input(format!("standard input: {e}")))?;
    }
    given.parse().map_err(Failure::Input)
}

/// What the system calls this machine.
fn host_name() -> String {
    let named = std::fs::read_to_string("/proc/sys/kernel/hostname").ok();
    let named =
        named.or_else(|| std::env::var("COMPUTERNAME").ok()).or_else(|| std::env::var("HOSTNAME").ok());
    named.map_or_else(|| "a machine".to_owned(), |name| name.trim().to_owned())
}

/// Runs the command.
pub fn run(a: &TraceArguments, progress: Progress) -> Result<(), Failure> {
    foveal_terminal::progress::end_on_interrupt();
    if a.limit.is_some_and(|limit| limit < LIMIT_LEAST) {
        return Err(Failure::Usage("--limit: at least 10kB a second".into()));
    }
    let invitation = invitation(&a.join)?;
    let folder = cache_folder(a.cache.as_deref())
        .ok_or_else(|| Failure::Environment("nowhere to keep scenes; set FOVEAL_CACHE or --cache".into()))?;
    let all = std::thread::available_parallelism().map_or(1, usize::from).min(CREDITS_MAX as usize - 1);
    let name: String = a.name.clone().unwrap_or_else(host_name).chars().take(30).collect();
    let options = Options {
        cores: a.cores.unwrap_or(all as u16),
        stock: folder.join("remote"),
        stock_bytes_max: a.cache_size,
        name,
        memory_max: a.memory,
        bits: bits::probe(),
    };
    // What scenes are made ready by, too, keeps to them. Who has threads already has been asked for nothing yet.
    let _ = rayon::ThreadPoolBuilder::new().num_threads(usize::from(options.cores)).build_global();
    let (mut done, mut wait, mut stays) = (Done::default(), AGAIN[0], 0_u32);
    let ended = loop {
        let attempt = match link::connect(&invitation) {
            Ok(link) => {
                let mut link: Box<dyn GuestLink> = match a.limit {
                    Some(bytes) => Box::new(Limited::new(link, bytes)),
                    None => link,
                };
                stays += 1;
                wait = AGAIN[0];
                let mut teller = Teller { progress, bar: None };
                stay(&mut *link, &options, &mut teller, &mut done)
            }
            Err(e) if a.once => break Err(Failure::Environment(e)),
            Err(e) => {
                tracing::info!("{e}");
                Ok(End::Gone)
            }
        };
        match attempt {
            Ok(End::Refused(why @ Refusal::TooSmall { .. })) => break Err(Failure::Limit(why.to_string())),
            Ok(End::Refused(why)) => break Err(Failure::Check(why.to_string())),
            Ok(End::Left) => {
                break Err(Failure::Interrupted("interrupted; the walk does the rest elsewhere".into()));
            }
            Ok(End::Farewell) if a.once => break Ok("farewell"),
            Ok(End::Gone) if a.once => break Ok("gone"),
            // What is too large for here stays so.
            Err(failure @ Failure::Limit(_)) => break Err(failure),
            Err(failure) if a.once => break Err(failure),
            Err(failure) => tracing::warn!("{failure}"),
            Ok(End::Farewell | End::Gone) => {}
        }
        let until = Instant::now() + wait;
        while Instant::now() < until && !interrupted() {
            std::thread::sleep(Duration::from_millis(20));
        }
        if interrupted() {
            break Err(Failure::Interrupted("interrupted while waiting for a walk".into()));
        }
        wait = (wait * 2).min(AGAIN[1]);
    };
    let document = json!({
        "schema": "foveal.trace/1",
        "cores": options.cores,
        "stays": stays,
        "jobs": done.jobs,
        "samples": done.samples,
        "busy_seconds": done.busy.as_secs_f64(),
        "joined_seconds": done.joined.map(|t| t.as_secs_f64()),
        "ended": ended.as_ref().ok(),
    });
    if a.json {
        print_json(&document);
    } else if ended.is_ok() || done.jobs > 0 {
        print_line(&format!("{} samples in {} jobs", done.samples, done.jobs));
    }
    ended.map(drop)
}
