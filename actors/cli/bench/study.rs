//! Views of a scene with all samples traced, which orders of rays then share.
//!
//! Every sample of every view is traced once in a run, with its time; the orders differ in nothing but which comes when,
//! and time is the sum of what each object's samples were measured to cost.

use std::sync::Arc;
use std::time::Instant;

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
use foveal::metrics::video;
use foveal::perception::importance::{ObjectScan, ObjectStatistics, Weights, priorities};
use foveal::perception::saliency::SaliencyModel;
use foveal::perception::tvi::TviTable;
use foveal::perception::viewing::Viewing;
use foveal::sampling::Lattice;
use foveal::scene::Camera;
use foveal::scene::camera::CameraFrame;
use foveal::splatting::trace::{Owner, trace_samples};
use foveal::splatting::{AgeingRules, Footprint, Sample, SampleBatch, SampleCache, SplatLayer, warp};
use foveal::world::World;
use glam::Vec3;

use crate::cache_ager::angle_limit;
use crate::cli::arguments::Size;
use crate::cli::failure::Failure;
use crate::cli::session::{interrupted, uninterrupted};
use crate::processor_time::cpu_ns;
use crate::settings::Settings;

/// Frames per second of the walk.
pub(super) const FRAMES_PER_SECOND: f32 = 10.0;
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
    camera: Camera,
    pub(super) frame: CameraFrame,
    pub(super) buffers: FrameBuffers,
    statistics: Vec<ObjectStatistics>,
    /// Index of each pixel's sample in its object's batch.
    index: Map2d<u32>,
    /// All samples, by object id.
    samples: Vec<SampleBatch>,
    /// Seconds per sample, by object id.
    pub(super) cost: Vec<f64>,
    /// Seconds of drawing the base layer.
    pub(super) drawing: f64,
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

/// The orders by their names.
pub(super) fn policies(names: &[String]) -> Result<Vec<Entrant>, Failure> {
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
    pub(super) world: World,
    pub(super) tone: ToneMap,
    first: FirstApproximation,
    pub(super) views: Vec<Traced>,
    limits: Vec<f32>,
    settings: Settings,
}

impl Study {
    /// `frames` views along the scene's first path, or from its first camera where it has none.
    ///
    /// # Errors
    /// If the scene has no camera, or Ctrl-C was pressed before all were traced.
    pub(super) fn new(world: World, size: Size, frames: u32, coarse_maps: bool) -> Result<Self, Failure> {
        let nowhere = || Failure::Input(format!("{}: it has no camera", world.scene.name));
        let still = world.scene.cameras.first().ok_or_else(nowhere)?.camera;
        let camera = |i: u32| match world.scene.paths.first() {
            Some(path) => path.at(i as f32 / FRAMES_PER_SECOND, still.up, still.fov_y),
            None => still,
        };
        let settings = Settings::new(size.width, size.height, 1);
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
        let mut views = Vec::new();
        for i in 0..frames {
            uninterrupted()?;
            views.push(traced(&world, &first, camera(i), &settings));
        }
        let limits = world.scene.objects.iter().map(|o| angle_limit(&world, o.material)).collect();
        Ok(Self { tone: ToneMap::from(&world.scene.display), world, first, views, limits, settings })
    }

    /// The same, with all samples traced once more: for another run's times.
    pub(super) fn retrace(&mut self) {
        for view in &mut self.views {
            *view = traced(&self.world, &self.first, view.camera, &self.settings);
        }
    }

    /// What each view converges to.
    pub(super) fn converged(&self) -> Vec<Map2d<Vec3>> {
        self.views.iter().map(|v| v.reference.clone()).collect()
    }

    /// Where the walk begins and stands still.
    pub(super) fn still(&self) -> &Traced {
        &self.views[0]
    }

    /// Stands still: what is shown after each of `steps` shares of the time of all samples, and before. `attend` sees
    /// each picture but the last. Returns the walk, with what it decided in.
    pub(super) fn stand(
        &self,
        entrant: &Entrant,
        shares: impl Iterator<Item = f64>,
        mut shown: impl FnMut(f64, Map2d<Vec3>),
    ) -> Walk<'_> {
        let (mut walk, view) = (Walk::new(self, entrant), self.still());
        walk.begin(1, view);
        shown(0.0, walk.picture(view));
        for share in shares {
            let until = share * view.seconds();
            walk.attend(view);
            walk.correct(view, until);
            shown(until, walk.picture(view));
        }
        walk
    }

    /// Walks all views, each with time for `share` of its samples, and gives what is shown.
    pub(super) fn walk(&self, entrant: &Entrant, share: f64) -> (Walk<'_>, Vec<Map2d<Vec3>>) {
        let (mut walk, mut shown) = (Walk::new(self, entrant), Vec::new());
        for (i, view) in self.views.iter().enumerate() {
            walk.begin(i as u32 + 1, view);
            walk.correct(view, share * view.seconds());
            shown.push(walk.picture(view));
            walk.attend(view);
        }
        (walk, shown)
    }

    /// How near the pictures of a walk come to references, in just objectionable differences: 10 is the same.
    pub(super) fn jod(&self, shown: &[Map2d<Vec3>], references: &[Map2d<Vec3>]) -> Result<f64, Failure> {
        let (display, camera) = (&self.world.scene.display, &self.still().camera);
        let [width, height] = [self.settings.width, self.settings.height];
        let fov_x = 2.0 * ((0.5 * camera.fov_y).tan() * width as f32 / height as f32).atan();
        let viewing = Viewing::from_centre_of_projection(display.white_cd_m2, width as usize, fov_x);
        let jod = video::jod(shown, references, FRAMES_PER_SECOND, &self.tone, &viewing);
        jod.map(f64::from).map_err(Failure::Check)
    }
}

/// Traces all samples of a view, object by object.
fn traced(world: &World, first: &FirstApproximation, camera: Camera, s: &Settings) -> Traced {
    let frame = camera.frame(s.width, s.height);
    let (width, height) = (s.width as usize, s.height as usize);
    let mut buffers = FrameBuffers::new(width, height);
    let start = cpu_ns();
    twin::draw(world, &frame, Passes { texture_ids: false }, &mut buffers);
    let drawing = 1e-9 * (cpu_ns() - start);
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
    let first = approximation;
    Traced { camera, frame, buffers, statistics, index, samples, cost, drawing, reference, first }
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
    fn new(study: &'s Study, entrant: &Entrant) -> Self {
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

    fn begin(&mut self, view: u32, traced: &Traced) {
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

    fn picture(&self, traced: &Traced) -> Map2d<Vec3> {
        let (base, layer) = (&traced.buffers.color, self.layer.colors());
        let sum = base.data().iter().zip(layer.data()).map(|(&b, &s)| b + s).collect();
        Map2d::from_vec(base.width(), base.height(), sum)
    }

    /// What the analyzer does after a frame.
    fn attend(&mut self, traced: &Traced) {
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
    fn correct(&mut self, traced: &Traced, until: f64) {
        let display = &self.study.world.scene.display;
        let viewing = Viewing::from_centre_of_projection(display.white_cd_m2, traced.buffers.width(), 1.0);
        // A run that was interrupted is thrown away.
        while self.time < until && !interrupted() {
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

    /// Seconds of deciding and of tracing.
    pub(super) fn times(&self) -> [f64; 2] {
        [self.deciding, self.traced]
    }
}
