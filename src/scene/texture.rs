//! Textures with their mip chains, kept in the file's own precision, and their filtered look-up.

use std::sync::Arc;

use glam::Vec2;

use crate::image::{linear_from_srgb, srgb_from_linear};

/// How the texels of a [`MipChain`] are stored.
#[derive(Clone, Debug)]
enum Texels {
    /// 8 bits per channel. RGB is gamma-encoded where `decode` says so.
    Byte(Vec<[u8; 4]>),
    /// 16 bits per channel, not gamma-encoded.
    Word(Vec<[u16; 4]>),
    /// Linear values.
    Float(Vec<[f32; 4]>),
}

/// Where one level lies in the store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Level {
    width: u32,
    height: u32,
    offset: usize,
}

/// The pixels of one picture at full size and, by a box filter, at every half of it down to 1 × 1.
///
/// 8-bit pictures stay at 4 bytes per texel (a 3000 × 2139 picture needs 34 MB, not 137); smaller
/// levels are filtered in linear light and rounded to the same encoding, as a GPU's sRGB format does.
#[derive(Clone, Debug)]
pub struct MipChain {
    levels: Vec<Level>,
    texels: Texels,
    /// Linear value of each byte of a colour channel.
    decode: Box<[f32; 256]>,
    gamma: bool,
}

/// The table from byte to linear value.
fn decode_table(gamma: bool) -> Box<[f32; 256]> {
    Box::new(std::array::from_fn(|b| {
        let v = b as f32 / 255.0;
        if gamma { linear_from_srgb(v) } else { v }
    }))
}

/// The levels of a picture, and the number of texels of all of them.
fn levels_of(width: usize, height: usize) -> (Vec<Level>, usize) {
    let (mut w, mut h, mut offset) = (width.max(1), height.max(1), 0);
    let mut levels = Vec::new();
    loop {
        levels.push(Level { width: w as u32, height: h as u32, offset });
        offset += w * h;
        if w == 1 && h == 1 {
            return (levels, offset);
        }
        w = (w / 2).max(1);
        h = (h / 2).max(1);
    }
}

impl MipChain {
    /// From 8-bit RGBA in rows from the top. `gamma`: RGB is sRGB-encoded.
    ///
    /// # Panics
    /// If `texels.len() != width * height` or it is empty: a bug of the caller.
    pub fn from_rgba8(width: usize, height: usize, texels: Vec<[u8; 4]>, gamma: bool) -> Self {
        assert!(!texels.is_empty() && texels.len() == width * height, "a picture of {width} × {height}");
        let mut chain =
            Self { levels: Vec::new(), texels: Texels::Byte(texels), decode: decode_table(gamma), gamma };
        chain.fill(width, height);
        chain
    }

    /// From 16-bit RGBA that is not gamma-encoded.
    ///
    /// # Panics
    /// As [`Self::from_rgba8`].
    pub fn from_rgba16(width: usize, height: usize, texels: Vec<[u16; 4]>) -> Self {
        assert!(!texels.is_empty() && texels.len() == width * height, "a picture of {width} × {height}");
        let mut chain = Self {
            levels: Vec::new(),
            texels: Texels::Word(texels),
            decode: decode_table(false),
            gamma: false,
        };
        chain.fill(width, height);
        chain
    }

    /// From linear values.
    ///
    /// # Panics
    /// As [`Self::from_rgba8`].
    pub fn from_linear(width: usize, height: usize, texels: Vec<[f32; 4]>) -> Self {
        assert!(!texels.is_empty() && texels.len() == width * height, "a picture of {width} × {height}");
        let mut chain = Self {
            levels: Vec::new(),
            texels: Texels::Float(texels),
            decode: decode_table(false),
            gamma: false,
        };
        chain.fill(width, height);
        chain
    }

