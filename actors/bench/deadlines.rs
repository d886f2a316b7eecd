//! How late frames come while one walks, alone on the machine and beside threads that never sleep: there a walk has half of
//! it, and is to show less, not later.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use foveal::scene::CameraPath;

use super::made::MadeScene;
use foveal_engine::failure::Failure;
use foveal_engine::{Light, Recipe, Settings};
use foveal_terminal::table::{Aim, Row};

/// Scenes walked through.
const SCENES: [&str; 5] = ["table", "chess", "gallery", "duck", "box"];
/// Frames of each walk.
const FRAMES: u32 = 40;
/// Frames at its beginning that do not count: nothing is foreseen yet.
const FIRST: usize = 2;
/// Frames per second.
const FPS: f32 = 10.0;
/// Side of the picture.
const SIDE: u32 = 512;

/// One thread for each processor that never sleeps, until it is dropped.
struct Busy {
    ends: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Busy {
    fn new() -> Self {
        let ends = Arc::new(AtomicBool::new(false));
        let spin = || {
            let ends = ends.clone();
            std::thread::spawn(move || {
                // As another program's would be.
                foveal_runtime::be_patient();
                while !ends.load(Ordering::Relaxed) {}
            })
        };
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let threads = (0..cores).map(|_| spin()).collect();
        Self { ends, threads }
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// Frame by deadline of `runs` walks through each scene, alone and beside [`Busy`].
pub fn measure(runs: u32) -> Result<Vec<Row>, Failure> {
    let mut rows = Vec::new();
    for name in SCENES {
        let made = MadeScene::bundled(name)?;
        for (beside, p99) in [("", 1.1), (", beside busy threads", 1.25)] {
            let (mut frames, mut coarse) = (Vec::new(), 0);
            for _ in 0..runs.max(1) {
                let busy = (!beside.is_empty()).then(Busy::new);
                let walked = walk(&made)?;
                drop(busy);
                coarse += walked.iter().filter(|(_, is_coarse)| *is_coarse).count();
                frames.extend(walked.into_iter().map(|(late, _)| late));
            }
            let share = 100.0 * coarse as f64 / frames.len().max(1) as f64;
            let note = format!("{share:.0} % of frames drawn coarsely");
            frames.sort_unstable_by(f64::total_cmp);
            let at = |share: f64| frames[((frames.len() - 1) as f64 * share).round() as usize];
            rows.push(
                Row::new(format!("frame / deadline, {name}{beside}: median"), "", &[at(0.5)])
                    .aim(Aim::AtMost(1.0)),
            );
            rows.push(Row::new("  p99", "", &[at(0.99)]).against(note, None).aim(Aim::AtMost(p99)));
        }
    }
    Ok(rows)
}

/// How long each frame took beside its time, and whether it was drawn coarsely.
fn walk(made: &MadeScene) -> Result<Vec<(f64, bool)>, Failure> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from) as u32;
    let light = Light { quick: true, ..Light::default() };
    let recipe = Recipe { light, ..Recipe::new(made.path(), Settings::new(SIDE, SIDE, cores)) };
    let mut walk = recipe.walk(&())?;
    let scene = walk.opened().world.scene.clone();
    let path = scene.paths.iter().find(|path| path.name == "tour").or(scene.paths.first());
    let (Some(path), Some(start)) = (path, scene.cameras.first()) else {
        return Err(Failure::Input("the scene has no path".into()));
    };
    let mut frames = Vec::new();
    for frame in 0..FRAMES {
        let camera = CameraPath::at(path, frame as f32 / FPS, scene.up, start.camera.fov_y);
        let begun = Instant::now();
        walk.frame_until(&camera, Duration::from_secs_f32(1.0 / FPS), None, |_| false)?;
        let late = begun.elapsed().as_secs_f64() * f64::from(FPS);
        let cell = walk.look(|renderer| renderer.drawn().map(|drawn| drawn.drawn.cell())).flatten();
        frames.push((late, cell == Some(4)));
    }
    Ok(frames.split_off(FIRST))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn busy_threads_take_processor_time_and_end() {
        let before = foveal_engine::process::cpu_ns();
        let busy = Busy::new();
        std::thread::sleep(Duration::from_millis(30));
        drop(busy);
        let took = foveal_engine::process::cpu_ns() - before;
        assert!(took.is_nan() || took > 5e6, "{took} ns of all processors");
    }
}
