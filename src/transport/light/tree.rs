//! Lights inside of a scene in a tree, chosen among by what each may bring to a surface: the lamp under a cupboard means
//! more to the wall behind it than a window of a hundred times its power (Conty Estévez & Kulla 2018).
//!
//! A choice goes down from the root, at each node to one of its two halves in proportion to a bound of what they bring.
//! The way to a light is kept as a trail of bits, so that its probability is the product of those along it (as in
//! pbrt-v4). Bounds are never below the truth: what brings light is chosen with a probability above zero.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::{DVec3, Vec3};

use super::Receiver;
use crate::math;

/// Cosines this far beyond a bound still count as within: the light's own code computes in f32.
const ROUNDING: f64 = 1e-5;
/// What a light counts at least that shines or arrives at a grazing angle, as a cosine.
const GRAZING: f64 = 1e-3;
/// Buckets along an axis between which a node may be halved (pbrt-v4).
const BUCKETS: usize = 12;
/// From this depth on nodes are halved by number: no trail is longer than 64 bits.
const UNBALANCED_MAX: u32 = 32;

/// Bounds of what one or several lights send out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bounds {
    /// Corners of a box around them.
    low: DVec3,
    high: DVec3,
    /// Axis and cosine of the half angle of a cone around the directions that they face.
    axis: DVec3,
    spread: f64,
    /// Cosine of the angle from such a direction up to which they shine.
    reach: f64,
    /// Radiant intensity, luminance, W/sr.
    strength: f64,
}

/// cos(max(0, a − b)) of two angles in [0, π] by their cosines.
fn cosine_of_rest(a: f64, b: f64) -> f64 {
    if a >= b {
        return 1.0;
    }
    let sine = |c: f64| (1.0 - c * c).max(0.0).sqrt();
    a * b + sine(a) * sine(b)
}

impl Bounds {
    /// Of a triangle that emits from its front, with unit `normal`.
    pub fn of_triangle(corners: [Vec3; 3], normal: Vec3, strength: f64) -> Self {
        let [a, b, c] = corners.map(|p| p.as_dvec3());
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        Self { low, high, axis: normal.as_dvec3(), spread: 1.0, reach: 0.0, strength }
    }

    /// Of a point.
    pub fn of_point(position: Vec3, strength: f64) -> Self {
        let p = position.as_dvec3();
        Self { low: p, high: p, axis: DVec3::Z, spread: -1.0, reach: 0.0, strength }
    }

    /// Of a spot along the unit `axis`, whose light falls off between two angles.
    pub fn of_spot(position: Vec3, axis: Vec3, inner: f32, outer: f32, strength: f64) -> Self {
        let (inner, outer) = (f64::from(inner).clamp(0.0, PI), f64::from(outer).clamp(0.0, PI));
        let reach = math::cos((outer - inner).abs());
        let (axis, spread) = (axis.as_dvec3(), math::cos(inner.min(outer)));
        Self { axis, spread, reach, ..Self::of_point(position, strength) }
    }

    fn centre(&self) -> DVec3 {
        self.low + 0.5 * (self.high - self.low)
    }

    /// Of both together.
    fn with(&self, other: &Self) -> Self {
        let (axis, spread) = cone_around((self.axis, self.spread), (other.axis, other.spread));
        Self {
            low: self.low.min(other.low),
            high: self.high.max(other.high),
            axis,
            spread,
            reach: self.reach.min(other.reach),
            strength: self.strength + other.strength,
        }
    }

    /// A bound of the irradiance on a surface, up to a factor that is the same for all; 0 only where nothing arrives.
    fn importance(&self, at: &Receiver) -> f64 {
        let to = self.centre() - at.point.as_dvec3();
        let (squared, radius) = (to.length_squared(), 0.25 * (self.high - self.low).length_squared());
        if !(squared > radius) {
            // Inside of a sphere around them, where they may be in any direction.
            return self.strength / radius.max(1e-80);
        }
        let wi = to / squared.sqrt();
        let extent = (1.0 - radius / squared).max(0.0).sqrt();
        let sent = cosine_of_rest(cosine_of_rest(-wi.dot(self.axis), self.spread), extent);
        let received = cosine_of_rest(wi.dot(at.normal.as_dvec3()), extent);
        if sent < self.reach - ROUNDING || received < -ROUNDING {
            return 0.0;
        }
        self.strength * sent.max(GRAZING) * received.max(GRAZING) / squared
    }

