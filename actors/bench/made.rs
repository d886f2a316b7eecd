//! Scenes that a measurement makes for itself: the bundled ones, and halls of any number of triangles.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use foveal_engine::failure::Failure;
use foveal_engine::files::{make_folder, write_atomic};

/// A scene on disk; its files go with it.
pub struct MadeScene {
    folder: PathBuf,
    file: PathBuf,
    /// Triangles in its OBJ.
    pub triangles: usize,
}

/// A scene to measure in.
pub enum Subject {
    /// One of ours.
    Bundled(MadeScene),
    /// A file.
    File(PathBuf),
}

impl Subject {
    /// A file, or one of ours by name.
    ///
    /// # Errors
    /// If there is neither.
    pub fn of(word: &str) -> Result<Self, Failure> {
        let path = Path::new(word);
        let is_name = path.extension().is_none() && path.components().count() == 1;
        Ok(if is_name { Self::Bundled(MadeScene::bundled(word)?) } else { Self::File(path.to_owned()) })
    }

    /// What it is called in tables: of a file its name without extension.
    pub fn name(word: &str) -> &str {
        Path::new(word).file_stem().and_then(|s| s.to_str()).unwrap_or(word)
    }

    /// Its file.
    pub fn path(&self) -> &Path {
        match self {
            Self::Bundled(made) => made.path(),
            Self::File(path) => path,
        }
    }
}

impl MadeScene {
    /// A bundled scene by name.
    pub fn bundled(name: &str) -> Result<Self, Failure> {
        let all = || foveal_scenes::BUNDLED.iter().chain(&foveal_scenes::KINDS);
        let Some((_, make)) = all().find(|(n, _)| *n == name) else {
            let names: Vec<&str> = all().map(|(n, _)| *n).collect();
            return Err(Failure::Usage(format!(
                "no bundled scene \"{name}\"; there are {}; a scene of yours is named with its extension",
                names.join(", ")
            )));
        };
        Self::write(make())
    }

    /// A hall of vases of about `triangles` triangles.
    pub fn hall(triangles: usize) -> Result<Self, Failure> {
        Self::write(foveal_scenes::hall(triangles))
    }

    /// A salon with patterned walls.
    pub fn salon() -> Result<Self, Failure> {
        Self::write(foveal_scenes::salon())
    }

    /// Writes a scene below the system's folder for temporary files.
    fn write(scene: image::ImageResult<foveal_scenes::SceneFiles>) -> Result<Self, Failure> {
        let scene = scene.map_err(|e| Failure::Environment(format!("a scene cannot be made: {e}")))?;
        static MADE: AtomicU32 = AtomicU32::new(0);
        let number = MADE.fetch_add(1, Ordering::Relaxed);
        let folder =
            std::env::temp_dir().join(format!("foveal-{}-{number}-{}", std::process::id(), scene.name));
        make_folder(&folder)?;
        let file = folder.join(format!("{}.toml", scene.name));
        let made = Self { folder, file, triangles: scene.triangle_count };
        for (name, bytes) in &scene.files {
            write_atomic(&made.folder.join(name), bytes)?;
        }
        Ok(made)
    }

    /// Makes its pictures so many times as large along each edge, with grain as fine as their texels.
    pub fn refine_pictures(&self, factor: u32) -> Result<(), Failure> {
        let failed =
            |e: &dyn std::fmt::Display| Failure::Environment(format!("a picture cannot be made: {e}"));
        for entry in std::fs::read_dir(&self.folder).map_err(|e| failed(&e))?.flatten() {
            let path = entry.path();
            if !path.extension().is_some_and(|e| e == "jpg" || e == "png") {
                continue;
            }
            let picture = image::open(&path).map_err(|e| failed(&e))?;
            let (w, h) = (picture.width() * factor, picture.height() * factor);
            let mut fine = image::imageops::resize(&picture.to_rgba8(), w, h, image::imageops::Triangle);
            for (x, y, texel) in fine.enumerate_pixels_mut() {
                let grain = (foveal::rng::hash(u64::from(x), u64::from(y), 7) % 17) as i16 - 8;
                for channel in &mut texel.0[..3] {
                    *channel = (i16::from(*channel) + grain).clamp(0, 255) as u8;
                }
            }
            let fine = image::DynamicImage::from(fine);
            let fine = if picture.color().has_alpha() { fine } else { fine.to_rgb8().into() };
            fine.save(&path).map_err(|e| failed(&e))?;
        }
        Ok(())
    }

    /// Its sidecar.
    pub fn path(&self) -> &Path {
        &self.file
    }
}

impl Drop for MadeScene {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}
