//! Which nodes of a binary tree become nodes with eight children and which become leaves, at the least expected cost.
//!
//! A tree's cost is the sum over its nodes of surface area × cost of a visit (MacDonald & Booth 1990). The best way to make
//! the part of the tree below a node into at most i roots follows from the best ways for its children; the whole is found
//! from the leaves up (Ylitie, Karras & Laine 2017, §3.2).

use glam::Vec3;

use super::block::LEAF;
use super::node::CHILDREN;

/// A node of a binary tree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct BinaryNode {
    /// Lower corner of the (padded) box.
    pub min: Vec3,
    /// Upper corner.
    pub max: Vec3,
    /// First of two children that follow each other, or what a leaf holds.
    pub first: u32,
    /// Whether it holds a triangle.
    pub is_leaf: bool,
}

/// Cost of visiting a leaf, in visits of a node: its triangles are tested at once, but packets test them one by one.
fn leaf_cost(triangles: u32) -> f32 {
    0.8 + 0.05 * triangles as f32
}

/// How to make at most i roots of a part of the tree.
#[derive(Clone, Copy, Debug, Default)]
struct Ways {
    /// Least cost for i = 1 … 7 roots.
    cost: [f32; CHILDREN - 1],
    /// For 2 … 8 roots, how many of them the first child gets; 0 where fewer roots are as good.
    first: [u8; CHILDREN - 1],
    /// Triangles below.
    count: u32,
    /// Whether one root is best a leaf.
    is_leaf: bool,
}

/// The best ways through a tree.
pub(super) struct Collapse<'a> {
    binary: &'a [BinaryNode],
    ways: Vec<Ways>,
}

fn half_area(n: &BinaryNode) -> f32 {
    let e = n.max - n.min;
    e.x * e.y + e.y * e.z + e.z * e.x
}

impl<'a> Collapse<'a> {
    /// Finds them for all nodes below the first.
    pub fn new(binary: &'a [BinaryNode]) -> Self {
        let mut ways = vec![Ways::default(); binary.len()];
        // Parents before children; then from the end.
        let mut order = vec![0u32];
        let mut next = 0;
        while let Some(&at) = order.get(next) {
            next += 1;
            let node = &binary[at as usize];
            if !node.is_leaf {
                order.extend([node.first, node.first + 1]);
            }
        }
        for &at in order.iter().rev() {
            let node = &binary[at as usize];
            let area = half_area(node);
            if node.is_leaf {
                let cost = [area * leaf_cost(1); CHILDREN - 1];
                ways[at as usize] = Ways { cost, first: [0; CHILDREN - 1], count: 1, is_leaf: true };
                continue;
            }
            let (a, b) = (ways[node.first as usize], ways[node.first as usize + 1]);
            let mut here = Ways { count: a.count + b.count, ..Ways::default() };
            // Of 2 … 8 roots, so many to each child.
            let mut shared = [f32::INFINITY; CHILDREN - 1];
            for roots in 2..=CHILDREN {
                for first in 1..roots {
                    let second = roots - first;
                    let cost = a.cost[first - 1] + b.cost[second - 1];
                    // Areas that are no numbers any more still make a tree.
                    if first == 1 || cost < shared[roots - 2] {
                        shared[roots - 2] = cost;
                        here.first[roots - 2] = first as u8;
                    }
                }
            }
            let (as_node, as_leaf) = (area + shared[CHILDREN - 2], area * leaf_cost(here.count));
            here.is_leaf = here.count as usize <= LEAF && as_leaf <= as_node;
            here.cost[0] = if here.is_leaf { as_leaf } else { as_node };
            for roots in 2..CHILDREN {
                if shared[roots - 2] < here.cost[roots - 2] {
                    here.cost[roots - 1] = shared[roots - 2];
                } else {
                    here.cost[roots - 1] = here.cost[roots - 2];
                    here.first[roots - 2] = 0;
                }
            }
            ways[at as usize] = here;
        }
        Self { binary, ways }
    }

    /// Whether a root is to be a leaf.
    pub fn is_leaf(&self, at: u32) -> bool {
        self.ways[at as usize].is_leaf
    }

    /// Calls `child` with the children of the wide node that `at` becomes.
    pub fn children(&self, at: u32, child: &mut impl FnMut(u32)) {
        if self.is_leaf(at) {
            return child(at); // a tree that is one leaf
        }
        self.share(at, CHILDREN, child);
    }

    /// At most so many roots of the tree below `at`.
    fn roots(&self, at: u32, mut roots: usize, child: &mut impl FnMut(u32)) {
        let ways = &self.ways[at as usize];
        while roots >= 2 && ways.first[roots - 2] == 0 {
            roots -= 1;
        }
        if roots == 1 { child(at) } else { self.share(at, roots, child) }
    }

    fn share(&self, at: u32, roots: usize, child: &mut impl FnMut(u32)) {
        let (first, to_first) =
            (self.binary[at as usize].first, usize::from(self.ways[at as usize].first[roots - 2]));
        self.roots(first, to_first, child);
        self.roots(first + 1, roots - to_first, child);
    }

    /// Calls `leaf` with what the leaves below `at` hold.
    pub fn leaves(&self, at: u32, leaf: &mut impl FnMut(u32)) {
        let node = &self.binary[at as usize];
        if node.is_leaf {
            leaf(node.first);
        } else {
            self.leaves(node.first, leaf);
            self.leaves(node.first + 1, leaf);
        }
    }
}
