//! When something came about in a recording.
//!
//! Deliveries are replayed and looked at on the way, each actor's on the thread that makes it: all of them, parts beside
//! each other, or those alone in which a counter passes a bound.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use crossbeam_queue::SegQueue;
use foveal_actors::cache_ager::CacheAger;
use foveal_actors::renderer::Renderer;
use foveal_actors::wiring::Actors;
use foveal_runtime::{ActorId, Content, Delivery, Observer, Runtime, Snapshot};

use super::condition::{Comparison, Of, Test};
use super::counters::COUNTERS;
use super::source::{Ground, How, Source};
use crate::failure::Failure;
use crate::interrupt::interrupted;

pub use super::condition::{Condition, GRAMMAR};

/// Where it came about.
#[derive(Clone, Debug, PartialEq)]
pub struct Met {
    /// The delivery in which it did.
    pub at: (ActorId, u64),
    /// Frames that had been shown before its actor's part in the recording came so far; `None` for other actors than the
    /// renderer.
    pub frame: Option<u32>,
    /// What there was before; nothing at the first.
    pub before: Option<Content>,
    /// What there is then.
    pub value: Content,
}

impl fmt::Display for Met {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.before {
            Some(before) => write!(f, "{before} → {}", self.value),
            None => write!(f, "{}", self.value),
        }
    }
}

/// What is looked at, delivery by delivery.
type Look = Box<dyn Fn(&Delivery<'_>) -> Option<Content> + Send + Sync>;

/// The value at a path of a tree; `Untold` where nothing stands there.
fn standing(content: &Content, path: &str) -> Content {
    content.at(path).cloned().unwrap_or_default()
}

/// Parts of a recording that are searched beside each other, for each thread: so that none waits long for another.
const PARTS_PER_THREAD: usize = 4;

/// A stretch of a recording: from a snapshot, or the start, up to a place, or the end.
struct Part {
    from: Option<Arc<Snapshot>>,
    /// What has been delivered at its end.
    end: Vec<u64>,
}

/// All places where a condition comes to hold, in the order of the actor's deliveries.
///
/// Where snapshots are kept all along the recording, its parts are searched beside each other; where a number that never
/// falls passes a bound, only the part is searched in which it does. Else all of it is replayed, and leaves snapshots.
///
/// # Errors
/// If the recording has no such actor, object or pixel, no state ever has such a path, or the replay diverges.
pub fn when(source: &Source, condition: &Condition, workers: usize) -> Result<Vec<Met>, Failure> {
    let (actor, look) = looked_at(source, condition)?;
    let look: Arc<Look> = Arc::new(look);
    let values = match by_halves(source, condition, actor, &look) {
        Some(values) => values,
        None => match parts(source, workers) {
            Some(all) => beside(source, condition, actor, &look, &all, workers)?,
            None => seen_in_whole(source, condition, actor, &look, workers)?,
        },
    };
    if let Of::State(name, Test { path, .. }) | Of::Changes(name, path) = &condition.of
        && values.values().all(|value| *value == Content::Untold)
    {
        return Err(Failure::Usage(format!(
            "nothing ever stands at {name}.{path}; `--state {name:?}` shows what does"
        )));
    }
    Ok(met(source, condition, actor, values))
}

/// All deliveries of a recording.
fn whole(source: &Source) -> Vec<u64> {
    let nodes = 0..source.trace.header().nodes.len() as u32;
    nodes.map(|number| source.trace.deliveries(ActorId(number))).collect()
}

/// Puts what is looked at into a queue.
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
) -> Result<BTreeMap<u64, Content>, Failure> {
    let mut values: BTreeMap<u64, Content> = std::iter::from_fn(|| queue.pop()).collect();
    if matches!(condition.of, Of::Hears(..)) {
        return Ok(values);
    }
    // What was seen before a delivery is what the one before left; the last one's is still to be seen.
    let last = match &condition.of {
        Of::State(_, Test { path, .. }) | Of::Changes(_, path) => {
            runtime.content(actor).map(|content| standing(&content, path))
        }
        Of::Pixel(x, y) => runtime.inspect(actors.renderer, |r| pixel(r, *x, *y)).flatten(),
        Of::Loses(name) => {
            let object = object(ground, name)?;
            let ager = actors.correction.as_ref().map(|correction| correction.cache_ager);
            ager.and_then(|ager| runtime.inspect(ager, |ager| samples_of(ager, object)))
        }
        Of::Hears(..) => None,
    };
    values.extend(last.map(|value| (end, value)));
    Ok(values.into_iter().filter_map(|(index, value)| Some((index.checked_sub(1)?, value))).collect())
}

