//! Dumont's framework: actions with approximations, each with a cost and a quality; keep the best total
//! quality inside a limit (Dumont 2003 §3).
//!
//! A new kind of resource is one impl of [`Resource`]. The optimiser is [`super::knapsack`].

use super::knapsack::{self, Allocation, Candidate, LimitTooSmall};

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
#[derive(Clone, Copy, Debug, PartialEq)]
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

/// The approximation of each action that gives the best total quality Q = Σ q (Dumont 2003 Eq. (1)) under
/// `constraint`. `now` is the present choice, which is preferred a little ([`knapsack::HYSTERESIS`]).
pub fn decide(
    resource: &impl Resource,
    constraint: Constraint,
    now: Option<&[usize]>,
) -> Result<Allocation, LimitTooSmall> {
    let mut approximations = Vec::new();
    let items: Vec<Vec<Candidate>> = (0..resource.action_count())
        .map(|action| {
            approximations.clear();
            resource.approximations(action, &mut approximations);
            let saliency = resource.saliency(action);
            approximations.iter().map(|a| Candidate { cost: a.cost, quality: a.quality(saliency) }).collect()
        })
        .collect();
    knapsack::allocate(&items, constraint.limit(), now)
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
