//! Textures with their mip chains, kept in the file's own precision, and their filtered look-up.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::Vec2;
use rayon::prelude::*;

use super::bulk::BulkReader;
use super::placement::Placement;
use crate::image::{linear_from_srgb, srgb_byte_from_linear};
use crate::math;

/// Bytes of texels that all chains of this process hold now, and the most they ever held.
static HELD: AtomicU64 = AtomicU64::new(0);
static HELD_MAX: AtomicU64 = AtomicU64::new(0);

/// Bytes of texels held by this process: now, and at most since [`forget_most_held`].
pub fn held_bytes() -> (u64, u64) {
    (HELD.load(Ordering::SeqCst), HELD_MAX.load(Ordering::SeqCst))
}

/// Begins anew to look for the most.
pub fn forget_most_held() {
    HELD_MAX.store(HELD.load(Ordering::SeqCst), Ordering::SeqCst);
}

/// Texels that are counted while they exist.
#[derive(Debug)]
struct Counted<T>(Vec<T>);

impl<T> Counted<T> {
    fn new(texels: Vec<T>) -> Self {
        let bytes = (texels.len() * size_of::<T>()) as u64;
        let now = HELD.fetch_add(bytes, Ordering::SeqCst) + bytes;
        HELD_MAX.fetch_max(now, Ordering::SeqCst);
        Self(texels)
    }
}

impl<T> Drop for Counted<T> {
    fn drop(&mut self) {
        HELD.fetch_sub((self.0.len() * size_of::<T>()) as u64, Ordering::SeqCst);
    }
}

/// The texels of one level, shared by all chains that hold it.
#[derive(Clone, Debug)]
pub struct LevelTexels(Texels);

/// How texels are stored.
#[derive(Clone, Debug)]
enum Texels {
    /// 8 bits per channel. RGB is gamma-encoded where `decode` says so.
    Byte(Arc<Counted<[u8; 4]>>),
    /// 16 bits per channel, not gamma-encoded.
    Word(Arc<Counted<[u16; 4]>>),
    /// Linear values.
    Float(Arc<Counted<[f32; 4]>>),
}

impl LevelTexels {
    /// Number of texels.
    fn len(&self) -> usize {
        match &self.0 {
            Texels::Byte(t) => t.0.len(),
            Texels::Word(t) => t.0.len(),
            Texels::Float(t) => t.0.len(),
        }
    }

    /// Bytes of one texel.
    pub fn size(&self) -> usize {
        match &self.0 {
            Texels::Byte(_) => 4,
            Texels::Word(_) => 8,
            Texels::Float(_) => 16,
        }
    }

    /// The texels' memory, little endian.
    pub fn as_bytes(&self) -> &[u8] {
        match &self.0 {
            Texels::Byte(t) => bytemuck::cast_slice(&t.0),
            Texels::Word(t) => bytemuck::cast_slice(&t.0),
            Texels::Float(t) => bytemuck::cast_slice(&t.0),
        }
    }

    /// Texels like these from [`Self::as_bytes`] of another level; `None` where the length is not that of whole texels.
    pub fn of_bytes(&self, bytes: &[u8]) -> Option<Self> {
        Self::of_size(self.size(), bytes)
    }

    /// Texels of `size` bytes each from [`Self::as_bytes`]; `None` where there are none of that size, or the length is not
    /// that of whole ones.
    pub fn of_size(size: usize, bytes: &[u8]) -> Option<Self> {
        if size == 0 || !bytes.len().is_multiple_of(size) {
            return None;
        }
        Some(Self(match size {
            4 => Texels::Byte(Arc::new(Counted::new(bytemuck::pod_collect_to_vec(bytes)))),
            8 => Texels::Word(Arc::new(Counted::new(bytemuck::pod_collect_to_vec(bytes)))),
            16 => Texels::Float(Arc::new(Counted::new(bytemuck::pod_collect_to_vec(bytes)))),
            _ => return None,
        }))
    }

    #[inline]
    fn fetch(&self, at: usize, decode: &[f32; 256]) -> [f32; 4] {
        match &self.0 {
            Texels::Byte(t) => decoded(t.0[at], decode),
            Texels::Word(t) => t.0[at].map(|v| f32::from(v) * (1.0 / 65535.0)),
            Texels::Float(t) => t.0[at],
        }
    }

