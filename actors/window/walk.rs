//! A walk: input becomes cameras, cameras become frames, each in its time.
//!
//! Knows no window: times are seconds since the start, given by the caller.

use std::time::Duration;

use foveal::image::Map2d;
use foveal::scene::camera::PathKey;
use foveal::scene::{Camera, CameraPath};

use super::navigation::Navigator;
use super::panel::{FrameTimes, Notice};
use super::source::{Branch, Controls, FrameSource, Names, Place, Ranges, Status, TimelineShown};
use super::timeline::Wish;
use crate::insight::{Insight, LONGEST_FRAME};
use crate::renderer::gpu::Mirror;
use crate::renderer::overlay::Overlay;

/// Longest stretch of work between two looks at the input.
const SLICE: Duration = Duration::from_millis(8);
/// Bookmarks, keys 1 to 9.
pub const BOOKMARKS: usize = 9;

fn key_of(t: f32, camera: &Camera) -> PathKey {
    PathKey { t, eye: camera.eye, target: camera.target }
}

/// What the caller does until the next call of [`Walk::tick`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Next {
    /// Call again at once.
    Now,
    /// Call again at this time, or after input.
    At(f64),
    /// Call again after input.
    Input,
}

/// A walk through one scene.
pub struct Walk {
    source: Box<dyn FrameSource>,
    place: Place,
    /// Who walks.
    pub navigator: Navigator,
    controls: Controls,
    bookmarks: [Option<Camera>; BOOKMARKS],
    /// Keys of the path that is being recorded, with the time of its start.
    recording: Option<(f64, Vec<PathKey>)>,
    recorded: Option<CameraPath>,
    /// The path that is played, with the time of its start.
    playing: Option<(f64, CameraPath)>,
    /// Begin and camera of the frame that is worked on.
    frame: Option<f64>,
    camera: Option<Camera>,
    /// Camera of the picture on show.
    shown: Option<Camera>,
    last_begin: f64,
    /// Work or display changed, so that a frame must be drawn although nothing moves.
    stale: bool,
    picture: Option<Map2d<[u8; 3]>>,
    /// A display draws by itself, so that frames need no picture.
    mirrored: bool,
    mirror_wanted: bool,
    /// How long the last frames took.
    pub times: FrameTimes,
    /// Estimated quality of the picture on show.
    quality: Option<f32>,
    /// When the next frame of a recording is due, while it plays.
    replaying: Option<f64>,
    /// The last thing to tell the user.
    pub notice: Option<Notice>,
}

impl Walk {
    /// Stands at the scene's first camera.
    pub fn new(source: Box<dyn FrameSource>, now: f64) -> Self {
        let place = source.place();
        let start = place.cameras.first().map_or(
            Camera { eye: glam::Vec3::ZERO, target: glam::Vec3::NEG_Z, up: place.up, fov_y: 0.8 },
            |c| c.camera,
        );
        let mut bookmarks = [None; BOOKMARKS];
        for (bookmark, camera) in bookmarks.iter_mut().zip(&place.cameras) {
            *bookmark = Some(camera.camera);
        }
        Self {
            navigator: Navigator::new(&start, place.up, place.diagonal, now),
            controls: source.controls(),
            source,
            place,
            bookmarks,
            recording: None,
            recorded: None,
            playing: None,
            frame: None,
            camera: None,
            shown: None,
            last_begin: f64::NEG_INFINITY,
            stale: true,
            picture: None,
            mirrored: false,
            mirror_wanted: false,
            times: FrameTimes::default(),
            quality: None,
            replaying: None,
            notice: None,
        }
    }

    /// The same walk through another version of the scene: camera, bookmarks and controls stay.
    pub fn replace_source(&mut self, mut source: Box<dyn FrameSource>) {
        source.set_controls(&self.controls);
        source.set_mirrored(self.mirrored);
        self.place = source.place();
        self.source = source;
        self.frame = None;
        self.camera = None;
        self.stale = true;
    }

    /// The scene.
    pub fn place(&self) -> &Place {
        &self.place
    }

    /// What the user set.
    pub fn controls(&self) -> &Controls {
        &self.controls
    }

