//! What the allocator thinks, for whoever looks on: overlays, panels, replays. No actor decides by it. A clock outside may,
//! where quality is to be kept: what it decides is an input, recorded like all others.

use std::sync::Arc;
use std::time::Duration;

use crossbeam_queue::ArrayQueue;
use foveal::allocation::supersampling::RefinementProgress;
use foveal::display::environment_map::texel_count;

use crate::message::View;
use crate::textures::TextureReport;

/// Longest that a frame waits to become good enough, where quality is to be kept.
pub const LONGEST_FRAME: Duration = Duration::from_secs(10);

/// What is known of one object.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ObjectInsight {
    /// Pixels that show it.
    pub pixels: u32,
    /// Mean saliency of its pixels in the newest frame that was looked at.
    pub saliency: f32,
    /// Importance in [0, 1] (Haber 2001 §3).
    pub importance: f32,
    /// Both combined, in [0, 1].
    pub attention: f32,
    /// Priority of its next job; infinite where it comes before all others, 0 where nothing is left to trace.
    pub priority: f32,
    /// Level of its next job; 0 where nothing is left.
    pub level: u32,
    /// Estimated error that it shows, just noticeable differences; `None` before anything is known.
    pub error: Option<f32>,
}

/// An object's environment map in the ranking (Dumont 2003, Eq. (10) and figure 16).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapRank {
    /// Object id.
    pub object: u32,
    /// What the map takes off the visible error: saliency × pixels × just noticeable differences.
    pub worth: f32,
    /// Texels along an edge of the map that is there; 0 for none.
    pub side: u32,
    /// Texels along an edge that are wanted.
    pub wanted: u32,
    /// Whether it is kept within the budget.
    pub kept: bool,
}

impl MapRank {
    /// Bytes of the map that is wanted.
    pub fn asked_bytes(&self) -> u64 {
        map_bytes(self.wanted as usize)
    }

    /// Bytes of the map that is there.
    pub fn given_bytes(&self) -> u64 {
        map_bytes(self.side as usize)
    }

    /// Visible error for want of a map, in the unit of [`MapRank::worth`].
    pub fn visible_loss(&self) -> f32 {
        if self.side == 0 { self.worth } else { 0.0 }
    }
}

/// Bytes of a texel of a map: radiance and distance.
const TEXEL_BYTES: usize = 16;

/// Bytes of a map of this side.
pub fn map_bytes(side: usize) -> u64 {
    (texel_count(side) * TEXEL_BYTES) as u64
}

/// Everything at a moment.
#[derive(Clone, Debug, Default)]
pub struct Insight {
    /// The view it was thought of in.
    pub view: View,
    /// By object id.
    pub objects: Vec<ObjectInsight>,
    /// The most worth first.
    pub maps: Vec<MapRank>,
    /// Bytes of the maps that are there, and most bytes.
    pub map_bytes: [u64; 2],
    /// Visible error that one more MiB of maps would take away, in the unit of [`MapRank::worth`].
    pub map_price_per_mib: f64,
    /// Textures, where they are limited, and the limit in bytes.
    pub textures: Option<(TextureReport, u64)>,
    /// How far the converged view is refined, once that has begun.
    pub refinement: Option<RefinementProgress>,
    /// Q per pixel (Dumont 2003, Eq. (1)): −1 × the mean visible error of rays that are still to come and of texture levels
    /// that are missing, just noticeable differences. 0 is the gold standard; −∞ while nothing is known.
    pub quality: f32,
    /// Jobs that were given up so far: several tracers panicked over each, or hung at it.
    pub lost_jobs: u32,
}

/// Holds the newest.
#[derive(Clone, Debug)]
pub struct InsightSlot(Arc<ArrayQueue<Insight>>);

impl Default for InsightSlot {
    fn default() -> Self {
        Self(Arc::new(ArrayQueue::new(1)))
    }
}

impl InsightSlot {
    /// Replaces what nobody has taken.
    pub fn put(&self, insight: Insight) {
        self.0.force_push(insight);
    }

    /// The newest, once.
    pub fn take(&self) -> Option<Insight> {
        self.0.pop()
    }
}
