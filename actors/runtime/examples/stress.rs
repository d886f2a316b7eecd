//! What happens when everything goes wrong at once: bursts, a slow consumer, a storm of senders, workers that keep
//! dying, and frames that are due all the same. For 1, 2, 4, 8 and 16 threads; give it the cores with `taskset`:
//!
//! `taskset -c 0 cargo run --release -p foveal-runtime --example stress -- 60`
//!
//! The first number is how many seconds workers are killed for; further ones are the numbers of threads.

#![allow(clippy::disallowed_methods, reason = "the main function measures from outside")]

use crossbeam_queue::ArrayQueue;
use foveal_runtime::*;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

#[derive(Serialize, Deserialize)]
struct Data(u64);

#[derive(Serialize, Deserialize)]
struct Urgent(u64);

enum Msg {
    Data(u64),
    Urgent(u64),
}

impl From<Data> for Msg {
    fn from(data: Data) -> Self {
        Self::Data(data.0)
    }
}

impl From<Urgent> for Msg {
    fn from(urgent: Urgent) -> Self {
        Self::Urgent(urgent.0)
    }
}

impl Message for Msg {
    fn digest(&self, digest: &mut Digest) {
        let (Self::Data(number) | Self::Urgent(number)) = self;
        digest.u64(*number);
    }

    fn kind(&self) -> &'static str {
        match self {
            Self::Data(_) => "Data",
            Self::Urgent(_) => "Urgent",
        }
    }

    fn lane(&self) -> Lane {
        if matches!(self, Self::Data(_)) { Lane::Data } else { Lane::Control }
    }
}

/// Takes messages, each of which costs some microseconds; notes how long control messages were on their way.
struct Consumer {
    work_us: u64,
    start: Instant,
    waited_ns: Arc<ArrayQueue<u64>>,
}

fn work(time: Duration) {
    let start = Instant::now();
    while start.elapsed() < time {
        std::hint::spin_loop();
    }
}

impl Actor for Consumer {
    type Msg = Msg;
    const NAME: &'static str = "consumer";

    fn handle(&mut self, message: Msg, _: &mut Cx<'_, Msg>) {
        match message {
            Msg::Data(_) => work(Duration::from_micros(self.work_us)),
            Msg::Urgent(sent) => {
                let _ = self.waited_ns.push(self.start.elapsed().as_nanos() as u64 - sent);
            }
        }
    }
}

/// Sends its share as fast as the mailbox takes it.
struct Sender {
    to: Address<Msg>,
    left: u64,
}

impl Actor for Sender {
    type Msg = Msg;
    const NAME: &'static str = "sender";

    fn started(&mut self, cx: &mut Cx<'_, Msg>) {
        self.handle(Msg::Data(0), cx);
    }

    fn handle(&mut self, _: Msg, cx: &mut Cx<'_, Msg>) {
        for _ in 0..128 {
            if self.left == 0 || cx.tell(&self.to, Msg::Data(self.left)).is_err() {
                break;
            }
            self.left -= 1;
        }
        if self.left > 0 {
            // A full mailbox is a value: come back a little later.
            let _ = cx.after(Duration::from_micros(100), Msg::Data(0));
        }
    }
}

fn p99(values: &mut [u64]) -> f64 {
    values.sort_unstable();
    values.get((values.len().saturating_sub(1)) * 99 / 100).map_or(f64::NAN, |ns| *ns as f64 * 1e-3)
}

/// `senders` × `each` messages into one consumer, control messages in between. Messages a second, p99 of control in µs.
fn storm(threads: usize, senders: u64, each: u64, work_us: u64) -> (f64, f64) {
    let start = Instant::now();
    let waited_ns = Arc::new(ArrayQueue::new(10_000));
    let (mut runtime, (consumer, urgent)) = Runtime::build(Config::live(threads), |wiring| {
        let consumer = wiring.declare::<Consumer>(Bounds::messages(100_000));
        let urgent = wiring.port::<Urgent, Msg>("urgent", &consumer.address());
        for _ in 0..senders {
            let sender = wiring.declare::<Sender>(Bounds::messages(4));
            wiring.spawn(sender, Sender { to: consumer.address(), left: each }, OnPanic::Resume);
        }
        (
            wiring.spawn(
                consumer,
                Consumer { work_us, start, waited_ns: waited_ns.clone() },
                OnPanic::Resume,
            ),
            urgent,
        )
    })
    .expect("builds");
    let mut quiet = false;
    while !quiet {
        let _ = urgent.send(Urgent(start.elapsed().as_nanos() as u64));
        quiet = runtime.pump(Limit::idle_within(Duration::from_millis(1))) == Exit::Idle;
    }
    let seconds = start.elapsed().as_secs_f64();
    let end = runtime.shutdown(Duration::from_secs(60));
    assert!(end.drained && end.dead_letters == 0, "{end:?}");
    let consumed = end.counters[consumer.id().0 as usize].delivered;
    assert!(consumed >= senders * each, "{consumed} of {} came", senders * each);
    let mut waited_ns: Vec<u64> = std::iter::from_fn(|| waited_ns.pop()).collect();
    (consumed as f64 / seconds, p99(&mut waited_ns))
}

struct Job1(u64);

impl Job for Job1 {
    type Brief = u64;

    fn digest(&self, digest: &mut Digest) {
        digest.u64(self.0);
    }

    fn brief(&self) -> u64 {
        self.0
    }
}

