//! The walk's side of the door: a thread between a link and the stations.
//!
//! The [`Hall`] is a state machine: events in, effects out. It knows who may come, what was sent to whom, and which station
//! a guest has; what jobs a guest gets, and what becomes of them, the stations decide.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use crossbeam_queue::ArrayQueue;
use foveal_actors::station::wire::{
    Body, DoneJob, FromGuest, Hash, JOBS_MAX, PIECE_BYTES_MAX, PROTOCOL, Refusal, ToGuest,
};
use foveal_actors::station::{
    CREDITS_MAX, Found, Heard, Outlet, Outlets, STATIONS_MAX, StationMessage, bits,
};
use foveal_engine::failure::Failure;
use foveal_runtime::Port;

use crate::key::{Invitation, Key};
use crate::link::{self, Event, HostLink, Peer, Waker};
use crate::package::Package;
use crate::program;

/// Messages that a station may be ahead of the door.
const AHEAD: usize = 8 * CREDITS_MAX as usize;
/// Pieces of blobs that one guest is sent before others are heard.
const LOOK: Duration = Duration::from_millis(50);

/// Blobs beside the package that may be wanted.
const OFFERS: usize = 4;

/// Something that the hall wants done.
#[derive(Debug)]
pub enum Effect {
    /// Say this to a guest.
    Send(Peer, ToGuest),
    /// End its connection.
    Close(Peer),
    /// Tell this station.
    Tell(usize, Heard),
    /// The guest of this place, in this stay of its, has what these pieces of work are of.
    Grounded(usize, u64, u32),
    /// It has answered one.
    Worked(usize, u64, Worked),
}

/// The answer to a piece of work.
#[derive(Debug)]
pub struct Worked {
    /// Which.
    pub lease: u64,
    /// Time of one core, µs, as the guest says.
    pub micros: u32,
    /// Pieces that it has and nobody there has begun, as it says.
    pub waiting: u32,
    /// What was found; nothing where it could not be done.
    pub found: Vec<u8>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// It has not said who it is.
    Silent,
    /// It gets what it needs, in a place that is kept for it.
    Stocking(usize),
    /// It traces.
    Serving(usize),
}

/// Somebody at the door.
struct Guest {
    stage: Stage,
    incarnation: u64,
    cores: u16,
    name: String,
    has_other_bits: bool,
}

/// What a walk grants who comes, and keeps of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Letting {
    /// Machines whose numbers have other bits may come. What they find is recorded, and is near to what this machine would
    /// find.
    pub any_bits: bool,
    /// What is found is recorded, whoever found it, so that a replay need not trace it.
    pub payloads: bool,
}

/// Who comes, and who has which station.
pub struct Hall {
    package: Arc<Package>,
    k_max: u32,
    places: Vec<Option<Peer>>,
    guests: BTreeMap<Peer, Guest>,
    incarnations: u64,
    bits: u64,
    letting: Letting,
    /// What guests may want beside the package, where it is work in pieces that they come for.
    offers: Option<Vec<(Hash, Arc<Vec<u8>>)>>,
    /// Numbers that no guest can know before.
    salt: fn() -> u64,
}

/// A number of the system's.
pub(crate) fn random() -> u64 {
    let mut bytes = [0; 8];
    // Without any, checks are those that a guest could foresee: what it sends is checked all the same.
    let _ = getrandom::fill(&mut bytes);
    u64::from_le_bytes(bytes)
}

impl Hall {
    /// For a walk with so many stations.
    pub fn new(package: Arc<Package>, k_max: u32, stations: u32) -> Self {
        let places = vec![None; stations.min(STATIONS_MAX) as usize];
        Self {
            package,
            k_max,
            places,
            guests: BTreeMap::new(),
            incarnations: 0,
            bits: bits::probe(),
            letting: Letting::default(),
            offers: None,
            salt: random,
        }
    }

    /// The same, which grants more.
    pub fn letting(self, letting: Letting) -> Self {
        Self { letting, ..self }
    }

