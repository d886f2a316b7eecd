//! Pictures compressed by Basis Universal in KTX 2 files (`KHR_texture_basisu`), with the feature `basisu`.

use std::panic::{AssertUnwindSafe, catch_unwind};

use basisu::{DecodeFlags, TargetFormat, Transcoder};
use image::{DynamicImage, RgbaImage};

const MAGIC: [u8; 12] = *b"\xabKTX 20\xbb\r\n\x1a\n";

/// Whether a file says that it is a KTX 2 file.
pub(super) fn is_ktx2(bytes: &[u8]) -> bool {
    bytes.starts_with(&MAGIC)
}

fn number(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..at + 4)?.try_into().ok().map(u32::from_le_bytes)
}

/// Columns and rows, as the header says. The error completes "texture …".
pub(super) fn size(bytes: &[u8]) -> Result<(u32, u32), String> {
    number(bytes, 20).zip(number(bytes, 24)).ok_or_else(|| "is a KTX 2 file cut short".to_owned())
}

/// Its finest level; the size has been checked. The error completes "texture …".
pub(super) fn decode(bytes: &[u8]) -> Result<DynamicImage, String> {
    let (w, h) = size(bytes)?;
    // Blocks of sixteen bytes for sixteen texels; a level that unpacks to more is not made room for.
    let most = u64::from(w.div_ceil(4)) * u64::from(h.div_ceil(4)) * 16;
    let unpacked = bytes.get(96..104).and_then(|b| b.try_into().ok()).map_or(0, u64::from_le_bytes);
    let (layers, faces) = (number(bytes, 32).unwrap_or(0), number(bytes, 36).unwrap_or(0));
    if unpacked > most || layers > 1 || faces != 1 {
        return Err(
            "is a KTX 2 file of several pictures, or of other than Basis Universal's blocks".to_owned()
        );
    }
    // The decoder is young: what it did not think of ends here.
    let texels = catch_unwind(AssertUnwindSafe(|| {
        let of = Transcoder::new(bytes)?;
        let texels = of.transcode(0, TargetFormat::Rgba32, DecodeFlags::NONE)?;
        Ok::<_, basisu::Error>((of.has_alpha(), texels))
    }));
    let (has_alpha, texels) = match texels {
        Ok(Ok(texels)) => texels,
        Ok(Err(why)) => return Err(format!("is a KTX 2 file that cannot be read ({why:?})")),
        Err(_) => return Err("is a KTX 2 file that the decoder gave up on".to_owned()),
    };
    let picture = RgbaImage::from_raw(w, h, texels).ok_or("is a KTX 2 file of another size than it says")?;
    let picture = DynamicImage::ImageRgba8(picture);
    Ok(if has_alpha { picture } else { DynamicImage::ImageRgb8(picture.into_rgb8()) })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A picture of blocks of one colour each, in rows.
    pub(in crate::load) fn file(blocks_across: u32, blocks: &[[u8; 4]]) -> Vec<u8> {
        let size = [4 * blocks_across, 4 * blocks.len() as u32 / blocks_across];
        let mut texels = Vec::new();
        for color in blocks {
            // Mode 8: a code of five bits, then the colour.
            let bits = u64::from(u32::from_le_bytes(*color)) << 5 | 0b10111;
            texels.extend(u128::from(bits).to_le_bytes());
        }
        let mut out = MAGIC.to_vec();
        let mut push = |words: &[u32]| words.iter().for_each(|w| out.extend(w.to_le_bytes()));
        // Format, size of types, size, depth, layers, faces, levels, packing; then where things are.
        push(&[0, 1, size[0], size[1], 0, 0, 1, 1, 0, 104, 44, 0, 0, 0, 0, 0, 0]);
        let length = texels.len() as u32;
        push(&[148, 0, length, 0, length, 0]);
        // A descriptor: model 166 (UASTC), sRGB, blocks of 4 × 4, red to alpha in one sample.
        push(&[
            44,
            0,
            2 | 40 << 16,
            166 | 1 << 8 | 2 << 16,
            0x0303,
            16,
            0,
            127 << 16 | 3 << 24,
            0,
            0,
            u32::MAX,
        ]);
        out.extend(texels);
        out
    }

    #[test]
    fn blocks_lie_from_the_upper_left() {
        let colors = [[255, 0, 0, 255], [0, 255, 0, 128], [0, 0, 255, 255], [9, 8, 7, 6]];
        let bytes = file(2, &colors);
        assert!(is_ktx2(&bytes));
        assert_eq!(size(&bytes), Ok((8, 8)));
        let picture = decode(&bytes).unwrap().into_rgba8();
        for (i, color) in colors.iter().enumerate() {
            assert_eq!(picture.get_pixel(4 * (i as u32 % 2) + 1, 4 * (i as u32 / 2) + 2).0, *color);
        }
    }

    #[test]
    fn what_is_broken_or_declares_more_is_refused() {
        let whole = file(1, &[[1, 2, 3, 255]]);
        for length in 0..whole.len() {
            assert!(decode(&whole[..length]).is_err(), "{length}");
        }
        for at in 12..whole.len() {
            for value in [0, 1, 0x7f, 0xff] {
                let mut bytes = whole.clone();
                bytes[at] = value;
                // Larger pictures are refused by whoever asks for the size.
                if size(&bytes).is_ok_and(|(w, h)| w.max(h) < 64)
                    && let Err(why) = decode(&bytes)
                {
                    assert!(why.starts_with("is a KTX 2 file"), "{why}");
                }
            }
        }
        let mut more = whole.clone();
        more[98] = 1;
        assert!(decode(&more).unwrap_err().contains("several pictures"));
    }
}
