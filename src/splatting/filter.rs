//! A filter whose halves guard each other: what two independent halves of the samples do not both show is noise.
//!
//! À-trous wavelets with a 5×5 binomial kernel on six levels (Dammertz et al. 2010; Schied et al. 2017), over pixels of one
//! surface. The weight of a tap in one half comes from the values of the other (as between the halves of Bitterli et al.
//! 2016): what is noise in both would be kept by weights of its own. Then what is left is scaled by the share that both
//! halves agree on, ⟨f_P f_Q⟩ / ⟨((f_P + f_Q) / 2)²⟩, which noise does not raise. As variances fall, taps of other values
//! lose their weights and the share becomes 1: in the limit nothing is changed, and there is no strength to tune.

use arrayvec::ArrayVec;
use glam::Vec3;

use crate::display::FrameBuffers;
use crate::display::cpu_pass::{primary_interaction, primary_ray};
use crate::image::luminance;
use crate::scene::camera::CameraFrame;
use crate::world::World;

/// Distances between taps, pixels.
const STEPS: [usize; 6] = [1, 2, 4, 8, 16, 32];
/// Binomial weights.
const KERNEL: [f32; 5] = [1.0 / 16.0, 4.0 / 16.0, 6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0];
const TAPS: usize = KERNEL.len() * KERNEL.len();
/// Pixels to each side that a variance is pooled over.
const POOLED: usize = 3;
/// Pixels to each side over which halves must agree.
const AGREED: usize = 24;
/// Of each of two means, one over the other, which together reach about as far as that.
const FADING: usize = 17;
/// Cosine of the normals of one surface, at least.
const FLAT: f32 = 0.9;
/// Distance of a tap from the tangent plane, pixel widths, at most.
const BESIDE: f32 = 2.0;
/// Exponents from which on a weight is nothing.
const NOTHING: f32 = 20.0;
/// Pixels of a row that are filtered together, where any of them is known.
const LANES: usize = 8;
/// The object of pixels that show none.
const NONE: u32 = u32::MAX;

/// Asked now and then by what takes long, which ends early with `None` where the answer is no.
pub type GoesOn<'a> = &'a dyn Fn() -> bool;

/// What a pixel shows of the geometry.
#[derive(Clone, Copy, Debug)]
struct Surface {
    object: u32,
    normal: Vec3,
    position: Vec3,
    /// Of the pixel there, scene units.
    width: f32,
}

/// The surfaces of a view: which pixels may tell of which.
#[derive(Clone, Debug)]
pub struct Surfaces {
    grid: Grid,
    /// By step, columns with a bit for each tap of the kernel that shows the same surface.
    alike: [Vec<u32>; STEPS.len()],
}

/// Where pixels lie in padded columns: beside each row there is room for taps that reach over its ends.
#[derive(Clone, Copy, Debug)]
struct Grid {
    width: usize,
    height: usize,
}

impl Grid {
    const PAD: usize = 2 * STEPS[STEPS.len() - 1];

    fn pitch(&self) -> usize {
        self.width.next_multiple_of(LANES) + 2 * Self::PAD
    }

    fn len(&self) -> usize {
        self.pitch() * self.height
    }

    #[inline(always)]
    fn at(&self, x: usize, y: usize) -> usize {
        y * self.pitch() + Self::PAD + x
    }

    /// Pixels in the order of a picture, as a column.
    fn padded<T: Copy>(&self, none: T, value: impl Fn(usize) -> T) -> Vec<T> {
        let mut column = vec![none; self.len()];
        for y in 0..self.height {
            let row = self.at(0, y);
            (0..self.width).for_each(|x| column[row + x] = value(y * self.width + x));
        }
        column
    }

    /// The taps of the pixels of row `y`, without those above and below the picture.
    #[inline(always)]
    fn taps(&self, y: usize, step: usize) -> ArrayVec<Tap, TAPS> {
        let mut taps = ArrayVec::new();
        for (dy, down) in KERNEL.into_iter().enumerate() {
            for (dx, across) in KERNEL.into_iter().enumerate() {
                let [right, below] = [dx, dy].map(|d| (d as isize - 2) * step as isize);
                if (0..self.height as isize).contains(&(y as isize + below)) {
                    let number = (dy * KERNEL.len() + dx) as u32;
                    taps.push(Tap {
                        number,
                        weight: down * across,
                        away: below * self.pitch() as isize + right,
                    });
                }
            }
        }
        taps
    }
}