    /// For work in pieces, of so many guests.
    pub fn of_work(package: Arc<Package>, guests: u32) -> Self {
        Self { offers: Some(Vec::new()), ..Self::new(package, 0, guests) }
    }

    /// Guests may want this blob from now on. Who still fetches one of those before fetches it to its end.
    pub fn offer(&mut self, hash: Hash, bytes: Arc<Vec<u8>>) {
        let offers = self.offers.get_or_insert_default();
        if offers.iter().all(|(known, _)| *known != hash) {
            offers.push((hash, bytes));
            let old = offers.len().saturating_sub(OFFERS);
            offers.drain(..old);
        }
    }

    /// Tells everybody that it is over.
    pub(crate) fn farewell(&self, link: &mut dyn HostLink) {
        for peer in self.guests.keys() {
            link.send(*peer, &ToGuest::Farewell.to_bytes());
        }
    }

    /// Guests that trace.
    pub fn serving(&self) -> u32 {
        self.guests.values().filter(|guest| matches!(guest.stage, Stage::Serving(_))).count() as u32
    }

    /// Something came over the link.
    pub fn heard(&mut self, event: Event, effects: &mut Vec<Effect>) {
        match event {
            Event::Opened(peer) => {
                let (incarnation, name) = (self.incarnations, String::new());
                self.incarnations += 1;
                let guest =
                    Guest { stage: Stage::Silent, incarnation, cores: 1, name, has_other_bits: false };
                self.guests.insert(peer, guest);
            }
            Event::Closed(peer) => self.leave(peer, false, effects),
            Event::Message(peer, bytes) => match FromGuest::of_bytes(&bytes) {
                Some(message) => self.said(peer, message, effects),
                None => self.ban(peer, effects),
            },
        }
    }

    /// A station has something for its guest of this incarnation. Another one may have taken the place since: that is not
    /// for it.
    pub fn passes(&mut self, station: usize, incarnation: u64, message: ToGuest, effects: &mut Vec<Effect>) {
        let Some(peer) = self.places.get(station).copied().flatten() else { return };
        if self.guests.get(&peer).is_none_or(|guest| guest.incarnation != incarnation) {
            return;
        }
        if matches!(message, ToGuest::Refused(Refusal::Banned)) {
            // The station has seen to its jobs already.
            return self.ban(peer, effects);
        }
        effects.push(Effect::Send(peer, message));
    }

