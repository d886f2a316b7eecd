//! A tree of nodes with eight children over blocks of eight triangles, and the way of a single ray through it.
//!
//! Boxes are tested eight at a time ([`super::eight`]), and so are triangles ([`super::block`]). Hits do not depend on the
//! shape of the tree: of hits at one distance the lowest triangle counts.

use super::Ray;
use super::block::{Block, LEAF, Shear};
use super::collapse::{BinaryNode, Collapse};
use super::level::{Level, Vectors, Work};
use super::node::{Child, Node, Slabs};
use super::stack::{STACK, Stack};
use arrayvec::ArrayVec;
use glam::Vec3;

/// The tree.
#[derive(Clone, Debug, Default)]
pub(super) struct Wide {
    nodes: Vec<Node>,
    blocks: Vec<Block>,
    /// Entries that a traversal can need.
    stack: usize,
    level: Level,
}

/// A hit.
#[derive(Clone, Copy, Debug)]
pub(super) struct LeafHit {
    pub t: f32,
    /// The triangle, with [`CUT_OUT`](super::block::CUT_OUT) where it may not be there.
    pub triangle: u32,
    pub b1: f32,
    pub b2: f32,
}

impl Wide {
    /// Joins the nodes of a binary tree; `triangle` gives the corners of a leaf's triangle and its index, flagged where it
    /// may be cut out.
    ///
    /// # Panics
    /// If there are more than 2³¹ nodes or blocks, which no memory here holds.
    pub fn new(binary: &[BinaryNode], triangle: impl Fn(u32) -> ([Vec3; 3], u32)) -> Self {
        if binary.is_empty() {
            return Self::default();
        }
        let collapse = Collapse::new(binary);
        let mut wide = Self { nodes: vec![Node::EMPTY], ..Self::default() };
        let mut deepest = 1;
        // (index in `binary`, index in `wide.nodes`, entries on the stack when it is opened)
        let mut open = vec![(0, 0usize, 0usize)];
        while let Some((from, to, below)) = open.pop() {
            let mut slot = 0;
            let begin = open.len();
            collapse.children(from, &mut |index| {
                let node = &binary[index as usize];
                for axis in 0..3 {
                    wide.nodes[to].bounds[axis][slot] = node.min[axis];
                    wide.nodes[to].bounds[axis + 3][slot] = node.max[axis];
                }
                wide.nodes[to].child[slot] = if collapse.is_leaf(index) {
                    let mut block = Block::EMPTY;
                    collapse.leaves(index, &mut |leaf| block.push(triangle(leaf)));
                    wide.blocks.push(block);
                    Child::leaf(wide.blocks.len() - 1)
                } else {
                    wide.nodes.push(Node::EMPTY);
                    open.push((index, wide.nodes.len() - 1, 0));
                    Child::node(wide.nodes.len() - 1)
                };
                slot += 1;
            });
            // All but one of the children wait below the one that is visited.
            let waiting = below + slot - 1;
            open[begin..].iter_mut().for_each(|inner| inner.2 = waiting);
            deepest = deepest.max(waiting + 1);
        }
        assert!(
            wide.nodes.len().max(wide.blocks.len()) <= Child::INDEX_MAX,
            "more nodes than an index holds"
        );
        wide.stack = deepest + 1;
        wide
    }

    /// Bytes held.
    pub fn size_bytes(&self) -> usize {
        self.nodes.len() * size_of::<Node>() + self.blocks.len() * size_of::<Block>()
    }

    /// Whether it holds nothing.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.nodes.is_empty()
    }

    /// Nodes, the first of them the root, and blocks.
    #[inline]
    pub fn parts(&self) -> (&[Node], &[Block]) {
        (&self.nodes, &self.blocks)
    }

    /// The instructions it was made for.
    #[inline]
    pub fn level(&self) -> Level {
        self.level
    }

    /// From now on with other instructions.
    #[cfg(test)]
    pub fn set_level(&mut self, level: Level) {
        self.level = level;
    }

    /// Entries that a traversal can need.
    pub fn stack(&self) -> usize {
        self.stack
    }

    /// Calls `on_hit` with hits, near ones first by and large if `ORDERED`; it returns the distance up to which
    /// (inclusive) hits still matter, or `None` to stop.
    #[inline]
    pub fn traverse<const ORDERED: bool>(&self, ray: &Ray, on_hit: impl FnMut(LeafHit) -> Option<f32>) {
        if self.nodes.is_empty()
            || !ray.direction.is_finite()
            || !ray.origin.is_finite()
            || ray.direction == Vec3::ZERO
        {
            return;
        }
        self.level.run(Walk::<ORDERED, _> { tree: self, ray, on_hit });
    }
}

