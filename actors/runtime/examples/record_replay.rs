//! Records a race, replays it bit for bit, and shows what a planted bug looks like.
//!
//! `cargo run -p foveal-runtime --example record_replay`

use foveal_runtime::*;
use std::sync::Arc;
use std::time::Duration;

/// A step of one of the runners.
#[derive(Message)]
struct Step {
    runner: u64,
}

/// Runs 20,000 steps and tells the judge of each.
struct Runner {
    number: u64,
    left: u32,
    judge: Address<Step>,
}

impl Actor for Runner {
    type Msg = Step;
    const NAME: &'static str = "runner";

    fn started(&mut self, cx: &mut Cx<'_, Step>) {
        self.handle(Step { runner: self.number }, cx);
    }

    fn handle(&mut self, step: Step, cx: &mut Cx<'_, Step>) {
        if self.left > 0 {
            self.left -= 1;
            let myself = cx.address().clone();
            let _ = cx.tell(&self.judge, Step { runner: self.number });
            let _ = cx.tell(&myself, step);
        }
    }
}

/// Notes in which order the runners come along: no two live runs agree.
struct Judge {
    order: u64,
    steps: u64,
    /// A bug that is not in the recorded program: it miscounts this step.
    bug_at: Option<u64>,
}

impl Actor for Judge {
    type Msg = Step;
    const NAME: &'static str = "judge";

    fn handle(&mut self, step: Step, cx: &mut Cx<'_, Step>) {
        self.steps += 1;
        let runner = if self.bug_at == Some(self.steps) { step.runner + 1 } else { step.runner };
        let mut digest = Digest::new();
        digest.u64(self.order);
        digest.u64(runner);
        self.order = digest.finish();
        if self.steps.is_multiple_of(100) {
            cx.mark(0, self.order);
        }
    }

    fn digest(&self) -> Option<u64> {
        Some(self.order)
    }
}

fn wire(wiring: &mut Wiring, bug_at: Option<u64>) -> Handle<Judge> {
    let judge = wiring.declare::<Judge>(Bounds::messages(80_000));
    let address = judge.address();
    for number in 0..4 {
        let runner = wiring.declare::<Runner>(Bounds::messages(1));
        wiring.spawn(runner, Runner { number, left: 20_000, judge: address.clone() }, OnPanic::Resume);
    }
    wiring.spawn(judge, Judge { order: 0, steps: 0, bug_at }, OnPanic::Resume)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::temp_dir().join(format!("foveal-runtime-{}.fvlog", std::process::id()));
    for run in 1..=3 {
        let (mut runtime, _) = Runtime::build(Config::live(2).record(&path), |wiring| wire(wiring, None))?;
        runtime.pump(Limit::IDLE);
        println!("live run {run}: fingerprint {:016x}", runtime.fingerprint());
        runtime.shutdown(Duration::from_secs(1));
    }
    let trace = Arc::new(Trace::open(&path)?);
    println!("the last one is recorded: {:?}", trace.stat());
    for threads in 0..=3 {
        let config = Config::replay(Arc::clone(&trace), threads);
        let (mut runtime, _) = Runtime::build(config, |wiring| wire(wiring, None))?;
        let report = runtime.replay();
        println!(
            "replay on {threads} threads: {} deliveries, complete: {}, fingerprint {:016x}",
            report.deliveries,
            report.complete,
            runtime.fingerprint()
        );
    }
    let (mut runtime, _) = Runtime::build(Config::replay(trace, 0), |wiring| wire(wiring, Some(1234)))?;
    if let Some(divergence) = runtime.replay().divergence {
        println!("with a bug at the judge's step 1234 (delivery 1233):\n{divergence}");
    }
    std::fs::remove_file(path)?;
    Ok(())
}
