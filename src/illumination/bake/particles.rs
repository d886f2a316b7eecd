//! Caustics of a bake: particles, in parts for whoever traces them.
//!
//! What a part comes to is a function of scene, settings and its first particle alone; sums are made in the order of particles,
//! so it does not matter who traces which.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::Baker;
use super::orders::Gatherers;
use crate::transport::Indexed;
use crate::transport::caustic::{Caustics, Class, RUN, Sources};

/// Particles of a part, which one task follows.
pub const PART: u64 = 1 << 10;
/// Particles of caustics before the first round, whole runs for each half; after the first one over all sites every later round
/// doubles them.
const PARTICLES: u64 = 1 << 16;

/// What a particle brought to a site.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Arrived {
    site: u32,
    /// Whether it belongs to the second half.
    is_second: bool,
    /// W.
    flux: Vec3,
    is_unfound: bool,
}

impl Arrived {
    /// Whether it can be what a particle brought: what came from elsewhere must.
    pub fn is_sound(&self) -> bool {
        self.flux.is_finite()
    }
}

impl Baker {
    /// Where particles begin, looked for once.
    fn sources(&self, indexed: Indexed<'_>) -> &Sources {
        let look = || Sources::new(indexed.scene, indexed.accel, indexed.lights, Class::All);
        self.sources.get_or_init(look)
    }

    /// Particles that are to be traced before the round that has begun.
    fn wanted(&self) -> u64 {
        let most = self.settings.particles.map_or(u64::MAX, |most| most / 2);
        (PARTICLES << self.whole_rounds()).min(most)
    }

    /// Whether some of them are missing.
    pub(super) fn wants_particles(&self, indexed: Indexed<'_>) -> bool {
        // Not looked for before there is a first picture.
        self.sources(indexed).is_possible() && self.particles < self.wanted()
    }

    /// Has a run of particles for each half traced, or as many as keep all who trace busy.
    pub(super) fn trace(&mut self, indexed: Indexed<'_>, gatherers: &dyn Gatherers) {
        let pairs = self.wanted().saturating_sub(self.particles).div_ceil(2 * RUN);
        let end = self.particles + 2 * RUN * pairs.min(gatherers.worth()).max(1);
        let parts: Vec<u64> = (self.particles..end).step_by(PART as usize).collect();
        let traced = gatherers.trace(self, indexed, &parts);
        if !gatherers.is_wanted() {
            return;
        }
        // In the order of particles: sums depend on it.
        for arrived in traced.into_iter().flatten() {
            if let Some(sums) = self.gathered.get_mut(arrived.site as usize) {
                sums.deposit(usize::from(arrived.is_second), arrived.flux, arrived.is_unfound);
            }
        }
        self.paths += end - self.particles;
        self.particles = end;
    }

    /// What the particles of a part bring. Of the bake itself only scene and settings count.
    pub fn arrived(&self, indexed: Indexed<'_>, part: u64) -> Vec<Arrived> {
        let caustics = Caustics::new(indexed.scene, indexed.accel, indexed.lights, self.sources(indexed));
        let (seed, mesh) = (self.settings.seed, &indexed.scene.mesh);
        let mut found = Vec::new();
        for index in part..part.saturating_add(PART) {
            caustics.trace(seed, index, &mut |deposit| {
                let at = deposit.at;
                let element = self.atlas.element_at(at.triangle, at.b1, at.b2);
                let site = self.site_of[element as usize][usize::from(at.back)];
                let normal = mesh.smooth_normal(at.triangle, at.b1, at.b2, at.geometric_normal);
                if site != u32::MAX {
                    let is_second = index / RUN % 2 == 1;
                    let (flux, is_unfound) = (deposit.on(normal), deposit.is_unfound);
                    found.push(Arrived { site, is_second, flux, is_unfound });
                }
            });
        }
        found
    }
}
