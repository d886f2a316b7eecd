//! Where particles begin that carry the light of the sky and of suns: on the elements that it falls on, with the
//! irradiance that was gathered there, instead of somewhere outside, from where most of them would miss what matters.
//!
//! A room takes a hundredth of the light that falls on the house. So more particles begin, each carrying less, where
//! particles have been seen to arrive where they matter: in sight, and not drowned in direct light. What a particle
//! carries makes up for how often it begins, so that the choice changes the noise and not the mean.

use std::sync::atomic::{AtomicU64, Ordering};

use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::atlas::Element;
use crate::image::luminance;

/// Elements that are learned about together.
const GROUP: usize = 16;
/// Groups that know about each other.
const REGION: usize = 16;
/// Particles that the first guess counts for in a region, and what is learned of the region in a group.
const PRIOR: f64 = 1.0;
/// Importance that is left to those from where nothing seems to arrive.
const FLOOR: f64 = 1e-3;
/// Particles that begin on each side of a lit group, to learn what it is good for.
pub(super) const PILOTS: u32 = 8;
/// Least share of particles that begin with a diffuse reflection, and otherwise, where there are both.
const SHARE_MIN: f64 = 0.1;
/// Particles before the first lesson; every later one comes after four times as many.
const FIRST_LESSON: u64 = 8192;

/// The number of particles after which importance is learned next.
pub(super) fn next_lesson(emitted: u64) -> u64 {
    let mut lesson = FIRST_LESSON;
    while lesson <= emitted {
        lesson *= 4;
    }
    lesson
}

/// What particles that begin on one side of a group have come to.
#[derive(Debug, Default)]
struct Fate {
    /// Particles begun there.
    begun: AtomicU64,
    /// Their arrivals where they matter.
    met: AtomicU64,
    /// Arrivals expected of one before any was seen.
    expected: f64,
    /// The same after the last lesson.
    learned: f64,
}

impl Fate {
    fn count(&self, met: u64) {
        self.begun.fetch_add(1, Ordering::Relaxed);
        self.met.fetch_add(met, Ordering::Relaxed);
    }

    /// Arrivals where they matter, and particles.
    fn seen(&mut self) -> (f64, f64) {
        (*self.met.get_mut() as f64, *self.begun.get_mut() as f64)
    }
}

/// How many arrivals that matter a particle has that begins at an element.
#[derive(Debug, Default)]
pub(super) struct Importance {
    /// Elements by triangle: neighbours, mostly, are close to each other.
    order: Vec<u32>,
    /// Group of each element.
    group: Vec<u32>,
    /// Of the front and the back of each group.
    fates: Vec<[Fate; 2]>,
    /// Of all particles that begin otherwise: at lamps, on mirrors, on glass.
    others: Fate,
}

/// What has been learned, for a bake that will be continued: begun, met, learned.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct ImportanceState {
    fates: Vec<[(u64, u64, f64); 2]>,
    others: (u64, u64, f64),
}

impl Importance {
    /// Nothing learned yet; `expected` is what an element is thought to be good for.
    pub(super) fn new(elements: &[Element], expected: &dyn Fn(u32) -> f64) -> Self {
        let mut order: Vec<u32> = (0..elements.len() as u32).collect();
        order.par_sort_unstable_by_key(|&e| (elements[e as usize].triangle, e));
        let mut group = vec![0; elements.len()];
        for (g, members) in order.chunks(GROUP).enumerate() {
            for &e in members {
                group[e as usize] = g as u32;
            }
        }
        let fate = |members: &[u32]| {
            let expected = members.iter().map(|&e| expected(e)).fold(0.0, f64::max);
            [(); 2].map(|()| Fate { expected, learned: expected.max(FLOOR), ..Fate::default() })
        };
        let fates = order.chunks(GROUP).map(fate).collect();
        let others = Fate { expected: 1.0, learned: 1.0, ..Fate::default() };
        Self { order, group, fates, others }
    }

    /// Elements by group.
    pub(super) fn groups(&self) -> impl Iterator<Item = &[u32]> {
        self.order.chunks(GROUP)
    }

    /// Counts a particle that began at an element, with its arrivals where they matter.
    pub(super) fn count(&self, element: u32, back: bool, met: u64) {
        let fate = &self.fates[self.group[element as usize] as usize][usize::from(back)];
        fate.count(met);
    }

    /// Counts a particle that began otherwise.
    pub(super) fn count_other(&self, met: u64) {
        self.others.count(met);
    }

    /// Of particles that begin otherwise.
    pub(super) fn of_others(&self) -> f64 {
        self.others.learned
    }

