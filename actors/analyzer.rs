//! The analyzer: looks at the newest shown frame and says which objects matter to the eye.
//!
//! Owns the attention model's pyramids. Hears: a frame was shown. Says: to the allocator, each
//! object's saliency.

use std::sync::Arc;

use foveal::image::Map2d;
use foveal::perception::importance::{ObjectScan, ObjectStatistics};
use foveal::perception::saliency::SaliencyModel;
use foveal_runtime::{Actor, Address, Content, Cx, Loader, Saver};

use crate::message::{AllocatorMessage, AnalyzerMessage, FrameSnapshot};
use crate::stages::{Stage, StageTimes};

/// The analyzer's state.
pub struct Analyzer {
    model: SaliencyModel,
    scan: ObjectScan,
    statistics: Vec<ObjectStatistics>,
    allocator: Address<AllocatorMessage>,
    stages: StageTimes,
    /// Frames looked at.
    analyzed: u64,
}

impl Analyzer {
    /// An analyzer that has seen nothing.
    pub fn new(allocator: Address<AllocatorMessage>, stages: StageTimes) -> Self {
        Self {
            model: SaliencyModel::default(),
            scan: ObjectScan::default(),
            statistics: Vec::new(),
            allocator,
            stages,
            analyzed: 0,
        }
    }

    /// The saliency map of the last frame it looked at, one cell per 16 × 16 pixels.
    pub fn saliency(&self) -> &Map2d<f32> {
        &self.model.result().map
    }

    /// Frames looked at.
    pub fn analyzed(&self) -> u64 {
        self.analyzed
    }

    fn on_frame_shown(&mut self, snapshot: &FrameSnapshot, cx: &mut Cx<'_, AnalyzerMessage>) {
        let drawn = &snapshot.drawn;
        let (width, height) = (drawn.buffers().width(), drawn.buffers().height());
        self.stages.clone().time(Stage::Attention, || {
            let bytes = snapshot.rgb8.data().as_flattened();
            let map = &self.model.compute_rgb8(bytes, width, height).map;
            self.scan.gather(&drawn.buffers().object, Some(map), drawn.object_count, &mut self.statistics);
        });
        self.analyzed += 1;
        let saliency: Arc<Vec<f32>> = Arc::new(self.statistics.iter().map(|s| s.saliency).collect());
        let ranked = AllocatorMessage::ObjectsRanked { view: drawn.view, saliency };
        // Where the allocator is that far behind, the next frame's ranks serve as well.
        let _ = cx.tell(&self.allocator, ranked);
    }
}

impl Actor for Analyzer {
    type Msg = AnalyzerMessage;
    const NAME: &'static str = "analyzer";

    fn handle(&mut self, message: AnalyzerMessage, cx: &mut Cx<'_, AnalyzerMessage>) {
        match message {
            AnalyzerMessage::FrameShown { snapshot } => self.on_frame_shown(&snapshot, cx),
        }
    }

    fn content(&self) -> Content {
        Content::fields([("analyzed", Content::of(&self.analyzed))])
    }

    fn save(&self, saver: &mut Saver) {
        // The model and the scan keep room, nothing of the frame before.
        let Self { model: _, scan: _, statistics: _, allocator: _, stages: _, analyzed } = self;
        saver.put(analyzed);
    }

    fn restore(&mut self, loader: &mut Loader<'_>) -> Option<()> {
        self.analyzed = loader.take()?;
        Some(())
    }
}
