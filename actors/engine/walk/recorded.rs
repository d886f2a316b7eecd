//! A recording instead of a walk: its timeline, and the walk that branches off.

use super::{Next, Walk};

/// How often it is looked for what a thread beside makes, seconds.
const LOOK: f64 = 0.01;

use crate::source::{Branch, TimelineShown, Wish};

impl Walk {
    /// The timeline of a recording, and whether it plays.
    pub fn timeline(&self) -> Option<(TimelineShown, bool)> {
        self.source.timeline().map(|timeline| (timeline.shown(), self.replaying.is_some()))
    }

    /// Does what the user wants of a recording. Of a walk it can only be told what is at a pixel.
    pub fn wish(&mut self, wish: Wish, now: f64) {
        let replaying = self.replaying.take();
        if self.source.timeline().is_none() {
            if let Wish::Why(x, y) = wish {
                let at = self.source.pick(x, y);
                self.tell(at.map_or_else(|| "the environment".to_owned(), |picked| picked.told()));
            }
            return;
        }
        let Some(timeline) = self.source.timeline_mut() else { return };
        match wish {
            Wish::Frame(frame) => timeline.go_to(frame),
            Wish::Messages(messages) => timeline.step(messages),
            Wish::Play => self.replaying = if replaying.is_none() { Some(now) } else { None },
            Wish::Why(x, y) => timeline.why(x, y),
            Wish::Find(condition) => timeline.find(&condition),
            Wish::Place(place) => timeline.go_to_place(&place),
            Wish::State(actor) => timeline.tell_state(&actor),
            Wish::Lanes(shows) => timeline.show_lanes(shows),
            Wish::Branch => match timeline.branch() {
                Ok(Branch { source, camera, recorded }) => {
                    self.move_to(source, now);
                    self.navigator.set_camera(&camera, now);
                    self.tell(match recorded {
                        Some(file) => format!("walking on from the recording, into {}", file.display()),
                        None => "walking on from the recording".into(),
                    });
                }
                Err(e) => self.complain(e),
            },
        }
        self.stale = true;
    }

    /// A recording: shows what was asked for, and the next frame while it plays.
    pub(super) fn tick_recording(&mut self, now: f64) -> (bool, Next) {
        let period = 1.0 / f64::from(self.controls.set.fps.clamp(0.1, 1000.0));
        self.stale |= self.source.take_news();
        if let (Some(due), Some(timeline)) = (self.replaying, self.source.timeline_mut()) {
            if now < due && !self.stale {
                return (false, Next::At(due));
            }
            if now >= due {
                let goes_on = timeline.next_frame();
                self.replaying = goes_on.then_some(due.max(now - period) + period);
                self.stale = true;
            }
        }
        let next = match self.replaying {
            _ if self.source.is_busy() => Next::At(now + LOOK),
            Some(due) => Next::At(due),
            None => Next::Input,
        };
        let is_new = std::mem::take(&mut self.stale);
        if is_new {
            self.picture = self.source.picture();
        }
        (is_new, next)
    }
}
