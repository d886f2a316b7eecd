//! Camera paths by time.

use glam::Vec3;

use super::Scene;
use super::camera::{Camera, CameraPath, PathKey};

/// Position and view target at a time.
fn hermite(keys: &[PathKey], segment: usize, s: f32, value: impl Fn(&PathKey) -> Vec3) -> Vec3 {
    // Tangents from the neighbours by time (Catmull & Rom 1974, on uneven knots); one-sided at the ends.
    let tangent = |i: usize| {
        let (a, b) = (i.saturating_sub(1), (i + 1).min(keys.len() - 1));
        let dt = keys[b].t - keys[a].t;
        if dt > 0.0 { (value(&keys[b]) - value(&keys[a])) / dt } else { Vec3::ZERO }
    };
    let (k0, k1) = (&keys[segment], &keys[segment + 1]);
    let dt = k1.t - k0.t;
    let (s2, s3) = (s * s, s * s * s);
    value(k0) * (2.0 * s3 - 3.0 * s2 + 1.0)
        + tangent(segment) * (dt * (s3 - 2.0 * s2 + s))
        + value(k1) * (3.0 * s2 - 2.0 * s3)
        + tangent(segment + 1) * (dt * (s3 - s2))
}

impl CameraPath {
    /// Seconds from the first key to the last.
    pub fn duration(&self) -> f32 {
        match (self.keys.first(), self.keys.last()) {
            (Some(a), Some(b)) => (b.t - a.t).max(0.0),
            _ => 0.0,
        }
    }

    /// The camera `t` seconds after the first key; before the start and after the end it stands
    /// still. `up` and `fov_y` (radians) are those of the start view.
    ///
    /// Deviation from a plain Catmull–Rom curve: tangents divide by the time between keys, so the
    /// speed is continuous for uneven keys as well.
    pub fn at(&self, t: f32, up: Vec3, fov_y: f32) -> Camera {
        let Some(first) = self.keys.first() else {
            return Camera { eye: Vec3::ZERO, target: Vec3::NEG_Z, up, fov_y };
        };
        let last = self.keys.len() - 1;
        let time = first.t + if t > 0.0 { t } else { 0.0 };
        // Number of keys at or before `time`, at least one.
        let passed = self.keys.partition_point(|k| k.t <= time).max(1);
        if passed > last {
            let k = &self.keys[last];
            return Camera { eye: k.eye, target: k.target, up, fov_y };
        }
        let segment = passed - 1;
        let (a, b) = (&self.keys[segment], &self.keys[segment + 1]);
        let s = ((time - a.t) / (b.t - a.t)).clamp(0.0, 1.0);
        let eye = hermite(&self.keys, segment, s, |k| k.eye);
        let target = hermite(&self.keys, segment, s, |k| k.target);
        // Where the curves cross there is no view; keep that of the key.
        let view = target - eye;
        let least = 1e-5 * (a.target - a.eye).length();
        let target = if view.length() > least { target } else { eye + (a.target - a.eye) };
        Camera { eye, target, up, fov_y }
    }
}

/// Poses along each path that stand for it.
const POSES: usize = 16;

impl Scene {
    /// Where a walk may stand: its cameras, and poses along its paths.
    pub fn standpoints(&self) -> Vec<Camera> {
        let fov_y = self.cameras.first().map_or(1.0, |c| c.camera.fov_y);
        let along = self.paths.iter().flat_map(|path| {
            let pose = |i| path.at((i as f32 + 0.5) / POSES as f32 * path.duration(), self.up, fov_y);
            (0..POSES).map(pose).collect::<Vec<Camera>>()
        });
        self.cameras.iter().map(|c| c.camera).chain(along).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path(keys: &[(f32, f32)]) -> CameraPath {
        let keys =
            keys.iter().map(|&(t, x)| PathKey { t, eye: Vec3::X * x, target: Vec3::new(x, 0.0, -1.0) });
        CameraPath { name: "p".into(), keys: keys.collect() }
    }

    fn x(p: &CameraPath, t: f32) -> f32 {
        p.at(t, Vec3::Y, 1.0).eye.x
    }

    #[test]
    fn keys_are_met_at_their_times() {
        let p = path(&[(1.0, 0.0), (2.0, 5.0), (5.0, -1.0), (5.5, 2.0)]);
        assert_eq!(p.duration(), 4.5);
        for (t, e) in [
            (0.0, 0.0),
            (1.0, 5.0),
            (4.0, -1.0),
            (4.5, 2.0),
            (9.0, 2.0),
            (-3.0, 0.0),
            (f32::NAN, 0.0),
            (f32::INFINITY, 2.0),
        ] {
            assert!((x(&p, t) - e).abs() < 1e-5, "{t}: {}", x(&p, t));
        }
    }

    #[test]
    fn even_motion_stays_even_on_uneven_keys() {
        let p = path(&[(0.0, 0.0), (1.0, 1.0), (4.0, 4.0), (4.5, 4.5)]);
        for i in 0..=45 {
            let t = i as f32 * 0.1;
            assert!((x(&p, t) - t).abs() < 1e-5);
        }
    }

    #[test]
    fn speed_is_continuous() {
        let p = path(&[(0.0, 0.0), (1.0, 3.0), (3.0, 1.0), (4.0, 1.0)]);
        for key in [1.0, 3.0] {
            let h = 1e-3;
            let before = (x(&p, key) - x(&p, key - h)) / h;
            let after = (x(&p, key + h) - x(&p, key)) / h;
            assert!((before - after).abs() < 0.05, "{before} {after}");
        }
    }

    #[test]
    fn one_key_stands_still_and_crossing_curves_keep_a_view() {
        let p = path(&[(3.0, 7.0)]);
        assert_eq!((p.duration(), x(&p, 2.0)), (0.0, 7.0));
        let crossing = CameraPath {
            name: "c".into(),
            keys: vec![
                PathKey { t: 0.0, eye: Vec3::ZERO, target: Vec3::X },
                PathKey { t: 1.0, eye: Vec3::X, target: Vec3::ZERO },
            ],
        };
        for i in 0..=64 {
            let c = crossing.at(i as f32 / 64.0, Vec3::Y, 1.0);
            assert!((c.target - c.eye).length() > 1e-6);
        }
    }
}
