//! A mailbox: one bounded queue for data, a small one for control messages, newest-only slots, timers, and a
//! word of signals that can never overflow.

use crossbeam_queue::{ArrayQueue, SegQueue};
use crossbeam_utils::CachePadded;
use serde::{Serialize, Serializer};
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::message::{ActorId, LATEST_KEYS, Lane, Message, Reason, Rejected};
use crate::scheduler::ThreadCx;
use crate::scheduler::link::Link;
use crate::scheduler::signals::signal;
use crate::scheduler::timer::{Alarm, TIMERS_PER_ACTOR};

/// Bounds of a mailbox.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bounds {
    /// Data messages that may wait.
    pub messages: usize,
    /// Bytes that waiting messages may hold beside themselves ([`Message::size_bytes`]).
    pub bytes: usize,
    /// Control messages that may wait.
    pub control: usize,
}

impl Bounds {
    /// At most `messages` data messages, 64 control messages, and 1 GiB.
    pub const fn messages(messages: usize) -> Self {
        Self { messages, bytes: 1 << 30, control: 64 }
    }

    /// The same with another bound of bytes.
    pub const fn bytes(self, bytes: usize) -> Self {
        Self { bytes, ..self }
    }
}

/// A payload as it is recorded; boxed, since most messages have none.
#[derive(Default)]
pub(crate) struct Encoded(pub(crate) Vec<u8>);

/// A message on its way.
pub(crate) struct Envelope<M> {
    pub(crate) from: ActorId,
    /// Newest-only messages: how many this sender sent into this slot before.
    pub(crate) sequence: u32,
    /// Hash of the message, where the sender took it; 0 where it did not.
    pub(crate) digest: u64,
    /// Encoded payload, for what comes from outside while a recording runs.
    pub(crate) external: Option<Box<Encoded>>,
    pub(crate) message: M,
}

/// A regenerated message during replay; it waits with its receiver until the script calls for it.
pub(crate) struct Inbound<M> {
    pub(crate) from: ActorId,
    pub(crate) lane: u8,
    /// Deliveries to the sender before it was sent, the one that it was sent in included.
    pub(crate) sent_in: u64,
    pub(crate) message: M,
}

/// Turns a recorded payload of a port back into a message.
pub(crate) type Decoder<M> = fn(&[u8]) -> Option<M>;

pub(crate) struct Mailbox<M> {
    pub(crate) link: Arc<Link>,
    pub(crate) data: ArrayQueue<Envelope<M>>,
    pub(crate) urgent: ArrayQueue<Envelope<M>>,
    pub(crate) latest: Box<[ArrayQueue<Envelope<M>>]>,
    pub(crate) fired: ArrayQueue<u32>,
    bytes: CachePadded<AtomicUsize>,
    bytes_max: usize,
    /// Replay only; its length is bounded by what the recorded run sent.
    pub(crate) inbound: SegQueue<Inbound<M>>,
    pub(crate) decoders: SegQueue<(ActorId, Decoder<M>)>,
}

impl<M: Message> Mailbox<M> {
    pub(crate) fn new(link: Arc<Link>, bounds: Bounds) -> Self {
        Self {
            link,
            data: ArrayQueue::new(bounds.messages.max(1)),
            urgent: ArrayQueue::new(bounds.control.max(1)),
            latest: (0..LATEST_KEYS).map(|_| ArrayQueue::new(1)).collect(),
            fired: ArrayQueue::new(TIMERS_PER_ACTOR),
            bytes: CachePadded::new(AtomicUsize::new(0)),
            bytes_max: bounds.bytes,
            inbound: SegQueue::new(),
            decoders: SegQueue::new(),
        }
    }

    /// Accepts a message, or gives it back.
    #[inline(always)]
    pub(crate) fn accept(&self, envelope: Envelope<M>, thread: &ThreadCx) -> Result<(), Rejected<M>> {
        let back = |envelope: Envelope<M>, reason| Err(Rejected { message: envelope.message, reason });
        if self.link.closed.load(Ordering::Acquire) {
            return back(envelope, Reason::Stopped);
        }
        match envelope.message.lane() {
            Lane::Data => {
                let bytes = envelope.message.size_bytes();
                if bytes > 0 && !self.reserve(bytes) {
                    return back(envelope, Reason::FullBytes);
                }
                if let Err(envelope) = self.data.push(envelope) {
                    self.release(bytes);
                    return back(envelope, Reason::Full);
                }
                self.link.wake(thread);
            }
            Lane::Control => {
                if let Err(envelope) = self.urgent.push(envelope) {
                    return back(envelope, Reason::Full);
                }
                self.link.raise(signal::URGENT, thread);
            }
            Lane::Latest(key) => {
                let key = key % LATEST_KEYS;
                if self.latest[usize::from(key)].force_push(envelope).is_some() {
                    self.link.counters.replaced();
                }
                self.link.raise(signal::LATEST << key, thread);
            }
        }
        Ok(())
    }

    #[inline]
    fn reserve(&self, bytes: usize) -> bool {
        let before = self.bytes.fetch_add(bytes, Ordering::Relaxed);
        // One message larger than the whole bound may pass when it is alone: it could never be sent otherwise.
        let fits = before == 0 || before.saturating_add(bytes) <= self.bytes_max;
        if !fits {
            self.bytes.fetch_sub(bytes, Ordering::Relaxed);
        }
        fits
    }

    /// Gives back the bytes of a message that was taken out.
    #[inline]
    pub(crate) fn release(&self, bytes: usize) {
        if bytes > 0 {
            self.bytes.fetch_sub(bytes, Ordering::Relaxed);
        }
    }

    /// Takes a regenerated message during replay.
    pub(crate) fn accept_replayed(&self, inbound: Inbound<M>, thread: &ThreadCx) {
        self.inbound.push(inbound);
        self.link.wake(thread);
    }

    /// Messages that wait in the data queue.
    pub(crate) fn depth(&self) -> usize {
        self.data.len()
    }
}

impl<M: Message> Alarm for Mailbox<M> {
    fn fire(&self, timer: u32, thread: &ThreadCx) {
        // Never full: an actor has at most `TIMERS_PER_ACTOR` timers until their delivery.
        let pushed = self.fired.push(timer).is_ok();
        debug_assert!(pushed, "more timers fired than can run");
        self.link.raise(signal::TIMER, thread);
    }
}

/// Where an actor can be reached. Clones are cheap; identity is the order of creation.
pub struct Address<M> {
    pub(crate) mailbox: Arc<Mailbox<M>>,
}

impl<M> Clone for Address<M> {
    fn clone(&self) -> Self {
        Self { mailbox: Arc::clone(&self.mailbox) }
    }
}

/// Its identity: all that can be said of it outside of the system.
impl<M> Serialize for Address<M> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.mailbox.link.id.serialize(serializer)
    }
}

impl<M: Message> Address<M> {
    /// The receiver's identity.
    pub fn id(&self) -> ActorId {
        self.mailbox.link.id
    }

    /// Data messages that wait now. Not for decisions inside an actor: it is not recorded.
    pub fn depth(&self) -> usize {
        self.mailbox.depth()
    }
}

impl<M> PartialEq for Address<M> {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.mailbox, &other.mailbox)
    }
}

impl<M> fmt::Debug for Address<M> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Address({})", self.mailbox.link.id)
    }
}
