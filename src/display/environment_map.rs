//! What an object's surroundings look like from it: captured by rays, filtered for the object's lobe, looked up with
//! the distance of what was seen (Dumont 2003 §5.3; Kautz & McCool 2000; REFERENCE §9).
//!
//! In: the world without the object. Out: cube maps of radiance. They are first approximations of the view-dependent
//! part; rays correct what they get wrong (self-reflection, parallax behind edges, light of lamps without area).

use std::ops::Range;

use glam::{Vec2, Vec3};
use xxhash_rust::xxh3::Xxh3;

use crate::geometry::Ray;
use crate::math;
use crate::scene::Object;
use crate::transport::bsdf::peaks::SplitSum;
use crate::transport::bsdf::{Bsdf, BsdfSample};
use crate::transport::interaction::Interaction;
use crate::world::World;

/// Faces of a cube of `side × side` texels each, one value per texel: face, row, column.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Cube<T> {
    side: usize,
    texels: Vec<T>,
}

/// Axis of each face: +x, −x, +y, −y, +z, −z, with the axes of its columns and rows.
const FACES: [[Vec3; 3]; 6] = [
    [Vec3::X, Vec3::NEG_Z, Vec3::NEG_Y],
    [Vec3::NEG_X, Vec3::Z, Vec3::NEG_Y],
    [Vec3::Y, Vec3::X, Vec3::Z],
    [Vec3::NEG_Y, Vec3::X, Vec3::NEG_Z],
    [Vec3::Z, Vec3::X, Vec3::NEG_Y],
    [Vec3::NEG_Z, Vec3::NEG_X, Vec3::NEG_Y],
];

/// Number of texels of a cube.
pub const fn texel_count(side: usize) -> usize {
    6 * side * side
}

/// Unit direction through the centre of a texel.
pub fn direction(side: usize, texel: usize) -> Vec3 {
    let (face, rest) = (texel / (side * side), texel % (side * side));
    let [axis, across, down] = FACES[face.min(5)];
    let position = |i: usize| (2 * i + 1) as f32 / side as f32 - 1.0;
    (axis + across * position(rest % side) + down * position(rest / side)).normalize()
}

/// Solid angle of a texel, steradians.
///
/// Source: the difference of atan2(xy, √(x² + y² + 1)) at its corners (REFERENCE §9).
pub fn solid_angle(side: usize, texel: usize) -> f32 {
    let rest = texel % (side * side);
    let corner = |x: usize, y: usize| {
        let at = |i: usize| 2.0 * i as f64 / side as f64 - 1.0;
        let (x, y) = (at(x), at(y));
        math::atan2(x * y, (x * x + y * y + 1.0).sqrt())
    };
    let (x, y) = (rest % side, rest / side);
    (corner(x, y) - corner(x, y + 1) - corner(x + 1, y) + corner(x + 1, y + 1)) as f32
}

/// Face and position in [0, 1]² on it.
#[inline]
fn project(direction: Vec3) -> (usize, Vec2) {
    let a = direction.abs();
    let face = if a.x >= a.y && a.x >= a.z {
        usize::from(direction.x < 0.0)
    } else if a.y >= a.z {
        2 + usize::from(direction.y < 0.0)
    } else {
        4 + usize::from(direction.z < 0.0)
    };
    let [axis, across, down] = FACES[face];
    let depth = direction.dot(axis).max(f32::MIN_POSITIVE);
    let at = Vec2::new(direction.dot(across), direction.dot(down)) / depth;
    let at = if at.is_finite() { at.clamp(Vec2::NEG_ONE, Vec2::ONE) } else { Vec2::ZERO };
    (face, at * 0.5 + 0.5)
}

impl<T: Copy> Cube<T> {
    /// A cube of these texels.
    ///
    /// # Panics
    /// If their number is not 6 · side²: a bug of the caller.
    pub fn new(side: usize, texels: Vec<T>) -> Self {
        assert_eq!(texels.len(), texel_count(side), "six faces of {side} × {side}");
        Self { side, texels }
    }

    /// Texels along an edge.
    pub fn side(&self) -> usize {
        self.side
    }

    /// All texels.
    pub fn texels(&self) -> &[T] {
        &self.texels
    }

    /// The texel that holds a direction.
    #[inline]
    pub fn nearest(&self, direction: Vec3) -> T {
        let (face, p) = project(direction);
        let at = |p: f32| ((p * self.side as f32) as usize).min(self.side - 1);
        self.texels[(face * self.side + at(p.y)) * self.side + at(p.x)]
    }
}

