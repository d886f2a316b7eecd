//! Textures with their mip chains, kept in the file's own precision, and their filtered look-up.

use std::collections::HashMap;
use std::sync::Arc;

use glam::Vec2;
use rayon::prelude::*;

use super::bulk::BulkReader;
use super::placement::{Placement, Wrap};
use super::texels::Decode;
pub use super::texels::{LevelTexels, Pixels, forget_most_held, held_bytes};
use crate::math;

/// One level of a chain.
#[derive(Clone, Debug)]
struct Level {
    width: u32,
    height: u32,
    /// `None` where it is not in memory.
    texels: Option<LevelTexels>,
}

/// The pixels of one picture at full size and, by a box filter, at every half of it down to 1 × 1.
///
/// 8-bit pictures stay at 4 bytes per texel (a 3000 × 2139 picture needs 34 MB, not 137); smaller
/// levels are filtered in linear light and rounded to the same encoding, as a GPU's sRGB format does.
/// The finest levels may be absent; look-ups then read the finest that is there. The last is always there.
#[derive(Clone, Debug)]
pub struct MipChain {
    levels: Vec<Level>,
    /// The finest level in memory.
    finest: usize,
    decode: &'static Decode,
}

/// Columns and rows of each level of a picture.
fn sizes_of(width: usize, height: usize) -> Vec<[u32; 2]> {
    let (mut w, mut h) = (width.max(1), height.max(1));
    let mut sizes = Vec::new();
    loop {
        sizes.push([w as u32, h as u32]);
        if w == 1 && h == 1 {
            return sizes;
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
        Self::alone(width, height, Pixels::Byte { texels, gamma }).completed()
    }

    /// From 16-bit RGBA that is not gamma-encoded.
    ///
    /// # Panics
    /// As [`Self::from_rgba8`].
    pub fn from_rgba16(width: usize, height: usize, texels: Vec<[u16; 4]>) -> Self {
        Self::alone(width, height, Pixels::Word(texels)).completed()
    }

    /// From linear values.
    ///
    /// # Panics
    /// As [`Self::from_rgba8`].
    pub fn from_linear(width: usize, height: usize, texels: Vec<[f32; 4]>) -> Self {
        Self::alone(width, height, Pixels::Float(texels)).completed()
    }

    /// The finest level without the others, for pictures that others are made of. It has no [mean](Texture::mean) and nothing
    /// coarser to look up before it is [completed](Self::completed).
    ///
    /// # Panics
    /// As [`Self::from_rgba8`].
    pub fn alone(width: usize, height: usize, pixels: Pixels) -> Self {
        let (texels, gamma) = LevelTexels::of(pixels);
        let fits = texels.len() > 0 && texels.len() == width * height;
        assert!(fits, "a picture of {width} × {height}");
        let finest = Level { width: width as u32, height: height as u32, texels: Some(texels) };
        Self { levels: vec![finest], finest: 0, decode: Decode::shared(gamma) }
    }

    /// Whether all levels are there or have been.
    pub fn is_complete(&self) -> bool {
        self.levels.last().is_some_and(|last| (last.width, last.height) == (1, 1))
    }

    /// With every level below the first: each texel is the mean of the area that it covers, which
    /// at odd sizes takes part of its neighbours' texels, so that every level has the same mean.
    pub fn completed(mut self) -> Self {
        while let Some(Level { width, height, texels: Some(texels) }) = self.levels.last()
            && (*width, *height) != (1, 1)
        {
            let [w, h] = [*width, *height].map(|n| (n / 2).max(1));
            let texels = texels.halved([*width, *height], [w, h], self.decode);
            self.levels.push(Level { width: w, height: h, texels: Some(texels) });
        }
        self
    }

    /// A chain of the next lists, of texels of `size` bytes each, the finest level first.
    pub fn take(
        width: usize,
        height: usize,
        gamma: bool,
        size: usize,
        bulk: &mut BulkReader<'_>,
    ) -> Option<Self> {
        let mut levels = Vec::new();
        for [w, h] in sizes_of(width, height) {
            let count = (w as usize).checked_mul(h as usize)?;
            let texels = LevelTexels::take(size, count, bulk)?;
            levels.push(Level { width: w, height: h, texels: Some(texels) });
        }
        Some(Self { levels, finest: 0, decode: Decode::shared(gamma) })
    }

    #[inline]
    fn fetch(&self, level: &Level, at: usize) -> [f32; 4] {
        // Look-ups go to levels that are there.
        level.texels.as_ref().map_or([0.0; 4], |texels| texels.fetch(at, self.decode))
    }

    /// [`Self::fetch`] of four places, asking once of what kind the texels are.
    #[inline]
    fn fetch_four(&self, level: &Level, at: [usize; 4]) -> [[f32; 4]; 4] {
        level.texels.as_ref().map_or([[0.0; 4]; 4], |texels| texels.fetch_four(at, self.decode))
    }

    /// A chain with these linear values at its finest level, texel by texel, and as complete as this one; `None` where one is
    /// not known.
    pub fn with_texels(&self, value: impl Fn(usize) -> Option<[f32; 4]> + Send + Sync) -> Option<Self> {
        let level = self.levels.first()?;
        let count = level.width as usize * level.height as usize;
        let texels = (0..count).into_par_iter().map(value).collect::<Option<_>>()?;
        let finest = level.texels.as_ref()?.encode(texels, self.decode.gamma);
        let alone = Self { levels: vec![Level { texels: Some(finest), ..*level }], ..self.clone() };
        Some(if self.is_complete() { alone.completed() } else { alone })
    }

    /// Number of levels, at least 1.
    pub fn level_count(&self) -> usize {
        self.levels.len()
    }

    /// The finest level in memory.
    #[inline]
    pub fn finest(&self) -> usize {
        self.finest
    }

    /// Whether the bytes of colour channels are sRGB-encoded.
    pub fn is_gamma_encoded(&self) -> bool {
        self.decode.gamma
    }

    /// Bytes of all texels, in memory or not.
    pub fn bytes(&self) -> usize {
        (0..self.levels.len()).map(|level| self.level_bytes(level)).sum()
    }

    /// Bytes of one level's texels, in memory or not.
    pub fn level_bytes(&self, level: usize) -> usize {
        let size = self.levels.last().and_then(|l| l.texels.as_ref()).map_or(4, LevelTexels::size);
        self.levels.get(level).map_or(0, |l| l.width as usize * l.height as usize * size)
    }

    /// Bytes of the texels in memory.
    pub fn resident_bytes(&self) -> usize {
        (self.finest..self.levels.len()).map(|level| self.level_bytes(level)).sum()
    }

    /// The texels of a level, if it is in memory.
    pub fn level(&self, level: usize) -> Option<&LevelTexels> {
        self.levels.get(level)?.texels.as_ref()
    }

    /// The chain without the levels finer than `finest`; the last always stays.
    pub fn without_finer(&self, finest: usize) -> Self {
        let finest = finest.clamp(self.finest, self.levels.len() - 1);
        let mut chain = self.clone();
        chain.levels[..finest].iter_mut().for_each(|level| level.texels = None);
        chain.finest = finest;
        chain
    }

    /// The chain with the next finer level, whose texels must be of its size; `None` where they are not or none is absent.
    pub fn with_finer(&self, texels: LevelTexels) -> Option<Self> {
        let finest = self.finest.checked_sub(1)?;
        let level = &self.levels[finest];
        let fits = texels.len() == level.width as usize * level.height as usize;
        let same = texels.size() == self.levels.last()?.texels.as_ref()?.size();
        let mut chain = self.clone();
        chain.levels[finest].texels = Some(texels);
        chain.finest = finest;
        (fits && same).then_some(chain)
    }

    /// BLAKE3 of what its levels hold, as far as they are in memory, and of how they are read.
    pub fn content_hash(&self) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&[u8::from(self.decode.gamma)]);
        for level in &self.levels {
            hasher.update(&level.width.to_le_bytes());
            hasher.update(&level.height.to_le_bytes());
            if let Some(texels) = &level.texels {
                hasher.update(&[texels.size() as u8]);
                hasher.update(texels.as_bytes());
            }
        }
        *hasher.finalize().as_bytes()
    }
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
    /// How it lies on surfaces.
    pub placement: Placement,
}