/// A tap of the kernel.
#[derive(Clone, Copy)]
struct Tap {
    number: u32,
    weight: f32,
    /// Where it lies in columns, from where the pixel lies.
    away: isize,
}

/// Of three columns, numbers that lie side by side.
#[inline(always)]
fn lanes_of(columns: &[Vec<f32>; 3], at: usize) -> [&[f32; LANES]; 3] {
    let [a, b, c] = columns;
    [lanes(a, at), lanes(b, at), lanes(c, at)]
}

/// Numbers that lie side by side.
#[inline(always)]
fn lanes<T>(column: &[T], at: usize) -> &[T; LANES] {
    column[at..].first_chunk().expect("columns are padded")
}

impl Surfaces {
    /// Of a drawn view.
    pub fn of_view(
        world: &World,
        frame: &CameraFrame,
        buffers: &FrameBuffers,
        goes_on: GoesOn<'_>,
    ) -> Option<Self> {
        let (width, height) = (buffers.width(), buffers.height());
        let surface = |i: usize| {
            let (x, y) = (i % width, i / width);
            let hit = buffers.hit.at(x, y).hit()?;
            let ray = primary_ray(frame, x as u32, y as u32);
            let at = primary_interaction(world, frame, &ray, &hit);
            let object = buffers.object.at(x, y);
            let (normal, position) = (at.facing_shading(), at.position);
            Some(Surface { object, normal, position, width: at.footprint })
        };
        Self::new(width, height, surface, goes_on)
    }

    fn new(
        width: usize,
        height: usize,
        at: impl Fn(usize) -> Option<Surface>,
        goes_on: GoesOn<'_>,
    ) -> Option<Self> {
        let grid = Grid { width, height };
        let mut columns = Columns::new(&grid);
        for y in 0..height {
            if !goes_on() {
                return None;
            }
            (0..width).for_each(|x| columns.set(grid.at(x, y), at(y * width + x)));
        }
        let mut alike = STEPS.map(|_| vec![0; grid.len()]);
        for (step, alike) in STEPS.into_iter().zip(&mut alike) {
            for y in 0..height {
                if !goes_on() {
                    return None;
                }
                let row = Compared { columns: &columns, grid: &grid, y, step, alike };
                pulp::Arch::new().dispatch(row);
            }
        }
        Some(Self { grid, alike })
    }

    /// What both of two positive estimates show of the mean of a quantity around each pixel, by `weight`: about the harmonic
    /// mean of theirs, so that what only one of them found counts little. Pixels count less the farther they are away, or a
    /// bright one among dark ones would be seen as a square.
    pub fn agreed_around(&self, halves: &[Vec<Vec3>; 2], weight: &[Vec3]) -> Vec<Vec3> {
        let mut all = vec![Vec3::ZERO; weight.len()];
        for band in 0..3 {
            let sums = |values: &[Vec3]| {
                let once = self.sums_around(FADING, |i| f64::from(values[i][band]));
                self.sums_around(FADING, |i| once[i])
            };
            let (weight, [p, q]) = (sums(weight), halves.each_ref().map(|half| sums(half)));
            for (i, all) in all.iter_mut().enumerate() {
                let (p, q) = (p[i].max(0.0), q[i].max(0.0));
                if weight[i] > 0.0 && p + q > 0.0 {
                    all[band] = (2.0 * p * q / (p + q) / weight[i]) as f32;
                }
            }
        }
        all
    }

    /// Sums of `value` over the squares of `radius` around all pixels.
    pub(super) fn sums_around(&self, radius: usize, value: impl Fn(usize) -> f64) -> Vec<f64> {
        let Grid { width: w, height: h } = self.grid;
        let mut table = vec![0.0; (w + 1) * (h + 1)];
        for y in 0..h {
            let (above, below) = table[y * (w + 1)..][..2 * (w + 1)].split_at_mut(w + 1);
            let mut row = 0.0;
            for x in 0..w {
                row += value(y * w + x);
                below[x + 1] = above[x + 1] + row;
            }
        }
        let mut sums = Vec::with_capacity(w * h);
        for y in 0..h {
            let above = &table[y.saturating_sub(radius) * (w + 1)..][..w + 1];
            let below = &table[(y + radius + 1).min(h) * (w + 1)..][..w + 1];
            sums.extend((0..w).map(|x| {
                let (x0, x1) = (x.saturating_sub(radius), (x + radius + 1).min(w));
                below[x1] - below[x0] - above[x1] + above[x0]
            }));
        }
        sums
    }
}

