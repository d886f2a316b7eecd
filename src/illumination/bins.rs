//! What particles left behind, summed per element and side in fixed point: the same bits come out
//! for any number of threads and any order of arrival (REFERENCE §6.5).

use std::sync::atomic::{AtomicI64, AtomicU32, Ordering};

use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::image::luminance;

/// Steps per unit of flux relative to the power of the scene.
const FLUX_STEPS: f64 = (1u64 << 24) as f64;
/// Steps per unit of squared relative flux: in a room of a large house particles carry little.
const SQUARE_STEPS: f64 = (1u64 << 34) as f64;
/// A particle may carry this many times the power of the scene. (2¹⁰)² · 2³⁴ steps leave room for 2⁹ of the heaviest
/// particles in one bin, which are rare.
const RELATIVE_FLUX_MAX: f64 = 1024.0;

#[derive(Debug, Default)]
struct Bin {
    flux: [AtomicI64; 3],
    square: AtomicI64,
    count: AtomicU32,
}

/// The sums of one bin in steps, for saving.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct BinState {
    /// Flux per band.
    pub flux: [i64; 3],
    /// Squared luminance of the flux.
    pub square: i64,
    /// Particles.
    pub count: u32,
}

/// Sums of one bin.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Arrived {
    /// Sum of the particles' flux per band, W times the number of emitted particles.
    pub flux: Vec3,
    /// Sum of their squared luminance.
    pub square: f32,
    /// How many they are.
    pub count: f32,
    /// Area on which they could arrive.
    pub area: f32,
}

/// One bin for the front and one for the back of every element.
#[derive(Debug, Default)]
pub struct Bins {
    power: f64,
    bins: Vec<Bin>,
}

impl Bins {
    /// Empty bins for `elements` elements in a scene whose lights have `power` W in their strongest band.
    pub fn new(elements: usize, power: f32) -> Self {
        let power = if power > 0.0 && power.is_finite() { f64::from(power) } else { 1.0 };
        Self { power, bins: (0..2 * elements).into_par_iter().map(|_| Bin::default()).collect() }
    }

    /// Counts a particle of `flux` (as if it were the only one emitted).
    pub fn add(&self, element: u32, back: bool, flux: Vec3) {
        let bin = &self.bins[2 * element as usize + usize::from(back)];
        let relative = flux.to_array().map(|f| (f64::from(f) / self.power).clamp(0.0, RELATIVE_FLUX_MAX));
        for (sum, r) in bin.flux.iter().zip(relative) {
            sum.fetch_add((r * FLUX_STEPS).round() as i64, Ordering::Relaxed);
        }
        let y = (f64::from(luminance(flux)) / self.power).clamp(0.0, RELATIVE_FLUX_MAX);
        bin.square.fetch_add((y * y * SQUARE_STEPS).round() as i64, Ordering::Relaxed);
        bin.count.fetch_add(1, Ordering::Relaxed);
    }

    /// The sums of one bin.
    pub fn arrived(&self, element: u32, back: bool) -> Arrived {
        let bin = &self.bins[2 * element as usize + usize::from(back)];
        let flux = [0, 1, 2]
            .map(|i| (bin.flux[i].load(Ordering::Relaxed) as f64 * (self.power / FLUX_STEPS)) as f32);
        let square = bin.square.load(Ordering::Relaxed) as f64 * (self.power * self.power / SQUARE_STEPS);
        Arrived {
            flux: Vec3::from_array(flux),
            square: square as f32,
            count: bin.count.load(Ordering::Relaxed) as f32,
            area: 0.0,
        }
    }

    /// Particles counted in all bins.
    pub fn total_count(&self) -> u64 {
        self.bins.iter().map(|b| u64::from(b.count.load(Ordering::Relaxed))).sum()
    }

    /// All sums, for a bake that will be continued.
    pub fn state(&self) -> Vec<BinState> {
        let state = |b: &Bin| BinState {
            flux: [0, 1, 2].map(|i| b.flux[i].load(Ordering::Relaxed)),
            square: b.square.load(Ordering::Relaxed),
            count: b.count.load(Ordering::Relaxed),
        };
        self.bins.par_iter().map(state).collect()
    }

    /// Takes up saved sums. `false`, and nothing changed, if they are of another number of elements.
    pub fn restore(&mut self, state: &[BinState]) -> bool {
        if state.len() != self.bins.len() {
            return false;
        }
        for (bin, s) in self.bins.iter_mut().zip(state) {
            bin.flux = s.flux.map(AtomicI64::new);
            bin.square = AtomicI64::new(s.square);
            bin.count = AtomicU32::new(s.count);
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math;

    #[test]
    fn sums_have_the_same_bits_in_any_order_and_come_back_from_their_state() {
        let flux = |i: u32| Vec3::new(0.1 + math::sin(i as f32).abs(), 0.3, 1e-3 * i as f32);
        let forward = Bins::new(3, 2.0);
        let backward = Bins::new(3, 2.0);
        for i in 0..1000 {
            forward.add(i % 3, i % 2 == 0, flux(i));
            backward.add((999 - i) % 3, (999 - i) % 2 == 0, flux(999 - i));
        }
        assert_eq!(forward.state(), backward.state());
        let mut again = Bins::new(3, 2.0);
        assert!(again.restore(&forward.state()));
        assert_eq!(again.state(), forward.state());
        assert!(!again.restore(&forward.state()[1..]));
        let exact: f32 = (0..1000).filter(|i| i % 6 == 0).map(|i| flux(i).x).sum();
        assert!((forward.arrived(0, true).flux.x / exact - 1.0).abs() < 1e-5);
    }

    #[test]
    fn impossible_flux_is_bounded() {
        let bins = Bins::new(1, 1.0);
        for f in [f32::NAN, f32::INFINITY, -1.0, 1e30] {
            bins.add(0, false, Vec3::splat(f));
        }
        assert!(bins.arrived(0, false).flux.is_finite());
    }
}
