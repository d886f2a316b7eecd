//! When something came about in a recording: conditions on messages, on the state of actors and on pixels.
//!
//! Deliveries are replayed and looked at on the way, each actor's on the thread that makes it: all of them, parts beside
//! each other, or those alone in which a counter passes a bound.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use bytesize::ByteSize;
use crossbeam_queue::SegQueue;
use foveal_actors::cache_ager::CacheAger;
use foveal_actors::renderer::Renderer;
use foveal_actors::wiring::Actors;
use foveal_runtime::{ActorId, Content, Delivery, Observer, Runtime, Snapshot};

use super::source::{Ground, How, Source};
use crate::failure::Failure;
use crate::interrupt::interrupted;

/// How conditions are written, for messages and help.
pub const GRAMMAR: &str = "`ACTOR.PATH < 3`, `ACTOR.PATH changes`, `ACTOR hears MESSAGE [PATH > 3]`, \
                           `pixel X,Y changes` or `object \"NAME\" loses samples`";

/// How two values are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Comparison {
    Less,
    AtMost,
    Equal,
    Different,
    AtLeast,
    More,
}

/// What a value is compared with.
#[derive(Clone, Debug, PartialEq)]
enum Bound {
    Number(f64),
    Name(String),
}

/// A comparison with what stands at a path.
#[derive(Clone, Debug, PartialEq)]
struct Test {
    path: String,
    comparison: Comparison,
    bound: Bound,
}

/// Something that may come about.
#[derive(Clone, Debug, PartialEq)]
pub struct Condition {
    of: Of,
}

#[derive(Clone, Debug, PartialEq)]
enum Of {
    /// An actor's state comes to hold it.
    State(String, Test),
    /// Something in an actor's state becomes another.
    Changes(String, String),
    /// An actor is told a message.
    Hears(String, String, Option<Test>),
    /// A pixel of the shown picture becomes another.
    Pixel(u32, u32),
    /// The cache holds fewer samples of an object than before.
    Loses(String),
}

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

impl Comparison {
    fn holds(self, order: Option<std::cmp::Ordering>) -> bool {
        let Some(order) = order else { return self == Self::Different };
        match self {
            Self::Less => order.is_lt(),
            Self::AtMost => order.is_le(),
            Self::Equal => order.is_eq(),
            Self::Different => order.is_ne(),
            Self::AtLeast => order.is_ge(),
            Self::More => order.is_gt(),
        }
    }
}

impl Test {
    /// `PATH OP VALUE`.
    fn parse(text: &str) -> Option<Self> {
        let at = text.find(['<', '>', '=', '!'])?;
        let (path, rest) = text.split_at(at);
        let (comparison, bound) = [
            ("<=", Comparison::AtMost),
            (">=", Comparison::AtLeast),
            ("==", Comparison::Equal),
            ("!=", Comparison::Different),
            ("<", Comparison::Less),
            (">", Comparison::More),
            ("=", Comparison::Equal),
        ]
        .into_iter()
        .find_map(|(sign, comparison)| Some((comparison, rest.strip_prefix(sign)?.trim())))?;
        if path.trim().is_empty() || bound.is_empty() {
            return None;
        }
        let bound = match (bound.parse::<f64>(), bound.parse::<ByteSize>()) {
            (Ok(number), _) => Bound::Number(number),
            (_, Ok(size)) => Bound::Number(size.as_u64() as f64),
            _ => Bound::Name(bound.trim_matches('"').to_owned()),
        };
        Some(Self { path: path.trim().to_owned(), comparison, bound })
    }

    /// Whether it holds for what stands there; where nothing does, nothing holds.
    fn holds(&self, value: &Content) -> bool {
        match (&self.bound, value) {
            (Bound::Number(bound), value) => {
                value.number().is_some_and(|number| self.comparison.holds(number.partial_cmp(bound)))
            }
            (Bound::Name(bound), Content::Name(name)) => {
                self.comparison.holds(Some(name.as_ref().cmp(bound)))
            }
            (Bound::Name(bound), Content::Text(text)) => self.comparison.holds(Some(text.cmp(bound))),
            (Bound::Name(bound), Content::Flag(flag)) => {
                self.comparison.holds(Some(flag.to_string().cmp(bound)))
            }
            _ => false,
        }
    }
}

