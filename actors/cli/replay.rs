//! `foveal replay`: a recorded run again, on any number of threads, compared message by message.

use std::path::PathBuf;
use std::sync::Arc;

use clap::{Args, ValueEnum};
use crossbeam_queue::SegQueue;
use foveal_runtime::{
    ActorId, Config, Delivery, Divergence, Hashing, Limit, Mode, Observer, ReplayReport, Runtime, Trace,
    Until,
};
use serde_json::{Value, json};

use super::Progress;
use super::failure::Failure;
use super::output::{png_bytes, print_json, print_line, write_atomic};
use super::recording::{Elsewhere, RecordedRun, open_trace};
use super::session::{end_on_interrupt, interrupted};
use crate::message::FrameSnapshot;
use crate::renderer::{FrameCounts, FrameSink, MARK_FRAME, Renderer};
use crate::stages::StageTimes;
use crate::wiring::{Parts, wire};

/// Turns that a profile keeps of each actor.
const PROFILED_TURNS: usize = 1 << 16;

/// Arguments of `foveal replay`.
#[derive(Args, Debug)]
pub struct ReplayArguments {
    /// A recording that --record made
    trace: PathBuf,
    /// Refuse a recording without hashes, whose messages cannot be compared
    #[arg(long)]
    verify: bool,
    /// Number of threads (default: one per core); the outcome is the same with any
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=64))]
    workers: Option<u32>,
    /// Stop when this frame was shown, or after this delivery of an actor
    #[arg(long, value_name = "FRAME|ACTOR:INDEX")]
    until: Option<String>,
    /// Write this frame's picture to --out
    #[arg(long, value_name = "FRAME", requires = "out", conflicts_with = "until")]
    show: Option<u32>,
    /// Where --show writes the picture
    #[arg(long, value_name = "PNG", requires = "show")]
    out: Option<PathBuf>,
    /// Say what was delivered to this actor
    #[arg(long, value_name = "NAME")]
    actor: Option<String>,
    /// Write a profile of the replay's turns, for chrome://tracing or Perfetto
    #[arg(long, num_args = 2, value_names = ["FORMAT", "FILE"])]
    export: Option<Vec<String>>,
    /// The scene the walk was recorded in, where it has moved
    #[arg(long, value_name = "FILE")]
    scene: Option<PathBuf>,
    #[command(flatten)]
    elsewhere: Elsewhere,
    /// One JSON document
    #[arg(long)]
    json: bool,
}

/// Formats of a profile; Perfetto reads Chrome's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    Chrome,
    Perfetto,
}

/// Shows nothing: replay leaves the world alone.
pub struct Unseen;

impl FrameSink for Unseen {
    fn frame_shown(&mut self, _snapshot: &Arc<FrameSnapshot>, _counts: FrameCounts, _renderer: &Renderer) {}
}

/// A delivery to the actor that was asked about.
struct Seen {
    index: u64,
    from: ActorId,
    kind: &'static str,
    chain: u64,
}

/// Runs the command.
pub fn run(a: &ReplayArguments, progress: Progress) -> Result<(), Failure> {
    end_on_interrupt();
    let export = a.export.as_deref().map(export_file).transpose()?;
    let trace = Arc::new(open_trace(&a.trace)?);
    let recorded = RecordedRun::of(&trace, &a.trace)?;
    if a.verify && trace.header().hashing == Hashing::Off {
        return Err(Failure::Input(format!(
            "{}: recorded without hashes; it cannot be verified",
            a.trace.display()
        )));
    }
    let until = match (a.show, &a.until) {
        (Some(frame), _) => Some(frame_shown(frame)),
        (None, Some(until)) => Some(parse_until(until, &trace)?),
        (None, None) => None,
    };
    let asked = a.actor.as_deref().map(|name| actor(name, &trace)).transpose()?;
    let session = recorded.open(&a.trace, a.scene.as_deref(), &a.elsewhere, progress)?;

    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let workers = a.workers.map_or(cores, |w| w as usize).min(64);
    let seen = Arc::new(SegQueue::new());
    let config = Config {
        mode: Mode::Replay { trace: Arc::clone(&trace), until },
        observer: asked.map(|asked| observe(asked, &seen)),
        ring_turns: if export.is_some() { PROFILED_TURNS } else { Config::live(0).ring_turns },
        ..Config::live(workers)
    };
    let parts = Parts {
        settings: recorded.settings,
        world: session.world.clone(),
        passes: recorded.passes(),
        corrects: recorded.corrects,
        stages: StageTimes::default(),
        sink: Box::new(Unseen),
    };
    let (mut runtime, actors) = Runtime::build(config, |w| wire(w, parts))
        .map_err(|e| Failure::Input(format!("{}: {e}", a.trace.display())))?;
    let build = &trace.header().build;
    tracing::info!("recorded by {} ({build})", recorded.program);
    runtime.pump_until(Limit::IDLE, |_| interrupted());
    if interrupted() {
        return Err(Failure::Interrupted("interrupted while replaying".into()));
    }
    let report = runtime.replay_report();
    let shown = runtime.inspect(actors.renderer, |r| r.shown().cloned()).flatten();
    let frames = shown.as_ref().map_or(0, |s| s.index.0 + 1);

    if let Some(asked) = asked {
        let lines = std::iter::from_fn(|| seen.pop());
        lines.filter(|_| !a.json).for_each(|s| print_line(&seen_line(asked, &s, &trace)));
    }
    if let (Some(frame), Some(out)) = (a.show, &a.out) {
        match shown.as_ref().filter(|s| s.index.0 == frame) {
            Some(snapshot) => {
                let picture = &snapshot.rgb8;
                let bytes = png_bytes(
                    picture.width() as u32,
                    picture.height() as u32,
                    picture.data().as_flattened(),
                )?;
                write_atomic(out, &bytes)?;
            }
            None if report.divergence.is_none() => {
                return Err(Failure::Usage(format!("no frame {frame}; the recording shows {frames}")));
            }
            None => {}
        }
    }
    if let Some(file) = &export {
        write_atomic(file, runtime.chrome_trace().as_bytes())?;
    }
    // Where the replay was to stop before the end, all that was asked for is there.
    let complete = report.complete || until.is_some() && trace.complete() && report.divergence.is_none();
    let document = document(&report, &trace, frames, workers, complete);
    if a.json {
        print_json(&document);
    } else {
        summary(&report, frames, workers, complete);
    }
    match &report.divergence {
        None => Ok(()),
        Some(divergence) => Err(Failure::Check(format!("the replay diverges: {divergence}"))),
    }
}

