//! Walks as a window has them: rest, controls, refinement, input whoever stalls.

use super::*;
use crate::navigation::Motion;
use crate::options::Recording;
use crate::source::FrameSource;
use crate::test_scene;
use crate::walk::{Next, Walk};
use foveal::allocation::policy::Policy;
use foveal::display::first_approximation::Probes;
use foveal::illumination::Uniform;
use foveal::illumination::bake::BakeSettings;
use foveal::image::Map2d;
use foveal::splatting::AgeingRules;
use foveal::splatting::supersampling::Supersampling;
use foveal::world::World;
use foveal_actors::illuminator::Refinement;
use foveal_runtime::simulate::{Fault, FaultKind, Faults, Simulation};
use foveal_runtime::{ActorId, Hashing, Record};
use glam::Vec3;
use std::time::Instant;

fn walk() -> Walk {
    walk_of(Settings::new(64, 48, 2))
}

/// A world of its own, and how it is walked through.
struct Made {
    opened: Opened,
    options: Options,
}

impl Made {
    fn start(self) -> Engine {
        Engine::start(self.opened, self.options).expect("actors")
    }

    /// Light that is being baked all the time.
    fn baking(mut self) -> Self {
        let settings = BakeSettings { particles: Some(1 << 40), error: None, ..BakeSettings::default() };
        self.opened.refinement = Some(Refinement {
            world: self.opened.world.clone(),
            settings,
            begun: 0,
            keep: None,
            early: None,
            book: None,
        });
        self
    }

    fn recorded(mut self, into: Record) -> Self {
        self.options.recording = Some(Recording { into, hashing: Hashing::Said, command: "test" });
        self
    }
}

fn made(settings: Settings) -> Made {
    let world = World::new(Arc::new(test_scene::room(4)), Arc::new(Uniform(Vec3::ONE)));
    let options = Options { fps: Some(30.0), ..Options::interactive(settings) };
    Made { opened: Opened::of_world(world), options }
}

fn walk_of(settings: Settings) -> Walk {
    Walk::new(Box::new(made(settings).start()), 0.0)
}

/// Ticks in real time until nothing is left to do.
fn settle(walk: &mut Walk, start: Instant) {
    loop {
        let now = start.elapsed().as_secs_f64();
        assert!(now < 120.0, "the walk never comes to rest");
        match walk.tick(now).1 {
            Next::Input => return,
            Next::Now => {}
            Next::At(t) => std::thread::sleep(Duration::from_secs_f64((t - now).clamp(0.0, 0.1))),
        }
    }
}

#[test]
fn a_walk_comes_to_rest_converged_and_every_overlay_shows_something_else() {
    let (mut walk, start) = (walk(), Instant::now());
    settle(&mut walk, start);
    assert!(walk.status().converged);
    let plain = walk.picture().cloned().expect("a picture");
    assert!(plain.data().iter().flatten().any(|b| *b > 100));
    for _ in 1..Overlay::ALL.len() {
        walk.next_overlay();
        settle(&mut walk, start);
        assert_ne!(walk.picture(), Some(&plain), "{:?}", walk.controls().overlay);
    }
    walk.next_overlay();
    settle(&mut walk, start);
    assert_eq!(walk.picture(), Some(&plain), "overlays leave nothing behind");
}

#[test]
fn exposure_changes_the_picture_but_traces_nothing() {
    let (mut walk, start) = (walk(), Instant::now());
    settle(&mut walk, start);
    let (view, plain) = (walk.status().view, walk.picture().cloned().expect("a picture"));
    let mut controls = *walk.controls();
    controls.set.tone.exposure = 0.25;
    walk.set_controls(controls);
    settle(&mut walk, start);
    let sum = |p: &Map2d<[u8; 3]>| p.data().iter().flatten().map(|b| u64::from(*b)).sum::<u64>();
    assert!(walk.picture().is_some_and(|p| sum(p) * 10 < sum(&plain) * 9), "darker");
    assert_eq!((walk.status().view, walk.status().traced), (view, 0));
}