/// A ray on its way.
struct Walk<'a, const ORDERED: bool, F> {
    tree: &'a Wide,
    ray: &'a Ray,
    on_hit: F,
}

impl<const ORDERED: bool, F: FnMut(LeafHit) -> Option<f32>> Work for Walk<'_, ORDERED, F> {
    type Output = ();
    const SIXTEEN: bool = false;

    #[inline(always)]
    fn run<V: Vectors>(self, v: V) {
        let most = self.tree.stack;
        if most <= STACK {
            self.go(v, &mut ArrayVec::<_, STACK>::new());
        } else {
            self.go(v, &mut Vec::with_capacity(most));
        }
    }
}

impl<const ORDERED: bool, F: FnMut(LeafHit) -> Option<f32>> Walk<'_, ORDERED, F> {
    #[inline(always)]
    fn go<V: Vectors>(mut self, v: V, stack: &mut impl Stack) {
        let (tree, ray) = (self.tree, self.ray);
        let t_min = ray.t_min.max(0.0);
        let slabs = Slabs::new(v, ray.origin, ray.direction, t_min);
        let shear = Shear::new(v, ray.origin, ray.direction);
        // A hit at t_max itself does not count.
        let mut t_max = ray.t_max.next_down();
        let mut current = Child::node(0);
        loop {
            if current.is_leaf() {
                let block = &tree.blocks[current.index()];
                if let Some(lanes) = block.intersect(v, &shear, t_min, t_max) {
                    let mut mask = lanes.mask;
                    while mask != 0 {
                        let lane = mask.trailing_zeros() as usize & (LEAF - 1);
                        mask &= mask - 1;
                        if lanes.t[lane] > t_max {
                            continue;
                        }
                        let hit = LeafHit {
                            t: lanes.t[lane],
                            triangle: block.index[lane],
                            b1: lanes.b1[lane],
                            b2: lanes.b2[lane],
                        };
                        match (self.on_hit)(hit) {
                            Some(t) => t_max = t_max.min(t),
                            None => return,
                        }
                    }
                }
            } else {
                let node = &tree.nodes[current.index()];
                let (enter, mask) = slabs.intersect(node, t_max);
                if mask != 0 {
                    current = stack.visit::<ORDERED>(node, &enter, mask);
                    continue;
                }
            }
            loop {
                let Some(next) = stack.pop() else { return };
                if !ORDERED || next.t() <= t_max {
                    current = next.child();
                    break;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Chains, whose trees are deeper than the usual stack.
    #[test]
    fn deep_trees_lose_nothing() {
        for count in [1u32, 2, 8, 9, 96, 1000] {
            let (min, max) = (-Vec3::ONE, Vec3::splat(count as f32 + 1.0));
            let leaf = |first: u32| BinaryNode { min, max, first, is_leaf: true };
            let mut binary = vec![leaf(0)];
            for i in 1..count {
                // The last leaf opens into two.
                let last = binary.len() - 1;
                binary[last] = BinaryNode { first: binary.len() as u32, is_leaf: false, ..binary[last] };
                binary.extend([leaf(i - 1), leaf(i)]);
            }
            let corners = |i: u32| [Vec3::ZERO, Vec3::X, Vec3::Y].map(|p| p + Vec3::Z * i as f32);
            let wide = Wide::new(&binary, |leaf| (corners(leaf), leaf));
            assert_eq!(wide.stack() > STACK, count == 1000, "{count}: {}", wide.stack());
            let mut seen = vec![0; count as usize];
            let ray = Ray::new(Vec3::new(0.25, 0.25, -1.0), Vec3::Z);
            wide.traverse::<true>(&ray, |hit| {
                assert_eq!(hit.t, hit.triangle as f32 + 1.0);
                seen[hit.triangle as usize] += 1;
                Some(f32::INFINITY)
            });
            assert!(seen.iter().all(|&n| n == 1), "{count}: {seen:?}");
        }
    }
}
