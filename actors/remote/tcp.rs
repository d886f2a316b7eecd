//! Plain connections between processes of one machine, and through tunnels that end there (`ssh -L`).
//!
//! Each message is its length, four bytes, and itself. Both sides prove that they have the key before anything else is
//! said; nothing is encrypted, so that nobody listens elsewhere than on loopback. A thread reads each connection.

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::{IpAddr, Shutdown, SocketAddr, TcpListener, TcpStream, ToSocketAddrs};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::{self, JoinHandle};
use std::time::Duration;

use foveal_actors::station::wire::MESSAGE_BYTES_MAX;

use crate::inbox::{Events, FULL, Messages, PEERS_MAX};
use crate::key::Key;
use crate::link::{Event, Gone, GuestLink, HostLink, Peer, Waker};

/// Time for both proofs.
const GREETING: Duration = Duration::from_secs(5);
/// Somebody who takes nothing for so long is gone.
const UNREAD: Duration = Duration::from_secs(2);

/// The first bytes of either side.
const MAGIC: [u8; 8] = *b"foveal-1";

fn proved(stream: &mut TcpStream, key: &Key, own: &str, other: &str) -> Option<()> {
    stream.set_nodelay(true).ok()?;
    stream.set_read_timeout(Some(GREETING)).ok()?;
    stream.set_write_timeout(Some(UNREAD)).ok()?;
    let mut nonce = [0; 32];
    getrandom::fill(&mut nonce).ok()?;
    stream.write_all(&MAGIC).ok()?;
    stream.write_all(&nonce).ok()?;
    let (mut magic, mut asked, mut proof) = ([0; 8], [0; 32], [0; 32]);
    stream.read_exact(&mut magic).ok()?;
    stream.read_exact(&mut asked).ok()?;
    if magic != MAGIC || asked == nonce {
        return None;
    }
    stream.write_all(&key.proof(own, &asked)).ok()?;
    stream.read_exact(&mut proof).ok()?;
    if !key.is_proof(other, &nonce, &proof) {
        return None;
    }
    stream.set_read_timeout(None).ok()
}

/// Reads a message; none where there is no whole one, or one that is too long.
fn read(stream: &mut TcpStream) -> Option<Vec<u8>> {
    let mut length = [0; 4];
    stream.read_exact(&mut length).ok()?;
    let length = u32::from_le_bytes(length) as usize;
    if length > MESSAGE_BYTES_MAX {
        return None;
    }
    let mut message = Vec::new();
    // Room as it comes, not as it is said to come.
    stream.take(length as u64).read_to_end(&mut message).ok()?;
    (message.len() == length).then_some(message)
}

fn write(stream: &mut TcpStream, message: &[u8]) -> std::io::Result<()> {
    let mut framed = Vec::with_capacity(4 + message.len());
    framed.extend_from_slice(&(message.len() as u32).to_le_bytes());
    framed.extend_from_slice(message);
    stream.write_all(&framed)
}

/// Tells who hears, once there is room.
fn tell(inbox: &Events<TcpStream>, mut event: Event) {
    while let Err(back) = inbox.offer(event) {
        event = back;
        thread::sleep(FULL);
    }
}

/// Listens on this machine's own addresses.
pub struct Listener {
    inbox: Arc<Events<TcpStream>>,
    at: SocketAddr,
    peers: BTreeMap<Peer, TcpStream>,
    thread: Option<JoinHandle<()>>,
}

impl Listener {
    /// Listens at an address of loopback. The thread that calls this is the one that hears.
    ///
    /// # Errors
    /// If it is no such address, or is taken.
    pub fn new(at: &str, key: &Key) -> Result<Self, String> {
        let address = resolved(at)?;
        let listener = TcpListener::bind(address).map_err(|e| format!("tcp/{at}: {e}"))?;
        let at = listener.local_addr().map_err(|e| format!("tcp/{at}: {e}"))?;
        let inbox = Arc::new(Events::new());
        let (shared, key) = (Arc::clone(&inbox), key.clone());
        let spawned =
            thread::Builder::new().name("door".into()).spawn(move || accept(&listener, &shared, &key));
        let thread = spawned.map_err(|e| format!("tcp/{at}: {e}"))?;
        Ok(Self { inbox, at, peers: BTreeMap::new(), thread: Some(thread) })
    }
}

