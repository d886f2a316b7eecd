//! When something came about in a recording.
//!
//! Answered from what is kept of what actors were told and knew (`history`), or searched for (`search`).

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use foveal_actors::cache_ager::CacheAger;
use foveal_actors::renderer::Renderer;
use foveal_runtime::{ActorId, Content, Delivery};

use super::condition::{Of, Test};
use super::search::{Look, Search};
use super::source::{Ground, Source};
use crate::failure::Failure;

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

/// The value at a path of a tree; `Untold` where nothing stands there.
pub(super) fn standing(content: &Content, path: &str) -> Content {
    content.at(path).cloned().unwrap_or_default()
}

/// All places where a condition comes to hold, in the order of the actor's deliveries.
///
/// What a replay all along the recording has left tells it at once, but for pixels and for messages that are large and many.
/// Else it is searched for: where snapshots are kept all along the recording, in its parts beside each other; where a number
/// that never falls passes a bound, only in the part in which it does; where it is known when messages of that kind came,
/// only in parts in which they did. Else all of it is replayed, and leaves snapshots.
///
/// # Errors
/// If the recording has no such actor, object or pixel, no state ever has such a path, or the replay diverges.
pub fn when(source: &Source, condition: &Condition, workers: usize) -> Result<Vec<Met>, Failure> {
    let (actor, look) = looked_at(source, condition)?;
    let values = match told(source, condition, actor) {
        Some(values) => values,
        None => Search { source, condition, actor, look: Arc::new(look), workers }.values()?,
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

/// What is looked at, by the delivery that it came about in, from what is kept. `None` where that does not say.
fn told(source: &Source, condition: &Condition, actor: ActorId) -> Option<BTreeMap<u64, Content>> {
    let (mut history, deliveries) = (source.history(), source.trace.deliveries(actor));
    match &condition.of {
        Of::State(_, Test { path, .. }) | Of::Changes(_, path) => {
            history.left(actor, deliveries, |state| standing(state, path))
        }
        Of::Hears(_, kind, test) => {
            let heard = history.heard(actor, deliveries, kind)?;
            let holds = |told: &Content| holds_for(test.as_ref(), told);
            Some(heard.into_iter().filter(|(_, told)| holds(told)).collect())
        }
        Of::Loses(name) => {
            let path = format!("by_object.{}", object(source, name).ok()?);
            let samples = |state: &Content| state.at(&path).cloned().unwrap_or(Content::Count(0));
            history.left(actor, deliveries, samples)
        }
        Of::Pixel(..) => None,
    }
}

/// Whether a test holds for a message, where there is one.
fn holds_for(test: Option<&Test>, told: &Content) -> bool {
    test.is_none_or(|test| told.at(&test.path).is_some_and(|value| test.holds(value)))
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
                holds_for(test.as_ref(), &told).then_some(told)
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
pub(super) fn pixel(renderer: &Renderer, x: u32, y: u32) -> Option<Content> {
    renderer.shown().map(|shown| Content::of(&shown.rgb8.at(x as usize, y as usize)))
}

pub(super) fn samples_of(ager: &CacheAger, object: u32) -> Content {
    Content::of(&ager.samples_of(object))
}

/// An object's number by its name.
pub(super) fn object(source: &Ground, name: &str) -> Result<u32, Failure> {
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
    use crate::replay::How;
    use crate::replay::counters::COUNTERS;
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
            source.keep(&runtime);
        }
        source
    }

    const CONDITIONS: [&str; 18] = [
        "renderer.view > 3",
        "renderer.view >= 0",
        "renderer.view >= 1",
        "renderer.view > 1000",
        "allocator.begun >= 2",
        "renderer.view changes",
        "renderer.drawn changes",
        "renderer.counts.traced > 0",
        "allocator.objects changes",
        "allocator.in_flight < 2",
        "cache ager.samples changes",
        "tracer.outbox >= 0",
        "analyzer.analyzed != 3",
        "allocator hears JobDone",
        "allocator hears JobDone samples > 10",
        "renderer hears SamplesTraced tracer > 0",
        "object \"Mirror\" loses samples",
        "pixel 32,24 changes",
    ];

    /// By halves, in parts and as a whole, the same is found.
    #[test]
    fn snapshots_change_nothing_but_how_long_it_takes() {
        let folders = [(); 2].map(|()| tempfile::tempdir().expect("a folder"));
        let kept = with_snapshots("gallery.fvl", folders[0].path(), 3);
        let bare = with_snapshots("gallery.fvl", folders[1].path(), usize::MAX >> 1);
        fn search<'a>(source: &'a Source, condition: &'a Condition) -> Search<'a> {
            let (actor, look) = looked_at(source, condition).expect("a look");
            Search { source, condition, actor, look: Arc::new(look), workers: 2 }
        }
        let any = Condition::parse("renderer.view changes").expect("a condition");
        assert!(search(&kept, &any).parts().is_some_and(|parts| parts.len() >= 4));
        assert!(search(&bare, &any).parts().is_none());
        for text in CONDITIONS {
            let condition = Condition::parse(text).expect(text);
            // Searched for each time, whatever was kept of the search before.
            let [a, b] = [&kept, &bare].map(|source| {
                let search = search(source, &condition);
                met(source, &condition, search.actor, search.values().expect(text))
            });
            assert_eq!(a, b, "{text}");
        }
        for text in ["renderer.view > 3", "renderer.view >= 1", "renderer.view > 1000"] {
            let condition = Condition::parse(text).expect(text);
            let search = search(&kept, &condition);
            let seen = search.by_halves().expect(text);
            assert!((seen.len() as u64) < kept.trace.deliveries(search.actor) / 2, "{text}: {}", seen.len());
        }
    }

    /// What is kept of a replay says the same as a search, whoever left it: a replay for its sake, with or without
    /// snapshots on its way, or a search.
    #[test]
    fn what_is_kept_says_what_a_search_finds() {
        for name in ["gallery.fvl", "table.fvl"] {
            let bare = kept(name);
            let conditions: Vec<Condition> =
                CONDITIONS.iter().map(|text| Condition::parse(text).expect(text)).collect();
            let searched = |condition: &Condition| {
                let (actor, look) = looked_at(&bare, condition).ok()?;
                let search = Search { source: &bare, condition, actor, look: Arc::new(look), workers: 1 };
                Some(met(&bare, condition, actor, search.values().expect("values")))
            };
            let found: Vec<_> = conditions.iter().map(searched).collect();
            for way in 0..3 {
                let folder = tempfile::tempdir().expect("a folder");
                let source = with_snapshots(name, folder.path(), [usize::MAX >> 1, 3, 3][way]);
                match way {
                    0 => assert!(!source.indexing().go_on(&source, || false)),
                    1 => drop(places(&source, "pixel 1,1 changes")),
                    _ => {
                        let condition = Condition::parse("pixel 1,1 changes").expect("a condition");
                        when(&source, &condition, 2).expect("a search");
                    }
                }
                let path = &source.path;
                let elsewhere = Elsewhere { cache: Some(folder.path().to_owned()), ..Elsewhere::default() };
                let again = Source::open(path, &elsewhere, true, &()).expect("a walk");
                for source in [&source, &again] {
                    assert!(source.is_told(), "{name}, way {way}");
                    for (condition, found) in conditions.iter().zip(&found) {
                        let Ok((actor, _)) = looked_at(source, condition) else { continue };
                        let told = told(source, condition, actor);
                        if way > 0 && matches!(condition.of, Of::Pixel(..)) {
                            assert_eq!(told, None);
                        }
                        if let Some(values) = told {
                            let met = met(source, condition, actor, values);
                            assert_eq!(Some(met), *found, "{name}, way {way}: {condition:?}");
                        }
                    }
                }
            }
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
