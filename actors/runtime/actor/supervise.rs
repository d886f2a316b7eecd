//! What happens when an actor panics: the mailbox stays in order, the job goes back, and somebody is told.

use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

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
