//! Rays by decision theory: the expected drop of visible error per second of each object's next levels,
//! estimated while tracing (REFERENCE §13; neither paper has this).
//!
//! In: how far each new sample was from what its pixel showed before, and how long it took. Out: utilities that
//! [`super::policy::Policy::Utility`] orders by, when an object is good enough, how large a job should be.
//!
//! The lattice's levels are uniform samples of the pixels that are not traced yet, so the mean difference over one
//! level estimates the object's error before it, without a reference and without further rays.

use crate::perception::tvi::TviTable;

/// Most levels of the hierarchy.
pub const LEVELS_MAX: usize = crate::sampling::Lattice::K_LIMIT as usize + 1;

/// Differences between new samples and what was shown, in just noticeable differences.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Residual {
    sum: f64,
    sum_of_squares: f64,
    count: u32,
}

impl Residual {
    /// Adds one sample: displayed luminance in cd/m² before and after, seen by an eye adapted to the brighter.
    #[inline]
    pub fn add(&mut self, thresholds: &TviTable, shown: f32, sampled: f32) {
        self.add_difference((shown - sampled).abs() / thresholds.threshold(shown.max(sampled)));
    }

    /// Adds one sample's difference. What is no number ≥ 0 counts as a sample without difference.
    #[inline]
    pub fn add_difference(&mut self, difference: f32) {
        let difference = if difference > 0.0 { f64::from(difference.min(1e9)) } else { 0.0 };
        self.sum += difference;
        self.sum_of_squares += difference * difference;
        self.count += 1;
    }

    /// Adds a batch of which only the sum of differences and their number are known.
    pub fn add_sum(&mut self, sum: f32, count: u32) {
        if count > 0 {
            let sum = if sum > 0.0 { f64::from(sum.min(1e30)) } else { 0.0 };
            self.sum += sum;
            // As if all were equal; the spread between batches still counts.
            self.sum_of_squares += sum * sum / f64::from(count);
            self.count += count;
        }
    }

    /// Adds all of `other`.
    pub fn merge(&mut self, other: &Self) {
        self.sum += other.sum;
        self.sum_of_squares += other.sum_of_squares;
        self.count += other.count;
    }

    /// Number of samples.
    pub fn count(&self) -> u32 {
        self.count
    }

    /// r_l, the mean difference; none without samples.
    pub fn mean(&self) -> Option<f32> {
        (self.count > 0).then(|| (self.sum / f64::from(self.count)) as f32)
    }

    /// Standard error of the mean. Twice that of independent samples: those of a lattice are correlated (REFERENCE §13.1).
    pub fn standard_error(&self) -> f32 {
        if self.count < 2 {
            return f32::INFINITY;
        }
        let n = f64::from(self.count);
        let variance = ((self.sum_of_squares - self.sum * self.sum / n) / (n - 1.0)).max(0.0);
        (2.0 * (variance / n).sqrt()) as f32
    }
}

/// Constants of the estimate.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct RaySettings {
    /// ρ₀: the expected ratio of an object's errors from level to level before any was seen.
    pub ratio_prior: f32,
    /// n₀: how many observed ratios the prior counts as.
    pub ratio_prior_weight: f32,
    /// Smallest and largest ratio that is believed.
    pub ratio_bounds: [f32; 2],
    /// Levels of fewer samples say nothing about ratios.
    pub ratio_samples_min: u32,
    /// Seconds per ray before any was measured.
    pub seconds_per_ray_prior: f32,
    /// Share of a new measurement in the moving average of seconds per ray.
    pub seconds_share: f32,
    /// Error of an object of which a level is handed out but no sample has come back, just noticeable differences.
    pub error_prior: f32,
    /// An object whose error is below this many just noticeable differences gives its rays away.
    pub visible_jnd: f32,
}

impl RaySettings {
    /// r_l is too high by up to 17 %, as a level's samples are as far from older ones as pixels can be; on average by
    /// this factor (REFERENCE §13.1).
    pub const BIAS: f32 = 1.1;
}

