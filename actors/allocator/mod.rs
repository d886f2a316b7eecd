//! The allocator: decides which samples are traced next.
//!
//! Owns the progress of every visible object through its levels, the policy, and how deep the job pool
//! is filled. Hears: a view is begun, a view was drawn, objects were ranked, a job is done, residuals were measured, a
//! job was given up. Says: jobs into the pool; to the renderer, that a view has converged.
//!
//! | module | what it decides |
//! | --- | --- |
//! | `rays` | which samples come next, and when a view has converged |
//! | [`maps`] | which environment maps are captured, and which are kept |
//! | [`textures`] | which levels of textures are in memory |
//! | [`decisions`] | how much of a decision about maps and textures is made at once |
//! | `refinement` | which pixels of a converged view get more samples |
//! | `insights`, `told`, `saved` | what others may know of it; its state, told; its state in a snapshot |

pub mod decisions;
mod insights;
pub mod maps;
mod rays;
mod refinement;
mod saved;
pub mod textures;
mod told;

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use foveal::allocation::ray_order::RayOrder;
use foveal::allocation::supersampling::Supersampler;
use foveal::perception::importance::{ObjectScan, ObjectStatistics};
use foveal::transport::tracer::guide::is_guided;
use foveal_runtime::{Actor, ActorId, Address, Content, Cx, DeadJob, Incident, JobPool, Loader, Saver};

use crate::insight::InsightSlot;
use crate::message::tracer::TraceBrief;
use crate::message::{AllocatorMessage, DrawnView, RendererMessage, TraceJob, TracerMessage, View};
use crate::outbox::Outbox;
use crate::settings::{Adjustment, Settings};
use crate::stages::{Stage, StageTimes};
use maps::Environments;
use textures::Textures;

/// The allocator's state.
pub struct Allocator {
    settings: Settings,
    /// What the user changed last.
    adjustment: Option<Adjustment>,
    renderer: Address<RendererMessage>,
    pool: JobPool<TraceJob>,
    /// By number.
    tracers: Vec<Address<TracerMessage>>,
    /// Who owns the samples of earlier views.
    cache_ager: Option<ActorId>,
    outbox: Outbox<AllocatorMessage>,
    stages: StageTimes,
    /// Progress through the levels, policy, and what was learnt.
    order: RayOrder,
    /// The newest view that has begun.
    begun: View,
    /// It, once it is drawn.
    drawn: Option<Arc<DrawnView>>,
    /// Objects of that view, by id.
    statistics: Vec<ObjectStatistics>,
    scan: ObjectScan,
    /// Mean saliency by object id, in the last frame that was looked at.
    saliency: Arc<Vec<f32>>,
    /// Combined saliency and importance by object id.
    attention: Vec<f32>,
    /// Jobs of samples in the pool or with a tracer, of any view.
    in_flight: u32,
    /// Jobs that each station can have beside those of the tracers.
    credits: BTreeMap<u32, u32>,
    /// First approximations.
    environments: Environments,
    /// Textures, where they do not all fit into memory.
    textures: Option<Textures>,
    /// Whether the next portion of a decision waits for its timer.
    portion_waits: bool,
    /// Seconds of samples that are to be traced before the next job of an environment map.
    owed_to_samples: maps::OwedToSamples,
    /// Whether the renderer knows that the view has converged.
    told_converged: bool,
    /// Refines a view that has converged, where that is wanted.
    supersampler: Option<Supersampler>,
    /// Whether the renderer knows that the view is refined.
    told_refined: bool,
    /// Jobs that were given up.
    lost_jobs: u32,
    /// Jobs done since whoever looks on was told.
    since_insight: u32,
    /// Whoever looks on.
    insight: Option<InsightSlot>,
    /// What the runtime had to tell, the newest.
    incidents: VecDeque<Incident>,
    /// Jobs that were given up, the newest.
    dead_jobs: VecDeque<DeadJob<TraceBrief>>,
}

