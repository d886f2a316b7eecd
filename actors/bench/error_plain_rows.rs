//! What `bench error --plain` tells of its curves: times until pictures are right, what their floors are, and how many
//! times as long plain ways take.

use super::error::ErrorArguments;
use super::error_curves::{Point, ReferenceKind, Way, time_to};
use super::error_plain::{FLOOR, HALVES, Measured, NEAR, PATHS, RIGHT, SCAN};
use foveal_terminal::table::{Aim, Row, figure, median};

/// What our order is held against, and how many times as long it should take at least.
const PEERS: [(&str, f64); 2] = [(SCAN, 3.0), (PATHS, 10.0)];

/// A scene's medians.
pub(super) fn rows_of(name: &str, a: &ErrorArguments, measured: &Measured) -> Vec<Row> {
    let mut rows = Vec::new();
    let floor = measured.floor();
    let (own, near): (Vec<&Way>, Vec<&Way>) =
        measured.still.iter().filter(|w| !w.is_floor).partition(|w| w.against.kind == ReferenceKind::Traced);
    let paths = near.iter().filter(|w| w.name == PATHS);
    for way in own.iter().chain(paths) {
        rows.extend(waited(name, way, RIGHT, ""));
    }
    for (peer, aim) in PEERS {
        if let Some(quotient) = own_quotient(measured, peer) {
            rows.push(Row::new(quotient_text(name, peer), "×", &[quotient]).aim(Aim::AtLeast(aim)));
        }
    }
    rows.extend(floors(name, a, measured));
    for way in &near {
        rows.extend(waited(name, way, NEAR * floor, " = 1.1 × floor"));
    }
    if let Some(quotient) = near_quotient(measured) {
        rows.push(Row::new(near_text(name), "×", &[quotient]));
    }
    for (way, jod) in measured.walking.iter().zip(&measured.jod) {
        rows.extend(walk(name, way, jod));
        if way.name == PATHS {
            let spp = &measured.paths_per_frame;
            rows.push(Row::new("  paths per pixel that a frame has time for", "", spp));
        }
    }
    if let Some(halves) = &measured.halves {
        let runs = vec![halves.walking.clone()];
        rows.extend(walk(name, &Way { runs, ..Way::new(HALVES, halves.against[1]) }, &[halves.jod]));
    }
    rows
}

/// How far a walk is from its reference.
fn walk(name: &str, way: &Way, jod: &[f64]) -> [Row; 3] {
    let what = format!("{name}, walking, against {}: {}", way.against.kind.name(), way.name);
    // A run's means over its frames.
    let means = |of: fn(&Point) -> f64| -> Vec<f64> {
        way.runs.iter().map(|r| r.iter().map(of).sum::<f64>() / r.len().max(1) as f64).collect()
    };
    let row = |which: &str, unit, values: &[f64]| {
        Row::new(format!("{what}{which}"), unit, values).held_against(way.against)
    };
    [
        row("", "mean FLIP", &means(|p| p.corrected.flip)),
        row(", all pixels", "mean FLIP", &means(|p| p.all.flip)),
        row("", "JOD", jod),
    ]
}

/// What no time takes away, and what parts of it are.
fn floors(name: &str, a: &ErrorArguments, measured: &Measured) -> Vec<Row> {
    let converged = measured.still.iter().find(|w| w.is_floor);
    let first = converged.and_then(|w| Some((w.runs.first()?.first()?, w.against)));
    let refined = format!("refined view, {} samples per pixel", a.reference_spp);
    let floors = [
        (FLOOR, first),
        (&refined, converged.map(|w| (&measured.refined, w.against))),
        (HALVES, measured.halves.as_ref().map(|h| (&h.still, h.against[0]))),
    ];
    let mut rows = Vec::new();
    for (what, found) in floors {
        let Some((Point { corrected, all, .. }, against)) = found else { continue };
        for (which, flip) in [("", corrected.flip), (", all pixels", all.flip)] {
            let row = Row::new(format!("{name}, against path: {what}{which}"), "mean FLIP", &[flip]);
            rows.push(row.held_against(against));
        }
    }
    rows
}

/// The median over scenes of how many times as long plain ways take.
pub(super) fn overall(told: &[(String, Measured)]) -> Vec<Row> {
    let mut rows = Vec::new();
    for (peer, aim) in PEERS {
        let quotients: Vec<f64> = told.iter().filter_map(|(_, m)| own_quotient(m, peer)).collect();
        if !quotients.is_empty() {
            let row = Row::new(quotient_text("median over scenes", peer), "×", &quotients);
            rows.push(row.aim(Aim::AtLeast(aim)));
        }
    }
    let quotients: Vec<f64> = told.iter().filter_map(|(_, m)| near_quotient(m)).collect();
    if !quotients.is_empty() {
        rows.push(Row::new(near_text("median over scenes"), "×", &quotients));
    }
    rows
}

fn quotient_text(name: &str, peer: &str) -> String {
    format!("{name}: {peer} takes at least this many times as long")
}

fn near_text(name: &str) -> String {
    format!("{name}, against path: {PATHS}, takes at least this many times as long to 1.1 × floor")
}

/// How long a way takes, and what is left where it does not come so far.
fn waited(name: &str, way: &Way, error: f64, which: &str) -> Vec<Row> {
    let times: Vec<f64> = way.runs.iter().map(|r| time_to(r, error)).collect();
    let against = way.against;
    let what = format!(
        "{name}, against {}: {}, time to FLIP ≤ {}{which}",
        against.kind.name(),
        way.name,
        figure(error)
    );
    let mut rows = vec![Row::new(what, "CPU s", &times).held_against(against)];
    let missed = times.iter().filter(|t| !t.is_finite()).count();
    if missed > 0 {
        let last = |r: &Vec<Point>| r.last().map_or(f64::NAN, |p| p.corrected.flip);
        let what = format!("  not reached in {missed} runs; error at the end");
        let ends: Vec<f64> = way.runs.iter().map(last).collect();
        rows.push(Row::new(what, "mean FLIP", &ends).held_against(against));
    }
    rows
}

/// How many times as long as our order another way takes at least until it is right, each against its own kind of
/// reference.
fn own_quotient(measured: &Measured, peer: &str) -> Option<f64> {
    let theirs = measured.still.iter().find(|w| w.name == peer)?;
    quotient(measured.still.first()?, theirs, RIGHT)
}

/// How many times as long as our order path tracing takes at least until it is as near to paths as our order comes.
fn near_quotient(measured: &Measured) -> Option<f64> {
    let beside_paths = |w: &&Way| w.against.kind == ReferenceKind::Path;
    let ours = measured.still.iter().find(beside_paths)?;
    let theirs = measured.still.iter().find(|w| w.name == PATHS)?;
    quotient(ours, theirs, NEAR * measured.floor())
}

fn quotient(ours: &Way, theirs: &Way, error: f64) -> Option<f64> {
    // Where it never is as near, its last time is a lower bound.
    let least = |r: &Vec<Point>| match time_to(r, error) {
        t if t.is_finite() => t,
        _ => r.last().map_or(0.0, |p| p.seconds),
    };
    let theirs: Vec<f64> = theirs.runs.iter().map(least).collect();
    let ours: Vec<f64> = ours.runs.iter().map(|r| time_to(r, error)).collect();
    Some(median(&theirs)? / median(&ours)?)
}