/// An address of loopback.
fn resolved(at: &str) -> Result<SocketAddr, String> {
    let found = at.to_socket_addrs().map_err(|e| format!("tcp/{at}: {e}"))?;
    let is_own = |address: &SocketAddr| match address.ip() {
        IpAddr::V4(ip) => ip.is_loopback(),
        IpAddr::V6(ip) => ip.is_loopback(),
    };
    let mut found = found.filter(is_own);
    found.next().ok_or_else(|| {
        format!("tcp/{at}: what goes over tcp is not encrypted, so it stays on this machine: 127.0.0.1 or a tunnel")
    })
}

fn accept(listener: &TcpListener, inbox: &Arc<Events<TcpStream>>, key: &Key) {
    let mut next: Peer = 0;
    for stream in listener.incoming() {
        if inbox.is_closed() {
            return;
        }
        let Ok(mut stream) = stream else { continue };
        if inbox.peers.fetch_add(1, Ordering::Relaxed) >= PEERS_MAX {
            inbox.peers.fetch_sub(1, Ordering::Relaxed);
            continue;
        }
        let (inbox, key, peer) = (Arc::clone(inbox), key.clone(), next);
        next += 1;
        // Who does not come to the end of greeting keeps a thread for five seconds.
        let _ = thread::Builder::new().name(format!("guest {peer}")).spawn(move || {
            if proved(&mut stream, &key, "walk", "guest").is_some()
                && let Ok(own) = stream.try_clone()
            {
                inbox.opened.push((peer, own));
                if inbox.is_closed() {
                    // Who closed it may have looked for guests before this one was there.
                    let _ = stream.shutdown(Shutdown::Both);
                }
                tell(&inbox, Event::Opened(peer));
                while let Some(message) = read(&mut stream) {
                    tell(&inbox, Event::Message(peer, message));
                }
                tell(&inbox, Event::Closed(peer));
            }
            inbox.peers.fetch_sub(1, Ordering::Relaxed);
        });
    }
}

impl HostLink for Listener {
    fn next(&mut self, wait: Duration) -> Option<Event> {
        self.inbox.next(wait, &mut self.peers)
    }

    fn send(&mut self, to: Peer, message: &[u8]) {
        let Some(stream) = self.peers.get_mut(&to) else { return };
        if write(stream, message).is_err() {
            let _ = stream.shutdown(Shutdown::Both);
        }
    }

    fn close(&mut self, peer: Peer) {
        if let Some(stream) = self.peers.remove(&peer) {
            let _ = stream.shutdown(Shutdown::Both);
        }
    }

    fn address(&self) -> String {
        format!("tcp/{}", self.at)
    }

    fn waker(&self) -> Waker {
        self.inbox.waker()
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        self.inbox.close();
        // Those, too, that nobody has heard of yet.
        let unheard = std::iter::from_fn(|| self.inbox.opened.pop()).map(|(_, stream)| stream);
        for stream in std::mem::take(&mut self.peers).into_values().chain(unheard) {
            let _ = stream.shutdown(Shutdown::Both);
        }
        // It waits for one more. Once it has ended, the address is free.
        if TcpStream::connect_timeout(&self.at, Duration::from_secs(1)).is_ok()
            && let Some(thread) = self.thread.take()
        {
            let _ = thread.join();
        }
    }
}

/// A guest's connection.
pub struct Connection {
    stream: TcpStream,
    inbox: Arc<Messages>,
}

