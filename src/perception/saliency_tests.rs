//! Numbers of REFERENCE §1 (its script c01) and degenerate pictures.

use super::*;

use crate::math;

const GREY: Vec3 = Vec3::splat(0.25);

fn squares(list: &[(usize, usize, Vec3)]) -> Map2d<Vec3> {
    let mut image = Map2d::new(512, 512, GREY);
    for &(row, column, colour) in list {
        for y in row..row + 32 {
            for x in column..column + 32 {
                *image.at_mut(x, y) = colour;
            }
        }
    }
    image
}

fn pop_out() -> Map2d<Vec3> {
    let mut list = Vec::new();
    for j in 0..4 {
        for i in 0..4 {
            let red = (j, i) == (2, 1);
            let colour = if red { Vec3::new(0.9, 0.1, 0.1) } else { Vec3::splat(0.75) };
            list.push((j * 128 + 48, i * 128 + 48, colour));
        }
    }
    squares(&list)
}

fn near(value: f32, expected: f32, tolerance: f32) {
    assert!((value - expected).abs() <= tolerance, "{value} instead of {expected}");
}

#[test]
fn opponent_channels_of_pure_colours() {
    // I, R − G, B − Y from the R, G, B, Y of REFERENCE §1.1.
    for (rgb, rg, by) in [
        ([1.0, 0.0, 0.0], 3.0, 0.0),
        ([0.0, 1.0, 0.0], -3.0, 0.0),
        ([0.0, 0.0, 1.0], 0.0, 3.0),
        ([1.0, 1.0, 0.0], 0.0, -1.5),
        ([1.0, 0.5, 0.0], 1.5, -1.0),
        ([1.0, 1.0, 1.0], 0.0, 0.0),
        ([0.2, 0.6, 0.4], -0.75, 0.0),
    ] {
        let (mut i, mut red_green, mut blue_yellow) = ([0.0], [0.0], [0.0]);
        let [r, g, b] = rgb;
        channels([&[r], &[g], &[b]], [&mut i, &mut red_green, &mut blue_yellow], 0.1 * (r + g + b));
        near(i[0], (r + g + b) / 3.0, 1e-6);
        near(red_green[0], rg, 1e-5);
        near(blue_yellow[0], by, 1e-5);
    }
}

#[test]
fn normalisation_promotes_single_peaks() {
    let gain = |peaks: &[(usize, usize, f32)]| {
        let mut map = Map2d::new(9, 9, 0.0);
        peaks.iter().for_each(|&(y, x, v)| *map.at_mut(x, y) = v);
        Maxima::default().gain(map.data(), 9, 1e-9)
    };
    near(gain(&[(2, 2, 1.0)]), 1.0, 1e-6);
    near(gain(&[(2, 2, 1.0), (6, 6, 1.0)]), 0.0, 1e-6);
    near(gain(&[(2, 2, 1.0), (6, 6, 0.5), (2, 6, 0.25)]), 0.390_625, 1e-6);
    near(gain(&[(2, 2, 1.0), (6, 6, 0.5), (2, 6, 0.25), (7, 1, 0.05)]), 0.390_625, 1e-6);
    // A plateau is one maximum, whatever its shape: the U counts once, the dot beside it once.
    let u = [(1, 1), (2, 1), (3, 1), (3, 2), (3, 3), (2, 3), (1, 3)].map(|(y, x)| (y, x, 1.0));
    near(gain(&u), 1.0, 1e-6);
    near(gain(&[&u[..], &[(7, 7, 0.5)]].concat()), 0.25, 1e-6);
    assert_eq!(gain(&[]), 0.0);
}

#[test]
fn one_square() {
    let s = saliency(&squares(&[(300, 120, Vec3::splat(0.9))]));
    assert_eq!((s.map.width(), s.map.height()), (32, 32));
    let (y, x, value) = winner(&s.map);
    assert_eq!((y, x), (20, 8));
    near(value, 0.5, 1e-5);
    near(maximum(s.intensity.data()), 3.511_56, 2e-4);
    assert!(s.colour.data().iter().all(|&v| v == 0.0), "grey has no hue");
    near(s.map.data().iter().sum::<f32>() / 1024.0, 0.005_457, 1e-5);
}

#[test]
fn two_squares() {
    let s = saliency(&squares(&[(300, 120, Vec3::splat(0.9)), (60, 400, Vec3::splat(0.6))]));
    let (y, x, value) = winner(&s.map);
    assert_eq!((y, x), (20, 8));
    near(value, 0.073_58, 2e-5);
    near(s.map.at(136 / 16, 316 / 16), 0.057_94, 2e-5);
    near(s.map.at(416 / 16, 76 / 16), 0.035_13, 2e-5);
}

#[test]
fn red_among_grey_pops_out_at_any_exposure() {
    let image = pop_out();
    let s = saliency(&image);
    let (y, x, value) = winner(&s.map);
    assert_eq!((y, x), (20, 12));
    near(value, 0.500_35, 2e-5);
    near(s.map.at(12, 4), 0.001_95, 2e-5);
    near(s.map.at(20, 12), 0.003_51, 2e-5);
    let brighter = saliency(&image.map(|v| v * 7.3));
    for (a, b) in s.map.data().iter().zip(brighter.map.data()) {
        near(*a, *b, 2e-5);
    }
}

