//! How far estimates are from what arrived, whatever the reason: cross-validation (Stone 1974; Rudemo 1982 for kernels).
//!
//! What arrived on a few neighbouring elements, divided by their area, is an irradiance without bias, but noisy. With f
//! the estimate and t that irradiance, f² − 2 f t + t² is the squared error of f, once the products are without those of a
//! particle with itself. Its mean over many places is noise and bias of kernels together, in contact shadows as on open
//! walls, no finer than the places are wide. What the noise does not explain is bias.

use rayon::prelude::*;

use super::bake::Baker;
use super::estimate::Prepared;
use super::neighbourhood::Neighbourhood;
use crate::image::luminance;

/// Places at which estimates are held against what arrived, at most.
const PLACES: usize = 12_000;
/// Particles wanted at a place: fewer tell little.
const WANTED: f32 = 64.0;
/// Elements that make a place, at most.
const ELEMENTS_MAX: u32 = 32;
/// Cosine of the angle within which their normals must be.
const FLAT: f32 = 0.98;

/// One place: its area, the squared error there times the area, and that of the noise.
struct Place {
    area: f64,
    error: f64,
    noise: f64,
}

impl Baker<'_> {
    /// Mean over the fronts that count of the squared bias of the luminance from particles, W²/m⁴.
    pub(super) fn cross_validated_bias(&self, with: &Prepared) -> f64 {
        let tree = with.tree();
        if self.coarse || tree.is_empty() || with.stored() == 0 {
            return 0.0;
        }
        let per_element = with.stored() as f32 / tree.len() as f32;
        let size = (WANTED / per_element).clamp(1.0, ELEMENTS_MAX as f32) as u32;
        let all = tree.subtrees(size);
        let step = all.len().div_ceil(PLACES).max(1);
        let places: Vec<Place> = all
            .par_iter()
            .step_by(step)
            .map_init(Neighbourhood::default, |hood, &node| self.validate(with, node, hood))
            .flatten()
            .collect();
        let area: f64 = places.iter().map(|p| p.area).sum();
        let n = places.len() as f64;
        if n < 100.0 || area <= 0.0 {
            return 0.0;
        }
        let excess: f64 = places.iter().map(|p| p.error - p.noise).sum::<f64>() / n;
        excess.max(0.0) * n / area
    }

    /// Estimate and arrivals at a node of the tree.
    fn validate(&self, with: &Prepared, node: u32, hood: &mut Neighbourhood) -> Option<Place> {
        let tree = with.tree();
        let extent = tree.as_element(node);
        let members = &tree.order()[tree.range(node)];
        if extent.cosine < FLAT || !members.iter().all(|&e| self.watched[e as usize]) {
            return None;
        }
        hood.reset();
        let (estimate, radius) = with.estimate_at(&extent, hood, self.emitted);
        let (arrived, _) = tree.sums(node, 0);
        let (area, n) = (f64::from(arrived.area), self.emitted as f64);
        let flux = f64::from(luminance(arrived.flux));
        let square = f64::from(arrived.square);
        let f = f64::from(luminance(estimate.irradiance));
        // Particles of the place lie a little beside the middle of the kernel.
        let beside = 1.0 - 0.5 * f64::from((extent.reach / radius).min(1.0)).powi(2);
        let own = f64::from(estimate.own) * beside * square / (area * n);
        let t = flux / (area * n);
        let t_squared = (flux * flux - square) / (area * n).powi(2);
        let error = f * f - 2.0 * (f * t - own) + t_squared;
        let noise = f64::from(estimate.variance);
        (error.is_finite() && area > 0.0).then_some(Place { area, error: area * error, noise: area * noise })
    }
}
