//! Searches a recording for when something came about.
//!
//! Deliveries are replayed and looked at on the way, each actor's on the thread that makes it: all of them, parts beside
//! each other, or those parts alone in which a counter passes a bound or a kind of message came.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use crossbeam_queue::SegQueue;
use foveal_actors::wiring::Actors;
use foveal_runtime::{ActorId, Content, Delivery, Observer, Runtime};

use super::condition::{Comparison, Condition, Of, Test};
use super::counters::COUNTERS;
use super::history::Record;
use super::index::Index;
use super::listener::Listener;
use super::pictures::tile_of;
use super::source::{Ground, How, Source};
use super::when::{object, pixel, samples_of, standing};
use crate::failure::Failure;
use crate::interrupt::interrupted;

/// What is looked at, delivery by delivery.
pub(super) type Look = Box<dyn Fn(&Delivery<'_>) -> Option<Content> + Send + Sync>;

/// Parts of a recording that are searched beside each other, for each thread: so that none waits long for another.
const PARTS_PER_THREAD: usize = 4;

/// What is seen, by the delivery that it came about in.
type Values = BTreeMap<u64, Content>;

/// A stretch of a recording.
pub(super) struct Part {
    /// What has been delivered at its beginning: the start, or where a snapshot is kept.
    begin: Vec<u64>,
    /// What has been delivered at its end.
    end: Vec<u64>,
}

fn progress(place: &[u64]) -> u64 {
    place.iter().sum()
}

/// A search.
pub(super) struct Search<'a> {
    pub(super) source: &'a Source,
    pub(super) condition: &'a Condition,
    /// Whose deliveries are looked at.
    pub(super) actor: ActorId,
    pub(super) look: Arc<Look>,
    pub(super) workers: usize,
}

