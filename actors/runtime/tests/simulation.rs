//! Simulated systems: equal seeds are equal runs, faults lose nothing, failures shrink, and simulations are recorded in
//! the same format as live runs.

use foveal_runtime::simulate::{Fault, FaultKind, Faults, Simulation, Strategy, Work, exhaust, shrink};
use foveal_runtime::*;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use crate::common::*;
use crate::ring;
use crate::workshop::{self, Options, Order};

const STRATEGIES: [Strategy; 4] =
    [Strategy::Random, Strategy::Pct { depth: 3, horizon: 500 }, Strategy::RoundRobin, Strategy::StarveOne];

fn faults() -> Faults {
    use FaultKind::*;
    Faults::Seeded { kinds: vec![Panic, Full, Delay, Stall, Slow, Hang], each: 2, horizon: 60 }
}

/// Runs the workshop under a seed; returns its fingerprint.
fn shop(seed: u64, faults: Faults, record: Option<&std::path::Path>) -> u64 {
    let strategy = STRATEGIES[(seed % 4) as usize];
    // By turns of the strategies' turns.
    let work = if (seed / 4).is_multiple_of(2) { Work::Constant } else { Work::Seeded };
    let simulation = Simulation { strategy, faults, work, ..Simulation::new(seed) };
    let mut config = Config::simulate(simulation);
    config.record = record.map(|path| Record::File(path.to_owned()));
    let options = Options { work: 3, ..Options::new(3) };
    let (mut runtime, shop) =
        Runtime::build(config, |wiring| workshop::wire(wiring, options)).expect("builds");
    for _ in 0..4 {
        shop.orders.send(Order { tasks: 8 }).expect("room");
    }
    assert_eq!(runtime.pump(Limit::IDLE), Exit::Idle, "{:?}", runtime.failure());
    assert_eq!(runtime.failure(), None);
    let stats = shop.pool.stats();
    assert_eq!(stats.pushed, stats.completed + stats.dead, "seed {seed}: {stats:?}");
    let fingerprint = runtime.fingerprint();
    if record.is_some() {
        assert!(runtime.shutdown(WAIT).drained);
    }
    fingerprint
}

#[test]
fn every_seed_runs_twice_alike() {
    let mut seen = BTreeSet::new();
    for seed in 0..1000 {
        let first = shop(seed, faults(), None);
        assert_eq!(first, shop(seed, faults(), None), "seed {seed}");
        seen.insert(first);
    }
    assert!(seen.len() > 900, "only {} different runs", seen.len());
}

#[test]
fn seeds_of_a_ring_run_twice_alike() {
    let run = |seed: u64| {
        let simulation = Simulation { strategy: STRATEGIES[(seed % 4) as usize], ..Simulation::new(seed) };
        let (mut runtime, _) =
            Runtime::build(Config::simulate(simulation), |wiring| ring::wire(wiring, 4, 8, 20))
                .expect("builds");
        assert_eq!(runtime.pump(Limit::IDLE), Exit::Idle);
        assert_eq!(runtime.deliveries(), 4 + 8 * 21);
        runtime.fingerprint()
    };
    let runs: BTreeSet<u64> = (0..2000)
        .map(|seed| {
            let first = run(seed);
            assert_eq!(first, run(seed), "seed {seed}");
            first
        })
        .collect();
    assert!(runs.len() > 1000, "only {} different orders", runs.len());
}

#[test]
fn a_simulation_is_recorded_and_replays_on_threads() {
    let folder = tempfile::tempdir().expect("a folder");
    for seed in 0..20 {
        let path = folder.path().join("simulated.fvlog");
        shop(seed, faults(), Some(&path));
        let trace = Arc::new(Trace::open(&path).expect("reads"));
        assert!(trace.complete());
        for threads in [0, 2] {
            assert_complete(&replay_workshop(&trace, threads, Options { work: 3, ..Options::new(3) }));
        }
    }
}

