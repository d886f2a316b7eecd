//! The filter of stored light: halves that guard each other (à-trous wavelets, Dammertz et al. 2010; halves as in NFOR,
//! Bitterli et al. 2016), on the surfaces themselves.
//!
//! As [`crate::splatting::filter`] does for pixels. Every value exists in two independent halves; how alike two sites are is
//! told by the other half than the one that is smoothed, so that noise does not choose its own company. A half's noise is half of the
//! squared difference of both, pooled.

use glam::Vec3;
use rayon::prelude::*;

use super::sites::{Links, NONE, Site, Sites};
use crate::image::luminance;
use crate::math;

/// Parts of light that are smoothed apart, each with edges of its own: see [`super::gathered`].
pub const PARTS: usize = 3;
/// The one of them that particles bring: to a few sites much of it, to most sites nothing.
const CAUSTIC: usize = 2;
/// Passes that smooth; each has taps twice as far apart as the one before, the first a width.
const LEVELS: usize = 6;
/// The pass that takes peaks away. As many as the levels follow, which spread what they held.
const PEAKS: usize = LEVELS + 1;
/// The last pass.
const LAST: usize = PEAKS + LEVELS;
/// Taps but for the middle one: a binomial kernel without its corners.
const TAPS: usize = 12;
/// Of these, those right beside it.
const BESIDE: usize = 8;
/// Weights of those straight ahead, of those between two ways, and of those twice as far.
const WEIGHTS: [f32; 3] = [0.25, 0.167, 0.0625];
/// Weight of the middle.
const MIDDLE: f32 = 0.375;
/// All weights together.
const WHOLE: f32 = MIDDLE + 4.0 * (WEIGHTS[0] + WEIGHTS[1] + WEIGHTS[2]);
/// A standard error below this share of a value is not smoothed away: nobody sees it.
const CLEAN: f32 = 2e-3;
/// Values are alike within so many squares of their noise, as five in six are that differ by noise alone.
const LIKE: f32 = 2.0;
/// Variance of a half at most, in squares of the light around.
const NOISE_MAX: f32 = 16.0;
/// Exponents from which on a weight is nothing.
const NOTHING: f32 = 20.0;

/// One part of the light of a site.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Noisy {
    /// By half.
    pub halves: [Vec3; 2],
    /// Variance of the luminance of each.
    pub variance: f32,
}

impl Noisy {
    /// Two estimates; what they differ by is all that is known of their noise.
    pub fn new(halves: [Vec3; 2]) -> Self {
        Self { halves, variance: 0.5 * luminance(halves[0] - halves[1]).powi(2) }
    }

    /// Mean of both halves.
    pub fn mean(&self) -> Vec3 {
        (self.halves[0] + self.halves[1]) * 0.5
    }

    fn is_clean(&self) -> bool {
        self.variance <= (CLEAN * luminance(self.mean())).powi(2)
    }
}

/// The parts of the light of a site.
pub type Parts = [Noisy; PARTS];
/// Of each part what a site has too much.
type Excess = [Vec3; PARTS];

/// What a filter came to.
#[derive(Clone, Debug, Default)]
pub struct Smoothed {
    /// The sites that anything is known of, in ascending order.
    pub known: Vec<u32>,
    /// Their light, in this order.
    pub parts: Vec<Parts>,
}

/// A filter under way. It goes over those sites alone that anything is known of, by numbers of their own: of the first rounds of a
/// bake these are few.
#[derive(Clone, Debug)]
pub struct Smoothing {
    /// Which of all sites they are.
    known: Vec<u32>,
    surface: Surface,
    from: Vec<Parts>,
    /// Luminance of both halves of each, in the pass that goes on.
    lights: Vec<[[f32; 2]; PARTS]>,
    /// What the pass that goes on makes of the active ones, in their order.
    to: Vec<Parts>,
    /// Which sites tell others anything: those with light.
    telling: Vec<bool>,
    /// The sites that a pass may change: those with neighbours at the distance of the last one; where there were none, there
    /// are none further away.
    active: Vec<u32>,
    /// Which of them have some at that of the pass that goes on.
    reaching: Vec<bool>,
    /// Whether particles brought anything.
    has_caustics: bool,
    /// What peaks held that were taken away, and what the active ones have of it in the pass that goes on; empty before.
    excess: Vec<Excess>,
    spread: Vec<Excess>,
    /// Passes done: pooling, the levels, peaks, the levels again for what these held.
    pass: usize,
    /// Per site those at the distance of taps, of the pass that goes on.
    hops: Vec<Links>,
}