struct Hand {
    done: Arc<AtomicU64>,
    deadly: Arc<AtomicU64>,
    job_us: u64,
}

impl Actor for Hand {
    type Msg = Msg;
    const NAME: &'static str = "hand";
    const CLASS: Class = Class::Heavy;

    fn handle(&mut self, _: Msg, _: &mut Cx<'_, Msg>) {}
}

impl Worker for Hand {
    type Job = Job1;

    fn run(&mut self, _: &Job1, _: &mut Cx<'_, Msg>) {
        if self.deadly.swap(0, Ordering::Relaxed) == 1 {
            std::panic::resume_unwind(Box::new("killed"));
        }
        work(Duration::from_micros(self.job_us));
        self.done.fetch_add(1, Ordering::Relaxed);
    }
}

/// Shows a frame after some work of its own, and keeps the pool full.
struct Screen {
    pool: JobPool<Job1>,
    start: Instant,
    frame_ns: Vec<u64>,
    input_ns: Vec<u64>,
    pushed: u64,
    own: Duration,
}

impl Actor for Screen {
    type Msg = Msg;
    const NAME: &'static str = "screen";
    const CLASS: Class = Class::Pinned;

    fn handle(&mut self, message: Msg, cx: &mut Cx<'_, Msg>) {
        let (Msg::Data(sent) | Msg::Urgent(sent)) = message;
        let now = self.start.elapsed().as_nanos() as u64;
        self.input_ns.push(now - sent);
        while cx.push(&self.pool, 0, 0, Job1(self.pushed)).is_ok() {
            self.pushed += 1;
        }
        work(self.own);
        self.frame_ns.push(self.start.elapsed().as_nanos() as u64 - sent);
    }
}

/// Frames at `fps` whose own work needs half of their time, while workers do jobs of a millisecond and one is killed
/// every 100 ms. Share of a frame that 99 of 100 frames take at most, p99 of input in µs, jobs a second.
fn frames(threads: usize, seconds: u64) -> (f64, f64, f64) {
    const FPS: f64 = 60.0;
    let period = Duration::from_secs_f64(1.0 / FPS);
    let start = Instant::now();
    let (done, deadly) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
    let (mut runtime, (screen, input, pool)) = Runtime::build(Config::live(threads), |wiring| {
        let screen = wiring.declare::<Screen>(Bounds::messages(16));
        let input = wiring.port::<Data, Msg>("input", &screen.address());
        let pool = wiring.pool::<Job1>(64);
        for _ in 0..threads.max(2) {
            let hand = wiring.declare::<Hand>(Bounds::messages(4));
            let state = Hand { done: done.clone(), deadly: deadly.clone(), job_us: 1000 };
            wiring.spawn_worker(hand, state, &pool, OnPanic::Resume);
        }
        let (frame_ns, input_ns) = (Vec::new(), Vec::new());
        let state = Screen { pool: pool.clone(), start, frame_ns, input_ns, pushed: 0, own: period / 2 };
        (wiring.spawn(screen, state, OnPanic::Resume), input, pool)
    })
    .expect("builds");
    let mut killed = 0;
    for frame in 0..(seconds as f64 * FPS) as u32 {
        let due = period * frame;
        let now = start.elapsed();
        if now < due {
            runtime.pump(Limit::time(due - now));
        }
        if start.elapsed().as_millis() as u64 / 100 > killed {
            killed += 1;
            deadly.store(1, Ordering::Relaxed);
        }
        // Time counts from when the frame was due.
        let _ = input.send(Data(due.as_nanos() as u64));
        runtime.pump(Limit::time(Duration::from_micros(1)));
    }
    let took = start.elapsed().as_secs_f64();
    let (mut frame_ns, mut input_ns) =
        runtime.inspect(screen, |s| (s.frame_ns.clone(), s.input_ns.clone())).expect("the screen");
    let end = runtime.shutdown(Duration::from_secs(60));
    let stats = pool.stats();
    assert!(end.drained && stats.completed + stats.dead == stats.pushed, "{stats:?}");
    let jobs = done.load(Ordering::Relaxed) as f64 / took;
    (p99(&mut frame_ns) * 1e-6 * FPS, p99(&mut input_ns), jobs)
}

fn main() {
    let mut numbers = std::env::args().skip(1).filter_map(|word| word.parse().ok());
    let seconds = numbers.next().unwrap_or(3);
    let threads: Vec<u64> = numbers.collect();
    let threads = if threads.is_empty() { &[1, 2, 4, 8, 16][..] } else { &threads };
    println!(
        "threads  burst M/s  slow consumer k/s  control p99 µs  storm M/s  control p99 µs  frame p99 / period  input p99 µs  jobs/s"
    );
    for threads in threads.iter().map(|threads| *threads as usize) {
        let (burst, _) = storm(threads, 1, 100_000, 0);
        let (slow, slow_control) = storm(threads, 2, 5_000, 20);
        let (fan_in, control) = storm(threads, 16, 25_000, 0);
        let (frame, input, jobs) = frames(threads, seconds);
        println!(
            "{threads:>7}  {:>9.2}  {:>17.1}  {slow_control:>14.0}  {:>9.2}  {control:>14.0}  {frame:>18.2}  \
             {input:>12.0}  {jobs:>6.0}",
            burst * 1e-6,
            slow * 1e-3,
            fan_in * 1e-6
        );
    }
}
