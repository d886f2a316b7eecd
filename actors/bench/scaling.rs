//! `foveal bench scaling`: how each stage grows with triangles, pixels, objects, samples, textures and workers, with
//! exponents fitted to the processor times, and memory beside them.

use std::hint::black_box;
use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::Args;
use foveal::allocation::knapsack::{Candidate, allocate};
use foveal::display::FrameBuffers;
use foveal::display::cpu_pass::{self, Passes};
use foveal::display::tone::{Encoder, ToneMap};
use foveal::geometry::{Accel, Ray};
use foveal::image::Map2d;
use foveal::perception::importance::{ObjectScan, SALIENCY_WEIGHT, priorities};
use foveal::perception::saliency::SaliencyModel;
use foveal::rng::Stream;
use foveal::splatting::{AgeingRules, Footprint, SampleCache, SplatLayer, warp};
use foveal::world::World;
use glam::Vec3;

use super::made::MadeScene;
use super::stages::{quick_world, stepped, traced};
use super::{remote, remote_batch};
use foveal_actors::renderer::Renderer;
use foveal_engine::failure::Failure;
use foveal_engine::files::make_folder;
use foveal_engine::opened::{Opened, camera, load_scene};
use foveal_engine::process::{cpu_ns, memory_bytes};
use foveal_engine::{Engine, Options, Settings};
use foveal_terminal::arguments::Size;
use foveal_terminal::progress::Progress;
use foveal_terminal::table::{Aim, CommonArguments, Row, finish, median, write_csv};

/// Arguments of `foveal bench scaling`.
#[derive(Args, Debug)]
pub struct ScalingArguments {
    /// Approximate numbers of triangles; the hall has at least 35,000, and ten million need about 4 GiB
    #[arg(long, value_name = "N,…", value_delimiter = ',', default_value = "35000,100000,300000,1000000")]
    triangles: Vec<usize>,
    /// Sides of the square pictures
    #[arg(long, value_name = "N,…", value_delimiter = ',', default_value = "128,256,512,1024")]
    sides: Vec<u32>,
    /// Numbers of tracers
    #[arg(long, value_name = "N,…", value_delimiter = ',', default_value = "1,2")]
    workers: Vec<u32>,
    /// Measure instead how much guests with one core each add over these links
    #[arg(long, value_name = "LINK,…", value_delimiter = ',', num_args = 0..=1, default_missing_value = "tcp,quic", value_parser = ["tcp", "quic"])]
    tracers: Vec<String>,
    /// Numbers of guests, at most 16; each has a core of its own if the machine has one core more than guests
    #[arg(
        long, value_name = "N,…", value_delimiter = ',', default_value = "1", requires = "tracers",
        value_parser = clap::value_parser!(u32).range(1..=16),
    )]
    guests: Vec<u32>,
    /// Measure instead how long a guest takes to receive a scene of 100 MiB
    #[arg(long, requires = "tracers")]
    join: bool,
    #[command(flatten)]
    common: CommonArguments,
}

/// Least squares of y = a + b·x; b.
pub fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let (mx, my) = (points.iter().map(|p| p.0).sum::<f64>() / n, points.iter().map(|p| p.1).sum::<f64>() / n);
    let (mut above, mut below) = (0.0, 0.0);
    for (x, y) in points {
        above += (x - mx) * (y - my);
        below += (x - mx) * (x - mx);
    }
    above / below
}

/// One quantity against one size.
struct ScalingCurve {
    what: String,
    unit: &'static str,
    /// Size and median.
    points: Vec<(f64, f64)>,
    /// Most that the exponent should be.
    aim: Option<f64>,
}

impl ScalingCurve {
    fn new(what: &str, unit: &'static str, aim: Option<f64>) -> Self {
        Self { what: what.into(), unit, points: Vec::new(), aim }
    }

    /// The b of y = a·xᵇ.
    fn exponent(&self) -> f64 {
        let logs: Vec<(f64, f64)> = self.points.iter().map(|(x, y)| (x.ln(), y.ln())).collect();
        slope(&logs)
    }

    fn rows(&self, out: &mut Vec<Row>) {
        for (x, y) in &self.points {
            out.push(Row::new(format!("{}: {x}", self.what), self.unit, &[*y]));
        }
        if self.points.len() > 1 {
            let row = Row::new(format!("{}: exponent", self.what), "", &[self.exponent()]);
            out.push(match self.aim {
                Some(aim) => row.aim(Aim::AtMost(aim)),
                None => row,
            });
        }
    }
}