#[test]
fn a_still_view_keeps_its_bits_and_then_nothing_is_done() {
    // Without environment maps, which tracers go on to capture for other views.
    let settings = Settings { environment_bytes: 0, ..Settings::new(64, 48, 2) };
    let (mut walk, start) = (walk_of(settings), Instant::now());
    settle(&mut walk, start);
    let plain = walk.picture().cloned().expect("a picture");
    let jobs = |walk: &Walk| -> u64 {
        walk.status().actors.iter().filter(|a| a.name.starts_with("tracer")).map(|a| a.delivered).sum()
    };
    let before = jobs(&walk);
    assert!(before > 0);
    for frame in 0..20 {
        // Something that is no work makes each frame be drawn.
        let controls = *walk.controls();
        walk.set_controls(Controls {
            set: Adjustment { fps: 31.0 + frame as f32, ..controls.set },
            ..controls
        });
        settle(&mut walk, start);
        assert_eq!(walk.picture(), Some(&plain), "frame {frame}");
        assert_eq!(walk.status().traced, 0, "frame {frame}");
    }
    assert_eq!(jobs(&walk), before, "no ray");
    for _ in 0..100 {
        let now = start.elapsed().as_secs_f64();
        assert_eq!(walk.tick(now + 5.0), (false, Next::Input), "no frame");
    }
}

#[test]
fn a_view_is_refined_and_comes_to_rest() {
    let start = Instant::now();
    let rules = Supersampling { noise: 0.02, max_samples: 8 };
    let mut walk = walk_of(Settings { supersampling: Some(rules), ..Settings::new(64, 48, 2) });
    settle(&mut walk, start);
    assert!(walk.status().refined);
    let standing = walk.insight().and_then(|(insight, _)| insight.refinement).expect("how far");
    assert!(standing.quiet > 0 && standing.tiles == 12, "{standing:?}");
    assert!(standing.error.is_some_and(|error| error > 0.0 && error < 0.2), "{standing:?}");
    let refined = walk.picture().cloned().expect("a picture");
    let controls = *walk.controls();
    walk.set_controls(Controls { set: Adjustment { refine: None, ..controls.set }, ..controls });
    settle(&mut walk, start);
    let plain = walk.picture().cloned().expect("a picture");
    assert!(!walk.status().refined && plain != refined, "edges are not smooth any more");
    walk.set_controls(controls);
    settle(&mut walk, start);
    assert_eq!(walk.picture(), Some(&refined), "the same bits again");
}

