//! `foveal simulate`: the same actors on one thread under a virtual clock, in the order and with the faults that a
//! seed decides, and with what it changes on the way: controls, resting workers, limits of memory.

mod scenario;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use clap::{Args, ValueEnum};
use foveal_runtime::simulate::{Fault, FaultKind, Faults, Strategy};
use foveal_runtime::{ActorId, NodeInfo};
use serde_json::{Value, json};

use foveal_engine::Light;
use foveal_engine::failure::Failure;
use foveal_engine::files::make_folder;
use foveal_engine::interrupt::interrupted;
use foveal_engine::opened;
use foveal_engine::recording::TRACERS_MAX;
use foveal_terminal::arguments::Size;
use foveal_terminal::print::{print_json, print_line};
use foveal_terminal::progress::Progress;
use scenario::Scenario;

/// Samples of a job: few, so that small pictures make many messages.
const SAMPLES_PER_JOB: u32 = 32;
/// Virtual time of a frame: some jobs of a view are done in it, others are not.
const FRAME: Duration = Duration::from_millis(5);
/// Deliveries, sends or turns of an actor within which its faults come.
const HORIZON: u64 = 60;
/// Faults of a kind that an actor gets at most.
const FAULTS_EACH: u64 = 2;
/// Schedules, by seed.
const STRATEGIES: [Strategy; 4] =
    [Strategy::Random, Strategy::Pct { depth: 3, horizon: 500 }, Strategy::RoundRobin, Strategy::StarveOne];

/// Arguments of `foveal simulate`.
#[derive(Args, Debug)]
pub struct SimulateArguments {
    /// OBJ or glTF file, or a .toml sidecar; its light is the first estimate, without a bake
    scene: PathBuf,
    /// Range of seeds; B is excluded
    #[arg(long, value_name = "A..B", value_parser = seeds)]
    seeds: Seeds,
    /// Kinds of faults to inject; the seed decides where and when
    #[arg(long, value_enum, value_delimiter = ',')]
    faults: Vec<FaultName>,
    /// Inject exactly this fault instead, as printed for a failure; may be repeated
    #[arg(long, value_name = "ACTOR:KIND:AT", conflicts_with = "faults")]
    fault: Vec<String>,
    /// Picture size
    #[arg(long, value_name = "WxH", default_value = "64x64")]
    size: Size,
    /// Frames of the walk, before the final stay, which must converge
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    frames: u32,
    /// Let the light grow during the walk, with an illuminator
    #[arg(long)]
    grow: bool,
    /// Limit on texture memory, e.g. 64MiB, which the simulated user lowers during the walk (default: none)
    #[arg(long, value_name = "SIZE", value_parser = foveal_terminal::arguments::bytes)]
    texture_budget: Option<u64>,
    /// Number of tracers
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=i64::from(TRACERS_MAX)))]
    workers: u32,
    /// Which actor runs next: a strategy chosen by the seed (mixed), or always the same one; exhaustive takes seeds
    /// as schedules, starting with the one without deviations
    #[arg(long, value_enum, default_value_t = StrategyName::Mixed)]
    strategy: StrategyName,
    /// Run each seed twice; both runs must be equal message by message
    #[arg(long)]
    twice: bool,
    /// Count a walk that a panic ended in order as failed, too
    #[arg(long)]
    must_rest: bool,
    /// Folder for a recording of each failure, for `foveal replay`
    #[arg(long, value_name = "DIR")]
    traces: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// A range of seeds, the last one left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Seeds {
    start: u64,
    end: u64,
}

fn seeds(text: &str) -> Result<Seeds, String> {
    let wrong = || format!("`{text}` is no range of seeds; write it as 0..100");
    let (start, end) = text.split_once("..").ok_or_else(wrong)?;
    let (start, end) = (start.parse().map_err(|_| wrong())?, end.parse().map_err(|_| wrong())?);
    if start < end { Ok(Seeds { start, end }) } else { Err(wrong()) }
}

/// What can go wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum FaultName {
    /// An actor panics: a tracer's job is returned, the analyzer or cache ager restarts, any other actor ends the
    /// walk in order
    Panic,
    /// A turn is a millisecond late
    Delay,
    /// An actor hangs for 100 ms
    Stall,
    /// Ten turns take 100 times as long
    Slow,
    /// A message or job is returned to its sender
    Full,
    /// The walk is recorded, and the file is truncated
    TornLog,
    /// The walk is recorded, and the disk is full
    DiskFull,
    /// A tracer hangs in a job, which passes to another one
    Hang,
}

/// The name of the recording among the actors.
const RECORDING: &str = "recording";
/// Its number there.
const RECORDING_ID: ActorId = ActorId(u32::MAX);
/// Bytes of a recording within which its faults come.
const RECORDING_HORIZON: u64 = 12_000;

