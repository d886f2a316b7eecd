//! Notes what all actors are told and know while a replay runs: what [`super::history`] keeps.
//!
//! An actor whose state takes much room, and a kind of message that does, are left out: of those messages only the places
//! are noted. What is left out depends on the recording alone.

use std::collections::BTreeMap;
use std::sync::Arc;

use crossbeam_queue::{ArrayQueue, SegQueue};
use foveal_actors::renderer::Renderer;
use foveal_runtime::{ActorId, Content, Delivery, Observer, Runtime};

use super::course::Writer;
use super::history::{Block, Heard, Record};
use super::pictures::Pictures;

/// Bytes of an actor's state at most, where it is noted: telling it takes about as long as a delivery does.
const STATE_BYTES_MAX: usize = 16 << 10;
/// Bytes that become others in a state at most, on average over the deliveries of a record.
const CHANGE_BYTES_MAX: usize = 1 << 10;
/// Items of lists in it: those of long lists are told by their hash alone, which takes time and no room.
const STATE_ITEMS_MAX: usize = 4096;
/// Bytes of a message above which it is large…
const MESSAGE_BYTES_MAX: usize = 512;
/// …or items of lists in it…
const MESSAGE_ITEMS_MAX: usize = 256;
/// …and so many of a kind are noted: few are light and textures, many are samples.
const LARGE_MAX: usize = 64;
/// Bytes of an actor's notes that make a record.
const RECORD_BYTES: usize = 1 << 20;

/// How many items all lists in a value have.
fn items(content: &Content) -> usize {
    match content {
        Content::List(list) => list.length + list.items.iter().map(items).sum::<usize>(),
        Content::Fields { fields, .. } => fields.iter().map(|(_, value)| items(value)).sum(),
        _ => 0,
    }
}

/// Messages of one kind to one actor.
#[derive(Default)]
struct Kind {
    places: Writer,
    told: Writer,
}

/// What is noted of one actor.
struct ActorNotes {
    begin: u64,
    next: u64,
    state: Writer,
    kinds: BTreeMap<&'static str, Kind>,
    /// Whether its state is left out.
    is_silent: bool,
    /// Large messages so far, by kind.
    large: BTreeMap<&'static str, usize>,
    /// What is shown, where it is the renderer's.
    pictures: Option<Pictures>,
    /// A delivery went by.
    is_broken: bool,
}

impl ActorNotes {
    fn new(begin: u64) -> Self {
        Self {
            begin,
            next: begin,
            state: Writer::default(),
            kinds: BTreeMap::new(),
            is_silent: false,
            large: BTreeMap::new(),
            pictures: None,
            is_broken: false,
        }
    }

    fn look(&mut self, d: &Delivery<'_>) {
        self.is_broken |= d.index != self.next;
        if self.is_broken {
            return;
        }
        self.next += 1;
        if !self.is_silent {
            match (d.state)() {
                // An order to the runtime shows nothing of the actor.
                Content::Untold => self.state.is_unseen(d.index),
                state => self.stands(d.index, state),
            }
        }
        if let Some(renderer) = d.receiver.downcast_ref::<Renderer>() {
            let pictures = self.pictures.get_or_insert_default();
            renderer.shown().into_iter().for_each(|shown| pictures.stands(d.index, &shown.rgb8));
        }
        let kind = self.kinds.entry(d.kind).or_default();
        kind.places.comes(d.index, Content::Untold);
        let large = self.large.entry(d.kind).or_default();
        if *large < LARGE_MAX {
            let (before, told) = (kind.told.len(), (d.told)());
            let has_many = items(&told) > MESSAGE_ITEMS_MAX;
            kind.told.comes(d.index, told);
            *large += usize::from(has_many || kind.told.len() - before > MESSAGE_BYTES_MAX);
        }
    }

