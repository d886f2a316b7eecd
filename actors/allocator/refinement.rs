//! The allocator's part about refinement: more samples for the pixels of a view that has converged, tile by
//! tile, and light traced to the eye, run by run.

use std::sync::Arc;

use foveal::allocation::policy::bucket_of;
use foveal::allocation::supersampling::Supersampler;
use foveal::display::tone::ToneMap;
use foveal::splatting::light_tracing::{LightSums, Splats};
use foveal::splatting::tile_sums::TileSums;
use foveal_runtime::Cx;

use super::Allocator;
use crate::message::{
    AllocatorMessage, DrawnView, RendererMessage, RunWork, SettleWork, TileWork, TraceJob, View,
};
use crate::stages::Stage;

impl Allocator {
    pub(super) fn on_block_sampled(
        &mut self,
        view: View,
        block: Option<Arc<TileSums>>,
        cx: &mut Cx<'_, AllocatorMessage>,
    ) {
        self.in_flight = self.in_flight.saturating_sub(1);
        if let (Some(supersampler), Some(drawn), Some(block)) = (&mut self.supersampler, &self.drawn, block)
            && drawn.view == view
        {
            let tone = ToneMap::from(&drawn.world.scene.display);
            let grown = self.stages.time(Stage::Allocate, || supersampler.record(block, &tone));
            self.since_insight += 1;
            if let Some(sums) = grown {
                let hash = sums.digest();
                self.outbox.tell(cx, &self.renderer, RendererMessage::TileSampled { view, sums, hash });
            }
        }
        self.fill_pool(cx);
        self.tell_insight_if_due();
    }

    pub(super) fn on_run_traced(
        &mut self,
        view: View,
        splats: Option<&Splats>,
        cx: &mut Cx<'_, AllocatorMessage>,
    ) {
        self.in_flight = self.in_flight.saturating_sub(1);
        if let (Some(supersampler), Some(drawn), Some(splats)) = (&mut self.supersampler, &self.drawn, splats)
            && drawn.view == view
        {
            self.stages.time(Stage::Allocate, || supersampler.record_run(splats));
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
        let jobs_in_flight = self.jobs_in_flight();
        let Some(supersampler) = &mut self.supersampler else { return };
        if !supersampler.has_begun() {
            let (world, data) = (&drawn.world, drawn.buffers().color.data());
            let is_possible = world.caustics().is_possible();
            supersampler.begin(is_possible.then(|| LightSums::new(world, data.len())));
        }
        // At the end of a round the picture is made while the next one goes on.
        if let Some((tiles, traced)) = supersampler.end_round(&ToneMap::from(&drawn.world.scene.display)) {
            let work = SettleWork { drawn: drawn.clone(), tiles, traced };
            self.outbox.push(cx, &self.pool, bucket_of(1.0), u64::from(drawn.view.0), TraceJob::Settle(work));
            self.in_flight += 1;
        }
        while self.in_flight < jobs_in_flight {
            let (drawn, seed) = (drawn.clone(), self.settings.seed);
            let view = u64::from(drawn.view.0);
            let job = if let Some(run) = supersampler.next_run() {
                TraceJob::Run(RunWork { drawn, run, seed })
            } else if let Some(block) = supersampler.next_block() {
                TraceJob::Tile(TileWork { drawn, block, seed })
            } else {
                break;
            };
            self.outbox.push(cx, &self.pool, bucket_of(0.0), view, job);
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
