//! A tracer's inbox, and the jobs it gets from the pool.

use std::sync::Arc;

use foveal::allocation::jobs::SampleJob;
use foveal_runtime::{Digest, Job, Message};

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

/// What a tracer can be told. Its work comes from the pool.
#[derive(Clone, Copy, Debug)]
pub enum TracerMessage {
    /// From its own timer, or from the allocator after a panic that may have lost it: send what waits.
    SendAgain,
}

impl Message for TracerMessage {
    fn digest(&self, digest: &mut Digest) {
        match self {
            Self::SendAgain => digest.u32(0),
        }
    }

    fn kind(&self) -> &'static str {
        match self {
            Self::SendAgain => "SendAgain",
        }
    }
}

impl Job for TraceJob {
    fn digest(&self, digest: &mut Digest) {
        digest.u32(self.drawn.view.0);
        digest.u64(self.drawn.hash);
        let o = &self.order;
        for word in [o.object, o.level, o.count, o.start.x as u32, o.start.y as u32] {
            digest.u32(word);
        }
    }

    fn describe(&self) -> String {
        let (o, r) = (&self.order, &self.order.rect);
        format!(
            "{} samples of object {}, level {}, view {}, pixels [{}, {}) × [{}, {}) from ({}, {}), seed {}",
            o.count,
            o.object,
            o.level,
            self.drawn.view.0,
            r.x0,
            r.x1,
            r.y0,
            r.y1,
            o.start.x,
            o.start.y,
            self.seed
        )
    }

    fn kind(&self) -> &'static str {
        "TraceJob"
    }
}
