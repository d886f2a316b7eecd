//! Discrete choice by weight, and directions drawn from an environment's radiance.

use std::f64::consts::{PI, TAU};
use std::ops::{Range, RangeInclusive};

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::image::{Map2d, luminance};
use crate::math;
use crate::scene::Environment;

/// Indices chosen in proportion to their weights.
#[derive(Clone, Debug, Default)]
pub struct Choice {
    /// Sums of the weights up to and including each index; not decreasing.
    sums: Vec<f64>,
}

impl Choice {
    /// From weights; what is negative or not finite counts as 0.
    pub fn new(weights: impl IntoIterator<Item = f64>) -> Self {
        let mut sum = 0.0;
        let sums = weights.into_iter().map(|w| {
            sum += if w.is_finite() { w.max(0.0) } else { 0.0 };
            sum
        });
        Self { sums: sums.collect() }
    }

    /// The sum of all weights.
    pub fn total(&self) -> f64 {
        self.sums.last().copied().unwrap_or(0.0)
    }

    /// Sum of the first `n` weights.
    pub fn sum_of_first(&self, n: usize) -> f64 {
        n.checked_sub(1).and_then(|i| self.sums.get(i)).copied().unwrap_or(0.0)
    }

    /// Probability of `index`.
    pub fn probability(&self, index: usize) -> f64 {
        let before = if index == 0 { 0.0 } else { self.sums[index - 1] };
        if self.total() > 0.0 { (self.sums[index] - before) / self.total() } else { 0.0 }
    }

    /// The index for `u` in [0, 1); never one without weight. `None` if there is no weight at all.
    pub fn sample(&self, u: f64) -> Option<usize> {
        let total = self.total();
        if total <= 0.0 {
            return None;
        }
        // Rounding may bring u · total up to the total.
        let x = (u * total).min(total.next_down());
        Some(self.sums.partition_point(|&s| s <= x))
    }
}

/// Most columns of an environment's cells; larger maps share cells, which costs noise but no bias.
const COLUMNS_MAX: usize = 2048;

/// Steps of the shares of a row of which columns are known.
const GUIDES: usize = 64;

/// Directions drawn in proportion to an environment's luminance. Within a cell of the map they are uniform in
/// solid angle.
#[derive(Clone, Debug)]
pub struct EnvironmentDistribution {
    width: usize,
    height: usize,
    /// Per row, the share of the row's weight up to and including each column, in [0, 1].
    columns: Vec<f32>,
    /// Per row the column that each of [`GUIDES`] equal steps of its shares leads to, and the width: a search of the whole row is
    /// slow where the table is larger than a cache.
    guides: Vec<u16>,
    rows: Choice,
    /// Cosine of the upper edge of each row, from straight up, and of the lower edge of the last one.
    cosines: Vec<f64>,
    /// ∫ L dω per band.
    pub integral: Vec3,
}

impl EnvironmentDistribution {
    /// `None` where nothing shines.
    pub fn new(environment: &Environment) -> Option<Self> {
        let one = Map2d::new(1, 1, Vec3::ONE);
        let map = environment.map.as_ref().unwrap_or(&one);
        let (w, h) = (map.width(), map.height());
        if w == 0 || h == 0 {
            return None;
        }
        let (width, height) = (w.min(COLUMNS_MAX), h.min(COLUMNS_MAX / 2));
        let mut weights = vec![0.0f64; width * height];
        // Row by row in parallel; the same sums on any number of threads.
        let integrals: Vec<DVec3> = weights
            .par_chunks_mut(width)
            .enumerate()
            .map(|(row, weights)| {
                let mut integral = DVec3::ZERO;
                for y in touched(row, height, h) {
                    let sum = add_row(map, (y, environment.radiance), weights);
                    // What lies in several rows of cells counts in the first.
                    if y * height / h == row {
                        integral += sum;
                    }
                }
                integral
            })
            .collect();
        let integral: DVec3 = integrals.into_iter().sum();
        let rows = Choice::new(weights.chunks_exact(width).map(|row| row.iter().sum()));
        let integral = integral.as_vec3();
        if rows.total() <= 0.0 || !rows.total().is_finite() || !integral.is_finite() {
            return None;
        }
        let mut columns = vec![0.0f32; weights.len()];
        let mut guides = vec![0u16; height * (GUIDES + 1)];
        columns
            .par_chunks_mut(width)
            .zip(guides.par_chunks_mut(GUIDES + 1))
            .zip(weights.par_chunks(width))
            .for_each(|((columns, guides), weights)| shares(weights, columns, guides));
        let cosines = (0..=height).map(|row| math::cos(PI * row as f64 / height as f64)).collect();
        Some(Self { width, height, columns, guides, rows, cosines, integral })
    }

