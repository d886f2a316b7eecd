//! Rays by decision theory: the expected drop of visible error per second of each object's next levels,
//! estimated while tracing (REFERENCE §13; neither paper has this).
//!
//! In: how far each new sample was from what its pixel showed before, and how long it took. Out: utilities that
//! [`super::policy::Policy::Utility`] orders by, when an object is good enough, how large a job should be.
//!
//! The lattice's levels are uniform samples of the pixels that are not traced yet, so the mean difference over one
//! level estimates the object's error before it, without a reference and without further rays.

use crate::math;
use crate::perception::tvi::TviTable;

use super::decision::{Approximation, Resource, best_step};

/// Most levels of the hierarchy.
pub const LEVELS_MAX: usize = crate::sampling::Lattice::K_LIMIT as usize + 1;

/// Differences between new samples and what was shown, in just noticeable differences.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Residual {
    sum: f64,
    sum_of_squares: f64,
    count: u32,
    /// Samples that these stand for: some may not have been measured.
    of: u32,
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
        self.of += 1;
    }

    /// So many further samples were like those measured.
    pub fn add_unmeasured(&mut self, count: u32) {
        self.of += count;
    }

    /// Adds all of `other`.
    pub fn merge(&mut self, other: &Self) {
        self.sum += other.sum;
        self.sum_of_squares += other.sum_of_squares;
        self.count += other.count;
        self.of += other.of;
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
    /// By how much guides reduce an object's error before any was compared.
    pub guide_ratio_prior: f32,
    /// As how much error that counts, just noticeable differences.
    pub guide_ratio_prior_weight: f32,
    /// Share of a sample's time that a guide takes before any was measured.
    pub guide_share_prior: f32,
    /// Error of an object of which a level is handed out but no sample has come back, just noticeable differences.
    pub error_prior: f32,
    /// As how many samples an expectation counts.
    pub prior_samples: f32,
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
            guide_ratio_prior: 0.8,
            guide_ratio_prior_weight: 16.0,
            guide_share_prior: 0.15,
            error_prior: 3.0,
            prior_samples: 4.0,
            visible_jnd: 0.5,
        }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
struct ObjectRays {
    /// Residual of each level, index level − 1.
    residuals: [Residual; LEVELS_MAX],
    /// Moving average; 0 before any measurement. Of whole objects only.
    seconds_per_ray: f32,
    /// The same of guides.
    seconds_per_guide: f32,
    /// Differences of samples from what their pixels would have shown with guides, and without; those of former views
    /// count the less the older they are.
    guided: [f32; 2],
    /// What a part is a part of; none of a whole object.
    parent: Option<u32>,
}

/// What an object still wants, for [`RayLedger::utility`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayDemand<'a> {
    /// Object id, or that of a part of one.
    pub object: u32,
    /// A_o, pixels that show it.
    pub pixels: u32,
    /// w_o, how much its errors matter: combined saliency and importance, 1 on average.
    pub weight: f32,
    /// The level to be traced next, 1 (coarsest) ….
    pub level: u32,
    /// Samples left in that level and in each finer one, in this order; the last is the finest there is.
    pub left: &'a [u32],
    /// Pixels whose guides come before all that.
    pub guides: u32,
    /// How long samples hold, in frames: under camera motion what does not last is worth less. Infinite for a still view.
    pub life_frames: f32,
}

/// Rays under a limit of time, which each frame has anew: approximation 0 is what an object shows, the others what it
/// would show after its next levels, the last of them exact. Of all of them the frame takes best steps
/// ([`best_step`]) until its time is up.
#[derive(Clone, Copy, Debug)]
pub struct RayChoices<'a> {
    /// What is known.
    pub ledger: &'a RayLedger,
    /// What each object or part wants.
    pub demands: &'a [RayDemand<'a>],
}

