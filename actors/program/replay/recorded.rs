//! What an actor said where a replay parts from its recording, by the program that recorded it.
//!
//! A recording has hashes of what was said, and the program that made it says all of it again: so nothing has to be kept of
//! contents. That program is run beside, and what it says at the place is held against what this one says.

use std::path::Path;
use std::process::Command;

use foveal_engine::Failure;
use foveal_engine::replay::Source;
use foveal_runtime::{Divergence, Said};
use serde_json::Value;

/// A value that the program that recorded says otherwise.
#[derive(Debug, PartialEq)]
pub(super) struct Other {
    /// The message and the way to the value in it.
    pub path: String,
    /// What was recorded.
    pub recorded: Value,
    /// What is said here.
    pub here: Value,
}

/// Where what was said `here` in a delivery differs from what `program` says there.
///
/// # Errors
/// If that program cannot be run, or cannot replay the recording up to there either.
pub(super) fn others(
    program: &Path,
    source: &Source,
    divergence: &Divergence,
    here: &[Said],
) -> Result<Vec<Other>, Failure> {
    let place = source.at((divergence.actor, divergence.index));
    let mut others = Vec::new();
    let mut told: Vec<(String, Vec<Value>)> = Vec::new();
    for said in here {
        let to = source.name(said.to).to_owned();
        let known = match told.iter_mut().find(|(of, _)| *of == to) {
            Some((_, known)) => known,
            None => {
                told.push((to.clone(), said_in(&deliveries(program, source, &to)?, &place)));
                &mut told.last_mut().ok_or_else(|| Failure::Check("nothing was told".into()))?.1
            }
        };
        let here = serde_json::to_value(&said.says).unwrap_or_default();
        let at = known.iter().position(|message| message["message"] == said.kind);
        match at.map(|at| known.remove(at)) {
            Some(message) => differences(said.kind, &message["says"], &here, &mut others),
            None => others.push(Other { path: said.kind.to_owned(), recorded: Value::Null, here }),
        }
    }
    let left = told.into_iter().flat_map(|(_, left)| left);
    others.extend(left.map(|message| Other {
        path: message["message"].as_str().unwrap_or("?").to_owned(),
        recorded: message["says"].clone(),
        here: Value::Null,
    }));
    Ok(others)
}

/// All that `program` delivers to an actor.
fn deliveries(program: &Path, source: &Source, actor: &str) -> Result<Value, Failure> {
    let wrong = |what: String| Failure::Environment(format!("{}: {what}", program.display()));
    let mut command = Command::new(program);
    command.arg("replay").arg(&source.path).args(["--actor", actor, "--json", "--quiet"]);
    let output = command.output().map_err(|e| wrong(e.to_string()))?;
    let document = serde_json::from_slice::<Value>(&output.stdout).map_err(|_| {
        let said = String::from_utf8_lossy(&output.stderr);
        wrong(format!("cannot tell what was recorded: {}", said.lines().next().unwrap_or("it says nothing")))
    })?;
    match document["diverged"].as_object() {
        None => Ok(document),
        Some(at) => {
            let at = format!("{}:{}", at["actor"].as_str().unwrap_or("?"), at["index"]);
            Err(wrong(format!("is not the program that recorded it: it parts at {at}")))
        }
    }
}

/// The messages among deliveries that were sent in the delivery at `place`.
fn said_in(document: &Value, place: &str) -> Vec<Value> {
    let all = document["deliveries"].as_array().map(Vec::as_slice).unwrap_or_default();
    all.iter().filter(|message| message["sent_in"] == place).cloned().collect()
}

fn differences(path: &str, recorded: &Value, here: &Value, found: &mut Vec<Other>) {
    match (recorded, here) {
        (Value::Object(a), Value::Object(b)) if a.keys().eq(b.keys()) => {
            for (name, value) in a {
                differences(&format!("{path}.{name}"), value, &b[name], found);
            }
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            for (number, (a, b)) in a.iter().zip(b).enumerate() {
                differences(&format!("{path}.{number}"), a, b, found);
            }
        }
        _ if recorded == here => {}
        _ => found.push(Other { path: path.to_owned(), recorded: recorded.clone(), here: here.clone() }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn fields_are_named_with_both_values() {
        let recorded = json!({"deliveries": [
            {"message": "JobDone", "sent_in": "tracer:3", "says": {"samples": 256, "cost": [1, 2]}},
            {"message": "JobDone", "sent_in": "tracer:4", "says": {"samples": 1, "cost": [1, 2]}},
            {"message": "Begun", "sent_in": null, "says": 3},
        ]});
        let said = said_in(&recorded, "tracer:3");
        assert_eq!(said.len(), 1);
        let mut found = Vec::new();
        differences("JobDone", &said[0]["says"], &json!({"samples": 255, "cost": [1, 3]}), &mut found);
        let other = |path: &str, recorded: u32, here: u32| Other {
            path: path.into(),
            recorded: recorded.into(),
            here: here.into(),
        };
        found.sort_by(|a, b| a.path.cmp(&b.path));
        assert_eq!(found, [other("JobDone.cost.1", 2, 3), other("JobDone.samples", 256, 255)]);
    }
}
