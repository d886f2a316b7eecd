//! Direct light where few samples make it noisy: means over neighbours, as wide as the error asks for
//! (REFERENCE §6.3). Where the samples suffice nothing is changed, and light that needs no samples is kept as it is, so
//! sharp shadows stay.

use glam::Vec3;

use super::atlas::Element;
use super::bins::Arrived;
use super::clusters::{ClusterTree, Extent};
use super::density::Bandwidth;
use super::direct::DirectBin;
use super::estimate::reads_one;
use super::neighbourhood::{Neighbourhood, REACH, RESOLUTION, along_tangents};
use crate::image::luminance;

/// Neighbours that decide together how noisy their samples are.
const RUN: u32 = 96;
/// Elements within this share of a kernel's radius share its fit.
const SHARED: f32 = 0.2;
/// Cosine of the angle within which their normals must be, 0.15 rad.
const NARROW: f32 = 0.988_771_1;
/// (∫K)² / ∫K² of a disc is 3/4 of its area: so many more elements are needed.
const INEFFICIENCY: f32 = 4.0 / 3.0;

/// Elements whose mean a first picture takes in clutter, where kernels would have to visit too much.
const MEAN_OF: usize = 32;

/// What neighbours say may differ from an element's own samples by the root of this many times their variance before
/// it is doubted: then it is the edge of a shadow that lies between, and no noise.
const TRUSTED: f32 = 4.0;
/// Largest radius of kernels, as a share of the scene's size.
const RADIUS_MAX: f32 = 0.05;
/// How noisy samples are is learned within so many times the reach of a run.
const POOLED: f32 = 3.0;

/// Irradiance and the variance of its luminance, front and back.
pub type Sides = [(Vec3, f32); 2];

/// Direct light with a standard error of about `target` of itself at most, as far as kernels of `radius_max` bring it
/// there.
pub struct SmoothDirect {
    tree: ClusterTree,
    radius_max: f32,
    target: f32,
}

impl SmoothDirect {
    /// Smooths what `direct` holds for the elements of `tree`.
    pub fn new(
        elements: &[Element],
        direct: &[[DirectBin; 2]],
        mut tree: ClusterTree,
        open: &(dyn Fn(u32) -> [bool; 2] + Sync),
        diagonal: f32,
        target: f32,
    ) -> Self {
        let radius_max = RADIUS_MAX * diagonal;
        let arrived = |e: u32| {
            [0, 1].map(|side| {
                let area = elements[e as usize].area;
                let (mean, variance) = direct[e as usize][side].sampled();
                Arrived { flux: area * mean, square: area * area * variance, count: 1.0, area }
            })
        };
        tree.update_with(&arrived, open);
        Self { tree, radius_max, target }
    }

    /// Direct light at the elements of a node of the tree, in its order.
    pub fn at_node(
        &self,
        elements: &[Element],
        direct: &[[DirectBin; 2]],
        root: u32,
        hood: &mut Neighbourhood,
    ) -> Vec<Sides> {
        let tree = &self.tree;
        let mut all = Vec::with_capacity(tree.range(root).len());
        for node in tree.subtrees_of(root, RUN) {
            let members = &tree.order()[tree.range(node)];
            let first = all.len();
            all.extend(members.iter().map(|&e| direct[e as usize].map(|bin| bin.sampled())));
            for side in [0, 1] {
                let extent = tree.as_element(node);
                // A first picture has no time to ask around.
                let pool = match hood.is_hurried() {
                    true => self.within(node, side),
                    false => self.pooled(&extent, side, POOLED * extent.reach, hood),
                };
                let Some(mut pool) = pool else { continue };
                let n = members.len() as f32;
                let certain: Vec3 = members.iter().map(|&e| direct[e as usize][side].certain()).sum();
                let wanted_by = |pool: &Pool| {
                    let mean = pool.mean + luminance(certain) / n;
                    let wanted = INEFFICIENCY * pool.variance / (self.target * mean).powi(2);
                    let radius = (wanted * extent.center.area / std::f32::consts::PI).sqrt();
                    (mean, wanted, radius.min(self.radius_max))
                };
                let (mut mean, mut wanted, mut radius) = wanted_by(&pool);
                // What a kernel makes a mean of must be what tells its noise.
                if radius > pool.radius && !hood.is_hurried() {
                    pool = self.pooled(&extent, side, radius, hood).unwrap_or(pool);
                    (mean, wanted, radius) = wanted_by(&pool);
                }
                if wanted > 1.5 {
                    let kernel = Kernel { side, radius, variance_max: 2.0 * (self.target * mean).powi(2) };
                    let own: Vec<(Vec3, f32)> = all[first..].iter().map(|sides| sides[side]).collect();
                    smooth(elements, tree, node, &kernel, &mut all[first..], hood);
                    for (sides, own) in all[first..].iter_mut().zip(own) {
                        sides[side] = shrunk(own, sides[side], pool.variance);
                    }
                }
            }
            for (sides, &e) in all[first..].iter_mut().zip(members) {
                for (side, bin) in sides.iter_mut().zip(&direct[e as usize]) {
                    side.0 += bin.certain();
                }
            }
        }
        all
    }
}

