//! A tree of nodes with eight children over blocks of four triangles, for single rays.
//!
//! Boxes are tested eight at a time, with AVX2 where there is it ([`super::eight`]), triangles four at a time through
//! `glam`. Hits do not depend on the shape of the tree: of hits at one distance the lowest index counts.

use super::Ray;
use super::block::{Block, Shear};
use super::eight::{Eight, Level, Work};
use super::node::{CHILDREN, Child, Node, Slabs};
use super::packet::FlatNode;
use glam::Vec3;

/// Entries of the stack that lies on the thread's own stack; deeper trees get a heap allocation.
const STACK: usize = 64;

/// The tree. Indices are those of the binary tree's leaf order.
#[derive(Clone, Debug, Default)]
pub(super) struct Wide {
    nodes: Vec<Node>,
    blocks: Vec<Block>,
    /// Entries that a traversal can need.
    stack: usize,
    level: Level,
}

/// A hit, of the triangle at `index` in leaf order.
#[derive(Clone, Copy, Debug)]
pub(super) struct LeafHit {
    pub t: f32,
    pub index: u32,
    pub b1: f32,
    pub b2: f32,
}

/// What is still to be visited: entry distance (as bits, which sort as the distances do) above, child below.
#[derive(Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Entry(u64);

impl Entry {
    #[inline]
    pub fn new(t: f32, child: Child) -> Self {
        Self(u64::from(t.to_bits()) << 32 | u64::from(child.0))
    }

    #[inline]
    pub fn t(self) -> f32 {
        f32::from_bits((self.0 >> 32) as u32)
    }

    #[inline]
    pub fn child(self) -> Child {
        Child(self.0 as u32)
    }
}

fn half_area(n: &FlatNode) -> f32 {
    let e = Vec3::from_array(n.max) - Vec3::from_array(n.min);
    e.x * e.y + e.y * e.z + e.z * e.x
}

impl Wide {
    /// Joins the nodes of a binary tree: the child with the largest surface opens until there are eight.
    ///
    /// # Panics
    /// If there are more than 2²⁸ nodes or blocks, which no memory here holds.
    pub fn new(binary: &[FlatNode], corners: &[[Vec3; 3]]) -> Self {
        if binary.is_empty() {
            return Self::default();
        }
        let mut wide = Self { nodes: vec![Node::EMPTY], ..Self::default() };
        let mut deepest = 1;
        // (index in `binary`, index in `wide.nodes`, entries on the stack when it is opened)
        let mut open = vec![(0usize, 0usize, 0usize)];
        while let Some((from, to, below)) = open.pop() {
            let mut children = [from; CHILDREN];
            let mut count = 1;
            while count < CHILDREN {
                let inner = (0..count).filter(|&i| binary[children[i]].count == 0);
                let area = |i: usize| half_area(&binary[children[i]]);
                let Some(i) = inner.max_by(|&a, &b| area(a).total_cmp(&area(b))) else { break };
                let first = binary[children[i]].first as usize;
                children[i] = first;
                children[count] = first + 1;
                count += 1;
            }
            // All but one of the children wait below the one that is visited.
            let waiting = below + count - 1;
            deepest = deepest.max(waiting + 1);
            for (slot, &index) in children[..count].iter().enumerate() {
                let node = &binary[index];
                for axis in 0..3 {
                    wide.nodes[to].bounds[axis][slot] = node.min[axis];
                    wide.nodes[to].bounds[axis + 3][slot] = node.max[axis];
                }
                wide.nodes[to].child[slot] = if node.count > 0 && node.count as usize <= 4 * Child::BLOCKS_MAX
                {
                    wide.leaf(corners, node.first as usize, node.count as usize)
                } else {
                    wide.nodes.push(Node::EMPTY);
                    let child = wide.nodes.len() - 1;
                    if node.count > 0 {
                        // Many triangles in one place: a row of nodes with the same box.
                        let nodes = wide.row(corners, node, child);
                        deepest = deepest.max(waiting + nodes * (CHILDREN - 1) + 1);
                    } else {
                        open.push((index, child, waiting));
                    }
                    Child::node(child)
                };
            }
        }
        assert!(
            wide.nodes.len().max(wide.blocks.len()) <= Child::INDEX_MAX,
            "more nodes than an index holds"
        );
        wide.stack = deepest + 1;
        wide
    }

    fn leaf(&mut self, corners: &[[Vec3; 3]], first: usize, count: usize) -> Child {
        let start = self.blocks.len();
        for chunk in (first..first + count).step_by(4) {
            let mut block = Block::EMPTY;
            for (lane, triangle) in corners[chunk..(chunk + 4).min(first + count)].iter().enumerate() {
                block.set(lane, *triangle, (chunk + lane) as u32);
            }
            self.blocks.push(block);
        }
        Child::leaf(start, self.blocks.len() - start)
    }

    /// Fills node `at` and new ones after it with a leaf too large for one; returns how many nodes deep.
    fn row(&mut self, corners: &[[Vec3; 3]], leaf: &FlatNode, mut at: usize) -> usize {
        let (mut first, mut left, mut depth) = (leaf.first as usize, leaf.count as usize, 1);
        loop {
            for slot in 0..CHILDREN {
                for axis in 0..3 {
                    self.nodes[at].bounds[axis][slot] = leaf.min[axis];
                    self.nodes[at].bounds[axis + 3][slot] = leaf.max[axis];
                }
                let here = left.min(4 * Child::BLOCKS_MAX);
                if slot == CHILDREN - 1 && left > here {
                    self.nodes.push(Node::EMPTY);
                    self.nodes[at].child[slot] = Child::node(self.nodes.len() - 1);
                    at = self.nodes.len() - 1;
                    depth += 1;
                    break;
                }
                self.nodes[at].child[slot] = self.leaf(corners, first, here);
                first += here;
                left -= here;
                if left == 0 {
                    return depth;
                }
            }
        }
    }

