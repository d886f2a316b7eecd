//! Where the time goes: durations of the stages of a frame, handed from any actor to the report
//! without a lock. Measured, never read by an actor: they decide nothing.

use std::sync::Arc;
use std::time::{Duration, Instant};

use crossbeam_queue::SegQueue;

/// The stages of the first paper's §5 and of the report.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Stage {
    /// Ageing of cached samples.
    Age,
    /// Drawing the base layer.
    Display,
    /// Warping and splatting of old and new samples.
    WarpSplat,
    /// From the end of drawing to the deadline: collecting new samples.
    Correct,
    /// The attention model.
    Attention,
    /// Ordering and handing out jobs.
    Allocate,
    /// Tone mapping the sum of both layers.
    Compose,
}

impl Stage {
    /// All stages.
    pub const ALL: [Self; 7] = [
        Self::Age,
        Self::Display,
        Self::WarpSplat,
        Self::Correct,
        Self::Attention,
        Self::Allocate,
        Self::Compose,
    ];

    /// Key in JSON documents.
    pub fn key(self) -> &'static str {
        match self {
            Self::Age => "age",
            Self::Display => "display",
            Self::WarpSplat => "warp_splat",
            Self::Correct => "correct",
            Self::Attention => "attention",
            Self::Allocate => "allocate",
            Self::Compose => "compose",
        }
    }
}

/// Collects durations from all actors.
#[derive(Clone, Debug, Default)]
pub struct StageTimes(Arc<SegQueue<(Stage, Duration)>>);

impl StageTimes {
    /// Times `work`.
    pub fn time<R>(&self, stage: Stage, work: impl FnOnce() -> R) -> R {
        let start = Instant::now();
        let result = work();
        self.add(stage, start.elapsed());
        result
    }

    /// Adds a duration measured elsewhere.
    pub fn add(&self, stage: Stage, duration: Duration) {
        self.0.push((stage, duration));
    }

    /// Everything added since the last call.
    pub fn drain(&self) -> Vec<(Stage, Duration)> {
        std::iter::from_fn(|| self.0.pop()).collect()
    }
}