impl Allocator {
    /// An allocator that has not seen a view.
    pub fn new(
        settings: Settings,
        renderer: Address<RendererMessage>,
        pool: JobPool<TraceJob>,
        tracers: Vec<Address<TracerMessage>>,
        environments: Environments,
        textures: Option<Textures>,
        stages: StageTimes,
    ) -> Self {
        Self {
            order: RayOrder::new(
                settings.policy,
                settings.winner_takes_all,
                settings.lattice(),
                settings.samples_per_job,
                settings.width as usize * settings.height as usize,
            ),
            settings,
            adjustment: None,
            renderer,
            pool,
            tracers,
            cache_ager: None,
            outbox: Outbox::new(|| AllocatorMessage::SendAgain),
            stages,
            begun: View(0),
            drawn: None,
            statistics: Vec::new(),
            scan: ObjectScan::default(),
            saliency: Arc::new(Vec::new()),
            attention: Vec::new(),
            in_flight: 0,
            credits: BTreeMap::new(),
            environments,
            textures,
            portion_waits: false,
            owed_to_samples: maps::OwedToSamples::default(),
            told_converged: false,
            supersampler: settings
                .supersampling
                .map(|rules| Supersampler::new(rules, settings.width, settings.height)),
            told_refined: false,
            lost_jobs: 0,
            since_insight: 0,
            insight: None,
            incidents: VecDeque::new(),
            dead_jobs: VecDeque::new(),
        }
    }

    /// Tells `slot` what it thinks, now and then.
    pub fn looked_on_by(mut self, slot: Option<InsightSlot>) -> Self {
        self.insight = slot;
        self
    }

    /// Says who is the cache ager, to know whose panic it is told of.
    pub fn with_cache_ager(mut self, cache_ager: ActorId) -> Self {
        self.cache_ager = Some(cache_ager);
        self
    }
}

impl Actor for Allocator {
    type Msg = AllocatorMessage;
    const NAME: &'static str = "allocator";

    fn handle(&mut self, message: AllocatorMessage, cx: &mut Cx<'_, AllocatorMessage>) {
        match message {
            AllocatorMessage::ViewBegun { view } => self.on_view_begun(view, cx),
            AllocatorMessage::ViewDrawn { drawn } => self.on_view_drawn(drawn, cx),
            AllocatorMessage::ObjectsRanked { view: _, saliency } => self.on_objects_ranked(saliency),
            AllocatorMessage::JobDone { view: _, object, level, samples, seconds } => {
                self.order.record_time(object, level, samples, seconds);
                self.owed_to_samples.samples_took(seconds);
                self.on_job_done(cx);
            }
            AllocatorMessage::BlockSampled { view, block, hash: _ } => self.on_block_sampled(view, block, cx),
            AllocatorMessage::RunTraced { view, splats, hash: _ } => {
                self.on_run_traced(view, splats.as_deref(), cx);
            }
            AllocatorMessage::Settled { view, stated } => self.on_settled(view, stated, cx),
            AllocatorMessage::ResidualsMeasured { view, object, level, pixel, residual, guided } => {
                self.order.record(u64::from(view.0), object, level, pixel, &residual, &guided);
            }
            AllocatorMessage::EnvironmentCaptured { object, seen, hash: _, seconds } => {
                self.on_environment_captured(object, &seen, seconds, cx);
            }
            AllocatorMessage::EnvironmentFiltered { object, contrast, seconds } => {
                self.on_environment_filtered(object, contrast, seconds, cx);
            }
            AllocatorMessage::TexturesSeen { uses, hash: _ } => self.on_textures_seen(&uses, cx),
            AllocatorMessage::LevelLoaded { texture, level, texels } => {
                self.on_level_loaded(texture, level, texels, cx);
            }
            AllocatorMessage::TexturesReleased { drops } => self.on_textures_released(drops, cx),
            AllocatorMessage::Adjusted(adjustment) => self.on_adjusted(&adjustment, cx),
            AllocatorMessage::Incident(incident) => self.on_incident(incident, cx),
            AllocatorMessage::JobDead(dead) => self.on_job_dead(dead, cx),
            AllocatorMessage::StationChanged { station, credits } => {
                self.credits.insert(station, credits);
                self.fill_pool(cx);
            }
            AllocatorMessage::DecideOn => self.on_decide_on(cx),
            AllocatorMessage::SendAgain => self.outbox.send(cx),
        }
    }

    fn content(&self) -> Content {
        self.told()
    }

    fn save(&self, saver: &mut Saver) {
        self.save_state(saver);
    }

    fn restore(&mut self, loader: &mut Loader<'_>) -> Option<()> {
        self.restore_state(loader)
    }
}

impl Allocator {
    fn on_view_begun(&mut self, view: View, cx: &mut Cx<'_, AllocatorMessage>) {
        // Jobs of older views come back as stale, and none is handed out until there is something to trace.
        cx.retire(&self.pool, u64::from(view.0));
        self.begun = view;
        self.drawn = None;
        if let Some(supersampler) = &mut self.supersampler {
            supersampler.forget();
        }
    }

