//! Texels covered by charts: their world area, centroid and normal.

use glam::{Vec2, Vec3};

use super::atlas::{Element, triangle_area};
use crate::scene::Mesh;

/// What of a texel is covered by triangles.
#[derive(Clone, Copy, Debug, Default)]
pub struct Coverage {
    area: f32,
    position: Vec3,
    normal: Vec3,
    largest_part: f32,
    triangle: u32,
    b: Vec2,
}

impl Coverage {
    /// The piece of surface in this texel.
    pub fn element(&self) -> Element {
        if self.area <= 0.0 {
            return Element::default();
        }
        Element {
            position: self.position / self.area,
            normal: self.normal.normalize_or_zero(),
            area: self.area,
            opaque: self.area,
            triangle: self.triangle,
            b1: self.b.x,
            b2: self.b.y,
        }
    }
}

/// Clips every placed triangle against the texels it touches. World area of a texel is the sum of
/// uv areas times the Jacobian of each triangle (REFERENCE §6.4).
pub fn rasterise(mesh: &Mesh, placed: &[Option<[Vec2; 3]>], width: u32, height: u32) -> Vec<Coverage> {
    let mut texels = vec![Coverage::default(); width as usize * height as usize];
    for (t, uv) in placed.iter().enumerate() {
        if let Some(uv) = uv {
            add_triangle(&mut texels, width, height, t as u32, uv, mesh.corners(t as u32));
        }
    }
    texels
}

fn add_triangle(
    texels: &mut [Coverage],
    width: u32,
    height: u32,
    t: u32,
    uv: &[Vec2; 3],
    corners: [Vec3; 3],
) {
    let doubled_uv_area = (uv[1] - uv[0]).perp_dot(uv[2] - uv[0]);
    let jacobian = triangle_area(corners) / (0.5 * doubled_uv_area.abs());
    let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
    let low = uv[0].min(uv[1]).min(uv[2]).max(Vec2::ZERO);
    let high = uv[0].max(uv[1]).max(uv[2]);
    let (x0, y0) = (low.x as u32, low.y as u32);
    let (x1, y1) = ((high.x.max(0.0) as u32).min(width - 1), (high.y.max(0.0) as u32).min(height - 1));
    let is_inside = inside(uv);
    for y in y0..=y1 {
        for x in x0..=x1 {
            let corner = Vec2::new(x as f32, y as f32);
            let (area, centroid) =
                if is_inside(corner) { (1.0, corner + 0.5) } else { clipped_area(uv, corner) };
            if area <= 0.0 {
                continue;
            }
            let b = Vec2::new(
                (centroid - uv[0]).perp_dot(uv[2] - uv[0]) / doubled_uv_area,
                (uv[1] - uv[0]).perp_dot(centroid - uv[0]) / doubled_uv_area,
            )
            .clamp(Vec2::ZERO, Vec2::ONE);
            let b = b / (b.x + b.y).max(1.0);
            let world = area * jacobian;
            let texel = &mut texels[(y * width + x) as usize];
            texel.area += world;
            texel.position += world * (corners[0] * (1.0 - b.x - b.y) + corners[1] * b.x + corners[2] * b.y);
            texel.normal += world * normal;
            if world > texel.largest_part {
                (texel.largest_part, texel.triangle, texel.b) = (world, t, b);
            }
        }
    }
}

/// Whether a texel at its corner of least coordinates is sure to lie inside a triangle, without clipping it.
pub(super) fn inside(uv: &[Vec2; 3]) -> impl Fn(Vec2) -> bool {
    let doubled = (uv[1] - uv[0]).perp_dot(uv[2] - uv[0]);
    let sides = [0, 1, 2].map(|i| {
        let (a, b) = (uv[i], uv[(i + 1) % 3]);
        let along = (b - a) * doubled.signum();
        // Half of a texel's extent across the side, and more than rounding moves it.
        (a, along, (0.5 + 1e-3) * (along.x.abs() + along.y.abs()))
    });
    move |corner| sides.iter().all(|(a, along, reach)| along.perp_dot(corner + 0.5 - a) > *reach)
}

