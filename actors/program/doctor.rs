//! `foveal doctor`: what this machine offers.

use clap::Args;
use serde_json::json;

use foveal_engine::failure::Failure;
use foveal_terminal::machine::{processor, simd};
use foveal_terminal::print::{print_json, print_line};

/// Arguments of `foveal doctor`.
#[derive(Args, Debug)]
pub struct DoctorArguments {
    /// One JSON document
    #[arg(long)]
    json: bool,
}

/// The display a window could open on, if the environment names one.
fn display() -> Option<String> {
    let named = |variable: &str| std::env::var(variable).ok().filter(|v| !v.is_empty());
    named("WAYLAND_DISPLAY")
        .map(|d| format!("wayland {d}"))
        .or_else(|| named("DISPLAY").map(|d| format!("x11 {d}")))
}

#[cfg(feature = "window")]
use foveal_window::gpu::{AdapterInfo, adapter};

/// Stands for an adapter where the program cannot use one.
#[cfg(not(feature = "window"))]
type AdapterInfo = String;

#[cfg(not(feature = "window"))]
fn adapter() -> Result<AdapterInfo, String> {
    Err("this build has no window; build it with the feature `window`".into())
}

#[cfg(feature = "window")]
fn adapter_json(found: &Result<AdapterInfo, String>) -> serde_json::Value {
    found.as_ref().map_or(
        serde_json::Value::Null,
        |a| json!({"name": a.name, "backend": a.backend, "software": a.software, "driver": a.driver}),
    )
}

#[cfg(not(feature = "window"))]
fn adapter_json(_: &Result<AdapterInfo, String>) -> serde_json::Value {
    serde_json::Value::Null
}

/// Runs the command.
pub fn run(a: &DoctorArguments) -> Result<(), Failure> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let adapter = adapter();
    let document = json!({
        "schema": "foveal.doctor/1",
        "version": env!("CARGO_PKG_VERSION"),
        "scenes": foveal::scene::load::MESHES,
        "processor": processor(),
        "cores": cores,
        "simd": simd(),
        "adapter": adapter_json(&adapter),
        "adapter_missing": adapter.as_ref().err(),
        "display": display(),
        "cache": foveal_engine::opened::cache_folder(None).map(|p| p.display().to_string()),
    });
    if a.json {
        print_json(&document);
        return Ok(());
    }
    print_line(&format!("foveal    {}", env!("CARGO_PKG_VERSION")));
    print_line(&format!(
        "processor {}, {cores} cores, {}",
        processor().unwrap_or_default(),
        simd().join(" ")
    ));
    print_line(&match &adapter {
        Ok(a) => format!("adapter   {a}"),
        Err(e) => format!("adapter   none: {e}; pictures are drawn and shown by the processor"),
    });
    print_line(&format!(
        "display   {}",
        display().unwrap_or_else(|| "none named by DISPLAY or WAYLAND_DISPLAY".into())
    ));
    let cache = document["cache"].as_str().unwrap_or("none (set FOVEAL_CACHE)");
    print_line(&format!("bakes     {cache}"));
    let endings = foveal::scene::load::MESHES.map(|e| format!(".{e}"));
    print_line(&format!("scenes    {}, and .toml for a sidecar", endings.join(", ")));
    Ok(())
}