    /// The user set something.
    pub fn set_controls(&mut self, controls: Controls) {
        if controls == self.controls {
            return;
        }
        self.controls = controls;
        self.source.set_controls(&controls);
        self.stale = true;
        if self.picture.is_some() && !self.mirrored {
            self.picture = self.source.picture();
        }
    }

    /// How far controls go.
    pub fn ranges(&self) -> Ranges {
        self.source.ranges()
    }

    /// What the allocator thought last.
    pub fn insight(&self) -> Option<(&Insight, &Names)> {
        self.source.insight()
    }

    /// The overlay after this one.
    pub fn next_overlay(&mut self) {
        let at = Overlay::ALL.iter().position(|o| *o == self.controls.overlay).unwrap_or(0);
        let overlay = Overlay::ALL[(at + 1) % Overlay::ALL.len()];
        self.set_controls(Controls { overlay, ..self.controls });
    }

    /// Where the session stands.
    pub fn status(&self) -> Status {
        self.source.status()
    }

    /// Whether a display draws by itself, with [`Self::draw_on`]; else frames come as pictures.
    pub fn set_mirrored(&mut self, wanted: bool) {
        self.mirror_wanted = wanted;
        // A recording may go back to a frame whose samples nobody traces again.
        let mirrored = wanted && self.source.timeline().is_none();
        if mirrored != self.mirrored {
            self.mirrored = mirrored;
            self.source.set_mirrored(mirrored);
            self.fetch_picture();
        }
    }

    /// Whether frames come without pictures.
    pub fn is_mirrored(&self) -> bool {
        self.mirrored
    }

    /// Lets a display draw what the last frame shows. `false` where it cannot.
    pub fn draw_on(&mut self, mirror: &mut Mirror) -> bool {
        self.source.draw_on(mirror)
    }

    /// Columns and rows of the picture.
    pub fn size(&self) -> [u32; 2] {
        self.source.size()
    }

    /// Makes the picture that is on show, where frames come without.
    pub fn fetch_picture(&mut self) {
        self.picture = self.source.picture();
    }

    /// The picture on show; of a mirrored walk the last that was fetched.
    pub fn picture(&self) -> Option<&Map2d<[u8; 3]>> {
        self.picture.as_ref()
    }

    /// Quality of the picture on show as estimated when it was shown ([`Insight::quality`]), once anything is known of it.
    pub fn quality(&self) -> Option<f32> {
        self.quality
    }

    /// The camera of the picture on show.
    pub fn camera(&self) -> Option<&Camera> {
        self.shown.as_ref()
    }

    /// The camera of the frame that began last.
    pub fn begun(&self) -> Option<&Camera> {
        self.camera.as_ref()
    }

    /// Names and values that say how the picture came to be.
    pub fn facts(&mut self, now: f64) -> Vec<(String, String)> {
        let camera = self.camera_at(now);
        let stands = self.shown == Some(camera);
        let mut facts = self.source.facts();
        facts.extend(self.shown.as_ref().map(super::screenshot::camera_fact));
        if self.source.timeline().is_none() {
            facts.push(("foveal speed".into(), self.navigator.speed().to_string()));
            facts.push(("foveal at rest".into(), stands.to_string()));
            facts.extend(self.quality.map(|quality| ("foveal quality".into(), quality.to_string())));
        }
        facts
    }

    /// Goes to a bookmark, counted from 0.
    pub fn go_to(&mut self, bookmark: usize, now: f64) {
        match self.bookmarks.get(bookmark).copied().flatten() {
            Some(camera) => {
                self.playing = None;
                self.navigator.set_camera(&camera, now);
            }
            None => self.tell(format!("bookmark {} is not set; Ctrl + {0} sets it", bookmark + 1)),
        }
    }

    /// Sets a bookmark, counted from 0.
    pub fn set_bookmark(&mut self, bookmark: usize, now: f64) {
        let camera = self.camera_at(now);
        if let Some(place) = self.bookmarks.get_mut(bookmark) {
            *place = Some(camera);
            self.tell(format!("bookmark {} set", bookmark + 1));
        }
    }

