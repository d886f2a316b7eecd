//! Views compressed by meshoptimizer (`EXT_meshopt_compression` and `KHR_meshopt_compression`, appendices A and B).
//!
//! Streams do not say how long they are: a view declares what comes out, and the caller bounds that. Here nothing is kept
//! beyond what the bytes have given so far, so a stream that ends early costs no more than it holds.

/// What a stream holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mode {
    /// Elements of a vertex attribute, with what is done to them afterwards.
    Attributes(Filter),
    /// Triangle lists.
    Triangles,
    /// Any other indices.
    Indices,
}

/// What is done to attributes after they are decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Filter {
    None,
    /// Unit vectors on an octahedron.
    Octahedral,
    /// Rotations without their largest component.
    Quaternion,
    /// Floats as whole numbers times powers of two.
    Exponential,
    /// Colours as luma and two differences.
    Color,
}

/// What comes out of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Layout {
    pub mode: Mode,
    pub count: usize,
    /// Bytes of an element.
    pub stride: usize,
}

impl Layout {
    /// The layout that a document names; the error completes "is compressed …".
    pub fn named(mode: &str, filter: &str, count: u64, stride: u64) -> Result<Self, String> {
        let mode = match (mode, filter) {
            ("ATTRIBUTES", "NONE") => Mode::Attributes(Filter::None),
            ("ATTRIBUTES", "OCTAHEDRAL") => Mode::Attributes(Filter::Octahedral),
            ("ATTRIBUTES", "QUATERNION") => Mode::Attributes(Filter::Quaternion),
            ("ATTRIBUTES", "EXPONENTIAL") => Mode::Attributes(Filter::Exponential),
            ("ATTRIBUTES", "COLOR") => Mode::Attributes(Filter::Color),
            ("TRIANGLES", "NONE") => Mode::Triangles,
            ("INDICES", "NONE") => Mode::Indices,
            _ => {
                let [mode, filter] = [mode, filter].map(super::buffers::shortened);
                return Err(format!(
                    "in mode {mode:?} with filter {filter:?}, which this build does not know"
                ));
            }
        };
        let fits = match mode {
            Mode::Attributes(filter) => {
                let of_filter = match filter {
                    Filter::None | Filter::Exponential => true,
                    Filter::Octahedral | Filter::Color => matches!(stride, 4 | 8),
                    Filter::Quaternion => stride == 8,
                };
                stride.is_multiple_of(4) && (4..=256).contains(&stride) && of_filter
            }
            Mode::Triangles => matches!(stride, 2 | 4) && count.is_multiple_of(3),
            Mode::Indices => matches!(stride, 2 | 4),
        };
        match usize::try_from(count) {
            Ok(count) if fits => Ok(Self { mode, count, stride: stride as usize }),
            _ => {
                Err(format!("as {count} elements of {stride} bytes, which its mode and filter do not allow"))
            }
        }
    }
}

/// The elements of a stream: `layout.count` times `layout.stride` bytes. The error completes "the compressed bytes …".
pub(super) fn decode(bytes: &[u8], layout: &Layout) -> Result<Vec<u8>, &'static str> {
    match layout.mode {
        Mode::Attributes(filter) => {
            let mut out = attributes(bytes, layout.count, layout.stride)?;
            filtered(&mut out, layout.stride, filter);
            Ok(out)
        }
        Mode::Triangles => triangles(bytes, layout.count, layout.stride),
        Mode::Indices => indices(bytes, layout.count, layout.stride),
    }
}

const SHORT: &str = "end early";
const LONG: &str = "go on after their end";
const HEADER: &str = "begin with a byte that says another format";

/// Bytes that are read one after the other.
struct Stream<'a>(&'a [u8]);

impl<'a> Stream<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], &'static str> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or(SHORT)?;
        self.0 = rest;
        Ok(taken)
    }

    fn byte(&mut self) -> Result<u8, &'static str> {
        self.take(1).map(|b| b[0])
    }

    /// Seven bits a byte, the lowest first.
    fn varint(&mut self) -> Result<u32, &'static str> {
        let mut value = 0u32;
        for shift in (0..32).step_by(7) {
            let byte = self.byte()?;
            value |= u32::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Ok(value);
            }
        }
        Err("hold a number of more than 32 bits")
    }

    fn end(&self) -> Result<(), &'static str> {
        if self.0.is_empty() { Ok(()) } else { Err(LONG) }
    }
}