impl Default for RaySettings {
    fn default() -> Self {
        Self {
            ratio_prior: 0.6,
            ratio_prior_weight: 1.0,
            ratio_bounds: [0.1, 0.95],
            ratio_samples_min: 4,
            seconds_per_ray_prior: 2e-6,
            seconds_share: 0.2,
            error_prior: 3.0,
            visible_jnd: 0.5,
        }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
struct ObjectRays {
    /// Residual of each level, index level − 1.
    residuals: [Residual; LEVELS_MAX],
    /// Moving average; 0 before any measurement.
    seconds_per_ray: f32,
}

/// What an object still wants, for [`RayLedger::utility`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayDemand<'a> {
    /// Object id.
    pub object: u32,
    /// A_o, pixels that show it.
    pub pixels: u32,
    /// w_o, how much its errors matter: combined saliency and importance, 1 on average.
    pub weight: f32,
    /// The level to be traced next, 1 (coarsest) ….
    pub level: u32,
    /// Samples left in that level and in each finer one, in this order; the last is the finest there is.
    pub left: &'a [u32],
    /// How long samples hold, in frames: under camera motion what does not last is worth less. Infinite for a still view.
    pub life_frames: f32,
}

/// The estimates of all objects of a view.
#[derive(Clone, Debug, Default, serde::Serialize, serde::Deserialize)]
pub struct RayLedger {
    settings: RaySettings,
    objects: Vec<ObjectRays>,
}

impl RayLedger {
    /// Nothing known yet.
    pub fn new(settings: RaySettings) -> Self {
        Self { settings, objects: Vec::new() }
    }

    /// Forgets residuals, which belong to a view, and keeps the cost of rays, which belongs to the object.
    /// `count`: number of object ids.
    pub fn start_view(&mut self, count: usize) {
        self.objects.resize(count, ObjectRays::default());
        self.objects.iter_mut().for_each(|object| object.residuals = Default::default());
    }

    /// Records a batch: `rays` samples of `level` of `object` that took `seconds` of one core, and their residual. Ids and
    /// levels that do not exist are passed over.
    pub fn record(&mut self, object: u32, level: u32, residual: &Residual, rays: u32, seconds: f32) {
        let Some(entry) = self.objects.get_mut(object as usize) else { return };
        let Some(at) = (level as usize).checked_sub(1).and_then(|i| entry.residuals.get_mut(i)) else {
            return;
        };
        at.merge(residual);
        if rays > 0 && seconds > 0.0 && seconds.is_finite() {
            let measured = seconds / rays as f32;
            let old = entry.seconds_per_ray;
            let share = self.settings.seconds_share;
            entry.seconds_per_ray = if old > 0.0 { old + share * (measured - old) } else { measured };
        }
    }

    /// c_o: the moving average of the object's seconds per ray; the mean over measured objects where it has none.
    pub fn seconds_per_ray(&self, object: u32) -> f32 {
        let own = self.objects.get(object as usize).map_or(0.0, |entry| entry.seconds_per_ray);
        if own > 0.0 {
            return own;
        }
        let measured =
            self.objects.iter().map(|entry| entry.seconds_per_ray).filter(|seconds| *seconds > 0.0);
        let (sum, count) = measured.fold((0.0, 0.0), |(sum, count), seconds| (sum + seconds, count + 1.0));
        if count > 0.0 { sum / count } else { self.settings.seconds_per_ray_prior }
    }

    /// ρ_o: by how much a further level reduces the object's error, from the ratios of consecutive levels.
    pub fn ratio(&self, object: u32) -> f32 {
        let settings = &self.settings;
        let (mut sum, mut count) =
            (settings.ratio_prior * settings.ratio_prior_weight, settings.ratio_prior_weight);
        let [low, high] = settings.ratio_bounds;
        if let Some(entry) = self.objects.get(object as usize) {
            for pair in entry.residuals.windows(2) {
                let enough = pair.iter().all(|residual| residual.count >= settings.ratio_samples_min.max(1));
                if let (true, Some(before), Some(after)) = (enough, pair[0].mean(), pair[1].mean())
                    && before > 0.0
                {
                    sum += (after / before).clamp(low, high);
                    count += 1.0;
                }
            }
        }
        if count > 0.0 { (sum / count).clamp(low, high) } else { high }
    }

    /// e_o: the error the object shows now, mean over its pixels, in just noticeable differences; none before its first
    /// level. `level` and `left` as in [`RayDemand`].
    pub fn displayed_error(&self, object: u32, level: u32, left_in_level: u32) -> Option<f32> {
        let entry = self.objects.get(object as usize)?;
        let finest = entry.residuals.iter().rposition(|residual| residual.count > 0)?;
        let residual = &entry.residuals[finest];
        let before = residual.mean()?;
        // A level that is traced in part has reduced the error in part.
        let current = finest + 1 == level as usize;
        let left = if current { f64::from(left_in_level) } else { 0.0 };
        let done = f64::from(residual.count) / (f64::from(residual.count) + left);
        Some(before * (1.0 - done as f32 * (1.0 - self.ratio(object))))
    }

