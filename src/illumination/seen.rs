//! Which surfaces a walk can see: only those are worth fine elements.
//!
//! Rays leave the scene's cameras and paths in all directions, and the places in free space that those rays
//! pass, so that whole rooms count as seen and not only what faces a camera. A triangle that no ray met is
//! either out of sight or small; both may be stored per vertex.

use glam::Vec3;
use rayon::prelude::*;

use crate::geometry::{Accel, Ray};
use crate::math;
use crate::rng::Stream;
use crate::scene::Scene;

/// Eyes at most.
const EYES_MAX: usize = 32;
/// Places reached from each eye.
const PLACES: u64 = 24;
/// Panes that a look passes at most.
const PANES_MAX: u32 = 16;

/// Looks along `direction` through whatever is transparent: calls `met` with every triangle, returns the
/// distance to the last.
fn look(
    scene: &Scene,
    accel: &Accel,
    origin: Vec3,
    direction: Vec3,
    mut met: impl FnMut(u32),
) -> Option<f32> {
    let mut ray = Ray::new(origin, direction);
    for _ in 0..PANES_MAX {
        let hit = accel.intersect(scene, &ray)?;
        met(hit.triangle);
        if !scene.materials[scene.mesh.materials[hit.triangle as usize].0 as usize].is_transparent() {
            return Some(hit.t);
        }
        (ray.t_min, ray.ignore) = (hit.t * (1.0 + 1e-5), hit.triangle);
    }
    None
}

fn on_sphere([u, v]: [f32; 2]) -> Vec3 {
    let z = 1.0 - 2.0 * u;
    let r = (1.0 - z * z).max(0.0).sqrt();
    let (sin, cos) = math::sin_cos(std::f32::consts::TAU * v);
    Vec3::new(r * cos, r * sin, z)
}

/// Where the scene is seen from: its cameras, and places along its paths.
fn eyes(scene: &Scene) -> Vec<Vec3> {
    let mut eyes: Vec<Vec3> = scene.cameras.iter().map(|c| c.camera.eye).collect();
    let keys: Vec<Vec3> = scene.paths.iter().flat_map(|p| p.keys.iter().map(|k| k.eye)).collect();
    let step = keys.len().div_ceil(EYES_MAX.saturating_sub(eyes.len()).max(1)).max(1);
    eyes.extend(keys.iter().step_by(step));
    eyes.truncate(EYES_MAX);
    eyes
}

/// Whether a camera or a place along a path sees the front of a surface at `point`; everything is in sight where there
/// are none of these.
pub fn in_sight(scene: &Scene, accel: &Accel, point: Vec3, normal: Vec3) -> bool {
    let eyes = eyes(scene);
    eyes.is_empty()
        || eyes.iter().any(|&eye| {
            let way = point - eye;
            let reached = || look(scene, accel, eye, way.normalize_or_zero(), |_| {});
            way.dot(normal) < 0.0 && reached().is_some_and(|t| t >= 0.999 * way.length())
        })
}

/// Per triangle whether one of about `rays` rays from where a walk may lead met it. All of them if the scene has
/// no cameras.
pub fn seen(scene: &Scene, accel: &Accel, rays: u64) -> Vec<bool> {
    let eyes = eyes(scene);
    let count = scene.mesh.triangles.len();
    if eyes.is_empty() {
        return vec![true; count];
    }
    let mut places: Vec<Vec3> = eyes.clone();
    for (i, &eye) in eyes.iter().enumerate() {
        for k in 0..PLACES {
            let mut stream = Stream::new(0x5ee, i as u64, k);
            let direction = on_sphere(stream.next_2d());
            if let Some(t) = look(scene, accel, eye, direction, |_| {}) {
                places.push(eye + direction * (t * (0.3 + 0.6 * stream.next_f32())));
            }
        }
    }
    let each = rays.div_ceil(places.len() as u64);
    let found: Vec<Vec<u32>> = places
        .par_iter()
        .enumerate()
        .map(|(i, &place)| {
            let mut met = Vec::new();
            for k in 0..each {
                let direction = on_sphere(Stream::new(0x5ef, i as u64, k).next_2d());
                look(scene, accel, place, direction, |t| met.push(t));
            }
            met.sort_unstable();
            met.dedup();
            met
        })
        .collect();
    let mut seen = vec![false; count];
    for t in found.into_iter().flatten() {
        seen[t as usize] = true;
    }
    seen
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::illumination::test_scenes::{cube, join, lambert, quad, scene};

    #[test]
    fn a_room_is_seen_and_what_is_behind_its_walls_is_not() {
        let mut mesh = cube(Vec3::ZERO, 2.0, false);
        join(&mut mesh, &quad(Vec3::new(5.0, 0.0, 0.0), Vec3::X, Vec3::Y), 0);
        let mut room = scene(mesh, vec![lambert(0.5, 0.0)], Vec::new());
        room.cameras[0].camera.eye = Vec3::ONE;
        let found = seen(&room, &Accel::build(&room), 4000);
        assert!(found[..12].iter().all(|&s| s) && !found[12] && !found[13], "{found:?}");
        room.cameras.clear();
        assert!(seen(&room, &Accel::build(&room), 10).iter().all(|&s| s));
    }
}
