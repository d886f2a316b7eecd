//! `foveal bench messages`: what a message costs, with and without recording, beside other runtimes and channels.

pub mod load;
mod ours;
#[cfg(feature = "peers")]
mod peers;
mod replayed;
mod walked;

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::Args;
use foveal_runtime::Hashing;
use serde_json::Value;

use foveal_engine::failure::Failure;
use foveal_terminal::progress::Progress;
use foveal_terminal::table::{Aim, CommonArguments, Row, finish};
use load::{Cost, Large, Small};

/// Arguments of `foveal bench messages`.
#[derive(Args, Debug)]
pub struct MessagesArguments {
    /// Messages per measurement, in thousands
    #[arg(long, value_name = "K", default_value_t = 200, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    thousands: u64,
    /// Scene of the simulated walks
    #[arg(long, value_name = "FILE", default_value = "scenes/box/box.toml")]
    scene: PathBuf,
    /// Skip what takes longest: simulated walks, stress runs and faults
    #[arg(long)]
    quick: bool,
    #[command(flatten)]
    common: CommonArguments,
}

/// Jobs a second, in millions, and processor nanoseconds of a message (each job is sent twice).
#[derive(Default)]
struct Fans {
    rate: Vec<f64>,
    cpu: Vec<f64>,
}

impl Fans {
    fn add(&mut self, jobs: u64, cost: Cost) {
        self.rate.push(jobs as f64 / cost.seconds * 1e-6);
        self.cpu.push(cost.cpu_ns / (2 * jobs) as f64);
    }
}

/// Everything that is run once a round, so that all suffer alike from what else the machine does.
#[derive(Default)]
struct Rounds {
    small: Fans,
    large: Fans,
    order: Fans,
    hashed: Fans,
    exact: Fans,
    ping_pong: Vec<f64>,
    wake: Vec<f64>,
    control: Vec<f64>,
    span: Vec<f64>,
    ring: Vec<f64>,
    ring_alone: Vec<f64>,
    #[cfg(feature = "peers")]
    peers: Peers,
}

#[cfg(feature = "peers")]
#[derive(Default)]
struct Peers {
    small: [Fans; 4],
    large: [Fans; 4],
    ping_pong: Vec<f64>,
    wake: Vec<f64>,
}

impl Rounds {
    fn round(&mut self, jobs: u64) {
        let threads = 2;
        self.small.add(jobs, ours::fan::<Small>(threads, jobs, None));
        #[cfg(feature = "peers")]
        self.peers.round(jobs);
        self.order.add(jobs, ours::fan::<Small>(threads, jobs, Some(Hashing::Off)));
        self.hashed.add(jobs, ours::fan::<Small>(threads, jobs, Some(Hashing::Every(64))));
        self.exact.add(jobs, ours::fan::<Small>(threads, jobs, Some(Hashing::Exact)));
        self.large.add(jobs / 4, ours::fan::<Large>(threads, jobs / 4, None));
        self.ping_pong.push(ours::ping_pong(threads, jobs));
        self.wake.push(ours::wake(300));
        self.control.push(ours::control_latency());
        // A turn of a full budget carries one span.
        self.span.push(span_ns() / 128.0);
        let ring = |clock| foveal_runtime::ring_cost(1_000_000, clock).as_nanos() as f64 * 1e-6;
        self.ring.push(ring(true));
        self.ring_alone.push(ring(false));
    }
}

#[cfg(feature = "peers")]
impl Peers {
    fn round(&mut self, jobs: u64) {
        use peers::*;
        let few = jobs / 4;
        self.small[0].add(jobs, threads_fan::<Small, Channel<Small>>(jobs));
        self.small[1].add(few, ractor_fan::<Small>(few));
        self.small[2].add(few, kameo_fan::<Small>(few));
        self.small[3].add(few, threads_fan::<Small, Locked<Small>>(few));
        self.large[0].add(few, threads_fan::<Large, Channel<Large>>(few));
        self.large[1].add(few, ractor_fan::<Large>(few));
        self.large[2].add(few, kameo_fan::<Large>(few));
        self.large[3].add(few, threads_fan::<Large, Locked<Large>>(few));
        self.ping_pong.push(threads_ping_pong::<Channel<u64>>(few));
        self.wake.push(threads_wake::<Channel<u64>>(300));
    }
}

