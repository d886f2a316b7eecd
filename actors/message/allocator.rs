//! The allocator's inbox.

use std::sync::Arc;

use foveal::allocation::environment::MapContrast;
use foveal::allocation::rays::Residual;
use foveal::allocation::texture_demand::TextureUse;
use foveal::display::environment_map::Seen;
use foveal::scene::texture::LevelTexels;
use foveal::splatting::light_tracing::Splats;
use foveal::splatting::tile_sums::TileSums;
use foveal_runtime::{DeadJob, Incident, Message};

use super::tracer::TraceBrief;
use super::{DrawnView, View, saved};
use crate::settings::Adjustment;

/// Everything the allocator can be told.
#[derive(Clone, Debug, Message)]
pub enum AllocatorMessage {
    /// From the renderer: a new view is being drawn; jobs of older ones are void, so that the tracers leave the
    /// cores to the drawing.
    #[message(lane = latest(0))]
    ViewBegun {
        /// The view.
        view: View,
    },
    /// From the renderer: a new view is drawn; jobs of older ones are void.
    #[message(lane = latest(1))]
    ViewDrawn {
        /// The view.
        #[message(with = saved)]
        drawn: Arc<DrawnView>,
    },
    /// From the analyzer: how much each object matters to the eye.
    ObjectsRanked {
        /// The view that was looked at.
        view: View,
        /// Mean saliency of each object's pixels, by object id, in [0, 1].
        saliency: Arc<Vec<f32>>,
    },
    /// From a tracer: a job is done and its samples are on their way.
    JobDone {
        /// The view it was for.
        view: View,
        /// Object id.
        object: u32,
        /// Level.
        level: u32,
        /// Samples traced.
        samples: u32,
        /// How long that took on one core, seconds, as measured.
        seconds: f32,
    },
    /// From the renderer, where the policy learns from it: how far samples were from what was shown.
    ResidualsMeasured {
        /// The view they were splatted into.
        view: View,
        /// Object id.
        object: u32,
        /// Level.
        level: u32,
        /// Where the first of them is.
        pixel: [u16; 2],
        /// The differences.
        residual: Residual,
        /// The same if the pixels had guides, and if they had none; nothing where samples bring no guides.
        guided: [Residual; 2],
    },
    /// From a tracer: a block of samples of a tile of a converged view.
    BlockSampled {
        /// The view.
        view: View,
        /// The block; none where the order came back.
        #[message(skip = "`hash` tells it", with = saved)]
        block: Option<Arc<TileSums>>,
        /// Hash of it.
        hash: u64,
    },
    /// From a tracer: the picture of all tiles is with the renderer.
    Settled {
        /// The view.
        view: View,
        /// What is said of its error, a share of the mean; none where the order came back.
        stated: Option<f32>,
    },
    /// From a tracer: part of an environment map is captured.
    EnvironmentCaptured {
        /// Whose map.
        object: u32,
        /// What was seen; nothing where the order came back.
        #[message(skip = "`hash` tells it")]
        seen: Arc<Vec<Seen>>,
        /// Hash of it.
        hash: u64,
        /// How long that took on one core, seconds, as measured.
        seconds: f32,
    },
    /// From a tracer: a map is with the renderer.
    EnvironmentFiltered {
        /// Whose map.
        object: u32,
        /// What is lost without it.
        contrast: MapContrast,
        /// How long that took on one core, seconds, as measured.
        seconds: f32,
    },
    /// From a tracer: what a view and the turns that may follow it show of each texture.
    TexturesSeen {
        /// By texture.
        #[message(skip = "`hash` tells it")]
        uses: Arc<Vec<TextureUse>>,
        /// Hash of it.
        hash: u64,
    },
    /// From a tracer: a level of a texture.
    LevelLoaded {
        /// Which texture.
        texture: u32,
        /// Which level.
        level: u32,
        /// Its texels; none where it cannot be had.
        #[message(with = saved)]
        texels: Option<LevelTexels>,
    },
    /// From the renderer: nobody holds what was dropped so far any more.
    TexturesReleased {
        /// How many drops that was, since the beginning.
        drops: u32,
    },
    /// From the renderer: the user changed something. Each holds all that can be changed.
    #[message(lane = latest(2))]
    Adjusted(Adjustment),
    /// From the runtime: an actor panicked, or a tracer was stopped.
    #[message(lane = control)]
    Incident(Incident),
    /// From the runtime: a job was given up.
    #[message(lane = control)]
    JobDead(DeadJob<TraceBrief>),
    /// From its own timer: the next portion of a decision.
    DecideOn,
    /// From its own timer: send what was not accepted.
    SendAgain,
    /// From a tracer: a run of particles was traced to the eye.
    RunTraced {
        /// The view.
        view: View,
        /// What it shows; none where the order came back.
        #[message(skip = "`hash` tells it", with = saved)]
        splats: Option<Arc<Splats>>,
        /// Hash of it.
        hash: u64,
    },
    /// From a station: how many jobs its guest can have beside those of the tracers.
    StationChanged {
        /// Which one, among tracers and stations.
        station: u32,
        /// Jobs.
        credits: u32,
    },
}

impl AllocatorMessage {
    /// A block of a tile was sampled, or came back.
    pub(crate) fn block_sampled(view: View, block: Option<TileSums>) -> Self {
        let hash = block.as_ref().map_or(0, TileSums::digest);
        Self::BlockSampled { view, block: block.map(Arc::new), hash }
    }

    /// A run of light was traced to the eye, or came back.
    pub(crate) fn run_traced(view: View, splats: Option<Splats>) -> Self {
        let hash = splats.as_ref().map_or(0, Splats::digest);
        Self::RunTraced { view, splats: splats.map(Arc::new), hash }
    }
}
