//! Contrast masking: a pattern hides other patterns of its frequency band.

use crate::math;

/// Factor ≥ 1 by which a masker of `normalised_contrast` (contrast × contrast sensitivity, so 1 is just visible)
/// raises the threshold in its band. Tends to a slope of 0.7 in log–log.
///
/// Source: Daly 1993, Eq. (14.27) with W = 6, Q = 0.7, s = 0.7, b = 4 and his rounded constants (REFERENCE §8.4).
pub fn threshold_elevation(normalised_contrast: f32) -> f32 {
    /// k1 = W^(1 − 1/(1 − Q)).
    const K1: f32 = 0.0153;
    /// k2 = W^(1/(1 − Q)).
    const K2: f32 = 392.498;
    if normalised_contrast.is_nan() || normalised_contrast <= 0.0 {
        return 1.0;
    }
    let masker = K1 * math::powf(K2 * normalised_contrast, 0.7);
    let squared = masker * masker;
    // The fourth root of 1 + m⁴; m itself where m⁴ would overflow.
    if masker > 1e8 { masker } else { (1.0 + squared * squared).sqrt().sqrt() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_the_reference() {
        for (contrast, elevation) in [
            (0.0, 1.0),
            (0.1, 1.0004),
            (0.5, 1.034_22),
            (1.0, 1.189_72),
            (2.0, 1.6812),
            (5.0, 3.096_31),
            (10.0, 5.018_21),
            (50.0, 15.475_99),
            (100.0, 25.140_73),
        ] {
            assert!((threshold_elevation(contrast) / elevation - 1.0).abs() < 5e-5, "{contrast}");
        }
    }

    #[test]
    fn monotone_and_never_below_one() {
        let mut last = 1.0;
        for i in -40..120 {
            let e = threshold_elevation(math::powf(10f32, i as f32 / 4.0));
            assert!(e >= last && e.is_finite());
            last = e;
        }
        assert_eq!(threshold_elevation(f32::NAN), 1.0);
        assert_eq!(threshold_elevation(-3.0), 1.0);
    }
}