/// Elements that are decoded together have columns of this many deltas.
const GROUP: usize = 16;

fn attributes(bytes: &[u8], count: usize, stride: usize) -> Result<Vec<u8>, &'static str> {
    let (version, tail_min) = match bytes.first() {
        Some(0xa0) => (0, 32),
        Some(0xa1) => (1, 24),
        _ => return Err(HEADER),
    };
    let tail = stride + if version == 1 { stride / 4 } else { 0 };
    let end = bytes.len().checked_sub(tail.max(tail_min)).filter(|&end| end >= 1).ok_or(SHORT)?;
    let mut stream = Stream(&bytes[1..end]);
    let (baseline, channels) = bytes[bytes.len() - tail..].split_at(stride);
    if channels.iter().any(|c| c & 15 > 2 || c & 15 < 2 && c >> 4 != 0) {
        return Err("name a kind of differences that there is not");
    }
    let mut last = baseline.to_vec();
    let block_max = ((8192 / stride) & !(GROUP - 1)).min(256);
    let mut out = Vec::new();
    let mut columns = vec![0u8; stride * block_max];
    while out.len() < count * stride {
        let elements = (count - out.len() / stride).min(block_max);
        let control = if version == 1 { stream.take(stride / 4)? } else { &[] };
        for (k, column) in columns.chunks_exact_mut(block_max).enumerate() {
            let control = control.get(k / 4).map(|c| c >> (2 * (k % 4)) & 3);
            match control {
                None => deltas(&mut stream, &mut column[..elements], [0, 2, 4, 8])?,
                Some(0) => deltas(&mut stream, &mut column[..elements], [0, 1, 2, 4])?,
                Some(1) => deltas(&mut stream, &mut column[..elements], [1, 2, 4, 8])?,
                Some(2) => column[..elements].fill(0),
                Some(_) => column[..elements].copy_from_slice(stream.take(elements)?),
            }
        }
        for i in 0..elements {
            for (k, last) in last.chunks_exact_mut(4).enumerate() {
                let delta = std::array::from_fn(|b| columns[(4 * k + b) * block_max + i]);
                let now = undone(delta, [last[0], last[1], last[2], last[3]], channels.get(k).copied());
                last.copy_from_slice(&now);
            }
            out.extend_from_slice(&last);
        }
    }
    stream.end()?;
    Ok(out)
}

