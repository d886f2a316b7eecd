//! What to bake, and what tells one bake from another.

use serde::{Deserialize, Serialize};

use crate::scene::Scene;

/// Raised with every change of how a map is computed, or of what of it is kept.
pub const VERSION: u32 = 25;

/// What to bake, and when it is good enough.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BakeSettings {
    /// Texels of the lightmap, about; 0 stores everything per vertex.
    pub texels: u32,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Stop after this many paths.
    pub particles: Option<u64>,
    /// Fine elements also where no camera and no path leads.
    pub everything: bool,
    /// Stop at this relative error ([`Summary::relative_error`](super::Summary::relative_error)), for example 0.02.
    pub error: Option<f32>,
}

impl Default for BakeSettings {
    fn default() -> Self {
        Self { texels: 256 * 1024, seed: 1, particles: Some(1 << 24), everything: false, error: Some(0.02) }
    }
}

/// Key of a cache file: everything that decides the values, except how far the bake went, which the
/// file's summary says.
pub fn cache_key(scene: &Scene, settings: &BakeSettings) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(b"foveal illumination");
    hasher.update(&VERSION.to_le_bytes());
    hasher.update(&scene.content_hash);
    hasher.update(&settings.texels.to_le_bytes());
    hasher.update(&settings.seed.to_le_bytes());
    hasher.update(&[u8::from(settings.everything)]);
    *hasher.finalize().as_bytes()
}

/// Key of a map that a bake publishes on its way, after some of its rounds: with what decides the values, as far as those
/// came, the number of paths, which the rounds share.
pub fn early_key(scene: &Scene, settings: &BakeSettings) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(b"early");
    hasher.update(&cache_key(scene, settings));
    hasher.update(&settings.particles.unwrap_or(u64::MAX).to_le_bytes());
    *hasher.finalize().as_bytes()
}