    /// Texels of the same kind from linear values.
    fn encode(&self, texels: Vec<[f32; 4]>, gamma: bool) -> Self {
        let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
        let color = |v: f32| if gamma { srgb_byte_from_linear(v) } else { byte(v) };
        Self(match &self.0 {
            Texels::Byte(_) => {
                let of = |v: [f32; 4]| [color(v[0]), color(v[1]), color(v[2]), byte(v[3])];
                let bytes = texels.into_par_iter().with_min_len(TEXELS_AT_ONCE).map(of).collect();
                Texels::Byte(Arc::new(Counted::new(bytes)))
            }
            Texels::Word(_) => {
                let of = |v: [f32; 4]| v.map(|v| (v.clamp(0.0, 1.0) * 65535.0 + 0.5) as u16);
                Texels::Word(Arc::new(Counted::new(texels.into_iter().map(of).collect())))
            }
            Texels::Float(_) => Texels::Float(Arc::new(Counted::new(texels))),
        })
    }
}

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
    /// Linear value of each byte of a colour channel.
    decode: Arc<[f32; 256]>,
    gamma: bool,
}

/// The table from byte to linear value.
fn decode_table(gamma: bool) -> Arc<[f32; 256]> {
    Arc::new(std::array::from_fn(|b| {
        let v = b as f32 / 255.0;
        if gamma { linear_from_srgb(v) } else { v }
    }))
}

