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
///
/// `expected`: what all rays between two larger patches around these found. Where four rays, one from each part to each,
/// find the same, no more are asked: with those of its three siblings that is as many as there were between the larger
/// patches, and others.
pub fn form_factor(
    p: &Facet,
    q: &Facet,
    expected: Option<bool>,
    visible: Visible<'_>,
    mut stream: Stream,
) -> (f32, f32) {
    let (parts_p, parts_q) = (subdivide(p.corners), subdivide(q.corners));
    let (from, to) = (parts_p.map(centroid), parts_q.map(centroid));
    let mut shares = [[0.0; 4]; 4];
    let mut factor = 0.0;
    for (row, from) in shares.iter_mut().zip(from) {
        for (share, to) in row.iter_mut().zip(to) {
            *share = disc(from, p.normal, to, q.normal, q.area / 4.0) / 4.0;
            factor += *share;
        }
    }
    if factor <= 0.0 {
        return (0.0, 0.0);
    }
    let (mut seen, mut rays, mut seen_rays) = (0.0, 0, 0);
    for step in 0..4 {
        for i in 0..4 {
            // No two of a step share a part.
            let j = (i + step) % 4;
            if shares[i][j] > 0.0 {
                let ends =
                    (random_point(parts_p[i], stream.next_2d()), random_point(parts_q[j], stream.next_2d()));
                rays += 1;
                if visible(ends.0, ends.1) {
                    seen += shares[i][j];
                    seen_rays += 1;
                }
            }
        }
        if rays >= 4 && expected.is_some_and(|expected| seen_rays == if expected { rays } else { 0 }) {
            break;
        }
    }
    // Sums in another order are not exactly one.
    (factor, if seen_rays == rays { 1.0 } else { (seen / factor).min(1.0) })
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
        let stream = || Stream::new(1, 2, 3);
        let all = form_factor(&p, &q, None, &|_, _| true, stream());
        let none = form_factor(&p, &q, None, &|_, _| false, stream());
        let half = form_factor(&p, &q, None, &|a, b| a.x + b.x < 0.6, stream());
        assert!(all.0 > 0.0 && all.1 == 1.0 && none == (all.0, 0.0));
        assert!(half.1 > 0.2 && half.1 < 0.8);
        assert_eq!(form_factor(&q, &facet(3.0, 1.0), None, &|_, _| true, stream()).0, 0.0);
        // What is expected needs four rays, and what is not all of them.
        let asked = |expected: bool, seen: bool| {
            let rays = std::sync::atomic::AtomicU32::new(0);
            let ray = |_, _| {
                rays.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                seen
            };
            let found = form_factor(&p, &q, Some(expected), &ray, stream());
            assert_eq!(found, if seen { all } else { none });
            rays.into_inner()
        };
        assert_eq!(
            [asked(true, true), asked(false, false), asked(true, false), asked(false, true)],
            [4, 4, 16, 16]
        );
        assert_eq!(form_factor(&p, &q, Some(true), &|a, b| a.x + b.x < 0.6, stream()), half);
    }
}
