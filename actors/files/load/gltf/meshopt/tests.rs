use super::filters::{color, octahedral, quaternion};
use super::*;

const NONE: Mode = Mode::Attributes(Filter::None);

fn layout(mode: Mode, count: usize, stride: usize) -> Layout {
    Layout { mode, count, stride }
}

/// A stream of version 0 that uses every number of bits.
fn encoded(elements: &[u8], stride: usize) -> Vec<u8> {
    let mut out = vec![0xa0];
    let (mut last, block_max) = (elements[..stride].to_vec(), ((8192 / stride) & !15).min(256));
    for block in elements.chunks(block_max * stride) {
        for k in 0..stride {
            let mut before = last[k];
            let column: Vec<u8> = block[k..].iter().step_by(stride).copied().collect();
            let zigzag: Vec<u8> = column
                .iter()
                .map(|&v| {
                    let d = v.wrapping_sub(std::mem::replace(&mut before, v));
                    if d & 0x80 != 0 { !(d << 1) } else { d << 1 }
                })
                .collect();
            let groups: Vec<[u8; 16]> =
                zigzag.chunks(16).map(|g| std::array::from_fn(|i| g.get(i).copied().unwrap_or(0))).collect();
            let kind = |g: &[u8; 16]| match g.iter().max() {
                Some(0) => 0,
                Some(..3) => 1,
                Some(..200) => 2,
                _ => 3,
            };
            for four in groups.chunks(4) {
                out.push(four.iter().enumerate().map(|(i, g)| kind(g) << (2 * i)).sum());
            }
            for g in &groups {
                let bits = [0, 2, 4, 8][usize::from(kind(g))];
                if bits == 8 {
                    out.extend(g);
                } else if bits > 0 {
                    let all = (1u8 << bits) - 1;
                    let small = g.map(|v| v.min(all));
                    for packed in small.chunks(8 / bits) {
                        out.push(packed.iter().fold(0, |byte, v| byte << bits | v));
                    }
                    out.extend(g.iter().filter(|&&v| v >= all));
                }
            }
        }
        last.copy_from_slice(&block[block.len() - stride..]);
    }
    let tail = 32usize.saturating_sub(stride);
    out.resize(out.len() + tail, 0);
    out.extend(&elements[..stride]);
    out
}

#[test]
fn attributes_come_back_bit_for_bit() {
    for (count, stride) in [(1, 4), (15, 4), (16, 8), (17, 12), (300, 12), (513, 16), (600, 64), (70, 256)] {
        let elements: Vec<u8> = (0..count * stride)
            .map(|i| {
                let (e, k) = (i / stride, i % stride);
                match k % 4 {
                    0 => 7,
                    1 => (e / 3) as u8,
                    2 => (e * e % 61) as u8,
                    _ => (e * 37) as u8,
                }
            })
            .collect();
        let stream = encoded(&elements, stride);
        assert_eq!(decode(&stream, &layout(NONE, count, stride)).unwrap(), elements, "{count} {stride}");
        for cut in [1, 20, 33] {
            if stream.len() > cut {
                let _ = decode(&stream[..stream.len() - cut], &layout(NONE, count, stride));
            }
        }
        assert_eq!(decode(&stream, &layout(NONE, count * 2 + 600, stride)), Err(SHORT));
    }
}

#[test]
fn the_example_of_the_text() {
    let bytes = [0x17, 0x5f, 0xf0, 0xbc, 0x77, 0xa9, 0x21, 0x00, 0x34, 0xb5];
    let mut stream = vec![2];
    stream.extend(bytes);
    let mut column = [0; 16];
    let mut stream = Stream(&stream);
    deltas(&mut stream, &mut column, [0, 2, 4, 8]).unwrap();
    stream.end().unwrap();
    let signed = column.map(|d| undone([d, 0, 0, 0], [0; 4], None)[0] as i8);
    assert_eq!(signed, [-1, -4, -3, 26, -91, 0, -6, 6, -4, -4, 5, -5, 1, -1, 0, 0]);
}

#[test]
fn version_1_has_literals_zeros_words_and_rotated_bits() {
    // Two elements of twelve bytes: bytes, words, and turned words.
    let mut stream = vec![0xa1];
    stream.extend([0b11_10_01_00u8, 0xff, 0xff]);
    // Byte 0: one bit each, 1 means that a byte follows.
    stream.extend([1, 0b10, 0, 9]);
    // Byte 1: eight bits each; byte 2 is zero, byte 3 literal.
    stream.push(3);
    stream.extend([4, 2].iter().chain(&[0; 14]));
    stream.extend([1, 3]);
    // Words: 0 and −1, 512 and 1; then bits turned by 4.
    stream.extend([0, 1, 0, 0, 0, 2, 4, 0]);
    stream.extend([0x10, 0, 0, 0, 0, 0, 0, 0]);
    stream.resize(stream.len() + 9, 0);
    let baseline = [10, 20, 30, 40, 1, 0, 0, 0, 0, 0, 0, 0];
    stream.extend(baseline);
    stream.extend([0, 1, 0x42]);
    let out = decode(&stream, &layout(NONE, 2, 12)).unwrap();
    let first = [10, 22, 30, 39, 1, 0, 0, 2, 1, 0, 0, 0];
    let second = [5, 23, 30, 37, 0, 0, 1, 2, 1, 0, 0, 0];
    assert_eq!(out, [first, second].concat());
    let at = stream.len() - 1;
    for bad in [3, 0x10, 0x11] {
        stream[at] = bad;
        assert!(decode(&stream, &layout(NONE, 2, 12)).is_err(), "{bad}");
    }
}

