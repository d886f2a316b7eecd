//! The one class of paths that no connection finds: light of a lamp without area that meets Dirac lobes on both sides of
//! every vertex that could be connected, as a lamp's caustic seen in a mirror.
//!
//! Photons that came such a way are merged with what subpaths from the eye meet first behind Dirac lobes, over a disk.
//! That blurs: the mean is off by a share of the radius squared, so that the same photons within 1/√2 of the radius tell
//! how much. Radii shrink from pass to pass, so that in the limit nothing is off (Knaus & Zwicker 2011).

use std::f32::consts::PI;

use glam::Vec3;

use super::vertex::{Vertex, geometric_cosine};

/// Light that arrives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Photon {
    position: Vec3,
    /// Unit direction back to where it came from.
    wi: Vec3,
    /// Geometric normal on the side that it met.
    normal: Vec3,
    /// Flux over the cosine at that normal.
    flux: Vec3,
}

impl Photon {
    pub(super) fn at(vertex: &Vertex) -> Self {
        let (at, wi) = (&vertex.at, vertex.at.wo);
        let flux = vertex.throughput / geometric_cosine(at, wi);
        Self { position: at.position, wi, normal: at.facing_geometric(), flux }
    }
}

/// Photons in a balanced k-d tree: the middle of a slice divides it, along its longest extent.
#[derive(Clone, Debug, Default)]
pub struct Photons {
    /// With the axis that each divides.
    tree: Vec<(Photon, u8)>,
}

impl Photons {
    pub(super) fn new(photons: impl Iterator<Item = Photon>) -> Self {
        let usable = |p: &Photon| p.position.is_finite() && p.flux.is_finite();
        let mut tree: Vec<(Photon, u8)> = photons.filter(usable).map(|p| (p, 0)).collect();
        divide(&mut tree);
        Self { tree }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.tree.is_empty()
    }

    /// Radiance that a vertex scatters towards the eye of all photons within `radius`, as if one had been emitted; and
    /// the same within radius/√2.
    pub(super) fn around(&self, vertex: &Vertex, radius: f32) -> [Vec3; 2] {
        let mut sums = [Vec3::ZERO; 2];
        let (at, squared) = (&vertex.at, radius * radius);
        visit(&self.tree, at.position, radius, &mut |p, distance| {
            if distance > squared || p.normal.dot(at.facing_geometric()) <= 0.0 {
                return;
            }
            let cosine = p.wi.dot(at.facing_shading()).max(0.0);
            let light = vertex.bsdf.evaluate_all(at.wo, p.wi) * p.flux * cosine;
            sums[0] += light;
            if distance <= 0.5 * squared {
                sums[1] += light;
            }
        });
        let per_area = vertex.throughput / (PI * squared);
        [sums[0] * per_area, sums[1] * per_area * 2.0].map(|s| if s.is_finite() { s } else { Vec3::ZERO })
    }
}

fn divide(photons: &mut [(Photon, u8)]) {
    if photons.len() < 2 {
        return;
    }
    let low = photons.iter().fold(Vec3::INFINITY, |low, p| low.min(p.0.position));
    let extent = photons.iter().fold(Vec3::NEG_INFINITY, |high, p| high.max(p.0.position)) - low;
    let axis = extent.max_position();
    let middle = photons.len() / 2;
    photons.select_nth_unstable_by(middle, |a, b| a.0.position[axis].total_cmp(&b.0.position[axis]));
    photons[middle].1 = axis as u8;
    let (before, after) = photons.split_at_mut(middle);
    divide(before);
    divide(&mut after[1..]);
}

/// Visits photons of a slice near a point, each with its squared distance.
fn visit(photons: &[(Photon, u8)], point: Vec3, radius: f32, found: &mut impl FnMut(&Photon, f32)) {
    let middle = photons.len() / 2;
    let Some((photon, axis)) = photons.get(middle) else { return };
    found(photon, photon.position.distance_squared(point));
    let beyond = point[usize::from(*axis)] - photon.position[usize::from(*axis)];
    if beyond <= radius {
        visit(&photons[..middle], point, radius, found);
    }
    if beyond >= -radius {
        visit(&photons[middle + 1..], point, radius, found);
    }
}
