//! Form factors between patches by discs, with visibility by rays (REFERENCE §7.2).

use std::f32::consts::PI;

use glam::Vec3;

use crate::rng::Stream;

/// Whether two points see each other.
pub type Visible<'a> = &'a (dyn Fn(Vec3, Vec3) -> bool + Sync);

/// Fraction of the energy leaving a point at `p` with normal `np` that reaches a disc of `area` at `q`:
/// \[cos\]+ \[cos\]+ A / (π r² + A). Bounded by 1 at any distance.
pub fn disc(p: Vec3, np: Vec3, q: Vec3, nq: Vec3, area: f32) -> f32 {
    let d = q - p;
    let r2 = d.length_squared();
    if r2 <= 0.0 {
        return 0.0;
    }
    let cosines = np.dot(d).max(0.0) * (-nq.dot(d)).max(0.0) / r2;
    cosines * area / (PI * r2 + area)
}

/// The four triangles of a midpoint subdivision: three at the corners, then the middle one.
pub fn subdivide([a, b, c]: [Vec3; 3]) -> [[Vec3; 3]; 4] {
    let (ab, bc, ca) = ((a + b) * 0.5, (b + c) * 0.5, (c + a) * 0.5);
    [[a, ab, ca], [ab, b, bc], [ca, bc, c], [bc, ca, ab]]
}

/// Centroid of a triangle.
pub fn centroid([a, b, c]: [Vec3; 3]) -> Vec3 {
    (a + b + c) / 3.0
}

fn random_point([a, b, c]: [Vec3; 3], [u, v]: [f32; 2]) -> Vec3 {
    let s = u.sqrt();
    a * (1.0 - s) + b * (s * (1.0 - v)) + c * (s * v)
}

/// A triangle as form factors need it.
#[derive(Clone, Copy, Debug)]
pub struct Facet {
    /// Corners.
    pub corners: [Vec3; 3],
    /// Unit normal of the side that radiates.
    pub normal: Vec3,
    /// Area.
    pub area: f32,
}

/// Form factor from `p` to `q` without occlusion, and the visible share of it. Each is divided in four:
/// 16 discs and 16 jittered rays. A patch partly behind the other's plane counts with the parts that are not.
pub fn form_factor(p: &Facet, q: &Facet, visible: Visible<'_>, mut stream: Stream) -> (f32, f32) {
    let (parts_p, parts_q) = (subdivide(p.corners), subdivide(q.corners));
    let (mut factor, mut seen) = (0.0, 0.0);
    for pi in parts_p {
        for qj in parts_q {
            let share = disc(centroid(pi), p.normal, centroid(qj), q.normal, q.area / 4.0) / 4.0;
            if share > 0.0 {
                factor += share;
                let (from, to) = (random_point(pi, stream.next_2d()), random_point(qj, stream.next_2d()));
                if visible(from, to) {
                    seen += share;
                }
            }
        }
    }
    (factor, if factor > 0.0 { seen / factor } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cells(o: Vec3, u: Vec3, v: Vec3, k: u32) -> Vec<Vec3> {
        let at = |i: u32| (i as f32 + 0.5) / k as f32;
        (0..k * k).map(|i| o + u * at(i / k) + v * at(i % k)).collect()
    }

    #[test]
    fn discs_between_unit_squares_have_the_references_errors() {
        let (x, y, z) = (Vec3::X, Vec3::Y, Vec3::Z);
        let cases = [
            (z, x, y, -z, [0.241_453, 0.203_060, 0.200_368, 0.199_947, 0.199_855]),
            (Vec3::ZERO, z, y, x, [0.194_492, 0.191_287, 0.192_877, 0.195_478, 0.197_446]),
        ];
        for (origin, u, v, normal, expected) in cases {
            for (k, exact) in [1, 2, 4, 8, 16].into_iter().zip(expected) {
                let (p, q) = (cells(Vec3::ZERO, x, y, k), cells(origin, u, v, k));
                let area = 1.0 / (k * k) as f32;
                let sum: f32 =
                    p.iter().flat_map(|&a| q.iter().map(move |&b| disc(a, z, b, normal, area))).sum();
                assert!((sum * area - exact).abs() < 2e-5, "{k}: {}", sum * area);
            }
        }
    }

    #[test]
    fn visibility_is_the_share_that_rays_find() {
        let facet = |z: f32, up: f32| Facet {
            corners: [Vec3::new(0., 0., z), Vec3::new(1., 0., z), Vec3::new(0., 1., z)],
            normal: Vec3::Z * up,
            area: 0.5,
        };
        let (p, q) = (facet(0.0, 1.0), facet(2.0, -1.0));
        let all = form_factor(&p, &q, &|_, _| true, Stream::new(1, 2, 3));
        let none = form_factor(&p, &q, &|_, _| false, Stream::new(1, 2, 3));
        let half = form_factor(&p, &q, &|a, b| a.x + b.x < 0.6, Stream::new(1, 2, 3));
        assert!(all.0 > 0.0 && all.1 == 1.0 && none == (all.0, 0.0));
        assert!(half.1 > 0.2 && half.1 < 0.8);
        assert_eq!(form_factor(&q, &facet(3.0, 1.0), &|_, _| true, Stream::new(1, 2, 3)).0, 0.0);
    }
}