/// Median milliseconds of processor time of several runs, the first one left out.
fn measure(runs: u32, mut work: impl FnMut()) -> f64 {
    let times: Vec<f64> = (0..runs + 1)
        .map(|_| {
            let start = cpu_ns();
            work();
            (cpu_ns() - start) * 1e-6
        })
        .collect();
    median(&times[1..]).unwrap_or(f64::NAN)
}

/// Runs the benchmark.
pub fn run(a: &ScalingArguments, progress: Progress) -> Result<(), Failure> {
    if !a.tracers.is_empty() {
        let apart = remote::keep_apart(a.guests.iter().copied().max().unwrap_or(1));
        let rows = match a.join {
            true => remote_batch::joins(&a.tracers, apart)?,
            false => {
                let mut rows = remote::rows(&a.tracers, &a.guests, a.common.runs, apart)?;
                rows.extend(remote_batch::rows(&a.tracers, &a.guests, a.common.runs, apart)?);
                rows
            }
        };
        let cores = if apart { "each kept to a core of its own" } else { "cores are shared" };
        let notes = vec![format!(
            "all on this machine, {cores}, over loopback: a network adds its round trip and its losses"
        )];
        return finish("scaling-tracers", &rows, &notes, &a.common);
    }
    let bar = progress.bar(5, "scaling");
    let mut curves = Vec::new();
    for part in [triangles, pixels, samples, objects] {
        curves.extend(part(a)?);
        bar.inc(1);
    }
    let mut rows = Vec::new();
    curves.iter().for_each(|c| c.rows(&mut rows));
    rows.extend(workers(a)?);
    bar.finish_and_clear();
    if let Some(out) = &a.common.out {
        make_folder(out)?;
        let points = curves.iter().flat_map(|c| c.points.iter().map(|p| (&c.what, c.unit, p)));
        write_csv(&out.join("scaling-points.csv"), "what,unit,size,value", points)?;
    }
    let notes =
        vec!["processor time of all threads; exponent b of y = a·xᵇ, least squares of logarithms".into()];
    finish("scaling", &rows, &notes, &a.common)
}

/// Rays between random points of the hall, above its floor.
fn hall_rays() -> Vec<Ray> {
    (0..200_000)
        .map(|i| {
            let mut s = Stream::new(5, i, 0);
            let at =
                Vec3::new(s.next_f32() * 14.0 - 7.0, 0.2 + 3.0 * s.next_f32(), s.next_f32() * 14.0 - 7.0);
            let d = Vec3::new(s.next_f32() - 0.5, s.next_f32() - 0.5, s.next_f32() - 0.5);
            Ray::new(at, d.try_normalize().unwrap_or(Vec3::X))
        })
        .collect()
}

fn triangles(a: &ScalingArguments) -> Result<Vec<ScalingCurve>, Failure> {
    let mut load = ScalingCurve::new("reading, triangles", "ms", None);
    let mut build = ScalingCurve::new("BVH, triangles", "ms", None);
    let mut size = ScalingCurve::new("memory of scene and BVH, triangles", "MiB", None);
    let mut display = ScalingCurve::new("display 512 × 512, triangles", "ms", None);
    let mut random = ScalingCurve::new("random rays, triangles", "ns per ray", Some(0.25));
    let mut shadow = ScalingCurve::new("shadow rays, triangles", "ns per ray", Some(0.25));
    let rays = hall_rays();
    for &count in &a.triangles {
        let before = memory_bytes();
        let made = MadeScene::hall(count)?;
        let n = made.triangles as f64;
        let start = cpu_ns();
        let scene = load_scene(made.path())?.0;
        load.points.push((n, (cpu_ns() - start) * 1e-6));
        let start = cpu_ns();
        let accel = Arc::new(Accel::build(&scene));
        build.points.push((n, (cpu_ns() - start) * 1e-6));
        if let (Some(before), Some(after)) = (before, memory_bytes()) {
            size.points.push((n, ((after as f64 - before as f64) / f64::from(1 << 20)).max(0.1)));
        }
        let per_ray = 1e6 / rays.len() as f64;
        let runs = a.common.runs;
        random.points.push((
            n,
            per_ray
                * measure(runs, || {
                    _ = black_box(rays.iter().filter(|r| accel.intersect(&scene, r).is_some()).count())
                }),
        ));
        let short: Vec<Ray> = rays.iter().map(|r| Ray { t_max: 2.0, ..*r }).collect();
        shadow.points.push((
            n,
            per_ray
                * measure(runs, || _ = black_box(short.iter().filter(|r| accel.occluded(&scene, r)).count())),
        ));
        let frame = camera(&scene, None)?.camera.frame(512, 512);
        let uniform = Arc::new(foveal::illumination::Uniform(Vec3::ONE));
        let lights = Arc::new(foveal::transport::light::Lights::build(&scene));
        let world = World::of(scene, accel, lights, uniform);
        let mut buffers = FrameBuffers::new(512, 512);
        display.points.push((
            n,
            measure(runs, || cpu_pass::draw(&world, &frame, Passes { texture_ids: false }, &mut buffers)),
        ));
    }
    Ok(vec![load, build, size, display, random, shadow])
}

