//! Meshes of fewer elements: quadtrees of radiosity cut back to k leaves (Dumont, Pellacini & Ferwerda
//! 2003 §5.4; REFERENCE §7.6).
//!
//! A p-node is an inner node whose children are all leaves; removing it saves three elements. The
//! paper's order by one sort is corrected (REFERENCE D6): a node's key is never below its descendants'.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// A node of a quadtree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QuadNode {
    /// The node above, or `None` for a root.
    pub parent: Option<u32>,
    /// The first of its four children, which stand together and after it.
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
    /// δB, the difference in radiosity to the original leaves.
    Absolute,
    /// δB / B.
    Photometric,
    /// Dumont's eq. (12): δL / (TVI(L) · elevation), with L = B/π times `cd_m2_per_unit` and the threshold
    /// in cd/m².
    Perceptual {
        /// Threshold versus intensity: cd/m² to cd/m².
        tvi: &'a (dyn Fn(f64) -> f64 + Sync),
        /// Displayed luminance of a radiance of luminance 1.
        cd_m2_per_unit: f64,
    },
    /// Least squared error by area, whole subtrees at once (generalised BFOS; Chou, Lookabaugh & Gray 1989).
    Optimal,
}

/// From what δB is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Deviation {
    /// The largest difference to an original leaf below; errors do not add up unseen.
    #[default]
    Leaves,
    /// The largest difference to a child, as in the paper.
    Children,
}

/// A forest cut back.
#[derive(Clone, Debug, PartialEq)]
pub struct Simplified {
    /// Per node whether it is an element now.
    pub is_element: Vec<bool>,
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

    /// Per inner node the largest deviation of what it stands for.
    fn deviations(&self, from: Deviation) -> Vec<f64> {
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
                deviations[i] = f64::max(deviations[i], (self.nodes[c].value - value).abs());
            }
            if from == Deviation::Leaves {
                deviations[i] = (range[i].1 - value).max(value - range[i].0);
            }
        }
        deviations
    }

    fn keys(&self, criterion: &Criterion<'_>, from: Deviation) -> Vec<f64> {
        let brightest = self.nodes.iter().map(|n| n.value).fold(0.0, f64::max);
        let deviations = self.deviations(from);
        let key = |(node, delta): (&QuadNode, f64)| match criterion {
            Criterion::Absolute | Criterion::Optimal => delta,
            Criterion::Photometric => delta / node.value.max(1e-6 * brightest).max(1e-30),
            Criterion::Perceptual { tvi, cd_m2_per_unit } => {
                let to_luminance = cd_m2_per_unit / std::f64::consts::PI;
                let threshold = tvi((node.value * to_luminance).max(0.0)) * node.elevation.max(1.0);
                delta * to_luminance / threshold.max(1e-30)
            }
        };
        self.nodes.iter().zip(deviations).map(key).collect()
    }
}

/// Cuts `forest` back to at most `k` elements, at least `k` − 2 where the roots allow it.
pub fn simplify(forest: &Forest, k: usize, criterion: &Criterion<'_>, from: Deviation) -> Simplified {
    let mut cut = Cut::new(forest);
    match criterion {
        Criterion::Optimal => {
            let errors = forest.squared_errors();
            cut.cut_subtrees(k, &errors, |_, _, _| {});
            cut.cut_marginal(k, &errors);
        }
        _ => cut.cut_by_key(k, &forest.keys(criterion, from)),
    }
    cut.result()
}

/// Cuts the subtrees below these nodes.
pub fn cut_below(forest: &Forest, nodes: impl Iterator<Item = u32>) -> Simplified {
    let mut cut = Cut::new(forest);
    nodes.for_each(|node| cut.remove_below(node as usize));
    cut.elements = (0..forest.nodes.len()).filter(|&i| cut.is_element(i)).count();
    cut.result()
}

impl<'a> Cut<'a> {
    fn new(forest: &'a Forest) -> Self {
        let inner: Vec<bool> = forest.nodes.iter().map(|n| n.children.is_some()).collect();
        let open_children =
            (0..forest.nodes.len()).map(|i| forest.children(i).filter(|&c| inner[c]).count() as u8).collect();
        Self { forest, inner, open_children, elements: forest.leaf_count() }
    }

