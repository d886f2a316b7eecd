use glam::Vec3;

use super::*;
use crate::image::luminance;
use crate::rng::Stream;
use crate::scene::{Environment, Light, Scene, Texture, TextureId, texture::MipChain};
use crate::transport::light::{Emitter, LightSample, Lights, emitted, sample_analytic, sample_triangle};
use crate::transport::test_boxes::{Builder, lambert};

fn cube_of(s: &mut Stream, half: f32) -> Vec3 {
    Vec3::new(s.next_f32(), s.next_f32(), s.next_f32()) * (2.0 * half) - half
}

fn direction(s: &mut Stream) -> Vec3 {
    cube_of(s, 1.0).try_normalize().unwrap_or(Vec3::Z)
}

/// Rectangles of all sizes that face anywhere, points and spots of all widths, in a cube of half side 2.
fn crowded(count: usize, seed: u64) -> Scene {
    let mut b = Builder::default();
    let mut s = Stream::new(seed, 0, 0);
    for _ in 0..count {
        let light = b.emitter(lambert(0.2), Vec3::new(s.next_f32(), s.next_f32(), 0.1) * 10.0);
        let (u, size) = (direction(&mut s), 0.01 + s.next_f32().powi(4));
        b.rectangle(cube_of(&mut s, 2.0), u * size, u.any_orthonormal_vector() * size * s.next_f32(), light);
    }
    let mut scene = b.scene();
    for i in 0..count {
        let position = cube_of(&mut s, 2.0);
        let intensity = Vec3::splat(s.next_f32() * 3.0);
        scene.lights.push(if i % 3 == 0 {
            Light::Point { position, intensity, range: f32::INFINITY }
        } else {
            let outer = 0.02 + 1.5 * s.next_f32();
            // Also such with a hard edge.
            let inner = if i % 3 == 1 { outer } else { outer * s.next_f32() };
            Light::Spot {
                position,
                direction: direction(&mut s),
                intensity,
                inner,
                outer,
                range: f32::INFINITY,
            }
        });
    }
    scene
}

/// Points far, near, between the lights, on them and on the corners of boxes, each with a normal.
fn receivers(scene: &Scene) -> Vec<Receiver> {
    let mut s = Stream::new(77, 0, 0);
    let mut all = Vec::new();
    for half in [0.1, 2.0, 6.0, 1e4] {
        for _ in 0..40 {
            all.push(Receiver { point: cube_of(&mut s, half), normal: direction(&mut s) });
        }
    }
    for (i, &point) in scene.mesh.positions.iter().enumerate().take(40) {
        let normal = if i % 2 == 0 { direction(&mut s) } else { Vec3::Y };
        all.push(Receiver { point, normal });
        all.push(Receiver { point: point + direction(&mut s) * 1e-3, normal });
    }
    for light in &scene.lights {
        if let Light::Point { position, .. } | Light::Spot { position, .. } = light {
            all.push(Receiver { point: *position, normal: Vec3::X });
            all.push(Receiver { point: *position + direction(&mut s) * 0.01, normal: Vec3::Z });
        }
    }
    all
}

/// What sample `u` of one light brings to a surface, before anything stands in between.
fn brings(scene: &Scene, emitter: Emitter, at: &Receiver, u: [f32; 2]) -> f64 {
    let sample: Option<LightSample> = match emitter {
        Emitter::Triangle(t) => sample_triangle(scene, t, at.point, u),
        Emitter::Analytic(i) => sample_analytic(&scene.lights[i as usize], at.point),
        Emitter::Environment => None,
    };
    let e = sample.map_or(0.0, |s| {
        f64::from(luminance(s.radiance)) * f64::from(s.wi.dot(at.normal).max(0.0)) / f64::from(s.pdf)
    });
    if e.is_finite() { e } else { 0.0 }
}

