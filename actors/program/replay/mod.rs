//! `foveal replay`: a recorded run again, on any number of threads, compared message by message, stepped through in both
//! directions, and taken apart.

mod diff;
mod export;
mod look;
mod recorded;
mod step;
#[cfg(feature = "window")]
mod view;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Args;
use crossbeam_queue::SegQueue;
use foveal::image::Map2d;
use foveal_engine::Failure;
use foveal_engine::files::{png_bytes, write_atomic};
use foveal_engine::replay::{How, Source, Telling, diverged, drawn_over, late, observe, ring_turns, why};
#[cfg(feature = "serve")]
use foveal_engine::{replay::Player, source::FrameSource};
use foveal_runtime::{Delivery, Divergence, ReplayReport};
use foveal_terminal::light::ElsewhereArguments;
use foveal_terminal::print::{print_json, print_line};
use foveal_terminal::progress::{Progress, end_on_interrupt};
use serde_json::{Value, json};

/// A timeline as the bytes of a file, in the format that its name asks for.
pub fn profile(timeline: &foveal_runtime::Timeline, file: &std::path::Path) -> Vec<u8> {
    let perfetto = file.extension().is_some_and(|e| e == "pftrace" || e == "perfetto-trace");
    export::encode(if perfetto { export::Format::Perfetto } else { export::Format::Chrome }, timeline)
}