/// Two independent estimates of the same values.
#[derive(Clone, Debug, PartialEq)]
pub struct Halves {
    /// By half and pixel.
    pub values: [Vec<Vec3>; 2],
    /// Variances of their luminance.
    pub variances: [Vec<f32>; 2],
    /// Where there is something to estimate; elsewhere values are 0.
    pub known: Vec<bool>,
}

impl Halves {
    /// Of so many pixels, none of which is known.
    pub fn of_nothing(count: usize) -> Self {
        let none = || vec![Vec3::ZERO; count];
        Self {
            values: [none(), none()],
            variances: [vec![0.0; count], vec![0.0; count]],
            known: vec![false; count],
        }
    }

    /// Each half smoothed under the guard of the other.
    fn smoothed(mut self, surfaces: &Surfaces, goes_on: GoesOn<'_>) -> Option<Self> {
        if !self.known.contains(&true) {
            return Some(self);
        }
        let counted = surfaces.sums_around(POOLED, |i| f64::from(u8::from(self.known[i])));
        for variances in &mut self.variances {
            let sums = surfaces.sums_around(POOLED, |i| f64::from(variances[i]));
            // A firefly is as doubtful as it says itself: by the mean around it, it would be an edge on all sides, and what
            // the other half shows there would stay as it is.
            for ((own, sum), n) in variances.iter_mut().zip(sums).zip(&counted) {
                *own = own.max((sum / n.max(1.0)) as f32).max(0.0);
            }
        }
        let grid = &surfaces.grid;
        let mut planes = Planes::of(&self, grid);
        let mut next = planes.clone();
        for (step, alike) in STEPS.into_iter().zip(&surfaces.alike) {
            for y in 0..grid.height {
                if !goes_on() {
                    return None;
                }
                let row = Smoothed { planes: &planes, grid, y, step, alike, next: &mut next };
                pulp::Arch::new().dispatch(row);
            }
            std::mem::swap(&mut planes, &mut next);
        }
        self.values = planes.halves.map(|half| half.values(grid));
        Some(self)
    }

    /// What both halves show: their mean, smoothed, and what both are `missing`, as far as they agree on what is seen of it,
    /// which is `seen` times the values. Where an edge of something else leaves nearly nothing of a pixel, its values are noise
    /// that nobody sees.
    pub fn reconstructed(
        self,
        surfaces: &Surfaces,
        missing: &[Vec3],
        seen: &[f32],
        goes_on: GoesOn<'_>,
    ) -> Option<Vec<Vec3>> {
        let smooth = self.smoothed(surfaces, goes_on)?;
        let [p, q] = smooth.values.map(|values| -> Vec<Vec3> {
            values.iter().zip(missing).map(|(value, missing)| *value + *missing).collect()
        });
        let both = |i: usize| [p[i], q[i]].map(|v| f64::from(luminance(v) * seen[i]));
        let agreed = surfaces.sums_around(AGREED, |i| both(i)[0] * both(i)[1]);
        let all = surfaces.sums_around(AGREED, |i| (0.5 * (both(i)[0] + both(i)[1])).powi(2));
        let share = |i: usize| if all[i] > 0.0 { (agreed[i] / all[i]).clamp(0.0, 1.0) as f32 } else { 0.0 };
        Some((0..p.len()).map(|i| (p[i] + q[i]) * (0.5 * share(i))).collect())
    }

    /// The mean of both halves, smoothed.
    pub fn mean(self, surfaces: &Surfaces, goes_on: GoesOn<'_>) -> Option<Vec<Vec3>> {
        let [p, q] = self.smoothed(surfaces, goes_on)?.values;
        Some(p.into_iter().zip(q).map(|(p, q)| (p + q) * 0.5).collect())
    }
}

/// Surfaces by quantity, so that processors compare several at once.
struct Columns {
    object: Vec<u32>,
    normal: [Vec<f32>; 3],
    position: [Vec<f32>; 3],
    width: Vec<f32>,
}

