//! The environment: radiance that arrives from outside the scene.

use std::f32::consts::{PI, TAU};

use glam::Vec3;

use crate::image::Map2d;
use crate::math;

/// The environment: a constant radiance, or an equirectangular map times `radiance`.
#[derive(Clone, Debug)]
pub struct Environment {
    /// Radiance where there is no map, and the factor of the map otherwise.
    pub radiance: Vec3,
    /// Equirectangular radiance; column = atan2(d.x, −d.z) / 2π in the frame where `up` is +y,
    /// after turning by `rotate_up`; row 0 is straight up. Finite and not negative.
    pub map: Option<Map2d<Vec3>>,
    /// Rotation about up, right-handed, radians.
    pub rotate_up: f32,
    /// The scene's up axis, unit.
    pub up: Vec3,
}

/// `v` in the frame where the axis `up` is +y. Axes map to axes; the other two keep their order as
/// far as right-handedness allows (z up: x → x, y → −z).
fn y_up_from_scene(v: Vec3, up: Vec3) -> Vec3 {
    let a = up.abs();
    if a.x > a.y && a.x > a.z {
        if up.x > 0.0 { Vec3::new(-v.y, v.x, v.z) } else { Vec3::new(v.y, -v.x, v.z) }
    } else if a.z > a.y {
        if up.z > 0.0 { Vec3::new(v.x, v.z, -v.y) } else { Vec3::new(v.x, -v.z, v.y) }
    } else if up.y < 0.0 {
        Vec3::new(v.x, -v.y, -v.z)
    } else {
        v
    }
}

/// The inverse of [`y_up_from_scene`].
fn scene_from_y_up(v: Vec3, up: Vec3) -> Vec3 {
    let a = up.abs();
    if a.x > a.y && a.x > a.z {
        if up.x > 0.0 { Vec3::new(v.y, -v.x, v.z) } else { Vec3::new(-v.y, v.x, v.z) }
    } else if a.z > a.y {
        if up.z > 0.0 { Vec3::new(v.x, -v.z, v.y) } else { Vec3::new(v.x, v.z, -v.y) }
    } else if up.y < 0.0 {
        Vec3::new(v.x, -v.y, -v.z)
    } else {
        v
    }
}

impl Environment {
    /// The same radiance from everywhere.
    pub fn constant(radiance: Vec3) -> Self {
        Self { radiance, map: None, rotate_up: 0.0, up: Vec3::Y }
    }

    /// Map position in [0, 1)², column first, of a direction that need not be unit.
    #[inline]
    pub fn position(&self, direction: Vec3) -> [f32; 2] {
        let d = y_up_from_scene(direction, self.up);
        let column = (math::atan2(d.x, -d.z) + self.rotate_up) / TAU;
        let row = math::atan2(d.y, math::hypot(d.x, d.z));
        [column - column.floor(), (0.5 - row / PI).clamp(0.0, 1.0)]
    }

    /// The unit direction of a map position in [0, 1]²: the inverse of [`Self::position`].
    #[inline]
    pub fn direction(&self, position: [f32; 2]) -> Vec3 {
        let phi = position[0] * TAU - self.rotate_up;
        let theta = position[1] * PI;
        let (s, c) = math::sin_cos(theta);
        scene_from_y_up(Vec3::new(s * math::sin(phi), c, -s * math::cos(phi)), self.up)
    }

    /// Radiance that arrives against `direction` (which points away from the scene), bilinear
    /// between texel centres. Finite for any direction.
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        let Some(map) = &self.map else { return self.radiance };
        if !direction.is_finite() || map.width() == 0 || map.height() == 0 {
            return Vec3::ZERO;
        }
        let [u, v] = self.position(direction);
        let (w, h) = (map.width() as isize, map.height() as isize);
        let x = u * w as f32 - 0.5;
        let y = v * h as f32 - 0.5;
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        // At most one column beyond either side: a remainder would take longer than all else here.
        let around = |c: isize| if c < 0 { c + w } else { c - if c < w { 0 } else { w } };
        let columns = [around(x0 as isize), around(x0 as isize + 1)];
        let row = |y: isize| {
            let y = y.clamp(0, h - 1) as usize;
            let [a, b] = columns.map(|c| map.at(c as usize, y));
            a + (b - a) * fx
        };
        let (top, bottom) = (row(y0 as isize), row(y0 as isize + 1));
        (top + (bottom - top) * fy) * self.radiance
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AXES: [Vec3; 6] = [Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z];

    fn with_map(up: Vec3, rotate_up: f32) -> Environment {
        let map = Map2d::from_fn(8, 4, |x, y| Vec3::new(x as f32, y as f32, 1.0));
        Environment { radiance: Vec3::ONE, map: Some(map), rotate_up, up }
    }

    #[test]
    fn the_middle_column_looks_along_plus_z() {
        let e = with_map(Vec3::Y, 0.0);
        assert!((e.position(Vec3::Z)[0] - 0.5).abs() < 1e-6);
        assert!((e.position(Vec3::X)[0] - 0.25).abs() < 1e-6);
        assert!((e.position(Vec3::NEG_X)[0] - 0.75).abs() < 1e-6);
        assert_eq!(e.position(Vec3::Y)[1], 0.0);
        assert_eq!(e.position(Vec3::NEG_Y)[1], 1.0);
    }

    #[test]
    fn rotation_is_right_handed_about_up() {
        // A quarter turn brings the middle of the map from +z to +x.
        let e = with_map(Vec3::Y, PI / 2.0);
        assert!((e.position(Vec3::X)[0] - 0.5).abs() < 1e-6);
    }

    #[test]
    fn position_and_direction_are_inverse_for_every_axis() {
        for up in AXES {
            let e = with_map(up, 0.7);
            assert!((e.direction([0.3, 0.0]) - up).length() < 1e-6, "{up}");
            for (i, v) in [(1, 0.1), (3, 0.4), (5, 0.5), (7, 0.9)] {
                let p = [i as f32 / 8.0, v];
                let q = e.position(e.direction(p));
                assert!((p[0] - q[0]).abs() < 1e-5 && (p[1] - q[1]).abs() < 1e-5, "{up}: {p:?} {q:?}");
            }
            // Right-handed: the frame change keeps cross products.
            let (a, b) = (Vec3::new(1.0, 2.0, 3.0), Vec3::new(-2.0, 0.5, 1.0));
            let whole = y_up_from_scene(a.cross(b), up);
            assert_eq!(whole, y_up_from_scene(a, up).cross(y_up_from_scene(b, up)));
        }
    }

    #[test]
    fn texel_centres_give_their_texel_and_the_seam_wraps() {
        let e = with_map(Vec3::Y, 0.0);
        let l = e.radiance(e.direction([2.5 / 8.0, 1.5 / 4.0]));
        assert!((l - Vec3::new(2.0, 1.0, 1.0)).length() < 1e-4, "{l}");
        let seam = e.radiance(e.direction([0.0, 1.5 / 4.0]));
        assert!((seam.x - 3.5).abs() < 1e-3, "{seam}");
        assert_eq!(e.radiance(Vec3::splat(f32::NAN)), Vec3::ZERO);
        assert!(e.radiance(Vec3::ZERO).is_finite());
    }
}
