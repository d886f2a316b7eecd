//! Threshold versus intensity: the smallest luminance difference that is seen at an adaptation luminance.

use crate::math;

/// Below this luminance (cd/m²) the threshold is that of absolute darkness; also keeps the base of the power positive.
const DARK: f32 = 1.148e-4;

/// Threshold ΔL in cd/m² at adaptation luminance `luminance` in cd/m². Positive and finite for any input; a negative
/// luminance or NaN counts as darkness.
///
/// Source: Ward Larson, Rushmeier & Piatko 1997, Table 1, after Ferwerda et al. 1996 (REFERENCE §8.2). Jumps by
/// 3 % at 10^−1.44 cd/m² and 0.7 % at 10^1.9 cd/m², as the source does.
pub fn tvi(luminance: f32) -> f32 {
    if luminance.is_nan() || luminance < DARK {
        return math::powf(10f32, -2.86);
    }
    if luminance == f32::INFINITY {
        return f32::MAX;
    }
    let a = math::log10(luminance);
    let log_threshold = if a < -1.44 {
        math::powf(0.405 * a + 1.6, 2.18) - 2.86
    } else if a < -0.0184 {
        a - 0.395
    } else if a < 1.9 {
        math::powf(0.249 * a + 0.65, 2.7) - 0.72
    } else {
        a - 1.255
    };
    math::powf(10f32, log_threshold)
}

/// [`tvi`] as a table, for every pixel of a frame: within 0.5 %, without a power function.
#[derive(Clone, Debug)]
pub struct TviTable {
    thresholds: Vec<f32>,
}

impl TviTable {
    /// Bits of a float that are dropped: 7 bits of mantissa stay, so steps are 0.8 % at most.
    const SHIFT: u32 = 16;
    /// 2^−14 cd/m², below [`DARK`].
    const FIRST: u32 = (113 << 23) >> Self::SHIFT;
    /// 2^20 cd/m².
    const LAST: u32 = (147 << 23) >> Self::SHIFT;

    /// Threshold ΔL in cd/m² at `luminance` in cd/m²; luminances above 10^6 count as that.
    #[inline]
    pub fn threshold(&self, luminance: f32) -> f32 {
        // max drops NaN and what is negative, whose bits would be large.
        let bits = luminance.max(0.0).to_bits() >> Self::SHIFT;
        self.thresholds[(bits.clamp(Self::FIRST, Self::LAST) - Self::FIRST) as usize]
    }
}

impl Default for TviTable {
    fn default() -> Self {
        let middle = |bits: u32| f32::from_bits((bits << Self::SHIFT) + (1 << (Self::SHIFT - 1)));
        Self { thresholds: (Self::FIRST..=Self::LAST).map(|bits| tvi(middle(bits))).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_the_reference() {
        for (luminance, threshold) in [
            (1e-6, 1.380_384e-3),
            (1e-4, 1.380_384e-3),
            (1e-3, 1.840_034e-3),
            (0.01, 5.472_343e-3),
            (0.1, 4.027_17e-2),
            (1.0, 0.391_301_5),
            (10.0, 1.071_902),
            (100.0, 5.559_043),
            (1000.0, 55.590_43),
        ] {
            assert!((tvi(luminance) / threshold - 1.0).abs() < 1e-5, "{luminance}: {}", tvi(luminance));
        }
    }

    #[test]
    fn any_luminance_has_a_threshold() {
        for v in [0.0, -1.0, f32::NAN, f32::NEG_INFINITY, f32::INFINITY, f32::MAX, f32::MIN_POSITIVE] {
            assert!(tvi(v) > 0.0 && tvi(v).is_finite(), "{v}");
        }
    }

    #[test]
    fn the_table_is_close() {
        let table = TviTable::default();
        for i in 0..20_000 {
            let luminance = math::powf(10f32, -6.0 + i as f32 * 5e-4);
            let ratio = table.threshold(luminance) / tvi(luminance);
            // Where the source jumps by 3 %, a cell holds one side of it.
            let jump =
                (math::log10(luminance) + 1.44).abs() < 4e-3 || (math::log10(luminance) - 1.9).abs() < 4e-3;
            assert!((ratio - 1.0).abs() < if jump { 0.03 } else { 0.005 }, "{luminance}: {ratio}");
        }
        for v in [0.0, -1.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX] {
            assert!(table.threshold(v) > 0.0 && table.threshold(v).is_finite());
        }
        assert_eq!(table.threshold(f32::NAN), tvi(0.0));
    }
}
