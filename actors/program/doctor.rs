//! `foveal doctor`: what this machine offers.

use clap::Args;
use serde_json::json;

use foveal_engine::failure::Failure;
use foveal_terminal::machine::{processor, simd};
use foveal_terminal::print::{print_json, print_line};

/// Arguments of `foveal doctor`.
#[derive(Args, Debug)]
pub struct DoctorArguments {
    /// Print one JSON document
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

/// What `foveal serve` finds here: whether it can listen, by what it encrypts, what would open a browser.
#[cfg(feature = "serve")]
fn serving() -> (serde_json::Value, String) {
    let listens = std::net::TcpListener::bind("127.0.0.1:0").map_err(|e| e.to_string());
    let on_path = |command: &std::process::Command| {
        let folders = std::env::var_os("PATH").unwrap_or_default();
        let found =
            std::env::split_paths(&folders).any(|folder| folder.join(command.get_program()).is_file());
        found.then(|| command.get_program().to_string_lossy().into_owned())
    };
    let browser = open::commands("http://127.0.0.1").iter().find_map(on_path);
    let tls = foveal_serve::server::Tls::BY;
    let line = format!(
        "{}; encrypts with {tls}; {}",
        match &listens {
            Ok(_) => "can listen at 127.0.0.1".to_owned(),
            Err(e) => format!("cannot listen at 127.0.0.1: {e}"),
        },
        match &browser {
            Some(program) => format!("--open uses {program}"),
            None => "found no program for --open to open a browser with".to_owned(),
        }
    );
    (json!({"listens": listens.is_ok(), "why_not": listens.err(), "tls": tls, "opens_by": browser}), line)
}

#[cfg(not(feature = "serve"))]
fn serving() -> (serde_json::Value, String) {
    (serde_json::Value::Null, "none: this build has no server; build it with the feature `serve`".into())
}

/// Runs the command.
pub fn run(a: &DoctorArguments) -> Result<(), Failure> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let adapter = adapter();
    let (served, serves) = serving();
    let document = json!({
        "schema": "foveal.doctor/1",
        "version": env!("CARGO_PKG_VERSION"),
        "scenes": foveal_files::load::MESHES,
        "processor": processor(),
        "cores": cores,
        "simd": simd(),
        "adapter": adapter_json(&adapter),
        "adapter_missing": adapter.as_ref().err(),
        "display": display(),
        "serve": served,
        "bits": format!("{:016x}", foveal_actors::station::bits::probe()),
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
    print_line(&format!("serve     {serves}"));
    let bits = document["bits"].as_str().unwrap_or_default();
    print_line(&format!("bits      {bits}: must be equal on machines that trace together"));
    let cache = document["cache"].as_str().unwrap_or("none (set FOVEAL_CACHE)");
    print_line(&format!("bakes     {cache}"));
    let endings = foveal_files::load::MESHES.map(|e| format!(".{e}"));
    print_line(&format!("scenes    {}, and .toml for a sidecar", endings.join(", ")));
    Ok(())
}
