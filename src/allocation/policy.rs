//! Which samples next: the policies of the allocator over (object, level) pairs.
//!
//! In: what is known of an object and the level it would get. Out: a priority in [0, 1] and the bucket of a
//! job pool it belongs in. Level 1 is the coarsest, as in Haber 2001 §4.3.

use std::fmt;
use std::str::FromStr;

use crate::math;
use crate::rng;

/// Buckets of the job pool.
pub const BUCKETS: u8 = 64;

/// How (object, level) pairs are ordered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
pub enum Policy {
    /// Saliency and importance, reduced per level (Haber 2001 §4.4).
    Attention,
    /// Pixels covered, reduced per level.
    Coverage,
    /// Every object's level 1, then every object's level 2, and so on.
    Uniform,
    /// Any order.
    Random,
    /// Expected drop of visible error per time ([`super::rays`], REFERENCE §13.2).
    #[default]
    Utility,
}

impl Policy {
    /// All of them, in the order of the documentation.
    pub const ALL: [Self; 5] = [Self::Attention, Self::Coverage, Self::Uniform, Self::Random, Self::Utility];

    /// The name on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Attention => "attention",
            Self::Coverage => "coverage",
            Self::Uniform => "uniform",
            Self::Random => "random",
            Self::Utility => "utility",
        }
    }
}

impl fmt::Display for Policy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Policy {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Self::ALL.into_iter().find(|policy| policy.name() == name).ok_or_else(|| {
            format!("no policy is called \"{name}\": attention, coverage, uniform, random or utility")
        })
    }
}

/// What a policy may ask about an object's next level.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Demand {
    /// Object id, ≥ 1.
    pub object: u32,
    /// The level to be traced, 1 (coarsest) … l_max.
    pub level: u32,
    /// Combined saliency and importance in [0, 1] ([`crate::perception::importance::priorities`]).
    pub attention: f32,
    /// Share of the picture's pixels that show the object, in [0, 1].
    pub coverage: f32,
    /// Expected drop of visible error per time relative to the best object's, in [0, 1]
    /// ([`super::rays::RayLedger::utility`]); read by [`Policy::Utility`] alone.
    pub utility: f32,
    /// Frame or view number: the random policy draws anew for each.
    pub frame: u64,
}

/// A policy with its constants.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct RayPolicy {
    /// The order.
    pub policy: Policy,
    /// Factor on the priority for each level beyond the first, in (0, 1).
    pub reduction: f32,
    /// Seed of the random policy.
    pub seed: u64,
}

impl RayPolicy {
    /// Best in the study of REFERENCE §13.4 with .2 and .35: utility per ray falls by .09–.2 per level (H11).
    pub const REDUCTION: f32 = 0.25;
    /// "Reduced by 10–20 %" (Haber 2001 §3, §4.4): worse than uniform in that study.
    pub const HABER_REDUCTION: f32 = 0.85;

    /// A policy with the default constants.
    pub const fn new(policy: Policy, seed: u64) -> Self {
        Self { policy, reduction: Self::REDUCTION, seed }
    }

    /// Priority in [0, 1] of tracing `demand.level` of `demand.object`; 0 for an invisible object.
    ///
    /// Within one policy larger is earlier; priorities of different policies do not compare.
    pub fn priority(&self, demand: &Demand) -> f32 {
        let steps = demand.level.saturating_sub(1);
        let visible = demand.coverage > 0.0;
        let priority = match self.policy {
            _ if !visible => 0.0,
            // A visible object without attention still gets its turn, at the very end.
            Policy::Attention => demand.attention.max(1e-6) * self.reduction.powi(steps as i32),
            Policy::Coverage => demand.coverage * self.reduction.powi(steps as i32),
            // A power of two per level: each level has buckets of its own.
            Policy::Uniform => 0.5f32.powi(steps as i32),
            Policy::Random => {
                let of_pair = rng::hash(demand.frame, u64::from(demand.object), u64::from(demand.level));
                // Evenly over the buckets, which are logarithmic.
                math::exp2(-20.0 * rng::unit_f32(rng::mix(of_pair ^ rng::mix(self.seed))))
            }
            Policy::Utility => demand.utility,
        };
        if priority.is_finite() { priority.clamp(0.0, 1.0) } else { 0.0 }
    }
}

