//! A tree of nodes with eight children over blocks of eight triangles, and the way of a single ray through it.
//!
//! Boxes are tested eight at a time ([`super::eight`]), and so are triangles ([`super::block`]). Hits do not depend on the
//! shape of the tree: of hits at one distance the lowest triangle counts.

use super::Ray;
use super::block::{Block, LEAF, Shear};
use super::collapse::{BinaryNode, Branch, Collapse};
use super::level::{Level, Vectors, Work};
use super::node::{Child, Node, Slabs};
use super::stack::{STACK, Stack};
use arrayvec::ArrayVec;
use bytemuck::Pod;
use glam::Vec3;
use prefetch_index::prefetch_index;
use rayon::prelude::*;

/// The tree.
#[derive(Clone, Debug, Default)]
pub(super) struct Wide {
    nodes: Vec<Node>,
    blocks: Vec<Block>,
    /// Entries that a traversal can need.
    stack: usize,
    /// Whether it is larger than the caches next to a processor's core.
    is_large: bool,
    level: Level,
}

/// A line of the cache.
type Line = [u8; 64];

/// Bytes of a large tree. In smaller ones, which the caches mostly hold, fetching early costs more than it saves.
const LARGE: usize = 16 << 20;

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
    /// Joins the nodes of a binary tree; `triangle` gives the corners of what a leaf holds and its index, flagged where it
    /// may be cut out. The tree is the same for any number of threads.
    ///
    /// # Panics
    /// If there are more than 2³¹ nodes or blocks, which no memory here holds.
    pub fn new(binary: Vec<BinaryNode>, triangle: impl Fn(u32) -> ([Vec3; 3], u32) + Sync) -> Self {
        if binary.is_empty() {
            return Self::default();
        }
        let collapse = Collapse::new(&binary);
        // The upper part here, large branches of it on several threads.
        let mut wide = Grown::default();
        let whole = Open { branch: collapse.root(), to: 0, below: 0 };
        let branches = wide.grow(&collapse, &triangle, whole, BRANCH);
        let alone = |&Open { branch, below, .. }: &Open| {
            let mut grown = Grown::default();
            grown.grow(&collapse, &triangle, Open { branch, to: 0, below }, 0);
            grown
        };
        let grown: Vec<Grown> = branches.par_iter().map(alone).collect();
        drop(collapse);
        drop(binary);
        wide.nodes.reserve_exact(grown.iter().map(|g| g.nodes.len()).sum());
        wide.blocks.reserve_exact(grown.iter().map(|g| g.blocks.len()).sum());
        for (open, branch) in branches.iter().zip(grown) {
            wide.graft(open.to, branch);
        }
        let Grown { nodes, blocks, deepest } = wide;
        assert!(nodes.len().max(blocks.len()) <= Child::INDEX_MAX, "more nodes than an index holds");
        Self::of(nodes, blocks, deepest + 1)
    }

    /// A tree of these parts, whose traversal needs `stack` entries.
    pub fn of(nodes: Vec<Node>, blocks: Vec<Block>, stack: usize) -> Self {
        let mut tree = Self { nodes, blocks, stack, ..Self::default() };
        tree.is_large = tree.size_bytes() > LARGE;
        tree
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

    /// Has the processor fetch what will be visited, where that is likely to be far away.
    #[inline(always)]
    fn fetch(&self, child: Child) {
        if self.is_large {
            if child.is_leaf() {
                fetch(&self.blocks, child.index());
            } else {
                fetch(&self.nodes, child.index());
            }
        }
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
        self.level.run(Traversal::<ORDERED, _> { tree: self, ray, on_hit });
    }
}

/// Nodes of a binary tree in a branch that grows on one thread.
const BRANCH: usize = 1 << 15;

/// A node that is still to be made.
struct Open {
    branch: Branch,
    /// Its index.
    to: usize,
    /// Entries on the stack when it is visited.
    below: usize,
}

/// A tree, or a branch of one, that grows.
#[derive(Default)]
struct Grown {
    nodes: Vec<Node>,
    blocks: Vec<Block>,
    /// Most entries on the stack.
    deepest: usize,
}