    fn said(&mut self, peer: Peer, message: FromGuest, effects: &mut Vec<Effect>) {
        let Some(guest) = self.guests.get_mut(&peer) else { return };
        match (message, guest.stage) {
            (FromGuest::Hello { protocol, program: theirs, bits, cores, name, memory }, Stage::Silent) => {
                let wanted = program();
                let refusal = if protocol != PROTOCOL || theirs != wanted {
                    Some(Refusal::Version { wanted })
                } else if bits != self.bits && !self.letting.any_bits {
                    Some(Refusal::OtherBits { wanted: self.bits })
                } else {
                    let bytes = self.package.bytes();
                    memory.filter(|memory| *memory < bytes).map(|_| Refusal::TooSmall { bytes })
                };
                let place = self.places.iter().position(Option::is_none);
                let (refusal, place) = match (refusal, place) {
                    (None, Some(place)) => (None, place),
                    (refusal, _) => (Some(refusal.unwrap_or(Refusal::Full)), 0),
                };
                if let Some(refusal) = refusal {
                    effects.push(Effect::Send(peer, ToGuest::Refused(refusal)));
                    effects.push(Effect::Close(peer));
                    self.guests.remove(&peer);
                    return;
                }
                (guest.cores, guest.name, guest.stage) = (cores, name, Stage::Stocking(place));
                guest.has_other_bits = bits != self.bits;
                if guest.has_other_bits {
                    tracing::warn!(
                        "{}: its numbers have other bits: what it traces is near to what this machine would, not the same",
                        guest.name
                    );
                }
                self.places[place] = Some(peer);
                let (package, bytes) = self.package.manifest();
                let (incarnation, k_max) = (guest.incarnation, self.k_max);
                effects.push(Effect::Send(peer, ToGuest::Welcome { incarnation, package, bytes, k_max }));
            }
            (FromGuest::Want { hash, at }, Stage::Stocking(_)) => match self.package.piece(&hash, at) {
                Some(bytes) => effects.push(Effect::Send(peer, ToGuest::Piece { hash, at, bytes })),
                None => self.ban(peer, effects),
            },
            (FromGuest::Ready { incarnation }, Stage::Stocking(place))
                if incarnation == guest.incarnation =>
            {
                guest.stage = Stage::Serving(place);
                let (cores, name) = (guest.cores, guest.name.clone());
                let joined = if guest.has_other_bits {
                    Heard::OtherJoined { incarnation, cores, name }
                } else {
                    Heard::Joined { incarnation, cores, name }
                };
                effects.push(Effect::Tell(place, joined));
            }
            (FromGuest::Done { incarnation, jobs }, Stage::Serving(place)) if self.offers.is_none() => {
                if jobs.iter().any(|job| job.found.as_ref().is_some_and(|found| !found.is_sound())) {
                    return self.ban(peer, effects);
                }
                let (salt, jobs) = ((self.salt)(), jobs.into_iter().map(found));
                let heard = if self.letting.payloads || guest.has_other_bits {
                    Heard::Told { incarnation, salt, jobs: jobs.collect() }
                } else {
                    let whole =
                        |(found, body): (Found, Option<Body>)| Found { body: body.map(Arc::new), ..found };
                    Heard::Done { incarnation, salt, jobs: jobs.map(whole).collect() }
                };
                effects.push(Effect::Tell(place, heard));
            }
            (FromGuest::Leaving, _) => {
                effects.push(Effect::Close(peer));
                self.leave(peer, false, effects);
            }
            // It may have wanted more than it needs before it said that it is ready.
            (FromGuest::Want { hash, at }, Stage::Serving(_)) => {
                let offered = self.offers.iter().flatten().find(|(known, _)| *known == hash);
                let piece = offered.and_then(|(_, bytes)| bytes.get(at as usize..));
                if let Some(bytes) = piece {
                    let bytes = bytes[..bytes.len().min(PIECE_BYTES_MAX)].to_vec();
                    effects.push(Effect::Send(peer, ToGuest::Piece { hash, at, bytes }));
                }
            }
            (FromGuest::Grounded { incarnation, number }, Stage::Serving(place))
                if incarnation == guest.incarnation && self.offers.is_some() =>
            {
                effects.push(Effect::Grounded(place, incarnation, number));
            }
            (FromGuest::Worked { incarnation, lease, micros, waiting, found }, Stage::Serving(place))
                if incarnation == guest.incarnation && self.offers.is_some() =>
            {
                let worked = Worked { lease, micros, waiting, found };
                effects.push(Effect::Worked(place, incarnation, worked));
            }
            _ => self.ban(peer, effects),
        }
    }

    fn ban(&mut self, peer: Peer, effects: &mut Vec<Effect>) {
        effects.push(Effect::Send(peer, ToGuest::Refused(Refusal::Banned)));
        effects.push(Effect::Close(peer));
        self.leave(peer, true, effects);
    }

    fn leave(&mut self, peer: Peer, banned: bool, effects: &mut Vec<Effect>) {
        let Some(guest) = self.guests.remove(&peer) else { return };
        if let Stage::Stocking(place) | Stage::Serving(place) = guest.stage {
            self.places[place] = None;
        }
        if let Stage::Serving(place) = guest.stage {
            effects.push(Effect::Tell(place, Heard::Left { incarnation: guest.incarnation, banned }));
        }
    }
}

/// An answer as the station hears it.
fn found(job: DoneJob) -> (Found, Option<Body>) {
    let DoneJob { lease, micros, found } = job;
    let (hash, count) = (found.as_ref().map_or(0, Body::digest), found.as_ref().map(Body::samples));
    (Found { lease, micros, count, hash, body: None }, found)
}

