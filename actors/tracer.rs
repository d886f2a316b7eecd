//! A tracer: pops the best job, traces it, sends the samples on. Owns nothing that lasts.

use std::sync::Arc;

use foveal::allocation::jobs::job_pixels;
use foveal::sampling::Lattice;
use foveal::splatting::trace::{Owner, trace_samples};
use foveal_runtime::{Actor, Address, Class, Cx, Digest, Job, Message, Worker};

use crate::message::{AllocatorMessage, CacheAgerMessage, RendererMessage, TraceJob};

/// What a tracer can be told: nothing. Its work comes from the pool.
#[derive(Clone, Copy, Debug)]
pub enum TracerMessage {}

impl Message for TracerMessage {
    fn digest(&self, _digest: &mut Digest) {
        match *self {}
    }

    fn kind(&self) -> &'static str {
        match *self {}
    }
}

impl Job for TraceJob {
    fn digest(&self, digest: &mut Digest) {
        digest.u32(self.drawn.view.0);
        digest.u64(self.drawn.hash);
        let o = &self.order;
        for word in [o.object, o.level, o.count, o.start.x as u32, o.start.y as u32] {
            digest.u32(word);
        }
    }

    fn describe(&self) -> String {
        let (o, r) = (&self.order, &self.order.rect);
        format!(
            "{} samples of object {}, level {}, view {}, pixels [{}, {}) × [{}, {}) from ({}, {}), seed {}",
            o.count,
            o.object,
            o.level,
            self.drawn.view.0,
            r.x0,
            r.x1,
            r.y0,
            r.y1,
            o.start.x,
            o.start.y,
            self.seed
        )
    }

    fn kind(&self) -> &'static str {
        "TraceJob"
    }
}

/// A tracer's state.
pub struct Tracer {
    /// Its number among the tracers, from 0.
    index: u32,
    lattice: Lattice,
    renderer: Address<RendererMessage>,
    cache_ager: Address<CacheAgerMessage>,
    allocator: Address<AllocatorMessage>,
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
        Self { index, lattice, renderer, cache_ager, allocator }
    }

    fn job_done(&self, job: &TraceJob, samples: u32, cx: &mut Cx<'_, TracerMessage>) {
        let done = AllocatorMessage::JobDone {
            view: job.drawn.view,
            object: job.order.object,
            level: job.order.level,
            samples,
        };
        // The allocator's mailbox holds an answer to every job that can be out.
        let accepted = cx.tell(&self.allocator, done);
        debug_assert!(accepted.is_ok(), "one answer for each job");
    }
}

impl Actor for Tracer {
    type Msg = TracerMessage;
    const NAME: &'static str = "tracer";
    const CLASS: Class = Class::Heavy;

    fn handle(&mut self, message: TracerMessage, _cx: &mut Cx<'_, TracerMessage>) {
        match message {}
    }
}

impl Worker for Tracer {
    type Job = TraceJob;

    fn run(&mut self, job: &TraceJob, cx: &mut Cx<'_, TracerMessage>) {
        let drawn = &job.drawn;
        let owner =
            Owner { view: drawn.view.0, object: job.order.object, k: self.lattice.k_of(job.order.level) };
        let pixels = job_pixels(&self.lattice, &job.order, &drawn.buffers.object);
        let batch =
            Arc::new(trace_samples(&drawn.world, &drawn.frame, &drawn.buffers, owner, pixels, job.seed));
        let (samples, hash) = (batch.len() as u32, batch.digest());
        // Samples before the word that the job is done: so the allocator's "converged" comes after them.
        let to_renderer = RendererMessage::SamplesTraced { batch: batch.clone(), tracer: self.index, hash };
        let accepted = cx.tell(&self.renderer, to_renderer);
        debug_assert!(accepted.is_ok(), "the renderer has room for the samples of every job that can be out");
        let accepted = cx.tell(&self.cache_ager, CacheAgerMessage::SamplesTraced { batch, hash });
        debug_assert!(
            accepted.is_ok(),
            "the cache ager has room for the samples of every job that can be out"
        );
        self.job_done(job, samples, cx);
    }

    fn stale(&mut self, job: TraceJob, cx: &mut Cx<'_, TracerMessage>) {
        self.job_done(&job, 0, cx);
    }
}