    /// Bytes held.
    pub fn size_bytes(&self) -> usize {
        self.nodes.len() * size_of::<Node>() + self.blocks.len() * size_of::<Block>()
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

    /// From now on with what every processor has.
    #[cfg(test)]
    pub fn make_portable(&mut self) {
        self.level = Level::portable();
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

    #[inline(always)]
    fn run<E: Eight>(self, eight: E) {
        if self.tree.stack <= STACK {
            self.go(eight, &mut [Entry(0); STACK]);
        } else {
            let mut stack = vec![Entry(0); self.tree.stack];
            self.go(eight, &mut stack);
        }
    }
}

impl<const ORDERED: bool, F: FnMut(LeafHit) -> Option<f32>> Walk<'_, ORDERED, F> {
    #[inline(always)]
    fn go<E: Eight>(mut self, eight: E, stack: &mut [Entry]) {
        let (tree, ray) = (self.tree, self.ray);
        let t_min = ray.t_min.max(0.0);
        let slabs = Slabs::new(eight, ray.origin, ray.direction, t_min);
        let shear = Shear::new(ray.direction);
        // A hit at t_max itself does not count.
        let mut t_max = ray.t_max.next_down();
        let mut top = 0;
        let mut current = Child::node(0);
        loop {
            if current.is_leaf() {
                let first = current.index();
                for block in &tree.blocks[first..first + current.block_count()] {
                    let Some(lanes) = block.intersect(slabs.origin, &shear, t_min, t_max) else { continue };
                    let mut mask = lanes.mask;
                    while mask != 0 {
                        let lane = mask.trailing_zeros() as usize & 3;
                        mask &= mask - 1;
                        if lanes.t[lane] > t_max {
                            continue;
                        }
                        let hit = LeafHit {
                            t: lanes.t[lane],
                            index: block.index[lane],
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
                let (enter, mut mask) = slabs.intersect(node, t_max);
                if mask != 0 {
                    let mut slot = mask.trailing_zeros() as usize & (CHILDREN - 1);
                    mask &= mask - 1;
                    let mut nearest = Entry::new(enter[slot], node.child[slot]);
                    let base = top;
                    while mask != 0 {
                        slot = mask.trailing_zeros() as usize & (CHILDREN - 1);
                        mask &= mask - 1;
                        let mut entry = Entry::new(enter[slot], node.child[slot]);
                        if ORDERED {
                            // Insertion, the nearest on top and the very nearest in hand.
                            if entry.0 < nearest.0 {
                                std::mem::swap(&mut entry, &mut nearest);
                            }
                            let mut i = top;
                            while i > base && stack[i - 1].0 < entry.0 {
                                stack[i] = stack[i - 1];
                                i -= 1;
                            }
                            stack[i] = entry;
                        } else {
                            stack[top] = entry;
                        }
                        top += 1;
                    }
                    current = nearest.child();
                    continue;
                }
            }
            loop {
                if top == 0 {
                    return;
                }
                top -= 1;
                if !ORDERED || stack[top].t() <= t_max {
                    current = stack[top].child();
                    break;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(min: Vec3, max: Vec3, first: u32, count: u32) -> FlatNode {
        FlatNode { min: min.to_array(), first, max: max.to_array(), count }
    }

    /// Leaves of any size, and trees deeper than the usual stack.
    #[test]
    fn large_leaves_and_deep_trees_lose_nothing() {
        for count in [1usize, 4, 5, 32, 33, 96, 97, 128, 129, 1000] {
            let corners: Vec<[Vec3; 3]> =
                (0..count).map(|i| [Vec3::ZERO, Vec3::X, Vec3::Y].map(|p| p + Vec3::Z * i as f32)).collect();
            let (min, max) = (-Vec3::ONE, Vec3::splat(count as f32 + 1.0));
            // One leaf; and a chain in which every inner node has one leaf and the rest.
            let mut chain = vec![flat(min, max, 1, 0)];
            for i in 0..count as u32 - 1 {
                let rest = if i as usize + 2 == count { (i + 1, 1) } else { (chain.len() as u32 + 2, 0) };
                chain.push(flat(min, max, i, 1));
                chain.push(flat(min, max, rest.0, rest.1));
            }
            if count == 1 {
                chain = vec![flat(min, max, 0, 1)];
            }
            for binary in [vec![flat(min, max, 0, count as u32)], chain] {
                let wide = Wide::new(&binary, &corners);
                let mut seen = vec![0; count];
                let ray = Ray::new(Vec3::new(0.25, 0.25, -1.0), Vec3::Z);
                wide.traverse::<true>(&ray, |hit| {
                    assert_eq!(hit.t, hit.index as f32 + 1.0);
                    seen[hit.index as usize] += 1;
                    Some(f32::INFINITY)
                });
                assert!(seen.iter().all(|&n| n == 1), "{count}: {seen:?}");
            }
        }
    }
}
