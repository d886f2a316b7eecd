//! Elevation maps: how much the content of a texture raises the threshold of visible errors in it.
//!
//! In: displayed luminance of one mip level in cd/m². Out: a factor ≥ 1 per texel, large where strong
//! contrast masks errors. A pre-process: one map per texture and level.

use rayon::prelude::*;

use super::csf::{barten, elevation_of_frequency};
use super::masking::threshold_elevation;
use crate::image::Map2d;

/// Bands of the contrast pyramid; it needs two more levels than bands.
const BANDS: usize = 6;
/// Smaller maps have too few levels: their elevation is 1.
const MIN_SIDE: usize = 8;
/// Tap weights of the à-trous blur.
const TAPS: [f32; 5] = [0.05, 0.25, 0.4, 0.25, 0.05];

/// How texture coordinates beyond [0, 1] are read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Border {
    /// The texture repeats.
    #[default]
    Wrap,
    /// Its edge texels continue.
    Clamp,
}

/// Conditions of an elevation map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ElevationSettings {
    /// Texels per degree of visual angle. A level is drawn at about one texel per pixel, so this is the display's
    /// pixels per degree for every level (REFERENCE §8.6).
    pub texels_per_degree: f32,
    /// Adaptation luminance, cd/m²; none for the mean of the map.
    pub adaptation: Option<f32>,
    /// Beyond the edge.
    pub border: Border,
    /// Whether only masking counts, not that some frequencies are seen less than others: where the error's own frequency
    /// is judged elsewhere.
    pub masking_only: bool,
    /// Upper bound: 100. The 10 of perceptualdiff saturates on ordinary textures and flattens the ranking (REFERENCE §8.5).
    pub max: f32,
}

impl ElevationSettings {
    /// Settings with adaptation to the mean, repeating textures and the bound of 100.
    pub const fn new(texels_per_degree: f32) -> Self {
        Self { texels_per_degree, adaptation: None, border: Border::Wrap, masking_only: false, max: 100.0 }
    }
}

/// Threshold elevation of each texel, in [1, `settings.max`]; 1 everywhere in maps with a side under 8 texels and where
/// there is no contrast.
///
/// Source: Ramasubramanian et al. 1999 §4.2 in the form of REFERENCE §8.5: Σ C F M / Σ C over octave bands of contrast C,
/// with F for frequency and M for masking. Deviation: taps spread with the level (à trous), so that bands are octaves.
pub fn elevation(luminance: &Map2d<f32>, settings: &ElevationSettings) -> Map2d<f32> {
    let (width, height) = (luminance.width(), luminance.height());
    let min_side = width.min(height);
    if min_side < MIN_SIDE {
        return Map2d::new(width, height, 1.0);
    }
    let mut current: Vec<f32> =
        luminance.data().iter().map(|v| if v.is_finite() { v.max(0.0) } else { 0.0 }).collect();
    let mean = current.iter().map(|&v| f64::from(v)).sum::<f64>() / current.len() as f64;
    let adaptation = settings.adaptation.unwrap_or(mean as f32).max(1e-4);
    let bands = (0..BANDS).take_while(|band| 2usize << band <= min_side).count();
    let (mut weighted, mut contrasts) = (vec![0.0f32; current.len()], vec![0.0f32; current.len()]);
    let mut next = blur(&current, width, 1, settings.border);
    for band in 0..bands {
        let after = blur(&next, width, 2 << band, settings.border);
        let frequency = settings.texels_per_degree / (2 << band) as f32;
        let of_frequency = if settings.masking_only { 1.0 } else { elevation_of_frequency(frequency) };
        let sensitivity = barten(frequency, adaptation);
        weighted.par_iter_mut().zip(&mut contrasts).enumerate().for_each(|(i, (weighted, contrasts))| {
            let contrast = (current[i] - next[i]).abs() / after[i].max(1e-5);
            *weighted += contrast * of_frequency * threshold_elevation(contrast * sensitivity);
            *contrasts += contrast;
        });
        current = std::mem::replace(&mut next, after);
    }
    let of_texel = |(&weighted, &contrasts): (&f32, &f32)| {
        if contrasts < 1e-5 { 1.0 } else { (weighted / contrasts).clamp(1.0, settings.max.max(1.0)) }
    };
    Map2d::from_vec(width, height, weighted.iter().zip(&contrasts).map(of_texel).collect())
}

