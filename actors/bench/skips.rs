//! `foveal bench skips`: what a scene saves that does not need a part of the machine; each beside the same with it.

use std::hint::black_box;
use std::sync::Arc;
use std::time::Duration;

use clap::Args;
use foveal::allocation::spatial_error::{SpatialErrors, SpatialSettings};
use foveal::display::FrameBuffers;
use foveal::display::cpu_pass::{self, Passes};
use foveal::display::environment_map::{capture, texel_count};
use foveal::display::first_approximation::Probes;
use foveal::display::tone::{Encoder, ToneMap};
use foveal::geometry::{Accel, Ray};
use foveal::rng::Stream;
use foveal::scene::{Camera, Model, Roughness};
use foveal::splatting::trace::{Owner, trace_samples};
use foveal::world::World;

use super::made::MadeScene;
use super::stages::{quick_world, stepped};
use foveal_actors::renderer::Renderer;
use foveal_engine::failure::Failure;
use foveal_engine::opened::{Opened, camera};
use foveal_engine::process::cpu_ns;
use foveal_engine::{Engine, Options, Settings};
use foveal_terminal::arguments::Size;
use foveal_terminal::progress::Progress;
use foveal_terminal::table::{Aim, CommonArguments, Row, finish};

/// Arguments of `foveal bench skips`.
#[derive(Args, Debug)]
pub struct SkipsArguments {
    /// Picture size
    #[arg(long, value_name = "WxH", default_value = "256x256")]
    size: Size,
    /// Frames per run
    #[arg(long, value_name = "N", default_value_t = 30, value_parser = clap::value_parser!(u32).range(2..=100_000))]
    frames: u32,
    #[command(flatten)]
    common: CommonArguments,
}

/// Milliseconds of processor time that `work` takes.
fn cpu_ms(work: impl FnOnce()) -> f64 {
    let start = cpu_ns();
    work();
    (cpu_ns() - start) * 1e-6
}

