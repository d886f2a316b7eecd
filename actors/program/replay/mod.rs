//! `foveal replay`: a recorded run again, on any number of threads, compared message by message, stepped through in both
//! directions, and taken apart.

mod diff;
mod export;
mod look;
mod recorded;
mod rerun;
mod step;
mod verify;
#[cfg(feature = "window")]
mod view;

use std::path::{Path, PathBuf};
#[cfg(feature = "serve")]
use std::sync::Arc;

use clap::Args;
use foveal::image::Map2d;
use foveal_engine::Failure;
use foveal_engine::files::{png_bytes, write_atomic};
use foveal_engine::replay::{Source, Telling, drawn_over, late, why};
#[cfg(feature = "serve")]
use foveal_engine::{replay::Player, source::FrameSource};
use foveal_terminal::light::ElsewhereArguments;
use foveal_terminal::print::{print_json, print_line};
use foveal_terminal::progress::{Progress, end_on_interrupt};

/// A timeline as the bytes of a file, in the format that its name asks for.
pub fn profile(timeline: &foveal_runtime::Timeline, file: &std::path::Path) -> Vec<u8> {
    let perfetto = file.extension().is_some_and(|e| e == "pftrace" || e == "perfetto-trace");
    export::encode(if perfetto { export::Format::Perfetto } else { export::Format::Chrome }, timeline)
}

/// What goes with a replay to its end or to a place, and with nothing that is answered by itself.
const ON_THE_WAY: [&str; 5] = ["verify", "show", "actor", "export", "with"];
/// What is answered by itself.
const QUESTIONS: [&str; 9] =
    ["step", "back", "why", "why_late", "state", "state_diff", "said", "when", "diff"];

/// Questions behind one of them: a conflict is said once of two arguments.
fn behind(question: &str) -> impl Iterator<Item = &'static str> {
    QUESTIONS.into_iter().skip_while(move |other| *other != question).skip(1)
}