    /// Columns and rows of cells.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Column and row of a direction.
    pub fn cell(&self, environment: &Environment, direction: Vec3) -> (usize, usize) {
        let [u, v] = environment.position(direction);
        let column = ((u * self.width as f32) as usize).min(self.width - 1);
        let row = ((v * self.height as f32) as usize).min(self.height - 1);
        (column, row)
    }

    /// Density per solid angle of a direction.
    pub fn pdf(&self, environment: &Environment, direction: Vec3) -> f32 {
        let (column, row) = self.cell(environment, direction);
        self.density(column, row) as f32
    }

    /// Density per solid angle in a cell.
    pub fn density(&self, column: usize, row: usize) -> f64 {
        self.weight(row, column..column + 1) * self.width as f64 / self.row_solid_angle(row)
    }

    /// Probability of some columns of a row.
    pub fn weight(&self, row: usize, columns: Range<usize>) -> f64 {
        let shares = &self.columns[row * self.width..][..self.width];
        let before = if columns.start == 0 { 0.0 } else { shares[columns.start - 1] };
        self.rows.probability(row) * f64::from(shares[columns.end - 1] - before)
    }

    /// Solid angle of a rectangle of cells, and whether it is wider than high.
    pub fn extent(&self, columns: &Range<usize>, rows: &Range<usize>) -> (f64, bool) {
        let share = columns.len() as f64 / self.width as f64;
        let solid_angle = TAU * share * (self.cosines[rows.start] - self.cosines[rows.end]);
        let high = PI * rows.len() as f64 / self.height as f64;
        // In both directions at least one cell is left.
        let wide = solid_angle > high * high || rows.len() == 1;
        (solid_angle, wide && columns.len() > 1)
    }

    fn row_solid_angle(&self, row: usize) -> f64 {
        TAU * (self.cosines[row] - self.cosines[row + 1])
    }

    /// A direction and its density per solid angle.
    pub fn sample(&self, environment: &Environment, u: [f32; 2]) -> Option<(Vec3, f32)> {
        let x = f64::from(u[1]);
        let row = self.rows.sample(x)?;
        // What is left of the number places the direction within its row, and so for the column.
        let share = self.rows.probability(row);
        let before = (0..row).next_back().map_or(0.0, |r| self.rows.sums[r] / self.rows.total());
        let v = ((x - before) / share).clamp(0.0, 1.0);
        let (wi, column) = self.sample_row(environment, row, 0..self.width, [f64::from(u[0]), v])?;
        Some((wi, self.density(column, row) as f32))
    }

    /// A direction in some columns of a row, and its column, as [`Self::sample`] draws them.
    pub fn sample_row(
        &self,
        environment: &Environment,
        row: usize,
        columns: Range<usize>,
        [u, v]: [f64; 2],
    ) -> Option<(Vec3, usize)> {
        let shares = &self.columns[row * self.width..][..columns.end];
        let first = if columns.start == 0 { 0.0 } else { shares[columns.start - 1] };
        let last = shares[columns.end - 1];
        let x = (first + u as f32 * (last - first)).min(last.next_down());
        // Steps are powers of two, so that none of the shares between is missed.
        let step = ((x * GUIDES as f32) as usize).min(GUIDES - 1);
        let guides = &self.guides[row * (GUIDES + 1) + step..][..2];
        let [low, high] = [guides[0], guides[1]].map(|column| usize::from(column).min(columns.end));
        let column = low + shares[low..high].partition_point(|&s| s <= x);
        let before = if column == 0 { 0.0 } else { shares[column - 1] };
        let u = ((x - before) / (shares[column] - before)).clamp(0.0, 1.0);
        let (top, bottom) = (self.cosines[row], self.cosines[row + 1]);
        let theta = math::acos((top + (bottom - top) * v).clamp(-1.0, 1.0));
        let position = [(column as f32 + u) / self.width as f32, (theta / PI) as f32];
        (self.density(column, row) > 0.0).then(|| (environment.direction(position), column))
    }
}

/// The shares of columns of these weights, and where steps of them lead.
fn shares(weights: &[f64], columns: &mut [f32], guides: &mut [u16]) {
    let total: f64 = weights.iter().sum();
    let mut sum = 0.0;
    for (column, weight) in columns.iter_mut().zip(weights) {
        sum += weight;
        *column = if total > 0.0 { (sum / total) as f32 } else { 0.0 };
    }
    let mut column = 0;
    for (step, guide) in guides.iter_mut().enumerate() {
        let x = step as f32 / GUIDES as f32;
        while columns.get(column).is_some_and(|&share| share <= x) {
            column += 1;
        }
        *guide = column as u16;
    }
}