/// Area and centroid of the part of a triangle inside the unit square at `corner` (Sutherland–Hodgman).
pub(super) fn clipped_area(triangle: &[Vec2; 3], corner: Vec2) -> (f32, Vec2) {
    let mut polygon = [Vec2::ZERO; 8];
    let mut count = 3;
    // Relative to the square, so that areas keep their digits anywhere on the page.
    for (p, q) in polygon.iter_mut().zip(triangle) {
        *p = *q - corner;
    }
    let planes: [fn(Vec2) -> f32; 4] = [|p| p.x, |p| 1.0 - p.x, |p| p.y, |p| 1.0 - p.y];
    for inside in planes {
        let mut out = [Vec2::ZERO; 8];
        let mut n = 0;
        for i in 0..count {
            let (a, b) = (polygon[i], polygon[(i + 1) % count]);
            let (da, db) = (inside(a), inside(b));
            if da >= 0.0 && n < 8 {
                out[n] = a;
                n += 1;
            }
            if (da >= 0.0) != (db >= 0.0) && n < 8 {
                out[n] = a + (b - a) * (da / (da - db));
                n += 1;
            }
        }
        (polygon, count) = (out, n);
        if count < 3 {
            return (0.0, Vec2::ZERO);
        }
    }
    let (mut doubled, mut sum) = (0.0, Vec2::ZERO);
    for i in 1..count - 1 {
        let part = (polygon[i] - polygon[0]).perp_dot(polygon[i + 1] - polygon[0]);
        doubled += part;
        sum += part * (polygon[0] + polygon[i] + polygon[i + 1]);
    }
    if doubled.abs() < 1e-9 {
        return (0.0, Vec2::ZERO);
    }
    (0.5 * doubled.abs(), corner + sum / (3.0 * doubled))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Stream;

    #[test]
    fn clipped_areas_of_a_triangle_sum_to_its_area() {
        let triangle = [Vec2::new(0.3, 0.4), Vec2::new(7.7, 1.1), Vec2::new(2.2, 6.9)];
        let exact = 0.5 * (triangle[1] - triangle[0]).perp_dot(triangle[2] - triangle[0]);
        let (mut area, mut centroid) = (0.0, Vec2::ZERO);
        for y in 0..8 {
            for x in 0..8 {
                let (a, c) = clipped_area(&triangle, Vec2::new(x as f32, y as f32));
                area += a;
                centroid += a * c;
            }
        }
        assert!((area - exact).abs() < 1e-4 * exact);
        let mean = (triangle[0] + triangle[1] + triangle[2]) / 3.0;
        assert!((centroid / area).distance(mean) < 1e-4);
    }

    #[test]
    fn a_square_inside_a_triangle_is_whole() {
        let triangle = [Vec2::new(-10.0, -10.0), Vec2::new(30.0, -10.0), Vec2::new(-10.0, 30.0)];
        assert_eq!(clipped_area(&triangle, Vec2::new(2.0, 3.0)), (1.0, Vec2::new(2.5, 3.5)));
    }

    /// What is taken for inside without clipping has all of a texel's area; most of a large triangle is.
    #[test]
    fn texels_inside_a_triangle_are_whole() {
        let mut inside_all = 0;
        for i in 0..200 {
            let mut s = Stream::new(41, i, 0);
            let uv = [(); 3].map(|()| Vec2::new(s.next_f32(), s.next_f32()) * 40.0);
            let is_inside = inside(&uv);
            for (y, x) in (0..40).flat_map(|y| (0..40).map(move |x| (y, x))) {
                let corner = Vec2::new(x as f32, y as f32);
                if is_inside(corner) {
                    inside_all += 1;
                    let (area, centroid) = clipped_area(&uv, corner);
                    let is_whole = (area - 1.0).abs() < 1e-3 && centroid.distance(corner + 0.5) < 1e-3;
                    assert!(is_whole, "{uv:?} {corner}");
                }
            }
        }
        assert!(inside_all > 10_000, "{inside_all}");
    }
}