#[test]
fn probabilities_sum_to_what_is_chosen_at_all_and_choices_follow_them() {
    for (count, seed) in [(1, 1), (2, 2), (7, 3), (60, 4)] {
        let scene = crowded(count, seed);
        let lights = Lights::build(&scene);
        let n = lights.near_count;
        let mut lost = Vec::new();
        for (k, at) in receivers(&scene).iter().enumerate() {
            let p: Vec<f64> = (0..n).map(|i| lights.tree.probability(i, at)).collect();
            let sum: f64 = p.iter().sum();
            assert!(p.iter().all(|p| (0.0..=1.0).contains(p)) && sum < 1.0 + 1e-9, "{at:?}: {sum}");
            lost.push(1.0 - sum);
            if k % 9 != 0 {
                continue;
            }
            // Stratified, so that frequencies are exact to a few strata per light.
            let draws = 20_000;
            let mut found = vec![0u32; n];
            for i in 0..draws {
                let u = (f64::from(i) + 0.5) / f64::from(draws);
                if let Some((light, probability)) = lights.tree.choose(at, u) {
                    assert!((probability - p[light]).abs() < 1e-12, "{probability} {}", p[light]);
                    found[light] += 1;
                }
            }
            for (p, f) in p.iter().zip(&found) {
                assert!((f64::from(*f) / f64::from(draws) - p).abs() < 2.0 / f64::from(draws), "{p} {f}");
            }
            let missing = f64::from(draws - found.iter().sum::<u32>()) / f64::from(draws);
            assert!((1.0 - sum - missing).abs() < 2.0 * n as f64 / f64::from(draws), "{sum} {missing}");
        }
        // Where two halves look away that do not together, nothing is chosen: seldom where anything shines.
        let shone_on: Vec<f64> = lost.into_iter().filter(|l| *l < 1.0).collect();
        let mean = shone_on.iter().sum::<f64>() / shone_on.len() as f64;
        assert!(mean < 0.3, "{count}: {mean}");
    }
    // What shines everywhere is always chosen.
    let tree = LightTree::new((0..99).map(|i| {
        let mut s = Stream::new(5, i, 0);
        Some(Bounds::of_point(cube_of(&mut s, 1.0), 0.1 + f64::from(s.next_f32())))
    }));
    for i in 0..50 {
        let mut s = Stream::new(6, i, 0);
        let at = Receiver { point: cube_of(&mut s, 0.5) - 2.0 * Vec3::Y, normal: Vec3::Y };
        let sum: f64 = (0..99).map(|i| tree.probability(i, &at)).sum();
        assert!((sum - 1.0).abs() < 1e-9, "{sum}");
    }
}

#[test]
fn whatever_brings_light_may_be_chosen() {
    for (count, seed) in [(1, 11), (3, 12), (80, 13)] {
        let scene = crowded(count, seed);
        let lights = Lights::build(&scene);
        let mut shining = 0u32;
        for at in receivers(&scene) {
            for (i, &emitter) in lights.emitters[..lights.near_count].iter().enumerate() {
                let p = lights.tree.probability(i, &at);
                for u in [[0.5, 0.5], [0.01, 0.99], [0.98, 0.03], [0.9, 0.97]] {
                    let e = brings(&scene, emitter, &at, u);
                    shining += u32::from(e > 0.0);
                    assert!(e <= 0.0 || p > 0.0, "{emitter:?} brings {e} to {at:?}");
                }
            }
        }
        assert!(shining > 100);
    }
}

/// A light whose picture is bright in one corner only, and one of which a mask leaves nothing but a corner.
#[test]
fn pictures_of_light_are_not_lost() {
    let mut b = Builder::default();
    let window = b.emitter(lambert(0.0), Vec3::ONE);
    let other = b.emitter(lambert(0.0), Vec3::ONE);
    b.rectangle(Vec3::Y * 2.0, Vec3::X, Vec3::Z, other);
    b.rectangle(Vec3::Y * 3.0, Vec3::X, Vec3::Z, window);
    let mut s = b.scene();
    s.mesh.uvs = s.mesh.positions.iter().map(|p| glam::Vec2::new(p.x + 1.0, p.z + 1.0) * 0.5).collect();
    let texels = (0..256).map(|i| if i == 0 { [1.0, 0.0, 0.0, 1.0] } else { [0.0; 4] }).collect();
    s.textures.push(Texture::new("corner", MipChain::from_linear(16, 16, texels)));
    s.materials[0].emission.map = Some(TextureId(0));
    let lights = Lights::build(&s);
    let at = Receiver { point: Vec3::new(0.3, 1.0, 0.2), normal: Vec3::Y };
    let mut bright = 0;
    for (i, &emitter) in lights.emitters[..lights.near_count].iter().enumerate() {
        let Emitter::Triangle(t) = emitter else { continue };
        for (b1, b2) in [(0.01, 0.01), (0.98, 0.01), (0.01, 0.98)] {
            let shines = emitted(&s, t, b1, b2).max_element() > 0.0;
            bright += u32::from(shines && t >= 2);
            // Seen from below, both rectangles show their backs or their fronts alike.
            let front = lights.tree.probability(i, &at) > 0.0
                || lights
                    .tree
                    .probability(i, &Receiver { point: Vec3::new(0.3, 9.0, 0.2), normal: Vec3::NEG_Y })
                    > 0.0;
            assert!(!shines || front, "{t}");
        }
    }
    assert!(bright > 0);
}