    /// How much light such bounds promise to all the directions and places that they hold: Conty Estévez & Kulla's
    /// surface area orientation heuristic, without the factor for thin boxes.
    fn cost(&self) -> f64 {
        let d = self.high - self.low;
        let area = 2.0 * (d.x * d.y + d.y * d.z + d.z * d.x);
        let (spread, reach) =
            (math::acos(self.spread.clamp(-1.0, 1.0)), math::acos(self.reach.clamp(-1.0, 1.0)));
        let (all, s) = ((spread + reach).min(PI), math::sin(spread));
        let directions = TAU * (1.0 - self.spread)
            + FRAC_PI_2 * (2.0 * all * s - math::cos(spread - 2.0 * all) - 2.0 * spread * s + self.spread);
        self.strength * directions.max(0.0) * area
    }
}

/// The least cone around two, each an axis and the cosine of its half angle.
fn cone_around((a, cos_a): (DVec3, f64), (b, cos_b): (DVec3, f64)) -> (DVec3, f64) {
    let [angle_a, angle_b] = [cos_a, cos_b].map(|c| math::acos(c.clamp(-1.0, 1.0)));
    let between = math::acos(a.dot(b).clamp(-1.0, 1.0));
    if (between + angle_b).min(PI) <= angle_a {
        return (a, cos_a);
    }
    if (between + angle_a).min(PI) <= angle_b {
        return (b, cos_b);
    }
    let angle = 0.5 * (angle_a + between + angle_b);
    let Some(across) = (b - a * a.dot(b)).try_normalize().filter(|_| angle < PI) else { return (a, -1.0) };
    let (s, c) = math::sin_cos(angle - angle_a);
    (a * c + across * s, math::cos(angle))
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    /// Place of the light among all.
    Light(u32),
    /// The first half follows; this is where the second one is.
    Inner(u32),
}

/// Lights inside of a scene, each with its place among all.
#[derive(Clone, Debug, Default)]
pub(super) struct LightTree {
    nodes: Vec<(Bounds, Kind)>,
    /// Per light the way to it: bit d tells whether the second half is taken at depth d. `None` for those that nothing
    /// is known of and that are never chosen.
    trails: Vec<Option<u64>>,
}

impl LightTree {
    /// A tree of lights in their order; `None`, and what is not finite, has no place in it.
    pub fn new(lights: impl Iterator<Item = Option<Bounds>>) -> Self {
        let mut tree = Self::default();
        let mut all = Vec::new();
        for bounds in lights {
            let usable = bounds.filter(|b| {
                b.low.is_finite() && b.high.is_finite() && b.strength > 0.0 && b.strength.is_finite()
            });
            all.extend(usable.map(|b| (b, tree.trails.len() as u32)));
            tree.trails.push(None);
        }
        if !all.is_empty() {
            tree.build(&mut all, 0, 0);
        }
        tree
    }

    fn build(&mut self, lights: &mut [(Bounds, u32)], trail: u64, depth: u32) {
        if let [(bounds, light)] = *lights {
            self.trails[light as usize] = Some(trail);
            self.nodes.push((bounds, Kind::Light(light)));
            return;
        }
        let middle = halve(lights, depth < UNBALANCED_MAX);
        let node = self.nodes.len();
        self.nodes.push((lights[0].0, Kind::Inner(0)));
        let (first, second) = lights.split_at_mut(middle);
        self.build(first, trail, depth + 1);
        let other = self.nodes.len();
        self.build(second, trail | 1 << depth, depth + 1);
        self.nodes[node] = (self.nodes[node + 1].0.with(&self.nodes[other].0), Kind::Inner(other as u32));
    }

