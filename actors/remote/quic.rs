//! QUIC: encrypted connections between machines, in which either side is known by the walk's secret ([`identity`]).
//!
//! One stream a guest carries messages, each its length, four bytes, and itself. A thread with a small loop of its own does
//! all that comes and goes at one end; what is sent waits in a queue with an end: who reads too little is closed.

use std::collections::BTreeMap;
use std::future::Future;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::{self, JoinHandle};
use std::time::Duration;

use foveal_actors::station::wire::MESSAGE_BYTES_MAX;
use quinn::crypto::rustls::{QuicClientConfig, QuicServerConfig};
use quinn::{
    ClientConfig, Connection as Quic, Endpoint, EndpointConfig, IdleTimeout, Incoming, RecvStream,
    SendStream, ServerConfig, TokioRuntime, TransportConfig, VarInt,
};
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinSet;
use tokio::time::timeout;

use crate::identity;
use crate::inbox::{AHEAD, Events, FULL, Messages, PEERS_MAX};
use crate::key::Key;
use crate::link::{Event, Gone, GuestLink, HostLink, Peer, Waker};

/// From so many on, who comes has to show first that its address is its own.
const PEERS_UNPROVED: usize = 8;
/// Messages that a walk may be ahead of a guest.
const UNREAD: usize = 256;
/// Time until both sides know each other.
const GREETING: Duration = Duration::from_secs(5);
/// Who says nothing for so long, not even that it is there, is gone.
const SILENCE: Duration = Duration::from_secs(3);
/// How often a side says that it is there.
const SIGN_OF_LIFE: Duration = Duration::from_millis(500);
/// Time that the last messages have.
const LAST_WORDS: Duration = Duration::from_secs(1);

/// The first bytes of either side.
const MAGIC: [u8; 8] = *b"foveal-1";

fn transport() -> Arc<TransportConfig> {
    let mut transport = TransportConfig::default();
    transport
        .max_concurrent_bidi_streams(VarInt::from_u32(1))
        .max_concurrent_uni_streams(VarInt::from_u32(0))
        .datagram_receive_buffer_size(None)
        .keep_alive_interval(Some(SIGN_OF_LIFE))
        .max_idle_timeout(IdleTimeout::try_from(SILENCE).ok());
    Arc::new(transport)
}

/// Runs what comes and goes at one end, until it ends.
fn in_thread(name: &str, run: impl Future<Output = ()> + Send + 'static) -> Result<JoinHandle<()>, String> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_io().enable_time().build();
    let runtime = runtime.map_err(|e| format!("quic: {e}"))?;
    thread::Builder::new()
        .name(name.into())
        .spawn(move || runtime.block_on(run))
        .map_err(|e| format!("quic: no thread: {e}"))
}

fn resolved(at: &str) -> Result<SocketAddr, String> {
    let mut found = at.to_socket_addrs().map_err(|e| format!("quic/{at}: {e}"))?;
    found.next().ok_or_else(|| format!("quic/{at}: no such address"))
}

/// The address that others reach: this machine's own where it listens on all.
fn reachable(at: SocketAddr) -> SocketAddr {
    if !at.ip().is_unspecified() {
        return at;
    }
    // Nothing is sent; the system only says by which address it would go (to one of those kept for documentation).
    let own = match at {
        SocketAddr::V4(_) => own_address((Ipv4Addr::UNSPECIFIED, 0).into(), "192.0.2.1:9"),
        SocketAddr::V6(_) => own_address((Ipv6Addr::UNSPECIFIED, 0).into(), "[2001:db8::1]:9"),
    };
    let loopback = if at.is_ipv4() { Ipv4Addr::LOCALHOST.into() } else { Ipv6Addr::LOCALHOST.into() };
    SocketAddr::new(own.unwrap_or(loopback), at.port())
}

fn own_address(from: SocketAddr, to: &str) -> Option<std::net::IpAddr> {
    let socket = UdpSocket::bind(from).ok()?;
    socket.connect(to).ok()?;
    Some(socket.local_addr().ok()?.ip())
}

/// Reads a message; none where there is no whole one, or one that is too long.
async fn read(stream: &mut RecvStream) -> Option<Vec<u8>> {
    let mut length = [0; 4];
    stream.read_exact(&mut length).await.ok()?;
    let length = u32::from_le_bytes(length) as usize;
    if length > MESSAGE_BYTES_MAX {
        return None;
    }
    let mut message = Vec::new();
    // Room as it comes, not as it is said to come.
    while message.len() < length {
        let chunk = stream.read_chunk(length - message.len(), true).await.ok()??;
        message.extend_from_slice(&chunk.bytes);
    }
    Some(message)
}

