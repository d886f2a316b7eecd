//! The cache ager's inbox.

use std::sync::Arc;

use foveal::scene::camera::CameraFrame;
use foveal::splatting::SampleBatch;
use foveal_runtime::Message;

use super::{View, saved};
use crate::settings::Adjustment;

/// Everything the cache ager can be told.
#[derive(Clone, Debug, Message)]
pub enum CacheAgerMessage {
    /// From the renderer, as a view begins: age and warp for it. Of several that wait only the newest counts: nobody
    /// would show what was warped for the others.
    #[message(lane = latest(0))]
    CameraMoved {
        /// The new view.
        view: View,
        /// Its camera.
        frame: CameraFrame,
    },
    /// From a tracer.
    #[message(size = batch.size_bytes())]
    SamplesTraced {
        /// The samples.
        #[message(skip = "`hash` tells it", with = saved)]
        batch: Arc<SampleBatch>,
        /// Their hash.
        hash: u64,
    },
    /// From the renderer: the user changed something. Each holds all that can be changed.
    #[message(lane = latest(1))]
    Adjusted(Adjustment),
    /// From its own timer: send what was not accepted.
    SendAgain,
    /// From a station: what its guest found is not true, so no sample is kept.
    Doubted,
}