/// Reads the deltas of one byte of elements, in groups that say how many bits each has.
fn deltas(stream: &mut Stream<'_>, column: &mut [u8], bits_of: [usize; 4]) -> Result<(), &'static str> {
    let groups = column.len().div_ceil(GROUP);
    let header = stream.take(groups.div_ceil(4))?;
    for (g, group) in column.chunks_mut(GROUP).enumerate() {
        let bits = bits_of[usize::from(header[g / 4] >> (2 * (g % 4)) & 3)];
        let packed = stream.take(bits * GROUP / 8)?;
        let mut values = [0u8; GROUP];
        for (i, value) in values.iter_mut().enumerate() {
            *value = match bits {
                0 => 0,
                8 => packed[i],
                // Single bits begin at the lowest, others at the highest.
                1 => packed[i / 8] >> (i % 8) & 1,
                _ => {
                    let (byte, place) = (i * bits / 8, i * bits % 8);
                    packed[byte] >> (8 - bits - place) & ((1 << bits) - 1)
                }
            };
            // All ones: the value follows.
            if matches!(bits, 1 | 2 | 4) && usize::from(*value) == (1 << bits) - 1 {
                *value = stream.byte()?;
            }
        }
        group.copy_from_slice(&values[..group.len()]);
    }
    Ok(())
}

/// Four bytes of an element from their differences to the one before.
fn undone(delta: [u8; 4], last: [u8; 4], channel: Option<u8>) -> [u8; 4] {
    match channel {
        Some(channel) if channel & 15 == 2 => {
            let delta = u32::from_le_bytes(delta).rotate_right(u32::from(channel >> 4));
            (u32::from_le_bytes(last) ^ delta).to_le_bytes()
        }
        Some(1) => {
            let word = |v: [u8; 4], at: usize| u16::from_le_bytes([v[at], v[at + 1]]);
            let next = |at| {
                let d = word(delta, at);
                let d = if d & 1 != 0 { !(d >> 1) } else { d >> 1 };
                word(last, at).wrapping_add(d).to_le_bytes()
            };
            let ([a, b], [c, d]) = (next(0), next(2));
            [a, b, c, d]
        }
        _ => std::array::from_fn(|b| {
            let d = delta[b];
            last[b].wrapping_add(if d & 1 != 0 { !(d >> 1) } else { d >> 1 })
        }),
    }
}

/// The last sixteen of something; 0 is the newest.
struct Recent<T>([T; 16], usize);

impl<T: Copy> Recent<T> {
    fn push(&mut self, value: T) {
        self.0[self.1 & 15] = value;
        self.1 = self.1.wrapping_add(1);
    }

    fn get(&self, back: u8) -> T {
        self.0[self.1.wrapping_sub(1 + usize::from(back)) & 15]
    }
}

/// What a decoder of triangles remembers.
struct Corners<'a> {
    data: Stream<'a>,
    next: u32,
    last: u32,
    vertices: Recent<u32>,
    edges: Recent<[u32; 2]>,
}

impl Corners<'_> {
    fn new_vertex(&mut self) -> u32 {
        self.next = self.next.wrapping_add(1);
        self.next.wrapping_sub(1)
    }

    fn explicit(&mut self) -> Result<u32, &'static str> {
        let v = self.data.varint()?;
        let delta = if v & 1 != 0 { !(v >> 1) } else { v >> 1 };
        self.last = self.last.wrapping_add(delta);
        Ok(self.last)
    }

    /// The vertex that four bits name; with it whether it is to be remembered.
    fn named(&mut self, bits: u8, explicit: bool) -> Result<(u32, bool), &'static str> {
        match bits {
            0 => Ok((self.new_vertex(), true)),
            15 if explicit => Ok((self.explicit()?, true)),
            _ => Ok((self.vertices.get(bits - 1), false)),
        }
    }

    /// A triangle beside the edge that the upper bits of `code` name.
    fn beside(&mut self, code: u8) -> Result<[u32; 3], &'static str> {
        let [a, b] = self.edges.get(code >> 4);
        let (c, remember) = match code & 15 {
            0 => (self.new_vertex(), true),
            13 => {
                self.last = self.last.wrapping_sub(1);
                (self.last, true)
            }
            14 => {
                self.last = self.last.wrapping_add(1);
                (self.last, true)
            }
            15 => (self.explicit()?, true),
            bits => (self.vertices.get(bits), false),
        };
        self.edges.push([c, b]);
        self.edges.push([a, c]);
        if remember {
            self.vertices.push(c);
        }
        Ok([a, b, c])
    }

    /// A triangle away from all before: its last two corners as the bits of `pair` say.
    fn apart(&mut self, a: u32, pair: u8, explicit: bool) -> Result<[u32; 3], &'static str> {
        let (b, remember_b) = self.named(pair >> 4, explicit)?;
        let (c, remember_c) = self.named(pair & 15, explicit)?;
        self.edges.push([b, a]);
        self.edges.push([c, b]);
        self.edges.push([a, c]);
        self.vertices.push(a);
        if remember_b {
            self.vertices.push(b);
        }
        if remember_c {
            self.vertices.push(c);
        }
        Ok([a, b, c])
    }
}

/// Adds an index of 2 or 4 bytes.
fn put(out: &mut Vec<u8>, stride: usize, index: u32) {
    out.extend_from_slice(&index.to_le_bytes()[..stride]);
}

