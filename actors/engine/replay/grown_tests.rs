//! Walks that change while one looks: light that grows, textures under a limit, a lamp that was dimmed. A snapshot of any
//! moment of them holds, with the maps of the light at hand, without them, and with some of them damaged.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use foveal::illumination::bake::early_key;
use foveal::scene::edit::{Lamp, SceneEdit};
use foveal_actors::renderer::MARK_FRAME;
use foveal_files::bakes::save;
use foveal_runtime::{Limit, Snapshot};
use glam::Vec3;

use super::{How, Source};
use crate::light::BakeOptions;
use crate::options::{Options, Recording};
use crate::recording::{Elsewhere, light_beside};
use crate::{Engine, Light, Settings, kept_light, opened};

const TEXTURES: u64 = 24_000;

/// A textured floor and wall, a mirror, and a lamp above.
fn scene(folder: &Path) -> PathBuf {
    let picture = |name: &str, side: u32, of: fn(u32, u32) -> [u8; 3]| {
        let picture = image::RgbImage::from_fn(side, side, |x, y| image::Rgb(of(x, y)));
        picture.save(folder.join(name)).expect("a picture");
    };
    picture("floor.png", 128, |x, y| if (x / 8 + y / 8) % 2 == 0 { [220, 200, 160] } else { [60, 40, 30] });
    picture("wall.png", 64, |x, y| [(x * 4) as u8, (y * 4) as u8, (x * y) as u8]);
    let quad = |corners: [[f32; 3]; 4], first: usize, material: &str| {
        let places = corners.map(|[x, y, z]| format!("v {x} {y} {z}\n")).concat();
        let texels = ["vt 0 0\n", "vt 1 0\n", "vt 1 1\n", "vt 0 1\n"].concat();
        let face = (first..first + 4).map(|i| format!(" {i}/{i}")).collect::<String>();
        format!("{places}{texels}o {material}\nusemtl {material}\nf{face}\n")
    };
    let parts = [
        quad([[-2.0, 0.0, 2.0], [2.0, 0.0, 2.0], [2.0, 0.0, -2.0], [-2.0, 0.0, -2.0]], 1, "floor"),
        quad([[-2.0, 0.0, -2.0], [2.0, 0.0, -2.0], [2.0, 2.0, -2.0], [-2.0, 2.0, -2.0]], 5, "wall"),
        quad([[0.2, 0.3, 1.0], [1.2, 0.3, 1.0], [1.2, 0.3, 0.0], [0.2, 0.3, 0.0]], 9, "mirror"),
        quad([[-0.5, 2.0, -0.5], [0.5, 2.0, -0.5], [0.5, 2.0, 0.5], [-0.5, 2.0, 0.5]], 13, "lamp"),
    ];
    std::fs::write(folder.join("a.obj"), format!("mtllib a.mtl\n{}", parts.concat())).expect("written");
    let materials = "newmtl floor\nKd 0.8 0.8 0.8\nmap_Kd floor.png\nnewmtl wall\nKd 0.8 0.8 0.8\nmap_Kd wall.png\n\
                     newmtl mirror\nKd 0 0 0\nKs 0.9 0.9 0.9\nNs 1000\nillum 3\nnewmtl lamp\nKd 0 0 0\nKe 5 5 5\n";
    std::fs::write(folder.join("a.mtl"), materials).expect("written");
    folder.join("a.obj")
}

/// Records a walk to and fro, until its light is final, but so many frames at most.
fn recorded(folder: &Path, keeps_light: bool, frames: u32) -> PathBuf {
    let file = scene(folder);
    let cache = Some(folder.join("cache"));
    let settings =
        BakeOptions { texels: Some(800), particles: 1 << 12, error: 1e-4, ..BakeOptions::default() };
    let light = Light { settings, cache: cache.clone(), ..Light::default() };
    let lamp = opened::open(&file, &Light { quick: true, ..light.clone() }, &()).expect("a scene");
    let lamp = lamp.world.scene.materials.iter().position(|m| m.is_emissive()).expect("a lamp");
    let dimmed = SceneEdit::LampDimmed { lamp: Lamp::Material(lamp as u32), gain: Vec3::splat(0.5) };
    let light = Light { edits: vec![dimmed], ..light };
    let mut opened = opened::open(&file, &light, &()).expect("a scene");
    opened.limit_textures(Some(TEXTURES)).expect("a limit");
    assert!(opened.refinement.is_some() && opened.textures.is_some());
    let trace = folder.join("a.fvl");
    let options = Options {
        recording: Some(Recording::file(&trace, "test")),
        keeps_light,
        ..Options::new(Settings::new(48, 32, 2))
    };
    let mut walk = Engine::start(opened, options).expect("actors");
    let mut camera = walk.opened().world.scene.cameras[0].camera;
    for frame in 0..frames {
        // It stands now and then.
        if frame < 24 && frame % 5 != 4 {
            camera.eye += Vec3::new(0.05, 0.01, -0.02) * if frame < 12 { 1.0 } else { -1.0 };
        }
        walk.frame(&camera, Duration::from_millis(20)).expect("a frame");
        if frame >= 24 && walk.look(|r| r.is_lit()) == Some(true) {
            break;
        }
    }
    assert!(frames < 200 || walk.look(|r| r.is_lit()) == Some(true), "the light is final");
    drop(walk);
    trace
}

