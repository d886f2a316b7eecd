//! From what a bake has gathered to irradiance with its error.

use glam::{Vec3, Vec4};
use rayon::prelude::*;

use super::atlas::Element;
use super::bake::{BLOCK, Baker};
use super::bins::Arrived;
use super::clusters::{ClusterTree, Extent};
use super::density::{Bandwidth, Estimate};
use super::neighbourhood::{Neighbourhood, along_tangents};
use super::smooth_direct::{Sides, SmoothDirect};
use super::stored::{Illumination, Summary, Value};
use crate::image::luminance;
use crate::math;

/// Elements that decide on the bandwidth.
const PILOTS: usize = 3000;
/// Squared bias that counts at one of them at most, in units of its variance.
const BIAS_MAX: f64 = 6.0;
/// Neighbours in the tree that are estimated one after the other, each from the radius of the one before.
const RUN: u32 = 1024;
/// Elements share a fit within this share of the kernel's radius, where their normals are within the angle of this
/// cosine, 0.15 rad. The windows then overlap by 90 %.
const SHARED: (f32, f32) = (0.1, 0.988_771_1);
/// The same for a first picture: on leaves and ornaments 0.4 rad is all that a second allows.
const SHARED_COARSELY: (f32, f32) = (0.25, 0.921);
/// Places at which a first picture estimates a dense mesh, about.
const PLACES_COARSELY: usize = 8 * 1024;
/// Particles in a mean that a first picture shows where it is cluttered.
const MEAN_COUNT: f32 = 64.0;
/// Elements within the first share of the kernel's radius read one neighbourhood, where their normals are within the
/// angle of this cosine, 0.4 rad; and those of small things, within the second share and 1 rad.
const TOGETHER: [(f32, f32); 2] = [(0.6, 0.921), (0.2, 0.54)];
/// In a hurry, where elements within this share of the kernel's radius found too much clutter, no part of them is asked
/// again.
const CLUTTERED: f32 = 0.3;
/// Direct light noisier than this share of itself is smoothed.
const DIRECT_NOISE: f32 = 0.03;
/// Elements brighter than so many times the median count less, as if they were not brighter.
const BRIGHT: f32 = 8.0;

/// Whether elements of this extent read one neighbourhood for kernels of `radius`.
pub(super) fn reads_one(extent: &Extent, radius: f32) -> bool {
    TOGETHER.iter().any(|&(share, cosine)| extent.reach <= share * radius && extent.cosine > cosine)
}

/// The mean irradiance of what arrived of `emitted` particles.
fn mean_of(sum: &Arrived, emitted: u64) -> Estimate {
    if sum.area <= 0.0 || emitted == 0 {
        return Estimate::default();
    }
    let per_flux = 1.0 / (sum.area * emitted as f32);
    let (irradiance, variance) = (per_flux * sum.flux, per_flux * per_flux * sum.square);
    Estimate { irradiance, variance, ..Estimate::default() }
}

/// What the irradiance at one side of an element is made of.
#[derive(Clone, Copy, Debug)]
struct Parts {
    direct: Vec3,
    direct_variance: f32,
    particles: Vec3,
    particle_variance: f32,
}

impl Parts {
    fn value(&self) -> Vec4 {
        let error = (self.direct_variance + self.particle_variance).sqrt();
        self.all().extend(error)
    }

    /// All irradiance.
    fn all(&self) -> Vec3 {
        self.direct + self.particles
    }
}

/// How wide kernels are, and what that costs.
struct ChosenBandwidth {
    bandwidth: Bandwidth,
    /// Mean squared bias of the luminance, as far as a smooth irradiance lets expect.
    bias_squared: f64,
    /// Radius to start a search from.
    guess: f32,
}

/// Where estimates can be made, with the sums of what arrived.
pub(super) struct Prepared {
    tree: ClusterTree,
    /// How far the bake was.
    emitted: u64,
    direct_rounds: u32,
    stored: u64,
    bandwidth: ChosenBandwidth,
    /// Mean squared bias of the luminance.
    bias_squared: f64,
    /// Per block of elements whether its backs receive anything.
    lit_back: Vec<bool>,
}

impl Prepared {
    pub(super) fn tree(&self) -> &ClusterTree {
        &self.tree
    }

    pub(super) fn stored(&self) -> u64 {
        self.stored
    }

