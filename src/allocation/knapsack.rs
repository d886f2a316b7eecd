//! The multiple-choice knapsack: one candidate of every item, best total quality, total cost within a limit.
//!
//! The problem is NP-hard. Here: upper concave hull per item, hull steps given up from the least quality per
//! cost on, then what is left of the limit is refilled (REFERENCE §8.9); where candidates are few, so that one step
//! matters, dynamic programming on rounded costs as well. Dumont's single sort of all ratios (2003
//! §5.2.4.3) is right only where ratios are monotone (correction D1).

use std::fmt;

pub use super::search::Search;

/// A step to which an item already has been taken is given up for this factor more than its worth, so that what is
/// resident does not come and go (REFERENCE §8.9).
pub const HYSTERESIS: f64 = 1.1;

/// One state an item may be in.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Candidate {
    /// Cost in the limit's unit.
    pub cost: u64,
    /// Quality; larger is better. NaN counts as the worst.
    pub quality: f64,
}

/// The chosen states.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Allocation {
    /// Index of the chosen candidate of each item.
    pub states: Vec<usize>,
    /// Total cost, within the limit.
    pub cost: u64,
    /// Total quality.
    pub quality: f64,
    /// Quality per unit of cost of the best hull step that was given up: what one more unit would buy. 0 if nothing was.
    pub price: f64,
}

/// The limit cannot be met by any choice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LimitTooSmall {
    /// The limit.
    pub limit: u64,
    /// The smallest one that can be met.
    pub smallest: u64,
}

impl fmt::Display for LimitTooSmall {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a limit of {} cannot be met: the smallest that can is {}", self.limit, self.smallest)
    }
}

impl std::error::Error for LimitTooSmall {}

/// Its quality, NaN as the worst; bounded, so that sums stay finite.
pub(super) fn quality(candidate: &Candidate) -> f64 {
    if candidate.quality.is_nan() { -1e300 } else { candidate.quality.clamp(-1e300, 1e300) }
}

/// Indices of the candidates on the upper concave hull of (cost, quality), from cheapest to best. Never empty for a
/// non-empty input; dominated candidates and all but the first of equal ones are left out.
pub fn hull(candidates: &[Candidate]) -> Vec<usize> {
    let (mut order, mut hull) = (Vec::new(), Vec::new());
    hull_into(candidates, &mut order, &mut hull);
    hull
}

/// The same into `hull`, which is cleared first; `order` is room to work in.
pub(super) fn hull_into(candidates: &[Candidate], order: &mut Vec<usize>, hull: &mut Vec<usize>) {
    hull.clear();
    order.clear();
    order.extend(0..candidates.len());
    order.sort_unstable_by(|&i, &j| {
        let (a, b) = (&candidates[i], &candidates[j]);
        a.cost.cmp(&b.cost).then_with(|| quality(b).total_cmp(&quality(a))).then(i.cmp(&j))
    });
    for &i in order.iter() {
        if hull.last().is_some_and(|&top| quality(&candidates[i]) <= quality(&candidates[top])) {
            continue;
        }
        while let [.., before, top] = hull[..]
            && slope(candidates, before, top) <= slope(candidates, top, i)
        {
            hull.pop();
        }
        hull.push(i);
    }
}

/// Quality per cost of going from candidate `a` to the dearer candidate `b`.
pub(super) fn slope(candidates: &[Candidate], a: usize, b: usize) -> f64 {
    let (a, b) = (&candidates[a], &candidates[b]);
    (quality(b) - quality(a)) / (b.cost - a.cost) as f64
}

/// Chooses one candidate of every item so that the total cost is at most `limit`.
///
/// `now`: the present state of each item, to which [`HYSTERESIS`] applies; states that do not exist are passed over.
/// An item without candidates gets state 0 at no cost. O(n log n) in the number of candidates. The result depends on
/// nothing but the arguments; ties go to the lower item. [`Search`] does the same in steps.
pub fn allocate(
    items: &[Vec<Candidate>],
    limit: u64,
    now: Option<&[usize]>,
) -> Result<Allocation, LimitTooSmall> {
    let mut search = Search::new(limit);
    for (i, item) in items.iter().enumerate() {
        search.add(item, now.and_then(|now| now.get(i).copied()));
    }
    search.finish()
}

#[cfg(test)]
#[path = "knapsack_tests.rs"]
mod tests;
