//! From what a bake has gathered to irradiance with its error.

use glam::{Vec3, Vec4};
use rayon::prelude::*;

use super::bake::{BLOCK, Baker};
use super::clusters::ClusterTree;
use super::density::{Bandwidth, Estimate, estimate};
use super::smooth_direct::{Sides, smoothed};
use super::stored::{Illumination, Summary, Value};
use crate::image::luminance;
use crate::rng::Stream;

/// Elements that decide on the bandwidth.
const PILOTS: usize = 3000;
/// Neighbours in the tree that are estimated one after the other, each from the radius of the one before.
const RUN: u32 = 4096;
/// Elements share a fit within this share of the kernel's radius, where their normals are within the angle of this
/// cosine, 0.15 rad. The windows then overlap by 90 %.
const SHARED: (f32, f32) = (0.1, 0.988_771_1);
/// The same for a first picture: on leaves and ornaments 0.4 rad is all that a second allows.
const SHARED_COARSELY: (f32, f32) = (0.25, 0.921);
/// Direct light noisier than this share of itself is smoothed.
const DIRECT_NOISE: f32 = 0.03;
/// Rays that decide whether an element lies inside a body.
const BURIED_RAYS: u64 = 8;

/// What the irradiance at one side of an element is made of.
#[derive(Clone, Copy, Debug)]
struct Parts {
    direct: Vec3,
    direct_variance: f32,
    particles: Estimate,
}

impl Parts {
    fn value(&self) -> Vec4 {
        let error = (self.direct_variance + self.particles.variance).sqrt();
        (self.direct + self.particles.irradiance).extend(error)
    }
}

/// How wide kernels are, and what that costs.
struct ChosenBandwidth {
    bandwidth: Bandwidth,
    /// Mean squared bias of the luminance.
    bias_squared: f64,
    /// Radius to start a search from.
    guess: f32,
}

/// Where estimates can be made, with the sums of what arrived.
struct Prepared {
    tree: ClusterTree,
    /// Elements in it.
    open: usize,
    stored: u64,
    bandwidth: ChosenBandwidth,
    /// Per block of elements whether its backs receive anything.
    lit_back: Vec<bool>,
}

