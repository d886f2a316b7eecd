//! What a walk came to, as one document and as lines.

use std::time::Duration;

use foveal::allocation::residency::TextureFacts;
use foveal::metrics::quantile;
use foveal::scene::Scene;
use foveal::scene::texture::held_bytes;
use foveal_actors::insight::{Insight, MapRank};
use foveal_actors::stages::Stage;
use foveal_actors::textures::{Charge, TextureReport, TextureStore};
use foveal_engine::process::peak_memory_bytes;
use foveal_engine::{Engine, Event, Frame};
use foveal_terminal::machine::{machine, today};
use foveal_terminal::print::print_line;
use foveal_terminal::table::figure;
use serde_json::{Value, json};

use super::walk::WalkArguments;

/// What a walk came to.
#[derive(Default)]
pub struct Walked {
    /// Times from beginning to showing, ms, of each frame.
    pub frame_ms: Vec<f32>,
    /// Times of drawing, ms, of each frame.
    pub display_ms: Vec<f32>,
    /// Quality of each frame as estimated, −1 × mean visible error of its pixels, just noticeable differences.
    pub quality: Vec<f32>,
    /// Durations by stage, ms.
    pub stages: Vec<(Stage, f32)>,
    /// Sums over all frames.
    pub traced: u64,
    /// Warped samples that painted something, over all frames.
    pub reused: u64,
    /// Expired samples.
    pub expired: u64,
    /// Samples that came after their view.
    pub late: u64,
    /// Samples that refined the converged view.
    pub refined: u64,
    /// Pixels shown under a first approximation.
    pub approximated: u64,
    /// What went wrong while the walk went on.
    pub warnings: Vec<String>,
    /// Textures after each frame, where they are limited.
    pub textures: Vec<TextureReport>,
    /// Messages delivered, before the actors are told to stop.
    pub delivered: u64,
    /// What the allocator thought last.
    pub insight: Option<Insight>,
    /// Most memory of the process while it walked, bytes.
    pub memory: Option<u64>,
}

impl Walked {
    /// A frame was shown `taken` after it began.
    pub fn took(&mut self, frame: &Frame, taken: Duration, quality: f32) {
        let ms = |d: Duration| d.as_secs_f32() * 1e3;
        self.stages.extend(frame.stages.iter().map(|(stage, sum)| (*stage, ms(*sum))));
        self.frame_ms.push(ms(taken));
        let display = frame.stages.iter().find(|s| s.0 == Stage::Display);
        self.display_ms.push(display.map_or(0.0, |s| ms(s.1)));
        self.quality.push(quality);
        self.traced += u64::from(frame.counts.traced);
        self.reused += u64::from(frame.counts.reused);
        self.expired += u64::from(frame.counts.expired);
        self.late += u64::from(frame.counts.late);
        self.refined += u64::from(frame.counts.refined);
        self.approximated += u64::from(frame.counts.approximated);
        self.warnings.extend(frame.events.iter().filter_map(|event| match event {
            Event::Incident { what } => Some(what.clone()),
            Event::RecordingStopped { reason } => Some(format!("the recording ended early: {reason}")),
            Event::LightGrew | Event::LightFinal | Event::Converged | Event::Refined => None,
        }));
        self.textures.extend(frame.textures.clone().or_else(|| self.textures.last().cloned()));
    }
}

/// Median, 95th and 99th percentile; 0 without values.
pub fn percentiles(values: &[f32]) -> [f64; 3] {
    let values = || values.iter().copied().map(f64::from);
    [0.5, 0.95, 0.99].map(|share| quantile(values(), share).max(0.0))
}

fn round(ms: impl Into<f64>) -> f64 {
    (ms.into() * 1e4).round() / 1e4
}

