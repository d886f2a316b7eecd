//! Which sides of elements are part of kernels: those that light can reach, and that are not so large that most of them
//! lies elsewhere.

use rayon::prelude::*;

use super::bake::{BLOCK, Baker};
use crate::rng::Stream;
use crate::transport::particle::SurfacePoint;

/// Width of a gap that counts as closed, as a share of the scene's size.
const GAP: f32 = 0.01;
/// An element that gets less than this share of the mean irradiance may lie inside a body or a gap.
const DIM: f32 = 0.1;
/// A block of elements on which fewer particles arrived than this is judged by the blocks around it.
const FEW_ARRIVALS: f32 = 64.0;
/// As many blocks of neighbours in storage are judged together.
const BLOCKS_AROUND: usize = 64;
/// An element out of sight that is so many times larger than a texel is no part of kernels.
const COARSE: f32 = 16.0;
/// Rays that decide whether an element lies inside a body.
const BURIED_RAYS: u64 = 8;

impl Baker<'_> {
    /// Out of sight and so large that most of it lies elsewhere than the kernels that would hold it.
    pub(super) fn is_coarse(&self, e: usize) -> bool {
        !self.watched[e] && self.atlas.elements[e].area * self.atlas.texels_per_unit.powi(2) > COARSE
    }

    /// Sides of elements inside a body, such as the floor under a box, or in a gap, such as the cupboard behind its door:
    /// next to nothing arrives there, and in all directions the inside of something or something near is seen. A kernel
    /// that held them would darken what lies before them. What is seen of bodies wound inside out are their backs.
    pub(super) fn open_sides(&self, lit_back: &[bool]) -> Vec<[bool; 2]> {
        let area: f32 = self.atlas.elements.iter().map(|e| e.opaque).sum();
        let dim = DIM * self.bins.total_count() as f32 / area.max(f32::MIN_POSITIVE);
        let elements = (0..self.atlas.elements.len()).into_par_iter();
        elements.map(|e| [false, true].map(|back| self.is_open(e, back, dim, lit_back))).collect()
    }

    /// `dim` arrivals per area are next to nothing.
    fn is_open(&self, e: usize, back: bool, dim: f32, lit_back: &[bool]) -> bool {
        if back && !lit_back[e / BLOCK] || self.is_coarse(e) {
            return false;
        }
        let element = &self.atlas.elements[e];
        let at = SurfacePoint { triangle: element.triangle, b1: element.b1, b2: element.b2 };
        let near = GAP * self.diagonal;
        // A first picture has no time to ask.
        let buried = !self.coarse
            && element.area > 0.0
            && self.bins.arrived(e as u32, back).count <= dim * element.opaque
            && !self.direct[e][usize::from(back)].is_lit()
            && !self.is_late()
            && (0..BURIED_RAYS).all(|ray| {
                let mut stream = Stream::new(0xb0d1, e as u64, ray);
                self.transport.sees_inside(at, back, near, &mut stream)
            });
        !buried
    }

    /// Per block of elements, whether anything arrives on their backs. A block that is too small to tell, such as the
    /// mouldings of a window, is like the blocks around it.
    pub(super) fn lit_backs(&self) -> Vec<bool> {
        let elements = self.atlas.elements.len();
        let of_block = |block: usize| {
            let members = block * BLOCK..((block + 1) * BLOCK).min(elements);
            let count = |back: bool| -> f32 {
                members.clone().map(|e| self.bins.arrived(e as u32, back).count).sum()
            };
            let direct = members.clone().any(|e| self.direct[e][1].is_lit());
            (direct, count(false), count(true))
        };
        // Rounding lets one particle in a million slip out through an edge where walls meet.
        let more = |front: f32, back: f32| back > 1e-3 * front;
        let found: Vec<(bool, f32, f32)> =
            (0..elements.div_ceil(BLOCK)).into_par_iter().map(of_block).collect();
        let mut lit = Vec::with_capacity(found.len());
        for region in found.chunks(BLOCKS_AROUND) {
            let around = region.iter().fold((0.0, 0.0), |sum, b| (sum.0 + b.1, sum.1 + b.2));
            lit.extend(region.iter().map(|&(direct, front, back)| {
                let few = front + back < FEW_ARRIVALS;
                direct || more(front, back) || few && more(around.0, around.1)
            }));
        }
        lit
    }
}
