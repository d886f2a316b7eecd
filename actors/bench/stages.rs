//! `foveal bench stages`: each stage of a frame alone, as in the first paper's §5.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use clap::Args;

use foveal::display::FrameBuffers;
use foveal::display::cpu_pass::{self, Passes};
use foveal::display::tone::{Encoder, ToneMap};
use foveal::geometry::Accel;
use foveal::illumination::bake::Baker;
use foveal::illumination::first::first_picture;
use foveal::image::Map2d;
use foveal::perception::importance::ObjectScan;
use foveal::perception::saliency::SaliencyModel;
use foveal::sampling::{Lattice, Rect};
use foveal::scene::{Camera, Scene};
use foveal::splatting::{
    AgeingRules, Footprint, Reconstruction, SampleBatch, SampleCache, SplatLayer, trace, warp,
};
use foveal::transport::Indexed;
use foveal::transport::light::Lights;
use foveal::world::World;
use foveal_files::{kept, load};
use glam::Vec3;
use rayon::prelude::*;

use super::made::MadeScene;
use super::mathematics;
use super::timed;
use foveal_engine::failure::Failure;
use foveal_engine::light::BakeOptions;
use foveal_engine::opened::{Opened, load_scene};
use foveal_engine::process::peak_memory_bytes;
use foveal_engine::{Engine, Options, Settings};
use foveal_terminal::arguments::Size;
use foveal_terminal::progress::Progress;
use foveal_terminal::table::{Aim, CommonArguments, Row, finish, median};

/// Arguments of `foveal bench stages`.
#[derive(Args, Debug)]
pub struct StagesArguments {
    /// Picture size
    #[arg(long, value_name = "WxH", default_value = "512x512")]
    size: Size,
    /// Triangles of the displayed hall
    #[arg(long, value_name = "N", default_value_t = 100_000)]
    triangles: usize,
    /// Triangles of the loaded hall
    #[arg(long, value_name = "N", default_value_t = 1_000_000)]
    load: usize,
    #[command(flatten)]
    common: CommonArguments,
}

/// Samples that the paper gives its times for.
const SAMPLES: usize = 50_000;

/// Runs the benchmark.
pub fn run(a: &StagesArguments, progress: Progress) -> Result<(), Failure> {
    let bar = progress.bar(8, "stages");
    let mut rows = Vec::new();
    let step = |rows: &mut Vec<Row>, made: Vec<Row>| {
        rows.extend(made);
        bar.inc(1);
    };
    // What is largest first, so that its memory is its own.
    let (load, halls_world) = loading(a)?;
    step(&mut rows, load);
    step(&mut rows, display(a, &halls_world)?);
    drop(halls_world);
    let glass = quick_world(MadeScene::bundled("table")?.path())?;
    step(&mut rows, display(a, &glass)?);
    step(&mut rows, samples(a, &glass)?);
    step(&mut rows, attention(a, &glass));
    step(&mut rows, correction(a, &glass)?);
    step(&mut rows, baking(a)?);
    step(&mut rows, mathematics::rows(a.common.runs));
    bar.finish_and_clear();
    let notes = vec![
        "What Haber et al. 2001 report for eight processors of their time is there for comparison; it is not a target."
            .into(),
        format!("Pictures have {} × {} pixels.", a.size.width, a.size.height),
    ];
    finish("stages", &rows, &notes, &a.common)
}

fn scene(file: &Path) -> Result<Arc<Scene>, Failure> {
    Ok(load_scene(file)?.0)
}

fn quick(scene: Arc<Scene>, accel: Arc<Accel>) -> World {
    let lights = Arc::new(Lights::build(&scene));
    let illumination = first_picture(Indexed { scene: &scene, accel: &accel, lights: &lights }, 1);
    World::of(scene, accel, lights, Arc::new(illumination))
}

/// A world of a scene file under the quick illumination.
pub fn quick_world(file: &Path) -> Result<World, Failure> {
    let scene = scene(file)?;
    let accel = Arc::new(Accel::build(&scene));
    Ok(quick(scene, accel))
}

/// Forgets the largest memory so far, where the system lets a process do so.
fn forget_peak_memory() -> bool {
    std::fs::write("/proc/self/clear_refs", "5").is_ok()
}

