//! The last element or two: a p-node saves three at once, so two of three numbers cannot be reached by removing whole
//! p-nodes. There two children of one p-node become one element, the mean of both, as all others are means.

use super::Cut;

impl Cut<'_> {
    /// Joins children of p-nodes, of each the pair of least `cost`, cheapest p-nodes first, until `k` elements are left.
    /// At most two elements too many can be saved so; where there is one p-node only, three of its children join.
    pub(super) fn join(&mut self, k: usize, cost: impl Fn([usize; 2]) -> f64) {
        let wanted = self.elements.saturating_sub(k).min(2);
        let pairs = |node: usize| {
            // The middle child borders on each of the others.
            let [a, b, c, middle] = std::array::from_fn(|i| self.forest.children(node).start + i);
            [[a, middle], [b, middle], [c, middle]]
        };
        let mut open: Vec<(f64, [usize; 2])> = (0..self.inner.len())
            .filter(|&i| self.inner[i] && self.open_children[i] == 0)
            .flat_map(|i| pairs(i).map(|pair| (cost(pair), pair)))
            .collect();
        open.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        // Another p-node first, the same one again only where there is no other.
        let mut joined: Vec<Vec<u32>> = Vec::new();
        let mut saved = 0;
        for again in [false, true] {
            for &(_, [corner, middle]) in &open {
                let with = joined.iter_mut().find(|j| j.contains(&(middle as u32)));
                match with {
                    _ if saved == wanted => break,
                    None => joined.push(vec![corner as u32, middle as u32]),
                    Some(with) if again && !with.contains(&(corner as u32)) => with.push(corner as u32),
                    Some(_) => continue,
                }
                saved += 1;
            }
        }
        self.elements -= saved;
        self.joined = joined;
    }
}
