//! Tests of packets of shadow rays: against single rays, bit for bit, whatever the processor has.

use glam::Vec3;

use super::super::level::Level;
use super::super::{Accel, Hit};
use super::*;
use crate::rng::Stream;
use crate::scene::test_scenes::of_triangles;

/// Numbers from −1 to 1.
fn vector(s: &mut Stream) -> Vec3 {
    Vec3::new(s.next_f32(), s.next_f32(), s.next_f32()) * 2.0 - 1.0
}

/// Triangles of which some share edges, some are long and thin (and so lie in several leaves), some large.
fn scenery(count: u64) -> Vec<[Vec3; 3]> {
    let of = |i: u64| {
        let mut s = Stream::new(31, i, 0);
        let mut v = || vector(&mut s);
        let (a, b, c, d) = (v(), v(), v(), v());
        match i % 8 {
            0 => [[a, a + 0.9 * b, a + 0.01 * c]; 2],
            1 => [[a, a + b, a + c], [a, a + c, a + d]],
            _ => [[a, a + 0.2 * b, a + 0.2 * c], [a, a + 0.2 * c, a + 0.2 * d]],
        }
    };
    (0..count).flat_map(of).collect()
}

/// Rays of a packet to one light, near or far away or a sun.
fn rays(i: u64, corners: &[[Vec3; 3]]) -> [Ray; LANES] {
    let mut s = Stream::new(32, i, 0);
    let (from, light) = (1.5 * vector(&mut s), 2.0 * vector(&mut s));
    let along = if i.is_multiple_of(7) { Vec3::NEG_Y } else { vector(&mut s) };
    let spread = [0.01, 0.1, 1.0][i as usize % 3];
    std::array::from_fn(|l| {
        let triangle = (i as usize * 16 + l) % corners.len();
        // On a surface, or somewhere.
        let origin = if l % 5 == 0 { corners[triangle][l % 3] } else { from + spread * vector(&mut s) };
        let target = if l % 4 == 0 { corners[(triangle + 7) % corners.len()][0] } else { light };
        let ignore = if l % 2 == 0 { triangle as u32 } else { Ray::NOTHING };
        match i % 4 {
            0 => Ray { ignore, ..Ray::new(origin, along) },
            1 => Ray { ignore, t_min: 0.1, t_max: 0.7, ..Ray::new(origin, 2.0 * (target - origin)) },
            _ => Ray { ignore, t_max: 1.0 - 1e-4, ..Ray::new(origin, target - origin) },
        }
    })
}

/// What single rays find.
fn singly(
    accel: &Accel,
    scene: &crate::scene::Scene,
    rays: &[Ray; LANES],
    lanes: u32,
    blocks: &impl Fn(&Hit) -> bool,
) -> Shadows {
    let mut shadows = Shadows::default();
    for lane in bits(lanes) {
        if accel.any_hit(scene, &rays[lane], |hit| blocks(&hit)) {
            shadows.blocked |= 1 << lane;
        } else if accel.occluded(scene, &rays[lane]) {
            shadows.unclear |= 1 << lane;
        }
    }
    shadows
}

#[test]
fn packets_find_what_single_rays_find() {
    for (corners, scale) in [(scenery(30), 1.0), (scenery(2000), 1.0), (scenery(300), 1e-12)] {
        let corners: Vec<[Vec3; 3]> = corners.iter().map(|t| t.map(|p| p * scale)).collect();
        let scene = of_triangles(&corners);
        let best = Accel::build(&scene);
        let all = Level::all().into_iter().map(|level| {
            let mut accel = best.clone();
            accel.set_level(level);
            accel
        });
        let all: Vec<Accel> = all.collect();
        let blocks = |hit: &Hit| !hit.triangle.is_multiple_of(2) || hit.b1 < 0.25;
        let mut last = vec![LastShadow::default(); all.len()];
        let mut counts = [0; 3];
        for i in 0..4000 {
            let rays = rays(i, &corners).map(|r| Ray { origin: r.origin * scale, ..r });
            let lanes = if i % 3 == 0 { 0xffff } else { Stream::new(33, i, 0).next_u64() as u32 & 0xffff };
            let single = singly(&best, &scene, &rays, lanes, &blocks);
            for (accel, last) in all.iter().zip(&mut last) {
                let found = accel.shadows(&scene, &rays, lanes, last, blocks);
                assert_eq!(found, single, "packet {i}");
                let open = lanes & !found.unclear & !found.blocked;
                for (count, lanes) in counts.iter_mut().zip([found.blocked, found.unclear, open]) {
                    *count += lanes.count_ones();
                }
            }
        }
        assert!(counts.iter().all(|&count| count > 2000), "{counts:?}");
    }
}

/// Rays from nearby to one light, along all axes and from all sides of it.
#[test]
fn rays_to_one_light_go_together() {
    let scene = of_triangles(&scenery(1000));
    let accel = Accel::build(&scene);
    let mut blocked = 0;
    for i in 0..3000 {
        let mut s = Stream::new(34, i, 0);
        let from = vector(&mut s);
        let light = if i % 3 == 0 { from + 0.02 * vector(&mut s) } else { Vec3::new(0.3, 3.0, 0.2) };
        let rays = std::array::from_fn(|_| {
            let origin = from + 0.01 * vector(&mut s);
            Ray { t_max: 1.0 - 1e-4, ..Ray::new(origin, light - origin) }
        });
        let found = accel.shadows(&scene, &rays, 0xffff, &mut LastShadow::default(), |_| true);
        assert_eq!(found, singly(&accel, &scene, &rays, 0xffff, &|_| true), "packet {i}");
        blocked += found.blocked.count_ones();
    }
    assert!((8_000..40_000).contains(&blocked), "{blocked} of 48000");
}

#[test]
fn what_is_no_ray_is_in_no_shadow() {
    let scene = of_triangles(&scenery(50));
    let accel = Accel::build(&scene);
    let bad = [Vec3::NAN, Vec3::ZERO, Vec3::INFINITY, Vec3::new(0.0, f32::NAN, 1.0)];
    let rays = std::array::from_fn(|l| match l % 8 {
        0..4 => Ray::new(Vec3::ZERO, bad[l % 4]),
        4 => Ray::new(Vec3::NAN, Vec3::X),
        5 => Ray::new(Vec3::ZERO, Vec3::X * 1e-30),
        _ => Ray::new(Vec3::ZERO, Vec3::X),
    });
    let found = accel.shadows(&scene, &rays, 0xffff, &mut LastShadow::default(), |_| true);
    let single = singly(&accel, &scene, &rays, 0xffff, &|_| true);
    assert_eq!(found.blocked & !found.unclear, single.blocked & !found.unclear);
    assert_eq!((found.blocked | found.unclear) & 0x1f1f, 0, "{found:?}");
    let none = Accel::build(&of_triangles(&[]));
    assert_eq!(none.shadows(&scene, &rays, 0xffff, &mut LastShadow::default(), |_| true), Shadows::default());
}
