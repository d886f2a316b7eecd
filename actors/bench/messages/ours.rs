//! The runtime of this program under the same loads as its peers.

use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use crossbeam_queue::ArrayQueue;
use foveal::metrics::quantile;
use foveal_runtime::*;
use serde::{Deserialize, Serialize};

use super::load::{Cost, IN_FLIGHT, Payload, WORKERS, cost};

/// The order to begin.
#[derive(Serialize, Deserialize)]
pub struct Go(u64);

/// Jobs that the source hands out in one turn, if it has the credits.
const BURST: usize = 512;

/// All inboxes of the fan.
enum Fan<P> {
    Go(u64),
    On,
    Work(P),
    Credit(u32),
}

impl<P: Payload> From<Go> for Fan<P> {
    fn from(go: Go) -> Self {
        Self::Go(go.0)
    }
}

impl<P: Payload> Message for Fan<P> {
    fn digest(&self, digest: &mut Digest) {
        match self {
            Self::Go(count) => digest.u64(*count),
            Self::On => {}
            Self::Work(payload) => digest.u64(payload.sum()),
            Self::Credit(count) => digest.u32(*count),
        }
    }

    fn kind(&self) -> &'static str {
        "Fan"
    }
}

struct Source<P: Payload> {
    workers: Vec<Address<Fan<P>>>,
    credits: Credits,
    sent: u64,
    count: u64,
    waits: bool,
    pool: P::Pool,
}

impl<P: Payload> Actor for Source<P> {
    type Msg = Fan<P>;
    const NAME: &'static str = "source";

    fn handle(&mut self, message: Fan<P>, cx: &mut Cx<'_, Fan<P>>) {
        match message {
            Fan::Go(count) => (self.sent, self.count, self.waits) = (0, count, false),
            Fan::Credit(count) => {
                self.credits.give(count);
                if !std::mem::take(&mut self.waits) {
                    return;
                }
            }
            Fan::On | Fan::Work(_) => {}
        }
        for _ in 0..BURST {
            if self.sent == self.count {
                return;
            }
            if !self.credits.take(1) {
                self.waits = true;
                return;
            }
            let worker = &self.workers[self.sent as usize % WORKERS];
            let _ = cx.tell(worker, Fan::Work(P::make(&self.pool, self.sent)));
            self.sent += 1;
        }
        let me = cx.address().clone();
        let _ = cx.tell(&me, Fan::On);
    }
}

struct Middle<P: Payload> {
    to: Address<Fan<P>>,
    sum: u64,
}

impl<P: Payload> Actor for Middle<P> {
    type Msg = Fan<P>;
    const NAME: &'static str = "worker";

    fn handle(&mut self, message: Fan<P>, cx: &mut Cx<'_, Fan<P>>) {
        if let Fan::Work(payload) = message {
            self.sum = self.sum.wrapping_add(payload.sum());
            let _ = cx.tell(&self.to, Fan::Work(payload));
        }
    }
}

struct Collector<P: Payload> {
    source: Address<Fan<P>>,
    owed: u32,
    got: Arc<AtomicU64>,
    count: u64,
    pool: P::Pool,
}

impl<P: Payload> Actor for Collector<P> {
    type Msg = Fan<P>;
    const NAME: &'static str = "collector";

    fn handle(&mut self, message: Fan<P>, cx: &mut Cx<'_, Fan<P>>) {
        if let Fan::Work(payload) = message {
            payload.give_back(&self.pool);
            self.count += 1;
            self.owed += 1;
            if self.owed == 128 {
                self.got.store(self.count, Ordering::Relaxed);
                let _ = cx.tell(&self.source, Fan::Credit(std::mem::take(&mut self.owed)));
            }
        }
    }
}

/// A writer that keeps nothing.
pub struct Nowhere;

