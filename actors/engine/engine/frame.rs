//! What a frame is, and what is told beside it.

use std::sync::Arc;
use std::time::Duration;

use foveal_actors::message::{FrameIndex, FrameSnapshot};
use foveal_actors::renderer::FrameCounts;
use foveal_actors::stages::Stage;
use foveal_actors::textures::TextureReport;

/// A frame as it was shown.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Its number.
    pub index: FrameIndex,
    /// The picture, tone-mapped, and the view that it is of.
    pub snapshot: Arc<FrameSnapshot>,
    /// How many samples it holds, by where they came from.
    pub counts: FrameCounts,
    /// Durations of its stages.
    pub stages: Vec<(Stage, Duration)>,
    /// How far its view has come.
    pub standing: Standing,
    /// Textures, where they are limited and something was decided of them.
    pub textures: Option<TextureReport>,
    /// What happened since the frame before.
    pub events: Vec<Event>,
}

/// How far a view has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// Samples are still to come.
    Growing,
    /// Every pixel that is not diffuse shows its own ray.
    Converged,
    /// Refined as far as was asked for.
    Refined,
}

impl Standing {
    /// As screenshots say it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Growing => "growing",
            Self::Converged => "converged",
            Self::Refined => "refined",
        }
    }
}

/// What happened beside the frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Event {
    /// The light is better than it was.
    LightGrew,
    /// The light is final.
    LightFinal,
    /// The view has converged.
    Converged,
    /// The view is refined as far as was asked for.
    Refined,
    /// The recording ends here, though the walk goes on.
    RecordingStopped {
        /// Why.
        reason: String,
    },
    /// Something went wrong and the walk goes on: an actor began anew, a job was given up, an observer failed.
    Incident {
        /// What happened to whom.
        what: String,
    },
}