impl Texture {
    /// A repeated colour texture of these pixels.
    pub fn new(name: impl Into<String>, mips: MipChain) -> Self {
        Self {
            name: name.into(),
            mips: Arc::new(mips),
            has_alpha: false,
            is_color: true,
            placement: Placement::default(),
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
        let l = &self.mips.levels[level.min(self.mips.levels.len() - 1)];
        [l.width as usize, l.height as usize]
    }

    /// The texel at column `x`, row `y` (from the top) of a level in memory, linear RGB and alpha; of one that is not,
    /// black.
    ///
    /// # Panics
    /// If `x` or `y` is outside of the level: a bug of the caller.
    #[inline]
    pub fn texel(&self, level: usize, x: usize, y: usize) -> [f32; 4] {
        let l = &self.mips.levels[level.min(self.mips.levels.len() - 1)];
        assert!(
            x < l.width as usize && y < l.height as usize,
            "texel ({x}, {y}) of {} × {}",
            l.width,
            l.height
        );
        self.mips.fetch(l, y * l.width as usize + x)
    }

    /// Reads as many texels of row `y` (from the top) of the finest level as `row` has places, as [`Self::texel`] does.
    ///
    /// # Panics
    /// If there are fewer: a bug of the caller.
    pub fn row(&self, y: usize, row: &mut [[f32; 4]]) {
        let first = y * self.size(0)[0];
        if let Some(texels) = self.mips.level(0) {
            texels.read(first, row, self.mips.decode);
        }
    }

    /// Trilinear look-up at OBJ coordinates `uv` (origin at the lower left) and a mip level that
    /// need not be whole; below the finest in memory it is that one, beyond the last it is the last. Safe for any
    /// numbers: what is not finite reads as 0.
    #[inline]
    pub fn sample(&self, uv: Vec2, level: f32) -> [f32; 4] {
        let (low, f) = self.levels_at(level);
        let p = self.placement.place(uv);
        if self.placement.nearest && low == self.mips.finest && f <= 0.0 {
            let [w, h] = self.size(low);
            let at = |v: f32, n: usize| ((v * n as f32) as usize).min(n - 1);
            return self.texel(low, at(p.x, w), at(p.y, h));
        }
        let a = self.bilinear(p, low);
        if f <= 0.0 {
            return a;
        }
        let b = self.bilinear(p, low + 1);
        std::array::from_fn(|c| a[c] + (b[c] - a[c]) * f)
    }

    /// [`Self::sample`] of this texture and of one of the same size that lies on it, in one look.
    #[inline]
    pub fn sample_with(&self, other: &Self, uv: Vec2, level: f32) -> [[f32; 4]; 2] {
        let have_the_same_levels = self.size(0) == other.size(0) && self.mips.finest == other.mips.finest;
        if !have_the_same_levels || self.placement.nearest {
            return [self, other].map(|t| t.sample(uv, level));
        }
        let (low, f) = self.levels_at(level);
        let p = self.placement.place(uv);
        let look = |level: usize| {
            let spot = self.spot(p, level);
            let (Some(first), Some(second)) = (self.mips.level(level), other.mips.level(level)) else {
                return [[0.0; 4]; 2];
            };
            let decode = [self.mips.decode, other.mips.decode];
            let [first, second] = LevelTexels::fetch_both([first, second], spot.at, decode);
            [spot.mean(first), spot.mean(second)]
        };
        let a = look(low);
        if f <= 0.0 {
            return a;
        }
        let b = look(low + 1);
        std::array::from_fn(|t| std::array::from_fn(|c| a[t][c] + (b[t][c] - a[t][c]) * f))
    }

    /// The finer of the levels in memory that a level lies between, and how far it is on the way to the next.
    #[inline]
    fn levels_at(&self, level: f32) -> (usize, f32) {
        let last = (self.mips.levels.len() - 1) as f32;
        // NaN is not above it either.
        let finest = self.mips.finest as f32;
        let level = if level > finest { level.min(last) } else { finest };
        let low = level as usize;
        (low, level - low as f32)
    }

    /// Opacity in [0, 1] of a cut-out mask: its alpha if it has one, else its grey.
    #[inline]
    pub fn mask(&self, uv: Vec2, level: f32) -> f32 {
        let [r, g, b, a] = self.sample(uv, level);
        if self.has_alpha { a } else { (r + g + b) * (1.0 / 3.0) }
    }

    /// The mean over the picture: the last level.
    pub fn mean(&self) -> [f32; 4] {
        debug_assert!(self.mips.is_complete(), "a chain with all of its levels");
        self.texel(self.mips.levels.len() - 1, 0, 0)
    }

    #[inline]
    fn bilinear(&self, p: Vec2, level: usize) -> [f32; 4] {
        let spot = self.spot(p, level);
        spot.mean(self.mips.fetch_four(&self.mips.levels[level], spot.at))
    }

    /// Where a position in [0, 1]² lies in a level.
    #[inline]
    fn spot(&self, p: Vec2, level: usize) -> Spot {
        let l = &self.mips.levels[level];
        let [u, v] = self.placement.wrap;
        let (x, y) = (Between::at(p.x, l.width as i32, u), Between::at(p.y, l.height as i32, v));
        let (ya, yb) = (y.low * l.width as usize, y.high * l.width as usize);
        Spot { at: [ya + x.low, ya + x.high, yb + x.low, yb + x.high], fx: x.share, fy: y.share }
    }
}

/// A place between two columns, or two rows.
#[derive(Clone, Copy, Debug)]
pub struct Between {
    /// The one before, or the one that wrapping makes of it.
    pub low: usize,
    /// The one behind.
    pub high: usize,
    /// How far it is on the way from the one to the other.
    pub share: f32,
}

impl Between {
    /// Of a position in [0, 1] among `n` columns.
    #[inline]
    pub fn at(p: f32, n: i32, wrap: Wrap) -> Self {
        let x = p * n as f32 - 0.5;
        let low = math::floor(x);
        let share = x - low;
        let low = low as i32;
        // p is in [0, 1], so a position leaves the level by at most one texel.
        Self { low: wrap.texel(low, n), high: wrap.texel(low + 1, n), share }
    }
}

/// A place between four texels of a level.
struct Spot {
    at: [usize; 4],
    fx: f32,
    fy: f32,
}

impl Spot {
    /// What lies there between the four.
    #[inline]
    fn mean(&self, texels: [[f32; 4]; 4]) -> [f32; 4] {
        mean(texels, self.fx, self.fy)
    }
}

/// What lies between two texels above and two below, so far to the right and down.
#[inline]
pub fn mean([a, b, c, d]: [[f32; 4]; 4], fx: f32, fy: f32) -> [f32; 4] {
    std::array::from_fn(|i| {
        let top = a[i] + (b[i] - a[i]) * fx;
        let bottom = c[i] + (d[i] - c[i]) * fx;
        top + (bottom - top) * fy
    })
}

/// Gives those textures all levels that can be made of the finest; what shares its pixels goes on sharing them.
pub fn complete(textures: &mut [Texture], which: impl Fn(&Texture) -> bool) {
    let mut chains: Vec<Arc<MipChain>> = Vec::new();
    let mut places = Vec::new();
    let mut known: HashMap<*const MipChain, usize> = HashMap::new();
    for (i, t) in textures.iter().enumerate().filter(|(_, t)| which(t) && !t.mips.is_complete()) {
        let place = *known.entry(Arc::as_ptr(&t.mips)).or_insert_with(|| {
            chains.push(t.mips.clone());
            chains.len() - 1
        });
        places.push((i, place));
    }
    let made: Vec<_> = chains.par_iter().map(|c| Arc::new(MipChain::clone(c).completed())).collect();
    for (i, place) in places {
        textures[i].mips = made[place].clone();
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
    fn a_level_alone_becomes_the_same_chain() {
        let texels: Vec<[u8; 4]> = (0..35u8).map(|i| [i, 7 * i, 250 - i, 3 * i]).collect();
        let full = MipChain::from_rgba8(5, 7, texels.clone(), true);
        let alone = MipChain::alone(5, 7, Pixels::Byte { texels, gamma: true });
        assert!((alone.level_count(), alone.is_complete()) == (1, false) && full.is_complete());
        let again = alone.with_texels(|i| Some(alone.fetch(&alone.levels[0], i))).unwrap();
        assert_eq!(again.level_count(), 1);
        for chain in [alone, again] {
            assert_eq!(chain.completed().content_hash(), full.content_hash());
        }
    }

    #[test]
    fn levels_come_and_go() {
        let full = checker();
        let mut t = full.clone();
        t.mips = Arc::new(full.mips.without_finer(1));
        assert_eq!((t.mips.finest(), t.mips.resident_bytes(), t.mips.bytes()), (1, 20, 84));
        let uv = Vec2::new(0.3, 0.6);
        assert_eq!(t.sample(uv, 0.0), full.sample(uv, 1.0));
        let finest = full.mips.level(0).unwrap();
        let copy = t.mips.level(1).unwrap().of_bytes(finest.as_bytes()).unwrap();
        t.mips = Arc::new(t.mips.with_finer(copy).unwrap());
        assert_eq!(t.sample(uv, 0.0), full.sample(uv, 0.0));
        assert_eq!(t.mips.content_hash(), full.mips.content_hash());
        // Too much, too little, of another kind, or nothing absent.
        assert!(t.mips.with_finer(finest.clone()).is_none());
        let coarse = full.mips.without_finer(9);
        assert_eq!(coarse.finest(), 2);
        assert!(coarse.with_finer(finest.clone()).is_none());
        assert!(finest.of_bytes(&[1, 2, 3]).is_none());
        assert!(held_bytes().0 >= 84 && held_bytes().1 >= held_bytes().0);
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
        t.placement = Placement::clamped(true);
        assert_eq!(t.sample(Vec2::ZERO, 0.0)[0], 3.0);
        assert_eq!(t.sample(Vec2::new(-9.0, 9.0), 0.0)[0], 1.0);
        // Half way between the levels.
        assert!((t.sample(Vec2::new(0.25, 0.25), 0.5)[0] - 2.75).abs() < 1e-6);
    }

    #[test]
    fn any_number_gives_a_colour() {
        let mut t = checker();
        for clamp in [false, true] {
            t.placement = Placement::clamped(clamp);
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
                assert!(t.sample(Vec2::splat(v), 77.0)[0].is_finite());
            }
        }
    }

    #[test]
    fn two_looks_at_once_are_the_same_as_two() {
        let of = |seed: u64, n: u64| -> Vec<[u8; 4]> {
            (0..n).map(|i| (crate::rng::hash(seed, i, 0) as u32).to_le_bytes()).collect()
        };
        let words = of(3, 64).into_iter().map(|t| t.map(u16::from)).collect();
        let a = Texture::new("a", MipChain::from_rgba8(16, 4, of(1, 64), true));
        let b = Texture::new("b", MipChain::from_rgba8(16, 4, of(2, 64), false));
        let coarse = Texture { mips: Arc::new(b.mips.without_finer(1)), ..b.clone() };
        let nearest = Placement { nearest: true, ..Placement::default() };
        let others = [
            Texture::new("words", MipChain::from_rgba16(16, 4, words)),
            Texture::new("of another size", MipChain::from_rgba8(4, 4, of(4, 16), true)),
            coarse,
            b,
        ];
        for placement in [Placement::default(), nearest, Placement::clamped(true)] {
            for other in &others {
                let [a, other] = [&a, other].map(|t| Texture { placement, ..t.clone() });
                for i in 0..200u64 {
                    let [u, v, level, _] = (crate::rng::hash(5, i, 0) as u32).to_le_bytes().map(f32::from);
                    let (uv, level) = (Vec2::new(u / 99.0 - 1.0, v / 99.0 - 1.0), level / 50.0 - 1.0);
                    let both = [a.sample(uv, level), other.sample(uv, level)];
                    assert_eq!(a.sample_with(&other, uv, level), both, "{} {uv} {level}", other.name);
                }
            }
        }
    }

    #[test]
    fn scale_and_offset_move_the_picture() {
        let mut t = checker();
        t.placement.scale_offset = [2.0, 2.0, 0.25, 0.0];
        let moved = t.sample(Vec2::new(0.0625, 0.0625), 0.0);
        t.placement.scale_offset = [1.0, 1.0, 0.0, 0.0];
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
