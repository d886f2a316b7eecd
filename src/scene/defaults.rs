//! What a scene without light, camera or path gets.

use std::f32::consts::{FRAC_PI_4, PI};

use glam::Vec3;
use rayon::prelude::*;

use super::camera::PathKey;
use super::{Camera, CameraPath, Environment, Light, Mesh, NamedCamera, Scene};

use crate::math;

/// Radiance of the sky of a scene without light, W·sr⁻¹·m⁻²: bluish, and such that with [`SUN`] a
/// white floor is near display white at exposure 1.
const SKY: Vec3 = Vec3::new(0.45, 0.55, 0.7);

/// Irradiance of the sun of a scene without light, W/m².
const SUN: Vec3 = Vec3::new(1.6, 1.5, 1.35);

/// Directions in which rays probe what is around a point.
const PROBE_DIRECTIONS: usize = 96;

/// A surface met by a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hit {
    pub distance: f32,
    front: bool,
}

/// Nearest surface from `origin` along each direction (unit), by looking at every triangle: this is done a few times while
/// loading, before there is a BVH, and takes 0.1 s for a million triangles.
pub(super) fn nearest(mesh: &Mesh, origin: Vec3, directions: &[Vec3]) -> Vec<Option<Hit>> {
    let apart = Apart::of(directions);
    let chunks: Vec<Vec<Option<Hit>>> = mesh
        .triangles
        .par_chunks(1 << 15)
        .map(|triangles| {
            let mut hits = vec![None; directions.len()];
            for t in triangles {
                let corners = t.map(|v| mesh.positions[v as usize]);
                if apart.may_meet(corners.map(|p| p - origin)) {
                    meet(origin, corners, directions, &mut hits);
                }
            }
            hits
        })
        .collect();
    let mut hits = vec![None; directions.len()];
    for chunk in chunks {
        for (hit, new) in hits.iter_mut().zip(chunk) {
            keep_nearer(hit, new);
        }
    }
    hits
}

/// Directions in eights, by coordinate, so that a triangle is held against many at once: most are small and lie between all
/// of them.
struct Apart(Vec<[[f32; 8]; 3]>);

impl Apart {
    fn of(directions: &[Vec3]) -> Self {
        let eight = |some: &[Vec3]| {
            // The first again where there are fewer.
            let of = |axis: usize, i: usize| some.get(i).unwrap_or(&some[0]).normalize_or_zero()[axis];
            std::array::from_fn(|axis| std::array::from_fn(|i| of(axis, i)))
        };
        Self(directions.chunks(8).map(eight).collect())
    }

    /// Whether a direction lies in the cone around the sphere that holds a triangle, which is seen from the origin.
    fn may_meet(&self, [a, b, c]: [Vec3; 3]) -> bool {
        /// By how much less than the cone's the cosine may be.
        const ROUNDING: f32 = 0.999;
        let middle = (a + b + c) / 3.0;
        let radius = [a, b, c].map(|p| p.distance_squared(middle)).into_iter().fold(0.0, f32::max);
        let least = (middle.length_squared() - radius).max(0.0).sqrt() * ROUNDING;
        let mut most = [f32::NEG_INFINITY; 8];
        for [x, y, z] in &self.0 {
            for i in 0..8 {
                let along = x[i] * middle.x + y[i] * middle.y + z[i] * middle.z;
                most[i] = if along > most[i] { along } else { most[i] };
            }
        }
        // Of numbers that overflow nothing is known.
        let is_known = middle.is_finite() && least.is_finite();
        !is_known || most.iter().any(|along| *along >= least)
    }
}

fn keep_nearer(hit: &mut Option<Hit>, new: Option<Hit>) {
    if let Some(n) = new
        && hit.is_none_or(|h| n.distance < h.distance)
    {
        *hit = Some(n);
    }
}

