//! Jobs by priority, each with what goes with it.

use std::ops::Deref;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use crossbeam_queue::SegQueue;

use super::BUCKETS;
use super::bitmap::Bitmap;

/// A job that waits.
pub(super) struct Entry<J> {
    pub(super) id: u64,
    pub(super) attempt: u32,
    pub(super) epoch: u64,
    pub(super) bucket: u32,
    /// Deliveries to its maker before it was pushed, the one at hand included.
    pub(super) pushed_in: u64,
    pub(super) job: Carried<J>,
    /// Whether one of the two who have it has come to its end, where it was [shared](Cx::share).
    pub(super) rival: Option<Arc<AtomicBool>>,
}

impl<J> Entry<J> {
    /// The same job for two: whoever has it, and those who get it if that one does not come to its end.
    pub(super) fn split(self) -> (Self, Self) {
        let job = match self.job {
            Carried::Alone(job) => Arc::new(job),
            Carried::Shared(job) => job,
        };
        let rival = self.rival.clone();
        (
            Self { job: Carried::Shared(Arc::clone(&job)), rival, ..self },
            Self { job: Carried::Shared(job), ..self },
        )
    }
}

/// A job on its way. It lies in its entry as long as nobody else needs it: memory that one thread takes and another
/// gives back costs more than the way through the pool.
pub(super) enum Carried<J> {
    Alone(J),
    Shared(Arc<J>),
}

impl<J> Deref for Carried<J> {
    type Target = J;

    fn deref(&self) -> &J {
        match self {
            Self::Alone(job) => job,
            Self::Shared(job) => job,
        }
    }
}

/// Jobs by priority.
pub(super) struct Heap<J> {
    buckets: Box<[SegQueue<Entry<J>>]>,
    bitmap: Bitmap,
}

impl<J> Heap<J> {
    pub(super) fn new() -> Self {
        Self { buckets: (0..BUCKETS).map(|_| SegQueue::new()).collect(), bitmap: Bitmap::new() }
    }

    /// Whether nothing waits, as far as bits say.
    pub(super) fn is_empty(&self) -> bool {
        self.bitmap.is_empty()
    }

    /// Whether nothing waits in this bucket.
    pub(super) fn has_none_in(&self, bucket: u32) -> bool {
        self.buckets[bucket as usize].is_empty()
    }

    pub(super) fn put(&self, entry: Entry<J>) {
        let bucket = entry.bucket;
        self.buckets[bucket as usize].push(entry);
        self.bitmap.raise(bucket);
    }

    pub(super) fn take(&self, base: u32) -> Option<Entry<J>> {
        self.bitmap.take(
            base,
            |bucket| self.buckets[bucket as usize].pop(),
            |bucket| self.buckets[bucket as usize].is_empty(),
        )
    }

    /// How far behind `base` (cyclically) the first bucket is that has something; 64 where none has.
    pub(super) fn rank(&self, base: u32) -> u32 {
        let mut bits = self.bitmap.from(base);
        while bits != 0 {
            let rank = bits.trailing_zeros();
            // A bucket keeps its bit until somebody finds it empty.
            if !self.buckets[((base + rank) % 64) as usize].is_empty() {
                return rank;
            }
            bits &= bits - 1;
        }
        64
    }

    /// Whether something waits in one of the first `rank` buckets.
    pub(super) fn has_better(&self, base: u32, rank: u32) -> bool {
        (0..rank).any(|step| !self.buckets[((base + step) % 64) as usize].is_empty())
    }
}