impl Grown {
    /// Makes the nodes and blocks of a branch, without its own branches of at most `smallest` nodes, which it returns.
    fn grow(
        &mut self,
        collapse: &Collapse,
        triangle: &impl Fn(u32) -> ([Vec3; 3], u32),
        root: Open,
        smallest: usize,
    ) -> Vec<Open> {
        self.nodes.push(Node::EMPTY);
        let mut open = vec![root];
        let mut left = Vec::new();
        while let Some(next) = open.pop() {
            if next.branch.len() <= smallest {
                left.push(next);
                continue;
            }
            let mut slot = 0;
            let begin = open.len();
            collapse.children(next.branch, &mut |branch| {
                let binary = collapse.node(branch);
                let child = if collapse.is_leaf(branch) {
                    let mut block = Block::EMPTY;
                    collapse.leaves(branch).for_each(|leaf| block.push(triangle(leaf)));
                    self.blocks.push(block);
                    Child::leaf(self.blocks.len() - 1)
                } else {
                    self.nodes.push(Node::EMPTY);
                    open.push(Open { branch, to: self.nodes.len() - 1, below: 0 });
                    Child::node(self.nodes.len() - 1)
                };
                let node = &mut self.nodes[next.to];
                for axis in 0..3 {
                    node.bounds[axis][slot] = binary.min[axis];
                    node.bounds[axis + 3][slot] = binary.max[axis];
                }
                node.child[slot] = child;
                slot += 1;
            });
            // All but one of the children wait below the one that is visited.
            let waiting = next.below + slot - 1;
            open[begin..].iter_mut().for_each(|inner| inner.below = waiting);
            self.deepest = self.deepest.max(waiting + 1);
        }
        left
    }

    /// Puts a branch in the place of the node `at`.
    fn graft(&mut self, at: usize, branch: Self) {
        let Self { mut nodes, blocks, deepest } = branch;
        // Its root, which no other node refers to, is there already.
        let (first_node, first_block) = (self.nodes.len() - 1, self.blocks.len());
        for child in nodes.iter_mut().flat_map(|node| &mut node.child) {
            *child = if child.is_leaf() {
                Child::leaf(first_block + child.index())
            } else if child.index() == 0 {
                *child
            } else {
                Child::node(first_node + child.index())
            };
        }
        self.nodes[at] = nodes[0];
        self.nodes.extend_from_slice(&nodes[1..]);
        self.blocks.extend(blocks);
        self.deepest = self.deepest.max(deepest);
    }
}

/// Has the processor fetch all of an element, if there is one of this index.
#[inline(always)]
fn fetch<T: Pod>(all: &[T], index: usize) {
    let lines: &[Line] = bytemuck::cast_slice(all);
    let count = size_of::<T>() / size_of::<Line>();
    for line in 0..count {
        prefetch_index(lines, index * count + line);
    }
}

/// A ray on its way.
struct Traversal<'a, const ORDERED: bool, F> {
    tree: &'a Wide,
    ray: &'a Ray,
    on_hit: F,
}

impl<const ORDERED: bool, F: FnMut(LeafHit) -> Option<f32>> Work for Traversal<'_, ORDERED, F> {
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

impl<const ORDERED: bool, F: FnMut(LeafHit) -> Option<f32>> Traversal<'_, ORDERED, F> {
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
                    current = stack.visit::<ORDERED>(node, &enter, mask, |child| tree.fetch(child));
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
            let node = |next: u32, is_leaf: bool| BinaryNode { min, max, next, is_leaf };
            // Each inner node has a leaf and the rest.
            let mut binary: Vec<BinaryNode> =
                (1..count).flat_map(|i| [node(2, false), node(i - 1, true)]).collect();
            binary.push(node(count - 1, true));
            let corners = |i: u32| [Vec3::ZERO, Vec3::X, Vec3::Y].map(|p| p + Vec3::Z * i as f32);
            let wide = Wide::new(binary, |leaf| (corners(leaf), leaf));
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
