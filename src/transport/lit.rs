//! Where distant light falls on mirrors, glass and gloss: particles that carry the light of the sky and of suns begin
//! on these surfaces, instead of somewhere outside, from where most of them would miss what matters. Those that begin
//! with a diffuse reflection need no samples of their own: what falls there is gathered by the bake.
//!
//! The surfaces are cut into pieces of equal area. A few samples of the light on each decide how many particles
//! begin there; what they carry is what a fresh sample finds, so that the decision changes the noise and not the mean.
//! Lights inside of the scene emit as ever (REFERENCE §6.1): near a lamp irradiance has no bound.

use rayon::prelude::*;

use crate::rng::{Stream, hash};

/// Share of the mean that every piece gets at least, on the sides that any light was found on.
const FLOOR: f64 = 0.1;
/// Pieces on each side whose samples are averaged: one sample sees the light or does not.
const SMOOTHED: usize = 6;

/// A place to begin at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// Triangle.
    pub triangle: u32,
    /// Barycentric coordinate at its second corner.
    pub b1: f32,
    /// Barycentric coordinate at its third corner.
    pub b2: f32,
    /// Whether the light falls on its back.
    pub back: bool,
    /// Expected number of starts per area, for one start.
    pub density: f64,
}

/// Where particles begin.
#[derive(Clone, Debug, Default)]
pub struct LitSurfaces {
    /// Areas of triangles, summed up.
    areas: Vec<f64>,
    /// Share of the particles, summed up: of the fronts of all pieces, then of their backs.
    shares: Vec<f64>,
    /// What depends on particles that begin here, W: the power of near lights, and what the surfaces receive from distant lights,
    /// as far as they count.
    begins: f64,
    /// Share of particles that the lights inside of the scene emit.
    near_share: f64,
}

impl LitSurfaces {
    /// Cuts triangles of these `areas` (0 for those that no particle shall begin on) into `pieces`. `irradiance` is a
    /// sample of the luminance of distant light on the side of a point, `weight` what a triangle counts, `near` the power
    /// of all other lights.
    pub fn new(
        areas: impl Iterator<Item = f32>,
        pieces: usize,
        seed: u64,
        near: f64,
        weight: &(dyn Fn(u32) -> f64 + Sync),
        irradiance: &(dyn Fn(&Start, &mut Stream) -> f32 + Sync),
    ) -> Self {
        let mut sum = 0.0;
        let areas: Vec<f64> = areas
            .map(|a| {
                sum += f64::from(if a.is_finite() { a.max(0.0) } else { 0.0 });
                sum
            })
            .collect();
        let mut lit = Self { areas, shares: Vec::new(), begins: near, near_share: 1.0 };
        if sum <= 0.0 || pieces == 0 {
            return lit;
        }
        let found: Vec<[(f64, f64); 2]> = (0..pieces)
            .into_par_iter()
            .map(|k| {
                [false, true].map(|back| {
                    let mut stream = Stream::new(hash(seed, 0x11f, u64::from(back)), k as u64, 0);
                    let start = lit.place(k, pieces, back, [stream.next_f32(), stream.next_f32()]);
                    let e = f64::from(irradiance(&start, &mut stream));
                    (if e.is_finite() { e.max(0.0) } else { 0.0 }, weight(start.triangle))
                })
            })
            .collect();
        let received = found.iter().flatten().map(|f| f.0 * f.1).sum::<f64>() * (sum / pieces as f64);
        if !(received > 0.0 && received.is_finite()) {
            return lit;
        }
        lit.begins += received;
        let mut total = 0.0;
        for side in [0, 1] {
            let mean = found.iter().map(|f| f[side].0).sum::<f64>() / pieces as f64;
            for k in 0..pieces {
                let around = k.saturating_sub(SMOOTHED)..(k + SMOOTHED + 1).min(pieces);
                let n = around.len() as f64;
                let smooth = found[around].iter().map(|f| f[side].0).sum::<f64>() / n;
                total += (smooth + FLOOR * mean) * found[k][side].1;
                lit.shares.push(total);
            }
        }
        for share in &mut lit.shares {
            *share /= total;
        }
        lit.near_share = if near > 0.0 { (near / lit.begins).clamp(0.1, 0.9) } else { 0.0 };
        lit
    }