fn frame_shown(frame: u32) -> Until {
    Until::Mark { kind: MARK_FRAME, count: u64::from(frame) + 1 }
}

/// `FRAME` or `ACTOR:INDEX`, the actor by name or number.
fn parse_until(text: &str, trace: &Trace) -> Result<Until, Failure> {
    if let Ok(frame) = text.parse::<u32>() {
        return Ok(frame_shown(frame));
    }
    let wrong =
        || Failure::Usage(format!("--until {text}: a frame number, or an actor and an index as renderer:12"));
    let (name, index) = text.rsplit_once(':').ok_or_else(wrong)?;
    Ok(Until::Delivery { actor: actor(name, trace)?, index: index.parse().map_err(|_| wrong())? })
}

fn actor(name: &str, trace: &Trace) -> Result<ActorId, Failure> {
    let nodes = &trace.header().nodes;
    let by_number = || {
        let number = name.strip_prefix('#').unwrap_or(name).parse::<u32>().ok()?;
        ((number as usize) < nodes.len()).then_some(ActorId(number))
    };
    trace.find(name).or_else(by_number).ok_or_else(|| {
        let names: Vec<&str> = nodes.iter().filter(|n| n.class.is_some()).map(|n| n.name.as_str()).collect();
        Failure::Usage(format!("no actor \"{name}\"; the recording has {}", names.join(", ")))
    })
}

fn export_file(export: &[String]) -> Result<PathBuf, Failure> {
    let [format, file] = export else {
        return Err(Failure::Usage("--export takes a format and a file".into()));
    };
    Format::from_str(format, true)
        .map_err(|_| Failure::Usage(format!("--export {format}: chrome or perfetto")))?;
    Ok(PathBuf::from(file))
}

fn observe(asked: ActorId, seen: &Arc<SegQueue<Seen>>) -> Observer {
    let seen = Arc::clone(seen);
    Arc::new(move |d: &Delivery<'_>| {
        if d.actor == asked {
            seen.push(Seen { index: d.index, from: d.from, kind: d.kind, chain: d.chain });
        }
    })
}

fn name(trace: &Trace, id: ActorId) -> &str {
    trace.header().nodes.get(id.0 as usize).map_or("?", |node| node.name.as_str())
}

fn seen_line(asked: ActorId, s: &Seen, trace: &Trace) -> String {
    let from = if s.from == asked { "itself" } else { name(trace, s.from) };
    format!("{:>8}  {:<16} from {from:<12} {:016x}", s.index, s.kind, s.chain)
}

fn document(report: &ReplayReport, trace: &Trace, frames: u32, workers: usize, complete: bool) -> Value {
    let diverged = |d: &Divergence| {
        json!({
            "actor": d.name,
            "index": d.index,
            "frame": frames,
            "message": d.kind,
            "from": d.from.map(|from| name(trace, from)),
            "expected": d.expected,
            "found": d.found,
            "turns": d.turns.iter().map(|t| json!({
                "index": t.index, "message": t.kind, "from": name(trace, t.from), "lane": t.lane,
            })).collect::<Vec<_>>(),
        })
    };
    json!({
        "schema": "foveal.replay/1",
        "frames": frames,
        "messages": report.deliveries,
        "recorded": report.recorded,
        "workers": workers,
        "diverged": report.divergence.as_ref().map(diverged),
        "complete": complete,
        "damage": trace.damage().map(|cut| json!({"offset": cut.offset, "reason": cut.reason})),
    })
}

fn summary(report: &ReplayReport, frames: u32, workers: usize, complete: bool) {
    if report.divergence.is_some() {
        return;
    }
    let end = if complete { "" } else { "; the recording ends early" };
    print_line(&format!(
        "{frames} frames, {} messages on {workers} threads: each as recorded{end}",
        report.deliveries
    ));
}
