//! Where a walk's illumination comes from, and when a bake of it is good enough. Part of a recording's header.

use std::path::PathBuf;
use std::time::Duration;

use foveal::illumination::bake::BakeSettings;
use foveal::scene::Scene;
use foveal::scene::edit::SceneEdit;
use foveal_files::load::LoadOptions;
use serde::{Deserialize, Serialize};

/// Where illumination comes from.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Light {
    /// A file that `foveal bake --out` made; without it one is taken from the cache, or refined while walking.
    pub bake: Option<PathBuf>,
    /// Stay with the first estimate, which takes about a second.
    pub quick: bool,
    /// Bake before the walk begins instead of while it goes on.
    #[serde(default)]
    pub baked: bool,
    /// In a recording: the illumination was refined while walking.
    #[serde(default)]
    pub refined: bool,
    /// In a recording: rounds of the bake whose map it began with, where that was kept by a walk before; of a first estimate 0.
    #[serde(default, skip_serializing_if = "is_first")]
    pub begun: u32,
    /// Begin with what the last walk of the scene had found by its end, and leave that to the next one.
    #[serde(skip)]
    pub keeps_early: bool,
    /// Folder of kept bakes; `None` is FOVEAL_CACHE, else the user's cache folder.
    #[serde(skip)]
    pub cache: Option<PathBuf>,
    /// A file with the first estimate, taken if it is there.
    #[serde(skip)]
    pub first: Option<PathBuf>,
    /// When a bake is good enough.
    pub settings: BakeOptions,
    /// How the scene's files are read, which decides what is lit.
    #[serde(default, skip_serializing_if = "Reading::is_plain")]
    pub reading: Reading,
    /// What is changed of what was read, before it is lit.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub edits: Vec<SceneEdit>,
}

fn is_first(rounds: &u32) -> bool {
    *rounds == 0
}

/// What is chosen where a scene's files leave a choice.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reading {
    /// Extensions of glTF to do without although a file requires them.
    pub ignored_extensions: Vec<String>,
    /// Variant of glTF's materials.
    pub variant: Option<String>,
}

impl Reading {
    /// Whether nothing was chosen.
    pub fn is_plain(&self) -> bool {
        *self == Self::default()
    }

    /// As the core takes them.
    pub fn options(&self) -> LoadOptions {
        LoadOptions {
            ignored_extensions: self.ignored_extensions.clone(),
            variant: self.variant.clone(),
            ..LoadOptions::default()
        }
    }
}

/// When a bake is good enough.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct BakeOptions {
    /// Relative error of irradiance at which it ends.
    pub error: f32,
    /// Particles after which it ends.
    pub particles: u64,
    /// Texels of the lightmap, about; `None` goes by the number of triangles.
    pub texels: Option<u32>,
    /// Fine texels also where no camera or path of the scene leads.
    #[serde(default)]
    pub everything: bool,
    /// Seed of its random numbers.
    pub bake_seed: u64,
    /// Time after which it ends.
    pub time: Option<Duration>,
}

impl Default for BakeOptions {
    fn default() -> Self {
        Self { error: 0.02, particles: 1 << 22, texels: None, everything: false, bake_seed: 1, time: None }
    }
}

impl BakeOptions {
    /// As the core takes them.
    pub fn settings(&self, scene: &Scene) -> BakeSettings {
        // A room of a few walls needs no fine map, and its bake should take seconds; but the shadows of lights without
        // area are as sharp as the map.
        let least = if scene.lights.is_empty() { 32 * 1024 } else { 128 * 1024 };
        let of_scene = || (least + 4 * scene.mesh.triangles.len()).min(256 * 1024) as u32;
        BakeSettings {
            texels: self.texels.unwrap_or_else(of_scene),
            seed: self.bake_seed,
            everything: self.everything,
            particles: Some(self.particles.max(1)),
            error: Some(self.error),
        }
    }
}
