//! What was said where a replay parts from its recording, by the program that recorded it.
//!
//! A recording has hashes of what was said, and the program that made it says all of it again: so nothing has to be kept of
//! contents. That program is run beside, and what it says at the place is held against what this one says.
//!
//! Where hashes are of what an actor says, the place is the delivery in which it says something else (`--said` of the other
//! program). Where they are of what an actor is told, or it is not told what was recorded at all, the place is the first
//! delivery to it that differs (`--actor`).

use std::fmt;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;

use crossbeam_queue::SegQueue;
use foveal_engine::Failure;
use foveal_engine::replay::{How, Source, Telling, observe};
use foveal_runtime::{ActorId, Delivery, Divergence, Hashing, Limit, Said, Until};
use foveal_terminal::light::ElsewhereArguments;
use foveal_terminal::print::{print_json, print_line};
use serde_json::{Value, json};

/// Something that is otherwise than it was recorded.
#[derive(Debug, PartialEq)]
pub(super) struct Other {
    /// The message and the way to the value in it.
    pub path: String,
    /// What was recorded; none where nothing was.
    pub recorded: Option<Value>,
    /// What is here; none where nothing is.
    pub here: Option<Value>,
}

impl Other {
    /// As JSON: `only` tells a value that is null from one that is not there.
    pub(super) fn document(&self) -> Value {
        let only = match (&self.recorded, &self.here) {
            (Some(_), None) => Some("recorded"),
            (None, Some(_)) => Some("here"),
            _ => None,
        };
        json!({"path": self.path, "recorded": self.recorded, "here": self.here, "only": only})
    }
}

impl fmt::Display for Other {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { path, recorded, here } = self;
        match (recorded, here) {
            (Some(recorded), Some(here)) => write!(f, "{path}: recorded {recorded}, here {here}"),
            (Some(recorded), None) => write!(f, "{path}: recorded, and not here: {recorded}"),
            (None, Some(here)) => write!(f, "{path}: here, and not recorded: {here}"),
            (None, None) => f.write_str(path),
        }
    }
}

/// The program that made a recording.
pub(super) struct Recorder<'a> {
    pub program: &'a Path,
    pub source: &'a Source,
    /// Where files lie, for that program as for this one.
    pub elsewhere: &'a ElsewhereArguments,
}

impl Recorder<'_> {
    /// What is otherwise at a divergence than that program says it was.
    ///
    /// # Errors
    /// If that program cannot be run, or cannot replay the recording up to there either.
    pub(super) fn differences(&self, divergence: &Divergence, workers: usize) -> Result<Vec<Other>, Failure> {
        let at = self.source.at((divergence.actor, divergence.index));
        match &divergence.said {
            Some(here) => {
                let recorded = self.asked(&["--said", &at])?;
                let here: Vec<Value> = here.iter().map(|said| document(self.source, said)).collect();
                Ok(said_otherwise(all(&recorded["said"]), &here))
            }
            None => self.delivered_otherwise(divergence.actor, divergence.index, workers),
        }
    }

    /// The first delivery to an actor that differs, of those that one hash stands for.
    fn delivered_otherwise(&self, actor: ActorId, index: u64, workers: usize) -> Result<Vec<Other>, Failure> {
        let first = match self.source.trace.header().hashing {
            Hashing::Every(period) => (index + 1).saturating_sub(u64::from(period)),
            Hashing::Exact | Hashing::Said => index,
            Hashing::Off => 0,
        };
        // What is wrong at the end shows behind the last delivery.
        let Some(last) = self.source.trace.deliveries(actor).checked_sub(1) else { return Ok(Vec::new()) };
        let (name, until) = (self.source.name(actor), self.source.at((actor, index.min(last))));
        let recorded = self.asked(&["--actor", name, "--until", &until])?;
        let here = delivered(self.source, actor, first..index + 1, workers)?;
        let at = |of: &[Value], at: &str| of.iter().find(|message| message["at"] == at).cloned();
        for index in first..=index {
            let place = self.source.at((actor, index));
            let (recorded, here) = (at(all(&recorded["deliveries"]), &place), at(&here, &place));
            let others = told_otherwise(&place, recorded.as_ref(), here.as_ref());
            if !others.is_empty() {
                return Ok(others);
            }
        }
        Ok(Vec::new())
    }

    /// What it answers to a question about the recording.
    fn asked(&self, question: &[&str]) -> Result<Value, Failure> {
        let wrong = |what: String| Failure::Environment(format!("{}: {what}", self.program.display()));
        let mut command = Command::new(self.program);
        command.arg("replay").arg(&self.source.path).args(question).args(["--json", "--quiet"]);
        command.args(self.elsewhere.words());
        let output = command.output().map_err(|e| wrong(e.to_string()))?;
        let document = serde_json::from_slice::<Value>(&output.stdout).map_err(|_| {
            let said = String::from_utf8_lossy(&output.stderr);
            wrong(format!(
                "cannot tell what was recorded: {}",
                said.lines().next().unwrap_or("it says nothing")
            ))
        })?;
        match document["diverged"].as_object() {
            None => Ok(document),
            Some(at) => {
                let at = format!("{}:{}", at["actor"].as_str().unwrap_or("?"), at["index"]);
                Err(wrong(format!("is not the program that recorded it: it parts at {at}")))
            }
        }
    }
}

