//! Sockets and threads around the [hub](crate::hub): what comes from them are its events, and its effects go to them.
//!
//! One thread serves all connections, walks have threads of their own, and pictures are coded beside. A connection's task
//! holds a short queue of what is to be sent; who does not read it is left behind, and then left.

mod connection;
mod listen;
mod still;
mod tls;

use std::collections::{BTreeMap, VecDeque};
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::time::{Duration, Instant};

use foveal_engine::change::Begun;
use foveal_engine::thread::{Command, EngineHandle, EngineThread, Opening};
use foveal_engine::walk::Act;
use foveal_engine::{Failure, screenshot};
use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::{Notify, mpsc};
use tokio::time::MissedTickBehavior;

use self::connection::Out;
use self::still::Asked;
pub use self::tls::Tls;
use crate::coding::{Coding, encode};
use crate::gate::{Gate, Hosts, Token};
use crate::hub::{Effect, Event, Hub, Limits, Order};
use crate::protocol::Described;
use crate::viewer::{RoomId, ViewerId};

/// How often time passes for the hub.
const TICK: Duration = Duration::from_millis(50);
/// How long connections have to hear of the end.
const FAREWELL: Duration = Duration::from_millis(200);
/// Pixels that are coded as JPEG within two milliseconds.
const SOON: usize = 512 * 512;
/// Events that may wait for the hub; connections wait with more.
const EVENTS: usize = 1024;

/// What the names of threads beside the one that serves begin with.
pub const THREADS: &str = "serve";

/// Makes a walk on the thread that it will live on; they are counted from 1.
pub type Make = Arc<dyn Fn(u32) -> Result<Begun, Failure> + Send + Sync>;

/// How a server is opened.
#[derive(Clone, Debug)]
pub struct Options {
    /// Where it listens; with port 0 anywhere.
    pub listen: SocketAddr,
    /// Names it is known by beside its address.
    pub hosts: Vec<String>,
    /// A proxy stands before it and says whom it speaks for.
    pub behind_proxy: bool,
    /// Who has this may drive.
    pub token: Token,
    /// Who has this may look.
    pub watch_token: Option<Token>,
    /// How many, and how much.
    pub limits: Limits,
    /// Whether walks are recorded.
    pub recorded: bool,
    /// By what connections are encrypted.
    pub tls: Option<Tls>,
}

/// A server that listens.
pub struct Server {
    options: Options,
    listener: TcpListener,
    address: SocketAddr,
}

impl Server {
    /// Listens. Who connects waits until it [runs](Self::run).
    ///
    /// # Errors
    /// If it cannot listen there.
    pub fn bind(options: Options) -> Result<Self, Failure> {
        let failed =
            |e: std::io::Error| Failure::Environment(format!("cannot listen at {}: {e}", options.listen));
        let listener = TcpListener::bind(options.listen).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        Ok(Self { options, listener, address })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Serves walks until `stop` holds, or the walk that all share is over. `ready`: it does so from now on.
    ///
    /// # Errors
    /// If a walk cannot be made, or ends by itself.
    pub fn run(self, make: Make, stop: impl Fn() -> bool, ready: impl FnOnce()) -> Result<(), Failure> {
        let runtime = tokio::runtime::Builder::new_current_thread().thread_name(THREADS).enable_all().build();
        let runtime =
            runtime.map_err(|e| Failure::Environment(format!("the server cannot be started: {e}")))?;
        runtime.block_on(self.serve(make, stop, ready))
    }

    async fn serve(self, make: Make, stop: impl Fn() -> bool, ready: impl FnOnce()) -> Result<(), Failure> {
        let Self { options, listener, address } = self;
        let gate = Gate::new(options.token.clone(), options.watch_token.clone());
        let (sender, mut messages) = mpsc::channel(EVENTS);
        let is_shared = options.limits.walks.is_none();
        let mut glue = Glue {
            is_shared,
            hub: Hub::new(options.limits, gate),
            recorded: options.recorded,
            outs: BTreeMap::new(),
            walks: BTreeMap::new(),
            opened: 0,
            make,
            wake: Arc::new(Notify::new()),
            sender: sender.clone(),
            start: Instant::now(),
            failure: None,
        };
        if is_shared {
            glue.share()?;
        }
        let listener = tokio::net::TcpListener::from_std(listener)
            .map_err(|e| Failure::Environment(format!("cannot listen: {e}")))?;
        let hosts = Hosts::new(address, &options.hosts);
        tokio::spawn(listen::listen(
            listener,
            listen::Door::new(hosts, options.behind_proxy, options.tls, sender),
        ));
        ready();
        let mut tick = tokio::time::interval(TICK);
        tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let wake = Arc::clone(&glue.wake);
        while !(stop() || is_shared && glue.walks.is_empty()) {
            tokio::select! {
                message = messages.recv() => match message {
                    Some(message) => glue.hear(message),
                    None => break,
                },
                () = wake.notified() => glue.look(),
                _ = tick.tick() => glue.on_tick(),
            }
        }
        glue.end().await
    }
}

/// What other tasks and threads say to the one that serves.
enum Message {
    /// Somebody connected, and this is where what they are to hear goes.
    Connected(ViewerId, std::net::IpAddr, mpsc::Sender<Out>),
    /// Something else happened.
    Event(Event),
    /// Somebody wants one picture.
    Still(Asked),
    /// A walk stands, or does not.
    Opened(RoomId, Result<EngineThread, Failure>),
}

/// A walk and how it is talked to.
struct Walk {
    thread: EngineThread,
    handle: EngineHandle,
    /// Its time less the server's, seconds.
    ahead: f64,
    /// It took no more: keys may be held whose release nobody heard.
    deaf: bool,
}

impl Walk {
    /// Says something whose times are the server's.
    fn tell(&mut self, command: Command) {
        let command = match command {
            Command::Act { act, at, mark } => Command::Act { act, at: at + self.ahead, mark },
            command => command,
        };
        self.deaf |= self.handle.send(command).is_err();
    }

