//! LDR-FLIP: the difference a viewer sees who flips between two pictures (Andersson et al. 2020; REFERENCE §12.1).
//!
//! In: displayed linear light in [0, 1]. Out: error per pixel in [0, 1]. Written here and not taken from
//! `nv-flip`, which the tests compare it with, because that one takes bytes: rounding to bytes moves the error of
//! close pictures by some per cent.

use std::f64::consts::PI;

use glam::{DMat3, DVec3, Mat3, Vec3};
use rayon::prelude::*;

use crate::display::tone::ToneMap;
use crate::image::{Map2d, linear_from_srgb};
use crate::math;

/// Pixels per degree of visual angle: a 0.7 m wide screen of 3840 pixels at 0.7 m, FLIP's default.
pub const PIXELS_PER_DEGREE: f64 = 67.020_643_276_582_25;

/// The exponent of colour differences, q_c.
const COLOUR_EXPONENT: f32 = 0.7;
/// The share p_c of the largest colour difference that is mapped to p_t of the error.
const COLOUR_KNEE: f32 = 0.4;
/// The error p_t at that share.
const ERROR_KNEE: f32 = 0.95;
/// Width of the feature detectors, degrees.
const FEATURE_WIDTH: f64 = 0.082;

/// The D65 white of [`xyz_from_linear`].
const WHITE: DVec3 = DVec3::new(0.950_428_545, 1.0, 1.088_900_371);

/// CIE XYZ from linear sRGB with exact rational chromaticities.
fn xyz_from_linear() -> DMat3 {
    DMat3::from_cols(
        DVec3::new(10_135_552.0 / 24_577_794.0, 2_613_072.0 / 12_288_897.0, 1_425_312.0 / 73_733_382.0),
        DVec3::new(8_788_810.0 / 24_577_794.0, 8_788_810.0 / 12_288_897.0, 8_788_810.0 / 73_733_382.0),
        DVec3::new(4_435_075.0 / 24_577_794.0, 887_015.0 / 12_288_897.0, 70_074_185.0 / 73_733_382.0),
    )
}

/// Colour transforms and filters for one viewing distance.
struct Filters {
    /// XYZ over white, from linear RGB, and back.
    relative_xyz: Mat3,
    linear: Mat3,
    /// Contrast sensitivity: Y, Cx, and the two Gaussians of Cz.
    sensitivity: [Vec<f32>; 4],
    /// A Gaussian, its first and its second derivative.
    features: [Vec<f32>; 3],
    /// Difference of green and blue, the largest there is, after the exponent.
    largest: f32,
}

impl Filters {
    fn new(pixels_per_degree: f64) -> Self {
        let relative_xyz = DMat3::from_diagonal(1.0 / WHITE) * xyz_from_linear();
        let mut filters = Self {
            relative_xyz: relative_xyz.as_mat3(),
            linear: relative_xyz.inverse().as_mat3(),
            sensitivity: sensitivity(pixels_per_degree),
            features: features(pixels_per_degree),
            largest: 0.0,
        };
        filters.largest =
            math::powf(hyab(filters.hunt_lab(Vec3::Y), filters.hunt_lab(Vec3::Z)), COLOUR_EXPONENT);
        filters
    }

    /// Linear RGB to the opponent space YCxCz.
    fn opponent(&self, linear: Vec3) -> Vec3 {
        let v = self.relative_xyz * linear;
        Vec3::new(116.0 * v.y - 16.0, 500.0 * (v.x - v.y), 200.0 * (v.y - v.z))
    }

    fn linear_from_opponent(&self, [y, cx, cz]: [f32; 3]) -> Vec3 {
        let y = (y + 16.0) / 116.0;
        self.linear * Vec3::new(y + cx / 500.0, y, y - cz / 200.0)
    }