impl Cube<Vec3> {
    /// Bilinear look-up within the face of a direction.
    #[inline]
    pub fn sample(&self, direction: Vec3) -> Vec3 {
        let (face, p) = project(direction);
        let position = |p: f32| {
            let p = (p * self.side as f32 - 0.5).clamp(0.0, (self.side - 1) as f32);
            let low = p as usize;
            (low, (low + 1).min(self.side - 1), p - low as f32)
        };
        let ((xa, xb, fx), (ya, yb, fy)) = (position(p.x), position(p.y));
        let at = |x: usize, y: usize| self.texels[(face * self.side + y) * self.side + x];
        at(xa, ya).lerp(at(xb, ya), fx).lerp(at(xa, yb).lerp(at(xb, yb), fx), fy)
    }

    /// Mean over solid angle.
    pub fn mean(&self) -> Vec3 {
        let mut sum = Vec3::ZERO;
        for (i, &texel) in self.texels.iter().enumerate() {
            sum += texel * solid_angle(self.side, i);
        }
        sum / (4.0 * std::f32::consts::PI)
    }

    /// Half the side, each texel the mean of four. Sides of one stay.
    fn halved(&self) -> Self {
        let side = (self.side / 2).max(1);
        let step = self.side / side;
        let texel = |i: usize| {
            let (face, y, x) = (i / (side * side), i / side % side, i % side);
            let mut sum = Vec3::ZERO;
            for k in 0..step * step {
                let (sx, sy) = (x * step + k % step, y * step + k / step);
                sum += self.texels[(face * self.side + sy) * self.side + sx];
            }
            sum / (step * step) as f32
        };
        Self { side, texels: (0..texel_count(side)).map(texel).collect() }
    }
}

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
    /// Distance to what was seen; infinite for the surrounding.
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

/// What lobes are as sharp as: the Phong exponent around the mirrored direction for a microfacet α, none for mirrors.
///
/// n = (2/m² − 2)/4: Phong around r equals Blinn of four times the exponent around h (REFERENCE §9).
pub fn phong_exponent(alpha: f32) -> Option<f32> {
    (alpha > 0.0).then(|| (0.5 / (alpha * alpha).max(1e-6) - 0.5).max(1.0))
}

/// Texels along an edge that a lobe's width needs: 90° / (σ/2), σ = acos((n+1)/(n+2)), as a power of two.
pub fn side_of_lobe(exponent: f32) -> usize {
    let sigma = math::acos(((exponent + 1.0) / (exponent + 2.0)).min(1.0));
    let side = std::f32::consts::FRAC_PI_2 / (0.5 * sigma).max(1e-4);
    (side.min(256.0) as usize).next_power_of_two().clamp(8, 256)
}

/// cosⁿ as a table, to 1e-5 of its peak; what is below a thousandth of that is left out.
struct Lobe {
    /// The cosine where it begins.
    least: f32,
    steps_per_unit: f32,
    values: [f32; Self::STEPS + 2],
}

impl Lobe {
    const STEPS: usize = 1024;

    fn new(exponent: f32) -> Self {
        let least = math::powf(1e-3, 1.0 / exponent.max(1.0)).min(1.0 - f32::EPSILON);
        let (first, exponent) = (f64::from(least), f64::from(exponent));
        let step = (1.0 - first) / Self::STEPS as f64;
        let values = std::array::from_fn(|i| math::powf(first + step * i as f64, exponent) as f32);
        Self { least, steps_per_unit: (1.0 / step) as f32, values }
    }

    /// At a cosine of `least` or more.
    #[inline]
    fn at(&self, cosine: f32) -> f32 {
        let place = (cosine - self.least) * self.steps_per_unit;
        let i = (place as usize).min(Self::STEPS);
        self.values[i] + (self.values[i + 1] - self.values[i]) * (place - i as f32)
    }
}

/// Texels along an edge that a lobe is integrated over, for a result of `side`: twice as fine where that is coarse. Sharper
/// lobes, whose texels are half a lobe's width, are not blurred visibly by them (their variance grows by 4 %), and twice as
/// fine a polished floor's map held a tracer for four times as long.
fn source_side(side: usize) -> usize {
    (2 * side).min(side.max(64))
}