impl Columns {
    /// Of pixels that show none.
    fn new(grid: &Grid) -> Self {
        let zeros = || vec![0.0; grid.len()];
        Self {
            object: vec![NONE; grid.len()],
            normal: [zeros(), zeros(), zeros()],
            position: [zeros(), zeros(), zeros()],
            width: zeros(),
        }
    }

    fn set(&mut self, at: usize, surface: Option<Surface>) {
        let Some(Surface { object, normal, position, width }) = surface else { return };
        (self.object[at], self.width[at]) = (object, width);
        for axis in 0..3 {
            self.normal[axis][at] = normal[axis];
            self.position[axis][at] = position[axis];
        }
    }

    /// Sets the bits of the pixels of a row.
    #[inline(always)]
    fn compare(&self, grid: &Grid, y: usize, step: usize, alike: &mut [u32]) {
        let taps = grid.taps(y, step);
        for x in (0..grid.width).step_by(LANES) {
            let here = grid.at(x, y);
            let (object, width) = (lanes(&self.object, here), lanes(&self.width, here));
            let [ax, ay, az] = lanes_of(&self.normal, here);
            let [px, py, pz] = lanes_of(&self.position, here);
            let mut bits = [0; LANES];
            for tap in &taps {
                let there = here.wrapping_add_signed(tap.away);
                let (other, wider) = (lanes(&self.object, there), lanes(&self.width, there));
                let [bx, by, bz] = lanes_of(&self.normal, there);
                let [qx, qy, qz] = lanes_of(&self.position, there);
                for i in 0..LANES {
                    let cosine = ax[i] * bx[i] + ay[i] * by[i] + az[i] * bz[i];
                    let off = (qx[i] - px[i]) * ax[i] + (qy[i] - py[i]) * ay[i] + (qz[i] - pz[i]) * az[i];
                    let most = BESIDE * if width[i] > wider[i] { width[i] } else { wider[i] };
                    let is_one = (cosine > FLAT) & (off.abs() < most) | (here == there);
                    let is_one = is_one & (object[i] == other[i]) & (object[i] != NONE);
                    bits[i] |= u32::from(is_one) << tap.number;
                }
            }
            alike[here..here + LANES].copy_from_slice(&bits);
        }
    }
}

/// A half, by quantity.
#[derive(Clone)]
struct Plane {
    rgb: [Vec<f32>; 3],
    brightness: Vec<f32>,
    variance: Vec<f32>,
}

impl Plane {
    fn values(&self, grid: &Grid) -> Vec<Vec3> {
        let rows = (0..grid.height).flat_map(|y| grid.at(0, y)..grid.at(grid.width, y));
        rows.map(|at| Vec3::from(self.rgb.each_ref().map(|band| band[at]))).collect()
    }
}

/// Both halves, so that processors filter several pixels at once.
#[derive(Clone)]
struct Planes {
    halves: [Plane; 2],
    /// 1 where there is something to filter, 0 elsewhere.
    known: Vec<f32>,
}

impl Planes {
    fn of(halves: &Halves, grid: &Grid) -> Self {
        let plane = |half: usize| {
            let (values, variances) = (&halves.values[half], &halves.variances[half]);
            Plane {
                rgb: [0, 1, 2].map(|band| grid.padded(0.0, |i| values[i][band])),
                brightness: grid.padded(0.0, |i| luminance(values[i])),
                variance: grid.padded(0.0, |i| variances[i]),
            }
        };
        let known = grid.padded(0.0, |i| f32::from(u8::from(halves.known[i])));
        Self { halves: [plane(0), plane(1)], known }
    }