/// Which of `count` equal parts of a length the one of number `i` among `parts` touches.
fn touched(i: usize, parts: usize, count: usize) -> RangeInclusive<usize> {
    i * count / parts..=((i + 1) * count).div_ceil(parts) - 1
}

/// Adds the weights of row `y` of a map to cells, to every one that a texel touches, so that none that shines is without; and
/// says what the row radiates, ∫ L dω.
fn add_row(map: &Map2d<Vec3>, (y, scale): (usize, Vec3), cells: &mut [f64]) -> DVec3 {
    let (w, width) = (map.width(), cells.len());
    let solid_angle = row_solid_angle(y, map.height()) / w as f64;
    let mut integral = DVec3::ZERO;
    for x in 0..w {
        let mean = interpolated_mean(map, x, y) * scale;
        integral += mean.as_dvec3() * solid_angle;
        let weight = f64::from(luminance(mean)) * solid_angle;
        let weight = if weight.is_finite() { weight.max(0.0) } else { 0.0 };
        if width == w {
            cells[x] += weight;
        } else {
            cells[touched(x, w, width)].iter_mut().for_each(|cell| *cell += weight);
        }
    }
    integral
}

/// Solid angle of a row of `height`.
fn row_solid_angle(row: usize, height: usize) -> f64 {
    let cosine = |row: usize| math::cos(PI * row as f64 / height as f64);
    TAU * (cosine(row) - cosine(row + 1))
}

