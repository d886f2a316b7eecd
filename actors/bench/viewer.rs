//! `foveal bench viewer`: how soon the window shows something, how evenly frames come while one walks, what a view
//! costs once nothing changes, and a frame on the graphics adapter; how late frames come, also beside other work.

use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::{Args, ValueEnum};
use foveal::display::FrameBuffers;
use foveal::display::cpu_pass::{self, Passes};
use foveal::display::tone::ToneMap;
use foveal::scene::Camera;
use foveal::splatting::supersampling::Supersampling;
use foveal::splatting::{Footprint, WarpedSample};
use foveal::world::World;

use super::made::MadeScene;
use super::{deadlines, motion};
use foveal_actors::renderer::overlay::Overlay;
use foveal_engine::failure::Failure;
use foveal_engine::light::{BakeOptions, Light};
use foveal_engine::navigation::Motion;
use foveal_engine::opened;
use foveal_engine::process::cpu_ns;
use foveal_engine::walk::{Next, Walk};
use foveal_engine::{Recipe, Settings};
use foveal_terminal::arguments::Size;
use foveal_terminal::progress::Progress;
use foveal_terminal::table::{Aim, CommonArguments, Row, finish};
use foveal_window::Options;
use foveal_window::gpu::{Gpu, GpuDisplay, display};
use foveal_window::probe::Probe;

/// Arguments of `foveal bench viewer`.
#[derive(Args, Debug)]
pub struct ViewerArguments {
    /// Triangles of the hall shown in the window
    #[arg(long, value_name = "N", default_value_t = 300_000)]
    triangles: usize,
    /// Triangles of the hall drawn by the adapter
    #[arg(long, value_name = "N", default_value_t = 90_000)]
    drawn: usize,
    /// Picture size on the adapter
    #[arg(long, value_name = "WxH", default_value = "1280x720")]
    size: Size,
    /// What to measure
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = [Part::Adapter, Part::Baking, Part::Deadlines, Part::Motion, Part::Window])]
    what: Vec<Part>,
    #[command(flatten)]
    common: CommonArguments,
}

/// Parts of the benchmark.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Part {
    /// A frame on the graphics adapter
    Adapter,
    /// How long input waits while light is baked
    Baking,
    /// How late frames come, alone and beside threads that never sleep
    Deadlines,
    /// Error at the borders of splats
    Motion,
    /// The window
    Window,
}

/// Splats of a frame on the adapter.
const SAMPLES: usize = 50_000;
/// How long it walks.
const WALK: Duration = Duration::from_secs(6);
/// How long a still view is watched.
const IDLE: Duration = Duration::from_secs(5);

