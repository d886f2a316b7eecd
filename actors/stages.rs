//! Where the time goes: durations of the stages of a frame, handed from any actor to the report
//! without a lock. Measured, never read by an actor: they decide nothing.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

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

/// When something began.
#[derive(Clone, Copy, Debug)]
pub struct Begun(Instant);

/// Sums of durations by stage, of all actors: they take no room however long nobody looks.
#[derive(Clone, Debug, Default)]
pub struct StageTimes(Arc<[Sum; Stage::ALL.len()]>);

/// Durations of one stage since somebody looked.
#[derive(Debug, Default)]
struct Sum {
    nanoseconds: AtomicU64,
    /// So many of them.
    count: AtomicU64,
}

impl StageTimes {
    /// Times `work`.
    pub fn time<R>(&self, stage: Stage, work: impl FnOnce() -> R) -> R {
        let start = Instant::now();
        let result = work();
        self.add(stage, start.elapsed());
        result
    }

    /// Begins to time what goes on beyond one turn. Whoever holds it cannot read it.
    pub fn begin(&self) -> Begun {
        Begun(Instant::now())
    }

    /// Adds the time since it was begun.
    pub fn end(&self, stage: Stage, begun: Begun) {
        self.add(stage, begun.0.elapsed());
    }

    /// Adds a duration measured elsewhere.
    pub fn add(&self, stage: Stage, duration: Duration) {
        let sum = &self.0[stage as usize];
        sum.nanoseconds.fetch_add(duration.as_nanos() as u64, Ordering::Relaxed);
        sum.count.fetch_add(1, Ordering::Relaxed);
    }

    /// The sum of each stage that had any since the last call.
    pub fn take(&self) -> Vec<(Stage, Duration)> {
        let taken = |stage: Stage| {
            let sum = &self.0[stage as usize];
            let any = sum.count.swap(0, Ordering::Relaxed) > 0;
            any.then(|| (stage, Duration::from_nanos(sum.nanoseconds.swap(0, Ordering::Relaxed))))
        };
        Stage::ALL.into_iter().filter_map(taken).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_are_taken_once() {
        let times = StageTimes::default();
        (0..1000).for_each(|_| times.add(Stage::WarpSplat, Duration::from_micros(3)));
        times.add(Stage::Age, Duration::ZERO);
        let expected = [(Stage::Age, Duration::ZERO), (Stage::WarpSplat, Duration::from_millis(3))];
        assert_eq!(times.take(), expected);
        assert_eq!(times.take(), []);
    }
}
