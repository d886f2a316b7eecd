//! Recording, replay and simulation of a system that is as sensitive to the order of deliveries as can be: players that
//! pass tokens on to whom their state says.

use std::sync::Arc;
use std::time::Instant;

use foveal_runtime::simulate::{Simulation, Strategy};
use foveal_runtime::*;

enum Toss {
    Meet(Vec<Address<Toss>>),
    Token { hops: u32, value: u64 },
}

impl Message for Toss {
    fn digest(&self, digest: &mut Digest) {
        match self {
            Self::Meet(others) => digest.u64(others.len() as u64),
            Self::Token { hops, value } => {
                digest.u32(*hops);
                digest.u64(*value);
            }
        }
    }

    fn kind(&self) -> &'static str {
        match self {
            Self::Meet(_) => "Meet",
            Self::Token { .. } => "Token",
        }
    }
}

/// One bit of one player's state, turned at a delivery.
#[derive(Clone, Copy)]
struct Flip {
    actor: ActorId,
    at: u64,
    bit: u32,
}

struct Player {
    others: Vec<Address<Toss>>,
    state: u64,
    flip: Option<Flip>,
}

impl Actor for Player {
    type Msg = Toss;
    const NAME: &'static str = "player";

    fn handle(&mut self, message: Toss, cx: &mut Cx<'_, Toss>) {
        let (hops, value) = match message {
            Toss::Meet(others) => {
                self.others = others;
                return;
            }
            Toss::Token { hops, value } => (hops, value),
        };
        let mut digest = Digest::new();
        digest.u64(self.state);
        digest.u64(value);
        self.state = digest.finish();
        if let Some(flip) = self.flip.filter(|flip| flip.at + 1 == cx.index()) {
            self.state ^= 1 << flip.bit;
        }
        if hops > 0 {
            let to = self.others[(self.state >> 33) as usize % self.others.len()].clone();
            let _ = cx.tell(&to, Toss::Token { hops: hops - 1, value: value ^ self.state });
        }
    }

    fn digest(&self) -> Option<u64> {
        Some(self.state)
    }
}

struct Starter {
    players: Vec<Address<Toss>>,
    tokens: u64,
    hops: u32,
}

impl Actor for Starter {
    type Msg = Toss;
    const NAME: &'static str = "starter";

    fn started(&mut self, cx: &mut Cx<'_, Toss>) {
        for player in &self.players {
            let _ = cx.tell(player, Toss::Meet(self.players.clone()));
        }
        for value in 0..self.tokens {
            let to = &self.players[value as usize % self.players.len()];
            let _ = cx.tell(to, Toss::Token { hops: self.hops, value });
        }
    }

