//! Bytes from one machine to another: what doors and guests need of whatever carries them.

use std::time::{Duration, Instant};

use crate::key::{Invitation, Key};
use crate::{quic, tcp};

/// Names a guest's connection at a door; never used twice.
pub type Peer = u64;

/// What a door hears.
#[derive(Debug, PartialEq, Eq)]
pub enum Event {
    /// Somebody with the key is there.
    Opened(Peer),
    /// Somebody says something, in order.
    Message(Peer, Vec<u8>),
    /// Somebody is gone.
    Closed(Peer),
}

/// The walk's end.
pub trait HostLink: Send {
    /// The next event, waited for at most so long, or until [`Waker`] wakes it.
    fn next(&mut self, wait: Duration) -> Option<Event>;
    /// Sends a message, or loses it where nobody takes it: who reads nothing is closed.
    fn send(&mut self, to: Peer, message: &[u8]);
    /// Ends a connection, once what was sent before is on its way.
    fn close(&mut self, peer: Peer);
    /// What guests are told to join.
    fn address(&self) -> String;
    /// Wakes whoever waits in [`HostLink::next`].
    fn waker(&self) -> Waker;
}

/// The guest's end.
pub trait GuestLink: Send {
    /// The next message, waited for at most so long; [`Gone`] once the walk is.
    ///
    /// # Errors
    /// Once the walk is gone.
    fn next(&mut self, wait: Duration) -> Result<Option<Vec<u8>>, Gone>;
    /// Sends a message.
    ///
    /// # Errors
    /// Once the walk is gone.
    fn send(&mut self, message: &[u8]) -> Result<(), Gone>;
    /// Wakes whoever waits in [`GuestLink::next`].
    fn waker(&self) -> Waker;
}

/// A guest's link that passes so many bytes a second, both ways together, but for what comes at once.
pub struct Limited {
    link: Box<dyn GuestLink>,
    /// Bytes a second.
    rate: f64,
    /// Bytes that may pass now; below zero nothing passes.
    allowance: f64,
    at: Instant,
}

impl Limited {
    /// Time for which nothing may have passed, to be made up for.
    const BURST: Duration = Duration::from_millis(100);

    /// Passes so many bytes a second, at least one.
    pub fn new(link: Box<dyn GuestLink>, bytes: u64) -> Self {
        Self { link, rate: bytes.max(1) as f64, allowance: 0.0, at: Instant::now() }
    }

    /// Time until something may pass.
    fn debt(&mut self) -> Duration {
        let most = self.rate * Self::BURST.as_secs_f64();
        self.allowance = (self.allowance + self.at.elapsed().as_secs_f64() * self.rate).min(most);
        self.at = Instant::now();
        Duration::from_secs_f64((-self.allowance).max(0.0) / self.rate)
    }
}

impl GuestLink for Limited {
    fn next(&mut self, wait: Duration) -> Result<Option<Vec<u8>>, Gone> {
        let debt = self.debt();
        if debt > Duration::ZERO {
            std::thread::sleep(debt.min(wait));
            return Ok(None);
        }
        let message = self.link.next(wait)?;
        self.allowance -= message.as_ref().map_or(0.0, |message| message.len() as f64);
        Ok(message)
    }

    fn send(&mut self, message: &[u8]) -> Result<(), Gone> {
        std::thread::sleep(self.debt());
        self.allowance -= message.len() as f64;
        self.link.send(message)
    }

    fn waker(&self) -> Waker {
        self.link.waker()
    }
}

/// The other side is gone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gone;

/// Wakes a thread that waits for messages.
#[derive(Clone, Debug)]
pub struct Waker(pub(crate) std::thread::Thread);

impl Waker {
    /// Wakes it.
    pub fn wake(&self) {
        self.0.unpark();
    }
}

/// Listens at an address, `quic/ADDRESS:PORT` or `tcp/ADDRESS:PORT`.
///
/// # Errors
/// If there is no such link, or nobody can listen there.
pub fn listen(address: &str, key: &Key) -> Result<Box<dyn HostLink>, String> {
    match address.split_once('/') {
        Some(("quic", at)) => Ok(Box::new(quic::Listener::new(at, key)?)),
        Some(("tcp", at)) => Ok(Box::new(tcp::Listener::new(at, key)?)),
        _ => Err(unknown(address)),
    }
}

/// Goes where an invitation leads.
///
/// # Errors
/// If nobody answers there, or somebody without the key does.
pub fn connect(invitation: &Invitation) -> Result<Box<dyn GuestLink>, String> {
    match invitation.address.split_once('/') {
        Some(("quic", at)) => Ok(Box::new(quic::Connection::new(at, &invitation.key)?)),
        Some(("tcp", at)) => Ok(Box::new(tcp::Connection::new(at, &invitation.key)?)),
        _ => Err(unknown(&invitation.address)),
    }
}

fn unknown(address: &str) -> String {
    format!(
        "{address}: no such link; this program has quic/ADDRESS:PORT, and tcp/ADDRESS:PORT on this machine's own addresses"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Takes and gives whatever is wanted.
    struct Wide;

    impl GuestLink for Wide {
        fn next(&mut self, _: Duration) -> Result<Option<Vec<u8>>, Gone> {
            Ok(Some(vec![0; 10_000]))
        }

        fn send(&mut self, _: &[u8]) -> Result<(), Gone> {
            Ok(())
        }

        fn waker(&self) -> Waker {
            Waker(std::thread::current())
        }
    }

    #[test]
    fn no_more_passes_than_is_allowed() {
        let mut link = Limited::new(Box::new(Wide), 1_000_000);
        let (began, mut passed) = (Instant::now(), 0);
        while began.elapsed() < Duration::from_millis(300) {
            link.send(&[0; 5_000]).unwrap();
            passed += 5_000 + link.next(Duration::from_millis(1)).unwrap().map_or(0, |m| m.len());
        }
        // The last message of either way may be ahead of its time.
        let most = began.elapsed().as_secs_f64() * 1e6 + 15_000.0;
        assert!(passed as f64 <= most && passed > 50_000, "{passed} of {most}");
    }
}
