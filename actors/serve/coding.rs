//! A picture as bytes: JPEG of what has changed while it does, without loss once it is still.
//!
//! Tiles that have changed go out together, as one picture that has them side by side: so tables, which are as long as a
//! small tile itself, are sent once, and a page decodes one picture.

use foveal::image::Map2d;
use image_webp::{ColorType as WebpColor, WebPEncoder};
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};

/// Where more than this share of the picture has changed, all of it is sent.
const PART: f64 = 0.4;
/// Columns and rows of a tile: whole blocks of a JPEG, also where it has half of them.
pub const TILE: usize = 32;

/// How a picture is coded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coding {
    /// Small and soon there.
    Jpeg {
        /// From 1 to 100.
        quality: u8,
        /// With half the columns and rows.
        half: bool,
    },
    /// Each bit of it: WebP.
    Lossless,
}

/// A coded picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Coded {
    /// Left and top of the tiles that it replaces, which lie in it row by row; none where it is the whole picture.
    pub tiles: Vec<[u16; 2]>,
    /// Tiles in a row of it.
    pub columns: u16,
    /// The file.
    pub bytes: Vec<u8>,
}

type Picture = Map2d<[u8; 3]>;

/// Codes `picture` for somebody who sees `before`; of JPEGs only what is different. `None` where that is nothing, or the
/// picture is too large to be coded.
pub fn encode(picture: &Picture, before: Option<&Picture>, coding: Coding) -> Option<Coded> {
    let size = [picture.width(), picture.height()];
    let [Ok(width), Ok(height)] = size.map(u16::try_from) else { return None };
    let mut bytes = Vec::new();
    let Coding::Jpeg { quality, half } = coding else {
        let encoder = WebPEncoder::new(&mut bytes);
        let pixels = picture.data().as_flattened();
        encoder.encode(pixels, width.into(), height.into(), WebpColor::Rgb8).ok()?;
        return Some(Coded { tiles: Vec::new(), columns: 0, bytes });
    };
    let before = before.filter(|before| [before.width(), before.height()] == size);
    let tiles = before.map(|before| changed(before, picture));
    if tiles.as_ref().is_some_and(Vec::is_empty) {
        return None;
    }
    let tiles = tiles.filter(|tiles| (tiles.len() * TILE * TILE) as f64 <= PART * (size[0] * size[1]) as f64);
    let jpeg = |bytes: &mut Vec<u8>, pixels: &[u8], size: [usize; 2], sampling| {
        let small = half.then(|| halved(pixels, size));
        let [columns, rows] = size.map(|side| if half { side.div_ceil(2) } else { side } as u16);
        let mut encoder = Encoder::new(bytes, quality);
        encoder.set_sampling_factor(sampling);
        encoder.encode(small.as_deref().unwrap_or(pixels), columns, rows, ColorType::Rgb).ok()
    };
    let Some(tiles) = tiles else {
        jpeg(&mut bytes, picture.data().as_flattened(), size, SamplingFactor::F_2_2)?;
        return Some(Coded { tiles: Vec::new(), columns: 0, bytes });
    };
    let columns = (tiles.len() as f64).sqrt().ceil() as usize;
    // With all of its colours: what decoders smooth of fewer would be mixed with that of the neighbours in here.
    let sheet = sheet(picture, &tiles, columns);
    jpeg(&mut bytes, sheet.data().as_flattened(), [sheet.width(), sheet.height()], SamplingFactor::F_1_1)?;
    Some(Coded { tiles, columns: columns as u16, bytes })
}

/// Left and top of the tiles in which two pictures of one size are not the same.
fn changed(before: &Picture, picture: &Picture) -> Vec<[u16; 2]> {
    let [width, height] = [picture.width(), picture.height()];
    let mut tiles = Vec::new();
    for top in (0..height).step_by(TILE) {
        for left in (0..width).step_by(TILE) {
            let right = (left + TILE).min(width);
            let mut rows = (top..(top + TILE).min(height)).map(|y| y * width + left..y * width + right);
            if rows.any(|row| before.data()[row.clone()] != picture.data()[row]) {
                tiles.push([left as u16, top as u16]);
            }
        }
    }
    tiles
}

/// These tiles side by side; what of them is beyond the picture is as its edge.
fn sheet(picture: &Picture, tiles: &[[u16; 2]], columns: usize) -> Picture {
    let [last_x, last_y] = [picture.width() - 1, picture.height() - 1];
    Map2d::from_fn(columns * TILE, tiles.len().div_ceil(columns) * TILE, |x, y| {
        let Some(tile) = tiles.get(y / TILE * columns + x / TILE) else { return [0; 3] };
        let [left, top] = tile.map(usize::from);
        picture.at((left + x % TILE).min(last_x), (top + y % TILE).min(last_y))
    })
}

