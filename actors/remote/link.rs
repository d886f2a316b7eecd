//! Bytes from one machine to another: what doors and guests need of whatever carries them.

use std::time::Duration;

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
