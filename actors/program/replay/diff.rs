//! The first message at which two recordings part.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use crossbeam_queue::SegQueue;
use foveal_runtime::{ActorId, Content, Delivery, Difference, Event, Limit, Observer, Trace};
use serde_json::json;

use foveal_engine::failure::Failure;
use foveal_engine::recording::{Elsewhere, RecordedRun, open_trace};
use foveal_engine::replay::{How, Source, name};
use foveal_terminal::print::{print_json, print_line};
use foveal_terminal::progress::Progress;

/// Where the recordings of one actor part.
struct Parting {
    actor: ActorId,
    index: u64,
    left: String,
    right: String,
    /// Frames shown before, from a replay of the first recording.
    frames: Option<u64>,
    /// What replays of both showed there.
    told: [Option<Told>; 2],
}

/// A delivery at which recordings part.
struct Told {
    kind: &'static str,
    /// The delivery it was sent in.
    cause: Option<(ActorId, u64)>,
    says: Content,
    /// The receiver's state before it.
    state: Content,
}

impl Parting {
    fn kind(&self) -> Option<&'static str> {
        self.told.iter().flatten().next().map(|told| told.kind)
    }

    fn cause(&self) -> Option<(ActorId, u64)> {
        self.told[0].as_ref().and_then(|told| told.cause)
    }

    /// The fields in which the message differs, or, where it does not, the receiver's state before it.
    fn differences(&self) -> (&'static str, Vec<Difference>) {
        let [Some(left), Some(right)] = &self.told else { return ("message", Vec::new()) };
        let message = left.says.differences(&right.says);
        if !message.is_empty() || left.kind != right.kind {
            return ("message", message);
        }
        ("state", left.state.differences(&right.state))
    }
}

/// Runs the command: exit 1 if the recordings differ.
pub fn run(
    left_path: &Path,
    right_path: &Path,
    elsewhere: &Elsewhere,
    as_json: bool,
    progress: Progress,
) -> Result<(), Failure> {
    let (left, right) = (open_trace(left_path)?, open_trace(right_path)?);
    let header = headers(&left, &right, left_path, right_path)?;
    let mut partings = partings(&left, &right);
    if !partings.is_empty() {
        // What was sent when is known to a replay alone; without its scene the order stays a guess.
        for (side, path) in [left_path, right_path].into_iter().enumerate() {
            match Source::open(path, elsewhere, false, &progress.baking())
                .and_then(|s| look(&s, side, &mut partings))
            {
                Ok(()) => {}
                Err(e) if side == 0 => {
                    tracing::warn!("{}: {e}; which message is the first is a guess", path.display());
                }
                Err(e) => tracing::warn!("{}: {e}; what differs is not known", path.display()),
            }
        }
    }
    let first = first(&partings, &left);
    let at = |p: &Parting| format!("{}:{}", name(&left, p.actor), p.index);
    let of = |(actor, index): (ActorId, u64)| format!("{}:{index}", name(&left, actor));
    let lines = |p: &Parting| {
        let (within, differences) = p.differences();
        json!({
            "actor": name(&left, p.actor), "index": p.index, "frame": p.frames, "message": p.kind(),
            "sent_in": p.cause().map(of), "a": p.left, "b": p.right, "within": within,
            "differences": differences.iter()
                .map(|d| json!({"path": d.path, "a": d.left, "b": d.right}))
                .collect::<Vec<_>>(),
        })
    };
    if as_json {
        print_json(&json!({
            "schema": "foveal.replay.diff/1",
            "same": partings.is_empty(),
            "settings": header,
            "first": first.map(lines),
            "actors": partings.iter().map(lines).collect::<Vec<_>>(),
        }));
    } else {
        header.iter().for_each(|line| print_line(line));
        match first {
            None => print_line(&format!("identical: {} messages", left.stat().deliveries)),
            Some(p) => {
                let kind = p.kind().map_or_else(String::new, |kind| format!(": {kind}"));
                let sent = p.cause().map_or_else(String::new, |cause| format!(", sent in {}", of(cause)));
                let frame = p.frames.map_or_else(String::new, |frames| format!(", after {frames} frames"));
                print_line(&format!("they diverge at {}{kind}{sent}{frame}", at(p)));
                print_line(&format!("  A: {}\n  B: {}", p.left, p.right));
                let (within, differences) = p.differences();
                for d in &differences {
                    let path = if d.path.is_empty() { "" } else { "." };
                    print_line(&format!("  {within}{path}{}: A {}, B {}", d.path, d.left, d.right));
                }
                for other in partings.iter().filter(|o| o.actor != p.actor) {
                    print_line(&format!("then {}: A {}, B {}", at(other), other.left, other.right));
                }
            }
        }
    }
    match first {
        None => Ok(()),
        Some(p) => Err(Failure::Check(format!("the recordings differ from {} on", at(p)))),
    }
}

