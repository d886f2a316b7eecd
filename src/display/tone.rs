//! From radiance to what a display is sent: exposure, tone curve, sRGB encoding, bytes.
//!
//! In: linear RGB radiance of any range. Out: display-referred values in [0, 1] or bytes. One fixed
//! operator and exposure per walk: with an automatic one, errors of different frames do not compare
//! (REFERENCE §8.1).

use glam::Vec3;

use crate::image::{Map2d, luminance, srgb_from_linear};
use crate::math;
use crate::scene::Display;

/// What happens to exposed radiance above 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub enum ToneCurve {
    /// It is shown as 1.
    #[default]
    Clamp,
    /// Luminance L becomes L (1 + L / white²) / (1 + L), colour is kept; then clamped.
    ///
    /// Source: Reinhard et al. 2002, Eq. (4).
    Reinhard {
        /// The exposed luminance that is shown as 1; infinite for the simple operator L / (1 + L).
        white: f32,
    },
}

/// Exposure and tone curve.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ToneMap {
    /// Factor on radiance, ≥ 0.
    pub exposure: f32,
    /// The curve after it.
    pub curve: ToneCurve,
}

impl Default for ToneMap {
    fn default() -> Self {
        Self { exposure: 1.0, curve: ToneCurve::Clamp }
    }
}

impl From<&Display> for ToneMap {
    fn from(display: &Display) -> Self {
        Self { exposure: display.exposure, curve: ToneCurve::Clamp }
    }
}

/// Into [0, 1]; what is no number becomes 0.
#[inline]
fn unit(v: f32) -> f32 {
    if v > 0.0 { v.min(1.0) } else { 0.0 }
}

impl ToneMap {
    /// Radiance from which on grey is displayed as white.
    pub fn white(&self) -> f32 {
        let exposed = match self.curve {
            ToneCurve::Clamp => 1.0,
            ToneCurve::Reinhard { white } => white,
        };
        exposed / self.exposure.max(f32::MIN_POSITIVE)
    }

    /// Displayed light in [0, 1] per channel, linear. NaN becomes 0, infinity 1.
    #[inline]
    pub fn to_linear(&self, radiance: Vec3) -> Vec3 {
        let mut rgb = radiance * self.exposure;
        if let ToneCurve::Reinhard { white } = self.curve {
            let l = luminance(rgb);
            if l > 0.0 && l.is_finite() {
                let white_squared = (white * white).max(f32::MIN_POSITIVE);
                rgb *= (1.0 + l / white_squared) / (1.0 + l);
            }
        }
        Vec3::new(unit(rgb.x), unit(rgb.y), unit(rgb.z))
    }

    /// Display-referred values: [`Self::to_linear`], sRGB-encoded, in [0, 1].
    #[inline]
    pub fn to_display(&self, radiance: Vec3) -> Vec3 {
        let linear = self.to_linear(radiance);
        Vec3::new(srgb_from_linear(linear.x), srgb_from_linear(linear.y), srgb_from_linear(linear.z))
    }

    /// The bytes of [`Self::to_display`]. For whole pictures use an [`Encoder`], which gives the same.
    #[inline]
    pub fn to_rgb8(&self, radiance: Vec3) -> [u8; 3] {
        self.to_display(radiance).to_array().map(|v| (v * 255.0).round() as u8)
    }
}

/// Tables that turn linear light into sRGB bytes without a power function, exact to the byte.
#[derive(Clone, Debug)]
pub struct Encoder {
    /// The byte at the lower end of each interval of width 1 / [`INTERVALS`].
    first: Box<[u8; INTERVALS]>,
    /// `next[b]`: the smallest value whose byte is above b; no interval holds two of them.
    next: [f32; 256],
}

/// Intervals of the table. The smallest distance between two steps of the curve is 1 / (12.92 · 255) =
/// 1 / 3295, so none of these holds two.
const INTERVALS: usize = 4096;

impl Default for Encoder {
    fn default() -> Self {
        let mut next = [f32::INFINITY; 256];
        for (byte, next) in next.iter_mut().enumerate().take(255) {
            let v = (byte as f64 + 0.5) / 255.0;
            let linear = if v <= 0.04045 { v / 12.92 } else { math::powf((v + 0.055) / 1.055, 2.4) };
            let nearest = linear as f32;
            *next = if f64::from(nearest) < linear { nearest.next_up() } else { nearest };
        }
        let byte_at = |i: usize| {
            let v = i as f32 / INTERVALS as f32;
            next.partition_point(|&step| step <= v) as u8
        };
        Self { first: Box::new(std::array::from_fn(byte_at)), next }
    }
}

