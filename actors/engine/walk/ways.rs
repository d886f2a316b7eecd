//! Where a walk goes without hands: bookmarks, and paths that are recorded and played.

use foveal::scene::camera::PathKey;
use foveal::scene::{Camera, CameraPath};

use super::Walk;
use crate::source::Place;

/// Bookmarks, keys 1 to 9.
pub const BOOKMARKS: usize = 9;

/// Bookmarks and paths of a walk.
pub(super) struct Ways {
    bookmarks: [Option<Camera>; BOOKMARKS],
    /// Keys of the path that is being recorded, with the time of its start.
    recording: Option<(f64, Vec<PathKey>)>,
    recorded: Option<CameraPath>,
    /// The path that is played, with the time of its start.
    playing: Option<(f64, CameraPath)>,
}

impl Ways {
    /// The scene's cameras as bookmarks.
    pub(super) fn new(place: &Place) -> Self {
        let mut bookmarks = [None; BOOKMARKS];
        for (bookmark, camera) in bookmarks.iter_mut().zip(&place.cameras) {
            *bookmark = Some(camera.camera);
        }
        Self { bookmarks, recording: None, recorded: None, playing: None }
    }

    /// Whether a path is played.
    pub(super) fn is_playing(&self) -> bool {
        self.playing.is_some()
    }
}

fn key_of(t: f32, camera: &Camera) -> PathKey {
    PathKey { t, eye: camera.eye, target: camera.target }
}

impl Walk {
    /// Goes to a bookmark, counted from 0.
    pub fn go_to(&mut self, bookmark: usize, now: f64) {
        match self.ways.bookmarks.get(bookmark).copied().flatten() {
            Some(camera) => {
                self.ways.playing = None;
                self.navigator.set_camera(&camera, now);
            }
            None => self.tell(format!("bookmark {} is not set", bookmark + 1)),
        }
    }

    /// Sets a bookmark, counted from 0.
    pub fn set_bookmark(&mut self, bookmark: usize, now: f64) {
        let camera = self.camera_at(now);
        if let Some(place) = self.ways.bookmarks.get_mut(bookmark) {
            *place = Some(camera);
            self.tell(format!("bookmark {} set", bookmark + 1));
        }
    }

    /// Begins or ends the recording of a path.
    pub fn toggle_recording(&mut self, now: f64) {
        match self.ways.recording.take() {
            None => {
                let begin = key_of(0.0, &self.camera_at(now));
                self.ways.recording = Some((now, vec![begin]));
                self.tell("recording a path; R ends it".into());
            }
            Some((start, mut keys)) => {
                // Where the walk is may be further than the last frame has seen.
                let end = key_of((now - start) as f32, &self.camera_at(now));
                if keys.last().is_some_and(|last| (last.eye, last.target) != (end.eye, end.target)) {
                    keys.push(end);
                }
                let (count, seconds) = (keys.len(), keys.last().map_or(0.0, |k| k.t));
                if count > 1 {
                    self.ways.recorded = Some(CameraPath { name: "recorded".into(), keys });
                    self.tell(format!("a path of {count} keys and {seconds:.1} s; P plays it"));
                } else {
                    self.tell("nothing was recorded".into());
                }
            }
        }
    }

    /// Plays the recorded path, else the scene's first; or ends playing.
    pub fn toggle_playing(&mut self, now: f64) {
        if self.ways.playing.take().is_some() {
            return;
        }
        match self.ways.recorded.as_ref().or(self.place.paths.first()) {
            Some(path) => self.ways.playing = Some((now, path.clone())),
            None => self.tell("there is no path; R records one".into()),
        }
    }

    /// Stops playing, since the user moves.
    pub fn take_over(&mut self, now: f64) {
        if self.ways.playing.is_some() {
            let camera = self.camera_at(now);
            self.ways.playing = None;
            self.navigator.set_camera(&camera, now);
        }
    }

    /// A frame begins: where a path is recorded, it goes on.
    pub(super) fn record_key(&mut self, camera: &Camera, now: f64, period: f64) {
        if let Some((start, keys)) = &mut self.ways.recording {
            let key = key_of((now - *start) as f32, camera);
            // While nothing moves no frame begins; a rest stays one.
            let rested = keys.last().copied().filter(|last| key.t - last.t > 2.0 * period as f32);
            keys.extend(rested.map(|last| PathKey { t: key.t - period as f32, ..last }));
            if keys.last().is_none_or(|last| last.t < key.t) {
                keys.push(key);
            }
        }
    }

    /// The camera of this moment.
    pub(super) fn camera_at(&mut self, now: f64) -> Camera {
        let Some((start, path)) = &self.ways.playing else { return self.navigator.camera(now) };
        let t = (now - start) as f32;
        let fov_y = self.navigator.camera(now).fov_y;
        let camera = path.at(t, self.place.up, fov_y);
        if t >= path.duration() {
            self.ways.playing = None;
            self.navigator.set_camera(&camera, now);
        }
        camera
    }
}
