//! An engine on a thread of its own, for a door that many come through: commands in, the newest picture out.
//!
//! [`Engine`](crate::Engine) belongs to the thread that began it. [`EngineThread`] is that thread: it drives a
//! [`Walk`] as the window does, looks at its commands between slices of work, and leaves what is new where whoever holds an
//! [`EngineHandle`] finds it. Nothing waits for a reader: of pictures only the newest is kept, commands beyond the queue's
//! length are refused.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{JoinHandle, Thread};
use std::time::{Duration, Instant};

use crossbeam_queue::ArrayQueue;
use foveal::image::Map2d;
use foveal::scene::Camera;
use foveal_actors::insight::Insight;

use crate::controls::Value;
use crate::failure::Failure;
use crate::source::{Controls, FrameSource, Names, Place, Ranges, Status, TimelineShown, Wish};
use crate::walk::{Act, Next, Notice, Walk};

/// Commands that may wait: what hands do in seconds, should a frame take that long.
const COMMANDS: usize = 4096;
/// Lines for people, and screenshots, that may wait.
const SAID: usize = 64;
/// Shortest time between two reports, but for news that nobody wants to wait for.
const REPORT: Duration = Duration::from_millis(250);

/// What a walk is told.
#[derive(Clone, Debug, PartialEq)]
pub enum Command {
    /// The user did something at this time, seconds since the start.
    Act {
        /// What.
        act: Act,
        /// When: [`EngineHandle::now`].
        at: f64,
        /// Found again in the first picture that knows of it: [`Shown::mark`].
        mark: f64,
    },
    /// A control is set.
    Put {
        /// Its name.
        key: String,
        /// Its value.
        value: Value,
    },
    /// Something is wanted of a recording.
    Wish(Wish),
    /// The picture on show is wanted, with the facts of its making.
    Shot {
        /// Found again in the [`Shot`].
        tag: u64,
    },
    /// Nobody looks: no more frames.
    Pause,
    /// Somebody looks again.
    Resume,
}

/// What a walk says once, when it begins.
#[derive(Clone, Debug)]
pub struct Opening {
    /// The scene.
    pub place: Place,
    /// Columns and rows of its pictures.
    pub size: [u32; 2],
    /// How far controls go.
    pub ranges: Ranges,
    /// What they begin with.
    pub controls: Controls,
}

/// The newest picture, and how the walk stands.
#[derive(Clone, Debug)]
pub struct Shown {
    /// Number of the picture, from 1; the same as long as that is.
    pub number: u64,
    /// The picture, tone-mapped, with its overlay.
    pub picture: Arc<Map2d<[u8; 3]>>,
    /// Where it is seen from; nothing where it is of a recording.
    pub camera: Option<Camera>,
    /// The newest mark of an act that had been done when its frame began.
    pub mark: Option<f64>,
    /// It is what a still view converges to, or is refined to, each bit of it; of a recording that does not play, what that
    /// showed.
    pub exact: bool,
    /// The camera moves.
    pub moving: bool,
    /// How the walk stands.
    pub report: Arc<Report>,
}

/// How a walk stands.
#[derive(Clone, Debug)]
pub struct Report {
    /// What is set.
    pub controls: Controls,
    /// Views, samples, actors.
    pub status: Status,
    /// Median and 99th percentile of the time of a frame, seconds.
    pub times: Option<(f32, f32)>,
    /// Estimated quality of the picture.
    pub quality: Option<f32>,
    /// Speed of walking, scene units per second.
    pub speed: f32,
    /// Whether dragging turns about the middle.
    pub orbits: bool,
    /// What the allocator thought last, and names of objects and textures.
    pub insight: Option<(Insight, Arc<Names>)>,
    /// The timeline of a recording, and whether it plays.
    pub timeline: Option<(TimelineShown, bool)>,
}

/// A picture that was asked for.
#[derive(Clone, Debug)]
pub struct Shot {
    /// Who asked.
    pub tag: u64,
    /// The picture.
    pub picture: Arc<Map2d<[u8; 3]>>,
    /// Names and values that say how it came to be.
    pub facts: Vec<(String, String)>,
}

/// What the thread and its handles share.
struct Shared {
    start: Instant,
    commands: ArrayQueue<Command>,
    newest: ArrayQueue<Arc<Shown>>,
    notices: ArrayQueue<Notice>,
    shots: ArrayQueue<Shot>,
    /// It is to end.
    ends: AtomicBool,
    /// It has ended.
    over: AtomicBool,
    wake: Box<dyn Fn() + Send + Sync>,
}

/// A walk on a thread of its own. Dropped, it ends.
pub struct EngineThread {
    opening: Opening,
    handle: EngineHandle,
    join: Option<JoinHandle<Result<(), String>>>,
}

/// Tells a walk on another thread what to do, and sees what it shows.
#[derive(Clone)]
pub struct EngineHandle {
    shared: Arc<Shared>,
    thread: Thread,
}

