//! Direct light where few samples make it noisy: means over neighbours, as wide as the error asks for
//! (REFERENCE §6.3). Where the samples suffice nothing is changed, so sharp shadows stay.

use glam::Vec3;

use super::atlas::Element;
use super::bins::Arrived;
use super::clusters::ClusterTree;
use super::density::{Bandwidth, estimate};
use super::direct::DirectBin;
use crate::image::luminance;

/// Independent elements in a kernel of the smallest radius: π · 2.2² of which (∫K)²/∫K² = 3/4 count.
const POOLED: f32 = 11.0;
/// Radii that are tried, each this much larger than the one before.
const GROWTH: f32 = 1.7;
/// Radii at most.
const STEPS: u32 = 5;

/// The sums of direct light over clusters: each element counts as one particle of its flux.
pub struct DirectSums<'a> {
    direct: &'a [[DirectBin; 2]],
    tree: ClusterTree,
    radius_max: f32,
    /// Standard error aimed at, as a share of the irradiance.
    target: f32,
}

impl<'a> DirectSums<'a> {
    /// Over the elements of `tree`.
    pub fn new(
        elements: &[Element],
        direct: &'a [[DirectBin; 2]],
        mut tree: ClusterTree,
        radius_max: f32,
        target: f32,
    ) -> Self {
        tree.update_with(&|e| {
            [0, 1].map(|side| {
                let area = elements[e as usize].area;
                let (mean, variance) = direct[e as usize][side].mean();
                Arrived { flux: area * mean, square: area * area * variance, count: 1.0 }
            })
        });
        Self { direct, tree, radius_max, target }
    }

    /// Direct irradiance at one side of element `e` and the variance of its luminance.
    pub fn at(&self, e: u32, element: &Element, back: bool) -> (Vec3, f32) {
        let own = self.direct[e as usize][usize::from(back)].mean();
        let mut radius = Bandwidth::radius_min(element);
        let pooled = estimate(&self.tree, element, back, radius, 1);
        let mean = luminance(pooled.irradiance);
        if mean <= 0.0 || pooled.variance * POOLED <= (self.target * mean).powi(2) {
            return own;
        }
        let mut best = pooled;
        for _ in 1..STEPS {
            if best.variance <= (self.target * luminance(best.irradiance)).powi(2)
                || radius >= self.radius_max
            {
                break;
            }
            radius *= GROWTH;
            best = estimate(&self.tree, element, back, radius, 1);
        }
        (best.irradiance, best.variance)
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
                bin.gather(u64::from(i), |_| match position.x < 0.5 && stream.next_f32() < p {
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
        for (p, allowed) in [(1.0, 1e-6), (0.2, 0.25)] {
            let (elements, direct) = lit(p);
            let sums = DirectSums::new(&elements, &direct, ClusterTree::build(&elements), 0.2, 0.1);
            let mut error = 0.0f32;
            for (e, element) in elements.iter().enumerate() {
                let exact = if element.position.x < 0.5 { 1.0 } else { 0.0 };
                // A blurred edge is the price where there is noise.
                if p == 1.0 || (element.position.x - 0.5).abs() > 0.2 {
                    error = error.max((sums.at(e as u32, element, false).0.x - exact).abs());
                }
                assert_eq!(sums.at(e as u32, element, true).0, Vec3::ZERO);
            }
            assert!(error <= allowed, "{p}: {error}");
        }
    }
}
