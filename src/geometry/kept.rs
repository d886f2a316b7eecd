//! The geometry index as bytes. Corners are not among them: they are the scene's.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::block::{Block, CUT_OUT, LEAF};
use super::bvh::Accel;
use super::node::{CHILDREN, Node};
use super::wide::Wide;
use crate::scene::Scene;
use crate::scene::bulk::{Bulk, BulkReader};

/// What of an index is short.
#[derive(Debug, Serialize, Deserialize)]
pub struct AccelHead {
    nodes: usize,
    blocks: usize,
    count: usize,
    is_split: bool,
}

impl Accel {
    /// Writes the index: lists into `bulk`, and what is returned.
    pub fn keep<'a>(&'a self, bulk: &mut Bulk<'a>) -> AccelHead {
        let (nodes, blocks) = self.wide.parts();
        bulk.put(nodes);
        bulk.put_made(&blocks.iter().map(|block| block.index).collect::<Vec<[u32; LEAF]>>());
        AccelHead { nodes: nodes.len(), blocks: blocks.len(), count: self.len(), is_split: self.is_split }
    }

    /// What [`Self::keep`] wrote of the index of `scene`; `None` where it cannot be that.
    pub fn from_kept(scene: &Scene, head: &AccelHead, bulk: &mut BulkReader<'_>) -> Option<Self> {
        let nodes: Vec<Node> = bulk.take(head.nodes)?;
        let indices: Vec<[u32; LEAF]> = bulk.take(head.blocks)?;
        let triangles = scene.mesh.triangles.len();
        if head.count > triangles || nodes.is_empty() != (head.count == 0) {
            return None;
        }
        let stack = stack(&nodes, indices.len())?;
        let is_known = |&index: &u32| index == u32::MAX || ((index & !CUT_OUT) as usize) < triangles;
        if !indices.par_iter().all(|block| block.iter().all(is_known)) {
            return None;
        }
        let block = |index: &[u32; LEAF]| Block::of(*index, |t| scene.mesh.corners(t));
        let blocks = indices.par_iter().map(block).collect();
        Some(Self { wide: Wide::of(nodes, blocks, stack), count: head.count, is_split: head.is_split })
    }
}

/// Entries that a traversal of a tree needs; `None` where it is none: children come after their parents, each node but the
/// first and each of the blocks is the child of one, and nothing can be hit where there is no child.
fn stack(nodes: &[Node], blocks: usize) -> Option<usize> {
    let mut below = vec![usize::MAX; nodes.len()];
    let mut is_taken = vec![false; blocks];
    if let Some(root) = below.first_mut() {
        *root = 0;
    }
    let mut deepest = 0;
    for (at, node) in nodes.iter().enumerate() {
        let own = below[at];
        if own == usize::MAX {
            return None;
        }
        let is_used = |slot: &usize| {
            let child = node.child[*slot];
            child.is_leaf() || child.index() != 0
        };
        let waiting = own + (0..CHILDREN).filter(is_used).count().saturating_sub(1);
        deepest = deepest.max(waiting + 1);
        for slot in 0..CHILDREN {
            let child = node.child[slot];
            if child.is_leaf() {
                let taken = is_taken.get_mut(child.index())?;
                if std::mem::replace(taken, true) {
                    return None;
                }
            } else if is_used(&slot) {
                let entry = below.get_mut(child.index()).filter(|_| child.index() > at)?;
                if std::mem::replace(entry, waiting) != usize::MAX {
                    return None;
                }
            } else if node.bounds.iter().enumerate().any(|(side, bounds)| {
                bounds[slot] != if side < 3 { f32::INFINITY } else { f32::NEG_INFINITY }
            }) {
                return None;
            }
        }
    }
    is_taken.into_iter().all(|taken| taken).then_some(deepest + 1)
}
