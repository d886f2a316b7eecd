//! `foveal bench scaling --tracers`: what tracers on other machines add to one here, as far as one machine can show it:
//! each guest is a process of its own with one core, over loopback.

use std::ffi::OsStr;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use foveal::scene::Camera;
use foveal::splatting::supersampling::Supersampling;
use foveal_actors::renderer::Renderer;
use foveal_actors::station::StationStatus;
use foveal_engine::failure::Failure;
use foveal_engine::opened::{self, Opened, camera};
use foveal_engine::process::cpu_ns;
use foveal_engine::source::FrameSource;
use foveal_engine::{Engine, Light, Options, Settings, Standing};
use foveal_remote::door::{Door, Letting};
use foveal_remote::key::{Invitation, Key};
use foveal_remote::package::Package;
use foveal_terminal::table::{Aim, Row, median};
use glam::Vec3;

use super::made::MadeScene;

/// Time that a guest has to come.
const COMES: Duration = Duration::from_secs(60);
/// Time that a view has to converge.
const CONVERGES: Duration = Duration::from_secs(120);

/// Time of a frame of a walk.
const WALKED: Duration = Duration::from_millis(100);
/// That of a still view: long, so that it is samples that are measured, not pictures, of which there are as many with guests
/// as without.
const STILL: Duration = Duration::from_secs(1);

/// A guest's process, which ends with this value.
pub(super) struct Guest(Child);

impl Guest {
    /// Resident memory of its process, where the system tells.
    pub fn memory_bytes(&self) -> Option<u64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.0.id())).ok()?;
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
        line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|k| k * 1024)
    }
}