/// The known sites, and those of them that lie beside each.
#[derive(Clone, Debug)]
struct Surface {
    sites: Vec<Site>,
    links: Vec<Links>,
}

impl Surface {
    fn new(sites: &Sites, known: &[u32]) -> Self {
        let mut number = vec![NONE; sites.all().len()];
        known.iter().zip(0..).for_each(|(&i, k)| number[i as usize] = k);
        let linked =
            |&i: &u32| sites.links_of(i).map(|other| number.get(other as usize).copied().unwrap_or(NONE));
        Self {
            sites: known.iter().map(|&i| sites.all()[i as usize]).collect(),
            links: known.par_iter().map(linked).collect(),
        }
    }
}

/// What a pass looks at around a site.
#[derive(Clone, Copy)]
struct Around<'a> {
    surface: &'a Surface,
    telling: &'a [bool],
    from: &'a [Parts],
    lights: &'a [[[f32; 2]; PARTS]],
    hops: &'a [Links],
    has_caustics: bool,
}

impl Smoothing {
    /// Of what was gathered at the sites that are known, in ascending order; the others tell these nothing.
    pub fn new(sites: &Sites, known: Vec<u32>, gathered: Vec<Parts>) -> Self {
        Self {
            surface: Surface::new(sites, &known),
            has_caustics: gathered.iter().any(|parts| parts[CAUSTIC].halves != [Vec3::ZERO; 2]),
            from: gathered,
            lights: Vec::new(),
            to: Vec::new(),
            telling: vec![true; known.len()],
            active: (0..known.len() as u32).collect(),
            reaching: Vec::new(),
            excess: Vec::new(),
            spread: Vec::new(),
            pass: 0,
            hops: Vec::new(),
            known,
        }
    }

    /// Does some more of it, `count` sites about. What comes out once it is done.
    pub fn step(&mut self, count: usize) -> Option<Smoothed> {
        if self.pass > PEAKS {
            return self.spread_excess(count);
        }
        let done = self.to.len();
        let end = done.saturating_add(count).min(self.active.len());
        if done == 0 {
            self.hops = match self.pass {
                1 => self.surface.links.clone(),
                0 | PEAKS => doubled(&self.surface.links),
                _ => doubled(&self.hops),
            };
            self.lights = lights_of(&self.from);
        }
        let pass = self.pass;
        let around = self.around();
        let changed = self.active[done..end].par_iter().map(|&i| i as usize).map(|i| match pass {
            0 if around.is_dark(i) => (around.from[i], false),
            0 => (around.pooled(i), true),
            PEAKS => (around.without_peak(i), true),
            _ => around.smoothed(i),
        });
        let (parts, reaching): (Vec<Parts>, Vec<bool>) = changed.unzip();
        self.to.extend(parts);
        self.reaching.extend(reaching);
        if self.to.len() < self.active.len() {
            return None;
        }
        if pass == PEAKS {
            self.excess = vec![Excess::default(); self.from.len()];
        }
        for (&i, after) in self.active.iter().zip(&self.to) {
            let before = std::mem::replace(&mut self.from[i as usize], *after);
            if pass == PEAKS {
                self.excess[i as usize] = std::array::from_fn(|k| before[k].mean() - after[k].mean());
            }
        }
        if pass == 0 {
            // The dark tells the light beside it nothing.
            self.telling.clone_from(&self.reaching);
        }
        let mut reaching = std::mem::take(&mut self.reaching).into_iter();
        self.active.retain(|_| reaching.next() == Some(true));
        self.to.clear();
        self.pass += 1;
        if self.pass > PEAKS {
            self.active = (0..self.telling.len() as u32).filter(|i| self.telling[*i as usize]).collect();
            if self.excess.iter().all(|excess| *excess == Excess::default()) {
                return Some(self.done());
            }
        }
        None
    }

