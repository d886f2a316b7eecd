//! What a walk can be told to do differently.

use foveal::allocation::policy::{Policy, RayPolicy};
use foveal::display::tone::ToneMap;
use foveal::perception::importance::SALIENCY_WEIGHT;
use foveal::sampling::Lattice;
use foveal::scene::Display;
use foveal::splatting::supersampling::Supersampling;
use foveal::splatting::{AgeingRules, Footprint};

use crate::station::CHECKED;

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
    /// Whether pixels that no sample has reached show a first approximation; else they show nothing but their base
    /// light, as both papers draw them.
    #[serde(default = "approximates")]
    pub approximates: bool,
    /// Places for other machines among the tracers.
    #[serde(default, skip_serializing_if = "has_none")]
    pub stations: u32,
    /// One of so many samples that come from there is traced here as well.
    #[serde(default = "checked", skip_serializing_if = "is_usual")]
    pub checked: u32,
}

fn checked() -> u32 {
    CHECKED
}

fn is_usual(checked: &u32) -> bool {
    *checked == CHECKED
}

fn has_none(stations: &u32) -> bool {
    *stations == 0
}

/// Recordings of before it could be chosen.
fn approximates() -> bool {
    true
}

/// What the user may change while walking. Each change reaches the actors as a recorded message.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Adjustment {
    /// Frames per second to aim at. Frames come when the clock says so; this one is for whoever reads the recording.
    pub fps: f32,
    /// Least [`quality`](crate::insight::Insight::quality) of a frame that is shown, which waits for it; `None` where frames
    /// keep their rate. As [`fps`](Self::fps), for whoever reads the recording.
    pub quality: Option<f32>,
    /// Tracers at work, at least 1; the others rest.
    pub workers: u32,
    /// Order of rays.
    pub policy: Policy,
    /// Weight of saliency against importance, 0 (task only) to 1 (saliency only).
    pub saliency_weight: f32,
    /// Samples per job, the paper's n_job.
    pub samples_per_job: u32,
    /// Ageing, from the next view on.
    pub ageing: AgeingRules,
    /// Most bytes of environment maps.
    pub environment_bytes: u64,
    /// Most bytes of textures, where they are limited.
    pub texture_bytes: Option<u64>,
    /// How far a converged view is refined, if at all.
    pub refine: Option<Supersampling>,
    /// Exposure and curve of what is displayed; what is computed does not change with it.
    pub tone: ToneMap,
}

impl Adjustment {
    /// What settings and a display begin with, at ten frames a second.
    pub fn of(settings: &Settings, display: &Display) -> Self {
        Self {
            fps: 10.0,
            quality: None,
            workers: settings.tracers,
            policy: settings.policy.policy,
            saliency_weight: settings.saliency_weight,
            samples_per_job: settings.samples_per_job,
            ageing: settings.ageing,
            environment_bytes: settings.environment_bytes,
            texture_bytes: None,
            refine: settings.supersampling,
            tone: ToneMap::from(display),
        }
    }

    /// All values as bytes, for a hash.
    pub fn to_bytes(&self) -> Vec<u8> {
        postcard::to_stdvec(self).unwrap_or_default()
    }
}

impl Settings {
    /// Takes up what the user changed.
    pub fn adjust(&mut self, to: &Adjustment) {
        self.policy.policy = to.policy;
        self.saliency_weight = if to.saliency_weight >= 0.0 { to.saliency_weight.min(1.0) } else { 0.0 };
        self.samples_per_job = to.samples_per_job.clamp(1, 1 << 20);
        self.ageing = to.ageing;
        self.environment_bytes = to.environment_bytes;
        self.supersampling = to.refine;
    }

    /// Defaults for a picture of this size.
    pub fn new(width: u32, height: u32, tracers: u32) -> Self {
        Self {
            width,
            height,
            tracers,
            policy: RayPolicy::new(Policy::default(), 0),
            saliency_weight: SALIENCY_WEIGHT,
            seed: 0,
            samples_per_job: 256,
            k_max: 6,
            footprint: Footprint::default(),
            ageing: AgeingRules::default(),
            cache_capacity: (1 << 18).max(width as usize * height as usize),
            environment_bytes: 64 << 20,
            supersampling: None,
            winner_takes_all: false,
            approximates: approximates(),
            stations: 0,
            checked: CHECKED,
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
}