/// Arguments of `foveal replay`.
#[derive(Args, Debug)]
pub struct ReplayArguments {
    /// A recording that --record made
    #[arg(required_unless_present = "diff")]
    trace: Option<PathBuf>,
    /// Refuse a recording without hashes, whose messages cannot be compared
    #[arg(long)]
    verify: bool,
    /// Number of threads (default: one per core); the outcome is the same with any
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=64))]
    workers: Option<u32>,
    /// Stop when this frame was shown, or after this delivery of an actor
    #[arg(long, value_name = "FRAME|ACTOR:INDEX")]
    until: Option<String>,
    /// Read commands: step forward and back through the deliveries, from --until or the start; h lists them
    #[arg(long)]
    step: bool,
    /// Leave snapshots all along it, so that every moment of it is reached at once from now on
    #[arg(long, conflicts_with_all = ["verify", "until", "step", "show", "why", "actor", "export"])]
    index: bool,
    /// Take this many deliveries back from --until or the end, and say which
    #[arg(long, value_name = "N", num_args = 0..=1, default_missing_value = "1", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    back: Option<u32>,
    /// Show it in a window: a timeline to scrub, step and play, a click on a pixel for its story, and a walk on from there
    #[cfg(feature = "window")]
    #[arg(long, conflicts_with_all = ["verify", "until", "step", "back", "show", "why", "actor", "export", "json"])]
    view: bool,
    /// Another recording, shown beside it at the same frame, with the first frame marked that differs
    #[cfg(feature = "window")]
    #[arg(long, value_name = "FVL", requires = "view")]
    beside: Option<PathBuf>,
    /// Record walks that leave it into this file; they name this recording and the frame
    #[cfg(feature = "window")]
    #[arg(long, value_name = "FVL", requires = "view")]
    record: Option<PathBuf>,
    /// Show it in a browser: the same timeline and stories, at this address
    #[cfg(feature = "serve")]
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, require_equals = true, default_missing_value = "127.0.0.1:8080", conflicts_with_all = ["verify", "until", "step", "back", "show", "why", "actor", "export"])]
    serve: Option<std::net::SocketAddr>,
    /// Folder for its screenshots (F12)
    #[cfg(feature = "window")]
    #[arg(long, value_name = "DIR", default_value = ".", requires = "view")]
    screenshots: PathBuf,
    /// Write this frame's picture to --out
    #[arg(long, value_name = "FRAME", requires = "out", conflicts_with = "until")]
    show: Option<u32>,
    /// Where --show writes the picture, and --path draws it over the picture
    #[arg(long, value_name = "PNG")]
    out: Option<PathBuf>,
    /// With --why: trace the sample's whole path again: surfaces, lobes, random numbers and what each adds
    #[arg(long, requires = "why")]
    path: bool,
    /// Why this pixel of --frame looks as it does: the chain from input to sample
    #[arg(long, value_name = "X,Y", value_parser = pixel)]
    why: Option<(u32, u32)>,
    /// The frame that --why looks at (default: the last)
    #[arg(long, requires = "why")]
    frame: Option<u32>,
    /// Why this frame took as long as it did: what each thread did, the chain that it waited for, what of it would have had
    /// to be faster
    #[arg(long, value_name = "FRAME")]
    why_late: Option<u32>,
    /// Say what was delivered to this actor
    #[arg(long, value_name = "NAME")]
    actor: Option<String>,
    /// Tell this actor's state, at --at or the end
    #[arg(long, value_name = "ACTOR")]
    state: Option<String>,
    /// Where --state looks
    #[arg(long, value_name = "FRAME|ACTOR:INDEX", requires = "state")]
    at: Option<String>,
    /// What changed between two places, in the state of --state or of all actors
    #[arg(long, num_args = 2, value_names = ["A", "B"], conflicts_with = "at")]
    state_diff: Option<Vec<String>>,
    /// Where this comes about: `ACTOR.PATH < 3`, `ACTOR.PATH changes`, `ACTOR hears MESSAGE [PATH > 3]`, `pixel X,Y changes`,
    /// `object "NAME" loses samples`; --state shows which paths there are
    #[arg(long, value_name = "CONDITION")]
    when: Option<String>,
    /// Which of the places where --when comes about
    #[arg(long, value_name = "WHICH", default_value = "all", requires = "when")]
    which: look::Which,
    /// Write every delivery of the replay, with arrows from input to job to pixel: for chrome://tracing, or Perfetto's
    /// own format
    #[arg(long, num_args = 2, value_names = ["chrome|perfetto", "FILE"])]
    export: Option<Vec<String>>,
    /// Where the replay diverges: the program that recorded it, which says what was recorded there
    #[arg(long, value_name = "PROGRAM")]
    with: Option<PathBuf>,
    /// The first message at which two recordings part
    #[arg(long, num_args = 2, value_names = ["A", "B"], conflicts_with_all = ["trace", "until", "show", "step", "back", "why", "export", "actor"])]
    diff: Option<Vec<PathBuf>>,
    #[command(flatten)]
    elsewhere: ElsewhereArguments,
    /// One JSON document
    #[arg(long)]
    json: bool,
}

pub fn pixel(text: &str) -> Result<(u32, u32), String> {
    let wrong = || format!("`{text}` is no pixel; write it as 30,20");
    let (x, y) = text.split_once(',').ok_or_else(wrong)?;
    Ok((x.trim().parse().map_err(|_| wrong())?, y.trim().parse().map_err(|_| wrong())?))
}

