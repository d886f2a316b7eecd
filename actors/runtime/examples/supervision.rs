//! An actor that panics: its mailbox stays in order, it starts anew, and the supervisor is told. Simulated with a
//! panic at any delivery, over many seeds.
//!
//! `cargo run -p foveal-runtime --example supervision`

use foveal_runtime::simulate::{Fault, FaultKind, Faults, Simulation};
use foveal_runtime::*;
use std::time::Duration;

#[derive(Message)]
enum ParserMsg {
    Line(String),
}

/// Adds up numbers, and trusts its input too much.
struct Parser {
    sum: i64,
}

impl Actor for Parser {
    type Msg = ParserMsg;
    const NAME: &'static str = "parser";

    fn handle(&mut self, ParserMsg::Line(line): ParserMsg, cx: &mut Cx<'_, ParserMsg>) {
        self.sum += line.trim().parse::<i64>().expect("a number");
        cx.mark(0, self.sum as u64);
    }
}

#[derive(Message)]
enum WatchMsg {
    /// Overtakes what waits, so that it gets through.
    #[message(lane = control)]
    Incident(Incident),
}

#[derive(Default)]
struct Watch {
    incidents: Vec<String>,
}

impl Actor for Watch {
    type Msg = WatchMsg;
    const NAME: &'static str = "watch";
    const CLASS: Class = Class::Pinned;

    fn handle(&mut self, WatchMsg::Incident(incident): WatchMsg, _: &mut Cx<'_, WatchMsg>) {
        if let Incident::Panicked { name, kind, message, .. } = incident {
            self.incidents.push(format!("{name} panicked over {kind}: {message}"));
        }
    }
}

struct Lines {
    watch: Handle<Watch>,
    parser: Handle<Parser>,
    port: Port<String, ParserMsg>,
}

impl From<String> for ParserMsg {
    fn from(line: String) -> Self {
        Self::Line(line)
    }
}

fn wire(wiring: &mut Wiring) -> Lines {
    let watch = wiring.declare::<Watch>(Bounds::messages(16));
    wiring.supervisor(&watch.address(), WatchMsg::Incident);
    let parser = wiring.declare::<Parser>(Bounds::messages(16));
    let port = wiring.port("lines", &parser.address());
    let anew = OnPanic::Restart(Box::new(|| Parser { sum: 0 }));
    let parser = wiring.spawn(parser, Parser { sum: 0 }, anew);
    Lines { watch: wiring.spawn(watch, Watch::default(), OnPanic::End), parser, port }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (mut runtime, lines) = Runtime::build(Config::live(0), wire)?;
    for line in ["1", "2", "three", "40", "2"] {
        lines.port.send(line.to_owned())?;
    }
    runtime.pump(Limit::IDLE);
    println!("{:?}", runtime.inspect(lines.watch, |watch| watch.incidents.clone()));
    println!("what came after: {:?}", runtime.inspect(lines.parser, |parser| parser.sum));
    runtime.shutdown(Duration::from_secs(1));

    // The same system, one thread, virtual time: a panic at each delivery in turn, under other schedules each time.
    for seed in 0..1000 {
        let mut simulation = Simulation::new(seed);
        let at = seed % 3;
        simulation.faults = Faults::Listed(vec![Fault { actor: ActorId(1), kind: FaultKind::Panic, at }]);
        let (mut runtime, lines) = Runtime::build(Config::simulate(simulation), wire)?;
        for line in ["1", "2", "3"] {
            lines.port.send(line.to_owned())?;
        }
        runtime.pump(Limit::IDLE);
        assert_eq!(runtime.failure(), None, "seed {seed}");
        let incidents = runtime.inspect(lines.watch, |watch| watch.incidents.len());
        assert_eq!(incidents, Some(1), "seed {seed}: one panic, one incident");
    }
    println!("1000 seeds, a panic in each: every one was told of");
    Ok(())
}