    /// CIELAB with chroma scaled by lightness (Hunt effect).
    fn hunt_lab(&self, linear: Vec3) -> Vec3 {
        /// 6/29: below its cube the root is replaced by a line.
        const DELTA: f32 = 6.0 / 29.0;
        let f =
            |t: f32| if t > DELTA.powi(3) { math::cbrt(t) } else { t / (3.0 * DELTA * DELTA) + 4.0 / 29.0 };
        let [x, y, z] = (self.relative_xyz * linear).to_array().map(f);
        let lightness = 116.0 * y - 16.0;
        Vec3::new(lightness, 0.01 * lightness * 500.0 * (x - y), 0.01 * lightness * 200.0 * (y - z))
    }

    /// Colour error of two filtered colours.
    fn colour_error(&self, a: Vec3, b: Vec3) -> f32 {
        let difference = math::powf(hyab(a, b), COLOUR_EXPONENT);
        let knee = COLOUR_KNEE * self.largest;
        if difference < knee {
            difference * ERROR_KNEE / knee
        } else {
            ERROR_KNEE + (difference - knee) / (self.largest - knee) * (1.0 - ERROR_KNEE)
        }
    }
}

/// City-block distance in lightness, Euclidean in chroma.
fn hyab(a: Vec3, b: Vec3) -> f32 {
    (a.x - b.x).abs() + math::hypot(a.y - b.y, a.z - b.z)
}

fn taps(radius: i32, f: impl Fn(f64) -> f64) -> Vec<f64> {
    (-radius..=radius).map(|i| f(f64::from(i))).collect()
}

/// Separable contrast sensitivity filters. Cz is a sum of two Gaussians, so it takes two passes that share one
/// normalisation.
fn sensitivity(pixels_per_degree: f64) -> [Vec<f32>; 4] {
    let radius = (3.0 * (0.04 / (2.0 * PI * PI)).sqrt() * pixels_per_degree).ceil() as i32;
    let gaussian = |a: f64, b: f64| {
        let weight = (a * (PI / b).sqrt()).sqrt();
        taps(radius, |x| weight * math::exp(-PI * PI * (x / pixels_per_degree).powi(2) / b))
    };
    let sum = |kernel: &[f64]| kernel.iter().sum::<f64>();
    let scaled = |kernel: &[f64], scale: f64| kernel.iter().map(|v| (v * scale) as f32).collect();
    let (y, cx) = (gaussian(1.0, 0.0047), gaussian(1.0, 0.0053));
    let (wide, narrow) = (gaussian(34.1, 0.04), gaussian(13.5, 0.025));
    let both = 1.0 / math::hypot(sum(&wide), sum(&narrow));
    [scaled(&y, 1.0 / sum(&y)), scaled(&cx, 1.0 / sum(&cx)), scaled(&wide, both), scaled(&narrow, both)]
}

/// A Gaussian and its derivatives, the positive and negative taps of each summing to ±1.
fn features(pixels_per_degree: f64) -> [Vec<f32>; 3] {
    let sigma = 0.5 * FEATURE_WIDTH * pixels_per_degree;
    let radius = (3.0 * sigma).ceil() as i32;
    let gaussian = |x: f64| math::exp(-x * x / (2.0 * sigma * sigma));
    let normalised = |kernel: Vec<f64>| {
        let positive: f64 = kernel.iter().filter(|v| **v > 0.0).sum();
        let negative: f64 = -kernel.iter().filter(|v| **v < 0.0).sum::<f64>();
        kernel
            .iter()
            .map(|&v| (if v > 0.0 { v / positive } else { v / negative.max(1e-300) }) as f32)
            .collect()
    };
    [
        normalised(taps(radius, gaussian)),
        normalised(taps(radius, |x| -x * gaussian(x))),
        normalised(taps(radius, |x| (x * x / (sigma * sigma) - 1.0) * gaussian(x))),
    ]
}

/// `out` = `row` convolved with `kernel`, the row continued by its end values. `padded` is working memory.
fn convolve_row(row: &[f32], kernel: &[f32], padded: &mut Vec<f32>, out: &mut [f32]) {
    let (radius, width) = (kernel.len() / 2, row.len());
    padded.clear();
    padded.resize(radius, row[0]);
    padded.extend_from_slice(row);
    padded.resize(width + 2 * radius, row[width - 1]);
    out.fill(0.0);
    for (i, &k) in kernel.iter().enumerate() {
        out.iter_mut().zip(&padded[i..i + width]).for_each(|(out, v)| *out += k * v);
    }
}