    fn tick(&mut self) {
        if self.deaf {
            let release = Command::Act { act: Act::ReleaseAll, at: self.handle.now(), mark: 0.0 };
            self.deaf = self.handle.send(release).is_err();
        }
    }
}

/// Whether coding a picture takes no longer than having it done beside: while a walk has all cores, each thread that is to
/// be woken waits for milliseconds.
fn is_soon_coded(order: &Order) -> bool {
    order.coding != Coding::Lossless && order.shown.picture.data().len() <= SOON
}

/// The hub with its hands.
struct Glue {
    hub: Hub,
    recorded: bool,
    is_shared: bool,
    outs: BTreeMap<ViewerId, mpsc::Sender<Out>>,
    walks: BTreeMap<RoomId, Walk>,
    /// Walks that were begun.
    opened: u32,
    make: Make,
    wake: Arc<Notify>,
    sender: mpsc::Sender<Message>,
    start: Instant,
    failure: Option<Failure>,
}

impl Glue {
    fn now(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }

    /// What makes the next walk, wherever that is to be.
    fn maker(&mut self) -> impl FnOnce() -> Result<EngineThread, Failure> + Send + use<> {
        self.opened += 1;
        let (make, number, wake) = (Arc::clone(&self.make), self.opened, Arc::clone(&self.wake));
        move || EngineThread::spawn(move || make(number), move || wake.notify_one())
    }

    fn described(&self, opening: &Opening) -> Described {
        Described::new(opening, self.recorded)
    }

    fn keep(&mut self, room: RoomId, thread: EngineThread) {
        let handle = thread.handle().clone();
        let ahead = handle.now() - self.now();
        self.walks.insert(room, Walk { thread, handle, ahead, deaf: false });
        // It may have shown something before anybody listened.
        self.wake.notify_one();
    }

    /// One walk for all, from the start.
    fn share(&mut self) -> Result<(), Failure> {
        let thread = self.maker()()?;
        let room = self.hub.open(self.described(thread.opening()), self.now());
        self.keep(room, thread);
        Ok(())
    }

    fn hear(&mut self, message: Message) {
        match message {
            Message::Connected(id, address, out) => {
                self.outs.insert(id, out);
                self.on(Event::Connected(id, address));
            }
            Message::Event(event) => {
                if let Event::Gone(id) = event {
                    self.outs.remove(&id);
                }
                self.on(event);
            }
            Message::Still(Asked { address, token, answer }) => {
                // Whoever asked may have left.
                let _ = answer.send(self.hub.still(address, &token, self.now()));
            }
            Message::Opened(room, Ok(thread)) if !self.hub.has(room) => {
                tokio::task::spawn_blocking(move || thread.end());
                tracing::debug!("nobody waited for walk {room}");
            }
            Message::Opened(room, Ok(thread)) => {
                let described = self.described(thread.opening());
                self.keep(room, thread);
                self.on(Event::Opened(room, Ok(described)));
            }
            Message::Opened(room, Err(failure)) => {
                tracing::warn!("a walk cannot begin: {failure}");
                self.on(Event::Opened(room, Err(failure.to_string())));
            }
        }
    }