/// Filters a cube with the normalised Phong lobe (n+1)/(2π) [⟨r, ω⟩]₊ⁿ: each texel of the result is what a lobe around
/// it sees. The result has [`side_of_lobe`] texels along an edge at most.
pub fn filtered(map: &Cube<Vec3>, exponent: f32) -> Cube<Vec3> {
    let side = side_of_lobe(exponent).min(map.side);
    let mut source = map.clone();
    while source.side > source_side(side) {
        source = source.halved();
    }
    let n = source.side;
    let lobe = Lobe::new(exponent);
    let texels: Vec<(Vec3, Vec3)> =
        (0..texel_count(n)).map(|i| (direction(n, i), source.texels[i] * solid_angle(n, i))).collect();
    let weights: Vec<f32> = (0..texel_count(n)).map(|i| solid_angle(n, i)).collect();
    let reach = math::acos(lobe.least);
    let (sources, targets) = (Blocks::of(n), Blocks::of(side));
    let cones: Vec<Cone> = (0..sources.count()).map(|b| sources.cone(b, reach)).collect();
    let filter = |target: usize, near: &[usize]| {
        let r = direction(side, target);
        let (mut sum, mut total) = (Vec3::ZERO, 0.0f32);
        for &b in near.iter().filter(|b| r.dot(cones[**b].axis) >= cones[**b].cosine) {
            for i in sources.members(b) {
                let cosine = r.dot(texels[i].0);
                if cosine >= lobe.least {
                    let share = lobe.at(cosine);
                    sum += texels[i].1 * share;
                    total += weights[i] * share;
                }
            }
        }
        // Divided by the lobe's own sum, so that a constant stays constant at any resolution.
        if total > 0.0 { sum / total } else { source.nearest(r) }
    };
    let mut result = vec![Vec3::ZERO; texel_count(side)];
    let mut near = Vec::new();
    for block in 0..targets.count() {
        let around = targets.cone(block, ROUNDING);
        near.clear();
        near.extend((0..cones.len()).filter(|b| around.meets(&cones[*b])));
        for target in targets.members(block) {
            result[target] = filter(target, &near);
        }
    }
    Cube { side, texels: result }
}

/// An angle by which cones are wider than what they hold.
const ROUNDING: f32 = 1e-3;

/// Squares of texels of a cube, to skip what a lobe does not reach.
struct Blocks {
    /// Texels along an edge of the cube, and of a square.
    side: usize,
    block: usize,
}

impl Blocks {
    fn of(side: usize) -> Self {
        Self { side, block: side.min(8) }
    }

    fn count(&self) -> usize {
        6 * (self.side / self.block).pow(2)
    }

    fn members(&self, b: usize) -> impl Iterator<Item = usize> + use<> {
        let (side, block, across) = (self.side, self.block, self.side / self.block);
        let (face, y, x) = (b / (across * across), b % (across * across) / across, b % across);
        (0..block * block).map(move |k| (face * side + y * block + k / block) * side + x * block + k % block)
    }

    /// The cone around a square, wider by `more`.
    fn cone(&self, b: usize, more: f32) -> Cone {
        let axis = self.members(b).map(|i| direction(self.side, i)).sum::<Vec3>().normalize();
        let least = self.members(b).map(|i| axis.dot(direction(self.side, i))).fold(1.0f32, f32::min);
        let angle = (math::acos(least) + more).min(std::f32::consts::PI);
        Cone { axis, cosine: math::cos(angle), sine: math::sin(angle) }
    }
}

/// Directions around an axis, up to an angle of at most π.
struct Cone {
    axis: Vec3,
    cosine: f32,
    sine: f32,
}

impl Cone {
    /// Whether both share a direction.
    fn meets(&self, other: &Self) -> bool {
        // The sum of both angles is beyond π where its sine is below zero.
        let sine = self.sine * other.cosine + self.cosine * other.sine;
        sine < 0.0 || self.axis.dot(other.axis) >= self.cosine * other.cosine - self.sine * other.sine
    }
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
    use crate::rng;

    #[test]
    fn lobes_are_powers() {
        for exponent in [1.0, 1.5, 7.0, 48.0, 1000.0, 5e5f32] {
            let lobe = Lobe::new(exponent);
            for i in 0..=10_000 {
                let cosine = lobe.least + (1.0 - lobe.least) * i as f32 * 1e-4;
                let exact = math::powf(f64::from(cosine), f64::from(exponent));
                assert!((f64::from(lobe.at(cosine)) - exact).abs() < 1e-5, "{cosine} to the {exponent}");
            }
            // Of directions that are unit up to rounding.
            assert!((lobe.at(1.0f32.next_up()) - 1.0).abs() < 0.1);
        }
    }

