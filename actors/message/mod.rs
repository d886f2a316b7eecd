//! What the actors tell each other. One closed enum per inbox; bulk data travels in `Arc`.

pub mod allocator;
pub mod analyzer;
pub mod cache_ager;
pub mod illuminator;
pub mod later_light;
pub mod published;
pub mod renderer;
pub mod saved;
mod saved_world;
pub mod tracer;

use std::fmt;
use std::sync::{Arc, OnceLock};

use foveal::display::FrameBuffers;
use foveal::image::Map2d;
use foveal::scene::camera::CameraFrame;
use foveal::world::World;

pub use allocator::AllocatorMessage;
pub use analyzer::AnalyzerMessage;
pub use cache_ager::CacheAgerMessage;
pub use illuminator::IlluminatorMessage;
pub use published::PublishedLight;
pub use renderer::{RendererInput, RendererMessage};
pub use tracer::{
    EnvironmentOrder, LevelOrder, PredictionOrder, RunWork, SampleOrder, SettleWork, TileWork, TraceJob,
    TracerMessage,
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
    /// What was drawn.
    pub drawn: DrawnBuffers,
    /// Scene and illumination it shows, which its samples must be traced in.
    pub world: World,
    /// Number of object ids, id 0 included.
    pub object_count: usize,
    /// What [`Self::hash`] gave, or is said to give.
    pub hash: OnceLock<u64>,
}

impl DrawnView {
    /// [`saved::hash_view`] of it, made when it is first asked for: only recordings and replays ask.
    pub fn hash(&self) -> u64 {
        *self.hash.get_or_init(|| saved::hash_view(self.buffers(), self.view))
    }

    /// Its buffers. In a replay that began at a snapshot they are drawn when they are first asked for, on several threads, so
    /// ask outside of loops that run on these.
    pub fn buffers(&self) -> &FrameBuffers {
        self.drawn.get()
    }
}

/// The buffers of a view, drawn or to be drawn again.
pub struct DrawnBuffers {
    drawn: OnceLock<FrameBuffers>,
    cell: u32,
    draw: Option<Box<dyn Fn() -> FrameBuffers + Send + Sync>>,
}

impl DrawnBuffers {
    /// To be drawn when they are asked for, as densely as `cell` says ([`FrameBuffers::cell`]).
    pub fn later(cell: u32, draw: impl Fn() -> FrameBuffers + Send + Sync + 'static) -> Self {
        Self { drawn: OnceLock::new(), cell, draw: Some(Box::new(draw)) }
    }

    /// How densely they are drawn, as [`FrameBuffers::cell`] says.
    pub fn cell(&self) -> u32 {
        self.cell
    }

    fn get(&self) -> &FrameBuffers {
        let draw = || self.draw.as_ref().map_or_else(|| FrameBuffers::new(0, 0), |draw| draw());
        self.drawn.get_or_init(draw)
    }

    /// The buffers, if they were ever drawn.
    pub fn into_inner(self) -> Option<FrameBuffers> {
        self.drawn.into_inner()
    }
}

impl From<FrameBuffers> for DrawnBuffers {
    fn from(buffers: FrameBuffers) -> Self {
        Self { cell: buffers.cell, drawn: OnceLock::from(buffers), draw: None }
    }
}

impl fmt::Debug for DrawnBuffers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("DrawnBuffers").field("drawn", &self.drawn.get()).field("cell", &self.cell).finish()
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use foveal::allocation::rays::Residual;
    use foveal_runtime::{Digest, Message};

    fn hash(message: &impl Message) -> u64 {
        let mut digest = Digest::new();
        message.digest(&mut digest);
        digest.finish()
    }

    #[test]
    fn what_the_receiver_uses_is_hashed() {
        // As many differences with the same mean: the allocator learns from how they spread, too.
        let residual = |differences: [f32; 2]| {
            let mut residual = Residual::default();
            differences.into_iter().for_each(|difference| residual.add_difference(difference));
            residual
        };
        let measured = |residual, guided| AllocatorMessage::ResidualsMeasured {
            view: View(1),
            object: 2,
            level: 3,
            pixel: [4, 5],
            residual,
            guided,
        };
        let nothing = [Residual::default(); 2];
        let even = residual([2.0, 2.0]);
        assert_ne!(hash(&measured(residual([1.0, 3.0]), nothing)), hash(&measured(even, nothing)));
        assert_ne!(hash(&measured(even, nothing)), hash(&measured(even, [nothing[0], even])));
        // The picture's size is in a frame of a camera, and the tracers' views depend on it.
        let moved = |size| {
            let frame = CameraFrame {
                eye: glam::Vec3::ZERO,
                forward: glam::Vec3::Z,
                right: glam::Vec3::X,
                up: glam::Vec3::Y,
                size,
            };
            CacheAgerMessage::CameraMoved { view: View(1), frame }
        };
        assert_ne!(hash(&moved([640, 480])), hash(&moved([480, 640])));
        assert_ne!(hash(&IlluminatorMessage::Refine), hash(&IlluminatorMessage::SendAgain));
    }
}
