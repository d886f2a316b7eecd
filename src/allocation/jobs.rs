//! The order of sample jobs: which object, level and stretch of the lattice is traced next
//! (Haber 2001 §4.1, §4.4).
//!
//! Each visible object goes through its levels from coarse to fine. Taking a job cuts `n_job`
//! samples from the level at its cursor (the paper's iterator position); the rest of the level stays
//! with the object. A finished level goes back one level finer, at the priority the policy gives that.
//! From some level on an object may go on in parts, tiles of the picture, each with a priority of its own (the papers know
//! whole objects alone).
//!
//! Objects that are looked at through guides ([`crate::transport::tracer::guide`]) have jobs of another kind beside: the
//! guides of all of their pixels, which belong to no level and may come between the fine ones.

use crate::image::Map2d;
use crate::perception::importance::ObjectStatistics;
use crate::sampling::{Cursor, Lattice, Rect};

/// An order for one tracer: `count` samples of one level of one object, from `start` on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct SampleJob {
    /// Object id.
    pub object: u32,
    /// Level, 1 … l_max; [`GUIDES`] for guides.
    pub level: u32,
    /// Whether samples bring what their guides show.
    pub guided: bool,
    /// The object's bounds in the picture, or those of a part of it.
    pub rect: Rect,
    /// Where in the level to begin.
    pub start: Cursor,
    /// Samples to trace: pixels of the level, from `start`, that show the object; of guides, of all pixels.
    pub count: u32,
}

/// The level of jobs of guides, which belong to none.
pub const GUIDES: u32 = 0;
/// Guides may be followed before samples of this level set and finer ones: where an object goes on in parts.
const GUIDED_K: u32 = 2;
/// Guides of one job: as long as a job of samples lasts, about.
const GUIDES_PER_JOB: u32 = 1024;

/// An object or a part of one, and how far it has come.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Part {
    /// Its number: a whole object's is the object's id, parts follow behind the last object.
    pub id: u32,
    /// Object id.
    pub object: u32,
    /// Bounds in the picture.
    pub rect: Rect,
    /// Pixels of the object in there.
    pub pixels: u32,
    /// Level of its next job, 1 … l_max.
    pub level: u32,
    /// Samples of that level that are handed out.
    pub handed: u32,
    /// The level it began with: 1, or where what it is a part of was split.
    pub first_level: u32,
    /// Whether it goes on in parts, from `level` on.
    pub is_split: bool,
    /// Priority of its next job.
    pub priority: f32,
    /// Where in the level the next job begins; `None` once every level is handed out.
    cursor: Option<Cursor>,
    /// Where the next job of guides begins; `None` without guides, and once all are handed out.
    guides: Option<Cursor>,
}

impl Part {
    /// Whether it is `other` or a part of that.
    pub fn is_of(&self, other: &Self) -> bool {
        let lies_within = self.rect.intersection(other.rect) == self.rect;
        self.id == other.id || (self.object == other.object && lies_within && other.is_split)
    }

    /// Whether some of its guides are handed out, and others are not.
    pub fn is_being_guided(&self) -> bool {
        self.guides.is_some_and(|next| next != beginning(self.rect))
    }

    /// Whether every sample of it is handed out, or it goes on in parts.
    pub fn is_done(&self) -> bool {
        self.cursor.is_none()
    }
}

/// The objects of one view and what is left to trace of them.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
pub struct SampleJobs {
    lattice: Lattice,
    samples_per_job: u32,
    parts: Vec<Part>,
    /// Number of the next part.
    next_id: u32,
    /// By object id, which are looked at through guides.
    guided: Vec<bool>,
}

impl SampleJobs {
    /// No object yet. `samples_per_job` is the paper's n_job, at least 1.
    pub fn new(lattice: Lattice, samples_per_job: u32) -> Self {
        Self {
            lattice,
            samples_per_job: samples_per_job.max(1),
            parts: Vec::new(),
            next_id: 0,
            guided: Vec::new(),
        }
    }

    /// Which objects are looked at through guides from the next view on, by id.
    pub fn set_guided(&mut self, guided: Vec<bool>) {
        self.guided = guided;
    }

    /// Jobs of so many samples from now on.
    pub fn set_samples_per_job(&mut self, samples: u32) {
        self.samples_per_job = samples.max(1);
    }

    /// Samples of a job, n_job.
    pub fn samples_per_job(&self) -> u32 {
        self.samples_per_job
    }

