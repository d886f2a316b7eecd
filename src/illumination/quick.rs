//! The first illumination of a scene, within a second: coarse elements, a round of direct light, some particles.

use super::bake::{BakeSettings, Baker, DirectLight};
use super::stored::Illumination;
use crate::scene::Scene;
use crate::transport::particle::LightTransport;

/// Texels of the first map.
const TEXELS: u32 = 16 * 1024;
/// Particles of the first map: enough for the mean brightness of every wall, with kernels as wide as walls.
const PARTICLES: u64 = 1 << 16;

/// Samples of direct light per element: what is noisy is smoothed.
const SAMPLES: u32 = 2;

/// The first picture: direct light sampled at coarse elements, all other light from few particles with wide
/// kernels. Nothing in it is guessed: it is a short bake.
pub fn quick_direct(scene: &Scene, transport: &dyn LightTransport, seed: u64) -> Illumination {
    let settings = BakeSettings {
        texels: TEXELS,
        seed,
        error: Some(0.05),
        direct: DirectLight::NextEvent,
        ..BakeSettings::default()
    };
    let mut baker = Baker::new(scene, transport, &settings);
    baker.samples_per_round = SAMPLES;
    baker.coarse = true;
    baker.gather_direct();
    baker.emit(PARTICLES);
    let mut map = baker.illumination();
    map.summary.notes.push("a first estimate from few particles".into());
    map
}
