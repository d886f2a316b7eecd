//! The order of all rays of a view: jobs, policy and what was learnt from the samples so far, behind one door.
//!
//! In: the objects of a view, how much each matters, residuals and times of finished batches. Out: the next job with
//! its priority. The allocator drives it with messages, a benchmark with a loop.

use crate::display::tone::ToneMap;
use crate::image::{Map2d, luminance};
use crate::perception::importance::ObjectStatistics;
use crate::perception::tvi::TviTable;
use crate::perception::viewing::Viewing;
use crate::sampling::Lattice;
use crate::splatting::SampleBatch;
use glam::Vec3;

use super::jobs::{GUIDES, Part, SampleJob, SampleJobs};
use super::policy::{Demand, Policy, RayPolicy};
use super::rays::{LEVELS_MAX, RayDemand, RayLedger, RaySettings, Residual};

/// What of an object's utility counts once its error cannot be seen: its rays go elsewhere while anything else is left.
const INVISIBLE: f32 = 1e-6;

/// The levels that objects may go through in parts: the finest ones, where nearly all samples are.
const LEVELS_IN_PARTS: u32 = 3;
/// Parts of the finest level along an edge of a square picture, about.
const PARTS_ALONG: f32 = 16.0;

/// Views in which samples bring what their guides show after the last guide was followed.
const GUIDING_VIEWS: u8 = 4;

/// What guides save counts as much of what samples save: they hold for one view, and samples for the next ones, too.
const GUIDES_LAST: f32 = 0.6;

/// Tiles hold at least one of so many parts of a job. Smaller ones let rays go more precisely to where they are wanted, and
/// cost more messages.
const FAIR_PART: u32 = 4;

/// A job should not take longer, seconds (REFERENCE §13.3).
const JOB_SECONDS: f32 = 2e-3;

/// Most samples of a batch of the finest level whose difference is measured; they stand for the others. No level comes
/// after it that would want to know more.
const MEASURED_LAST: usize = 16;

/// How far an object has come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObjectProgress {
    /// Object id.
    pub object: u32,
    /// Level of its next job, or of that of its coarsest part; 0 where every sample is handed out.
    pub level: u32,
    /// Priority of its next job, or of that of its first part.
    pub priority: f32,
    /// The error it shows, mean over its pixels, just noticeable differences; none where that is not known.
    pub error: Option<f32>,
}

/// Orders the samples of one view after another.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
pub struct RayOrder {
    policy: RayPolicy,
    /// The most attended object converges before all others.
    winner_takes_all: bool,
    lattice: Lattice,
    /// Pixels of the picture.
    picture: f32,
    jobs: SampleJobs,
    ledger: RayLedger,
    statistics: Vec<ObjectStatistics>,
    /// Combined saliency and importance by object id.
    attention: Vec<f32>,
    /// Of the visible objects.
    mean_attention: f32,
    view: u64,
    /// Frames that samples hold, about; infinite while the view stands still.
    life_frames: f32,
    /// By object id, for how many views on samples of fine levels bring what their guides show: while guides are followed.
    guiding: Vec<u8>,
    /// Largest finite utility of the view so far: what priorities are relative to.
    largest: f32,
}

impl RayOrder {
    /// An order for pictures of `pixels` pixels that has not seen a view.
    pub fn new(
        policy: RayPolicy,
        winner_takes_all: bool,
        lattice: Lattice,
        samples_per_job: u32,
        pixels: usize,
    ) -> Self {
        Self {
            policy,
            winner_takes_all,
            lattice,
            picture: pixels.max(1) as f32,
            jobs: SampleJobs::new(lattice, samples_per_job),
            ledger: RayLedger::new(RaySettings::default()),
            statistics: Vec::new(),
            attention: Vec::new(),
            mean_attention: 1.0,
            view: 0,
            life_frames: f32::INFINITY,
            guiding: Vec::new(),
            largest: 0.0,
        }
    }

    /// Another policy and size of jobs from now on; what is handed out stays so.
    pub fn adjust(&mut self, policy: RayPolicy, samples_per_job: u32) {
        self.policy = policy;
        self.jobs.set_samples_per_job(samples_per_job);
        self.reprioritise();
    }