/// Möller & Trumbore 1997 for several directions; not watertight, which does not matter here.
fn meet(origin: Vec3, [a, b, c]: [Vec3; 3], directions: &[Vec3], hits: &mut [Option<Hit>]) {
    let (e, f, s) = (b - a, c - a, origin - a);
    let q = s.cross(e);
    let distance = f.dot(q);
    for (d, hit) in directions.iter().zip(hits) {
        let p = d.cross(f);
        let det = e.dot(p);
        if det == 0.0 {
            continue;
        }
        let inverse = 1.0 / det;
        let (u, v, t) = (s.dot(p) * inverse, d.dot(q) * inverse, distance * inverse);
        if u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0 {
            keep_nearer(hit, Some(Hit { distance: t, front: det > 0.0 }));
        }
    }
}

/// Directions spread over the sphere (Fibonacci lattice, González 2010).
pub(super) fn probe_directions() -> Vec<Vec3> {
    let golden = PI * (3.0 - 5f32.sqrt());
    (0..PROBE_DIRECTIONS)
        .map(|i| {
            let z = 1.0 - (2.0 * i as f32 + 1.0) / PROBE_DIRECTIONS as f32;
            let (s, c) = math::sin_cos(golden * i as f32);
            let r = (1.0 - z * z).sqrt();
            Vec3::new(r * c, z, r * s)
        })
        .collect()
}

/// A right-handed frame (right, up, back) about the scene's up axis; for +y that is (x, y, z).
fn axes(up: Vec3) -> [Vec3; 3] {
    let right = if up.y.abs() > 0.5 || up.z.abs() > 0.5 { Vec3::X } else { Vec3::Y };
    [right, up, right.cross(up)]
}

/// Whether the start view stands in the open, so that light from outside is expected.
pub fn is_open(scene: &Scene) -> bool {
    let eye = scene.cameras.first().map_or_else(|| default_camera(scene).0.eye, |c| c.camera.eye);
    let hits = nearest(&scene.mesh, eye, &probe_directions());
    hits.iter().flatten().count() * 20 < PROBE_DIRECTIONS * 19
}

/// Adds what is missing: light (`glows` says that what there is only glows), a camera, a path. Returns what to tell the user.
pub fn complete(scene: &mut Scene, glows: bool) -> Vec<String> {
    let mut said = Vec::new();
    if scene.cameras.is_empty() {
        let (camera, inside) = default_camera(scene);
        scene.cameras.push(NamedCamera { name: "default".to_owned(), camera });
        let place = if inside { "inside the room" } else { "in front of the whole" };
        said.push(format!("no camera; one {place} is made up (a sidecar's [[camera]] gives another)"));
    }
    if !has_light(scene) || glows {
        said.push(add_light(scene));
    }
    if scene.paths.is_empty() {
        let path = default_path(scene);
        scene.paths.push(path);
    }
    said
}

/// Whether anything in the scene emits light.
fn has_light(scene: &Scene) -> bool {
    let emits: Vec<bool> = scene.materials.iter().map(super::Material::is_emissive).collect();
    let lamp = |l: &Light| match l {
        Light::Point { intensity: v, .. } | Light::Spot { intensity: v, .. } => v.max_element() > 0.0,
        Light::Directional { irradiance, .. } => irradiance.max_element() > 0.0,
    };
    scene.environment.as_ref().is_some_and(|e| e.radiance.max_element() > 0.0)
        || scene.lights.iter().any(lamp)
        || scene.mesh.materials.iter().any(|m| emits.get(m.0 as usize).copied().unwrap_or(false))
}

/// A view of the whole bounds from a corner, or, in a closed room that shows its inner side, from
/// inside along the longest way.
fn default_camera(scene: &Scene) -> (Camera, bool) {
    let [low, high] = scene.bounds;
    let centre = (low + high) * 0.5;
    let [right, up, back] = axes(scene.up);
    let directions = probe_directions();
    let hits = nearest(&scene.mesh, centre, &directions);
    let inner = hits.iter().flatten().filter(|h| h.front).count();
    if inner * 20 >= PROBE_DIRECTIONS * 17 {
        // The farthest wall about level with the eye.
        let level = directions.iter().zip(&hits).filter(|(d, _)| d.dot(scene.up).abs() < 0.25);
        let longest =
            level.filter_map(|(d, h)| h.map(|h| (*d, h.distance))).max_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((d, distance)) = longest {
            let flat = (d - scene.up * d.dot(scene.up)).normalize_or(back);
            let eye = centre + flat * (0.6 * distance);
            return (Camera { eye, target: centre - flat * (0.1 * distance), up, fov_y: PI / 3.0 }, true);
        }
    }
    // Far enough that the eye is another point than the centre, and that squares of lengths are numbers.
    let radius = ((high - low).length() * 0.5).max(centre.abs().max_element() * 1e-5);
    let radius = if radius > 1e-15 { radius } else { 1.0 };
    let fov_y = FRAC_PI_4;
    let direction = (right * 0.7 + up * 0.5 + back).normalize();
    let eye = centre + direction * (radius / math::sin(fov_y * 0.5) * 1.05);
    (Camera { eye, target: centre, up, fov_y }, false)
}

