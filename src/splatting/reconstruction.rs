//! What is shown between samples, instead of tiles.
//!
//! In: the splat layer, object ids and depths of the view. Out: view-dependent radiance per pixel. A converged view, each of
//! whose pixels has its own sample, has the same bits with and without.
//!
//! There are two ways. [`Footprint::Smooth`] mixes all samples of a surface, however they lie ([`super::pull_push`]): in
//! motion they come from several views and levels, and no lattice holds. A sample is shown to the bit once its neighbours
//! have theirs. [`Footprint::Linear`] interpolates on lattices, and shows each sample on its pixel; it also serves pixels that
//! have a guide, and single pixels that are asked for. Of that:
//!
//! A pixel shows a sample that lies at s. The lattice of level set k has points at s + gₖ(m + ni), those of warped samples
//! nearly so, and the pixel lies in one of the four cells around s. Its value is the bilinear one of that cell's corners,
//! each with what is shown there. k is the finest level set whose tile around s holds the pixel and whose corners are all
//! there, else the sample's own. A corner does not count where it is on another object, at another depth or shows a
//! coarser sample that is not its own; the weights of the others are made to sum to one. What is above a display's white
//! counts as white: a lamp's reflection, many times as bright, would grow by a cell's width all around.
//!
//! Where a pixel's guide is known ([`crate::transport::tracer::guide`]) the corners' values are the differences of samples
//! from their guides, in the views they were traced for, and the pixel adds its own; where no sample lies, it is shown
//! alone.

use glam::Vec3;
use rayon::prelude::*;

use super::layer::level_of;
use super::pull_push::{self, Alike, BAND, ENOUGH, PullPush};
use super::{Footprint, SplatLayer};
use crate::display::FrameBuffers;
use crate::image::Map2d;
use crate::sampling::Lattice;
use crate::scene::camera::CameraFrame;

/// Depths of one surface may differ by the first share however near two pixels are, by the second however far.
pub const DEPTH_SHARES: [f32; 2] = [0.02, 0.25];
/// Steepest slope of one surface: depth per width, the tangent of 76°.
pub const SLOPE_MAX: f32 = 4.0;

/// The splat layer of a view, with what lies between the samples.
#[derive(Clone, Debug)]
pub struct Reconstruction<'a> {
    layer: &'a SplatLayer,
    objects: &'a Map2d<u32>,
    depths: &'a Map2d<f32>,
    /// Share by which depths of one surface may differ per pixel between them.
    slope: f32,
    /// Radiance that is displayed as white.
    white: f32,
    interpolates: bool,
}

impl<'a> Reconstruction<'a> {
    /// Of a layer over a drawn view, on a display that shows this radiance as white.
    pub fn new(layer: &'a SplatLayer, buffers: &'a FrameBuffers, frame: &CameraFrame, white: f32) -> Self {
        Self {
            layer,
            objects: &buffers.object,
            depths: &buffers.depth,
            slope: slope(frame),
            white,
            interpolates: layer.footprint().interpolates(),
        }
    }

    /// What all pixels show, of a layer of [`Footprint::Smooth`] as [`PullPush`] has it unless each pixel that has samples
    /// shows its own: `of` is given each pixel with its view-dependent radiance. A single pixel ([`Self::pixel`]) is told
    /// about the same linearly, which needs no preparation.
    ///
    /// # Panics
    /// If the sizes differ: a bug of the caller.
    pub fn fill<T: Copy + Send>(&self, out: &mut Map2d<T>, of: impl Fn(usize, usize, Vec3) -> T + Sync) {
        let (width, height) = (self.objects.width(), self.objects.height());
        assert_eq!((out.width(), out.height()), (width, height), "a picture of another size");
        let smooth = self.smooth();
        let width = width.max(1);
        out.data_mut().par_chunks_mut(width * BAND).enumerate().for_each(|(n, rows)| {
            let amid = smooth.as_ref().map(|smooth| smooth.band(n));
            for (y, row) in rows.chunks_mut(width).enumerate() {
                let y = n * BAND + y;
                let guides = &self.layer.guides()[1].data()[y * width..];
                for (x, (out, guide)) in row.iter_mut().zip(guides).enumerate() {
                    *out = of(x, y, self.pixel_amid(amid.as_ref(), x, y, *guide));
                }
            }
        });
    }