impl Write for Nowhere {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// One source, four workers, one collector: `jobs` payloads, each sent twice. `hashing` records them.
pub fn fan<P: Payload>(threads: usize, jobs: u64, hashing: Option<Hashing>) -> Cost {
    let mut config = Config::live(threads);
    if let Some(hashing) = hashing {
        config.hashing = hashing;
        config.record = Some(Record::Sink(Box::new(Nowhere)));
    }
    let got = Arc::new(AtomicU64::new(0));
    let pool = P::pool();
    let built = Runtime::build(config, |wiring| {
        let source = wiring.declare::<Source<P>>(Bounds::messages(64));
        let collector = wiring.declare::<Collector<P>>(Bounds::messages(IN_FLIGHT));
        let go = wiring.port::<Go, Fan<P>>("go", &source.address());
        let workers: Vec<_> =
            (0..WORKERS).map(|_| wiring.declare::<Middle<P>>(Bounds::messages(IN_FLIGHT))).collect();
        let addresses = workers.iter().map(Declared::address).collect();
        for worker in workers {
            wiring.spawn(worker, Middle { to: collector.address(), sum: 0 }, OnPanic::Stop);
        }
        let to = source.address();
        let credits = Credits::new(IN_FLIGHT as u32);
        let first =
            Source { workers: addresses, credits, sent: 0, count: 0, waits: false, pool: pool.clone() };
        wiring.spawn(source, first, OnPanic::Stop);
        wiring.spawn(
            collector,
            Collector { source: to, owed: 0, got: got.clone(), count: 0, pool },
            OnPanic::Stop,
        );
        go
    });
    let Ok((mut runtime, go)) = built else { return Cost { seconds: f64::NAN, cpu_ns: f64::NAN } };
    // Threads are up and parked.
    runtime.pump(Limit::IDLE);
    let jobs = jobs / 128 * 128;
    let took = cost(|| {
        let _ = go.send(Go(jobs));
        runtime.pump(Limit::IDLE);
    });
    let whole = got.load(Ordering::Relaxed) == jobs;
    runtime.shutdown(Duration::from_secs(5));
    if whole { took } else { Cost { seconds: f64::NAN, cpu_ns: f64::NAN } }
}

enum Ball {
    Serve(u64),
    Hop(u64),
}

impl From<Go> for Ball {
    fn from(go: Go) -> Self {
        Self::Serve(go.0)
    }
}

impl Message for Ball {
    fn digest(&self, digest: &mut Digest) {
        let (Self::Serve(left) | Self::Hop(left)) = self;
        digest.u64(*left);
    }

    fn kind(&self) -> &'static str {
        "Ball"
    }
}

struct Player {
    other: Option<Address<Ball>>,
    times: Arc<ArrayQueue<u64>>,
    begun: Option<Instant>,
}

/// Hops between two readings of the clock.
pub const HOPS: u64 = 64;

impl Actor for Player {
    type Msg = Ball;
    const NAME: &'static str = "player";

    fn handle(&mut self, message: Ball, cx: &mut Cx<'_, Ball>) {
        let (Ball::Serve(left) | Ball::Hop(left)) = message;
        if left.is_multiple_of(HOPS)
            && let Some(begun) = self.begun.replace(Instant::now())
        {
            let _ = self.times.push(begun.elapsed().as_nanos() as u64 / HOPS);
        }
        if left > 0
            && let Some(other) = &self.other
        {
            let _ = cx.tell(other, Ball::Hop(left - 1));
        }
    }
}

/// Median nanoseconds of a message between two actors that wait for each other.
pub fn ping_pong(threads: usize, hops: u64) -> f64 {
    let times = Arc::new(ArrayQueue::new((hops / HOPS) as usize + 1));
    let built = Runtime::build(Config::live(threads), |wiring| {
        let players = [(); 2].map(|()| wiring.declare::<Player>(Bounds::messages(4)));
        let addresses = players.each_ref().map(Declared::address);
        let go = wiring.port::<Go, Ball>("go", &addresses[0]);
        for (player, other) in players.into_iter().zip([1, 0]) {
            let other = Some(addresses[other].clone());
            wiring.spawn(player, Player { other, times: Arc::clone(&times), begun: None }, OnPanic::Stop);
        }
        go
    });
    let Ok((mut runtime, go)) = built else { return f64::NAN };
    runtime.pump(Limit::IDLE);
    let _ = go.send(Go(hops));
    runtime.pump(Limit::IDLE);
    let times: Vec<f64> = std::iter::from_fn(|| times.pop()).map(|ns| ns as f64).collect();
    runtime.shutdown(Duration::from_secs(5));
    quantile(times, 0.5)
}

struct Wakes(Arc<ArrayQueue<u64>>, Instant);

