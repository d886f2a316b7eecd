//! The order of sample jobs: which object, level and stretch of the lattice is traced next
//! (Haber 2001 §4.1, §4.4).
//!
//! Each visible object goes through its levels from coarse to fine. Taking a job cuts `n_job`
//! samples from the level at its cursor (the paper's iterator position); the rest of the level stays
//! with the object. A finished level goes back one level finer, at the priority the policy gives that.

use crate::image::Map2d;
use crate::perception::importance::ObjectStatistics;
use crate::sampling::{Cursor, Lattice, Rect};

/// An order for one tracer: `count` samples of one level of one object, from `start` on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct SampleJob {
    /// Object id.
    pub object: u32,
    /// Level, 1 … l_max.
    pub level: u32,
    /// The object's bounds in the picture.
    pub rect: Rect,
    /// Where in the level to begin.
    pub start: Cursor,
    /// Samples to trace: pixels of the level, from `start`, that show the object.
    pub count: u32,
}

/// How far one object has come.
#[derive(Clone, Copy, Debug, serde::Serialize, serde::Deserialize)]
struct Progress {
    object: u32,
    rect: Rect,
    level: u32,
    /// `None` once every level is handed out.
    cursor: Option<Cursor>,
    /// Samples of this level that are handed out.
    handed: u32,
    priority: f32,
}

/// Where an object stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Standing {
    /// Object id.
    pub object: u32,
    /// Level of its next job; 0 where every sample is handed out.
    pub level: u32,
    /// Samples of that level that are handed out.
    pub handed: u32,
    /// Priority of its next job.
    pub priority: f32,
}

/// The objects of one view and what is left to trace of them.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
pub struct SampleJobs {
    lattice: Lattice,
    samples_per_job: u32,
    objects: Vec<Progress>,
}

impl SampleJobs {
    /// No object yet. `samples_per_job` is the paper's n_job, at least 1.
    pub fn new(lattice: Lattice, samples_per_job: u32) -> Self {
        Self { lattice, samples_per_job: samples_per_job.max(1), objects: Vec::new() }
    }

    /// Jobs of so many samples from now on.
    pub fn set_samples_per_job(&mut self, samples: u32) {
        self.samples_per_job = samples.max(1);
    }

    /// The lattice.
    pub fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// Starts a view: `statistics[id]` of every object; id 0 (diffuse) and invisible ones are left out.
    /// `priority(object, level)` is asked whenever an object enters a level.
    pub fn start_view(&mut self, statistics: &[ObjectStatistics], priority: impl Fn(u32, u32) -> f32) {
        self.objects.clear();
        for (id, s) in statistics.iter().enumerate().skip(1).filter(|(_, s)| s.pixels > 0) {
            let rect = Rect { x0: s.x0 as i32, y0: s.y0 as i32, x1: s.x1 as i32, y1: s.y1 as i32 };
            let object = id as u32;
            self.objects.push(Progress {
                object,
                rect,
                level: 1,
                cursor: Some(Cursor { x: rect.x0, y: rect.y0 }),
                handed: 0,
                priority: priority(object, 1),
            });
        }
    }

    /// Forgets the view.
    pub fn clear(&mut self) {
        self.objects.clear();
    }

    /// Asks for priorities anew, of all objects or one: `priority(object, level, samples of it handed out)`.
    pub fn reprioritise(&mut self, only: Option<u32>, priority: impl Fn(u32, u32, u32) -> f32) {
        for o in self.objects.iter_mut().filter(|o| only.is_none_or(|only| only == o.object)) {
            o.priority = priority(o.object, o.level, o.handed);
        }
    }

    /// Whether every sample of the view is handed out.
    pub fn is_exhausted(&self) -> bool {
        self.objects.iter().all(|o| o.cursor.is_none())
    }

    /// Where each visible object stands, for whoever looks on.
    pub fn standings(&self) -> impl Iterator<Item = Standing> {
        self.objects.iter().map(|o| match o.cursor {
            Some(_) => Standing { object: o.object, level: o.level, handed: o.handed, priority: o.priority },
            None => Standing { object: o.object, level: 0, handed: 0, priority: 0.0 },
        })
    }

