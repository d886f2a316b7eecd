//! The analyzer's inbox.

use std::sync::Arc;

use foveal_runtime::{Digest, Lane, Loader, Message, Saver};

use super::FrameSnapshot;
use super::saved::{load_frame, save_frame};

/// Everything the analyzer can be told.
#[derive(Clone, Debug)]
pub enum AnalyzerMessage {
    /// From the renderer after each shown frame; only the newest is kept.
    FrameShown {
        /// The frame.
        snapshot: Arc<FrameSnapshot>,
    },
}

impl Message for AnalyzerMessage {
    fn digest(&self, digest: &mut Digest) {
        match self {
            Self::FrameShown { snapshot } => {
                digest.u32(snapshot.index.0);
                digest.u64(snapshot.hash);
            }
        }
    }

    fn kind(&self) -> &'static str {
        "FrameShown"
    }

    fn lane(&self) -> Lane {
        Lane::Latest(0)
    }

    fn save(&self, saver: &mut Saver) {
        let Self::FrameShown { snapshot } = self;
        save_frame(saver, snapshot);
    }

    fn restore(loader: &mut Loader<'_>) -> Option<Self> {
        Some(Self::FrameShown { snapshot: load_frame(loader)? })
    }
}