/// A sky with a sun; where the start view is in a closed room also a lamp above it, as no sky gets in.
fn add_light(scene: &mut Scene) -> String {
    let [right, up, back] = axes(scene.up);
    scene.environment = Some(Environment { radiance: SKY, map: None, rotate_up: 0.0, up: scene.up });
    let direction = -(right * 0.45 + up * 0.8 + back * 0.4).normalize();
    scene.lights.push(Light::Directional { direction, irradiance: SUN });
    let Some(view) = scene.cameras.first().map(|c| c.camera) else {
        return "no light; a sky and a sun are made up".to_owned();
    };
    let directions = probe_directions();
    let hits = nearest(&scene.mesh, view.eye, &directions);
    let met: Vec<f32> = hits.iter().flatten().map(|h| h.distance).collect();
    if met.len() * 20 < PROBE_DIRECTIONS * 19 {
        return "no light; a sky and a sun are made up (Ke in the MTL, or a sidecar's [[light]] or \
                [environment], give others)"
            .to_owned();
    }
    let ceiling = nearest(&scene.mesh, view.eye, &[scene.up]);
    let height = ceiling.first().copied().flatten().map_or(0.0, |h| h.distance);
    let position = view.eye + scene.up * (0.8 * height);
    // What is around, at its mean distance, gets π W/m², so that white is at radiance 1.
    let mean = met.iter().sum::<f32>() / met.len() as f32;
    scene.lights.push(Light::Point {
        position,
        intensity: Vec3::splat(PI * mean * mean),
        range: f32::INFINITY,
    });
    "no light, and the start view is in a closed room; a lamp above it, a sky and a sun are made up \
     (Ke in the MTL, or a sidecar's [[light]], give others)"
        .to_owned()
}

/// Eight seconds around the start view: to each side and forward, staying clear of what is there.
fn default_path(scene: &Scene) -> CameraPath {
    let view = match scene.cameras.first() {
        Some(c) => c.camera,
        None => default_camera(scene).0,
    };
    let forward = view.target - view.eye;
    let distance = forward.length();
    let forward = forward.normalize_or(Vec3::NEG_Z);
    let right = forward.cross(view.up).normalize_or(forward.any_orthonormal_vector());
    let ways = [right, forward, -right];
    let free = nearest(&scene.mesh, view.eye, &ways);
    let reach: Vec<f32> =
        free.iter().map(|h| h.map_or(f32::INFINITY, |h| 0.4 * h.distance).min(0.15 * distance)).collect();
    let key = |t: f32, offset: Vec3| PathKey { t, eye: view.eye + offset, target: view.target };
    let keys = vec![
        key(0.0, Vec3::ZERO),
        key(2.0, ways[0] * reach[0]),
        key(4.0, ways[1] * reach[1]),
        key(6.0, ways[2] * reach[2]),
        key(8.0, Vec3::ZERO),
    ];
    CameraPath { name: "tour".to_owned(), keys }
}

#[cfg(test)]
mod tests {
    use super::super::test_scenes::{box_scene, with_camera};
    use super::*;

    #[test]
    fn probe_directions_cover_the_sphere_evenly() {
        let sum: Vec3 = probe_directions().iter().sum();
        assert!(sum.length() < 1.0, "{sum}");
        let second: f32 = probe_directions().iter().map(|d| d.x * d.x).sum::<f32>() / PROBE_DIRECTIONS as f32;
        assert!((second - 1.0 / 3.0).abs() < 0.01);
        assert!(probe_directions().iter().all(|d| (d.length() - 1.0).abs() < 1e-5));
    }

