//! Contrast sensitivity: the inverse of the contrast at which a grating of a spatial frequency is just seen.
//!
//! Frequencies in cycles per degree, luminances in cd/m². All functions are 0 or positive and finite for any
//! input.

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
    let a = 440.0 * (1.0 + 0.7 / luminance).powf(-0.2);
    let b = 0.3 * (1.0 + 100.0 / luminance).powf(0.15);
    // e^(−Bρ) √(1 + 0.06 e^(Bρ)) = √(e^(−2Bρ) + 0.06 e^(−Bρ)), which does not overflow.
    let e = (-b * frequency).exp();
    a * frequency * (e * e + 0.06 * e).sqrt()
}

/// Contrast sensitivity of the visible differences predictor, for a picture of one square degree seen straight on
/// from `distance` metres.
///
/// Source: Daly 1993, Eq. (14.4), P = 250, ε = 0.9, i² = 1, eccentricity and orientation 0 (REFERENCE §8.3).
pub fn daly(frequency: f32, luminance: f32, distance: f32) -> f32 {
    let (frequency, luminance, distance) = (positive(frequency), positive(luminance), positive(distance));
    const EPSILON: f32 = 0.9;
    let a = 0.801 * (1.0 + 0.7 / luminance).powf(-0.2);
    let b = 0.3 * (1.0 + 100.0 / luminance).powf(0.15);
    let s = |f: f32| {
        let e = (-b * EPSILON * f).exp();
        let size = ((3.23 * (f * f).powf(-0.3)).powi(5) + 1.0).powf(-0.2);
        size * a * EPSILON * f * (e * e + 0.06 * e).sqrt()
    };
    let accommodation = 0.856 * distance.powf(0.14);
    250.0 * s(frequency / accommodation).min(s(frequency))
}

/// Relative contrast sensitivity, at most 0.981, at 7.89 cycles per degree.
///
/// Source: Mannos & Sakrison 1974.
pub fn mannos_sakrison(frequency: f32) -> f32 {
    let f = 0.114 * positive(frequency);
    2.6 * (0.0192 + f) * (-f.powf(1.1)).exp()
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
        let vdp = [16.3645, 42.9098, 97.2741, 163.581, 121.8645, 41.9001, 5.2279];
        let relative = [0.189_82, 0.315_96, 0.527_97, 0.810_53, 0.980_78, 0.690_75, 0.186_98];
        let near = |a: f32, b: f32| assert!((a / b - 1.0).abs() < 2e-4, "{a} instead of {b}");
        for (i, f) in frequencies.into_iter().enumerate() {
            near(barten(f, 100.0), at_100[i]);
            near(barten(f, 1.0), at_1[i]);
            near(daly(f, 100.0, 0.5), vdp[i]);
            near(mannos_sakrison(f), relative[i]);
        }
        near(barten(PEAK[0], PEAK[1]), 525.1536);
    }

    #[test]
    fn any_frequency_and_luminance() {
        let values = [0.0, -1.0, f32::NAN, f32::INFINITY, 1e-30, 1e30];
        for f in values {
            for l in values {
                for s in [barten(f, l), daly(f, l, 0.5), mannos_sakrison(f)] {
                    assert!(s >= 0.0, "{f} {l}: {s}");
                }
            }
            assert!((1.0..=1e3).contains(&elevation_of_frequency(f)));
        }
        assert!((elevation_of_frequency(PEAK[0]) - 1.0).abs() < 1e-6);
    }
}
