//! Meshes of fewer elements: quadtrees of radiosity cut back to k leaves (Dumont, Pellacini & Ferwerda
//! 2003 §5.4; REFERENCE §7.6).
//!
//! A p-node is an inner node whose children are all leaves; removing it saves three elements. The
//! paper's order by one sort is corrected (REFERENCE D6): a node's key is never below its descendants'.
//! What is left to reach k exactly, one element or two, is saved by joining (`join.rs`) children of p-nodes.

mod join;
#[cfg(test)]
mod tests;

use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// A node of a quadtree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuadNode {
    /// The node above, or `None` for a root.
    pub parent: Option<u32>,
    /// The first of its four children, which stand together and after it. The fourth, in the middle, borders on each of
    /// the others.
    pub children: Option<u32>,
    /// Area, square scene units.
    pub area: f64,
    /// Luminance of radiosity, W/m². An inner node's is the mean of its leaves by area.
    pub value: f64,
    /// Mean elevation of the visibility threshold by its texture, ≥ 1; 1 without texture.
    pub elevation: f64,
}

/// Quadtrees, each with its nodes after their parents.
#[derive(Clone, Debug, Default)]
pub struct Forest {
    /// Nodes.
    pub nodes: Vec<QuadNode>,
}

/// What a removal may cost.
#[derive(Clone, Copy)]
pub enum Criterion<'a> {
    /// δB / B, where δB is the difference in radiosity to the original leaves.
    Photometric,
    /// Dumont's eq. (12): δL / (TVI(L) · elevation). Deviations: contrasts far above the threshold are masked less, a
    /// display has a white, and small elements are seen less.
    Perceptual(Eye<'a>),
    /// Least squared error by area, whole subtrees at once (generalised BFOS; Chou, Lookabaugh & Gray 1989).
    Optimal,
}

/// What an eye sees of errors on a display.
#[derive(Clone, Copy)]
pub struct Eye<'a> {
    /// Threshold versus intensity: cd/m² to cd/m².
    pub tvi: &'a (dyn Fn(f64) -> f64 + Sync),
    /// 1 / the least contrast that is seen at a luminance in cd/m².
    pub sensitivity: &'a (dyn Fn(f64) -> f64 + Sync),
    /// Displayed luminance of a radiance of luminance 1.
    pub cd_m2_per_unit: f64,
    /// Displayed luminance of white, above which nothing differs.
    pub white_cd_m2: f64,
    /// The area over which the eye sums, square scene units: an error on less of it is seen in proportion to its area
    /// (Ricco's law).
    pub summed_area: f64,
}

/// A forest cut back.
#[derive(Clone, Debug, PartialEq)]
pub struct Simplified {
    /// Per node whether it is a leaf now: an element, or a part of one.
    pub is_leaf: Vec<bool>,
    /// Leaves of one parent that are one element together.
    pub joined: Vec<Vec<u32>>,
    /// Elements.
    pub elements: usize,
    /// Elements before.
    pub elements_before: usize,
    /// Sum of area times squared difference to the original leaves.
    pub squared_error: f64,
}

/// A tree cut back so far: one of the states that [`Forest::ladders`] offers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rung {
    /// The node whose subtree was cut last; none where nothing was.
    pub node: Option<u32>,
    /// Elements of the tree.
    pub elements: usize,
    /// Sum of area times squared difference to the original leaves.
    pub squared_error: f64,
}

/// A number as a sort key: total order, NaN last.
#[derive(Clone, Copy, PartialEq)]
struct Key(f64);

impl Eq for Key {}

impl Ord for Key {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.0.total_cmp(&other.0)
    }
}

impl PartialOrd for Key {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

/// Working state of a cut.
struct Cut<'a> {
    forest: &'a Forest,
    /// Inner nodes not yet cut.
    inner: Vec<bool>,
    /// Inner children that are not yet cut.
    open_children: Vec<u8>,
    /// Leaves that are one element together.
    joined: Vec<Vec<u32>>,
    elements: usize,
}

impl Forest {
    /// The leaves of all trees.
    pub fn leaf_count(&self) -> usize {
        self.nodes.iter().filter(|n| n.children.is_none()).count()
    }

