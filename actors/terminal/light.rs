//! Where illumination comes from, as a command line says it.

use std::ffi::OsString;
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use foveal_engine::light::{BakeOptions, Light, Reading};
use foveal_engine::recording::Elsewhere;

use crate::arguments::{duration, share};

/// Where illumination comes from.
#[derive(Args, Clone, Debug)]
pub struct IlluminationArguments {
    /// Illumination made by `foveal bake --out`; without it, one is taken from the cache or refined during the walk
    #[arg(long, value_name = "FILE")]
    pub bake: Option<PathBuf>,
    /// Use only the first estimate, which takes about a second
    #[arg(long, conflicts_with = "bake")]
    pub quick: bool,
    /// Bake before the walk instead of during it
    #[arg(long, conflicts_with = "quick")]
    pub baked: bool,
    /// Folder for cached bakes (default: FOVEAL_CACHE, else the user's cache folder)
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// When a bake is good enough
    #[command(flatten)]
    pub settings: BakeSettingsArguments,
    /// How the scene is read
    #[command(flatten)]
    pub reading: ReadingArguments,
}

/// What is chosen where a scene's files leave a choice.
#[derive(Args, Clone, Debug)]
pub struct ReadingArguments {
    /// Load a glTF file that requires this extension, although this build does not support it; may be repeated
    #[arg(long = "ignore-extension", value_name = "NAME")]
    pub ignored_extensions: Vec<String>,
    /// Material variant of a glTF file
    #[arg(long, value_name = "NAME")]
    pub variant: Option<String>,
}

impl ReadingArguments {
    /// As the engine takes them.
    pub fn reading(&self) -> Reading {
        Reading { ignored_extensions: self.ignored_extensions.clone(), variant: self.variant.clone() }
    }
}

impl IlluminationArguments {
    /// As the engine takes them.
    pub fn light(&self) -> Light {
        Light {
            bake: self.bake.clone(),
            quick: self.quick,
            baked: self.baked,
            refined: false,
            begun: 0,
            keeps_early: true,
            first: None,
            cache: self.cache.clone(),
            settings: self.settings.options(),
            reading: self.reading.reading(),
            edits: Vec::new(),
        }
    }
}

/// When a bake is good enough.
#[derive(Args, Clone, Debug)]
pub struct BakeSettingsArguments {
    /// Stop at this relative error of the irradiance
    #[arg(long, value_name = "SHARE", value_parser = share, default_value = "2%")]
    pub error: f32,
    /// Stop after this many particles
    #[arg(long, value_name = "N", default_value_t = 1 << 22)]
    pub particles: u64,
    /// Approximate number of lightmap texels (default: by number of triangles, 32 Ki to 256 Ki; at least 128 Ki if
    /// lights without area cast sharp shadows)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=1 << 26))]
    pub texels: Option<u32>,
    /// Use fine texels even where no camera or path of the scene leads
    #[arg(long)]
    pub everything: bool,
    /// Seed of the bake's random numbers
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub bake_seed: u64,
    /// Stop after this time, e.g. 10s
    #[arg(long, value_name = "TIME", value_parser = duration)]
    pub time: Option<Duration>,
}

impl BakeSettingsArguments {
    /// As the engine takes them.
    pub fn options(&self) -> BakeOptions {
        let Self { error, particles, texels, everything, bake_seed, time } = self.clone();
        BakeOptions { error, particles, texels, everything, bake_seed, time }
    }
}

/// Files that replay takes instead of the recorded ones.
#[derive(Args, Clone, Debug, Default)]
pub struct ElsewhereArguments {
    /// Scene of the recording, if it has moved
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,
    /// Bake of the recording, if it has moved
    #[arg(long, value_name = "FILE")]
    pub bake: Option<PathBuf>,
    /// Folder for cached bakes (default: FOVEAL_CACHE, else the user's cache folder)
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
}

impl ElsewhereArguments {
    /// As the engine takes them.
    pub fn files(&self) -> Elsewhere {
        Elsewhere { scene: self.scene.clone(), bake: self.bake.clone(), cache: self.cache.clone() }
    }

    /// As another program takes them.
    pub fn words(&self) -> Vec<OsString> {
        let Self { scene, bake, cache } = self;
        let all = [("--scene", scene), ("--bake", bake), ("--cache", cache)];
        let given = all.into_iter().filter_map(|(option, file)| Some((option, file.as_ref()?)));
        given.flat_map(|(option, file)| [OsString::from(option), file.into()]).collect()
    }
}
