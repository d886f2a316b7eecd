//! What stands at the place where a replay parts from its recording.
//!
//! A recording holds a hash of what an actor says, not what it says. So two more replays go there and tell what it was told,
//! what it knew, and what it says: what differs between them depends on something that is no message (a clock, the order of a hash
//! map, a race), and is named with both values. Where they agree, the program itself says something else than it did.

use std::sync::Arc;

use crossbeam_queue::SegQueue;
use foveal_runtime::{Content, Delivery, Difference, Divergence, Limit, Observer, Said};

use super::source::{How, Source};
use crate::failure::Failure;

/// What two replays find at a divergence.
pub struct Diverged {
    /// What the message says.
    pub says: Content,
    /// What its receiver knew before.
    pub state: Content,
    /// What the receiver says to it.
    pub answers: Vec<Said>,
    /// What differs between the replays in what the receiver says, or where that is the same, in the message, or in the
    /// receiver's state.
    pub differs: Vec<Difference>,
}

/// What a replay finds at a place.
struct Observation {
    says: Content,
    state: Content,
    answers: Vec<Said>,
}

/// Looks at a divergence; nothing where a replay does not come there any more.
///
/// # Errors
/// If the recording cannot be replayed.
pub fn look_at(
    source: &Source,
    divergence: &Divergence,
    workers: usize,
) -> Result<Option<Diverged>, Failure> {
    let first = seen(source, divergence, workers)?;
    let second = seen(source, divergence, workers)?;
    let (Some(first), Some(second)) = (first, second) else { return Ok(None) };
    let mut differs: Vec<Difference> = first
        .answers
        .iter()
        .zip(&second.answers)
        .flat_map(|(one, other)| {
            let differences = one.says.differences(&other.says).into_iter();
            differences.map(|d| Difference { path: joined(one.kind, &d.path), ..d })
        })
        .collect();
    if differs.is_empty() {
        differs = first.says.differences(&second.says);
    }
    if differs.is_empty() {
        differs = first.state.differences(&second.state);
    }
    let Observation { says, state, answers } = first;
    Ok(Some(Diverged { says, state, answers, differs }))
}

fn joined(kind: &str, path: &str) -> String {
    if path.is_empty() { kind.to_owned() } else { format!("{kind}.{path}") }
}

/// What a replay of all of it finds where it comes to the place.
fn seen(source: &Source, divergence: &Divergence, workers: usize) -> Result<Option<Observation>, Failure> {
    let found: Arc<SegQueue<(Content, Content)>> = Arc::default();
    let (sink, actor, index) = (Arc::clone(&found), divergence.actor, divergence.index);
    let observer: Observer = Arc::new(move |d: &Delivery<'_>| {
        if (d.actor, d.index) == (actor, index) {
            sink.push(((d.told)(), (d.state)()));
        }
    });
    let how = How { threads: workers, observer: Some(observer), ..How::default() };
    let (mut runtime, _) = source.system(how)?;
    runtime.pump(Limit::IDLE);
    runtime.positions();
    let here = runtime.replay_report().divergence;
    let here = here.filter(|d| (d.actor, d.index) == (actor, index));
    let answers = here.and_then(|d| d.said).unwrap_or_default();
    Ok(found.pop().map(|(says, state)| Observation { says, state, answers }))
}
