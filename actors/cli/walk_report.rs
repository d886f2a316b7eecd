//! What a walk came to, as one document and as lines.

use serde_json::{Value, json};

use foveal::allocation::residency::TextureFacts;
use foveal::scene::Scene;
use foveal::scene::plan::ScenePlan;

use super::output::{peak_memory_bytes, print_line};
use super::report::FramePoint;
use super::session::Session;
use super::walk::WalkArguments;
use crate::insight::{Insight, MapRank};
use crate::settings::Settings;
use crate::stages::Stage;
use crate::textures::{Charge, TextureReport, TextureStore};

/// What a walk came to.
pub struct Walked {
    /// Times from beginning to showing, ms, of each frame.
    pub frame_ms: Vec<f32>,
    /// The same frames for the plot.
    pub points: Vec<FramePoint>,
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
    /// Textures after each frame, where they are limited.
    pub textures: Vec<TextureReport>,
    /// What the allocator thought last.
    pub insight: Option<Insight>,
    /// Most memory of the process while it walked, bytes.
    pub memory: Option<u64>,
}

/// Median, 95th and 99th percentile.
pub fn percentiles(values: &[f32]) -> [f32; 3] {
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f32::total_cmp);
    let at = |q: f32| match sorted.len() {
        0 => 0.0,
        n => sorted[((n - 1) as f32 * q).round() as usize],
    };
    [at(0.5), at(0.95), at(0.99)]
}

fn round(ms: f32) -> f64 {
    (f64::from(ms) * 1e4).round() / 1e4
}

#[expect(clippy::too_many_arguments, reason = "the one caller has them all")]
pub fn document(
    a: &WalkArguments,
    session: &Session,
    settings: &Settings,
    plan: &ScenePlan,
    fps: f32,
    walked: &Walked,
    converged: bool,
    deliveries: u64,
    lost_jobs: u32,
    incidents: &[String],
) -> Value {
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
        "scene": session.world.scene.name,
        "title": session.world.scene.title,
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
            "frame_ms": walked.points.iter().map(|p| round(p.total_ms)).collect::<Vec<_>>(),
            "quality": walked.points.iter().map(|p| round(p.quality)).collect::<Vec<_>>(),
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
        "messages": {"delivered": deliveries},
        "lost_jobs": lost_jobs,
        "converged": converged,
        "plan": super::explain::plan_json(plan),
        "environment_maps": walked.insight.as_ref().map(|i| maps_json(i, &session.world.scene)),
        "peak_memory_bytes": peak_memory_bytes(),
        "walk_memory_bytes": walked.memory,
        "machine": super::doctor::machine(),
        "recording": a.record.as_ref().map(|f| f.display().to_string()),
        "out": a.out.as_ref().map(|o| o.display().to_string()),
        "warnings": session.warnings.iter().chain(incidents).collect::<Vec<_>>(),
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
    print_line(&format!(
        "{} frames of {}, median {} ms, 99th percentile {} ms",
        d["frames"],
        d["title"].as_str().unwrap_or_default(),
        d["frame_ms"]["median"],
        d["frame_ms"]["p99"],
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
    if let Some(out) = &a.out {
        print_line(&format!("open {}", out.join("report.html").display()));
    }
}
