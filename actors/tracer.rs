//! A tracer: pops the best job, traces it, sends the samples on. Owns nothing that lasts but what was not accepted.
//!
//! Before it tells what it found it claims the job: one that it lost, because it hung for longer than a job is lent,
//! another tracer does, and nobody is told twice.

use std::sync::Arc;

use foveal::allocation::environment::MapContrast;
use foveal::allocation::jobs::{GUIDES, guide_pixels, job_pixels};
use foveal::allocation::texture_demand::predicted_uses;
use foveal::display::environment_map::{self, EnvironmentMap, capture, direction, solid_angle};
use foveal::image::luminance;
use foveal::sampling::Lattice;
use foveal::splatting::Guides;
use foveal::splatting::light_tracing::{Splats, trace_run};
use foveal::splatting::settled::settled;
use foveal::splatting::tile_sums::TileSums;
use foveal::splatting::trace::{Owner, trace_guides, trace_samples};
use foveal_runtime::{Actor, Address, Class, Content, Cx, Loader, Saver, Worker};

use xxhash_rust::xxh3::Xxh3;

use crate::message::tracer::EnvironmentWork;
use crate::message::{
    AllocatorMessage, CacheAgerMessage, DrawnView, EnvironmentOrder, LevelOrder, PredictionOrder,
    RendererMessage, RunWork, SampleOrder, SettleWork, TileWork, TraceJob, TracerMessage, View,
};
use crate::outbox::Outbox;

/// A tracer's state.
pub struct Tracer {
    /// Its number among the tracers, from 0.
    index: u32,
    lattice: Lattice,
    renderer: Address<RendererMessage>,
    cache_ager: Address<CacheAgerMessage>,
    allocator: Address<AllocatorMessage>,
    outbox: Outbox<TracerMessage>,
}

impl Tracer {
    /// Tracer number `index`.
    pub fn new(
        index: u32,
        lattice: Lattice,
        renderer: Address<RendererMessage>,
        cache_ager: Address<CacheAgerMessage>,
        allocator: Address<AllocatorMessage>,
    ) -> Self {
        let outbox = Outbox::new(|| TracerMessage::SendAgain);
        Self { index, lattice, renderer, cache_ager, allocator, outbox }
    }

    /// Whether everything it traced is with those who need it.
    pub fn is_empty_handed(&self) -> bool {
        self.outbox.is_empty()
    }

    fn trace_samples(&mut self, job: &SampleOrder, cx: &mut Cx<'_, TracerMessage>) {
        if job.order.level == GUIDES {
            return self.trace_guides(job, cx);
        }
        let drawn = &job.drawn;
        let owner =
            Owner { view: drawn.view.0, object: job.order.object, k: self.lattice.k_of(job.order.level) };
        let pixels = job_pixels(&self.lattice, &job.order, &drawn.buffers().object);
        let (batch, duration) = cx.measure(|| {
            let (DrawnView { world, frame, .. }, buffers) = (&**drawn, drawn.buffers());
            let mut batch = trace_samples(world, frame, buffers, owner, pixels, job.seed);
            if job.order.guided {
                let pixels = batch.pixels.iter().map(|&[x, y]| (i32::from(x), i32::from(y)));
                batch.guides = trace_guides(world, frame, buffers, pixels);
            }
            batch
        });
        if !cx.claim() {
            return;
        }
        let batch = Arc::new(batch);
        let (samples, hash) = (batch.len() as u32, batch.digest());
        // Samples before the word that the job is done: so the allocator's "converged" comes after them.
        let to_renderer = RendererMessage::SamplesTraced { batch: batch.clone(), tracer: self.index, hash };
        self.outbox.tell(cx, &self.renderer, to_renderer);
        self.outbox.tell(cx, &self.cache_ager, CacheAgerMessage::SamplesTraced { batch, hash });
        self.job_done(job, samples, duration.as_secs_f32(), cx);
    }

    fn trace_guides(&mut self, job: &SampleOrder, cx: &mut Cx<'_, TracerMessage>) {
        let (DrawnView { view, world, frame, .. }, buffers) = (&*job.drawn, job.drawn.buffers());
        let pixels = || guide_pixels(&job.order, &buffers.object);
        let (colors, duration) = cx.measure(|| trace_guides(world, frame, buffers, pixels()));
        if !cx.claim() {
            return;
        }
        let pixels = pixels().map(|(x, y)| [x as u16, y as u16]).collect();
        let guides = Guides { view: view.0, pixels, colors };
        let (count, hash) = (guides.colors.len() as u32, guides.digest());
        let traced = RendererMessage::GuidesTraced { guides: Arc::new(guides), hash };
        self.outbox.tell(cx, &self.renderer, traced);
        self.job_done(job, count, duration.as_secs_f32(), cx);
    }

