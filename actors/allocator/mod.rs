//! The allocator: decides which samples are traced next.
//!
//! Owns the progress of every visible object through its levels, the policy, and how deep the job pool
//! is filled. Hears: a view is begun, a view was drawn, objects were ranked, a job is done, residuals were measured, a
//! job was given up. Says: jobs into the pool; to the renderer, that a view has converged.

pub mod environments;
mod saved;
pub mod textures;

use std::sync::Arc;
use std::time::Duration;

use foveal::allocation::environment::MapContrast;
use foveal::allocation::policy::bucket_of;
use foveal::allocation::ray_order::{RayOrder, Standing};
use foveal::allocation::supersampling::Supersampler;
use foveal::allocation::texture_demand::TextureUse;
use foveal::display::environment_map::Seen;
use foveal::display::tone::ToneMap;
use foveal::perception::importance::{ObjectScan, ObjectStatistics, importance, priorities};
use foveal::scene::texture::LevelTexels;
use foveal::splatting::supersampling::TileSums;
use foveal_runtime::{Actor, Address, Cx, Incident, JobPool, Loader, Saver};

use crate::insight::{Insight, InsightSlot, ObjectInsight};
use crate::message::tracer::{ENVIRONMENT_MAP, LEVEL_OF_TEXTURE, TEXTURES_WANTED};
use crate::message::{
    AllocatorMessage, DrawnView, RendererMessage, SampleOrder, TileWork, TraceJob, TracerMessage, View,
};
use crate::outbox::Outbox;
use crate::settings::{Adjustment, Settings};
use crate::stages::{Stage, StageTimes};
use environments::Environments;
use textures::{TextureWork, Textures};

/// Jobs of samples that are done until whoever looks on is told anew.
const JOBS_BETWEEN_INSIGHTS: u32 = 32;
/// Work of one portion of a decision about maps and textures ([`foveal::allocation::search`]): some 50 µs.
pub const WORK_AT_ONCE: u64 = 1500;
/// Time between two portions: a frame of a fast display.
const BETWEEN_PORTIONS: Duration = Duration::from_millis(16);
/// Jobs of samples that are done between two jobs of environment maps, per tracer.
const SAMPLES_BETWEEN_MAPS: u32 = 3;