fn loading(a: &StagesArguments) -> Result<(Vec<Row>, World), Failure> {
    let hall = MadeScene::hall(a.load)?;
    let own_peak = forget_peak_memory();
    let (mut load_ms, mut build_ms, mut both) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..a.common.runs.min(3) {
        let (load, scene) = timed(|| scene(hall.path()));
        let scene = scene?;
        let (build, _accel) = timed(|| Accel::build(&scene));
        load_ms.push(load);
        build_ms.push(build);
        both.push((load + build) * 1e-3);
    }
    let own_peak_until_here = peak_memory_bytes();
    let (again, bytes) = second_start(&hall, a.common.runs.min(3))?;
    let peak: Vec<f64> =
        own_peak_until_here.filter(|_| own_peak).map(|b| b as f64 / f64::from(1 << 20)).into_iter().collect();
    let name = format!("{} triangles", hall.triangles);
    let rows = vec![
        Row::new(format!("load + BVH, {name}"), "s", &both).aim(Aim::AtMost(4.0)),
        Row::new("  of it reading", "ms", &load_ms),
        Row::new("  of it BVH", "ms", &build_ms),
        Row::new("  largest memory", "MiB", &peak).aim(Aim::AtMost(1536.0)),
        Row::new(format!("both as they were kept, {name}"), "s", &again).aim(Aim::AtMost(0.3)),
        Row::new("  kept", "MiB", &[bytes as f64 / f64::from(1 << 20)]),
    ];
    let shown = MadeScene::hall(a.triangles)?;
    Ok((rows, quick_world(shown.path())?))
}

/// Seconds that the second start takes to have scene and index, its files read again; and bytes of what is kept.
fn second_start(hall: &MadeScene, runs: u32) -> Result<(Vec<f64>, u64), Failure> {
    let failed = |e: &dyn std::fmt::Display| Failure::Environment(format!("a scene cannot be kept: {e}"));
    let made_by = [0; 32];
    let loaded = load::load(hall.path()).map_err(|e| failed(&e))?;
    let sources = loaded.sources.ok_or_else(|| failed(&"its files are not known"))?;
    let accel = Accel::build(&loaded.scene);
    let encoded = kept::encode(&made_by, &sources, &loaded.scene, &accel, &[]).map_err(|e| failed(&e))?;
    let file = hall.path().with_extension("fvscene");
    encoded.save(&file).map_err(|e| failed(&e))?;
    let length = encoded.bytes();
    drop(encoded);
    drop((loaded.scene, accel));
    let limit = load::LoadOptions::default().file_bytes_max;
    let mut seconds = Vec::new();
    for _ in 0..runs {
        let (ms, kept) = timed(|| kept::load(&made_by, &file, hall.path(), limit));
        kept.map_err(|e| failed(&e))?;
        seconds.push(ms * 1e-3);
    }
    Ok((seconds, length))
}

fn camera(world: &World) -> Result<Camera, Failure> {
    Ok(foveal_engine::opened::camera(&world.scene, None)?.camera)
}

/// The camera a step aside: enough for a new view, as in a walk.
pub fn stepped(camera: &Camera, step: u32) -> Camera {
    let aside = (camera.target - camera.eye).cross(camera.up).normalize_or_zero();
    let reach = (camera.target - camera.eye).length();
    Camera { eye: camera.eye + aside * (reach * 0.003 * step as f32), ..*camera }
}

fn display(a: &StagesArguments, world: &World) -> Result<Vec<Row>, Failure> {
    let frame = camera(world)?.frame(a.size.width, a.size.height);
    let mut buffers = FrameBuffers::new(a.size.width as usize, a.size.height as usize);
    let passes = Passes { texture_ids: false };
    let mut rays = 0;
    let mut drawn = |cell: u32| {
        let draw =
            |_| timed(|| rays = cpu_pass::draw_in_cells(world, &frame, passes, cell, &mut buffers).traced).0;
        let times: Vec<f64> = (0..a.common.runs + 1).map(draw).skip(1).collect();
        (times, rays)
    };
    let ((times, all), (sparse, some)) = (drawn(1), drawn(2));
    let triangles = world.scene.mesh.triangles.len();
    let lamps = if world.lights.has_any_named() { ", shadow rays to its lamps" } else { "" };
    Ok(vec![
        Row::new(format!("display, CPU pass, {triangles} triangles{lamps}"), "ms", &times)
            .aim(Aim::AtMost(20.0)),
        Row::new(
            format!("  drawn sparsely, {:.0} % of the rays", 100.0 * some as f64 / all as f64),
            "ms",
            &sparse,
        )
        .against("whole", median(&times)),
    ])
}

