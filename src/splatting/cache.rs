//! The sample cache and its ageing (Haber 2001 §4.5; REFERENCE §11, corrections H6–H8).
//!
//! Samples live in the batches they were traced in, per object and level: ageing deletes whole ages
//! of an object, which drops batches and moves no sample.

use std::sync::Arc;

use glam::Vec3;

use super::SampleBatch;

/// When a cached sample no longer holds for the new view.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct AgeingRules {
    /// Haber's δ: largest change of ⟨normal, view⟩, both unit (0.05–0.2; REFERENCE §11 advises small ones).
    pub delta: f32,
    /// Largest age in views.
    pub max_age: u32,
    /// Samples that a level must have to stand for the others.
    pub n_min: usize,
}

impl Default for AgeingRules {
    fn default() -> Self {
        Self { delta: 0.1, max_age: 64, n_min: 10 }
    }
}

/// Samples by object and level.
#[derive(Clone, Debug, Default)]
pub struct SampleCache {
    /// Ascending by object.
    objects: Vec<ObjectSamples>,
    len: usize,
    capacity: usize,
}

#[derive(Clone, Debug, Default)]
struct ObjectSamples {
    object: u32,
    /// Batches by level set k; within a level in order of arrival.
    levels: Vec<Vec<Arc<SampleBatch>>>,
}

/// Votes of one age.
#[derive(Clone, Copy, Default)]
struct Votes {
    total: u32,
    invalid: u32,
}