#[test]
fn where_quality_is_kept_every_frame_has_it() {
    let mut made = made(Settings::new(64, 48, 2));
    (made.options.fps, made.options.quality) = (Some(1000.0), Some(0.0));
    let (mut walk, start) = (Walk::new(Box::new(made.start()), 0.0), Instant::now());
    settle(&mut walk, start);
    walk.navigator.press(Motion::Right, start.elapsed().as_secs_f64());
    let (view, mut frames) = (walk.status().view, 0);
    while frames < 3 {
        let (shown, next) = walk.tick(start.elapsed().as_secs_f64());
        if shown {
            frames += 1;
            assert_eq!(walk.quality(), Some(0.0), "frame {frames}");
        }
        if let Next::At(_) = next {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
    assert_eq!(walk.status().view, view + frames);
}

/// Walks to the right for ten frames, and fails unless each has the camera of the moment in which it began.
fn sees_input_in_each_frame(walk: &mut Walk, what: &str) {
    let (mut now, mut frames) = (0.0, 0);
    walk.navigator.press(Motion::Right, now);
    while frames < 10 {
        let before = walk.begun().copied();
        let expected = walk.navigator.camera(now);
        let (shown, next) = walk.tick(now);
        if walk.begun().copied() != before {
            assert_eq!(walk.begun(), Some(&expected), "{what}: frame {frames}");
            assert_ne!(before, Some(expected), "{what}: frame {frames} sees the camera move");
        }
        frames += u32::from(shown);
        now = match next {
            Next::At(t) => t,
            _ => now + 0.01,
        };
        assert!(now < 10.0, "{what}: {frames} frames");
    }
}

#[test]
fn input_reaches_its_frame_whoever_stalls() {
    for who in Stalled::EACH {
        let session = made(Settings::new(64, 48, 2)).baking().start();
        session.stall(who);
        let mut walk = Walk::new(Box::new(session), 0.0);
        sees_input_in_each_frame(&mut walk, &format!("{who:?}"));
        assert!(!walk.status().lit);
        assert!(who != Stalled::All || walk.status().traced == 0, "nobody else did anything");
    }
}

/// What takes what was written only once it is let.
struct Slow(Arc<AtomicBool>);

impl std::io::Write for Slow {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let is_recorder = std::thread::current().name() == Some("recorder");
        while is_recorder && !self.0.load(Ordering::SeqCst) {
            std::thread::sleep(Duration::from_millis(1));
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn input_reaches_its_frame_while_the_disk_stalls() {
    let goes_on = Arc::new(AtomicBool::new(false));
    let slow = Record::Sink(Box::new(Slow(goes_on.clone())));
    let made = made(Settings::new(64, 48, 2)).recorded(slow);
    let mut walk = Walk::new(Box::new(made.start()), 0.0);
    sees_input_in_each_frame(&mut walk, "recording");
    goes_on.store(true, Ordering::SeqCst);
}

#[test]
fn a_recording_is_whole_although_light_is_still_baked_at_its_end() {
    let folder = tempfile::tempdir().expect("a folder");
    for leaves in [false, true] {
        let file = folder.path().join(format!("{leaves}.fvl"));
        let made = made(Settings::new(64, 48, 2)).baking().recorded(Record::File(file.clone()));
        let mut walk = Walk::new(Box::new(made.start()), 0.0);
        sees_input_in_each_frame(&mut walk, "recording");
        if leaves {
            walk.replace_source(Box::new(self::made(Settings::new(64, 48, 2)).start()));
            sees_input_in_each_frame(&mut walk, "another version of the scene");
        }
        drop(walk);
        let trace = foveal_runtime::Trace::open(&file).expect("a recording");
        // One that is left may not have the time to come to its end.
        assert!(leaves || trace.complete(), "it has no end");
        assert!(trace.stat().deliveries > 0);
    }
}

#[test]
fn the_window_does_not_look_around_objects_when_that_was_done_while_loading() {
    let mut made = made(Settings::new(64, 48, 2));
    let probes = Arc::new(Probes::of_world(&made.opened.world));
    made.options.probes = Some(probes.clone());
    let session = made.start();
    assert!(Arc::strong_count(&probes) > 1, "the actors look at others");
    drop(session);
    assert_eq!(Arc::strong_count(&probes), 1);
}

#[test]
fn every_control_is_a_message_and_no_new_actors_start() {
    let (mut walk, start) = (walk(), Instant::now());
    settle(&mut walk, start);
    let plain = walk.picture().cloned();
    // More views than actors that start anew would have seen by the end.
    for turn in [40.0, -80.0, 40.0, 40.0, -80.0, 40.0] {
        walk.navigator.look(turn, 0.0, start.elapsed().as_secs_f64());
        settle(&mut walk, start);
    }
    let (before, views) = (*walk.controls(), walk.status().view);
    let set = Adjustment {
        fps: 20.0,
        workers: 1,
        policy: Policy::Uniform,
        saliency_weight: 1.0,
        samples_per_job: 64,
        environment_bytes: 0,
        ..before.set
    };
    walk.set_controls(Controls { set, ..before });
    settle(&mut walk, start);
    walk.navigator.look(40.0, 0.0, start.elapsed().as_secs_f64());
    settle(&mut walk, start);
    assert_eq!(walk.controls().set, set);
    // One more, or two where the machine is so slow that the first is sparse.
    let more = walk.status().view - views;
    assert!((1..=2).contains(&more), "the same actors go on: {more}");
    let (insight, _) = walk.insight().expect("the allocator said something");
    assert_eq!(insight.map_bytes, [0, 0], "maps are given up");
    walk.set_controls(Controls { set: Adjustment { workers: 2, ..set }, ..before });
    walk.go_to(0, start.elapsed().as_secs_f64());
    settle(&mut walk, start);
    assert_eq!(walk.picture().cloned(), plain, "whatever the order of the samples");
}

#[test]
fn other_ageing_rules_converge_to_the_same_picture() {
    let (mut walk, start) = (walk(), Instant::now());
    settle(&mut walk, start);
    let plain = walk.picture().cloned();
    let mut controls = *walk.controls();
    controls.set.ageing = AgeingRules { delta: 0.3, max_age: 7, n_min: 2 };
    walk.set_controls(controls);
    settle(&mut walk, start);
    assert!(walk.status().converged);
    assert_eq!(walk.picture().cloned(), plain);
}

#[test]
fn pictures_change_their_size_and_the_walk_goes_on() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("a.fvl");
    let mut engine = made(Settings::new(64, 48, 2)).recorded(Record::File(file.clone())).start();
    let camera = engine.place().cameras[0].camera;
    let mut controls = engine.controls();
    controls.set.workers = 1;
    engine.set(&controls).expect("a walk");
    engine.frame(&camera, Duration::from_millis(20)).expect("a frame");
    engine.resize(32, 24).expect("actors");
    let frame = engine.frame(&camera, Duration::from_millis(20)).expect("a frame");
    assert_eq!((frame.snapshot.rgb8.width(), frame.snapshot.rgb8.height()), (32, 24));
    assert_eq!(engine.controls(), controls);
    assert!(foveal_runtime::Trace::open(&file).expect("a recording").complete(), "it ends with its size");
}

#[test]
fn what_happens_beside_the_frames_is_told_once() {
    let mut engine = made(Settings::new(64, 48, 2)).start();
    let camera = engine.place().cameras[0].camera;
    let mut told = Vec::new();
    for _ in 0..3 {
        engine.begin(&camera).expect("a walk");
        engine.work_until(Duration::from_secs(60), Renderer::is_converged).expect("a walk");
        told.extend(engine.end().expect("a frame").events);
    }
    assert_eq!(told, [Event::Converged]);
}

/// Walks until the view has converged, in virtual time, where this goes wrong; returns the picture and what happened.
fn simulated(fault: Option<FaultKind>) -> (Map2d<[u8; 3]>, Vec<Event>) {
    let mut made = made(Settings::new(64, 48, 2));
    let faults = fault.map(|kind| Fault { actor: first_tracer(), kind, at: 1 }).into_iter().collect();
    made.options.clock = Clock::Virtual(Simulation { faults: Faults::Listed(faults), ..Simulation::new(1) });
    let mut engine = made.start();
    let camera = engine.place().cameras[0].camera;
    let mut events = Vec::new();
    for _ in 0..1000 {
        let frame = engine.frame(&camera, Duration::from_millis(20)).expect("a walk");
        events.extend(frame.events);
        if frame.standing != Standing::Growing {
            return (Map2d::clone(&frame.snapshot.rgb8), events);
        }
    }
    panic!("the view never converges");
}

/// Who the first tracer is among the actors.
fn first_tracer() -> ActorId {
    made(Settings::new(64, 48, 2)).start().actors().tracers[0].id()
}

#[test]
fn a_tracer_that_panics_or_hangs_is_told_of_and_changes_no_picture() {
    let (plain, events) = simulated(None);
    assert_eq!(events, [Event::Converged]);
    for (fault, word) in [(FaultKind::Panic, "panicked"), (FaultKind::Hang, "hangs")] {
        let (picture, events) = simulated(Some(fault));
        assert_eq!(picture, plain, "{word}");
        let told = |e: &Event| matches!(e, Event::Incident { what } if what.contains(word));
        assert_eq!(events.iter().filter(|e| told(e)).count(), 1, "{events:?}");
    }
}

/// A camera that has gone some steps aside.
fn aside(start: &Camera, steps: u32) -> Camera {
    let by = (start.target - start.eye).cross(start.up).normalize() * (0.01 * steps as f32);
    Camera { eye: start.eye + by, target: start.target + by, ..*start }
}

/// Where there is no time for it, the base layer is coarse while the camera moves; a view that stands still is whole.
#[test]
fn what_is_drawn_coarsely_in_motion_is_whole_when_the_camera_stands() {
    let size = Settings::new(64, 48, 2);
    let start = made(size).start().place().cameras[0].camera;
    let whole = {
        let mut engine = made(size).start();
        engine.begin(&aside(&start, 5)).expect("a walk");
        engine.work_until(Duration::from_secs(60), Renderer::is_converged).expect("a walk");
        engine.end().expect("a frame").snapshot.rgb8.clone()
    };
    let mut made = made(size);
    made.options.fps = Some(1e5);
    let mut engine = made.start();
    let cell = |engine: &Engine| engine.look(|r| r.drawn().map(|d| d.buffers().cell)).flatten();
    for step in 0..=5 {
        engine.begin(&aside(&start, step)).expect("a walk");
        // Composing alone takes longer than such a frame; of the first nothing is known but how many pixels it has.
        assert_eq!(cell(&engine), Some(if step == 0 { 2 } else { 4 }), "{step}");
        assert_eq!(engine.look(Renderer::is_converged), Some(false), "there is more to be shown");
        engine.end().expect("a frame");
    }
    engine.begin(&aside(&start, 5)).expect("a walk");
    engine.work_until(Duration::from_secs(60), Renderer::is_converged).expect("a walk");
    assert_eq!(cell(&engine), Some(1));
    assert!(*engine.end().expect("a frame").snapshot.rgb8 == *whole, "as if it had never moved");

    // Whoever asks for one frame and waits for it gets a whole one.
    for step in 0..=5 {
        engine.begin(&aside(&start, step)).expect("a walk");
        assert_eq!(cell(&engine), Some(4), "{step}");
        engine.work_until(Duration::from_secs(60), Renderer::is_converged).expect("a walk");
        assert_eq!((cell(&engine), engine.look(Renderer::is_converged)), (Some(1), Some(true)), "{step}");
        engine.end().expect("a frame");
    }
    assert!(*engine.frame(&aside(&start, 5), Duration::ZERO).expect("a frame").snapshot.rgb8 == *whole);
}

/// What is left when nobody looks any more is not traced to its end.
#[test]
fn a_walk_that_is_left_ends_without_its_jobs() {
    let mut engine = made(Settings::new(512, 512, 1)).start();
    let camera = engine.place().cameras[0].camera;
    engine.frame(&camera, Duration::from_millis(1)).expect("a frame");
    let pixels =
        engine.look(|r| r.drawn().map(|d| d.buffers().object.data().iter().filter(|id| **id != 0).count()));
    let end = engine.finish(Duration::from_secs(60));
    assert!(end.drained && end.jobs_left == 0, "{end:?}");
    let late = engine.look(|r| (0..512 * 512).filter(|i| r.layer().is_covered(i % 512, i / 512)).count());
    let (pixels, late) = (pixels.flatten().expect("a view"), late.expect("a renderer"));
    assert!(engine.look(Renderer::is_converged) == Some(false) && late <= pixels, "{late} of {pixels}");
}

#[test]
fn whoever_stalls_is_not_written_to_without_end() {
    let mut engine = made(Settings::new(64, 48, 2)).start();
    let camera = engine.place().cameras[0].camera;
    engine.frame(&camera, Duration::from_millis(50)).expect("a frame");
    engine.stall(Stalled::All);
    for step in 0..600 {
        let mut controls = engine.controls();
        controls.set.tone.exposure = 1.0 + 0.001 * step as f32;
        engine.set(&controls).expect("a walk");
        engine.frame(&aside(&camera, step), Duration::ZERO).expect("a frame");
    }
    assert_eq!(engine.look(Renderer::waiting), Some(0), "nothing came back to the renderer");
    for actor in engine.status().actors {
        assert!(actor.waiting < 64, "{} messages wait for the {}", actor.waiting, actor.name);
    }
}

#[test]
fn a_cache_ager_that_falls_behind_ages_for_the_newest_view_alone() {
    let mut engine = made(Settings::new(64, 48, 2)).start();
    let start = engine.place().cameras[0].camera;
    engine.begin(&start).expect("a walk");
    engine.work_until(Duration::from_secs(60), Renderer::is_converged).expect("a walk");
    engine.end().expect("a frame");
    assert!(engine.rest(Duration::from_secs(60)).expect("a walk"));
    let ager = engine.actors().correction.expect("corrections").cache_ager;
    let delivered = |engine: &Engine| {
        let counters = engine.runtime().counters();
        counters.iter().find(|c| c.name == "cache ager").map_or(0, |c| c.delivered)
    };
    // Nobody traces, so that it is told of cameras only.
    engine.stall(Stalled::Tracers);
    engine.stall(Stalled::CacheAger);
    for step in 1..8 {
        engine.frame(&aside(&start, step), Duration::from_millis(1)).expect("a frame");
    }
    let before = delivered(&engine);
    engine.begin(&aside(&start, 8)).expect("a walk");
    engine.runtime().control(ager, Control::Resume);
    assert!(engine.rest(Duration::from_secs(60)).expect("a walk"));
    let frame = engine.end().expect("a frame");
    assert!(frame.counts.reused > 0, "samples of the first view are shown in the last");
    // The order to go on, and one camera of eight.
    assert!(delivered(&engine) - before <= 2, "{} deliveries", delivered(&engine) - before);
}

/// Where a walk begins is the first of its places, and the others keep their order; a path is played until somebody moves.
#[test]
fn a_walk_begins_where_it_is_told() {
    use crate::walk::Act;
    use foveal::scene::camera::{CameraPath, NamedCamera, PathKey};
    let mut scene = test_scene::room(4);
    let first = scene.cameras[0].camera;
    let beside = |x: f32| Camera { eye: first.eye + x * Vec3::X, ..first };
    let camera = |(name, x): (&str, f32)| NamedCamera { name: name.into(), camera: beside(x) };
    scene.cameras = [("a", 0.0), ("b", 0.01), ("c", 0.02)].map(camera).to_vec();
    let key = |t, x| PathKey { t, eye: beside(x).eye, target: first.target };
    let path = |name: &str| CameraPath { name: name.into(), keys: vec![key(0.0, 0.0), key(2.0, 0.1)] };
    scene.paths = ["to", "fro"].map(path).to_vec();
    let world = World::new(Arc::new(scene), Arc::new(Uniform(Vec3::ONE)));
    let options = Options::interactive(Settings::new(16, 12, 1));
    let mut engine = Engine::start(Opened::of_world(world), options).expect("actors");
    assert!(!engine.plays());
    assert!(engine.begin_at(Some("d"), None).is_err_and(|e| e.exit_code() == 2));
    assert!(engine.begin_at(None, Some("up")).is_err_and(|e| e.to_string().contains("to, fro")));
    engine.begin_at(Some("c"), Some("fro")).expect("both are there");
    engine.resize(20, 12).expect("another size");
    let place = engine.place();
    assert_eq!(place.cameras.iter().map(|c| &*c.name).collect::<Vec<_>>(), ["c", "a", "b"]);
    assert_eq!(place.paths.iter().map(|p| &*p.name).collect::<Vec<_>>(), ["fro", "to"]);
    let mut walk = Walk::new(Box::new(engine), 0.0);
    assert!(walk.is_moving(), "the path is played");
    walk.act(Act::Look(1.0, 0.0), 0.1);
    assert!(!walk.is_moving());
}

#[test]
fn only_frames_of_a_moving_camera_that_are_due_leave_cores_to_drawing() {
    let mut engine = made(Settings::new(64, 48, 2)).start();
    let start = test_scene::room(4).cameras[0].camera;
    let at = |step: u32| Camera { eye: start.eye + Vec3::X * (0.01 * step as f32), ..start };
    let mut hurries = |step: u32, ms: u64| {
        engine.frame(&at(step), Duration::from_millis(ms)).expect("a frame");
        engine.hurries
    };
    assert!(!hurries(0, 33), "nobody knows whether the first one moves");
    assert!(hurries(1, 33) && hurries(2, 33));
    assert!(!hurries(2, 33), "it stands still");
    assert!(!hurries(3, 200), "at 30 frames a second that is not a frame's time");
    assert!(hurries(4, 33));
    engine.controls.set.quality = Some(-1e9);
    engine.frame(&at(5), Duration::from_millis(33)).expect("a frame");
    assert!(!engine.hurries, "it waits for its quality");
}
