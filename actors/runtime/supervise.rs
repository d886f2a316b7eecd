//! What happens when an actor panics: the mailbox stays in order, the job goes back, and somebody is told.

use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

use crate::message::ActorId;

/// What becomes of an actor whose turn panicked. The message that did it is gone; all others stay in order.
#[derive(Default)]
pub enum OnPanic<A> {
    /// Go on with the state as it is: for actors whose state cannot be half changed.
    #[default]
    Resume,
    /// Go on with a new state.
    Restart(Box<dyn FnMut() -> A + Send>),
    /// Stop the actor.
    Stop,
}

/// What the supervisor is told.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Incident {
    /// A turn panicked.
    Panicked {
        /// The actor.
        actor: ActorId,
        /// Its name.
        name: String,
        /// What it was handling.
        kind: String,
        /// The panic's message.
        message: String,
    },
    /// A job killed [`crate::pool::KILLS_MAX`] workers and is given up.
    JobDead {
        /// The worker it killed last.
        actor: ActorId,
        /// The job's identity.
        job: u64,
        /// The job's description of itself.
        description: String,
    },
    /// An actor panicked too often and was stopped.
    CircuitOpen {
        /// The actor.
        actor: ActorId,
        /// Its name.
        name: String,
    },
}

/// So many panics…
const PANICS_MAX: usize = 8;
/// …within so many deliveries stop an actor, if another can do its work.
const WINDOW: u64 = 64;

/// Counts an actor's panics, by deliveries rather than by time, so that replay counts alike.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(crate) struct Circuit {
    recent: VecDeque<u64>,
}

impl Circuit {
    /// Notes a panic at a delivery; returns whether there were too many.
    pub(crate) fn panicked(&mut self, index: u64) -> bool {
        self.recent.push_back(index);
        while self.recent.front().is_some_and(|first| first + WINDOW <= index) {
            self.recent.pop_front();
        }
        self.recent.len() >= PANICS_MAX
    }
}

/// Verdicts as they are recorded.
pub(crate) mod verdict {
    pub(crate) const GO_ON: u64 = 0;
    pub(crate) const STOP: u64 = 1;
    pub(crate) const OPEN: u64 = 2;
}

/// The payload of a panic the simulator makes; it does not reach the panic hook.
pub(crate) struct Injected;

/// What a panic said.
pub(crate) fn message_of(payload: &(dyn std::any::Any + Send)) -> String {
    if payload.is::<Injected>() {
        return "injected".to_owned();
    }
    payload
        .downcast_ref::<String>()
        .cloned()
        .or_else(|| payload.downcast_ref::<&str>().map(|text| (*text).to_owned()))
        .unwrap_or_else(|| "a panic without a message".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_panics_close_together_open_the_circuit() {
        let mut circuit = Circuit::default();
        assert!((0..100).all(|panic| !circuit.panicked(panic * 10)));
        let mut circuit = Circuit::default();
        assert_eq!((0..8).map(|panic| circuit.panicked(panic)).filter(|open| *open).count(), 1);
    }
}