    /// What depends on particles that begin here or at lights inside of the scene, luminance, W.
    pub fn begins(&self) -> f64 {
        self.begins
    }

    /// Share of particles that lights inside of the scene emit: all, where no distant light was found.
    pub fn near_share(&self) -> f64 {
        self.near_share
    }

    /// The place for a number in [0, 1) that chooses the piece and two that choose the point on it.
    pub fn start(&self, choice: f64, u: [f32; 2]) -> Option<Start> {
        let pieces = self.shares.len() / 2;
        let last = self.shares.last()?;
        let i = self.shares.partition_point(|&s| s <= choice.min(last.next_down()));
        let share = self.shares[i] - if i > 0 { self.shares[i - 1] } else { 0.0 };
        let start = self.place(i % pieces, pieces, i >= pieces, u);
        let density = share * pieces as f64 / self.areas.last()?;
        (density > 0.0).then_some(Start { density, ..start })
    }

    /// A point of piece `k`. Pieces are strips of triangles, or several of them.
    fn place(&self, k: usize, pieces: usize, back: bool, [u, v]: [f32; 2]) -> Start {
        let total = self.areas.last().copied().unwrap_or(0.0);
        let x = ((k as f64 + f64::from(u)) / pieces as f64 * total).min(total.next_down());
        let t = self.areas.partition_point(|&a| a <= x).min(self.areas.len().saturating_sub(1));
        let before = if t > 0 { self.areas[t - 1] } else { 0.0 };
        let area = self.areas[t] - before;
        let along = if area > 0.0 { ((x - before) / area).clamp(0.0, 1.0) } else { 0.0 };
        let s = along.sqrt() as f32;
        Start { triangle: t as u32, b1: s * (1.0 - v), b2: s * v, back, density: 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Light on the front of the second of three triangles, twice as much on a tenth of the third; none on backs.
    fn example() -> LitSurfaces {
        LitSurfaces::new([1.0, 2.0, 0.0, 3.0].into_iter(), 4096, 1, 2.0, &|_| 1.0, &|s, _| match (
            s.back, s.triangle,
        ) {
            (false, 1) => 1.0,
            (false, 3) if (s.b1 + s.b2).powi(2) < 0.1 => 2.0,
            _ => 0.0,
        })
    }

    #[test]
    fn what_is_lit_gets_most_and_the_mean_is_kept() {
        let lit = example();
        assert!((lit.begins() - 4.6).abs() < 0.05);
        assert!((lit.near_share() - 2.0 / 4.6).abs() < 0.01);
        let n = 100_000u64;
        let (mut on_lit, mut area) = (0, 0.0);
        for i in 0..n {
            let mut stream = Stream::new(1, i, 0);
            let choice = (i as f64 * 0.618_033_988_75).fract();
            let s = lit.start(choice, stream.next_2d()).expect("a start");
            assert!(!s.back && s.triangle != 2 && s.b1 >= 0.0 && s.b2 >= 0.0 && s.b1 + s.b2 <= 1.0 + 1e-6);
            on_lit += u64::from(s.triangle == 1);
            area += 1.0 / s.density / n as f64;
        }
        assert!(on_lit as f64 > 0.6 * n as f64, "{on_lit}");
        // Of all that may be lit: every front.
        assert!((area - 6.0).abs() < 0.1, "{area}");
    }

    #[test]
    fn where_nothing_has_distant_light_all_particles_are_emitted() {
        let dark = LitSurfaces::new([1.0].into_iter(), 64, 1, 3.0, &|_| 1.0, &|_, _| 0.0);
        assert!(dark.near_share() == 1.0 && dark.start(0.5, [0.5; 2]).is_none() && dark.begins() == 3.0);
        let empty = LitSurfaces::new([].into_iter(), 64, 1, 3.0, &|_| 1.0, &|_, _| 1.0);
        assert!(empty.near_share() == 1.0 && empty.start(0.5, [0.5; 2]).is_none());
        let nan = LitSurfaces::new([f32::NAN, 1.0].into_iter(), 64, 1, 0.0, &|_| 1.0, &|_, _| 1.0);
        assert_eq!(nan.start(0.5, [0.5; 2]).expect("a start").triangle, 1);
        assert_eq!(nan.near_share(), 0.0);
    }
}