    /// What lies between samples that are no lattice, where that is asked for and there are any.
    fn smooth(&self) -> Option<PullPush> {
        let (colors, ranks, _, places) = self.layer.maps();
        let (colors, ranks, places) = (colors.data(), ranks.data(), places.data());
        let is_open = |rank: &u32| level_of(*rank).is_some_and(|level| level != (0, true));
        if self.layer.footprint() != Footprint::Smooth || !ranks.iter().any(is_open) {
            return None;
        }
        let width = self.objects.width();
        let white = Vec3::splat(self.white);
        let sample = |i: usize| {
            let is_own = places[i] == (i % width) as u32 | ((i / width) as u32) << 16;
            (is_own && level_of(ranks[i]).is_some()).then(|| colors[i].min(white))
        };
        let alike = Alike { slope: self.slope, shares: DEPTH_SHARES };
        Some(PullPush::new(self.objects, self.depths, alike, sample))
    }

    /// Whether a pixel shows a sample that lies on it.
    #[inline]
    fn is_own(&self, x: usize, y: usize) -> bool {
        let (_, ranks, _, places) = self.layer.maps();
        places.at(x, y) == x as u32 | (y as u32) << 16 && level_of(ranks.at(x, y)).is_some()
    }

    /// Whether all pixels of an object in a block of 2 × 2 show samples of their own.
    fn is_dense(&self, x: usize, y: usize) -> bool {
        let object = self.objects.at(x, y);
        [(x, y), (x ^ 1, y), (x, y ^ 1), (x ^ 1, y ^ 1)].into_iter().all(|(x, y)| {
            let is_other =
                x >= self.objects.width() || y >= self.objects.height() || self.objects.at(x, y) != object;
            is_other || self.is_own(x, y)
        })
    }

    /// How much of what a pixel shows is the sample that lies on it: all of it where that is shown to the bit, nothing where
    /// it lies between samples.
    pub fn own_share(&self, x: usize, y: usize) -> f32 {
        let (_, ranks, ..) = self.layer.maps();
        let level = level_of(ranks.at(x, y));
        let is_led = self.layer.guide_at(x, y).is_some();
        match self.layer.footprint() {
            _ if level.is_none() => 0.0,
            Footprint::Tile | Footprint::Square => 1.0,
            Footprint::Smooth if !is_led && self.is_dense(x, y) => 1.0,
            Footprint::Smooth if !is_led && self.is_own(x, y) => 1.0 / ENOUGH,
            Footprint::Smooth if !is_led => 0.0,
            _ => f32::from(self.is_own(x, y)),
        }
    }

    /// What a pixel without guide shows of all samples around: its own to the bit where those beside it have theirs.
    fn amid(&self, smooth: &pull_push::Band<'_>, x: usize, y: usize) -> Vec3 {
        let shown = self.layer.color(x, y);
        if self.is_dense(x, y) {
            return shown;
        }
        let own = self.is_own(x, y).then(|| shown.min(Vec3::splat(self.white)));
        smooth.pixel([x, y], (self.objects.at(x, y), self.depths.at(x, y)), own).unwrap_or(shown)
    }

    /// View-dependent radiance of a pixel.
    #[inline]
    pub fn pixel(&self, x: usize, y: usize) -> Vec3 {
        let [_, guides] = self.layer.guides();
        self.pixel_led_by(x, y, guides.at(x, y))
    }

    /// What a pixel would show if this were its guide; not a number: if it had none.
    #[inline]
    pub fn pixel_led_by(&self, x: usize, y: usize, guide: Vec3) -> Vec3 {
        self.pixel_amid(None, x, y, guide)
    }

    /// The same amid all samples around, where they are given.
    #[inline]
    fn pixel_amid(&self, smooth: Option<&pull_push::Band<'_>>, x: usize, y: usize, guide: Vec3) -> Vec3 {
        let (colors, ranks, _, places) = self.layer.maps();
        let (own, level) = (colors.at(x, y), level_of(ranks.at(x, y)));
        if !self.interpolates {
            return own;
        }
        let is_exact = level == Some((0, true));
        match smooth {
            // One alone amid others' is no more exact than those.
            Some(smooth) if level.is_some() && guide.is_nan() => return self.amid(smooth, x, y),
            _ if is_exact => return own,
            _ => {}
        }
        let [carried, _] = self.layer.guides();
        match level {
            // What is known of a pixel that no sample has reached.
            None => {
                if guide.is_nan() {
                    own
                } else {
                    guide
                }
            }
            Some((0, _)) if guide.is_nan() => own,
            Some((0, _)) => self.value(own, carried.at(x, y), guide).map_or(own, |v| self.led(v, guide)),
            Some((k, _)) => {
                let between = self.between([x as i32, y as i32], places.at(x, y), k, guide);
                between.map_or(own, |value| self.led(value, guide))
            }
        }
    }

