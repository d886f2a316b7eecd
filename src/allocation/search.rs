//! The search behind [`super::knapsack`], in steps of bounded work, so that a decision for thousands of candidates takes
//! a little of many frames instead of all of one (the aim: 0.1 ms in any frame).
//!
//! In: items one by one, then work to spend. Out: the same allocation however the work was portioned. Work is counted,
//! not timed, so that what is decided when does not depend on the machine.

use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;

use super::knapsack::{Allocation, Candidate, HYSTERESIS, LimitTooSmall, hull_into, quality, slope};

/// Up to this many candidates dynamic programming takes part: about half a millisecond.
const FEW: usize = 512;
/// Steps that the limit is divided into.
const GRID: u64 = 1024;
/// Cells of the grid that are one unit of work.
const CELLS_PER_WORK: u64 = 32;

/// A key that may stand in a heap, with the item that breaks ties.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
struct Ranked {
    key: f64,
    item: u32,
    state: u32,
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

/// The items of a problem, one after another.
#[derive(Clone, Debug, Default, serde::Serialize, serde::Deserialize)]
struct Items {
    /// With the qualities that count: those of `true_quality` with [`HYSTERESIS`].
    candidates: Vec<Candidate>,
    true_quality: Vec<f64>,
    /// Where each item begins, and the end of the last.
    starts: Vec<usize>,
}

impl Items {
    fn len(&self) -> usize {
        self.starts.len() - 1
    }

    fn get(&self, item: usize) -> &[Candidate] {
        &self.candidates[self.starts[item]..self.starts[item + 1]]
    }

    /// Cost and quality of chosen states that are within a limit.
    fn total(&self, states: &[usize]) -> (u64, f64) {
        let chosen = || (0..self.len()).filter_map(|i| self.get(i).get(states[i]));
        (chosen().map(|c| c.cost).sum(), chosen().map(quality).sum())
    }
}

/// What a search does next.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
enum Phase {
    /// Items are added.
    Gathering,
    /// Steps are given up until the limit is met.
    GivingUp,
    /// What is left of the limit is spent.
    Refilling(Refill),
    /// The states found so far have a rival by dynamic programming.
    Gridding(Vec<usize>, Grid),
    /// What the rival has left is spent.
    RefillingGrid(Vec<usize>, Refill),
}

/// A knapsack on its way.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
pub struct Search {
    limit: u64,
    items: Items,
    /// Hulls of all items, one after another, and where each begins.
    hulls: Vec<usize>,
    hull_starts: Vec<usize>,
    /// Where on its hull each item is.
    position: Vec<usize>,
    /// The step down from there.
    steps: BinaryHeap<Reverse<Ranked>>,
    smallest: u128,
    cost: u128,
    price: f64,
    phase: Phase,
    /// Most candidates for dynamic programming.
    few: usize,
    /// Room to work in.
    room: [Vec<usize>; 2],
}

impl Search {
    /// Without items so far; the total cost is to be at most `limit`.
    pub fn new(limit: u64) -> Self {
        Self {
            limit,
            items: Items { starts: vec![0], ..Items::default() },
            hulls: Vec::new(),
            hull_starts: vec![0],
            position: Vec::new(),
            steps: BinaryHeap::new(),
            smallest: 0,
            cost: 0,
            price: 0.0,
            phase: Phase::Gathering,
            few: FEW,
            room: [Vec::new(), Vec::new()],
        }
    }

    /// The same without dynamic programming.
    #[cfg(test)]
    pub(super) fn greedy(limit: u64) -> Self {
        Self { few: 0, ..Self::new(limit) }
    }

