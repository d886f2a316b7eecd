//! What stands at the place where a replay parts from its recording.
//!
//! A recording holds a hash of each message, not the message. So two more replays go there and tell what the message says and
//! what its receiver knew: what differs between them depends on something that is no message (a clock, the order of a hash
//! map, a race), and is named with both values. Where they agree, the program itself says something else than it did.

use std::sync::Arc;

use crossbeam_queue::SegQueue;
use foveal_runtime::{Content, Delivery, Difference, Divergence, Limit, Observer};

use super::source::{How, Source};
use crate::failure::Failure;

/// What two replays find at a divergence.
pub struct Diverged {
    /// What the message says.
    pub says: Content,
    /// What its receiver knew before.
    pub state: Content,
    /// What differs in the message between the replays, or where that is the same, in the receiver's state.
    pub differs: Vec<Difference>,
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
    let (Some((says, state)), Some((other, other_state))) = (first, second) else { return Ok(None) };
    let mut differs = says.differences(&other);
    if differs.is_empty() {
        differs = state.differences(&other_state);
    }
    Ok(Some(Diverged { says, state, differs }))
}

/// Message and receiver's state where a replay of all of it comes to the place.
fn seen(
    source: &Source,
    divergence: &Divergence,
    workers: usize,
) -> Result<Option<(Content, Content)>, Failure> {
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
    Ok(found.pop())
}
