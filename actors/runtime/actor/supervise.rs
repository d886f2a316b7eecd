//! What happens when an actor panics: the mailbox stays in order, the job goes back, and somebody is told.

use serde::{Deserialize, Serialize};
use std::any::Any;
use std::collections::VecDeque;
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};

use crate::message::ActorId;

/// What becomes of an actor that panicked: over a message, its digest or kind, or the hash of its own state. The
/// message that did it is gone; all others stay in order.
pub enum OnPanic<A> {
    /// Go on with the state as it is: for actors whose state cannot be half changed. One that panics again and again is
    /// stopped if other workers of its pool can do its work; else the system ends.
    Resume,
    /// Go on with a new state. Where making one panics as well, or the actor panics again and again, the system ends.
    Restart(Box<dyn FnMut() -> A + Send>),
    /// Stop the actor.
    Stop,
    /// Stop the actor, and end the system in order: [`crate::Runtime::pump`] returns [`crate::Exit::Ended`].
    End,
}

impl<A> OnPanic<A> {
    /// Go on with what `make` makes.
    pub fn restart(make: impl FnMut() -> A + Send + 'static) -> Self {
        Self::Restart(Box::new(make))
    }
}

/// What went wrong. The supervisor is told of what an actor did; [`crate::Runtime::incidents`] has that and what no
/// actor did.
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
    /// A job was given up, and whoever is to know could not be told.
    JobLost {
        /// The worker that had it last.
        actor: ActorId,
        /// The job's identity.
        job: u64,
        /// Why nobody could be told.
        message: String,
    },
    /// A worker hung at a job, and another one has it now.
    LeaseLost {
        /// The worker.
        actor: ActorId,
        /// Its name.
        name: String,
        /// The job's identity.
        job: u64,
    },
    /// A worker panicked too often and was stopped.
    CircuitOpen {
        /// The actor.
        actor: ActorId,
        /// Its name.
        name: String,
    },
    /// A turn panicked outside everything that is guarded. What the actor held was handed on, and it was stopped.
    TurnBroke {
        /// The actor.
        actor: ActorId,
        /// Its name.
        name: String,
        /// The panic's message.
        message: String,
    },
    /// Something beside the actors panicked: an observer (which is asked no more), the waker, the wording of an
    /// incident, or a thread between two turns.
    Beside {
        /// What it was.
        what: String,
        /// The panic's message.
        message: String,
    },
}

impl fmt::Display for Incident {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Panicked { name, kind, message, .. } => write!(f, "{name} panicked over {kind}: {message}"),
            Self::JobLost { job, message, .. } => write!(f, "job {job:#x} is given up, untold: {message}"),
            Self::LeaseLost { name, job, .. } => {
                write!(f, "{name} hangs at job {job:#x}: another one does it")
            }
            Self::CircuitOpen { name, .. } => write!(f, "{name} panicked too often and was stopped"),
            Self::TurnBroke { name, message, .. } => write!(f, "a turn of {name} broke off: {message}"),
            Self::Beside { what, message } => write!(f, "{what} panicked: {message}"),
        }
    }
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
    pub(crate) const END: u64 = 3;
}

/// The payload of a panic the simulator makes; it does not reach the panic hook.
pub(crate) struct Injected;

/// Runs code that is not ours; what it panics with comes back as text.
#[inline]
pub(crate) fn guarded<R>(body: impl FnOnce() -> R) -> Result<R, String> {
    catch_unwind(AssertUnwindSafe(body)).map_err(told)
}

#[cold]
fn told(panic: Box<dyn Any + Send>) -> String {
    message_of(panic.as_ref())
}

/// What a panic said.
pub(crate) fn message_of(payload: &(dyn Any + Send)) -> String {
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
