//! Pictures in batches: how sure the means of blocks are, and whether two pictures differ by more than noise.
//!
//! Samples are dealt out to 16 batches, each of which has a mean of its own for every block. They are independent, so
//! that their spread tells the error of the mean of all, with Student's t of 15 degrees of freedom.

use std::f64::consts::FRAC_2_PI;

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::blocks::{FLOOR, block_means};
use super::quantile;
use crate::image::Map2d;
use crate::math;

/// Number of batches.
pub const BATCHES: usize = 16;
/// Degrees of freedom of one picture's error.
const FREEDOM: f64 = (BATCHES - 1) as f64;

/// Luminances of a picture's blocks in 16 independent batches.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Batches {
    /// Pixels along an edge of a block.
    pub size: usize,
    /// Blocks beside each other; those that the picture's right edge cuts are left out.
    pub columns: usize,
    /// Blocks above each other, likewise.
    pub rows: usize,
    /// Samples per pixel in each batch.
    pub samples: u32,
    /// Mean luminance of each block, row by row, in each batch.
    pub means: Vec<[f64; BATCHES]>,
}

impl Batches {
    /// Of a picture without noise.
    pub fn exact(picture: &Map2d<Vec3>, size: usize) -> Self {
        let mut sums = BatchSums::new(picture.width(), picture.height(), size);
        (0..BATCHES as u64).for_each(|i| sums.add(i, picture));
        let Some(batches) = sums.batches() else { unreachable!("as many in each batch") };
        batches
    }

    /// Whether there are as many means as blocks, all of them numbers.
    pub fn is_whole(&self) -> bool {
        let blocks = self.columns.checked_mul(self.rows);
        self.size > 0
            && blocks == Some(self.means.len())
            && self.means.as_flattened().iter().all(|m| m.is_finite())
    }

    /// Mean and standard error of each block.
    pub fn statistics(&self) -> impl Iterator<Item = (f64, f64)> {
        self.means.iter().map(|batches| {
            let n = BATCHES as f64;
            let mean = batches.iter().sum::<f64>() / n;
            let variance = batches.iter().map(|b| (b - mean) * (b - mean)).sum::<f64>() / (n - 1.0);
            (mean, (variance / n).sqrt())
        })
    }

    /// Mean of the blocks' standard errors, relative as in [`super::block_errors`]. 0 where there are no blocks.
    pub fn relative_error(&self) -> f64 {
        let median = quantile(self.statistics().map(|s| s.0), 0.5);
        let relative = |(mean, error): (f64, f64)| {
            let scale = mean + FLOOR * median;
            if scale > 0.0 { error / scale } else { 0.0 }
        };
        self.statistics().map(relative).sum::<f64>() / self.means.len().max(1) as f64
    }
}

/// Batches on their way.
#[derive(Clone, Debug)]
pub struct BatchSums {
    sums: Batches,
    samples: [u32; BATCHES],
}

impl BatchSums {
    /// For pictures of `width` × `height` pixels.
    pub fn new(width: usize, height: usize, size: usize) -> Self {
        let (columns, rows) = (width / size, height / size);
        let means = vec![[0.0; BATCHES]; columns * rows];
        Self { sums: Batches { size, columns, rows, samples: 0, means }, samples: [0; BATCHES] }
    }

    /// Adds sample `index` of each pixel.
    pub fn add(&mut self, index: u64, sample: &Map2d<Vec3>) {
        let batch = (index % BATCHES as u64) as usize;
        self.samples[batch] += 1;
        for (sum, mean) in self.sums.means.iter_mut().zip(block_means(sample, self.sums.size)) {
            sum[batch] += mean;
        }
    }

    /// The batches; `None` unless all have as many samples, and at least one.
    pub fn batches(&self) -> Option<Batches> {
        let samples = self.samples[0];
        let even = samples > 0 && self.samples.iter().all(|s| *s == samples);
        even.then(|| {
            let means = self.sums.means.iter().map(|sums| sums.map(|s| s / f64::from(samples))).collect();
            Batches { samples, means, ..self.sums.clone() }
        })
    }
}

/// Whether the differences of two pictures' blocks are what their noise explains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Agreement {
    /// Blocks that tell anything: not those that are the same without noise.
    pub blocks: usize,
    /// Mean square of z, the difference over its standard error, relative to that of Student's t: 1 if it is all noise.
    pub mean_square: f64,
    /// Share of blocks with |z| above 3.
    pub over_3: f64,
    /// |mean of z| · √blocks: how many standard errors all blocks together are off.
    pub together: f64,
    /// The largest |z|.
    pub largest: f64,
    /// Probability that noise alone gives one as large among so many (Šidák 1967).
    pub of_largest: f64,
}