/// Means of two by two pixels.
fn halved(pixels: &[u8], [width, height]: [usize; 2]) -> Vec<u8> {
    let at = |x: usize, y: usize, channel: usize| {
        u32::from(pixels[3 * (y.min(height - 1) * width + x.min(width - 1)) + channel])
    };
    let mut out = Vec::with_capacity(pixels.len() / 4 + 3 * (width + height));
    for y in (0..height).step_by(2) {
        for x in (0..width).step_by(2) {
            for channel in 0..3 {
                let sum = at(x, y, channel)
                    + at(x + 1, y, channel)
                    + at(x, y + 1, channel)
                    + at(x + 1, y + 1, channel);
                out.push(((sum + 2) / 4) as u8);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(width: usize, height: usize) -> Picture {
        Map2d::from_fn(width, height, |x, y| [(x * 2) as u8, (y * 2) as u8, (x + y) as u8])
    }

    fn decoded(coded: &Coded) -> Picture {
        let image = image::load_from_memory(&coded.bytes).expect("a picture").to_rgb8();
        let (width, height) = (image.width() as usize, image.height() as usize);
        Map2d::from_vec(width, height, image.pixels().map(|p| p.0).collect())
    }

    #[test]
    fn a_still_picture_keeps_each_bit() {
        for (width, height) in [(1, 1), (64, 48), (33, 17)] {
            let picture = picture(width, height);
            let coded = encode(&picture, Some(&picture), Coding::Lossless).expect("coded");
            assert_eq!(decoded(&coded), picture);
            assert_eq!(coded.tiles, [[0; 2]; 0]);
        }
    }

    #[test]
    fn what_has_not_changed_is_not_sent() {
        let before = picture(130, 96);
        let coding = Coding::Jpeg { quality: 90, half: false };
        assert_eq!(encode(&before, Some(&before), coding), None);
        let mut after = before.clone();
        for (x, y) in [(40, 33), (129, 95)] {
            for i in 0..50 {
                *after.at_mut(x - i % 7, y - i / 7) = [255, 0, 0];
            }
        }
        let coded = encode(&after, Some(&before), coding).expect("coded");
        assert_eq!((&coded.tiles[..], coded.columns), (&[[32, 0], [32, 32], [96, 64], [128, 64]][..], 2));
        // As a page does it: tiles out of the sheet, each to its place.
        let sheet = decoded(&coded);
        assert_eq!((sheet.width(), sheet.height()), (2 * TILE, 2 * TILE));
        let mut seen = before.clone();
        for (i, [left, top]) in coded.tiles.iter().enumerate() {
            for (x, y) in (0..TILE * TILE).map(|i| (i % TILE, i / TILE)) {
                let (to_x, to_y) = (usize::from(*left) + x, usize::from(*top) + y);
                if to_x < 130 && to_y < 96 {
                    *seen.at_mut(to_x, to_y) = sheet.at(i % 2 * TILE + x, i / 2 * TILE + y);
                }
            }
        }
        let apart = |a: &[u8; 3], b: &[u8; 3]| (0..3).map(|c| a[c].abs_diff(b[c])).max();
        let far = seen.data().iter().zip(after.data()).filter(|(a, b)| apart(a, b) > Some(40)).count();
        assert!(far < 40, "{far} pixels are far off");
        // Where most has changed all of it is sent; another size is another picture.
        for before in [Map2d::new(130, 96, [9; 3]), picture(64, 48)] {
            let whole = encode(&after, Some(&before), coding).expect("coded");
            assert_eq!((whole.tiles.len(), decoded(&whole).width()), (0, 130));
        }
        let half = encode(&after, Some(&before), Coding::Jpeg { quality: 80, half: true }).expect("coded");
        assert_eq!((decoded(&half).width(), half.tiles), (TILE, coded.tiles));
    }

    #[test]
    fn a_jpeg_is_near_and_half_of_it_is_smaller() {
        let picture = picture(96, 65);
        let whole = encode(&picture, None, Coding::Jpeg { quality: 85, half: false }).expect("coded");
        let shown = decoded(&whole);
        let apart = |a: &[u8; 3], b: &[u8; 3]| (0..3).map(|c| a[c].abs_diff(b[c])).max();
        let far = shown.data().iter().zip(picture.data()).filter(|(a, b)| apart(a, b) > Some(24)).count();
        assert!(far * 20 < picture.data().len(), "{far}");
        let half = encode(&picture, None, Coding::Jpeg { quality: 85, half: true }).expect("coded");
        assert_eq!((half.tiles.len(), decoded(&half).width(), decoded(&half).height()), (0, 48, 33));
        assert!(half.bytes.len() < whole.bytes.len());
    }
}
