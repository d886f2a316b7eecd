//! Which nodes of a binary tree become nodes with eight children and which become leaves, at the least expected cost.
//!
//! A tree's cost is the sum over its nodes of surface area × cost of a visit (MacDonald & Booth 1990). The best way to make
//! the part of the tree below a node into at most i roots follows from the best ways for its children; the whole is found
//! from the leaves up (Ylitie, Karras & Laine 2017, §3.2).

use glam::Vec3;

use super::block::LEAF;
use super::node::CHILDREN;

/// A node of a binary tree in depth-first order: behind it lie its first child with all below that, then the second with
/// all below that.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct BinaryNode {
    /// Lower corner of the (padded) box.
    pub min: Vec3,
    /// Upper corner.
    pub max: Vec3,
    /// How far behind it the second child is, or what a leaf holds.
    pub next: u32,
    /// Whether it holds a triangle.
    pub is_leaf: bool,
}

/// Cost of visiting a leaf, in visits of a node: its triangles are tested at once, but packets test them one by one.
fn leaf_cost(triangles: u32) -> f32 {
    0.8 + 0.05 * triangles as f32
}

/// How well at most i roots can be made of a part of the tree.
#[derive(Clone, Copy, Debug)]
struct Ways {
    /// Least cost for i = 1 … 7 roots.
    cost: [f32; CHILDREN - 1],
    /// Triangles below.
    count: u32,
}

/// How they are made.
#[derive(Clone, Copy, Debug, Default)]
struct Choice {
    /// For 2 … 8 roots, how many of them the first child gets; 0 where fewer roots are as good.
    first: [u8; CHILDREN - 1],
    /// Whether one root is best a leaf.
    is_leaf: bool,
}

/// A node with all below it: where they begin and end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Branch {
    /// The node.
    pub from: usize,
    /// Behind the last one.
    pub to: usize,
}

impl Branch {
    /// Number of nodes.
    pub fn len(self) -> usize {
        self.to - self.from
    }
}

/// The best ways through a tree.
pub(super) struct Collapse<'a> {
    binary: &'a [BinaryNode],
    choices: Vec<Choice>,
}

fn half_area(n: &BinaryNode) -> f32 {
    let e = n.max - n.min;
    e.x * e.y + e.y * e.z + e.z * e.x
}

/// The ways of a node from those of its children.
fn joined(node: &BinaryNode, a: &Ways, b: &Ways, choice: &mut Choice) -> Ways {
    let area = half_area(node);
    // Of 2 … 8 roots, so many to each child.
    let mut shared = [f32::INFINITY; CHILDREN - 1];
    for roots in 2..=CHILDREN {
        for first in 1..roots {
            let cost = a.cost[first - 1] + b.cost[roots - first - 1];
            // Areas that are no numbers any more still make a tree.
            if first == 1 || cost < shared[roots - 2] {
                shared[roots - 2] = cost;
                choice.first[roots - 2] = first as u8;
            }
        }
    }
    let count = a.count + b.count;
    let (as_node, as_leaf) = (area + shared[CHILDREN - 2], area * leaf_cost(count));
    choice.is_leaf = count as usize <= LEAF && as_leaf <= as_node;
    let mut cost = [if choice.is_leaf { as_leaf } else { as_node }; CHILDREN - 1];
    for roots in 2..CHILDREN {
        if shared[roots - 2] < cost[roots - 2] {
            cost[roots - 1] = shared[roots - 2];
        } else {
            cost[roots - 1] = cost[roots - 2];
            choice.first[roots - 2] = 0;
        }
    }
    Ways { cost, count }
}

/// Below so many nodes, or after so many forks, a thread works alone.
const ALONE: usize = 1 << 14;
const FORKS: u32 = 12;

/// Finds the best ways of a branch, the last nodes first.
fn best(binary: &[BinaryNode], choices: &mut [Choice], forks: u32) -> Ways {
    if forks > 0 && binary.len() > ALONE {
        let second = binary[0].next as usize;
        let (choices, of_second) = choices.split_at_mut(second);
        let (own, of_first) = choices.split_at_mut(1);
        let (a, b) = rayon::join(
            || best(&binary[1..second], of_first, forks - 1),
            || best(&binary[second..], of_second, forks - 1),
        );
        return joined(&binary[0], &a, &b, &mut own[0]);
    }
    // Branches whose parent has not come yet, the first of them last.
    let mut open: Vec<Ways> = Vec::new();
    for (node, choice) in binary.iter().zip(choices).rev() {
        let ways = if node.is_leaf {
            choice.is_leaf = true;
            Ways { cost: [half_area(node) * leaf_cost(1); CHILDREN - 1], count: 1 }
        } else {
            let [a, b] = [(); 2].map(|()| open.pop().expect("children come behind their parents"));
            joined(node, &a, &b, choice)
        };
        open.push(ways);
    }
    open.pop().expect("a branch has a node")
}

impl<'a> Collapse<'a> {
    /// Finds them for all nodes of a tree, which has one at least.
    pub fn new(binary: &'a [BinaryNode]) -> Self {
        let mut choices = vec![Choice::default(); binary.len()];
        best(binary, &mut choices, FORKS);
        Self { binary, choices }
    }

    /// All of the tree.
    pub fn root(&self) -> Branch {
        Branch { from: 0, to: self.binary.len() }
    }

    /// A root.
    pub fn node(&self, branch: Branch) -> &BinaryNode {
        &self.binary[branch.from]
    }

    /// Whether a root is to be a leaf.
    pub fn is_leaf(&self, branch: Branch) -> bool {
        self.choices[branch.from].is_leaf
    }

    /// Calls `child` with the children of the wide node that a branch becomes.
    pub fn children(&self, branch: Branch, child: &mut impl FnMut(Branch)) {
        if self.is_leaf(branch) {
            return child(branch); // a tree that is one leaf
        }
        self.share(branch, CHILDREN, child);
    }

    /// At most so many roots of a branch.
    fn roots(&self, branch: Branch, mut roots: usize, child: &mut impl FnMut(Branch)) {
        let choice = &self.choices[branch.from];
        while roots >= 2 && choice.first[roots - 2] == 0 {
            roots -= 1;
        }
        if roots == 1 { child(branch) } else { self.share(branch, roots, child) }
    }

    fn share(&self, Branch { from, to }: Branch, roots: usize, child: &mut impl FnMut(Branch)) {
        let to_first = usize::from(self.choices[from].first[roots - 2]);
        let second = from + self.binary[from].next as usize;
        self.roots(Branch { from: from + 1, to: second }, to_first, child);
        self.roots(Branch { from: second, to }, roots - to_first, child);
    }

    /// What the leaves of a branch hold.
    pub fn leaves(&self, branch: Branch) -> impl Iterator<Item = u32> {
        self.binary[branch.from..branch.to].iter().filter(|node| node.is_leaf).map(|node| node.next)
    }
}
