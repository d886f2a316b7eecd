//! The only way into the system from outside.

use serde::{Serialize, de::DeserializeOwned};
use std::marker::PhantomData;
use std::sync::Arc;

use crate::journal::env::Env;
use crate::mailbox::{Address, Encoded, Envelope};
use crate::message::{ActorId, Message, Reason, Rejected};
use crate::scheduler::ThreadCx;

/// What can come from outside: it can be written down, and becomes a message of the receiver.
pub trait External<M>: Serialize + DeserializeOwned + Into<M> {}

impl<M, E: Serialize + DeserializeOwned + Into<M>> External<M> for E {}

/// An ingress of input, clock ticks, measured durations: each payload is recorded when it is delivered, and comes from
/// the recording during replay, when what is sent here is ignored.
///
/// A port is a sender of its own with one owner, so its messages arrive in order. Make several for several threads.
pub struct Port<E, M> {
    id: ActorId,
    to: Address<M>,
    env: Arc<Env>,
    thread: ThreadCx,
    kind: PhantomData<fn(E)>,
}

impl<E: External<M>, M: Message> Port<E, M> {
    pub(crate) fn new(id: ActorId, to: &Address<M>, env: &Arc<Env>) -> Self {
        to.mailbox.decoders.push((id, |bytes| postcard::from_bytes::<E>(bytes).ok().map(Into::into)));
        Self { id, to: to.clone(), env: Arc::clone(env), thread: ThreadCx::outside(), kind: PhantomData }
    }

    /// The port's identity as a sender.
    pub fn id(&self) -> ActorId {
        self.id
    }

    /// Hands `input` in. The message made from it comes back if the mailbox is full or the system shuts down.
    pub fn send(&self, input: E) -> Result<(), Rejected<M>> {
        let env = &*self.env;
        if env.replaying() {
            return Ok(());
        }
        // What cannot be encoded is delivered all the same; the recording then ends before it.
        let external = env.recording().then(|| match postcard::to_stdvec(&input) {
            Ok(bytes) => Box::new(Encoded(bytes)),
            Err(error) => {
                env.stop_recording(format!("an input of {} cannot be encoded: {error}", env.name(self.id)));
                Box::default()
            }
        });
        let message: M = input.into();
        if env.closed() {
            return Err(Rejected { message, reason: Reason::Stopped });
        }
        let envelope = Envelope { from: self.id, sequence: 0, digest: 0, external, message };
        let result = self.to.mailbox.accept(envelope, &self.thread);
        if result.is_err() {
            self.to.mailbox.link.counters.rejected();
        }
        result
    }
}