fn triangles(bytes: &[u8], count: usize, stride: usize) -> Result<Vec<u8>, &'static str> {
    let mut stream = Stream(bytes);
    if stream.byte()? != 0xe1 {
        return Err(HEADER);
    }
    let codes = stream.take(count / 3)?;
    let end = stream.0.len().checked_sub(16).ok_or(SHORT)?;
    let (data, table) = stream.0.split_at(end);
    let edges = Recent([[0; 2]; 16], 0);
    let mut corners = Corners { data: Stream(data), next: 0, last: 0, vertices: Recent([0; 16], 0), edges };
    let mut out = Vec::with_capacity(count * stride);
    for &code in codes {
        let triangle = match code {
            0..0xf0 => corners.beside(code)?,
            0xf0..0xfe => {
                let a = corners.new_vertex();
                corners.apart(a, table[usize::from(code & 15)], false)?
            }
            _ => {
                let pair = corners.data.byte()?;
                if pair == 0 {
                    corners.next = 0;
                }
                let a = if code == 0xfe { corners.new_vertex() } else { corners.explicit()? };
                corners.apart(a, pair, true)?
            }
        };
        triangle.iter().for_each(|&v| put(&mut out, stride, v));
    }
    corners.data.end()?;
    Ok(out)
}

fn indices(bytes: &[u8], count: usize, stride: usize) -> Result<Vec<u8>, &'static str> {
    if bytes.first() != Some(&0xd1) {
        return Err(HEADER);
    }
    let end = bytes.len().checked_sub(4).filter(|&end| end >= 1).ok_or(SHORT)?;
    let mut stream = Stream(&bytes[1..end]);
    let mut last = [0u32; 2];
    let mut out = Vec::new();
    for _ in 0..count {
        let v = stream.varint()?;
        let delta = if v & 2 != 0 { !(v >> 2) } else { v >> 2 };
        let last = &mut last[(v & 1) as usize];
        *last = last.wrapping_add(delta);
        put(&mut out, stride, *last);
    }
    stream.end()?;
    Ok(out)
}

/// Applies a filter to elements in place.
fn filtered(elements: &mut [u8], stride: usize, filter: Filter) {
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

fn octahedral([x, y, one, rest]: [i32; 4], most: f32) -> [i32; 4] {
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

fn quaternion(v: [i32; 4]) -> [i32; 4] {
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

fn color([y, orange, green, alpha]: [i32; 4], most: f32) -> [i32; 4] {
    // The highest bit of alpha says how many bits the others have.
    let full = (1i32 << (32 - alpha.leading_zeros())) - 1;
    let scale = most / full.max(1) as f32;
    let opacity = alpha & (full >> 1);
    [y + orange - green, y + green, y - orange - green, opacity << 1 | opacity & 1]
        .map(|v| (v as f32 * scale).round().clamp(0.0, most) as i32)
}

#[cfg(test)]
mod tests {
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
                let groups: Vec<[u8; 16]> = zigzag
                    .chunks(16)
                    .map(|g| std::array::from_fn(|i| g.get(i).copied().unwrap_or(0)))
                    .collect();
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
        for (count, stride) in
            [(1, 4), (15, 4), (16, 8), (17, 12), (300, 12), (513, 16), (600, 64), (70, 256)]
        {
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
        let floats: Vec<f32> =
            v.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
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
        assert!(
            ok("ATTRIBUTES", "NONE", 5, 12) && ok("TRIANGLES", "NONE", 6, 2) && ok("INDICES", "NONE", 7, 4)
        );
        assert!(ok("ATTRIBUTES", "QUATERNION", 5, 8) && ok("ATTRIBUTES", "EXPONENTIAL", 5, 12));
        assert!(
            !ok("ATTRIBUTES", "NONE", 5, 0)
                && !ok("ATTRIBUTES", "NONE", 5, 260)
                && !ok("ATTRIBUTES", "NONE", 5, 6)
        );
        assert!(!ok("ATTRIBUTES", "OCTAHEDRAL", 5, 12) && !ok("TRIANGLES", "OCTAHEDRAL", 6, 4));
        assert!(!ok("TRIANGLES", "NONE", 7, 4) && !ok("INDICES", "NONE", 7, 8) && !ok("WORDS", "NONE", 7, 4));
    }
}