impl Connection {
    /// Goes to an address of loopback. The thread that calls this is the one that hears.
    ///
    /// # Errors
    /// If nobody answers, or somebody without the key.
    pub fn new(at: &str, key: &Key) -> Result<Self, String> {
        let address = resolved(at)?;
        let connected = TcpStream::connect_timeout(&address, GREETING);
        let mut stream = connected.map_err(|e| format!("tcp/{at}: nobody answers: {e}"))?;
        proved(&mut stream, key, "guest", "walk")
            .ok_or_else(|| format!("tcp/{at}: whoever is there has another key"))?;
        let inbox = Arc::new(Messages::new());
        let shared = Arc::clone(&inbox);
        let mut reads = stream.try_clone().map_err(|e| format!("tcp/{at}: {e}"))?;
        let reader = move || {
            while let Some(mut message) = read(&mut reads) {
                while let Err(back) = shared.offer(message) {
                    message = back;
                    thread::sleep(FULL);
                }
                if shared.has_ended() {
                    return;
                }
            }
            shared.end();
        };
        thread::Builder::new().name("walk".into()).spawn(reader).map_err(|e| format!("tcp/{at}: {e}"))?;
        Ok(Self { stream, inbox })
    }
}

impl GuestLink for Connection {
    fn next(&mut self, wait: Duration) -> Result<Option<Vec<u8>>, Gone> {
        self.inbox.next(wait)
    }

    fn send(&mut self, message: &[u8]) -> Result<(), Gone> {
        write(&mut self.stream, message).map_err(|_| Gone)
    }

    fn waker(&self) -> Waker {
        self.inbox.waker()
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.inbox.end();
        let _ = self.stream.shutdown(Shutdown::Both);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn heard(listener: &mut Listener) -> Event {
        (0..500).find_map(|_| listener.next(Duration::from_millis(10))).expect("something is heard")
    }

    #[test]
    fn what_is_said_is_heard_and_who_is_gone_is_known() {
        let key = Key::new().unwrap();
        let mut listener = Listener::new("127.0.0.1:0", &key).unwrap();
        let at = listener.at.to_string();
        let mut guest = Connection::new(&at, &key).unwrap();
        assert_eq!(heard(&mut listener), Event::Opened(0));
        let long: Vec<u8> = (0..MESSAGE_BYTES_MAX).map(|i| i as u8).collect();
        guest.send(b"hello").unwrap();
        guest.send(&long).unwrap();
        assert_eq!(heard(&mut listener), Event::Message(0, b"hello".to_vec()));
        assert_eq!(heard(&mut listener), Event::Message(0, long));
        listener.send(0, b"welcome");
        let said = (0..500).find_map(|_| guest.next(Duration::from_millis(10)).unwrap());
        assert_eq!(said.as_deref(), Some(&b"welcome"[..]));
        drop(guest);
        assert_eq!(heard(&mut listener), Event::Closed(0));
        let mut guest = Connection::new(&at, &key).unwrap();
        assert_eq!(heard(&mut listener), Event::Opened(1));
        drop(listener);
        assert!((0..500).any(|_| guest.next(Duration::from_millis(10)).is_err()));
    }

    #[test]
    fn who_has_another_key_hears_and_says_nothing() {
        let mut listener = Listener::new("127.0.0.1:0", &Key::new().unwrap()).unwrap();
        let at = listener.at.to_string();
        assert!(Connection::new(&at, &Key::new().unwrap()).is_err());
        // Neither is who says what the walk says.
        let mut mirror = TcpStream::connect(&at).unwrap();
        let mut hello = [0; 40];
        mirror.read_exact(&mut hello).unwrap();
        mirror.write_all(&hello).unwrap();
        assert_eq!(mirror.read(&mut hello).unwrap_or(0), 0);
        assert_eq!(listener.next(Duration::from_millis(50)), None);
    }

    #[test]
    fn a_length_that_cannot_be_ends_the_connection() {
        let key = Key::new().unwrap();
        let mut listener = Listener::new("127.0.0.1:0", &key).unwrap();
        let mut guest = Connection::new(&listener.at.to_string(), &key).unwrap();
        assert_eq!(heard(&mut listener), Event::Opened(0));
        guest.stream.write_all(&u32::MAX.to_le_bytes()).unwrap();
        assert_eq!(heard(&mut listener), Event::Closed(0));
    }

    #[test]
    fn only_this_machine_is_reached_without_encryption() {
        for at in ["0.0.0.0:0", "192.0.2.1:7447", "[::]:0", "nowhere"] {
            assert!(resolved(at).is_err(), "{at}");
        }
        assert!(resolved("127.0.0.1:0").is_ok());
    }
}