    /// Whether a node is an element now.
    fn is_element(&self, i: usize) -> bool {
        let below_inner = self.forest.nodes[i].parent.is_none_or(|p| self.inner[p as usize]);
        below_inner && !self.inner[i]
    }

    fn result(&self) -> Simplified {
        let errors = self.forest.squared_errors();
        let is_element: Vec<bool> = (0..errors.len()).map(|i| self.is_element(i)).collect();
        let squared_error = errors.iter().zip(&is_element).filter(|(_, is)| **is).map(|(e, _)| e).sum();
        let elements_before = self.forest.leaf_count();
        Simplified { is_element, elements: self.elements, elements_before, squared_error }
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

    /// Removes p-nodes, always the one with the smallest key; a parent becomes a candidate with its last
    /// child. The same order as one sort by max(own key, keys below).
    fn cut_by_key(&mut self, k: usize, keys: &[f64]) {
        let is_p_node = |i: &usize| self.inner[*i] && self.open_children[*i] == 0;
        let mut heap: BinaryHeap<Reverse<(Key, usize)>> =
            (0..keys.len()).filter(is_p_node).map(|i| Reverse((Key(keys[i]), i))).collect();
        while self.elements > k {
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Preorder split bits of the three quadtrees of the reference check (2028 leaves, 675 inner nodes).
    const SPLITS: &str = "\
        f4210c2108610840e108430842184210c087084218410c10610843a108610843084218420d083042184210c21083420c\
        21048430421e1084308214210c210864218420a10860842c2084841c210848430842184210f04218420c108610384210\
        c1086108430821a10861084308421842107c210861084308420b0841820c2108701840c210861084384210c208308421\
        e108428184210c108708421210c2086104384210c210861084308421c10610428184210f08421840c210861084384210\
        30421c210861084308420d08428418420784210c2108608430841c1086108430821410e1083084214210c21087084218\
        2103b0420c10870842184210c21038210c210861080f0842184210c210861084384210c10850841c2108610843084218\
        42108c21084e10843084218410c2107084218210c2108610842e10830821210c21085842106108438410c21086108430\
        8420";

    fn reference_forest() -> Forest {
        let bits: Vec<bool> = SPLITS
            .chars()
            .filter_map(|c| c.to_digit(16))
            .flat_map(|d| (0..4).map(move |i| d >> (3 - i) & 1 == 1))
            .collect();
        let functions: [fn(f64, f64) -> f64; 3] = [
            |x, y| 10.0 * (-40.0 * ((x - 0.3).powi(2) + (y - 0.6).powi(2))).exp(),
            |x, y| if x + 0.3 * y > 0.55 { 3.0 } else { 1.0 },
            |x, y| 1.0 + 0.2 * (40.0 * x).sin() * (33.0 * y).sin(),
        ];
        let mut forest = Forest::default();
        let mut at = 0;
        for f in functions {
            let root = forest.nodes.len();
            forest.nodes.push(node(None, 1.0));
            fill(&mut forest, root, &bits, &mut at, (0.0, 0.0, 1.0), f);
        }
        assert_eq!(at, 2703);
        for i in (0..forest.nodes.len()).rev() {
            if forest.nodes[i].children.is_some() {
                forest.nodes[i].value = forest.children(i).map(|c| forest.nodes[c].value).sum::<f64>() / 4.0;
            }
        }
        forest
    }

    fn node(parent: Option<u32>, area: f64) -> QuadNode {
        QuadNode { parent, children: None, area, value: 0.0, elevation: 1.0 }
    }

    fn fill(
        forest: &mut Forest,
        i: usize,
        bits: &[bool],
        at: &mut usize,
        (x, y, s): (f64, f64, f64),
        f: fn(f64, f64) -> f64,
    ) {
        *at += 1;
        if !bits[*at - 1] {
            forest.nodes[i].value = f(x + s / 2.0, y + s / 2.0);
            return;
        }
        let first = forest.nodes.len();
        forest.nodes[i].children = Some(first as u32);
        let child = node(Some(i as u32), forest.nodes[i].area / 4.0);
        forest.nodes.extend([child; 4]);
        for c in 0..4usize {
            let corner = (x + s / 2.0 * (c & 1) as f64, y + s / 2.0 * (c >> 1) as f64, s / 2.0);
            fill(forest, first + c, bits, at, corner, f);
        }
    }

    fn check(criterion: Criterion<'_>, from: Deviation, expected: [(usize, usize, f64); 3]) {
        let forest = reference_forest();
        for (k, n, error) in expected {
            let cut = simplify(&forest, k, &criterion, from);
            assert_eq!(cut.elements_before, 2028);
            assert_eq!(cut.elements, n);
            assert_eq!(cut.is_element.iter().filter(|&&e| e).count(), n);
            assert!((cut.squared_error - error).abs() <= 6e-6, "{k}: {}", cut.squared_error);
        }
    }

    #[test]
    fn the_papers_order_with_keys_never_below_their_children() {
        let expected = [(600, 600, 0.00252), (300, 300, 0.01225), (100, 99, 0.24773)];
        check(Criterion::Absolute, Deviation::Children, expected);
    }

    #[test]
    fn whole_subtrees_reach_the_optimum_where_their_hull_meets_k() {
        check(
            Criterion::Optimal,
            Deviation::Leaves,
            [(300, 300, 0.00873), (100, 99, 0.12133), (594, 594, 0.00197)],
        );
        let cut = simplify(&reference_forest(), 600, &Criterion::Optimal, Deviation::Leaves);
        assert_eq!(cut.elements, 600);
        assert!(cut.squared_error < 0.00198, "{}", cut.squared_error);
    }

    #[test]
    fn a_sort_by_one_key_is_the_heap() {
        let forest = reference_forest();
        let keys = forest.keys(&Criterion::Photometric, Deviation::Leaves);
        let mut highest = keys.clone();
        for i in (0..keys.len()).rev() {
            for c in forest.children(i).filter(|&c| forest.nodes[c].children.is_some()) {
                highest[i] = highest[i].max(highest[c]);
            }
        }
        let mut inner: Vec<usize> = (0..keys.len()).filter(|&i| forest.nodes[i].children.is_some()).collect();
        inner.sort_by(|&a, &b| highest[a].total_cmp(&highest[b]).then(b.cmp(&a)));
        let last = highest[inner[(2028usize - 300).div_ceil(3) - 1]];
        let cut = simplify(&forest, 300, &Criterion::Photometric, Deviation::Leaves);
        for &i in &inner {
            let above = std::iter::successors(Some(i), |&n| forest.nodes[n].parent.map(|p| p as usize));
            let is_cut = above.into_iter().any(|n| cut.is_element[n]);
            // Equal keys may go in either order.
            assert!(highest[i] == last || is_cut == (highest[i] < last), "{i}");
        }
    }

    #[test]
    fn the_perceptual_criterion_spares_what_is_seen() {
        // Two roots with the same relative error; texture hides it on the first.
        let mut forest = Forest::default();
        for root in 0..2u32 {
            let at = forest.nodes.len() as u32;
            forest.nodes.push(QuadNode {
                parent: None,
                children: Some(at + 1),
                area: 1.0,
                value: 2.0,
                elevation: if root == 0 { 5.0 } else { 1.0 },
            });
            for value in [1.9, 2.1, 1.9, 2.1] {
                forest.nodes.push(QuadNode {
                    parent: Some(at),
                    children: None,
                    area: 0.25,
                    value,
                    elevation: 1.0,
                });
            }
        }
        let weber = |l: f64| 0.01 * l;
        let criterion = Criterion::Perceptual { tvi: &weber, cd_m2_per_unit: 100.0 };
        let cut = simplify(&forest, 5, &criterion, Deviation::Leaves);
        assert_eq!(cut.elements, 5);
        assert!(cut.is_element[0] && !cut.is_element[5]);
    }

    #[test]
    fn roots_are_the_least_and_nothing_is_cut_above_k() {
        let forest = reference_forest();
        for criterion in [Criterion::Absolute, Criterion::Photometric, Criterion::Optimal] {
            assert_eq!(simplify(&forest, 0, &criterion, Deviation::Leaves).elements, 3);
            assert_eq!(simplify(&forest, 5000, &criterion, Deviation::Leaves).elements, 2028);
        }
        assert_eq!(simplify(&Forest::default(), 3, &Criterion::Optimal, Deviation::Leaves).elements, 0);
    }
}
