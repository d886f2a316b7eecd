//! The watertight ray–triangle test of Woop, Benthin & Wald 2013 (REFERENCE §5.2).

use glam::Vec3;

/// What of a ray the test needs, once per ray.
#[derive(Clone, Copy, Debug)]
pub struct Shear {
    axes: [usize; 3],
    x: f32,
    y: f32,
    z: f32,
}

impl Shear {
    /// For rays along `direction`; not zero.
    #[inline]
    pub fn new(direction: Vec3) -> Self {
        let a = direction.abs();
        let kz = if a.x > a.y && a.x > a.z {
            0
        } else if a.y > a.z {
            1
        } else {
            2
        };
        let (kx, ky) = ((kz + 1) % 3, (kz + 2) % 3);
        let z = 1.0 / direction[kz];
        Self { axes: [kx, ky, kz], x: direction[kx] / direction[kz], y: direction[ky] / direction[kz], z }
    }
}

/// Distance and barycentric weights of the second and third corner, if the ray hits between `t_min` and
/// `t_max`. Both sides are hit; degenerate and edge-on triangles are not.
///
/// Rounding can make an edge function zero but never give it the wrong sign; zeros are decided by exact
/// products in f64. No fused multiply-add may be used here.
#[inline(always)]
pub fn intersect(
    shear: &Shear,
    origin: Vec3,
    corners: &[Vec3; 3],
    t_min: f32,
    t_max: f32,
) -> Option<(f32, f32, f32)> {
    let [kx, ky, kz] = shear.axes;
    let [a, b, c] = corners.map(|p| p - origin);
    let (ax, ay) = (a[kx] - shear.x * a[kz], a[ky] - shear.y * a[kz]);
    let (bx, by) = (b[kx] - shear.x * b[kz], b[ky] - shear.y * b[kz]);
    let (cx, cy) = (c[kx] - shear.x * c[kz], c[ky] - shear.y * c[kz]);
    let mut u = cx * by - cy * bx;
    let mut v = ax * cy - ay * cx;
    let mut w = bx * ay - by * ax;
    if u == 0.0 || v == 0.0 || w == 0.0 {
        let edge = |p: f32, q: f32, r: f32, s: f32| {
            (f64::from(p) * f64::from(q) - f64::from(r) * f64::from(s)) as f32
        };
        u = edge(cx, by, cy, bx);
        v = edge(ax, cy, ay, cx);
        w = edge(bx, ay, by, ax);
    }
    if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
        return None;
    }
    let determinant = u + v + w;
    if determinant == 0.0 {
        return None;
    }
    let t = shear.z * (u * a[kz] + v * b[kz] + w * c[kz]) / determinant;
    // Also refuses NaN.
    (t > t_min && t < t_max).then(|| (t, v / determinant, w / determinant))
}
