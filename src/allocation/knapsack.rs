//! The multiple-choice knapsack: one candidate of every item, best total quality, total cost within a limit.
//!
//! The problem is NP-hard. Here: upper concave hull per item, hull steps given up from the least quality per
//! cost on, then what is left of the limit is refilled (REFERENCE §8.9). Dumont's single sort of all ratios (2003
//! §5.2.4.3) is right only where ratios are monotone (correction D1).

use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;
use std::fmt;

/// A step to which an item already has been taken is given up for this factor more than its worth, so that what is
/// resident does not come and go (REFERENCE §8.9).
pub const HYSTERESIS: f64 = 1.1;

/// One state an item may be in.
#[derive(Clone, Copy, Debug, PartialEq)]
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

fn quality(candidate: &Candidate) -> f64 {
    if candidate.quality.is_nan() { f64::MIN } else { candidate.quality.clamp(f64::MIN, f64::MAX) }
}

/// Indices of the candidates on the upper concave hull of (cost, quality), from cheapest to best. Never empty for a
/// non-empty input; dominated candidates and all but the first of equal ones are left out.
pub fn hull(candidates: &[Candidate]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..candidates.len()).collect();
    order.sort_by(|&a, &b| {
        let (a, b) = (&candidates[a], &candidates[b]);
        a.cost.cmp(&b.cost).then_with(|| quality(b).total_cmp(&quality(a)))
    });
    let mut hull: Vec<usize> = Vec::with_capacity(order.len());
    for i in order {
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
    hull
}

/// Quality per cost of going from candidate `a` to the dearer candidate `b`.
fn slope(candidates: &[Candidate], a: usize, b: usize) -> f64 {
    let (a, b) = (&candidates[a], &candidates[b]);
    (quality(b) - quality(a)) / (b.cost - a.cost) as f64
}

/// A key that may stand in a heap, with the item that breaks ties.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Ranked {
    key: f64,
    item: usize,
    state: usize,
}

impl Eq for Ranked {}

impl Ord for Ranked {
    fn cmp(&self, other: &Self) -> Ordering {
        self.key
            .total_cmp(&other.key)
            .then_with(|| other.item.cmp(&self.item))
            .then_with(|| other.state.cmp(&self.state))
    }
}