    /// What a sample is carried to a pixel as: its difference from its guide where the pixel has a guide. None where the
    /// pixel has one and the sample has not.
    #[inline]
    fn value(&self, color: Vec3, carried: Vec3, guide: Vec3) -> Option<Vec3> {
        let white = Vec3::splat(self.white);
        match (guide.is_nan(), carried.is_nan()) {
            (true, _) => Some(color.min(white)),
            (false, false) => Some(color.min(white) - carried.min(white)),
            (false, true) => None,
        }
    }

    /// What a pixel shows of such a value.
    #[inline]
    fn led(&self, value: Vec3, guide: Vec3) -> Vec3 {
        if guide.is_nan() { value } else { (value + guide.min(Vec3::splat(self.white))).max(Vec3::ZERO) }
    }

    /// The value of a pixel that shows the sample of level set `own` at `place`; none where no corner counts.
    fn between(&self, [x, y]: [i32; 2], place: u32, own: u32, guide: Vec3) -> Option<Vec3> {
        let (sx, sy) = ((place & 0xffff) as i32, (place >> 16) as i32);
        let (dx, dy) = (x - sx, y - sy);
        for k in 1..=own {
            let (a, b) = Lattice::generator(k);
            let (a, b) = (a as i32, b as i32);
            // d / g = d · conj(g) / |g|².
            let (u, v, area) = (dx * a + dy * b, dy * a - dx * b, a * a + b * b);
            if k < own && 2 * u.abs().max(v.abs()) > area {
                continue;
            }
            let along = (u.abs() as f32 / area as f32).min(1.0);
            let across = (v.abs() as f32 / area as f32).min(1.0);
            let (ux, uy, vx, vy) = (u.signum() * a, u.signum() * b, -v.signum() * b, v.signum() * a);
            let corners = [
                (sx, sy, (1.0 - along) * (1.0 - across)),
                (sx + ux, sy + uy, along * (1.0 - across)),
                (sx + vx, sy + vy, (1.0 - along) * across),
                (sx + ux + vx, sy + uy + vy, along * across),
            ];
            if let Some((sum, weight)) = self.sum([x, y], k, guide, corners, k < own) {
                return (weight > 0.0).then(|| sum / weight);
            }
        }
        None
    }

    /// Weighted sum over the corners that count for a pixel, and the sum of their weights. None, as soon as that is known,
    /// where `all` are asked for and one is missing that is on the pixel's surface.
    #[inline]
    fn sum(
        &self,
        [x, y]: [i32; 2],
        k: u32,
        guide: Vec3,
        corners: [(i32, i32, f32); 4],
        all: bool,
    ) -> Option<(Vec3, f32)> {
        let (colors, ranks, _, places) = self.layer.maps();
        let [carried, _] = self.layer.guides();
        let (width, height) = (colors.width() as i32, colors.height() as i32);
        let at = |x: i32, y: i32| (y * width + x) as usize;
        let (object, depth) = (self.objects.data()[at(x, y)], self.depths.data()[at(x, y)]);
        let (mut sum, mut weights) = (Vec3::ZERO, 0.0);
        for (cx, cy, weight) in corners {
            if weight <= 0.0 || cx < 0 || cy < 0 || cx >= width || cy >= height {
                continue;
            }
            let i = at(cx, cy);
            let distance = ((cx - x).abs() + (cy - y).abs()) as f32;
            let tolerance = depth * (self.slope * distance).clamp(DEPTH_SHARES[0], DEPTH_SHARES[1]);
            // Also refuses NaN.
            if self.objects.data()[i] != object || !((self.depths.data()[i] - depth).abs() <= tolerance) {
                continue;
            }
            let is_own = places.data()[i] == cx as u32 | ((cy as u32) << 16);
            let counts = level_of(ranks.data()[i]).is_some_and(|(of, _)| of <= k || is_own);
            let value = || self.value(colors.data()[i], carried.data()[i], guide);
            match counts.then(value).flatten() {
                Some(value) => {
                    sum += value * weight;
                    weights += weight;
                }
                None if all => return None,
                None => {}
            }
        }
        Some((sum, weights))
    }
}

