//! Maps of one bake as bytes: what a map shares with the first of them (where its elements are, how large they are) takes
//! no room, and what is left is sorted by significance, so that it compresses.
//!
//! In: a map, and the plain bytes of the first one. Out: bytes that give it back to the bit. Bytes that are cut short,
//! altered or of another bake give nothing back, never a panic or a large allocation.

use super::stored::Illumination;

/// Bytes of a number: values lie at the same place modulo so many.
const STRIDE: usize = 4;
/// A block is at most so many times shorter than what it holds.
const EXPANSION_MAX: usize = 255;
/// Plain bytes of the largest map.
const PLAIN_MAX: usize = 1 << 31;

/// A map as plain bytes; `None` for one that is too large.
pub fn plain(map: &Illumination) -> Option<Vec<u8>> {
    map.to_plain().filter(|plain| plain.len() <= PLAIN_MAX)
}

/// A map's plain bytes against those of the `first` one, which may be empty.
pub fn pack(plain: &[u8], first: &[u8]) -> Vec<u8> {
    let mut sorted = vec![0; plain.len()];
    let (words, last) = plain.as_chunks::<STRIDE>();
    let (shared, _) = first.as_chunks::<STRIDE>();
    let mut rest = &mut sorted[..];
    for plane in 0..STRIDE {
        let (bytes, behind) = rest.split_at_mut(plane_of(plain.len(), plane));
        rest = behind;
        let (bytes, beyond) = bytes.split_at_mut(words.len());
        bytes.iter_mut().zip(words).for_each(|(byte, word)| *byte = word[plane]);
        bytes.iter_mut().zip(shared).for_each(|(byte, first)| *byte ^= first[plane]);
        // What is behind the last word of either.
        let at = |word: usize| first.get(word * STRIDE + plane).copied().unwrap_or_default();
        bytes.get_mut(shared.len()).into_iter().for_each(|byte| *byte ^= at(shared.len()));
        beyond.iter_mut().zip(last.get(plane)).for_each(|(byte, last)| *byte = last ^ at(words.len()));
    }
    lz4_flex::block::compress_prepend_size(&sorted)
}

/// The plain bytes behind what [`pack`] made.
pub fn unpack(packed: &[u8], first: &[u8]) -> Option<Vec<u8>> {
    let (size, block) = packed.split_first_chunk::<4>()?;
    let size = u32::from_le_bytes(*size) as usize;
    if size > PLAIN_MAX || size / EXPANSION_MAX > block.len() {
        return None;
    }
    let sorted = lz4_flex::block::decompress(block, size).ok().filter(|sorted| sorted.len() == size)?;
    let mut plain = vec![0; size];
    let mut rest = &sorted[..];
    let planes: [&[u8]; STRIDE] = std::array::from_fn(|plane| {
        let (bytes, behind) = rest.split_at(plane_of(size, plane));
        rest = behind;
        bytes
    });
    // Words of slices of one length, which the compiler joins by vectors: a seek waits for it.
    let (words, last) = plain.as_chunks_mut::<STRIDE>();
    let count = words.len();
    let [a, b, c, d] = planes.map(|plane| &plane[..count]);
    let word = |at: usize| {
        u32::from(a[at]) | u32::from(b[at]) << 8 | u32::from(c[at]) << 16 | u32::from(d[at]) << 24
    };
    let (shared, _) = first.as_chunks::<STRIDE>();
    let shared = &shared[..shared.len().min(count)];
    let (against, alone) = words.split_at_mut(shared.len());
    for (at, (into, first)) in against.iter_mut().zip(shared).enumerate() {
        *into = (word(at) ^ u32::from_le_bytes(*first)).to_le_bytes();
    }
    alone.iter_mut().zip(shared.len()..).for_each(|(into, at)| *into = word(at).to_le_bytes());
    last.iter_mut().zip(planes).for_each(|(byte, plane)| *byte = plane[count]);
    // What is behind the last word of either.
    let behind = shared.len() * STRIDE;
    let left = first.get(behind..).unwrap_or_default();
    plain[behind..].iter_mut().zip(left).for_each(|(byte, first)| *byte ^= first);
    Some(plain)
}

/// Bytes of so many that lie in a plane.
fn plane_of(size: usize, plane: usize) -> usize {
    size.saturating_sub(plane).div_ceil(STRIDE)
}

/// The map of plain bytes, if it fits a scene of `triangles` triangles.
pub fn map(plain: &[u8], triangles: usize) -> Option<Illumination> {
    let map = Illumination::from_plain(plain)?;
    (map.triangle_count() == triangles && map.is_sound()).then_some(map)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Accel;
    use crate::illumination::bake::{BakeSettings, Baker, Step};
    use crate::illumination::first::first_picture;
    use crate::illumination::test_scenes::{cube, lambert, scene};
    use crate::scene::Light;
    use crate::transport::Indexed;
    use crate::transport::light::Lights;
    use glam::Vec3;
    use std::sync::Arc;

    /// The maps of a bake, as they are published.
    fn maps() -> Vec<Arc<Illumination>> {
        let mesh = cube(Vec3::splat(-1.0), 2.0, false);
        let scene = scene(mesh, vec![lambert(0.5, 0.2)], Vec::<Light>::new());
        let (accel, lights) = (Accel::build(&scene), Lights::build(&scene));
        let indexed = Indexed { scene: &scene, accel: &accel, lights: &lights };
        let first = first_picture(indexed, 1);
        let settings =
            BakeSettings { texels: 2048, seed: 1, everything: true, particles: Some(1 << 16), error: None };
        let mut baker = Baker::new(indexed, &settings);
        baker.begin_with(&first);
        let mut maps = vec![baker.map().clone()];
        loop {
            match baker.step(indexed) {
                Step::Going => {}
                Step::Better(map) => maps.push(map),
                Step::Done(map) => {
                    maps.push(map);
                    return maps;
                }
            }
        }
    }

    #[test]
    fn maps_come_back_to_the_bit_and_share_what_is_the_same() {
        let maps = maps();
        assert!(maps.len() > 2, "{} maps", maps.len());
        let first = plain(&maps[0]).expect("bytes");
        for of in &maps {
            let bytes = plain(of).expect("bytes");
            let packed = pack(&bytes, &first);
            assert!(packed.len() < bytes.len(), "{} of {} bytes", packed.len(), bytes.len());
            let back = unpack(&packed, &first).and_then(|plain| map(&plain, of.triangle_count()));
            assert_eq!(back.as_ref(), Some(&**of));
            assert_eq!(map(&bytes, of.triangle_count() + 1), None, "of another scene");
            for cut in [0, 3, 4, packed.len() / 2, packed.len() - 1] {
                assert_eq!(unpack(&packed[..cut], &first), None, "cut at {cut}");
            }
            // More than there is.
            assert_eq!(unpack(&[255, 255, 255, 127, 0], &first), None);
        }
    }

    /// Whatever is longer, and by whatever few bytes.
    #[test]
    fn bytes_of_any_length_come_back() {
        let bytes = |count: usize, by: usize| (0..count).map(|i| (i * by) as u8).collect::<Vec<_>>();
        for length in 0..24 {
            for shared in 0..24 {
                let (plain, first) = (bytes(length, 7), bytes(shared, 5));
                let packed = pack(&plain, &first);
                assert_eq!(unpack(&packed, &first), Some(plain), "{length} against {shared}");
            }
        }
    }
}
