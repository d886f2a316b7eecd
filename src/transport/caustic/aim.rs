//! Which way lamps send their particles: most would meet nothing but diffuse surfaces, in vain.
//!
//! The square of the two numbers that a lamp's direction is made of is cut into cells. Trials say how many of each cell's
//! directions meet what is wanted; cells get particles by that, but a share of all goes everywhere, so that the decision
//! changes the noise and not the mean.

use rayon::prelude::*;

use crate::rng::Stream;

/// Cells along an edge.
const SIDE: usize = 32;
/// Trials in a cell.
const TRIALS: u32 = 16;
/// Share of the particles that go everywhere.
const EVERYWHERE: f64 = 0.2;
/// What the neighbours of a cell say about it: what is small may have been missed there.
const BESIDE: f64 = 0.25;
/// More lamps than these send their particles everywhere: trials take time.
const LAMPS_MAX: usize = 16;

/// Directions of lamps.
#[derive(Clone, Debug, Default)]
pub struct Aim {
    /// By lamp: shares of the cells, row by row, summed up. Nothing for those that send particles everywhere.
    lamps: Vec<Vec<f64>>,
}

impl Aim {
    /// Tries directions of so many lamps; `meets` says how much one is worth.
    pub fn new(lamps: usize, meets: &(dyn Fn(usize, [f32; 2]) -> f32 + Sync)) -> Self {
        let of_lamp = |lamp: usize| {
            let of_cell = |cell: usize| {
                let mut stream = Stream::new(0xa1, lamp as u64, cell as u64);
                let within = |k: usize, u: f32| (k as f32 + u) / SIDE as f32;
                let mut trial = || {
                    let [u, v] = stream.next_2d();
                    f64::from(meets(lamp, [within(cell % SIDE, u), within(cell / SIDE, v)]))
                };
                (0..TRIALS).map(|_| trial()).sum::<f64>()
            };
            let found: Vec<f64> = (0..SIDE * SIDE).into_par_iter().map(of_cell).collect();
            let around = |cell: usize| {
                let (x, y) = (cell % SIDE, cell / SIDE);
                let rows = y.saturating_sub(1)..(y + 2).min(SIDE);
                let columns = |_| x.saturating_sub(1)..(x + 2).min(SIDE);
                let cells = rows.flat_map(|y| columns(y).map(move |x| y * SIDE + x));
                cells.map(|cell| found[cell]).fold(0.0, f64::max)
            };
            let wanted: Vec<f64> =
                (0..SIDE * SIDE).map(|cell| found[cell].max(BESIDE * around(cell))).collect();
            let total: f64 = wanted.iter().sum();
            if !(total > 0.0) {
                return Vec::new();
            }
            let mut sum = 0.0;
            let share = |w: f64| (1.0 - EVERYWHERE) * w / total + EVERYWHERE / (SIDE * SIDE) as f64;
            wanted
                .into_iter()
                .map(|w| {
                    sum += share(w);
                    sum
                })
                .collect()
        };
        Self { lamps: (0..lamps.min(LAMPS_MAX)).map(of_lamp).collect() }
    }

    /// The numbers for a lamp's direction, made of two uniform ones, and their density.
    pub fn sample(&self, lamp: usize, [u, v]: [f32; 2]) -> ([f32; 2], f64) {
        let cells = self.lamps.get(lamp).map_or(&[][..], |cells| cells);
        let Some(last) = cells.last() else { return ([u, v], 1.0) };
        let at = (f64::from(u) * last).min(last.next_down());
        let cell = cells.partition_point(|sum| *sum <= at);
        let before = if cell > 0 { cells[cell - 1] } else { 0.0 };
        let share = cells[cell] - before;
        let within = |k: usize, u: f64| ((k as f64 + u) / SIDE as f64) as f32;
        let point = [within(cell % SIDE, (at - before) / share), within(cell / SIDE, f64::from(v))];
        (point.map(|x| x.min(1.0f32.next_down())), share * (SIDE * SIDE) as f64 / last)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn most_goes_where_it_is_wanted_and_the_mean_is_kept() {
        // A disk of a hundredth of the square.
        let inside = |[u, v]: [f32; 2]| (u - 0.3).powi(2) + (v - 0.6).powi(2) < 0.01 / std::f32::consts::PI;
        let aim = Aim::new(2, &|lamp, u| f32::from(u8::from(lamp == 0 && inside(u))));
        let n = 100_000u64;
        let (mut hits, mut area, mut all) = (0, 0.0, 0.0);
        for i in 0..n {
            let (u, density) = aim.sample(0, Stream::in_sequence(1, 2, i as u32).next_2d());
            hits += u64::from(inside(u));
            area += if inside(u) { 1.0 / density } else { 0.0 } / n as f64;
            all += 1.0 / density / n as f64;
        }
        assert!(hits > n / 3, "{hits}");
        assert!((area - 0.01).abs() < 2e-4 && (all - 1.0).abs() < 0.01, "{area} {all}");
        // Nothing wanted, or too many lamps: everywhere.
        for lamp in [1, 7] {
            assert_eq!(aim.sample(lamp, [0.3, 0.7]), ([0.3, 0.7], 1.0));
        }
    }
}
