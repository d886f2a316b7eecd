//! Dumont's framework: actions with approximations, each with a cost and a quality; keep the best total
//! quality inside a limit (Dumont 2003 §3).
//!
//! A new kind of resource is one impl of [`Resource`]. The optimiser is [`super::knapsack`].

use super::knapsack::{Allocation, Candidate, LimitTooSmall, Search};

/// A limit that total cost may not exceed. Its unit is that of the candidates' costs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Constraint {
    /// Bytes of memory.
    Bytes(u64),
    /// Time per frame, nanoseconds.
    Nanoseconds(u64),
    /// A count of things: mesh elements, rays.
    Count(u64),
}

impl Constraint {
    /// The limit in its unit.
    pub const fn limit(self) -> u64 {
        match self {
            Self::Bytes(limit) | Self::Nanoseconds(limit) | Self::Count(limit) => limit,
        }
    }
}

/// One way to carry out an action.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Approximation {
    /// What it costs, in the constraint's unit.
    pub cost: u64,
    /// Perceptible error ε ≥ 0 of the result, in just noticeable differences times pixels; 0 for the gold standard.
    pub error: f64,
}

impl Approximation {
    /// q = α · (−ε), Dumont 2003 Eq. (2). An error that is no number counts as infinite, a saliency that is none as 0.
    pub fn quality(&self, saliency: f64) -> f64 {
        let saliency = if saliency > 0.0 { saliency.min(f64::MAX) } else { 0.0 };
        if saliency == 0.0 || self.error <= 0.0 {
            0.0
        } else if self.error.is_nan() {
            f64::MIN
        } else {
            -(saliency * self.error).min(f64::MAX)
        }
    }
}

/// Something with actions that share a limit: textures, environment maps, mesh elements, rays.
pub trait Resource {
    /// Number of actions. Each gets exactly one of its approximations.
    fn action_count(&self) -> usize;

    /// α of an action: how much its errors matter, ≥ 0. 1 where saliency is part of the error already.
    fn saliency(&self, action: usize) -> f64;

    /// Appends the approximations of an action, at least one, in any order.
    fn approximations(&self, action: usize, out: &mut Vec<Approximation>);
}

/// A decision on its way: a little work in each frame.
///
/// The resource must be the same whenever it goes on; what has changed since counts in the next decision.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
pub struct Decision {
    search: Search,
    /// Actions that are asked for their approximations.
    asked: usize,
    approximations: Vec<Approximation>,
    candidates: Vec<Candidate>,
}

impl Decision {
    /// Work of one approximation: what it is estimated by, its place on the hull.
    const WORK: u64 = 4;

    /// Nothing is decided yet.
    pub fn new(constraint: Constraint) -> Self {
        Self {
            search: Search::new(constraint.limit()),
            asked: 0,
            approximations: Vec::new(),
            candidates: Vec::new(),
        }
    }

    /// Goes on for as long as there is `work` ([`Search::go_on`]): the approximation of each action that gives the best
    /// total quality Q = Σ q (Dumont 2003 Eq. (1)), once that is found. `now` is the present choice, which is preferred a
    /// little ([`super::knapsack::HYSTERESIS`]).
    ///
    /// # Errors
    /// Where not even the cheapest approximations fit.
    pub fn go_on(
        &mut self,
        resource: &impl Resource,
        now: Option<&[usize]>,
        work: &mut u64,
    ) -> Option<Result<Allocation, LimitTooSmall>> {
        while self.asked < resource.action_count() {
            if *work == 0 {
                return None;
            }
            let action = self.asked;
            candidates_of(resource, action, &mut self.approximations, &mut self.candidates);
            self.search.add(&self.candidates, now.and_then(|now| now.get(action).copied()));
            *work = work.saturating_sub(1 + Self::WORK * self.candidates.len() as u64);
            self.asked += 1;
        }
        self.search.go_on(work)
    }
}

fn candidates_of(
    resource: &impl Resource,
    action: usize,
    room: &mut Vec<Approximation>,
    out: &mut Vec<Candidate>,
) {
    room.clear();
    resource.approximations(action, room);
    let saliency = resource.saliency(action);
    out.clear();
    out.extend(room.iter().map(|a| Candidate { cost: a.cost, quality: a.quality(saliency) }));
}

/// What [`Decision`] comes to, at once.
///
/// # Errors
/// Where not even the cheapest approximations fit.
pub fn decide(
    resource: &impl Resource,
    constraint: Constraint,
    now: Option<&[usize]>,
) -> Result<Allocation, LimitTooSmall> {
    let mut decision = Decision::new(constraint);
    loop {
        if let Some(result) = decision.go_on(resource, now, &mut u64::MAX.clone()) {
            return result;
        }
    }
}

/// Quality per cost of the best step that an action can take from its approximation `from`, the first of the hull above
/// it; 0 where none is better. The order of resources that are spent one by one, as rays are.
pub fn best_step(resource: &impl Resource, action: usize, from: usize) -> f64 {
    let mut approximations = Vec::new();
    resource.approximations(action, &mut approximations);
    let Some(now) = approximations.get(from) else { return 0.0 };
    let saliency = resource.saliency(action);
    let (cost, quality) = (now.cost, now.quality(saliency));
    let per_cost = |a: &Approximation| {
        let gain = a.quality(saliency) - quality;
        gain / a.cost.saturating_sub(cost).max(1) as f64
    };
    approximations.iter().filter(|a| a.cost > cost).map(per_cost).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Objects of different saliency, each drawn roughly, well, or not at all.
    struct Drawings(Vec<f64>);

    impl Resource for Drawings {
        fn action_count(&self) -> usize {
            self.0.len()
        }

        fn saliency(&self, action: usize) -> f64 {
            self.0[action]
        }

        fn approximations(&self, _: usize, out: &mut Vec<Approximation>) {
            out.extend([(0, 10.0), (3, 2.0), (8, 0.0)].map(|(cost, error)| Approximation { cost, error }));
        }
    }

    #[test]
    fn the_salient_is_drawn_well() {
        let drawings = Drawings(vec![1.0, 5.0, 0.1]);
        let chosen = |limit| decide(&drawings, Constraint::Count(limit), None).unwrap();
        assert_eq!(chosen(24).states, [2, 2, 2]);
        assert_eq!(chosen(11).states, [1, 2, 0]);
        assert_eq!(chosen(3).states, [0, 1, 0]);
        assert_eq!(chosen(0).states, [0, 0, 0]);
        assert_eq!(chosen(11).quality, -2.0 - 1.0);
    }

    #[test]
    fn quality_is_never_positive_and_never_nan() {
        let values = [0.0, 1.0, -1.0, f64::NAN, f64::INFINITY, f64::MAX];
        for error in values {
            for saliency in values {
                let quality = Approximation { cost: 1, error }.quality(saliency);
                assert!(quality <= 0.0 && quality.is_finite(), "{error} {saliency}: {quality}");
            }
        }
    }
}
