//! Contrast sensitivity: the inverse of the contrast at which a grating of a spatial frequency is just seen.
//!
//! Frequencies in cycles per degree, luminances in cd/m². All functions are 0 or positive and finite for any
//! input.

use crate::math;

/// Frequency and luminance at which [`barten`] is largest for a display of 100 cd/m².
pub const PEAK: [f32; 2] = [3.248, 100.0];

/// Keeps products finite: what is no positive number becomes next to nothing, the infinite very large.
#[inline]
fn positive(v: f32) -> f32 {
    if v > 1e-12 { v.min(1e6) } else { 1e-12 }
}

/// Contrast sensitivity at `frequency` for adaptation to `luminance`.
///
/// Source: Barten 1989, as used by Ramasubramanian et al. 1999 and Yee (REFERENCE §8.3).
pub fn barten(frequency: f32, luminance: f32) -> f32 {
    let (frequency, luminance) = (positive(frequency), positive(luminance));
    let a = 440.0 * math::powf(1.0 + 0.7 / luminance, -0.2);
    let b = 0.3 * math::powf(1.0 + 100.0 / luminance, 0.15);
    // e^(−Bρ) √(1 + 0.06 e^(Bρ)) = √(e^(−2Bρ) + 0.06 e^(−Bρ)), which does not overflow.
    let e = math::exp(-b * frequency);
    a * frequency * (e * e + 0.06 * e).sqrt()
}

/// How much less sensitive than at the peak: CSF_max / CSF, in [1, 1000]; below 0.1 cycles per degree as at 0.1.
pub fn elevation_of_frequency(frequency: f32) -> f32 {
    let [peak, luminance] = PEAK;
    let sensitivity = barten(frequency.max(0.1), luminance);
    (barten(peak, luminance) / sensitivity.max(f32::MIN_POSITIVE)).clamp(1.0, 1e3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_the_reference() {
        let frequencies = [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0];
        let at_100 = [192.4874, 327.8966, 477.2303, 514.172, 334.364, 124.8695, 21.9155];
        let at_1 = [152.4284, 228.8409, 261.2802, 185.3897, 75.1899, 12.8240, 0.3617];
        let near = |a: f32, b: f32| assert!((a / b - 1.0).abs() < 2e-4, "{a} instead of {b}");
        for (i, f) in frequencies.into_iter().enumerate() {
            near(barten(f, 100.0), at_100[i]);
            near(barten(f, 1.0), at_1[i]);
        }
        near(barten(PEAK[0], PEAK[1]), 525.1536);
    }

    #[test]
    fn any_frequency_and_luminance() {
        let values = [0.0, -1.0, f32::NAN, f32::INFINITY, 1e-30, 1e30];
        for f in values {
            for l in values {
                assert!(barten(f, l) >= 0.0, "{f} {l}");
            }
            assert!((1.0..=1e3).contains(&elevation_of_frequency(f)));
        }
        assert!((elevation_of_frequency(PEAK[0]) - 1.0).abs() < 1e-6);
    }
}
