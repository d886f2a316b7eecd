//! Files: atomic writes, pictures as PNG and EXR.

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use atomic_write_file::AtomicWriteFile;
use glam::Vec3;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, Rgb32FImage};

use foveal::image::{Map2d, linear_from_srgb};
use foveal::metrics::Batches;

use crate::failure::Failure;

/// Writes a file by way of a neighbour that is renamed, so that a kill or a crash leaves the old one or the new one.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let written = AtomicWriteFile::open(path).and_then(|mut file| {
        file.write_all(bytes)?;
        file.commit()
    });
    written.map_err(|e| {
        Failure::Input(format!("{}: cannot be written ({e}); choose another --out", path.display()))
    })
}

/// Makes a folder with its parents.
pub fn make_folder(path: &Path) -> Result<(), Failure> {
    fs::create_dir_all(path).map_err(|e| {
        Failure::Input(format!("{}: the folder cannot be made ({e}); choose another --out", path.display()))
    })
}

/// PNG bytes of an sRGB picture.
pub fn png_bytes(width: u32, height: u32, rgb8: &[u8]) -> Result<Vec<u8>, Failure> {
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive)
        .write_image(rgb8, width, height, ExtendedColorType::Rgb8)
        .map_err(|e| Failure::Input(format!("a picture cannot be encoded: {e}")))?;
    Ok(bytes)
}

/// EXR bytes (32-bit float, lossless) of a linear picture.
pub fn exr_bytes(picture: &Map2d<Vec3>) -> Result<Vec<u8>, Failure> {
    let values: Vec<f32> = picture.data().iter().flat_map(|c| c.to_array()).collect();
    let (w, h) = (picture.width() as u32, picture.height() as u32);
    let Some(buffer) = Rgb32FImage::from_raw(w, h, values) else {
        return Err(Failure::Input("a picture without pixels cannot be written".into()));
    };
    let mut bytes = std::io::Cursor::new(Vec::new());
    buffer
        .write_to(&mut bytes, image::ImageFormat::OpenExr)
        .map_err(|e| Failure::Input(format!("a picture cannot be encoded: {e}")))?;
    Ok(bytes.into_inner())
}

/// A picture file in linear RGB; 8- and 16-bit files are sRGB-decoded.
pub fn read_picture(path: &Path) -> Result<Map2d<Vec3>, Failure> {
    let wrong = |e: &dyn std::fmt::Display| {
        Failure::Input(format!("{}: {e}; a PNG, JPEG, HDR or EXR picture is needed", path.display()))
    };
    let mut reader = image::ImageReader::open(path)
        .map_err(|e| wrong(&e))?
        .with_guessed_format()
        .map_err(|e| wrong(&e))?;
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(16384);
    limits.max_image_height = Some(16384);
    limits.max_alloc = Some(2 << 30);
    reader.limits(limits);
    let decoded = reader.decode().map_err(|e| wrong(&e))?;
    let is_linear =
        matches!(decoded, image::DynamicImage::ImageRgb32F(_) | image::DynamicImage::ImageRgba32F(_));
    let rgb = decoded.into_rgb32f();
    let (w, h) = rgb.dimensions();
    let pixels = rgb
        .pixels()
        .map(|p| {
            let v = Vec3::from_array(p.0);
            if is_linear {
                v
            } else {
                Vec3::new(linear_from_srgb(v.x), linear_from_srgb(v.y), linear_from_srgb(v.z))
            }
        })
        .collect();
    Ok(Map2d::from_vec(w as usize, h as usize, pixels))
}

/// Where the batches of a picture are kept: beside it, `.batches.json` in place of its extension.
pub fn batches_of(picture: &Path) -> PathBuf {
    picture.with_extension("batches.json")
}

/// Writes the batches of a picture beside it: one JSON object of schema `foveal.batches/1` with the fields of [`Batches`];
/// `means` holds for each block, row by row, 16 mean luminances.
pub fn write_batches(picture: &Path, batches: &Batches) -> Result<(), Failure> {
    let file = BatchesFile { schema: BATCHES_SCHEMA.into(), batches: batches.clone() };
    let text = serde_json::to_vec(&file)
        .map_err(|e| Failure::Input(format!("batches cannot be written as JSON: {e}")))?;
    write_atomic(&batches_of(picture), &text)
}

/// The batches beside a picture, where there are any.
pub fn read_batches(picture: &Path) -> Result<Option<Batches>, Failure> {
    let path = batches_of(picture);
    if !path.exists() {
        return Ok(None);
    }
    let wrong = |e: &dyn std::fmt::Display| {
        Failure::Input(format!("{}: {e}; remove it or make the picture again", path.display()))
    };
    let text = fs::read(&path).map_err(|e| wrong(&e))?;
    let file: BatchesFile = serde_json::from_slice(&text).map_err(|e| wrong(&e))?;
    if file.schema != BATCHES_SCHEMA || !file.batches.is_whole() {
        return Err(wrong(&"not the batches of a picture"));
    }
    Ok(Some(file.batches))
}

const BATCHES_SCHEMA: &str = "foveal.batches/1";

#[derive(serde::Serialize, serde::Deserialize)]
struct BatchesFile {
    schema: String,
    #[serde(flatten)]
    batches: Batches,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exr_keeps_every_bit() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a.exr");
        let picture = Map2d::from_fn(13, 7, |x, y| {
            Vec3::new(x as f32 * 0.1 + 1e-20, 1e9 / (y as f32 + 1.0), 1.0 / 3.0)
        });
        write_atomic(&path, &exr_bytes(&picture).expect("bytes")).expect("written");
        assert_eq!(read_picture(&path).expect("read"), picture);
        assert_eq!(fs::read_dir(folder.path()).expect("a folder").count(), 1, "no part is left");
    }

    #[test]
    fn batches_lie_beside_their_picture() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a.exr");
        assert_eq!(read_batches(&path).expect("none"), None);
        let picture = Map2d::from_fn(24, 17, |x, y| Vec3::splat(x as f32 / (y as f32 + 3.0)));
        let batches = Batches::exact(&picture, 8);
        write_batches(&path, &batches).expect("written");
        let read = read_batches(&path).expect("read").expect("batches");
        // To the last digit but one.
        let pairs = read.means.as_flattened().iter().zip(batches.means.as_flattened());
        assert!(pairs.clone().count() == 96 && pairs.clone().all(|(a, b)| (a - b).abs() <= 1e-15 * b));
        assert_eq!(Batches { means: batches.means.clone(), ..read }, batches);
        let text = fs::read_to_string(folder.path().join("a.batches.json")).expect("a text");
        for wrong in [text.replace("/1", "/9"), text.replace("\"columns\":3", "\"columns\":4"), String::new()]
        {
            fs::write(folder.path().join("a.batches.json"), wrong).expect("written");
            assert_eq!(read_batches(&path).expect_err("wrong").exit_code(), 3);
        }
    }

    #[test]
    fn unreadable_pictures_are_named() {
        let error = read_picture(Path::new("no-such.exr")).expect_err("missing");
        assert!(error.to_string().contains("no-such.exr") && error.exit_code() == 3);
    }
}
