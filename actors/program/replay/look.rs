//! What a recording's actors knew, and when it changed.

use foveal_engine::Failure;
use foveal_engine::replay::when::{Condition, Met, when};
use foveal_engine::replay::{How, Source, Telling};
use foveal_runtime::Content;
use foveal_terminal::print::{print_json, print_line};
use serde_json::{Value, json};

/// Which of the places where a condition comes to hold are told.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Which {
    /// The first.
    First,
    /// The last.
    Last,
    /// The first after --until.
    Next,
    /// All of them.
    All,
}

/// Prints a state: a line for each value, or JSON.
pub fn print_state(state: &Content, telling: Telling) {
    match telling {
        Telling::Json => print_json(&json!(state)),
        _ => state.lines().iter().for_each(|line| print_line(line)),
    }
}

/// The states of an actor, or of all, at a place; at the end where none is named.
fn states(
    source: &Source,
    actor: Option<&str>,
    place: Option<&str>,
    workers: usize,
) -> Result<Content, Failure> {
    let until = place.map(|place| source.place(place)).transpose()?;
    let how = How { threads: workers, until, jump: until.is_some(), ..How::default() };
    let (mut runtime, _) = source.run(how, |_| ())?;
    if let Some(divergence) = runtime.replay_report().divergence {
        return Err(Failure::Check(format!("the replay diverges: {divergence}")));
    }
    match actor {
        Some(name) => Ok(runtime.content(source.actor(name)?).unwrap_or_default()),
        None => {
            let nodes = source.trace.header().nodes.iter().enumerate().filter(|(_, n)| n.class.is_some());
            Ok(Content::fields(nodes.map(|(number, node)| {
                let content = runtime.content(foveal_runtime::ActorId(number as u32));
                (node.name.clone(), content.unwrap_or_default())
            })))
        }
    }
}

/// Tells an actor's state at a place.
pub fn state(
    source: &Source,
    actor: &str,
    place: Option<&str>,
    workers: usize,
    telling: Telling,
) -> Result<(), Failure> {
    let state = states(source, Some(actor), place, workers)?;
    match telling {
        Telling::Json => print_json(&json!({
            "schema": "foveal.replay.state/1", "actor": actor, "at": place, "state": state,
        })),
        _ => print_state(&state, telling),
    }
    Ok(())
}

/// Tells which snapshots are kept along a recording.
pub fn index(source: &Source, as_json: bool) {
    let Some(kept) = source.snapshots() else {
        return match as_json {
            true => print_json(&json!({"schema": "foveal.replay.index/1", "snapshots": 0})),
            false => print_line("no cache folder for snapshots"),
        };
    };
    let frames = source.shown_in.len();
    if as_json {
        print_json(&json!({
            "schema": "foveal.replay.index/1",
            "file": kept.file,
            "snapshots": kept.count,
            "bytes": kept.bytes,
            "frames": frames,
        }));
    } else {
        print_line(&format!(
            "{} snapshots along {frames} frames, {} bytes in {}",
            kept.count,
            kept.bytes,
            kept.file.display()
        ));
    }
}

/// Tells what differs between the states at two places, of one actor or of all.
pub fn difference(
    source: &Source,
    actor: Option<&str>,
    [a, b]: [&str; 2],
    workers: usize,
    as_json: bool,
) -> Result<(), Failure> {
    let [left, right] = [a, b].map(|place| states(source, actor, Some(place), workers));
    let differences = left?.differences(&right?);
    if as_json {
        let all: Value =
            differences.iter().map(|d| json!({"path": d.path, "a": d.left, "b": d.right})).collect();
        print_json(&json!({
            "schema": "foveal.replay.state_diff/1", "actor": actor, "a": a, "b": b, "differences": all,
        }));
    } else {
        differences.iter().for_each(|d| print_line(&format!("{}: {} → {}", d.path, d.left, d.right)));
        if differences.is_empty() {
            print_line("no difference");
        }
    }
    Ok(())
}

/// Tells where a condition comes to hold: exit 1 where it never does.
pub fn when_met(
    source: &Source,
    condition: &str,
    which: Which,
    after: Option<&str>,
    workers: usize,
    as_json: bool,
) -> Result<(), Failure> {
    let parsed = Condition::parse(condition).map_err(Failure::Usage)?;
    let mut met = when(source, &parsed, workers)?;
    match which {
        Which::All => {}
        Which::First => met.truncate(1),
        Which::Last => met = met.pop().into_iter().collect(),
        Which::Next => {
            let place = after.ok_or_else(|| Failure::Usage("after which place? say --until".into()))?;
            let made = made_by(source, place, workers)?;
            met.retain(|met| met.at.1 >= made[met.at.0.0 as usize]);
            met.truncate(1);
        }
    }
    let document =
        |m: &Met| json!({"at": source.at(m.at), "frame": m.frame, "before": m.before, "value": m.value});
    if as_json {
        print_json(&json!({
            "schema": "foveal.replay.when/1",
            "condition": condition,
            "met": met.iter().map(document).collect::<Vec<_>>(),
        }));
    } else {
        for m in &met {
            let frame = m.frame.map_or_else(String::new, |frame| format!(" (frame {frame})"));
            print_line(&format!("{}{frame}: {m}", source.at(m.at)));
        }
    }
    if met.is_empty() { Err(Failure::Check(format!("`{condition}` never comes about"))) } else { Ok(()) }
}

/// Deliveries made to each actor where a replay stops at a place.
fn made_by(source: &Source, place: &str, workers: usize) -> Result<Vec<u64>, Failure> {
    let until = Some(source.place(place)?);
    let (runtime, _) = source.run(How { threads: workers, until, jump: true, ..How::default() }, |_| ())?;
    Ok(runtime.positions().into_iter().map(|(made, _)| made).collect())
}
