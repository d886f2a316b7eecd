//! What a walk can be told to do differently.

use foveal::allocation::policy::{Policy, RayPolicy};
use foveal::perception::importance::Weights;
use foveal::sampling::Lattice;
use foveal::splatting::supersampling::Supersampling;
use foveal::splatting::{AgeingRules, Footprint};

/// Settings that all actors of a session share; part of a recording's header.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Settings {
    /// Picture width, pixels.
    pub width: u32,
    /// Picture height, pixels.
    pub height: u32,
    /// Number of tracers.
    pub tracers: u32,
    /// Order of rays.
    pub policy: RayPolicy,
    /// Weight of saliency against importance, 0 (task only) to 1 (saliency only).
    pub saliency_weight: f32,
    /// Seed of every random number.
    pub seed: u64,
    /// Samples per job, the paper's n_job.
    pub samples_per_job: u32,
    /// K of the √5 lattice: K + 1 levels.
    pub k_max: u32,
    /// What fresh samples paint.
    pub footprint: Footprint,
    /// Ageing.
    pub ageing: AgeingRules,
    /// Most samples kept.
    pub cache_capacity: usize,
    /// Most bytes of environment maps; with 0 only the coarsest of each object is drawn.
    pub environment_bytes: u64,
    /// How far a converged view is refined; `None` leaves it as it converged.
    pub supersampling: Option<Supersampling>,
    /// Winner takes all: the most attended object converges before the next.
    pub winner_takes_all: bool,
}

impl Settings {
    /// Defaults for a picture of this size.
    pub fn new(width: u32, height: u32, tracers: u32) -> Self {
        Self {
            width,
            height,
            tracers,
            policy: RayPolicy::new(Policy::default(), 0),
            saliency_weight: 0.5,
            seed: 0,
            samples_per_job: 256,
            k_max: 6,
            footprint: Footprint::Tile,
            ageing: AgeingRules::default(),
            cache_capacity: (1 << 18).max(width as usize * height as usize),
            environment_bytes: 64 << 20,
            supersampling: None,
            winner_takes_all: false,
        }
    }

    /// The √5 lattice, anchored in the middle of the picture, where people look first.
    pub fn lattice(&self) -> Lattice {
        Lattice::new(self.k_max, [self.width as i32 / 2, self.height as i32 / 2])
    }

    /// Jobs of samples in the pool or with a tracer: enough that no tracer waits between two turns of the allocator, few
    /// enough that a new view or priority takes effect within milliseconds.
    pub fn jobs_in_flight(&self) -> u32 {
        2 * self.tracers + 2
    }

    /// The weights of the attention model.
    pub fn weights(&self) -> Weights {
        Weights { saliency: self.saliency_weight, ..Weights::default() }
    }
}