/// What door, stations and walk share.
struct DoorShared {
    /// By station, with the incarnation of the guest.
    outlets: Vec<ArrayQueue<(u64, ToGuest)>>,
    /// What leads to the stations, on its way to the door.
    inputs: ArrayQueue<Vec<Port<Heard, StationMessage>>>,
    closing: AtomicBool,
    serving: AtomicU32,
}

/// An outlet that leads to the door.
struct ToDoor {
    station: usize,
    shared: Arc<DoorShared>,
    waker: Waker,
}

impl Outlet for ToDoor {
    fn send(&mut self, incarnation: u64, message: ToGuest) {
        // What finds no room is overdue some time.
        if self.shared.outlets[self.station].push((incarnation, message)).is_ok() {
            self.waker.wake();
        }
    }
}

/// Who answers at a link, until it ends with a value.
pub(crate) type Serving<T> = JoinHandle<Option<T>>;

/// Makes a link on a thread of its own, which serves who comes over it. Tells the link's address, and who wakes it.
pub(crate) fn serving<T: Send + 'static>(
    link: impl FnOnce() -> Result<Box<dyn HostLink>, String> + Send + 'static,
    serve: impl FnOnce(Box<dyn HostLink>) -> T + Send + 'static,
) -> Result<(String, Waker, Serving<T>), Failure> {
    let opened = Arc::new(ArrayQueue::new(1));
    let (tells, asker) = (Arc::clone(&opened), thread::current());
    let run = move || {
        // The link's messages come to the thread that made it.
        let (link, told) = match link() {
            Ok(link) => {
                let told = Ok((link.address(), link.waker()));
                (Some(link), told)
            }
            Err(e) => (None, Err(e)),
        };
        let _ = tells.push(told);
        asker.unpark();
        link.map(serve)
    };
    let thread = thread::Builder::new().name("door".into()).spawn(run);
    let thread = thread.map_err(|e| Failure::Environment(format!("no thread for the door: {e}")))?;
    loop {
        match opened.pop() {
            Some(told) => {
                let (address, waker) = told.map_err(Failure::Environment)?;
                return Ok((address, waker, thread));
            }
            None => thread::park_timeout(Duration::from_millis(10)),
        }
    }
}

/// A door that is open.
pub struct Door {
    shared: Arc<DoorShared>,
    waker: Waker,
    invitation: Invitation,
    thread: Option<Serving<()>>,
}

impl Door {
    /// Opens it at an address, for a walk of a scene that is open.
    ///
    /// # Errors
    /// If nobody can listen there.
    pub fn open(
        address: &str,
        key: Key,
        package: Package,
        k_max: u32,
        stations: u32,
        letting: Letting,
    ) -> Result<Self, Failure> {
        let stations = stations.min(STATIONS_MAX);
        let shared = Arc::new(DoorShared {
            outlets: (0..stations).map(|_| ArrayQueue::new(AHEAD)).collect(),
            inputs: ArrayQueue::new(1),
            closing: AtomicBool::new(false),
            serving: AtomicU32::new(0),
        });
        let hall = Hall::new(Arc::new(package), k_max, stations).letting(letting);
        let inside = Arc::clone(&shared);
        let (at, own_key) = (address.to_owned(), key.clone());
        let link = move || link::listen(&at, &own_key);
        let (address, waker, thread) = serving(link, move |link| serve(link, hall, &inside))?;
        let invitation = Invitation { address, key };
        Ok(Self { shared, waker, invitation, thread: Some(thread) })
    }

    /// What guests need to come.
    pub fn invitation(&self) -> &Invitation {
        &self.invitation
    }

    /// Guests that trace.
    pub fn serving(&self) -> u32 {
        self.shared.serving.load(Ordering::Relaxed)
    }

