//! Pieces of work that threads of this machine and guests take from two ends, until all of them are done.
//!
//! Threads here never wait while there is something to do: once nobody has a piece to begin, they do those that guests are
//! at as well, the last given out first, and who is done first counts. So a guest that hangs costs nothing but its work.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicUsize, Ordering};
use std::thread;
use std::time::Duration;

use crossbeam_queue::SegQueue;
use foveal_actors::station::wire::Hash;
use foveal_engine::batch::{Found, Ground, Piece, Task};
use foveal_engine::interrupt::interrupted;

/// Nobody has begun it.
const WAITING: u8 = 0;
/// A thread of this machine is at it.
const HERE: u8 = 1;
/// A guest is.
const THERE: u8 = 2;
/// A guest, and a thread of this machine since.
const BOTH: u8 = 3;
/// What it comes to is known.
const DONE: u8 = 4;

/// A look at what guests are at, where there is nothing else to do.
const LOOK: Duration = Duration::from_micros(200);

/// What pieces are of, as guests get it.
pub(crate) struct Spec {
    /// Names it: the round that it was made for.
    pub number: u32,
    pub task: Task,
    /// Tells the light apart from others.
    pub digest: Option<u64>,
    /// The light, as a blob.
    pub map: Option<(Hash, Arc<Vec<u8>>)>,
}

/// An answer that is to be compared with what is found here.
pub(crate) struct Check {
    pub piece: usize,
    /// As it came.
    pub found: Vec<u8>,
    pub place: usize,
    pub incarnation: u64,
    /// The first round in which that guest was believed.
    pub since: u32,
}

/// A guest whose answer was wrong.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Liar {
    pub place: usize,
    pub incarnation: u64,
    pub since: u32,
}

/// Pieces, and what became of each.
pub(crate) struct Round {
    pub number: u32,
    /// None where guests are not to help.
    pub spec: Option<Arc<Spec>>,
    pub pieces: Vec<Piece>,
    states: Vec<AtomicU8>,
    /// This machine has looked at all before this one.
    front: AtomicUsize,
    /// Guests were offered all from this one on.
    back: AtomicUsize,
    returned: SegQueue<usize>,
    /// What was found of a piece, and by which guest.
    results: SegQueue<(usize, Found, Option<u64>)>,
    /// Pieces whose result is not known.
    left: AtomicUsize,
    checks: SegQueue<Check>,
    unchecked: AtomicUsize,
    pub liars: SegQueue<Liar>,
    over: AtomicBool,
}

impl Round {
    pub fn new(number: u32, spec: Option<Arc<Spec>>, pieces: Vec<Piece>) -> Self {
        let count = pieces.len();
        Self {
            number,
            spec,
            pieces,
            states: (0..count).map(|_| AtomicU8::new(WAITING)).collect(),
            front: AtomicUsize::new(0),
            back: AtomicUsize::new(count),
            returned: SegQueue::new(),
            results: SegQueue::new(),
            left: AtomicUsize::new(count),
            checks: SegQueue::new(),
            unchecked: AtomicUsize::new(0),
            liars: SegQueue::new(),
            over: AtomicBool::new(false),
        }
    }

    /// Whether nobody needs anything of it any more.
    pub fn is_over(&self) -> bool {
        self.over.load(Ordering::SeqCst)
    }

    fn is_known(&self) -> bool {
        self.left.load(Ordering::SeqCst) == 0 && self.unchecked.load(Ordering::SeqCst) == 0
    }

    /// Whether it was in that state, and is in the other one now.
    fn goes(&self, piece: usize, from: u8, to: u8) -> bool {
        self.states[piece].compare_exchange(from, to, Ordering::SeqCst, Ordering::SeqCst).is_ok()
    }

    /// A piece for a guest.
    pub fn give(&self) -> Option<usize> {
        let returned = || std::iter::from_fn(|| self.returned.pop()).find(|&i| self.goes(i, WAITING, THERE));
        returned().or_else(|| {
            let next = || {
                let less = |back: usize| back.checked_sub(1);
                self.back.fetch_update(Ordering::SeqCst, Ordering::SeqCst, less).ok().map(|back| back - 1)
            };
            std::iter::from_fn(next).find(|&i| self.goes(i, WAITING, THERE))
        })
    }

    /// A guest will not do it.
    pub fn give_back(&self, piece: usize) {
        if self.goes(piece, THERE, WAITING) {
            self.returned.push(piece);
        }
    }

    /// A piece for a thread of this machine.
    fn take(&self) -> Option<usize> {
        let returned = || std::iter::from_fn(|| self.returned.pop()).find(|&i| self.goes(i, WAITING, HERE));
        let next = || {
            let next = self.front.fetch_add(1, Ordering::SeqCst);
            if next < self.pieces.len() { Some(next) } else { None }
        };
        let fresh = || std::iter::from_fn(next).find(|&i| self.goes(i, WAITING, HERE));
        // Guests begin at the end: what was given out last is first.
        let shared = || (0..self.pieces.len()).find(|&i| self.goes(i, THERE, BOTH));
        returned().or_else(fresh).or_else(shared)
    }

    /// What a piece comes to; false where that was known.
    pub fn finish(&self, piece: usize, found: Option<Found>, by: Option<u64>) -> bool {
        if self.states[piece].swap(DONE, Ordering::SeqCst) == DONE {
            return false;
        }
        if let Some(found) = found {
            self.results.push((piece, found, by));
        }
        self.left.fetch_sub(1, Ordering::SeqCst);
        true
    }

    /// Has an answer compared. Before it is finished: until then the round is not over.
    pub fn check(&self, check: Check) {
        self.unchecked.fetch_add(1, Ordering::SeqCst);
        self.checks.push(check);
    }

    /// Does what there is to do, on one thread, until nothing is left.
    pub fn work(&self, ground: &Ground<'_>, goes_on: &(dyn Fn() -> bool + Sync)) {
        let here = |piece: usize| ground.done(&self.pieces[piece], &|| !interrupted());
        loop {
            if let Some(check) = self.checks.pop() {
                // What is found has one form as bytes, whatever numbers are in it.
                let found = here(check.piece).and_then(|found| postcard::to_stdvec(&found).ok());
                if found.is_some_and(|found| found != check.found) {
                    let Check { place, incarnation, since, .. } = check;
                    self.liars.push(Liar { place, incarnation, since });
                }
                self.unchecked.fetch_sub(1, Ordering::SeqCst);
            } else if let Some(piece) = self.take() {
                let found = if goes_on() { here(piece) } else { None };
                self.finish(piece, found, None);
            } else if self.is_known() {
                return;
            } else {
                thread::sleep(LOOK);
            }
        }
    }

    /// What all pieces came to, without what `liars` said, and who of those there were.
    pub fn ended(&self) -> (Vec<Option<Found>>, Vec<Liar>) {
        self.over.store(true, Ordering::SeqCst);
        let liars: Vec<Liar> = std::iter::from_fn(|| self.liars.pop()).collect();
        let mut found: Vec<Option<Found>> = self.pieces.iter().map(|_| None).collect();
        while let Some((piece, result, by)) = self.results.pop() {
            if !liars.iter().any(|liar| by == Some(liar.incarnation)) {
                found[piece] = Some(result);
            }
        }
        (found, liars)
    }
}