/// Runs the command.
pub fn run(a: &ReplayArguments, progress: Progress) -> Result<(), Failure> {
    end_on_interrupt();
    if let Some([left, right]) = a.diff.as_deref() {
        return diff::run(left, right, &a.elsewhere.files(), a.json, progress);
    }
    let export = a.export.as_deref().map(export::parse).transpose()?;
    let Some(path) = &a.trace else { return Err(Failure::Usage("which recording?".into())) };
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let workers = a.workers.map_or(cores, |w| w as usize).min(64);
    #[cfg(feature = "window")]
    if a.view {
        return view::run(a, path.clone(), workers);
    }
    #[cfg(feature = "serve")]
    if let Some(listen) = a.serve {
        let (path, elsewhere) = (path.clone(), a.elsewhere.files());
        let make = move |_| {
            let source = Source::open(&path, &elsewhere, false, &())?;
            Ok((Box::new(Player::new(source, workers)?) as Box<dyn FrameSource>).into())
        };
        return super::serve::recording(listen, Arc::new(make), a.json);
    }
    let source = Source::open(path, &a.elsewhere.files(), a.verify, &progress.baking())?;
    if a.index {
        return match source.indexing().go_on(&source, || false) {
            true => Err(Failure::Interrupted("interrupted; snapshots so far are kept".into())),
            false => Ok(()),
        };
    }
    if a.out.is_some() && a.show.is_none() && a.why.is_none() {
        return Err(Failure::Usage("--out is where --show and --why draw".into()));
    }
    if let Some(pixel) = a.why {
        let explained = why::explain(&source, pixel, a.frame, a.path, workers)?;
        if let Some(out) = &a.out {
            write_picture(out, &drawn_over(&explained.picture, &explained.segments, pixel))?;
        }
        match a.json {
            true => print_json(&explained.document),
            false => why::told(&explained.document).iter().for_each(|line| print_line(line)),
        }
        return Ok(());
    }
    if let Some(frame) = a.why_late {
        let document = late::explain(&source, frame, workers)?;
        match a.json {
            true => print_json(&document),
            false => late::told(&document).iter().for_each(|line| print_line(line)),
        }
        return Ok(());
    }
    let telling = if a.json { Telling::Json } else { Telling::Text };
    if let Some(condition) = &a.when {
        return look::when_met(&source, condition, a.which, a.until.as_deref(), workers, a.json);
    }
    if let Some([from, to]) = a.state_diff.as_deref() {
        return look::difference(&source, a.state.as_deref(), [from, to], workers, a.json);
    }
    if let Some(actor) = &a.state {
        return look::state(&source, actor, a.at.as_deref(), workers, telling);
    }
    if a.step || a.back.is_some() {
        return step::run(source, a.until.as_deref(), a.back, a.step, workers, telling);
    }
    verify(a, &source, workers, export)
}

