//! The first illumination of a scene, within a second: coarse elements, direct light at some of them, some particles.

use rayon::prelude::*;

use super::bake::{BakeSettings, Baker, DirectLight};
use super::clusters::ClusterTree;
use super::direct::{DirectBin, probe};
use super::stored::Illumination;
use crate::rng::hash;
use crate::scene::Scene;
use crate::transport::particle::LightTransport;

/// Texels of the first map.
const TEXELS: u32 = 16 * 1024;
/// Particles of the first map: enough for the mean brightness of every wall, with kernels as wide as walls.
const PARTICLES: u64 = 1 << 16;
/// Elements at which direct light is sampled, at most: in a dense mesh neighbours share theirs.
const PLACES: usize = 32 * 1024;
/// Samples of direct light at each of them: what is noisy is smoothed.
const SAMPLES: u32 = 4;

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
    baker.coarse = true;
    baker.gather_sparsely();
    baker.emit(PARTICLES);
    let mut map = baker.illumination();
    map.summary.notes.push("a first estimate from few particles".into());
    map
}

impl Baker<'_> {
    /// Direct light at every so manieth element, which speaks for those beside it.
    fn gather_sparsely(&mut self) {
        let tree = ClusterTree::build(&self.atlas.elements);
        let run = tree.len().div_ceil(PLACES).max(1);
        let (atlas, transport, seed) = (&self.atlas, &self.transport, self.settings.seed);
        let at = |members: &[u32]| {
            let index = members[members.len() / 2];
            let e = &atlas.elements[index as usize];
            [0, 1].map(|side| {
                let certain = transport.certain(e.triangle, e.b1, e.b2, side == 1);
                let sample = |u| transport.direct(e.triangle, e.b1, e.b2, side == 1, u);
                let mut bin = DirectBin::default();
                bin.set_certain(certain);
                // Most backs are inside of bodies.
                if side == 0 || probe(hash(seed, index.into(), 2), sample) {
                    bin.gather(hash(seed, index.into(), side), SAMPLES, sample);
                }
                bin
            })
        };
        let found: Vec<[DirectBin; 2]> = tree.order().par_chunks(run).map(at).collect();
        for (members, bins) in tree.order().chunks(run).zip(found) {
            for &e in members {
                self.direct[e as usize] = bins;
            }
        }
        self.direct_rounds = 1;
        self.sources = None;
    }
}
