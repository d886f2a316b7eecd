//! An engine on a thread of its own, for a door that many come through: commands in, the newest picture out.
//!
//! [`Engine`](crate::Engine) belongs to the thread that began it. [`EngineThread`] is that thread: it drives a
//! [`Walk`] as the window does, looks at its commands between slices of work, and leaves what is new where whoever holds an
//! [`EngineHandle`] finds it. Nothing waits for a reader: of pictures only the newest is kept, commands beyond the queue's
//! length are refused.

mod inside;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{JoinHandle, Thread};
use std::time::Instant;

use crossbeam_queue::ArrayQueue;
use foveal::image::Map2d;
use foveal::scene::Camera;
use foveal_actors::insight::Insight;

use self::inside::Inside;
use crate::change::{Begun, Change};
use crate::controls::Value;
use crate::failure::Failure;
use crate::source::{Controls, Names, Place, Ranges, Status, TimelineShown, Wish};
use crate::walk::{Act, Notice, Walk};

/// Commands that may wait: what hands do in seconds, should a frame take that long.
const COMMANDS: usize = 4096;
/// Lines for people, and screenshots, that may wait.
const SAID: usize = 64;

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
    /// The walk is to begin anew. It goes on until it can.
    Change(Change),
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

impl Command {
    /// Whether pictures may be other ones after it although nobody moves.
    pub fn sets(&self) -> bool {
        matches!(self, Self::Put { .. } | Self::Change(_))
    }
}

/// What a walk says when it begins, and again when it begins anew.
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
    /// Whether it can be [changed](Command::Change).
    pub changes: bool,
}

impl Opening {
    fn of(walk: &Walk, changes: bool) -> Self {
        Self {
            place: walk.place().clone(),
            size: walk.size(),
            ranges: walk.ranges(),
            controls: *walk.controls(),
            changes,
        }
    }
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
    /// From when that act was done until the first picture that knows of it stood here, seconds.
    pub took: f64,
    /// It is what a still view converges to, or is refined to, each bit of it; of a recording that does not play, what that
    /// showed.
    pub exact: bool,
    /// Commands that [set](Command::sets) something and were done before it was looked at.
    pub set: u64,
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
    /// What it has begun anew with.
    opening: ArrayQueue<Opening>,
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
    pub fn spawn<B, M, W>(make: M, wake: W) -> Result<Self, Failure>
    where
        B: Into<Begun>,
        M: FnOnce() -> Result<B, Failure> + Send + 'static,
        W: Fn() + Send + Sync + 'static,
    {
        let shared = Arc::new(Shared {
            start: Instant::now(),
            commands: ArrayQueue::new(COMMANDS),
            newest: ArrayQueue::new(1),
            opening: ArrayQueue::new(1),
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
                let Begun { source, changer } = match make() {
                    Ok(begun) => begun.into(),
                    Err(e) => {
                        let _ = stands.send(Err(e));
                        return Ok(());
                    }
                };
                let mut walk = Walk::new(source, over.0.now());
                let _ = stands.send(Ok(Opening::of(&walk, changer.is_some())));
                drop(stands);
                Inside::new(&over.0, changer).run(&mut walk)
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

    /// What the walk begins anew with, once for each time.
    pub fn opening(&self) -> Option<Opening> {
        self.shared.opening.pop()
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

#[cfg(test)]
#[path = "thread_tests.rs"]
mod tests;