fn open(trace: &Path, cache: &Path) -> Source {
    let elsewhere = Elsewhere { cache: Some(cache.to_owned()), ..Elsewhere::default() };
    Source::open(trace, &elsewhere, true, &()).expect("a recording")
}

/// Replays to each frame and on from there; what is shown must be what was shown then.
fn seek_everywhere(source: &Source, step: usize) {
    let (mut whole, _) = source.system(How { threads: 2, ..How::default() }).expect("a system");
    let report = whole.replay();
    assert!(report.complete, "{:?}", report.divergence);
    // What was shown when it was recorded.
    let marks = source.trace.marks(source.renderer()).filter(|(_, kind, _)| *kind == MARK_FRAME);
    let pictures: Vec<(u32, u64)> = (0..).zip(marks.map(|(_, _, hash)| hash)).collect();
    assert_eq!(pictures.len(), source.shown_in.len());
    for (frame, hash) in pictures.into_iter().step_by(step) {
        let until = Some(source.frame_shown(frame).expect("a frame"));
        let threads = frame as usize % 3;
        let (mut there, actors) =
            source.run(How { threads, until, jump: true, ..How::default() }, |_| ()).expect("a replay");
        assert_eq!(there.replay_report().divergence, None, "frame {frame}");
        let shown = there.inspect(actors.renderer, |r| r.shown().map(|s| (s.index.0, s.hash))).flatten();
        assert_eq!(shown, Some((frame, hash)));
        let snapshot = there.snapshot().unwrap_or_else(|| panic!("frame {frame}: no snapshot"));
        let from = Snapshot::from_bytes(&snapshot.to_bytes()).map(Arc::new);
        let (mut after, _) = source.system(How { threads, from, ..How::default() }).expect("a system");
        let report = after.replay();
        assert_eq!(report.divergence, None, "after frame {frame}");
        assert!(report.complete && after.fingerprint() == whole.fingerprint(), "after frame {frame}");
    }
}

#[test]
fn a_walk_that_changes_goes_on_from_every_frame() {
    let folder = tempfile::tempdir().expect("a folder");
    let trace = recorded(folder.path(), true, 200);
    assert!(light_beside(&trace).exists());
    seek_everywhere(&open(&trace, &folder.path().join("cache")), 1);
    // Nothing was baked again.
    let made = std::fs::read_dir(folder.path().join("cache")).expect("a folder").flatten();
    assert_eq!(made.filter(|f| f.path().extension().is_some_and(|e| e == "fvlight")).count(), 0);
}

#[test]
fn a_walk_that_ends_while_its_light_grows_is_not_baked_again() {
    let folder = tempfile::tempdir().expect("a folder");
    let trace = recorded(folder.path(), true, 8);
    let source = open(&trace, &folder.path().join("cache"));
    // Afterwards it is stopped, and cannot be looked at.
    let until = Some(source.frame_shown(7).expect("a frame"));
    let (mut whole, actors) = source.system(How { until, ..How::default() }).expect("a system");
    whole.pump(Limit::IDLE);
    let illuminator = actors.illuminator.expect("an illuminator");
    assert_eq!(whole.inspect(illuminator, |i| i.has_baked()), Some(false));
    seek_everywhere(&source, 1);
}

#[test]
fn maps_that_are_missing_or_damaged_are_made_again() {
    let folder = tempfile::tempdir().expect("a folder");
    let trace = recorded(folder.path(), false, 200);
    let (light, cache) = (light_beside(&trace), folder.path().join("other"));
    assert!(!light.exists());
    seek_everywhere(&open(&trace, &cache), 9);
    // What was made again is a whole book, with which the next replay does not bake.
    let made = std::fs::read_dir(&cache).expect("a folder").flatten().map(|file| file.path());
    let made = made.filter(|f| f.extension().is_some_and(|e| e == "fvlight")).collect::<Vec<_>>();
    let [made] = &made[..] else { panic!("{made:?}") };
    let whole = std::fs::read(made).expect("maps");
    for at in [3, 50, 120, whole.len() / 2, whole.len() - 2] {
        let (mut bad, cache) = (whole.clone(), folder.path().join(format!("damaged-{at}")));
        bad[at] ^= 4;
        std::fs::write(&light, &bad).expect("written");
        seek_everywhere(&open(&trace, &cache), 31);
        std::fs::write(&light, &whole[..at]).expect("written");
        seek_everywhere(&open(&trace, &cache), 31);
    }
}

