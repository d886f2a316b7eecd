//! In which order objects are corrected, one level at a time (Haber 2001 §3).
//!
//! In: one priority per object and how many levels it has. Out: (object, level) pairs, best first.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// What happens to an object that was selected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reselection {
    /// Its priority is multiplied by this factor in (0, 1), and it competes again. The paper's 0.8–0.9
    /// is worse than no order at all; 0.2–0.35 is far better (REFERENCE H11).
    Reduce(f32),
    /// Winner takes all: it keeps winning until its last level is done.
    WinnerTakesAll,
}

impl Default for Reselection {
    fn default() -> Self {
        Self::Reduce(0.25)
    }
}

/// One selected level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Selected {
    /// Object id.
    pub object: u32,
    /// Level, 1 (coarsest) … the object's number of levels.
    pub level: u32,
    /// The priority it won with.
    pub priority: f32,
}

impl Eq for Selected {}

impl Ord for Selected {
    /// By priority, then the lower object id: the order is a function of the input alone.
    fn cmp(&self, other: &Self) -> Ordering {
        self.priority
            .total_cmp(&other.priority)
            .then_with(|| other.object.cmp(&self.object))
            .then_with(|| other.level.cmp(&self.level))
    }
}

impl PartialOrd for Selected {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// The selections of one view, as an iterator.
#[derive(Clone, Debug)]
pub struct Selection {
    heap: BinaryHeap<Selected>,
    levels: Vec<u32>,
    reselection: Reselection,
}

impl Selection {
    /// `priorities[o]` and `levels[o]` belong to object o. Objects without positive priority or without levels
    /// are never selected.
    pub fn new(priorities: &[f32], levels: &[u32], reselection: Reselection) -> Self {
        let heap = (0u32..)
            .zip(priorities.iter().zip(levels))
            .filter(|(_, (priority, levels))| **priority > 0.0 && **levels > 0)
            .map(|(object, (&priority, _))| Selected { object, level: 1, priority })
            .collect();
        Self { heap, levels: levels.to_vec(), reselection }
    }
}

impl Iterator for Selection {
    type Item = Selected;

    fn next(&mut self) -> Option<Selected> {
        let won = self.heap.pop()?;
        if won.level < self.levels[won.object as usize] {
            let factor = match self.reselection {
                Reselection::Reduce(factor) => factor,
                Reselection::WinnerTakesAll => 1.0,
            };
            self.heap.push(Selected { level: won.level + 1, priority: won.priority * factor, ..won });
        }
        Some(won)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn order(priorities: &[f32], levels: &[u32], reselection: Reselection) -> Vec<(u32, u32)> {
        Selection::new(priorities, levels, reselection).map(|s| (s.object, s.level)).collect()
    }

    #[test]
    fn reduction_lets_others_in() {
        let order = order(&[0.0, 1.0, 0.3], &[9, 3, 2], Reselection::Reduce(0.5));
        assert_eq!(order, [(1, 1), (1, 2), (2, 1), (1, 3), (2, 2)]);
    }

    #[test]
    fn a_strong_reduction_is_level_by_level() {
        let order = order(&[0.0, 1.0, 0.3], &[0, 3, 3], Reselection::Reduce(0.25));
        assert_eq!(order, [(1, 1), (2, 1), (1, 2), (2, 2), (1, 3), (2, 3)]);
    }

    #[test]
    fn the_winner_takes_all() {
        let order = order(&[0.5, 0.7, 0.7, f32::NAN], &[1, 2, 2, 4], Reselection::WinnerTakesAll);
        assert_eq!(order, [(1, 1), (1, 2), (2, 1), (2, 2), (0, 1)]);
    }

    #[test]
    fn every_level_comes_exactly_once_and_in_order() {
        let priorities: Vec<f32> = (0..40).map(|i| crate::rng::unit_f32(crate::rng::hash(i, 0, 0))).collect();
        let levels: Vec<u32> = (0..40).map(|i| i % 8).collect();
        for reselection in [Reselection::Reduce(0.9), Reselection::Reduce(0.2), Reselection::WinnerTakesAll] {
            let mut done = vec![0; 40];
            let mut last = f32::INFINITY;
            for s in Selection::new(&priorities, &levels, reselection) {
                done[s.object as usize] += 1;
                assert_eq!(done[s.object as usize], s.level);
                assert!(s.priority <= last);
                last = s.priority;
            }
            assert_eq!(done, levels);
        }
    }
}