impl Encoder {
    /// The sRGB byte of a linear value; NaN gives 0.
    #[inline]
    pub fn byte(&self, linear: f32) -> u8 {
        // The cast saturates and sends NaN to 0.
        let i = ((linear * INTERVALS as f32) as usize).min(INTERVALS - 1);
        let byte = self.first[i];
        byte + u8::from(linear >= self.next[usize::from(byte)])
    }

    /// The bytes a display is sent for `radiance`.
    #[inline]
    pub fn rgb8(&self, tone: &ToneMap, radiance: Vec3) -> [u8; 3] {
        // Written out: mapping an array made two calls of it, for each pixel of each frame.
        let Vec3 { x, y, z } = tone.to_linear(radiance);
        [self.byte(x), self.byte(y), self.byte(z)]
    }

    /// The bytes of a picture, three per pixel in rows.
    pub fn encode(&self, tone: &ToneMap, radiance: &Map2d<Vec3>, bytes: &mut Vec<u8>) {
        bytes.resize(3 * radiance.data().len(), 0);
        for (pixel, rgb) in bytes.chunks_exact_mut(3).zip(radiance.data()) {
            pixel.copy_from_slice(&self.rgb8(tone, *rgb));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn exact_byte(linear: f32) -> u8 {
        let v = f64::from(linear);
        let encoded = if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * math::powf(v, 1.0 / 2.4) - 0.055 };
        (encoded * 255.0).round() as u8
    }

    #[test]
    fn encoder_is_exact_to_the_byte() {
        let encoder = Encoder::default();
        for i in 0..=1_000_000u32 {
            let v = i as f32 * 1e-6;
            assert_eq!(encoder.byte(v), exact_byte(v), "{v}");
        }
        // Around every step, float by float.
        for byte in 0..255usize {
            let mut v = encoder.next[byte];
            (0..8).for_each(|_| v = v.next_down());
            for _ in 0..16 {
                assert_eq!(encoder.byte(v), exact_byte(v), "{v}");
                v = v.next_up();
            }
        }
    }

    #[test]
    fn every_byte_comes_back() {
        let encoder = Encoder::default();
        for byte in 0..=255u8 {
            assert_eq!(encoder.byte(crate::image::linear_from_srgb(f32::from(byte) / 255.0)), byte);
        }
    }

    #[test]
    fn what_is_no_light_is_shown_as_something() {
        let encoder = Encoder::default();
        for curve in
            [ToneCurve::Clamp, ToneCurve::Reinhard { white: 0.0 }, ToneCurve::Reinhard { white: f32::NAN }]
        {
            let tone = ToneMap { exposure: 2.0, curve };
            for v in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, f32::MAX, 1e-40, 0.0] {
                let shown = tone.to_display(Vec3::new(v, 0.5, v));
                assert!(shown.to_array().iter().all(|v| (0.0..=1.0).contains(v)), "{curve:?} {v} {shown}");
                assert_eq!(encoder.rgb8(&tone, Vec3::splat(v)), tone.to_rgb8(Vec3::splat(v)));
            }
        }
        let tone = ToneMap::default();
        assert_eq!(tone.to_rgb8(Vec3::new(f32::NAN, f32::INFINITY, -5.0)), [0, 255, 0]);
    }

    #[test]
    fn reinhard_shows_its_white_as_one_and_keeps_colour() {
        let tone = ToneMap { exposure: 0.5, curve: ToneCurve::Reinhard { white: 4.0 } };
        assert!((tone.to_linear(Vec3::splat(8.0)) - Vec3::ONE).abs().max_element() < 1e-5);
        let simple = ToneMap { exposure: 1.0, curve: ToneCurve::Reinhard { white: f32::INFINITY } };
        assert!((simple.to_linear(Vec3::ONE).x - 0.5).abs() < 1e-6);
        let shown = simple.to_linear(Vec3::new(0.2, 0.1, 0.4));
        assert!((shown.x / shown.y - 2.0).abs() < 1e-5 && (shown.z / shown.y - 4.0).abs() < 1e-5);
    }

    #[test]
    fn pictures_encode_as_pixels_do() {
        let map = Map2d::from_fn(33, 7, |x, y| Vec3::new(x as f32 / 20.0, y as f32 / 7.0, 0.01 * x as f32));
        let tone = ToneMap { exposure: 0.8, ..ToneMap::default() };
        let mut bytes = Vec::new();
        Encoder::default().encode(&tone, &map, &mut bytes);
        for (pixel, rgb) in bytes.chunks_exact(3).zip(map.data()) {
            assert_eq!(pixel, tone.to_rgb8(*rgb));
        }
    }
}