    fn supersample(&mut self, work: &TileWork, cx: &mut Cx<'_, TracerMessage>) {
        let TileWork { drawn, block, seed } = work;
        let traced = cx.while_wanted(|is_wanted| block.traced(&drawn.world, &drawn.frame, *seed, is_wanted));
        if cx.claim() {
            self.block_sampled(drawn.view, traced, cx);
        }
    }

    fn block_sampled(&mut self, view: View, block: Option<TileSums>, cx: &mut Cx<'_, TracerMessage>) {
        self.outbox.tell(cx, &self.allocator, AllocatorMessage::block_sampled(view, block));
    }

    fn settle(&mut self, work: &SettleWork, cx: &mut Cx<'_, TracerMessage>) {
        let SettleWork { drawn, tiles, traced } = work;
        // It takes longer than a view that has begun can wait for the cores.
        let settled = cx.while_wanted(|is_wanted| {
            settled(&drawn.world, &drawn.frame, drawn.buffers(), tiles, traced.as_deref(), is_wanted)
        });
        if !cx.claim() {
            return;
        }
        let Some(settled) = settled else { return self.not_settled(drawn.view, cx) };
        let (view, stated, hash) = (drawn.view, Some(settled.stated), settled.digest());
        let shown = RendererMessage::RefinedShown { view, settled: Arc::new(settled), hash };
        self.outbox.tell(cx, &self.renderer, shown);
        self.outbox.tell(cx, &self.allocator, AllocatorMessage::Settled { view, stated });
    }

    fn trace_run(&mut self, work: &RunWork, cx: &mut Cx<'_, TracerMessage>) {
        let RunWork { drawn, run, seed } = work;
        let splats =
            cx.while_wanted(|is_wanted| trace_run(&drawn.world, &drawn.frame, *run, *seed, is_wanted));
        if cx.claim() {
            self.run_traced(drawn.view, splats, cx);
        }
    }

    fn run_traced(&mut self, view: View, splats: Option<Splats>, cx: &mut Cx<'_, TracerMessage>) {
        self.outbox.tell(cx, &self.allocator, AllocatorMessage::run_traced(view, splats));
    }

    fn not_settled(&mut self, view: View, cx: &mut Cx<'_, TracerMessage>) {
        self.outbox.tell(cx, &self.allocator, AllocatorMessage::Settled { view, stated: None });
    }

    fn capture(&mut self, order: &EnvironmentOrder, cx: &mut Cx<'_, TracerMessage>) {
        let Some(probe) = order.probes.probes.get(order.object as usize) else { return };
        match &order.work {
            EnvironmentWork::Capture { first, count } => {
                let texels = *first as usize..(*first + *count) as usize;
                let side = order.side as usize;
                let (split_sum, centre) = (&order.probes.split_sum, probe.centre);
                let (seen, duration) =
                    cx.measure(|| capture(&order.world, split_sum, order.object, centre, side, texels));
                if !cx.claim() {
                    return;
                }
                let hash = environment_map::digest(&seen);
                let seconds = duration.as_secs_f32();
                let captured = AllocatorMessage::EnvironmentCaptured {
                    object: order.object,
                    seen: Arc::new(seen),
                    hash,
                    seconds,
                };
                self.outbox.tell(cx, &self.allocator, captured);
            }
            EnvironmentWork::Filter { seen } => {
                let ((map, contrast), duration) = cx.measure(|| {
                    let map =
                        EnvironmentMap::of_capture(probe.centre, order.side as usize, seen, order.exponent);
                    let contrast = contrast(&map, &probe.map);
                    (map, contrast)
                });
                if !cx.claim() {
                    return;
                }
                let hash = map.digest();
                let changed = RendererMessage::EnvironmentChanged {
                    object: order.object,
                    map: Some(Arc::new(map)),
                    hash,
                };
                self.outbox.tell(cx, &self.renderer, changed);
                let filtered = AllocatorMessage::EnvironmentFiltered {
                    object: order.object,
                    contrast,
                    seconds: duration.as_secs_f32(),
                };
                self.outbox.tell(cx, &self.allocator, filtered);
            }
        }
    }

