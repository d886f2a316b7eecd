//! The allocator's state in a snapshot of a replay.

use std::sync::Arc;

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
            since_map,
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
            since_map,
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
            saver.put(&(supersampler.open(), supersampler.progress(), supersampler.tiles().len() as u64));
            for tile in supersampler.tiles() {
                tile.save(saver);
            }
            supersampler.traced().cloned().save(saver);
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
            self.since_map,
            self.told_converged,
            self.told_refined,
            self.lost_jobs,
            self.incidents,
            self.dead_jobs,
            is_drawn,
        ) = loader.take()?;
        self.drawn = if is_drawn { Some(Saved::restore(loader)?) } else { None };
        if let Some(supersampler) = &mut self.supersampler {
            let (open, progress, count): (_, _, u64) = loader.take()?;
            let tiles: Option<Vec<_>> = (0..count).map(|_| Saved::restore(loader)).collect();
            supersampler.restore(tiles?, open, progress, Saved::restore(loader)?)?;
        }
        self.environments.restore(loader)?;
        self.textures.as_mut().map_or(Some(()), |textures| textures.restore(loader))
    }
}
