//! Top-down importance and the priority of objects (Haber 2001 §3; REFERENCE §2).
//!
//! In: the object id of every pixel and the saliency map. Out: per object its pixel count, bounds and
//! mean saliency ([`ObjectScan`]), and one priority in [0, 1] ([`priorities`]). Object 0 is
//! everything diffuse: it has statistics and priority 0.

use glam::Vec2;

use super::saliency::CELL;
use crate::image::Map2d;

/// What the id buffer says of one object.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ObjectStatistics {
    /// Pixels that show it; 0 where it is not visible, and then all else is 0 too.
    pub pixels: u32,
    /// Smallest column.
    pub x0: u32,
    /// Smallest row.
    pub y0: u32,
    /// Largest column + 1.
    pub x1: u32,
    /// Largest row + 1.
    pub y1: u32,
    /// Mean of the interpolated saliency map over its pixels (mean, not sum: coverage is part of importance).
    pub saliency: f32,
}

impl ObjectStatistics {
    /// Share of its bounds that it fills, in [0, 1].
    pub fn fill(&self) -> f32 {
        let area = f64::from(self.x1 - self.x0) * f64::from(self.y1 - self.y0);
        if area > 0.0 { (f64::from(self.pixels) / area) as f32 } else { 0.0 }
    }
}

#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    pixels: u32,
    x0: u32,
    y0: u32,
    x1: u32,
    y1: u32,
    saliency: f64,
}

/// Gathers [`ObjectStatistics`] in one pass over the id buffer; keeps its working memory.
///
/// Works on runs of equal ids. The saliency map is linear between its cells along a row, so its sum over a run
/// has a closed form: the result is that of interpolating at every pixel, at the cost of one step per run
/// and cell.
#[derive(Clone, Debug, Default)]
pub struct ObjectScan {
    sums: Vec<Sums>,
    /// The saliency map interpolated to the current row of pixels, one value per cell.
    row: Vec<f64>,
    /// Sum of the interpolated row over all pixels left of each cell.
    prefix: Vec<f64>,
}

impl ObjectScan {
    /// Statistics of the objects 0..`count`, in order of their ids, into `statistics`.
    ///
    /// `ids`: object id per pixel; ids ≥ `count` are passed over. `saliency`: the level-4 map of a picture of the
    /// same size, or none (then all saliencies are 0).
    pub fn gather(
        &mut self,
        ids: &Map2d<u32>,
        saliency: Option<&Map2d<f32>>,
        count: usize,
        statistics: &mut Vec<ObjectStatistics>,
    ) {
        self.sums.clear();
        self.sums.resize(count, Sums::default());
        let saliency = saliency.filter(|map| map.width() > 0 && map.height() > 0);
        for y in 0..ids.height() {
            if let Some(map) = saliency {
                self.prepare_row(map, y);
            }
            let mut row = ids.row(y);
            let mut x0 = 0;
            while let Some(&id) = row.first() {
                let length = row.iter().position(|&other| other != id).unwrap_or(row.len());
                row = &row[length..];
                let x1 = x0 + length;
                let salient = if saliency.is_some() { self.prefix_at(x1) - self.prefix_at(x0) } else { 0.0 };
                if let Some(sums) = self.sums.get_mut(id as usize) {
                    sums.add_run(x0 as u32, x1 as u32, y as u32, salient);
                }
                x0 = x1;
            }
        }
        statistics.clear();
        statistics.extend(self.sums.iter().map(Sums::finish));
    }

    fn prepare_row(&mut self, map: &Map2d<f32>, y: usize) {
        let y0 = (y / CELL).min(map.height() - 1);
        let y1 = (y0 + 1).min(map.height() - 1);
        let f = (y % CELL) as f64 / CELL as f64;
        let lerp = |(&a, &b): (&f32, &f32)| f64::from(a) + (f64::from(b) - f64::from(a)) * f;
        self.row.clear();
        self.row.extend(map.row(y0).iter().zip(map.row(y1)).map(lerp));
        self.prefix.clear();
        let mut sum = 0.0;
        for (j, a) in self.row.iter().enumerate() {
            self.prefix.push(sum);
            let b = self.row.get(j + 1).unwrap_or(a);
            sum += partial(*a, *b, CELL);
        }
    }

    /// Sum of the interpolated row over the pixels 0..`x`.
    fn prefix_at(&self, x: usize) -> f64 {
        let j = (x / CELL).min(self.row.len() - 1);
        let b = self.row.get(j + 1).unwrap_or(&self.row[j]);
        self.prefix[j] + partial(self.row[j], *b, x - j * CELL)
    }
}

