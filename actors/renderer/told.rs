//! The renderer's state, for whoever looks at a replay.

use foveal_runtime::Content;

use super::{FrameCounts, Renderer};
use crate::message::saved::Told;

impl Renderer {
    /// What decides what it shows next.
    pub(super) fn told(&self) -> Content {
        let FrameCounts { traced, reused, expired, late, approximated, refined } = self.counts;
        let counts = [
            ("traced", traced),
            ("reused", reused),
            ("expired", expired),
            ("late", late),
            ("approximated", approximated),
            ("refined", refined),
        ];
        let stated = self.settled.as_ref().map(|settled| settled.stated);
        let samples = self.tiles.iter().flatten().map(|tile| u64::from(tile.samples)).sum::<u64>();
        Content::fields([
            ("view", Content::of(&self.view)),
            ("camera", Content::of(&self.camera)),
            ("adjustment", Content::of(&self.adjustment)),
            ("drawn", self.drawn.content()),
            ("drawing", Content::of(&self.drawing)),
            ("sparse_share", Content::of(&self.sparse_share)),
            ("following", Content::of(&self.following)),
            ("counts", Content::fields(counts.map(|(name, count)| (name, Content::of(&count))))),
            ("converged", Content::of(&self.converged)),
            ("refined", Content::of(&self.refined)),
            ("refining_samples", Content::of(&samples)),
            ("stated", Content::of(&stated)),
            ("lit", Content::of(&self.lit)),
            ("changed", Content::of(&self.changed)),
            ("shown", self.shown.content()),
            ("textures_waiting", Content::of(&self.waiting.len())),
            ("texture_drops", Content::of(&self.drops)),
            ("outbox", Content::of(&self.outbox.len())),
        ])
    }
}