/// `out` += row `y` of `plane` convolved vertically with `kernel`.
fn convolve_column(plane: &[f32], width: usize, y: usize, kernel: &[f32], out: &mut [f32]) {
    let (radius, height) = (kernel.len() / 2, plane.len() / width);
    for (i, &k) in kernel.iter().enumerate() {
        let y = (y + i).saturating_sub(radius).min(height - 1);
        let row = &plane[y * width..(y + 1) * width];
        out.iter_mut().zip(row).for_each(|(out, v)| *out += k * v);
    }
}

/// What FLIP compares of one picture.
struct Seen {
    /// Hunt-adjusted CIELAB of the colours left after the contrast sensitivity filter.
    colours: Vec<Vec3>,
    /// Strength of edges and of points.
    features: Vec<[f32; 2]>,
}

fn see(image: &Map2d<Vec3>, filters: &Filters) -> Seen {
    let width = image.width();
    let radius = filters.sensitivity[0].len().max(filters.features[0].len());
    // Horizontal passes: Y, Cx, Cz, Cz by sensitivity; then Y by the three feature kernels.
    let rows: Vec<[Vec<f32>; 7]> = (0..image.height())
        .into_par_iter()
        .map(|y| {
            let (mut padded, mut channels) =
                (Vec::with_capacity(width + 2 * radius), [(); 3].map(|()| vec![0.0; width]));
            for (x, rgb) in image.row(y).iter().enumerate() {
                let v = filters.opponent(*rgb);
                channels.iter_mut().zip(v.to_array()).for_each(|(channel, v)| channel[x] = v);
            }
            let luma: Vec<f32> = channels[0].iter().map(|y| (y + 16.0) / 116.0).collect();
            let [y, cx, cz] = &channels;
            let [ky, kx, wide, narrow] = &filters.sensitivity;
            let [g, dg, ddg] = &filters.features;
            [(y, ky), (cx, kx), (cz, wide), (cz, narrow), (&luma, g), (&luma, dg), (&luma, ddg)].map(
                |(row, kernel)| {
                    let mut out = vec![0.0; width];
                    convolve_row(row, kernel, &mut padded, &mut out);
                    out
                },
            )
        })
        .collect();
    let planes: [Vec<f32>; 7] =
        std::array::from_fn(|i| rows.iter().flat_map(|row| row[i].iter().copied()).collect());
    let seen: Vec<(Vec<Vec3>, Vec<[f32; 2]>)> = (0..image.height())
        .into_par_iter()
        .map(|row| {
            let vertical = |passes: &[(usize, &[f32])]| {
                let mut out = vec![0.0; width];
                passes
                    .iter()
                    .for_each(|&(i, kernel)| convolve_column(&planes[i], width, row, kernel, &mut out));
                out
            };
            let [ky, kx, wide, narrow] = &filters.sensitivity;
            let (y, cx) = (vertical(&[(0, ky)]), vertical(&[(1, kx)]));
            let cz = vertical(&[(2, wide), (3, narrow)]);
            let colour = |x: usize| {
                let linear = filters.linear_from_opponent([y[x], cx[x], cz[x]]);
                filters.hunt_lab(linear.clamp(Vec3::ZERO, Vec3::ONE))
            };
            let [g, dg, ddg] = &filters.features;
            let (edge_x, edge_y) = (vertical(&[(5, g)]), vertical(&[(4, dg)]));
            let (point_x, point_y) = (vertical(&[(6, g)]), vertical(&[(4, ddg)]));
            let strength =
                |x: usize| [math::hypot(edge_x[x], edge_y[x]), math::hypot(point_x[x], point_y[x])];
            ((0..width).map(colour).collect(), (0..width).map(strength).collect())
        })
        .collect();
    let (colours, features): (Vec<_>, Vec<_>) = seen.into_iter().unzip();
    Seen { colours: colours.concat(), features: features.concat() }
}