    /// Takes what is new of all walks.
    fn look(&mut self) {
        let mut events = Vec::new();
        for (room, walk) in &self.walks {
            let anew = walk.handle.opening().map(|o| Event::Described(*room, self.described(&o)));
            events.extend(anew);
            events.extend(walk.handle.shown().map(|shown| Event::Shown(*room, shown)));
            events.extend(std::iter::from_fn(|| walk.handle.notice()).map(|n| Event::Said(*room, n)));
            while let Some(shot) = walk.handle.shot() {
                let sender = self.sender.clone();
                tokio::task::spawn_blocking(move || {
                    if let Ok(bytes) = screenshot::png(&shot.picture, &shot.facts) {
                        let _ = sender.blocking_send(Message::Event(Event::File(shot.tag, bytes)));
                    }
                });
            }
            if walk.handle.is_over() {
                events.push(Event::Over(*room));
            }
        }
        events.into_iter().for_each(|event| self.on(event));
    }

    fn on_tick(&mut self) {
        self.walks.values_mut().for_each(Walk::tick);
        self.on(Event::Tick);
    }

    fn on(&mut self, event: Event) {
        let mut effects = VecDeque::from(self.hub.on(event, self.now()));
        while let Some(effect) = effects.pop_front() {
            if let Some(event) = self.take_effect(effect) {
                let now = self.now();
                effects.extend(self.hub.on(event, now));
            }
        }
    }

    /// Does what is to be done. What that leads to.
    fn take_effect(&mut self, effect: Effect) -> Option<Event> {
        match effect {
            Effect::Text(id, text, brief) => return self.send(id, Out::Text(text), brief),
            Effect::Binary(id, bytes) => return self.send(id, Out::Binary(bytes), false),
            Effect::Close(id, why) => {
                // Whoever has no room for a last word ends without.
                let out = self.outs.remove(&id)?;
                let _ = out.try_send(Out::Close(why.code()));
            }
            Effect::Tell(room, command) => self.walks.get_mut(&room)?.tell(command),
            Effect::Code(order) if is_soon_coded(&order) => {
                let before = order.before.as_ref().map(|before| &*before.picture);
                let coded = encode(&order.shown.picture, before, order.coding);
                return Some(Event::Coded(order, coded));
            }
            Effect::Code(order) => {
                let sender = self.sender.clone();
                tokio::task::spawn_blocking(move || {
                    let before = order.before.as_ref().map(|before| &*before.picture);
                    let coded = encode(&order.shown.picture, before, order.coding);
                    let _ = sender.blocking_send(Message::Event(Event::Coded(order, coded)));
                });
            }
            Effect::Open(room) => {
                let (make, sender) = (self.maker(), self.sender.clone());
                tokio::task::spawn_blocking(move || {
                    let _ = sender.blocking_send(Message::Opened(room, make()));
                });
            }
            Effect::End(room) => {
                let walk = self.walks.remove(&room)?;
                let is_over = walk.handle.is_over();
                if self.is_shared && is_over {
                    // The only one: whoever waits for the server wants to know why.
                    self.failure = walk.thread.end().err().map(|why| Failure::ended(&why));
                } else {
                    tokio::task::spawn_blocking(move || walk.thread.end());
                }
            }
        }
        None
    }

    /// Hands something to a connection; where that has no room it ends, unless it can do without.
    fn send(&mut self, id: ViewerId, out: Out, brief: bool) -> Option<Event> {
        match self.outs.get(&id)?.try_send(out) {
            Ok(()) => None,
            Err(TrySendError::Full(_)) if brief => None,
            Err(_) => {
                self.outs.remove(&id);
                Some(Event::Gone(id))
            }
        }
    }

    /// Says good-bye and ends all walks, whose recordings end with them.
    async fn end(mut self) -> Result<(), Failure> {
        for effect in self.hub.shut() {
            self.take_effect(effect);
        }
        if !self.outs.is_empty() || self.failure.is_some() {
            tokio::time::sleep(FAREWELL).await;
        }
        let mut failure = self.failure.take();
        for (_, walk) in std::mem::take(&mut self.walks) {
            if let Err(why) = walk.thread.end() {
                failure = failure.or(Some(Failure::ended(&why)));
            }
        }
        failure.map_or(Ok(()), Err)
    }
}
