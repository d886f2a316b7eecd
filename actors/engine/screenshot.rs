//! A picture in a file, with all it takes to make it again.

use std::io::Write;
use std::path::{Path, PathBuf};

use foveal::image::Map2d;
use foveal::scene::Camera;

/// PNG bytes of a picture; `facts` become text chunks.
///
/// # Errors
/// If the picture has no pixels.
pub fn png(picture: &Map2d<[u8; 3]>, facts: &[(String, String)]) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, picture.width() as u32, picture.height() as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_source_srgb(png::SrgbRenderingIntent::RelativeColorimetric);
    for (name, value) in facts {
        encoder.add_itxt_chunk(name.clone(), value.clone()).map_err(|e| e.to_string())?;
    }
    let mut writer = encoder.write_header().map_err(|e| e.to_string())?;
    writer.write_image_data(picture.data().as_flattened()).map_err(|e| e.to_string())?;
    writer.finish().map_err(|e| e.to_string())?;
    Ok(bytes)
}

/// A camera with every bit, as a sidecar writes it.
pub fn camera_fact(camera: &Camera) -> (String, String) {
    let v = |v: glam::Vec3| format!("[{:?}, {:?}, {:?}]", v.x, v.y, v.z);
    let value = format!(
        "eye = {}, target = {}, up = {}, fov_y = {:?}",
        v(camera.eye),
        v(camera.target),
        v(camera.up),
        camera.fov_y.to_degrees()
    );
    ("foveal camera".into(), value)
}

/// Writes `bytes` into the first of `foveal-1.png`, `foveal-2.png`, … that is not there.
///
/// # Errors
/// If the folder cannot be written to.
pub fn save(folder: &Path, bytes: &[u8]) -> Result<PathBuf, String> {
    for number in 1..10_000 {
        let path = folder.join(format!("foveal-{number}.png"));
        match std::fs::File::create_new(&path) {
            Ok(mut file) => {
                let written = file.write_all(bytes);
                return written.map(|()| path.clone()).map_err(|e| format!("{}: {e}", path.display()));
            }
            Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => {}
            Err(e) => return Err(format!("{}: {e}", path.display())),
        }
    }
    Err(format!("{}: holds ten thousand screenshots", folder.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_carry_their_facts_and_never_overwrite() {
        let folder = tempfile::tempdir().expect("a folder");
        let picture = Map2d::from_fn(5, 3, |x, y| [x as u8 * 40, y as u8 * 80, 7]);
        let facts = [("foveal scene".to_owned(), "küche.toml".to_owned())];
        let bytes = png(&picture, &facts).expect("bytes");
        let first = save(folder.path(), &bytes).expect("saved");
        let second = save(folder.path(), &bytes).expect("saved");
        assert_ne!(first, second);
        let mut reader = png::Decoder::new(std::io::Cursor::new(std::fs::read(second).expect("read")))
            .read_info()
            .expect("png");
        let text = &reader.info().utf8_text[0];
        assert_eq!(
            (text.keyword.as_str(), text.get_text().expect("text")),
            ("foveal scene", "küche.toml".into())
        );
        let mut pixels = vec![0; reader.output_buffer_size().expect("size")];
        reader.next_frame(&mut pixels).expect("pixels");
        assert_eq!(pixels, picture.data().as_flattened());
        assert!(save(&folder.path().join("none"), &bytes).expect_err("no folder").contains("none"));
    }
}
