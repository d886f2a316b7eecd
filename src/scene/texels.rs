//! How the texels of one level lie in memory, and what they hold: bytes as the file has them, words, or numbers.
//!
//! In: pixels, or the bytes of a level that was kept. Out: linear values, texel by texel, and the next coarser level. How
//! many bytes there are in the process is counted.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, LazyLock};

use super::box_filter::{halved, halved_bytes};
use super::bulk::BulkReader;
use crate::image::{linear_from_srgb, srgb_byte_from_linear};

/// The pixels of one picture, RGBA in rows from the top.
pub enum Pixels {
    /// 8 bits per channel.
    Byte {
        /// RGBA.
        texels: Vec<[u8; 4]>,
        /// Whether RGB is sRGB-encoded.
        gamma: bool,
    },
    /// 16 bits per channel, linear.
    Word(Vec<[u16; 4]>),
    /// Linear values.
    Float(Vec<[f32; 4]>),
}

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
    /// 8 bits per channel. RGB is gamma-encoded where [`Decode`] says so.
    Byte(Arc<Counted<[u8; 4]>>),
    /// 16 bits per channel, not gamma-encoded.
    Word(Arc<Counted<[u16; 4]>>),
    /// Linear values.
    Float(Arc<Counted<[f32; 4]>>),
}

impl LevelTexels {
    /// Number of texels.
    pub(super) fn len(&self) -> usize {
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
            4 => Texels::Byte(counted(bytemuck::pod_collect_to_vec(bytes))),
            8 => Texels::Word(counted(bytemuck::pod_collect_to_vec(bytes))),
            16 => Texels::Float(counted(bytemuck::pod_collect_to_vec(bytes))),
            _ => return None,
        }))
    }

    #[inline]
    pub(super) fn fetch(&self, at: usize, decode: &Decode) -> [f32; 4] {
        match &self.0 {
            Texels::Byte(t) => decode.linear(t.0[at]),
            Texels::Word(t) => of_words(t.0[at]),
            Texels::Float(t) => t.0[at],
        }
    }

    /// As many texels as `out` has places, from one on.
    ///
    /// # Panics
    /// If there are fewer: a bug of the caller.
    pub(super) fn read(&self, first: usize, out: &mut [[f32; 4]], decode: &Decode) {
        let those = first..first + out.len();
        match &self.0 {
            Texels::Byte(t) => {
                t.0[those].iter().zip(out).for_each(|(t, out)| *out = decode.linear(*t));
            }
            Texels::Word(t) => t.0[those].iter().zip(out).for_each(|(t, out)| *out = of_words(*t)),
            Texels::Float(t) => out.copy_from_slice(&t.0[those]),
        }
    }

    /// The texels at four places, asking once of what kind they are.
    #[inline]
    pub(super) fn fetch_four(&self, at: [usize; 4], decode: &Decode) -> [[f32; 4]; 4] {
        // Not by `map`, which is called for each and not written out.
        let [a, b, c, d] = at;
        match &self.0 {
            Texels::Byte(t) => {
                let look = |i: usize| decode.linear(t.0[i]);
                [look(a), look(b), look(c), look(d)]
            }
            _ => {
                let look = |i: usize| self.fetch(i, decode);
                [look(a), look(b), look(c), look(d)]
            }
        }
    }

    /// [`Self::fetch_four`] of two levels.
    #[inline]
    pub(super) fn fetch_both(of: [&Self; 2], at: [usize; 4], decode: [&Decode; 2]) -> [[[f32; 4]; 4]; 2] {
        let (Texels::Byte(first), Texels::Byte(second)) = (&of[0].0, &of[1].0) else {
            return [of[0].fetch_four(at, decode[0]), of[1].fetch_four(at, decode[1])];
        };
        // What the processor has to wait for is asked for at once.
        let [i, j, k, l] = at;
        let [a, b, c, d] = [first.0[i], first.0[j], first.0[k], first.0[l]];
        let [e, f, g, h] = [second.0[i], second.0[j], second.0[k], second.0[l]];
        let ([of_first, of_second], look) = (decode, Decode::linear);
        [
            [look(of_first, a), look(of_first, b), look(of_first, c), look(of_first, d)],
            [look(of_second, e), look(of_second, f), look(of_second, g), look(of_second, h)],
        ]
    }

    /// Those of a picture, and whether its colours are gamma-encoded.
    pub(super) fn of(pixels: Pixels) -> (Self, bool) {
        let (texels, gamma) = match pixels {
            Pixels::Byte { texels, gamma } => (Texels::Byte(counted(texels)), gamma),
            Pixels::Word(texels) => (Texels::Word(counted(texels)), false),
            Pixels::Float(texels) => (Texels::Float(counted(texels)), false),
        };
        (Self(texels), gamma)
    }

    /// So many texels of `size` bytes each from a list that was kept.
    pub(super) fn take(size: usize, count: usize, bulk: &mut BulkReader<'_>) -> Option<Self> {
        Some(Self(match size {
            4 => Texels::Byte(counted(bulk.take(count)?)),
            8 => Texels::Word(counted(bulk.take(count)?)),
            16 => Texels::Float(counted(bulk.take(count)?)),
            _ => return None,
        }))
    }

    /// Texels of the same kind from linear values.
    pub(super) fn encode(&self, texels: Vec<[f32; 4]>, gamma: bool) -> Self {
        let color = |v: f32| if gamma { srgb_byte_from_linear(v) } else { byte(v) };
        let bytes = |v: [f32; 4]| [color(v[0]), color(v[1]), color(v[2]), byte(v[3])];
        Self(match &self.0 {
            Texels::Byte(_) => Texels::Byte(counted(texels.into_iter().map(bytes).collect())),
            Texels::Word(_) => Texels::Word(counted(texels.into_iter().map(words).collect())),
            Texels::Float(_) => Texels::Float(counted(texels)),
        })
    }

    /// Those of the next coarser level, of `to` columns and rows.
    pub(super) fn halved(&self, from: [u32; 2], to: [u32; 2], decode: &Decode) -> Self {
        Self(match &self.0 {
            Texels::Byte(t) => Texels::Byte(counted(halved_bytes(from, to, &t.0, decode))),
            Texels::Word(t) => Texels::Word(counted(halved(from, to, |at| of_words(t.0[at]), words))),
            Texels::Float(t) => Texels::Float(counted(halved(from, to, |at| t.0[at], |v| v))),
        })
    }
}