impl SampleCache {
    /// A cache of at most `capacity` samples.
    pub fn new(capacity: usize) -> Self {
        Self { objects: Vec::new(), len: 0, capacity }
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether it holds no sample.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Forgets everything (the scene or its illumination changed). Returns how many samples went.
    pub fn clear(&mut self) -> usize {
        self.objects.clear();
        std::mem::take(&mut self.len)
    }

    /// Keeps a batch. Above the capacity the oldest views' batches go first, among them the finest
    /// levels (their loss shows least). Returns how many samples were evicted.
    pub fn insert(&mut self, batch: Arc<SampleBatch>) -> usize {
        if batch.is_empty() {
            return 0;
        }
        let at = match self.objects.binary_search_by_key(&batch.object, |o| o.object) {
            Ok(at) => at,
            Err(at) => {
                self.objects.insert(at, ObjectSamples { object: batch.object, levels: Vec::new() });
                at
            }
        };
        let levels = &mut self.objects[at].levels;
        let k = batch.k as usize;
        if levels.len() <= k {
            levels.resize_with(k + 1, Vec::new);
        }
        self.len += batch.len();
        levels[k].push(batch);
        if self.len > self.capacity { self.evict() } else { 0 }
    }

    /// Drops oldest views until an eighth of the capacity is free, so that it runs rarely.
    fn evict(&mut self) -> usize {
        let before = self.len;
        let mut keys: Vec<(u32, u32, usize)> = self.batches().map(|b| (b.view, b.k, b.len())).collect();
        keys.sort_unstable();
        let mut excess = self.len - self.capacity * 7 / 8;
        // Everything before this (view, k) goes.
        let mut bound = (0, 0);
        for (view, k, len) in keys {
            bound = (view, k + 1);
            excess = excess.saturating_sub(len);
            if excess == 0 {
                break;
            }
        }
        self.retain(|b| (b.view, b.k) >= bound);
        before - self.len
    }

    fn retain(&mut self, keep: impl Fn(&SampleBatch) -> bool) {
        for object in &mut self.objects {
            for level in &mut object.levels {
                level.retain(|b| keep(b));
            }
        }
        self.recount();
    }

    fn recount(&mut self) {
        self.objects.retain(|o| o.levels.iter().any(|l| !l.is_empty()));
        self.len = self.batches().map(SampleBatch::len).sum();
    }

    fn batches(&self) -> impl Iterator<Item = &SampleBatch> {
        self.objects.iter().flat_map(|o| o.levels.iter().flatten()).map(|b| &**b)
    }

    /// All batches as they are shared, by object and level, in order of arrival: [`SampleCache::insert`]ed in this order
    /// they make the same cache.
    pub fn shared(&self) -> impl Iterator<Item = &Arc<SampleBatch>> {
        self.objects.iter().flat_map(|o| o.levels.iter().flatten())
    }

    /// All batches, coarse levels before fine ones, in order of arrival within an object's level.
    pub fn coarse_to_fine(&self) -> impl Iterator<Item = &SampleBatch> {
        let deepest = self.objects.iter().map(|o| o.levels.len()).max().unwrap_or(0);
        (0..deepest).rev().flat_map(move |k| {
            self.objects.iter().filter_map(move |o| o.levels.get(k)).flatten().map(|b| &**b)
        })
    }

    /// Samples per level set k, for reports.
    pub fn len_per_level(&self) -> Vec<usize> {
        let deepest = self.objects.iter().map(|o| o.levels.len()).max().unwrap_or(0);
        (0..deepest)
            .map(|k| self.objects.iter().filter_map(|o| o.levels.get(k)).flatten().map(|b| b.len()).sum())
            .collect()
    }

    /// Ages the cache for a camera at `eye`, in its `view`-th view. `angle_limit` gives for an object
    /// the cosine of the largest turn of the view direction about a sample that its lobe allows.
    /// Returns how many samples expired.
    ///
    /// Per object, the coarsest level with at least `n_min` samples votes for each age; an age with
    /// more than half of its votes invalid goes, on all levels. Ages without a sample on that level are
    /// judged by the coarsest level that has one (the paper never invalidates those).
    pub fn age(
        &mut self,
        view: u32,
        eye: Vec3,
        rules: &AgeingRules,
        angle_limit: impl Fn(u32) -> f32,
    ) -> usize {
        let before = self.len;
        let mut votes: Vec<Votes> = Vec::new();
        for object in &mut self.objects {
            // Age first (correction H7).
            for level in &mut object.levels {
                level.retain(|b| view.wrapping_sub(b.view) <= rules.max_age);
            }
            votes.clear();
            votes.resize(rules.max_age as usize + 1, Votes::default());
            let cosine_limit = angle_limit(object.object);
            let sizes = |l: &Vec<Arc<SampleBatch>>| l.iter().map(|b| b.len()).sum::<usize>();
            let voting = object.levels.iter().rposition(|l| sizes(l) >= rules.n_min);
            // From the coarsest voting level to finer ones, each only for ages that have no vote yet.
            let mut voted = vec![false; votes.len()];
            for k in (0..=voting.unwrap_or(object.levels.len().saturating_sub(1))).rev() {
                let Some(level) = object.levels.get(k) else { continue };
                for batch in level {
                    let age = view.wrapping_sub(batch.view) as usize;
                    if !voted[age] {
                        vote(batch, eye, rules.delta, cosine_limit, &mut votes[age]);
                    }
                }
                for (voted, votes) in voted.iter_mut().zip(&votes) {
                    *voted = votes.total > 0;
                }
            }
            for level in &mut object.levels {
                level.retain(|b| {
                    let v = votes[view.wrapping_sub(b.view) as usize];
                    2 * v.invalid <= v.total
                });
            }
        }
        self.recount();
        before - self.len
    }
}

fn vote(batch: &SampleBatch, eye: Vec3, delta: f32, cosine_limit: f32, votes: &mut Votes) {
    for ((&position, &normal), &old) in batch.positions.iter().zip(&batch.normals).zip(&batch.views) {
        let view = (eye - position).normalize_or_zero();
        let facing = normal.dot(view);
        let bad = (facing - normal.dot(old)).abs() > delta || view.dot(old) < cosine_limit || facing <= 0.0;
        votes.total += 1;
        votes.invalid += u32::from(bad);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math;
    use crate::rng::Stream;
    use crate::splatting::Sample;

    /// Samples on spheres in [−1, 1]³ seen from `eye`, as in REFERENCE §11 (c11).
    fn batch(view: u32, object: u32, k: u32, n: u64, eye: Vec3) -> Arc<SampleBatch> {
        let mut b = SampleBatch::new(view, object, k, 0);
        let mut i = 0;
        while (b.len() as u64) < n {
            let mut s = Stream::new(5, i, u64::from(k));
            i += 1;
            let centre = Vec3::new(s.next_f32(), s.next_f32(), s.next_f32()) * 2.0 - 1.0;
            let z = 1.0 - 2.0 * s.next_f32();
            let phi = std::f32::consts::TAU * s.next_f32();
            let r = (1.0 - z * z).sqrt();
            let normal = Vec3::new(r * math::cos(phi), r * math::sin(phi), z);
            let position = centre + normal * 0.2;
            let to_eye = (eye - position).normalize();
            if normal.dot(to_eye) > 0.05 {
                b.push(Sample {
                    pixel: [0, 0],
                    position,
                    normal,
                    view: to_eye,
                    color: Vec3::ONE,
                    pixel_width: 0.01,
                });
            }
        }
        Arc::new(b)
    }

    const EYE: Vec3 = Vec3::new(0.0, 0.0, 4.0);
    const NO_LIMIT: f32 = -2.0;

    fn invalid_share(eye: Vec3) -> f32 {
        let b = batch(0, 1, 0, 4000, EYE);
        let mut v = Votes::default();
        vote(&b, eye, 0.1, NO_LIMIT, &mut v);
        v.invalid as f32 / v.total as f32
    }

    /// REFERENCE §11: a 0.2 dolly kills nothing once view vectors are normalised (H6: 49 % in the paper's form);
    /// a lateral move of 1.2 kills most.
    #[test]
    fn dolly_keeps_and_lateral_move_kills() {
        assert_eq!(invalid_share(EYE - Vec3::Z * 0.2), 0.0);
        assert!(invalid_share(EYE - Vec3::Z) < 0.06);
        let lateral = invalid_share(EYE + Vec3::X * 1.2);
        assert!((0.5..0.8).contains(&lateral), "{lateral}");
    }

    /// H8: a quarter turn about the normal leaves ⟨n, v⟩ as it was; the angle test sees it.
    #[test]
    fn turning_about_the_normal_is_seen_by_the_angle_limit() {
        let mut b = SampleBatch::new(0, 1, 0, 0);
        b.push(Sample {
            pixel: [0, 0],
            position: Vec3::ZERO,
            normal: Vec3::Y,
            view: Vec3::new(1.0, 1.0, 0.0).normalize(),
            color: Vec3::ONE,
            pixel_width: 0.01,
        });
        let eye = Vec3::new(0.0, 4.0, 4.0);
        let mut votes = Votes::default();
        vote(&b, eye, 0.1, NO_LIMIT, &mut votes);
        assert_eq!(votes.invalid, 0);
        vote(&b, eye, 0.1, 0.9, &mut votes);
        assert_eq!(votes.invalid, 1);
    }

    #[test]
    fn whole_ages_go_on_all_levels_and_others_stay() {
        let mut cache = SampleCache::new(100_000);
        let aside = EYE + Vec3::X * 2.5;
        for (view, eye) in [(1, aside), (2, EYE)] {
            cache.insert(batch(view, 7, 3, 50, eye));
            cache.insert(batch(view, 7, 0, 500, eye));
        }
        let expired = cache.age(3, EYE, &AgeingRules::default(), |_| NO_LIMIT);
        assert_eq!((expired, cache.len()), (550, 550));
        assert!(cache.coarse_to_fine().all(|b| b.view == 2));
    }

    /// The paper never invalidates an age that has no sample on the voting level.
    #[test]
    fn ages_without_coarse_samples_are_judged_by_finer_ones() {
        let mut cache = SampleCache::new(100_000);
        cache.insert(batch(2, 7, 3, 50, EYE));
        cache.insert(batch(1, 7, 0, 500, EYE + Vec3::X * 2.5));
        assert_eq!(cache.age(3, EYE, &AgeingRules::default(), |_| NO_LIMIT), 500);
    }

    #[test]
    fn max_age_and_capacity_hold() {
        let mut cache = SampleCache::new(1000);
        let rules = AgeingRules { max_age: 3, ..Default::default() };
        for view in 0..20 {
            cache.age(view, EYE, &rules, |_| NO_LIMIT);
            cache.insert(batch(view, 1, 1, 150, EYE));
            assert!(cache.len() <= 4 * 150);
        }
        for view in 20..60 {
            cache.insert(batch(view, view % 3, 1, 150, EYE));
            assert!(cache.len() <= 1000);
        }
        let kept: Vec<u32> = cache.coarse_to_fine().map(|b| b.view).collect();
        assert!(kept.iter().all(|&v| v >= 53), "the newest stay: {kept:?}");
    }
}