/// Sum of the first `n` of the `CELL` values that lead from `a` towards `b`.
#[inline]
fn partial(a: f64, b: f64, n: usize) -> f64 {
    let n = n as f64;
    n * a + (b - a) * (n * (n - 1.0) / (2.0 * CELL as f64))
}

impl Sums {
    #[inline]
    fn add_run(&mut self, x0: u32, x1: u32, y: u32, saliency: f64) {
        let n = x1 - x0;
        if self.pixels == 0 {
            (self.x0, self.y0, self.x1) = (x0, y, x1);
        }
        self.x0 = self.x0.min(x0);
        self.x1 = self.x1.max(x1);
        self.y1 = y + 1;
        self.pixels += n;
        self.saliency += saliency;
    }

    fn finish(&self) -> ObjectStatistics {
        if self.pixels == 0 {
            return ObjectStatistics::default();
        }
        let n = f64::from(self.pixels);
        ObjectStatistics {
            pixels: self.pixels,
            x0: self.x0,
            y0: self.y0,
            x1: self.x1,
            y1: self.y1,
            saliency: (self.saliency / n).max(0.0) as f32,
        }
    }
}

/// One call of [`ObjectScan::gather`] with memory of its own.
#[cfg(test)]
pub(crate) fn object_statistics(
    ids: &Map2d<u32>,
    saliency: Option<&Map2d<f32>>,
    count: usize,
) -> Vec<ObjectStatistics> {
    let mut statistics = Vec::new();
    ObjectScan::default().gather(ids, saliency, count, &mut statistics);
    statistics
}

/// Weight of closeness to the centre against coverage; the paper does not say.
const CENTRE: f32 = 0.5;

/// Weight w_s of saliency against importance: "roughly balanced" worked best (Haber 2001 §3).
pub const SALIENCY_WEIGHT: f32 = 0.5;

/// Top-down importance of an object in a picture of `width × height` pixels, in [0, 1]; 0 if it is not visible.
///
/// (1 − d)/2 + √a/2. d: distance of the centre of its bounds to that of the picture, over half the diagonal. a: share of
/// the pixels.
pub fn importance(object: &ObjectStatistics, width: usize, height: usize) -> f32 {
    if object.pixels == 0 || width == 0 || height == 0 {
        return 0.0;
    }
    let size = Vec2::new(width as f32, height as f32);
    let at = Vec2::new((object.x0 + object.x1) as f32 * 0.5, (object.y0 + object.y1) as f32 * 0.5);
    let closeness = 1.0 - (at - size * 0.5).length() / (0.5 * size.length());
    let coverage = object.pixels as f32 / (size.x * size.y);
    (CENTRE * closeness + (1.0 - CENTRE) * coverage.sqrt()).clamp(0.0, 1.0)
}

