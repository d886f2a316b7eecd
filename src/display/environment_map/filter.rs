//! What a lobe sees of a cube.

use glam::Vec3;

use super::cube::{Cube, direction, solid_angle, texel_count};
use crate::math;

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
}
