//! Surfaces of signed distance functions, as polygons: naive surface nets, each vertex then moved
//! onto the surface along the gradient.

use std::collections::BTreeMap;

use glam::{DVec2, DVec3};

use super::obj::{Corner, Mesh};

/// The surface `distance` = 0 inside the box, with `cells` cells along its longest side. It must
/// not touch the box.
pub fn surface(lo: DVec3, hi: DVec3, cells: usize, distance: &dyn Fn(DVec3) -> f64) -> Mesh {
    let step = (hi - lo).max_element() / cells as f64;
    let n = ((hi - lo) / step).ceil();
    let [nx, ny, nz] = [n.x as usize + 1, n.y as usize + 1, n.z as usize + 1];
    let at = |x: usize, y: usize, z: usize| lo + DVec3::new(x as f64, y as f64, z as f64) * step;
    let index = |x: usize, y: usize, z: usize| (z * ny + y) * nx + x;
    let mut value = Vec::with_capacity(nx * ny * nz);
    for z in 0..nz {
        for y in 0..ny {
            for x in 0..nx {
                value.push(distance(at(x, y, z)));
            }
        }
    }
    let gradient = |p: DVec3| {
        let e = step * 0.05;
        let d = |o: DVec3| distance(p + o * e) - distance(p - o * e);
        DVec3::new(d(DVec3::X), d(DVec3::Y), d(DVec3::Z)) / (2.0 * e)
    };

    let mut vertex: BTreeMap<usize, Corner> = BTreeMap::new();
    for z in 0..nz - 1 {
        for y in 0..ny - 1 {
            for x in 0..nx - 1 {
                let corner = |i: usize| (x + (i & 1), y + (i >> 1 & 1), z + (i >> 2));
                let sample = |i: usize| {
                    let (x, y, z) = corner(i);
                    (at(x, y, z), value[index(x, y, z)])
                };
                let (mut sum, mut crossings) = (DVec3::ZERO, 0.0);
                for i in 0..8 {
                    for bit in [1, 2, 4] {
                        let ((p, a), (q, b)) = (sample(i), sample(i | bit));
                        if i & bit == 0 && (a < 0.0) != (b < 0.0) {
                            sum += p + (q - p) * (a / (a - b));
                            crossings += 1.0;
                        }
                    }
                }
                if crossings > 0.0 {
                    let mut p = sum / crossings;
                    for _ in 0..4 {
                        let g = gradient(p);
                        let move_by = -g * (distance(p) / g.length_squared());
                        p += move_by.clamp_length_max(step * 0.25);
                    }
                    let normal = gradient(p).normalize();
                    vertex.insert(index(x, y, z), Corner { position: p, normal, uv: DVec2::new(p.x, p.y) });
                }
            }
        }
    }

    let mut mesh = Mesh::default();
    for z in 1..nz - 1 {
        for y in 1..ny - 1 {
            for x in 1..nx - 1 {
                let here = value[index(x, y, z)] < 0.0;
                let ends = [index(x + 1, y, z), index(x, y + 1, z), index(x, y, z + 1)];
                // The four cells around an edge that crosses the surface.
                let around = [
                    [(x, y - 1, z - 1), (x, y, z - 1), (x, y, z), (x, y - 1, z)],
                    [(x - 1, y, z - 1), (x, y, z - 1), (x, y, z), (x - 1, y, z)],
                    [(x - 1, y - 1, z), (x, y - 1, z), (x, y, z), (x - 1, y, z)],
                ];
                for (end, cells) in ends.into_iter().zip(around) {
                    if (value[end] < 0.0) != here {
                        let corners =
                            cells.iter().filter_map(|&(x, y, z)| vertex.get(&index(x, y, z)).copied());
                        mesh.faces.push(corners.collect());
                    }
                }
            }
        }
    }
    mesh
}

/// Distance to an ellipsoid, to first order near its surface.
pub fn ellipsoid(p: DVec3, center: DVec3, radii: DVec3) -> f64 {
    let q = p - center;
    let (a, b) = ((q / radii).length(), (q / (radii * radii)).length());
    if b == 0.0 { -radii.min_element() } else { a * (a - 1.0) / b }
}

/// Distance to a cone between two spheres' centres whose radius runs from `ra` to `rb`, to first order.
pub fn capsule(p: DVec3, a: DVec3, b: DVec3, ra: f64, rb: f64) -> f64 {
    let t = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
    (p - a - (b - a) * t).length() - (ra + (rb - ra) * t)
}

/// The union, blended where both are nearer than `k`.
pub fn blend(a: f64, b: f64, k: f64) -> f64 {
    let h = (k - (a - b).abs()).max(0.0) / k;
    a.min(b) - h * h * h * k / 6.0
}