    /// The next job and its priority: the object of highest priority (the lowest id among equals).
    /// Levels of which the object shows no pixel cost nothing.
    pub fn next(&mut self, ids: &Map2d<u32>, priority: impl Fn(u32, u32) -> f32) -> Option<(SampleJob, f32)> {
        loop {
            let mut best: Option<usize> = None;
            for (i, o) in self.objects.iter().enumerate().filter(|(_, o)| o.cursor.is_some()) {
                if best.is_none_or(|b| o.priority.total_cmp(&self.objects[b].priority).is_gt()) {
                    best = Some(i);
                }
            }
            let o = &mut self.objects[best?];
            let Some(start) = o.cursor else { continue };
            let mut samples = self.lattice.samples(o.level, o.rect, start);
            let mut count = 0;
            while count < self.samples_per_job {
                let Some((x, y)) = samples.next() else { break };
                count += u32::from(ids.at(x as usize, y as usize) == o.object);
            }
            let job = SampleJob { object: o.object, level: o.level, rect: o.rect, start, count };
            let job_priority = o.priority;
            o.cursor = samples.cursor();
            o.handed += count;
            if o.cursor.is_none() && o.level < self.lattice.levels() {
                o.level += 1;
                o.handed = 0;
                o.cursor = Some(Cursor { x: o.rect.x0, y: o.rect.y0 });
                o.priority = priority(o.object, o.level);
            }
            if count > 0 {
                return Some((job, job_priority));
            }
        }
    }
}

/// The pixels of a job.
pub fn job_pixels<'a>(
    lattice: &Lattice,
    job: &SampleJob,
    ids: &'a Map2d<u32>,
) -> impl Iterator<Item = (i32, i32)> + use<'a> {
    let object = job.object;
    lattice
        .samples(job.level, job.rect, job.start)
        .filter(move |&(x, y)| ids.at(x as usize, y as usize) == object)
        .take(job.count as usize)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::importance::object_statistics;
    use proptest::prelude::*;

    /// Two discs and a line one pixel wide on a diffuse ground.
    fn ids(w: usize, h: usize) -> Map2d<u32> {
        let disc = |x: usize, y: usize, cx: f32, cy: f32, r: f32| (x as f32 - cx).hypot(y as f32 - cy) < r;
        Map2d::from_fn(w, h, |x, y| {
            if y == h / 2 {
                3
            } else if disc(x, y, 0.3 * w as f32, 0.4 * h as f32, 0.25 * h as f32) {
                1
            } else if disc(x, y, 0.8 * w as f32, 0.6 * h as f32, 0.15 * h as f32) {
                2
            } else {
                0
            }
        })
    }

    proptest! {
        /// Whatever the policy, job size and moments of reordering: every pixel of every object is
        /// traced exactly once, and the jobs of an object go from coarse to fine.
        #[test]
        fn jobs_visit_every_pixel_once(w in 1usize..90, h in 1usize..70, n_job in 1u32..200, seed in 0u64..1000) {
            let ids = ids(w, h);
            let statistics = object_statistics(&ids, None, 4);
            let lattice = Lattice::new(5, [w as i32 / 2, h as i32 / 2]);
            let mut jobs = SampleJobs::new(lattice, n_job);
            let random = |round: u64| move |o: u32, l: u32| crate::rng::unit_f32(crate::rng::hash(seed, round << 32 | u64::from(o), u64::from(l)));
            jobs.start_view(&statistics, random(0));
            let mut traced = Map2d::new(w, h, 0u32);
            let mut last = [0; 4];
            let mut round = 0;
            while let Some((job, _)) = jobs.next(&ids, random(round)) {
                round += 1;
                if round % 7 == 0 { let random = random(round); jobs.reprioritise(None, |o, l, _| random(o, l)); }
                prop_assert!(job.count > 0 && job.count <= n_job);
                prop_assert!(job.level >= last[job.object as usize]);
                last[job.object as usize] = job.level;
                let mut found = 0;
                for (x, y) in job_pixels(&lattice, &job, &ids) {
                    prop_assert_eq!(lattice.level(x, y), job.level);
                    *traced.at_mut(x as usize, y as usize) += 1;
                    found += 1;
                }
                prop_assert_eq!(found, job.count);
            }
            prop_assert!(jobs.is_exhausted());
            for (t, id) in traced.data().iter().zip(ids.data()) {
                prop_assert_eq!(*t, u32::from(*id > 0));
            }
        }
    }

    #[test]
    fn the_highest_priority_goes_first() {
        let ids = ids(80, 60);
        let mut jobs = SampleJobs::new(Lattice::new(3, [0, 0]), 16);
        let priority = |o: u32, l: u32| if o == 2 { 1.0 } else { 0.5 * 0.25f32.powi(l as i32 - 1) };
        jobs.start_view(&object_statistics(&ids, None, 4), priority);
        let mut first = Vec::new();
        while let Some((job, _)) = jobs.next(&ids, priority) {
            first.push(job.object);
        }
        let other = first.iter().position(|&o| o != 2).expect("others come later");
        assert!(first[..other].iter().all(|&o| o == 2) && first[other..].iter().all(|&o| o != 2));
    }
}