/// Runs the benchmark.
pub fn run(a: &ViewerArguments, progress: Progress) -> Result<(), Failure> {
    let bar = progress.bar(a.what.len() as u64, "viewer");
    let (mut rows, mut notes) = (Vec::new(), Vec::new());
    for part in &a.what {
        match part {
            Part::Adapter => match adapter(a) {
                Ok(made) => rows.extend(made),
                Err(e) => notes.push(format!("no frame on an adapter: {e}")),
            },
            Part::Baking => rows.extend(while_baking()?),
            Part::Deadlines => rows.extend(deadlines::measure(a.common.runs)?),
            Part::Motion => rows.extend(motion::measure()?),
            Part::Window => match in_window(a)? {
                Ok(made) => rows.extend(made),
                Err(e) => notes.push(format!("no window: {e}")),
            },
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    finish("viewer", &rows, &notes, &a.common)
}

fn quick(path: &std::path::Path) -> Result<World, Failure> {
    let light = Light { quick: true, ..Light::default() };
    Ok(opened::open(path, &light, &())?.world)
}

/// As many tracers as cores.
fn settings(width: u32, height: u32) -> Settings {
    let cores = std::thread::available_parallelism().map_or(1, usize::from) as u32;
    Settings::new(width, height, cores)
}

/// The first corrected pixels of a view, evenly over the picture.
fn splats(world: &World, camera: &Camera, size: Size) -> Vec<WarpedSample> {
    let frame = camera.frame(size.width, size.height);
    let mut buffers = FrameBuffers::new(size.width as usize, size.height as usize);
    cpu_pass::draw(world, &frame, Passes { texture_ids: false }, &mut buffers);
    let pixels: Vec<usize> =
        (0..buffers.object.data().len()).filter(|&i| buffers.object.data()[i] != 0).collect();
    let step = (pixels.len() / SAMPLES).max(1);
    let width = size.width as usize;
    let sample = |&i: &usize| WarpedSample {
        x: (i % width) as u16,
        y: (i / width) as u16,
        depth: buffers.depth.data()[i],
        depth_tolerance: 0.02 * buffers.depth.data()[i],
        color: glam::Vec3::splat(0.2),
        guide: glam::Vec3::NAN,
        object: buffers.object.data()[i],
        age: 1,
        half_side: 1,
        k: 2,
    };
    pixels.iter().step_by(step).take(SAMPLES).map(sample).collect()
}

/// A whole frame on the adapter, drawn and waited for.
fn adapter(a: &ViewerArguments) -> Result<Vec<Row>, String> {
    let gpu = Gpu::headless()?;
    let hall = MadeScene::hall(a.drawn).map_err(|e| e.to_string())?;
    let world = quick(hall.path()).map_err(|e| e.to_string())?;
    let start = world.scene.cameras.first().ok_or("the hall has no camera")?.camera;
    let samples = splats(&world, &start, a.size);
    let (name, software) = (gpu.info.to_string(), gpu.info.software);
    let size = [a.size.width, a.size.height];
    let passes = Arc::new(display::Passes::new(gpu));
    let mut display =
        GpuDisplay::new(passes, world.scene.clone(), &*world.illumination, size, 6, Footprint::Tile);
    let (mut wall, mut cpu, mut plain) = (Vec::new(), Vec::new(), Vec::new());
    for run in 0..2 * (a.common.runs + 2) {
        let with_splats = run % 2 == 0;
        let aside = (start.target - start.eye).cross(start.up).normalize_or_zero() * 1e-4 * run as f32;
        let camera = Camera { eye: start.eye + aside, ..start };
        let (begin, busy) = (Instant::now(), cpu_ns());
        display.begin_view(&camera.frame(a.size.width, a.size.height));
        if with_splats {
            display.splat_warped(&samples);
        }
        display.draw(&ToneMap::default(), Overlay::None);
        display.gpu().finish()?;
        let ms = begin.elapsed().as_secs_f64() * 1e3;
        // The first frames compile.
        if run >= 4 {
            let busy = (cpu_ns() - busy) * 1e-6;
            if with_splats {
                wall.push(ms);
                cpu.push(busy);
            } else {
                plain.push(busy);
            }
        }
    }
    let what =
        format!("GPU frame, {} triangles, {} splats, {}×{}", hall.triangles, samples.len(), size[0], size[1]);
    let aim = Aim::AtMost(if software { 60.0 } else { 2.0 });
    Ok(vec![
        Row::new(what, "ms", &wall).against(name, None).aim(aim),
        Row::new("  of it on all cores", "ms CPU", &cpu),
        Row::new("  the same without splats", "ms CPU", &plain),
    ])
}

/// Walks while the light is baked and everything is recorded: how long input waits for its frame.
fn while_baking() -> Result<Vec<Row>, Failure> {
    let made = MadeScene::bundled("table")?;
    let folder = made.path().with_extension("cache");
    let recorded = made.path().with_extension("fvl");
    let recipe = Recipe {
        light: Light { cache: Some(folder), ..Light::default() },
        record: Some(recorded),
        ..Recipe::new(made.path(), settings(320, 240))
    };
    let session = recipe.walk(&())?;
    let start = Instant::now();
    let mut walk = Walk::new(Box::new(session), 0.0);
    let (mut waits, mut camera, mut pressed) = (Vec::new(), None, None);
    loop {
        let now = start.elapsed().as_secs_f64();
        if now > WALK.as_secs_f64() {
            break;
        }
        // A key goes down and up every 0.37 s.
        let down = (now / 0.37) as u64 % 2 == 1;
        if down != walk.navigator.is_moving() {
            if down {
                walk.navigator.press(Motion::Right, now);
                pressed = Some(now);
            } else {
                walk.navigator.release(Motion::Right, now);
            }
        }
        let (_, next) = walk.tick(now);
        if walk.begun().copied() != camera {
            camera = walk.begun().copied();
            if let Some(at) = pressed.take() {
                waits.push((start.elapsed().as_secs_f64() - at) * 1e3);
            }
        }
        if let Next::At(t) = next {
            std::thread::sleep(Duration::from_secs_f64((t - now).clamp(0.0, 0.005)));
        }
    }
    let baking = !walk.status().lit;
    drop(walk);
    let largest = waits.iter().copied().fold(0.0, f64::max);
    let note = if baking { "light still bakes at the end" } else { "the bake ended meanwhile" };
    let period = 1e3 / 10.0;
    Ok(vec![
        Row::new("input → frame with its camera, baking and recording", "ms", &waits)
            .aim(Aim::AtMost(period)),
        Row::new("  the longest of them", "ms", &[largest])
            .against(note, None)
            .aim(Aim::AtMost(2.0 * period)),
    ])
}

/// The window itself, in a scene whose light is kept.
fn in_window(a: &ViewerArguments) -> Result<Result<Vec<Row>, String>, Failure> {
    let hall = MadeScene::hall(a.triangles)?;
    let folder = hall.path().with_extension("cache");
    let bake = BakeOptions { particles: 65536, error: 0.9, ..BakeOptions::default() };
    let light = Light { baked: true, cache: Some(folder), settings: bake, ..Light::default() };
    // Fills the cache.
    drop(opened::open(hall.path(), &light, &())?);
    let settings = Settings { supersampling: Some(Supersampling::default()), ..settings(512, 512) };
    let recipe = Recipe { light, ..Recipe::new(hall.path(), settings) };
    let options = Options { probe: Some(Probe::new(WALK, IDLE)), ..Options::new(recipe) };
    let measured = match foveal_window::run(options) {
        Ok(measured) => measured,
        Err(foveal_window::WindowError::Environment(e)) => return Ok(Err(e)),
        Err(foveal_window::WindowError::Scene(e)) => return Err(Failure::Input(e)),
        Err(foveal_window::WindowError::Ended(e)) => return Err(Failure::ended(&e)),
    };
    let seconds = |value: Option<f64>| value.into_iter().collect::<Vec<f64>>();
    let name = format!("{} triangles, light kept", hall.triangles);
    let ratio = |times: Option<(f32, f32)>| -> Vec<f64> {
        times.iter().map(|(median, p99)| f64::from(p99 / median)).collect()
    };
    let median = |times: Option<(f32, f32)>| -> Vec<f64> {
        times.iter().map(|(median, _)| f64::from(*median) * 1e3).collect()
    };
    Ok(Ok(vec![
        Row::new(format!("window visible, {name}"), "s", &seconds(measured.visible)).aim(Aim::AtMost(0.5)),
        Row::new("  first lit picture", "s", &seconds(measured.lit)).aim(Aim::AtMost(1.0)),
        Row::new("  frame while walking at 10 per second", "ms", &median(measured.frames)),
        Row::new("  its p99 / median", "", &ratio(measured.frames)).aim(Aim::AtMost(1.5)),
        Row::new("  from picture to picture in the window", "ms", &median(measured.pictures)),
        Row::new("  its p99 / median", "", &ratio(measured.pictures)).aim(Aim::AtMost(1.5)),
        Row::new(
            "still view, processor over 5 s",
            "%",
            &seconds(measured.idle_cpu.map(|share| share * 100.0)),
        )
        .aim(Aim::AtMost(0.1)),
        Row::new("  frames drawn in that time", "", &seconds(measured.idle_frames.map(f64::from)))
            .aim(Aim::AtMost(0.0)),
    ]))
}