/// Share by which depths of one surface may differ per pixel between them: [`SLOPE_MAX`] times a pixel's angle.
pub fn slope(frame: &CameraFrame) -> f32 {
    SLOPE_MAX * frame.pixel_angle()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng;
    use crate::sampling::Rect;
    use crate::scene::Camera;
    use crate::splatting::{Guides, Sample, SampleBatch, WarpedSample};

    const SIZE: usize = 90;

    fn frame() -> CameraFrame {
        let camera = Camera { eye: Vec3::new(0.0, 0.0, 4.0), target: Vec3::ZERO, up: Vec3::Y, fov_y: 0.8 };
        camera.frame(SIZE as u32, SIZE as u32)
    }

    /// A view of this object and depth per pixel.
    fn view(of: impl Fn(usize, usize) -> (u32, f32)) -> FrameBuffers {
        let mut buffers = FrameBuffers::new(SIZE, SIZE);
        for (x, y) in pixels() {
            (*buffers.object.at_mut(x, y), *buffers.depth.at_mut(x, y)) = of(x, y);
        }
        buffers
    }

    fn pixels() -> impl Iterator<Item = (usize, usize)> {
        (0..SIZE * SIZE).map(|i| (i % SIZE, i / SIZE))
    }

    fn empty() -> SplatLayer {
        SplatLayer::new(SIZE, SIZE, 4, Footprint::Linear)
    }

    fn lattice() -> Lattice {
        Lattice::new(4, [SIZE as i32 / 2, SIZE as i32 / 2])
    }

    /// Splats one level of an object where `keep` says so.
    fn splat(
        layer: &mut SplatLayer,
        buffers: &FrameBuffers,
        object: u32,
        level: u32,
        color: impl Fn(f32, f32) -> Vec3,
        keep: impl Fn(i32, i32) -> bool,
    ) {
        layer.splat_fresh(&batch(buffers, object, level, color, keep), &buffers.object, 1);
    }

    fn batch(
        buffers: &FrameBuffers,
        object: u32,
        level: u32,
        color: impl Fn(f32, f32) -> Vec3,
        keep: impl Fn(i32, i32) -> bool,
    ) -> SampleBatch {
        let mut batch = SampleBatch::new(1, object, lattice().k_of(level), 0);
        for (x, y) in lattice().all_samples(level, Rect::of_size(SIZE as u32, SIZE as u32)) {
            if buffers.object.at(x as usize, y as usize) == object && keep(x, y) {
                batch.push(Sample {
                    pixel: [x as u16, y as u16],
                    position: Vec3::ZERO,
                    normal: Vec3::Z,
                    view: Vec3::Z,
                    color: color(x as f32, y as f32),
                    pixel_width: 1.0,
                });
            }
        }
        batch
    }

    /// The sample that each pixel of level set `k` moved by `offset` has become.
    fn warped(k: u32, offset: [i32; 2], object: u32, color: impl Fn(f32, f32) -> Vec3) -> Vec<WarpedSample> {
        let moved =
            Rect { x0: -offset[0], y0: -offset[1], x1: SIZE as i32 - offset[0], y1: SIZE as i32 - offset[1] };
        let levels = 1..=lattice().levels() - k;
        let all = levels.flat_map(|level| lattice().all_samples(level, moved));
        all.map(|(x, y)| {
            let (x, y) = (x + offset[0], y + offset[1]);
            WarpedSample {
                x: x as u16,
                y: y as u16,
                depth: 4.0,
                depth_tolerance: 0.1,
                color: color(x as f32, y as f32),
                guide: Vec3::NAN,
                object,
                age: 1,
                half_side: (Lattice::square_side(k) / 2) as u8,
                k: k as u8,
            }
        })
        .collect()
    }

    fn plane(x: f32, y: f32) -> Vec3 {
        Vec3::new(0.3 + 0.01 * x, 0.7 - 0.005 * y, 0.2 + 0.002 * x + 0.003 * y)
    }

    /// Away from the rim all around a pixel is sampled.
    fn is_inner(x: usize, y: usize, rim: usize) -> bool {
        (rim..SIZE - rim).contains(&x) && (rim..SIZE - rim).contains(&y)
    }

    fn near(a: Vec3, b: Vec3) -> bool {
        (a - b).abs().max_element() < 1e-5
    }

    #[test]
    fn a_constant_stays_that_constant_whatever_lies_where() {
        let buffers = view(|x, y| (u32::from((x as i32 - 40).pow(2) + (y as i32 - 50).pow(2) < 900), 4.0));
        let color = |_: f32, _: f32| Vec3::new(0.3, 0.7, 11.0);
        for seed in 0..8 {
            let mut layer = empty();
            let old = warped(2, [3, -2], 1, color);
            layer.splat_warped(&old, &buffers.object, &buffers.depth);
            for level in 1..=4 {
                let keep = |x: i32, y: i32| !rng::hash(seed, x as u64, y as u64).is_multiple_of(3);
                splat(&mut layer, &buffers, 1, level, color, keep);
            }
            let between = Reconstruction::new(&layer, &buffers, &frame(), f32::INFINITY);
            for (x, y) in pixels().filter(|&(x, y)| layer.is_covered(x, y)) {
                assert!((between.pixel(x, y) - color(0.0, 0.0)).abs().max_element() < 1e-5, "{x}, {y}");
            }
        }
    }

    #[test]
    fn a_plane_stays_that_plane_between_fresh_and_between_warped_samples() {
        let buffers = view(|_, _| (1, 4.0));
        for k in 1..=3 {
            let rim = 2 * Lattice::square_side(k) as usize;
            let mut layer = empty();
            for level in 1..=lattice().levels() - k {
                splat(&mut layer, &buffers, 1, level, plane, |_, _| true);
            }
            let mut moved = empty();
            moved.splat_warped(&warped(k, [2, 1], 1, plane), &buffers.object, &buffers.depth);
            for (layer, what) in [(&layer, "fresh"), (&moved, "warped")] {
                let between = Reconstruction::new(layer, &buffers, &frame(), f32::INFINITY);
                let mut differing = 0;
                for (x, y) in pixels().filter(|&(x, y)| is_inner(x, y, rim)) {
                    let expected = plane(x as f32, y as f32);
                    let found = between.pixel(x, y);
                    assert!(near(found, expected), "{what}, k = {k}: {found} for {expected} at {x}, {y}");
                    differing += usize::from(!near(layer.color(x, y), expected));
                }
                assert!(differing > 500, "tiles are no planes");
            }
        }
    }

    #[test]
    fn other_objects_and_other_depths_are_never_read() {
        // Quarters: two objects, each at two depths.
        let of = |x: usize, y: usize| (1 + u32::from(x + y / 3 > 60), if y > 40 { 4.0 } else { 2.0 });
        let buffers = view(of);
        let tint = |object: u32, y: f32| Vec3::new(object as f32, if y > 40.0 { 4.0 } else { 2.0 }, 0.5);
        for k in 1..=3 {
            let mut layer = empty();
            for object in [1, 2] {
                for level in 1..=lattice().levels() - k {
                    splat(&mut layer, &buffers, object, level, |_, y| tint(object, y), |_, _| true);
                }
            }
            let between = Reconstruction::new(&layer, &buffers, &frame(), f32::INFINITY);
            let mut mended = 0;
            for (x, y) in pixels().filter(|&(x, y)| layer.is_covered(x, y)) {
                let (object, depth) = of(x, y);
                let found = between.pixel(x, y);
                assert!((found.x - object as f32).abs() < 1e-5, "k = {k}: {found} at {x}, {y}");
                // A tile reaches over the edge of depth, but where one corner lies on this side, only such are shown.
                let is_whole = [2.0, 4.0].iter().any(|of| (found.y - of).abs() < 1e-5);
                assert!(is_whole, "k = {k}: depths are mixed: {found} at {x}, {y}");
                mended += usize::from(layer.color(x, y).y != depth && (found.y - depth).abs() < 1e-5);
            }
            assert!(mended > 10, "k = {k}: {mended}");
        }
    }

    #[test]
    fn own_samples_and_approximations_are_shown_to_the_bit() {
        let buffers = view(|_, _| (1, 4.0));
        let mut layer = empty();
        let wild = |x: f32, y: f32| Vec3::new((7.0 * x + 3.0 * y) % 11.0, (x * y) % 5.0, x / (y + 1.0));
        for level in 1..=lattice().levels() {
            let in_part = |x: i32, _: i32| x < 60;
            splat(&mut layer, &buffers, 1, level, wild, in_part);
        }
        layer.approximate(|x, y| plane(x as f32, y as f32));
        let between = Reconstruction::new(&layer, &buffers, &frame(), f32::INFINITY);
        for (x, y) in pixels().filter(|&(x, y)| x < 60 || !layer.is_covered(x, y)) {
            assert_eq!(between.pixel(x, y), layer.color(x, y), "{x}, {y}");
        }
        assert!(pixels().any(|(x, y)| !layer.is_covered(x, y)));
    }

    fn texture(x: f32, y: f32) -> Vec3 {
        Vec3::new((7.0 * x + 3.0 * y) % 11.0, (x * y) % 5.0, (x - y).abs() % 3.0)
    }

    /// What guides show is shown in each pixel, and only what samples know beside it is carried.
    #[test]
    fn guides_take_the_place_of_what_they_know() {
        let buffers = view(|_, _| (1, 4.0));
        let beside = Vec3::new(0.5, -0.1, 0.25);
        let sampled = |x: f32, y: f32| texture(x, y) + Vec3::splat(1.0) + beside;
        let guides = |keep: fn(usize) -> bool| {
            let some: Vec<(usize, usize)> = pixels().filter(|(x, _)| keep(*x)).collect();
            Guides {
                view: 1,
                pixels: some.iter().map(|&(x, y)| [x as u16, y as u16]).collect(),
                colors: some.iter().map(|&(x, y)| texture(x as f32, y as f32) + Vec3::splat(1.0)).collect(),
            }
        };
        let mut fresh = empty();
        for level in 1..=3 {
            let mut batch = batch(&buffers, 1, level, sampled, |_, _| true);
            let guide = |&[x, y]: &[u16; 2]| texture(f32::from(x), f32::from(y)) + Vec3::splat(1.0);
            batch.guides = batch.pixels.iter().map(guide).collect();
            fresh.splat_fresh(&batch, &buffers.object, 1);
        }
        // In the view before all was brighter by 3: what the samples knew beside is the same.
        let mut old = empty();
        let mut samples = warped(2, [2, 1], 1, |x, y| sampled(x, y) + Vec3::splat(3.0));
        for s in &mut samples {
            s.guide = texture(f32::from(s.x), f32::from(s.y)) + Vec3::splat(4.0);
        }
        old.splat_warped(&samples, &buffers.object, &buffers.depth);
        for layer in [&mut fresh, &mut old] {
            let before = layer.clone();
            layer.guide(&guides(|x| x < 60));
            let between = |layer| Reconstruction::new(layer, &buffers, &frame(), f32::INFINITY);
            for (x, y) in pixels() {
                let found = between(&*layer).pixel(x, y);
                if x >= 60 {
                    assert_eq!(found, between(&before).pixel(x, y), "a pixel without guide");
                } else if layer.is_covered(x, y) {
                    let expected = sampled(x as f32, y as f32);
                    assert!(
                        (found - expected).abs().max_element() < 1e-4,
                        "{found}, not {expected} at {x}, {y}"
                    );
                } else {
                    assert_eq!(found, texture(x as f32, y as f32) + Vec3::splat(1.0), "only the guide");
                }
            }
        }
        let exact = pixels().filter(|&(x, y)| fresh.shown_level(x, y) == Some((0, true)));
        let own = Reconstruction::new(&fresh, &buffers, &frame(), f32::INFINITY);
        assert!(exact.inspect(|&(x, y)| assert_eq!(own.pixel(x, y), fresh.color(x, y))).count() > 300);
    }

    /// A highlight many times as bright as white is not seen further away than a white one.
    #[test]
    fn what_is_above_white_counts_as_white_but_on_its_own_pixel() {
        let buffers = view(|_, _| (1, 4.0));
        let lit = |brightness: f32| {
            let mut layer = empty();
            let color = |x: f32, _: f32| if x < 45.0 { Vec3::ZERO } else { Vec3::splat(brightness) };
            (1..=3).for_each(|level| splat(&mut layer, &buffers, 1, level, color, |_, _| true));
            layer
        };
        let (bright, white) = (lit(50.0), lit(2.0));
        let of = |layer| Reconstruction::new(layer, &buffers, &frame(), 2.0);
        for (x, y) in pixels() {
            let (found, expected) = (of(&bright).pixel(x, y), of(&white).pixel(x, y));
            let is_own = bright.shown_level(x, y) == Some((0, true));
            assert_eq!(found, if is_own { bright.color(x, y) } else { expected }, "{x}, {y}");
        }
    }

    /// Smooth pictures: what has few samples is mixed, never with another object's; what has all shows them to the bit.
    #[test]
    fn samples_are_mixed_until_their_neighbours_have_theirs() {
        let buffers = view(|x, y| (1 + u32::from(x + y / 3 > 60), 4.0));
        let wild = |object: u32| move |x: f32, y: f32| texture(x, y).with_z(object as f32);
        let mut layer = SplatLayer::new(SIZE, SIZE, 4, Footprint::Smooth);
        let old = warped(2, [3, -2], 1, wild(1));
        layer.splat_warped(&old, &buffers.object, &buffers.depth);
        for level in 1..=lattice().levels() {
            for object in [1, 2] {
                splat(&mut layer, &buffers, object, level, wild(object), |_, _| true);
            }
            let between = Reconstruction::new(&layer, &buffers, &frame(), f32::INFINITY);
            let is_smooth = between.smooth().is_some();
            assert_eq!(is_smooth, level < lattice().levels(), "only where it is needed");
            let mut shown = Map2d::new(SIZE, SIZE, Vec3::ZERO);
            between.fill(&mut shown, |_, _, value| value);
            let mut mixed = 0;
            for (x, y) in pixels().filter(|&(x, y)| layer.is_covered(x, y)) {
                let value = shown.at(x, y);
                let object = buffers.object.at(x, y);
                assert!((value.z - object as f32).abs() < 1e-5, "{value} at {x}, {y}");
                mixed += usize::from(value != layer.color(x, y));
                if !is_smooth {
                    assert_eq!(value, wild(object)(x as f32, y as f32));
                }
            }
            assert!(!is_smooth || mixed > 1000, "{mixed}");
        }
        // Without preparation the linear way stands for it.
        let alone = Reconstruction::new(&layer, &buffers, &frame(), f32::INFINITY);
        assert_eq!(alone.pixel(40, 40), layer.color(40, 40));
    }

    #[test]
    fn tiles_show_tiles() {
        let buffers = view(|_, _| (1, 4.0));
        for footprint in [Footprint::Tile, Footprint::Square] {
            let mut layer = SplatLayer::new(SIZE, SIZE, 4, footprint);
            (1..=3).for_each(|level| splat(&mut layer, &buffers, 1, level, plane, |_, _| true));
            let between = Reconstruction::new(&layer, &buffers, &frame(), f32::INFINITY);
            assert!(pixels().all(|(x, y)| between.pixel(x, y) == layer.color(x, y)));
        }
    }

    /// Fine samples at the rim of what is refined take no value from the coarse ones beyond it.
    #[test]
    fn coarser_samples_are_not_read() {
        let buffers = view(|_, _| (1, 4.0));
        let mut layer = empty();
        splat(&mut layer, &buffers, 1, 1, |_, _| Vec3::ONE, |_, _| true);
        let mut fine = SplatLayer::clone(&layer);
        (2..=4)
            .for_each(|level| splat(&mut fine, &buffers, 1, level, |_, _| Vec3::splat(5.0), |x, _| x < 45));
        let between = Reconstruction::new(&fine, &buffers, &frame(), f32::INFINITY);
        let is_of_level = |x, y| fine.shown_level(x, y).is_some_and(|(k, _)| k == 1);
        let all = pixels().filter(|&(x, y)| is_of_level(x, y) && is_inner(x, y, 4));
        let mut count = 0;
        for (x, y) in all {
            // Points of the coarsest level keep their own.
            let value = between.pixel(x, y);
            let coarse_near = (-3..=3).any(|dy| {
                (-3..=3).any(|dx| {
                    let (cx, cy) = (x as i32 + dx, y as i32 + dy);
                    lattice().level(cx, cy) == 1
                })
            });
            assert!(coarse_near || near(value, Vec3::splat(5.0)), "{value} at {x}, {y}");
            count += 1;
        }
        assert!(count > 500);
    }
}
