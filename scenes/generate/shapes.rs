//! Meshes with smooth normals and texture coordinates.

use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3};

use super::obj::{Corner, Mesh};

/// Shorthand.
pub fn v(x: f64, y: f64, z: f64) -> DVec3 {
    DVec3::new(x, y, z)
}

/// A flat quadrilateral, its front where `corners` run counter-clockwise; `uvs` go with the corners.
pub fn quad_uv(corners: [DVec3; 4], uvs: [[f64; 2]; 4]) -> Mesh {
    let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
    let face = corners.iter().zip(uvs);
    Mesh { faces: vec![face.map(|(&position, uv)| Corner { position, normal, uv: uv.into() }).collect()] }
}

/// A flat parallelogram at `origin`, its front along `x` × `y`. Coordinates run over `repeat`.
pub fn quad(origin: DVec3, x: DVec3, y: DVec3, repeat: [f64; 2]) -> Mesh {
    let [s, t] = repeat;
    quad_uv([origin, origin + x, origin + x + y, origin + y], [[0.0, 0.0], [s, 0.0], [s, t], [0.0, t]])
}

/// As [`quad`], with an opening from `lo` to `hi` in fractions of the sides. Coordinates in `repeat`.
pub fn quad_with_hole(origin: DVec3, x: DVec3, y: DVec3, lo: DVec2, hi: DVec2, repeat: [f64; 2]) -> Mesh {
    let outer = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    let inner = [[lo.x, lo.y], [hi.x, lo.y], [hi.x, hi.y], [lo.x, hi.y]];
    let at = |c: [f64; 2]| origin + x * c[0] + y * c[1];
    let uv = |c: [f64; 2]| [c[0] * repeat[0], c[1] * repeat[1]];
    (0..4).fold(Mesh::default(), |mesh, i| {
        let c = [outer[i], outer[(i + 1) % 4], inner[(i + 1) % 4], inner[i]];
        mesh.with(quad_uv(c.map(at), c.map(uv)))
    })
}

/// A box with rounded edges of `radius`, `steps` polygons per quarter turn at each edge (0 for a
/// sharp box). Coordinates are lengths: u along the longest side, so that wood grain follows it.
pub fn rounded_box(lo: DVec3, hi: DVec3, radius: f64, steps: usize) -> Mesh {
    let (center, half) = ((lo + hi) * 0.5, (hi - lo) * 0.5);
    let radius = radius.min(0.9 * half.min_element());
    let core = half - DVec3::splat(if steps == 0 { 0.0 } else { radius });
    // Lines of the grid on a face: direction as a tangent, and side of the core.
    let mut lines: Vec<(f64, f64)> = Vec::new();
    if steps == 0 {
        lines = vec![(-1.0, -1.0), (1.0, 1.0)];
    } else {
        for side in [-1.0, 1.0] {
            for i in 0..=steps {
                let angle = PI / 4.0 * i as f64 / steps as f64;
                lines.push((if side < 0.0 { -(PI / 4.0 - angle).tan() } else { angle.tan() }, side));
            }
        }
    }
    let mut mesh = Mesh::default();
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
            let mut flat = DVec3::ZERO;
            flat[axis] = sign;
            let corner = |i: usize, j: usize| {
                let (mut n, mut side) = (flat, flat);
                (n[a], side[a]) = lines[i];
                (n[b], side[b]) = lines[j];
                let n = n.normalize();
                let local = if steps == 0 { side * half } else { side * core + n * radius };
                let (u, w) = if half[a] >= half[b] { (a, b) } else { (b, a) };
                Corner {
                    position: center + local,
                    normal: if steps == 0 { flat } else { n },
                    uv: DVec2::new((center + local)[u], (center + local)[w]),
                }
            };
            for i in 0..lines.len() - 1 {
                for j in 0..lines.len() - 1 {
                    let face = vec![corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
                    mesh.faces.push(face);
                }
            }
        }
    }
    mesh
}

