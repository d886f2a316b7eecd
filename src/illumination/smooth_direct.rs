//! Direct light where few samples make it noisy: means over neighbours, as wide as the error asks for
//! (REFERENCE §6.3). Where the samples suffice nothing is changed, so sharp shadows stay.

use glam::Vec3;
use rayon::prelude::*;

use super::atlas::Element;
use super::bins::Arrived;
use super::clusters::ClusterTree;
use super::density::{Bandwidth, estimate_coarsely};
use super::direct::DirectBin;
use crate::image::luminance;

/// Neighbours that decide together how noisy their samples are: enough that some of them found the light.
const RUN: u32 = 96;
/// Elements within this share of a kernel's radius share its fit.
const SHARED: f32 = 0.2;
/// Cosine of the angle within which their normals must be, 0.15 rad.
const NARROW: f32 = 0.988_771_1;
/// (∫K)² / ∫K² of a disc is 3/4 of its area: so many more elements are needed.
const INEFFICIENCY: f32 = 4.0 / 3.0;

/// Irradiance and the variance of its luminance, front and back.
pub type Sides = [(Vec3, f32); 2];

/// Direct light at the elements of `tree`, in its order, with a standard error of about `target` of itself at most,
/// as far as kernels of `radius_max` bring it there.
pub fn smoothed(
    elements: &[Element],
    direct: &[[DirectBin; 2]],
    mut tree: ClusterTree,
    radius_max: f32,
    target: f32,
) -> Vec<Sides> {
    tree.update_with(&|e| {
        [0, 1].map(|side| {
            let area = elements[e as usize].area;
            let (mean, variance) = direct[e as usize][side].mean();
            Arrived { flux: area * mean, square: area * area * variance, count: 1.0 }
        })
    });
    let tree = &tree;
    let run = |&node: &u32| {
        let members = &tree.order()[tree.range(node)];
        let mut found: Vec<Sides> =
            members.iter().map(|&e| [0, 1].map(|side| direct[e as usize][side].mean())).collect();
        for side in [0, 1] {
            let (sum, area) = tree.sums(node, side);
            let n = members.len() as f32;
            let mean = luminance(sum.flux) / area;
            let variance = sum.square * n / (area * area);
            let wanted = INEFFICIENCY * variance / (target * mean).powi(2);
            if mean > 0.0 && wanted > 1.5 {
                let radius = (wanted * area / n / std::f32::consts::PI).sqrt().min(radius_max);
                let most = 2.0 * (target * mean).powi(2);
                smooth(elements, tree, node, side, radius, most, &mut found);
            }
        }
        found
    };
    tree.subtrees(RUN).par_iter().flat_map_iter(run).collect()
}

fn smooth(
    elements: &[Element],
    tree: &ClusterTree,
    root: u32,
    side: usize,
    radius: f32,
    variance_max: f32,
    found: &mut [Sides],
) {
    let first = tree.range(root).start;
    // A slope fitted at a border or in a corner is noisier than in the open.
    let fitted = |element: &Element, radius: f32| {
        let fit = estimate_coarsely(tree, element, side == 1, radius, 1);
        if fit.variance <= variance_max {
            fit
        } else {
            estimate_coarsely(tree, element, side == 1, 2.0 * radius, 1)
        }
    };
    let mut open = vec![root];
    while let Some(node) = open.pop() {
        let range = tree.range(node);
        let members = &tree.order()[range.clone()];
        if let Some((center, _)) =
            tree.as_element(node, NARROW).filter(|(_, reach)| *reach <= SHARED * radius)
        {
            let fit = fitted(&center, radius);
            let (x, y) = center.normal.any_orthonormal_pair();
            for (i, &e) in range.zip(members) {
                let d = elements[e as usize].position - center.position;
                found[i - first][side] = (fit.at(d.dot(x), d.dot(y)), fit.variance);
            }
        } else if let Some([a, b]) = tree.halves(node) {
            open.extend([b, a]);
        } else {
            for (i, &e) in range.zip(members) {
                let element = &elements[e as usize];
                let radius = radius.max(Bandwidth::radius_min(element));
                let fit = fitted(element, radius);
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
    fn noise_is_smoothed_and_a_clean_shadow_is_not() {
        for (p, allowed) in [(1.0, 1e-6), (0.2, 0.5)] {
            let (elements, direct) = lit(p);
            let tree = ClusterTree::build(&elements);
            let order = tree.order().to_vec();
            let found = smoothed(&elements, &direct, tree, 0.2, 0.1);
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
}
