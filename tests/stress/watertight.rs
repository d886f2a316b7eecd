//! No ray leaves a closed mesh.

use std::sync::Arc;

use foveal::geometry::{Accel, Ray};
use foveal::rng::Stream;
use foveal::scene::Scene;
use foveal_files::load::load;
use glam::Vec3;
use rayon::prelude::*;

use super::Files;

/// Closed meshes, with a point inside around which rays begin, and how far from it.
fn closed() -> Vec<(&'static str, Arc<Scene>, Vec3, f32)> {
    let ball = |rings, centre: Vec3, stretch: Vec3| {
        let files = Files::default().grey("skin", 0.5).ball("skin", Vec3::ZERO, 1.0, rings);
        let file = files.write_with("closed", Vec3::ZERO, Vec3::X, 45.0, |p| p * stretch + centre);
        Arc::new(load(&file).unwrap_or_else(|e| panic!("{e}")).scene)
    };
    let far = Vec3::new(3000.0, -500.0, 1234.5);
    let mut rooms = vec![
        ("ball", ball(32, Vec3::ZERO, Vec3::ONE), Vec3::ZERO, 0.3),
        ("fine ball", ball(90, Vec3::ZERO, Vec3::ONE), Vec3::ZERO, 0.3),
        ("needle", ball(24, Vec3::ZERO, Vec3::new(1e-3, 1e-3, 10.0)), Vec3::ZERO, 1e-4),
        ("disc", ball(24, Vec3::ZERO, Vec3::new(5.0, 1e-4, 5.0)), Vec3::ZERO, 1e-5),
        ("far ball", ball(32, far, Vec3::ONE), far, 0.3),
        ("small ball", ball(32, Vec3::ZERO, Vec3::splat(2f32.powi(-20))), Vec3::ZERO, 2f32.powi(-22)),
        ("large ball", ball(32, Vec3::ZERO, Vec3::splat(2f32.powi(20))), Vec3::ZERO, 2f32.powi(18)),
    ];
    let room = Files::furnished().write("room");
    let room = Arc::new(load(&room).unwrap_or_else(|e| panic!("{e}")).scene);
    rooms.push(("room", room, Vec3::new(0.0, 0.4, 0.4), 0.4));
    rooms
}

/// Rays aimed at edges, corners and along the axes; single, to the end, and in packets. Returns how many left.
fn leaks(scene: &Scene, accel: &Accel, centre: Vec3, reach: f32, packets: u64) -> u64 {
    let triangles = scene.mesh.triangles.len() as u64;
    (0..packets)
        .into_par_iter()
        .map(|i| {
            let mut s = Stream::new(0x1ea4, i, 0);
            let mut inside = || 2.0 * Vec3::new(s.next_f32(), s.next_f32(), s.next_f32()) - 1.0;
            let origin = centre + reach * inside() * 0.577;
            let mut s = Stream::new(0x1ea5, i, 0);
            let corners = scene.mesh.corners((s.next_u64() % triangles) as u32);
            let directions: [Vec3; 16] = std::array::from_fn(|lane| {
                let target = match lane % 4 {
                    0 => corners[(lane / 4) % 3],
                    1 => corners[0].lerp(corners[1], s.next_f32()),
                    2 => corners[1].lerp(corners[2], s.next_f32()),
                    _ => corners[2].lerp(corners[0], 0.5),
                };
                (target - origin).try_normalize().unwrap_or(Vec3::X)
            });
            let mut lost = 0;
            for hit in accel.intersect_packet(scene, origin, &directions) {
                lost += u64::from(hit.is_none());
            }
            for direction in directions.into_iter().chain([Vec3::X, Vec3::NEG_Y, Vec3::Z]) {
                let ray = Ray::new(origin, direction);
                lost += u64::from(accel.intersect(scene, &ray).is_none());
                lost += u64::from(!accel.occluded(scene, &ray));
            }
            lost
        })
        .sum()
}

/// `rays` rays of every kind over all meshes.
fn check(rays: u64) {
    let meshes = closed();
    let packets = rays / (meshes.len() as u64 * (16 + 2 * 19)) + 1;
    for (what, scene, centre, reach) in &meshes {
        let accel = Accel::build(scene);
        assert_eq!(leaks(scene, &accel, *centre, *reach, packets), 0, "{what}");
    }
}

#[test]
fn a_million_rays_stay_inside() {
    check(1_000_000);
}

/// `cargo test --release --test program -- --ignored a_hundred_million`
#[test]
#[ignore = "half a minute, optimised"]
fn a_hundred_million_rays_stay_inside() {
    check(100_000_000);
}
