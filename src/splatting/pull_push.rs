//! What is shown between samples that lie anyhow: pull-push (Gortler et al. 1996, The Lumigraph, §3.6), on one surface at a
//! time.
//!
//! Cells of 2 × 2 pixels, 4 × 4 and so on hold the mean of the samples in them and how many there are (pull). From the
//! coarsest down each is then mixed with what lies around it one level up: what has [`ENOUGH`] samples shows their mean, what
//! has fewer, or none, so much of the coarser ones instead, bilinearly between the four nearest (push). So a single sample
//! fades into those around it, where a footprint of its own would have an edge.
//!
//! A cell is of one surface: one object at depths that a plane through it could have. Of several it is the one that most of
//! it shows, diffuse ones, which have no samples, aside; the others' are left to finer cells.

use glam::{Vec3, Vec4};
use rayon::prelude::*;

use crate::image::Map2d;

/// Samples that a cell needs to show nothing but their mean. One alone is a third its surroundings', so that it stands out
/// less and has less noise; with 1, 2 and 4 walks of table and chess were further from what their views converge to (one run
/// each).
pub const ENOUGH: f32 = 1.5;
/// Levels: the last one's cells have a side of 32 pixels, more than the spacing of any level set that is shown for long.
pub const LEVELS: usize = 5;
/// Cells of a level below which one thread takes all.
const SHARED_FROM: usize = 4096;

/// An object and a depth.
type Key = (u32, f32);

/// How depths of one surface may differ.
#[derive(Clone, Copy, Debug)]
pub struct Alike {
    /// Share of the depth per pixel.
    pub slope: f32,
    /// Least and greatest share.
    pub shares: [f32; 2],
}

impl Alike {
    /// Whether both can lie on one surface, so many pixels apart.
    #[inline]
    pub fn holds(&self, a: Key, b: Key, pixels: f32) -> bool {
        let tolerance = a.1 * (self.slope * pixels).clamp(self.shares[0], self.shares[1]);
        // Also refuses NaN.
        a.0 == b.0 && (a.1 - b.1).abs() <= tolerance
    }
}

/// The cells of one level.
#[derive(Clone, Debug)]
struct Level {
    width: usize,
    height: usize,
    keys: Vec<Key>,
    /// Pulled: the sum of the samples and their number. Pushed: what is shown, and 1 where it is known.
    cells: Vec<Vec4>,
}

/// What is shown between the samples of a view.
#[derive(Clone, Debug)]
pub struct PullPush {
    /// From the finest to the coarsest.
    levels: Vec<Level>,
    alike: Alike,
}

impl PullPush {
    /// Of a view's objects and depths; `sample` is what a pixel's own sample shows, if it has one.
    pub fn new(
        objects: &Map2d<u32>,
        depths: &Map2d<f32>,
        alike: Alike,
        sample: impl Fn(usize) -> Option<Vec3> + Sync,
    ) -> Self {
        let (width, height) = (objects.width(), objects.height());
        let (ids, depth) = (objects.data(), depths.data());
        let mut levels: Vec<Level> = Vec::with_capacity(LEVELS);
        levels.push(halved([width, height], 1, &alike, |i| {
            let value = sample(i).map_or(Vec4::ZERO, |color| color.extend(1.0));
            ((ids[i], depth[i]), value)
        }));
        for n in 1..LEVELS {
            let finer = &levels[n - 1];
            // What has enough counts no more, however much that is: else a crowd would outweigh its surroundings.
            let coarser = halved([finer.width, finer.height], 1 << n, &alike, |i| {
                let cell = finer.cells[i];
                (finer.keys[i], cell * (ENOUGH / cell.w.max(ENOUGH)))
            });
            levels.push(coarser);
        }
        let mut made = Self { levels, alike };
        for n in (0..LEVELS).rev() {
            let pushed = made.pushed(n);
            made.levels[n].cells = pushed;
        }
        made
    }

    /// What the cells of a level show, once those of the next coarser do.
    fn pushed(&self, n: usize) -> Vec<Vec4> {
        let level = &self.levels[n];
        let mut out = vec![Vec4::ZERO; level.cells.len()];
        let row = |(y, out): (usize, &mut [Vec4])| {
            for (x, out) in out.iter_mut().enumerate() {
                let i = y * level.width + x;
                let coarse = match n + 1 < LEVELS {
                    true => self.around(n + 1, [x, y], level.keys[i]),
                    false => None,
                };
                *out = mixed(level.cells[i], coarse).map_or(Vec4::ZERO, |shown| shown.extend(1.0));
            }
        };
        let rows = level.width.max(1);
        if level.cells.len() < SHARED_FROM {
            out.chunks_mut(rows).enumerate().for_each(row);
        } else {
            out.par_chunks_mut(rows).enumerate().for_each(row);
        }
        out
    }