    /// P_o: the best drop of visible error (weighted just noticeable differences times pixels) per second that tracing up to
    /// some later level gives; infinite for the first level of an object, 0 where nothing is left.
    ///
    /// The maximum over later levels is the look-ahead: an object whose error does not fall before its last level, which
    /// is exact, would starve otherwise (REFERENCE §13.2).
    pub fn utility(&self, demand: &RayDemand) -> f32 {
        let left: u64 = demand.left.iter().map(|&samples| u64::from(samples)).sum();
        if left == 0 || demand.pixels == 0 {
            return 0.0;
        }
        let first = demand.left.first().copied().unwrap_or(0);
        let error = match self.displayed_error(demand.object, demand.level, first) {
            Some(error) => error,
            None if demand.level <= 1 => return f32::INFINITY,
            // Its first samples are on their way.
            None => self.settings.error_prior,
        };
        let ratio = self.ratio(demand.object);
        let (mut best, mut remaining, mut samples) = (0.0f32, 1.0f32, 0u64);
        for (step, &in_level) in demand.left.iter().enumerate() {
            samples += u64::from(in_level);
            remaining = if step + 1 == demand.left.len() { 0.0 } else { remaining * ratio };
            best = best.max((1.0 - remaining) / samples.max(1) as f32);
        }
        // The share of a sample's worth that is still there in the next frames; 1 for a still view.
        let life = if demand.life_frames.is_nan() { 1.0 } else { 1.0 - (-demand.life_frames.max(0.0)).exp() };
        let utility =
            demand.weight * demand.pixels as f32 * error * best * life / self.seconds_per_ray(demand.object);
        if utility > 0.0 { utility.min(f32::MAX) } else { 0.0 }
    }

    /// Utilities of all demands relative to the largest finite one, in [0, 1], for [`super::policy::Demand::utility`].
    /// Objects of which nothing was traced come first, at 1; the others stay below it, at 0.99 at most.
    pub fn utilities(&self, demands: &[RayDemand]) -> Vec<f32> {
        let raw: Vec<f32> = demands.iter().map(|demand| self.utility(demand)).collect();
        let largest = raw.iter().copied().filter(|utility| utility.is_finite()).fold(0.0, f32::max);
        raw.iter()
            .map(|&utility| match utility {
                f32::INFINITY => 1.0,
                _ if largest > 0.0 => 0.99 * (utility / largest),
                _ => 0.0,
            })
            .collect()
    }

    /// Whether what is left of the object's error cannot be seen: r/1.1 + 2 standard errors below the visible
    /// difference. Its rays are better spent elsewhere while anything else is left.
    pub fn is_good_enough(&self, object: u32) -> bool {
        let Some(entry) = self.objects.get(object as usize) else { return false };
        let last = entry.residuals.iter().rev().find(|residual| residual.count > 0);
        last.is_some_and(|residual| {
            let mean = residual.mean().unwrap_or(f32::INFINITY) / RaySettings::BIAS;
            mean + 2.0 * residual.standard_error() < self.settings.visible_jnd
        })
    }

    /// Samples of a job of the object that takes about `seconds`, between 32 and 512 (measured optimum of job sizes).
    pub fn job_size(&self, object: u32, seconds: f32) -> u32 {
        // The cast saturates and sends NaN to 0.
        ((seconds / self.seconds_per_ray(object)) as u32).clamp(32, 512)
    }
}

/// λ: the utility below which an object is skipped, adapted so that the frame time is met (REFERENCE §13.3).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StoppingThreshold {
    lambda: f32,
}

impl StoppingThreshold {
    /// η: how fast λ follows.
    const RATE: f32 = 0.5;

    /// A threshold in the unit of [`RayLedger::utility`].
    pub fn new(lambda: f32) -> Self {
        Self { lambda: if lambda.is_finite() { lambda.max(f32::MIN_POSITIVE) } else { f32::MIN_POSITIVE } }
    }

    /// λ.
    pub fn lambda(&self) -> f32 {
        self.lambda
    }

    /// Whether an object of this utility is worth a ray.
    pub fn admits(&self, utility: f32) -> bool {
        utility >= self.lambda
    }

    /// λ ← λ exp(η (used − budget) / budget), times in one unit. Exponents are kept within ±1.
    pub fn adapt(&mut self, used: f32, budget: f32) {
        let excess = (used - budget) / budget;
        if excess.is_finite() {
            let factor = (Self::RATE * excess).clamp(-1.0, 1.0).exp();
            self.lambda = (self.lambda * factor).clamp(f32::MIN_POSITIVE, f32::MAX);
        }
    }
}

#[cfg(test)]
#[path = "rays_tests.rs"]
mod tests;
