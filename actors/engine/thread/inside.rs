//! The thread's side: does what it is told, lets the walk work, and leaves what is new.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, TryRecvError, sync_channel};
use std::time::Duration;

use super::{Command, Opening, Report, Shared, Shot, Shown};
use crate::change::{Change, Changer, apart};
use crate::source::{Build, Names, Status};
use crate::walk::{Next, Notice, Walk};

/// Shortest time between two reports, but for news that nobody wants to wait for.
const REPORT: Duration = Duration::from_millis(250);
/// Changes that may wait for the one that is made; each lamp has one at most.
const CHANGES: usize = 64;

/// A change that is being made on a thread beside.
struct Changing {
    change: Change,
    result: Receiver<Result<Build, String>>,
}

/// An act by its mark, and when it was done.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Mark {
    mark: f64,
    at: f64,
}

pub(super) struct Inside<'s> {
    shared: &'s Shared,
    /// What was published last, and when its report was made.
    shown: Option<(Arc<Shown>, f64)>,
    /// The last act; the same as it was when the frame began, and of the frame on show.
    mark: Option<Mark>,
    frame_mark: Option<Mark>,
    shown_mark: Option<Mark>,
    paused: bool,
    names: Option<Arc<Names>>,
    changer: Option<Changer>,
    changing: Option<Changing>,
    changes: VecDeque<Change>,
    /// Commands done that set something.
    set: u64,
    /// What was published last was exact, and nothing has been set since.
    was_exact: bool,
}

impl<'s> Inside<'s> {
    pub(super) fn new(shared: &'s Shared, changer: Option<Changer>) -> Self {
        Self {
            shared,
            shown: None,
            mark: None,
            frame_mark: None,
            shown_mark: None,
            paused: false,
            names: None,
            changer,
            changing: None,
            changes: VecDeque::new(),
            set: 0,
            was_exact: false,
        }
    }

    pub(super) fn run(mut self, walk: &mut Walk) -> Result<(), String> {
        while !self.shared.ends.load(Ordering::Acquire) {
            while let Some(command) = self.shared.commands.pop() {
                self.obey(walk, command);
            }
            self.change(walk);
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
        if command.sets() {
            self.set += 1;
            self.was_exact = false;
        }
        match command {
            Command::Act { act, at, mark } => {
                self.mark = Some(Mark { mark, at: self.shared.now() });
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
            Command::Change(_) if self.changer.is_none() => {
                walk.complain("what was recorded stays as it was".into());
            }
            Command::Change(change) => {
                self.changes.retain(|other| !change.replaces(other));
                if self.changes.len() < CHANGES {
                    self.changes.push_back(change);
                } else {
                    walk.complain("the scene is still being changed".into());
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

    /// Takes a change that is made, and has the next one made.
    fn change(&mut self, walk: &mut Walk) {
        if let Some(Changing { change, result }) = &self.changing {
            let made = match result.try_recv() {
                Ok(made) => made,
                Err(TryRecvError::Empty) => return,
                Err(TryRecvError::Disconnected) => Err("the change was not made".into()),
            };
            let told = change.told();
            self.changing = None;
            match made.and_then(|build| build()) {
                Ok(source) => {
                    walk.replace_source(source);
                    walk.tell(told);
                    self.names = None;
                    self.was_exact = false;
                }
                Err(e) => walk.complain(e),
            }
            // Also where it failed: somebody shows what was wanted.
            self.shared.opening.force_push(Opening::of(walk, true));
        }
        let Some(change) = self.changes.pop_front() else { return };
        let (Some(changer), Some(opened)) = (self.changer.clone(), walk.opened()) else {
            return walk.complain("what was recorded stays as it was".into());
        };
        let (size, (sender, result), engine) = (walk.size(), sync_channel(1), std::thread::current());
        let started = std::thread::Builder::new().name("loader".into()).spawn(move || {
            let _ = sender.send(apart(|| changer(change, opened, size)));
            engine.unpark();
        });
        match started {
            Ok(_) => self.changing = Some(Changing { change, result }),
            Err(e) => walk.complain(format!("no thread to change the scene with: {e}")),
        }
    }

    fn say(&self, notice: Notice) {
        self.shared.notices.force_push(notice);
        (self.shared.wake)();
    }

    /// Leaves what is new for whoever looks. `rests`: nothing more comes until somebody does something.
    fn publish(&mut self, walk: &mut Walk, is_new: bool, rests: bool) {
        for notice in walk.notices.take() {
            self.say(notice);
        }
        let camera = walk.camera().copied();
        let now = self.shared.now();
        let before = self.shown.as_ref().map(|(shown, _)| shown);
        let is_set = before.is_none_or(|b| b.report.controls != *walk.controls() || b.set != self.set);
        let pressing = rests || is_set;
        let is_due = self.shown.as_ref().is_none_or(|(_, at)| now - at >= REPORT.as_secs_f64());
        if !is_new && !pressing && !is_due {
            return;
        }
        let Some(picture) = walk.picture() else { return };
        // Frames of a view that has converged are the same.
        let same = before.filter(|b| *b.picture == *picture);
        let status = walk.status();
        let exact = match walk.timeline() {
            Some((_, plays)) => !plays,
            None => {
                let is_exact = status.converged && walk.shows_all() && !walk.is_in_frame();
                let settled = self.changing.is_none() && self.changes.is_empty();
                // While the next frame is made an equal picture that was exact still is.
                settled && (is_exact || self.was_exact && same.is_some_and(|b| b.camera == camera))
            }
        };
        let (number, kept) = match same {
            Some(before) => (before.number, Arc::clone(&before.picture)),
            None => (before.map_or(0, |b| b.number) + 1, Arc::new(picture.clone())),
        };
        let moving = walk.is_moving() && walk.timeline().is_none();
        let mark = self.shown_mark.map(|m| m.mark);
        let was = before.map(|b| (b.number, b.exact, b.moving, b.mark));
        let news = was != Some((number, exact, moving, mark));
        let took = before.filter(|b| b.mark == mark).map(|b| b.took);
        let state = |status: &Status| (status.converged, status.refined, status.lit);
        let is_due = is_due || pressing || before.is_none_or(|b| state(&b.report.status) != state(&status));
        if !news && !is_due {
            return;
        }
        let (report, at) = match &self.shown {
            Some((before, at)) if !is_due => (Arc::clone(&before.report), *at),
            _ => (Arc::new(self.report(walk, status)), now),
        };
        let set = self.set;
        let took = took.unwrap_or_else(|| self.shown_mark.map_or(0.0, |m| self.shared.now() - m.at));
        let shown = Arc::new(Shown { number, picture: kept, camera, mark, took, exact, set, moving, report });
        self.was_exact = exact;
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
