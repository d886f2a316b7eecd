//! What commands share that walk as somebody wants to, in a window or in a browser.

use std::path::PathBuf;

use clap::Args;
use foveal::allocation::policy::{Policy, RayPolicy};
use foveal::splatting::supersampling::Supersampling;
use foveal_engine::controls::Setting;
use foveal_engine::recipe::From;
use foveal_engine::recording::TRACERS_MAX;
use foveal_engine::{Light, Recipe, Settings};
use foveal_terminal::arguments::{Size, bytes, positive};
use foveal_terminal::hashes::Hashes;
use foveal_terminal::light::IlluminationArguments;
use foveal_terminal::mode::ModeArguments;

use super::doors::doors;
use super::tracers::TracersArguments;

/// Arguments of a walk that somebody takes.
#[derive(Args, Clone, Debug)]
pub struct InteractiveArguments {
    /// An OBJ or glTF file or a sidecar
    pub scene: PathBuf,
    /// Picture size (default: 512x512; a window's picture follows its size then, unless it is recorded)
    #[arg(long, value_name = "WxH")]
    size: Option<Size>,
    /// Begin at this camera (default: the scene's first)
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,
    /// Begin along this camera path, which is played until you move
    #[arg(long, value_name = "NAME", conflicts_with = "camera")]
    path: Option<String>,
    /// What decides which samples come first
    #[arg(long, value_name = "NAME", default_value_t = Policy::default())]
    policy: Policy,
    /// Seed of every random number
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Frames per second to aim at (default: the scene's, else 10)
    #[arg(long, value_parser = positive)]
    fps: Option<f32>,
    #[command(flatten)]
    mode: ModeArguments,
    /// Number of tracers (default: one per core)
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=i64::from(TRACERS_MAX)))]
    workers: Option<u32>,
    /// Refine what has converged until the standard error of displayed values, 0 to 1, is below this; 0 refines nothing
    /// (default: 0.01, with --headless 0)
    #[arg(long, value_name = "NOISE", value_parser = clap::value_parser!(f32))]
    refine: Option<f32>,
    /// The most samples that --refine takes of a pixel
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = clap::value_parser!(u32).range(1..=1 << 16))]
    refine_samples: u32,
    /// The most bytes of textures kept in memory, e.g. 64MiB (default: the scene's, else no limit)
    #[arg(long, value_name = "SIZE", value_parser = bytes)]
    texture_budget: Option<u64>,
    /// Record the walk, so that `foveal replay` can run it again; one that begins anew, as in another scene or the same read
    /// again, goes to FILE-2, FILE-3, ...
    #[arg(long, value_name = "FILE")]
    pub record: Option<PathBuf>,
    /// How densely hashes are recorded
    #[arg(long, value_name = "WHICH", value_enum, default_value_t = Hashes::Each, requires = "record")]
    hashes: Hashes,
    /// Do not keep the maps of growing light beside the recording (FILE.light); a replay then bakes them again
    #[arg(long, requires = "record")]
    no_light: bool,
    /// Set a control of the panel from the start, e.g. exposure=-1; may be repeated. --help lists them
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<Setting>,
    #[command(flatten)]
    pub tracers: TracersArguments,
    #[command(flatten)]
    pub illumination: IlluminationArguments,
}

impl InteractiveArguments {
    /// The picture's size.
    pub fn size(&self) -> Size {
        self.size.unwrap_or(Size { width: 512, height: 512 })
    }

    /// Whether the picture may have another size when the window has.
    pub fn follows(&self) -> bool {
        self.size.is_none() && self.record.is_none()
    }

    /// Tracers that were asked for, or one for each core.
    pub fn workers(&self) -> u32 {
        let cores = std::thread::available_parallelism().map_or(1, usize::from) as u32;
        self.workers.unwrap_or(cores.min(TRACERS_MAX))
    }

    /// The walk of a command under this light; `noise` is what it is refined to unless it was said.
    pub fn recipe(&self, command: &'static str, light: Light, noise: f32) -> Recipe {
        let light = Light { baked: light.baked || self.tracers.is_asked_for(), ..light };
        let noise = self.refine.unwrap_or(noise);
        let rules = Supersampling { noise, max_samples: self.refine_samples };
        let settings = Settings {
            policy: RayPolicy::new(self.policy, self.seed),
            seed: self.seed,
            supersampling: (noise > 0.0).then_some(rules),
            ..Settings::new(self.size().width, self.size().height, self.workers())
        };
        Recipe {
            light,
            fps: self.fps,
            quality: self.mode.least_quality(),
            texture_bytes: self.texture_budget,
            record: self.record.clone(),
            keeps_light: !self.no_light,
            command,
            hashing: self.hashes.into(),
            set: self.set.clone(),
            from: From { camera: self.camera.clone(), path: self.path.clone() },
            doors: doors(&self.tracers),
            ..Recipe::new(&self.scene, self.tracers.settings(settings))
        }
    }
}