    fn look_ahead(&mut self, order: &PredictionOrder, cx: &mut Cx<'_, TracerMessage>) {
        let uses = predicted_uses(&order.drawn.world, &order.drawn.frame, &order.store.means);
        if !cx.claim() {
            return;
        }
        let mut h = Xxh3::new();
        for used in &uses {
            h.update(bytemuck::cast_slice(&used.pixels));
            h.update(bytemuck::cast_slice(&used.visibility));
        }
        let seen = AllocatorMessage::TexturesSeen { uses: Arc::new(uses), hash: h.digest() };
        self.outbox.tell(cx, &self.allocator, seen);
    }

    fn load(&mut self, order: &LevelOrder, cx: &mut Cx<'_, TracerMessage>) {
        let (texture, level) = (order.texture as usize, order.level as usize);
        let texels = order.like.as_ref().and_then(|like| {
            let level = order.store.level(texture, level, like);
            let file = || order.store.file(texture, order.level as usize);
            level.inspect_err(|e| tracing::warn!("{}: {e}; a coarser level stays", file().display())).ok()
        });
        if !cx.claim() {
            return;
        }
        let loaded = AllocatorMessage::LevelLoaded { texture: order.texture, level: order.level, texels };
        self.outbox.tell(cx, &self.allocator, loaded);
    }

    fn job_done(&mut self, job: &SampleOrder, samples: u32, seconds: f32, cx: &mut Cx<'_, TracerMessage>) {
        let done = AllocatorMessage::JobDone {
            view: job.drawn.view,
            object: job.order.object,
            level: job.order.level,
            samples,
            seconds,
        };
        self.outbox.tell(cx, &self.allocator, done);
    }
}

impl Actor for Tracer {
    type Msg = TracerMessage;
    const NAME: &'static str = "tracer";
    const CLASS: Class = Class::Heavy;

    fn handle(&mut self, message: TracerMessage, cx: &mut Cx<'_, TracerMessage>) {
        match message {
            TracerMessage::SendAgain => self.outbox.send(cx),
        }
    }

    fn content(&self) -> Content {
        Content::fields([("outbox", Content::of(&self.outbox.len()))])
    }

    fn save(&self, saver: &mut Saver) {
        let Self { index: _, lattice: _, renderer: _, cache_ager: _, allocator: _, outbox } = self;
        if !outbox.is_empty() {
            saver.refuse();
        }
    }

    fn restore(&mut self, _: &mut Loader<'_>) -> Option<()> {
        Some(())
    }
}

impl Worker for Tracer {
    type Job = TraceJob;

    fn run(&mut self, job: &TraceJob, cx: &mut Cx<'_, TracerMessage>) {
        match job {
            TraceJob::Samples(order) => self.trace_samples(order, cx),
            TraceJob::Tile(work) => self.supersample(work, cx),
            TraceJob::Run(work) => self.trace_run(work, cx),
            TraceJob::Settle(work) => self.settle(work, cx),
            TraceJob::Environment(order) => self.capture(order, cx),
            TraceJob::Prediction(order) => self.look_ahead(order, cx),
            TraceJob::Level(order) => self.load(order, cx),
        }
    }

    fn stale(&mut self, job: &TraceJob, cx: &mut Cx<'_, TracerMessage>) {
        match job {
            TraceJob::Samples(order) => self.job_done(order, 0, 0.0, cx),
            TraceJob::Tile(TileWork { drawn, .. }) => self.block_sampled(drawn.view, None, cx),
            TraceJob::Run(RunWork { drawn, .. }) => self.run_traced(drawn.view, None, cx),
            TraceJob::Settle(SettleWork { drawn, .. }) => self.not_settled(drawn.view, cx),
            TraceJob::Environment(order) => {
                let nothing = AllocatorMessage::EnvironmentCaptured {
                    object: order.object,
                    seen: Arc::new(Vec::new()),
                    hash: 0,
                    seconds: 0.0,
                };
                self.outbox.tell(cx, &self.allocator, nothing);
            }
            // These hold for every view and are never stale.
            TraceJob::Prediction(order) => self.look_ahead(order, cx),
            TraceJob::Level(order) => self.load(order, cx),
        }
    }
}

/// What is lost where the coarse map is drawn in the place of the fine one.
fn contrast(fine: &EnvironmentMap, coarse: &EnvironmentMap) -> MapContrast {
    let side = fine.radiance().side();
    let texels: Vec<f32> = fine.radiance().texels().iter().map(|&t| luminance(t)).collect();
    let (mut drawn, mut weights) = (Vec::with_capacity(texels.len()), Vec::with_capacity(texels.len()));
    for i in 0..texels.len() {
        drawn.push(luminance(coarse.radiance().sample(direction(side, i))));
        weights.push(solid_angle(side, i));
    }
    MapContrast::of_map(&texels, &drawn, &weights)
}