impl Agreement {
    /// Of two pictures of one size; `None` where their blocks are others, or where none tells anything.
    pub fn new(a: &Batches, b: &Batches) -> Option<Self> {
        if (a.size, a.columns, a.rows) != (b.size, b.columns, b.rows) {
            return None;
        }
        let (mut blocks, mut square, mut over, mut sum) = (0usize, 0.0, 0usize, 0.0);
        let (mut largest, mut least) = (0.0f64, 1.0f64);
        for ((mean_a, error_a), (mean_b, error_b)) in a.statistics().zip(b.statistics()) {
            let [va, vb] = [error_a * error_a, error_b * error_b];
            let difference = mean_a - mean_b;
            if difference == 0.0 && va + vb == 0.0 {
                continue;
            }
            let z = difference / (va + vb).sqrt();
            // Welch 1947.
            let freedom =
                ((va + vb) * (va + vb) / (va * va + vb * vb) * FREEDOM).clamp(FREEDOM, 2.0 * FREEDOM);
            blocks += 1;
            square += z * z * (freedom - 2.0) / freedom;
            over += usize::from(!(z.abs() <= 3.0));
            sum += z;
            largest = if z.is_finite() { largest.max(z.abs()) } else { f64::INFINITY };
            least = least.min(student_tails(z.abs(), freedom as u32));
        }
        let n = blocks as f64;
        (blocks > 0).then(|| Self {
            blocks,
            mean_square: square / n,
            over_3: over as f64 / n,
            together: (sum / n).abs() * n.sqrt(),
            largest,
            of_largest: 1.0 - math::powf(1.0 - least, n),
        })
    }

    /// Whether nothing but noise is seen. Of few blocks, as much more is let pass as noise needs.
    pub fn holds(&self) -> bool {
        let n = self.blocks as f64;
        // Three standard deviations of the mean of χ² and of a count of rare events.
        let spread = 3.0 * (2.0 / n).sqrt();
        let rare = 0.009 + 3.0 * (0.009 / n).sqrt();
        let square = self.mean_square - 1.0;
        square > -spread.max(0.2)
            && square < spread.max(0.25)
            && self.over_3 < rare.max(0.02)
            && self.together < 4.0
            && self.of_largest > 0.01
    }
}

/// Probability that Student's t with so many degrees of freedom, at least 2, is further from 0 than `t` ≥ 0 (Abramowitz &
/// Stegun, 26.7.3 and 26.7.4).
fn student_tails(t: f64, freedom: u32) -> f64 {
    if !t.is_finite() {
        return 0.0;
    }
    let (sine, cosine) = math::sin_cos(math::atan(t / f64::from(freedom).sqrt()));
    let odd = freedom % 2;
    let (mut term, mut sum) = (if odd == 1 { cosine } else { 1.0 }, 0.0);
    for i in (2 - odd..=freedom - odd).step_by(2).take((freedom / 2) as usize) {
        sum += term;
        let k = f64::from(i + 2 * odd);
        term *= cosine * cosine * (k - 1.0) / k;
    }
    let inside = if odd == 1 { FRAC_2_PI * (math::atan2(sine, cosine) + sine * sum) } else { sine * sum };
    (1.0 - inside).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Stream;

    /// Quantiles of tables.
    #[test]
    fn tails_of_student() {
        for (freedom, t, tails) in [
            (2, 4.303, 0.05),
            (3, 3.182, 0.05),
            (4, 2.776, 0.05),
            (15, 2.131, 0.05),
            (15, 2.947, 0.01),
            (15, 4.073, 0.001),
            (16, 2.120, 0.05),
            (30, 2.750, 0.01),
        ] {
            let p = student_tails(t, freedom);
            assert!((p / tails - 1.0).abs() < 2e-3, "{freedom} {t}: {p}");
        }
        assert_eq!((student_tails(0.0, 15), student_tails(f64::INFINITY, 15)), (1.0, 0.0));
    }

    /// Pixels of exponential noise about `level`.
    fn noisy(level: f32, seed: u64, samples: u64) -> Batches {
        let mut sums = BatchSums::new(128, 128, 8);
        for i in 0..samples {
            let mut s = Stream::new(seed, i, 0);
            let picture = Map2d::from_fn(128, 128, |_, _| {
                Vec3::splat(-level * math::ln((1.0 - s.next_f32()).max(1e-9)))
            });
            sums.add(i, &picture);
        }
        sums.batches().expect("even batches")
    }

    #[test]
    fn noise_agrees_and_a_percent_of_light_does_not() {
        for seed in 0..3 {
            let (a, b) = (noisy(1.0, 2 * seed, 16), noisy(1.0, 2 * seed + 1, 32));
            let agreement = Agreement::new(&a, &b).expect("blocks");
            assert!(agreement.holds() && agreement.blocks == 256, "{agreement:?}");
            assert!((a.relative_error() - 1.0 / 32.0 / 1.05).abs() < 2e-3, "{}", a.relative_error());
            let less = Agreement::new(&noisy(0.99, 2 * seed, 16), &b).expect("blocks");
            assert!(!less.holds(), "{less:?}");
            let exact = Batches::exact(&Map2d::new(128, 128, Vec3::ONE), 8);
            assert!(Agreement::new(&b, &exact).expect("blocks").holds());
        }
    }

    #[test]
    fn one_wrong_block_is_found_and_sizes_must_agree() {
        let (mut a, b) = (noisy(1.0, 8, 16), noisy(1.0, 9, 16));
        for m in &mut a.means[77] {
            *m += 0.4;
        }
        assert!(!Agreement::new(&a, &b).expect("blocks").holds());
        let black = Batches::exact(&Map2d::new(128, 128, Vec3::ZERO), 8);
        assert_eq!(Agreement::new(&black, &black), None);
        let white = Batches::exact(&Map2d::new(128, 128, Vec3::ONE), 8);
        assert!(!Agreement::new(&black, &white).expect("blocks").holds());
        assert_eq!(Agreement::new(&a, &Batches::exact(&Map2d::new(64, 64, Vec3::ONE), 8)), None);
        let mut uneven = BatchSums::new(8, 8, 8);
        uneven.add(0, &Map2d::new(8, 8, Vec3::ONE));
        assert_eq!(uneven.batches(), None);
    }
}
