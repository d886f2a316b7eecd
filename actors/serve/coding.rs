//! A picture as bytes: JPEG of what has changed while it does, without loss once it is still.

use foveal::image::Map2d;
use image_webp::{ColorType as WebpColor, WebPEncoder};
use jpeg_encoder::{ColorType, Encoder, EncodingError, SamplingFactor};

/// Where more than this share of the picture has changed, all of it is sent.
const PART: f64 = 0.4;
/// What is sent is cut at multiples of this: blocks of a JPEG whose colour has half the columns and rows.
const BLOCK: usize = 16;

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
    /// What it replaces: left, top, columns, rows.
    pub part: [u16; 4],
    /// The file.
    pub bytes: Vec<u8>,
}

type Picture = Map2d<[u8; 3]>;

/// Codes `picture` for somebody who sees `before`; of JPEGs only what is different. `None` where that is nothing, or the
/// picture is too large to be coded.
pub fn encode(picture: &Picture, before: Option<&Picture>, coding: Coding) -> Option<Coded> {
    let whole = [0, 0, picture.width(), picture.height()];
    let area = |part: [usize; 4]| (part[2] * part[3]) as f64;
    let part = match (coding, before) {
        (Coding::Jpeg { .. }, Some(before)) => {
            let part = changed(before, picture)?;
            if area(part) > PART * area(whole) { whole } else { part }
        }
        _ => whole,
    };
    let told = part.map(|v| u16::try_from(v).ok());
    let [Some(x), Some(y), Some(width), Some(height)] = told else { return None };
    let (mut columns, mut rows) = (width, height);
    let mut pixels = cut(picture, part);
    let mut bytes = Vec::new();
    match coding {
        Coding::Jpeg { quality, half } => {
            if half {
                let [w, h] = [part[2].div_ceil(2), part[3].div_ceil(2)];
                pixels = halved(&pixels, [part[2], part[3]]);
                (columns, rows) = (w as u16, h as u16);
            }
            jpeg(&mut bytes, &pixels, [columns, rows], quality).ok()?;
        }
        Coding::Lossless => {
            let encoder = WebPEncoder::new(&mut bytes);
            encoder.encode(&pixels, columns.into(), rows.into(), WebpColor::Rgb8).ok()?;
        }
    }
    Some(Coded { part: [x, y, width, height], bytes })
}

fn jpeg(
    bytes: &mut Vec<u8>,
    pixels: &[u8],
    [columns, rows]: [u16; 2],
    quality: u8,
) -> Result<(), EncodingError> {
    let mut encoder = Encoder::new(bytes, quality);
    encoder.set_sampling_factor(SamplingFactor::F_2_2);
    encoder.encode(pixels, columns, rows, ColorType::Rgb)
}

/// The least rectangle of whole blocks outside of which both are the same. `None` where they are everywhere; all of it
/// where they have not one size.
fn changed(before: &Picture, picture: &Picture) -> Option<[usize; 4]> {
    let [width, height] = [picture.width(), picture.height()];
    if [before.width(), before.height()] != [width, height] {
        return Some([0, 0, width, height]);
    }
    let rows = || before.data().chunks_exact(width.max(1)).zip(picture.data().chunks_exact(width.max(1)));
    let top = rows().position(|(a, b)| a != b)?;
    let bottom = height - rows().rev().position(|(a, b)| a != b)?;
    let (mut left, mut right) = (width, 0);
    for (a, b) in rows().skip(top).take(bottom - top) {
        let differs = |x: &usize| a[*x] != b[*x];
        left = (0..left).find(differs).unwrap_or(left);
        right = (right..width).rev().find(differs).map_or(right, |x| x + 1);
    }
    let [left, top] = [left, top].map(|v| v / BLOCK * BLOCK);
    let [right, bottom] =
        [(right, width), (bottom, height)].map(|(v, end)| v.next_multiple_of(BLOCK).min(end));
    Some([left, top, right - left, bottom - top])
}

/// Pixels of a rectangle.
fn cut(picture: &Picture, [x, y, width, height]: [usize; 4]) -> Vec<u8> {
    let rows = picture.data().chunks_exact(picture.width().max(1)).skip(y).take(height);
    rows.flat_map(|row| row[x..x + width].as_flattened()).copied().collect()
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
            assert_eq!(coded.part, [0, 0, width as u16, height as u16]);
        }
    }

    #[test]
    fn what_has_not_changed_is_not_sent() {
        let before = picture(128, 96);
        let coding = Coding::Jpeg { quality: 80, half: false };
        assert_eq!(encode(&before, Some(&before), coding), None);
        let mut after = before.clone();
        *after.at_mut(40, 33) = [255, 0, 0];
        *after.at_mut(50, 50) = [255, 0, 0];
        let coded = encode(&after, Some(&before), coding).expect("coded");
        assert_eq!(coded.part, [32, 32, 32, 32]);
        assert_eq!((decoded(&coded).width(), decoded(&coded).height()), (32, 32));
        *after.at_mut(0, 0) = [0, 255, 0];
        *after.at_mut(127, 95) = [0, 255, 0];
        assert_eq!(encode(&after, Some(&before), coding).expect("coded").part, [0, 0, 128, 96]);
        // Another size is another picture.
        assert_eq!(encode(&after, Some(&picture(64, 48)), coding).expect("coded").part, [0, 0, 128, 96]);
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
        assert_eq!((half.part, decoded(&half).width(), decoded(&half).height()), ([0, 0, 96, 65], 48, 33));
        assert!(half.bytes.len() < whole.bytes.len());
    }
}