    /// Spreads what peaks held over what is as bright around them: cut away, it would be missing everywhere.
    fn spread_excess(&mut self, count: usize) -> Option<Smoothed> {
        let done = self.spread.len();
        let end = done.saturating_add(count).min(self.active.len());
        if done == 0 {
            self.hops = if self.pass == PEAKS + 1 { self.surface.links.clone() } else { doubled(&self.hops) };
            if self.pass == PEAKS + 1 {
                self.lights = lights_of(&self.from);
            }
        }
        let (around, excess) = (self.around(), &self.excess);
        let spread = self.active[done..end].par_iter().map(|&i| around.spread(i as usize, excess));
        let spread: Vec<Excess> = spread.collect();
        self.spread.extend(spread);
        if self.spread.len() < self.active.len() {
            return None;
        }
        for (&i, spread) in self.active.iter().zip(&self.spread) {
            self.excess[i as usize] = *spread;
        }
        self.spread.clear();
        self.pass += 1;
        if self.pass <= LAST {
            return None;
        }
        for (part, excess) in self.from.iter_mut().flatten().zip(self.excess.iter().flatten()) {
            part.halves = part.halves.map(|half| half + *excess);
        }
        Some(self.done())
    }

    fn around(&self) -> Around<'_> {
        let Self { surface, telling, from, lights, hops, has_caustics, .. } = self;
        Around { surface, telling, from, lights, hops, has_caustics: *has_caustics }
    }

    /// What comes out.
    fn done(&mut self) -> Smoothed {
        Smoothed { known: std::mem::take(&mut self.known), parts: std::mem::take(&mut self.from) }
    }
}

/// Luminance of both halves of each part of sites.
fn lights_of(parts: &[Parts]) -> Vec<[[f32; 2]; PARTS]> {
    parts.par_iter().map(|parts| parts.map(|part| part.halves.map(luminance))).collect()
}

/// Links that reach twice as far.
fn doubled(links: &[Links]) -> Vec<Links> {
    let twice = |own: &Links| std::array::from_fn(|way| hop(links, own[way], way));
    links.par_iter().map(twice).collect()
}

/// The site that lies one link in a direction from another one, if there is one.
#[inline]
fn hop(links: &[Links], from: u32, way: usize) -> u32 {
    links.get(from as usize).map_or(NONE, |links| links[way])
}

/// Sites around one with weights: an array, since iterators in pieces took as long as what is done with them.
struct Taps {
    all: [(u32, f32); TAPS],
    count: usize,
}

impl Taps {
    #[inline]
    fn iter(&self) -> impl Iterator<Item = (usize, f32)> {
        self.all[..self.count].iter().map(|&(j, weight)| (j as usize, weight))
    }
}

