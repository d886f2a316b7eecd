//! Who of the guests is at which pieces of work: a state machine beside the [`Hall`], for work in pieces.

use std::collections::BTreeSet;
use std::sync::Arc;

use foveal_actors::station::Heard;
use foveal_actors::station::wire::{Refusal, ToGuest, lease_of, round_of};
use foveal_engine::batch::Found;

use crate::door::{Effect, Hall, Worked};
use crate::round::{Check, Liar, Round};

/// Answers of a guest that are all compared with what is found here, before it gets more pieces than it has cores.
const PROVING: u32 = 2;
/// Pieces that a guest has for each of its cores at most.
const AHEAD: usize = 8;
/// So many times the pieces that it may be at were not answered: it gets no more until some are.
const LOST: usize = 4;
/// Pieces that a guest could not do, one after the other, after which it gets no more.
const UNABLE_MAX: u32 = 3;

/// What became of a guest's pieces.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HelperStatus {
    /// Its name.
    pub name: String,
    /// Its cores.
    pub cores: u16,
    /// Pieces that it did and that counted.
    pub pieces: u64,
    /// Seconds of its cores.
    pub busy: f64,
    /// Answers that came too late or for nothing.
    pub late: u64,
    /// Pieces that it left to others.
    pub returned: u64,
    /// Answers that were done here as well, to compare.
    pub checked: u64,
    /// Whether it was banned.
    pub banned: bool,
}

/// What a guest knows of what pieces are of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stands {
    Nowhere,
    /// It gets what this needs.
    Moving(u32),
    On(u32),
}

struct Helper {
    incarnation: u64,
    stands: Stands,
    /// Pieces that it is at: lease, of the round in its upper half.
    out: BTreeSet<u64>,
    /// Pieces that it may be at.
    window: usize,
    answers: u32,
    unable: u32,
    /// The first round in which it was believed.
    since: Option<u32>,
    status: HelperStatus,
}

/// Who of the guests is at what.
pub(crate) struct Foreman {
    places: Vec<Option<Helper>>,
    round: Option<Arc<Round>>,
    /// One answer of so many is compared with what is found here.
    check: u64,
    salt: fn() -> u64,
    gone: Vec<HelperStatus>,
}

impl Foreman {
    /// Of so many places. One answer in `check` is compared with what is found here, chosen by numbers that no guest knows.
    pub fn new(places: u32, check: u64, salt: fn() -> u64) -> Self {
        let places = (0..places).map(|_| None).collect();
        Self { places, round: None, check: check.max(1), salt, gone: Vec::new() }
    }

    /// Cores of all guests.
    pub fn cores(&self) -> u32 {
        self.places.iter().flatten().map(|helper| u32::from(helper.status.cores)).sum()
    }

    /// Other pieces are to be done.
    pub fn begin(&mut self, round: Arc<Round>, hall: &mut Hall, effects: &mut Vec<Effect>) {
        if let Some((hash, bytes)) = round.spec.as_ref().and_then(|spec| spec.map.clone()) {
            hall.offer(hash, bytes);
        }
        for (place, helper) in self.places.iter().enumerate() {
            if let Some(helper) = helper.as_ref().filter(|helper| !helper.out.is_empty()) {
                hall.passes(place, helper.incarnation, ToGuest::Retire { below: round.number }, effects);
            }
        }
        self.round = Some(round);
    }

    /// What these have found is not believed.
    pub fn ban(&mut self, liars: impl Iterator<Item = Liar>, hall: &mut Hall, effects: &mut Vec<Effect>) {
        for Liar { place, incarnation, .. } in liars {
            hall.passes(place, incarnation, ToGuest::Refused(Refusal::Banned), effects);
        }
    }

    /// Takes what the hall tells.
    pub fn heard(&mut self, place: usize, heard: Heard) {
        match heard {
            Heard::Joined { incarnation, cores, name } => {
                let status = HelperStatus { name, cores, ..HelperStatus::default() };
                self.places[place] = Some(Helper {
                    incarnation,
                    stands: Stands::Nowhere,
                    out: BTreeSet::new(),
                    window: usize::from(cores),
                    answers: 0,
                    unable: 0,
                    since: None,
                    status,
                });
            }
            Heard::Left { incarnation, banned } => {
                if self.of(place, incarnation).is_none() {
                    return;
                }
                let Some(mut helper) = self.places[place].take() else { return };
                if let Some(round) = &self.round {
                    for piece in helper.out.iter().filter_map(|lease| piece_of(*lease, round)) {
                        round.give_back(piece);
                        helper.status.returned += 1;
                    }
                }
                helper.status.banned = banned;
                self.gone.push(helper.status);
            }
            // Of walks: here nobody of other bits is let in, and samples are not pieces.
            Heard::Done { .. } | Heard::OtherJoined { .. } | Heard::Told { .. } => {}
        }
    }