/// What is to be sent, in order. Once it is dropped, what is in it has [`LAST_WORDS`] to go.
struct Queue {
    messages: mpsc::Sender<Vec<u8>>,
    _held: oneshot::Sender<()>,
}

/// The other end of a [`Queue`].
struct Queued {
    messages: mpsc::Receiver<Vec<u8>>,
    dropped: oneshot::Receiver<()>,
}

fn queue(messages_max: usize) -> (Queue, Queued) {
    let (sender, receiver) = mpsc::channel(messages_max);
    let (held, dropped) = oneshot::channel();
    (Queue { messages: sender, _held: held }, Queued { messages: receiver, dropped })
}

/// Sends all that is queued until nobody can queue any more and it was received, or was not in time.
async fn write(mut stream: SendStream, queued: Queued) {
    let Queued { mut messages, dropped } = queued;
    let send = async {
        while let Some(message) = messages.recv().await {
            let length = (message.len() as u32).to_le_bytes();
            if stream.write_all(&length).await.is_err() || stream.write_all(&message).await.is_err() {
                return;
            }
        }
        if stream.finish().is_ok() {
            let _ = stream.stopped().await;
        }
    };
    let late = async {
        let _ = dropped.await;
        tokio::time::sleep(LAST_WORDS).await;
    };
    tokio::select! {
        () = send => {}
        () = late => {}
    }
}

/// Tells who hears, once there is room.
async fn tell(inbox: &Events<Queue>, mut event: Event) {
    while let Err(back) = inbox.offer(event) {
        event = back;
        tokio::time::sleep(FULL).await;
    }
}

/// Listens at an address that others reach.
pub struct Listener {
    inbox: Arc<Events<Queue>>,
    at: SocketAddr,
    peers: BTreeMap<Peer, Queue>,
    ends: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Listener {
    /// Listens at an address. The thread that calls this is the one that hears.
    ///
    /// # Errors
    /// If it is no address of this machine, or is taken.
    pub fn new(at: &str, key: &Key) -> Result<Self, String> {
        let wrong = |e: &dyn std::fmt::Display| format!("quic/{at}: {e}");
        let socket = UdpSocket::bind(resolved(at)?).map_err(|e| wrong(&e))?;
        let bound = socket.local_addr().map_err(|e| wrong(&e))?;
        let tls = QuicServerConfig::try_from(identity::of_walk(key)?).map_err(|e| wrong(&e))?;
        let mut config = ServerConfig::with_crypto(Arc::new(tls));
        config.transport_config(transport());
        let inbox = Arc::new(Events::new());
        let (ends, ended) = oneshot::channel();
        let shared = Arc::clone(&inbox);
        let thread = in_thread("quic", async move {
            let endpoint =
                Endpoint::new(EndpointConfig::default(), Some(config), socket, Arc::new(TokioRuntime));
            match endpoint {
                Ok(endpoint) => listen(endpoint, &shared, ended).await,
                Err(e) => tracing::warn!("quic: nobody is heard: {e}"),
            }
        })?;
        let at = reachable(bound);
        Ok(Self { inbox, at, peers: BTreeMap::new(), ends: Some(ends), thread: Some(thread) })
    }
}

/// Lets guests in until the listener ends.
async fn listen(endpoint: Endpoint, inbox: &Arc<Events<Queue>>, mut ended: oneshot::Receiver<()>) {
    let mut next: Peer = 0;
    let mut guests = JoinSet::new();
    loop {
        let incoming = tokio::select! {
            incoming = endpoint.accept() => incoming,
            _ = &mut ended => None,
            Some(_) = guests.join_next() => continue,
        };
        let Some(incoming) = incoming else { break };
        let peers = inbox.peers.load(Ordering::Relaxed);
        if peers >= PEERS_MAX {
            incoming.refuse();
        } else if peers >= PEERS_UNPROVED && !incoming.remote_address_validated() {
            let _ = incoming.retry();
        } else {
            inbox.peers.fetch_add(1, Ordering::Relaxed);
            let (inbox, peer) = (Arc::clone(inbox), next);
            next += 1;
            guests.spawn(async move {
                attend(incoming, peer, &inbox).await;
                inbox.peers.fetch_sub(1, Ordering::Relaxed);
            });
        }
    }
    // Who hears the last words goes by itself.
    let _ = timeout(LAST_WORDS, async { while guests.join_next().await.is_some() {} }).await;
    endpoint.close(VarInt::from_u32(0), b"");
    let _ = timeout(LAST_WORDS, endpoint.wait_idle()).await;
}

/// A guest, from its first packet to its last.
async fn attend(incoming: Incoming, peer: Peer, inbox: &Events<Queue>) {
    let greeted = async {
        let connection = incoming.await.ok()?;
        let (mut send, mut recv) = connection.accept_bi().await.ok()?;
        greet(&mut send, &mut recv).await?;
        Some((connection, send, recv))
    };
    let Ok(Some((connection, send, mut recv))) = timeout(GREETING, greeted).await else { return };
    let (queue, queued) = queue(UNREAD);
    inbox.opened.push((peer, queue));
    tell(inbox, Event::Opened(peer)).await;
    let hear = async {
        while let Some(message) = read(&mut recv).await {
            tell(inbox, Event::Message(peer, message)).await;
        }
    };
    // The end of either is the end of both: nobody who hears nothing is told more.
    tokio::select! {
        () = hear => {}
        () = write(send, queued) => {}
    }
    connection.close(VarInt::from_u32(0), b"");
    tell(inbox, Event::Closed(peer)).await;
}

/// What both sides say first: only who is let in says and hears it.
async fn greet(send: &mut SendStream, recv: &mut RecvStream) -> Option<()> {
    send.write_all(&MAGIC).await.ok()?;
    let mut magic = [0; 8];
    recv.read_exact(&mut magic).await.ok()?;
    (magic == MAGIC).then_some(())
}

impl HostLink for Listener {
    fn next(&mut self, wait: Duration) -> Option<Event> {
        self.inbox.next(wait, &mut self.peers)
    }

