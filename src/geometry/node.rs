//! Nodes with eight children, whose boxes are tested at once.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::offset::gamma;
use super::simd::Simd;

/// Children of a node.
pub(super) const CHILDREN: usize = 8;

/// Eight children, in four lines of the cache.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C, align(64))]
pub(super) struct Node {
    /// Lower x, y, z, then upper x, y, z of the boxes. An unused child's box is (+∞, −∞).
    pub bounds: [[f32; CHILDREN]; 6],
    /// What they are.
    pub child: [Child; CHILDREN],
    /// Fills the line.
    pub unused: [u32; CHILDREN],
}

/// A reference to a node, or to a block of triangles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(transparent)]
pub(super) struct Child(pub u32);

impl Child {
    const LEAF: u32 = 1 << 31;
    /// Most nodes, and most blocks.
    pub const INDEX_MAX: usize = Self::LEAF as usize;

    /// A node.
    pub fn node(index: usize) -> Self {
        Self(index as u32)
    }

    /// A block.
    pub fn leaf(index: usize) -> Self {
        Self(Self::LEAF | index as u32)
    }

    /// Whether it is a block.
    #[inline]
    pub fn is_leaf(self) -> bool {
        self.0 & Self::LEAF != 0
    }

    /// Index of the node or the block.
    #[inline]
    pub fn index(self) -> usize {
        (self.0 & !Self::LEAF) as usize
    }
}

impl Node {
    /// No children.
    pub const EMPTY: Self = Self {
        bounds: [
            [f32::INFINITY; CHILDREN],
            [f32::INFINITY; CHILDREN],
            [f32::INFINITY; CHILDREN],
            [f32::NEG_INFINITY; CHILDREN],
            [f32::NEG_INFINITY; CHILDREN],
            [f32::NEG_INFINITY; CHILDREN],
        ],
        child: [Child(0); CHILDREN],
        unused: [0; CHILDREN],
    };
}

/// Exits are enlarged by this, so that a box is never missed by rounding: 1 + 2γ(3) (Ize 2013), and one more rounding,
/// since it is the inverse of the direction that is enlarged.
pub(super) const FAR: f32 = 1.0 + 2.0 * gamma(4);

/// A ray prepared for boxes.
#[derive(Clone, Copy)]
pub(super) struct Slabs<E: Simd<8>> {
    eight: E,
    start: [E::Lanes; 3],
    /// Inverse of the direction, for where the ray enters a slab and, a little larger, for where it leaves.
    inverse: [[E::Lanes; 3]; 2],
    t_min: E::Lanes,
    near: [usize; 3],
    far: [usize; 3],
}

impl<E: Simd<8>> Slabs<E> {
    #[inline(always)]
    pub fn new(eight: E, origin: Vec3, direction: Vec3, t_min: f32) -> Self {
        let inverse = direction.recip();
        let side =
            |v: f32, axis: usize| if v.is_sign_negative() { [axis + 3, axis] } else { [axis, axis + 3] };
        let [x, y, z] = [side(inverse.x, 0), side(inverse.y, 1), side(inverse.z, 2)];
        let lanes = |v: Vec3| [eight.splat(v.x), eight.splat(v.y), eight.splat(v.z)];
        Self {
            eight,
            start: lanes(origin),
            inverse: [lanes(inverse), lanes(inverse * FAR)],
            t_min: eight.splat(t_min),
            near: [x[0], y[0], z[0]],
            far: [x[1], y[1], z[1]],
        }
    }

    /// Entry distances of the boxes, and a bit for each that the ray meets in `[t_min, t_max]`.
    ///
    /// Where the origin lies on a slab that is parallel to the ray, 0·∞ is NaN; `max` and `min` then return their second
    /// operand, so that the axis (or both of a pair) sets no bound.
    #[inline(always)]
    pub fn intersect(&self, node: &Node, t_max: f32) -> ([f32; CHILDREN], u32) {
        let e = self.eight;
        let plane = |axis: usize, side: usize, inverse: &[E::Lanes; 3]| {
            e.mul(e.sub(e.load(&node.bounds[side]), self.start[axis]), inverse[axis])
        };
        let ([x, y, z], [to_x, to_y, to_z], [near, far]) = (self.near, self.far, &self.inverse);
        // In pairs, since what follows waits for the result.
        let enter = e.max(e.max(plane(0, x, near), plane(1, y, near)), e.max(plane(2, z, near), self.t_min));
        let leave = e
            .min(e.min(plane(0, to_x, far), plane(1, to_y, far)), e.min(plane(2, to_z, far), e.splat(t_max)));
        (e.store(enter), e.bits(e.at_most(enter, leave)))
    }
}
