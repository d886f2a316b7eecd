//! What samples brought to a site: sums in two independent halves, straight light, indirect light and caustics apart.

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::atlas::Atlas;
use super::filter::{Noisy, Parts};
use super::points::{CANDIDATES, Look, Points};
use super::sites::Site;
use crate::rng::{Stream, hash};
use crate::scene::Scene;
use crate::transport::bsdf::Bsdf;
use crate::transport::gather::Gather;
use crate::transport::medium::Media;

/// Weight of the indirect light of former rounds at the beginning of another one, which reads a better map.
const KEPT: f32 = 0.5;

/// Points of a site, at most, at which named lights are asked for.
const NAMED: u32 = 8;

/// Sums of one site, W/m² per band times samples; caustics W.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Gathered {
    sharp: [[f32; 3]; 2],
    soft: [[f32; 3]; 2],
    caustic: [[f32; 3]; 2],
    /// What of the caustics no path from a surface finds.
    unfound: [f32; 3],
    /// Mean irradiance straight from named lights, once somebody asked for it.
    named: Option<[f32; 3]>,
    /// Samples of both halves.
    samples: u32,
    /// Samples of each half that `soft` counts as.
    soft_weight: f32,
    /// Candidates that samples begin at, as bits; `None` while nobody has looked.
    usable: Option<u16>,
}

impl Gathered {
    /// Looks for points of the site where that was not done before. False where there are none.
    pub fn find_points(
        &mut self,
        seen_by: (&Scene, &crate::geometry::Accel),
        atlas: &Atlas,
        points: &Points,
        (site, look): (&Site, Look),
    ) -> bool {
        let usable = || points.usable(seen_by, atlas, site.element, site.back, look);
        *self.usable.get_or_insert_with(usable) != 0
    }

    /// Whether there is anything to see of the site, as far as is known.
    pub fn is_open(&self) -> bool {
        self.usable != Some(0)
    }

    /// Whether samples have found any light.
    pub fn is_lit(&self) -> bool {
        let named = self.named.iter().flatten();
        [self.sharp, self.soft].iter().flatten().flatten().chain(named).any(|v| *v > 0.0)
    }

    /// Whether it can be what samples brought: what came from elsewhere must.
    pub fn is_sound(&self) -> bool {
        let sums = [self.sharp, self.soft, self.caustic];
        let mut all = sums.iter().flatten().chain(&self.named).flatten().chain([&self.soft_weight]);
        all.all(|v| v.is_finite()) && self.samples < 1 << 30
    }

    /// Another round begins: indirect light of the ones before counts less.
    pub fn begin_round(&mut self) {
        self.soft.iter_mut().flatten().for_each(|v| *v *= KEPT);
        self.soft_weight *= KEPT;
    }

    /// Takes `count` samples, an even number, at the points found.
    pub fn gather(
        &mut self,
        scene: &Scene,
        (atlas, points): (&Atlas, &Points),
        gather: &Gather<'_>,
        site: &Site,
        (seed, count): (u64, u32),
    ) {
        let usable = self.usable.unwrap_or(0);
        let found = usable.count_ones();
        if found == 0 {
            return;
        }
        let side = u64::from(site.element) << 1 | u64::from(site.back);
        self.named.get_or_insert_with(|| {
            let looks = found.min(NAMED);
            let look = |turn: u32| {
                let point =
                    points.candidate(scene, atlas, site.element, bit(usable, turn * found / looks)?)?;
                let at = point.seen_from(scene, site.back).with_footprint(site.width);
                Some(gather.named(&at, &Bsdf::at(scene, &at), Media::EMPTY))
            };
            ((0..looks).filter_map(look).sum::<Vec3>() / looks as f32).to_array()
        });
        for sample in self.samples..self.samples + count {
            let (half, index) = ((sample & 1) as usize, sample >> 1);
            // Each half comes to all points in turn.
            let turn = (index + hash(seed, side, 2 + half as u64) as u32 % CANDIDATES) % found;
            let Some(k) = bit(usable, turn) else { continue };
            let Some(point) = points.candidate(scene, atlas, site.element, k) else { continue };
            let at = point.seen_from(scene, site.back).with_footprint(site.width);
            let stream = Stream::in_sequence(hash(seed, side, half as u64), 0, index);
            let light = gather.arriving(&at, Media::EMPTY, stream);
            add(&mut self.sharp[half], light.sharp);
            add(&mut self.soft[half], light.soft + light.deep);
        }
        self.samples += count;
        self.soft_weight += 0.5 * count as f32;
    }

    /// Adds what a particle of a half brought, W.
    pub fn deposit(&mut self, half: usize, flux: Vec3, is_unfound: bool) {
        add(&mut self.caustic[half], flux);
        if is_unfound {
            add(&mut self.unfound, flux);
        }
    }

    /// The share of caustics that no path from a surface finds ([`crate::transport::caustic::Class::Unfound`]).
    pub fn unfound_share(&self) -> Vec3 {
        Vec3::from_array(std::array::from_fn(|c| {
            let all = self.caustic[0][c] + self.caustic[1][c];
            if all > 0.0 { (self.unfound[c] / all).min(1.0) } else { 0.0 }
        }))
    }

    /// Irradiance of its parts, W/m²; `caustic`: what the sums of caustics are multiplied with.
    pub fn parts(&self, caustic: f32) -> Parts {
        let scaled = |sums: [[f32; 3]; 2], by: f32| {
            Noisy::new(sums.map(|sum| {
                let value = Vec3::from_array(sum) * by;
                if value.is_finite() { value } else { Vec3::ZERO }
            }))
        };
        let per = |n: f32| if n > 0.0 { 1.0 / n } else { 0.0 };
        [
            scaled(self.sharp, per(0.5 * self.samples as f32)),
            scaled(self.soft, per(self.soft_weight)),
            scaled(self.caustic, caustic),
        ]
    }

    /// Irradiance straight from named lights, W/m², as far as anybody asked.
    pub fn named(&self) -> Option<Vec3> {
        self.named.map(Vec3::from_array)
    }

    /// Samples taken.
    pub fn samples(&self) -> u32 {
        self.samples
    }
}

/// The number of the set bit that `turn` others precede.
fn bit(bits: u16, turn: u32) -> Option<u32> {
    (0..CANDIDATES).filter(|k| bits >> k & 1 == 1).nth(turn as usize)
}

fn add(sum: &mut [f32; 3], value: Vec3) {
    sum.iter_mut().zip(value.to_array()).for_each(|(sum, v)| *sum += v);
}