/// What samples are like around a run of elements.
struct Pool {
    /// How far around.
    radius: f32,
    /// Mean luminance.
    mean: f32,
    /// Mean variance of an element's luminance.
    variance: f32,
}

impl SmoothDirect {
    /// What the samples of the run itself are like; `None` where none of them found any light.
    fn within(&self, node: u32, side: usize) -> Option<Pool> {
        let (sum, area) = self.tree.sums(node, side);
        let (mean, n) = (luminance(sum.flux) / area, self.tree.range(node).len() as f32);
        let radius = self.tree.as_element(node).reach;
        (mean > 0.0).then_some(Pool { radius, mean, variance: sum.square * n / (area * area) })
    }

    /// `None` where none of them found any light. A run decides with those around it, so that runs beside each other
    /// decide alike; and where chance had it that none of its own samples found the light, theirs tell.
    fn pooled(&self, extent: &Extent, side: usize, radius: f32, hood: &mut Neighbourhood) -> Option<Pool> {
        let near = radius.max(Bandwidth::radius_min(&extent.center));
        [near, self.radius_max.max(near)].into_iter().find_map(|radius| {
            hood.gather(&self.tree, extent, radius, 2.0 * RESOLUTION);
            hood.place(&extent.center);
            let (mean, variance) = hood.pooled(radius, side == 1);
            (mean > 0.0).then_some(Pool { radius, mean, variance })
        })
    }
}

/// An element's own samples drawn towards what is around it, by as much as their noise explains the difference (a
/// shrinkage estimator; James & Stein 1961). `typical`: variance of the samples around, since the few of one element may
/// all have missed the light.
fn shrunk(own: (Vec3, f32), around: (Vec3, f32), typical: f32) -> (Vec3, f32) {
    let noise = own.1.max(typical);
    let difference = luminance(around.0 - own.0).powi(2);
    let w = if difference > TRUSTED * noise { TRUSTED * noise / difference } else { 1.0 };
    // What the difference is more than the noise is bias of the neighbours.
    let bias = w * w * (difference - noise).max(0.0);
    (own.0 + w * (around.0 - own.0), w * w * around.1 + (1.0 - w).powi(2) * own.1 + bias)
}

/// How the elements of a run are smoothed.
struct Kernel {
    side: usize,
    radius: f32,
    /// Beyond this kernels grow.
    variance_max: f32,
}