impl Around<'_> {
    /// The telling sites around one with the weights of the kernel, at links of these.
    #[inline]
    fn taps(self, i: usize, links: &[Links]) -> Taps {
        let own = links[i];
        let [right, left, up, down] = own;
        // A corner of the surface may be in the way of one of both ways there.
        let between = |a: u32, way_b: usize, b: u32, way_a: usize| match hop(links, a, way_b) {
            NONE => hop(links, b, way_a),
            found => found,
        };
        let diagonal = [
            between(right, 2, up, 0),
            between(right, 3, down, 0),
            between(left, 2, up, 1),
            between(left, 3, down, 1),
        ];
        let far: Links = std::array::from_fn(|way| hop(links, own[way], way));
        let sites = &self.surface.sites;
        let site = &sites[i];
        let mut taps = Taps { all: [(0, 0.0); TAPS], count: 0 };
        for (found, weight) in [own, diagonal, far].into_iter().zip(WEIGHTS) {
            for j in found {
                if j != NONE && self.telling[j as usize] && site.goes_on_to(&sites[j as usize]) {
                    taps.all[taps.count] = (j, weight);
                    taps.count += 1;
                }
            }
        }
        taps
    }

    /// Whether no light was found at a site, nor at most of those around it: then it is dark there, and a wall or a shadow's
    /// edge that is near ends the light. Alone it may be chance.
    fn is_dark(self, i: usize) -> bool {
        let dark = |i: usize| self.from[i].iter().all(|part| part.halves == [Vec3::ZERO; 2]);
        if !dark(i) {
            return false;
        }
        let (mut all, mut none) = (0, 0);
        for (j, _) in self.taps(i, &self.surface.links).iter() {
            all += 1;
            none += usize::from(dark(j));
        }
        2 * none >= all
    }

    /// Light of all parts at a site.
    fn light(self, i: usize) -> f32 {
        0.5 * self.lights[i].as_flattened().iter().sum::<f32>()
    }

    /// What a site has too much of, spread: the darker of two takes the less of it, and gives as much as it takes.
    fn spread(self, i: usize, excess: &[Excess]) -> Excess {
        let own = self.light(i);
        let (mut sums, mut left) = (Excess::default(), 1.0);
        for (j, kernel) in self.taps(i, self.hops).iter() {
            let other = self.light(j);
            let brighter = own.max(other);
            if brighter > 0.0 {
                let weight = kernel / WHOLE * (own.min(other) / brighter);
                sums.iter_mut().zip(&excess[j]).for_each(|(sum, excess)| *sum += *excess * weight);
                left -= weight;
            }
        }
        sums.iter_mut().zip(&excess[i]).for_each(|(sum, excess)| *sum += *excess * left);
        sums
    }

    /// Variances as they are around a site.
    fn pooled(self, i: usize) -> Parts {
        let mut out = self.from[i];
        let mut sums = out.map(|part| part.variance * MIDDLE);
        let (mut total, mut around, mut count) = (MIDDLE, [0.0; TAPS], 0);
        for (j, weight) in self.taps(i, self.hops).iter() {
            total += weight;
            sums.iter_mut().zip(&self.from[j]).for_each(|(sum, part)| *sum += weight * part.variance);
            around[count] = self.light(j);
            count += 1;
        }
        // Beside a wall the noise of the light behind it is not that of the dark before it: a lower quartile is on this side.
        let around = &mut around[..count];
        around.sort_unstable_by(f32::total_cmp);
        let level = around.get(count / 4).map_or(0.0, |quartile| self.light(i).max(*quartile));
        let most = NOISE_MAX * level * level;
        out.iter_mut().zip(sums).for_each(|(part, sum)| part.variance = (sum / total).min(most));
        out
    }

    /// Whether a part is as sure as anybody sees. Where particles may come and none did is not: what comes to its neighbours by
    /// chance is meant for it as well, and would be lost.
    fn is_settled(self, part: usize, value: &Noisy) -> bool {
        value.is_clean() && !(part == CAUSTIC && self.has_caustics && value.variance == 0.0)
    }

    /// The mean of what is alike around a site, and whether there is anything at that distance.
    fn smoothed(self, i: usize) -> (Parts, bool) {
        let here = &self.from[i];
        if here.iter().enumerate().all(|(k, part)| self.is_settled(k, part)) {
            return (*here, true);
        }
        // Where no particle brought anything there is nothing to smooth of it.
        let parts = if self.has_caustics { PARTS } else { CAUSTIC };
        let mut found = false;
        let mut sums = [Sum::NOTHING; PARTS];
        let own = here.iter().zip(&self.lights[i]);
        for (j, weight) in self.taps(i, self.hops).iter() {
            found = true;
            let others = self.from[j].iter().zip(&self.lights[j]);
            for ((sum, own), other) in sums[..parts].iter_mut().zip(own.clone()).zip(others) {
                sum.add(own, other, weight / WHOLE);
            }
        }
        let mut out = *here;
        out.iter_mut()
            .zip(&sums)
            .enumerate()
            .filter(|(k, (part, _))| !self.is_settled(*k, part))
            .for_each(|(_, (part, sum))| *part = sum.with(part));
        (out, found)
    }

    /// No brighter than the brightest around: where few samples found a light by chance in both halves, they agree on a spot.
    /// Twice as far away, since a spot may be wider than a site; and right beside it, since of spots that lie so far from
    /// each other each would excuse the other one.
    fn without_peak(self, i: usize) -> Parts {
        let beside = self.taps(i, &self.surface.links);
        let beside = beside.iter().filter(|(_, weight)| *weight > WEIGHTS[2]);
        let limits = [self.brightest(beside, BESIDE), self.brightest(self.taps(i, self.hops).iter(), TAPS)];
        let mut out = self.from[i];
        for most in limits.into_iter().flatten() {
            for (part, most) in out.iter_mut().zip(most) {
                let light = luminance(part.mean());
                if light > most {
                    part.halves = part.halves.map(|half| half * (most / light));
                }
            }
        }
        out
    }

    /// The brightest of each part among taps, unless less than half of so many are there: the edge of a narrow thing may be
    /// its brightest place.
    fn brightest(self, taps: impl Iterator<Item = (usize, f32)>, of: usize) -> Option<[f32; PARTS]> {
        let (mut most, mut count) = ([0.0f32; PARTS], 0);
        for (j, _) in taps {
            most.iter_mut().zip(&self.lights[j]).for_each(|(most, [a, b])| *most = most.max(0.5 * (a + b)));
            count += 1;
        }
        (2 * count >= of).then_some(most)
    }
}

