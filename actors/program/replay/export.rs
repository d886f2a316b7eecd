//! A replay on a line of time: a slice for each delivery on the track of its actor, and arrows from the input to the job
//! to the pixel.

use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::ValueEnum;
use foveal_runtime::{ActorId, Runtime, Slice, Timeline, Trace};

use foveal_engine::failure::Failure;
use foveal_engine::replay::{Seen, Source};

/// Most turns kept of an actor: those at the end of a long replay.
const RING_TURNS_MAX: u64 = 1 << 18;

/// Formats of a profile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// JSON, for chrome://tracing and Perfetto's viewer.
    Chrome,
    /// Perfetto's own.
    Perfetto,
}

/// Format and file, as they were given.
pub fn parse(export: &[String]) -> Result<(Format, PathBuf), Failure> {
    let [format, file] = export else {
        return Err(Failure::Usage("--export takes a format and a file".into()));
    };
    let format = Format::from_str(format, true)
        .map_err(|_| Failure::Usage(format!("--export {format}: chrome or perfetto")))?;
    Ok((format, PathBuf::from(file)))
}

/// Turns to keep of each actor so that every delivery has its time.
pub fn ring_turns(trace: &Trace) -> usize {
    let most = (0..trace.header().nodes.len() as u32).map(|actor| trace.deliveries(ActorId(actor))).max();
    // Turns that found nothing to deliver lie between.
    (most.unwrap_or(0) * 2 + 1024).min(RING_TURNS_MAX) as usize
}

/// A timeline as the bytes of a file.
pub fn encode(format: Format, timeline: &Timeline) -> Vec<u8> {
    match format {
        Format::Chrome => timeline.chrome().into_bytes(),
        Format::Perfetto => timeline.perfetto(),
    }
}

/// The file's content, of a replay with one delivery a turn.
pub fn bytes(format: Format, source: &Source, runtime: &Runtime, seen: &[Seen]) -> Vec<u8> {
    encode(format, &timeline(source, runtime, seen))
}

fn timeline(source: &Source, runtime: &Runtime, seen: &[Seen]) -> Timeline {
    let nodes = &source.trace.header().nodes;
    let mut of_actor: Vec<Vec<&Seen>> = vec![Vec::new(); nodes.len()];
    for s in seen {
        if let Some(list) = of_actor.get_mut(s.actor.0 as usize) {
            list.push(s);
        }
    }
    let mut timeline =
        Timeline { tracks: nodes.iter().map(|n| n.name.clone()).collect(), ..Timeline::default() };
    let mut places = BTreeMap::new();
    for ((actor, deliveries), (_, turns)) in of_actor.iter_mut().enumerate().zip(runtime.turn_times()) {
        deliveries.sort_by_key(|s| s.index);
        let turns: Vec<_> = turns.into_iter().filter(|turn| turn.messages == 1).collect();
        // The ring may have lost the first ones.
        let kept = turns.len().min(deliveries.len());
        for (s, turn) in deliveries[deliveries.len() - kept..].iter().zip(&turns[turns.len() - kept..]) {
            places.insert((s.actor, s.index), timeline.slices.len());
            let shown = source.shown_in.binary_search(&s.index).ok().filter(|_| s.actor == source.renderer());
            let name = shown.map_or_else(|| s.kind.to_owned(), |frame| format!("frame {frame}"));
            let mut notes = vec![
                ("delivery", source.at((s.actor, s.index))),
                ("from", source.name(s.from).to_owned()),
                ("thread", turn.thread.to_string()),
                ("hash", format!("{:016x}", s.chain)),
            ];
            notes.extend(s.cause.map(|cause| ("sent in", source.at(cause))));
            let (start_ns, duration_ns) = (turn.start_ns, u64::from(turn.duration_ns));
            timeline.slices.push(Slice { track: actor as u32, name, start_ns, duration_ns, notes });
        }
    }
    let arrow = |from, to| Some((*places.get(&from)?, *places.get(&to)?));
    timeline.arrows.extend(seen.iter().filter_map(|s| arrow(s.cause?, (s.actor, s.index))));
    // What a frame shows came with the samples delivered since the frame before.
    let renderer = source.renderer();
    for s in of_actor.get(renderer.0 as usize).into_iter().flatten() {
        if ["SamplesTraced", "SamplesAged"].contains(&s.kind) {
            let frame = source.shown_in.partition_point(|index| *index < s.index);
            let shown = source.shown_in.get(frame).map(|index| (renderer, *index));
            timeline.arrows.extend(shown.and_then(|shown| arrow((s.actor, s.index), shown)));
        }
    }
    timeline
}
