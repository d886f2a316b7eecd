//! What is done to attributes after they are decoded (appendix B).

use super::Filter;

/// Applies a filter to elements in place.
pub(super) fn filtered(elements: &mut [u8], stride: usize, filter: Filter) {
    match (filter, stride) {
        (Filter::None, _) => {}
        (Filter::Exponential, _) => {
            for v in elements.chunks_exact_mut(4) {
                let word = i32::from_le_bytes([v[0], v[1], v[2], v[3]]);
                let (exponent, mantissa) = ((word >> 24).clamp(-100, 100), (word << 8) >> 8);
                let scale = f32::from_bits(((exponent + 127) as u32) << 23);
                v.copy_from_slice(&(scale * mantissa as f32).to_le_bytes());
            }
        }
        (_, 4) => {
            for v in elements.chunks_exact_mut(4) {
                let signed = [v[0], v[1], v[2], v[3]].map(|b| i32::from(b as i8));
                let unsigned = [v[0], v[1], v[2], v[3]].map(i32::from);
                let out = match filter {
                    Filter::Color => color([unsigned[0], signed[1], signed[2], unsigned[3]], 255.0),
                    _ => octahedral(signed, 127.0),
                };
                v.copy_from_slice(&out.map(|w| w as u8));
            }
        }
        (..) => {
            for v in elements.chunks_exact_mut(8) {
                let words = [0, 2, 4, 6].map(|at| [v[at], v[at + 1]]);
                let signed = words.map(|w| i32::from(i16::from_le_bytes(w)));
                let unsigned = words.map(|w| i32::from(u16::from_le_bytes(w)));
                let out = match filter {
                    Filter::Color => color([unsigned[0], signed[1], signed[2], unsigned[3]], 65_535.0),
                    Filter::Quaternion => quaternion(signed),
                    _ => octahedral(signed, 32_767.0),
                };
                for (to, from) in v.chunks_exact_mut(2).zip(out) {
                    to.copy_from_slice(&(from as u16).to_le_bytes());
                }
            }
        }
    }
}

pub(super) fn octahedral([x, y, one, rest]: [i32; 4], most: f32) -> [i32; 4] {
    let one = (one as f32).max(1.0);
    let (x, y) = (x as f32 / one, y as f32 / one);
    let z = 1.0 - x.abs() - y.abs();
    // The lower half is folded over the edges of the upper.
    let t = z.min(0.0);
    let (x, y) = (x - t.copysign(x), y - t.copysign(y));
    let length = (x * x + y * y + z * z).sqrt().max(f32::MIN_POSITIVE);
    let [x, y, z] = [x, y, z].map(|v| (v / length * most).round() as i32);
    [x, y, z, rest]
}

pub(super) fn quaternion(v: [i32; 4]) -> [i32; 4] {
    let one = ((v[3] | 3) as f32).max(3.0);
    let [x, y, z] = [v[0], v[1], v[2]].map(|v| v as f32 / one * std::f32::consts::FRAC_1_SQRT_2);
    let w = (1.0 - x * x - y * y - z * z).max(0.0).sqrt();
    let largest = (v[3] & 3) as usize;
    let mut out = [0; 4];
    for (i, component) in [w, x, y, z].into_iter().enumerate() {
        out[(largest + i) % 4] = (component * 32_767.0).round().clamp(-32_767.0, 32_767.0) as i32;
    }
    out
}

pub(super) fn color([y, orange, green, alpha]: [i32; 4], most: f32) -> [i32; 4] {
    // The highest bit of alpha says how many bits the others have.
    let full = (1i32 << (32 - alpha.leading_zeros())) - 1;
    let scale = most / full.max(1) as f32;
    let opacity = alpha & (full >> 1);
    [y + orange - green, y + green, y - orange - green, opacity << 1 | opacity & 1]
        .map(|v| (v as f32 * scale).round().clamp(0.0, most) as i32)
}
