//! What is around a scene: constant radiance, or a map that is decoded while meshes are read.

use std::path::{Path, PathBuf};

use foveal::image::Map2d;
use foveal::scene::Environment;
use glam::Vec3;

use super::error::Warning;
use super::folder::{Folder, read_file};
use super::sidecar::Sidecar;
use super::{LoadOptions, textures};

/// A map of what is around a scene, decoded ahead.
pub(super) struct Surroundings {
    /// Where it is.
    pub found: PathBuf,
    /// BLAKE3 of its file.
    pub hash: [u8; 32],
    /// The map and the number of its texels that were no radiance, or why there is none.
    pub made: Result<(Map2d<Vec3>, usize), String>,
}

impl Surroundings {
    /// Of a file that was found; `None` where it cannot be read, which is said where it is asked for.
    pub fn decode(found: PathBuf, options: &LoadOptions) -> Option<Self> {
        let contents = read_file(&found, options.file_bytes_max).ok()?;
        let made = textures::radiance_map(&contents.bytes, &found, options);
        Some(Self { found, hash: contents.hash, made })
    }
}

/// What a sidecar says of it, with its map as decoded `ahead` or now; without where that cannot be.
pub(super) fn environment(
    sidecar: &Sidecar,
    folder: &mut Folder,
    ahead: Option<Surroundings>,
    options: &LoadOptions,
    warnings: &mut Vec<Warning>,
) -> Option<Environment> {
    let table = sidecar.environment.as_ref()?;
    let mut environment =
        Environment { radiance: table.radiance, map: None, rotate_up: table.rotate_up, up: sidecar.up };
    let Some(file) = &table.map else { return Some(environment) };
    let found = folder.find(Path::new(""), &file.name);
    let decoded = found.map_err(|problem| problem.to_string()).and_then(|found| match ahead {
        Some(ahead) if ahead.found == found => {
            folder.note(folder.relative(&found), ahead.hash);
            ahead.made
        }
        _ => {
            let bytes = folder.read(&found).map_err(|problem| problem.to_string())?;
            textures::radiance_map(&bytes, &found, options)
        }
    });
    match decoded {
        Ok((map, bad)) => {
            if bad > 0 {
                let message =
                    format!("\"{}\": {bad} texels are negative, NaN or infinite; put right", file.name);
                warnings.push(Warning::new(file.place.clone(), message));
            }
            environment.map = Some(map);
        }
        Err(why) => {
            let message = format!("environment map \"{}\" {why}; its constant radiance instead", file.name);
            warnings.push(Warning::new(file.place.clone(), message));
        }
    }
    Some(environment)
}
