//! Whether lamps and what glows are told in the same units.
//!
//! glTF has candela and nits, but programs also write watts for candela, or leave out the 683 lm/W between them. Then lamps
//! light things to another brightness than anything that glows by several powers of ten, which nothing real does.

use std::f32::consts::PI;

use super::defaults::{nearest, probe_directions};
use super::{Light, Scene};
use crate::image::luminance;

/// From which factor on one is taken to be in other units.
const APART: f32 = 1e4;

/// Lamps that are looked at: searching for what they light looks at every triangle.
const LAMPS: usize = 4;

/// What to say where lamps and what glows lie too far apart.
pub fn doubt(scene: &Scene) -> Option<String> {
    let glow = scene.materials.iter().filter(|m| m.is_emissive()).map(|m| luminance(m.emission.color));
    let glow = glow.fold(0.0, f32::max);
    let lamps = scene.lights.iter().take(LAMPS).filter_map(|l| brightness(scene, l)).fold(0.0, f32::max);
    let ratio = lamps / glow;
    if !(ratio.is_finite() && ratio > 0.0) || (1.0 / APART..=APART).contains(&ratio) {
        return None;
    }
    let (times, how) = if ratio > 1.0 { (ratio, "brighter") } else { (1.0 / ratio, "darker") };
    Some(format!(
        "what the lamps light is {times:.0e} times {how} than what glows: were watts written for candela, light_scale in the sidecar's [gltf] sets it right ({:.1e} makes both alike)",
        1.0 / ratio
    ))
}

/// The radiance of a white surface as far away as half of those are that the light meets: the nearest may be its own shade.
fn brightness(scene: &Scene, light: &Light) -> Option<f32> {
    let (position, towards, intensity) = match light {
        Light::Directional { irradiance, .. } => return Some(luminance(*irradiance) / PI),
        Light::Point { position, intensity, .. } => (*position, probe_directions(), *intensity),
        Light::Spot { position, direction, intensity, .. } => (*position, vec![*direction], *intensity),
    };
    let found = nearest(&scene.mesh, position, &towards);
    let mut distances: Vec<f32> = found.into_iter().flatten().map(|hit| hit.distance).collect();
    distances.sort_unstable_by(f32::total_cmp);
    let distance = distances.get(distances.len() / 2)?;
    Some(luminance(intensity) / (PI * distance * distance))
}
