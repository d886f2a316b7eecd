//! What a traversal has still to visit.

use std::ops::DerefMut;

use arrayvec::ArrayVec;

use super::node::{CHILDREN, Child, Node};

/// Entries of a stack on the thread's own; deeper trees get a heap allocation.
pub(super) const STACK: usize = 128;

/// Something to be visited: entry distance (as bits, which sort as the distances do) or the rays that enter above, child below.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Entry(u64);

impl Entry {
    #[inline]
    fn new(t: f32, child: Child) -> Self {
        Self(u64::from(t.to_bits()) << 32 | u64::from(child.0))
    }

    /// What `rays` enter, a bit for each.
    #[inline]
    pub fn of_rays(rays: u32, child: Child) -> Self {
        Self(u64::from(rays) << 32 | u64::from(child.0))
    }

    /// The rays that enter it.
    #[inline]
    pub fn rays(self) -> u32 {
        (self.0 >> 32) as u32
    }

    /// Where the ray enters its box.
    #[inline]
    pub fn t(self) -> f32 {
        f32::from_bits((self.0 >> 32) as u32)
    }

    /// What it is.
    #[inline]
    pub fn child(self) -> Child {
        Child(self.0 as u32)
    }
}

/// Entries, those to be visited next last.
pub(super) trait Stack: DerefMut<Target = [Entry]> {
    fn push(&mut self, entry: Entry);
    fn pop(&mut self) -> Option<Entry>;
    fn truncate(&mut self, len: usize);

    /// Takes the children of `node` that `mask` names, which is not 0: returns one, the nearest if `ORDERED`, and puts the
    /// others on top, near ones last if `ORDERED`. `enter`: where the ray enters each; `meet` is told of all of them.
    #[inline(always)]
    fn visit<const ORDERED: bool>(
        &mut self,
        node: &Node,
        enter: &[f32; CHILDREN],
        mut mask: u32,
        meet: impl Fn(Child),
    ) -> Child {
        let mut next = || {
            let slot = mask.trailing_zeros() as usize & (CHILDREN - 1);
            mask &= mask - 1;
            meet(node.child[slot]);
            (Entry::new(enter[slot], node.child[slot]), mask != 0)
        };
        let (mut nearest, mut more) = next();
        let base = self.len();
        while more {
            let mut entry;
            (entry, more) = next();
            if ORDERED {
                (nearest, entry) = (nearest.min(entry), nearest.max(entry));
            }
            self.push(entry);
            if ORDERED {
                let others = &mut self[base..];
                let mut i = others.len() - 1;
                while i > 0 && others[i - 1] < entry {
                    others[i] = others[i - 1];
                    i -= 1;
                }
                others[i] = entry;
            }
        }
        nearest.child()
    }
}

macro_rules! stack {
    ($vec:ty) => {
        impl Stack for $vec {
            #[inline(always)]
            fn push(&mut self, entry: Entry) {
                self.push(entry);
            }

            #[inline(always)]
            fn pop(&mut self) -> Option<Entry> {
                self.pop()
            }

            #[inline(always)]
            fn truncate(&mut self, len: usize) {
                self.truncate(len);
            }
        }
    };
}

stack!(ArrayVec<Entry, STACK>);
stack!(Vec<Entry>);
