//! What an object's surroundings look like from it: captured by rays, filtered for the object's lobe, looked up with
//! the distance of what was seen (Dumont 2003 §5.3; Kautz & McCool 2000; REFERENCE §9).
//!
//! In: the world without the object. Out: cube maps of radiance. They are first approximations of the view-dependent
//! part; rays correct what they get wrong (self-reflection, parallax behind edges, light of lamps without area).

mod cube;
mod filter;

use std::ops::Range;

pub use cube::{Cube, direction, solid_angle, texel_count};
pub use filter::{filtered, phong_exponent, side_of_lobe};
use glam::Vec3;
use xxhash_rust::xxh3::Xxh3;

use crate::geometry::Ray;
use crate::scene::Object;
use crate::transport::bsdf::peaks::SplitSum;
use crate::transport::bsdf::{Bsdf, BsdfSample};
use crate::transport::interaction::Interaction;
use crate::world::World;

/// What one capture ray found.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    bytemuck::Pod,
    bytemuck::Zeroable,
    serde::Serialize,
    serde::Deserialize,
)]
#[repr(C)]
pub struct Seen {
    /// Radiance towards the object.
    pub radiance: Vec3,
    /// Distance to what was seen; infinite for the environment.
    pub distance: f32,
}

/// Hash of a stretch of a capture.
pub fn digest(seen: &[Seen]) -> u64 {
    let mut h = Xxh3::new();
    h.update(bytemuck::cast_slice(seen));
    h.digest()
}

/// Surfaces that a capture ray meets at most: what it sees in a mirror it follows, along the lobe's peak alone.
const CAPTURE_DEPTH: usize = 4;

/// What a ray from `origin` sees of everything but `object`; and whether the nearest surface showed its back.
fn look(world: &World, split_sum: &SplitSum, object: u32, origin: Vec3, direction: Vec3) -> (Seen, bool) {
    let (scene, tracer) = (&*world.scene, world.tracer());
    let mut ray = Ray::new(origin, direction);
    let (mut sum, mut weight) = (Vec3::ZERO, Vec3::ONE);
    let (mut distance, mut back) = (f32::INFINITY, false);
    for depth in 0..CAPTURE_DEPTH {
        let Some(hit) = world.accel.intersect_except(scene, &ray, object) else {
            let sky = scene.environment.as_ref().map_or(Vec3::ZERO, |e| e.radiance(ray.direction));
            sum += weight * sky;
            break;
        };
        let at = Interaction::at(scene, &ray, &hit);
        if depth == 0 {
            (distance, back) = (hit.t, at.back);
        }
        sum += weight * tracer.base(&at.point(), || at);
        let bsdf = Bsdf::at(scene, &at);
        let strength = |s: &Option<BsdfSample>| s.map_or(0.0, |s| s.weight.max_element());
        let stronger = |a, b| if strength(&a) >= strength(&b) { a } else { b };
        let peak = bsdf.peaks(at.wo, split_sum).into_iter().reduce(stronger).flatten();
        let Some(peak) = peak.filter(|peak| peak.weight.max_element() > 0.02) else { break };
        weight *= peak.weight * peak.radiance_scale;
        ray = at.spawn(peak.wi);
    }
    let radiance = if sum.is_finite() { sum.max(Vec3::ZERO) } else { Vec3::ZERO };
    (Seen { radiance, distance }, back)
}

/// Traces a stretch of the texels of a capture of `side` texels around `centre`.
pub fn capture(
    world: &World,
    split_sum: &SplitSum,
    object: u32,
    centre: Vec3,
    side: usize,
    texels: Range<usize>,
) -> Vec<Seen> {
    let end = texels.end.min(texel_count(side));
    (texels.start..end)
        .map(|texel| look(world, split_sum, object, centre, direction(side, texel)).0)
        .collect()
}

/// An object's environment, ready to be looked up.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct EnvironmentMap {
    centre: Vec3,
    radiance: Cube<Vec3>,
    distance: Cube<f32>,
    mean: Vec3,
}

impl EnvironmentMap {
    /// From all texels of a capture, filtered for a lobe of this exponent; none for a mirror.
    pub fn of_capture(centre: Vec3, side: usize, seen: &[Seen], exponent: Option<f32>) -> Self {
        let raw = Cube::new(side, seen.iter().map(|s| s.radiance).collect());
        let distance = Cube::new(side, seen.iter().map(|s| s.distance).collect());
        let radiance = match exponent {
            Some(exponent) if side_of_lobe(exponent) <= 2 * side => filtered(&raw, exponent),
            _ => raw,
        };
        let mean = radiance.mean();
        Self { centre, radiance, distance, mean }
    }

    /// Mean radiance over solid angle.
    pub fn mean(&self) -> Vec3 {
        self.mean
    }

    /// The filtered radiance.
    pub fn radiance(&self) -> &Cube<Vec3> {
        &self.radiance
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.radiance.texels.len() * size_of::<Vec3>() + self.distance.texels.len() * size_of::<f32>()
    }