/// Rounds of the bake that an opened scene shows.
fn begun_in(opened: &opened::Opened) -> u32 {
    opened.refinement.as_ref().expect("it grows").begun
}

fn early_of(opened: &opened::Opened) -> PathBuf {
    opened.refinement.as_ref().and_then(|r| r.early.clone()).expect("a file")
}

/// Light that a walk through `file` with a folder of its own keeps.
fn keeping(folder: &Path, particles: u64) -> Light {
    let settings = BakeOptions { texels: Some(800), particles, error: 1e-4, ..BakeOptions::default() };
    Light { settings, cache: Some(folder.join("cache")), keeps_early: true, ..Light::default() }
}

#[test]
fn what_a_walk_finds_is_kept_while_it_goes_on() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = scene(folder.path());
    // It never comes to its end.
    let light = keeping(folder.path(), 1 << 40);
    let first = opened::open(&file, &light, &()).expect("a scene");
    assert_eq!(begun_in(&first), 0);
    let camera = first.world.scene.cameras[0].camera;
    let mut walk = Engine::start(first, Options::new(Settings::new(48, 32, 2))).expect("actors");
    let mut frames = 0;
    while begun_in(&opened::open(&file, &light, &()).expect("a scene")) == 0 {
        walk.frame(&camera, Duration::from_millis(20)).expect("a frame");
        frames += 1;
        assert!(frames < 2000, "nothing is kept");
    }
}

#[test]
fn a_second_walk_begins_in_the_light_of_the_first_and_replays_without_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = scene(folder.path());
    let light = keeping(folder.path(), 1 << 16);
    let first = opened::open(&file, &light, &()).expect("a scene");
    let camera = first.world.scene.cameras[0].camera;
    // As a walk before would have left it.
    let settings = light.settings.settings(&first.world.scene);
    let kept = kept_light::baked(first.world.indexed(), &settings, 2);
    assert_eq!(kept.summary.rounds, 2);
    let key = early_key(&first.world.scene, &settings);
    // The thread that keeps the first estimate may still be at it.
    while begun_in(&opened::open(&file, &light, &()).expect("a scene")) != 2 {
        save(&early_of(&first), &key, &kept).expect("kept");
    }

    let second = opened::open(&file, &light, &()).expect("a scene");
    assert_eq!(begun_in(&second), 2);
    let trace = folder.path().join("a.fvl");
    let options = Options {
        recording: Some(Recording::file(&trace, "test")),
        ..Options::new(Settings::new(48, 32, 2))
    };
    let early = early_of(&second);
    let mut walk = Engine::start(second, options).expect("actors");
    let mut frames = 0;
    while walk.look(|r| r.is_lit()) != Some(true) {
        walk.frame(&camera, Duration::from_millis(20)).expect("a frame");
        frames += 1;
        assert!(frames < 4000, "the light is final");
    }
    // Nobody begins with it any more, and what it came to is what a bake comes to.
    assert!(!early.exists());
    let found = walk.look(|r| r.world().illumination.stored().map(|map| map.digest())).flatten();
    let elsewhere = Light { cache: Some(folder.path().join("baked")), baked: true, ..light };
    let baked = opened::open(&file, &elsewhere, &()).expect("a scene").world.illumination;
    assert_eq!(found, baked.stored().map(|map| map.digest()));
    drop(walk);

    // From the maps beside the recording, and without anything.
    let step = (frames / 3).max(1);
    seek_everywhere(&open(&trace, &folder.path().join("beside")), step);
    std::fs::remove_file(light_beside(&trace)).expect("it was there");
    seek_everywhere(&open(&trace, &folder.path().join("nothing")), step);
}

#[test]
fn kept_light_that_is_damaged_is_made_anew() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = scene(folder.path());
    let light = keeping(folder.path(), 1 << 22);
    let first = opened::open(&file, &light, &()).expect("a scene");
    let early = early_of(&first);
    // A thread beside writes it.
    let until = std::time::Instant::now() + Duration::from_secs(60);
    while !early.exists() {
        assert!(std::time::Instant::now() < until, "nothing is kept");
        std::thread::yield_now();
    }
    let digest = |opened: &opened::Opened| opened.world.illumination.stored().map(|map| map.digest());
    let again = opened::open(&file, &light, &()).expect("a scene");
    assert_eq!(digest(&again), digest(&first));
    let mut bytes = std::fs::read(&early).expect("read");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&early, bytes).expect("written");
    let anew = opened::open(&file, &light, &()).expect("a scene");
    assert_eq!((digest(&anew), begun_in(&anew)), (digest(&first), 0));
}
