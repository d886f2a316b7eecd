//! Cuts polygons into triangles.

use earcut::Earcut;
use glam::{DVec2, DVec3, Vec3};

/// Cuts polygons; keeps its buffers between them.
pub(super) struct Triangulator {
    earcut: Earcut<f64>,
    flat: Vec<DVec2>,
    cut: Vec<u32>,
    ring: Vec<u32>,
    next: Vec<u32>,
}

/// Normal of a polygon times twice its area (Newell's method), f64 because large faces cancel.
fn newell(corners: &[u32], position: impl Fn(u32) -> Vec3) -> DVec3 {
    let Some(&first) = corners.first() else { return DVec3::ZERO };
    // Relative to the first corner, so that a face far from the origin keeps its digits.
    let origin = position(first).as_dvec3();
    let mut sum = DVec3::ZERO;
    let mut last = position(corners[corners.len() - 1]).as_dvec3() - origin;
    for &c in corners {
        let p = position(c).as_dvec3() - origin;
        sum += last.cross(p);
        last = p;
    }
    sum
}

fn cross(a: DVec2, b: DVec2, c: DVec2) -> f64 {
    (b - a).perp_dot(c - a)
}

impl Triangulator {
    pub fn new() -> Self {
        Self { earcut: Earcut::new(), flat: Vec::new(), cut: Vec::new(), ring: Vec::new(), next: Vec::new() }
    }

    /// Appends the triangles of a polygon, with its orientation. Concave polygons by ear clipping; a
    /// polygon whose corners do not lie in a plane is cut as its projection along its normal.
    /// Nothing comes of a polygon without area or with corners that are not finite.
    pub fn triangulate(
        &mut self,
        corners: &[u32],
        position: impl Fn(u32) -> Vec3 + Copy,
        out: &mut Vec<[u32; 3]>,
    ) {
        if let &[a, b, c] = corners {
            out.push([a, b, c]);
            return;
        }
        let n = newell(corners, position);
        if !(n.length_squared() > 0.0 && n.length_squared().is_finite()) {
            return;
        }
        let n = n.normalize();
        let (x, y) = n.any_orthonormal_pair();
        self.flat.clear();
        let Some(&first) = corners.first() else { return };
        let origin = position(first).as_dvec3();
        self.flat.extend(corners.iter().map(|&c| {
            let p = position(c).as_dvec3() - origin;
            DVec2::new(p.dot(x), p.dot(y))
        }));
        if self.is_convex() {
            self.cut_convex(corners, out);
        } else {
            self.cut_concave(corners, out);
        }
    }

    /// Whether all turns go left and once round.
    fn is_convex(&self) -> bool {
        let p = &self.flat;
        let n = p.len();
        // Turning once: a star that turns twice also turns left at every corner.
        let mut turns = 0;
        for i in 0..n {
            let (a, b, c) = (p[i], p[(i + 1) % n], p[(i + 2) % n]);
            if (b - a).perp_dot(c - b) < 0.0 {
                return false;
            }
            let (d, e) = (b - a, c - b);
            turns += usize::from(d.y < 0.0 && e.y >= 0.0);
        }
        turns <= 1
    }

    /// Quads along the shorter diagonal; larger ones by cutting off every second corner again and
    /// again, which avoids the long slivers of a fan.
    fn cut_convex(&mut self, corners: &[u32], out: &mut Vec<[u32; 3]>) {
        let p = &self.flat;
        if let &[a, b, c, d] = corners {
            let one = p[0].distance_squared(p[2]);
            let other = p[1].distance_squared(p[3]);
            // A flat corner must not become a triangle of its own.
            let good = |i: usize, j: usize, k: usize| cross(p[i], p[j], p[k]) > 0.0;
            let first = good(0, 1, 2) && good(0, 2, 3);
            let second = good(1, 2, 3) && good(1, 3, 0);
            if second && (other < one || !first) {
                out.extend([[b, c, d], [b, d, a]]);
            } else {
                out.extend([[a, b, c], [a, c, d]]);
            }
            return;
        }
        self.ring.clear();
        self.ring.extend(corners);
        while self.ring.len() > 3 {
            self.next.clear();
            let n = self.ring.len();
            let mut i = 0;
            while i < n {
                self.next.push(self.ring[i]);
                if i + 1 < n {
                    out.push([self.ring[i], self.ring[i + 1], self.ring[(i + 2) % n]]);
                }
                i += 2;
            }
            std::mem::swap(&mut self.ring, &mut self.next);
        }
        if let &[a, b, c] = &self.ring[..] {
            out.push([a, b, c]);
        }
    }