impl Resource for RayChoices<'_> {
    fn action_count(&self) -> usize {
        self.demands.len()
    }

    fn saliency(&self, action: usize) -> f64 {
        let demand = &self.demands[action];
        // The share of a sample's worth that is still there in the next frames; 1 for a still view.
        let life =
            if demand.life_frames.is_nan() { 1.0 } else { 1.0 - math::exp(-demand.life_frames.max(0.0)) };
        f64::from(demand.weight * life)
    }

    fn approximations(&self, action: usize, out: &mut Vec<Approximation>) {
        let demand = &self.demands[action];
        let first = demand.left.first().copied().unwrap_or(0);
        let shown = self.ledger.displayed_error(demand.object, demand.level, first);
        let error = f64::from(demand.pixels as f32 * shown.unwrap_or(self.ledger.settings.error_prior));
        let (seconds, ratio) = (self.ledger.seconds_per_ray(demand.object), self.ledger.ratio(demand.object));
        out.push(Approximation { cost: 0, error });
        let (mut remaining, mut cost) = (1.0f32, 0u64);
        if demand.guides > 0 {
            let seconds = self.ledger.seconds_per_guide(demand.object) * demand.guides as f32;
            cost = ((1e9 * seconds) as u64).max(1);
            remaining = self.ledger.guide_ratio(demand.object);
            out.push(Approximation { cost, error: error * f64::from(remaining) });
        }
        for (step, &samples) in demand.left.iter().enumerate() {
            // Nanoseconds; the cast saturates and sends NaN to 0.
            cost = cost.saturating_add(((1e9 * seconds * samples as f32) as u64).max(1));
            remaining = if step + 1 == demand.left.len() { 0.0 } else { remaining * ratio };
            out.push(Approximation { cost, error: error * f64::from(remaining) });
        }
    }
}

