//! A walk through a scene that is a script, in time that is one too.

use std::cell::RefCell;
use std::rc::Rc;

use foveal::allocation::policy::Policy;
use foveal::display::tone::ToneMap;
use foveal::scene::NamedCamera;
use foveal::splatting::AgeingRules;
use glam::Vec3;

use super::*;
use crate::navigation::Motion;
use foveal_actors::settings::Adjustment;

/// What a session was told, and how many slices of work it needs to converge.
#[derive(Default)]
struct Told {
    cameras: Vec<Camera>,
    shown: usize,
    controls: Vec<Controls>,
    left: usize,
    /// Slices that a view needs.
    slices: usize,
    /// What the next frame tells.
    events: Vec<Event>,
    /// What was left when frames were shown.
    left_shown: Vec<usize>,
}

struct Scripted(Rc<RefCell<Told>>);

fn camera(x: f32) -> Camera {
    Camera { eye: Vec3::new(x, 0.0, 5.0), target: Vec3::new(x, 0.0, 0.0), up: Vec3::Y, fov_y: 0.8 }
}

impl FrameSource for Scripted {
    fn place(&self) -> Place {
        let cameras = (0..2).map(|i| NamedCamera { name: i.to_string(), camera: camera(i as f32) }).collect();
        Place {
            title: "scripted".into(),
            up: Vec3::Y,
            diagonal: 8.0,
            cameras,
            paths: Vec::new(),
            lamps: Vec::new(),
        }
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
    fn end_frame(&mut self) -> Vec<Event> {
        let mut told = self.0.borrow_mut();
        told.shown += 1;
        let left = told.left;
        told.left_shown.push(left);
        std::mem::take(&mut told.events)
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
fn frames_keep_their_period_although_showing_them_takes_time() {
    let (mut walk, told) = walk();
    told.borrow_mut().slices = 1 << 20;
    walk.navigator.press(Motion::Right, 0.0);
    let mut now = 0.0;
    while now < 4.0 {
        now = match walk.tick(now) {
            (true, _) => now + 0.03,
            (false, Next::Now) => now + 0.004,
            (false, Next::At(t)) => t,
            (false, Next::Input) => panic!("it moves"),
        };
    }
    let frames = told.borrow().cameras.len();
    assert!((37..=41).contains(&frames), "{frames} frames in 4 s at 10 per second");
    assert!(walk.times.median_p99().is_some_and(|(median, _)| (median - 0.1).abs() < 0.01));
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
    assert!(walk.notices.newest().is_some_and(|n| n.text.contains("bookmark 8")));
    walk.toggle_playing(0.1);
    assert!(walk.notices.newest().is_some_and(|n| n.text.contains("no path")));
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

/// What happens beside the frames is said to whoever looks on.
#[test]
fn incidents_and_the_end_of_a_recording_are_told() {
    for (event, says) in [
        (Event::Incident { what: "tracer 1 began anew".into() }, "tracer 1 began anew"),
        (Event::RecordingStopped { reason: "the disk is full".into() }, "the disk is full"),
    ] {
        let (mut walk, told) = walk();
        told.borrow_mut().events = vec![Event::Converged, event, Event::LightGrew];
        run(&mut walk, 0.0, 1.0);
        assert!(walk.notices.newest().is_some_and(|n| n.failed && n.text.contains(says)), "{says}");
    }
}
