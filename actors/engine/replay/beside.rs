//! A recording that is looked at, on a thread of its own: whoever shows it never waits for a replay. What is asked for
//! comes when it is there, of several frames the newest; while nothing is, the thread replays on and leaves snapshots, so
//! that what is asked for later comes at once.

use std::cell::Cell;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_queue::{ArrayQueue, SegQueue};
use foveal::image::Map2d;
use foveal::scene::Camera;
use foveal_actors::insight::Insight;

use super::player::{Player, Way};
use super::source::Source;
use crate::engine::Event;
use crate::failure::Failure;
use crate::source::{Branch, Controls, FrameSource, Names, Place, Ranges, Status, Timeline, TimelineShown};

/// What is asked of the thread.
enum Wish {
    Frame(u32),
    Next,
    Messages(i64),
    Why(u32, u32),
    Find(String),
    Place(String),
    State(String),
    Lanes(bool),
    Controls(Controls),
}

/// What it shows.
struct PlayerState {
    timeline: TimelineShown,
    picture: Option<Map2d<[u8; 3]>>,
    insight: Option<Insight>,
    status: Status,
    facts: Vec<(String, String)>,
    way: Result<Way, String>,
    /// Whether there is a frame after it.
    goes_on: bool,
    /// Wishes that were done by then.
    done: u64,
}

#[derive(Default)]
struct Asked {
    wishes: SegQueue<Wish>,
    ends: AtomicBool,
}

impl Asked {
    fn is_waiting(&self) -> bool {
        !self.wishes.is_empty() || self.ends.load(Ordering::Acquire)
    }
}

/// A recording that is looked at from another thread than the one that replays it.
pub struct Beside {
    asked: Arc<Asked>,
    newest: Arc<ArrayQueue<PlayerState>>,
    thread: Option<JoinHandle<()>>,
    shown: PlayerState,
    /// Wishes so far.
    wishes: Cell<u64>,
    /// The last frame that was asked for, and which wish that was.
    wanted: (u64, u32),
    place: Place,
    size: [u32; 2],
    ranges: Ranges,
    controls: Controls,
    names: Names,
}

impl Beside {
    /// At its first frame. Waits until that is there.
    ///
    /// # Errors
    /// If it cannot be replayed, or no thread can be had.
    pub fn new(source: Source, workers: usize) -> Result<Self, Failure> {
        Self::recorded_into(source, workers, None)
    }

    /// The same, where walks that leave it are recorded into `file`.
    ///
    /// # Errors
    /// If it cannot be replayed, or no thread can be had.
    pub fn recorded_into(source: Source, workers: usize, file: Option<PathBuf>) -> Result<Self, Failure> {
        let (asked, newest) = (Arc::<Asked>::default(), Arc::new(ArrayQueue::new(1)));
        let begun = Arc::new(ArrayQueue::new(1));
        let thread = {
            let (asked, newest, begun) = (Arc::clone(&asked), Arc::clone(&newest), Arc::clone(&begun));
            let caller = std::thread::current();
            let work = move || {
                let player = Player::new(source, workers);
                let player = match player {
                    Ok(mut player) => {
                        player.record_into(file);
                        let first = shown(&mut player, 0, true);
                        let facts = (
                            player.place(),
                            player.size(),
                            player.ranges(),
                            player.controls(),
                            player.names(),
                        );
                        let _ = begun.push(Ok((first, facts)));
                        Some(player)
                    }
                    Err(e) => {
                        let _ = begun.push(Err(e));
                        None
                    }
                };
                caller.unpark();
                if let Some(player) = player {
                    serve(player, &asked, &newest);
                }
            };
            std::thread::Builder::new()
                .name("replay".into())
                .spawn(work)
                .map_err(|e| Failure::Environment(format!("no thread for the replay: {e}")))?
        };
        let (shown, (place, size, ranges, controls, names)) = loop {
            if let Some(begun) = begun.pop() {
                break begun?;
            }
            if thread.is_finished() && begun.is_empty() {
                return Err(Failure::Check("the replay ended before it began".into()));
            }
            std::thread::park_timeout(Duration::from_millis(100));
        };
        let (thread, wishes) = (Some(thread), Cell::new(0));
        Ok(Self {
            asked,
            newest,
            thread,
            shown,
            wishes,
            wanted: (0, 0),
            place,
            size,
            ranges,
            controls,
            names,
        })
    }