/// Nanoseconds of a span that nobody listens to.
fn span_ns() -> f64 {
    const SPANS: u32 = 1_000_000;
    let start = Instant::now();
    for number in 0..SPANS {
        let _span = tracing::trace_span!("turn", number = std::hint::black_box(number)).entered();
    }
    start.elapsed().as_nanos() as f64 / f64::from(SPANS)
}

/// Runs the command.
pub fn run(a: &MessagesArguments, progress: Progress) -> Result<(), Failure> {
    let jobs = a.thousands * 1000;
    let bar = progress.bar(u64::from(a.common.runs) + 5, "messages");
    let mut rounds = Rounds::default();
    for _ in 0..a.common.runs {
        rounds.round(jobs);
        bar.inc(1);
    }
    let mut rows = rows(&rounds);
    let (order, hashed) = replayed::log_bytes();
    rows.push(Row::new("log, 16 senders at random: order", "B/message", &[order]).aim(Aim::AtMost(1.0)));
    rows.push(Row::new("log, the same with a hash every 256", "B/message", &[hashed]).aim(Aim::AtMost(1.0)));
    let (live, again) = replayed::speeds();
    rows.push(Row::new("replay, the same", "M messages/s", &[again]).against("recording it", Some(live)));
    bar.inc(1);
    if !a.quick {
        let (differ, seconds) = replayed::seeds(10_000);
        rows.push(
            Row::new("10,000 simulated seeds: runs that differ", "", &[differ as f64]).aim(Aim::AtMost(0.0)),
        );
        rows.push(Row::new("the same, twice each", "s", &[seconds]));
        bar.inc(1);
        let wrong = replayed::stress(200) as f64;
        rows.push(
            Row::new("200 recorded stress runs: replays that differ", "", &[wrong]).aim(Aim::AtMost(0.0)),
        );
        let named = replayed::flips(200) as f64;
        rows.push(
            Row::new("200 flipped bits: named at their delivery", "", &[named]).aim(Aim::AtLeast(200.0)),
        );
        bar.inc(1);
        rows.extend(of_a_walk(a)?);
        bar.inc(1);
        let seconds = simulated(&a.scene);
        let what = "1,000 simulated walks of the box, 64 × 64";
        rows.push(Row::new(what, "s", seconds.as_slice()).aim(Aim::AtMost(60.0)));
    }
    bar.finish_and_clear();
    let mut notes = vec![format!(
        "A fan has 1 source, 4 workers and 1 collector on 2 threads, and {jobs} jobs, each of which is sent twice."
    )];
    if cfg!(not(feature = "peers")) {
        notes
            .push(
                "This build has no peers, so these rows have no number to be compared with; built with `--features peers`, \
                 it measures ractor, kameo, crossbeam and a mutex with a condition variable as well."
                    .into(),
            );
    }
    finish("messages", &rows, &notes, &a.common)
}

