//! A walk on a thread of its own, as a door drives it.

use std::time::Duration;

use foveal::illumination::Uniform;
use foveal::world::World;
use foveal_actors::renderer::overlay::Overlay;
use glam::Vec3;

use super::*;
use crate::change::Changer;
use crate::engine::Engine;
use crate::navigation::{Motion, Navigator};
use crate::opened::Opened;
use crate::options::Options;
use crate::source::FrameSource;
use crate::{Settings, test_scene};

fn make() -> Result<Box<dyn FrameSource>, Failure> {
    let world = World::new(Arc::new(test_scene::room(4)), Arc::new(Uniform(Vec3::ONE)));
    let options = Options { fps: Some(30.0), ..Options::interactive(Settings::new(64, 48, 2)) };
    Ok(Box::new(Engine::start(Opened::of_world(world), options)?))
}

fn spawned() -> EngineThread {
    let here = std::thread::current();
    EngineThread::spawn(make, move || here.unpark()).expect("a walk")
}

/// The next thing shown that is as wanted.
fn wait(handle: &EngineHandle, wanted: impl Fn(&Shown) -> bool) -> Arc<Shown> {
    let until = Instant::now() + Duration::from_secs(120);
    while Instant::now() < until {
        match handle.shown() {
            Some(shown) if wanted(&shown) => return shown,
            Some(_) => {}
            None => std::thread::park_timeout(Duration::from_millis(50)),
        }
    }
    panic!("it is never shown");
}

#[test]
fn acts_reach_the_walk_at_their_times_and_a_still_view_becomes_exact() {
    let engine = spawned();
    let handle = engine.handle();
    let first = wait(handle, |s| s.exact);
    let start = engine.opening().place.cameras[0].camera;
    assert_eq!((first.camera, first.mark), (Some(start), None));

    // Told late and at once, but done at their times.
    let t = handle.now();
    std::thread::sleep(Duration::from_millis(30));
    let (down, up) = (t + 0.005, t + 0.02);
    for (act, at) in [(Act::Press(Motion::Right), down), (Act::Release(Motion::Right), up)] {
        handle.send(Command::Act { act, at, mark: at }).expect("room");
    }
    let walked = wait(handle, |s| s.exact && s.mark == Some(up));
    let place = &engine.opening().place;
    let mut navigator = Navigator::new(&start, place.up, place.diagonal, 0.0);
    navigator.press(Motion::Right, down);
    navigator.release(Motion::Right, up);
    assert_eq!(walked.camera, Some(navigator.camera(up)));
    assert!(walked.number > first.number && walked.picture != first.picture && !walked.moving);

    // No picture says that it knows of what it does not show.
    handle.send(Command::Act { act: Act::Look(30.0, 0.0), at: handle.now(), mark: 5.0 }).expect("room");
    let turned = wait(handle, |s| s.mark == Some(5.0));
    assert!(turned.took > 0.0 && turned.took < 60.0, "{}", turned.took);
    assert!(turned.camera != walked.camera && turned.picture != walked.picture);

    // Nothing is of the future.
    let at = handle.now() + 1e6;
    handle.send(Command::Act { act: Act::Press(Motion::Left), at, mark: 1.0 }).expect("room");
    wait(handle, |s| s.moving && s.camera != turned.camera);
    engine.end().expect("a good end");
}

#[test]
fn controls_are_set_by_name_and_nonsense_is_told() {
    let engine = spawned();
    let handle = engine.handle();
    let plain = wait(handle, |s| s.exact);
    let put = |key: &str, value| handle.send(Command::Put { key: key.into(), value }).expect("room");
    put("overlay", Value::Name("object ids".into()));
    let painted = wait(handle, |s| s.report.controls.overlay == Overlay::Objects && s.exact);
    assert_ne!(painted.picture, plain.picture);
    put("overlay", Value::Name("none".into()));
    let again = wait(handle, |s| s.report.controls.overlay == Overlay::None && s.exact);
    assert_eq!(again.picture, plain.picture);
    assert!(again.number > painted.number);
    put("speed of light", Value::Number(3e8));
    let until = Instant::now() + Duration::from_secs(60);
    let notice = loop {
        match handle.notice() {
            Some(notice) => break notice,
            None if Instant::now() > until => panic!("nothing is said"),
            None => std::thread::park_timeout(Duration::from_millis(20)),
        }
    };
    assert!(notice.failed && notice.text.contains("speed of light"));
    handle.send(Command::Shot { tag: 7 }).expect("room");
    let shot = loop {
        match handle.shot() {
            Some(shot) => break shot,
            None => std::thread::park_timeout(Duration::from_millis(20)),
        }
    };
    assert_eq!((shot.tag, &*shot.picture), (7, &*plain.picture));
    assert!(shot.facts.iter().any(|(name, _)| name == "foveal camera"));
}