    /// What level `n` shows at the middle of a cell of the next finer level, or of a pixel, on its surface.
    #[inline(always)] // a call for each pixel otherwise
    fn around(&self, n: usize, [x, y]: [usize; 2], key: Key) -> Option<Vec3> {
        let level = &self.levels[n];
        // The cell's parent and those on the side that it lies to.
        let next = |v: usize, count: usize| {
            let parent = v / 2;
            let other = if v.is_multiple_of(2) { parent.checked_sub(1) } else { Some(parent + 1) };
            (parent, other.filter(|v| *v < count))
        };
        let ((px, qx), (py, qy)) = (next(x, level.width), next(y, level.height));
        let pixels = (2usize << n) as f32;
        let mut sum = Vec4::ZERO;
        for (cy, wy) in [(Some(py), 0.75), (qy, 0.25)] {
            for (cx, wx) in [(Some(px), 0.75), (qx, 0.25)] {
                let (Some(cx), Some(cy)) = (cx, cy) else { continue };
                let i = cy * level.width + cx;
                if self.alike.holds(key, level.keys[i], pixels) {
                    sum += level.cells[i] * (wx * wy);
                }
            }
        }
        (sum.w > 0.0).then(|| sum.truncate() / sum.w)
    }

    /// What a pixel of a surface shows whose own sample, if it has one, is this; `None` where no cell around is of its surface
    /// and has samples near.
    #[inline]
    pub fn pixel(&self, [x, y]: [usize; 2], key: (u32, f32), own: Option<Vec3>) -> Option<Vec3> {
        let coarse = self.around(0, [x, y], key)?;
        mixed(own.map_or(Vec4::ZERO, |own| own.extend(1.0)), Some(coarse))
    }
}

/// What a cell of these samples shows amid what is coarser.
#[inline]
fn mixed(samples: Vec4, coarse: Option<Vec3>) -> Option<Vec3> {
    if samples.w <= 0.0 {
        return coarse;
    }
    let mean = samples.truncate() / samples.w;
    Some(coarse.map_or(mean, |coarse| coarse.lerp(mean, (samples.w / ENOUGH).min(1.0))))
}

/// Cells of 2 × 2 of what is there, whose sides are this many pixels.
fn halved(
    [width, height]: [usize; 2],
    side: usize,
    alike: &Alike,
    of: impl Fn(usize) -> (Key, Vec4) + Sync,
) -> Level {
    let (across, down) = (width.div_ceil(2), height.div_ceil(2));
    let (mut keys, mut cells) = (vec![(0, 0.0); across * down], vec![Vec4::ZERO; across * down]);
    let row = |(y, (keys, cells)): (usize, (&mut [Key], &mut [Vec4]))| {
        for (x, (key, cell)) in keys.iter_mut().zip(cells).enumerate() {
            let mut children = [((0, f32::NAN), Vec4::ZERO); 4];
            for (k, child) in children.iter_mut().enumerate() {
                let (cx, cy) = (2 * x + k % 2, 2 * y + k / 2);
                if cx < width && cy < height {
                    *child = of(cy * width + cx);
                }
            }
            (*key, *cell) = joined(&children, alike, side as f32);
        }
    };
    let across = across.max(1);
    if cells.len() < SHARED_FROM {
        keys.chunks_mut(across).zip(cells.chunks_mut(across)).enumerate().for_each(row);
    } else {
        keys.par_chunks_mut(across).zip(cells.par_chunks_mut(across)).enumerate().for_each(row);
    }
    Level { width: width.div_ceil(2), height: down, keys, cells }
}