#[test]
fn a_broken_invariant_is_named_and_its_faults_shrink() {
    // The invariant that no send is ever refused breaks as soon as the workshop's office refuses one.
    let fails = |faults: &[Fault]| {
        let simulation = Simulation {
            faults: Faults::Listed(faults.to_vec()),
            invariant: Some(Box::new(|runtime: &Runtime| {
                let panics: u64 = runtime.counters().iter().map(|actor| actor.panics).sum();
                if panics < 2 { Ok(()) } else { Err(format!("{panics} panics")) }
            })),
            ..Simulation::new(3)
        };
        let (mut runtime, shop) =
            Runtime::build(Config::simulate(simulation), |wiring| workshop::wire(wiring, Options::new(2)))
                .expect("builds");
        shop.orders.send(Order { tasks: 16 }).expect("room");
        let exit = runtime.pump(Limit::IDLE);
        let failure = runtime.failure().cloned();
        assert_eq!(exit == Exit::Halted, failure.is_some());
        failure
    };
    assert_eq!(fails(&[]), None);
    let seeded = faults();
    let all: Vec<Fault> = (0..6).flat_map(|actor| seeded.of(99, ActorId(actor))).collect();
    let extra = [2, 3].map(|actor| Fault { actor: ActorId(actor), kind: FaultKind::Panic, at: 1 });
    let all = [&all[..], &extra].concat();
    let failure = fails(&all).expect("two panics");
    assert_eq!((failure.seed, failure.reason.as_str()), (3, "2 panics"));
    let kept = shrink(&all, |faults| fails(faults).is_some());
    assert_eq!(kept.len(), 2, "{kept:?}");
    assert!(kept.iter().all(|fault| fault.kind == FaultKind::Panic));
}

#[test]
fn a_system_without_rest_is_told() {
    struct Restless;
    impl Actor for Restless {
        type Msg = ring::Msg;
        const NAME: &'static str = "restless";
        fn started(&mut self, cx: &mut Cx<'_, ring::Msg>) {
            self.handle(ring::Msg::Meet(Vec::new()), cx);
        }
        fn handle(&mut self, message: ring::Msg, cx: &mut Cx<'_, ring::Msg>) {
            let me = cx.address().clone();
            cx.tell(&me, message).expect("room for one");
        }
    }
    let simulation = Simulation { steps_max: 500, ..Simulation::new(0) };
    let (mut runtime, _) = Runtime::build(Config::simulate(simulation), |wiring| {
        let restless = wiring.declare::<Restless>(Bounds::messages(1));
        wiring.spawn(restless, Restless, OnPanic::Resume)
    })
    .expect("builds");
    assert_eq!(runtime.pump(Limit::IDLE), Exit::Halted);
    assert_eq!(runtime.failure().map(|failure| failure.step), Some(500));
}

#[test]
fn a_small_system_is_run_under_every_schedule() {
    let mut runs = BTreeSet::new();
    let exhausted = exhaust(2_000_000, |seed| {
        let simulation = Simulation { strategy: Strategy::Exhaustive, ..Simulation::new(seed) };
        let (mut runtime, players) =
            Runtime::build(Config::simulate(simulation), |wiring| ring::wire(wiring, 2, 2, 2))
                .expect("builds");
        assert_eq!(runtime.pump(Limit::IDLE), Exit::Idle, "seed {seed}: {:?}", runtime.failure());
        assert_eq!(runtime.deliveries(), 2 + 2 * 3);
        let schedule = runtime.schedule();
        if schedule.left == 0 {
            runs.insert(runtime.fingerprint());
        }
        drop(players);
        schedule
    });
    assert!(exhausted.complete, "{exhausted:?}");
    assert!(
        exhausted.schedules > runs.len() as u64 && runs.len() > 1,
        "{exhausted:?}, {} outcomes",
        runs.len()
    );
    // Random schedules find no outcome that these do not.
    for seed in 0..300 {
        let strategy = STRATEGIES[(seed % 4) as usize];
        let simulation = Simulation { strategy, ..Simulation::new(seed) };
        let (mut runtime, _) =
            Runtime::build(Config::simulate(simulation), |wiring| ring::wire(wiring, 2, 2, 2))
                .expect("builds");
        assert_eq!(runtime.pump(Limit::IDLE), Exit::Idle);
        assert!(runs.contains(&runtime.fingerprint()), "seed {seed}");
    }
}

