//! Actors that come while the system runs, into places that were reserved when it was wired.
//!
//! A place is a number among the actors, a mailbox and a part of the recording, so a replay finds there what was
//! recorded. Whoever owns the reserve gives its places away in order: who comes where is the same in every replay.

use std::collections::VecDeque;
use std::sync::Arc;

use crate::actor::node::Node;
use crate::actor::supervise::OnPanic;
use crate::actor::{Actor, Cx, Handle};
use crate::mailbox::Address;
use crate::message::Message;

/// Places for actors of one kind; belongs to the actor that will spawn them. Made by [`crate::Wiring::reserve`].
pub struct Reserve<A: Actor> {
    free: VecDeque<Arc<Node<A>>>,
}

impl<A: Actor> Reserve<A> {
    pub(crate) fn new(free: VecDeque<Arc<Node<A>>>) -> Self {
        Self { free }
    }

    /// Places that are left.
    pub fn len(&self) -> usize {
        self.free.len()
    }

    /// Nobody can come any more.
    pub fn is_empty(&self) -> bool {
        self.free.is_empty()
    }

    /// Names of those who will come, to look at their states.
    pub fn handles(&self) -> Vec<Handle<A>> {
        self.free.iter().map(|node| Handle::new(node.id())).collect()
    }
}

impl<M: Message> Cx<'_, M> {
    /// Lets an actor begin in the next place of `reserve`, and says what becomes of it when it panics. It comes back where
    /// no place is left: one that has stopped leaves its place taken.
    ///
    /// A replay in which somebody has come so has no snapshots from there on.
    pub fn spawn<A: Actor>(
        &mut self,
        reserve: &mut Reserve<A>,
        actor: A,
        on_panic: OnPanic<A>,
    ) -> Result<Address<A::Msg>, A> {
        let Some(node) = reserve.free.pop_front() else { return Err(actor) };
        Ok(node.arrive(actor, on_panic, self.thread))
    }
}
