//! Why a frame was late: what each thread did between its beginning and its showing, which chain of deliveries took the
//! longest, and what of it would have had to be faster.

use std::collections::BTreeMap;

use foveal_actors::message::RendererInput;
use foveal_runtime::{ActorId, Event};
use serde_json::{Value, json};

use super::lanes::{Lanes, Timed};
use super::source::Source;
use crate::failure::Failure;

/// Kinds of deliveries told of each thread.
const KINDS_TOLD: usize = 6;

/// Deliveries of one kind to one actor.
#[derive(Clone, Copy, Debug, Default)]
struct Sum {
    count: u64,
    ns: u64,
}

/// The chain of deliveries that takes the longest from `first` to `last`, by their places: each waits for the one before it
/// at the same actor, and for the one its message was sent in.
pub(super) fn critical_path(lanes: &Lanes, first: usize, last: usize) -> Vec<usize> {
    let mut sent_in = vec![None; lanes.all.len()];
    lanes.causes.iter().for_each(|(from, to)| sent_in[*to] = Some(*from));
    let mut order: Vec<usize> = (0..lanes.all.len()).collect();
    // What another waits for began before it.
    order.sort_by_key(|place| (lanes.all[*place].start_ns, *place));
    let mut at_actor: BTreeMap<ActorId, usize> = BTreeMap::new();
    // The longest way from `first`, and over which delivery it comes.
    let mut ways: Vec<Option<(u64, Option<usize>)>> = vec![None; lanes.all.len()];
    for place in order {
        let timed = &lanes.all[place];
        let before = at_actor.insert(timed.seen.actor, place);
        let longest = [before, sent_in[place]]
            .into_iter()
            .flatten()
            .filter_map(|before| Some((ways[before]?.0, before)))
            .max();
        ways[place] = match longest {
            _ if place == first => Some((timed.cost_ns(), None)),
            Some((ns, before)) => Some((ns + timed.cost_ns(), Some(before))),
            None => None,
        };
        if place == last {
            break;
        }
    }
    let mut path = Vec::new();
    let mut at = ways[last].map(|_| last);
    while let Some(place) = at {
        path.push(place);
        at = ways[place].and_then(|(_, before)| before);
    }
    path.reverse();
    path
}

/// How long a frame was meant to take, seconds, as the message says in which it began.
fn meant(source: &Source, timed: &Timed) -> Option<f64> {
    let event = source.trace.delivery(timed.seen.actor, timed.seen.index)?;
    let Event::Delivered { external: Some(bytes), .. } = event else { return None };
    match postcard::from_bytes(&bytes).ok()? {
        RendererInput::FrameBegan { time, .. } => Some(f64::from(time)),
        _ => None,
    }
}

