//! `foveal bench error`: how fast the error of the corrected pixels falls under each policy, standing still and walking.
//!
//! Every sample of every view is traced once, with its time; the policies then order the same samples, so that they
//! differ in nothing but their order, and time is the sum of what each object's samples were measured to cost.

use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::Args;
use rayon::prelude::*;

use foveal::allocation::jobs::job_pixels;
use foveal::allocation::policy::{Policy, RayPolicy};
use foveal::allocation::ray_order::{RayOrder, residual_of_batch};
use foveal::display::FrameBuffers;
use foveal::display::environment_map::{EnvironmentMap, capture, phong_exponent, texel_count};
use foveal::display::first_approximation::{FirstApproximation, Probes};
use foveal::display::tone::{Encoder, ToneMap};
use foveal::display::twin::{self, Passes};
use foveal::image::Map2d;
use foveal::metrics::curve::ErrorCurve;
use foveal::metrics::{flip, video};
use foveal::perception::importance::{ObjectScan, ObjectStatistics, Weights, priorities};
use foveal::perception::saliency::SaliencyModel;
use foveal::perception::tvi::TviTable;
use foveal::perception::viewing::Viewing;
use foveal::sampling::Lattice;
use foveal::scene::camera::CameraFrame;
use foveal::splatting::trace::{Owner, trace_samples};
use foveal::splatting::{AgeingRules, Footprint, Sample, SampleBatch, SampleCache, SplatLayer, warp};
use foveal::world::World;
use glam::Vec3;

use super::made::MadeScene;
use super::stages::quick_world;
use super::table::{Aim, CommonArguments, Row, finish};
use crate::cache_ager::angle_limit;
use crate::cli::Progress;
use crate::cli::arguments::Size;
use crate::cli::failure::Failure;
use crate::processor_time::cpu_ns;
use crate::settings::Settings;

/// Arguments of `foveal bench error`.
#[derive(Args, Debug)]
pub struct ErrorArguments {
    /// Whose error
    #[arg(long, value_enum, default_value_t = What::Corrections)]
    what: What,
    /// Seconds of all cores for each scene and method: --what illumination
    #[arg(long, value_name = "TIME", default_value = "10s", value_parser = crate::cli::arguments::duration)]
    time: Duration,
    /// Picture size
    #[arg(long, value_name = "WxH", default_value = "400x300")]
    pub(super) size: Size,
    /// Bundled scenes (default: box,duck,table,gallery,chess; of the illumination box,diffuse,table)
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    scenes: Vec<String>,
    /// Policies to compare; all: the first paper's, black mirrors and all; its attention on
    /// environment maps; attention as here, uniform, utility
    #[arg(long, value_name = "NAMES", value_delimiter = ',', default_value = "all")]
    pub(super) policies: Vec<String>,
    /// Frames of the walk, a tenth of a second apart
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(2..=1000))]
    frames: u32,
    /// Share of a view's samples that one frame of the walk has time for
    #[arg(long, value_name = "SHARE", default_value = "0.1", value_parser = crate::cli::arguments::unit)]
    share: f32,
    /// Show only the coarsest environment maps
    #[arg(long)]
    coarse_maps: bool,
    /// The time until still views look right, beside scan order, √5 order and path tracing of full frames; best with a
    /// small --size, since references take long
    #[arg(long)]
    pub(super) plain: bool,
    /// With --plain: samples per pixel of what corrections are held against; 1 is what a still view converges to, more
    /// have other random numbers
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    pub(super) traced_spp: u32,
    /// With --plain: samples per pixel of what paths are held against
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    pub(super) reference_spp: u32,
    /// With --plain: most samples per pixel of path tracing
    #[arg(long, value_name = "N", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    pub(super) path_spp: u32,
    #[command(flatten)]
    pub(super) common: CommonArguments,
}

/// Whose error is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum What {
    /// That of the pixels that need correction
    Corrections,
    /// That of the baked irradiance, by both methods
    Illumination,
}