    /// Adds an item that is in state `now`, if that exists: what falls short of it does so [`HYSTERESIS`] times. All
    /// steps up to that state are worth more by this factor, those above it what they were.
    pub fn add(&mut self, candidates: &[Candidate], now: Option<usize>) {
        let present = now.and_then(|state| candidates.get(state)).map_or(f64::NEG_INFINITY, quality);
        let first = self.items.candidates.len();
        for c in candidates {
            let of_its_own = quality(c);
            let short = (present - of_its_own).max(0.0);
            let valued = of_its_own - (HYSTERESIS - 1.0) * short;
            self.items.candidates.push(Candidate { cost: c.cost, quality: valued });
            self.items.true_quality.push(of_its_own);
        }
        self.items.starts.push(self.items.candidates.len());
        let item = self.position.len();
        let valued = &self.items.candidates[first..];
        let [order, hull] = &mut self.room;
        hull_into(valued, order, hull);
        if let (Some(&cheapest), Some(&best)) = (hull.first(), hull.last()) {
            self.smallest += u128::from(valued[cheapest].cost);
            self.cost += u128::from(valued[best].cost);
        }
        self.hulls.extend_from_slice(hull);
        self.hull_starts.push(self.hulls.len());
        self.position.push(hull.len().saturating_sub(1));
        self.push_step(item);
    }

    fn hull(&self, item: usize) -> &[usize] {
        &self.hulls[self.hull_starts[item]..self.hull_starts[item + 1]]
    }

    /// The step that an item would give up next.
    fn push_step(&mut self, item: usize) {
        let position = self.position[item];
        if position > 0 {
            let hull = self.hull(item);
            let key = slope(self.items.get(item), hull[position - 1], hull[position]);
            self.steps.push(Reverse(Ranked { key, item: item as u32, state: position as u32 }));
        }
    }

    /// Goes on for as long as there is `work`, of which one unit is a few dozen nanoseconds; the result once there is
    /// one. After that it is of no more use.
    ///
    /// # Errors
    /// Where not even the cheapest candidates fit.
    pub fn go_on(&mut self, work: &mut u64) -> Option<Result<Allocation, LimitTooSmall>> {
        while *work > 0 {
            match &mut self.phase {
                Phase::Gathering => {
                    if self.smallest > u128::from(self.limit) {
                        let smallest = u64::try_from(self.smallest).unwrap_or(u64::MAX);
                        return Some(Err(LimitTooSmall { limit: self.limit, smallest }));
                    }
                    self.phase = Phase::GivingUp;
                }
                Phase::GivingUp => {
                    if self.give_up(work) {
                        let states: Vec<usize> = (0..self.items.len())
                            .map(|item| self.hull(item).get(self.position[item]).copied().unwrap_or(0))
                            .collect();
                        spend(work, states.len() as u64 / 4);
                        self.phase = Phase::Refilling(Refill::new(&self.items, self.limit, states));
                    }
                }
                Phase::Refilling(refill) => {
                    if refill.go_on(&self.items, work) {
                        let states = std::mem::take(&mut refill.states);
                        if self.items.candidates.len() > self.few {
                            return Some(Ok(self.result(states)));
                        }
                        self.phase = Phase::Gridding(states, Grid::new(&self.items, self.limit));
                    }
                }
                Phase::Gridding(states, grid) => {
                    if grid.go_on(&self.items, work) {
                        let rival = grid.states(&self.items);
                        let states = std::mem::take(states);
                        let refill = Refill::new(&self.items, self.limit, rival);
                        self.phase = Phase::RefillingGrid(states, refill);
                    }
                }
                Phase::RefillingGrid(states, refill) => {
                    if refill.go_on(&self.items, work) {
                        let (greedy, rival) = (std::mem::take(states), std::mem::take(&mut refill.states));
                        let is_better = self.items.total(&rival).1 > self.items.total(&greedy).1;
                        return Some(Ok(self.result(if is_better { rival } else { greedy })));
                    }
                }
            }
        }
        None
    }

    /// Goes on to the end.
    ///
    /// # Errors
    /// Where not even the cheapest candidates fit.
    pub fn finish(mut self) -> Result<Allocation, LimitTooSmall> {
        loop {
            if let Some(result) = self.go_on(&mut u64::MAX.clone()) {
                return result;
            }
        }
    }