    /// One level of a row; what is not known stays.
    #[inline(always)]
    fn smooth_row(&self, grid: &Grid, y: usize, step: usize, alike: &[u32], next: &mut Self) {
        let taps = grid.taps(y, step);
        for x in (0..grid.width).step_by(LANES) {
            let here = grid.at(x, y);
            let (known, alike) = (lanes(&self.known, here), lanes(alike, here));
            if *known == [0.0; LANES] {
                continue;
            }
            for half in 0..2 {
                let (values, guard) = (&self.halves[half], &self.halves[1 - half]);
                let (shown, doubt) = (lanes(&guard.brightness, here), lanes(&guard.variance, here));
                let [mut red, mut green, mut blue, mut total, mut variance] = [[0.0f32; LANES]; 5];
                for tap in &taps {
                    let there = here.wrapping_add_signed(tap.away);
                    let (other, doubts) = (lanes(&guard.brightness, there), lanes(&guard.variance, there));
                    let [r, g, b] = lanes_of(&values.rgb, there);
                    let (spread, known) = (lanes(&values.variance, there), lanes(&self.known, there));
                    for i in 0..LANES {
                        let difference = other[i] - shown[i];
                        let noise = doubts[i] + doubt[i];
                        let beyond = difference * difference - noise;
                        let beyond = if beyond > 0.0 { beyond } else { 0.0 };
                        // Nothing also where there is no noise, but for what is the same.
                        let something = if beyond <= NOTHING * noise { 1.0 } else { 0.0 };
                        let least = if noise > f32::MIN_POSITIVE { noise } else { f32::MIN_POSITIVE };
                        let like = (alike[i] >> tap.number & 1) as i32 as f32 * known[i] * something;
                        let weight = tap.weight * fading(beyond / least) * like;
                        red[i] += r[i] * weight;
                        green[i] += g[i] * weight;
                        blue[i] += b[i] * weight;
                        total[i] += weight;
                        variance[i] += spread[i] * weight * weight;
                    }
                }
                let to = &mut next.halves[half];
                for i in 0..LANES {
                    if known[i] > 0.0 && total[i] > 0.0 {
                        let color = Vec3::new(red[i], green[i], blue[i]) / total[i];
                        (0..3).for_each(|band| to.rgb[band][here + i] = color[band]);
                        to.brightness[here + i] = luminance(color);
                        to.variance[here + i] = variance[i] / (total[i] * total[i]);
                    }
                }
            }
        }
    }
}

/// [`Columns::compare`], compiled for what the processor has. Not a closure: what is called from there would be compiled for
/// any processor.
struct Compared<'a> {
    columns: &'a Columns,
    grid: &'a Grid,
    y: usize,
    step: usize,
    alike: &'a mut [u32],
}

impl pulp::NullaryFnOnce for Compared<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.columns.compare(self.grid, self.y, self.step, self.alike);
    }
}

/// [`Planes::smooth_row`], the same.
struct Smoothed<'a> {
    planes: &'a Planes,
    grid: &'a Grid,
    y: usize,
    step: usize,
    alike: &'a [u32],
    next: &'a mut Planes,
}

impl pulp::NullaryFnOnce for Smoothed<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.planes.smooth_row(self.grid, self.y, self.step, self.alike, self.next);
    }
}