/// Per-pixel FLIP in [0, 1] of displayed linear light in [0, 1].
///
/// # Panics
/// If the sizes differ: a bug of the caller.
pub fn flip_linear(reference: &Map2d<Vec3>, test: &Map2d<Vec3>, pixels_per_degree: f64) -> Map2d<f32> {
    let (width, height) = (reference.width(), reference.height());
    assert_eq!((width, height), (test.width(), test.height()), "pictures of one size");
    if width == 0 || height == 0 {
        return Map2d::new(width, height, 0.0);
    }
    let filters = Filters::new(pixels_per_degree);
    let (a, b) = (see(reference, &filters), see(test, &filters));
    let map = (0..width * height)
        .into_par_iter()
        .map(|i| {
            let colour = filters.colour_error(a.colours[i], b.colours[i]);
            let ([edge, point], [other_edge, other_point]) = (a.features[i], b.features[i]);
            let strongest = (edge - other_edge).abs().max((point - other_point).abs());
            let feature = (strongest * std::f32::consts::FRAC_1_SQRT_2).sqrt();
            math::powf(colour, 1.0 - feature.min(1.0))
        })
        .collect();
    Map2d::from_vec(width, height, map)
}

/// Per-pixel FLIP of two pictures of sRGB bytes, three per pixel in rows.
///
/// # Panics
/// If a slice is shorter than `3 · width · height`: a bug of the caller.
pub fn flip_rgb8(reference: &[u8], test: &[u8], width: usize, height: usize) -> Map2d<f32> {
    let table: [f32; 256] = std::array::from_fn(|byte| linear_from_srgb(byte as f32 / 255.0));
    let image = |bytes: &[u8]| {
        Map2d::from_fn(width, height, |x, y| {
            let i = 3 * (y * width + x);
            Vec3::new(table[bytes[i] as usize], table[bytes[i + 1] as usize], table[bytes[i + 2] as usize])
        })
    };
    flip_linear(&image(reference), &image(test), PIXELS_PER_DEGREE)
}

/// Per-pixel LDR-FLIP of two pictures of linear radiance as `tone` shows them.
///
/// # Panics
/// If the sizes differ: a bug of the caller ([`super::compare`] checks them).
pub fn flip(reference: &Map2d<Vec3>, test: &Map2d<Vec3>, tone: &ToneMap) -> Map2d<f32> {
    let shown = |image: &Map2d<Vec3>| image.map(|rgb| tone.to_linear(rgb));
    flip_linear(&shown(reference), &shown(test), PIXELS_PER_DEGREE)
}