/// Separable five-tap blur whose taps are `step` texels apart.
fn blur(source: &[f32], width: usize, step: usize, border: Border) -> Vec<f32> {
    let height = source.len() / width;
    let inside = |i: usize, offset: usize, side: usize| match border {
        // i + offset − 2 · step, kept positive.
        Border::Wrap => (i + offset + 2 * step * (side - 1)) % side,
        Border::Clamp => (i + offset).saturating_sub(2 * step).min(side - 1),
    };
    let mut rows = vec![0.0; source.len()];
    rows.par_chunks_mut(width).zip(source.par_chunks(width)).for_each(|(out, row)| {
        let (from, to) = (2 * step, width.saturating_sub(2 * step));
        for (x, out) in out.iter_mut().enumerate() {
            let tap = |k: usize| {
                let x =
                    if (from..to).contains(&x) { x + k * step - from } else { inside(x, k * step, width) };
                TAPS[k] * row[x]
            };
            *out = tap(0) + tap(1) + tap(2) + tap(3) + tap(4);
        }
    });
    let mut out = vec![0.0; source.len()];
    out.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
        for (k, weight) in TAPS.iter().enumerate() {
            let y = inside(y, k * step, height);
            out.iter_mut().zip(&rows[y * width..]).for_each(|(out, v)| *out += weight * v);
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math;

    fn grating(period: f32, contrast: f32) -> Map2d<f32> {
        Map2d::from_fn(64, 64, |x, _| {
            100.0 * (1.0 + contrast * math::cos(std::f32::consts::TAU * x as f32 / period + 0.3))
        })
    }

    fn statistics(period: f32, contrast: f32, max: f32) -> [f32; 2] {
        let settings = ElevationSettings { adaptation: Some(100.0), max, ..ElevationSettings::new(10.7868) };
        let map = elevation(&grating(period, contrast), &settings);
        let mean = map.data().iter().sum::<f32>() / 4096.0;
        [mean, map.data().iter().copied().fold(0.0, f32::max)]
    }

    #[test]
    fn gratings_of_the_reference() {
        let near = |a: f32, b: f32| assert!((a / b - 1.0).abs() < 1e-3, "{a} instead of {b}");
        for (period, mean, max) in [(8.0, 6.0636, 8.1086), (16.0, 5.8040, 8.1313), (32.0, 6.5744, 9.0978)] {
            let [found, largest] = statistics(period, 0.1, 100.0);
            near(found, mean);
            near(largest, max);
        }
        near(statistics(4.0, 0.1, 1e9)[0], 7.7922);
        near(statistics(8.0, 0.8, 1e9)[0], 26.0522);
        near(statistics(2.0, 0.1, 1e9)[0], 16.1502);
        assert_eq!(statistics(2.0, 0.8, 10.0)[1], 10.0);
    }

    #[test]
    fn constant_small_and_broken_maps() {
        let settings = ElevationSettings::new(10.0);
        for map in
            [Map2d::new(32, 9, 50.0), Map2d::new(7, 100, 3.0), Map2d::new(0, 0, 1.0), Map2d::new(16, 16, 0.0)]
        {
            assert!(elevation(&map, &settings).data().iter().all(|&v| v == 1.0));
        }
        for border in [Border::Wrap, Border::Clamp] {
            let broken = Map2d::from_fn(9, 40, |x, y| [1.0, f32::NAN, f32::INFINITY, -4.0, 0.0][(x + y) % 5]);
            let settings = ElevationSettings { border, ..settings };
            assert!(elevation(&broken, &settings).data().iter().all(|v| (1.0..=100.0).contains(v)));
        }
    }

    #[test]
    fn blurs_wrap_or_clamp() {
        let impulse: Vec<f32> = (0..16).map(|x| f32::from(u8::from(x == 0))).collect();
        let clamped = blur(&impulse, 16, 2, Border::Clamp);
        let wrapped = blur(&impulse, 16, 2, Border::Wrap);
        let near = |a: f32, b: f32| assert!((a - b).abs() < 1e-6, "{a} {b}");
        near(wrapped[0], 0.4);
        near(wrapped[2], 0.25);
        near(wrapped[12], 0.05);
        near(wrapped[14], 0.25);
        near(clamped[0], 0.7);
        near(clamped[1], 0.3);
        near(clamped[14], 0.0);
        near(wrapped.iter().sum(), 1.0);
        // Steps larger than the map.
        near(blur(&[1.0; 9], 3, 64, Border::Wrap).iter().sum(), 9.0);
    }
}