/// Why a frame took as long as it did, as a document.
///
/// # Errors
/// If there is no such frame, or the replay diverges.
pub fn explain(source: &Source, frame: u32, workers: usize) -> Result<Value, Failure> {
    let lanes = Lanes::of_frames(source, frame, frame, workers)?;
    let (Some(first), Some(last)) = (lanes.began(source, frame), lanes.shown(source, frame)) else {
        return Err(Failure::Check(format!("frame {frame} has no beginning in this recording")));
    };
    let ms = |ns: u64| ns as f64 * 1e-6;
    let (begin, end) = (lanes.all[first].start_ns, lanes.all[last].end_ns());
    let had = meant(source, &lanes.all[first]);
    let mut threads: BTreeMap<u16, BTreeMap<(ActorId, &'static str), Sum>> = BTreeMap::new();
    for timed in lanes.all.iter().filter(|t| t.start_ns < end && t.end_ns() > begin) {
        let of =
            threads.entry(timed.thread).or_default().entry((timed.seen.actor, timed.seen.kind)).or_default();
        of.count += 1;
        of.ns += timed.end_ns().min(end) - timed.start_ns.max(begin);
    }
    let path = critical_path(&lanes, first, last);
    let takes: u64 = path.iter().map(|place| lanes.all[*place].cost_ns()).sum();
    let over = had.map(|had| ms(takes) - had * 1e3);
    let mut parts: BTreeMap<(ActorId, &'static str), Sum> = BTreeMap::new();
    for timed in path.iter().map(|place| &lanes.all[*place]) {
        let part = parts.entry((timed.seen.actor, timed.seen.kind)).or_default();
        part.count += 1;
        part.ns += timed.cost_ns();
    }
    let mut parts: Vec<_> = parts.into_iter().collect();
    parts.sort_by_key(|(_, sum)| std::cmp::Reverse(sum.ns));
    let part = |((actor, kind), sum): &((ActorId, &'static str), Sum)| {
        // How much of its time it may take for the frame to be in time.
        let over_ns = over.map_or(0.0, |over| over * 1e6);
        let may = (over_ns > 0.0).then(|| 1.0 - over_ns / sum.ns.max(1) as f64);
        json!({
            "actor": source.name(*actor),
            "message": kind,
            "count": sum.count,
            "ms": ms(sum.ns),
            "would_have_had_to_take_ms": may.filter(|may| *may > 0.0).map(|may| may * ms(sum.ns)),
        })
    };
    let link = |place: &usize| {
        let timed = &lanes.all[*place];
        json!({
            "at": source.at((timed.seen.actor, timed.seen.index)),
            "message": timed.seen.kind,
            "sent_in": timed.seen.cause.map(|cause| source.at(cause)),
            "ms": ms(timed.cost_ns()),
            "measured_then": timed.measured_ns.is_some(),
        })
    };
    let thread = |(thread, kinds): (&u16, &BTreeMap<(ActorId, &'static str), Sum>)| {
        let mut kinds: Vec<_> = kinds.iter().collect();
        kinds.sort_by_key(|(_, sum)| std::cmp::Reverse(sum.ns));
        let busy: u64 = kinds.iter().map(|(_, sum)| sum.ns).sum();
        json!({
            "thread": thread,
            "busy_ms": ms(busy),
            "did": kinds.iter().map(|((actor, kind), sum)| json!({
                "actor": source.name(*actor), "message": kind, "count": sum.count, "ms": ms(sum.ns),
            })).collect::<Vec<_>>(),
        })
    };
    Ok(json!({
        "schema": "foveal.late/1",
        "frame": frame,
        "had_ms": had.map(|had| had * 1e3),
        "replayed_in_ms": ms(end.saturating_sub(begin)),
        "path_ms": ms(takes),
        "over_ms": over,
        "threads": threads.iter().map(thread).collect::<Vec<_>>(),
        "path": path.iter().map(link).collect::<Vec<_>>(),
        "parts": parts.iter().map(part).collect::<Vec<_>>(),
    }))
}

/// The same in lines.
pub fn told(d: &Value) -> Vec<String> {
    let number = |v: &Value| v.as_f64().unwrap_or_default();
    let text = |v: &Value| v.as_str().unwrap_or_default().to_owned();
    let had = d["had_ms"].as_f64();
    let over = d["over_ms"].as_f64();
    let verdict = match (had, over) {
        (Some(had), Some(over)) if over > 0.0 => {
            format!(
                "late by {over:.1} ms: the longest chain takes {:.1} of {had:.1} ms",
                number(&d["path_ms"])
            )
        }
        (Some(had), _) => {
            format!("the longest chain takes {:.1} of {had:.1} ms: in time", number(&d["path_ms"]))
        }
        (None, _) => format!("the longest chain takes {:.1} ms", number(&d["path_ms"])),
    };
    let mut lines = vec![format!("frame {}: {verdict}", d["frame"])];
    let whole = number(&d["replayed_in_ms"]);
    for thread in d["threads"].as_array().into_iter().flatten() {
        let busy = number(&thread["busy_ms"]);
        let name = match thread["thread"].as_u64() {
            Some(0) => "main".to_owned(),
            number => format!("worker {}", number.unwrap_or_default()),
        };
        lines.push(format!("thread    {name:<10} {busy:7.1} ms at work of {whole:.1} in the replay"));
        for did in thread["did"].as_array().into_iter().flatten().take(KINDS_TOLD) {
            lines.push(format!(
                "            {:>8.2} ms  {} × {} {}",
                number(&did["ms"]),
                did["count"],
                text(&did["actor"]),
                text(&did["message"])
            ));
        }
    }
    lines.push("path      what the frame waited for, each for the one before".to_owned());
    for link in d["path"].as_array().into_iter().flatten() {
        let then = if link["measured_then"] == true { ", measured then" } else { "" };
        lines.push(format!(
            "            {:>8.2} ms  {:<16} {}{then}",
            number(&link["ms"]),
            text(&link["at"]),
            text(&link["message"])
        ));
    }
    for part in d["parts"].as_array().into_iter().flatten() {
        if let Some(may) = part["would_have_had_to_take_ms"].as_f64() {
            lines.push(format!(
                "faster    {} {}: {may:.1} ms instead of {:.1}, and the frame is in time",
                text(&part["actor"]),
                text(&part["message"]),
                number(&part["ms"])
            ));
        }
    }
    if over.is_some_and(|over| over > 0.0)
        && d["parts"]
            .as_array()
            .is_some_and(|parts| parts.iter().all(|part| part["would_have_had_to_take_ms"].is_null()))
    {
        lines.push("faster    no part alone: several would have had to be".to_owned());
    }
    lines
}