/// Mean of a map, in index order; 0 for an empty one.
pub fn mean(map: &Map2d<f32>) -> f64 {
    map.data().iter().map(|&v| f64::from(v)).sum::<f64>() / map.data().len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(value: f64, expected: f64, tolerance: f64) {
        assert!((value - expected).abs() <= tolerance, "{value} instead of {expected}");
    }

    fn extremes(map: &Map2d<f32>) -> [f64; 2] {
        let fold = |start, f: fn(f32, f32) -> f32| f64::from(map.data().iter().copied().fold(start, f));
        [fold(f32::INFINITY, f32::min), fold(0.0, f32::max)]
    }

    #[test]
    fn constants_of_the_reference() {
        let filters = Filters::new(PIXELS_PER_DEGREE);
        near(f64::from(filters.largest), 41.2761, 1e-3);
        assert_eq!((filters.sensitivity[0].len(), filters.features[0].len()), (21, 19));
        for (a, b, expected) in [
            (Vec3::ZERO, Vec3::ONE, 0.967_38),
            (Vec3::Y, Vec3::Z, 1.0),
            (Vec3::X, Vec3::Y, 0.986_66),
            (Vec3::splat(0.18), Vec3::splat(0.2), 0.104_37),
            (Vec3::splat(0.5), Vec3::splat(0.51), 0.040_70),
            (Vec3::X * 0.5, Vec3::X * 0.6, 0.257_48),
            (Vec3::new(0.2, 0.7, 0.1), Vec3::new(0.2, 0.7, 0.1), 0.0),
        ] {
            let map = flip_linear(&Map2d::new(40, 40, a), &Map2d::new(40, 40, b), PIXELS_PER_DEGREE);
            near(mean(&map), expected, 5e-5);
        }
    }

    #[test]
    fn an_edge_that_moved() {
        let edge = |at| Map2d::from_fn(40, 40, |x, _| Vec3::splat(if x < at { 0.2 } else { 0.8 }));
        let map = flip(&edge(20), &edge(22), &ToneMap::default());
        near(mean(&map), 0.079_33, 5e-5);
        near(extremes(&map)[1], 0.685_18, 5e-5);
    }

    /// Two pictures of 32 × 24 pixels that differ a little everywhere.
    fn patterns() -> [Map2d<Vec3>; 2] {
        let n = |x: i32, y: i32| ((7 * x.rem_euclid(32) + 13 * y.rem_euclid(24)) % 11) as f32 / 10.0;
        let at = |x: i32, y: i32| Vec3::new(n(x, y), n(x, y) * n(x, y), 1.0 - n(x, y));
        let reference = Map2d::from_fn(32, 24, |x, y| at(x as i32, y as i32));
        let test = Map2d::from_fn(32, 24, |x, y| {
            let (x, y) = (x as i32, y as i32);
            let shifts = Vec3::new(n(x, y - 1), n(x - 1, y), n(x, y));
            (at(x, y) + 0.1 * shifts - Vec3::splat(0.05)).clamp(Vec3::ZERO, Vec3::ONE)
        });
        [reference, test]
    }

    #[test]
    fn the_pattern_of_the_reference() {
        let [reference, test] = patterns();
        let map = flip(&reference, &test, &ToneMap::default());
        near(mean(&map), 0.035_338, 5e-5);
        let [smallest, largest] = extremes(&map);
        near(smallest, 0.007_845, 5e-5);
        near(largest, 0.189_771, 5e-5);
    }

    #[test]
    fn agrees_with_the_makers_code_on_bytes() {
        let tone = ToneMap::default();
        let [a, b] = patterns()
            .map(|image| -> Vec<u8> { image.data().iter().flat_map(|&rgb| tone.to_rgb8(rgb)).collect() });
        let image = |bytes: &[u8]| nv_flip::FlipImageRgb8::with_data(32, 24, bytes);
        let theirs = nv_flip::flip(image(&a), image(&b), PIXELS_PER_DEGREE as f32).to_vec();
        for (ours, theirs) in flip_rgb8(&a, &b, 32, 24).data().iter().zip(theirs) {
            near(f64::from(*ours), f64::from(theirs), 5e-5);
        }
    }

    #[test]
    fn nothing_differs_from_nothing() {
        assert_eq!(mean(&flip_rgb8(&[], &[], 0, 5)), 0.0);
        assert!(mean(&flip_rgb8(&[1, 2, 3], &[200, 2, 3], 1, 1)) > 0.1);
    }

    #[test]
    #[expect(clippy::disallowed_methods, reason = "prints how long it takes, asserts nothing about it")]
    fn timing() {
        let bytes = |seed| -> Vec<u8> {
            (0..3 * 512 * 512).map(|i| (crate::rng::hash(i, seed, 0) >> 58) as u8).collect()
        };
        let (a, b) = (bytes(1), bytes(2));
        let start = std::time::Instant::now();
        let map = flip_rgb8(&a, &b, 512, 512);
        println!("FLIP of 512 × 512: {:.1} ms", start.elapsed().as_secs_f64() * 1e3);
        assert!(mean(&map) > 0.0);
        let start = std::time::Instant::now();
        let image = |bytes: &[u8]| nv_flip::FlipImageRgb8::with_data(512, 512, bytes);
        nv_flip::flip(image(&a), image(&b), 67.0);
        println!("nv-flip of 512 × 512: {:.1} ms", start.elapsed().as_secs_f64() * 1e3);
    }
}
