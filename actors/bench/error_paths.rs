//! Path tracing of full frames, the plainest alternative: no base light, no order, nothing kept from view to view.

use foveal::geometry::Ray;
use foveal::image::Map2d;
use foveal::scene::camera::CameraFrame;
use foveal::splatting::trace::pixel_stream;
use foveal::world::World;
use glam::Vec3;
use rayon::prelude::*;

use foveal_engine::interrupt::interrupted;
use foveal_engine::process::cpu_ns;
use foveal_engine::reference::path_picture;

/// Pictures of a still view with twice as many samples per pixel each time, until there are `most` or `shown`, which is
/// told the processor time so far, has seen enough.
pub(super) fn still(
    world: &World,
    frame: &CameraFrame,
    seed: u64,
    most: u32,
    mut shown: impl FnMut(f64, &Map2d<Vec3>) -> bool,
) {
    let [width, height] = frame.size.map(|s| s as usize);
    let (mut sum, mut count, mut seconds) = (Map2d::new(width, height, Vec3::ZERO), 0u32, 0.0);
    while count < most && !interrupted() {
        let more = count.max(1).min(most - count);
        let start = cpu_ns();
        let new = path_picture(world, frame, seed ^ u64::from(count) << 32, more, &|| !interrupted());
        seconds += (cpu_ns() - start) * 1e-9;
        for (sum, new) in sum.data_mut().iter_mut().zip(new.data()) {
            *sum += *new * more as f32;
        }
        count += more;
        if shown(seconds, &sum.map(|c| c / count as f32)) {
            break;
        }
    }
}

/// A frame of a walk.
pub(super) struct Frame {
    pub picture: Map2d<Vec3>,
    /// Paths per pixel.
    pub spp: f64,
}

/// What `seconds` of processor time are enough for, by what a path of this view was found to cost just before: whole
/// rounds of paths through all pixels, and the next round as far as it comes. Where not one round fits, square blocks of
/// pixels share a path.
pub(super) fn frame_in(world: &World, frame: &CameraFrame, seed: u64, seconds: f64) -> Frame {
    let pixels = frame.size[0] as usize * frame.size[1] as usize;
    let start = cpu_ns();
    let _ = path_picture(world, frame, !seed, 1, &|| true);
    let cost = (cpu_ns() - start) * 1e-9 / pixels.max(1) as f64;
    frame_of(world, frame, seed, (seconds / cost) as usize)
}

/// At most so many paths, but one.
fn frame_of(world: &World, frame: &CameraFrame, seed: u64, paths: usize) -> Frame {
    let [width, height] = frame.size.map(|s| s as usize);
    let pixels = width * height;
    let blocks = |side: usize| width.div_ceil(side) * height.div_ceil(side);
    let side =
        (1..=width.max(height)).find(|&side| blocks(side) <= paths).unwrap_or(width.max(height).max(1));
    let columns = width.div_ceil(side);
    let rounds = |block: usize| match side {
        1 => paths / pixels + usize::from(block < paths % pixels),
        _ => 1,
    };
    let radiance = |block: usize| {
        let [x, y] = [block % columns, block / columns].map(|i| i * side);
        let [w, h] = [side.min(width - x), side.min(height - y)].map(|s| s as f32);
        let mut sum = Vec3::ZERO;
        for sample in 0..rounds(block) {
            // As neighbours share numbers out among them, blocks are what is counted.
            let (column, row) = ((block % columns) as u32, (block / columns) as u32);
            let mut stream = pixel_stream(seed, column, row, sample as u64);
            let [dx, dy] = stream.next_2d();
            let direction = frame.direction(x as f32 + w * dx, y as f32 + h * dy);
            sum += world.path_radiance(&Ray::new(frame.eye, direction), stream.split(0));
        }
        sum / rounds(block).max(1) as f32
    };
    let traced: Vec<Vec3> = (0..blocks(side)).into_par_iter().map(radiance).collect();
    let picture = Map2d::from_fn(width, height, |x, y| traced[y / side * columns + x / side]);
    let paths: usize = (0..traced.len()).map(rounds).sum();
    Frame { picture, spp: paths as f64 / pixels.max(1) as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::made::MadeScene;
    use crate::stages::quick_world;

    /// A furnace: paths see the same light wherever they lead.
    fn furnace() -> (World, CameraFrame) {
        let scene = MadeScene::bundled("furnace").expect("a scene");
        let world = quick_world(scene.path()).expect("a world");
        let frame = world.scene.cameras[0].camera.frame(14, 9);
        (world, frame)
    }

    #[test]
    fn a_frame_takes_the_paths_that_it_may() {
        let (world, frame) = furnace();
        let pixels = 14 * 9;
        for paths in [0, 1, 5, 40, pixels - 1, pixels, pixels + 3, 3 * pixels + 1] {
            let made = frame_of(&world, &frame, 1, paths);
            let taken = (made.spp * pixels as f64).round() as usize;
            assert!(taken <= paths.max(1), "{taken} of {paths}");
            // Whole rounds and what is left of them are all taken; of blocks a share that squares allow.
            assert!(if paths >= pixels { taken == paths } else { 8 * taken >= paths }, "{taken} of {paths}");
            assert!(made.picture.data().iter().all(|c| c.is_finite()));
        }
    }

    /// The samples of a still view are all different, however they are counted: more are nearer to many.
    #[test]
    fn more_paths_are_nearer() {
        let scene = MadeScene::bundled("box").expect("a scene");
        let world = quick_world(scene.path()).expect("a world");
        let frame = world.scene.cameras[0].camera.frame(24, 18);
        let many = path_picture(&world, &frame, 7, 256, &|| true);
        let error = |picture: &Map2d<Vec3>| -> f32 {
            let squares = picture.data().iter().zip(many.data());
            // A firefly would say more than all others.
            squares.map(|(a, b)| (a.min(Vec3::ONE) - b.min(Vec3::ONE)).length_squared()).sum()
        };
        // 1, 2, 4, 8 and 12, summed over as many seeds as say more than chance.
        let mut errors = [0.0; 5];
        let (mut blocks, mut pixels) = (0.0, 0.0);
        for seed in 1..=6 {
            let mut shown = 0;
            still(&world, &frame, seed, 12, |seconds, picture| {
                assert!(seconds > 0.0);
                errors[shown] += error(picture);
                shown += 1;
                false
            });
            assert_eq!(shown, 5);
            blocks += error(&frame_of(&world, &frame, seed, 48).picture);
            pixels += error(&frame_of(&world, &frame, seed, 12 * 192).picture);
        }
        assert!(errors[4] < 0.5 * errors[0], "{errors:?}");
        assert!(blocks > errors[1] && pixels < blocks, "{errors:?} {blocks} {pixels}");
    }
}
