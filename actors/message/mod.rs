//! What the actors tell each other. One closed enum per inbox; bulk data travels in `Arc`.

pub mod allocator;
pub mod analyzer;
pub mod cache_ager;
pub mod illuminator;
pub mod renderer;
pub mod saved;
pub mod tracer;

use std::sync::Arc;

use foveal::display::FrameBuffers;
use foveal::image::Map2d;
use foveal::scene::camera::CameraFrame;
use foveal::world::World;

pub use allocator::AllocatorMessage;
pub use analyzer::AnalyzerMessage;
pub use cache_ager::CacheAgerMessage;
pub use illuminator::IlluminatorMessage;
pub use renderer::{RendererInput, RendererMessage};
pub use tracer::{
    EnvironmentOrder, LevelOrder, PredictionOrder, SampleOrder, TileWork, TraceJob, TracerMessage,
};

/// The age of the camera: how often the view (pose, size or illumination) has changed.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default, serde::Serialize, serde::Deserialize,
)]
pub struct View(pub u32);

impl View {
    /// The view after this one.
    pub fn next(self) -> Self {
        Self(self.0.wrapping_add(1))
    }
}

/// A frame's number, counted from 0.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default, serde::Serialize, serde::Deserialize,
)]
pub struct FrameIndex(pub u32);

/// One view as drawn: what tracers trace for and the analyzer looks at.
#[derive(Debug)]
pub struct DrawnView {
    /// Which view.
    pub view: View,
    /// Its camera.
    pub frame: CameraFrame,
    /// Its buffers.
    pub buffers: FrameBuffers,
    /// Scene and illumination it shows, which its samples must be traced in.
    pub world: World,
    /// Number of object ids, id 0 included.
    pub object_count: usize,
    /// Hash of the camera and the ids, made once.
    pub hash: u64,
}

/// A frame as it was shown.
#[derive(Debug)]
pub struct FrameSnapshot {
    /// Which frame.
    pub index: FrameIndex,
    /// The view behind it.
    pub drawn: Arc<DrawnView>,
    /// The picture: sRGB bytes, three per pixel.
    pub rgb8: Arc<Map2d<[u8; 3]>>,
    /// Hash of the picture.
    pub hash: u64,
}
