//! A replay on a line of time: a slice for each delivery on the track of its actor, and arrows from the input to the job
//! to the pixel.

use std::path::PathBuf;

use clap::ValueEnum;
use foveal_runtime::{Runtime, Slice, Timeline};

use foveal_engine::failure::Failure;
use foveal_engine::replay::{Lanes, Seen, Source, Timed};

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
        .map_err(|_| Failure::Usage(format!("--export {format}: chrome, perfetto or rerun")))?;
    Ok((format, PathBuf::from(file)))
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
    let lanes = Lanes::of(source, runtime, seen);
    let renderer = source.renderer();
    let slice = |timed: &Timed| {
        let s = &timed.seen;
        let shown = source.shown_in.binary_search(&s.index).ok().filter(|_| s.actor == renderer);
        let name = shown.map_or_else(|| s.kind.to_owned(), |frame| format!("frame {frame}"));
        let mut notes = vec![
            ("delivery", source.at((s.actor, s.index))),
            ("from", source.name(s.from).to_owned()),
            ("thread", timed.thread.to_string()),
            ("hash", format!("{:016x}", s.chain)),
        ];
        notes.extend(s.cause.map(|cause| ("sent in", source.at(cause))));
        let (start_ns, duration_ns) = (timed.start_ns, timed.duration_ns);
        Slice { track: s.actor.0, name, start_ns, duration_ns, notes }
    };
    let tracks = source.trace.header().nodes.iter().map(|n| n.name.clone()).collect();
    let slices = lanes.all.iter().map(slice).collect();
    let mut arrows = lanes.causes.clone();
    // What a frame shows came with the samples delivered since the frame before.
    let shown: Vec<_> = (0..source.shown_in.len() as u32).map(|frame| lanes.shown(source, frame)).collect();
    for (place, timed) in lanes.all.iter().enumerate() {
        if timed.seen.actor == renderer && ["SamplesTraced", "SamplesAged"].contains(&timed.seen.kind) {
            let frame = source.shown_in.partition_point(|index| *index < timed.seen.index);
            arrows.extend(shown.get(frame).copied().flatten().map(|shown| (place, shown)));
        }
    }
    Timeline { tracks, slices, arrows }
}
