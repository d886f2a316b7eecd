//! What tracers get: jobs from the pool.

use std::sync::Arc;

use foveal::allocation::jobs::SampleJob;

use super::DrawnView;

/// An order for a tracer, complete in itself.
#[derive(Clone, Debug)]
pub struct TraceJob {
    /// The view to trace for.
    pub drawn: Arc<DrawnView>,
    /// Which samples.
    pub order: SampleJob,
    /// Seed of the random numbers.
    pub seed: u64,
}