/// A sharp box.
pub fn cuboid(lo: DVec3, hi: DVec3) -> Mesh {
    rounded_box(lo, hi, 0.0, 0)
}

/// The inside of a box: floor, ceiling, and the walls at −x, +x, −z, +z. Coordinates in units.
pub fn room(lo: DVec3, hi: DVec3) -> [Mesh; 6] {
    let s = hi - lo;
    let (x, y, z) = (DVec3::X * s.x, DVec3::Y * s.y, DVec3::Z * s.z);
    [
        quad(lo + z, x, -z, [s.x, s.z]),
        quad(lo + y, x, z, [s.x, s.z]),
        quad(lo + z, -z, y, [s.z, s.y]),
        quad(lo + x, z, y, [s.z, s.y]),
        quad(lo, x, y, [s.x, s.y]),
        quad(lo + x + z, -x, y, [s.x, s.y]),
    ]
}

/// A sphere of `around` × `rings` polygons.
pub fn sphere(center: DVec3, radius: f64, around: usize, rings: usize) -> Mesh {
    let arc = (0..=rings).map(|i| {
        let angle = PI * (i as f64 / rings as f64 - 0.5);
        // Exactly on the axis at the poles.
        let r = if i == 0 || i == rings { 0.0 } else { angle.cos() };
        DVec2::new(r * radius, angle.sin() * radius)
    });
    lathe(&[arc.collect()], around).at(center.x, center.y, center.z)
}

/// A curve through `points` (radius, height), `steps` pieces between two of them. It leaves neither
/// the radii nor the heights of the two (Hermite with the tangents of Fritsch & Butland 1984).
pub fn curve(points: &[[f64; 2]], steps: usize) -> Vec<DVec2> {
    let p = straight(points);
    let secant = |i: usize| p[i + 1] - p[i];
    let tangent = |i: usize| {
        if i == 0 || i == p.len() - 1 {
            return secant(i.min(p.len() - 2));
        }
        let (a, b) = (secant(i - 1), secant(i));
        let mean = |a: f64, b: f64| if a * b > 0.0 { 2.0 * a * b / (a + b) } else { 0.0 };
        DVec2::new(mean(a.x, b.x), mean(a.y, b.y))
    };
    let mut out = Vec::new();
    for (i, ends) in p.windows(2).enumerate() {
        let (d, m0, m1) = (secant(i), tangent(i), tangent(i + 1));
        for k in 0..steps {
            let t = k as f64 / steps as f64;
            out.push(
                ends[0] + m0 * t + (d * 3.0 - m0 * 2.0 - m1) * (t * t) + (m0 + m1 - d * 2.0) * (t * t * t),
            );
        }
    }
    out.push(p[p.len() - 1]);
    out
}

/// A polygon through `points`, for [`lathe`].
pub fn straight(points: &[[f64; 2]]) -> Vec<DVec2> {
    points.iter().map(|&p| p.into()).collect()
}

/// A surface of revolution about +y. Each stroke of the profile (radius, height) is smooth, strokes
/// meet in creases; the outside is to the right of the stroke as it runs, so a body runs upwards.
pub fn lathe(strokes: &[Vec<DVec2>], around: usize) -> Mesh {
    let length: f64 = strokes.iter().flat_map(|s| s.windows(2)).map(|w| w[0].distance(w[1])).sum();
    let mut mesh = Mesh::default();
    let mut from_start = 0.0;
    for stroke in strokes {
        let mut rows: Vec<(DVec2, DVec2, f64)> = Vec::new();
        for i in 0..stroke.len() {
            let before = stroke[i] - stroke[i.saturating_sub(1)];
            let after = stroke[(i + 1).min(stroke.len() - 1)] - stroke[i];
            if i > 0 {
                from_start += before.length();
            }
            let tangent = before.normalize_or_zero() + after.normalize_or_zero();
            let mut normal = DVec2::new(tangent.y, -tangent.x).normalize_or_zero();
            // A smooth stroke that ends on the axis is horizontal there, if it is not a cone's tip.
            if stroke[i].x == 0.0 && stroke.len() > 2 && normal.y.abs() > 0.7 {
                normal = DVec2::new(0.0, normal.y.signum());
            }
            rows.push((stroke[i], normal, from_start / length));
        }
        let corner = |row: &(DVec2, DVec2, f64), k: usize| {
            // The first column again at the end, bit for bit.
            let (sin, cos) =
                if k == around { (0.0, 1.0) } else { (TAU * k as f64 / around as f64).sin_cos() };
            Corner {
                position: v(row.0.x * cos, row.0.y, row.0.x * sin),
                normal: v(row.1.x * cos, row.1.y, row.1.x * sin),
                uv: DVec2::new(k as f64 / around as f64, row.2),
            }
        };
        for w in rows.windows(2) {
            for k in 0..around {
                let face =
                    vec![corner(&w[0], k), corner(&w[0], k + 1), corner(&w[1], k + 1), corner(&w[1], k)];
                mesh.faces.push(face);
            }
        }
    }
    mesh
}