impl PartialOrd for Ranked {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// Chooses one candidate of every item so that the total cost is at most `limit`.
///
/// `now`: the present state of each item, to which [`HYSTERESIS`] applies; states that do not exist are passed over.
/// An item without candidates gets state 0 at no cost. O(n log n) in the number of candidates. The result depends on
/// nothing but the arguments; ties go to the lower item.
pub fn allocate(
    items: &[Vec<Candidate>],
    limit: u64,
    now: Option<&[usize]>,
) -> Result<Allocation, LimitTooSmall> {
    let hulls: Vec<Vec<usize>> = items.iter().map(|candidates| hull(candidates)).collect();
    let cost_of = |position: fn(&[usize]) -> Option<&usize>| {
        let costs = items.iter().zip(&hulls).filter_map(|(item, hull)| Some(item[*position(hull)?].cost));
        costs.map(u128::from).sum::<u128>()
    };
    let smallest = cost_of(<[usize]>::first);
    if smallest > u128::from(limit) {
        let smallest = u64::try_from(smallest).unwrap_or(u64::MAX);
        return Err(LimitTooSmall { limit, smallest });
    }
    let resident = |item: usize, state: usize| {
        let now = now.and_then(|now| items[item].get(*now.get(item)?));
        now.is_some_and(|now| now.cost >= items[item][state].cost)
    };
    // The last step of an item's hull, and what giving it up loses per cost.
    let step = |item: usize, position: usize| {
        let (below, above) = (hulls[item][position - 1], hulls[item][position]);
        let factor = if resident(item, above) { HYSTERESIS } else { 1.0 };
        Ranked { key: slope(&items[item], below, above) * factor, item, state: position }
    };
    let mut position: Vec<usize> = hulls.iter().map(|hull| hull.len().saturating_sub(1)).collect();
    let mut steps: BinaryHeap<Reverse<Ranked>> = (0..items.len())
        .filter(|&item| position[item] > 0)
        .map(|item| Reverse(step(item, position[item])))
        .collect();
    let (mut cost, mut price) = (cost_of(<[usize]>::last), 0.0);
    while cost > u128::from(limit) {
        // The cheapest states fit, so while the total does not there is a step to give up.
        let Some(Reverse(given_up)) = steps.pop() else { break };
        let (item, hull) = (given_up.item, &hulls[given_up.item]);
        let (below, above) = (hull[given_up.state - 1], hull[given_up.state]);
        price = slope(&items[item], below, above);
        cost -= u128::from(items[item][above].cost - items[item][below].cost);
        position[item] -= 1;
        if position[item] > 0 {
            steps.push(Reverse(step(item, position[item])));
        }
    }
    let mut states: Vec<usize> = hulls
        .iter()
        .zip(&position)
        .map(|(hull, &position)| hull.get(position).copied().unwrap_or(0))
        .collect();
    let left = u128::from(limit).saturating_sub(cost);
    let left = u64::try_from(left).unwrap_or(0);
    let cost = (limit - left) + refill(items, left, &mut states);
    let chosen = items.iter().zip(&states).filter_map(|(item, &state)| item.get(state));
    let quality = chosen.map(quality).sum();
    Ok(Allocation { states, cost, quality, price })
}

/// Spends what is left: while any candidate fits and gains quality, the one that gains most. Returns what it spent.
fn refill(items: &[Vec<Candidate>], limit: u64, states: &mut [usize]) -> u64 {
    let mut left = limit;
    // What each candidate that fits would gain, and the state it would gain it from.
    let mut gains: BinaryHeap<(Ranked, usize)> = BinaryHeap::new();
    let push = |gains: &mut BinaryHeap<(Ranked, usize)>, item: usize, from: usize, left: u64| {
        let now = &items[item][from];
        for (state, candidate) in items[item].iter().enumerate() {
            let gain = quality(candidate) - quality(now);
            if gain > 0.0 && candidate.cost.saturating_sub(now.cost) <= left {
                gains.push((Ranked { key: gain, item, state }, from));
            }
        }
    };
    for (item, &state) in states.iter().enumerate().filter(|(item, _)| !items[*item].is_empty()) {
        push(&mut gains, item, state, left);
    }
    while let Some((best, from)) = gains.pop() {
        let extra = |now: &Candidate, then: &Candidate| then.cost.saturating_sub(now.cost);
        let extra = extra(&items[best.item][from], &items[best.item][best.state]);
        // Entries of an item that has moved since are void: those of its new state stand beside them.
        if states[best.item] == from && extra <= left {
            left -= extra;
            states[best.item] = best.state;
            push(&mut gains, best.item, best.state, left);
        }
    }
    limit - left
}

/// An upper bound of the quality any choice within `limit` can have: that of the linear relaxation, in which one hull
/// step may be taken in part. None where the limit cannot be met.
pub fn upper_bound(items: &[Vec<Candidate>], limit: u64) -> Option<f64> {
    let (mut cost, mut bound) = (0u64, 0.0);
    let mut steps = Vec::new();
    for candidates in items {
        let hull = hull(candidates);
        let Some(&first) = hull.first() else { continue };
        cost = cost.saturating_add(candidates[first].cost);
        bound += quality(&candidates[first]);
        let of_pair = |pair: &[usize]| {
            (slope(candidates, pair[0], pair[1]), candidates[pair[1]].cost - candidates[pair[0]].cost)
        };
        steps.extend(hull.windows(2).map(of_pair));
    }
    let mut left = limit.checked_sub(cost)?;
    // Slopes fall along each hull, so this order takes the steps of each item in theirs.
    steps.sort_by(|a, b| b.0.total_cmp(&a.0));
    for (slope, cost) in steps {
        bound += slope * cost.min(left) as f64;
        left = left.saturating_sub(cost);
    }
    Some(bound)
}

#[cfg(test)]
#[path = "knapsack_tests.rs"]
mod tests;
