//! Scenes that a measurement makes for itself: the bundled ones, and halls of any number of triangles.

use std::path::{Path, PathBuf};

use crate::cli::failure::Failure;
use crate::cli::output::{make_folder, write_atomic};

#[path = "../../../scenes/generate/mod.rs"]
pub mod generate;

/// A scene on disk; its files go with it.
pub struct MadeScene {
    folder: PathBuf,
    file: PathBuf,
    /// Triangles in its OBJ.
    pub triangles: usize,
}

impl MadeScene {
    /// A bundled scene by name.
    pub fn bundled(name: &str) -> Result<Self, Failure> {
        let Some((_, make)) = generate::BUNDLED.iter().find(|(n, _)| *n == name) else {
            let names: Vec<&str> = generate::BUNDLED.iter().map(|(n, _)| *n).collect();
            return Err(Failure::Usage(format!(
                "no bundled scene \"{name}\"; there are {}",
                names.join(", ")
            )));
        };
        Self::write(make())
    }

    /// A hall of vases of about `triangles` triangles.
    pub fn hall(triangles: usize) -> Result<Self, Failure> {
        Self::write(generate::hall(triangles))
    }

    /// Writes a scene below the system's folder for temporary files.
    fn write(scene: image::ImageResult<generate::SceneFiles>) -> Result<Self, Failure> {
        let scene = scene.map_err(|e| Failure::Environment(format!("a scene cannot be made: {e}")))?;
        let folder = std::env::temp_dir().join(format!("foveal-{}-{}", std::process::id(), scene.name));
        make_folder(&folder)?;
        let file = folder.join(format!("{}.toml", scene.name));
        let made = Self { folder, file, triangles: scene.triangle_count };
        for (name, bytes) in &scene.files {
            write_atomic(&made.folder.join(name), bytes)?;
        }
        Ok(made)
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