    /// Begins or ends the recording of a path.
    pub fn toggle_recording(&mut self, now: f64) {
        match self.recording.take() {
            None => {
                let begin = key_of(0.0, &self.camera_at(now));
                self.recording = Some((now, vec![begin]));
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
                    self.recorded = Some(CameraPath { name: "recorded".into(), keys });
                    self.tell(format!("a path of {count} keys and {seconds:.1} s; P plays it"));
                } else {
                    self.tell("nothing was recorded".into());
                }
            }
        }
    }

    /// Plays the recorded path, else the scene's first; or ends playing.
    pub fn toggle_playing(&mut self, now: f64) {
        if self.playing.take().is_some() {
            return;
        }
        match self.recorded.as_ref().or(self.place.paths.first()) {
            Some(path) => self.playing = Some((now, path.clone())),
            None => self.tell("there is no path; R records one".into()),
        }
    }

    /// Stops playing, since the user moves.
    pub fn take_over(&mut self, now: f64) {
        if self.playing.is_some() {
            let camera = self.camera_at(now);
            self.playing = None;
            self.navigator.set_camera(&camera, now);
        }
    }

    /// Tells the user something.
    pub fn tell(&mut self, text: String) {
        self.notice = Some(Notice { text, failed: false });
    }

    /// Tells the user what went wrong.
    pub fn complain(&mut self, text: String) {
        self.notice = Some(Notice { text, failed: true });
    }

    fn camera_at(&mut self, now: f64) -> Camera {
        let Some((start, path)) = &self.playing else { return self.navigator.camera(now) };
        let t = (now - start) as f32;
        let fov_y = self.navigator.camera(now).fov_y;
        let camera = path.at(t, self.place.up, fov_y);
        if t >= path.duration() {
            self.playing = None;
            self.navigator.set_camera(&camera, now);
        }
        camera
    }

    /// The timeline of a recording, and whether it plays.
    pub fn timeline(&self) -> Option<(TimelineShown, bool)> {
        self.source.timeline().map(|timeline| (timeline.shown(), self.replaying.is_some()))
    }

    /// Does what the user wants of a recording. Nothing where this is none.
    pub fn wish(&mut self, wish: Wish, now: f64) {
        let replaying = self.replaying.take();
        let Some(timeline) = self.source.timeline_mut() else { return };
        match wish {
            Wish::Frame(frame) => timeline.go_to(frame),
            Wish::Messages(messages) => timeline.step(messages),
            Wish::Play => self.replaying = if replaying.is_none() { Some(now) } else { None },
            Wish::Why(x, y) => timeline.why(x, y),
            Wish::Branch => match timeline.branch() {
                Ok(Branch { source, camera }) => {
                    let wanted = self.mirror_wanted;
                    *self = Self::new(source, now);
                    self.set_mirrored(wanted);
                    self.navigator.set_camera(&camera, now);
                    self.tell("walking on from the recording".into());
                }
                Err(e) => self.complain(e),
            },
        }
        self.stale = true;
    }

    /// A recording: shows what was asked for, and the next frame while it plays.
    fn tick_recording(&mut self, now: f64) -> (bool, Next) {
        let period = 1.0 / f64::from(self.controls.set.fps.clamp(0.1, 1000.0));
        if let (Some(due), Some(timeline)) = (self.replaying, self.source.timeline_mut()) {
            if now < due {
                return (false, Next::At(due));
            }
            let goes_on = timeline.next_frame();
            self.replaying = goes_on.then_some(due.max(now - period) + period);
            self.stale = true;
        }
        if !std::mem::take(&mut self.stale) {
            return (false, Next::Input);
        }
        self.picture = self.source.picture();
        (true, self.replaying.map_or(Next::Input, Next::At))
    }

    /// Works a little. Returns whether there is a new picture, and when to call again.
    pub fn tick(&mut self, now: f64) -> (bool, Next) {
        if self.source.timeline().is_some() {
            return self.tick_recording(now);
        }
        let period = 1.0 / f64::from(self.controls.set.fps.clamp(0.1, 1000.0));
        let Some(begin) = self.frame else {
            return (false, self.begin(now, period));
        };
        // Of a scene that was just loaded something is to be seen soon: the time of the first coarse samples.
        let is_first = self.shown.is_none();
        let mut deadline = begin + if is_first { 0.3 * period } else { period };
        if let Some(least) = self.controls.set.quality.filter(|_| !is_first && now >= deadline)
            && self.source.quality() < least
        {
            deadline = begin + LONGEST_FRAME.as_secs_f64();
        }
        if now < deadline && !self.source.is_done() {
            self.source.work(SLICE.min(Duration::from_secs_f64(deadline - now)));
            return (false, Next::Now);
        }
        // (Without its sign, 0 is told as 0.)
        self.quality = Some(self.source.quality() + 0.0).filter(|quality| quality.is_finite());
        self.source.end_frame();
        self.frame = None;
        self.times.push(Duration::from_secs_f64((now - begin).max(0.0)));
        // A session that hears of its end of frame on this thread shows it while it works.
        self.source.work(Duration::ZERO);
        if !self.mirrored {
            self.picture = self.source.picture();
        }
        self.shown = self.camera;
        (true, Next::Now)
    }

    fn begin(&mut self, now: f64, period: f64) -> Next {
        let camera = self.camera_at(now);
        let moved = self.camera != Some(camera);
        let all_shown = self.source.is_done() && self.source.is_shown();
        if !moved && !self.stale && all_shown {
            return if self.navigator.is_moving() || self.playing.is_some() {
                Next::Now
            } else {
                Next::Input
            };
        }
        // Not earlier than a period after the frame before, unless that took longer.
        let next = self.last_begin + period;
        if now < next && self.camera.is_some() {
            return Next::At(next);
        }
        if let Some((start, keys)) = &mut self.recording {
            let key = key_of((now - *start) as f32, &camera);
            // While nothing moves no frame begins; a rest stays one.
            let rested = keys.last().copied().filter(|last| key.t - last.t > 2.0 * period as f32);
            keys.extend(rested.map(|last| PathKey { t: key.t - period as f32, ..last }));
            if keys.last().is_none_or(|last| last.t < key.t) {
                keys.push(key);
            }
        }
        self.last_begin = now;
        self.camera = Some(camera);
        self.stale = false;
        self.frame = Some(now);
        self.source.begin_frame(&camera);
        Next::Now
    }
}