    fn result(&self, states: Vec<usize>) -> Allocation {
        let (cost, _) = self.items.total(&states);
        let of_its_own = |i: usize| self.items.true_quality[self.items.starts[i]..].get(states[i]);
        let has_any = |&i: &usize| !self.items.get(i).is_empty();
        let quality = (0..states.len()).filter(has_any).filter_map(of_its_own).sum();
        Allocation { states, cost, quality, price: self.price }
    }

    /// Gives up hull steps of least quality per cost. Whether the limit is met.
    fn give_up(&mut self, work: &mut u64) -> bool {
        while self.cost > u128::from(self.limit) {
            if *work == 0 {
                return false;
            }
            spend(work, 6);
            // The cheapest states fit, so while the total does not there is a step to give up.
            let Some(Reverse(given_up)) = self.steps.pop() else { return true };
            let (item, position) = (given_up.item as usize, given_up.state as usize);
            self.price = given_up.key;
            let (hull, candidates) = (self.hull(item), self.items.get(item));
            let saved = candidates[hull[position]].cost - candidates[hull[position - 1]].cost;
            self.cost -= u128::from(saved);
            self.position[item] = position - 1;
            self.push_step(item);
        }
        true
    }
}

fn spend(work: &mut u64, units: u64) {
    *work = work.saturating_sub(units);
}

/// Spends what is left: while any candidate fits and gains quality, the one that gains most.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
struct Refill {
    states: Vec<usize>,
    left: u64,
    /// Items that were asked for their gain.
    asked: usize,
    /// The best that each could gain when it was asked; there was no less room then.
    gains: BinaryHeap<Ranked>,
}

impl Refill {
    fn new(items: &Items, limit: u64, states: Vec<usize>) -> Self {
        let left = limit.saturating_sub(items.total(&states).0);
        Self { states, left, asked: 0, gains: BinaryHeap::new() }
    }

    /// The candidate of an item that fits and gains most.
    fn best(&self, items: &Items, item: usize) -> Option<Ranked> {
        let candidates = items.get(item);
        let now = candidates.get(self.states[item])?;
        let mut best: Option<Ranked> = None;
        for (state, c) in candidates.iter().enumerate() {
            let gain = quality(c) - quality(now);
            if gain > best.map_or(0.0, |b| b.key) && c.cost.saturating_sub(now.cost) <= self.left {
                best = Some(Ranked { key: gain, item: item as u32, state: state as u32 });
            }
        }
        best
    }

    /// Whether it is done.
    fn go_on(&mut self, items: &Items, work: &mut u64) -> bool {
        while self.asked < items.len() {
            if *work == 0 {
                return false;
            }
            spend(work, 1 + items.get(self.asked).len() as u64 / 4);
            let best = self.best(items, self.asked);
            self.gains.extend(best);
            self.asked += 1;
        }
        while *work > 0 {
            let Some(found) = self.gains.pop() else { return true };
            let item = found.item as usize;
            spend(work, 4 + items.get(item).len() as u64 / 4);
            // There may be less room by now.
            let best = self.best(items, item);
            if best == Some(found) {
                let (now, then) = (self.states[item], found.state as usize);
                let candidates = items.get(item);
                self.left -= candidates[then].cost.saturating_sub(candidates[now].cost);
                self.states[item] = then;
                let next = self.best(items, item);
                self.gains.extend(next);
            } else {
                self.gains.extend(best);
            }
        }
        false
    }
}

/// The optimum for costs rounded up to a grid, by dynamic programming: exact where the room above the cheapest states is
/// at most [`GRID`]. The cheapest states must fit.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
struct Grid {
    /// What the limit leaves above the cheapest states.
    room: u64,
    steps: u64,
    /// best[g]: the best quality of the items so far at g steps of cost or less.
    best: Vec<f64>,
    next: Vec<f64>,
    /// The states that give it.
    choices: Vec<Vec<u16>>,
}

impl Grid {
    fn new(items: &Items, limit: u64) -> Self {
        let room = limit - (0..items.len()).map(|i| least(items.get(i))).sum::<u64>();
        let steps = room.min(GRID);
        let width = steps as usize + 1;
        Self { room, steps, best: vec![0.0; width], next: vec![0.0; width], choices: Vec::new() }
    }