/// The estimates of all objects of a view.
#[derive(Clone, Debug, Default, serde::Serialize, serde::Deserialize)]
pub struct RayLedger {
    settings: RaySettings,
    /// Whole objects by id, their parts behind them.
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
        self.objects.iter_mut().for_each(|object| {
            object.residuals = Default::default();
            object.guided = object.guided.map(|sum| 0.5 * sum);
            object.parent = None;
        });
    }

    /// Adds a part of an object or of a part, which from now on has an estimate of its own, beginning with that of what it is
    /// a part of. Parts have the numbers behind those of the objects and earlier parts.
    pub fn add_part(&mut self, of: u32) {
        self.objects.push(ObjectRays { parent: Some(of), ..ObjectRays::default() });
    }

    fn parent(&self, part: u32) -> Option<u32> {
        self.objects.get(part as usize).and_then(|entry| entry.parent)
    }

    fn whole(&self, part: u32) -> u32 {
        std::iter::successors(Some(part), |&part| self.parent(part)).last().unwrap_or(part)
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

    /// `guides` of an object took `seconds` of one core.
    pub fn record_guides(&mut self, object: u32, guides: u32, seconds: f32) {
        let Some(entry) = self.objects.get_mut(object as usize) else { return };
        if guides > 0 && seconds > 0.0 && seconds.is_finite() {
            let (measured, old) = (seconds / guides as f32, entry.seconds_per_guide);
            let share = self.settings.seconds_share;
            entry.seconds_per_guide = if old > 0.0 { old + share * (measured - old) } else { measured };
        }
    }

    /// How far samples of an object were from what their pixels would have shown with guides, and without.
    pub fn record_guided(&mut self, object: u32, [with, without]: [&Residual; 2]) {
        let whole = self.whole(object) as usize;
        if let Some(entry) = self.objects.get_mut(whole) {
            entry.guided[0] += with.sum as f32;
            entry.guided[1] += without.sum as f32;
        }
    }

    /// By how much guides reduce the object's error, at most to nothing.
    pub fn guide_ratio(&self, object: u32) -> f32 {
        let [with, without] =
            self.objects.get(self.whole(object) as usize).map_or([0.0; 2], |entry| entry.guided);
        let weight = self.settings.guide_ratio_prior_weight;
        ((with + weight * self.settings.guide_ratio_prior) / (without + weight)).clamp(0.0, 1.0)
    }

    /// The moving average of the object's seconds per guide; where it has none, a share of what its rays take.
    pub fn seconds_per_guide(&self, object: u32) -> f32 {
        let own = self.objects.get(self.whole(object) as usize).map_or(0.0, |entry| entry.seconds_per_guide);
        if own > 0.0 { own } else { self.settings.guide_share_prior * self.seconds_per_ray(object) }
    }

    /// c_o: the moving average of the object's seconds per ray; the mean over measured objects where it has none.
    pub fn seconds_per_ray(&self, object: u32) -> f32 {
        let whole = self.whole(object) as usize;
        let own = self.objects.get(whole).map_or(0.0, |entry| entry.seconds_per_ray);
        if own > 0.0 {
            return own;
        }
        let measured =
            self.objects.iter().map(|entry| entry.seconds_per_ray).filter(|seconds| *seconds > 0.0);
        let (sum, count) = measured.fold((0.0, 0.0), |(sum, count), seconds| (sum + seconds, count + 1.0));
        if count > 0.0 { sum / count } else { self.settings.seconds_per_ray_prior }
    }

    /// What is known of a level of an object or part: a part takes the word of what it is a part of where it has none of
    /// its own.
    fn residual(&self, object: u32, level: usize) -> Residual {
        let own = self.objects.get(object as usize).map_or(Residual::default(), |e| e.residuals[level]);
        match self.parent(object) {
            Some(parent) if own.count == 0 => self.residual(parent, level),
            _ => own,
        }
    }

    /// ρ_o: by how much a further level reduces the object's error, from the ratios of consecutive levels.
    pub fn ratio(&self, object: u32) -> f32 {
        let settings = &self.settings;
        let (mut sum, mut count) =
            (settings.ratio_prior * settings.ratio_prior_weight, settings.ratio_prior_weight);
        let [low, high] = settings.ratio_bounds;
        let mut coarser = Residual::default();
        for level in 0..LEVELS_MAX {
            let finer = self.residual(object, level);
            let enough = coarser.count.min(finer.count) >= settings.ratio_samples_min.max(1);
            if let (true, Some(before), Some(after)) = (enough, coarser.mean(), finer.mean())
                && before > 0.0
            {
                sum += (after / before).clamp(low, high);
                count += 1.0;
            }
            coarser = finer;
        }
        if count > 0.0 { (sum / count).clamp(low, high) } else { high }
    }

    /// e_o: the error the object shows now, mean over its pixels, in just noticeable differences; none before its first
    /// level. `level` and `left` as in [`RayDemand`].
    ///
    /// A level of few samples says little: each is weighed against what the levels before it led to expect, which counts as
    /// [`RaySettings::prior_samples`].
    pub fn displayed_error(&self, object: u32, level: u32, left_in_level: u32) -> Option<f32> {
        let ratio = self.ratio(object);
        let prior = self.settings.prior_samples;
        let (mut error, mut any) = (self.settings.error_prior, false);
        for l in 0..LEVELS_MAX {
            let residual = self.residual(object, l);
            let Some(mean) = residual.mean() else { continue };
            any = true;
            let count = residual.count as f32;
            let before = (count * mean + prior * error) / (count + prior);
            // A level that is traced in part has reduced the error in part.
            let left = if l + 1 == level as usize { left_in_level as f32 } else { 0.0 };
            let done = residual.of as f32 / (residual.of as f32 + left);
            error = before * (1.0 - done * (1.0 - ratio));
        }
        any.then_some(error)
    }

    /// P_o: the best drop of visible error (weighted just noticeable differences times pixels) per second that tracing up to
    /// some later level gives; infinite for the first level of an object, 0 where nothing is left.
    ///
    /// The first step of the hull over later levels is the look-ahead: an object whose error does not fall before its last
    /// level, which is exact, would starve otherwise (REFERENCE §13.2).
    pub fn utility(&self, demand: &RayDemand) -> f32 {
        let left: u64 = demand.left.iter().map(|&samples| u64::from(samples)).sum();
        if left == 0 || demand.pixels == 0 {
            return 0.0;
        }
        let is_seen = || (0..LEVELS_MAX).any(|level| self.residual(demand.object, level).count > 0);
        if demand.level <= 1 && !is_seen() {
            return f32::INFINITY;
        }
        let choices = RayChoices { ledger: self, demands: std::slice::from_ref(demand) };
        let utility = (1e9 * best_step(&choices, 0, 0)) as f32;
        if utility > 0.0 { utility.min(f32::MAX) } else { 0.0 }
    }

    /// Whether what is left of the object's error cannot be seen: r/1.1 + 2 standard errors, and what samples that happened
    /// to be alike have not shown yet, below the visible difference. Its rays are better spent elsewhere while anything
    /// else is left.
    pub fn is_good_enough(&self, object: u32) -> bool {
        let Some(entry) = self.objects.get(object as usize) else { return false };
        let last = entry.residuals.iter().rev().find(|residual| residual.count > 0);
        last.is_some_and(|residual| {
            let mean = residual.mean().unwrap_or(f32::INFINITY) / RaySettings::BIAS;
            // Of what no sample of n shows there is less than 3/n (at 95 %).
            let unseen = 3.0 / residual.count as f32 * self.settings.error_prior;
            mean + 2.0 * residual.standard_error() + unseen < self.settings.visible_jnd
        })
    }

    /// Samples of a job of the object that takes about `seconds`, between 32 and 512 (measured optimum of job sizes).
    pub fn job_size(&self, object: u32, seconds: f32) -> u32 {
        // The cast saturates and sends NaN to 0.
        ((seconds / self.seconds_per_ray(object)) as u32).clamp(32, 512)
    }
}

#[cfg(test)]
#[path = "rays_tests.rs"]
mod tests;