impl Baker<'_> {
    /// Elements inside a body, such as the floor under a box: nothing ever arrives there, and from all
    /// directions the inside of something is seen. What was once seen to lie open is not asked again.
    fn update_buried(&mut self) {
        let (atlas, bins, direct, transport) = (&self.atlas, &self.bins, &self.direct, &self.transport);
        self.open.par_iter_mut().enumerate().filter(|(_, open)| !**open).for_each(|(i, open)| {
            let element = &atlas.elements[i];
            let buried = element.area > 0.0
                && bins.arrived(i as u32, false).count == 0.0
                && !direct[i][0].is_lit()
                && (0..BURIED_RAYS).all(|ray| {
                    let mut stream = Stream::new(0xb0d1, i as u64, ray);
                    transport.sees_inside(element.triangle, element.b1, element.b2, false, &mut stream)
                });
            *open = !buried;
        });
    }

    fn prepare(&mut self) -> Prepared {
        self.update_buried();
        // Geometry of the tree changes only while elements are found to lie open.
        let open = &self.open;
        let count = open.iter().filter(|&&o| o).count();
        let mut tree = match self.tree.take() {
            Some((before, tree)) if before == count => tree,
            _ => ClusterTree::build_where(&self.atlas.elements, &|e| open[e as usize]),
        };
        tree.update(&self.bins);
        let stored = self.bins.total_count();
        let lit_back = (0..self.atlas.elements.len().div_ceil(BLOCK))
            .into_par_iter()
            .map(|block| {
                let elements = block * BLOCK..((block + 1) * BLOCK).min(self.atlas.elements.len());
                let count = |back: bool| -> f32 {
                    elements.clone().map(|e| self.bins.arrived(e as u32, back).count).sum()
                };
                // Rounding lets one particle in a million slip out through an edge where walls meet.
                elements.clone().any(|e| self.direct[e][1].is_lit()) || count(true) > 1e-3 * count(false)
            })
            .collect();
        let bandwidth = self.bandwidth(&tree, stored);
        Prepared { tree, open: count, stored, bandwidth, lit_back }
    }

    /// Estimates of particles at the elements of a node of the tree, in its order, front and back.
    ///
    /// Elements much closer to each other than the kernel is wide share one fit, evaluated at each of them.
    fn estimate_node(&self, root: u32, with: &Prepared) -> Vec<[Estimate; 2]> {
        let elements = &self.atlas.elements;
        let (shared, cosine) = if self.coarse { SHARED_COARSELY } else { SHARED };
        let mut found = Vec::with_capacity(with.tree.range(root).len());
        let mut open = vec![(root, with.bandwidth.guess)];
        while let Some((node, mut guess)) = open.pop() {
            let members = &with.tree.order()[with.tree.range(node)];
            let bandwidth = &with.bandwidth.bandwidth;
            let needs_back = |e: &u32| with.lit_back[*e as usize / BLOCK];
            if let Some((center, radius)) = with
                .tree
                .as_element(node, cosine)
                .filter(|(_, radius)| *radius <= shared * bandwidth.radius_max)
            {
                let kernel = bandwidth.radius(&with.tree, &center, false, guess);
                guess = kernel;
                if radius <= shared * kernel {
                    let within =
                        |back| bandwidth.estimate_within(&with.tree, &center, back, kernel, self.emitted);
                    let front = within(false);
                    let back = if members.iter().any(needs_back) {
                        bandwidth.estimate(&with.tree, &center, true, kernel, self.emitted).0
                    } else {
                        Estimate::default()
                    };
                    let (x, y) = center.normal.any_orthonormal_pair();
                    found.extend(members.iter().map(|&e| {
                        let d = elements[e as usize].position - center.position;
                        let (u, v) = (d.dot(x), d.dot(y));
                        [front, back].map(|fit| Estimate { irradiance: fit.at(u, v), ..fit })
                    }));
                    continue;
                }
            }
            if let Some([first, second]) = with.tree.halves(node) {
                open.extend([(second, guess), (first, guess)]);
                continue;
            }
            for &e in members {
                let element = &elements[e as usize];
                let (front, kernel) = bandwidth.estimate(&with.tree, element, false, guess, self.emitted);
                guess = kernel;
                let back = if needs_back(&e) {
                    bandwidth.estimate(&with.tree, element, true, kernel, self.emitted).0
                } else {
                    Estimate::default()
                };
                found.push([front, back]);
            }
        }
        found
    }

    /// What is known of the sides of an element.
    fn parts(&self, e: u32, particles: [Estimate; 2], direct: Sides, with: &Prepared) -> [Option<Parts>; 2] {
        [0, 1].map(|side| {
            (side == 0 || with.lit_back[e as usize / BLOCK]).then(|| Parts {
                direct: direct[side].0,
                direct_variance: direct[side].1,
                particles: particles[side],
            })
        })
    }

    /// Direct light noisier than this share of itself is smoothed.
    fn direct_target(&self) -> f32 {
        DIRECT_NOISE.max(2.0 * self.settings.error.unwrap_or(0.0))
    }

    /// The irradiance from all that was gathered so far.
    pub fn illumination(&mut self) -> Illumination {
        let with = self.prepare();
        let order = with.tree.order();
        let estimates: Vec<[Estimate; 2]> = match with.stored {
            0 => vec![[Estimate::default(); 2]; order.len()],
            _ => {
                let nodes = with.tree.subtrees(RUN);
                let found: Vec<_> = nodes.par_iter().map(|&node| self.estimate_node(node, &with)).collect();
                found.into_iter().flatten().collect()
            }
        };
        let radius_max = 0.05 * self.diagonal;
        let direct: Vec<Sides> = if self.direct_rounds == 0 {
            vec![Sides::default(); order.len()]
        } else {
            let tree = with.tree.clone();
            smoothed(&self.atlas.elements, &self.direct, tree, radius_max, self.direct_target())
        };
        let mut values: Vec<[Option<Parts>; 2]> = vec![[None; 2]; self.atlas.elements.len()];
        for ((&e, particles), direct) in order.iter().zip(estimates).zip(direct) {
            values[e as usize] = self.parts(e, particles, direct, &with);
        }
        let summary = self.summary((0..values.len() as u32).zip(values.iter().copied()), &with);
        let side = |s: usize| values.iter().map(|v| v[s].map(|p| p.value())).collect::<Vec<Value>>();
        let map = Illumination::new(&self.atlas, side(0), side(1), summary);
        self.tree = Some((with.open, with.tree));
        map
    }

    /// What [`Self::illumination`] would say of itself, from some of the elements only: takes much less time.
    pub fn appraise(&mut self) -> Summary {
        let with = self.prepare();
        let target = self.direct_target();
        let order: Vec<u32> =
            with.tree.order().iter().copied().filter(|&e| self.watched[e as usize]).collect();
        let step = order.len().div_ceil(PILOTS).max(1);
        let values: Vec<(u32, [Option<Parts>; 2])> = order
            .par_iter()
            .step_by(step)
            .map(|&e| {
                let element = &self.atlas.elements[e as usize];
                let mut guess = with.bandwidth.guess;
                let mut at = |back: bool| {
                    if with.stored == 0 || (back && !with.lit_back[e as usize / BLOCK]) {
                        return Estimate::default();
                    }
                    let bandwidth = &with.bandwidth.bandwidth;
                    let estimate;
                    (estimate, guess) = bandwidth.estimate(&with.tree, element, back, guess, self.emitted);
                    estimate
                };
                let particles = [at(false), at(true)];
                // Smoothing leaves the error that it aims at, no more.
                let direct = [0, 1].map(|side| {
                    let (mean, variance) = self.direct[e as usize][side].mean();
                    (mean, variance.min((target * luminance(mean)).powi(2)))
                });
                (e, self.parts(e, particles, direct, &with))
            })
            .collect();
        let summary = self.summary(values.into_iter(), &with);
        self.tree = Some((with.open, with.tree));
        summary
    }

    /// The bandwidth of least error: at some elements the estimate is compared with one from twice as many
    /// particles. Bias grows with the count k, variance falls with 1/k, so their sum is least where the
    /// squared bias is half of the variance (REFERENCE §6.2).
    fn bandwidth(&self, tree: &ClusterTree, stored: u64) -> ChosenBandwidth {
        let base = Bandwidth { coarse: self.coarse, ..Bandwidth::new(stored, self.diagonal) };
        let elements = &self.atlas.elements;
        let area: f32 = elements.iter().map(|e| e.area).sum();
        if tree.is_empty() || stored == 0 {
            return ChosenBandwidth { bandwidth: base, bias_squared: 0.0, guess: 0.0 };
        }
        let order: Vec<u32> = tree.order().iter().copied().filter(|&e| self.watched[e as usize]).collect();
        if order.is_empty() {
            return ChosenBandwidth { bandwidth: base, bias_squared: 0.0, guess: 0.0 };
        }
        let step = order.len().div_ceil(if self.coarse { PILOTS / 8 } else { PILOTS });
        let wide = Bandwidth { count: 2.0 * base.count, ..base };
        let pilots: Vec<(f64, f64, f64)> = order
            .par_iter()
            .step_by(step)
            .map(|&e| {
                let element = &elements[e as usize];
                let at = |b: &Bandwidth, guess: f32| {
                    let radius = b.radius(tree, element, false, guess);
                    let e = estimate(tree, element, false, radius, self.emitted);
                    (f64::from(luminance(e.irradiance)), f64::from(e.variance), radius)
                };
                let (narrow, v1, r1) = at(&base, base.radius_for(area, stored));
                let (wide, v2, r2) = at(&wide, 1.4 * r1);
                let area = f64::from(element.area);
                // Where the radius is at a limit nothing can be learned.
                if r2 < 1.2 * r1 {
                    return (0.0, area * v1, area);
                }
                (area * ((wide - narrow).powi(2) - (v1 - v2).abs()), area * v1, area)
            })
            .collect();
        let bias: f64 = pilots.iter().map(|p| p.0).sum();
        let variance: f64 = pilots.iter().map(|p| p.1).sum();
        let weight: f64 = pilots.iter().map(|p| p.2).sum();
        // Smooth scenes show none; then the radius is limited by their size.
        let bias = bias.max(0.004 * variance);
        let factor = if variance > 0.0 { (0.5 * variance / bias).cbrt().clamp(0.2, 8.0) } else { 1.0 };
        let bandwidth = Bandwidth { count: base.count * factor as f32, ..base };
        ChosenBandwidth {
            bandwidth,
            bias_squared: bias / weight * factor * factor,
            guess: bandwidth.radius_for(area, stored),
        }
    }

    fn summary(&self, values: impl Iterator<Item = (u32, [Option<Parts>; 2])>, with: &Prepared) -> Summary {
        let (mut weight, mut energy, mut surface) = (0.0f64, 0.0f64, 0.0f64);
        let (mut direct, mut particles) = (0.0f64, 0.0f64);
        let mut mean = [0.0f64; 3];
        for (e, sides) in values {
            let area = f64::from(self.atlas.elements[e as usize].area);
            if !self.watched[e as usize] {
                continue;
            }
            surface += area;
            for parts in sides.iter().flatten() {
                let total = parts.direct + parts.particles.irradiance;
                weight += area;
                energy += area * f64::from(luminance(total)).powi(2);
                direct += area * f64::from(parts.direct_variance);
                particles += area * f64::from(parts.particles.variance);
                for (sum, band) in mean.iter_mut().zip(total.to_array()) {
                    *sum += area * f64::from(band);
                }
            }
        }
        let relative = |squared: f64| if energy > 0.0 { (squared / energy).sqrt() as f32 } else { 0.0 };
        let bias = with.bandwidth.bias_squared * weight;
        Summary {
            particles: self.emitted,
            stored: with.stored,
            bounces: self.bounces,
            direct_rounds: self.direct_rounds,
            relative_error: relative(direct + particles + bias),
            direct_error: relative(direct),
            particle_error: relative(particles),
            bias_error: relative(bias),
            mean: mean.map(|m| (m / surface.max(1e-300)) as f32),
            has_indirect: with.stored > 0,
            notes: self.atlas.notes.clone(),
        }
    }
}
