//! The allocator: decides which samples are traced next.
//!
//! Owns the progress of every visible object through its levels, the policy, and how deep the job pool
//! is filled. Hears: a view is begun, a view was drawn, objects were ranked, a job is done, residuals were measured, a
//! job was given up. Says: jobs into the pool; to the renderer, that a view has converged.

use std::sync::Arc;

use foveal::allocation::jobs::SampleJobs;
use foveal::allocation::policy::{Demand, RayPolicy, bucket_of};
use foveal::perception::importance::{ObjectScan, ObjectStatistics, priorities};
use foveal_runtime::{Actor, Address, Cx, Incident, JobPool};

use crate::message::{AllocatorMessage, DrawnView, RendererMessage, TraceJob, TracerMessage, View};
use crate::outbox::Outbox;
use crate::settings::Settings;
use crate::stages::{Stage, StageTimes};

/// The allocator's state.
pub struct Allocator {
    settings: Settings,
    renderer: Address<RendererMessage>,
    pool: JobPool<TraceJob>,
    /// By number.
    tracers: Vec<Address<TracerMessage>>,
    outbox: Outbox<AllocatorMessage>,
    stages: StageTimes,
    /// Progress through the levels.
    jobs: SampleJobs,
    /// The newest view; `None` while one is being drawn.
    drawn: Option<Arc<DrawnView>>,
    /// Objects of that view, by id.
    statistics: Vec<ObjectStatistics>,
    scan: ObjectScan,
    /// Mean saliency by object id, in the last frame that was looked at.
    saliency: Arc<Vec<f32>>,
    /// Combined saliency and importance by object id.
    attention: Vec<f32>,
    /// Jobs in the pool or with a tracer, of any view.
    in_flight: u32,
    /// Whether the renderer knows that the view has converged.
    told_converged: bool,
    /// Jobs that were given up.
    lost_jobs: u32,
    /// What the runtime had to tell.
    incidents: Vec<Incident>,
}

/// What the policy asks about (object, level) pairs, borrowed apart from the jobs' own state.
struct Priorities<'a> {
    policy: &'a RayPolicy,
    attention: &'a [f32],
    statistics: &'a [ObjectStatistics],
    picture: f32,
    view: u64,
    winner: Option<u32>,
}

impl Priorities<'_> {
    fn of(&self, object: u32, level: u32) -> f32 {
        if self.winner == Some(object) {
            // Winner takes all: before everything else, whatever its level.
            return 1.0;
        }
        let at = |v: &[f32]| v.get(object as usize).copied().unwrap_or(0.0);
        self.policy.priority(&Demand {
            object,
            level,
            attention: at(self.attention),
            coverage: self.statistics.get(object as usize).map_or(0.0, |s| s.pixels as f32 / self.picture),
            utility: 0.0,
            frame: self.view,
        })
    }
}

macro_rules! priorities {
    ($self:ident) => {
        Priorities {
            policy: &$self.settings.policy,
            attention: &$self.attention,
            statistics: &$self.statistics,
            picture: $self.settings.width as f32 * $self.settings.height as f32,
            view: $self.drawn.as_ref().map_or(0, |d| u64::from(d.view.0)),
            winner: if $self.settings.winner_takes_all { most_attended(&$self.attention) } else { None },
        }
    };
}

fn most_attended(attention: &[f32]) -> Option<u32> {
    let best = attention.iter().enumerate().skip(1).max_by(|a, b| a.1.total_cmp(b.1).then(b.0.cmp(&a.0)))?;
    (*best.1 > 0.0).then_some(best.0 as u32)
}

impl Allocator {
    /// An allocator that has not seen a view.
    pub fn new(
        settings: Settings,
        renderer: Address<RendererMessage>,
        pool: JobPool<TraceJob>,
        tracers: Vec<Address<TracerMessage>>,
        stages: StageTimes,
    ) -> Self {
        Self {
            jobs: SampleJobs::new(settings.lattice(), settings.samples_per_job),
            settings,
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
            told_converged: false,
            lost_jobs: 0,
            incidents: Vec::new(),
        }
    }

    /// Jobs that were given up after killing their tracers.
    pub fn lost_jobs(&self) -> u32 {
        self.lost_jobs
    }

    /// Jobs that nobody has answered yet, in the pool, with a tracer or on their way.
    pub fn in_flight(&self) -> u32 {
        self.in_flight
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
    }

    fn on_view_drawn(&mut self, drawn: Arc<DrawnView>, cx: &mut Cx<'_, AllocatorMessage>) {
        let stages = self.stages.clone();
        stages.time(Stage::Allocate, || {
            self.scan.gather(&drawn.buffers.object, None, drawn.object_count, &mut self.statistics);
            self.drawn = Some(drawn);
            self.told_converged = false;
            self.update_attention();
            let priorities = priorities!(self);
            self.jobs.start_view(&self.statistics, |o, l| priorities.of(o, l));
        });
        self.fill_pool(cx);
    }

    fn on_objects_ranked(&mut self, saliency: Arc<Vec<f32>>) {
        // The saliency of the view before says more than none.
        self.saliency = saliency;
        self.update_attention();
        let priorities = priorities!(self);
        self.jobs.reprioritise(|o, l| priorities.of(o, l));
    }

    fn on_job_done(&mut self, cx: &mut Cx<'_, AllocatorMessage>) {
        self.in_flight = self.in_flight.saturating_sub(1);
        self.fill_pool(cx);
    }

    fn on_incident(&mut self, incident: Incident, cx: &mut Cx<'_, AllocatorMessage>) {
        match &incident {
            Incident::JobDead { .. } => {
                self.lost_jobs += 1;
                self.incidents.push(incident);
                self.on_job_done(cx);
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
                let priorities = priorities!(self);
                let next = self.jobs.next(&drawn.buffers.object, |o, l| priorities.of(o, l));
                let Some((order, priority)) = next else { break };
                let job = TraceJob { drawn: drawn.clone(), order, seed: self.settings.seed };
                let bucket = bucket_of(priority);
                self.outbox.push(cx, &self.pool, bucket, u64::from(drawn.view.0), job);
                self.in_flight += 1;
            }
        });
        if self.in_flight == 0 && self.jobs.is_exhausted() && !self.told_converged {
            let message = RendererMessage::ViewConverged { view: drawn.view };
            self.outbox.tell(cx, &self.renderer, message);
            self.told_converged = true;
        }
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
            AllocatorMessage::JobDone { .. } => self.on_job_done(cx),
            AllocatorMessage::Incident(incident) => self.on_incident(incident, cx),
            AllocatorMessage::SendAgain => self.outbox.send(cx),
        }
    }
}