/// Sums of both halves over what is alike around a site.
///
/// A tap that is missing or unlike leaves its weight to the site itself, so that a site takes as much of another one as it
/// gives: light is moved, never made. Divided by the weights that there are, sites beside an edge would give more than they take;
/// and a bright site is an edge for the other half, beside which its own light is spread but which it does not come to.
struct Sum {
    values: [Vec3; 2],
    weights: [f32; 2],
    variances: [f32; 2],
}

impl Sum {
    const NOTHING: Self = Self { values: [Vec3::ZERO; 2], weights: [0.0; 2], variances: [0.0; 2] };

    /// How noisy the other is decides nothing: bright samples are the noisy ones, and the mean would be too dark.
    #[inline]
    fn add(
        &mut self,
        (own, own_lights): (&Noisy, &[f32; 2]),
        (other, lights): (&Noisy, &[f32; 2]),
        kernel: f32,
    ) {
        let noise = own.variance + other.variance;
        for half in 0..2 {
            let guard = 1 - half;
            let squared = (lights[guard] - own_lights[guard]).powi(2);
            let beyond = (squared - LIKE * noise).max(0.0);
            let likeness = match beyond / noise {
                _ if beyond <= 0.0 => 1.0,
                exponent if exponent < NOTHING => math::exp(-exponent),
                // Also where there is no noise.
                _ => continue,
            };
            let weight = kernel * likeness;
            self.values[half] += other.halves[half] * weight;
            self.weights[half] += weight;
            self.variances[half] += weight * weight * other.variance;
        }
    }