/// Frames of the walk.
const FRAMES_PER_SECOND: f32 = 10.0;
/// Steps of the still view's curve.
const STEPS: u32 = 16;
/// Texels along an edge of the maps that a walk of some seconds would have captured.
const MAP_SIDE: usize = 64;

/// One of the orders that are compared.
#[derive(Clone)]
pub(super) struct Entrant {
    pub(super) name: String,
    pub(super) policy: RayPolicy,
    /// Without any first approximation, as both papers draw what is not diffuse.
    black: bool,
}

/// A view with all of its samples.
pub(super) struct Traced {
    frame: CameraFrame,
    pub(super) buffers: FrameBuffers,
    statistics: Vec<ObjectStatistics>,
    /// Index of each pixel's sample in its object's batch.
    index: Map2d<u32>,
    /// All samples, by object id.
    samples: Vec<SampleBatch>,
    /// Seconds per sample, by object id.
    pub(super) cost: Vec<f64>,
    pub(super) reference: Map2d<Vec3>,
    /// What the splat layer begins with.
    first: Map2d<Vec3>,
}

impl Traced {
    /// Seconds that all samples take.
    pub(super) fn seconds(&self) -> f64 {
        self.samples.iter().zip(&self.cost).map(|(s, c)| s.len() as f64 * c).sum()
    }
}

/// What one policy came to in one scene.
struct Result {
    still: f64,
    walking: f64,
    /// The walk beside its traced pictures, in just objectionable differences.
    jod: f32,
    curve: ErrorCurve,
    /// Share of time spent deciding.
    deciding: f64,
}

/// Runs the benchmark.
pub fn run(a: &ErrorArguments, progress: Progress) -> std::result::Result<(), Failure> {
    let names = |default: &str| match a.scenes.is_empty() {
        true => default.split(',').map(str::to_owned).collect(),
        false => a.scenes.clone(),
    };
    if a.what == What::Illumination {
        return super::illumination::run(
            &names("box,diffuse,table"),
            a.time.as_secs_f64(),
            &a.common,
            progress,
        );
    }
    let scenes: Vec<String> = names("box,duck,table,gallery,chess");
    if a.plain {
        return super::error_plain::run(a, &scenes, progress);
    }
    let entrants = policies(&a.policies)?;
    let bar = progress.bar(scenes.len() as u64, "scenes");
    let mut rows = Vec::new();
    let mut sums = vec![[0.0f64; 2]; entrants.len()];
    let mut csv = String::from("scene,policy,seconds,flip\n");
    let (mut deciding, mut worst) = (Vec::new(), 0.0f64);
    for name in &scenes {
        let world = quick_world(MadeScene::bundled(name)?.path())?;
        let study = Study::new(a, world);
        let results: std::result::Result<Vec<Result>, Failure> =
            entrants.par_iter().map(|e| study.run(a, e)).collect();
        let results = results?;
        for motion in 0..2 {
            let of = |r: &Result| [r.still, r.walking][motion];
            let best_other = entrants
                .iter()
                .zip(&results)
                .filter(|(e, _)| e.policy.policy != Policy::Utility)
                .map(|(_, r)| of(r))
                .fold(f64::INFINITY, f64::min);
            for (i, (entrant, result)) in entrants.iter().zip(&results).enumerate() {
                sums[i][motion] += of(result);
                let what = format!("{name}, {}: {}", ["still", "walking"][motion], entrant.name);
                let mut row = Row::new(what, "mean FLIP", &[of(result)]);
                if entrant.policy.policy == Policy::Utility {
                    row = row
                        .against("best other", Some(best_other).filter(|v| v.is_finite()))
                        .aim(Aim::RatioAtMost(1.05));
                    worst = worst.max(of(result) / best_other);
                    deciding.push(result.deciding);
                }
                rows.push(row);
            }
        }
        for (entrant, result) in entrants.iter().zip(&results) {
            rows.push(Row::new(
                format!("{name}, walking: {}", entrant.name),
                "JOD",
                &[f64::from(result.jod)],
            ));
            for (time, error) in result.curve.points() {
                csv += &format!("{name},{},{time},{error}\n", entrant.name);
            }
        }
        bar.inc(1);
    }
    let total = |name: &str| {
        let i = entrants.iter().position(|e| e.name == name)?;
        Some((sums[i][0] + sums[i][1]) / (2 * scenes.len()) as f64)
    };
    if let Some(utility) = total("utility") {
        for (peer, aim) in [("as published in 2001", 0.7), ("attention of 2001", 0.7), ("uniform", 0.8)] {
            if let Some(theirs) = total(peer) {
                let row = Row::new("all scenes, still and walking: utility", "mean FLIP", &[utility]);
                rows.push(row.against(peer, Some(theirs)).aim(Aim::RatioAtMost(aim)));
            }
        }
        rows.push(Row::new("share of time spent deciding: utility", "", &deciding).aim(Aim::AtMost(0.02)));
    }
    bar.finish_and_clear();
    let notes = vec![format!(
        "mean FLIP of the non-diffuse pixels over time, {}; a frame of the walk has time for {} of its samples",
        if a.coarse_maps { "before environment maps are captured" } else { "with environment maps" },
        a.share
    )];
    if let Some(out) = &a.common.out {
        crate::cli::output::make_folder(out)?;
        crate::cli::output::write_atomic(&out.join("error-curves.csv"), csv.as_bytes())?;
    }
    finish("error", &rows, &notes, &a.common)
}