    /// The lattice.
    pub fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// Starts a view: `statistics[id]` of every object; id 0 (diffuse) and invisible ones are left out.
    /// `priority` is asked whenever an object enters a level.
    pub fn start_view(&mut self, statistics: &[ObjectStatistics], priority: impl Fn(&Part) -> f32) {
        self.parts.clear();
        self.next_id = statistics.len() as u32;
        for (id, s) in statistics.iter().enumerate().skip(1).filter(|(_, s)| s.pixels > 0) {
            let rect = Rect { x0: s.x0 as i32, y0: s.y0 as i32, x1: s.x1 as i32, y1: s.y1 as i32 };
            let mut whole = part(id as u32, id as u32, rect, s.pixels, 1);
            whole.guides = self.guided.get(id).is_some_and(|guided| *guided).then(|| beginning(rect));
            whole.priority = priority(&whole);
            self.parts.push(whole);
        }
    }

    /// Forgets the view.
    pub fn clear(&mut self) {
        self.parts.clear();
    }

    /// Asks for the priorities of some parts anew.
    pub fn reprioritise(&mut self, which: impl Fn(&Part) -> bool, priority: impl Fn(&Part) -> f32) {
        for part in self.parts.iter_mut().filter(|part| !part.is_done() && which(part)) {
            part.priority = priority(part);
        }
    }

    /// Whether every sample of the view is handed out.
    pub fn is_exhausted(&self) -> bool {
        self.parts.iter().all(Part::is_done)
    }

    /// Objects and their parts.
    pub fn parts(&self) -> &[Part] {
        &self.parts
    }

    /// The part that a sample of `level` of an object at a pixel belongs to.
    pub fn part_at(&self, object: u32, level: u32, pixel: [u16; 2]) -> Option<u32> {
        let (x, y) = (i32::from(pixel[0]), i32::from(pixel[1]));
        let holds = |p: &&Part| {
            let has_level = p.first_level <= level && (level < p.level || !p.is_split);
            p.object == object && has_level && p.rect.contains(x, y)
        };
        self.parts.iter().find(holds).map(|part| part.id)
    }

    /// Which object or part is next: that of highest priority (the first among equals).
    pub fn best(&self) -> Option<usize> {
        let mut best: Option<usize> = None;
        for (i, part) in self.parts.iter().enumerate().filter(|(_, p)| !p.is_done()) {
            if best.is_none_or(|b| part.priority.total_cmp(&self.parts[b].priority).is_gt()) {
                best = Some(i);
            }
        }
        best
    }

    /// Has an object or part that is about to begin a level go on in tiles of `side` pixels from there on. Returns their
    /// numbers; they are at no priority yet.
    pub fn split(&mut self, index: usize, side: i32, ids: &Map2d<u32>) -> std::ops::Range<u32> {
        let whole = self.parts[index];
        self.parts[index].cursor = None;
        self.parts[index].is_split = true;
        let first = self.next_id;
        let Rect { x0, y0, x1, y1 } = whole.rect;
        let tiles = (y0.div_euclid(side)..=(y1 - 1).div_euclid(side)).flat_map(|y| {
            (x0.div_euclid(side)..=(x1 - 1).div_euclid(side)).map(move |x| (x * side, y * side))
        });
        for (x, y) in tiles {
            let rect = whole.rect.intersection(Rect { x0: x, y0: y, x1: x + side, y1: y + side });
            let of_row = |y: i32| {
                let row = y as usize * ids.width();
                let row = &ids.data()[row + rect.x0 as usize..row + rect.x1 as usize];
                row.iter().filter(|id| **id == whole.object).count() as u32
            };
            let pixels: u32 = (rect.y0..rect.y1).map(of_row).sum();
            if pixels > 0 {
                let mut part = part(self.next_id, whole.object, rect, pixels, whole.level);
                part.guides = whole.guides.map(|_| beginning(rect));
                self.parts.push(part);
                self.next_id += 1;
            }
        }
        first..self.next_id
    }

    /// The next job and its priority. Levels of which there is no pixel cost nothing.
    pub fn next(&mut self, ids: &Map2d<u32>, priority: impl Fn(&Part) -> f32) -> Option<(SampleJob, f32)> {
        loop {
            let best = self.best()?;
            if let Some(job) = self.cut(best, self.samples_per_job, ids, &priority) {
                return Some(job);
            }
        }
    }

    /// Whether a level comes before those between which guides may be followed.
    pub fn is_coarse(lattice: &Lattice, level: u32) -> bool {
        lattice.k_of(level) > GUIDED_K
    }

    /// Whether the next job of a part may be one of guides: some are left, and it is about to begin a fine level.
    pub fn may_guide(lattice: &Lattice, part: &Part) -> bool {
        part.guides.is_some() && part.handed == 0 && lattice.k_of(part.level) <= GUIDED_K
    }