/// The first `count` samples of a view, level by level as a walk traces them.
pub fn traced(
    world: &World,
    camera: &Camera,
    size: Size,
    view: u32,
    count: usize,
) -> (FrameBuffers, Vec<SampleBatch>) {
    let frame = camera.frame(size.width, size.height);
    let mut buffers = FrameBuffers::new(size.width as usize, size.height as usize);
    cpu_pass::draw(world, &frame, Passes { texture_ids: false }, &mut buffers);
    let lattice = Lattice::new(6, [size.width as i32 / 2, size.height as i32 / 2]);
    let (mut batches, mut left) = (Vec::new(), count);
    for level in 1..=lattice.levels() {
        let mut pixels: Vec<(u32, (i32, i32))> = lattice
            .all_samples(level, Rect::of_size(size.width, size.height))
            .map(|(x, y)| (buffers.object.at(x as usize, y as usize), (x, y)))
            .filter(|(object, _)| *object != 0)
            .collect();
        pixels.truncate(left);
        left -= pixels.len();
        pixels.sort_by_key(|p| p.0);
        for of_object in pixels.chunk_by(|a, b| a.0 == b.0) {
            for job in of_object.chunks(256) {
                let owner = trace::Owner { view, object: job[0].0, k: lattice.k_of(level) };
                let pixels = job.iter().map(|p| p.1);
                batches.push(trace::trace_samples(world, &frame, &buffers, owner, pixels, 0));
            }
        }
    }
    (buffers, batches)
}

fn samples(a: &StagesArguments, world: &World) -> Result<Vec<Row>, Failure> {
    // Every glass close up: all samples that the paper's figures speak of, in one view.
    let first = camera(world)?;
    let (_, batches) = traced(world, &first, a.size, 1, SAMPLES);
    let count: usize = batches.iter().map(SampleBatch::len).sum();
    let mut cache = SampleCache::new(2 * SAMPLES);
    for batch in batches {
        cache.insert(Arc::new(batch));
    }
    let second = stepped(&first, 1);
    let frame = second.frame(a.size.width, a.size.height);
    let mut buffers = FrameBuffers::new(a.size.width as usize, a.size.height as usize);
    cpu_pass::draw(world, &frame, Passes { texture_ids: false }, &mut buffers);
    let (width, height) = (a.size.width as usize, a.size.height as usize);
    let mut layer = SplatLayer::new(width, height, 6, Footprint::Smooth);
    let mut shown = Map2d::new(width, height, Vec3::ZERO);
    let [mut age_ms, mut splat_ms, mut fresh_ms, mut linear_ms, mut between_ms] = [const { Vec::new() }; 5];
    let (_, fresh) = traced(world, &second, a.size, 2, SAMPLES);
    for _ in 0..a.common.runs {
        let mut aged = cache.clone();
        age_ms.push(timed(|| aged.age(2, frame.eye, &AgeingRules::default(), |_| -1.0)).0);
        layer.clear();
        let warp_and_splat = || {
            let warped = warp(&aged, 2, &frame);
            layer.splat_warped(&warped, &buffers.object, &buffers.depth)
        };
        splat_ms.push(timed(warp_and_splat).0);
        let splat = || fresh.iter().map(|b| layer.splat_fresh(b, &buffers.object, 1).1).sum::<u32>();
        fresh_ms.push(timed(splat).0);
        let between = Reconstruction::new(&layer, &buffers, &frame, 1.0);
        let linearly = |shown: &mut Map2d<Vec3>| {
            shown.data_mut().par_chunks_mut(width).enumerate().for_each(|(y, row)| {
                row.iter_mut().enumerate().for_each(|(x, light)| *light = between.pixel(x, y));
            });
        };
        linear_ms.push(timed(|| linearly(&mut shown)).0);
        between_ms.push(timed(|| between.fill(&mut shown, |_, _, light| light)).0);
    }
    let fresh_count: usize = fresh.iter().map(SampleBatch::len).sum();
    Ok(vec![
        Row::new(format!("ageing of {count} samples"), "ms", &age_ms)
            .against("paper", Some(7.5))
            .aim(Aim::AtMost(0.2)),
        Row::new(format!("warp + splat of {count} samples"), "ms", &splat_ms)
            .against("paper", Some(25.0))
            .aim(Aim::AtMost(2.5)),
        Row::new(format!("splat of {fresh_count} fresh samples"), "ms", &fresh_ms),
        Row::new(format!("what is shown between them, {width} × {height} pixels"), "ms", &between_ms)
            .aim(Aim::AtMost(6.0)),
        Row::new(format!("the same linearly, {width} × {height} pixels"), "ms", &linear_ms),
    ])
}

