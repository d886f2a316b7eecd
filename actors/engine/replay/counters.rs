//! Numbers in the state of actors that never fall. Snapshots are kept with them, so that where one of them passes a bound is
//! known without a look into any.

use foveal_runtime::{Runtime, Snapshot, Trace};

/// Actors and paths of such numbers.
pub(super) const COUNTERS: [(&str, &str); 6] = [
    ("renderer", "view"),
    ("allocator", "begun"),
    ("analyzer", "analyzed"),
    ("illuminator", "turns"),
    ("illuminator", "rounds"),
    ("illuminator", "published_in"),
];
/// Stands for a number that an actor does not tell, or for an actor that is not there.
const UNTOLD: u64 = u64::MAX;

/// What each of them is somewhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Counts(pub(super) [u64; COUNTERS.len()]);

impl Counts {
    /// In a replay, between two turns.
    pub(super) fn of(trace: &Trace, runtime: &Runtime) -> Self {
        let mut last = None;
        Self(COUNTERS.map(|(name, path)| {
            // Those of one actor stand beside each other.
            if last.as_ref().is_none_or(|(of, _)| *of != name) {
                last = Some((name, trace.find(name).and_then(|actor| runtime.content(actor))));
            }
            let state = last.as_ref().and_then(|(_, state)| state.as_ref());
            let number = state.and_then(|state| state.at(path)?.number());
            number.map_or(UNTOLD, |number| number as u64)
        }))
    }

    /// The number at this path of this actor, if it is one of them and told.
    pub(super) fn at(&self, name: &str, path: &str) -> Option<u64> {
        let which = COUNTERS.iter().position(|counter| *counter == (name, path))?;
        Some(self.0[which]).filter(|number| *number != UNTOLD)
    }
}

/// A snapshot of a replay, with its counts.
pub(super) fn counted(trace: &Trace, runtime: &Runtime) -> Option<(Snapshot, Counts)> {
    runtime.held(|runtime| Some((runtime.snapshot()?, Counts::of(trace, runtime))))
}