    #[test]
    fn solid_angles_fill_the_sphere() {
        for side in [1, 4, 16] {
            let sum: f64 = (0..texel_count(side)).map(|i| f64::from(solid_angle(side, i))).sum();
            assert!((sum / (4.0 * std::f64::consts::PI) - 1.0).abs() < 1e-5, "{side} {sum}");
        }
        let ratio = solid_angle(16, 8 * 16 + 8) / solid_angle(16, 0);
        assert!((ratio - 4.51).abs() < 0.01, "{ratio}");
    }

    #[test]
    fn directions_come_back() {
        for side in [1, 5, 16] {
            let cube = Cube::new(side, (0..texel_count(side)).collect());
            for i in 0..texel_count(side) {
                assert_eq!(cube.nearest(direction(side, i)), i);
            }
        }
        for wrong in [Vec3::ZERO, Vec3::NAN, Vec3::INFINITY, Vec3::new(1e-40, 0.0, 0.0)] {
            let cube = Cube::new(4, vec![Vec3::ONE; texel_count(4)]);
            assert_eq!(cube.sample(wrong), Vec3::ONE);
        }
    }

    /// L = [z]₊ seen by lobes of several widths.
    #[test]
    fn filtering_gives_the_numbers_of_the_reference() {
        let side = 64;
        let sky = Cube::new(
            side,
            (0..texel_count(side)).map(|i| Vec3::splat(direction(side, i).z.max(0.0))).collect(),
        );
        let at = |degrees: f32| {
            let (s, c) = math::sin_cos(degrees.to_radians());
            Vec3::new(s, 0.0, c)
        };
        for (n, degrees, expected) in [
            (1.0, 0.0, 0.66667),
            (10.0, 0.0, 0.91667),
            (100.0, 0.0, 0.99020),
            (1.0, 60.0, 0.40600),
            (10.0, 60.0, 0.46267),
            (100.0, 60.0, 0.49510),
            (1.0, 90.0, 0.21221),
            (10.0, 90.0, 0.11279),
            (100.0, 90.0, 0.0394),
            (1.0, 120.0, 0.07267),
            (10.0, 120.0, 0.00434),
        ] {
            let map = filtered(&sky, n);
            let found = map.sample(at(degrees)).x;
            let tolerance = if n == 1.0 { 0.03 } else { 0.015 };
            assert!((found - expected).abs() < tolerance, "n {n}, {degrees}°: {found}, not {expected}");
        }
        let constant = filtered(&Cube::new(16, vec![Vec3::ONE; texel_count(16)]), 30.0);
        assert!(constant.texels().iter().all(|v| (*v - Vec3::ONE).abs().max_element() < 1e-5));
    }

    /// What squares skip is what no lobe reaches.
    #[test]
    fn squares_skip_nothing_that_counts() {
        let value = |i: usize, salt| rng::hash(7, i as u64, salt) as f32 / u64::MAX as f32;
        let texels = (0..texel_count(32)).map(|i| Vec3::new(value(i, 0), value(i, 1), value(i, 2))).collect();
        let map = Cube::new(32, texels);
        for exponent in [1.0, 7.0, 60.0, 300.0, 5000.0] {
            let result = filtered(&map, exponent);
            let mut source = map.clone();
            while source.side > source_side(result.side) {
                source = source.halved();
            }
            let (n, lobe) = (source.side, Lobe::new(exponent));
            for target in (0..texel_count(result.side)).step_by(17) {
                let r = direction(result.side, target);
                let (mut sum, mut total) = (Vec3::ZERO, 0.0);
                for i in 0..texel_count(n) {
                    let cosine = r.dot(direction(n, i));
                    if cosine >= lobe.least {
                        let share = lobe.at(cosine) * solid_angle(n, i);
                        sum += source.texels[i] * share;
                        total += share;
                    }
                }
                let apart = (sum / total - result.texels[target]).abs().max_element();
                assert!(apart < 1e-5, "{exponent}: {target}");
            }
        }
    }

    #[test]
    fn sides_of_lobes() {
        for (n, side) in [(10.0, 8), (50.0, 16), (100.0, 32), (500.0, 64), (1000.0, 128)] {
            let found = side_of_lobe(n);
            assert!(found == side || found == 2 * side, "{n}: {found}");
        }
        assert_eq!(phong_exponent(0.0), None);
        assert!((phong_exponent(0.1).unwrap() - 49.5).abs() < 0.01);
    }

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