impl Actor for Wakes {
    type Msg = Ball;
    const NAME: &'static str = "wakes";

    fn handle(&mut self, message: Ball, _: &mut Cx<'_, Ball>) {
        if let Ball::Serve(sent) = message {
            let _ = self.0.push((self.1.elapsed().as_nanos() as u64).saturating_sub(sent));
        }
    }
}

/// Median microseconds from sending to a sleeping system to the first line of its handler.
pub fn wake(count: u64) -> f64 {
    let times = Arc::new(ArrayQueue::new(count as usize));
    let start = Instant::now();
    let built = Runtime::build(Config::live(2), |wiring| {
        let wakes = wiring.declare::<Wakes>(Bounds::messages(4));
        let go = wiring.port::<Go, Ball>("go", &wakes.address());
        wiring.spawn(wakes, Wakes(Arc::clone(&times), start), OnPanic::Stop);
        go
    });
    let Ok((mut runtime, go)) = built else { return f64::NAN };
    runtime.pump(Limit::IDLE);
    for _ in 0..count {
        std::thread::sleep(Duration::from_micros(500));
        let _ = go.send(Go(start.elapsed().as_nanos() as u64));
    }
    runtime.pump(Limit::IDLE);
    let times: Vec<f64> = std::iter::from_fn(|| times.pop()).map(|ns| ns as f64 * 1e-3).collect();
    runtime.shutdown(Duration::from_secs(5));
    quantile(times, 0.5)
}

enum Flooded {
    Data,
    Order(u64),
}

#[derive(Serialize, Deserialize)]
struct Drop1;

#[derive(Serialize, Deserialize)]
struct Urgent(u64);

impl From<Drop1> for Flooded {
    fn from(_: Drop1) -> Self {
        Self::Data
    }
}

impl From<Urgent> for Flooded {
    fn from(urgent: Urgent) -> Self {
        Self::Order(urgent.0)
    }
}

impl Message for Flooded {
    fn digest(&self, digest: &mut Digest) {
        if let Self::Order(sent) = self {
            digest.u64(*sent);
        }
    }

    fn kind(&self) -> &'static str {
        "Flooded"
    }

    fn lane(&self) -> Lane {
        if matches!(self, Self::Data) { Lane::Data } else { Lane::Control }
    }
}

struct Busy {
    times: Arc<ArrayQueue<u64>>,
    start: Instant,
    state: u64,
}

impl Actor for Busy {
    type Msg = Flooded;
    const NAME: &'static str = "busy";

    fn handle(&mut self, message: Flooded, _: &mut Cx<'_, Flooded>) {
        match message {
            // About a microsecond of work.
            Flooded::Data => self.state = (0..1000).fold(self.state, |s, i| (s ^ i).rotate_left(7)),
            Flooded::Order(sent) => {
                let _ = self.times.push((self.start.elapsed().as_nanos() as u64).saturating_sub(sent));
            }
        }
    }
}

/// Microseconds that 99 of 100 control messages take to an actor with up to 100,000 messages queued.
pub fn control_latency() -> f64 {
    const QUEUED: usize = 100_000;
    let times = Arc::new(ArrayQueue::new(10_000));
    let start = Instant::now();
    let built = Runtime::build(Config::live(2), |wiring| {
        let busy = wiring.declare::<Busy>(Bounds::messages(QUEUED));
        let data = wiring.port::<Drop1, Flooded>("data", &busy.address());
        let orders = wiring.port::<Urgent, Flooded>("orders", &busy.address());
        wiring.spawn(busy, Busy { times: Arc::clone(&times), start, state: 1 }, OnPanic::Stop);
        (data, orders)
    });
    let Ok((mut runtime, (data, orders))) = built else { return f64::NAN };
    let mut times_all = Vec::new();
    for _ in 0..5 {
        while data.send(Drop1).is_ok() {}
        for _ in 0..100 {
            let _ = orders.send(Urgent(start.elapsed().as_nanos() as u64));
            std::thread::sleep(Duration::from_micros(200));
        }
        times_all.extend(std::iter::from_fn(|| times.pop()).map(|ns| ns as f64 * 1e-3));
    }
    runtime.pump(Limit::IDLE);
    runtime.shutdown(Duration::from_secs(5));
    quantile(times_all, 0.99)
}