    fn ask(&self, wish: Wish) {
        self.wishes.set(self.wishes.get() + 1);
        self.asked.wishes.push(wish);
        if let Some(thread) = &self.thread {
            thread.thread().unpark();
        }
    }
}

impl Drop for Beside {
    /// What the thread has in hand ends by itself: nobody waits for it.
    fn drop(&mut self) {
        self.asked.ends.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
        }
    }
}

fn shown(player: &mut Player, done: u64, goes_on: bool) -> PlayerState {
    PlayerState {
        picture: player.picture(),
        timeline: Timeline::shown(player),
        insight: player.insight().map(|(insight, _)| insight.clone()),
        status: player.status(),
        facts: player.facts(),
        way: player.way(),
        goes_on,
        done,
    }
}

/// Does what is asked for until that ends.
fn serve(mut player: Player, asked: &Asked, newest: &ArrayQueue<PlayerState>) {
    let (mut done, mut goes_on) = (0, true);
    let mut indexing = player.source().indexing();
    while !asked.ends.load(Ordering::Acquire) {
        let (mut frame, mut is_new) = (None, false);
        while let Some(wish) = asked.wishes.pop() {
            (done, is_new, goes_on) = (done + 1, true, true);
            if let Wish::Frame(wanted) = wish {
                // The newest of those that follow each other.
                frame = Some(wanted);
                continue;
            }
            if let Some(frame) = frame.take() {
                player.go_to(frame);
            }
            match wish {
                Wish::Frame(_) => {}
                Wish::Next => goes_on = player.next_frame(),
                Wish::Messages(messages) => player.step(messages),
                Wish::Why(x, y) => player.why(x, y),
                Wish::Find(condition) => player.find(&condition),
                Wish::Place(place) => player.go_to_place(&place),
                Wish::State(actor) => player.tell_state(&actor),
                Wish::Lanes(shows) => player.show_lanes(shows),
                Wish::Controls(controls) => player.set_controls(&controls),
            }
        }
        if let Some(frame) = frame {
            player.go_to(frame);
        }
        if is_new {
            newest.force_push(shown(&mut player, done, goes_on));
        } else if !indexing.go_on(player.source(), || asked.is_waiting()) && !asked.is_waiting() {
            std::thread::park_timeout(Duration::from_secs(1));
        }
    }
}

impl Timeline for Beside {
    /// As it will be once the frame that was asked for last is there: who steps on from it while it is being made loses no
    /// step.
    fn shown(&self) -> TimelineShown {
        let shown = self.shown.timeline.clone();
        let (wish, wanted) = self.wanted;
        if wish > self.shown.done && self.is_busy() {
            return TimelineShown { frame: Some(wanted.min(shown.frames.saturating_sub(1))), ..shown };
        }
        shown
    }

    fn go_to(&mut self, frame: u32) {
        self.ask(Wish::Frame(frame));
        self.wanted = (self.wishes.get(), frame);
    }

    /// Nothing more is asked for while the last frame is still being made.
    fn next_frame(&mut self) -> bool {
        if self.is_busy() {
            return true;
        }
        if self.shown.goes_on {
            self.ask(Wish::Next);
        }
        self.shown.goes_on
    }

    fn step(&mut self, messages: i64) {
        self.ask(Wish::Messages(messages));
    }

    fn why(&mut self, x: u32, y: u32) {
        self.ask(Wish::Why(x, y));
    }

    fn find(&mut self, condition: &str) {
        self.ask(Wish::Find(condition.to_owned()));
    }

    fn go_to_place(&mut self, place: &str) {
        self.ask(Wish::Place(place.to_owned()));
    }

    fn tell_state(&mut self, actor: &str) {
        self.ask(Wish::State(actor.to_owned()));
    }

    fn show_lanes(&mut self, shows: bool) {
        self.ask(Wish::Lanes(shows));
    }