    /// Draws the lesson from what was counted.
    pub(super) fn learn(&mut self) {
        let posterior = |(met, begun): (f64, f64), prior: f64| (met + PRIOR * prior) / (begun + PRIOR);
        self.others.learned = posterior(self.others.seen(), self.others.expected).max(FLOOR);
        for region in self.fates.chunks_mut(REGION) {
            for side in [0, 1] {
                let (mut seen, mut expected) = ((0.0, 0.0), 0.0f64);
                for fate in region.iter_mut().map(|sides| &mut sides[side]) {
                    let (met, begun) = fate.seen();
                    seen = (seen.0 + met, seen.1 + begun);
                    expected = expected.max(fate.expected);
                }
                let around = posterior(seen, expected);
                for fate in region.iter_mut().map(|sides| &mut sides[side]) {
                    fate.learned = posterior(fate.seen(), around).max(FLOOR);
                }
            }
        }
    }

    /// Of particles that begin on one side of group `g`.
    fn at(&self, g: usize, side: usize) -> f64 {
        self.fates[g][side].learned
    }

    /// What has been learned.
    pub(super) fn state(&self) -> ImportanceState {
        let of = |f: &Fate| (f.begun.load(Ordering::Relaxed), f.met.load(Ordering::Relaxed), f.learned);
        let fates = self.fates.iter().map(|[front, back]| [of(front), of(back)]).collect();
        ImportanceState { fates, others: of(&self.others) }
    }

    /// Takes up what had been learned; nothing, if it is of other elements.
    pub(super) fn restore(&mut self, state: &ImportanceState) {
        if state.fates.len() != self.fates.len() {
            return;
        }
        let known = state.fates.iter().flatten().chain([&state.others]);
        let fates = self.fates.iter_mut().flatten().chain([&mut self.others]);
        for (fate, &(begun, met, learned)) in fates.zip(known) {
            *fate = Fate { begun: begun.into(), met: met.into(), learned, expected: fate.expected };
        }
    }
}

/// A particle's begin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Source {
    pub(super) element: u32,
    pub(super) back: bool,
    /// Flux that falls there from afar, as if it were the only place, W.
    pub(super) flux: Vec3,
}

/// Light from afar on one side of an element.
#[derive(Clone, Copy, Debug, PartialEq)]
struct LitSide {
    element: u32,
    back: bool,
    flux: Vec3,
    /// Share of the particles, those before it included.
    share: f64,
}

/// All sides of elements that light from afar falls on.
#[derive(Clone, Debug, Default)]
pub(super) struct Sources {
    sides: Vec<LitSide>,
    /// Share of the particles that begin here.
    here: f64,
    /// Of each element, whether what arrives on its front and on its back matters.
    matters: Vec<[bool; 2]>,
}

impl Sources {
    /// `flux` is what light from afar brings to a side of an element, `others` what depends on particles that begin
    /// otherwise, W.
    pub(super) fn new(
        importance: &Importance,
        others: f64,
        flux: &dyn Fn(u32, bool) -> Vec3,
        matters: Vec<[bool; 2]>,
    ) -> Self {
        let (mut sides, mut total) = (Vec::new(), 0.0);
        for (g, members) in importance.groups().enumerate() {
            for (side, back) in [false, true].into_iter().enumerate() {
                let important = importance.at(g, side);
                for &element in members {
                    let flux = flux(element, back);
                    let y = f64::from(luminance(flux));
                    if y > 0.0 && y.is_finite() {
                        total += y * important.sqrt();
                        sides.push(LitSide { element, back, flux, share: total });
                    }
                }
            }
        }
        for side in &mut sides {
            side.share /= total;
        }
        // Both noises are least together where particles are as many as flux times the root of importance.
        let others = others * importance.of_others().sqrt();
        let here = match (total > 0.0, others > 0.0) {
            (false, _) => 0.0,
            (true, false) => 1.0,
            (true, true) => (total / (total + others)).clamp(SHARE_MIN, 1.0 - SHARE_MIN),
        };
        Self { sides, here, matters }
    }

    /// Whether an arrival on an element is one that matters.
    pub(super) fn matters(&self, element: u32, back: bool) -> bool {
        self.matters[element as usize][usize::from(back)]
    }

    pub(super) fn into_matters(self) -> Vec<[bool; 2]> {
        self.matters
    }

    /// Share of the particles that begin here.
    pub(super) fn share(&self) -> f64 {
        self.here
    }

