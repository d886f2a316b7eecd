//! What came over a link and was not heard yet: filled by who reads a connection, emptied by the one thread that hears.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::{self, Thread};
use std::time::Duration;

use crossbeam_queue::{ArrayQueue, SegQueue};

use crate::link::{Event, Gone, Peer, Waker};

/// Connections of a walk at once.
pub const PEERS_MAX: usize = 64;
/// Messages that a reader may be ahead of who hears them.
pub const AHEAD: usize = 64;
/// A look at an inbox that was full.
pub const FULL: Duration = Duration::from_millis(1);

/// A walk's: of all its guests. `S` is how one of them is sent to.
pub struct Events<S> {
    /// Guests that were let in, on their way to who hears.
    pub opened: SegQueue<(Peer, S)>,
    events: ArrayQueue<Event>,
    hears: Thread,
    closed: AtomicBool,
    /// Connections, greeted or not.
    pub peers: AtomicUsize,
}

impl<S> Events<S> {
    /// None so far; this thread is the one that hears.
    pub fn new() -> Self {
        Self {
            opened: SegQueue::new(),
            events: ArrayQueue::new(AHEAD * 4),
            hears: thread::current(),
            closed: AtomicBool::new(false),
            peers: AtomicUsize::new(0),
        }
    }

    /// Adds an event, or gives it back while there is no room: who says too much is not read on. Nobody hears it once this
    /// is closed.
    pub fn offer(&self, event: Event) -> Result<(), Event> {
        if !self.is_closed() {
            self.events.push(event)?;
        }
        self.hears.unpark();
        Ok(())
    }

    /// The next event, waited for at most so long. Who is let in comes to `guests`, who is gone leaves.
    pub fn next(&self, wait: Duration, guests: &mut BTreeMap<Peer, S>) -> Option<Event> {
        let event = self.events.pop().or_else(|| {
            thread::park_timeout(wait);
            self.events.pop()
        });
        while let Some((peer, sends)) = self.opened.pop() {
            guests.insert(peer, sends);
        }
        if let Some(Event::Closed(peer)) = &event {
            guests.remove(peer);
        }
        event
    }

    /// Nobody hears any more.
    pub fn close(&self) {
        self.closed.store(true, Ordering::SeqCst);
    }

    /// Whether somebody still hears.
    pub fn is_closed(&self) -> bool {
        self.closed.load(Ordering::SeqCst)
    }

    /// Wakes who hears.
    pub fn waker(&self) -> Waker {
        Waker(self.hears.clone())
    }
}

/// A guest's: of its walk.
pub struct Messages {
    messages: ArrayQueue<Vec<u8>>,
    gone: AtomicBool,
    hears: Thread,
}

impl Messages {
    /// None so far; this thread is the one that hears.
    pub fn new() -> Self {
        Self { messages: ArrayQueue::new(AHEAD), gone: AtomicBool::new(false), hears: thread::current() }
    }

    /// Adds a message, or gives it back while there is no room. Nobody hears it once this has ended.
    pub fn offer(&self, message: Vec<u8>) -> Result<(), Vec<u8>> {
        if !self.has_ended() {
            self.messages.push(message)?;
        }
        self.hears.unpark();
        Ok(())
    }

    /// No more comes, or nobody hears any more.
    pub fn end(&self) {
        self.gone.store(true, Ordering::SeqCst);
        self.hears.unpark();
    }

    /// Whether one of both is so.
    pub fn has_ended(&self) -> bool {
        self.gone.load(Ordering::SeqCst)
    }

    /// The next message, waited for at most so long; what came before the end is heard.
    ///
    /// # Errors
    /// After the last one.
    pub fn next(&self, wait: Duration) -> Result<Option<Vec<u8>>, Gone> {
        // In this order.
        let over = self.has_ended();
        match self.messages.pop() {
            Some(message) => return Ok(Some(message)),
            None if over => return Err(Gone),
            None => thread::park_timeout(wait),
        }
        Ok(self.messages.pop())
    }

    /// Wakes who hears.
    pub fn waker(&self) -> Waker {
        Waker(self.hears.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_finds_no_room_comes_back_and_nothing_is_heard_after_the_end() {
        let (events, mut guests) = (Events::new(), BTreeMap::new());
        events.opened.push((3, "a way"));
        let told = (0..=4 * AHEAD).find(|_| events.offer(Event::Opened(3)).is_err());
        assert_eq!(told, Some(4 * AHEAD));
        assert_eq!(events.next(Duration::ZERO, &mut guests), Some(Event::Opened(3)));
        assert_eq!(guests.get(&3), Some(&"a way"));
        events.close();
        assert!(events.offer(Event::Closed(3)).is_ok(), "it does not come back for ever");
        let messages = Messages::new();
        let told = (0..=AHEAD).find(|i| messages.offer(vec![*i as u8]).is_err());
        assert_eq!(told, Some(AHEAD));
        messages.end();
        assert!(messages.offer(Vec::new()).is_ok());
        for i in 0..AHEAD {
            assert_eq!(messages.next(Duration::ZERO), Ok(Some(vec![i as u8])));
        }
        assert_eq!(messages.next(Duration::ZERO), Err(Gone));
    }
}