    /// The next job of guides of one part; none where no pixel is left.
    pub fn cut_guides(
        &mut self,
        index: usize,
        ids: &Map2d<u32>,
        priority: impl Fn(&Part) -> f32,
    ) -> Option<(SampleJob, f32)> {
        let o = &mut self.parts[index];
        let start = o.guides?;
        let (count, end) = guides_from(o.object, o.rect, start, ids);
        let job = SampleJob { object: o.object, level: GUIDES, guided: true, rect: o.rect, start, count };
        let job_priority = o.priority;
        o.guides = end;
        o.priority = priority(o);
        (count > 0).then_some((job, job_priority))
    }

    /// The next job of one part, of at most so many samples; none where its level has no pixel left, and it is at the next
    /// one then.
    pub fn cut(
        &mut self,
        index: usize,
        at_most: u32,
        ids: &Map2d<u32>,
        priority: impl Fn(&Part) -> f32,
    ) -> Option<(SampleJob, f32)> {
        let guided = self.guided.get(self.parts[index].object as usize).is_some_and(|guided| *guided);
        let o = &mut self.parts[index];
        let start = o.cursor?;
        let mut samples = self.lattice.samples(o.level, o.rect, start);
        let mut count = 0;
        while count < at_most {
            let Some((x, y)) = samples.next() else { break };
            count += u32::from(ids.at(x as usize, y as usize) == o.object);
        }
        let job = SampleJob { object: o.object, level: o.level, guided, rect: o.rect, start, count };
        let job_priority = o.priority;
        o.cursor = samples.cursor();
        o.handed += count;
        if o.cursor.is_none() && o.level < self.lattice.levels() {
            o.level += 1;
            o.handed = 0;
            o.cursor = Some(Cursor { x: o.rect.x0, y: o.rect.y0 });
            o.priority = priority(o);
        }
        (count > 0).then_some((job, job_priority))
    }
}

fn part(id: u32, object: u32, rect: Rect, pixels: u32, level: u32) -> Part {
    Part {
        id,
        object,
        rect,
        pixels,
        level,
        handed: 0,
        first_level: level,
        is_split: false,
        priority: 0.0,
        cursor: Some(beginning(rect)),
        guides: None,
    }
}

fn beginning(rect: Rect) -> Cursor {
    Cursor { x: rect.x0, y: rect.y0 }
}

/// Pixels of an object in a rectangle from a place on, in rows.
fn object_pixels<'a>(
    object: u32,
    rect: Rect,
    start: Cursor,
    ids: &'a Map2d<u32>,
) -> impl Iterator<Item = (i32, i32)> + use<'a> {
    let row = move |y: i32| {
        let x0 = if y == start.y { start.x } else { rect.x0 };
        (x0..rect.x1).map(move |x| (x, y))
    };
    (start.y..rect.y1).flat_map(row).filter(move |&(x, y)| ids.at(x as usize, y as usize) == object)
}

/// How many guides a job from `start` on has, and where the next one begins.
fn guides_from(object: u32, rect: Rect, start: Cursor, ids: &Map2d<u32>) -> (u32, Option<Cursor>) {
    let mut pixels = object_pixels(object, rect, start, ids);
    let count = pixels.by_ref().take(GUIDES_PER_JOB as usize).count() as u32;
    (count, pixels.next().map(|(x, y)| Cursor { x, y }))
}

/// The pixels of a job of guides.
pub fn guide_pixels<'a>(job: &SampleJob, ids: &'a Map2d<u32>) -> impl Iterator<Item = (i32, i32)> + use<'a> {
    object_pixels(job.object, job.rect, job.start, ids).take(job.count as usize)
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