/// A heavy actor and a light one, which are told so often, and what the heavy one measured.
#[derive(Message)]
enum Go {
    Go(u64),
}

impl From<u64> for Go {
    fn from(number: u64) -> Self {
        Self::Go(number)
    }
}

struct Porter(Vec<Duration>);

impl Actor for Porter {
    type Msg = Go;
    const NAME: &'static str = "porter";
    const CLASS: Class = Class::Heavy;

    fn handle(&mut self, Go::Go(steps): Go, cx: &mut Cx<'_, Go>) {
        let carry = || (0..steps).fold(steps, |sum, step| std::hint::black_box(sum.rotate_left(7) ^ step));
        self.0.push(cx.measure(carry).1);
    }
}

struct Clerk;

impl Actor for Clerk {
    type Msg = Go;
    const NAME: &'static str = "clerk";

    fn handle(&mut self, Go::Go(steps): Go, _: &mut Cx<'_, Go>) {
        let _ = (0..steps).fold(steps, |sum, step| std::hint::black_box(sum.rotate_left(7) ^ step));
    }
}

/// What the porter measured of work of these lengths; when the porter, then the clerk had done theirs.
fn worked(seed: u64, work: Work, lengths: &[u64]) -> (Vec<Duration>, [Duration; 2]) {
    let simulation = Simulation { work, strategy: Strategy::RoundRobin, ..Simulation::new(seed) };
    let (mut runtime, (porter, ports)) = Runtime::build(Config::simulate(simulation), |wiring| {
        let porter = wiring.declare::<Porter>(Bounds::messages(64));
        let clerk = wiring.declare::<Clerk>(Bounds::messages(64));
        let ports = [wiring.port("heavy", &porter.address()), wiring.port("light", &clerk.address())];
        wiring.spawn(clerk, Clerk, OnPanic::End);
        (wiring.spawn(porter, Porter(Vec::new()), OnPanic::End), ports)
    })
    .expect("builds");
    assert_eq!(runtime.pump(Limit::IDLE), Exit::Idle);
    let begun = runtime.now();
    let ends = ports.map(|port: Port<u64, Go>| {
        lengths.iter().for_each(|steps| port.send(*steps).expect("room"));
        assert_eq!(runtime.pump(Limit::IDLE), Exit::Idle);
        runtime.now().since(begun)
    });
    (runtime.inspect(porter, |p| p.0.clone()).expect("at rest"), ends)
}

#[test]
fn work_takes_what_the_seed_says() {
    let lengths = [0; 32];
    let (none, [constant, _]) = worked(1, Work::Constant, &lengths);
    assert!(none.iter().all(Duration::is_zero));
    // And a last turn, which finds nothing.
    assert_eq!(constant, Duration::from_micros(500) * 33);
    let (measured, ends) = worked(1, Work::Seeded, &lengths);
    assert_eq!((measured.clone(), ends), worked(1, Work::Seeded, &lengths));
    assert_ne!(measured, worked(2, Work::Seeded, &lengths).0);
    let different: BTreeSet<Duration> = measured.iter().copied().collect();
    assert!(different.len() > 24 && !measured.contains(&Duration::ZERO), "{measured:?}");
    // What was measured is what the clock moved by, but for the rounding of what is recorded.
    let sum: Duration = measured.iter().sum();
    let beside = ends[0] - sum * 99 / 100;
    assert!(beside < sum / 50 + Duration::from_micros(500) * 16, "{ends:?}, {sum:?}");
    let light = ends[1] - ends[0];
    assert!(light > Duration::ZERO && light != Duration::from_micros(33), "{light:?}");
}

#[test]
fn work_takes_the_time_it_really_takes() {
    let lengths = [1_000, 3_000_000];
    let (measured, ends) = worked(1, Work::Measured, &lengths);
    assert!(measured[1] > 20 * measured[0], "{measured:?}");
    // A turn is more than what is measured in it; what others do at the same time is not in it.
    let sum: Duration = measured.iter().sum();
    assert!(ends[0] >= sum * 99 / 100 && ends[0] < sum * 2, "{ends:?}, {sum:?}");
    // Light turns keep their constant, whatever they do.
    assert_eq!(ends[1] - ends[0], Duration::from_micros(1) * 3);
}
