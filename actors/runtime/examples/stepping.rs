//! Taking a recorded run apart: one delivery at a time, back and forth, with the state of an actor at each.
//!
//! `cargo run -p foveal-runtime --example stepping`

use foveal_runtime::*;
use std::sync::Arc;
use std::time::Duration;

#[derive(Message)]
enum Msg {
    Ball { hits: u32 },
}

/// Passes the ball on, and hits harder every time.
struct Player {
    other: Address<Msg>,
    serves: bool,
    hits: u32,
}

impl Actor for Player {
    type Msg = Msg;
    const NAME: &'static str = "player";

    fn started(&mut self, cx: &mut Cx<'_, Msg>) {
        if std::mem::take(&mut self.serves) {
            let _ = cx.tell(&self.other, Msg::Ball { hits: 0 });
        }
    }

    fn handle(&mut self, Msg::Ball { hits }: Msg, cx: &mut Cx<'_, Msg>) {
        self.hits += 1;
        if hits < 9 {
            let _ = cx.tell(&self.other, Msg::Ball { hits: hits + 1 });
        }
    }

    // What makes it possible to go back: the state can be written down.
    fn save(&self, saver: &mut Saver) {
        saver.put(&(self.serves, self.hits));
    }

    fn restore(&mut self, loader: &mut Loader<'_>) -> Option<()> {
        (self.serves, self.hits) = loader.take()?;
        Some(())
    }
}

fn wire(wiring: &mut Wiring) -> [Handle<Player>; 2] {
    let [a, b] = [(); 2].map(|()| wiring.declare::<Player>(Bounds::messages(1)));
    let (to_a, to_b) = (a.address(), b.address());
    let a = wiring.spawn(a, Player { other: to_b, serves: true, hits: 0 }, OnPanic::End);
    [a, wiring.spawn(b, Player { other: to_a, serves: false, hits: 0 }, OnPanic::End)]
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::temp_dir().join(format!("foveal-stepping-{}.fvlog", std::process::id()));
    let (mut runtime, _) = Runtime::build(Config::live(2).record(&path), wire)?;
    runtime.pump(Limit::IDLE);
    runtime.shutdown(Duration::from_secs(1));
    let trace = Arc::new(Trace::open(&path)?);
    std::fs::remove_file(path)?;

    // Forward, with the cause of each delivery.
    let told: Observer = Arc::new(|delivery| {
        let Delivery { actor, index, kind, cause, .. } = delivery;
        println!("  {actor} gets its {index}: {kind}, sent in {cause:?}");
    });
    let config = Config { observer: Some(told), ..Config::replay(Arc::clone(&trace), 0) };
    let (mut runtime, players) = Runtime::build(config, wire)?;
    for _ in 0..4 {
        let actor = runtime.step(None);
        let hits = players.map(|player| runtime.inspect(player, |player| player.hits));
        println!("step to {actor:?}: hits {hits:?}");
    }

    // Back: a system that begins at the snapshot, and goes on to the end from there.
    let snapshot = runtime.snapshot().ok_or("all of it can be saved")?;
    println!("a snapshot of {} bytes at {:?}", snapshot.size_bytes(), snapshot.positions());
    let config = Config { from: Some(Arc::new(snapshot)), ..Config::replay(trace, 0) };
    let (mut runtime, players) = Runtime::build(config, wire)?;
    let hits = players.map(|player| runtime.inspect(player, |player| player.hits));
    println!("begun there: hits {hits:?}");
    let report = runtime.replay();
    println!("to the end: {} deliveries, complete: {}", report.deliveries, report.complete);
    Ok(())
}
