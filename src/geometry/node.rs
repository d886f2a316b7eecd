//! Nodes with eight children, whose boxes are tested at once.

use glam::{Vec3, Vec4};

use super::eight::Eight;
use super::offset::gamma;

/// Children of a node.
pub(super) const CHILDREN: usize = 8;

/// Eight children.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub(super) struct Node {
    /// Lower x, y, z, then upper x, y, z of the boxes. An unused child's box is (+∞, −∞).
    pub bounds: [[f32; CHILDREN]; 6],
    /// What they are.
    pub child: [Child; CHILDREN],
}

/// A reference to a node, or to a few blocks of triangles in a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Child(pub u32);

impl Child {
    const LEAF: u32 = 1 << 31;
    const COUNT_SHIFT: u32 = 28;
    /// Most blocks of a leaf.
    pub const BLOCKS_MAX: usize = 8;
    /// Most nodes, and most blocks.
    pub const INDEX_MAX: usize = (1 << Self::COUNT_SHIFT) - 1;

    /// A node.
    pub fn node(index: usize) -> Self {
        Self(index as u32)
    }

    /// The blocks `first … first + count`, 1 to [`Self::BLOCKS_MAX`] of them.
    pub fn leaf(first: usize, count: usize) -> Self {
        Self(Self::LEAF | (count as u32 - 1) << Self::COUNT_SHIFT | first as u32)
    }

    /// Whether it is a leaf.
    #[inline]
    pub fn is_leaf(self) -> bool {
        self.0 & Self::LEAF != 0
    }

    /// Index of the node or of the first block.
    #[inline]
    pub fn index(self) -> usize {
        self.0 as usize & Self::INDEX_MAX
    }

    /// Number of blocks of a leaf.
    #[inline]
    pub fn block_count(self) -> usize {
        (self.0 >> Self::COUNT_SHIFT & 7) as usize + 1
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
    };
}

/// A ray prepared for boxes.
#[derive(Clone, Copy)]
pub(super) struct Slabs<E: Eight> {
    eight: E,
    /// For triangles, which are tested four at a time.
    pub origin: [Vec4; 3],
    start: [E::Lanes; 3],
    inverse: [E::Lanes; 3],
    t_min: E::Lanes,
    near: [usize; 3],
    far: [usize; 3],
}

impl<E: Eight> Slabs<E> {
    #[inline(always)]
    pub fn new(eight: E, origin: Vec3, direction: Vec3, t_min: f32) -> Self {
        let inverse = direction.recip();
        let side =
            |v: f32, axis: usize, near: bool| if v.is_sign_negative() == near { axis + 3 } else { axis };
        Self {
            eight,
            origin: origin.to_array().map(Vec4::splat),
            start: [eight.splat(origin.x), eight.splat(origin.y), eight.splat(origin.z)],
            inverse: [eight.splat(inverse.x), eight.splat(inverse.y), eight.splat(inverse.z)],
            t_min: eight.splat(t_min),
            near: [side(inverse.x, 0, true), side(inverse.y, 1, true), side(inverse.z, 2, true)],
            far: [side(inverse.x, 0, false), side(inverse.y, 1, false), side(inverse.z, 2, false)],
        }
    }

    /// Entry distances of the boxes, and a bit for each that the ray meets in `[t_min, t_max]`.
    ///
    /// The exit is enlarged by 1 + 2γ(3), so that a box is never missed by rounding (Ize 2013). Where
    /// the origin lies on a slab that is parallel to the ray, 0·∞ is NaN; `max` and `min` then return
    /// their second operand, so that the axis sets no bound.
    #[inline(always)]
    pub fn intersect(&self, node: &Node, t_max: f32) -> ([f32; CHILDREN], u32) {
        let e = self.eight;
        let plane = |axis: usize, side: usize| {
            e.mul(e.sub(e.load(&node.bounds[side]), self.start[axis]), self.inverse[axis])
        };
        let enter = e.max(plane(2, self.near[2]), self.t_min);
        let enter = e.max(plane(0, self.near[0]), e.max(plane(1, self.near[1]), enter));
        let leave = e.min(plane(2, self.far[2]), e.splat(f32::MAX));
        let leave = e.min(plane(0, self.far[0]), e.min(plane(1, self.far[1]), leave));
        let leave = e.min(e.mul(leave, e.splat(1.0 + 2.0 * gamma(3))), e.splat(t_max));
        (e.store(enter), e.at_most(enter, leave))
    }
}