/// Priorities of all objects: w_s S/max S + (1 − w_s) imp/max imp, in [0, 1] (REFERENCE §2). Object 0 and invisible
/// objects have 0; where nothing is salient, or the picture is too small for the model
/// ([`super::saliency::MIN_SIDE`]), importance alone counts.
pub fn priorities(
    objects: &[ObjectStatistics],
    width: usize,
    height: usize,
    saliency_weight: f32,
    out: &mut Vec<f32>,
) {
    out.clear();
    out.extend(objects.iter().map(|object| importance(object, width, height)));
    if let Some(diffuse) = out.first_mut() {
        *diffuse = 0.0;
    }
    let most_important = out.iter().copied().fold(0.0, f32::max);
    if most_important <= 0.0 {
        return;
    }
    let most_salient = objects.iter().skip(1).map(|object| object.saliency).fold(0.0, f32::max);
    let too_small = width.min(height) < super::saliency::MIN_SIDE;
    let share = if most_salient > 0.0 && !too_small { saliency_weight.clamp(0.0, 1.0) } else { 0.0 };
    for (priority, object) in out.iter_mut().zip(objects).skip(1) {
        let salient = if share > 0.0 { share * object.saliency / most_salient } else { 0.0 };
        *priority = salient + (1.0 - share) * *priority / most_important;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::pyramid;

    fn rectangle(x0: usize, y0: usize, x1: usize, y1: usize) -> Map2d<u32> {
        Map2d::from_fn(512, 512, |x, y| u32::from((x0..x1).contains(&x) && (y0..y1).contains(&y)))
    }

    fn importance_of(ids: &Map2d<u32>) -> f32 {
        importance(&object_statistics(ids, None, 2)[1], 512, 512)
    }

    #[test]
    fn numbers_of_the_reference() {
        for (ids, expected) in [
            (rectangle(206, 206, 306, 306), 0.597_656),
            (rectangle(0, 0, 100, 100), 0.195_312),
            (rectangle(0, 0, 512, 512), 1.0),
            (rectangle(0, 0, 1, 1), 0.001_953),
        ] {
            assert!((importance_of(&ids) - expected).abs() < 2e-6);
        }
    }

    #[test]
    fn statistics_equal_those_of_every_pixel() {
        for (w, h) in [(512, 512), (100, 37), (16, 16), (5, 3), (33, 70)] {
            let ids = Map2d::from_fn(w, h, |x, y| {
                let h = crate::rng::hash((x / 3) as u64, (y / 5) as u64, 9);
                if h % 7 == 6 { u32::MAX } else { (h % 7) as u32 }
            });
            let (sw, sh) = (pyramid::level_side(w, 4), pyramid::level_side(h, 4));
            let map =
                Map2d::from_fn(sw, sh, |x, y| crate::rng::unit_f32(crate::rng::hash(x as u64, y as u64, 1)));
            let fine = pyramid::upsample(&map, w, h, CELL);
            let all = object_statistics(&ids, Some(&map), 9);
            assert_eq!(all.len(), 9);
            for (id, found) in all.iter().enumerate() {
                let pixels: Vec<_> =
                    (0..w * h).map(|i| (i % w, i / w)).filter(|&(x, y)| ids.at(x, y) == id as u32).collect();
                assert_eq!(found.pixels as usize, pixels.len());
                if pixels.is_empty() {
                    assert_eq!(*found, ObjectStatistics::default());
                    continue;
                }
                let n = pixels.len() as f64;
                let mean =
                    |f: &dyn Fn(usize, usize) -> f64| pixels.iter().map(|&(x, y)| f(x, y)).sum::<f64>() / n;
                assert!((f64::from(found.saliency) - mean(&|x, y| f64::from(fine.at(x, y)))).abs() < 1e-6);
                assert_eq!(found.x0 as usize, pixels.iter().map(|p| p.0).min().unwrap());
                assert_eq!(found.x1 as usize, pixels.iter().map(|p| p.0).max().unwrap() + 1);
                assert_eq!(found.y0 as usize, pixels.iter().map(|p| p.1).min().unwrap());
                assert_eq!(found.y1 as usize, pixels.iter().map(|p| p.1).max().unwrap() + 1);
            }
        }
    }

    fn object(pixels: u32, x0: u32, saliency: f32) -> ObjectStatistics {
        let (y0, x1, y1) = (40, x0 + 10, 50);
        ObjectStatistics { pixels, x0, y0, x1, y1, saliency }
    }

    #[test]
    fn the_slider_goes_from_importance_to_saliency() {
        let objects =
            [object(5000, 0, 0.9), object(100, 45, 0.1), object(60, 0, 0.4), ObjectStatistics::default()];
        let mut out = Vec::new();
        let mut run = |saliency, size| {
            priorities(&objects, size, size, saliency, &mut out);
            out.clone()
        };
        assert_eq!(run(1.0, 100), [0.0, 0.25, 1.0, 0.0]);
        let important = run(0.0, 100);
        assert_eq!((important[0], important[1], important[3]), (0.0, 1.0, 0.0));
        assert!(important[2] > 0.0 && important[2] < 1.0);
        // Too small for the model: the slider has no effect.
        assert_eq!(run(1.0, 60), run(0.0, 60));
    }

    #[test]
    fn nothing_salient_and_nothing_visible() {
        let mut out = Vec::new();
        priorities(&[object(10, 0, 0.0), object(10, 45, 0.0)], 100, 100, SALIENCY_WEIGHT, &mut out);
        assert_eq!(out, [0.0, 1.0]);
        priorities(&[ObjectStatistics::default(); 3], 100, 100, SALIENCY_WEIGHT, &mut out);
        assert_eq!(out, [0.0; 3]);
        priorities(&[], 0, 0, SALIENCY_WEIGHT, &mut out);
        assert!(out.is_empty());
    }

    #[test]
    #[expect(clippy::disallowed_methods, reason = "prints how long it takes, asserts nothing about it")]
    fn timing() {
        let ids = Map2d::from_fn(512, 512, |x, y| ((x / 20 + y / 13 * 7) % 40) as u32);
        let map = Map2d::from_fn(32, 32, |x, y| (x * y) as f32);
        let (mut scan, mut statistics) = (ObjectScan::default(), Vec::new());
        let start = std::time::Instant::now();
        for _ in 0..20 {
            scan.gather(&ids, Some(&map), 40, &mut statistics);
        }
        println!(
            "statistics of 40 objects in 512 × 512: {:.3} ms",
            start.elapsed().as_secs_f64() * 1e3 / 20.0
        );
        assert_eq!(statistics.iter().map(|s| s.pixels).sum::<u32>(), 512 * 512);
    }
}
