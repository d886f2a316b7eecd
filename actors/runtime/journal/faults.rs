//! What goes wrong in a simulation.

use crate::message::ActorId;
use crate::scheduler::work::Random;

/// What can go wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum FaultKind {
    /// A delivery panics before the actor sees it.
    Panic,
    /// A send or push comes back as if there was no room.
    Full,
    /// One turn comes a millisecond late.
    Delay,
    /// The actor hangs for 100 ms.
    Stall,
    /// Ten turns take 100 times as long.
    Slow,
    /// The recording's file ends at this byte. Of no actor: whoever gives the sink makes it so.
    TornLog,
    /// The disk that is recorded to has room for so many bytes. Of no actor, as above.
    DiskFull,
    /// A worker hangs at its next job from this delivery on, so that it loses its lease. Nothing where jobs have none.
    Hang,
}

/// One thing that goes wrong: at this delivery (panic, hang), send (full) or turn (delay, stall, slow) of this actor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Fault {
    /// Where.
    pub actor: ActorId,
    /// What.
    pub kind: FaultKind,
    /// When, from 0.
    pub at: u64,
}

/// Which faults a run has.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Faults {
    /// Exactly these.
    Listed(Vec<Fault>),
    /// Drawn by the seed: up to `each` of every kind for every actor, among its first `horizon` deliveries, sends or
    /// turns.
    Seeded {
        /// Kinds to draw.
        kinds: Vec<FaultKind>,
        /// At most so many of a kind for an actor.
        each: u64,
        /// None come later than this.
        horizon: u64,
    },
}

impl Faults {
    /// A run without faults.
    pub const NONE: Self = Self::Listed(Vec::new());

    /// The faults of one actor.
    pub fn of(&self, seed: u64, actor: ActorId) -> Vec<Fault> {
        match self {
            Self::Listed(faults) => faults.iter().filter(|fault| fault.actor == actor).copied().collect(),
            Self::Seeded { kinds, each, horizon } => {
                let mut faults = Vec::new();
                for kind in kinds {
                    let mut random = Random::new(&[seed, u64::from(actor.0), *kind as u64, 0xfa17]);
                    for _ in 0..random.below(each + 1) {
                        faults.push(Fault { actor, kind: *kind, at: random.below((*horizon).max(1)) });
                    }
                }
                faults
            }
        }
    }
}