    fn cut_concave(&mut self, corners: &[u32], out: &mut Vec<[u32; 3]>) {
        let p = &self.flat;
        self.earcut.earcut(p.iter().map(|p| [p.x, p.y]), &[] as &[u32], &mut self.cut);
        for t in self.cut.chunks_exact(3) {
            let [a, b, c] = [t[0] as usize, t[1] as usize, t[2] as usize];
            // The projection keeps the orientation, the ear clipping need not.
            if cross(p[a], p[b], p[c]) >= 0.0 {
                out.push([corners[a], corners[b], corners[c]]);
            } else {
                out.push([corners[a], corners[c], corners[b]]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use foveal::math;

    fn area_and_triangles(points: &[Vec3]) -> (f32, Vec<[u32; 3]>) {
        let corners: Vec<u32> = (0..points.len() as u32).collect();
        let mut out = Vec::new();
        Triangulator::new().triangulate(&corners, |i| points[i as usize], &mut out);
        let n = newell(&corners, |i| points[i as usize]).normalize_or_zero().as_vec3();
        let area = out
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|i| points[i as usize]);
                let signed = (b - a).cross(c - a).dot(n) * 0.5;
                assert!(signed >= 0.0, "turned over: {t:?}");
                signed
            })
            .sum();
        (area, out)
    }

    fn ring(n: usize, radius: impl Fn(usize) -> f32) -> Vec<Vec3> {
        (0..n)
            .map(|i| {
                let a = i as f32 / n as f32 * std::f32::consts::TAU;
                Vec3::new(3.0 + radius(i) * math::cos(a), 5.0, -7.0 - radius(i) * math::sin(a))
            })
            .collect()
    }

    #[test]
    fn ten_thousand_corners_make_9998_triangles() {
        let (area, triangles) = area_and_triangles(&ring(10_000, |_| 2.0));
        assert_eq!(triangles.len(), 9_998);
        assert!((area - 4.0 * std::f32::consts::PI).abs() < 1e-3, "{area}");
    }

    #[test]
    fn a_star_of_twenty_thousand_corners_keeps_its_area() {
        let n = 20_000;
        let (area, triangles) = area_and_triangles(&ring(n, |i| if i % 2 == 0 { 1.0 } else { 2.0 }));
        assert_eq!(triangles.len(), n - 2);
        let exact = 0.5 * n as f32 * 2.0 * math::sin(std::f32::consts::TAU / n as f32);
        assert!((area / exact - 1.0).abs() < 1e-3, "{area} {exact}");
    }

    #[test]
    fn a_concave_quad_is_cut_inside() {
        let p = [[0.0, 0.0], [2.0, 0.0], [0.4, 0.4], [0.0, 2.0]].map(|[x, y]| Vec3::new(x, y, 1.0));
        for turn in 0..4 {
            let q: Vec<Vec3> = (0..4).map(|i| p[(i + turn) % 4]).collect();
            let (area, triangles) = area_and_triangles(&q);
            assert_eq!(triangles.len(), 2);
            assert!((area - 0.8).abs() < 1e-6, "{area} at {turn}");
        }
    }

    #[test]
    fn polygons_without_area_or_with_nan_give_nothing_or_no_area() {
        assert!(area_and_triangles(&[Vec3::ZERO; 5]).1.is_empty());
        let line: Vec<Vec3> = (0..6).map(|i| Vec3::X * i as f32).collect();
        assert!(area_and_triangles(&line).1.is_empty());
        let mut p = ring(6, |_| 1.0);
        p[2].x = f32::NAN;
        assert!(area_and_triangles(&p).1.is_empty());
        p[2].x = f32::INFINITY;
        assert!(area_and_triangles(&p).1.is_empty());
    }

    #[test]
    fn self_crossing_polygons_end() {
        let p: Vec<Vec3> = (0..400u32)
            .map(|i| {
                let h = foveal::rng::hash(1, u64::from(i), 2);
                Vec3::new(foveal::rng::unit_f32(h), foveal::rng::unit_f32(h << 24), 0.0)
            })
            .collect();
        let corners: Vec<u32> = (0..400).collect();
        let mut out = Vec::new();
        Triangulator::new().triangulate(&corners, |i| p[i as usize], &mut out);
        assert!(out.len() <= 398);
    }
}