    /// The ways of cutting each tree back, from all of its leaves to one: at each step the subtree that adds the least
    /// squared error per element saved (generalised BFOS), so that they stand on the hull of elements and error.
    pub fn ladders(&self) -> Vec<Vec<Rung>> {
        let mut ladders: Vec<Vec<Rung>> = Vec::new();
        let mut trees = vec![0; self.nodes.len()];
        for (i, node) in self.nodes.iter().enumerate() {
            trees[i] = node.parent.map_or(ladders.len(), |parent| trees[parent as usize]);
            if node.parent.is_none() {
                ladders.push(vec![Rung { node: None, elements: 0, squared_error: 0.0 }]);
            }
            ladders[trees[i]][0].elements += usize::from(node.children.is_none());
        }
        Cut::new(self).cut_subtrees(0, &self.squared_errors(), |node, saved, added| {
            let ladder = &mut ladders[trees[node]];
            if let Some(&Rung { elements, squared_error, .. }) = ladder.last() {
                let (elements, squared_error) = (elements - saved, squared_error + added);
                ladder.push(Rung { node: Some(node as u32), elements, squared_error });
            }
        });
        ladders
    }

    fn children(&self, node: usize) -> std::ops::Range<usize> {
        self.nodes[node].children.map_or(0..0, |c| c as usize..c as usize + 4)
    }

    /// Per node the squared error by area of standing for all its leaves.
    fn squared_errors(&self) -> Vec<f64> {
        // About the node's own value: Σ A (b − v)² = Σ A b² − 2 v Σ A b + v² Σ A, kept centred on the mean
        // to save digits.
        let mut moments = vec![(0.0f64, 0.0f64, 0.0f64); self.nodes.len()];
        for i in (0..self.nodes.len()).rev() {
            let node = &self.nodes[i];
            if node.children.is_none() {
                moments[i] = (node.area, node.value, 0.0);
                continue;
            }
            let area: f64 = self.children(i).map(|c| moments[c].0).sum();
            let mean = self.children(i).map(|c| moments[c].0 * moments[c].1).sum::<f64>() / area.max(1e-300);
            let spread =
                self.children(i).map(|c| moments[c].2 + moments[c].0 * (moments[c].1 - mean).powi(2)).sum();
            moments[i] = (area, mean, spread);
        }
        self.nodes.iter().zip(moments).map(|(n, (a, m, s))| s + a * (m - n.value).powi(2)).collect()
    }

    /// Mean value of nodes by area, and the squared error by area of showing it in place of their own values.
    fn mean(&self, nodes: &[usize]) -> (f64, f64) {
        let nodes = || nodes.iter().map(|&n| &self.nodes[n]);
        let area: f64 = nodes().map(|n| n.area).sum();
        let mean = nodes().map(|n| n.area * n.value).sum::<f64>() / area.max(1e-300);
        (mean, nodes().map(|n| n.area * (n.value - mean).powi(2)).sum())
    }

    /// Per inner node the largest difference to an original leaf below. (The paper's is that to a child; there errors add
    /// up unseen.)
    fn deviations(&self) -> Vec<f64> {
        let mut range = vec![(f64::INFINITY, f64::NEG_INFINITY); self.nodes.len()];
        let mut deviations = vec![0.0; self.nodes.len()];
        for i in (0..self.nodes.len()).rev() {
            let value = self.nodes[i].value;
            if self.nodes[i].children.is_none() {
                range[i] = (value, value);
                continue;
            }
            for c in self.children(i) {
                range[i] = (range[i].0.min(range[c].0), range[i].1.max(range[c].1));
            }
            deviations[i] = (range[i].1 - value).max(value - range[i].0);
        }
        deviations
    }

    fn keys(&self, cost: &impl Fn(&QuadNode, f64) -> f64, deviations: &[f64]) -> Vec<f64> {
        self.nodes.iter().zip(deviations).map(|(node, &delta)| cost(node, delta)).collect()
    }