/// The orders by their names.
pub(super) fn policies(names: &[String]) -> std::result::Result<Vec<Entrant>, Failure> {
    let of = |name: &str, policy: RayPolicy| Entrant { name: name.to_owned(), policy, black: false };
    let paper = RayPolicy { reduction: RayPolicy::HABER_REDUCTION, ..RayPolicy::new(Policy::Attention, 0) };
    let published = Entrant { black: true, ..of("as published in 2001", paper) };
    let mut all = vec![published, of("attention of 2001", paper)];
    for policy in [Policy::Attention, Policy::Uniform, Policy::Utility] {
        all.push(of(policy.name(), RayPolicy::new(policy, 0)));
    }
    if names.iter().any(|n| n == "all") {
        return Ok(all);
    }
    let one = |name: &String| {
        let policy: Policy = name.parse().map_err(Failure::Usage)?;
        Ok(of(policy.name(), RayPolicy::new(policy, 0)))
    };
    names.iter().map(one).collect()
}

impl Entrant {
    /// All pixels level by level over nothing, as a plain ray tracer would on this lattice.
    pub(super) fn plain_lattice() -> Self {
        Self { name: "√5 order".into(), policy: RayPolicy::new(Policy::Uniform, 0), black: true }
    }
}

/// A scene with all views traced.
pub(super) struct Study {
    world: World,
    tone: ToneMap,
    views: Vec<Traced>,
    limits: Vec<f32>,
    settings: Settings,
}

impl Study {
    fn new(a: &ErrorArguments, world: World) -> Self {
        let still = world.scene.cameras[0].camera;
        let camera = |i: u32| match world.scene.paths.first() {
            Some(path) => path.at(i as f32 / FRAMES_PER_SECOND, still.up, still.fov_y),
            None => still,
        };
        let cameras = (0..a.frames).map(camera).collect();
        Self::of_cameras(a, world, cameras, a.coarse_maps)
    }

    /// The start view, before environment maps are captured.
    pub(super) fn of_view(a: &ErrorArguments, world: World) -> Self {
        let still = world.scene.cameras[0].camera;
        Self::of_cameras(a, world, vec![still], true)
    }

    /// Its first view.
    pub(super) fn first_view(&self) -> &Traced {
        &self.views[0]
    }