/// Arguments of `foveal replay`.
#[derive(Args, Debug)]
pub struct ReplayArguments {
    /// Recording made with --record
    #[arg(required_unless_present = "diff")]
    trace: Option<PathBuf>,
    /// Refuse a recording without hashes, whose messages cannot be compared
    #[arg(long)]
    verify: bool,
    /// Number of threads (default: one per core); the result is the same with any number
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=64))]
    workers: Option<u32>,
    /// Stop once this frame has been shown, or after this delivery to an actor
    #[arg(long, value_name = "FRAME|ACTOR:INDEX", conflicts_with_all = ["why", "why_late", "state", "state_diff", "said", "diff"])]
    until: Option<String>,
    /// Read commands that step forward and back through the deliveries, from --until or the start; h lists them
    #[arg(long, conflicts_with_all = ON_THE_WAY, conflicts_with_all = behind("back"))]
    step: bool,
    /// Store snapshots along the whole recording, so that any moment of it is reached quickly from now on
    #[arg(long, conflicts_with = "until", conflicts_with_all = ON_THE_WAY, conflicts_with_all = QUESTIONS)]
    index: bool,
    /// Undo this many deliveries from --until or the end, and print them
    #[arg(long, value_name = "N", num_args = 0..=1, default_missing_value = "1", value_parser = clap::value_parser!(u32).range(1..=100_000), conflicts_with_all = ON_THE_WAY, conflicts_with_all = behind("back"))]
    back: Option<u32>,
    /// Show it in a window: a timeline to scrub, step and play; click a pixel for its history, or walk on from any
    /// frame
    #[cfg(feature = "window")]
    #[arg(long, conflicts_with_all = ["until", "index", "json"], conflicts_with_all = ON_THE_WAY, conflicts_with_all = QUESTIONS)]
    view: bool,
    /// Another recording to show next to it at the same frame, with the first different frame marked
    #[cfg(feature = "window")]
    #[arg(long, value_name = "FVL", requires = "view")]
    beside: Option<PathBuf>,
    /// Record walks that branch off into this file, which names this recording and the frame
    #[cfg(feature = "window")]
    #[arg(long, value_name = "FVL", requires = "view")]
    record: Option<PathBuf>,
    /// Show it in a browser at this address, with the same timeline and histories
    #[cfg(feature = "serve")]
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, require_equals = true, default_missing_value = "127.0.0.1:8080", conflicts_with_all = ["until", "index"], conflicts_with_all = ON_THE_WAY, conflicts_with_all = QUESTIONS)]
    #[cfg_attr(feature = "window", arg(conflicts_with = "view"))]
    serve: Option<std::net::SocketAddr>,
    /// Folder for screenshots (F12)
    #[cfg(feature = "window")]
    #[arg(long, value_name = "DIR", default_value = ".", requires = "view")]
    screenshots: PathBuf,
    /// Write this frame's picture to --out
    #[arg(long, value_name = "FRAME", requires = "out", conflicts_with = "until", group = "drawn")]
    show: Option<u32>,
    /// PNG file for the picture of --show, or for the path of --path drawn over the picture
    #[arg(long, value_name = "PNG", requires = "drawn")]
    out: Option<PathBuf>,
    /// With --why: trace the sample's whole path again, with its surfaces, lobes, random numbers and contributions
    #[arg(long, requires = "why")]
    path: bool,
    /// Explain why this pixel of --frame looks as it does: the chain from input to sample
    #[arg(long, value_name = "X,Y", value_parser = pixel, group = "drawn", conflicts_with_all = ON_THE_WAY, conflicts_with_all = behind("why"))]
    why: Option<(u32, u32)>,
    /// Frame for --why (default: the last)
    #[arg(long, requires = "why")]
    frame: Option<u32>,
    /// Explain why this frame took as long as it did: what each thread did, the critical path, and which parts should
    /// have been faster
    #[arg(long, value_name = "FRAME", conflicts_with_all = ON_THE_WAY, conflicts_with_all = behind("why_late"))]
    why_late: Option<u32>,
    /// Print what was delivered to this actor
    #[arg(long, value_name = "NAME")]
    actor: Option<String>,
    /// Print this actor's state, at --at or the end
    #[arg(long, value_name = "ACTOR", conflicts_with_all = ON_THE_WAY, conflicts_with_all = behind("state_diff"))]
    state: Option<String>,
    /// Moment at which --state is printed
    #[arg(long, value_name = "FRAME|ACTOR:INDEX", requires = "state")]
    at: Option<String>,
    /// Print what changed between two moments in the state of --state, or of all actors
    #[arg(long, num_args = 2, value_names = ["A", "B"], conflicts_with = "at", conflicts_with_all = ON_THE_WAY, conflicts_with_all = behind("state_diff"))]
    state_diff: Option<Vec<String>>,
    /// Print everything an actor sent in response to this delivery, including what was not delivered
    #[arg(long, value_name = "ACTOR:INDEX", conflicts_with_all = ON_THE_WAY, conflicts_with_all = behind("said"))]
    said: Option<String>,
    /// Find where this becomes true: `ACTOR.PATH < 3`, `ACTOR.PATH changes`, `ACTOR hears MESSAGE [PATH > 3]`, `pixel
    /// X,Y changes`, `object "NAME" loses samples`; --state lists the paths
    #[arg(long, value_name = "CONDITION", conflicts_with_all = ON_THE_WAY, conflicts_with_all = behind("when"))]
    when: Option<String>,
    /// Which of the places found by --when to print
    #[arg(long, value_name = "WHICH", default_value = "all", requires = "when")]
    which: look::Which,
    /// Write every delivery of the replay, with arrows from input to job to pixel, for chrome://tracing or in
    /// Perfetto's own format; rerun, without other options, writes pictures, cameras, object ids and numbers of the
    /// actors for the Rerun viewer
    #[arg(long, num_args = 2, value_names = ["chrome|perfetto|rerun", "FILE"])]
    export: Option<Vec<String>>,
    /// If the replay diverges: program that made the recording, to find out what was recorded there
    #[arg(long, value_name = "PROGRAM")]
    with: Option<PathBuf>,
    /// Find the first message at which two recordings diverge
    #[arg(long, num_args = 2, value_names = ["A", "B"], conflicts_with = "trace", conflicts_with_all = ON_THE_WAY)]
    diff: Option<Vec<PathBuf>>,
    #[command(flatten)]
    elsewhere: ElsewhereArguments,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