/// Tells all that an actor says in a delivery.
///
/// # Errors
/// If there is no such delivery, or the replay parts from the recording before.
pub(super) fn said(source: &Source, place: &str, workers: usize, as_json: bool) -> Result<(), Failure> {
    let until = source.place(place)?;
    let Until::Delivery { actor, index } = until else { return Ok(()) };
    let listen_to = Some((actor, index));
    let how = How { threads: workers, until: Some(until), jump: true, listen_to, ..How::default() };
    let (mut runtime, _) = source.run(how, |_| ())?;
    let report = runtime.replay_report();
    let heard = runtime.heard().unwrap_or_default();
    if as_json {
        print_json(&json!({
            "schema": "foveal.replay.said/1",
            "at": source.at((actor, index)),
            "said": heard.iter().map(|said| document(source, said)).collect::<Vec<_>>(),
            "diverged": report.divergence.as_ref().map(|d| json!({"actor": d.name, "index": d.index})),
        }));
    } else {
        for said in heard {
            let to = if said.to == actor { String::new() } else { format!(" to {}", source.name(said.to)) };
            print_line(&format!("{}{to}: {}", said.kind, said.says));
        }
        if heard.is_empty() && report.divergence.is_none() {
            print_line("nothing");
        }
    }
    match report.divergence {
        Some(divergence) => Err(Failure::Check(format!("the replay diverges: {divergence}"))),
        None => Ok(()),
    }
}

/// As JSON, by way of its text: a number of 32 bits is told with as many digits as it takes, here as there.
pub(super) fn document(source: &Source, said: &Said) -> Value {
    let says = serde_json::to_string(&said.says).ok();
    let says = says.and_then(|text| serde_json::from_str::<Value>(&text).ok());
    json!({"to": source.name(said.to), "message": said.kind, "says": says})
}

/// What is delivered here to an actor, as far as the replay comes.
fn delivered(
    source: &Source,
    actor: ActorId,
    indices: std::ops::Range<u64>,
    workers: usize,
) -> Result<Vec<Value>, Failure> {
    let seen = Arc::new(SegQueue::new());
    let wanted = move |d: &Delivery<'_>| d.actor == actor && indices.contains(&d.index);
    let observer = Some(observe(&seen, Telling::Json, wanted));
    let (mut runtime, _) = source.system(How { threads: workers, observer, ..How::default() })?;
    runtime.pump(Limit::IDLE);
    // Nothing runs any more behind it.
    runtime.replay_report();
    Ok(std::iter::from_fn(|| seen.pop()).map(|s| source.document(&s)).collect())
}

fn all(list: &Value) -> &[Value] {
    list.as_array().map(Vec::as_slice).unwrap_or_default()
}

/// The message's variant, and to whom, where that is said.
fn label(message: &Value) -> String {
    let kind = message["message"].as_str().unwrap_or("?");
    message["to"].as_str().map_or_else(|| kind.to_owned(), |to| format!("{kind} to {to}"))
}

/// What differs between all that was said in a delivery and what is. Messages of one kind to one receiver are compared in
/// their order; of the others it is told that they are missing, or that there is one more.
fn said_otherwise(recorded: &[Value], here: &[Value]) -> Vec<Other> {
    let mut others = Vec::new();
    let mut left: Vec<&Value> = recorded.iter().collect();
    for message in here {
        let same = |of: &&Value| of["message"] == message["message"] && of["to"] == message["to"];
        match left.iter().position(same) {
            Some(at) => {
                let kind = message["message"].as_str().unwrap_or("?");
                differences(kind, &left.remove(at)["says"], &message["says"], &mut others);
            }
            None => others.push(Other {
                path: label(message),
                recorded: None,
                here: Some(message["says"].clone()),
            }),
        }
    }
    others.extend(left.into_iter().map(|message| Other {
        path: label(message),
        recorded: Some(message["says"].clone()),
        here: None,
    }));
    let order = |all: &[Value]| all.iter().map(label).collect::<Vec<_>>();
    if others.is_empty() && order(recorded) != order(here) {
        let [recorded, here] = [recorded, here].map(|all| Some(json!(order(all))));
        others.push(Other { path: "their order".into(), recorded, here });
    }
    others
}