    fn of(&mut self, place: usize, incarnation: u64) -> Option<&mut Helper> {
        self.places.get_mut(place)?.as_mut().filter(|helper| helper.incarnation == incarnation)
    }

    /// A guest has what pieces are of.
    pub fn grounded(&mut self, place: usize, incarnation: u64, number: u32) {
        if let Some(helper) = self.of(place, incarnation)
            && helper.stands == Stands::Moving(number)
        {
            helper.stands = Stands::On(number);
        }
    }

    /// A guest has answered.
    pub fn worked(
        &mut self,
        place: usize,
        incarnation: u64,
        worked: Worked,
        hall: &mut Hall,
        effects: &mut Vec<Effect>,
    ) {
        let (round, check, salt) = (self.round.clone(), self.check, (self.salt)());
        let Some(helper) = self.of(place, incarnation) else { return };
        let Worked { lease, micros, waiting, found } = worked;
        if !helper.out.remove(&lease) {
            helper.status.late += 1;
            return;
        }
        let cores = usize::from(helper.status.cores);
        if helper.answers >= PROVING && waiting == 0 {
            helper.window = (helper.window + 1).min(AHEAD * cores);
        } else if waiting as usize > 2 * cores {
            helper.window = (helper.window - 1).max(cores);
        }
        let Some((round, piece)) =
            round.and_then(|round| piece_of(lease, &round).map(|piece| (round, piece)))
        else {
            helper.status.late += 1;
            return;
        };
        if found.is_empty() {
            helper.unable += 1;
            helper.status.returned += 1;
            return round.give_back(piece);
        }
        let decoded: Option<Found> = postcard::from_bytes(&found).ok();
        let fits = |found: &Found| {
            round.spec.as_ref().is_some_and(|spec| spec.task.may_come_to(&round.pieces[piece], found))
        };
        let Some(decoded) = decoded.filter(fits) else {
            return hall.passes(place, incarnation, ToGuest::Refused(Refusal::Banned), effects);
        };
        helper.unable = 0;
        let since = *helper.since.get_or_insert(round.number);
        if helper.answers < PROVING || salt.is_multiple_of(check) {
            helper.status.checked += 1;
            round.check(Check { piece, found, place, incarnation, since });
        }
        helper.answers = helper.answers.saturating_add(1);
        if round.finish(piece, Some(decoded), Some(incarnation)) {
            helper.status.pieces += 1;
            helper.status.busy += f64::from(micros) * 1e-6;
        } else {
            helper.status.late += 1;
        }
    }

    /// Gives guests what they can do.
    pub fn assign(&mut self, hall: &mut Hall, effects: &mut Vec<Effect>) {
        let Some(round) = self.round.clone() else { return };
        let Some(spec) = round.spec.as_ref().filter(|_| !round.is_over()) else { return };
        for (place, helper) in self.places.iter_mut().enumerate() {
            let Some(helper) = helper else { continue };
            match helper.stands {
                // One thing after the other.
                Stands::Moving(_) => continue,
                Stands::On(number) if number == spec.number => {}
                Stands::On(_) | Stands::Nowhere => {
                    let Ok(task) = postcard::to_stdvec(&spec.task) else { continue };
                    let map = spec.map.as_ref().map(|(hash, bytes)| (*hash, bytes.len() as u64));
                    let ground = ToGuest::Ground { number: spec.number, task, map };
                    hall.passes(place, helper.incarnation, ground, effects);
                    helper.stands = Stands::Moving(spec.number);
                    continue;
                }
            }
            // Of rounds before there are a few, unless it does not answer.
            let is_lost = helper.out.len() > LOST * helper.window || helper.unable >= UNABLE_MAX;
            let out = helper.out.range(lease_of(round.number, 0)..).count();
            for _ in out..if is_lost { out } else { helper.window } {
                let Some(piece) = round.give() else { break };
                let lease = lease_of(round.number, piece as u32);
                helper.out.insert(lease);
                let Ok(bytes) = postcard::to_stdvec(&round.pieces[piece]) else { continue };
                let work = ToGuest::Work { lease, ground: spec.number, piece: bytes };
                hall.passes(place, helper.incarnation, work, effects);
            }
        }
    }

    /// What became of everybody's pieces.
    pub fn ended(self) -> Vec<HelperStatus> {
        let there = self.places.into_iter().flatten().map(|helper| helper.status);
        self.gone.into_iter().chain(there).collect()
    }
}

/// The piece of a round that a lease is of.
fn piece_of(lease: u64, round: &Round) -> Option<usize> {
    let piece = lease as u32 as usize;
    (round_of(lease) == round.number && piece < round.pieces.len()).then_some(piece)
}