impl Drop for Guest {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Keeps this thread, and what begins from it, to one core of the machine. Whether that can be done.
#[cfg(target_os = "linux")]
fn keep_to(core: usize) -> bool {
    use rustix::thread::{CpuSet, sched_setaffinity};
    let mut set = CpuSet::new();
    set.set(core);
    sched_setaffinity(None, &set).is_ok()
}

/// Not here.
#[cfg(not(target_os = "linux"))]
fn keep_to(_: usize) -> bool {
    false
}

/// Core 0 for this process, and those after it for so many guests.
pub(super) fn keep_apart(guests: u32) -> bool {
    std::thread::available_parallelism().is_ok_and(|cores| cores.get() > guests as usize) && keep_to(0)
}

/// Views until each has converged.
struct ConvergedViews {
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

pub(super) fn door(opened: &Opened, link: &str, settings: &Settings) -> Result<Door, Failure> {
    let key = Key::new().map_err(Failure::Environment)?;
    let address = format!("{link}/127.0.0.1:0");
    Door::open(&address, key, Package::of(opened)?, settings.k_max, settings.stations, Letting::default())
}

/// How far each view goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Until {
    Converged,
    /// By so many further samples of each pixel.
    Refined(u32),
}

/// With so many guests over a link.
fn walked(
    opened: &Opened,
    until: Until,
    (link, guests): (&str, u32),
    views: u32,
    apart: bool,
) -> Result<ConvergedViews, Failure> {
    let start = camera(&opened.world.scene, None)?.camera;
    let supersampling = match until {
        Until::Converged => None,
        Until::Refined(max_samples) => Some(Supersampling { noise: 1e-6, max_samples }),
    };
    let settings =
        Settings { environment_bytes: 0, stations: guests, supersampling, ..Settings::new(512, 512, 1) };
    let mut options = Options::new(settings);
    let mut door = None;
    if guests > 0 {
        let opened = self::door(opened, link, &settings)?;
        options.outlets = Some(opened.outlets());
        door = Some(opened);
    }
    let mut engine = Engine::start(opened.clone(), options)?;
    let mut come = Vec::new();
    if let Some(door) = &door {
        door.attach(engine.station_inputs());
        come = self::guests(guests, door.invitation(), apart, || door.serving())?;
    }
    let mut walked = ConvergedViews { seconds: Vec::new(), samples: 0.0, cpu_ns: 0.0, stations: Vec::new() };
    for number in 0..=views {
        let (began, before, camera) = (Instant::now(), cpu_ns(), aside(&start, number));
        let mut samples = 0.0;
        // In frames: what moves may be drawn sparsely, and is whole in the frame after.
        let mut time = WALKED;
        loop {
            let is_done =
                if until == Until::Converged { Renderer::is_converged } else { Renderer::is_refined };
            let frame = engine.frame_until(&camera, time, None, is_done)?;
            time = STILL;
            samples += f64::from(frame.counts.traced) + f64::from(frame.counts.refined);
            if frame.standing == Standing::Refined
                || until == Until::Converged && frame.standing != Standing::Growing
            {
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
    drop((engine, door, come));
    Ok(walked)
}

/// Starts a guest with one core, which is this one of the machine where cores are [kept apart](keep_apart).
pub(super) fn guest(invitation: &Invitation, more: &[&OsStr], core: Option<usize>) -> Result<Guest, Failure> {
    let environment = |what: String| Failure::Environment(what);
    let program =
        std::env::current_exe().map_err(|e| environment(format!("the program does not find itself: {e}")))?;
    // It inherits what this thread keeps to.
    let _ = core.is_some_and(keep_to);
    let child = Command::new(program)
        .args(["trace", "--once", "--quiet", "--cores", "1", "--join", &invitation.to_string()])
        .args(more)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .spawn();
    let _ = core.is_some() && keep_to(0);
    child.map(Guest).map_err(|e| environment(format!("no guest: {e}")))
}

/// Starts so many guests and waits until all of them are there.
pub(super) fn guests(
    count: u32,
    invitation: &Invitation,
    apart: bool,
    serving: impl Fn() -> u32,
) -> Result<Vec<Guest>, Failure> {
    let started = (1..=count as usize).map(|core| guest(invitation, &[], apart.then_some(core)));
    let mut guests = started.collect::<Result<Vec<_>, _>>()?;
    for guest in &mut guests {
        comes(guest, || serving() >= count)?;
    }
    Ok(guests)
}

/// Waits until a guest is there.
pub(super) fn comes(guest: &mut Guest, is_there: impl Fn() -> bool) -> Result<(), Failure> {
    let began = Instant::now();
    while !is_there() {
        if began.elapsed() > COMES || !matches!(guest.0.try_wait(), Ok(None)) {
            return Err(Failure::Environment("the guest does not come".to_owned()));
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    Ok(())
}

/// Kills a guest that has jobs: milliseconds until all of them are back.
fn killed(opened: &Opened, link: &str, apart: bool) -> Result<f64, Failure> {
    let start = camera(&opened.world.scene, None)?.camera;
    let settings = Settings { environment_bytes: 0, stations: 1, ..Settings::new(512, 512, 1) };
    let door = door(opened, link, &settings)?;
    let options = Options { outlets: Some(door.outlets()), ..Options::new(settings) };
    let mut engine = Engine::start(opened.clone(), options)?;
    door.attach(engine.station_inputs());
    let mut guest = guest(door.invitation(), &[], apart.then_some(1))?;
    comes(&mut guest, || door.serving() > 0)?;
    let out = |engine: &Engine| engine.status().stations.first().map_or(0, |station| station.jobs[0]);
    let (mut number, mut frames) = (0, 0);
    // Some frames, so that it is known how long its jobs take.
    while frames < 30 || out(&engine) == 0 {
        let frame = engine.frame(&aside(&start, number), WALKED)?;
        number += u32::from(frame.standing != Standing::Growing);
        frames += 1;
        if frames > 600 {
            return Err(Failure::Check("the guest has no jobs".into()));
        }
    }
    engine.begin(&aside(&start, number + 1))?;
    while out(&engine) == 0 {
        engine.work_until(Duration::from_micros(500), |_| false)?;
    }
    let began = Instant::now();
    // SIGKILL.
    let _ = guest.0.kill();
    while out(&engine) > 0 {
        engine.work_until(Duration::from_micros(200), |_| false)?;
    }
    let took = began.elapsed().as_secs_f64() * 1e3;
    engine.end()?;
    engine.finish(Duration::from_secs(10));
    Ok(took)
}

/// What so many guests are called in a row.
pub(super) fn helpers(guests: u32, link: &str) -> String {
    if guests == 1 {
        format!("and a guest of one core over {link}")
    } else {
        format!("and {guests} guests of one core over {link}")
    }
}

/// Measures numbers of guests over each link beside a walk without any.
pub fn rows(links: &[String], guests: &[u32], views: u32, apart: bool) -> Result<Vec<Row>, Failure> {
    let made = MadeScene::bundled("table")?;
    let light = Light { quick: true, baked: true, ..Light::default() };
    let opened = opened::open(made.path(), &light, &())?;
    let mut rows = views_of(&opened, Until::Converged, links, guests, (views, apart))?;
    rows.extend(views_of(
        &opened,
        Until::Refined(16),
        links.get(..1).unwrap_or_default(),
        guests,
        (1, apart),
    )?);
    for link in links {
        let back = (0..views.max(1)).map(|_| killed(&opened, link, apart)).collect::<Result<Vec<_>, _>>()?;
        let row =
            Row::new(format!("  a guest over {link}: from kill -9 until its jobs are back"), "ms", &back);
        rows.push(if link == "tcp" { row.aim(Aim::AtMost(50.0)) } else { row });
    }
    Ok(rows)
}

/// Views that go so far.
fn views_of(
    opened: &Opened,
    until: Until,
    links: &[String],
    guests: &[u32],
    (views, apart): (u32, bool),
) -> Result<Vec<Row>, Failure> {
    let alone = walked(opened, until, ("", 0), views, apart)?;
    let Some(own) = median(&alone.seconds) else { return Ok(Vec::new()) };
    let what = match until {
        Until::Converged => "table, a view until it has converged, one core".to_owned(),
        Until::Refined(samples) => {
            format!("table, a view refined by {samples} samples of each pixel, one core")
        }
    };
    let mut rows = vec![Row::new(what, "s", &alone.seconds)];
    let cost = alone.cpu_ns / alone.samples;
    rows.push(Row::new("  its processor time a sample", "CPU µs", &[cost * 1e-3]));
    for (link, &guests) in links.iter().flat_map(|link| guests.iter().map(move |guests| (link, guests))) {
        let with = walked(opened, until, (link, guests), views, apart)?;
        let name = format!("  {}", helpers(guests, link));
        rows.push(Row::new(&name, "s", &with.seconds));
        let of = |count: fn(&StationStatus) -> u64| with.stations.iter().map(count).sum::<u64>() as f64;
        // The first view's are among them.
        let remote = of(|s| s.counts.samples) * f64::from(views) / f64::from(views + 1);
        // What the host took beyond what its own samples cost it alone.
        let host = (with.cpu_ns - cost * (with.samples - remote)) / remote * 1e-3;
        let gains: Vec<f64> = with.seconds.iter().map(|seconds| own / seconds).collect();
        let gain = Row::new(format!("{name}: gain"), "×", &gains);
        rows.push(if guests == 1 { gain.aim(Aim::AtLeast(1.8)) } else { gain });
        // Of a refined view particles are counted among them, which cost another time.
        if until == Until::Converged {
            rows.push(Row::new(format!("{name}: share of samples"), "", &[remote / with.samples]));
            let time = Row::new(format!("{name}: host's time a sample from there"), "CPU µs", &[host]);
            rows.push(time.aim(Aim::AtMost(0.7)));
        }
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
