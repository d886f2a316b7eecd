//! A reference or a bake, in pieces that guests do as well: the threads of this machine, and the door beside them.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Duration;

use crossbeam_queue::SegQueue;
use foveal_actors::station::STATIONS_MAX;
use foveal_engine::batch::{Found, Ground, Hands, Piece};
use foveal_engine::failure::Failure;
use foveal_files::bakes::encode;
use rayon::prelude::*;

use crate::door::{self, Effect, Hall, Serving};
use crate::foreman::Foreman;
pub use crate::foreman::HelperStatus;
use crate::key::{Invitation, Key};
use crate::link::{self, HostLink, Waker};
use crate::package::Package;
use crate::round::{Liar, Round, Spec};

/// A look at whether it is over.
const LOOK: Duration = Duration::from_millis(50);
/// Maps are encoded under this key: their hash tells them apart.
pub(crate) const MAP_KEY: [u8; 32] = [0; 32];

/// What the door and who works share.
#[derive(Default)]
struct HelpedShared {
    /// Pieces that are to be done, on their way to the door.
    rounds: SegQueue<Arc<Round>>,
    liars: SegQueue<Liar>,
    closing: AtomicBool,
    /// Guests that have the scene, and their cores.
    serving: AtomicU32,
    cores: AtomicU32,
}

/// The threads of this machine, and guests.
pub struct Helped {
    shared: Arc<HelpedShared>,
    waker: Waker,
    invitation: Invitation,
    thread: Serving<Vec<HelperStatus>>,
    package_bytes: u64,
    /// What pieces were of last.
    spec: SegQueue<Arc<Spec>>,
    rounds: AtomicU32,
    doubts: AtomicBool,
}

impl Helped {
    /// Opens a door for so many guests; one answer in `check` is compared with what is found here.
    ///
    /// # Errors
    /// If nobody can listen at the address.
    pub fn open(address: &str, key: Key, package: Package, guests: u32, check: u32) -> Result<Self, Failure> {
        let (at, own_key) = (address.to_owned(), key.clone());
        Self::over(move || link::listen(&at, &own_key), key, package, guests, check)
    }

    pub(crate) fn over(
        link: impl FnOnce() -> Result<Box<dyn HostLink>, String> + Send + 'static,
        key: Key,
        package: Package,
        guests: u32,
        check: u32,
    ) -> Result<Self, Failure> {
        let guests = guests.min(STATIONS_MAX);
        let shared = Arc::new(HelpedShared::default());
        let (inside, package_bytes, package) = (Arc::clone(&shared), package.bytes(), Arc::new(package));
        let serve = move |link| {
            let foreman = Foreman::new(guests, u64::from(check), door::random);
            serve(link, Hall::of_work(package, guests), foreman, &inside)
        };
        let (address, waker, thread) = door::serving(link, serve)?;
        let invitation = Invitation { address, key };
        let (spec, rounds, doubts) = (SegQueue::new(), AtomicU32::new(0), AtomicBool::new(false));
        Ok(Self { shared, waker, invitation, thread, package_bytes, spec, rounds, doubts })
    }

    /// What guests need to come.
    pub fn invitation(&self) -> &Invitation {
        &self.invitation
    }

    /// Bytes that a guest needs to come.
    pub fn package_bytes(&self) -> u64 {
        self.package_bytes
    }

    /// Guests that have the scene.
    pub fn serving(&self) -> u32 {
        self.shared.serving.load(Ordering::Relaxed)
    }

    /// Ends it, and tells what became of the pieces of each guest.
    pub fn close(self) -> Vec<HelperStatus> {
        self.shared.closing.store(true, Ordering::SeqCst);
        self.waker.wake();
        self.thread.join().ok().flatten().unwrap_or_default()
    }

