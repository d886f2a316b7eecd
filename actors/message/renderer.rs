//! The renderer's inbox.

use std::sync::Arc;

use foveal::display::environment_map::EnvironmentMap;
use foveal::scene::Camera;
use foveal::scene::texture::LevelTexels;
use foveal::splatting::settled::Settled;
use foveal::splatting::tile_sums::TileSums;
use foveal::splatting::{Guides, SampleBatch, WarpedSample};
use foveal_runtime::Message;

use super::{FrameIndex, PublishedLight, View, saved};
use crate::settings::Adjustment;

/// What reaches the renderer from outside: the clock and the user. Recorded with its payload.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub enum RendererInput {
    /// A frame begins. The camera is where the path or the user has it at this time.
    FrameBegan {
        /// Its number.
        frame: FrameIndex,
        /// Camera of this moment.
        camera: Camera,
        /// How long the frame is meant to take, seconds: what takes long for that is drawn sparsely while the camera moves.
        time: f32,
    },
    /// The frame's time is up: show what there is.
    DeadlineReached {
        /// Its number.
        frame: FrameIndex,
    },
    /// The user changed something.
    Adjusted(Adjustment),
    /// Nobody looks any more: what is still to be traced for the view is not needed.
    Left,
}

/// Everything the renderer can be told.
#[derive(Clone, Debug, Message)]
pub enum RendererMessage {
    /// From outside.
    #[message(kind = _0.kind())]
    Input(RendererInput),
    /// From the cache ager: the cached samples that still hold, in the picture of `view`.
    #[message(size = samples.len() * size_of::<WarpedSample>())]
    SamplesAged {
        /// The view they were warped for.
        view: View,
        /// Coarse before fine.
        #[message(skip = "`hash` tells it")]
        samples: Arc<Vec<WarpedSample>>,
        /// How many samples expired for this view.
        expired: u32,
        /// Hash of the samples.
        hash: u64,
    },
    /// From a tracer.
    #[message(size = batch.size_bytes())]
    SamplesTraced {
        /// The samples.
        #[message(skip = "`hash` tells it", with = saved)]
        batch: Arc<SampleBatch>,
        /// Which tracer, counted from 0.
        tracer: u32,
        /// Their hash.
        hash: u64,
    },
    /// From a tracer: what guides show.
    #[message(size = guides.size_bytes())]
    GuidesTraced {
        /// By pixel.
        #[message(skip = "`hash` tells it", with = saved)]
        guides: Arc<Guides>,
        /// Their hash.
        hash: u64,
    },
    /// From a tracer: an object's environment map is ready; or from the allocator: it is given up.
    #[message(size = map.as_ref().map_or(0, |map| map.bytes()))]
    EnvironmentChanged {
        /// Whose map.
        object: u32,
        /// The map; none where it is given up.
        #[message(skip = "`hash` tells it", with = saved)]
        map: Option<Arc<EnvironmentMap>>,
        /// Its hash.
        hash: u64,
    },
    /// From the allocator: another level of a texture is to be shown, from the next frame on.
    #[message(size = texels.as_ref().map_or(0, |t| t.as_bytes().len()))]
    TextureChanged {
        /// Which texture.
        texture: u32,
        /// The finest level from now on.
        finest: u32,
        /// Its texels where it is one level finer than before; none where finer levels are dropped.
        #[message(with = saved)]
        texels: Option<LevelTexels>,
    },
    /// From the allocator: every sample of the view has been traced, and all of them are in the
    /// mailbox before this message.
    ViewConverged {
        /// Which view.
        view: View,
    },
    /// From the allocator: more samples of a tile of a converged view.
    #[message(size = sums.size_bytes())]
    TileSampled {
        /// Which view.
        view: View,
        /// All that the tile has.
        #[message(skip = "`hash` tells it", with = saved)]
        sums: Arc<TileSums>,
        /// Hash of them.
        hash: u64,
    },
    /// From a tracer: what the samples of all tiles come to.
    #[message(size = settled.size_bytes())]
    RefinedShown {
        /// Which view.
        view: View,
        /// The picture.
        #[message(skip = "`hash` tells it", with = saved)]
        settled: Arc<Settled>,
        /// Its hash.
        hash: u64,
    },
    /// From the allocator: the view is as good as it gets, and all of its tiles are in the mailbox before this message.
    ViewRefined {
        /// Which view.
        view: View,
    },
    /// From the illuminator: better light.
    #[message(size = map.bytes())]
    Illuminated {
        /// The light.
        #[message(skip = "`hash` tells it", with = saved)]
        map: Arc<PublishedLight>,
        /// Whether it is the last.
        last: bool,
        /// Hash of the values.
        hash: u64,
    },
    /// From the allocator: the cache ager panicked and began anew. It has no samples, and does not know what the user
    /// changed before.
    SamplesForgotten,
    /// From its own timer: send what was not accepted.
    SendAgain,
    /// From the cache ager: no sample is to be believed. The view begins anew.
    SamplesDoubted,
}

impl RendererInput {
    /// The variant's name, for reports.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::FrameBegan { .. } => "FrameBegan",
            Self::DeadlineReached { .. } => "DeadlineReached",
            Self::Adjusted(_) => "Adjusted",
            Self::Left => "Left",
        }
    }
}

impl From<RendererInput> for RendererMessage {
    fn from(input: RendererInput) -> Self {
        Self::Input(input)
    }
}