fn pixels(a: &ScalingArguments) -> Result<Vec<ScalingCurve>, Failure> {
    let mut display = ScalingCurve::new("display, pixels", "ms", Some(1.05));
    let mut attention = ScalingCurve::new("attention, pixels", "ms", Some(1.05));
    let mut encode = ScalingCurve::new("tone mapping, pixels", "ms", Some(1.05));
    let world = quick_world(MadeScene::bundled("table")?.path())?;
    let view = camera(&world.scene, None)?.camera;
    for &side in &a.sides {
        let n = f64::from(side) * f64::from(side);
        let s = side as usize;
        let frame = view.frame(side, side);
        let mut buffers = FrameBuffers::new(s, s);
        let runs = a.common.runs;
        display.points.push((
            n,
            measure(runs, || cpu_pass::draw(&world, &frame, Passes { texture_ids: false }, &mut buffers)),
        ));
        let (encoder, tone) = (Encoder::default(), ToneMap::from(&world.scene.display));
        let mut bytes = Vec::new();
        encode.points.push((n, measure(runs, || encoder.encode(&tone, &buffers.color, &mut bytes))));
        let (mut model, mut scan, mut statistics) =
            (SaliencyModel::default(), ObjectScan::default(), Vec::new());
        attention.points.push((
            n,
            measure(runs, || {
                let map: &Map2d<f32> = &model.compute_rgb8(&bytes, s, s).map;
                scan.gather(&buffers.object, Some(map), world.scene.objects.len(), &mut statistics);
            }),
        ));
    }
    Ok(vec![display, encode, attention])
}

fn samples(a: &ScalingArguments) -> Result<Vec<ScalingCurve>, Failure> {
    let mut ageing = ScalingCurve::new("ageing, samples", "ms", Some(1.05));
    let mut warping = ScalingCurve::new("warp, samples", "ms", Some(1.05));
    let mut splatting = ScalingCurve::new("splat of warped samples, samples", "ms", Some(1.05));
    let world = quick_world(MadeScene::bundled("table")?.path())?;
    let first = camera(&world.scene, None)?.camera;
    let size = Size { width: 1024, height: 1024 };
    let second = stepped(&first, 1);
    let frame = second.frame(size.width, size.height);
    let mut buffers = FrameBuffers::new(1024, 1024);
    cpu_pass::draw(&world, &frame, Passes { texture_ids: false }, &mut buffers);
    let (_, batches) = traced(&world, &first, size, 1, 200_000);
    let batches: Vec<_> = batches.into_iter().map(Arc::new).collect();
    for wanted in [12_500, 25_000, 50_000, 100_000, 200_000] {
        let mut cache = SampleCache::new(400_000);
        let mut count = 0;
        for batch in &batches {
            if count >= wanted {
                break;
            }
            count += batch.len();
            cache.insert(batch.clone());
        }
        let n = count as f64;
        let runs = a.common.runs;
        // A copy must be aged each time; what the copy costs is taken off.
        let copying = measure(runs, || _ = black_box(cache.clone()));
        let both = measure(runs, || {
            let mut aged = cache.clone();
            aged.age(2, frame.eye, &AgeingRules::default(), |_| -1.0);
            black_box(&aged);
        });
        ageing.points.push((n, (both - copying).max(1e-4)));
        warping.points.push((n, measure(runs, || _ = black_box(warp(&cache, 2, &frame)))));
        let warped = warp(&cache, 2, &frame);
        let mut layer = SplatLayer::new(1024, 1024, 6, Footprint::Tile);
        splatting.points.push((
            n,
            measure(runs, || {
                layer.clear();
                black_box(layer.splat_warped(&warped, &buffers.object, &buffers.depth));
            }),
        ));
    }
    Ok(vec![ageing, warping, splatting])
}