    /// Hash of all texels.
    pub fn digest(&self) -> u64 {
        let mut h = Xxh3::new();
        h.update(bytemuck::cast_slice(&self.radiance.texels));
        h.update(bytemuck::cast_slice(&self.distance.texels));
        h.digest()
    }

    /// Radiance that arrives at `position` from `direction`: where the ray from there meets what was seen, found by its
    /// distance (Szirmay-Kalos et al. 2005, two steps).
    #[inline]
    pub fn look_up(&self, position: Vec3, direction: Vec3) -> Vec3 {
        let offset = position - self.centre;
        let (along, apart) = (offset.dot(direction), offset.length_squared());
        let mut towards = direction;
        for _ in 0..2 {
            let distance = self.distance.nearest(towards);
            let inside = along * along + distance * distance - apart;
            if !inside.is_finite() || inside <= 0.0 {
                break;
            }
            towards = offset + direction * (inside.sqrt() - along).max(0.0);
        }
        self.radiance.sample(towards)
    }
}

/// Texels along an edge of the coarse map that every object has from the start.
pub const PROBE_SIDE: usize = 4;

/// The coarsest map of an object: what is drawn where it has no finer one, so that nothing is black.
#[derive(Clone, Debug, PartialEq)]
pub struct Probe {
    /// Where maps of this object are captured.
    pub centre: Vec3,
    /// What it sees, in few directions.
    pub map: EnvironmentMap,
}

/// Makes the probe of an object: looks around from the middle of its bounds, or from before its front where that is
/// inside or behind something.
pub fn probe(world: &World, split_sum: &SplitSum, id: u32, object: &Object) -> Probe {
    let mesh = &world.scene.mesh;
    let mut normal = Vec3::ZERO;
    for &t in &object.triangles {
        let [a, b, c] = mesh.corners(t);
        normal += (b - a).cross(c - a);
    }
    let [low, high] = object.bounds;
    let (middle, extent) = (0.5 * (low + high), high - low);
    let step = 0.05 * extent.length() + 1e-3 * world.scene.diagonal();
    // Flat things look to their front; closed ones may stand in the way of their own middle on any side.
    let front = normal.try_normalize().filter(|_| normal.length() > 0.2 * object.area).unwrap_or(Vec3::ZERO);
    let out = |axis: Vec3| axis * (0.5 * extent.dot(axis.abs()) + step);
    let candidates = [
        front * step,
        out(front),
        out(world.scene.up),
        out(Vec3::X),
        out(Vec3::NEG_X),
        out(Vec3::Z),
        out(Vec3::NEG_Z),
        out(-world.scene.up),
    ];
    let white = 4.0 / world.scene.display.exposure.max(f32::MIN_POSITIVE);
    let mut best: Option<(usize, Vec3, Vec<Seen>)> = None;
    for offset in candidates {
        let centre = middle + offset;
        let looks: Vec<(Seen, bool)> = (0..texel_count(PROBE_SIDE))
            .map(|i| look(world, split_sum, id, centre, direction(PROBE_SIDE, i)))
            .collect();
        let blind = looks.iter().filter(|(seen, back)| *back || seen.distance < 0.2 * step).count();
        if best.as_ref().is_none_or(|(least, ..)| blind < *least) {
            // A lamp in one of so few texels would outshine all else.
            let bounded = |seen: Seen| Seen { radiance: seen.radiance.min(Vec3::splat(white)), ..seen };
            best = Some((blind, centre, looks.into_iter().map(|(seen, _)| bounded(seen)).collect()));
        }
        if best.as_ref().is_some_and(|(blind, ..)| *blind < texel_count(PROBE_SIDE) / 4) {
            break;
        }
    }
    let (_, centre, seen) = best.unwrap_or_default();
    let map = if seen.is_empty() {
        EnvironmentMap::of_capture(centre, PROBE_SIDE, &vec![Seen::default(); texel_count(PROBE_SIDE)], None)
    } else {
        EnvironmentMap::of_capture(centre, PROBE_SIDE, &seen, None)
    };
    Probe { centre, map }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_look_up_sees_walls_where_they_are() {
        // A room with walls at ±1, captured from its middle; each point of the wall has its own colour.
        let side = 64;
        let wall = |d: Vec3| d / d.abs().max_element();
        let seen: Vec<Seen> = (0..texel_count(side))
            .map(|i| {
                let hit = wall(direction(side, i));
                Seen { radiance: hit * 0.5 + 0.5, distance: hit.length() }
            })
            .collect();
        let map = EnvironmentMap::of_capture(Vec3::ZERO, side, &seen, None);
        let position = Vec3::new(0.5, -0.3, 0.2);
        for direction in [Vec3::X, Vec3::NEG_Z, Vec3::new(0.3, 1.0, 0.2).normalize()] {
            let t = ((direction.signum() - position) / direction)
                .to_array()
                .into_iter()
                .filter(|t| *t > 0.0)
                .fold(f32::INFINITY, f32::min);
            let exact = (position + direction * t) * 0.5 + 0.5;
            let found = map.look_up(position, direction);
            let without = map.radiance().sample(direction);
            assert!((found - exact).length() < 0.06, "{direction}: {found}, not {exact}");
            assert!((without - exact).length() > (found - exact).length());
        }
    }
}