fn seen_in_whole(
    source: &Source,
    condition: &Condition,
    actor: ActorId,
    look: &Arc<Look>,
    workers: usize,
) -> Result<BTreeMap<u64, Content>, Failure> {
    let queue = Arc::default();
    let how = How { threads: workers, observer: Some(observer(&queue, actor, look)), ..How::default() };
    let (mut runtime, actors) = source.run(how, |_| ())?;
    if let Some(divergence) = runtime.replay_report().divergence {
        return Err(Failure::Check(format!("the replay diverges: {divergence}")));
    }
    runtime.positions();
    let end = source.trace.deliveries(actor);
    collect(source, condition, actor, &queue, (&runtime, &actors), end)
}

/// What is seen in a part. `None` where it cannot be replayed from its snapshot.
fn seen_in(
    ground: &Ground,
    condition: &Condition,
    actor: ActorId,
    look: &Arc<Look>,
    part: &Part,
) -> Option<BTreeMap<u64, Content>> {
    let queue = Arc::default();
    let how =
        How { from: part.from.clone(), observer: Some(observer(&queue, actor, look)), ..How::default() };
    let (mut runtime, actors) = ground.system(how).ok()?;
    if !runtime.run_to(&part.end) || runtime.diverged() {
        return None;
    }
    let end = part.end[actor.0 as usize];
    collect(ground, condition, actor, &queue, (&runtime, &actors), end).ok()
}

/// The parts between the snapshots that are kept, about as many as keep all threads busy; none where there are too few.
fn parts(source: &Source, workers: usize) -> Option<Vec<Part>> {
    let (places, end) = (source.places(), whole(source));
    let count = workers.max(1) * PARTS_PER_THREAD;
    if workers < 2 || places.len() < count {
        return None;
    }
    let progress = |place: &[u64]| place.iter().sum::<u64>();
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
    let part = |(begin, end): (Vec<u64>, Vec<u64>)| {
        let from = if progress(&begin) == 0 { None } else { Some(source.at_place(&begin)?) };
        Some(Part { from, end })
    };
    begins.into_iter().zip(ends).map(part).collect()
}

