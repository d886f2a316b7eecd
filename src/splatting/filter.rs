//! A filter whose halves guard each other: what two independent halves of the samples do not both show is noise.
//!
//! À-trous wavelets with a 5×5 binomial kernel on six levels (Dammertz et al. 2010; Schied et al. 2017), over pixels of one
//! surface. The weight of a tap in one half comes from the values of the other (as between the halves of Bitterli et al.
//! 2016): what is noise in both would be kept by weights of its own. Then what is left is scaled by the share that both
//! halves agree on, ⟨f_P f_Q⟩ / ⟨((f_P + f_Q) / 2)²⟩, which noise does not raise. As variances fall, taps of other values
//! lose their weights and the share becomes 1: in the limit nothing is changed, and there is no strength to tune.

use glam::Vec3;

use crate::display::FrameBuffers;
use crate::display::twin::{primary_interaction, primary_ray};
use crate::image::luminance;
use crate::math;
use crate::scene::camera::CameraFrame;
use crate::world::World;

/// Distances between taps, pixels.
const STEPS: [usize; 6] = [1, 2, 4, 8, 16, 32];
/// Binomial weights.
const KERNEL: [f32; 5] = [1.0 / 16.0, 4.0 / 16.0, 6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0];
/// Pixels to each side that a variance is pooled over.
const POOLED: usize = 3;
/// Pixels to each side over which halves must agree.
const AGREED: usize = 24;
/// Cosine of the normals of one surface, at least.
const FLAT: f32 = 0.9;
/// Distance of a tap from the tangent plane, pixel widths, at most.
const BESIDE: f32 = 2.0;
/// Exponents from which on a weight is nothing.
const NOTHING: f32 = 20.0;

/// What a pixel shows of the geometry.
#[derive(Clone, Copy, Debug)]
struct Surface {
    object: u32,
    normal: Vec3,
    position: Vec3,
    /// Of the pixel there, scene units.
    width: f32,
}

/// The surfaces of a view, pixel by pixel.
#[derive(Clone, Debug)]
pub struct Surfaces {
    width: usize,
    height: usize,
    at: Vec<Option<Surface>>,
}

impl Surfaces {
    /// Of a drawn view.
    pub fn of_view(world: &World, frame: &CameraFrame, buffers: &FrameBuffers) -> Self {
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
        Self { width, height, at: (0..width * height).map(surface).collect() }
    }

    /// Whether what one pixel shows may tell of another one.
    fn are_one(a: &Surface, b: &Surface) -> bool {
        let off = (b.position - a.position).dot(a.normal).abs();
        a.object == b.object && a.normal.dot(b.normal) > FLAT && off < BESIDE * a.width.max(b.width)
    }

    /// What both of two positive estimates show of the mean of a quantity around each pixel, by `weight`: about the harmonic
    /// mean of theirs, so that what only one of them found counts little.
    pub fn agreed_around(&self, halves: &[Vec<Vec3>; 2], weight: &[Vec3]) -> Vec<Vec3> {
        let bands = [0, 1, 2].map(|band| {
            let sums = |values: &[Vec3]| self.sums_around(AGREED, |i| f64::from(values[i][band]));
            let (weight, [p, q]) = (sums(weight), halves.each_ref().map(|half| sums(half)));
            let agreed = |i: usize| {
                let (p, q) = (p[i].max(0.0), q[i].max(0.0));
                if weight[i] > 0.0 && p + q > 0.0 { (2.0 * p * q / (p + q) / weight[i]) as f32 } else { 0.0 }
            };
            (0..p.len()).map(agreed).collect::<Vec<f32>>()
        });
        (0..weight.len()).map(|i| Vec3::new(bands[0][i], bands[1][i], bands[2][i])).collect()
    }

