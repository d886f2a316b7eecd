//! What is kept of a walk's deliveries to say why a pixel looks as it does.

use std::collections::BTreeMap;
use std::sync::Arc;

use crossbeam_queue::SegQueue;
use foveal::splatting::{SampleBatch, WarpedSample};
use foveal_actors::message::{
    AllocatorMessage, AnalyzerMessage, CacheAgerMessage, RendererInput, RendererMessage, SampleOrder,
    TraceJob,
};
use foveal_runtime::Delivery;

use super::why::{At, SampleOrigin, ShownPixel};

/// What is kept of the deliveries on the way to the frame.
pub(super) enum Note {
    Began {
        frame: u32,
    },
    Shown {
        frame: u32,
    },
    Drawn {
        view: u32,
    },
    Aged {
        view: u32,
        samples: Arc<Vec<WarpedSample>>,
    },
    /// At the renderer.
    Traced {
        batch: Arc<SampleBatch>,
    },
    /// At the cache ager.
    Kept {
        batch: Arc<SampleBatch>,
    },
    Looked {
        frame: u32,
    },
    Ranked {
        saliency: Arc<Vec<f32>>,
    },
    Job {
        job: SampleOrder,
    },
    /// At the allocator: what made it hand out jobs.
    Woke {
        kind: &'static str,
    },
    /// At the renderer: better light came.
    Lit {
        rounds: u32,
    },
}

pub(super) struct Noted {
    pub at: At,
    pub cause: Option<At>,
    pub note: Note,
}

/// Notes by delivery.
#[derive(Default)]
pub(super) struct Notes {
    pub all: BTreeMap<At, (Option<At>, Note)>,
    /// Newest view seen.
    view: u32,
}

impl Notes {
    /// Takes over what came; samples and jobs of views so old that none of them can be shown any more go.
    pub fn take(&mut self, queue: &SegQueue<Noted>, max_age: u32) {
        let before = self.view;
        while let Some(Noted { at, cause, note }) = queue.pop() {
            if let Note::Drawn { view } = note {
                self.view = self.view.max(view);
            }
            self.all.insert(at, (cause, note));
        }
        if self.view != before {
            let oldest = self.view.saturating_sub(max_age + 1);
            self.all.retain(|_, (_, note)| match note {
                Note::Aged { view, .. } => *view == self.view,
                Note::Traced { batch } | Note::Kept { batch } => batch.view >= oldest,
                Note::Job { job } => job.drawn.view.0 >= oldest,
                _ => true,
            });
        }
    }

    /// Whether they reach back to all that is told of a pixel.
    pub fn tell_all(
        &self,
        shown: &ShownPixel,
        found: Option<&SampleOrigin>,
        is_diffuse: bool,
        moved: Option<(At, u32)>,
    ) -> bool {
        // A view may be overtaken on its way to the allocator; that an older one came says as much.
        let reach_back_to =
            |of: u32| self.all.values().any(|(_, note)| matches!(note, Note::Drawn { view } if *view <= of));
        // All that is told of a diffuse surface is in the view itself.
        if is_diffuse {
            return true;
        }
        let view = shown.drawn.view.0;
        if !reach_back_to(view) && !moved.is_some_and(|(at, _)| self.all.contains_key(&at)) {
            return false;
        }
        let Some(found) = found else { return true };
        let Some((delivered, _)) = found.batch else { return false };
        let job = self.cause(delivered);
        let is_ranked = || {
            let pushed = job.and_then(|job| self.cause(job));
            pushed.is_some_and(|(allocator, index)| {
                let mut before = self.all.range((allocator, 0)..=(allocator, index));
                before.any(|(_, (_, note))| matches!(note, Note::Ranked { .. }))
            })
        };
        reach_back_to(view.saturating_sub(found.age)) && is_ranked()
    }

    pub fn cause(&self, at: At) -> Option<At> {
        self.all.get(&at).and_then(|(cause, _)| *cause)
    }

    pub fn note(&self, at: At) -> Option<&Note> {
        self.all.get(&at).map(|(_, note)| note)
    }
}

pub(super) fn note(d: &Delivery<'_>) -> Option<Note> {
    let content = d.content;
    if let Some(job) = content.downcast_ref::<TraceJob>() {
        let TraceJob::Samples(job) = job else { return None };
        return Some(Note::Job { job: job.clone() });
    }
    if let Some(message) = content.downcast_ref::<RendererMessage>() {
        return Some(match message {
            RendererMessage::Input(RendererInput::FrameBegan { frame, .. }) => Note::Began { frame: frame.0 },
            RendererMessage::Input(RendererInput::DeadlineReached { frame }) => {
                Note::Shown { frame: frame.0 }
            }
            RendererMessage::SamplesAged { view, samples, .. } => {
                Note::Aged { view: view.0, samples: samples.clone() }
            }
            RendererMessage::SamplesTraced { batch, .. } => Note::Traced { batch: batch.clone() },
            RendererMessage::Illuminated { map, .. } => {
                Note::Lit { rounds: map.map().map_or(0, |map| map.summary.rounds) }
            }
            _ => return None,
        });
    }
    if let Some(message) = content.downcast_ref::<AllocatorMessage>() {
        return Some(match message {
            AllocatorMessage::ViewDrawn { drawn } => Note::Drawn { view: drawn.view.0 },
            AllocatorMessage::ObjectsRanked { saliency, .. } => Note::Ranked { saliency: saliency.clone() },
            _ => Note::Woke { kind: d.kind },
        });
    }
    match content.downcast_ref::<AnalyzerMessage>() {
        Some(AnalyzerMessage::FrameShown { snapshot }) => Some(Note::Looked { frame: snapshot.index.0 }),
        None => match content.downcast_ref::<CacheAgerMessage>()? {
            CacheAgerMessage::SamplesTraced { batch, .. } => Some(Note::Kept { batch: batch.clone() }),
            _ => None,
        },
    }
}
