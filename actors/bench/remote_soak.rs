//! `foveal bench soak --tracers`: a walk whose samples a guest traces, in real time: the memory of both must stay as it is.

use std::time::{Duration, Instant};

use foveal_engine::failure::Failure;
use foveal_engine::interrupt::interrupted;
use foveal_engine::opened::{self, camera};
use foveal_engine::process::memory_bytes;
use foveal_engine::{Engine, Light, Options, Settings};
use foveal_terminal::progress::Progress;
use foveal_terminal::table::{Aim, Row, median};

use super::made::MadeScene;
use super::remote::{comes, door, guest};
use super::scaling::slope;

/// Time of a frame.
const FRAME: Duration = Duration::from_millis(100);
/// Looks at the memory.
const LOOKS: u32 = 200;

/// A walk of so long through a bundled scene, with a guest over `link`.
pub fn rows(
    scene: &str,
    (width, height): (u32, u32),
    link: &str,
    time: Duration,
    progress: Progress,
) -> Result<Vec<Row>, Failure> {
    let made = MadeScene::bundled(scene)?;
    let light = Light { quick: true, baked: true, ..Light::default() };
    let opened = opened::open(made.path(), &light, &())?;
    let still = camera(&opened.world.scene, None)?.camera;
    let path = opened.world.scene.paths.first().cloned();
    let settings = Settings { samples_per_job: 64, stations: 1, ..Settings::new(width, height, 1) };
    let door = door(&opened, link, &settings)?;
    let options = Options { outlets: Some(door.outlets()), ..Options::new(settings) };
    let mut engine = Engine::start(opened, options)?;
    door.attach(engine.station_inputs());
    let mut helper = guest(door.invitation(), &[], None)?;
    comes(&mut helper, || door.serving() > 0)?;
    let bar = progress.bar(u64::from(LOOKS), "soak");
    let (began, mut frames) = (Instant::now(), 0_u32);
    let mut memory: [Vec<(f64, f64)>; 2] = Default::default();
    while began.elapsed() < time && !interrupted() {
        let camera = match &path {
            Some(path) => path.at(0.1 * frames as f32 % path.duration().max(0.1), still.up, still.fov_y),
            None => still,
        };
        engine.frame(&camera, FRAME)?;
        frames += 1;
        let looks = memory[0].len() as u32;
        if began.elapsed() >= time * (looks + 1) / LOOKS {
            let of = [memory_bytes(), helper.memory_bytes()];
            for (memory, bytes) in memory.iter_mut().zip(of) {
                memory.push((began.elapsed().as_secs_f64(), bytes.map_or(f64::NAN, |bytes| bytes as f64)));
            }
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    let end = engine.finish(Duration::from_secs(10));
    let stations = engine.stations();
    let samples = stations.iter().map(|station| station.counts.samples).sum::<u64>() as f64;
    let jobs = engine.actors().pool.as_ref().map_or(f64::NAN, |pool| pool.stats().twice as f64);
    let minutes = began.elapsed().as_secs_f64() / 60.0;
    let name = format!("{scene}, {minutes:.1} min of {width} × {height} with a guest over {link}");
    let mut rows = vec![
        Row::new(format!("{name}: frames"), "", &[f64::from(frames)]),
        Row::new("  samples that came", "", &[samples]),
    ];
    for (who, memory) in ["walk", "guest"].iter().zip(&memory) {
        // What fills up once has filled up in the first half.
        let later = &memory[memory.len() / 2..];
        let level = median(&later.iter().map(|m| m.1).collect::<Vec<_>>()).unwrap_or(f64::NAN);
        let growth = slope(later) * began.elapsed().as_secs_f64() / 2.0;
        rows.push(Row::new(
            format!("  memory of the {who}, second half"),
            "MiB",
            &[level / f64::from(1 << 20)],
        ));
        rows.push(
            Row::new("  growth over the second half", "% of it", &[growth / level * 100.0])
                .aim(Aim::AtMost(1.0)),
        );
    }
    rows.push(Row::new("jobs that counted twice", "", &[jobs]).aim(Aim::AtMost(0.0)));
    rows.push(Row::new("messages that nobody got", "", &[end.dead_letters as f64]).aim(Aim::AtMost(0.0)));
    Ok(rows)
}
