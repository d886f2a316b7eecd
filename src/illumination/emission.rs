//! Particles of a bake: where each begins, and what is counted of it.

use glam::Vec3;
use rayon::prelude::*;

use super::bake::Baker;
use super::sources::{Source, Sources, next_lesson};
use crate::image::luminance;
use crate::rng::hash;
use crate::transport::particle::{Deposit, Reflected, SurfacePoint};

/// The irrational number that multiples spread most evenly of (modulo 1).
const GOLDEN_RATIO: f64 = 0.618_033_988_749_894_9;

impl Baker<'_> {
    /// Emits the next `count` particles.
    pub fn emit(&mut self, count: u64) {
        let end = self.emitted + count;
        while self.emitted < end {
            if self.sources.is_none() {
                self.find_sources();
            }
            let lesson = next_lesson(self.emitted);
            let first = self.emitted;
            let bounces: u64 = (0..(end.min(lesson) - first) as usize)
                .into_par_iter()
                .with_min_len(128)
                .map(|index| u64::from(self.emit_one(first + index as u64)))
                .sum();
            self.emitted = end.min(lesson);
            self.bounces += bounces;
            if self.emitted == lesson {
                self.importance.learn();
                self.sources = None;
            }
        }
    }

    /// Emits particle `index`. Returns the number of surfaces it met.
    fn emit_one(&self, index: u64) -> u32 {
        let seed = self.settings.seed;
        let Some(sources) = &self.sources else {
            return self.transport.trace(seed, index, &mut |d| {
                self.arrive(&d, 1.0);
            });
        };
        // Additive recurrence: the places where any run of particles begins are spread evenly.
        let start = hash(seed, 0, 0x11e) as f64 / 2f64.powi(64);
        let choice = (start + index as f64 * GOLDEN_RATIO).fract();
        let share = sources.share();
        if choice >= share {
            let (choice, weight) = ((choice - share) / (1.0 - share), 1.0 / (1.0 - share) as f32);
            let mut met = 0;
            let mut deposit = |d: Deposit| met += u64::from(sources.matters(self.arrive(&d, weight), d.back));
            let bounces = self.transport.trace_reflected(&self.lit, choice, seed, index, &mut deposit);
            self.importance.count_other(met);
            return bounces;
        }
        let Some(source) = sources.choose(choice / share) else { return 0 };
        let (mut met, weight) = (0, 1.0 / share as f32);
        let mut deposit = |d: Deposit| met += u64::from(sources.matters(self.arrive(&d, weight), d.back));
        let bounces = self.transport.reflect(&self.reflected(&source), seed, index, &mut deposit);
        self.importance.count(source.element, source.back, met);
        bounces
    }

    /// Counts what a particle brings. Returns the element.
    fn arrive(&self, d: &Deposit, weight: f32) -> u32 {
        let element = self.atlas.element_at(d.triangle, d.b1, d.b2);
        self.bins.add(element, d.back, d.flux * weight);
        element
    }

    fn reflected(&self, source: &Source) -> Reflected {
        let e = &self.atlas.elements[source.element as usize];
        let at = SurfacePoint { triangle: e.triangle, b1: e.b1, b2: e.b2 };
        Reflected { at, back: source.back, width: e.area.sqrt(), flux: source.flux }
    }

    /// Where light from afar falls, by what has been gathered of it; the first time, what it is good for there.
    fn find_sources(&mut self) {
        let flux = |element: u32, back: bool| {
            let bin = &self.direct[element as usize][usize::from(back)];
            let e = &self.atlas.elements[element as usize];
            let mut irradiance = bin.sampled_from_afar();
            if bin.certain() != Vec3::ZERO {
                let near = self.transport.certain_from_near(e.triangle, e.b1, e.b2, back);
                irradiance += (bin.certain() - near).max(Vec3::ZERO);
            }
            irradiance * e.area
        };
        let elements = self.direct.len();
        let all: Vec<[Vec3; 2]> =
            (0..elements as u32).into_par_iter().map(|e| [false, true].map(|back| flux(e, back))).collect();
        let flux = |element: u32, back: bool| all[element as usize][usize::from(back)];
        let light: Vec<[f32; 2]> =
            self.direct.par_iter().map(|sides| sides.each_ref().map(|b| luminance(b.mean().0))).collect();
        // Where direct light is more than usual, nobody sees the noise of the rest.
        let (mut sum, mut area) = (0.0, 0.0);
        for (e, element) in self.atlas.elements.iter().enumerate().filter(|&(e, _)| self.watched[e]) {
            sum += f64::from(light[e][0] * element.area);
            area += f64::from(element.area);
        }
        let drowning = if area > 0.0 { (sum / area) as f32 } else { 0.0 };
        let matters =
            self.watched.iter().zip(&light).map(|(&w, l)| l.map(|light| w && light <= drowning)).collect();
        let mut sources = Sources::new(&self.importance, self.lit.begins(), &flux, matters);
        if self.emitted == 0 {
            let pilots = sources.pilots(&self.importance);
            let seed = hash(self.settings.seed, 0, 0x9107);
            pilots.par_iter().enumerate().with_min_len(128).for_each(|(i, source)| {
                let mut met = 0;
                let mut deposit = |d: Deposit| {
                    let element = self.atlas.element_at(d.triangle, d.b1, d.b2);
                    met += u64::from(sources.matters(element, d.back));
                };
                self.transport.reflect(&self.reflected(source), seed, i as u64, &mut deposit);
                self.importance.count(source.element, source.back, met);
            });
            self.importance.learn();
            sources = Sources::new(&self.importance, self.lit.begins(), &flux, sources.into_matters());
        }
        self.sources = Some(sources);
    }
}