/// Cells (row, column, saliency) of waves in all channels, from the script c01 in double precision; sizes that are
/// no powers of two.
#[test]
fn agrees_with_the_script_in_double_precision() {
    let waves = |w, h| {
        Map2d::from_fn(w, h, |x, y| {
            let (x, y) = (x as f32, y as f32);
            let r = 0.5 + 0.3 * math::sin(x / 9.0) + 0.2 * math::cos(y / 5.0);
            let g = 0.4 + 0.3 * math::sin((x + y) / 13.0);
            let b = 0.5 + 0.4 * math::cos((x - 2.0 * y) / 17.0);
            Vec3::new(r, g, b).clamp(Vec3::ZERO, Vec3::ONE)
        })
    };
    let check = |w, h, conspicuities: [f32; 2], cells: [(usize, usize, f32); 5]| {
        let s = saliency(&waves(w, h));
        near(maximum(s.intensity.data()), conspicuities[0], 1e-4);
        near(maximum(s.colour.data()), conspicuities[1], 1e-4);
        for (row, column, value) in cells {
            near(s.map.at(column, row), value, 1e-5);
        }
    };
    let cells =
        [(0, 0, 0.015_974), (2, 3, 0.014_816), (6, 9, 0.018_673), (1, 5, 0.013_385), (4, 4, 0.011_507)];
    check(150, 97, [0.475_369, 1.093_124], cells);
    let cells =
        [(0, 0, 0.033_48), (2, 3, 0.032_422), (12, 20, 0.036_481), (1, 5, 0.030_609), (4, 4, 0.028_845)];
    check(333, 200, [0.463_16, 1.093_292], cells);
}

#[test]
fn a_red_patch_on_green_does_not_light_up_the_rest() {
    let mut image = Map2d::new(512, 512, Vec3::new(0.2, 0.5, 0.2));
    for y in 240..272 {
        for x in 240..272 {
            *image.at_mut(x, y) = Vec3::new(0.5, 0.2, 0.2);
        }
    }
    let s = saliency(&image);
    assert!(s.colour.at(16, 16) > 1.0);
    assert!(s.colour.at(1, 1) < 1e-3);
}

#[test]
fn uniform_pictures_have_no_saliency_at_all() {
    for rgb in [[0.0; 3], [0.5; 3], [1.0 / 3.0; 3], [1.0, 0.0, 0.0], [0.3, 0.7, 0.1], [0.1, 0.2, 0.9]] {
        let s = saliency(&Map2d::new(129, 70, Vec3::from(rgb)));
        assert!(s.map.data().iter().all(|&v| v == 0.0), "{rgb:?}");
    }
}

#[test]
fn any_size_and_any_value() {
    let s = saliency(&Map2d::from_fn(33, 21, |x, y| Vec3::splat(((x * y) % 5) as f32 / 5.0)));
    assert_eq!((s.map.width(), s.map.height()), (3, 2));
    assert_eq!(saliency(&Map2d::new(1, 1, Vec3::ONE)).map.data(), [0.0]);
    assert_eq!(saliency(&Map2d::new(0, 0, Vec3::ONE)).map.data(), [0.0; 0]);
    for (w, h) in [(5, 1), (1, 300), (2, 2), (17, 64)] {
        let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -3.0, 0.2, f32::MAX, 1e-30];
        let image = Map2d::from_fn(w, h, |x, y| {
            Vec3::new(bad[(x + y) % 7], bad[(x * 3 + y) % 7], bad[(x + 2 * y) % 7])
        });
        assert!(saliency(&image).map.data().iter().all(|v| v.is_finite() && *v >= 0.0));
    }
}

#[test]
fn the_model_can_be_used_again_and_takes_bytes() {
    let mut model = SaliencyModel::default();
    let image = pop_out().map(|v| (v * 255.0).round() / 255.0);
    let first = model.compute(&image).clone();
    model.compute(&squares(&[(10, 10, Vec3::ONE)]));
    model.compute(&Map2d::new(40, 30, GREY));
    assert_eq!(model.compute(&image), &first);
    let bytes: Vec<u8> =
        image.data().iter().flat_map(|v| v.to_array().map(|c| (c * 255.0).round() as u8)).collect();
    let from_bytes = model.compute_rgb8(&bytes, 512, 512);
    for (a, b) in first.map.data().iter().zip(from_bytes.map.data()) {
        near(*a, *b, 1e-5);
    }
}

#[test]
#[expect(clippy::disallowed_methods, reason = "prints how long it takes, asserts nothing about it")]
fn timing() {
    let image = Map2d::from_fn(512, 512, |x, y| {
        let t = crate::rng::hash(x as u64 / 3, y as u64 / 3, 1);
        Vec3::new((t & 255) as f32, (t >> 8 & 255) as f32, (t >> 16 & 255) as f32) / 255.0
    });
    let mut model = SaliencyModel::default();
    let first = model.compute(&image).clone();
    let start = std::time::Instant::now();
    for _ in 0..20 {
        model.compute(&image);
    }
    println!("saliency of 512 × 512: {:.2} ms", start.elapsed().as_secs_f64() * 1e3 / 20.0);
    assert_eq!(model.result(), &first);
}

/// The most salient cell: its row and column, the first of several, and its value.
fn winner(map: &Map2d<f32>) -> (usize, usize, f32) {
    let best = map.data().iter().copied().fold(0.0, f32::max);
    let cell = map.data().iter().position(|&v| v == best && v > 0.0).expect("something stands out");
    (cell / map.width(), cell % map.width(), best)
}
