//! `foveal bench soak`: a walk of many frames on a virtual clock: memory, jobs and frame times must stay as they are.
//!
//! All actors run on this thread, so that the same frames do the same work whatever else the machine does; a frame ends
//! when its virtual time is over, long before its view has converged.

use std::time::Duration;

use clap::Args;
use foveal::metrics::quantile;
use foveal_runtime::simulate::Simulation;

use super::made::MadeScene;
use super::remote_soak;
use super::scaling::slope;
use super::stages::quick_world;
use foveal_actors::allocator::Allocator;
use foveal_engine::failure::Failure;
use foveal_engine::opened::{Opened, camera};
use foveal_engine::process::{cpu_ns, memory_bytes};
use foveal_engine::{Clock, Engine, Options, Settings};
use foveal_terminal::arguments::{Size, duration};
use foveal_terminal::progress::Progress;
use foveal_terminal::table::{Aim, CommonArguments, Row, finish, median};

/// Arguments of `foveal bench soak`.
#[derive(Args, Debug)]
pub struct SoakArguments {
    /// Bundled scene
    #[arg(long, value_name = "NAME", default_value = "box")]
    scene: String,
    /// Frames of the walk
    #[arg(long, value_name = "N", default_value_t = 100_000, value_parser = clap::value_parser!(u32).range(100..=100_000_000))]
    frames: u32,
    /// Picture size
    #[arg(long, value_name = "WxH", default_value = "32x24")]
    size: Size,
    /// Virtual time per frame, in milliseconds
    #[arg(long, value_name = "MS", default_value_t = 5)]
    frame_ms: u64,
    /// Walk in real time instead, for --time, with a guest process over this link
    #[arg(long, value_name = "LINK", value_parser = ["tcp", "quic"])]
    tracers: Option<String>,
    /// Length of a walk with a guest
    #[arg(long, value_name = "TIME", default_value = "10min", requires = "tracers", value_parser = duration)]
    time: Duration,
    #[command(flatten)]
    common: CommonArguments,
}

/// Frames between two looks at the memory, of all of them.
const LOOKS: u32 = 200;

/// Runs the benchmark.
pub fn run(a: &SoakArguments, progress: Progress) -> Result<(), Failure> {
    if let Some(link) = &a.tracers {
        let rows = remote_soak::rows(&a.scene, (a.size.width, a.size.height), link, a.time, progress)?;
        let notes = ["both on this machine, over loopback".into()];
        return finish("soak-tracers", &rows, &notes, &a.common);
    }
    let world = quick_world(MadeScene::bundled(&a.scene)?.path())?;
    let still = camera(&world.scene, None)?.camera;
    let path = world.scene.paths.first().cloned();
    // However long the walk, it comes to an end.
    let simulation = Simulation { steps_max: u64::MAX, ..Simulation::new(1) };
    let settings = Settings { samples_per_job: 64, ..Settings::new(a.size.width, a.size.height, 2) };
    let options = Options { clock: Clock::Virtual(simulation), ..Options::new(settings) };
    let mut walk = Engine::start(Opened::of_world(world), options)?;
    let bar = progress.bar(u64::from(a.frames), "soak");
    let (mut frame_ms, mut memory) = (Vec::with_capacity(a.frames as usize), Vec::new());
    let every = (a.frames / LOOKS).max(1);
    for number in 0..a.frames {
        let camera = match &path {
            // Back and forth, so that no two frames in a row are the same and caches see old views again.
            Some(path) => path.at(0.1 * number as f32 % path.duration().max(0.1), still.up, still.fov_y),
            None => still,
        };
        let start = cpu_ns();
        walk.frame(&camera, Duration::from_millis(a.frame_ms))?;
        frame_ms.push((cpu_ns() - start) * 1e-6);
        if number % every == every - 1 {
            memory.push((f64::from(number), memory_bytes().map_or(f64::NAN, |bytes| bytes as f64)));
            bar.set_position(u64::from(number));
        }
    }
    bar.finish_and_clear();
    let deliveries = walk.runtime().deliveries() as f64;
    let end = walk.finish(Duration::from_secs(10));
    let lost = match walk.actors().correction {
        Some(c) => walk.runtime().inspect(c.allocator, Allocator::lost_jobs).map_or(f64::NAN, f64::from),
        None => 0.0,
    };
    // What fills up once (caches, buffers) has filled up in the first half.
    let later = &memory[memory.len() / 2..];
    let growth = slope(later);
    let mib = f64::from(1 << 20);
    let of = |share: std::ops::Range<f64>, q: f64| {
        let at = |s: f64| (frame_ms.len() as f64 * s) as usize;
        quantile(frame_ms[at(share.start)..at(share.end)].iter().copied(), q)
    };
    let level = median(&later.iter().map(|m| m.1).collect::<Vec<_>>()).unwrap_or(f64::NAN);
    let name = format!("{}, {} frames of {} × {}", a.scene, a.frames, a.size.width, a.size.height);
    let rows = vec![
        Row::new(format!("{name}: memory, second half"), "MiB", &[level / mib]),
        Row::new(
            "  growth over the second half",
            "% of it",
            &[growth * f64::from(a.frames) / 2.0 / level * 100.0],
        )
        .aim(Aim::AtMost(1.0)),
        Row::new("  growth per frame", "bytes", &[growth]),
        Row::new("frame, median", "CPU ms", &[of(0.5..1.0, 0.5)]),
        Row::new("frame, 99th percentile, last fifth", "CPU ms", &[of(0.8..1.0, 0.99)])
            .against("second fifth", Some(of(0.2..0.4, 0.99)))
            .aim(Aim::RatioAtMost(1.1)),
        Row::new("lost jobs", "", &[lost]).aim(Aim::AtMost(0.0)),
        Row::new("messages that nobody got", "", &[end.dead_letters as f64]).aim(Aim::AtMost(0.0)),
        Row::new("messages", "", &[deliveries]),
    ];
    finish(
        "soak",
        &rows,
        &["a virtual clock: frames end after the same work on every machine".into()],
        &a.common,
    )
}