    fn on_view_drawn(&mut self, drawn: Arc<DrawnView>, cx: &mut Cx<'_, AllocatorMessage>) {
        if drawn.view < self.begun {
            // The next one is being drawn already.
            return;
        }
        let stages = self.stages.clone();
        stages.time(Stage::Allocate, || {
            self.scan.gather(&drawn.buffers().object, None, drawn.object_count, &mut self.statistics);
            self.order.set_guided(self.guided_objects(&drawn));
            self.drawn = Some(drawn);
            self.told_converged = false;
            self.told_refined = false;
            self.update_attention();
            let view = self.drawn.as_ref().map_or(0, |d| u64::from(d.view.0));
            self.order.start_view(view, &self.statistics, &self.attention);
        });
        self.rank_maps();
        if let (Some(textures), Some(drawn)) = (&mut self.textures, &self.drawn) {
            textures.on_view(drawn);
        }
        self.decide(cx);
        self.fill_pool(cx);
        self.tell_insight();
    }

    /// Which objects are looked at through guides: those of smooth glass, where there is anything between samples.
    fn guided_objects(&self, drawn: &DrawnView) -> Vec<bool> {
        let scene = &drawn.world.scene;
        let interpolates = self.settings.footprint.interpolates();
        scene.objects.iter().map(|object| interpolates && is_guided(scene, object.material)).collect()
    }

    fn on_incident(&mut self, incident: Incident, cx: &mut Cx<'_, AllocatorMessage>) {
        if let Incident::Panicked { actor, .. } = &incident {
            // Its timer's message may have been what it panicked over.
            if let Some(tracer) = self.tracers.iter().find(|tracer| tracer.id() == *actor) {
                self.outbox.tell(cx, tracer, TracerMessage::SendAgain);
            }
            if self.cache_ager == Some(*actor) {
                self.outbox.tell(cx, &self.renderer, RendererMessage::SamplesForgotten);
            }
        }
        keep_newest(&mut self.incidents, incident);
    }

    /// What the job would have answered will not come.
    fn on_job_dead(&mut self, dead: DeadJob<TraceBrief>, cx: &mut Cx<'_, AllocatorMessage>) {
        self.lost_jobs += 1;
        match &dead.brief {
            TraceBrief::Samples { .. } | TraceBrief::Settle { .. } => self.on_job_done(cx),
            TraceBrief::Tile { view, tile, .. } => {
                let is_shown = self.drawn.as_ref().is_some_and(|drawn| drawn.view == *view);
                if let Some(supersampler) = self.supersampler.as_mut().filter(|_| is_shown) {
                    supersampler.lose(*tile);
                }
                self.on_job_done(cx);
            }
            TraceBrief::Run { view, .. } => {
                let is_shown = self.drawn.as_ref().is_some_and(|drawn| drawn.view == *view);
                if let Some(supersampler) = self.supersampler.as_mut().filter(|_| is_shown) {
                    supersampler.lose_run();
                }
                self.on_job_done(cx);
            }
            TraceBrief::Environment { .. } => {
                self.environments.on_job_lost();
                self.capture_maps(cx);
            }
            TraceBrief::Prediction { .. } => {
                if let Some(textures) = &mut self.textures {
                    textures.on_prediction_lost();
                }
                self.change_textures(cx);
            }
            TraceBrief::Level { texture, level } => self.on_level_loaded(*texture, *level, None, cx),
        }
        keep_newest(&mut self.dead_jobs, dead);
        self.tell_insight();
    }

    /// Takes up what the user changed, in the middle of a view.
    fn on_adjusted(&mut self, adjustment: &Adjustment, cx: &mut Cx<'_, AllocatorMessage>) {
        let before = self.settings.environment_bytes;
        self.told_refined &= self.settings.supersampling == adjustment.refine;
        self.adjust(adjustment);
        self.update_attention();
        self.order.attend(&self.attention);
        if before != self.settings.environment_bytes {
            self.rank_maps();
        }
        self.decide(cx);
        self.fill_pool(cx);
    }

    fn adjust(&mut self, adjustment: &Adjustment) {
        self.adjustment = Some(*adjustment);
        self.settings.adjust(adjustment);
        self.order.adjust(self.settings.policy, self.settings.samples_per_job);
        self.environments.set_budget(self.settings.environment_bytes);
        self.adjust_refinement();
        if let (Some(textures), Some(bytes)) = (&mut self.textures, adjustment.texture_bytes) {
            textures.set_limit(bytes);
        }
    }
}

/// What went wrong that is kept: enough to tell of, however long a walk is.
const TROUBLES_KEPT: usize = 64;

fn keep_newest<T>(kept: &mut VecDeque<T>, newest: T) {
    if kept.len() == TROUBLES_KEPT {
        kept.pop_front();
    }
    kept.push_back(newest);
}