/// What differs between what was delivered at a place and what is.
fn told_otherwise(place: &str, recorded: Option<&Value>, here: Option<&Value>) -> Vec<Other> {
    let mut others = Vec::new();
    let path = |message: &Value| {
        let sent = message["sent_in"].as_str().map_or_else(String::new, |sent| format!(" (said in {sent})"));
        format!("{place}{sent} {}", label(message))
    };
    match (recorded, here) {
        (Some(recorded), Some(here)) if recorded["message"] == here["message"] => {
            differences(&path(here), &recorded["says"], &here["says"], &mut others);
        }
        _ => {
            let says = |message: &Value| Some(message["says"].clone());
            others.extend(recorded.map(|m| Other { path: path(m), recorded: says(m), here: None }));
            others.extend(here.map(|m| Other { path: path(m), recorded: None, here: says(m) }));
        }
    }
    others
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
        _ => {
            let (recorded, here) = (Some(recorded.clone()), Some(here.clone()));
            found.push(Other { path: path.to_owned(), recorded, here });
        }
    }
}

#[cfg(test)]
mod tests {
    use std::slice::from_ref;

    use super::*;

    fn message(kind: &str, to: &str, says: Value) -> Value {
        json!({"message": kind, "to": to, "says": says})
    }

    fn told(others: &[Other]) -> Vec<String> {
        others.iter().map(Other::to_string).collect()
    }

    #[test]
    fn fields_are_named_with_both_values() {
        let recorded = message("JobDone", "allocator", json!({"samples": 256, "cost": [1, 2], "age": null}));
        let here = message("JobDone", "allocator", json!({"samples": 255, "cost": [1, 3], "age": null}));
        assert_eq!(
            told(&said_otherwise(from_ref(&recorded), &[here])),
            ["JobDone.cost.1: recorded 2, here 3", "JobDone.samples: recorded 256, here 255"]
        );
        assert_eq!(said_otherwise(from_ref(&recorded), from_ref(&recorded)), []);
    }

    /// A message that is not there is not one that says null.
    #[test]
    fn what_is_missing_and_what_is_more_is_told_apart_from_null() {
        let (done, idle) = (message("Done", "allocator", Value::Null), message("Idle", "renderer", json!(1)));
        let missing = said_otherwise(from_ref(&done), &[]);
        assert_eq!(told(&missing), ["Done to allocator: recorded, and not here: null"]);
        assert_eq!(missing[0].document()["only"], "recorded");
        let more = said_otherwise(from_ref(&done), &[idle.clone(), done.clone()]);
        assert_eq!(told(&more), ["Idle to renderer: here, and not recorded: 1"]);
        assert_eq!(more[0].document()["only"], "here");
        let null = said_otherwise(from_ref(&done), &[message("Done", "allocator", json!(2))]);
        assert_eq!(told(&null), ["Done: recorded null, here 2"]);
        assert_eq!(null[0].document()["only"], Value::Null);
        // To somebody else is another message.
        let other = said_otherwise(from_ref(&done), &[message("Done", "analyzer", Value::Null)]);
        assert_eq!(other.len(), 2);
        let turned = said_otherwise(&[done.clone(), idle.clone()], &[idle, done]);
        assert_eq!(turned[0].path, "their order");
        assert_eq!(turned.len(), 1);
    }

    #[test]
    fn a_delivery_that_differs_says_where_it_was_said() {
        let told_of = |kind: &str, says: u32| json!({"message": kind, "sent_in": "tracer:3", "says": says});
        let (one, other) = (told_of("JobDone", 1), told_of("JobDone", 2));
        let place = "allocator:7";
        assert_eq!(told_otherwise(place, Some(&one), Some(&one)), []);
        assert_eq!(
            told(&told_otherwise(place, Some(&one), Some(&other))),
            ["allocator:7 (said in tracer:3) JobDone: recorded 1, here 2"]
        );
        assert_eq!(told_otherwise(place, Some(&one), Some(&told_of("Idle", 1))).len(), 2);
        assert_eq!(
            told(&told_otherwise(place, Some(&one), None)),
            ["allocator:7 (said in tracer:3) JobDone: recorded, and not here: 1"]
        );
    }
}