/// The bucket of a priority: 0, which is popped first, holds 1, each further one a factor of about √2 less, 63 all the
/// rest.
///
/// Boundaries are the powers of two and one and a half times these, read off the bits of the float, so that no
/// rounding of a logarithm decides. Monotone.
pub fn bucket_of(priority: f32) -> u8 {
    /// Exponent and first bit of the mantissa of 1.0.
    const ONE: u32 = 1.0f32.to_bits() >> 22;
    const LAST: u8 = BUCKETS - 1;
    if priority > 0.0 {
        u8::try_from(ONE.saturating_sub(priority.to_bits() >> 22)).map_or(LAST, |bucket| bucket.min(LAST))
    } else {
        LAST
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn demand(object: u32, level: u32, attention: f32, coverage: f32) -> Demand {
        Demand { object, level, attention, coverage, ..Demand::default() }
    }

    fn order(policy: Policy) -> Vec<(u32, u32)> {
        let ray_policy = RayPolicy::new(policy, 7);
        let mut pairs = Vec::new();
        for level in 1..=3 {
            pairs.push(demand(1, level, 1.0, 0.01));
            pairs.push(demand(2, level, 0.1, 0.5));
        }
        pairs.sort_by(|a, b| ray_policy.priority(b).total_cmp(&ray_policy.priority(a)));
        pairs.iter().map(|d| (d.object, d.level)).collect()
    }

    #[test]
    fn each_policy_orders_by_its_own_measure() {
        assert_eq!(order(Policy::Attention), [(1, 1), (1, 2), (2, 1), (1, 3), (2, 2), (2, 3)]);
        assert_eq!(order(Policy::Coverage), [(2, 1), (2, 2), (2, 3), (1, 1), (1, 2), (1, 3)]);
        let levels: Vec<_> = order(Policy::Uniform).iter().map(|pair| pair.1).collect();
        assert_eq!(levels, [1, 1, 2, 2, 3, 3]);
    }

    #[test]
    fn random_depends_on_seed_frame_object_and_level_only() {
        let policy = RayPolicy::new(Policy::Random, 7);
        let base = Demand { frame: 3, ..demand(5, 2, 0.5, 0.5) };
        assert_eq!(policy.priority(&base), policy.priority(&Demand { attention: 0.9, ..base }));
        for other in [
            policy.priority(&Demand { frame: 4, ..base }),
            policy.priority(&Demand { object: 6, ..base }),
            policy.priority(&Demand { level: 3, ..base }),
            RayPolicy { seed: 8, ..policy }.priority(&base),
        ] {
            assert_ne!(other, policy.priority(&base));
        }
        // Every one of the first 40 buckets is used about equally.
        let mut used = [0u32; BUCKETS as usize];
        for object in 0..4000 {
            used[bucket_of(policy.priority(&Demand { object, ..base })) as usize] += 1;
        }
        assert!(used[1..40].iter().all(|&n| (40..200).contains(&n)), "{used:?}");
    }

    #[test]
    fn invisible_objects_and_wrong_numbers_have_priority_zero() {
        for policy in Policy::ALL {
            let policy = RayPolicy::new(policy, 1);
            assert_eq!(policy.priority(&demand(1, 1, 1.0, 0.0)), 0.0);
            let nan = Demand { utility: f32::NAN, ..demand(1, 1, f32::NAN, 0.3) };
            assert!((0.0..=1.0).contains(&policy.priority(&nan)));
            assert!((0.0..=1.0).contains(&policy.priority(&demand(1, u32::MAX, 1.0, 1.0))));
        }
    }

    #[test]
    fn buckets_are_logarithmic_and_monotone() {
        for (priority, bucket) in [(1.0, 0), (7.5, 0), (f32::INFINITY, 0), (0.75, 1), (0.5, 2), (0.25, 4)] {
            assert_eq!(bucket_of(priority), bucket);
        }
        for nothing in [0.0, -1.0, 1e-30, f32::NAN, f32::NEG_INFINITY] {
            assert_eq!(bucket_of(nothing), BUCKETS - 1);
        }
        let mut last = 0;
        for i in 0..4000 {
            let bucket = bucket_of(0.99f32.powi(i));
            assert!(bucket >= last && bucket - last <= 1);
            last = bucket;
        }
        assert_eq!(last, BUCKETS - 1);
    }

    #[test]
    fn names_round_trip() {
        for policy in Policy::ALL {
            assert_eq!(policy.to_string().parse(), Ok(policy));
        }
        assert!("best".parse::<Policy>().is_err());
    }
}
