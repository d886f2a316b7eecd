//! A walk whose pictures an adapter draws by itself.

use std::sync::Arc;
use std::time::{Duration, Instant};

use foveal::illumination::Uniform;
use foveal::splatting::supersampling::Supersampling;
use foveal::world::World;
use foveal_actors::renderer::overlay::Overlay;
use foveal_engine::navigation::{Motion, Pace};
use foveal_engine::walk::{Next, Walk};
use foveal_engine::{Engine, Opened, Options, Settings};
use glam::Vec3;

use crate::gpu::{Gpu, Mirror, readback, test_scene};

fn walk_of(settings: Settings) -> Walk {
    let world = World::new(Arc::new(test_scene::room(4)), Arc::new(Uniform(Vec3::ONE)));
    // So slow that even on a busy machine no view is drawn sparsely: the adapter draws them whole then.
    let options = Options { fps: Some(6.0), ..Options::interactive(settings) };
    let engine = Engine::start(Opened::of_world(world), options).expect("actors");
    Walk::new(Box::new(engine), 0.0)
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

/// Pixels of the mirror's picture that are not as the walk's, and of how many. Both show what came since the last frame,
/// too: on a busy machine that may be much.
fn differing(walk: &mut Walk, mirror: &mut Mirror) -> (usize, usize) {
    walk.set_mirrored(true);
    assert!(walk.draw_on(mirror));
    walk.fetch_picture();
    let picture = walk.picture().expect("a picture");
    let shown = readback::read(mirror.gpu(), mirror.picture().expect("drawn")).expect("an adapter");
    let pixels = picture.data().iter().zip(shown.chunks_exact(4));
    let is_off = |(a, b): &(&[u8; 3], &[u8])| (0..3).any(|c| a[c].abs_diff(b[c]) > 2);
    (pixels.filter(is_off).count(), picture.data().len())
}

#[test]
fn an_adapter_shows_the_same_picture_by_itself() {
    let Ok(gpu) = Gpu::headless() else { return };
    let rules = Supersampling { noise: 0.05, max_samples: 4 };
    let settings = Settings { supersampling: Some(rules), ..Settings::new(160, 120, 2) };
    let mut walk = walk_of(settings);
    walk.set_mirrored(true);
    let mut mirror = Mirror::new(gpu.clone());
    walk.navigator.set_pace(Pace::Slow, 0.0);
    walk.navigator.press(Motion::Right, 0.0);
    // A clock of its own: which views are compared must not depend on how busy the machine is.
    let (mut now, mut frames) = (0.0, 0);
    while frames < 12 {
        let (shown, next) = walk.tick(now);
        if shown {
            frames += 1;
            let (off, all) = differing(&mut walk, &mut mirror);
            // A few at edges of surfaces, where the rasteriser rounds otherwise than rays do.
            assert!(off * 1000 < all, "frame {frames}: {off} of {all} pixels differ");
        }
        if frames == 6 {
            walk.navigator.release(Motion::Right, now);
        }
        match next {
            Next::Input => break,
            Next::At(t) => now = t.max(now),
            Next::Now => now += 0.004,
        }
    }
    let start = Instant::now().checked_sub(Duration::from_secs_f64(now)).expect("a clock");
    settle(&mut walk, start);
    assert!(walk.status().refined);
    let (off, all) = differing(&mut walk, &mut mirror);
    assert!(off * 100 < all, "refined: {off} of {all} pixels differ");
    // Another adapter has to be told all of it again.
    let mut mirror = Mirror::new(gpu);
    assert_eq!(differing(&mut walk, &mut mirror).0, off);
    for _ in 1..Overlay::ALL.len() {
        walk.next_overlay();
        let (off, all) = differing(&mut walk, &mut mirror);
        assert!(off * 100 < all * 2, "{:?}: {off} of {all}", walk.controls().overlay);
    }
    let mut controls = *walk.controls();
    controls.overlay = Overlay::None;
    controls.set.refine = None;
    controls.set.tone.exposure = 0.5;
    walk.set_controls(controls);
    settle(&mut walk, start);
    let (off, all) = differing(&mut walk, &mut mirror);
    assert!(off * 100 < all, "darker, and not refined: {off} of {all} pixels differ");
}