impl Search<'_> {
    /// What is seen, as far as it decides where the condition comes to hold.
    pub(super) fn values(&self) -> Result<Values, Failure> {
        if let Some(values) = self.by_halves() {
            return Ok(values);
        }
        // What all of it tells is left for the next question.
        let listens = !self.source.is_told();
        let found = match self.parts_of_interest().or_else(|| self.parts()) {
            Some(parts) => self.beside(&parts, listens)?,
            None => None,
        };
        match found {
            Some(found) => Ok(found),
            // No snapshots, or one of them may be at fault.
            None => self.seen_in_whole(listens),
        }
    }

    fn seen_in_whole(&self, listens: bool) -> Result<Values, Failure> {
        let (source, end) = (self.source, self.source.deliveries());
        let queue = Arc::default();
        let observer = observer(&queue, self.actor, &self.look);
        let listener = listens.then(|| Listener::new(&vec![0; end.len()]));
        let observer = match &listener {
            Some(listener) => listener.observer(Some(observer)),
            None => observer,
        };
        let how = How { threads: self.workers, observer: Some(observer), ..How::default() };
        let (mut runtime, actors) = source.run(how, |_| ())?;
        if let Some(divergence) = runtime.replay_report().divergence {
            return Err(Failure::Check(format!("the replay diverges: {divergence}")));
        }
        runtime.positions();
        if let Some(listener) = listener {
            source.history().add(listener.records(&runtime, &end));
        }
        collect(source, self.condition, self.actor, &queue, (&runtime, &actors), end[self.actor.0 as usize])
    }

    /// What is seen in the parts, each replayed on a thread of its own. `None` where one of them cannot be replayed from its
    /// snapshot.
    fn beside(&self, parts: &[Part], listens: bool) -> Result<Option<Values>, Failure> {
        let (end, index) = (self.source.deliveries(), self.source.index());
        let one = self.one(&index, listens, &end);
        let (next, workers) = (AtomicUsize::new(0), self.workers);
        let found = std::thread::scope(|scope| {
            let work = || {
                let mut found = Vec::new();
                while let Some(part) = parts.get(next.fetch_add(1, Ordering::Relaxed)) {
                    if interrupted() {
                        break;
                    }
                    found.push(one.seen_in(part));
                }
                found
            };
            let threads: Vec<_> = (0..workers.min(parts.len())).map(|_| scope.spawn(work)).collect();
            threads
                .into_iter()
                .flat_map(|thread| thread.join().unwrap_or_else(|_| vec![None]))
                .collect::<Vec<_>>()
        });
        if interrupted() {
            return Err(Failure::Interrupted("interrupted while replaying".into()));
        }
        let Some(found) = found.into_iter().collect::<Option<Vec<_>>>() else { return Ok(None) };
        let (values, records): (Vec<_>, Vec<_>) = found.into_iter().unzip();
        self.source.history().add(records.into_iter().flatten().collect());
        Ok(Some(values.into_iter().flatten().collect()))
    }

    /// The search of one part.
    fn one<'a>(&'a self, index: &'a Index, listens: bool, deliveries: &'a [u64]) -> One<'a> {
        let Self { source, condition, actor, look, .. } = self;
        One { ground: source, index, condition, actor: *actor, look, listens, deliveries }
    }

    /// The parts between the snapshots that are kept, about as many as keep all threads busy; none where there are too few.
    pub(super) fn parts(&self) -> Option<Vec<Part>> {
        let (places, end) = (self.source.places(), self.source.deliveries());
        let count = self.workers.max(1) * PARTS_PER_THREAD;
        if self.workers < 2 || places.len() < count {
            return None;
        }
        let step = progress(&end) / count as u64;
        let mut begins: Vec<Vec<u64>> = vec![vec![0; end.len()]];
        for place in places {
            let before = begins.last().map_or(0, |place| progress(place));
            if progress(&place) >= before + step && progress(&place) < progress(&end) {
                begins.push(place);
            }
        }
        let ends = begins[1..].iter().cloned().chain([end]).collect::<Vec<_>>();
        // The longest decides how long it takes.
        let longest = begins.iter().zip(&ends).map(|(begin, end)| progress(end) - progress(begin)).max()?;
        if longest > 4 * step.max(1) {
            return None;
        }
        Some(begins.into_iter().zip(ends).map(|(begin, end)| Part { begin, end }).collect())
    }

    /// The parts between snapshots in which messages of the kind that is looked for came, or the tile of the pixel changed.
    /// `None` where that is not known, or it was nearly everywhere.
    pub(super) fn parts_of_interest(&self) -> Option<Vec<Part>> {
        let (actor, end) = (self.actor.0 as usize, self.source.deliveries());
        let at = match &self.condition.of {
            Of::Hears(_, kind, _) => self.source.history().heard_at(self.actor, end[actor], kind)?,
            Of::Pixel(x, y) => {
                let tile = tile_of(*x, *y, self.source.recorded.settings.width);
                self.source.history().tile_changed(self.actor, end[actor], tile)?
            }
            _ => return None,
        };
        let places = self.source.places().into_iter().filter(|place| progress(place) < progress(&end));
        let begins: Vec<Vec<u64>> = [vec![0; end.len()]].into_iter().chain(places).collect();
        let ends = begins[1..].iter().cloned().chain([end.clone()]);
        let is_of_interest = |part: &Part| {
            let next = at.partition_point(|index| *index < part.begin[actor]);
            at.get(next).is_some_and(|index| *index < part.end[actor])
        };
        let parts = begins.iter().cloned().zip(ends).map(|(begin, end)| Part { begin, end });
        let parts: Vec<Part> = parts.filter(is_of_interest).collect();
        let replayed: u64 = parts.iter().map(|part| progress(&part.end) - progress(&part.begin)).sum();
        (replayed < progress(&end) / 2).then_some(parts)
    }

    /// What is seen in the part in which a number that never falls passes a bound, found by halves. `None` where the
    /// condition does not ask for that, or what is kept does not do.
    pub(super) fn by_halves(&self) -> Option<Values> {
        let source = self.source;
        let Of::State(_, test) = &self.condition.of else { return None };
        let grows = matches!(test.comparison, Comparison::More | Comparison::AtLeast);
        let counts = COUNTERS.contains(&(source.name(self.actor), test.path.as_str()));
        let (places, end) = (source.places(), source.deliveries());
        if !grows || !counts || places.is_empty() {
            return None;
        }
        // Snapshots at which it does not hold yet.
        let name = source.name(self.actor);
        let index = source.index();
        let holds = |place: &Vec<u64>| {
            let number = index.counts(place).and_then(|counts| counts.at(name, &test.path));
            number.is_some_and(|number| test.holds(&Content::Count(number)))
        };
        let below = places.partition_point(|place| !holds(place));
        let begin = below.checked_sub(1).map_or_else(|| vec![0; end.len()], |last| places[last].clone());
        let part = Part { begin, end: places.get(below).cloned().unwrap_or_else(|| end.clone()) };
        let one = self.one(&index, false, &end);
        one.seen_in(&part).map(|(values, _)| values)
    }
}