    /// Whether the policy wants to hear of residuals.
    pub fn learns(&self) -> bool {
        self.policy.policy == Policy::Utility
    }

    /// What was learnt.
    pub fn ledger(&self) -> &RayLedger {
        &self.ledger
    }

    /// The error that a part shows, just noticeable differences; none before anything is known.
    fn shown_error(&self, part: &Part) -> Option<f32> {
        if part.is_done() {
            return Some(0.0);
        }
        let levels = self.lattice.levels();
        let all = samples_of_level(part.pixels, self.lattice.k_of(part.level), levels - 1);
        self.ledger.displayed_error(part.id, part.level, all.saturating_sub(part.handed))
    }

    /// How far each visible object has come.
    pub fn object_progress(&self) -> Vec<ObjectProgress> {
        let mut all: Vec<ObjectProgress> = Vec::new();
        for part in self.jobs.parts() {
            // A whole object comes before its parts, which then speak for it.
            let is_whole = part.id == part.object;
            if is_whole {
                let level = if part.is_done() { 0 } else { part.level };
                let priority = if part.is_done() { 0.0 } else { part.priority };
                let error = self.shown_error(part);
                all.push(ObjectProgress { object: part.object, level, priority, error });
            } else if let Some(of) = all.iter_mut().find(|s| s.object == part.object) {
                let pixels = self.statistics.get(part.object as usize).map_or(1, |s| s.pixels.max(1));
                let share = part.pixels as f32 / pixels as f32;
                let error = self.shown_error(part).unwrap_or(RaySettings::default().error_prior);
                of.error = Some(of.error.unwrap_or(0.0) + share * error);
                if !part.is_done() {
                    of.level = if of.level == 0 { part.level } else { of.level.min(part.level) };
                    of.priority = of.priority.max(part.priority);
                }
            }
        }
        all
    }

    /// −Q of the rays: the visible error of all objects, just noticeable differences × pixels. Where nothing is known yet
    /// the usual error is assumed.
    pub fn visible_error(&self) -> f64 {
        let usual = RaySettings::default().error_prior;
        let of = |part: &Part| {
            let error = self.shown_error(part).unwrap_or(usual);
            f64::from(error) * f64::from(part.pixels)
        };
        self.jobs.parts().iter().filter(|part| !part.is_done()).map(of).sum()
    }

    /// Whether every sample of the view is handed out.
    pub fn is_exhausted(&self) -> bool {
        self.jobs.is_exhausted()
    }

    /// Which objects are looked at through guides from the next view on, by id.
    pub fn set_guided(&mut self, guided: Vec<bool>) {
        self.jobs.set_guided(guided);
    }

    /// Starts a view of these objects (by id), which matter by `attention`.
    pub fn start_view(&mut self, view: u64, statistics: &[ObjectStatistics], attention: &[f32]) {
        self.view = view;
        self.statistics.clear();
        self.statistics.extend_from_slice(statistics);
        self.ledger.start_view(statistics.len());
        self.guiding.resize(statistics.len(), 0);
        self.guiding.iter_mut().for_each(|views| *views = views.saturating_sub(1));
        self.largest = 0.0;
        self.set_attention(attention);
        let mut jobs = std::mem::replace(&mut self.jobs, SampleJobs::new(self.lattice, 1));
        jobs.start_view(statistics, |part| self.priority(part));
        self.jobs = jobs;
    }

    /// Forgets the view.
    pub fn clear(&mut self) {
        self.jobs.clear();
    }

    /// How much the objects matter has changed.
    pub fn attend(&mut self, attention: &[f32]) {
        self.set_attention(attention);
        self.reprioritise();
    }

    fn set_attention(&mut self, attention: &[f32]) {
        self.attention.clear();
        self.attention.extend_from_slice(attention);
        let visible = || self.statistics.iter().zip(attention).skip(1).filter(|(s, _)| s.pixels > 0);
        let (sum, count) = visible().fold((0.0, 0.0f32), |(sum, n), (_, a)| (sum + a, n + 1.0));
        self.mean_attention = if sum > 0.0 { sum / count } else { 1.0 };
    }

