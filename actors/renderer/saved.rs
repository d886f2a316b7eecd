//! The renderer's state in a snapshot of a replay.

use std::sync::Arc;

use foveal::display::first_approximation::FirstApproximation;
use foveal::splatting::supersampling::Tiles;
use foveal::splatting::tile_sums::TileSums;
use foveal_runtime::{Loader, Saver};

use super::growth::Growth;
use super::{FrameCounts, Renderer, TextureChange};
use crate::message::saved::Saved;

impl Renderer {
    /// Puts down everything that a replay goes on from.
    pub(super) fn save_state(&self, saver: &mut Saver) {
        let Self {
            // What the wiring makes alike.
            settings: _,
            passes: _,
            tone: _,
            viewing: _,
            thresholds: _,
            encoder: _,
            neighbours: _,
            stages: _,
            sink: _,
            // Only room, only a time that is shown, and who may hold what: what was seen of that is recorded.
            retired: _,
            drawn_at: _,
            former: _,
            world,
            target,
            lit,
            adjustment,
            camera,
            view,
            drawing,
            sparse_share,
            following,
            warping,
            drawn,
            layer,
            approximation,
            counts,
            converged,
            tiles,
            settled,
            refined,
            changed,
            shown,
            outbox,
            waiting,
            releasing,
            drops,
        } = self;
        if !outbox.is_empty() {
            return saver.refuse();
        }
        world.save(saver);
        let growth = target.as_ref().map(|growth| (growth.last, growth.left));
        saver.put(&(lit, releasing, drops, growth, waiting.len() as u64));
        if let Some(Growth { light, .. }) = target {
            light.save(saver);
        }
        for TextureChange { texture, finest, texels } in waiting {
            saver.put(&(texture, finest));
            texels.save(saver);
        }
        saver.put(adjustment);
        saver.put(&(camera, view, converged, changed, drawn.is_some(), shown.is_some()));
        let FrameCounts { traced, reused, expired, late, approximated, refined: refined_now } = counts;
        saver.put(&(traced, reused, expired, late, approximated, refined_now));
        saver.put(&(drawing, sparse_share, following, warping));
        saver.put(&(refined, tiles.len() as u64));
        for tile in tiles {
            tile.save(saver);
        }
        settled.save(saver);
        if let Some(drawn) = drawn {
            drawn.save(saver);
        }
        if let Some(shown) = shown {
            shown.save(saver);
        }
        saver.put(&layer.is_guided());
        layer.columns().into_iter().for_each(|column| saver.bytes(column));
        let maps = approximation.as_ref().map_or(&[][..], FirstApproximation::maps);
        saver.put(&(maps.len() as u64));
        for map in maps {
            saver.put(&map.is_some());
            if let Some(map) = map {
                saver.shared(map, |map, saver| saver.put(map));
            }
        }
    }

    /// Takes it up again; `None` if the snapshot holds something else.
    pub(super) fn restore_state(&mut self, loader: &mut Loader<'_>) -> Option<()> {
        self.world = Saved::restore(loader)?;
        let (growth, count): (Option<(bool, Option<f32>)>, u64);
        (self.lit, self.releasing, self.drops, growth, count) = loader.take()?;
        self.target = match growth {
            Some((last, left)) => Some(Growth { light: Saved::restore(loader)?, last, left }),
            None => None,
        };
        for _ in 0..count {
            let (texture, finest) = loader.take()?;
            self.waiting.push_back(TextureChange { texture, finest, texels: Saved::restore(loader)? });
        }
        self.adjustment = loader.take()?;
        if let Some(adjustment) = &self.adjustment {
            self.settings.adjust(adjustment);
        }
        let (camera, view, converged, changed, is_drawn, is_shown) = loader.take()?;
        (self.camera, self.view, self.converged, self.changed) = (camera, view, converged, changed);
        let (traced, reused, expired, late, approximated, refined) = loader.take()?;
        self.counts = FrameCounts { traced, reused, expired, late, approximated, refined };
        let count: u64;
        (self.drawing, self.sparse_share, self.following, self.warping) = loader.take()?;
        (self.refined, count) = loader.take()?;
        let tiles: Option<Vec<Option<Arc<TileSums>>>> = (0..count).map(|_| Saved::restore(loader)).collect();
        let grid = Tiles::of_size(self.settings.width, self.settings.height);
        self.tiles = tiles.filter(|tiles| tiles.iter().flatten().all(|sums| sums.fits(&grid)))?;
        self.settled = Saved::restore(loader)?;
        if self.settled.as_ref().is_some_and(|s| !s.fits(self.settings.width, self.settings.height)) {
            return None;
        }
        self.drawn = if is_drawn { Some(Saved::restore(loader)?) } else { None };
        self.shown = if is_shown { Some(Saved::restore(loader)?) } else { None };
        for column in self.layer.columns_mut(loader.take()?) {
            let bytes = loader.bytes().filter(|bytes| bytes.len() == column.len())?;
            column.copy_from_slice(bytes);
        }
        let count: u64 = loader.take()?;
        for object in 0..u32::try_from(count).ok()? {
            let map = if loader.take()? { Some(loader.shared(|loader| loader.take())?) } else { None };
            self.approximation.as_mut()?.set(object, map);
        }
        Some(())
    }
}