/// `ACTOR.PATH`, where the actor's name may have blanks: paths have none.
fn of_actor(text: &str) -> Option<(String, String)> {
    let (actor, path) = text.trim().split_once('.')?;
    (!actor.is_empty() && !path.is_empty()).then(|| (actor.trim().to_owned(), path.trim().to_owned()))
}

impl Condition {
    /// Reads one.
    ///
    /// # Errors
    /// Says how conditions are written.
    pub fn parse(text: &str) -> Result<Self, String> {
        Self::read(text.trim()).map(|of| Self { of }).ok_or_else(|| {
            format!("`{text}` is no condition; write one as {GRAMMAR}; --state shows what can stand there")
        })
    }

    fn read(text: &str) -> Option<Of> {
        if let Some(rest) = text.strip_prefix("pixel ") {
            let (x, y) = rest.strip_suffix("changes")?.trim().split_once(',')?;
            return Some(Of::Pixel(x.trim().parse().ok()?, y.trim().parse().ok()?));
        }
        if let Some(rest) = text.strip_prefix("object ") {
            let name = rest.strip_suffix("samples")?.trim_end().strip_suffix("loses")?.trim();
            return Some(Of::Loses(name.trim_matches('"').to_owned()));
        }
        if let Some((actor, what)) = text.split_once(" hears ") {
            let (kind, test) = what.trim().split_once(' ').unwrap_or((what.trim(), ""));
            let test = if test.trim().is_empty() { None } else { Some(Test::parse(test)?) };
            return Some(Of::Hears(actor.trim().to_owned(), kind.to_owned(), test));
        }
        if let Some(place) = text.strip_suffix(" changes") {
            let (actor, path) = of_actor(place)?;
            return Some(Of::Changes(actor, path));
        }
        let test = Test::parse(text)?;
        let (actor, path) = of_actor(&test.path)?;
        Some(Of::State(actor, Test { path, ..test }))
    }
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

/// Numbers of a state that never fall: where such a one passes a bound is found by halves.
const COUNTERS: [(&str, &str); 6] = [
    ("renderer", "view"),
    ("allocator", "begun"),
    ("analyzer", "analyzed"),
    ("illuminator", "turns"),
    ("illuminator", "rounds"),
    ("illuminator", "published_in"),
];
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
    // Snapshots at which it does not hold, and those at which it does.
    let (mut below, mut above) = (0, places.len());
    while below < above {
        let middle = usize::midpoint(below, above);
        let from = Some(source.at_place(&places[middle])?);
        let (runtime, _) = source.system(How { from, ..How::default() }).ok()?;
        let state = runtime.content(actor)?;
        if test.holds(&standing(&state, &test.path)) {
            above = middle;
        } else {
            below = middle + 1;
        }
    }
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

    #[test]
    fn conditions_are_read() {
        for text in [
            "renderer.view < 3",
            "allocator.budget.textures<1MiB",
            "cache ager.samples changes",
            "renderer hears SamplesTraced",
            "allocator hears JobDone samples >= 10",
            "pixel 3, 4 changes",
            "object \"Mirror ball\" loses samples",
            "allocator.converged = true",
        ] {
            assert!(Condition::parse(text).is_ok(), "{text}");
        }
        let limit = Condition::parse("allocator.budget.textures < 1MiB").expect("a condition");
        let Of::State(actor, Test { path, comparison, bound }) = limit.of else { panic!("a state") };
        assert_eq!(
            (actor.as_str(), path.as_str(), comparison),
            ("allocator", "budget.textures", Comparison::Less)
        );
        assert_eq!(bound, Bound::Number(1_048_576.0));
        for text in
            ["", "renderer", "renderer.view", "< 3", "renderer. < 3", "pixel 3 changes", "a hears b < "]
        {
            assert!(Condition::parse(text).is_err(), "{text}");
        }
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
            source.keep(|| runtime.snapshot());
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