    fn of_cameras(
        a: &ErrorArguments,
        world: World,
        cameras: Vec<foveal::scene::Camera>,
        coarse_maps: bool,
    ) -> Self {
        let settings = Settings::new(a.size.width, a.size.height, 1);
        let probes = Arc::new(Probes::of_world(&world));
        let mut first = FirstApproximation::new(probes.clone());
        if !coarse_maps {
            let map = |(id, object): (usize, &foveal::scene::Object)| {
                let model = &world.scene.materials[object.material.0 as usize].model;
                let (exponent, centre) = (phong_exponent(model.lobe_alpha()), probes.probes[id].centre);
                let texels = 0..texel_count(MAP_SIDE);
                let seen = capture(&world, &probes.split_sum, id as u32, centre, MAP_SIDE, texels);
                Arc::new(EnvironmentMap::of_capture(centre, MAP_SIDE, &seen, exponent))
            };
            let objects: Vec<_> = world.scene.objects.iter().enumerate().skip(1).collect();
            let maps: Vec<_> = objects.into_par_iter().map(map).collect();
            for (i, map) in maps.into_iter().enumerate() {
                first.set(i as u32 + 1, Some(map));
            }
        }
        let views = cameras.into_iter().map(|c| traced(&world, &first, c, &settings)).collect();
        let limits = world.scene.objects.iter().map(|o| angle_limit(&world, o.material)).collect();
        Self { tone: ToneMap::from(&world.scene.display), world, views, limits, settings }
    }

    fn run(&self, a: &ErrorArguments, entrant: &Entrant) -> std::result::Result<Result, Failure> {
        let mut walk = Walk::new(self, entrant);
        let view = &self.views[0];
        walk.begin(1, view);
        let total = view.seconds();
        let mut curve = ErrorCurve::new(walk.error(view));
        for step in 1..=STEPS {
            let until = total * f64::from(step) / f64::from(STEPS);
            walk.attend(view);
            walk.correct(view, until);
            curve.push(until, walk.error(view));
        }
        let still = curve.area(total) * curve.points()[0].1;
        let mut walk = Walk { deciding: walk.deciding, traced: walk.traced, ..Walk::new(self, entrant) };
        let (mut sum, mut shown) = (0.0, Vec::new());
        for (i, view) in self.views.iter().enumerate() {
            walk.begin(i as u32 + 1, view);
            walk.correct(view, f64::from(a.share) * view.seconds());
            sum += walk.error(view);
            shown.push(walk.picture(view));
            walk.attend(view);
        }
        let walking = sum / self.views.len() as f64;
        let deciding = walk.deciding / (walk.deciding + walk.traced);
        let display = &self.world.scene.display;
        let camera = &self.world.scene.cameras[0].camera;
        let fov_x = 2.0 * ((0.5 * camera.fov_y).tan() * a.size.width as f32 / a.size.height as f32).atan();
        let viewing = Viewing::from_centre_of_projection(display.white_cd_m2, a.size.width as usize, fov_x);
        let references: Vec<_> = self.views.iter().map(|v| v.reference.clone()).collect();
        let jod = video::jod(&shown, &references, FRAMES_PER_SECOND, &self.tone, &viewing)
            .map_err(Failure::Check)?;
        Ok(Result { still, walking, jod, curve, deciding })
    }
}

