//! `foveal bench scaling --tracers`: what a tracer on another machine adds to one here, as far as one machine can show it:
//! the guest is a process of its own with one core, over loopback.

use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use foveal::scene::Camera;
use foveal_actors::renderer::Renderer;
use foveal_actors::station::StationStatus;
use foveal_engine::failure::Failure;
use foveal_engine::opened::{self, Opened, camera};
use foveal_engine::process::cpu_ns;
use foveal_engine::{Engine, Light, Options, Settings, Standing};
use foveal_remote::door::Door;
use foveal_remote::key::Key;
use foveal_remote::package::Package;
use foveal_terminal::table::{Aim, Row, median};
use glam::Vec3;

use super::made::MadeScene;

/// Time that a guest has to come.
const COMES: Duration = Duration::from_secs(60);
/// Time that a view has to converge.
const CONVERGES: Duration = Duration::from_secs(120);

/// Time of a frame.
const FRAME: Duration = Duration::from_millis(100);

/// A guest's process, which ends with this value.
struct Guest(Child);

impl Drop for Guest {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Views until each has converged.
struct Walked {
    /// Seconds of each.
    seconds: Vec<f64>,
    /// Samples of all of them.
    samples: f64,
    /// This process's time on its processors, nanoseconds.
    cpu_ns: f64,
    stations: Vec<StationStatus>,
}

/// A view aside from the scene's first, far enough that nothing is carried along.
fn aside(start: &Camera, number: u32) -> Camera {
    let right = (start.target - start.eye).cross(start.up).normalize_or(Vec3::X);
    Camera { eye: start.eye + right * (0.2 * (number % 2) as f32), ..*start }
}

fn walked(opened: &Opened, link: Option<&str>, views: u32) -> Result<Walked, Failure> {
    let start = camera(&opened.world.scene, None)?.camera;
    let stations = u32::from(link.is_some());
    let settings = Settings { environment_bytes: 0, stations, ..Settings::new(512, 512, 1) };
    let mut options = Options::new(settings);
    let mut door = None;
    if let Some(link) = link {
        let key = Key::new().map_err(Failure::Environment)?;
        let address = format!("{link}/127.0.0.1:0");
        let opened = Door::open(&address, key, Package::of(opened)?, settings.k_max, stations)?;
        options.outlets = Some(opened.outlets());
        door = Some(opened);
    }
    let mut engine = Engine::start(opened.clone(), options)?;
    let guest = door.as_ref().map(|door| {
        door.attach(engine.station_inputs());
        comes(door)
    });
    let guest = guest.transpose()?;
    let mut walked = Walked { seconds: Vec::new(), samples: 0.0, cpu_ns: 0.0, stations: Vec::new() };
    for number in 0..=views {
        let (began, before, camera) = (Instant::now(), cpu_ns(), aside(&start, number));
        let mut samples = 0.0;
        // In frames: what moves may be drawn coarsely, and is whole in the frame after.
        loop {
            let frame = engine.frame_until(&camera, FRAME, None, Renderer::is_converged)?;
            samples += f64::from(frame.counts.traced);
            if frame.standing != Standing::Growing {
                break;
            }
            if began.elapsed() > CONVERGES {
                return Err(Failure::Check(format!("view {number} does not converge")));
            }
        }
        // The first is where both sides learn how long jobs take.
        if number > 0 {
            walked.seconds.push(began.elapsed().as_secs_f64());
            walked.cpu_ns += cpu_ns() - before;
            walked.samples += samples;
        }
    }
    engine.finish(Duration::from_secs(10));
    walked.stations = engine.stations();
    drop((engine, door, guest));
    Ok(walked)
}

/// Starts a guest with one core, and waits for it.
fn comes(door: &Door) -> Result<Guest, Failure> {
    let environment = |what: String| Failure::Environment(what);
    let program =
        std::env::current_exe().map_err(|e| environment(format!("the program does not find itself: {e}")))?;
    let child = Command::new(program)
        .args(["trace", "--once", "--quiet", "--cores", "1", "--join", &door.invitation().to_string()])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .map_err(|e| environment(format!("no guest: {e}")))?;
    let mut guest = Guest(child);
    let began = Instant::now();
    while door.serving() == 0 {
        if began.elapsed() > COMES || !matches!(guest.0.try_wait(), Ok(None)) {
            return Err(environment("the guest does not come".to_owned()));
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    Ok(guest)
}

/// Measures each link beside a walk without guests.
pub fn rows(links: &[String], views: u32) -> Result<Vec<Row>, Failure> {
    let made = MadeScene::bundled("table")?;
    let light = Light { quick: true, baked: true, ..Light::default() };
    let opened = opened::open(made.path(), &light, &())?;
    let alone = walked(&opened, None, views)?;
    let Some(own) = median(&alone.seconds) else { return Ok(Vec::new()) };
    let mut rows = vec![Row::new("table, a view until it has converged, one tracer", "s", &alone.seconds)];
    for link in links {
        let with = walked(&opened, Some(link), views)?;
        let name = format!("  and a guest of one core over {link}");
        rows.push(Row::new(&name, "s", &with.seconds));
        let gains: Vec<f64> = with.seconds.iter().map(|seconds| own / seconds).collect();
        rows.push(Row::new(format!("{name}: gain"), "×", &gains).aim(Aim::AtLeast(1.8)));
        let of = |count: fn(&StationStatus) -> u64| with.stations.iter().map(count).sum::<u64>() as f64;
        // The first view's are among them.
        let remote = of(|s| s.counts.samples) * f64::from(views) / f64::from(views + 1);
        rows.push(Row::new(format!("{name}: share of samples"), "", &[remote / with.samples]));
        // What the host took beyond what its own samples cost it alone.
        let cost = alone.cpu_ns / alone.samples;
        let host = (with.cpu_ns - cost * (with.samples - remote)) / remote * 1e-3;
        rows.push(
            Row::new(format!("{name}: host's time a sample from there"), "CPU µs", &[host])
                .aim(Aim::AtMost(0.7)),
        );
        rows.push(Row::new(
            format!("{name}: jobs handed back, late or twice"),
            "",
            &[of(|s| s.counts.returned + s.counts.late)],
        ));
        let trip: Vec<f64> = with.stations.iter().map(|s| f64::from(s.round_trip) * 1e3).collect();
        rows.push(Row::new(format!("{name}: round trip beside the work"), "ms", &trip));
    }
    Ok(rows)
}