/// Who runs next.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum StrategyName {
    /// Random, PCT, round robin and starve-one, by seed.
    Mixed,
    /// Any runnable actor.
    Random,
    /// Random priorities with three change points.
    Pct,
    /// Each in turn.
    RoundRobin,
    /// One actor runs only when no other can.
    StarveOne,
    /// Every choice, one schedule per seed.
    Exhaustive,
}

impl StrategyName {
    fn of(self, seed: u64) -> Strategy {
        let [random, pct, round_robin, starve_one] = STRATEGIES;
        match self {
            Self::Mixed => STRATEGIES[(seed % STRATEGIES.len() as u64) as usize],
            Self::Random => random,
            Self::Pct => pct,
            Self::RoundRobin => round_robin,
            Self::StarveOne => starve_one,
            Self::Exhaustive => Strategy::Exhaustive,
        }
    }
}

impl From<FaultName> for FaultKind {
    fn from(name: FaultName) -> Self {
        match name {
            FaultName::Panic => Self::Panic,
            FaultName::Delay => Self::Delay,
            FaultName::Stall => Self::Stall,
            FaultName::Slow => Self::Slow,
            FaultName::Full => Self::Full,
            FaultName::TornLog => Self::TornLog,
            FaultName::DiskFull => Self::DiskFull,
            FaultName::Hang => Self::Hang,
        }
    }
}

fn word(kind: FaultKind) -> &'static str {
    match kind {
        FaultKind::Panic => "panic",
        FaultKind::Delay => "delay",
        FaultKind::Stall => "stall",
        FaultKind::Slow => "slow",
        FaultKind::Full => "full",
        FaultKind::TornLog => "torn-log",
        FaultKind::DiskFull => "disk-full",
        FaultKind::Hang => "hang",
    }
}

/// A seed that broke an invariant.
struct Broken {
    seed: u64,
    invariant: String,
    faults: Vec<Fault>,
    trace: Option<PathBuf>,
}

/// Runs the command.
pub fn run(a: &SimulateArguments, progress: Progress) -> Result<(), Failure> {
    foveal_terminal::progress::end_on_interrupt();
    let light = Light { quick: true, ..Light::default() };
    let opened = opened::open(&a.scene, &light, &progress.baking())?;
    if let Some(folder) = &a.traces {
        make_folder(folder)?;
    }
    let scenario = Scenario::new(a, opened)?;
    let (nodes, ending) = scenario.actors()?;
    let listed: Vec<Fault> = a.fault.iter().map(|f| parse_fault(f, &nodes)).collect::<Result<_, _>>()?;
    let kinds: Vec<FaultKind> = a.faults.iter().map(|f| (*f).into()).collect();
    let start = Instant::now();
    let bar = progress.bar(a.seeds.end - a.seeds.start, "simulate");
    let mut broken = Vec::new();
    let mut done = 0;
    for seed in a.seeds.start..a.seeds.end {
        if interrupted() {
            break;
        }
        let faults = if listed.is_empty() { draw(seed, &kinds, &nodes, &ending) } else { listed.clone() };
        if let Err(invariant) = scenario.check(seed, &faults, a.twice) {
            broken.push(scenario.pin_down(seed, &faults, invariant, a));
        }
        done += 1;
        bar.inc(1);
    }
    bar.finish_and_clear();
    let seconds = start.elapsed().as_secs_f64();
    let failures: Vec<Value> = broken.iter().map(|b| failure(b, a, &nodes)).collect();
    if a.json {
        print_json(&json!({
            "schema": "foveal.simulate/1",
            "scene": scenario.scene_name(),
            "seeds": done,
            "first": a.seeds.start,
            "faults": kinds.iter().map(|k| word(*k)).collect::<Vec<_>>(),
            "seconds": seconds,
            "failures": failures,
        }));
    } else {
        print_line(&format!("{done} seeds in {seconds:.1} s, {} failures", failures.len()));
        for failure in &failures {
            let text = |key: &str| failure[key].as_str().unwrap_or_default().to_owned();
            print_line(&format!("seed {}: {}\n    {}", failure["seed"], text("invariant"), text("command")));
        }
    }
    if interrupted() {
        return Err(Failure::Interrupted("interrupted; the seeds done so far are told".into()));
    }
    match failures.len() {
        0 => Ok(()),
        n => Err(Failure::Check(format!("{n} of {done} seeds break an invariant"))),
    }
}

/// One of so many seeds may have panics that end the walk; the others go on to where all rests.
const ENDS_EVERY: u64 = 4;

/// The faults of a seed; a panic of one of `ending` ends the walk.
fn draw(seed: u64, kinds: &[FaultKind], nodes: &[NodeInfo], ending: &[ActorId]) -> Vec<Fault> {
    let of_recording = |kind: &FaultKind| matches!(kind, FaultKind::TornLog | FaultKind::DiskFull);
    let (recording, kinds): (Vec<FaultKind>, Vec<FaultKind>) = kinds.iter().partition(|k| of_recording(k));
    let seeded = Faults::Seeded { kinds, each: FAULTS_EACH, horizon: HORIZON };
    let mut faults: Vec<Fault> =
        (0..nodes.len() as u32).flat_map(|actor| seeded.of(seed, ActorId(actor))).collect();
    let seeded = Faults::Seeded { kinds: recording, each: 1, horizon: RECORDING_HORIZON };
    faults.extend(seeded.of(seed, RECORDING_ID));
    let may_end = seed % ENDS_EVERY == ENDS_EVERY - 1;
    faults.retain(|f| may_end || f.kind != FaultKind::Panic || !ending.contains(&f.actor));
    faults
}