#[test]
fn the_mean_of_samples_is_the_sum_over_all_lights() {
    let mut scene = crowded(25, 21);
    scene.lights.push(Light::Directional { direction: Vec3::new(0.3, -1.0, 0.2), irradiance: Vec3::ONE });
    scene.environment = Some(Environment::constant(Vec3::splat(0.2)));
    let lights = Lights::build(&scene);
    for at in receivers(&scene).into_iter().step_by(31).filter(|at| at.point.abs().max_element() < 10.0) {
        let sun = Vec3::new(-0.3, 1.0, -0.2).normalize().dot(at.normal).max(0.0);
        let mut sum = f64::from(sun) + 0.2 * PI;
        for &emitter in &lights.emitters[..lights.near_count] {
            let n = 4000;
            let of = |i| brings(&scene, emitter, &at, Stream::new(8, i, 0).next_2d());
            sum += (0..n).map(of).sum::<f64>() / n as f64;
        }
        let n = 200_000;
        let (mut mean, mut square) = (0.0, 0.0);
        for i in 0..n {
            let mut s = Stream::new(9, i, 0);
            let Some(l) = lights.sample_towards(&scene, &at, (s.next_f64(), s.next_2d()), None) else {
                continue;
            };
            let e = f64::from(luminance(l.radiance)) * f64::from(l.wi.dot(at.normal).max(0.0) / l.pdf);
            mean += e / n as f64;
            square += e * e / n as f64;
        }
        let error = ((square - mean * mean).max(0.0) / n as f64).sqrt();
        assert!((mean - sum).abs() < 5.0 * error + 0.01 * sum, "{at:?}: {mean} ± {error}, {sum}");
    }
}

#[test]
fn a_weak_lamp_nearby_is_asked_more_often_than_a_strong_one_far_away() {
    let mut b = Builder::default();
    let strong = b.emitter(lambert(0.0), Vec3::splat(100.0));
    let weak = b.emitter(lambert(0.0), Vec3::splat(100.0));
    b.rectangle(Vec3::new(0.5, 3.0, 0.5), Vec3::X, Vec3::Z, strong);
    b.rectangle(Vec3::new(5.0, 0.3, 0.0), Vec3::X * 0.05, Vec3::Z * 0.05, weak);
    let lights = Lights::build(&b.scene());
    let share = |first: usize, point: Vec3| {
        let at = Receiver { point, normal: Vec3::Y };
        lights.tree.probability(first, &at) + lights.tree.probability(first + 1, &at)
    };
    assert!(share(2, Vec3::new(5.0, 0.0, 0.0)) > 0.5);
    assert!(share(0, Vec3::new(0.5, 1.0, 0.5)) > 0.8);
    // Above both and facing away nothing is chosen.
    let above = Receiver { point: Vec3::Y * 9.0, normal: Vec3::Y };
    assert_eq!(lights.tree.choose(&above, 0.5), None);
}

#[test]
fn degenerate_lights_and_numbers_that_are_none_choose_nothing_wrong() {
    let empty = LightTree::new(std::iter::empty());
    let at = Receiver { point: Vec3::ZERO, normal: Vec3::Y };
    assert!(empty.choose(&at, 0.5).is_none() && empty.probability(3, &at) == 0.0);
    let strange = [
        Some(Bounds::of_point(Vec3::NAN, 1.0)),
        Some(Bounds::of_point(Vec3::X, f64::INFINITY)),
        Some(Bounds::of_point(Vec3::X, 0.0)),
        None,
        Some(Bounds::of_point(Vec3::Y, 1.0)),
        Some(Bounds::of_point(Vec3::Y, 2.0)),
        Some(Bounds::of_triangle([Vec3::splat(1e30), Vec3::splat(-1e30), Vec3::X], Vec3::Y, 1e30)),
        Some(Bounds::of_triangle([Vec3::Y; 3], Vec3::ZERO, 1.0)),
        Some(Bounds::of_spot(Vec3::Y, Vec3::NEG_Y, 0.0, 0.0, 1.0)),
        Some(Bounds::of_spot(Vec3::Y, Vec3::NEG_Y, 9.0, -1.0, 1.0)),
    ];
    let tree = LightTree::new(strange.into_iter());
    for point in [Vec3::ZERO, Vec3::Y, Vec3::NAN, Vec3::INFINITY, Vec3::MAX, Vec3::splat(1e-40)] {
        for normal in [Vec3::Y, Vec3::ZERO, Vec3::NAN] {
            let at = Receiver { point, normal };
            for u in [0.0, 0.3, 0.999_999_999, 1.0] {
                if let Some((i, p)) = tree.choose(&at, u) {
                    assert!(i >= 4 && p > 0.0 && p <= 1.0, "{i} {p} {at:?}");
                }
            }
            let sum: f64 = (0..10).map(|i| tree.probability(i, &at)).sum();
            assert!(sum <= 1.0 + 1e-9, "{sum} {at:?}");
        }
    }
    // Many lights at one place: no trail outgrows its bits.
    let heap = LightTree::new((0..5000).map(|_| Some(Bounds::of_point(Vec3::ONE, 1.0))));
    let p = heap.probability(4321, &at);
    assert!((p - 1.0 / 5000.0).abs() < 1e-4, "{p}");
    // In a geometric row halves are lopsided.
    let row = (0..4000).map(|i| {
        let x = math::powf(0.9f64, f64::from(i)) as f32;
        Some(Bounds::of_point(Vec3::X * x, f64::from(x)))
    });
    let tree = LightTree::new(row);
    let sum: f64 = (0..4000).map(|i| tree.probability(i, &at)).sum();
    assert!((sum - 1.0).abs() < 1e-6, "{sum}");
}
