//! The multiple-choice knapsack: one candidate of every item, best total quality, total cost within a limit.
//!
//! The problem is NP-hard. Here: upper concave hull per item, hull steps given up from the least quality per
//! cost on, then what is left of the limit is refilled (REFERENCE §8.9); where candidates are few, so that one step
//! matters, dynamic programming on rounded costs as well. Dumont's single sort of all ratios (2003
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

/// Its quality, NaN as the worst; bounded, so that sums stay finite.
fn quality(candidate: &Candidate) -> f64 {
    if candidate.quality.is_nan() { -1e300 } else { candidate.quality.clamp(-1e300, 1e300) }
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
    let cheapest = items.iter().filter_map(|item| item.iter().map(|c| u128::from(c.cost)).min());
    let smallest: u128 = cheapest.sum();
    if smallest > u128::from(limit) {
        return Err(LimitTooSmall { limit, smallest: u64::try_from(smallest).unwrap_or(u64::MAX) });
    }
    let adjusted = now.map(|now| with_hysteresis(items, now));
    let valued = adjusted.as_deref().unwrap_or(items);
    let (mut states, price) = give_up(valued, limit);
    if items.iter().map(Vec::len).sum::<usize>() <= FEW {
        let others = fill_grid(valued, limit);
        if total(valued, &others).1 > total(valued, &states).1 {
            states = others;
        }
    }
    let (cost, quality) = total(items, &states);
    Ok(Allocation { states, cost, quality, price })
}

/// The candidates with the qualities that count: what falls short of the present state's does so [`HYSTERESIS`] times.
/// All steps up to that state are worth more by this factor, those above it what they were.
fn with_hysteresis(items: &[Vec<Candidate>], now: &[usize]) -> Vec<Vec<Candidate>> {
    let adjust = |(i, item): (usize, &Vec<Candidate>)| {
        let Some(present) = now.get(i).and_then(|&state| item.get(state)).map(quality) else {
            return item.clone();
        };
        let valued = |c: &Candidate| Candidate {
            cost: c.cost,
            quality: quality(c) - (HYSTERESIS - 1.0) * (present - quality(c)).max(0.0),
        };
        item.iter().map(valued).collect()
    };
    items.iter().enumerate().map(adjust).collect()
}

/// Cost and quality of chosen states that are within a limit.
fn total(items: &[Vec<Candidate>], states: &[usize]) -> (u64, f64) {
    let chosen = || items.iter().zip(states).filter_map(|(item, &state)| item.get(state));
    (chosen().map(|c| c.cost).sum(), chosen().map(quality).sum())
}

/// From the best state of every item, gives up the hull step of least quality per cost until the limit is met, then
/// refills. Returns the states and the ratio of the last step given up. The cheapest states must fit.
fn give_up(items: &[Vec<Candidate>], limit: u64) -> (Vec<usize>, f64) {
    let hulls: Vec<Vec<usize>> = items.iter().map(|candidates| hull(candidates)).collect();
    let step = |item: usize, position: usize| {
        let key = slope(&items[item], hulls[item][position - 1], hulls[item][position]);
        Reverse(Ranked { key, item, state: position })
    };
    let mut position: Vec<usize> = hulls.iter().map(|hull| hull.len().saturating_sub(1)).collect();
    let mut steps: BinaryHeap<Reverse<Ranked>> =
        (0..items.len()).filter(|&item| position[item] > 0).map(|item| step(item, position[item])).collect();
    let best = items.iter().zip(&hulls).filter_map(|(item, hull)| Some(u128::from(item[*hull.last()?].cost)));
    let (mut cost, mut price): (u128, f64) = (best.sum(), 0.0);
    while cost > u128::from(limit) {
        // The cheapest states fit, so while the total does not there is a step to give up.
        let Some(Reverse(given_up)) = steps.pop() else { break };
        let (item, hull) = (given_up.item, &hulls[given_up.item]);
        price = given_up.key;
        cost -=
            u128::from(items[item][hull[given_up.state]].cost - items[item][hull[given_up.state - 1]].cost);
        position[item] -= 1;
        if position[item] > 0 {
            steps.push(step(item, position[item]));
        }
    }
    let mut states: Vec<usize> = hulls
        .iter()
        .zip(&position)
        .map(|(hull, &position)| hull.get(position).copied().unwrap_or(0))
        .collect();
    refill(items, limit - total(items, &states).0, &mut states);
    (states, price)
}

/// Up to this many candidates [`fill_grid`] takes part: about half a millisecond.
const FEW: usize = 512;
/// Steps that the limit is divided into.
const GRID: u64 = 1024;

/// The optimum for costs rounded up to a grid, by dynamic programming, then refilled: exact where the room above the
/// cheapest states is at most [`GRID`]. The cheapest states must fit.
fn fill_grid(items: &[Vec<Candidate>], limit: u64) -> Vec<usize> {
    let least = |item: &[Candidate]| item.iter().map(|c| c.cost).min().unwrap_or(0);
    let room = limit - items.iter().map(|item| least(item)).sum::<u64>();
    let grid = room.min(GRID);
    let width = grid as usize + 1;
    // More than the grid has where there is no room.
    let steps_of = |extra: u64| -> usize {
        let steps = (u128::from(extra) * u128::from(grid)).div_ceil(u128::from(room.max(1)));
        if extra > room { width } else { steps as usize }
    };
    // best[g]: the best quality of the items so far at g steps of cost or less; and the states that give it.
    let mut best = vec![0.0; width];
    let mut choices: Vec<Vec<u16>> = Vec::with_capacity(items.len());
    for item in items {
        let (mut next, mut choice) = (vec![f64::NEG_INFINITY; width], vec![0u16; width]);
        if item.is_empty() {
            next.copy_from_slice(&best);
        }
        for (state, candidate) in item.iter().enumerate() {
            let (steps, value) = (steps_of(candidate.cost - least(item)), quality(candidate));
            for (g, before) in (steps..width).zip(&best) {
                if before + value > next[g] {
                    (next[g], choice[g]) = (before + value, state as u16);
                }
            }
        }
        choices.push(choice);
        best = next;
    }
    let mut states = vec![0; items.len()];
    let mut g = width - 1;
    for (i, item) in items.iter().enumerate().rev() {
        let state = usize::from(choices[i][g]);
        states[i] = state;
        if let Some(candidate) = item.get(state) {
            g -= steps_of(candidate.cost - least(item));
        }
    }
    refill(items, limit - total(items, &states).0, &mut states);
    states
}

/// Spends what is left: while any candidate fits and gains quality, the one that gains most.
fn refill(items: &[Vec<Candidate>], mut left: u64, states: &mut [usize]) {
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
