//! Where a replay parts from its recording, and where it is to stop.

use std::fmt;

use crate::message::ActorId;
use crate::message::content::Content;
use crate::scheduler::ThreadCx;

/// One delivery in a report.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Turn {
    /// Its number among the actor's deliveries.
    pub index: u64,
    /// The sender.
    pub from: ActorId,
    /// `data`, `control`, `timer`, `job`, …
    pub lane: &'static str,
    /// The message's variant.
    pub kind: &'static str,
}

/// What an actor said to another one.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Said {
    /// To whom; for a job, which whoever is free may take, who made it.
    pub to: ActorId,
    /// The message's variant, or the job's.
    pub kind: &'static str,
    /// What is in it.
    pub says: Content,
}

/// Something that was said in a replay and waits until it is known whether the recording has it, too.
pub(crate) trait Held: Send {
    fn tell(&self) -> Said;
    fn go(self: Box<Self>, thread: &ThreadCx);
}

/// Where a replay parts from its recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Divergence {
    /// The actor at which it showed.
    pub actor: ActorId,
    /// Its name.
    pub name: String,
    /// Number of the delivery.
    pub index: u64,
    /// The application's last mark before: kind and value.
    pub mark: Option<(u32, u64)>,
    /// The message's variant.
    pub kind: &'static str,
    /// Who sent it.
    pub from: Option<ActorId>,
    /// What the recording holds.
    pub expected: String,
    /// What happened instead.
    pub found: String,
    /// All that the actor said there in this replay, where that is what differs. Nobody was told it.
    pub said: Option<Vec<Said>>,
    /// The actor's last deliveries, newest first (at most 20).
    pub turns: Vec<Turn>,
}

impl fmt::Display for Divergence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}, delivery {}: {}", self.name, self.actor, self.index, self.kind)?;
        if let Some(from) = self.from {
            write!(f, " from {from}")?;
        }
        write!(f, ": expected {}, found {}", self.expected, self.found)?;
        if let Some((kind, value)) = self.mark {
            write!(f, " (last mark: {kind} with {value:016x})")?;
        }
        for turn in &self.turns {
            write!(f, "\n  {:>10}  {} from {} ({})", turn.index, turn.kind, turn.from, turn.lane)?;
        }
        Ok(())
    }
}

/// Where a replay is to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Until {
    /// When so many marks of this kind have been made.
    Mark {
        /// The application's kind.
        kind: u32,
        /// How many of them, from 1.
        count: u64,
    },
    /// After this delivery of this actor.
    Delivery {
        /// The actor.
        actor: ActorId,
        /// Number of the delivery, from 0.
        index: u64,
    },
}