/// A torus about +y.
pub fn torus(radius: f64, thickness: f64, around: usize, across: usize) -> Mesh {
    let circle = (0..=across).map(|i| {
        let angle = if i == across { -0.5 * PI } else { (i as f64 / across as f64 - 0.25) * TAU };
        DVec2::new(radius + thickness * angle.cos(), thickness * angle.sin())
    });
    let mut mesh = lathe(&[circle.collect()], around);
    for corner in mesh.faces.iter_mut().flatten() {
        let p = corner.position;
        let axis = v(p.x, 0.0, p.z).normalize() * radius;
        corner.normal = (p - axis).normalize();
    }
    mesh
}

/// A round tube along `points` in the plane z = 0, flattened by `flatness` along z, with open ends.
pub fn tube(points: &[DVec2], radius: f64, flatness: f64, around: usize) -> Mesh {
    let rows: Vec<(DVec2, DVec2)> = (0..points.len())
        .map(|i| {
            let tangent = (points[(i + 1).min(points.len() - 1)] - points[i.saturating_sub(1)]).normalize();
            (points[i], DVec2::new(tangent.y, -tangent.x))
        })
        .collect();
    let corner = |i: usize, k: usize| {
        let (sin, cos) = if k == around { (0.0, 1.0) } else { (TAU * k as f64 / around as f64).sin_cos() };
        let (p, side) = rows[i];
        let position = p + side * (cos * radius);
        Corner {
            position: v(position.x, position.y, sin * radius * flatness),
            normal: v(side.x * cos, side.y * cos, sin / flatness).normalize(),
            uv: DVec2::new(i as f64 / (rows.len() - 1) as f64, k as f64 / around as f64),
        }
    };
    let mut mesh = Mesh::default();
    for i in 0..rows.len() - 1 {
        for k in 0..around {
            mesh.faces.push(vec![corner(i, k), corner(i, k + 1), corner(i + 1, k + 1), corner(i + 1, k)]);
        }
    }
    mesh
}

/// A frame around the rectangle `size` centred at the origin in the plane z = 0, its front to +z.
/// `profile`: distance from the rectangle's edge and height, from the inside out.
pub fn frame(size: [f64; 2], profile: &[[f64; 2]]) -> Mesh {
    let corner = |i: usize, [d, z]: [f64; 2]| {
        let (x, y) = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)][i % 4];
        v(x * (size[0] * 0.5 + d), y * (size[1] * 0.5 + d), z)
    };
    let mut mesh = Mesh::default();
    for w in profile.windows(2) {
        for i in 0..4 {
            let c = [corner(i, w[1]), corner(i + 1, w[1]), corner(i + 1, w[0]), corner(i, w[0])];
            let length = if i % 2 == 0 { size[0] } else { size[1] };
            mesh = mesh.with(quad_uv(c, [[0.0, 0.0], [length, 0.0], [length, 0.1], [0.0, 0.1]]));
        }
    }
    mesh
}