/// The pixels of a job, of samples or of guides, where objects are told pixel by pixel as they are asked for.
pub fn pixels_as_told(
    lattice: &Lattice,
    job: &SampleJob,
    mut object_at: impl FnMut(i32, i32) -> u32,
) -> Vec<(i32, i32)> {
    let SampleJob { object, level, rect, start, count, .. } = *job;
    let mut pixels = Vec::with_capacity(count.min(1 << 16) as usize);
    if count == 0 {
        return pixels;
    }
    let mut take = |(x, y): (i32, i32)| {
        if object_at(x, y) == object {
            pixels.push((x, y));
        }
        pixels.len() < count as usize
    };
    if level == GUIDES {
        let row = move |y: i32| (if y == start.y { start.x } else { rect.x0 }..rect.x1).map(move |x| (x, y));
        (start.y..rect.y1).flat_map(row).all(&mut take);
    } else {
        lattice.samples(level, rect, start).all(&mut take);
    }
    pixels
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math;
    use crate::perception::importance::object_statistics;
    use proptest::prelude::*;

    /// Two discs and a line one pixel wide on a diffuse ground.
    fn ids(w: usize, h: usize) -> Map2d<u32> {
        let disc =
            |x: usize, y: usize, cx: f32, cy: f32, r: f32| math::hypot(x as f32 - cx, y as f32 - cy) < r;
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
            let random = |round: u64| move |p: &Part| crate::rng::unit_f32(crate::rng::hash(seed, round << 32 | u64::from(p.id), u64::from(p.level)));
            jobs.start_view(&statistics, random(0));
            let mut traced = Map2d::new(w, h, 0u32);
            let mut last = [0; 4];
            let mut round = 0;
            // Some objects go on in parts, and those in smaller ones.
            let side_at = |level: u32| match level { 4 => Some(32), 5 => Some(16), _ => None };
            while let Some(best) = jobs.best() {
                let whole = jobs.parts()[best];
                if let Some(side) = side_at(whole.level)
                    && whole.object != 3 && whole.handed == 0 && whole.first_level < whole.level
                {
                    let tiles = jobs.split(best, side, &ids);
                    prop_assert!(!tiles.is_empty());
                    jobs.reprioritise(|part| tiles.contains(&part.id), random(round));
                    continue;
                }
                let Some((job, _)) = jobs.cut(best, n_job, &ids, random(round)) else { continue };
                round += 1;
                if round % 7 == 0 { jobs.reprioritise(|_| true, random(round)); }
                prop_assert!(job.count > 0 && job.count <= n_job);
                prop_assert!(job.level >= last[job.object as usize] || job.level > 3);
                last[job.object as usize] = job.level;
                let at = job_pixels(&lattice, &job, &ids).next().map(|(x, y)| [x as u16, y as u16]);
                let part = jobs.part_at(job.object, job.level, at.unwrap());
                prop_assert_eq!(part, Some(whole.id));
                let mut found = 0;
                let told = pixels_as_told(&lattice, &job, |x, y| ids.at(x as usize, y as usize));
                prop_assert!(job_pixels(&lattice, &job, &ids).eq(told));
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

    /// Guides are handed out once for all pixels of the objects that have some, whatever is split.
    #[test]
    fn guides_come_once() {
        let ids = ids(240, 180);
        let lattice = Lattice::new(5, [120, 90]);
        let mut jobs = SampleJobs::new(lattice, 64);
        jobs.set_guided(vec![false, true, false, true]);
        jobs.start_view(&object_statistics(&ids, None, 4), |_| 1.0);
        let mut guides = Map2d::new(240, 180, 0u32);
        while let Some(best) = jobs.best() {
            let whole = jobs.parts()[best];
            if whole.object == 1 && lattice.k_of(whole.level) == 2 && whole.id == 1 {
                jobs.split(best, 64, &ids);
                continue;
            }
            let next = match SampleJobs::may_guide(&lattice, &whole) {
                true => jobs.cut_guides(best, &ids, |_| 1.0),
                false => jobs.cut(best, 64, &ids, |_| 1.0),
            };
            let Some((job, _)) = next else { continue };
            assert_eq!(job.guided, job.object != 2);
            if job.level == GUIDES {
                assert!(guide_pixels(&job, &ids).count() as u32 == job.count && job.count <= GUIDES_PER_JOB);
                guide_pixels(&job, &ids).for_each(|(x, y)| *guides.at_mut(x as usize, y as usize) += 1);
                continue;
            }
            for (x, y) in job_pixels(&lattice, &job, &ids) {
                let has_guide = guides.at(x as usize, y as usize) == 1;
                assert_eq!(has_guide, job.guided && lattice.k_of(job.level) <= GUIDED_K, "{job:?}");
            }
        }
        for (guides, id) in guides.data().iter().zip(ids.data()) {
            assert_eq!(*guides, u32::from(*id == 1 || *id == 3));
        }
    }

    #[test]
    fn the_highest_priority_goes_first() {
        let ids = ids(80, 60);
        let mut jobs = SampleJobs::new(Lattice::new(3, [0, 0]), 16);
        let priority = |p: &Part| if p.object == 2 { 1.0 } else { 0.5 * 0.25f32.powi(p.level as i32 - 1) };
        jobs.start_view(&object_statistics(&ids, None, 4), priority);
        let mut first = Vec::new();
        while let Some((job, _)) = jobs.next(&ids, priority) {
            first.push(job.object);
        }
        let other = first.iter().position(|&o| o != 2).expect("others come later");
        assert!(first[..other].iter().all(|&o| o == 2) && first[other..].iter().all(|&o| o != 2));
    }
}
