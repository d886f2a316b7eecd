//! `foveal log`: is a recording whole, what is in it, and its good part.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use foveal_runtime::{ActorId, Trace};
use serde_json::{Value, json};

use foveal_actors::renderer::MARK_FRAME;
use foveal_engine::failure::Failure;
use foveal_engine::files::write_atomic;
use foveal_engine::recording::RecordedRun;
use foveal_terminal::print::{print_json, print_line};

/// Arguments of `foveal log`.
#[derive(Args, Debug)]
pub struct LogArguments {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Check whether a recording is intact; exit with 3 if not
    Check {
        /// The recording
        trace: PathBuf,
    },
    /// Keep only the intact part of a recording
    Cut {
        /// The recording
        trace: PathBuf,
        /// Output file (default: overwrite the recording)
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// Summarise a recording
    Stat {
        /// The recording
        trace: PathBuf,
        /// Print one JSON document
        #[arg(long)]
        json: bool,
    },
}

/// Runs the command.
pub fn run(a: &LogArguments) -> Result<(), Failure> {
    match &a.what {
        What::Check { trace } => check(trace),
        What::Cut { trace, out } => cut(trace, out.as_deref().unwrap_or(trace)),
        What::Stat { trace, json } => stat(trace, *json),
    }
}

fn read(path: &Path) -> Result<Trace, Failure> {
    Trace::open(path).map_err(|e| Failure::file(path, e))
}

fn check(path: &Path) -> Result<(), Failure> {
    let trace = read(path)?;
    RecordedRun::of(&trace, path)?;
    match trace.damage() {
        None => {
            print_line(&format!(
                "intact: {} deliveries, {} bytes",
                trace.stat().deliveries,
                trace.whole_bytes()
            ));
            Ok(())
        }
        Some(damage) => Err(Failure::Input(format!(
            "{}: {} (whole up to byte {}, {} deliveries)",
            path.display(),
            damage.reason,
            damage.offset,
            trace.stat().deliveries
        ))),
    }
}

fn cut(path: &Path, out: &Path) -> Result<(), Failure> {
    let trace = read(path)?;
    let bytes = std::fs::read(path).map_err(|e| Failure::file(path, e))?;
    let whole = usize::try_from(trace.whole_bytes()).unwrap_or(usize::MAX).min(bytes.len());
    if whole < bytes.len() || out != path {
        write_atomic(out, &bytes[..whole])?;
    }
    print_line(&format!("{} of {} bytes kept in {}", whole, bytes.len(), out.display()));
    Ok(())
}

/// To hundredths.
fn round(value: f64) -> f64 {
    (value * 100.0).round() / 100.0
}

fn frames(trace: &Trace) -> usize {
    let actors = 0..trace.header().nodes.len() as u32;
    let marks = |actor| trace.marks(ActorId(actor)).filter(|(_, kind, _)| *kind == MARK_FRAME).count();
    actors.map(marks).sum()
}

fn stat(path: &Path, as_json: bool) -> Result<(), Failure> {
    let trace = read(path)?;
    let run = RecordedRun::of(&trace, path)?;
    let stat = trace.stat();
    let actors: Vec<Value> = (0..)
        .map(ActorId)
        .zip(&trace.header().nodes)
        .map(|(id, node)| json!({"actor": node.name, "deliveries": trace.deliveries(id)}))
        .collect();
    // What came from outside could not be left out; the rest is what recording itself costs.
    let own = stat.order_bytes + stat.pop_bytes + stat.hash_bytes + stat.rejected_bytes;
    let per_delivery = own as f64 / stat.deliveries.max(1) as f64;
    let document = json!({
        "schema": "foveal.log/1",
        "program": run.program,
        "build": trace.header().fingerprint.to_string(),
        "command": run.command,
        "scene": run.scene.display().to_string(),
        "size": [run.settings.width, run.settings.height],
        "tracers": run.settings.tracers,
        "frames": frames(&trace),
        "deliveries": stat.deliveries,
        "segments": stat.segments,
        "complete": trace.complete(),
        "bytes": {
            "file": stat.file_bytes,
            "order": stat.order_bytes,
            "external": stat.external_bytes,
            "pops": stat.pop_bytes,
            "values": stat.value_bytes,
            "hashes": stat.hash_bytes,
            "rejected": stat.rejected_bytes,
        },
        "bytes_per_delivery": round(per_delivery),
        "actors": actors,
    });
    if as_json {
        print_json(&document);
        return Ok(());
    }
    let text = |key: &str| document[key].as_str().unwrap_or_default().to_owned();
    print_line(&format!("{} of {} by {}", text("command"), text("scene"), text("program")));
    print_line(&format!(
        "{} frames of {} × {}, {} deliveries, {} bytes in {} segments{}",
        document["frames"],
        run.settings.width,
        run.settings.height,
        stat.deliveries,
        stat.file_bytes,
        stat.segments,
        if trace.complete() { "" } else { ", cut short" }
    ));
    print_line(&format!(
        "of these: order {}, job pops {}, hashes {}, rejections {} bytes ({per_delivery:.2} a delivery); input {}, \
         values {} bytes",
        stat.order_bytes,
        stat.pop_bytes,
        stat.hash_bytes,
        stat.rejected_bytes,
        stat.external_bytes - stat.pop_bytes,
        stat.value_bytes
    ));
    for actor in &actors {
        print_line(&format!("{:>10}  {}", actor["deliveries"], actor["actor"].as_str().unwrap_or_default()));
    }
    Ok(())
}
