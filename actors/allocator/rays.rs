//! The allocator's part about rays: which samples come next, by level, policy, saliency and importance.
//!
//! The pool is kept filled for a few jobs per tracer, so that what is learnt counts soon. A view has converged once every
//! level is traced and its textures are there.

use std::sync::Arc;

use foveal::allocation::policy::bucket_of;
use foveal::perception::importance::priorities;
use foveal_runtime::Cx;

use super::Allocator;
use super::textures::Textures;
use crate::message::{AllocatorMessage, RendererMessage, SampleOrder, TraceJob};
use crate::stages::Stage;

impl Allocator {
    pub(super) fn on_objects_ranked(&mut self, saliency: Arc<Vec<f32>>) {
        // The saliency of the view before says more than none.
        self.saliency = saliency;
        self.update_attention();
        self.order.attend(&self.attention);
    }

    pub(super) fn on_job_done(&mut self, cx: &mut Cx<'_, AllocatorMessage>) {
        self.in_flight = self.in_flight.saturating_sub(1);
        self.since_insight += 1;
        self.fill_pool(cx);
        self.tell_insight_if_due();
    }

    /// Those of the tracers, and what stations can have beside them.
    pub(super) fn jobs_in_flight(&self) -> u32 {
        self.settings.jobs_in_flight() + self.credits.values().sum::<u32>()
    }

    pub(super) fn update_attention(&mut self) {
        for (id, s) in self.statistics.iter_mut().enumerate() {
            s.saliency = self.saliency.get(id).copied().unwrap_or(0.0);
        }
        let (w, h) = (self.settings.width as usize, self.settings.height as usize);
        priorities(&self.statistics, w, h, self.settings.saliency_weight, &mut self.attention);
    }

    pub(super) fn fill_pool(&mut self, cx: &mut Cx<'_, AllocatorMessage>) {
        let Some(drawn) = self.drawn.clone() else { return };
        let stages = self.stages.clone();
        stages.time(Stage::Allocate, || {
            while self.in_flight < self.jobs_in_flight() {
                let Some((order, priority)) = self.order.next(&drawn.buffers().object) else { break };
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