    /// The light for `u` in [0, 1) and its probability; `None` where the half that was chosen brings nothing.
    pub fn choose(&self, at: &Receiver, mut u: f64) -> Option<(usize, f64)> {
        let (mut node, mut probability) = (0, 1.0);
        loop {
            match self.nodes.get(node)?.1 {
                Kind::Light(light) => return Some((light as usize, probability)),
                Kind::Inner(second) => {
                    let p = self.second_share(node, second as usize, at)?;
                    if u < 1.0 - p {
                        (node, probability, u) = (node + 1, probability * (1.0 - p), u / (1.0 - p));
                    } else {
                        (node, probability, u) = (second as usize, probability * p, (u - (1.0 - p)) / p);
                    }
                    u = u.min(1.0f64.next_down());
                }
            }
        }
    }

    /// The probability with which [`Self::choose`] names a light.
    pub fn probability(&self, light: usize, at: &Receiver) -> f64 {
        let Some(&Some(mut trail)) = self.trails.get(light) else { return 0.0 };
        let (mut node, mut probability) = (0, 1.0);
        while let Kind::Inner(second) = self.nodes[node].1 {
            let Some(p) = self.second_share(node, second as usize, at) else { return 0.0 };
            if trail & 1 == 1 {
                (node, probability) = (second as usize, probability * p);
            } else {
                (node, probability) = (node + 1, probability * (1.0 - p));
            }
            trail >>= 1;
        }
        probability
    }

    /// Probability of a node's second half; `None` where neither brings anything.
    fn second_share(&self, node: usize, second: usize, at: &Receiver) -> Option<f64> {
        let [a, b] = [node + 1, second].map(|i| self.nodes[i].0.importance(at));
        // Never so near to 0 or 1 that rounding makes it that.
        if !(a + b > 0.0) {
            return None;
        }
        Some(match (a > 0.0, b > 0.0) {
            (true, true) => (b / (a + b)).clamp(1e-12, 1.0 - 1e-12),
            (_, second) => f64::from(u8::from(second)),
        })
    }
}

/// Orders lights so that the halves before and after the returned place promise the least, or, where no place does or
/// they shall be `balanced`, are halves in number.
fn halve(lights: &mut [(Bounds, u32)], by_cost: bool) -> usize {
    let centres = || lights.iter().map(|(b, _)| b.centre());
    let low = centres().fold(DVec3::INFINITY, DVec3::min);
    let extent = centres().fold(DVec3::NEG_INFINITY, DVec3::max) - low;
    let all = lights.iter().map(|(b, _)| *b).reduce(|a, b| a.with(&b));
    let size = all.map_or(DVec3::ONE, |b| b.high - b.low);
    let bucket = |b: &Bounds, axis: usize| {
        let x = (b.centre()[axis] - low[axis]) / extent[axis] * BUCKETS as f64;
        (x as usize).min(BUCKETS - 1)
    };
    let mut best: Option<(f64, usize, usize)> = None;
    for axis in (0..3).filter(|&axis| by_cost && extent[axis] > 0.0) {
        let mut buckets = [None::<Bounds>; BUCKETS];
        for (b, _) in lights.iter() {
            let sum = &mut buckets[bucket(b, axis)];
            *sum = Some(sum.map_or(*b, |s| s.with(b)));
        }
        let cost = |part: &[Option<Bounds>]| {
            part.iter().flatten().copied().reduce(|a, b| a.with(&b)).map(|b| b.cost())
        };
        // Cuts across a long box are better than such that leave slices.
        let slices = size.max_element() / size[axis].max(f64::MIN_POSITIVE);
        for at in 1..BUCKETS {
            let (before, after) = buckets.split_at(at);
            let (Some(a), Some(b)) = (cost(before), cost(after)) else { continue };
            let total = (a + b) * slices;
            if best.is_none_or(|(least, ..)| total < least) {
                best = Some((total, axis, at));
            }
        }
    }
    let by_place = |axis: usize| {
        move |(a, i): &(Bounds, u32), (b, j): &(Bounds, u32)| {
            a.centre()[axis].total_cmp(&b.centre()[axis]).then(i.cmp(j))
        }
    };
    if let Some((cost, axis, at)) = best
        && cost > 0.0
        && cost.is_finite()
    {
        lights.sort_by(by_place(axis));
        return lights.partition_point(|(b, _)| bucket(b, axis) < at);
    }
    let axis = (0..3).max_by(|&i, &j| extent[i].total_cmp(&extent[j])).unwrap_or(0);
    lights.sort_by(by_place(axis));
    lights.len() / 2
}

#[cfg(test)]
mod tests;