    /// The estimate on the front of what `extent` describes, and the radius of its kernel.
    pub(super) fn estimate_at(
        &self,
        extent: &Extent,
        hood: &mut Neighbourhood,
        emitted: u64,
    ) -> (Estimate, f32) {
        let bandwidth = &self.bandwidth.bandwidth;
        bandwidth.focus(hood, &self.tree, extent, self.bandwidth.guess);
        bandwidth.estimate(hood, &extent.center, false, emitted)
    }
}

/// The last estimate in the making.
pub(super) struct Estimating {
    with: Prepared,
    smooth: Option<SmoothDirect>,
    /// Runs of neighbours, and what was found for the first of them.
    nodes: Vec<u32>,
    found: Vec<Vec<[Option<Parts>; 2]>>,
}

impl Baker<'_> {
    fn prepare(&mut self) -> Prepared {
        let before = match self.prepared.take() {
            Some(p) if p.emitted == self.emitted && p.direct_rounds == self.direct_rounds => return p,
            before => before,
        };
        let lit_back = self.lit_backs();
        let open = self.open_sides(&lit_back);
        let unchanged = open == self.open;
        self.open = open;
        let is_open = |e: u32| self.open[e as usize];
        let mut tree = match before {
            Some(p) if unchanged => p.tree,
            _ => match self.spare_tree.take() {
                // What is coarse lies in it without counting.
                Some(tree)
                    if (0..self.open.len()).all(|e| self.open[e] != [false; 2] || self.is_coarse(e)) =>
                {
                    tree
                }
                _ => ClusterTree::build_where(&self.atlas.elements, &|e| is_open(e) != [false; 2]),
            },
        };
        let stored = self.bins.total_count();
        tree.update_with(&|e| [self.arrived(e, false), self.arrived(e, true)], &is_open);
        let bandwidth = self.bandwidth(&tree, stored);
        let (emitted, direct_rounds) = (self.emitted, self.direct_rounds);
        let mut with = Prepared {
            bias_squared: bandwidth.bias_squared,
            tree,
            emitted,
            direct_rounds,
            stored,
            bandwidth,
            lit_back,
        };
        with.bias_squared = with.bias_squared.max(self.cross_validated_bias(&with));
        with
    }

    /// What arrived at one side of an element, and on which area.
    fn arrived(&self, e: u32, back: bool) -> Arrived {
        Arrived { area: self.atlas.elements[e as usize].opaque, ..self.bins.arrived(e, back) }
    }

    /// Estimates of particles at the elements of a node of the tree, in its order, front and back.
    fn estimate_node(
        &self,
        root: u32,
        with: &Prepared,
        coarse: bool,
        hood: &mut Neighbourhood,
    ) -> Vec<[Estimate; 2]> {
        let tree = &with.tree;
        let bandwidth = &Bandwidth { coarse, ..with.bandwidth.bandwidth };
        let mut found = Vec::with_capacity(tree.range(root).len());
        let mut open = vec![(root, with.bandwidth.guess, self.means(root, tree, None), false)];
        while let Some((node, mut guess, means, is_cluttered)) = open.pop() {
            let extent = tree.as_element(node);
            let means = if hood.is_hurried() { self.means(node, tree, Some(means)) } else { means };
            let mut gave_up = is_cluttered;
            // The radius may turn out to be larger than the one before.
            if !gave_up && reads_one(&extent, 1.6 * guess) {
                guess = bandwidth.focus(hood, tree, &extent, guess);
                gave_up = hood.gave_up();
                if !gave_up && reads_one(&extent, guess) {
                    self.estimate_run(node, with, bandwidth, hood, &mut found);
                    continue;
                }
            }
            let members = &tree.order()[tree.range(node)];
            if coarse && members.len() <= tree.len() / PLACES_COARSELY {
                // What was too much clutter is so again.
                if !gave_up {
                    bandwidth.focus(hood, tree, &extent, guess);
                    gave_up = hood.gave_up();
                }
                let fits = match gave_up {
                    true => means,
                    false => self.fits(&extent.center, members, with, bandwidth, hood),
                };
                found.extend(members.iter().map(|_| fits));
                continue;
            }
            if let Some([first, second]) = tree.halves(node) {
                let is_cluttered = gave_up && extent.reach <= CLUTTERED * guess;
                open.extend([(second, guess, means, is_cluttered), (first, guess, means, is_cluttered)]);
                continue;
            }
            for &e in members {
                let element = &self.atlas.elements[e as usize];
                if !is_cluttered {
                    guess = bandwidth.focus(hood, tree, &Extent::of(element), guess);
                }
                found.push(match is_cluttered || hood.gave_up() {
                    true => means,
                    false => self.fits(element, &[e], with, bandwidth, hood),
                });
            }
        }
        found
    }

    /// Mean irradiance on front and back of a node; on a side that has too few particles for it, the mean `above`. What a
    /// first picture shows in clutter, where a kernel would have to visit too much.
    fn means(&self, node: u32, tree: &ClusterTree, above: Option<[Estimate; 2]>) -> [Estimate; 2] {
        [0, 1].map(|side| {
            let (sum, _) = tree.sums(node, side);
            match above {
                Some(above) if sum.count < MEAN_COUNT => above[side],
                _ => mean_of(&sum, self.emitted),
            }
        })
    }

    /// The same at elements that read one neighbourhood. Those much closer to each other than the kernel is wide share
    /// one fit, evaluated at each of them.
    fn estimate_run(
        &self,
        root: u32,
        with: &Prepared,
        bandwidth: &Bandwidth,
        hood: &mut Neighbourhood,
        found: &mut Vec<[Estimate; 2]>,
    ) {
        let (tree, elements) = (&with.tree, &self.atlas.elements);
        let (shared, narrow) = if bandwidth.coarse { SHARED_COARSELY } else { SHARED };
        let mut open = vec![root];
        while let Some(node) = open.pop() {
            let members = &tree.order()[tree.range(node)];
            let Extent { center, reach, cosine } = tree.as_element(node);
            if reach <= shared * hood.nominal() && cosine > narrow {
                hood.place(&center);
                let fits = self.fits(&center, members, with, bandwidth, hood);
                found.extend(members.iter().map(|&e| {
                    let [u, v] = along_tangents(&center, elements[e as usize].position);
                    fits.map(|fit| Estimate { irradiance: fit.at(u, v), ..fit })
                }));
            } else if let Some([first, second]) = tree.halves(node) {
                open.extend([second, first]);
            } else {
                for &e in members {
                    let element = &elements[e as usize];
                    hood.place(element);
                    found.push(self.fits(element, &[e], with, bandwidth, hood));
                }
            }
        }
    }

    /// Front and back of a placed element that speaks for `members`.
    fn fits(
        &self,
        element: &Element,
        members: &[u32],
        with: &Prepared,
        bandwidth: &Bandwidth,
        hood: &Neighbourhood,
    ) -> [Estimate; 2] {
        let needs_back = members.iter().any(|&e| with.lit_back[e as usize / BLOCK]);
        [false, true].map(|back| match back && !needs_back {
            true => Estimate::default(),
            false => bandwidth.estimate(hood, element, back, self.emitted).0,
        })
    }

    /// What is known of the sides of an element.
    fn parts(&self, e: u32, particles: [Estimate; 2], direct: Sides, with: &Prepared) -> [Option<Parts>; 2] {
        [0, 1].map(|side| {
            (side == 0 || with.lit_back[e as usize / BLOCK]).then(|| Parts {
                direct: direct[side].0,
                direct_variance: direct[side].1,
                particles: particles[side].irradiance,
                particle_variance: particles[side].variance,
            })
        })
    }

    /// Direct light noisier than this share of itself is smoothed.
    fn direct_target(&self) -> f32 {
        DIRECT_NOISE.max(2.0 * self.settings.error.unwrap_or(0.0))
    }

    /// The irradiance from all that was gathered so far.
    pub fn illumination(&mut self) -> Illumination {
        loop {
            if let Some(map) = self.estimate_some(usize::MAX) {
                return map;
            }
        }
    }

    /// A bounded part of the work for [`Self::illumination`]: estimates at about 1000 × `runs` elements. The map, once
    /// it is whole. Nothing else may be asked of the bake meanwhile.
    pub fn estimate_some(&mut self, runs: usize) -> Option<Illumination> {
        let mut e = match self.estimating.take() {
            Some(e) => e,
            None => {
                let with = self.prepare();
                let any = self.direct_rounds > 0 || self.direct_block > 0;
                let smooth = (any && !self.is_late()).then(|| {
                    let open = |e: u32| self.open[e as usize];
                    let (tree, target) = (with.tree.clone(), self.direct_target());
                    SmoothDirect::new(&self.atlas.elements, &self.direct, tree, &open, self.diagonal, target)
                });
                let nodes = with.tree.subtrees(RUN);
                Estimating { with, smooth, nodes, found: Vec::new() }
            }
        };
        let first = e.found.len();
        let last = first.saturating_add(runs).min(e.nodes.len());
        let with = &e.with;
        let work = |hood: &mut Neighbourhood, &node: &u32| {
            let late = self.is_late();
            let coarse = self.coarse || late;
            hood.reset();
            if coarse {
                hood.hurry();
            }
            let members = &with.tree.order()[with.tree.range(node)];
            let particles = match with.stored {
                0 => vec![[Estimate::default(); 2]; members.len()],
                _ => self.estimate_node(node, with, coarse, hood),
            };
            let direct = match &e.smooth {
                Some(smooth) if !late => smooth.at_node(&self.atlas.elements, &self.direct, node, hood),
                _ => {
                    members.iter().map(|&e| [0, 1].map(|side| self.direct[e as usize][side].mean())).collect()
                }
            };
            let sides = members.iter().zip(particles.into_iter().zip(direct));
            sides.map(|(&e, (particles, direct))| self.parts(e, particles, direct, with)).collect()
        };
        let found: Vec<Vec<_>> =
            e.nodes[first..last].par_iter().map_init(Neighbourhood::default, work).collect();
        e.found.extend(found);
        if last < e.nodes.len() {
            self.estimating = Some(e);
            return None;
        }
        let mut values: Vec<[Option<Parts>; 2]> = vec![[None; 2]; self.atlas.elements.len()];
        for (&e, sides) in with.tree.order().iter().zip(e.found.iter().flatten()) {
            values[e as usize] = *sides;
        }
        self.add_coarse(&mut values, with);
        let summary = self.summary((0..values.len() as u32).zip(&values), with);
        let front: Vec<Value> = values.iter().map(|v| v[0].map(|p| p.value())).collect();
        // Where nothing arrives it is dark: no neighbour's light is theirs, as it is that of what nothing is known of.
        let back = |(i, v): (usize, &[Option<Parts>; 2])| match with.lit_back[i / BLOCK] {
            true => v[1].map(|p| p.value()),
            false => Some(Vec4::ZERO),
        };
        let back: Vec<Value> = values.iter().enumerate().map(back).collect();
        let map = Illumination::new(&self.atlas, front, back, summary);
        self.prepared = Some(e.with);
        Some(map)
    }

    /// Large elements out of sight need no kernels: they show the mean of what arrived on them.
    fn add_coarse(&self, values: &mut [[Option<Parts>; 2]], with: &Prepared) {
        for e in (0..values.len() as u32).filter(|&e| self.is_coarse(e as usize)) {
            let particles = [false, true].map(|back| mean_of(&self.arrived(e, back), self.emitted));
            let direct = self.direct[e as usize].map(|bin| bin.mean());
            values[e as usize] = self.parts(e, particles, direct, with);
        }
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
            .map_init(Neighbourhood::default, |hood, &e| {
                let element = &self.atlas.elements[e as usize];
                let particles = if with.stored == 0 {
                    [Estimate::default(); 2]
                } else {
                    let bandwidth = &with.bandwidth.bandwidth;
                    hood.reset();
                    bandwidth.focus(hood, &with.tree, &Extent::of(element), with.bandwidth.guess);
                    self.fits(element, &[e], &with, bandwidth, hood)
                };
                // Smoothing leaves the error that it aims at, no more.
                let direct = [0, 1].map(|side| {
                    let (mean, variance) = self.direct[e as usize][side].mean();
                    (mean, variance.min((target * luminance(mean)).powi(2)))
                });
                (e, self.parts(e, particles, direct, &with))
            })
            .collect();
        let summary = self.summary(values.iter().map(|(e, sides)| (*e, sides)), &with);
        self.prepared = Some(with);
        summary
    }

    /// The bandwidth of least error: at some elements the estimate is compared with one from twice as many
    /// particles. Bias grows with the count k, variance falls with 1/k, so their sum is least where the
    /// squared bias is half of the variance (REFERENCE §6.2).
    fn bandwidth(&self, tree: &ClusterTree, stored: u64) -> ChosenBandwidth {
        let base = Bandwidth { coarse: self.coarse, ..Bandwidth::new(stored, self.diagonal) };
        let elements = &self.atlas.elements;
        let area: f32 = elements.iter().map(|e| e.opaque).sum();
        if tree.is_empty() || stored == 0 {
            return ChosenBandwidth { bandwidth: base, bias_squared: 0.0, guess: 0.0 };
        }
        let order: Vec<u32> = tree.order().iter().copied().filter(|&e| self.watched[e as usize]).collect();
        if order.is_empty() {
            return ChosenBandwidth { bandwidth: base, bias_squared: 0.0, guess: 0.0 };
        }
        let step = order.len().div_ceil(if self.coarse { PILOTS / 8 } else { PILOTS });
        let wide = Bandwidth { count: 2.0 * base.count, ..base };
        let guess = base.radius_for(area, stored);
        let pilots: Vec<(f64, f64, f64)> = order
            .par_iter()
            .step_by(step)
            .map_init(Neighbourhood::default, |hood, &e| {
                let element = &elements[e as usize];
                hood.reset();
                if self.coarse {
                    hood.hurry();
                }
                base.focus(hood, tree, &Extent::of(element), guess);
                if hood.gave_up() {
                    return (0.0, 0.0, 0.0);
                }
                let at = |b: &Bandwidth| {
                    let radius = b.kernel(hood, element, false);
                    let e = hood.estimate(radius, false, self.emitted);
                    (f64::from(luminance(e.irradiance)), f64::from(e.variance), radius)
                };
                let (narrow, v1, r1) = at(&base);
                let (wide, v2, r2) = at(&wide);
                let area = f64::from(element.opaque);
                // Where the radius is at a limit nothing can be learned.
                if r2 < 1.2 * r1 {
                    return (0.0, area * v1, area);
                }
                // Where it is much more than the noise narrower kernels are taken: it says nothing of the rest.
                let bias = ((wide - narrow).powi(2) - (v1 - v2).abs()).min(BIAS_MAX * v1);
                (area * bias, area * v1, area)
            })
            .collect();
        let bias: f64 = pilots.iter().map(|p| p.0).sum();
        let variance: f64 = pilots.iter().map(|p| p.1).sum();
        let weight: f64 = pilots.iter().map(|p| p.2).sum();
        // Smooth scenes show none; then the radius is limited by their size.
        let bias = bias.max(0.004 * variance);
        let factor = if variance > 0.0 { math::cbrt(0.5 * variance / bias).clamp(0.2, 8.0) } else { 1.0 };
        let bandwidth = Bandwidth { count: base.count * factor as f32, ..base };
        ChosenBandwidth {
            bandwidth,
            bias_squared: bias / weight.max(1e-300) * factor * factor,
            guess: bandwidth.radius_for(area, stored),
        }
    }

    fn notes(&self) -> Vec<String> {
        let mut notes = self.atlas.notes.clone();
        if let Some(done) = self.cut {
            let share = 100.0 * done as f64 / self.direct.len() as f64;
            notes.push(format!(
                "there was time for direct light at {share:.0} % of the elements; the others show that of some of \
                 them, and indirect light is a first estimate"
            ));
        }
        if self.emitted == 0 && self.transport.power() > 0.0 {
            notes.push("there was no time for indirect light".into());
        }
        notes
    }

    fn summary<'v>(
        &self,
        values: impl Iterator<Item = (u32, &'v [Option<Parts>; 2])> + Clone,
        with: &Prepared,
    ) -> Summary {
        let (mut energy, mut surface) = (0.0f64, 0.0f64);
        let (mut direct, mut particles, mut bias) = (0.0f64, 0.0f64, 0.0f64);
        let mut mean = [0.0f64; 3];
        let watched = values.filter(|&(e, _)| self.watched[e as usize]);
        // Beside a lamp irradiance has no bound: what is there must not outweigh all the rest.
        let total = |p: &Parts| luminance(p.all());
        let mut brightness: Vec<f32> = watched.clone().filter_map(|v| v.1[0].as_ref().map(total)).collect();
        let middle = brightness.len() / 2;
        let cap = match brightness.is_empty() {
            true => 0.0,
            false => BRIGHT * *brightness.select_nth_unstable_by(middle, f32::total_cmp).1,
        };
        for (e, sides) in watched {
            let area = f64::from(self.atlas.elements[e as usize].opaque);
            surface += area;
            for parts in sides.iter().flatten() {
                let all = parts.all();
                let counts = if cap > 0.0 && luminance(all) > cap { cap / luminance(all) } else { 1.0 };
                let weighted = area * f64::from(counts * counts);
                energy += weighted * f64::from(luminance(all)).powi(2);
                direct += weighted * f64::from(parts.direct_variance);
                particles += weighted * f64::from(parts.particle_variance);
                bias += weighted * with.bias_squared;
                for (sum, band) in mean.iter_mut().zip(all.to_array()) {
                    *sum += area * f64::from(band);
                }
            }
        }
        let relative = |squared: f64| if energy > 0.0 { (squared / energy).sqrt() as f32 } else { 0.0 };
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
            notes: self.notes(),
        }
    }
}