#[cfg(test)]
mod tests {
    use std::cell::RefCell;
    use std::rc::Rc;

    use foveal::allocation::policy::Policy;
    use foveal::display::tone::ToneMap;
    use foveal::scene::NamedCamera;
    use foveal::splatting::AgeingRules;
    use glam::Vec3;

    use super::*;
    use crate::settings::Adjustment;
    use crate::window::navigation::Motion;

    /// What a session was told, and how many slices of work it needs to converge.
    #[derive(Default)]
    struct Told {
        cameras: Vec<Camera>,
        shown: usize,
        controls: Vec<Controls>,
        left: usize,
        /// Slices that a view needs.
        slices: usize,
        /// What was left when frames were shown.
        left_shown: Vec<usize>,
    }

    struct Scripted(Rc<RefCell<Told>>);

    fn camera(x: f32) -> Camera {
        Camera { eye: Vec3::new(x, 0.0, 5.0), target: Vec3::new(x, 0.0, 0.0), up: Vec3::Y, fov_y: 0.8 }
    }

    impl FrameSource for Scripted {
        fn place(&self) -> Place {
            let cameras =
                (0..2).map(|i| NamedCamera { name: i.to_string(), camera: camera(i as f32) }).collect();
            Place { title: "scripted".into(), up: Vec3::Y, diagonal: 8.0, cameras, paths: Vec::new() }
        }
        fn size(&self) -> [u32; 2] {
            [2, 2]
        }
        fn controls(&self) -> Controls {
            let set = Adjustment {
                fps: 10.0,
                quality: None,
                workers: 1,
                saliency_weight: 0.5,
                policy: Policy::default(),
                samples_per_job: 256,
                ageing: AgeingRules::default(),
                environment_bytes: 0,
                texture_bytes: None,
                refine: None,
                tone: ToneMap::default(),
            };
            Controls { set, overlay: Overlay::None }
        }
        fn ranges(&self) -> Ranges {
            Ranges { workers: 1, textures: None }
        }
        fn insight(&self) -> Option<(&Insight, &Names)> {
            None
        }
        fn set_controls(&mut self, controls: &Controls) {
            self.0.borrow_mut().controls.push(*controls);
        }
        fn begin_frame(&mut self, camera: &Camera) {
            let mut told = self.0.borrow_mut();
            if told.cameras.last() != Some(camera) {
                told.left = told.slices;
            }
            told.cameras.push(*camera);
        }
        fn work(&mut self, time: Duration) {
            assert!(time <= SLICE);
            let mut told = self.0.borrow_mut();
            told.left = told.left.saturating_sub(usize::from(!time.is_zero()));
        }
        fn end_frame(&mut self) {
            let mut told = self.0.borrow_mut();
            told.shown += 1;
            let left = told.left;
            told.left_shown.push(left);
        }
        fn picture(&mut self) -> Option<Map2d<[u8; 3]>> {
            Some(Map2d::new(2, 2, [self.0.borrow().shown as u8; 3]))
        }
        fn quality(&mut self) -> f32 {
            -(self.0.borrow().left as f32) / 30.0
        }
        fn is_done(&self) -> bool {
            self.0.borrow().left == 0
        }
        fn status(&self) -> Status {
            Status { converged: self.0.borrow().left == 0, ..Status::default() }
        }
        fn facts(&self) -> Vec<(String, String)> {
            vec![("scene".into(), "scripted".into())]
        }
    }