fn counted<T>(texels: Vec<T>) -> Arc<Counted<T>> {
    Arc::new(Counted::new(texels))
}

fn byte(v: f32) -> u8 {
    (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}

fn words(v: [f32; 4]) -> [u16; 4] {
    v.map(|v| (v.clamp(0.0, 1.0) * 65535.0 + 0.5) as u16)
}

#[inline]
fn of_words(t: [u16; 4]) -> [f32; 4] {
    t.map(|v| f32::from(v) * (1.0 / 65535.0))
}

/// How bytes become linear values.
#[derive(Debug)]
pub(super) struct Decode {
    /// Of each byte of a colour channel.
    pub color: [f32; 256],
    /// Whether those are gamma-encoded.
    pub gamma: bool,
}

impl Decode {
    fn new(gamma: bool) -> Self {
        let linear = |b: usize| {
            let v = b as f32 / 255.0;
            if gamma { linear_from_srgb(v) } else { v }
        };
        Self { color: std::array::from_fn(linear), gamma }
    }

    /// The one of all chains.
    pub fn shared(gamma: bool) -> &'static Self {
        static OF: [LazyLock<Decode>; 2] =
            [LazyLock::new(|| Decode::new(false)), LazyLock::new(|| Decode::new(true))];
        &OF[usize::from(gamma)]
    }

    /// The linear values of a texel.
    #[inline]
    pub fn linear(&self, [r, g, b, a]: [u8; 4]) -> [f32; 4] {
        let color = |byte: u8| self.color[usize::from(byte)];
        [color(r), color(g), color(b), f32::from(a) * (1.0 / 255.0)]
    }
}
