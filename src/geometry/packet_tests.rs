//! Tests of packets: against single rays, at edges, and of what is no direction or no triangle.

use super::super::collapse::BinaryNode;
use super::*;
use crate::rng::Stream;

/// A tree of leaves with one triangle each, split where `at` says of a number of triangles (bad but valid); `flag`
/// goes to each.
fn tree(corners: &[[Vec3; 3]], flag: u32, at: fn(usize) -> usize) -> Wide {
    fn fill(nodes: &mut Vec<BinaryNode>, corners: &[[Vec3; 3]], first: usize, at: fn(usize) -> usize) {
        let points = || corners.iter().flatten();
        let min = points().fold(Vec3::INFINITY, |m, &p| m.min(p));
        let max = points().fold(Vec3::NEG_INFINITY, |m, &p| m.max(p));
        let pad = min.abs().max(max.abs()).max_element() / 1_048_576.0;
        let (min, max, here) = (min - pad, max + pad, nodes.len());
        nodes.push(BinaryNode { min, max, next: first as u32, is_leaf: corners.len() == 1 });
        if corners.len() > 1 {
            let middle = at(corners.len());
            fill(nodes, &corners[..middle], first, at);
            nodes[here].next = (nodes.len() - here) as u32;
            fill(nodes, &corners[middle..], first + middle, at);
        }
    }
    let mut nodes = Vec::new();
    fill(&mut nodes, corners, 0, at);
    Wide::new(nodes, |leaf| (corners[leaf as usize], leaf | flag))
}

fn halves(count: usize) -> usize {
    count / 2
}

/// Every triangle is there.
const WHOLE: fn(u32, f32, f32) -> bool = |_, _, _| true;

fn random_directions(i: u64, spread: f32) -> [Vec3; LANES] {
    let mut s = Stream::new(3, i, 0);
    let mut vector = || Vec3::new(s.next_f32() - 0.5, s.next_f32() - 0.5, s.next_f32() - 0.5);
    let axis = vector().normalize();
    std::array::from_fn(|_| (axis + spread * vector()).normalize())
}

/// Rays from inside a closed octahedron aimed at its edges and corners never escape (c05: plain
/// Möller–Trumbore loses 30195 of 400 000).
#[test]
fn no_ray_leaves_a_closed_octahedron() {
    for offset in [0.0, 100.0, 10_000.0] {
        let at = |x: f32, y: f32, z: f32| Vec3::new(x, y, z) + offset;
        let (px, mx) = (at(1.0, 0.0, 0.0), at(-1.0, 0.0, 0.0));
        let (py, my) = (at(0.0, 1.0, 0.0), at(0.0, -1.0, 0.0));
        let (pz, mz) = (at(0.0, 0.0, 1.0), at(0.0, 0.0, -1.0));
        let corners = [
            [px, py, pz],
            [py, mx, pz],
            [mx, my, pz],
            [my, px, pz],
            [py, px, mz],
            [mx, py, mz],
            [my, mx, mz],
            [px, my, mz],
        ];
        let wide = tree(&corners, 0, halves);
        let vertices = [px, mx, py, my, pz, mz];
        for i in 0..4000u64 {
            let mut s = Stream::new(11, i, 0);
            let eye = at(0.0, 0.0, 0.0)
                + Vec3::new(s.next_f32() - 0.5, s.next_f32() - 0.5, s.next_f32() - 0.5) * 0.5;
            let directions = std::array::from_fn(|l| {
                // Opposite vertices share no edge.
                let (a, step) = ((i as usize + l) % 6, 2 + (l % 2) * 2);
                let pair = (vertices[a], vertices[((a / 2) * 2 + step) % 6]);
                let f = if l % 8 == 7 { 0.0 } else { s.next_f32() };
                (pair.0 + (pair.1 - pair.0) * f - eye).normalize()
            });
            let hit = intersect(&wide, eye, &directions, &WHOLE);
            assert!(hit.t.iter().all(|&t| t < f32::INFINITY), "offset {offset}, packet {i}: {hit:?}");
        }
    }
}