    /// What it costs to show a node in place of values that differ from its own by up to δ.
    fn cost<'a>(&self, criterion: &'a Criterion<'_>) -> impl Fn(&QuadNode, f64) -> f64 + 'a {
        let brightest = self.nodes.iter().map(|n| n.value).fold(0.0, f64::max);
        move |shown, delta| match criterion {
            Criterion::Optimal => delta,
            Criterion::Photometric => delta / shown.value.max(1e-6 * brightest).max(1e-30),
            Criterion::Perceptual(eye) => {
                let to_luminance = eye.cd_m2_per_unit / std::f64::consts::PI;
                let displayed = |value: f64| (value * to_luminance).clamp(0.0, eye.white_cd_m2);
                let now = displayed(shown.value);
                let [above, below] = [delta, -delta].map(|d| (displayed(shown.value + d) - now).abs());
                let seen = above.max(below);
                let contrast = seen / now.max(1e-3) * (eye.sensitivity)(now);
                let summed = (shown.area / eye.summed_area.max(1e-300)).min(1.0);
                summed * seen / (eye.tvi)(now).max(1e-30) * unmasked(contrast, shown.elevation.max(1.0))
            }
        }
    }
}

/// What a texture that elevates thresholds leaves of a contrast, both in thresholds on a plain surface: 1 / elevation up
/// to the elevated threshold, as in Dumont's eq. (12). Beyond it a mask takes from what is seen, it does not divide it:
/// contrasts look alike where they exceed their thresholds by the same (Kulikowski 1976).
fn unmasked(contrast: f64, elevation: f64) -> f64 {
    if contrast <= elevation { 1.0 / elevation } else { (1.0 + contrast - elevation) / contrast }
}

/// Cuts `forest` back to exactly `k` elements; to its roots where there are more of them than that, and not at all where
/// it has no more leaves.
pub fn simplify(forest: &Forest, k: usize, criterion: &Criterion<'_>) -> Simplified {
    let mut cut = Cut::new(forest);
    if let Criterion::Optimal = criterion {
        let errors = forest.squared_errors();
        cut.cut_subtrees(k, &errors, |_, _, _| {});
        return cut.finish_by_squared_error(k, &errors);
    }
    let (deviations, cost) = (forest.deviations(), forest.cost(criterion));
    cut.cut_by_key(k, &forest.keys(&cost, &deviations));
    cut.join(k, |pair| {
        let (mean, _) = forest.mean(&pair);
        let [a, b] = pair.map(|n| &forest.nodes[n]);
        let delta = pair.map(|n| deviations[n] + (forest.nodes[n].value - mean).abs());
        let area = a.area + b.area;
        let elevation = (a.area * a.elevation + b.area * b.elevation) / area.max(1e-300);
        cost(&QuadNode { value: mean, elevation, area, ..*a }, f64::max(delta[0], delta[1]))
    });
    cut.result()
}

/// Cuts the subtrees below these nodes, and then, if that is not enough, what adds the least squared error until `k`
/// elements are left.
pub fn cut_below(forest: &Forest, nodes: impl Iterator<Item = u32>, k: usize) -> Simplified {
    let mut cut = Cut::new(forest);
    nodes.for_each(|node| cut.remove_below(node as usize));
    let inner = |i: usize| forest.children(i).filter(|&c| cut.inner[c]).count() as u8;
    cut.open_children = (0..forest.nodes.len()).map(inner).collect();
    cut.elements = (0..forest.nodes.len()).filter(|&i| cut.is_leaf(i)).count();
    cut.finish_by_squared_error(k, &forest.squared_errors())
}

impl<'a> Cut<'a> {
    fn new(forest: &'a Forest) -> Self {
        let inner: Vec<bool> = forest.nodes.iter().map(|n| n.children.is_some()).collect();
        let open_children =
            (0..forest.nodes.len()).map(|i| forest.children(i).filter(|&c| inner[c]).count() as u8).collect();
        Self { forest, inner, open_children, joined: Vec::new(), elements: forest.leaf_count() }
    }

    /// Whether a node is a leaf now.
    fn is_leaf(&self, i: usize) -> bool {
        let below_inner = self.forest.nodes[i].parent.is_none_or(|p| self.inner[p as usize]);
        below_inner && !self.inner[i]
    }

    fn finish_by_squared_error(mut self, k: usize, errors: &[f64]) -> Simplified {
        let forest = self.forest;
        self.cut_marginal(k, errors);
        self.join(k, |pair| forest.mean(&pair).1);
        self.result()
    }

