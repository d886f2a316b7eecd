//! An environment as the faces of a cube (`EXT_lights_image_based`). Only the finest pictures count: what rough surfaces see
//! of them, and what falls on others, is computed.

use std::sync::Arc;

use glam::{DMat3, DVec3, Vec3};
use rayon::prelude::*;

use super::buffers::Buffers;
use super::document::Document;
use super::number::Index;
use super::pictures::{Picture, Pictures};
use super::{Oddities, Problem, get, nodes};
use crate::load::LoadOptions;
use crate::load::error::FileProblem;
use crate::load::folder::Folder;
use crate::load::textures;
use foveal::image::Map2d;
use foveal::scene::Environment;

/// Texels along an edge of a face below and beyond which the map is as fine as with these.
const SIDES: [usize; 2] = [64, 512];

/// Pictures all around, still to be read.
#[derive(Clone, Debug)]
pub(in super::super) struct CubeMap {
    /// Towards +x, −x, +y, −y, +z, −z, with their names.
    faces: [(String, Picture); 6],
    intensity: f32,
    /// From the frame of the pictures to that of the scene.
    turn: DMat3,
}

/// What a scene says of its environment; `None` where that shows nothing.
pub(super) fn read(
    document: &Document,
    light: Index,
    pictures: &Pictures<'_>,
    buffers: &mut Buffers<'_>,
    odd: &mut Oddities,
) -> Result<Option<CubeMap>, Problem> {
    const NAME: &str = "extensions/EXT_lights_image_based/lights";
    let none = super::number::List::default();
    let lights = document.extensions.image_based.as_ref().map_or(&none, |s| &s.lights);
    let light = get(lights, light, NAME)?;
    let Some(faces) = light.specular_images.first() else {
        odd.count("an environment without pictures", "not shown");
        return Ok(None);
    };
    let mut read = Vec::with_capacity(6);
    for face in faces {
        read.push(pictures.picture(*face, buffers)?);
    }
    let Ok(faces) = read.try_into() else { return Ok(None) };
    let turn = DMat3::from_mat4(nodes::transform([0.0; 3], light.rotation, [1.0; 3]));
    let intensity = if light.intensity.is_finite() { light.intensity.clamp(0.0, 1e6) } else { 1.0 };
    let turn = if turn.is_finite() && turn.determinant() > 0.5 { turn } else { DMat3::IDENTITY };
    Ok((intensity > 0.0).then_some(CubeMap { faces, intensity, turn }))
}

/// The pictures as one map; else what completes "the environment …".
pub(in super::super) fn environment(
    of: CubeMap,
    up: Vec3,
    folder: &mut Folder,
    options: &LoadOptions,
) -> Result<Environment, String> {
    let mut encoded: Vec<(String, Arc<Vec<u8>>)> = Vec::new();
    for (name, picture) in of.faces {
        let bytes = match picture {
            Picture::Bytes(bytes) => bytes,
            Picture::File(path) => Arc::new(folder.read(&path).map_err(|p: FileProblem| p.to_string())?),
            Picture::Broken(why) => return Err(format!("has a picture \"{name}\" that {why}")),
        };
        encoded.push((name, bytes));
    }
    let read = |(name, bytes): &(String, Arc<Vec<u8>>)| {
        textures::radiance_face(bytes, name.as_ref(), options)
            .map_err(|why| format!("has a picture \"{name}\" that {why}"))
    };
    let faces: Vec<Map2d<Vec3>> = encoded.par_iter().map(read).collect::<Result<_, _>>()?;
    let side = faces[0].width();
    if faces.iter().any(|face| (face.width(), face.height()) != (side, side)) {
        return Err("has pictures that are no six squares of one size".to_owned());
    }
    let mut environment = Environment { up, ..Environment::constant(Vec3::splat(of.intensity)) };
    let back = of.turn.transpose();
    let fine = side.clamp(SIDES[0], SIDES[1]);
    let (width, height) = (4 * fine, 2 * fine);
    let texel = |i: usize| {
        let at = [(i % width) as f32 + 0.5, (i / width) as f32 + 0.5];
        let towards = environment.direction([at[0] / width as f32, at[1] / height as f32]);
        look_up(&faces, back * towards.as_dvec3())
    };
    let texels = (0..width * height).into_par_iter().map(texel).collect();
    environment.map = Some(Map2d::from_vec(width, height, texels));
    Ok(environment)
}

/// The radiance from a direction, bilinear within a face. Faces are as they are seen from within, upright.
fn look_up(faces: &[Map2d<Vec3>], d: DVec3) -> Vec3 {
    let a = d.abs();
    // Columns to the right and rows down, over the axis that is looked along.
    let (face, right, down, ahead) = if a.x >= a.y && a.x >= a.z {
        if d.x > 0.0 { (0, d.z, -d.y, a.x) } else { (1, -d.z, -d.y, a.x) }
    } else if a.y >= a.z {
        if d.y > 0.0 { (2, -d.x, d.z, a.y) } else { (3, -d.x, -d.z, a.y) }
    } else if d.z > 0.0 {
        (4, -d.x, -d.y, a.z)
    } else {
        (5, d.x, -d.y, a.z)
    };
    let map = &faces[face];
    let side = map.width();
    let position = |v: f64| {
        let p = ((v / ahead * 0.5 + 0.5) * side as f64 - 0.5).clamp(0.0, (side - 1) as f64);
        let low = p as usize;
        (low, (low + 1).min(side - 1), (p - low as f64) as f32)
    };
    let ((xa, xb, fx), (ya, yb, fy)) = (position(right), position(down));
    map.at(xa, ya).lerp(map.at(xb, ya), fx).lerp(map.at(xa, yb).lerp(map.at(xb, yb), fx), fy)
}
