//! Goes all along a recording for the sake of whoever looks at it later.

use std::sync::Arc;

use foveal_runtime::{ActorId, Exit, Limit, Runtime};

use super::counters::counted;
use super::listener::Listener;
use super::source::{How, Source};
use crate::interrupt::interrupted;

/// A replay of which only its snapshots are wanted, and what actors are told and know in it.
pub struct Indexing {
    /// `None` before it has begun.
    replay: Option<(Runtime, Arc<Listener>)>,
    /// Up to so many deliveries there are snapshots already.
    kept: u64,
    is_done: bool,
}

impl Indexing {
    pub(super) fn new(is_done: bool) -> Self {
        Self { replay: None, kept: 0, is_done }
    }

    /// From the last snapshot before which nothing is missing.
    fn begin(&mut self, source: &Source) -> Option<&mut (Runtime, Arc<Listener>)> {
        let (index, mut history, end) = (source.index(), source.history(), source.deliveries());
        let known: Vec<u64> = (0..end.len() as u32).map(|actor| history.known_to(ActorId(actor))).collect();
        let places = index.places();
        self.kept = places.last().map_or(0, |place| place.iter().sum());
        let is_known = |place: &&Vec<u64>| place.iter().zip(&known).all(|(made, known)| made <= known);
        let from = places.iter().rev().find(is_known).and_then(|place| index.at(place));
        let begun = from.and_then(|from| {
            let listener = Listener::new(from.positions());
            let observer = Some(listener.observer(None));
            let how = How { from: Some(Arc::new(from)), observer, ..How::default() };
            Some((source.system(how).ok()?.0, listener))
        });
        let begun = begun.or_else(|| {
            let listener = Listener::new(&vec![0; end.len()]);
            let observer = Some(listener.observer(None));
            Some((source.system(How { observer, ..How::default() }).ok()?.0, listener))
        });
        Some(self.replay.insert(begun?))
    }

    /// Goes on until `enough`. Returns whether there is more to do.
    pub fn go_on(&mut self, source: &Source, mut enough: impl FnMut() -> bool) -> bool {
        if self.is_done {
            return false;
        }
        if self.replay.is_none() && self.begin(source).is_none() {
            self.is_done = true;
            return false;
        }
        let (kept, deliveries) = (self.kept, source.deliveries());
        let Some((runtime, listener)) = &mut self.replay else { return false };
        let mut index = source.index_to_keep();
        index.begin();
        loop {
            let exit = runtime.pump_until(Limit::IDLE, |_| enough() || interrupted() || index.is_due());
            // What diverges is found again by whoever looks there.
            let is_due = matches!(exit, Exit::Until) && !(enough() || interrupted());
            if runtime.diverged() {
                (self.replay, self.is_done) = (None, true);
                return false;
            }
            if exit == Exit::Until && !is_due {
                return true;
            }
            let made = runtime.positions().iter().map(|(made, _)| made).sum::<u64>();
            let records = listener.records(runtime, &deliveries);
            source.history().add(records);
            if !is_due {
                (self.replay, self.is_done) = (None, true);
                return false;
            }
            match made >= kept {
                true => index.keep(|| counted(&source.trace, runtime)),
                false => index.begin(),
            }
        }
    }
}