impl ReplayArguments {
    /// Where all that is asked for is, if that can be gone to at once.
    fn place(&self) -> Option<String> {
        let from_start = self.verify || self.actor.is_some() || self.export.is_some();
        let shown = self.show.map(|frame| frame.to_string());
        shown.or_else(|| self.until.clone()).or_else(|| self.at.clone()).filter(|_| !from_start)
    }
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
    let Some(path) = &a.trace else { return Err(Failure::Usage("which recording?".into())) };
    if let Some([format, out]) = a.export.as_deref()
        && format.eq_ignore_ascii_case("rerun")
    {
        let others =
            [a.verify, a.json, a.show.is_some(), a.until.is_some(), a.actor.is_some(), a.with.is_some()];
        if others.contains(&true) {
            return Err(Failure::Usage("--export rerun goes with nothing else".into()));
        }
        return rerun::write(path, out.as_ref(), &a.elsewhere);
    }
    let export = a.export.as_deref().map(export::parse).transpose()?;
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
    let source =
        Source::open_at(path, &a.elsewhere.files(), a.verify, a.place().as_deref(), &progress.baking())?;
    if a.index {
        if source.indexing().go_on(&source, || false) {
            return Err(Failure::Interrupted("interrupted; snapshots so far are kept".into()));
        }
        look::index(&source, a.json);
        return Ok(());
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
    if let Some(place) = &a.said {
        return recorded::said(&source, place, workers, a.json);
    }
    if a.step || a.back.is_some() {
        return step::run(source, a.until.as_deref(), a.back, a.step, workers, telling);
    }
    verify::verify(a, &source, workers, export)
}

fn write_picture(out: &Path, picture: &Map2d<[u8; 3]>) -> Result<(), Failure> {
    let (width, height) = (picture.width() as u32, picture.height() as u32);
    write_atomic(out, &png_bytes(width, height, picture.data().as_flattened())?)
}

#[cfg(test)]
mod tests {
    use super::*;

    use clap::error::ErrorKind;

    /// Every argument that asks for something, as one says it.
    const ASKED: &[&[&str]] = &[
        #[cfg(feature = "window")]
        &["--view"],
        #[cfg(feature = "serve")]
        &["--serve"],
        &["--index"],
        &["--verify"],
        &["--until", "3"],
        &["--show", "3", "--out", "a.png"],
        &["--actor", "renderer"],
        &["--export", "chrome", "a.json"],
        &["--with", "before"],
        &["--step"],
        &["--back"],
        &["--why", "1,2"],
        &["--why-late", "3"],
        &["--state", "renderer"],
        &["--state-diff", "1", "2"],
        &["--said", "renderer:3"],
        &["--when", "renderer.view > 1"],
        &["--diff", "a.fvl", "b.fvl"],
    ];

    /// Of these any may go together but for `--show` and `--until`, which both say where to stop.
    const TOGETHER: [&str; 6] = ["--verify", "--until", "--show", "--actor", "--export", "--with"];
    const ALSO: [[&str; 2]; 5] = [
        ["--until", "--step"],
        ["--until", "--back"],
        ["--until", "--when"],
        ["--step", "--back"],
        ["--state", "--state-diff"],
    ];

    fn parsed(words: &[&[&str]]) -> Result<(), ErrorKind> {
        let command = ReplayArguments::augment_args(clap::Command::new("replay"));
        // A diff names its recordings itself.
        let trace: &[&str] = if words.iter().any(|of| of[0] == "--diff") { &[] } else { &["a.fvl"] };
        let line = std::iter::once("replay").chain(trace.iter().copied());
        let line = line.chain(words.iter().flat_map(|of| of.iter().copied()));
        command.try_get_matches_from(line).map(drop).map_err(|e| e.kind())
    }

    /// What cannot be answered together is refused, and nothing is dropped in silence.
    #[test]
    fn each_two_questions_go_together_or_are_refused() {
        for (number, one) in ASKED.iter().enumerate() {
            assert_eq!(parsed(&[one]), Ok(()), "{one:?}");
            for other in &ASKED[number + 1..] {
                let pair = [one[0], other[0]];
                let stops = pair == ["--until", "--show"];
                let both = pair.iter().all(|of| TOGETHER.contains(of)) && !stops;
                let goes = both || ALSO.contains(&pair);
                let expected = if goes { Ok(()) } else { Err(ErrorKind::ArgumentConflict) };
                assert_eq!(parsed(&[one, other]), expected, "{one:?} {other:?}");
            }
        }
    }

    #[test]
    fn a_picture_is_drawn_by_somebody() {
        let out: &[&str] = &["--out", "a.png"];
        assert_eq!(parsed(&[out]), Err(ErrorKind::MissingRequiredArgument));
        assert_eq!(parsed(&[&["--why", "1,2"], out]), Ok(()));
        for question in ["--index", "--step", "--verify"] {
            assert!(parsed(&[&[question], out]).is_err(), "{question}");
        }
    }
}