fn smooth(
    elements: &[Element],
    tree: &ClusterTree,
    root: u32,
    &Kernel { side, radius, variance_max }: &Kernel,
    found: &mut [Sides],
    hood: &mut Neighbourhood,
) {
    let first = tree.range(root).start;
    // A slope fitted at a border or in a corner is noisier than in the open.
    let fitted = |hood: &mut Neighbourhood, element: &Element, radius: f32| {
        hood.place(element);
        let fit = hood.estimate(radius, side == 1, 1);
        if fit.variance <= variance_max { fit } else { hood.estimate(REACH * radius, side == 1, 1) }
    };
    // Nodes, and whether the neighbourhood of one above them is theirs as well.
    let mut open = vec![(root, false)];
    while let Some((node, mut gathered)) = open.pop() {
        let range = tree.range(node);
        let members = &tree.order()[range.clone()];
        let extent = tree.as_element(node);
        if !gathered && reads_one(&extent, radius) {
            hood.gather(tree, &extent, radius, 2.0 * RESOLUTION);
            gathered = !hood.gave_up();
        }
        if hood.is_hurried() && !gathered && members.len() <= MEAN_OF {
            let (sum, area) = tree.sums(node, side);
            for i in range {
                found[i - first][side] = (sum.flux / area, sum.square / (area * area));
            }
            continue;
        }
        let Extent { center, reach, cosine } = extent;
        if gathered && reach <= SHARED * radius && cosine > NARROW {
            let fit = fitted(hood, &center, radius);
            for (i, &e) in range.zip(members) {
                let [u, v] = along_tangents(&center, elements[e as usize].position);
                found[i - first][side] = (fit.at(u, v), fit.variance);
            }
        } else if let Some([a, b]) = tree.halves(node) {
            open.extend([(b, gathered), (a, gathered)]);
        } else {
            for (i, &e) in range.zip(members) {
                let element = &elements[e as usize];
                let radius = radius.max(Bandwidth::radius_min(element));
                if !gathered {
                    hood.gather(tree, &Extent::of(element), radius, 2.0 * RESOLUTION);
                }
                let fit = fitted(hood, element, radius.min(REACH * hood.nominal()));
                found[i - first][side] = (fit.irradiance, fit.variance);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Stream;

    /// 40 × 40 elements of a unit square, lit where x < 1/2, with samples that are found by chance `p`.
    fn lit(p: f32) -> (Vec<Element>, Vec<[DirectBin; 2]>) {
        let side = 1.0 / 40.0;
        (0..1600u32)
            .map(|i| {
                let position = Vec3::new((i % 40) as f32 + 0.5, (i / 40) as f32 + 0.5, 0.0) * side;
                let mut bin = DirectBin::default();
                let mut stream = Stream::new(1, u64::from(i), 0);
                bin.gather(u64::from(i), 8, |_| match position.x < 0.5 && stream.next_f32() < p {
                    true => Vec3::splat(1.0 / p),
                    false => Vec3::ZERO,
                });
                let element = Element { position, normal: Vec3::Z, area: side * side, ..Element::default() };
                (element, [bin, DirectBin::default()])
            })
            .unzip()
    }

    #[test]
    fn a_shadow_deeper_than_the_noise_keeps_its_edge() {
        let (elements, direct) = lit(0.9);
        let tree = ClusterTree::build(&elements);
        let order = tree.order().to_vec();
        let smooth = SmoothDirect::new(&elements, &direct, tree, &|_| [true; 2], 4.0, 0.02);
        let found = smooth.at_node(&elements, &direct, 0, &mut Neighbourhood::default());
        let (mut noise, mut before) = (0.0f32, 0.0f32);
        for (&e, sides) in order.iter().zip(&found) {
            let x = elements[e as usize].position.x;
            if x > 0.5 {
                assert!(sides[0].0.x < 0.15, "{x}: {}", sides[0].0.x);
            } else if x < 0.25 {
                noise += (sides[0].0.x - 1.0).powi(2);
                before += (direct[e as usize][0].mean().0.x - 1.0).powi(2);
            }
        }
        assert!(noise < 0.25 * before, "{noise} {before}");
    }

    #[test]
    fn noise_is_smoothed_and_a_clean_shadow_is_not() {
        for (p, allowed) in [(1.0, 1e-6), (0.2, 0.8)] {
            let (elements, direct) = lit(p);
            let tree = ClusterTree::build(&elements);
            let order = tree.order().to_vec();
            let smooth = SmoothDirect::new(&elements, &direct, tree, &|_| [true; 2], 4.0, 0.1);
            let found = smooth.at_node(&elements, &direct, 0, &mut Neighbourhood::default());
            let mut error = 0.0f32;
            for (&e, sides) in order.iter().zip(&found) {
                let x = elements[e as usize].position.x;
                // A blurred edge is the price where there is noise.
                if p == 1.0 || (x - 0.5).abs() > 0.25 {
                    error = error.max((sides[0].0.x - if x < 0.5 { 1.0 } else { 0.0 }).abs());
                }
                assert_eq!(sides[1].0, Vec3::ZERO);
            }
            assert!(error <= allowed, "{p}: {error}");
        }
    }

    #[test]
    fn where_chance_found_no_light_neighbours_speak() {
        // Two hits among a thousand samples: many runs of elements have none at all.
        let (elements, direct) = lit(0.002);
        let tree = ClusterTree::build(&elements);
        let order = tree.order().to_vec();
        let smooth = SmoothDirect::new(&elements, &direct, tree, &|_| [true; 2], 6.0, 0.02);
        let found = smooth.at_node(&elements, &direct, 0, &mut Neighbourhood::default());
        for (&e, sides) in order.iter().zip(&found) {
            let p = elements[e as usize].position;
            if p.x < 0.2 {
                assert!((0.1..4.0).contains(&sides[0].0.x), "{p}: {}", sides[0].0.x);
            }
        }
    }
}