/// The walk's document, once its actors are at rest.
pub fn document(a: &WalkArguments, engine: &Engine, fps: f32, walked: &Walked, converged: bool) -> Value {
    let (scene, settings) = (&engine.opened().world.scene, engine.settings());
    let (lost_jobs, incidents) = engine.lost();
    // Some incidents are told with frames, and to the allocator as well.
    let mut warnings: Vec<String> = engine.warnings().into_iter().chain(incidents).collect();
    for told in &walked.warnings {
        if !warnings.contains(told) {
            warnings.push(told.clone());
        }
    }
    let [median, p95, p99] = percentiles(&walked.frame_ms);
    let stage_ms: serde_json::Map<String, Value> = Stage::ALL
        .into_iter()
        .map(|stage| {
            let of: Vec<f32> = walked.stages.iter().filter(|s| s.0 == stage).map(|s| s.1).collect();
            (stage.key().to_owned(), json!(round(percentiles(&of)[0])))
        })
        .collect();
    json!({
        "schema": "foveal.walk/1",
        "scene": scene.name,
        "title": scene.title,
        "size": [settings.width, settings.height],
        "frames": walked.frame_ms.len(),
        "fps": fps,
        "workers": settings.tracers,
        "policy": settings.policy.policy.name(),
        "seed": settings.seed,
        "frame_ms": {"median": round(median), "p95": round(p95), "p99": round(p99)},
        "stage_ms": stage_ms,
        "mode": a.mode.name(),
        "over_time": {
            "frame_ms": walked.frame_ms.iter().copied().map(round).collect::<Vec<_>>(),
            "quality": walked.quality.iter().copied().map(round).collect::<Vec<_>>(),
        },
        "samples": {
            "traced": walked.traced + walked.late,
            "reused": walked.reused,
            "expired": walked.expired,
            "splatted": walked.traced + walked.reused,
            "late": walked.late,
            "refined": walked.refined,
            "approximated": walked.approximated,
        },
        "messages": {"delivered": walked.delivered},
        "lost_jobs": lost_jobs,
        "converged": converged,
        "refinement": walked.insight.as_ref().and_then(|i| i.refinement).map(|r| json!({
            "tiles": r.tiles,
            "quiet": r.quiet,
            "noise": r.error,
            "stated": r.stated.filter(|s| s.is_finite()),
        })),
        "plan": super::explain::plan_json(engine.plan()),
        "environment_maps": walked.insight.as_ref().map(|i| maps_json(i, scene)),
        "peak_memory_bytes": peak_memory_bytes(),
        "walk_memory_bytes": walked.memory,
        "machine": machine(),
        "date": today(),
        "recording": a.record.as_ref().map(|f| f.display().to_string()),
        "out": a.out.as_ref().map(|o| o.display().to_string()),
        "warnings": warnings,
    })
}

/// What textures were given, what is lost by that, and what more memory would buy; `None` where they all fit.
pub fn textures_json(store: &TextureStore, reports: &[TextureReport], scene: &Scene) -> Option<Value> {
    let last = reports.last()?;
    let line = |(i, (charge, facts)): (usize, (&Charge, &TextureFacts))| {
        let asked = charge.asked.unwrap_or(facts.coarsest()).min(facts.coarsest());
        json!({
            "texture": scene.textures[i].name,
            "pinned": facts.pinned,
            "pixels": charge.pixels,
            "asked_level": asked,
            "asked_bytes": facts.bytes_from(asked),
            "given_level": charge.given,
            "given_bytes": facts.bytes_from(charge.given),
            "visible_loss": charge.loss,
        })
    };
    let bill: Vec<Value> = last.bill.iter().zip(&store.facts).enumerate().map(line).collect();
    let over_time: Vec<Value> = reports
        .iter()
        .map(|r| {
            json!({
                "used_bytes": r.used,
                "held_bytes": r.held,
                "visible_error": r.visible_error(),
                "finest": r.bill.iter().map(|c| c.given).collect::<Vec<_>>(),
                "losses": r.bill.iter().map(|c| c.loss).collect::<Vec<_>>(),
            })
        })
        .collect();
    Some(json!({
        "limit_bytes": store.limit,
        "peak_used_bytes": reports.iter().map(|r| r.used).max(),
        "peak_held_bytes": held_bytes().1,
        "used_bytes": last.used,
        "all_bytes": store.facts.iter().map(|f| f.bytes_from(0)).sum::<u64>(),
        "levels_loaded": last.counts[0],
        "drops": last.counts[1],
        "visible_error": last.visible_error(),
        "one_more_mib_buys": last.price_per_mib,
        "bill": bill,
        "over_time": over_time,
    }))
}

/// The bill of environment maps.
fn maps_json(insight: &Insight, scene: &Scene) -> Value {
    let line = |rank: &MapRank| {
        json!({
            "object": rank.object,
            "name": scene.objects.get(rank.object as usize).map_or("", |o| o.name.as_str()),
            "asked_bytes": rank.asked_bytes(),
            "given_bytes": rank.given_bytes(),
            "visible_loss": rank.visible_loss(),
            "worth": rank.worth,
        })
    };
    let [used, limit] = insight.map_bytes;
    json!({
        "limit_bytes": limit,
        "used_bytes": used,
        "one_more_mib_buys": insight.map_price_per_mib,
        "bill": insight.maps.iter().map(line).collect::<Vec<_>>(),
    })
}

/// The lines for somebody who asked for no document.
pub fn summary(a: &WalkArguments, d: &Value) {
    let samples = &d["samples"];
    let ms = |key: &str| figure(d["frame_ms"][key].as_f64().unwrap_or(f64::NAN));
    print_line(&format!(
        "{} frames of {}, median {} ms, 99th percentile {} ms",
        d["frames"],
        d["title"].as_str().unwrap_or_default(),
        ms("median"),
        ms("p99"),
    ));
    print_line(&format!(
        "{} samples traced, {} reused, {} expired; {}",
        samples["traced"],
        samples["reused"],
        samples["expired"],
        if d["converged"] == true {
            "the last picture has converged"
        } else {
            "the last picture is still growing"
        },
    ));
    if let Some(stated) = d["refinement"]["stated"].as_f64() {
        print_line(&format!(
            "refined: error below {:.1} % of the mean, in blocks of 8 × 8 pixels",
            100.0 * stated
        ));
    }
    if let Some(out) = &a.out {
        print_line(&format!("open {}", out.join("report.html").display()));
    }
}
