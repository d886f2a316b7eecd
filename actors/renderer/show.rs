//! A frame is due: what is there is put together, shown and marked.

use std::sync::Arc;

use foveal::image::Map2d;
use foveal_runtime::Cx;
use rayon::prelude::*;

use super::{MARK_FRAME, Renderer, Unseen};
use crate::message::{AnalyzerMessage, DrawnView, FrameIndex, FrameSnapshot, RendererMessage};
use crate::stages::Stage;

/// First approximations that a frame has time for pixel by pixel: 5 ms of two cores. Of more, neighbours share one: four of them,
/// or sixteen where even a fourth of them would take as long as drawing, as in the first frame. Numbers of pixels and no times,
/// so that the same samples give the same picture wherever it is shown.
const SINGLY: usize = 1 << 15;
const BY_FOURS: usize = 1 << 17;

impl Renderer {
    /// Shows the frame; while nothing changes the last picture stands, and nobody has work.
    pub(super) fn on_deadline_reached(&mut self, index: FrameIndex, cx: &mut Cx<'_, RendererMessage>) {
        if let Some(since) = self.drawn_at.take() {
            self.stages.end(Stage::Correct, since);
        }
        let Some(drawn) = self.drawn.clone() else { return };
        let (rgb8, hash) = match (&self.shown, self.changed) {
            (Some(shown), false) => (None, shown.hash),
            _ => {
                let put_together = || {
                    self.approximate_the_rest(&drawn);
                    self.stages.clone().time(Stage::Compose, || self.compose(&drawn))
                };
                let (picture, took) = cx.measure(put_together);
                self.following.learn(took + self.warping);
                let hash = xxhash_rust::xxh3::xxh3_64(picture.data().as_flattened());
                (Some(picture), hash)
            }
        };
        let snapshot = match (rgb8, &self.shown) {
            (None, Some(shown)) => {
                Arc::new(FrameSnapshot { index, drawn: drawn.clone(), rgb8: shown.rgb8.clone(), hash })
            }
            (Some(rgb8), _) => {
                let snapshot =
                    Arc::new(FrameSnapshot { index, drawn: drawn.clone(), rgb8: Arc::new(rgb8), hash });
                if let Some(neighbours) = &self.neighbours {
                    // Newest only: where it comes back, the next frame serves as well.
                    let shown = AnalyzerMessage::FrameShown { snapshot: snapshot.clone() };
                    let _ = cx.tell(&neighbours.analyzer, shown);
                }
                snapshot
            }
            (None, None) => return,
        };
        cx.mark(MARK_FRAME, hash);
        self.changed = false;
        self.shown = Some(snapshot.clone());
        // From here on they are the next frame's, whose beginning may lie behind samples in the mailbox.
        let counts = std::mem::take(&mut self.counts);
        if !cx.replays() {
            // The sink is lent to itself: it may look at the layers.
            let mut sink = std::mem::replace(&mut self.sink, Box::new(Unseen));
            sink.frame_shown(&snapshot, counts, self);
            self.sink = sink;
        }
    }

    /// Fills in what no sample has reached by the time the frame is shown. Coarse samples come first and cover much, so
    /// few pixels are left; a pixel is looked up once in a view.
    fn approximate_the_rest(&mut self, drawn: &DrawnView) {
        let (Some(first), false) = (&self.approximation, self.converged) else { return };
        let (layer, world, buffers) = (&mut self.layer, &self.world, drawn.buffers());
        let own = |x, y| first.pixel(world, &drawn.frame, buffers, x, y);
        self.counts.approximated += self.stages.time(Stage::Compose, || {
            let is_dear = |x: usize, y: usize| buffers.object.at(x, y) != 0 && layer.is_bare(x, y);
            let rows = (0..buffers.height()).into_par_iter();
            let dear: usize = rows.map(|y| (0..buffers.width()).filter(|&x| is_dear(x, y)).count()).sum();
            let count = if dear <= SINGLY {
                layer.approximate(own)
            } else {
                let side = if dear <= BY_FOURS { 2 } else { 4 };
                let cells = first.cells(world, &drawn.frame, buffers, side, |x, y| layer.is_bare(x, y));
                layer.approximate(|x, y| cells.pixel(buffers, x, y).unwrap_or_else(|| own(x, y)))
            };
            count as u32
        });
    }

    fn compose(&self, drawn: &DrawnView) -> Map2d<[u8; 3]> {
        let buffers = drawn.buffers();
        let (width, height) = (buffers.width(), buffers.height());
        let mut rgb8 = Map2d::new(width, height, [0u8; 3]);
        let (encoder, tone) = (&self.encoder, &self.tone);
        let settled = self.settled.as_ref();
        self.between(drawn).fill(&mut rgb8, |x, y, splats| {
            let base = buffers.color.at(x, y);
            let first = base + splats;
            let light = settled.map_or(first, |settled| settled.pixel(x, y, base, first));
            encoder.rgb8(tone, light)
        });
        rgb8
    }
}
