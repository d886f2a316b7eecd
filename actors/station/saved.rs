//! A station in snapshots of a replay. The jobs it keeps are saved with its place at the pool.

use foveal_runtime::{Loader, Saver};

use super::Station;

impl Station {
    pub(super) fn save_state(&self, saver: &mut Saver) {
        let Self {
            index: _,
            lattice: _,
            pool: _,
            to: _,
            outlet: _,
            outbox,
            guest,
            out,
            views,
            timer,
            credits,
            counts,
            checked: _,
            board: _,
        } = self;
        if !outbox.is_empty() {
            return saver.refuse();
        }
        saver.put(&(guest, out, views, timer, credits, counts));
    }

    pub(super) fn restore_state(&mut self, loader: &mut Loader<'_>) -> Option<()> {
        (self.guest, self.out, self.views, self.timer, self.credits, self.counts) = loader.take()?;
        Some(())
    }
}