#[test]
fn triangles_come_by_edges_and_vertices_seen_lately() {
    let mut stream = vec![0xe1];
    // New 0 1 2; beside its newest edge (0, 2) new 3; beside (0, 3) the vertex two back; explicit; ± 1.
    let codes = [0xf0, 0x00, 0x02, 0x0f, 0x0e, 0x0d, 0xff, 0xfe];
    stream.extend(codes);
    stream.extend([20]);
    // 0xff: a = last + 5, b explicit −1, c the newest vertex. 0xfe with 0: restarts.
    stream.extend([0xf1, 10, 1, 0]);
    stream.extend([0; 16]);
    let found = decode(&stream, &layout(Mode::Triangles, 24, 4)).unwrap();
    let found: Vec<u32> =
        found.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    let expected =
        [[0, 1, 2], [0, 2, 3], [0, 3, 1], [0, 1, 10], [0, 10, 11], [0, 11, 10], [15, 14, 10], [0, 1, 2]];
    assert_eq!(found, expected.concat());
    let short = decode(&stream, &layout(Mode::Triangles, 24, 2)).unwrap();
    assert_eq!(short.len(), 48);
    assert_eq!(decode(&stream, &layout(Mode::Triangles, 21, 4)), Err(LONG));
    assert_eq!(decode(&stream[..20], &layout(Mode::Triangles, 24, 4)), Err(SHORT));
}

#[test]
fn indices_follow_two_baselines() {
    // +5, then −2 on the other, +1 on the first, 300 on the other.
    let mut stream = vec![0xd1, 5 << 2, 0b111, 1 << 2];
    let v = 300u32 << 2 | 1;
    stream.extend([v as u8 | 0x80, (v >> 7) as u8]);
    stream.extend([0; 4]);
    let found = decode(&stream, &layout(Mode::Indices, 4, 4)).unwrap();
    let found: Vec<i32> =
        found.chunks_exact(4).map(|b| i32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    assert_eq!(found, [5, -2, 6, 298]);
    assert_eq!(decode(&stream, &layout(Mode::Indices, 3, 4)), Err(LONG));
    assert_eq!(decode(&stream, &layout(Mode::Indices, 5, 4)), Err(SHORT));
}

#[test]
fn filters_undo_what_the_text_says() {
    let mut v: Vec<u8> =
        [-3i32 << 24 | 5, 2 << 24 | 0x00ff_ffff].iter().flat_map(|v| v.to_le_bytes()).collect();
    filtered(&mut v, 8, Filter::Exponential);
    let floats: Vec<f32> = v.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    assert_eq!(floats, [0.625, -4.0]);
    // Straight up, along x, and the lower pole at a corner; ten bits in sixteen.
    let up = octahedral([0, 0, 511, 9], 32_767.0);
    assert_eq!(up, [0, 0, 32_767, 9]);
    assert_eq!(octahedral([511, 0, 511, 0], 32_767.0), [32_767, 0, 0, 0]);
    assert_eq!(octahedral([127, 127, 127, 0], 127.0), [0, 0, -127, 0]);
    // The largest is the last: (0, 0, 0, 1); and a half of everything.
    assert_eq!(quaternion([0, 0, 0, 32_767 & !3 | 3]), [0, 0, 0, 32_767]);
    let half = (0.5 * std::f32::consts::SQRT_2 * 1023.0).round() as i32;
    let q = quaternion([half, half, half, 1023 & !3]);
    assert!(q.iter().all(|c| (c - 16_384).abs() < 40), "{q:?}");
    // Grey of seven bits, opaque.
    assert_eq!(color([127, 0, 0, 0x7f], 255.0), [255, 255, 255, 255]);
    assert_eq!(color([0, 0, 0, 0], 255.0), [0, 0, 0, 0]);
    let [r, g, b, _] = color([30, 20, -10, 0x40], 255.0);
    assert!(r > g && r > b, "{r} {g} {b}");
}

#[test]
fn layouts_are_those_that_the_text_allows() {
    let ok = |mode, filter, count, stride| Layout::named(mode, filter, count, stride).is_ok();
    assert!(ok("ATTRIBUTES", "NONE", 5, 12) && ok("TRIANGLES", "NONE", 6, 2) && ok("INDICES", "NONE", 7, 4));
    assert!(ok("ATTRIBUTES", "QUATERNION", 5, 8) && ok("ATTRIBUTES", "EXPONENTIAL", 5, 12));
    assert!(
        !ok("ATTRIBUTES", "NONE", 5, 0)
            && !ok("ATTRIBUTES", "NONE", 5, 260)
            && !ok("ATTRIBUTES", "NONE", 5, 6)
    );
    assert!(!ok("ATTRIBUTES", "OCTAHEDRAL", 5, 12) && !ok("TRIANGLES", "OCTAHEDRAL", 6, 4));
    assert!(!ok("TRIANGLES", "NONE", 7, 4) && !ok("INDICES", "NONE", 7, 8) && !ok("WORDS", "NONE", 7, 4));
}