    /// Makes every level below the first: each texel is the mean of the area that it covers, which
    /// at odd sizes takes part of its neighbours' texels, so that every level has the same mean.
    fn fill(&mut self, width: usize, height: usize) {
        let (levels, total) = levels_of(width, height);
        match &mut self.texels {
            Texels::Byte(t) => t.reserve_exact(total - t.len()),
            Texels::Word(t) => t.reserve_exact(total - t.len()),
            Texels::Float(t) => t.reserve_exact(total - t.len()),
        }
        self.levels = levels;
        for below in 1..self.levels.len() {
            let (from, to) = (self.levels[below - 1], self.levels[below]);
            let columns: Vec<_> = (0..to.width).map(|x| covered(x, to.width, from.width)).collect();
            for y in 0..to.height {
                let (y0, row_weights) = covered(y, to.height, from.height);
                for (x0, column_weights) in &columns {
                    let mut sum = [0.0f32; 4];
                    for (dy, wy) in row_weights.iter().enumerate().filter(|(_, w)| **w > 0.0) {
                        let row = from.offset + (y0 + dy) * from.width as usize;
                        for (dx, wx) in column_weights.iter().enumerate().filter(|(_, w)| **w > 0.0) {
                            let t = self.fetch(row + x0 + dx);
                            for c in 0..4 {
                                sum[c] += wy * wx * t[c];
                            }
                        }
                    }
                    self.push(sum);
                }
            }
        }
    }

    fn push(&mut self, v: [f32; 4]) {
        let gamma = self.gamma;
        match &mut self.texels {
            Texels::Byte(t) => {
                let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
                let encode = |v: f32| if gamma { byte(srgb_from_linear(v)) } else { byte(v) };
                t.push([encode(v[0]), encode(v[1]), encode(v[2]), byte(v[3])]);
            }
            Texels::Word(t) => t.push(v.map(|v| (v.clamp(0.0, 1.0) * 65535.0 + 0.5) as u16)),
            Texels::Float(t) => t.push(v),
        }
    }

    #[inline]
    fn fetch(&self, at: usize) -> [f32; 4] {
        match &self.texels {
            Texels::Byte(t) => {
                let [r, g, b, a] = t[at];
                let d = &self.decode;
                [d[r as usize], d[g as usize], d[b as usize], f32::from(a) * (1.0 / 255.0)]
            }
            Texels::Word(t) => t[at].map(|v| f32::from(v) * (1.0 / 65535.0)),
            Texels::Float(t) => t[at],
        }
    }

    /// Number of levels, at least 1.
    pub fn level_count(&self) -> usize {
        self.levels.len()
    }

    /// Bytes of all texels.
    pub fn bytes(&self) -> usize {
        match &self.texels {
            Texels::Byte(t) => t.len() * 4,
            Texels::Word(t) => t.len() * 8,
            Texels::Float(t) => t.len() * 16,
        }
    }
}

/// The first of `from` texels that texel `i` of `to` covers, and the shares of it and of the next two.
fn covered(i: u32, to: u32, from: u32) -> (usize, [f32; 3]) {
    // In units of 1 / to of a texel, so that whole numbers suffice.
    let (start, end) = (u64::from(i) * u64::from(from), u64::from(i + 1) * u64::from(from));
    let to = u64::from(to);
    let first = start / to;
    let share = |k: u64| {
        let (a, b) = ((first + k) * to, (first + k + 1) * to);
        b.min(end).saturating_sub(a.max(start)) as f32 / u64::from(from) as f32
    };
    (first as usize, [share(0), share(1), share(2)])
}

/// A texture with its mip chain. Level 0 is full size; row 0 of a level is the top of the picture.
/// Values are linear RGB (or the raw values, where the texture is not a colour) and alpha.
#[derive(Clone, Debug)]
pub struct Texture {
    /// Path relative to the scene's folder, for reports.
    pub name: String,
    /// The pixels; textures that differ in coordinates only share them.
    pub mips: Arc<MipChain>,
    /// Whether the file had an alpha channel.
    pub has_alpha: bool,
    /// `false` for masks, heights and normals, whose bytes are not gamma-decoded.
    pub is_color: bool,
    /// Coordinates are clamped instead of repeated (`-clamp on`).
    pub clamp: bool,
    /// Scale (two numbers) and offset (two numbers) of the coordinates (`-s`, `-o`).
    pub scale_offset: [f32; 4],
}

impl Texture {
    /// A repeated colour texture of these pixels.
    pub fn new(name: impl Into<String>, mips: MipChain) -> Self {
        Self {
            name: name.into(),
            mips: Arc::new(mips),
            has_alpha: false,
            is_color: true,
            clamp: false,
            scale_offset: [1.0, 1.0, 0.0, 0.0],
        }
    }

    /// Number of levels, at least 1.
    #[inline]
    pub fn level_count(&self) -> usize {
        self.mips.levels.len()
    }

    /// Columns and rows of a level; levels beyond the last are the last.
    #[inline]
    pub fn size(&self, level: usize) -> [usize; 2] {
        let l = self.mips.levels[level.min(self.mips.levels.len() - 1)];
        [l.width as usize, l.height as usize]
    }

