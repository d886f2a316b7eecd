//! How a walk stands, as pages show it.

use foveal_actors::insight::ObjectInsight;
use foveal_actors::station::StationCounts;
use foveal_engine::foveal::scene::Camera;
use foveal_engine::thread::Report;
use serde_json::{Value, json};

use crate::protocol;

/// Lines of a list.
const LINES: usize = 8;
/// Bytes of a MiB.
const MIB: f64 = (1 << 20) as f64;

/// The message; a recording has no `camera`.
pub fn state(report: &Report, camera: Option<&Camera>) -> String {
    let Report { controls, status, times, quality, speed, orbits, insight, timeline } = report;
    let refinement =
        insight.as_ref().filter(|_| status.converged).and_then(|(insight, _)| insight.refinement);
    let state = status.state(refinement.is_some());
    let actors: Vec<Value> = status
        .actors
        .iter()
        .map(|a| json!([a.name, a.delivered, a.waiting, a.waiting_max, rounded(a.busy.as_secs_f64(), 2)]))
        .collect();
    let stations =
        status.stations.iter().filter(|s| s.guest.is_some() || s.counts != StationCounts::default());
    let stations: Vec<Value> = stations
        .map(|s| {
            let rate = rounded(f64::from(s.rate), 0);
            let trip = rounded(f64::from(s.round_trip) * 1e3, 1);
            let c = &s.counts;
            json!([s.guest, s.cores, s.told(), trip, rate, c.late, c.shared, c.checked])
        })
        .collect();
    json!({
        "type": "state",
        "state": state,
        "converged": status.converged,
        "view": status.view,
        "traced": status.traced,
        "reused": status.reused,
        "expired": status.expired,
        "supersampled": status.supersampled,
        "times": times.map(|(median, p99)| [median, p99].map(|t| rounded(f64::from(t) * 1e3, 1))),
        "deadline": rounded(1e3 / f64::from(controls.set.fps.max(0.1)), 1),
        "quality": quality.map(|q| rounded(f64::from(q), 3)),
        "speed": rounded(f64::from(*speed), 3),
        "orbits": orbits,
        "camera": camera.map(protocol::camera_numbers),
        "error": refinement.and_then(|r| r.stated).map(|e| rounded(f64::from(e) * 100.0, 2)),
        "tiles": refinement.map(|r| [r.quiet, r.tiles]),
        "objects": objects(report),
        "maps": insight.as_ref().filter(|(insight, _)| !insight.maps.is_empty()).map(|(insight, _)| {
            insight.map_bytes.map(|bytes| rounded(bytes as f64 / MIB, 1))
        }),
        "textures": insight.as_ref().and_then(|(insight, _)| insight.textures.as_ref()).map(|(report, limit)| {
            [report.used, *limit].map(|bytes| rounded(bytes as f64 / MIB, 1))
        }),
        "actors": actors,
        "stations": stations,
        "timeline": timeline.as_ref().map(|(at, plays)| json!({
            "frame": at.frame, "frames": at.frames, "plays": plays,
            "position": at.position, "lines": at.lines, "story": at.story,
        })),
    })
    .to_string()
}

/// Those that the eye is drawn to most, with what is left to do for them.
fn objects(report: &Report) -> Vec<Value> {
    let Some((insight, names)) = &report.insight else { return Vec::new() };
    let mut seen: Vec<(usize, &ObjectInsight)> =
        insight.objects.iter().enumerate().filter(|(_, object)| object.pixels > 0).collect();
    seen.sort_by(|(i, a), (j, b)| b.attention.total_cmp(&a.attention).then(i.cmp(j)));
    let line = |(index, object): (usize, &ObjectInsight)| {
        json!([
            names.objects.get(index).map_or("", String::as_str),
            object.pixels,
            rounded(f64::from(object.attention), 2),
            object.error.map(|error| rounded(f64::from(error), 2)),
            object.level,
        ])
    };
    seen.into_iter().take(LINES).map(line).collect()
}

/// So many digits behind the point. What is not finite is nothing in JSON.
fn rounded(value: f64, digits: i32) -> f64 {
    let scale = 10_f64.powi(digits);
    (value * scale).round() / scale
}