fn attention(a: &StagesArguments, world: &World) -> Vec<Row> {
    let Ok(camera) = camera(world) else { return Vec::new() };
    let frame = camera.frame(a.size.width, a.size.height);
    let mut buffers = FrameBuffers::new(a.size.width as usize, a.size.height as usize);
    cpu_pass::draw(world, &frame, Passes { texture_ids: false }, &mut buffers);
    let mut bytes = Vec::new();
    Encoder::default().encode(&ToneMap::from(&world.scene.display), &buffers.color, &mut bytes);
    let (mut model, mut scan, mut statistics) = (SaliencyModel::default(), ObjectScan::default(), Vec::new());
    let mut work = || {
        let map: &Map2d<f32> = &model.compute_rgb8(&bytes, a.size.width as usize, a.size.height as usize).map;
        scan.gather(&buffers.object, Some(map), world.scene.objects.len().max(1), &mut statistics);
    };
    let times: Vec<f64> = (0..a.common.runs + 1).map(|_| timed(&mut work).0).skip(1).collect();
    vec![
        Row::new("attention model, one core", "ms", &times)
            .against("paper", Some(300.0))
            .aim(Aim::AtMost(4.0)),
    ]
}

/// Samples that reach the screen in 50 ms after a view is drawn, all actors at work.
fn correction(a: &StagesArguments, world: &World) -> Result<Vec<Row>, Failure> {
    const WINDOW: Duration = Duration::from_millis(50);
    let cores = std::thread::available_parallelism().map_or(1, usize::from).min(2) as u32;
    let settings = Settings::new(a.size.width, a.size.height, cores);
    let mut walk = Engine::start(Opened::of_world(world.clone()), Options::new(settings))?;
    let start = camera(world)?;
    let mut counts = Vec::new();
    for run in 0..a.common.runs + 1 {
        walk.begin(&stepped(&start, run + 1))?;
        walk.work_until(WINDOW, |_| false)?;
        let frame = walk.end()?;
        if run > 0 {
            counts.push(f64::from(frame.counts.traced));
        }
    }
    Ok(vec![
        Row::new(format!("samples traced and splatted in 50 ms, glass, {cores} tracers"), "samples", &counts)
            .against("paper", Some(650.0))
            .aim(Aim::AtLeast(25_000.0)),
    ])
}

fn baking(a: &StagesArguments) -> Result<Vec<Row>, Failure> {
    let scene = scene(MadeScene::bundled("box")?.path())?;
    let accel = Accel::build(&scene);
    let lights = Lights::build(&scene);
    let indexed = Indexed { scene: &scene, accel: &accel, lights: &lights };
    let settings = BakeOptions::default().settings(&scene);
    let (mut seconds, mut errors) = (Vec::new(), Vec::new());
    for _ in 0..a.common.runs.min(3) {
        let (ms, baked) =
            timed(|| Baker::new(indexed, &settings).run(indexed, &|_: &_| true, &mut |_: &_| {}));
        seconds.push(ms * 1e-3);
        errors.push(f64::from(baked.illumination.summary.relative_error) * 100.0);
    }
    Ok(vec![
        Row::new("bake of the box to 2 % of irradiance", "s", &seconds).aim(Aim::AtMost(10.0)),
        Row::new("  error that it states in the end", "%", &errors).aim(Aim::AtMost(2.0)),
    ])
}