    fn handle(&mut self, _: Toss, _: &mut Cx<'_, Toss>) {}
}

#[derive(Clone, Copy)]
struct Ring {
    players: usize,
    tokens: u64,
    hops: u32,
    flip: Option<Flip>,
}

fn wire(wiring: &mut Wiring, ring: Ring) {
    let Ring { players, tokens, hops, flip } = ring;
    let room = tokens as usize + 1;
    let declared: Vec<_> = (0..players).map(|_| wiring.declare::<Player>(Bounds::messages(room))).collect();
    let players = declared.iter().map(Declared::address).collect();
    let starter = wiring.declare::<Starter>(Bounds::messages(1));
    wiring.spawn(starter, Starter { players, tokens, hops }, OnPanic::Stop);
    for player in declared {
        let flip = flip.filter(|flip| flip.actor == player.address().id());
        wiring.spawn(player, Player { others: Vec::new(), state: 0, flip }, OnPanic::Stop);
    }
}

/// Seeds of a simulated ring of which two runs differ, and seconds of all.
pub fn seeds(count: u64) -> (u64, f64) {
    const STRATEGIES: [Strategy; 4] = [
        Strategy::Random,
        Strategy::Pct { depth: 3, horizon: 200 },
        Strategy::RoundRobin,
        Strategy::StarveOne,
    ];
    let start = Instant::now();
    let run = |seed: u64| {
        let strategy = STRATEGIES[(seed % 4) as usize];
        let simulation = Simulation { strategy, ..Simulation::new(seed) };
        let ring = Ring { players: 4, tokens: 8, hops: 20, flip: None };
        let (mut runtime, ()) = Runtime::build(Config::simulate(simulation), |w| wire(w, ring)).ok()?;
        (runtime.pump(Limit::IDLE) == Exit::Idle).then(|| runtime.fingerprint())
    };
    let differ = (0..count).filter(|seed| run(*seed).is_none_or(|first| run(*seed) != Some(first))).count();
    (differ as u64, start.elapsed().as_secs_f64())
}

fn record(ring: Ring, threads: usize, seed: u64, hashing: Hashing) -> Option<Arc<Trace>> {
    let bytes = Arc::new(crossbeam_queue::SegQueue::new());
    let sink = Sink(Arc::clone(&bytes));
    let record = Some(Record::Sink(Box::new(sink)));
    let config = Config { record, seed, hashing, ..Config::live(threads) };
    let (mut runtime, ()) = Runtime::build(config, |w| wire(w, ring)).ok()?;
    runtime.pump(Limit::IDLE);
    runtime.shutdown(std::time::Duration::from_secs(10));
    let bytes: Vec<u8> = std::iter::from_fn(|| bytes.pop()).flatten().collect();
    Trace::from_bytes(&bytes).ok().map(Arc::new)
}

struct Sink(Arc<crossbeam_queue::SegQueue<Vec<u8>>>);

impl std::io::Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.push(bytes.to_vec());
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

fn replay(trace: &Arc<Trace>, ring: Ring, threads: usize) -> Option<ReplayReport> {
    let config = Config::replay(Arc::clone(trace), threads);
    let (mut runtime, ()) = Runtime::build(config, |w| wire(w, ring)).ok()?;
    Some(runtime.replay())
}

/// Recorded runs of 16 players whose replay on one or two threads is not the recorded one.
pub fn stress(runs: u64) -> u64 {
    let ring = Ring { players: 16, tokens: 128, hops: 50, flip: None };
    let whole = |trace: &Arc<Trace>, threads| replay(trace, ring, threads).is_some_and(|r| r.complete);
    let same = |seed: &u64| {
        let trace = record(ring, 1 + (*seed % 4) as usize, *seed, Hashing::Exact);
        trace.is_some_and(|trace| whole(&trace, 1) && whole(&trace, 2))
    };
    (0..runs).filter(|seed| !same(seed)).count() as u64
}

/// Bit flips that a replay names at their very delivery.
pub fn flips(count: u64) -> u64 {
    let ring = Ring { players: 8, tokens: 64, hops: 100, flip: None };
    let Some(trace) = record(ring, 2, 7, Hashing::Exact) else { return 0 };
    let named = |fault: &u64| {
        let actor = ActorId((fault % 8) as u32);
        let at = 1 + fault * 7 % (trace.deliveries(actor) - 2);
        let flip = Flip { actor, at, bit: (fault % 64) as u32 };
        let report = replay(&trace, Ring { flip: Some(flip), ..ring }, (fault % 3) as usize);
        report.and_then(|r| r.divergence).is_some_and(|d| (d.actor, d.index) == (actor, at))
    };
    (0..count).filter(named).count() as u64
}

/// Bytes of a recording for each message: of the order alone, and with a hash every 256 messages.
pub fn log_bytes() -> (f64, f64) {
    let ring = Ring { players: 16, tokens: 128, hops: 1000, flip: None };
    let bytes = |hashing| {
        let stat = record(ring, 2, 7, hashing)?.stat();
        Some(stat.file_bytes as f64 / stat.deliveries as f64)
    };
    (bytes(Hashing::Off).unwrap_or(f64::NAN), bytes(Hashing::Every(256)).unwrap_or(f64::NAN))
}

/// Millions of messages a second in a recorded run and in its replay.
pub fn speeds() -> (f64, f64) {
    let ring = Ring { players: 16, tokens: 128, hops: 2000, flip: None };
    let start = Instant::now();
    let Some(trace) = record(ring, 2, 7, Hashing::Every(64)) else { return (f64::NAN, f64::NAN) };
    let live = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let report = replay(&trace, ring, 2);
    let again = start.elapsed().as_secs_f64();
    let messages = report.map_or(f64::NAN, |r| r.deliveries as f64 * 1e-6);
    (messages / live, messages / again)
}