    fn with(&self, own: &Noisy) -> Noisy {
        let left = self.weights.map(|weight| 1.0 - weight);
        let of = |half: usize| own.halves[half] * left[half] + self.values[half];
        let variance = |half: usize| self.variances[half] + left[half] * left[half] * own.variance;
        Noisy { halves: [of(0), of(1)], variance: 0.5 * (variance(0) + variance(1)) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illumination::test_scenes::floor;
    use crate::rng::Stream;

    const SIDE: usize = 64;

    /// `signal` with noise of this deviation in each half.
    fn noisy(signal: impl Fn(usize, usize) -> f32, deviation: f32, seed: u64) -> Vec<Parts> {
        let part = |i: usize| {
            let half = |half: u64| {
                let noise = 12f32.sqrt() * (Stream::new(seed, i as u64, half).next_f32() - 0.5);
                Vec3::splat(signal(i % SIDE, i / SIDE) + deviation * noise)
            };
            [Noisy::new([half(0), half(1)]), Noisy::default(), Noisy::default()]
        };
        (0..SIDE * SIDE).map(part).collect()
    }

    /// In pieces, as a walk does it.
    fn filtered(parts: Vec<Parts>) -> Vec<Parts> {
        let known = (0..parts.len() as u32).collect();
        let mut smoothing = Smoothing::new(&Sites::of(floor(SIDE)), known, parts);
        loop {
            if let Some(Smoothed { parts, .. }) = smoothing.step(1000) {
                return parts;
            }
        }
    }

    fn smoothed(parts: Vec<Parts>) -> Vec<f32> {
        filtered(parts).iter().map(|p| p[0].mean().x).collect()
    }

    fn deviation(values: impl Iterator<Item = f32>) -> f32 {
        let (sum, n) = values.fold((0.0, 0), |(sum, n), v| (sum + v * v, n + 1));
        (sum / n as f32).sqrt()
    }

    #[test]
    fn noise_is_smoothed_away_and_told() {
        let parts = noisy(|_, _| 1.0, 0.5, 1);
        let out = filtered(parts);
        let left = deviation(out.iter().map(|p| p[0].mean().x - 1.0));
        let told = deviation(out.iter().map(|p| (0.5 * p[0].variance).sqrt()));
        assert!(left < 0.08 * 0.5, "{left}");
        // It knows nothing of how alike halves are by chance.
        assert!((0.1..3.0).contains(&(told / left)), "{told} {left}");
    }

    #[test]
    fn edges_that_samples_show_stay() {
        let edge = |x: usize, _| if x < SIDE / 2 { 0.2 } else { 1.0 };
        let out = smoothed(noisy(edge, 0.1, 2));
        let off = deviation(out.iter().enumerate().map(|(i, v)| v - edge(i % SIDE, 0)));
        assert!(off < 0.03, "{off}");
    }

    /// Half of the floor is behind a wall: not even a trace of light comes there, however noisy it is beside it.
    #[test]
    fn the_dark_stays_dark() {
        let mut parts = noisy(|_, _| 1.0, 0.5, 5);
        for (i, part) in parts.iter_mut().enumerate() {
            // Some of the light beside it was missed as well.
            if i % SIDE >= SIDE / 2 || i % 7 == 0 {
                *part = Parts::default();
            }
        }
        let out = smoothed(parts);
        assert!((0..SIDE * SIDE).filter(|i| i % SIDE >= SIDE / 2).all(|i| out[i] == 0.0));
        let lit = (0..SIDE * SIDE).filter(|i| i % SIDE < SIDE / 2 - 2).map(|i| out[i]);
        let mean = lit.clone().sum::<f32>() / lit.clone().count() as f32;
        assert!((mean / (6.0 / 7.0) - 1.0).abs() < 0.1 && lit.clone().all(|v| v > 0.0), "{mean}");
    }

    /// Both halves found a light by chance: they agree on a spot, and nothing around does. A lit square stays.
    #[test]
    fn fireflies_go_and_what_is_wider_stays() {
        let light = |x: usize, y: usize| match (x, y) {
            (10, 10) => 9.0,
            (40..44, 40..44) => 9.0,
            _ => 1.0,
        };
        let out = smoothed(noisy(light, 0.0, 3));
        // What the spot held lies around it, and nowhere stands out.
        let most = (0..SIDE * SIDE).filter(|i| !(40..44).contains(&(i % SIDE))).map(|i| out[i]);
        let most = most.fold(0.0, f32::max);
        assert!(most < 1.05, "{most}");
        let sum = out.iter().map(|v| v - 1.0).sum::<f32>();
        assert!((sum - 17.0 * 8.0).abs() < 0.1, "{sum}");
        assert!((0..16).all(|i| (out[(40 + i / 4) * SIDE + 40 + i % 4] - 9.0).abs() < 0.01));
    }

    /// Spots that lie as far from each other as is looked for brighter ones; lines as narrow stay.
    #[test]
    fn spots_do_not_excuse_each_other() {
        let is_spot =
            |x: usize, y: usize| [(10, 10), (12, 10), (10, 12), (14, 14), (18, 14)].contains(&(x, y));
        let light = |x: usize, y: usize| match (x, y) {
            _ if is_spot(x, y) => 3.0,
            (40, 8..56) => 3.0,
            (x, y) if x < 40 && y >= 30 && x + 25 == y => 3.0,
            _ => 1.0,
        };
        let out = smoothed(noisy(light, 0.0, 4));
        let spots = (0..SIDE * SIDE).filter(|i| is_spot(i % SIDE, i / SIDE)).map(|i| out[i]);
        assert!(spots.fold(0.0, f32::max) < 1.05);
        assert!((9..55).all(|y| out[y * SIDE + 40] > 2.95));
        assert!((33..60).all(|y| out[y * SIDE + y - 25] > 2.95));
        let all = (0..SIDE * SIDE).map(|i| light(i % SIDE, i / SIDE)).sum::<f32>();
        assert!((out.iter().sum::<f32>() / all - 1.0).abs() < 1e-4);
    }

    /// One particle for a hundred sites in each half: they spread, and what they bring stays.
    #[test]
    fn what_few_particles_bring_is_not_lost() {
        let parts = (0..SIDE * SIDE).map(|i| {
            let brings = |half: u64| {
                let found = Stream::new(7, i as u64, half).next_f32() < 0.01;
                if found { Vec3::splat(100.0) } else { Vec3::ZERO }
            };
            [Noisy::default(), Noisy::new([Vec3::ONE; 2]), Noisy::new([brings(0), brings(1)])]
        });
        let parts: Vec<Parts> = parts.collect();
        let mean = |parts: &[Parts]| {
            parts.iter().map(|p| luminance(p[CAUSTIC].mean())).sum::<f32>() / parts.len() as f32
        };
        let before = mean(&parts);
        let out = filtered(parts);
        assert!((mean(&out) / before - 1.0).abs() < 0.02, "{} of {before}", mean(&out));
        let off = deviation(out.iter().map(|p| luminance(p[CAUSTIC].mean()) - before));
        assert!(off < before, "{off} of {before}");
    }

    #[test]
    fn without_noise_nothing_changes() {
        let ramp = |x: usize, y: usize| 0.1 + 0.01 * x as f32 + if y > 40 { 1.0 } else { 0.0 };
        let out = smoothed(noisy(ramp, 0.0, 3));
        assert!(out.iter().enumerate().all(|(i, v)| *v == ramp(i % SIDE, i / SIDE)));
    }

    #[test]
    fn what_is_not_known_tells_nothing() {
        let is_hole = |i: usize| (20..24).contains(&(i % SIDE)) && (20..24).contains(&(i / SIDE));
        let known: Vec<u32> = (0..(SIDE * SIDE) as u32).filter(|i| !is_hole(*i as usize)).collect();
        let all = noisy(|_, _| 1.0, 0.3, 4);
        let parts = known.iter().map(|i| all[*i as usize]).collect();
        let mut smoothing = Smoothing::new(&Sites::of(floor(SIDE)), known.clone(), parts);
        let out = loop {
            if let Some(out) = smoothing.step(1000) {
                break out;
            }
        };
        assert_eq!(out.known, known);
        assert!(deviation(out.parts.iter().map(|p| p[0].mean().x - 1.0)) < 0.03);
    }
}