    fn walk() -> (Walk, Rc<RefCell<Told>>) {
        let told = Rc::new(RefCell::new(Told { left: 30, slices: 30, ..Told::default() }));
        (Walk::new(Box::new(Scripted(told.clone())), 0.0), told)
    }

    /// Ticks until nothing is left to do or `until`, 8 ms each. Returns the time.
    fn run(walk: &mut Walk, mut now: f64, until: f64) -> f64 {
        while now < until {
            match walk.tick(now).1 {
                Next::Now => now += 0.008,
                Next::At(t) => now = t.max(now),
                Next::Input => return now,
            }
        }
        now
    }

    #[test]
    fn a_still_view_converges_and_then_nothing_is_done() {
        let (mut walk, told) = walk();
        let end = run(&mut walk, 0.0, 10.0);
        assert!(end < 1.0);
        let shown = told.borrow().shown;
        // 30 slices of 8 ms at 10 frames per second: three frames or so.
        assert!((2..=4).contains(&shown), "{shown}");
        assert_eq!(walk.tick(end + 5.0), (false, Next::Input));
        assert_eq!(told.borrow().shown, shown);
        assert_eq!(walk.picture().map(|p| p.at(0, 0)[0]), Some(shown as u8));
    }

    #[test]
    fn frames_of_a_moving_camera_keep_their_period() {
        let (mut walk, told) = walk();
        walk.navigator.press(Motion::Right, 0.0);
        run(&mut walk, 0.0, 2.0);
        let frames = told.borrow().cameras.len();
        assert!((17..=21).contains(&frames), "{frames} frames in 2 s at 10 per second");
        let eyes: Vec<f32> = told.borrow().cameras.iter().map(|c| c.eye.x).collect();
        assert!(eyes.windows(2).all(|w| w[1] > w[0]), "each frame sees the camera move");
        assert!(walk.times.median_p99().is_some_and(|(m, _)| (m - 0.1).abs() < 0.02));
    }

    #[test]
    fn where_quality_is_kept_frames_wait_for_it() {
        let (mut walk, told) = walk();
        let controls = *walk.controls();
        walk.set_controls(Controls { set: Adjustment { quality: Some(-0.25), ..controls.set }, ..controls });
        walk.navigator.press(Motion::Right, 0.0);
        run(&mut walk, 0.0, 2.0);
        let left = told.borrow().left_shown.clone();
        // The first picture of a scene is to be seen soon.
        assert!(left[0] > 7, "{left:?}");
        assert!(
            left.len() > 5 && left[1..].iter().all(|left| *left == 7),
            "0.25 of 30 slices are left: {left:?}"
        );
        assert!(walk.times.median_p99().is_some_and(|(median, _)| median > 0.15), "the rate falls");
        assert_eq!(walk.quality(), Some(-7.0 / 30.0));
        walk.set_controls(controls);
        run(&mut walk, 2.0, 3.0);
        assert!(told.borrow().left_shown.last().is_some_and(|left| *left > 7), "the rate is kept again");
    }