    /// The texel at column `x`, row `y` (from the top) of a level, linear RGB and alpha.
    ///
    /// # Panics
    /// If `x` or `y` is outside of the level: a bug of the caller.
    #[inline]
    pub fn texel(&self, level: usize, x: usize, y: usize) -> [f32; 4] {
        let l = self.mips.levels[level.min(self.mips.levels.len() - 1)];
        assert!(
            x < l.width as usize && y < l.height as usize,
            "texel ({x}, {y}) of {} × {}",
            l.width,
            l.height
        );
        self.mips.fetch(l.offset + y * l.width as usize + x)
    }

    /// Trilinear look-up at OBJ coordinates `uv` (origin at the lower left) and a mip level that
    /// need not be whole; below 0 it is 0, beyond the last it is the last. Safe for any numbers:
    /// what is not finite reads as 0.
    #[inline]
    pub fn sample(&self, uv: Vec2, level: f32) -> [f32; 4] {
        let last = (self.mips.levels.len() - 1) as f32;
        // NaN is not above 0 either.
        let level = if level > 0.0 { level.min(last) } else { 0.0 };
        let low = level as usize;
        let f = level - low as f32;
        let p = self.wrapped(uv);
        let a = self.bilinear(p, low);
        if f <= 0.0 {
            return a;
        }
        let b = self.bilinear(p, low + 1);
        std::array::from_fn(|c| a[c] + (b[c] - a[c]) * f)
    }

    /// Bilinear look-up at one level.
    #[inline]
    pub fn sample_level(&self, uv: Vec2, level: usize) -> [f32; 4] {
        self.bilinear(self.wrapped(uv), level.min(self.mips.levels.len() - 1))
    }

    /// Opacity in [0, 1] of a cut-out mask: its alpha if it has one, else its grey.
    #[inline]
    pub fn mask(&self, uv: Vec2, level: f32) -> f32 {
        let [r, g, b, a] = self.sample(uv, level);
        if self.has_alpha { a } else { (r + g + b) * (1.0 / 3.0) }
    }

    /// The mean over the picture: the last level.
    pub fn mean(&self) -> [f32; 4] {
        self.texel(self.mips.levels.len() - 1, 0, 0)
    }

    /// Position in [0, 1]² from the upper left.
    #[inline]
    fn wrapped(&self, uv: Vec2) -> Vec2 {
        let [su, sv, ou, ov] = self.scale_offset;
        let p = Vec2::new(uv.x * su + ou, 1.0 - (uv.y * sv + ov));
        let p = if self.clamp { p.clamp(Vec2::ZERO, Vec2::ONE) } else { p - p.floor() };
        if p.is_finite() { p } else { Vec2::ZERO }
    }