/// Runs the benchmark.
pub fn run(a: &SkipsArguments, progress: Progress) -> Result<(), Failure> {
    let bar = progress.bar(5, "skips");
    let mut rows = Vec::new();
    for part in [diffuse, still, textures, rays, maps] {
        rows.extend(part(a)?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    let notes = vec![
        "Times are processor time; each is compared with what the same costs with the part that is skipped."
            .into(),
    ];
    finish("skips", &rows, &notes, &a.common)
}

/// A walk whose frames end as soon as they can.
struct System(Engine);

impl System {
    fn start(a: &SkipsArguments, world: &World, whole: bool) -> Result<Self, Failure> {
        let options = Options { whole, ..Options::new(Settings::new(a.size.width, a.size.height, 1)) };
        Engine::start(Opened::of_world(world.clone()), options).map(Self)
    }

    fn frame(&mut self, camera: Camera, until: impl Fn(&Renderer) -> bool) {
        black_box(self.0.frame_until(&camera, Duration::from_secs(60), None, until).is_ok());
    }
}

/// A diffuse scene against the loop that draws and tone-maps it, and against all actors.
fn diffuse(a: &SkipsArguments) -> Result<Vec<Row>, Failure> {
    let world = quick_world(MadeScene::bundled("diffuse")?.path())?;
    let start = camera(&world.scene, None)?.camera;
    let tone = ToneMap::from(&world.scene.display);
    let (mut plain, mut alone, mut all) = (Vec::new(), Vec::new(), Vec::new());
    let (mut one, mut full) = (System::start(a, &world, false)?, System::start(a, &world, true)?);
    let per_frame = |ms: f64| ms / f64::from(a.frames);
    let mut buffers = FrameBuffers::new(a.size.width as usize, a.size.height as usize);
    let (encoder, mut bytes) = (Encoder::default(), Vec::new());
    for run in 0..a.common.runs + 1 {
        let at = |i: u32| stepped(&start, run * a.frames + i + 1);
        let measured = [
            cpu_ms(|| {
                for i in 0..a.frames {
                    let frame = at(i).frame(a.size.width, a.size.height);
                    cpu_pass::draw(&world, &frame, Passes { texture_ids: false }, &mut buffers);
                    encoder.encode(&tone, &buffers.color, &mut bytes);
                    black_box(xxhash_rust::xxh3::xxh3_64(&bytes));
                }
            }),
            cpu_ms(|| (0..a.frames).for_each(|i| one.frame(at(i), |_| true))),
            cpu_ms(|| (0..a.frames).for_each(|i| full.frame(at(i), |_| true))),
        ];
        if run > 0 {
            plain.push(per_frame(measured[0]));
            alone.push(per_frame(measured[1]));
            all.push(per_frame(measured[2]));
        }
    }
    let median = foveal_terminal::table::median;
    Ok(vec![
        Row::new("diffuse scene, a frame", "ms", &alone)
            .against("plain display loop", median(&plain))
            .aim(Aim::RatioAtMost(1.02)),
        Row::new("diffuse scene, a frame", "ms", &alone).against("with all actors", median(&all)),
    ])
}

/// A view that has converged.
fn still(a: &SkipsArguments) -> Result<Vec<Row>, Failure> {
    let world = quick_world(MadeScene::bundled("box")?.path())?;
    let start = camera(&world.scene, None)?.camera;
    let mut system = System::start(a, &world, false)?;
    system.frame(start, Renderer::is_converged);
    system.frame(start, |_| true);
    let (mut still, mut moving) = (Vec::new(), Vec::new());
    for run in 0..a.common.runs {
        system.frame(start, Renderer::is_converged);
        system.frame(start, |_| true);
        let frames = a.frames.max(100);
        let ms = cpu_ms(|| (0..frames).for_each(|_| system.frame(start, |_| true)));
        still.push(ms / f64::from(frames));
        moving.push(cpu_ms(|| system.frame(stepped(&start, run + 1), Renderer::is_converged)));
    }
    Ok(vec![
        Row::new("converged still view, a frame", "ms", &still)
            .against("a new view until it has converged", foveal_terminal::table::median(&moving))
            .aim(Aim::AtMost(0.2)),
    ])
}

/// Textures that fit.
fn textures(a: &SkipsArguments) -> Result<Vec<Row>, Failure> {
    let world = quick_world(MadeScene::bundled("gallery")?.path())?;
    let frame = camera(&world.scene, None)?.camera.frame(a.size.width, a.size.height);
    let mut buffers = FrameBuffers::new(a.size.width as usize, a.size.height as usize);
    let (mut without, mut with) = (Vec::new(), Vec::new());
    for run in 0..a.common.runs + 1 {
        for (texture_ids, times) in [(false, &mut without), (true, &mut with)] {
            let ms = cpu_ms(|| {
                for _ in 0..a.frames {
                    cpu_pass::draw(&world, &frame, Passes { texture_ids }, &mut buffers);
                }
            });
            if run > 0 {
                times.push(ms / f64::from(a.frames));
            }
        }
    }
    let errors: Vec<f64> = (0..a.common.runs.min(3))
        .map(|_| {
            cpu_ms(|| {
                for texture in &world.scene.textures {
                    let settings = SpatialSettings::new(30.0, world.scene.display.white_cd_m2);
                    black_box(SpatialErrors::of_texture(texture, &settings));
                }
            })
        })
        .collect();
    Ok(vec![
        Row::new("display, textures fit", "ms", &without)
            .against("with texture ids", foveal_terminal::table::median(&with)),
        Row::new("elevation maps at the start, textures fit", "ms", &[0.0])
            .against("under a limit", foveal_terminal::table::median(&errors)),
    ])
}

/// Rays of mirrors and of gloss, shadow rays with and without anything transparent.
fn rays(a: &SkipsArguments) -> Result<Vec<Row>, Failure> {
    let world = quick_world(MadeScene::bundled("box")?.path())?;
    let mut scene = (*world.scene).clone();
    for material in &mut scene.materials {
        if let Model::Mirror { specular } = &material.model {
            let roughness = Roughness { alpha_x: 0.15, alpha_y: 0.15, distribution: Default::default() };
            material.model = Model::Metal { specular: *specular, roughness };
        }
    }
    let rough = world.with_scene(Arc::new(scene));
    let view =
        world.scene.cameras.iter().find(|c| c.name == "mirror-ball").unwrap_or(&world.scene.cameras[0]);
    let frame = view.camera.frame(a.size.width, a.size.height);
    let mut buffers = FrameBuffers::new(a.size.width as usize, a.size.height as usize);
    cpu_pass::draw(&world, &frame, Passes { texture_ids: false }, &mut buffers);
    let is_mirror = |id: u32| {
        world.scene.objects.get(id as usize).is_some_and(|o| {
            matches!(world.scene.materials[o.material.0 as usize].model, Model::Mirror { .. })
        })
    };
    let pixels: Vec<(i32, i32)> = (0..a.size.height as i32)
        .flat_map(|y| (0..a.size.width as i32).map(move |x| (x, y)))
        .filter(|&(x, y)| is_mirror(buffers.object.at(x as usize, y as usize)))
        .collect();
    let trace = |world: &World| {
        let owner = Owner { view: 1, object: 1, k: 0 };
        let ms = cpu_ms(|| {
            black_box(trace_samples(world, &frame, &buffers, owner, pixels.iter().copied(), 0));
        });
        ms * 1e3 / pixels.len().max(1) as f64
    };
    let (mut mirror, mut gloss) = (Vec::new(), Vec::new());
    for _ in 0..a.common.runs {
        mirror.push(trace(&world));
        gloss.push(trace(&rough));
    }
    // Long rays through many vases: the first hit ends them, or every hit is looked at.
    let hall = super::stages::quick_world(MadeScene::hall(100_000)?.path())?;
    let accel: &Accel = &hall.accel;
    let shadow: Vec<Ray> = (0..100_000)
        .map(|i| {
            let mut s = Stream::new(3, i, 0);
            let mut at = |y: f32| glam::Vec3::new(s.next_f32() * 15.0 - 7.5, y, s.next_f32() * 15.0 - 7.5);
            let (from, to) = (at(0.3), at(0.5));
            Ray { t_max: 1.0, ..Ray::new(from, to - from) }
        })
        .collect();
    let (mut first, mut every) = (Vec::new(), Vec::new());
    for _ in 0..a.common.runs {
        let per_ray = 1e6 / shadow.len() as f64;
        let blocked = |ray: &&Ray| accel.occluded(&hall.scene, ray);
        first.push(per_ray * cpu_ms(|| _ = black_box(shadow.iter().filter(blocked).count())));
        let all = |ray: &&Ray| accel.any_hit(&hall.scene, ray, |_| false);
        every.push(per_ray * cpu_ms(|| _ = black_box(shadow.iter().filter(all).count())));
    }
    Ok(vec![
        Row::new("sample of a mirror, no gloss", "µs", &mirror)
            .against("distributed rays of gloss", foveal_terminal::table::median(&gloss)),
        Row::new("shadow ray, nothing transparent", "ns", &first)
            .against("looking at every hit", foveal_terminal::table::median(&every)),
    ])
}

/// The map of an object that is too small for one.
fn maps(a: &SkipsArguments) -> Result<Vec<Row>, Failure> {
    const SIDE: usize = 64;
    let world = quick_world(MadeScene::bundled("table")?.path())?;
    let probes = Probes::of_world(&world);
    let Some(probe) = probes.probes.get(1) else { return Ok(Vec::new()) };
    let times: Vec<f64> = (0..a.common.runs)
        .map(|_| {
            cpu_ms(|| {
                let texels = 0..texel_count(SIDE);
                black_box(capture(&world, &probes.split_sum, 1, probe.centre, SIDE, texels));
            })
        })
        .collect();
    Ok(vec![
        Row::new("environment map, object below a thousandth of the picture", "ms", &[0.0])
            .against(format!("capture of {SIDE} texels' side"), foveal_terminal::table::median(&times)),
    ])
}
