//! Rounds of direct light, gathered at the elements.

use glam::Vec3;
use rayon::prelude::*;

use super::bake::{BLOCK, Baker};
use super::direct::{SAMPLES_PER_ROUND, probe};
use crate::rng::hash;

impl Baker<'_> {
    /// Direct light at the next `count` blocks of elements: at those that may receive some. A round ends with the last.
    pub(super) fn gather_blocks(&mut self, count: usize) {
        let first = self.direct_rounds == 0;
        if self.direct_block == 0 && !first {
            self.direct_goes_on = self.direct_noise().worth_a_round(self.direct_rounds);
        }
        let begin = self.direct_block * BLOCK;
        let end = begin.saturating_add(count.saturating_mul(BLOCK)).min(self.direct.len());
        let (atlas, transport, seed) = (&self.atlas, &self.transport, self.settings.seed);
        let (watched, chosen) = (&self.watched, &self.direct_goes_on);
        let first_block = self.direct_block;
        self.direct[begin..end].par_chunks_mut(BLOCK).enumerate().for_each(|(block, bins)| {
            let begin = begin + block * BLOCK;
            let goes_on = [0, 1].map(|side| {
                match (first, side) {
                    (true, 0) => true,
                    // Most backs are inside of bodies: a few samples each, and none finds light.
                    (true, _) => (begin..begin + bins.len()).any(|index| {
                        let e = &atlas.elements[index];
                        e.area > 0.0
                            && (transport.certain(e.triangle, e.b1, e.b2, true) != Vec3::ZERO
                                || probe(hash(seed, index as u64, 2), |u| {
                                    transport.direct(e.triangle, e.b1, e.b2, true, u)
                                }))
                    }),
                    (false, _) => chosen[first_block + block][side],
                }
            });
            for (i, bin) in bins.iter_mut().enumerate() {
                let index = begin + i;
                let e = &atlas.elements[index];
                if e.area <= 0.0 || !(first || watched[index]) {
                    continue;
                }
                for side in [0, 1] {
                    if goes_on[side] {
                        let key = hash(seed, index as u64, side as u64);
                        let (t, b1, b2, back) = (e.triangle, e.b1, e.b2, side == 1);
                        if first {
                            bin[side].set_certain(transport.certain(t, b1, b2, back));
                        }
                        bin[side].gather(key, SAMPLES_PER_ROUND, |u| transport.direct(t, b1, b2, back, u));
                    }
                }
            }
        });
        if end < self.direct.len() {
            self.direct_block = end / BLOCK;
        } else {
            self.direct_block = 0;
            self.direct_rounds += 1;
            self.sources = None;
            if first {
                self.average_shadow_edges();
            }
        }
    }
}