    /// Sums of `value` over the squares of `radius` around all pixels.
    fn sums_around(&self, radius: usize, value: impl Fn(usize) -> f64) -> Vec<f64> {
        let (w, h) = (self.width, self.height);
        let mut table = vec![0.0; (w + 1) * (h + 1)];
        for y in 0..h {
            let mut row = 0.0;
            for x in 0..w {
                row += value(y * w + x);
                table[(y + 1) * (w + 1) + x + 1] = table[y * (w + 1) + x + 1] + row;
            }
        }
        let around = |i: usize| {
            let (x, y) = (i % w, i / w);
            let (x0, y0) = (x.saturating_sub(radius), y.saturating_sub(radius));
            let (x1, y1) = ((x + radius + 1).min(w), (y + radius + 1).min(h));
            let at = |x: usize, y: usize| table[y * (w + 1) + x];
            at(x1, y1) - at(x0, y1) - at(x1, y0) + at(x0, y0)
        };
        (0..w * h).map(around).collect()
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
    /// Each half smoothed under the guard of the other.
    fn smoothed(mut self, surfaces: &Surfaces) -> Self {
        let counted = surfaces.sums_around(POOLED, |i| f64::from(u8::from(self.known[i])));
        for variances in &mut self.variances {
            let sums = surfaces.sums_around(POOLED, |i| f64::from(variances[i]));
            *variances = sums.iter().zip(&counted).map(|(s, n)| (s / n.max(1.0)).max(0.0) as f32).collect();
        }
        for step in STEPS {
            self = self.smoothed_by(surfaces, step);
        }
        self
    }

    fn smoothed_by(&self, surfaces: &Surfaces, step: usize) -> Self {
        let (w, h) = (surfaces.width, surfaces.height);
        let brightness =
            self.values.each_ref().map(|v| v.iter().map(|c| luminance(*c)).collect::<Vec<f32>>());
        let mut next = self.clone();
        for i in 0..w * h {
            let (Some(here), true) = (&surfaces.at[i], self.known[i]) else { continue };
            let mut sums = [(Vec3::ZERO, 0.0f32, 0.0f32); 2];
            let (x, y) = (i % w, i / w);
            for (dy, ky) in KERNEL.iter().enumerate() {
                let Some(y) = (y + dy * step).checked_sub(2 * step).filter(|y| *y < h) else { continue };
                for (dx, kx) in KERNEL.iter().enumerate() {
                    let Some(x) = (x + dx * step).checked_sub(2 * step).filter(|x| *x < w) else { continue };
                    let j = y * w + x;
                    let Some(there) = surfaces.at[j].as_ref().filter(|_| self.known[j]) else { continue };
                    if j != i && !Surfaces::are_one(here, there) {
                        continue;
                    }
                    for (half, (value, total, variance)) in sums.iter_mut().enumerate() {
                        let guard = 1 - half;
                        let squared = (brightness[guard][j] - brightness[guard][i]).powi(2);
                        let noise = self.variances[guard][j] + self.variances[guard][i];
                        let beyond = (squared - noise).max(0.0);
                        // Most taps differ by no more than noise does.
                        let likeness = match beyond / noise {
                            _ if beyond <= 0.0 => 1.0,
                            exponent if exponent < NOTHING => math::exp(-exponent),
                            // Also where there is no noise.
                            _ => continue,
                        };
                        let weight = kx * ky * likeness;
                        *value += self.values[half][j] * weight;
                        *total += weight;
                        *variance += self.variances[half][j] * weight * weight;
                    }
                }
            }
            for (half, (value, total, variance)) in sums.into_iter().enumerate() {
                if total > 0.0 {
                    next.values[half][i] = value / total;
                    next.variances[half][i] = variance / (total * total);
                }
            }
        }
        next
    }

    /// What both halves show: their mean, smoothed, as far as they agree.
    pub fn reconstructed(self, surfaces: &Surfaces) -> Vec<Vec3> {
        let smooth = self.smoothed(surfaces);
        let [p, q] = &smooth.values;
        let both = |i: usize| [p[i], q[i]].map(|v| f64::from(luminance(v)));
        let agreed = surfaces.sums_around(AGREED, |i| both(i)[0] * both(i)[1]);
        let all = surfaces.sums_around(AGREED, |i| (0.5 * (both(i)[0] + both(i)[1])).powi(2));
        let share = |i: usize| if all[i] > 0.0 { (agreed[i] / all[i]).clamp(0.0, 1.0) as f32 } else { 0.0 };
        (0..p.len()).map(|i| (p[i] + q[i]) * (0.5 * share(i))).collect()
    }

    /// The mean of both halves, smoothed.
    pub fn mean(self, surfaces: &Surfaces) -> Vec<Vec3> {
        let [p, q] = self.smoothed(surfaces).values;
        p.into_iter().zip(q).map(|(p, q)| (p + q) * 0.5).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Stream;

    const SIDE: usize = 96;

    /// A wall that fills the picture.
    fn wall() -> Surfaces {
        let at = |i: usize| {
            let position = Vec3::new((i % SIDE) as f32, (i / SIDE) as f32, 0.0);
            Some(Surface { object: 0, normal: Vec3::Z, position, width: 1.0 })
        };
        Surfaces { width: SIDE, height: SIDE, at: (0..SIDE * SIDE).map(at).collect() }
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
        let kept = halves(|_, _| 0.3, 0.2, 1).reconstructed(&wall());
        let off = root_mean_square(kept.iter().map(|v| v.x - 0.3));
        assert!(off < 0.01, "{off}");
    }

    #[test]
    fn of_pure_noise_at_most_a_tenth_is_left() {
        let left = root_mean_square(halves(|_, _| 0.0, 1.0, 2).reconstructed(&wall()).iter().map(|v| v.x));
        // Of the mean of both halves.
        assert!(left < 0.1 / 2f32.sqrt(), "{left}");
    }

    #[test]
    fn without_variance_nothing_changes() {
        let ramp = |x: usize, y: usize| 0.01 * x as f32 + if y > 40 { 1.0 } else { 0.0 };
        let exact = halves(ramp, 0.0, 3).reconstructed(&wall());
        assert!(exact.iter().enumerate().all(|(i, v)| (v.x - ramp(i % SIDE, i / SIDE)).abs() < 1e-5));
    }

    #[test]
    fn an_edge_that_samples_show_stays() {
        let edge = |x: usize, _| if x < SIDE / 2 { 0.0 } else { 1.0 };
        let shown = halves(edge, 0.1, 4).reconstructed(&wall());
        let off = root_mean_square(shown.iter().enumerate().map(|(i, v)| v.x - edge(i % SIDE, 0)));
        assert!(off < 0.04, "{off}");
    }

    #[test]
    fn halves_that_are_exchanged_give_the_same_bits() {
        let signal = |x: usize, y: usize| ((x / 16 + y / 16) % 2) as f32;
        let some = halves(signal, 0.5, 5);
        let Halves { values: [p, q], variances: [v, w], known } = some.clone();
        let other = Halves { values: [q, p], variances: [w, v], known };
        assert_eq!(some.reconstructed(&wall()), other.reconstructed(&wall()));
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

    #[test]
    fn other_surfaces_tell_nothing() {
        let mut surfaces = wall();
        for (i, surface) in surfaces.at.iter_mut().enumerate() {
            if i % SIDE >= SIDE / 2 {
                surface.iter_mut().for_each(|s| s.normal = Vec3::X);
            }
        }
        let edge = |x: usize, _| if x < SIDE / 2 { 0.0 } else { 0.2 };
        let smooth = halves(edge, 0.5, 6).mean(&surfaces);
        let off = root_mean_square(smooth.iter().enumerate().map(|(i, v)| v.x - edge(i % SIDE, 0)));
        assert!(off < 0.05, "{off}");
    }
}