    /// What guests are told that pieces are of; none where they cannot help.
    fn spec(&self, number: u32, ground: &Ground<'_>, pieces: &[Piece]) -> Option<Arc<Spec>> {
        // A bake has many short rounds: who comes meanwhile begins with the next one.
        if self.serving() == 0 && matches!(ground, Ground::Bake { .. }) {
            return None;
        }
        let needs_light = |piece: &Piece| matches!(piece, Piece::Converged(_) | Piece::Tile { .. });
        if ground.map().is_none() && pieces.iter().any(needs_light) {
            return None;
        }
        let (task, digest) = (ground.task(), ground.map().map(|map| map.digest()));
        let last = self.spec.pop();
        let known = last.as_ref().filter(|last| last.task == task && last.digest == digest).cloned();
        let made = || {
            let map = match ground.map() {
                Some(map) => {
                    let bytes = encode(&MAP_KEY, map).ok()?;
                    Some((*blake3::hash(&bytes).as_bytes(), Arc::new(bytes)))
                }
                None => None,
            };
            Some(Arc::new(Spec { number, task, digest, map }))
        };
        let spec = known.or_else(made)?;
        self.spec.push(Arc::clone(&spec));
        Some(spec)
    }
}

impl Hands for Helped {
    fn each(
        &self,
        ground: &Ground<'_>,
        pieces: Vec<Piece>,
        goes_on: &(dyn Fn() -> bool + Sync),
    ) -> Vec<Option<Found>> {
        let number = self.rounds.fetch_add(1, Ordering::Relaxed);
        let spec = self.spec(number, ground, &pieces);
        let round = Arc::new(Round::new(number, spec, pieces));
        if round.spec.is_some() {
            self.shared.rounds.push(Arc::clone(&round));
            self.waker.wake();
        }
        rayon::scope(|scope| {
            for _ in 0..rayon::current_num_threads() {
                scope.spawn(|_| round.work(ground, goes_on));
            }
        });
        let (mut found, liars) = round.ended();
        if !liars.is_empty() {
            // What was handed out before is not to be believed, either.
            if liars.iter().any(|liar| liar.since < number) {
                self.doubts.store(true, Ordering::SeqCst);
            }
            liars.into_iter().for_each(|liar| self.shared.liars.push(liar));
            self.waker.wake();
            found.par_iter_mut().zip(&round.pieces).filter(|(found, _)| found.is_none()).for_each(
                |(found, piece)| {
                    *found = goes_on().then(|| ground.done(piece, &goes_on)).flatten();
                },
            );
        }
        found
    }

    fn worth(&self) -> u64 {
        let here = rayon::current_num_threads() as u32;
        u64::from((here + self.shared.cores.load(Ordering::Relaxed)).div_ceil(here.max(1)))
    }

    fn doubts(&self) -> bool {
        self.doubts.swap(false, Ordering::SeqCst)
    }
}

fn serve(
    mut link: Box<dyn HostLink>,
    mut hall: Hall,
    mut foreman: Foreman,
    shared: &HelpedShared,
) -> Vec<HelperStatus> {
    let mut effects = Vec::new();
    while !shared.closing.load(Ordering::SeqCst) {
        let event = link.next(LOOK);
        foreman.ban(std::iter::from_fn(|| shared.liars.pop()), &mut hall, &mut effects);
        while let Some(round) = shared.rounds.pop() {
            foreman.begin(round, &mut hall, &mut effects);
        }
        if let Some(event) = event {
            hall.heard(event, &mut effects);
        }
        deliver(&mut *link, &mut hall, &mut foreman, &mut effects);
        foreman.assign(&mut hall, &mut effects);
        deliver(&mut *link, &mut hall, &mut foreman, &mut effects);
        shared.cores.store(foreman.cores(), Ordering::Relaxed);
        shared.serving.store(hall.serving(), Ordering::Relaxed);
    }
    hall.farewell(&mut *link);
    foreman.ended()
}

/// Does what hall and foreman want done, and what they want because of that.
fn deliver(link: &mut dyn HostLink, hall: &mut Hall, foreman: &mut Foreman, effects: &mut Vec<Effect>) {
    while !effects.is_empty() {
        for effect in std::mem::take(effects) {
            match effect {
                Effect::Send(peer, message) => link.send(peer, &message.to_bytes()),
                Effect::Close(peer) => link.close(peer),
                Effect::Tell(place, heard) => foreman.heard(place, heard),
                Effect::Grounded(place, incarnation, number) => foreman.grounded(place, incarnation, number),
                Effect::Worked(place, incarnation, worked) => {
                    foreman.worked(place, incarnation, worked, hall, effects);
                }
            }
        }
    }
}