    /// A batch of samples of `level` is shown, the first of them at `pixel`; its residual.
    /// `guided`: the same with guides, and without, where it has some.
    pub fn record(
        &mut self,
        view: u64,
        object: u32,
        level: u32,
        pixel: [u16; 2],
        residual: &Residual,
        guided: &[Residual; 2],
    ) {
        if view == self.view && self.learns() {
            let [with, without] = guided;
            self.ledger.record_guided(object, [with, without]);
            let part = self.jobs.part_at(object, level, pixel).unwrap_or(object);
            self.ledger.record(part, level, residual, 0, 0.0);
            let mut jobs = std::mem::replace(&mut self.jobs, SampleJobs::new(self.lattice, 1));
            // Parts of which nothing is known yet go by what they are parts of.
            let of = jobs.parts().iter().find(|p| p.id == part).copied();
            let is_touched = |p: &Part| of.is_some_and(|of| p.is_of(&of));
            jobs.reprioritise(is_touched, |part| self.priority(part));
            self.jobs = jobs;
        }
    }

    /// How long `samples` of a level of an object, or guides, took on one core, whatever the view.
    pub fn record_time(&mut self, object: u32, level: u32, samples: u32, seconds: f32) {
        if self.learns() && level == GUIDES {
            self.ledger.record_guides(object, samples, seconds);
        } else if self.learns() {
            self.ledger.record(object, 1, &Residual::default(), samples, seconds);
        }
    }

    fn reprioritise(&mut self) {
        let mut jobs = std::mem::replace(&mut self.jobs, SampleJobs::new(self.lattice, 1));
        jobs.reprioritise(|_| true, |part| self.priority(part));
        self.jobs = jobs;
    }

    /// Pixels along an edge of the parts that objects go through a level in: the smallest tiles that hold a fair part of a job
    /// of the level's samples, each some of the next level's. None where they go on as they are.
    fn part_side(&self, level: u32, samples_per_job: u32) -> Option<i32> {
        let levels = self.lattice.levels();
        if level + LEVELS_IN_PARTS <= levels {
            return None;
        }
        let mut side = ((self.picture.sqrt() / PARTS_ALONG) as i32).clamp(24, 96);
        let k = self.lattice.k_of(level);
        while samples_of_level((side * side) as u32, k, levels - 1) < samples_per_job / FAIR_PART {
            side = side.checked_mul(2)?;
            if side as f32 * side as f32 > self.picture {
                return None;
            }
        }
        Some(side)
    }

    /// The next job, its priority in [0, 1].
    pub fn next(&mut self, ids: &Map2d<u32>) -> Option<(SampleJob, f32)> {
        let mut jobs = std::mem::replace(&mut self.jobs, SampleJobs::new(self.lattice, 1));
        let samples_per_job = jobs.samples_per_job();
        let next = loop {
            let Some(best) = jobs.best() else { break None };
            let part = jobs.parts()[best];
            let begins = part.level > part.first_level && part.handed == 0;
            let longest = (part.rect.x1 - part.rect.x0).max(part.rect.y1 - part.rect.y0);
            if let Some(side) = self.part_side(part.level, samples_per_job)
                && self.learns()
                && begins
                && longest > side
            {
                let tiles = jobs.split(best, side, ids);
                tiles.clone().for_each(|_| self.ledger.add_part(part.id));
                jobs.reprioritise(|part| tiles.contains(&part.id), |part| self.priority(part));
                continue;
            }
            // All jobs take about as long: what is dear is done in small ones, so that none is late for its frame.
            let at_most = match self.learns() {
                true => self.ledger.job_size(part.object, JOB_SECONDS).min(samples_per_job),
                false => samples_per_job,
            };
            let job = match self.guides_first(&part) {
                true => jobs.cut_guides(best, ids, |part| self.priority(part)),
                false => jobs.cut(best, at_most, ids, |part| self.priority(part)),
            };
            if let Some(job) = job {
                break Some(job);
            }
        };
        self.jobs = jobs;
        let (mut job, priority) = next?;
        if let Some(views) = self.guiding.get_mut(job.object as usize) {
            // Coarse samples always do: they tell whether guides are worth it.
            job.guided &=
                job.level == GUIDES || SampleJobs::is_coarse(&self.lattice, job.level) || *views > 0;
            if job.level == GUIDES {
                *views = GUIDING_VIEWS;
            }
        }
        if !self.learns() {
            return Some((job, priority));
        }
        if priority.is_finite() {
            self.largest = self.largest.max(priority);
        }
        let relative = if priority.is_finite() { 0.99 * priority / self.largest.max(1e-30) } else { 1.0 };
        Some((job, relative.clamp(0.0, 1.0)))
    }

