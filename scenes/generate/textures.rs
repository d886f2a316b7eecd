//! Procedural textures: noise on a lattice that repeats, so that every texture tiles.

use std::io::Cursor;

use image::codecs::jpeg::JpegEncoder;
use image::{ImageFormat, ImageResult, Rgb, RgbImage, RgbaImage};

/// A colour in display values, 0–1.
pub type Color = [f64; 3];

/// Between `a` and `b`.
pub fn mix(a: Color, b: Color, t: f64) -> Color {
    let t = t.clamp(0.0, 1.0);
    [0, 1, 2].map(|i| a[i] + (b[i] - a[i]) * t)
}

/// 0 below `a`, 1 above `b`, smooth between.
pub fn smoothstep(a: f64, b: f64, x: f64) -> f64 {
    let t = ((x - a) / (b - a)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// A number in [0, 1) from whole numbers.
pub fn hash(x: i64, y: i64, seed: u64) -> f64 {
    let mut h = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (x as u64).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    h = (h ^ (h >> 29)).wrapping_add((y as u64).wrapping_mul(0x94d0_49bb_1331_11eb));
    h = (h ^ (h >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    h = (h ^ (h >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((h ^ (h >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

/// Value noise in [0, 1] that repeats after `period` units in x and y.
pub fn noise(x: f64, y: f64, period: [i64; 2], seed: u64) -> f64 {
    let (ix, iy) = (x.floor(), y.floor());
    let (tx, ty) = (smoothstep(0.0, 1.0, x - ix), smoothstep(0.0, 1.0, y - iy));
    let at = |dx: i64, dy: i64| {
        hash((ix as i64 + dx).rem_euclid(period[0]), (iy as i64 + dy).rem_euclid(period[1]), seed)
    };
    let (a, b) = (at(0, 0) + (at(1, 0) - at(0, 0)) * tx, at(0, 1) + (at(1, 1) - at(0, 1)) * tx);
    a + (b - a) * ty
}

/// Octaves of [`noise`] over the unit square, in [0, 1].
pub fn turbulence(u: f64, v: f64, cells: [i64; 2], octaves: u32, seed: u64) -> f64 {
    let (mut sum, mut weight, mut total) = (0.0, 1.0, 0.0);
    for octave in 0..octaves {
        let n = [cells[0] << octave, cells[1] << octave];
        sum += weight * noise(u * n[0] as f64, v * n[1] as f64, n, seed + u64::from(octave));
        total += weight;
        weight *= 0.5;
    }
    sum / total
}

/// Rounded to a byte, ties moved off the middle.
fn byte(x: f64) -> u8 {
    (x.clamp(0.0, 1.0) * 255.0 + 0.5 + 1e-6).floor() as u8
}

/// A picture of `color(u, v)`, v up, each pixel the mean of 2 × 2.
pub fn picture(width: u32, height: u32, color: impl Fn(f64, f64) -> Color) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        let mut sum = [0.0; 3];
        for k in 0..4 {
            let u = (f64::from(x) + 0.25 + 0.5 * f64::from(k & 1)) / f64::from(width);
            let v = 1.0 - (f64::from(y) + 0.25 + 0.5 * f64::from(k >> 1)) / f64::from(height);
            let c = color(u, v);
            sum = [0, 1, 2].map(|i| sum[i] + c[i] * 0.25);
        }
        Rgb(sum.map(byte))
    })
}

/// As a JPEG file.
pub fn jpeg(image: &RgbImage, quality: u8) -> ImageResult<Vec<u8>> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, quality).encode_image(image)?;
    Ok(bytes)
}

/// As a PNG file.
pub fn png(image: &RgbImage) -> ImageResult<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, ImageFormat::Png)?;
    Ok(bytes.into_inner())
}

/// As a PNG file with alpha.
pub fn png_alpha(image: &RgbaImage) -> ImageResult<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, ImageFormat::Png)?;
    Ok(bytes.into_inner())
}

/// Wood with its grain along u.
pub fn wood(dark: Color, light: Color, seed: u64) -> impl Fn(f64, f64) -> Color {
    move |u, v| {
        let bend = turbulence(u, v, [2, 3], 3, seed);
        let rings = v * 7.0 + bend * 3.0;
        let ring = rings - rings.floor();
        let late = smoothstep(0.3, 0.95, ring) - smoothstep(0.95, 1.0, ring);
        let fibre = turbulence(u, v, [6, 96], 2, seed + 10);
        mix(light, dark, 0.55 * late + 0.5 * (fibre - 0.5) + 0.15)
    }
}

/// `rows` planks of wood along u, with joints.
pub fn planks(dark: Color, light: Color, rows: u32, seed: u64) -> impl Fn(f64, f64) -> Color {
    let grain = wood(dark, light, seed);
    move |u, v| {
        let row = (v * f64::from(rows)).floor();
        let across = v * f64::from(rows) - row;
        let shift = hash(row as i64, 0, seed);
        let along = u + shift;
        let plank = (row as i64) * 8 + ((along * 2.0).floor() as i64).rem_euclid(2);
        let end = along * 2.0 - (along * 2.0).floor();
        let tint = 0.82 + 0.28 * hash(plank, 1, seed);
        let own = hash(plank, 2, seed);
        let c = grain(u + own, v * 0.5 + own * 3.0);
        let joint = smoothstep(0.0, 0.025, across) * smoothstep(0.0, 0.025, 1.0 - across);
        let joint = joint * smoothstep(0.0, 0.006, end) * smoothstep(0.0, 0.006, 1.0 - end);
        c.map(|x| x * tint * (0.45 + 0.55 * joint))
    }
}

/// Marble tiles, two by two, alternating.
pub fn marble_tiles(seed: u64) -> impl Fn(f64, f64) -> Color {
    move |u, v| {
        let (x, y) = ((u * 2.0).floor(), (v * 2.0).floor());
        let light = (x as i64 + y as i64) % 2 == 0;
        let warp = turbulence(u, v, [4, 4], 5, seed);
        let vein = (turbulence(u + warp * 0.25, v + warp * 0.15, [5, 5], 4, seed + 20) - 0.5).abs();
        let vein = 1.0 - smoothstep(0.0, 0.06, vein);
        let (a, b) = (u * 2.0 - x, v * 2.0 - y);
        let edge = smoothstep(0.0, 0.008, a.min(1.0 - a).min(b.min(1.0 - b)));
        let c = if light {
            mix(mix([0.86, 0.84, 0.80], [0.76, 0.74, 0.71], warp), [0.55, 0.53, 0.52], 0.6 * vein)
        } else {
            mix(mix([0.20, 0.22, 0.23], [0.12, 0.14, 0.15], warp), [0.62, 0.62, 0.60], 0.5 * vein)
        };
        c.map(|x| x * (0.5 + 0.5 * edge))
    }
}

/// Radiance of an equirectangular map as a Radiance HDR file; `radiance(u, v)`, v up.
pub fn hdr(width: u32, height: u32, radiance: impl Fn(f64, f64) -> Color) -> Vec<u8> {
    let mut bytes = format!("#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n").into_bytes();
    for y in 0..height {
        let mut row = Vec::new();
        for x in 0..width {
            let u = (f64::from(x) + 0.5) / f64::from(width);
            let v = 1.0 - (f64::from(y) + 0.5) / f64::from(height);
            row.push(rgbe(radiance(u, v)));
        }
        bytes.extend([2, 2, (width >> 8) as u8, (width & 255) as u8]);
        for channel in 0..4 {
            let values: Vec<u8> = row.iter().map(|p| p[channel]).collect();
            run_lengths(&values, &mut bytes);
        }
    }
    bytes
}

/// Mantissas and shared exponent of Ward's RGBE.
fn rgbe(c: Color) -> [u8; 4] {
    let max = c[0].max(c[1]).max(c[2]);
    if max < 1e-9 {
        return [0; 4];
    }
    let mut exponent = 0i32;
    while max * (1.0 + 1e-9) >= 2f64.powi(exponent) {
        exponent += 1;
    }
    while max * (1.0 + 1e-9) < 2f64.powi(exponent - 1) {
        exponent -= 1;
    }
    let [r, g, b] = c.map(|x| (x / 2f64.powi(exponent) * 256.0 + 1e-6).floor().clamp(0.0, 255.0) as u8);
    [r, g, b, (exponent + 128) as u8]
}

/// One channel of a scanline: runs of 3 or more equal bytes, and literals.
fn run_lengths(values: &[u8], out: &mut Vec<u8>) {
    let run = |i: usize| values[i..].iter().take(127).take_while(|&&b| b == values[i]).count();
    let mut i = 0;
    while i < values.len() {
        let n = run(i);
        if n >= 3 {
            out.extend([128 + n as u8, values[i]]);
            i += n;
        } else {
            let mut end = i + 1;
            while end < values.len() && end - i < 128 && run(end) < 3 {
                end += 1;
            }
            out.push((end - i) as u8);
            out.extend(&values[i..end]);
            i = end;
        }
    }
}

/// A tangent-space normal map of the height field `height(u, v)`, whose slope is scaled by `strength`.
pub fn normal_map(size: u32, strength: f64, height: impl Fn(f64, f64) -> f64) -> RgbImage {
    let e = 0.5 / f64::from(size);
    RgbImage::from_fn(size, size, |x, y| {
        let u = (f64::from(x) + 0.5) / f64::from(size);
        let v = 1.0 - (f64::from(y) + 0.5) / f64::from(size);
        let du = (height(u + e, v) - height(u - e, v)) / (2.0 * e);
        let dv = (height(u, v + e) - height(u, v - e)) / (2.0 * e);
        let n = glam::DVec3::new(-du * strength, -dv * strength, 1.0).normalize();
        Rgb(n.to_array().map(|c| byte(c * 0.5 + 0.5)))
    })
}

/// A leaf with its tip up; alpha is 0 outside it.
pub fn leaf() -> RgbaImage {
    RgbaImage::from_fn(64, 128, |x, y| {
        let u = (f64::from(x) + 0.5) / 32.0 - 1.0;
        let v = 1.0 - (f64::from(y) + 0.5) / 128.0;
        let width = 0.92 * (4.0 * v * (1.0 - v)).sqrt() * (1.05 - 0.5 * v) + 0.03;
        let inside = u.abs() < width && v > 0.01 && v < 0.985;
        let side = (v - u.abs() * 0.35) * 9.0;
        let vein = (1.0 - smoothstep(0.02, 0.07, u.abs()))
            .max(1.0 - smoothstep(0.0, 0.12, (side - side.floor() - 0.5).abs()));
        let c = mix(
            [0.13, 0.30, 0.09],
            [0.45, 0.58, 0.25],
            0.55 * vein + 0.25 * noise(u * 6.0, v * 12.0, [64, 64], 3),
        );
        image::Rgba([byte(c[0]), byte(c[1]), byte(c[2]), if inside { 255 } else { 0 }])
    })
}

/// A lattice of bars and round holes; grey 1 where there is matter.
pub fn lattice() -> RgbImage {
    picture(128, 128, |u, v| {
        let (x, y) = (u * 4.0 - (u * 4.0).floor() - 0.5, v * 4.0 - (v * 4.0).floor() - 0.5);
        let hole = x * x + y * y < 0.3 * 0.3 || (x.abs() + y.abs() > 0.82 && x.abs().max(y.abs()) < 0.47);
        if hole { [0.0; 3] } else { [1.0; 3] }
    })
}
