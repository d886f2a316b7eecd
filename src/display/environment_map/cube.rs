//! Cubes of texels around a point.

use glam::{Vec2, Vec3};

use crate::math;

/// Faces of a cube of `side × side` texels each, one value per texel: face, row, column.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Cube<T> {
    pub(super) side: usize,
    pub(super) texels: Vec<T>,
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
    pub(super) fn halved(&self) -> Self {
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

#[cfg(test)]
mod tests {
    use super::*;

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
}