/// What is seen in all parts, each replayed on a thread of its own.
fn beside(
    source: &Source,
    condition: &Condition,
    actor: ActorId,
    look: &Arc<Look>,
    parts: &[Part],
    workers: usize,
) -> Result<BTreeMap<u64, Content>, Failure> {
    let ground: &Ground = source;
    let next = AtomicUsize::new(0);
    let found = std::thread::scope(|scope| {
        let work = || {
            let mut found = Vec::new();
            while let Some(part) = parts.get(next.fetch_add(1, Ordering::Relaxed)) {
                if interrupted() {
                    break;
                }
                found.push(seen_in(ground, condition, actor, look, part));
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
    match found.into_iter().collect::<Option<Vec<_>>>() {
        Some(found) => Ok(found.into_iter().flatten().collect()),
        // A snapshot may be at fault.
        None => seen_in_whole(source, condition, actor, look, workers),
    }
}

/// What is seen in the part in which a number that never falls passes a bound, found by halves. `None` where the condition
/// does not ask for that, or what is kept does not do.
fn by_halves(
    source: &Source,
    condition: &Condition,
    actor: ActorId,
    look: &Arc<Look>,
) -> Option<BTreeMap<u64, Content>> {
    let Of::State(_, test) = &condition.of else { return None };
    let grows = matches!(test.comparison, Comparison::More | Comparison::AtLeast);
    let counts = COUNTERS.contains(&(source.name(actor), test.path.as_str()));
    let places = source.places();
    if !grows || !counts || places.is_empty() {
        return None;
    }
    // Snapshots at which it does not hold yet.
    let name = source.name(actor);
    let holds = |place: &Vec<u64>| {
        let number = source.counts_at(place).and_then(|counts| counts.at(name, &test.path));
        number.is_some_and(|number| test.holds(&Content::Count(number)))
    };
    let below = places.partition_point(|place| !holds(place));
    let from = match below.checked_sub(1) {
        Some(last) => Some(source.at_place(&places[last])?),
        None => None,
    };
    let end = places.get(below).cloned().unwrap_or_else(|| whole(source));
    seen_in(source, condition, actor, look, &Part { from, end })
}

/// Where a condition comes to hold, of the values that were seen.
fn met(source: &Source, condition: &Condition, actor: ActorId, values: BTreeMap<u64, Content>) -> Vec<Met> {
    let is_message = matches!(condition.of, Of::Hears(..));
    let mut met = Vec::new();
    let mut before: Option<Content> = None;
    for (index, value) in values {
        let comes_about = match &condition.of {
            Of::Hears(..) => true,
            Of::State(_, test) => {
                test.holds(&value) && !before.as_ref().is_some_and(|before| test.holds(before))
            }
            Of::Changes(..) | Of::Pixel(..) => before.as_ref().is_some_and(|before| *before != value),
            Of::Loses(_) => match (before.as_ref().and_then(Content::number), value.number()) {
                (Some(before), Some(now)) => now < before,
                _ => false,
            },
        };
        if comes_about {
            let before = before.clone().filter(|_| !is_message);
            let shown = || source.shown_in.partition_point(|shown| *shown < index) as u32;
            let frame = (actor == source.renderer()).then(shown);
            met.push(Met { at: (actor, index), frame, before, value: value.clone() });
        }
        before = Some(value);
    }
    met
}

/// Whose deliveries are looked at, and what at each of them.
fn looked_at(source: &Source, condition: &Condition) -> Result<(ActorId, Look), Failure> {
    Ok(match &condition.of {
        Of::State(name, Test { path, .. }) | Of::Changes(name, path) => {
            let path = path.clone();
            // An order to the runtime shows nothing of the actor.
            let look = move |d: &Delivery<'_>| match (d.state)() {
                Content::Untold => None,
                state => Some(standing(&state, &path)),
            };
            (source.actor(name)?, Box::new(look))
        }
        Of::Hears(name, kind, test) => {
            let (kind, test) = (kind.clone(), test.clone());
            let look = move |d: &Delivery<'_>| {
                if d.kind != kind {
                    return None;
                }
                let told = (d.told)();
                let holds =
                    test.as_ref().is_none_or(|test| told.at(&test.path).is_some_and(|v| test.holds(v)));
                holds.then_some(told)
            };
            (source.actor(name)?, Box::new(look))
        }
        Of::Pixel(x, y) => {
            let (x, y) = (*x, *y);
            let settings = &source.recorded.settings;
            if x >= settings.width || y >= settings.height {
                let size = format!("{} × {}", settings.width, settings.height);
                return Err(Failure::Usage(format!("no pixel {x},{y}; the picture has {size}")));
            }
            let look = move |d: &Delivery<'_>| pixel(d.receiver.downcast_ref::<Renderer>()?, x, y);
            (source.renderer(), Box::new(look))
        }
        Of::Loses(name) => {
            let object = object(source, name)?;
            let look =
                move |d: &Delivery<'_>| Some(samples_of(d.receiver.downcast_ref::<CacheAger>()?, object));
            (source.actor("cache ager")?, Box::new(look))
        }
    })
}

/// What is shown at a pixel, sRGB bytes; nothing before the first frame.
fn pixel(renderer: &Renderer, x: u32, y: u32) -> Option<Content> {
    renderer.shown().map(|shown| Content::of(&shown.rgb8.at(x as usize, y as usize)))
}

fn samples_of(ager: &CacheAger, object: u32) -> Content {
    Content::of(&ager.samples_of(object))
}

/// An object's number by its name.
fn object(source: &Ground, name: &str) -> Result<u32, Failure> {
    let objects = &source.world().scene.objects;
    objects.iter().position(|object| object.name == name).map(|id| id as u32).ok_or_else(|| {
        let mut names: Vec<&str> =
            objects.iter().map(|o| o.name.as_str()).filter(|n| !n.is_empty()).collect();
        names.truncate(20);
        Failure::Usage(format!("no object {name:?}; the scene has {}", names.join(", ")))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::Elsewhere;
    use foveal_runtime::{Limit, Until};
    use std::path::Path;

    fn kept(name: &str) -> Source {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../traces").join(name);
        Source::open(&path, &Elsewhere::default(), true, &()).expect("a walk")
    }

    fn places(source: &Source, text: &str) -> Vec<Met> {
        when(source, &Condition::parse(text).expect(text), 1).expect(text)
    }

    /// A condition on a state holds where the state, asked for there, says so, and did not one delivery before.
    #[test]
    fn states_hold_from_where_they_are_found_on() {
        let source = kept("gallery.fvl");
        let renderer = source.renderer();
        let view = |index: u64| {
            let until = Some(Until::Delivery { actor: renderer, index });
            let (mut runtime, _) = source.system(How { until, ..How::default() }).expect("a system");
            runtime.pump(foveal_runtime::Limit::IDLE);
            runtime.content(renderer).and_then(|c| c.at("view").and_then(Content::number)).expect("a view")
        };
        let met = places(&source, "renderer.view >= 3");
        let [first] = &met[..] else { panic!("once: {met:?}") };
        assert!(view(first.at.1) >= 3.0 && view(first.at.1 - 1) < 3.0);
        let changes = places(&source, "renderer.view changes");
        assert!(changes.iter().any(|met| met.at == first.at), "{changes:?}");
        // A view begins with a frame whose camera has moved.
        let frames = places(&source, "renderer hears FrameBegan");
        assert!(changes.iter().all(|met| frames.iter().any(|frame| frame.at == met.at)));
    }

    #[test]
    fn messages_are_found_by_kind_and_content() {
        let source = kept("table.fvl");
        let all = places(&source, "allocator hears JobDone");
        let many = places(&source, "allocator hears JobDone samples > 20");
        assert!(!many.is_empty() && many.len() < all.len());
        let samples = |met: &Met| met.value.at("samples").and_then(Content::number).expect("a number");
        assert_eq!(all.iter().filter(|met| samples(met) > 20.0).count(), many.len());
    }

    #[test]
    fn pixels_change_where_frames_are_shown() {
        let source = kept("gallery.fvl");
        let met = places(&source, "pixel 32,24 changes");
        assert!(!met.is_empty());
        for Met { at, before, value, .. } in &met {
            assert!(source.shown_in.contains(&at.1) && before.as_ref() != Some(value));
        }
    }

    #[test]
    fn what_is_not_there_is_named() {
        let source = kept("table.fvl");
        for (text, says) in [
            ("allocator.nothing > 1", "nothing ever stands"),
            ("nobody.x > 1", "no actor"),
            ("pixel 9999,0 changes", "no pixel"),
            ("object \"Nobody\" loses samples", "no object"),
        ] {
            let condition = Condition::parse(text).expect(text);
            let failure = when(&source, &condition, 1).expect_err(text).to_string();
            assert!(failure.contains(says), "{text}: {failure}");
        }
    }

    /// Leaves a snapshot after each so many deliveries of the renderer, in a folder of its own.
    fn with_snapshots(name: &str, folder: &Path, every: usize) -> Source {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../traces").join(name);
        let elsewhere = Elsewhere { cache: Some(folder.to_owned()), ..Elsewhere::default() };
        let source = Source::open(&path, &elsewhere, true, &()).expect("a walk");
        let renderer = source.renderer();
        for index in (0..source.trace.deliveries(renderer)).step_by(every) {
            let until = Some(Until::Delivery { actor: renderer, index });
            let (mut runtime, _) = source.system(How { until, ..How::default() }).expect("a system");
            runtime.pump(Limit::IDLE);
            source.keep(&mut runtime);
        }
        source
    }

    /// By halves, in parts and as a whole, the same is found.
    #[test]
    fn snapshots_change_nothing_but_how_long_it_takes() {
        let folders = [(); 2].map(|()| tempfile::tempdir().expect("a folder"));
        let kept = with_snapshots("gallery.fvl", folders[0].path(), 3);
        let bare = with_snapshots("gallery.fvl", folders[1].path(), usize::MAX >> 1);
        assert!(parts(&kept, 2).is_some_and(|parts| parts.len() >= 4), "{} places", kept.places().len());
        assert!(parts(&bare, 2).is_none());
        for text in [
            "renderer.view > 3",
            "renderer.view >= 1",
            "renderer.view > 1000",
            "allocator.begun >= 2",
            "renderer.view changes",
            "renderer.counts.traced > 0",
            "cache ager.samples changes",
            "allocator hears JobDone samples > 10",
            "pixel 32,24 changes",
        ] {
            let condition = Condition::parse(text).expect(text);
            let [a, b] = [&kept, &bare].map(|source| when(source, &condition, 2).expect(text));
            assert_eq!(a, b, "{text}");
        }
        for text in ["renderer.view > 3", "renderer.view >= 1", "renderer.view > 1000"] {
            let condition = Condition::parse(text).expect(text);
            let (actor, look) = looked_at(&kept, &condition).expect(text);
            let seen = by_halves(&kept, &condition, actor, &Arc::new(look)).expect(text);
            assert!((seen.len() as u64) < kept.trace.deliveries(actor) / 2, "{text}: {}", seen.len());
        }
    }

    /// What is found by halves never falls, in any of the kept walks.
    #[test]
    fn counters_never_fall() {
        for name in ["box.fvl", "duck.fvl", "gallery.fvl", "table.fvl"] {
            let source = kept(name);
            for (actor, path) in COUNTERS {
                if source.trace.find(actor).is_none() {
                    continue;
                }
                for met in places(&source, &format!("{actor}.{path} changes")) {
                    let [before, now] =
                        [met.before.as_ref(), Some(&met.value)].map(|value| value.and_then(Content::number));
                    assert!(before.is_none() || before <= now, "{name}, {actor}.{path}: {met}");
                }
            }
        }
    }
}