    /// Within one policy and view larger is earlier.
    fn priority(&self, part: &Part) -> f32 {
        let pixels = self.statistics.get(part.object as usize).map_or(0, |s| s.pixels);
        let attention = self.attention.get(part.object as usize).copied().unwrap_or(0.0);
        if self.winner_takes_all && self.winner() == Some(part.object) {
            return if self.learns() { f32::INFINITY } else { 1.0 };
        }
        if self.learns() {
            return self.utility(part, attention);
        }
        let coverage = pixels as f32 / self.picture;
        let (object, level) = (part.object, part.level);
        self.policy.priority(&Demand { object, level, attention, coverage, utility: 0.0, frame: self.view })
    }

    fn winner(&self) -> Option<u32> {
        let of = |a: &(usize, &f32), b: &(usize, &f32)| a.1.total_cmp(b.1).then(b.0.cmp(&a.0));
        let best = self.attention.iter().enumerate().skip(1).max_by(of)?;
        (*best.1 > 0.0).then_some(best.0 as u32)
    }

    /// Whether guides are the better next job of a part.
    fn guides_first(&self, part: &Part) -> bool {
        if !self.learns() || !SampleJobs::may_guide(&self.lattice, part) {
            return false;
        }
        let guides = || GUIDES_LAST * self.utility_of(part, 1.0, part.pixels);
        part.is_being_guided() || guides() > self.utility_of(part, 1.0, 0)
    }

    fn utility(&self, part: &Part, attention: f32) -> f32 {
        let samples = self.utility_of(part, attention, 0);
        match SampleJobs::may_guide(&self.lattice, part) {
            true => samples.max(GUIDES_LAST * self.utility_of(part, attention, part.pixels)),
            false => samples,
        }
    }

    /// What a part's next jobs are worth: `guides` of them first, then samples.
    fn utility_of(&self, part: &Part, attention: f32, guides: u32) -> f32 {
        let mut left = [0; LEVELS_MAX];
        let levels = self.lattice.levels();
        let (first, last) = (part.level.max(1), levels.max(1));
        let mut count = 0;
        for l in first..=last {
            left[count] = samples_of_level(part.pixels, self.lattice.k_of(l), levels - 1);
            count += 1;
        }
        left[0] = left[0].saturating_sub(part.handed).max(1);
        let demand = RayDemand {
            object: part.id,
            pixels: part.pixels,
            weight: 0.5 + 0.5 * attention / self.mean_attention,
            level: part.level,
            left: &left[..count],
            guides,
            life_frames: self.life_frames,
        };
        let utility = self.ledger.utility(&demand);
        if self.ledger.is_good_enough(part.id) { utility * INVISIBLE } else { utility }
    }
}

/// About how many of an object's pixels belong to level set k exactly: 4/5 of what is left at each finer level.
fn samples_of_level(pixels: u32, k: u32, k_max: u32) -> u32 {
    let share = if k >= k_max { 0.2f32.powi(k_max as i32) } else { 0.8 * 0.2f32.powi(k as i32) };
    (pixels as f32 * share).ceil() as u32
}