    fn stands(&mut self, index: u64, state: Content) {
        let is_first = self.state.len() == 0;
        self.is_silent |= is_first && items(&state) > STATE_ITEMS_MAX;
        self.state.stands(index, state);
        self.is_silent |= is_first && self.state.len() > STATE_BYTES_MAX;
    }

    fn len(&self) -> usize {
        self.state.len() + self.kinds.values().map(|kind| kind.told.len()).sum::<usize>()
    }

    /// What was noted so far, and goes on behind it.
    fn record(&mut self, actor: ActorId) -> Option<Record> {
        let count = self.next - self.begin;
        if self.is_broken || count == 0 {
            return None;
        }
        let Self { begin, next, .. } = *self;
        let state = std::mem::take(&mut self.state);
        let most = STATE_BYTES_MAX + CHANGE_BYTES_MAX.saturating_mul(count as usize);
        self.is_silent |= state.len() > most;
        let state = (!self.is_silent).then(|| Block::of(&state.end()));
        let heard = std::mem::take(&mut self.kinds).into_iter().map(|(name, kind)| {
            let is_told = self.large.get(name).is_none_or(|large| *large < LARGE_MAX);
            let heard = match is_told {
                true => Heard::Told(Block::of(&kind.told.end())),
                false => Heard::At(Block::of(&kind.places.end())),
            };
            (name.to_owned(), heard)
        });
        let pictures = self.pictures.as_mut().map(|pictures| Block::of(&pictures.take()));
        let record = Record { actor: actor.0, begin, end: next, state, heard: heard.collect(), pictures };
        self.begin = next;
        Some(record)
    }
}

/// Listens to a replay.
pub(super) struct Listener {
    /// Notes of each actor, which whoever delivers to it has meanwhile.
    seats: Vec<ArrayQueue<ActorNotes>>,
    records: SegQueue<Record>,
}

impl Listener {
    /// Of a replay that begins where so much has been delivered to each actor.
    pub(super) fn new(begin: &[u64]) -> Arc<Self> {
        let seats = begin.iter().map(|begin| {
            let seat = ArrayQueue::new(1);
            let _ = seat.push(ActorNotes::new(*begin));
            seat
        });
        Arc::new(Self { seats: seats.collect(), records: SegQueue::new() })
    }

    /// What is to observe the replay; `other` sees everything, too.
    pub(super) fn observer(self: &Arc<Self>, other: Option<Observer>) -> Observer {
        let listener = Arc::clone(self);
        Arc::new(move |d: &Delivery<'_>| {
            listener.look(d);
            if let Some(other) = &other {
                other(d);
            }
        })
    }

    fn look(&self, d: &Delivery<'_>) {
        let Some(seat) = self.seats.get(d.actor.0 as usize) else { return };
        let Some(mut notes) = seat.pop() else { return };
        notes.look(d);
        if notes.len() >= RECORD_BYTES {
            notes.record(d.actor).into_iter().for_each(|record| self.records.push(record));
        }
        let _ = seat.push(notes);
    }

    /// What was noted since the last call, between two turns; and how those actors were left that have had all
    /// `deliveries` of theirs.
    pub(super) fn records(&self, runtime: &Runtime, deliveries: &[u64]) -> Vec<Record> {
        for (number, (seat, end)) in (0..).zip(self.seats.iter().zip(deliveries)) {
            let (actor, Some(mut notes)) = (ActorId(number), seat.pop()) else { continue };
            if notes.next == *end
                && let Some(state) = runtime.content(actor)
            {
                if !notes.is_silent {
                    notes.stands(*end, state);
                }
                // Nobody saw what the last one left.
                let last = end.saturating_sub(1);
                notes.pictures.iter_mut().for_each(|pictures| pictures.is_unknown(last));
                notes.next += 1;
            }
            notes.record(actor).into_iter().for_each(|record| self.records.push(record));
            let _ = seat.push(notes);
        }
        std::iter::from_fn(|| self.records.pop()).collect()
    }
}
