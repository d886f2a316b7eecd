//! A recording replayed to its end or to a place, compared message by message; where it parts, what stands there.

use std::path::PathBuf;
use std::sync::Arc;

use crossbeam_queue::SegQueue;
use foveal_engine::Failure;
use foveal_engine::files::write_atomic;
use foveal_engine::replay::{How, Source, Telling, diverged, observe, ring_turns};
use foveal_runtime::{Delivery, Divergence, ReplayReport};
use foveal_terminal::print::{print_json, print_line};
use serde_json::{Value, json};

use super::{ReplayArguments, export, recorded, write_picture};

/// Runs it, with what else is asked on the way.
pub(super) fn verify(
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
    if let Some((format, file)) = &export {
        write_atomic(file, &export::bytes(*format, source, &runtime, &seen))?;
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
            document["diverged"]["answers"] =
                found.answers.iter().map(|said| recorded::document(source, said)).collect();
            document["diverged"]["replays_differ"] = differs.collect();
        } else {
            print_line(&format!("the message there: {}", found.says));
            for said in &found.answers {
                print_line(&format!(
                    "the response: {} to {}: {}",
                    said.kind,
                    source.name(said.to),
                    said.says
                ));
            }
            match found.differs.is_empty() {
                true => print_line(
                    "two more replays agree there: this program behaves differently from the one that recorded",
                ),
                false => print_line(
                    "two more replays differ there, so the outcome depends on something other than messages:",
                ),
            }
            found
                .differs
                .iter()
                .for_each(|d| print_line(&format!("  {}: {} and {}", d.path, d.left, d.right)));
        }
    }
    if let (Some(program), Some(divergence)) = (&a.with, &report.divergence) {
        let other = recorded::Recorder { program, source, elsewhere: &a.elsewhere };
        match other.differences(divergence, workers) {
            Ok(others) if a.json => {
                document["diverged"]["recorded_differs"] =
                    others.iter().map(recorded::Other::document).collect();
            }
            Ok(others) if others.is_empty() => print_line("the program that recorded does the same there"),
            Ok(others) => others.iter().for_each(|other| print_line(&format!("  {other}"))),
            // That it parts is known all the same.
            Err(e) => {
                document["diverged"]["recorded_unknown"] = json!(e.to_string());
                tracing::warn!("{e}");
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