    fn result(self) -> Simplified {
        let errors = self.forest.squared_errors();
        let is_leaf: Vec<bool> = (0..errors.len()).map(|i| self.is_leaf(i)).collect();
        let of_leaves: f64 = errors.iter().zip(&is_leaf).filter(|(_, is)| **is).map(|(e, _)| e).sum();
        let of_joined = |nodes: &Vec<u32>| {
            let nodes: Vec<usize> = nodes.iter().map(|&n| n as usize).collect();
            self.forest.mean(&nodes).1
        };
        let squared_error = of_leaves + self.joined.iter().map(of_joined).sum::<f64>();
        let elements_before = self.forest.leaf_count();
        Simplified { is_leaf, joined: self.joined, elements: self.elements, elements_before, squared_error }
    }

    /// Makes a leaf of a node, whatever is below.
    fn remove_below(&mut self, node: usize) {
        let mut below = vec![node];
        while let Some(n) = below.pop() {
            if std::mem::take(&mut self.inner[n]) {
                self.open_children[n] = 0;
                below.extend(self.forest.children(n));
            }
        }
    }

    /// Removes p-nodes, always the one with the smallest key, as long as `k` elements are left; a parent becomes a
    /// candidate with its last child. The same order as one sort by max(own key, keys below).
    fn cut_by_key(&mut self, k: usize, keys: &[f64]) {
        let is_p_node = |i: &usize| self.inner[*i] && self.open_children[*i] == 0;
        let mut heap: BinaryHeap<Reverse<(Key, usize)>> =
            (0..keys.len()).filter(is_p_node).map(|i| Reverse((Key(keys[i]), i))).collect();
        while self.elements >= k.saturating_add(3) {
            let Some(Reverse((_, i))) = heap.pop() else { break };
            self.inner[i] = false;
            self.elements -= 3;
            if let Some(p) = self.forest.nodes[i].parent.map(|p| p as usize) {
                self.open_children[p] -= 1;
                if self.open_children[p] == 0 {
                    heap.push(Reverse((Key(keys[p]), p)));
                }
            }
        }
    }

    /// The same by the squared error that a removal adds.
    fn cut_marginal(&mut self, k: usize, errors: &[f64]) {
        let added: Vec<f64> = (0..errors.len())
            .map(|i| errors[i] - self.forest.children(i).map(|c| errors[c]).sum::<f64>())
            .collect();
        self.cut_by_key(k, &added);
    }

    /// Cuts whole subtrees, always the one that adds the least squared error per element saved, until the
    /// next would leave fewer than `k` elements. `on_cut` hears of the node, the elements saved and the error added.
    fn cut_subtrees(&mut self, k: usize, errors: &[f64], mut on_cut: impl FnMut(usize, usize, f64)) {
        let nodes = &self.forest.nodes;
        let (mut error, mut leaves) = (errors.to_vec(), vec![1usize; nodes.len()]);
        for i in (0..nodes.len()).rev() {
            if self.inner[i] {
                error[i] = self.forest.children(i).map(|c| error[c]).sum();
                leaves[i] = self.forest.children(i).map(|c| leaves[c]).sum();
            }
        }
        let ratio = |i: usize, error: &[f64], leaves: &[usize]| {
            Key((errors[i] - error[i]) / (leaves[i].max(2) - 1) as f64)
        };
        let mut version = vec![0u32; nodes.len()];
        let mut heap: BinaryHeap<Reverse<(Key, usize, u32)>> = (0..nodes.len())
            .filter(|&i| self.inner[i])
            .map(|i| Reverse((ratio(i, &error, &leaves), i, 0)))
            .collect();
        while self.elements > k {
            let Some(Reverse((_, i, seen))) = heap.pop() else { break };
            if !self.inner[i] || version[i] != seen {
                continue;
            }
            let saved = leaves[i] - 1;
            if self.elements - saved < k {
                break;
            }
            self.elements -= saved;
            let added = errors[i] - error[i];
            on_cut(i, saved, added);
            self.remove_below(i);
            (error[i], leaves[i]) = (errors[i], 1);
            let mut above = nodes[i].parent;
            if let Some(p) = above {
                self.open_children[p as usize] -= 1;
            }
            while let Some(p) = above.map(|p| p as usize) {
                error[p] += added;
                leaves[p] -= saved;
                version[p] += 1;
                heap.push(Reverse((ratio(p, &error, &leaves), p, version[p])));
                above = nodes[p].parent;
            }
        }
    }
}