fn objects(a: &ScalingArguments) -> Result<Vec<ScalingCurve>, Failure> {
    let mut ranking = ScalingCurve::new("ranking at 512 × 512, objects", "ms", Some(1.05));
    let mut deciding = ScalingCurve::new("deciding on textures, textures", "ms", Some(1.15));
    let mut scan = ObjectScan::default();
    let (mut statistics, mut out) = (Vec::new(), Vec::new());
    for count in [10u32, 100, 1000, 10_000] {
        let ids = Map2d::from_fn(512, 512, |x, y| (x / 5 + 103 * (y / 5)) as u32 % count);
        let ms = measure(a.common.runs, || {
            scan.gather(&ids, None, count as usize, &mut statistics);
            priorities(&statistics, 512, 512, SALIENCY_WEIGHT, &mut out);
            black_box(&out);
        });
        ranking.points.push((f64::from(count), ms));
        let item = |i: u32| {
            let mut s = Stream::new(1, u64::from(i), 0);
            let scale = 0.1 + s.next_f32();
            (0..8)
                .map(|level| Candidate {
                    cost: 1 << (2 * level),
                    quality: -f64::from(scale) / f64::from(1 + level),
                })
                .collect::<Vec<_>>()
        };
        let items: Vec<Vec<Candidate>> = (0..count).map(item).collect();
        let limit = u64::from(count) * 1000;
        let ms = measure(a.common.runs, || _ = black_box(allocate(&items, limit, None)));
        deciding.points.push((f64::from(count), ms));
    }
    Ok(vec![ranking, deciding])
}

/// Seconds until a view has converged: on the wall, and of all processors.
fn convergence(world: &World, tracers: u32, runs: u32) -> Result<[f64; 2], Failure> {
    let start = camera(&world.scene, None)?.camera;
    // Environment maps are work that is not repeated; without them every run has the same.
    let settings = Settings { environment_bytes: 0, ..Settings::new(384, 384, tracers) };
    // A frame a second has time to be drawn whole.
    let options = Options { fps: Some(1.0), ..Options::new(settings) };
    let mut walk = Engine::start(Opened::of_world(world.clone()), options)?;
    let (mut seconds, mut worked) = (Vec::new(), Vec::new());
    for run in 0..runs + 1 {
        // Far enough apart that nothing is carried along.
        let aside = (start.target - start.eye).cross(start.up).normalize_or_zero() * (0.2 * (run % 2) as f32);
        let camera = foveal::scene::Camera { eye: start.eye + aside, ..start };
        let (began, before) = (Instant::now(), cpu_ns());
        walk.begin(&camera)?;
        walk.work_until(Duration::from_secs(120), Renderer::is_converged)?;
        if walk.look(Renderer::is_converged) != Some(true) {
            return Err(Failure::Check(format!("{tracers} tracers: no view had converged after 120 s")));
        }
        seconds.push(began.elapsed().as_secs_f64());
        worked.push((cpu_ns() - before) * 1e-9);
        walk.end()?;
    }
    Ok([seconds, worked].map(|s| median(&s[1..]).unwrap_or(f64::NAN)))
}

fn workers(a: &ScalingArguments) -> Result<Vec<Row>, Failure> {
    let world = quick_world(MadeScene::bundled("table")?.path())?;
    let cores = std::thread::available_parallelism().map_or(1, usize::from) as u32;
    let mut rows: Vec<Row> = Vec::new();
    let mut one = None;
    for &tracers in &a.workers {
        if !(1..=64).contains(&tracers) {
            return Err(Failure::Usage("--workers: 1 to 64".into()));
        }
        let [seconds, worked] = convergence(&world, tracers, a.common.runs)?;
        let row = Row::new(format!("a view until it has converged, {tracers} tracers"), "s", &[seconds]);
        if tracers == 1 {
            one = Some(seconds);
        }
        rows.push(row);
        rows.push(Row::new("  processor time of it", "s", &[worked]));
        if let Some(one) = one.filter(|_| tracers > 1) {
            let row = Row::new(format!("  {tracers} tracers against 1"), "×", &[one / seconds]);
            rows.push(if tracers == 2 && cores >= 2 { row.aim(Aim::AtLeast(1.85)) } else { row });
        }
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponents_are_those_of_powers() {
        let mut curve = ScalingCurve::new("x", "ms", None);
        curve.points = [1.0f64, 10.0, 100.0].map(|x| (x, 3.0 * x.powf(0.7))).to_vec();
        assert!((curve.exponent() - 0.7).abs() < 1e-9);
        assert!((slope(&[(0.0, 1.0), (1.0, 3.0), (2.0, 5.0)]) - 2.0).abs() < 1e-12);
    }
}
