//! Names of nodes, and the paths to them.

use super::document::Document;
use foveal::scene::thing::escaped;

/// Letters of a name.
const NAME_MAX: usize = 200;

/// Steps of a path. Where a node lies deeper, its path begins with `…`, or a chain of nodes would make a megabyte of each.
const STEPS_MAX: usize = 16;

/// What is above each node.
pub(super) struct Above {
    parent: Vec<u32>,
    /// Of each node that was asked about the thing that it is or hangs from, an index into names; `u32::MAX` for none.
    thing: Vec<u32>,
}

impl Above {
    /// Of a document whose nodes have at most one parent each.
    pub fn new(document: &Document) -> Self {
        let none = vec![u32::MAX; document.nodes.len()];
        let mut parent = none.clone();
        for (i, node) in document.nodes.iter().enumerate() {
            node.children.iter().for_each(|c| parent[c.at()] = i as u32);
        }
        Self { parent, thing: none }
    }

    fn parent_of(&self, node: usize) -> Option<usize> {
        self.parent.get(node).filter(|p| **p != u32::MAX).map(|p| *p as usize)
    }

    /// The path of a node that is called `name`.
    pub fn path(&self, document: &Document, node: usize, name: &str) -> String {
        let mut steps = vec![escaped(name)];
        let mut at = node;
        while let Some(above) = self.parent_of(at) {
            if steps.len() == STEPS_MAX {
                steps.push("…".to_owned());
                break;
            }
            let called = document.nodes[above].name.as_deref();
            steps.push(escaped(&called.map_or_else(|| format!("node {above}"), named)));
            at = above;
        }
        steps.reverse();
        steps.join("/")
    }

    /// The thing that a node hangs from. Asked once of each node that is shown, parents before their children.
    pub fn thing_of(&mut self, node: usize) -> Option<u32> {
        let above = self.parent_of(node).map_or(u32::MAX, |parent| self.thing[parent]);
        self.thing[node] = above;
        (above != u32::MAX).then_some(above)
    }

    /// Notes that a node is this thing, so that what is below hangs from it.
    pub fn is(&mut self, node: usize, thing: u32) {
        self.thing[node] = thing;
    }
}

/// As much of a name as is kept.
pub(super) fn named(name: &str) -> String {
    if name.len() <= NAME_MAX { name.to_owned() } else { name.chars().take(NAME_MAX / 4).collect() }
}