/// Mean over a texel of the bilinear interpolant that `Environment::radiance` reads: positive wherever that is.
fn interpolated_mean(map: &Map2d<Vec3>, x: usize, y: usize) -> Vec3 {
    let (w, h) = (map.width(), map.height());
    let left = if x == 0 { w - 1 } else { x - 1 };
    let right = if x + 1 == w { 0 } else { x + 1 };
    let row = |y: usize| (map.at(left, y) + map.at(right, y)) * 0.125 + map.at(x, y) * 0.75;
    (row(y.saturating_sub(1)) + row((y + 1).min(h - 1))) * 0.125 + row(y) * 0.75
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Stream;

    fn spotted() -> Environment {
        let map = Map2d::from_fn(16, 8, |x, y| match (x, y) {
            (3, 2) => Vec3::new(50.0, 40.0, 30.0),
            _ if y > 4 => Vec3::ZERO,
            _ => Vec3::splat(0.1),
        });
        Environment { radiance: Vec3::new(1.0, 2.0, 1.0), map: Some(map), rotate_up: 0.4, up: Vec3::Z }
    }

    #[test]
    fn the_density_integrates_to_one() {
        for environment in [spotted(), Environment::constant(Vec3::X)] {
            let d = EnvironmentDistribution::new(&environment).unwrap();
            let mut sum = 0.0;
            for row in 0..d.height {
                for column in 0..d.width {
                    sum += d.density(column, row) * row_solid_angle(row, d.height) / d.width as f64;
                }
            }
            assert!((sum - 1.0).abs() < 1e-5, "{sum}");
        }
    }

    #[test]
    fn samples_estimate_the_integral_and_know_their_density() {
        for environment in [spotted(), Environment::constant(Vec3::new(1.0, 0.5, 0.0))] {
            let d = EnvironmentDistribution::new(&environment).unwrap();
            let n = 40_000;
            let (mut sum, mut square) = (0.0, 0.0);
            for i in 0..n {
                let (w, pdf) = d.sample(&environment, Stream::new(5, i, 0).next_2d()).unwrap();
                assert!((w.length() - 1.0).abs() < 1e-5);
                let again = d.pdf(&environment, w);
                // Directions on the border of two cells may round into the other one.
                if i % 16 == 0 && (again - pdf).abs() > 1e-3 * pdf {
                    let p = environment.position(w);
                    let edge = |x: f32| (x - x.round()).abs();
                    assert!(edge(p[0] * 16.0).min(edge(p[1] * 8.0)) < 1e-3, "{pdf} {again}");
                }
                let l = f64::from(luminance(environment.radiance(w)) / pdf);
                sum += l / n as f64;
                square += l * l / n as f64;
            }
            let error = ((square - sum * sum).max(0.0) / n as f64).sqrt();
            let expected = f64::from(luminance(d.integral));
            // The interpolant's rows are not weighted quite like texels: up to a percent at 8 rows.
            assert!((sum - expected).abs() < 4.0 * error + 0.01 * expected, "{sum} ± {error}, {expected}");
        }
        let d = EnvironmentDistribution::new(&Environment::constant(Vec3::ONE)).unwrap();
        assert!((d.integral.x - 4.0 * std::f32::consts::PI).abs() < 1e-5);
    }

    /// A map of which some texels lie in two columns or rows of cells: each that shines reaches all of its cells, no light is
    /// counted twice, and threads do not matter.
    #[test]
    fn maps_larger_than_the_cells_lose_nothing() {
        let lit = |x: usize, y: usize| x % 97 == 5 && y % 31 == 3;
        let (w, h) = (COLUMNS_MAX + 307, COLUMNS_MAX / 2 + 211);
        let map = Map2d::from_fn(w, h, |x, y| if lit(x, y) { Vec3::splat(5.0) } else { Vec3::ZERO });
        let environment = Environment { map: Some(map), ..Environment::constant(Vec3::ONE) };
        let d = EnvironmentDistribution::new(&environment).expect("something shines");
        assert_eq!(d.size(), (COLUMNS_MAX, COLUMNS_MAX / 2));
        let mut integral = 0.0;
        let map = environment.map.as_ref().expect("a map");
        for y in 0..h {
            integral += (0..w).map(|x| f64::from(interpolated_mean(map, x, y).x)).sum::<f64>()
                * row_solid_angle(y, h)
                / w as f64;
            for x in (0..w).filter(|x| lit(*x, y)) {
                let columns = touched(x, w, COLUMNS_MAX);
                for row in touched(y, h, COLUMNS_MAX / 2) {
                    assert!(columns.clone().all(|column| d.density(column, row) > 0.0), "{x} {y}");
                }
            }
        }
        assert!((f64::from(d.integral.x) / integral - 1.0).abs() < 1e-6, "{} {integral}", d.integral);
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
        let alone = one.install(|| EnvironmentDistribution::new(&environment)).expect("something shines");
        assert!(alone.columns == d.columns && alone.rows.sums == d.rows.sums && alone.integral == d.integral);
    }

    /// Columns are found as a search of all of them finds them, in whole rows and in parts: with few and with most of the light in
    /// one place, and at the ends of all steps.
    #[test]
    fn guides_lead_to_the_column_that_a_search_finds() {
        for exponent in [0, 1, 8, 60] {
            let map = Map2d::from_fn(300, 4, |x, y| {
                let u = Stream::new(6, (300 * y + x) as u64, 0).next_f32();
                Vec3::splat(if u < 0.1 { 0.0 } else { u.powi(exponent) })
            });
            let environment = Environment { map: Some(map), ..Environment::constant(Vec3::ONE) };
            let d = EnvironmentDistribution::new(&environment).expect("something shines");
            for i in 0..4000u64 {
                let mut s = Stream::new(7, i, 0);
                let row = i as usize % 4;
                let ends = [s.next_f32(), s.next_f32()].map(|u| (u * 300.0) as usize);
                let columns =
                    if i % 3 == 0 { 0..300 } else { ends[0].min(ends[1])..ends[0].max(ends[1]) + 1 };
                let u = if i % 2 == 0 { s.next_f32() } else { (i % 64) as f32 / 64.0 };
                let shares = &d.columns[row * 300..][..300];
                let first = if columns.start == 0 { 0.0 } else { shares[columns.start - 1] };
                let last = shares[columns.end - 1];
                let x = (first + u * (last - first)).min(last.next_down());
                let searched = shares[..columns.end].partition_point(|&s| s <= x);
                let found = d.sample_row(&environment, row, columns.clone(), [f64::from(u), 0.5]);
                assert_eq!(found.map_or(searched, |(_, column)| column), searched, "{row} {columns:?} {u}");
                assert!(found.is_some() || d.density(searched, row) == 0.0);
            }
        }
    }

    #[test]
    fn darkness_has_no_distribution() {
        assert!(EnvironmentDistribution::new(&Environment::constant(Vec3::ZERO)).is_none());
        let nan = Environment::constant(Vec3::NAN);
        assert!(EnvironmentDistribution::new(&nan).is_none());
    }

    #[test]
    fn a_choice_follows_its_weights() {
        let c = Choice::new([0.0, 1.0, 0.0, f64::NAN, 3.0, -2.0]);
        assert_eq!(c.total(), 4.0);
        assert_eq!([0, 1, 2, 3, 4, 5].map(|i| c.probability(i)), [0.0, 0.25, 0.0, 0.0, 0.75, 0.0]);
        assert_eq!([0.0, 0.2499, 0.25, 0.999_999_9, 1.0].map(|u| c.sample(u)), [1, 1, 4, 4, 4].map(Some));
        assert_eq!(Choice::new([0.0, 0.0]).sample(0.5), None);
        assert_eq!(Choice::new([]).sample(0.5), None);
    }
}
