//! Nodes with four children, whose boxes are tested at once.

use glam::{Vec3, Vec4};

use super::offset::gamma;

/// Four children.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct Node {
    /// Lower x, y, z, then upper x, y, z of the four boxes. An unused child's box is (+∞, −∞).
    pub bounds: [Vec4; 6],
    /// What they are.
    pub child: [Child; 4],
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
            Vec4::INFINITY,
            Vec4::INFINITY,
            Vec4::INFINITY,
            Vec4::NEG_INFINITY,
            Vec4::NEG_INFINITY,
            Vec4::NEG_INFINITY,
        ],
        child: [Child(0); 4],
    };
}

/// A ray prepared for boxes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slabs {
    pub origin: [Vec4; 3],
    inverse: [Vec4; 3],
    near: [usize; 3],
    far: [usize; 3],
}

impl Slabs {
    #[inline]
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        let inverse = direction.recip();
        let side =
            |v: f32, axis: usize, near: bool| if v.is_sign_negative() == near { axis + 3 } else { axis };
        Self {
            origin: origin.to_array().map(Vec4::splat),
            inverse: inverse.to_array().map(Vec4::splat),
            near: [0, 1, 2].map(|a| side(inverse[a], a, true)),
            far: [0, 1, 2].map(|a| side(inverse[a], a, false)),
        }
    }

    /// Entry distances of the four boxes, and a bit for each that the ray meets in `[t_min, t_max]`.
    ///
    /// The exit is enlarged by 1 + 2γ(3), so that a box is never missed by rounding (Ize 2013). Where
    /// the origin lies on a slab that is parallel to the ray, 0·∞ is NaN; `max` and `min` then return
    /// their argument, so that the axis sets no bound.
    #[inline]
    pub fn intersect(&self, node: &Node, t_min: f32, t_max: f32) -> (Vec4, u32) {
        let plane = |axis: usize, side: usize| (node.bounds[side] - self.origin[axis]) * self.inverse[axis];
        let enter = plane(0, self.near[0])
            .max(plane(1, self.near[1]).max(plane(2, self.near[2]).max(Vec4::splat(t_min))));
        let leave = plane(0, self.far[0])
            .min(plane(1, self.far[1]).min(plane(2, self.far[2]).min(Vec4::splat(f32::MAX))))
            * (1.0 + 2.0 * gamma(3));
        let leave = leave.min(Vec4::splat(t_max));
        (enter, enter.cmple(leave).bitmask())
    }
}
