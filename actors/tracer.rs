//! A tracer: pops the best job, traces it, sends the samples on. Owns nothing that lasts but what was not accepted.

use std::sync::Arc;

use foveal::allocation::jobs::job_pixels;
use foveal::sampling::Lattice;
use foveal::splatting::trace::{Owner, trace_samples};
use foveal_runtime::{Actor, Address, Class, Cx, Worker};

use crate::message::{AllocatorMessage, CacheAgerMessage, RendererMessage, TraceJob, TracerMessage};
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

    fn job_done(&mut self, job: &TraceJob, samples: u32, cx: &mut Cx<'_, TracerMessage>) {
        let done = AllocatorMessage::JobDone {
            view: job.drawn.view,
            object: job.order.object,
            level: job.order.level,
            samples,
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
        self.outbox.tell(cx, &self.renderer, to_renderer);
        self.outbox.tell(cx, &self.cache_ager, CacheAgerMessage::SamplesTraced { batch, hash });
        self.job_done(job, samples, cx);
    }

    fn stale(&mut self, job: TraceJob, cx: &mut Cx<'_, TracerMessage>) {
        self.job_done(&job, 0, cx);
    }
}
