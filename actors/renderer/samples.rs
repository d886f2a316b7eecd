//! Samples as they reach the splat layer, and how wrong what was shown before them was.

use std::sync::Arc;

use foveal::allocation::policy::Policy;
use foveal::allocation::ray_order::residual_of_batch;
use foveal::display::environment_map::EnvironmentMap;
use foveal::splatting::{Guides, SampleBatch, WarpedSample};
use foveal_runtime::Cx;
use glam::Vec3;

use super::{Renderer, Splats};
use crate::message::{AllocatorMessage, CacheAgerMessage, DrawnView, RendererMessage, View};
use crate::stages::Stage;

impl Renderer {
    pub(super) fn on_samples_aged(
        &mut self,
        view: View,
        samples: Arc<Vec<WarpedSample>>,
        expired: u32,
        cx: &mut Cx<'_, RendererMessage>,
    ) {
        if view != self.view {
            return;
        }
        let Some(drawn) = self.drawn.clone() else { return };
        let (layer, buffers) = (&mut self.layer, drawn.buffers());
        let splat = || layer.splat_warped(&samples, &buffers.object, &buffers.depth);
        let (reused, took) = cx.measure(|| self.stages.time(Stage::WarpSplat, splat));
        self.warping += took;
        self.counts.reused += reused as u32;
        self.counts.expired += expired;
        self.changed |= reused > 0;
        if !cx.replays() {
            self.sink.splatted(view, Splats::Warped(samples));
        }
    }

    pub(super) fn on_samples_traced(
        &mut self,
        batch: Arc<SampleBatch>,
        tracer: u32,
        cx: &mut Cx<'_, RendererMessage>,
    ) {
        let (Some(drawn), true) = (self.drawn.clone(), batch.view == self.view.0) else {
            self.counts.late += batch.len() as u32;
            return;
        };
        self.counts.traced += batch.len() as u32;
        self.changed = true;
        if self.settings.policy.policy == Policy::Utility {
            self.measure_residuals(&batch, &drawn, cx);
        }
        let layer = &mut self.layer;
        let source = (tracer % 255) as u8 + 1;
        self.stages.time(Stage::WarpSplat, || layer.splat_fresh(&batch, &drawn.buffers().object, source));
        if !cx.replays() {
            self.sink.splatted(self.view, Splats::Fresh { batch, source });
        }
    }

    pub(super) fn on_guides_traced(&mut self, guides: Arc<Guides>, cx: &Cx<'_, RendererMessage>) {
        if guides.view != self.view.0 {
            return;
        }
        self.changed = true;
        let layer = &mut self.layer;
        self.stages.time(Stage::WarpSplat, || layer.guide(&guides));
        if !cx.replays() {
            self.sink.splatted(self.view, Splats::Guides(guides));
        }
    }

    /// Pixels that no sample has reached yet show the new map in the next frame.
    pub(super) fn on_environment_changed(&mut self, object: u32, map: Option<Arc<EnvironmentMap>>) {
        let Some(approximation) = &mut self.approximation else { return };
        approximation.set(object, map);
        let (Some(drawn), false) = (&self.drawn, self.converged) else { return };
        let objects = &drawn.buffers().object;
        self.layer.disapprove(|x, y| objects.at(x, y) == object);
        self.changed = true;
    }

    /// Tells the allocator how wrong what is shown was.
    fn measure_residuals(&self, batch: &SampleBatch, drawn: &DrawnView, cx: &mut Cx<'_, RendererMessage>) {
        let Some(neighbours) = &self.neighbours else { return };
        let base = &drawn.buffers().color;
        let between = self.between(drawn);
        let first = |x, y| match &self.approximation {
            Some(first) if self.layer.is_bare(x, y) => {
                Some(first.pixel(&self.world, &drawn.frame, drawn.buffers(), x, y))
            }
            _ => None,
        };
        let of = |shown: &dyn Fn(usize, usize, usize) -> Vec3| {
            residual_of_batch(batch, base, shown, &self.tone, &self.viewing, &self.thresholds)
        };
        let (residual, guided) = self.stages.time(Stage::Allocate, || {
            let residual = of(&|_, x, y| match self.layer.guide_at(x, y) {
                Some(guide) => between.pixel_led_by(x, y, guide),
                None => first(x, y).unwrap_or_else(|| between.pixel(x, y)),
            });
            if batch.guides.is_empty() {
                return (residual, Default::default());
            }
            let with = of(&|i, x, y| between.pixel_led_by(x, y, batch.guide(i)));
            let without = of(&|_, x, y| first(x, y).unwrap_or_else(|| between.pixel_led_by(x, y, Vec3::NAN)));
            (residual, [with, without])
        });
        let measured = AllocatorMessage::ResidualsMeasured {
            view: self.view,
            object: batch.object,
            level: self.settings.k_max + 1 - batch.k.min(self.settings.k_max),
            pixel: batch.pixels.first().copied().unwrap_or_default(),
            residual,
            guided,
        };
        // Where the allocator is that far behind, it learns from the next batch as well.
        let _ = cx.tell(&neighbours.allocator, measured);
    }

    /// A new cache ager does not know what the old one was told.
    pub(super) fn on_samples_forgotten(&mut self, cx: &mut Cx<'_, RendererMessage>) {
        if let (Some(neighbours), Some(adjustment)) = (&self.neighbours, self.adjustment) {
            self.outbox.tell(cx, &neighbours.cache_ager, CacheAgerMessage::Adjusted(adjustment));
        }
    }
}
