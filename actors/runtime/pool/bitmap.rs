//! Which priority buckets of a pool have jobs, in one word.

use crate::sync::{AtomicU64, Ordering};

/// Which buckets have jobs.
#[derive(Debug)]
pub(crate) struct Bitmap {
    bits: AtomicU64,
}

impl Bitmap {
    pub(crate) fn new() -> Self {
        Self { bits: AtomicU64::new(0) }
    }

    /// A job is in place in this bucket.
    pub(crate) fn raise(&self, bucket: u32) {
        self.bits.fetch_or(1 << bucket, Ordering::SeqCst);
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.bits.load(Ordering::SeqCst) == 0
    }

    /// Which buckets may have something, from `base` on (cyclically), which is the lowest bit.
    pub(crate) fn from(&self, base: u32) -> u64 {
        self.bits.load(Ordering::SeqCst).rotate_right(base)
    }

    /// Takes from the first bucket at or after `base` (cyclically) that has something. A bucket found empty loses its
    /// bit and is looked at once more: a job that came in between had its bit cleared with the old one.
    pub(crate) fn take<T>(
        &self,
        base: u32,
        pop: impl Fn(u32) -> Option<T>,
        is_empty: impl Fn(u32) -> bool,
    ) -> Option<T> {
        loop {
            let bits = self.bits.load(Ordering::SeqCst);
            if bits == 0 {
                return None;
            }
            let bucket = (bits.rotate_right(base).trailing_zeros() + base) % 64;
            if let Some(taken) = pop(bucket) {
                return Some(taken);
            }
            self.bits.fetch_and(!(1 << bucket), Ordering::SeqCst);
            if !is_empty(bucket) {
                self.raise(bucket);
            }
        }
    }
}