/// What differs in the headers; recordings of other actors cannot be compared.
fn headers(left: &Trace, right: &Trace, left_path: &Path, right_path: &Path) -> Result<Vec<String>, Failure> {
    let (a, b) = (&left.header().nodes, &right.header().nodes);
    if let Some(index) = (0..a.len().max(b.len())).find(|i| a.get(*i) != b.get(*i)) {
        let named = |n: Option<&foveal_runtime::NodeInfo>| n.map_or("nobody", |n| n.name.as_str()).to_owned();
        return Err(Failure::Input(format!(
            "the recordings are of other systems: #{index} is {} in {} and {} in {}",
            named(a.get(index)),
            left_path.display(),
            named(b.get(index)),
            right_path.display()
        )));
    }
    let mut lines = Vec::new();
    if let Some(difference) = left.header().fingerprint.difference(&right.header().fingerprint) {
        lines.push(format!("made elsewhere: {difference}"));
    }
    let keys = |trace: &Trace, path: &Path| -> Result<serde_json::Value, Failure> {
        serde_json::to_value(RecordedRun::of(trace, path)?).map_err(|e| Failure::file(path, e))
    };
    let (a, b) = (keys(left, left_path)?, keys(right, right_path)?);
    for (key, value) in a.as_object().into_iter().flatten().filter(|(key, value)| b.get(key) != Some(value)) {
        lines.push(format!("{key}: {value} | {}", b[key]));
    }
    Ok(lines)
}

fn partings(left: &Trace, right: &Trace) -> Vec<Parting> {
    let actors = (0..left.header().nodes.len() as u32).map(ActorId);
    let told = |trace: &Trace, actor: ActorId, index: u64| {
        let Some(Event::Delivered { from, lane, .. }) = trace.delivery(actor, index) else {
            return "nothing more".to_owned();
        };
        let from = if from == actor { "itself" } else { name(trace, from) };
        format!("from {from} ({lane})")
    };
    actors
        .filter_map(|actor| {
            let lengths = (left.deliveries(actor), right.deliveries(actor));
            let shorter = (lengths.0 != lengths.1).then_some(lengths.0.min(lengths.1));
            let index = left.first_difference(right, actor).or(shorter)?;
            let (a, b) = (told(left, actor, index), told(right, actor, index));
            let same = a == b;
            let with = |text: String| if same { format!("{text}, other content or state") } else { text };
            let (left, right) = (with(a), with(b));
            Some(Parting { actor, index, left, right, frames: None, told: [None, None] })
        })
        .collect()
}

/// Replays a recording to learn what each parting comes of, and what was said there.
fn look(source: &Source, side: usize, partings: &mut [Parting]) -> Result<(), Failure> {
    let wanted: BTreeMap<ActorId, u64> = partings.iter().map(|p| (p.actor, p.index)).collect();
    let seen = Arc::new(SegQueue::new());
    let sink = Arc::clone(&seen);
    let observer: Observer = Arc::new(move |d: &Delivery<'_>| {
        if wanted.get(&d.actor) == Some(&d.index) {
            let (says, state) = ((d.told)(), (d.state)());
            sink.push((d.actor, Told { kind: d.kind, cause: d.cause, says, state }));
        }
    });
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let (mut runtime, _) =
        source.system(How { threads: cores, observer: Some(observer), ..How::default() })?;
    runtime.pump(Limit::IDLE);
    while let Some((actor, told)) = seen.pop() {
        if let Some(p) = partings.iter_mut().find(|p| p.actor == actor) {
            p.told[side] = Some(told);
            if side == 0 && actor == source.renderer() {
                p.frames = Some(source.shown_in.partition_point(|index| *index < p.index) as u64);
            }
        }
    }
    Ok(())
}

/// Of the partings that are no consequence of another, the one with the least of the recording before it.
fn first<'p>(partings: &'p [Parting], left: &Trace) -> Option<&'p Parting> {
    let follows = |p: &Parting| {
        p.cause().is_some_and(|(actor, index)| {
            partings
                .iter()
                .any(|other| other.actor == actor && other.actor != p.actor && other.index <= index)
        })
    };
    let share = |p: &Parting| p.index as f64 / left.deliveries(p.actor).max(1) as f64;
    let earliest = |roots: Vec<&'p Parting>| roots.into_iter().min_by(|a, b| share(a).total_cmp(&share(b)));
    let roots: Vec<&Parting> = partings.iter().filter(|p| !follows(p)).collect();
    earliest(roots).or_else(|| earliest(partings.iter().collect()))
}