/// The allocator's state.
pub struct Allocator {
    settings: Settings,
    /// What the user changed last.
    adjustment: Option<Adjustment>,
    renderer: Address<RendererMessage>,
    pool: JobPool<TraceJob>,
    /// By number.
    tracers: Vec<Address<TracerMessage>>,
    outbox: Outbox<AllocatorMessage>,
    stages: StageTimes,
    /// Progress through the levels, policy, and what was learnt.
    order: RayOrder,
    /// The newest view; `None` while one is being drawn.
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
    /// First approximations.
    environments: Environments,
    /// Textures, where they do not all fit into memory.
    textures: Option<Textures>,
    /// Whether the next portion of a decision waits for its timer.
    portion_waits: bool,
    /// Jobs of samples done since a job of an environment map was handed out.
    since_map: u32,
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
    /// What the runtime had to tell.
    incidents: Vec<Incident>,
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
            outbox: Outbox::new(|| AllocatorMessage::SendAgain),
            stages,
            drawn: None,
            statistics: Vec::new(),
            scan: ObjectScan::default(),
            saliency: Arc::new(Vec::new()),
            attention: Vec::new(),
            in_flight: 0,
            environments,
            textures,
            portion_waits: false,
            since_map: u32::MAX,
            told_converged: false,
            supersampler: settings
                .supersampling
                .map(|rules| Supersampler::new(rules, settings.width, settings.height)),
            told_refined: false,
            lost_jobs: 0,
            since_insight: 0,
            insight: None,
            incidents: Vec::new(),
        }
    }

    /// Tells `slot` what it thinks, now and then.
    pub fn looked_on_by(mut self, slot: Option<InsightSlot>) -> Self {
        self.insight = slot;
        self
    }

    /// What it thinks.
    pub fn insight(&self) -> Insight {
        let size = (self.settings.width as usize, self.settings.height as usize);
        let weights = self.settings.weights();
        let mut objects: Vec<ObjectInsight> = self
            .statistics
            .iter()
            .enumerate()
            .map(|(id, s)| ObjectInsight {
                pixels: s.pixels,
                saliency: s.saliency,
                importance: if id == 0 { 0.0 } else { importance(s, size.0, size.1, &weights) },
                attention: self.attention.get(id).copied().unwrap_or(0.0),
                ..ObjectInsight::default()
            })
            .collect();
        for Standing { object, level, priority, error } in self.order.standings() {
            if let Some(object) = objects.get_mut(object as usize) {
                (object.level, object.priority, object.error) = (level, priority, error);
            }
        }
        Insight {
            view: self.drawn.as_ref().map_or(View(0), |d| d.view),
            objects,
            maps: self.environments.ranking(),
            map_bytes: [self.environments.bytes(), self.settings.environment_bytes],
            map_price_per_mib: self.environments.price_per_mib(),
            textures: self.textures.as_ref().map(|t| (t.current(), t.residency().limit())),
            refinement: self.supersampler.as_ref().and_then(Supersampler::standing),
            quality: self.quality(),
        }
    }

    /// Q per pixel.
    fn quality(&self) -> f32 {
        if self.drawn.is_none() {
            return f32::NEG_INFINITY;
        }
        let textures = self.textures.as_ref().map_or(0.0, Textures::visible_error);
        let pixels = f64::from(self.settings.width) * f64::from(self.settings.height);
        -((self.order.visible_error() + textures) / pixels.max(1.0)) as f32
    }

    fn tell_insight(&mut self) {
        if let Some(slot) = &self.insight {
            self.since_insight = 0;
            slot.put(self.insight());
        }
    }

    /// Jobs that were given up after killing their tracers.
    pub fn lost_jobs(&self) -> u32 {
        self.lost_jobs
    }

    /// Jobs that nobody has answered yet, in the pool, with a tracer or on their way.
    pub fn in_flight(&self) -> u32 {
        let textures = self.textures.as_ref().map_or(0, Textures::in_flight);
        self.in_flight + u32::from(self.environments.in_flight()) + textures
    }

    /// Textures, where they do not all fit into memory.
    pub fn textures(&self) -> Option<&Textures> {
        self.textures.as_ref()
    }

    /// Environment maps.
    pub fn environments(&self) -> &Environments {
        &self.environments
    }

    /// Panics, jobs given up and tracers stopped.
    pub fn incidents(&self) -> &[Incident] {
        &self.incidents
    }

    /// Combined saliency and importance by object id, in the newest view.
    pub fn attention(&self) -> &[f32] {
        &self.attention
    }

    fn on_view_begun(&mut self, view: View, cx: &mut Cx<'_, AllocatorMessage>) {
        // Jobs of older views come back as stale, and none is handed out until there is something to trace.
        cx.retire(&self.pool, u64::from(view.0));
        self.drawn = None;
        if let Some(supersampler) = &mut self.supersampler {
            supersampler.forget();
        }
    }

    fn on_view_drawn(&mut self, drawn: Arc<DrawnView>, cx: &mut Cx<'_, AllocatorMessage>) {
        let stages = self.stages.clone();
        stages.time(Stage::Allocate, || {
            self.scan.gather(&drawn.buffers.object, None, drawn.object_count, &mut self.statistics);
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

    /// Gives the orders that textures need now.
    fn change_textures(&mut self, cx: &mut Cx<'_, AllocatorMessage>) {
        let Some(textures) = &mut self.textures else { return };
        // Neither goes stale with a view.
        if let Some(order) = textures.next_prediction() {
            self.outbox.push(cx, &self.pool, 0, u64::MAX, TraceJob::Prediction(order));
        }
        let mut changed = false;
        while let Some(work) = textures.next_work() {
            changed = true;
            match work {
                TextureWork::Load(order) => {
                    self.outbox.push(cx, &self.pool, 0, u64::MAX, TraceJob::Level(order));
                }
                TextureWork::Drop { texture, finest } => {
                    let changed = RendererMessage::TextureChanged { texture, finest, texels: None };
                    self.outbox.tell(cx, &self.renderer, changed);
                }
            }
        }
        textures.report(changed);
    }

    fn on_textures_seen(&mut self, uses: &[TextureUse], cx: &mut Cx<'_, AllocatorMessage>) {
        if let Some(textures) = &mut self.textures {
            textures.on_seen(uses);
        }
        self.decide(cx);
        self.fill_pool(cx);
    }

    fn on_level_loaded(
        &mut self,
        texture: u32,
        level: u32,
        texels: Option<LevelTexels>,
        cx: &mut Cx<'_, AllocatorMessage>,
    ) {
        let Some(textures) = &mut self.textures else { return };
        textures.on_loaded(texture, level, texels.is_some());
        if let Some(texels) = texels {
            let changed = RendererMessage::TextureChanged { texture, finest: level, texels: Some(texels) };
            self.outbox.tell(cx, &self.renderer, changed);
        }
        self.change_textures(cx);
        self.fill_pool(cx);
    }

    fn on_textures_released(&mut self, drops: u32, cx: &mut Cx<'_, AllocatorMessage>) {
        if let Some(textures) = &mut self.textures {
            textures.on_released(drops);
        }
        self.change_textures(cx);
        self.fill_pool(cx);
    }

    fn rank_maps(&mut self) {
        let Some(drawn) = self.drawn.clone() else { return };
        let stages = self.stages.clone();
        stages.time(Stage::Allocate, || {
            self.environments.on_view(&drawn, &self.statistics, &self.attention);
        });
    }

    /// Goes on with decisions about maps and textures: one portion, the next after a while.
    fn decide(&mut self, cx: &mut Cx<'_, AllocatorMessage>) {
        if !self.portion_waits {
            self.decide_for(WORK_AT_ONCE, cx);
            if self.is_deciding() {
                self.portion_waits = cx.after(BETWEEN_PORTIONS, AllocatorMessage::DecideOn).is_ok();
                if !self.portion_waits {
                    // Nobody will say when to go on.
                    self.decide_for(u64::MAX, cx);
                }
            }
        }
        self.change_textures(cx);
    }

    fn is_deciding(&self) -> bool {
        let textures = self.textures.as_ref().is_some_and(|t| t.residency().is_deciding());
        textures || self.environments.is_deciding()
    }

    fn decide_for(&mut self, mut work: u64, cx: &mut Cx<'_, AllocatorMessage>) {
        let stages = self.stages.clone();
        let dropped = stages.time(Stage::Allocate, || {
            let dropped = self.environments.go_on(&mut work);
            if let Some(textures) = &mut self.textures {
                textures.go_on(&mut work);
            }
            dropped
        });
        for object in dropped {
            let changed = RendererMessage::EnvironmentChanged { object, map: None, hash: 0 };
            self.outbox.tell(cx, &self.renderer, changed);
        }
    }

    fn on_decide_on(&mut self, cx: &mut Cx<'_, AllocatorMessage>) {
        self.portion_waits = false;
        self.decide(cx);
        self.fill_pool(cx);
    }

    /// Hands out a job of an environment map, if it is time for one.
    fn capture_maps(&mut self, cx: &mut Cx<'_, AllocatorMessage>) {
        let idle = self.order.is_exhausted();
        if !idle && self.since_map < SAMPLES_BETWEEN_MAPS * self.settings.tracers {
            return;
        }
        if let Some(order) = self.environments.next_order() {
            self.since_map = 0;
            // Maps hold for every view, so they never go stale.
            self.outbox.push(cx, &self.pool, 0, u64::MAX, TraceJob::Environment(order));
        }
    }

    fn on_environment_captured(
        &mut self,
        object: u32,
        seen: &[Seen],
        seconds: f32,
        cx: &mut Cx<'_, AllocatorMessage>,
    ) {
        self.environments.on_captured(object, seen, seconds);
        self.capture_maps(cx);
    }

    fn on_environment_filtered(
        &mut self,
        object: u32,
        contrast: MapContrast,
        cx: &mut Cx<'_, AllocatorMessage>,
    ) {
        self.environments.on_filtered(object, contrast);
        self.capture_maps(cx);
    }

    fn on_objects_ranked(&mut self, saliency: Arc<Vec<f32>>) {
        // The saliency of the view before says more than none.
        self.saliency = saliency;
        self.update_attention();
        self.order.attend(&self.attention);
    }

    fn on_job_done(&mut self, cx: &mut Cx<'_, AllocatorMessage>) {
        self.in_flight = self.in_flight.saturating_sub(1);
        self.since_map = self.since_map.saturating_add(1);
        self.since_insight += 1;
        self.fill_pool(cx);
        if self.since_insight >= JOBS_BETWEEN_INSIGHTS {
            self.tell_insight();
        }
    }

    fn on_tile_sampled(
        &mut self,
        view: View,
        sums: Option<Arc<TileSums>>,
        cx: &mut Cx<'_, AllocatorMessage>,
    ) {
        self.in_flight = self.in_flight.saturating_sub(1);
        if let (Some(supersampler), Some(drawn), Some(sums)) = (&mut self.supersampler, &self.drawn, sums)
            && drawn.view == view
        {
            let tone = ToneMap::from(&drawn.world.scene.display);
            self.stages.time(Stage::Allocate, || supersampler.record(sums, &tone));
            self.since_insight += 1;
        }
        self.fill_pool(cx);
        if self.since_insight >= JOBS_BETWEEN_INSIGHTS {
            self.tell_insight();
        }
    }

    /// Orders more samples for tiles of a view that has converged.
    fn refine(&mut self, drawn: &Arc<DrawnView>, cx: &mut Cx<'_, AllocatorMessage>) {
        let Some(supersampler) = &mut self.supersampler else { return };
        if !supersampler.has_begun() {
            supersampler.begin();
        }
        while self.in_flight < self.settings.jobs_in_flight() {
            let Some(order) = supersampler.next_order() else { break };
            let work = TileWork { drawn: drawn.clone(), order, seed: self.settings.seed };
            self.outbox.push(cx, &self.pool, bucket_of(0.0), u64::from(drawn.view.0), TraceJob::Tile(work));
            self.in_flight += 1;
        }
        if self.in_flight == 0 && supersampler.is_exhausted() && !self.told_refined {
            self.outbox.tell(cx, &self.renderer, RendererMessage::ViewRefined { view: drawn.view });
            self.told_refined = true;
            self.tell_insight();
        }
    }

    fn on_incident(&mut self, incident: Incident, cx: &mut Cx<'_, AllocatorMessage>) {
        match &incident {
            Incident::JobDead { description, .. } => {
                self.lost_jobs += 1;
                let of_map = description.contains(ENVIRONMENT_MAP);
                let of_prediction = description.starts_with(TEXTURES_WANTED);
                let of_level = level_of(description);
                self.incidents.push(incident);
                if of_prediction {
                    if let Some(textures) = &mut self.textures {
                        textures.on_prediction_lost();
                    }
                    self.change_textures(cx);
                } else if let Some([texture, level]) = of_level {
                    self.on_level_loaded(texture, level, None, cx);
                } else if of_map {
                    self.environments.on_job_lost();
                    self.capture_maps(cx);
                } else {
                    self.on_job_done(cx);
                }
            }
            Incident::Panicked { actor, .. } => {
                // Its timer's message may have been what it panicked over.
                if let Some(tracer) = self.tracers.iter().find(|tracer| tracer.id() == *actor) {
                    self.outbox.tell(cx, tracer, TracerMessage::SendAgain);
                }
                self.incidents.push(incident);
            }
            Incident::CircuitOpen { .. } => self.incidents.push(incident),
        }
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
        match (self.settings.supersampling, &mut self.supersampler, &self.drawn) {
            (None, supersampler, _) => *supersampler = None,
            (Some(rules), Some(supersampler), Some(drawn)) => {
                supersampler.set_rules(rules, &ToneMap::from(&drawn.world.scene.display));
            }
            (Some(rules), supersampler, _) => {
                let (width, height) = (self.settings.width, self.settings.height);
                *supersampler = Some(Supersampler::new(rules, width, height));
            }
        }
        if let (Some(textures), Some(bytes)) = (&mut self.textures, adjustment.texture_bytes) {
            textures.set_limit(bytes);
        }
    }

    fn update_attention(&mut self) {
        for (id, s) in self.statistics.iter_mut().enumerate() {
            s.saliency = self.saliency.get(id).copied().unwrap_or(0.0);
        }
        let (w, h) = (self.settings.width as usize, self.settings.height as usize);
        priorities(&self.statistics, w, h, &self.settings.weights(), &mut self.attention);
    }

    fn fill_pool(&mut self, cx: &mut Cx<'_, AllocatorMessage>) {
        let Some(drawn) = self.drawn.clone() else { return };
        let stages = self.stages.clone();
        stages.time(Stage::Allocate, || {
            while self.in_flight < self.settings.jobs_in_flight() {
                let Some((order, priority)) = self.order.next(&drawn.buffers.object) else { break };
                let attention = self.attention.get(order.object as usize).copied().unwrap_or(0.0);
                let seed = self.settings.seed;
                let order = SampleOrder { drawn: drawn.clone(), order, seed, priority, attention };
                let job = TraceJob::Samples(order);
                let bucket = bucket_of(priority);
                self.outbox.push(cx, &self.pool, bucket, u64::from(drawn.view.0), job);
                self.in_flight += 1;
            }
        });
        self.capture_maps(cx);
        let textures_settled = self.textures.as_ref().is_none_or(Textures::is_quiet);
        if self.in_flight == 0 && self.order.is_exhausted() && textures_settled && !self.told_converged {
            self.told_converged = true;
            // Before anybody can know.
            self.tell_insight();
            let message = RendererMessage::ViewConverged { view: drawn.view };
            self.outbox.tell(cx, &self.renderer, message);
        }
        if self.told_converged {
            self.refine(&drawn, cx);
        }
    }
}

/// Texture and level that the description of a job that loads one ends with.
fn level_of(description: &str) -> Option<[u32; 2]> {
    let (texture, level) = description.strip_prefix(LEVEL_OF_TEXTURE)?.split_once(", level ")?;
    Some([texture.trim().parse().ok()?, level.trim().parse().ok()?])
}

impl Actor for Allocator {
    type Msg = AllocatorMessage;
    const NAME: &'static str = "allocator";

    fn handle(&mut self, message: AllocatorMessage, cx: &mut Cx<'_, AllocatorMessage>) {
        match message {
            AllocatorMessage::ViewBegun { view } => self.on_view_begun(view, cx),
            AllocatorMessage::ViewDrawn { drawn } => self.on_view_drawn(drawn, cx),
            AllocatorMessage::ObjectsRanked { view: _, saliency } => self.on_objects_ranked(saliency),
            AllocatorMessage::JobDone { view: _, object, level: _, samples, seconds } => {
                self.order.record_time(object, samples, seconds);
                self.on_job_done(cx);
            }
            AllocatorMessage::TileSampled { view, sums, hash: _ } => self.on_tile_sampled(view, sums, cx),
            AllocatorMessage::ResidualsMeasured { view, object, level, pixel, residual } => {
                self.order.record(u64::from(view.0), object, level, pixel, &residual);
            }
            AllocatorMessage::EnvironmentCaptured { object, seen, hash: _, seconds } => {
                self.on_environment_captured(object, &seen, seconds, cx);
            }
            AllocatorMessage::EnvironmentFiltered { object, contrast } => {
                self.on_environment_filtered(object, contrast, cx);
            }
            AllocatorMessage::TexturesSeen { uses, hash: _ } => self.on_textures_seen(&uses, cx),
            AllocatorMessage::LevelLoaded { texture, level, texels } => {
                self.on_level_loaded(texture, level, texels, cx);
            }
            AllocatorMessage::TexturesReleased { drops } => self.on_textures_released(drops, cx),
            AllocatorMessage::Adjusted(adjustment) => self.on_adjusted(&adjustment, cx),
            AllocatorMessage::Incident(incident) => self.on_incident(incident, cx),
            AllocatorMessage::DecideOn => self.on_decide_on(cx),
            AllocatorMessage::SendAgain => self.outbox.send(cx),
        }
    }

    fn save(&self, saver: &mut Saver) {
        self.save_state(saver);
    }

    fn restore(&mut self, loader: &mut Loader<'_>) -> Option<()> {
        self.restore_state(loader)
    }
}
