//! Two actors pass a ball; then one source, four workers and a collector. Prints what a message costs.
//!
//! `cargo run --release -p foveal-runtime --example ping_pong`

#![allow(clippy::disallowed_methods, reason = "the main function measures from outside")]

use foveal_runtime::*;
use std::time::Instant;

/// 64 bytes, like a small message of a real system.
struct Ball {
    number: u64,
    _rest: [u64; 7],
}

impl Message for Ball {
    fn digest(&self, digest: &mut Digest) {
        digest.u64(self.number);
    }

    fn kind(&self) -> &'static str {
        "Ball"
    }
}

fn ball(number: u64) -> Ball {
    Ball { number, _rest: [0; 7] }
}

struct Player {
    other: Address<Ball>,
    serves: bool,
}

impl Actor for Player {
    type Msg = Ball;
    const NAME: &'static str = "player";

    fn started(&mut self, cx: &mut Cx<'_, Ball>) {
        if self.serves {
            let _ = cx.tell(&self.other, ball(HITS));
        }
    }

    fn handle(&mut self, message: Ball, cx: &mut Cx<'_, Ball>) {
        if message.number > 0 {
            let _ = cx.tell(&self.other, ball(message.number - 1));
        }
    }
}

const HITS: u64 = 1_000_000;
const JOBS: u64 = 2_000_000;
const WINDOW: u64 = 256;

/// Keeps a window of balls with each worker.
struct Source {
    workers: Vec<Address<Ball>>,
    sent: u64,
}

impl Actor for Source {
    type Msg = Ball;
    const NAME: &'static str = "source";

    fn started(&mut self, cx: &mut Cx<'_, Ball>) {
        for _ in 0..WINDOW {
            for worker in 0..self.workers.len() {
                self.send(worker, cx);
            }
        }
    }

    /// The collector returns credits, 64 for one worker at a time.
    fn handle(&mut self, credit: Ball, cx: &mut Cx<'_, Ball>) {
        for _ in 0..64 {
            self.send(credit.number as usize, cx);
        }
    }
}

impl Source {
    fn send(&mut self, worker: usize, cx: &mut Cx<'_, Ball>) {
        if self.sent < JOBS {
            self.sent += 1;
            cx.tell(&self.workers[worker], ball(worker as u64)).expect("credits bound what waits");
        }
    }
}

struct Relay {
    to: Address<Ball>,
}

impl Actor for Relay {
    type Msg = Ball;
    const NAME: &'static str = "relay";

    fn handle(&mut self, message: Ball, cx: &mut Cx<'_, Ball>) {
        cx.tell(&self.to, message).expect("credits bound what waits");
    }
}

struct Collector {
    source: Address<Ball>,
    counts: [u64; 4],
}

impl Actor for Collector {
    type Msg = Ball;
    const NAME: &'static str = "collector";

    fn handle(&mut self, message: Ball, cx: &mut Cx<'_, Ball>) {
        let count = &mut self.counts[message.number as usize];
        *count += 1;
        if count.is_multiple_of(64) {
            cx.tell(&self.source, ball(message.number)).expect("credits bound what waits");
        }
    }
}

fn ping_pong(wiring: &mut Wiring) {
    let (left, right) =
        (wiring.declare::<Player>(Bounds::messages(4)), wiring.declare::<Player>(Bounds::messages(4)));
    let (to_left, to_right) = (left.address(), right.address());
    wiring.spawn(left, Player { other: to_right, serves: true }, OnPanic::Resume);
    wiring.spawn(right, Player { other: to_left, serves: false }, OnPanic::Resume);
}

fn fan(wiring: &mut Wiring) {
    let source = wiring.declare::<Source>(Bounds::messages(64));
    let relays: Vec<_> = (0..4).map(|_| wiring.declare::<Relay>(Bounds::messages(512))).collect();
    let collector = wiring.declare::<Collector>(Bounds::messages(2048));
    let state = Source { workers: relays.iter().map(Declared::address).collect(), sent: 0 };
    let (to_source, to_collector) = (source.address(), collector.address());
    wiring.spawn(source, state, OnPanic::Resume);
    for relay in relays {
        wiring.spawn(relay, Relay { to: to_collector.clone() }, OnPanic::Resume);
    }
    wiring.spawn(collector, Collector { source: to_source, counts: [0; 4] }, OnPanic::Resume);
}

/// CPU time of this process in nanoseconds, to 10 ms; on a busy machine it says more than the clock.
fn cpu_ns() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let ticks = stat.rsplit(')').next().map(|fields| fields.split_whitespace().skip(11).take(2));
    ticks.into_iter().flatten().filter_map(|field| field.parse::<f64>().ok()).sum::<f64>() * 1e7
}

fn measure(name: &str, threads: usize, hashing: Option<Hashing>, wire: impl FnOnce(&mut Wiring)) {
    let mut config = Config::live(threads);
    if let Some(hashing) = hashing {
        config.hashing = hashing;
        config.record = Some(Record::Sink(Box::new(std::io::sink())));
    }
    let (start, cpu) = (Instant::now(), cpu_ns());
    let (mut runtime, ()) = Runtime::build(config, wire).expect("threads");
    runtime.pump(Limit::IDLE);
    let (elapsed, cpu) = (start.elapsed().as_nanos() as f64, cpu_ns() - cpu);
    let counters = runtime.counters();
    let messages = runtime.deliveries();
    let turns: u64 = counters.iter().map(|actor| actor.turns).sum();
    println!(
        "{name:<10} {threads} threads  {:<18} {:7.1} ns/message  {:7.1} CPU ns/message  {:6.1} messages/turn",
        hashing.map_or("not recorded".to_owned(), |hashing| format!("{hashing:?}")),
        elapsed / messages as f64,
        cpu / messages as f64,
        messages as f64 / turns as f64,
    );
}

fn main() {
    for threads in [0, 1, 2] {
        for hashing in [None, Some(Hashing::Off), Some(Hashing::Every(64)), Some(Hashing::Exact)] {
            measure("ping-pong", threads, hashing, ping_pong);
        }
    }
    for threads in [0, 1, 2] {
        for hashing in [None, Some(Hashing::Off), Some(Hashing::Every(64)), Some(Hashing::Exact)] {
            measure("fan 1-4-1", threads, hashing, fan);
        }
    }
}
