//! Two-dimensional maps, linear RGB and luminance.

use std::sync::LazyLock;

use glam::Vec3;

use crate::math;

/// A row-major map of `width × height` values.
#[derive(Clone, Debug, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Map2d<T> {
    width: usize,
    height: usize,
    data: Vec<T>,
}

impl<T: Copy> Map2d<T> {
    /// A map filled with `value`.
    pub fn new(width: usize, height: usize, value: T) -> Self {
        Self { width, height, data: vec![value; width * height] }
    }

    /// A map of given values in rows.
    ///
    /// # Panics
    /// If `data.len() != width * height`: a bug of the caller.
    pub fn from_vec(width: usize, height: usize, data: Vec<T>) -> Self {
        assert_eq!(data.len(), width * height, "a map of {width} × {height} values");
        Self { width, height, data }
    }

    /// A map of `f(x, y)`.
    pub fn from_fn(width: usize, height: usize, mut f: impl FnMut(usize, usize) -> T) -> Self {
        let mut data = Vec::with_capacity(width * height);
        for y in 0..height {
            data.extend((0..width).map(|x| f(x, y)));
        }
        Self { width, height, data }
    }

    /// Columns.
    #[inline]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    #[inline]
    pub fn height(&self) -> usize {
        self.height
    }

    /// The value at column `x`, row `y`.
    #[inline]
    pub fn at(&self, x: usize, y: usize) -> T {
        debug_assert!(x < self.width);
        self.data[y * self.width + x]
    }

    /// The value at the nearest pixel inside the map.
    #[inline]
    pub fn clamped(&self, x: isize, y: isize) -> T {
        let x = x.clamp(0, self.width as isize - 1) as usize;
        let y = y.clamp(0, self.height as isize - 1) as usize;
        self.data[y * self.width + x]
    }

    /// The place of the value at column `x`, row `y`.
    #[inline]
    pub fn at_mut(&mut self, x: usize, y: usize) -> &mut T {
        debug_assert!(x < self.width);
        &mut self.data[y * self.width + x]
    }

    /// All values, rows one after another.
    #[inline]
    pub fn data(&self) -> &[T] {
        &self.data
    }

    /// All values, to be changed.
    #[inline]
    pub fn data_mut(&mut self) -> &mut [T] {
        &mut self.data
    }

    /// Row `y`.
    #[inline]
    pub fn row(&self, y: usize) -> &[T] {
        &self.data[y * self.width..(y + 1) * self.width]
    }

    /// A map of `f(value)`, of the same shape.
    pub fn map<U: Copy>(&self, f: impl FnMut(T) -> U) -> Map2d<U> {
        Map2d { width: self.width, height: self.height, data: self.data.iter().copied().map(f).collect() }
    }
}

/// Luminance of linear RGB with Rec. 709 primaries (REFERENCE §8.1). Same unit as the input.
#[inline]
pub fn luminance(rgb: Vec3) -> f32 {
    rgb.dot(Vec3::new(0.212_672_9, 0.715_152_2, 0.072_175_0))
}

/// sRGB opto-electronic transfer: linear [0, 1] to display value [0, 1].
#[inline]
pub fn srgb_from_linear(v: f32) -> f32 {
    if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * math::powf(v, 1.0 / 2.4) - 0.055 }
}

/// [`srgb_from_linear`] of a value in [0, 1] as a byte, to the nearest, with the same bits as the formula has; what is beyond
/// is the nearest, NaN is 0.
#[inline]
pub fn srgb_byte_from_linear(v: f32) -> u8 {
    SrgbSteps::shared().byte(v)
}