    #[test]
    fn no_frame_waits_for_ever() {
        let (mut walk, told) = walk();
        let controls = *walk.controls();
        walk.set_controls(Controls { set: Adjustment { quality: Some(0.0), ..controls.set }, ..controls });
        run(&mut walk, 0.0, 10.0);
        walk.navigator.press(Motion::Right, 10.0);
        told.borrow_mut().slices = 1 << 20;
        let shown = told.borrow().shown;
        run(&mut walk, 10.0, 31.0);
        assert_eq!(told.borrow().shown, shown + 2, "as long as the longest frame is");
    }

    #[test]
    fn changed_controls_reach_the_session_and_draw_one_frame() {
        let (mut walk, told) = walk();
        let end = run(&mut walk, 0.0, 10.0);
        let (shown, controls) = (told.borrow().shown, *walk.controls());
        walk.set_controls(controls);
        assert_eq!(walk.tick(end + 1.0).1, Next::Input, "nothing changed");
        walk.set_controls(Controls { set: Adjustment { fps: 20.0, ..controls.set }, ..controls });
        walk.next_overlay();
        run(&mut walk, end + 1.0, end + 5.0);
        assert_eq!(told.borrow().shown, shown + 1);
        assert_eq!(told.borrow().controls.len(), 2);
        assert_eq!(walk.controls().overlay, Overlay::Saliency);
    }

    #[test]
    fn bookmarks_paths_and_facts() {
        let (mut walk, told) = walk();
        walk.go_to(1, 0.0);
        run(&mut walk, 0.0, 0.05);
        assert_eq!(told.borrow().cameras, [camera(1.0)]);
        walk.go_to(7, 0.1);
        assert!(walk.notice.as_ref().is_some_and(|n| n.text.contains("bookmark 8")));
        walk.toggle_playing(0.1);
        assert!(walk.notice.as_ref().is_some_and(|n| n.text.contains("no path")));
        walk.toggle_recording(0.1);
        // Between the last frame and the end of the recording it goes on, seen by no frame.
        walk.navigator.press(Motion::Right, 0.5);
        run(&mut walk, 0.5, 1.1);
        walk.navigator.release(Motion::Right, 1.19);
        let last = walk.navigator.camera(1.19);
        walk.toggle_recording(1.19);
        walk.set_bookmark(7, 1.19);
        walk.go_to(0, 1.2);
        walk.toggle_playing(1.2);
        let before = told.borrow().cameras.len();
        let end = run(&mut walk, 1.2, 5.0);
        let played: Vec<f32> = told.borrow().cameras[before..].iter().map(|c| c.eye.x).collect();
        assert!(played.len() > 5 && played.windows(2).all(|w| w[1] >= w[0] - 0.01), "{played:?}");
        assert_eq!(told.borrow().cameras.last(), Some(&last), "it ends where it ended");
        assert!(played[..3].iter().all(|x| (x - 1.0).abs() < 1e-3), "it begins with a rest: {played:?}");
        assert_eq!(walk.tick(end + 1.0).1, Next::Input, "the path has an end");
        assert_eq!(walk.facts(end + 1.0)[3].1, "true", "bookmark 8 is where the path ends");
        walk.go_to(0, end + 1.0);
        let facts = walk.facts(end + 1.0);
        let names: Vec<&str> = facts.iter().map(|f| f.0.as_str()).collect();
        assert_eq!(names, ["scene", "foveal camera", "foveal speed", "foveal at rest", "foveal quality"]);
        assert_eq!(facts[3].1, "false", "bookmark 1 is not on show yet");
    }

    #[test]
    fn another_version_of_the_scene_keeps_camera_and_controls() {
        let (mut walk, _) = walk();
        walk.navigator.look(30.0, 0.0, 0.0);
        let camera = walk.navigator.camera(0.0);
        walk.next_overlay();
        let told = Rc::new(RefCell::new(Told { left: 30, slices: 30, ..Told::default() }));
        walk.replace_source(Box::new(Scripted(told.clone())));
        run(&mut walk, 0.0, 0.05);
        assert_eq!(told.borrow().cameras, [camera]);
        assert_eq!(told.borrow().controls[0].overlay, Overlay::Saliency);
    }
}