/// e⁻ˣ to 10⁻⁵, for x from 0 to [`NOTHING`]; anything above that. Without branches, as all that several pixels are to go
/// through at once.
#[inline(always)]
fn fading(x: f32) -> f32 {
    /// Added and subtracted, it rounds to an integer; in between, the lowest bits are that integer.
    const ROUND: f32 = 12_582_912.0;
    let x = if x < NOTHING { x } else { NOTHING };
    let t = x * -std::f32::consts::LOG2_E;
    let rounded = t + ROUND;
    let f = t - (rounded - ROUND);
    // 2ᶠ for |f| ≤ ½.
    let p = 1.0 + f * (std::f32::consts::LN_2 + f * (0.240_226_5 + f * (0.055_504_1 + f * 0.009_618_1)));
    f32::from_bits(p.to_bits().wrapping_add(rounded.to_bits() << 23))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Stream;

    const SIDE: usize = 96;

    /// A wall that fills the picture.
    fn wall() -> Surfaces {
        of_normals(|_| Vec3::Z)
    }

    /// One with such normals, by column.
    fn of_normals(normal: impl Fn(usize) -> Vec3) -> Surfaces {
        let at = |i: usize| {
            let position = Vec3::new((i % SIDE) as f32, (i / SIDE) as f32, 0.0);
            Some(Surface { object: 0, normal: normal(i % SIDE), position, width: 1.0 })
        };
        Surfaces::new(SIDE, SIDE, at, &|| true).expect("it goes on")
    }

    fn reconstructed(halves: Halves) -> Vec<Vec3> {
        halves
            .reconstructed(&wall(), &[Vec3::ZERO; SIDE * SIDE], &[1.0; SIDE * SIDE], &|| true)
            .expect("it goes on")
    }

    /// `signal` with noise of this deviation in each half.
    fn halves(signal: impl Fn(usize, usize) -> f32, deviation: f32, seed: u64) -> Halves {
        let noisy = |half: u64| {
            let mut stream = Stream::new(seed, half, 0);
            let mut value = |i: usize| {
                let noise = 12f32.sqrt() * (stream.next_f32() - 0.5) * deviation;
                Vec3::splat(signal(i % SIDE, i / SIDE) + noise)
            };
            (0..SIDE * SIDE).map(&mut value).collect()
        };
        let variance = vec![deviation * deviation; SIDE * SIDE];
        Halves {
            values: [noisy(0), noisy(1)],
            variances: [variance.clone(), variance],
            known: vec![true; SIDE * SIDE],
        }
    }

    fn root_mean_square(values: impl Iterator<Item = f32>) -> f32 {
        (values.map(|v| v * v).sum::<f32>() / (SIDE * SIDE) as f32).sqrt()
    }

    #[test]
    fn a_constant_is_kept() {
        let kept = reconstructed(halves(|_, _| 0.3, 0.2, 1));
        let off = root_mean_square(kept.iter().map(|v| v.x - 0.3));
        assert!(off < 0.01, "{off}");
    }

    #[test]
    fn of_pure_noise_at_most_a_tenth_is_left() {
        let left = root_mean_square(reconstructed(halves(|_, _| 0.0, 1.0, 2)).iter().map(|v| v.x));
        // Of the mean of both halves.
        assert!(left < 0.1 / 2f32.sqrt(), "{left}");
    }

    /// One in each half, on the same pixel; what is as bright there in all samples stays.
    #[test]
    fn fireflies_leave_no_speck() {
        const AT: usize = SIDE * SIDE / 2 + SIDE / 2;
        let (bright, of_one_sample) = (Vec3::splat(2.0), 2.0 * 2.0);
        for (own, shown) in [(of_one_sample, 0.0), (0.0, 2.0)] {
            let mut with = halves(|_, _| 0.0, 0.1, 8);
            for half in 0..2 {
                with.values[half][AT] = bright;
                with.variances[half][AT] = own;
            }
            let kept = reconstructed(with)[AT].x;
            assert!((kept - shown).abs() < 0.05, "{own}: {kept}");
        }
    }

    #[test]
    fn without_variance_nothing_changes() {
        let ramp = |x: usize, y: usize| 0.01 * x as f32 + if y > 40 { 1.0 } else { 0.0 };
        let exact = reconstructed(halves(ramp, 0.0, 3));
        assert!(exact.iter().enumerate().all(|(i, v)| (v.x - ramp(i % SIDE, i / SIDE)).abs() < 1e-5));
    }

    #[test]
    fn an_edge_that_samples_show_stays() {
        let edge = |x: usize, _| if x < SIDE / 2 { 0.0 } else { 1.0 };
        let shown = reconstructed(halves(edge, 0.1, 4));
        let off = root_mean_square(shown.iter().enumerate().map(|(i, v)| v.x - edge(i % SIDE, 0)));
        assert!(off < 0.04, "{off}");
    }

    /// A hundredth of a pixel at an edge, of which one sample in each half tells, one so and one so.
    #[test]
    fn what_is_hardly_seen_decides_nothing() {
        let lone = SIDE * SIDE / 2 + SIDE / 2;
        let mut some = halves(|_, _| 0.1, 0.01, 6);
        (some.values[0][lone], some.values[1][lone]) = (Vec3::splat(20.0), Vec3::splat(-20.0));
        let (mut seen, surfaces) = ([1.0; SIDE * SIDE], wall());
        seen[lone] = 0.01;
        let shown =
            some.reconstructed(&surfaces, &[Vec3::ZERO; SIDE * SIDE], &seen, &|| true).expect("it goes on");
        let beside = shown.iter().enumerate().filter(|(i, _)| *i != lone);
        let off = root_mean_square(beside.map(|(_, v)| v.x - 0.1));
        assert!(off < 0.01, "{off}");
    }

    /// Where the map is right, what cutting left and what was cut are nothing together but noise, of which little is shown.
    #[test]
    fn what_was_cut_counts_where_halves_agree() {
        let (cut, surfaces, seen) = (halves(|_, _| -0.3, 1.0, 8), wall(), [1.0; SIDE * SIDE]);
        let shown = |missing: f32| {
            let missing = [Vec3::splat(missing); SIDE * SIDE];
            cut.clone().reconstructed(&surfaces, &missing, &seen, &|| true).expect("it goes on")
        };
        let [apart, together] = [0.0, 0.3].map(|missing| {
            root_mean_square(shown(missing).iter().map(|v| v.x + if missing == 0.0 { 0.3 } else { 0.0 }))
        });
        assert!(together < 0.6 * apart, "{together} {apart}");
    }

    #[test]
    fn halves_that_are_exchanged_give_the_same_bits() {
        let signal = |x: usize, y: usize| ((x / 16 + y / 16) % 2) as f32;
        let some = halves(signal, 0.5, 5);
        let Halves { values: [p, q], variances: [v, w], known } = some.clone();
        let other = Halves { values: [q, p], variances: [w, v], known };
        assert_eq!(reconstructed(some), reconstructed(other));
    }

    #[test]
    fn what_only_one_half_found_counts_little() {
        let surfaces = wall();
        let (one, lone) = (vec![Vec3::ONE; SIDE * SIDE], |i: usize| {
            let mut values = vec![Vec3::ZERO; SIDE * SIDE];
            values[i] = Vec3::splat(1e6);
            values
        });
        let weight = vec![Vec3::splat(0.5); SIDE * SIDE];
        let kept = surfaces.agreed_around(&[one.clone(), one.clone()], &weight);
        assert!(kept.iter().all(|v| (v.x - 2.0).abs() < 1e-3));
        let alone = surfaces.agreed_around(&[lone(4700), vec![Vec3::ZERO; SIDE * SIDE]], &weight);
        assert!(alone.iter().all(|v| *v == Vec3::ZERO));
        let mixed = surfaces.agreed_around(&[lone(4700), one], &weight);
        assert!(mixed.iter().all(|v| v.x <= 4.0 + 1e-3), "twice what the other found at most");
    }

    /// As a square it would be seen.
    #[test]
    fn what_a_bright_pixel_lacks_is_shown_around_without_an_edge() {
        let surfaces = wall();
        let mut lone = vec![Vec3::ZERO; SIDE * SIDE];
        lone[SIDE * SIDE / 2 + SIDE / 2] = Vec3::ONE;
        let shown = surfaces.agreed_around(&[lone.clone(), lone], &vec![Vec3::ONE; SIDE * SIDE]);
        let most = shown.iter().map(|v| v.x).fold(0.0, f32::max);
        assert!(most > 0.0);
        for i in (0..SIDE * SIDE).filter(|i| i % SIDE > 0) {
            assert!((shown[i].x - shown[i - 1].x).abs() < 0.06 * most, "{i}");
        }
    }

    #[test]
    fn other_surfaces_tell_nothing() {
        let surfaces = of_normals(|x| if x >= SIDE / 2 { Vec3::X } else { Vec3::Z });
        let edge = |x: usize, _| if x < SIDE / 2 { 0.0 } else { 0.2 };
        let smooth = halves(edge, 0.5, 6).mean(&surfaces, &|| true).expect("it goes on");
        let off = root_mean_square(smooth.iter().enumerate().map(|(i, v)| v.x - edge(i % SIDE, 0)));
        assert!(off < 0.05, "{off}");
    }

    #[test]
    fn weights_fade_as_the_exponential() {
        assert_eq!(fading(0.0), 1.0);
        for i in 0..2000 {
            let x = i as f32 * 0.01;
            let (shown, exact) = (fading(x), crate::math::exp(-x));
            assert!((shown / exact - 1.0).abs() < 1e-4, "{x}: {shown} {exact}");
        }
        assert!(fading(f32::INFINITY) < 1e-8 && fading(f32::NAN) < 1e-8);
    }

    #[test]
    fn what_is_asked_to_end_ends() {
        let left = std::cell::Cell::new(0);
        let asks = |n: u32| {
            left.set(n);
            move |left: &std::cell::Cell<u32>| left.replace(left.get().saturating_sub(1)) > 0
        };
        let (surfaces, all) = (wall(), STEPS.len() as u32 * SIDE as u32);
        for n in [0, 1, all - 1] {
            let asked = asks(n);
            assert!(halves(|_, _| 0.3, 0.2, 1).mean(&surfaces, &|| asked(&left)).is_none(), "{n}");
        }
        let asked = asks(all);
        assert!(halves(|_, _| 0.3, 0.2, 1).mean(&surfaces, &|| asked(&left)).is_some());
    }
}
