//! The allocator's state in a snapshot of a replay.

use std::sync::Arc;

use foveal::allocation::supersampling::UnderWay;
use foveal::splatting::tile_sums::TileSums;
use foveal_runtime::{Loader, Saver};

use super::Allocator;
use crate::message::saved::Saved;

impl Allocator {
    /// Puts down everything that a replay goes on from.
    pub(super) fn save_state(&self, saver: &mut Saver) {
        let Self {
            settings: _,
            renderer: _,
            pool: _,
            tracers: _,
            cache_ager: _,
            stages: _,
            scan: _,
            since_insight: _,
            insight: _,
            adjustment,
            outbox,
            order,
            begun,
            drawn,
            statistics,
            saliency,
            attention,
            in_flight,
            credits,
            environments,
            textures,
            portion_waits,
            owed_to_samples,
            told_converged,
            supersampler,
            told_refined,
            lost_jobs,
            incidents,
            dead_jobs,
        } = self;
        if !outbox.is_empty() {
            return saver.refuse();
        }
        saver.put(adjustment);
        if self.settings.stations > 0 {
            saver.put(credits);
        }
        saver.put(&(order, statistics, saliency.as_slice(), attention));
        saver.put(&(
            begun,
            in_flight,
            portion_waits,
            owed_to_samples,
            told_converged,
            told_refined,
            lost_jobs,
            incidents,
            dead_jobs,
            drawn.is_some(),
        ));
        if let Some(drawn) = drawn {
            drawn.save(saver);
        }
        if let Some(supersampler) = supersampler {
            let UnderWay { sums, begun, early, open, round, lost, stated, traced } = supersampler.under_way();
            saver.put(&(open, round, lost, stated, begun, early.len() as u64, sums.len() as u64));
            early.into_values().map(Some).chain(sums).for_each(|sums| sums.save(saver));
            traced.save(saver);
        }
        environments.save(saver);
        if let Some(textures) = textures {
            textures.save(saver);
        }
    }

    /// Takes it up again; `None` if the snapshot holds something else.
    pub(super) fn restore_state(&mut self, loader: &mut Loader<'_>) -> Option<()> {
        if let Some(adjustment) = loader.take()? {
            self.adjust(&adjustment);
        }
        if self.settings.stations > 0 {
            self.credits = loader.take()?;
        }
        let saliency: Vec<f32>;
        (self.order, self.statistics, saliency, self.attention) = loader.take()?;
        self.saliency = Arc::new(saliency);
        let is_drawn: bool;
        (
            self.begun,
            self.in_flight,
            self.portion_waits,
            self.owed_to_samples,
            self.told_converged,
            self.told_refined,
            self.lost_jobs,
            self.incidents,
            self.dead_jobs,
            is_drawn,
        ) = loader.take()?;
        self.drawn = if is_drawn { Some(Saved::restore(loader)?) } else { None };
        if let Some(supersampler) = &mut self.supersampler {
            let (blocks, tiles): (u64, u64);
            let mut under_way = UnderWay::default();
            let UnderWay { sums, begun, early, open, round, lost, stated, traced } = &mut under_way;
            (*open, *round, *lost, *stated, *begun, blocks, tiles) = loader.take()?;
            for _ in 0..blocks {
                let block = Option::<Arc<TileSums>>::restore(loader)??;
                early.insert((block.tile, block.first), block);
            }
            *sums = (0..tiles).map(|_| Saved::restore(loader)).collect::<Option<_>>()?;
            *traced = Saved::restore(loader)?;
            supersampler.restore(under_way)?;
        }
        self.environments.restore(loader)?;
        self.textures.as_mut().map_or(Some(()), |textures| textures.restore(loader))
    }
}