    fn branch(&mut self) -> Result<Branch, String> {
        self.shown.way.clone()?.start(&self.controls)
    }
}

impl FrameSource for Beside {
    fn place(&self) -> Place {
        self.place.clone()
    }

    fn size(&self) -> [u32; 2] {
        self.size
    }

    fn controls(&self) -> Controls {
        self.controls
    }

    fn ranges(&self) -> Ranges {
        self.ranges
    }

    fn insight(&self) -> Option<(&Insight, &Names)> {
        self.shown.insight.as_ref().map(|insight| (insight, &self.names))
    }

    fn set_controls(&mut self, controls: &Controls) {
        self.controls = super::player::adopted(&self.controls, controls);
        self.ask(Wish::Controls(*controls));
    }

    fn begin_frame(&mut self, _camera: &Camera) {}

    fn work(&mut self, _time: Duration) {}

    fn end_frame(&mut self) -> Vec<Event> {
        Vec::new()
    }

    fn picture(&mut self) -> Option<Map2d<[u8; 3]>> {
        self.shown.picture.clone()
    }

    fn quality(&mut self) -> f32 {
        self.shown.insight.as_ref().map_or(f32::NEG_INFINITY, |insight| insight.quality)
    }

    fn is_done(&self) -> bool {
        true
    }

    fn is_busy(&self) -> bool {
        self.shown.done < self.wishes.get() && self.thread.as_ref().is_some_and(|t| !t.is_finished())
    }

    fn take_news(&mut self) -> bool {
        let Some(shown) = self.newest.pop() else { return false };
        self.shown = shown;
        true
    }

    fn ended(&self) -> Option<String> {
        let has_ended = self.thread.as_ref().is_none_or(JoinHandle::is_finished);
        has_ended.then(|| "the replay has failed".to_owned())
    }

    fn status(&self) -> Status {
        self.shown.status.clone()
    }

    fn facts(&self) -> Vec<(String, String)> {
        self.shown.facts.clone()
    }

    fn timeline(&self) -> Option<&dyn Timeline> {
        Some(self)
    }

    fn timeline_mut(&mut self) -> Option<&mut dyn Timeline> {
        Some(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::Elsewhere;
    use std::path::Path;

    fn source(cache: &Path) -> Source {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../traces/box.fvl");
        let elsewhere = Elsewhere { cache: Some(cache.to_owned()), ..Elsewhere::default() };
        Source::open(&path, &elsewhere, true, &()).expect("a walk")
    }

    fn wait(beside: &mut Beside) {
        while beside.is_busy() {
            std::thread::sleep(Duration::from_millis(1));
            beside.take_news();
        }
    }

    #[test]
    fn what_is_asked_for_comes_as_a_player_shows_it() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut player = Player::new(source(folder.path()), 2).expect("a player");
        let mut beside = Beside::new(source(folder.path()), 2).expect("a player beside");
        let frames = Timeline::shown(&player).frames;
        assert!(frames > 2);
        let mut alike = |beside: &mut Beside, frame: u32| {
            player.go_to(frame);
            assert_eq!(Timeline::shown(beside).frame, Some(frame));
            // Not printed: pictures are large.
            assert!(beside.picture() == player.picture(), "frame {frame}");
        };
        alike(&mut beside, 0);
        // Nobody waits, and of several frames the newest counts; steps go on from where the last one leads.
        for frame in 0..frames {
            let at = Timeline::shown(&beside).frame.expect("a frame");
            assert_eq!(at, frame.saturating_sub(1));
            beside.go_to(frame);
        }
        wait(&mut beside);
        alike(&mut beside, frames - 1);
        beside.go_to(1);
        beside.why(10, 10);
        wait(&mut beside);
        let shown = Timeline::shown(&beside);
        assert!(
            shown.frame == Some(1) && shown.story.iter().any(|line| line.contains("pixel 10,10")),
            "{shown:?}"
        );
        assert!(beside.next_frame(), "frame 2");
        wait(&mut beside);
        alike(&mut beside, 2);
        assert!(beside.branch().is_ok() && beside.ended().is_none());
    }
}
