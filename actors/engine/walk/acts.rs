//! What hands do to a walk, at a time: the one way in for keys, mice and fingers, whoever listens to them.

use foveal::scene::Camera;

use super::Walk;
use crate::navigation::{Motion, Pace};

/// Something that a user did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Act {
    /// A key of motion went down.
    Press(Motion),
    /// It went up.
    Release(Motion),
    /// All keys went up: nobody listens to the keyboard any more.
    ReleaseAll,
    /// The view was dragged by so many pixels, to the right and down.
    Look(f32, f32),
    /// The wheel turned by so many steps, up is positive.
    Wheel(f32),
    /// How fast, beside the wheel.
    Pace(Pace),
    /// Dragging turns about the middle of the view, or about the eye again.
    ToggleOrbit,
    /// A path is recorded from now on, or no longer.
    ToggleRecording,
    /// A path is played from now on, or no longer.
    TogglePlaying,
    /// To a bookmark, counted from 0.
    GoTo(usize),
    /// A bookmark is set here, counted from 0.
    SetBookmark(usize),
    /// To where this camera stands.
    Stand(Camera),
}

impl Walk {
    /// The user does something at `now`, seconds since the start.
    pub fn act(&mut self, act: Act, now: f64) {
        match act {
            Act::Press(motion) => {
                self.take_over(now);
                self.navigator.press(motion, now);
            }
            Act::Release(motion) => self.navigator.release(motion, now),
            Act::ReleaseAll => self.navigator.release_all(now),
            Act::Look(right, down) => {
                self.take_over(now);
                self.navigator.look(right, down, now);
            }
            Act::Wheel(steps) => self.navigator.wheel(steps, now),
            Act::Pace(pace) => self.navigator.set_pace(pace, now),
            Act::ToggleOrbit => self.navigator.set_orbits(!self.navigator.orbits()),
            Act::ToggleRecording => self.toggle_recording(now),
            Act::TogglePlaying => self.toggle_playing(now),
            Act::GoTo(bookmark) => self.go_to(bookmark, now),
            Act::SetBookmark(bookmark) => self.set_bookmark(bookmark, now),
            Act::Stand(camera) => {
                self.take_over(now);
                self.navigator.set_camera(&camera, now);
            }
        }
    }

    /// Goes so far at once, scene units: to the right, upwards, ahead.
    pub fn stride(&mut self, aside: f32, up: f32, ahead: f32, now: f64) {
        let camera = self.camera_at(now);
        let forward = (camera.target - camera.eye).normalize_or_zero();
        let right = forward.cross(self.place.up).normalize_or_zero();
        let by = aside * right + up * self.place.up + ahead * forward;
        self.act(Act::Stand(Camera { eye: camera.eye + by, target: camera.target + by, ..camera }), now);
    }

    /// Whether a frame has begun and not yet ended.
    pub fn is_in_frame(&self) -> bool {
        self.frame.is_some()
    }

    /// Whether the picture on show is that of the camera as it is and of all that was set, and has everything that arrived.
    pub fn shows_all(&self) -> bool {
        !self.stale && self.source.is_shown() && self.shown.is_some() && self.shown == self.camera
    }

    /// Whether the camera moves by itself: a key is held, or a path is played.
    pub fn is_moving(&self) -> bool {
        self.navigator.is_moving() || self.ways.is_playing()
    }
}