    /// Steps of so much cost; more than the grid has where there is no room.
    fn steps_of(&self, extra: u64) -> usize {
        let steps = (u128::from(extra) * u128::from(self.steps)).div_ceil(u128::from(self.room.max(1)));
        if extra > self.room { self.best.len() } else { steps as usize }
    }

    /// Whether all items are in.
    fn go_on(&mut self, items: &Items, work: &mut u64) -> bool {
        while self.choices.len() < items.len() {
            if *work == 0 {
                return false;
            }
            let item = items.get(self.choices.len());
            spend(work, 1 + item.len() as u64 * self.steps / CELLS_PER_WORK);
            let width = self.best.len();
            let mut choice = vec![0u16; width];
            if item.is_empty() {
                self.choices.push(choice);
                continue;
            }
            self.next.fill(f64::NEG_INFINITY);
            for (state, candidate) in item.iter().enumerate() {
                let (steps, value) = (self.steps_of(candidate.cost - least(item)), quality(candidate));
                for (g, before) in (steps..width).zip(&self.best) {
                    if before + value > self.next[g] {
                        (self.next[g], choice[g]) = (before + value, state as u16);
                    }
                }
            }
            self.choices.push(choice);
            std::mem::swap(&mut self.best, &mut self.next);
        }
        true
    }

    /// The states of the best quality within the limit.
    fn states(&self, items: &Items) -> Vec<usize> {
        let mut states = vec![0; items.len()];
        let mut g = self.steps as usize;
        for i in (0..items.len()).rev() {
            let (item, state) = (items.get(i), usize::from(self.choices[i][g]));
            states[i] = state;
            if let Some(candidate) = item.get(state) {
                g -= self.steps_of(candidate.cost - least(item));
            }
        }
        states
    }
}

/// Cost of the cheapest candidate.
fn least(item: &[Candidate]) -> u64 {
    item.iter().map(|c| c.cost).min().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::allocation::knapsack::allocate;
    use crate::rng::Stream;

    fn item(random: &mut Stream, states: usize) -> Vec<Candidate> {
        let mut quality = 0.0;
        let of_state = |i: usize| {
            quality -= f64::from(random.next_f32()).powi(3);
            Candidate { cost: 4u64 << (2 * (states - i)), quality }
        };
        (0..states).map(of_state).collect()
    }

    #[test]
    fn portions_of_work_change_nothing() {
        let mut random = Stream::new(4, 0, 0);
        for (count, states) in [(30, 6), (300, 8)] {
            let items: Vec<_> = (0..count).map(|_| item(&mut random, states)).collect();
            let limit = items.iter().map(|item| item[0].cost).sum::<u64>() / 3;
            let now: Vec<usize> = (0..count).map(|i| i % states).collect();
            let at_once = allocate(&items, limit, Some(&now));
            for portion in [1, 7, 1000] {
                let mut search = Search::new(limit);
                items.iter().zip(&now).for_each(|(item, now)| search.add(item, Some(*now)));
                let (mut portions, mut most) = (0, 0);
                let found = loop {
                    portions += 1;
                    let mut work = portion;
                    let found = search.go_on(&mut work);
                    most = most.max(portion - work);
                    if let Some(found) = found {
                        break found;
                    }
                };
                assert_eq!(found, at_once, "in portions of {portion}");
                assert!(portions > 3 && most <= portion);
            }
        }
    }
}
