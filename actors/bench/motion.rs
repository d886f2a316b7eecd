//! How steady a picture is while one walks: each frame is carried over to the next along its depths and compared with
//! what is shown there, at borders of splats and elsewhere.

use std::time::Duration;

use foveal::image::Map2d;
use foveal::metrics::flip::flip_rgb8;
use foveal::scene::CameraPath;
use foveal::scene::camera::CameraFrame;

use super::made::MadeScene;
use foveal_actors::renderer::Renderer;
use foveal_engine::failure::Failure;
use foveal_engine::{Light, Recipe, Settings};
use foveal_terminal::table::Row;

/// Frames of the walk.
const FRAMES: u32 = 24;
/// Frames per second of the walk.
const FPS: f32 = 10.0;

/// One frame as it was shown.
struct ShownFrame {
    frame: CameraFrame,
    rgb8: Map2d<[u8; 3]>,
    depth: Map2d<f32>,
    /// 0 where nothing is corrected, 1 inside of splats, 2 where two of them meet on one object.
    places: Map2d<u8>,
}

/// Mean FLIP of the walk, and of the same walk where each view converges first.
pub fn measure() -> Result<Vec<Row>, Failure> {
    let made = MadeScene::bundled("table")?;
    let mut rows = Vec::new();
    let walked = walk(&made, false)?;
    let still = walk(&made, true)?;
    for (place, name) in [(2, "at borders of splats"), (1, "elsewhere in corrected pixels")] {
        let what = format!("temporal error {name}, {FRAMES} frames at {FPS} per second");
        let beside = ("each view converged".to_owned(), mean(&still, place));
        rows.push(
            Row::new(what, "FLIP", &mean(&walked, place).into_iter().collect::<Vec<f64>>())
                .against(beside.0, beside.1),
        );
    }
    Ok(rows)
}

/// The frames of a walk along the scene's path.
fn walk(made: &MadeScene, converges: bool) -> Result<Vec<ShownFrame>, Failure> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from) as u32;
    let light = Light { quick: true, ..Light::default() };
    let recipe = Recipe { light, ..Recipe::new(made.path(), Settings::new(320, 240, cores)) };
    let mut walk = recipe.walk(&())?;
    let scene = walk.opened().world.scene.clone();
    let (Some(path), Some(start)) = (scene.paths.first(), scene.cameras.first()) else {
        return Err(Failure::Input("the scene has no path".into()));
    };
    let mut frames = Vec::new();
    for frame in 0..FRAMES {
        let camera = CameraPath::at(path, frame as f32 / FPS, scene.up, start.camera.fov_y);
        let time = if converges { 60.0 } else { 1.0 / FPS };
        walk.frame_until(&camera, Duration::from_secs_f32(time), None, |r| converges && r.is_refined())?;
        frames.extend(walk.look(shown).flatten());
    }
    Ok(frames)
}

fn shown(renderer: &Renderer) -> Option<ShownFrame> {
    let (snapshot, drawn, layer) = (renderer.shown()?, renderer.drawn()?, renderer.layer());
    let object = &drawn.buffers().object;
    let (width, height) = (object.width(), object.height());
    let of = |x: usize, y: usize| (layer.shown_level(x, y), layer.shown_age(x, y));
    let places = Map2d::from_fn(width, height, |x, y| {
        let id = object.at(x, y);
        let meets = |x1: usize, y1: usize| {
            x1 < width && y1 < height && object.at(x1, y1) == id && of(x1, y1) != of(x, y)
        };
        match id {
            0 => 0,
            _ if meets(x + 1, y) || meets(x, y + 1) => 2,
            _ => 1,
        }
    });
    let rgb8 = (*snapshot.rgb8).clone();
    Some(ShownFrame { frame: drawn.frame, rgb8, depth: drawn.buffers().depth.clone(), places })
}

/// Mean FLIP of carried and shown frames, over pixels of a kind that were in sight before.
fn mean(frames: &[ShownFrame], place: u8) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0u32);
    for pair in frames.windows(2) {
        let (before, now) = (&pair[0], &pair[1]);
        let (width, height) = (now.rgb8.width(), now.rgb8.height());
        let carried: Vec<Option<[u8; 3]>> =
            (0..width * height).map(|i| carry(before, now, i % width, i / width)).collect();
        // What was out of sight is no error.
        let filled: Vec<[u8; 3]> =
            carried.iter().zip(now.rgb8.data()).map(|(carried, shown)| carried.unwrap_or(*shown)).collect();
        let error = flip_rgb8(now.rgb8.data().as_flattened(), filled.as_flattened(), width, height);
        for ((error, carried), of) in error.data().iter().zip(&carried).zip(now.places.data()) {
            if carried.is_some() && *of == place {
                sum += f64::from(*error);
                count += 1;
            }
        }
    }
    (count > 0).then(|| sum / f64::from(count))
}

/// What the frame before showed where a pixel sees now.
fn carry(before: &ShownFrame, now: &ShownFrame, x: usize, y: usize) -> Option<[u8; 3]> {
    let depth = now.depth.at(x, y);
    let direction = now.frame.direction(x as f32 + 0.5, y as f32 + 0.5);
    let point = now.frame.eye + direction * (depth / direction.dot(now.frame.forward));
    let (px, py, z) = before.frame.project(point).filter(|_| depth.is_finite())?;
    let inside =
        px >= 0.0 && py >= 0.0 && (px as usize) < now.rgb8.width() && (py as usize) < now.rgb8.height();
    let (px, py) = (px as usize, py as usize);
    (inside && (before.depth.at(px, py) - z).abs() < 0.02 * z).then(|| before.rgb8.at(px, py))
}