/// How far the samples of a batch are from what their pixels show (`shown_on_it` on the `base`, of sample number, column
/// and row), in just noticeable differences of the displayed, tone-mapped light, seen by an eye adapted to the brighter of
/// the two. To be asked before the batch is splatted.
pub fn residual_of_batch(
    batch: &SampleBatch,
    base: &Map2d<Vec3>,
    shown_on_it: impl Fn(usize, usize, usize) -> Vec3,
    tone: &ToneMap,
    viewing: &Viewing,
    thresholds: &TviTable,
) -> Residual {
    let mut residual = Residual::default();
    let range = viewing.white_cd_m2 - viewing.black_cd_m2;
    let step = if batch.k == 0 { batch.len().div_ceil(MEASURED_LAST).max(1) } else { 1 };
    for (i, (pixel, &color)) in batch.pixels.iter().zip(&batch.colors).enumerate().step_by(step) {
        let (x, y) = (usize::from(pixel[0]), usize::from(pixel[1]));
        let base = base.at(x, y);
        let (shown, sampled) = (tone.to_linear(base + shown_on_it(i, x, y)), tone.to_linear(base + color));
        let adapted = viewing.luminance(shown).max(viewing.luminance(sampled));
        // Channel by channel, so that a wrong hue of the right luminance counts too.
        let difference = luminance((shown - sampled).abs()) * range;
        residual.add_difference(difference / thresholds.threshold(adapted));
    }
    residual.add_unmeasured(batch.len() as u32 - residual.count());
    residual
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::importance::object_statistics;

    fn two_halves() -> Map2d<u32> {
        Map2d::from_fn(100, 50, |x, _| 1 + u32::from(x >= 50))
    }

    fn order(policy: Policy) -> RayOrder {
        RayOrder::new(RayPolicy::new(policy, 0), false, Lattice::new(3, [50, 25]), 64, 5000)
    }

    fn differing(difference: f32, count: u32) -> Residual {
        let mut residual = Residual::default();
        (0..count).for_each(|i| residual.add_difference(difference * (0.9 + 0.2 * (i % 2) as f32)));
        residual
    }

    #[test]
    fn rays_go_where_samples_differ_and_away_where_nothing_is_seen() {
        let ids = two_halves();
        let statistics = object_statistics(&ids, None, 3);
        let mut order = order(Policy::Utility);
        order.start_view(1, &statistics, &[0.0, 1.0, 1.0]);
        // Both objects get their first level before anything is known.
        let first: Vec<u32> = (0..2).map(|_| order.next(&ids).unwrap().0.object).collect();
        assert_eq!(first, [1, 2]);
        order.record(1, 1, 1, [10, 10], &differing(0.01, 20), &Default::default());
        order.record(1, 2, 1, [60, 10], &differing(9.0, 20), &Default::default());
        let mut visited = Vec::new();
        while let Some((job, priority)) = order.next(&ids) {
            assert!((0.0..=1.0).contains(&priority));
            visited.push(job.object);
        }
        let turn = visited.iter().position(|&o| o == 1).expect("its turn comes at the end");
        assert!(visited[..turn].iter().all(|&o| o == 2) && visited[turn..].iter().all(|&o| o == 1));
        assert!(order.is_exhausted());
    }

    #[test]
    fn dear_samples_wait() {
        let ids = two_halves();
        let statistics = object_statistics(&ids, None, 3);
        let mut order = order(Policy::Utility);
        order.start_view(1, &statistics, &[0.0, 1.0, 1.0]);
        order.record_time(1, 1, 100, 100e-6);
        order.record_time(2, 1, 100, 1000e-6);
        assert_eq!([0; 2].map(|_| order.next(&ids).unwrap().0.object), [1, 2]);
        order.record(1, 1, 1, [10, 10], &differing(5.0, 20), &Default::default());
        order.record(1, 2, 1, [60, 10], &differing(6.0, 20), &Default::default());
        assert_eq!(order.next(&ids).unwrap().0.object, 1);
        // A residual of another view says nothing.
        order.record(7, 1, 2, [10, 10], &differing(0.0, 100), &Default::default());
        assert_eq!(order.next(&ids).unwrap().0.object, 1);
    }

    #[test]
    fn other_policies_do_as_they_say() {
        let ids = two_halves();
        let statistics = object_statistics(&ids, None, 3);
        let mut order = order(Policy::Attention);
        order.start_view(1, &statistics, &[0.0, 0.2, 1.0]);
        order.record(1, 2, 1, [60, 10], &differing(0.0, 100), &Default::default());
        assert_eq!(order.next(&ids).unwrap().0.object, 2);
        order.attend(&[0.0, 1.0, 0.2]);
        assert_eq!(order.next(&ids).unwrap().0.object, 1);
    }

    #[test]
    fn levels_sum_to_the_pixels() {
        let sum: u32 = (0..=6).map(|k| samples_of_level(100_000, k, 6)).sum();
        assert!((100_000..100_010).contains(&sum), "{sum}");
    }
}