/// The search of one part, on any thread.
struct One<'a> {
    ground: &'a Ground,
    index: &'a Index,
    condition: &'a Condition,
    actor: ActorId,
    look: &'a Arc<Look>,
    /// Whether what all actors are told and know is noted.
    listens: bool,
    /// All of the recording.
    deliveries: &'a [u64],
}

impl One<'_> {
    /// What is seen in a part, and what was noted. `None` where it cannot be replayed from its snapshot.
    fn seen_in(&self, part: &Part) -> Option<(Values, Vec<Record>)> {
        let from = match progress(&part.begin) {
            0 => None,
            _ => Some(Arc::new(self.index.at(&part.begin)?)),
        };
        let queue = Arc::default();
        let observer = observer(&queue, self.actor, self.look);
        let listener = self.listens.then(|| Listener::new(&part.begin));
        let observer = match &listener {
            Some(listener) => listener.observer(Some(observer)),
            None => observer,
        };
        let how = How { from, observer: Some(observer), ..How::default() };
        let (mut runtime, actors) = self.ground.system(how).ok()?;
        if !runtime.run_to(&part.end) || runtime.diverged() {
            return None;
        }
        let end = part.end[self.actor.0 as usize];
        let values =
            collect(self.ground, self.condition, self.actor, &queue, (&runtime, &actors), end).ok()?;
        let records = listener.map(|listener| listener.records(&runtime, self.deliveries));
        Some((values, records.unwrap_or_default()))
    }
}

/// What is looked at goes into a queue.
fn observer(queue: &Arc<SegQueue<(u64, Content)>>, actor: ActorId, look: &Arc<Look>) -> Observer {
    let (sink, look) = (Arc::clone(queue), Arc::clone(look));
    Arc::new(move |d: &Delivery<'_>| {
        if d.actor == actor
            && let Some(value) = look(d)
        {
            sink.push((d.index, value));
        }
    })
}

/// What was seen, by the delivery that it came about in; and what the last one left.
fn collect(
    ground: &Ground,
    condition: &Condition,
    actor: ActorId,
    queue: &SegQueue<(u64, Content)>,
    (runtime, actors): (&Runtime, &Actors),
    end: u64,
) -> Result<Values, Failure> {
    let mut values: Values = std::iter::from_fn(|| queue.pop()).collect();
    // What was seen before a delivery is what the one before left; the last one's is still to be seen.
    let last = match &condition.of {
        Of::Hears(..) => return Ok(values),
        Of::State(_, Test { path, .. }) | Of::Changes(_, path) => {
            runtime.content(actor).map(|content| standing(&content, path))
        }
        Of::Pixel(x, y) => runtime.inspect(actors.renderer, |r| pixel(r, *x, *y)).flatten(),
        Of::Loses(name) => {
            let object = object(ground, name)?;
            let ager = actors.correction.as_ref().map(|correction| correction.cache_ager);
            ager.and_then(|ager| runtime.inspect(ager, |ager| samples_of(ager, object)))
        }
    };
    values.extend(last.map(|value| (end, value)));
    Ok(values.into_iter().filter_map(|(index, value)| Some((index.checked_sub(1)?, value))).collect())
}