/// Traces all samples of a view, object by object.
fn traced(world: &World, first: &FirstApproximation, camera: foveal::scene::Camera, s: &Settings) -> Traced {
    let frame = camera.frame(s.width, s.height);
    let (width, height) = (s.width as usize, s.height as usize);
    let mut buffers = FrameBuffers::new(width, height);
    twin::draw(world, &frame, Passes { texture_ids: false }, &mut buffers);
    let mut approximation = Map2d::new(width, height, Vec3::ZERO);
    first.draw(world, &frame, &buffers, &mut approximation);
    let mut statistics = Vec::new();
    ObjectScan::default().gather(&buffers.object, None, world.scene.objects.len(), &mut statistics);
    let of_object = |id: usize| {
        let s = &statistics[id];
        let pixels = (s.y0 as i32..s.y1 as i32).flat_map(|y| (s.x0 as i32..s.x1 as i32).map(move |x| (x, y)));
        let pixels =
            pixels.filter(|&(x, y)| id > 0 && buffers.object.at(x as usize, y as usize) == id as u32);
        let owner = Owner { view: 0, object: id as u32, k: 0 };
        // Processor time: what else the machine does is none of the policies' business.
        let start = cpu_ns();
        let batch = trace_samples(world, &frame, &buffers, owner, pixels, 0);
        let cost = 1e-9 * (cpu_ns() - start) / batch.len().max(1) as f64;
        (batch, cost)
    };
    let (samples, cost): (Vec<_>, Vec<_>) = (0..statistics.len()).map(of_object).unzip();
    let mut index = Map2d::new(width, height, u32::MAX);
    let mut reference = buffers.color.clone();
    for batch in &samples {
        for (i, (pixel, color)) in batch.pixels.iter().zip(&batch.colors).enumerate() {
            let (x, y) = (usize::from(pixel[0]), usize::from(pixel[1]));
            *index.at_mut(x, y) = i as u32;
            *reference.at_mut(x, y) += *color;
        }
    }
    Traced { frame, buffers, statistics, index, samples, cost, reference, first: approximation }
}

/// Seconds since `start`, of a decision of some microseconds. Longer than a millisecond it was something else: the
/// machine's other work. (A clock of the processor's time would cost more than what is measured.)
fn undisturbed(start: Instant) -> f64 {
    let seconds = start.elapsed().as_secs_f64();
    if seconds < 1e-3 { seconds } else { 0.0 }
}

/// One policy on its way.
pub(super) struct Walk<'s> {
    study: &'s Study,
    black: bool,
    order: RayOrder,
    layer: SplatLayer,
    cache: SampleCache,
    lattice: Lattice,
    model: SaliencyModel,
    saliency: Vec<f32>,
    attention: Vec<f32>,
    thresholds: TviTable,
    encoder: Encoder,
    view: u32,
    /// Seconds of samples of the view.
    time: f64,
    /// Seconds of deciding.
    deciding: f64,
    /// Seconds of all samples.
    traced: f64,
}

impl<'s> Walk<'s> {
    pub(super) fn new(study: &'s Study, entrant: &Entrant) -> Self {
        let s = &study.settings;
        let (width, height) = (s.width as usize, s.height as usize);
        let lattice = s.lattice();
        Self {
            order: RayOrder::new(entrant.policy, false, lattice, s.samples_per_job, width * height),
            layer: SplatLayer::new(width, height, s.k_max, Footprint::Tile),
            cache: SampleCache::new(s.cache_capacity),
            lattice,
            model: SaliencyModel::default(),
            saliency: Vec::new(),
            attention: Vec::new(),
            thresholds: TviTable::default(),
            encoder: Encoder::default(),
            view: 0,
            time: 0.0,
            deciding: 0.0,
            traced: 0.0,
            study,
            black: entrant.black,
        }
    }

    pub(super) fn begin(&mut self, view: u32, traced: &Traced) {
        (self.view, self.time) = (view, 0.0);
        let limits = &self.study.limits;
        self.cache.age(view, traced.frame.eye, &AgeingRules::default(), |object| {
            limits.get(object as usize).copied().unwrap_or(-1.0)
        });
        let warped = warp(&self.cache, view, &traced.frame);
        self.layer.restart(|out| match self.black {
            true => out.data_mut().fill(Vec3::ZERO),
            false => out.data_mut().copy_from_slice(traced.first.data()),
        });
        self.layer.splat_warped(&warped, &traced.buffers.object, &traced.buffers.depth);
        self.update_attention(traced);
        self.order.start_view(u64::from(view), &traced.statistics, &self.attention);
    }