fn rows(r: &Rounds) -> Vec<Row> {
    let median = foveal_terminal::table::median;
    let mut rows = Vec::new();
    let cpu = &r.small.cpu;
    #[cfg(feature = "peers")]
    let against = {
        let names = ["crossbeam", "ractor", "kameo", "mutex + condvar"];
        let of = |fans: &[Fans; 4]| -> Vec<(&'static str, Option<f64>)> {
            names.into_iter().zip(fans.iter().map(|f| median(&f.rate))).collect()
        };
        (of(&r.peers.small), of(&r.peers.large), median(&r.peers.ping_pong), median(&r.peers.wake))
    };
    #[cfg(not(feature = "peers"))]
    let against = {
        let names = ["crossbeam", "ractor", "kameo", "mutex + condvar"].map(|name| (name, None));
        (names.to_vec(), names.to_vec(), None, None)
    };
    let (small, large, ping_pong, wake) = against;
    for ((peer, value), aim) in small.into_iter().zip([0.8, 4.0, 4.0, 10.0]) {
        let row = Row::new("fan, 64 B", "M jobs/s", &r.small.rate).against(peer, value);
        rows.push(row.aim(Aim::RatioAtLeast(aim)));
    }
    rows.push(Row::new("fan, 64 B", "CPU ns/message", cpu).aim(Aim::AtMost(75.0)));
    for ((peer, value), aim) in large.into_iter().zip([Some(0.7), Some(1.5), None, None]) {
        let row = Row::new("fan, 4 KiB, pooled", "M jobs/s", &r.large.rate).against(peer, value);
        rows.push(match aim {
            Some(aim) => row.aim(Aim::RatioAtLeast(aim)),
            None => row,
        });
    }
    let row = Row::new("ping-pong, a message", "ns", &r.ping_pong).against("crossbeam", ping_pong);
    rows.push(row.aim(Aim::AtMost(200.0)));
    let row = Row::new("wake from idle", "µs", &r.wake).against("crossbeam", wake);
    rows.push(row.aim(Aim::RatioAtMost(1.5)));
    let off = median(cpu);
    let row =
        |what: &str, fans: &Fans| Row::new(what, "CPU ns/message", &fans.cpu).against("not recorded", off);
    rows.push(row("recorded: order", &r.order).aim(Aim::RatioAtMost(1.10)));
    rows.push(row("recorded: order, hash every 64", &r.hashed).aim(Aim::RatioAtMost(1.25)));
    rows.push(row("recorded: order, every hash", &r.exact));
    let row = Row::new("control, 100,000 messages queued, 99 %", "µs", &r.control);
    rows.push(row.aim(Aim::AtMost(200.0)));
    rows.push(Row::new("tracing off", "ns/message", &r.span).aim(Aim::AtMost(1.0)));
    rows.push(Row::new("ring of turns on, its clock reading too", "ns/turn", &r.ring).aim(Aim::AtMost(25.0)));
    rows.push(Row::new("ring of turns on, without", "ns/turn", &r.ring_alone));
    rows
}

/// What recording adds to a walk.
fn of_a_walk(a: &MessagesArguments) -> Result<Vec<Row>, Failure> {
    let world = super::stages::quick_world(&a.scene)?;
    let hashings = [None, Some(Hashing::Off), Some(Hashing::Every(256)), Some(Hashing::Said)];
    let mut cpu = hashings.map(|_| Vec::new());
    for _ in 0..a.common.runs {
        for (hashing, cpu) in hashings.into_iter().zip(&mut cpu) {
            cpu.extend(walked::cpu_ms(&world, hashing));
        }
    }
    let [off, order, sparse, each] = cpu;
    let without = foveal_terminal::table::median(&off);
    let row = |what: &str, cpu: &[f64]| Row::new(what, "CPU ms", cpu).against("not recorded", without);
    let mut rows = vec![
        row("a walk recorded: order", &order).aim(Aim::RatioAtMost(1.01)),
        row("a walk recorded: order, hash every 256", &sparse).aim(Aim::RatioAtMost(1.02)),
        row("a walk recorded: order, every hash", &each).aim(Aim::RatioAtMost(1.02)),
    ];
    for (what, hashes, aim) in [("a hash every 256", "sparse", 1.0), ("every hash", "each", 1.5)] {
        let (bytes, rate) = walked::log(&a.scene, hashes).unzip();
        let row = Row::new(format!("log of a walk, {what}"), "B/message", bytes.as_slice());
        rows.push(row.aim(Aim::AtMost(aim)));
        let row = Row::new(format!("log of a walk, {what}"), "kB/s", rate.as_slice());
        rows.push(row.aim(Aim::AtMost(20.0)));
    }
    Ok(rows)
}

/// Seconds of 1,000 simulated walks: this program, run anew.
fn simulated(scene: &Path) -> Option<f64> {
    let program = std::env::current_exe().ok()?;
    let mut command = std::process::Command::new(program);
    command.arg("simulate").arg(scene).args(["--seeds", "0..1000", "--size", "64x64", "--json", "--quiet"]);
    let document: Value = serde_json::from_slice(&command.output().ok()?.stdout).ok()?;
    document["failures"].as_array().filter(|f| f.is_empty())?;
    document["seconds"].as_f64()
}
