//! What recording costs a walk.

use std::path::Path;
use std::time::Duration;

use foveal::world::World;
use foveal_runtime::simulate::Simulation;
use foveal_runtime::{Hashing, Record, Trace, TraceStat};
use serde_json::Value;

use super::ours::Nowhere;
use foveal_engine::opened::{Opened, camera};
use foveal_engine::process::cpu_ns;
use foveal_engine::{Clock, Engine, Options, Recording, Settings};

/// Frames of a walk on a virtual clock.
const FRAMES: u32 = 16;
/// Frames of a real walk, and how many of them in a second.
const REAL: (u32, u32) = (40, 10);

/// Processor milliseconds of a walk on a virtual clock, so that each does the same work, recorded with `hashing`.
pub fn cpu_ms(world: &World, hashing: Option<Hashing>) -> Option<f64> {
    let still = camera(&world.scene, None).ok()?.camera;
    let path = world.scene.paths.first()?;
    let record = |hashing| Recording { into: Record::Sink(Box::new(Nowhere)), hashing, command: "bench" };
    let simulation = Simulation { steps_max: u64::MAX, ..Simulation::new(1) };
    let options = Options {
        clock: Clock::Virtual(simulation),
        recording: hashing.map(record),
        ..Options::new(Settings::new(320, 240, 2))
    };
    let mut walk = Engine::start(Opened::of_world(world.clone()), options).ok()?;
    let start = cpu_ns();
    for number in 0..FRAMES {
        let camera = path.at(0.1 * number as f32 % path.duration().max(0.1), still.up, still.fov_y);
        walk.frame(&camera, Duration::from_millis(50)).ok()?;
    }
    walk.finish(Duration::from_secs(10));
    Some((cpu_ns() - start) * 1e-6)
}

/// Bytes a delivery beside what came from outside, and thousands of bytes a second: a real walk, this program run anew.
pub fn log(scene: &Path, hashes: &str) -> Option<(f64, f64)> {
    let file = std::env::temp_dir().join(format!("foveal-walked-{}.fvl", std::process::id()));
    let mut command = std::process::Command::new(std::env::current_exe().ok()?);
    let (frames, fps) = (REAL.0.to_string(), REAL.1.to_string());
    command.arg("walk").arg(scene).args(["--quick", "--json", "--frames", &frames, "--fps", &fps]);
    command.args(["--hashes", hashes, "--record"]).arg(&file);
    let output = command.output();
    let trace = Trace::open(&file);
    let _ = std::fs::remove_file(&file);
    let document: Value = serde_json::from_slice(&output.ok()?.stdout).ok()?;
    let seconds = document["frame_ms"]["median"].as_f64()? * 1e-3 * f64::from(REAL.0);
    let TraceStat { deliveries, file_bytes, external_bytes, pop_bytes, value_bytes, .. } = trace.ok()?.stat();
    let own = file_bytes as f64 - (external_bytes - pop_bytes + value_bytes) as f64;
    Some((own / deliveries as f64, file_bytes as f64 * 1e-3 / seconds))
}