impl EngineThread {
    /// Makes a walk on a thread of its own and waits until it stands. `wake` is called on that thread whenever there is
    /// something new, and must not wait for anything.
    ///
    /// # Errors
    /// If the walk cannot be made, or its thread cannot be started.
    pub fn spawn<M, W>(make: M, wake: W) -> Result<Self, Failure>
    where
        M: FnOnce() -> Result<Box<dyn FrameSource>, Failure> + Send + 'static,
        W: Fn() + Send + Sync + 'static,
    {
        let shared = Arc::new(Shared {
            start: Instant::now(),
            commands: ArrayQueue::new(COMMANDS),
            newest: ArrayQueue::new(1),
            notices: ArrayQueue::new(SAID),
            shots: ArrayQueue::new(SAID),
            ends: AtomicBool::new(false),
            over: AtomicBool::new(false),
            wake: Box::new(wake),
        });
        let (stands, standing) = std::sync::mpsc::sync_channel(1);
        let inside = Arc::clone(&shared);
        let failed = |e: &dyn std::fmt::Display| Failure::Environment(format!("the walk has no thread: {e}"));
        let join = std::thread::Builder::new()
            .name("engine".into())
            .spawn(move || {
                // Also where it panics.
                let over = Over(inside);
                let source = match make() {
                    Ok(source) => source,
                    Err(e) => {
                        let _ = stands.send(Err(e));
                        return Ok(());
                    }
                };
                let mut walk = Walk::new(source, over.0.now());
                let _ = stands.send(Ok(Opening {
                    place: walk.place().clone(),
                    size: walk.size(),
                    ranges: walk.ranges(),
                    controls: *walk.controls(),
                }));
                drop(stands);
                Inside::new(&over.0).run(&mut walk)
            })
            .map_err(|e| failed(&e))?;
        let handle = EngineHandle { shared, thread: join.thread().clone() };
        match standing.recv() {
            Ok(Ok(opening)) => Ok(Self { opening, handle, join: Some(join) }),
            Ok(Err(failure)) => Err(failure),
            Err(e) => Err(failed(&e)),
        }
    }

    /// What it said when it began.
    pub fn opening(&self) -> &Opening {
        &self.opening
    }

    /// A way to talk to it.
    pub fn handle(&self) -> &EngineHandle {
        &self.handle
    }

    /// Ends the walk, and its recording with it, and waits for that.
    ///
    /// # Errors
    /// Why it had ended before, if it had.
    pub fn end(mut self) -> Result<(), String> {
        self.join_it()
    }

    fn join_it(&mut self) -> Result<(), String> {
        self.handle.shared.ends.store(true, Ordering::Release);
        self.handle.thread.unpark();
        match self.join.take().map(JoinHandle::join) {
            Some(Ok(ended)) => ended,
            Some(Err(_)) => Err("the walk panicked".into()),
            None => Ok(()),
        }
    }
}

impl Drop for EngineThread {
    fn drop(&mut self) {
        let _ = self.join_it();
    }
}

impl EngineHandle {
    /// Seconds since the walk's start.
    pub fn now(&self) -> f64 {
        self.shared.now()
    }

    /// Tells the walk something. Gives it back where too much waits already.
    ///
    /// # Errors
    /// The command, which nobody will hear.
    pub fn send(&self, command: Command) -> Result<(), Command> {
        self.shared.commands.push(command)?;
        self.thread.unpark();
        Ok(())
    }

    /// The newest picture, once.
    pub fn shown(&self) -> Option<Arc<Shown>> {
        self.shared.newest.pop()
    }

    /// The next line for people.
    pub fn notice(&self) -> Option<Notice> {
        self.shared.notices.pop()
    }

    /// The next picture that was asked for.
    pub fn shot(&self) -> Option<Shot> {
        self.shared.shots.pop()
    }

    /// Whether nothing more will come.
    pub fn is_over(&self) -> bool {
        self.shared.over.load(Ordering::Acquire)
    }
}

impl Shared {
    fn now(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }
}

/// Says that the thread has ended, however it did.
struct Over(Arc<Shared>);

impl Drop for Over {
    fn drop(&mut self) {
        self.0.over.store(true, Ordering::Release);
        (self.0.wake)();
    }
}

/// The thread's side.
struct Inside<'s> {
    shared: &'s Shared,
    /// What was published last, and when its report was made.
    shown: Option<(Arc<Shown>, f64)>,
    /// Mark of the last act; the same as it was when the frame began, and of the frame on show.
    mark: Option<f64>,
    frame_mark: Option<f64>,
    shown_mark: Option<f64>,
    paused: bool,
    names: Option<Arc<Names>>,
}

impl<'s> Inside<'s> {
    fn new(shared: &'s Shared) -> Self {
        Self {
            shared,
            shown: None,
            mark: None,
            frame_mark: None,
            shown_mark: None,
            paused: false,
            names: None,
        }
    }