#[test]
fn what_is_set_is_exact_once_it_is_shown_and_not_before() {
    let engine = spawned();
    let handle = engine.handle();
    let plain = wait(handle, |s| s.exact);
    let put = Command::Put { key: "exposure".into(), value: Value::Number(-2.0) };
    assert!(put.sets() && !Command::Pause.sets());
    handle.send(put).expect("room");
    let dark = wait(handle, |s| {
        // (Exactness is lost with the command, whatever the picture on show.)
        assert!(!(s.exact && s.set == 1) || s.picture != plain.picture);
        s.exact && s.set == 1
    });
    assert!(dark.number > plain.number && dark.picture != plain.picture);
    // What changes no picture is exact again, the same picture.
    handle.send(Command::Put { key: "fps".into(), value: Value::Number(20.0) }).expect("room");
    assert_eq!(wait(handle, |s| s.exact && s.set == 2).number, dark.number);
}

/// The next of what somebody waits for.
fn next<T>(what: &str, mut found: impl FnMut() -> Option<T>) -> T {
    let until = Instant::now() + Duration::from_secs(60);
    while Instant::now() < until {
        match found() {
            Some(found) => return found,
            None => std::thread::park_timeout(Duration::from_millis(20)),
        }
    }
    panic!("{what} never comes");
}

#[test]
fn a_walk_begins_anew_where_it_stands() {
    let changer: Changer = Arc::new(|change, opened, size| {
        let [width, height] = match change {
            Change::Size([1, _]) => return Err("too narrow".into()),
            Change::Size(size) => size,
            _ => size,
        };
        Ok(Box::new(move || {
            let options =
                Options { fps: Some(30.0), ..Options::interactive(Settings::new(width, height, 2)) };
            Ok(Box::new(Engine::start(opened, options).map_err(|e| e.to_string())?))
        }))
    });
    let here = std::thread::current();
    let begun = move || Ok(Begun { source: make()?, changer: Some(changer) });
    let engine = EngineThread::spawn(begun, move || here.unpark()).expect("a walk");
    let handle = engine.handle();
    assert!(engine.opening().changes);
    wait(handle, |s| s.exact);
    let at = handle.now();
    handle.send(Command::Act { act: Act::Look(30.0, 0.0), at, mark: 1.0 }).expect("room");
    handle.send(Command::Put { key: "exposure".into(), value: Value::Number(-1.0) }).expect("room");
    let turned = wait(handle, |s| s.exact && s.mark == Some(1.0) && s.set == 1);
    handle.send(Command::Change(Change::Size([40, 56]))).expect("room");
    let resized = wait(handle, |s| {
        // No picture of the walk before is taken for one of the next.
        assert!(!(s.exact && s.set == 2) || s.picture.width() == 40);
        s.exact && s.set == 2
    });
    assert_eq!((resized.camera, resized.report.controls), (turned.camera, turned.report.controls));
    assert_eq!([resized.picture.width(), resized.picture.height()], [40, 56]);
    assert_eq!(next("an opening", || handle.opening()).size, [40, 56]);
    assert!(!next("a notice", || handle.notice()).failed);
    // What fails is told, and the walk goes on.
    handle.send(Command::Change(Change::Size([1, 56]))).expect("room");
    let told = next("a notice", || handle.notice());
    assert_eq!((told.failed, &*told.text), (true, "too narrow"));
    assert_eq!(next("an opening", || handle.opening()).size, [40, 56]);
    assert_eq!(wait(handle, |s| s.exact && s.set == 3).picture, resized.picture);
    engine.end().expect("a good end");
}

#[test]
fn a_walk_without_a_changer_stays_as_it_is() {
    let engine = spawned();
    let handle = engine.handle();
    wait(handle, |s| s.exact);
    handle.send(Command::Change(Change::Reload)).expect("room");
    assert!(next("a notice", || handle.notice()).failed && !engine.opening().changes);
}

#[test]
fn nothing_is_shown_while_nobody_looks() {
    let engine = spawned();
    let handle = engine.handle();
    wait(handle, |s| s.exact);
    handle.send(Command::Pause).expect("room");
    let at = handle.now();
    handle.send(Command::Act { act: Act::Look(40.0, 0.0), at, mark: at }).expect("room");
    std::thread::sleep(Duration::from_millis(200));
    // The walk may have said that it rests before it heard of the pause.
    assert!(handle.shown().is_none_or(|s| s.mark != Some(at)));
    assert!(handle.shown().is_none());
    handle.send(Command::Resume).expect("room");
    wait(handle, |s| s.mark == Some(at));
}

#[test]
fn what_cannot_begin_or_go_on_says_so() {
    let failed = EngineThread::spawn::<Begun, _, _>(|| Err(Failure::Input("no such scene".into())), || {});
    assert!(matches!(failed, Err(Failure::Input(why)) if why == "no such scene"));
    let panicked = EngineThread::spawn::<Begun, _, _>(|| panic!("at once"), || {});
    assert!(matches!(panicked, Err(Failure::Environment(_))));
    let engine = spawned();
    let handle = engine.handle().clone();
    engine.end().expect("a good end");
    assert!(handle.is_over());
}

/// What a program with threads of its own hands about. An engine stays on its thread, since a runtime's main thread is
/// part of its scheduling: [`EngineThread`] has one for those who have other things to do.
#[test]
fn all_but_the_engine_crosses_threads() {
    fn crosses<T: Send>() {}
    crosses::<EngineHandle>();
    crosses::<EngineThread>();
    crosses::<Opened>();
    crosses::<crate::Frame>();
    crosses::<crate::engine::Event>();
}