/// Squares of such lengths are infinite.
#[test]
fn trees_of_any_size_are_whole() {
    for scale in [1e-25f32, 1e25, 1e30] {
        let corners: Vec<[Vec3; 3]> = (0..40)
            .map(|i| Vec3::new(0.0, 0.0, 1.0 + i as f32))
            .map(|at| [at - Vec3::ONE, at + Vec3::X * 3.0, at + Vec3::Y * 3.0].map(|p| p * scale))
            .collect();
        for at in [halves as fn(usize) -> usize, |_| 1] {
            let wide = tree(&corners, 0, at);
            let mut held: Vec<u32> = wide.parts().1.iter().flat_map(|b| b.index).collect();
            held.retain(|&index| index != u32::MAX);
            held.sort_unstable();
            assert_eq!(held, (0..40).collect::<Vec<_>>(), "{scale}");
        }
    }
}

/// Rays that are none hit nothing and keep no other from what it hits.
#[test]
fn directions_that_are_none_hit_nothing() {
    let corners: Vec<[Vec3; 3]> = (0..40)
        .map(|i| Vec3::new(0.0, 0.0, 1.0 + i as f32))
        .map(|at| [at - Vec3::ONE, at + Vec3::X * 3.0, at + Vec3::Y * 3.0])
        .collect();
    for at in [halves as fn(usize) -> usize, |_| 1] {
        let wide = tree(&corners, 0, at);
        for none in [Vec3::NAN, Vec3::ZERO, Vec3::INFINITY, Vec3::new(0.0, f32::NAN, 1.0)] {
            let some = std::array::from_fn(|l| if l % 3 == 0 { none } else { Vec3::Z });
            let hit = intersect(&wide, Vec3::ZERO, &some, &WHOLE);
            assert!((0..LANES).all(|l| hit.t[l].is_finite() == (l % 3 != 0)), "{none}: {hit:?}");
            let hit = intersect(&wide, Vec3::ZERO, &[none; LANES], &WHOLE);
            assert_eq!(hit.t, [f32::INFINITY; LANES], "{none}");
        }
        let hit = intersect(&wide, Vec3::NAN, &[Vec3::Z; LANES], &WHOLE);
        assert_eq!(hit.t, [f32::INFINITY; LANES]);
    }
}

/// A packet finds what packets of one ray find, for any tree.
#[test]
fn packets_agree_with_single_rays() {
    let corners: Vec<[Vec3; 3]> = (0..300)
        .map(|i| {
            let mut s = Stream::new(1, i, 0);
            let mut p = || Vec3::new(s.next_f32(), s.next_f32(), s.next_f32()) * 2.0 - 1.0;
            let c = p();
            [c, c + p() * 0.3, c + p() * 0.3]
        })
        .collect();
    let shapes = [tree(&corners, CUT_OUT, halves), tree(&corners, CUT_OUT, |_| 1)];
    assert!(shapes[0].stack() <= STACK && shapes[1].stack() > STACK, "both kinds of stacks");
    let is_there = |triangle: u32, _: f32, _: f32| !triangle.is_multiple_of(5);
    let mut hits = 0;
    for i in 0..2000 {
        let directions = random_directions(i, if i % 3 == 0 { 3.0 } else { 0.05 });
        let eye = Vec3::new(0.1, 0.0, -0.2);
        let [packet, same] = [0, 1].map(|shape| intersect(&shapes[shape], eye, &directions, &is_there));
        assert_eq!(packet, same, "packet {i}");
        for (l, &direction) in directions.iter().enumerate() {
            let single = intersect(&shapes[1], eye, &[direction; LANES], &is_there);
            let close = (packet.t[l] - single.t[0]).abs() <= 1e-4 * single.t[0] || packet.t[l] == single.t[0];
            assert!(close, "packet {i}, lane {l}: {} against {}", packet.t[l], single.t[0]);
            if packet.t[l] < f32::INFINITY {
                assert_ne!(packet.triangle[l] % 5, 0);
                hits += 1;
            }
        }
    }
    assert!(hits > 4000);
}

#[test]
fn nothing_degenerate_is_hit() {
    let p = Vec3::new(0.0, 0.0, 2.0);
    let corners =
        [[p, p, p], [p, p, p + Vec3::X], [p - Vec3::X, p, p + Vec3::X], [p, p + Vec3::Z, p + Vec3::Z * 2.0]];
    for wide in [tree(&corners, 0, halves), Wide::default()] {
        let hit = intersect(&wide, Vec3::ZERO, &[Vec3::Z; LANES], &WHOLE);
        assert_eq!(hit.t, [f32::INFINITY; LANES]);
    }
}
