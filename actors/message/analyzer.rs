//! The analyzer's inbox.

use std::sync::Arc;

use foveal_runtime::Message;

use super::{FrameSnapshot, saved};

/// Everything the analyzer can be told.
#[derive(Clone, Debug, Message)]
pub enum AnalyzerMessage {
    /// From the renderer after each shown frame; only the newest is kept.
    #[message(lane = latest(0))]
    FrameShown {
        /// The frame.
        #[message(with = saved)]
        snapshot: Arc<FrameSnapshot>,
    },
}
