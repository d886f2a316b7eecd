//! What went wrong, and how panics of code that is not ours become that.

use serde::{Deserialize, Serialize};
use std::any::Any;
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};

use crate::message::ActorId;

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
