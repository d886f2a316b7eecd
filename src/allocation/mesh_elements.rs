//! Which elements of a radiosity mesh a picture can do without: the criteria of Dumont et al. 2003 §5.4 with the
//! scene's textures and display.

use glam::Vec3;

use crate::illumination::from_radiosity::SceneRadiosity;
use crate::illumination::simplify::{Criterion, Simplified};
use crate::image::{Map2d, luminance};
use crate::perception::elevation::{ElevationSettings, elevation};
use crate::perception::tvi::tvi;
use crate::rng::Stream;
use crate::scene::Scene;

/// Texels per degree that elevation maps assume: 512 pixels over 45° (REFERENCE §8.6).
const TEXELS_PER_DEGREE: f32 = 10.787;
/// Points of an element at which its texture's elevation is read.
const ELEVATION_POINTS: u64 = 16;

/// Which elements go first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ElementCriterion {
    /// Least relative change of radiosity.
    Photometric,
    /// Least visible change (Dumont et al. 2003 eq 12).
    #[default]
    Perceptual,
    /// Least squared error, whole subtrees at once.
    Optimal,
}

/// Cuts the mesh of a solution for `scene` back to `k` elements.
pub fn simplify_mesh(
    solution: &mut SceneRadiosity,
    scene: &Scene,
    k: usize,
    criterion: ElementCriterion,
) -> Simplified {
    match criterion {
        ElementCriterion::Photometric => solution.simplify(k, &Criterion::Photometric, &|_, _| 1.0),
        ElementCriterion::Optimal => solution.simplify(k, &Criterion::Optimal, &|_, _| 1.0),
        ElementCriterion::Perceptual => {
            let maps = elevation_maps(scene);
            let criterion = Criterion::Perceptual {
                tvi: &|l| f64::from(tvi(l as f32)),
                cd_m2_per_unit: f64::from(scene.display.exposure * scene.display.white_cd_m2),
            };
            solution.simplify(k, &criterion, &|triangle, piece| mean_elevation(scene, &maps, triangle, piece))
        }
    }
}

/// Elevation of each texture that some diffuse surface shows.
fn elevation_maps(scene: &Scene) -> Vec<Option<Map2d<f32>>> {
    let mut used = vec![false; scene.textures.len()];
    for material in &scene.materials {
        if let Some(t) = material.picture() {
            used[t.0 as usize] = true;
        }
    }
    let settings = ElevationSettings::new(TEXELS_PER_DEGREE);
    scene
        .textures
        .iter()
        .zip(used)
        .map(|(texture, used)| {
            used.then(|| {
                let [w, h] = texture.size(0);
                let y = Map2d::from_fn(w, h, |x, y| {
                    let [r, g, b, _] = texture.texel(0, x, y);
                    scene.display.white_cd_m2 * luminance(Vec3::new(r, g, b))
                });
                elevation(&y, &settings)
            })
        })
        .collect()
}

/// Mean elevation over the texture's part on a piece of a triangle; 1 without texture.
fn mean_elevation(scene: &Scene, maps: &[Option<Map2d<f32>>], triangle: u32, piece: [Vec3; 3]) -> f32 {
    let material = &scene.materials[scene.mesh.materials[triangle as usize].0 as usize];
    let Some(map) = material.picture().and_then(|t| maps[t.0 as usize].as_ref()) else { return 1.0 };
    let [a, b, c] = scene.mesh.corners(triangle);
    let uv = scene.mesh.triangles[triangle as usize].map(|v| scene.mesh.uvs[v as usize]);
    let n = (b - a).cross(c - a);
    let square = n.length_squared().max(f32::MIN_POSITIVE);
    let mut sum = 0.0;
    for i in 0..ELEVATION_POINTS {
        let [u, v] = Stream::new(0xe1e, triangle.into(), i).next_2d();
        let s = u.sqrt();
        let p = piece[0] * (1.0 - s) + piece[1] * (s * (1.0 - v)) + piece[2] * (s * v);
        let (b1, b2) = ((p - a).cross(c - a).dot(n) / square, (b - a).cross(p - a).dot(n) / square);
        let at = uv[0] * (1.0 - b1 - b2) + uv[1] * b1 + uv[2] * b2;
        let texel = |x: f32, n: usize| ((x.rem_euclid(1.0) * n as f32) as usize).min(n - 1);
        // Rows count from the top, v from below.
        sum += map.at(texel(at.x, map.width()), texel(1.0 - at.y, map.height()));
    }
    sum / ELEVATION_POINTS as f32
}