    /// Triangles that are passed over are met by no direction.
    #[test]
    fn what_lies_between_directions_is_met_by_none() {
        let directions = probe_directions();
        let apart = Apart::of(&directions);
        let mut passed = 0;
        for i in 0..20_000 {
            let mut stream = crate::rng::Stream::new(5, i, 0);
            let mut point = || Vec3::from_array([0; 3].map(|_| 2.0 * stream.next_f32() - 1.0));
            let (middle, size) = (point() * 3.0, 10f32.powi((i % 7) as i32 - 5));
            let corners = [0; 3].map(|_| middle + point() * size);
            let mut hits = vec![None; directions.len()];
            meet(Vec3::ZERO, corners, &directions, &mut hits);
            let may = apart.may_meet(corners);
            assert!(may || hits.iter().all(Option::is_none), "{corners:?}");
            passed += u32::from(!may);
        }
        assert!(passed > 10_000, "{passed}");
        assert!(apart.may_meet([Vec3::NAN; 3]) && apart.may_meet([Vec3::MAX, Vec3::MIN, Vec3::X]));
    }

    #[test]
    fn a_box_seen_from_outside_gets_sky_and_a_view_of_all_of_it() {
        let mut scene = box_scene(false);
        let said = complete(&mut scene, false);
        assert_eq!(said.len(), 2, "{said:?}");
        assert!(said[0].contains("in front") && said[1].contains("sky") && !said[1].contains("lamp"));
        let frame = scene.cameras[0].camera.frame(100, 100);
        for corner in 0..8 {
            let p = Vec3::new((corner & 1) as f32, ((corner >> 1) & 1) as f32, (corner >> 2) as f32);
            let (x, y, _) = frame.project(p).unwrap();
            assert!((0.0..100.0).contains(&x) && (0.0..100.0).contains(&y), "{p}: {x} {y}");
        }
        assert!(scene.environment.is_some());
        assert_eq!(scene.paths[0].name, "tour");
        assert_eq!(scene.paths[0].duration(), 8.0);
    }

    /// A scene of one point, or of none: the view still has a direction.
    #[test]
    fn points_are_seen_from_somewhere() {
        for at in [Vec3::ZERO, Vec3::splat(1e-38), Vec3::splat(1e-20), Vec3::new(1e7, 0.0, -3e9)] {
            let mut scene = box_scene(false);
            scene.mesh.positions.iter_mut().for_each(|p| *p = at);
            scene.bounds = [at, at];
            complete(&mut scene, false);
            let camera = scene.cameras[0].camera;
            assert!(camera.frame(8, 8).direction(4.0, 4.0).is_finite(), "{at}: {camera:?}");
        }
    }

    #[test]
    fn a_room_gets_a_view_and_a_lamp_inside() {
        let mut scene = box_scene(true);
        let said = complete(&mut scene, false);
        assert!(said[0].contains("inside") && said[1].contains("lamp"), "{said:?}");
        let inside = |p: Vec3| p.min_element() > 0.0 && p.max_element() < 1.0;
        assert!(inside(scene.cameras[0].camera.eye));
        let lamps: Vec<Vec3> = scene
            .lights
            .iter()
            .filter_map(|l| match l {
                Light::Point { position, .. } => Some(*position),
                _ => None,
            })
            .collect();
        assert_eq!(lamps.len(), 1);
        assert!(inside(lamps[0]));
        for i in 0..=80 {
            let c = scene.paths[0].at(i as f32 * 0.1, Vec3::Y, 1.0);
            assert!(inside(c.eye), "{}", c.eye);
        }
    }

    #[test]
    fn what_is_there_stays() {
        let mut scene = with_camera(box_scene(true));
        scene.materials[0].emission.color = Vec3::ONE;
        let before = scene.cameras.clone();
        assert!(complete(&mut scene, false).is_empty());
        assert_eq!(scene.cameras, before);
        assert!(scene.lights.is_empty() && scene.environment.is_none());
    }
}
