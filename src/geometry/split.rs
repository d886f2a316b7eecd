//! Boxes of triangles: several for one that lies long and thin across the axes, as hair does.
//!
//! The box of such a triangle is nearly empty, and nothing a tree does about boxes makes it less so; halves of the triangle
//! have boxes of a quarter of the area each. Where few triangles are like that nothing is split: it would only make the tree
//! larger (after Ernst & Greiner 2007).

use glam::{DVec3, Vec3};

/// A part of a triangle, or all of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Part {
    /// Lower corner of its box.
    pub min: Vec3,
    /// Upper corner.
    pub max: Vec3,
    /// Index of the triangle in the mesh.
    pub triangle: u32,
}

/// Triangles are split where the areas of all boxes are together this many times those of what is in them; meshes of
/// ordinary shape are at 2 or 3, hair at 30.
const EMPTY: f64 = 8.0;
/// A box is replaced by two whose areas are together less than this share of its own.
const GAIN: f32 = 0.6;
/// Boxes smaller than this share of the mean stay as they are.
const SMALL: f64 = 0.7;
/// How often the halves are halved again, at most.
const ROUNDS: usize = 4;

/// Splits what is long, thin and oblique, if there is much of it; says whether anything was split. New parts come last.
pub(super) fn split(parts: &mut Vec<Part>, corners: impl Fn(u32) -> [Vec3; 3]) -> bool {
    let whole = parts.len();
    let boxes: f64 = parts.iter().map(|p| f64::from(half_area(p))).sum();
    let shown: f64 = parts.iter().map(|p| projected_area(corners(p.triangle))).sum();
    // Not so where any of them is no number.
    if !(boxes > EMPTY * shown) {
        return false;
    }
    let small = (SMALL * boxes / whole as f64) as f32;
    let mut round = 0..whole;
    for _ in 0..ROUNDS {
        let next = parts.len();
        for i in round {
            let part = parts[i];
            let area = half_area(&part);
            if area > small
                && let Some([a, b]) = halves(&part, &corners(part.triangle))
                && half_area(&a) + half_area(&b) < GAIN * area
            {
                parts[i] = a;
                parts.push(b);
            }
        }
        round = next..parts.len();
    }
    parts.len() > whole
}

fn half_area(part: &Part) -> f32 {
    let e = part.max - part.min;
    e.x * e.y + e.y * e.z + e.z * e.x
}

/// The sum of a triangle's areas as seen along the axes: half the area of a box that it would fill.
fn projected_area([a, b, c]: [Vec3; 3]) -> f64 {
    let [a, b, c] = [a, b, c].map(|p| p.as_dvec3());
    0.5 * (b - a).cross(c - a).abs().element_sum()
}

/// Both sides of the middle of the box's longest axis.
fn halves(part: &Part, corners: &[Vec3; 3]) -> Option<[Part; 2]> {
    let axis = (part.max - part.min).max_position();
    let (from, to) = (part.min[axis], part.max[axis]);
    let middle = from + 0.5 * (to - from);
    let a = between(part, corners, axis, from, middle)?;
    let b = between(part, corners, axis, middle, to)?;
    Some([a, b])
}

/// What of a part lies between two planes across an axis. Cuts are computed in f64 and rounded once, which the padding of
/// boxes makes good.
fn between(part: &Part, corners: &[Vec3; 3], axis: usize, from: f32, to: f32) -> Option<Part> {
    let (mut min, mut max) = (part.max, part.min);
    let mut add = |p: Vec3| (min, max) = (min.min(p), max.max(p));
    for (i, &a) in corners.iter().enumerate() {
        let b = corners[(i + 1) % 3];
        if (from..=to).contains(&a[axis]) {
            add(a);
        }
        for plane in [from, to] {
            if (a[axis] < plane) != (b[axis] < plane) {
                let (a, b): (DVec3, DVec3) = (a.as_dvec3(), b.as_dvec3());
                let mut p = a.lerp(b, (f64::from(plane) - a[axis]) / (b[axis] - a[axis])).as_vec3();
                p[axis] = plane;
                add(p);
            }
        }
    }
    let (min, max) = (min.max(part.min), max.min(part.max));
    min.cmple(max).all().then_some(Part { min, max, ..*part })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Stream;

    fn whole(corners: &[[Vec3; 3]]) -> Vec<Part> {
        let part = |(i, &[a, b, c]): (usize, &[Vec3; 3])| Part {
            min: a.min(b).min(c),
            max: a.max(b).max(c),
            triangle: i as u32,
        };
        corners.iter().enumerate().map(part).collect()
    }

    /// A triangle of which each side is seen is as large as half of a box's side.
    #[test]
    fn ordinary_triangles_stay_whole() {
        let mut s = Stream::new(4, 2, 0);
        let mut v = || Vec3::new(s.next_f32(), s.next_f32(), s.next_f32()) * 2.0 - 1.0;
        let corners: Vec<[Vec3; 3]> = (0..500).map(|_| [v(), v(), v()]).collect();
        let mut parts = whole(&corners);
        let before = parts.clone();
        assert!(!split(&mut parts, |t| corners[t as usize]));
        assert_eq!(parts, before);
        let nothing = [Vec3::ZERO; 3];
        let far = [Vec3::splat(1e30), Vec3::splat(-1e30), Vec3::X];
        for odd in [vec![], vec![nothing; 3], vec![far; 3]] {
            split(&mut whole(&odd), |t| odd[t as usize]);
        }
    }

    /// Hairs are split, their boxes shrink, and each point of a hair lies in one of its boxes, give or take a rounding.
    #[test]
    fn parts_cover_their_triangles() {
        let mut s = Stream::new(4, 3, 0);
        let mut v = || Vec3::new(s.next_f32(), s.next_f32(), s.next_f32()) * 2.0 - 1.0;
        let hair = |p: Vec3, d: Vec3, side: Vec3| [p, p + d, p + 0.01 * side];
        let mut corners: Vec<[Vec3; 3]> = (0..300).map(|_| hair(v(), v(), v())).collect();
        corners.push([Vec3::ZERO, Vec3::ONE * 20.0, Vec3::X * 0.01]);
        let mut parts = whole(&corners);
        let area = |parts: &[Part]| parts.iter().map(half_area).sum::<f32>();
        let before = area(&parts);
        assert!(split(&mut parts, |t| corners[t as usize]));
        assert!(area(&parts) < 0.5 * before, "{} {before}", area(&parts));
        assert!(parts.iter().filter(|p| p.triangle == 300).count() >= 4);
        for (t, &[a, b, c]) in corners.iter().enumerate() {
            let own: Vec<&Part> = parts.iter().filter(|p| p.triangle == t as u32).collect();
            for i in 0..=20 {
                for j in 0..=20 - i {
                    let (u, v) = (i as f32 / 20.0, j as f32 / 20.0);
                    let p = a + (b - a) * u + (c - a) * v;
                    let slack = 1e-6 * p.abs().max_element() + 1e-7;
                    let inside = |q: &&Part| (p + slack).cmpge(q.min).all() && (p - slack).cmple(q.max).all();
                    assert!(own.iter().any(inside), "triangle {t}, {u} {v}");
                }
            }
        }
    }
}
