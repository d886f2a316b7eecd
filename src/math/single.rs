//! Functions of f32 as polynomials in f64, which leaves their errors far below half a unit in the last place: all
//! are within 0.52 of one. No table, and hardly a branch.
//!
//! Polynomials interpolate at Chebyshev nodes; what is stated is their greatest error on the interval.

use std::f64::consts::{FRAC_2_PI, LN_2, LOG2_E, LOG10_2};

/// Added and subtracted, it rounds to an integer; in between, the lowest bits are that integer.
const ROUND: f64 = 6_755_399_441_055_744.0;

/// π/2 to 25 bits, so that 2²⁸ of them are exact, and the rest of it.
const HALF_PI: [f64; 2] = [1.570_796_310_901_641_8, 1.589_325_477_352_819_7e-8];

/// Sine and cosine.
#[inline]
pub fn sin_cos(x: f32) -> (f32, f32) {
    // Where more of π would be needed, and what has no sine.
    if x.is_nan() || x.abs() > 1e8 {
        return libm::sincosf(x);
    }
    let x = f64::from(x);
    let turned = x * FRAC_2_PI + ROUND;
    let (quadrant, n) = (turned.to_bits(), turned - ROUND);
    let r = x - n * HALF_PI[0] - n * HALF_PI[1];
    let z = r * r;
    // (sin r − r) / r³ to 3e-11 and (cos r − 1 + r²/2) / r⁴ to 3e-12 for |r| ≤ π/4.
    let s = (-0.166_666_666_638_551_8 + z * 0.008_333_331_874_666_563)
        + z * z * (-0.000_198_400_867_118_067_7 + z * 2.724_992_274_581_348e-6);
    let c = (0.041_666_666_664_321_11 - z * 0.001_388_888_767_198_036_5)
        + z * z * (2.480_060_035_747_831_3e-5 - z * 2.730_095_665_223_154_5e-7);
    let (sin, cos) = ((r + r * z * s) as f32, (1.0 - 0.5 * z + z * z * c) as f32);
    let (a, b) = if quadrant & 1 == 0 { (sin, cos) } else { (cos, sin) };
    let negated = |v: f32, when: u64| f32::from_bits(v.to_bits() ^ ((when & 2) << 30) as u32);
    (negated(a, quadrant), negated(b, quadrant.wrapping_add(1)))
}

/// Sine.
#[inline]
pub fn sin(x: f32) -> f32 {
    sin_cos(x).0
}

/// Cosine.
#[inline]
pub fn cos(x: f32) -> f32 {
    sin_cos(x).1
}

/// 2ᵗ.
#[inline]
fn power_of_two(t: f64) -> f32 {
    // Further out, an f32 is 0 or infinite anyway.
    let t = t.clamp(-200.0, 200.0);
    let rounded = t + ROUND;
    let f = t - (rounded - ROUND);
    // (2ᶠ − 1) / f to 2e-10 for |f| ≤ 1/2.
    let f2 = f * f;
    let p = (LN_2 + f * 0.240_226_509_222_890_3)
        + f2 * (0.055_504_108_839_096_39 + f * 0.009_618_056_678_466_632)
        + f2 * f2
            * (0.001_333_350_238_611_812_2
                + f * 0.000_154_614_447_217_735_11
                + f2 * 1.529_732_377_856_141_2e-5);
    let scale = f64::from_bits(rounded.to_bits().wrapping_add(1023) << 52);
    ((1.0 + f * p) * scale) as f32
}

/// The logarithm to base 2 of a positive, finite number that is normal, as all f32 are in f64.
#[inline]
fn log2_of_normal(x: f64) -> f64 {
    /// √½.
    const LEAST: u64 = 0x3fe6_a09e_667f_3bcd;
    let exponent = (x.to_bits().wrapping_sub(LEAST) as i64) >> 52;
    let m = f64::from_bits(x.to_bits().wrapping_sub((exponent as u64) << 52));
    // log₂ m = s P(s²) with s = (m − 1) / (m + 1); P to 2e-11 for m in [√½, √2].
    let s = (m - 1.0) / (m + 1.0);
    let z = s * s;
    let p = (2.885_390_081_789_993 + z * 0.961_796_673_443_228_3)
        + z * z * (0.577_083_567_703_489_2 + z * 0.411_673_658_400_816 + z * z * 0.340_714_136_651_911_97);
    exponent as f64 + s * p
}

/// Whether it has a logarithm.
#[inline]
fn is_positive(x: f32) -> bool {
    x > 0.0 && x < f32::INFINITY
}

/// eˣ.
#[inline]
pub fn exp(x: f32) -> f32 {
    power_of_two(f64::from(x) * LOG2_E)
}

/// 2ˣ.
#[inline]
pub fn exp2(x: f32) -> f32 {
    power_of_two(f64::from(x))
}

/// Natural logarithm.
#[inline]
pub fn ln(x: f32) -> f32 {
    if is_positive(x) { (log2_of_normal(f64::from(x)) * LN_2) as f32 } else { libm::logf(x) }
}

/// Logarithm to base 2.
#[inline]
pub fn log2(x: f32) -> f32 {
    if is_positive(x) { log2_of_normal(f64::from(x)) as f32 } else { libm::log2f(x) }
}

/// Logarithm to base 10.
#[inline]
pub fn log10(x: f32) -> f32 {
    if is_positive(x) { (log2_of_normal(f64::from(x)) * LOG10_2) as f32 } else { libm::log10f(x) }
}

/// xʸ.
#[inline]
pub fn powf(x: f32, y: f32) -> f32 {
    if is_positive(x) && y.is_finite() {
        power_of_two(f64::from(y) * log2_of_normal(f64::from(x)))
    } else {
        libm::powf(x, y)
    }
}