    fn send(&mut self, to: Peer, message: &[u8]) {
        let Some(queue) = self.peers.get(&to) else { return };
        if queue.messages.try_send(message.to_vec()).is_err() {
            self.peers.remove(&to);
        }
    }

    fn close(&mut self, peer: Peer) {
        self.peers.remove(&peer);
    }

    fn address(&self) -> String {
        format!("quic/{}", self.at)
    }

    fn waker(&self) -> Waker {
        self.inbox.waker()
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        self.inbox.close();
        while self.inbox.opened.pop().is_some() {}
        self.peers.clear();
        self.ends.take();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// A guest's connection.
pub struct Connection {
    queue: Option<Queue>,
    inbox: Arc<Messages>,
    thread: Option<JoinHandle<()>>,
}

impl Connection {
    /// Goes to an address. The thread that calls this is the one that hears.
    ///
    /// # Errors
    /// If nobody answers, or somebody without the key.
    pub fn new(at: &str, key: &Key) -> Result<Self, String> {
        let address = resolved(at)?;
        let tls =
            QuicClientConfig::try_from(identity::of_guest(key)?).map_err(|e| format!("quic/{at}: {e}"))?;
        let mut config = ClientConfig::new(Arc::new(tls));
        config.transport_config(transport());
        let inbox = Arc::new(Messages::new());
        let (queue, queued) = queue(AHEAD);
        let shared = Arc::clone(&inbox);
        let (tells, told) = oneshot::channel();
        let thread = in_thread("quic", async move {
            match timeout(GREETING, connected(address, config)).await.unwrap_or(Err(Greeting::Nobody)) {
                Ok((endpoint, connection, send, recv)) => {
                    let _ = tells.send(Ok(()));
                    visit(send, recv, queued, &shared).await;
                    connection.close(VarInt::from_u32(0), b"");
                    let _ = timeout(LAST_WORDS, endpoint.wait_idle()).await;
                }
                Err(e) => drop(tells.send(Err(e))),
            }
            shared.end();
        })?;
        match told.blocking_recv().unwrap_or(Err(Greeting::Nobody)) {
            Ok(()) => Ok(Self { queue: Some(queue), inbox, thread: Some(thread) }),
            Err(Greeting::Nobody) => Err(format!("quic/{at}: nobody answers")),
            Err(Greeting::Other) => Err(format!("quic/{at}: whoever is there has another key")),
        }
    }
}

/// Why no connection came about.
enum Greeting {
    Nobody,
    Other,
}

async fn connected(
    address: SocketAddr,
    config: ClientConfig,
) -> Result<(Endpoint, Quic, SendStream, RecvStream), Greeting> {
    let own: SocketAddr = match address {
        SocketAddr::V4(_) => (Ipv4Addr::UNSPECIFIED, 0).into(),
        SocketAddr::V6(_) => (Ipv6Addr::UNSPECIFIED, 0).into(),
    };
    let mut endpoint = Endpoint::client(own).map_err(|_| Greeting::Nobody)?;
    endpoint.set_default_client_config(config);
    // A name that TLS wants, and nobody looks at.
    let connecting = endpoint.connect(address, "foveal").map_err(|_| Greeting::Nobody)?;
    let refused = |e: quinn::ConnectionError| match e {
        quinn::ConnectionError::TransportError(_) | quinn::ConnectionError::ConnectionClosed(_) => {
            Greeting::Other
        }
        _ => Greeting::Nobody,
    };
    let connection = connecting.await.map_err(refused)?;
    let (mut send, mut recv) = connection.open_bi().await.map_err(refused)?;
    // Only now is it known whether the walk lets this side in.
    greet(&mut send, &mut recv).await.ok_or(Greeting::Other)?;
    Ok((endpoint, connection, send, recv))
}

/// A stay, until one of both sides ends it.
async fn visit(send: SendStream, mut recv: RecvStream, queued: Queued, inbox: &Messages) {
    let hear = async {
        while let Some(mut message) = read(&mut recv).await {
            while let Err(back) = inbox.offer(message) {
                message = back;
                tokio::time::sleep(FULL).await;
            }
            if inbox.has_ended() {
                // Who hears no more may still have something to say.
                std::future::pending::<()>().await;
            }
        }
    };
    tokio::select! {
        () = hear => {}
        () = write(send, queued) => {}
    }
}

impl GuestLink for Connection {
    fn next(&mut self, wait: Duration) -> Result<Option<Vec<u8>>, Gone> {
        self.inbox.next(wait)
    }

    fn send(&mut self, message: &[u8]) -> Result<(), Gone> {
        let queue = self.queue.as_ref().ok_or(Gone)?;
        queue.messages.blocking_send(message.to_vec()).map_err(|_| Gone)
    }

    fn waker(&self) -> Waker {
        self.inbox.waker()
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.inbox.end();
        self.queue.take();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn heard(listener: &mut Listener) -> Event {
        (0..500).find_map(|_| listener.next(Duration::from_millis(10))).expect("something is heard")
    }

    fn told(guest: &mut Connection) -> Option<Vec<u8>> {
        (0..500).find_map(|_| guest.next(Duration::from_millis(10)).transpose()).and_then(Result::ok)
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
        assert_eq!(told(&mut guest).as_deref(), Some(&b"welcome"[..]));
        guest.send(b"last words").unwrap();
        drop(guest);
        assert_eq!(heard(&mut listener), Event::Message(0, b"last words".to_vec()));
        assert_eq!(heard(&mut listener), Event::Closed(0));
        let mut guest = Connection::new(&at, &key).unwrap();
        assert_eq!(heard(&mut listener), Event::Opened(1));
        listener.send(1, b"farewell");
        drop(listener);
        assert_eq!(told(&mut guest).as_deref(), Some(&b"farewell"[..]));
        assert!((0..500).any(|_| guest.next(Duration::from_millis(10)).is_err()));
    }

    /// A message that arrives while a guest goes does not cut off what it said before.
    #[test]
    fn who_hears_no_more_is_heard_to_the_end() {
        let key = Key::new().unwrap();
        let mut listener = Listener::new("127.0.0.1:0", &key).unwrap();
        let mut guest = Connection::new(&listener.at.to_string(), &key).unwrap();
        assert_eq!(heard(&mut listener), Event::Opened(0));
        guest.inbox.end();
        listener.send(0, b"too late");
        thread::sleep(Duration::from_millis(100));
        guest.send(b"last words").unwrap();
        drop(guest);
        assert_eq!(heard(&mut listener), Event::Message(0, b"last words".to_vec()));
        assert_eq!(heard(&mut listener), Event::Closed(0));
    }

    #[test]
    fn who_has_another_key_hears_and_says_nothing() {
        let (key, other) = (Key::new().unwrap(), Key::new().unwrap());
        let mut listener = Listener::new("127.0.0.1:0", &key).unwrap();
        let at = listener.at.to_string();
        let refused = Connection::new(&at, &other).err().expect("refused");
        assert!(refused.contains("another key"), "{refused}");
        assert_eq!(listener.next(Duration::from_millis(50)), None);
        // A walk is no guest: who has the walk's own signing key alone is not let in.
        assert_ne!(key.seed("walk"), key.seed("guest"));
        assert!(Connection::new(&at, &key).is_ok(), "who has the key comes after all");
    }

    #[test]
    fn nobody_answers_where_nobody_listens() {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let at = socket.local_addr().unwrap().to_string();
        let refused = Connection::new(&at, &Key::new().unwrap()).err().expect("nobody");
        assert!(refused.contains("nobody answers"), "{refused}");
        assert!(Listener::new(&at, &Key::new().unwrap()).is_err(), "taken");
        assert!(Listener::new("nowhere", &Key::new().unwrap()).is_err());
    }

    #[test]
    fn a_guest_that_reads_nothing_is_closed_and_another_is_served() {
        let key = Key::new().unwrap();
        let mut listener = Listener::new("127.0.0.1:0", &key).unwrap();
        let at = listener.at.to_string();
        let [deaf, mut guest] = [(); 2].map(|()| Connection::new(&at, &key).unwrap());
        let opened = [heard(&mut listener), heard(&mut listener)];
        assert_eq!(opened, [Event::Opened(0), Event::Opened(1)]);
        let message = vec![7; 64 << 10];
        for _ in 0..2 * UNREAD {
            listener.send(0, &message);
        }
        assert!(!listener.peers.contains_key(&0), "what nobody reads has an end");
        listener.send(1, b"still here");
        assert_eq!(told(&mut guest).as_deref(), Some(&b"still here"[..]));
        assert_eq!(heard(&mut listener), Event::Closed(0));
        drop(deaf);
    }

    #[test]
    fn an_address_that_others_reach_is_told() {
        let listener = Listener::new("0.0.0.0:0", &Key::new().unwrap()).unwrap();
        assert!(!listener.at.ip().is_unspecified() && listener.at.port() != 0);
        assert_eq!(reachable("127.0.0.1:5".parse().unwrap()).to_string(), "127.0.0.1:5");
    }

    /// A network between two addresses that is late by some milliseconds, loses one packet in `loses`, sends one in 13
    /// twice and one in 17 late. Ends with the process.
    fn relay(to: SocketAddr, loses: u64) -> SocketAddr {
        let [near, far] = [(); 2].map(|()| UdpSocket::bind("127.0.0.1:0").unwrap());
        let at = near.local_addr().unwrap();
        for socket in [&near, &far] {
            socket.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
        }
        thread::spawn(move || {
            let mut guest = None;
            let mut under_way: Vec<(std::time::Instant, bool, Vec<u8>)> = Vec::new();
            let (mut buffer, mut count) = ([0; 65536], 0u64);
            loop {
                for (socket, outwards) in [(&near, true), (&far, false)] {
                    let Ok((length, from)) = socket.recv_from(&mut buffer) else { continue };
                    if outwards {
                        guest = Some(from);
                    }
                    count += 1;
                    let drawn = foveal::rng::hash(count, 0, 0);
                    if drawn.is_multiple_of(loses) {
                        continue;
                    }
                    let late = Duration::from_millis(if drawn.is_multiple_of(17) { 25 } else { 5 });
                    let copies = if drawn.is_multiple_of(13) { 2 } else { 1 };
                    for _ in 0..copies {
                        let due = std::time::Instant::now() + late;
                        under_way.push((due, outwards, buffer[..length].to_vec()));
                    }
                }
                let now = std::time::Instant::now();
                under_way.retain(|(due, outwards, packet)| {
                    if *due > now {
                        return true;
                    }
                    let _ = match (outwards, guest) {
                        (true, _) => far.send_to(packet, to),
                        (false, Some(guest)) => near.send_to(packet, guest),
                        (false, None) => Ok(0),
                    };
                    false
                });
            }
        });
        at
    }

    /// In order, whole and once, whatever the network does.
    #[test]
    fn a_network_that_loses_doubles_and_reorders_changes_nothing() {
        let key = Key::new().unwrap();
        let mut listener = Listener::new("127.0.0.1:0", &key).unwrap();
        let at = relay(listener.at, 20);
        let mut guest = Connection::new(&at.to_string(), &key).unwrap();
        assert_eq!(heard(&mut listener), Event::Opened(0));
        let message = |i: usize| vec![i as u8; 1 + i * 37 % 5000];
        for i in 0..100 {
            guest.send(&message(i)).unwrap();
            listener.send(0, &message(i + 100));
        }
        for i in 0..100 {
            assert_eq!(heard(&mut listener), Event::Message(0, message(i)));
            assert_eq!(told(&mut guest), Some(message(i + 100)));
        }
    }
}