fn exact_byte(v: f32) -> u8 {
    (srgb_from_linear(v).clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

/// Where bytes step, by the leading bits of a number: one look and one sum for each byte. For whole pictures, which ask for
/// it once.
#[derive(Debug)]
pub struct SrgbSteps {
    /// Of each cell of numbers whose bits differ in the lowest [`BELOW`] alone: the byte of its first number above these
    /// bits, and in them how far its step, if it has one, lies before the next cell. So the sum of both carries at the step.
    cells: Vec<u32>,
}

/// Bits within a cell: cells are narrower than any step (0.4 % beside 0.9 % below 1).
const BELOW: u32 = 16;

/// Bits of 2⁻¹³, below which all bytes are 0.
const LEAST: u32 = (127 - 13) << 23;

static SRGB_STEPS: LazyLock<SrgbSteps> = LazyLock::new(|| {
    // Bits of the least number of each byte: near where the formula's inverse says, found by halving.
    let edge = |byte: u8| {
        let about = linear_from_srgb((f32::from(byte) - 0.5) / 255.0);
        let (mut below, mut at) = ((about * 0.9999).to_bits(), (about * 1.0001).to_bits());
        while at - below > 1 {
            let middle = below + (at - below) / 2;
            if exact_byte(f32::from_bits(middle)) >= byte { at = middle } else { below = middle }
        }
        at
    };
    let edges: Vec<u32> = (1..=255).map(edge).collect();
    let last = (1.0f32.to_bits() - LEAST) >> BELOW;
    let cell = |i: u32| {
        let first = LEAST + (i << BELOW);
        let byte = edges.partition_point(|edge| *edge <= first);
        let step = edges.get(byte).map(|edge| edge - first).filter(|step| *step < 1 << BELOW);
        ((byte as u32) << BELOW) + step.map_or(0, |step| (1 << BELOW) - step)
    };
    SrgbSteps { cells: (0..=last).map(cell).collect() }
});

impl SrgbSteps {
    /// The steps, found once.
    pub fn shared() -> &'static Self {
        &SRGB_STEPS
    }

    /// [`srgb_byte_from_linear`].
    #[inline]
    pub fn byte(&self, v: f32) -> u8 {
        // In this order, which makes NaN the least.
        let bits = v.max(f32::from_bits(LEAST)).min(1.0).to_bits();
        let cell = self.cells[((bits - LEAST) >> BELOW) as usize];
        ((cell + (bits & ((1 << BELOW) - 1))) >> BELOW) as u8
    }
}

/// sRGB electro-optical transfer: display value [0, 1] to linear [0, 1].
#[inline]
pub fn linear_from_srgb(v: f32) -> f32 {
    if v <= 0.04045 { v / 12.92 } else { math::powf((v + 0.055) / 1.055, 2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_by_steps_are_those_of_the_formula() {
        let mut some: Vec<f32> = (0..=4096).map(|i| i as f32 / 4096.0).collect();
        some.extend((0..200_000).map(|i| crate::rng::Stream::new(7, i, 0).next_f32()));
        some.extend((0..2_000).map(|i| i as f32 * 1e-6));
        some.extend((LEAST..1.0f32.to_bits()).step_by(1 << BELOW).map(f32::from_bits));
        some.extend([f32::NAN, f32::INFINITY, -1.0, -0.0, 2.0, 1e-30]);
        for v in some {
            for v in [v, v.next_down(), v.next_up(), v * 1.00009, v * 1.00011, v * 0.99989, v * 0.99991] {
                assert_eq!(srgb_byte_from_linear(v), exact_byte(v), "{v}");
            }
        }
    }

    /// The formula is a step at each byte, and not two and one back: every number around it.
    #[test]
    fn every_number_around_a_step_has_the_byte_of_the_formula() {
        for byte in 1..=255u8 {
            let edge = linear_from_srgb((f32::from(byte) - 0.5) / 255.0);
            let around = (edge * 0.9999).to_bits()..=(edge * 1.0001).to_bits();
            for v in around.map(f32::from_bits) {
                assert_eq!(srgb_byte_from_linear(v), exact_byte(v), "{v}");
            }
        }
    }

    #[test]
    fn srgb_round_trips_every_byte() {
        for byte in 0..=255u8 {
            let v = f32::from(byte) / 255.0;
            let back = srgb_from_linear(linear_from_srgb(v));
            assert_eq!((back * 255.0).round() as u8, byte);
        }
    }

    #[test]
    fn luminance_of_white_is_one() {
        assert!((luminance(Vec3::ONE) - 1.0).abs() < 1e-6);
    }
}
