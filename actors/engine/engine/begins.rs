//! Where a walk by hand begins.

use super::Engine;
use crate::failure::Failure;
use crate::opened;

/// Where whoever walks by hand begins, as numbers of the scene's cameras and paths.
#[derive(Clone, Copy, Default)]
pub(super) struct Begins {
    pub(super) camera: usize,
    pub(super) path: Option<usize>,
}

impl Engine {
    /// Whoever walks by hand begins at this camera, or along this path, instead of at the first camera.
    ///
    /// # Errors
    /// If the scene has none of that name.
    pub fn begin_at(&mut self, camera: Option<&str>, path: Option<&str>) -> Result<(), Failure> {
        let scene = &self.opened.world.scene;
        if let Some(name) = camera {
            let found = opened::camera(scene, Some(name))?;
            self.begins.camera = scene.cameras.iter().position(|c| c.name == found.name).unwrap_or(0);
        }
        if let Some(name) = path {
            let found = scene.paths.iter().position(|path| path.name == name);
            self.begins.path = Some(found.ok_or_else(|| {
                let names: Vec<&str> = scene.paths.iter().map(|p| p.name.as_str()).collect();
                Failure::Usage(format!("no path \"{name}\"; the scene has {}", names.join(", ")))
            })?);
        }
        Ok(())
    }
}