    fn update_attention(&mut self, traced: &Traced) {
        let mut statistics = traced.statistics.clone();
        for (id, s) in statistics.iter_mut().enumerate() {
            s.saliency = self.saliency.get(id).copied().unwrap_or(0.0);
        }
        let (w, h) = (traced.buffers.width(), traced.buffers.height());
        priorities(&statistics, w, h, &Weights::default(), &mut self.attention);
    }

    pub(super) fn picture(&self, traced: &Traced) -> Map2d<Vec3> {
        let (base, layer) = (&traced.buffers.color, self.layer.colors());
        let sum = base.data().iter().zip(layer.data()).map(|(&b, &s)| b + s).collect();
        Map2d::from_vec(base.width(), base.height(), sum)
    }

    /// What the analyzer does after a frame.
    pub(super) fn attend(&mut self, traced: &Traced) {
        let mut bytes = Vec::new();
        let picture = self.picture(traced);
        self.encoder.encode(&self.study.tone, &picture, &mut bytes);
        let map = &self.model.compute_rgb8(&bytes, picture.width(), picture.height()).map;
        let mut statistics = Vec::new();
        let objects = traced.statistics.len();
        ObjectScan::default().gather(&traced.buffers.object, Some(map), objects, &mut statistics);
        self.saliency = statistics.iter().map(|s| s.saliency).collect();
        self.update_attention(traced);
        self.order.attend(&self.attention);
    }

    /// Traces what the policy asks for until the view has had so many seconds.
    pub(super) fn correct(&mut self, traced: &Traced, until: f64) {
        let display = &self.study.world.scene.display;
        let viewing = Viewing::from_centre_of_projection(display.white_cd_m2, traced.buffers.width(), 1.0);
        while self.time < until {
            let start = Instant::now();
            let Some((job, _)) = self.order.next(&traced.buffers.object) else { break };
            self.deciding += undisturbed(start);
            let all = &traced.samples[job.object as usize];
            let k = self.lattice.k_of(job.level);
            let mut batch = SampleBatch::new(self.view, job.object, k, job.count as usize);
            for (x, y) in job_pixels(&self.lattice, &job, &traced.buffers.object) {
                let i = traced.index.at(x as usize, y as usize) as usize;
                batch.push(Sample {
                    pixel: all.pixels[i],
                    position: all.positions[i],
                    normal: all.normals[i],
                    view: all.views[i],
                    color: all.colors[i],
                    pixel_width: all.pixel_widths[i],
                });
            }
            let seconds = traced.cost[job.object as usize] * batch.len() as f64;
            let start = Instant::now();
            if self.order.learns() {
                let base = &traced.buffers.color;
                let residual = residual_of_batch(
                    &batch,
                    base,
                    |x, y| self.layer.color(x, y),
                    &self.study.tone,
                    &viewing,
                    &self.thresholds,
                );
                self.order.record_time(job.object, batch.len() as u32, seconds as f32);
                let pixel = batch.pixels.first().copied().unwrap_or_default();
                self.order.record(u64::from(self.view), job.object, job.level, pixel, &residual);
            }
            self.deciding += undisturbed(start);
            self.layer.splat_fresh(&batch, &traced.buffers.object, 1);
            self.time += seconds;
            self.traced += seconds;
            self.cache.insert(Arc::new(batch));
        }
    }

    /// Mean FLIP of the non-diffuse pixels.
    fn error(&self, traced: &Traced) -> f64 {
        let map = flip::flip(&traced.reference, &self.picture(traced), &self.study.tone);
        let corrected = || map.data().iter().zip(traced.buffers.object.data()).filter(|(_, id)| **id != 0);
        let sum: f64 = corrected().map(|(e, _)| f64::from(*e)).sum();
        sum / corrected().count().max(1) as f64
    }
}