fn parse_fault(text: &str, nodes: &[NodeInfo]) -> Result<Fault, Failure> {
    let wrong =
        || Failure::Usage(format!("--fault {text}: an actor, a kind and a number, as tracer:panic:3"));
    let mut parts = text.rsplitn(3, ':');
    let (Some(at), Some(kind), Some(actor)) = (parts.next(), parts.next(), parts.next()) else {
        return Err(wrong());
    };
    let number = nodes.iter().position(|n| n.name == actor && n.class.is_some());
    let number = number.map(|number| number as u32).or((actor == RECORDING).then_some(RECORDING_ID.0));
    let number = number.ok_or_else(|| {
        let names: Vec<&str> = nodes.iter().filter(|n| n.class.is_some()).map(|n| n.name.as_str()).collect();
        Failure::Usage(format!("--fault {text}: no actor \"{actor}\"; there are {}", names.join(", ")))
    })?;
    let kind = FaultName::from_str(kind, true).map_err(|_| wrong())?.into();
    Ok(Fault { actor: ActorId(number), kind, at: at.parse().map_err(|_| wrong())? })
}

fn failure(b: &Broken, a: &SimulateArguments, nodes: &[NodeInfo]) -> Value {
    let name = |f: &Fault| nodes.get(f.actor.0 as usize).map_or(RECORDING, |n| n.name.as_str());
    let faults: Vec<String> =
        b.faults.iter().map(|f| format!("{}:{}:{}", name(f), word(f.kind), f.at)).collect();
    let given: String = faults.iter().map(|f| format!(" --fault '{f}'")).collect();
    let command = format!(
        "foveal simulate {} --seeds {}..{} --size {}x{} --frames {} --workers {}{}{}{}{given}",
        a.scene.display(),
        b.seed,
        b.seed + 1,
        a.size.width,
        a.size.height,
        a.frames,
        a.workers,
        [(a.grow, " --grow"), (a.twice, " --twice"), (a.must_rest, " --must-rest")]
            .map(|(given, flag)| if given { flag } else { "" })
            .concat(),
        a.texture_budget.map(|bytes| format!(" --texture-budget {bytes}")).unwrap_or_default(),
        match a.strategy.to_possible_value() {
            Some(name) if a.strategy != StrategyName::Mixed => format!(" --strategy {}", name.get_name()),
            _ => String::new(),
        },
    );
    json!({
        "seed": b.seed,
        "invariant": b.invariant,
        "command": command,
        "faults": faults,
        "trace": b.trace.as_ref().map(|t| t.display().to_string()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_and_faults_parse_and_nonsense_is_refused() {
        assert_eq!(seeds("3..7"), Ok(Seeds { start: 3, end: 7 }));
        for wrong in ["", "3", "7..3", "3..3", "a..b", "-1..2", "1..=2"] {
            assert!(seeds(wrong).is_err(), "{wrong}");
        }
        let node = |name: &str| NodeInfo { name: name.into(), class: Some(foveal_runtime::Class::Light) };
        let nodes = [node("cache ager"), node("tracer-2")];
        let fault = parse_fault("tracer-2:stall:12", &nodes).expect("a fault");
        assert_eq!(fault, Fault { actor: ActorId(1), kind: FaultKind::Stall, at: 12 });
        for wrong in ["tracer-2:stall", "tracer:stall:1", "tracer-2:burn:1", "tracer-2:full:x", ""] {
            assert_eq!(parse_fault(wrong, &nodes).expect_err(wrong).exit_code(), 2);
        }
    }

    #[test]
    fn panics_hit_all_and_few_seeds_end() {
        let node = |name: &str| NodeInfo { name: name.into(), class: Some(foveal_runtime::Class::Light) };
        let nodes = [node("renderer"), node("tracer")];
        for seed in 0..200 {
            let faults = draw(seed, &[FaultKind::Panic, FaultKind::Full], &nodes, &[ActorId(0)]);
            let ends = faults.iter().any(|f| f.kind == FaultKind::Panic && f.actor == ActorId(0));
            assert!(!ends || seed % ENDS_EVERY == ENDS_EVERY - 1, "seed {seed}");
        }
        let all = |actor| {
            let of = |f: &Fault| f.kind == FaultKind::Panic && f.actor == ActorId(actor);
            let faults = |seed| draw(seed, &[FaultKind::Panic], &nodes, &[ActorId(0)]);
            (0..200).flat_map(faults).filter(of).count()
        };
        assert!(all(0) > 0 && all(1) > all(0));
    }
}