    fn run(mut self, walk: &mut Walk) -> Result<(), String> {
        while !self.shared.ends.load(Ordering::Acquire) {
            while let Some(command) = self.shared.commands.pop() {
                self.obey(walk, command);
            }
            if self.paused {
                std::thread::park();
                continue;
            }
            let now = self.shared.now();
            let was_in_frame = walk.is_in_frame();
            let (is_new, next) = walk.tick(now);
            if !was_in_frame && walk.is_in_frame() {
                self.frame_mark = self.mark;
            }
            if is_new {
                self.shown_mark = self.frame_mark;
            }
            if let Some(why) = walk.ended() {
                self.say(Notice { text: why.clone(), failed: true });
                return Err(why);
            }
            self.publish(walk, is_new, next == Next::Input);
            match next {
                Next::Now => {}
                Next::At(at) => {
                    std::thread::park_timeout(Duration::from_secs_f64((at - now).clamp(0.0, 1.0)))
                }
                Next::Input => std::thread::park(),
            }
        }
        Ok(())
    }

    fn obey(&mut self, walk: &mut Walk, command: Command) {
        match command {
            Command::Act { act, at, mark } => {
                self.mark = Some(mark);
                // What comes from outside may be late, never of the future.
                walk.act(act, at.min(self.shared.now()));
            }
            Command::Put { key, value } => {
                let mut controls = *walk.controls();
                match controls.put(&key, &value, &walk.ranges()) {
                    Ok(()) => walk.set_controls(controls),
                    Err(e) => walk.complain(e.to_string()),
                }
            }
            Command::Wish(wish) => walk.wish(wish, self.shared.now()),
            Command::Shot { tag } => {
                let facts = walk.facts(self.shared.now());
                if let Some(picture) = walk.picture() {
                    let picture = Arc::new(picture.clone());
                    let _ = self.shared.shots.force_push(Shot { tag, picture, facts });
                    (self.shared.wake)();
                }
            }
            Command::Pause => self.paused = true,
            Command::Resume => self.paused = false,
        }
    }

    fn say(&self, notice: Notice) {
        self.shared.notices.force_push(notice);
        (self.shared.wake)();
    }

    /// Leaves what is new for whoever looks. `rests`: nothing more comes until somebody does something.
    fn publish(&mut self, walk: &mut Walk, is_new: bool, rests: bool) {
        if let Some(notice) = walk.notice.take() {
            self.say(notice);
        }
        let camera = walk.camera().copied();
        let now = self.shared.now();
        let before = self.shown.as_ref().map(|(shown, _)| shown);
        let is_set = before.is_none_or(|b| b.report.controls != *walk.controls());
        let pressing = rests || is_set;
        let is_due = self.shown.as_ref().is_none_or(|(_, at)| now - at >= REPORT.as_secs_f64());
        if !is_new && !pressing && !is_due {
            return;
        }
        let Some(picture) = walk.picture() else { return };
        // Frames of a view that has converged are the same.
        let same = before.filter(|b| b.picture.data() == picture.data());
        let status = walk.status();
        let exact = match walk.timeline() {
            Some((_, plays)) => !plays,
            None => status.converged && walk.shows_all() && !walk.is_in_frame(),
        };
        let (number, kept) = match same {
            Some(before) => (before.number, Arc::clone(&before.picture)),
            None => (before.map_or(0, |b| b.number) + 1, Arc::new(picture.clone())),
        };
        // Whoever looks later still finds that an equal picture was exact.
        let exact = exact || same.is_some_and(|b| b.exact && b.camera == camera);
        let moving = walk.is_moving() && walk.timeline().is_none();
        let was = before.map(|b| (b.number, b.exact, b.moving, b.mark));
        let news = was != Some((number, exact, moving, self.shown_mark));
        let state = |status: &Status| (status.converged, status.refined, status.lit);
        let is_due = is_due || pressing || before.is_none_or(|b| state(&b.report.status) != state(&status));
        if !news && !is_due {
            return;
        }
        let (report, at) = match &self.shown {
            Some((before, at)) if !is_due => (Arc::clone(&before.report), *at),
            _ => (Arc::new(self.report(walk, status)), now),
        };
        let shown =
            Arc::new(Shown { number, picture: kept, camera, mark: self.shown_mark, exact, moving, report });
        self.shown = Some((Arc::clone(&shown), at));
        self.shared.newest.force_push(shown);
        (self.shared.wake)();
    }

    fn report(&mut self, walk: &Walk, status: Status) -> Report {
        let insight = walk.insight().map(|(insight, names)| {
            let names = self.names.get_or_insert_with(|| Arc::new(names.clone()));
            (insight.clone(), Arc::clone(names))
        });
        Report {
            controls: *walk.controls(),
            status,
            times: walk.times.median_p99(),
            quality: walk.quality(),
            speed: walk.navigator.speed(),
            orbits: walk.navigator.orbits(),
            insight,
            timeline: walk.timeline(),
        }
    }
}

#[cfg(test)]
#[path = "thread_tests.rs"]
mod tests;
