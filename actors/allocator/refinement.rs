//! The allocator's part about refinement: more samples for the pixels of a view that has converged, tile by tile.

use std::sync::Arc;

use foveal::allocation::policy::bucket_of;
use foveal::allocation::supersampling::Supersampler;
use foveal::display::tone::ToneMap;
use foveal::splatting::tile_sums::TileSums;
use foveal_runtime::Cx;

use super::Allocator;
use crate::message::{AllocatorMessage, DrawnView, RendererMessage, SettleWork, TileWork, TraceJob, View};
use crate::stages::Stage;

impl Allocator {
    pub(super) fn on_tile_sampled(
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
        self.tell_insight_if_due();
    }

    pub(super) fn on_settled(&mut self, view: View, stated: Option<f32>, cx: &mut Cx<'_, AllocatorMessage>) {
        self.in_flight = self.in_flight.saturating_sub(1);
        let is_shown = self.drawn.as_ref().is_some_and(|drawn| drawn.view == view);
        if let (Some(supersampler), Some(stated), true) = (&mut self.supersampler, stated, is_shown) {
            supersampler.state(stated);
            self.since_insight += 1;
        }
        self.fill_pool(cx);
        self.tell_insight_if_due();
    }

    /// Orders more samples for tiles of a view that has converged.
    pub(super) fn refine(&mut self, drawn: &Arc<DrawnView>, cx: &mut Cx<'_, AllocatorMessage>) {
        let Some(supersampler) = &mut self.supersampler else { return };
        if !supersampler.has_begun() {
            supersampler.begin();
        }
        // At the end of a round the picture is made while the next one goes on.
        if let Some(tiles) = supersampler.end_round(&ToneMap::from(&drawn.world.scene.display)) {
            let work = SettleWork { drawn: drawn.clone(), tiles };
            self.outbox.push(cx, &self.pool, bucket_of(1.0), u64::from(drawn.view.0), TraceJob::Settle(work));
            self.in_flight += 1;
        }
        while self.in_flight < self.settings.jobs_in_flight() {
            let Some(order) = supersampler.next_order() else { break };
            let work = TileWork { drawn: drawn.clone(), order, seed: self.settings.seed };
            self.outbox.push(cx, &self.pool, bucket_of(0.0), u64::from(drawn.view.0), TraceJob::Tile(work));
            self.in_flight += 1;
        }
        if self.in_flight == 0 && supersampler.is_exhausted() && !self.told_refined {
            self.told_refined = true;
            // Before anybody can know.
            self.tell_insight();
            self.outbox.tell(cx, &self.renderer, RendererMessage::ViewRefined { view: drawn.view });
        }
    }

    /// Under the rules of the settings, whatever they were before.
    pub(super) fn adjust_refinement(&mut self) {
        match (self.settings.supersampling, &mut self.supersampler, &self.drawn) {
            (None, supersampler, _) => *supersampler = None,
            (Some(rules), Some(supersampler), Some(_)) => supersampler.set_rules(rules),
            (Some(rules), supersampler, _) => {
                let (width, height) = (self.settings.width, self.settings.height);
                *supersampler = Some(Supersampler::new(rules, width, height));
            }
        }
    }
}
