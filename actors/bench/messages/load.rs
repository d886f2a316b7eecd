//! What is sent in the measurements, and what a measurement costs.

use std::sync::Arc;
use std::time::Instant;

use crossbeam_queue::ArrayQueue;
use foveal_engine::process::cpu_ns;

/// Messages on their way at once.
pub const IN_FLIGHT: usize = 1024;
/// Workers between source and collector.
pub const WORKERS: usize = 4;

/// Something to send.
pub trait Payload: Send + Sync + 'static {
    /// Boxes that are used again.
    type Pool: Clone + Send + Sync + 'static;
    /// An empty pool.
    fn pool() -> Self::Pool;
    /// Payload number `number`.
    fn make(pool: &Self::Pool, number: u64) -> Self;
    /// What a worker reads of it.
    fn sum(&self) -> u64;
    /// It is done with.
    fn give_back(self, pool: &Self::Pool);
}

/// 64 bytes, inline.
pub struct Small(pub [u64; 8]);

impl Payload for Small {
    type Pool = ();

    fn pool() -> Self::Pool {}

    fn make((): &(), number: u64) -> Self {
        Self([number; 8])
    }

    fn sum(&self) -> u64 {
        self.0.iter().fold(0, |sum, word| sum.wrapping_add(*word))
    }

    fn give_back(self, (): &()) {}
}

/// 4 KiB in a box.
pub struct Large(pub Box<[u64; 512]>);

impl Payload for Large {
    type Pool = Arc<ArrayQueue<Box<[u64; 512]>>>;

    fn pool() -> Self::Pool {
        Arc::new(ArrayQueue::new(2 * IN_FLIGHT))
    }

    fn make(pool: &Self::Pool, number: u64) -> Self {
        let mut words = pool.pop().unwrap_or_else(|| Box::new([0; 512]));
        words.fill(number);
        Self(words)
    }

    fn sum(&self) -> u64 {
        self.0.iter().fold(0, |sum, word| sum.wrapping_add(*word))
    }

    fn give_back(self, pool: &Self::Pool) {
        let _ = pool.push(self.0);
    }
}

/// What a run took.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cost {
    /// Seconds on the wall.
    pub seconds: f64,
    /// Processor time of the whole process, in nanoseconds.
    pub cpu_ns: f64,
}

/// Measures `work`.
pub fn cost(work: impl FnOnce()) -> Cost {
    let (start, cpu) = (Instant::now(), cpu_ns());
    work();
    Cost { seconds: start.elapsed().as_secs_f64(), cpu_ns: cpu_ns() - cpu }
}