    /// Where a particle begins, for a number in [0, 1).
    pub(super) fn choose(&self, choice: f64) -> Option<Source> {
        let i = self.sides.partition_point(|s| s.share <= choice).min(self.sides.len().checked_sub(1)?);
        let side = &self.sides[i];
        let share = side.share - if i > 0 { self.sides[i - 1].share } else { 0.0 };
        let flux = side.flux / share as f32;
        flux.is_finite().then_some(Source { element: side.element, back: side.back, flux })
    }

    /// One lit side of every lit group for each of [`PILOTS`] particles.
    pub(super) fn pilots(&self, importance: &Importance) -> Vec<Source> {
        let of = |s: &LitSide| (importance.group[s.element as usize], s.back);
        let source = |s: &LitSide| Source { element: s.element, back: s.back, flux: s.flux };
        let groups = self.sides.chunk_by(|a, b| of(a) == of(b));
        groups
            .flat_map(|g| (0..PILOTS as usize).map(move |i| source(&g[i * g.len() / PILOTS as usize])))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn elements(n: u32) -> Vec<Element> {
        (0..n).map(|i| Element { triangle: i / 20, area: 1.0, ..Element::default() }).collect()
    }

    /// A house of 640 elements, the front of the last 64 in a room that takes a hundredth of the light.
    fn house(importance: &Importance) -> Sources {
        Sources::new(
            importance,
            10.0,
            &|e, back| match (back, e < 576) {
                (true, _) => Vec3::ZERO,
                (false, true) => Vec3::ONE,
                (false, false) => Vec3::splat(0.09),
            },
            Vec::new(),
        )
    }

    #[test]
    fn more_particles_begin_where_they_matter_and_the_mean_is_kept() {
        let elements = elements(640);
        let mut importance = Importance::new(&elements, &|_| 1.0);
        let first = house(&importance);
        for pilot in first.pilots(&importance) {
            importance.count(pilot.element, pilot.back, if pilot.element < 576 { 0 } else { 3 });
        }
        for source in (0..100_000).filter_map(|i| first.choose((f64::from(i) * 0.618_033_988_75).fract())) {
            importance.count(source.element, source.back, if source.element < 576 { 0 } else { 3 });
        }
        importance.learn();
        let learned = house(&importance);
        for (sources, room) in [(&first, 0.01), (&learned, 0.25)] {
            let n = 200_000;
            let (mut inside, mut flux) = (0, [0.0f64; 2]);
            for i in 0..n {
                let s = sources.choose((f64::from(i) * 0.618_033_988_75).fract()).expect("light");
                inside += u32::from(s.element >= 576);
                flux[usize::from(s.element >= 576)] += f64::from(s.flux.x) / f64::from(n);
            }
            let share = f64::from(inside) / f64::from(n);
            assert!(share > 0.9 * room && share < 0.99, "{share}");
            assert!((flux[0] / 576.0 - 1.0).abs() < 0.02 && (flux[1] / 5.76 - 1.0).abs() < 0.02, "{flux:?}");
        }
        assert!(first.share() == 0.9 && (0.5..0.85).contains(&learned.share()), "{}", learned.share());
    }

    #[test]
    fn what_was_learned_is_kept() {
        let elements = elements(100);
        let mut importance = Importance::new(&elements, &|e| if e < 50 { 1.0 } else { 0.3 });
        importance.count(3, false, 7);
        importance.learn();
        importance.count(99, true, 1);
        let mut again = Importance::new(&elements, &|_| 1.0);
        again.restore(&importance.state());
        assert_eq!(again.state(), importance.state());
        // Seven arrivals of one particle, beside eight expected of two.
        assert_eq!(again.at(0, 0), 0.5 * (7.0 + 4.0));
        let mut other = Importance::new(&elements[..20], &|_| 1.0);
        let before = other.state();
        other.restore(&importance.state());
        assert_eq!(other.state(), before);
    }

    #[test]
    fn darkness_has_no_sources() {
        let importance = Importance::new(&elements(10), &|_| 1.0);
        let dark = Sources::new(&importance, 1.0, &|_, _| Vec3::ZERO, Vec::new());
        assert!(dark.choose(0.5).is_none() && dark.share() == 0.0 && dark.pilots(&importance).is_empty());
        let broken = Sources::new(&importance, 1.0, &|_, _| Vec3::splat(f32::NAN), Vec::new());
        assert!(broken.choose(0.5).is_none());
        assert!(
            Sources::new(&Importance::new(&[], &|_| 1.0), 1.0, &|_, _| Vec3::ONE, Vec::new())
                .choose(0.0)
                .is_none()
        );
    }

    #[test]
    fn lessons_come_after_ever_more_particles() {
        assert_eq!([0, 8191, 8192, 40_000].map(next_lesson), [8192, 8192, 32_768, 131_072]);
    }
}