/// The linear values of a texel of bytes.
#[inline]
fn decoded([r, g, b, a]: [u8; 4], decode: &[f32; 256]) -> [f32; 4] {
    [decode[r as usize], decode[g as usize], decode[b as usize], f32::from(a) * (1.0 / 255.0)]
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
        assert!(!texels.is_empty() && texels.len() == width * height, "a picture of {width} × {height}");
        Self::of(width, height, Texels::Byte(Arc::new(Counted::new(texels))), gamma)
    }

    /// From 16-bit RGBA that is not gamma-encoded.
    ///
    /// # Panics
    /// As [`Self::from_rgba8`].
    pub fn from_rgba16(width: usize, height: usize, texels: Vec<[u16; 4]>) -> Self {
        assert!(!texels.is_empty() && texels.len() == width * height, "a picture of {width} × {height}");
        Self::of(width, height, Texels::Word(Arc::new(Counted::new(texels))), false)
    }

    /// From linear values.
    ///
    /// # Panics
    /// As [`Self::from_rgba8`].
    pub fn from_linear(width: usize, height: usize, texels: Vec<[f32; 4]>) -> Self {
        assert!(!texels.is_empty() && texels.len() == width * height, "a picture of {width} × {height}");
        Self::of(width, height, Texels::Float(Arc::new(Counted::new(texels))), false)
    }

    /// Makes every level below the first: each texel is the mean of the area that it covers, which
    /// at odd sizes takes part of its neighbours' texels, so that every level has the same mean.
    fn of(width: usize, height: usize, finest: Texels, gamma: bool) -> Self {
        let decode = decode_table(gamma);
        let mut levels: Vec<Level> = Vec::new();
        let mut texels = LevelTexels(finest);
        for [w, h] in sizes_of(width, height) {
            if let Some(from) = levels.last() {
                texels = halved(from, &texels, [w, h], &decode, gamma);
            }
            levels.push(Level { width: w, height: h, texels: Some(texels.clone()) });
        }
        Self { levels, finest: 0, decode, gamma }
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
            let texels = match size {
                4 => Texels::Byte(Arc::new(Counted::new(bulk.take(count)?))),
                8 => Texels::Word(Arc::new(Counted::new(bulk.take(count)?))),
                16 => Texels::Float(Arc::new(Counted::new(bulk.take(count)?))),
                _ => return None,
            };
            levels.push(Level { width: w, height: h, texels: Some(LevelTexels(texels)) });
        }
        Some(Self { levels, finest: 0, decode: decode_table(gamma), gamma })
    }

    #[inline]
    fn fetch(&self, level: &Level, at: usize) -> [f32; 4] {
        // Look-ups go to levels that are there.
        level.texels.as_ref().map_or([0.0; 4], |texels| texels.fetch(at, &self.decode))
    }

    /// [`Self::fetch`] of four places, asking once of what kind the texels are.
    #[inline]
    fn fetch_four(&self, level: &Level, at: [usize; 4]) -> [[f32; 4]; 4] {
        let Some(texels) = &level.texels else { return [[0.0; 4]; 4] };
        // Not by `map`, which is called for each and not written out.
        let [a, b, c, d] = at;
        match &texels.0 {
            Texels::Byte(t) => {
                let look = |i: usize| decoded(t.0[i], &self.decode);
                [look(a), look(b), look(c), look(d)]
            }
            _ => {
                let look = |i: usize| texels.fetch(i, &self.decode);
                [look(a), look(b), look(c), look(d)]
            }
        }
    }

    /// A chain with these linear values at its finest level, texel by texel; `None` where one is not known.
    pub fn with_texels(&self, value: impl Fn(usize) -> Option<[f32; 4]>) -> Option<Self> {
        let level = self.levels.first()?;
        let texels = (0..level.width as usize * level.height as usize).map(value).collect::<Option<_>>()?;
        let finest = level.texels.as_ref()?.encode(texels, self.gamma);
        Some(Self::of(level.width as usize, level.height as usize, finest.0, self.gamma))
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
        self.gamma
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
        hasher.update(&[u8::from(self.gamma)]);
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

/// The next coarser level. Rows are made in parallel.
fn halved(
    from: &Level,
    texels: &LevelTexels,
    [w, h]: [u32; 2],
    decode: &[f32; 256],
    gamma: bool,
) -> LevelTexels {
    let columns: Vec<_> = (0..w).map(|x| covered(x, w, from.width)).collect();
    let width = from.width as usize;
    let is_half = (from.width, from.height) == (2 * w, 2 * h);
    let mut out = vec![[0.0f32; 4]; w as usize * h as usize];
    out.par_chunks_mut(w as usize).enumerate().with_min_len(ROWS_AT_ONCE).for_each(|(y, row)| {
        if let (true, Texels::Byte(t)) = (is_half, &texels.0) {
            // The same sums in the same order, without looking for what is covered.
            let rows = t.0[2 * y * width..].split_at(width);
            for (x, sum) in row.iter_mut().enumerate() {
                for t in [rows.0[2 * x], rows.0[2 * x + 1], rows.1[2 * x], rows.1[2 * x + 1]] {
                    let t = decoded(t, decode);
                    for c in 0..4 {
                        sum[c] += 0.25 * t[c];
                    }
                }
            }
            return;
        }
        let (y0, row_weights) = covered(y as u32, h, from.height);
        for ((x0, column_weights), sum) in columns.iter().zip(row) {
            for (dy, wy) in row_weights.iter().enumerate().filter(|(_, w)| **w > 0.0) {
                let row = (y0 + dy) * width;
                for (dx, wx) in column_weights.iter().enumerate().filter(|(_, w)| **w > 0.0) {
                    let t = texels.fetch(row + x0 + dx, decode);
                    for c in 0..4 {
                        sum[c] += wy * wx * t[c];
                    }
                }
            }
        }
    });
    texels.encode(out, gamma)
}

/// Fewer texels are not worth another thread.
const TEXELS_AT_ONCE: usize = 1 << 14;

/// Fewer rows of a level are not worth another thread.
const ROWS_AT_ONCE: usize = 32;

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

    /// Trilinear look-up at OBJ coordinates `uv` (origin at the lower left) and a mip level that
    /// need not be whole; below the finest in memory it is that one, beyond the last it is the last. Safe for any
    /// numbers: what is not finite reads as 0.
    #[inline]
    pub fn sample(&self, uv: Vec2, level: f32) -> [f32; 4] {
        let last = (self.mips.levels.len() - 1) as f32;
        // NaN is not above it either.
        let finest = self.mips.finest as f32;
        let level = if level > finest { level.min(last) } else { finest };
        let low = level as usize;
        let f = level - low as f32;
        let p = self.placement.place(uv);
        if self.placement.nearest && level <= finest {
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

    #[inline]
    fn bilinear(&self, p: Vec2, level: usize) -> [f32; 4] {
        let l = &self.mips.levels[level];
        let (w, h) = (l.width as i32, l.height as i32);
        let x = p.x * w as f32 - 0.5;
        let y = p.y * h as f32 - 0.5;
        let (x0, y0) = (math::floor(x), math::floor(y));
        let (fx, fy) = (x - x0, y - y0);
        let (x0, y0) = (x0 as i32, y0 as i32);
        // p is in [0, 1], so a position leaves the level by at most one texel.
        let [u, v] = self.placement.wrap;
        let (xa, xb) = (u.texel(x0, w), u.texel(x0 + 1, w));
        let (ya, yb) = (v.texel(y0, h) * w as usize, v.texel(y0 + 1, h) * w as usize);
        let [a, b, c, d] = self.mips.fetch_four(l, [ya + xa, ya + xb, yb + xa, yb + xb]);
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

    /// What is halved on the short way has the bits of what shares of texels sum up to.
    #[test]
    fn halves_of_even_sides_are_sums_of_shares() {
        let texels: Vec<[u8; 4]> = (0..16 * 8)
            .map(|i| crate::rng::hash(3, i, 0).to_le_bytes())
            .map(|b| [b[0], b[1], b[2], b[3]])
            .collect();
        for gamma in [true, false] {
            let chain = MipChain::from_rgba8(16, 8, texels.clone(), gamma);
            let table = decode_table(gamma);
            let linear = MipChain::from_linear(16, 8, texels.iter().map(|t| decoded(*t, &table)).collect());
            let Some(LevelTexels(Texels::Float(sums))) = linear.level(1) else {
                panic!("a level of numbers")
            };
            let sums = chain.level(0).unwrap().encode(sums.0.clone(), gamma);
            assert_eq!(sums.as_bytes(), chain.level(1).unwrap().as_bytes());
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
