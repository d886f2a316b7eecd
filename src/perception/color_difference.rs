//! CIELAB and ΔE*76 (REFERENCE §8.7).

use glam::Vec3;

use crate::math;

/// D65 white of the sRGB matrix: the sums of its rows.
const WHITE: Vec3 = Vec3::new(0.950_47, 1.000_000_1, 1.088_83);

/// CIELAB (L*, a*, b*) relative to D65 of linear RGB with Rec. 709 primaries, 1 = display white.
///
/// Source: CIE 15:2004, with the exact constants 216/24389 and 24389/27.
pub fn lab(linear: Vec3) -> Vec3 {
    let xyz = Vec3::new(
        linear.dot(Vec3::new(0.412_456_4, 0.357_576_1, 0.180_437_5)),
        linear.dot(Vec3::new(0.212_672_9, 0.715_152_2, 0.072_175_0)),
        linear.dot(Vec3::new(0.019_333_9, 0.119_192, 0.950_304_1)),
    ) / WHITE;
    let f = |t: f32| {
        if t > 216.0 / 24389.0 { math::cbrt(t) } else { (24389.0 / 27.0 * t + 16.0) / 116.0 }
    };
    let [x, y, z] = xyz.to_array().map(f);
    Vec3::new(116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z))
}

/// ΔE*76: the Euclidean distance of two CIELAB colours. About 2.3 is just noticeable.
pub fn delta_e76(a: Vec3, b: Vec3) -> f32 {
    (a - b).length()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::linear_from_srgb;

    fn of_bytes(rgb: [u8; 3]) -> Vec3 {
        lab(Vec3::from(rgb.map(|v| linear_from_srgb(f32::from(v) / 255.0))))
    }

    #[test]
    fn numbers_of_the_reference() {
        let grey = of_bytes([128; 3]);
        assert!((grey - Vec3::new(53.585, 0.0, 0.0)).abs().max_element() < 1e-3);
        let red = lab(Vec3::X);
        assert!((red - Vec3::new(53.2408, 80.0925, 67.2032)).abs().max_element() < 1e-3);
        assert!((delta_e76(red, lab(Vec3::Y)) - 170.565).abs() < 1e-2);
        let small = delta_e76(of_bytes([100, 120, 140]), of_bytes([105, 118, 139]));
        assert!((small - 2.570_75).abs() < 1e-3);
        assert!(lab(Vec3::ZERO).abs().max_element() < 1e-4);
        assert!((lab(Vec3::ONE) - Vec3::new(100.0, 0.0, 0.0)).abs().max_element() < 1e-3);
    }
}