    #[inline]
    fn bilinear(&self, p: Vec2, level: usize) -> [f32; 4] {
        let l = self.mips.levels[level];
        let (w, h) = (l.width as i32, l.height as i32);
        let x = p.x * w as f32 - 0.5;
        let y = p.y * h as f32 - 0.5;
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let (x0, y0) = (x0 as i32, y0 as i32);
        // p is in [0, 1], so a position leaves the level by at most one texel.
        let fold = |i: i32, n: i32| -> usize {
            let i = if i < 0 {
                if self.clamp { 0 } else { n - 1 }
            } else if i >= n {
                if self.clamp { n - 1 } else { 0 }
            } else {
                i
            };
            i as usize
        };
        let (xa, xb) = (fold(x0, w), fold(x0 + 1, w));
        let (ya, yb) = (fold(y0, h) * w as usize, fold(y0 + 1, h) * w as usize);
        let at = |x: usize, y: usize| self.mips.fetch(l.offset + y + x);
        let (a, b, c, d) = (at(xa, ya), at(xb, ya), at(xa, yb), at(xb, yb));
        std::array::from_fn(|i| {
            let top = a[i] + (b[i] - a[i]) * fx;
            let bottom = c[i] + (d[i] - c[i]) * fx;
            top + (bottom - top) * fy
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checker() -> Texture {
        let texels = (0..16).map(|i| if (i % 4 + i / 4) % 2 == 0 { [255; 4] } else { [0, 0, 0, 255] });
        Texture::new("checker", MipChain::from_rgba8(4, 4, texels.collect(), true))
    }

    #[test]
    fn levels_halve_down_to_one_texel_and_average_linear_light() {
        let t = checker();
        assert_eq!(t.level_count(), 3);
        assert_eq!([t.size(0), t.size(1), t.size(2)], [[4, 4], [2, 2], [1, 1]]);
        // Half of the light, to the nearest sRGB byte (188).
        assert!((t.mean()[0] - 0.5).abs() < 0.005, "{:?}", t.mean());
        assert_eq!(t.mean()[3], 1.0);
    }

    #[test]
    fn odd_sizes_keep_the_mean() {
        let n = 5 * 7;
        let texels: Vec<[f32; 4]> = (0..n).map(|i| [i as f32, 1.0, 0.0, 1.0]).collect();
        let t = Texture::new("odd", MipChain::from_linear(5, 7, texels));
        assert_eq!(t.level_count(), 3);
        assert_eq!(t.size(1), [2, 3]);
        let sizes: Vec<_> = (0..3).map(|l| t.size(l)).collect();
        assert_eq!(sizes[2], [1, 1]);
        assert!((t.mean()[0] - 17.0).abs() < 1e-4, "{:?}", t.mean());
        assert!((t.mean()[1] - 1.0).abs() < 1e-6);
    }

    #[test]
    fn the_origin_is_at_the_lower_left() {
        let texels =
            vec![[1.0, 0.0, 0.0, 1.0], [2.0, 0.0, 0.0, 1.0], [3.0, 0.0, 0.0, 1.0], [4.0, 0.0, 0.0, 1.0]];
        let mut t = Texture::new("quad", MipChain::from_linear(2, 2, texels));
        // Rows from the top: 1 2 / 3 4. Texel centres.
        assert_eq!(t.sample(Vec2::new(0.25, 0.25), 0.0)[0], 3.0);
        assert_eq!(t.sample(Vec2::new(0.75, 0.75), 0.0)[0], 2.0);
        assert_eq!(t.sample(Vec2::new(1.25, -0.75), 0.0)[0], 3.0);
        // The corner blends all four where the texture repeats, and is the nearest where it is clamped.
        assert_eq!(t.sample(Vec2::ZERO, 0.0)[0], 2.5);
        t.clamp = true;
        assert_eq!(t.sample(Vec2::ZERO, 0.0)[0], 3.0);
        assert_eq!(t.sample(Vec2::new(-9.0, 9.0), 0.0)[0], 1.0);
        // Half way between the levels.
        assert!((t.sample(Vec2::new(0.25, 0.25), 0.5)[0] - 2.75).abs() < 1e-6);
    }

    #[test]
    fn any_number_gives_a_colour() {
        let mut t = checker();
        for clamp in [false, true] {
            t.clamp = clamp;
            for v in [
                f32::NAN,
                f32::INFINITY,
                f32::NEG_INFINITY,
                1e30,
                -1e30,
                1e-40,
                -1e-9,
                0.999_999_94,
                16_777_217.0,
            ] {
                for level in [0.0, f32::NAN, f32::INFINITY, -3.0, 1.5, 99.0] {
                    for uv in [Vec2::new(v, 0.3), Vec2::new(0.3, v), Vec2::splat(v)] {
                        assert!(t.sample(uv, level).iter().all(|c| (0.0..=1.0).contains(c)), "{uv} {level}");
                    }
                }
                assert!(t.sample_level(Vec2::splat(v), 77)[0].is_finite());
            }
        }
    }

    #[test]
    fn scale_and_offset_move_the_picture() {
        let mut t = checker();
        t.scale_offset = [2.0, 2.0, 0.25, 0.0];
        let moved = t.sample(Vec2::new(0.0625, 0.0625), 0.0);
        t.scale_offset = [1.0, 1.0, 0.0, 0.0];
        assert_eq!(moved, t.sample(Vec2::new(0.375, 0.125), 0.0));
    }

    #[test]
    fn a_mask_is_alpha_or_grey() {
        let mut t = Texture::new("mask", MipChain::from_rgba8(1, 1, vec![[255, 0, 0, 51]], false));
        assert!((t.mask(Vec2::ZERO, 0.0) - 1.0 / 3.0).abs() < 1e-6);
        t.has_alpha = true;
        assert!((t.mask(Vec2::ZERO, 0.0) - 0.2).abs() < 1e-6);
    }

    #[test]
    fn sixteen_bits_are_kept() {
        let t = Texture::new("height", MipChain::from_rgba16(1, 1, vec![[300, 301, 0, 65535]]));
        let [a, b, _, d] = t.texel(0, 0, 0);
        assert!(a < b && d == 1.0 && t.mips.bytes() == 8);
    }
}