fn verify(
    a: &ReplayArguments,
    source: &Source,
    workers: usize,
    export: Option<(export::Format, PathBuf)>,
) -> Result<(), Failure> {
    let until = match (a.show, &a.until) {
        (Some(frame), _) => Some(source.frame_shown(frame)?),
        (None, Some(until)) => Some(source.place(until)?),
        (None, None) => None,
    };
    let asked = a.actor.as_deref().map(|name| source.actor(name)).transpose()?;
    let seen = Arc::new(SegQueue::new());
    let all = export.is_some();
    // A profile has no room for what messages say.
    let telling = match (all, a.json) {
        (true, _) => Telling::Nothing,
        (false, true) => Telling::Json,
        (false, false) => Telling::Text,
    };
    let wanted = move |d: &Delivery<'_>| all || Some(d.actor) == asked;
    let observer = (all || asked.is_some()).then(|| observe(&seen, telling, wanted));
    // Whoever wants to see all deliveries, or to be sure of all, begins at the start.
    let jump = until.is_some() && observer.is_none() && !a.verify;
    let mut how = How { threads: workers, until, observer, jump, ..How::default() };
    if all {
        // One delivery a turn, and all of them kept: so each has its time.
        how.turn = Some(1);
        how.ring_turns = Some(ring_turns(&source.trace));
    }
    tracing::info!("recorded by {}", source.trace.header().fingerprint);
    let (mut runtime, actors) = source.run(how, |_| ())?;
    let report = runtime.replay_report();
    let shown = runtime.inspect(actors.renderer, |r| r.shown().cloned()).flatten();
    let frames = shown.as_ref().map_or(0, |s| s.index.0 + 1);

    let seen: Vec<_> = std::iter::from_fn(|| seen.pop()).collect();
    if let (Some(asked), false) = (asked, a.json) {
        for s in seen.iter().filter(|s| s.actor == asked) {
            print_line(&source.line(s));
            s.told.iter().for_each(|told| print_line(&format!("    {told}")));
        }
    }
    if let (Some(frame), Some(out)) = (a.show, &a.out)
        && let Some(snapshot) = shown.as_ref().filter(|s| s.index.0 == frame)
    {
        write_picture(out, &snapshot.rgb8)?;
    }
    if let Some((format, file)) = export {
        write_atomic(&file, &export::bytes(format, source, &runtime, &seen))?;
    }
    // Where the replay was to stop before the end, all that was asked for is there.
    let complete =
        report.complete || until.is_some() && source.trace.complete() && report.divergence.is_none();
    let mut document = document(&report, source, frames, workers, complete);
    let looked = report.divergence.as_ref().map(|d| diverged::look_at(source, d, workers)).transpose()?;
    if let Some(found) = looked.flatten() {
        if a.json {
            let differs = found.differs.iter().map(|d| json!({"path": d.path, "a": d.left, "b": d.right}));
            document["diverged"]["says"] = json!(found.says);
            document["diverged"]["state"] = json!(found.state);
            document["diverged"]["answers"] = found
                .answers
                .iter()
                .map(|said| json!({"to": source.name(said.to), "message": said.kind, "says": said.says}))
                .collect();
            document["diverged"]["replays_differ"] = differs.collect();
        } else {
            print_line(&format!("there it says {}", found.says));
            for said in &found.answers {
                print_line(&format!(
                    "and is answered by {} to {}: {}",
                    said.kind,
                    source.name(said.to),
                    said.says
                ));
            }
            match found.differs.is_empty() {
                true => print_line(
                    "two more replays say the same there: this program says something else than that one did",
                ),
                false => print_line(
                    "two more replays differ there, so it depends on something that is no message:",
                ),
            }
            found
                .differs
                .iter()
                .for_each(|d| print_line(&format!("  {}: {} and {}", d.path, d.left, d.right)));
        }
    }
    if let (Some(program), Some(divergence)) = (&a.with, &report.divergence) {
        let others = recorded::others(program, source, divergence, &divergence.said)?;
        if a.json {
            let others = others.iter();
            document["diverged"]["recorded_differs"] =
                others.map(|o| json!({"path": o.path, "recorded": o.recorded, "here": o.here})).collect();
        } else {
            for o in &others {
                print_line(&format!("  {}: recorded {}, here {}", o.path, o.recorded, o.here));
            }
        }
    }
    if let Some(asked) = asked {
        document["deliveries"] =
            seen.iter().filter(|s| s.actor == asked).map(|s| source.document(s)).collect();
    }
    if a.json {
        print_json(&document);
    } else {
        summary(&report, frames, workers, complete);
    }
    match &report.divergence {
        None => Ok(()),
        Some(divergence) => Err(Failure::Check(match &report.foreign {
            None => format!("the replay diverges: {divergence}"),
            Some(foreign) => format!(
                "{}: recorded elsewhere, where results have other bits: {foreign}; first at {divergence}",
                source.path.display()
            ),
        })),
    }
}

fn write_picture(out: &Path, picture: &Map2d<[u8; 3]>) -> Result<(), Failure> {
    let (width, height) = (picture.width() as u32, picture.height() as u32);
    write_atomic(out, &png_bytes(width, height, picture.data().as_flattened())?)
}

fn document(report: &ReplayReport, source: &Source, frames: u32, workers: usize, complete: bool) -> Value {
    let diverged = |d: &Divergence| {
        json!({
            "actor": d.name,
            "index": d.index,
            "frame": frames,
            "message": d.kind,
            "from": d.from.map(|from| source.name(from)),
            "expected": d.expected,
            "found": d.found,
            "turns": d.turns.iter().map(|t| json!({
                "index": t.index, "message": t.kind, "from": source.name(t.from), "lane": t.lane,
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
        "foreign": report.foreign,
        "complete": complete,
        "damage": source.trace.damage().map(|cut| json!({"offset": cut.offset, "reason": cut.reason})),
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