    /// What leads from the stations to the door, for [`foveal_engine::Options::outlets`].
    pub fn outlets(&self) -> Outlets {
        let (shared, waker) = (Arc::clone(&self.shared), self.waker.clone());
        Arc::new(move || {
            let to_door = |station| {
                let (shared, waker) = (Arc::clone(&shared), waker.clone());
                Box::new(ToDoor { station, shared, waker }) as Box<dyn Outlet>
            };
            (0..shared.outlets.len()).map(to_door).collect()
        })
    }

    /// Has what guests say lead to these stations from now on; nobody is let in before.
    pub fn attach(&self, inputs: Vec<Port<Heard, StationMessage>>) {
        self.attacher()(inputs);
    }

    /// The same, for whoever has no door.
    pub fn attacher(&self) -> impl FnOnce(Vec<Port<Heard, StationMessage>>) + 'static {
        let (shared, waker) = (Arc::clone(&self.shared), self.waker.clone());
        move |inputs| {
            let _ = shared.inputs.push(inputs);
            waker.wake();
        }
    }
}

impl Drop for Door {
    fn drop(&mut self) {
        self.shared.closing.store(true, Ordering::SeqCst);
        self.waker.wake();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// What a station could not be told yet, in order.
type Waiting = VecDeque<Heard>;

fn serve(mut link: Box<dyn HostLink>, mut hall: Hall, shared: &DoorShared) {
    let mut effects = Vec::new();
    let mut inputs: Vec<Port<Heard, StationMessage>> = Vec::new();
    let mut waiting: Vec<Waiting> = shared.outlets.iter().map(|_| Waiting::new()).collect();
    while !shared.closing.load(Ordering::SeqCst) {
        if inputs.is_empty() {
            match shared.inputs.pop() {
                Some(given) => inputs = given,
                None => {
                    thread::park_timeout(LOOK);
                    continue;
                }
            }
        }
        let blocked = waiting.iter().any(|waiting| !waiting.is_empty());
        let event = link.next(if blocked { Duration::from_millis(1) } else { LOOK });
        if let Some(event) = event {
            hall.heard(event, &mut effects);
        }
        for (station, outlet) in shared.outlets.iter().enumerate() {
            pass(station, outlet, &mut hall, &mut effects);
        }
        for effect in effects.drain(..) {
            match effect {
                Effect::Send(peer, message) => link.send(peer, &message.to_bytes()),
                Effect::Close(peer) => link.close(peer),
                Effect::Tell(station, heard) => waiting[station].push_back(heard),
                // Of work in pieces, which walks have none of.
                Effect::Grounded(..) | Effect::Worked(..) => {}
            }
        }
        for (input, waiting) in inputs.iter().zip(&mut waiting) {
            while let Some(heard) = waiting.front() {
                if input.send(heard.clone()).is_err() {
                    break;
                }
                waiting.pop_front();
            }
        }
        shared.serving.store(hall.serving(), Ordering::Relaxed);
    }
    hall.farewell(&mut *link);
}

/// Takes what a station has for its guest; jobs that follow each other go together.
fn pass(station: usize, outlet: &ArrayQueue<(u64, ToGuest)>, hall: &mut Hall, effects: &mut Vec<Effect>) {
    let (mut bundle, mut bundled_for) = (Vec::new(), 0);
    while let Some((incarnation, message)) = outlet.pop() {
        match message {
            ToGuest::Jobs(jobs) if bundled_for == incarnation && bundle.len() + jobs.len() <= JOBS_MAX => {
                bundle.extend(jobs);
            }
            other => {
                if !bundle.is_empty() {
                    let bundle = ToGuest::Jobs(std::mem::take(&mut bundle));
                    hall.passes(station, bundled_for, bundle, effects);
                }
                bundled_for = incarnation;
                match other {
                    ToGuest::Jobs(jobs) => bundle = jobs,
                    other => hall.passes(station, incarnation, other, effects),
                }
            }
        }
    }
    if !bundle.is_empty() {
        hall.passes(station, bundled_for, ToGuest::Jobs(bundle), effects);
    }
}