/// The surface that most of four show, and its samples. Diffuse surfaces have none.
#[inline]
fn joined(children: &[(Key, Vec4); 4], alike: &Alike, side: f32) -> (Key, Vec4) {
    let mut best = (0, children[0].0, Vec4::ZERO);
    for &(key, _) in children.iter().filter(|(key, _)| key.0 != 0) {
        let mut votes = 0;
        let mut sum = Vec4::ZERO;
        for &(other, samples) in children {
            if alike.holds(key, other, side) {
                votes += 1;
                sum += samples;
            }
        }
        if votes > best.0 {
            best = (votes, key, sum);
        }
        if votes == 4 {
            break;
        }
    }
    (best.1, best.2)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: usize = 90;
    const ALIKE: Alike = Alike { slope: 0.01, shares: [0.02, 0.25] };

    fn shown(
        of: impl Fn(usize, usize) -> Key,
        sample: impl Fn(usize, usize) -> Option<Vec3> + Sync,
    ) -> Map2d<Option<Vec3>> {
        let objects = Map2d::from_fn(SIZE, SIZE, |x, y| of(x, y).0);
        let depths = Map2d::from_fn(SIZE, SIZE, |x, y| of(x, y).1);
        let made = PullPush::new(&objects, &depths, ALIKE, |i| sample(i % SIZE, i / SIZE));
        Map2d::from_fn(SIZE, SIZE, |x, y| made.pixel([x, y], of(x, y), sample(x, y)))
    }

    fn is_sampled(x: usize, y: usize) -> bool {
        crate::rng::hash(5, x as u64, y as u64).is_multiple_of(23)
    }

    #[test]
    fn a_constant_is_that_constant_and_a_slope_is_nearly_that_slope() {
        let all = shown(|_, _| (1, 4.0), |x, y| is_sampled(x, y).then_some(Vec3::new(0.25, 7.0, 0.0)));
        for y in 0..SIZE {
            for x in 0..SIZE {
                let found = all.at(x, y).expect("samples everywhere");
                assert!((found - Vec3::new(0.25, 7.0, 0.0)).abs().max_element() < 1e-5, "{found}");
            }
        }
        let slope = shown(|_, _| (1, 4.0), |x, y| is_sampled(x, y).then_some(Vec3::splat(x as f32)));
        let off = |x, y| slope.at(x, y).map_or(f32::NAN, |v: Vec3| v.x - x as f32);
        let inner = || (10..SIZE - 10).flat_map(|y| (10..SIZE - 10).map(move |x| (x, y)));
        let mean = inner().map(|(x, y)| off(x, y).abs()).sum::<f32>() / inner().count() as f32;
        // A sample in 23 pixels: 4.8 apart.
        assert!(mean < 1.3, "{mean}");
        assert!(inner().all(|(x, y)| off(x, y).abs() < 8.0));
    }

    #[test]
    fn no_other_surface_is_read() {
        // Two objects, one of them at two depths.
        let of =
            |x: usize, y: usize| if x + y / 3 > 60 { (2, 4.0) } else { (1, if y > 40 { 4.0 } else { 2.0 }) };
        let tint = |x, y| Vec3::new(of(x, y).0 as f32, of(x, y).1, 0.5);
        let all = shown(of, |x, y| is_sampled(x, y).then(|| tint(x, y)));
        for y in 0..SIZE {
            for x in 0..SIZE {
                let Some(found) = all.at(x, y) else { continue };
                assert!((found - tint(x, y)).abs().max_element() < 1e-5, "{found} at {x}, {y}");
            }
        }
        assert!(all.data().iter().filter(|v| v.is_none()).count() < SIZE * SIZE / 200);
    }

    #[test]
    fn a_sample_fades_and_none_shows_nothing() {
        let one = |x, y| (x == 40 && y == 40).then_some(Vec3::ONE);
        let few =
            shown(|_, _| (1, 4.0), |x, y| one(x, y).or((x % 16 == 8 && y % 16 == 8).then_some(Vec3::ZERO)));
        let at = |x: usize| few.at(x, 40).map_or(f32::NAN, |v| v.x);
        assert!(
            at(40) > 0.5 && at(41) < at(40) && at(44) < at(42) && at(50) < 0.3,
            "{:?}",
            [40, 42, 44, 50].map(at)
        );
        let step = (20..60).map(|x| (at(x + 1) - at(x)).abs()).fold(0.0f32, f32::max);
        assert!(step <= 0.51, "{step}");
        let none = shown(|_, _| (1, 4.0), |_, _| None);
        assert!(none.data().iter().all(Option::is_none));
        let far = shown(|_, _| (1, 4.0), one);
        assert_eq!(far.at(60, 40), Some(Vec3::ONE));
    }

    #[test]
    fn pixels_without_depth_and_pictures_of_one_pixel_are_no_matter() {
        let all =
            shown(|x, _| (1, if x % 3 == 0 { f32::NAN } else { f32::INFINITY }), |_, _| Some(Vec3::ONE));
        assert!(all.data().iter().all(|v| v.is_none_or(|v| v == Vec3::ONE)));
        for size in [[1, 1], [2, 1], [1, 3]] {
            let objects = Map2d::new(size[0], size[1], 1);
            let depths = Map2d::new(size[0], size[1], 2.0);
            let made = PullPush::new(&objects, &depths, ALIKE, |i| (i == 0).then_some(Vec3::X));
            let last = [size[0] - 1, size[1] - 1];
            assert_eq!(made.pixel(last, (1, 2.0), None), Some(Vec3::X));
        }
        assert!(
            PullPush::new(&Map2d::new(0, 0, 0), &Map2d::new(0, 0, 0.0), ALIKE, |_| None).levels.len()
                == LEVELS
        );
    }
}
